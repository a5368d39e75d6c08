"""Ground of the banks, the cloud of the surroundings laid on it, and all clouds as one."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.bands import band
from tests.conftest import check_whole
from tests.fusion.conftest import FRAME, GRID
from thalweg.core import CoverageError, GeometryError, InputError, LazWriter, Trajectory, iter_laz
from thalweg.fusion import (
    Cloud,
    Source,
    filter_ground,
    fit_cloud,
    join_clouds,
    joined_parts,
    read_cloud,
    read_ground,
)
from thalweg.fusion.ground import scores
from thalweg.settings.sections import CloudFit, GroundFilter


def slope_up(x, y):
    """A bank that rises 1:2 to the north, with waves: every motion shows."""
    return 0.5 * y + 0.9 * np.sin(x / 3) + 0.7 * np.cos(y / 2 + x / 5)


def bank(rng, n, *, noise=0.01, width=60.0):
    xy = rng.uniform(0, width, (n, 2)) * (1.0, 0.4)
    return np.column_stack([xy, slope_up(*xy.T) + rng.normal(0, noise, n)])


def cloud(xyz, sigma=0.02):
    return Cloud(xyz_m=xyz, sigma_horizontal_m=np.full(len(xyz), sigma), sigma_up_m=np.full(len(xyz), sigma))


@pytest.fixture
def with_plants(rng):
    """Ground, and bushes whose beams in part go on to the ground."""
    ground = bank(rng, 20_000)
    in_bush = (np.hypot(ground[:, 0] - 20, ground[:, 1] - 12) < 2) | (
        np.hypot(ground[:, 0] - 40, ground[:, 1] - 8) < 2
    )
    through = in_bush & (rng.random(len(ground)) < 0.4)
    bush = ground[in_bush] + np.column_stack(
        [np.zeros((in_bush.sum(), 2)), rng.uniform(0.05, 2.0, in_bush.sum())]
    )
    keep = ~in_bush | through
    number = np.where(through, 2, 1)[keep]
    of = np.where(through, 2, 1)[keep]
    first_of = np.where(through[in_bush], 2, 1)
    xyz = np.concatenate([ground[keep], bush])
    return (
        xyz,
        np.concatenate([number, np.ones(len(bush), int)]),
        np.concatenate([of, first_of]),
        np.arange(len(xyz)) < keep.sum(),
    )


def test_plants_are_no_ground_and_the_gain_of_last_echoes_is_told(with_plants):
    xyz, number, of, true = with_plants
    found = filter_ground(xyz, number, of, GroundFilter())
    last = scores(found.is_ground, true)
    assert last["precision"] > 0.97
    assert last["recall"] > 0.97
    without = filter_ground(xyz, number, of, GroundFilter(last_returns=False))
    assert scores(without.is_ground, true)["precision"] < last["precision"]
    # all ground in the bushes came through them
    assert found.facts["cells_by_last_of_several_alone"] > 20
    assert found.facts["height_of_earlier_echoes_m"] > 0.02


def test_counts_and_gain_of_echoes_by_hand():
    """A plane, four points in each of 24 by 24 cells: one cell is ground by last of several echoes alone."""
    x, y = (a.ravel() for a in np.meshgrid(*[np.arange(0.0, 12.0, 0.25) + 0.1] * 2))
    ground = np.column_stack([x, y, np.zeros(len(x))])
    first, second = (x < 0.5) & (y < 0.5), (x > 6.5) & (x < 7.0) & (y > 3.5) & (y < 3.8)
    of = np.where(first | second, 2, 1)
    earlier = np.concatenate([ground[first], ground[second]]) + np.array([0.0, 0.0, 0.1])
    earlier[-1, 2] = 0.3
    high = ground[:10] + np.array([0.0, 0.0, 2.0])
    xyz = np.concatenate([ground, earlier, high])
    number = np.concatenate([of, np.ones(len(earlier) + 10)]).astype(int)
    several = np.concatenate([of, np.full(len(earlier), 2), np.ones(10)]).astype(int)
    found = filter_ground(xyz, number, several, GroundFilter(clearance_m=0.5))
    assert found.above_m == pytest.approx(xyz[:, 2], abs=1e-6)
    assert found.is_ground.tolist() == [True] * len(ground) + [False] * (len(earlier) + 10)
    n = int(first.sum() + second.sum())
    assert (int(first.sum()), n) == (4, 6)
    assert found.facts == {
        "points": len(xyz),
        "ground": 48 * 48,
        "above_the_clearance": 10,
        "several_echoes": 2 * n,
        "ground_by_last_of_several": n,
        "low_but_not_last": n,
        "last_returns": True,
        "cells_with_ground": 24 * 24,
        "cells_by_last_of_several_alone": 1,
        "gain_share": 1 / 24**2,
        "height_of_earlier_echoes_m": pytest.approx(0.1),
    }
    every = filter_ground(xyz, number, several, GroundFilter(clearance_m=0.5, last_returns=False))
    assert every.is_ground.tolist() == [True] * (len(ground) + n) + [False] * 10
    plain = filter_ground(ground, np.ones(len(x)), np.ones(len(x)), GroundFilter()).facts
    assert (plain["gain_share"], plain["height_of_earlier_echoes_m"]) == (0.0, None)
    assert len(filter_ground(ground[:100], of[:100], of[:100], GroundFilter()).is_ground) == 100
    for bad, words in ((ground[:99], "99 points, 0 of them"), (ground * np.nan, "2304 points, 2304 of them")):
        with pytest.raises(InputError, match=words):
            filter_ground(bad, of[: len(bad)], of[: len(bad)], GroundFilter())
    assert scores(np.array([1, 1, 0, 0], bool), np.array([1, 0, 1, 1], bool)) == {
        "precision": 0.5,
        "recall": 1 / 3,
    }
    nothing = np.zeros(3, bool)
    assert scores(nothing, nothing) == {"precision": 0.0, "recall": 0.0}


def test_the_ground_of_a_file_is_that_of_all_its_points(with_plants, tmp_path, monkeypatch):
    """Read in pieces of any size, and never held as a whole."""
    xyz, number, of, _ = with_plants
    path = tmp_path / "points.laz"
    with LazWriter(path, FRAME) as writer:
        writer.append(xyz, return_number=number, number_of_returns=of)
    whole = read_cloud([path], FRAME, GRID, sigma_m=0.03)
    ground = filter_ground(whole.xyz_m, number, of, GroundFilter())
    sizes = []
    for size in (1_000_000, 3_000):
        monkeypatch.setattr(
            "thalweg.fusion.clouds.iter_laz", lambda p, size=size: sizes.append(size) or iter_laz(p, size)
        )
        found, facts = read_ground(path, FRAME, GRID, GroundFilter(), sigma_m=0.03)
        np.testing.assert_array_equal(found.xyz_m, whole.xyz_m[ground.is_ground])
        np.testing.assert_array_equal(found.sigma_up_m, 0.03)
        assert facts == ground.facts | {"below_the_water": 0}
    assert sizes == [1_000_000] * 3 + [3_000] * 3


def test_mirror_images_in_the_water_do_not_hide_the_toe_of_the_bank(rng, tmp_path):
    """Images of what stands up to 12 cm above the water lie where noise does; without them it is ground."""
    xy = rng.uniform(0, [60.0, 6.0], (40_000, 2))
    true = 0.8 * xy[:, 1]  # 1:1.25 out of the water at y = 0
    up = true + rng.normal(0, 0.02, len(xy))
    image = (true < 0.12) & (rng.random(len(xy)) < 0.8)
    behind = np.column_stack([rng.uniform(0, 60, 500), rng.uniform(20, 25, 500), np.full(500, -0.5)])
    path, one = tmp_path / "points.laz", np.ones(len(xy) + image.sum() + 500, int)
    points = [np.column_stack([xy, up]), np.column_stack([xy[image], -up[image]]), behind]
    with LazWriter(path, FRAME) as writer:
        writer.append(np.concatenate(points), return_number=one, number_of_returns=one)
    shore = np.column_stack([np.arange(0.0, 61.0), np.zeros(61), np.zeros(61)])
    error, toe = {}, {}
    for name, places in (("without", None), ("with", shore)):
        found, facts = read_ground(path, FRAME, GRID, GroundFilter(), sigma_m=0.03, shore_m=places)
        near = (found.xyz_m[:, 1] > 0.05) & (found.xyz_m[:, 1] < 0.4)
        toe[name] = int(near.sum())
        error[name] = float(np.mean(found.xyz_m[near, 2] - 0.8 * found.xyz_m[near, 1]))
    assert error["without"] < -0.05
    assert abs(error["with"]) < 0.005
    assert toe["with"] > 0.95 * np.sum((xy[:, 1] > 0.05) & (xy[:, 1] < 0.4))
    assert image.sum() <= facts["below_the_water"] < image.sum() + 500
    # land behind a dyke may lie lower
    assert (found.xyz_m[:, 2] < -0.4).sum() == 500


def test_the_pose_makes_errors_that_neighbours_share(rng, tmp_path):
    """Cells of points with scatter of their own: what the pose adds is that of drawn poses."""
    sigma = np.array([0.02, 0.02, 0.015, 0.002, 0.001, 0.003])
    t = np.array([100.0, 100.1])
    place, quaternion = np.tile([5.0, -12.0, 1.0], (2, 1)), np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))
    poses = Trajectory(
        frame=FRAME, t_gps_s=t, position_wcs_m=place, quaternion_wcs_ics=quaternion,
        cov_pose_wcs=np.tile(np.diag(sigma**2), (2, 1, 1)), valid=np.ones(2, bool),
    )  # fmt: skip
    xyz, one = bank(rng, 300), np.ones(300, int)
    with LazWriter(tmp_path / "points.laz", FRAME) as writer:
        writer.append(xyz, t_gps_s=np.full(300, 100.05), return_number=one, number_of_returns=one)
    found, _ = read_ground(
        tmp_path / "points.laz", FRAME, GRID, GroundFilter(), sigma_m=0.03,
        trajectory=poses, decay=lambda t: t / 8.0,
    )  # fmt: skip
    draws = sigma * rng.standard_normal((20_000, 6))
    arm = found.xyz_m[0] - place[0]
    moved = draws[:, :3] + np.cross(draws[:, 3:], arm)
    expected = [np.mean(moved[:, :2] ** 2), np.mean(moved[:, 2] ** 2)]
    assert found.pose is not None
    assert found.pose.shape == (len(found.xyz_m), 3)
    assert found.pose[0] == pytest.approx([*expected, 100.05 / 8.0], rel=0.04)


def test_a_cloud_without_plants_has_nothing_to_gain(rng):
    xyz = bank(rng, 5000)
    one = np.ones(len(xyz), int)
    facts = filter_ground(xyz, one, one, GroundFilter()).facts
    assert facts["gain_share"] == 0.0
    assert facts["height_of_earlier_echoes_m"] is None


def test_a_filter_without_points_says_so():
    with pytest.raises(InputError, match="3 points"):
        filter_ground(np.zeros((3, 3)), np.ones(3), np.ones(3), GroundFilter())


def moved(xyz, shift, turn_rad):
    middle = xyz.mean(axis=0)
    return middle + (xyz - middle) @ Rotation.from_rotvec(turn_rad).as_matrix().T + shift


def test_a_fit_finds_the_motion_within_its_sigmas(rng):
    """Blocks of the foreign cloud err by 2 cm each: that is what the covariance must hold."""
    squares = []
    for _ in range(8):
        ours, theirs = bank(rng, 12_000), bank(rng, 12_000, noise=0.03)
        block = (theirs[:, 0] // 10 + 10 * (theirs[:, 1] // 10)).astype(int)
        theirs[:, 2] += rng.normal(0, 0.02, 200)[block]
        shift, turn = np.array([0.2, -0.1, 0.15]), np.array([0.002, -0.001, 0.003])
        fit = fit_cloud(cloud(moved(theirs, shift, turn)), cloud(ours), CloudFit(), sigma_shared_m=0.0)
        facts, sigma = fit.facts, np.sqrt(np.diag(fit.cov))
        assert facts["fitted_shift_m"] == fit.motion.shift_m.tolist()
        turned = Rotation.from_matrix(fit.motion.R).as_rotvec(degrees=True)
        assert facts["rotation_deg"] == pytest.approx(turned)
        assert facts["sigma_shift_m"] == pytest.approx(sigma[:3])
        assert facts["sigma_rotation_deg"] == pytest.approx(sigma[3:] * 180 / np.pi)
        left = fit.motion.apply(moved(theirs, shift, turn)) - theirs
        middle = left.mean(axis=0)
        squares.append(middle @ np.linalg.solve(fit.cov[:3, :3], middle) / 3)
    low, high = band(3 * len(squares))
    assert low < np.mean(squares) < high


def test_a_fit_tells_the_overlap_and_grows_the_sigmas(rng, tmp_path):
    ours, theirs = cloud(bank(rng, 8000)), cloud(bank(rng, 8000) + np.array([0, 0, 0.3]))
    fit = fit_cloud(theirs, ours, CloudFit(), sigma_shared_m=0.05)
    assert fit.overlap["median_before_m"].median() > 0.2
    assert abs(fit.overlap["median_after_m"].median()) < 0.01
    after = fit.moved(theirs)
    assert (after.sigma_up_m > np.hypot(0.02, 0.049)).all()
    fit.write(tmp_path / "fit.json")
    told = json.loads((tmp_path / "fit.json").read_text())
    assert told["shift_m"] == pytest.approx(fit.motion.shift_m)
    assert np.array(told["cov"]) == pytest.approx(fit.cov)


def test_a_fit_rests_on_stable_ground_alone(rng):
    """Two corners of the bank are stable; between them it sank by half a metre."""
    corners = [[[x, y], [x + 15, y], [x + 15, y + 10], [x, y + 10]] for x, y in ((0, 0), (45, 14))]
    ours, theirs = bank(rng, 16_000), bank(rng, 16_000) + np.array([0, 0, 0.3])
    x, y = theirs[:, :2].T
    theirs[~(((x < 15) & (y < 10)) | ((x > 45) & (y > 14))), 2] -= 0.5
    settings = CloudFit(stable=corners, motion="shift")
    fit = fit_cloud(cloud(theirs), cloud(ours), settings, sigma_shared_m=0.0)
    assert fit.motion.shift_m == pytest.approx([0, 0, -0.3], abs=0.02)


def test_a_level_plain_shows_no_shift_along_itself(rng):
    def plain():
        return np.column_stack([rng.uniform(0, 60, (8000, 2)), rng.normal(0, 0.01, 8000)])

    theirs = cloud(plain() + np.array([0.3, 0, 0.2]))
    fit = fit_cloud(theirs, cloud(plain()), CloudFit(sigma_datum_m=0.25), sigma_shared_m=0.0)
    assert fit.motion.shift_m == pytest.approx([0, 0, -0.2], abs=0.01)
    assert any("shift along" in words for words in fit.undetermined)
    # both shifts and the turn that were left alone move points by 25 cm each, so 25 to 31 cm an axis
    sigma = fit.moved(theirs).sigma_horizontal_m
    assert np.sqrt(np.mean(sigma**2)) == pytest.approx(0.25 * np.sqrt(1.5), rel=0.02)
    assert fit.moved(theirs).sigma_up_m.max() < 0.03
    # taken as right by the owner of the cloud: no motion, no more sigma
    still = fit_cloud(theirs, cloud(plain()), CloudFit(motion="none"), sigma_shared_m=0.0)
    assert still.cov == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda p, rng: p + np.array([0, 0, 45.0]), CoverageError, "orthometric"),
        (lambda p, rng: p + np.array([0, 0, 1.3]), GeometryError, "off the ground"),
        (lambda p, rng: p + np.array([500, 0, 0]), CoverageError, "ground that both clouds have"),
        (
            lambda p, rng: p + np.column_stack([np.zeros((len(p), 2)), 0.5 * np.sin(2 * p[:, 0])]),
            GeometryError,
            "differ",
        ),
        # ended in a bare warning of NumPy about infinities
        (
            lambda p, rng: np.where(np.arange(len(p))[:, None] < 5, np.inf, p),
            GeometryError,
            "5 of 8,000 points without",
        ),
    ],
    ids=["geoid", "datum", "elsewhere", "other ground", "infinite heights"],
)
def test_a_cloud_that_does_not_fit_is_refused(rng, change, error, words):
    ours, theirs = bank(rng, 8000), bank(rng, 8000)
    with pytest.raises(error, match=words) as told:
        fit_cloud(cloud(change(theirs, rng)), cloud(ours), CloudFit(), sigma_shared_m=0.0)
    check_whole(told.value)


def test_clouds_join_with_source_and_sigma_and_are_read_in_any_frame(rng, tmp_path):
    lidar, uav = cloud(bank(rng, 500), 0.031), cloud(bank(rng, 300), 0.062)
    counts = join_clouds(tmp_path / "all.laz", [(Source.LIDAR, lidar), (Source.SURROUNDINGS, uav)], FRAME)
    assert sorted(counts.values()) == [300, 500]
    parts = joined_parts(tmp_path / "all.laz")
    assert parts[Source.SURROUNDINGS].sigma_up_m == pytest.approx(0.062)
    assert parts[Source.LIDAR].xyz_m == pytest.approx(lidar.xyz_m, abs=6e-4)
    assert len(read_cloud([tmp_path / "all.laz"], FRAME, GRID, sigma_m=1.0).xyz_m) == 800


def test_a_cloud_in_the_map_comes_into_the_local_frame(rng, tmp_path):
    from thalweg.core import LazWriter

    local = bank(rng, 400)
    with LazWriter(tmp_path / "uav.laz", GRID) as writer:
        writer.append(FRAME.to_map(local, GRID))
    found = read_cloud([tmp_path / "uav.laz"], FRAME, GRID, sigma_m=0.07)
    assert found.xyz_m == pytest.approx(local, abs=2e-3)
    assert (found.sigma_up_m == 0.07).all()
