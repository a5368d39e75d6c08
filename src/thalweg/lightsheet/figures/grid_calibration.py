"""Calibration of the light sheet on a grid above a plate (P3 Fig. 4 and 7; P4 Fig. 9 and 10)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.core import AnyArray, ArrayF, CoverageError, root_mean_square
from thalweg.figures import GREY, ORANGE, count, new_figure, plural, styled
from thalweg.figures.calibration import Oblique
from thalweg.lightsheet.figures.views import (
    DEPTH_STYLES,
    GLASS_COLOUR,
    LIGHT_COLOUR,
    axes_cross,
    beam_paths,
    fill_oblique,
    first_image,
    green_of,
    need,
    plate,
    show_green,
    words_oblique,
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
    twin: bool = False,
) -> Figure:
    """The image with the points of each level and the pairs of ends, the rays in space, and the residuals.

    Parameters
    ----------
    sensor : calibrated.
    image : (h, w) mosaic or monochrome, or (h, w, 3), of the calibration object.
    residuals : line points, columns `RESIDUALS`.
    pairs : ends on one sub-beam, columns `PAIRS`.
    title : first words of the title.
    twin : true if the digital twin made the image.

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
    figure = new_figure(146.0, head, twin=twin)
    grid = figure.add_gridspec(2, 2, height_ratios=[1.75, 1.0])
    levels = list(dict.fromkeys(residuals["level"].astype(str)))
    _image(figure.add_subplot(grid[0, 0]), image, residuals, pairs, levels)
    _space(figure.add_subplot(grid[0, 1]), sensor, kept, levels)
    _residuals(figure.add_subplot(grid[1, 0]), residuals, levels)
    _pairs(figure.add_subplot(grid[1, 1]), pairs)
    return figure


