"""The magnetometer of the INS: the Earth's field, the boat's own fields, and the heading error they cause.

T 2.2.1 names the magnetometer among the INS's sensors; the abstracts of T and P2 name errors of the
orientation from the electromagnetic fields of the boat's rotors. A lead with the current I and its return at
a distance d make a field of about ``mu_0 I d / (2 pi r^2)`` at the distance r (Biot-Savart): 4.4 mG for 10 A,
2 cm and 0.3 m, against 200 mG of the Earth's horizontal field, so 1.3 degrees.
"""

from typing import Final

import numpy as np
from scipy.signal import lfilter

from thalweg.core.types import ArrayF
from thalweg.settings.twin.navigation import TwinIns

EARTH_NED_MG: Final[ArrayF] = np.array([199.0, 15.0, 453.0])
"""Earth's field in Saxony in 2021 (IGRF): north, east, down; declination 4.3, inclination 66.2 degrees."""


def boat_field_mg(ins: TwinIns, thrust: ArrayF) -> ArrayF:
    """Field (n, 3) of the boat itself at the INS, body frame: hard iron and the currents of the motors.

    Parameters
    ----------
    ins : section ``twin.ins``.
    thrust : (n, 2) thrust of the left and the right motor as a share of the full one; the current is taken as
        proportional to it.
    """
    return np.asarray(np.asarray(thrust) @ np.asarray(ins.motor_field_mg) + np.asarray(ins.hard_iron_mg))


def levelled_error_rad(
    roll_rad: ArrayF, pitch_rad: ArrayF, heading_rad: ArrayF, boat_field_ics_mg: ArrayF
) -> ArrayF:
    """Heading error (n,) of a magnetic compass that levels its field with the true roll and pitch.

    The compass takes the horizontal field for magnetic north, ``atan2(-h_right, h_forward)``; its error is
    the angle between the disturbed and the undisturbed horizontal field. In the level frame that looks along
    the heading the undisturbed field is ``H (cos(heading - declination), -sin(heading - declination))``.
    """
    north, east, _ = EARTH_NED_MG
    forward = north * np.cos(heading_rad) + east * np.sin(heading_rad)
    right = east * np.cos(heading_rad) - north * np.sin(heading_rad)
    x, y, z = np.asarray(boat_field_ics_mg, dtype=np.float64).T
    sr, cr = np.sin(roll_rad), np.cos(roll_rad)
    # R_y(pitch) R_x(roll) of the body vector, its horizontal part.
    turned = sr * y + cr * z
    b_forward = np.cos(pitch_rad) * x + np.sin(pitch_rad) * turned
    b_right = cr * y - sr * z
    disturbed = np.arctan2(-(right + b_right), forward + b_forward)
    error = disturbed - np.arctan2(-right, forward)
    return np.asarray(np.mod(error + np.pi, 2 * np.pi) - np.pi)


def low_pass(values: ArrayF, step_s: float, time_s: float) -> ArrayF:
    """First-order low pass (n,), settled on the first value: ``y' = (x - y) / time``, exact for steps."""
    if not len(values):
        return np.asarray(values)
    a = float(np.exp(-step_s / time_s))
    out, _ = lfilter([1.0 - a], [1.0, -a], values, zi=[a * float(values[0])])
    return np.asarray(out)


def magnetic_heading_error_rad(
    ins: TwinIns, roll_rad: ArrayF, pitch_rad: ArrayF, heading_rad: ArrayF, boat_field_ics_mg: ArrayF
) -> ArrayF:
    """Heading error (n,) of the INS at its epochs.

    Gyroscopes carry the heading over short times and the magnetometer draws it with its time constant: the
    error of the filter's heading is the low-passed error of the compass, times ``magnetic_weight``.
    """
    compass = levelled_error_rad(roll_rad, pitch_rad, heading_rad, boat_field_ics_mg)
    return ins.magnetic_weight * low_pass(np.unwrap(compass), 1.0 / ins.rate_hz, ins.magnetic_time_s)
