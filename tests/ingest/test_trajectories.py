"""Trajectories of other programs: conventions by hand, what is not stated is asked for."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.ingest.writers import noted
from thalweg.core import InputError, LocalFrame, gps_from_unix, gps_from_week, rotation_enu_body
from thalweg.ingest import PoseLog, TrackOptions
from thalweg.ingest.registry import describe, read_poses, recognise
from thalweg.ingest.registry.poses import POSES
from thalweg.ingest.tracks import read_text_poses
from thalweg.ingest.tracks.trajectories import BODY_AXES

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
STATED = {"frame": FRAME, "time_scale": "utc", "sigma_position_m": 0.05, "sigma_attitude_deg": 0.2}
T0 = 1_700_000_000
NOSE_UP, RIGHT_DOWN, HEADING = np.deg2rad([3.0, -2.0, 70.0])


def write(kind: str, path: Path, body_axes: str) -> Path:
    """Three poses along the course; rotation of the body with these axes, written out by hand."""
    R = rotation_enu_body(RIGHT_DOWN, NOSE_UP, HEADING) @ BODY_AXES[body_axes].T
    w = 0.5 * np.sqrt(1.0 + np.trace(R))
    x, y, z = (R[2, 1] - R[1, 2]) / 4 / w, (R[0, 2] - R[2, 0]) / 4 / w, (R[1, 0] - R[0, 1]) / 4 / w
    lines = []
    for k in range(3):
        p = [10.0 * k, 5.0, -1.0]
        row = {
            "tum": [T0 + 0.1 * k, *p, x, y, z, w],
            "euroc": [*p, w, x, y, z, 1.0, 2.0, 3.0, 0, 0, 0, 0, 0, 0],
            "kitti": np.column_stack([R, p]).ravel().tolist(),
        }[kind]
        cells = [repr(float(v)) for v in row]
        cells = [str((T0 * 10 + k) * 10**8), *cells] if kind == "euroc" else cells
        lines.append((", " if kind == "euroc" else " ").join(cells))
    head = "#timestamp, p_RS_R_x [m], ...\n" if kind == "euroc" else ""
    path.write_text(head + "\n".join(lines) + "\n")
    return path


def reader_of(kind: str):
    return next(row.poses for row in POSES if row.kind == kind)


@pytest.mark.parametrize("body_axes", BODY_AXES)
@pytest.mark.parametrize("kind", ["tum", "euroc", "kitti"])
def test_poses_on_earth(tmp_path, saved, kind, body_axes):
    path = write(kind, tmp_path / "poses", body_axes)
    assert recognise(path) == kind
    times = saved("times.txt", "\n".join(str(T0 + 0.1 * k) for k in range(3)))
    options = TrackOptions(**STATED, body_axes=body_axes, times=times if kind == "kitti" else None)
    log = reader_of(kind)([path], options)
    s = log.states
    # float64 of a Unix time of 1.7e9 s
    assert_allclose(s["t_gps_s"], gps_from_unix(T0 + 0.1 * np.arange(3)), atol=5e-7)
    east_north_up = FRAME.from_geodetic(s["lat_deg"], s["lon_deg"], s["h_ell_m"])
    assert_allclose(east_north_up, [[0, 5, -1], [10, 5, -1], [20, 5, -1]], atol=1e-6)
    # the local level turns by 3e-6 rad within 20 m
    for name, angle in (("roll", RIGHT_DOWN), ("pitch", NOSE_UP), ("heading", HEADING)):
        assert_allclose(s[f"{name}_rad"], angle, atol=1e-5)
        assert_allclose(s[f"sigma_{name}_rad"], np.deg2rad(0.2))
    if kind == "euroc":
        assert_allclose(s[["v_east_mps", "v_north_mps", "v_down_mps"]], [[1, 2, -3]] * 3, atol=1e-4)
    else:
        assert s["v_north_mps"].isna().all()
    assert log.report.counts == {"poses": 3}
    assert log.report.synchronised


@pytest.mark.parametrize("kind", ["tum", "euroc", "kitti"])
def test_what_a_table_does_not_hold_is_asked_for(tmp_path, kind):
    path = write(kind, tmp_path / "poses", "forward-left-up")
    with pytest.raises(
        InputError, match="frame, body_axes, time_scale, sigma_position_m, sigma_attitude_deg"
    ):
        reader_of(kind)([path], TrackOptions())
    report = describe(path)
    assert not report.synchronised
    assert report.counts["poses"] == 3
    assert noted(report, "asks for them")
    if kind == "kitti":
        with pytest.raises(InputError, match="times"):
            reader_of(kind)([path], TrackOptions(**STATED, body_axes="forward-left-up"))


@pytest.mark.parametrize(
    ("kind", "text", "told"),
    [
        ("tum", "1.0 0 0 0 0 0 0 2\n", "the rotation is none"),
        ("kitti", "1 0 0 0 0 1 0 0 0 0 -1 0\n", "the rotation is none"),
        ("tum", "1.0 0 0 0 0 0 0 1\n1.1 0 0 x 0 0 0 1\n", "line 2"),
        ("tum", "1.0 0 0 0 0 0 0 1\n1.1 0 0 nan 0 0 0 1\n", "line 2"),
        ("euroc", "1,0,0,0,1,0,0\n", "line 1"),
        ("tum", "# nothing\n", "no poses"),
    ],
)
def test_damaged_tables_are_refused(saved, kind, text, told):
    path = saved("poses", text)
    with pytest.raises(InputError, match=told):
        read_text_poses(kind, [path])


HEADER = """Project:     Elbe
Program:     Inertial Explorer Version 8.90

 Week   GPSTime    Latitude   Longitude    H-Ell  VEast VNorth   VUp   Roll  Pitch Heading{more}
