"""What wrong presumptions of the errors do to sigmas, and what estimates mend of that, for all chains."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline
from scipy.stats import chi2

from thalweg.calibration.ins_lidar import (
    InsLidarSettings,
    MountRange,
    PoseErrors,
    RunGates,
    RunPoints,
    calibrate,
)
from thalweg.core import ArrayB, ArrayF, LocalFrame, Rigid, ThalwegError, Trajectory
from thalweg.ingest import LidarClock, LidarOptions
from thalweg.ingest.anpp import read_anpp
from thalweg.ingest.registry import lidar_reader
from thalweg.ingest.tracks import read_pos
from thalweg.lidar import error_model_of_log
from thalweg.lightsheet.calibration import CalibrationSettings, GridObject, fit_sheet, parse_grid
from thalweg.lightsheet.optics import PARAMETERS, Sensor, paper_4, project, sheet_in_water
from thalweg.navigation.camera import CloudSettings, camera_trajectory
from thalweg.navigation.fusion import FusionSettings
from thalweg.navigation.ins_gnss import ErrorModel, build_trajectory
from thalweg.settings.sections import RunErrors
from thalweg_lab.instruments import simulate_gnss, simulate_ins
from thalweg_lab.random_numbers import drawn, generator
from thalweg_lab.settings import TwinConfig
from thalweg_lab.studies import cone_runs
from thalweg_lab.studies.cone_runs import NEAR
from thalweg_lab.studies.outage import (
    FRAME,
    Recorded,
    VoyageSpec,
    errors_at,
    fuse,
    make_survey,
    pose_errors,
    unit_errors,
)
from thalweg_lab.studies.study import Result, Seed, Study, Tables
from thalweg_lab.studies.survey import Logs, log_settings, record, survey_settings
from thalweg_lab.truth import ratio_of_surveys
from thalweg_lab.voyage import Motion, Voyage

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
MODELS: Final = ("presumed", "estimated")
COLUMNS: Final = (
    "chain",
    "variant",
    "seed",
    "model",
    "quantity",
    "nees",
    "n",
    "coverage_95",
    "undetermined",
    "refused",
)
_SHEET: Final = ("laser_x_mm", "laser_y_mm", "laser_z_mm", "laser_omega_rad", "laser_kappa_rad")
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

SURVEY: Final[dict[str, Any]] = {
    "size": "tiny",
    "duration_s": 60.0,
    "boat": {"speed_mps": 1.5, "turn_rate_degps": 20.0},
    "ins": {"attitude_time_s": 20.0},
    "gnss": {"correlation_time_s": 10.0},
}
"""Section ``twin`` of the surveys: plants, stones, a building, mirror images; errors last as in T 2.2.1."""
BEAMS: Final[Mapping[str, Mapping[str, float]]] = MappingProxyType(
    {
        "component_150": {"sigma_component_m": 1 / 1.5},
        "component_67": {"sigma_component_m": 1.5},
        "divergence_half": {"divergence_mrad": 2.0},
        "divergence_double": {"divergence_mrad": 0.5},
    }
)
"""Variants of the lidar's noise: factors on the stated values; ``component_150``: truly 1.5 times stated."""

CHAINS: Final = ("fused", "fused_no_images", "camera")
QUANTITIES: Final[Mapping[str, slice]] = MappingProxyType(
    {"position": slice(0, 3), "attitude": slice(3, 6), "pose": slice(0, 6)}
)
DURATION_S: Final = 120.0
STEP_S: Final = 0.37
"""Between the moments that are judged: off the nodes too."""
GOAL: Final = (0.8, 1.25)
"""Mean normalised squares that count as right."""
SLOW_HEADING_DEG: Final = 0.3
SLOW_HEADING_TIME_S: Final = 300.0
STUDENT: Final = 3.0
WHITE: Final = 0.25
"""Share of white noise in the twin's positions, if nothing is said."""


@dataclass(frozen=True, slots=True)
class CalibrationVariant:
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


