"""The light-sheet sensor: its parts, the bent sheet, what it can measure."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from thalweg.core import ArrayF, CoverageError
from thalweg.figures import (
    BLUE,
    DEPTH_MAP,
    GREY,
    HALO,
    HEIGHT_MAP,
    PURPLE,
    VERMILION,
    colour_bar,
    legend_below,
    new_figure,
    styled,
)
from thalweg.figures.calibration import Oblique
from thalweg.lightsheet.figures.views import (
    GLASS_COLOUR,
    LIGHT_COLOUR,
    WATER_COLOUR,
    Space,
    along_and_off,
    beam_paths,
    depth_styles,
    dots,
    pair,
    path_to,
)
from thalweg.lightsheet.optics import (
    DepthLine,
    LightSheet,
    Sensor,
    Status,
    Window,
    depth_lines,
    intersect,
    measurement_volume,
    picture_grid,
    read_sensor,
    refract_to_water,
)

DEPTH_MM: Final = 100.0
"""For which P4 Table 1 states the size of a pixel."""
VIEW: Final = Oblique(azimuth_deg=62.0, elevation_deg=20.0)
RAY_COLOUR: Final = VERMILION
BEAM_COLOUR: Final = PURPLE
_BEAMS: Final = 61

TILTS_DEG: Final = ((45.0, 0.0), (45.0, 30.0))
"""About the y axis, and then about the x axis: those of P3 Fig. 1 and P4 Fig. 1."""
HALF_ANGLE_DEG: Final = 32.0
HEIGHT_MM: Final = 70.0
WINDOW: Final = Window(thickness_mm=15.0, n_glass=1.52, n_water=1.335)
BENT_VIEW: Final = Oblique(azimuth_deg=22.0, elevation_deg=22.0)
_BENT_BEAMS: Final = 121
_DRAWN: Final = 15
"""Each how many-th sub-beam is drawn as a line."""

DEPTHS_MM: Final = (0.0, 50.0, 125.0, 250.0)
"""Reference depths of P4 Fig. 11 and 12."""


# ---------------------------------------------------------------- laser, camera and window (P3 Fig. 3, P4
# Fig. 3 and 7)


@styled
def sensor_setup(sensor: Sensor, *, depth_mm: float = DEPTH_MM, title: str = "Light-sheet sensor") -> Figure:
    """Section through laser and camera; one image ray and its sub-beam in space.

    Parameters
    ----------
    sensor : any.
    depth_mm : of the point that is measured as an example, in the middle of its line.
    title : first words of the title.

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
    figure = new_figure(110.0, head)
    section, space = figure.subplots(1, 2, width_ratios=[1.0, 1.25])
    _section(section, sensor, depth_mm, point)
    _space(Space(space, VIEW), sensor, point)
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
    ax.axhspan(-thick, 0.0, color=GLASS_COLOUR, lw=0, zorder=0)
    ax.axhspan(deepest, -thick, color=WATER_COLOUR, lw=0, zorder=0)
    axis = sensor.sheet.beams(np.zeros(1))
    path = beam_paths(laser, axis, sensor.window, 1.5 * depth_mm)[0]
    ax.plot(*in_section(sensor, path).T, color=LIGHT_COLOUR, lw=1.6, zorder=3)
    width, height = sensor.camera.size_px
    view = np.array([[0.5, 0.0], [0.5, 1.0], [0.0, 0.5], [1.0, 0.5], [0.5, 0.5]]) * [width, height]
    rays = sensor.camera.rays(view) @ sensor.R_lcs_ccs.T
    paths = beam_paths(eye, rays, sensor.window, 1.5 * depth_mm)
    flat = np.stack([in_section(sensor, one) for one in paths])
    # of the four middles of the picture's edges those two that lie farthest apart bound the view
    order = np.argsort(flat[:4, -1, 0])
    for one, dashes in ((flat[order[0]], "--"), (flat[order[-1]], "--"), (flat[4], "-.")):
        ax.plot(*one.T, color=BLUE, lw=0.9, ls=dashes, zorder=2)
    place = in_section(sensor, np.stack([laser, eye, point]))
    ax.plot(*place[:2].T, color="black", lw=0.8, ls=":", zorder=2)
    dots(ax, *pair(place[:2].T), "black", "s", ms=5, zorder=5)
    dots(ax, *pair(place[2:].T), RAY_COLOUR, "o", ms=4, zorder=6)
    left = min(float(flat[..., 0].min()), float(place[0, 0]) - 125.0) - 10.0
    for at, words, shift in (
        (place[0], f"laser, {tilt_deg(axis[0]):.0f}°\nfrom the vertical", (-6, 0)),
        (place[1], f"camera, {tilt_deg(rays[4]):.0f}°", (6, 7)),
        ((left + 25.0, 0.0), "air", (0, 7)),
        ((left + 25.0, -thick), "water", (0, -7)),
    ):
        ax.annotate(
            words,
            (float(at[0]), float(at[1])),
            xytext=shift,
            fontsize=7,
            ha="right",
            va="center",
            textcoords="offset points",
        )
    ax.set_xlim(left, flat[..., 0].max() + 15.0)
    ax.set_ylim(deepest, place[:, 1].max() + 30.0)
    ax.set_aspect("equal", adjustable="box")
    ax.set(xlabel="from laser to camera / mm", ylabel="z / mm")
    ax.set_title(f"a: section; {thick:.1f} mm of glass")


