"""What an error model makes of stated covariances."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tests.core.conftest import trajectory_of
from thalweg.core import (
    ErrorChain,
    cross_matrix,
    even_time,
    roll_pitch_heading,
    rotation_enu_body,
    write_chains,
)
from thalweg.navigation.ins_gnss import (
    BEAM,
    NAMES,
    ErrorModel,
    Estimate,
    PoseCorrelation,
    PriorErrors,
    beam_factors,
)
from thalweg.navigation.ins_gnss.trajectory import pose_covariance

LEVER = np.array([0.4, -0.2, -1.1])
SIGMA_POSITION = np.array([0.02, 0.03, 0.05])
SIGMA_ATTITUDE = np.deg2rad([0.1, 0.15, 0.4])
HEADINGS = np.linspace(0, 350, 40)
PRIOR = PriorErrors(
    sigma_position_m=SIGMA_POSITION,
    sigma_attitude_rad=SIGMA_ATTITUDE,
    white_share=0.25,
    position_time_s=10.0,
    attitude_time_s=20.0,
    spread=2.0,
    time_spread=3.0,
)


def model(sigma_log=0.0, **values):
    told = {"sigma_log": sigma_log, "prior": 1.0, "prior_sigma_log": np.log(2)}
    estimates = {name: Estimate(value=values.get(name, 1.0), **told) for name in NAMES + BEAM}
    return ErrorModel(estimates=estimates, white_share_stated=0.25)


def poses(heading_deg=HEADINGS, sigma_position=SIGMA_POSITION, sigma_attitude=SIGMA_ATTITUDE, tilt_deg=3.0):
    """A boat that rolls and pitches by so much, at scattered places."""
    n, rng = len(heading_deg), np.random.default_rng(3)
    R = rotation_enu_body(*np.deg2rad([rng.normal(0, tilt_deg, n), rng.normal(0, tilt_deg, n), heading_deg]))
    antenna, attitude = np.diag(sigma_position**2), np.tile(sigma_attitude, (n, 1))
    cov = pose_covariance(R, np.tile(antenna, (n, 1, 1)), attitude, lever_ics_m=LEVER)
    return trajectory_of(np.arange(n) * 0.1, rng.normal(0, 10, (n, 3)), Rotation.from_matrix(R), cov)


def test_covariances_are_those_of_the_scaled_sigmas():
    """Slow part doubled, white noise halved: variance 0.75 * 4 + 0.25 / 4; tilt and heading by themselves."""
    found = model(position=2.0, white=0.5, roll_pitch=3.0, heading=0.5).apply(poses(), LEVER)
    factor = np.sqrt(0.75 * 4 + 0.25 / 4)
    expected = poses(HEADINGS, factor * SIGMA_POSITION, SIGMA_ATTITUDE * [3.0, 3.0, 0.5])
    assert_allclose(found.cov_pose_wcs, expected.cov_pose_wcs, rtol=1e-9, atol=1e-15)
    assert_array_equal(found.position_wcs_m, expected.position_wcs_m)


def test_what_is_not_known_enlarges_sigmas():
    """E[f^2] of a lognormal factor with median 1 and sigma ln 2 is exp(2 ln(2)^2) = 2.614."""
    assert Estimate(value=1.0, sigma_log=np.log(2), prior=1.0, prior_sigma_log=np.log(2)).predictive ** 2 == (
        pytest.approx(2.614, abs=0.001)
    )
    stated = poses()
    found = model(sigma_log=np.log(2)).apply(stated, LEVER)
    ratio = found.sigma_position_m / stated.sigma_position_m
    assert_allclose(ratio, np.sqrt(2.614), rtol=1e-3)


def deviating(size):
    """A = 2, B = -1 times ``size``, each with a sigma of 1, in units of 0.1 degrees."""
    unit = np.deg2rad(0.1)
    return ErrorModel(
        estimates=model().estimates,
        white_share_stated=0.25,
        deviation_rad=(2 * size * unit, -1 * size * unit),
        cov_deviation_rad2=(np.eye(2) * unit**2).tolist(),
    )


def test_a_significant_deviation_of_the_heading_is_taken_off_about_the_antenna():
    stated = poses()
    found = deviating(3.0).apply(stated, LEVER)
    h = np.deg2rad(HEADINGS)
    before = Rotation.from_quat(stated.quaternion_wcs_ics)
    after = Rotation.from_quat(found.quaternion_wcs_ics)
    turned = roll_pitch_heading(before.as_matrix())[2] - roll_pitch_heading(after.as_matrix())[2]
    expected = np.deg2rad(0.1) * (6 * np.sin(h) - 3 * np.cos(h))
    # forward of a boat that pitches by 3 degrees is not quite level
    assert_allclose((turned + np.pi) % (2 * np.pi) - np.pi, expected, atol=1e-6)
    assert_allclose(
        found.position_wcs_m + after.apply(LEVER), stated.position_wcs_m + before.apply(LEVER), atol=1e-12
    )
    assert np.all(np.linalg.eigvalsh(found.cov_pose_wcs) > 0)


@pytest.mark.parametrize(("size", "corrected"), [(1.65, False), (1.67, True)])
def test_a_deviation_is_corrected_from_the_printed_limit_on(size, corrected):
    """Chi-square, two degrees, 0.1 %: 13.82 (Abramowitz and Stegun 26.8); 5 size^2 crosses it at 1.662."""
    assert chi2.ppf(0.999, 2) == pytest.approx(13.82, abs=0.005)
    assert deviating(size).deviation_is_significant is corrected


def test_the_report_tells_survey_from_prior(tmp_path):
    found = model(sigma_log=0.1, position=1.3, component=1.2)
    found.write(tmp_path / "error_model.json")
    report = json.loads((tmp_path / "error_model.json").read_text())
    assert report["estimates"]["position"]["from"] == "survey"
    assert report["estimates"]["position"]["predictive"] == pytest.approx(1.3 * np.exp(0.01))
    assert beam_factors(tmp_path / "error_model.json")["component"] == pytest.approx(1.2 * np.exp(0.01))
    unknown = ErrorModel.of_prior(PRIOR, note="nothing was seen twice").report()
    assert {e["from"] for e in unknown["estimates"].values()} == {"prior"}
    assert unknown["notes"] == ["nothing was seen twice"]
    assert unknown["correlation_s"] == pytest.approx(20.0)
    assert unknown["white_share"] == pytest.approx(0.25)


def test_the_report_states_the_deviation_in_degrees():
    """A = 0.2, B = -0.1 degrees, each with a sigma of 0.1."""
    report = deviating(1.0).report()
    assert report["heading_deviation_deg"] == pytest.approx([0.2, -0.1])
    assert_allclose(report["cov_heading_deviation_deg2"], np.diag([0.01, 0.01]), atol=1e-15)


@pytest.mark.parametrize(
    ("found", "width"),
    [(ErrorModel.of_prior(PRIOR, note="x"), 1.0), (ErrorModel.presumed(PRIOR), 0.0)],
    ids=["of prior", "presumed"],
)
def test_models_that_are_not_estimated_by_hand(found, width):
    """The width of the prior, or none; sigmas of a single measurement may be wrong by a factor of 1.5."""
    sigma = width * np.log([2.0, 2.0, 2.0, 2.0, 3.0, 3.0, 1.5, 1.5])
    values = np.array([1.0, 1.0, 1.0, 1.0, 10.0, 20.0, 1.0, 1.0])
    assert list(found.estimates) == [*NAMES, *BEAM]
    rows = [(e.value, e.prior, e.sigma_log, e.prior_sigma_log) for e in found.estimates.values()]
    assert_allclose(np.transpose(rows), [values, values, sigma, sigma])
    assert not any(e.informed for e in found.estimates.values())
    assert (found.white_share_stated, len(found.notes)) == (0.25, 1)
    assert (found.windows, found.planes, found.observations) == (0, 0, 0)
    assert (found.deviation_rad, found.cov_deviation_rad2) == ((0.0, 0.0), None)
    assert not found.deviation_is_significant
    report = found.report()
    assert report["heading_deviation_deg"] == [0.0, 0.0]
    assert report["cov_heading_deviation_deg2"] is None


def test_shares_and_factors_of_unequal_estimates_by_hand():
    """Slow errors tripled, white ones doubled, of 25 %: 0.75 * 9 + 0.25 * 4 = 7.75, of which 1 is white."""
    found = model(
        position=3.0, white=2.0, position_time_s=7.0, attitude_time_s=4.0, component=1.2, footprint=0.7
    )
    assert found.position_factor == pytest.approx(np.sqrt(7.75))
    assert found.white_share == pytest.approx(1 / 7.75)
    assert found.correlation_s == 7.0
    assert found.beam == {"component": pytest.approx(1.2), "footprint": pytest.approx(0.7)}
    report = found.report()
    assert (report["position_factor"], report["white_share"]) == (found.position_factor, found.white_share)
    # what is uncertain is larger in what is predicted, not in what is told
    loose = model(sigma_log=0.5, position=3.0, white=2.0)
    assert loose.position_factor == pytest.approx(np.sqrt(7.75) * np.exp(0.25))
    assert loose.white_share == pytest.approx(1 / 7.75)


def test_a_corrected_heading_adds_the_variance_of_its_correction():
    """Level poses at 0 and 90 degrees: sine and cosine have sigmas of 0.1 and 0.2 degrees."""
    unit = np.deg2rad(0.1)
    R = rotation_enu_body(np.zeros(2), np.zeros(2), np.deg2rad([0.0, 90.0]))
    stated = poses(np.array([0.0, 90.0]), tilt_deg=0.0)
    found = replace(deviating(5.0), cov_deviation_rad2=(np.diag([1.0, 4.0]) * unit**2).tolist()).apply(
        stated, LEVER
    )
    more = found.cov_pose_wcs[:, 3:, 3:] - stated.cov_pose_wcs[:, 3:, 3:]
    assert_allclose(more[0], np.diag([0.0, 0.0, 4.0]) * unit**2, atol=1e-12)
    assert_allclose(more[1], np.diag([0.0, 0.0, 1.0]) * unit**2, atol=1e-12)
    # the antenna is as uncertain as it was stated
    to_antenna = np.concatenate([np.tile(np.eye(3), (2, 1, 1)), -cross_matrix(R @ LEVER)], axis=2)
    antenna = to_antenna @ found.cov_pose_wcs @ np.swapaxes(to_antenna, 1, 2)
    assert_allclose(antenna, np.tile(np.diag(SIGMA_POSITION**2), (2, 1, 1)), atol=1e-12)


def test_the_prior_of_a_survey_has_its_sigmas_and_what_is_stated():
    trajectory = poses()
    stated = {
        "white_share": 0.3,
        "position_time_s": 11.0,
        "attitude_time_s": 22.0,
        "spread": 1.5,
        "time_spread": 4.0,
    }
    found = PriorErrors.of_survey(trajectory, LEVER, {**stated, "other": 1})
    assert {name: getattr(found, name) for name in stated} == stated
    assert_allclose(found.sigma_position_m, SIGMA_POSITION, rtol=1e-6)
    assert_allclose(found.sigma_attitude_rad, SIGMA_ATTITUDE, rtol=1e-6)
    slow, white = found.sigmas()
    assert_allclose(slow, [*np.sqrt(0.7) * SIGMA_POSITION, *SIGMA_ATTITUDE], rtol=1e-6)
    assert_allclose(white, np.sqrt(0.3) * SIGMA_POSITION, rtol=1e-6)
    mean, spread = found.mean_and_spread()
    assert_allclose(np.exp(mean), [1, 1, 1, 1, 11, 22])
    assert_allclose(np.exp(spread), [1.5, 1.5, 1.5, 1.5, 4, 4])


def test_how_long_errors_last_comes_from_the_survey_unless_it_is_stated(tmp_path):
    path = tmp_path / "error_model.json"
    model(position_time_s=7.0, attitude_time_s=31.0).write(path)
    found = PoseCorrelation.of_survey(path, receiver_s=0.2)
    assert (found.position_s, found.attitude_s, found.receiver_s, found.even) == (7.0, 31.0, 0.2, None)
    assert found.white_share == json.loads(path.read_text())["white_share"] == pytest.approx(0.25)
    assert_array_equal(found.even_time_s(np.array([3.0, 4.0])), [3.0, 4.0])
    stated = PoseCorrelation.of_survey(path, receiver_s=0.2, position_time_s=5.0, attitude_time_s=6.0)
    assert (stated.position_s, stated.attitude_s) == (5.0, 6.0)
    # chains leave no white part, and decay faster at first than later
    t = np.arange(0.0, 60.5, 0.5)
    keep = np.exp(-0.5 / np.where(t <= 30.0, 2.0, 8.0))
    root = np.tile(np.diag([0.02] * 6), (len(t), 1, 1))
    chain = ErrorChain(name="all", t_gps_s=t, root=root, link=keep[:, None, None] * np.eye(6))
    write_chains(tmp_path / "chains.npz", [chain])
    of_chains = PoseCorrelation.of_survey(tmp_path / "chains.npz", receiver_s=0.2)
    at, even, time_s = even_time([chain])
    assert of_chains.position_s == pytest.approx(time_s, rel=1e-5)
    assert (np.isnan(of_chains.attitude_s), of_chains.white_share, of_chains.receiver_s) == (True, 0.0, 0.2)
    assert_allclose(of_chains.even_time_s(at), even, atol=1e-3)
    assert_allclose(of_chains.even_time_s(np.array([-9.0, 99.0])), [even[0], even[-1]], atol=1e-3)
    stated = PoseCorrelation.of_survey(tmp_path / "chains.npz", receiver_s=0.2, position_time_s=5.0)
    assert (stated.position_s, stated.even) == (5.0, None)


def test_presumed_values_change_nothing():
    stated = poses(HEADINGS, SIGMA_POSITION, SIGMA_ATTITUDE)
    found = ErrorModel.presumed(PRIOR).apply(stated, LEVER)
    assert_allclose(found.cov_pose_wcs, stated.cov_pose_wcs, rtol=1e-9, atol=1e-15)
