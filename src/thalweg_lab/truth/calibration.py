"""A calibration of the twin's boat against where its sensors truly sit.

The antenna's lever arm *defines* the origin of ics in a calibration, because every position comes from the
antenna. The twin's own origin is another point of the boat if its antenna sits off the campaign's value; all
true places are therefore shifted to the calibration's origin before they are compared::

    l_sensor (as calibrated) = l_sensor (true) - l_antenna (true) + l_antenna (as calibrated)
"""

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.stats import chi2

from thalweg.calibration import read_camera
from thalweg.clocks import ClockModel
from thalweg.core import (
    ArrayF,
    Camera,
    GeometryError,
    InputError,
    Rigid,
    opk_of,
    root_mean_square,
    rotation_opk,
    rotation_y,
    rotation_z,
)
from thalweg.core.calibration import Calibration, read_calibration
from thalweg.lightsheet.optics import (
    FLIP,
    LASER,
    LENS,
    PARAMETERS,
    LightSheet,
    Sensor,
    intersect,
    read_sensor,
    sheet_derivatives,
)
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import read_true_mounts, start_gps_s
from thalweg_lab.yard_images import true_camera

QUANTITIES: Final = ("rotation_x_deg", "rotation_y_deg", "rotation_z_deg", "x_m", "y_m", "z_m")
BOAT_COLUMNS: Final = ("block", "quantity", "estimated_minus_true", "sigma", "unit", "normalised")

LIGHT_SHEET_COLUMNS: Final = ("what", "estimated_minus_true", "sigma", "unit", "normalised", "n")
DEPTHS_MM: Final = (30.0, 80.0, 130.0, 180.0, 230.0)
"""Borders of the classes of depth."""
_STEP_PX: Final = 16
_ROUNDING: Final = 1e-9
"""Sigmas below that (mm, rad, px) are zeros that went through a file."""
_TURNS: Final = 20


# ---------------------------------------------------------------- boat


def compare_calibration(calibration: Calibration, true_mounts: Mapping[str, Any]) -> pd.DataFrame:
    """Errors of each pose of a calibration, quantity by quantity, and of each pose as a whole.

    Parameters
    ----------
    calibration : with the block ``antenna`` and pose blocks ``lidar``, ``camera``, ``camera_lidar``, as it
        holds them.
    true_mounts : what `thalweg_lab.voyage.truth.read_true_mounts` gives.

    Returns
    -------
    Columns `BOAT_COLUMNS`. Errors of rotations are small rotation vectors about the axes of the target frame.
    The row ``together`` of a block holds the normalised square ``e^T C^-1 e / 6`` (expectation 1) and, as
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
    return pd.DataFrame(rows, columns=list(BOAT_COLUMNS))


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
    table = pd.DataFrame(
        {
            "block": "camera interior",
            "quantity": camera.parameter_names,
            "estimated_minus_true": error,
            "sigma": sigma,
            "unit": units,
            "normalised": error / np.where(sigma > 0, sigma, np.nan),
        }
    )
    return table[list(BOAT_COLUMNS)]


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
    return pd.DataFrame(rows, columns=list(BOAT_COLUMNS))


def judge_boat(
    *,
    boat: Path,
    camera_lidar: Path,
    camera: Path,
    clock: Path,
    true_mounts: Path,
    table: Path,
    twin: TwinConfig,
) -> None:
    """Errors of a boat's calibration, its camera and its clock from files.

    Parameters
    ----------
    boat, camera_lidar, camera, clock : calibrations.
    true_mounts : the truth.
    table : target, CSV.
    twin : with the true lens and clock of the camera.
    """
    mounts, lens = read_true_mounts(true_mounts), true_camera(twin.camera, "boat")
    parts = [
        compare_calibration(read_calibration(camera_lidar), mounts),
        compare_calibration(read_calibration(boat), mounts),
        compare_interior(
            read_camera(camera), dict(zip(lens.parameter_names, lens.parameters.tolist(), strict=True))
        ),
        compare_clock(
            ClockModel.read(clock),
            start_gps_s=start_gps_s(twin),
            ahead_s=twin.camera.clock_offset_s,
            drift_ppm=twin.camera.clock_drift_ppm,
        ),
    ]
    pd.concat(parts, ignore_index=True).to_csv(table, index=False, float_format="%.9g")


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


# ---------------------------------------------------------------- light-sheet sensor
#
# Nothing shows the heading and the place of the sensor's frame along the window: a calibration takes both
# from the design (`thalweg.lightsheet.calibration.camera_over_window`). The true sensor is therefore turned
# about the window's normal and shifted along it, so that both cameras stand alike; heights, tilts and depths
# stay.
# Nor does anything show a turn of the fan in its own plane, of which the calibration holds one angle fixed:
# the true fan is turned in its plane until it has the same one.


def aligned(truth: Sensor, like: Sensor) -> Sensor:
    """The true sensor, turned about Z and shifted along the window until its camera stands like another's."""
    M = like.R_lcs_ccs @ truth.R_lcs_ccs.T
    Rz = rotation_z(float(np.arctan2(M[1, 0] - M[0, 1], M[0, 0] + M[1, 1])))
    shift = like.camera_origin_lcs_mm - Rz @ truth.camera_origin_lcs_mm
    shift[2] = 0.0
    sheet = truth.sheet
    return replace(
        truth,
        camera_origin_lcs_mm=Rz @ truth.camera_origin_lcs_mm + shift,
        camera_angles_rad=np.array(opk_of(Rz @ truth.R_lcs_ccs @ FLIP)),
        sheet=replace(
            sheet,
            origin_lcs_mm=Rz @ sheet.origin_lcs_mm + shift,
            angles_rad=np.array(opk_of(Rz @ sheet.R_lcs_las)),
        ),
    )


