"""Measurement of the laser line: methods, one patch, bright markers, an image of a scan."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from thalweg.core import NMAD, AnyArray, ArrayB, ArrayF, CoverageError, read_table
from thalweg.figures import BLUE, ORANGE, RED, SKY, VERMILION, colour_bar, count, new_figure, plural, styled
from thalweg.figures.accuracy import DISTANCE_MAP
from thalweg.lightsheet.figures.views import (
    LIGHT_MAP,
    dots,
    find_image,
    first_image,
    green_of,
    need,
    show_green,
)
from thalweg.lightsheet.lines import LineFlag, LineSettings, Method, detect_lines
from thalweg.lightsheet.poses import SERIES_POINTS

METHODS: Final[dict[Method, tuple[str, str, str, float, str]]] = {
    "row_gauss": ("each row for itself", SKY, "o", 4.5, "none"),
    "lsm": ("patch of 15 x 15", ORANGE, "^", 4.5, "none"),
    "speckle_patch": ("speckle-weighted patch", VERMILION, "s", 2.0, VERMILION),
}
"""Words, colour, marker, size and face of each method of `thalweg.lightsheet.lines.settings.LineSettings`."""
COLUMNS: Final = ("x_px", "y_px", "sigma_px", "angle_rad", "peak_dn", "width_px", "background_dn", "flags")
"""Columns of line points that the figures use."""
DETAIL_ROWS: Final = 30
_SMOOTH_DEGREE: Final = 8
_BESIDE: Final = 6.0
"""Half widths of the line that a detail shows on either side."""
_PROFILE_STYLES: Final = ((BLUE, "-", "o"), (VERMILION, "--", "s"), (ORANGE, "-.", "^"))

SIDE: Final = 15
"""Rows and columns of the patch (P4 4.1)."""

FLAGS: Final = (
    (0, "without reserve", SKY, "o"),
    (int(LineFlag.WEAK), "weak", BLUE, "v"),
    (int(LineFlag.NEAR_JUMP), "near a jump", ORANGE, "^"),
    (int(LineFlag.ALBEDO_EDGE), "edge of the brightness", VERMILION, "D"),
    (int(LineFlag.SATURATED), "saturated", RED, "x"),
    (int(LineFlag.APART), "apart from the line", BLUE, "+"),
)
"""Flags with words, colour and marker; a point with several shows the last of them."""
POINTS: Final = ("piece", "x_px", "y_px", "sigma_px", "flags")
DETAIL: Final = 0.14
"""Side of the detail as a share of the picture's."""


# ---------------------------------------------------------------- methods of measurement (P3 Fig. 2, P4 Fig.
# 4 and 5)


def measured(image: AnyArray, methods: Sequence[Method] = tuple(METHODS)) -> dict[Method, pd.DataFrame]:
    """Line points of an image by several methods.

    Raises
    ------
    InputError : the image shows no line.
    """
    return {name: detect_lines(image, LineSettings(method=name)).to_frame() for name in methods}


