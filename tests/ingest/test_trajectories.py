"""Trajectories of other programs: conventions by hand, what is not stated is asked for."""

from pathlib import Path

import numpy as np
import pytest

from thalweg.core import InputError, LocalFrame, gps_from_unix, gps_from_week, rotation_enu_body
from thalweg.ingest import TrackOptions
from thalweg.ingest.registry import describe, read_poses, recognise
from thalweg.ingest.registry.poses import POSES
from thalweg.ingest.tracks import read_gpx, read_text_poses
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
def test_poses_on_earth(tmp_path: Path, kind: str, body_axes: str) -> None:
    path = write(kind, tmp_path / "poses", body_axes)
    assert recognise(path) == kind
    times = tmp_path / "times.txt"
    times.write_text("\n".join(str(T0 + 0.1 * k) for k in range(3)))
    options = TrackOptions(**STATED, body_axes=body_axes, times=times if kind == "kitti" else None)
    log = reader_of(kind)([path], options)
    s = log.states
    # float64 of a Unix time of 1.7e9 s
    np.testing.assert_allclose(s["t_gps_s"], gps_from_unix(T0 + 0.1 * np.arange(3)), atol=5e-7)
    east_north_up = FRAME.from_geodetic(s["lat_deg"], s["lon_deg"], s["h_ell_m"])
    np.testing.assert_allclose(east_north_up, [[0, 5, -1], [10, 5, -1], [20, 5, -1]], atol=1e-6)
    # the local level turns by 3e-6 rad within 20 m
    for name, angle in (("roll", RIGHT_DOWN), ("pitch", NOSE_UP), ("heading", HEADING)):
        np.testing.assert_allclose(s[f"{name}_rad"], angle, atol=1e-5)
        np.testing.assert_allclose(s[f"sigma_{name}_rad"], np.deg2rad(0.2))
    if kind == "euroc":
        np.testing.assert_allclose(
            s[["v_east_mps", "v_north_mps", "v_down_mps"]], [[1, 2, -3]] * 3, atol=1e-4
        )
    else:
        assert s["v_north_mps"].isna().all()
    assert log.report.counts == {"poses": 3}
    assert log.report.synchronised


@pytest.mark.parametrize("kind", ["tum", "euroc", "kitti"])
def test_what_a_table_does_not_hold_is_asked_for(tmp_path: Path, kind: str) -> None:
    path = write(kind, tmp_path / "poses", "forward-left-up")
    with pytest.raises(
        InputError, match="frame, body_axes, time_scale, sigma_position_m, sigma_attitude_deg"
    ):
        reader_of(kind)([path], TrackOptions())
    report = describe(path)
    assert not report.synchronised
    assert report.counts["poses"] == 3
    assert any("asks for them" in note for note in report.notes)
    if kind == "kitti":
        with pytest.raises(InputError, match="times"):
            reader_of(kind)([path], TrackOptions(**STATED, body_axes="forward-left-up"))


@pytest.mark.parametrize(
    ("kind", "text", "told"),
    [
        ("tum", "1.0 0 0 0 0 0 0 2\n", "the rotation is none"),
        ("kitti", "1 0 0 0 0 1 0 0 0 0 -1 0\n", "the rotation is none"),
        ("tum", "1.0 0 0 0 0 0 0 1\n1.1 0 0 x 0 0 0 1\n", "line 2"),
        ("euroc", "1,0,0,0,1,0,0\n", "line 1"),
        ("tum", "# nothing\n", "no poses"),
    ],
)
def test_damaged_tables_are_refused(tmp_path: Path, kind: str, text: str, told: str) -> None:
    path = tmp_path / "poses"
    path.write_text(text)
    with pytest.raises(InputError, match=told):
        read_text_poses(kind, [path])


