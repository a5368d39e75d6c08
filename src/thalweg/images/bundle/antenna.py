"""GNSS positions at the exposures of images, as observations of the block adjustment."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from thalweg.core.frames import LocalFrame
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF
from thalweg.images.bundle.problem import Antenna

_SAME_S: Final = 1e-6
"""Times that differ by less are one."""
_OVER_S: Final = 0.5
_MOST_SIGMAS: Final = 3.5


def antenna_lever_ccs(T_ics_ccs: Rigid, lever_ics_m: ArrayLike) -> ArrayF:
    """(3,) antenna in the frame of the camera, from its place in the frame of the boat."""
    away = np.asarray(lever_ics_m, dtype=np.float64) - T_ics_ccs.shift_m
    return np.asarray(T_ics_ccs.R.T @ away)


def antenna_at_images(
    positions: pd.DataFrame,
    frame: LocalFrame,
    t_image_s: ArrayF,
    sigma_t_s: ArrayF,
    *,
    sigma_clock_s: float = 0.0,
    lever_ccs_m: ArrayF,
    sigma_lever_m: ArrayF,
    accept_fixes: Sequence[str],
    max_gap_s: float,
    correlation_time_s: float = 0.0,
    shift: bool = False,
    drift: bool = False,
) -> tuple[Antenna | None, dict[str, Any]]:
    """Positions interpolated to the exposures; None if no image has one.

    An error of the time of an exposure moves the position along the velocity of the antenna: that of a single
    image is part of its covariance, what all images share is an unknown.

    Parameters
    ----------
    positions : table kind ``gnss_position``.
    t_image_s, sigma_t_s : (i,) GPS times of the images of the block and their sigmas; NaN where unknown.
    sigma_clock_s : part of these sigmas that all images share, because the camera's clock is off.

    Returns
    -------
    antenna : observations.
    counts : images with a position, and those without by reason.
    """
    good = positions["fix"].isin(list(accept_fixes)) & positions["t_gps_s"].notna()
    track = positions[good].drop_duplicates("t_gps_s").sort_values("t_gps_s")
    counts = {"images with a position": 0, "images without time": int(np.isnan(t_image_s).sum())}
    t = track["t_gps_s"].to_numpy(np.float64)
    if len(t) < 2:
        return None, {**counts, "images without a position": int(np.isfinite(t_image_s).sum())}
    place = frame.from_geodetic(track["lat_deg"], track["lon_deg"], track["h_ell_m"])
    sigma = track[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].to_numpy(np.float64)
    at = np.clip(np.searchsorted(t, np.nan_to_num(t_image_s, nan=t[0])), 1, len(t) - 1)
    step = t[at] - t[at - 1]
    u = (t_image_s - t[at - 1]) / step
    with np.errstate(invalid="ignore"):
        before_s, after_s = u * step, (1 - u) * step
        reached = (np.minimum(before_s, after_s) >= -_SAME_S) & np.isfinite(u)
        # an exposure at a position needs no second one
        inside = np.flatnonzero(reached & ((step <= max_gap_s) | (np.minimum(before_s, after_s) <= _SAME_S)))
    u = np.clip(u, 0.0, 1.0)
    counts |= {
        "images with a position": len(inside),
        "images without a position": int(np.isfinite(t_image_s).sum()) - len(inside),
    }
    if not len(inside):
        return None, counts
    before, after, v = at[inside] - 1, at[inside], u[inside][:, None]
    single = np.clip(np.square(np.nan_to_num(sigma_t_s[inside])) - sigma_clock_s**2, 0.0, None)
    antenna = Antenna(
        image=inside.astype(np.int64),
        t_s=t_image_s[inside],
        position_wcs_m=place[before] * (1 - v) + place[after] * v,
        sigma_m=np.maximum(sigma[before], sigma[after]),
        velocity_wcs_m_s=_velocity(t, place, t_image_s[inside], step[inside]),
        sigma_jitter_s=np.sqrt(single),
        sigma_clock_s=sigma_clock_s,
        lever_ccs_m=lever_ccs_m,
        sigma_lever_m=sigma_lever_m,
        correlation_time_s=correlation_time_s,
        shift=shift,
        drift=drift,
    )
    return antenna, counts


def _velocity(t: ArrayF, place: ArrayF, at_s: ArrayF, step_s: ArrayF) -> ArrayF:
    """(a, 3) velocity of a track (n, 3) at times, over twice `_OVER_S` or the steps there if they are longer.

    Single steps of a track at 10 Hz err by decimetres per second.
    """
    half = np.maximum(step_s, _OVER_S)
    before, after = np.clip(at_s - half, t[0], t[-1]), np.clip(at_s + half, t[0], t[-1])
    way = np.stack([np.interp(after, t, axis) - np.interp(before, t, axis) for axis in place.T], axis=1)
    return np.asarray(way / (after - before)[:, None])


def clock_notes(antenna: Antenna | None, late_s: float) -> list[str]:
    """What people should know of the clock of the camera as the antenna's positions tell it.

    ``late_s`` is the estimate of how much later than stamped the images were taken.
    """
    if antenna is None or not antenna.late or abs(late_s) <= _MOST_SIGMAS * antenna.sigma_clock_s:
        return []
    return [
        f"By the antenna's positions the images were taken {late_s:+.3f} s later than by the camera's clock, "
        f"{abs(late_s) / antenna.sigma_clock_s:.1f} times its sigma: is images.clock, or the calibration's, "
        "right?"
    ]
