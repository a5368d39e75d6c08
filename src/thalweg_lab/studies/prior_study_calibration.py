"""Calibrations whose stochastic model is not what is stated: do the sigmas hold?

The processing starts from the published sizes, correlation times and white share of `STATED`, whatever the
generator used. Each survey is processed twice: *presumed*, with the stated values as if they were known, and
*estimated*, with the values that the survey itself shows, the stated ones being prior knowledge with a width.
The noise of the lidar's points is estimated in both: hundreds of residuals show it.

``moving_boat``: 150 s past six cones (`cone_runs`), as long as T 3.1.1; positions only twice a second, which
makes a run of seconds instead of minutes. ``light_sheet``: one picture of a printed grid over a plate
(`sheet_lines`), camera, window and levels without error, so that the noise of the line alone decides.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.calibration.ins_lidar.adjustment import InsLidarSettings, calibrate
from thalweg.calibration.ins_lidar.checks import RunGates
from thalweg.calibration.ins_lidar.motion_search import MountRange
from thalweg.calibration.ins_lidar.pose_errors import PoseErrors
from thalweg.calibration.ins_lidar.run_points import RunPoints
from thalweg.core.errors import ThalwegError
from thalweg.core.types import ArrayF
from thalweg.lightsheet.calibration.settings import CalibrationSettings
from thalweg.lightsheet.calibration.sheet_calibration import fit_sheet
from thalweg.lightsheet.optics.sensor import PARAMETERS, Sensor, paper_4
from thalweg.settings.sections.calibration import RunErrors
from thalweg_lab.base.random import generator
from thalweg_lab.studies import cone_runs
from thalweg_lab.studies.calibration_runs import NEAR
from thalweg_lab.studies.sheet_lines import grid_object, line_points

_GNSS_HZ: Final = 2.0

STATED: Final = replace(PoseErrors.from_section(RunErrors().model_dump()), epoch_s=1.0 / _GNSS_HZ)
"""What the processing assumes of the poses: the defaults of a campaign, with positions twice a second."""

FOOTPRINT_SHARE: Final = 0.177
"""Of the beam's diameter by which points scatter across it, see ``lidar.footprint_share``."""

_DURATION_S: Final = 150.0
_POINTS: Final = 60_000
_SIGMA_PX: Final = 0.15
_EDGE_PX: Final = 0.5
_ROWS: Final = 4
"""The line is measured in every so many rows of the picture."""

_NORMAL: Final = 1.959964


@dataclass(frozen=True, slots=True)
class Variant:
    """How the truth of a study differs from what is stated.

    ``boat``: fields of `cone_runs.RunSpec`; ``sheet``: arguments of `sheet_lines.line_points`; None: the
    chain knows no such error.
    """

    boat: Mapping[str, Any] | None = field(default_factory=dict)
    sheet: Mapping[str, Any] | None = field(default_factory=dict)


def _times(factor: float) -> dict[str, Any]:
    return {
        "position_time_s": STATED.position_time_s * factor,
        "attitude_time_s": STATED.attitude_time_s * factor,
    }


def _sizes(factor: float) -> dict[str, Any]:
    return {
        "sigma_position_m": tuple((STATED.sigma_position_m * factor).tolist()),
        "sigma_attitude_deg": tuple(np.rad2deg(STATED.sigma_attitude_rad * factor).tolist()),
    }


def _line(factor: float) -> dict[str, Any]:
    return {"sigma_px": _SIGMA_PX * factor}


VARIANTS: Final[Mapping[str, Variant]] = MappingProxyType({
    "base": Variant(),
    "times_fifth": Variant(_times(0.2), {"rows_shared": 3}),
    "times_fivefold": Variant(_times(5.0), {"rows_shared": 15}),
    "white_0": Variant({"white_share": 0.0}, {"rows_shared": 7}),
    "white_60": Variant({"white_share": 0.6}, {"rows_shared": 7, "white_share": 0.6}),
    "stated_half": Variant(_sizes(2.0), {**_line(2.0), "sigma_edge_px": 2.0 * _EDGE_PX}),
    "stated_double": Variant(_sizes(0.5), {**_line(0.5), "sigma_edge_px": 0.5 * _EDGE_PX}),
    "divergence_1_5_mrad": Variant({"footprint_rad": FOOTPRINT_SHARE * 0.0015}, None),
    "divergence_3_mrad": Variant({"footprint_rad": FOOTPRINT_SHARE * 0.003}, None),
    "heavy_tails": Variant({"tails": 3.0}, {"tails": 3.0}),
    "heading_slow": Variant({"slow_heading_deg": 0.3}, None),
    "component_150": Variant({"noise_m": 1.5 * 0.0173}, _line(1.5)),
})  # fmt: skip
"""Named as in `prior_study_navigation`. Rows of the light sheet that share their errors stand for its
correlation time: 1 is stated; the true are 3, 15 and 7."""

MODELS: Final = ("presumed", "estimated")
COLUMNS: Final = (
    "chain", "variant", "seed", "model", "quantity", "nees", "n", "coverage_95", "undetermined", "refused",
)  # fmt: skip


def run(variant: str, seed: int) -> pd.DataFrame:
    """Both calibrations of one seed, processed with the presumed and with the estimated model.

    Returns
    -------
    Columns ``chain``, ``variant``, ``seed``, ``model``, ``quantity``, ``nees`` (normalised square over the
    number ``n`` of components), ``n``, ``coverage_95`` (share of the components within 1.96 sigma),
    ``undetermined``: parameters that the survey cannot tell, where the width of the prior counts;
    ``refused``: why the calibration gave no result, with NaN for the numbers; else missing.
    """
    chosen = VARIANTS[variant]
    rows: list[dict[str, Any]] = []
    if chosen.boat is not None:
        rows += moving_boat(chosen.boat, seed)
    if chosen.sheet is not None:
        rows += light_sheet(chosen.sheet, seed)
    return pd.DataFrame([row | {"variant": variant, "seed": seed} for row in rows], columns=list(COLUMNS))


