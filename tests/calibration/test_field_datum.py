"""The place of a field in the world: errors against sigmas, wrong targets, targets in a line."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from tests.bands import band
from tests.calibration import field_blocks as blocks
from thalweg.calibration import MarkerLayout
from thalweg.calibration.field import FieldPoints
from thalweg.calibration.field.datum import FieldDatum, field_datum, targets_wcs
from thalweg.calibration.field.description import Target
from thalweg.core import GeometryError, Rigid, exp_rotation

FRAME, SIGMA = blocks.FRAME, blocks.RTK_M
PLACES = np.array([[0, 7, 1.8], [6, 3, 1.6], [4, -2, 0.9], [-1, -6, 1.7], [-6, -4, 0.9], [-6, 3, 0.3]])


def field(n: int = 6, places: np.ndarray = PLACES) -> FieldPoints:
    saddles = np.concatenate([places[k] + MarkerLayout().saddles_m(64 + k) for k in range(n)])
    names = tuple((64 + k, c) for k in range(n) for c in range(4))
    return FieldPoints(points=names, points_pcs=saddles, cov=np.eye(12 * n) * 1e-8)


def targets(
    seed: int, n: int = 6, wrong: dict[int, tuple[float, float, float]] | None = None
) -> tuple[Target, ...]:
    """Targets with errors of RTK, and of some that are far off in the world."""
    places = TRUE.apply(PLACES[:n]) + np.random.default_rng(seed).normal(size=(n, 3)) * SIGMA
    for k, off in (wrong or {}).items():
        places[k] += off
    return blocks.targets([64 + k for k in range(n)], places)


TRUE = Rigid(R=exp_rotation([0.01, -0.02, 2.5]), shift_m=np.array([12.0, -40.0, 0.4]))


def square(found: FieldDatum) -> float:
    error = TRUE.error_from(found.T_wcs_pcs)
    return float(error @ np.linalg.solve(found.T_wcs_pcs.cov, error))


def test_errors_are_as_the_covariance_says():
    runs = [field_datum(field(), targets(seed), FRAME) for seed in range(20)]
    assert {found.redundancy for found in runs} == {12}
    low, high = band(120)
    assert low < np.mean([square(found) for found in runs]) / 6 < high


def test_a_wrong_target_is_named_and_left_out():
    found = field_datum(field(), targets(1, wrong={2: (0.0, 0.0, 0.30)}), FRAME)
    ((name, reason),) = found.rejected
    assert name == "T3"
    assert "measure it again" in reason
    # 0.30 m up, to three sigmas of RTK and of the rest
    assert 250 < float(reason.split("north, ")[1].split(" mm up")[0]) < 350
    assert square(found) < chi2.ppf(0.9999, 6)
    assert found.table["used"].tolist() == [True, True, False, True, True, True]


@pytest.mark.parametrize(
    ("n", "wrong"),
    [
        pytest.param(3, {1: (0.4, 0.0, 0.0)}, id="one of three"),
        pytest.param(3, {1: (0.0, 220.0, 0.0)}, id="far away"),
        pytest.param(6, {1: (0.4, 0.0, 0.0), 3: (-0.4, 0.0, 0.0), 4: (0, 0.5, 0.2)}, id="three of six"),
    ],
)
def test_contradictions_that_nobody_can_settle(n, wrong):
    with pytest.raises(GeometryError, match="RTK targets contradict the field by"):
        field_datum(field(n), targets(1, n, wrong), FRAME)


def test_targets_in_one_line_and_too_few():
    line = np.array([[k, 2.0 * k, 1.0] for k in range(4)])
    rtk = blocks.targets([64, 65, 66, 67], TRUE.apply(line))
    with pytest.raises(GeometryError, match="T1, T2, T3, T4 stand in one line"):
        field_datum(field(4, line), rtk, FRAME)
    missing = [*rtk[:2], replace(rtk[2], name="T9", marker=99)]
    with pytest.raises(GeometryError, match="2 usable RTK targets; T9: marker 99: 0 of four saddles"):
        field_datum(field(), missing, FRAME)


def test_table_has_the_residuals():
    found: FieldDatum = field_datum(field(), targets(4), FRAME)
    off = found.table[["residual_east_m", "residual_north_m", "residual_up_m"]].to_numpy()
    # 18 numbers with sigmas of 8 and 12 mm, to which six unknowns are fitted
    low, high = np.sqrt(band(12) * np.mean(np.square(SIGMA)) * 12 / 18)
    assert low < off.std() < high
    np.testing.assert_allclose(off.mean(axis=0), 0.0, atol=2e-4)


def test_a_target_far_away_is_left_out_and_named():
    found = field_datum(field(4), targets(1, 4, {1: (0.0, 220.0, 0.0)}), FRAME)
    ((name, reason),) = found.rejected
    assert name == "T2"
    # to three sigmas of RTK and of the rest
    assert 219.9 < float(reason.split("east, ")[1].split(" m north")[0]) < 220.1
    assert square(found) < chi2.ppf(0.9999, 6)
    # 12 mm and 8 mm of height over 12 m, four targets less one
    assert 0.0005 < found.sigma_scale < 0.002


def test_several_targets_far_away_are_named_with_their_distances():
    wrong = {1: (0.0, 220.0, 0.0), 2: (400.0, 0.0, 0.0)}
    with pytest.raises(GeometryError, match=r"by T3 (399\.9|400\.0)\d m, T2 (219\.9|220\.0)\d m, "):
        field_datum(field(), targets(1, wrong=wrong), FRAME)


@pytest.mark.parametrize("factor", [10.0, 1.02])
def test_a_field_of_another_scale_than_the_targets(factor):
    large = field()
    scaled = replace(large, points_pcs=factor * large.points_pcs)
    with pytest.raises(GeometryError, match="RTK targets contradict the field by"):
        field_datum(scaled, targets(3), FRAME)


def test_each_number_of_a_datum_by_hand():
    """Weights of RTK and of the turned covariance of each centre; derivatives by differences."""
    root = np.random.default_rng(7).standard_normal((72, 72)) * 4e-4
    points = replace(field(), cov=root @ root.T)
    rtk = targets(5)
    found = field_datum(points, rtk, FRAME)
    T, wcs = found.T_wcs_pcs, targets_wcs(rtk, FRAME)
    centres = points.points_pcs.reshape(6, 4, 3).mean(axis=1)
    v = wcs - T.apply(centres)
    table = found.table
    assert table["target"].tolist() == [t.name for t in rtk]
    assert table["marker"].tolist() == list(range(64, 70))
    names = [f"{a}_m" for a in ("east", "north", "up")]
    np.testing.assert_allclose(table[names], wcs)
    np.testing.assert_allclose(table[[f"residual_{name}" for name in names]], v, atol=1e-12)
    assert table["used"].all()
    W = np.zeros((18, 18))
    for k in range(6):
        mean = np.zeros((3, 72))
        mean[:, 12 * k : 12 * k + 12] = np.tile(np.eye(3), 4) / 4
        own = slice(3 * k, 3 * k + 3)
        W[own, own] = np.linalg.inv(np.diag(np.square(SIGMA)) + T.R @ mean @ points.cov @ mean.T @ T.R.T)
    h = 1e-6
    J = np.column_stack(
        [
            (T.moved(h * e).apply(centres) - T.moved(-h * e).apply(centres)).ravel() / (2 * h)
            for e in np.eye(6)
        ]
    )
    N = J.T @ W @ J
    # the adjustment stops at a small part of a sigma
    sigma = np.sqrt(np.diag(np.linalg.inv(N)))
    assert np.abs(np.linalg.solve(N, J.T @ W @ v.ravel()) / sigma).max() < 0.01
    np.testing.assert_allclose(
        T.cov / np.outer(sigma, sigma), np.linalg.inv(N) / np.outer(sigma, sigma), atol=1e-4
    )
    assert found.redundancy == 12
    assert found.sigma0 == pytest.approx(np.sqrt(v.ravel() @ W @ v.ravel() / 12), rel=1e-4)
    grown = ((centres - centres.mean(axis=0)) @ T.R.T).ravel()
    assert found.sigma_scale == pytest.approx(1 / np.sqrt(grown @ W @ grown), rel=1e-6)
    assert found.rejected == ()
