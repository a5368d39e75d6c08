"""The table of marks in pictures of a marker field, and the job that calibrates the camera from it."""

import json

import numpy as np
import pandas as pd
import pytest

from tests.lightsheet.basin import FRAME, Jobs, run
from thalweg.calibration import MARKS, read_camera
from thalweg.core import GeometryError, InputError, frame_of, write_table
from thalweg.core.calibration import read_calibration
from thalweg.lightsheet.calibration import NAME, read_lens_marks
from thalweg.lightsheet.optics import LENS, read_sensor
from thalweg.lightsheet.optics.sensor import LENS_BLOCK

SIZE = (512, 512)


def table(basin):
    return pd.read_csv(basin.folder / "camera_field_marks.csv")


def changed(basin, path, change):
    change(table(basin)).to_csv(path, index=False)
    return path


# ---------------------------------------------------------------- the table


def test_the_twin_writes_what_is_read(basin):
    marks = read_lens_marks(basin.folder / "camera_field_marks.csv", SIZE)
    assert marks.columns.tolist() == ["image", "camera", "marker", "corner", "x_px", "y_px", "sigma_px"]
    assert marks["image"].nunique() == 24
    assert set(marks["camera"]) == {NAME}
    assert (marks.groupby(["image", "marker"]).size() == 4).all()


def test_a_detected_table_is_read_as_well(basin, tmp_path):
    marks = table(basin).rename(columns={"file": "image"})
    path = tmp_path / "marks.parquet"
    found = frame_of(MARKS, {**marks, "file": marks["image"], "camera": "sheet", "size_px": 20.0})
    write_table(path, found, MARKS, {"sizes_px": {"sheet": SIZE}})
    one = read_lens_marks(path, SIZE)
    two = read_lens_marks(basin.folder / "camera_field_marks.csv", SIZE)
    pd.testing.assert_frame_equal(one, two)
    with pytest.raises(InputError, match="pictures of 512 x 512 pixels; expected 2048 x 2048"):
        read_lens_marks(path, (2048, 2048))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.drop(columns="file"), "columns missing: file"),
        (lambda t: t.assign(corner=t["corner"] + 1), "corner 4; expected 0 upper left"),
        (lambda t: t.assign(marker=-1 - t["marker"]), "marker -"),
        (lambda t: t.assign(marker=t["marker"] + 0.5), "expected a whole number"),
        (lambda t: t.assign(sigma_px=0.0), "sigma_px 0 in row 1"),
        (lambda t: pd.concat([t, t.iloc[:1]]), "stands twice in field_001.png"),
        (lambda t: t.assign(x_px=4 * t["x_px"]), "lie outside the picture"),
        (lambda t: t.assign(x_px=512 - t["x_px"]), "anticlockwise"),
        (lambda t: t.assign(y_px=512 - t["y_px"]), "y counts upwards"),
        (lambda t: t.rename(columns={"x_px": "y_px", "y_px": "x_px"}), "x and y are exchanged"),
        (lambda t: t.assign(corner=3 - t["corner"]), "numbered the other way round"),
        (lambda t: t[t["corner"] < 3], "no marker with all four corners"),
    ],
)
def test_tables_that_are_wrong(basin, tmp_path, change, words):
    with pytest.raises(InputError) as caught:
        read_lens_marks(changed(basin, tmp_path / "marks.csv", change), SIZE)
    assert words in str(caught.value)
    assert caught.value.expected


# ---------------------------------------------------------------- the job


@pytest.fixture(scope="module")
def jobs(basin, tmp_path_factory):
    done = Jobs(tmp_path_factory.mktemp("lens"))
    done.calibrate_camera(basin)
    done.orient(basin, interior=done.out / "camera_interior.yaml")
    done.detect(basin, "calibration")
    done.calibrate(basin)
    return done


def test_files_of_the_calibration(jobs):
    calibration = read_calibration(jobs.out / "camera_interior.yaml")
    assert [block.name for block in calibration.blocks] == [LENS_BLOCK]
    assert calibration.source.twin
    assert calibration.source.observations > 4000
    report = json.loads((jobs.out / "camera_interior.json").read_text())
    assert len(report["images"]) == 24
    assert [row["name"] for row in report["scale_bars"]] == ["bar 1", "bar 2", "bar 3"]
    # at a quarter of the pixels four times the 0.0005 mm of the whole chip, still below P4's 0.004 mm
    assert 0.3 < report["sigma_over_constant"]["over_published"] < 0.8
    residuals = pd.read_csv(jobs.out / "calibrate_sheet_camera.residuals")
    assert residuals["used"].sum() == report["adjustment"]["marks"] - report["adjustment"]["marks_rejected"]


def test_its_covariance_arrives_in_the_calibrated_sensor(jobs, basin):
    camera = read_camera(jobs.out / "camera_interior.yaml")
    sensor = read_sensor(jobs.out / "sensor.yaml")
    np.testing.assert_allclose(sensor.cov[LENS, LENS], camera.cov, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(sensor.camera.parameters, camera.parameters, rtol=1e-12)
    # the camera over its window and the laser stand on it
    names = ("fx", "cx", "k1")
    for name in names:
        k = sensor.names.index(name)
        assert np.abs(sensor.cov[k, : LENS.start]).max() > 0
        assert np.abs(sensor.cov[k, LENS.stop : LENS.stop + 6]).max() > 0
    assert np.diag(sensor.cov)[sensor.names.index("laser_phi_rad")] == 0.0  # held, and not nearly so
    sigma = np.sqrt(np.diag(sensor.cov))
    shown = sigma > 0
    joint = sensor.cov[np.ix_(shown, shown)] / np.outer(sigma[shown], sigma[shown])
    # the file's 14 digits leave no negative eigenvalue that counts
    assert np.linalg.eigvalsh(joint).min() > -1e-12
    design = jobs.orient(basin)
    assert np.sqrt(design.cov[LENS, LENS][0, 0]) > 1.5 * np.sqrt(camera.cov[0, 0])


def test_without_a_marker_field_the_design_counts(jobs, basin, tmp_path):
    sensor = Jobs(tmp_path).orient(basin)
    report = json.loads((tmp_path / "orient_sheet_camera.report").read_text())
    assert report["interior_orientation"] == "the design"
    other = Jobs(jobs.out).orient(basin, interior=jobs.out / "camera_interior.yaml")
    assert sensor.camera.parameters[4:].tolist() == [0.0] * 5
    assert np.abs(other.camera.parameters[4:]).min() > 0.0


def test_a_message_names_the_table(basin, tmp_path):
    few = changed(basin, tmp_path / "few.csv", lambda t: t[t["file"] < "field_005.png"])
    with pytest.raises(GeometryError, match=r"few\.csv: 4 pictures of the field"):
        Jobs(tmp_path).calibrate_camera(basin, marks=few)
    with pytest.raises(InputError, match="file not found"):
        run(
            "calibrate_sheet_camera",
            tmp_path,
            design=basin.folder / "sensor.yaml",
            marks=tmp_path / "none.csv",
            field=basin.folder / "camera_field.yaml",
            run="x",
            frame=FRAME,
            twin=True,
        )
