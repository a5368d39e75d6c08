"""Flow coordinates: ``s`` along the centre line, downstream, ``n`` across it, positive to the left.

The centre line is an interpolating cubic spline in its own arc length. ``s`` of a place is the foot of the
perpendicular, found by Newton's method from the nearest of many places on the line:

    f(s) = (p - c(s)) . c'(s) = 0,        f'(s) = (p - c(s)) . c''(s) - c'(s) . c'(s).

Where ``|kappa n|`` comes near one, neighbouring perpendiculars meet: the coordinates fold, which is said.
Merwade et al. (2006, Advances in Water Resources 29) interpolate river beds in such coordinates.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from thalweg.core import ArrayB, ArrayF, GeometryError, InputError

_FOLD: Final = 0.9
"""Curvature times distance from which coordinates count as folded."""
_OFF_M: Final = 1e-6
"""A place whose foot is not perpendicular by more than this lies beyond an end of the line."""
_STARTS: Final = 40
"""Places of the line a knot from which Newton's method may start."""
_STEPS: Final = 40
_GAUSS: Final = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True, slots=True, kw_only=True)
class FlowLine:
    """A centre line.

    Parameters
    ----------
    points_m : (k, 2) east and north of the places it goes through, downstream.
    spline : of the places over arc length.
    length_m : of the line.
    tree, starts_m : places from which projections start.
    """

    points_m: ArrayF
    spline: Any
    length_m: float
    tree: Any
    starts_m: ArrayF

    @classmethod
    def through(cls, points_m: ArrayLike) -> Self:
        """A line through places (k, 2).

        Raises
        ------
        GeometryError : fewer than three different places, or places that are no numbers.
        """
        p = np.asarray(points_m, dtype=np.float64)
        if p.ndim != 2 or p.shape[1] != 2 or not np.isfinite(p).all():
            raise GeometryError(f"a centre line of shape {p.shape}", expected="places (k, 2), all numbers")
        p = p[np.concatenate([[True], np.linalg.norm(np.diff(p, axis=0), axis=1) > 1e-9])]
        if len(p) < 3:
            raise GeometryError(f"a centre line of {len(p)} places", expected="at least three")
        u = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
        nodes, weights = _GAUSS
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                for _ in range(8):  # the parameter becomes arc length
                    spline = CubicSpline(u, p)
                    h = np.diff(u)
                    speed = np.linalg.norm(spline(u[:-1, None] + h[:, None] / 2 * (1 + nodes), 1), axis=2)
                    before, u = u, np.concatenate([[0.0], np.cumsum(speed @ weights * h / 2)])
                    if np.abs(u - before).max() < 1e-12 * u[-1]:
                        break
                spline = CubicSpline(u, p)
                starts = np.linspace(0.0, u[-1], _STARTS * len(u))
                tree = cKDTree(spline(starts))
        except ValueError as error:  # lengths that do not grow, or places that are not finite
            raise GeometryError(
                f"a centre line through {len(p)} places that go to and fro",
                expected="places one after the other, downstream, none of them far away from the others",
                cure="Look for places of another river, or in degrees",
            ) from error
        return cls(points_m=p, spline=spline, length_m=float(u[-1]), tree=tree, starts_m=starts)

    def to_flow(self, places_m: ArrayLike) -> tuple[ArrayF, ArrayF, ArrayB]:
        """Flow coordinates of places (m, 2).

        Returns
        -------
        s_m, n_m : (m,).
        fold : (m,) true beyond the ends of the line, and where perpendiculars meet: the place has several.
        """
        p = np.asarray(places_m, dtype=np.float64).reshape(-1, 2)
        if not len(p):
            return np.empty(0), np.empty(0), np.empty(0, dtype=np.bool_)
        s = self.starts_m[self.tree.query(p)[1]]
        left = np.arange(len(p))
        for _ in range(_STEPS):
            at = s[left]
            d, t, k = p[left] - self.spline(at), self.spline(at, 1), self.spline(at, 2)
            slope = np.minimum(np.sum(d * k, axis=1) - np.sum(t * t, axis=1), -0.05)
            step = np.clip(np.sum(d * t, axis=1) / slope, -1.0, 1.0)
            s[left] = np.clip(at - step, 0.0, self.length_m)
            # a place at an end of the line stays there however long it is pushed
            left = left[np.abs(s[left] - at) >= 1e-12]
            if not len(left):
                break
        tangent, normal = self._frame(s)
        d = p - self.spline(s)
        n = np.sum(d * normal, axis=1)
        off = np.abs(np.sum(d * tangent, axis=1)) > _OFF_M
        return s, n, off | (np.abs(self.curvature(s) * n) >= _FOLD)

    def to_map(self, s_m: ArrayLike, n_m: ArrayLike) -> ArrayF:
        """Places (m, 2) of flow coordinates."""
        s, n = np.broadcast_arrays(np.asarray(s_m, dtype=np.float64), np.asarray(n_m, dtype=np.float64))
        return np.asarray(self.spline(s) + n[..., None] * self._frame(s)[1])

    def curvature(self, s_m: ArrayLike) -> ArrayF:
        """Curvature (m,), 1/m, positive to the left."""
        t, k = self.spline(np.asarray(s_m), 1), self.spline(np.asarray(s_m), 2)
        cross = t[..., 0] * k[..., 1] - t[..., 1] * k[..., 0]
        return np.asarray(cross / np.linalg.norm(t, axis=-1) ** 3)

    def _frame(self, s: ArrayF) -> tuple[ArrayF, ArrayF]:
        t = self.spline(s, 1)
        t = t / np.linalg.norm(t, axis=-1, keepdims=True)
        return t, np.stack([-t[..., 1], t[..., 0]], axis=-1)

    def write(self, path: Path) -> None:
        """As CSV: east_m, north_m, the same line when it is read again."""
        pd.DataFrame(self.points_m, columns=["east_m", "north_m"]).to_csv(
            path, index=False, float_format="%.9f"
        )

    @classmethod
    def read(cls, path: Path) -> Self:
        """What `write` wrote.

        Raises
        ------
        InputError : the file is no such table.
        """
        try:
            table = pd.read_csv(path)[["east_m", "north_m"]]
        except (OSError, ValueError, KeyError) as error:
            raise InputError(f"{error}", where=path, expected="CSV with east_m, north_m") from error
        return cls.through(table.to_numpy(np.float64))