def turned_in_its_plane(sheet: LightSheet, like: LightSheet, held: int) -> LightSheet:
    """The fan, turned in its own plane until one of its angles is that of another fan.

    Parameters
    ----------
    sheet, like : plane fans (``v`` = 0); a cone shows its turn.
    held : 0, 1, 2 for omega, phi, kappa.

    Raises
    ------
    GeometryError : no turn gives that angle.
    """
    goal, turn, step = float(like.angles_rad[held]), 0.0, 1e-4

    def off(a: float) -> float:
        """Angle left to the goal after a turn about the fan's own axis, radians."""
        angle = opk_of(sheet.R_lcs_las @ rotation_y(a))[held]
        return float(np.angle(np.exp(1j * (angle - goal))))

    for _ in range(_TURNS):
        here = off(turn)
        if abs(here) < 1e-12:
            return replace(sheet, angles_rad=np.array(opk_of(sheet.R_lcs_las @ rotation_y(turn))))
        slope = (off(turn + step) - off(turn - step)) / (2 * step)
        turn -= here / slope if abs(slope) > 1e-6 else np.inf
        if not abs(turn) < np.pi / 2:
            break
    raise GeometryError(
        f"no turn of the laser's fan in its plane gives {PARAMETERS[LASER][3 + held]} of the other sensor",
        expected="two calibrations of one sensor",
    )


def compare_sensor(found: Sensor, truth: Sensor) -> pd.DataFrame:
    """Errors of the parameters, and of the depths that follow from them.

    Parameters
    ----------
    found : calibrated, with covariance.
    truth : the true sensor; a tilted window is not known to `aligned`.

    Returns
    -------
    Columns `LIGHT_SHEET_COLUMNS`. A row for each parameter with a sigma (the camera's place along the window
    and one angle of the laser have none); ``interior orientation jointly``: root of the squared error of the
    camera's parameters in units of their covariance, beside that of their number; ``image of a ray``:
    difference of both cameras' images of the same rays, beside the predicted one; ``depth ... mm``: root mean
    square over every sixteenth pixel of a class of depth of the difference of both sensors' depths, beside
    that of the predicted sigma (with correlations), ``normalised`` their ratio.
    """
    true = aligned(truth, found)
    sigma = np.sqrt(np.maximum(np.diag(found.cov), 0.0))
    sigma[sigma < _ROUNDING] = 0.0
    error = found.vector() - _same_fan(true, found, sigma).vector()
    rows: list[tuple[str, float, float, str, float, int]] = []
    for k, name in enumerate(PARAMETERS):
        if sigma[k] <= 0.0:
            continue
        angle = name.endswith("_rad")
        factor = float(np.rad2deg(1.0)) if angle else 1.0
        if angle:
            error[k] = np.angle(np.exp(1j * error[k]))
        word = name.replace("_rad", "") if angle else name.removesuffix("_mm")
        unit = "deg" if angle else "mm" if name.endswith("_mm") else "px" if name[0] in "fc" else "1"
        rows.append((word, error[k] * factor, sigma[k] * factor, unit, error[k] / sigma[k], 1))
    return pd.DataFrame(rows + _lens(found, true) + _depths(found, true), columns=list(LIGHT_SHEET_COLUMNS))


