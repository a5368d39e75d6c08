"""Calibration of the light sheet on a grid above a plate (P3 Fig. 4 and 7; P4 Fig. 9 and 10)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.core import AnyArray, CoverageError, root_mean_square
from thalweg.figures import GREY, ORANGE, count, new_figure, plural, styled, thinned
from thalweg.figures.calibration import Oblique
from thalweg.lightsheet.figures.views import (
    DEPTH_STYLES,
    GLASS_COLOUR,
    LIGHT_COLOUR,
    Space,
    beam_paths,
    dots,
    first_image,
    green_of,
    need,
    show_green,
)
from thalweg.lightsheet.optics import Sensor, intersect, read_sensor

RESIDUALS: Final = ("level", "x_px", "y_px", "residual_px", "standardised", "used")
PAIRS: Final = ("upper_x_px", "upper_y_px", "lower_x_px", "lower_y_px", "apart_deg", "standardised", "used")
"""Columns of the tables of `thalweg.lightsheet.calibration.report`."""

_MOST_POINTS: Final = 180
"""Points of a level that are drawn as marks in the picture: more would hide the line."""


@styled
def grid_calibration(
    sensor: Sensor,
    image: AnyArray,
    residuals: pd.DataFrame,
    pairs: pd.DataFrame,
    *,
    title: str = "Calibration of the light sheet",
) -> Figure:
    """The image with the points of each level and the pairs of ends, the rays in space, and the residuals.

    Parameters
    ----------
    sensor : calibrated.
    image : (h, w) mosaic or monochrome, or (h, w, 3), of the calibration object.
    residuals : line points, columns `RESIDUALS`.
    pairs : ends on one sub-beam, columns `PAIRS`.
    title : first words of the title.

    Raises
    ------
    InputError : an empty table, or one that lacks columns.
    CoverageError : no point or no pair was used.
    """
    need(residuals, RESIDUALS, "residuals of a calibration"), need(pairs, PAIRS, "pairs of a calibration")
    used = residuals[residuals["used"].astype(bool)]
    kept = pairs[pairs["used"].astype(bool)]
    if not len(used) or not len(kept):
        raise CoverageError(f"{len(used)} points and {len(kept)} pairs in use", expected="some of both")
    left_out = len(residuals) - len(used) + len(pairs) - len(kept)
    head = (
        f"{title}: n = {count(len(used))} line points and {plural(len(kept), 'pair')} of ends, "
        f"{plural(left_out, 'observation')} rejected"
    )
    figure = new_figure(146.0, head)
    grid = figure.add_gridspec(2, 2, height_ratios=[1.75, 1.0])
    levels = list(dict.fromkeys(residuals["level"].astype(str)))
    _image(figure.add_subplot(grid[0, 0]), image, residuals, kept, levels)
    _space(Space(figure.add_subplot(grid[0, 1]), _view_of(kept)), sensor, kept, levels)
    _residuals(figure.add_subplot(grid[1, :]), residuals, levels)
    return figure


def _view_of(pairs: pd.DataFrame) -> Oblique:
    """Across the line the paths of laser and camera lie side by side."""
    along_y = np.ptp(pairs["upper_y_px"]) >= np.ptp(pairs["upper_x_px"])
    return Oblique(azimuth_deg=24.0 if along_y else 66.0, elevation_deg=14.0)


def _image(
    ax: Axes, image: AnyArray, residuals: pd.DataFrame, pairs: pd.DataFrame, levels: Sequence[str]
) -> None:
    show_green(ax, green_of(image))
    # a line from end to end, then a gap
    ends = np.full((2, 3, len(pairs)), np.nan)
    ends[0, :2], ends[1, :2] = (pairs[[f"upper_{a}_px", f"lower_{a}_px"]].to_numpy().T for a in "xy")
    x_px, y_px = ends.transpose(0, 2, 1).reshape(2, -1)
    ax.plot(
        x_px, y_px, color=ORANGE, lw=0.5, alpha=0.8, zorder=2, label=f"ends on one sub-beam: {len(pairs)}"
    )
    used = residuals["used"].astype(bool)
    for k, level in enumerate(levels):
        colour, _, marker = DEPTH_STYLES[k]
        mine = residuals[used & (residuals["level"].astype(str) == level)]
        shown = thinned(mine, _MOST_POINTS)
        dots(
            ax,
            shown["x_px"],
            shown["y_px"],
            colour,
            marker,
            ms=2.2,
            label=f"{level}: {count(len(mine))} points",
            zorder=3,
        )
    out = residuals[~used]
    if len(out):
        dots(ax, out["x_px"], out["y_px"], "black", "x", ms=5, label=f"rejected: {len(out)}", zorder=4)
    ax.set(xlabel="column / px", ylabel="row / px")
    ax.set_title("a: image and observations")
    ax.legend(loc="upper left", bbox_to_anchor=(0.0, -0.2), ncols=2, borderaxespad=0.0)


def _space(space: Space, sensor: Sensor, pairs: pd.DataFrame, levels: Sequence[str]) -> None:
    """Sub-beams of the pairs and the image rays to their ends."""
    xy = [pairs[[f"{end}_x_px", f"{end}_y_px"]].to_numpy() for end in ("upper", "lower")]
    ends = [intersect(sensor, each) for each in xy]
    good = ends[0].ok & ends[1].ok
    fan = 0.5 * (ends[0].fan_angle_rad + ends[1].fan_angle_rad)[good]
    window, eye, laser = sensor.window, sensor.camera_origin_lcs_mm, sensor.sheet.origin_lcs_mm
    beams = beam_paths(laser, sensor.sheet.beams(fan), window, ends[1].depth_mm[good])
    rays = [
        beam_paths(eye, sensor.camera.rays(each[good]) @ sensor.R_lcs_ccs.T, window, end.depth_mm[good])
        for each, end in zip(xy, ends, strict=True)
    ]
    every = np.concatenate([beams, *rays]).reshape(-1, 3)
    low, high = every.min(axis=0) - 12.0, every.max(axis=0) + 12.0
    for path in beams:
        space.path(path, LIGHT_COLOUR, lw=0.9, zorder=6, gid="beam")
    for k, (end, paths, level) in enumerate(zip(ends, rays, (levels[0], levels[-1]), strict=True)):
        points = end.xyz_lcs_mm[good]
        colour, _, marker = DEPTH_STYLES[k]
        inner, outer, z = points.min(axis=0) - 15.0, points.max(axis=0) + 15.0, float(np.median(points[:, 2]))
        space.plate(inner, outer, z, "0.85", alpha=0.8, zorder=3 - 2 * k)
        depth = float(np.median(end.depth_mm[good]))
        space.words(np.array([outer[0], inner[1], z]), f" {level}, {depth:.0f} mm")
        for path in paths:
            space.path(path, colour, lw=0.5, alpha=0.7, zorder=7)
        space.dots(points, colour, marker, ms=3, zorder=9)
    for z in (-window.thickness_mm, 0.0):
        space.plate(low, high, z, GLASS_COLOUR, alpha=0.35, zorder=8)
    space.device(laser, "laser")
    space.device(eye, "camera")
    space.cross(np.array([low[0], low[1], 0.65 * low[2]]), 0.14 * float(np.ptp(every[:, 2])))
    space.finish("b: sub-beams (green) and image rays")


def _residuals(ax: Axes, residuals: pd.DataFrame, levels: Sequence[str]) -> None:
    along = "y_px" if np.ptp(residuals["y_px"]) >= np.ptp(residuals["x_px"]) else "x_px"
    used = residuals["used"].astype(bool)
    for k, level in enumerate(levels):
        colour, _, marker = DEPTH_STYLES[k]
        mine = residuals[used & (residuals["level"].astype(str) == level)]
        rms = root_mean_square(mine["residual_px"]) if len(mine) else float("nan")
        dots(ax, mine[along], mine["residual_px"], colour, marker, label=f"{level}: {rms:.3f} px")
    out = residuals[~used]
    limit = 1.3 * float(residuals.loc[used, "residual_px"].abs().quantile(0.998)) + 1e-6
    shown = out["residual_px"].clip(-limit, limit)
    dots(ax, out[along], shown, GREY, "x", ms=4)
    ax.axhline(0.0, color="0.3", lw=0.6)
    ax.set(xlabel=f"{'row' if along == 'y_px' else 'column'} / px", ylabel="residual / px")
    ax.set_ylim(-1.05 * limit, 1.35 * limit)
    ax.set_title("c: residuals, root mean squares" + ("; crosses: rejected" if len(out) else ""))
    ax.legend(loc="upper left", ncols=len(levels), markerscale=2.0)
    ax.grid()


def draw_grid_calibration(
    *, sensor: Path, images: list[Path], line_points: Path, residuals: Path, pairs: Path, title: str
) -> Figure:
    """Image, residuals and pairs of a calibration of the light sheet -> figure."""
    return grid_calibration(
        read_sensor(sensor),
        first_image(images, line_points)[0],
        pd.read_csv(residuals),
        pd.read_csv(pairs),
        title=title,
    )
