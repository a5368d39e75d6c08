"""From tables and settings to an estimate of the echo sounder's place, and its result as files."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.ndimage import minimum_filter1d
from scipy.spatial import cKDTree

from thalweg.calibration.echo_sounder.adjustment import PARAMETERS, Bed, EchoSettings, EchoSounder
from thalweg.calibration.ins_lidar.pose_errors import PoseErrors
from thalweg.core.calibration.model import Block, Calibration, Source, lever_block
from thalweg.core.errors import GeometryError, InputError
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayF

SENTENCES: Final = ("DPT", "DBT", "ANPP53", "DBS")
"""Sentences that state the depth below the transducer, best first: one ping often gives several."""

SMALLEST_RULER_M: Final = 1e-4
"""Sigma of a ruler that claims to have none."""

MISFIT: Final = 3.0
"""Rms of standardised residuals above which the soundings and the bed do not belong together."""

_NEIGHBOURS: Final = 9
"""Points of a plane, with the one itself."""

_AROUND_S: Final = 1.6
"""Velocities are smoothed over three seconds: soundings as near to a gap of the trajectory are left out."""


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
        sigma_m=float(np.sqrt(np.mean(np.square(sigma_m)))),
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
    if not len(depths):
        raise InputError("no soundings", expected="a log of the echo sounder with depths")
    present = depths["sentence"].value_counts()
    # the best sentence that comes about as often as any other
    often = [name for name in SENTENCES if present.get(name, 0) >= 0.9 * present.max()]
    chosen = depths[depths["sentence"] == (often[0] if often else present.index[0])]
    timed = chosen[np.isfinite(chosen["t_gps_s"])].drop_duplicates("t_gps_s").sort_values("t_gps_s")
    t = timed["t_gps_s"].to_numpy(np.float64)
    whole = _whole(trajectory)
    at = np.clip(np.searchsorted(trajectory.t_gps_s, t), 1, len(whole) - 1)
    first, last = trajectory.span()
    good = whole[at] & whole[at - 1] & (t >= first) & (t <= last)
    counts = {
        "rows": len(depths),
        "of_other_sentences": len(depths) - len(chosen),
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
    place = lever_block("echo_sounder", found.lever_ics_m)
    facts = {
        "method": "soundings over a surveyed bed, and ruler",
        "determined": [name for name in found.observed if name != "lag"],
        "ruler": [name for name in PARAMETERS[:3] if name in found.not_observed],
        "lag_s": round(found.lag_s, 6),
        "sigma_lag_s": round(found.sigma_lag_s, 6),
    }
    block = Block(
        name=place.name, quantities=place.quantities, values=place.values, equation=place.equation,
        convention=place.convention, facts=facts,
    )  # fmt: skip
    source = Source(
        run=run, method="soundings over a surveyed bed, and ruler", observations=found.n_used,
        sigma0=found.sigma0, twin=twin,
    )  # fmt: skip
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
