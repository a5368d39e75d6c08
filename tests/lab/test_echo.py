"""The echo sounder of the twin: its beam, its water, its faults, and what the truth says of each."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.lab.conftest import ECHO_M, FRAME, SEED, short
from tests.lab.sheets import bed, level, sheet
from thalweg.core import read_table
from thalweg.ingest.nmea import read_nmea
from thalweg_lab.instruments import TRUE_SOUNDINGS, simulate_echo
from thalweg_lab.reach import River
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import Voyage

LEVEL = level(-2.5)
CALM = {"roll_deg": 0.0, "pitch_deg": 0.0, "yaw_deg": 0.0, "heave_m": 0.0, "heel_share": 0.0}


def record(folder, mesh, echo, boat=None, **changes):
    config = short(echo={"sigma_m": 0.0, **echo}, boat=CALM if boat is None else boat, **changes)
    simulate_echo(
        config,
        SEED,
        FRAME,
        mesh,
        folder / "echo.nmea",
        lever_ics_echo_m=ECHO_M,
        out_effects=folder / "echo.json",
        out_soundings=folder / "soundings.parquet",
    )
    truth, _ = read_table(folder / "soundings.parquet", TRUE_SOUNDINGS)
    return read_nmea([folder / "echo.nmea"]), truth, json.loads((folder / "echo.json").read_text())


def dpt(log):
    return log.depths.loc[log.depths["sentence"] == "DPT", "depth_m"].to_numpy()


def test_cold_water_looks_deeper(tmp_path):
    """10 degrees, 1500 m/s assumed: 1447.3 m/s make 9 cm at 2.5 m (Marczak 1997)."""
    log, truth, facts = record(tmp_path, bed(tmp_path, LEVEL), {"assumed_sound_speed_mps": 1500.0})
    assert_allclose(truth["depth_m"], 2.4, atol=1e-5)
    assert_allclose(dpt(log), 2.4 * 1500 / 1447.27, atol=0.006)
    assert facts["sound_speed_mps"] == pytest.approx(1447.27, abs=0.02)
    assert not facts["effects"]


@pytest.mark.parametrize("slope", [0.02, 0.3, 0.65])
def test_the_beam_returns_the_nearest_place_of_a_slope(tmp_path, slope):
    """In closed form cos(theta) within the half angle, else cos(theta) / cos(theta - beta)."""
    plane = sheet([0, 0, -2.5], [300, 0, 0], [0, 3, 3 * slope])
    boat = {**CALM, "zigzag_deg": 0.0, "speed_mps": 0.2}
    log, truth, _ = record(
        tmp_path, bed(tmp_path, plane), {"beam_deg": 5.0}, boat, scene={"meander_deg": 0.0}
    )
    theta, beta = np.arctan(slope), np.deg2rad(2.5)
    vertical = truth["depth_m"]
    expected = vertical * np.cos(theta) / np.cos(max(theta - beta, 0.0))
    # the rays leave out what lies between the rings and the rim of the cone's nearest direction
    assert_allclose(truth["first_m"], expected, atol=0.002)
    assert (truth["first_m"] >= expected - 1e-4).all()
    assert_allclose(dpt(log), truth["first_m"], atol=0.006)
    if slope == 0.65:
        assert float(np.mean(vertical - truth["first_m"])) == pytest.approx(0.067 * 2.4 / 2.5, rel=0.1)


def test_boulders_are_met_only_if_switched_on(tmp_path):
    scene = bed(tmp_path, LEVEL, sheet([0, 0, -1.5], [6, 0, 0], [0, 6, 0]))
    off, truth_off, _ = record(tmp_path, scene, {"beam_deg": 5.0})
    assert dpt(off).min() > 2.38
    assert not (truth_off["effect"] == "boulder").any()
    on, truth, facts = record(tmp_path, scene, {"beam_deg": 5.0, "boulders": True})
    stone = (truth["effect"] == "boulder").to_numpy()
    assert 3 < stone.sum() < len(stone) - 3
    assert_allclose(dpt(on)[stone], 1.4, atol=0.02)
    assert_allclose(truth["depth_m"], 2.4, atol=1e-5)
    assert facts["effects"] == {"boulder": int(stone.sum())}


def test_each_blunder_is_named_and_has_its_share(tmp_path):
    shares = {"second_echo_share": 0.1, "spike_share": 0.1, "no_bottom_share": 0.1}
    log, truth, facts = record(tmp_path, bed(tmp_path, LEVEL), {**shares, "zeros": True, "rate_hz": 50.0})
    named = truth["effect"].value_counts()
    n = len(truth)
    for name in ("spike", "no bottom"):
        # binomial: four sigmas
        assert named[name] / n == pytest.approx(0.1, abs=4 * np.sqrt(0.09 / n))
    assert facts["effects"] == named.drop("").to_dict()
    depth = dpt(log)
    quiet = (truth["effect"] == "").to_numpy()
    assert_allclose(depth[quiet], 2.4, atol=0.006)
    # over the surface once more: 0.1 m of water above the face
    second = (truth["effect"] == "second echo").to_numpy()
    assert_allclose(depth[second], 4.9, atol=0.006)
    assert (depth[(truth["effect"] == "no bottom").to_numpy()] == 0).all()
    assert_allclose(truth["blunder_m"][quiet], 0.0, atol=1e-12)
    assert_allclose(truth["blunder_m"][second], 2.5, atol=1e-3)


def test_own_filters_smooth_and_come_late(tmp_path):
    """On a slope a window of k pings lags by half of it; the median takes single spikes out."""
    scene, boat = bed(tmp_path, sheet([0, 0, -5], [30, 0, 3], [0, 30, 0])), {**CALM, "zigzag_deg": 0.0}
    filtered = {"median_pings": 5, "spike_share": 0.05}
    (plain, _, _), (late, truth, facts) = (
        record(tmp_path, scene, {"rate_hz": 10.0, **more}, boat, scene={"meander_deg": 0.0})
        for more in ({}, filtered)
    )
    assert facts["filter_delay_s"] == pytest.approx(0.2)
    # 2 pings of 0.24 m on a slope of 0.1
    step = np.median(np.diff(dpt(plain)))
    shift = np.median((dpt(late) - dpt(plain))[10:])
    assert shift == pytest.approx(-2 * step, abs=0.01)
    spikes = (truth["effect"] == "spike").to_numpy()
    assert spikes.any()
    assert np.abs(truth["blunder_m"]).max() < 0.2


def test_latency_stamps_late(tmp_path):
    _, truth, facts = record(tmp_path, bed(tmp_path, LEVEL), {"latency_s": 0.4})
    assert_allclose(truth["stamp_gps_s"] - truth["t_gps_s"], 0.4, atol=1e-6)
    assert facts["latency_s"] == 0.4


def test_tilt_moves_the_place_and_is_stated(tmp_path):
    echo = {"tilt_deg": (4.0, -3.0), "tilt_sentences": True, "temperature_sentences": True}
    log, truth, _ = record(tmp_path, bed(tmp_path, LEVEL), {**echo, "water_temperature_c": 12.3})
    voyage = Voyage(short(boat=CALM), SEED)
    t = truth["t_gps_s"].to_numpy()
    face, heading = voyage.sensor_wcs_m(t, ECHO_M), voyage.angles_rad(t)[2]
    off = truth[["east_m", "north_m"]].to_numpy() - face[:, :2]
    ahead = off[:, 0] * np.sin(heading) + off[:, 1] * np.cos(heading)
    right = off[:, 0] * np.cos(heading) - off[:, 1] * np.sin(heading)
    assert_allclose(ahead, 2.4 * np.tan(np.deg2rad(4.0)), atol=2e-3)
    assert_allclose(right, -2.4 * np.tan(np.deg2rad(3.0)), atol=2e-3)
    assert log.report.details["water_temperature_c"] == 12.3
    assert log.report.details["pitch_deg"] == pytest.approx(4.0, abs=0.8)
    assert log.report.details["roll_deg"] == pytest.approx(3.0, abs=0.8)


def test_weeds_return_early_where_they_grow(tmp_path):
    weedy, echo = {"weeds_cover": 0.4, "weeds_height_m": 0.6}, {"weed_share": 1.0, "rate_hz": 50.0}
    log, truth, _ = record(tmp_path, bed(tmp_path, LEVEL), echo, None, scene=weedy)
    weeds = (truth["effect"] == "weeds").to_numpy()
    assert 0.05 < weeds.mean() < 0.9
    short_by = 2.4 - dpt(log)
    assert short_by[weeds].min() > 0.01
    assert short_by[weeds].max() < 0.61
    assert np.abs(short_by[~weeds]).max() < 0.006
    river = River(short(scene={"weeds_cover": 0.3}).scene, SEED)
    s, n = np.meshgrid(np.linspace(-60, 60, 500), np.linspace(-6, 6, 60))
    assert np.mean(river.weed_height_m(s, n) > 0) == pytest.approx(0.3, abs=0.12)


def test_the_boat_rides_on_water_that_falls():
    slope = {"water_fall_m_per_km": 5.0}
    plain, moved = Voyage(short(), SEED), Voyage(short(scene=slope), SEED)
    t = plain.start_gps_s + np.linspace(-1.0, 5.0, 61)
    s, _ = plain.river.to_flow(*plain.position_wcs_m(t)[:, :2].T)
    expected = -0.005 * s
    assert_allclose((moved.position_wcs_m(t) - plain.position_wcs_m(t))[:, 2], expected, atol=1e-4)
    assert_allclose(moved.water_level_m(t), expected, atol=1e-4)
    up = moved.position_wcs_m(t)[:, 2]
    assert_allclose(np.gradient(up, t)[2:-2], moved.velocity_wcs_mps(t)[2:-2, 2], atol=5e-3)
    # the ground falls with the water: depths stay
    assert moved.river.height(np.array(50.0), np.array(0.0)) == pytest.approx(
        plain.river.height(np.array(50.0), np.array(0.0)) - 0.25
    )


def patterned(pattern, **boat):
    config = TwinConfig.of_size(
        "demo", boat={"pattern": pattern, "turn_rate_degps": 30.0, "bank_distance_m": 3.0, **boat}
    )
    return Voyage(config, SEED)


def test_sections_cross_the_river_at_their_distance():
    voyage = patterned("sections", line_spacing_m=12.0)
    t = voyage.start_gps_s + np.arange(0.0, 180.0, 0.1)
    s, n = voyage.river.to_flow(*voyage.position_wcs_m(t)[:, :2].T)
    limit = 0.94 * 20.0 - 3.0
    assert n.max() == pytest.approx(limit, abs=0.1)
    assert n.min() == pytest.approx(-limit, abs=0.1)
    crossings = s[np.flatnonzero(np.diff(np.sign(n)))]
    assert_allclose(np.diff(crossings), 12.0, atol=0.6)
    speed = np.linalg.norm(voyage.velocity_wcs_mps(t)[:, :2], axis=1)
    assert_allclose(speed, 1.2, rtol=0.02)
