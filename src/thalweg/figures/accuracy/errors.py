"""Errors found against errors predicted."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from thalweg.core.errors import InputError
from thalweg.core.types import ArrayB, ArrayF
from thalweg.figures.style import BLUE, VERMILION, count, legend_below, new_figure, styled

RANGE_COLUMNS = ("range_m", "n", "rmse_observed_m", "rmse_predicted_m")
HISTOGRAM_LIMIT = 5.0
"""Ends of the histograms of normalised errors, in sigmas; what lies beyond is counted in the title."""


@styled
def error_versus_range(
    table: pd.DataFrame,
    *,
    n_least: int = 30,
    outlier_rule: str = "",
    quantity: str = "3D error of a point",
    title: str = "Error versus range",
    twin: bool = False,
) -> Figure:
    """RMSE observed and predicted by range class, with their ratio and the number of points per class.

    Parameters
    ----------
    table : columns ``range_m`` (centre of the class), ``n``, ``rmse_observed_m``, ``rmse_predicted_m``, and
        optionally ``ratio_low95`` and ``ratio_high95``, the band of their ratio, the same in each row.
    n_least : classes with fewer points are drawn hollow: their RMSE is uncertain.
    outlier_rule : sentence on what was left out.
    quantity : what the RMSE is of.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : a column is missing, or the table has no row.
    """
    missing = [name for name in RANGE_COLUMNS if name not in table.columns]
    if missing or table.empty:
        raise InputError(
            f"columns missing: {missing}" if missing else "a table without a row",
            expected=f"columns {', '.join(RANGE_COLUMNS)} and at least one range class",
        )
    r, n = table["range_m"].to_numpy(float), table["n"].to_numpy(np.int64)
    observed = table["rmse_observed_m"].to_numpy(float) * 1e3
    predicted = table["rmse_predicted_m"].to_numpy(float) * 1e3
    figure = new_figure(118.0, f"{title}, n = {count(int(n.sum()))} points", twin=twin)
    upper, middle, lower = figure.subplots(3, 1, sharex=True, height_ratios=[2.6, 1.0, 1.0])
    many = n >= n_least
    upper.plot(r, predicted, color=VERMILION, lw=1.6, label="predicted", zorder=2)
    draw_observed(upper, r, observed, many, n_least=n_least, also=predicted)
    upper.set_ylabel("RMSE / mm")
    upper.set_title("\n".join(filter(None, [quantity, outlier_rule])))
    upper.legend(loc="upper left", ncols=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = observed / predicted
    if "ratio_low95" in table.columns:
        low, high = (float(table[f"ratio_{end}95"].iloc[0]) for end in ("low", "high"))
        middle.axhspan(low, high, color=VERMILION, alpha=0.12, lw=0, gid="band")
        text = "shaded: where honest sigmas leave the ratio of all points together, 95 %"
        middle.set_title(text, fontsize="small")
    middle.axhline(1.0, color=VERMILION, lw=1.0)
    middle.plot(r[many], ratio[many], color=BLUE, marker="o", lw=0.8, gid="ratio")
    usable = ratio[many & np.isfinite(ratio)]
    reach = float(np.clip(np.max(np.abs(usable - 1.0)), 0.1, 1.5)) * 1.15 if usable.size else 0.5
    if "ratio_high95" in table.columns:
        reach = max(reach, 1.1 * float(table["ratio_high95"].iloc[0] - 1.0))
    middle.set_ylim(max(0.0, 1 - reach), 1 + reach)
    middle.set_ylabel("observed /\npredicted / 1")
    width = 0.8 * float(np.min(np.diff(r))) if r.size > 1 else 0.8
    lower.bar(r, n, width=width, color="0.65", gid="counts")
    lower.set_yscale("log")
    lower.set_ylim(0.7, 2.0 * float(n.max()))
    lower.set_ylabel("points\nper class / 1")
    lower.set_xlabel("range / m")
    for ax in (upper, middle, lower):
        ax.grid(axis="y")
    figure.align_ylabels([upper, middle, lower])
    return figure


def draw_observed(
    ax: Axes, range_m: ArrayF, observed: ArrayF, many: ArrayB, *, n_least: int, also: ArrayF
) -> None:
    """Errors observed by range class; hollow dots for classes with few points, arrows for what is beyond.

    Sets the limits of the y axis: single classes with few points do not decide about them.

    Parameters
    ----------
    ax : where.
    range_m : (n,) centres of the classes.
    observed : (n,) in the unit of the axis.
    many : (n,) true for classes with at least ``n_least`` points.
    n_least : for the legend.
    also : values that have to be on the axis too.
    """
    ax.plot(range_m, observed, color=BLUE, lw=0.8, zorder=3)
    ax.plot(range_m[many], observed[many], color=BLUE, ls="none", marker="o", label="observed", zorder=4)
    if not many.all():
        ax.plot(
            range_m[~many], observed[~many], color=BLUE, ls="none", marker="o", mfc="white", zorder=4,
            label=f"observed, fewer than {n_least} points",
        )  # fmt: skip
    top = max(float(np.nanmax(also)), float(np.nanmax(observed[many] if many.any() else observed)))
    ax.set_ylim(0, 1.3 * top if top > 0 else 1.0)
    above = observed > ax.get_ylim()[1]
    if above.any():
        ax.plot(range_m[above], np.full(int(above.sum()), 0.97 * ax.get_ylim()[1]), color=BLUE, ls="none",
                marker="^", mfc="white", label=f"beyond the axis, n = {int(above.sum())}")  # fmt: skip


@styled
def error_histograms(
    normalised: Mapping[str, ArrayF],
    *,
    outlier_rule: str = "",
    title: str = "Errors divided by their predicted sigma",
    twin: bool = False,
) -> Figure:
    """Histograms of normalised errors against the standard normal density.

    Parameters
    ----------
    normalised : name of a component -> (n,) errors over their sigmas; NaN are left out.
    outlier_rule : sentence on what was left out.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : no component, or one without a finite value.
    """
    if not normalised:
        raise InputError("no normalised errors", expected="at least one component")
    clean = {name: np.asarray(v, dtype=np.float64) for name, v in normalised.items()}
    clean = {name: v[np.isfinite(v)] for name, v in clean.items()}
    for name, v in clean.items():
        if not v.size:
            raise InputError(f"component '{name}' has no finite normalised error", expected="numbers")
    largest = max(v.size for v in clean.values())
    figure = new_figure(78.0, f"{title}, n = {count(largest)} points", twin=twin)
    panels = figure.subplots(1, len(clean), sharey=True, squeeze=False)[0]
    for ax, (name, values) in zip(panels, clean.items(), strict=True):
        _histogram(ax, name, values)
    panels[0].set_ylabel("density / 1")
    legend_below(figure, panels[0], title=outlier_rule or None)
    return figure


def _histogram(ax: Axes, name: str, values: ArrayF) -> None:
    edges = np.linspace(-HISTOGRAM_LIMIT, HISTOGRAM_LIMIT, 51)
    n, _ = np.histogram(values, edges)
    # Over all values, also those beyond the ends: the bars then compare with the density as they stand.
    density = n / (values.size * np.diff(edges))
    ax.stairs(density, edges, fill=True, color=BLUE, alpha=0.45, label="errors found", gid="histogram")
    x = np.linspace(-HISTOGRAM_LIMIT, HISTOGRAM_LIMIT, 201)
    ax.plot(x, norm.pdf(x), color=VERMILION, lw=1.4, label="standard normal")
    beyond = int(np.sum(np.abs(values) > HISTOGRAM_LIMIT))
    inside = 100.0 * float(np.mean(np.abs(values) <= 1.959964))
    ax.set_title(
        f"{name}: n = {count(values.size)}\nmean {np.mean(values):+.2f}, std {np.std(values):.2f}\n"
        f"{inside:.1f} % within ±1.96 (normal: 95 %)\n{count(beyond)} beyond ±{HISTOGRAM_LIMIT:g}",
        fontsize=7,
    )
    ax.set_xlim(-HISTOGRAM_LIMIT, HISTOGRAM_LIMIT)
    ax.set_xlabel("error over predicted sigma / 1")
