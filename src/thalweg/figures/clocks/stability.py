"""Stability of a camera's clock from photos of a running display (P2 Fig. 13)."""

from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from thalweg.core.errors import CoverageError, InputError
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayU8
from thalweg.figures.calibration.tables import DISPLAY, checked, filled
from thalweg.figures.style import BLUE, VERMILION, count, new_figure, plural, styled

BINS: Final = 61


@styled
def clock_stability(
    readings: pd.DataFrame,
    photo: ArrayU8,
    *,
    photo_text: str = "",
    nominal_s: float = 1.0,
    step_s: float = 0.0,
    title: str = "Clock of the camera",
    twin: bool = False,
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
    InputError : a column is missing, or the photo is none.
    CoverageError : fewer than two neighbouring photos are readable.
    """
    table = filled(checked(readings, DISPLAY), "photo")
    if photo.dtype != np.uint8 or photo.ndim not in (2, 3):
        raise InputError(
            f"photo of shape {photo.shape} and type {photo.dtype}", expected="(h, w[, 3]) of uint8"
        )
    elapsed_min, intervals = display_intervals(table)
    unread = int((~table["readable"].to_numpy(bool)).sum())
    head = (
        f"{title}: interval {intervals.mean():.4f} s, std {intervals.std(ddof=1):.4f} s, "
        f"n = {plural(intervals.size, 'interval')}; {count(unread)} of {count(len(table))} photos unreadable"
    )
    figure = new_figure(124.0, head, twin=twin)
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
    read = table["read_s"].to_numpy(np.float64)
    good: ArrayB = table["readable"].to_numpy(bool) & np.isfinite(read)
    both = good[1:] & good[:-1]
    intervals = np.diff(read)[both]
    if intervals.size < 2:
        raise CoverageError(
            f"{intervals.size} intervals between readable photos", expected="two or more",
            cure="Photograph the display without reflections",
        )  # fmt: skip
    return (read[1:][both] - read[good][0]) / 60.0, intervals


def chosen_photo(table: pd.DataFrame) -> tuple[str, str]:
    """File and text of the first clear photo that could be read.

    Parameters
    ----------
    table : columns ``file`` and ``readable``; perhaps ``text``, and ``overlaid``, how far two numbers lie
        over each other.

    Raises
    ------
    CoverageError : none could.
    """
    readable = table[table["readable"].astype(bool)]
    if not len(readable):
        raise CoverageError("no photo could be read", expected="at least one")
    clear = readable[readable["overlaid"] == readable["overlaid"].min()] if "overlaid" in table else readable
    first = clear.iloc[0]
    return str(first["file"]), str(first["text"]) if "text" in table else ""


def _photo(ax: Axes, photo: ArrayU8, text: str) -> None:
    h, w = photo.shape[:2]
    ax.imshow(photo, cmap="gray", extent=(0, w, h, 0), interpolation="antialiased")
    ax.set_xticks([])
    ax.set_yticks([])
    ax.set_title("a: photo of the display" + (f"\nread: {text}" if text else ""))


def _in_time(ax: Axes, minutes: ArrayF, intervals: ArrayF, nominal_s: float) -> None:
    mean, std = float(intervals.mean()), float(intervals.std(ddof=1))
    ax.plot(
        minutes, intervals, ls="none", marker=".", ms=1.8, mew=0, color=BLUE, rasterized=True, gid="intervals"
    )
    ax.axhline(mean, color=VERMILION, lw=1.2, label=f"mean {mean:.4f} s")
    for sign in (-1, 1):
        ax.axhline(mean + sign * std, color=VERMILION, lw=0.9, ls="--", label="± std" if sign > 0 else None)
    ax.axhline(nominal_s, color="black", lw=0.7, ls=":", label=f"as set, {nominal_s:g} s")
    reach = 1.1 * _reach(intervals, mean)
    outside: AnyArray = np.abs(intervals - mean) > reach
    ax.set_ylim(mean - reach, mean + 1.35 * reach)
    ax.set(xlabel="time since the first photo / min", ylabel="interval / s")
    ax.set_title(
        f"b: time between two images; {count(int(outside.sum())) if outside.any() else 'none'} outside"
    )
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
        ax.plot(x, intervals.size * width * norm.pdf(x, mean, std), color=VERMILION, lw=1.4,
                label=f"normal: {mean:.4f} s, {std:.4f} s")  # fmt: skip
    ax.axvline(nominal_s, color="black", lw=0.7, ls=":")
    ax.set(xlabel="interval / s", ylabel=f"intervals per {1e3 * width:.2g} ms / 1")
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
