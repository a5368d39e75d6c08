"""Orientations of real blocks by the measurements of their images, and the script of the rule."""

import importlib.util
import json
import re

import numpy as np
import pytest

from tests.images.finished_scene import (
    FLIP,
    Scene,
    assert_poses,
    imported,
    predictions,
    settings,
    table,
    write_colmap_text,
)
from thalweg.calibration import read_camera
from thalweg.core import Camera, rotation_opk
from thalweg.images.model import ImagePoses

# ---------------------------------------------------------------- real files


@pytest.mark.real
def test_orientations_of_an_aerial_block_by_its_control_points(tmp_path, data_dir):
    """DBAT's adjusted poses of five aerial images put surveyed points where they were marked."""
    script = data_dir / "dbat_sxb/script/sxb"
    if not script.is_dir():
        pytest.skip("no dbat_sxb")
    report = (script / "result/report.txt").read_text()
    values = re.findall(r"Photo (\d+): (\S+)\n(.*?)(?=Photo \d|\Z)", report, re.DOTALL)
    names, rows = [], []
    for _, name, text in values:
        names.append(name)
        rows.append(
            [
                float(re.findall(rf"{key}:\s+Value:\s+(\S+)", text)[0])
                for key in ("Xc", "Yc", "Zc", "Omega", "Phi", "Kappa")
            ]
        )
    poses = np.array(rows)
    assert len(poses) == 5
    R = np.array([rotation_opk(*np.deg2rad(row)) @ FLIP for row in poses[:, 3:]])
    given = Scene(tuple(names), poses[:, :3], R)
    path = table(tmp_path / "eo.txt", angles=poses[:, 3:], of=given, separator=",")
    found = imported(path, given=predictions(truth=given))
    # pixels of DBAT count from the centre of the first one, which is 1
    focal_px = 123.9392 / 0.006
    parameters = np.array([focal_px, focal_px, 4429.0, 6468.0, 0, 0, 0, 0, 0])
    camera = Camera(model="perspective", size_px=(8858, 12996), parameters=parameters)
    listed = (script / "reference/sxb-control.txt").read_text().splitlines()
    cells = [line.split(",") for line in listed if line[:1].isdigit()]
    control = {int(row[0]): np.array(row[2:5], float) for row in cells}
    off = []
    for point, image, x, y in np.loadtxt(script / "measurements/markpts.txt", delimiter=","):
        k, p = int(image) - 1, control[int(point)]
        seen = camera.project((p - found.poses.centre_wcs_m[k]) @ found.poses.R_wcs_ccs[k])[0]
        off.append(seen - [x - 0.5, y - 0.5])
    # the report's rms of all points is 1.1 px; two of the 16 points took no part and are up to 0.5 m off
    assert np.sqrt(np.mean(np.square(off))) < 2.0


# ---------------------------------------------------------------- script


@pytest.mark.parametrize("kind", ["colmap", "table", "table and calibration"])
def test_script(tmp_path, repository, kind):
    spec = importlib.util.spec_from_file_location(
        "import_orientations", repository / "workflow/scripts/import_orientations.py"
    )
    assert spec
    assert spec.loader
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    interior = None
    path = write_colmap_text(tmp_path / "model") if kind == "colmap" else table(tmp_path / "eo.txt")
    if kind == "table and calibration":
        interior = tmp_path / "cameras.txt"
        interior.write_text("1 PINHOLE 720 540 600 600 360 270\n")
    script.main(
        files=[path],
        predictions=predictions(),
        interior=interior,
        poses=tmp_path / "poses.parquet",
        camera=tmp_path / "camera.yaml",
        facts=tmp_path / "facts.json",
        run="test",
        crs=None,
        finished=settings(crs="world"),
    )
    assert_poses(ImagePoses.read(tmp_path / "poses.parquet"))
    facts = json.loads((tmp_path / "facts.json").read_text())
    assert facts["oriented"] == 12
    if kind == "table":
        assert "No interior orientation" in (tmp_path / "camera.yaml").read_text()
    else:
        expected = 582.0 if kind == "colmap" else 600.0
        assert read_camera(tmp_path / "camera.yaml").parameters[0] == expected
