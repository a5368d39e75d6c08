"""The chain of frames: derivatives by differences, finite draws, and one formula for every use."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from thalweg.core import (
    GeometryError,
    Link,
    beam_axes,
    chain_derivatives,
    cross_matrix,
    opk_axes,
    propagated,
    rotation_opk,
)


def three_links(rng, n):
    """The outer two with a pose for each point."""
    return [
        Link(rotation=Rotation.random(n, rng=rng).as_matrix(), shift_m=rng.normal(size=(n, 3))),
        Link(rotation=Rotation.random(n, rng=rng).as_matrix(), shift_m=rng.normal(size=3)),
        Link(rotation=Rotation.random(rng=rng).as_matrix(), shift_m=rng.normal(size=3)),
    ]


def moved(links, x, errors, dx):
    """Points with finite errors (k, 6) of the links and dx of the point: the chain, written once more."""
    x = x + dx
    for link, e in zip(reversed(links), errors[::-1], strict=True):
        turned = (link.rotation @ x[:, :, None])[:, :, 0]
        x = Rotation.from_rotvec(e[3:]).apply(turned) + link.shift_m + e[:3]
    return x


def test_each_derivative_by_differences(rng):
    links, x = three_links(rng, 40), rng.normal(scale=20.0, size=(40, 3))
    chain = chain_derivatives(links, x)
    none = np.zeros((3, 6)), np.zeros(3)
    assert_allclose(chain.points_m, moved(links, x, *none), atol=1e-12)
    step = 1e-5
    for i in range(3):
        for k in range(6):
            e = np.zeros((3, 6))
            e[i, k] = step
            numeric = (moved(links, x, e, none[1]) - moved(links, x, -e, none[1])) / (2 * step)
            # central difference: step^2 / 6 * 50 m = 1e-9, rounding 1e-14 / step
            assert_allclose(chain.by_link[i][:, :, k], numeric, atol=1e-7)
    for k in range(3):
        e = step * np.eye(3)[k]
        numeric = (moved(links, x, none[0], e) - moved(links, x, none[0], -e)) / (2 * step)
        assert_allclose(chain.by_point[:, :, k], numeric, atol=1e-7)


def test_covariances_are_those_of_linear_combinations(rng):
    """Of one covariance for all points, and of one for each."""
    J, root = rng.normal(size=(5, 3, 7)), rng.normal(size=(5, 7, 7))
    own = root @ np.swapaxes(root, 1, 2)
    for S in (own[0], own):
        expected = np.einsum("nik,nkl,njl->nij", J, np.broadcast_to(S, own.shape), J)
        assert_allclose(propagated(J, S), expected, rtol=1e-12)


def test_small_changes_of_angles_are_rotation_vectors(rng):
    angles = rng.uniform(-3, 3, size=(50, 3))
    axes = opk_axes(angles[:, 0], angles[:, 1])
    assert axes.shape == (50, 3, 3)
    step = 1e-6
    for k in range(3):
        e = step * np.eye(3)[k]
        for a, A in zip(angles, axes, strict=True):
            skew = (rotation_opk(*(a + e)) - rotation_opk(*(a - e))) / (2 * step) @ rotation_opk(*a).T
            # rounding: 1e-16 / step
            assert_allclose([skew[2, 1], skew[0, 2], skew[1, 0]], A[:, k], atol=1e-9)


def test_axes_of_a_beam(rng):
    beams = np.concatenate([rng.normal(size=(100, 3)), np.eye(3), -np.eye(3)])
    axes = beam_axes(beams)
    assert_allclose(axes @ np.swapaxes(axes, 1, 2), np.tile(np.eye(3), (106, 1, 1)), atol=1e-14)
    assert_allclose(np.linalg.det(axes), 1.0, atol=1e-14)
    assert_allclose(np.cross(axes[:, :, 0], beams), 0.0, atol=1e-14)
    assert_allclose(cross_matrix(beams[:1])[0] @ beams[1], np.cross(beams[0], beams[1]), atol=1e-15)


@pytest.mark.parametrize(
    ("links", "points"),
    [
        ([], np.ones((2, 3))),
        ([Link(rotation=np.eye(3), shift_m=np.zeros(3))], np.ones(3)),
        ([Link(rotation=np.eye(4), shift_m=np.zeros(3))], np.ones((2, 3))),
        ([Link(rotation=np.eye(3), shift_m=np.zeros((5, 3)))], np.ones((2, 3))),
    ],
)
def test_shapes_that_do_not_match(links, points):
    with pytest.raises(GeometryError, match="expected"):
        chain_derivatives(links, points)


def test_covariance_agrees_with_draws_through_the_chain(rng):
    links, x = three_links(rng, 1), np.array([[8.0, -3.0, 5.0]])
    chain = chain_derivatives(links, x)
    J = np.concatenate([*chain.by_link, chain.by_point], axis=2)
    root = rng.normal(size=(21, 21)) * np.tile([0.02, 0.02, 0.02, 2e-3, 2e-3, 2e-3], 4)[:21, None]
    predicted = propagated(J, root @ root.T)[0]
    draws = rng.normal(size=(40_000, 21)) @ root.T
    many = np.repeat(x, len(draws), axis=0) + draws[:, 18:]
    for k in (2, 1, 0):
        turned = many @ np.broadcast_to(links[k].rotation, (1, 3, 3))[0].T
        shift = np.broadcast_to(links[k].shift_m, (1, 3))[0]
        many = Rotation.from_rotvec(draws[:, 6 * k + 3 : 6 * k + 6]).apply(turned) + shift
        many = many + draws[:, 6 * k : 6 * k + 3]
    scale = np.sqrt(np.outer(np.diag(predicted), np.diag(predicted)))
    # relative standard error of a variance from n draws: sqrt(2 / n) = 0.7 %; five of them
    assert_allclose(np.cov(many.T) / scale, predicted / scale, atol=0.035)