@pytest.mark.real
def test_poses_of_a_real_lidar(data_dir: Path) -> None:
    path = data_dir / "ouster_sdk_samples/OS-1-128_v2.3.0_1024x10_lb_n3_poses_kitti.txt"
    assert recognise(path) == "kitti"
    poses = read_text_poses("kitti", [path])
    np.testing.assert_allclose(poses.position_m[:, 0], [0.0, 0.2454105, 0.4978255], atol=1e-7)


HEADER = """Project:     Elbe
Program:     Inertial Explorer Version 8.90

 Week   GPSTime    Latitude   Longitude    H-Ell  VEast VNorth   VUp   Roll  Pitch Heading{more}
(weeks)   (sec)       (deg)       (deg)      (m)  (m/s)  (m/s) (m/s)  (deg)  (deg)   (deg){units}
"""
SIGMAS = ("  SDEast SDNorth SDHeight  RollSD PitchSD  HdngSD", "   (m) (m) (m) (arcmin) (arcmin) (arcmin)")
ROW = "2235 300000.{k}00 51.0500000{k} 13.25000000 120.500 0.1 0.2 0.3 1.0 -2.0 359.5"


def export(path: Path, *, sigmas: bool = True, header: str = HEADER) -> Path:
    more, units = SIGMAS if sigmas else ("", "")
    rows = "\n".join(ROW.format(k=k) + (" 0.01 0.02 0.03 1.2 1.8 6.0" if sigmas else "") for k in range(4))
    path.write_text(header.format(more=more, units=units) + rows + "\n")
    return path


def test_inertial_explorer_by_its_header(tmp_path: Path) -> None:
    path = export(tmp_path / "boat.txt")
    assert recognise(path) == "inertial_explorer"
    log = read_poses([path], "sbet", TrackOptions())
    s = log.states
    np.testing.assert_allclose(s["t_gps_s"], gps_from_week(2235, 300_000 + 0.1 * np.arange(4)), atol=1e-6)
    np.testing.assert_allclose(s["lat_deg"], 51.05 + 1e-8 * np.arange(4), atol=1e-12)
    first = s.iloc[0]
    assert first["v_down_mps"] == -0.3
    assert np.rad2deg(
        first[["roll_rad", "pitch_rad", "heading_rad"]].astype(float)
    ).tolist() == pytest.approx([1.0, -2.0, 359.5])
    assert first[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].tolist() == [0.01, 0.02, 0.03]
    assert np.rad2deg(first["sigma_heading_rad"]) == pytest.approx(0.1)  # 6 arc minutes
    assert describe(path).counts["poses"] == 4


def test_inertial_explorer_in_degrees_minutes_seconds(tmp_path: Path) -> None:
    header = HEADER.replace("(deg)", "(+/-D M S)", 2)
    path = tmp_path / "dms.txt"
    row = "2235 300000.0 -0 30 36.0 13 15 00.0 120.5 0.1 0.2 0.3 1.0 -2.0 359.5 0.01 0.02 0.03 1.2 1.8 6.0"
    path.write_text(header.format(more=SIGMAS[0], units=SIGMAS[1]) + row + "\n")
    first = read_poses([path], "sbet", TrackOptions()).states.iloc[0]
    assert (first["lat_deg"], first["lon_deg"]) == pytest.approx((-0.51, 13.25))


def test_inertial_explorer_without_sigmas_units_or_columns(tmp_path: Path) -> None:
    path = export(tmp_path / "bare.txt", sigmas=False)
    with pytest.raises(InputError, match=r"no standard deviations: SDEast, SDNorth, SDH.*sigma_position_m"):
        read_poses([path], "sbet", TrackOptions())
    stated = TrackOptions(sigma_position_m=0.1, sigma_attitude_deg=0.5)
    assert (read_poses([path], "sbet", stated).states["sigma_up_m"] == 0.1).all()
    wrong = export(tmp_path / "gon.txt", header=HEADER.replace("(deg){units}", "(gon){units}"))
    with pytest.raises(InputError, match="unit 'gon' of Heading"):
        read_poses([wrong], "sbet", TrackOptions())
    path.write_text(path.read_text().replace(" H-Ell", " H-MSL"))
    with pytest.raises(InputError, match="no column H-Ell"):
        read_poses([path], "sbet", stated)


