"""Files of a series: read by the project's own readers, the truth apart, the same bytes again."""

import json

import cv2
import numpy as np
import pandas as pd
import pytest

from tests.lab.conftest import FRAME
from tests.lab.light_sheet.conftest import SEED
from thalweg.clocks import read_number_columns
from thalweg.clocks.ties import match_pulses
from thalweg.core import read_table
from thalweg.ingest.photos import read_image_stamps
from thalweg.lightsheet.calibration import read_grid
from thalweg.lightsheet.optics import read_sensor
from thalweg_lab.tank import calibration_plan, panel_plan, scan_plan, stepped_object
from thalweg_lab.tank.record import LINE_TRUTH, POSE_TRUTH, record

START = 3.0e8


@pytest.fixture(scope="module")
def scan(small, tmp_path_factory):
    folder = tmp_path_factory.mktemp("scan")
    plan = scan_plan(small.sensor, SEED, stepped_object(), lines=9, step_mm=4.0)
    record(
        plan,
        small.sensor,
        small.settings,
        SEED,
        folder,
        folder / "truth",
        FRAME,
        start_gps_s=START,
        six_dof=True,
    )
    return folder


def test_stamps_and_pulses_find_each_other(scan):
    stamps = read_image_stamps(scan / "images").table
    (pulses,) = read_number_columns(scan / "trigger_pulses.csv", ("t_gps_s",))
    match = match_pulses(stamps.t_device_s.to_numpy(), pulses)
    assert (match.images_without_pulse, match.pulses_without_image) == (0, 0)
    truth, _ = read_table(scan / "truth" / "poses.parquet", POSE_TRUTH)
    assert stamps.file.tolist() == truth.file.tolist()
    has = match.pulse >= 0
    assert pulses[match.pulse[has]] == pytest.approx(truth.t_gps_s.to_numpy()[has], abs=1e-6)
    assert -match.offset_s == pytest.approx(3.417, abs=0.005)  # jitter of 2 ms


def test_the_truth_lies_on_the_bright_line(scan):
    truth, _ = read_table(scan / "truth" / "lines.parquet", LINE_TRUTH)
    name = truth.file.iloc[0]
    image = cv2.imread(str(scan / "images" / name), cv2.IMREAD_UNCHANGED)
    assert image.shape == (512, 512)
    one = truth[(truth.file == name) & truth.visible & (truth.albedo > 0.3)]
    at = image[one.y_px.astype(int), one.x_px.astype(int)]
    aside = image[one.y_px.astype(int), np.clip(one.x_px.astype(int) + 15, 0, 511)]
    assert at.mean() > 2 * aside.mean()


def test_what_the_camera_gives_holds_no_truth(scan):
    files = {path.relative_to(scan).parts[0] for path in scan.rglob("*") if path.is_file()}
    assert files == {"images", "images.csv", "trigger_pulses.csv", "six_dof", "truth"}
    assert pd.read_csv(scan / "images.csv").columns.tolist() == ["file", "object"]
    marks = pd.read_csv(scan / "six_dof" / "marks.csv")
    assert marks.groupby("file").size().tolist() == [30] * 9
    assert (scan / "truth" / "stepped_object.ply").is_file()
    assert read_sensor(scan / "truth" / "sensor.yaml").camera.size_px == (512, 512)
    assert json.loads((scan / "truth" / "plan.json").read_text())["images"] == 9


def test_each_image_has_speckle_and_noise_of_its_own(small, tmp_path):
    plan = panel_plan(small.sensor, depths_mm=(125.0, 125.0))
    names = record(
        plan, small.sensor, small.settings, SEED, tmp_path, tmp_path / "truth", FRAME, start_gps_s=START
    )
    files = [str(tmp_path / "images" / name) for name in names]
    one, two = (cv2.imread(file, cv2.IMREAD_UNCHANGED).astype(float) for file in files)
    # shot noise, read noise and rounding, where nothing but daylight is; rounding of some 0.4 grey values
    # about one level is uniform within 15 % of the whole
    chip = small.settings.chip
    electrons = chip.full_well_electrons / 255
    variance = (two[:, 400:].mean() - chip.dark_dn) / electrons + (chip.read_electrons / electrons) ** 2
    assert (one - two)[:, 400:].var() == pytest.approx(2 * (variance + 1 / 12), rel=0.15)
    assert np.abs(one - two).max() > 30  # speckle


def test_the_grid_is_described_as_the_calibration_reads_it(small, tmp_path):
    plan = calibration_plan(small.sensor, SEED, positions=2)
    record(plan, small.sensor, small.clean, SEED, tmp_path, tmp_path / "truth", FRAME, start_gps_s=START)
    for k, depths in enumerate(plan.facts["depths_mm"]):
        grid = read_grid(tmp_path / f"grid_{k + 1}.yaml")
        # a calliper of 0.05 mm
        assert grid.depths_mm == pytest.approx(depths, abs=0.25)
        assert (grid.depths_mm != np.array(depths)).all()
        assert len(grid.gaps_x_mm) == 11
        assert np.diff(grid.gaps_x_mm, axis=1)[[0, 5], 0] == pytest.approx([3.5, 5.25])
