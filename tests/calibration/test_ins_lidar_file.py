"""Cones of a field for the run about them: with a joint covariance that holds."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from thalweg.calibration import Cone, MarkerLayout
from thalweg.calibration.field import FieldDescription, FieldPoints
from thalweg.calibration.field.description import AntennaMarker, FieldCone
from thalweg.calibration.ins_lidar import FieldCones
from thalweg.calibration.ins_lidar.antenna import antenna_lever, phase_centre
from thalweg.calibration.ins_lidar.file import field_antenna, field_cones, seen_antenna
from thalweg.core import ConfigError, InputError, Rigid

HALF_RAD = np.deg2rad(25.0)
PER_CONE = 8
FORM_M = 0.0002
TRUE = (
    Cone(apex_m=np.array([3.0, 0.5, 0.4]), axis=np.array([0.6, -0.8, 0.0]), half_angle_rad=HALF_RAD + 0.002),
    Cone(apex_m=np.array([-2.0, 1.0, 1.4]), axis=np.array([0.0, 0.1, -1.0]), half_angle_rad=HALF_RAD - 0.002),
    Cone(apex_m=np.array([0.5, 4.0, 0.9]), axis=np.array([-0.7, 0.7, 0.1]), half_angle_rad=HALF_RAD),
)
FIELD = FieldDescription(
    layout=MarkerLayout(),
    cones=tuple(
        FieldCone(
            name=f"C{k + 1}",
            markers=tuple(range(PER_CONE * k, PER_CONE * (k + 1))),
            half_angle_rad=float(HALF_RAD),
            length_m=0.7,
        )
        for k in range(len(TRUE))
    ),
)


def measured(seed: int) -> FieldPoints:
    """Marks on the cones in mixed order, with independent errors and some that all of them share."""
    rng = np.random.default_rng([6, seed])
    keys, points = [], []
    for k, cone in enumerate(TRUE):
        for marker in FIELD.cones[k].markers:
            for corner in range(4):
                slant, psi = rng.uniform(0.3, 0.75), rng.uniform(0, 2 * np.pi)
                across = np.array([np.cos(psi), np.sin(psi)]) @ cone.tangents
                a = cone.half_angle_rad
                point = cone.apex_m + slant * (np.cos(a) * cone.axis + np.sin(a) * across)
                normal = cone.see(point[None]).normal[0]
                keys.append((marker, corner))
                points.append(point + FORM_M * rng.standard_normal() * normal)
    order = rng.permutation(len(keys))
    n = 3 * len(keys)
    # the frame as a whole is shifted by millimetres, and turned: cones err together
    xyz = np.array(points)[order]
    x, y, z = xyz.T
    o = np.zeros(len(xyz))
    turned = np.stack([np.stack(row, axis=1) for row in ((o, z, -y), (-z, o, x), (y, -x, o))], axis=1)
    root = np.concatenate([np.tile(np.eye(3), (len(xyz), 1)), turned.reshape(n, 3)], axis=1)
    root = root * np.repeat([5e-3, 1e-4], 3)
    errors = root @ rng.standard_normal(6) + 1e-4 * rng.standard_normal(n)
    return FieldPoints(
        points=tuple(keys[i] for i in order),
        points_pcs=xyz + errors.reshape(-1, 3),
        cov=root @ root.T + 1e-8 * np.eye(n),
    )


def off(found: FieldCones) -> np.ndarray:
    return np.concatenate(
        [
            np.r_[
                true.apex_m - cone.apex_m,
                cone.tangents @ true.axis,
                true.half_angle_rad - cone.half_angle_rad,
            ]
            for cone, true in zip(found.cones, TRUE, strict=True)
        ]
    )


def test_the_covariance_of_the_cones_is_a_joint_one_and_positive():
    found, refused = field_cones(FIELD, measured(0), form_sigma_m=FORM_M)
    assert not refused
    assert np.linalg.eigvalsh(found.cov)[0] > 0
    for k, cone in enumerate(found.cones):
        mine = slice(6 * k, 6 * k + 6)
        np.testing.assert_allclose(found.cov[mine, mine], cone.cov, rtol=1e-9, atol=1e-18)
    # the shift of the frame is in all apexes
    sigma = np.sqrt(np.diag(found.cov))
    assert np.abs(found.cov / np.outer(sigma, sigma))[:6, 6:].max() > 0.7


def test_cones_are_as_far_off_as_they_say():
    runs = [field_cones(FIELD, measured(seed), form_sigma_m=FORM_M)[0] for seed in range(16)]
    squares = [off(found) @ np.linalg.solve(found.cov, off(found)) for found in runs]
    low, high = chi2.ppf([0.001, 0.999], 18 * len(runs))
    assert low < sum(squares) < high
    # difference of two apexes, in which the shift that they share drops out: only a joint covariance is right
    D = np.zeros((3, 18))
    D[:, :3], D[:, 6:9] = np.eye(3), -np.eye(3)
    apart = [D @ off(f) @ np.linalg.solve(D @ f.cov @ D.T, D @ off(f)) for f in runs]
    low, high = chi2.ppf([0.001, 0.999], 3 * len(runs))
    assert low < sum(apart) < high


def test_a_cone_that_is_not_round_is_less_certain():
    points = measured(1)
    round_, dented = (field_cones(FIELD, points, form_sigma_m=form)[0].cov for form in (0.0, 0.002))
    assert np.linalg.eigvalsh(dented - round_)[0] > -1e-12
    assert np.diag(dented)[5] > 4 * np.diag(round_)[5]  # the half angle: no shift of the frame is in it


def test_a_cone_without_marks_is_left_out_of_the_covariance_too():
    points = measured(2).without(set(FIELD.cones[1].markers))
    found, refused = field_cones(FIELD, points, form_sigma_m=FORM_M)
    assert (found.names, list(refused)) == (("C1", "C3"), ["C2"])
    whole = field_cones(FIELD, measured(2), form_sigma_m=FORM_M)[0].only([0, 2])
    np.testing.assert_allclose(found.cov, whole.cov, rtol=1e-9, atol=1e-18)


def test_a_field_without_marks_is_refused():
    markers = {m for cone in FIELD.cones for m in cone.markers}
    with pytest.raises(InputError, match=r"no cone of the field has a reference.*Take more pictures"):
        field_cones(FIELD, measured(0).without(markers))


def test_without_a_camera_the_antennas_marker_is_left_out():
    field = replace(FIELD, antenna=AntennaMarker(marker=99, offset_m=-0.02, sigma_m=0.001))
    assert seen_antenna(field, measured(0), {}, [], [], "position_1") is None
    with pytest.raises(ConfigError, match="no such file"):
        seen_antenna(field, measured(0), {}, [Path("poses.parquet")], [Path("nothing.yaml")], "position_1")


def test_the_antenna_by_its_marker_has_the_covariance_of_its_four_corners():
    """Its points stand in mixed order behind others; by the camera's place and the formula of the mark."""
    rng = np.random.default_rng(4)
    square = np.array([[0, 0, 1], [0.1, 0, 1], [0.1, -0.1, 1], [0, -0.1, 1]]) + np.array([0.5, 0.2, 0.0])
    root = 1e-3 * rng.standard_normal((21, 21))
    cov = root @ root.T
    names = ((7, 0), (99, 2), (7, 1), (99, 0), (99, 3), (8, 2), (99, 1))
    xyz = np.array([square[corner] if marker == 99 else [9.0, 9.0, 9.0] for marker, corner in names])
    at = [names.index((99, corner)) for corner in range(4)]
    of = np.array([[cov[3 * i + a, 3 * j + b] for j in at for b in range(3)] for i in at for a in range(3)])
    pose = Rigid(R=np.eye(3), shift_m=np.array([0.3, 0.0, 0.5]), cov=1e-6 * np.eye(6))
    relative = Rigid(R=np.eye(3), shift_m=np.array([0.0, 0.1, 0.0]), cov=1e-8 * np.eye(6))
    field = replace(FIELD, antenna=AntennaMarker(marker=99, offset_m=-0.02, sigma_m=0.001))
    points = FieldPoints(points=names, points_pcs=xyz, cov=cov)
    poses = {"position_1.jpg": pose, "position_2.jpg": relative}
    found = field_antenna(field, points, poses, "position_1.png", relative)
    assert found is not None
    np.testing.assert_allclose(found.x_ccs_m, [0.25, 0.15, 0.48], atol=1e-9)
    np.testing.assert_allclose(found.x_scs_m, [0.25, 0.05, 0.48], atol=1e-9)
    mark = phase_centre(square, of, offset_m=-0.02, sigma_offset_m=0.001)
    np.testing.assert_allclose(found.cov_scs_m2, antenna_lever(mark, pose, relative).cov_scs_m2)