@pytest.mark.parametrize(
    ("header", "separator", "order"),
    [
        ("# timestamp tx ty tz qw qx qy qz", " ", "t x y z qw qx qy qz"),
        ("time_s,x,y,z,qw,qx,qy,qz", ",", "t x y z qw qx qy qz"),
        (
            "#timestamp [ms], q_w [], q_x [], q_y [], q_z [], p_x [m], p_y [m], p_z [m]",
            ", ",
            "ms qw qx qy qz x y z",
        ),
    ],
)
def test_names_of_columns_decide_over_their_order(
    tmp_path: Path, header: str, separator: str, order: str
) -> None:
    usual = write("tum", tmp_path / "usual.txt", "forward-left-up")
    lines = []
    for line in usual.read_text().split("\n")[:-1]:
        t, x, y, z, qx, qy, qz, qw = line.split()
        cells = {"t": t, "x": x, "y": y, "z": z, "qx": qx, "qy": qy, "qz": qz, "qw": qw}
        cells["ms"] = str(round(float(t) * 1e3))
        lines.append(separator.join(cells[name] for name in order.split()))
    named = tmp_path / "named.txt"
    named.write_text("\n".join([header, *lines]) + "\n")
    options = TrackOptions(**STATED, body_axes="forward-left-up")
    states, expected = (read_poses([path], None, options).states for path in (named, usual))
    np.testing.assert_allclose(states["roll_rad"], expected["roll_rad"])
    np.testing.assert_allclose(states["t_gps_s"], expected["t_gps_s"], atol=1e-3)
    np.testing.assert_allclose(states["h_ell_m"], expected["h_ell_m"])


def test_a_boat_that_is_upside_down_is_asked_about(tmp_path: Path) -> None:
    path = tmp_path / "w_first.txt"
    path.write_text("".join(f"{T0 + k} {k} 0 0 0.9 0 0 {0.19**0.5}\n" for k in range(5)))
    stated = STATED | {"body_axes": "forward-left-up"}
    with pytest.raises(InputError, match=r"upside down .* in 100% .*order of the quaternion.*--upside-down"):
        read_poses([path], None, TrackOptions(**stated))
    log = read_poses([path], None, TrackOptions(**stated, upside_down=True))
    assert len(log.states) == 5
    assert "upside down" in " ".join(read_poses([path], "ins", TrackOptions(**stated)).report.notes)


def test_stamps_against_the_stated_time_scale(tmp_path: Path) -> None:
    path = tmp_path / "adjusted.txt"
    path.write_text("".join(f"{402221618 + k} 0 0 0 0 0 0 1\n" for k in range(3)))
    with pytest.raises(InputError, match=r"time_scale utc is stated, but 402221618 .* adjusted standard GPS"):
        read_poses([path], None, TrackOptions(**STATED, body_axes="forward-left-up"))


CORR_TIME = (
    " CorrTime  Date  Latitude  Longitude  H-Ell  Heading  HdngSD  Pitch  PitchSD  Roll  RollSD\n"
    " (sec) ({date}) (+/-D M S) (+/-D M S) (m) (Deg) (Deg) (Deg) (Deg) (Deg) (Deg)\n"
    "{tow} {day} 51 03 10.0 -00 45 05.0 155.0 51.23 0.0199 -1.29 0.0049 0.03 0.0048\n"
)


