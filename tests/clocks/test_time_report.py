"""The time of the whole boat, and the tables that the camera's clock comes from."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.core.conftest import FRAME, trajectory_of
from thalweg.clocks import ClockModel, Lag, Speeds, report_lines, stream_table, time_report
from thalweg.clocks.streams import COLUMNS, _stream_row, _who, apart_words
from thalweg.clocks.synchronise import offset_options, run_attitude, run_poses
from thalweg.clocks.ties import RUN_IMAGE_TIMES, trigger_clock
from thalweg.core import ClockError, CoverageError, InputError, Rigid, cross_matrix, frame_of, gps_from_unix
from thalweg.ingest import IntegrityReport, StreamTiming

T0 = float(gps_from_unix(1_620_808_267))
DISPLAY = {"mean_s": 0.999, "std_s": 0.023, "kind": "white stamps", "image_error_s": 0.0163}
"""What the photographs of a display told of the camera."""


def trajectory(speed_mps, turn_degps, *, n=500, hole=False):
    """A boat at 50 Hz that drives east and turns about up."""
    s = 0.02 * np.arange(n)
    attitude = Rotation.from_rotvec(np.outer(np.deg2rad(turn_degps) * s, [0, 0, 1]))
    valid = np.arange(n) % 20 > 0 if hole else True
    return trajectory_of(T0 + s, np.outer(s, [speed_mps, 0, 0]), attitude, valid=valid)


def speeds():
    return Speeds.of(trajectory(0.4, 7.0))


def camera_row(report):
    return report.set_index("stream").loc["camera"]


def streams():
    def report(stream, form, scale, **timing):
        told = {"synchronised": scale in ("gps", "utc"), "t_first_s": T0, "t_last_s": T0 + 60}
        told |= {"time_scale": scale, "timing": StreamTiming(**timing)}
        return IntegrityReport(stream=stream, format=form, files=["a"], **told)

    reports = [
        report("lidar", "Velodyne packets, pcap", "utc", resolution_s=1e-6, jitter_s=2e-7),
        report("ins", "ANPP", "utc", resolution_s=1e-6),
        report("positions", "RTKLIB .pos", "gps", resolution_s=1e-3),
        report("depth", "NMEA 0183", "host"),
        report("camera", "photographs", "device", resolution_s=1e-3),
    ]
    return stream_table(reports, {"positions": ("ins", Lag(offset_s=0.040, sigma_s=0.003, n=250))})


def test_speeds_are_those_of_the_survey():
    found = speeds()
    assert (found.linear_mps, np.rad2deg(found.angular_radps)) == pytest.approx((0.4, 7.0), rel=1e-6)
    # P2 6.1.2: 0.023 s at 0.4 m/s and 7 degrees/s about one axis: 9.2 and 70.25 mm
    assert found.cost_mm(0.023, 25.0) == pytest.approx(70.85, abs=0.005)
    with pytest.raises(CoverageError, match="no second without a gap"):
        Speeds.of(trajectory(0.4, 7.0, hole=True))


def test_every_stream_says_who_stamps_it_and_what_that_costs(tmp_path):
    run = {"source": "kinematic run", "t_first_s": T0, "t_last_s": T0 + 200, "reference_s": T0}
    cov = np.diag([0.0016**2, 1e-10])
    clock = ClockModel(offset_s=-2.3471, drift=12e-6, cov=cov, jitter_s=0.023, **run)
    streams().to_csv(tmp_path / "streams.csv", index=False)
    for table in (streams(), pd.read_csv(tmp_path / "streams.csv")):
        report = time_report(table, speeds(), camera=clock)
        assert list(report.columns) == list(COLUMNS)
        row = report.set_index("stream")
        assert row.index.tolist() == ["lidar", "ins", "positions", "depth", "camera"]
        assert "pulse per second" in row.loc["lidar", "stamped_by"]
        assert row.loc["depth", "stamped_by"] == "the logging computer"
        assert not row.loc["depth", "synchronised"]
        # jitter, offset, and drift over 200 s
        sigma = np.sqrt(0.023**2 + 0.0016**2 + (1e-5 * 200) ** 2)
        assert row.loc["camera", "sigma_time_s"] == pytest.approx(sigma)
        assert row.loc["camera", "cost_mm"] == pytest.approx(speeds().cost_mm(sigma, 25.0))
        assert row.loc["camera", "cost_if_ignored_mm"] > 7000
    text = "\n".join(report_lines(report, speeds()))
    for words in (
        "0.40 m/s, 7.0 degrees/s",
        "offset -2347.100 ms (sigma 1.600)",
        "Late by +40.0 ms against ins",
        "unit of the stamps 0.001 ms",
    ):
        assert words in text, words
    lidar = text[text.index("lidar: ") : text.index("ins: ")]
    assert "is good to" not in lidar
    assert "Not checked against another stream" in lidar


@pytest.mark.parametrize(
    ("told", "sigma_s", "ignored", "remark"),
    [
        ({}, np.nan, False, "Not checked against another stream: how good its stamps are was not measured."),
        ({"sigma_lag_s": 0.003}, 0.003, False, ""),
        ({"sigma_lag_s": 0.003, "resolution_s": 0.012}, np.sqrt(9e-6 + 12e-6), False, ""),
        (
            {"lag_s": -0.004, "sigma_lag_s": 0.003, "lag_significant": True, "lag_against": "ins"},
            0.005,
            True,
            "Late by -4.0 ms against ins: not corrected.",
        ),
        ({"synchronised": False, "sigma_lag_s": 0.003}, np.nan, False, "Never on GPS time: not used."),
        ({"sigma_lag_s": 0.003, "unsynchronised_s": 2.04}, 0.003, False, "2.0 s without GPS time."),
    ],
)
def test_a_row_of_the_report_by_hand(told, sigma_s, ignored, remark):
    """A unit of the stamps of 12 ms scatters by the root of a twelfth; a lag that stays adds to its sigma."""
    record = {"stream": "ins", "format": "ANPP", "time_scale": "gps", "synchronised": True, "jitter_s": 1e-4}
    row = _stream_row(record | told, Speeds(linear_mps=0.4, angular_radps=0.03), 10.0)
    numbers = ["offset", "sigma_offset", "jitter", "sigma_jitter", "resolution", "lag", "sigma_lag"]
    expected = [np.nan, np.nan, 1e-4, np.nan]
    expected += [told.get(f"{name}_s", np.nan) for name in ("resolution", "lag", "sigma_lag")]
    assert_allclose([row[f"{name}_s"] for name in (*numbers, "sigma_time")], [*expected, sigma_s])
    assert_allclose([row["cost_mm"], row["cost_if_ignored_mm"]], [500 * sigma_s, 2.0 if ignored else np.nan])
    assert (row["remark"], row["range_m"], row["lag_significant"]) == (remark, 10.0, ignored)
    assert row["lag_against"] == told.get("lag_against", "")


def test_the_report_of_a_trigger_is_that_of_its_pulses():
    """Neither the unit of the camera's stamps nor the display test count; what is not known is said."""
    clock = trigger_clock(t_first_s=T0, t_last_s=T0 + 100, delay_s=0.003)
    clock = replace(clock, notes=("Jitter of the trigger not stated: taken as 0.",))
    row = camera_row(time_report(streams(), speeds(), camera=clock, stability=DISPLAY))
    assert (row["offset_s"], row["jitter_s"], row["sigma_time_s"]) == (0.003, 0.0, 0.0)
    assert row["stamped_by"] == "the pulses of its trigger"
    assert "not stated: taken as 0" in row["remark"]


