"""Histogram of the distances with a normal and a robust fit (P2 Fig. 16a), and their quantiles."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from scipy.stats import norm

from thalweg.core.types import ArrayF
from thalweg.figures.accuracy.distances import (
    centimetres,
    compared,
    robust_fit,
    round_limit_m,
    statistics_text,
)
from thalweg.figures.style import BLUE, GREY, VERMILION, count, new_figure, styled

BINS: Final = 81
"""Bars of the histogram; an odd number, so that one stands on zero."""

QUANTILES: Final = 401
"""Points of the quantile plot."""

SIGMAS: Final = 3.9
"""End of the quantile plot: 1 of 20,000 values of a normal distribution lies beyond."""


@styled
def distance_histogram(
    table: pd.DataFrame,
    *,
    limit_m: float | None = None,
    title: str = "Distances of the cloud to the reference",
    twin: bool = False,
) -> Figure:
    """Histogram, the normal distributions of mean and std and of median and NMAD, and the quantiles beside.

    Parameters
    ----------
    table : of kind ``cloud_to_mesh``.
    limit_m : distance at both ends of the axis; twice that of the map by default.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : a column is missing.
    CoverageError : no point was compared.
    """
    used = compared(table)
    d = used["distance_m"].to_numpy(np.float64)
    kept = d[~used["outlier"].to_numpy(bool)]
    limit = limit_m or 2.0 * round_limit_m(d)
    head = f"{title}, n = {count(d.size)} points, {statistics_text(d, std=True)}"
    figure = new_figure(92.0, head, twin=twin)
    left, right = figure.subplots(1, 2, width_ratios=[1.75, 1.0])
    _bars(left, d, kept, limit)
    _quantiles(right, d, limit)
    return figure


def _bars(ax: Axes, d: ArrayF, kept: ArrayF, limit: float) -> None:
    edges = np.linspace(-limit, limit, BINS + 1)
    n, _ = np.histogram(d, edges)
    width = float(edges[1] - edges[0])
    ax.stairs(n, 100 * edges, fill=True, color="0.72", gid="histogram")
    x = np.linspace(-limit, limit, 601)
    median, nmad = robust_fit(d)
    without = f"normal fit without {count(d.size - kept.size)} outliers"
    fits = (
        ("normal fit: mean, std", float(np.mean(d)), float(np.std(d)), VERMILION, "-"),
        (without, float(np.mean(kept)), float(np.std(kept)), VERMILION, ":"),
        ("robust fit: median, NMAD", median, nmad, BLUE, "--"),
    )
    for k, (name, middle, spread, colour, dashes) in enumerate(fits):
        n_fit = kept.size if k == 1 else d.size
        if spread > 0 and not (k == 1 and kept.size == d.size):
            ax.plot(
                100 * x, n_fit * width * norm.pdf(x, middle, spread), color=colour, lw=1.5, ls=dashes,
                label=f"{name}: {centimetres(middle, sign=True)}, {centimetres(spread)}", gid=f"fit-{k}",
            )  # fmt: skip
    ax.axvline(0.0, color="black", lw=0.7, zorder=1)
    top = float(n.max()) * 1.42
    ax.set_xlim(-100 * limit, 100 * limit)
    ax.set_ylim(0.0, max(top, 1.0))
    low, high = int(np.sum(d < -limit)), int(np.sum(d > limit))
    beyond = f"{count(low)} behind, {count(high)} in front" if low + high else "none"
    ax.set_title(f"a: distances and fitted normal distributions\nbeyond the axis: {beyond}")
    ax.set_xlabel("behind  \N{LEFTWARDS ARROW}   signed distance / cm   \N{RIGHTWARDS ARROW}  in front")
    ax.set_ylabel(f"points per {100 * width:.2g} cm / 1")
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: count(int(value))))
    ax.grid(axis="y")
    if len(ax.lines) > 1:  # equal distances have no fit
        ax.legend(loc="upper left")


def _quantiles(ax: Axes, d: ArrayF, limit: float) -> None:
    """Quantiles of the distances over those of the standard normal: a straight line if they are normal."""
    z = np.linspace(-SIGMAS, SIGMAS, QUANTILES)
    z = z[(norm.cdf(z) >= 0.5 / d.size) & (norm.cdf(-z) >= 0.5 / d.size)]
    found = np.quantile(d, norm.cdf(z))
    median, nmad = robust_fit(d)
    ax.axhline(0.0, color="black", lw=0.7, zorder=1)
    ax.plot(z, 100 * (float(np.mean(d)) + np.std(d) * z), color=VERMILION, lw=1.5, label="normal fit")
    ax.plot(z, 100 * (median + nmad * z), color=BLUE, lw=1.5, ls="--", label="robust fit")
    ax.plot(z, 100 * found, color="black", ls="none", marker=".", ms=2.5, label="distances", gid="quantiles")
    ax.set_ylim(-100 * limit, 100 * limit)
    ax.set_xlim(-SIGMAS - 0.1, SIGMAS + 0.1)
    within = 100.0 * float(np.mean(np.abs(d - median) <= 1.959964 * nmad)) if nmad > 0 else 100.0
    ax.set_title(f"b: quantiles; {within:.1f} % within\n±1.96 NMAD (normal: 95 %)")
    ax.set_xlabel("quantile of the standard normal / 1")
    ax.set_ylabel("signed distance / cm")
    ax.grid(color=GREY, alpha=0.2)
