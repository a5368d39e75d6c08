"""A calibration of the twin's boat against where its sensors truly sit.

The antenna's lever arm *defines* the origin of ics in a calibration, because every position comes from the
antenna. The twin's own origin is another point of the boat if its antenna sits off the campaign's value; all
true places are therefore shifted to the calibration's origin before they are compared::

    l_sensor (as calibrated) = l_sensor (true) - l_antenna (true) + l_antenna (as calibrated)
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.stats import chi2

from thalweg.clocks.ties.model import ClockModel
from thalweg.core.calibration.model import Calibration
from thalweg.core.camera.model import Camera
from thalweg.core.errors import InputError
from thalweg.core.frames import rotation_opk
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF

QUANTITIES: Final = ("rotation_x_deg", "rotation_y_deg", "rotation_z_deg", "x_m", "y_m", "z_m")
COLUMNS: Final = ("block", "quantity", "estimated_minus_true", "sigma", "unit", "normalised")


def compare_calibration(calibration: Calibration, true_mounts: Mapping[str, Any]) -> pd.DataFrame:
    """Errors of each pose of a calibration, quantity by quantity, and of each pose as a whole.

    Parameters
    ----------
    calibration : with the block ``antenna`` and pose blocks ``lidar``, ``camera``, ``camera_lidar``, as it
        holds them.
    true_mounts : what `thalweg_lab.voyage.true_mounts.read_true_mounts` gives.

    Returns
    -------
    Columns `COLUMNS`. Errors of rotations are small rotation vectors about the axes of the target frame. The
    row ``together`` of a block holds the normalised square ``e^T C^-1 e / 6`` (expectation 1) and, as
    ``sigma``, half the width of its 95 % band.

    Raises
    ------
    InputError : the truth lacks a sensor that the calibration holds.
    """
    rows: list[tuple[Any, ...]] = []
    for name, truth in _true_poses(calibration, true_mounts).items():
        estimated = calibration.pose(name)
        error = estimated.error_from(truth)
        sigma = np.sqrt(np.diag(estimated.cov))
        order = [3, 4, 5, 0, 1, 2]
        for quantity, k in zip(QUANTITIES, order, strict=True):
            unit = 180.0 / np.pi if k >= 3 else 1.0
            ratio = error[k] / sigma[k] if sigma[k] > 0 else np.nan
            word = "deg" if k >= 3 else "m"
            rows.append((name, quantity, error[k] * unit, sigma[k] * unit, word, ratio))
        if (sigma > 0).all():
            low, high = (float(chi2.ppf(level, 6)) / 6 for level in (0.025, 0.975))
            square = float(error @ np.linalg.solve(estimated.cov, error)) / 6
            rows.append((name, "together", square, (high - low) / 2, "1", square))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def compare_interior(camera: Camera, truth: Mapping[str, float]) -> pd.DataFrame:
    """Errors of an interior orientation, in the columns of `compare_calibration`.

    Parameters
    ----------
    camera : as calibrated, with covariance.
    truth : true value of each of its parameters.
    """
    error = camera.parameters - np.array([truth[name] for name in camera.parameter_names])
    sigma = np.sqrt(np.diag(camera.cov))
    units = ["px" if name in ("fx", "fy", "cx", "cy") else "1" for name in camera.parameter_names]
    table = pd.DataFrame({
        "block": "camera interior", "quantity": camera.parameter_names, "estimated_minus_true": error,
        "sigma": sigma, "unit": units, "normalised": error / np.where(sigma > 0, sigma, np.nan),
    })  # fmt: skip
    return table[list(COLUMNS)]


def compare_clock(clock: ClockModel, *, start_gps_s: float, ahead_s: float, drift_ppm: float) -> pd.DataFrame:
    """Errors of a camera's clock, in the columns of `compare_calibration`.

    Parameters
    ----------
    clock : as found: GPS time minus stamp.
    start_gps_s : begin of the recording, at which the clock was ``ahead_s`` ahead of the time that its stamps
        are expressed in; it gains ``drift_ppm``.
    """
    true_s = -(ahead_s + drift_ppm * 1e-6 * (clock.reference_s - ahead_s - start_gps_s))
    sigma = np.sqrt(np.diag(clock.cov))
    error = np.array([clock.offset_s - true_s, clock.drift + drift_ppm * 1e-6])
    ratio = error / np.where(sigma > 0, sigma, np.nan)
    rows = [
        ("camera clock", "offset_s", error[0], sigma[0], "s", ratio[0]),
        ("camera clock", "drift_ppm", 1e6 * error[1], 1e6 * sigma[1], "ppm", ratio[1]),
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _true_poses(calibration: Calibration, mounts: Mapping[str, Any]) -> dict[str, Rigid]:
    shift = np.zeros(3)
    if "antenna" in calibration:
        shift = calibration.block("antenna")[0] - _sensor(mounts, "antenna")["lever_ics_m"]
    poses: dict[str, Rigid] = {}
    for name in ("lidar", "camera"):
        if name in calibration:
            poses[name] = _pose(_sensor(mounts, name), shift)
    if "camera_lidar" in calibration:
        # Both ends move with the origin: the relative orientation does not know of it.
        camera, lidar = (_pose(_sensor(mounts, name), np.zeros(3)) for name in ("camera", "lidar"))
        poses["camera_lidar"] = camera.inverse() @ lidar
    return poses


def _pose(mount: Mapping[str, Any], shift_m: ArrayF) -> Rigid:
    angles = np.deg2rad([mount[f"{a}_deg"] for a in ("omega", "phi", "kappa")])
    return Rigid(R=rotation_opk(*angles), shift_m=np.asarray(mount["lever_ics_m"], np.float64) + shift_m)


def _sensor(mounts: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    if name not in mounts:
        raise InputError(
            f"the truth holds {', '.join(sorted(mounts))}",
            expected=f"the true mount of the {name}",
            cure="Build the true mounts again with the rule simulate_mounts",
        )
    found: Mapping[str, Any] = mounts[name]
    return found
