"""Beams on a board and its edges against differences and against places written by hand."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from tests.calibration.test_board import BEAM
from thalweg.calibration import BoardSettings
from thalweg.calibration.boards import (
    BoardCalibration,
    BoardPose,
    BoardView,
    Edges,
    _difference,
    _OnBoard,
    _plane_cov,
    _select,
    _shifted,
    _State,
    _table,
    edge_rows,
    find_edges,
    meet_board,
    pose_table,
    refuse_alike,
)
from thalweg.core import Rigid, UnobservableError

FRONT = np.diag([1.0, -1.0, -1.0])
"""A board that faces the camera: x to the right, y up."""
HALF = np.array([0.4, 0.3])
AHEAD = BoardView(name="a", T_ccs_board=Rigid(R=FRONT, shift_m=np.array([0.0, 0.0, 2.0])), half_m=HALF)
TILTED = replace(
    AHEAD,
    T_ccs_board=Rigid(
        R=FRONT @ Rotation.from_euler("xyz", [25, -18, 7], degrees=True).as_matrix(),
        shift_m=np.array([0.2, -0.1, 2.2]),
    ),
)
T = Rigid(R=Rotation.from_rotvec([0.02, -0.03, 0.01]).as_matrix(), shift_m=np.array([0.05, -0.04, 0.1]))


def beams_to(places: np.ndarray) -> np.ndarray:
    return places / np.linalg.norm(places, axis=1, keepdims=True)


def test_where_beams_meet_a_board():
    """From 0.5 m right of the middle, at half the distance: places lie between, on the front alone."""
    beam = beams_to(np.array([[-0.5, 0.0, 1.0], [-0.31, 0.2, 1.0], [-0.5, -0.29, 1.0], [0.0, 0.0, -1.0]]))
    met = meet_board(AHEAD, np.array([0.5, 0.0, 1.0]), beam)
    assert met.place_m[:3] == pytest.approx(np.array([[0.0, 0.0], [0.19, -0.2], [0.0, 0.29]]))
    assert met.range_m == pytest.approx(
        [np.sqrt(1.25), *np.linalg.norm([[0.31, 0.2, 1], [0.5, 0.29, 1]], axis=1), -1]
    )
    assert met.slope == pytest.approx([*(-beam[:3, 2]), 1.0])
    assert met.inside(HALF, 0.0).tolist() == [True, True, True, False]
    assert met.inside(HALF, 0.02).tolist() == [True, True, False, False]
    behind = replace(AHEAD, T_ccs_board=Rigid(R=np.eye(3), shift_m=np.array([0.0, 0.0, 2.0])))
    assert not meet_board(behind, np.array([0.5, 0.0, 1.0]), beam).inside(HALF, 0.0).any()


def test_derivatives_of_edges():
    """Central differences by the orientation, and by offset and tilts of the plane."""
    edges = Edges(
        beam_scs=beams_to(
            np.array([[0.55, 0.0, 2.1], [-0.2, -0.1, 2.0], [0.1, 0.15, 2.2], [0.2, -0.4, 2.3]])
        ),
        side=np.array([0, 0, 1, 1]),
        sign=np.array([1.0, -1.0, -1.0, 1.0]),
        variance_m2=np.full(4, 1e-4),
    )
    past, by_T, by_plane = edge_rows(TILTED, T, edges)
    met = meet_board(TILTED, T.shift_m, edges.beam_scs @ T.R.T)
    places = met.place_m[range(4), edges.side]
    assert past == pytest.approx(edges.sign * places - [0.4, 0.4, 0.3, 0.3])
    h = 1e-6
    for k in range(6):
        d = h * np.eye(6)[k]
        more, less = (edge_rows(TILTED, T.moved(sign * d), edges)[0] for sign in (1, -1))
        assert by_T[:, k] == pytest.approx((more - less) / (2 * h), rel=1e-5, abs=1e-7)
    for k in range(3):
        d = h * np.eye(3)[k]
        # the sides move with the plane; the distance along them does not
        moved = [
            edges.sign
            * (
                met.place_m
                + (
                    (T.shift_m + each.range_m[:, None] * (edges.beam_scs @ T.R.T))
                    - (T.shift_m + met.range_m[:, None] * (edges.beam_scs @ T.R.T))
                )
                @ TILTED.T_ccs_board.R[:, :2]
            )[range(4), edges.side]
            for each in (
                meet_board(_shifted(TILTED, sign * d), T.shift_m, edges.beam_scs @ T.R.T) for sign in (1, -1)
            )
        ]
        assert by_plane[:, k] == pytest.approx((moved[0] - moved[1]) / (2 * h), rel=1e-5, abs=1e-7)


def test_planes_that_move_and_their_covariance():
    d = np.array([0.01, 0.02, -0.03])
    moved = _shifted(TILTED, d)
    assert _difference(moved, TILTED) == pytest.approx(d, abs=1e-4)
    assert (moved.T_ccs_board.shift_m - TILTED.T_ccs_board.shift_m) @ TILTED.normal == pytest.approx(0.01)
    root = np.random.default_rng(1).standard_normal((6, 6)) * 1e-3
    seen = replace(TILTED, T_ccs_board=TILTED.T_ccs_board.with_cov(root @ root.T))
    settings = BoardSettings(flatness_m=0.002, sigma_board_m=0.003)
    R, cov = TILTED.T_ccs_board.R, root @ root.T
    found = _plane_cov(seen, settings)
    assert found[0, 0] == pytest.approx(R[:, 2] @ cov[:3, :3] @ R[:, 2] + 4e-6 + 9e-6)
    # a corner 2 mm off at the end of the other side tilts the plane
    assert found[1, 1] == pytest.approx(R[:, 0] @ cov[3:, 3:] @ R[:, 0] + (0.002 / 0.3) ** 2)
    assert found[2, 2] == pytest.approx(R[:, 1] @ cov[3:, 3:] @ R[:, 1] + (0.002 / 0.4) ** 2)
    assert found[0, 2] == pytest.approx(R[:, 2] @ cov[:3, 3:] @ R[:, 1])
    assert found[1, 2] == pytest.approx(R[:, 0] @ cov[3:, 3:] @ R[:, 1])


def ring_of(across: np.ndarray, up: float, board: np.ndarray, wall: float = 4.0) -> np.ndarray:
    """Points of one ring that sees places across (n,) at a height on the plane 2 m ahead, or the wall."""
    d = beams_to(np.column_stack([across, np.full(len(across), -up), np.full(len(across), 2.0)]))
    return d * (np.where(board, 2.0, wall) / d[:, 2])[:, None]


TURN = Rigid(R=np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]), shift_m=np.zeros(3))
"""Of a scanner whose x axis is the camera's line of sight, so that azimuths do not jump."""


