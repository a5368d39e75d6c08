"""The other logs: other people's programs read them, and their errors are those of the settings."""

import json
import subprocess
import sys

import laspy
import numpy as np
import pandas as pd
import pytest
from advanced_navigation.anpp_packets.an_packet_20 import SystemStatePacket
from advanced_navigation.anpp_packets.an_packet_26 import EulerOrientationStandardDeviationPacket
from advanced_navigation.anpp_packets.an_packet_28 import RawSensorsPacket
from advanced_navigation.anpp_packets.an_packet_protocol import ANDecoder
from numpy.testing import assert_allclose
from pynmeagps import NMEAReader
from pyproj import CRS, Transformer
from sbp.client import Framer
from sbp.client.drivers.file_driver import FileDriver

from tests.lab.conftest import ANTENNA_M, ECHO_M, FRAME, SEED, true_depth_m
from thalweg.core import gps_from_unix, gps_from_week, roll_pitch_heading
from thalweg.workflow.codehash import imported_modules, reached_modules
from thalweg_lab import writers
from thalweg_lab.instruments import (
    Solution,
    antenna_errors_m,
    attitude_errors_rad,
    simulate_gnss,
    simulate_ins,
    stated_sigmas_m,
    velocity_errors_mps,
)
from thalweg_lab.river import Material
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import Voyage, epochs


def sdk_packets(path):
    """Packets of an ANPP log as the manufacturer's SDK finds them; it returns one object again and again."""
    decoder = ANDecoder()
    decoder.buffer = bytearray()
    decoder.decode_iterator = 0
    decoder.crc_errors = 0
    decoder.add_data(path.read_bytes())
    out = []
    while (packet := decoder.decode()) is not None:
        out.append((int(packet.id), packet.header + packet.data))
    assert decoder.crc_errors == 0
    return out


def sdk_decode(kind, raw):
    class Envelope:
        id = kind.ID
        data = raw[5:]

    packet = kind()
    assert packet.decode(Envelope) == 0
    return packet


def ins_states(path):
    """States of the INS as the SDK decodes them."""
    return [sdk_decode(SystemStatePacket, raw) for identifier, raw in sdk_packets(path) if identifier == 20]


def test_the_ins_log_is_read_by_the_manufacturers_sdk(twin):
    path = twin.path("ins.anpp")
    packets = sdk_packets(path)
    assert b"".join(raw for _, raw in packets) == path.read_bytes(), "no byte outside of packets"
    counts = pd.Series([i for i, _ in packets]).value_counts().to_dict()
    n = twin.facts["ins"]["states"]
    assert n == 400
    assert counts == {20: n, 26: n, 28: n, 21: 8, 22: 8, 3: 1}
    raw = next(sdk_decode(RawSensorsPacket, r) for i, r in packets if i == 28)
    # Nearly level and slow: gravity along -z of the body within the sway.
    assert raw.accelerometers[2] == pytest.approx(-9.81, abs=0.3)
    sigma = next(sdk_decode(EulerOrientationStandardDeviationPacket, r) for i, r in packets if i == 26)
    assert_allclose(sigma.standard_deviation, np.deg2rad([0.1, 0.1, 0.2]), rtol=1e-6)


def test_the_ins_states_are_the_true_pose_with_the_drawn_errors(twin):
    states = ins_states(twin.path("ins.anpp"))
    t = epochs(twin.config, 50.0)
    stamps = [float(gps_from_unix(p.unix_time_seconds, p.microseconds)) for p in states]
    assert_allclose(stamps, t, atol=1.2e-7)
    voyage = twin.voyage
    lat, lon, h = np.array([[p.latitude, p.longitude, p.height] for p in states]).T
    lat, lon = np.rad2deg(lat), np.rad2deg(lon)
    R_local = np.swapaxes(FRAME.R_wcs_enu(lat, lon), 1, 2)
    angles = np.stack(roll_pitch_heading(R_local @ voyage.R_wcs_ics(t)), axis=1)
    error = np.array([p.orientation for p in states]) - angles
    error = np.mod(error + np.pi, 2 * np.pi) - np.pi
    drawn = attitude_errors_rad(twin.config, SEED, t, voyage.start_gps_s)
    # float32 angles up to 2 pi resolve 5e-7.
    assert_allclose(error, drawn, atol=6e-7)
    v = voyage.velocity_wcs_mps(t)[:, [1, 0, 2]] * [1, 1, -1]
    drawn = velocity_errors_mps(twin.config, SEED, len(t))
    # The level at the boat differs from that of the origin by 50 m / 6.4e6 m.
    assert_allclose(np.array([p.velocity for p in states]) - v, drawn, atol=1e-4)
    off = FRAME.from_geodetic(lat, lon, h) - voyage.position_wcs_m(t)
    assert 0.05 < np.sqrt(np.mean(off**2)) < 3.0, "single-frequency positions"