def _space(space: Space, sensor: Sensor, point: ArrayF) -> None:
    laser, eye, window = sensor.sheet.origin_lcs_mm, sensor.camera_origin_lcs_mm, sensor.window
    depth = float(window.depth_mm(point[None])[0])
    half = min(sensor.sheet.half_angle_rad, float(np.deg2rad(35.0)))
    fan = beam_paths(laser, sensor.sheet.beams(np.linspace(-half, half, _BEAMS)), window, depth)
    every = np.concatenate([fan.reshape(-1, 3), eye[None]])
    low, high = every.min(axis=0) - 12.0, every.max(axis=0) + 12.0
    _sheet(space, fan, low, high, window)
    for place, colour, words in ((laser, BEAM_COLOUR, "sub-beam"), (eye, RAY_COLOUR, "image ray")):
        space.path(path_to(place, point, window), colour, lw=1.6, zorder=8, gid=words, label=words)
    space.device(laser, "laser")
    space.device(eye, "camera")
    space.dots(point, "black", "x", ms=7, zorder=10)
    space.words(point, f"   ({point[0]:.1f}, {point[1]:.1f}, {point[2]:.1f}) mm", dy=-9.0)
    space.cross(np.array([low[0], high[1], 0.6 * point[2]]), 30.0)
    space.ax.legend(loc="lower left")
    space.finish("b: image ray and sub-beam meet in the water")


def _sheet(space: Space, paths: ArrayF, low: ArrayF, high: ArrayF, window: Window) -> None:
    """A sheet by the paths (n, 4, 3) of its sub-beams through the faces of the window, from below."""
    space.path(paths[:, 3], LIGHT_COLOUR, lw=1.6, zorder=2, gid="line")
    faces = {0: (WATER_COLOUR, -window.thickness_mm), 1: (GLASS_COLOUR, 0.0)}
    for k, medium in enumerate((2, 1, 0)):
        part = paths[:, medium : medium + 2]
        edge = np.concatenate([part[:, 0], part[::-1, 1]])
        space.area(edge, LIGHT_COLOUR, edgecolor="none", alpha=0.3, zorder=3 + 2 * k)
        if k in faces:
            colour, z = faces[k]
            space.plate(low, high, z, colour, alpha=0.5, zorder=4 + 2 * k)


def draw_sensor_setup(*, sensor: Path, title: str) -> Figure:
    """Calibrated light-sheet sensor -> figure of its set-up and of one measured point."""
    return sensor_setup(read_sensor(sensor), title=title)


# ---------------------------------------------------------------- refraction bends the sheet (P3 Fig. 1, P4
# Fig. 1 and 2)


def tilted_sheet(first_deg: float, second_deg: float) -> LightSheet:
    """A fan along y, turned about the y axis and then about the x axis."""
    angles = np.deg2rad([second_deg, first_deg, 90.0])
    return LightSheet(
        origin_lcs_mm=np.array([0.0, 0.0, HEIGHT_MM]),
        angles_rad=angles,
        half_angle_rad=float(np.deg2rad(HALF_ANGLE_DEG)),
    )


