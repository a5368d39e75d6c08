"""Distances to the reference by range, observed against predicted (P2 Fig. 16b)."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from thalweg.accuracy.cloud_to_mesh.comparison_tables import ALL, AS_MEASURED, WITHOUT_OUTLIERS
from thalweg.core.errors import InputError
from thalweg.core.types import ArrayB, ArrayF
from thalweg.figures.accuracy.errors import draw_observed
from thalweg.figures.style import BLUE, GREY, RED, VERMILION, count, legend_below, new_figure, styled

COLUMNS: Final = (
    "points", "range_m", "n", "rmse_observed_m", "rmse_predicted_m", "rmse_predicted_3d_m", "ratio",
    "ratio_low95", "ratio_high95", "inside",
)  # fmt: skip

MOST_RATIO: Final = 4.0
"""Ratios are drawn up to this and down to its inverse."""


@styled
def distance_by_range(
    table: pd.DataFrame,
    *,
    n_least: int = 30,
    outlier_rule: str = "",
    title: str = "Distance to the reference by range",
    twin: bool = False,
) -> Figure:
    """RMSE observed and predicted by range class, points per class in red, and predicted over observed.

    Parameters
    ----------
    table : columns ``points`` ("all", "without outliers"), ``range_m`` (centre of the class), ``n``,
        ``rmse_observed_m``, ``rmse_predicted_m`` (what a comparison with a surface can see),
        ``rmse_predicted_3d_m`` (P2 eq. 9), ``ratio`` (predicted over observed), ``ratio_low95`` and
        ``ratio_high95`` (band of the class), ``inside`` (is it in its band?); of a column ``registration``
        the rows "as measured" are drawn.
    n_least : classes with fewer points are drawn hollow: their RMSE is uncertain.
    outlier_rule : sentence on what the outlier rule is.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : a column is missing, or no row is left.
    """
    kept, everything = _rows(table)
    r, n = kept["range_m"].to_numpy(np.float64), kept["n"].to_numpy(np.int64)
    observed, normal, full = (
        1e3 * kept[f"rmse_{name}_m"].to_numpy(np.float64)
        for name in ("observed", "predicted", "predicted_3d")
    )
    many = n >= n_least
    figure = new_figure(122.0, f"{title}, n = {count(int(n.sum()))} points", twin=twin)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.5, 1.0])
    _draw_rmse(upper, r, observed, normal, full, many, n_least, everything)
    upper.set_title("\n".join(filter(None, ["distance along the normal of the reference", outlier_rule])))
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
    missing = [name for name in COLUMNS if name not in table.columns]
    if missing:
        raise InputError(f"columns missing: {missing}", expected=f"columns {', '.join(COLUMNS)}")
    if "registration" in table.columns:
        table = table[table["registration"] == AS_MEASURED]
    everything, kept = (table[table["points"] == which] for which in (ALL, WITHOUT_OUTLIERS))
    kept = kept if len(kept) else everything
    if kept.empty:
        raise InputError(
            f"no row of points '{ALL}' or '{WITHOUT_OUTLIERS}'", expected="at least one range class"
        )
    return kept.sort_values("range_m"), everything.sort_values("range_m")


def _draw_rmse(
    ax: Axes,
    r: ArrayF,
    observed: ArrayF,
    normal: ArrayF,
    full: ArrayF,
    many: ArrayB,
    n_least: int,
    everything: pd.DataFrame,
) -> None:
    ax.plot(r, full, color=GREY, lw=1.4, ls=":", label="predicted, all three components (P2 eq. 9)", gid="3d")
    words = "predicted, normal component and reference"
    ax.plot(r, normal, color=VERMILION, lw=1.6, ls="--", label=words, gid="normal")
    draw_observed(ax, r, observed, many, n_least=n_least, also=np.concatenate([normal, full]))
    if len(everything):
        ax.plot(
            everything["range_m"], 1e3 * everything["rmse_observed_m"], color=BLUE, lw=0.7, ls=(0, (1, 1.5)),
            label="observed, outliers included", gid="all", zorder=1,
        )  # fmt: skip
    ax.set_ylabel("RMSE / mm")


def _draw_counts(ax: Axes, r: ArrayF, n: ArrayF) -> None:
    """Points per class in red on an axis of their own, as the paper draws them."""
    right = ax.twinx()
    right.step(r, n, where="mid", color=RED, lw=0.9, gid="counts")
    # The curves of the errors keep the upper part of the panel.
    right.set_ylim(0.0, 2.2 * float(n.max()))
    right.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    right.yaxis.set_major_formatter(FuncFormatter(lambda value, _: count(int(value))))
    right.set_ylabel("points per class of 1 m / 1", color=RED)
    right.tick_params(axis="y", colors=RED, labelcolor=RED)
    right.spines["right"].set_visible(True)
    right.spines["right"].set_color(RED)
    ax.set_zorder(right.get_zorder() + 1)
    ax.patch.set_visible(False)


def _draw_ratio(ax: Axes, kept: pd.DataFrame, many: ArrayB) -> None:
    r = kept["range_m"].to_numpy(np.float64)
    ratio, low, high = (kept[name].to_numpy(np.float64) for name in ("ratio", "ratio_low95", "ratio_high95"))
    shown, outside = np.isfinite(ratio), ~kept["inside"].to_numpy(bool)
    ax.fill_between(r, low, high, step="mid", color=VERMILION, alpha=0.15, lw=0, gid="band")
    ax.axhline(1.0, color=VERMILION, lw=1.0, ls="--")
    ax.plot(r[shown], ratio[shown], color=BLUE, lw=0.8, marker="o", gid="ratio")
    ax.plot(r[shown & ~many], ratio[shown & ~many], color=BLUE, ls="none", marker="o", mfc="white")
    ax.plot(
        r[outside], ratio[outside], ls="none", marker="o", ms=6.5, mfc="none", mec="black", mew=0.9,
        gid="outside",
    )  # fmt: skip
    values = np.concatenate([ratio[shown], low[many], high[many], [0.5, 2.0]])
    values = np.clip(values[np.isfinite(values) & (values > 0)], 1.0 / MOST_RATIO, MOST_RATIO)
    ax.set_yscale("log", base=2)
    ax.set_ylim(0.9 * float(values.min()), 1.1 * float(values.max()))
    ax.yaxis.set_major_locator(FixedLocator([0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0]))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.set_ylabel("predicted /\nobserved / 1")
    n_outside = int(outside.sum())
    words = f"ringed: {n_outside} of {len(r)} classes outside" if n_outside else f"all {len(r)} inside"
    ax.set_title(f"shaded: where honest sigmas leave the ratio of a class, 95 %; {words}", fontsize="small")
