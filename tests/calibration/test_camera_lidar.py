"""The camera-lidar calibration on a small yard: right, consistent; refusals of what geometry cannot give."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from tests.bands import band
from tests.calibration import cone_yard as yard
from thalweg.calibration import Cone, Position, SearchRange, fit_reference, search
from thalweg.calibration.camera_lidar import (
    CameraLidar,
    CameraLidarSettings,
    FieldErrors,
    calibrate_camera_lidar,
)
from thalweg.calibration.camera_lidar.adjustment import cone_table, report, residual_table, sensor_table
from thalweg.calibration.camera_lidar.model import Layout, Unknowns, field_group
from thalweg.core import InputError, Rigid, UnobservableError
from thalweg.settings.sections import LidarAccuracy

Yard, NOMINAL = yard.Yard, yard.NOMINAL
SEEN = ["C1", "C2", "C3", "C4", "C5", "C6"]


def calibrated(y, positions: int = 3, **settings) -> CameraLidar:
    return calibrate_camera_lidar(
        y.references(), y.positions(positions), NOMINAL, CameraLidarSettings(**settings)
    )


def square(result: CameraLidar, truth: Rigid) -> float:
    error = result.T_ccs_scs.error_from(truth)
    return float(error @ np.linalg.solve(result.T_ccs_scs.cov, error))


@pytest.fixture(scope="module")
def good():
    y = Yard(seed=3)
    return y, calibrated(y)


# 22.5: six degrees of freedom, 99.9 %
LIKELY = 22.5

# ---------------------------------------------------------------- results


def test_three_positions(good):
    y, result = good
    assert square(result, y.truth) < LIKELY
    assert list(result.cones) == SEEN
    # P2 Table 1 has 1.0, 0.4, 0.2 mm and 0.067, 0.035, 0.015 degrees; here are five revolutions each
    assert (result.T_ccs_scs.sigma_shift_m < [0.0015, 0.0007, 0.0005]).all()
    assert (np.rad2deg(result.T_ccs_scs.sigma_rotation_rad) < [0.015, 0.02, 0.067]).all()
    assert 0.95 < result.group_sigma0["lidar"] < 1.05
    # six for each cone and position, 6 for the orientation
    assert len(result.adjusted.names) == 6 * 6 + 6 + 3 * 6
    assert 0.9 < np.sqrt(result.variance_factor) < 1.1


def test_nothing_is_silently_lost(good):
    _, result = good
    table = result.detection
    assert len(table) == 3 * 8
    parts = ["used", "grazing", "outline", "end", "in_front", "behind", "beside", "left_out"]
    np.testing.assert_array_equal(table[parts].sum(axis=1), table["predicted"])
    unseen = table[~table["found"]]
    assert set(unseen["cone"]) == {"C7", "C8"}
    assert unseen["reason"].str.startswith("no beam meets it: it stands outside").all()
    used = table[table["found"]].set_index(["position", "cone"])["used"]
    residuals = result.residuals.set_index(["position", "cone"])
    np.testing.assert_array_equal(residuals["points"], used.loc[residuals.index])
    assert result.points["used"].sum() == used.sum()
    assert len(result.points) == table["predicted"].sum()
    # the points of a cone are within five times 17 mm of it, their mean within four sigmas of none
    assert (residuals["rms_mm"] < 25).all()
    assert (residuals["mean_mm"].abs() < 4 * residuals["sigma_mean_mm"]).all()
    assert len(result.references) == 8 * 32


def test_tables_for_people(good):
    y, result = good
    facts = report(result, NOMINAL)
    assert facts["unknowns"] == 60
    assert facts["lever_length_m"] == pytest.approx(np.linalg.norm(y.truth.shift_m), abs=0.005)
    np.testing.assert_allclose(np.diag(facts["correlation"]), 1.0)
    np.testing.assert_allclose(facts["from_nominal"]["shift_mm"], 1e3 * yard.TRUE_ERROR[:3], atol=5)
    cones = cone_table(result.cones)
    assert cones["half_angle_deg"].between(24.5, 25.5).all()
    assert (cones[["sigma_apex_x_mm", "sigma_axis_1_deg", "sigma_half_angle_deg"]] > 0).all(axis=None)
    places = sensor_table(["position_1"], result.adjusted.x.poses[:1], result.T_ccs_scs)
    apart = places[["x_m", "y_m", "z_m"]].diff().iloc[1]
    assert np.linalg.norm(apart) == pytest.approx(np.linalg.norm(result.T_ccs_scs.shift_m))


def test_no_mean_residual_stays_on_curved_surfaces():
    """Sixty revolutions, sharp marks: means to 0.2 mm, where ranges on a cone are 0.6 mm too long.

    From three sides: the six unknowns of the orientation could take up the means of one.
    """
    sharp = {"sigma_pose_m": 1e-5, "sigma_pose_deg": 1e-4, "sigma_mark_m": 1e-5}
    y = Yard(seed=1, frames=20, near_m=0.6, **sharp)
    references = [replace(r, form_sigma_m=1e-4) for r in y.references()]
    how = CameraLidarSettings(within=None, contradiction_sigmas=99.0)
    table = calibrate_camera_lidar(references, y.positions(3), y.truth, how).residuals
    assert len(table) == 18
    # 18 means, 99.9 %; found 0.5. Without the excess of the ranges 5.3, with its sign turned 18
    assert np.mean((table["mean_mm"] / table["sigma_mean_mm"]) ** 2) < chi2.ppf(0.999, 18) / 18


def test_the_lidar_itself_in_the_field():
    """P1 2.3: five for each cone and six for the exterior orientation of the lidar."""
    y = Yard(seed=6)
    flat = [replace(c, half=np.deg2rad(25.0)) for c in y.cones]
    y = replace(y, cones=flat, there=flat)
    one = replace(y.positions(1)[0], T_pcs_ccs=Rigid(R=np.eye(3), shift_m=np.zeros(3)))
    camera = yard.camera_poses()[0]
    settings = CameraLidarSettings(free_half_angle=False, within=None)
    start = camera @ y.truth.moved([0.005, -0.005, 0.003, 0.003, -0.002, 0.004])
    result = calibrate_camera_lidar(y.references(), [one], start, settings)
    assert len(result.adjusted.names) == 5 * 6 + 6
    assert square(result, camera @ y.truth) < LIKELY


def test_errors_that_poses_and_points_share_enter_with_their_signs():
    """A network that is bent moves poses and cones together: residuals at the truth, drawn from its
    covariance."""
    y = Yard(seed=5, frames=1)
    references, poses = y.references()[:2], [p.T_pcs_ccs for p in y.positions(2)]
    counts = {r.name: len(r.points_m) for r in references}
    cones = [fit_reference(r).cone for r in references]
    seen = [cone.see(r.points_m) for r, cone in zip(references, cones, strict=True)]
    exact = [
        replace(r, points_m=r.points_m - on.distance_m[:, None] * on.normal)
        for r, on in zip(references, seen, strict=True)
    ]
    rng = np.random.default_rng(31)
    n = 12 + 3 * sum(counts.values())
    # a few modes that all share, and little of each number's own
    root = np.hstack([rng.normal(0, 1e-4, (n, 4)), 1e-5 * np.eye(n)])
    errors = FieldErrors(cov=root @ root.T, points=counts)
    layout = Layout(cones=tuple(counts), positions=("a", "b"), free_half_angle=True, free_pose=(True, True))
    truth = Unknowns(cones=tuple(cones), T_ccs_scs=y.truth, poses=tuple(poses))
    squares = []
    for _ in range(20):
        e = root @ rng.standard_normal(root.shape[1])
        measured = [T.moved(e[6 * k : 6 * k + 6]) for k, T in enumerate(poses)]
        parts = np.split(e[12:].reshape(-1, 3), np.cumsum(list(counts.values()))[:-1])
        drawn = [
            replace(r, points_m=r.points_m + part, form_sigma_m=0.0)
            for r, part in zip(exact, parts, strict=True)
        ]
        used = [np.ones(len(r.points_m), bool) for r in drawn]
        linear = field_group(layout, list(zip(drawn, used, strict=True)), measured, errors).model(truth)
        squares.append(linear.residual @ np.linalg.solve(linear.cov[0], linear.residual))
    low, high = band(len(linear.residual) * len(squares))
    assert low < np.mean(squares) / len(linear.residual) < high


# ---------------------------------------------------------------- nominal mounts and the search


def test_the_search_bears_decimetres_and_degrees():
    y = Yard(seed=1, frames=1)
    rng = np.random.default_rng([8, 1])
    # two sigmas of the range at most
    off = np.concatenate([rng.uniform(-0.15, 0.15, 3), np.deg2rad(rng.uniform(-4, 4, 3))])
    found = search(
        [Cone(apex_m=c.apex, axis=c.axis, half_angle_rad=c.half) for c in y.cones],
        [c.length for c in y.cones],
        y.positions(3),
        y.truth.moved(off),
        SearchRange(),
    )
    error = found.T_ccs_scs.error_from(y.truth)
    assert np.linalg.norm(error[:3]) < 0.05
    assert np.rad2deg(np.linalg.norm(error[3:])) < 0.5
    assert found.score > 0.6


# ---------------------------------------------------------------- what geometry cannot give


@pytest.mark.parametrize("which", [[0], [0, 6, 7]], ids=["one cone", "one that is seen"])
def test_a_single_cone_is_refused(which):
    y = Yard(seed=4, frames=2)
    settings = CameraLidarSettings(within=SearchRange(tries=500))
    with pytest.raises(UnobservableError, match=r"do not determine .*rotation") as caught:
        calibrate_camera_lidar([y.references()[i] for i in which], y.positions(1), NOMINAL, settings)
    assert "The lidar sees C1 only" in str(caught.value)
    assert "Add a cone" in str(caught.value)
    assert any(p.startswith("rotation") for p in caught.value.parameters)


def test_one_cone_from_two_orientations_is_enough():
    y = Yard(seed=4, frames=2)
    result = calibrate_camera_lidar(y.references()[:1], y.positions(2), NOMINAL)
    assert square(result, y.truth) < LIKELY


@pytest.mark.parametrize(
    ("points", "message"), [(np.zeros((0, 3)), r"shape \(0, 3\)"), (np.full((2, 3), np.nan), "not finite")]
)
def test_empty_scans_are_refused(points, message):
    pose = Rigid(R=np.eye(3), shift_m=np.zeros(3))
    with pytest.raises(InputError, match=message):
        Position.measured(
            "position_2",
            pose,
            points,
            LidarAccuracy(sigma_component_m=0.017, divergence_mrad=0.0, sigma_weak_m=0.0, sigma_time_s=0.0),
        )


def test_residuals_of_a_cone_by_hand():
    """Ranges off by 5, -15, 5, -15 mm, cosine 0.8; 20 mm along the beam are 16 mm from the cone."""
    layout = SimpleNamespace(positions=["P1"], cones=["C1", "C2"])
    scan = SimpleNamespace(cone=np.zeros(4, int), variance_m2=np.full(4, 0.02**2))
    row = SimpleNamespace(residual=np.array([5.0, -15.0, 5.0, -15.0]) * 1e-3, slope=np.full(4, -0.8))
    table = residual_table(layout, [scan], [row])
    assert table.to_dict("records") == [
        {
            "position": "P1",
            "cone": "C1",
            "points": 4,
            "mean_mm": pytest.approx(4.0),
            "sigma_mean_mm": pytest.approx(8.0),
            "rms_mm": pytest.approx(np.sqrt(80.0)),
            "greatest_mm": pytest.approx(12.0),
            "standardised": pytest.approx(np.sqrt(80.0) / 16),
        }
    ]
