"""Images of a fifteen-line laser with the measured lines, and their set-ups (T Fig. 4.4)."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from thalweg.core.errors import InputError
from thalweg.core.types import AnyArray, ArrayF
from thalweg.figures.calibration.field_views import Oblique
from thalweg.figures.style import SKY, count, new_figure, styled
from thalweg.lightsheet.figures.mesh_views import mesh_picture
from thalweg.lightsheet.figures.multi_line_geometry import LINE_MAP
from thalweg.lightsheet.figures.views import (
    GLASS_COLOUR,
    LIGHT_COLOUR,
    fill_oblique,
    green_of,
    need,
    path_to,
    plate,
    show_green,
    words_oblique,
)
from thalweg.lightsheet.optics.refracted_rays import refract_to_water
from thalweg.lightsheet.optics.sensor import Sensor, paper_4

POINTS: Final = ("object", "line", "best_line", "true_line", "x_px", "y_px", "x_mm", "y_mm", "z_mm")
NAMES: Final = {"calibration": "grid above a plate", "plane": "plane", "wreck": "wreck, a part"}
"""Objects in the order of the columns."""

VIEW: Final = Oblique(azimuth_deg=62.0, elevation_deg=24.0)
_OBJECT_COLOUR: Final = "#d8c9a6"
_AROUND_MM: Final = 25.0
_BOX_MM: Final = 75.0
"""How far the object is drawn around the middle of the lines, in plan."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenObject:
    """An image (h, w), and what was seen: vertices (n, 3) in lcs, millimetres, and faces (m, 3)."""

    image: AnyArray
    vertices_lcs_mm: ArrayF
    faces: AnyArray


def read_objects(path: Path) -> dict[str, SeenObject]:
    """Images and meshes of `thalweg_lab.studies.multi_line_images`, in the order of `NAMES`.

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
    points : columns `POINTS`; ``line`` is -1 for a point without label.
    sensor : that took the images; None: that of P4.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    """
    need(points, POINTS, "points of a fifteen-line laser")
    sensor = paper_4() if sensor is None else sensor
    labelled = points[points["line"] >= 0]
    right = float((labelled["line"] == labelled["true_line"]).mean()) if len(labelled) else float("nan")
    head = (
        f"A laser of fifteen lines: n = {count(len(points))} measured points, {count(len(labelled))} with a "
        f"label, of which {100 * right:.1f} % are right"
    )
    figure = new_figure(142.0, head, twin=True)
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
    has = points["line"] >= 0
    if has.any():
        return f"{count(int(has.sum()))} of {count(len(points))} points labelled"
    guessed = float((points["best_line"] == points["true_line"]).mean())
    return f"{count(len(points))} points, none labelled;\nguesses right: {100 * guessed:.0f} %"


def _image(ax: Axes, seen: SeenObject, points: pd.DataFrame, colours: ScalarMappable) -> None:
    show_green(ax, green_of(seen.image))
    has = points["line"] >= 0
    if (~has).any():
        ax.plot(points["x_px"][~has], points["y_px"][~has], ls="none", marker=".", ms=1.1, mew=0, color=SKY,
                gid="without label", zorder=3)  # fmt: skip
    shades = colours.to_rgba(points["line"][has].to_numpy())
    ax.scatter(points["x_px"][has], points["y_px"][has], c=shades, s=1.2, lw=0, gid="labelled", zorder=4)
    low = points[["x_px", "y_px"]].min().to_numpy() - 0.05 * seen.image.shape[0]
    high = points[["x_px", "y_px"]].max().to_numpy() + 0.05 * seen.image.shape[0]
    side = 0.5 * float((high - low).max())
    middle = np.clip(0.5 * (low + high), side, np.array(seen.image.shape[1::-1]) - side)
    ax.set_xlim(middle[0] - side, middle[0] + side)
    ax.set_ylim(middle[1] + side, middle[1] - side)


def _setup(ax: Axes, seen: SeenObject, points: pd.DataFrame, sensor: Sensor, colours: ScalarMappable) -> None:
    laser, eye = sensor.sheet.origin_lcs_mm, sensor.camera_origin_lcs_mm
    places = points.loc[points["line"] >= 0, ["x_mm", "y_mm", "z_mm"]].to_numpy(np.float64)
    middle = places.mean(axis=0) if len(places) else _below(sensor, seen)
    box = (
        np.array([*(middle[:2] - _BOX_MM), float(seen.vertices_lcs_mm[:, 2].min()) - 1.0]),
        np.array([*(middle[:2] + _BOX_MM), -sensor.window.thickness_mm]),
    )
    mesh_picture(seen.vertices_lcs_mm, seen.faces, VIEW, colours=_OBJECT_COLOUR, inside=box).show(ax)
    flat = VIEW.apply(places)[0]
    numbers = points["line"][points["line"] >= 0].to_numpy()
    shades = colours.to_rgba(numbers)
    ax.scatter(flat[:, 0], flat[:, 1], c=shades, s=0.8, lw=0, gid="places", zorder=4)
    for words, place, colour in (("laser", laser, LIGHT_COLOUR), ("camera", eye, "black")):
        path = path_to(place, middle, sensor.window)
        ax.plot(*VIEW.apply(path)[0].T, color=colour, lw=1.0, ls="--", zorder=5)
        ax.plot(*VIEW.apply(place)[0], marker="s", ms=4, color="black", zorder=10)
        words_oblique(ax, VIEW, place, f"  {words}")
    both = np.stack([laser, eye, middle])
    low, high = both.min(axis=0) - _AROUND_MM, both.max(axis=0) + _AROUND_MM
    for z in (-sensor.window.thickness_mm, 0.0):
        fill_oblique(ax, VIEW, plate(low, high, z), GLASS_COLOUR, alpha=0.4, zorder=6)
    shown = np.concatenate([plate(*box, float(box[0][2])), plate(low, high, 0.0), [laser, eye]])
    flat = VIEW.apply(shown)[0]
    ax.set_xlim(flat[:, 0].min() - 25.0, flat[:, 0].max() + 45.0)
    ax.set_ylim(flat[:, 1].min() - 25.0, flat[:, 1].max() + 15.0)
    ax.set_aspect("equal")
    ax.axis("off")


def _below(sensor: Sensor, seen: SeenObject) -> ArrayF:
    """Where the middle of the laser's light meets the height of the object's ground."""
    depth = sensor.window.depth_mm(seen.vertices_lcs_mm).max()
    water = refract_to_water(sensor.sheet.origin_lcs_mm, sensor.sheet.beams(0.0), sensor.window)
    return np.asarray(water.at_depth(depth)[0])
