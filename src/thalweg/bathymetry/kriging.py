r"""Ordinary kriging in flow coordinates, from soundings whose errors last.

The bed is ``z(s, n) = mu + f(s, n)`` with ``cov f = sigma^2 rho(h)``, ``h^2 = (ds/a_s)^2 + (dn/a_n)^2``, and
a sounding is ``y_i = z_i + micro + w_i + c_i g(t_i)``: relief that is smaller than the grid, noise, and an
error that lasts (Gauss-Markov). With ``C = L L'`` of the chosen neighbours, ``u = L^-1 c_0``, ``w = L^-1 1``
and ``y = L^-1 z`` (one Cholesky factor a cell):

    z_0 = u'y + (1 - u'w)/(w'w) w'y,        sigma_0^2 = sigma^2 - u'u + (1 - u'w)^2/(w'w),

the variance of the bed, not of another sounding (Cressie 1993, Statistics for Spatial Data, 3.2; Chiles and
Delfiner 2012, Geostatistics, 3.7 on errors of measurement). An error that all data share does not become
smaller by interpolation and is added apart.

Where the relief is rougher in one part of the river than in another, ``f = g f_1`` with a known factor
``g(s, n)`` and a stationary ``f_1``: everything is divided by ``g``, the mean is then ``1 / g``. A drift
``F beta`` has been taken off the heights with coefficients whose covariance ``B`` is known (generalised least
squares). With the weights ``lambda`` of a cell, its error adds ``d' B d``, ``d = F_0 - lambda' F``: what
universal kriging says (Chiles and Delfiner 2012, 3.4), with the whole survey's drift instead of the
neighbours'.

Neighbours are taken by octants, at most so many of a line: the nearest ones all lie on one leg of a track.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, Final, Self

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from thalweg.core import ArrayF, ArrayI, GeometryError, UnsupportedError, get_num_threads, njit, prange

KINDS: Final = ("exponential", "matern32", "spherical")
"""Covariance models; their ranges are practical ones: there 5 % of the covariance are left."""
_MATERN: Final = 4.743864518104397
"""``(1 + a) exp(-a) = 0.05``."""
_CHUNK: Final = 20_000
"""Cells whose candidates are held at a time."""
_FEW: Final = 1000
_CANDIDATES: Final = 256
_BY_TREE: Final = 1500
"""Observations beyond which a tree finds neighbours faster than all distances do (measured: 5 against 3
microseconds a cell at 250, equal at 4000)."""
_AT_ONCE: Final = 1_000_000
"""Distances in memory."""
_DRIFT_DATA: Final = 800
"""Observations that tell the coefficients of a drift."""
PYKRIGE_MOST: Final = 2000
"""Soundings that PyKrige is given: its constructor computes all pairs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Observations:
    """Heights of the bed at places.

    Parameters
    ----------
    s_m, n_m : (n,) flow coordinates.
    height_m : (n,).
    sigma_white_m : (n,) noise.
    sigma_slow_m : (n,) errors that last.
    t_s : (n,) times, for how long they last; NaN: such an error is of this observation alone.
    line : (n,) number of the line of soundings.
    """

    s_m: ArrayF
    n_m: ArrayF
    height_m: ArrayF
    sigma_white_m: ArrayF
    sigma_slow_m: ArrayF
    t_s: ArrayF
    line: ArrayI

    def __post_init__(self) -> None:
        for name in ("s_m", "n_m", "height_m", "sigma_white_m", "sigma_slow_m"):
            value = np.asarray(getattr(self, name), dtype=np.float64)
            object.__setattr__(self, name, value)
            bad = int(np.sum(~np.isfinite(value)))
            if bad or value.shape != np.shape(self.height_m):
                raise GeometryError(
                    f"{name}: {bad} of {value.size} values are no numbers, shape {value.shape}",
                    expected=f"{np.shape(self.height_m)} finite values",
                )
        # times too far apart to share anything stand for "alone"
        t = np.asarray(self.t_s, dtype=np.float64)
        alone = ~np.isfinite(t)
        t = np.where(alone, -1e15 * (1 + np.arange(len(t))), t)
        object.__setattr__(self, "t_s", t)
        object.__setattr__(self, "line", np.asarray(self.line, dtype=np.int64))

    def __len__(self) -> int:
        return len(self.height_m)

    @property
    def places_m(self) -> ArrayF:
        """Flow coordinates (n, 2)."""
        return np.column_stack([self.s_m, self.n_m])

    def where(self, keep: Any) -> Self:
        """Some of them."""
        return replace(self, **{name: getattr(self, name)[keep] for name in self.__dataclass_fields__})

    def lifted(self, height_m: ArrayF) -> Self:
        """The same with other heights."""
        return replace(self, height_m=height_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class CovarianceModel:
    """How heights of the bed go together.

    Parameters
    ----------
    kind : one of `KINDS`.
    sill_m2 : variance of the bed.
    range_s_m, range_n_m : practical ranges along and across the river.
    micro_m2 : variance of relief that no grid holds.
    slow_time_s : correlation time of errors that last; 0: they do not.
    """

    kind: str
    sill_m2: float
    range_s_m: float
    range_n_m: float
    micro_m2: float = 0.0
    slow_time_s: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise UnsupportedError(f"covariance model {self.kind!r}", expected=", ".join(KINDS))
        if not (self.sill_m2 > 0 and self.range_s_m > 0 and self.range_n_m > 0 and self.micro_m2 >= 0):
            raise GeometryError(f"{self}", expected="a sill and ranges above zero")

    def scaled(self, places_m: ArrayF) -> ArrayF:
        """Places (n, 2) in units of the ranges."""
        return np.ascontiguousarray(places_m / np.array([self.range_s_m, self.range_n_m]))

    def correlation(self, h: ArrayF) -> ArrayF:
        """Correlation at scaled distances."""
        if self.kind == "exponential":
            return np.asarray(np.exp(-3.0 * h))
        if self.kind == "matern32":
            return np.asarray((1 + _MATERN * h) * np.exp(-_MATERN * h))
        return np.asarray(np.where(h < 1, 1 - 1.5 * h + 0.5 * h**3, 0.0))


@njit(cache=True)
def _correlation(h: float, kind: int) -> float:
    if kind == 0:
        return math.exp(-3.0 * h)
    if kind == 1:
        a = 4.743864518104397 * h
        return (1.0 + a) * math.exp(-a)
    return 1.0 - 1.5 * h + 0.5 * h * h * h if h < 1.0 else 0.0


@njit(cache=True)
def _choose(near, ds, dn, line, most, of_octant, of_line, out):  # type: ignore[no-untyped-def]
    """Up to ``most`` of the candidates, which come by distance: so many an octant, so many a line."""
    count = np.zeros(8, dtype=np.int64)
    name = np.full(most, -1, dtype=np.int64)
    taken = np.zeros(most, dtype=np.int64)
    m = 0
    for j in range(near.size):
        if near[j] < 0:
            break
        octant = 0
        if of_octant > 0:
            octant = min(int((math.atan2(dn[j], ds[j]) + math.pi) / (math.pi / 4.0)), 7)
            if count[octant] >= of_octant:
                continue
        slot = -1
        if of_line > 0:
            mine = line[near[j]]
            for q in range(most):
                if name[q] == mine or taken[q] == 0:
                    slot = q
                    break
            if slot < 0 or taken[slot] >= of_line:
                continue
            name[slot] = mine
            taken[slot] += 1
        count[octant] += 1
        out[m] = j
        m += 1
        if m == most:
            break
    return m


def _solve(  # type: ignore[no-untyped-def]
    cells, places, z, white2, slow, t, tau, line, near, most, of_octant, of_line, sill, kind,
    mean, mean_there, functions, functions_there, cov_drift,
):  # fmt: skip
    """Height and variance of each cell; ``cells``, ``places`` in units of the ranges."""
    n = cells.shape[0]
    p = functions.shape[1]
    height = np.full(n, np.nan)
    variance = np.full(n, np.nan)
    for i in prange(n):
        width = near.shape[1]
        ds = np.empty(width)
        dn = np.empty(width)
        for j in range(width):
            k = near[i, j]
            if k < 0:
                break
            ds[j] = places[k, 0] - cells[i, 0]
            dn[j] = places[k, 1] - cells[i, 1]
        chosen = np.empty(most, dtype=np.int64)
        m = _choose(near[i], ds, dn, line, most, of_octant, of_line, chosen)
        if m == 0:
            continue
        # C = U'U by rows: inner loops without a sum and from zero, which the compiler makes vectors of
        U = np.empty((m, m))
        u = np.empty(m)
        w = np.empty(m)
        y = np.empty(m)
        F = np.empty((m, p))
        for a in range(m):
            ja = chosen[a]
            pa = near[i, ja]
            u[a] = sill * _correlation(math.sqrt(ds[ja] * ds[ja] + dn[ja] * dn[ja]), kind)
            w[a] = mean[pa]
            y[a] = z[pa]
            for k in range(p):
                F[a, k] = functions[pa, k]
            U[a, a] = sill + (white2[pa] + slow[pa] * slow[pa])
            for b in range(a + 1, m):
                jb = chosen[b]
                pb = near[i, jb]
                c = sill * _correlation(math.sqrt((ds[ja] - ds[jb]) ** 2 + (dn[ja] - dn[jb]) ** 2), kind)
                if tau > 0.0:
                    c += slow[pa] * slow[pb] * math.exp(-abs(t[pa] - t[pb]) / tau)
                U[a, b] = c
        uu = 0.0
        uw = 0.0
        ww = 0.0
        uy = 0.0
        wy = 0.0
        d = np.empty(p)
        wF = np.zeros(p)
        for k in range(p):
            d[k] = functions_there[i, k]
        sound = True
        for a in range(m):
            if not U[a, a] > 0.0:
                sound = False
                break
            U[a, a] = math.sqrt(U[a, a])
            pivot = U[a]
            for b in range(a + 1, m):
                pivot[b] /= pivot[a]
            u[a] /= pivot[a]
            w[a] /= pivot[a]
            y[a] /= pivot[a]
            for k in range(p):
                F[a, k] /= pivot[a]
                d[k] -= u[a] * F[a, k]
                wF[k] += w[a] * F[a, k]
            uu += u[a] * u[a]
            uw += u[a] * w[a]
            ww += w[a] * w[a]
            uy += u[a] * y[a]
            wy += w[a] * y[a]
            for b in range(a + 1, m):
                row = U[b, b:]
                above = U[a, b:]
                share = pivot[b]
                for k in range(m - b):
                    row[k] -= share * above[k]
                u[b] -= share * u[a]
                w[b] -= share * w[a]
                y[b] -= share * y[a]
                for k in range(p):
                    F[b, k] -= share * F[a, k]
        if not sound:
            continue
        rest = mean_there[i] - uw
        height[i] = uy + rest / ww * wy
        variance[i] = sill - uu + rest**2 / ww
        for k in range(p):
            d[k] -= rest / ww * wF[k]
        for k in range(p):
            for q in range(p):
                variance[i] += d[k] * cov_drift[k, q] * d[q]
    return height, variance


# threads that are started for some cells cost more than they save
_solve_many, _solve_few = njit(cache=True, parallel=True)(_solve), njit(cache=True)(_solve)


def _nearest(points: ArrayF, cells: ArrayF, k: int) -> ArrayI:
    """Numbers (m, k) of the nearest points of each cell, by distance."""
    near = np.empty((len(cells), k), dtype=np.int64)
    block = max(_AT_ONCE // len(points), 1)
    for start in range(0, len(cells), block):
        square = cdist(cells[start : start + block], points, "sqeuclidean")
        row = np.arange(len(square))[:, None]
        some = np.argpartition(square, k - 1, axis=1)[:, :k]
        near[start : start + block] = some[row, np.argsort(square[row, some], axis=1)]
    return near


def krige(
    observations: Observations,
    places_m: ArrayF,
    model: CovarianceModel,
    *,
    roughness: tuple[ArrayF, ArrayF] | None = None,
    drift: tuple[ArrayF, ArrayF, ArrayF] | None = None,
    neighbours: int = 48,
    octants: bool = True,
    of_line: int = 0,
    candidates: int = _CANDIDATES,
    chunk: int = _CHUNK,
) -> tuple[ArrayF, ArrayF]:
    """Heights of the bed and their standard deviations.

    Parameters
    ----------
    observations : see there.
    places_m : (m, 2) flow coordinates.
    model : covariance.
    roughness : factor on the standard deviation of the relief at the observations (n,) and the places (m,);
        None: the same everywhere.
    drift : functions at the observations (n, p) and the places (m, p), and the covariance (p, p) of the
        coefficients with which they have been taken off the heights; None: there is none.
    neighbours : observations of a cell, an eighth in each octant.
    octants : take them by octants.
    of_line : at most so many of one line; 0: any number.
    candidates : nearest observations among which octants and lines choose.
    chunk : cells at a time; changes the memory, not the result.

    Returns
    -------
    height_m, sigma_m : (m,); NaN where the system has no solution.

    Raises
    ------
    GeometryError : fewer than two observations.
    """
    if len(observations) < 2:
        raise GeometryError(f"{len(observations)} soundings", expected="at least two, better two lines")
    points = model.scaled(observations.places_m)
    tree = cKDTree(points) if len(points) > _BY_TREE else None
    # heights about their mean: small numbers keep their digits
    middle = float(observations.height_m.mean())
    g, g_there = roughness or (np.ones(len(points)), np.ones(len(places_m)))
    functions, functions_there, cov_drift = drift or (
        np.empty((len(points), 0)),
        np.empty((len(places_m), 0)),
        np.empty((0, 0)),
    )
    most = min(neighbours, len(points))
    wide = octants or of_line > 0
    width = min(len(points), max(candidates, 4 * neighbours) if wide else most)
    height, variance = np.empty(len(places_m)), np.empty(len(places_m))
    for start in range(0, len(places_m), chunk):
        part = slice(start, start + chunk)
        cells = model.scaled(np.asarray(places_m[part], dtype=np.float64))
        workers, solve = (get_num_threads(), _solve_many) if len(cells) > _FEW else (1, _solve_few)
        if tree is None:
            near = _nearest(points, cells, width)
        else:
            near = tree.query(cells, k=width, workers=workers)[1].reshape(len(cells), -1)
        height[part], variance[part] = solve(
            cells,
            points,
            (observations.height_m - middle) / g,
            (observations.sigma_white_m / g) ** 2 + model.micro_m2,
            observations.sigma_slow_m / g,
            observations.t_s,
            model.slow_time_s,
            observations.line,
            np.ascontiguousarray(near, dtype=np.int64),
            most,
            max(neighbours // 8, 1) if octants else 0,
            of_line,
            model.sill_m2,
            KINDS.index(model.kind),
            1.0 / g,
            1.0 / g_there[part],
            np.ascontiguousarray(functions / g[:, None]),
            np.ascontiguousarray(functions_there[part] / g_there[part, None]),
            np.ascontiguousarray(cov_drift),
        )
    return height * g_there + middle, g_there * np.sqrt(np.maximum(variance, 0.0))


def fit_drift(
    observations: Observations, functions: ArrayF, model: CovarianceModel, roughness: ArrayF
) -> tuple[ArrayF, ArrayF]:
    """Coefficients of a drift beside an unknown mean, by generalised least squares.

    Parameters
    ----------
    observations : up to `_DRIFT_DATA` of them, evenly chosen, tell the coefficients.
    functions : (n, p) of the drift at them.
    model, roughness : covariance, factor (n,) on the standard deviation of the relief.

    Returns
    -------
    coefficients : (p,).
    cov : (p, p).
    """
    some = slice(None, None, -(-len(observations) // _DRIFT_DATA))
    of = observations.where(some)
    X = np.column_stack([np.ones(len(of)), functions[some]])
    factor = cho_factor(observed_covariance(of, model, roughness[some]), lower=True)
    cov = np.linalg.pinv(X.T @ cho_solve(factor, X), hermitian=True)
    value = cov @ (X.T @ cho_solve(factor, of.height_m - of.height_m.mean()))
    return np.asarray(value[1:]), np.asarray(cov[1:, 1:])


def observed_covariance(of: Observations, model: CovarianceModel, g: ArrayF) -> ArrayF:
    """Covariance (n, n) of observed heights about the drift; ``g`` (n,) is the roughness of their places."""
    points = model.scaled(of.places_m)
    cov = np.outer(g, g) * model.sill_m2 * model.correlation(cdist(points, points))
    if model.slow_time_s > 0:
        apart = np.abs(of.t_s[:, None] - of.t_s[None]) / model.slow_time_s
        cov += np.outer(of.sigma_slow_m, of.sigma_slow_m) * np.exp(-apart)
    else:
        cov[np.diag_indices_from(cov)] += of.sigma_slow_m**2
    cov[np.diag_indices_from(cov)] += of.sigma_white_m**2 + g**2 * model.micro_m2
    return np.asarray(cov)


def krige_dense(
    observations: Observations,
    places_m: ArrayF,
    model: CovarianceModel,
    *,
    roughness: tuple[ArrayF, ArrayF] | None = None,
    functions: tuple[ArrayF, ArrayF] | None = None,
) -> tuple[ArrayF, ArrayF]:
    """Universal kriging with all observations in one system: for few of them, and to compare `krige` with.

    Parameters
    ----------
    observations, places_m, model, roughness : as of `krige`.
    functions : of the drift, whose coefficients are unknown, at the observations (n, p) and places (m, p).
    """
    g, g_there = roughness or (np.ones(len(observations)), np.ones(len(places_m)))
    F, F_there = functions or (np.empty((len(observations), 0)), np.empty((len(places_m), 0)))
    points, z = model.scaled(observations.places_m), observations.height_m
    X, X_there = (np.column_stack([np.ones(len(of)), of]) for of in (F, F_there))
    factor = cho_factor(observed_covariance(observations, model, g), lower=True)
    inner = cho_solve(factor, X)
    cov_beta = np.linalg.inv(X.T @ inner)
    middle = float(z.mean())
    weighted = cho_solve(factor, z - middle)
    height, variance = [], []
    for start in range(0, len(places_m), 2000):
        part = slice(start, start + 2000)
        cells = model.scaled(np.asarray(places_m[part], dtype=np.float64))
        c0 = np.outer(g, g_there[part]) * model.sill_m2 * model.correlation(cdist(points, cells))
        rest = X_there[part].T - inner.T @ c0
        height.append(middle + c0.T @ weighted + rest.T @ cov_beta @ (X.T @ weighted))
        variance.append(
            g_there[part] ** 2 * model.sill_m2
            - np.sum(c0 * cho_solve(factor, c0), axis=0)
            + np.sum(rest * (cov_beta @ rest), axis=0)
        )
    return np.concatenate(height), np.sqrt(np.maximum(np.concatenate(variance), 0.0))


def error_covariance(
    observations: Observations,
    places_m: ArrayF,
    model: CovarianceModel,
    *,
    roughness: tuple[ArrayF, ArrayF] | None = None,
    drift: tuple[ArrayF, ArrayF, ArrayF] | None = None,
) -> ArrayF:
    """Covariance (m, m) of the errors of kriging with all observations in one system.

    Parameters
    ----------
    observations, places_m, model, roughness, drift : as of `krige`, but for the mean, which is the same
        everywhere.
    """
    g, g_there = roughness or (np.ones(len(observations)), np.ones(len(places_m)))
    points, cells = model.scaled(observations.places_m), model.scaled(places_m)
    factor = cho_factor(observed_covariance(observations, model, g), lower=True)
    c0 = np.outer(g, g_there) * model.sill_m2 * model.correlation(cdist(points, cells))
    weights, of_mean = cho_solve(factor, c0), cho_solve(factor, np.ones(len(points)))
    rest = 1 - c0.T @ of_mean
    cov = np.outer(g_there, g_there) * model.sill_m2 * model.correlation(cdist(cells, cells))
    cov += np.outer(rest, rest) / of_mean.sum() - c0.T @ weights
    if drift is not None:
        functions, functions_there, cov_drift = drift
        d = functions_there - (weights + np.outer(of_mean, rest) / of_mean.sum()).T @ functions
        cov += d @ cov_drift @ d.T
    return np.asarray((cov + cov.T) / 2)


def krige_by_pykrige(
    observations: Observations, places_m: ArrayF, model: CovarianceModel
) -> tuple[ArrayF, ArrayF]:
    """The same by PyKrige, with one noise for all soundings and errors that do not last.

    Raises
    ------
    UnsupportedError : more than `PYKRIGE_MOST` soundings.
    """
    if len(observations) > PYKRIGE_MOST:
        raise UnsupportedError(
            f"{len(observations)} soundings for PyKrige",
            expected=f"at most {PYKRIGE_MOST}: it computes all pairs",
            cure="Set bathymetry.engine to own",
        )
    from pykrige.ok import OrdinaryKriging

    points, cells = model.scaled(observations.places_m), model.scaled(np.asarray(places_m))
    noise = float(np.mean(observations.sigma_white_m**2 + observations.sigma_slow_m**2)) + model.micro_m2
    total = model.sill_m2 + noise

    def variogram(_: Any, h: ArrayF) -> ArrayF:
        """Semivariances at scaled distances, noise included."""
        return total - model.sill_m2 * model.correlation(np.asarray(h))

    solver = OrdinaryKriging(
        points[:, 0],
        points[:, 1],
        observations.height_m,
        variogram_model="custom",
        variogram_parameters=[noise],
        variogram_function=variogram,
        exact_values=False,
    )
    height, variance = solver.execute("points", cells[:, 0], cells[:, 1])
    # PyKrige's variance is that of another sounding
    return np.asarray(height), np.sqrt(np.maximum(np.asarray(variance) - noise, 0.0))
