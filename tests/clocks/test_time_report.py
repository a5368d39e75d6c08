"""The time of the whole boat, and the tables that the camera's clock comes from."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from thalweg.clocks import ClockModel, Lag, Speeds, report_lines, stream_table, time_report
from thalweg.clocks.streams import COLUMNS, _stream_row
from thalweg.clocks.synchronise import offset_options, run_attitude, run_poses
from thalweg.clocks.ties import RUN_IMAGE_TIMES, trigger_clock
from thalweg.core import (
    ClockError,
    CoverageError,
    InputError,
    LocalFrame,
    Rigid,
    Trajectory,
    frame_of,
    gps_from_unix,
)
from thalweg.ingest import IntegrityReport, StreamTiming

T0 = float(gps_from_unix(1_620_808_267))
FRAME = LocalFrame(lat_deg=51.0, lon_deg=13.7, h_ell_m=160.0)


def trajectory(speed_mps: float, turn_degps: float, *, n: int = 500, hole: bool = False) -> Trajectory:
    """A boat at 50 Hz that drives east and turns about up."""
    t = T0 + 0.02 * np.arange(n)
    valid = np.ones(n, dtype=bool)
    if hole:
        valid[::20] = False
    return Trajectory(
        frame=FRAME,
        t_gps_s=t,
        position_wcs_m=np.column_stack([speed_mps * (t - T0), 0 * t, 0 * t]),
        quaternion_wcs_ics=Rotation.from_rotvec(
            np.outer(np.deg2rad(turn_degps) * (t - T0), [0, 0, 1])
        ).as_quat(),
        cov_pose_wcs=np.tile(np.eye(6) * 1e-4, (n, 1, 1)),
        valid=valid,
    )


def streams() -> pd.DataFrame:
    def report(stream: str, form: str, scale: str, **timing: float) -> IntegrityReport:
        return IntegrityReport(
            stream=stream,
            format=form,
            files=["a"],
            time_scale=scale,
            synchronised=scale in ("gps", "utc"),
            t_first_s=T0,
            t_last_s=T0 + 60,
            timing=StreamTiming(**timing),
        )

    reports = [
        report("lidar", "Velodyne packets, pcap", "utc", resolution_s=1e-6, jitter_s=2e-7),
        report("ins", "ANPP", "utc", resolution_s=1e-6),
        report("positions", "RTKLIB .pos", "gps", resolution_s=1e-3),
        report("depth", "NMEA 0183", "host"),
        report("camera", "photographs", "device", resolution_s=1e-3),
    ]
    return stream_table(reports, {"positions": ("ins", Lag(offset_s=0.040, sigma_s=0.003, n=250))})


def test_speeds_are_those_of_the_survey():
    speeds = Speeds.of(trajectory(0.4, 7.0))
    assert speeds.linear_mps == pytest.approx(0.4, rel=1e-6)
    assert np.rad2deg(speeds.angular_radps) == pytest.approx(7.0, rel=1e-6)
    # P2 6.1.2: 0.023 s at 0.4 m/s and 7 degrees/s about one axis; at 25 m 70.9 mm
    assert speeds.cost_mm(0.023, 25.0) == pytest.approx(1e3 * 0.023 * np.hypot(0.4, np.deg2rad(7.0) * 25))
    with pytest.raises(CoverageError, match="no second without a gap"):
        Speeds.of(trajectory(0.4, 7.0, hole=True))


def test_every_stream_says_who_stamps_it_and_what_that_costs(tmp_path):
    speeds = Speeds.of(trajectory(0.4, 7.0))
    clock = ClockModel(
        offset_s=-2.3471,
        drift=12e-6,
        reference_s=T0,
        cov=np.diag([0.0016**2, 1e-10]),
        jitter_s=0.023,
        source="kinematic run",
        t_first_s=T0,
        t_last_s=T0 + 200,
    )
    streams().to_csv(tmp_path / "streams.csv", index=False)
    for table in (streams(), pd.read_csv(tmp_path / "streams.csv")):
        report = time_report(table, speeds, camera=clock)
        assert list(report.columns) == list(COLUMNS)
        row = report.set_index("stream")
        assert row.index.tolist() == ["lidar", "ins", "positions", "depth", "camera"]
        assert "pulse per second" in row.loc["lidar", "stamped_by"]
        assert row.loc["depth", "stamped_by"] == "the logging computer"
        assert not row.loc["depth", "synchronised"]
        # jitter, offset, and drift over 200 s
        sigma = np.sqrt(0.023**2 + 0.0016**2 + (1e-5 * 200) ** 2)
        assert row.loc["camera", "sigma_time_s"] == pytest.approx(sigma)
        assert row.loc["camera", "cost_mm"] == pytest.approx(speeds.cost_mm(sigma, 25.0))
        assert row.loc["camera", "cost_if_ignored_mm"] > 7000
    text = "\n".join(report_lines(report, speeds))
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
    numbers = [
        "offset",
        "sigma_offset",
        "jitter",
        "sigma_jitter",
        "resolution",
        "lag",
        "sigma_lag",
        "sigma_time",
    ]
    expected = [np.nan, np.nan, 1e-4, np.nan]
    expected += [told.get(f"{name}_s", np.nan) for name in ("resolution", "lag", "sigma_lag")]
    assert_allclose([row[f"{name}_s"] for name in numbers], [*expected, sigma_s])
    assert_allclose([row["cost_mm"], row["cost_if_ignored_mm"]], [500 * sigma_s, 2.0 if ignored else np.nan])
    assert (row["remark"], row["range_m"], row["lag_significant"]) == (remark, 10.0, ignored)
    assert row["lag_against"] == told.get("lag_against", "")


def test_the_report_of_a_trigger_is_that_of_its_pulses():
    """Neither the unit of the camera's stamps nor the display test count; what is not known is said."""
    clock = trigger_clock(t_first_s=T0, t_last_s=T0 + 100, delay_s=0.003)
    facts = {"mean_s": 0.999, "std_s": 0.023, "kind": "white stamps", "image_error_s": 0.0163}
    clock = replace(clock, notes=("Jitter of the trigger not stated: taken as 0.",))
    report = time_report(streams(), Speeds.of(trajectory(0.4, 7.0)), camera=clock, stability=facts)
    row = report.set_index("stream").loc["camera"]
    assert (row["offset_s"], row["jitter_s"], row["sigma_time_s"]) == (0.003, 0.0, 0.0)
    assert row["stamped_by"] == "the pulses of its trigger"
    assert "not stated: taken as 0" in row["remark"]


