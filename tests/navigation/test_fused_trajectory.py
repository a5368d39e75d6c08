"""The fused trajectory against the truth of simulated surveys, and what it does with bad input."""

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from thalweg.core import CoverageError, InputError, LocalFrame, Rigid, Trajectory, exp_rotation
from thalweg.navigation.fusion import FusionSettings, count_table, fuse_trajectory
from thalweg.navigation.fusion.model import GROUPS
from thalweg.navigation.fusion.trajectory import group_facts
from thalweg.settings.sections import Fused as FusedSection
from thalweg_lab.studies.outage import FRAME, LEVER_ANTENNA_M, VoyageSpec, errors_at, fuse, make_survey

SETTINGS = FusionSettings()
MOTORS = {"ins": {"motor_field_mg": ((5.0, 12.0, 2.0), (-5.0, 12.0, 2.0)), "hard_iron_mg": (6.0, 4.0, 0.0)}}

TREES = {
    "twin": {
        "gnss": {"multipath_m": 0.05},
        "effects": {"gnss_floats": ((4.0, 5.0), (18.0, 3.0)), "gnss_outages": ((9.0, 8.0),)},
    },
    "shade_s": ((3.0, 20.0),),
}
"""Twenty seconds under trees: dimmed satellites, float solutions, and none for eight seconds."""


@cache
def survey(seed=1, duration_s=40.0):
    return make_survey(seed, VoyageSpec(duration_s=duration_s))


@cache
def whole(seed=1):
    return fuse(survey(seed), SETTINGS)


def fused(recorded=None, *, settings=SETTINGS, **changed):
    """The trajectory of a survey whose positions, images or states are changed."""
    streams = {key: changed.pop(key) for key in ("positions", "images", "states") if key in changed}
    return fuse(replace(recorded or survey(), **streams), settings, **changed)


def dropped(found, kind):
    return found.facts["observations"][kind]["dropped"]


def fixed(**more):
    """Sizes of errors as they are stated."""
    return SETTINGS.replace(estimate_errors=False, **more)


def only(inputs):
    return {"with_positions": inputs != "images", "with_images": inputs != "positions"}


def moments(recorded):
    """Times in the survey, off the nodes too."""
    return recorded.motion.start_gps_s + np.arange(1.0, recorded.motion.config.duration_s - 2.0, 0.37)


def rms(found, recorded, at=None):
    """RMS of the position's error in m, and of the attitude's in rad."""
    e, _ = errors_at(found, recorded.motion, moments(recorded) if at is None else at)
    return float(np.sqrt(np.mean(np.sum(e[:, :3] ** 2, axis=1)))), float(np.sqrt(np.mean(e[:, 3:] ** 2)))


# ---------------------------------------------------------------- consistency


@pytest.mark.parametrize("inputs", ["all", "positions", "images"])
def test_normalised_errors_lie_in_their_band_over_ten_seeds(inputs):
    """One moment a seed: errors are independent. 10 x 6 squares have a band of 0.59 to 1.53 (99 %)."""
    settings = FusionSettings(heading_disturbance_deg=0.0, estimate_errors=inputs == "all")
    squares = []
    for seed in range(1, 11):
        recorded = make_survey(seed, VoyageSpec(duration_s=12.0))
        found = fuse(recorded, settings, **only(inputs))
        # between two nodes, 5 s behind the begin
        e, C = errors_at(found, recorded.motion, np.array([recorded.motion.start_gps_s + 5.13]))
        squares.append(e[0] @ np.linalg.solve(C[0], e[0]))
    low, high = chi2.ppf([0.005, 0.995], 60) / 60
    assert low < np.mean(squares) / 6 < high


def test_the_clock_offset_and_the_mount_are_found_within_their_sigmas():
    clock, turn = [], []
    for seed in range(1, 7):
        recorded = make_survey(seed, VoyageSpec(duration_s=20.0, sigma_clock_s=0.15))
        facts = fuse(recorded, SETTINGS.replace(sigma_clock_offset_s=0.2)).facts
        clock.append((facts["clock_offset_s"] - recorded.clock_s) / facts["clock_offset_sigma_s"])
        turn.append(facts["boresight"]["sigma_rotation_deg"])
        # 20 images of 16 ms jitter leave 3.6 ms; what turns and walks little adds to it
        assert facts["clock_offset_sigma_s"] < 0.007
    low, high = chi2.ppf([0.005, 0.995], 6) / 6
    assert low < np.mean(np.square(clock)) < high
    # 0.02 as stated; what is not known of the sizes of the errors adds to it
    assert np.all(np.array(turn) <= 0.0205)


