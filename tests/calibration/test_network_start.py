"""Approximate values of a field, gross contradictions of its targets, changed cameras: by hand."""

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests.calibration import field_blocks as blocks
from tests.calibration.test_network_parts import CORNERS, PLACE
from thalweg.calibration.field import Layout, bundle, marks_model
from thalweg.calibration.field.bundle import State
from thalweg.calibration.field.network import (
    CameraChange,
    Start,
    _aligned,
    _centres,
    _intersect,
    _places,
    _repair,
    _resected,
    _triples,
    agreeing,
    approximate_place,
    camera_changes,
    distances_words,
    require_steady,
)
from thalweg.calibration.markers import Block
from thalweg.core import GeometryError, Rigid, exp_rotation, rotation_opk

SLR = blocks.SLR

CENTRES = np.array(
    [
        [2, 0, 0.1],
        [-2, 0.5, 0],
        [0.3, 2, 0.8],
        [0, -2, 0.4],
        [1.5, 1.6, 1.2],
        [-1.4, -1.3, 0.9],
        [1.4, -1.2, 0],
    ]
)


def block_of_rays(images: str, points, image: np.ndarray, point: np.ndarray, rays: np.ndarray) -> Block:
    """Marks whose pixels do not count."""
    n = len(image)
    return Block(
        images=tuple(images), camera_of=("slr",) * len(images), points=points, image=image, point=point,
        xy_px=np.zeros((n, 2)), sigma_px=np.ones(n), rays=rays,
    )  # fmt: skip


def exact() -> tuple[Block, Start]:
    """Seven sheets in six pictures whose rays have no error, and the true start."""
    points = tuple((m, c) for m in range(7) for c in range(4))
    X = np.concatenate([centre + CORNERS for centre in CENTRES])
    poses = {}
    for i, turn in enumerate(np.linspace(0.0, 2 * np.pi, 6, endpoint=False)):
        place = np.array([6 * np.cos(turn), 6 * np.sin(turn), 2.0 + 0.3 * i])
        poses[i] = blocks.look(place, np.array([0.0, 0.0, 0.4]), 0.3 * i)
    image, point = (a.ravel() for a in np.meshgrid(np.arange(6), np.arange(28), indexing="ij"))
    rays = np.concatenate([poses[i].inverse().apply(X) for i in range(6)])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return block_of_rays("abcdef", points, image, point, rays), Start(poses, X.copy())


# ---------------------------------------------------------------- places of sheets


def test_the_centre_of_a_sheet_is_the_mean_of_four_saddles():
    block, start = exact()
    start.points[1] += [0.4, 0.0, 0.0]
    start.points[6] = np.nan
    found = _centres(block, start)
    assert sorted(found) == [0, 2, 3, 4, 5, 6]
    np.testing.assert_allclose(found[0], CENTRES[0] + [0.1, 0.0, 0.0])
    np.testing.assert_allclose(found[6], CENTRES[6])


