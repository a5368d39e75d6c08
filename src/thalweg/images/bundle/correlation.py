"""How the errors of a point's marks are related, estimated from the block itself.

A slow boat sees the same texture in neighbouring images from nearly the same side. What shifts a mark there -
relief below the size of the feature, its oblique picture, light - shifts it alike in both images, and changes
with the view. So each coordinate of a mark errs by ::

    e = s (white w + slow c),      E[c_i c_j] = exp(-(|v_i - v_j| / reach)^power)

with the stated sigma ``s``, independent ``w``, and the place of view ``v``: the unit vector from the point to
the camera, and the logarithm of their distance. Two views that differ by ``reach`` (a change of direction in
radians, or of distance in nepers) are correlated by 1/e. The distance of places is Euclidean, so this is a
covariance on any set of views for powers up to 2 (Schoenberg 1938): at 1 errors wander like a drunkard, at 2
they drift smoothly.

What is nearer than the feature's own depth passes before what is farther, along the parallax. There marks err
more than across it, by factors that are estimated, too. Along is where the main direction of the cameras that
see a point appears in the image; on a boat that is mostly the horizontal.

Some tracks are much worse than others: a leaf that moves, an edge that hides. The errors of a track follow
Student's distribution, jointly for all its marks: with ``q = r^T P r`` and ``d = 2 n - 3`` it counts with the
weight ``(freedom + d) / (freedom + q)`` (Lange, Little and Taylor 1989).

All numbers and the size of the errors maximise the restricted likelihood of the residuals (Patterson and
Thompson 1971): the coordinates of each point are integrated out exactly; the images, which share six unknowns
among hundreds of marks, are taken as they are.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy import optimize
from scipy.special import gammaln

from thalweg.core.types import ArrayF, ArrayI
from thalweg.images.bundle.kernels import restricted_parts

MOST_TRACKS: Final = 2000
"""Tracks that are looked at: the numbers are then known to a few percent."""
_LEAST_MARKS: Final = 3
"""Marks of a track that tells anything of its correlation."""
_REACHES: Final = (0.003, 3.0)
"""Bounds of the reach, radians: from a sixth of a degree to errors that wander over all views."""
_POWERS: Final = (0.5, 1.9)
"""Bounds of the power: with 2 the matrices of long tracks lose their digits."""
_STARTS: Final = (
    (0.3, 0.02, 1.0),
    (0.3, 0.1, 1.0),
    (0.8, 0.1, 1.0),
    (0.8, 0.5, 1.0),
    (0.97, 3.0, 1.0),
    (0.9, 0.5, 1.6),
)
"""Share of the slow part in the variance, reach and power, from where the search begins."""
_APART_RAD: Final = 0.1
"""Distance of views at which the search looks at the slow part."""
_FIRST_STEPS: Final = (0.8, -0.3, -0.3, -0.6, 0.8)
"""Of the numbers of the search."""
_LATER_STEPS: Final = 0.3
_MORE: Final = 10.0
"""Twice the gain in likelihood that five more numbers must bring (Akaike 1974)."""
_ACROSS: Final = (0.1, 10.0)
"""Bounds of errors across over those along."""
_FREEDOMS: Final = (1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 30.0, 100.0, np.inf)
_LEAST_SHARE: Final = 1e-3
"""Least white part of the variance, so that two views from the same place are no contradiction."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Correlation:
    """Errors of tie marks in units of their stated sigma.

    Parameters
    ----------
    white, slow : parts of the errors along the parallax.
    reach_rad, power : how fast the slow part changes with the view.
    white_across, slow_across : factors for the errors across the parallax.
    freedom : degrees of freedom of Student's distribution of a track; infinite: normal.
    """

    white: float = 1.0
    slow: float = 0.0
    reach_rad: float = 1.0
    power: float = 1.0
    white_across: float = 1.0
    slow_across: float = 1.0
    freedom: float = float("inf")

    @property
    def model(self) -> ArrayF:
        """(6,) as the compiled loops take it."""
        white, slow = self.white, self.slow
        across = (self.white_across * white, self.slow_across * slow)
        return np.array([white, across[0], slow, across[1], self.reach_rad, self.power])

    def change(self, apart_rad: float) -> ArrayF:
        """(2,) sigma of half the difference of two marks with views so far apart, times the root of two."""
        m = self.model
        new = -np.expm1(-((apart_rad / self.reach_rad) ** self.power))
        return np.asarray(np.sqrt(np.square(m[:2]) + np.square(m[2:4]) * new))

    def covariances(self, view: ArrayF, sigma_px: ArrayF) -> ArrayF:
        """(2, n, n) covariance of the marks of a track in each coordinate; as the compiled loops build it."""
        m = self.model
        apart = np.linalg.norm(view[:, None] - view, axis=2)
        alike = np.exp(-((apart / self.reach_rad) ** self.power))
        unit = m[:2, None, None] ** 2 * np.eye(len(view)) + m[2:4, None, None] ** 2 * alike
        return np.asarray(unit * np.outer(sigma_px, sigma_px))

    def differs(self, other: "Correlation", share: float) -> bool:
        """Whether the errors of two views a degree, or 10 degrees, apart differ by more than a share."""
        return any(
            bool((np.abs(self.change(apart) / other.change(apart) - 1.0) > share).any())
            for apart in np.radians([1.0, 10.0])
        )

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
            "white_across": self.white * self.white_across,
            "slow_across": self.slow * self.slow_across,
            "reach_deg": float(np.degrees(self.reach_rad)),
            "power": self.power,
            "freedom": self.freedom if np.isfinite(self.freedom) else None,
            "unit": "stated sigma of a mark",
        }


