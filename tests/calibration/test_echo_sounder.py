"""Echo sounder over a surveyed bed: consistency over seeds, what is not observable and why, blunders."""

import numpy as np
import pytest
from scipy.stats import chi2

from tests.calibration.echo_runs import SIGMA_RULER_M, TRUE_LEVER_M, EchoSpec, bed_height_m, make_echo_run
from thalweg.calibration import Bed, EchoSettings, estimate_echo_sounder
from thalweg.calibration.echo_sounder import PARAMETERS, EchoSounder
from thalweg.calibration.ins_lidar import BorderedNormals, PoseErrors
from thalweg.core import CoverageError, GeometryError
from thalweg_lab.studies.cone_runs import LEVER_ANTENNA_M

ERRORS = PoseErrors(
    sigma_position_m=np.array([0.02, 0.02, 0.03]), sigma_attitude_rad=np.deg2rad([0.1, 0.1, 0.2])
)


def estimated(seed: int, spec: EchoSpec, *, away_m: float = 0.0) -> EchoSounder:
    run = make_echo_run(seed, spec)
    bed = run.bed
    if away_m:
        away = bed.points_wcs_m + np.array([away_m, 0.0, 0.0])
        bed = Bed(points_wcs_m=away, sigma_m=0.01, sigma_datum_m=0.01)
    return estimate_echo_sounder(
        run.t_gps_s,
        run.depth_m,
        run.trajectory,
        bed,
        EchoSettings(errors=ERRORS),
        ruler_ics_m=run.ruler_m,
        cov_ruler_m2=np.diag(SIGMA_RULER_M**2),
        lever_ics_antenna_m=LEVER_ANTENNA_M,
    )


def test_consistent_over_seeds_and_formal_not():
    n, spec = 6, EchoSpec(reach_m=12.0, duration_s=40.0)
    consistent, formal = [], []
    for seed in range(n):
        found = estimated(seed, spec)
        e = found.lever_ics_m - TRUE_LEVER_M
        consistent.append(e @ np.linalg.solve(found.cov_m2, e) / 3)
        formal.append(e @ np.linalg.solve(found.cov_formal_m2, e) / 3)
    # band of 99 %, two-sided: 0.35 to 2.06
    low, high = chi2.ppf([0.005, 0.995], 3 * n) / (3 * n)
    assert low < np.mean(consistent) < high
    assert np.mean(formal) > 50


def test_relief_and_turns_observe_all(monkeypatch):
    solve, steps = BorderedNormals.solve, []

    def noted(self, *words):
        found = solve(self, *words)
        steps.append(np.abs(found.border[:4]) / np.sqrt(np.diag(found.cov_border)[:4]))
        return found

    monkeypatch.setattr(BorderedNormals, "solve", noted)
    found = estimated(1, EchoSpec(reach_m=12.0, lag_s=0.08))
    # all steps but the last are longer than a hundredth of a sigma; then each unknown is solved alone
    *before, last = [float(step.max()) for step in steps[: -len(PARAMETERS)]]
    assert last < 0.01 < min(before)
    assert found.observed == ("x", "y", "z", "lag")
    # a third of the ruler's 3 cm
    assert np.all(np.sqrt(np.diag(found.cov_m2))[:2] < 0.012)
    # the bed's datum (1 cm) and the speed of sound (6 mm at 3 m) are in every sounding: not below 1.1 cm
    assert 0.011 < np.sqrt(found.cov_m2[2, 2]) < 0.02
    assert found.lag_s == pytest.approx(0.08, abs=4 * found.sigma_lag_s)
    # one quarter of the prior knowledge of 50 ms
    assert found.sigma_lag_s < 0.0125
    assert found.n_used + found.n_rejected + found.n_outside == len(
        make_echo_run(1, EchoSpec(reach_m=12.0)).t_gps_s
    )


def test_a_flat_bed_leaves_x_and_y_to_the_ruler():
    flat = EchoSpec(reach_m=12.0, relief_m=0.0, sway=0.1)
    found = estimated(1, flat)
    # hardly any heave either: no offset in time
    assert found.observed == ("z",)
    assert "relief is missing" in found.not_observed["x"]
    assert np.sqrt(np.diag(found.cov_m2))[:2] == pytest.approx(SIGMA_RULER_M[:2], rel=0.03)
    # the run alone, without the ruler
    assert min(found.sigma_run[name] for name in "xy") > 2 * SIGMA_RULER_M.max()
    # the ruler's height, and what is known of the lag, add their weights to those of the run
    alone = 1 / found.cov_m2[2, 2] - 1 / SIGMA_RULER_M[2] ** 2
    assert found.sigma_run["z"] == pytest.approx(alone**-0.5, rel=1e-4)
    assert found.sigma_run["lag"] ** -2 == pytest.approx(found.sigma_lag_s**-2 - 0.05**-2, rel=0.02)


def test_one_heading_on_slopes_misses_turns():
    found = estimated(1, EchoSpec(reach_m=12.0, turning=False, sway=0.1, duration_s=120.0))
    assert "y" in found.not_observed
    assert "turns are missing" in found.not_observed["y"]


def test_blunders_are_rejected_and_counted():
    spec = EchoSpec(reach_m=12.0, duration_s=120.0)
    clean, dirty = estimated(3, spec), estimated(3, EchoSpec(reach_m=12.0, duration_s=120.0, blunders=0.05))
    assert clean.n_rejected < 0.005 * clean.n_used
    # 5 % of 1200, three sigmas of the binomial number
    assert dirty.n_rejected == pytest.approx(60, abs=25)
    shift = np.abs(dirty.lever_ics_m - clean.lever_ics_m)
    assert np.all(shift < np.sqrt(np.diag(clean.cov_m2)))


def test_soundings_beside_the_bed_are_refused():
    with pytest.raises(CoverageError, match=r"0 of \d+ soundings lie over the surveyed bed.*Survey the bed"):
        estimated(1, EchoSpec(reach_m=12.0, duration_s=30.0), away_m=500.0)


def test_the_bed_is_its_triangles():
    side = np.arange(0.0, 4.1, 0.5)
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    plane = np.column_stack([grid, 0.1 * grid[:, 0] - 0.2 * grid[:, 1] - 3.0])
    bed = Bed(points_wcs_m=plane, sigma_m=0.01, sigma_datum_m=0.0)
    height, slope, inside = bed.at(np.array([[1.3, 2.2], [9.0, 0.0]]))
    assert inside.tolist() == [True, False]
    assert height[0] == pytest.approx(0.13 - 0.44 - 3.0)
    assert slope[0] == pytest.approx([0.1, -0.2])
    holes = Bed(points_wcs_m=plane, sigma_m=0.01, sigma_datum_m=0.0, longest_edge_m=0.6)
    assert not holes.at(np.array([[1.3, 2.2]]))[2].any()
    with pytest.raises(GeometryError, match="not on one line"):
        Bed(points_wcs_m=plane[:9], sigma_m=0.01, sigma_datum_m=0.0)
    assert bed_height_m(np.zeros((1, 2)), 0.0)[0] == -3.0
