"""The INS as the path about which the fused trajectory is linearised.

Attitudes are the INS's own, turned into wcs; the way is the integral of its velocity. The states of the
smoother are what is missing from both, so that motion faster than the observations stays in.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, Slerp

from thalweg.core.frames import LocalFrame, attitude_axes, rotation_enu_body
from thalweg.core.types import ArrayB, ArrayF
from thalweg.navigation.ins_gnss.interpolation import JITTER_S

_RATE_SPAN_S = 0.05
"""Angular velocities are differences over this time to both sides: single attitudes jitter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampled:
    """The reference at n times.

    ``R_wcs_ics`` (n, 3, 3), ``axes`` (n, 3, 3) of roll, pitch, heading in wcs, ``sigma_rad`` (n, 3) of the
    three, ``way_m`` (n, 3), ``velocity_mps`` (n, 3) of the way, ``rate_radps`` (n, 3) in wcs.
    """

    R_wcs_ics: ArrayF
    axes: ArrayF
    sigma_rad: ArrayF
    way_m: ArrayF
    velocity_mps: ArrayF
    rate_radps: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """Attitudes and way of the INS over time.

    Parameters
    ----------
    t_gps_s : (m,) times of the INS states.
    R_wcs_ics : (m, 3, 3) their attitudes.
    sigma_rad : (m, 3) of roll, pitch, heading.
    velocity_mps, way_m : (m, 3) velocity in wcs (bridged linearly where there is none) and its integral.
    hole : (m - 1,) the interval is longer than attitudes may be interpolated over.
    blind : (m - 1,) the INS gives no velocity in the interval.
    """

    t_gps_s: ArrayF
    R_wcs_ics: ArrayF
    sigma_rad: ArrayF
    velocity_mps: ArrayF
    way_m: ArrayF
    hole: ArrayB
    blind: ArrayB

    def inside(self, t_gps_s: ArrayF) -> ArrayB:
        """Whether the INS gives an attitude at times (n,): within its span and in no hole."""
        t = np.asarray(t_gps_s, dtype=np.float64)
        with np.errstate(invalid="ignore"):
            within = (t >= self.t_gps_s[0]) & (t <= self.t_gps_s[-1])
        left = np.clip(np.searchsorted(self.t_gps_s, t, side="right") - 1, 0, len(self.hole) - 1)
        return np.asarray(within & (~self.hole[left] | (t == self.t_gps_s[left])))

    def at(self, t_gps_s: ArrayF) -> Sampled:
        """The reference at times within its span."""
        t = np.clip(t_gps_s, self.t_gps_s[0], self.t_gps_s[-1])
        since = self.t_gps_s - self.t_gps_s[0]
        turn = Slerp(since, Rotation.from_matrix(self.R_wcs_ics))
        s = t - self.t_gps_s[0]
        R = turn(s)
        before, after = np.maximum(s - _RATE_SPAN_S, 0.0), np.minimum(s + _RATE_SPAN_S, since[-1])
        rate = (turn(after) * turn(before).inv()).as_rotvec() / (after - before)[:, None]
        left = np.clip(np.searchsorted(since, s, side="right") - 1, 0, len(since) - 2)
        step, u = (since[left + 1] - since[left])[:, None], (s - since[left])[:, None]
        slope = (self.velocity_mps[left + 1] - self.velocity_mps[left]) / step
        matrix = R.as_matrix()
        return Sampled(
            R_wcs_ics=matrix,
            axes=attitude_axes(matrix),
            sigma_rad=self.sigma_rad[left] * (1 - u / step) + self.sigma_rad[left + 1] * (u / step),
            way_m=self.way_m[left] + self.velocity_mps[left] * u + slope * u**2 / 2,
            velocity_mps=self.velocity_mps[left] + slope * u,
            rate_radps=rate,
        )

    def blind_spans(self) -> ArrayF:
        """Begin and end (k, 2) of the stretches without velocity."""
        edge = np.diff(np.concatenate([[0], self.blind.astype(np.int64), [0]]))
        return np.column_stack([self.t_gps_s[:-1][edge[:-1] == 1], self.t_gps_s[1:][edge[1:] == -1]])


def make_reference(
    states: pd.DataFrame,
    frame: LocalFrame,
    *,
    sigma_attitude_rad: ArrayLike,
    max_attitude_gap_s: float,
    use_velocity: bool,
    near_t_s: ArrayF,
    near_wcs_m: ArrayF,
) -> Reference:
    """The reference of usable INS states.

    Parameters
    ----------
    states : as `thalweg.navigation.ins_gnss.selection.usable_states` leaves them.
    frame : the world frame.
    sigma_attitude_rad : (3,) roll, pitch, heading; stands in where the log states none.
    max_attitude_gap_s : longest hole between states that is interpolated.
    use_velocity : whether the INS's velocity carries the way.
    near_t_s, near_wcs_m : (k,), (k, 3) where the boat is to a few metres: the level of the INS's angles.
    """
    t = states["t_gps_s"].to_numpy()
    place = np.stack([np.interp(t, near_t_s, axis) for axis in near_wcs_m.T], axis=1)
    lat_deg, lon_deg, _ = frame.to_geodetic(place)
    R_wcs_enu = frame.R_wcs_enu(lat_deg, lon_deg)
    angles = (states[name].to_numpy() for name in ("roll_rad", "pitch_rad", "heading_rad"))
    R = np.asarray(R_wcs_enu @ rotation_enu_body(*angles))
    stated = states[["sigma_roll_rad", "sigma_pitch_rad", "sigma_heading_rad"]].to_numpy()
    known_sigma = np.isfinite(stated) & (stated > 0)
    sigma = np.where(known_sigma, stated, np.asarray(sigma_attitude_rad, dtype=np.float64))
    enu = states[["v_east_mps", "v_north_mps", "v_down_mps"]].to_numpy() * [1.0, 1.0, -1.0]
    known = np.isfinite(enu).all(axis=1)
    hole = np.diff(t) > max_attitude_gap_s + JITTER_S
    velocity = np.zeros((len(t), 3))
    if use_velocity and known.sum() >= 2:
        wcs = np.einsum("nij,nj->ni", R_wcs_enu[known], enu[known])
        velocity = np.stack([np.interp(t, t[known], axis) for axis in wcs.T], axis=1)
        blind = hole | ~known[1:] | ~known[:-1]
    else:
        blind = np.ones(len(t) - 1, dtype=np.bool_)
    step = (velocity[1:] + velocity[:-1]) / 2 * np.diff(t)[:, None]
    return Reference(
        t_gps_s=t,
        R_wcs_ics=R,
        sigma_rad=sigma,
        velocity_mps=velocity,
        way_m=np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)]),
        hole=hole,
        blind=blind,
    )
