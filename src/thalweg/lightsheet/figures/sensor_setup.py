"""Set-up of a light-sheet sensor, and how one point is measured (P3 Fig. 3; P4 Fig. 3 and 7, Table 1)."""

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.core.errors import CoverageError
from thalweg.core.types import ArrayF
from thalweg.figures.calibration.field_views import Oblique
from thalweg.figures.style import BLUE, PURPLE, VERMILION, new_figure, styled
from thalweg.lightsheet.figures.views import (
    GLASS_COLOUR,
    LIGHT_COLOUR,
    WATER_COLOUR,
    axes_cross,
    beam_paths,
    fill_oblique,
    path_to,
    plate,
    words_oblique,
)
from thalweg.lightsheet.optics.intersection import intersect
from thalweg.lightsheet.optics.refracted_rays import refract_to_water
from thalweg.lightsheet.optics.sensor import Sensor
from thalweg.lightsheet.optics.volume import depth_lines

DEPTH_MM: Final = 100.0
"""For which P4 Table 1 states the size of a pixel."""

VIEW: Final = Oblique(azimuth_deg=62.0, elevation_deg=20.0)
RAY_COLOUR: Final = VERMILION
BEAM_COLOUR: Final = PURPLE

_BEAMS: Final = 61


@styled
def sensor_setup(
    sensor: Sensor, *, depth_mm: float = DEPTH_MM, title: str = "Light-sheet sensor", twin: bool = False
) -> Figure:
    """Section through laser and camera; one image ray and its sub-beam in space; the point in the image.

    Parameters
    ----------
    sensor : any.
    depth_mm : of the point that is measured as an example, in the middle of its line.
    title : first words of the title.
    twin : true if the sensor is that of the digital twin.

    Raises
    ------
    CoverageError : the sensor does not see the sheet in that depth.
    """
    lines = [line for line in depth_lines(sensor, [depth_mm]) if len(line.xy_px) > 1]
    if not lines:
        raise CoverageError(f"no line in the image {depth_mm:g} mm deep", expected="a depth that is seen")
    line = lines[0]
    k = len(line.xy_px) // 2
    pixel = line.xy_px[k]
    point = intersect(sensor, pixel[None]).xyz_lcs_mm[0]
    size = pixel_size_mm(sensor, pixel, depth_mm)
    base = float(np.linalg.norm(sensor.camera_origin_lcs_mm - sensor.sheet.origin_lcs_mm))
    columns, rows = sensor.camera.size_px
    head = (
        f"{title}: base {base:.0f} mm, {columns} x {rows} pixels of {size[0]:.2f} mm x {size[1]:.2f} mm in "
        f"{depth_mm:g} mm depth (P4 Table 1: 174 mm, 2048 x 2048, 0.02 mm x 0.03 mm)"
    )
    figure = new_figure(152.0, head, twin=twin)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.0, 1.25], height_ratios=[1.25, 1.0])
    _section(figure.add_subplot(grid[0, 0]), sensor, depth_mm, point)
    _space(figure.add_subplot(grid[:, 1]), sensor, point)
    _image(figure.add_subplot(grid[1, 0]), sensor, line.xy_px, pixel, depth_mm)
    return figure


def pixel_size_mm(sensor: Sensor, xy_px: ArrayF, depth_mm: float) -> tuple[float, float]:
    """How far the image ray moves on a level for one pixel along the columns and along the rows."""
    xy = xy_px + 0.5 * np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
    rays = sensor.camera.rays(xy) @ sensor.R_lcs_ccs.T
    at = refract_to_water(sensor.camera_origin_lcs_mm, rays, sensor.window).at_depth(depth_mm)
    return float(np.linalg.norm(at[1] - at[0])), float(np.linalg.norm(at[3] - at[2]))


def tilt_deg(direction: ArrayF) -> float:
    """Angle between a direction (3,) and the way down."""
    return float(np.rad2deg(np.arccos(np.clip(-direction[2] / np.linalg.norm(direction), -1.0, 1.0))))


def in_section(sensor: Sensor, points_mm: ArrayF) -> ArrayF:
    """Coordinates (n, 2) in the upright plane through laser and camera: from laser to camera, and height."""
    way = (sensor.camera_origin_lcs_mm - sensor.sheet.origin_lcs_mm)[:2]
    along = way / np.linalg.norm(way)
    points = np.atleast_2d(points_mm)
    across = (points[:, :2] - sensor.sheet.origin_lcs_mm[:2]) @ along
    return np.stack([across, points[:, 2]], axis=1)


