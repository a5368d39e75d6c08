"""Compiled loops of the block adjustment: one pass over the tracks of tie points.

A track is all marks of one point. Its errors are correlated: marks ``i`` and ``j`` of a track have, in
coordinate ``a`` (along and across the parallax of the track), the covariance ::

    C_ij = s_i s_j (white_a^2 [i = j] + slow_a^2 exp(-(|v_i - v_j| / reach)^power))

with the standard deviations ``s`` and the places ``v`` from where the point was seen (see
`thalweg.images.bundle.correlation`). With ``W_a = C_a^-1``, ``W_ij = diag(W_1ij, W_2ij)``, the
derivatives ``A_i`` (2, 3) by the point, and ``V = sum_ij A_i^T W_ij A_j``, the point is eliminated (Brown
1958; Triggs et al. 2000)::

    P_ij = W_ij - (W A)_i V^-1 (W A)_j^T,      S += J_i^T P_ij J_j,      g += J_i^T P_ij r_j

``model`` holds white (2), slow (2), reach and power. Residuals and derivatives come in the coordinates along
and across.
"""

import numba as nb
import numpy as np

from thalweg.core.types import ArrayF, ArrayI


@nb.njit(cache=True, error_model="numpy")
def _inverse_track(n: int, s: ArrayF, v: ArrayF, model: ArrayF, W: ArrayF) -> float:
    """Fill ``W`` (2, n, n) with the inverse covariances of a track; returns the logarithm of determinants."""
    log_determinant = 0.0
    wanders = n > 1 and (model[2] > 0.0 or model[3] > 0.0)
    if wanders:
        # how alike the slow errors are, in the upper half of the second matrix until it is its turn
        half = 0.5 * model[5]
        for i in range(n):
            for j in range(i + 1, n):
                d2 = 0.0
                for a in range(v.shape[1]):
                    d2 += (v[i, a] - v[j, a]) ** 2
                W[1, i, j] = np.exp(-((d2 / (model[4] * model[4])) ** half))
    for a in range(2):
        white, slow = model[a] * model[a], model[2 + a] * model[2 + a]
        if not wanders:
            for i in range(n):
                for j in range(n):
                    W[a, i, j] = 0.0
                W[a, i, i] = 1.0 / ((white + slow) * s[i] * s[i])
                log_determinant -= np.log(W[a, i, i])
        else:
            log_determinant += _inverse_coordinate(n, s, W[1], white, slow, W[a])
    return log_determinant


@nb.njit(cache=True, error_model="numpy")
def _inverse_coordinate(n: int, s: ArrayF, alike: ArrayF, white: float, slow: float, W: ArrayF) -> float:
    """Inverse covariance of one coordinate; ``alike`` is read from its upper half, and may be ``W``."""
    # Cholesky factor of the correlation part, in the lower half of W; the sigmas are put in at the end
    for i in range(n):
        for j in range(i + 1):
            value = white + slow if i == j else slow * alike[j, i]
            for k in range(j):
                value -= W[i, k] * W[j, k]
            W[i, j] = np.sqrt(value) if i == j else value / W[j, j]
    log_determinant = 0.0
    for i in range(n):
        log_determinant += 2.0 * np.log(W[i, i] * s[i])
    # inverse of the factor, in place
    for j in range(n):
        W[j, j] = 1.0 / W[j, j]
        for i in range(j + 1, n):
            value = 0.0
            for k in range(j, i):
                value -= W[i, k] * W[k, j]
            W[i, j] = value / W[i, i]
    # L^-T L^-1
    for i in range(n):
        for j in range(i + 1):
            value = 0.0
            for k in range(i, n):
                value += W[k, i] * W[k, j]
            W[j, i] = value
    for i in range(n):
        for j in range(i, n):
            W[i, j] /= s[i] * s[j]
            W[j, i] = W[i, j]
    return log_determinant


@nb.njit(cache=True, error_model="numpy")
def _inverse3(V: ArrayF, out: ArrayF) -> float:
    """Inverse of a symmetric 3x3 matrix; returns its determinant."""
    a, b, c = V[0, 0], V[0, 1], V[0, 2]
    d, e, f = V[1, 1], V[1, 2], V[2, 2]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * A + b * B + c * C
    out[0, 0], out[0, 1], out[0, 2] = A / determinant, B / determinant, C / determinant
    out[1, 1], out[1, 2] = (a * f - c * c) / determinant, (b * c - a * e) / determinant
    out[2, 2] = (a * d - b * b) / determinant
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return determinant


@nb.njit(cache=True, error_model="numpy")
def _eliminated(n: int, A: ArrayF, W: ArrayF, damping: float, WA: ArrayF, V: ArrayF, Vi: ArrayF) -> float:
    """Fill ``W A`` (n, 2, 3), ``V`` and its inverse for a track; returns the determinant of ``V``."""
    V[:] = 0.0
    for i in range(n):
        for a in range(2):
            for x in range(3):
                value = 0.0
                for j in range(n):
                    value += W[a, i, j] * A[j, a, x]
                WA[i, a, x] = value
    for i in range(n):
        for a in range(2):
            for x in range(3):
                for y in range(3):
                    V[x, y] += A[i, a, x] * WA[i, a, y]
    for x in range(3):
        V[x, x] *= 1.0 + damping
    return _inverse3(V, Vi)


