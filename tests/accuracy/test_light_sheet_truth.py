"""Errors of a calibrated light-sheet sensor against the true one: gauge, units, consistency over seeds."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from tests.lightsheet.basin import Jobs, recorded
from thalweg.core import ArrayF, GeometryError, opk_of, rotation_y, rotation_z
from thalweg.lightsheet.optics import FLIP, PARAMETERS, Sensor, intersect, paper_3, paper_4
from thalweg_lab.truth import compare_sensor
from thalweg_lab.truth.calibration import LIGHT_SHEET_COLUMNS, aligned, turned_in_its_plane

SIGMA = {
    "camera_z_mm": 0.05,
    "camera_omega_rad": 3e-4,
    "fx": 0.3,
    "laser_y_mm": 0.1,
    "laser_kappa_rad": 2e-4,
    "glass_mm": 0.05,
    "n_water": 1e-3,
}


def known(sensor: Sensor) -> Sensor:
    """With independent sigmas of some parameters."""
    sigma = np.array([SIGMA.get(name, 0.0) for name in PARAMETERS])
    return sensor.with_vector(sensor.vector(), cov=np.diag(sigma**2))


def moved(sensor: Sensor, angle_rad: float, shift_mm: tuple[float, float]) -> Sensor:
    """Camera and laser turned about the window's normal and shifted along it."""
    Rz, shift = rotation_z(angle_rad), np.array([*shift_mm, 0.0])
    return replace(
        sensor,
        camera_origin_lcs_mm=Rz @ sensor.camera_origin_lcs_mm + shift,
        camera_angles_rad=np.array(opk_of(Rz @ sensor.R_lcs_ccs @ FLIP)),
        sheet=replace(
            sensor.sheet,
            origin_lcs_mm=Rz @ sensor.sheet.origin_lcs_mm + shift,
            angles_rad=np.array(opk_of(Rz @ sensor.sheet.R_lcs_las)),
        ),
    )


def changed(sensor: Sensor, **by: float) -> Sensor:
    x = sensor.vector()
    for name, value in by.items():
        x[PARAMETERS.index(name)] += value
    return sensor.with_vector(x)


# ---------------------------------------------------------------- gauge


@pytest.mark.parametrize("angle_deg", [0.5, 40.0, -170.0])
def test_turning_the_true_sensor_about_z_changes_nothing(angle_deg):
    found = known(changed(paper_4(), camera_z_mm=0.1, laser_y_mm=-0.2, n_water=1e-3))
    still = compare_sensor(found, paper_4())
    turned = compare_sensor(found, moved(paper_4(), np.deg2rad(angle_deg), (35.0, -80.0)))
    assert still["what"].tolist() == turned["what"].tolist()
    # rounding of angles of a radian, over sigmas of 1e-4
    np.testing.assert_allclose(turned["normalised"], still["normalised"], atol=1e-7)


def test_a_sensor_compared_with_itself_has_no_error():
    table = compare_sensor(known(paper_4()), moved(paper_4(), 1.0, (5.0, 5.0)))
    assert tuple(table.columns) == LIGHT_SHEET_COLUMNS
    # the solver of the depths stops at 1e-9 mm
    assert table["estimated_minus_true"].abs().max() < 1e-6


def test_depths_of_aligned_sensors_are_those_of_the_true_one():
    truth = paper_4()
    turned = moved(truth, 0.7, (20.0, 30.0))
    xy = np.random.default_rng(1).uniform(200, 1800, (200, 2))
    one, two = intersect(aligned(turned, truth), xy), intersect(truth, xy)
    np.testing.assert_array_equal(one.ok, two.ok)
    assert one.ok.sum() > 100
    np.testing.assert_allclose(one.depth_mm[one.ok], two.depth_mm[one.ok], atol=1e-8)


