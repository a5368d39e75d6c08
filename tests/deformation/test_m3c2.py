"""Distances along normals against brute force, a peer's numbers and moved poses."""

import numpy as np
import pytest

from thalweg.core import ArrayF, GeometryError
from thalweg.deformation.m3c2 import ColumnIndex, cut_cylinders, multiscale_normals, pose_weights


@pytest.fixture
def cloud():
    rng = np.random.default_rng(3)
    xy = rng.uniform((-7.0, 100.0), (9.0, 112.0), (6000, 2))
    return np.column_stack([xy, 2.0 * np.sin(xy[:, 0] / 3.0) + rng.normal(0.0, 0.05, len(xy))])


def unit(vectors: ArrayF) -> ArrayF:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def inside(cloud: ArrayF, core: ArrayF, normal: ArrayF, radius: float, half_length: float) -> ArrayF:
    d = cloud - core
    along = d @ normal
    return np.asarray((np.abs(along) <= half_length) & ((d**2).sum(axis=1) - along**2 <= radius**2))


@pytest.mark.parametrize(
    ("radius", "half_length", "width"), [(0.4, 3.0, 0.7), (1.0, 0.5, 1.0), (0.3, 9.0, 2.5)]
)
def test_cylinders_hold_the_points_of_brute_force(cloud, radius, half_length, width):
    rng = np.random.default_rng(5)
    cores = cloud[rng.choice(len(cloud), 60, replace=False)] + rng.normal(0.0, 0.3, (60, 3))
    normals = unit(rng.normal(size=(60, 3)))
    normals[0], normals[1] = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
    cut = cut_cylinders(
        cores, normals, ColumnIndex.of(cloud, width), radius_m=radius, half_length_m=half_length, least=3
    )
    assert cut.n.max() > 20
    for i in range(60):
        along = (cloud[inside(cloud, cores[i], normals[i], radius, half_length)] - cores[i]) @ normals[i]
        assert cut.n[i] == len(along)
        if len(along) >= 3:
            assert cut.along_m[i] == pytest.approx(along.mean(), abs=1e-12)
            assert cut.std_m[i] == pytest.approx(along.std(ddof=1), rel=1e-9, abs=1e-12)
        else:
            assert np.isnan(cut.along_m[i])
            assert np.isnan(cut.std_m[i])


def test_normals_are_those_of_the_most_planar_scale(cloud):
    cores = cloud[:40]
    radii = (0.3, 0.8, 2.0)
    normals, radius = multiscale_normals(
        cores, ColumnIndex.of(cloud, 1.0), radii, towards=np.array([0.0, 0.1, -1.0])
    )
    for core, normal, scale in zip(cores, normals, radius, strict=True):
        best, expected = -1.0, np.zeros(3)
        for each in radii:
            near = cloud[((cloud - core) ** 2).sum(axis=1) <= each**2]
            if len(near) < 3:
                continue
            values, vectors = np.linalg.eigh(np.cov(near.T))
            if (planarity := (values[1] - values[0]) / values[2]) > best:
                best, expected, taken = planarity, vectors[:, 0], each
        assert scale == taken
        assert normal @ (0.0, 0.1, -1.0) > 0
        assert abs(normal @ expected) == pytest.approx(1.0, abs=1e-9)
    assert len(set(radius)) > 1


def test_a_core_point_without_neighbours_has_no_normal_and_no_distance(cloud):
    index = ColumnIndex.of(cloud, 1.0)
    cores = np.array([[0.0, 106.0, 50.0], [500.0, 0.0, 0.0]])
    normals, radius = multiscale_normals(cores, index, (0.5,), towards=np.array([0.0, 0.0, 1.0]))
    assert np.isnan(normals).all()
    assert np.isnan(radius).all()
    cut = cut_cylinders(cores, normals, index, radius_m=1.0, half_length_m=5.0)
    assert cut.n.tolist() == [0, 0]
    assert np.isnan(cut.along_m).all()