@styled
def line_measurement(
    image: AnyArray, points: Mapping[Method, pd.DataFrame], *, title: str = "Line measurement"
) -> Figure:
    """A line with its detail, grey values of three rows, and departures from a smooth line by method.

    Parameters
    ----------
    image : (h, w) mosaic or monochrome, or (h, w, 3), of a line on an even surface.
    points : by method (`METHODS`), columns `COLUMNS`; the last one defines the smooth line.
    title : first words of the title.

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
    figure = new_figure(100.0, head)
    detail, profiles, shares = figure.subplots(1, 3)
    middle = float(np.median(last["y_px"]))
    _detail(detail, green, tables, middle)
    detail.set(title="a: detail and measured points", xlabel=f"{column} / px", ylabel=f"{row} / px")
    _profiles(profiles, green, tables, middle, row)
    profiles.set(xlabel=f"{column} / px", ylabel="grey value")
    _distribution(shares, {name: departures_px(table, last) for name, table in tables.items()})
    figure.legend(*detail.get_legend_handles_labels(), loc="outside lower left", ncols=3)
    return figure


def departures_px(table: pd.DataFrame, smooth_of: pd.DataFrame) -> ArrayF:
    """Distances (n,) along a row from the smooth curve, a polynomial, through other points.

    Parameters
    ----------
    table : line points.
    smooth_of : points that define the curve; those more than four NMADs off it are left out.
    """
    y, x = (smooth_of[name].to_numpy() for name in ("y_px", "x_px"))
    middle, half = 0.5 * (y.min() + y.max()), max(0.5 * float(np.ptp(y)), 1.0)
    keep: ArrayB = np.ones(len(x), dtype=bool)
    for _ in range(3):
        fit = np.polynomial.Polynomial.fit((y[keep] - middle) / half, x[keep], _SMOOTH_DEGREE, domain=[-1, 1])
        e = x - fit((y - middle) / half)
        keep = np.abs(e) <= 4 * NMAD * np.median(np.abs(e)) + 1e-9
    at = table["y_px"].to_numpy()
    off = table["x_px"].to_numpy() - fit((at - middle) / half)
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


def _detail(ax: Axes, green: AnyArray, tables: Mapping[Method, pd.DataFrame], middle: float) -> None:
    """The part of the line about the middle row with the points of each method."""
    near = {name: t[(t["y_px"] - middle).abs() <= 0.5 * DETAIL_ROWS] for name, t in tables.items()}
    last = list(near.values())[-1]
    aside = _BESIDE * max(float(last["width_px"].median()), 1.0)
    left, top = max(int(last["x_px"].min() - aside), 0), max(int(middle - DETAIL_ROWS / 2), 0)
    right = int(last["x_px"].max() + aside)
    show_green(ax, green[top : top + DETAIL_ROWS, left:right], left=left, top=top)
    for name, table in near.items():
        words, colour, marker, size, face = METHODS[name]
        dots(
            ax,
            table["x_px"],
            table["y_px"],
            colour,
            marker,
            ms=size,
            mfc=face,
            mew=0.9,
            label=words,
            gid=f"{name} points",
        )
    ax.set_aspect("auto")


def _profiles(
    ax: Axes, green: AnyArray, tables: Mapping[Method, pd.DataFrame], middle: float, row: str
) -> None:
    """Grey values of adjacent rows, the Gaussian curve of each and where the last method sees the line."""
    own, *_, last = (*tables.values(), list(tables.values())[-1])
    for k, (colour, style, marker) in enumerate(_PROFILE_STYLES):
        at = int(middle) + k
        rows = own[(own["y_px"] - at - 0.5).abs() < 0.5]
        if not len(rows) or at >= green.shape[0]:
            continue
        fit = rows.iloc[0]
        x, reach = float(fit["x_px"]), 0.8 * _BESIDE * float(fit["width_px"])
        x_px = np.arange(max(int(x - reach), 0), min(int(x + reach) + 1, green.shape[1]))
        dots(ax, x_px + 0.5, green[at, x_px], colour, marker, label=f"{row} {at}")
        fine = np.linspace(x_px[0], x_px[-1] + 1.0, 200)
        ax.plot(fine, gauss_row(fine - x, fit), color=colour, ls=style, lw=1.2)
        for place in last["x_px"][(last["y_px"] - at - 0.5).abs() < 0.5]:
            ax.axvline(place, color=colour, lw=0.8, ls=style)
    ax.set_ylim(0.0, None)
    ax.set_title(f"b: {len(_PROFILE_STYLES)} adjacent {row}s")
    ax.legend(loc="upper left", handlelength=1.0)


def _distribution(ax: Axes, off: Mapping[Method, ArrayF]) -> None:
    largest = max(float(np.nanpercentile(np.abs(e), 99.0)) for e in off.values())
    bins = np.linspace(-largest, largest, 61).tolist()
    for name, e in off.items():
        words, colour, *_ = METHODS[name]
        ax.hist(
            e,
            bins=bins,
            color=colour,
            label=f"{words}: {np.nanstd(e):.2f} px",
            histtype="step",
            lw=1.3,
            density=True,
            gid=f"{name} histogram",
        )
    ax.set(xlabel="distance from a smooth line / px", ylabel="density / (1/px)", yscale="log")
    low, high = ax.get_ylim()
    ax.set_ylim(low, high * 200)
    ax.set_title("c: standard deviations")
    ax.legend(loc="upper left")


def draw_line_measurement(*, images: list[Path], line_points: Path, title: str) -> Figure:
    """An image of the laser line on a panel -> figure of what each method of measurement reaches."""
    image, _ = first_image(images, line_points)
    return line_measurement(image, measured(image), title=title)


# ---------------------------------------------------------------- matching of one place (P4 Fig. 6)


@styled
def line_patch(image: AnyArray, points: pd.DataFrame, *, title: str = "Line measurement") -> Figure:
    """Template of Gaussian rows, the grey values below it, their difference; grey values of all rows.

    The place is the point nearest to the middle of the line whose patch lies in the picture.

    Parameters
    ----------
    image : (h, w) mosaic or monochrome, or (h, w, 3).
    points : columns `thalweg.lightsheet.figures.lines.COLUMNS`, by the method ``lsm``.
    title : first words of the title.

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
    figure = new_figure(84.0, head)
    axes = figure.subplots(1, 3)
    extent = (float(left), float(left + SIDE), float(top + SIDE), float(top))
    across, along = ("row", "column") if turned else ("column", "row")
    bright = Normalize(0.0, max(patch.max(), model.max()))
    largest = float(np.abs(left_over).max())
    for ax, values, norm, colours, words in (
        (axes[0], model, bright, LIGHT_MAP.reversed(), "a: template, shifted and scaled"),
        (axes[1], patch, bright, LIGHT_MAP.reversed(), "b: grey values below it"),
        (axes[2], left_over, Normalize(-largest, largest), DISTANCE_MAP, "c: what is left"),
    ):
        ax.imshow(values, cmap=colours, norm=norm, extent=extent, aspect="equal", gid=words[0])
        ax.axvline(x, color=VERMILION, lw=1.0)
        ax.set(xlabel=f"{across} / px", ylabel=f"{along} / px" if ax is axes[0] else "")
        ax.set_title(words)
        ax.yaxis.set_major_locator(MaxNLocator(5, integer=True))
        ax.tick_params(labelleft=ax is axes[0])
    look: dict[str, Any] = {"location": "bottom", "pad": 0.02}
    colour_bar(axes[:2], LIGHT_MAP.reversed(), bright, "grey value", aspect=30, **look)
    colour_bar(axes[2], DISTANCE_MAP, (-largest, largest), "difference", aspect=15, **look)
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
    xy = inside[["x_px", "y_px"]].to_numpy()
    return inside.iloc[int(np.argmin(np.square(xy - xy.mean(axis=0)).sum(axis=1)))]