def test_a_camera_that_was_never_tied_is_told():
    row = camera_row(time_report(streams(), speeds(), stability=DISPLAY))
    assert not row["synchronised"]
    assert np.isnan(row["cost_mm"])
    assert row["jitter_s"] == 0.0163
    assert "not tied to GPS time" in row["remark"]
    assert "0.9990 s between images" in row["remark"]


def test_a_boat_without_a_camera_has_no_row_for_one():
    table = streams()
    report = time_report(table[table["stream"] != "camera"], speeds())
    assert "camera" not in set(report["stream"])
    with pytest.raises(InputError, match="time_scale"):
        time_report(table.drop(columns="time_scale"), speeds())


# ---------------------------------------------------------------- tables of a run


def test_poses_come_into_the_world_with_the_error_they_share():
    rng = np.random.default_rng(1)
    place = Rigid.from_opk([0.1, -0.2, 0.7], [3.0, -4.0, 1.0], np.diag([1e-4, 1e-4, 4e-4, 1e-8, 1e-8, 2e-8]))
    B = rng.standard_normal((6, 6)) * 1e-3
    pose = Rigid.from_opk([1.0, 0.3, -0.5], [1.0, 2.0, 0.5], B @ B.T)
    names = ["run/R2.jpg", "run/R1.jpg", "R9.jpg"]
    stamps = pd.DataFrame(
        {"file": ["R1.jpg", "R2.jpg", "R3.jpg", "R4.jpg"], "t_device_s": [T0, T0 + 1, T0 + 2, np.nan]}
    )
    run, shared, counts = run_poses(names, dict.fromkeys(names, pose), place, stamps)
    assert run.file.tolist() == ["R1.jpg", "R2.jpg"]
    assert counts == {"images_with_pose_and_time": 2, "poses_without_time": 1, "times_without_pose": 1}
    # the chain of the core carries both errors; here they stand apart
    full = place @ pose
    assert_allclose(run.R_wcs_ccs[0], full.R, atol=1e-12)
    assert_allclose(run.centre_wcs_m[0], full.shift_m, atol=1e-12)
    J = np.eye(6)
    (J[:3, 3:],) = -cross_matrix((full.shift_m - shared.about_wcs_m)[None])
    assert_allclose(run.cov_pose_wcs[0] + J @ shared.cov @ J.T, full.cov, rtol=1e-9, atol=1e-15)
    with pytest.raises(ClockError, match="none of 3 images"):
        run_poses(names, dict.fromkeys(names, pose), place, stamps.assign(file="x.jpg"))


