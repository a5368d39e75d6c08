"""What figures of the light-sheet sensor share: paths of light, oblique views, pictures, looks of depths."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from cmcrameri import cm
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PathCollection
from matplotlib.colors import Colormap, ListedColormap, Normalize, PowerNorm
from numpy.typing import ArrayLike

from thalweg.core import AnyArray, ArrayF, ArrayF32, InputError, read_parquet
from thalweg.figures import BLUE, GREEN, HALO, ORANGE, PURPLE, SKY, VERMILION
from thalweg.figures.calibration import Oblique
from thalweg.ingest.photos import list_images
from thalweg.lightsheet.lines import LineSettings, green_image
from thalweg.lightsheet.optics import Window, directions_to_points, refract_to_water
from thalweg.lightsheet.poses import read_sheet_image

DEPTH_STYLES: Final = (
    (BLUE, "-", "o"),
    (VERMILION, "--", "s"),
    (GREEN, "-.", "^"),
    (PURPLE, ":", "D"),
    (ORANGE, "-", "v"),
    (SKY, "--", "P"),
)
"""Colour, line and marker of each depth or level, in order: told apart in grey print as well."""

LIGHT_MAP: Final[Colormap] = ListedColormap(cm.grayC_r(np.linspace(0.0, 1.0, 256)), "thalweg_light")
"""Dark where no light is, white where most is."""

BRIGHTENING: Final = 0.5
"""Exponent of grey values in pictures: the line stays white and its surroundings can be seen."""

LIGHT_COLOUR: Final = "#4daf4a"
"""Green light of the laser, for fans only: no meaning hangs on it."""

WATER_COLOUR: Final = "#e3f0f8"
GLASS_COLOUR: Final = "#b9cfdb"


Look = dict[str, Any]
"""Keywords of Matplotlib."""


def need(table: pd.DataFrame, columns: Sequence[str], what: str) -> pd.DataFrame:
    """The table, if it has rows and the columns.

    Raises
    ------
    InputError : it has not.
    """
    missing = [name for name in columns if name not in table.columns]
    if missing or not len(table):
        raise InputError(
            f"columns missing: {', '.join(missing)}" if missing else "an empty table",
            expected=f"{what} with {', '.join(columns)}",
        )
    return table


def find_image(images: Sequence[Path], name: str) -> AnyArray:
    """Pixels of the image of that name in a series of files and folders.

    Raises
    ------
    InputError : it is not there.
    """
    files = {path.name: path for path in list_images(images)}
    if name not in files:
        raise InputError(f"no image {name}", expected="the images that were measured")
    return read_sheet_image(files[name])


def green_of(image: AnyArray) -> ArrayF32:
    """Green grey values (h, w); in a mosaic those of red and blue pixels are interpolated."""
    # pictures of over-exposed images are wanted as well
    return green_image(image, LineSettings(largest_saturated_share=1.0)).dn


def show_green(ax: Axes, green: AnyArray, *, left: int = 0, top: int = 0) -> None:
    """A picture or part of one, brightened, in pixels from the upper left corner of the whole."""
    h, w = green.shape
    bright = float(np.percentile(green, 99.9)) if green.size else 1.0
    ax.imshow(
        green,
        cmap=LIGHT_MAP.reversed(),
        norm=PowerNorm(BRIGHTENING, 0.0, max(bright, 1.0)),
        extent=(left, left + w, top + h, top),
        aspect="equal",
    )
    ax.set_xlim(left, left + w)
    ax.set_ylim(top + h, top)


def beam_paths(origin_lcs_mm: ArrayF, directions: ArrayF, window: Window, depth_mm: ArrayLike) -> ArrayF:
    """Corners (n, 4, 3) of the paths of light: start, inner and outer face of the window, place at a depth.

    Parameters
    ----------
    origin_lcs_mm : (3,) of laser or camera.
    directions : (n, 3) in air, lcs.
    window : of the sensor.
    depth_mm : of the ends, one number or (n,).
    """
    start = np.broadcast_to(np.asarray(origin_lcs_mm, dtype=np.float64), directions.shape)
    normal = window.normal_lcs
    way = -(start @ normal) / (directions @ normal)
    inner = start + way[:, None] * directions
    rays = refract_to_water(origin_lcs_mm, directions, window)
    return np.stack([start, inner, rays.at_depth(0.0), rays.at_depth(depth_mm)], axis=1)


def path_to(origin_lcs_mm: ArrayF, point_lcs_mm: ArrayF, window: Window) -> ArrayF:
    """Corners (4, 3) of the path of light from laser or camera to a point in the water."""
    direction = directions_to_points(origin_lcs_mm, point_lcs_mm[None], window)
    return np.asarray(beam_paths(origin_lcs_mm, direction, window, window.depth_mm(point_lcs_mm[None]))[0])


def pair(both: ArrayF) -> tuple[ArrayF, ArrayF]:
    """The two rows of (2, n), for what takes x and y."""
    return both[0], both[1]


def dots(ax: Axes, x: ArrayLike, y: ArrayLike, colour: str, marker: str = ".", **look: Any) -> None:
    """Marks without a line between them."""
    edge = 0.0 if marker in ".os^vDP" else 1.2
    look = {"ms": 2.0, "mew": edge} | look
    ax.plot(np.asarray(x), np.asarray(y), ls="none", marker=marker, color=colour, **look)


def spots(ax: Axes, x: ArrayLike, y: ArrayLike, colours: Any, **look: Any) -> PathCollection:
    """Many small points of a colour each, as pixels."""
    return ax.scatter(np.asarray(x), np.asarray(y), c=colours, lw=0, rasterized=True, **look)


def line_numbers(files: "pd.Series[str]") -> tuple[ArrayF, ScalarMappable]:
    """Numbers (n,) of the lines of a scan from 1 by the names of their images, and their colours."""
    number = 1.0 + pd.factorize(files)[0].astype(np.float64)
    return number, ScalarMappable(Normalize(1, max(float(number.max()), 2.0)), cm.batlow)


@dataclass(frozen=True, slots=True)
class Space:
    """A panel that shows places of lcs, millimetres, in an oblique view."""

    ax: Axes
    view: Oblique

    def flat(self, points_mm: ArrayF) -> ArrayF:
        """Coordinates (2, n) in the panel."""
        return self.view.apply(np.atleast_2d(points_mm))[0].T

    def path(self, points_mm: ArrayF, colour: Any, **look: Any) -> None:
        """A line through points (n, 3)."""
        self.ax.plot(*self.flat(points_mm), color=colour, **look)

    def dots(self, points_mm: ArrayF, colour: str, marker: str = ".", **look: Any) -> None:
        """Marks at points (n, 3)."""
        dots(self.ax, *pair(self.flat(points_mm)), colour, marker, **look)

    def area(self, corners_mm: ArrayF, colour: str, **look: Any) -> None:
        """A polygon."""
        look = {"edgecolor": "0.4", "lw": 0.5, **look}
        self.ax.fill(*self.flat(corners_mm), facecolor=colour, **look)

    def plate(self, low: ArrayF, high: ArrayF, z_mm: float, colour: str, **look: Any) -> None:
        """A level rectangle."""
        x, y = np.array([low[0], high[0], high[0], low[0]]), np.array([low[1], low[1], high[1], high[1]])
        self.area(np.stack([x, y, np.full(4, z_mm)], axis=1), colour, **look)

    def words(self, place_mm: ArrayF, words: str, dy: float = 0.0) -> None:
        """Words at a place."""
        ((x,), (y,)) = self.flat(place_mm)
        self.ax.text(x, y + dy, words, fontsize=7, va="center", path_effects=HALO, zorder=20)

    def device(self, place_mm: ArrayF, words: str) -> None:
        """Laser or camera, with its name."""
        self.dots(place_mm, "black", "s", ms=5, zorder=10)
        self.words(place_mm, f"   {words}")

    def cross(self, at_mm: ArrayF, length_mm: float) -> None:
        """The axes x, y, z of lcs."""
        arrow = {"arrowstyle": "-|>", "color": "0.2", "lw": 0.9, "shrinkA": 0, "shrinkB": 0}
        for name, step in zip("xyz", length_mm * np.eye(3), strict=True):
            start, end = self.flat(np.stack([at_mm, at_mm + step])).T
            # the line makes room for the arrow, which has none of its own
            self.ax.plot(*np.stack([start, end]).T, color="0.2", lw=0.6, zorder=15)
            self.ax.annotate("", end, xytext=start, zorder=15, annotation_clip=False, arrowprops=arrow)
            x, y = start + 1.25 * (end - start)
            self.ax.text(x, y, name, fontsize=7, ha="center", va="center", path_effects=HALO, zorder=16)

    def finish(self, title: str) -> None:
        """Equal scales, no frame, a title."""
        self.ax.set_aspect("equal")
        self.ax.margins(0.05)
        self.ax.axis("off")
        self.ax.set_title(title)


def depth_styles(depths_mm: Sequence[float]) -> Mapping[float, tuple[str, str, str]]:
    """Colour, line and marker of each depth."""
    return {depth: DEPTH_STYLES[k % len(DEPTH_STYLES)] for k, depth in enumerate(depths_mm)}


def along_and_off(x: ArrayF, y: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Places (n,) of points along the straight line with least squared distances, from its middle, and those
    distances (n,).
    """
    points = np.stack([x, y], axis=1)
    off = points - points.mean(axis=0)
    axes = np.linalg.svd(off, full_matrices=False)[2]
    # from the first point to the last one
    axes[0] *= np.sign((points[-1] - points[0]) @ axes[0]) or 1.0
    axes[1] = [-axes[0, 1], axes[0, 0]]
    return np.asarray(off @ axes[0]), np.asarray(off @ axes[1])


def first_image(images: Sequence[Path], line_points: Path) -> tuple[AnyArray, pd.DataFrame]:
    """Pixels of the first image of a series that has line points, and these points.

    Raises
    ------
    InputError : the table has no points, or the image is not there.
    """
    table = need(read_parquet(line_points), ("file", "x_px", "y_px"), "line points")
    name = str(table["file"].iloc[0])
    return find_image(images, name), table[table["file"] == name].reset_index(drop=True)
