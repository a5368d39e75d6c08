"""Parallel planes of known heights under a profile or a scan: the stepped object of P4 7.1 to 7.3.

The object stands anywhere; three numbers say where its planes are: two tilts and a height. They are
adjusted to the points through `thalweg.core.adjustment`, the spacing of the planes being that of the
reference. Points are given to the nearest plane; those farther than ``NEAR_MM`` lie on the ground, on a
side, or nowhere.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core import Adjusted, ArrayB, ArrayF, ArrayI, GeometryError, Linear, Observations, adjust

STEP_HEIGHTS_MM: Final = (0.006, 20.195, 40.135)
"""Heights of the levels of the test object by plane fits (P4 7.1)."""

_NAMES: Final = ("height", "tilt along the first axis", "tilt along the second axis")
_LARGEST_TILT_RAD: Final = 0.1
NEAR_MM: Final = 3.0
"""Half width of the layers whose points lie on a plane."""
_SEARCH_MM: Final = 0.25
_SIGMA_MM: Final = 0.2
"""Where no sigma is given: all points alike."""
_ROUNDS: Final = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Levels:
    """Planes fitted to points.

    ``normal`` (3,) upwards and ``height_mm`` of the plane of the first level along it; ``level`` (n,) number
    of each point's plane, -1 if it lies on none; ``distance_mm`` (n,) signed distance from that plane, NaN if
    none; ``adjusted`` the adjustment; ``plane_rms_mm``, ``plane_n`` (m,) of a plane of its own for each
    level; ``plane_height_mm`` (m,) of the points of each level over the first plane, in the middle of them.
    """

    normal: ArrayF
    height_mm: float
    level: ArrayI
    distance_mm: ArrayF
    adjusted: Adjusted[ArrayF]
    plane_rms_mm: ArrayF
    plane_n: ArrayI
    plane_height_mm: ArrayF

    @property
    def used(self) -> ArrayB:
        """(n,) points that belong to a plane."""
        return self.level >= 0


def fit_levels(
    xyz_mm: ArrayF,
    up: ArrayF,
    *,
    heights_mm: tuple[float, ...] = STEP_HEIGHTS_MM,
    sigma_mm: ArrayF | None = None,
    tilt_sigma_rad: float = 0.0,
) -> Levels:
    """Fit parallel planes of known heights.

    Parameters
    ----------
    xyz_mm : (n, 3) points in any frame.
    up : (3,) normal of the planes, within some degrees.
    heights_mm : of the levels, growing.
    sigma_mm : (n,) standard deviation of each point along ``up``; None: all alike.
    tilt_sigma_rad : standard deviation of ``up`` as an observation of both tilts; 0: none.

    Raises
    ------
    GeometryError : too few points on the planes, or planes that are tilted by more than six degrees.
    UnobservableError : points that do not determine the tilts, such as a line on a single level.
    """
    X, h = np.asarray(xyz_mm, dtype=np.float64), np.asarray(heights_mm, dtype=np.float64)
    if not (len(h) and (np.diff(h) > 0).all()):
        raise GeometryError(f"heights {h.tolist()} mm", expected="growing numbers", where="levels")
    if len(X) < 10 or not np.isfinite(X).all():
        raise GeometryError(f"{len(X)} points, or some not finite", expected="10 and more", where="levels")
    sigma = np.full(len(X), _SIGMA_MM) if sigma_mm is None else np.maximum(sigma_mm, 1e-3)
    axes = _axes(up)
    centre = X.mean(axis=0)
    local = (X - centre) @ axes.T
    x = np.array([_first_height(local[:, 2], h), 0.0, 0.0])
    # the layer begins wide, for the tilts, and narrows: neighbouring levels must stay apart
    widest = min(0.4 * float(np.diff(h).min()) if len(h) > 1 else 3 * NEAR_MM, 8.0)
    widths = np.maximum(np.geomspace(max(widest, NEAR_MM), NEAR_MM, _ROUNDS), NEAR_MM)
    adjusted: Adjusted[ArrayF] | None = None
    for width in widths:
        away = _heights(local, x)[:, None] - h
        level = np.argmin(np.abs(away), axis=1)
        near = np.abs(away[np.arange(len(X)), level]) <= width
        if near.sum() < 10:
            raise GeometryError(
                f"{int(near.sum())} of {len(X)} points lie within {width:.1f} mm of planes {h.tolist()}",
                expected="an object with levels at these millimetres under the line",
                where="levels",
                cure="Check the heights, and that the profile shows this object",
            )
        adjusted = _adjusted(local[near], h[level[near]], sigma[near], x, tilt_sigma_rad)
        x = adjusted.x
    assert adjusted is not None
    if np.hypot(x[1], x[2]) > _LARGEST_TILT_RAD:
        raise GeometryError(
            f"planes tilted by {np.rad2deg(np.hypot(x[1], x[2])):.1f} degrees against the stated direction",
            expected=f"at most {np.rad2deg(_LARGEST_TILT_RAD):.0f} degrees",
            where="levels",
            cure="State the direction upwards of the object",
        )
    away = _heights(local, x)[:, None] - h
    level = np.argmin(np.abs(away), axis=1).astype(np.int64)
    distance = away[np.arange(len(X)), level]
    on = np.abs(distance) <= NEAR_MM
    level[~on], distance = -1, np.where(on, distance, np.nan)
    normal = np.array([-x[1], -x[2], 1.0]) / np.sqrt(1.0 + x[1] ** 2 + x[2] ** 2)
    rms, n, height = _single_planes(local, level, _heights(local, x), len(h))
    first = float(x[0] * normal[2] + (normal @ (axes @ centre)))
    return Levels(
        normal=axes.T @ normal,
        height_mm=first,
        level=level,
        distance_mm=distance,
        adjusted=adjusted,
        plane_rms_mm=rms,
        plane_n=n,
        plane_height_mm=height,
    )


def _axes(up: ArrayF) -> ArrayF:
    """(3, 3) rows: two directions across and the unit vector upwards."""
    u = np.asarray(up, dtype=np.float64) / np.linalg.norm(up)
    first = np.eye(3)[int(np.argmin(np.abs(u)))]
    first = first - u * (first @ u)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(u, first), u])


def _heights(local: ArrayF, x: ArrayF) -> ArrayF:
    """Distances (n,) above the plane of height 0."""
    slant = local[:, 2] - x[0] - local[:, 0] * x[1] - local[:, 1] * x[2]
    return np.asarray(slant / np.sqrt(1.0 + x[1] ** 2 + x[2] ** 2))


def _first_height(z: ArrayF, h: ArrayF) -> float:
    """Height of level 0 for which most points lie near a level, the middle of equally good ones."""
    trial = np.arange(z.min() - h[-1], z.max() - h[0] + _SEARCH_MM, _SEARCH_MM)
    width = min(2.0, 0.2 * float(np.diff(h).min()) if len(h) > 1 else 2.0)
    count = np.zeros(len(trial))
    ordered = np.sort(z)
    for level in h:
        first, last = (np.searchsorted(ordered, trial + level + side) for side in (-width, width))
        # every level counts by the root, so that no large level alone decides
        count += np.sqrt(last - first)
    best = np.flatnonzero(count >= count.max() - 1e-9)
    return float(trial[best].mean())


def _adjusted(local: ArrayF, h: ArrayF, sigma: ArrayF, x: ArrayF, tilt_sigma_rad: float) -> Adjusted[ArrayF]:
    def points(state: ArrayF) -> Linear:
        """Distances of points from their planes."""
        length = np.sqrt(1.0 + state[1] ** 2 + state[2] ** 2)
        d = _heights(local, state)
        J = np.stack([np.full(len(d), -1.0), -local[:, 0], -local[:, 1]], axis=1) / length
        J[:, 1] -= d * state[1] / length**2
        J[:, 2] -= d * state[2] / length**2
        return Linear(residual=d - h, jacobian=J, cov=sigma**2)

    def tilts(state: ArrayF) -> Linear:
        """The stated direction upwards as an observation."""
        return Linear(residual=state[1:], jacobian=np.eye(3)[1:], cov=np.full(2, tilt_sigma_rad**2))

    groups = [Observations("points", points)]
    if tilt_sigma_rad > 0:
        groups.append(Observations("direction upwards", tilts))
    return adjust(
        groups,
        x,
        _NAMES,
        loss="huber",
        reject_sigmas=6.0,
        cure="Scan several lines, or state how well the direction upwards is known",
    )


def _single_planes(
    local: ArrayF, level: ArrayI, height: ArrayF, n_levels: int
) -> tuple[ArrayF, ArrayI, ArrayF]:
    """RMS of the distances from a plane of its own for each level, number of points, mean height."""
    rms, n, mean = np.full(n_levels, np.nan), np.zeros(n_levels, dtype=np.int64), np.full(n_levels, np.nan)
    for k in range(n_levels):
        own = local[level == k]
        n[k] = len(own)
        if len(own) < 4:
            continue
        mean[k] = float(height[level == k].mean())
        A = np.column_stack([np.ones(len(own)), own[:, :2]])
        # least norm: points of a single line leave the tilt across it at zero
        x, *_ = np.linalg.lstsq(A, own[:, 2], rcond=1e-6)
        away = (own[:, 2] - A @ x) / np.sqrt(1.0 + x[1] ** 2 + x[2] ** 2)
        rms[k] = float(np.sqrt((away**2).sum() / max(len(own) - 3, 1)))
    return rms, n, mean
