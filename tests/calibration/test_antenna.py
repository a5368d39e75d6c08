"""The antenna by its marker: geometry, covariance against drawn errors, bent prints."""

import numpy as np
import pytest

from thalweg.calibration.ins_lidar import AntennaLever
from thalweg.calibration.ins_lidar.antenna import antenna_lever, check_nominal, phase_centre
from thalweg.core import ArrayF, GeometryError, Rigid, rotation_opk

SIDE_M = 0.128
SQUARE = SIDE_M / 2 * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
"""Upper left, upper right, lower right, lower left as seen from above."""

T_PCS_CCS = Rigid.from_opk(
    [1.5, 0.2, -0.1], [0.3, -0.4, 0.9], np.diag(np.r_[np.full(3, 4e-7), np.full(3, 4e-8)])
)
T_CCS_SCS = Rigid.from_opk(
    [0.02, -1.55, 0.1], [0.05, 0.1, -0.1], np.diag(np.r_[np.full(3, 3e-7), np.full(3, 1e-7)])
)


def lying(turn: ArrayF) -> ArrayF:
    return SQUARE @ turn.T + [0.5, -0.2, 1.1]


@pytest.mark.parametrize("offset", [0.02, -0.03])
def test_the_phase_centre_lies_above_the_print(offset):
    turn = rotation_opk(0.1, -0.05, 0.8)
    mark = phase_centre(lying(turn), np.eye(12) * 1e-8, offset_m=offset, sigma_offset_m=0.001)
    assert mark.normal == pytest.approx(turn[:, 2])
    assert mark.point_m == pytest.approx(np.array([0.5, -0.2, 1.1]) + offset * turn[:, 2])
    # the offset's sigma along the normal rules all others
    assert np.sqrt(mark.normal @ mark.cov_m2 @ mark.normal) == pytest.approx(0.001, rel=0.01)


def test_the_covariance_is_that_of_drawn_errors(rng):
    root = rng.normal(size=(12, 12)) * 1.5e-4
    C = root @ root.T
    turn = rotation_opk(0.1, -0.05, 0.8)
    saddles = lying(turn)
    seen = antenna_lever(phase_centre(saddles, C, offset_m=0.05, sigma_offset_m=0.001), T_PCS_CCS, T_CCS_SCS)
    drawn = []
    for _ in range(1500):
        moved = saddles + (root @ rng.normal(size=12)).reshape(4, 3)
        mark = phase_centre(moved, C, offset_m=0.05 + 0.001 * rng.normal(), sigma_offset_m=0.001)
        pose, relative = (
            T.moved(np.sqrt(np.diag(T.cov)) * rng.normal(size=6)) for T in (T_PCS_CCS, T_CCS_SCS)
        )
        other = antenna_lever(mark, pose, relative)
        drawn.append(np.r_[other.x_ccs_m, other.x_scs_m])
    cov = np.cov(np.array(drawn).T)
    # 1500 draws give a variance to 3.7 % (1 sigma); four sigmas
    scale = np.sqrt(np.outer(np.diag(cov), np.diag(cov)))
    assert cov[:3, :3] / scale[:3, :3] == pytest.approx(seen.cov_ccs_m2 / scale[:3, :3], abs=0.147)
    assert cov[3:, 3:] / scale[3:, 3:] == pytest.approx(seen.cov_scs_m2 / scale[3:, 3:], abs=0.147)


def test_seen_from_the_scanner_it_is_where_the_frames_say():
    mark = phase_centre(lying(np.eye(3)), np.eye(12) * 1e-8, offset_m=0.02, sigma_offset_m=0.001)
    seen = antenna_lever(mark, T_PCS_CCS, T_CCS_SCS)
    assert (T_PCS_CCS @ T_CCS_SCS).apply(seen.x_scs_m[None])[0] == pytest.approx(mark.point_m)
    moved = T_CCS_SCS.moved(np.full(6, 1e-6))
    change = antenna_lever(mark, T_PCS_CCS, moved).x_scs_m - seen.x_scs_m
    # 1e-4: second order of a step of 1e-6
    assert seen.by_camera_lidar @ np.full(6, 1e-6) == pytest.approx(change, rel=1e-4)


LIDAR = {
    "omega_deg": 0.0,
    "phi_deg": -90.0,
    "kappa_deg": 0.0,
    "lever_ics_m": [-0.35, 0.0, -0.25],
    "sigma_omega_deg": 0.6,
    "sigma_phi_deg": 0.6,
    "sigma_kappa_deg": 0.6,
    "sigma_lever_m": [0.01, 0.01, 0.01],
}
ANTENNA = {"lever_ics_m": [0.1, -0.05, -0.45], "sigma_lever_m": [0.002, 0.002, 0.002]}