def test_attitude_errors_have_their_sigmas_two_sided():
    config = TwinConfig.of_size("tiny", ins={"attitude_time_s": 0.2})
    found = np.concatenate(
        [attitude_errors_rad(config, seed, epochs(config, 50.0), 0.0) for seed in range(40)]
    )
    # 40 runs of 29 s with 0.2 s correlation: 2,900 independent values, sigma known to 1.3 %.
    assert_allclose(np.rad2deg(found.std(axis=0)), [0.1, 0.1, 0.2], rtol=0.06)
    drifting = TwinConfig.of_size("tiny", ins={"heading_drift_degpmin": 6.0})
    t = epochs(config, 50.0)
    drift = attitude_errors_rad(drifting, 1, t, t[0]) - attitude_errors_rad(
        TwinConfig.of_size("tiny"), 1, t, t[0]
    )
    assert_allclose(np.rad2deg(drift[-1]), [0, 0, 2.9], atol=1e-6)


def test_an_ins_without_utc_counts_from_1970(twin, tmp_path):
    config = twin.config.model_copy(
        update={"effects": twin.config.effects.model_copy(update={"ins_clock_late_s": 1.0})}
    )
    simulate_ins(config, SEED, FRAME, tmp_path / "late.anpp")
    rows = ins_states(tmp_path / "late.anpp")
    known = np.array([p.filter_status.utc_time_initialised for p in rows])
    unix = np.array([p.unix_time_seconds for p in rows])
    assert np.array_equal(known, unix > 1_000_000_000)
    # 2 s of lead and 1 s of delay at 50 Hz, the first state included.
    assert np.sum(~known) == pytest.approx(150, abs=1)


POS_HEAD = """GPST latitude(deg) longitude(deg) height(m) Q ns
sdn(m) sde(m) sdu(m) sdne(m) sdeu(m) sdun(m) age(s) ratio"""
POS_NAMES = "date time lat lon h q ns sdn sde sdu sdne sdeu sdun age ratio"


def read_pos(path):
    lines = path.read_text().splitlines()
    head = [line for line in lines if line.startswith("%")]
    assert head[-1].split()[1:] == POS_HEAD.split()
    rows = [line.split() for line in lines if not line.startswith("%")]
    table = pd.DataFrame(rows, columns=POS_NAMES.split())
    clock = pd.to_datetime(table["date"] + " " + table["time"], format="%Y/%m/%d %H:%M:%S.%f")
    seconds = (clock - pd.Timestamp("1980-01-06")).dt.total_seconds()
    return table.iloc[:, 2:].astype(float).assign(t=seconds - 1e9)


def sbp_messages(path):
    with FileDriver(path.open("rb")) as driver, Framer(driver.read, None) as framer:
        return [message for message, _ in framer]


def antenna(voyage, t):
    return voyage.position_wcs_m(t) + voyage.R_wcs_ics(t) @ ANTENNA_M


def fixed_errors(config, seed, engine, n):
    """Errors of n epochs with fixed solutions."""
    kinds = np.full(n, int(Solution.FIXED))
    return antenna_errors_m(config, seed, engine, kinds, stated_sigmas_m(config.gnss, kinds))


