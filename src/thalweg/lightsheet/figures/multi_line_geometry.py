"""A fifteen-line laser under water: in space, in a section, and in the image (T Fig. 4.3)."""

from typing import Final

import numpy as np
import pandas as pd
from cmcrameri import cm
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure

from thalweg.core.types import ArrayF
from thalweg.figures.calibration.field_views import Oblique
from thalweg.figures.style import new_figure, plural, styled
from thalweg.lightsheet.figures.views import (
    GLASS_COLOUR,
    WATER_COLOUR,
    axes_cross,
    fill_oblique,
    need,
    path_to,
    plate,
    words_oblique,
)
from thalweg.lightsheet.optics.sensor import Sensor, paper_4

LINES: Final = ("line", "fan_angle_deg", "depth_mm", "x_mm", "y_mm", "z_mm", "x_px", "y_px", "in_picture")
"""Columns of `thalweg.lightsheet.multi_line.tables.line_table`."""

LINE_MAP: Final[Colormap] = ListedColormap(cm.batlow(np.linspace(0.0, 0.9, 256)), "thalweg_lines")
"""Number of a line: dark for the first, light for the last; without the end that vanishes on paper."""

VIEW: Final = Oblique(azimuth_deg=62.0, elevation_deg=20.0)

_WIDTHS: Final = (0.7, 1.1, 1.5)


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
    figure = new_figure(150.0, head, twin=False)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.15, 1.0], height_ratios=[1.0, 1.0])
    colours = ScalarMappable(Normalize(min(numbers), max(numbers)), LINE_MAP)
    left = figure.add_subplot(grid[:, 0])
    section, picture = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    _space(left, lines, sensor, colours)
    _section(section, lines, sensor, colours)
    _picture(picture, lines, sensor, colours)
    figure.colorbar(colours, ax=left, label="number of the line", location="bottom", aspect=40, pad=0.02)
    return figure


def _space(ax: Axes, lines: pd.DataFrame, sensor: Sensor, colours: ScalarMappable) -> None:
    origin, bottom = sensor.sheet.origin_lcs_mm, float(lines["z_mm"].min())
    eye = sensor.camera_origin_lcs_mm
    places = np.concatenate([lines[["x_mm", "y_mm"]].to_numpy(np.float64), origin[None, :2], eye[None, :2]])
    low, high = places.min(axis=0) - 15.0, places.max(axis=0) + 15.0
    for depth in sorted(lines["depth_mm"].unique(), reverse=True):
        level = lines[lines["depth_mm"] == depth]
        on_level = level[["x_mm", "y_mm"]].to_numpy(np.float64)
        inner, outer = on_level.min(axis=0) - 8.0, on_level.max(axis=0) + 8.0
        fill_oblique(ax, VIEW, plate(inner, outer, float(level["z_mm"].mean())), "0.92", alpha=0.8, zorder=1)
        for number, line in level.groupby("line"):
            xyz = line.sort_values("fan_angle_deg")[["x_mm", "y_mm", "z_mm"]].to_numpy(np.float64)
            ax.plot(*VIEW.apply(xyz)[0].T, color=colours.to_rgba(number), lw=1.3, zorder=4, gid="line")
        words_oblique(ax, VIEW, np.array([outer[0], inner[1], level["z_mm"].mean()]), f" {depth:g} mm")
    deepest = lines[lines["depth_mm"] == lines["depth_mm"].max()]
    for number, line in deepest.groupby("line"):
        for end in (line["fan_angle_deg"].idxmin(), line["fan_angle_deg"].idxmax()):
            path = path_to(
                origin, line.loc[end, ["x_mm", "y_mm", "z_mm"]].to_numpy(np.float64), sensor.window
            )
            ax.plot(*VIEW.apply(path)[0].T, color=colours.to_rgba(number), lw=0.5, alpha=0.7, zorder=3)
    seen = lines[lines["in_picture"] & (lines["z_mm"] == bottom)]
    for z, colour in ((-sensor.window.thickness_mm, WATER_COLOUR), (0.0, GLASS_COLOUR)):
        fill_oblique(ax, VIEW, plate(low, high, z), colour, alpha=0.4, zorder=5)
    if len(seen):
        middle = seen[["x_mm", "y_mm", "z_mm"]].mean().to_numpy()
        path = path_to(eye, np.array([*middle[:2], bottom]), sensor.window)
        ax.plot(*VIEW.apply(path)[0].T, color="black", lw=0.8, ls="--", zorder=6, gid="image ray")
    for words, place in (("laser", origin), ("camera", eye)):
        ax.plot(*VIEW.apply(place)[0], marker="s", ms=5, color="black", zorder=10)
        words_oblique(ax, VIEW, place, f"  {words}")
    corner = plate(low, high, 0.5 * bottom)
    axes_cross(ax, VIEW, corner[np.argmin(VIEW.apply(corner)[0][:, 0])], 30.0)
    ax.set_aspect("equal")
    ax.margins(0.03)
    ax.axis("off")
    ax.set_title("a: in space; dashed: an image ray")


