"""Difference of the heights of two epochs in cells of the map, with its standard deviation."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from thalweg.core import ArrayF
from thalweg.deformation.foreign import SurfaceDifference, read_difference
from thalweg.figures import SIGMA_MAP, count, raster_maps, styled
from thalweg.figures.accuracy import DISTANCE_MAP, round_above
from thalweg.figures.deformation.maps import SCALE_SHARE, signed


@styled
def height_difference(pairs: Sequence[tuple[str, SurfaceDifference]], *, title: str) -> Figure:
    """Difference and standard deviation of each pair, in coordinates of the map."""
    every = np.concatenate([found.raster.height_m.ravel() for _, found in pairs])
    known = np.abs(every[np.isfinite(every)])
    limit = 100 * round_above(max(float(np.percentile(known, SCALE_SHARE)), 1e-3))
    sigmas = np.concatenate([found.sigma_m[np.isfinite(found.sigma_m)] for _, found in pairs])
    most = 100 * round_above(max(float(np.percentile(sigmas, SCALE_SHARE)), 1e-3)) if len(sigmas) else 1.0
    raster = pairs[0][1].raster
    (west, north), (wide, tall) = raster.corner_m, raster.cell_m * raster.height_m.shape[::-1]
    of_difference = {"cmap": DISTANCE_MAP, "norm": Normalize(-limit, limit)}
    of_sigma = {"cmap": SIGMA_MAP, "norm": Normalize(0.0, most)}
    figure, axes = raster_maps(
        f"{title}, n = {count(len(known))} cells",
        (west, west + wide, north - tall, north),
        [
            panel
            for _, found in pairs
            for panel in (
                (100 * found.raster.height_m, "difference of height / cm", of_difference),
                (100 * found.sigma_m, "standard deviation / cm", of_sigma),
            )
        ],
        crs="" if raster.frame is None else raster.frame.name,
    )
    for (name, found), one, two in zip(pairs, axes[::2], axes[1::2], strict=True):
        one.set_title(_words(name, 100 * found.raster.height_m))
        two.set_title(_of_sigma(100 * found.sigma_m))
    return figure


def _words(name: str, value_cm: ArrayF) -> str:
    use = value_cm[np.isfinite(value_cm)]
    low, high = (signed(end(use), 0) for end in (np.min, np.max))
    return f"epochs {name.replace('-', ' to ')}, n = {count(len(use))} cells, from {low} to {high} cm"


def _of_sigma(value_cm: ArrayF) -> str:
    use = value_cm[np.isfinite(value_cm)]
    return (
        f"standard deviation,\nmedian {np.median(use):.1f} cm" if len(use) else "standard deviation not known"
    )


def draw_height_difference(*, differences: list[Path], title: str) -> Figure:
    """Files ``dod_<pair>.tif`` -> maps of difference and standard deviation."""
    pairs = [(path.stem.rpartition("_")[2], read_difference(path)) for path in differences]
    return height_difference(pairs, title=f"Difference of heights: {title}")