def edges_of(*rings: np.ndarray) -> Edges:
    points = np.concatenate(rings) @ TURN.R
    number = np.repeat(np.arange(len(rings)), [len(r) for r in rings])
    order = np.random.default_rng(2).permutation(len(points))
    return find_edges(AHEAD, TURN, points[order], number[order], np.full(len(points), 4e-6)[order])


def test_edges_lie_midway_between_the_last_beam_on_and_the_first_one_past():
    """Beams each 2 cm: last on at 0.39 m, past at 0.41 m to the right and at -0.43 m to the left."""
    across = np.arange(-0.53, 0.54, 0.02)
    on = (across > -0.42) & (across < 0.40)
    found = edges_of(ring_of(across, 0.1, on))
    assert found.side.tolist() == [0, 0]
    places = meet_board(AHEAD, np.zeros(3), found.beam_scs @ TURN.R.T).place_m
    order = np.argsort(places[:, 0])
    assert places[order] == pytest.approx(np.array([[-0.42, 0.1], [0.40, 0.1]]), abs=1e-4)
    assert found.sign[order].tolist() == [-1.0, 1.0]
    assert found.variance_m2 == pytest.approx(0.02**2 / 12 + 4e-6 + 9e-6)
    past = edge_rows(AHEAD, TURN, found)[0]
    assert past[order] == pytest.approx([0.02, 0.0], abs=1e-4)


