"""Place of the echo sounder from soundings over a surveyed bed, on top of what a ruler says.

A sounding ``d`` along the vertical axis of the boat meets the bed ``h(east, north)``::

    x_wcs = x_wcs_ics + R_wcs_ics (l + (0, 0, d)),        up(x_wcs) - h(x_wcs) = 0

On a flat bed a shift of the lever arm in x or y changes nothing. On slopes it does, by the slope in the
direction in which the boat heads: one slope and one heading leave a shift along the slope and a shift in
height together. An offset in time moves the soundings along the track and so needs relief too. The ruler's
values are observations with their sigmas; a parameter counts as *observed* by the run if it would be
determined without them.

A constant error of the bed's heights, the error of the speed of sound, and the errors of the poses
(`thalweg.calibration.ins_lidar.pose_errors`) are unknowns with prior knowledge. A wide beam on a steep slope
returns the nearest point of its footprint, which is not modelled: use gentle relief or a narrow beam.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.ndimage import minimum_filter1d
from scipy.spatial import Delaunay, cKDTree

from thalweg.calibration.ins_lidar import BorderedNormals, Knots, PoseErrors, RunPoints, pose_rows
from thalweg.core import NMAD, ArrayB, ArrayF, CoverageError, GeometryError, Trajectory, root_mean_square
from thalweg.core.calibration import Calibration, Source, lever_block
from thalweg.ingest import pings_of as pings_of
from thalweg.settings.sections import EchoSounderFit

PARAMETERS: Final = ("x", "y", "z", "lag")
_BORDER: Final = (*PARAMETERS, "bed", "sound_speed")
_REJECT: Final = 3.5
_FLAT: Final = 0.03
"""Rms slope below which a bed counts as flat."""
_MAX_STEPS: Final = 20
_FEWEST: Final = 10

SMALLEST_RULER_M: Final = 1e-4
"""Sigma of a ruler that claims to have none."""
MISFIT: Final = 3.0
"""Rms of standardised residuals above which the soundings and the bed do not belong together."""
_NEIGHBOURS: Final = 9
"""Points of a plane, with the one itself."""
_AROUND_S: Final = 1.6
"""Velocities are smoothed over three seconds: soundings as near to a gap of the trajectory are left out."""


# ---------------------------------------------------------------- adjustment


@dataclass(frozen=True, slots=True, kw_only=True)
class Bed:
    """A surveyed bed as a triangulated surface.

    Parameters
    ----------
    points_wcs_m : (m, 3) surveyed points, or the vertices of a mesh.
    sigma_m : of a single height.
    sigma_datum_m : of all heights together.
    longest_edge_m : triangles with a longer edge are holes.

    Raises
    ------
    GeometryError : fewer than three points, or all on a line.
    """

    points_wcs_m: ArrayF
    sigma_m: float
    sigma_datum_m: float
    longest_edge_m: float = np.inf
    triangles: Delaunay = field(init=False, repr=False)

    def __post_init__(self) -> None:
        p = np.asarray(self.points_wcs_m, dtype=np.float64)
        if p.ndim != 2 or p.shape[1] != 3 or len(p) < 3 or np.linalg.matrix_rank(p[:, :2] - p[0, :2]) < 2:
            raise GeometryError(
                f"a bed of {len(p)} points", expected="at least three points that are not on one line"
            )
        object.__setattr__(self, "points_wcs_m", p)
        object.__setattr__(self, "triangles", Delaunay(p[:, :2]))

    def at(self, places_m: ArrayF) -> tuple[ArrayF, ArrayF, ArrayB]:
        """Height (n,), slope (n, 2) east and north, and whether there is a bed (n,), at places (n, 2)."""
        number = self.triangles.find_simplex(places_m)
        inside = number >= 0
        corners = self.points_wcs_m[self.triangles.simplices[np.maximum(number, 0)]]
        edges = corners[:, 1:] - corners[:, :1]
        longest = np.linalg.norm(np.roll(corners, 1, axis=1) - corners, axis=2).max(axis=1)
        inside &= longest <= self.longest_edge_m
        flat = np.where(inside[:, None, None], edges[:, :, :2], np.eye(2))
        slope = np.linalg.solve(flat, edges[:, :, 2:])[:, :, 0]
        height = corners[:, 0, 2] + np.sum(slope * (places_m - corners[:, 0, :2]), axis=1)
        return np.asarray(height), np.asarray(slope), np.asarray(inside)


@dataclass(frozen=True, slots=True, kw_only=True)
class EchoSettings:
    """How soundings are evaluated.

    Parameters
    ----------
    errors : of the poses.
    sigma_depth_m : noise of a sounding.
    sigma_lag_s : what is known of the time of the soundings against the trajectory.
    sigma_sound_speed : of the speed of sound, relative.
    max_sigma_lever_m, max_sigma_lag_s : a parameter that the run alone gives worse is not observed.
    """

    errors: PoseErrors
    sigma_depth_m: float = EchoSounderFit().sigma_depth_m
    sigma_lag_s: float = EchoSounderFit().sigma_lag_s
    sigma_sound_speed: float = EchoSounderFit().sigma_sound_speed
    max_sigma_lever_m: float = EchoSounderFit().max_sigma_lever_m
    max_sigma_lag_s: float = EchoSounderFit().max_sigma_lag_s


@dataclass(frozen=True, slots=True, kw_only=True)
class EchoSounder:
    """Place of the echo sounder.

    Parameters
    ----------
    lever_ics_m, cov_m2 : (3,), (3, 3) ruler and run together.
    lag_s, sigma_lag_s : what is to be added to the stamps of the soundings.
    cov_formal_m2 : (3, 3) if soundings erred independently and nothing else did; infinite where singular.
    sigma_run : by parameter, what the run alone gives.
    not_observed : by parameter, what was missing.
    n_used, n_rejected, n_outside : soundings used, blunders, and those outside the bed or the trajectory.
    sigma0 : size of the residuals in units of what is stated.
    """

    lever_ics_m: ArrayF
    cov_m2: ArrayF
    lag_s: float
    sigma_lag_s: float
    cov_formal_m2: ArrayF
    sigma_run: dict[str, float]
    not_observed: dict[str, str]
    n_used: int
    n_rejected: int
    n_outside: int
    sigma0: float

    @property
    def observed(self) -> tuple[str, ...]:
        """Parameters that the run determines by itself."""
        return tuple(name for name in PARAMETERS if name not in self.not_observed)


def estimate_echo_sounder(
    t_gps_s: ArrayLike,
    depth_m: ArrayLike,
    trajectory: Trajectory,
    bed: Bed,
    settings: EchoSettings,
    *,
    ruler_ics_m: ArrayLike,
    cov_ruler_m2: ArrayF,
    lever_ics_antenna_m: ArrayLike,
) -> EchoSounder:
    """Place of the echo sounder from soundings over a surveyed bed and a ruler.

    Parameters
    ----------
    t_gps_s, depth_m : (n,) soundings below the transducer.
    trajectory, bed : poses, and the surveyed bed in wcs.
    settings : accuracies and limits.
    ruler_ics_m, cov_ruler_m2 : (3,), (3, 3) the place by hand.
    lever_ics_antenna_m : (3,) by which the trajectory was made.

    Raises
    ------
    CoverageError : no soundings over the bed with poses.
    """
    depth, t = np.asarray(depth_m, dtype=np.float64), np.asarray(t_gps_s, dtype=np.float64)
    good = np.isfinite(depth) & (depth > 0)
    down = np.column_stack([np.zeros((good.sum(), 2)), depth[good]])
    stamps = t[good]
    points = RunPoints.on(trajectory, down, stamps)
    ruler = np.asarray(ruler_ics_m, dtype=np.float64)
    lever, lag = ruler.copy(), 0.0
    knots = Knots.over(float(points.t_gps_s[0]), float(points.t_gps_s[-1]), settings.errors)
    band, _ = knots.prior(settings.errors)
    prior = _prior(cov_ruler_m2, bed, settings)
    kept = np.ones(len(points), dtype=np.bool_)
    for _step in range(_MAX_STEPS):
        # poses of the corrected stamps; those at the ends of the trajectory may be lost
        found_at = RunPoints.on(trajectory, down, stamps + lag)
        if len(found_at) != len(points):
            kept = np.ones(len(found_at), dtype=np.bool_)
        points = found_at
        rows = _rows(points, bed, settings, lever, np.asarray(lever_ics_antenna_m, np.float64))
        here = rows.inside & kept
        if here.sum() < _FEWEST:
            raise CoverageError(
                f"{int(here.sum())} of {len(t)} soundings lie over the surveyed bed",
                expected=f"at least {_FEWEST} soundings over the bed, with poses",
                cure="Survey the bed where the boat sounds, or check that both are in the same heights",
            )
        normals = BorderedNormals.of(
            knots,
            points.t_gps_s[here],
            rows.border[here],
            rows.pose[here],
            -rows.misfit[here],
            1 / rows.variance[here],
        )
        # all but the place of linearisation is solved whole; the ruler is an observation of the lever arm
        offset = np.r_[ruler - lever, -lag, 0.0, 0.0]
        normals.rhs_border += prior @ offset
        normals.square += float(offset @ prior @ offset)
        found = normals.solve(band, prior)
        step = found.border[:4]
        lever, lag = lever + step[:3], lag + float(step[3])
        left = rows.misfit + rows.border @ found.border
        left += np.sum(rows.pose * knots.at(found.errors, points.t_gps_s), axis=1)
        scaled = np.abs(left) / np.sqrt(rows.variance)
        spread = max(1.0, NMAD * float(np.median(scaled[rows.inside])))
        before, kept = kept, scaled <= _REJECT * spread
        done = np.all(np.abs(step) < 0.01 * np.sqrt(np.diag(found.cov_border)[:4]))
        if done and np.array_equal(before, kept):
            break
    n = int(here.sum())
    sigma_run = _run_alone(normals, band, prior)
    missing = _missing(sigma_run, settings, rows.slope[here], points.heading_rad()[here])
    formal = normals.border[:3, :3]
    regular = np.linalg.cond(formal) < 1e12
    cov_formal: ArrayF = np.asarray(np.linalg.inv(formal)) if regular else np.full((3, 3), np.inf)
    return EchoSounder(
        lever_ics_m=lever,
        cov_m2=found.cov_border[:3, :3],
        lag_s=lag,
        sigma_lag_s=float(np.sqrt(found.cov_border[3, 3])),
        cov_formal_m2=cov_formal,
        sigma_run=sigma_run,
        not_observed=missing,
        n_used=n,
        n_rejected=int((rows.inside & ~kept).sum()),
        n_outside=len(t) - int(rows.inside.sum()),
        sigma0=float(np.sqrt(found.omega / max(n, 1))),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rows:
    """Linearised soundings: misfit (n,), its variance, derivatives (n, 6) by border and by pose, slope."""

    misfit: ArrayF
    variance: ArrayF
    border: ArrayF
    pose: ArrayF
    slope: ArrayF
    inside: ArrayB


def _prior(cov_ruler_m2: ArrayF, bed: Bed, settings: EchoSettings) -> ArrayF:
    """Inverse covariance (6, 6) of what is known of the border without the run."""
    out = np.zeros((6, 6))
    out[:3, :3] = np.linalg.inv(cov_ruler_m2)
    known = [settings.sigma_lag_s, max(bed.sigma_datum_m, 1e-6), max(settings.sigma_sound_speed, 1e-9)]
    out[range(3, 6), range(3, 6)] = 1.0 / np.square(known)
    return out


def _rows(p: RunPoints, bed: Bed, settings: EchoSettings, lever_m: ArrayF, antenna_ics_m: ArrayF) -> _Rows:
    """Heights of soundings, points (0, 0, depth) below the transducer, above the bed, with derivatives."""
    x = p.to_wcs(p.xyz_scs_m + lever_m)
    moving = p.velocity_wcs_mps + np.cross(p.rate_wcs_radps, x - p.position_wcs_m)
    height, slope, inside = bed.at(x[:, :2])
    g = np.column_stack([-slope, np.ones(len(x))])
    in_ics = np.einsum("nji,nj->ni", p.R_wcs_ics, g)
    along = in_ics[:, 2]
    border = np.column_stack(
        [in_ics, np.sum(g * moving, axis=1), -np.ones(len(x)), along * p.xyz_scs_m[:, 2]]
    )
    return _Rows(
        misfit=x[:, 2] - height,
        variance=(along * settings.sigma_depth_m) ** 2 + bed.sigma_m**2,
        border=border,
        pose=pose_rows(g, x - p.to_wcs(antenna_ics_m), p.R_wcs_ics),
        slope=slope,
        inside=inside,
    )


def _run_alone(normals: BorderedNormals, band: ArrayF, prior: ArrayF) -> dict[str, float]:
    """Sigma of each parameter from the run alone.

    Horizontal shifts and the lag: without the ruler for any coordinate. Height: with the ruler for x and y,
    because the vertical offset over a flat bed does not need them.
    """
    out: dict[str, float] = {}
    for name in PARAMETERS:
        weak = prior.copy()
        free = [2] if name == "z" else [0, 1, 2]
        free += [3] if name == "lag" else []
        for k in free:
            weak[k, :] = 0.0
            weak[:, k] = 0.0
            # 10 m, 10 s: as good as nothing, but solvable
            weak[k, k] = 1e-2
        cov = normals.solve(band, weak).cov_border
        out[name] = float(np.sqrt(cov[_BORDER.index(name), _BORDER.index(name)]))
    return out


def _missing(
    sigma_run: dict[str, float], settings: EchoSettings, slope: ArrayF, heading_rad: ArrayF
) -> dict[str, str]:
    """Parameters that the run does not determine, and what it lacks."""
    rms = float(np.sqrt(np.mean(np.sum(slope**2, axis=1))))
    turned = 1 - float(np.abs(np.mean(np.exp(1j * heading_rad))))
    if rms < _FLAT:
        why = f"relief is missing: the bed under the soundings is flat (rms slope {100 * rms:.1f} %)"
    elif turned < 0.1:
        why = "turns are missing: all soundings were made in nearly one heading"
    else:
        why = "more soundings over slopes in several headings are missing"
    limits = dict.fromkeys("xyz", settings.max_sigma_lever_m) | {"lag": settings.max_sigma_lag_s}
    reasons = {"z": "the poses' heights are not good enough for the vertical offset: record a longer run"}
    return {
        name: f"{name}: {reasons.get(name, why)}; the run alone gives {sigma:.3f} "
        + ("s" if name == "lag" else "m")
        for name, sigma in sigma_run.items()
        if sigma > limits[name]
    }


# ---------------------------------------------------------------- from tables and settings to the result as
# files


def settings_of(section: Mapping[str, Any], trajectory: Trajectory, t_gps_s: ArrayF) -> EchoSettings:
    """How soundings at times (n,) are evaluated.

    ``section`` is ``calibration.echo_sounder`` with ``errors``, the section ``calibration.run_errors``. Under
    banks and trees positions are worse than on an open field: where the trajectory states greater sigmas at
    the soundings, these count.
    """
    names = ("sigma_depth_m", "sigma_lag_s", "sigma_sound_speed", "max_sigma_lever_m", "max_sigma_lag_s")
    errors = PoseErrors.from_section(section["errors"])
    if t_gps_s.size:
        at = np.clip(np.searchsorted(trajectory.t_gps_s, t_gps_s), 0, len(trajectory.t_gps_s) - 1)
        stated = np.sqrt(np.mean(np.square(trajectory.sigma_position_m[at]), axis=0))
        errors = replace(errors, sigma_position_m=np.maximum(errors.sigma_position_m, stated))
    return EchoSettings(errors=errors, **{name: section[name] for name in names})


def bed_of(points_wcs_m: ArrayF, sigma_m: ArrayF, section: Mapping[str, Any], places_m: ArrayF) -> Bed:
    """The surface through surveyed points (n, 3) with sigmas (n,) of their heights.

    Noise of the heights makes slopes that are none, and slopes are what tells a horizontal shift: each height
    is that of a plane through its neighbourhood. Soundings over one triangle share the errors of its corners.
    The sigma of a height is therefore that of a point times the root of the number of soundings for each
    point that they touch.

    Parameters
    ----------
    points_wcs_m, sigma_m : the survey.
    section : ``calibration.echo_sounder``.
    places_m : (k, 2) where soundings meet the bed, roughly.
    """
    bed = Bed(
        points_wcs_m=_smoothed(points_wcs_m),
        sigma_m=root_mean_square(sigma_m),
        sigma_datum_m=section["sigma_datum_m"],
        longest_edge_m=section["longest_edge_m"],
    )
    over = places_m[bed.at(places_m)[2]]
    touched = np.unique(bed.triangles.simplices[bed.triangles.find_simplex(over)])
    shared = max(1.0, len(over) / max(touched.size, 1))
    return replace(bed, sigma_m=bed.sigma_m * float(np.sqrt(shared)))


def _smoothed(points_m: ArrayF) -> ArrayF:
    """Points (n, 3) with heights of planes through their nearest neighbours."""
    near = cKDTree(points_m[:, :2]).query(points_m[:, :2], k=min(_NEIGHBOURS, len(points_m)))[1]
    local = points_m[near]
    middle = local.mean(axis=1, keepdims=True)
    rows = np.concatenate([np.ones_like(local[..., :1]), local[..., :2] - middle[..., :2]], axis=2)
    plane = np.einsum("nij,nj->ni", np.linalg.pinv(rows), local[..., 2])
    here = np.column_stack([np.ones(len(points_m)), points_m[:, :2] - middle[:, 0, :2]])
    return np.column_stack([points_m[:, :2], np.sum(plane * here, axis=1)])


def places_of(trajectory: Trajectory, t_gps_s: ArrayF, depth_m: ArrayF, lever_ics_m: ArrayF) -> ArrayF:
    """East and north (k, 2) where soundings meet the bed, of those with a pose."""
    position, R, valid = trajectory.at(t_gps_s)
    down = np.column_stack([np.zeros((len(depth_m), 2)), depth_m])
    return np.asarray((position + np.einsum("nij,nj->ni", R, lever_ics_m + down))[valid, :2])


def soundings(depths: pd.DataFrame, trajectory: Trajectory) -> tuple[ArrayF, ArrayF, dict[str, int]]:
    """One depth a ping, where the trajectory has no gap nearby.

    Parameters
    ----------
    depths : table kind ``depth``.
    trajectory : of the same survey.

    Returns
    -------
    t_gps_s, depth_m : (n,).
    counts : ``rows`` of the table, those ``of_other_sentences``, ``without_time``, ``near_a_gap``, and
        ``taken``. Soundings before and after the trajectory count as near a gap.

    Raises
    ------
    InputError : the table is empty.
    """
    chosen, other = pings_of(depths)
    timed = chosen[np.isfinite(chosen["t_gps_s"])].drop_duplicates("t_gps_s").sort_values("t_gps_s")
    t = timed["t_gps_s"].to_numpy(np.float64)
    whole = _whole(trajectory)
    at = np.clip(np.searchsorted(trajectory.t_gps_s, t), 1, len(whole) - 1)
    first, last = trajectory.span()
    good = whole[at] & whole[at - 1] & (t >= first) & (t <= last)
    counts = {
        "rows": len(depths),
        "of_other_sentences": other,
        "without_time": len(chosen) - len(timed),
        "near_a_gap": int((~good).sum()),
        "taken": int(good.sum()),
    }
    return t[good], timed["depth_m"].to_numpy(np.float64)[good], counts


def _whole(trajectory: Trajectory) -> Any:
    """Epochs (n,) of a trajectory without a missing pose nearby."""
    step = float(np.median(np.diff(trajectory.t_gps_s)))
    size = 2 * max(round(_AROUND_S / step), 1) + 1
    return minimum_filter1d(trajectory.valid.astype(np.uint8), size, mode="nearest").astype(np.bool_)


def ruler_of(mount: Mapping[str, Any]) -> tuple[ArrayF, ArrayF]:
    """Lever arm (3,) of the echo sounder and its covariance (3, 3), of a campaign's mounts."""
    sigma = np.maximum(np.asarray(mount["sigma_lever_m"], dtype=np.float64), SMALLEST_RULER_M)
    correlation = mount.get("correlation")
    matrix = np.eye(3) if correlation is None else np.asarray(correlation, dtype=np.float64)
    return np.asarray(mount["lever_ics_m"], dtype=np.float64), np.outer(sigma, sigma) * matrix


