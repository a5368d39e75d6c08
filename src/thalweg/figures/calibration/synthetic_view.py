"""What a camera and a coarse lidar would see of the calibration field (P2 Fig. 4)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Normalize
from matplotlib.figure import Figure

from thalweg.core import ArrayF32, ArrayU8, InputError
from thalweg.figures import HEIGHT_MAP, RING_MAP, count, new_figure, plural, scale_bar, styled
from thalweg.figures.calibration.field import Oblique
from thalweg.figures.calibration.tables import LIDAR_FRAME, checked, filled, points_of, read_figure_table

BRIGHTEST: Final = 0.35
DARKEST: Final = 1.0
"""Share of the colour that stays where a pixel is black and where it is white."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeightView:
    """A picture of the field that knows the height of each pixel.

    Parameters
    ----------
    height_m : (h, w) height in the field, NaN where there is no cone.
    shade : (h, w) uint8 brightness of the picture.
    """

    height_m: ArrayF32
    shade: ArrayU8


def read_height_view(path: Path) -> HeightView:
    """Read ``height_m`` and ``shade`` from an ``.npz`` file.

    Raises
    ------
    InputError : the file is missing or holds something else.
    """
    if not path.is_file():
        raise InputError("file not found", expected="heights and shades of a synthetic image", where=path)
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
            height, shade = data["height_m"], data["shade"]
    except (KeyError, ValueError, OSError, EOFError, BadZipFile) as error:
        raise InputError(f"no such picture ({error})", expected="height_m and shade", where=path) from error
    if height.ndim != 2 or shade.shape != height.shape or shade.dtype != np.uint8:
        raise InputError(
            f"height_m {height.shape}, shade {shade.shape} of {shade.dtype}",
            where=path,
            expected="two pictures of one size, the shade uint8",
        )
    return HeightView(height_m=height.astype(np.float32), shade=shade)


@styled
def synthetic_view(
    view: HeightView,
    lidar: pd.DataFrame,
    *,
    title: str = "Synthetic image and lidar frame",
    twin: bool = False,
) -> Figure:
    """Image with cones coloured by height, and a lidar frame coloured by scan line.

    Parameters
    ----------
    view : see `HeightView`.
    lidar : points on the cones, columns of ``lidar frame`` (see `thalweg.figures.calibration.tables`); others
        may stand in it with ``on_cone`` false and are drawn in grey.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : a column is missing.
    CoverageError : no point.
    """
    points = filled(checked(lidar, LIDAR_FRAME), "lidar point")
    on_cone = points["on_cone"].to_numpy(bool) if "on_cone" in points else np.ones(len(points), dtype=bool)
    rings = np.sort(points["ring"].unique())
    h, w = view.height_m.shape
    head = f"{title}, n = {count(int(on_cone.sum()))} points on cones in {plural(len(rings), 'scan line')}"
    figure = new_figure(min(165.0, 155.0 * h / w + 92.0), head, twin=twin)
    top, below = figure.subplots(2, 1, height_ratios=[h / w, 0.5])
    _image(figure, top, view)
    _frame(figure, below, points, on_cone, rings)
    return figure


def _image(figure: Figure, ax: Axes, view: HeightView) -> None:
    h, w = view.height_m.shape
    on = np.isfinite(view.height_m)
    limits = (float(view.height_m[on].min()), float(view.height_m[on].max())) if on.any() else (0.0, 1.0)
    norm = Normalize(*limits)
    shade = view.shade.astype(np.float64)[..., None] / 255.0
    rgb = np.repeat(0.35 + 0.65 * shade, 3, axis=2)
    rgb[on] = HEIGHT_MAP(norm(view.height_m[on]))[:, :3] * (BRIGHTEST + (DARKEST - BRIGHTEST) * shade[on])
    ax.imshow(rgb, extent=(0, w, h, 0), interpolation="antialiased", gid="image")
    ax.set_xticks([])
    ax.set_yticks([])
    ax.set_title(f"a: camera image, {w} × {h} pixels; cones coloured by height")
    figure.colorbar(ScalarMappable(norm, HEIGHT_MAP), ax=ax, label="height / m", shrink=0.85, pad=0.01)


def _frame(figure: Figure, ax: Axes, points: pd.DataFrame, on_cone: np.ndarray, rings: np.ndarray) -> None:
    view = Oblique(azimuth_deg=20.0, elevation_deg=35.0)
    xy, depth = view.apply(points_of(points))
    ring = np.searchsorted(rings, points["ring"].to_numpy())
    norm = BoundaryNorm(np.arange(len(rings) + 1) - 0.5, RING_MAP.N)
    ax.plot(
        xy[~on_cone, 0],
        xy[~on_cone, 1],
        ls="none",
        marker=".",
        ms=1.4,
        mew=0,
        color="0.65",
        rasterized=True,
        gid="others",
    )
    order = np.flatnonzero(on_cone)[np.argsort(depth[on_cone])]
    ax.scatter(
        xy[order, 0],
        xy[order, 1],
        c=ring[order],
        cmap=RING_MAP,
        norm=norm,
        s=4.0,
        lw=0,
        gid="frame",
        rasterized=True,
        zorder=3,
    )
    low, high = xy[on_cone].min(axis=0), xy[on_cone].max(axis=0)
    pad = max(0.06 * float((high - low).max()), 0.01)
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlim(low[0] - pad, high[0] + pad)
    ax.set_ylim(low[1] - 1.5 * pad, high[1] + pad)
    ax.axis("off")
    scale_bar(ax, span_m=float(high[0] - low[0] + 2 * pad), xy=(0.02, 0.03))
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


def draw_synthetic_view(*, view: Path, lidar_frame: Path, title: str, twin: bool) -> Figure:
    """Picture of the field with heights, and a coarse lidar frame -> figure of both."""
    return synthetic_view(
        read_height_view(view),
        read_figure_table(lidar_frame, LIDAR_FRAME),
        title=f"{title}: synthetic image and lidar frame",
        twin=twin,
    )
