"""Errors of a trajectory as processes in time, and their elimination from an adjustment.

Points of one second share the error of the pose of that second, and so do those of the next: counting them as
independent makes sigmas of a calibration from motion far too small. Here the antenna errs by a first-order
Gauss-Markov process plus a part that is new in each epoch, and roll, pitch and heading err by Gauss-Markov
processes (Gelb 1974, 2.2). Between knots errors run linearly. Their values at the knots are unknowns with

    cov e(t) e(s) = sigma^2 exp(-|t - s| / tau)

as observations; the inverse of that matrix is tridiagonal. Unknowns in the order of time make normal
equations with a band, beside a border of the unknowns that are asked for::

    [ B    C^T ] [x]   [b]
    [ C    N   ] [e] = [n]        (B - C^T N^-1 C) x = b - C^T N^-1 n

The position of the ics origin is ``x_antenna - R l``, so a turn of the boat turns it about the *antenna*.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from scipy.linalg import cholesky_banded
from scipy.linalg.lapack import dtbtrs

from thalweg.core import ArrayF, ArrayI, CoverageError, GeometryError, attitude_axes, cross_matrix
from thalweg.settings.sections import RunErrors

SLOW: Final = 6
"""Slow errors: east, north, up of the antenna, metres; roll, pitch, heading, radians."""

FAST: Final = 3
"""Errors of the antenna that are new in each epoch."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseErrors:
    """How a trajectory errs.

    Parameters
    ----------
    sigma_position_m : (3,) total error of the antenna east, north, up.
    sigma_attitude_rad : (3,) error of roll, pitch, heading.
    position_time_s, attitude_time_s : correlation times.
    heading_time_s : that of the heading; None: the one of roll and pitch.
    white_share : share of the position's variance that is new in each epoch.
    epoch_s : interval of the positions.
    knot_s : interval of the knots of the slow errors, rounded to whole epochs.

    Raises
    ------
    GeometryError : a sigma or a time is not above zero.
    """

    sigma_position_m: ArrayF
    sigma_attitude_rad: ArrayF
    position_time_s: float = RunErrors().position_time_s
    attitude_time_s: float = RunErrors().attitude_time_s
    white_share: float = RunErrors().white_share
    epoch_s: float = 0.1
    knot_s: float = RunErrors().knot_s
    heading_time_s: float | None = None

    def __post_init__(self) -> None:
        for name in ("sigma_position_m", "sigma_attitude_rad"):
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if value.shape != (3,) or not np.all((value > 0) & np.isfinite(value)):
                raise GeometryError(f"{name}={value}", expected="three finite values above 0")
            object.__setattr__(self, name, value)
        times = (*self.times_s, self.epoch_s, self.knot_s)
        if not all(0 < t < np.inf for t in times) or not 0 <= self.white_share < 1:
            raise GeometryError(
                f"correlation times {self.times_s[[0, 3, 5]].tolist()} s, epochs {self.epoch_s} s, "
                f"knots {self.knot_s} s, white share {self.white_share}",
                expected="times above 0 and a share of at least 0 and below 1",
            )

    @property
    def times_s(self) -> ArrayF:
        """Correlation times (6,) of the slow errors: east, north, up, roll, pitch, heading."""
        heading = self.attitude_time_s if self.heading_time_s is None else self.heading_time_s
        return np.array([*[self.position_time_s] * 3, self.attitude_time_s, self.attitude_time_s, heading])

    @classmethod
    def from_section(cls, section: Mapping[str, Any]) -> Self:
        """From a section of a campaign file: the same names, with ``sigma_attitude_deg``."""
        values = dict(section)
        return cls(sigma_attitude_rad=np.deg2rad(values.pop("sigma_attitude_deg")), **values)


