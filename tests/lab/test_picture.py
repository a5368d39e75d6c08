"""Pictures: geometry of the rays, shadows, water, sky, sun, and that there is something to see."""

import datetime as dt
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from thalweg.core import GeometryError, LocalFrame
from thalweg.settings.twin import TwinConfig
from thalweg_lab.river import (
    Material,
    Scene,
    Waves,
    build_scene,
    developed,
    fresnel,
    half_sphere,
    hash01,
    metered,
    mirrored,
    refracted,
    smooth_normals,
    spread_ambient,
    under_water,
    vertex_normals,
)
from thalweg_lab.river_images import Sun, simulate_view, sky
from thalweg_lab.river_images.daylight import clear_sky
from thalweg_lab.river_images.picture import SKY, Painter, render
from thalweg_lab.river_images.pinhole import PictureCamera
from thalweg_lab.voyage import Voyage, start_unix

NOON = Sun(azimuth_rad=np.pi, elevation_rad=np.deg2rad(60.0))
CALM = Waves.draw(1, rms_slope=0.0)
RIPPLED = Waves.draw(1, rms_slope=0.04)


def quad(corners: np.ndarray) -> np.ndarray:
    return np.asarray(corners, dtype=np.float64)


def made(*parts: tuple[np.ndarray, Material], water_level_m: float = 0.0) -> Scene:
    """A scene of quadrilaterals."""
    vertices = np.concatenate([p for p, _ in parts])
    first = 4 * np.arange(len(parts))[:, None]
    triangles = np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])], axis=1).reshape(
        -1, 3
    )
    material = np.repeat(np.array([m for _, m in parts], dtype=np.uint8), 2)
    return Scene(
        vertices_wcs_m=vertices,
        triangles=triangles,
        material=material,
        water_level_m=water_level_m,
        variation=np.full(len(triangles), 0.5, dtype=np.float32),
    )


GROUND = quad([[-50, -50, 1], [50, -50, 1], [50, 50, 1], [-50, 50, 1]])
LID = quad([[-2, 8, 4], [2, 8, 4], [2, 12, 4], [-2, 12, 4]])


@pytest.fixture(scope="module")
def reach() -> Scene:
    return build_scene(TwinConfig.of_size("tiny"), 8)


# ---------------------------------------------------------------- camera


def test_a_known_triangle_appears_where_the_camera_says() -> None:
    board = quad([[-1.0, 10.0, 4.0], [1.0, 10.0, 4.0], [1.0, 10.0, 5.0], [-1.0, 10.0, 5.0]])
    camera = PictureCamera.look([0.5, 0.0, 3.0], [0.7, 10.0, 4.0], focal_px=200.0, size_px=(160, 120))
    picture = render(made((board, Material.CONCRETE)), camera, sun=NOON, waves=CALM)
    corner, depth = camera.project(board)
    assert np.all(depth > 0)
    rows, columns = np.nonzero(picture.material == Material.CONCRETE)
    # A pixel shows the board if its middle does: half a pixel at each side.
    assert columns.min() + 0.5 == pytest.approx(corner[:, 0].min(), abs=1.0)
    assert columns.max() + 0.5 == pytest.approx(corner[:, 0].max(), abs=1.0)
    assert rows.min() + 0.5 == pytest.approx(corner[:, 1].min(), abs=1.0)
    assert rows.max() + 0.5 == pytest.approx(corner[:, 1].max(), abs=1.0)
    # Range of the pixel that shows the middle of the board; float32 rays of 10 m.
    (u, v), _ = (a[0] for a in camera.project([[0.0, 10.0, 4.5]]))
    distance = np.linalg.norm(np.array([0.0, 10.0, 4.5]) - camera.position_wcs_m)
    assert picture.range_m[int(v), int(u)] == pytest.approx(distance, abs=0.01)


def test_rays_and_projection_are_inverse_and_level() -> None:
    camera = PictureCamera.look([1.0, 2.0, 3.0], [5.0, -3.0, 2.0], focal_px=90.0, size_px=(32, 24))
    ray = camera.rays((0.25, 0.75))
    pixel, _ = camera.project(camera.position_wcs_m + 7.0 * ray)
    column, row = np.meshgrid(np.arange(32) + 0.25, np.arange(24) + 0.75)
    np.testing.assert_allclose(pixel, np.stack([column.ravel(), row.ravel()], axis=1), atol=1e-10)
    # The picture's right is level, its down points down, and the target is in the middle.
    assert abs(camera.R_wcs_ccs[2, 0]) < 1e-12
    assert camera.R_wcs_ccs[2, 1] < 0
    np.testing.assert_allclose(camera.project([[5.0, -3.0, 2.0]])[0], [[16.0, 12.0]], atol=1e-9)
    assert np.all(np.isnan(camera.project(camera.position_wcs_m - camera.R_wcs_ccs[:, 2][None])[0]))


