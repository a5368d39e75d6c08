"""A fifteen-line laser: geometry, images, labels of its lines."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from cmcrameri import cm
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure

from thalweg.core import AnyArray, ArrayF, InputError
from thalweg.figures import SKY, count, mark_twin, new_figure, plural, styled
from thalweg.figures.calibration import Oblique
from thalweg.lightsheet.figures import (
    GLASS_COLOUR,
    LIGHT_COLOUR,
    WATER_COLOUR,
    Look,
    Space,
    dots,
    green_of,
    mesh_picture,
    need,
    pair,
    path_to,
    show_green,
    spots,
)
from thalweg.lightsheet.optics import Sensor, paper_4, refract_to_water

LINES: Final = ("line", "fan_angle_deg", "depth_mm", "x_mm", "y_mm", "z_mm", "x_px", "y_px", "in_picture")
"""Columns of `thalweg_lab.multi_line.scan_labels.line_table`."""
LINE_MAP: Final[Colormap] = ListedColormap(cm.batlow(np.linspace(0.0, 0.9, 256)), "thalweg_lines")
"""Number of a line: dark for the first, light for the last; without the end that vanishes on paper."""
VIEW: Final = Oblique(azimuth_deg=62.0, elevation_deg=20.0)
_WIDTHS: Final = (0.7, 1.1, 1.5)

IMAGE_POINTS: Final = ("object", "line", "best_line", "true_line", "x_px", "y_px", "x_mm", "y_mm", "z_mm")
NAMES: Final = {"calibration": "grid above a plate", "plane": "plane", "wreck": "wreck, a part"}
"""Objects in the order of the columns."""
IMAGES_VIEW: Final = Oblique(azimuth_deg=62.0, elevation_deg=24.0)
_OBJECT_COLOUR: Final = "#d8c9a6"
_BOX_MM: Final = 75.0
"""How far the object is drawn around the middle of the lines, in plan."""


# ---------------------------------------------------------------- lines in space, in a section, in the image
# (T Fig. 4.3)


@styled
def multi_line_geometry(lines: pd.DataFrame, sensor: Sensor | None = None) -> Figure:
    """Lines on levels in an oblique view; paths of light in the plane across the lines; lines in the picture.

    Parameters
    ----------
    lines : columns `LINES`.
    sensor : that the lines were computed with; None: that of P4.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    """
    need(lines, LINES, "lines of a laser on levels")
    sensor = paper_4() if sensor is None else sensor
    numbers = sorted(lines["line"].unique())
    depths = sorted(lines["depth_mm"].unique())
    words = ", ".join(f"{depth:g}" for depth in depths)
    head = (
        f"A laser with n = {plural(len(numbers), 'line')} under the sensor of P4, on levels {words} mm deep "
        "(geometry, no data)"
    )
    figure = new_figure(150.0, head)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.15, 1.0], height_ratios=[1.0, 1.0])
    colours = ScalarMappable(Normalize(min(numbers), max(numbers)), LINE_MAP)
    left = figure.add_subplot(grid[:, 0])
    section, picture = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    _space(Space(left, VIEW), lines, sensor, colours)
    _section(section, lines, sensor, colours)
    _picture(picture, lines, sensor, colours)
    figure.colorbar(colours, ax=left, label="number of the line", location="bottom", aspect=40, pad=0.02)
    return figure


def _space(space: Space, lines: pd.DataFrame, sensor: Sensor, colours: ScalarMappable) -> None:
    laser, eye = sensor.sheet.origin_lcs_mm, sensor.camera_origin_lcs_mm
    places = np.concatenate([lines[["x_mm", "y_mm"]].to_numpy(np.float64), laser[None, :2], eye[None, :2]])
    low, high = places.min(axis=0) - 15.0, places.max(axis=0) + 15.0
    for depth, level in lines.groupby("depth_mm", sort=True):
        xyz = level[["x_mm", "y_mm", "z_mm"]].to_numpy(np.float64)
        inner, outer, z = xyz.min(axis=0) - 8.0, xyz.max(axis=0) + 8.0, float(xyz[:, 2].mean())
        space.plate(inner, outer, z, "0.92", alpha=0.8, zorder=1 + 1e-3 * z)
        for number, line in level.groupby("line"):
            xyz = line.sort_values("fan_angle_deg")[["x_mm", "y_mm", "z_mm"]].to_numpy(np.float64)
            space.path(xyz, colours.to_rgba(np.array(number)), lw=1.3, zorder=4, gid="line")
            for end in xyz[[0, -1]] if depth == lines["depth_mm"].max() else xyz[:0]:
                path = path_to(laser, end, sensor.window)
                space.path(path, colours.to_rgba(np.array(number)), lw=0.5, alpha=0.7, zorder=3)
        space.words(np.array([outer[0], inner[1], z]), f" {depth:g} mm")
    for z, colour in ((-sensor.window.thickness_mm, WATER_COLOUR), (0.0, GLASS_COLOUR)):
        space.plate(low, high, z, colour, alpha=0.4, zorder=5)
    seen = lines[lines["in_picture"] & (lines["depth_mm"] == lines["depth_mm"].max())]
    if len(seen):
        middle = seen[["x_mm", "y_mm", "z_mm"]].to_numpy(np.float64)[len(seen) // 2]
        path = path_to(eye, middle, sensor.window)
        space.path(path, "black", lw=0.8, ls="--", zorder=6)
    space.device(laser, "laser")
    space.device(eye, "camera")
    space.cross(np.array([low[0], low[1], 0.5 * float(lines["z_mm"].min())]), 30.0)
    space.finish("a: in space; dashed: an image ray")


def _section(ax: Axes, lines: pd.DataFrame, sensor: Sensor, colours: ScalarMappable) -> None:
    """Middles of the lines in the plane that contains laser and camera: across the lines, and height."""
    across, thick = across_direction(lines), sensor.window.thickness_mm
    laser, eye = sensor.sheet.origin_lcs_mm, sensor.camera_origin_lcs_mm
    middles = lines.loc[lines["fan_angle_deg"].abs().groupby([lines["line"], lines["depth_mm"]]).idxmin()]
    xyz = middles[["x_mm", "y_mm", "z_mm"]].to_numpy(np.float64)
    deepest = (middles["depth_mm"] == middles["depth_mm"].max()).to_numpy()
    for number, place in zip(middles["line"][deepest], xyz[deepest], strict=True):
        path = path_to(laser, place, sensor.window)
        look: Look = {"color": colours.to_rgba(np.array(number)), "lw": 0.9, "zorder": 3, "gid": "sub-beam"}
        ax.plot(path @ across, path[:, 2], **look)
    spots(ax, xyz @ across, xyz[:, 2], colours.to_rgba(middles["line"].to_numpy()), s=7, zorder=4)
    seen = xyz[deepest & middles["in_picture"].to_numpy()]
    for place in seen[[0, -1]] if len(seen) else seen:
        path = path_to(eye, place, sensor.window)
        ax.plot(path @ across, path[:, 2], color="black", lw=0.8, ls="--", zorder=2)
    for words, place in (("laser", laser), ("camera", eye)):
        at = float(place @ across), float(place[2])
        dots(ax, at[:1], at[1:], "black", "s", ms=4, zorder=5)
        ax.annotate(words, at, xytext=(5, 3), textcoords="offset points", fontsize=7)
    low = float(xyz[:, 2].min()) - 15.0
    ax.axhspan(-thick, 0.0, color=GLASS_COLOUR, lw=0, zorder=0)
    ax.axhspan(low, -thick, color=WATER_COLOUR, lw=0, zorder=0)
    ax.set_ylim(low, None)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel="across the lines / mm", ylabel="z / mm")
    ax.set_title("b: middles of the lines, in a section")


def across_direction(lines: pd.DataFrame) -> ArrayF:
    """Level unit vector (3,) across the lines, from the first to the last on the deepest level."""
    level = lines[lines["depth_mm"] == lines["depth_mm"].max()]
    middles = level.groupby("line")[["x_mm", "y_mm"]].mean().to_numpy(np.float64)
    way = middles[-1] - middles[0] if len(middles) > 1 else np.array([1.0, 0.0])
    return np.array([*(way / np.linalg.norm(way)), 0.0])


def _picture(ax: Axes, lines: pd.DataFrame, sensor: Sensor, colours: ScalarMappable) -> None:
    width, height = sensor.camera.size_px
    inside = lines[lines["in_picture"]].sort_values("fan_angle_deg")
    for (depth, level), lw in zip(inside.groupby("depth_mm"), cycle(_WIDTHS), strict=False):
        for number, line in level.groupby("line"):
            look: Look = {"color": colours.to_rgba(np.array(number)), "lw": lw, "gid": f"image {depth:g}"}
            ax.plot(line["x_px"], line["y_px"], **look)
        at = (float(level["x_px"].mean()), float(level["y_px"].min()))
        look = {"xytext": (0, 4), "textcoords": "offset points", "ha": "center", "fontsize": 7}
        ax.annotate(f"{depth:g} mm", at, **look)
    ax.set_xlim(0, width)
    ax.set_ylim(height, 0)
    ax.set_aspect("equal")
    ax.set(xlabel="column / px", ylabel="row / px")
    ax.set_title("c: in the image")


# ---------------------------------------------------------------- set-ups and images (T Fig. 4.4)


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenObject:
    """An image (h, w), and what was seen: vertices (n, 3) in lcs, millimetres, and faces (m, 3)."""

    image: AnyArray
    vertices_lcs_mm: ArrayF
    faces: AnyArray


def read_objects(path: Path) -> dict[str, SeenObject]:
    """Images and meshes of `thalweg_lab.studies.sensors.laser_lines`, in the order of `NAMES`.

    Raises
    ------
    InputError : the file is missing, or lacks an object.
    """
    if not path.is_file():
        raise InputError("file not found", expected="images of a fifteen-line laser (NPZ)", where=path)
    with np.load(path, allow_pickle=False) as data:
        missing = [name for name in NAMES if f"image_{name}" not in data]
        if missing:
            raise InputError(f"no {missing[0]}", expected=f"the objects {', '.join(NAMES)}", where=path)
        return {
            name: SeenObject(
                image=data[f"image_{name}"],
                vertices_lcs_mm=data[f"vertices_{name}"].astype(np.float64),
                faces=data[f"faces_{name}"],
            )
            for name in NAMES
        }


@styled
def multi_line_images_view(
    objects: Mapping[str, SeenObject], points: pd.DataFrame, sensor: Sensor | None = None
) -> Figure:
    """Above: sensor, object, and the places of labelled points. Below: the images with measured points.

    Parameters
    ----------
    objects : by name, see `read_objects`.
    points : columns `IMAGE_POINTS`; ``line`` is -1 for a point without label.
    sensor : that took the images; None: that of P4.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    """
    need(points, IMAGE_POINTS, "points of a fifteen-line laser")
    sensor = paper_4() if sensor is None else sensor
    labelled = points[points["line"] >= 0]
    right = float((labelled["line"] == labelled["true_line"]).mean()) if len(labelled) else float("nan")
    head = (
        f"A laser of fifteen lines: n = {count(len(points))} measured points, {count(len(labelled))} with a "
        f"label, of which {100 * right:.1f} % are right"
    )
    figure = new_figure(142.0, head)
    mark_twin(figure)
    axes = figure.subplots(2, len(objects), height_ratios=[1.15, 1.0])
    colours = ScalarMappable(Normalize(0, max(int(points["line"].max()), 1)), LINE_MAP)
    for k, (name, seen) in enumerate(objects.items()):
        mine = points[points["object"] == name]
        _setup(axes[0, k], seen, mine, sensor, colours)
        axes[0, k].set_title(f"{'abc'[k]}: {NAMES.get(name, name)}")
        _image(axes[1, k], seen, mine, colours)
        axes[1, k].set_title(f"{'def'[k]}: {image_words(mine)}", fontsize=7.5)
        axes[1, k].set(xlabel="column / px", ylabel="row / px" if k == 0 else "")
    figure.colorbar(colours, ax=axes, label="number of the line", location="bottom", aspect=60, pad=0.01)
    return figure


def image_words(points: pd.DataFrame) -> str:
    """How many points of an image have a label; where none has, how good a guess would be."""
    if points.empty:
        return "no points"
    has = points["line"] >= 0
    if has.any():
        return f"{count(int(has.sum()))} of {count(len(points))} points labelled"
    guessed = float((points["best_line"] == points["true_line"]).mean())
    return f"{count(len(points))} points, none labelled;\nguesses right: {100 * guessed:.0f} %"


def _image(ax: Axes, seen: SeenObject, points: pd.DataFrame, colours: ScalarMappable) -> None:
    show_green(ax, green_of(seen.image))
    has = points["line"] >= 0
    none, given = points[~has], points[has]
    if len(none):
        dots(ax, none["x_px"], none["y_px"], SKY, ms=1.1, zorder=3)
    shades = colours.to_rgba(given["line"].to_numpy())
    spots(ax, given["x_px"], given["y_px"], shades, s=1.2, zorder=4)
    if points.empty:
        return
    xy, size = points[["x_px", "y_px"]].to_numpy(np.float64), np.array(seen.image.shape[1::-1])
    low, high = xy.min(axis=0) - 0.05 * size[1], xy.max(axis=0) + 0.05 * size[1]
    side = 0.5 * float((high - low).max())
    x, y = np.clip(0.5 * (low + high), side, size - side)
    ax.set_xlim(x - side, x + side)
    ax.set_ylim(y + side, y - side)


def _setup(ax: Axes, seen: SeenObject, points: pd.DataFrame, sensor: Sensor, colours: ScalarMappable) -> None:
    laser, eye, window = sensor.sheet.origin_lcs_mm, sensor.camera_origin_lcs_mm, sensor.window
    space = Space(ax, IMAGES_VIEW)
    given = points[points["line"] >= 0]
    places = given[["x_mm", "y_mm", "z_mm"]].to_numpy(np.float64)
    if len(places):
        middle = places.mean(axis=0)
    else:
        # where the middle of the laser's light meets the height of the object's ground
        water = refract_to_water(laser, sensor.sheet.beams(0.0), window)
        middle = water.at_depth(window.depth_mm(seen.vertices_lcs_mm).max())[0]
    low, high = (np.array([*(middle[:2] + side), 0.0]) for side in (-_BOX_MM, _BOX_MM))
    low[2], high[2] = float(seen.vertices_lcs_mm[:, 2].min()) - 1.0, -window.thickness_mm
    look: Look = {"colours": _OBJECT_COLOUR, "inside": (low, high)}
    mesh_picture(seen.vertices_lcs_mm, seen.faces, IMAGES_VIEW, **look).show(ax)
    shades = colours.to_rgba(given["line"].to_numpy())
    spots(ax, *pair(space.flat(places)), shades, s=0.8, zorder=4)
    for words, place, colour in (("laser", laser, LIGHT_COLOUR), ("camera", eye, "black")):
        space.path(path_to(place, middle, window), colour, lw=1.0, ls="--", zorder=5)
        space.device(place, words)
    both = np.stack([laser, eye, middle])
    for z in (-window.thickness_mm, 0.0):
        space.plate(both.min(axis=0) - 25.0, both.max(axis=0) + 25.0, z, GLASS_COLOUR, alpha=0.4, zorder=6)
    flat = space.flat(np.stack([low, high, laser, eye]))
    ax.set_xlim(flat[0].min() - 50.0, flat[0].max() + 60.0)
    ax.set_ylim(flat[1].min() - 30.0, flat[1].max() + 20.0)
    ax.set_aspect("equal")
    ax.axis("off")


def draw_multi_line_images(*, images: Path, points: Path) -> Figure:
    """Images of a fifteen-line laser and their points -> figure of set-ups and images."""
    return multi_line_images_view(read_objects(images), pd.read_csv(points))