def sheet_paths(sheet: LightSheet) -> ArrayF:
    """(n, 4, 3) corners of the paths of its sub-beams down to the plane."""
    angles = np.linspace(-sheet.half_angle_rad, sheet.half_angle_rad, _BENT_BEAMS)
    return beam_paths(sheet.origin_lcs_mm, sheet.beams(angles), WINDOW, DEPTH_MM)


@styled
def sheet_deformation() -> Figure:
    """Above: sheets with one and with two tilts in air, glass and water. Below: their lines on a plane."""
    head = (
        f"A plane light sheet behind {WINDOW.thickness_mm:g} mm of glass, refractive index "
        f"{WINDOW.n_glass:.2f}, on a plane in {DEPTH_MM:g} mm of water, {WINDOW.n_water} (no data)"
    )
    figure = new_figure(124.0, head)
    axes = figure.subplots(2, 2, height_ratios=[1.5, 1.0])
    for k, (first, second) in enumerate(TILTS_DEG):
        paths = sheet_paths(tilted_sheet(first, second))
        _bent(Space(axes[0, k], BENT_VIEW), paths)
        words = f"{'ab'[k]}: turned by {first:g}° about y"
        axes[0, k].set_title(words + (f", then by {second:g}° about x" if second else ""))
        _line(axes[1, k], paths[:, 3], "cd"[k])
    return figure


def _bent(space: Space, paths: ArrayF) -> None:
    flat = paths.reshape(-1, 3)
    low, high = flat.min(axis=0) - 12.0, flat.max(axis=0) + 12.0
    bottom = -WINDOW.thickness_mm - DEPTH_MM
    space.plate(low, high, bottom, "0.9", zorder=1)
    _sheet(space, paths, low, high, WINDOW)
    for path in paths[::_DRAWN]:
        space.path(path, "#1b7837", lw=0.5, zorder=8)
    space.device(paths[0, 0], "laser")
    glass = -0.5 * WINDOW.thickness_mm
    for words, z in (("air", 8.0), ("glass", glass), ("water", 0.45 * bottom), ("plane", bottom)):
        space.words(np.array([high[0], low[1], z]), f" {words}")
    space.cross(np.array([low[0], low[1], 0.55 * HEIGHT_MM]), 24.0)
    space.finish("")


def _line(ax: Axes, points_mm: ArrayF, letter: str) -> None:
    """The line on the plane: how far its points lie from a straight one."""
    along, off = along_and_off(points_mm[:, 0], points_mm[:, 1])
    ax.axhline(0.0, color=BLUE, lw=0.9, ls="--", label="straight line")
    ax.plot(along, off, color=VERMILION, lw=1.8, label="line on the plane", gid="line")
    bends = int(np.sum(np.diff(np.sign(_curvature(along, off))) != 0))
    shape = "bent to both sides" if bends else "bent to one side"
    ax.set_title(f"{letter}: its line on the plane, {shape}")
    ax.set(xlabel="position along the straight line / mm", ylabel="distance from it / mm", ylim=(-6.0, 8.5))
    ax.grid()
    ax.legend(loc="upper center", ncols=2)


def _curvature(x: ArrayF, y: ArrayF) -> ArrayF:
    """Signed curvature times a positive factor along points of a curve, without its ends."""
    dx, dy = np.gradient(x), np.gradient(y)
    return np.asarray((dx * np.gradient(dy) - dy * np.gradient(dx))[3:-3])


# ---------------------------------------------------------------- measurement volume (P3 Fig. 5, P4 Fig. 11
# and 12)
#
# (P3 Fig. 5; P4 Fig. 11 and 12).