def test_cameras_that_cannot_be() -> None:
    with pytest.raises(GeometryError, match="no rotation"):
        PictureCamera(position_wcs_m=np.zeros(3), R_wcs_ccs=-np.eye(3), focal_px=10.0, size_px=(4, 4))
    with pytest.raises(GeometryError, match="above or below"):
        PictureCamera.look([0, 0, 5], [0, 0, 1], focal_px=10.0, size_px=(4, 4))
    below = PictureCamera.look([0, 0, -1], [0, 5, -1], focal_px=10.0, size_px=(4, 4))
    with pytest.raises(GeometryError, match="above the water"):
        render(made((GROUND, Material.SOIL)), below, sun=NOON, waves=CALM)


# ---------------------------------------------------------------- light


def test_a_lid_casts_a_shadow_where_the_sun_says() -> None:
    scene = made((GROUND, Material.CONCRETE), (LID, Material.WALL))
    camera = PictureCamera.look([0.0, -2.0, 9.0], [0.0, 11.0, 1.0], focal_px=150.0, size_px=(200, 160))
    image = render(scene, camera, sun=NOON, waves=CALM).image.astype(float).mean(axis=2)
    # Sun from the south at 60 degrees, lid 3 m up: its shadow is moved north by 3 / tan 60.
    shift = 3.0 / np.tan(np.deg2rad(60.0))

    def brightness(east: float, north: float) -> float:
        (u, v), _ = (a[0] for a in camera.project([[east, north, 1.0]]))
        return float(image[int(v) - 1 : int(v) + 2, int(u) - 1 : int(u) + 2].mean())

    sunny = brightness(-4.0, 12.0 + shift)
    assert brightness(-1.6, 11.7 + shift) < 0.75 * sunny
    assert brightness(1.6, 11.7 + shift) < 0.75 * sunny
    assert brightness(0.0, 12.4 + shift) == pytest.approx(sunny, rel=0.15)
    assert brightness(-2.5, 11.7 + shift) == pytest.approx(sunny, rel=0.15)


def test_the_sun_stands_where_almanacs_say() -> None:
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


def test_the_sky_is_bluer_up_and_brighter_at_the_sun_and_has_no_bands() -> None:
    up = np.deg2rad(np.linspace(1, 89, 400))
    d = np.stack([np.zeros(400), np.cos(up), np.sin(up)], axis=1)
    light = clear_sky(d, NOON)
    assert light[-1, 2] / light[-1, 0] > 1.5 * light[0, 2] / light[0, 0]
    assert np.max(np.abs(np.diff(light, axis=0))) < 0.02
    assert clear_sky(NOON.direction_wcs[None], NOON).min() > 10.0
    assert clear_sky(NOON.direction_wcs[None], NOON, with_sun=False).max() < 2.0
    clouds = sky(d, NOON, cover=0.9) - light
    assert np.abs(clouds).max() > 0.1
    np.testing.assert_array_equal(sky(d, NOON, cover=0.0), light)


def test_leaves_let_the_sun_through_and_boards_do_not() -> None:
    """A leaf seen against the sun is brighter than a board of its colour would be."""
    screen = quad([[-1.0, 10.0, 2.0], [1.0, 10.0, 2.0], [1.0, 10.0, 4.0], [-1.0, 10.0, 4.0]])
    behind = Sun(azimuth_rad=0.0, elevation_rad=np.deg2rad(30.0))
    camera = PictureCamera.look([0.0, 0.0, 3.0], [0.0, 10.0, 3.0], focal_px=100.0, size_px=(20, 20))
    front = PictureCamera.look([0.0, 20.0, 3.0], [0.0, 10.0, 3.0], focal_px=100.0, size_px=(20, 20))
    share = []
    for material in (Material.LEAF, Material.CONCRETE):
        painter = Painter(made((screen, material)), sun=behind, waves=CALM)
        dark, light = (painter.paint(c).image[5:15, 5:15].astype(float).mean() for c in (camera, front))
        share.append(dark / light)
    assert share[0] > share[1] + 0.05


