"""How far the boat moves by itself in a gap between observations, taken from the rest of its track.

Where the INS gives no velocity the boat's own is taken for a random walk, whose size the observations tell.
They tell it for the steps between them: of a tenth of a second, in which a boat heaves and does not turn. In
a gap of a minute a boat that turns every half minute goes several times as far as such a walk does, because
accelerations are no white noise: they last.

So the walk of a gap of length L gets the size that gaps of this length would have needed elsewhere, if that
is more. In the parts of the track that are known, both ends of windows of length L, with their velocities,
are taken for known and the middle is compared with what lies between them::

    e = p(L/2) - (p(0) + p(L)) / 2 - L (v(0) - v(L)) / 8,      q(L) = 192 mean(e^2) / L^3

as the middle of a bridged random walk of the density q has the variance q L^3 / 192 (from its covariance
given both ends). Beyond the longest windows the accelerations are taken to walk in their turn, so that q
grows with the square of L, until the boat would have to be faster than it is: one that turns about in the
middle, at the standard deviation of its velocity, asks for ``q = 12 var(v) / L``. A few seconds on a straight
leg need less than the steps do; there the sigmas stay on the safe side, as a walk has but one size for
changes of the place and of the velocity.
"""

from typing import Final

import numpy as np

from thalweg.core.types import ArrayB, ArrayF
from thalweg.navigation.fusion.inputs import MODEL, Nodes
from thalweg.navigation.fusion.output import pose_states
from thalweg.navigation.fusion.settings import FusionSettings
from thalweg.navigation.fusion.solver import Observed, Solved
from thalweg.navigation.ins_gnss.reference import Reference

_LONG: Final = 3.0
"""A gap longer than this many usual ones is one."""

_LAG_RATIO: Final = 1.5
"""Ratio of the lengths of windows from one to the next."""

_STARTS: Final = 8
"""Windows begin every so many-th of their length."""

_LEAST_WINDOWS: Final = 3
_MOST_WINDOWS: Final = 2000
"""Of one length; a long survey holds more than are needed."""

_LEAST_DENSITY: Final = 1e-12
"""A boat that moves as evenly, to a micrometre in a second, m^2/s^3."""

_BOUNDS: Final = (1.0, 1e8)
"""Of the factors. A smaller walk than that of the steps would contradict the velocities at both ends."""


def walk_factors(
    reference: Reference, nodes: Nodes, observed: Observed, solved: Solved, settings: FusionSettings
) -> ArrayF | None:
    """Factors (m, 3) of the noise of position and rate into each node; None where no gap asks for any.

    Parameters
    ----------
    reference, nodes, observed, settings : of the solution.
    solved : a solution with factors of 1.
    """
    t = nodes.t_gps_s
    seen = _seen_s(observed)
    gap_s = _gaps_s(t, seen)
    own = nodes.kind == MODEL
    steps = np.diff(seen)
    usual_s = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    long = own & (gap_s > _LONG * usual_s)
    if usual_s == 0 or not long.any():
        return None
    density = (settings.sigma_acceleration * solved.factors["acceleration"]) ** 2
    known = ~long
    known[0] = known[min(1, len(known) - 1)]
    lags_s, q, variance = _by_lag(reference, nodes, solved, settings, known, _LONG * usual_s)
    out = np.ones((len(t), 3))
    gaps = gap_s[long]
    for axis in range(3):
        out[long, axis] = _at(gaps, lags_s, q[:, axis], float(variance[axis]), density, usual_s) / density
    return np.clip(out, *_BOUNDS)


def _seen_s(observed: Observed) -> ArrayF:
    """Times of all observations that are used, in order."""
    parts = []
    if observed.antenna is not None:
        parts.append(observed.antenna.t_gps_s[observed.weight_antenna > 0])
    if observed.camera is not None:
        parts.append(observed.camera.t_gps_s[observed.weight_camera > 0])
    return np.sort(np.concatenate(parts))


def _gaps_s(t: ArrayF, seen_s: ArrayF) -> ArrayF:
    """Length (m,) of the gap between observations that the step into each node lies in.

    Before the first and behind the last one nothing holds the other end: counted twice.
    """
    middle = t - np.diff(t, prepend=t[0]) / 2
    after = np.searchsorted(seen_s, middle)
    first, last = 2 * (seen_s[0] - t[0]), 2 * (t[-1] - seen_s[-1])
    edges = np.concatenate([[first], np.diff(seen_s), [last]])
    return np.asarray(edges[after])


def _by_lag(
    reference: Reference,
    nodes: Nodes,
    solved: Solved,
    settings: FusionSettings,
    known: ArrayB,
    shortest_s: float,
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Lengths (k,) of windows, the density (k, 3) each asks for, and the variance (3,) of the velocity."""
    t = nodes.t_gps_s
    edge = np.diff(np.concatenate([[0], known.astype(np.int64), [0]]))
    begin, end = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1) - 1
    stretches = [
        (float(t[max(i - 1, 0)]), float(t[j])) for i, j in zip(begin.tolist(), end.tolist(), strict=True)
    ]
    longest_s = max((b - a for a, b in stretches), default=0.0)
    lags: list[float] = []
    density: list[ArrayF] = []
    variance = np.full(3, np.inf)
    lag = shortest_s
    while lag * (1 + (_LEAST_WINDOWS - 1) / _STARTS) <= longest_s:
        starts = np.concatenate([np.arange(a, b - lag, lag / _STARTS) for a, b in stretches if b - a > lag])
        if len(starts) < _LEAST_WINDOWS:
            break
        every = -(-len(starts) // _MOST_WINDOWS)
        (p0, v0), (p1, _), (p2, v2) = (
            _track(starts[::every] + share * lag, reference, nodes, solved, settings)
            for share in (0.0, 0.5, 1.0)
        )
        e = p1 - (p0 + p2) / 2 - lag * (v0 - v2) / 8
        lags.append(lag)
        density.append(192 * np.mean(e**2, axis=0) / lag**3)
        if len(lags) == 1:
            variance = np.var(v0, axis=0)
        lag *= _LAG_RATIO
    return np.array(lags), np.array(density).reshape(-1, 3), variance


def _track(
    t: ArrayF, reference: Reference, nodes: Nodes, solved: Solved, settings: FusionSettings
) -> tuple[ArrayF, ArrayF]:
    """Position and velocity (k, 3) of the solution."""
    mean, _ = pose_states(t, nodes, solved, settings)
    at = reference.at(t)
    return at.way_m + mean[:, :3], at.velocity_mps + mean[:, 3:6]


def _at(gap_s: ArrayF, lags_s: ArrayF, q: ArrayF, variance: float, density: float, usual_s: float) -> ArrayF:
    """Density (n,) for gaps of a length."""
    if not len(lags_s):
        lags_s, q = np.array([usual_s]), np.array([density])
    inner = np.exp(np.interp(np.log(gap_s), np.log(lags_s), np.log(np.maximum(q, _LEAST_DENSITY))))
    # the greatest that was seen: the longest windows are few and may show a lull
    beyond = np.minimum(float(q.max()) * (gap_s / lags_s[-1]) ** 2, 12 * variance / gap_s)
    return np.where(gap_s > lags_s[-1], beyond, inner)