@nb.njit(cache=True, error_model="numpy", nogil=True)
def add_tracks(
    first: ArrayI,
    image: ArrayI,
    by_pose: ArrayF,
    by_rest: ArrayF,
    by_point: ArrayF,
    residual: ArrayF,
    sigma: ArrayF,
    view: ArrayF,
    model: ArrayF,
    damping: float,
    n_poses: int,
    S: ArrayF,
    g: ArrayF,
) -> float:
    """Add all tracks to the reduced normal equations; returns their weighted square sum.

    Parameters
    ----------
    first : (p + 1,) first mark of each track; marks are sorted by track.
    image : (m,) image of each mark.
    by_pose, by_rest, by_point : (m, 2, 6), (m, 2, q), (m, 2, 3) derivatives of the pixel.
    residual : (m, 2) measured minus computed.
    sigma : (m,) standard deviations; view : (m, d) places of view; model : (6,).
    damping : Levenberg's share that is added to the diagonal of each point.
    n_poses : 6 times the number of images.
    S, g : (u, u), (u,) poses first, then the q others; only the upper half of S is filled.
    """
    longest = 0
    for k in range(len(first) - 1):
        longest = max(longest, first[k + 1] - first[k])
    W, WA = np.empty((2, longest, longest)), np.empty((longest, 2, 3))
    V, Vi, Wr = np.empty((3, 3)), np.empty((3, 3)), np.empty((longest, 2))
    left, P, T = np.empty((2, 3)), np.empty((2, 2)), np.empty((2, 6))
    q = by_rest.shape[2]
    PR, Pr = np.empty((longest, 2, q)), np.empty((longest, 2))
    rest, point = np.empty((3, q)), np.empty(3)
    cost = 0.0
    for k in range(len(first) - 1):
        at, n = first[k], first[k + 1] - first[k]
        if n == 0:
            continue
        A = by_point[at : at + n]
        _inverse_track(n, sigma[at : at + n], view[at : at + n], model, W)
        _eliminated(n, A, W, damping, WA, V, Vi)
        point[:] = 0.0
        rest[:] = 0.0
        for i in range(n):
            for a in range(2):
                value = 0.0
                for j in range(n):
                    value += W[a, i, j] * residual[at + j, a]
                Wr[i, a] = value
                cost += residual[at + i, a] * value
                for x in range(3):
                    point[x] += WA[i, a, x] * residual[at + i, a]
                    for c in range(q):
                        rest[x, c] += WA[i, a, x] * by_rest[at + i, a, c]
        # P applied to the residuals and to the derivatives by what all images share
        for i in range(n):
            for a in range(2):
                value = Wr[i, a]
                for x in range(3):
                    left[a, x] = 0.0
                    for y in range(3):
                        left[a, x] += WA[i, a, y] * Vi[y, x]
                    value -= left[a, x] * point[x]
                Pr[i, a] = value
                for c in range(q):
                    value = 0.0
                    for j in range(n):
                        value += W[a, i, j] * by_rest[at + j, a, c]
                    for x in range(3):
                        value -= left[a, x] * rest[x, c]
                    PR[i, a, c] = value
        for i in range(n):
            at_i = 6 * image[at + i]
            for a in range(2):
                for x in range(3):
                    left[a, x] = 0.0
                    for y in range(3):
                        left[a, x] += WA[i, a, y] * Vi[y, x]
            for b in range(6):
                g[at_i + b] += by_pose[at + i, 0, b] * Pr[i, 0] + by_pose[at + i, 1, b] * Pr[i, 1]
                for c in range(q):
                    S[at_i + b, n_poses + c] += (
                        by_pose[at + i, 0, b] * PR[i, 0, c] + by_pose[at + i, 1, b] * PR[i, 1, c]
                    )
            for b in range(q):
                g[n_poses + b] += by_rest[at + i, 0, b] * Pr[i, 0] + by_rest[at + i, 1, b] * Pr[i, 1]
                for c in range(b, q):
                    S[n_poses + b, n_poses + c] += (
                        by_rest[at + i, 0, b] * PR[i, 0, c] + by_rest[at + i, 1, b] * PR[i, 1, c]
                    )
            for j in range(n):
                at_j = 6 * image[at + j]
                if at_j < at_i:
                    continue
                for a in range(2):
                    for b in range(2):
                        P[a, b] = W[a, i, j] if a == b else 0.0
                        for x in range(3):
                            P[a, b] -= left[a, x] * WA[j, b, x]
                for b in range(6):
                    T[0, b] = P[0, 0] * by_pose[at + j, 0, b] + P[0, 1] * by_pose[at + j, 1, b]
                    T[1, b] = P[1, 0] * by_pose[at + j, 0, b] + P[1, 1] * by_pose[at + j, 1, b]
                for b in range(6):
                    one, two = by_pose[at + i, 0, b], by_pose[at + i, 1, b]
                    for c in range(6):
                        S[at_i + b, at_j + c] += one * T[0, c] + two * T[1, c]
    return cost