def _image(
    ax: Axes, image: AnyArray, residuals: pd.DataFrame, pairs: pd.DataFrame, levels: Sequence[str]
) -> None:
    show_green(ax, green_of(image))
    ends = pairs[pairs["used"].astype(bool)]
    across = np.stack([ends[["upper_x_px", "lower_x_px"]], ends[["upper_y_px", "lower_y_px"]]], axis=-1)
    for line in across:
        ax.plot(line[:, 0], line[:, 1], color=ORANGE, lw=0.5, alpha=0.8, zorder=2)
    ax.plot([], [], color=ORANGE, lw=0.8, label=f"ends on one sub-beam: {len(ends)}")
    for k, level in enumerate(levels):
        colour, _, marker = DEPTH_STYLES[k]
        mine = residuals[residuals["level"].astype(str) == level]
        shown = mine[mine["used"].astype(bool)]
        step = max(1, -(-len(shown) // _MOST_POINTS))
        ax.plot(
            shown["x_px"][::step],
            shown["y_px"][::step],
            ls="none",
            marker=marker,
            ms=2.2,
            color=colour,
            label=f"{level}: {count(len(shown))} points",
            gid=f"level {k}",
            zorder=3,
        )
    out = residuals[~residuals["used"].astype(bool)]
    if len(out):
        ax.plot(
            out["x_px"],
            out["y_px"],
            ls="none",
            marker="X",
            ms=5,
            mfc="white",
            mec="black",
            mew=0.6,
            label=f"rejected: {len(out)}",
            gid="rejected",
            zorder=4,
        )
    ax.set(xlabel="column / px", ylabel="row / px")
    ax.set_title("a: image and observations")
    ax.legend(loc="upper left", bbox_to_anchor=(0.0, -0.2), ncols=2, borderaxespad=0.0)


def _space(ax: Axes, sensor: Sensor, pairs: pd.DataFrame, levels: Sequence[str]) -> None:
    """Sub-beams of the pairs and the image rays to their ends."""
    upper = intersect(sensor, pairs[["upper_x_px", "upper_y_px"]].to_numpy(np.float64))
    lower = intersect(sensor, pairs[["lower_x_px", "lower_y_px"]].to_numpy(np.float64))
    good = upper.ok & lower.ok
    fan = 0.5 * (upper.fan_angle_rad + lower.fan_angle_rad)[good]
    beams = beam_paths(
        sensor.sheet.origin_lcs_mm, sensor.sheet.beams(fan), sensor.window, lower.depth_mm[good]
    )
    along = np.abs(beams[-1, 3] - beams[0, 3])
    # across the line the paths of laser and camera lie side by side
    view = Oblique(azimuth_deg=66.0 if along[0] >= along[1] else 24.0, elevation_deg=14.0)
    ends = [(upper.xyz_lcs_mm[good], 0), (lower.xyz_lcs_mm[good], 1)]
    rays = [
        _image_rays(sensor, pairs, name, points)
        for name, points in zip(("upper", "lower"), (ends[0][0], ends[1][0]), strict=True)
    ]
    every = np.concatenate([beams, *rays]).reshape(-1, 3)
    low, high = every.min(axis=0) - 12.0, every.max(axis=0) + 12.0
    for points, k in reversed(ends):
        z = float(np.median(points[:, 2]))
        inner, outer = points.min(axis=0) - 15.0, points.max(axis=0) + 15.0
        fill_oblique(ax, view, plate(inner, outer, z), "0.85", alpha=0.8, zorder=1 + 2 * (1 - k))
        depth = float(np.median(sensor.window.depth_mm(points)))
        name = levels[-1] if k else levels[0]
        words_oblique(ax, view, np.array([outer[0], inner[1], z]), f" {name}, {depth:.0f} mm")
    for path in beams:
        ax.plot(*view.apply(path)[0].T, color=LIGHT_COLOUR, lw=0.9, zorder=6, gid="beam")
    for (points, k), paths in zip(ends, rays, strict=True):
        colour, _, marker = DEPTH_STYLES[k]
        for path in paths:
            ax.plot(*view.apply(path)[0].T, color=colour, lw=0.5, alpha=0.7, zorder=7, gid="ray")
        ax.plot(*view.apply(points)[0].T, ls="none", marker=marker, ms=3, color=colour, zorder=9)
    for z in (-sensor.window.thickness_mm, 0.0):
        fill_oblique(ax, view, plate(low, high, z), GLASS_COLOUR, alpha=0.35, zorder=8)
    for words, place in (("laser", sensor.sheet.origin_lcs_mm), ("camera", sensor.camera_origin_lcs_mm)):
        ax.plot(*view.apply(place)[0], marker="s", ms=5, color="black", zorder=10)
        words_oblique(ax, view, place, f"  {words}")
    corners = plate(low, high, 0.65 * low[2])
    axes_cross(ax, view, corners[np.argmin(view.apply(corners)[0][:, 0])], 0.14 * float(np.ptp(every[:, 2])))
    ax.set_aspect("equal")
    ax.margins(0.03)
    ax.axis("off")
    ax.set_title("b: sub-beams (green) and image rays")


def _image_rays(sensor: Sensor, pairs: pd.DataFrame, name: str, points: ArrayF) -> ArrayF:
    xy = pairs[[f"{name}_x_px", f"{name}_y_px"]].to_numpy(np.float64)[: len(points)]
    directions = sensor.camera.rays(xy) @ sensor.R_lcs_ccs.T
    return beam_paths(sensor.camera_origin_lcs_mm, directions, sensor.window, sensor.window.depth_mm(points))


def _residuals(ax: Axes, residuals: pd.DataFrame, levels: Sequence[str]) -> None:
    along = "y_px" if np.ptp(residuals["y_px"]) >= np.ptp(residuals["x_px"]) else "x_px"
    for k, level in enumerate(levels):
        colour, _, marker = DEPTH_STYLES[k]
        mine = residuals[(residuals["level"].astype(str) == level) & residuals["used"].astype(bool)]
        rms = root_mean_square(mine["residual_px"]) if len(mine) else float("nan")
        ax.plot(
            mine[along],
            mine["residual_px"],
            ls="none",
            marker=marker,
            ms=1.8,
            color=colour,
            mew=0.0,
            label=f"{level}: {rms:.3f} px",
            gid=f"residuals {k}",
        )
    out = residuals[~residuals["used"].astype(bool)]
    seen = residuals[residuals["used"].astype(bool)]["residual_px"].abs()
    limit = 1.3 * float(seen.quantile(0.998)) + 1e-6
    ax.plot(
        out[along],
        out["residual_px"].clip(-limit, limit),
        ls="none",
        marker="x",
        ms=4,
        color=GREY,
        gid="rejected residuals",
    )
    ax.axhline(0.0, color="0.3", lw=0.6)
    ax.set(
        xlabel=f"{'row' if along == 'y_px' else 'column'} / px",
        ylabel="residual / px",
        ylim=(-1.05 * limit, 1.35 * limit),
    )
    ax.set_title("c: residuals, root mean squares" + ("; crosses: rejected" if len(out) else ""))
    ax.legend(loc="upper left", ncols=len(levels), markerscale=2.0)
    ax.grid()


def _pairs(ax: Axes, pairs: pd.DataFrame) -> None:
    """How far the fan angles of both ends are apart."""
    used = pairs["used"].to_numpy(dtype=bool)
    number = np.arange(1, len(pairs) + 1)
    apart = pairs["apart_deg"].to_numpy(np.float64)
    sigma = np.abs(apart / pairs["standardised"].to_numpy(np.float64))
    sigma = np.where(np.isfinite(sigma), sigma, 0.0)
    ax.errorbar(
        number[used],
        apart[used],
        yerr=sigma[used],
        ls="none",
        marker="o",
        ms=3.5,
        color=ORANGE,
        ecolor="0.5",
        elinewidth=0.8,
        capsize=1.5,
        gid="pairs",
    )
    ax.plot(number[~used], apart[~used], ls="none", marker="x", color=GREY, gid="rejected pairs")
    ax.axhline(0.0, color="0.3", lw=0.6)
    rms = root_mean_square(apart[used])
    ax.set(xlabel="pair / 1", ylabel="difference of fan angles / °")
    ax.set_title(f"d: pairs with sigmas, root mean square {rms:.3f}°")
    ax.grid()


def draw_grid_calibration(
    *,
    sensor: Path,
    images: list[Path],
    line_points: Path,
    residuals: Path,
    pairs: Path,
    title: str,
    twin: bool,
) -> Figure:
    """Image, residuals and pairs of a calibration of the light sheet -> figure."""
    return grid_calibration(
        read_sensor(sensor),
        first_image(images, line_points)[0],
        pd.read_csv(residuals),
        pd.read_csv(pairs),
        title=title,
        twin=twin,
    )