def views(points_m: ArrayF, centres_m: ArrayF) -> ArrayF:
    """(m, 4) place of view of each mark: unit vector from the point to the camera, logarithm of distance."""
    away = centres_m - points_m
    r = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
    return np.concatenate([away / r, np.log(r)], axis=1)


def parallax(by_point: ArrayF, point: ArrayI, centres_m: ArrayF, n_points: int) -> ArrayF:
    """(m, 2) unit vector in the image along the parallax of each mark.

    Parameters
    ----------
    by_point : (m, 2, 3) derivatives of the pixel by the point.
    point : (m,) points of the marks.
    centres_m : (m, 3) projection centres of their images.
    n_points : number of points.
    """
    count = np.maximum(np.bincount(point, minlength=n_points), 1)[:, None]
    mean = np.stack([np.bincount(point, c, n_points) for c in centres_m.T], axis=1) / count
    off = centres_m - mean[point]
    spread = np.empty((n_points, 3, 3))
    for a in range(3):
        for b in range(a, 3):
            spread[:, a, b] = spread[:, b, a] = np.bincount(point, off[:, a] * off[:, b], n_points)
    main = np.linalg.eigh(spread)[1][:, :, 2]
    along = np.einsum("mij,mj->mi", by_point, main[point])
    length = np.linalg.norm(along, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(length > 0, along / length, [1.0, 0.0])


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
    by_point : (m, 2, 3) derivatives of the pixel by the point; along and across the parallax.
    residual_px, sigma_px : (m, 2) along and across, (m,).
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

    def profile(shape: Correlation) -> tuple[float, float, float]:
        """-2 ln L for the best size and freedom of errors of that shape, and these."""
        restricted_parts(starts, *parts, shape.model, logarithm, square, none)
        best = min((*_sized(square, degrees, freedom), freedom) for freedom in _FREEDOMS)
        return best[0] + float(logarithm.sum()), best[1], best[2]

    fresh = start is None or start.slow == 0
    tries = (
        [_numbers(start)]
        if start is not None and not fresh
        else [
            _numbers(Correlation(white=np.sqrt(1 - share), slow=np.sqrt(share), reach_rad=reach, power=power))
            for share, reach, power in _STARTS
        ]
    )
    best = min(tries, key=lambda x: profile(_shape(x))[0])
    minimise: Any = optimize.minimize
    # a simplex may shrink beside the minimum; another from there does not
    for size, most in ((1.0, 150), (0.5, 100)) if fresh else ((_LATER_STEPS, 50),):
        search: Any = {
            "initial_simplex": best + np.vstack([np.zeros(5), size * np.diag(_FIRST_STEPS)]),
            "xatol": 0.02,
            "fatol": 0.1,
            "maxfev": most,
        }
        found = minimise(lambda x: profile(_shape(x))[0], best, method="Nelder-Mead", options=search)
        best = found.x
    independent, variance, freedom = profile(Correlation())
    if independent <= float(found.fun) + _MORE:
        return Correlation(white=float(np.sqrt(variance)), freedom=freedom)
    shape = _shape(found.x)
    _, variance, freedom = profile(shape)
    size = float(np.sqrt(variance))
    return replace(shape, white=size * shape.white, slow=size * shape.slow, freedom=freedom)


def _numbers(shape: Correlation) -> ArrayF:
    """(5,) numbers without bounds for the search.

    Not the whole slow part is known but what of it is new at some distance, so that is the first number; it
    hardly depends on the reach, the fourth.
    """
    low, high = _POWERS
    inner = float(np.clip((shape.power - low) / (high - low), 0.01, 0.99))
    new = (shape.slow / shape.white) ** 2 * -np.expm1(-((_APART_RAD / shape.reach_rad) ** shape.power))
    return np.array([
        np.log(max(new, 1e-6)), np.log(shape.white_across), np.log(shape.slow_across),
        np.log(shape.reach_rad), np.log(inner / (1 - inner)),
    ])  # fmt: skip


def _shape(x: ArrayF) -> Correlation:
    """Errors of unit variance along the parallax."""
    inner = float(1.0 / (1.0 + np.exp(-np.clip(x[4], -12, 12))))
    power = _POWERS[0] + (_POWERS[1] - _POWERS[0]) * inner
    reach = float(np.exp(np.clip(x[3], *np.log(_REACHES))))
    ratio = float(np.exp(np.clip(x[0], -20, 20))) / -np.expm1(-((_APART_RAD / reach) ** power))
    white = max(1.0 / (1.0 + ratio), _LEAST_SHARE)
    across = np.exp(np.clip(x[1:3], *np.log(_ACROSS)))
    return Correlation(
        white=float(np.sqrt(white)), slow=float(np.sqrt(1.0 - white)), reach_rad=reach, power=power,
        white_across=float(across[0]), slow_across=float(across[1]),
    )  # fmt: skip


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
