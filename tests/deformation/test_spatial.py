"""Errors alike over a length: sums over cells against full matrices, and against sums over rasters."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.spatial.distance import cdist
from scipy.stats import chi2

from thalweg.core import ArrayF, GeometryError
from thalweg.deformation import SpatialErrors, place_in_cells
from thalweg.deformation.field import ErrorField
from thalweg.deformation.foreign import HeightErrors
from thalweg.deformation.foreign.surfaces import volume_variance


def some_errors(rng: np.random.Generator, n: int, size: tuple[int, int], length_m: float) -> SpatialErrors:
    """Errors of n cells of 0.5 m with full covariances of their own."""
    taken = rng.choice(size[0] * size[1], n, replace=False)
    cell = np.column_stack(np.divmod(taken, size[1]))
    cell -= cell.min(axis=0)
    return SpatialErrors("stated", cell, 0.5, 0.02 * rng.standard_normal((n, 3, 3)), length_m)


def full_matrix(errors: SpatialErrors) -> ArrayF:
    """Covariance (3 m, 3 m) of all errors, entry by entry."""
    alike = np.exp(-cdist(errors.cell, errors.cell) * errors.cell_m / errors.correlation_m)
    blocks = np.einsum("iax,jbx,ij->iajb", errors.root, errors.root, alike)
    m = len(errors.cell)
    return blocks.reshape(3 * m, 3 * m)


@pytest.mark.parametrize("length_m", [0.3, 4.0, 100.0])
def test_sums_over_few_and_many_cells_are_those_of_the_full_matrix(length_m):
    rng = np.random.default_rng(4)
    errors = some_errors(rng, 400, (40, 25), length_m)
    cov = full_matrix(errors)
    rows = sp.random(6, 1200, density=0.01, random_state=5, format="csr")
    rows = sp.vstack(
        [rows, rng.standard_normal((2, 1200))]
    ).tocsr()  # pair by pair, and by Fourier transforms
    dense = rows.toarray()
    assert errors.variances(rows) == pytest.approx(np.einsum("ki,ij,kj->k", dense, cov, dense), rel=1e-9)
    columns = rng.standard_normal((1200, 3))
    assert errors.times_covariance(columns) == pytest.approx(cov @ columns, rel=1e-9, abs=1e-12)
    field = ErrorField((errors,), (rows,))
    assert field.covariance_with(field) == pytest.approx(dense @ cov @ dense.T, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("length_m", [0.5, 4.0, 60.0])
def test_draws_have_the_covariance_that_is_stated(length_m):
    rng = np.random.default_rng(6)
    errors = some_errors(rng, 60, (12, 12), length_m)
    products = rng.standard_normal((4, 180))
    n = 600
    drawn = products @ np.array([errors.draw(rng) for _ in range(n)]).T
    expected = np.diag(products @ full_matrix(errors) @ products.T)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], n) / n  # about +-21 % of a variance
    ratio = (drawn**2).mean(axis=1) / expected
    assert ((low < ratio) & (ratio < high)).all()


@pytest.mark.parametrize("length_m", [3.0, 20.0, 200.0])
def test_the_volume_of_a_raster_has_the_variance_of_the_sum_over_its_cells(length_m):
    inside = np.hypot(*(np.indices((60, 40)) - np.array([[[30]], [[20]]]))) < 19
    north, east = np.nonzero(inside)
    plan = np.column_stack([east, north]) * 1.0
    node, cell, cell_m = place_in_cells(plan, length_m)
    assert cell_m == pytest.approx(length_m / 8.0)
    root = np.zeros((len(cell), 3, 3))
    root[:, 2, 2] = 0.05
    weight = np.zeros(3 * len(cell))
    np.add.at(weight, 3 * node + 2, 1.0)  # each point stands for a square metre
    found = SpatialErrors("stated", cell, cell_m, root, length_m).variances(sp.csr_matrix(weight[None]))[0]
    expected = volume_variance(inside, np.ones(2), HeightErrors(0.05, length_m))
    # places in a cell of an eighth of the length count as one
    assert np.sqrt(found) == pytest.approx(np.sqrt(expected), rel=0.01)


def test_points_of_a_cell_share_its_number():
    rng = np.random.default_rng(7)
    plan = rng.uniform(-5.0, 20.0, (500, 2))
    node, cell, cell_m = place_in_cells(plan, 8.0)
    low = plan.min(axis=0)
    assert (np.floor((plan - low) / cell_m) == cell[node]).all()
    assert len(np.unique(cell, axis=0)) == len(cell) == node.max() + 1


def test_lengths_of_zero_are_noise_and_refused_here():
    with pytest.raises(GeometryError, match="errors of single points are noise"):
        SpatialErrors("stated", np.zeros((1, 2), int), 0.1, np.zeros((1, 3, 3)), 0.0)
