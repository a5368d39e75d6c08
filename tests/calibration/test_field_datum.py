"""The place of a field in the world: errors against sigmas, wrong targets, targets in a line."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from tests.bands import band
from thalweg.calibration import MarkerLayout
from thalweg.calibration.field import FieldPoints
from thalweg.calibration.field.datum import FieldDatum, field_datum
from thalweg.calibration.field.description import Target
from thalweg.core import GeometryError, LocalFrame, Rigid, exp_rotation

FRAME = LocalFrame(lat_deg=51.028, lon_deg=13.721, h_ell_m=160.0)
SIGMA = (0.008, 0.008, 0.012)
PLACES = np.array([[0, 7, 1.8], [6, 3, 1.6], [4, -2, 0.9], [-1, -6, 1.7], [-6, -4, 0.9], [-6, 3, 0.3]])


def field(n: int = 6) -> FieldPoints:
    saddles = np.concatenate([PLACES[k] + MarkerLayout().saddles_m(64 + k) for k in range(n)])
    names = tuple((64 + k, c) for k in range(n) for c in range(4))
    return FieldPoints(points=names, points_pcs=saddles, cov=np.eye(12 * n) * 1e-8)


def targets(
    T_wcs_pcs: Rigid, seed: int, n: int = 6, wrong: dict[int, np.ndarray] | None = None
) -> list[Target]:
    rng = np.random.default_rng(seed)
    places = T_wcs_pcs.apply(PLACES[:n]) + rng.normal(size=(n, 3)) * SIGMA
    for k, off in (wrong or {}).items():
        places[k] += off
    lat, lon, h = FRAME.to_geodetic(places)
    return [
        Target(name=f"T{k + 1}", marker=64 + k, lat_deg=lat[k], lon_deg=lon[k], h_ell_m=h[k], sigma_m=SIGMA)
        for k in range(n)
    ]


TRUE = Rigid(R=exp_rotation([0.01, -0.02, 2.5]), shift_m=np.array([12.0, -40.0, 0.4]))


def test_errors_are_as_the_covariance_says():
    squares = 0.0
    for seed in range(20):
        found = field_datum(field(), targets(TRUE, seed), FRAME)
        error = TRUE.error_from(found.T_wcs_pcs)
        squares += error @ np.linalg.solve(found.T_wcs_pcs.cov, error)
        assert found.redundancy == 12
    low, high = chi2.ppf([0.0005, 0.9995], 120)
    assert low < squares < high


def test_a_wrong_target_is_named_and_left_out():
    found = field_datum(field(), targets(TRUE, 1, wrong={2: np.array([0.0, 0.0, 0.30])}), FRAME)
    ((name, reason),) = found.rejected
    assert name == "T3"
    assert "measure it again" in reason
    # 0.30 m up, to three sigmas of RTK and of the rest
    assert 250 < float(reason.split("north, ")[1].split(" mm up")[0]) < 350
    error = TRUE.error_from(found.T_wcs_pcs)
    assert error @ np.linalg.solve(found.T_wcs_pcs.cov, error) < chi2.ppf(0.9999, 6)
    assert found.table["used"].tolist() == [True, True, False, True, True, True]


def test_contradictions_that_nobody_can_settle():
    far = np.array([0.4, 0.0, 0.0])
    for n, wrong in ((3, {1: far}), (6, {1: far, 3: -far, 4: np.array([0, 0.5, 0.2])})):
        with pytest.raises(GeometryError, match="RTK targets contradict the field by"):
            field_datum(field(n), targets(TRUE, 1, n, wrong=wrong), FRAME)


def test_targets_in_one_line_and_too_few():
    line = np.array([[k, 2.0 * k, 1.0] for k in range(4)])
    names = tuple((64 + k, c) for k in range(4) for c in range(4))
    saddles = np.concatenate([line[k] + MarkerLayout().saddles_m(0) for k in range(4)])
    points = FieldPoints(points=names, points_pcs=saddles, cov=np.eye(48) * 1e-8)
    lat, lon, h = FRAME.to_geodetic(TRUE.apply(line))
    rtk = [
        Target(name=f"T{k}", marker=64 + k, lat_deg=lat[k], lon_deg=lon[k], h_ell_m=h[k], sigma_m=SIGMA)
        for k in range(4)
    ]
    with pytest.raises(GeometryError, match="T0, T1, T2, T3 stand in one line"):
        field_datum(points, rtk, FRAME)
    missing = [
        *targets(TRUE, 1)[:2],
        Target(name="T9", marker=99, lat_deg=51, lon_deg=13, h_ell_m=0, sigma_m=SIGMA),
    ]
    with pytest.raises(GeometryError, match="2 usable RTK targets; T9: marker 99: 0 of four saddles"):
        field_datum(field(), missing, FRAME)


def test_table_has_the_residuals():
    found: FieldDatum = field_datum(field(), targets(TRUE, 4), FRAME)
    off = found.table[["residual_east_m", "residual_north_m", "residual_up_m"]].to_numpy()
    # 18 numbers with sigmas of 8 and 12 mm, to which six unknowns are fitted
    low, high = np.sqrt(band(12) * np.mean(np.square(SIGMA)) * 12 / 18)
    assert low < off.std() < high
    np.testing.assert_allclose(off.mean(axis=0), 0.0, atol=2e-4)


def far_off(n: int, wrong: dict[int, np.ndarray]) -> list[Target]:
    return targets(TRUE, 1, n, wrong=wrong)


def test_a_target_far_away_is_left_out_and_named():
    found = field_datum(field(4), far_off(4, {1: np.array([0.0, 220.0, 0.0])}), FRAME)
    ((name, reason),) = found.rejected
    assert name == "T2"
    # to three sigmas of RTK and of the rest
    assert 219.9 < float(reason.split("east, ")[1].split(" m north")[0]) < 220.1
    error = TRUE.error_from(found.T_wcs_pcs)
    assert error @ np.linalg.solve(found.T_wcs_pcs.cov, error) < chi2.ppf(0.9999, 6)
    # 12 mm and 8 mm of height over 12 m, four targets less one
    assert 0.0005 < found.sigma_scale < 0.002


def test_several_targets_far_away_are_named_with_their_distances():
    wrong = {1: np.array([0.0, 220.0, 0.0]), 2: np.array([400.0, 0.0, 0.0])}
    with pytest.raises(GeometryError, match=r"by T3 (399\.9|400\.0)\d m, T2 (219\.9|220\.0)\d m, "):
        field_datum(field(), far_off(6, wrong), FRAME)
    with pytest.raises(GeometryError, match="RTK targets contradict the field by"):
        field_datum(field(3), far_off(3, {1: np.array([0.0, 220.0, 0.0])}), FRAME)


@pytest.mark.parametrize("factor", [10.0, 1.02])
def test_a_field_of_another_scale_than_the_targets(factor):
    large = field()
    scaled = replace(large, points_pcs=factor * large.points_pcs)
    with pytest.raises(GeometryError, match="RTK targets contradict the field by"):
        field_datum(scaled, targets(TRUE, 3), FRAME)
