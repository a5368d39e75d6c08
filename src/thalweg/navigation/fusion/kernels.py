"""Compiled loops of the smoother: a Kalman filter forwards, the modified Bryson-Frazier smoother backwards.

The smoother gives the least-squares solution of all observations and of the transitions between nodes
(Rauch, Tung and Striebel 1965; Bierman 1977, ch. 10). In Bryson and Frazier's form it carries the adjoint
``lam`` and its matrix ``Lam`` instead of inverting covariances, so states that do not change from node to
node (mounts, clock) and states without noise are no trouble::

    x_s = x - P lam                          P_s = P - P Lam P
    lam- = lam - H^T u                       u = nu / S + K^T lam
    Lam- = (I - K H)^T Lam (I - K H) + H^T H / S
    lam of the node before = F^T lam-        w_s = -Q lam-

The same quantities give each group's share of the weighted squares of all residuals and of the redundancy
(Koopman 1993): ``R u^2`` and ``R (1 / S + K^T Lam K)`` of an observation, ``lam-^T Q lam-`` and
``tr(Q Lam-)`` of a transition.

Order of the states: position (3), its rate (3), then single processes ``x' = phi x + w``; six of them may be
the errors of an image's pose, whose transitions are full matrices.
"""

import numba as nb
import numpy as np

from thalweg.core.types import ArrayF, ArrayI


@nb.njit(cache=True, error_model="numpy")
def _rows(A: ArrayF, f: float, g: float, phi: ArrayF, cam: int, G: ArrayF, keep: ArrayF) -> None:
    """``A <- F A``."""
    n, m = A.shape
    for i in range(3):
        for j in range(m):
            A[i, j] += f * A[3 + i, j]
            A[3 + i, j] *= g
    for i in range(6, n):
        if phi[i] != 1.0:
            for j in range(m):
                A[i, j] *= phi[i]
    if cam >= 0:
        for j in range(m):
            for i in range(6):
                keep[i] = 0.0
                for k in range(6):
                    keep[i] += G[i, k] * A[cam + k, j]
            for i in range(6):
                A[cam + i, j] = keep[i]


@nb.njit(cache=True, error_model="numpy")
def _rows_transposed(A: ArrayF, f: float, g: float, phi: ArrayF, cam: int, G: ArrayF, keep: ArrayF) -> None:
    """``A <- F^T A``."""
    n, m = A.shape
    for i in range(3):
        for j in range(m):
            A[3 + i, j] = f * A[i, j] + g * A[3 + i, j]
    for i in range(6, n):
        if phi[i] != 1.0:
            for j in range(m):
                A[i, j] *= phi[i]
    if cam >= 0:
        for j in range(m):
            for i in range(6):
                keep[i] = 0.0
                for k in range(6):
                    keep[i] += G[k, i] * A[cam + k, j]
            for i in range(6):
                A[cam + i, j] = keep[i]


@nb.njit(cache=True, error_model="numpy")
def _transposed(A: ArrayF, B: ArrayF) -> None:
    """``B <- A^T``."""
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            B[j, i] = A[i, j]


