"""How the errors of a point's marks are related, estimated from the block itself.

A slow boat sees the same texture in neighbouring images from nearly the same side. What shifts a mark there -
relief below the size of the feature, its oblique picture, light - shifts it alike in both images, and changes
with the view. So each coordinate of a mark errs by ::

    e = s (white w + slow c),      E[c_i c_j] = exp(-|v_i - v_j| / reach)

with the stated sigma ``s``, independent ``w``, and the place of view ``v``: the unit vector from the point to
the camera, and the logarithm of their distance. Two views that differ by ``reach`` (a change of direction in
radians, or of distance in nepers) are correlated by 1/e. The distance of places is Euclidean, so the
exponential is a covariance on any set of views (Schoenberg 1938).

Some tracks are much worse than others: a leaf that moves, an edge that hides. The errors of a track follow
Student's distribution, jointly for all its marks: with ``q = r^T P r`` and ``d = 2 n - 3`` it counts with the
weight ``(freedom + d) / (freedom + q)`` (Lange, Little and Taylor 1989).

The four numbers and the size of the errors maximise the restricted likelihood of the residuals (Patterson and
Thompson 1971): the coordinates of each point are integrated out exactly; the images, which share six unknowns
among hundreds of marks, are taken as they are.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy import optimize
from scipy.special import gammaln

from thalweg.core.types import ArrayF, ArrayI
from thalweg.orientation.block_kernels import restricted_parts

MOST_TRACKS: Final = 2000
"""Tracks that are looked at: the numbers are then known to a few percent."""
_LEAST_MARKS: Final = 3
"""Marks of a track that tells anything of its correlation."""
_REACHES: Final = (0.003, 3.0)
"""Bounds of the reach, radians: from a sixth of a degree to errors that wander over all views."""
_STARTS: Final = ((0.3, 0.02), (0.3, 0.1), (0.8, 0.1), (0.8, 0.5), (0.97, 3.0))
"""Share of the slow part in the variance, and reach, from where the search begins."""
_FREEDOMS: Final = (1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 30.0, 100.0, np.inf)
_LEAST_SHARE: Final = 1e-3
"""Least white part of the variance, so that two views from the same place are no contradiction."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Correlation:
    """Errors of tie marks in units of their stated sigma: white part, slow part, reach in radians.

    ``freedom`` are the degrees of freedom of Student's distribution of a track; infinite: normal.
    """

    white: float = 1.0
    slow: float = 0.0
    reach_rad: float = 1.0
    freedom: float = float("inf")

    @property
    def model(self) -> ArrayF:
        """(3,) as the compiled loops take it."""
        return np.array([self.white, self.slow, self.reach_rad])

    def differs(self, other: "Correlation", share: float) -> bool:
        """Whether the errors of two views a degree, or 10 degrees, apart differ by more than a share."""
        for apart in np.radians([1.0, 10.0]):
            one, two = (
                np.sqrt(c.white**2 + c.slow**2 * -np.expm1(-apart / c.reach_rad)) for c in (self, other)
            )
            if abs(one / two - 1.0) > share:
                return True
        return False

    def weights(self, square: ArrayF, degrees: ArrayF) -> ArrayF:
        """Weight (t,) of tracks with these square sums and degrees of freedom."""
        if not np.isfinite(self.freedom):
            return np.ones_like(square)
        return np.asarray((self.freedom + degrees) / (self.freedom + square))

    def information(self, degrees: ArrayF) -> ArrayF:
        """(t,) what a track of Student's errors tells, as a share of its weighted normal equations.

        The expected curvature of the likelihood is smaller than the weight (Lange et al. 1989, eq. 6).
        """
        if not np.isfinite(self.freedom):
            return np.ones_like(degrees)
        return np.asarray((self.freedom + degrees) / (self.freedom + degrees + 2.0))

    def facts(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "white": self.white,
            "slow": self.slow,
            "reach_deg": float(np.degrees(self.reach_rad)),
            "freedom": self.freedom if np.isfinite(self.freedom) else None,
            "unit": "stated sigma of a mark",
        }


def views(points_m: ArrayF, centres_m: ArrayF) -> ArrayF:
    """(m, 4) place of view of each mark: unit vector from the point to the camera, logarithm of distance."""
    away = centres_m - points_m
    r = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
    return np.concatenate([away / r, np.log(r)], axis=1)


