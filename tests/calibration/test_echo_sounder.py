"""Echo sounder over a surveyed bed: consistency over seeds, what is not observable and why, blunders."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import chi2

from tests.calibration.echo_runs import SIGMA_RULER_M, TRUE_LEVER_M, EchoSpec, bed_height_m, make_echo_run
from tests.calibration.test_echo_sounder_file import depth_table
from thalweg.calibration import Bed, EchoSettings, estimate_echo_sounder
from thalweg.calibration.echo_sounder import (
    PARAMETERS,
    EchoSounder,
    _missing,
    _prior,
    _rows,
    _run_alone,
    _smoothed,
    check_fit,
    echo_calibration,
    ruler_of,
    settings_of,
    soundings,
    write_report,
)
from thalweg.calibration.ins_lidar import BorderedNormals, PoseErrors, RunPoints
from thalweg.core import CoverageError, GeometryError, LocalFrame, Trajectory, rotation_enu_body
from thalweg.settings.sections import Calibration
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


# ---------------------------------------------------------------- by hand


def test_derivatives_of_a_sounding_over_a_slope():
    """Central differences of its height above a plane, of a boat that heels, pitches, turns and goes on."""
    place, antenna, d = np.array([0.4, -0.3, 0.2]), np.array([-0.2, 0.1, -1.5]), 2.5
    angles, rates = np.array([0.15, -0.1, 0.7]), np.array([0.02, 0.03, 0.2])
    start, velocity = np.array([3.0, 4.0, 1.0]), np.array([0.8, 0.5, 0.05])
    corners = np.array([[-50.0, -50.0], [50.0, -50.0], [-50.0, 50.0], [50.0, 50.0]])
    surface = np.column_stack([corners, 0.3 * corners[:, 0] - 0.2 * corners[:, 1] - 4.0])
    bed = Bed(points_wcs_m=surface, sigma_m=0.03, sigma_datum_m=0.05)

    def above(lever=place, t=0.0, datum=0.0, factor=1.0, moved=0.0, turned=0.0):
        R = rotation_enu_body(*(angles + rates * t))
        leaning = rotation_enu_body(*(angles + rates * t + turned))
        at_antenna = start + velocity * t + R @ antenna + moved
        x = at_antenna + leaning @ (lever + np.array([0.0, 0.0, d * factor]) - antenna)
        return x[2] - (0.3 * x[0] - 0.2 * x[1] - 4.0 + datum)

    at, h = {"lever": place, "t": 0.0, "datum": 0.0, "factor": 1.0, "moved": 0.0, "turned": 0.0}, 1e-6

    def slope(**by):
        more, less = (above(**{k: at[k] + v * step for k, v in by.items()}) for step in (h, -h))
        return (more - less) / (2 * h)

    turn = (rotation_enu_body(*(angles + rates * h)) - rotation_enu_body(*(angles - rates * h))) / (2 * h)
    R = rotation_enu_body(*angles)
    skew = turn @ R.T
    points = RunPoints(
        xyz_scs_m=np.array([[0.0, 0.0, d]]),
        t_gps_s=np.zeros(1),
        position_wcs_m=start[None],
        R_wcs_ics=R[None],
        velocity_wcs_mps=velocity[None],
        rate_wcs_radps=np.array([[skew[2, 1], skew[0, 2], skew[1, 0]]]),
    )
    settings = EchoSettings(errors=ERRORS, sigma_depth_m=0.04)
    found = _rows(points, bed, settings, place, antenna)
    axes = np.eye(3)
    assert found.misfit[0] == pytest.approx(above())
    border = [*(slope(lever=a) for a in axes), slope(t=1.0), slope(datum=1.0), slope(factor=1.0)]
    assert found.border[0] == pytest.approx(border, rel=1e-6)
    pose = [*(slope(moved=a) for a in axes), *(slope(turned=a) for a in axes)]
    assert found.pose[0] == pytest.approx(pose, rel=1e-6)
    assert found.variance[0] == pytest.approx((slope(factor=1.0) / d * 0.04) ** 2 + 0.03**2, rel=1e-6)
    assert found.slope[0] == pytest.approx([0.3, -0.2])
    assert found.inside.all()


RULER = np.array([[4.0, 1.0, -0.5], [1.0, 9.0, 2.0], [-0.5, 2.0, 16.0]]) * 1e-4


def test_what_the_run_alone_gives_has_no_ruler_in_it():
    """Of what is known beside the run: datum and speed of sound always, the lag unless it is asked."""
    settings = EchoSettings(errors=ERRORS, sigma_lag_s=0.04, sigma_sound_speed=0.003)
    bed = SimpleNamespace(sigma_datum_m=0.02)
    others = np.diag([1 / 0.04**2, 1 / 0.02**2, 1 / 0.003**2])
    prior = _prior(RULER, bed, settings)
    ruler = np.linalg.inv(RULER)
    assert prior == pytest.approx(block_diag(ruler, others))
    nothing = _prior(RULER, SimpleNamespace(sigma_datum_m=0.0), replace(settings, sigma_sound_speed=0.0))
    assert np.diag(nothing)[4:] == pytest.approx([1e12, 1e18])
    root = np.random.default_rng(4).standard_normal((6, 9)) * [[3.0], [3], [20], [5], [4], [2]]
    run = root @ root.T
    normals = SimpleNamespace(solve=lambda _, weak: SimpleNamespace(cov_border=np.linalg.inv(run + weak)))
    loose = 1e-2 * np.eye(4)
    known = {
        "x": block_diag(loose[:3, :3], others),
        "y": block_diag(loose[:3, :3], others),
        "z": block_diag(ruler[:2, :2], 1e-2, others),
        "lag": block_diag(loose, others[1:, 1:]),
    }
    sigma = _run_alone(normals, np.zeros(1), prior)
    assert list(sigma) == list(PARAMETERS)
    for k, name in enumerate(PARAMETERS):
        assert sigma[name] == pytest.approx(np.sqrt(np.linalg.inv(run + known[name])[k, k]))


def test_what_a_run_lacks_is_said_by_relief_and_turns():
    settings = EchoSettings(errors=ERRORS, max_sigma_lever_m=0.02, max_sigma_lag_s=0.03)
    poor = {"x": 0.021, "y": 0.019, "z": 0.021, "lag": 0.031}
    everywhere, ahead = np.linspace(0.0, 2 * np.pi, 50), np.array([0.3, 0.3])

    def told(rise: float, heading: np.ndarray) -> dict[str, str]:
        return _missing(poor, settings, np.tile([0.6 * rise, 0.8 * rise], (len(heading), 1)), heading)

    found = told(0.029, everywhere)
    assert list(found) == ["x", "z", "lag"]
    flat = "relief is missing: the bed under the soundings is flat (rms slope 2.9 %)"
    assert found["x"] == f"x: {flat}; the run alone gives 0.021 m"
    assert found["lag"] == f"lag: {flat}; the run alone gives 0.031 s"
    assert found["z"].startswith("z: the poses' heights are not good enough for the vertical offset")
    assert "turns are missing" in told(0.031, ahead)["x"]
    # headings 2 a apart in two: the mean of unit vectors is cos a
    assert "turns are missing" in told(0.031, ahead + np.arccos(0.91) * np.array([-1, 1]))["x"]
    assert "more soundings over slopes" in told(0.031, ahead + np.arccos(0.89) * np.array([-1, 1]))["x"]


PLACED = EchoSounder(
    lever_ics_m=np.array([-0.4, 0.1, 0.3]),
    cov_m2=RULER / 4,
    lag_s=0.0123456789,
    sigma_lag_s=0.0023456789,
    cov_formal_m2=RULER,
    sigma_run={"x": 0.011, "y": np.inf, "z": 0.012, "lag": 0.004},
    not_observed={"y": "y: turns are missing"},
    n_used=100,
    n_rejected=7,
    n_outside=5,
    sigma0=1.1,
)


def test_the_report_and_the_calibration_tell_which_value_is_whose(tmp_path):
    ruler, counts = np.array([-0.41, 0.12, 0.33]), {"rows": 112, "taken": 112}
    write_report(tmp_path / "a" / "r.json", PLACED, ruler, RULER, counts)
    told = json.loads((tmp_path / "a" / "r.json").read_text())
    alone, sigma = [0.011, None, 0.012], [0.01, 0.015, 0.02]
    for k, name in enumerate("xyz"):
        assert told["lever_ics"][name] == {
            "value_m": PLACED.lever_ics_m[k],
            "sigma_m": pytest.approx(sigma[k]),
            "ruler_m": ruler[k],
            "sigma_ruler_m": pytest.approx(2 * sigma[k]),
            "sigma_soundings_alone_m": alone[k],
            "determined": name != "y",
            "refused": "y: turns are missing" if name == "y" else "",
        }
    assert told["lag"] == {
        "value_s": PLACED.lag_s,
        "sigma_s": PLACED.sigma_lag_s,
        "sigma_soundings_alone_s": 0.004,
        "determined": True,
        "refused": "",
    }
    assert told["determined"] == ["x", "z", "lag"]
    assert told["refused"] == ["y: turns are missing"]
    assert told["soundings"] == {**counts, "used": 100, "rejected": 7, "outside_the_bed": 5}
    assert told["sigma0"] == 1.1
    found = echo_calibration(PLACED, run="river", twin=False)
    values, cov = found.block("echo_sounder")
    assert values == pytest.approx(PLACED.lever_ics_m)
    assert cov == pytest.approx(PLACED.cov_m2)
    facts = found.find("echo_sounder").facts
    assert (facts["determined"], facts["ruler"], facts["lag_determined"]) == (["x", "z"], ["y"], True)
    assert (facts["lag_s"], facts["sigma_lag_s"]) == (0.012346, 0.002346)
    source = found.source
    assert (source.run, source.observations, source.sigma0, source.twin) == ("river", 100, 1.1, False)
    no_lag = echo_calibration(replace(PLACED, not_observed={"lag": "lag: no"}), run="river", twin=True)
    facts = no_lag.find("echo_sounder").facts
    assert (facts["determined"], facts["ruler"], facts["lag_determined"]) == (["x", "y", "z"], [], False)


@pytest.mark.parametrize(
    ("changed", "fits"),
    [
        ({"sigma0": 2.9}, True),
        ({"sigma0": 3.1}, False),
        ({"n_rejected": 100}, True),
        ({"n_rejected": 101}, False),
    ],
)
def test_soundings_that_miss_their_bed(changed, fits):
    found = replace(PLACED, **changed)
    if fits:
        check_fit(found)
    else:
        with pytest.raises(GeometryError, match=r"by \d.\d times their sigmas; 100 were used"):
            check_fit(found)


def test_a_ruler_has_a_sigma_and_its_correlations():
    lever, cov = ruler_of({"lever_ics_m": [0.1, 0.2, 0.3], "sigma_lever_m": [0.01, 0.02, 0.0]})
    assert lever == pytest.approx([0.1, 0.2, 0.3])
    assert cov == pytest.approx(np.diag([1e-4, 4e-4, 1e-8]))
    tied = [[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 1.0]]
    of = {"lever_ics_m": [0.0] * 3, "sigma_lever_m": [0.01, 0.02, 0.03], "correlation": tied}
    assert ruler_of(of)[1][0, 1] == pytest.approx(0.5 * 0.01 * 0.02)


def still(n: int, *, gap: int, sigma_m: float = 0.0) -> Trajectory:
    """An epoch a second, from 100 s; no pose at one."""
    cov = np.zeros((n, 6, 6))
    cov[:, range(3), range(3)] = (sigma_m * np.arange(n)[:, None]) ** 2
    return Trajectory(
        frame=LocalFrame(lat_deg=51.0, lon_deg=13.0, h_ell_m=0.0),
        t_gps_s=100.0 + np.arange(n),
        position_wcs_m=np.zeros((n, 3)),
        quaternion_wcs_ics=np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)),
        cov_pose_wcs=cov,
        valid=np.arange(n) != gap,
    )


def test_soundings_within_two_epochs_of_a_gap_are_left_out():
    """Velocities are smoothed over 1.6 s to each side: of epochs of one second two."""
    t = 100.0 + np.array([3.0, 0.0, -0.5, 7.0, 7.5, 8.5, 12.5, 13.0, 13.5, 20.0, 20.5, 3.0, np.nan])
    found, depth, counts = soundings(depth_table(t, np.arange(13.0)), still(21, gap=10))
    assert (found - 100.0).tolist() == [0.0, 3.0, 7.0, 13.5, 20.0]
    assert depth.tolist() == [1.0, 0.0, 3.0, 8.0, 9.0]
    assert counts == {"rows": 13, "of_other_sentences": 0, "without_time": 2, "near_a_gap": 6, "taken": 5}


def test_settings_of_a_section_and_of_a_trajectory():
    """Sigmas of the trajectory grow by 1 cm a second: those at the soundings, in the mean square."""
    plain = Calibration().model_dump(mode="json")
    section = plain["echo_sounder"] | {
        "errors": plain["run_errors"] | {"sigma_position_m": [0.02, 0.045, 0.5]},
        "sigma_depth_m": 0.031,
        "sigma_lag_s": 0.032,
        "sigma_sound_speed": 0.0033,
        "max_sigma_lever_m": 0.034,
        "max_sigma_lag_s": 0.035,
    }
    path = still(11, gap=20, sigma_m=0.01)
    found = settings_of(section, path, np.array([103.0, 104.5, 500.0]))
    rms = np.sqrt((0.03**2 + 0.05**2 + 0.1**2) / 3)
    assert found.errors.sigma_position_m == pytest.approx([rms, rms, 0.5])
    assert settings_of(section, path, np.empty(0)).errors.sigma_position_m == pytest.approx(
        [0.02, 0.045, 0.5]
    )
    values = found.sigma_depth_m, found.sigma_lag_s, found.sigma_sound_speed
    assert values == (0.031, 0.032, 0.0033)
    assert (found.max_sigma_lever_m, found.max_sigma_lag_s) == (0.034, 0.035)


def test_heights_of_planes_through_nine_neighbours():
    """Of x^2 + x y on a grid: the mean of x^2 over three columns is 2/3 more."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(7.0), np.arange(7.0)))
    found = _smoothed(np.column_stack([x, y, x**2 + x * y]))
    assert found[:, :2] == pytest.approx(np.column_stack([x, y]))
    inner = (x > 0) & (x < 6) & (y > 0) & (y < 6)
    assert found[inner, 2] == pytest.approx((x**2 + x * y + 2 / 3)[inner])
    three = np.array([[2.0, 0.0, 5.0], [0.0, 2.0, 3.0], [2.0, 2.0, -1.0]])
    assert _smoothed(three) == pytest.approx(three)


def test_depths_that_are_none_count_as_outside():
    run = make_echo_run(1, EchoSpec(reach_m=12.0, duration_s=30.0))
    depth = run.depth_m.copy()
    depth[[3, 50, 90]] = np.nan, 0.0, -1.0
    whole, less = (
        estimate_echo_sounder(
            run.t_gps_s, d, run.trajectory, run.bed, EchoSettings(errors=ERRORS), ruler_ics_m=run.ruler_m,
            cov_ruler_m2=np.diag(SIGMA_RULER_M**2), lever_ics_antenna_m=LEVER_ANTENNA_M,
        )
        for d in (run.depth_m, depth)
    )  # fmt: skip
    assert less.n_outside == whole.n_outside + 3
    assert less.n_used + less.n_rejected + less.n_outside == len(depth)
    assert less.lever_ics_m == pytest.approx(whole.lever_ics_m, abs=2e-3)