CALIBRATION_VARIANTS: Final[Mapping[str, CalibrationVariant]] = MappingProxyType(
    {
        "base": CalibrationVariant(),
        "times_fifth": CalibrationVariant(_times(0.2), {"rows_shared": 3}),
        "times_fivefold": CalibrationVariant(_times(5.0), {"rows_shared": 15}),
        "white_0": CalibrationVariant({"white_share": 0.0}, {"rows_shared": 7}),
        "white_60": CalibrationVariant({"white_share": 0.6}, {"rows_shared": 7, "white_share": 0.6}),
        "stated_half": CalibrationVariant(_sizes(2.0), {**_line(2.0), "sigma_edge_px": 2.0 * _EDGE_PX}),
        "stated_double": CalibrationVariant(_sizes(0.5), {**_line(0.5), "sigma_edge_px": 0.5 * _EDGE_PX}),
        "divergence_1_5_mrad": CalibrationVariant({"footprint_rad": FOOTPRINT_SHARE * 0.0015}, None),
        "divergence_3_mrad": CalibrationVariant({"footprint_rad": FOOTPRINT_SHARE * 0.003}, None),
        "heavy_tails": CalibrationVariant({"tails": 3.0}, {"tails": 3.0}),
        "heading_slow": CalibrationVariant({"slow_heading_deg": 0.3}, None),
        "component_150": CalibrationVariant({"noise_m": 1.5 * 0.0173}, _line(1.5)),
    }
)
"""Named as in `prior_study_navigation`. Rows of the light sheet that share their errors stand for its
correlation time: 1 is stated; the true are 3, 15 and 7."""


def run_calibration(variant: str, seed: int) -> pd.DataFrame:
    """Both calibrations of one seed, processed with the presumed and with the estimated model.

    Returns
    -------
    Columns ``chain``, ``variant``, ``seed``, ``model``, ``quantity``, ``nees`` (normalised square over the
    number ``n`` of components), ``n``, ``coverage_95`` (share of the components within 1.96 sigma),
    ``undetermined``: parameters that the survey cannot tell, where the width of the prior counts;
    ``refused``: why the calibration gave no result, with NaN for the numbers; else missing.
    """
    chosen = CALIBRATION_VARIANTS[variant]
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
        errors=STATED,
        search=MountRange(lever_m=0.0, angle_deg=0.0),
        gates_m=(0.12,),
        gates=RunGates(min_points_per_cone=40),
    )
    rows = []
    for model in MODELS:
        try:
            found = calibrate(
                at,
                survey.cones,
                survey.T_wcs_pcs,
                replace(how, estimate_errors=model == "estimated"),
                lever_ics_antenna_m=cone_runs.LEVER_ANTENNA_M,
                antenna=survey.antenna,
                start=NEAR,
            )
        except ThalwegError as refusal:
            rows.append(_refused("moving_boat", model, "mount", 6, refusal))
            continue
        error, cov = found.T_ics_scs.error_from(survey.true_mount), found.T_ics_scs.cov
        open_ = "" if found.processes is None else " ".join(found.processes.undetermined())
        parts = {"mount": range(6), "lever arm": range(3), "tilt": (3, 4), "heading": (5,)}
        rows += [
            _judged(error, cov, list(part))
            | {"chain": "moving_boat", "model": model, "quantity": name, "undetermined": open_}
            for name, part in parts.items()
        ]
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
    how = CalibrationSettings(least_gap_px=6.0, sigma_edge_px=_EDGE_PX)
    # what is held fixed, or known beforehand, errs by its sigma too: the covariance counts it
    rng = generator(seed, "object")
    drawn: dict[str, Any] = {
        "sigma_px": _SIGMA_PX,
        "sigma_edge_px": _EDGE_PX,
        "phase_mm": float(generator(seed, "phase").uniform(-7.0, 7.0)),
        "depths_mm": rng.multivariate_normal(grid.depths_mm, grid.cov_depths_mm2),
        "edge_shift_px": float(rng.normal(0.0, how.sigma_edge_shift_px)),
        **truth,
    }
    points = line_points(sensor, grid, seed, every=_ROWS, **drawn).assign(sigma_px=_SIGMA_PX)
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
            _judged(error, cov, list(part))
            | {"chain": "light_sheet", "model": model, "quantity": name, "undetermined": ""}
            for name, part in parts.items()
        ]
    return rows


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
        "chain": chain,
        "model": model,
        "quantity": quantity,
        "nees": np.nan,
        "n": n,
        "coverage_95": np.nan,
        "undetermined": "",
        "refused": str(refusal),
    }