@pytest.mark.parametrize(
    ("across", "up", "last", "wall", "found"),
    [
        (np.arange(0.31, 0.5, 0.02), 0.25, 0.4, 4.0, 1),
        (np.arange(0.31, 0.5, 0.02), 0.27, 0.4, 4.0, 0),  # nearer to a corner than 4 cm
        (np.arange(0.31, 0.7, 0.02), 0.1, 0.45, 4.0, 1),
        (np.arange(0.31, 0.7, 0.02), 0.1, 0.47, 4.0, 0),  # 6 cm from where the edge must be
        (np.arange(0.31, 0.5, 0.02), 0.1, 0.4, 2.16, 1),
        (np.arange(0.31, 0.5, 0.02), 0.1, 0.4, 2.14, 0),  # what is behind is nearer than 15 cm
        (np.array([0.375, 0.405, 0.43]), 0.1, 0.4, 4.0, 1),
        (np.array([0.38, 0.42]), 0.1, 0.4, 4.0, 0),  # beams 1.1 degrees apart
    ],
)
def test_which_edges_count(across, up, last, wall, found):
    assert len(edges_of(ring_of(across, up, across < last, wall)).side) == found


def test_edges_across_the_rows_and_along_the_ring():
    """A ring that rises steeply leaves at the upper side; one that hardly does runs along it."""
    for steep, found in ((1.0, 1), (0.4, 0)):
        along = np.arange(-0.1, 0.1, 0.01)
        up = 0.3 + steep * along
        d = beams_to(np.column_stack([along, -up, np.full(len(along), 2.0)]))
        points = d * (np.where(up < 0.3, 2.0, 4.0) / d[:, 2])[:, None]
        edges = edges_of(points)
        assert edges.side.tolist() == [1] * found
        assert edges.sign.tolist() == [1.0] * found


def test_points_of_a_scan_that_count():
    """Margin, incidence, distance from the plane: each on both sides of its limit."""
    settings = BoardSettings(margin_m=0.05, reject_sigmas=3.0, max_incidence_deg=60.0)
    pose = BoardPose(view=AHEAD, points_scs_m=np.array([[0.34, 0.0, 2.0], [0.36, 0.0, 2.0]]))
    state = _State(T=Rigid(), views=(AHEAD,))
    found = _select(state, 0, pose, BEAM, settings, 0.0, 1.0)
    assert found.reach_m == pytest.approx([np.hypot(0.34, 2.0)])
    assert (found.rejected, len(found.edges.side)) == (0, 0)
    # 17.3 mm along and across: the same whatever the angle, of the component along the normal
    cos = 2.0 / np.hypot(0.34, 2.0)
    assert found.variance_m2 == pytest.approx(0.0173**2 * (1 + (1 - cos**2) / cos**2))
    assert _select(state, 0, pose, BEAM, settings, 0.0, 4.0).variance_m2 == pytest.approx(
        4 * found.variance_m2
    )
    # six points on the plane, one 3.1 and one 2.9 sigmas off it; 2 cm of slack let both in
    x = np.arange(-0.2, 0.2, 0.05)
    z = 2.0 + np.array([0, 0, 0, 0, 0, 0, 3.1, 2.9]) * 0.0173
    pose = BoardPose(view=AHEAD, points_scs_m=np.column_stack([x, 0 * x, z]))
    found = _select(state, 0, pose, BEAM, settings, 0.0, 1.0)
    assert (len(found.reach_m), found.rejected) == (7, 1)
    assert _select(state, 0, pose, BEAM, settings, 0.02, 1.0).rejected == 0
    # what all share is no reason: 4.5 cm; 5.5 cm are
    for off, left in ((0.045, 7), (0.055, 0)):
        of = replace(pose, points_scs_m=np.column_stack([x, 0 * x, z + off]))
        assert len(_select(state, 0, of, BEAM, settings, 0.0, 1.0).reach_m) == left
    for angle, left in ((59.0, 1), (61.0, 0)):
        turned = replace(
            AHEAD,
            T_ccs_board=Rigid(
                R=FRONT @ Rotation.from_euler("y", angle, degrees=True).as_matrix(),
                shift_m=np.array([0.0, 0.0, 2.0]),
            ),
        )
        one = BoardPose(view=turned, points_scs_m=np.array([[0.0, 0.0, 2.0]]))
        of = _State(T=Rigid(), views=(turned,))
        assert len(_select(of, 0, one, BEAM, settings, 0.0, 1.0).reach_m) == left