def test_a_wrong_mount_is_found_with_its_sign():
    """The mount on file is turned by 0.6 deg about its x and z axis: the correction turns it back."""
    recorded = survey()
    wrong = np.array([0.0, 0.0, 0.0, *np.deg2rad([0.6, 0.0, -0.6])])
    cov = np.diag(np.repeat([0.001, np.deg2rad(0.5)], 3) ** 2)
    found = fuse(replace(recorded, T_ccs_ics=recorded.T_ccs_ics.moved(wrong).with_cov(cov)), SETTINGS)
    boresight = found.facts["boresight"]
    # 4 sigmas, and the survey's own mount error of 0.02 deg
    limit = 4 * np.array(boresight["sigma_rotation_deg"]) + 0.08
    assert np.all(np.abs(np.array(boresight["rotation_deg"]) - [-0.6, 0.0, 0.6]) < limit)
    assert limit[[0, 2]].max() < 0.5


@pytest.mark.parametrize("estimated", [True, False])
def test_chains_of_errors_are_the_covariance_of_the_poses(estimated):
    """Also between two of them: the difference of two neighbours is far better known than each."""
    recorded = make_survey(3, VoyageSpec(duration_s=8.0))
    found = fuse(recorded, SETTINGS.replace(estimate_errors=estimated))
    chains = found.error_chains()
    assert chains[0].name == "smoothed trajectory"
    t = chains[0].t_gps_s[1:-1]
    total = sum(chain.covariance_at(t) for chain in chains)
    expected = found.trajectory.cov_at(t)
    sigma = np.sqrt(np.diagonal(expected, axis1=1, axis2=2))
    scale = sigma[:, :, None] * sigma[:, None, :]
    assert_allclose(total / scale, expected / scale, rtol=0, atol=0.03)


# ---------------------------------------------------------------- better than each chain alone


@pytest.mark.parametrize(
    ("n", "spec"),
    [
        (3, {}),
        (3, TREES),
        (3, {"twin": MOTORS}),
        # images that tell less: the clean case goes the same way through the code
        pytest.param(4, {"image_interval_s": 5.0}, marks=pytest.mark.slow),
        pytest.param(
            4, {"sigma_image_m": (0.05,) * 3, "sigma_image_deg": (0.3,) * 3}, marks=pytest.mark.slow
        ),
    ],
    ids=["clean", "under trees", "heading disturbed", "few images", "weak images"],
)
def test_it_is_never_worse_than_the_better_chain(n, spec):
    """RMS over n surveys that nobody chose, of errors that last for a third of a survey; by 5 % at most.

    Under trees by 12 %: 6 and 10 % of position, 1 and 4 % of attitude over seeds 61 to 63 and 64 to 66.
    """
    totals = {"positions": [], "images": [], "all": []}
    for seed in range(61, 61 + n):
        recorded = make_survey(seed, VoyageSpec(duration_s=30.0, **spec))
        for name in totals:
            totals[name].append(rms(fuse(recorded, SETTINGS, **only(name)), recorded))
    ins, camera, both = (np.sqrt(np.mean(np.square(totals[n]), axis=0)) for n in totals)
    most = 1.12 if spec is TREES else 1.05
    assert np.all(both <= most * np.minimum(ins, camera)), (ins, camera, both)
    if spec is TREES:
        # multipath and float solutions that no fixed one bounds: the images must win
        assert both[0] < 0.5 * ins[0]
    if spec.get("twin") is MOTORS:
        # motors turn the INS by degrees: what the images say must win
        assert both[1] < 0.1 * ins[1]


def test_poses_of_images_are_moved_to_what_all_sensors_say():
    """A block that is turned as a whole, as one on antenna positions alone is; with sigmas that hold."""
    spec = VoyageSpec(
        duration_s=25.0,
        sigma_image_m=(0.03,) * 3,
        sigma_image_deg=(0.12,) * 3,
        image_time_s=1000.0,
        jitter_s=1e-4,
        sigma_mount_deg=0.1,
    )
    before, after, squares = [], [], []
    for seed in range(20, 24):
        recorded = make_survey(seed, spec)
        found = fuse(recorded, SETTINGS)
        moved = found.image_poses(recorded.images, found.whole())
        k = 12
        at = recorded.images.t_gps_s[[k]] + recorded.clock_s
        body = Rigid(R=recorded.motion.R_wcs_ics(at)[0], shift_m=recorded.motion.position_wcs_m(at)[0])
        true = body @ recorded.true_T_ics_ccs
        before.append(recorded.images.pose(k).error_from(true))
        after.append(moved.pose(k).error_from(true))
        squares.append(after[-1] @ np.linalg.solve(moved.cov_pose_wcs[k], after[-1]))
    n = 6 * len(squares)
    low, high = chi2.ppf([0.001, 0.999], n) / n
    assert low < np.sum(squares) / n < high
    turn, turn_before = (np.sqrt(np.mean(np.square(e)[:, 3:])) for e in (after, before))
    assert turn < 0.7 * turn_before
    alone = fuse(recorded, SETTINGS, with_images=False)
    assert alone.image_poses(recorded.images, alone.whole()) is recorded.images


