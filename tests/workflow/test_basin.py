"""The light-sheet sensor from recordings to a calibrated sensor: the twin's, and as users have it."""

import json

import numpy as np
import pandas as pd
import pytest
import yaml
from numpy.testing import assert_allclose, assert_array_equal

from tests.bands import band
from tests.golden.kept_numbers import moved_since_kept
from thalweg.core.calibration import read_calibration
from thalweg.lightsheet.optics import read_sensor
from thalweg.lightsheet.poses.panels import PUBLISHED

pytestmark = pytest.mark.workflow

NAME = "basin_tiny"
LOGS = f"results/{NAME}/simulation/logs/light_sheet"
TRUTH = f"results/{NAME}/accuracy/light_sheet_truth.csv"
TARGETS = (f"results/{NAME}/triangulation/panels.csv", TRUTH)


@pytest.fixture(scope="module")
def hall(repository, tmp_path_factory, house_builder):
    """A copy in which the sensor of the small basin was calibrated; `test_all` does the rest."""
    house = house_builder(repository, tmp_path_factory.mktemp("hall"))
    house.snakemake("--config", f"campaign={NAME}", "--", *TARGETS)
    return house


def real_campaign(house, name: str) -> None:
    """The twin's recordings as files of a real campaign: no twin, no truth."""
    twin = yaml.safe_load((house.root / f"config/campaigns/{NAME}.yaml").read_text())
    sheet = {
        "sensor": [f"../../{LOGS}/sensor.yaml"],
        "camera_field": [f"../../{LOGS}/camera_field.yaml"],
        "camera_field_marks": [f"../../{LOGS}/camera_field_marks.csv"],
        "camera_marks": [f"../../{LOGS}/camera_marks.csv"],
        "mark_points": [f"../../{LOGS}/mark_points.csv"],
        "grid_images": [f"../../{LOGS}/calibration/images/*.png"],
        "grid": [f"../../{LOGS}/calibration/grid_1.yaml"],
        "panel_images": [f"../../{LOGS}/panels/images"],
        "panels": [f"../../{LOGS}/panels/images.csv"],
    }
    (house.root / f"config/campaigns/{name}.yaml").write_text(
        yaml.safe_dump(
            {"campaign": {**twin["campaign"], "id": name, "title": "A basin"}, "logs": {"light_sheet": sheet}}
        )
    )


def test_errors_against_the_truth_are_what_the_sigmas_say(hall):
    table = pd.read_csv(hall.root / TRUTH).set_index("what")
    depths = table[table.index.str.startswith("depth")]
    rest = table.drop(depths.index)
    assert set(rest.index) >= {"camera_z", "laser_x", "laser_y", "laser_z", "laser_omega", "laser_kappa"}
    # Gaussian: one of 16 values lies beyond 4 once in 1000 seeds
    assert rest["normalised"].abs().max() < 4.0, rest
    # One observation: some ten of them are independent. The guard is
    # tests/accuracy/test_light_sheet_truth.py, each row over many seeds.
    low, high = band(10)
    assert low < (rest["normalised"] ** 2).mean() < high
    # a class of depth has one common error and more: chi with one degree of freedom, 99.9 % lie below
    assert len(depths) == 4
    assert (depths["normalised"] < 3.3).all(), depths
    assert depths["normalised"].max() > 0.01
    # P3 and P4: a tenth of a millimetre in mid-range, here with a quarter of the pixels
    assert depths["sigma"].max() < 0.2


def test_no_number_has_moved_unseen(hall):
    assert moved_since_kept(hall.root / f"results/{NAME}") == []


