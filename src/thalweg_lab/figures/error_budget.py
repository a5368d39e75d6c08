"""Where the error of a point comes from, over its distance: budgets side by side."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.budgets import GROUPS, TOTAL, Budget, read_budget, totals_mm
from thalweg.core import ArrayF, InputError
from thalweg.figures import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION, legend_below, new_figure, styled
from thalweg_lab.reproduction import group_shares, read_published

FARTHEST_M: Final = 60.0
STYLE: Final = {
    "lidar": (SKY, ""),
    "position": (BLUE, "////"),
    "lever arm": (GREEN, "...."),
    "boresight": (PURPLE, "\\\\\\\\"),
    "attitude": (ORANGE, ""),
    "timing": (VERMILION, "xxxx"),
}
"""Colour and hatching of each group, from below: told apart in grey print as well."""


@styled
def error_budget(budgets: Sequence[Budget], published: Sequence[pd.DataFrame | None]) -> Figure:
    """Total and shares of the variance over distance for each budget, published totals as points.

    In the upper panels the height is the 3D standard deviation; it is divided in proportion to the variances.
    The lower panels show the same shares of 100 %.

    Parameters
    ----------
    budgets : side by side, one or more.
    published : cells of each, or None.

    Raises
    ------
    InputError : no budget, or one with correlations, whose terms have no place in a stack.
    """
    if not budgets or any(budget.correlations for budget in budgets):
        raise InputError(
            "correlated budgets" if budgets else "no budget",
            expected="budgets without correlations: covariance terms may be negative and cannot be stacked",
        )
    d = np.linspace(1.0, FARTHEST_M, 237)
    figure = new_figure(112.0, "Where the error of a point comes from, by its distance")
    axes = figure.subplots(
        2, len(budgets), sharex=True, sharey="row", squeeze=False, height_ratios=[1.5, 1.0]
    )
    for k, (budget, cells) in enumerate(zip(budgets, published, strict=True)):
        total = totals_mm(budget, d)
        shares = group_shares(budget, d).reindex(columns=list(GROUPS), fill_value=0.0)
        stacked = [shares[group].to_numpy() for group in STYLE]
        _stack(axes[0, k], d, [share * total for share in stacked])
        _stack(axes[1, k], d, [100 * share for share in stacked])
        axes[0, k].plot(d, total, color="black", lw=1.2, label="total", gid="total")
        if cells is not None:
            points = cells[(cells["input"] == TOTAL) & cells["distance_m"].notna()]
            axes[0, k].plot(
                points["distance_m"],
                points["value_mm"],
                "o",
                label="total as published",
                mfc="white",
                mec="black",
                ms=5,
                zorder=5,
                gid="published",
            )
        axes[0, k].set_title(f"{budget.title}\n{budget.source}; geometry {budget.status}", fontsize="small")
        axes[1, k].set_xlabel("distance / m")
    axes[0, 0].set_ylabel("3D standard deviation / mm,\ndivided as the variances")
    axes[1, 0].set_ylabel("share of variance / %")
    axes[0, 0].set(xlim=(1, FARTHEST_M), ylim=(0, None))
    axes[1, 0].set_ylim(0, 100)
    figure.align_ylabels(list(axes[:, 0]))
    legend_below(figure, axes[0, 0])
    return figure


def _stack(ax: Axes, d: ArrayF, parts: list[ArrayF]) -> None:
    below = np.zeros_like(d)
    for group, part in zip(STYLE, parts, strict=True):
        colour, hatch = STYLE[group]
        ax.fill_between(
            d,
            below,
            below + part,
            facecolor=colour,
            edgecolor=(1, 1, 1, 0.55),
            hatch=hatch,
            lw=0.0,
            label=group,
            gid=group,
        )
        below = below + part
        ax.plot(d, below, color="white", lw=0.5)


def draw_error_budget(*, budgets: list[Path], published: list[Path]) -> Figure:
    """Error budgets of both ways of orientation -> shares of their inputs over distance."""
    return error_budget([read_budget(path) for path in budgets], [read_published(path) for path in published])