def test_an_outage_is_bridged_by_the_images_and_the_sigma_says_so():
    recorded = survey()
    t = recorded.positions["t_gps_s"].to_numpy() - recorded.motion.start_gps_s
    keep = (t < 10) | (t > 30)
    inside = recorded.motion.start_gps_s + np.arange(11, 29, 0.1)
    both = fuse(recorded, SETTINGS, keep_positions=keep)
    alone = fuse(recorded, SETTINGS, keep_positions=keep, with_images=False)
    assert both.trajectory.valid.mean() > 0.98
    assert rms(both, recorded, inside)[0] < 0.5 * rms(alone, recorded, inside)[0]
    # valid no longer where the sigma has grown beyond the limit of the settings
    middle = np.searchsorted(alone.trajectory.t_gps_s, recorded.motion.start_gps_s + 20)
    assert not alone.trajectory.valid[middle]
    assert alone.trajectory.sigma_position_m[middle].max() > SETTINGS.max_sigma_position_m


def test_what_is_taken_for_known_of_the_start_is_next_to_nothing(monkeypatch):
    """Twelve seconds without an observation at the begin: a start of kilometres must not cost digits."""
    recorded = survey()
    late = replace(recorded.images, oriented=np.arange(len(recorded.images.images)) > 10)
    at = recorded.motion.start_gps_s + np.array([-1.9, 5.0, 20.0])
    poses = []
    for sigma_m in (300.0, 3000.0):
        monkeypatch.setattr("thalweg.navigation.fusion.model.START_SIGMA_M", sigma_m)
        poses.append(fused(images=late, settings=fixed(), with_positions=False).poses(at))
    # a sigma of 0.4 m at the begin: a start of 300 m holds it by 0.4^2 / 300^2 = 2e-6
    assert_allclose(poses[0][0], poses[1][0], atol=2e-5)
    assert_allclose(poses[0][2], poses[1][2], rtol=2e-5, atol=1e-9)


# ---------------------------------------------------------------- wrong observations


@pytest.mark.parametrize(("jump_m", "with_images"), [(0.3, True), (5.0, False)])
def test_jumps_by_multipath_do_no_harm(jump_m, with_images):
    recorded = survey(2)
    positions = recorded.positions.copy()
    since = positions["t_gps_s"] - recorded.motion.start_gps_s
    jumped = (since > 18) & (since < 23)
    positions.loc[jumped, "lat_deg"] += jump_m / 111e3
    found = fused(recorded, positions=positions, with_images=with_images)
    without = fuse(recorded, SETTINGS, keep_positions=~jumped.to_numpy(), with_images=with_images)
    used = found.observations.query("kind == 'position'")["used"].to_numpy()
    assert not used[jumped].any()
    assert used[~jumped].all()
    # as if they had never been there: 1 mm of variance components that settle elsewhere
    at = moments(recorded)
    assert_allclose(found.poses(at)[0], without.poses(at)[0], atol=1e-3)
    assert found.facts["observations"]["position"]["rejected"] == int(jumped.sum())


def test_single_wrong_positions_and_images_are_rejected_and_counted():
    recorded = survey(2)
    positions = recorded.positions.copy()
    positions.loc[positions.index[50::70], "h_ell_m"] += 0.5
    images = recorded.images
    centre, R = images.centre_wcs_m.copy(), images.R_wcs_ccs.copy()
    centre[[8, 20, 21]] += [0.3, 0.0, 0.0]
    R[30] = exp_rotation([0.0, 0.0, 0.05]) @ R[30]
    bad = replace(images, centre_wcs_m=centre, R_wcs_ccs=R)
    found = fused(recorded, positions=positions, images=bad)
    left_out = found.observations[~found.observations["used"]]
    assert set(left_out["name"]) - {""} == {f"{k:05d}.jpg" for k in (8, 20, 21, 30)}
    assert (left_out["kind"] == "position").sum() == len(positions.index[50::70])
    # 5 %: what four images and seven positions less are worth
    assert rms(found, recorded)[0] < 1.05 * rms(whole(2), recorded)[0] + 1e-3
    for kind in ("position", "image"):
        counts = found.facts["observations"][kind]
        assert counts["given"] == counts["used"] + counts["rejected"] + sum(counts["dropped"].values())


