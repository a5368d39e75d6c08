"""Correlation matrix of calibrated quantities."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from cmcrameri import cm
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure

from thalweg.core.calibration.model import Calibration
from thalweg.core.errors import InputError
from thalweg.core.types import ArrayF
from thalweg.figures.style import new_figure, plural, styled

MAP: Final[Colormap] = cm.vik
NUMBERS_UP_TO: Final = 16
"""Quantities up to which each cell can hold its number."""

LARGE: Final = 0.95


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
    figure.colorbar(
        ScalarMappable(Normalize(-1, 1), MAP), ax=ax, label="correlation / 1", shrink=0.8, pad=0.02
    )
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
