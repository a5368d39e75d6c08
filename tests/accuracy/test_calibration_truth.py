"""Calibrations of the twin's boat against its true mounts."""

import numpy as np
import pytest

from thalweg.core import InputError, Rigid, rotation_opk
from thalweg.core.calibration import Calibration, Source, lever_block, pose_block
from thalweg_lab.truth import compare_calibration

LIDAR = {"omega_deg": 0.3, "phi_deg": -89.6, "kappa_deg": 0.2, "lever_ics_m": [-0.345, 0.004, -0.257]}
CAMERA = {"omega_deg": 90.4, "phi_deg": -0.2, "kappa_deg": 0.1, "lever_ics_m": [-0.251, -0.102, -0.176]}
ANTENNA = {"lever_ics_m": [0.102, -0.001, -0.451]}
TRUTH = {"lidar": LIDAR, "camera": CAMERA, "antenna": ANTENNA}
NOMINAL = np.array([0.1, 0.0, -0.45])


def pose(mount: dict) -> Rigid:
    angles = np.deg2rad([mount[f"{a}_deg"] for a in ("omega", "phi", "kappa")])
    return Rigid(R=rotation_opk(*angles), shift_m=np.array(mount["lever_ics_m"]))


def calibration(error: np.ndarray) -> Calibration:
    """A calibration whose lidar is off by an error, in an origin that the nominal antenna defines."""
    true = pose(LIDAR)
    seen = Rigid(R=true.R, shift_m=true.shift_m - ANTENNA["lever_ics_m"] + NOMINAL).moved(error)
    cov = np.diag([1e-6] * 3 + [1e-8] * 3)
    lidar, of_lidar = pose_block("lidar", seen.with_cov(cov))
    relative = pose(CAMERA).inverse() @ true
    pair, of_pair = pose_block("camera_lidar", relative.with_cov(cov))
    joint = np.zeros((15, 15))
    joint[3:9, 3:9], joint[9:, 9:] = of_lidar, of_pair
    return Calibration(
        title="boat",
        blocks=(lever_block("antenna", NOMINAL), lidar, pair),
        cov=joint,
        source=Source(run="yard", method="cones"),
    )


def test_a_right_calibration_has_no_error_wherever_its_origin_lies():
    table = compare_calibration(calibration(np.zeros(6)), TRUTH)
    assert set(table["block"]) == {"lidar", "camera_lidar"}
    # 1e-9: degrees and metres as float64, twice turned.
    assert table["estimated_minus_true"].abs().max() < 1e-9


def test_an_error_is_found_where_it_was_put_and_in_its_units():
    error = np.array([0.002, -0.001, 0.0005, 1e-4, -2e-4, 3e-4])
    table = compare_calibration(calibration(error), TRUTH).set_index(["block", "quantity"])
    lidar = table.loc["lidar"]
    got = lidar.loc[["x_m", "y_m", "z_m"], "estimated_minus_true"].to_numpy(float)
    np.testing.assert_allclose(got, error[:3], atol=1e-9)
    turned = lidar.loc[[f"rotation_{a}_deg" for a in "xyz"], "estimated_minus_true"].to_numpy(float)
    # 1e-6 degrees: second order of 3e-4 rad
    np.testing.assert_allclose(turned, np.rad2deg(error[3:]), atol=1e-6)
    assert lidar.loc["x_m", "normalised"] == pytest.approx(2.0)
    expected = float(np.sum(error[:3] ** 2) / 1e-6 + np.sum(error[3:] ** 2) / 1e-8) / 6
    assert lidar.loc["together", "normalised"] == pytest.approx(expected, rel=1e-3)


def test_a_truth_without_the_sensor_is_named():
    with pytest.raises(InputError, match="expected the true mount of the camera"):
        compare_calibration(calibration(np.zeros(6)), {"lidar": LIDAR, "antenna": ANTENNA})
