"""The place of a field in the world: errors against sigmas, wrong targets, targets in a line."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from tests.bands import band
from tests.calibration import field_blocks as blocks
from thalweg.calibration import MarkerLayout
from thalweg.calibration.field import FieldPoints
from thalweg.calibration.field.datum import FieldDatum, field_datum
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
