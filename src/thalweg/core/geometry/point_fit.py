"""Rotation, shift and scale between the same points in two frames, in closed form."""

import numpy as np

from thalweg.core import ArrayF


def fit_points(source: ArrayF, target: ArrayF, *, scaled: bool = False) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Motion of least squares, ``target = scale R source + shift`` (Kabsch 1976; with scale Umeyama 1991).

    Parameters
    ----------
    source, target : (..., n, 3) the same points in two frames, one unit; each set of points has its own fit.
    scaled : estimate the scale; otherwise it is 1.

    Returns
    -------
    R : (..., 3, 3) the best proper rotation, also where a mirrored one would fit better. Points on a line
        leave the turn about it open: R is then one of the rotations that fit equally well.
    shift : (..., 3) in the unit of the points.
    scale : (...,) above 0; 0 where target points coincide, NaN where those of the source do.

    Examples
    --------
    >>> points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    >>> R, shift, scale = fit_points(points, 2 * points + 5, scaled=True)
    >>> float(scale), shift.tolist()
    (2.0, [5.0, 5.0, 5.0])
    """
    a, b = source.mean(axis=-2), target.mean(axis=-2)
    da, db = source - a[..., None, :], target - b[..., None, :]
    R, along = _rotation(np.swapaxes(db, -1, -2) @ da)
    with np.errstate(invalid="ignore"):
        scale = along / np.square(da).sum(axis=(-1, -2)) if scaled else np.ones_like(along)
    return R, b - scale[..., None] * (R @ a[..., None])[..., 0], scale


def nearest_rotation(matrix: ArrayF) -> ArrayF:
    """Proper rotations (..., 3, 3) nearest to matrices (..., 3, 3): those R of the largest trace of R^T M."""
    return _rotation(matrix)[0]


def _rotation(matrix: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Nearest rotation and the trace of R^T M."""
    U, s, Vt = np.linalg.svd(matrix)
    # Of orthogonal matrices the determinant is 1 or -1, also where the matrix between them is singular.
    flip = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    s[..., 2] *= flip
    U[..., 2] *= flip[..., None]
    return U @ Vt, s.sum(axis=-1)
