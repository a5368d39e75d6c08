"""Soundings and the kriged bed of the twin against its true bed."""

import itertools
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import ArrayB, ArrayF, LocalFrame, read_raster, root_mean_square
from thalweg_lab.river import Material, Scene

_FROM_M: Final = 50.0
"""Rays to the true bed start so high above the origin."""
DISTANCES_M: Final = (0.0, 0.5, 1.0, 2.0, 4.0, np.inf)
"""Classes of distance to the nearest datum."""
_OUTSIDE: Final = 1.96


def true_bed_m(scene: Path, places_m: ArrayF) -> ArrayF:
    """Height (n,) of the true bed, without stones, at places (n, 2) in wcs; NaN where there is none."""
    caster = Scene.read(scene).only(Material.BED).caster()
    above = np.column_stack([places_m, np.full(len(places_m), _FROM_M)])
    down = np.tile([0.0, 0.0, -1.0], (len(above), 1))
    hit = caster.cast(above, down).t_hit_m
    return np.where(np.isfinite(hit), _FROM_M - hit, np.nan)


def compare_riverbed(soundings: pd.DataFrame, bed: Path, scene: Path, frame: LocalFrame) -> pd.DataFrame:
    """Errors of used soundings and of the cells of the bed.

    Parameters
    ----------
    soundings : table of kind ``soundings``.
    bed : raster of `thalweg.bathymetry.BANDS`.
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
    return pd.DataFrame(rows, columns=["measure", "value", "n"])


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
