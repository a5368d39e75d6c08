"""Echo sounder and light sheet on a small river, as in T Fig. 3.5."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.figures import BLUE, DEPTH_MAP, GREEN, VERMILION, count, mark_twin, new_figure, styled

_CM_PER_M: Final = 100.0
_ERROR_CM: Final = 20.0
_MARKS: Final = (("sounding", "echo soundings", BLUE, 3.0), ("light sheet", "light sheet", GREEN, 2.0))


@styled
def joint_river_figure(places: pd.DataFrame, by_depth: pd.DataFrame) -> Figure:
    """Bed and track, what each instrument measured, errors without and with the sheet, errors by depth.

    Parameters
    ----------
    places : of one survey, see `thalweg_lab.studies.joint_study.surveyed`.
    by_depth : of all surveys, see `thalweg_lab.studies.joint_study.by_depth`.
    """
    whole = by_depth[(by_depth["from_m"] == 0) & np.isinf(by_depth["to_m"])].set_index("survey")
    surveys = int(by_depth["number"].max())
    figure = new_figure(
        170.0,
        "Echo sounder and light sheet on a river ten metres wide, "
        f"n = {count(surveys)} surveys; a to d: one of them",
    )
    mark_twin(figure)
    grid = figure.add_gridspec(5, 2, height_ratios=[1, 1, 1, 1, 1.5], width_ratios=[40, 1])
    alone, joint = whole.index
    cells = places[places["what"] == f"cell, {alone}"]
    track = places[places["what"] == "track"]
    panels: list[Axes] = []
    for row in range(4):
        panels.append(figure.add_subplot(grid[row, 0], sharex=panels[0] if panels else None))
    depth = panels[0].scatter(
        cells["east_m"], cells["north_m"], c=cells["depth_m"], cmap=DEPTH_MAP, s=1.5, lw=0, rasterized=True
    )
    panels[0].plot(track["east_m"], track["north_m"], color="black", lw=0.8)
    panels[0].set_title("a: true depth, and the boat's track")
    figure.colorbar(depth, cax=figure.add_subplot(grid[0, 1]), label="depth [m]")
    panels[1].scatter(cells["east_m"], cells["north_m"], color="0.92", s=1.5, lw=0, rasterized=True)
    for what, name, colour, size in _MARKS:
        of = places[places["what"] == what]
        panels[1].plot(
            of["east_m"], of["north_m"], ls="none", marker=".", ms=size, mew=0, color=colour,
            label=f"{name}, n = {count(len(of))}", rasterized=True,
        )  # fmt: skip
    panels[1].set_title("b: what each instrument measured")
    panels[1].legend(loc="upper left", bbox_to_anchor=(0.0, -0.05), ncols=2, markerscale=3)
    for ax, letter, name in ((panels[2], "c", alone), (panels[3], "d", joint)):
        of = places[places["what"] == f"cell, {name}"]
        error = ax.scatter(
            of["east_m"], of["north_m"], c=_CM_PER_M * of["error_m"], cmap="RdBu_r", s=1.5, lw=0,
            vmin=-_ERROR_CM, vmax=_ERROR_CM, rasterized=True,
        )  # fmt: skip
        ax.set_title(f"{letter}: error of the bed, {name}")
        figure.colorbar(
            error, cax=figure.add_subplot(grid[2 if letter == "c" else 3, 1]), label="[cm]", extend="both"
        )
    for ax in panels:
        ax.set(ylabel="north [m]", aspect="equal")
    for ax in panels[:-1]:
        ax.tick_params(labelbottom=False)
    panels[-1].set_xlabel("east [m]")
    _by_depth(figure.add_subplot(grid[4, 0]), by_depth)
    return figure


def _by_depth(ax: Axes, table: pd.DataFrame) -> None:
    classes = table[~((table["from_m"] == 0) & np.isinf(table["to_m"]))]
    for (name, of), colour, aside in zip(
        classes.groupby("survey", sort=False), (BLUE, VERMILION), (-0.18, 0.18), strict=True
    ):
        at = np.arange(len(of)) + aside
        ax.bar(at, _CM_PER_M * of["rmse_observed_m"], width=0.34, color=colour, label=f"{name}, error")
        ax.plot(at, _CM_PER_M * of["rmse_predicted_m"], ls="none", marker="_", ms=14, mew=1.5, color="black")
    ax.plot([], [], ls="none", marker="_", ms=14, mew=1.5, color="black", label="predicted")
    first = classes[classes["survey"] == classes["survey"].iloc[0]]
    names = [
        f"{low:g} to {high:g} m" if np.isfinite(high) else f"over {low:g} m"
        for low, high in zip(first["from_m"], first["to_m"], strict=True)
    ]
    ax.set_xticks(
        np.arange(len(names)),
        [f"{name}\nn = {count(int(n))}" for name, n in zip(names, first["n"], strict=True)],
    )
    ax.set(title="e: errors by depth of water, all surveys", ylabel="root mean\nsquare [cm]")
    top = _CM_PER_M * float(classes[["rmse_observed_m", "rmse_predicted_m"]].max().max())
    ax.set_ylim(0, 1.45 * top)
    ax.legend(ncols=3, loc="upper left")
    ax.grid(axis="y")
