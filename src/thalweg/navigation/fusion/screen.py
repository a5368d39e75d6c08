"""Observations that jump against the INS: where the smoother should start without them.

By multipath or a wrong fix a track jumps aside and, seconds later, back; a wrong image stands alone. A
smoother that starts with them follows them, because that is how it is told that the INS errs, and no later
test sees what is wrong. But what is left against the INS alone, ``z - way - R l`` and the turn between image
and INS, changes slowly. The series is cut where it does not; from the longest piece on, each next piece must
continue the last good one within what the INS can have drifted in between.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.stats import chi2

from thalweg.core.rigid import rotation_vector
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.navigation.fusion.inputs import Antenna, Camera
from thalweg.navigation.fusion.settings import FusionSettings
from thalweg.navigation.ins_gnss.reference import Reference

Variance = Callable[[ArrayI, ArrayI], ArrayF]
"""Variances (m, d) of the differences between members i (m,) and j (m,) of a series."""

_IMPROBABLE: Final = 1e-6
"""Probability of a step at which a series is cut: one in a day at 10 Hz."""

_BLIND_MPS: Final = 2.0
"""How far the boat may go a second where the INS gives no velocity."""

_ENDS: Final = 10
"""Members at the end of a piece whose median is compared."""

_MOST: Final = 0.5
"""Share of a series beyond which it is no longer clear which of its members are wrong."""


def jumped_positions(antenna: Antenna, reference: Reference, settings: FusionSettings) -> ArrayB:
    """Positions (k,) in pieces of the track that do not fit to its longest piece along the INS's way."""
    t = antenna.t_gps_s
    at = reference.at(t)
    b = antenna.position_wcs_m - at.way_m - at.R_wcs_ics @ antenna.lever_ics_m
    sigma = np.linalg.norm(antenna.root_m, axis=2)
    without = _without_velocity(t, reference)
    white = settings.gnss_white_share

    def variance(i: ArrayI, j: ArrayI) -> ArrayF:
        """Noise of both, what their slow errors can have changed, and the drift of the way."""
        both = np.maximum(sigma[i], sigma[j]) ** 2
        alike = np.exp(-np.abs(t[j] - t[i]) / settings.gnss_time_s)[:, None]
        drift = _way_m2(np.abs(t[j] - t[i]), np.abs(without[j] - without[i]), settings)
        return np.asarray(2 * both * (white + (1 - white) * (1 - alike)) + drift[:, None])

    return _doubtful(b, variance, _ENDS)


def jumped_images(camera: Camera, reference: Reference, settings: FusionSettings) -> ArrayB:
    """Images (k,) whose poses do not fit to the others along the INS's way and turns."""
    t = camera.t_gps_s
    at = reference.at(t)
    turn = rotation_vector(camera.R_wcs_ics @ np.swapaxes(at.R_wcs_ics, 1, 2))
    b = np.concatenate([camera.position_wcs_m - at.way_m, turn], axis=1)
    own = np.sum(camera.root**2, axis=2)
    # without the INS's velocity the motion is not known here; the time's jitter moves the boat by it
    moving = np.concatenate([at.velocity_mps, at.rate_radps], axis=1)
    own = own + (camera.jitter_s[:, None] * moving) ** 2
    without = _without_velocity(t, reference)
    heading = np.deg2rad(settings.heading_disturbance_deg)
    angle = np.sqrt(np.max(at.sigma_rad, axis=1) ** 2 + heading**2)

    def variance(i: ArrayI, j: ArrayI) -> ArrayF:
        """Errors of both images, and the drift of the INS."""
        step = np.abs(t[j] - t[i])
        drift = np.empty((len(step), 6))
        drift[:, :3] = _way_m2(step, np.abs(without[j] - without[i]), settings)[:, None]
        turned = 2 * np.maximum(angle[i], angle[j]) ** 2 * -np.expm1(-step / settings.attitude_time_s)
        drift[:, 3:] = turned[:, None]
        return np.asarray(own[i] + own[j] + drift)

    return _doubtful(b, variance, 1)


def _doubtful(b: ArrayF, variance: Variance, ends: int) -> ArrayB:
    """Members (k,) of a series (k, d) in pieces that do not continue its longest one."""
    n, d = b.shape
    out = np.zeros(n, dtype=np.bool_)
    if n < 3:
        return out
    every = np.arange(n)
    step = np.sqrt(np.sum(np.diff(b, axis=0) ** 2 / variance(every[:-1], every[1:]), axis=1))
    # sigmas that are stated too small must not cut everything
    scale = max(1.0, float(np.median(step) / np.sqrt(chi2.ppf(0.5, d))))
    limit = scale * float(np.sqrt(chi2.isf(_IMPROBABLE, d)))
    bounds = np.concatenate([[0], np.flatnonzero(step > limit) + 1, [n]])
    anchor = int(np.argmax(np.diff(bounds)))

    def continues(first: int, second: int) -> bool:
        """Whether a piece goes on where an earlier one stopped."""
        i, j = int(bounds[first + 1]), int(bounds[second])
        jump = np.median(b[j : min(j + ends, int(bounds[second + 1]))], axis=0)
        jump = jump - np.median(b[max(i - ends, int(bounds[first])) : i], axis=0)
        spread = variance(np.array([i - 1]), np.array([j]))[0]
        return bool(np.sqrt(np.sum(jump**2 / spread)) <= limit)

    last = anchor
    for piece in range(anchor + 1, len(bounds) - 1):
        if continues(last, piece):
            last = piece
        else:
            out[bounds[piece] : bounds[piece + 1]] = True
    last = anchor
    for piece in range(anchor - 1, -1, -1):
        if continues(piece, last):
            last = piece
        else:
            out[bounds[piece] : bounds[piece + 1]] = True
    return out if out.mean() <= _MOST else np.zeros(n, dtype=np.bool_)


def _without_velocity(t: ArrayF, reference: Reference) -> ArrayF:
    """Seconds (k,) without a velocity of the INS until each time."""
    blind = np.append(0.0, np.cumsum(np.where(reference.blind, np.diff(reference.t_gps_s), 0.0)))
    return np.asarray(np.interp(t, reference.t_gps_s, blind))


def _way_m2(step_s: ArrayF, blind_s: ArrayF, settings: FusionSettings) -> ArrayF:
    """Variance (m,) of the way over steps, an upper bound."""
    tau = settings.velocity_time_s
    along = settings.sigma_velocity_mps**2 * np.minimum(step_s**2, 2 * tau * step_s)
    return np.asarray(along + (_BLIND_MPS * blind_s) ** 2)
