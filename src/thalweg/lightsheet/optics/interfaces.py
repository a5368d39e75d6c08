"""Refraction of single rays in vector form: Snell's law in space, and paths through a plate.

For a unit direction v in the medium 1 and a unit normal N against it (Glassner 1989)::

    r = n_1 / n_2,   c = -N . v,   v' = r v + (r c - sqrt(1 - r^2 (1 - c^2))) N

with total reflection where the root has no real value. P3 and P4 print ``1 + r^2 (c - 1)^2`` under the root
(their eq. 1), which is right at normal incidence only and never finds total reflection: the square of
Glassner's ``1 + r^2 (c^2 - 1)`` stands on the wrong bracket.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import ArrayB, ArrayF
from thalweg.lightsheet.optics.sensor import Window


@dataclass(frozen=True, slots=True, kw_only=True)
class Path:
    """Rays from air through the window into the water, all in lcs; NaN from total reflection on.

    ``at_inner_mm``, ``at_outer_mm`` (n, 3) points on the faces; ``in_glass``, ``in_water`` (n, 3) unit
    directions; ``total_reflection`` (n,) at either face; ``away`` (n,) true for rays that never meet the
    window.
    """

    at_inner_mm: ArrayF
    at_outer_mm: ArrayF
    in_glass: ArrayF
    in_water: ArrayF
    total_reflection: ArrayB
    away: ArrayB

    def at_depth(self, depth_mm: ArrayLike, window: Window) -> ArrayF:
        """Points (n, 3) of the rays at depths (n,) or one depth below the outer face."""
        step = np.asarray(depth_mm, dtype=np.float64) / -(self.in_water @ window.normal_lcs)
        return np.asarray(self.at_outer_mm + self.in_water * step[:, None])


def refract(directions: ArrayLike, normals: ArrayLike, n_1: float, n_2: float) -> tuple[ArrayF, ArrayB]:
    """Directions behind a surface between two media.

    Parameters
    ----------
    directions : (n, 3) unit vectors in the first medium.
    normals : (n, 3) or (3,) unit vectors, to either side.
    n_1, n_2 : refractive indices of the first and the second medium.

    Returns
    -------
    (n, 3) unit vectors in the second medium, NaN at total reflection, and (n,) true at total reflection.

    Examples
    --------
    >>> behind, lost = refract([[0.6, 0.0, -0.8]], [0.0, 0.0, 1.0], 1.0, 1.5)
    >>> behind.round(6), lost
    (array([[ 0.4     ,  0.      , -0.916515]]), array([False]))
    """
    v = np.atleast_2d(np.asarray(directions, dtype=np.float64))
    N = np.broadcast_to(np.asarray(normals, dtype=np.float64), v.shape)
    c = -np.einsum("ni,ni->n", N, v)
    N, c = np.where(c < 0, -1.0, 1.0)[:, None] * N, np.abs(c)
    r = n_1 / n_2
    # the sine from the part of the ray along the surface: 1 - c^2 would lose digits near the normal
    across = v + c[:, None] * N
    root = 1.0 - r * r * np.einsum("ni,ni->n", across, across)
    lost = root < 0.0
    with np.errstate(invalid="ignore"):
        out = r * across - np.sqrt(np.where(lost, np.nan, root))[:, None] * N
    return out, lost


def trace(origin_mm: ArrayLike, directions: ArrayLike, window: Window) -> Path:
    """Follow rays from air through both faces of the window.

    Parameters
    ----------
    origin_mm : (3,) or (n, 3) in lcs, on the dry side.
    directions : (n, 3) unit vectors in air, lcs.
    window : the plate.
    """
    v = np.atleast_2d(np.asarray(directions, dtype=np.float64))
    start = np.broadcast_to(np.asarray(origin_mm, dtype=np.float64), v.shape)
    N = window.normal_lcs
    away = ~(v @ N < 0.0)
    v = np.where(away[:, None], np.nan, v)
    inner = start - v * ((start @ N) / (v @ N))[:, None]
    glass, first = refract(v, N, window.n_air, window.n_glass)
    outer = inner - glass * (window.thickness_mm / (glass @ N))[:, None]
    water, second = refract(glass, N, window.n_glass, window.n_water)
    return Path(
        at_inner_mm=inner,
        at_outer_mm=outer,
        in_glass=glass,
        in_water=water,
        total_reflection=first | second,
        away=away,
    )
