"""Soundings, the kriged bed and the terrain model of the twin against its true ground.

Soundings are judged ping by ping: errors by depth, and whether the reasons of those left out are right.
"""

import itertools
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy import ndimage

from thalweg.bathymetry import Banks, FlowLine, WaterLevel
from thalweg.core import ArrayB, ArrayF, CoverageError, LocalFrame, read_raster, root_mean_square
from thalweg.fusion import SOURCE_WORDS, Dtm, Source, seam_steps, separation_at
from thalweg_lab.river import Material, Scene

# ---------------------------------------------------------------- soundings, ping by ping

DEPTHS_M: Final = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0, np.inf)
"""Limits of the classes of depth below the transducer."""
SILENT: Final = ("no bottom", "turn")
"""Effects that leave no depth."""
LEAST_BLUNDER_SIGMAS: Final = 4.0
"""A depth that its faults displace by less than so many sigmas is none that a filter must find."""
_PARTS: Final = ("white", "slow", "common")
SAME_PING: Final = 0.45
"""A sounding and a ping are the same within this share of the time between pings."""


def compare_soundings(
    soundings: pd.DataFrame, stamp_gps_s: ArrayF, truth: pd.DataFrame
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Soundings against the places that their pings truly met.

    Parameters
    ----------
    soundings : table kind ``soundings``.
    stamp_gps_s : (m,) stamps of the pings chosen of the log, to which ``row`` of the soundings points.
    truth : table kind ``twin_soundings`` of the same log.

    Returns
    -------
    errors : a row a class of true depth, and first one for all: n, bias_m and rmse_m of the height of
        soundings that are used and were disturbed by nothing, predicted_white_m, predicted_slow_m,
        predicted_common_m (root mean squares), normalised_square with all three parts, outside_95 (share).
        Heights are compared where the beam's axis meets the bed, so errors of the place are in them on slopes
        alone.
    reasons : a row an effect: pings that it spoilt, left_out (for any reason) and their share; the last row
        ``none`` holds the soundings that nothing spoilt, and those of them that were left out nevertheless.

    Raises
    ------
    CoverageError : no sounding belongs to a ping of the truth.
    """
    known = truth.sort_values("stamp_gps_s", kind="stable").reset_index(drop=True)
    stamp = known["stamp_gps_s"].to_numpy(np.float64)
    # The processing removes what it believes to be lag and latency, so the stamps of the log tell.
    t = stamp_gps_s[soundings["row"].to_numpy(np.int64)]
    step = float(np.median(np.diff(stamp))) if len(stamp) > 1 else 0.0
    at = np.clip(np.searchsorted(stamp, t), 1, max(len(stamp) - 1, 1))
    at = np.where(t - stamp[at - 1] < stamp[at] - t, at - 1, at)
    same = np.isfinite(t) & (np.abs(t - stamp[at]) <= SAME_PING * step)
    if not same.any():
        raise CoverageError(
            f"none of {len(t):,} soundings belongs to one of {len(stamp):,} true pings",
            expected="soundings and truth of the same log",
            where="soundings of the twin",
        )
    found, ping = soundings[same].reset_index(drop=True), known.iloc[at[same]].reset_index(drop=True)
    sigma = np.sqrt(sum(found[f"sigma_{part}_m"].to_numpy(np.float64) ** 2 for part in _PARTS))
    effect = ping["effect"].to_numpy().astype(str)
    gross = np.abs(ping["blunder_m"].to_numpy(np.float64)) > LEAST_BLUNDER_SIGMAS * np.nan_to_num(sigma)
    faulty = np.isin(effect, SILENT) | ~np.isfinite(ping["stated_m"].to_numpy()) | gross
    used = found["used"].to_numpy(dtype=np.bool_)
    error = (found["up_m"] - ping["up_m"]).to_numpy(np.float64)
    quiet = used & ~faulty & (effect == "") & np.isfinite(error)
    depth = ping["depth_m"].to_numpy(np.float64)
    rows = [_row("all", error, sigma, found, quiet)]
    for low, high in pairwise(DEPTHS_M):
        inside = quiet & (depth >= low) & (depth < high)
        if inside.any():
            rows.append(_row(f"{low:g} to {high:g} m", error, sigma, found, inside))
    scores = []
    for name in np.unique(effect[faulty]):
        of = faulty & (effect == name)
        scores.append((name or "filters of the instrument", int(of.sum()), int((of & ~used).sum())))
    scores.append(("none", int((~faulty).sum()), int((~faulty & ~used).sum())))
    reasons = pd.DataFrame(scores, columns=["effect", "pings", "left_out"])
    return pd.DataFrame(rows), reasons.assign(share=reasons["left_out"] / reasons["pings"].clip(lower=1))


def _row(name: str, error: ArrayF, sigma: ArrayF, soundings: pd.DataFrame, of: ArrayB) -> dict[str, Any]:
    e, s = error[of], sigma[of]
    if not len(e):
        e, s = np.full(1, np.nan), np.ones(1)
    parts = {f"predicted_{part}_m": root_mean_square(soundings.loc[of, f"sigma_{part}_m"]) for part in _PARTS}
    return {
        "depth": name,
        "n": int(of.sum()),
        "bias_m": float(np.mean(e)),
        "rmse_m": root_mean_square(e),
        **parts,
        "normalised_square": float(np.mean((e / s) ** 2)),
        "outside_95": float(np.mean(np.abs(e) > 1.96 * s)),
    }


# ---------------------------------------------------------------- bed and terrain model

_FROM_M: Final = 50.0
"""Rays to the true bed start so high above the origin."""
DISTANCES_M: Final = (0.0, 0.5, 1.0, 2.0, 4.0, np.inf)
"""Classes of distance to the nearest datum."""
_OUTSIDE: Final = 1.96
GROUND: Final = (Material.BED, Material.SOIL, Material.GRASS, Material.GRAVEL)
"""What a terrain model shows; stones, plants and works stand on it."""
_SHORE_SOUGHT_M: Final = 3.0
_SHORE_STEP_M: Final = 0.02
"""The true shoreline is sought so far to both sides of a bank, in such steps."""
_SHORE_M: Final = 5.0
"""Banks within this of the bed are judged apart: farther away stand bushes, walls and houses."""


def true_bed_m(scene: Path, places_m: ArrayF, materials: tuple[Material, ...] = (Material.BED,)) -> ArrayF:
    """Height (n,) of the true bed or ground, without stones, at places (n, 2) in wcs; NaN: there is none."""
    caster = Scene.read(scene).only(*materials).caster()
    above = np.column_stack([places_m, np.full(len(places_m), _FROM_M)])
    down = np.tile([0.0, 0.0, -1.0], (len(above), 1))
    hit = caster.cast(above, down).t_hit_m
    return np.where(np.isfinite(hit), _FROM_M - hit, np.nan)


def compare_riverbed(
    soundings: pd.DataFrame, bed: Path, banks: Banks, level: WaterLevel, scene: Path, frame: LocalFrame
) -> pd.DataFrame:
    """Errors of used soundings, of the cells of the bed, and across the river of banks that were seen.

    Parameters
    ----------
    soundings : table of kind ``soundings``.
    bed : raster of `thalweg.bathymetry.BANDS`.
    banks, level : shorelines, and the water level that they are traced at.
    scene : the true scene.
    frame : of the world.

    Returns
    -------
    table : columns ``measure, value, n``; by distance to the nearest datum: rms, predicted sigma, mean of
        squared errors over predicted variances, share outside 95 %.
    """
    used = soundings[soundings["used"]]
    error = used["up_m"].to_numpy() - true_bed_m(scene, used[["east_m", "north_m"]].to_numpy())
    parts = used[["sigma_white_m", "sigma_slow_m", "sigma_common_m"]].to_numpy()
    sigma = np.linalg.norm(parts, axis=1)
    rows = _rows("soundings", error, sigma, np.isfinite(error))
    grid, bands, _ = read_raster(bed)
    height = bands["height_m"].ravel()
    known = np.isfinite(height)
    world = frame.from_map(np.column_stack([grid.centres_m()[known], height[known]]), grid.crs)
    error = world[:, 2] - true_bed_m(scene, world[:, :2])
    sigma = np.hypot(bands["sigma_m"].ravel()[known], bands["sigma_common_m"].ravel()[known])
    distance = bands["distance_m"].ravel()[known]
    there = np.isfinite(error)
    rows += _rows("bed", error, sigma, there)
    for low, high in itertools.pairwise(DISTANCES_M):
        of = there & (distance >= low) & (distance < high)
        words = (
            f"bed, {low:g} m to data and more" if high == np.inf else f"bed, {low:g} to {high:g} m to data"
        )
        rows += _rows(words, error, sigma, of)
    seen = banks.table[banks.table["seen"]]
    outward = _beyond_shore_m(seen, banks.line, level, scene)
    rows += _rows("banks", outward, seen["sigma_across_m"].to_numpy(np.float64), np.isfinite(outward))
    return pd.DataFrame(rows, columns=["measure", "value", "n"])


def _beyond_shore_m(banks: pd.DataFrame, line: FlowLine, level: WaterLevel, scene: Path) -> ArrayF:
    """How far (n,) banks lie landward of where the true ground meets the water; NaN: nowhere near."""
    s, n = banks["s_m"].to_numpy(np.float64), banks["n_m"].to_numpy(np.float64)
    off = np.arange(-_SHORE_SOUGHT_M, _SHORE_SOUGHT_M, _SHORE_STEP_M)
    places = line.to_map(np.repeat(s, len(off)), (n[:, None] + off).ravel())
    above = true_bed_m(scene, places, GROUND).reshape(len(s), -1) - level.at(s)[0][:, None]
    met = np.abs(np.diff(np.sign(above), axis=1)) > 0  # not where the ground ends, which is NaN
    nearest = np.where(met, off[:-1] + _SHORE_STEP_M / 2, np.inf)
    best = nearest[np.arange(len(s)), np.abs(nearest).argmin(axis=1)]
    return np.where(np.isfinite(best), -best * np.sign(n), np.nan)


def judge_dtm(*, dtm: Path, scene: Path, table: Path, campaign: dict[str, Any]) -> None:
    """Errors of the terrain model by source, and of its steps at seams: the model's step less the true one.

    Parameters
    ----------
    dtm : ``dtm.tif``.
    scene : the true scene.
    table : what is written: columns ``measure, value, n`` as of `compare_riverbed`; banks near the bed and
        farther away apart.
    campaign : its ``origin``.
    """
    model, frame = Dtm.read(dtm), LocalFrame(**campaign["origin"])
    centres = model.centres_m().reshape(-1, 2)
    height = model.height_m.ravel() + separation_at(model.separation, centres)
    known = np.isfinite(height)
    world = frame.from_map(np.column_stack([centres[known], height[known]]), model.crs)
    error = np.full(len(height), np.nan)
    error[known] = world[:, 2] - true_bed_m(scene, world[:, :2], GROUND)
    there, sigma, source = np.isfinite(error), model.sigma_m.ravel(), model.source.ravel()
    away = ndimage.distance_transform_edt(model.source != int(Source.BED)) * model.cell_m
    shore = away.ravel() <= _SHORE_M
    rows = []
    for each in Source:
        of = there & (source == int(each))
        if each in (Source.BED, Source.FILLED):
            rows += _rows(SOURCE_WORDS[each], error, sigma, of)
        elif each is not Source.NONE:
            near = f"{SOURCE_WORDS[each]}, within {_SHORE_M:g} m of the bed"
            rows += _rows(near, error, sigma, of & shore)
            rows += _rows(f"{SOURCE_WORDS[each]}, farther away", error, sigma, of & ~shore)
    step, of_step, _ = seam_steps(replace(model, height_m=error.reshape(model.height_m.shape)))
    rows += _rows("steps at seams", step, of_step, np.isfinite(step))
    pd.DataFrame(rows, columns=["measure", "value", "n"]).to_csv(table, index=False)


def _rows(name: str, error: ArrayF, sigma: ArrayF, of: ArrayB) -> list[tuple[Any, ...]]:
    n = int(of.sum())
    if not n:
        return []
    e, s = error[of], sigma[of]
    return [
        (f"{name}: mean error, m", float(e.mean()), n),
        (f"{name}: root mean square error, m", root_mean_square(e), n),
        (f"{name}: root mean predicted variance, m", root_mean_square(s), n),
        (f"{name}: mean of squared error over variance", float(np.mean((e / s) ** 2)), n),
        (f"{name}: share outside 95 %", float(np.mean(np.abs(e) > _OUTSIDE * s)), n),
    ]
