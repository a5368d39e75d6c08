"""What a calibration reaches: sigmas by the design of the field."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from thalweg.figures import (
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    count,
    legend_below,
    new_figure,
    plural,
    styled,
)
from thalweg.figures.survey import plain_numbers

STYLE: Final = ((BLUE, "o"), (VERMILION, "s"), (GREEN, "^"), (PURPLE, "D"), (ORANGE, "v"), (SKY, "P"))
PUBLISHED: Final = (("deg", (0.067, 0.035, 0.015)), ("m", (1.0e-3, 0.4e-3, 0.2e-3)))
"""Sigmas of P2 Table 1, six cones and three positions, largest first."""


# ---------------------------------------------------------------- design of the field


@styled
def calibration_design(study: pd.DataFrame) -> Figure:
    """Sigmas of rotation and lever arm over the number of cones, one line for each number of positions.

    Parameters
    ----------
    study : columns of ``design study`` (see `thalweg.figures.calibration.tables`); several rows of one cones,
        positions and quantity (choices of cones, seeds) are drawn as median and as band of the middle 80 %.

    """
    known = np.isfinite(study["sigma"].to_numpy())
    table, lost = study[known], int((~known).sum())
    quantities = {unit: _ordered(part["quantity"]) for unit, part in table.groupby("unit")}
    head = f"Gain from more cones and positions, n = {plural(len(table), 'sigma')}"
    head += f"; {count(lost)} that the geometry does not determine are left out" if lost else ""
    rows = [unit for unit in ("deg", "m") if unit in quantities]
    figure = new_figure(18.0 + 52.0 * len(rows), head)
    columns = max(len(names) for names in quantities.values())
    axes = figure.subplots(len(rows), columns, squeeze=False, sharex=True, sharey="row")
    positions = sorted(int(p) for p in table["positions"].unique())
    for i, unit in enumerate(rows):
        for k, name in enumerate(quantities[unit]):
            part = table[(table["unit"] == unit) & (table["quantity"] == name)]
            _panel(axes[i, k], part, positions, unit)
            axes[i, k].set_title(_title(name, unit))
        for ax in axes[i, len(quantities[unit]) :]:
            ax.set_axis_off()
        axes[i, 0].set_ylabel("sigma of rotation / °" if unit == "deg" else "sigma of lever arm / mm")
    for ax in axes[-1]:
        ax.set_xlabel("cones")
        ax.set_xticks(sorted(int(c) for c in table["cones"].unique()))
    legend_below(figure, axes[0, 0])
    return figure


def _ordered(names: "pd.Series[str]") -> list[str]:
    return sorted(
        {str(name) for name in names}, key=lambda name: [c for c in "xyz" if f"{c}_" in name] or ["~"]
    )


def _title(name: str, unit: str) -> str:
    axis = next((c for c in "xyz" if f"_{c}_" in f"_{name}"), name)
    return f"rotation about {axis}" if unit == "deg" else f"{axis} of the lever arm"


def _panel(ax: Axes, part: pd.DataFrame, positions: Sequence[int], unit: str) -> None:
    factor = 1.0 if unit == "deg" else 1e3
    for k, number in enumerate(positions):
        colour, marker = STYLE[k % len(STYLE)]
        groups = part[part["positions"] == number].groupby("cones")["sigma"]
        middle = factor * groups.median()
        if not len(middle):
            continue
        low, high = factor * groups.quantile(0.1), factor * groups.quantile(0.9)
        x = middle.index.to_numpy()
        ax.fill_between(x, low.to_numpy(), high.to_numpy(), color=colour, alpha=0.15, lw=0)
        ax.plot(
            x,
            middle.to_numpy(),
            color=colour,
            marker=marker,
            ms=3.5,
            lw=1.1,
            label=f"{number} position{'s' if number > 1 else ''}",
        )
    published = factor * np.array(dict(PUBLISHED)[unit])
    ax.axhspan(
        published.min(),
        published.max(),
        color="0.88",
        zorder=0,
        lw=0,
        label="P2 Table 1: from the smallest to the largest of three",
    )
    ax.set_yscale("log")
    plain_numbers(ax.yaxis, LogNorm())
    ax.grid(axis="y")
