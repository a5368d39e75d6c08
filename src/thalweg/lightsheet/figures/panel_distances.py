"""A plane panel in known depths: the line, its distances, and published ones (P3 Fig. 9 and 10)."""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.core import AnyArray, CoverageError, read_parquet
from thalweg.figures import HALO, count, new_figure, plural, styled
from thalweg.lightsheet.figures.views import DEPTH_STYLES, Look, dots, find_image, green_of, need, show_green
from thalweg.lightsheet.optics import Sensor, depth_lines, read_sensor

POINTS: Final = ("file", "x_mm", "y_mm", "depth_mm", "sigma_depth_mm", "expected_depth_mm", "x_px", "y_px")
PANELS: Final = ("file", "depth_mm", "n", "mean_mm", "std_mm", "published_mean_mm", "published_std_mm")
"""Columns of `thalweg.lightsheet.poses.panels.compare_panels`."""

DETAIL_PX: Final = 60
_MM_PER_PANEL: Final = 15.0


@styled
def panel_distances(
    sensor: Sensor,
    image: AnyArray,
    points: pd.DataFrame,
    panels: pd.DataFrame,
    *,
    title: str = "Panel in known depths",
) -> Figure:
    """Detail of one image with lines of reference depths, distances by place, means beside published ones.

    Parameters
    ----------
    sensor : calibrated.
    image : that of `first_with_points`.
    points : columns `POINTS`.
    panels : columns `PANELS`; at most six are drawn one by one.
    title : first words of the title.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    CoverageError : no panel has points.
    """
    need(points, POINTS, "points on the panels"), need(panels, PANELS, "panels")
    shown = panels.head(len(DEPTH_STYLES))
    off = points["depth_mm"] - points["expected_depth_mm"]
    head = (
        f"{title}: mean {signed(off.mean())} mm, standard deviation {off.std():.3f} mm, "
        f"n = {count(len(points))} points in {plural(len(panels), 'depth')}"
    )
    rows = max(len(shown), 2)  # the detail needs the height of two
    figure = new_figure(34.0 + _MM_PER_PANEL * rows, head)
    grid = figure.add_gridspec(rows, 2, width_ratios=[1.0, 1.7])
    _detail(figure.add_subplot(grid[:, 0]), sensor, image, points, shown)
    along = "x_mm" if np.ptp(points["x_mm"]) >= np.ptp(points["y_mm"]) else "y_mm"
    limit = 1.1 * float(off.abs().quantile(0.999)) + 1e-6
    axes: list[Axes] = []
    for k, (_, row) in enumerate(shown.iterrows()):
        first = axes[0] if axes else None
        ax = figure.add_subplot(grid[k, 1], sharex=first, sharey=first)
        axes.append(ax)
        _distances(ax, points[points["file"] == row["file"]], row, along, k, limit)
        ax.tick_params(labelbottom=k == len(shown) - 1)
    ax.set_xlabel(f"{along[0]} / mm")
    axes[0].set_title("b: measured minus reference depth / mm, beside P3 3.1.2")
    return figure


def first_with_points(panels: pd.DataFrame) -> pd.Series:
    """The first panel that has points.

    Raises
    ------
    CoverageError : no panel has any.
    """
    some = panels[panels["n"] > 0]
    if not len(some):
        raise CoverageError("no point on any panel", expected="points in at least one image")
    return some.iloc[0]


def signed(value: float) -> str:
    """A number with three places and its sign, zero without one.

    Examples
    --------
    >>> signed(-0.0002), signed(0.0312)
    ('0.000', '+0.031')
    """
    text = f"{float(value):+.3f}"
    return text[1:] if float(text) == 0.0 else text


def _detail(ax: Axes, sensor: Sensor, image: AnyArray, points: pd.DataFrame, shown: pd.DataFrame) -> None:
    """Measured points and the lines that panels in the reference depths would have."""
    panel = first_with_points(shown)
    mine = points[points["file"] == panel["file"]]
    middle = mine.iloc[len(mine) // 2]
    left, top = (max(int(middle[name] - DETAIL_PX / 2), 0) for name in ("x_px", "y_px"))
    green = green_of(image)[top : top + DETAIL_PX, left : left + DETAIL_PX]
    show_green(ax, green, left=left, top=top)
    lines = depth_lines(sensor, [float(d) for d in shown["depth_mm"]])
    for (colour, style, _), line in zip(DEPTH_STYLES, lines, strict=False):
        x, y = line.xy_px.T
        near = (np.abs(x - left) <= DETAIL_PX) & (np.abs(y - top) <= DETAIL_PX)
        # a line that the detail does not show has no place in its legend
        look: Look = {"lw": 1.6, "gid": f"reference {line.depth_mm:g}", "zorder": 3}
        look |= {"label": f"{line.depth_mm:.1f} mm"} if near.any() else {}
        ax.plot(x, y, color=colour, ls=style, **look)
    dots(
        ax, mine["x_px"], mine["y_px"], "black", "o", ms=2.6, mfc="white", mew=0.4, label="measured", zorder=4
    )
    ax.set_xlim(left, left + green.shape[1])
    ax.set_ylim(top + green.shape[0], top)
    ax.set(xlabel="column / px", ylabel="row / px")
    ax.set_title(f"a: detail at {float(panel['depth_mm']):.1f} mm\nwith lines of reference depths")
    ax.legend(loc="upper left")


def _distances(ax: Axes, mine: pd.DataFrame, row: pd.Series, along: str, k: int, limit: float) -> None:
    """Distances of the points of a panel, their mean, and in words those published."""
    colour, _, marker = DEPTH_STYLES[k]
    off = mine["depth_mm"] - mine["expected_depth_mm"]
    dots(ax, mine[along], off, colour, marker)
    ax.axhline(0.0, color="0.3", lw=0.6)
    if np.isfinite(row["mean_mm"]):
        ax.axhline(float(row["mean_mm"]), color="black", lw=0.9, ls="--")
    ax.set_ylim(-limit, 1.9 * limit)
    words = "no points"
    if row["n"]:
        words = f"{signed(row['mean_mm'])} ± {row['std_mm']:.3f} mm, n = {count(row['n'])}"
    if np.isfinite(row["published_std_mm"]):
        words += f" (P3: {row['published_mean_mm']:.2f} ± {row['published_std_mm']:.2f} mm)"
    ax.text(
        0.01,
        0.96,
        f"{row['depth_mm']:.1f} mm: {words}",
        transform=ax.transAxes,
        va="top",
        fontsize=7,
        path_effects=HALO,
    )
    ax.grid()


def draw_panel_distances(
    *, sensor: Path, images: list[Path], points: Path, panels: Path, title: str
) -> Figure:
    """Points on a panel in known depths -> figure of their distances, beside published ones."""
    rows = pd.read_csv(panels)
    image = find_image(images, str(first_with_points(rows)["file"]))
    return panel_distances(read_sensor(sensor), image, read_parquet(points), rows, title=title)