def test_a_camera_that_was_never_tied_is_told():
    facts = {"mean_s": 0.999, "std_s": 0.023, "kind": "white stamps", "image_error_s": 0.0163}
    report = time_report(streams(), Speeds.of(trajectory(0.4, 7.0)), stability=facts)
    row = report.set_index("stream").loc["camera"]
    assert not row["synchronised"]
    assert np.isnan(row["cost_mm"])
    assert row["jitter_s"] == 0.0163
    assert "not tied to GPS time" in row["remark"]
    assert "0.9990 s between images" in row["remark"]


def test_a_boat_without_a_camera_has_no_row_for_one():
    table = streams()
    report = time_report(table[table["stream"] != "camera"], Speeds.of(trajectory(0.4, 7.0)))
    assert "camera" not in set(report["stream"])
    with pytest.raises(InputError, match="time_scale"):
        time_report(table.drop(columns="time_scale"), Speeds.of(trajectory(0.4, 7.0)))


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
    arm = full.shift_m - shared.about_wcs_m
    J[:3, 3:] = -np.array([[0, -arm[2], arm[1]], [arm[2], 0, -arm[0]], [-arm[1], arm[0], 0]])
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
    n = 20
    states = pd.DataFrame(
        {
            "t_gps_s": T0 + 0.02 * np.arange(n),
            "roll_rad": 0.0,
            "pitch_rad": 0.0,
            "heading_rad": np.pi / 2,
            "lat_deg": 51.0,
            "lon_deg": 13.7,
            "sigma_roll_rad": np.nan,
            "sigma_pitch_rad": 0.001,
            "sigma_heading_rad": 0.004,
        }
    )
    ins = run_attitude(states, FRAME, OPTIONS)
    # heading east: forward is east, right is south, down is down
    assert_allclose(ins.R_wcs_ics[0], [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=1e-12)
    assert_allclose(ins.sigma_rad, [np.deg2rad(0.1), 0.001, 0.004])
    assert run_attitude(states, FRAME, OPTIONS | {"use_attitude": False}) is None
    with pytest.raises(CoverageError, match="0 INS states"):
        run_attitude(states.assign(t_gps_s=np.nan), FRAME, OPTIONS)


def test_times_by_pulses_stand_in_the_cameras_remark():
    times = frame_of(
        RUN_IMAGE_TIMES,
        {
            "file": ["a.jpg", "b.jpg"],
            "t_device_s": [T0, T0 + 1],
            "t_gps_s": [T0 + 0.1, T0 + 1.1],
            "sigma_s": [2e-4, 0.02],
            "matched": [True, False],
            "reason": ["", "no pulse"],
        },
    )
    clock = ClockModel(offset_s=0.1, reference_s=T0, cov=np.zeros((2, 2)), source="hardware trigger")
    speeds = Speeds.of(trajectory(0.4, 7.0))
    remark = (
        time_report(streams(), speeds, camera=clock, image_times=times)
        .set_index("stream")
        .loc["camera", "remark"]
    )
    assert (
        "1 by their pulse (sigma up to 0.20 ms), 1 by the camera's own clock (sigma up to 20.00 ms)" in remark
    )
    plain = time_report(streams(), speeds, camera=clock).set_index("stream").loc["camera", "remark"]
    assert "Times of" not in plain
