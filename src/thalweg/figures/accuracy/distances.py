"""Distances of a cloud from a reference and errors against a truth: histograms, and by range."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator
from scipy.stats import norm

from thalweg.accuracy import ALL, AS_MEASURED, LEAST, WITHOUT_OUTLIERS
from thalweg.core import ArrayB, ArrayF, CoverageError, InputError, robust_sigma, root_mean_square
from thalweg.figures import BLUE, GREY, RED, VERMILION, count, legend_below, new_figure, styled
from thalweg.surface import BankFrame

COLUMNS: Final = ("east_m", "north_m", "up_m", "distance_m", "at_border", "used", "outlier")
"""Columns of a comparison that the figures need."""
_TIE: Final = "\N{NO-BREAK SPACE}"

BINS: Final = 81
"""Bars of the histogram; an odd number, so that one stands on zero."""
QUANTILES: Final = 401
"""Points of the quantile plot."""
SIGMAS: Final = 3.9
"""End of the quantile plot: 1 of 20,000 values of a normal distribution lies beyond."""


MOST_RATIO: Final = 4.0
"""Ratios are drawn up to this and down to its inverse."""


# ---------------------------------------------------------------- what the figures of distances share


def bank_frame_of(mesh_facts: Mapping[str, Any]) -> BankFrame:
    """The frame of the bank that the facts of a reference mesh state.

    Raises
    ------
    InputError : the facts name no bank frame.
    """
    stated = mesh_facts.get("bank_frame")
    if not stated:
        raise InputError(
            "facts of a mesh without a bank frame",
            expected="'bank_frame' with 'origin_m' and 'R_bank_wcs'",
            cure="Mesh the reference again with this version of Thalweg",
        )
    return BankFrame(
        origin_m=np.asarray(stated["origin_m"], dtype=np.float64),
        R_bank_wcs=np.asarray(stated["R_bank_wcs"], dtype=np.float64),
    )


def compared(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of a comparison that count.

    Raises
    ------
    CoverageError : no row counts.
    """
    used = table[table["used"].to_numpy(bool)]
    if used.empty:
        raise CoverageError(
            f"none of {len(table)} points was compared with the reference",
            expected="points near the reference and not only at its border",
            cure="See the counts of the comparison; take a larger accuracy.area or accuracy.max_distance_m",
        )
    return used


def statistics_text(distance_m: ArrayF, *, std: bool = False) -> str:
    """``mean +4.1 cm, RMSE 9.8 cm``, on request with the standard deviation between them."""
    mean, rmse = float(np.mean(distance_m)), root_mean_square(distance_m)
    parts = [f"mean{_TIE}{centimetres(mean, sign=True)}", f"RMSE{_TIE}{centimetres(rmse)}"]
    spread = [f"std{_TIE}{centimetres(float(np.std(distance_m)))}"] if std else []
    return ", ".join([parts[0], *spread, parts[1]])


def centimetres(value_m: float, *, sign: bool = False) -> str:
    """A length in centimetres that no line break tears apart.

    Examples
    --------
    >>> centimetres(-0.0412, sign=True).split("\N{NO-BREAK SPACE}")
    ['−4.1', 'cm']
    """
    digits = ".1f" if abs(value_m) >= 5e-4 or not value_m else ".2g"  # small is not nothing
    text = f"{100 * value_m:{'+' if sign else ''}{digits}}".replace("-", "\N{MINUS SIGN}")
    return f"{text}{_TIE}cm"


def robust_fit(distance_m: ArrayF) -> tuple[float, float]:
    """Median and NMAD."""
    median = float(np.median(distance_m))
    return median, robust_sigma(distance_m, median)


def round_above(value: float) -> float:
    """The smallest of 1, 1.5, 2, 3, 5 times a power of ten that is not below a positive value.

    Examples
    --------
    >>> [round_above(x) for x in (0.12, 0.2, 40.0, 0.7)]
    [0.15, 0.2, 50.0, 1.0]
    """
    power = 10.0 ** np.floor(np.log10(value))
    return round(float(min(f * power for f in (1, 1.5, 2, 3, 5, 10) if f * power >= value * (1 - 1e-9))), 12)


def round_limit_m(distance_m: ArrayF) -> float:
    """Round end of a symmetric scale: the median and three NMAD about it are inside.

    Examples
    --------
    >>> round_limit_m(np.array([-0.1, 0.0, 0.1]))
    0.5
    """
    median, nmad = robust_fit(distance_m)
    return round_above(abs(median) + 3.0 * nmad or 1e-3)


# ---------------------------------------------------------------- histogram with normal and robust fit (P2
# Fig. 16a)


