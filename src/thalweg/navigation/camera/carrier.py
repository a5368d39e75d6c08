"""The motion of the boat between images as the INS knows it, and how fast its error grows.

The carrier is a chain of poses of its own: attitudes of the INS, and a way that is the integral of its
velocity or the path of the INS/GNSS trajectory. Only its *changes* between images count: a constant error
goes into the correction that each image gives.
"""

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from thalweg.core.errors import InputError
from thalweg.core.frames import LocalFrame, attitude_axes
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.navigation.camera.settings import CloudSettings
from thalweg.navigation.ins_gnss.reference import Reference, make_reference
from thalweg.navigation.ins_gnss.selection import ATTITUDE_INITIALISED, TrajectorySummary, usable_states

_RATE_SPAN_S: Final = 0.05
"""Speeds of a trajectory are differences over this time to both sides."""

_EPOCH_S: Final = 0.1
"""Time within which the white part of the positions' errors is the same: a spline joins their epochs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Moments:
    """The carrier at n times: ``way_m`` (n, 3), ``R_wcs_ics`` (n, 3, 3), ``sigma_rad`` (n, 3) of roll, pitch,
    heading, ``rates`` (n, 6) velocity in m/s and angular velocity in rad/s, in wcs.
    """

    way_m: ArrayF
    R_wcs_ics: ArrayF
    sigma_rad: ArrayF
    rates: ArrayF


class Carrier(Protocol):
    """What `thalweg.navigation.camera.trajectory` needs of the INS.

    ``t_gps_s`` (m,) its nodes; ``broken`` (m - 1,) intervals that nothing may be carried across; ``notes``
    what was left out, for people.
    """

    t_gps_s: ArrayF
    broken: ArrayB
    notes: list[str]

    def at(self, t_gps_s: ArrayF) -> Moments:
        """The carrier at times within its span."""

    def way_variance_m2(self, dt_s: ArrayF, share: ArrayF, gap_s: ArrayF, settings: CloudSettings) -> ArrayF:
        """Variance (n,) of the way in each component, see `bridged`; ``settings`` say how the INS errs."""


class VelocityCarrier:
    """Attitudes and the integral of the velocity of the INS.

    Parameters
    ----------
    states : table kind ``ins_state``.
    frame : the world frame.
    sigma_attitude_rad : (3,) roll, pitch, heading; stands in where the log states none.
    max_attitude_gap_s : longest hole between states that is interpolated.
    near_t_s, near_wcs_m : (k,), (k, 3) where the boat is to a few metres.

    Raises
    ------
    InputError : no usable states, or none with a velocity.
    """

    def __init__(
        self,
        states: pd.DataFrame,
        frame: LocalFrame,
        *,
        sigma_attitude_rad: ArrayLike,
        max_attitude_gap_s: float,
        near_t_s: ArrayF,
        near_wcs_m: ArrayF,
    ) -> None:
        summary = TrajectorySummary(n_states=len(states))
        usable = usable_states(states, summary, max_attitude_gap_s, ATTITUDE_INITIALISED)
        known = int(usable[["v_north_mps", "v_east_mps", "v_down_mps"]].notna().all(axis=1).sum())
        if known < 2:
            raise InputError(
                f"{known} of {len(usable)} INS states have a velocity",
                expected="a velocity in each state: it carries the boat from image to image",
                cure="Set images.cloud.motion to trajectory",
            )
        if known < len(usable):
            summary.notes.append(f"{len(usable) - known} INS states without a velocity carry nothing")
        self.reference: Reference = make_reference(
            usable, frame, sigma_attitude_rad=sigma_attitude_rad, max_attitude_gap_s=max_attitude_gap_s,
            use_velocity=True, near_t_s=near_t_s, near_wcs_m=near_wcs_m,
        )  # fmt: skip
        self.t_gps_s = self.reference.t_gps_s
        self.broken = np.asarray(self.reference.hole | self.reference.blind)
        self.notes = summary.notes

    def at(self, t_gps_s: ArrayF) -> Moments:
        """The carrier at times within its span."""
        found = self.reference.at(t_gps_s)
        return Moments(
            way_m=found.way_m, R_wcs_ics=found.R_wcs_ics, sigma_rad=found.sigma_rad,
            rates=np.hstack([found.velocity_mps, found.rate_radps]),
        )  # fmt: skip

    def way_variance_m2(self, dt_s: ArrayF, share: ArrayF, gap_s: ArrayF, settings: CloudSettings) -> ArrayF:
        """Variance (n,) of the integral of a Gauss-Markov velocity error, see `bridged`."""
        each = [
            e.velocity**2 * bridged_integral(dt_s, share, gap_s, e.velocity_time_s) for e in settings.errors
        ]
        return np.asarray(settings.sigma_velocity_mps**2 * np.mean(each, axis=0))


class TrajectoryCarrier:
    """The trajectory of INS and positions.

    Parameters
    ----------
    trajectory : with covariance.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self._trajectory = trajectory
        self.t_gps_s = trajectory.t_gps_s
        self.broken = np.asarray(~(trajectory.valid[1:] & trajectory.valid[:-1]))
        self.notes: list[str] = []
        self._sigma = trajectory.sigma_roll_pitch_heading_rad()
        sigma = trajectory.sigma_position_m[trajectory.valid]
        self._sigma_position_m = float(np.sqrt(np.median(np.square(sigma).mean(axis=1))))

    def at(self, t_gps_s: ArrayF) -> Moments:
        """The carrier at times within its span."""
        first, last = float(self.t_gps_s[0]), float(self.t_gps_s[-1])
        t = np.clip(t_gps_s, first, last)
        position, R, _ = self._trajectory.at(t)
        before, after = np.maximum(t - _RATE_SPAN_S, first), np.minimum(t + _RATE_SPAN_S, last)
        x0, R0, _ = self._trajectory.at(before)
        x1, R1, _ = self._trajectory.at(after)
        turn = Rotation.from_matrix(R1 @ np.swapaxes(R0, 1, 2)).as_rotvec()
        return Moments(
            way_m=position,
            R_wcs_ics=R,
            sigma_rad=np.stack([np.interp(t, self.t_gps_s, s) for s in self._sigma.T], axis=1),
            rates=np.hstack([x1 - x0, turn]) / (after - before)[:, None],
        )

    def way_variance_m2(self, dt_s: ArrayF, share: ArrayF, gap_s: ArrayF, settings: CloudSettings) -> ArrayF:
        """Variance (n,) of the positions' slow and white errors, see `bridged`."""
        white = bridged(dt_s, share, gap_s, _EPOCH_S)
        each = [
            (1.0 - e.position_white_share) * bridged(dt_s, share, gap_s, e.position_time_s)
            + e.position_white_share * white
            for e in settings.errors
        ]
        return np.asarray(self._sigma_position_m**2 * np.mean(each, axis=0))


