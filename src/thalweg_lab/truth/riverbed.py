"""Soundings, the kriged bed and the terrain model of the twin against its true ground."""

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy import ndimage

from thalweg.core import ArrayB, ArrayF, LocalFrame, read_raster, root_mean_square
from thalweg.fusion import SOURCE_WORDS, Dtm, Source, seam_steps
from thalweg_lab.river import Material, Scene

_FROM_M: Final = 50.0
"""Rays to the true bed start so high above the origin."""
DISTANCES_M: Final = (0.0, 0.5, 1.0, 2.0, 4.0, np.inf)
"""Classes of distance to the nearest datum."""
_OUTSIDE: Final = 1.96
GROUND: Final = (Material.BED, Material.SOIL, Material.GRASS, Material.GRAVEL)
"""What a terrain model shows; stones, plants and works stand on it."""
_SHORE_M: Final = 5.0
"""Banks within this of the bed are judged apart: farther away stand bushes, walls and houses."""


def true_bed_m(scene: Path, places_m: ArrayF, materials: tuple[Material, ...] = (Material.BED,)) -> ArrayF:
    """Height (n,) of the true bed or ground, without stones, at places (n, 2) in wcs; NaN: there is none."""
    caster = Scene.read(scene).only(*materials).caster()
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
    height = model.height_m.ravel() + model.separation_m
    known = np.isfinite(height)
    centres = model.centres_m().reshape(-1, 2)
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