(weeks)   (sec)       (deg)       (deg)      (m)  (m/s)  (m/s) (m/s)  (deg)  (deg)   (deg){units}
"""
SIGMAS_STATED = {"sigma_position_m": 0.1, "sigma_attitude_deg": 0.5}
SIGMAS = ("  SDEast SDNorth SDHeight  RollSD PitchSD  HdngSD", "   (m) (m) (m) (arcmin) (arcmin) (arcmin)")
ROW = "2235 300000.{k}00 51.0500000{k} 13.25000000 120.500 0.1 0.2 0.3 1.0 -2.0 359.5"


def export(path: Path, *, sigmas: bool = True, header: str = HEADER) -> Path:
    more, units = SIGMAS if sigmas else ("", "")
    rows = "\n".join(ROW.format(k=k) + (" 0.01 0.02 0.03 1.2 1.8 6.0" if sigmas else "") for k in range(4))
    path.write_text(header.format(more=more, units=units) + rows + "\n")
    return path


def read(path: Path, **options: Any) -> PoseLog:
    """An export of Inertial Explorer."""
    return read_poses([path], "sbet", TrackOptions(**options))


def test_inertial_explorer_by_its_header(tmp_path):
    path = export(tmp_path / "boat.txt")
    assert recognise(path) == "inertial_explorer"
    s = read(path).states
    assert_allclose(s["t_gps_s"], gps_from_week(2235, 300_000 + 0.1 * np.arange(4)), atol=1e-6)
    assert_allclose(s["lat_deg"], 51.05 + 1e-8 * np.arange(4), atol=1e-12)
    first = s.iloc[0]
    assert first["v_down_mps"] == -0.3
    angles = first[["roll_rad", "pitch_rad", "heading_rad", "sigma_heading_rad"]].astype(float)
    assert np.rad2deg(angles).tolist() == pytest.approx([1.0, -2.0, 359.5, 0.1])  # 6 arc minutes
    assert first[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].tolist() == [0.01, 0.02, 0.03]
    assert describe(path).counts["poses"] == 4


def test_inertial_explorer_in_degrees_minutes_seconds(tmp_path):
    header = HEADER.replace("(deg)", "(+/-D M S)", 2)
    path = tmp_path / "dms.txt"
    row = "2235 300000.0 -0 30 36.0 13 15 00.0 120.5 0.1 0.2 0.3 1.0 -2.0 359.5 0.01 0.02 0.03 1.2 1.8 6.0"
    path.write_text(header.format(more=SIGMAS[0], units=SIGMAS[1]) + row + "\n")
    first = read(path).states.iloc[0]
    assert (first["lat_deg"], first["lon_deg"]) == pytest.approx((-0.51, 13.25))


def test_inertial_explorer_without_sigmas_units_or_columns(tmp_path):
    path = export(tmp_path / "bare.txt", sigmas=False)
    bare = read(path)
    assert bare.states[["sigma_up_m", "sigma_roll_rad"]].isna().all(axis=None)
    assert noted(bare, "SDEast, SDNorth, SDHeight")
    assert (read(path, **SIGMAS_STATED).states["sigma_up_m"] == 0.1).all()
    path.write_text(path.read_text().replace(" H-Ell", " H-MSL"))
    with pytest.raises(InputError, match="no column H-Ell"):
        read(path, **SIGMAS_STATED)


AERIAL = """Program:     Inertial Explorer Version 8.30
 CorrTime   Date    Latitude   Longitude  H-Ell  Heading HdngSep HdngSD  Pitch PtchSD {more}
    (sec)  {form}       {dms}       {dms}    (m)   (Deg)   (Deg)  (Deg)  (Deg)  (Deg) {units}
