"""What a calibration reaches: correlations of its parameters, sigmas by the design of the field."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from cmcrameri import cm
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from thalweg.core import ArrayF, InputError
from thalweg.core.calibration import Calibration, read_calibration
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
from thalweg.figures.calibration.tables import read_figure_table

MAP: Final[Colormap] = cm.vik
NUMBERS_UP_TO: Final = 16
"""Quantities up to which each cell can hold its number."""
LARGE: Final = 0.95

STYLE: Final = ((BLUE, "o"), (VERMILION, "s"), (GREEN, "^"), (PURPLE, "D"), (ORANGE, "v"), (SKY, "P"))
PUBLISHED: Final = (("deg", (0.067, 0.035, 0.015)), ("m", (1.0e-3, 0.4e-3, 0.2e-3)))
"""Sigmas of P2 Table 1, six cones and three positions, largest first."""


# ---------------------------------------------------------------- correlations


@styled
def correlation_matrix(
    calibration: Calibration, *, title: str = "Correlations", twin: bool = False
) -> Figure:
    """Correlations of all quantities, blocks apart; quantities without error are left out.

    Parameters
    ----------
    calibration : see `thalweg.core.calibration.model`.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : fewer than two quantities have an error.
    """
    free = np.flatnonzero(calibration.sigmas > 0)
    if free.size < 2:
        raise InputError(
            f"{free.size} quantities with an error in '{calibration.title}'", expected="two or more"
        )
    labels = [calibration.labels[i] for i in free]
    matrix = calibration.correlation()[np.ix_(free, free)]
    n = len(labels)
    below = np.abs(matrix[np.tril_indices(n, -1)])
    over = int(np.sum(below > LARGE))
    head = (
        f"{title}: {calibration.title}, n = {n} quantities, largest correlation {below.max():.2f}, "
        f"{plural(over, 'pair').replace('no pair', 'none')} above {LARGE:g}"
    )
    figure = new_figure(min(38.0 + 7.5 * n, 178.0), head, twin=twin)
    ax = figure.subplots()
    draw_matrix(ax, matrix, labels)
    figure.colorbar(ScalarMappable(Normalize(-1, 1), MAP), ax=ax, label="correlation", shrink=0.8, pad=0.02)
    return figure


def draw_matrix(ax: Axes, matrix: ArrayF, labels: Sequence[str]) -> None:
    """Cells of a correlation matrix (n, n) with its numbers, and lines between blocks."""
    n = len(labels)
    ax.imshow(matrix, cmap=MAP, norm=Normalize(-1, 1), gid="matrix")
    names = [_name(label) for label in labels]
    size = 7.0 if n <= 24 else 5.0
    ax.set_xticks(range(n), names, rotation=60, ha="right", rotation_mode="anchor", fontsize=size)
    ax.set_yticks(range(n), names, fontsize=size)
    ax.tick_params(length=0)
    if n <= NUMBERS_UP_TO:
        for i in range(n):
            for k in range(n):
                colour = "white" if abs(matrix[i, k]) > 0.6 else "black"
                if abs(matrix[i, k]) < 0.005:
                    continue
                text = "1" if i == k else f"{matrix[i, k]:+.2f}".replace("+0.", "+.").replace("-0.", "−.")
                ax.text(k, i, text, ha="center", va="center", fontsize=6.5 if n <= 12 else 5.2, color=colour)
    blocks = [label.partition(".")[0] for label in labels]
    for k in range(1, n):
        if blocks[k] != blocks[k - 1]:
            ax.axhline(k - 0.5, color="black", lw=1.2)
            ax.axvline(k - 0.5, color="black", lw=1.2)


def _name(label: str) -> str:
    """``lidar x`` of ``lidar.x_m``: correlations have no units."""
    block, _, quantity = label.partition(".")
    stem, _, unit = quantity.rpartition("_")
    name = stem if stem and unit in {"deg", "m", "s", "px", "ppm", "mps"} else quantity
    return f"{block} {name}".replace("_", " ").strip()


def draw_correlations(*, calibration: Path, twin: bool) -> Figure:
    """A calibration file -> figure of its correlation matrix."""
    return correlation_matrix(read_calibration(calibration), twin=twin)


# ---------------------------------------------------------------- design of the field


@styled
def calibration_design(
    study: pd.DataFrame, *, title: str = "Gain from more cones and positions", twin: bool = False
) -> Figure:
    """Sigmas of rotation and lever arm over the number of cones, one line for each number of positions.

    Parameters
    ----------
    study : columns of ``design study`` (see `thalweg.figures.calibration.tables`); several rows of one cones,
        positions and quantity (choices of cones, seeds) are drawn as median and as band of the middle 80 %.
    title : first words of the title.
    twin : true if the digital twin made the data.

    """
    known = np.isfinite(study["sigma"].to_numpy(np.float64))
    table, lost = study[known], int((~known).sum())
    quantities = {unit: _ordered(part["quantity"]) for unit, part in table.groupby("unit")}
    head = f"{title}, n = {plural(len(table), 'sigma')}"
    head += f"; {count(lost)} that the geometry does not determine are left out" if lost else ""
    rows = [unit for unit in ("deg", "m") if unit in quantities]
    figure = new_figure(18.0 + 52.0 * len(rows), head, twin=twin)
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
        x = middle.index.to_numpy(np.float64)
        ax.fill_between(x, low.to_numpy(), high.to_numpy(), color=colour, alpha=0.15, lw=0)
        ax.plot(
            x,
            middle.to_numpy(),
            color=colour,
            marker=marker,
            ms=3.5,
            lw=1.1,
            label=f"{number} position{'s' if number > 1 else ''}",
            gid=f"positions-{number}",
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
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.grid(axis="y")


def draw_calibration_design(*, study: Path, twin: bool) -> Figure:
    """Study of numbers of cones and positions -> figure of the sigmas."""
    return calibration_design(read_figure_table(study), twin=twin)