@nb.njit(cache=True, error_model="numpy", nogil=True)
def solve_points(
    first: ArrayI,
    by_point: ArrayF,
    residual: ArrayF,
    sigma: ArrayF,
    view: ArrayF,
    model: ArrayF,
    damping: float,
    step: ArrayF,
) -> None:
    """Best change (p, 3) of each point for residuals (m, 2) that remain after the change of the images."""
    longest = 0
    for k in range(len(first) - 1):
        longest = max(longest, first[k + 1] - first[k])
    W, WA = np.empty((2, longest, longest)), np.empty((longest, 2, 3))
    V, Vi = np.empty((3, 3)), np.empty((3, 3))
    right = np.empty(3)
    for k in range(len(first) - 1):
        at, n = first[k], first[k + 1] - first[k]
        step[k] = 0.0
        if n == 0:
            continue
        _inverse_track(n, sigma[at : at + n], view[at : at + n], model, W)
        _eliminated(n, by_point[at : at + n], W, damping, WA, V, Vi)
        right[:] = 0.0
        for i in range(n):
            for a in range(2):
                for x in range(3):
                    right[x] += WA[i, a, x] * residual[at + i, a]
        for x in range(3):
            for y in range(3):
                step[k, x] += Vi[x, y] * right[y]


@nb.njit(cache=True, error_model="numpy", nogil=True)
def track_costs(
    first: ArrayI, residual: ArrayF, sigma: ArrayF, view: ArrayF, model: ArrayF, cost: ArrayF
) -> None:
    """Weighted square sum ``r^T W r`` (p,) of each track."""
    longest = 0
    for k in range(len(first) - 1):
        longest = max(longest, first[k + 1] - first[k])
    W = np.empty((2, longest, longest))
    for k in range(len(first) - 1):
        at, n = first[k], first[k + 1] - first[k]
        _inverse_track(n, sigma[at : at + n], view[at : at + n], model, W)
        cost[k] = 0.0
        for i in range(n):
            for j in range(n):
                for a in range(2):
                    cost[k] += residual[at + i, a] * W[a, i, j] * residual[at + j, a]


@nb.njit(cache=True, error_model="numpy", nogil=True)
def restricted_parts(
    first: ArrayI,
    by_point: ArrayF,
    residual: ArrayF,
    sigma: ArrayF,
    view: ArrayF,
    model: ArrayF,
    logarithm: ArrayF,
    square: ArrayF,
    fit: ArrayF,
) -> None:
    """Parts of the restricted likelihood (Patterson and Thompson 1971) of each track, and how a mark fits.

    Of the residuals all that a change of the point could explain is left out: ``logarithm`` (p,) is
    ``ln |C| + ln |V|``, ``square`` (p,) is ``r^T P r``. ``fit`` (m,), unless it is empty, becomes
    ``sqrt(z^T P_ii^-1 z)`` with ``z = (P r)_i``: how far a mark is, in units of its own sigma, from what all
    others of its track say of it.
    """
    longest = 0
    for k in range(len(first) - 1):
        longest = max(longest, first[k + 1] - first[k])
    W, WA = np.empty((2, longest, longest)), np.empty((longest, 2, 3))
    V, Vi, point = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    left, z = np.empty((2, 3)), np.empty(2)
    for k in range(len(first) - 1):
        at, n = first[k], first[k + 1] - first[k]
        logarithm[k] = square[k] = 0.0
        if n < 2:
            continue
        log_det = _inverse_track(n, sigma[at : at + n], view[at : at + n], model, W)
        determinant = _eliminated(n, by_point[at : at + n], W, 0.0, WA, V, Vi)
        logarithm[k] = log_det + np.log(determinant)
        point[:] = 0.0
        for i in range(n):
            for a in range(2):
                for x in range(3):
                    point[x] += WA[i, a, x] * residual[at + i, a]
        for i in range(n):
            for a in range(2):
                z[a] = 0.0
                for j in range(n):
                    z[a] += W[a, i, j] * residual[at + j, a]
                for x in range(3):
                    left[a, x] = 0.0
                    for y in range(3):
                        left[a, x] += WA[i, a, y] * Vi[y, x]
                    z[a] -= left[a, x] * point[x]
                square[k] += residual[at + i, a] * z[a]
            if len(fit):
                # a direction that only this mark shows has no check: it gets a little weight of its own
                xx, yy = 1.001 * W[0, i, i], 1.001 * W[1, i, i]
                xy = 0.0
                for x in range(3):
                    xx -= left[0, x] * WA[i, 0, x]
                    yy -= left[1, x] * WA[i, 1, x]
                    xy -= left[0, x] * WA[i, 1, x]
                value = (yy * z[0] * z[0] - 2 * xy * z[0] * z[1] + xx * z[1] * z[1]) / (xx * yy - xy * xy)
                fit[at + i] = np.sqrt(max(value, 0.0))
