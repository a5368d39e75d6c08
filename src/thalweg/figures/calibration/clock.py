"""The camera's clock: its offset from antenna positions, its stability from a running display."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayU8, CoverageError
from thalweg.figures import (
    BLUE,
    GREEN,
    ORANGE,
    VERMILION,
    count,
    legend_below,
    marks_in_free_corners,
    new_figure,
    plural,
    read_picture,
    styled,
)
from thalweg.figures.calibration.field import fit_axes
from thalweg.figures.calibration.tables import first_picture, points_of, read_display

PINK: Final = "#D6488F"
PARTS: Final = (("along", BLUE, "o"), ("across", ORANGE, "^"), ("up", GREEN, "s"))
CROSSES: Final = 400
"""Crosses of the track that are drawn at most; between them there is a line."""
GAP_S: Final = 2.0
"""Seconds without a fix that interrupt the line."""

BINS: Final = 61


# ---------------------------------------------------------------- offset (P2 Fig. 9)


@styled
def clock_offset(images: pd.DataFrame, track: pd.DataFrame, facts: Mapping[str, Any]) -> Figure:
    """Plan of both tracks with the offset applied, and the residuals along, across and up over time.

    Parameters
    ----------
    images, track : see `thalweg.figures.calibration.tables`.
    facts : ``offset_s`` and ``sigma_offset_s``; others are not used.

    """
    images, track = images.sort_values("t_gps_s"), track.sort_values("t_gps_s")
    used = images["used"].to_numpy(bool)
    offset = f"GPS minus camera {facts['offset_s']:+.4f} s ± {1e3 * facts['sigma_offset_s']:.1f} ms"
    rejected = int((~used).sum())
    head = (
        f"Camera clock against GNSS: {offset}, n = {plural(used.sum(), 'image')}, {count(rejected)} rejected"
    )
    figure = new_figure(132.0, head)
    grid = figure.add_gridspec(2, 2, height_ratios=[1.7, 1.0], width_ratios=[3.2, 1.0])
    plan, below = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, 0])
    _plan(plan, images, track, used)
    t0 = float(track["t_gps_s"].iloc[0]) if len(track) else float(images["t_gps_s"].iloc[0])
    _residuals(below, figure.add_subplot(grid[1, 1], sharey=below), images[used], t0)
    for name, colour, marker in PARTS:
        plan.plot([], [], color=colour, marker=marker, mfc="none", ms=3.5, lw=1.1, label=name)
    legend_below(figure, plan)
    return figure


def _plan(ax: Axes, images: pd.DataFrame, track: pd.DataFrame, used: ArrayB) -> None:
    gnss = points_of(track, ("east_m", "north_m"))
    fixes = points_of(images, ("east_m", "north_m"))
    line = gnss.copy()
    line[1:][np.diff(track["t_gps_s"].to_numpy()) > GAP_S] = np.nan
    step = max(-(-len(gnss) // CROSSES), 1)
    ax.plot(line[:, 0], line[:, 1], color="0.75", lw=0.8, zorder=1)
    every = "" if step == 1 else f", 1 of {step} drawn"
    words = f"GNSS, n = {count(len(gnss))}{every}"
    ax.plot(*gnss[::step].T, "x", ms=3.2, mew=0.8, color="black", zorder=2, label=words, gid="track")
    for which, colour, words, gid in (
        (used, PINK, "antenna from images", "images"),
        (~used, "0.5", "rejected", "rejected"),
    ):
        if which.any():
            label = f"{words}, n = {count(which.sum())}"
            ax.plot(*fixes[which].T, "o", ms=5.0, mfc="none", color=colour, zorder=3, label=label, gid=gid)
    both = np.concatenate([gnss, fixes])
    fit_axes(ax, both, margin=0.07)
    ax.set(xlabel="east / m", ylabel="north / m")
    ax.set_title("a: tracks of the antenna, images at their corrected times")
    ax.grid()
    marks_in_free_corners(ax, both)


def _residuals(ax: Axes, right: Axes, images: pd.DataFrame, t0: float) -> None:
    t = images["t_gps_s"].to_numpy() - t0
    texts = []
    all_mm = np.abs(1e3 * points_of(images, [f"residual_{name}_m" for name, _, _ in PARTS]))
    reach = 1.15 * max(float(np.nanpercentile(all_mm, 99.5)), 1.0)
    edges = np.linspace(-reach, reach, 31)
    for name, colour, marker in PARTS:
        mm = 1e3 * images[f"residual_{name}_m"].to_numpy()
        ax.plot(t, mm, marker, ms=2.4, mew=0.6, mfc="none", color=colour, gid=name)
        right.hist(mm, edges.tolist(), orientation="horizontal", histtype="step", color=colour)
        texts.append(f"{name} {np.nanmean(mm):+.1f} ± {np.nanstd(mm):.1f}")
    ax.axhline(0.0, color="black", lw=0.6, zorder=1)
    ax.set_ylim(edges[0], edges[-1])
    ax.set(xlabel="time since the first fix / s", ylabel="track minus image / mm")
    ax.set_title(f"b: residuals; mean ± std / mm: {', '.join(texts)}")
    ax.grid()
    right.set_xlabel("images")
    right.tick_params(labelleft=False)
    right.grid()


# ---------------------------------------------------------------- stability (P2 Fig. 13)


@styled
def clock_stability(
    readings: pd.DataFrame,
    photo: ArrayU8,
    *,
    photo_text: str = "",
    nominal_s: float = 1.0,
    step_s: float = 0.0,
    title: str = "Clock of the camera",
) -> Figure:
    """A photo with what was read from it, the intervals between images over time, and their histogram.

    Parameters
    ----------
    readings : columns of ``display`` (see `thalweg.figures.calibration.tables`), in order of time. Intervals
        are taken between neighbouring photos that are both readable.
    photo : (h, w) or (h, w, 3) uint8, one of the photos. photo_text : what was read from it. nominal_s :
    interval that was set, seconds. step_s : step of the display, seconds: bars of the histogram are
    multiples of it; 0: not known. title : first words of the title. twin : true if the digital twin made
    the data.

    Raises
    ------
    CoverageError : fewer than two neighbouring photos are readable.
    """
    elapsed_min, intervals = display_intervals(readings)
    unread = int((~readings["readable"].to_numpy(bool)).sum())
    head = (
        f"{title}: interval {intervals.mean():.4f} s, std {intervals.std(ddof=1):.4f} s, "
        f"n = {plural(intervals.size, 'interval')}; {count(unread)} of {count(len(readings))} "
        "photos unreadable"
    )
    figure = new_figure(124.0, head)
    axes: dict[str, Any] = figure.subplot_mosaic([["a", "c"], ["b", "b"]], height_ratios=[1.15, 1.0])
    _photo(axes["a"], photo, photo_text)
    _in_time(axes["b"], elapsed_min, intervals, nominal_s)
    _histogram(axes["c"], intervals, nominal_s, step_s)
    return figure


def display_intervals(table: pd.DataFrame) -> tuple[ArrayF, ArrayF]:
    """Minutes since the first photo, and intervals in seconds between neighbouring readable photos.

    Raises
    ------
    CoverageError : fewer than two intervals.
    """
    read = table["read_s"].to_numpy()
    intervals = np.diff(read)
    both = np.isfinite(intervals)
    intervals = intervals[both]
    if intervals.size < 2:
        raise CoverageError(
            f"{intervals.size} intervals between readable photos",
            expected="two or more",
            cure="Photograph the display without reflections",
        )
    return (read[1:][both] - np.nanmin(read)) / 60.0, intervals


def chosen_photo(table: pd.DataFrame) -> tuple[str, str]:
    """File and text of the first clear photo that could be read.

    Parameters
    ----------
    table : columns ``file``, ``text``, ``readable``, and ``overlaid``: how far two numbers lie over each
        other.

    Raises
    ------
    CoverageError : none could.
    """
    readable = table[table["readable"].astype(bool)]
    if not len(readable):
        raise CoverageError("no photo could be read", expected="at least one")
    first = readable[readable["overlaid"] == readable["overlaid"].min()].iloc[0]
    return str(first["file"]), str(first["text"])


def _photo(ax: Axes, photo: ArrayU8, text: str) -> None:
    h, w = photo.shape[:2]
    ax.imshow(photo, cmap="gray", extent=(0, w, h, 0), interpolation="antialiased")
    ax.set(xticks=[], yticks=[])
    ax.set_title("a: photo of the display" + (f"\nread: {text}" if text else ""))


def _in_time(ax: Axes, minutes: ArrayF, intervals: ArrayF, nominal_s: float) -> None:
    mean, std = float(intervals.mean()), float(intervals.std(ddof=1))
    ax.plot(minutes, intervals, ".", ms=1.8, mew=0, color=BLUE, rasterized=True)
    ax.axhline(mean, color=VERMILION, lw=1.2, label=f"mean {mean:.4f} s")
    for sign in (-1, 1):
        ax.axhline(mean + sign * std, color=VERMILION, lw=0.9, ls="--", label="± std" if sign > 0 else None)
    ax.axhline(nominal_s, color="black", lw=0.7, ls=":", label=f"as set, {nominal_s:g} s")
    reach = 1.1 * _reach(intervals, mean)
    outside: AnyArray = np.abs(intervals - mean) > reach
    ax.set_ylim(mean - reach, mean + 1.35 * reach)
    ax.set(xlabel="time since the first photo / min", ylabel="interval / s")
    ax.set_title(f"b: time between two images; {count(outside.sum()) if outside.any() else 'none'} outside")
    ax.legend(loc="upper right", ncols=3)
    ax.grid()


def _histogram(ax: Axes, intervals: ArrayF, nominal_s: float, step_s: float) -> None:
    mean, std = float(intervals.mean()), float(intervals.std(ddof=1))
    reach = _reach(intervals, mean)
    edges = _edges(mean, reach, step_s)
    n, _ = np.histogram(intervals, edges)
    ax.stairs(n, edges, fill=True, color="0.75", gid="histogram")
    x = np.linspace(edges[0], edges[-1], 401)
    width = float(edges[1] - edges[0])
    if std > 0:
        ax.plot(
            x,
            intervals.size * width * norm.pdf(x, mean, std),
            color=VERMILION,
            lw=1.4,
            label=f"normal: {mean:.4f} s, {std:.4f} s",
        )
    ax.axvline(nominal_s, color="black", lw=0.7, ls=":")
    ax.set(xlabel="interval / s", ylabel=f"intervals per {1e3 * width:.2g} ms")
    ax.set_ylim(0, 1.3 * max(float(n.max()), 1.0))
    ax.set_title("c: histogram and normal distribution")
    ax.legend(loc="upper left")


def _edges(mean: float, reach: float, step_s: float) -> ArrayF:
    """Edges of the bars; intervals of a display are multiples of its step, and lie in the middle of a bar."""
    if step_s <= 0:
        return np.linspace(mean - reach, mean + reach, BINS + 1)
    width = step_s * max(round(2 * reach / step_s / BINS), 1)
    low, high = np.floor((mean - reach) / width), np.ceil((mean + reach) / width)
    return np.asarray(width * (np.arange(low, high + 2) - 0.5))


def _reach(intervals: ArrayF, mean: float) -> float:
    """Half width of the axes: what holds 99.8 % of the intervals."""
    return max(1.1 * float(np.percentile(np.abs(intervals - mean), 99.8)), 1e-4)


def draw_clock_stability(
    *, display: Path, photos: list[Path], nominal_s: float, step_s: float, title: str
) -> Figure:
    """Readings of a running display -> figure of the intervals between images."""
    table = read_display(display)
    name, text = chosen_photo(table)
    return clock_stability(
        table,
        read_picture(first_picture(photos, choice=[name])),
        photo_text=text,
        nominal_s=nominal_s,
        step_s=step_s,
        title=title,
    )
