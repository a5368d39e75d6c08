"""What a light-sheet sensor can measure: tables of X, Y and depth over the image, and the volume in the water
(P3 Fig. 5; P4 Fig. 11 and 12).
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PathCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from thalweg.core.types import ArrayF
from thalweg.figures.style import DEPTH_MAP, GREY, HALO, HEIGHT_MAP, legend_below, new_figure, styled
from thalweg.lightsheet.figures.views import DEPTH_LOOKS
from thalweg.lightsheet.optics.refracted_rays import Status
from thalweg.lightsheet.optics.sensor import Sensor
from thalweg.lightsheet.optics.volume import (
    DepthLine,
    PictureGrid,
    depth_lines,
    measurement_volume,
    picture_grid,
)

DEPTHS_MM: Final = (0.0, 50.0, 125.0, 250.0)
"""Reference depths of P4 Fig. 11 and 12."""

STATUS_LOOKS: Final = {
    Status.NO_SHEET: ("sheet not seen", "0.80", "////"),
    Status.ABOVE_WINDOW: ("sheet above the window", "0.92", "...."),
    Status.GRAZING: ("grazing", "0.7", "xxxx"),
    Status.TOTAL_REFLECTION: ("totally reflected", "0.6", "\\\\\\\\"),
    Status.OUTSIDE_LENS: ("outside the lens", "0.5", "++++"),
}


@styled
def measurement_volume_view(
    sensor: Sensor,
    depths_mm: Sequence[float] = DEPTHS_MM,
    *,
    step_px: int = 8,
    title: str = "Measurement volume",
    twin: bool = False,
) -> Figure:
    """Above: X, Y and depth of each pixel. Below: the border of the image and lines of equal depth in space.

    Parameters
    ----------
    sensor : any.
    depths_mm : of the lines; those that the sensor does not see are left out and named.
    step_px : of the tables.
    title : first words of the title.
    twin : true if the sensor is that of the digital twin.

    Raises
    ------
    GeometryError : no pixel sees the sheet in the water.
    """
    volume, grid = measurement_volume(sensor, step_px), picture_grid(sensor, step_px)
    lines = [line for line in depth_lines(sensor, depths_mm) if len(line.xy_px) > 1]
    missed = sorted(set(depths_mm) - {line.depth_mm for line in lines})
    size = volume.size_mm
    head = (
        f"{title}: {volume.depth_mm[1]:.0f} mm deep, {size[0]:.0f} mm x {size[1]:.0f} mm, "
        f"{100 * volume.share:.0f} % of the image see the sheet in the water"
    )
    figure = new_figure(150.0, head, twin=twin)
    axes = figure.subplots(2, 3, height_ratios=[1.35, 1.0])
    maps = (
        ("a: x", "x / mm", grid.xyz_lcs_mm[..., 0], HEIGHT_MAP),
        ("b: y", "y / mm", grid.xyz_lcs_mm[..., 1], HEIGHT_MAP),
        ("c: depth", "depth / mm", grid.depth_mm, DEPTH_MAP),
    )
    for k, (ax, (words, label, values, colours)) in enumerate(zip(axes[0], maps, strict=True)):
        _status(ax, grid)
        norm = Normalize(float(np.nanmin(values)), float(np.nanmax(values)))
        mesh = _edges(grid.x_px), _edges(grid.y_px)
        ax.pcolormesh(*mesh, np.ma.masked_invalid(values), cmap=colours, norm=norm, rasterized=True,
                      gid=f"map {'xyz'[k]}")  # fmt: skip
        _isolines(ax, lines, sensor)
        ax.set_title(words)
        ax.set(xlabel="column / px", ylabel="row / px" if k == 0 else "")
        ax.tick_params(labelleft=k == 0)
        figure.colorbar(
            ScalarMappable(norm, colours), ax=ax, label=label, location="bottom", pad=0.02, aspect=30
        )
    _views(axes[1], volume.border_lcs_mm, lines, sensor)
    legend_below(figure, axes[0, 0])
    if missed:
        words = ", ".join(f"{depth:g}" for depth in missed)
        axes[1, 0].set_xlabel(f"x / mm\nnot in the image: {words} mm")
    return figure


def _edges(centres: ArrayF) -> ArrayF:
    """Edges (n + 1,) of cells about centres (n,)."""
    inner = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[centres[0] - 0.5], inner, [centres[-1] + 0.5]])


def _status(ax: Axes, grid: PictureGrid) -> None:
    """Where a pixel has no point, and why."""
    x, y = _edges(grid.x_px), _edges(grid.y_px)
    ax.set_xlim(x[0], x[-1])
    ax.set_ylim(y[-1], y[0])
    ax.set_aspect("equal")
    for status, (words, colour, hatch) in STATUS_LOOKS.items():
        mine = grid.status == int(status)
        if not mine.any():
            continue
        if min(mine.shape) > 1 and not mine.all():
            drawn = ax.contourf(grid.x_px, grid.y_px, mine.astype(float), levels=[0.5, 1.5])
            paths = drawn.get_paths()
            drawn.remove()
            # plain paths: the artist of a contour cannot be hatched without a frame
            look = PathCollection(paths, facecolor=colour, edgecolor="0.55", linewidth=0.0, hatch=hatch)
            look.set_gid(status.name)
            ax.add_collection(look, autolim=False)
        ax.fill([], [], label=f"{words}: {100 * mine.mean():.0f} %", facecolor=colour,
                edgecolor="0.55", lw=0.0, hatch=hatch)  # fmt: skip


def _isolines(ax: Axes, lines: Sequence[DepthLine], sensor: Sensor) -> None:
    for k, line in enumerate(lines):
        colour, style, _ = DEPTH_LOOKS[k]
        ax.plot(*line.xy_px.T, color=colour, ls=style, lw=1.4, path_effects=HALO,
                label=f"{line.depth_mm:g} mm deep", gid=f"depth {line.depth_mm:g}")  # fmt: skip


def _views(axes: Sequence[Axes], border: ArrayF, lines: Sequence[DepthLine], sensor: Sensor) -> None:
    """Plan, view along y and view along x; depth counts downwards."""
    views = (("d: from above", 0, 1), ("e: along y", 0, 2), ("f: along x", 1, 2))
    names = ("x / mm", "y / mm", "depth / mm")
    ring = np.concatenate([border, border[:1]]).copy()
    ring[:, 2] = sensor.window.depth_mm(ring)
    # a border that leaves the sheet is not one line
    ring[1:][np.linalg.norm(np.diff(ring, axis=0), axis=1) > 15.0] = np.nan
    for ax, (words, i, j) in zip(axes, views, strict=True):
        ax.plot(ring[:, i], ring[:, j], color=GREY, lw=0.9, gid="border")
        for k, line in enumerate(lines):
            colour, style, _ = DEPTH_LOOKS[k]
            points = line.xyz_lcs_mm.copy()
            points[:, 2] = sensor.window.depth_mm(points)
            ax.plot(points[:, i], points[:, j], color=colour, ls=style, lw=1.8)
        ax.set(xlabel=names[i], ylabel=names[j])
        ax.set_title(words)
        ax.set_aspect("equal", adjustable="box")
        if j == 2:
            ax.invert_yaxis()
        ax.xaxis.set_major_locator(MaxNLocator(2 if np.ptp(ring[~np.isnan(ring[:, i]), i]) < 120.0 else 5))
        ax.grid()
