"""Where the sensor stands at each image: on a rail above an object, or under a boat.

A pose is ``x_obj = R_obj_lcs x_lcs + shift_obj_mm``; the frame of the object does not move.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from thalweg.core.frames import rotation_opk
from thalweg.core.types import ArrayF
from thalweg_lab.base.random import gauss_markov, generator
from thalweg_lab.tank.surfaces import Posed, Surface


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorPath:
    """True poses: ``R_obj_lcs`` (n, 3, 3), ``shift_obj_mm`` (n, 3), ``t_s`` (n,) from the first image."""

    R_obj_lcs: ArrayF
    shift_obj_mm: ArrayF
    t_s: ArrayF

    def __len__(self) -> int:
        return len(self.t_s)

    def posed(self, k: int, surface: Surface) -> Posed:
        """The surface as it lies under the sensor at image k."""
        R = self.R_obj_lcs[k].T
        return Posed(surface=surface, R_lcs_obj=R, shift_lcs_mm=-R @ self.shift_obj_mm[k])

    def quaternions(self) -> ArrayF:
        """(n, 4) of R_obj_lcs, scalar last."""
        return np.asarray(Rotation.from_matrix(self.R_obj_lcs).as_quat())


def rail(
    seed: int,
    *,
    lines: int,
    step_mm: float,
    middle_lcs_mm: ArrayF,
    middle_obj_mm: ArrayF,
    name: str,
    wobble_mm: float = 0.3,
    wobble_deg: float = 0.15,
    step_spread: float = 0.1,
    interval_s: float = 2.0,
    kappa_rad: float = 0.0,
) -> SensorPath:
    """A hand-driven rail across the line, as in P4 7.3: steps of 2 to 5 mm, the sensor stands at each image.

    Parameters
    ----------
    seed : of the campaign; the streams are ``light sheet <name> ...``.
    lines, step_mm : number of images and mean step along y of the object.
    middle_lcs_mm, middle_obj_mm : (3,) point of the sensor's frame that meets this point of the object in the
        middle of the way.
    name : of the run, for its random streams.
    wobble_mm, wobble_deg : standard deviation of each component of the pose about the straight way.
    step_spread : standard deviation of a step as a share of it.
    interval_s : time from image to image.
    kappa_rad : direction of the laser line in lcs, from its x axis: x of the object lies along it.
    """
    steps = 1.0 + step_spread * generator(seed, f"light sheet {name} steps").standard_normal(lines)
    wobble = generator(seed, f"light sheet {name} wobble").standard_normal((lines, 6))
    way = np.cumsum(steps) * step_mm
    way -= way.mean()
    turn = Rotation.from_rotvec(np.deg2rad(wobble_deg) * wobble[:, 3:]).as_matrix()
    R = turn @ rotation_opk(0.0, 0.0, -kappa_rad)
    at = middle_obj_mm + np.stack([np.zeros(lines), way, np.zeros(lines)], axis=1) + wobble_mm * wobble[:, :3]
    return SensorPath(
        R_obj_lcs=R,
        shift_obj_mm=at - np.einsum("nij,j->ni", R, middle_lcs_mm),
        t_s=np.asarray(interval_s * np.arange(lines, dtype=np.float64)),
    )


def drift(
    seed: int,
    *,
    lines: int,
    rate_hz: float,
    speed_mmps: float,
    middle_lcs_mm: ArrayF,
    start_obj_mm: ArrayF,
    name: str,
    roll_deg: float = 0.6,
    pitch_deg: float = 0.4,
    heave_mm: float = 4.0,
    period_s: float = 1.8,
    kappa_rad: float = 0.0,
) -> SensorPath:
    """A slow boat along y of the object, rolling, pitching and heaving.

    Parameters are those of `rail`; ``roll_deg``, ``pitch_deg``, ``heave_mm`` are amplitudes of a swell of
    ``period_s``; heading and course wander by a Gauss-Markov process of 0.5 degrees and 2 mm.
    """
    t = np.arange(lines) / rate_hz
    swell = generator(seed, f"light sheet {name} swell")
    phases = swell.uniform(0, 2 * np.pi, 3)
    periods_s = period_s * np.array([1.0, 1.37, 0.81])
    wave = np.sin(2 * np.pi * t / periods_s[:, None] + phases[:, None])
    course = generator(seed, f"light sheet {name} course")
    heading = gauss_markov(course, lines, 1 / rate_hz, float(np.deg2rad(0.5)), 4.0)
    aside = gauss_markov(course, lines, 1 / rate_hz, 2.0, 6.0)
    pitch, roll = np.deg2rad(pitch_deg) * wave[0], np.deg2rad(roll_deg) * wave[1]
    turns = [rotation_opk(float(p), float(r), float(h)) for p, r, h in zip(pitch, roll, heading, strict=True)]
    R = np.stack(turns) @ rotation_opk(0.0, 0.0, -kappa_rad)
    at = start_obj_mm + np.stack([aside, speed_mmps * t, heave_mm * wave[2]], axis=1)
    return SensorPath(R_obj_lcs=R, shift_obj_mm=at - np.einsum("nij,j->ni", R, middle_lcs_mm), t_s=t)