def gauss_row(off_px: ArrayF, point: pd.Series) -> ArrayF:
    """Grey values at distances from the line's centre, as matching found it."""
    width, peak, ground = (float(point[name]) for name in ("width_px", "peak_dn", "background_dn"))
    return np.asarray(ground + peak * np.exp(-2.0 * np.square(off_px / width)))


def draw_line_patch(*, images: list[Path], line_points: Path, title: str) -> Figure:
    """An image of the laser line on a panel -> figure of the matching of one place."""
    image, _ = first_image(images, line_points)
    return line_patch(image, measured(image, ["lsm"])["lsm"], title=title)


# ---------------------------------------------------------------- an image with its line (P4 Fig. 16 and 18)


@styled
def sheet_image(image: AnyArray, points: pd.DataFrame, *, title: str = "Laser line") -> Figure:
    """The green channel with the measured line by flag, and a detail: where most points are flagged, or else
    where the line bends most.

    Parameters
    ----------
    image : as `thalweg.lightsheet.poses.read_sheet_image` gives it.
    points : columns `POINTS`, of this image.
    title : first words of the title.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    """
    table, green = need(points, POINTS, "line points"), green_of(image)
    table = table.assign(shown=shown_flag(table["flags"].to_numpy()))
    head = (
        f"{title}: line in {plural(table['piece'].nunique(), 'piece')}, median sigma "
        f"{table['sigma_px'].median():.2f} px, {count((table['flags'] != 0).sum())} flagged, "
        f"n = {count(len(table))} points"
    )
    figure = new_figure(104.0, head)
    left, right = figure.subplots(1, 2)
    h, w = green.shape
    side = min(max(int(DETAIL * max(h, w)), 40), h, w)
    middle = _middle_of_detail(table, side)
    x0, y0 = (int(np.clip(m - side / 2, 0, n - side)) for m, n in zip(middle, (w, h), strict=True))
    show_green(left, green)
    left.add_patch(Rectangle((x0, y0), side, side, fill=False, ec="white", lw=0.9))
    show_green(right, green[y0 : y0 + side, x0 : x0 + side], left=x0, top=y0)
    for ax, size in ((left, 1.2), (right, 3.5)):
        for flag, words, colour, marker in FLAGS:
            mine = table[table["shown"] == flag]
            if len(mine):
                dots(
                    ax,
                    mine["x_px"],
                    mine["y_px"],
                    colour,
                    marker,
                    ms=size,
                    label=f"{words}: {count(len(mine))}",
                    zorder=3,
                )
    right.set_xlim(x0, x0 + side)
    right.set_ylim(y0 + side, y0)
    left.set(title="a: image, green channel", xlabel="column / px", ylabel="row / px")
    right.set(title="b: detail (frame in a)", xlabel="column / px")
    figure.legend(*right.get_legend_handles_labels(), loc="outside lower left", ncols=3, markerscale=1.5)
    return figure