def test_sheets_are_where_they_were_intersected_or_else_where_pictures_see_them():
    """Sheet 1 lacks a saddle; three pictures see it 0, 0.3 and 9 m off: the median. Sheet 5 is not seen."""
    block, start = exact()
    start.points[6] = np.nan
    start.points[20] = np.nan
    off = {0: 0.0, 2: 0.3, 3: 9.0}
    seen = {
        i: {1: pose.inverse().apply((CENTRES[1] + [off[i], 0.0, 0.0])[None])[0], 2: np.zeros(3)}
        for i, pose in start.poses.items()
        if i in off
    }
    found = _places(block, start, seen)
    np.testing.assert_allclose(found[1], CENTRES[1] + [0.3, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(found[2], CENTRES[2], atol=1e-12)
    assert sorted(found) == [0, 1, 2, 3, 4, 6]


def test_a_picture_is_laid_upon_three_sheets():
    at = {m: CENTRES[m] for m in (0, 1, 2)}
    there = {m: PLACE.apply(at[m][None])[0] for m in at} | {9: np.zeros(3)}
    found = _aligned(at | {5: np.ones(3)}, there)
    np.testing.assert_allclose(found.matrix, PLACE.matrix, atol=1e-12)
    assert _aligned({m: at[m] for m in (0, 1)}, there) is None


def aligned(at: np.ndarray, off: np.ndarray | float = 0.0) -> bool:
    """Whether sheets are laid upon their places in another frame, from which they are off."""
    return _aligned(dict(enumerate(at)), dict(enumerate(PLACE.apply(at + off)))) is not None


@pytest.mark.parametrize(("width_m", "there"), [(0.5, False), (1.5, True)])
def test_sheets_in_a_line_leave_a_turn_free(width_m, there):
    """Three sheets 10 m ahead, the middle one aside: sqrt(2) / 3 of that is the width, and 0.5 m the limit.

    The farthest one is sqrt(10^2 + 4^2) = 10.77 m away, so the limit is 0.54 m: 1.14 m aside.
    """
    assert aligned(np.array([[-4.0, 0, 10], [0, width_m, 10], [4, 0, 10]])) == there


@pytest.mark.parametrize(("off_m", "there"), [(0.2, True), (2.0, False)])
def test_sheets_that_lie_otherwise_do_not_align(off_m, there):
    """Seven sheets of a field of 2 m, each moved to another side: a tenth of its size is the limit."""
    side = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [1, 0, 0]])
    assert aligned(CENTRES, off_m * side) == there


# ---------------------------------------------------------------- points and poses

OFF = np.array([1.0, -0.5, 0.3, 0.1, 0.2, -0.1])
"""Of a wrong pose from the right one."""


def test_rays_meet_in_their_points():
    block, start = exact()
    np.testing.assert_allclose(_intersect(block, start.poses), start.points, atol=1e-9)
    # two pictures are enough, one is not; a ray without numbers is no ray
    two = {i: start.poses[i] for i in (0, 2)}
    block.rays[5, 1] = np.nan
    found = _intersect(block, two)
    np.testing.assert_allclose(found[:5], start.points[:5], atol=1e-9)
    assert np.isnan(found[5]).all()
    assert np.isnan(_intersect(block, {0: start.poses[0]})).all()


def test_one_wrong_ray_of_six_hardly_moves_its_point():
    """0.3 rad off at 6 m: 1.8 m, weighted down to a millirad's share in each turn."""
    block, start = exact()
    block.rays[3] = exp_rotation([0.0, 0.3, 0.0]) @ block.rays[3]
    found = _intersect(block, start.poses)
    off = np.linalg.norm(found - start.points, axis=1)
    assert off[3] < 0.03
    np.testing.assert_allclose(np.delete(off, 3), 0.0, atol=1e-9)


def test_rays_that_hardly_cross_make_no_point():
    """Two pictures, 5 m from a point, apart by 0.029 and 0.031 rad as it sees them; 0.03 is the limit."""
    for angle, solved in ((0.029, False), (0.031, True)):
        aside = 5 * np.sin(angle / 2) * np.array([[-1.0, 0, 0], [1, 0, 0]])
        poses = {i: Rigid(R=np.eye(3), shift_m=place) for i, place in enumerate(aside)}
        rays = (np.array([0.0, 0.0, 5 * np.cos(angle / 2)]) - aside) / 5
        block = block_of_rays("ab", ((0, 0),), np.array([0, 1]), np.array([0, 0]), rays)
        assert np.isfinite(_intersect(block, poses)).all() == solved


def test_a_wrong_pose_is_found_anew_and_right_ones_stay():
    block, start = exact()
    true = dict(start.poses)
    start.poses[2] = true[2].moved(OFF)
    # rays with one unknown number have no part
    block.rays[np.flatnonzero(block.image == 2)[9]] = [0.1, np.nan, 0.9]
    _repair(block, block, start)
    np.testing.assert_allclose(start.poses[2].matrix, true[2].matrix, atol=1e-3)
    for i in (0, 1, 3, 4, 5):
        assert start.poses[i] is true[i]


def test_a_right_pose_with_wrong_marks_is_not_found_anew():
    """Three of ten marks are off by 0.1: the pose fits badly, and no other fits better."""
    block, start = exact()
    true = start.poses[2]
    rays = block.rays.copy()
    rays[(block.image == 2) & (block.point % 10 < 3)] += [0.1, 0.0, 0.0]
    _repair(replace(block, rays=rays), block, start)
    assert start.poses[2] is true


