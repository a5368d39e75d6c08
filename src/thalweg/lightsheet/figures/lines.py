"""Measurement of the laser line: methods, one patch, bright markers, an image of a scan."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from thalweg.core import NMAD, AnyArray, ArrayB, ArrayF, CoverageError, read_table
from thalweg.figures import BLUE, ORANGE, RED, SKY, VERMILION, count, new_figure, plural, styled
from thalweg.figures.accuracy import DISTANCE_MAP
from thalweg.lightsheet.figures.views import LIGHT_MAP, find_image, first_image, green_of, need, show_green
from thalweg.lightsheet.lines import LineFlag, LineSettings, Method, detect_lines
from thalweg.lightsheet.poses import SERIES_POINTS

METHODS: Final[dict[Method, tuple[str, str, str]]] = {
    "row_gauss": ("each row for itself", SKY, "o"),
    "lsm": ("patch of 15 x 15", ORANGE, "^"),
    "speckle_patch": ("speckle-weighted patch", VERMILION, "s"),
}
"""Words, colour and marker of each method of `thalweg.lightsheet.lines.settings.LineSettings`."""
COLUMNS: Final = ("x_px", "y_px", "sigma_px", "angle_rad", "peak_dn", "width_px", "background_dn", "flags")
"""Columns of line points that the figures use."""
DETAIL_ROWS: Final = 30
PROFILE_ROWS: Final = 3
_SIZES: Final[dict[Method, float]] = {"row_gauss": 4.5, "lsm": 4.5, "speckle_patch": 2.0}
_SMOOTH_DEGREE: Final = 8
_BESIDE: Final = 6.0
"""Half widths of the line that a detail shows on either side."""
_PROFILE_STYLES: Final = ((BLUE, "-", "o"), (VERMILION, "--", "s"), (ORANGE, "-.", "^"))

SIDE: Final = 15
"""Rows and columns of the patch (P4 4.1)."""

MARKER_COLUMNS: Final = ("x_px", "y_px", "angle_rad", "peak_dn", "width_px", "flags")
FLAGS: Final = (
    (0, "without reserve", SKY, "o"),
    (int(LineFlag.WEAK), "weak", BLUE, "v"),
    (int(LineFlag.NEAR_JUMP), "near a jump", ORANGE, "^"),
    (int(LineFlag.ALBEDO_EDGE), "edge of the brightness", VERMILION, "D"),
    (int(LineFlag.SATURATED), "saturated", RED, "x"),
    (int(LineFlag.APART), "apart from the line", BLUE, "+"),
)
"""Flags with words, colour and marker; a point with several shows the last of them."""
_BESIDE_MARKER: Final = 8.0
"""Half widths of the line that the pictures show on either side."""
_DETAIL_SHARE: Final = 0.12
"""Part of the line's length that the detail shows."""

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
        keep = np.abs(e) <= 4 * NMAD * np.median(np.abs(e)) + 1e-9
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
        ax.plot(
            near["x_px"],
            near["y_px"],
            ls="none",
            marker=marker,
            ms=_SIZES[name],
            mfc=face,
            mec=colour,
            mew=0.9,
            label=words,
            gid=f"{name} points",
        )
    ax.set_aspect("auto")
    ax.set(xlabel=x)
    ax.set_title("b: detail and measured points")


def _profiles(
    ax: Axes, green: AnyArray, tables: Mapping[Method, pd.DataFrame], middle: float, row: str, x: str
) -> None:
    """Grey values of adjacent rows, the Gaussian curve of each and where the last method sees the line."""
    names = list(tables)
    own, last = tables[names[0]], tables[names[-1]]
    for k, (colour, style, marker) in enumerate(_PROFILE_STYLES[:PROFILE_ROWS]):
        at = int(middle) + k
        rows = own[(own["y_px"] - at - 0.5).abs() < 0.5]
        if not len(rows) or at >= green.shape[0]:
            continue
        fit = rows.iloc[0]
        reach = 0.8 * _BESIDE * float(fit["width_px"])
        x_px = np.arange(max(int(fit["x_px"] - reach), 0), min(int(fit["x_px"] + reach) + 1, green.shape[1]))
        ax.plot(
            x_px + 0.5,
            green[at, x_px],
            color=colour,
            marker=marker,
            ms=2.5,
            lw=0.5,
            alpha=0.7,
            label=f"{row} {at}",
            gid="profile",
        )
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
        ax.hist(
            e,
            bins=bins,
            histtype="step",
            color=colour,
            lw=1.3,
            density=True,
            label=f"{words}: {std:.2f} px",
            gid=f"{name} histogram",
        )
    ax.set(xlabel="distance from a smooth line / px", ylabel="density / (1/px)", yscale="log")
    low, high = ax.get_ylim()
    ax.set_ylim(low, high * 200)
    ax.set_title("d: standard deviations")
    ax.legend(loc="upper left")