@nb.njit(cache=True, error_model="numpy")
def forward(
    x0: ArrayF, p0: ArrayF, pair: ArrayF, walk: ArrayF, phi: ArrayF, q: ArrayF, cam: int, image_of: ArrayI,
    G: ArrayF, W: ArrayF, first_row: ArrayI, H: ArrayF, y: ArrayF, x_out: ArrayF, P_out: ArrayF,
    K_out: ArrayF, S_out: ArrayF, nu_out: ArrayF,
) -> None:  # fmt: skip
    """Filter through all nodes; observations have the variance 1.

    Parameters
    ----------
    x0, p0 : (n,) start and its variances.
    pair : (m, 5) of the transition into each node: ``f, g`` of position and rate, and the noise's variances
        and covariance ``dd, de, ee``; row 0 is not used.
    walk : (m, 3) factors of that noise, east, north, up.
    phi, q : (m, n) of the single processes; columns 0 to 5 are not used.
    cam : first state of the image's errors, or -1.
    image_of : (m,) row of ``G``, ``W`` for the transition into a node, or -1 for none.
    G, W : (k, 6, 6) transitions and noise of the image's errors.
    first_row : (m + 1,) rows of ``H`` by node.
    H, y : (r, n) and (r,) observations.
    x_out, P_out : (m, n), (m, n, n) of the filter, written.
    K_out, S_out, nu_out : (r, n), (r,), (r,) gain, variance and innovation of each observation, written.
    """
    n, m = len(x0), len(first_row) - 1
    x = x0.copy()
    P = np.diag(p0)
    B = np.empty((n, n))
    column = np.empty((n, 1))
    keep = np.empty(6)
    ph = np.empty(n)
    for node in range(m):
        if node > 0:
            f, g, image = pair[node, 0], pair[node, 1], image_of[node]
            at = cam if image >= 0 else -1
            Gk = G[max(image, 0)]
            column[:, 0] = x
            _rows(column, f, g, phi[node], at, Gk, keep)
            x[:] = column[:, 0]
            _rows(P, f, g, phi[node], at, Gk, keep)
            _transposed(P, B)
            _rows(B, f, g, phi[node], at, Gk, keep)
            _transposed(B, P)
            for i in range(3):
                P[i, i] += walk[node, i] * pair[node, 2]
                P[i, 3 + i] += walk[node, i] * pair[node, 3]
                P[3 + i, i] += walk[node, i] * pair[node, 3]
                P[3 + i, 3 + i] += walk[node, i] * pair[node, 4]
            for i in range(6, n):
                P[i, i] += q[node, i]
            if at >= 0:
                for i in range(6):
                    for j in range(6):
                        P[at + i, at + j] += W[image, i, j]
        for row in range(first_row[node], first_row[node + 1]):
            h = H[row]
            S, nu = 1.0, y[row]
            for i in range(n):
                ph[i] = 0.0
                for j in range(n):
                    ph[i] += P[i, j] * h[j]
                nu -= h[i] * x[i]
            for i in range(n):
                S += h[i] * ph[i]
            # Joseph's form: the loss of digits by a weak start stays small
            for i in range(n):
                ki = ph[i] / S
                K_out[row, i] = ki
                x[i] += ki * nu
                for j in range(i + 1):
                    kj = ph[j] / S
                    P[i, j] += ki * kj * S - ki * ph[j] - ph[i] * kj
                    P[j, i] = P[i, j]
            S_out[row], nu_out[row] = S, nu
        x_out[node] = x
        P_out[node] = P