def estimate(
    first: ArrayI,
    by_point: ArrayF,
    residual_px: ArrayF,
    sigma_px: ArrayF,
    view: ArrayF,
    start: Correlation | None = None,
) -> Correlation:
    """The numbers that make the residuals most likely.

    Parameters
    ----------
    first : (p + 1,) first mark of each track.
    by_point : (m, 2, 3) derivatives of the pixel by the point.
    residual_px, sigma_px : (m, 2), (m,).
    view : (m, 4) of `views`.
    start : an earlier estimate to begin from.
    """
    length = np.diff(first)
    usable = np.flatnonzero(length >= _LEAST_MARKS)
    if len(usable) == 0:
        return Correlation()
    # evenly spread, not random: the same block gives the same numbers
    chosen = usable[np.linspace(0, len(usable) - 1, min(MOST_TRACKS, len(usable))).astype(np.int64)]
    rows = np.concatenate([np.arange(first[k], first[k + 1]) for k in chosen])
    starts = np.concatenate([[0], np.cumsum(length[chosen])])
    parts = tuple(np.ascontiguousarray(a[rows]) for a in (by_point, residual_px, sigma_px, view))
    degrees = (2 * length[chosen] - 3).astype(np.float64)
    logarithm, square, none = np.empty(len(chosen)), np.empty(len(chosen)), np.empty(0)

    def profile(share: float, reach: float) -> tuple[float, float, float]:
        """-2 ln L for the best size and freedom of errors of that shape, and these."""
        model = np.array([np.sqrt(max(1.0 - share, _LEAST_SHARE)), np.sqrt(share), reach])
        restricted_parts(starts, *parts, model, logarithm, square, none)
        best = min((*_sized(square, degrees, freedom), freedom) for freedom in _FREEDOMS)
        return best[0] + float(logarithm.sum()), best[1], best[2]

    def shape(x: ArrayF) -> tuple[float, float]:
        share = float(1.0 / (1.0 + np.exp(-np.clip(x[0], -12, 12))))
        return share, float(np.exp(np.clip(x[1], *np.log(_REACHES))))

    tries = [np.array([np.log(s / (1 - s)), np.log(g)]) for s, g in _STARTS]
    if start is not None and start.slow > 0:
        share = np.clip(start.slow**2 / (start.slow**2 + start.white**2), 1e-4, 1 - 1e-4)
        tries = [np.array([np.log(share / (1 - share)), np.log(start.reach_rad)])]
    best = min(tries, key=lambda x: profile(*shape(x))[0])
    search: Any = {
        "initial_simplex": best + np.array([[0, 0], [0.6, 0], [0, -0.4]]),
        "xatol": 0.02,
        "fatol": 0.1,
        "maxfev": 60 if start is None or start.slow == 0 else 24,
    }
    minimise: Any = optimize.minimize
    found = minimise(
        lambda x: profile(*shape(x))[0],
        best,
        method="Nelder-Mead",
        options=search,
    )
    independent, variance, freedom = profile(0.0, 1.0)
    if independent <= float(found.fun) + 4.0:
        # two more numbers that gain less than their own freedom (Akaike 1974)
        return Correlation(white=float(np.sqrt(variance)), freedom=freedom)
    share, reach = shape(found.x)
    _, variance, freedom = profile(share, reach)
    size = float(np.sqrt(variance))
    return Correlation(
        white=size * float(np.sqrt(max(1 - share, _LEAST_SHARE))),
        slow=size * float(np.sqrt(share)),
        reach_rad=reach,
        freedom=freedom,
    )


def _sized(square: ArrayF, degrees: ArrayF, freedom: float) -> tuple[float, float]:
    """-2 ln L of Student's (normal) distribution of tracks for the best variance, and that variance."""
    variance = max(float(np.median(square / degrees)), 1e-12)
    if not np.isfinite(freedom):
        variance = max(float(square.sum() / degrees.sum()), 1e-12)
        return float((degrees * np.log(variance) + square / variance).sum()), variance
    for _ in range(40):
        weight = (freedom + degrees) / (freedom + square / variance)
        new = max(float((weight * square).sum() / degrees.sum()), 1e-12)
        done = abs(new / variance - 1) < 1e-5
        variance = new
        if done:
            break
    constant = gammaln((freedom + degrees) / 2) - gammaln(freedom / 2) - degrees / 2 * np.log(freedom / 2)
    body = (freedom + degrees) * np.log1p(square / (variance * freedom))
    return float((degrees * np.log(variance) + body - 2 * constant).sum()), variance
