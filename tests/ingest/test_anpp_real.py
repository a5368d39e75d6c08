"""The ANPP reader on the manufacturer's own log, field by field against the manufacturer's SDK."""

from collections import Counter
from typing import Any

import numpy as np
import pytest
from advanced_navigation.anpp_packets.an_packet_3 import DeviceInformationPacket
from advanced_navigation.anpp_packets.an_packet_20 import SystemStatePacket
from advanced_navigation.anpp_packets.an_packet_22 import FormattedTimePacket
from advanced_navigation.anpp_packets.an_packet_26 import EulerOrientationStandardDeviationPacket
from advanced_navigation.anpp_packets.an_packet_29 import RawGNSSPacket
from advanced_navigation.anpp_packets.an_packet_30 import SatellitesPacket
from advanced_navigation.anpp_packets.an_packet_53 import ExternalDepthPacket
from advanced_navigation.anpp_packets.an_packet_protocol import ANDecoder, ANPacket

from thalweg.ingest.anpp import packets as ap, read_anpp
from thalweg.ingest.anpp.packets import collect

pytestmark = pytest.mark.real


@pytest.fixture(scope="module")
def path(data_dir):
    return data_dir / "anpp_sdk_log" / "Log.anpp"


@pytest.fixture(scope="module")
def log(path):
    return read_anpp([path])


@pytest.fixture(scope="module")
def sdk(path):
    decoder = ANDecoder()
    decoder.add_data(path.read_bytes())
    out = []
    while (found := decoder.decode()) is not None:  # the SDK hands out one object again and again: copy it
        out.append(ANPacket(id=found.id, length=found.length, header=found.header, data=found.data))
    return out


def decoded(sdk: list[ANPacket], kind: type[Any]) -> list[Any]:
    out = []
    for one in sdk:
        packet = kind()
        if one.id == kind.ID and packet.decode(one) == 0:
            out.append(packet)
    return out


def test_counts_of_the_provenance(path, log, sdk):
    counts = collect([path]).by_id
    assert (sum(counts.values()), len(counts)) == (632, 68)
    assert len(log.states) == counts[20] == counts[28] == 283
    assert {n for k, n in counts.items() if k not in (20, 28)} == {1}
    assert counts == Counter(int(p.id) for p in sdk)
    assert log.report.bytes_read == 46866
    assert log.report.losses == {"bytes_outside_packets": 104, "packets_cut_at_end": 1}


def test_time_and_gaps_of_the_provenance(log):
    report = log.report
    t = log.states["t_device_s"].to_numpy()
    assert not report.synchronised
    assert report.time_scale == "device"
    assert log.states["t_gps_s"].isna().all()
    assert log.depths["t_gps_s"].isna().all()
    assert any("UTC was never initialised: all 283 states" in note for note in report.notes)
    # 2023-07-11T14:59:37.394174Z and 15:03:15.544171Z; float64 resolves 240 ns at today's Unix times
    assert report.t_first_s == pytest.approx(1689087577.394174, abs=5e-7)
    assert report.t_last_s == pytest.approx(1689087795.544171, abs=5e-7)
    assert [round(g.duration_s, 1) for g in report.gaps] == [204.1, 0.1]
    assert report.gaps[0].t_start_s == t[14]
    assert report.counts["time_steps_shorter_than_half"] == 1
    assert report.rates_hz["states"] == pytest.approx(20.0, rel=1e-4)  # stamps are whole microseconds


def test_every_state_equals_the_sdk(log, sdk):
    states = decoded(sdk, SystemStatePacket)
    assert len(states) == len(log.states)
    rad = np.deg2rad  # degrees and back cost a last bit of a double: 1e-15 relative
    for row, p in zip(log.states.itertuples(), states, strict=True):
        assert row.t_device_s == p.unix_time_seconds + p.microseconds * 1e-6
        assert rad(row.lat_deg) == pytest.approx(p.latitude, rel=1e-15)
        assert rad(row.lon_deg) == pytest.approx(p.longitude, rel=1e-15)
        assert row.h_ell_m == p.height
        assert [row.v_north_mps, row.v_east_mps, row.v_down_mps] == p.velocity
        assert [row.roll_rad, row.pitch_rad] == p.orientation[:2]
        assert row.heading_rad == p.orientation[2] % (2 * np.pi)
        assert [row.rate_x_radps, row.rate_y_radps, row.rate_z_radps] == p.angular_velocity
        assert [row.sigma_north_m, row.sigma_east_m, row.sigma_up_m] == p.standard_deviation
        assert bool(row.system_status & 1 << 14) == p.system_status.gnss_antenna_disconnected
        assert bool(row.filter_status & ap.FILTER_UTC) == p.filter_status.utc_time_initialised
        assert ap.STATE_FIX.tolist().index(row.fix) == p.filter_status.gnss_fix_type.value


def test_single_packets_equal_the_sdk(path, log, sdk):
    records = collect([path])
    (device,) = decoded(sdk, DeviceInformationPacket)
    row = records.of(ap.DEVICE).fields[0]
    assert (row["firmware"], row["device"], row["hardware"]) == (
        device.software_version,
        device.device_id.value,
        device.hardware_revision,
    )
    assert row["serial"].tolist() == device.serial_number
    (formatted,) = decoded(sdk, FormattedTimePacket)
    row = records.of(ap.FORMATTED_TIME).fields[0]
    assert [int(row[n]) for n in ("us", "year", "year_day", "month", "day", "hour", "minute", "second")] == [
        formatted.microseconds,
        formatted.year,
        formatted.year_day,
        formatted.month,
        formatted.month_day,
        formatted.hour,
        formatted.minute,
        formatted.second,
    ]
    (euler,) = decoded(sdk, EulerOrientationStandardDeviationPacket)
    assert records.of(ap.EULER_SIGMA).fields["sigma"][0].tolist() == euler.standard_deviation
    with_sigma = log.states.dropna(subset=["sigma_roll_rad"])
    assert 0 < len(with_sigma) < 283  # only the states within a second of the one packet 26
    assert with_sigma["sigma_heading_rad"].unique().tolist() == [euler.standard_deviation[2]]
    (gnss,) = decoded(sdk, RawGNSSPacket)
    row = records.of(ap.RAW_GNSS).fields[0]
    assert [row["lat"], row["lon"], row["height"]] == gnss.position
    assert row["sigma"].tolist() == gnss.position_standard_deviation
    assert int(row["flags"]) & 7 == gnss.flags.fix_type == 0
    assert log.positions.empty
    (used,) = decoded(sdk, SatellitesPacket)
    assert records.of(ap.SATELLITES).fields["used"][0].tolist() == [
        used.gps_satellites,
        used.glonass_satellites,
        used.beidou_satellites,
        used.galileo_satellites,
        used.sbas_satellites,
    ]
    (depth,) = decoded(sdk, ExternalDepthPacket)
    assert log.depths["depth_m"].tolist() == [depth.depth]