def test_a_picture_is_resected_without_the_rays_that_are_unknown():
    block, start = exact()
    true = start.poses.pop(2)
    block.rays[np.flatnonzero(block.image == 2)[9]] = [0.1, np.nan, 0.9]
    found = _resected(block, 2, start, np.ones(28, dtype=bool), {}, {})
    np.testing.assert_allclose(found.matrix, true.matrix, atol=1e-3)


@pytest.mark.parametrize("kept", ["six saddles", "three sheets"])
def test_too_little_repairs_no_pose(kept):
    block, start = exact()
    wrong = start.poses[2] = start.poses[2].moved(OFF)
    few = [0, 4, 8, 12, 16, 20] if kept == "six saddles" else list(range(12))
    block.rays[(block.image == 2) & ~np.isin(block.point, few)] = np.nan
    _repair(block, block, start)
    assert start.poses[2] is wrong


# ---------------------------------------------------------------- targets

TARGETS = np.array([[0.0, 0, 0], [10, 0, 1], [12, 8, 0], [-1, 9, 2], [5, 4, 0.5], [3, 12, 1]])


@pytest.mark.parametrize(("off", "kept"), [(0.1, True), (0.5, False)])
def test_a_target_agrees_within_a_share_of_the_size(off, kept):
    """15 % of the root mean square distance from the middle, of fields of any size; four fit exactly."""
    for size in (0.02, 40.0):
        places = size * TARGETS[[0, 1, 2, 3, 5]]
        root = np.sqrt(np.square(places - places.mean(axis=0)).sum(axis=1).mean())
        there = PLACE.apply(places)
        there[4] += [0.0, 0.0, off * root]
        found = approximate_place(places, there, scaled=False)
        assert np.allclose(found[1].matrix, PLACE.matrix, atol=1e-9 * size) != kept


@pytest.mark.parametrize(("factor", "there"), [(0.59, False), (0.61, True), (1.59, True), (1.61, False)])
def test_a_place_of_another_size_is_none(factor, there):
    found = approximate_place(TARGETS, PLACE.apply(factor * TARGETS), scaled=True)
    assert (found is not None) == there


def test_which_targets_agree():
    """One of six 1 m off, where 5 cm are tolerated; RTK minus field is that metre."""
    there = PLACE.apply(TARGETS)
    there[3] += [0.0, 0.0, 1.0]
    there[[0, 2]] += [[0.02, 0.0, 0.0], [-0.02, 0.0, 0.0]]
    kept, off, factor = agreeing(TARGETS, there, np.full(6, 0.05))
    assert kept.tolist() == [True, True, True, False, True, True]
    assert factor == 1.0
    np.testing.assert_allclose(off[3], [0.0, 0.0, 1.0], atol=0.06)
    assert np.linalg.norm(off[kept], axis=1).max() < 0.05
    # none: all have their part in the residuals, which sum up to nothing
    kept, off, _ = agreeing(TARGETS, TARGETS[::-1] * [1.0, 2.0, 3.0], np.full(6, 1e-6))
    assert not kept.any()
    np.testing.assert_allclose(off.sum(axis=0), 0.0, atol=1e-9)


def test_of_as_many_targets_the_nearer_ones_agree():
    """Two triples of six: one fits exactly, one to some centimetres within its tolerance of 10 cm."""
    other = Rigid(R=rotation_opk(0.0, 0.0, 1.0), shift_m=np.array([200.0, 0.0, 0.0]))
    loose = other.apply(TARGETS[:3]) + 0.03 * np.array([[1.0, 0, 0], [-1, 1, 0], [0, -1, 0]])
    there = np.concatenate([loose, PLACE.apply(TARGETS[3:])])
    kept, _, _ = agreeing(TARGETS, there, np.full(6, 0.1))
    assert kept.tolist() == [False, False, False, True, True, True]


def test_distances_in_words():
    off = np.array([[0.0, 0.03, 0.04], [3.0, 0.0, 4.0], [0.1, 0.0, 0.0]])
    assert distances_words(["T0", "T1", "T2"], off) == "T1 5.00 m, T2 0.10 m, T0 0.05 m"


