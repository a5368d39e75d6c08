"""The similarity that puts a block into the world, and what it says of wrong points."""

from types import SimpleNamespace

import numpy as np
import pytest

from thalweg.core import GeometryError, exp_rotation
from thalweg.images.model import ControlPoints, Similarity, check_place, nearest_to_rays, robust_similarity
from thalweg.images.model.block import comparable, spread_share, start_from_positions

NAMES = tuple(f"P{k}" for k in range(9))


def pair(rng: np.random.Generator, n: int = 9) -> tuple[np.ndarray, np.ndarray]:
    """The same points in a model's frame and in the world, to a few centimetres."""
    target = rng.uniform([0, 0, 0], [80, 12, 5], (n, 3))
    R = exp_rotation([0.3, -1.2, 2.0])
    source = (target - [10.0, 20.0, 30.0]) @ R / 7.5 + rng.normal(0, 0.002, (n, 3))
    return source, target


def points_of(xyz: np.ndarray) -> ControlPoints:
    n = len(xyz)
    cov = np.tile(1e-4 * np.eye(3), (n, 1, 1))
    return ControlPoints(names=NAMES[:n], points_wcs_m=xyz, cov_wcs_m2=cov, check=np.zeros(n, bool))


def fitted(source: np.ndarray, target: np.ndarray) -> Similarity:
    return robust_similarity(source, target, NAMES, what="control points")


def test_swapped_names_are_named_and_left_out(rng):
    source, target = pair(rng)
    target[[2, 6]] = target[[6, 2]]
    found = fitted(source, target)
    assert np.flatnonzero(~found.fits).tolist() == [2, 6]
    distance = np.linalg.norm(target[2] - target[6])
    assert any("P2" in note and f"{distance:.0f}"[:1] in note for note in found.notes)
    assert found.scale == pytest.approx(7.5, rel=0.01)


def test_one_wrong_point_is_named_with_its_size(rng):
    source, target = pair(rng)
    target[4, 2] += 10.0
    found = fitted(source, target)
    assert np.flatnonzero(~found.fits).tolist() == [4]
    assert found.misfit_m[4] == pytest.approx(10, abs=0.5)
    assert found.notes[0].startswith("P4 is ")


LINE = np.outer(np.linspace(0, 1, 9), [80.0, 5.0, 1.0])


def test_points_on_a_line_have_no_spread():
    assert spread_share(LINE) < 1e-12


@pytest.mark.parametrize(
    ("target", "answer"),
    [
        pytest.param(LINE, r"all 9 control points lie on a line.*off the line", id="on a line"),
        pytest.param(
            np.random.default_rng(1).uniform(0, 80, (9, 3)),
            r"do not have the same shape.*names of the points",
            id="other coordinates",
        ),
        pytest.param(LINE[:2], r"2 control points.*at least 3", id="too few"),
    ],
)
def test_points_that_give_no_place_are_refused(rng, target, answer):
    source, _ = pair(rng, len(target))
    with pytest.raises(GeometryError, match=answer):
        fitted(source, target)


def test_a_wrong_crs_is_told_by_the_distance(rng):
    _, target = pair(rng)
    near = target + np.array([0.0, -30.0, 2.0])
    check_place(points_of(target), near)
    with pytest.raises(GeometryError, match=r"P\d lies 5\d\d\d\.\d km.*nearest, P\d.*CRS of the control"):
        check_place(points_of(target + np.array([4e5, 5.6e6, 0.0])), near)
    one = target.copy()
    one[3, 0] += 2e4
    with pytest.raises(GeometryError, match=r"control point P3 lies 20\.0 km.*Check its coordinates"):
        check_place(points_of(one), near)
    check_place(points_of(one), np.empty((0, 3)))  # nothing is known of the images


def test_one_wrong_ray_does_not_move_the_point():
    centres = np.outer(np.arange(5), [5.0, 0, 0])
    target = np.array([9.0, 25.0, 3.0])
    rays = target - centres
    rays[1] += [4.0, 0, 0]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    np.testing.assert_allclose(nearest_to_rays(centres, rays), target, atol=1e-9)
    assert np.isnan(nearest_to_rays(centres[:2], np.tile([[0.0, 1, 0]], (2, 1)))).all()


@pytest.mark.parametrize(("extent_m", "tolerance_m"), [(10.0, 2.0), (500.0, 15.0)])
def test_cameras_agree_within_a_share_of_their_extent(monkeypatch, extent_m, tolerance_m):
    """3 % of the diagonal, at least 2 m."""
    given = []
    monkeypatch.setattr(
        "thalweg.images.model.block.robust_similarity", lambda *words, **more: given.append((words, more))
    )
    block = SimpleNamespace(centre_block_m=np.arange(9.0).reshape(3, 3), images=("a", "b", "c"))
    places = extent_m * np.array([[0.0, 0.6, 0.0], [0.8, 0.0, 0.0]])
    start_from_positions(block, np.array([2, 0]), places)
    ((a, b, names), more) = given[0]
    assert (a.tolist(), names) == ([[6.0, 7, 8], [0, 1, 2]], ["c", "a"])
    assert b is places
    assert more == {"what": "camera positions", "tolerance_m": pytest.approx(tolerance_m)}


def test_images_without_a_whole_prediction_are_not_compared():
    centre = np.array([[1.0, 2, 3], [1, np.nan, 3], [np.nan] * 3, [1, 2, 3]])
    given = SimpleNamespace(oriented=np.array([True, True, True, False]), centre_wcs_m=centre)
    assert comparable(given).tolist() == [True, False, False, False]
