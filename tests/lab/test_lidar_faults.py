"""Faults of the lidar in whole recordings: each alone, each where it should be."""

import numpy as np
import pytest

from tests.lab.captures import read
from tests.lab.conftest import SEED, record_lidar, short
from thalweg_lab.instruments import EchoKind
from thalweg_lab.river import Material
from thalweg_lab.river.waves import Waves
from thalweg_lab.voyage import Voyage, start_gps_s

QUIET = {"sigma_range_m": 0.0, "sigma_lateral_m": 0.0, "sigma_weak_m": 0.0}


OFF = {
    "footprint": {"divergence_mrad": 0.0},
    "mixed": {"mixed_pixels": False},
    "weak": {"sigma_weak_m": 0.0},
    "dark": {"dark_dropouts": False},
    "chance": {"dropouts": 0.0},
    "water": {"water_returns": 0.0},
    "wet": {"wet_reflectance": 1.0},
    "ghosts": {"mirror_ghosts": False},
    "hull": {"own_hull": False},
}
"""How each fault is switched off."""


LENGTH_S = 0.6
"""Six revolutions, 174,000 shots."""


@pytest.fixture(scope="module")
def all_faults(twin, tmp_path_factory):
    """A recording with all faults, and its capture."""
    path, config = tmp_path_factory.mktemp("faults") / "all.pcap", short(duration_s=LENGTH_S)
    return path, read(path, record_lidar(twin.scene, path, config), config)


def test_each_fault_can_be_switched_off_alone(record, all_faults):
    """Random numbers of one effect do not shift those of another, and each effect changes what it should."""
    found = {name: read(*record(name, lidar=change, duration_s=LENGTH_S)) for name, change in OFF.items()}
    full = all_faults[1]
    kind = full.truth["kind"]
    assert np.array_equal(np.flatnonzero(full.range_m), kind.index), "truth and log have the same shots"
    for name, number in (("mixed", EchoKind.MIXED), ("ghosts", EchoKind.GHOST), ("hull", EchoKind.HULL)):
        assert full.facts[name] == np.sum(kind == number) > 100
    assert min(full.facts[c] for c in ("hull_blocked", "dropouts_chance", "dropouts_weak")) > 100
    same, gone, new = {}, {}, {}
    boat = np.zeros(len(full.range_m), dtype=bool)
    boat[kind.index[kind == EchoKind.HULL]] = True
    for name, other in found.items():
        both = (full.range_m > 0) & (other.range_m > 0) & ~boat
        equal = (full.range_m == other.range_m) & (full.brightness == other.brightness)
        same[name] = float(np.mean(equal[both]))
        gone[name] = kind[other.range_m[kind.index] == 0]
        new[name] = other.truth.index[full.range_m[other.truth.index] == 0]
    assert all(same[name] == 1.0 for name in ("chance", "hull", "water", "ghosts")), same
    # A far echo that is too weak may be stronger than the near one that is reported instead.
    assert 0.999 < same["dark"] < 1.0
    assert set(gone["ghosts"]) == {EchoKind.GHOST}
    assert len(gone["ghosts"]) == pytest.approx(full.facts["ghosts"], rel=0.01)
    assert set(gone["hull"]) == {EchoKind.HULL}
    assert len(gone["hull"]) == pytest.approx(full.facts["hull"], rel=0.01)
    assert set(full.truth["material"][gone["water"].index]) == {Material.WATER}
    for name in ("ghosts", "water"):
        assert len(new[name]) == 0, name
    for name in ("dark", "chance"):
        assert len(gone[name]) == 0, name
    for name in ("weak", "mixed"):
        # Another range is another limit of detection, which matters for the weakest echoes.
        assert len(new[name]) + len(gone[name]) < 0.001 * len(kind), name
    for name in ("dark", "chance", "hull"):
        assert len(new[name]) > 100, name
    # The others touch some returns and leave the rest as they were: weak echoes, edges, wet ground.
    assert 0.5 < same["weak"] < 0.99
    assert 0.1 < same["mixed"] < 0.99
    assert 0.9 < same["wet"] < 0.9999
    wet = full.truth[(full.range_m != found["wet"].range_m)[full.truth.index]]
    assert np.all(wet["up_m"] < full.config.lidar.wet_band_m + 0.3)
    assert np.all(full.brightness[wet.index] <= found["wet"].brightness[wet.index])
    solid = kind.index[kind == EchoKind.SURFACE]
    assert (
        np.std((full.range_m - found["footprint"].range_m)[solid][found["footprint"].range_m[solid] > 0])
        > 0.005
    )


