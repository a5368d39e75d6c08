"""How a small boat sways: roll, pitch, heave and yawing as sums of sinusoids with exact derivatives.

Roll, pitch and heave answer to the same waves: a wave that lifts the boat tilts it a quarter of a period
earlier or later, about the axis that its direction gives. So the three are correlated in time, as they are in
the log of an INS, and none of them is white. A share of the roll swings at the boat's own period.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.types import ArrayF
from thalweg.settings.twin.scene import TwinBoat

_PERIODS_S: Final = np.array([1.15, 1.4, 1.7, 2.1, 2.6, 3.3])
"""Encounter periods of the wind waves of a river and the wakes on it; round values."""

_WEIGHTS: Final = np.array([0.10, 0.17, 0.24, 0.22, 0.16, 0.11])
_OWN_ROLL_S: Final = 1.5
_OWN_ROLL_SHARE: Final = 0.3
_YAW_PERIODS_S: Final = np.array([4.3, 2.3, 9.9])
_YAW_WEIGHTS: Final = np.array([0.6, 0.25, 0.15])


@dataclass(frozen=True, slots=True)
class Sway:
    """Sum of sinusoids ``amplitude sin(rate t + phase)`` and its derivatives.

    Parameters
    ----------
    amplitude : (k,) in the unit of the motion.
    rate : (k,) rad/s.
    phase : (k,) rad.
    """

    amplitude: ArrayF
    rate: ArrayF
    phase: ArrayF

    def __call__(self, t_s: ArrayF, derivative: int = 0) -> ArrayF:
        """Value, or derivative of the given order, at times in seconds."""
        total = np.zeros(np.shape(t_s))
        for a, w, p in zip(self.amplitude, self.rate, self.phase, strict=True):
            total = total + a * w**derivative * np.sin(w * t_s + p + derivative * np.pi / 2)
        return total


def draw_sways(rng: np.random.Generator, boat: TwinBoat) -> dict[str, Sway]:
    """Roll, pitch, yaw (rad) and heave (m) of a boat.

    The amplitudes of each motion add up to the configured one, so that it is never exceeded. Each motion's
    numbers do not depend on the amplitudes of the others.
    """
    k = len(_PERIODS_S)
    rate = 2 * np.pi / (_PERIODS_S * rng.uniform(0.92, 1.08, k))
    phase = rng.uniform(0, 2 * np.pi, k)
    # Waves run along the reach or across it with the wind: they come from all sides, rarely dead ahead.
    side = rng.uniform(-np.pi, np.pi, k)
    roll = _WEIGHTS * np.sin(side)
    pitch = _WEIGHTS * np.cos(side)
    own = np.array([2 * np.pi / (_OWN_ROLL_S * rng.uniform(0.9, 1.1))])
    own_phase = rng.uniform(0, 2 * np.pi, 1)
    yaw_rate = 2 * np.pi / (_YAW_PERIODS_S * rng.uniform(0.9, 1.1, 3))
    yaw_phase = rng.uniform(0, 2 * np.pi, 3)
    degree = np.pi / 180
    roll = roll / np.sum(np.abs(roll)) * (1.0 - _OWN_ROLL_SHARE)
    pitch = pitch / np.sum(np.abs(pitch))
    return {
        "roll": Sway(
            boat.roll_deg * degree * np.concatenate([roll, [_OWN_ROLL_SHARE]]),
            np.concatenate([rate, own]),
            np.concatenate([phase + np.pi / 2, own_phase]),
        ),
        "pitch": Sway(boat.pitch_deg * degree * pitch, rate, phase + np.pi / 2),
        "heave": Sway(boat.heave_m * _WEIGHTS / np.sum(_WEIGHTS), rate, phase),
        "yaw": Sway(boat.yaw_deg * degree * _YAW_WEIGHTS, yaw_rate, yaw_phase),
    }