@pytest.mark.parametrize(("sensor", "held"), [(paper_4(), 1), (paper_3(), 0)], ids=["P4 phi", "P3 omega"])
def test_a_fan_turned_in_its_plane_is_the_same_sheet(sensor, held):
    sheet = sensor.sheet
    other = replace(sheet, angles_rad=np.array(opk_of(sheet.R_lcs_las @ rotation_y(0.03))))
    assert abs(other.angles_rad[held] - sheet.angles_rad[held]) > 0.02
    back = turned_in_its_plane(other, sheet, held)
    np.testing.assert_allclose(back.angles_rad, sheet.angles_rad, atol=1e-9)
    found = known(sensor)
    # a calibration cannot see that turn, so it is no error; kappa and omega are compared in one gauge
    table = compare_sensor(found, sensor.with_sheet(other)).set_index("what")
    assert (
        abs(table.loc["laser_kappa", "normalised"]) > 1e-3
    )  # both other angles are free here: nothing is turned
    one_held = found.with_vector(found.vector(), cov=_all_but(found, held))
    table = compare_sensor(one_held, sensor.with_sheet(other))
    laser = table[table["what"].str.startswith("laser")]
    assert laser["normalised"].abs().max() < 1e-4


def _all_but(sensor: Sensor, held: int) -> ArrayF:
    cov = sensor.cov.copy()
    for k in range(3):
        at = PARAMETERS.index("laser_omega_rad") + k
        cov[at, at] = 0.0 if k == held else 1e-8
    return cov


def test_a_turn_that_cannot_be_is_refused():
    sheet = replace(paper_4().sheet, angles_rad=np.array([0.4, 0.0, 0.0]))
    goal = replace(sheet, angles_rad=np.array([0.9, 0.0, 0.0]))
    with pytest.raises(GeometryError, match="laser_omega_rad of the other sensor"):
        turned_in_its_plane(sheet, goal, 0)


# ---------------------------------------------------------------- units


def test_errors_and_sigmas_have_their_units():
    by = {"camera_z_mm": 0.2, "fx": -0.6, "laser_kappa_rad": 1e-3, "n_water": 2e-3}
    table = compare_sensor(changed(known(paper_4()), **by), paper_4()).set_index("what")
    one = table.loc["camera_z"]
    assert (one["unit"], one["sigma"]) == ("mm", pytest.approx(0.05))
    assert one["estimated_minus_true"] == pytest.approx(0.2)
    assert one["normalised"] == pytest.approx(4.0)
    assert table.loc["fx", "unit"] == "px"
    assert table.loc["fx", "normalised"] == pytest.approx(-2.0)
    assert table.loc["laser_kappa", "unit"] == "deg"
    assert table.loc["laser_kappa", "estimated_minus_true"] == pytest.approx(np.rad2deg(1e-3))
    assert table.loc["laser_kappa", "sigma"] == pytest.approx(np.rad2deg(2e-4))
    assert table.loc["n_water", "unit"] == "1"
    assert "camera_x" not in table.index


def test_the_interior_orientation_is_judged_with_its_correlations():
    """Principal distance and a distortion, nearly wholly correlated, both off along the correlation."""
    truth = paper_4()
    sigma, rho = np.array([0.5, 1e-3]), -0.9
    fx, k1 = PARAMETERS.index("fx"), PARAMETERS.index("k1")
    cov = np.zeros((26, 26))
    cov[np.ix_([fx, k1], [fx, k1])] = np.outer(sigma, sigma) * np.array([[1.0, rho], [rho, 1.0]])
    found = changed(truth, fx=2 * sigma[0], k1=-2 * sigma[1])
    table = compare_sensor(found.with_vector(found.vector(), cov=cov), truth).set_index("what")
    joint = table.loc["interior orientation jointly"]
    # (2, -2) with that correlation: 8 / (1 + 0.9) in squares, of two degrees of freedom
    assert joint["estimated_minus_true"] == pytest.approx(np.sqrt(8 / 1.9))
    assert (joint["n"], joint["unit"]) == (2, "1")
    assert joint["normalised"] == pytest.approx(np.sqrt(8 / 1.9 / 2))
    # the principal point alone moves the image of every ray as much, in one of two coordinates
    cov = np.zeros((26, 26))
    cov[PARAMETERS.index("cx"), PARAMETERS.index("cx")] = 0.1**2
    moved_image = changed(truth, cx=0.3)
    table = compare_sensor(moved_image.with_vector(moved_image.vector(), cov=cov), truth).set_index("what")
    ray = table.loc["image of a ray"]
    assert ray["estimated_minus_true"] == pytest.approx(0.3 / np.sqrt(2))
    assert ray["sigma"] == pytest.approx(0.1 / np.sqrt(2))
    assert (ray["n"], ray["unit"]) == (128 * 128, "px")
    # without a sigma of the lens there is nothing to compare
    cov = np.zeros((26, 26))
    cov[PARAMETERS.index("n_water"), PARAMETERS.index("n_water")] = 1e-8
    wet = set(compare_sensor(truth.with_vector(truth.vector(), cov=cov), truth)["what"])
    assert not {"image of a ray", "interior orientation jointly"} & wet


