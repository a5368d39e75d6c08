"""Difference of the heights of two epochs in cells of the map, with its standard deviation."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from thalweg.core import ArrayF
from thalweg.deformation.foreign import SurfaceDifference, read_difference
from thalweg.figures import SIGMA_MAP, WIDTH_MM, count, marks_in_free_corners, new_figure, styled
from thalweg.figures.accuracy import DISTANCE_MAP, round_above
from thalweg.figures.deformation.maps import SCALE_SHARE, signed

_LEGEND_MM: Final = 36.0
"""Beside the panels: labels of the axis and the scale of colours."""
_LEAST_MM: Final = 34.0
_TALLEST_MM: Final = 160.0
"""Heights of a panel; one of a single row of cells holds the words of its axes."""


@styled
def height_difference(pairs: Sequence[tuple[str, SurfaceDifference]], *, title: str, twin: bool) -> Figure:
    """Difference and standard deviation of each pair, in coordinates of the map less a round number."""
    every = np.concatenate([found.raster.height_m.ravel() for _, found in pairs])
    known = np.abs(every[np.isfinite(every)])
    limit = 100 * round_above(max(float(np.percentile(known, SCALE_SHARE)), 1e-3))
    sigmas = np.concatenate([found.sigma_m[np.isfinite(found.sigma_m)] for _, found in pairs])
    most = 100 * round_above(max(float(np.percentile(sigmas, SCALE_SHARE)), 1e-3)) if len(sigmas) else 1.0
    raster = pairs[0][1].raster
    rows, columns = raster.height_m.shape
    shape = rows * raster.cell_m[1] / (columns * raster.cell_m[0])
    side_by_side = shape > 0.8
    across, down = (2, len(pairs)) if side_by_side else (1, 2 * len(pairs))
    panel_mm = float(np.clip(shape * (WIDTH_MM - _LEGEND_MM) / across, _LEAST_MM, _TALLEST_MM))
    beside_mm = 34.0 if side_by_side else 16.0  # scales of colours lie below panels that stand side by side
    figure = new_figure(
        down * (panel_mm + beside_mm) + 14.0, f"{title}, n = {count(len(known))} cells", twin=twin
    )
    panels = figure.subplots(down, across, squeeze=False).ravel()
    origin = np.floor(raster.corner_m / 100.0) * 100.0 - np.array([0.0, 100.0])
    looks = (
        ("difference", DISTANCE_MAP, Normalize(-limit, limit), "difference of height / cm", "both"),
        ("sigma", SIGMA_MAP, Normalize(0.0, most), "standard deviation / cm", "max"),
    )
    for i, (name, found) in enumerate(pairs):
        values = (100 * found.raster.height_m, 100 * found.sigma_m)
        for ax, value, (gid, colours, norm, label, ends) in zip(
            panels[2 * i : 2 * i + 2], values, looks, strict=True
        ):
            ax.imshow(
                value, extent=_box(found, origin), cmap=colours, norm=norm, interpolation="nearest", gid=gid
            )
            ax.set_aspect("equal")
            ax.set_title(_words(name, value) if gid == "difference" else _of_sigma(value))
            if gid == "difference" or not side_by_side:
                ax.set_ylabel(f"north of {origin[1]:.0f} m / m")
            figure.colorbar(
                ScalarMappable(norm, colours),
                ax=ax,
                location="bottom" if side_by_side else "right",
                extend=ends,
                shrink=0.9,
                label=label,
            )
            marks_in_free_corners(ax, found.raster.points_m()[:, :2] - origin)
    for ax in panels if side_by_side else panels[-1:]:
        ax.set_xlabel(f"east of {origin[0]:.0f} m / m")
    return figure


def _box(found: SurfaceDifference, origin: ArrayF) -> tuple[float, float, float, float]:
    """West, east, south, north of a raster."""
    rows, columns = found.raster.height_m.shape
    west, north = found.raster.corner_m - origin
    wide, tall = found.raster.cell_m * (columns, rows)
    return float(west), float(west + wide), float(north - tall), float(north)


def _words(name: str, value_cm: ArrayF) -> str:
    use = value_cm[np.isfinite(value_cm)]
    low, high = (signed(end(use), 0) for end in (np.min, np.max))
    return f"epochs {name.replace('-', ' to ')}, n = {count(len(use))} cells, from {low} to {high} cm"


def _of_sigma(value_cm: ArrayF) -> str:
    use = value_cm[np.isfinite(value_cm)]
    return (
        f"standard deviation, median {np.median(use):.1f} cm" if len(use) else "standard deviation not known"
    )


def draw_height_difference(*, differences: list[Path], title: str, twin: bool) -> Figure:
    """Files ``dod_<pair>.tif`` -> maps of difference and standard deviation."""
    pairs = [(path.stem.rpartition("_")[2], read_difference(path)) for path in differences]
    return height_difference(pairs, title=f"Difference of heights: {title}", twin=twin)