@nb.njit(cache=True, error_model="numpy")
def backward(
    p0: ArrayF, pair: ArrayF, kind: ArrayI, walk: ArrayF, phi: ArrayF, q: ArrayF, cam: int,
    image_of: ArrayI, G: ArrayF, W: ArrayF, first_row: ArrayI, H: ArrayF, x: ArrayF, P: ArrayF, K: ArrayF,
    S: ArrayF, nu: ArrayF, part: int, x_out: ArrayF, cov_out: ArrayF, cross_out: ArrayF, squares: ArrayF,
    redundancy: ArrayF, pairs: ArrayF, rows: ArrayF,
) -> None:  # fmt: skip
    """Smooth what `forward` found.

    Parameters
    ----------
    p0, pair, walk, phi, q, cam, image_of, G, W, first_row, H : as in `forward`.
    kind : (m,) kind of the transition of position and rate into each node, row of ``pairs``.
    x, P, K, S, nu : what `forward` wrote.
    part : the first ``part`` states get covariances; no transition may lead into them from others.
    x_out : (m, n) smoothed states, written.
    cov_out, cross_out : (m, part, part) covariance of a node, and with the next node, written.
    squares, redundancy : (n,) by single process, the image's errors under their first state; added to.
    pairs : (kinds, 2) squares and redundancy of position and rate by kind of transition; added to.
    rows : (r, 2) squares and redundancy of each observation, written.
    """
    m, n = x.shape
    lam = np.zeros(n)
    Lam = np.zeros((n, n))
    B = np.empty((n, n))
    column = np.empty((n, 1))
    keep = np.empty(6)
    kl = np.empty(n)
    U = np.empty((part, n))
    for node in range(m - 1, -1, -1):
        Pk = P[node]
        for i in range(n):
            x_out[node, i] = x[node, i]
            for j in range(n):
                x_out[node, i] -= Pk[i, j] * lam[j]
        # covariance of the first states: P - P Lam P
        for i in range(part):
            for j in range(n):
                U[i, j] = 0.0
            for k in range(n):
                a = Pk[i, k]
                for j in range(n):
                    U[i, j] += a * Lam[k, j]
            for j in range(part):
                s = Pk[i, j]
                for k in range(n):
                    s -= U[i, k] * Pk[k, j]
                cov_out[node, i, j] = s
        for i in range(part):
            for j in range(i):
                s = 0.5 * (cov_out[node, i, j] + cov_out[node, j, i])
                cov_out[node, i, j] = s
                cov_out[node, j, i] = s
        if node < m - 1:
            # cross_out holds P F^T Lam- Q of the transition; P_s F^T goes before it
            f, g = pair[node + 1, 0], pair[node + 1, 1]
            for i in range(part):
                for j in range(3):
                    a, b = cov_out[node, i, j], cov_out[node, i, 3 + j]
                    cross_out[node, i, j] = a + f * b - cross_out[node, i, j]
                    cross_out[node, i, 3 + j] = g * b - cross_out[node, i, 3 + j]
                for j in range(6, part):
                    cross_out[node, i, j] = phi[node + 1, j] * cov_out[node, i, j] - cross_out[node, i, j]
        for row in range(first_row[node + 1] - 1, first_row[node] - 1, -1):
            u, d = nu[row] / S[row], 1.0 / S[row]
            for i in range(n):
                kl[i] = 0.0
                for j in range(n):
                    kl[i] += Lam[i, j] * K[row, j]
                u += K[row, i] * lam[i]
            for i in range(n):
                d += K[row, i] * kl[i]
            # (I - K H)^T first, then (I - K H): at a weak start, where K H is nearly 1, the expanded
            # product would leave rounding errors of Lam that the great P multiplies twice
            for i in range(n):
                hi = H[row, i]
                lam[i] -= hi * u
                for j in range(n):
                    Lam[i, j] -= hi * kl[j]
            for i in range(n):
                s = 0.0
                for j in range(n):
                    s += Lam[i, j] * K[row, j]
                for j in range(n):
                    Lam[i, j] -= s * H[row, j]
            for i in range(n):
                for j in range(i + 1):
                    Lam[i, j] = 0.5 * (Lam[i, j] + Lam[j, i]) + H[row, i] * H[row, j] / S[row]
                    Lam[j, i] = Lam[i, j]
            rows[row, 0], rows[row, 1] = u * u, d
        if node == 0:
            for i in range(6, n):
                squares[i] += p0[i] * lam[i] * lam[i]
                redundancy[i] += p0[i] * Lam[i, i]
            break
        image = image_of[node]
        at = cam if image >= 0 else -1
        Gk = G[max(image, 0)]
        dd, de, ee = pair[node, 2], pair[node, 3], pair[node, 4]
        for i in range(3):
            a, b = lam[i], lam[3 + i]
            own = dd * Lam[i, i] + 2.0 * de * Lam[i, 3 + i] + ee * Lam[3 + i, 3 + i]
            pairs[kind[node], 0] += walk[node, i] * (dd * a * a + 2.0 * de * a * b + ee * b * b)
            pairs[kind[node], 1] += walk[node, i] * own
        for i in range(6, n):
            squares[i] += q[node, i] * lam[i] * lam[i]
            redundancy[i] += q[node, i] * Lam[i, i]
        if at >= 0:
            for i in range(6):
                for j in range(6):
                    squares[at] += W[image, i, j] * lam[at + i] * lam[at + j]
                    redundancy[at] += W[image, i, j] * Lam[at + i, at + j]
        f, g = pair[node, 0], pair[node, 1]
        column[:, 0] = lam
        _rows_transposed(column, f, g, phi[node], at, Gk, keep)
        lam[:] = column[:, 0]
        _rows_transposed(Lam, f, g, phi[node], at, Gk, keep)
        Pb = P[node - 1]
        for i in range(part):
            for j in range(part):
                U[i, j] = 0.0
            for k in range(n):
                a = Pb[i, k]
                for j in range(part):
                    U[i, j] += a * Lam[k, j]
            for j in range(3):
                a, b = U[i, j], U[i, 3 + j]
                cross_out[node - 1, i, j] = walk[node, j] * (a * dd + b * de)
                cross_out[node - 1, i, 3 + j] = walk[node, j] * (a * de + b * ee)
            for j in range(6, part):
                cross_out[node - 1, i, j] = U[i, j] * q[node, j]
        _transposed(Lam, B)
        _rows_transposed(B, f, g, phi[node], at, Gk, keep)
        for i in range(n):
            for j in range(n):
                Lam[i, j] = 0.5 * (B[i, j] + B[j, i])