def test_the_interior_orientation_comes_from_the_marker_field(hall):
    """With its whole covariance, from the pictures to the calibrated sensor."""
    base = hall.root / f"results/{NAME}/triangulation"
    lens, sensor = (read_calibration(base / name) for name in ("camera_interior.yaml", "sensor.yaml"))
    (block,) = (b.name for b in lens.blocks)
    for mine, theirs in zip(sensor.block(block), lens.block(block), strict=True):
        assert_allclose(mine, theirs, rtol=1e-9, atol=1e-18)
    table = pd.read_csv(hall.root / TRUTH).set_index("what")
    joint = table.loc["interior orientation jointly"]
    assert joint["n"] == 9
    # One observation, as the root of a mean. The guard is tests/lightsheet/calibrate/test_lens.py, over many
    # seeds.
    low, high = np.sqrt(band(9))
    assert low < joint["normalised"] < high
    report = json.loads((base / "camera_interior.json").read_text())
    # a quarter of the pixels: 0.002 mm of 12 mm, half of P4's 0.004
    assert report["sigma_over_constant"]["over_published"] < 0.8


def test_panels_are_measured_beside_the_published_ones(hall):
    table = pd.read_csv(hall.root / f"results/{NAME}/triangulation/panels.csv")
    assert sorted(table["depth_mm"].round(1)) == sorted(PUBLISHED)
    assert table["published_std_mm"].tolist() == [0.21, 0.21, 0.34, 0.15]
    # Gaussian, four panels with one calibration: beyond 3.5 once in 1000 seeds
    assert (table["mean_mm"].abs() < 3.5 * np.hypot(table["predicted_mm"], table["sigma_mm"])).all()
    assert (table["n"] > 400).all()


def test_what_was_dropped_is_counted(hall):
    base = hall.root / f"results/{NAME}/triangulation"
    report = json.loads((base / "calibration.json").read_text())
    counts = pd.read_csv(base / "calibration/line_counts.csv")
    lines = report["line_points"]
    dropped = {key: n for key, n in report["dropped"].items() if "ends" not in key}
    assert lines["used"] + lines["rejected"] + sum(dropped.values()) == counts["points"].sum()
    assert report["pairs"]["used"] >= 8


def test_a_second_call_has_nothing_to_do(hall):
    run = hall.snakemake("--dry-run", "--config", f"campaign={NAME}", "--", *TARGETS)
    assert "Nothing to be done" in run.stdout + run.stderr


def test_the_same_recordings_as_a_real_campaign_give_the_same_numbers(hall):
    real_campaign(hall, "hall")
    hall.snakemake("--config", "campaign=hall", "--", "results/hall/triangulation/panels.csv")
    mine, theirs = (
        read_calibration(hall.root / f"results/{name}/triangulation/sensor.yaml") for name in (NAME, "hall")
    )
    assert mine.source.twin
    assert not theirs.source.twin
    assert_array_equal(theirs.values, mine.values)
    assert_array_equal(theirs.sigmas, mine.sigmas)
    panels = [pd.read_csv(hall.root / f"results/{n}/triangulation/panels.csv") for n in (NAME, "hall")]
    pd.testing.assert_frame_equal(panels[1], panels[0])
    assert not (hall.root / "results/hall/accuracy").exists()
    sensor = read_sensor(hall.root / "results/hall/triangulation/sensor.yaml")
    assert sensor.camera.size_px == (512, 512)


@pytest.mark.slow
def test_all(hall):
    """Budget, scans, pictures and the page as well."""
    hall.snakemake("--config", f"campaign={NAME}")
    run = hall.snakemake("--dry-run", "--config", f"campaign={NAME}")
    assert "Nothing to be done" in run.stdout + run.stderr
    page = (hall.root / f"results/{NAME}/triangulation/index.html").read_text()
    assert "digital twin" in page
    assert page.count("data:image/png;base64") >= 8
    base = hall.root / f"results/{NAME}/triangulation"
    assert len(pd.read_csv(base / "budget.csv")) >= 8
    ledger = pd.read_csv(base / "ledger.csv")
    gone = ledger[ledger["verdict"] == "no result yet"]["source"].fillna("")
    # a renamed column or file must not turn a number into none
    assert not gone.str.contains("triangulation/|simulation/").any(), gone
