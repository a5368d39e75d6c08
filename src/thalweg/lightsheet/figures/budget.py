"""Budget of the depth by cause, and errors that simpler models of the sheet leave."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.core import CoverageError
from thalweg.figures import GREY, legend_below, new_figure, plural, styled
from thalweg.lightsheet.budget import TOTAL, TOTAL_CORRELATED
from thalweg.lightsheet.figures.views import depth_styles, need

COLUMNS: Final = ("depth_mm", "x_px", "y_px", "panel", "cause", "sigma_depth_mm")
"""Columns of `thalweg.lightsheet.budget.budget.budget_on_lines`."""
ACROSS: Final = 4
"""Panels in a row."""
_MM_PER_ROW: Final = 37.0
_LEAST_MM: Final = 84.0
"""One row of panels holds the words of the axis that all share."""


# ---------------------------------------------------------------- budget of the depth (P4 Fig. 13)


@styled
def depth_budget(lines: pd.DataFrame, *, title: str) -> Figure:
    """A panel for each cause that has a share, and for the total with and without correlations.

    Parameters
    ----------
    lines : columns `COLUMNS`.
    title : first words of the title.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    CoverageError : no cause has a share.
    """
    need(lines, COLUMNS, "a budget along lines of equal depth")
    depths = sorted(float(depth) for depth in lines["depth_mm"].unique())
    most = lines.groupby("cause", sort=False)["sigma_depth_mm"].max()
    causes = [str(name) for name in most.index if most[name] > 0.0 and name != TOTAL_CORRELATED]
    if not causes:
        raise CoverageError("no cause of errors", expected="a sensor with a covariance")
    places = lines[lines["cause"] == causes[0]].groupby("depth_mm").size()
    head = (
        f"{title}: sigma of the depth by cause in {plural(len(depths), 'depth')}, "
        f"n = {plural(places.min(), 'place')} or more on each line"
    )
    rows = -(-len(causes) // ACROSS)
    figure = new_figure(max(20.0 + _MM_PER_ROW * rows, _LEAST_MM), head)
    axes = figure.subplots(rows, ACROSS, sharex=True, squeeze=False)
    along = "y_px" if np.ptp(lines["y_px"]) >= np.ptp(lines["x_px"]) else "x_px"
    for k, (ax, cause) in enumerate(zip(axes.flat, causes, strict=False)):
        _panel(ax, lines, cause, along, depths, total=cause == TOTAL)
        panel = str(lines.loc[lines["cause"] == cause, "panel"].fillna("").iloc[0])
        ax.set_title(f"{cause}" + (f" (P4: {panel})" if panel else ""))
        ax.set_ylim(0.0, 1.25 * ax.get_ylim()[1])
        if k + ACROSS >= len(causes):
            ax.set_xlabel("row / px" if along == "y_px" else "column / px")
            ax.tick_params(labelbottom=True)
        ax.grid()
    for ax in axes.flat[len(causes) :]:
        ax.axis("off")
    label = "standard deviation of the depth / mm; each panel has its own scale"
    figure.supylabel(label if rows > 1 else label.replace("; ", ";\n"), fontsize=8)
    legend_below(figure, *axes.flat[: len(causes)])
    return figure


def _panel(
    ax: Axes, lines: pd.DataFrame, cause: str, along: str, depths: Sequence[float], *, total: bool
) -> None:
    looks = depth_styles(depths)
    for depth in depths:
        colour, style, _ = looks[depth]
        part = lines[(lines["depth_mm"] == depth) & (lines["cause"] == cause)]
        ax.plot(
            part[along],
            part["sigma_depth_mm"],
            color=colour,
            ls=style,
            lw=1.3,
            label=f"{depth:g} mm deep",
            gid=f"{cause} {depth:g}",
        )
        whole = lines[(lines["depth_mm"] == depth) & (lines["cause"] == TOTAL_CORRELATED)]
        if total and len(whole):
            ax.plot(whole[along], whole["sigma_depth_mm"], color=colour, ls=style, lw=2.6, alpha=0.45)
    if total and (lines["cause"] == TOTAL_CORRELATED).any():
        ax.plot([], [], color=GREY, lw=2.6, alpha=0.6, label="broad: total with correlations")
