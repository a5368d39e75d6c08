"""Poses and points of one bundle: their joint covariance is that of their errors, nothing is used twice."""

from functools import cache

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from tests.calibration import field_blocks as blocks
from thalweg.calibration import orient_on_field
from thalweg.calibration.camera_lidar import Statics, read_statics, statics_of, write_statics
from thalweg.calibration.field import FieldDescription, FieldPoints
from thalweg.calibration.field.description import FieldCone
from thalweg.core import InputError, Rigid

SHEETS, _ = blocks.yard(1, cones=8, per_cone=6, flat=16)
NAMES = tuple((s.marker, c) for s in SHEETS for c in range(4))
TRUTH = blocks.truth_of(SHEETS, NAMES)
CAMERA = blocks.FISHEYE
FIELD = FieldDescription(
    layout=blocks.MarkerLayout(),
    scale_bars=(),
    cones=tuple(
        FieldCone(name=f"C{k + 1}", markers=tuple(range(6 * k, 6 * k + 6)), half_angle_rad=0.4, length_m=0.7)
        for k in range(8)
    ),
)
STATIC = ["p1.jpg", "p2.jpg", "p3.jpg"]


@cache
def root() -> np.ndarray:
    """(3n, k) root of the covariance of the field: 0.2 mm that points share, 0.2 mm of their own."""
    rng = np.random.default_rng(12)
    shared = 2e-4 / np.sqrt(20) * rng.normal(size=(3 * len(NAMES), 20))
    return np.hstack([shared, 2e-4 * np.eye(3 * len(NAMES))])


def field(seed: int) -> FieldPoints:
    error = root() @ np.random.default_rng([seed, 7]).normal(size=root().shape[1])
    return FieldPoints(points=NAMES, points_pcs=TRUTH + error.reshape(-1, 3), cov=root() @ root().T)


def true_poses(run: int) -> dict[str, Rigid]:
    rng = np.random.default_rng(5)
    turns = np.r_[[0.1, 2.2, 4.3], np.linspace(0, 6, run)]
    names = STATIC + [f"r{k:02d}.jpg" for k in range(run)]
    return {
        name: blocks.look(
            np.append(rng.normal(0, 0.3, 2), 1.0), 4 * np.array([np.cos(a), np.sin(a), 0.2]), 0.2 * k
        )
        for k, (name, a) in enumerate(zip(names, turns, strict=True))
    }


def marks(run: int, seed: int) -> pd.DataFrame:
    return blocks.observe(SHEETS, true_poses(run), CAMERA, seed, sigma_px=0.1, largest_angle_deg=75.0)


def statics(run: int, seed: int) -> Statics:
    given = field(seed)
    return statics_of(orient_on_field(marks(run, seed), CAMERA, given), given, STATIC)


def error_of(found: Statics, run: int) -> np.ndarray:
    poses = true_poses(run)
    parts = [T.error_from(poses[i]) for i, T in zip(found.images, found.poses, strict=True)]
    return np.concatenate([*parts, (found.points.points_pcs - TRUTH).ravel()])


@pytest.mark.parametrize("run", [0, 6], ids=["static pictures alone", "with a run"])
def test_errors_are_as_the_joint_covariance_says(run):
    """Also where poses and points hang together, and for points that no picture shows."""
    squares, poses = [], []
    for seed in range(3 if run else 5):
        found = statics(run, seed)
        error = error_of(found, run)
        assert len(found.cov) == len(error)
        squares.append(error @ np.linalg.solve(found.cov, error))
        poses.append(error[:18] @ np.linalg.solve(found.cov[:18, :18], error[:18]))
    for values, size in ((squares, len(error)), (poses, 18)):
        # 99.9 %; sigmas of the marks are estimated along from some 300 of them, 4 % in the variance
        low, high = chi2.ppf([0.0005, 0.9995], size * len(values)) / (size * len(values))
        assert 0.96 * low < np.sum(values) / (size * len(values)) < 1.04 * high


def test_points_that_no_picture_shows_follow_the_others():
    found, given = statics(0, 2), field(2)
    seen = {(m, c) for m, c in zip(*marks(0, 2)[["marker", "corner"]].to_numpy().T, strict=True)}
    hidden = [i for i, name in enumerate(NAMES) if name not in seen]
    assert len(hidden) > 8
    # they share errors with the others, and so become better than they were
    before, after = given.sigma_m[hidden], found.points.sigma_m[hidden]
    assert (after < before * (1 + 1e-9)).all()
    assert np.mean(after) < 0.99 * np.mean(before)
    assert (found.points.points_pcs[hidden] != given.points_pcs[hidden]).all()
    assert found.points.points == NAMES


def test_the_block_as_a_file(tmp_path):
    found = statics(0, 3)
    write_statics(tmp_path / "s.npz", found)
    back = read_statics(tmp_path / "s.npz")
    assert back.images == tuple(STATIC)
    assert back.points.points == NAMES
    np.testing.assert_array_equal(back.cov, found.cov)
    np.testing.assert_array_equal(back.points.points_pcs, found.points.points_pcs)
    for a, b in zip(back.poses, found.poses, strict=True):
        np.testing.assert_allclose(a.matrix, b.matrix, atol=1e-15)
        np.testing.assert_array_equal(a.cov, b.cov)
    # in another order, and of some pictures only
    order = back.errors(FIELD, ["p3.jpg", "p1.jpg"]).cov
    np.testing.assert_array_equal(order[:6, 6:12], found.cov[12:18, :6])
    at = NAMES.index((0, 0))
    np.testing.assert_array_equal(order[:6, 12:15], found.cov[12:18, 18 + 3 * at : 21 + 3 * at])


def test_pictures_without_a_pose_are_told():
    table = marks(3, 4)
    few = table[(table["image"] != "p2.jpg") | (table["marker"] == table["marker"].iloc[0])]
    found = statics_of(orient_on_field(few, CAMERA, field(4)), field(4), [*STATIC, "p4.jpg"])
    assert found.images == ("p1.jpg", "p3.jpg")
    assert set(found.lost) == {"p2.jpg", "p4.jpg"}
    assert found.lost["p4.jpg"] == "no markers of the field were found in it"
    assert len(found.cov) == 12 + 3 * len(NAMES)


def test_another_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="file not found"):
        read_statics(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("x")
    with pytest.raises(InputError, match="no static positions"):
        read_statics(tmp_path / "text.npz")
    np.savez(tmp_path / "points.npz", points=np.zeros((2, 2)))
    with pytest.raises(InputError, match="no static positions"):
        read_statics(tmp_path / "points.npz")