READSOL = """
import json, os, sys
import pyrtklib5 as rtk
buffer = rtk.solbuf_t()
assert rtk.readsol([sys.argv[1]], 1, buffer) == 1
rows, kept = [], []
for k in range(buffer.n):
    s = rtk.getsol(buffer, k)
    kept.append(s)  # the wrapper frees what belongs to the buffer
    values = [s.rr[i] for i in range(3)] + [s.qr[i] for i in range(3)]
    rows.append([s.time.time + s.time.sec, s.stat, s.ns, *values])
print(json.dumps(rows), flush=True)
os._exit(0)
"""


def test_rtklib_itself_reads_the_track(twin):
    """RTKLIB's readsol in a process of its own (C code): epochs, fix, satellites, position, variances."""
    run = subprocess.run(
        [sys.executable, "-c", READSOL, str(twin.path("ppk.pos"))], capture_output=True, text=True, check=True
    )
    found = np.array(json.loads(run.stdout.splitlines()[-1]))
    table = read_pos(twin.path("ppk.pos"))
    assert len(found) == len(table)
    assert set(found[:, 1]) == {1}
    wcs = FRAME.from_ecef(found[:, 3:6])
    mine = FRAME.from_geodetic(table["lat"], table["lon"], table["h"])
    # nine digits of a degree are 0.1 mm, four of a metre 0.05 mm
    assert_allclose(wcs, mine, atol=5e-4)
    ecef_trace = found[:, 6:9].sum(axis=1)
    assert_allclose(ecef_trace, (table[["sdn", "sde", "sdu"]] ** 2).sum(axis=1), rtol=1e-3)


def test_positions_are_the_antennas_with_the_drawn_errors(twin):
    n = 80
    table = read_pos(twin.path("ppk.pos"))
    assert len(table) == n == twin.facts["gnss"]["epochs_written"]
    t = table["t"].to_numpy()
    assert_allclose(t, epochs(twin.config, 10.0), atol=1e-6)
    error = FRAME.from_geodetic(table["lat"], table["lon"], table["h"]) - antenna(twin.voyage, t)
    drawn = fixed_errors(twin.config, SEED, "ppk", n)
    # Nine decimals of a degree are 0.06 mm, four of a metre 0.05 mm.
    assert_allclose(error, drawn, atol=1e-4)
    assert (table["q"] == 1).all()
    assert_allclose(table[["sdn", "sde", "sdu"]], [[0.02, 0.02, 0.03]] * n)


def test_the_sbp_log_is_read_by_swifts_library(twin):
    path = twin.path("rover.sbp")
    messages = sbp_messages(path)
    assert sum(len(m.to_binary()) for m in messages) == path.stat().st_size, "no byte outside of messages"
    kinds = pd.Series([type(m).__name__ for m in messages]).value_counts().to_dict()
    assert {k: v for k, v in kinds.items() if v == 80} == dict.fromkeys(
        ["MsgGPSTime", "MsgUtcTime", "MsgPosLLH", "MsgPosLLHCov", "MsgVelNED"], 80
    )
    assert kinds["MsgHeartbeat"] == kinds["MsgBasePosECEF"] == 9
    senders = {type(m).__name__: m.sender for m in messages}
    assert senders["MsgBasePosECEF"] == 0
    assert senders["MsgPosLLH"] != 0
    pos = [m for m in messages if type(m).__name__ == "MsgPosLLH"]
    gps = [m for m in messages if type(m).__name__ == "MsgGPSTime"]
    utc = [m for m in messages if type(m).__name__ == "MsgUtcTime"]
    t = np.array([float(gps_from_week(m.wn, m.tow / 1000)) for m in gps])
    assert_allclose(t, epochs(twin.config, 10.0), atol=1e-6)
    for m, stamp in zip(utc, t, strict=True):
        clock = pd.Timestamp(m.year, m.month, m.day, m.hours, m.minutes, m.seconds, tz="UTC").timestamp()
        assert float(gps_from_unix(clock, m.ns / 1000)) == pytest.approx(stamp, abs=1e-6)
    error = FRAME.from_geodetic(
        [m.lat for m in pos], [m.lon for m in pos], [m.height for m in pos]
    ) - antenna(twin.voyage, t)
    drawn = fixed_errors(twin.config, SEED, "rtk", 80)
    # Doubles: only the geodetic round trip remains.
    assert_allclose(error, drawn, atol=1e-6)
    assert {m.flags for m in pos} == {4}