def test_weights_tell_what_an_error_of_a_pose_does(cloud):
    """Points moved by small errors of their poses move their mean as the weights say."""
    rng = np.random.default_rng(7)
    node = rng.integers(0, 9, len(cloud))
    boat = np.column_stack([np.linspace(-5, 7, 9), np.full(9, 90.0), np.full(9, 1.0)])
    index = ColumnIndex.of(cloud, 1.0)
    cores = cloud[:30]
    normals, _ = multiscale_normals(cores, index, (1.0,), towards=np.array([0.0, 0.0, 1.0]))
    shape = {"radius_m": 0.8, "half_length_m": 4.0}
    weights = pose_weights(cores, normals, index, node, boat, **shape)
    shift, turn = rng.normal(0.0, 1e-3, (9, 3)), rng.normal(0.0, 1e-4, (9, 3))
    moved = cloud + shift[node] + np.cross(turn[node], cloud - boat[node])
    for i in range(len(cores)):
        # the same points: which ones a cylinder holds is no derivative
        chosen = inside(cloud, cores[i], normals[i], 0.8, 4.0)
        expected = ((moved - cloud)[chosen] @ normals[i]).mean()
        entries = slice(weights.start[i], weights.start[i + 1])
        k = weights.node[entries]
        assert sorted(set(node[chosen])) == k.tolist()
        found = (weights.shift[entries] * shift[k]).sum() + (weights.turn_m[entries] * turn[k]).sum()
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-15)


def test_weights_of_many_core_points_with_many_moments(cloud):
    """More than one block of core points, more moments than a block has room for, two passages apart."""
    rng = np.random.default_rng(12)
    cores = cloud[rng.choice(len(cloud), 300, replace=False)]
    cores[7] = 1e4  # far from all points
    normals = np.tile([0.0, 0.0, 1.0], (300, 1))
    node = rng.integers(0, 400, len(cloud)) + np.where(rng.random(len(cloud)) < 0.5, 0, 9000)
    boat = rng.normal(0.0, 5.0, (9400, 3))
    index = ColumnIndex.of(cloud, 1.0)
    weights = pose_weights(cores, normals, index, node, boat, radius_m=1.5, half_length_m=5.0)
    assert len(weights.node) > 64 * 300
    assert weights.start[8] == weights.start[7]
    for i in (0, 7, 255, 256, 299):
        chosen = inside(cloud, cores[i], normals[i], 1.5, 5.0)
        k, at = np.unique(node[chosen], return_inverse=True)
        entries = slice(weights.start[i], weights.start[i + 1])
        assert weights.node[entries].tolist() == k.tolist()
        share = np.bincount(at, minlength=len(k)) / max(chosen.sum(), 1)
        assert weights.shift[entries, 2] == pytest.approx(share, abs=1e-15)
        arm = np.zeros((len(k), 3))
        np.add.at(arm, at, (cloud[chosen] - boat[node[chosen]]) / max(chosen.sum(), 1))
        assert weights.turn_m[entries] == pytest.approx(np.cross(arm, normals[i]), abs=1e-12)


@pytest.mark.real
def test_the_planes_of_py4dgeo(data_dir):
    """py4dgeo 1.2.0: every 50th point, cylinders of 2 m, normals at 0.5, 1 and 2 m."""
    before, after = (np.loadtxt(data_dir / f"py4dgeo_planes/plane_horizontal_t{i}.xyz") for i in (1, 2))
    cores = before[::50]
    indices = [ColumnIndex.of(each, 2.0) for each in (before, after)]
    normals, _ = multiscale_normals(cores, indices[0], (0.5, 1.0, 2.0), towards=np.array([0.0, 0.0, 1.0]))
    # At the corner of the plane py4dgeo's scatter is not quite about the mean, which turns that normal by
    # 0.05 degrees: its own normal is given there, so that the level of detection is the same.
    assert normals[0] == pytest.approx([0.00371886, -0.00155059, 0.99999188], abs=1e-8)
    judged = normals.copy()
    judged[0] = (4.3167396849e-03, -9.5270570738e-04, 9.9999022901e-01)
    for chosen, limit in ((normals, 1e-6), (judged, 1e-8)):
        cuts = [
            cut_cylinders(cores, chosen, each, radius_m=2.0, half_length_m=2.0, least=1) for each in indices
        ]
        distance = cuts[1].along_m - cuts[0].along_m
        assert distance[:3] == pytest.approx([-0.10269281, -0.09957772, -0.10179986], abs=limit)
        assert distance.mean() == pytest.approx(-0.100323, abs=1e-6)
    limits = 1.96 * np.sqrt(sum(cut.std_m**2 / cut.n for cut in cuts))
    assert limits[:3] == pytest.approx([0.0054738, 0.00181819, 0.00255157], abs=5e-8)


@pytest.mark.parametrize("bad", [np.empty((0, 3)), np.array([[0.0, np.nan, 1.0]])])
def test_clouds_that_cannot_be_indexed_are_refused(bad):
    with pytest.raises(GeometryError, match="finite"):
        ColumnIndex.of(bad, 1.0)
    far = np.array([[0.0, 0.0, 0.0], [1e9, 1e9, 0.0]])
    with pytest.raises(GeometryError, match="far from all others"):
        ColumnIndex.of(far, 0.5)
