"""A laser line over bright and dark parts of a surface, and what its points are flagged with (P4 Fig. 16)."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from thalweg.core.types import AnyArray
from thalweg.figures.style import BLUE, ORANGE, RED, SKY, VERMILION, count, new_figure, styled
from thalweg.lightsheet.figures.views import green_of, need, show_green
from thalweg.lightsheet.lines.settings import LineFlag

COLUMNS: Final = ("x_px", "y_px", "angle_rad", "peak_dn", "width_px", "flags")

FLAGS: Final = (
    (0, "without reserve", SKY, "o"),
    (int(LineFlag.WEAK), "weak", BLUE, "v"),
    (int(LineFlag.NEAR_JUMP), "near a jump", ORANGE, "^"),
    (int(LineFlag.ALBEDO_EDGE), "edge of the brightness", VERMILION, "D"),
    (int(LineFlag.SATURATED), "saturated", RED, "x"),
)
"""Flags with words, colour and marker; a point with several shows the last of them."""


_BESIDE: Final = 8.0
"""Half widths of the line that the pictures show on either side."""
_DETAIL_SHARE: Final = 0.12
"""Part of the line's length that the detail shows."""


@styled
def line_on_markers(
    image: AnyArray, points: pd.DataFrame, *, title: str = "Flags of the line", twin: bool = False
) -> Figure:
    """The line with its points by flag, a detail where most are flagged, and brightness and width along it.

    Parameters
    ----------
    image : (h, w) mosaic or monochrome, or (h, w, 3).
    points : columns `COLUMNS`, of this image.
    title : first words of the title.
    twin : true if the digital twin made the image.

    Raises
    ------
    InputError : no points, or columns are missing.
    """
    table, green = need(points, COLUMNS, "line points"), green_of(image)
    column, row = "column / px", "row / px"
    if np.median(np.abs(np.sin(table["angle_rad"].to_numpy()))) > np.sqrt(0.5):
        table = table.rename(columns={"x_px": "y_px", "y_px": "x_px"})
        green, column, row = green.T, row, column
    table = table.assign(shown=shown_flag(table["flags"].to_numpy()))
    reserved = int((table["flags"] != 0).sum())
    head = f"{title}: {count(reserved)} of n = {count(len(table))} points of the line are flagged"
    figure = new_figure(118.0, head, twin=twin)
    left, middle, right = figure.subplots(1, 3, width_ratios=[0.8, 0.9, 1.3])
    box = _detail_box(table)
    _picture(left, green, table, _whole_box(table, green.shape[0]), 1.8)
    left.add_patch(Rectangle(box[:2], box[2], box[3], fill=False, edgecolor=ORANGE, lw=1.2))
    left.set(xlabel=column, ylabel=row)
    left.set_title("a: the line; box: b")
    _picture(middle, green, table, box, 4.0)
    middle.set(xlabel=column)
    middle.set_title("b: detail")
    _brightness(right, table, row)
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower left", ncols=len(FLAGS))
    return figure


def shown_flag(flags: AnyArray) -> AnyArray:
    """The last flag (n,) of `FLAGS` that each point has; 0 for none."""
    out = np.zeros(len(flags), dtype=np.int64)
    for flag, *_ in FLAGS[1:]:
        out[(flags.astype(np.int64) & flag) != 0] = flag
    return out


def _detail_box(table: pd.DataFrame) -> tuple[int, int, int, int]:
    """Left, top, width, height of the part with most flagged points."""
    y = table["y_px"].to_numpy()
    rows = max(_DETAIL_SHARE * float(np.ptp(y)), 24.0)
    flagged = np.sort(y[table["flags"].to_numpy() != 0])
    starts = flagged if len(flagged) else y[:1]
    inside = [int(((flagged >= start) & (flagged < start + rows)).sum()) for start in starts]
    top = float(starts[int(np.argmax(inside))]) - 2.0
    near = table[(y >= top) & (y <= top + rows)]
    aside = 0.6 * _BESIDE * max(float(table["width_px"].median()), 1.0)
    left, right = float(near["x_px"].min()) - aside, float(near["x_px"].max()) + aside
    return max(int(left), 0), max(int(top), 0), int(right - left), int(rows)


def _whole_box(table: pd.DataFrame, height: int) -> tuple[int, int, int, int]:
    aside = _BESIDE * max(float(table["width_px"].median()), 1.0)
    left, right = float(table["x_px"].min()) - aside, float(table["x_px"].max()) + aside
    return max(int(left), 0), 0, int(right - left), height


def _picture(
    ax: Axes, green: AnyArray, table: pd.DataFrame, box: tuple[int, int, int, int], size: float
) -> None:
    left, top, width, height = box
    show_green(ax, green[top : top + height, left : left + width], left=left, top=top)
    for flag, words, colour, marker in FLAGS:
        mine = table[table["shown"] == flag]
        ax.plot(mine["x_px"], mine["y_px"], ls="none", marker=marker, ms=size, color=colour,
                label=f"{words}: {count(len(mine))}", gid=f"flag {flag}")  # fmt: skip
    ax.set_aspect("auto")
    ax.set_xlim(left, left + width)
    ax.set_ylim(top + height, top)


def _brightness(ax: Axes, table: pd.DataFrame, row: str) -> None:
    """Peak and width: where both change together, the light shifts the line."""
    for flag, _, colour, marker in FLAGS:
        mine = table[table["shown"] == flag]
        ax.plot(mine["peak_dn"], mine["y_px"], ls="none", marker=marker, ms=2.5, color=colour, gid="peak")
    ax.set(xlabel="points: peak height of the line / 1", xscale="log")
    ax.invert_yaxis()
    ax.set_title("c: brightness along the line")
    ax.grid()
    twin_axis = ax.twiny()
    order = np.argsort(table["y_px"].to_numpy(), kind="stable")
    width, y = table["width_px"].to_numpy()[order], table["y_px"].to_numpy()[order].copy()
    # a break of the line is no place between its ends
    width = np.where(np.append(np.diff(y) > 3.0, False), np.nan, width)
    twin_axis.plot(width, y, color="0.35", lw=0.8, gid="width")
    twin_axis.set_xlim(0.0, 3.0 * float(np.nanmedian(width)))
    twin_axis.set_xlabel("curve: half width at 1/e² / px")
    twin_axis.spines["top"].set_visible(True)
    ax.set_ylabel(row)
