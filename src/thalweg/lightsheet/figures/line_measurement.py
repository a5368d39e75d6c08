"""A laser line in an image and how well it is measured (P3 Fig. 2; P4 Fig. 4 to 6 and 16)."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from thalweg.core.errors import CoverageError
from thalweg.core.types import AnyArray, ArrayB, ArrayF
from thalweg.figures.style import BLUE, ORANGE, SKY, VERMILION, count, new_figure, plural, styled
from thalweg.lightsheet.figures.views import green_of, need, show_green
from thalweg.lightsheet.lines.detect import detect_lines
from thalweg.lightsheet.lines.settings import LineSettings, Method

METHODS: Final[dict[Method, tuple[str, str, str]]] = {
    "row_gauss": ("each row for itself", SKY, "o"),
    "lsm": ("patch of 15 x 15", ORANGE, "^"),
    "speckle_patch": ("speckle-weighted patch", VERMILION, "s"),
}
"""Words, colour and marker of each method of `thalweg.lightsheet.lines.settings.LineSettings`."""

COLUMNS: Final = (
    "x_px", "y_px", "sigma_px", "angle_rad", "peak_dn", "width_px", "background_dn", "flags",
)  # fmt: skip
"""Columns of line points that the figures use."""

DETAIL_ROWS: Final = 30
PROFILE_ROWS: Final = 3
_SIZES: Final[dict[Method, float]] = {"row_gauss": 4.5, "lsm": 4.5, "speckle_patch": 2.0}
_SMOOTH_DEGREE: Final = 8
_BESIDE: Final = 6.0
"""Half widths of the line that a detail shows on either side."""
_PROFILE_LOOKS: Final = ((BLUE, "-", "o"), (VERMILION, "--", "s"), (ORANGE, "-.", "^"))


def measured(image: AnyArray, methods: Sequence[Method] = tuple(METHODS)) -> dict[Method, pd.DataFrame]:
    """Line points of an image by several methods.

    Raises
    ------
    InputError : the image shows no line.
    """
    return {name: detect_lines(image, LineSettings(method=name)).to_frame() for name in methods}


@styled
def line_measurement(
    image: AnyArray,
    points: Mapping[Method, pd.DataFrame],
    *,
    title: str = "Line measurement",
    twin: bool = False,
) -> Figure:
    """A line with its detail, grey values of three rows, and departures from a smooth line by method.

    Parameters
    ----------
    image : (h, w) mosaic or monochrome, or (h, w, 3), of a line on an even surface.
    points : by method (`METHODS`), columns `COLUMNS`; the last one defines the smooth line.
    title : first words of the title.
    twin : true if the digital twin made the image.

    Raises
    ------
    InputError : a table without rows or columns.
    CoverageError : fewer than 20 points.
    """
    tables = {name: need(table, COLUMNS, "line points") for name, table in points.items()}
    last = list(tables.values())[-1]
    if len(last) < 2 * (_SMOOTH_DEGREE + 2):
        raise CoverageError(f"{len(last)} points on the line", expected="20 or more")
    green, tables, turned = _upright(green_of(image), tables)
    last = list(tables.values())[-1]
    row, column = ("column", "row") if turned else ("row", "column")
    head = f"{title}: one laser line measured by {len(tables)} methods, n = {count(len(last))} points"
    figure = new_figure(150.0, head, twin=twin)
    grid = figure.add_gridspec(3, 3, height_ratios=[0.8, 1.0, 0.85], width_ratios=[0.95, 1.0, 1.0])
    whole, detail = figure.add_subplot(grid[:2, 0]), figure.add_subplot(grid[:2, 1])
    profiles, shares = figure.add_subplot(grid[0, 2]), figure.add_subplot(grid[1, 2])
    off = {name: departures_px(table, last) for name, table in tables.items()}
    middle = float(np.median(last["y_px"]))
    _whole(whole, green, last, middle, f"{column} / px", f"{row} / px")
    _detail(detail, green, tables, middle, f"{column} / px")
    _profiles(profiles, green, tables, middle, row, f"{column} / px")
    _distribution(shares, off)
    _along(figure.add_subplot(grid[2, :]), tables, off, f"{row} / px")
    return figure


def departures_px(table: pd.DataFrame, smooth_of: pd.DataFrame) -> ArrayF:
    """Distances (n,) along a row from the smooth curve, a polynomial, through other points.

    Parameters
    ----------
    table : line points.
    smooth_of : points that define the curve; those more than four NMADs off it are left out.
    """
    y, x = (smooth_of[name].to_numpy(np.float64) for name in ("y_px", "x_px"))
    middle, half = 0.5 * (y.min() + y.max()), max(0.5 * float(np.ptp(y)), 1.0)
    keep: ArrayB = np.ones(len(x), dtype=bool)
    for _ in range(3):
        fit = np.polynomial.Polynomial.fit((y[keep] - middle) / half, x[keep], _SMOOTH_DEGREE, domain=[-1, 1])
        e = x - fit((y - middle) / half)
        keep = np.abs(e) <= 4 * 1.4826 * np.median(np.abs(e)) + 1e-9
    at = table["y_px"].to_numpy(np.float64)
    off = table["x_px"].to_numpy(np.float64) - fit((at - middle) / half)
    return np.asarray(np.where((at >= y.min()) & (at <= y.max()), off, np.nan))


def _upright(
    green: AnyArray, tables: Mapping[Method, pd.DataFrame]
) -> tuple[AnyArray, dict[Method, pd.DataFrame], bool]:
    """A line from left to right as one from top to bottom; whether it was turned."""
    angles = np.concatenate([table["angle_rad"].to_numpy() for table in tables.values()])
    turned = bool(np.median(np.abs(np.sin(angles))) > np.sqrt(0.5))
    if not turned:
        return green, dict(tables), False
    swap = {"x_px": "y_px", "y_px": "x_px"}
    return green.T, {name: table.rename(columns=swap) for name, table in tables.items()}, True


def _near(table: pd.DataFrame, middle: float, rows: float) -> pd.DataFrame:
    return table[(table["y_px"] - middle).abs() <= 0.5 * rows]


def _box(table: pd.DataFrame, middle: float) -> tuple[int, int, int, int]:
    """Left, top, width, height of the detail about the middle row."""
    near = _near(table, middle, DETAIL_ROWS)
    aside = _BESIDE * max(float(near["width_px"].median()), 1.0)
    left, right = float(near["x_px"].min()) - aside, float(near["x_px"].max()) + aside
    return int(left), int(middle - DETAIL_ROWS / 2), int(right - left), DETAIL_ROWS


def _whole(ax: Axes, green: AnyArray, table: pd.DataFrame, middle: float, x: str, y: str) -> None:
    x_px = table["x_px"].to_numpy()
    wide = max(0.45 * green.shape[0], float(np.ptp(x_px)) + 0.1 * green.shape[1])
    left = max(int(x_px.mean() - 0.5 * wide), 0)
    right = min(int(left + wide), green.shape[1])
    show_green(ax, green[:, left:right], left=left)
    box = _box(table, middle)
    ax.add_patch(Rectangle(box[:2], box[2], box[3], fill=False, edgecolor=ORANGE, lw=1.2, gid="detail"))
    ax.set(xlabel=x, ylabel=y)
    ax.set_title("a: the line; box: b")


def _detail(ax: Axes, green: AnyArray, tables: Mapping[Method, pd.DataFrame], middle: float, x: str) -> None:
    left, top, width, height = _box(list(tables.values())[-1], middle)
    left, top = max(left, 0), max(top, 0)
    show_green(ax, green[top : top + height, left : left + width], left=left, top=top)
    for name, table in tables.items():
        words, colour, marker = METHODS[name]
        near = _near(table, middle, DETAIL_ROWS)
        face = colour if name == "speckle_patch" else "none"
        ax.plot(near["x_px"], near["y_px"], ls="none", marker=marker, ms=_SIZES[name], mfc=face, mec=colour,
                mew=0.9, label=words, gid=f"{name} points")  # fmt: skip
    ax.set_aspect("auto")
    ax.set(xlabel=x)
    ax.set_title("b: detail and measured points")


def _profiles(
    ax: Axes, green: AnyArray, tables: Mapping[Method, pd.DataFrame], middle: float, row: str, x: str
) -> None:
    """Grey values of adjacent rows, the Gaussian curve of each and where the last method sees the line."""
    names = list(tables)
    own, last = tables[names[0]], tables[names[-1]]
    for k, (colour, style, marker) in enumerate(_PROFILE_LOOKS[:PROFILE_ROWS]):
        at = int(middle) + k
        rows = own[(own["y_px"] - at - 0.5).abs() < 0.5]
        if not len(rows) or at >= green.shape[0]:
            continue
        fit = rows.iloc[0]
        reach = 0.8 * _BESIDE * float(fit["width_px"])
        x_px = np.arange(max(int(fit["x_px"] - reach), 0), min(int(fit["x_px"] + reach) + 1, green.shape[1]))
        ax.plot(x_px + 0.5, green[at, x_px], color=colour, marker=marker, ms=2.5, lw=0.5, alpha=0.7,
                label=f"{row} {at}", gid="profile")  # fmt: skip
        fine = np.linspace(x_px[0], x_px[-1] + 1.0, 200)
        curve = float(fit["background_dn"]) + float(fit["peak_dn"]) * np.exp(
            -2.0 * ((fine - float(fit["x_px"])) / float(fit["width_px"])) ** 2
        )
        ax.plot(fine, curve, color=colour, ls=style, lw=1.2, gid="curve")
        there = last[(last["y_px"] - at - 0.5).abs() < 0.5]
        for place in there["x_px"]:
            ax.axvline(place, color=colour, lw=0.8, ls=style, gid="place")
    ax.set(xlabel=x, ylabel="grey value / 1")
    ax.set_ylim(0.0, None)
    ax.set_title(f"c: {PROFILE_ROWS} adjacent {row}s")
    ax.legend(loc="upper left", handlelength=1.0)


def _distribution(ax: Axes, off: Mapping[Method, ArrayF]) -> None:
    largest = max(float(np.nanpercentile(np.abs(e), 99.0)) for e in off.values())
    bins = np.linspace(-largest, largest, 61).tolist()
    for name, e in off.items():
        words, colour, _ = METHODS[name]
        std = float(np.nanstd(e))
        ax.hist(e, bins=bins, histtype="step", color=colour, lw=1.3, density=True,
                label=f"{words}: {std:.2f} px", gid=f"{name} histogram")  # fmt: skip
    ax.set(xlabel="distance from a smooth line / px", ylabel="density / (1/px)", yscale="log")
    low, high = ax.get_ylim()
    ax.set_ylim(low, high * 200)
    ax.set_title("d: standard deviations")
    ax.legend(loc="upper left")


def _along(ax: Axes, tables: Mapping[Method, pd.DataFrame], off: Mapping[Method, ArrayF], y: str) -> None:
    for name, table in tables.items():
        words, colour, marker = METHODS[name]
        ax.plot(table["y_px"], off[name], ls="none", marker=marker, ms=2.0, color=colour, label=words,
                gid=f"{name} departures", mew=0.0)  # fmt: skip
    largest = max(float(np.nanpercentile(np.abs(e), 99.5)) for e in off.values())
    ax.axhline(0.0, color="0.3", lw=0.6)
    ax.set(xlabel=y, ylabel="distance / px", ylim=(-1.15 * largest, 1.15 * largest))
    beyond = sum(int(np.nansum(np.abs(e) > 1.15 * largest)) for e in off.values())
    ax.set_title(f"e: distances of the points from a smooth line; {plural(beyond, 'point')} beyond the frame")
    ax.legend(loc="upper left", ncols=len(off))
    ax.grid()