@styled
def measurement_volume_view(
    sensor: Sensor,
    depths_mm: Sequence[float] = DEPTHS_MM,
    *,
    step_px: int = 8,
    title: str = "Measurement volume",
) -> Figure:
    """Above: X, Y and depth of each pixel. Below: the border of the image and lines of equal depth in space.

    Parameters
    ----------
    sensor : any.
    depths_mm : of the lines; those that the sensor does not see are left out and named.
    step_px : of the tables.
    title : first words of the title.

    Raises
    ------
    GeometryError : no pixel sees the sheet in the water.
    """
    volume, grid = measurement_volume(sensor, step_px), picture_grid(sensor, step_px)
    lines = [line for line in depth_lines(sensor, depths_mm) if len(line.xy_px) > 1]
    missed = sorted(set(depths_mm) - {line.depth_mm for line in lines})
    looks = depth_styles([line.depth_mm for line in lines])
    size = volume.size_mm
    head = (
        f"{title}: {volume.depth_mm[1]:.0f} mm deep, {size[0]:.0f} mm x {size[1]:.0f} mm, "
        f"{100 * volume.share:.0f} % of the image see the sheet in the water"
    )
    figure = new_figure(150.0, head)
    axes = figure.subplots(2, 3, height_ratios=[1.35, 1.0])
    maps = (
        ("a: x", "x / mm", grid.xyz_lcs_mm[..., 0], HEIGHT_MAP),
        ("b: y", "y / mm", grid.xyz_lcs_mm[..., 1], HEIGHT_MAP),
        ("c: depth", "depth / mm", grid.depth_mm, DEPTH_MAP),
    )
    for k, (ax, (words, label, values, colours)) in enumerate(zip(axes[0], maps, strict=True)):
        norm = Normalize(np.nanmin(values), np.nanmax(values))
        x, y = _edges(grid.x_px), _edges(grid.y_px)
        ax.pcolormesh(x, y, np.ma.masked_invalid(values), cmap=colours, norm=norm, rasterized=True)
        ax.set_xlim(x[0], x[-1])
        ax.set_ylim(y[-1], y[0])
        ax.set_aspect("equal")
        for line in lines:
            colour, style, _ = looks[line.depth_mm]
            ax.plot(
                *line.xy_px.T,
                color=colour,
                ls=style,
                lw=1.4,
                path_effects=HALO,
                label=f"{line.depth_mm:g} mm deep",
            )
        ax.set(title=words, xlabel="column / px", ylabel="row / px" if k == 0 else "")
        ax.tick_params(labelleft=k == 0)
        colour_bar(ax, colours, norm, label, location="bottom", pad=0.02, aspect=30)
    _views(axes[1], volume.border_lcs_mm, lines, looks, sensor)
    # why a pixel has no point
    for status, share in volume.shares.items():
        if share and status != Status.OK.name:
            words = f"white, {status.lower().replace('_', ' ')}: {100 * share:.0f} %"
            axes[0, 0].fill([], [], facecolor="white", edgecolor="0.55", lw=0.5, label=words)
    legend_below(figure, axes[0, 0])
    if missed:
        words = ", ".join(f"{depth:g}" for depth in missed)
        axes[1, 0].set_xlabel(f"x / mm\nnot in the image: {words} mm")
    return figure


def _edges(centres: ArrayF) -> ArrayF:
    """Edges (n + 1,) of cells about centres (n,)."""
    inner = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[centres[0] - 0.5], inner, [centres[-1] + 0.5]])


def _views(
    axes: Sequence[Axes],
    border: ArrayF,
    lines: Sequence[DepthLine],
    looks: Mapping[float, tuple[str, str, str]],
    sensor: Sensor,
) -> None:
    """Plan, view along y and view along x; depth counts downwards."""
    views = (("d: from above", 0, 1), ("e: along y", 0, 2), ("f: along x", 1, 2))
    names = ("x / mm", "y / mm", "depth / mm")
    ring = np.concatenate([border, border[:1]]).copy()
    ring[:, 2] = sensor.window.depth_mm(ring)
    # a border that leaves the sheet is not one line
    ring[1:][np.linalg.norm(np.diff(ring, axis=0), axis=1) > 15.0] = np.nan
    for ax, (words, i, j) in zip(axes, views, strict=True):
        ax.plot(ring[:, i], ring[:, j], color=GREY, lw=0.9)
        for line in lines:
            colour, style, _ = looks[line.depth_mm]
            points = line.xyz_lcs_mm.copy()
            points[:, 2] = sensor.window.depth_mm(points)
            ax.plot(points[:, i], points[:, j], color=colour, ls=style, lw=1.8)
        ax.set(xlabel=names[i], ylabel=names[j])
        ax.set_title(words)
        ax.set_aspect("equal", adjustable="box")
        if j == 2:
            ax.invert_yaxis()
        ax.xaxis.set_major_locator(MaxNLocator(2 if np.ptp(ring[~np.isnan(ring[:, i]), i]) < 120.0 else 5))
        ax.grid()


def draw_measurement_volume(*, sensor: Path, title: str) -> Figure:
    """A light-sheet sensor -> figure of what it can measure."""
    return measurement_volume_view(read_sensor(sensor), title=title)
