"""The adjustment against closed forms, and its covariance against what many seeds show."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse
from scipy.stats import chi2

from thalweg.core import (
    GeometryError,
    Linear,
    Observations,
    Rigid,
    UnobservableError,
    adjust,
    check_rank,
    exp_rotation,
    global_test,
    normal_equations,
    prior,
)
from thalweg.core.adjustment import HUBER_LIMIT, _same, condition, damped_step

LINE = ("height", "slope")


def line(x, y, sigma, *, name="points", thin=False):
    J = np.stack([np.ones_like(x), x], axis=1)
    wide = sparse.csr_array(J) if thin else J

    def model(state):
        return Linear(residual=J @ state - y, jacobian=wide, cov=sigma**2)

    return Observations(name, model)


def of_two(residual, jacobian=None, cov=None):
    """Observations of two unknowns, each by itself unless another derivative is given."""
    jacobian, cov = np.eye(2) if jacobian is None else jacobian, np.ones(2) if cov is None else cov
    return Linear(residual=residual, jacobian=jacobian, cov=cov)


def of_one(values, variance=1.0):
    """The unknown itself, measured as often as there are values."""
    shape = len(values), 1
    return Observations(
        "values",
        lambda x: Linear(residual=x[0] - values, jacobian=np.ones(shape), cov=np.full((*shape, 1), variance)),
    )


def rejected(residual, reject_sigmas):
    """Which of the blocks (n, size) are rejected, where nothing that is looked for changes them."""
    n, size = np.shape(residual)
    blocks = Linear(
        residual=np.ravel(residual), jacobian=np.zeros((n * size, 1)), cov=np.tile(np.eye(size), (n, 1, 1))
    )
    known = Observations("known", prior(np.zeros(1), np.eye(1), [0], 1))
    groups = [Observations("blocks", lambda _: blocks), known]
    found = adjust(groups, np.zeros(1), ["x"], reject_sigmas=reject_sigmas)
    return np.flatnonzero(~found.used["blocks"]).tolist()


@pytest.fixture
def points(rng):
    x, sigma = np.linspace(0, 10, 40), rng.uniform(0.1, 0.5, 40)
    return x, 2.0 - 0.7 * x + sigma * rng.standard_normal(40), sigma


# ---------------------------------------------------------------- closed forms


@pytest.mark.parametrize("thin", [False, True], ids=["dense", "sparse"])
def test_a_line_is_the_weighted_closed_form(points, thin):
    x, y, sigma = points
    found = adjust([line(x, y, sigma, thin=thin)], np.zeros(2), LINE)
    A = np.stack([np.ones_like(x), x], axis=1) / sigma[:, None]
    Q = np.linalg.inv(A.T @ A)
    # float64 of a well-conditioned 2x2 system
    assert_allclose(found.x, Q @ A.T @ (y / sigma), rtol=1e-10)
    assert_allclose(found.cov, Q, rtol=1e-10)
    v = A @ found.x - y / sigma
    assert found.sigma0_squared == pytest.approx(v @ v / 38, rel=1e-9)
    assert found.redundancy == 38
    assert found.group_sigma0["points"] == pytest.approx(np.sqrt(v @ v / 38), rel=1e-9)
    assert found.sigma("slope") == pytest.approx(np.sqrt(Q[1, 1]))
    assert found.correlation()[0, 1] == pytest.approx(Q[0, 1] / np.sqrt(Q[0, 0] * Q[1, 1]))
    assert_allclose(found.block(["slope", "height"]), Q[::-1, ::-1], rtol=1e-10)


@pytest.mark.parametrize("thin", [False, True], ids=["dense", "sparse"])
def test_blocks_are_generalised_least_squares(rng, thin):
    J, y = rng.standard_normal((12, 3)), rng.standard_normal(12)
    root = rng.standard_normal((4, 3, 3)) + 2 * np.eye(3)
    S = root @ np.swapaxes(root, 1, 2)
    whole = np.zeros((12, 12))
    for b in range(4):
        whole[3 * b : 3 * b + 3, 3 * b : 3 * b + 3] = S[b]
    wide = sparse.csr_array(J) if thin else J
    group = Observations("blocks", lambda x: Linear(residual=J @ x - y, jacobian=wide, cov=S))
    found = adjust([group], np.zeros(3), ("a", "b", "c"))
    P = np.linalg.inv(whole)
    assert_allclose(found.cov, np.linalg.inv(J.T @ P @ J), rtol=1e-8)
    assert_allclose(found.x, found.cov @ J.T @ P @ y, rtol=1e-8)
    v = J @ found.x - y
    assert_allclose(
        np.square(found.standardised["blocks"]),
        [v[3 * b : 3 * b + 3] @ np.linalg.solve(S[b], v[3 * b : 3 * b + 3]) for b in range(4)],
        rtol=1e-8,
    )


def test_redundancy_is_shared_among_the_groups(points):
    x, y, sigma = points
    two = [line(x[:5], y[:5], sigma[:5], name="few"), line(x[5:], y[5:], sigma[5:], name="many")]
    found = adjust(two, np.zeros(2), LINE)
    one = adjust([line(x, y, sigma)], np.zeros(2), LINE)
    assert_allclose(found.x, one.x, rtol=1e-10)
    assert sum(found.group_redundancy.values()) == pytest.approx(38, abs=1e-9)
    squares = sum(found.group_sigma0[n] ** 2 * found.group_redundancy[n] for n in ("few", "many"))
    assert squares == pytest.approx(one.sigma0_squared * 38, rel=1e-9)


def test_an_observed_unknown_is_a_weighted_mean():
    told = Observations("told", prior(np.array([1.0]), np.array([[0.04]]), [0], 2))
    seen = Observations("seen", lambda x: of_two(x - [2.0, 5.0], cov=np.array([0.01, 1.0])))
    found = adjust([told, seen], np.zeros(2), ("a", "b"))
    # weights 25 and 100
    assert_allclose(found.x, [(25 * 1 + 100 * 2) / 125, 5.0], rtol=1e-12)
    assert_allclose(found.cov, np.diag([1 / 125, 1.0]), atol=1e-15)


# ---------------------------------------------------------------- Gauss-Helmert


def on_line(state, observed):
    """Condition a + b x - y = 0 with x and y observed."""
    x, y = observed.T
    g = state[0] + state[1] * x - y
    A = np.stack([np.ones_like(x), x], axis=1)[:, None, :]
    B = np.stack([np.full_like(x, state[1]), -np.ones_like(x)], axis=1)[:, None, :]
    return g[:, None], A, B


def test_errors_in_both_coordinates_are_orthogonal_regression(rng):
    true = np.linspace(0, 4, 60)
    xy = np.stack([true, 1.0 + 1.5 * true], axis=1) + 0.1 * rng.standard_normal((60, 2))
    model = condition(on_line, xy, 0.01 * np.eye(2), iterations=4)
    found = adjust([Observations("points", model)], np.array([0.0, 1.0]), LINE)
    # total least squares: the line along the first principal axis through the mean
    _, _, axes = np.linalg.svd(xy - xy.mean(axis=0))
    slope = axes[0, 1] / axes[0, 0]
    # the steps end at a ten-thousandth of a sigma, and sigma of the slope is 0.02
    assert found.x[1] == pytest.approx(slope, abs=2e-6)
    assert found.x[0] == pytest.approx(xy[:, 1].mean() - slope * xy[:, 0].mean(), abs=5e-6)


# ---------------------------------------------------------------- covariance over seeds


def test_covariance_and_band_are_those_of_many_seeds():
    squares, sigma0 = [], []
    truth = exp_rotation([0.3, -0.2, 0.5])
    for seed in range(200):
        rng = np.random.default_rng([7, seed])
        source = rng.standard_normal((12, 3))
        target = source @ truth.T + [1.0, 2.0, 3.0] + 0.01 * rng.standard_normal((12, 3))

        def model(T, a=source, b=target):
            J = T.by_error(a).reshape(-1, 6)
            return Linear(residual=(T.apply(a) - b).ravel(), jacobian=J, cov=np.full(36, 1e-4))

        start = Rigid(R=np.eye(3), shift_m=np.zeros(3))
        found = adjust([Observations("p", model)], start, [f"u{i}" for i in range(6)], update=Rigid.moved)
        error = found.x.error_from(Rigid(R=truth, shift_m=np.array([1.0, 2.0, 3.0])))
        squares.append(error @ np.linalg.solve(found.cov, error))
        sigma0.append(found.sigma0_squared)
    # 200 seeds of 6 and of 30 degrees of freedom; 99.9 % bands
    low, high = chi2.ppf([0.0005, 0.9995], 1200) / 1200
    assert low < np.mean(squares) / 6 < high
    low, high = chi2.ppf([0.0005, 0.9995], 6000) / 6000
    assert low < np.mean(sigma0) < high


# ---------------------------------------------------------------- blunders


@pytest.mark.parametrize(
    ("share", "how"),
    [
        pytest.param(0.05, {"reject_sigmas": 4.5}, id="few"),
        pytest.param(0.25, {"reject_sigmas": 4.5}, id="many"),
        pytest.param(0.05, {}, id="a loss alone rejects too"),
    ],
)
def test_blunders_are_rejected_and_nothing_else(rng, share, how):
    x, sigma = np.linspace(0, 10, 200), np.full(200, 0.1)
    y = 2.0 - 0.7 * x + 0.1 * rng.standard_normal(200)
    clean = rng.permutation(200) >= 200 * share
    y[~clean] += (rng.choice([-1, 1], 200) * rng.uniform(2, 30, 200))[~clean]
    found = adjust([line(x, y, sigma)], np.zeros(2), LINE, loss="huber", **how)
    assert_array_equal(found.used["points"], clean)
    alone = adjust([line(x[clean], y[clean], sigma[clean])], np.zeros(2), LINE)
    assert_allclose(found.x, alone.x, atol=1e-8)
    assert_allclose(found.cov, alone.cov, rtol=1e-8)
    assert found.redundancy == clean.sum() - 2


# ---------------------------------------------------------------- what is not determined


def levels(pairs, n, rng):
    """Height differences between benchmarks."""
    J = np.zeros((len(pairs), n))
    for i, (a, b) in enumerate(pairs):
        J[i, a], J[i, b] = -1.0, 1.0
    seen = J @ np.arange(n) + 0.01 * rng.standard_normal(len(pairs))
    return Observations(
        "levels", lambda x: Linear(residual=J @ x - seen, jacobian=J, cov=np.full(len(pairs), 1e-4))
    )


RING = [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2)]


def test_a_free_network_is_refused_with_its_unknowns(rng):
    names = ("A", "B", "C", "D", "E")
    pinned = Observations("pin", prior(np.array([9.0]), np.eye(1), [4], 5))
    with pytest.raises(UnobservableError) as caught:
        adjust([levels(RING, 5, rng), pinned], np.zeros(5), names)
    # E is held; the other four can be lifted together
    assert sorted(caught.value.parameters) == ["A", "B", "C", "D"]
    assert caught.value.defects == 1
    assert "A" in str(caught.value)


def test_an_unknown_that_nothing_sees_is_named(rng):
    with pytest.raises(UnobservableError, match="do not determine E"):
        adjust([levels(RING, 5, rng)], np.zeros(5), "ABCDE", inner_constraints=None)


# ---------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("group", "message"),
    [
        pytest.param(lambda x: of_two(x * np.nan), "'bad' give numbers that are not", id="nan"),
        pytest.param(lambda x: of_two(x * [np.nan, 1]), "'bad' give numbers that are not", id="one nan"),
        pytest.param(
            lambda x: of_two(x, cov=np.array([1.0, 0.0])), "a variance of 0.0 among 'bad'", id="no variance"
        ),
        pytest.param(
            lambda x: of_two(x, cov=-np.eye(2)[None]), "among 'bad' is not positive", id="no covariance"
        ),
        pytest.param(
            lambda x: of_two(np.cbrt(x - 1), np.diag(np.cbrt(x - 1) ** -2 / 3)),
            "did not converge in 3 steps",
            id="no convergence",
        ),
    ],
)
def test_bad_groups_are_told_by_name(group, message):
    with pytest.raises(GeometryError, match=message):
        adjust([Observations("bad", group)], np.array([5.0, 6.0]), "ab", max_iterations=3)


def test_two_groups_of_one_name_are_refused():
    with pytest.raises(GeometryError, match="expected different names"):
        adjust([Observations("a", of_two)] * 2, np.zeros(2), "pq")


def test_the_cure_of_the_caller_is_told():
    blind = Observations("a", lambda x: of_two(x[:1], np.eye(2)[:1], np.ones(1)))
    with pytest.raises(UnobservableError, match="Turn the boat"):
        adjust([blind], np.zeros(2), "pq", cure="Turn the boat")


def test_a_step_too_far_is_damped():
    """Gauss-Newton alone diverges on atan beyond 1.39."""
    group = Observations("a", lambda x: of_two(np.arctan(x), np.diag(1 / (1 + x**2)), np.ones(1)))
    # a ten-thousandth of its sigma, which is 1
    assert abs(adjust([group], np.array([3.0]), "p", max_iterations=60).x[0]) < 1e-3


@pytest.mark.parametrize(
    ("size", "limit"),
    # upper 0.001 of chi-square with 1, 2, 3 degrees of freedom (Abramowitz and Stegun 1964, table 26.8)
    [(1, 10.828), (2, 13.816), (3, 16.266)],
)
def test_the_limit_of_a_block_is_that_of_its_number_of_coordinates(size, limit):
    """3.2905 sigmas of a normal error are exceeded by one in a thousand, both signs together."""
    residual = np.zeros((10, size))
    residual[8:, -1] = np.sqrt([0.99 * limit, 1.01 * limit])
    assert rejected(residual, 3.2905) == [9]


@pytest.mark.parametrize(("how", "squares"), [({}, (0.3247, 2.0483)), ({"level": 0.01}, (0.2156, 2.5188))])
def test_the_band_of_the_global_test_is_that_of_the_table(how, squares):
    """Ten degrees of freedom: 3.247 and 20.483 are exceeded by 97.5 and 2.5 % (table 26.8)."""
    test = adjust([of_one(np.zeros(11))], np.zeros(1), ["x"]).global_test(**how)
    assert (test.low**2, test.high**2) == pytest.approx(squares, abs=1e-4)


def test_an_adjustment_hands_the_root_of_its_sigma0_squared_to_the_global_test():
    """Residuals 1, -1, 1, -1 with sigmas of 0.5: squares 4 * 4 over three degrees of freedom."""
    found = adjust([of_one(np.array([1.0, -1.0, 1.0, -1.0]), 0.25)], np.zeros(1), ["x"])
    assert found.sigma0_squared == pytest.approx(16 / 3)
    assert found.global_test().sigma0 == pytest.approx(4 / np.sqrt(3))


def test_the_global_test_scales_what_is_too_small_and_warns_on_both_sides():
    """Ten degrees of freedom: 0.3247 and 2.0483 of the square, by table."""
    too_small, right, too_large = (global_test(sigma0, 10) for sigma0 in (1.5, 1.4, 0.5))
    assert [t.factor for t in (too_small, right, too_large)] == [1.5, 1.0, 1.0]
    assert right.note("marks") == ""
    assert too_small.note("marks") == (
        "Global test failed (sigma0 1.50, 0.57 to 1.43 expected): marks err more than stated; standard "
        "deviations are multiplied by 1.50"
    )
    assert "marks err less than stated" in too_large.note("marks")
    # nothing left over tells nothing
    assert (global_test(0.0, 0).factor, global_test(7.0, 0).note("marks")) == (1.0, "")


def test_huber_weights_by_hand():
    """Residuals 1 and 10, limit L: weights 1 and L / 10, costs 1 and 2 L 10 - L^2."""
    found = normal_equations([of_one(np.array([-1.0, -10.0]))], np.zeros(1), 1, [None], "huber")
    assert (found.N[0, 0], found.n[0]) == pytest.approx((1 + HUBER_LIMIT / 10, 1 + HUBER_LIMIT))
    assert found.cost == pytest.approx(1 + 20 * HUBER_LIMIT - HUBER_LIMIT**2)


@pytest.mark.parametrize(
    ("size", "n_left"), [([2.0] * 9 + [14.7, 14.9], 10), ([0.5] * 5 + [2.0, 8.0] + [100.0] * 4, 6)]
)
def test_the_limit_grows_with_the_scatter_of_the_blocks_that_are_left(size, n_left):
    """Half of all normal errors are within 0.6745 sigmas: 2.0 means a scatter of 2.965, five times 14.83.

    Blunders of 100 sigmas hide one of 8: the limit is five times 2.965 with them, and 5 without, as a scatter
    below 1 counts as 1.
    """
    assert rejected(np.array(size)[:, None], 5.0) == list(range(n_left, 11))


def test_the_smallest_eigenvalue_decides_whether_unknowns_are_determined():
    """Two unknowns correlated by ``-(1 - e)`` have the eigenvalue ``e``, and the last pivot ``2 e``."""
    just, not_quite = ([[1.0, 1.0 - e], [1.0 - e, 1.0]] for e in (1.4e-10, 0.7e-10))
    check_rank(np.array(just), "ab", None, "")
    with pytest.raises(UnobservableError, match="do not determine"):
        check_rank(np.array(not_quite), "ab", None, "")


@pytest.mark.parametrize(("part", "named"), [(0.18, ("a", "b")), (0.22, ("a", "b", "c"))])
def test_unknowns_with_a_small_part_in_what_is_free_are_not_named(part, named):
    """1 a + 0.83 b + c's part is free; named is who has more than a fifth of the strongest part.

    Derivatives of length 1 that make a triangle with these sides: their cosines are those of its angles.
    """
    a, b, c = 1.0, 0.83, part
    ab, ac, bc = (
        (third**2 - one**2 - other**2) / (2 * one * other)
        for one, other, third in ((a, b, c), (a, c, b), (b, c, a))
    )
    with pytest.raises(UnobservableError) as caught:
        check_rank(np.array([[1.0, ab, ac], [ab, 1.0, bc], [ac, bc, 1.0]]), ("a", "b", "c"), None, "")
    assert caught.value.parameters == named


def test_huber_limit_of_two_coordinates():
    """86.64 % of normal errors are within 1.5 sigmas, of blocks of two within sqrt(-2 ln 0.1336) = 2.006."""
    J = np.array([[1.0], [0.0]])
    two = Observations("two", lambda x: Linear(residual=J @ x + [10.0, 0.0], jacobian=J, cov=np.eye(2)[None]))
    found = normal_equations([two], np.zeros(1), 1, [None], "huber")
    assert found.N[0, 0] == pytest.approx(0.2006, abs=1e-4)


@pytest.mark.parametrize("G", [np.ones((1, 4)), np.array([[1.0, 2.0, 0.0, -0.5]])], ids=["even", "uneven"])
def test_inner_constraints_are_the_adjustment_of_what_they_leave(rng, G):
    """``G dx = 0`` leaves ``dx = T z``: covariance ``T (T^T N T)^-1 T^T``, whatever the weights in ``G``."""
    group, start = levels(RING, 4, rng), np.array([5.0, -3.0, 1.0, 7.0])
    found = adjust([group], start, "ABCD", inner_constraints=lambda x: G)
    part = group.model(start)
    N = part.jacobian.T @ part.jacobian / 1e-4
    T = np.linalg.svd(G)[2][1:].T
    Q = T @ np.linalg.inv(T.T @ N @ T) @ T.T
    assert_allclose(found.cov, Q, atol=1e-12)
    assert_allclose(found.x, start - Q @ part.jacobian.T @ part.residual / 1e-4, atol=1e-9)
    # all five differences are of one group, and three unknowns are left to them
    assert found.group_redundancy["levels"] == pytest.approx(2.0)
    assert (found.redundancy, found.sigma0_squared) == pytest.approx((2.0, found.group_sigma0["levels"] ** 2))


def test_observations_that_just_determine_the_unknowns_have_no_scatter():
    """Two points make a line: nothing is left over, for the group as for the whole."""
    found = adjust(
        [line(np.array([0.0, 2.0]), np.array([1.0, 5.0]), np.array([0.1, 0.1]))], np.zeros(2), LINE
    )
    assert_allclose(found.x, [1.0, 2.0], atol=1e-9)
    assert_allclose(found.cov, [[0.01, -0.005], [-0.005, 0.005]], rtol=1e-9)
    assert (found.redundancy, found.sigma0_squared) == (0.0, 0.0)
    assert found.group_redundancy["points"] == pytest.approx(0.0, abs=1e-9)
    assert found.group_sigma0["points"] == 0.0
    assert_allclose(found.sigmas, [0.1, np.sqrt(0.005)], rtol=1e-9)


@pytest.mark.parametrize("damping", [0.0, 0.5])
def test_a_damped_step_stays_off_the_datum(damping, rng):
    """``G dx = 0`` whatever the damping; without damping it is the step of least squares."""
    group = levels(RING, 4, rng)
    here = normal_equations([group], np.zeros(4), 4, [None], None)
    G = np.array([[1.0, 2.0, 0.0, -0.5]])
    dx = damped_step(here, tuple("ABCD"), G, damping, "")
    assert_allclose(G @ dx, 0.0, atol=1e-12)
    if damping == 0.0:
        assert_allclose(here.N @ dx, here.n, rtol=1e-9)


@pytest.mark.parametrize(("large", "steps"), [(1e3, 1), (0.0, 10)])
def test_a_gain_that_is_nothing_beside_the_cost_ends_the_steps(large, steps):
    """From x = 0, where 0.01 seems to be won, every step leads to 10; 1e-4 is 1e-10 of a cost of 1e6.

    Alone it is no small gain: steps shrink by damping, 1e-4 first and ten times as much each time, until
    ``1e-4 / (1 + damping)`` is below 1e-8 of a cost of one, at a damping above 9999.
    """

    def model(x):
        return of_two(np.array([0.01 if x[0] == 0.0 else 10.0, large]), np.array([[1.0], [0.0]]))

    found = adjust([Observations("errors", model)], np.zeros(1), ["x"])
    # dampings 0, 1e-4, 1e-3, ... 1e4: ten steps
    assert (found.x[0], found.n_iterations) == (0.0, steps)


def test_a_datum_makes_up_for_its_own_defect_and_for_no_other():
    """Of two unknowns only the difference is observed: a datum of their sum helps, one of it does not."""
    N = np.array([[1.0, -1.0], [-1.0, 1.0]])
    check_rank(N, ("a", "b"), np.array([[1.0, 1.0]]), "")
    with pytest.raises(UnobservableError, match="do not determine"):
        check_rank(N, ("a", "b"), np.array([[1.0, -1.0]]), "")


def test_no_mask_is_a_mask_of_all():
    some, every = np.array([True, False]), np.array([True, True])
    assert [_same(*pair) for pair in ((None, None), (None, every), (every, None), (some, some))] == [True] * 4
    assert [_same(*pair) for pair in ((None, some), (some, None), (some, every))] == [False] * 3
