"""Least-squares matching of one place of a laser line: template, image, rest (P3 Fig. 2, P4 Fig. 6)."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from thalweg.core.errors import CoverageError
from thalweg.core.types import AnyArray, ArrayF
from thalweg.figures.accuracy.distance_map import DISTANCE_MAP
from thalweg.figures.style import BLUE, VERMILION, new_figure, styled
from thalweg.lightsheet.figures.line_measurement import COLUMNS
from thalweg.lightsheet.figures.views import LIGHT_MAP, green_of, need

SIDE: Final = 15
"""Rows and columns of the patch (P4 4.1)."""


@styled
def line_patch(
    image: AnyArray, points: pd.DataFrame, *, title: str = "Line measurement", twin: bool = False
) -> Figure:
    """Template of Gaussian rows, the grey values below it, their difference; grey values of all rows.

    The place is the point nearest to the middle of the line whose patch lies in the picture.

    Parameters
    ----------
    image : (h, w) mosaic or monochrome, or (h, w, 3).
    points : columns `thalweg.lightsheet.figures.line_measurement.COLUMNS`, by the method ``lsm``.
    title : first words of the title.
    twin : true if the digital twin made the image.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    CoverageError : no point lies far enough inside.
    """
    green = green_of(image)
    point = middle_point(need(points, COLUMNS, "line points"), (green.shape[0], green.shape[1]))
    turned = abs(np.sin(float(point["angle_rad"]))) > np.sin(np.pi / 4)
    seen = green.T if turned else green
    x, y = (float(point[name]) for name in (("y_px", "x_px") if turned else ("x_px", "y_px")))
    top, left = int(np.floor(y)) - SIDE // 2, int(np.floor(x)) - SIDE // 2
    patch = np.asarray(seen[top : top + SIDE, left : left + SIDE], dtype=np.float64)
    place: ArrayF = np.arange(SIDE, dtype=np.float64) + (left + 0.5)
    model = np.tile(gauss_row(place - x, point), (SIDE, 1))
    left_over = patch - model
    head = (
        f"{title}: one place of the line by a patch of {SIDE} x {SIDE} pixels, sigma "
        f"{float(point['sigma_px']):.2f} px, n = {SIDE * SIDE} pixels"
    )
    figure = new_figure(128.0, head, twin=twin)
    grid = figure.add_gridspec(2, 3, height_ratios=[1.0, 0.85])
    axes = [figure.add_subplot(grid[0, k]) for k in range(3)]
    extent = (float(left), float(left + SIDE), float(top + SIDE), float(top))
    across, along = ("row", "column") if turned else ("column", "row")
    bright = Normalize(0.0, float(max(patch.max(), model.max())))
    largest = float(np.abs(left_over).max())
    for ax, values, norm, colours, words in (
        (axes[0], model, bright, LIGHT_MAP.reversed(), "a: template, shifted and scaled"),
        (axes[1], patch, bright, LIGHT_MAP.reversed(), "b: grey values below it"),
        (axes[2], left_over, Normalize(-largest, largest), DISTANCE_MAP, "c: what is left"),
    ):
        ax.imshow(values, cmap=colours, norm=norm, extent=extent, aspect="equal", gid=words[0])
        ax.axvline(x, color=VERMILION, lw=1.0, gid="place")
        ax.set(xlabel=f"{across} / px", ylabel=f"{along} / px" if ax is axes[0] else "")
        ax.set_title(words)
        ax.yaxis.set_major_locator(MaxNLocator(5, integer=True))
        ax.tick_params(labelleft=ax is axes[0])
    shades = ScalarMappable(bright, LIGHT_MAP.reversed())
    figure.colorbar(shades, ax=axes[:2], label="grey value / 1", location="bottom", aspect=30, pad=0.02)
    shades = ScalarMappable(Normalize(-largest, largest), DISTANCE_MAP)
    figure.colorbar(shades, ax=axes[2], label="difference / 1", location="bottom", aspect=15, pad=0.02)
    _rows(figure.add_subplot(grid[1, :]), place, patch, point, x, f"{across} / px")
    return figure


def middle_point(points: pd.DataFrame, shape: tuple[int, int]) -> pd.Series:
    """The point nearest to the middle of the line whose patch lies inside a picture of that shape.

    Raises
    ------
    CoverageError : there is none.
    """
    margin = SIDE // 2 + 1
    inside = points[
        points["x_px"].between(margin, shape[1] - margin) & points["y_px"].between(margin, shape[0] - margin)
    ]
    if not len(inside):
        raise CoverageError("no point far enough inside", expected=f"a margin of {margin} pixels")
    xy = inside[["x_px", "y_px"]].to_numpy(np.float64)
    return inside.iloc[int(np.argmin(np.square(xy - xy.mean(axis=0)).sum(axis=1)))]


def gauss_row(off_px: ArrayF, point: pd.Series) -> ArrayF:
    """Grey values at distances from the line's centre, as matching found it."""
    width, peak, ground = (float(point[name]) for name in ("width_px", "peak_dn", "background_dn"))
    return np.asarray(ground + peak * np.exp(-2.0 * np.square(off_px / width)))


def _rows(ax: Axes, place: ArrayF, patch: ArrayF, point: pd.Series, x: float, label: str) -> None:
    for k, row in enumerate(patch):
        ax.plot(
            place, row, color=BLUE, lw=0.6, alpha=0.6, gid="row", label=f"{SIDE} rows" if k == 0 else None
        )
    fine = np.linspace(place[0], place[-1], 241)
    ax.plot(fine, gauss_row(fine - x, point), color=VERMILION, lw=2.0, gid="template",
            label=f"template, half width {float(point['width_px']):.2f} px")  # fmt: skip
    ax.axvline(x, color=VERMILION, lw=0.8, ls="--", label=f"place {x:.2f} px")
    ax.set(xlabel=label, ylabel="grey value / 1", xlim=(place[0], place[-1]))
    ax.set_title("d: grey values of the rows")
    ax.legend(loc="upper left")
    ax.grid()
