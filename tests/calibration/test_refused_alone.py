"""Each condition of a refusal alone refuses: one thing is wrong, all others are as they should be."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from thalweg.calibration.cones import Cone, ConeReference
from thalweg.calibration.ins_lidar.antenna import phase_centre
from thalweg.calibration.ins_lidar.pose_errors import PoseErrors
from thalweg.calibration.marker_sheets import MarkerLayout
from thalweg.clocks.track import Track
from thalweg.core import ErrorChain, GeometryError, InputError
from thalweg.core.calibration import Block, Calibration, Source
from thalweg.images.model import ControlPoints
from thalweg.images.model.files import check_share

UP = np.array([0.0, 0.0, 1.0])
CONE = Cone(apex_m=np.zeros(3), axis=UP, half_angle_rad=0.3)
SQUARE = np.array([[0.0, 0.1, 0.0], [0.1, 0.1, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
BLOCK = Block(name="a", quantities=("x_m", "y_m"), values=np.array([1.0, 2.0]), equation="x = y")
SKEWED = np.array([[1.0, 0.1], [0.2, 1.0]])

GOOD: dict[Callable[..., Any], dict[str, Any]] = {
    Cone: {"apex_m": np.zeros(3), "axis": UP, "half_angle_rad": 0.3},
    ConeReference: {
        "name": "c", "points_m": np.ones((5, 3)), "cov": np.zeros((15, 15)), "half_angle_rad": 0.3,
        "length_m": 0.5, "labels": tuple("abcde"),
    },
    MarkerLayout: {"dictionary": "DICT_4X4_50", "module_m": 0.012, "sizes": ((0, 3, 0.02),)},
    phase_centre: {
        "saddles_pcs_m": SQUARE, "cov_m2": 1e-8 * np.eye(12), "offset_m": 0.1, "sigma_offset_m": 0.001
    },
    PoseErrors: {
        "sigma_position_m": np.ones(3), "sigma_attitude_rad": np.ones(3), "position_time_s": 10.0,
        "attitude_time_s": 20.0, "white_share": 0.25, "epoch_s": 0.1, "knot_s": 1.0, "heading_time_s": 30.0,
    },
    Track: {
        "t_gps_s": np.arange(50.0), "position_m": np.zeros((50, 3)), "cov_m2": np.tile(np.eye(3), (50, 1, 1)),
        "correlation_time_s": 10.0, "white_share": 0.25,
    },
    ErrorChain: {
        "name": "a", "t_gps_s": np.arange(3.0), "root": np.zeros((3, 6, 2)), "link": np.zeros((3, 2, 2))
    },
    Block: {"name": "a", "quantities": ("x_m", "y_m"), "values": np.array([1.0, 2.0]), "equation": "x = y"},
    Calibration: {
        "title": "boat", "blocks": (BLOCK,), "cov": np.eye(2), "source": Source(run="yard", method="ruler")
    },
    ControlPoints: {
        "names": ("A", "B"), "points_wcs_m": np.zeros((2, 3)), "cov_wcs_m2": np.tile(np.eye(3), (2, 1, 1)),
        "check": np.zeros(2, bool),
    },
    check_share: {
        "found": np.array([0, 1, -1, -1]), "names": list("abcd"), "images": list("ab"), "least_share": 0.5,
        "where": "poses.txt",
    },
}  # fmt: skip
TIMES = ("position_time_s", "attitude_time_s", "heading_time_s", "epoch_s", "knot_s")
WRONG: list[tuple[Callable[..., Any], dict[str, Any]]] = [
    *((Cone, each) for each in (
        {"apex_m": np.zeros(2)}, {"apex_m": np.array([0, np.nan, 0])}, {"axis": np.zeros(3)},
        {"axis": np.ones(2)}, {"axis": np.array([0, 0, np.inf])}, {"half_angle_rad": 0.0},
        {"half_angle_rad": np.pi / 2},
    )),
    *((ConeReference, each) for each in (
        {"points_m": np.full((5, 3), np.nan)}, {"cov": np.full((15, 15), np.inf)},
    )),
    *((MarkerLayout, each) for each in (
        {"dictionary": "DICT_4X4_51"}, {"dictionary": "DICT_5X5_50"}, {"dictionary": "CORNER_REFINE_SUBPIX"},
        {"module_m": 0.0}, {"module_m": 1.0}, {"sizes": ((0, 3, 0.02), (4, 5, -0.1))},
    )),
    *((phase_centre, each) for each in (
        {"saddles_pcs_m": SQUARE * [1.1, 1.0, 1.0]},
        {"saddles_pcs_m": SQUARE[[0, 1, 3, 2]]},
    )),
    *((PoseErrors, {name: value}) for name in TIMES for value in (0.0, -1.0, np.inf)),
    *((PoseErrors, each) for each in (
        {"white_share": -0.01}, {"white_share": 1.0}, {"sigma_position_m": np.ones(2)},
        {"sigma_position_m": np.array([1, 0, 1])}, {"sigma_attitude_rad": np.array([1, 1, np.inf])},
    )),
    *((Track, each) for each in (
        {"t_gps_s": np.arange(2.0), "position_m": np.zeros((2, 3)), "cov_m2": np.zeros((2, 3, 3))},
        {"position_m": np.zeros((49, 3))}, {"cov_m2": np.zeros((50, 3))}, {"white_share": -0.1},
        {"white_share": 1.1}, {"correlation_time_s": 0.0},
        {"t_gps_s": np.r_[np.arange(49.0), 48.0]}, {"t_gps_s": np.r_[1.0, 0.0, np.arange(2.0, 50.0)]},
    )),
    *((ErrorChain, each) for each in (
        {"root": np.zeros((3, 5, 2))}, {"link": np.zeros((3, 2, 3))}, {"t_gps_s": np.array([0.0, 2.0, 1.0])},
        {"t_gps_s": np.zeros(0), "root": np.zeros((0, 6, 2)), "link": np.zeros((0, 2, 2))},
    )),
    *((Block, each) for each in (
        {"quantities": ("x_m", "x_m")}, {"equation": " "}, {"values": np.ones(3)},
        {"values": np.array([1.0, np.nan])}, {"quantities": (), "values": np.zeros(0)},
    )),
    *((Calibration, each) for each in (
        {"blocks": ()}, {"blocks": (BLOCK, BLOCK), "cov": np.eye(4)}, {"cov": np.eye(3)},
        {"cov": np.diag([1.0, np.nan])}, {"cov": SKEWED}, {"cov": np.diag([1.0, -1e-3])},
        {"cov": np.array([[1.0, 2.0], [2.0, 1.0]])},
    )),
    *((ControlPoints, each) for each in (
        {"names": ("A", "A")}, {"points_wcs_m": np.zeros((3, 3))}, {"cov_wcs_m2": np.zeros((2, 3))},
        {"check": np.zeros(3, bool)}, {"cov_wcs_m2": np.stack([np.eye(3), np.diag([1.0, 0.0, 1.0])])},
        {"cov_wcs_m2": np.stack([np.eye(3), np.full((3, 3), np.nan)])},
    )),
    *((check_share, each) for each in (
        {"least_share": 0.51}, {"found": np.full(4, -1), "least_share": 0.0},
        {"found": np.array([0, -1, -1, -1])},
    )),
]  # fmt: skip


@pytest.mark.parametrize("make", GOOD, ids=lambda make: make.__qualname__)
def test_what_is_right_is_taken(make):
    made = make(**GOOD[make])
    if not isinstance(make, type):  # a check gives nothing back, a maker what it makes
        assert (made is None) == (make.__name__ in ("check_share",))
    for name, value in GOOD[make].items() if isinstance(make, type) else ():
        np.testing.assert_array_equal(getattr(made, name), value, err_msg=name)


@pytest.mark.parametrize(
    ("make", "wrong"), WRONG, ids=[f"{make.__qualname__}-{'-'.join(wrong)}" for make, wrong in WRONG]
)
def test_one_wrong_thing_is_enough(make, wrong):
    with pytest.raises((GeometryError, InputError)):
        make(**(GOOD.get(make, {}) | wrong))
