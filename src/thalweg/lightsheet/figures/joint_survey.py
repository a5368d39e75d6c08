"""Echo sounder and light sheet on a small river: what each measures of its bed (T Fig. 3.5)."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.figures.style import BLUE, GREEN, GREY, count, legend_below, new_figure, styled
from thalweg.lightsheet.figures.views import WATER_COLOUR, need

PLACES: Final = ("along_m", "across_m", "depth_m", "instrument")
TABLE: Final = ("from_m", "to_m", "area_m2", "share_echo", "share_laser", "share_joint")
LOOKS: Final = (("echo sounder", BLUE), ("light sheet", GREEN))
_MOST: Final = 20_000


@styled
def joint_survey_figure(
    places: pd.DataFrame,
    table: pd.DataFrame,
    facts: Mapping[str, Any],
    *,
    title: str = "Joint survey of a small river",
    twin: bool = True,
) -> Figure:
    """Cross-section and plan of a simulated survey, and the share of the bed that is measured by depth.

    Parameters
    ----------
    places : columns `PLACES`; ``instrument`` is section, track, echo sounder or light sheet.
    table : columns `TABLE`, see `thalweg.lightsheet.scanning.joint_survey`.
    facts : of the same survey: ``rmse_section_echo_m`` and ``_joint_m``.
    title : first words of the title.
    twin : true if the survey is simulated, as it is here always.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    """
    need(places, PLACES, "places of the survey"), need(table, TABLE, "shares by depth")
    own = {name: places[places["instrument"] == name] for name, _ in LOOKS}
    alone, joint = (
        f"{100 * facts[f'rmse_section_{name}_m']:.1f}\N{NO-BREAK SPACE}cm" for name in ("echo", "joint")
    )
    head = (
        f"{title}: error of the interpolated section {alone} by the echo sounder, "
        f"{joint} with the light sheet, "
        f"n = {count(len(own['echo sounder']))} soundings"
    )
    figure = new_figure(150.0, head, twin=twin)
    grid = figure.add_gridspec(3, 2, height_ratios=[1.0, 1.0, 1.0], width_ratios=[2.2, 1.0])
    section = places[places["instrument"] == "section"]
    whole, shallow = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, :])
    for ax, words in ((whole, "a: cross-section"), (shallow, "b: its shallow part")):
        _section(ax, section, own)
        ax.set(title=words, ylabel="depth / m", xlim=(section["across_m"].min(), section["across_m"].max()))
    deepest = float(section["depth_m"].max())
    whole.set_ylim(1.06 * deepest, -0.08 * deepest)
    shallow.set_ylim(0.3, -0.02)
    shallow.set_xlabel("across the river / m")
    _plan(figure.add_subplot(grid[2, 0]), places[places["instrument"] == "track"], own)
    _shares(figure.add_subplot(grid[2, 1]), table)
    legend_below(figure, shallow)
    return figure


def _section(ax: Axes, section: pd.DataFrame, own: Mapping[str, pd.DataFrame]) -> None:
    ax.fill_between(section["across_m"], 0.0, section["depth_m"], color=WATER_COLOUR, lw=0)
    ax.plot(section["across_m"], section["depth_m"], color="0.35", lw=0.9, label="bed", gid="bed")
    ax.axhline(0.0, color=BLUE, lw=0.6)
    for name, colour in LOOKS:
        mine = own[name].iloc[:: max(1, len(own[name]) // _MOST)]
        ax.plot(mine["across_m"], mine["depth_m"], ls="none", marker=".", ms=3.0, mew=0, color=colour,
                label=f"{name}, n = {count(len(own[name]))}", gid=name, rasterized=True)  # fmt: skip
    ax.grid()


def _plan(ax: Axes, track: pd.DataFrame, own: Mapping[str, pd.DataFrame]) -> None:
    ax.plot(track["along_m"], track["across_m"], color=GREY, lw=0.5, gid="track")
    for name, colour in LOOKS:
        mine = own[name].iloc[:: max(1, len(own[name]) // _MOST)]
        ax.plot(mine["along_m"], mine["across_m"], ls="none", marker=".", ms=1.4, mew=0, color=colour,
                gid=f"plan {name}", rasterized=True)  # fmt: skip
    ax.set(title="c: from above, with the boat's way", xlabel="along the river / m", ylabel="across / m")
    ax.set_aspect("equal", adjustable="datalim")


def _shares(ax: Axes, table: pd.DataFrame) -> None:
    """Share of the bed's area that was measured, by class of depth."""
    place = np.arange(len(table), dtype=np.float64)
    kinds = (("share_echo", BLUE, -0.27), ("share_laser", GREEN, 0.0), ("share_joint", GREY, 0.27))
    for column, colour, aside in kinds:
        ax.barh(place + aside, 100 * table[column], height=0.25, color=colour, gid=column)
    names = [
        f"{low:g} to {high:g} m" if np.isfinite(high) else f"over {low:g} m"
        for low, high in zip(table["from_m"], table["to_m"], strict=True)
    ]
    ax.set_yticks(place, names)
    ax.invert_yaxis()
    ax.set(title="d: measured area (grey: both)", xlabel="share of the bed / %")
    ax.grid(axis="x")
