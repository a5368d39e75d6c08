"""The survey at a glance: banks, riverbed and track from above, in the colours of a topographic map."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from cmcrameri import cm
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from pyproj import CRS

from thalweg.bathymetry import FlowLine
from thalweg.core import ArrayF, Trajectory, iter_laz, read_json, read_raster
from thalweg.figures import (
    HALO,
    VERMILION,
    WIDTH_MM,
    marks_in_free_corners,
    new_figure,
    robust_limits,
    styled,
)
from thalweg.figures.bathymetry import depth_of
from thalweg.figures.cloud.views import ObliqueView, Splat
from thalweg.figures.survey import draw_ends, track_of

WATER: Final = ListedColormap(cm.oleron_r(np.linspace(0.52, 0.98, 256)), "thalweg_water")
LAND: Final = ListedColormap(cm.oleron(np.linspace(0.54, 0.96, 256)), "thalweg_land")
"""Both halves of a map of F. Crameri: light shallows and dark depths, green banks and brown heights."""
_WIDTH_PX: Final = 1300
_DOT_PX: Final = 9
"""Half size of a sounding where there is no bed."""
_SHAPE: Final = 0.62
"""Height over width."""
_MARGIN: Final = 0.18
_LEAST_MARGIN_M: Final = 8.0
"""Around track and bed, in shares of their extent, and at least."""


def draw_from_above(
    *,
    trajectory: Path,
    points: list[Path],
    bed: list[Path],
    line: list[Path],
    level: list[Path],
    soundings: list[Path],
    crs: str,
) -> Figure:
    """Trajectory, cloud, bed with its line and water level, soundings on the map -> the survey from above."""
    path = Trajectory.read(trajectory)
    wet, depth_m, cell_m = _water(path, bed, line, level, soundings, crs)
    view = view_of(np.vstack([path.position_wcs_m[path.valid], wet]))
    land = None
    water_up_m = read_json(level[0])["level_m"] if level else 0.0
    if points:
        land = Splat(view)
        for chunk in iter_laz(points[0], 1_000_000):
            land.add(chunk["xyz_m"], chunk["xyz_m"][:, 2] - water_up_m)
    above = "height above the water / m" if level else "height / m"
    return from_above(path, view, land, wet, depth_m, cell_m=cell_m, above=above)


@styled
def from_above(
    path: Trajectory,
    view: ObliqueView,
    land: Splat[ObliqueView] | None,
    wet_m: ArrayF,
    depth_m: ArrayF,
    *,
    cell_m: float = 0.0,
    above: str = "height / m",
) -> Figure:
    """Cloud by height, bed or soundings by depth, track, scale and north.

    Parameters
    ----------
    path : of the boat.
    view : as `view_of` makes it.
    land : the cloud with its heights; None: there is none.
    wet_m, depth_m : (n, 3) places in the local frame, (n,) their depths.
    cell_m : size of a cell of the bed; 0: the places are soundings, which lie on the track.
    above : what the heights are.
    """
    picture = np.full((view.height_px, view.width_px, 3), 255, np.uint8)
    bars: list[tuple[ListedColormap, tuple[float, float], str]] = []
    if len(wet_m):
        water, limits = Splat(view), (0.0, robust_limits(depth_m, 0.5, 99.5)[1])
        water.add(wet_m, depth_m)
        radius = int(np.ceil(0.5 * cell_m / view.pixel_m)) if cell_m else _DOT_PX
        picture = _laid_on(picture, water, WATER, limits, radius, shading=0.0)
        bars.append((WATER, limits, "water depth / m"))
    if land is not None:
        limits = (0.0, robust_limits(land.buffers()[1], 1, 97)[1])
        picture = _laid_on(picture, land, LAND, limits, land.radius_px(), shading=1.0)
        bars.append((LAND, limits, above))
    figure = new_figure(WIDTH_MM * _SHAPE + (14.0 if bars else 2.0), "")
    rows: Any = [["map"] * max(len(bars), 1)] + ([[name for _, _, name in bars]] if bars else [])
    axes = figure.subplot_mosaic(rows, height_ratios=[45, 1][: len(rows)])
    ax = axes["map"]
    right, bottom = np.array([view.width_px, -view.height_px]) * view.pixel_m + [view.left_m, view.top_m]
    ax.imshow(picture, extent=(view.left_m, right, bottom, view.top_m), interpolation="antialiased")
    look: dict[str, Any] = {"lw": 1.5, "path_effects": HALO} if cell_m or not len(wet_m) else {"lw": 0.5}
    # a line is broken where no pose is
    east_north = track_of(path)
    ax.plot(*east_north.T, color=VERMILION, label="track of the boat", gid="track", **look)
    draw_ends(ax, path)
    ax.legend(loc="upper left", ncols=3, fontsize=7, edgecolor="none", borderaxespad=0.2)
    ax.set(xlim=(view.left_m, right), ylim=(bottom, view.top_m))
    marks_in_free_corners(ax, np.vstack([path.position_wcs_m[path.valid], wet_m])[:, :2])
    ax.set_axis_off()
    for colours, limits, name in bars:
        scale = ScalarMappable(Normalize(*limits), colours)
        bar = figure.colorbar(scale, cax=axes[name], orientation="horizontal")
        bar.ax.tick_params(labelsize=7)
        bar.set_label(name, fontsize=7)
    return figure


def _water(
    path: Trajectory, bed: list[Path], line: list[Path], level: list[Path], soundings: list[Path], crs: str
) -> tuple[ArrayF, ArrayF, float]:
    """Places (n, 3) in the local frame with their depths (n,), and the size of a cell of a bed, else 0."""
    if bed:
        grid, bands, _ = read_raster(bed[0])
        depth = depth_of(grid, bands, path.frame, FlowLine.read(line[0]), level[0])[0].ravel()
        known = np.isfinite(depth)
        heights = bands["height_m"].ravel()[known]
        place = path.frame.from_map(np.column_stack([grid.centres_m()[known], heights]), grid.crs)
        return place, depth[known], grid.cell_m
    if soundings:
        table = pd.read_csv(soundings[0]).dropna(subset=["depth"])
        place = path.frame.from_map(table[["east", "north", "height"]].to_numpy(), CRS.from_user_input(crs))
        return place, table["depth"].to_numpy(), 0.0
    return np.empty((0, 3)), np.empty(0), 0.0


def view_of(shown: ArrayF) -> ObliqueView:
    """A view from above, north up, that holds these places with a margin."""
    low, high = shown[:, :2].min(axis=0), shown[:, :2].max(axis=0)
    span = high - low + 2 * max(_MARGIN * float((high - low).max()), _LEAST_MARGIN_M)
    width = max(span[0], span[1] / _SHAPE)
    middle = 0.5 * (low + high)
    return ObliqueView(
        azimuth_rad=0.0,
        elevation_rad=0.5 * np.pi,
        left_m=float(middle[0] - 0.5 * width),
        top_m=float(middle[1] + 0.5 * width * _SHAPE),
        pixel_m=float(width / _WIDTH_PX),
        width_px=_WIDTH_PX,
        height_px=int(_WIDTH_PX * _SHAPE),
    )


def _laid_on(
    picture: np.ndarray,
    splat: Splat[ObliqueView],
    colours: ListedColormap,
    limits: tuple[float, float],
    radius_px: int,
    *,
    shading: float,
) -> np.ndarray:
    """A picture with another one laid on it."""
    drawn = np.isfinite(splat.buffers(radius_px)[0])[..., None]
    table = colours(np.linspace(0, 1, 256))[:, :3]
    return np.where(drawn, splat.image(table, limits, radius_px=radius_px, shading=shading), picture)