def bridged(dt_s: ArrayF, share: ArrayF, gap_s: ArrayF, time_s: float) -> ArrayF:
    """Variance of what is left of a Gauss-Markov error of unit variance when images correct it.

    Between two images ``e(t) - (1 - u) e(0) - u e(T)``; ``u`` = 0 with one image only: ``e(t) - e(0)``.

    Parameters
    ----------
    dt_s : (n,) time since the image, of either sign.
    share : (n,) u, share of the next image; `gap_s` times it is ``dt_s``, or it is 0.
    gap_s : (n,) time T to the next image.
    time_s : correlation time.

    Examples
    --------
    >>> bridged(np.array([0.5, 0.5]), np.array([0.5, 0.0]), np.array([1.0, 1.0]), 20.0).round(4)
    array([0.025 , 0.0494])
    """
    u = np.asarray(share, dtype=np.float64)
    near, far = np.abs(dt_s) / time_s, np.abs(gap_s - dt_s) / time_s
    whole = gap_s / time_s
    # 1 - exp keeps its digits where the times are short
    out = 2 * (1 - u) * -np.expm1(-near) + 2 * u * -np.expm1(-far) - 2 * u * (1 - u) * -np.expm1(-whole)
    return np.asarray(np.maximum(out, 0.0))


def bridged_integral(dt_s: ArrayF, share: ArrayF, gap_s: ArrayF, time_s: float) -> ArrayF:
    """The same for the integral of such an error, in s^2: ``w(t) - u w(T)`` with ``w(0) = 0``.

    ``Cov(w(x), w(y)) = tau 2 min(x, y) - tau^2 (1 - exp(-x/tau) - exp(-y/tau) + exp(-|x - y|/tau))``.

    Examples
    --------
    >>> bridged_integral(np.array([0.5, 0.05]), np.array([0.5, 0.0]), np.array([1.0, 1.0]), 10.0).round(6)
    array([0.004014, 0.002496])
    """
    u = np.asarray(share, dtype=np.float64)
    x, y = np.abs(dt_s) / time_s, gap_s / time_s

    def spread(a: ArrayF, b: ArrayF) -> ArrayF:
        """Covariance of the integral at two times, in units of the correlation time."""
        return np.asarray(2 * np.minimum(a, b) + np.expm1(-a) + np.expm1(-b) - np.expm1(-np.abs(a - b)))

    out = spread(x, x) - 2 * u * spread(x, y) + u**2 * spread(y, y)
    return np.asarray(np.maximum(time_s**2 * out, 0.0))


def attitude_growth(
    moments: Moments, dt_s: ArrayF, share: ArrayF, gap_s: ArrayF, settings: CloudSettings
) -> ArrayF:
    """Covariance (n, 3, 3) in wcs of the attitude errors that images leave, see `bridged`."""
    each = [
        bridged(dt_s, share, gap_s, e.attitude_time_s)[:, None]
        * np.square([e.roll_pitch, e.roll_pitch, e.heading])
        for e in settings.errors
    ]
    sigma = moments.sigma_rad * np.sqrt(np.mean(each, axis=0))
    axes = np.swapaxes(attitude_axes(moments.R_wcs_ics), 1, 2) * sigma[:, None, :]
    return np.asarray(axes @ np.swapaxes(axes, 1, 2))


def stretches(carrier: Carrier) -> tuple[ArrayF, ArrayF]:
    """Begin (k,) and end (k,) of the unbroken stretches of a carrier."""
    t, broken = carrier.t_gps_s, carrier.broken
    edge = np.diff(np.concatenate([[0], (~broken).astype(np.int64), [0]]))
    return t[:-1][edge[:-1] == 1], t[1:][edge[1:] == -1]


def stretch_of(carrier: Carrier, t_gps_s: ArrayF) -> ArrayI:
    """Number (n,) of the unbroken stretch that holds a time; -1 where none does."""
    begin, end = stretches(carrier)
    if not len(begin):
        return np.full(len(t_gps_s), -1)
    k = np.searchsorted(begin, t_gps_s, side="right") - 1
    inside = (k >= 0) & (t_gps_s <= end[np.maximum(k, 0)])
    return np.where(inside, k, -1)
