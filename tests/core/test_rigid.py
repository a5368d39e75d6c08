"""Rigid transforms by hand: what they refuse, and how errors pass through them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from thalweg.core import GeometryError, Rigid, exp_rotation, opk_of, plane_rates, rotation_opk

TURN = rotation_opk(0.0, 0.0, np.pi / 2)
"""x of the source is y of the target, y is -x."""


@pytest.mark.parametrize(
    "what",
    [
        pytest.param({"shift_m": [0.0, np.nan, 0.0]}, id="no number"),
        pytest.param({"shift_m": np.zeros(2)}, id="two metres"),
        pytest.param({"R": np.eye(3)[:2]}, id="no square"),
        pytest.param({"R": 1.001 * np.eye(3)}, id="scale"),
        pytest.param({"R": np.diag([1.0, 1.0, -1.0])}, id="reflection"),
        pytest.param({"cov": np.zeros((3, 3))}, id="3x3"),
        pytest.param({"cov": np.diag([1.0, 1, 1, 1, 1, -1e-6])}, id="negative"),
        pytest.param({"cov": np.diag([1e-6, 1e-6, 1e-6, 1e-6, 1e-6, -1e-9])}, id="negative and small"),
        pytest.param({"cov": np.eye(6) + 1e-6 * np.eye(6, k=1)}, id="not symmetric"),
    ],
)
def test_what_is_no_transform_is_refused(what):
    with pytest.raises(GeometryError, match=r"no rotation matrix|no covariance matrix"):
        Rigid(**{"R": np.eye(3), "shift_m": np.zeros(3), "cov": np.zeros((6, 6)), **what})


def test_a_matrix_needs_its_last_row():
    with pytest.raises(GeometryError, match="4x4 with the last row 0 0 0 1"):
        Rigid.from_matrix(2.0 * np.eye(4))
    with pytest.raises(GeometryError, match=r"shape \(3, 4\)"):
        Rigid.from_matrix(np.eye(4)[:3])
    cov = np.diag(np.arange(1.0, 7.0))
    again = Rigid.from_matrix(Rigid(R=TURN, shift_m=np.array([1.0, 2.0, 3.0])).matrix, cov)
    assert_allclose(again.apply([[1.0, 0.0, 0.0]]), [[1.0, 3.0, 3.0]], atol=1e-15)
    assert_array_equal(again.cov, cov)


def test_sigmas_count_the_shift_first():
    """Variances 1, 4, 9 of the shift and 16, 25, 36 of the rotation."""
    T = Rigid(R=TURN, shift_m=np.zeros(3), cov=np.diag(np.square(np.arange(1.0, 7.0))))
    assert_allclose(T.sigma_shift_m, [1.0, 2.0, 3.0])
    assert_allclose(T.sigma_rotation_rad, [4.0, 5.0, 6.0])


def test_an_error_is_put_on_in_the_target_frame_and_found_again():
    T = Rigid(R=TURN, shift_m=np.array([1.0, 2.0, 3.0]))
    error = np.array([0.1, 0.2, 0.3, 0.01, -0.02, 0.03])
    assert_allclose(T.moved(error).error_from(T), error, atol=1e-12)
    # a turn about z of the target by a quarter: the x of the source, on y before, is on -x then
    quarter = T.moved([0.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2])
    assert_allclose(quarter.apply([[1.0, 0.0, 0.0]]), [[0.0, 2.0, 3.0]], atol=1e-15)


def test_errors_of_the_inverse_and_of_a_product_by_differences():
    first = Rigid(R=rotation_opk(0.3, -0.8, 1.1), shift_m=np.array([1.0, 2.0, -3.0]))
    second = Rigid(R=rotation_opk(-0.5, 0.2, 2.0), shift_m=np.array([-4.0, 0.5, 1.0]))
    by_first, by_second = first.by_product(second)
    step, x = 1e-6, [[1.0, -2.0, 0.5]]
    for k, e in enumerate(step * np.eye(6)):
        # one-sided: half the second derivative times the step, 4 m x 1e-6
        for found, J in (
            (first.moved(e).inverse().error_from(first.inverse()), first.by_inverse()),
            ((first.moved(e) @ second).error_from(first @ second), by_first),
            ((first @ second.moved(e)).error_from(first @ second), by_second),
            ((first.moved(e).apply(x) - first.apply(x))[0], first.by_error(x)[0]),
        ):
            assert_allclose(found / step, J[:, k], atol=2e-5)


def test_omega_phi_and_kappa_by_hand():
    """Omega of a quarter turns y to z, and with it the axis that phi turns about."""
    sigmas = np.array([1e-3, 2e-3, 3e-3, 1e-4, 2e-4, 3e-4])
    T = Rigid.from_opk([np.pi / 2, 0.0, 0.0], [1.0, 2.0, 3.0], np.diag(sigmas**2))
    assert_allclose(T.apply([[0.0, 1.0, 0.0]]), [[1.0, 2.0, 4.0]], atol=1e-15)
    assert_allclose(T.sigma_shift_m, [1e-3, 2e-3, 3e-3])
    # about x: omega; about y: kappa, whose axis z went to -y; about z: phi
    assert_allclose(T.sigma_rotation_rad, [1e-4, 3e-4, 2e-4])


def test_a_matrix_without_covariance_is_taken_as_certain():
    assert_array_equal(Rigid.from_matrix(np.eye(4)).cov, np.zeros((6, 6)))
    assert_array_equal(Rigid.from_opk([0.0, 0.0, 0.0], np.zeros(3)).cov, np.zeros((6, 6)))


@pytest.mark.parametrize("omega", [-2.8, -0.4, 0.3, 2.1])
@pytest.mark.parametrize("phi", [-1.5, -0.6, 0.2, 1.5])
@pytest.mark.parametrize("kappa", [-3.0, -0.7, 0.9, 2.5])
def test_omega_phi_and_kappa_come_back_in_every_quadrant(omega, phi, kappa):
    assert_allclose(opk_of(rotation_opk(omega, phi, kappa)), [omega, phi, kappa], atol=1e-13)


@pytest.mark.parametrize(("phi", "sign"), [(np.pi / 2, 1.0), (-np.pi / 2, -1.0)])
def test_upright_omega_and_kappa_are_one_angle_and_kappa_has_it(phi, sign):
    """Where phi is 90 degrees both turn about the same axis: kappa + omega counts, at -90 kappa - omega."""
    found = opk_of(rotation_opk(0.4, phi, 1.1))
    assert_allclose(found, [0.0, phi, 1.1 + sign * 0.4], atol=1e-12)


@pytest.mark.parametrize("sigma", [1e-4, 100.0])
def test_rounding_of_a_covariance_is_measured_by_its_sigmas(sigma):
    """The two halves may differ by 1e-9 of the product of both sigmas, whatever the unit."""
    rounded, different = (sigma**2 * (np.eye(6) + share * np.eye(6, k=1)) for share in (2e-10, 5e-9))
    assert_array_equal(Rigid(R=TURN, shift_m=np.zeros(3), cov=rounded).cov, rounded)
    with pytest.raises(GeometryError, match="no covariance matrix"):
        Rigid(R=TURN, shift_m=np.zeros(3), cov=different)


def test_the_inverse_of_the_identity_has_the_same_covariance():
    cov = np.diag([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]) + 0.05
    assert Rigid(R=np.eye(3), shift_m=np.zeros(3), cov=cov).inverse().cov == pytest.approx(cov)
    # twice the inverse is the transform itself
    there = Rigid(R=TURN, shift_m=np.array([1.0, -2.0, 0.5]), cov=cov)
    assert there.inverse().inverse().cov == pytest.approx(cov)


def test_a_turn_about_north_lowers_what_lies_east():
    """A level plane, and a point a metre to the east of the axis; one beside it in a wall that faces east."""
    normals, arms = np.array([[0.0, 0, 1], [1, 0, 0]]), np.array([[1.0, 0, 0], [0, 2, 0]])
    expected = np.array([[0.0, 0, 1, 0, -1, 0], [1, 0, 0, 0, 0, -2]])
    assert plane_rates(normals, arms) == pytest.approx(expected)


def test_the_covariance_of_a_product_is_that_of_two_independent_errors():
    """All cross terms; the derivatives of the product are tested against differences above."""
    rng = np.random.default_rng(5)

    def pose():
        root = 0.01 * rng.standard_normal((6, 6))
        return Rigid(R=exp_rotation(rng.normal(0, 1, 3)), shift_m=rng.normal(0, 3, 3), cov=root @ root.T)

    one, two = pose(), pose()
    expected = sum(J @ T.cov @ J.T for J, T in zip(one.by_product(two), (one, two), strict=True))
    assert_allclose((one @ two).cov, expected, atol=1e-12 * np.abs(expected).max())


def test_many_rotations_are_each_of_them():
    vectors = np.array([[0.0, 0.0, 0.0], [1e-5, -2e-5, 0.0], [0.3, -2.0, 1.1]])
    assert_allclose(exp_rotation(vectors), [exp_rotation(v) for v in vectors], atol=1e-14)