def test_the_table_of_poses():
    """Of points 4 and -2 mm off a plane 2 m away in slanting beams; another pose has none."""
    beam = beams_to(np.array([[0.3, 0.2, 2.0], [-0.1, 0.1, 2.0]]))
    reach = (2.0 + np.array([0.004, -0.002])) / beam[:, 2]
    edges = Edges(beam_scs=beam[:1], side=np.zeros(1, np.int64), sign=np.ones(1), variance_m2=np.ones(1))
    some = _OnBoard(reach_m=reach, beam_scs=beam, variance_m2=np.ones(2), rejected=3, edges=edges)
    none = replace(some, reach_m=reach[:0], beam_scs=beam[:0], rejected=0, edges=Edges.none())
    views = [replace(AHEAD, rms_px=0.2), replace(TILTED, name="b")]
    poses = [BoardPose(view=v, points_scs_m=np.zeros((0, 3))) for v in views]
    found = _table(
        poses, [some, none], [0], _State(T=Rigid(), views=tuple(views)), BoardSettings(least_points=2)
    )
    first, second = found.to_dict("records")
    assert first == {
        "pose": "a",
        "points": 2,
        "rejected": 3,
        "edges": 1,
        "mean_mm": pytest.approx(1.0),
        "rms_mm": pytest.approx(np.sqrt(10.0)),
        "distance_m": 2.0,
        "rms_px": 0.2,
        "used": True,
        "reason": "",
    }
    assert (second["points"], second["used"]) == (0, False)
    assert np.isnan([second["mean_mm"], second["rms_mm"]]).all()
    assert second["distance_m"] == pytest.approx(np.linalg.norm([0.2, -0.1, 2.2]))
    assert second["reason"] == "0 points on the board, at least 2 are needed"
    lost = pd.DataFrame([{"pose": "c", "used": False, "reason": "no board"}])
    result = BoardCalibration(
        T_ccs_scs=Rigid(), adjusted=None, lidar_factor=1.0, board_factor=1.0, table=found, score=1.0
    )
    assert pose_table(result, lost)["pose"].tolist() == ["a", "b", "c"]
    assert pose_table(result, lost[:0]) is found


def test_normals_that_spread_just_enough():
    """Tilted by a each way about x and y: along x normals spread by the root of the mean square of sines."""

    def views(tilt_deg: float) -> list[BoardView]:
        turns = [("x", tilt_deg), ("x", -tilt_deg), ("y", 30.0), ("y", -30.0)]
        return [
            replace(
                AHEAD, T_ccs_board=Rigid(R=FRONT @ Rotation.from_euler(axis, a, degrees=True).as_matrix())
            )
            for axis, a in turns
        ]

    # two of four: the sine of the spread is that of the tilt over the root of two
    tilt = np.rad2deg(np.arcsin(np.sqrt(2) * np.sin(np.deg2rad(5.0))))
    refuse_alike(views(tilt + 0.1), 5.0)
    with pytest.raises(UnobservableError, match=r"shift along \(0\.00, -?1\.00, -?0\.00\)|4\.9 deg") as told:
        refuse_alike(views(tilt - 0.1), 5.0)
    text = str(told.value)
    assert "The normals of 4 poses spread by only 4.9 deg in this direction" in text
    assert "about the axis (1.00, 0.00, 0.00)" in text.replace("-", "")
    with pytest.raises(UnobservableError, match=r"with 2 of 7 poses of the board \(a, a\)"):
        refuse_alike(views(20.0)[:2], 5.0, asked=7)
    with pytest.raises(UnobservableError, match=r"with 0 poses of the board \(none\)"):
        refuse_alike([], 5.0)