def _judged(error: ArrayF, cov: ArrayF, at: list[int]) -> dict[str, Any]:
    """Normalised square and coverage of some components."""
    e, C = error[at], cov[np.ix_(at, at)]
    return {
        "nees": float(e @ np.linalg.solve(C, e)) / len(at),
        "n": len(at),
        "coverage_95": float(np.mean(np.abs(e) <= _NORMAL * np.sqrt(np.diag(C)))),
    }


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """How the instruments err otherwise than the processing presumes.

    Parameters
    ----------
    times : factor of the correlation times of attitude, velocity and positions.
    white_share : of the positions' variance.
    size : factor of all errors but mount and clock; the stated sigmas stay.
    student : positions' white noise, image poses and times have Student's distribution of 3 degrees.
    heading : ``constant``, ``slow`` (300 s) or no error that no sigma contains.
    """

    times: float = 1.0
    white_share: float = WHITE
    size: float = 1.0
    student: bool = False
    heading: str = ""

    def spec(self, duration_s: float) -> VoyageSpec:
        """The survey of the twin; with heavy tails white noise of the positions is not in it."""
        usual = VoyageSpec()
        slow = np.sqrt(1 - self.white_share) if self.student else 1.0
        ins = {
            "rate_hz": 10.0,
            "attitude_time_s": 20.0 * self.times,
            "velocity_time_s": 10.0 * self.times,
            "sigma_velocity_mps": 0.05 * self.size,
            **{f"sigma_{a}_deg": s * self.size for a, s in (("roll", 0.1), ("pitch", 0.1), ("heading", 0.2))},
        }
        gnss = {
            "rate_hz": 5.0,
            "correlation_time_s": 10.0 * self.times,
            "white_share": 0.0 if self.student else self.white_share,
            "sigma_m": tuple(float(s * self.size * slow) for s in (0.02, 0.02, 0.03)),
        }
        size = self.size
        return VoyageSpec(
            duration_s=duration_s,
            twin={"ins": ins, "gnss": gnss},
            jitter_s=usual.jitter_s * size,
            sigma_image_m=tuple(s * size for s in usual.sigma_image_m),  # type: ignore[arg-type]
            sigma_image_deg=tuple(s * size for s in usual.sigma_image_deg),  # type: ignore[arg-type]
            student=STUDENT if self.student else 0.0,
        )


VARIANTS: Final[Mapping[str, Variant]] = MappingProxyType(
    {
        "base": Variant(),
        "times_fifth": Variant(times=0.2),
        "times_fivefold": Variant(times=5.0),
        "white_0": Variant(white_share=0.0),
        "white_60": Variant(white_share=0.6),
        "stated_half": Variant(size=2.0),
        "stated_double": Variant(size=0.5),
        "heavy_tails": Variant(student=True),
        "heading_constant": Variant(heading="constant"),
        "heading_slow": Variant(heading="slow"),
    }
)