def test_sigmas_stated_too_small_are_found():
    positions = survey().positions.copy()
    positions[["sigma_east_m", "sigma_north_m", "sigma_up_m"]] /= 3
    facts = fused(positions=positions).facts
    assert facts["groups"]["gnss_white"]["sigma_factor"] == pytest.approx(3.0, rel=0.15)
    # the slow part holds fewer independent values, and what is stated weighs as ten
    assert 1.6 < facts["groups"]["gnss"]["sigma_factor"] < 3.5
    assert facts["observations"]["position"]["rejected"] == 0
    assert not fused(positions=positions, settings=fixed()).facts["groups"]["gnss_white"]["inside"]


# ---------------------------------------------------------------- missing and bad input


def test_without_positions_and_images_it_says_what_is_missing():
    with pytest.raises(InputError, match=r"no antenna positions; no image poses.*positions or oriented"):
        fuse(survey(), SETTINGS, with_positions=False, with_images=False)


def test_inputs_that_cannot_enter_are_counted_in_the_refusal():
    images = survey().images
    untimed = images.with_times(np.full(len(images.images), np.nan), images.sigma_t_s)
    with pytest.raises(InputError, match=r"441 antenna positions \(441 kind of solution\); 39 .*39 no time"):
        fused(positions=survey().positions.assign(fix="single"), images=untimed)


def test_streams_of_different_days_are_refused():
    positions = survey().positions
    with pytest.raises(InputError, match="outside the INS"):
        fused(positions=positions.assign(t_gps_s=positions["t_gps_s"] + 86400.0), with_images=False)


def fused_without_a_mount(recorded, **more):
    how = {"sigma_attitude_rad": np.deg2rad([0.1, 0.1, 0.2]), "max_attitude_gap_s": 0.1}
    return fuse_trajectory(recorded.states, FRAME, SETTINGS, images=recorded.images, **how, **more)


def test_images_of_another_frame_or_without_a_mount_are_refused():
    away = replace(survey().images, frame=LocalFrame(lat_deg=51.06, lon_deg=13.25, h_ell_m=300.0))
    with pytest.raises(InputError, match="world frame"):
        fused(images=away)
    with pytest.raises(InputError, match="mount of the camera"):
        fused_without_a_mount(survey())


def test_positions_that_the_image_block_holds_are_not_counted_twice():
    recorded = survey()
    t = recorded.positions["t_gps_s"].to_numpy()
    first, last = recorded.images.t_gps_s.min(), recorded.images.t_gps_s.max()
    antenna = {"positions": recorded.positions, "lever_ics_antenna_m": LEVER_ANTENNA_M}
    camera = {"T_ccs_ics": recorded.T_ccs_ics, "images_hold_positions": True}
    again = fused_without_a_mount(recorded, **antenna, **camera)
    within = int(((t >= first) & (t <= last)).sum())
    found = again.facts["observations"]["position"]
    assert found["dropped"]["part of the image poses"] == within > 300
    assert found["used"] + found["rejected"] == len(t) - within
    middle = recorded.motion.start_gps_s + np.array([20.0])
    # with them once more the place would seem to be known better
    assert (np.diag(again.poses(middle)[2][0])[:3] > np.diag(whole().poses(middle)[2][0])[:3]).all()


def test_a_trajectory_that_is_good_enough_nowhere_is_refused():
    with pytest.raises(CoverageError, match=r"at least 0\.\d+ m and .*Add what is missing: image poses"):
        fuse(survey(), SETTINGS.replace(max_sigma_position_m=0.001), with_images=False)


def test_holes_of_the_ins_are_not_bridged_and_their_observations_counted():
    recorded = survey()
    t = recorded.states["t_gps_s"] - recorded.motion.start_gps_s
    found = fused(states=recorded.states[(t < 15) | (t > 17)])
    assert dropped(found, "position") == {"outside the INS or in a hole of it": 21}
    assert dropped(found, "image") == {"outside the INS or in a hole of it": 2}
    _, _, inside = found.trajectory.at(recorded.motion.start_gps_s + np.array([14.9, 15.5, 16.5, 17.1]))
    assert inside.tolist() == [True, False, False, True]
    # beside the hole it is as good as elsewhere
    assert rms(found, recorded, recorded.motion.start_gps_s + np.array([14.5, 17.5]))[0] < 0.05