@styled
def distance_histogram(
    table: pd.DataFrame, *, limit_m: float | None = None, title: str = "Distances to the reference"
) -> Figure:
    """Histogram, the normal distributions of mean and std and of median and NMAD, and the quantiles beside.

    Parameters
    ----------
    table : of kind ``cloud_to_mesh``.
    limit_m : distance at both ends of the axis; twice that of the map by default.
    title : first words of the title.

    Raises
    ------
    InputError : a column is missing.
    CoverageError : no point was compared.
    """
    used = compared(table)
    d = used["distance_m"].to_numpy()
    kept = d[~used["outlier"].to_numpy(bool)]
    limit = limit_m or 2.0 * round_limit_m(d)
    head = f"{title}, n = {count(d.size)} points, {statistics_text(d, std=True)}"
    figure = new_figure(92.0, head)
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
                100 * x,
                n_fit * width * norm.pdf(x, middle, spread),
                color=colour,
                lw=1.5,
                ls=dashes,
                label=f"{name}: {centimetres(middle, sign=True)}, {centimetres(spread)}",
                gid=f"fit-{k}",
            )
    ax.axvline(0.0, color="black", lw=0.7, zorder=1)
    top = float(n.max()) * 1.42
    ax.set_xlim(-100 * limit, 100 * limit)
    ax.set_ylim(0.0, max(top, 1.0))
    low, high = int(np.sum(d < -limit)), int(np.sum(d > limit))
    beyond = f"{count(low)} behind, {count(high)} in front" if low + high else "none"
    ax.set_title(f"a: distances and fitted normal distributions\nbeyond the axis: {beyond}")
    ax.set_xlabel("behind  \N{LEFTWARDS ARROW}   signed distance / cm   \N{RIGHTWARDS ARROW}  in front")
    ax.set_ylabel(f"points per {100 * width:.2g} cm")
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: count(value)))
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
    ax.plot(z, 100 * (np.mean(d) + np.std(d) * z), color=VERMILION, lw=1.5, label="normal fit")
    ax.plot(z, 100 * (median + nmad * z), color=BLUE, lw=1.5, ls="--", label="robust fit")
    ax.plot(z, 100 * found, ".", color="black", ms=2.5, label="distances")
    ax.set_ylim(-100 * limit, 100 * limit)
    ax.set_xlim(-SIGMAS - 0.1, SIGMAS + 0.1)
    within = 100.0 * float(np.mean(np.abs(d - median) <= 1.959964 * nmad)) if nmad > 0 else 100.0
    ax.set_title(f"b: quantiles; {within:.1f} % within\n±1.96 NMAD (normal: 95 %)")
    ax.set_xlabel("quantile of the standard normal")
    ax.set_ylabel("signed distance / cm")
    ax.grid(color=GREY, alpha=0.2)


# ---------------------------------------------------------------- observed and predicted distances by range
# (P2 Fig. 16b)


def outlier_rule(nmads: float | None) -> str:
    """A further line of a title: which points count as outliers."""
    if nmads is None:
        return ""
    return f"\nwithout points whose distance over its sigma is farther than {nmads:g} NMAD from the median"


@styled
def distance_by_range(
    table: pd.DataFrame,
    *,
    outlier_nmads: float | None = None,
    title: str = "Distance to the reference by range",
) -> Figure:
    """RMSE observed and predicted by range class, points per class in red, and predicted over observed.

    Parameters
    ----------
    table : columns ``points`` ("all", "without outliers"), ``range_m`` (centre of the class), ``n``,
        ``rmse_observed_m``, ``rmse_predicted_m`` (what a comparison with a surface can see),
        ``rmse_predicted_3d_m`` (P2 eq. 9), ``ratio`` (predicted over observed), ``ratio_low95`` and
        ``ratio_high95`` (band of the class), ``inside`` (is it in its band?); of a column ``registration``
        the rows "as measured" are drawn.
    outlier_nmads : limit of the outlier rule; None: there is none.
    title : first words of the title.

    Raises
    ------
    InputError : a column is missing, or no row is left.
    """
    kept, everything = _rows(table)
    r, n = kept["range_m"].to_numpy(), kept["n"].to_numpy(np.int64)
    observed, normal, full = (
        1e3 * kept[f"rmse_{name}_m"].to_numpy() for name in ("observed", "predicted", "predicted_3d")
    )
    many = n >= LEAST
    figure = new_figure(122.0, f"{title}, n = {count(n.sum())} points")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.5, 1.0])
    _draw_rmse(upper, r, observed, normal, full, many, everything)
    upper.set_title(f"distance along the normal of the reference{outlier_rule(outlier_nmads)}")
    _draw_counts(upper, r, n)
    _draw_ratio(lower, kept, many)
    legend_below(figure, upper)
    lower.set_xlabel("range / m")
    for ax in (upper, lower):
        ax.grid(axis="y")
    figure.align_ylabels([upper, lower])
    return figure


