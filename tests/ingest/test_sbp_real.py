"""The SBP reader on Swift receivers' logs, message by message against the library ``sbp``."""

import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sbp.client import Framer
from sbp.client.drivers.file_driver import FileDriver

from thalweg.core import gps_from_week
from thalweg.ingest import PositionLog
from thalweg.ingest.sbp import SbpRecords, base_positions, collect, find_messages, messages as sm, read_sbp

pytestmark = pytest.mark.real

RTK = "sbp_piksi_rtk_2017/2017-05-12-v1.1.26.sbp"
COLD = "sbp_piksi_coldstart_2017/20170513-180207.1.1.26.bin"
FILTER = "sbp_libsbp_samples/filter.bin"
ROUNDTRIP = "sbp_libsbp_samples/roundtrip.sbp"
SHORT = "sbp_libsbp_samples/short.sbp"


def counts_of(log: PositionLog) -> dict[str, int]:
    """Messages by type and sender."""
    found: dict[str, int] = log.report.details["messages by type and sender"]
    return found


def library(path: Path) -> list[Any]:
    with path.open("rb") as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the library stamps each message with a deprecated utcnow()
        return [message for message, _ in Framer(FileDriver(stream).read, None, skip_metadata=True)]


@pytest.fixture(scope="module")
def rtk(data_dir):
    return read_sbp([data_dir / RTK])


@pytest.fixture(scope="module")
def rtk_start(data_dir, tmp_path_factory):
    """The first third of the log: the library takes its time."""
    path = tmp_path_factory.mktemp("rtk") / "start.sbp"
    path.write_bytes((data_dir / RTK).read_bytes()[:700_000])
    return path


@pytest.fixture(scope="module")
def rtk_library(rtk_start):
    return library(rtk_start)


def expected_fields(messages: list[Any], kind: int) -> dict[str, list[Any]]:
    """Columns of one message type as the library decodes it."""
    names = sm.LAYOUTS[kind].names or ()
    own = {"ns": "ns_residual"} if kind != sm.UTC_TIME else {}
    out: dict[str, list[Any]] = {name: [] for name in names}
    for m in messages:
        if m.msg_type == kind:
            for name in names:
                if kind == sm.OBS:
                    value = m.header.n_obs if name == "n_obs" else getattr(m.header.t, own.get(name, name))
                else:
                    value = getattr(m, own.get(name, name))
                out[name].append(value)
    return out


def same_as_library(records: SbpRecords, messages: list[Any]) -> int:
    compared = 0
    for kind in sm.LAYOUTS:
        found = records.of(kind)
        want = expected_fields(messages, kind)
        senders = [m.sender for m in messages if m.msg_type == kind]
        assert found.sender.tolist() == senders
        for name, values in want.items():
            assert_array_equal(found.fields[name], np.array(values, found.fields[name].dtype))
            compared += len(values)
    return compared


def test_every_wanted_message_of_the_rtk_log_equals_the_library(rtk_start, rtk_library):
    records = collect([rtk_start])
    assert same_as_library(records, rtk_library) > 50_000
    want = Counter((m.msg_type, m.sender) for m in rtk_library)
    assert records.counts == want
    signals = Counter((m.sender, o.sid.code) for m in rtk_library if m.msg_type == sm.OBS for o in m.obs)
    assert records.signals == signals


@pytest.mark.parametrize("name", [FILTER, ROUNDTRIP])
def test_every_wanted_message_of_other_firmware_equals_the_library(data_dir, name):
    messages, records = library(data_dir / name), collect([data_dir / name])
    same_as_library(records, messages)
    assert records.counts == Counter((m.msg_type, m.sender) for m in messages)
    assert records.signals == Counter(
        (m.sender, o.sid.code) for m in messages if m.msg_type == sm.OBS for o in m.obs
    )


def test_the_library_loses_sound_messages_behind_damage(data_dir):
    """Its framer swallows a damaged frame whole; what lies inside it is found here."""
    ours = find_messages(np.fromfile(data_dir / SHORT, np.uint8))
    theirs = library(data_dir / SHORT)
    assert len(theirs) == 2382  # PROVENANCE
    assert ours.kind.size == 2395
    mine, i = list(zip(ours.kind.tolist(), ours.sender.tolist(), ours.length.tolist(), strict=True)), 0
    for m in theirs:  # each of theirs is among ours, in the same order
        i = mine.index((m.msg_type, m.sender, m.length), i) + 1


