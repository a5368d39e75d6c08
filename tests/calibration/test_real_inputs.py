"""Entry scripts on what campaigns name: a folder of the twin, or a list of files of a survey."""

import json
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.calibration import field_blocks as blocks
from thalweg.calibration import MARKS, MarkerLayout, interior_calibration, read_camera, sheet_picture
from thalweg.calibration.camera_lidar import read_statics
from thalweg.calibration.field import FieldPoints, write_points
from thalweg.core import GeometryError, InputError, read_table, write_table
from thalweg.core.calibration import Source, write_calibration
from thalweg.ingest.photos import IMAGE_STAMPS, list_images

Text = Callable[[list[int], list[int]], str]
RUN = ["R20210512_083107000.png", "R20210512_083108000.png", "R20210512_083109000.png"]


@pytest.fixture
def script(repository):
    """The ``main`` of an entry script."""
    return lambda name: runpy.run_path(str(repository / f"workflow/scripts/{name}.py"))["main"]


def sheets(path: Path, *ids: int) -> Path:
    """A picture with sheets side by side on grey."""
    image = np.full((180, 320), 120, np.uint8)
    for k, marker in enumerate(ids):
        image[20:152, 20 + 145 * k : 152 + 145 * k] = sheet_picture(marker, MarkerLayout(), 12) // 2 + 60
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)
    return path


@pytest.fixture
def recordings(tmp_path, field_text):
    """Pictures of positions and of a run; a folder with a dot, and a file beside that is no picture."""
    for k, ids in ((2, (1, 4)), (10, (5,))):
        sheets(tmp_path / f"logs/shots.2021/position_{k}.png", *ids)
    for k, name in enumerate(RUN):
        sheets(tmp_path / "logs/run" / name, k + 1)
    (tmp_path / "logs/run/notes.txt").write_text("no picture")
    (tmp_path / "field.yaml").write_text(field_text([1, 3], [4, 7]))
    return tmp_path


def detected(main: Callable[..., None], base: Path, folders: list[Path], name: str) -> Any:
    """Table of marks by the script."""
    out = base / name
    out.mkdir()
    main(
        folders=folders,
        field=base / "field.yaml",
        marks=out / "marks.parquet",
        report=out / "report.json",
        rejected=out / "rejected.csv",
        camera="boat",
        threads=1,
    )
    table, meta = read_table(out / "marks.parquet", MARKS)
    assert meta["sizes_px"] == {"boat": [320, 180]}
    assert json.loads((out / "report.json").read_text())["images"] == 5
    return table


def test_markers_in_folders_and_in_lists_of_files(recordings, script):
    main = script("detect_markers")
    shots, run = recordings / "logs/shots.2021", recordings / "logs/run"
    by_folders = detected(main, recordings, [shots, run], "folders")
    assert by_folders["image"].unique().tolist() == ["position_2.png", "position_10.png", *RUN]
    assert by_folders["file"].unique().tolist() == [
        "shots.2021/position_2.png",
        "shots.2021/position_10.png",
        *(f"run/{name}" for name in RUN),
    ]
    files = [shots / "position_2.png", shots / "position_10.png", *(run / name for name in RUN)]
    by_files = detected(main, recordings, files, "files")
    mixed = detected(main, recordings, [*files[:2], run], "mixed")
    for table in (by_files, mixed):
        assert table.equals(by_folders)


def test_stamps_of_a_folder_and_of_a_list_of_files(recordings, script):
    run, tables = recordings / "logs/run", []
    given = {"folder": [run], "files": [run / name for name in RUN], "mixed": [run / RUN[0]]}
    # the other two from a second folder: a camera begins a new one every thousand pictures
    for name in RUN[1:]:
        sheets(recordings / "logs/run_2" / name, 1)
    given["mixed"].append(recordings / "logs/run_2")
    for name, images in given.items():
        stamps, integrity = recordings / f"{name}.parquet", recordings / f"{name}.json"
        script("read_image_stamps")(
            images=images,
            times=[],
            stamps=stamps,
            integrity=integrity,
            source="auto",
            pattern=None,
            utc_offset=None,
            folders=False,
        )
        tables.append(read_table(stamps, IMAGE_STAMPS)[0])
        assert json.loads(integrity.read_text())["counts"]["images"] == 3
    assert tables[0]["file"].tolist() == RUN
    assert np.diff(tables[0]["t_device_s"]).tolist() == [1.0, 1.0]
    assert tables[1].equals(tables[0])
    assert tables[2].equals(tables[0])


def test_files_and_folders_as_one_list(recordings):
    run, shots = recordings / "logs/run", recordings / "logs/shots.2021"
    assert [p.name for p in list_images([run / RUN[2], shots])] == [
        RUN[2],
        "position_2.png",
        "position_10.png",
    ]
    assert list_images(run) == [run / name for name in RUN]
    assert list_images(run / RUN[1]) == [run / RUN[1]]
    with pytest.raises(InputError, match="no such folder or file"):
        list_images([run, recordings / "absent"])
    with pytest.raises(InputError, match="no photographs"):
        list_images([])


def test_the_boats_camera_from_a_file_and_from_nothing(tmp_path, script, field_text):
    """Two pictures are enough with a known interior orientation, and too few without."""
    (tmp_path / "field.yaml").write_text(field_text([1, 3], [4, 7]))
    rng = np.random.default_rng(4)
    yard = blocks.yard(2)[0]
    index = tuple((sheet.marker, corner) for sheet in yard for corner in range(4))
    saddles = np.concatenate([sheet.saddles for sheet in yard])
    points = FieldPoints(points=index, points_pcs=saddles, cov=1e-8 * np.eye(saddles.size))
    write_points(tmp_path / "points.csv", points)
    poses = {
        f"{k}.jpg": blocks.look(np.append(rng.normal(0, 0.5, 2), 1.0), np.array([5.0, 4.0 * k - 2, 1.0]))
        for k in range(2)
    }
    marks = blocks.observe(yard, poses, blocks.FISHEYE, 1, largest_angle_deg=70.0)
    marks = marks.assign(file=marks["image"], size_px=50.0)
    size_px = blocks.FISHEYE.size_px
    write_table(tmp_path / "marks.parquet", marks, MARKS, {"sizes_px": {"fisheye": size_px}})
    sigma = np.r_[np.full(4, 0.1), np.full(4, 1e-5)]
    known = blocks.FISHEYE.with_parameters(blocks.FISHEYE.parameters, np.diag(sigma**2))
    source = Source(run="before", method="bundle adjustment", observations=100, sigma0=1.0)
    write_calibration(tmp_path / "interior.yaml", interior_calibration(known, source))

    def run(interior: list[Path]) -> None:
        script("orient_camera")(
            marks=tmp_path / "marks.parquet",
            points=tmp_path / "points.csv",
            field=tmp_path / "field.yaml",
            interior=interior,
            position_images=[],
            poses=tmp_path / "poses.parquet",
            statics=tmp_path / "statics.npz",
            camera=tmp_path / "camera.yaml",
            residuals=tmp_path / "residuals.csv",
            report=tmp_path / "report.json",
            run="x",
            model="fisheye",
            focal_px=None,
        )

    with pytest.raises(GeometryError, match="2 of 2 pictures of the boat's camera"):
        run([])
    run([tmp_path / "interior.yaml"])
    assert read_statics(tmp_path / "statics.npz").images == ()
    found = read_camera(tmp_path / "camera.yaml")
    # an observation more only makes it better: within four sigma of what was known
    assert (np.abs(found.parameters - blocks.FISHEYE.parameters) < 4 * sigma).all()
    assert (np.diag(found.cov) <= sigma**2).all()
