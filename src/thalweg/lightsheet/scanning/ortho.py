"""Orthophoto of the bed from the sensor's own images, lit by the day (P4 4.1, Bodenmann et al. 2016).

The images that hold the laser line also show the bed around it. Each cell of a level grid gets its height
from the measured points; its centre is projected through the window into each image, strip by strip, and the
colours of all images that see it are averaged: daylight under water is weak, and a mean of k images has
1 / sqrt(k) of their noise. Pixels near the laser line are left out, and cells that the bed itself hides.

It is written as a picture, and a world file that says where its pixels are.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import QhullError, cKDTree

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, ArrayU8, GeometryError, InputError, optional
from thalweg.core.geometry import RayCaster
from thalweg.lightsheet.optics import Sensor, directions_to_points, project, refract_to_water
from thalweg.lightsheet.poses import M_PER_MM
from thalweg.lightsheet.scanning.profile import ScanCloud

cv2 = optional("cv2")

LINE_MARGIN_PX: Final = 20.0
_LIFT_MM: Final = 0.3
"""A ray of sight starts so far above its cell: float32 and the cell's own triangles."""
_MOST_CELLS: Final = 50_000_000
_MOSAICS: Final = ("rggb", "bggr", "grbg", "gbrg")


@dataclass(frozen=True, slots=True, kw_only=True)
class HeightGrid:
    """Heights on a level grid: row i, column j has its centre at ``(x0 + j g, y0 + i g)``, metres.

    ``height_m`` (rows, columns), NaN where the points leave a gap.
    """

    x0_m: float
    y0_m: float
    cell_m: float
    height_m: ArrayF

    @property
    def points_m(self) -> ArrayF:
        """(rows * columns, 3) centres."""
        rows, columns = self.height_m.shape
        y, x = np.mgrid[0:rows, 0:columns]
        return np.stack(
            [self.x0_m + self.cell_m * x.ravel(), self.y0_m + self.cell_m * y.ravel(), self.height_m.ravel()],
            axis=1,
        )

    def mesh(self) -> tuple[ArrayF, ArrayI]:
        """Vertices and faces of the cells whose four corners have a height."""
        rows, columns = self.height_m.shape
        number = np.arange(rows * columns).reshape(rows, columns)
        a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
        faces = np.concatenate([np.stack([k.ravel() for k in t], axis=1) for t in ((a, b, c), (a, c, d))])
        points = self.points_m
        known = np.isfinite(points[:, 2])
        faces = faces[known[faces].all(axis=1)]
        points[~known, 2] = 0.0
        return points, faces.astype(np.int64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Orthophoto:
    """Colours on a grid.

    ``dn`` (rows, columns, 3) mean grey values red, green, blue (three times the same for a monochrome
    camera), NaN where nothing was seen; ``images`` (rows, columns) number of images of each cell; ``counts``
    of cells.
    """

    grid: HeightGrid
    dn: ArrayF
    images: ArrayI
    counts: dict[str, int]

    def picture(self) -> ArrayU8:
        """(rows, columns, 3) for people: larger y up, all colours stretched alike, black where unseen."""
        seen = np.isfinite(self.dn)
        if not seen.any():
            raise GeometryError("no cell was seen", expected="images of the bed", where="orthophoto")
        low, high = np.percentile(self.dn[seen], [1.0, 99.0])
        scaled = np.clip((self.dn - low) / max(high - low, 1e-6), 0.0, 1.0) * 254.0 + 1.0
        return np.where(seen, scaled, 0.0)[::-1].astype(np.uint8)


def height_grid(xyz_m: ArrayF, cell_m: float, *, largest_gap_m: float) -> HeightGrid:
    """Heights of a bed on a level grid: means of cells, linear between them.

    Parameters
    ----------
    xyz_m : (n, 3) points, z upwards.
    cell_m : width of a cell.
    largest_gap_m : cells farther from any point stay empty.

    Raises
    ------
    GeometryError : too few points, points on a line, or more than 50 million cells.
    """
    X = np.asarray(xyz_m, dtype=np.float64)
    if len(X) < 4 or not np.isfinite(X).all() or not cell_m > 0:
        raise GeometryError(f"{len(X)} points in cells of {cell_m} m", expected="four and more finite points")
    low = np.floor(X[:, :2].min(axis=0) / cell_m) * cell_m
    columns, rows = (int(n) for n in np.ceil((X[:, :2].max(axis=0) - low) / cell_m) + 1)
    if rows * columns > _MOST_CELLS:
        raise GeometryError(f"{rows} x {columns} cells", expected="fewer: choose wider cells", where="grid")
    at = np.rint((X[:, :2] - low) / cell_m).astype(np.int64)
    key = at[:, 1] * columns + at[:, 0]
    count = np.bincount(key, minlength=rows * columns)
    has = count > 0
    mean = np.stack([np.bincount(key, X[:, k], rows * columns)[has] / count[has] for k in range(3)], axis=1)
    y, x = np.mgrid[0:rows, 0:columns]
    centres = low + cell_m * np.stack([x.ravel(), y.ravel()], axis=1)
    gap = np.asarray(cKDTree(mean[:, :2]).query(centres, distance_upper_bound=largest_gap_m)[0])
    near = gap <= largest_gap_m
    height = np.full(rows * columns, np.nan)
    try:
        height[near] = LinearNDInterpolator(mean[:, :2] - low, mean[:, 2])(centres[near] - low)
    except QhullError as error:
        raise GeometryError(
            "the points lie on a line", expected="points of several scan lines", where="height grid"
        ) from error
    return HeightGrid(
        x0_m=float(low[0]), y0_m=float(low[1]), cell_m=cell_m, height_m=height.reshape(rows, columns)
    )


def colours(image: AnyArray, layout: str = "rggb") -> ArrayF:
    """Red, green, blue (h, w, 3) of an image, in grey values.

    Parameters
    ----------
    image : (h, w) mosaic or monochrome, or (h, w, 3) red, green, blue.
    layout : of a mosaic, or ``mono``.

    Raises
    ------
    InputError : another shape, or an unknown layout.
    """
    if image.ndim == 3 and image.shape[2] == 3:
        return image.astype(np.float64)
    if image.ndim != 2 or layout not in (*_MOSAICS, "mono"):
        raise InputError(
            f"an image of the shape {image.shape} with layout '{layout}'",
            expected=f"(h, w) with layout {', '.join(_MOSAICS)} or mono, or (h, w, 3)",
            where="orthophoto",
        )
    if layout == "mono":
        return np.repeat(image[:, :, None].astype(np.float64), 3, axis=2)
    return np.asarray(cv2.cvtColor(image, getattr(cv2, f"COLOR_Bayer{layout.upper()}2RGB")), dtype=np.float64)


def orthophoto(
    sensor: Sensor,
    cloud: ScanCloud,
    image: Callable[[str], AnyArray],
    *,
    cell_m: float,
    line_margin_px: float = LINE_MARGIN_PX,
    layout: str = "rggb",
) -> Orthophoto:
    """Orthophoto of a scanned bed.

    Parameters
    ----------
    sensor : calibrated.
    cloud : of the scan, in a frame with z upwards.
    image : gives the pixels of an image by its name.
    cell_m : width of a cell.
    line_margin_px : pixels nearer to a measured point of the laser line are left out.
    layout : see `colours`.

    Raises
    ------
    GeometryError : no height grid, or no image sees any of it.
    """
    grid = height_grid(cloud.xyz_m, cell_m, largest_gap_m=max(6 * cell_m, 0.01))
    points = grid.points_m
    known = np.flatnonzero(np.isfinite(points[:, 2]))
    caster = RayCaster(*grid.mesh())
    total = np.zeros((len(points), 3))
    n: ArrayI = np.zeros(len(points), dtype=np.int64)
    hidden = beside = 0
    for k, name in enumerate(cloud.poses.images):
        R, shift = cloud.poses.R_target_lcs[k], cloud.poses.shift_m[k]
        at, xy, exits = _seen(sensor, (points[known] - shift) @ R / M_PER_MM)
        own = cloud.xy_px[cloud.number == k]
        if len(own) and len(at):
            to_line = np.asarray(cKDTree(own).query(xy, distance_upper_bound=line_margin_px)[0])
            off: ArrayB = to_line > line_margin_px
            beside += int((~off).sum())
            at, xy, exits = at[off], xy[off], exits[off]
        free = _free(caster, points[known[at]], (exits * M_PER_MM) @ R.T + shift)
        hidden += int((~free).sum())
        at, xy = at[free], xy[free]
        if len(at):
            total[known[at]] += _sampled(colours(image(name), layout), xy)
            n[known[at]] += 1
    if not n.any():
        raise GeometryError(
            f"none of {len(cloud.poses)} images sees any of {len(known)} cells",
            expected="images of this scan",
            where="orthophoto",
        )
    with np.errstate(invalid="ignore"):
        mean = np.where(n[:, None] > 0, total / np.maximum(n, 1)[:, None], np.nan)
    shape = grid.height_m.shape
    counts = {
        "cells": len(points),
        "cells_without_height": len(points) - len(known),
        "cells_seen": int((n > 0).sum()),
        "views": int(n.sum()),
        "views_beside_the_line": beside,
        "views_hidden": hidden,
    }
    return Orthophoto(grid=grid, dn=mean.reshape(*shape, 3), images=n.reshape(shape), counts=counts)


def write_orthophoto(found: Orthophoto, picture: Path, world: Path) -> None:
    """Write an orthophoto.

    Parameters
    ----------
    found : the orthophoto.
    picture : PNG, north (larger y) up; black where nothing was seen.
    world : world file (six lines): width of a cell, two zeros, minus its height, centre of the upper left
        cell, in metres of the grid's frame.
    """
    grid = found.grid
    done, data = cv2.imencode(".png", np.ascontiguousarray(found.picture()[:, :, ::-1]))
    assert done
    picture.write_bytes(data.tobytes())
    top = grid.y0_m + grid.cell_m * (grid.height_m.shape[0] - 1)
    numbers = (grid.cell_m, 0.0, 0.0, -grid.cell_m, grid.x0_m, top)
    world.write_text("".join(f"{value:.9f}\n" for value in numbers))


def _seen(sensor: Sensor, local_mm: ArrayF) -> tuple[ArrayI, ArrayF, ArrayF]:
    """Points of lcs inside the picture: numbers, pixels (m, 2), and where their rays leave the water."""
    xy = project(sensor, local_mm)
    at = np.flatnonzero(np.isfinite(xy).all(axis=1))
    at = at[np.asarray(sensor.camera.inside(xy[at], 1.0), dtype=np.bool_)]
    eye, window = sensor.camera_origin_lcs_mm, sensor.window
    rays = refract_to_water(eye, directions_to_points(eye, local_mm[at], window), window)
    return at, xy[at], rays.at_depth(0.0)


def _free(caster: RayCaster, points_m: ArrayF, exits_m: ArrayF) -> ArrayB:
    """Whether nothing of the bed stands between points and the window (n,)."""
    way = exits_m - points_m
    length = np.linalg.norm(way, axis=1, keepdims=True)
    direction = way / np.maximum(length, 1e-12)
    hits = caster.cast(points_m + _LIFT_MM * M_PER_MM * np.array([0.0, 0.0, 1.0]), direction)
    return np.asarray(hits.t_hit_m >= length[:, 0])


def _sampled(image: ArrayF, xy_px: ArrayF) -> ArrayF:
    """Colours (n, 3) between pixels, bilinear; the centre of the first pixel is (0.5, 0.5)."""
    h, w = image.shape[:2]
    x, y = np.clip(xy_px[:, 0] - 0.5, 0, w - 1.001), np.clip(xy_px[:, 1] - 0.5, 0, h - 1.001)
    j, i = x.astype(np.int64), y.astype(np.int64)
    u, v = (x - j)[:, None], (y - i)[:, None]
    upper = image[i, j] * (1 - u) + image[i, j + 1] * u
    lower = image[i + 1, j] * (1 - u) + image[i + 1, j + 1] * u
    return np.asarray(upper * (1 - v) + lower * v)
