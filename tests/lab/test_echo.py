"""The echo sounder of the twin: its beam, its water, its faults, and what the truth says of each."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.lab.conftest import ECHO_M, FRAME, SEED, short
from thalweg.core import read_table
from thalweg.ingest import PositionLog
from thalweg.ingest.nmea import read_nmea
from thalweg_lab.instruments import TRUE_SOUNDINGS, simulate_echo
from thalweg_lab.reach import River
from thalweg_lab.river import Material, Scene
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import Voyage

LEVEL = ([-200, -200, -2.5], [200, -200, -2.5], [200, 200, -2.5], [-200, 200, -2.5])
CALM = {"roll_deg": 0.0, "pitch_deg": 0.0, "yaw_deg": 0.0, "heave_m": 0.0, "heel_share": 0.0}


def bed(folder: Path, corners: Any = LEVEL, *boxes: Any) -> Path:
    """A plane of bed, and stones: flat squares (east, north, half side, up)."""
    vertices, triangles, material = [list(corners)], [[0, 1, 2], [0, 2, 3]], [Material.BED] * 2
    for k, (east, north, half, up) in enumerate(boxes):
        vertices.append(
            [[east + half * x, north + half * y, up] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        )
        first = 4 * (k + 1)
        triangles += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
        material += [Material.STONE] * 2
    Scene(
        vertices_wcs_m=np.concatenate([np.array(v, dtype=np.float64) for v in vertices]),
        triangles=np.array(triangles),
        material=np.array([int(m) for m in material], dtype=np.uint8),
        water_level_m=0.0,
    ).write(folder / "scene.npz")
    return folder / "scene.npz"


def record(
    folder: Path, mesh: Path, echo: dict[str, Any], boat: dict[str, Any] | None = None, **changes: Any
) -> tuple[PositionLog, pd.DataFrame, dict[str, Any]]:
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


def dpt(log: PositionLog) -> np.ndarray:
    return log.depths.loc[log.depths["sentence"] == "DPT", "depth_m"].to_numpy()


def test_cold_water_looks_deeper(tmp_path):
    """10 degrees, 1500 m/s assumed: 1447.3 m/s make 9 cm at 2.5 m (Marczak 1997)."""
    log, truth, facts = record(tmp_path, bed(tmp_path), {"assumed_sound_speed_mps": 1500.0})
    np.testing.assert_allclose(truth["depth_m"], 2.4, atol=1e-5)
    np.testing.assert_allclose(dpt(log), 2.4 * 1500 / 1447.27, atol=0.006)
    assert facts["sound_speed_mps"] == pytest.approx(1447.27, abs=0.02)
    assert not facts["effects"]


@pytest.mark.parametrize("slope", [0.02, 0.3, 0.65])
def test_the_beam_returns_the_nearest_place_of_a_slope(tmp_path, slope):
    """In closed form cos(theta) within the half angle, else cos(theta) / cos(theta - beta)."""
    corners = [[e, n, -2.5 + slope * n] for e, n in ((-300, -3), (300, -3), (300, 3), (-300, 3))]
    boat = {**CALM, "zigzag_deg": 0.0, "speed_mps": 0.2}
    log, truth, _ = record(
        tmp_path, bed(tmp_path, corners), {"beam_deg": 5.0}, boat, scene={"meander_deg": 0.0}
    )
    theta, beta = np.arctan(slope), np.deg2rad(2.5)
    vertical = truth["depth_m"]
    expected = vertical * np.cos(theta) / np.cos(max(theta - beta, 0.0))
    # the rays leave out what lies between the rings and the rim of the cone's nearest direction
    np.testing.assert_allclose(truth["first_m"], expected, atol=0.002)
    assert (truth["first_m"] >= expected - 1e-4).all()
    np.testing.assert_allclose(dpt(log), truth["first_m"], atol=0.006)
    if slope == 0.65:
        assert float(np.mean(vertical - truth["first_m"])) == pytest.approx(0.067 * 2.4 / 2.5, rel=0.1)


def test_boulders_are_met_only_if_switched_on(tmp_path):
    scene = bed(tmp_path, LEVEL, (0.0, 0.0, 6.0, -1.5))
    off, truth_off, _ = record(tmp_path, scene, {"beam_deg": 5.0})
    assert dpt(off).min() > 2.38
    assert not (truth_off["effect"] == "boulder").any()
    on, truth, facts = record(tmp_path, scene, {"beam_deg": 5.0, "boulders": True})
    stone = (truth["effect"] == "boulder").to_numpy()
    assert 3 < stone.sum() < len(stone) - 3
    np.testing.assert_allclose(dpt(on)[stone], 1.4, atol=0.02)
    np.testing.assert_allclose(truth["depth_m"], 2.4, atol=1e-5)
    assert facts["effects"] == {"boulder": int(stone.sum())}


def test_each_blunder_is_named_and_has_its_share(tmp_path):
    shares = {"second_echo_share": 0.1, "spike_share": 0.1, "no_bottom_share": 0.1}
    log, truth, facts = record(tmp_path, bed(tmp_path), {**shares, "zeros": True, "rate_hz": 50.0})
    named = truth["effect"].value_counts()
    n = len(truth)
    for name in ("spike", "no bottom"):
        # binomial: four sigmas
        assert named[name] / n == pytest.approx(0.1, abs=4 * np.sqrt(0.09 / n))
    assert facts["effects"] == named.drop("").to_dict()
    depth = dpt(log)
    quiet = (truth["effect"] == "").to_numpy()
    np.testing.assert_allclose(depth[quiet], 2.4, atol=0.006)
    # over the surface once more: 0.1 m of water above the face
    second = (truth["effect"] == "second echo").to_numpy()
    np.testing.assert_allclose(depth[second], 4.9, atol=0.006)
    assert (depth[(truth["effect"] == "no bottom").to_numpy()] == 0).all()
    np.testing.assert_allclose(truth["blunder_m"][quiet], 0.0, atol=1e-12)
    np.testing.assert_allclose(truth["blunder_m"][second], 2.5, atol=1e-3)


def test_own_filters_smooth_and_come_late(tmp_path):
    """On a slope a window of k pings lags by half of it; the median takes single spikes out."""
    corners = [[e, n, -5.0 + 0.1 * e] for e, n in ((-30, -30), (30, -30), (30, 30), (-30, 30))]
    scene, boat = bed(tmp_path, corners), {**CALM, "zigzag_deg": 0.0}
    plain, _, _ = record(tmp_path, scene, {"rate_hz": 10.0}, boat, scene={"meander_deg": 0.0})
    late, truth, facts = record(
        tmp_path,
        scene,
        {"rate_hz": 10.0, "median_pings": 5, "spike_share": 0.05},
        boat,
        scene={"meander_deg": 0.0},
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
    _, truth, facts = record(tmp_path, bed(tmp_path), {"latency_s": 0.4})
    np.testing.assert_allclose(truth["stamp_gps_s"] - truth["t_gps_s"], 0.4, atol=1e-6)
    assert facts["latency_s"] == 0.4


def test_tilt_moves_the_place_and_is_stated(tmp_path):
    echo = {"tilt_deg": (4.0, -3.0), "tilt_sentences": True, "temperature_sentences": True}
    log, truth, _ = record(tmp_path, bed(tmp_path), {**echo, "water_temperature_c": 12.3})
    voyage = Voyage(short(boat=CALM), SEED)
    t = truth["t_gps_s"].to_numpy()
    face, heading = voyage.sensor_wcs_m(t, ECHO_M), voyage.angles_rad(t)[2]
    off = truth[["east_m", "north_m"]].to_numpy() - face[:, :2]
    ahead = off[:, 0] * np.sin(heading) + off[:, 1] * np.cos(heading)
    right = off[:, 0] * np.cos(heading) - off[:, 1] * np.sin(heading)
    np.testing.assert_allclose(ahead, 2.4 * np.tan(np.deg2rad(4.0)), atol=2e-3)
    np.testing.assert_allclose(right, -2.4 * np.tan(np.deg2rad(3.0)), atol=2e-3)
    assert log.report.details["water_temperature_c"] == 12.3
    assert log.report.details["pitch_deg"] == pytest.approx(4.0, abs=0.8)
    assert log.report.details["roll_deg"] == pytest.approx(3.0, abs=0.8)


def test_weeds_return_early_where_they_grow(tmp_path):
    scene = {"weeds_cover": 0.4, "weeds_height_m": 0.6}
    log, truth, _ = record(tmp_path, bed(tmp_path), {"weed_share": 1.0, "rate_hz": 50.0}, None, scene=scene)
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
    np.testing.assert_allclose((moved.position_wcs_m(t) - plain.position_wcs_m(t))[:, 2], expected, atol=1e-4)
    np.testing.assert_allclose(moved.water_level_m(t), expected, atol=1e-4)
    up = moved.position_wcs_m(t)[:, 2]
    np.testing.assert_allclose(np.gradient(up, t)[2:-2], moved.velocity_wcs_mps(t)[2:-2, 2], atol=5e-3)
    # the ground falls with the water: depths stay
    assert moved.river.height(np.array(50.0), np.array(0.0)) == pytest.approx(
        plain.river.height(np.array(50.0), np.array(0.0)) - 0.25
    )


def patterned(pattern: str, **boat: Any) -> Voyage:
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
    np.testing.assert_allclose(np.diff(crossings), 12.0, atol=0.6)
    speed = np.linalg.norm(voyage.velocity_wcs_mps(t)[:, :2], axis=1)
    np.testing.assert_allclose(speed, 1.2, rtol=0.02)
