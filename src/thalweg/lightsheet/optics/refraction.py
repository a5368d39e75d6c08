"""Rays behind a plane-parallel window in closed form.

Along a ray through parallel faces ``q = n d_xy``, the index times the part of the unit direction along the
faces, stays the same in every medium. A ray from the height h above the inner face is therefore, in the frame
of the window and at the depth D below the outer face, a straight line in D::

    XY(D) = O_xy + q (h / sqrt(n_air^2 - q^2) + t / sqrt(n_glass^2 - q^2) + D / sqrt(n_water^2 - q^2))
          = A + B D,            q^2 = |q|^2

without vectors or normals; a tilt of the window only turns the ray into the window's frame first. Total
reflection is ``q^2 >= n^2``. `thalweg.lightsheet.optics.interfaces` has the same path step by step.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import ArrayF, ArrayU8, get_num_threads, njit, prange, set_num_threads
from thalweg.lightsheet.optics.sensor import Window

_EACH: Final = 16384
"""Points for a thread."""


class Status(IntEnum):
    """Why there is no number; only `OK` has one."""

    OK = 0
    NO_SHEET = 1
    """The ray meets no sub-beam of the fan."""
    ABOVE_WINDOW = 2
    """The ray does not go to the water, or meets the sheet before it."""
    GRAZING = 3
    """The ray runs along the window or along the sheet: no depth worth the name."""
    TOTAL_REFLECTION = 4
    OUTSIDE_LENS = 5
    """The lens model has no ray for this pixel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WaterRays:
    """Rays in the water: ``XY = A + B D`` in the frame of the window.

    ``A`` (n, 2) mm, ``B`` (n, 2); NaN where ``status`` (n,) is not `Status.OK`.
    """

    A: ArrayF
    B: ArrayF
    status: ArrayU8
    window: Window

    def at_depth(self, depth_mm: ArrayLike) -> ArrayF:
        """Points (n, 3) in lcs at depths (n,), or one depth, below the outer face."""
        D = np.broadcast_to(np.asarray(depth_mm, dtype=np.float64), (len(self.A),))
        z = -D - self.window.thickness_mm
        local = np.concatenate([self.A + self.B * D[:, None], z[:, None]], axis=1)
        return np.asarray(local @ self.window.R_lcs_window.T)

    def directions(self) -> ArrayF:
        """Unit directions (n, 3) in the water, lcs, downwards."""
        local = np.concatenate([self.B, np.full((len(self.B), 1), -1.0)], axis=1)
        local /= np.linalg.norm(local, axis=1, keepdims=True)
        return np.asarray(local @ self.window.R_lcs_window.T)


def refract_to_water(origins_mm: ArrayLike, directions: ArrayLike, window: Window) -> WaterRays:
    """Rays of the water from rays in air.

    Parameters
    ----------
    origins_mm : (3,) or (n, 3) in lcs, on the dry side.
    directions : (n, 3) unit vectors in air, lcs; NaN for none.
    window : the plate.

    Returns
    -------
    WaterRays, whose status is ABOVE_WINDOW for a ray that goes away from the window, OUTSIDE_LENS for NaN.
    """
    d = np.atleast_2d(np.asarray(directions, dtype=np.float64)) @ window.R_lcs_window
    o = np.broadcast_to(np.asarray(origins_mm, dtype=np.float64) @ window.R_lcs_window, d.shape)
    q = window.n_air * d[:, :2]
    q2 = np.einsum("ni,ni->n", q, q)
    status = np.zeros(len(d), dtype=np.uint8)
    status[q2 >= min(window.n_glass, window.n_water) ** 2] = Status.TOTAL_REFLECTION
    status[~(d[:, 2] < 0.0)] = Status.ABOVE_WINDOW
    status[~np.isfinite(d).all(axis=1)] = Status.OUTSIDE_LENS
    good = status == Status.OK
    q, q2 = np.where(good[:, None], q, np.nan), np.where(good, q2, np.nan)
    air = o[:, 2] / (window.n_air * -np.where(good, d[:, 2], np.nan))
    glass = window.thickness_mm / np.sqrt(window.n_glass**2 - q2)
    A = o[:, :2] + q * (air + glass)[:, None]
    return WaterRays(A=A, B=q / np.sqrt(window.n_water**2 - q2)[:, None], status=status, window=window)