def test_depths_are_beside_what_their_covariance_predicts():
    """Only the water is uncertain, and off by two sigmas: so is every depth."""
    cov = np.zeros((26, 26))
    k = PARAMETERS.index("n_water")
    cov[k, k] = 1e-8
    truth = paper_4()
    found = changed(truth, n_water=2e-4)
    table = compare_sensor(found.with_vector(found.vector(), cov=cov), truth)
    depths = table[table["what"].str.startswith("depth")]
    assert depths["what"].tolist() == [
        "depth 30 to 80 mm",
        "depth 80 to 130 mm",
        "depth 130 to 180 mm",
        "depth 180 to 230 mm",
    ]
    # first order of a step of 2e-4
    np.testing.assert_allclose(depths["normalised"], 2.0, rtol=1e-3)
    assert (depths["n"] > 500).all()
    assert (depths["unit"] == "mm").all()


# ---------------------------------------------------------------- consistency


@pytest.fixture(scope="module", params=[2, pytest.param(8, marks=pytest.mark.slow)])
def calibrated(request, tmp_path_factory):
    """Found and true sensors of some seeds, of more in the slow tests.

    Marker field, marks in air, rendered grid, lines, calibration.
    """
    pairs = []
    for seed in range(200, 200 + request.param):
        folder: Path = tmp_path_factory.mktemp(f"seed{seed}")
        basin = recorded(folder / "logs", seed, changes={"lens_pictures": 12})
        jobs = Jobs(folder / "out")
        jobs.calibrate_camera(basin)
        jobs.orient(basin, interior=jobs.out / "camera_interior.yaml")
        jobs.detect(basin, "calibration")
        pairs.append((jobs.calibrate(basin), basin.truth))
    return pairs


def test_errors_over_seeds_are_what_the_sigmas_say(calibrated):
    table = pd.concat([compare_sensor(found, truth) for found, truth in calibrated])
    square = (table["normalised"] ** 2).groupby(table["what"], sort=False).mean()
    n = len(calibrated)
    assert set(square.index) >= {
        "camera_z",
        "laser_x",
        "laser_y",
        "laser_z",
        "laser_omega",
        "laser_kappa",
        "glass",
        "interior orientation jointly",
        "image of a ray",
    }
    # twenty rows at 99.99 % each; a row holds at least one degree of freedom a seed
    low, high = chi2.ppf([0.00005, 0.99995], n) / n
    assert square.between(low, high).all(), square
    # all of them at once: rows are correlated, half of them count
    rows = len(square) // 2 * n
    low, high = chi2.ppf([0.0005, 0.9995], rows) / rows
    assert low < square.mean() < high, square


def test_joint_errors_over_seeds_are_what_the_covariance_says(calibrated):
    """With correlations: squares along the axes of the correlation matrix, none of them a null direction."""
    squares = []
    for found, truth in calibrated:
        rows = compare_sensor(found, truth)
        # rows of one parameter each
        rows = rows[rows["n"] == 1]
        names = [f"{what}{_ending(unit)}" for what, unit in zip(rows["what"], rows["unit"], strict=True)]
        at = [PARAMETERS.index(name) for name in names]
        sigma = np.sqrt(np.diag(found.cov)[at])
        values, axes = np.linalg.eigh(found.cov[np.ix_(at, at)] / np.outer(sigma, sigma))
        # one focal length in two axes, and a tilt in three angles, are no degrees of freedom
        kept = values > 1e-3
        squares += ((axes.T @ rows["normalised"].to_numpy())[kept] ** 2 / values[kept]).tolist()
    n = len(squares)
    low, high = chi2.ppf([0.0005, 0.9995], n) / n
    assert n > 12 * len(calibrated)
    assert low < np.mean(squares) < high


def _ending(unit: str) -> str:
    return {"mm": "_mm", "deg": "_rad"}.get(unit, "")
