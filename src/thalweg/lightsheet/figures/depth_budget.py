"""What each parameter of a light-sheet sensor costs in depth, in reference depths (P4 Fig. 13)."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.core.errors import CoverageError
from thalweg.figures.style import GREY, new_figure, plural, styled
from thalweg.lightsheet.budget.budget import TOTAL, TOTAL_CORRELATED
from thalweg.lightsheet.figures.views import depth_looks, need

COLUMNS: Final = ("depth_mm", "x_px", "y_px", "panel", "cause", "sigma_depth_mm")
"""Columns of `thalweg.lightsheet.budget.budget.budget_on_lines`."""

PUBLISHED: Final = ("cause", "bound", "published_mm", "verdict")
"""Columns of `thalweg.lightsheet.budget.checks.verdicts`."""

OR: Final = " or "
"""Between causes for which P4 states one figure."""

ACROSS: Final = 4
"""Panels in a row."""

_MM_PER_ROW: Final = 37.0


@styled
def depth_budget(
    lines: pd.DataFrame,
    published: pd.DataFrame | None = None,
    *,
    title: str = "Sigma of the depth",
    twin: bool = False,
) -> Figure:
    """A panel for each cause that has a share, and for the total with and without correlations.

    Parameters
    ----------
    lines : columns `COLUMNS`.
    published : figures of P4 beside those of the same geometry, columns `PUBLISHED`; None to show none.
    title : first words of the title.
    twin : true if the digital twin made the data.

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
        f"{title} by cause in {plural(len(depths), 'depth')}, n = {plural(int(places.min()), 'place')} "
        "or more on each line"
    )
    rows = -(-len(causes) // ACROSS)
    figure = new_figure(20.0 + _MM_PER_ROW * rows, head, twin=twin)
    axes = figure.subplots(rows, ACROSS, sharex=True, squeeze=False)
    along = "y_px" if np.ptp(lines["y_px"]) >= np.ptp(lines["x_px"]) else "x_px"
    for k, (ax, cause) in enumerate(zip(axes.flat, causes, strict=False)):
        _panel(ax, lines, cause, along, depths, total=cause == TOTAL)
        _published(ax, published, cause)
        panel = str(lines.loc[lines["cause"] == cause, "panel"].fillna("").iloc[0])
        ax.set_title(f"{cause}" + (f" (P4: {panel})" if panel else ""))
        ax.set_ylim(0.0, 1.25 * ax.get_ylim()[1])
        if k + ACROSS >= len(causes):
            ax.set_xlabel("row / px" if along == "y_px" else "column / px")
            ax.tick_params(labelbottom=True)
        ax.grid()
    for ax in axes.flat[len(causes) :]:
        ax.axis("off")
    figure.supylabel("standard deviation of the depth / mm; each panel has its own scale", fontsize=8)
    _legend(figure, list(axes.flat[: len(causes)]))
    return figure


def _panel(
    ax: Axes, lines: pd.DataFrame, cause: str, along: str, depths: Sequence[float], *, total: bool
) -> None:
    looks = depth_looks(depths)
    for depth in depths:
        colour, style, _ = looks[depth]
        part = lines[(lines["depth_mm"] == depth) & (lines["cause"] == cause)]
        ax.plot(part[along], part["sigma_depth_mm"], color=colour, ls=style, lw=1.3,
                label=f"{depth:g} mm deep", gid=f"{cause} {depth:g}")  # fmt: skip
        whole = lines[(lines["depth_mm"] == depth) & (lines["cause"] == TOTAL_CORRELATED)]
        if total and len(whole):
            ax.plot(whole[along], whole["sigma_depth_mm"], color=colour, ls=style, lw=2.6, alpha=0.45,
                    gid=f"correlated {depth:g}")  # fmt: skip
    if total and (lines["cause"] == TOTAL_CORRELATED).any():
        ax.plot([], [], color=GREY, lw=2.6, alpha=0.6, label="broad: total with correlations")


def _published(ax: Axes, published: pd.DataFrame | None, cause: str) -> None:
    """The published figure as a line, with the verdict in words."""
    if published is None:
        return
    need(published, PUBLISHED, "published figures")
    mine = published[[cause in str(name).split(OR) for name in published["cause"]]]
    for _, row in mine.iterrows():
        ax.axhline(float(row["published_mm"]), color="black", lw=0.9, ls=(0, (1, 1)), gid="published",
                   label="as published in P4")  # fmt: skip
    most = mine[mine["bound"] == "most"]
    if len(most):
        several = len(str(most.iloc[0]["cause"]).split(OR))
        words = str(most.iloc[0]["verdict"]) + (f", most of {several}" if several > 1 else "")
        ax.text(0.03, 0.97, words, transform=ax.transAxes, va="top",
                fontsize=7, gid="verdict")  # fmt: skip


def _legend(figure: Figure, axes: Sequence[Axes]) -> None:
    found: dict[str, Artist] = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    figure.legend(list(found.values()), list(found), loc="outside lower left", ncols=6)