def directions_to_points(origin_mm: ArrayLike, xyz_lcs_mm: ArrayLike, window: Window) -> ArrayF:
    """Unit directions (n, 3) in air, lcs, in which rays leave an origin (3,) that reach points of the water.

    The inverse of `refract_to_water`. NaN for points (n, 3) above the outer face.
    """
    R = window.R_lcs_window
    points = np.ascontiguousarray(np.atleast_2d(np.asarray(xyz_lcs_mm, dtype=np.float64)) @ R)
    origin = np.asarray(origin_mm, dtype=np.float64) @ R
    out = np.empty_like(points)
    media = np.array([window.n_air, window.n_glass, window.n_water, window.thickness_mm])
    with threads_for(len(points), each=_EACH):
        directions_to(points, np.ascontiguousarray(origin), media, out)
    return np.asarray(out @ R.T)


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def directions_to(points: ArrayF, origin: ArrayF, media: ArrayF, out: ArrayF) -> None:
    """Directions ``out`` (n, 3) from ``origin`` to ``points`` (n, 3), all in the frame of the window.

    ``media``: indices of air, glass, water, and the thickness of the glass.
    """
    n_air, n_glass, n_water, thickness = media[0], media[1], media[2], media[3]
    for i in prange(len(points)):
        dx, dy = points[i, 0] - origin[0], points[i, 1] - origin[1]
        depth = -points[i, 2] - thickness
        if -1e-9 < depth < 0.0:  # on the outer face, and turned into its frame by rounding numbers
            depth = 0.0
        r = np.sqrt(dx * dx + dy * dy)
        slope = air_slope(r, origin[2], thickness, depth, n_air / n_glass, n_air / n_water)
        turn = slope / r if r > 0.0 else 0.0
        length = np.sqrt(1.0 + slope * slope)
        out[i, 0], out[i, 1], out[i, 2] = dx * turn / length, dy * turn / length, -1.0 / length


@njit(cache=True, nogil=True, error_model="numpy")
def air_slope(r: float, height: float, glass: float, depth: float, m_glass: float, m_water: float) -> float:
    """Tangent of the angle in air of the ray that gets ``r`` aside on its way through three layers.

    ``h u + t m_g u / sqrt(1 + u^2 (1 - m_g^2)) + D m_w u / sqrt(1 + u^2 (1 - m_w^2)) = r``, m = n_air / n.
    The left side grows with u and, towards denser media, bends down; so Newton's steps from below never pass
    the root. NaN for a negative depth or where total reflection leaves no ray.
    """
    if not depth >= 0.0 or not height > 0.0:
        return np.nan
    e_glass, e_water = 1.0 - m_glass * m_glass, 1.0 - m_water * m_water
    low, high = 0.0, r / height
    least = min(e_glass, e_water)
    if least < 0.0:  # towards a thinner medium there is a critical angle
        high = min(high, np.sqrt(-1.0 / least))
    u = min(r / (height + glass * m_glass + depth * m_water), high)
    for _ in range(100):
        g = np.sqrt(1.0 + u * u * e_glass)
        w = np.sqrt(1.0 + u * u * e_water)
        f = height * u + glass * m_glass * u / g + depth * m_water * u / w - r
        if f < 0.0:
            low = u
        else:
            high = u
        step = f / (height + glass * m_glass / (g * g * g) + depth * m_water / (w * w * w))
        v = u - step
        if not (v >= low and v <= high):
            v = 0.5 * (low + high)
        done = abs(v - u) <= 4e-16 * (1.0 + abs(v))
        u = v
        if done:
            break
    return u


@contextmanager
def threads_for(n: int, *, each: int) -> Iterator[None]:
    """Let compiled loops run in so many threads that each gets at least ``each`` of ``n`` elements.

    The number of threads belongs to the calling thread, and is set back afterwards.

    Examples
    --------
    >>> with threads_for(100, each=4096):
    ...     get_num_threads()
    1
    """
    before = get_num_threads()
    wanted = min(before, max(1, n // each))
    if wanted == before:
        yield
        return
    set_num_threads(wanted)
    try:
        yield
    finally:
        set_num_threads(before)
