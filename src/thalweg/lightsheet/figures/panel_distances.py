"""A plane panel in known depths: the line, its distances, and published ones (P3 Fig. 9 and 10)."""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.core import AnyArray, CoverageError, read_parquet
from thalweg.figures import BLUE, GREY, HALO, VERMILION, count, legend_below, new_figure, plural, styled
from thalweg.lightsheet.figures.views import DEPTH_STYLES, find_image, green_of, need, show_green
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
    twin: bool = False,
) -> Figure:
    """Detail of one image with lines of reference depths, distances by place, means beside published ones.

    Parameters
    ----------
    sensor : calibrated.
    image : that of `first_with_points`.
    points : columns `POINTS`.
    panels : columns `PANELS`; at most six are drawn one by one.
    title : first words of the title.
    twin : true if the digital twin made the images.

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
    figure = new_figure(70.0 + _MM_PER_PANEL * rows, head, twin=twin)
    grid = figure.add_gridspec(rows + 3, 2, width_ratios=[1.0, 1.7])
    _detail(figure.add_subplot(grid[:rows, 0]), sensor, image, points, shown)
    along = "x_mm" if np.ptp(points["x_mm"]) >= np.ptp(points["y_mm"]) else "y_mm"
    limit = 1.1 * float(off.abs().quantile(0.999)) + 1e-6
    first: Axes | None = None
    for k, (_, row) in enumerate(shown.iterrows()):
        ax = figure.add_subplot(grid[k, 1], sharex=first, sharey=first)
        first = first or ax
        _distances(ax, points[points["file"] == row["file"]], row, along, k, limit)
        if k < len(shown) - 1:
            ax.tick_params(labelbottom=False)
        else:
            ax.set_xlabel(f"{along[0]} / mm")
        if k == 0:
            ax.set_title("b: measured minus reference depth / mm")
    below = figure.add_subplot(grid[rows:, :])
    _beside_published(below, shown)
    legend_below(figure, below)
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
    for k, line in enumerate(lines):
        if not len(line.xy_px):
            continue
        colour, style, _ = DEPTH_STYLES[k]
        ax.plot(
            *line.xy_px.T,
            color=colour,
            ls=style,
            lw=1.6,
            label=f"{line.depth_mm:.1f} mm",
            gid=f"reference {k}",
            zorder=3,
        )
    ax.plot(
        mine["x_px"],
        mine["y_px"],
        ls="none",
        marker="o",
        ms=2.6,
        mfc="white",
        mec="black",
        mew=0.4,
        label="measured",
        gid="measured",
        zorder=4,
    )
    ax.set_xlim(left, left + green.shape[1])
    ax.set_ylim(top + green.shape[0], top)
    ax.set(xlabel="column / px", ylabel="row / px")
    ax.set_title(f"a: detail at {float(panel['depth_mm']):.1f} mm\nwith lines of reference depths")
    seen = [line for line in ax.get_lines() if _inside(ax, np.asarray(line.get_xydata()))]
    ax.legend(handles=seen, loc="upper left")


def _inside(ax: Axes, xy: AnyArray) -> bool:
    (x0, x1), (y1, y0) = ax.get_xlim(), ax.get_ylim()
    x, y = np.asarray(xy, dtype=np.float64).T
    return bool(((x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)).any())


def _distances(ax: Axes, mine: pd.DataFrame, row: pd.Series, along: str, k: int, limit: float) -> None:
    colour, _, marker = DEPTH_STYLES[k]
    off = (mine["depth_mm"] - mine["expected_depth_mm"]).to_numpy()
    ax.plot(mine[along], off, ls="none", marker=marker, ms=1.8, color=colour, mew=0.0, gid=f"distances {k}")
    ax.axhline(0.0, color="0.3", lw=0.6)
    if np.isfinite(row["mean_mm"]):
        ax.axhline(float(row["mean_mm"]), color="black", lw=0.9, ls="--", gid="mean")
    ax.set_ylim(-limit, 1.9 * limit)
    words = f"{signed(row['mean_mm'])} ± {float(row['std_mm']):.3f} mm, n = {count(int(row['n']))}"
    ax.text(
        0.01,
        0.96,
        f"{float(row['depth_mm']):.1f} mm: {words if row['n'] else 'no points'}",
        transform=ax.transAxes,
        va="top",
        fontsize=7,
        path_effects=HALO,
    )
    ax.grid()


def _beside_published(ax: Axes, shown: pd.DataFrame) -> None:
    """Mean and standard deviation of each panel, and published ones; the predicted sigma if known."""
    place = np.arange(len(shown), dtype=np.float64)
    sides = (("", "this measurement", VERMILION, "o", -0.1), ("published_", "P3 3.1.2", BLUE, "s", 0.1))
    for prefix, words, colour, marker, aside in sides:
        mean, std = (shown[f"{prefix}{name}_mm"].to_numpy(np.float64) for name in ("mean", "std"))
        ax.errorbar(
            place + aside,
            mean,
            yerr=std,
            ls="none",
            marker=marker,
            ms=4,
            color=colour,
            elinewidth=1.2,
            capsize=3,
            label=f"{words}: mean, standard deviation",
            gid=f"{prefix or 'own '}means",
        )
    if "predicted_mm" in shown:
        sigma = shown["predicted_mm"].to_numpy(np.float64)
        ax.bar(
            place - 0.1,
            2 * sigma,
            bottom=-sigma,
            width=0.16,
            color=GREY,
            alpha=0.3,
            label="predicted sigma",
            gid="predicted",
        )
    ax.axhline(0.0, color="0.3", lw=0.6)
    ax.set_xticks(place, [f"{depth:.1f} mm" for depth in shown["depth_mm"]])
    ax.set(xlabel="reference depth", ylabel="measured minus reference / mm", xlim=(-0.5, len(shown) - 0.5))
    ax.set_title("c: beside published values")
    ax.grid(axis="y")


def draw_panel_distances(
    *, sensor: Path, images: list[Path], points: Path, panels: Path, title: str, twin: bool
) -> Figure:
    """Points on a panel in known depths -> figure of their distances, beside published ones."""
    rows = pd.read_csv(panels)
    image = find_image(images, str(first_with_points(rows)["file"]))
    return panel_distances(read_sensor(sensor), image, read_parquet(points), rows, title=title, twin=twin)
