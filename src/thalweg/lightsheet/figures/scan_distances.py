"""A scan against its reference: distances, and the middle line (P4 Fig. 19 and 20)."""

import json
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from scipy.stats import norm

from thalweg.core import NMAD, ArrayF, read_table, robust_sigma
from thalweg.figures import BLUE, GREY, PURPLE, VERMILION, count, new_figure, plural, styled
from thalweg.figures.accuracy import DISTANCE_MAP
from thalweg.lightsheet.figures.views import need
from thalweg.lightsheet.scanning import SCAN_DISTANCES

POINTS: Final = ("file", "x_m", "y_m", "z_m", "distance_mm", "used", "reason")
STATISTICS: Final = ("points", "rule", "std_mm", "std_kept_mm")
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
    limit = max(3.0 * NMAD * float(np.median(np.abs(d - np.median(d)))), 0.1)
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
            ax.plot(
                1e3 * mine[first],
                1e3 * mine[second],
                ls="none",
                marker=".",
                ms=0.8,
                color=colour,
                label=words,
                gid=reason,
                rasterized=True,
                zorder=1,
            )
    shades = ax.scatter(
        1e3 * shown[first],
        1e3 * shown[second],
        c=shown["distance_mm"],
        s=1.6,
        lw=0,
        cmap=DISTANCE_MAP,
        vmin=-limit,
        vmax=limit,
        gid="points",
        rasterized=True,
        zorder=2,
    )
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
    nmad = robust_sigma(d, median)
    fits = (
        ("normal: mean, std", float(d.mean()), float(d.std(ddof=1)), VERMILION, "-"),
        ("robust: median, NMAD", median, nmad, BLUE, "--"),
    )
    for name, middle, sigma, colour, dashes in fits:
        if sigma > 0:
            ax.plot(
                x,
                len(d) * width * norm.pdf(x, middle, sigma),
                color=colour,
                ls=dashes,
                lw=1.4,
                label=f"{name}\n{middle:+.3f}, {sigma:.3f} mm",
                gid=name.split(":")[0],
            )
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


def draw_scan_distances(
    *, distances: Path, statistics: Path, facts: Path, scan: str, title: str, twin: bool
) -> Figure:
    """Distances of a scan and their statistics -> figure of the coloured scan and their histogram."""
    return scan_distances(
        read_table(distances, SCAN_DISTANCES)[0],
        pd.read_csv(statistics),
        reference=json.loads(facts.read_text())["reference"],
        title=f"{title}, {scan}",
        twin=twin,
    )


# ---------------------------------------------------------------- middle line


@styled
def scan_profile(
    points: pd.DataFrame, image: str, *, reference: str = "mesh", title: str = "Profile", twin: bool = False
) -> Figure:
    """Points along the object; distances along it with their predicted sigma; histogram.

    Parameters
    ----------
    points : columns `PROFILE_POINTS`, of the whole scan in the frame of its reference.
    image : name of the image whose line is shown.
    reference : what the distances are from.
    title : first words of the title.
    twin : true if the digital twin made the images.

    Raises
    ------
    InputError : an empty table, one that lacks columns, or no point of that line on the reference.
    """
    line = need(points, PROFILE_POINTS, "points of the scan")
    line = line[line["file"] == image]
    used = need(line[line["used"]], PROFILE_POINTS, f"points of {image} on the reference").sort_values("x_m")
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
    _profile_histogram(figure.add_subplot(grid[1, 1], sharey=along), d)
    return figure


def _points(ax: Axes, line: pd.DataFrame) -> None:
    for keep, colour, words in ((~line["used"], "0.65", "not on the object"), (line["used"], BLUE, "used")):
        if keep.any():
            x, z = (_MM_PER_M * line[name][keep] for name in ("x_m", "z_m"))
            ax.plot(
                x,
                z,
                ls="none",
                marker=".",
                ms=2.0,
                mew=0,
                color=colour,
                gid=words,
                label=f"{words}: {count(int(keep.sum()))}",
            )
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


def _profile_histogram(ax: Axes, d: ArrayF) -> None:
    low, high = ax.get_ylim()
    edges = np.linspace(low, high, classes(len(d)) + 1)
    n, _ = np.histogram(d, edges)
    ax.stairs(n, edges, orientation="horizontal", fill=True, color="0.75", gid="histogram")
    mean, std = float(d.mean()), float(d.std(ddof=1)) if len(d) > 1 else 0.0
    if std > 0:
        y = np.linspace(low, high, 301)
        ax.plot(
            len(d) * float(edges[1] - edges[0]) * norm.pdf(y, mean, std),
            y,
            color=VERMILION,
            lw=1.4,
            gid="normal",
        )
    ax.tick_params(labelleft=False)
    ax.set(xlabel="points")
    ax.set_title(f"c: {len(edges) - 1} classes, normal distribution")
    ax.grid(axis="x")


def draw_scan_profile(
    *, distances: Path, facts: Path, profile: Path, scan: str, title: str, twin: bool
) -> Figure:
    """Distances of a scan -> figure of its middle line."""
    return scan_profile(
        read_table(distances, SCAN_DISTANCES)[0],
        json.loads(profile.read_text(encoding="utf-8"))["image"],
        reference=json.loads(facts.read_text(encoding="utf-8"))["reference"],
        title=f"{title}, {scan.replace('_', ' ')}",
        twin=twin,
    )