def _along(ax: Axes, tables: Mapping[Method, pd.DataFrame], off: Mapping[Method, ArrayF], y: str) -> None:
    for name, table in tables.items():
        words, colour, marker = METHODS[name]
        ax.plot(
            table["y_px"],
            off[name],
            ls="none",
            marker=marker,
            ms=2.0,
            color=colour,
            label=words,
            gid=f"{name} departures",
            mew=0.0,
        )
    largest = max(float(np.nanpercentile(np.abs(e), 99.5)) for e in off.values())
    ax.axhline(0.0, color="0.3", lw=0.6)
    ax.set(xlabel=y, ylabel="distance / px", ylim=(-1.15 * largest, 1.15 * largest))
    beyond = sum(int(np.nansum(np.abs(e) > 1.15 * largest)) for e in off.values())
    ax.set_title(f"e: distances of the points from a smooth line; {plural(beyond, 'point')} beyond the frame")
    ax.legend(loc="upper left", ncols=len(off))
    ax.grid()


def draw_line_measurement(*, images: list[Path], line_points: Path, title: str, twin: bool) -> Figure:
    """An image of the laser line on a panel -> figure of what each method of measurement reaches."""
    image, _ = first_image(images, line_points)
    return line_measurement(image, measured(image), title=title, twin=twin)


# ---------------------------------------------------------------- matching of one place (P4 Fig. 6)