def check_fit(found: EchoSounder) -> None:
    """Do the soundings fit the bed at all?

    Raises
    ------
    GeometryError : they do not, or most of them are blunders.
    """
    if found.sigma0 > MISFIT or found.n_rejected > found.n_used:
        raise GeometryError(
            f"the soundings miss the surveyed bed by {found.sigma0:.1f} times their sigmas; {found.n_used} "
            f"were used, {found.n_rejected} rejected",
            expected=f"at most {MISFIT:g} times, and few blunders",
            cure="Check that the heights of the bed are ellipsoidal, like the trajectory's; that the bed has "
            "not changed; and the time of the echo sounder's log",
        )


def echo_calibration(found: EchoSounder, *, run: str, twin: bool) -> Calibration:
    """The place as a calibration with the block ``echo_sounder``."""
    facts = {
        "method": "soundings over a surveyed bed, and ruler",
        "determined": [name for name in found.observed if name != "lag"],
        "ruler": [name for name in PARAMETERS[:3] if name in found.not_observed],
        "lag_s": round(found.lag_s, 6),
        "sigma_lag_s": round(found.sigma_lag_s, 6),
        "lag_determined": "lag" in found.observed,
    }
    block = replace(lever_block("echo_sounder", found.lever_ics_m), facts=facts)
    source = Source(
        run=run,
        method="soundings over a surveyed bed, and ruler",
        observations=found.n_used,
        sigma0=found.sigma0,
        twin=twin,
    )
    cov = (found.cov_m2 + found.cov_m2.T) / 2
    return Calibration(title="Echo sounder on the boat", blocks=(block,), cov=cov, source=source)