def _rows(table: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Rows without outliers, and those of all points; the latter stand for both where there is no rule."""
    table = table[table["registration"] == AS_MEASURED]
    everything, kept = (table[table["points"] == which] for which in (ALL, WITHOUT_OUTLIERS))
    kept = kept if len(kept) else everything
    return kept.sort_values("range_m"), everything.sort_values("range_m")


def _draw_rmse(
    ax: Axes,
    r: ArrayF,
    observed: ArrayF,
    normal: ArrayF,
    full: ArrayF,
    many: ArrayB,
    everything: pd.DataFrame,
) -> None:
    ax.plot(r, full, color=GREY, lw=1.4, ls=":", label="predicted, all three components (P2 eq. 9)", gid="3d")
    words = "predicted, normal component and reference"
    ax.plot(r, normal, color=VERMILION, lw=1.6, ls="--", label=words, gid="normal")
    ax.plot(r, observed, color=BLUE, lw=0.8, zorder=3)
    ax.plot(r[many], observed[many], "o", color=BLUE, label="observed", zorder=4)
    hollow: dict[str, Any] = {"color": BLUE, "mfc": "white"}
    if not many.all():
        few = f"observed, fewer than {LEAST} points"
        ax.plot(r[~many], observed[~many], "o", **hollow, zorder=4, label=few)
    # single classes with few points do not decide about the axis
    certain = observed[many] if many.any() else observed
    top = float(np.nanmax(np.concatenate([normal, full, certain])))
    ax.set_ylim(0, 1.3 * top if top > 0 else 1.0)
    above = observed > ax.get_ylim()[1]
    if above.any():
        words = f"beyond the axis, n = {above.sum()}"
        ax.plot(r[above], np.full(above.sum(), 0.97 * ax.get_ylim()[1]), "^", **hollow, label=words)
    if len(everything):
        ax.plot(
            everything["range_m"],
            1e3 * everything["rmse_observed_m"],
            color=BLUE,
            lw=0.7,
            ls=(0, (1, 1.5)),
            label="observed, outliers included",
            zorder=1,
        )
    ax.set_ylabel("RMSE / mm")


def _draw_counts(ax: Axes, r: ArrayF, n: ArrayF) -> None:
    """Points per class in red on an axis of their own, as the paper draws them."""
    right = ax.twinx()
    right.step(r, n, where="mid", color=RED, lw=0.9)
    # The curves of the errors keep the upper part of the panel.
    right.set_ylim(0.0, 2.2 * n.max())
    right.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    right.yaxis.set_major_formatter(FuncFormatter(lambda value, _: count(value)))
    right.set_ylabel("points per class of 1 m", color=RED)
    right.tick_params(axis="y", colors=RED, labelcolor=RED)
    right.spines["right"].set_visible(True)
    right.spines["right"].set_color(RED)
    ax.set_zorder(right.get_zorder() + 1)
    ax.patch.set_visible(False)


def _draw_ratio(ax: Axes, kept: pd.DataFrame, many: ArrayB) -> None:
    r = kept["range_m"].to_numpy()
    ratio, low, high = (kept[name].to_numpy() for name in ("ratio", "ratio_low95", "ratio_high95"))
    shown, outside = np.isfinite(ratio), ~kept["inside"].to_numpy(bool)
    ax.fill_between(r, low, high, step="mid", color=VERMILION, alpha=0.15, lw=0)
    ax.axhline(1.0, color=VERMILION, lw=1.0, ls="--")
    ax.plot(r[shown], ratio[shown], color=BLUE, lw=0.8, marker="o", gid="ratio")
    ax.plot(r[shown & ~many], ratio[shown & ~many], "o", color=BLUE, mfc="white")
    ax.plot(r[outside], ratio[outside], "o", ms=6.5, mfc="none", mec="black", mew=0.9)
    values = np.concatenate([ratio[shown], low[many], high[many], [0.5, 2.0]])
    values = np.clip(values[np.isfinite(values) & (values > 0)], 1.0 / MOST_RATIO, MOST_RATIO)
    ax.set_yscale("log", base=2)
    ax.set_ylim(0.9 * values.min(), 1.1 * values.max())
    ax.yaxis.set_major_locator(FixedLocator([0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0]))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.set_ylabel("predicted /\nobserved")
    n_outside = int(outside.sum())
    words = f"ringed: {n_outside} of {len(r)} classes outside" if n_outside else f"all {len(r)} inside"
    ax.set_title(f"shaded: 95 % acceptance band for the ratio of a class; {words}", fontsize="small")