def moving_boat(
    truth: Mapping[str, Any], seed: int, *, duration_s: float = _DURATION_S, points: int = _POINTS
) -> list[dict[str, Any]]:
    """Rows of the mount of the lidar from a run about cones.

    Parameters
    ----------
    truth : fields of `cone_runs.RunSpec` that differ from what is stated.
    seed : of the run.
    duration_s, points : of the run.
    """
    spec = cone_runs.RunSpec(
        duration_s=duration_s,
        points=points,
        gnss_hz=_GNSS_HZ,
        **({**_times(1.0), **_sizes(1.0)} | dict(truth)),
    )
    survey = cone_runs.make_run(seed, spec)
    at = RunPoints.on(survey.trajectory, survey.xyz_scs_m, survey.t_gps_s)
    how = InsLidarSettings(
        errors=STATED, search=MountRange(lever_m=0.0, angle_deg=0.0), gates_m=(0.12,),
        gates=RunGates(min_points_per_cone=40),
    )  # fmt: skip
    rows = []
    for model in MODELS:
        try:
            found = calibrate(
                at, survey.cones, survey.T_wcs_pcs, replace(how, estimate_errors=model == "estimated"),
                lever_ics_antenna_m=cone_runs.LEVER_ANTENNA_M, antenna=survey.antenna, start=NEAR,
            )  # fmt: skip
        except ThalwegError as refusal:
            rows.append(_refused("moving_boat", model, "mount", 6, refusal))
            continue
        error, cov = found.T_ics_scs.error_from(survey.true_mount), found.T_ics_scs.cov
        open_ = "" if found.processes is None else " ".join(found.processes.undetermined())
        parts = {"mount": range(6), "lever arm": range(3), "tilt": (3, 4), "heading": (5,)}
        rows += [
            _judged(error, cov, list(part)) | {"chain": "moving_boat", "model": model, "quantity": name,
                                               "undetermined": open_}
            for name, part in parts.items()
        ]  # fmt: skip
    return rows


def light_sheet(truth: Mapping[str, Any], seed: int) -> list[dict[str, Any]]:
    """Rows of the light sheet from one picture of the grid object.

    Parameters
    ----------
    truth : arguments of `sheet_lines.line_points` that differ from what is stated.
    seed : of the picture.
    """
    sensor = paper_4()
    sensor = sensor.with_vector(sensor.vector(), cov=np.zeros_like(sensor.cov))
    grid = grid_object()
    phase = float(generator(seed, "phase").uniform(-7.0, 7.0))
    drawn: dict[str, Any] = {"sigma_px": _SIGMA_PX, "sigma_edge_px": _EDGE_PX, **truth}
    points = line_points(sensor, grid, seed, every=_ROWS, phase_mm=phase, **drawn).assign(sigma_px=_SIGMA_PX)
    how = CalibrationSettings(least_gap_px=6.0, sigma_edge_px=_EDGE_PX)
    rows = []
    for model in MODELS:
        try:
            found = fit_sheet(sensor, points, grid, replace(how, rescale=model == "estimated"))
        except ThalwegError as refusal:
            rows.append(_refused("light_sheet", model, "sheet", 5, refusal))
            continue
        error = _sheet_error(found.sensor, sensor)
        at = [found.names.index(name) for name in _SHEET]
        cov = found.cov[np.ix_(at, at)]
        parts = {"sheet": range(5), "laser": range(3), "normal": (3, 4)}
        rows += [
            _judged(error, cov, list(part)) | {"chain": "light_sheet", "model": model, "quantity": name,
                                               "undetermined": ""}
            for name, part in parts.items()
        ]  # fmt: skip
    return rows


_SHEET: Final = ("laser_x_mm", "laser_y_mm", "laser_z_mm", "laser_omega_rad", "laser_kappa_rad")


def _sheet_error(found: Sensor, true: Sensor) -> ArrayF:
    """Error (5,) of the laser's place and of the sheet's normal as changes of omega and kappa.

    Two fans in one plane may be turned against each other: only the normals are compared.
    """
    off = found.vector()[15:18] - true.vector()[15:18]
    normals = [s.sheet.R_lcs_las[:, 1] for s in (found, true)]
    J = np.empty((3, 2))
    for i, name in enumerate(_SHEET[3:]):
        x = found.vector()
        x[PARAMETERS.index(name)] += 1e-6
        J[:, i] = (found.with_vector(x).sheet.R_lcs_las[:, 1] - normals[0]) / 1e-6
    turn = np.linalg.lstsq(J, normals[0] - normals[1], rcond=None)[0]
    return np.concatenate([off, turn])


def _refused(chain: str, model: str, quantity: str, n: int, refusal: ThalwegError) -> dict[str, Any]:
    """Row of a calibration that refused the survey, as one does whose own checks contradict its sigmas."""
    return {
        "chain": chain, "model": model, "quantity": quantity, "nees": np.nan, "n": n, "coverage_95": np.nan,
        "undetermined": "", "refused": str(refusal),
    }  # fmt: skip


def _judged(error: ArrayF, cov: ArrayF, at: list[int]) -> dict[str, Any]:
    """Normalised square and coverage of some components."""
    e, C = error[at], cov[np.ix_(at, at)]
    return {
        "nees": float(e @ np.linalg.solve(C, e)) / len(at),
        "n": len(at),
        "coverage_95": float(np.mean(np.abs(e) <= _NORMAL * np.sqrt(np.diag(C)))),
    }