def judge_light_sheet(*, sensor: Path, truth: Path, table: Path) -> None:
    """Errors of a calibrated light-sheet sensor from files; ``truth``: folder with the true one."""
    compared = compare_sensor(read_sensor(sensor), read_sensor(truth / "sensor.yaml"))
    compared.to_csv(table, index=False, float_format="%.6g")


def _same_fan(true: Sensor, found: Sensor, sigma: ArrayF) -> Sensor:
    """The true sensor with its fan turned as the calibration held it; as it is if no angle was held."""
    held = np.flatnonzero(sigma[LASER][3:] == 0.0)
    if len(held) != 1 or true.sheet.v != 0.0:
        return true
    return true.with_sheet(turned_in_its_plane(true.sheet, found.sheet, int(held[0])))


def _lens(found: Sensor, true: Sensor) -> list[tuple[str, float, float, str, float, int]]:
    sigma = np.sqrt(np.maximum(np.diag(found.cov)[LENS], 0.0))
    at = np.flatnonzero(sigma > 0.0)
    if not len(at):
        return []
    error = (found.camera.parameters - true.camera.parameters)[at]
    C = found.cov[LENS, LENS][np.ix_(at, at)]
    scale = np.outer(sigma[at], sigma[at])
    squared = float(error / sigma[at] @ np.linalg.solve(C / scale, error / sigma[at]))
    k = float(np.sqrt(len(at)))
    joint = ("interior orientation jointly", np.sqrt(squared), k, "1", np.sqrt(squared) / k, len(at))
    rays = found.camera.rays(_pixels(found))
    off = found.camera.project(rays) - true.camera.project(rays)
    J = found.camera.project_with_derivatives(rays)[2][:, :, at]
    ok = np.isfinite(off).all(axis=1) & np.isfinite(J).all(axis=(1, 2))
    rms = root_mean_square(off[ok])
    predicted = float(np.sqrt(np.einsum("nij,jk,nik->ni", J[ok], C, J[ok]).mean()))
    return [joint, ("image of a ray", rms, predicted, "px", rms / predicted, int(ok.sum()))]


def _pixels(sensor: Sensor) -> ArrayF:
    """Every sixteenth pixel (n, 2) in both directions."""
    width, height = sensor.camera.size_px
    grid = np.meshgrid(np.arange(_STEP_PX / 2, width, _STEP_PX), np.arange(_STEP_PX / 2, height, _STEP_PX))
    return np.stack(grid, axis=-1).reshape(-1, 2)


def _depths(found: Sensor, true: Sensor) -> list[tuple[str, float, float, str, float, int]]:
    xy = _pixels(found)
    d, other = sheet_derivatives(found, xy), intersect(true, xy)
    ok = d.points.ok & other.ok
    off = (d.points.depth_mm - other.depth_mm)[ok]
    J: ArrayF = d.depth_by_parameters[ok]
    variance = np.einsum("ni,ij,nj->n", J, found.cov, J)
    rows = []
    for low, high in pairwise(DEPTHS_MM):
        mine = (other.depth_mm[ok] >= low) & (other.depth_mm[ok] < high)
        if mine.any():
            rms, predicted = root_mean_square(off[mine]), np.sqrt(np.mean(variance[mine]))
            words = f"depth {low:g} to {high:g} mm"
            rows.append((words, float(rms), float(predicted), "mm", float(rms / predicted), int(mine.sum())))
    return rows
