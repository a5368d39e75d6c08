"""What else pictures of the sensor could be, where they contradict what is stated of them.

Another medium in front of the window, or pictures that were turned or mirrored: each reading comes with the
sensor and the line points as they would be then, and with what a user should do if it fits.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import pandas as pd

from thalweg.lightsheet.optics.sensor import Sensor

WATER: Final = 1.335
"""Fresh water at 520 nm, 20 degrees: 1.336 (IAPWS); near enough to tell water from air."""
_WET: Final = 1.2
_COLUMNS: Final = ("x_px", "y_px", "angle_rad")


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """Another reading of the same pictures.

    ``cure`` a sentence without its full stop; ``sensor`` and ``points`` (a table of line points) that belong
    to it, or the same objects that were given where they do not differ.
    """

    cure: str
    sensor: Sensor
    points: pd.DataFrame


def other_readings(sensor: Sensor, points: pd.DataFrame) -> Iterator[Reading]:
    """The other medium, then the picture turned by 180 degrees and mirrored both ways.

    Parameters
    ----------
    sensor : as stated.
    points : line points with x_px, y_px, angle_rad; without these columns only the medium is read otherwise.
    """
    n = sensor.window.n_water
    if n < _WET:
        yield Reading(
            cure=f"The picture fits with n_water = {WATER}: state the index of water, not {n:g} of air",
            sensor=sensor.with_water(WATER), points=points,
        )  # fmt: skip
    else:
        yield Reading(
            cure=f"The picture fits with the index of air, 1.0, instead of n_water = {n:g}: was the housing "
            "dry, the object not under water?",
            sensor=sensor.with_water(sensor.window.n_air), points=points,
        )  # fmt: skip
    if any(name not in points.columns for name in _COLUMNS):
        return
    for cure, x_sign, y_sign in (
        (
            "The picture fits if it is turned by 180 degrees: camera mounted upside down, or picture rotated",
            -1,
            -1,
        ),
        ("The picture fits if it is mirrored left to right: switch the mirroring of the camera off", -1, 1),
        ("The picture fits if it is mirrored top to bottom: switch the mirroring of the camera off", 1, -1),
    ):
        yield Reading(cure=cure, sensor=sensor, points=_turned(points, sensor, x_sign, y_sign))


def _turned(points: pd.DataFrame, sensor: Sensor, x_sign: int, y_sign: int) -> pd.DataFrame:
    """Line points of the picture turned or mirrored about its centre."""
    moved = points.copy()
    width, height = sensor.camera.size_px
    if x_sign < 0:
        moved["x_px"] = width - points["x_px"]
    if y_sign < 0:
        moved["y_px"] = height - points["y_px"]
    moved["angle_rad"] = points["angle_rad"] * x_sign * y_sign
    return moved
