"""A scan coloured by its distance from the reference, and the histogram of distances (P4 Fig. 19 and 20)."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from scipy.stats import norm

from thalweg.core.types import ArrayF
from thalweg.figures.accuracy.distance_map import DISTANCE_MAP
from thalweg.figures.style import BLUE, GREY, VERMILION, count, new_figure, plural, styled
from thalweg.lightsheet.figures.views import need

POINTS: Final = ("file", "x_m", "y_m", "z_m", "distance_mm", "used", "reason")
STATISTICS: Final = ("points", "rule", "std_mm", "std_kept_mm")
BINS: Final = 61
_REASONS: Final = (
    ("far", "0.72", "not on the object"),
    ("at_border", "0.25", "at a border of the mesh"),
    ("bad_pose", "#E69F00", "line with a bad pose"),
)


@styled
def scan_distances(
    points: pd.DataFrame,
    statistics: pd.DataFrame,
    *,
    reference: str = "mesh",
    title: str = "Scan",
    twin: bool = False,
) -> Figure:
    """Plan and side view of a scan coloured by distance; histogram with a normal and a robust fit.

    Parameters
    ----------
    points : columns `POINTS`, see `thalweg.lightsheet.scanning.compare.SCAN_DISTANCES`.
    statistics : columns `STATISTICS`, of the same scan.
    reference : what the distances are from.
    title : first words of the title.
    twin : true if the digital twin made the images.

    Raises
    ------
    InputError : an empty table, one that lacks columns, or no point that is used.
    """
    need(points, POINTS, "points of the scan"), need(statistics, STATISTICS, "statistics")
    used = need(points[points["used"]], POINTS, "points on the reference")
    d = used["distance_mm"].to_numpy(np.float64)
    lines = int(used["file"].nunique())
    head = (
        f"{title}: distance from the {reference} {d.mean():+.2f} ± {d.std(ddof=1):.2f} mm, "
        f"n = {count(len(d))} points of {plural(lines, 'line')}"
    )
    figure = new_figure(165.0, head, twin=twin)
    grid = figure.add_gridspec(3, 2, height_ratios=[1.25, 1.0, 1.1], width_ratios=[1.5, 1.0])
    limit = max(3.0 * 1.4826 * float(np.median(np.abs(d - np.median(d)))), 0.1)
    top, side = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, :])
    shades = _view(top, points, "x_m", "y_m", limit)
    _view(side, points, "x_m", "z_m", limit)
    top.set(title="a: from above", ylabel="y / mm")
    side.set(title="b: from the side", xlabel="x / mm", ylabel="z / mm")
    figure.colorbar(shades, ax=[top, side], label="signed distance / mm", extend="both", aspect=32, pad=0.01)
    top.legend(loc="upper right", markerscale=4.0)
    _histogram(figure.add_subplot(grid[2, 0]), d, limit)
    _rules(figure.add_subplot(grid[2, 1]), statistics)
    return figure


def _view(ax: Axes, points: pd.DataFrame, first: str, second: str, limit: float) -> PathCollection:
    """Unused points in grey below, used ones coloured."""
    shown = points[points["used"]]
    for reason, colour, words in _REASONS:
        mine = points[points["reason"] == reason]
        if len(mine):
            ax.plot(1e3 * mine[first], 1e3 * mine[second], ls="none", marker=".", ms=0.8, color=colour,
                    label=words, gid=reason, rasterized=True, zorder=1)  # fmt: skip
    shades = ax.scatter(
        1e3 * shown[first], 1e3 * shown[second], c=shown["distance_mm"], s=1.6, lw=0, cmap=DISTANCE_MAP,
        vmin=-limit, vmax=limit, gid="points", rasterized=True, zorder=2,
    )  # fmt: skip
    ax.set_aspect("equal", adjustable="datalim")
    ax.grid()
    return shades


def _histogram(ax: Axes, d: ArrayF, limit: float) -> None:
    """Distances within twice the range of the colours, with what lies beyond in words."""
    edges = np.linspace(-2 * limit, 2 * limit, BINS + 1)
    n, _ = np.histogram(d, edges)
    width = float(edges[1] - edges[0])
    ax.stairs(n, edges, fill=True, color="0.75", gid="histogram")
    x = np.linspace(edges[0], edges[-1], 401)
    median = float(np.median(d))
    nmad = 1.4826 * float(np.median(np.abs(d - median)))
    fits = (("normal: mean, std", float(d.mean()), float(d.std(ddof=1)), VERMILION, "-"),
            ("robust: median, NMAD", median, nmad, BLUE, "--"))  # fmt: skip
    for name, middle, sigma, colour, dashes in fits:
        if sigma > 0:
            ax.plot(x, len(d) * width * norm.pdf(x, middle, sigma), color=colour, ls=dashes, lw=1.4,
                    label=f"{name}\n{middle:+.3f}, {sigma:.3f} mm", gid=name.split(":")[0])  # fmt: skip
    ax.axvline(0.0, color="black", lw=0.7)
    beyond = int((np.abs(d) > 2 * limit).sum())
    ax.set_title(f"c: histogram, {count(beyond)} points beyond the axis")
    ax.set(xlabel="signed distance / mm", ylabel=f"points per {width:.2g} mm", xlim=(edges[0], edges[-1]))
    ax.set_ylim(0.0, 1.45 * max(float(n.max()), 1.0))
    ax.legend(loc="upper right", fontsize=6.5)
    ax.grid(axis="y")


def _rules(ax: Axes, statistics: pd.DataFrame) -> None:
    """Standard deviation of all points and of what each outlier rule leaves, and the published pair."""
    rows = statistics[statistics["points"] != "all lines"]
    names = ["P4" if row["points"] == "published" else str(row["rule"]) for _, row in rows.iterrows()]
    place = np.arange(len(rows), dtype=np.float64)
    kinds = ((-0.18, "std_mm", GREY, "all"), (0.18, "std_kept_mm", VERMILION, "kept"))
    for aside, column, colour, words in kinds:
        value = rows[column].to_numpy(np.float64)
        bars = ax.bar(place + aside, value, width=0.34, color=colour, label=words, gid=words)
        ax.bar_label(bars, [f"{v:.2f}" for v in value], fontsize=6, padding=1)
    ax.set_xticks(place, [name.replace(" repeated", "\nrepeated") for name in names], fontsize=7)
    ax.set_ylim(0.0, 1.35 * float(rows[["std_mm", "std_kept_mm"]].to_numpy(np.float64).max()))
    ax.set(title="d: outlier rules", ylabel="standard deviation / mm")
    ax.legend(loc="upper left", ncols=2)
    ax.grid(axis="y")
