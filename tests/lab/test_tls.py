"""Terrestrial scans: spacing, noise and footprint as stated, leaves at 1550 nm, rays only where of use."""

import laspy
import numpy as np
import pytest

from tests.lab.conftest import FRAME, SEED
from tests.lab.sheets import scene_of, sheet
from thalweg.core import laz_header
from thalweg_lab.instruments import simulate_tls
from thalweg_lab.instruments.tls import Station, station_positions
from thalweg_lab.reach import River
from thalweg_lab.river import REFLECTANCE_1550, Material, Scene
from thalweg_lab.settings import TwinConfig, TwinTls

QUIET = {"sigma_50m_m": 0.0, "sigma_floor_m": 0.0, "divergence_mrad": 0.0}


def at(scene, centre, caster, **changes):
    """A station with other settings, its random numbers being those of number 1."""
    return Station.standing(TwinTls(**changes), SEED, 1, centre, scene, caster)


@pytest.fixture(scope="module")
def caster(scene):
    return scene.caster()


@pytest.fixture(scope="module")
def centre(twin, caster):
    """The middle one of three stations."""
    places = station_positions(twin.config, River(twin.config.scene, SEED), 3, caster)
    return places[1]


def facing_wall(distance_m):
    """A wall square to +y, and 10,000 rays that meet it within 0.2 degrees of the middle."""
    wall = sheet([0, distance_m, 0], [50, 0, 0], [0, 0, 50])
    aside = np.random.default_rng(1).uniform(-0.003, 0.003, (10_000, 1))
    direction = np.column_stack([aside, np.ones(10_000), np.zeros(10_000)])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return scene_of((wall, Material.WALL), level_m=-100.0), direction, np.arange(10_000)


@pytest.mark.parametrize(
    ("floor_m", "distance_m", "sigma_m"),
    [
        # 1 mm and sqrt(3^2 - 1^2) mm at 50 m, that one in proportion to the distance.
        (0.001, 1.0, 0.0010016),
        (0.001, 25.0, 0.0017321),
        (0.001, 50.0, 0.003),
        (0.001, 100.0, 0.0057446),
        # No floor: in proportion to the distance. All floor: the same everywhere.
        (0.0, 1.0, 0.00006),
        (0.0, 100.0, 0.006),
        (0.003, 1.0, 0.003),
        (0.003, 100.0, 0.003),
    ],
)
def test_noise_is_three_millimetres_at_50_m(floor_m, distance_m, sigma_m):
    wall, direction, ray = facing_wall(distance_m)
    found = at(wall, np.zeros(3), wall.caster(), divergence_mrad=0.0, sigma_floor_m=floor_m).shoot(
        ray, direction
    )
    error = found.points_wcs_m - distance_m * direction / direction[:, 1:2]
    # P2 5.1: 3 mm in 3D at 50 m. n = 10,000: 0.7 % a component, 0.4 % in all; four times that.
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) == pytest.approx(sigma_m, rel=0.02)
    np.testing.assert_allclose(np.std(error, axis=0), sigma_m / 3**0.5, rtol=0.03)
    np.testing.assert_allclose(found.reflectance, REFLECTANCE_1550[Material.WALL], rtol=1e-4)


def test_points_on_the_far_shore_have_the_spacing_of_the_settings(twin, tmp_path):
    config = TwinConfig.of_size("tiny", tls={"spacing_m": 0.05, "coordinates": "local", **QUIET})
    simulate_tls(config, SEED, FRAME, twin.path("scene.npz"), [tmp_path / "1.laz"], crs="EPSG:25833")
    assert laz_header(tmp_path / "1.laz").frame == FRAME  # or they would pass for coordinates of the grid
    cloud = laspy.read(tmp_path / "1.laz")
    points = np.column_stack([cloud.x, cloud.y, cloud.z])
    river = River(config.scene, SEED)
    centre = station_positions(config, river, 1, Scene.read(twin.path("scene.npz")).caster())[0]
    away = points - centre
    azimuth, flat = np.arctan2(away[:, 1], away[:, 0]), np.hypot(away[:, 0], away[:, 1])
    shore = (np.abs(flat - (config.scene.width_m + 3.0)) < 1.0) & (np.abs(azimuth + np.pi / 2) < 0.3)
    assert np.sum(shore) > 1000
    columns = np.unique(np.round(azimuth[shore], 4))
    step = np.median(np.diff(columns[np.concatenate([[True], np.diff(columns) > 5e-4])]))
    # Coordinates in steps of 1 mm blur the azimuth by 0.04 mrad of 2 mrad.
    assert step * (config.scene.width_m + 3.0) == pytest.approx(0.05, rel=0.05)


def test_stations_stand_where_they_see_the_other_bank(twin, caster):
    river = River(twin.config.scene, SEED)
    nominal = station_positions(twin.config, river, 3)
    chosen = station_positions(twin.config, river, 3, caster)
    assert np.all(np.linalg.norm((nominal - chosen)[:, :2], axis=1) < 3.0)

    def view(place):
        a = -np.pi / 2 + np.linspace(-0.7, 0.7, 141)
        e = np.deg2rad([-3.0, 0.0, 3.0])[:, None] + 0 * a
        rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1).reshape(-1, 3)
        return np.mean(caster.cast(place, rays).t_hit_m > 8.0)

    assert all(view(b) >= view(a) - 0.05 for a, b in zip(nominal, chosen, strict=True))
    assert min(view(b) for b in chosen) > 0.5
