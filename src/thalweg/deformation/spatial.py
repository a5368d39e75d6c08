r"""Errors that neighbouring places share: a field over the plan, alike over one length.

With the standard deviation sigma and distance L, the shared
error is a field over the plan with three independent components and the covariance

    sigma_i sigma_j exp(-d_ij / L)

between places at the distance d (Rolstad, Haug and Denby 2009, J. Glaciology 55,
https://doi.org/10.3189/002214309789470950). The points of a cell of L / 8 have one error, so that a sum over
points is one over cells: of few cells pair by pair, of many by Fourier transforms of the grid. What a cell
hides is a correlation of 0.94 that counts as 1, and in the variance of a sum over more than L about a
thousandth. Points above each other have the same place.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.fft import irfft2, next_fast_len, rfft2

from thalweg.core import AnyArray, ArrayF, ArrayI, GeometryError, njit, prange
from thalweg.deformation.field import SharedErrors

CELLS_IN_LENGTH = 8.0
"""Cells of the grid in a correlation length."""
MOST_CELLS = 2048
"""Cells along the longer side of the grid; of shorter correlations a cell counts as one error."""
_FADED = 64
"""Cells after which a correlation has faded (``exp(-8)``)."""
_FEW = 300
"""Cells up to which a sum goes over pairs."""


def torus_spectrum(shape: tuple[int, ...], cell_m: ArrayF, correlation_m: float) -> AnyArray:
    """Fourier transform of the correlation ``exp(-d / L)`` about a cell of a torus of cells.

    Parameters
    ----------
    shape : rows and columns.
    cell_m : (2,) width and height of a cell.
    """
    down, right = (np.minimum(np.arange(n), n - np.arange(n)) for n in shape)
    distance = np.hypot(down[:, None] * cell_m[1], right * cell_m[0])
    return rfft2(np.exp(-distance / correlation_m))


@dataclass(frozen=True, slots=True)
class SpatialErrors(SharedErrors):
    """Errors of places: three components, alike over one length.

    Attributes
    ----------
    name : what errs.
    cell : (m, 2) column and row of each node in a grid of ``cell_m``, from zero.
    cell_m : edge of the cells, metres.
    root : (m, 3, 3) roots of the covariance of each node, world axes, metres.
    correlation_m : L, metres.
    """

    name: str
    cell: ArrayI
    cell_m: float
    root: ArrayF
    correlation_m: float

    def __post_init__(self) -> None:
        if not 0 < self.correlation_m < np.inf or not self.cell_m > 0:
            raise GeometryError(
                f"errors ({self.name}) correlated over {self.correlation_m} m in cells of {self.cell_m} m",
                expected="a length above zero; errors of single points are noise",
            )

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows of the grid."""
        columns, rows = self.cell.max(axis=0) + 1
        return int(columns), int(rows)

    def variances(self, rows: sp.csr_matrix) -> ArrayF:
        """Variance (k,) of products with the derivatives ``rows`` (k, 3 m), component by component."""
        total = np.zeros(rows.shape[0])
        columns, lines = self.size
        table = np.exp(
            -np.hypot(*np.meshgrid(range(columns), range(lines))) * self.cell_m / self.correlation_m
        )
        for scaled in self._scaled(rows):
            scaled.sort_indices()
            many = np.diff(scaled.indptr) > _FEW
            total += _of_pairs(scaled.indptr, scaled.indices, scaled.data, self.cell, table, ~many)
            for k in np.flatnonzero(many):
                u = np.zeros(len(self.cell))
                part = slice(scaled.indptr[k], scaled.indptr[k + 1])
                u[scaled.indices[part]] = scaled.data[part]
                total[k] += float(u @ self.correlated(u))
        return total

    def unit_draw(self, rng: np.random.Generator) -> ArrayF:
        """Components (m, 3), drawn by the covariance of a torus around theirs (Dietrich and Newsam 1997)."""
        spectrum, shape = self._spectrum()
        root = np.sqrt(np.maximum(spectrum.real, 0.0))
        process = np.empty((len(self.cell), 3))
        for axis in range(3):
            field = irfft2(root * rfft2(rng.standard_normal(shape)), shape)
            process[:, axis] = field[self.cell[:, 1], self.cell[:, 0]]
        return process

    def facts(self) -> dict[str, Any]:
        """Its length and its grid."""
        return {
            "correlation_s": None,
            "lasts": f"{self.correlation_m:g} m",
            "correlation_m": self.correlation_m,
            "cell_m": self.cell_m,
            "unit": "m",
        }

    def stored(self) -> Mapping[str, AnyArray]:
        """Arrays from which, with its facts, it is made again."""
        return {"root": self.root, "cell": self.cell}

    def _scaled(self, rows: sp.csr_matrix) -> list[sp.csr_matrix]:
        """For each component of unit variance its derivatives (k, m)."""
        m = len(self.cell)
        blocks = sp.bsr_matrix((self.root, np.arange(m), np.arange(m + 1)), shape=(3 * m, 3 * m))
        scaled = (rows @ blocks.tocsr()).tocsc()
        parts = [scaled[:, axis::3].tocsr() for axis in range(3)]
        for part in parts:
            part.eliminate_zeros()
        return parts

    def _spectrum(self) -> tuple[AnyArray, tuple[int, int]]:
        """Fourier transform of the correlation about a cell on a torus, and its shape (rows, columns)."""
        columns, lines = self.size
        shape = tuple(
            next_fast_len(max(2 * n - 1, n + _FADED), real=True) for n in (lines, columns)
        )  # no two cells of the grid are nearer around the torus than on the grid
        cell_m = np.full(2, self.cell_m)
        return torus_spectrum(shape, cell_m, self.correlation_m), (shape[0], shape[1])

    def correlated(self, u: ArrayF) -> ArrayF:
        """Correlation matrix of the places, times (m, ...)."""
        spectrum, shape = self._spectrum()
        out = np.empty_like(u)
        for q in np.ndindex(u.shape[1:]):
            grid = np.zeros(shape)
            grid[self.cell[:, 1], self.cell[:, 0]] = u[:, *q]
            out[:, *q] = irfft2(spectrum * rfft2(grid), shape)[self.cell[:, 1], self.cell[:, 0]]
        return out


