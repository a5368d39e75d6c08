"""What a camera and a coarse lidar would see of the calibration field (P2 Fig. 4)."""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Normalize
from matplotlib.figure import Figure

from thalweg.core import ArrayF32, ArrayU8, read_parquet
from thalweg.figures import HEIGHT_MAP, RING_MAP, count, new_figure, plural, robust_limits, scale_bar, styled
from thalweg.figures.calibration import Oblique, fit_axes, points_of

BRIGHTEST: Final = 0.35
DARKEST: Final = 1.0
"""Share of the colour that stays where a pixel is black and where it is white."""


@styled
def synthetic_view(
    height_m: ArrayF32, shade: ArrayU8, lidar: pd.DataFrame, *, title: str = "Synthetic image and lidar frame"
) -> Figure:
    """Image with cones coloured by height, and a lidar frame coloured by scan line.

    Parameters
    ----------
    height_m : (h, w) height in the field of each pixel, NaN where there is no cone.
    shade : (h, w) brightness of the picture.
    lidar : points on the cones, columns of ``lidar frame`` (see `thalweg.figures.calibration.tables`); others
        may stand in it with ``on_cone`` false and are drawn in grey.
    title : first words of the title.
    """
    on_cone = lidar["on_cone"].to_numpy(bool) if "on_cone" in lidar else np.ones(len(lidar), dtype=bool)
    rings = np.sort(lidar["ring"].unique())
    h, w = height_m.shape
    head = f"{title}, n = {count(on_cone.sum())} points on cones in {plural(len(rings), 'scan line')}"
    figure = new_figure(min(165.0, 155.0 * h / w + 92.0), head)
    top, below = figure.subplots(2, 1, height_ratios=[h / w, 0.5])
    _image(figure, top, height_m, shade)
    _frame(figure, below, lidar, on_cone, rings)
    return figure


def _image(figure: Figure, ax: Axes, height_m: ArrayF32, brightness: ArrayU8) -> None:
    h, w = height_m.shape
    on = np.isfinite(height_m)
    norm = Normalize(*robust_limits(height_m, 0.0, 100.0))
    shade = brightness.astype(np.float64)[..., None] / 255.0
    rgb = np.repeat(0.35 + 0.65 * shade, 3, axis=2)
    rgb[on] = HEIGHT_MAP(norm(height_m[on]))[:, :3] * (BRIGHTEST + (DARKEST - BRIGHTEST) * shade[on])
    ax.imshow(rgb, extent=(0, w, h, 0), interpolation="antialiased")
    ax.set_xticks([])
    ax.set_yticks([])
    ax.set_title(f"a: camera image, {w} × {h} pixels; cones coloured by height")
    figure.colorbar(ScalarMappable(norm, HEIGHT_MAP), ax=ax, label="height / m", shrink=0.85, pad=0.01)


def _frame(figure: Figure, ax: Axes, points: pd.DataFrame, on_cone: np.ndarray, rings: np.ndarray) -> None:
    view = Oblique(azimuth_deg=20.0, elevation_deg=35.0)
    xy, depth = view.apply(points_of(points))
    ring = np.searchsorted(rings, points["ring"].to_numpy())
    norm = BoundaryNorm(np.arange(len(rings) + 1) - 0.5, RING_MAP.N)
    ax.plot(*xy[~on_cone].T, ".", ms=1.4, mew=0, color="0.65", rasterized=True)
    order = np.flatnonzero(on_cone)[np.argsort(depth[on_cone])]
    ax.scatter(
        xy[order, 0],
        xy[order, 1],
        s=4.0,
        c=ring[order],
        cmap=RING_MAP,
        norm=norm,
        lw=0,
        rasterized=True,
        zorder=3,
    )
    width = fit_axes(ax, xy[on_cone])
    ax.axis("off")
    scale_bar(ax, span_m=width, xy=(0.02, 0.03))
    ax.set_title(f"b: lidar frame, coloured by scan line; the lowest of {len(rings)} is 0")
    bar = figure.colorbar(
        ScalarMappable(norm, RING_MAP),
        ax=ax,
        label="scan line",
        shrink=0.85,
        pad=0.01,
        ticks=np.arange(len(rings))[:: max(1, len(rings) // 8)],
    )
    bar.ax.tick_params(length=0)


def draw_synthetic_view(*, view: Path, lidar_frame: Path, title: str) -> Figure:
    """Picture of the field with heights, and a coarse lidar frame -> figure of both."""
    with np.load(view, allow_pickle=False) as data:
        height_m, shade = data["height_m"], data["shade"]
    frame = read_parquet(lidar_frame)
    return synthetic_view(height_m, shade, frame, title=f"{title}: synthetic image and lidar frame")
