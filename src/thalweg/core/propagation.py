"""First-order propagation through a chain of frames: the one formula behind every predicted sigma.

A point known in the innermost frame goes outwards through links (P2 eq. 3, T 3.1.1)::

    x_0 = T_01 T_12 ... x_k,        T_ij: x_i = R_ij x_j + t_ij

Each link errs by a shift ``dt`` and by a small rotation vector ``dtheta``, both in its *outer* frame, so that
``R_true = exp([dtheta]x) R``. The point itself errs by ``dx``. To first order::

    dx_0 = sum over links of  P ( dt + dtheta x (R_ij x_j) )  +  P_k dx,       P = R_01 ... R_(i-1)i

which is ``J`` of ``cov = J S J^T`` (P2 eq. 8). `thalweg.lidar.covariance` is this chain with two links, error
budgets (`thalweg.budgets`) are it with any number.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayF

SHIFT: Final = slice(0, 3)
TURN: Final = slice(3, 6)
"""Columns of the derivatives by a link: three of the shift, three of the small rotation vector."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """One transform of the chain: ``x_outer = rotation @ x_inner + shift_m``.

    Parameters
    ----------
    rotation : (3, 3), or (n, 3, 3) if each point has its own.
    shift_m : (3,) or (n, 3), the inner origin in the outer frame.
    """

    rotation: ArrayF
    shift_m: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class Chain:
    """Points of a chain in its outermost frame, and their derivatives.

    ``points_m`` (n, 3); ``by_link``, for each link from the outermost inwards, (n, 3, 6) by shift and by
    rotation vector in the link's outer frame; ``by_point`` (n, 3, 3) by the coordinates in the innermost
    frame, which is the rotation of the whole chain.
    """

    points_m: ArrayF
    by_link: tuple[ArrayF, ...]
    by_point: ArrayF


def chain_derivatives(links: Sequence[Link], points_m: ArrayLike) -> Chain:
    """Points of the innermost frame in the outermost one, with the derivatives of P2 eq. 8.

    Parameters
    ----------
    links : from the outermost frame inwards; at least one.
    points_m : (n, 3) in the innermost frame.

    Raises
    ------
    GeometryError : no link, or shapes that do not match.
    """
    x = np.asarray(points_m, dtype=np.float64)
    n = len(x) if x.ndim == 2 else -1
    if n < 0 or x.shape[1] != 3 or not links:
        raise GeometryError(
            f"{len(links)} links and points of the shape {x.shape}",
            expected="at least one link, (n, 3) points",
        )
    for k, link in enumerate(links):
        turn, shift = np.shape(link.rotation), np.shape(link.shift_m)
        if turn not in ((3, 3), (n, 3, 3)) or shift not in ((3,), (n, 3)):
            raise GeometryError(
                f"link {k} has a rotation {turn} and a shift {shift} for {n} points",
                expected="(3, 3) or (n, 3, 3), and (3,) or (n, 3)",
            )
    arms: list[ArrayF] = []
    for link in reversed(links):
        arms.append(_turned(link.rotation, x))
        x = arms[-1] + link.shift_m
    by_link: list[ArrayF] = []
    outer: ArrayF | None = None
    for link, arm in zip(links, reversed(arms), strict=True):
        J = np.empty((n, 3, 6))
        turn_part = -cross_matrix(arm)
        J[:, :, SHIFT] = np.eye(3) if outer is None else outer
        J[:, :, TURN] = turn_part if outer is None else outer @ turn_part
        by_link.append(J)
        outer = link.rotation if outer is None else outer @ link.rotation
    assert outer is not None
    return Chain(points_m=x, by_link=tuple(by_link), by_point=np.broadcast_to(outer, (n, 3, 3)))


def propagated(jacobian: ArrayF, covariance: ArrayF) -> ArrayF:
    """Covariance (n, 3, 3) of points: ``J S J^T`` (P2 eq. 8 with all correlations).

    Parameters
    ----------
    jacobian : (n, 3, k).
    covariance : (k, k) or (n, k, k) of the inputs.
    """
    return np.asarray(jacobian @ covariance @ np.swapaxes(jacobian, 1, 2))


def cross_matrix(a: ArrayF) -> ArrayF:
    """``[a]x`` (n, 3, 3), so that ``[a]x b = a x b``, of vectors (n, 3)."""
    out = np.zeros((len(a), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -a[:, 2], a[:, 1], -a[:, 0]
    return out - np.swapaxes(out, 1, 2)


def beam_axes(beam: ArrayF) -> ArrayF:
    """Unit vectors along beams (n, 3) and in two directions across them, as columns (n, 3, 3), right-handed.

    The two directions across are free. The first is perpendicular to the coordinate axis from which the beam
    is farthest, so that it is defined for every beam.
    """
    along = beam / np.linalg.norm(beam, axis=1, keepdims=True)
    least = np.argmin(np.abs(along), axis=1)
    first = np.cross(along, np.eye(3)[least])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([along, first, np.cross(along, first)], axis=2)


def _turned(rotation: ArrayF, x: ArrayF) -> ArrayF:
    return x @ rotation.T if rotation.ndim == 2 else np.einsum("nij,nj->ni", rotation, x)