# ---------------------------------------------------------------- water


def test_fresnel_and_snell() -> None:
    # ((n - 1) / (n + 1))^2 = 2.04 % straight down; everything at grazing incidence.
    assert fresnel(np.array([1.0]))[0] == pytest.approx((0.333 / 2.333) ** 2, rel=1e-12)
    assert fresnel(np.array([0.0]))[0] == pytest.approx(1.0, abs=1e-12)
    assert np.all(np.diff(fresnel(np.linspace(0, 1, 100))) < 0)
    a = np.deg2rad(50.0)
    ray, up = np.array([[np.sin(a), 0.0, -np.cos(a)]]), np.array([[0.0, 0.0, 1.0]])
    down = refracted(ray, up)[0]
    assert np.linalg.norm(down) == pytest.approx(1.0, abs=1e-12)
    assert down[0] == pytest.approx(np.sin(a) / 1.333, abs=1e-12)
    np.testing.assert_allclose(mirrored(ray, up), [[np.sin(a), 0.0, np.cos(a)]], atol=1e-15)


def test_deep_water_is_murk_and_shallow_water_shows_the_bed() -> None:
    bed, light = np.full((1, 3), 0.4), np.ones(3)
    deep = under_water(bed, np.array([30.0]), np.array([40.0]), light)
    other = under_water(0 * bed, np.array([30.0]), np.array([40.0]), light)
    np.testing.assert_allclose(deep, other, atol=1e-9)
    np.testing.assert_allclose(under_water(bed, np.zeros(1), np.zeros(1), light), 0.9 * bed)


def test_calm_water_mirrors_a_board_and_waves_blur_the_mirror() -> None:
    board = quad([[-30.0, 20.0, -1.0], [30.0, 20.0, -1.0], [30.0, 20.0, 6.0], [-30.0, 20.0, 6.0]])
    scene = made((board, Material.ROOF))
    camera = PictureCamera.look([0.0, 0.0, 2.0], [0.0, 20.0, 1.0], focal_px=120.0, size_px=(120, 100))
    calm, rippled = (render(scene, camera, sun=NOON, waves=w) for w in (CALM, RIPPLED))
    assert set(np.unique(calm.material)) == {int(Material.ROOF), int(Material.WATER), SKY}
    water = calm.material == Material.WATER
    height = np.full(water.shape, np.nan)
    ray = camera.rays().reshape(100, 120, 3)
    # Height at which the mirrored ray meets the board's plane.
    height[water] = (20.0 / ray[water][:, 1]) * -ray[water][:, 2] - 2.0
    red = calm.image[..., 0].astype(float) - calm.image[..., 2]
    assert np.median(red[water & (height < 5.0)]) > np.median(red[water & (height > 7.0)]) + 15
    # The same place of the mirror is uneven with waves. A calm mirror shows the roof's tiles only.
    sky_part = water & (height > 7.0)
    spread = [np.std(p.image[sky_part].astype(float).mean(axis=1)) for p in (calm, rippled)]
    assert spread[1] > 1.3 * spread[0]


# ---------------------------------------------------------------- helpers


def test_smooth_normals_round_a_ridge_and_lift_shadow_rays_off_it() -> None:
    v = np.array([[0.0, 0, 0], [0.0, 1, 0], [1.0, 0, -0.5], [1.0, 1, -0.5], [-1.0, 0, -0.5], [-1.0, 1, -0.5]])
    f = np.array([[0, 2, 3], [0, 3, 1], [0, 1, 5], [0, 5, 4]])
    corner = vertex_normals(v, f)
    np.testing.assert_allclose(corner[0], [0, 0, 1], atol=0.35)
    facet = np.cross(v[2] - v[0], v[3] - v[0])
    facet = facet / np.linalg.norm(facet)
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [0.4, 0.2]])
    normal, shift = smooth_normals(np.tile(facet, (3, 1)), v, corner, f, np.zeros(3, dtype=np.int64), uv)
    np.testing.assert_allclose(normal[:2], corner[[0, 2]], atol=1e-12)
    np.testing.assert_allclose(shift[:2], 0.0, atol=1e-12)
    assert shift[2] @ facet > 0.0