def place_in_cells(plan_m: ArrayF, correlation_m: float) -> tuple[ArrayI, ArrayI, float]:
    """Cells that hold points (n, 2).

    Returns
    -------
    node : (n,) number of the cell of each point.
    cell : (m, 2) column and row of the occupied cells, from zero.
    cell_m : edge of a cell: an eighth of the correlation length, or more where there would be too many.
    """
    low = plan_m.min(axis=0)
    extent = float(np.ptp(plan_m, axis=0).max())
    cell_m = max(correlation_m / CELLS_IN_LENGTH, extent / (MOST_CELLS - 1))
    place = np.floor((plan_m - low) / cell_m).astype(np.int64)
    rows = int(place[:, 1].max()) + 1
    names, node = np.unique(place[:, 0] * rows + place[:, 1], return_inverse=True)
    return node.astype(np.int64), np.column_stack(np.divmod(names, rows)), cell_m


@njit(cache=True, parallel=True)
def _of_pairs(
    start: AnyArray, node: AnyArray, value: AnyArray, cell: AnyArray, table: AnyArray, use: AnyArray
) -> AnyArray:
    """Sum over pairs of entries of each sparse row of values times correlations; zero where not used."""
    out = np.zeros(len(start) - 1)
    for row in prange(len(out)):
        if not use[row]:
            continue
        total = 0.0
        for a in range(start[row], start[row + 1]):
            i = node[a]
            total += value[a] * value[a]
            for b in range(start[row], a):
                j = node[b]
                down, right = abs(cell[i, 1] - cell[j, 1]), abs(cell[i, 0] - cell[j, 0])
                total += 2.0 * value[a] * value[b] * table[down, right]
        out[row] = total
    return out