def shown_flag(flags: AnyArray) -> AnyArray:
    """The last flag (n,) of `FLAGS` that each point has; 0 for none."""
    out = np.zeros(len(flags), dtype=np.int64)
    for flag, *_ in FLAGS[1:]:
        out[(flags.astype(np.int64) & flag) != 0] = flag
    return out


def _middle_of_detail(table: pd.DataFrame, side: int) -> ArrayF:
    """Place (2,) with most flagged points around it; without flags, where neighbours are farthest apart."""
    flagged = table.loc[table["flags"] != 0, ["x_px", "y_px"]].to_numpy()
    if len(flagged):
        some = flagged[:: max(1, len(flagged) // 500)]
        near = np.abs(some[:, None] - flagged).max(axis=2) < side / 2
        return np.asarray(some[int(near.sum(axis=1).argmax())])
    order = table.sort_values("y_px" if np.ptp(table["y_px"]) > np.ptp(table["x_px"]) else "x_px")
    xy = order[["x_px", "y_px"]].to_numpy()
    step = np.abs(np.diff(xy, axis=0)).sum(axis=1)
    k = int(np.argmax(np.where(step < side / 2, step, 0.0))) if len(step) else 0
    return np.asarray(xy[k : k + 2].mean(axis=0))


def draw_line_on_markers(*, images: list[Path], line_points: Path, title: str) -> Figure:
    """An image of the stepped object and its line points -> figure of their flags."""
    image, points = first_image(images, line_points)
    return sheet_image(image, points, title=title)


def draw_sheet_image(*, images: list[Path], line_points: Path, scan: str, title: str) -> Figure:
    """Images of a scan and their line points -> figure of the middle image with its line."""
    points, _ = read_table(line_points, SERIES_POINTS)
    names = points["file"].unique()
    name = str(names[len(names) // 2])
    title = f"{title}, {scan}"
    return sheet_image(find_image(images, name), points[points["file"] == name], title=title)
