"""The field of shared errors against full matrices, its limits, draws, and two surveys."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.stats import chi2, false_discovery_control

from thalweg.core import ArrayF, ErrorChain, GeometryError
from thalweg.deformation.field import ErrorField, ErrorGroup, benjamini_hochberg, joint_fields
from thalweg.deformation.m3c2 import ColumnIndex, cut_cylinders, pose_weights


def a_group(rng: np.random.Generator, m: int, tau: float) -> ErrorGroup:
    t = np.sort(rng.uniform(0.0, 60.0, m))
    return ErrorGroup("position", t, rng.normal(size=(m, 3, 3)), tau)


def full_covariance(group: ErrorGroup) -> ArrayF:
    lag = np.abs(group.t_s[:, None] - group.t_s)
    correlation = np.where(lag == 0, 1.0, np.exp(-lag / group.correlation_s) if group.correlation_s else 0.0)
    m = len(group.t_s)
    return np.einsum("kl,kij,lmj->kilm", correlation, group.root, group.root).reshape(3 * m, 3 * m)


def rows_of(rng: np.random.Generator, k: int, m: int) -> sp.csr_matrix:
    rows = sp.csr_matrix(sp.random(k, 3 * m, density=0.3, random_state=rng, data_rvs=rng.standard_normal))
    rows.sort_indices()
    return rows


@pytest.mark.parametrize("tau", [0.0, 0.3, 7.0, 1e9])
def test_variances_and_covariances_are_those_of_the_full_matrix(tau):
    rng = np.random.default_rng(1)
    groups = (a_group(rng, 40, tau), a_group(rng, 25, 3.0))
    rows = (rows_of(rng, 7, 40), rows_of(rng, 7, 25))
    field = ErrorField(groups, rows)
    expected = sum(
        R.toarray() @ full_covariance(g) @ R.toarray().T for g, R in zip(groups, rows, strict=True)
    )
    assert field.variances() == pytest.approx(np.diag(expected), rel=1e-9)
    assert field.covariance_with(field) == pytest.approx(
        expected, rel=1e-9, abs=1e-9 * np.abs(expected).max()
    )
    mean = np.full((1, 7), 1.0 / 7.0)
    assert field.combined(mean).variances()[0] == pytest.approx((mean @ expected @ mean.T)[0, 0], rel=1e-9)


def test_a_markov_chain_has_the_sums_of_its_full_matrix():
    """Also for rows that pass over many moments, and for draws."""
    rng = np.random.default_rng(5)
    m, c, d = 37, 6, 5
    left, size, right = np.linalg.svd(rng.standard_normal((m, d, d)))
    link = (left * np.clip(size, 0.0, 0.98)[:, None, :]) @ right
    group = ErrorGroup("smoothed", np.arange(float(m)), rng.standard_normal((m, c, d)), np.nan, link)
    correlation = np.zeros((m, d, m, d))
    for i in range(m):
        M = np.eye(d)
        for k in range(i, m):
            M = link[k] @ M if k > i else M
            correlation[k, :, i], correlation[i, :, k] = M, M.T
    full = np.einsum("kci,kilj,lej->kcle", group.root, correlation, group.root).reshape(c * m, c * m)
    rows = sp.csr_matrix(sp.random(9, c * m, density=0.03, random_state=rng, data_rvs=rng.standard_normal))
    rows.sort_indices()
    field = ErrorField((group,), (rows,))
    expected = rows @ full @ rows.T
    assert field.variances() == pytest.approx(np.diag(expected), rel=1e-9)
    assert field.covariance_with(field) == pytest.approx(expected, rel=1e-9, abs=1e-9 * expected.max())
    draws = np.array([field.draw(rng) for _ in range(1500)])
    squares = np.einsum("ij,jk,ik->i", draws, np.linalg.inv(expected), draws)
    low, high = chi2.ppf([0.0005, 0.9995], 9 * len(draws))
    assert low < squares.sum() < high


def test_one_error_of_all_moments_adds_up_and_independent_ones_average():
    t = np.linspace(0.0, 10.0, 50)
    rows = sp.csr_matrix(np.tile([0.0, 0.02, 0.0], 50)[None])  # the mean of 50 moments, component north
    for tau, expected in ((np.inf, 0.3**2), (0.0, 0.3**2 / 50)):
        field = ErrorField((ErrorGroup.from_sigmas("position", t, np.array([9.0, 0.3, 9.0]), tau),), (rows,))
        assert field.variances()[0] == pytest.approx(expected, rel=1e-12)


def test_q_values_are_those_of_scipy_and_leave_the_unknown_out():
    p = np.random.default_rng(4).uniform(size=200) ** 2
    assert benjamini_hochberg(p) == pytest.approx(false_discovery_control(p), rel=1e-12)
    with_gaps = np.insert(p, [0, 50], np.nan)
    q = benjamini_hochberg(with_gaps)
    assert np.isnan(q[[0, 51]]).all()
    assert q[np.isfinite(q)] == pytest.approx(false_discovery_control(p), rel=1e-12)


def test_times_that_go_back_are_refused():
    with pytest.raises(GeometryError, match="go back"):
        ErrorGroup.from_sigmas("position", np.array([1.0, 0.0]), np.ones(3), 1.0)
    with pytest.raises(GeometryError, match="correlated over -1"):
        ErrorGroup.from_sigmas("position", np.array([0.0, 1.0]), np.ones(3), -1.0)


# ---------------------------------------------------------------- two surveys of a bank

TAU_S, SIGMA_M, SIGMA_RAD, NOISE_M = 10.0, np.array([0.02, 0.02, 0.03]), np.radians([0.05, 0.05, 0.1]), 0.02
CORES = np.column_stack([np.arange(10.0, 50.0, 2.0), np.zeros(20), np.tile([1.0, 2.5], 10)])
NORMALS = np.tile([0.0, -1.0, 0.0], (20, 1))
SHAPE = {"radius_m": 0.8, "half_length_m": 2.0}


def process(rng: np.random.Generator, t: ArrayF, sigma: ArrayF) -> ArrayF:
    """Errors drawn from their full covariance, not by the recursion of the library."""
    root = np.linalg.cholesky(np.exp(-np.abs(t[:, None] - t) / TAU_S) + 1e-10 * np.eye(len(t)))
    return np.asarray(root @ rng.standard_normal((len(t), 3)) * sigma)


def an_epoch(rng: np.random.Generator) -> tuple[ArrayF, ErrorField, ArrayF]:
    """Mean positions at the core points, their field, and their white variance, of one pass along a plane."""
    t = np.arange(0.0, 60.0, 0.2)
    boat = np.column_stack([t, np.full(len(t), -rng.uniform(8, 15)), np.full(len(t), 0.5)])
    node = np.repeat(np.arange(len(t)), 30)
    bank = np.column_stack(
        [boat[node, 0] + rng.uniform(-4, 4, len(node)), np.zeros(len(node)), rng.uniform(0, 4, len(node))]
    )
    moved = (
        bank + process(rng, t, SIGMA_M)[node] + np.cross(process(rng, t, SIGMA_RAD)[node], bank - boat[node])
    )
    moved += rng.normal(0.0, NOISE_M, moved.shape)
    index = ColumnIndex.of(moved, 1.0)
    cut = cut_cylinders(CORES, NORMALS, index, **SHAPE)
    weights = pose_weights(CORES, NORMALS, index, node, boat, **SHAPE)
    field = ErrorField.of_distances(
        weights,
        ErrorGroup.from_sigmas("position", t, SIGMA_M, TAU_S),
        ErrorGroup.from_sigmas("attitude", t, SIGMA_RAD, TAU_S),
    )
    return cut.along_m, field, NOISE_M**2 / cut.n


def test_distances_of_two_surveys_err_as_the_field_says():
    """Joint squares of 20 distances in 24 pairs, normalised; with independent points they are too large."""
    squares, single, independent = 0.0, [], []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        (a, field_a, white_a), (b, field_b, white_b) = an_epoch(rng), an_epoch(rng)
        error = b - a
        C = field_a.covariance_with(field_a) + field_b.covariance_with(field_b) + np.diag(white_a + white_b)
        assert np.diag(C) == pytest.approx(
            field_a.variances() + field_b.variances() + white_a + white_b, rel=1e-9
        )
        squares += float(error @ np.linalg.solve(C, error))
        single.append(np.abs(error) > 1.96 * np.sqrt(np.diag(C)))
        groups = [ErrorGroup(g.name, g.t_s, g.root, 0.0) for g in field_a.groups]
        independent.append(
            error**2 / (2 * ErrorField(tuple(groups), field_a.rows).variances() + white_a + white_b)
        )
    low, high = chi2.ppf([0.005, 0.995], 24 * len(CORES))
    assert low < squares < high
    assert np.mean(independent) > 3.0
    assert 0.0 < np.mean(single) < 0.12  # 5 %; a pair holds some three independent values


def test_a_chain_in_other_axes_turns_shift_and_rotation():
    """The covariance of (shift, rotation) between two nodes, both parts turned; times from a start."""
    rng = np.random.default_rng(11)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    chain = ErrorChain(
        name="all",
        t_gps_s=1e9 + np.array([5.0, 7.0]),
        root=rng.standard_normal((2, 6, 4)),
        link=np.tile(0.5 * np.eye(4), (2, 1, 1)),
    )
    group = ErrorGroup.of_chain(chain, 1e9, turn)
    assert group.t_s == pytest.approx([5.0, 7.0])
    both = np.kron(np.eye(2), turn)
    across = group.times_covariance(np.eye(12))
    for i in range(2):
        for k in range(2):
            stated = (1.0 if i == k else 0.5) * chain.root[i] @ chain.root[k].T
            assert across[6 * i : 6 * i + 6, 6 * k : 6 * k + 6] == pytest.approx(both @ stated @ both.T)


def test_one_mount_of_two_surveys_is_one_error_on_the_times_of_both():
    """Times go on where the first survey ends; a sum of products of both has the covariance of one error."""
    rng = np.random.default_rng(12)
    sigma = np.array([0.1, 0.2, 0.3])
    fields = []
    for t, name in ((np.array([0.0, 2.0]), "mount"), (np.array([1.0, 4.0, 5.0]), "mount")):
        mount = ErrorGroup.from_sigmas(name, t, sigma, np.inf)
        own = ErrorGroup.from_sigmas("position", t, sigma, 1.0)
        rows = sp.csr_matrix(rng.standard_normal((4, 3 * len(t))))
        fields.append(ErrorField((mount, own), (rows, rows)))
    one, two = joint_fields(fields, common="mount")
    assert [group.name for group in one.groups] == ["mount", "position", "position"]
    assert one.groups[0].t_s == pytest.approx([0.0, 2.0, 3.0, 6.0, 7.0])
    alike = [field.rows[0].toarray().reshape(4, -1, 3).sum(axis=1) for field in fields]
    shared = np.sum(((alike[0] + alike[1]) * sigma) ** 2, axis=1)
    alone = sum(field.groups[1].variances(field.rows[1]) for field in fields)
    assert (one + two).variances() == pytest.approx(shared + alone)