def _section(ax: Axes, lines: pd.DataFrame, sensor: Sensor, colours: ScalarMappable) -> None:
    """Middles of the lines in the plane that contains laser and camera: across the lines, and height."""
    across = across_direction(lines)
    thick = sensor.window.thickness_mm
    middles = lines.loc[
        lines.groupby(["line", "depth_mm"])["fan_angle_deg"].apply(lambda a: a.abs().idxmin())
    ]
    deepest = middles[middles["depth_mm"] == middles["depth_mm"].max()]
    for _, row in deepest.iterrows():
        path = path_to(sensor.sheet.origin_lcs_mm, row[["x_mm", "y_mm", "z_mm"]].to_numpy(np.float64),
                       sensor.window)  # fmt: skip
        ax.plot(
            path @ across, path[:, 2], color=colours.to_rgba(row["line"]), lw=0.9, gid="sub-beam", zorder=3
        )
    xyz = middles[["x_mm", "y_mm", "z_mm"]].to_numpy(np.float64)
    ax.scatter(xyz @ across, xyz[:, 2], c=colours.to_rgba(middles["line"].to_numpy()), s=7, zorder=4,
               gid="middles")  # fmt: skip
    eye = sensor.camera_origin_lcs_mm
    seen = deepest.loc[deepest["in_picture"], ["x_mm", "y_mm", "z_mm"]].to_numpy(np.float64)
    for place in seen[[0, -1]] if len(seen) else seen:
        path = path_to(eye, place, sensor.window)
        ax.plot(path @ across, path[:, 2], color="black", lw=0.8, ls="--", zorder=2, gid="image ray")
    for words, place in (("laser", sensor.sheet.origin_lcs_mm), ("camera", eye)):
        ax.plot(place @ across, place[2], marker="s", ms=4, color="black", zorder=5)
        at = float(place @ across), float(place[2])
        ax.annotate(words, at, xytext=(5, 3), textcoords="offset points", fontsize=7)
    ax.axhspan(-thick, 0.0, color=GLASS_COLOUR, lw=0, zorder=0, gid="glass")
    ax.axhspan(float(xyz[:, 2].min()) - 15.0, -thick, color=WATER_COLOUR, lw=0, zorder=0, gid="water")
    ax.set_ylim(float(xyz[:, 2].min()) - 15.0, None)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel="across the lines / mm", ylabel="z / mm")
    ax.set_title("b: middles of the lines, in a section")


def across_direction(lines: pd.DataFrame) -> ArrayF:
    """Level unit vector (3,) across the lines, from the first to the last on the deepest level."""
    level = lines[lines["depth_mm"] == lines["depth_mm"].max()]
    middles = level.groupby("line")[["x_mm", "y_mm"]].mean().to_numpy(np.float64)
    way = middles[-1] - middles[0]
    return np.array([*(way / np.linalg.norm(way)), 0.0])


def _picture(ax: Axes, lines: pd.DataFrame, sensor: Sensor, colours: ScalarMappable) -> None:
    width, height = sensor.camera.size_px
    depths = sorted(lines["depth_mm"].unique())
    for depth, lw in zip(depths, np.resize(_WIDTHS, len(depths)), strict=True):
        level = lines[(lines["depth_mm"] == depth) & lines["in_picture"]]
        for number, line in level.groupby("line"):
            mine = line.sort_values("fan_angle_deg")
            ax.plot(mine["x_px"], mine["y_px"], color=colours.to_rgba(number), lw=lw, gid=f"image {depth:g}")
        if len(level):
            top = level.loc[level["y_px"].idxmin()]
            ax.annotate(f"{depth:g} mm", (float(level["x_px"].mean()), float(top["y_px"])), xytext=(0, 4),
                        textcoords="offset points", ha="center", fontsize=7)  # fmt: skip
    ax.set_xlim(0, width)
    ax.set_ylim(height, 0)
    ax.set_aspect("equal")
    ax.set(xlabel="column / px", ylabel="row / px")
    ax.set_title("c: in the image")
