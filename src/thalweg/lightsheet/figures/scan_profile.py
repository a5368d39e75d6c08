"""One profile of a scan: its points, distances beside their predicted sigma, and histogram (P4 Fig. 19)."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from thalweg.core.types import ArrayF
from thalweg.figures.style import BLUE, PURPLE, VERMILION, count, new_figure, styled
from thalweg.lightsheet.figures.views import need

POINTS: Final = ("file", "x_m", "z_m", "distance_mm", "sigma_mm", "sigma_own_mm", "used")

_MM_PER_M: Final = 1e3
_MOST_CLASSES: Final = 60
_GAP: Final = 8.0
"""Steps along the line that are so many times longer than usual are gaps."""


@styled
def scan_profile(
    points: pd.DataFrame, image: str, *, reference: str = "mesh", title: str = "Profile", twin: bool = False
) -> Figure:
    """Points along the object; distances along it with their predicted sigma; histogram.

    Parameters
    ----------
    points : columns `POINTS`, of the whole scan in the frame of its reference.
    image : name of the image whose line is shown.
    reference : what the distances are from.
    title : first words of the title.
    twin : true if the digital twin made the images.

    Raises
    ------
    InputError : an empty table, one that lacks columns, or no point of that line on the reference.
    """
    line = need(points, POINTS, "points of the scan")
    line = line[line["file"] == image]
    used = need(line[line["used"]], POINTS, f"points of {image} on the reference").sort_values("x_m")
    d, sigma = (used[name].to_numpy(np.float64) for name in ("distance_mm", "sigma_mm"))
    within = float((np.abs(d) <= sigma).mean())
    head = (
        f"{title}: middle line {d.mean():+.3f} ± {d.std(ddof=1) if len(d) > 1 else 0.0:.3f} mm from the "
        f"{reference}, {100 * within:.0f} % within one predicted sigma, n = {count(len(d))} points"
    )
    figure = new_figure(128.0, head, twin=twin)
    grid = figure.add_gridspec(2, 2, width_ratios=[2.0, 1.0])
    top = figure.add_subplot(grid[0, :])
    _points(top, line)
    along = figure.add_subplot(grid[1, 0])
    limit = 1.2 * float(np.quantile(np.abs(d), 0.99)) + float(np.median(sigma))
    _along(along, used, limit)
    _histogram(figure.add_subplot(grid[1, 1], sharey=along), d)
    return figure


def _points(ax: Axes, line: pd.DataFrame) -> None:
    for keep, colour, words in ((~line["used"], "0.65", "not on the object"), (line["used"], BLUE, "used")):
        if keep.any():
            x, z = (_MM_PER_M * line[name][keep] for name in ("x_m", "z_m"))
            ax.plot(x, z, ls="none", marker=".", ms=2.0, mew=0, color=colour, gid=words,
                    label=f"{words}: {count(int(keep.sum()))}")  # fmt: skip
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel="x / mm", ylabel="z / mm")
    ax.set_title("a: points of the line, in the frame of the reference")
    ax.legend(loc="upper right", markerscale=3)
    ax.grid()


def _along(ax: Axes, used: pd.DataFrame, limit: float) -> None:
    x = _MM_PER_M * used["x_m"].to_numpy(np.float64)
    d = used["distance_mm"].to_numpy(np.float64)
    # no band across a gap of the line
    gaps = (
        np.diff(x, prepend=x[0]) > _GAP * max(float(np.median(np.diff(x))), 1e-9) if len(x) > 2 else x < x[0]
    )
    for name, colour, alpha, words in (
        ("sigma_mm", PURPLE, 0.35, "predicted sigma"),
        ("sigma_own_mm", "0.35", 0.35, "of it the line's measurement"),
    ):
        sigma = np.where(gaps, np.nan, used[name].to_numpy(np.float64))
        ax.fill_between(x, -sigma, sigma, color=colour, alpha=alpha, lw=0, label=words, gid=name)
    ax.plot(x, d, ls="none", marker=".", ms=2.0, mew=0, color=BLUE, gid="distances", zorder=3)
    ax.axhline(0.0, color="black", lw=0.7)
    beyond = int(((d < -limit) | (d > 1.4 * limit)).sum())
    ax.set_ylim(-limit, 1.4 * limit)
    ax.set(xlabel="x / mm", ylabel="signed distance / mm")
    ax.set_title(f"b: distances, {count(beyond)} points beyond the axis")
    ax.legend(loc="upper right", ncols=2)
    ax.grid()


def classes(n: int) -> int:
    """Number of classes of a histogram: the square root of the number of points, as in P4 Fig. 20.

    Examples
    --------
    >>> classes(400)
    20
    """
    return int(np.clip(round(np.sqrt(n)), 5, _MOST_CLASSES))


def _histogram(ax: Axes, d: ArrayF) -> None:
    low, high = ax.get_ylim()
    edges = np.linspace(low, high, classes(len(d)) + 1)
    n, _ = np.histogram(d, edges)
    ax.stairs(n, edges, orientation="horizontal", fill=True, color="0.75", gid="histogram")
    mean, std = float(d.mean()), float(d.std(ddof=1)) if len(d) > 1 else 0.0
    if std > 0:
        y = np.linspace(low, high, 301)
        ax.plot(len(d) * float(edges[1] - edges[0]) * norm.pdf(y, mean, std), y, color=VERMILION, lw=1.4,
                gid="normal")  # fmt: skip
    ax.tick_params(labelleft=False)
    ax.set(xlabel="points")
    ax.set_title(f"c: {len(edges) - 1} classes, normal distribution")
    ax.grid(axis="x")
