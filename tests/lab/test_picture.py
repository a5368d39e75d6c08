"""Light of the twin's pictures: sun, sky, shadows, water; and the views from the boat."""

import datetime as dt

import numpy as np
import pytest

from tests.lab.sheets import scene_of, sheet
from thalweg.core import Camera, GeometryError
from thalweg_lab.river import Material, Waves
from thalweg_lab.river_images import Sun
from thalweg_lab.time_lapse.renderer import Renderer, World
from thalweg_lab.yard import looking
from thalweg_lab.yard_images import LensRays

NOON = Sun(azimuth_rad=np.pi, elevation_rad=np.deg2rad(60.0))
RIPPLED = Waves.draw(1, rms_slope=0.04)


def camera(focal_px, size_px):
    """Without distortion, principal point in the middle."""
    middle = [size_px[0] / 2, size_px[1] / 2]
    return Camera(
        model="perspective", size_px=size_px, parameters=np.array([focal_px, focal_px, *middle, *[0.0] * 5])
    )


def seen(scene, lens, T_wcs_ccs, *, sun=NOON, waves=None):
    """Linear light (h, w, 3)."""
    renderer = Renderer(World(scene, None, NOON), LensRays(lens), waves=waves, boat=None, clouds=False)
    return renderer.see(T_wcs_ccs, np.eye(3), t_s=0.0, grain=1)


# ---------------------------------------------------------------- camera


def test_a_known_board_appears_where_the_camera_says():
    board, empty = (sheet([0, north, 4.5], [1, 0, 0], [0, 0, 0.5]) for north in (10, -10))
    lens, pose = camera(200.0, (160, 120)), looking(np.array([0.5, 0.0, 3.0]), np.array([0.7, 10.0, 4.0]))
    with_it, without = (
        seen(scene_of((q, Material.CONCRETE), level_m=0.0), lens, pose) for q in (board, empty)
    )
    rows, columns = np.nonzero(np.abs(with_it - without).max(axis=2) > 1e-3)
    corner = lens.project(pose.inverse().apply(board[0]))
    # water mirrors the board far below it
    mine = rows < 100
    # A pixel shows the board if a part of it does: a pixel at each side.
    assert columns[mine].min() == pytest.approx(corner[:, 0].min(), abs=1.0)
    assert columns[mine].max() + 1 == pytest.approx(corner[:, 0].max(), abs=1.0)
    assert rows[mine].min() == pytest.approx(corner[:, 1].min(), abs=1.0)
    # The picture's right is level, its down points down.
    assert abs(pose.R[2, 0]) < 1e-12
    assert pose.R[2, 1] < 0
    with pytest.raises(GeometryError, match="above or below"):
        looking(np.array([0.0, 0.0, 5.0]), np.array([0.0, 0.0, 1.0]))


# ---------------------------------------------------------------- light


def test_a_lid_casts_a_shadow_where_the_sun_says():
    ground, lid = sheet([0, 0, 1], [50, 0, 0], [0, 50, 0]), sheet([0, 10, 4], [2, 0, 0], [0, 2, 0])
    world = World(scene_of((ground, Material.CONCRETE), (lid, Material.WALL), level_m=0.0), None, NOON)
    # Sun from the south at 60 degrees, lid 3 m up: its shadow is moved north by 3 / tan 60.
    shift = 3.0 / np.tan(np.deg2rad(60.0))
    places = [(0.0, 10.0), (1.99, 11.99), (-1.99, 8.01), (2.01, 10.0), (0.0, 12.01), (0.0, 7.99)]
    below = np.array([[east, north + shift, 1.0] for east, north in places])
    up = np.tile([0.0, 0.0, 1.0], (len(below), 1))
    assert world.sunlit(below, up).tolist() == [0, 0, 0, 1, 1, 1]


def test_the_sun_stands_where_almanacs_say():
    # Greenwich, summer solstice 2021, true noon about 12:02 UTC: elevation 90 - 51.48 + 23.44.
    noon_s = dt.datetime(2021, 6, 21, 12, 2, tzinfo=dt.UTC).timestamp()
    noon = Sun.at(noon_s, 51.48, 0.0)
    assert np.rad2deg(noon.elevation_rad) == pytest.approx(61.96, abs=0.05)
    assert np.rad2deg(noon.azimuth_rad) == pytest.approx(180.0, abs=0.5)
    # Equinox on the equator, an hour before true noon (12:07:25 with an equation of time of -7:25).
    hour = Sun.at(dt.datetime(2021, 3, 20, 11, 7, 25, tzinfo=dt.UTC).timestamp(), 0.0, 0.0)
    assert np.rad2deg(hour.elevation_rad) == pytest.approx(75.0, abs=0.1)
    assert np.rad2deg(hour.azimuth_rad) == pytest.approx(90.0, abs=0.5)
    np.testing.assert_allclose(
        hour.direction_wcs, [np.cos(np.deg2rad(75)), 0, np.sin(np.deg2rad(75))], atol=2e-3
    )
    with pytest.raises(GeometryError, match="above the horizon"):
        Sun.at(noon_s + 43_200.0, 51.48, 0.0)


# ---------------------------------------------------------------- water


def test_calm_water_mirrors_a_board_and_waves_blur_the_mirror():
    board = sheet([0, 20, 2.5], [30, 0, 0], [0, 0, 3.5])
    scene, lens = scene_of((board, Material.ROOF), level_m=0.0), camera(120.0, (120, 100))
    pose = looking(np.array([0.0, 0.0, 2.0]), np.array([0.0, 20.0, 1.0]))
    calm, rippled = (seen(scene, lens, pose, waves=waves) for waves in (None, RIPPLED))
    ray = LensRays(lens).rays_ccs.astype(np.float64) @ pose.R.T
    # what the ray meets first, and the height at which its mirror image meets the board's plane
    water = (ray[..., 2] < 0) & (-2.0 / ray[..., 2] * ray[..., 1] < 20.0)
    height = np.where(water, (20.0 / ray[..., 1]) * -ray[..., 2] - 2.0, np.nan)
    red = calm[..., 0] - calm[..., 2]
    assert np.median(red[water & (height < 5.0)]) > np.median(red[water & (height > 7.0)]) + 0.02
    sky_part = water & (height > 7.0)
    spread = [np.std(light[sky_part].mean(axis=1)) for light in (calm, rippled)]
    assert spread[1] > 1.3 * spread[0]