def test_rtk_figures_of_the_provenance(rtk):
    report, t = rtk.report, rtk.positions["t_gps_s"].to_numpy()
    found = counts_of(rtk)
    assert (sum(found.values()), len(found)) == (59065, 32)
    assert (found["MsgObs 12027"], found["MsgObs 0"], found["MsgPosLLH 12027"]) == (1193, 1317, 4392)
    assert report.counts["ephemerides"] == 87
    assert report.counts["positions_without_fix_dropped"] == 396
    assert rtk.positions["fix"].value_counts().to_dict() == {"fixed": 3689, "float": 288, "single": 19}
    fixed = t[(rtk.positions["fix"] == "fixed").to_numpy()]
    # nanosecond residuals of the receiver's clock are below a microsecond here
    assert fixed[0] == pytest.approx(float(gps_from_week(1948, 499544.1)), abs=1e-6)
    assert fixed[-1] == pytest.approx(float(gps_from_week(1948, 499912.9)), abs=1e-6)
    assert t[0] == pytest.approx(float(gps_from_week(1948, 499513.4)), abs=1e-6)
    assert (report.counts["observation_epochs_base"], report.counts["observation_epochs_12027"]) == (439, 400)
    assert report.details["GPS - UTC"] == {"18.000 s": 3996}
    assert report.synchronised
    assert report.time_scale == "gps"
    assert not report.gaps
    assert report.rates_hz["positions"] == pytest.approx(10.0, rel=1e-5)
    assert report.losses == {"bytes_outside_messages": 102, "messages_cut_at_end": 1}


def test_rtk_solution_of_the_provenance(rtk, data_dir):
    base = base_positions(collect([data_dir / RTK]))
    assert base.shape == (440, 3)
    # the PROVENANCE prints four decimals of a metre, nine of a degree
    assert_allclose(base, [[-2706105.2018, -4261210.8062, 3885598.6411]] * 440, atol=5.1e-5)
    mean = rtk.positions[rtk.positions["fix"] == "fixed"][["lat_deg", "lon_deg", "h_ell_m"]].mean()
    assert_allclose(mean[:2], [37.773452126, -122.417872451], atol=5.1e-10)
    assert mean["h_ell_m"] == pytest.approx(-6.3070, abs=5.1e-5)
    row = rtk.positions.iloc[-1]
    sigmas = row[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].tolist()
    assert sigmas == pytest.approx([0.013, 0.013, 0.026], rel=1e-12)  # whole millimetres
    assert row["age_s"] == pytest.approx(0.9)
    assert row["n_sats"] == 9


def test_every_position_equals_the_library(rtk, rtk_library):
    want = [m for m in rtk_library if m.msg_type == sm.POS_LLH and m.flags & 7]
    assert len(want) > 1000
    found = rtk.positions.iloc[: len(want)]
    for name, key in (("lat_deg", "lat"), ("lon_deg", "lon"), ("h_ell_m", "height"), ("n_sats", "n_sats")):
        assert_array_equal(found[name], [getattr(m, key) for m in want])
    tow = np.array([m.tow for m in want])
    # the residual of MsgGPSTime is at most half a millisecond
    assert_allclose(found["t_gps_s"], gps_from_week(1948, tow * 1e-3), atol=5.001e-4)


def test_coldstart_figures_of_the_provenance(data_dir):
    log = read_sbp([data_dir / COLD])
    assert sum(counts_of(log).values()) == 61599
    assert {k: n for k, n in counts_of(log).items() if k.startswith("MsgObs ")} == {"MsgObs 12027": 1253}
    assert log.positions["fix"].value_counts().to_dict() == {"single": 4276}
    assert log.report.counts["positions_without_fix_dropped"] == 410
    assert log.positions["t_gps_s"].iloc[0] == pytest.approx(float(gps_from_week(1949, 3799.4)), abs=1e-6)
    assert log.positions["t_gps_s"].iloc[-1] == pytest.approx(float(gps_from_week(1949, 4226.9)), abs=1e-6)
    assert log.report.counts["observation_epochs_12027"] == 428
    assert "base_positions" not in log.report.counts


def test_covariances_are_turned_to_east_north_up(data_dir):
    log, cov = read_sbp([data_dir / FILTER]), collect([data_dir / FILTER]).of(sm.POS_LLH_COV).fields
    p = log.positions
    for name, want in (
        ("sigma_east_m", np.sqrt(cov["cov_e_e"].astype(float))),
        ("sigma_north_m", np.sqrt(cov["cov_n_n"].astype(float))),
        ("sigma_up_m", np.sqrt(cov["cov_d_d"].astype(float))),
        ("cov_en_m2", cov["cov_n_e"].astype(float)),
        ("cov_eu_m2", -cov["cov_e_d"].astype(float)),
        ("cov_nu_m2", -cov["cov_n_d"].astype(float)),
    ):
        assert_allclose(p[name], want, rtol=1e-12)  # products with exact ones and zeros
