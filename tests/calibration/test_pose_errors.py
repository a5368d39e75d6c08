"""Processes of pose errors: their inverse covariance, and the elimination against dense algebra."""

from dataclasses import replace

import numpy as np
import pytest

from tests.calibration.echo_runs import POSE_ERRORS
from thalweg.calibration.ins_lidar import BorderedNormals, Knots, PoseErrors, pose_rows
from thalweg.calibration.ins_lidar.pose_errors import SLOW, turns
from thalweg.core import ArrayF, CoverageError, exp_rotation, rotation_enu_body

ERRORS = replace(POSE_ERRORS, knot_s=0.5)


def dense(band: ArrayF) -> ArrayF:
    n = band.shape[1]
    out = np.zeros((n, n))
    for k in range(len(band)):
        out[np.arange(k, n), np.arange(n - k)] = band[k, : n - k]
    return out + np.tril(out, -1).T


@pytest.mark.parametrize("white", [0.0, 0.25])
def test_the_prior_is_the_inverse_of_the_covariance_of_the_processes(white):
    errors = replace(ERRORS, white_share=white)
    knots = Knots.over(0.0, 2.2, errors)
    band, logdet = knots.prior(errors)
    C = np.linalg.inv(dense(band))
    # covariance of the errors at two times, by the interpolation that observations use
    t = np.array([0.0, 1.5])
    east, roll = (np.array([knots.at(unit, t)[:, k] for unit in np.eye(knots.n)]) for k in (0, 3))
    # at knots the processes are exact; 1e-9: float64 through an inverse
    for found, sigma, alike in (
        (east, 0.02, (1 - white) * np.exp(-0.15)),
        (roll, np.deg2rad(0.1), np.exp(-1.5 / 20)),
    ):
        expected = sigma**2 * np.array([[1, alike], [alike, 1]])
        assert found.T @ C @ found == pytest.approx(expected, rel=1e-9)
    assert logdet == pytest.approx(np.linalg.slogdet(dense(band))[1], rel=1e-12)


def test_the_elimination_equals_dense_least_squares(rng):
    knots = Knots.over(10.0, 12.9, ERRORS)
    n, m = 200, 4
    t = rng.uniform(10.0, 12.9, n)
    border, pose, y = rng.normal(size=(n, m)), rng.normal(size=(n, 6)), rng.normal(size=n)
    weight = rng.uniform(0.5, 2.0, n) * 1e4
    band, _ = knots.prior(ERRORS)
    normals = BorderedNormals.of(knots, t, border, pose, y, weight)
    prior_border = np.diag([0.0, 0.0, 3.0, 0.0])
    found = normals.solve(band, prior_border)

    A = np.zeros((n, m + knots.n))
    A[:, :m] = border
    local, at = knots.spread(pose, t), knots.unknowns(knots.interval(t))
    for row in range(n):
        A[row, m + at[row]] += local[row]
    P = np.zeros((m + knots.n,) * 2)
    P[:m, :m], P[m:, m:] = prior_border, dense(band)
    N = A.T @ (A * weight[:, None]) + P
    x = np.linalg.solve(N, A.T @ (weight * y))
    # float64; the normal matrix has a condition of 1e8
    assert found.border == pytest.approx(x[:m], rel=1e-6)
    assert found.errors == pytest.approx(x[m:], abs=1e-6 * np.abs(x[m:]).max())
    assert found.cov_border == pytest.approx(np.linalg.inv(N)[:m, :m], rel=1e-6)
    assert found.logdet == pytest.approx(np.linalg.slogdet(N)[1], rel=1e-9)
    v = y - A @ x
    assert found.omega == pytest.approx(weight @ v**2 + x @ P @ x, rel=1e-8)
    # how many observations the errors use up: trace of the dense hat matrix of these unknowns
    B = A[:, m:]
    Nb = B.T @ (B * weight[:, None])
    # 1e-4: a numerical derivative with steps of 1e-3
    assert normals.taken(band) == pytest.approx(np.trace(Nb @ np.linalg.inv(Nb + dense(band))), rel=1e-4)


def test_a_turn_moves_a_point_about_the_antenna(rng):
    R = rotation_enu_body(np.array([0.05]), np.array([-0.04]), np.array([2.1]))
    arm, normal = np.array([[3.0, -4.0, 1.0]]), np.array([[0.6, 0.0, 0.8]])
    e = 1e-5
    rows = pose_rows(normal, arm, R)[0]
    for k, (roll, pitch, heading) in enumerate(np.eye(3) * e):
        turned = rotation_enu_body(0.05 + roll, -0.04 + pitch, 2.1 + heading) @ R[0].T
        # 1e-4: second order of a turn by 1e-5
        assert rows[3 + k] * e == pytest.approx(normal[0] @ (turned @ arm[0] - arm[0]), rel=1e-4)
    assert rows[:3] == pytest.approx(normal[0])


def test_small_turns_are_rotations():
    v = np.deg2rad([[0.2, -0.3, 0.25]])
    # third order: (0.44 deg)^3 / 6 = 8e-8
    assert turns(v)[0] == pytest.approx(exp_rotation(v[0]), abs=1e-7)


def test_sections_are_in_degrees():
    section = {"sigma_position_m": (0.02, 0.02, 0.03), "sigma_attitude_deg": (0.1, 0.1, 0.2), "knot_s": 2.0}
    errors = PoseErrors.from_section(section)
    assert errors.sigma_attitude_rad == pytest.approx(np.deg2rad([0.1, 0.1, 0.2]))
    assert Knots.over(0.0, 10.0, errors).stride == SLOW + 3 * 20


def test_a_run_without_a_point_on_a_cone_is_refused_with_what_to_check():
    # A wrong sheet named as the antenna's marker put the scanner metres away: nothing met a cone any more.
    none = np.zeros(0)
    with pytest.raises(CoverageError, match=r"no point of the run .* the antenna's marker"):
        BorderedNormals.of(
            Knots.over(10.0, 12.9, ERRORS), none, np.zeros((0, 6)), np.zeros((0, 6)), none, none
        )
