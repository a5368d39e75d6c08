"""A scan against its reference: distances, and the middle line (P4 Fig. 19 and 20)."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from scipy.stats import norm

from thalweg.core import NMAD, ArrayF, robust_sigma
from thalweg.figures import BLUE, PURPLE, VERMILION, count, new_figure, plural, styled
from thalweg.figures.accuracy import DISTANCE_MAP
from thalweg.lightsheet.figures.views import dots, need, spots

POINTS: Final = ("file", "x_m", "y_m", "z_m", "distance_mm", "used", "reason")
BINS: Final = 61
_REASONS: Final = (
    ("far", "0.72", "not on the object"),
    ("at_border", "0.25", "at a border of the mesh"),
    ("bad_pose", "#E69F00", "line with a bad pose"),
)

PROFILE_POINTS: Final = ("file", "x_m", "z_m", "distance_mm", "sigma_mm", "sigma_own_mm", "used")
_MM_PER_M: Final = 1e3
_MOST_CLASSES: Final = 60
_GAP: Final = 8.0
"""Steps along the line that are so many times longer than usual are gaps."""


# ---------------------------------------------------------------- distances


@styled
def scan_distances(*, distances: pd.DataFrame, facts: Mapping[str, Any], scan: str, title: str) -> Figure:
    """Plan and side view of a scan coloured by distance; histogram with a normal and a robust fit.

    Parameters
    ----------
    distances : columns `POINTS`; ``used`` says which have a counterpart on a line with a good pose.
    facts : ``reference``, of what the distances are: ``mesh`` or ``planes``.
    scan, title : its name, and first words of the title.

    Raises
    ------
    InputError : an empty table, one without used points, or one that lacks columns.
    """
    points = need(distances, POINTS, "points of the scan")
    used = need(points[points["used"]], POINTS, "points on the reference")
    d = used["distance_mm"].to_numpy()
    head = (
        f"{title}, {scan}: distance from the {facts['reference']} {d.mean():+.2f} ± {d.std(ddof=1):.2f} mm, "
        f"n = {count(len(d))} points of {plural(used['file'].nunique(), 'line')}"
    )
    figure = new_figure(160.0, head)
    limit = max(3.0 * NMAD * float(np.median(np.abs(d - np.median(d)))), 0.1)
    top, side, below = figure.subplots(3, 1, height_ratios=[1.25, 1.0, 0.9])
    shades = [_view(ax, points, used, other, limit) for ax, other in ((top, "y_m"), (side, "z_m"))]
    top.set(title="a: from above", ylabel="y / mm")
    side.set(title="b: from the side", xlabel="x / mm", ylabel="z / mm")
    words = "signed distance / mm"
    figure.colorbar(shades[0], ax=[top, side], label=words, extend="both", aspect=32, pad=0.01)
    top.legend(loc="upper right", markerscale=4.0)
    edges = np.linspace(-2 * limit, 2 * limit, BINS + 1)
    fits = {
        "normal: mean, std": (d.mean(), d.std(ddof=1)),
        "robust: median, NMAD": (np.median(d), robust_sigma(d)),
    }
    most = _histogram(below, d, edges, fits)
    below.axvline(0.0, color="black", lw=0.7)
    below.set_title(f"c: histogram, {count((np.abs(d) > 2 * limit).sum())} points beyond the axis")
    below.set(xlabel=words, ylabel=f"points per {edges[1] - edges[0]:.2g} mm", xlim=(edges[0], edges[-1]))
    below.set_ylim(0.0, 1.45 * max(most, 1.0))
    below.legend(loc="upper right", fontsize=6.5)
    below.grid(axis="y")
    return figure


def _view(ax: Axes, points: pd.DataFrame, used: pd.DataFrame, other: str, limit: float) -> PathCollection:
    """Unused points in grey below, used ones coloured."""
    for reason, colour, words in _REASONS:
        mine = points[points["reason"] == reason]
        if len(mine):
            dots(ax, 1e3 * mine["x_m"], 1e3 * mine[other], colour, ms=0.8, label=words, gid=reason, zorder=1)
    shades = spots(
        ax,
        1e3 * used["x_m"],
        1e3 * used[other],
        used["distance_mm"],
        s=1.6,
        cmap=DISTANCE_MAP,
        vmin=-limit,
        vmax=limit,
        gid="points",
        zorder=2,
    )
    ax.set_aspect("equal", adjustable="datalim")
    ax.grid()
    return shades


def _histogram(
    ax: Axes, d: ArrayF, edges: ArrayF, fits: Mapping[str, tuple[float, float]], *, upright: bool = False
) -> float:
    """Points in classes with fitted normal distributions, their means and sigmas; the largest class."""
    n, _ = np.histogram(d, edges)
    ax.stairs(
        n,
        edges,
        orientation="horizontal" if upright else "vertical",
        fill=True,
        color="0.75",
        gid="histogram",
    )
    at = np.linspace(edges[0], edges[-1], 401)
    for (words, (mean, sigma)), colour, dashes in zip(fits.items(), (VERMILION, BLUE), "-:", strict=False):
        if sigma > 0:
            curve = len(d) * float(edges[1] - edges[0]) * norm.pdf(at, mean, sigma)
            label = f"{words}\n{mean:+.3f}, {sigma:.3f} mm"
            xy = (curve, at) if upright else (at, curve)
            ax.plot(*xy, color=colour, ls=dashes, lw=1.4, label=label, gid=words.split(":")[0])
    return float(n.max())


@styled
def scan_profile(
    *, distances: pd.DataFrame, profile: Mapping[str, Any], facts: Mapping[str, Any], scan: str, title: str
) -> Figure:
    """Points along the object; distances along it with their predicted sigma; histogram.

    Parameters
    ----------
    distances : columns `PROFILE_POINTS`, of the whole scan.
    profile : ``image``, the name of the image of the line.
    facts, scan, title : see `scan_distances`.

    Raises
    ------
    InputError : an empty table, an image without used points, or a table that lacks columns.
    """
    line, image = need(distances, PROFILE_POINTS, "points of the scan"), profile["image"]
    line = line[line["file"] == image]
    used = need(line[line["used"]], PROFILE_POINTS, f"points of {image} on the reference").sort_values("x_m")
    d, sigma = (used[name].to_numpy() for name in ("distance_mm", "sigma_mm"))
    std = float(d.std(ddof=1)) if len(d) > 1 else 0.0
    head = (
        f"{title}, {scan.replace('_', ' ')}: middle line {d.mean():+.3f} ± {std:.3f} mm from the "
        f"{facts['reference']}, {100 * (np.abs(d) <= sigma).mean():.0f} % within one predicted sigma, "
        f"n = {count(len(d))} points"
    )
    figure = new_figure(128.0, head)
    grid = figure.add_gridspec(2, 2, width_ratios=[2.0, 1.0])
    top, along = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, 0])
    for keep, colour, words in ((~line["used"], "0.65", "not on the object"), (line["used"], BLUE, "used")):
        if keep.any():
            x, z = (_MM_PER_M * line[name][keep] for name in ("x_m", "z_m"))
            dots(top, x, z, colour, gid=words, label=f"{words}: {count(keep.sum())}")
    top.set_aspect("equal", adjustable="datalim")
    top.set(title="a: points of the line, in the frame of the reference", xlabel="x / mm", ylabel="z / mm")
    top.legend(loc="upper right", markerscale=3)
    top.grid()
    limit = 1.2 * float(np.quantile(np.abs(d), 0.99)) + float(np.median(sigma))
    _along(along, used, limit)
    right = figure.add_subplot(grid[1, 1], sharey=along)
    edges = np.linspace(*along.get_ylim(), classes(len(d)) + 1)
    _histogram(right, d, edges, {"normal": (d.mean(), std)}, upright=True)
    right.tick_params(labelleft=False)
    right.set(title=f"c: {len(edges) - 1} classes, normal distribution", xlabel="points")
    right.grid(axis="x")
    return figure


def _along(ax: Axes, used: pd.DataFrame, limit: float) -> None:
    x = _MM_PER_M * used["x_m"].to_numpy()
    d = used["distance_mm"].to_numpy()
    # no band across a gap of the line
    step = np.diff(x, prepend=x[0])
    gaps = step > _GAP * max(float(np.median(step[1:])), 1e-9) if len(x) > 2 else x < x[0]
    for name, colour, words in (
        ("sigma_mm", PURPLE, "predicted sigma"),
        ("sigma_own_mm", "0.35", "of it the line's measurement"),
    ):
        sigma = np.where(gaps, np.nan, used[name].to_numpy())
        ax.fill_between(x, -sigma, sigma, color=colour, alpha=0.35, lw=0, label=words, gid=name)
    dots(ax, x, d, BLUE, gid="distances", zorder=3)
    ax.axhline(0.0, color="black", lw=0.7)
    beyond = int(((d < -limit) | (d > 1.4 * limit)).sum())
    ax.set_ylim(-limit, 1.4 * limit)
    ax.set(xlabel="x / mm", ylabel="signed distance / mm")
    ax.set_title(f"b: distances, {count(beyond)} points beyond the axis")
    ax.legend(loc="upper right", ncols=2)
    ax.grid()


def classes(n: int) -> int:
    """Number of classes of a histogram: the square root of the number of points, as in P4 Fig. 20.

    At most `_MOST_CLASSES`: narrower ones cannot be seen.
    """
    return int(np.clip(round(np.sqrt(n)), 5, _MOST_CLASSES))
