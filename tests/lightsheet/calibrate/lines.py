"""Line points on a grid object, and sensors of which more or less is known."""

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from thalweg.core import ArrayB, ArrayF
from thalweg.lightsheet.calibration import GridObject, parse_grid
from thalweg.lightsheet.calibration.sheet_calibration import SheetCalibration
from thalweg.lightsheet.optics import Sensor, project, sheet_in_water
from thalweg_lab.random_numbers import generator

OBJECT = """
thalweg_grid: 1
name: printed grid over a plate
levels:
  - {name: grid, pattern: grid, depth_mm: 60.0, sigma_mm: 0.05}
  - {name: plate, pattern: plate, depth_mm: 150.0, sigma_mm: 0.05}
grid:
  along_x: {bar_mm: 9.0, gap_mm: 5.0, gaps: 24}
  along_y: {bar_mm: 5.0, gap_mm: 100.0, gaps: 1}
"""
THREE = OBJECT.replace(
    "  - {name: plate", "  - {name: middle, pattern: grid, depth_mm: 105.0, sigma_mm: 0.05}\n  - {name: plate"
)
"""A third level under every other gap."""


def without_sigmas(sensor: Sensor) -> Sensor:
    """A sensor of which everything is known exactly."""
    return sensor.with_vector(sensor.vector(), cov=np.zeros((26, 26)))


def place_in_sigmas(found: SheetCalibration, true: Sensor) -> ArrayF:
    """Errors (3,) of the laser's place over their sigmas."""
    off = found.sensor.sheet.origin_lcs_mm - true.sheet.origin_lcs_mm
    return np.asarray(off / [found.sigma(f"laser_{axis}_mm") for axis in "xyz"])


def off_start(sensor: Sensor, seed: int, mm: float = 10.0, deg: float = 4.0) -> Sensor:
    """The sensor with a laser that is off by up to so much in each coordinate and angle."""
    rng, x = generator(seed, "start"), sensor.vector()
    x[15:18] += rng.uniform(-mm, mm, 3)
    x[18:21] += np.deg2rad(rng.uniform(-deg, deg, 3))
    return sensor.with_vector(x)


def grid_object(upper: float = 60.0, lower: float = 150.0) -> GridObject:
    """A printed grid over a plate, at depths in mm."""
    text = OBJECT.replace("depth_mm: 60.0", f"depth_mm: {upper}").replace(
        "depth_mm: 150.0", f"depth_mm: {lower}"
    )
    return parse_grid(text)


def line_points(
    sensor: Sensor,
    grid: GridObject,
    seed: int = 1,
    *,
    sigma_px: float = 0.15,
    axis: int = 0,
    every: int = 1,
    depths_mm: ArrayF | None = None,
    edge_shift_px: float = 0.0,
    sigma_edge_px: float = 0.0,
    phase_mm: float = 0.0,
    along: int = 0,
) -> pd.DataFrame:
    """Row-wise (``axis`` 0: x measured) or column-wise points of the line on all levels.

    The bars of the grid lie along the world axis ``along``; a sub-beam hits the first level whose bar it
    meets. ``depths_mm`` are the true depths, those of the object if None. All ends reach ``edge_shift_px``
    too far out, each with its own error ``sigma_edge_px``; the object lies ``phase_mm`` aside.
    """
    rng = generator(seed, "line points")
    depths = grid.depths_mm if depths_mm is None else depths_mm
    a = np.linspace(-1, 1, 6001) * sensor.sheet.half_angle_rad * 0.999
    beams = sheet_in_water(sensor, depths, a)
    reach = float(grid.gaps_x_mm[-1, 1] + grid.gaps_x_mm[0, 0])
    frames: list[pd.DataFrame] = []
    for k, points in enumerate(beams):
        xy = project(sensor, points)
        there = np.asarray(sensor.camera.inside(np.nan_to_num(xy, nan=-1.0)), dtype=np.bool_)
        seen = np.isfinite(xy).all(axis=1) & there
        if seen.sum() < 10:
            continue
        across, down = xy[seen, axis], xy[seen, 1 - axis]
        order = np.argsort(down)
        rows = np.arange(np.ceil(down.min() - 0.5), np.floor(down.max() - 0.5), every) + 0.5
        x = CubicSpline(down[order], across[order])(rows)
        place = beams[0][:, along]  # on the first level, growing or falling with the fan angle
        turn = 1 if place[-1] > place[0] else -1
        # with three levels the gaps look on the second and the third one in turn
        gaps = grid.gaps_x_mm if k == 0 else grid.gaps_x_mm[k - 1 :: len(depths) - 1]
        edges_mm = (gaps - reach / 2 - phase_mm).ravel()
        edges_fan = np.interp(edges_mm, place[::turn], a[::turn])
        inside = (edges_mm > place.min()) & (edges_mm < place.max())
        by_fan = np.argsort(a[seen])
        edges_row = np.interp(edges_fan, a[seen][by_fan], down[by_fan])
        # a piece reaches as much too far as the edge is moved out of the light, into the dark
        into_gap = np.tile([1.0, -1.0], len(gaps)) * (1 if k == 0 else -1)
        rising = np.sign(down[by_fan][-1] - down[by_fan][0]) * turn
        noise = sigma_edge_px * rng.standard_normal(len(edges_row))
        edges_row = (edges_row + rising * into_gap * edge_shift_px + noise)[inside]
        is_start = np.tile([True, False], len(gaps))[inside]
        lit = _lit(rows, edges_row, is_start, rising, top=k == 0)
        xy_px = np.stack([x + sigma_px * rng.standard_normal(len(x)), rows], axis=1)[lit]
        frames.append(pd.DataFrame({"x_px": xy_px[:, axis], "y_px": xy_px[:, 1 - axis], "level": k}))
    table = pd.concat(frames, ignore_index=True)
    table["sigma_px"] = max(sigma_px, 0.01)
    table["angle_rad"] = 0.0 if axis == 0 else np.pi / 2
    table["line"] = -1
    table["peak_dn"] = 200.0
    table["flags"] = 0
    # the detector knows nothing of levels: mix the rows
    order = rng.permutation(len(table))
    return table.iloc[order].reset_index(drop=True)


def _lit(rows: ArrayF, edges_row: ArrayF, is_start: ArrayB, rising: float, *, top: bool) -> ArrayB:
    """Which rows are lit: between the edges of gaps, or outside of them on top."""
    in_gap = np.zeros(len(rows), dtype=np.bool_)
    if len(edges_row) == 0:
        return ~in_gap if top else in_gap
    if not is_start[0]:  # the first gap begins outside of the fan
        in_gap |= rising * (rows - edges_row[0]) < 0
    starts = np.flatnonzero(is_start)
    for i in starts:
        low = rising * (rows - edges_row[i]) >= 0
        in_gap |= low & (rising * (rows - edges_row[i + 1]) < 0) if i + 1 < len(edges_row) else low
    return ~in_gap if top else in_gap