def run_ins(seed: int, folder: Path, variants: tuple[str, ...] = (*VARIANTS, *BEAMS)) -> pd.DataFrame:
    """All variants of one survey.

    Parameters
    ----------
    seed : of the survey.
    folder : for its logs, which are deleted again.
    variants : names of `VARIANTS` and `BEAMS`.

    Returns
    -------
    Rows as of `thalweg_lab.studies.prior_study.run_navigation`, chains ``ins`` and ``lidar_noise``.
    """
    logging.getLogger("thalweg").setLevel(logging.ERROR)
    settings = survey_settings(SURVEY, seed=seed)
    logs = record(settings, folder / f"prior_{seed}")
    clock = lidar_reader([logs.pcap], LidarOptions(**settings["lidar"])).scan().clock
    motion = Voyage(logs.twin, seed)
    rows = []
    for name in variants:
        about = {"chain": "ins" if name in VARIANTS else "lidar_noise", "variant": name, "seed": seed}
        if name in VARIANTS:
            stated, epochs = _trajectory(logs, VARIANTS[name], seed, motion)
            model = _error_model(logs, clock, stated, epochs, {})
            for kind, trajectory in zip(MODELS, (stated, model.apply(stated, _lever(logs))), strict=True):
                found = _against_truth(trajectory, motion)
                rows += [
                    {**about, "model": kind, "quantity": quantity, **judged(found, part)}
                    for quantity, part in QUANTITIES.items()
                ]
        else:
            stated, epochs = _trajectory(logs, VARIANTS["base"], seed, motion)
            model = _error_model(logs, clock, stated, epochs, BEAMS[name])
            ((key, factor),) = BEAMS[name].items()
            part = "component" if key == "sigma_component_m" else "footprint"
            for kind, taken in zip(MODELS, (1.0, model.estimates[part].predictive), strict=True):
                rows.append(
                    {
                        **about,
                        "model": kind,
                        "quantity": part,
                        "nees": (factor * taken) ** -2,
                        "n": 1,
                        "coverage_95": np.nan,
                    }
                )
    logs.remove()
    return pd.DataFrame(rows)


def _lever(logs: Logs) -> ArrayF:
    return np.asarray(logs.settings["mounts"]["antenna"]["lever_ics_m"], dtype=np.float64)


def _trajectory(logs: Logs, variant: Variant, seed: int, motion: Motion) -> tuple[Trajectory, ArrayF]:
    """Trajectory of instruments that err as the variant says, with the usual stated sigmas; its epochs."""
    twin, spec = logs.settings["twin"], variant.spec(SURVEY["duration_s"]).twin
    rates = {key: {"rate_hz": twin[key]["rate_hz"]} for key in ("ins", "gnss")}
    config = TwinConfig(**{**twin, **{k: {**twin[k], **spec[k], **rates[k]} for k in ("ins", "gnss")}})
    anpp, pos = logs.folder / "variant.anpp", logs.folder / "variant.pos"
    simulate_ins(config, seed, logs.frame, anpp, motion=motion)
    simulate_gnss(
        config,
        seed,
        logs.frame,
        logs.folder / "variant.sbp",
        pos,
        scene=logs.scene,
        motion=motion,
        lever_ics_antenna_m=logs.true_mounts["antenna"]["lever_ics_m"],
    )
    states, positions = _as_stated(
        variant, seed, read_anpp([anpp]).states, read_pos([pos]).positions, logs.frame
    )
    s = logs.settings
    keys = ("accept_fixes", "max_gap_s", "max_attitude_gap_s", "interpolation")
    trajectory, _ = build_trajectory(
        positions,
        states,
        logs.frame,
        lever_ics_antenna_m=_lever(logs),
        sigma_lever_m=s["mounts"]["antenna"]["sigma_lever_m"],
        sigma_attitude_rad=np.deg2rad([s["ins"][f"sigma_{a}_deg"] for a in ("roll", "pitch", "heading")]),
        **{key: s["orientation"][key] for key in keys},
    )
    return trajectory, positions["t_gps_s"].to_numpy()