@styled
def line_patch(
    image: AnyArray, points: pd.DataFrame, *, title: str = "Line measurement", twin: bool = False
) -> Figure:
    """Template of Gaussian rows, the grey values below it, their difference; grey values of all rows.

    The place is the point nearest to the middle of the line whose patch lies in the picture.

    Parameters
    ----------
    image : (h, w) mosaic or monochrome, or (h, w, 3).
    points : columns `thalweg.lightsheet.figures.lines.COLUMNS`, by the method ``lsm``.
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
    ax.plot(
        fine,
        gauss_row(fine - x, point),
        color=VERMILION,
        lw=2.0,
        gid="template",
        label=f"template, half width {float(point['width_px']):.2f} px",
    )
    ax.axvline(x, color=VERMILION, lw=0.8, ls="--", label=f"place {x:.2f} px")
    ax.set(xlabel=label, ylabel="grey value / 1", xlim=(place[0], place[-1]))
    ax.set_title("d: grey values of the rows")
    ax.legend(loc="upper left")
    ax.grid()


def draw_line_patch(*, images: list[Path], line_points: Path, title: str, twin: bool) -> Figure:
    """An image of the laser line on a panel -> figure of the matching of one place."""
    image, _ = first_image(images, line_points)
    return line_patch(image, measured(image, ["lsm"])["lsm"], title=title, twin=twin)


# ---------------------------------------------------------------- over white markers (P4 Fig. 16)


@styled
def line_on_markers(
    image: AnyArray, points: pd.DataFrame, *, title: str = "Flags of the line", twin: bool = False
) -> Figure:
    """The line with its points by flag, a detail where most are flagged, and brightness and width along it.

    Parameters
    ----------
    image : (h, w) mosaic or monochrome, or (h, w, 3).
    points : columns `MARKER_COLUMNS`, of this image.
    title : first words of the title.
    twin : true if the digital twin made the image.

    Raises
    ------
    InputError : no points, or columns are missing.
    """
    table, green = need(points, MARKER_COLUMNS, "line points"), green_of(image)
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
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower left", ncols=3)
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
    aside = 0.6 * _BESIDE_MARKER * max(float(table["width_px"].median()), 1.0)
    left, right = float(near["x_px"].min()) - aside, float(near["x_px"].max()) + aside
    return max(int(left), 0), max(int(top), 0), int(right - left), int(rows)


def _whole_box(table: pd.DataFrame, height: int) -> tuple[int, int, int, int]:
    aside = _BESIDE_MARKER * max(float(table["width_px"].median()), 1.0)
    left, right = float(table["x_px"].min()) - aside, float(table["x_px"].max()) + aside
    return max(int(left), 0), 0, int(right - left), height


def _picture(
    ax: Axes, green: AnyArray, table: pd.DataFrame, box: tuple[int, int, int, int], size: float
) -> None:
    left, top, width, height = box
    show_green(ax, green[top : top + height, left : left + width], left=left, top=top)
    for flag, words, colour, marker in FLAGS:
        mine = table[table["shown"] == flag]
        ax.plot(
            mine["x_px"],
            mine["y_px"],
            ls="none",
            marker=marker,
            ms=size,
            color=colour,
            label=f"{words}: {count(len(mine))}",
            gid=f"flag {flag}",
        )
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


def draw_line_on_markers(*, images: list[Path], line_points: Path, title: str, twin: bool) -> Figure:
    """An image of the stepped object and its line points -> figure of their flags."""
    image, points = first_image(images, line_points)
    return line_on_markers(image, points, title=title, twin=twin)


# ---------------------------------------------------------------- an image of a scan (P4 Fig. 18)


@styled
def sheet_image(
    image: AnyArray, points: pd.DataFrame, *, title: str = "Laser line", twin: bool = False
) -> Figure:
    """The green channel with the measured line, and a detail with single points.

    Parameters
    ----------
    image : (h, w) mosaic or grey, or (h, w, 3).
    points : columns `POINTS`, of this image.
    title : first words of the title.
    twin : true if the digital twin made the image.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    """
    need(points, POINTS, "line points")
    green = green_of(image)
    pieces = int(points["piece"].nunique())
    flagged = int((points["flags"] != 0).sum())
    head = (
        f"{title}: line in {plural(pieces, 'piece')}, median sigma {points['sigma_px'].median():.2f} px, "
        f"{count(flagged)} flagged, n = {count(len(points))} points"
    )
    figure = new_figure(96.0, head, twin=twin)
    left, right = figure.subplots(1, 2)
    show_green(left, green)
    _line(left, points, 0.9)
    side = max(int(DETAIL * max(green.shape)), 40)
    # where the line bends most between neighbours there is most to see: an edge of the object
    order = points.sort_values("y_px" if np.ptp(points["y_px"]) > np.ptp(points["x_px"]) else "x_px")
    step = np.abs(np.diff(order[["x_px", "y_px"]].to_numpy(np.float64), axis=0)).sum(axis=1)
    k = int(np.argmax(np.where(step < side / 2, step, 0.0))) if len(step) else 0
    middle = order[["x_px", "y_px"]].iloc[k : k + 2].mean().to_numpy()
    x0, y0 = (int(np.clip(m - side / 2, 0, n - side)) for m, n in zip(middle, green.shape[::-1], strict=True))
    left.add_patch(Rectangle((x0, y0), side, side, fill=False, ec="white", lw=0.9))
    show_green(right, green[y0 : y0 + side, x0 : x0 + side], left=x0, top=y0)
    _line(right, points, 3.0)
    right.set_xlim(x0, x0 + side)
    right.set_ylim(y0 + side, y0)
    left.set(title="a: image, green channel", xlabel="column / px", ylabel="row / px")
    right.set(title="b: detail (frame in a)", xlabel="column / px")
    right.legend(loc="upper right")
    return figure


def _line(ax: Axes, points: pd.DataFrame, size: float) -> None:
    good = points["flags"] == 0
    for keep, colour, words in ((good, VERMILION, "measured"), (~good, ORANGE, "measured, flagged")):
        if keep.any():
            ax.plot(
                points["x_px"][keep],
                points["y_px"][keep],
                ls="none",
                marker=".",
                ms=size,
                mew=0,
                color=colour,
                label=words,
                gid=words.replace(", ", "-"),
                zorder=3,
            )


def draw_sheet_image(*, images: list[Path], line_points: Path, scan: str, title: str, twin: bool) -> Figure:
    """Images of a scan and their line points -> figure of the middle image with its line."""
    points, _ = read_table(line_points, SERIES_POINTS)
    names = points["file"].unique()
    name = str(names[len(names) // 2])
    title = f"{title}, {scan}"
    return sheet_image(find_image(images, name), points[points["file"] == name], title=title, twin=twin)