def write_report(
    path: Path, found: EchoSounder, ruler_ics_m: ArrayLike, cov_ruler_m2: ArrayF, counts: Mapping[str, int]
) -> None:
    """Which components the soundings determined, which they left to the ruler, and why (JSON)."""
    ruler, sigma_ruler = np.asarray(ruler_ics_m, dtype=np.float64), np.sqrt(np.diag(cov_ruler_m2))
    sigma, components = np.sqrt(np.diag(found.cov_m2)), {}
    for k, name in enumerate(PARAMETERS[:3]):
        components[name] = {
            "value_m": float(found.lever_ics_m[k]),
            "sigma_m": float(sigma[k]),
            "ruler_m": float(ruler[k]),
            "sigma_ruler_m": float(sigma_ruler[k]),
            "sigma_soundings_alone_m": _plain(found.sigma_run[name]),
            "determined": name in found.observed,
            "refused": found.not_observed.get(name, ""),
        }
    lag = {
        "value_s": found.lag_s,
        "sigma_s": found.sigma_lag_s,
        "sigma_soundings_alone_s": _plain(found.sigma_run["lag"]),
        "determined": "lag" in found.observed,
        "refused": found.not_observed.get("lag", ""),
    }
    report = {
        "lever_ics": components,
        "lag": lag,
        "determined": list(found.observed),
        "refused": list(found.not_observed.values()),
        "sigma0": found.sigma0,
        "soundings": {
            **counts,
            "used": found.n_used,
            "rejected": found.n_rejected,
            "outside_the_bed": found.n_outside,
        },
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")


def _plain(value: float) -> float | None:
    """A number that JSON has."""
    return float(value) if np.isfinite(value) else None