def test_ghosts_are_mirror_images_below_the_water(record, scene, mount):
    for slope in (0.0, 0.03):
        settings = {**QUIET, "divergence_mrad": 0.0, "wave_slope": slope}
        recording = read(*record(f"slope {slope}", lidar=settings, duration_s=1.0))
        ghost = recording.truth[recording.truth["kind"] == EchoKind.GHOST]
        origin, direction = recording.rays(ghost.index.to_numpy(), mount)
        length = recording.range_m[ghost.index]
        apparent = origin + length[:, None] * direction
        true = ghost[["east_m", "north_m", "up_m"]].to_numpy()
        assert len(ghost) > 1000
        # Azimuths in steps: 0.175 mm per metre.
        assert np.all(apparent[:, 2] < scene.water_level_m + 1.75e-4 * length)
        assert np.all(true[:, 2] > scene.water_level_m)
        assert Material.WATER not in ghost["material"].to_numpy()
        way = (origin[:, 2] - scene.water_level_m) / -direction[:, 2]
        place = origin + way[:, None] * direction
        t = ghost["t_gps_s"].to_numpy() - start_gps_s(recording.config)
        normal = Waves.draw(SEED, rms_slope=slope).normal(place[:, 0], place[:, 1], t)
        turned = direction - 2 * np.sum(direction * normal, axis=1)[:, None] * normal
        off = np.linalg.norm(place + (length - way)[:, None] * turned - true, axis=1) / length
        # Steps of azimuth, and of range: 1 mm at more than 4 m. Where a beam grazes, its step is centimetres
        # on the water, another slope; waves turn the images by 0.03 rad.
        assert np.median(off) < 0.0015
        assert slope > 0 or np.max(off) < 1.75e-4 + 0.001 / 4


def test_returns_of_the_own_boat_lie_on_it(all_faults):
    recording = all_faults[1]
    boat = recording.truth[recording.truth["kind"] == EchoKind.HULL]
    voyage, t = Voyage(recording.config, SEED), boat["t_gps_s"].to_numpy()
    assert len(boat) > 10_000
    assert set(boat["material"]) == {255}
    away = boat[["east_m", "north_m", "up_m"]].to_numpy() - voyage.position_wcs_m(t)
    body = np.einsum("nji,nj->ni", voyage.R_wcs_ics(t), away)
    # The HyDrone of T 2.1, 1.17 m by 0.74 m, whose water line is the boat's height below the INS.
    assert np.all(np.abs(body[:, 0]) < 1.17 / 2 + 0.001)
    assert np.all(np.abs(body[:, 1]) < 0.74 / 2 + 0.001)
    assert np.all(np.abs(body[:, 2] - recording.config.boat.height_m) < 0.75)
    # Nothing within the sensor's blind zone, less six sigma of its noise.
    assert recording.range_m[boat.index].min() > 0.4 - 6 * 0.0173
    assert recording.range_m[boat.index].max() < 1.2
    # What is behind the boat is hidden: no beam sees water straight below the scanner.
    water = recording.truth[recording.truth["material"] == Material.WATER]
    assert len(water[water["kind"] == EchoKind.SURFACE]) < 0.05 * len(boat)


def test_pieces_of_any_size_give_the_same_log(record, all_faults, monkeypatch):
    monkeypatch.setattr("thalweg_lab.instruments.lidar._CHUNK", 100)
    second, _, _ = record("small pieces", duration_s=LENGTH_S)
    assert all_faults[0].read_bytes() == second.read_bytes()