def test_images_out_of_order_alone_or_without_a_pose_are_no_trouble():
    images = survey().images
    back = np.arange(len(images.images))[::-1]
    names = ("t_gps_s", "centre_wcs_m", "R_wcs_ccs", "cov_pose_wcs", "cov_next")
    turned = replace(
        images,
        images=images.images[::-1],
        sigma_t_s=np.full(len(back), np.nan),
        oriented=back % 3 != 0,
        **{name: getattr(images, name)[back] for name in names},
    )
    found = fused(images=turned)
    assert dropped(found, "image") == {"not oriented": 13}
    assert rms(found, survey())[0] < 0.03
    alone = replace(images, oriented=np.arange(len(back)) == 20)
    assert rms(fused(images=alone), survey())[0] < 0.05


# ---------------------------------------------------------------- form


def test_the_same_input_gives_the_same_bytes(tmp_path):
    again = fuse(make_survey(1, VoyageSpec(duration_s=40.0)), SETTINGS)
    whole().trajectory.write(tmp_path / "a.parquet")
    again.trajectory.write(tmp_path / "b.parquet")
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    back = Trajectory.read(tmp_path / "a.parquet")
    assert_array_equal(back.valid, whole().trajectory.valid)


def test_facts_can_be_written_and_counts_are_a_table():
    facts = json.loads(json.dumps(whole().facts))
    assert facts["settled"]
    table = count_table(facts)
    assert table.query("kind == 'image' and what == 'used'")["n"].item() == 39
    assert set(facts["groups"]) >= {"gnss", "velocity", "camera", "clock"}


def test_poses_between_agree_with_the_trajectory_at_its_nodes():
    found = whole()
    t = found.trajectory.t_gps_s
    position, _, cov = found.poses(t[500:520])
    assert_array_equal(position, found.trajectory.position_wcs_m[500:520])
    assert_allclose(cov, found.trajectory.cov_pose_wcs[500:520], rtol=0, atol=0)
    assert np.all(np.linalg.eigvalsh(cov) > 0)


def test_the_section_and_the_settings_have_the_same_names_and_defaults():
    assert FusionSettings.of(FusedSection()) == FusionSettings()


def test_the_band_of_a_group_is_that_of_the_table():
    """Ten degrees of freedom: 2.156 and 25.188 hold 99 % (Abramowitz and Stegun 1964, table 26.8)."""
    squares = dict.fromkeys(GROUPS, (25.0, 10.0)) | {GROUPS[0]: (25.4, 10.0), GROUPS[1]: (2.1, 10.0)}
    found = group_facts(SimpleNamespace(groups=squares, factors=dict.fromkeys(GROUPS, 1.5)))
    assert [found[name]["inside"] for name in GROUPS] == [False, False, *[True] * (len(GROUPS) - 2)]
    assert found[GROUPS[0]] == {
        "chi_square": pytest.approx(2.54),
        "redundancy": 10.0,
        "band_low": pytest.approx(0.2156, abs=1e-4),
        "band_high": pytest.approx(2.5188, abs=1e-4),
        "inside": False,
        "sigma_factor": 1.5,
    }


def test_a_smoother_knows_the_begin_as_well_as_the_end():
    sigma = whole().trajectory.sigma_position_m.max(axis=1)
    assert sigma[100] < 1.5 * sigma[-100]


def test_correlated_images_are_not_averaged_away():
    """Images that all err alike give the sigma of one of them; independent ones of less than half."""
    # a good INS joins the images, so that the sigma shows how they are averaged
    recorded = make_survey(1, VoyageSpec(duration_s=40.0, twin={"ins": {"sigma_velocity_mps": 0.002}}))
    C = recorded.images.cov_pose_wcs
    alike, independent = (
        fuse(
            replace(recorded, images=replace(recorded.images, cov_next=share * C)),
            SETTINGS.replace(estimate_errors=False, sigma_velocity_mps=0.002),
            with_positions=False,
        ).trajectory
        for share in (0.998, 0.0)
    )
    middle = len(alike.t_gps_s) // 2
    # the height: along the way the clock adds its own
    assert alike.sigma_position_m[middle, 2] > 0.0095
    assert independent.sigma_position_m[middle, 2] < 0.005
