"""How the errors of the poses of a trajectory hang together over time.

A trajectory holds the covariance of each pose. What two poses have in common is here: independent parts
(`ErrorChain`), each of them a Markov chain over nodes,

    e(t_k) = root_k z_k,      z_k = link_k z_(k-1) + noise,      cov z_k = 1,

so that the covariance of the errors of two nodes i < k is ``root_k link_k ... link_(i+1) root_i'``. Between
nodes errors are interpolated linearly. A smoother's errors are such a chain (Rauch, Tung and Striebel 1965),
and so are those of photographs of a series, of their times and of their clock.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final, Self

import numpy as np
from scipy.optimize import brentq

from thalweg.core.errors import GeometryError, InputError
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import AnyArray, ArrayF, ArrayI

_LEAST: Final = 1e-9
"""Eigenvalues of a correlation matrix below this are rounding."""
_MOST_ALIKE: Final = 1.0 - 1e-12
"""Greatest correlation of two nodes of a chain whose errors change."""
_AT_ONCE: Final = 2000
"""Nodes whose matrices are taken apart at once: some 100 MB."""
_SHORTEST: Final = 1e-4
"""Shortest correlation time, and one over the longest one, in spans of a survey."""
_PLACES: Final = 600
"""Times at which errors of heights are compared over a survey."""
_LEAST_ALIKE: Final = 0.02
"""Correlation below which two errors are taken as this much alike, so that no piece of time is endless."""
_SAME_S: Final = 1e-6
"""Nodes that are nearer are one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorChain:
    """One part of the errors of poses, independent of the other parts.

    Attributes
    ----------
    name : what errs.
    t_gps_s : (m,) times of the nodes, ascending. Two nodes of one time are a jump.
    root : (m, 6, d) the error of the pose (shift of the ics origin, small rotation; wcs, metres and radians)
        is ``root z`` with d independent components of unit variance.
    link : (m, d, d) covariance of the components of a node with those of the node before; that of the first
        node is not used.

    Raises
    ------
    GeometryError : no node, shapes that differ, or times that go back.
    """

    name: str
    t_gps_s: ArrayF
    root: ArrayF
    link: ArrayF

    def __post_init__(self) -> None:
        m, d = len(self.t_gps_s), self.root.shape[-1]
        if not m or self.root.shape != (m, 6, d) or self.link.shape != (m, d, d):
            raise GeometryError(
                f"errors of the {self.name}: {m} times, roots {self.root.shape}, links {self.link.shape}",
                expected="(m,) times with m > 0, (m, 6, d) and (m, d, d)",
            )
        if (np.diff(self.t_gps_s) < 0).any():
            raise GeometryError(f"errors of the {self.name}: times that go back", expected="ascending times")

    def between(self, t_gps_s: ArrayF) -> tuple[ArrayI, ArrayI, ArrayF]:
        """Nodes left and right of times (n,), and the share of the right one; the nearest one outside."""
        right = np.searchsorted(self.t_gps_s, t_gps_s, side="right")
        left = np.clip(right - 1, 0, len(self.t_gps_s) - 1)
        right = np.clip(right, 0, len(self.t_gps_s) - 1)
        gap = self.t_gps_s[right] - self.t_gps_s[left]
        share = np.where(gap > 0, (t_gps_s - self.t_gps_s[left]) / np.where(gap > 0, gap, 1.0), 0.0)
        return left, right, share

    def covariance_at(self, t_gps_s: ArrayF) -> ArrayF:
        """Covariance (n, 6, 6) of the interpolated error at times (n,)."""
        left, right, share = self.between(t_gps_s)
        u = share[:, None, None]
        one, two = (1 - u) * self.root[left], u * self.root[right]
        mixed = two @ self.link[right] @ np.swapaxes(one, 1, 2)
        mixed = np.where((left == right)[:, None, None], 0.0, mixed)
        own = one @ np.swapaxes(one, 1, 2) + two @ np.swapaxes(two, 1, 2)
        return np.asarray(own + mixed + np.swapaxes(mixed, 1, 2))

    def heights_over_time(self) -> tuple[ArrayF, ArrayF]:
        """Variance (m,) of the height's error at each node, m2, and its integral over time (m,), m2 s.

        The integral is that of the covariance with the heights at all nodes, by trapezia.
        """
        up, m = self.root[:, 2], len(self.t_gps_s)
        gap = np.diff(self.t_gps_s) / 2
        weighted = up * (np.append(gap, 0.0) + np.append(0.0, gap))[:, None]
        before, after = np.zeros_like(up), np.zeros_like(up)
        for k in range(1, m):
            before[k] = self.link[k] @ (before[k - 1] + weighted[k - 1])
            after[m - 1 - k] = self.link[m - k].T @ (after[m - k] + weighted[m - k])
        return np.asarray(np.sum(up**2, axis=1)), np.asarray(np.sum(up * (before + weighted + after), axis=1))

    def heights_along(self, t_gps_s: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Variance (n,) of the height's error at the nodes next to ascending times, covariance (n - 1,)."""
        left, right, share = self.between(t_gps_s)
        node = np.where(share < 0.5, left, right)
        up = self.root[node, 2]
        following = np.empty(len(node) - 1)
        for k in range(len(node) - 1):
            kept = up[k]
            for j in range(node[k] + 1, node[k + 1] + 1):
                kept = self.link[j] @ kept
            following[k] = up[k + 1] @ kept
        return np.asarray(np.sum(up**2, axis=1)), following

    @classmethod
    def of_covariances(
        cls, name: str, t_gps_s: ArrayF, cov: ArrayF, following: ArrayF, pose: ArrayF, *, step_s: float
    ) -> Self:
        """A chain of states with known covariances, thinned.

        Parameters
        ----------
        name : what errs.
        t_gps_s : (m,) times of all nodes.
        cov, following : (m, n, n) covariance of the states of a node, and with those of the next node (rows:
            this node).
        pose : (m, 6, k) derivative of the pose to the first k states.
        step_s : nodes nearer to the one before are left out; the last one stays.
        """
        kept, roots, chain = [0], [], [np.zeros(cov.shape[1:])]
        link = np.eye(cov.shape[1])
        last = len(t_gps_s) - 1
        for first in range(0, last + 1, _AT_ONCE):
            # the last node of a piece is the first one of the next
            own = cov[first : first + _AT_ONCE + 1]
            root, inverse = _root_and_inverse(own)
            raw = inverse[1:] @ np.swapaxes(following[first : first + len(own) - 1], 1, 2)
            left, alike, right = np.linalg.svd(raw @ np.swapaxes(inverse[:-1], 1, 2))
            links = (left * np.minimum(alike, 1.0)[:, None, :]) @ right
            if first == 0:
                roots.append(root[0, : pose.shape[2]])
            for k in range(first + 1, first + len(own)):
                link = links[k - first - 1] @ link
                if t_gps_s[k] - t_gps_s[kept[-1]] >= step_s or k == last:
                    kept.append(k)
                    roots.append(root[k - first, : pose.shape[2]])
                    chain.append(link)
                    link = np.eye(cov.shape[1])
        return cls(name=name, t_gps_s=t_gps_s[kept], root=pose[kept] @ np.array(roots), link=np.array(chain))


def _root_and_inverse(cov: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Roots (m, n, n) of covariances and their pseudo-inverses."""
    scale = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 0.0))
    scale = np.where(scale > 0, scale, 1.0)
    value, vector = np.linalg.eigh(cov / scale[:, :, None] / scale[:, None, :])
    shown = value > _LEAST * value[:, -1:]
    size = np.where(shown, np.sqrt(np.maximum(value, 0.0)), 0.0)
    inverse = np.swapaxes(vector / np.where(shown, size, np.inf)[:, None, :], 1, 2) / scale[:, None, :]
    return scale[:, :, None] * vector * size[:, None, :], inverse


def covariance_of_means(chains: Sequence[ErrorChain], edges_s: ArrayF) -> ArrayF:
    """Covariance (6 b, 6 b) of the mean errors in spans of time, all chains together.

    Means are over time, of the errors as they are interpolated between nodes: errors that are new at each
    node, one a span, have half the variance of the nodes, and neighbouring means are alike.

    Parameters
    ----------
    chains : of all errors of the poses.
    edges_s : (b + 1,) ascending; before the first node and after the last one errors are theirs.
    """
    n_spans = len(edges_s) - 1
    total = np.zeros((6 * n_spans, 6 * n_spans))
    for chain in chains:
        # The mean over a piece of time between nodes and edges is the error in its middle: what `of_two`
        # makes of the components (2 d) of the nodes left and right of it.
        d = chain.root.shape[2]
        inside = (chain.t_gps_s > edges_s[0]) & (chain.t_gps_s < edges_s[-1])
        cuts = np.unique(np.concatenate([edges_s, chain.t_gps_s[inside]]))
        middle = (cuts[1:] + cuts[:-1]) / 2
        span = np.searchsorted(edges_s, middle) - 1
        left, right, share = chain.between(middle)
        share = share[:, None, None]
        of_two = np.concatenate([(1 - share) * chain.root[left], share * chain.root[right]], axis=2)
        of_two *= (np.diff(cuts) / np.diff(edges_s)[span])[:, None, None]
        alike = np.where((left < right)[:, None, None], chain.link[right], np.eye(d))
        # covariances of the components of a piece with the means of all spans before it
        so_far = np.zeros((2 * d, 0))
        first = np.flatnonzero(np.diff(span, prepend=-1))
        for start, stop in pairwise([*first.tolist(), len(span)]):
            row = slice(so_far.shape[1], so_far.shape[1] + 6)
            # with its own span so far; that span's mean so far by the components of its first piece
            own, mean, through = np.zeros((2 * d, 6)), np.zeros((6, 2 * d)), np.eye(2 * d)
            for k in range(start, stop):
                if k and (left[k] != left[k - 1] or right[k] != right[k - 1]):
                    on = _onward(chain, right[k - 1], left[k], alike[k])
                    own, through = on @ own, on @ through
                crossed = of_two[k] @ own
                one, other = of_two[k, :, :d].T, of_two[k, :, d:].T
                piece = np.concatenate([one + alike[k].T @ other, alike[k] @ one + other])
                own = own + piece
                mean += of_two[k] @ through
                total[row, row] += crossed + crossed.T + of_two[k] @ piece
            total[row, : row.start] += mean @ so_far
            total[: row.start, row] = total[row, : row.start].T
            so_far = np.concatenate([through @ so_far, own], axis=1)
    return total


def _onward(chain: ErrorChain, right: int, node: int, alike: ArrayF) -> ArrayF:
    """What the components (2 d) of two nodes, the later of them ``right``, tell of those of ``node`` and the
    next one, which are ``alike``.
    """
    d = len(alike)
    on, step = np.zeros((2 * d, 2 * d)), np.eye(d)
    for k in range(right + 1, node + 1):
        step = chain.link[k] @ step
    on[:d, d:], on[d:, d:] = step, alike @ step
    return on


def even_time(chains: Sequence[ErrorChain]) -> tuple[ArrayF, ArrayF, float]:
    """A time in which errors of heights decay evenly, for what holds one process of one correlation time.

    The correlation time ``tau`` is that with which the errors ``C(t, u)`` of the heights at two times have
    the same sum over the survey, ``int C(t, t) exp(-|t - u| / tau) dt du = int C(t, u) dt du``: means of many
    heights keep their variance. The even time runs from one ``tau`` to the next by the logarithm of their
    correlation, and is as long as the survey. It is exact where errors are a Gauss-Markov process of any
    rate; other correlations are kept at lags of about ``tau`` alone.

    Parameters
    ----------
    chains : of all errors of the poses.

    Returns
    -------
    t_gps_s : (k,) ascending.
    even_s : (k,) even time there.
    time_s : correlation time in it.

    Raises
    ------
    GeometryError : no errors of heights, or all at one time.
    """
    nodes = np.concatenate([chain.t_gps_s for chain in chains])
    t = np.linspace(nodes.min(), nodes.max(), _PLACES)
    span = float(t[-1] - t[0])
    variance, summed = np.zeros(len(t)), np.zeros(len(t))
    for chain in chains:
        own, whole = chain.heights_over_time()
        variance += np.interp(t, chain.t_gps_s, own)
        summed += np.interp(t, chain.t_gps_s, whole)
    if not span > 0 or not variance.any():
        raise GeometryError("no errors of heights over time", expected="nodes at several times that err")

    def correlation_time_s(even_s: ArrayF) -> float:
        """Time with which the sum over the survey is that of the chains."""
        lag = np.abs(even_s[:, None] - even_s)

        def beyond(log_s: float) -> float:
            """Sum over the survey with this correlation time less that of the chains."""
            alike = np.exp(-lag / np.exp(log_s)).mean(axis=1)
            return float(variance @ alike * span - summed.sum())

        low, high = np.log(span * _SHORTEST), np.log(span / _SHORTEST)
        if beyond(low) >= 0 or beyond(high) <= 0:
            return float(np.exp(low if beyond(low) >= 0 else high))
        return float(np.exp(brentq(beyond, low, high)))

    at = np.linspace(t[0], t[-1], max(int(span / correlation_time_s(t)), 1) + 1)
    own, next_one = (sum(each) for each in zip(*(chain.heights_along(at) for chain in chains), strict=True))
    size = np.sqrt(np.maximum(own[1:] * own[:-1], (_LEAST * own.max()) ** 2))
    aged = -np.log(np.clip(next_one / size, _LEAST_ALIKE, 1 - _LEAST_ALIKE))
    even = np.concatenate([[0.0], np.cumsum(aged)])
    even = at[0] + even * span / even[-1]
    return at, even, correlation_time_s(np.interp(t, at, even))


def with_rest(
    trajectory: Trajectory, chains: Sequence[ErrorChain], fixed_gps_s: ArrayF, *, step_s: float
) -> list[ErrorChain]:
    """Chains of the errors of a trajectory, with one more for what they do not explain of its covariance.

    Between fixed times other errors may grow and shrink again (those of an INS between photographs). They are
    zero at these times and correlated between two of them as a Brownian bridge is: ``sqrt(s (T - t) / (t (T -
    s)))`` at times s < t of a gap of length T.

    Parameters
    ----------
    trajectory : with the covariance of all errors.
    chains : what is known.
    fixed_gps_s : (k,) ascending times at which the chains are all; k > 0.
    step_s : least interval of the nodes of the rest.
    """
    node = fixed_gps_s
    t = trajectory.t_gps_s[trajectory.valid]
    kept = np.unique(np.floor((t - t[0]) / step_s), return_index=True)[1] if len(t) else np.zeros(0, int)
    t = np.unique(np.concatenate([t[kept], node, *(chain.t_gps_s for chain in chains)]))
    t = t[np.append(True, np.diff(t) > _SAME_S)]
    gap = np.clip(np.searchsorted(node, t + _SAME_S, side="right") - 1, 0, max(len(node) - 2, 0))
    begin, end = node[gap], node[np.minimum(gap + 1, len(node) - 1)]
    since, left = t - begin, end - t
    at_node = (np.abs(since) < _SAME_S) | (np.abs(left) < _SAME_S)
    whole = trajectory.cov_at(t)
    rest = whole - sum(chain.covariance_at(t) for chain in chains)
    rest[at_node] = 0.0
    left_over, total = (np.diagonal(each, axis1=1, axis2=2) for each in (rest, whole))
    if not (left_over > _LEAST * total).any():
        return list(chains)
    _, R, _ = trajectory.at(np.clip(t, trajectory.t_gps_s[0], trajectory.t_gps_s[-1]))
    axes = np.zeros((len(t), 6, 6))
    axes[:, :3, :3] = axes[:, 3:, 3:] = R
    root = symmetric_roots(rest, axes)
    share = np.zeros(len(t))
    same = (gap[1:] == gap[:-1]) & ~at_node[1:] & ~at_node[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        bridge = np.sqrt(since[:-1] * left[1:] / (since[1:] * left[:-1]))
        # outside of the nodes nothing holds the other end
        ratio = np.where((left[1:] > 0) & (since[:-1] > 0), bridge, 1.0)
    share[1:] = np.where(same, np.minimum(ratio, _MOST_ALIKE), 0.0)
    link = share[:, None, None] * np.eye(6)
    return [*chains, ErrorChain(name="between the nodes", t_gps_s=t, root=root, link=link)]


def symmetric_roots(cov: ArrayF, axes: ArrayF) -> ArrayF:
    """Roots L (m, k, k) of covariances, semi-definite ones too, whose components keep to axes.

    Between two moments errors have the covariance ``L(t) L(t')' exp(-|t - t'| / tau)``: any root has the
    variances of single moments, but only one whose components are the same errors at all moments has this.
    Here it is the symmetric root in the axes (m, k, k) in which the error lasts (columns: their directions in
    the world): those of the boat for what turns with it, of the world for antennas.
    """
    turned = np.swapaxes(axes, 1, 2) @ cov @ axes
    # metres beside radians: in one scale for all moments, as a root in other units is another root
    scale = np.sqrt(np.maximum(np.diagonal(turned, axis1=1, axis2=2), 0.0).mean(axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(turned / scale[:, None] / scale)
    own = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return np.asarray(axes @ (scale[:, None] * own))


def write_chains(path: Path, chains: Sequence[ErrorChain]) -> None:
    """Write chains as npz; roots and links in single precision."""
    arrays: dict[str, AnyArray] = {"names": np.array([chain.name for chain in chains])}
    for i, chain in enumerate(chains):
        arrays |= {
            f"t_gps_s_{i}": chain.t_gps_s,
            f"root_{i}": chain.root.astype(np.float32),
            f"link_{i}": chain.link.astype(np.float32),
        }
    np.savez_compressed(path, allow_pickle=False, **arrays)


def read_chains(path: Path) -> list[ErrorChain]:
    """Read what `write_chains` wrote.

    Raises
    ------
    InputError : the file holds no chains of errors.
    """
    with np.load(path) as stored:
        if "names" not in stored:
            raise InputError("no errors of poses", where=path, expected="a file of `write_chains`")
        return [
            ErrorChain(
                name=str(name),
                t_gps_s=stored[f"t_gps_s_{i}"],
                root=stored[f"root_{i}"].astype(np.float64),
                link=stored[f"link_{i}"].astype(np.float64),
            )
            for i, name in enumerate(stored["names"])
        ]