def test_rays_of_the_half_sphere_are_cosine_weighted() -> None:
    n = 40_000
    normal = np.tile(np.array([0.6, 0.0, -0.8]), (n, 1))
    way = half_sphere(normal, np.arange(n), 0, 1)
    np.testing.assert_allclose(np.linalg.norm(way, axis=1), 1.0, atol=1e-12)
    cosine = np.sum(way * normal, axis=1)
    assert cosine.min() >= 0.0
    # Mean of the cosine 2/3, of its square 1/2; sampling error 0.0012.
    assert cosine.mean() == pytest.approx(2 / 3, abs=0.006)
    assert np.mean(cosine**2) == pytest.approx(0.5, abs=0.006)
    u = hash01(np.arange(n), 5)
    assert u.min() >= 0.0
    assert u.max() < 1.0
    assert u.mean() == pytest.approx(0.5, abs=0.008)


def test_ambient_light_does_not_cross_edges_of_range() -> None:
    h, w = 20, 20
    ambient = np.zeros((h, w, 3))
    range_m = np.full((h, w), 5.0)
    range_m[:, 10:] = 9.0
    known = np.zeros((h, w), dtype=bool)
    known[::2, ::2] = True
    ambient[:, :10][known[:, :10]] = 0.1
    ambient[:, 10:][known[:, 10:]] = 0.8
    normal = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (h, w, 3)).copy()
    out = spread_ambient(ambient, range_m, normal, known, range_m, normal, 3)
    # What leaks is the least weight, 1e-4.
    np.testing.assert_allclose(out[:, :10], 0.1, atol=0.001)
    np.testing.assert_allclose(out[:, 10:], 0.8, atol=0.001)


def test_the_tone_curve_rises_and_keeps_black_black() -> None:
    grey = np.linspace(0, 8, 200)[:, None] * np.ones(3)
    tones = developed(grey, 1.0).astype(int)
    assert tones[0, 0] == 0
    assert np.all(np.diff(tones[:, 0]) >= 0)
    assert tones[-1, 0] >= 250


# ---------------------------------------------------------------- the reach


def test_the_reach_is_worth_looking_at(reach: Scene) -> None:
    camera = PictureCamera.look([0.0, 0.0, 1.2], [0.0, -14.0, 1.8], focal_px=170.0, size_px=(200, 120))
    painter = Painter(reach, sun=NOON, waves=RIPPLED)
    picture = painter.paint(camera, t_s=3.0)
    again = painter.paint(camera, t_s=3.0)
    np.testing.assert_array_equal(picture.image, again.image)
    later = painter.paint(camera, t_s=4.0)
    assert np.mean(picture.image[-30:] != later.image[-30:]) > 0.5
    kinds = set(np.unique(picture.material))
    assert {int(Material.WATER), SKY, int(Material.STONE)} <= kinds
    assert np.all(np.isfinite(picture.range_m) == (picture.material != SKY))
    # Not blank, not black, not burnt: tones spread over the scale.
    grey = picture.image.astype(float).mean(axis=2)
    assert np.std(grey) > 25
    assert np.mean(grey < 3) < 0.05
    assert np.mean(grey > 252) < 0.10


def test_finer_sampling_smooths_and_keeps_the_picture(reach: Scene) -> None:
    camera = PictureCamera.look([0.0, 0.0, 1.2], [0.0, -14.0, 1.8], focal_px=85.0, size_px=(100, 60))
    painter = Painter(reach, sun=NOON, waves=RIPPLED)
    coarse, fine = (painter.paint(camera, samples=s).image.astype(float) for s in (1, 2))
    rough = [np.mean(np.abs(np.diff(a, axis=1))) for a in (coarse, fine)]
    assert rough[1] < rough[0]
    assert abs(coarse.mean() - fine.mean()) < 4.0


def test_the_exposure_follows_the_light() -> None:
    rng = np.random.default_rng(1)
    light = rng.uniform(0.02, 0.3, (40, 60, 3))
    alone = developed(light, None)
    # As bright in the shade, where all light is a fifth, and with a few glints of the sun.
    assert np.array_equal(developed(0.2 * light, None), alone)
    glints = light.copy()
    glints[0, :10] = 50.0
    # Ten of 2,400 pixels move the quartile by half a percent: one step of 255 at most.
    assert np.max(np.abs(developed(glints, None).astype(int) - alone)[1:]) <= 1
    luminance = light @ [0.2126, 0.7152, 0.0722]
    grey = np.full((1, 1, 3), np.percentile(luminance, 75)) * metered(light)
    # 0.6 of white in sRGB.
    assert np.ptp(developed(grey, 1.0)) == 0
    assert developed(grey, 1.0)[0, 0, 0] == pytest.approx(0.6 * 255, abs=4)
    assert developed(np.zeros((2, 2, 3)), None).max() == 0


