"""Targets of a field that contradict it grossly: what the mistake looks like, without approximate values.

Any three targets give a place of the field in closed form; the place that most targets agree with is kept, as
in RANSAC, but over all triples. What agrees with nothing is then explained: exchanged ids, coordinates with
latitude and longitude exchanged, scale bars in another unit.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import Final

import numpy as np

from thalweg.core.rigid import Rigid
from thalweg.core.types import AnyArray, ArrayB, ArrayF

_MOST_TRIPLES: Final = 2000
_LEAST_WIDTH: Final = 0.02
"""Width over length of three targets below which they leave a turn of the field free."""
_SCALES: Final = (0.6, 1.6)
"""The sheets' printed size gives the size of a field, less the error of a nominal focal length."""
_ASKEW: Final = 0.15
"""Median distance over the size of the field up to which an approximate place is one."""
_SIMILAR: Final = 1.01
"""Factor between two scales below which they are no explanation of a gross contradiction."""


def similarity(a: ArrayF, b: ArrayF, *, scaled: bool) -> tuple[float, Rigid]:
    """Factor and ``T`` with ``b = T (factor a)`` by least squares (Umeyama 1991); without scale, factor is 1.

    Parameters
    ----------
    a, b : (n, 3) the same places in two frames, n >= 3.
    scaled : estimate the factor.
    """
    da, db = a - a.mean(axis=0), b - b.mean(axis=0)
    U, s, Vt = np.linalg.svd(db.T @ da)
    mirror = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt)) or 1.0])
    R = (U * mirror) @ Vt
    factor = float((s * mirror).sum() / np.square(da).sum()) if scaled else 1.0
    return factor, Rigid(R=R, shift_m=b.mean(axis=0) - factor * R @ a.mean(axis=0))


def approximate_place(a: ArrayF, b: ArrayF, *, scaled: bool) -> tuple[float, Rigid] | None:
    """The similarity of three places that most others lie nearest to; None if no three belong together.

    Parameters
    ----------
    a, b : (n, 3) the same places in two frames, of about the same size.
    scaled : estimate a factor, too.
    """
    best: tuple[float, ArrayB] | None = None
    size = float(np.sqrt(np.square(a - a.mean(axis=0)).sum(axis=1).mean()))
    for three in _triples(a):
        factor, T = similarity(a[three], b[three], scaled=True)
        if not _SCALES[0] < factor < _SCALES[1]:
            continue
        off = np.linalg.norm(T.apply(factor * a) - b, axis=1)
        cost = float(np.median(off)) + float(off[three].max())
        if best is None or cost < best[0]:
            best = cost, np.asarray(off < _ASKEW * size)
    if best is None or best[0] > 2 * _ASKEW * size or best[1].sum() < 3:
        return None
    return similarity(a[best[1]], b[best[1]], scaled=scaled)


def agreeing(
    pcs: ArrayF, wcs: ArrayF, tolerance_m: ArrayF, *, scaled: bool = False
) -> tuple[ArrayB, ArrayF, float]:
    """Targets that the place of most targets agrees with.

    Parameters
    ----------
    pcs, wcs : (n, 3) targets in the field and by RTK.
    tolerance_m : (n,) distance up to which a target agrees.
    scaled : the scale of the field is free.

    Returns
    -------
    (n,) which agree, (n, 3) RTK minus field [m], and the factor of the scale.
    """
    best: tuple[int, float] | None = None
    kept: AnyArray = np.zeros(len(pcs), np.bool_)
    for three in _triples(pcs):
        factor, T = similarity(pcs[three], wcs[three], scaled=scaled)
        off = np.linalg.norm(T.apply(factor * pcs) - wcs, axis=1)
        near = off <= tolerance_m
        key = int(near.sum()), -float(np.minimum(off, tolerance_m).sum())
        if near[three].all() and (best is None or key > best):
            best, kept = key, near
    everyone: AnyArray = np.ones(len(pcs), np.bool_)
    factor, T = similarity(*(x[kept if best else everyone] for x in (pcs, wcs)), scaled=scaled)
    return kept, wcs - T.apply(factor * pcs), factor


def exchanged(pcs: ArrayF, wcs: ArrayF, tolerance_m: ArrayF) -> tuple[int, int] | None:
    """The two targets whose exchange makes all agree, None if there are none."""
    best: tuple[float, tuple[int, int]] | None = None
    for i, j in combinations(range(len(pcs)), 2):
        order = np.arange(len(pcs))
        order[[i, j]] = j, i
        kept, off, _ = agreeing(pcs, wcs[order], tolerance_m)
        left = float(np.linalg.norm(off, axis=1).sum())
        if kept.all() and (best is None or left < best[0]):
            best = left, (i, j)
    return best[1] if best else None


def other_scale(pcs: ArrayF, wcs: ArrayF, tolerance_m: ArrayF) -> float | None:
    """The factor by which the field is too small if that explains what contradicts, None if not."""
    kept, _, factor = agreeing(pcs, wcs, tolerance_m, scaled=True)
    clear = max(factor, 1 / factor) > _SIMILAR if factor > 0 else False
    return factor if clear and kept.all() else None


def distances_words(names: Sequence[str], off_m: ArrayF) -> str:
    """Names with the lengths of their residuals (n, 3), the largest first."""
    length = np.linalg.norm(off_m, axis=1)
    return ", ".join(f"{names[k]} {length[k]:.2f} m" for k in np.argsort(-length, kind="stable"))


def _triples(places: ArrayF) -> list[AnyArray]:
    """Indices of triples that span a triangle; an even choice of them if there are very many."""
    every = np.array(list(combinations(range(len(places)), 3)), dtype=np.int64).reshape(-1, 3)
    chosen = every[:: max(1, -(-len(every) // _MOST_TRIPLES))]
    three = places[chosen]
    size = np.linalg.svd(three - three.mean(axis=1, keepdims=True), compute_uv=False)
    return list(chosen[size[:, 1] > _LEAST_WIDTH * size[:, 0]])