295218.00  {day}   51 03 10.0  -13 45 05.0   155.0   51.23   359.97   0.02   -1.5   0.005 0.25 0.004 0.05
"""
PARTS = {"more": "Roll RollSD SDHoriz", "units": "(Deg) (Deg) (m)"}


@pytest.mark.parametrize("dms", ["(+/-D M S)", "(+/-D) (M) (S)"])
@pytest.mark.parametrize(
    ("form", "day"), [("(MDY)", "6/12/2024"), ("(d/m/y)", "12/06/2024"), ("(YMD)", "2024-06-12")]
)
def test_inertial_explorer_by_date_and_other_names(saved, dms, form, day):
    path = saved("aerial.txt", AERIAL.format(dms=dms, form=form, day=day, **PARTS))
    assert recognise(path) == "inertial_explorer"
    first = read(path).states.iloc[0]
    assert first["t_gps_s"] == gps_from_week(2318, 295_218.0)
    place = (51 + 3 / 60 + 10 / 3600, -(13 + 45 / 60 + 5 / 3600))
    assert (first["lat_deg"], first["lon_deg"]) == pytest.approx(place)
    angles = [f"{kind}{name}_rad" for kind in ("", "sigma_") for name in ("heading", "pitch", "roll")]
    found = np.rad2deg(first[angles].astype(float)).tolist()
    assert found == pytest.approx([51.23, -1.5, 0.25, 0.02, 0.005, 0.004])
    assert first["sigma_east_m"] == pytest.approx(0.05 / np.sqrt(2))
    assert np.isnan(first["sigma_up_m"])


def test_inertial_explorer_with_a_date_of_another_day_or_none(saved):
    path = saved("aerial.txt", AERIAL.format(dms="(D M S)", form="(MDY)", day="6/15/2024", **PARTS))
    with pytest.raises(InputError, match="second 295,218 of the week on 2024-06-15, a Saturday"):
        read(path)
    path.write_text(path.read_text().replace(" Date ", " Day ").replace("6/15/2024", "0"))
    with pytest.raises(InputError, match="no column Week or Date"):
        read(path)
    report = describe(path)
    assert (report.synchronised, report.t_first_s) == (False, 295_218.0)
    assert noted(report, "neither week nor date")
    assert not noted(report, "1980")


UPRIGHT = [0.0, 0.0, np.sin(0.3), np.cos(0.3)]
"""A level body, x y z w; with w first it would be upside down."""
LEVEL = [0, 0, 0, 0, 0, 0, 1]
FORWARD = TrackOptions(**STATED, body_axes="forward-left-up")


def poses(
    folder: Path,
    cells: list[Any],
    head: str = "#",
    separator: str = " ",
    first: int = T0,
    per_second: int = 1,
) -> Path:
    """Four poses of these cells behind their time, one a second."""
    path = folder / "poses.txt"
    rows = ([(first + k) * per_second, *cells] for k in range(4))
    path.write_text("\n".join([head, *(separator.join(map(str, row)) for row in rows)]) + "\n")
    return path


@pytest.mark.parametrize(
    ("head", "order"),
    [
        ("# timestamp tx ty tz qw qx qy qz", "wxyz"),
        ("timestamp,x,y,z,qw,qx,qy,qz", "wxyz"),
        ("timestamp,x,y,z,q[0],q[1],q[2],q[3]", "wxyz"),
        ("#time [s], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_x, q_y, q_z, q_w", "xyzw"),
        ("# stamp, position, quaternion (w, x, y, z)", "wxyz"),
        ("# poses of the boat", "xyzw"),
        ("# time [ms] q_w [] q_x [] q_y [] q_z [] p_x [m] p_y [m] p_z [m]", "wxyz first"),
    ],
)
def test_names_decide_the_order_of_the_quaternion(tmp_path, head, order):
    cells = [UPRIGHT["xyzw".index(axis)] for axis in order[:4]]
    row = [*cells, 1, 2, 3] if order[4:] else [1, 2, 3, *cells]
    path = poses(tmp_path, row, head, ", " if head.startswith(("timestamp,", "#time")) else " ")
    assert recognise(path) == "tum"
    states = read_poses([path], "ins", FORWARD).states
    assert_allclose(states["roll_rad"], 0.0, atol=1e-5)
    assert_allclose(states["heading_rad"], np.pi / 2 - 0.6, atol=1e-5)


def test_a_boat_upside_down_is_refused_unless_it_is_stated(tmp_path):
    path = poses(tmp_path, [0, 0, 0, UPRIGHT[3], *UPRIGHT[:3]])
    with pytest.raises(InputError, match=r"upside down in 100% of 4 poses.*order of the quaternion"):
        read_poses([path], "ins", FORWARD)
    assert len(read_poses([path], "ins", replace(FORWARD, upside_down=True)).states) == 4


def test_times_of_a_table_of_poses_contradict_the_stated_scale(tmp_path):
    options = replace(FORWARD, time_scale="gps")
    with pytest.raises(InputError, match=r"1718186400 is 2024-06-12 in seconds since 1970"):
        read_poses([poses(tmp_path, LEVEL, first=1_718_186_400)], "ins", options)
    log = read_poses([poses(tmp_path, LEVEL, first=402_221_618)], "ins", options)
    assert log.states["t_gps_s"][0] == 402_221_618.0
    assert noted(log, "less 1e9")


@pytest.mark.parametrize(("per_second", "separator"), [(10**3, " "), (10**9, " "), (10**3, ",")])
def test_stamps_of_poses_in_other_units(tmp_path, per_second, separator):
    head = "# timestamp x y z qx qy qz qw"
    path = poses(tmp_path, LEVEL, head, separator, 1_718_186_400, per_second)
    log = read_poses([path], "ins", FORWARD)
    assert log.states["t_gps_s"].tolist() == [402_221_618.0 + k for k in range(4)]
    assert noted(log, "seconds since 1970")


def test_a_week_counter_that_rolled_over_is_doubted(tmp_path):
    path = export(tmp_path / "boat.txt")
    path.write_text(path.read_text().replace("2235 ", "187 "))
    assert noted(read(path), "2048 weeks later 2022-11-")


def test_inertial_explorer_with_a_time_of_the_day(tmp_path):
    path = tmp_path / "export.txt"
    head = "GPSTime Date Lat Lon H-Ell Roll Pitch Heading\n(HMS) (DMY) (deg) (deg) (m) (deg) (deg) (deg)\n"
    row = "10:00:18.25 12/06/2024 51.05 13.75 155.0 1.0 2.0 3.0\n"
    path.write_text(head + row)
    states = read(path, **SIGMAS_STATED).states
    assert states["t_gps_s"].iloc[0] == gps_from_week(2318, 295_218.25)
    head, row = head.replace("Date", "Week").replace("(DMY)", "(weeks)"), row.replace("12/06/2024", "2318")
    path.write_text(head + row)
    with pytest.raises(InputError, match="times of the day without a date"):
        read(path, **SIGMAS_STATED)


@pytest.mark.parametrize(
    ("usual", "stated", "words"),
    [
        ("(sec)", "(UTC)", r"times in 'UTC'"),
        ("(m/s)  (m/s) (m/s)", "(mph)  (mph) (mph)", "unit 'mph'"),
        ("      (m)  ", "     (mm)  ", "unit 'mm' of H-Ell"),
        ("(deg){units}", "(gon){units}", "unit 'gon' of Heading"),
    ],
)
def test_inertial_explorer_in_other_units_is_refused(tmp_path, usual, stated, words):
    with pytest.raises(InputError, match=words):
        read(export(tmp_path / "a.txt", header=HEADER.replace(usual, stated)))


@pytest.mark.parametrize(
    ("line", "quoted"),
    [
        ("Datum:       NAD83(2011)", True),
        ("Datum:       WGS84, (processing datum)", False),
        ("Time:        UTC seconds of the week", True),
        ("UTC Offset:  18 s", False),
        ("Standard deviations: 95 %", True),
    ],
)
def test_headers_of_inertial_explorer_are_quoted(tmp_path, line, quoted):
    header = HEADER.replace("Project:     Elbe", line)
    log = read(export(tmp_path / "a.txt", header=header))
    assert any(line in note for note in log.report.notes) == quoted


def test_yaw_and_zeros_of_inertial_explorer_are_told(tmp_path):
    path = export(tmp_path / "a.txt", header=HEADER.replace("Heading", "    Yaw"))
    path.write_text(path.read_text().replace("0.01 0.02 0.03", "0.00 0.00 0.00"))
    log = read(path)
    assert log.states["sigma_east_m"].isna().all()
    assert noted(log, "own yaw counts counterclockwise")
    assert noted(log, "no standard deviations of positions")


@pytest.mark.parametrize(
    ("head", "place", "words"),
    [
        ("# time lat lon alt qx qy qz qw", "51.05 13.75 150", "latitudes and longitudes"),
        ("# time p_SR_R_x p_SR_R_y p_SR_R_z q_SR_x q_SR_y q_SR_z q_SR_w", "1 2 3", "world in the body"),
        ("# t x y z roll pitch yaw sigma", "1 2 3", "angles instead of a quaternion"),
        ("# time tx[mm] ty[mm] tz[mm] qx qy qz qw", "1 2 3", "another unit than metres"),
        ("# time x y z qx qy qz qw", "412000 5656000 155", "5,656 km from the origin"),
    ],
)
def test_places_and_poses_of_other_kinds_are_refused(tmp_path, head, place, words):
    with pytest.raises(InputError, match=words):
        read_poses([poses(tmp_path, [place, *UPRIGHT], head)], "ins", FORWARD)


@pytest.mark.parametrize(
    ("remark", "quoted"), [("# T_body_world", True), ("# frame odom", True), ("# t_x t_y", False)]
)
def test_remarks_on_frames_are_quoted(tmp_path, remark, quoted):
    assert noted(describe(poses(tmp_path, [1, 2, 3, *UPRIGHT], remark)), remark) == quoted


def test_a_world_of_a_camera_is_refused(tmp_path):
    """Odometry of KITTI: z forward, y down; a boat that starts unturned would stand on its stern."""
    path, times = tmp_path / "poses.txt", tmp_path / "times.txt"
    path.write_text("".join(f"1 0 0 0 0 1 0 0 0 0 1 {k}\n" for k in range(4)))
    times.write_text("".join(f"{T0 + k}\n" for k in range(4)))
    options = TrackOptions(**STATED, body_axes="right-down-forward", times=times)
    with pytest.raises(InputError, match="bow points up or down by 90 deg"):
        read_poses([path], None, options)


@pytest.mark.real
def test_poses_of_a_real_lidar(data_dir):
    path = data_dir / "ouster_sdk_samples/OS-1-128_v2.3.0_1024x10_lb_n3_poses_kitti.txt"
    assert recognise(path) == "kitti"
    poses = read_text_poses("kitti", [path])
    assert_allclose(poses.position_m[:, 0], [0.0, 0.2454105, 0.4978255], atol=1e-7)
