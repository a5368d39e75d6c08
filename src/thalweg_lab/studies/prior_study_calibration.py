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
from scipy.interpolate import CubicSpline

from thalweg.calibration.ins_lidar.adjustment import InsLidarSettings, calibrate
from thalweg.calibration.ins_lidar.checks import RunGates
from thalweg.calibration.ins_lidar.motion_search import MountRange
from thalweg.calibration.ins_lidar.pose_errors import PoseErrors
from thalweg.calibration.ins_lidar.run_points import RunPoints
from thalweg.core.errors import ThalwegError
from thalweg.core.types import ArrayB, ArrayF
from thalweg.lightsheet.calibration.grid import GridObject, parse_grid
from thalweg.lightsheet.calibration.settings import CalibrationSettings
from thalweg.lightsheet.calibration.sheet_calibration import fit_sheet
from thalweg.lightsheet.optics.light_path import sheet_in_water
from thalweg.lightsheet.optics.projection import project
from thalweg.lightsheet.optics.sensor import PARAMETERS, Sensor, paper_4
from thalweg.settings.sections.calibration import RunErrors
from thalweg_lab.base.random import drawn, generator
from thalweg_lab.studies import cone_runs
from thalweg_lab.studies.calibration_runs import NEAR

# ---------------------------------------------------------------- line points on a grid object by forward
# projection, with noise in pixels; no images
#
# For studies over many seeds: what a detector would report of the light sheet's line on the calibration
# object.


OBJECT: Final = """
thalweg_grid: 1
name: printed grid over a plate
levels:
  - {name: grid, pattern: grid, depth_mm: 60.0, sigma_mm: 0.05}
  - {name: plate, pattern: plate, depth_mm: 150.0, sigma_mm: 0.05}
grid:
  along_x: {bar_mm: 9.0, gap_mm: 5.0, gaps: 24}
  along_y: {bar_mm: 5.0, gap_mm: 100.0, gaps: 1}
"""


def grid_object(upper: float = 60.0, lower: float = 150.0) -> GridObject:
    """A printed grid over a plate, at depths in mm."""
    text = OBJECT.replace("depth_mm: 60.0", f"depth_mm: {upper}").replace(
        "depth_mm: 150.0", f"depth_mm: {lower}"
    )
    return parse_grid(text)


def line_points(
    sensor: Sensor,
    grid: GridObject,
    seed: int = 1,
    *,
    sigma_px: float = 0.15,
    axis: int = 0,
    every: int = 1,
    depths_mm: ArrayF | None = None,
    edge_shift_px: float = 0.0,
    sigma_edge_px: float = 0.0,
    phase_mm: float = 0.0,
    along: int = 0,
    rows_shared: int = 1,
    white_share: float = 0.0,
    tails: float | None = None,
) -> pd.DataFrame:
    """Row-wise (``axis`` 0: x measured) or column-wise points of the line on all levels.

    The bars of the grid lie along the world axis ``along``; a sub-beam hits the first level whose bar it
    meets. ``depths_mm`` are the true depths, those of the object if None. All ends reach ``edge_shift_px``
    too far out, each with its own error ``sigma_edge_px``; the object lies ``phase_mm`` aside. The noise of a
    point is the mean over ``rows_shared`` rows, as a patch's is, but for ``white_share`` of its variance; all
    errors are normal, or of Student's distribution with ``tails`` degrees of freedom and the same variance.
    """
    rng = generator(seed, "line points")
    depths = grid.depths_mm if depths_mm is None else depths_mm
    a = np.linspace(-1, 1, 6001) * sensor.sheet.half_angle_rad * 0.999
    beams = sheet_in_water(sensor, depths, a)
    reach = float(grid.gaps_x_mm[-1, 1] + grid.gaps_x_mm[0, 0])
    frames: list[pd.DataFrame] = []
    for k, points in enumerate(beams):
        xy = project(sensor, points)
        there = np.asarray(sensor.camera.inside(np.nan_to_num(xy, nan=-1.0)), dtype=np.bool_)
        seen = np.isfinite(xy).all(axis=1) & there
        if seen.sum() < 10:
            continue
        across, down = xy[seen, axis], xy[seen, 1 - axis]
        order = np.argsort(down)
        rows = np.arange(np.ceil(down.min() - 0.5), np.floor(down.max() - 0.5), every) + 0.5
        x = CubicSpline(down[order], across[order])(rows)
        place = beams[0][:, along]  # on the first level, growing or falling with the fan angle
        turn = 1 if place[-1] > place[0] else -1
        # with three levels the gaps look on the second and the third one in turn
        gaps = grid.gaps_x_mm if k == 0 else grid.gaps_x_mm[k - 1 :: len(depths) - 1]
        edges_mm = (gaps - reach / 2 - phase_mm).ravel()
        edges_fan = np.interp(edges_mm, place[::turn], a[::turn])
        inside = (edges_mm > place.min()) & (edges_mm < place.max())
        by_fan = np.argsort(a[seen])
        edges_row = np.interp(edges_fan, a[seen][by_fan], down[by_fan])
        # a piece reaches as much too far as the edge is moved out of the light, into the dark
        into_gap = np.tile([1.0, -1.0], len(gaps)) * (1 if k == 0 else -1)
        rising = np.sign(down[by_fan][-1] - down[by_fan][0]) * turn
        noise = sigma_edge_px * drawn(rng, len(edges_row), tails)
        edges_row = (edges_row + rising * into_gap * edge_shift_px + noise)[inside]
        is_start = np.tile([True, False], len(gaps))[inside]
        lit = _lit(rows, edges_row, is_start, rising, top=k == 0)
        shared = drawn(rng, len(x) + rows_shared - 1, tails)
        off = np.convolve(shared, np.full(rows_shared, 1 / np.sqrt(rows_shared)), mode="valid")
        if white_share > 0:
            off = np.sqrt(1 - white_share) * off + np.sqrt(white_share) * drawn(rng, len(x), tails)
        xy_px = np.stack([x + sigma_px * off, rows], axis=1)[lit]
        frames.append(pd.DataFrame({"x_px": xy_px[:, axis], "y_px": xy_px[:, 1 - axis], "level": k}))
    table = pd.concat(frames, ignore_index=True)
    table["sigma_px"] = max(sigma_px, 0.01)
    table["angle_rad"] = 0.0 if axis == 0 else np.pi / 2
    table["line"] = -1
    table["peak_dn"] = 200.0
    table["flags"] = 0
    # the detector knows nothing of levels: mix the rows
    order = rng.permutation(len(table))
    return table.iloc[order].reset_index(drop=True)


def _lit(rows: ArrayF, edges_row: ArrayF, is_start: ArrayB, rising: float, *, top: bool) -> ArrayB:
    """Which rows are lit: between the edges of gaps, or outside of them on top."""
    in_gap = np.zeros(len(rows), dtype=np.bool_)
    if len(edges_row) == 0:
        return ~in_gap if top else in_gap
    if not is_start[0]:  # the first gap begins outside of the fan
        in_gap |= rising * (rows - edges_row[0]) < 0
    starts = np.flatnonzero(is_start)
    for i in starts:
        low = rising * (rows - edges_row[i]) >= 0
        in_gap |= low & (rising * (rows - edges_row[i + 1]) < 0) if i + 1 < len(edges_row) else low
    return ~in_gap if top else in_gap


# ---------------------------------------------------------------- prior study calibration


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
