"""Photographs without control points and positions: a model in a frame of its own, without scale."""

import json

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from tests.bands import band
from tests.images.block_scene import OPTIONS, scene
from tests.images.sfm_scene import photographs, similarity
from thalweg.cli import main
from thalweg.core import InputError, ThalwegError, exp_rotation
from thalweg.images import orient_photographs
from thalweg.images.bundle.run import orient_block
from thalweg.images.model import ControlMarks, ControlPoints

CORNERS = {
    "front": (-2.5, -0.2, 6.0),
    "low": (-0.9, 2.0, 6.0),
    "other": (1.0, 0.3, 5.0),
    "right": (2.2, 0.3, 5.0),
}
"""Corners of the boxes of `sfm_scene`."""


def test_a_block_without_control_is_true_in_its_own_datum(rng):
    """Errors of poses, in the datum that is stated, are those of their joint covariance."""
    problem, truth = scene(rng, images=14, points=320)
    turned = problem.block.transformed(exp_rotation([0.4, -1.1, 2.0]), np.array([900.0, -40.0, 7.0]), 0.13)
    found = orient_block(turned, ControlPoints.none(), ControlMarks.none(), OPTIONS, own_frame=True)
    adjusted = found.adjusted
    held = np.flatnonzero(~adjusted.layout.free[: adjusted.layout.n_poses])
    assert len(held) == 7
    assert held[:6].tolist() == [0, 1, 2, 3, 4, 5]
    base, axis = divmod(int(held[6]), 6)
    for name in (turned.images[0], f"{'xyz'[axis]} of {turned.images[base]}"):
        assert name in found.datum
    # the truth in that datum: its first camera is the frame, a coordinate of the base the unit
    away = (truth.C - truth.C[0]) @ truth.R[0]
    away /= abs(away[base, axis])
    R = truth.R[0].T @ truth.R
    turn = Rotation.from_matrix(R @ np.swapaxes(adjusted.x.R, 1, 2)).as_rotvec()
    error = np.concatenate([away - adjusted.x.C - adjusted.origin_m, turn], axis=1).ravel()
    np.testing.assert_allclose(error[held], 0.0, atol=1e-9)
    free = np.setdiff1d(np.arange(len(error)), held)
    Q = adjusted.cov[np.ix_(free, free)]
    low, high = band(len(free))  # 77 numbers
    assert low < error[free] @ np.linalg.solve(Q, error[free]) / len(free) < high
    lens = adjusted.x.cameras[0].parameters[:2] - truth.camera.parameters[:2]
    at = adjusted.layout.interior[0][0]
    assert np.abs(lens).max() < 4 * np.sqrt(adjusted.cov[at, at])


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """Results of five photographs and marks of four corners, and the true centres."""
    folder = tmp_path_factory.mktemp("model")
    taken = photographs(folder / "photos", x=np.linspace(-1.4, 1.4, 5))
    rows = ["image,point,x_px,y_px"]
    for file, R, centre in zip(taken.files, taken.R, taken.centre, strict=True):
        for name, at in CORNERS.items():
            x, y = taken.camera.project(((np.array(at) - centre) @ R)[None])[0]
            if 0 < x < 320 and 0 < y < 240:
                rows.append(f"{file.name},{name},{x:.3f},{y:.3f}")
    rows.append(f"{taken.files[0].name},alone,100,100")
    (folder / "marks.csv").write_text("\n".join(rows) + "\n")
    how = ["--marks", folder / "marks.csv", "--out", folder / "out", "--threads", "1"]
    assert main(["orient", str(folder / "photos"), *map(str, how)]) == 0
    return folder / "out", taken.centre


def test_photographs_alone_have_the_right_shape(model):
    out, true = model
    poses = pd.read_csv(out / "image_poses.csv")
    xyz = poses[["x", "y", "z"]].to_numpy()
    sigma = poses[["sigma_x", "sigma_y", "sigma_z"]].to_numpy()
    assert np.abs(xyz).max() == pytest.approx(1.0, abs=0.01)
    scale, R, shift = similarity(xyz, true)
    left = (scale * xyz @ R.T + shift - true) / scale
    assert np.abs(left).max() < 4 * sigma.max()
    assert sigma.max() < 0.02
    told = pd.read_csv(out / "images.csv")[["sigma_x", "sigma_y", "sigma_z"]].to_numpy()
    assert told == pytest.approx(sigma, rel=1e-5)  # six digits
    points = pd.read_csv(out / "points.csv").set_index("point")
    corners = scale * points.loc[list(CORNERS), ["x", "y", "z"]].to_numpy() @ R.T + shift
    np.testing.assert_allclose(corners, list(CORNERS.values()), atol=0.15)


def test_a_model_claims_no_metres(model):
    out, _ = model
    facts = json.loads((out / "orientation.json").read_text())
    assert facts["crs"] is None
    assert facts["model_frame"]["scale"] == "unknown"
    assert "image_01.png" in facts["model_frame"]["datum"]
    assert facts["notes"][0].startswith("Model frame, no scale")
    assert facts["measured_tie_points"] == {"given": 5, "used": 4}
    assert any("1 of 5 measured tie points" in note for note in facts["notes"])
    assert not (out / "image_poses.parquet").exists()
    for table in out.glob("*.csv"):
        columns = pd.read_csv(table).columns
        assert not [name for name in columns if name.endswith(("_m", "_mm")) or "east" in name], table
    page = (out / "index.html").read_text()
    assert "Model frame, no scale" in page
    assert " mm" not in page


def test_two_photographs_of_nothing_common_are_refused(tmp_path, rng):
    files = {}
    for name in ("a.png", "b.png"):
        noise = rng.integers(0, 255, (15, 20), np.uint8)
        Image.fromarray(noise).resize((320, 240), Image.Resampling.BICUBIC).save(tmp_path / name)
        files[name] = tmp_path / name
    with pytest.raises(ThalwegError, match="no two of 2 images could be oriented to each other"):
        orient_photographs(files, crs=None)


def test_a_crs_needs_coordinates_and_they_need_one(tmp_path, capsys):
    with pytest.raises(InputError, match="UTM zone 33N, and nothing that has coordinates"):
        orient_photographs({}, crs="EPSG:25833")
    for given, told in (
        (["--positions", "positions.csv"], "coordinates without a CRS"),
        (["--points", "points.csv", "--crs", "local"], "control points without marks"),
    ):
        assert main(["orient", str(tmp_path), *given, "--out", str(tmp_path / "out")]) == 2
        assert told in capsys.readouterr().err