def _section(ax: Axes, sensor: Sensor, depth_mm: float, point: ArrayF) -> None:
    laser, eye, thick = sensor.sheet.origin_lcs_mm, sensor.camera_origin_lcs_mm, sensor.window.thickness_mm
    deepest = -thick - 1.6 * depth_mm
    ax.axhspan(-thick, 0.0, color=GLASS_COLOUR, lw=0, zorder=0, gid="glass")
    ax.axhspan(deepest, -thick, color=WATER_COLOUR, lw=0, zorder=0, gid="water")
    axis = sensor.sheet.beams(np.zeros(1))
    path = beam_paths(laser, axis, sensor.window, 1.5 * depth_mm)[0]
    ax.plot(*in_section(sensor, path).T, color=LIGHT_COLOUR, lw=1.6, zorder=3, gid="sheet")
    width, height = sensor.camera.size_px
    view = np.array([[0.5, 0.0], [0.5, 1.0], [0.0, 0.5], [1.0, 0.5], [0.5, 0.5]]) * [width, height]
    rays = sensor.camera.rays(view) @ sensor.R_lcs_ccs.T
    paths = beam_paths(eye, rays, sensor.window, 1.5 * depth_mm)
    flat = np.stack([in_section(sensor, one) for one in paths])
    # of the four middles of the picture's edges those two that lie farthest apart bound the view
    order = np.argsort(flat[:4, -1, 0])
    for one, dashes in ((flat[order[0]], "--"), (flat[order[-1]], "--"), (flat[4], "-.")):
        ax.plot(*one.T, color=BLUE, lw=0.9, ls=dashes, zorder=2, gid="view")
    place = in_section(sensor, np.stack([laser, eye, point]))
    ax.plot(*place[:2].T, color="black", lw=0.8, ls=":", zorder=2, gid="base")
    ax.plot(*place[0], marker="s", ms=5, color="black", zorder=5)
    ax.plot(*place[1], marker="s", ms=5, color="black", zorder=5)
    ax.plot(*place[2], marker="o", ms=4, color=RAY_COLOUR, zorder=6)
    words = (
        (0, f"laser, {tilt_deg(axis[0]):.0f}°\nfrom the vertical", "right", (-6, 0)),
        (1, f"camera, {tilt_deg(rays[4]):.0f}°", "right", (6, 7)),
    )
    for k, text, side, shift in words:
        ax.annotate(text, (float(place[k, 0]), float(place[k, 1])), xytext=shift, fontsize=7, ha=side,
                    va="center", textcoords="offset points")  # fmt: skip
    for text, z, shift_y in (("air", 0.0, 7), ("water", -thick, -7)):
        ax.annotate(text, (0.0, z), xycoords=("axes fraction", "data"), xytext=(4, shift_y), va="center",
                    textcoords="offset points", fontsize=7)  # fmt: skip
    flat = np.concatenate([place, flat.reshape(-1, 2)])
    ax.set_xlim(
        min(float(flat[:, 0].min()), float(place[0, 0]) - 125.0) - 10.0, float(flat[:, 0].max()) + 15.0
    )
    ax.set_ylim(deepest, float(place[:, 1].max()) + 30.0)
    ax.set_aspect("equal", adjustable="box")
    ax.set(xlabel="from laser to camera / mm", ylabel="z / mm")
    ax.set_title(f"a: section; {thick:.1f} mm of glass")


def _space(ax: Axes, sensor: Sensor, point: ArrayF) -> None:
    laser, eye, window = sensor.sheet.origin_lcs_mm, sensor.camera_origin_lcs_mm, sensor.window
    depth = float(window.depth_mm(point[None])[0])
    half = min(sensor.sheet.half_angle_rad, float(np.deg2rad(35.0)))
    fan = beam_paths(laser, sensor.sheet.beams(np.linspace(-half, half, _BEAMS)), window, depth)
    for part, zorder in ((slice(2, 4), 2.0), (slice(1, 3), 4.0), (slice(0, 2), 6.0)):
        edge = np.concatenate([fan[:, part][:, 0], fan[::-1, part][:, 1]])
        ax.fill(*VIEW.apply(edge)[0].T, facecolor=LIGHT_COLOUR, edgecolor="none", alpha=0.3, zorder=zorder)
    ax.plot(*VIEW.apply(fan[:, 3])[0].T, color=LIGHT_COLOUR, lw=1.4, zorder=3, gid="line")
    both = np.concatenate([fan.reshape(-1, 3), eye[None]])
    low, high = both.min(axis=0) - 12.0, both.max(axis=0) + 12.0
    for z, zorder in ((-window.thickness_mm, 3.5), (0.0, 5.0)):
        fill_oblique(ax, VIEW, plate(low, high, z), GLASS_COLOUR, alpha=0.4, zorder=zorder)
    for place, colour, words in ((laser, BEAM_COLOUR, "sub-beam"), (eye, RAY_COLOUR, "image ray")):
        path = path_to(place, point, window)
        ax.plot(*VIEW.apply(path)[0].T, color=colour, lw=1.6, zorder=8, gid=words, label=words)
    for words, place in (("laser", laser), ("camera", eye)):
        ax.plot(*VIEW.apply(place)[0], marker="s", ms=5, color="black", zorder=10)
        words_oblique(ax, VIEW, place, f"   {words}")
    ax.plot(*VIEW.apply(point)[0], marker="x", ms=7, mew=1.6, color="black", zorder=10, gid="point")
    words_oblique(ax, VIEW, point, f"   ({point[0]:.1f}, {point[1]:.1f}, {point[2]:.1f}) mm", dy=-9.0)
    axes_cross(ax, VIEW, np.array([low[0], high[1], 0.6 * point[2]]), 30.0)
    ax.set_aspect("equal")
    ax.margins(0.03)
    ax.axis("off")
    ax.legend(loc="lower left")
    ax.set_title("b: image ray and sub-beam meet in the water")


def _image(ax: Axes, sensor: Sensor, line_px: ArrayF, pixel: ArrayF, depth_mm: float) -> None:
    width, height = sensor.camera.size_px
    ax.plot(*line_px.T, color=LIGHT_COLOUR, lw=1.4, label=f"line {depth_mm:g} mm deep", gid="line")
    ax.plot(*pixel, marker="x", ms=7, mew=1.6, ls="none", color=RAY_COLOUR, gid="pixel",
            label=f"({pixel[0]:.0f}, {pixel[1]:.0f}) px")  # fmt: skip
    ax.set_xlim(0, width)
    ax.set_ylim(height, 0)
    ax.set_aspect("equal")
    ax.set(xlabel="column / px", ylabel="row / px")
    ax.legend(loc="upper right")
    ax.set_title("c: the point in the image")