def test_triples_span_a_triangle():
    """Three of four in a line with a width of a tenth of a percent; at most 2000 of very many."""
    line = np.array([[0.0, 0, 0], [5, 0.005, 0], [10, 0, 0], [3, 8, 0]])
    assert [t.tolist() for t in _triples(line)] == [[0, 1, 3], [0, 2, 3], [1, 2, 3]]
    many = np.random.default_rng(1).standard_normal((40, 3))
    chosen = _triples(many)
    # 9880 of 40: every fifth
    assert 1900 < len(chosen) <= 1976
    assert chosen[1].tolist() == [0, 1, 7]


# ---------------------------------------------------------------- a changed camera


@pytest.fixture(scope="module")
def changed():
    """Twelve pictures; since the eighth the constant is larger by 0.2 %, and the axis 3 and -2 px on."""
    sheets, _ = blocks.yard(0, cones=2, per_cone=3, flat=12)
    stations = blocks.stations(0, 12, 7.0)
    problem, x, layout = blocks.true_block(sheets, stations, blocks.observe(sheets, stations, SLR, 0))
    block = problem.block
    late = block.image >= 7
    xy = block.xy_px.copy()
    xy[late] += 0.002 * (xy[late] - SLR.parameters[2:4]) + [3.0, -2.0]
    sigma = np.where(np.arange(len(xy)) % 2, 0.3, 0.6)
    block = replace(block, xy_px=xy, sigma_px=sigma)
    used = np.arange(len(xy)) % 7 != 3
    problem = replace(problem, block=block, used=used)
    part = marks_model(problem, layout, x)
    w = 1 / np.repeat(sigma[used], 2)
    J = part.jacobian.toarray() * w[:, None]
    # poses and points of about 1e-6, so that the start is the adjusted state
    cov = np.linalg.inv(J.T @ J + 1e12 * np.eye(J.shape[1]))
    adjusted = SimpleNamespace(x=x, cov=cov)
    return {"problem": problem, "adjusted": adjusted, "layout": layout, "J": J, "w": w, "part": part}


def test_a_camera_that_changed_is_the_score_test_of_all_marks(changed):
    """Three more unknowns of all marks since a picture, by differences; the best of all places is told."""
    problem, adjusted, layout = changed["problem"], changed["adjusted"], changed["layout"]
    (found,) = camera_changes(problem, cast(Any, adjusted), layout)
    names = problem.block.images
    assert (found.camera, found.before, found.since) == ("slr", names[6], names[7])
    late = np.repeat(problem.block.image[problem.used] >= 7, 2)
    x, J, w = adjusted.x, changed["J"], changed["w"]

    def residual(values: np.ndarray) -> np.ndarray:
        parameters = SLR.parameters.copy()
        parameters[:2] *= 1 + values[0]
        parameters[2:4] += values[1:]
        state = replace(x, cameras=(SLR.with_parameters(parameters),))
        return np.asarray(marks_model(problem, layout, state).residual) * w

    step = np.diag([1e-6, 1e-3, 1e-3])
    E = np.column_stack([(residual(d) - residual(-d)) / (2 * d.sum()) for d in step])
    E[~late] = 0.0
    r = changed["part"].residual * w
    across = J.T @ E
    left = E.T @ E - across.T @ adjusted.cov @ across
    values = -np.linalg.solve(left, E.T @ r)
    np.testing.assert_allclose([found.constant, *found.shift_px], values, rtol=1e-4)
    assert found.sigma_constant == pytest.approx(np.sqrt(np.linalg.inv(left)[0, 0]), rel=1e-5)
    bend = adjusted.cov[layout.points :] @ (across @ values)
    assert found.bend_m == pytest.approx(np.sqrt(np.mean(bend**2)), rel=1e-4)
    sigma = np.sqrt(np.mean(np.diag(adjusted.cov)[layout.points :]))
    assert found.bend_sigmas == pytest.approx(found.bend_m / sigma)
    # what was put in, but for what the other unknowns take of it
    assert found.constant == pytest.approx(0.002, rel=0.1)
    assert found.shift_px == pytest.approx((3.0, -2.0), rel=0.1)
    assert found.probability < 1e-6


