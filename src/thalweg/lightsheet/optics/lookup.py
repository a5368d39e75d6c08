"""Look-up tables: the points of all pixels of a sensor, for programs that need them in real time (P4 5)."""

from pathlib import Path
from typing import Final

import numpy as np

from thalweg.lightsheet.optics.intersection import intersect
from thalweg.lightsheet.optics.sensor import Sensor

STEP_PX: Final = 16
"""Between nodes: cubic polynomials leave 6e-6 mm; the error grows with the fourth power."""
EXACT: Final = 255
"""Mark of cells whose pixels have to be solved strictly."""


def write_look_up_table(path: Path, sensor: Sensor) -> None:
    """Tabulate a sensor as NPZ with the arrays ``values``, ``cells`` and ``step_px``.

    ``values`` (rows, columns, 4): x, y, z in lcs millimetres and the fan angle of nodes; node (i, j) is the
    pixel ``(j - 1, i - 1) * step_px``. Between them points follow from the cubic polynomials through 4 x 4
    nodes. ``cells`` (rows - 1, columns - 1): the `Status` of all pixels of a cell, or `EXACT` where its 4 x 4
    nodes do not agree, near the end of the fan or the window.
    """
    # one node beyond the picture on the upper left, two on the lower right: patches of 4 x 4
    columns, rows = (-(-side // STEP_PX) + 4 for side in sensor.camera.size_px)
    x, y = np.meshgrid((np.arange(columns) - 1.0) * STEP_PX, (np.arange(rows) - 1.0) * STEP_PX)
    found = intersect(sensor, np.stack([x.ravel(), y.ravel()], axis=1))
    values = np.concatenate([found.xyz_lcs_mm, found.fan_angle_rad[:, None]], axis=1)
    status = found.status.reshape(rows, columns)
    cells = np.full((rows - 1, columns - 1), EXACT, dtype=np.uint8)
    patch = np.lib.stride_tricks.sliding_window_view(status, (4, 4)).reshape(rows - 3, columns - 3, 16)
    same = (patch == patch[:, :, :1]).all(axis=2)
    cells[1 : rows - 2, 1 : columns - 2] = np.where(same, patch[:, :, 0], EXACT)
    with path.open("wb") as file:
        np.savez_compressed(
            file, values=values.reshape(rows, columns, 4), cells=cells, step_px=np.array(STEP_PX)
        )
