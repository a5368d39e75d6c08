"""Does the motion of a run tell the time? Which motion is missing if it does not.

A shift in time moves the antenna, seen from the camera, by the velocity in the camera's frame. While that
velocity is constant, a shift in time is the same as another place of the antenna on the boat: nobody can
tell them apart. So a boat that stands, drives straight at constant speed, or drives a circle at constant
speed with its bow ahead, does not determine the offset; one that speeds up, slows down, or swings from side
to side does. For attitudes the same holds for the angular velocity in the frame of the boat.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from thalweg.core.adjustment.solve import UnobservableError
from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayF

_SIGNIFICANT: Final = 4.0
"""Sigmas by which the velocity must change more than its noise."""
_STANDING_MPS: Final = 0.05
_TURNS_DEG: Final = 30.0
"""Less change of the attitude is no turn: a boat on a straight course yaws by some degrees."""
_STEADY: Final = 0.15
"""Speeds that scatter by less than this share of their mean are constant, as far as a helmsman can tell."""


class MissingMotionError(UnobservableError):
    """A run does not determine a time offset; ``missing`` names the motion it lacks."""

    def __init__(
        self, missing: tuple[str, ...], parameters: tuple[str, ...], found: str, sigma_s: float
    ) -> None:
        self.missing, self.parameters, self.defects = missing, parameters, 1
        GeometryError.__init__(
            self,
            f"the run does not determine the clock's offset against the antenna's place on the boat: {found}"
            + (f"; its sigma would be {sigma_s * 1e3:.0f} ms" if np.isfinite(sigma_s) else ""),
            expected=" and ".join(missing),
            cure=f"Record again with {' and '.join(missing)}: stop, speed up, reverse, swing from side to "
            "side; or give the antenna's lever arm in the frame of the camera",
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RunMotion:
    """How the boat moved, at the images that were used.

    ``speed_mps`` mean, ``speed_change_mps`` standard deviation of the speed without its noise,
    ``turned_deg`` largest turn between two images, ``turn_rate_degps`` root mean square, ``change_mps`` root
    mean square change of the velocity in the frame of the camera without its noise, ``change_degps`` the
    same of the angular velocity.
    """

    speed_mps: float
    speed_change_mps: float
    turned_deg: float
    turn_rate_degps: float
    change_mps: float
    change_degps: float

    @property
    def missing(self) -> tuple[str, ...]:
        """Motions that were too weak."""
        if self.speed_mps < _STANDING_MPS and self.turned_deg < _TURNS_DEG:
            return ("movement", "turns", "changes of speed")
        out = [] if self.turned_deg >= _TURNS_DEG else ["turns"]
        if self.speed_change_mps < _STEADY * max(self.speed_mps, _STANDING_MPS):
            out.append("changes of speed")
        return tuple(out) if out else ("a longer run", "stronger changes of speed")

    @property
    def words(self) -> str:
        """The motion in a sentence."""
        if self.speed_mps < _STANDING_MPS and self.turned_deg < _TURNS_DEG:
            return f"the boat stands ({self.speed_mps:.2f} m/s)"
        course = (
            f"the course is straight (turns of {self.turned_deg:.0f} degrees)"
            if self.turned_deg < _TURNS_DEG
            else f"it turns by {self.turned_deg:.0f} degrees"
        )
        return (
            f"{course}, the speed is {self.speed_mps:.2f} m/s and changes by {self.speed_change_mps:.2f} m/s,"
            f" and the velocity seen from the boat changes by {self.change_mps:.3f} m/s"
        )


def run_motion(
    velocity_wcs_mps: ArrayF,
    R_wcs_ccs: ArrayF,
    noise_m2ps2: ArrayF,
    *,
    rate_wcs_radps: ArrayF | None = None,
) -> RunMotion:
    """Motion of a run as far as it tells the time.

    Parameters
    ----------
    velocity_wcs_mps : (n, 3) of the antenna at the images.
    R_wcs_ccs : (n, 3, 3) attitude of the camera.
    noise_m2ps2 : (n,) variance of the velocity, summed over the axes.
    rate_wcs_radps : (n, 3) angular velocity, if attitudes are compared.
    """
    n = len(velocity_wcs_mps)
    seen = np.einsum("nji,nj->ni", R_wcs_ccs, velocity_wcs_mps)
    square = float(np.square(seen - seen.mean(axis=0)).sum())
    noise = float(noise_m2ps2.sum())
    # the sum of squares of noise in three axes scatters by its root of 2 / (3 n)
    excess = square - noise
    excess = excess if excess > _SIGNIFICANT * noise * np.sqrt(2.0 / (3.0 * n)) else 0.0
    speed = np.linalg.norm(velocity_wcs_mps, axis=1)
    spread = max(float(np.var(speed)) - noise / (3.0 * n), 0.0)
    turned = (Rotation.from_matrix(R_wcs_ccs) * Rotation.from_matrix(R_wcs_ccs[0]).inv()).magnitude()
    rate = change_rate = 0.0
    if rate_wcs_radps is not None:
        body = np.einsum("nji,nj->ni", R_wcs_ccs, rate_wcs_radps)
        rate = float(np.sqrt(np.square(body).sum(axis=1).mean()))
        change_rate = float(np.sqrt(np.square(body - body.mean(axis=0)).sum(axis=1).mean()))
    mean_velocity = float(np.sqrt(max(float((speed**2).mean()) - noise / n, 0.0)))
    return RunMotion(
        speed_mps=mean_velocity if mean_velocity < _STANDING_MPS else float(speed.mean()),
        speed_change_mps=float(np.sqrt(spread)),
        turned_deg=float(np.rad2deg(turned.max())),
        turn_rate_degps=float(np.rad2deg(rate)),
        change_mps=float(np.sqrt(excess / n)),
        change_degps=float(np.rad2deg(change_rate)),
    )
