"""Tracks, poses, raw GNSS and captures with traits of public bug reports: what the files themselves say."""

import numpy as np
import pytest

from thalweg.core import InputError, gps_from_unix, gps_from_week
from thalweg.ingest import TrackOptions
from thalweg.ingest.registry import choose_tracks, describe, read_poses, recognise
from thalweg.ingest.tracks import read_pos, read_text_poses

pytestmark = pytest.mark.real


@pytest.fixture
def reports(data_dir):
    folder = data_dir / "reports_logs"
    if not folder.is_dir():
        pytest.skip("no reports_logs beside the recordings")
    return folder


def test_a_solution_in_two_time_scales(reports):
    table = read_pos([reports / "pos_two_time_scales" / "two_solutions.pos"]).positions
    assert table["t_gps_s"].iloc[60] == gps_from_unix(1_718_186_520)  # 2024-06-12T10:02:00Z


def test_events_beside_their_track(reports):
    rover, events = (reports / "pos_with_events_file" / name for name in ("rover.pos", "rover_events.pos"))
    assert len(read_pos([rover, events]).positions) == 60
    assert choose_tracks([rover, events])[0] == [rover]


def test_times_without_zone(reports):
    assert "60 times state no zone" in " ".join(describe(reports / "gpx_time_without_zone/track.gpx").notes)


def test_inertial_explorer_with_date(reports):
    path = reports / "inertial_explorer_corrtime" / "export.txt"
    assert recognise(path) == "inertial_explorer"
    first = read_poses([path], "sbet", TrackOptions(sigma_position_m=0.05)).states.iloc[0]
    assert first["t_gps_s"] == gps_from_week(2318, 295_218.0)
    assert (first["lat_deg"], first["lon_deg"]) == pytest.approx((51.0527778, -13.7513889))
    angles = [f"sigma_{name}_rad" for name in ("heading", "pitch", "roll")]
    assert np.rad2deg(first[angles].astype(float)).tolist() == pytest.approx(
        [0.0199, 0.0049, 0.0048], abs=5e-5
    )


def test_a_quaternion_with_w_first(reports):
    named, right = (
        read_text_poses("tum", [reports / "tum_w_first" / name]) for name in ("poses.txt", "poses_right.txt")
    )
    np.testing.assert_array_equal(named.R_world_body, right.R_world_body)


def test_one_blank_before_the_flag(reports):
    report = describe(reports / "rinex_one_blank_before_flag" / "rover.21O")
    assert report.counts["epochs"] == 30
    assert report.clean


def test_a_short_snap_length(reports):
    with pytest.raises(InputError, match=r"snap length of 600 of 1248 bytes: 125 packets .* -s 0"):
        describe(reports / "pcap_short_snaplen" / "lidar.pcap")
