"""A track of antenna positions at any time: position, velocity, and the covariance between all times.

Positions come at a regular rate. At a time ``t`` a cubic is fitted to the epochs around it, with weights
that fall to zero at the ends of the window; its value and slope are linear in the epochs, so that their
errors are known. The window is symmetric, so that the noise of the slope is uncorrelated with that of the
value: an interpolation between two epochs makes both from the same two, and a time offset estimated with
such slopes is biased by up to ``sigma^2 / (step speed^2)``, 1.6 ms for 1 cm at 10 Hz and 0.8 m/s.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from thalweg.core import ArrayB, ArrayF, ArrayI, CoverageError, GeometryError, LocalFrame

_REACH_S: Final = 0.6
"""Half of the window: sway of a boat with a period of 2 s passes it by 99 %."""
_LEAST_EPOCHS: Final = 6
"""A cubic has four unknowns."""
_DEGREE: Final = 3
_BEST: Final = ("ppp", "fixed", "float", "dgnss", "sbas", "single")


@dataclass(frozen=True, slots=True, kw_only=True)
class Between:
    """A track at times.

    ``position_m`` and ``velocity_mps`` (n, 3); ``inside`` (n,) False where epochs are missing; ``index``
    (n, k) the epochs, ``weight`` (n, k) their shares in the position, ``slope`` (n, k) those in the velocity,
    1/s.
    """

    t_gps_s: ArrayF
    position_m: ArrayF
    velocity_mps: ArrayF
    inside: ArrayB
    index: ArrayI
    weight: ArrayF
    slope: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class Track:
    """Positions (m, 3) in wcs at times (m,), with covariances (m, 3, 3), and how their errors hang together.

    The error is a Gauss-Markov process with ``correlation_time_s`` and, for ``white_share`` of the variance,
    new in each epoch.

    Raises
    ------
    GeometryError : times that do not increase, shapes that differ, a share outside 0 .. 1.
    """

    t_gps_s: ArrayF
    position_m: ArrayF
    cov_m2: ArrayF
    correlation_time_s: float = 10.0
    white_share: float = 0.25

    def __post_init__(self) -> None:
        m = len(self.t_gps_s)
        if m < _LEAST_EPOCHS or self.position_m.shape != (m, 3) or self.cov_m2.shape != (m, 3, 3):
            raise GeometryError(
                f"{m} epochs, positions {self.position_m.shape}, covariances {self.cov_m2.shape}",
                expected=f"at least {_LEAST_EPOCHS} epochs, (m, 3) and (m, 3, 3)",
            )
        if not (np.diff(self.t_gps_s) > 0).all():
            raise GeometryError("times of a track that do not increase", expected="sorted, unrepeated epochs")
        if not 0 <= self.white_share <= 1 or not self.correlation_time_s > 0:
            raise GeometryError(
                f"white share {self.white_share}, correlation time {self.correlation_time_s} s",
                expected="a share from 0 to 1 and a time above 0",
            )

    @classmethod
    def from_table(
        cls, positions: pd.DataFrame, frame: LocalFrame, *, correlation_time_s: float, white_share: float
    ) -> Self:
        """From table kind ``gnss_position``: only epochs of the best kind of fix that the table holds.

        A finished trajectory (SBET) states no fix at any epoch; its standard deviations are what counts.

        Raises
        ------
        CoverageError : too few epochs have a time, a position and sigmas.
        """
        sigmas = ["sigma_east_m", "sigma_north_m", "sigma_up_m"]
        known = positions.dropna(subset=["t_gps_s", "lat_deg", "lon_deg", "h_ell_m", *sigmas])
        named = _BEST if (known["fix"] != "none").any() else ("none",)
        kinds = [fix for fix in named if (known["fix"] == fix).sum() >= _LEAST_EPOCHS]
        known = known[known["fix"] == kinds[0]] if kinds else known[:0]
        known = known.sort_values("t_gps_s", kind="stable").drop_duplicates("t_gps_s")
        if len(known) < _LEAST_EPOCHS:
            raise CoverageError(
                f"{len(known)} of {len(positions)} positions are usable",
                expected=f"at least {_LEAST_EPOCHS} epochs of one kind of fix with time, height and sigmas",
                cure="Use a solution with fixed ambiguities and covariances (PPK or RTK)",
            )
        cov = np.zeros((len(known), 3, 3))
        for i, name in enumerate(sigmas):
            cov[:, i, i] = known[name].to_numpy() ** 2
        for i, j, name in ((0, 1, "cov_en_m2"), (0, 2, "cov_eu_m2"), (1, 2, "cov_nu_m2")):
            value = known[name].fillna(0.0).to_numpy()
            cov[:, i, j] = cov[:, j, i] = value
        position = frame.from_geodetic(known["lat_deg"], known["lon_deg"], known["h_ell_m"])
        return cls(
            t_gps_s=known["t_gps_s"].to_numpy(np.float64),
            position_m=np.asarray(position),
            cov_m2=cov,
            correlation_time_s=correlation_time_s,
            white_share=white_share,
        )

    @property
    def step_s(self) -> float:
        """Interval of the epochs."""
        return float(np.median(np.diff(self.t_gps_s)))

    @property
    def epochs(self) -> int:
        """Number of epochs around a time, half of them on either side."""
        return min(2 * max(round(_REACH_S / self.step_s), _LEAST_EPOCHS // 2), len(self.t_gps_s) // 2 * 2)

    def at(self, t_gps_s: ArrayLike) -> Between:
        """The track at times (n,)."""
        t = np.asarray(t_gps_s, dtype=np.float64)
        n_all, count = len(self.t_gps_s), self.epochs
        half = count // 2
        right = np.searchsorted(self.t_gps_s, t, side="right")
        first = np.clip(right - half, 0, n_all - count)
        index = first[:, None] + np.arange(count)
        since = self.t_gps_s[index] - t[:, None]
        step = self.step_s
        inside = (right - half == first) & (
            since[:, -1] - since[:, 0] <= (count + 0.5) * step
        )  # one may be missing
        reach = half * step * 1.01
        x = since / reach
        kernel = np.square(np.clip(1.0 - x * x, 1e-6, None))
        powers = x[:, :, None] ** np.arange(_DEGREE + 1)
        left = np.swapaxes(powers * kernel[:, :, None], 1, 2)
        shares = np.linalg.solve(left @ powers, left)  # (n, 4, k): coefficients of the cubic
        slope = shares[:, 1] / reach
        near = self.position_m[index]
        return Between(
            t_gps_s=t,
            position_m=np.einsum("nk,nki->ni", shares[:, 0], near),
            velocity_mps=np.einsum("nk,nki->ni", slope, near),
            inside=inside,
            index=index,
            weight=shares[:, 0],
            slope=slope,
        )

    def covariance(self, between: Between) -> ArrayF:
        """Covariance (3 n, 3 n) of the interpolated positions, correlated in time."""
        return self._spread(between, between.weight)

    def velocity_covariance(self, between: Between) -> ArrayF:
        """Covariance (3 n, 3 n) of the velocities, correlated in time."""
        return self._spread(between, between.slope)

    def _spread(self, between: Between, weight: ArrayF) -> ArrayF:
        slow, white = self._kernels(between, weight)
        kernel = (1.0 - self.white_share) * slow + self.white_share * white
        root = self._roots(between)
        n = len(root)
        full = np.einsum("ij,iab,jcb->iajc", kernel, root, root, optimize=True)
        return np.asarray(full.reshape(3 * n, 3 * n))

    def _roots(self, between: Between) -> ArrayF:
        """Cholesky factors (n, 3, 3) of the positions' covariances, interpolated at the times."""
        cov = self.cov_m2[between.index].mean(axis=1)
        try:
            return np.asarray(np.linalg.cholesky(cov))
        except np.linalg.LinAlgError as error:
            raise GeometryError(
                "a covariance of positions is not positive", expected="sigmas above 0"
            ) from error

    def _kernels(self, between: Between, w: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Covariance (n, n) of sums with weights (n, k), of the slow and the white part of unit variance."""
        t, tau = between.t_gps_s, self.correlation_time_s
        since = self.t_gps_s[between.index] - t[:, None]
        # two times farther apart than a window: the exponential separates
        ahead = (w * np.exp(-since / tau)).sum(axis=1)
        behind = (w * np.exp(since / tau)).sum(axis=1)
        apart = np.exp(-np.abs(t[:, None] - t[None, :]) / tau)
        later = t[None, :] >= t[:, None]
        slow = apart * np.where(later, behind[:, None] * ahead[None, :], ahead[:, None] * behind[None, :])
        white = np.zeros_like(slow)
        width = (self.epochs + 1.5) * self.step_s
        i, j = np.nonzero(np.abs(t[:, None] - t[None, :]) < width)
        near = np.abs(self.t_gps_s[between.index][i, :, None] - self.t_gps_s[between.index][j, None, :])
        slow[i, j] = np.einsum("pk,pkl,pl->p", w[i], np.exp(-near / tau), w[j])
        same = between.index[i, :, None] == between.index[j, None, :]
        white[i, j] = np.einsum("pk,pkl,pl->p", w[i], same.astype(np.float64), w[j])
        return slow, white


def gauss_markov(apart_s: ArrayF, correlation_time_s: float) -> ArrayF:
    """Correlation of a Gauss-Markov process at times that are apart by any array of seconds."""
    return np.asarray(np.exp(-np.abs(apart_s) / correlation_time_s))