def test_the_near_picture_is_taken_where_the_bank_is_sunlit(reach: Scene, tmp_path: Path) -> None:
    config = TwinConfig.of_size("tiny", duration_s=20.0)
    voyage, frame = Voyage(config, 8), LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
    t = np.linspace(0.0, 20.0, 200)
    n = voyage.river.to_flow(*voyage.position_at(t)[:, :2].T)[1]
    place = voyage.position_at(t[[np.argmin(n)]])[0]
    sun = Sun.at(start_unix(config)[0], frame.lat_deg, frame.lon_deg).direction_wcs
    # A plate 15 m off in the way of the sun to what the nearest place shows.
    s = voyage.river.to_flow(place[:1], place[1:2])[0]
    shore = voyage.river.to_wcs(s, -voyage.river.shores(s)[0])[0]
    middle = np.append(shore, reach.water_level_m) + 15.0 * sun

    along = np.append(voyage.river.to_wcs(s + 1, 0 * s)[0] - voyage.river.to_wcs(s, 0 * s)[0], 0.0)
    across = np.cross(sun, along)

    def shown(name: str, half_m: float, half_across_m: float) -> np.ndarray:
        """Place of the camera under a plate of that size."""
        a, b = half_m * along, half_across_m * across
        corners = [middle - a - b, middle + a - b, middle + a + b, middle - a + b]
        faces = len(reach.vertices_wcs_m) + np.array([[0, 1, 2], [0, 2, 3]])
        shaded = replace(
            reach,
            vertices_wcs_m=np.vstack([reach.vertices_wcs_m, corners]),
            triangles=np.vstack([reach.triangles, faces]).astype(reach.triangles.dtype),
            material=np.append(reach.material, [Material.WALL] * 2).astype(np.uint8),
            variation=np.append(reach.variation, [0.0] * 2).astype(reach.variation.dtype),
        )
        shaded.write(tmp_path / f"{name}.npz")
        simulate_view(
            config,
            8,
            frame,
            tmp_path / f"{name}.npz",
            tmp_path / "a.npz",
            tmp_path / f"{name} b.npz",
            samples=1,
            shrink=16,
        )
        with np.load(tmp_path / f"{name} b.npz") as data:
            return np.array(json.loads(str(data["facts"]))["position_wcs_m"])

    free, shaded, dark = shown("free", 0.01, 0.01), shown("shaded", 3.0, 3.0), shown("dark", 60.0, 8.0)
    assert np.linalg.norm(shaded - free) > 0.5
    off = [voyage.river.to_flow(x[:1], x[1:2])[1][0] - n.min() for x in (free, shaded, dark)]
    # At most 3 m farther from the bank than the nearest one, which is taken in the sun and if all is shady.
    assert off[0] == pytest.approx(0.0, abs=0.05)
    assert 0.05 < off[1] < 3.05
    assert off[2] == pytest.approx(0.0, abs=0.05)


def test_views_are_written_and_say_where_they_are_from(reach: Scene, tmp_path: Path) -> None:
    config = TwinConfig.of_size("tiny", duration_s=8.0)
    reach.write(tmp_path / "scene.npz")
    frame = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
    outs = tmp_path / "bank.npz", tmp_path / "detail.npz"
    simulate_view(config, 8, frame, tmp_path / "scene.npz", *outs, samples=1, shrink=8)
    for out, (width, height) in zip(outs, ((200, 112), (150, 100)), strict=True):
        with np.load(out) as data:
            facts = json.loads(str(data["facts"]))
            assert data["image"].shape == (height, width, 3)
            assert data["range_m"].shape == data["material"].shape == (height, width)
        assert facts["sun_of_the_time"] is True
        assert 0.5 < facts["height_above_water_m"] < 2.0
        assert facts["pixel_mm"] == pytest.approx(1000 * facts["distance_m"] / facts["focal_px"], rel=0.01)