@dataclass(frozen=True, slots=True, kw_only=True)
class Knots:
    """Where the errors of a run are unknowns, in the order of time.

    Slow errors have knots every ``per`` epochs, fast ones at each epoch; without a white part there are no
    fast ones and ``per`` is 1. Each slow knot is followed by the fast ones up to the next slow one.

    Parameters
    ----------
    start_s : time of the first knot.
    epoch_s : interval of the finest knots.
    per : epochs between slow knots.
    n_slow : number of intervals between slow knots.
    fast : whether there are fast errors.
    """

    start_s: float
    epoch_s: float
    per: int
    n_slow: int
    fast: bool

    @classmethod
    def over(cls, first_s: float, last_s: float, errors: PoseErrors) -> Self:
        """Knots that cover a span of time."""
        fast = errors.white_share > 0
        per = max(round(errors.knot_s / errors.epoch_s), 1) if fast else 1
        epoch = errors.epoch_s if fast else errors.knot_s
        n = int(np.floor((last_s - first_s) / (per * epoch))) + 1
        return cls(start_s=first_s, epoch_s=epoch, per=per, n_slow=n, fast=fast)

    @property
    def stride(self) -> int:
        """Unknowns from one slow knot to the next."""
        return SLOW + FAST * self.per * self.fast

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self.n_slow * self.stride + SLOW + FAST * self.fast

    @property
    def bandwidth(self) -> int:
        """How far two unknowns of a point are apart at most: slow left and fast right ones."""
        return self.stride + SLOW + FAST * self.fast - 1

    def interval(self, t_s: ArrayF) -> ArrayI:
        """Number (n,) of the epoch interval of times; those outside count to the first or the last one."""
        q = np.floor((np.asarray(t_s) - self.start_s) / self.epoch_s).astype(np.int64)
        return np.asarray(np.clip(q, 0, self.n_slow * self.per - 1))

    def unknowns(self, interval: ArrayI) -> ArrayI:
        """Unknowns (m, 18 or 12) of intervals: slow left and right, fast left and right."""
        q = np.atleast_1d(interval)
        left = (q // self.per) * self.stride
        parts = [left[:, None] + np.arange(SLOW), left[:, None] + self.stride + np.arange(SLOW)]
        if self.fast:
            for k in (q, q + 1):
                at = (k // self.per) * self.stride + SLOW + FAST * (k % self.per)
                parts.append(at[:, None] + np.arange(FAST))
        return np.concatenate(parts, axis=1)

    def shares(self, t_s: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Where times lie in their slow and in their fast interval, 0 .. 1, both (n,)."""
        x = (np.asarray(t_s, dtype=np.float64) - self.start_s) / self.epoch_s
        q = self.interval(t_s)
        return (x - (q // self.per) * self.per) / self.per, x - q

    def spread(self, pose_rows: ArrayF, t_s: ArrayF) -> ArrayF:
        """Derivatives (n, 18 or 12) by the unknowns of each point's interval.

        Parameters
        ----------
        pose_rows : (n, 6) derivatives by the errors at the time of each point.
        t_s : (n,).
        """
        u, w = (share[:, None] for share in self.shares(t_s))
        parts = [(1 - u) * pose_rows, u * pose_rows]
        if self.fast:
            parts += [(1 - w) * pose_rows[:, :FAST], w * pose_rows[:, :FAST]]
        return np.concatenate(parts, axis=1)

    def at(self, values: ArrayF, t_s: ArrayF) -> ArrayF:
        """Errors (n, 6) at times, of the values (u,) of the unknowns."""
        u, w = (share[:, None] for share in self.shares(t_s))
        local = values[self.unknowns(self.interval(t_s))]
        out = (1 - u) * local[:, :SLOW] + u * local[:, SLOW : 2 * SLOW]
        if self.fast:
            out[:, :FAST] += (1 - w) * local[:, 2 * SLOW : 2 * SLOW + FAST] + w * local[:, 2 * SLOW + FAST :]
        return np.asarray(out)

    def prior(self, errors: PoseErrors) -> tuple[ArrayF, float]:
        """Inverse covariance of all unknowns, lower banded (bandwidth + 1, u), and its log determinant."""
        band = np.zeros((self.bandwidth + 1, self.n))
        step = self.epoch_s * self.per
        slow_position = errors.sigma_position_m * np.sqrt(1 - errors.white_share)
        sigma = np.concatenate([slow_position, errors.sigma_attitude_rad])
        keep = np.exp(-step / errors.times_s)
        drive = 1.0 / (sigma**2 * (1 - keep**2))
        knots = np.arange(self.n_slow + 1) * self.stride
        logdet = 0.0
        for channel in range(SLOW):
            diagonal = np.full(len(knots), (1 + keep[channel] ** 2) * drive[channel])
            diagonal[[0, -1]] = drive[channel]
            band[0, knots + channel] = diagonal
            band[self.stride, knots[:-1] + channel] = -keep[channel] * drive[channel]
            logdet += self.n_slow * np.log(drive[channel]) - 2 * np.log(sigma[channel])
        if self.fast:
            weight = 1.0 / (errors.white_share * errors.sigma_position_m**2)
            epochs = np.arange(self.n_slow * self.per + 1)
            at = (epochs // self.per) * self.stride + SLOW + FAST * (epochs % self.per)
            for axis in range(FAST):
                band[0, at + axis] = weight[axis]
                logdet += len(epochs) * np.log(weight[axis])
        return band, float(logdet)


@dataclass(slots=True, kw_only=True)
class BorderedNormals:
    """Normal equations of m border unknowns and u errors of the poses.

    ``border`` (m, m), ``coupling`` (u, m), ``band`` (bandwidth + 1, u) lower banded form, ``rhs_border``
    (m,), ``rhs_band`` (u,), ``square``: weighted sum of the squares of the residuals, ``n``: their number.
    """

    border: ArrayF
    coupling: ArrayF
    band: ArrayF
    rhs_border: ArrayF
    rhs_band: ArrayF
    square: float
    n: int

    @classmethod
    def of(
        cls,
        knots: Knots,
        t_s: ArrayF,
        border_rows: ArrayF,
        pose_rows: ArrayF,
        residual: ArrayF,
        weight: ArrayF,
    ) -> Self:
        """Normal equations of observations.

        Parameters
        ----------
        knots : where the errors of the poses are unknowns.
        t_s : (n,) time of each observation.
        border_rows, pose_rows : (n, m) and (n, 6) derivatives by the border and by the errors at its time.
        residual, weight : (n,) observed minus computed, and the inverse of its variance.

        Raises
        ------
        CoverageError : no observation is left.
        """
        if len(residual) == 0:
            raise CoverageError(
                "no point of the run lies on a cone any more",
                expected="points on the cones of the field",
                cure="Check what places the scanner: the antenna's marker in the field description, the "
                "place of the field, the nominal mounts",
            )
        m = border_rows.shape[1]
        root = np.sqrt(weight)[:, None]
        interval = knots.interval(t_s)
        order = np.argsort(interval, kind="stable")
        A = np.concatenate([border_rows, knots.spread(pose_rows, t_s), residual[:, None]], axis=1)
        A = np.ascontiguousarray((A * root)[order])
        found, first = np.unique(interval[order], return_index=True)
        ends = np.append(first[1:], len(A))
        unknowns = knots.unknowns(found)
        k = unknowns.shape[1]
        i, j = np.tril_indices(k)
        high = np.maximum(unknowns[:, i], unknowns[:, j])
        low = np.minimum(unknowns[:, i], unknowns[:, j])
        blocks = np.empty((len(found), k, A.shape[1]))
        for block, start, end in zip(blocks, first.tolist(), ends.tolist(), strict=True):
            part = A[start:end]
            np.matmul(part[:, m : m + k].T, part, out=block)
        flat = (high - low) * knots.n + low
        size = (knots.bandwidth + 1) * knots.n
        band = summed(flat, blocks[:, i, m + j], size)
        rhs_band = summed(unknowns, blocks[:, :, -1], knots.n)
        coupling = np.zeros((knots.n, m))
        np.add.at(coupling, unknowns, blocks[:, :, :m])
        own = np.delete(A, np.s_[m : m + k], axis=1)
        sums = own.T @ own
        return cls(
            border=sums[:m, :m],
            coupling=coupling,
            band=band.reshape(knots.bandwidth + 1, knots.n),
            rhs_border=sums[:m, -1],
            rhs_band=rhs_band,
            square=float(sums[-1, -1]),
            n=len(A),
        )

    def reduced(self, prior_band: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF]:
        """Cholesky factor of the errors' band, coupling and right side divided by it, and what is left.

        The last two are the normal equations (m, m) and (m,) of the border without the errors.
        """
        lower = np.asfortranarray(cholesky_banded(self.band + prior_band, lower=True))
        # forward only: C^T N^-1 C = (L^-1 C)^T (L^-1 C)
        half, _ = dtbtrs(lower, np.asfortranarray(np.column_stack([self.coupling, self.rhs_band])), uplo="L")
        product = half.T @ half
        normal = self.border - product[:-1, :-1]
        return lower, half, (normal + normal.T) / 2, self.rhs_border - product[:-1, -1]

    def solve(self, prior_band: ArrayF, prior_border: ArrayF) -> "Solution":
        """Values of all unknowns if the errors of the poses and the border are observed as zero.

        Parameters
        ----------
        prior_band : lower banded form as from `Knots.prior`.
        prior_border : (m, m) inverse covariance of what is known of the border; zero where nothing is.

        Raises
        ------
        GeometryError : the border is not determined.
        """
        lower, half, normal, rhs = self.reduced(prior_band)
        reduced = normal + prior_border
        border, cov, factor = solved(reduced, rhs)
        back, _ = dtbtrs(lower, half @ np.append(-border, 1.0)[:, None], uplo="L", trans="T")
        band = back[:, 0]
        return Solution(
            border=border,
            errors=band,
            cov_border=cov,
            reduced=reduced,
            omega=float(self.square - self.rhs_border @ border - self.rhs_band @ band),
            logdet=float(2 * np.sum(np.log(lower[0])) + 2 * np.sum(np.log(np.diag(factor)))),
        )

    def taken(self, prior_band: ArrayF) -> float:
        """How many observations the errors of the poses use up: ``tr(N (N + Q)^-1)``.

        The derivative of the log determinant of ``s N + Q`` by ``s``.
        """
        h = 1e-3
        more, less = (
            2 * np.sum(np.log(cholesky_banded(s * self.band + prior_band, lower=True)[0]))
            for s in (1 + h, 1 - h)
        )
        return float((more - less) / (2 * h))


def summed(at: ArrayI, values: ArrayF, n: int) -> ArrayF:
    """Sums (n,) of the values at each place."""
    return np.asarray(np.bincount(at.ravel(), weights=values.ravel(), minlength=n), dtype=np.float64)


def solved(normal: ArrayF, rhs: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Solution (m,) of normal equations (m, m), its covariance and the Cholesky factor.

    Raises
    ------
    GeometryError : the equations are singular.
    """
    try:
        factor = np.linalg.cholesky(normal)
    except np.linalg.LinAlgError as error:
        raise GeometryError(
            "the normal equations of the run are singular",
            expected="observations that determine every parameter",
        ) from error
    inverse = np.linalg.inv(factor)
    cov = inverse.T @ inverse
    return np.asarray(cov @ rhs), np.asarray(cov), np.asarray(factor, dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """Solved normal equations.

    ``border`` (m,), ``errors`` (u,) values; ``cov_border`` (m, m); ``reduced`` (m, m) its inverse; ``omega``
    weighted sum of the squares of all residuals, those of the prior knowledge included; ``logdet`` log
    determinant of all normal equations.
    """

    border: ArrayF
    errors: ArrayF
    cov_border: ArrayF
    reduced: ArrayF
    omega: float
    logdet: float


def pose_rows(normal_wcs: ArrayF, arm_wcs_m: ArrayF, R_wcs_ics: ArrayF) -> ArrayF:
    """Change (n, 6) of a component of points with errors of the antenna and of roll, pitch, heading.

    ``dx = dx_antenna + (A e) x arm`` with the axes ``A`` of roll, pitch and heading.

    Parameters
    ----------
    normal_wcs : (n, 3) the component.
    arm_wcs_m : (n, 3) from the antenna to the points.
    R_wcs_ics : (n, 3, 3).
    """
    axes = attitude_axes(R_wcs_ics)
    moment = np.cross(arm_wcs_m, normal_wcs)
    return np.concatenate([normal_wcs, np.einsum("nki,ni->nk", axes, moment)], axis=1)


def turns(vector_rad: ArrayF) -> ArrayF:
    """Small rotations (n, 3, 3) of vectors (n, 3), to second order: 0.3 deg to the third are 1e-7."""
    K = cross_matrix(vector_rad)
    return np.asarray(np.eye(3) + K + 0.5 * K @ K)


def attitude_vector(errors_rad: ArrayF, R_wcs_ics: ArrayF) -> ArrayF:
    """Rotation vectors (n, 3) in wcs of errors (n, 3) of roll, pitch and heading."""
    return np.asarray(np.einsum("nk,nki->ni", errors_rad, attitude_axes(R_wcs_ics)))