def test_outages_and_float_solutions(tmp_path):
    config = TwinConfig.of_size("tiny", effects={"gnss_outages": [[5, 3]], "gnss_floats": [[10, 4]]})
    facts = simulate_gnss(
        config, SEED, FRAME, tmp_path / "a.sbp", tmp_path / "a.pos", lever_ics_antenna_m=ANTENNA_M
    )
    table = read_pos(tmp_path / "a.pos")
    since = table["t"].to_numpy() - Voyage(config, SEED).start_gps_s
    assert facts["epochs"] - facts["epochs_written"] == 30
    assert not np.any((since > 5.0 - 1e-6) & (since < 8.0 - 1e-6))
    assert np.array_equal(table["q"] == 2, (since > 10.0 - 1e-6) & (since < 14.0 - 1e-6))
    assert table.loc[table["q"] == 2, "sde"].unique().tolist() == [0.3]
    modes = {m.flags for m in sbp_messages(tmp_path / "a.sbp") if type(m).__name__ == "MsgPosLLH"}
    assert modes == {3, 4}


def test_the_depth_log_is_read_by_pynmeagps(twin, scene):
    with twin.path("echo.nmea").open("rb") as file:
        parsed = [message for _, message in NMEAReader(file, quitonerror=2)]
    kinds = pd.Series([m.msgID for m in parsed]).value_counts().to_dict()
    assert kinds == {"RMC": 80, "DPT": 80, "DBT": 80, "GGA": 9, "ZDA": 9}
    depths = np.array([m.depth for m in parsed if m.msgID == "DPT"], dtype=float)
    below = np.array([m.depthm for m in parsed if m.msgID == "DBT"], dtype=float)
    assert np.array_equal(depths, below)
    assert {float(m.offset) for m in parsed if m.msgID == "DPT"} == {0.1}
    rmc = [m for m in parsed if m.msgID == "RMC"]
    stamps = [pd.Timestamp(f"{m.date} {m.time}", tz="UTC").timestamp() for m in rmc]
    t = np.array([float(gps_from_unix(s)) for s in stamps])
    assert_allclose(t, epochs(twin.config, 10.0), atol=0.006)
    residual = depths - true_depth_m(twin.voyage, scene, epochs(twin.config, 10.0), ECHO_M)
    # 80 values: sigma known to 8 %; steps of 1 cm add 3 mm in square.
    assert np.std(residual) == pytest.approx(twin.config.echo.sigma_m, rel=0.3)
    assert abs(np.mean(residual)) < 4 * 0.02 / 9


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (51.0, "5100.0000000,N,01315.0000000,E"),
        (-0.5, "0030.0000000,S,01315.0000000,E"),
        (59.99999999999, "6000.0000000,N,01315.0000000,E"),
    ],
)
def test_minutes_never_print_as_sixty(value, text):
    assert text in writers.rmc(1620809998_500000, value, 13.25, 1.0, -10.0)


def test_scans_lie_on_the_surface_within_their_noise(twin, scene):
    crs = CRS.from_epsg(25833)
    caster = scene.without(Material.WATER).caster()
    for number, facts in enumerate(twin.facts["tls"]["stations"], start=1):
        with laspy.open(twin.path(f"tls_{number}.laz")) as reader:
            assert str(reader.header.version) == "1.4"
            parsed = reader.header.parse_crs()
            assert parsed.to_epsg() == 25833
            cloud = reader.read()
        assert len(cloud) == facts["points"] > 2000
        assert set(cloud.point_source_id) == {number}
        # Map coordinates back into the local frame, through the geographic coordinates of the grid.
        back = Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True)
        lon, lat = back.transform(cloud.x, cloud.y)
        points = FRAME.from_geodetic(lat, lon, cloud.z)
        way = points - np.array(facts["centre_wcs_m"])
        reach = np.linalg.norm(way, axis=1)
        hits = caster.cast(np.array(facts["centre_wcs_m"]), way / reach[:, None])
        off = (reach - hits.t_hit_m)[np.abs(reach - hits.t_hit_m) < 0.05]
        assert len(off) > 0.9 * len(reach)
        distance = caster.closest_points(points).distance_m
        # Points of several surfaces in one footprint lie between them: 0.7 % are mixed, some of them by 5 cm.
        near = distance < 0.02
        assert np.mean(near) > 0.985
        # 3 mm at 50 m in 3D; stations see the bank at 25 to 60 m; steps of 1 mm in the file.
        assert np.sqrt(np.mean(distance[near] ** 2)) < 0.004
        assert 0.0003 < np.median(distance) < 0.003


