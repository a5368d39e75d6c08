"""A light-sheet sensor as it truly is, and as its calibration knows it: for studies without images.

The sensor is that of P4, built with the tolerances of its making. The processing knows the pose of the camera
over the window from the calibration of the basin (`thalweg.lightsheet.lens.camera_marks`) on
simulated marks. The bundle in air that gives the lens takes a minute, so that its result is drawn here: the
true lens with errors of the published sigmas (P4 6.2), which are its covariance. Glass and water are drawn
likewise, and the laser is known from the drawing. The frame of the calibrated sensor is turned a little about
the window's normal against the true one, because nothing can tell the heading.
"""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Literal

import numpy as np

from thalweg.calibration.field.points import read_points
from thalweg.core.frames import rotation_z
from thalweg.core.types import ArrayF
from thalweg.lightsheet.lens.camera_marks import orient_camera, read_camera_marks
from thalweg.lightsheet.optics.sensor import Sensor
from thalweg.lightsheet.optics.sensor_files import read_sensor
from thalweg.settings.twin.light_sheet import TwinLightSheet
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.tank.series import WINDOW_MARKERS, Basin, record_camera_station

Size = Literal["tiny", "demo", "full"]

_NAMES: Final = ("design.yaml", "marks.csv", "points.csv")


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorPair:
    """A sensor and what its calibration makes of it.

    Parameters
    ----------
    true : what observations are made with.
    known : what they are processed with: camera, window and water with their covariance.
    R_true_known : (3, 3) from the frame of the sensor as calibrated to the true one, a turn about the normal
        of the window; both have their origin below the camera.
    """

    true: Sensor
    known: Sensor
    R_true_known: ArrayF


def calibrated_sensor(seed: int, *, size: Size = "full") -> SensorPair:
    """A sensor and its calibration.

    Parameters
    ----------
    seed : of its making and of all errors of the calibration, as of a campaign in the basin.
    size : of the images, see `thalweg_lab.tank.truth_sensor.SIZES`.
    """
    twin = TwinConfig(light_sheet=TwinLightSheet(size=size))
    with TemporaryDirectory() as folder:
        design, marks, points = (Path(folder) / name for name in _NAMES)
        record_camera_station(twin, seed, out_sensor=design, out_marks=marks, out_points=points)
        nominal = read_sensor(design)
        found = orient_camera(nominal, read_camera_marks(marks), read_points(points), WINDOW_MARKERS)
    true, known = Basin.of(twin, seed).true, found.applied(nominal)
    M = true.R_lcs_ccs @ known.R_lcs_ccs.T
    turn = float(np.arctan2(M[1, 0] - M[0, 1], M[0, 0] + M[1, 1]))
    return SensorPair(true=true, known=known, R_true_known=rotation_z(turn))