def seen_at(off_m: ArrayF) -> AntennaLever:
    """The antenna beside its nominal place by a vector of ics."""
    R = rotation_opk(0.0, -np.pi / 2, 0.0)
    x_scs = R.T @ (np.array(ANTENNA["lever_ics_m"]) + off_m - np.array(LIDAR["lever_ics_m"]))
    return AntennaLever(
        x_ccs_m=np.zeros(3),
        cov_ccs_m2=np.eye(3) * 1e-6,
        x_scs_m=x_scs,
        cov_scs_m2=np.eye(3) * 1e-6,
        by_camera_lidar=np.zeros((3, 6)),
    )


def test_a_marker_far_from_the_antenna_is_refused_with_both_places():
    check_nominal(seen_at(np.array([0.1, -0.2, 0.1])), LIDAR, ANTENNA, marker=98)
    with pytest.raises(
        GeometryError, match=r"marker 98 puts the antenna at \(\+2\.10, -0\.05, -0\.45\) m"
    ) as error:
        check_nominal(seen_at(np.array([2.0, 0.0, 0.0])), LIDAR, ANTENNA, marker=98)
    for words in (
        "2.00 m from its lever arm (+0.10, -0.05, -0.45) m",
        "antenna_position",
        "on no other sheet",
    ):
        assert words in str(error.value)


def test_a_roughly_known_place_is_no_reason_to_refuse():
    far = seen_at(np.array([0.9, 0.0, 0.0]))
    rough = LIDAR | {"sigma_lever_m": [0.3, 0.3, 0.3]}  # five sigmas are 1.5 m
    check_nominal(far, rough, ANTENNA, marker=98)
    with pytest.raises(GeometryError):
        check_nominal(far, LIDAR, ANTENNA, marker=98)
    # nothing to compare with
    check_nominal(far, LIDAR | {"lever_ics_m": [0.0, 0.0, 0.0]}, ANTENNA, marker=98)


def test_places_at_their_limits():
    """Half a metre where all is known well; else five sigmas, in the direction of the difference."""
    for off, refused in ((0.49, False), (0.51, True)):
        place = seen_at(np.array([0.0, off, 0.0]))
        if refused:
            with pytest.raises(GeometryError, match=r"at most 0\.5 m, or 5 sigmas of 0\.0\d\d m"):
                check_nominal(place, LIDAR, ANTENNA, marker=98)
        else:
            check_nominal(place, LIDAR, ANTENNA, marker=98)
    rough = LIDAR | {"sigma_lever_m": [0.3, 0.2, 0.1], "sigma_kappa_deg": 4.0}
    antenna = ANTENNA | {"sigma_lever_m": [0.05, 0.06, 0.07]}
    u = np.array([2.0, -1.0, 2.0]) / 3.0
    known = np.sum(u**2 * (np.array([0.3, 0.2, 0.1]) ** 2 + np.array([0.05, 0.06, 0.07]) ** 2)) + 1e-6
    nominal = np.array(antenna["lever_ics_m"]) - np.array(LIDAR["lever_ics_m"])
    size = 1.0
    for _ in range(50):  # the arm, about which the lidar may be turned, grows with the difference
        size = 5.0 * np.sqrt(known + (np.deg2rad(4.0) * np.linalg.norm(nominal + size * u)) ** 2)
    check_nominal(seen_at(0.995 * size * u), rough, antenna, marker=98)
    with pytest.raises(GeometryError, match=f"{1.005 * size:.2f} m from its lever arm"):
        check_nominal(seen_at(1.005 * size * u), rough, antenna, marker=98)


@pytest.mark.parametrize("shape", ["rectangle", "rhombus"])
def test_a_print_may_be_bent_by_a_twentieth(shape):
    for bent, refused in ((0.049, False), (0.051, True)):
        more, less = 1 + bent / 2, 1 - bent / 2
        if shape == "rectangle":
            saddles = SQUARE * [more, less, 1.0]
        else:
            along, across = SQUARE[0] * more, SQUARE[1] * less
            saddles = np.array([along, across, -along, -across])
        if refused:
            with pytest.raises(GeometryError, match="the saddles of the antenna's marker are"):
                phase_centre(saddles, np.eye(12), offset_m=0.0, sigma_offset_m=0.001)
        else:
            phase_centre(saddles, np.eye(12), offset_m=0.0, sigma_offset_m=0.001)