FORMULAS = {
    "core/frames.py": ("core/test_frames.py", "Rotation.from_euler"),
    "core/rigid.py": ("core/test_adjustment.py", "source @ truth.T"),
    "core/camera.py": ("core/test_camera.py", "cv2.fisheye"),
    "core/timescales.py": ("core/test_timescales.py", "dt.datetime"),
    "core/geometry/raycast.py": ("core/test_raycast.py", "test_slanting_rays_meet_a_plane"),
    "calibration/marker_sheets.py": ("calibration/test_marker_sheets.py", "cv2.aruco.generateImageMarker"),
    "panorama/sphere.py": ("panorama/test_sphere.py", '"EQUIRECTANGULAR"'),
    "lightsheet/optics/interfaces.py": ("lightsheet/test_optics.py", "test_fermat"),
    "lightsheet/optics/refractive_index.py": ("lightsheet/test_optics.py", "Schiebener et al. 1990"),
    "lightsheet/optics/sensor.py": ("lightsheet/test_intersection.py", "test_golden_points_of_paper_4"),
}
"""Modules with formulas that the generators share with the processing: an error in one would cancel in every
comparison of the twin. Each has a test against an oracle outside of both (another library, published or
golden values, a closed form): the test file, and the words in it that name the oracle."""

HOLDERS = {
    "calibration/field/points.py": "writes the file of the points of the light-sheet series",
    "core/calibration/model.py": "true values with their names",
    "core/errors.py": "messages, and how far a long step is",
    "core/installed.py": "packages of extras",
    "core/kernels.py": "how loops are compiled",
    "core/tables.py": "files",
    "core/las.py": "the plausible extent of a scan",
    "core/geometry/mesh.py": "true surfaces",
    "core/trajectory.py": "writes the truth",
    "core/types.py": "types, and how large the drawn errors are, for the truth's facts",
    "images/model/poses.py": "true poses of images",
}
"""Modules that the generators use to hold and write what they made; none of their formulas shapes a log."""

BEHIND = {
    "core/documents.py",
    "core/values/stated.py",
    "core/values/units.py",
    "lightsheet/optics/refraction.py",
}
"""What the modules above import for their other functions; no generator imports it itself."""


GENERATORS = (
    "dual_fisheye",
    "instruments",
    "random_numbers",
    "reach",
    "river",
    "river_images",
    "tank",
    "time_lapse",
    "voyage",
    "writers",
    "yard",
    "yard_images",
    "yard_records",
)
"""Packages and modules of the laboratory that simulate."""


def of_library(modules, package):
    """Those outside of the laboratory and the settings."""
    names = {m.relative_to(package) for m in modules if m.is_relative_to(package) and m.name != "__init__.py"}
    return {name.as_posix() for name in names if name.parts[0] != "settings"}


def test_the_twin_shares_no_code_with_the_processing(repository):
    """But for what is named above, module by module; a name that is not used any more has to go."""
    package = repository / "src" / "thalweg"
    # studies and comparisons with the truth process by design
    laboratory = package.parent / "thalweg_lab"
    places = [(laboratory / name, laboratory / f"{name}.py") for name in GENERATORS]
    generators = [p for folder, module in places for p in [module, *folder.rglob("*.py")] if p.is_file()]
    reached = set().union(*(reached_modules(path) for path in generators))
    assert not any("studies" in path.parts for path in reached)
    direct = of_library(set().union(*(imported_modules(path) for path in generators)), package)
    assert direct == {*FORMULAS, *HOLDERS}
    assert of_library(reached, package) - direct == BEHIND
    for module, (test, oracle) in FORMULAS.items():
        assert oracle in (repository / "tests" / test).read_text(), f"{module} has lost its oracle in {test}"
