"""Look-up tables: the points of all pixels of a sensor, ready for live use (P4 5).

The strict solution is tabulated at nodes every 16 pixels and interpolated by cubic polynomials through 4 x 4
nodes. Where such a patch is not all sheet, near the end of the fan or the window, the pixel is solved
strictly, so that table and solver have the same mask.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import ArrayF, ArrayU8, GeometryError, njit, prange
from thalweg.lightsheet.optics.intersection import SheetPoints, intersect
from thalweg.lightsheet.optics.sensor import Sensor

STEP_PX: Final = 16
EXACT: Final = 255
"""Mark of cells whose pixels are solved strictly."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LookUpTable:
    """Points at nodes of the picture.

    ``values`` (rows, columns, 4) x, y, z in lcs millimetres and the fan angle of nodes; node (i, j) is the
    pixel ``(j - 1, i - 1) * step_px``. ``cells`` (rows - 1, columns - 1): the `Status` of all pixels of a
    cell, or `EXACT`.
    """

    sensor: Sensor
    step_px: int
    values: ArrayF
    cells: ArrayU8

    def write(self, path: Path) -> None:
        """Write nodes, cells and step (npz), for programs that need points in real time."""
        with path.open("wb") as file:
            np.savez_compressed(file, values=self.values, cells=self.cells, step_px=np.array(self.step_px))

    def points(self, xy_px: ArrayLike) -> SheetPoints:
        """Points of pixels (n, 2) inside the picture.

        Raises
        ------
        GeometryError : a pixel outside the picture of the sensor.
        """
        xy = np.ascontiguousarray(np.atleast_2d(np.asarray(xy_px, dtype=np.float64)))
        inside = self.sensor.camera.inside(xy)
        if not inside.all():
            x, y = xy[int(np.argmin(inside))]
            raise GeometryError(
                f"pixel ({x:g}, {y:g})",
                expected=f"pixels inside the picture of {self.sensor.camera.size_px}",
                where="look-up table",
            )
        out, status = np.empty((len(xy), 4)), np.empty(len(xy), dtype=np.uint8)
        _interpolate(xy, self.step_px, self.values, self.cells, out, status)
        strict = np.flatnonzero(status == EXACT)
        xyz, fan = out[:, :3], out[:, 3]
        if len(strict):
            found = intersect(self.sensor, xy[strict])
            xyz[strict], fan[strict], status[strict] = found.xyz_lcs_mm, found.fan_angle_rad, found.status
        return SheetPoints(
            xyz_lcs_mm=xyz, depth_mm=self.sensor.window.depth_mm(xyz), fan_angle_rad=fan, status=status
        )


def look_up_table(sensor: Sensor, step_px: int = STEP_PX) -> LookUpTable:
    """Tabulate a sensor.

    Parameters
    ----------
    sensor : any line.
    step_px : between nodes; the error grows with its fourth power.

    Raises
    ------
    GeometryError : a step below 1.
    """
    if step_px < 1:
        raise GeometryError(f"nodes every {step_px} pixels", expected="1 or more")
    width, height = sensor.camera.size_px
    # one node beyond the picture on the upper left, two on the lower right: patches of 4 x 4
    columns, rows = (-(-side // step_px) + 4 for side in (width, height))
    x, y = np.meshgrid((np.arange(columns) - 1.0) * step_px, (np.arange(rows) - 1.0) * step_px)
    found = intersect(sensor, np.stack([x.ravel(), y.ravel()], axis=1))
    values = np.concatenate([found.xyz_lcs_mm, found.fan_angle_rad[:, None]], axis=1).reshape(
        rows, columns, 4
    )
    status = found.status.reshape(rows, columns)
    cells = np.full((rows - 1, columns - 1), EXACT, dtype=np.uint8)
    patch = np.lib.stride_tricks.sliding_window_view(status, (4, 4)).reshape(rows - 3, columns - 3, 16)
    same = (patch == patch[:, :, :1]).all(axis=2)
    cells[1 : rows - 2, 1 : columns - 2] = np.where(same, patch[:, :, 0], EXACT)
    return LookUpTable(sensor=sensor, step_px=step_px, values=np.ascontiguousarray(values), cells=cells)


@njit(inline="always", cache=True, error_model="numpy")
def _weights(t: float) -> tuple[float, float, float, float]:
    """Of the nodes -1, 0, 1, 2 in the cubic polynomial through them, at t in [0, 1]."""
    a, b, c, d = t + 1.0, t, t - 1.0, t - 2.0
    return -b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def _interpolate(xy: ArrayF, step: int, values: ArrayF, cells: ArrayU8, out: ArrayF, status: ArrayU8) -> None:
    inverse = 1.0 / step
    for i in prange(len(xy)):
        px, py = xy[i, 0] * inverse + 1.0, xy[i, 1] * inverse + 1.0
        j, k = int(px), int(py)
        mark = cells[k, j]
        status[i] = mark
        if mark != 0:
            out[i, 0] = out[i, 1] = out[i, 2] = out[i, 3] = np.nan
            continue
        u0, u1, u2, u3 = _weights(px - j)
        w = _weights(py - k)
        s0 = s1 = s2 = s3 = 0.0
        for r in range(4):
            row = values[k - 1 + r]
            s0 += w[r] * (u0 * row[j - 1, 0] + u1 * row[j, 0] + u2 * row[j + 1, 0] + u3 * row[j + 2, 0])
            s1 += w[r] * (u0 * row[j - 1, 1] + u1 * row[j, 1] + u2 * row[j + 1, 1] + u3 * row[j + 2, 1])
            s2 += w[r] * (u0 * row[j - 1, 2] + u1 * row[j, 2] + u2 * row[j + 1, 2] + u3 * row[j + 2, 2])
            s3 += w[r] * (u0 * row[j - 1, 3] + u1 * row[j, 3] + u2 * row[j + 1, 3] + u3 * row[j + 2, 3])
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = s0, s1, s2, s3