OPTIONS = {
    "use_attitude": True, "attitude_time_s": 20.0, "high_pass_s": 60.0, "position_time_s": 10.0,
    "white_share": 0.25,
    "sigma_drift_ppm": 50.0, "largest_offset_s": 30.0, "largest_lever_m": 3.0, "largest_sigma_s": 0.02,
    "jitter_s": None,
}  # fmt: skip


def test_options_and_attitudes_of_a_campaign():
    assert offset_options(OPTIONS).sigma_drift == pytest.approx(50e-6)
    attitude = {"roll_rad": 0.0, "pitch_rad": 0.0, "heading_rad": np.pi / 2}
    sigmas = {"sigma_roll_rad": np.nan, "sigma_pitch_rad": 0.001, "sigma_heading_rad": 0.004}
    place = {"lat_deg": FRAME.lat_deg, "lon_deg": FRAME.lon_deg, "t_gps_s": T0 + 0.02 * np.arange(20)}
    states = pd.DataFrame(place | attitude | sigmas)
    ins = run_attitude(states, FRAME, OPTIONS)
    # heading east: forward is east, right is south, down is down
    assert_allclose(ins.R_wcs_ics[0], [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=1e-12)
    assert_allclose(ins.sigma_rad, [np.deg2rad(0.1), 0.001, 0.004])
    assert run_attitude(states, FRAME, OPTIONS | {"use_attitude": False}) is None
    with pytest.raises(CoverageError, match="0 INS states"):
        run_attitude(states.assign(t_gps_s=np.nan), FRAME, OPTIONS)


def test_times_by_pulses_stand_in_the_cameras_remark():
    rows = {"t_device_s": [T0, T0 + 1], "t_gps_s": [T0 + 0.1, T0 + 1.1], "sigma_s": [2e-4, 0.02]}
    rows |= {"file": ["a.jpg", "b.jpg"], "matched": [True, False], "reason": ["", "no pulse"]}
    times = frame_of(RUN_IMAGE_TIMES, rows)
    clock = ClockModel(offset_s=0.1, reference_s=T0, cov=np.zeros((2, 2)), source="hardware trigger")
    row, plain = (
        camera_row(time_report(streams(), speeds(), camera=clock, **more))
        for more in ({"image_times": times}, {})
    )
    words = "1 by their pulse (sigma up to 0.20 ms), 1 by the camera's own clock (sigma up to 20.00 ms)"
    assert words in row["remark"]
    assert "Times of" not in plain["remark"]


@pytest.mark.parametrize(
    ("form", "scale", "told"),
    [
        ("Photographs", "device", ("its own free-running clock", "nothing")),
        ("Velodyne packets", "none", ("its own free-running clock", "nothing")),
        ("NMEA 0183", "host", ("the logging computer", "its system clock")),
        ("PCAP", "utc", ("the lidar's clock", "UTC, put on GPS time with the leap seconds")),
        ("SBET of Applanix", "gps", ("the INS, steered by", "GPS time")),
        ("RTKLIB .pos", "gps", ("the GNSS receiver", "GPS time")),
        ("RINEX 3", "glonass", ("the GNSS receiver", "glonass")),
        ("NMEA 0183", "utc", ("the time sentences", "UTC, put on GPS time with the leap seconds")),
        ("a table", "gps", ("the instrument", "GPS time")),
    ],
)
def test_who_stamps_a_stream_and_against_what(form, scale, told):
    found = _who({"format": form, "time_scale": scale})
    assert found[0].startswith(told[0])
    assert found[1] == told[1]


@pytest.mark.parametrize(
    ("span", "other", "words"),
    [
        (
            (0.0, 100.0),
            (7210.0, 7260.0),
            "shifted by +2:00 h it would overlap: its hour or its time zone is wrong",
        ),
        ((0.0, 100.0), (86_400.0, 86_460.0), "shifted by +24:00 h it would overlap: its date is wrong"),
        ((90_000.0, 90_100.0), (3600.0, 3650.0), "shifted by -24:00 h it would overlap: its date is wrong"),
        # half of the shorter one is enough
        (
            (0.0, 100.0),
            (7249.0, 7349.0),
            "shifted by +2:00 h it would overlap: its hour or its time zone is wrong",
        ),
        ((0.0, 100.0), (7251.0, 7351.0), "it ends 7151 s before the other begins"),
        ((900.0, 950.0), (0.0, 100.0), "it begins 800 s after the other ends"),
        ((100.0, 200.0), (0.0, 100.0), "it begins 0 s after the other ends"),
        ((99.0, 200.0), (0.0, 100.0), ""),
    ],
)
def test_how_far_logs_lie_apart(span, other, words):
    assert apart_words(span, other) == words
