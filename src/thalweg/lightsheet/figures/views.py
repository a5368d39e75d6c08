"""What figures of the light-sheet sensor share: paths of light, oblique views, pictures, looks of depths."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from cmcrameri import cm
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, ListedColormap, PowerNorm
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
        gid="picture",
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


def plate(low: ArrayF, high: ArrayF, z_mm: float) -> ArrayF:
    """Corners (4, 3) of a level rectangle."""
    return np.array(
        [[low[0], low[1], z_mm], [high[0], low[1], z_mm], [high[0], high[1], z_mm], [low[0], high[1], z_mm]]
    )


def fill_oblique(
    ax: Axes, view: Oblique, corners_mm: ArrayF, colour: str, *, alpha: float, zorder: float, gid: str = ""
) -> None:
    """A polygon in an oblique view."""
    flat = view.apply(corners_mm)[0]
    ax.fill(*flat.T, facecolor=colour, edgecolor="0.4", lw=0.5, alpha=alpha, zorder=zorder, gid=gid)


def words_oblique(
    ax: Axes, view: Oblique, place_mm: ArrayF, words: str, *, ha: str = "left", dy: float = 0.0
) -> None:
    """Words at a place of an oblique view."""
    x, y = view.apply(place_mm)[0]
    ax.text(float(x), float(y) + dy, words, fontsize=7, ha=ha, va="center", path_effects=HALO, zorder=20)


def axes_cross(ax: Axes, view: Oblique, at_mm: ArrayF, length_mm: float) -> None:
    """The axes x, y, z of lcs, drawn at a place of an oblique view."""
    for name, step in zip("xyz", np.eye(3), strict=True):
        ends = view.apply(np.stack([at_mm, at_mm + length_mm * step]))[0]
        # the line makes room for the arrow, which has none of its own
        ax.plot(*ends.T, color="0.2", lw=0.6, zorder=15)
        ax.annotate(
            "",
            tuple(ends[1]),
            xytext=tuple(ends[0]),
            zorder=15,
            annotation_clip=False,
            arrowprops={"arrowstyle": "-|>", "color": "0.2", "lw": 0.9, "shrinkA": 0, "shrinkB": 0},
        )
        tip = ends[0] + 1.25 * (ends[1] - ends[0])
        ax.text(
            float(tip[0]),
            float(tip[1]),
            name,
            fontsize=7,
            ha="center",
            va="center",
            path_effects=HALO,
            zorder=16,
        )


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