def _as_stated(
    variant: Variant, seed: int, states: pd.DataFrame, positions: pd.DataFrame, frame: LocalFrame
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """States and positions with the usual stated sigmas, heavy-tailed noise and an error of the heading."""
    states, positions = states.copy(), positions.copy()
    for name in ("roll", "pitch", "heading"):
        states[f"sigma_{name}_rad"] /= variant.size
    sigmas = [f"sigma_{name}_m" for name in ("east", "north", "up")]
    positions[sigmas] /= variant.size * (np.sqrt(1 - variant.white_share) if variant.student else 1.0)
    if variant.student:
        noise = unit_errors(generator(seed, "heavy tails"), (len(positions), 3), STUDENT)
        place = frame.from_geodetic(positions["lat_deg"], positions["lon_deg"], positions["h_ell_m"])
        moved = place + np.sqrt(variant.white_share) * positions[sigmas].to_numpy() * noise
        lat, lon, height = frame.to_geodetic(moved)
        positions = positions.assign(lat_deg=lat, lon_deg=lon, h_ell_m=height)
    if variant.heading:
        states["heading_rad"] += slow_heading_rad(variant.heading, seed, states["t_gps_s"].to_numpy())
    return states, positions


def _error_model(
    logs: Logs, clock: LidarClock, stated: Trajectory, epochs_s: ArrayF, beam: Mapping[str, float]
) -> ErrorModel:
    """What the survey's lidar log says of the errors, with stated values of the beam times ``beam``."""
    s = logs.settings
    accuracy = {key: value * beam.get(key, 1.0) for key, value in s["lidar_accuracy"].items()}
    how = log_settings({**s, "lidar_accuracy": accuracy}, Rigid.from_mount(s["mounts"]["lidar"]))
    return error_model_of_log(
        lidar_reader([logs.pcap], LidarOptions(**s["lidar"])),
        clock,
        stated,
        how,
        positions_t_gps_s=epochs_s,
        lever_ics_antenna_m=_lever(logs),
        settings=s["orientation"]["error_model"],
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Processed:
    """Poses of a chain against the truth.

    ``error`` (k, 6) and ``cov`` (k, 6, 6) in wcs; ``facts`` what was estimated of its errors.
    """

    error: ArrayF
    cov: ArrayF
    facts: dict[str, Any] = field(default_factory=dict)


def _against_truth(trajectory: Trajectory, motion: Motion) -> Processed:
    first, last = trajectory.span()
    at = np.arange(first + 1.0, last - 1.0, STEP_S)
    position, R, inside = trajectory.at(at)
    return Processed(error=pose_errors(position, R, motion, at)[inside], cov=trajectory.cov_at(at)[inside])


def run_navigation(
    variant: str, seed: int, folder: Path | None = None, *, duration_s: float = DURATION_S
) -> pd.DataFrame:
    """Survey and process once.

    Parameters
    ----------
    variant : one of `VARIANTS`.
    seed : of the survey.
    folder : not needed, nothing is written; other chains of the study need one.
    duration_s : of the survey.

    Returns
    -------
    A row a chain, model and quantity: ``chain, variant, model, seed, quantity, nees`` (mean normalised square
    over its components, expected 1), ``n`` moments, ``coverage_95``.
    """
    # what neighbouring images differ by is no news here
    logging.getLogger("thalweg").setLevel(logging.ERROR)
    survey = survey_of(VARIANTS[variant], seed, duration_s)
    rows = []
    for model in MODELS:
        for chain, found in processed(survey, estimate=model == "estimated").items():
            about = {"chain": chain, "variant": variant, "model": model, "seed": seed}
            rows += [{**about, "quantity": name, **judged(found, part)} for name, part in QUANTITIES.items()]
    return pd.DataFrame(rows)


def survey_of(variant: Variant, seed: int, duration_s: float = DURATION_S) -> Recorded:
    """A survey whose logs state the sigmas that the processing is used to, whatever its errors are."""
    survey = make_survey(seed, variant.spec(duration_s))
    stated, images = 1.0 / variant.size, survey.images
    states, positions = _as_stated(variant, seed, survey.states, survey.positions, FRAME)
    images = replace(
        images, cov_pose_wcs=stated**2 * images.cov_pose_wcs, cov_next=stated**2 * images.cov_next
    ).with_times(images.t_gps_s, stated * images.sigma_t_s)
    return replace(survey, states=states, positions=positions, images=images)


def processed(survey: Recorded, *, estimate: bool) -> dict[str, Processed]:
    """The survey by all chains, with the defaults of a campaign file."""
    at = survey.motion.start_gps_s + np.arange(2.0, survey.motion.config.duration_s - 2.0, STEP_S)
    settings = FusionSettings(estimate_errors=estimate)
    out = {}
    for name, with_images in (("fused", True), ("fused_no_images", False)):
        fused = fuse(survey, settings, with_images=with_images)
        error, cov = errors_at(fused, survey.motion, at)
        out[name] = Processed(error=error, cov=cov, facts=fused.facts["errors"])
    by_camera = camera_trajectory(
        survey.images,
        survey.true_T_ics_ccs.with_cov(survey.T_ccs_ics.cov),
        CloudSettings(frames="bridge", estimate_errors=estimate),
        states=survey.states,
        sigma_attitude_rad=np.deg2rad([0.1, 0.1, 0.2]),
        max_attitude_gap_s=0.1,
    )
    position, R, inside = by_camera.trajectory.at(at)
    out["camera"] = Processed(
        error=pose_errors(position, R, survey.motion, at)[inside],
        cov=by_camera.trajectory.cov_at(at[inside]),
        facts=by_camera.facts["errors"],
    )
    return out


def table(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of many seeds by chain, variant, model and quantity.

    Columns ``chain, variant, model, quantity, seeds, nees, low, high`` (mean over the seeds and its band of
    95 %, by the spread between them), ``coverage_95``, ``right``, whether the mean lies within `GOAL`, and
    ``refused``, surveys whose processing refused a result and which are in no mean. With one seed there is
    no band.
    """
    out = []
    for keys, all_surveys in rows.groupby(["chain", "variant", "model", "quantity"], sort=False):
        part = all_surveys[all_surveys["nees"].notna()]
        n, nees = part["n"].to_numpy(np.float64), part["nees"].to_numpy(np.float64)
        mean = float(np.sum(n * nees) / n.sum()) if len(part) else np.nan
        low, high = np.nan, np.nan
        if len(part) > 1:
            _, below, above, _ = ratio_of_surveys(n * nees, n)
            low, high = mean * below**2, mean * above**2
        out.append(
            {
                **dict(zip(("chain", "variant", "model", "quantity"), keys, strict=True)),
                "seeds": len(part),
                "nees": mean,
                "low": low,
                "high": high,
                "coverage_95": float(np.average(part["coverage_95"], weights=n)) if len(part) else np.nan,
                "right": GOAL[0] <= mean <= GOAL[1],
                "refused": len(all_surveys) - len(part),
            }
        )
    return pd.DataFrame(out)


def judged(found: Processed, part: slice) -> dict[str, float]:
    """Mean normalised square of some components of the pose, number of poses, share inside 95 %."""
    e, C = found.error[:, part], found.cov[:, part, part]
    k = e.shape[1]
    square = np.einsum("ni,ni->n", e, np.linalg.solve(C, e[:, :, None])[:, :, 0])
    return {
        "nees": float(np.mean(square) / k),
        "n": len(e),
        "coverage_95": float(np.mean(square <= chi2.ppf(0.95, k))),
    }


def slow_heading_rad(kind: str, seed: int, t_gps_s: ArrayF) -> ArrayF:
    """An error (n,) of the heading: constant with either sign, or a Gauss-Markov process of minutes."""
    rng = generator(seed, "slow heading")
    sigma = np.deg2rad(SLOW_HEADING_DEG)
    if kind == "constant":
        return np.full(len(t_gps_s), sigma * rng.choice([-1.0, 1.0]))
    keep = np.exp(-np.diff(t_gps_s, prepend=t_gps_s[0]) / SLOW_HEADING_TIME_S)
    unit = rng.standard_normal(len(t_gps_s))
    error = unit.copy()
    for k in range(1, len(error)):
        error[k] = keep[k] * error[k - 1] + np.sqrt(1 - keep[k] ** 2) * unit[k]
    return np.asarray(sigma * error)


# ---------------------------------------------------------------- the study


def _study_rows(seed: Seed) -> Tables:
    match seed.kind:
        case "ins":
            rows = run_ins(seed.number, seed.folder)
        case "navigation":
            found = [run_navigation(name, seed.number) for name in VARIANTS]
            rows = pd.concat(found, ignore_index=True)
        case _:
            found = [run_calibration(name, seed.number) for name in CALIBRATION_VARIANTS]
            rows = pd.concat(found, ignore_index=True)
    return {seed.kind: rows}


def _study_results(tables: Tables, files: Sequence[Path]) -> Mapping[str, Result]:
    return {"table": table(pd.concat(tables.values(), ignore_index=True))}


STUDY: Final = Study(rows=_study_rows, results=_study_results, float_format="%.4g")