@pytest.mark.parametrize(
    ("date", "day", "tow", "t_gps_s"),
    [
        ("MDY", "6/12/2024", 295_218.0, gps_from_week(2318, 295_218.0)),
        ("DMY", "12/06/2024", 295_218.0, gps_from_week(2318, 295_218.0)),
        ("MDY", "06/12/2024", "10:00:18.00", gps_from_week(2318, 295_218.0)),
        ("YMD", "2024-06-09", 10.0, gps_from_week(2318, 10.0)),
        # the date is of UTC, 18 s behind GPS time
        ("MDY", "6/8/2024", 10.0, gps_from_week(2318, 10.0)),
    ],
)
def test_inertial_explorer_with_date_and_corrected_time(
    tmp_path: Path, date: str, day: str, tow: float | str, t_gps_s: float
) -> None:
    path = tmp_path / "export.txt"
    text = CORR_TIME.format(date=date, day=day, tow=tow)
    path.write_text(text.replace("(sec)", "(HMS)") if isinstance(tow, str) else text)
    with pytest.raises(InputError, match=r"no standard deviations: SDEast.*sigma_position_m"):
        read_poses([path], "sbet", TrackOptions())
    first = read_poses([path], "sbet", TrackOptions(sigma_position_m=0.05)).states.iloc[0]
    assert first["t_gps_s"] == t_gps_s
    assert first["lon_deg"] == pytest.approx(-(45 / 60 + 5 / 3600))
    assert np.rad2deg(first["sigma_heading_rad"]) == pytest.approx(0.0199)
    report = describe(path)  # asks for nothing
    assert report.t_first_s == t_gps_s
    assert "no standard deviations of positions" in " ".join(report.notes)


def test_describing_a_trajectory_without_week_asks_for_nothing(tmp_path: Path) -> None:
    path = export(tmp_path / "boat.txt")
    path.write_text(path.read_text().replace(" Week", " Wake").replace("Week ", "Wake "))
    report = describe(path)
    assert not report.synchronised
    assert report.t_first_s == pytest.approx(300_000)


def test_a_week_counter_that_rolled_over_is_doubted(tmp_path: Path) -> None:
    path = export(tmp_path / "boat.txt")
    path.write_text(path.read_text().replace("2235 ", "187 "))
    notes = " ".join(read_poses([path], "sbet", TrackOptions()).report.notes)
    assert "2048 weeks later 2022-11-" in notes


GPX = '<gpx xmlns="http://www.topografix.com/GPX/1/1" xmlns:g="urn:g"><wpt lat="51" lon="13"/><trk><trkseg>{}'
POINT = (
    '<trkpt lat="51.05" lon="13.75"><time>2024-06-12T10:00:0{k}{zone}</time>'
    "<extensions><g:TrackPointExtension><g:{tag}>{depth}</g:{tag}></g:TrackPointExtension></extensions></trkpt>"
)


@pytest.mark.parametrize("tag", ["depth", "Depth"])
def test_depths_zones_and_waypoints_of_gpx(tmp_path: Path, tag: str) -> None:
    path = tmp_path / "track.gpx"
    points = [POINT.format(k=k, zone="" if k else "+02:00", tag=tag, depth=1.5 * k) for k in range(3)]
    points += [POINT.format(k=3, zone="Z", tag=tag, depth=depth) for depth in ("-9999", "--")]
    path.write_text(GPX.format("".join(points)) + "</trkseg></trk></gpx>")
    log = read_gpx([path])
    np.testing.assert_allclose(np.diff(log.positions["t_gps_s"]), [7201.0, 1.0, 1.0, 0.0])
    assert log.depths["depth_m"].tolist() == [1.5, 3.0]
    assert log.report.losses == {"depths_of_nothing": 3}
    notes = " ".join(log.report.notes)
    assert "2 times state no zone and are taken as UTC" in notes
    assert "1 waypoints" in notes


def test_decimal_commas_are_read_as_such(tmp_path: Path) -> None:
    path = write("tum", tmp_path / "poses.txt", "forward-left-up")
    options = TrackOptions(**STATED, body_axes="forward-left-up")
    expected = read_poses([path], None, options).states
    path.write_text(path.read_text().replace(".", ","))
    np.testing.assert_array_equal(read_poses([path], None, options).states["roll_rad"], expected["roll_rad"])