@pytest.mark.parametrize(
    ("bend_sigmas", "probability", "refused"), [(3.1, 1e-9, True), (2.9, 1e-9, False), (3.1, 0.9, False)]
)
def test_a_clear_change_that_bends_the_field_is_refused(bend_sigmas, probability, refused):
    """Three of its sigmas; a change that is likely by chance bends nothing."""
    change = CameraChange(
        camera="slr", before="a", since="b", constant=0.001, sigma_constant=1e-5, shift_px=(0.0, 0.0),
        probability=probability, bend_m=0.001, bend_sigmas=bend_sigmas,
    )  # fmt: skip
    told = pytest.raises(GeometryError, match="the camera slr changed between a and b")
    with told if refused else nullcontext():
        require_steady([change])


def test_five_pictures_of_a_camera_tell_no_change(changed):
    """Three on either side are needed."""
    problem, adjusted = changed["problem"], changed["adjusted"]
    told = cast(Any, SimpleNamespace(x=replace(adjusted.x, cameras=(SLR, SLR)), cov=adjusted.cov))
    split = replace(problem, camera=np.where(np.arange(12) < 5, 0, 1), free=((), ()))
    layout = Layout(split, (SLR, SLR))
    (found,) = camera_changes(split, told, layout)
    # of the seven later ones the third or the fourth may be the first, and the change came before the third
    assert found.since == problem.block.images[8]
    halves = replace(split, camera=np.where(np.arange(12) < 6, 0, 1))
    assert [c.since for c in camera_changes(halves, told, layout)] == [
        problem.block.images[i] for i in (3, 9)
    ]


def test_pictures_that_fit_badly_are_resected_on_points_that_two_others_know(monkeypatch):
    """The third picture is off; of its nine marks it takes those of points that both others see well."""
    seen = [(i, p) for i in range(3) for p in range(9) if (i, p) != (1, 8)]
    image, point = np.array(seen).T
    block = block_of_rays("abc", tuple(divmod(p, 4) for p in range(9)), image, point, None)
    block = replace(block, xy_px=SLR.parameters[2:4] + image[:, None])
    problem = blocks.of_slr(block)
    x = State((SLR,), np.tile(np.eye(3), (3, 1, 1)), np.zeros((3, 3)), np.arange(27.0).reshape(9, 3))
    given: list = []

    def resected(*words, **more):
        given[:] = words
        return PLACE, np.zeros(8)

    monkeypatch.setattr(bundle, "mark_lengths", lambda *_: np.where(image == 2, 100.0, 0.5))
    monkeypatch.setattr(bundle, "pose_from_rays", resected)
    found = bundle._reposed(problem, x)
    places, rays, markers = given
    np.testing.assert_array_equal(places, x.X[:8])
    np.testing.assert_allclose(rays, SLR.rays(np.tile(SLR.parameters[2:4] + 2.0, (8, 1))))
    assert markers.tolist() == [0] * 4 + [1] * 4
    np.testing.assert_array_equal(found.C, [[0, 0, 0], [0, 0, 0], PLACE.shift_m])
    np.testing.assert_array_equal(found.R[2], PLACE.R)


def test_the_start_of_a_bundle_has_settled(rng):
    """From poses centimetres and degrees off, one mark in twenty wrong: once more changes next to nothing."""
    sheets, _ = blocks.yard(0, cones=2, per_cone=3, flat=12)
    stations = blocks.stations(0, 12, 7.0)
    sigma = np.repeat([0.05, 0.02], 3)
    off = {name: pose.moved(sigma * rng.normal(size=6)) for name, pose in stations.items()}
    marks = blocks.observe(sheets, stations, SLR, 0, wrong=0.05)
    problem, x, _ = blocks.true_block(sheets, off, marks)
    first = bundle.robust_start(problem, replace(x, X=x.X + rng.normal(0, 0.02, x.X.shape)))
    again = bundle.robust_start(problem, first)
    np.testing.assert_allclose(again.C, first.C, atol=1e-4)
