"""How refraction bends a light sheet (P3 Fig. 1, P4 Fig. 1 and 2): in space, and its line on a plane."""

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.core.types import ArrayF
from thalweg.figures.calibration.field_views import Oblique
from thalweg.figures.style import BLUE, VERMILION, new_figure, styled
from thalweg.lightsheet.figures.views import (
    GLASS_COLOUR,
    LIGHT_COLOUR,
    WATER_COLOUR,
    along_and_off,
    axes_cross,
    beam_paths,
    fill_oblique,
    plate,
    words_oblique,
)
from thalweg.lightsheet.optics.sensor import LightSheet, Window

TILTS_DEG: Final = ((45.0, 0.0), (45.0, 30.0))
"""About the y axis, and then about the x axis: those of P3 Fig. 1 and P4 Fig. 1."""

HALF_ANGLE_DEG: Final = 32.0
HEIGHT_MM: Final = 70.0
DEPTH_MM: Final = 100.0
WINDOW: Final = Window(thickness_mm=15.0, n_glass=1.52, n_water=1.335)
VIEW: Final = Oblique(azimuth_deg=22.0, elevation_deg=22.0)

_BEAMS: Final = 121
_DRAWN: Final = 15
"""Each how many-th sub-beam is drawn as a line."""


def tilted_sheet(first_deg: float, second_deg: float) -> LightSheet:
    """A fan along y, turned about the y axis and then about the x axis."""
    angles = np.deg2rad([second_deg, first_deg, 90.0])
    return LightSheet(
        origin_lcs_mm=np.array([0.0, 0.0, HEIGHT_MM]), angles_rad=angles,
        half_angle_rad=float(np.deg2rad(HALF_ANGLE_DEG)),
    )  # fmt: skip


def sheet_paths(sheet: LightSheet) -> ArrayF:
    """(n, 4, 3) corners of the paths of its sub-beams down to the plane."""
    angles = np.linspace(-sheet.half_angle_rad, sheet.half_angle_rad, _BEAMS)
    return beam_paths(sheet.origin_lcs_mm, sheet.beams(angles), WINDOW, DEPTH_MM)


@styled
def sheet_deformation() -> Figure:
    """Above: sheets with one and with two tilts in air, glass and water. Below: their lines on a plane."""
    head = (
        f"A plane light sheet behind {WINDOW.thickness_mm:g} mm of glass, refractive index "
        f"{WINDOW.n_glass:.2f}, on a plane in {DEPTH_MM:g} mm of water, {WINDOW.n_water} (no data)"
    )
    figure = new_figure(124.0, head, twin=False)
    axes = figure.subplots(2, 2, height_ratios=[1.5, 1.0])
    for k, (first, second) in enumerate(TILTS_DEG):
        paths = sheet_paths(tilted_sheet(first, second))
        _space(axes[0, k], paths)
        words = f"{'ab'[k]}: turned by {first:g}° about y"
        axes[0, k].set_title(words + (f", then by {second:g}° about x" if second else ""))
        _line(axes[1, k], paths[:, 3], "cd"[k])
    return figure


def _space(ax: Axes, paths: ArrayF) -> None:
    flat = paths.reshape(-1, 3)
    low, high = flat.min(axis=0) - 12.0, flat.max(axis=0) + 12.0
    bottom = -WINDOW.thickness_mm - DEPTH_MM
    fill_oblique(ax, VIEW, plate(low, high, bottom), "0.9", alpha=1.0, zorder=1)
    line = VIEW.apply(paths[:, 3])[0]
    ax.plot(*line.T, color=VERMILION, lw=1.8, zorder=2, gid="line")
    _fan(ax, paths[:, 2:4], 3)
    fill_oblique(ax, VIEW, plate(low, high, -WINDOW.thickness_mm), WATER_COLOUR, alpha=0.6, zorder=4)
    _fan(ax, paths[:, 1:3], 5)
    fill_oblique(ax, VIEW, plate(low, high, 0.0), GLASS_COLOUR, alpha=0.5, zorder=6)
    _fan(ax, paths[:, 0:2], 7)
    ax.plot(*VIEW.apply(paths[0, 0])[0], marker="s", ms=5, color="black", zorder=9)
    words_oblique(ax, VIEW, paths[0, 0] + [8.0, 0.0, 6.0], "laser")
    for words, z in (("air", 0.0), ("glass", -0.5 * WINDOW.thickness_mm), ("water", 0.45 * bottom)):
        words_oblique(ax, VIEW, np.array([high[0], low[1], z + (8.0 if z == 0.0 else 0.0)]), f" {words}")
    words_oblique(ax, VIEW, np.array([high[0], low[1], bottom]), " plane")
    axes_cross(ax, VIEW, np.array([low[0], low[1], 0.55 * HEIGHT_MM]), 24.0)
    ax.set_aspect("equal")
    ax.margins(0.04)
    ax.axis("off")


def _fan(ax: Axes, parts: ArrayF, zorder: float) -> None:
    """Part (n, 2, 3) of the sheet between two media."""
    edge = np.concatenate([parts[:, 0], parts[::-1, 1]])
    ax.fill(*VIEW.apply(edge)[0].T, facecolor=LIGHT_COLOUR, edgecolor="none", alpha=0.35, zorder=zorder)
    for ends in parts[::_DRAWN]:
        ax.plot(*VIEW.apply(ends)[0].T, color="#1b7837", lw=0.5, zorder=zorder + 0.5)


def _line(ax: Axes, points_mm: ArrayF, letter: str) -> None:
    """The line on the plane: how far its points lie from a straight one."""
    x, y = points_mm[:, 0], points_mm[:, 1]
    along, off = along_and_off(x, y)
    ax.axhline(0.0, color=BLUE, lw=0.9, ls="--", label="straight line", gid="straight")
    ax.plot(along, off, color=VERMILION, lw=1.8, label="line on the plane", gid="line")
    bends = int(np.sum(np.diff(np.sign(_curvature(along, off))) != 0))
    shape = "bent to both sides" if bends else "bent to one side"
    ax.set_title(f"{letter}: its line on the plane, {shape}")
    ax.set(xlabel="place along the straight line / mm", ylabel="distance from it / mm", ylim=(-6.0, 8.5))
    ax.grid()
    ax.legend(loc="upper center", ncols=2)


def _curvature(x: ArrayF, y: ArrayF) -> ArrayF:
    """Signed curvature times a positive factor along points of a curve, without its ends."""
    dx, dy = np.gradient(x), np.gradient(y)
    return np.asarray((dx * np.gradient(dy) - dy * np.gradient(dx))[3:-3])
