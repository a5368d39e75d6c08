"""Pieces of the masks on pictures of a few pixels: components, mirrors, horizons, and images of a camera that
stayed.
"""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from thalweg.core import NMAD, InputError, rotation_x
from thalweg.images.masks import images as masks, learning
from thalweg.images.masks.learning import HULL, LAND, MOVED, SKY, WATER
from thalweg.settings.sections import MaskSettings


def grid(*rows):
    """True where there is an x."""
    return np.array([[c == "x" for c in row] for row in rows])


def grey(values):
    return np.repeat(np.asarray(values, np.uint8)[..., None], 3, axis=2)


def test_specks_go_and_what_stays_is_wider_by_a_pixel():
    part = np.zeros((12, 12), bool)
    part[3:6, 3:6] = True
    part[9:11, 8:10] = True  # two by two
    wanted = np.zeros((12, 12), bool)
    wanted[2:7, 2:7] = True
    np.testing.assert_array_equal(masks._opened(part), wanted)


def test_holes_and_smaller_cut_off_pieces_are_filled():
    ring = grid(
        ".......",
        ".xxxx..",
        ".x..x..",
        ".xxxx..",
        ".......",
    )  # fmt: skip
    filled = ring.copy()
    filled[2, 2:4] = True
    np.testing.assert_array_equal(masks._filled(ring), filled)
    # a hull across the image: what it cuts off below is smaller than itself, what lies above is not
    across = grid("......", "......", "xxxxxx", "xxxxxx", "......")
    wanted = across.copy()
    wanted[4] = True
    np.testing.assert_array_equal(masks._filled(across), wanted)
    thin = grid("......", "......", "xxxxxx", "......", "......")
    np.testing.assert_array_equal(masks._filled(thin), thin)
    assert masks._filled(np.ones((3, 3), bool)).all()


def test_pieces_that_hold_some_of_a_core_or_reach_the_top():
    part = grid("x..x", "x.xx", "....", "xx..")
    core = grid("....", "..x.", "....", "..x.")
    np.testing.assert_array_equal(learning.connected_with(part, core), grid("...x", "..xx", "....", "...."))
    np.testing.assert_array_equal(learning.reaches_top(part), grid("x..x", "x.xx", "....", "...."))


def test_sure_sky_in_wide_pieces():
    """A window of three: a strip of two goes; the top and large pieces are open, small ones alone not."""
    odds = np.full((100, 100), -1.0, np.float32)
    odds[:5, :5] = 2.1
    odds[20:22, 20:60] = 9.0
    odds[40:46, 40:46] = 9.0  # 36 of 10,000 pixels: less than four thousandths
    odds[70:77, 70:77] = 9.0
    odds[:5, 50:60] = 2.0  # not sure
    wide, sure = masks.open_sky(odds)
    inside = np.zeros((100, 100), bool)
    inside[:5, :5] = inside[70:77, 70:77] = True
    np.testing.assert_array_equal(sure, inside)
    inside[40:46, 40:46] = True
    np.testing.assert_array_equal(wide, inside)


def test_colours_against_the_sure_sky_nearby():
    """Windows of 16 % of the height: 17 pixels of a picture of 100."""
    features = np.zeros((100, 60, 7), np.float32)
    features[..., 0], features[..., 1], features[..., 2] = 5.0, 0.5, 0.25
    sure = np.zeros((100, 60), bool)
    sure[:20] = True
    features[:20, :30, 0], features[:20, 30:, 0] = 7.0, 9.0
    against, near = masks.against_sky(features, sure)
    assert near[:28].all()
    assert not near[28:].any()
    np.testing.assert_allclose(against[24, 10], [-2.0, 0.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(against[24, 50], [-4.0, 0.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(against[24, 30], [5.0 - (8 * 7 + 9 * 9) / 17, 0.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(against[60, 30], [5.0, 0.5, 0.25])


def model_of(by_first):
    """Odds of class 0 are the first feature."""

    def log_probability(features):
        return np.stack([by_first * features[..., 0], np.zeros(features.shape[:-1])], axis=-1)

    return SimpleNamespace(log_probability=log_probability)


def test_pixels_of_sky_by_two_models_and_specks_of_land():
    may_be = np.ones((100, 100), bool)
    may_be[80:] = False
    features = np.zeros((100, 100, 7), np.float32)
    features[..., 0] = np.where(np.arange(100)[:, None] < 40, 5.0, -5.0)
    features[10, 10] = -5.0  # a bird
    features[20:22, 50:58] = -5.0  # 16 of 10,000 pixels stand alone
    features[60:70, 20:40] = 5.0  # a white wall, wide, without sky nearby
    features[48:51, 20:22] = 0.5
    rough = masks.SkyModel(model_of(1.0), None)
    sky = masks.sky_pixels(rough, features, may_be)
    wanted = (features[..., 0] > 0) & may_be
    wanted[10, 10] = True
    np.testing.assert_array_equal(sky, wanted)
    # by colours against the sky: the difference from it decides, with caution for leaves
    near = SimpleNamespace(
        log_probability=lambda d: np.stack([d[..., 0] + 9.5, np.zeros(d.shape[:-1])], axis=-1)
    )
    features[41:44, 70:90, 0] = -5.4  # 10.4 below the sky: odds of -0.9
    features[44:46, 70:90, 0] = -5.6
    both = masks.sky_pixels(masks.SkyModel(model_of(1.0), near), features, may_be)
    assert both[41:44, 75:85].all()
    assert not both[44:46, 75:85].any()
    assert both[60:70, 20:40].all()  # wide, with nothing near to compare with
    assert not both[48:51, 20:22].any()
    low = features.copy()
    low[79, 50] = 5.0
    low[79, 51] = -5.0
    assert not masks.sky_pixels(rough, low, may_be)[79, 51]  # held by what lies below


def test_smooth_and_bright_is_like_sky():
    sky = np.zeros((64, 64), bool)
    sky[:32] = True
    image = grey(np.where(sky, 200, 90))
    assert masks.looks_like_sky(image, sky, ~sky)
    assert not masks.looks_like_sky(grey(np.where(sky, 80, 90)), sky, ~sky)
    assert not masks.looks_like_sky(image, sky, np.zeros_like(sky))
    assert masks.looks_like_sky(image, np.zeros_like(sky), ~sky)
    assert masks._gradient(np.broadcast_to(0.25 * np.arange(9.0, dtype=np.float32), (9, 9)))[0][
        4, 4
    ] == pytest.approx(0.25)
    assert masks._gradient(np.broadcast_to(0.25 * np.arange(9.0, dtype=np.float32)[:, None], (9, 9)))[1][
        4, 4
    ] == pytest.approx(0.25)


def test_land_without_what_has_the_colour_of_the_sky():
    rng = np.random.default_rng(2)
    sky = rng.normal([9, 1, 0, 0, 0], 0.1, (300, 5)).astype(np.float32)
    land = rng.normal([4, 0, 1, 0, 0], 0.5, (300, 5)).astype(np.float32)
    clouds = rng.normal([9, 1, 0, 5, 5], 0.1, (80, 5)).astype(np.float32)
    np.testing.assert_array_equal(masks.trimmed(np.concatenate([land, clouds]), sky), land)
    few = rng.normal([4, 0, 1, 0, 0], 0.5, (50, 5)).astype(np.float32)
    mixed = np.concatenate([few, clouds])
    np.testing.assert_array_equal(masks.trimmed(mixed, sky), mixed)


# ---------------------------------------------------------------- what keeps its place


def test_a_still_scene_knows_its_light_and_what_always_moves():
    """Six pictures of one light, each as a whole brighter or darker; a patch flickers, another one comes."""
    base = np.full((30, 40), 92.0)
    base[:, 26:] = 142.0
    pictures = []
    for k in range(6):
        light = (base + 8.0) * (1.0 + 0.1 * k)
        light[5:12, 5:12] *= 1.5 if k % 2 else 1.0
        pictures.append(grey(np.round(light - 8.0)))
    still = masks.StillScene.of(pictures)
    assert still.varies[6:11, 6:11].all()
    assert not still.varies[:, 16:].any()
    assert float(still.scatter.min()) == pytest.approx(masks._NOISE)
    now = pictures[0].copy()
    moved = still.moved(now)
    np.testing.assert_array_equal(moved, still.varies)
    now[20:26, 30:36] = 200
    moved = still.moved(now)
    assert moved[20:26, 30:36].all()
    assert not moved[:, 16:28].any()
    assert still.median[15, 5] == pytest.approx(still.median[15, 10], abs=1e-3)
    even = masks._even_light(pictures[0])
    assert float(np.median(even)) == pytest.approx(0.0, abs=1e-6)
    assert even[15, 35] - even[15, 15] == pytest.approx(np.log(1.5), abs=1e-3)
    values = np.array([1.0, 2.0, 4.0], np.float32)[:, None, None]
    assert masks.robust_scatter(values, np.float32([[2.0]]))[0, 0] == pytest.approx(NMAD * 1.0)


def test_steady_regions_reach_the_border_and_are_large():
    still = np.zeros((60, 60), bool)
    still[50:, 10:30] = True  # at the border
    still[20:30, 20:30] = True  # in the middle
    still[:3, 55:58] = True  # nine pixels at the border: less than three thousandths
    coherence = np.full((60, 60), 0.9, np.float32)
    found, score = masks._with_steady_edges(still, coherence)
    wanted = np.zeros((60, 60), bool)
    wanted[50:, 10:30] = True
    np.testing.assert_array_equal(found, wanted)
    assert score == pytest.approx(200 * 0.3, rel=1e-5)
    assert not masks._with_steady_edges(still, np.full((60, 60), 0.59, np.float32))[0].any()
    for side in (np.s_[:10, 20:40], np.s_[20:40, :10], np.s_[20:40, 50:]):
        one = np.zeros((60, 60), bool)
        one[side] = True
        np.testing.assert_array_equal(masks._with_steady_edges(one, coherence)[0], one)


def test_the_share_of_edges_that_keep_their_place():
    """Two bars with four edges each; of one of them every second picture is the other way round."""
    pictures = []
    for k in range(masks.LEAST_IMAGES):
        values = np.full((40, 60), 100)
        values[:, 10:16] = 160
        values[:, 40:46] = 160 if k % 2 else 60
        pictures.append(grey(values))
    assert masks.steady_share(pictures) == pytest.approx(0.5, abs=0.05)
    left = np.zeros((40, 60), bool)
    left[:, 8:18] = True
    assert masks.steady_share(pictures, left) == 0.0
    assert masks.steady_share(pictures, left[:, ::-1] | np.roll(left, 30, axis=1)) == 1.0
    assert masks.steady_share(pictures[1:]) == 0.0
    assert masks.steady_share([grey(np.full((9, 9), 50))] * 9) == 0.0


# ---------------------------------------------------------------- mirrors and horizons


def test_columns_of_water_mirror_those_of_the_bank():
    rng = np.random.default_rng(3)
    pattern = cv2.blur(rng.uniform(40, 200, (1, 120)), (9, 1))[0]
    image = np.broadcast_to(pattern, (80, 120)).astype(np.uint8)
    rows, hull = np.full(120, 40), np.zeros((80, 120), bool)
    assert masks.mirrored_columns(grey(image), rows, hull) == pytest.approx(1.0, abs=1e-6)
    other = image.copy()
    other[40:] = image[40:, ::-1]
    assert masks.mirrored_columns(grey(other), rows, hull) < 0.9
    turned = image.copy()
    turned[40:] = 240 - image[40:]
    assert masks.mirrored_columns(grey(turned), rows, hull) < -0.9
    # light from side to side alone is no reflection
    light = np.exp(np.linspace(4.0, 5.0, 120))
    slope = np.broadcast_to(light, (80, 120)).copy()
    slope[40:] *= 0.5
    assert abs(masks.mirrored_columns(grey(slope), rows, hull)) < 0.9
    # what the hull covers does not count
    hull[60:] = True
    turned = image.copy()
    turned[60:] = 0
    assert masks.mirrored_columns(grey(turned), rows, hull) == pytest.approx(1.0, abs=1e-6)
    # 36 columns of 120 with a quarter of the height above and below are enough
    hull[:] = False
    few = np.where(np.arange(120) < 36, 60, 61)
    assert np.isfinite(masks.mirrored_columns(grey(image), few, hull))
    few[0] = 19
    assert np.isnan(masks.mirrored_columns(grey(image), few, hull))
    few[0] = 20
    hull[20:40, 5] = False
    hull[60:80, 5] = True
    assert np.isnan(masks.mirrored_columns(grey(image), few, hull))


def test_lines_go_below_what_lies_moored():
    """Sharp levels of fifteen columns, alike, below the line of the bank and no farther than 14 %."""
    mirror = np.zeros((100, 80), np.float32)
    rows = np.full(80, 40)
    mirror[50, 20:50] = 1.0
    found = masks.with_moored(rows, mirror)
    assert (found[26:44] == 50).all()
    assert (found[:18] == 40).all()
    assert (found[52:] == 40).all()
    faint = np.where(mirror > 0, 0.84, 0.0).astype(np.float32)
    np.testing.assert_array_equal(masks.with_moored(rows, faint), rows)
    np.testing.assert_array_equal(masks.with_moored(rows - 5, mirror), rows - 5)
    np.testing.assert_array_equal(masks.with_moored(rows + 8, mirror), rows + 8)
    assert (masks.with_moored(rows + 7, mirror)[26:44] == 50).all()
    short = np.zeros_like(mirror)
    short[50, 20:34] = 1.0
    np.testing.assert_array_equal(masks.with_moored(rows, short), rows)
    dry = np.full(80, 100)
    np.testing.assert_array_equal(masks.with_moored(dry, np.ones_like(mirror)), dry)


def test_horizons_of_poses_and_without_them(monkeypatch):
    settings = MaskSettings()
    none = masks.Horizons.of(None, None, settings)
    assert (none.camera, none.R_wcs_ccs, none.sigma_deg) == (None, {}, np.inf)
    assert none.price(np.zeros((2, 2))) is None
    level = none.below_deg("a", (40, 20))
    assert level[:, 0] == pytest.approx(np.rad2deg(np.arctan((np.arange(20) + 0.5 - 10) / 40)), abs=1e-4)
    sigma = np.deg2rad(2.0 * settings.pose_sigma_deg)
    cov = np.zeros((3, 6, 6))
    cov[:, 3:, 3:] = np.diag([0.5, 1.0, 1.5]) * sigma**2
    R = np.stack([rotation_x(angle) for angle in (0.3, 0.5, 0.1)])
    poses = SimpleNamespace(
        oriented=np.array([True, True, True]), cov_pose_wcs=cov, images="abc", R_wcs_ccs=R
    )
    with pytest.raises(InputError, match="approximate poses without a camera"):
        masks.Horizons.of(poses, None, settings)
    camera = object()
    made = masks.Horizons.of(poses, camera, settings)
    assert made.sigma_deg == pytest.approx(2.0 * settings.pose_sigma_deg)
    assert list(made.R_wcs_ccs) == ["a", "b", "c"]
    poses.cov_pose_wcs = cov / 16
    assert masks.Horizons.of(poses, camera, settings).sigma_deg == settings.pose_sigma_deg
    asked = []
    monkeypatch.setattr(masks, "depression", lambda camera, R, size: asked.append(R))
    made.below_deg("b", (4, 3))
    made.below_deg("z", (4, 3))  # the one in the middle of the tilts
    np.testing.assert_array_equal(asked, R[[1, 0]])
    price = masks.Horizons(camera=camera, R_wcs_ccs={}, sigma_deg=4.0).price(np.float32([[3.0, 8.0, -7.0]]))
    np.testing.assert_allclose(price, 0.02 * np.array([[0.0, 1.0, 4.0]]), rtol=1e-6)


# ---------------------------------------------------------------- parts of an image


def series(**changes):
    made = {
        "scenery": None, "sky": None, "hull": np.zeros((20, 20), bool), "size_px": (40, 40), "notes": (),
        "horizons": None, "settings": MaskSettings(),
    }  # fmt: skip
    return masks.SeriesModel(**(made | changes))


def test_parts_of_an_image_and_what_nobody_can_tell(monkeypatch):
    image = grey(np.full((40, 40), 90))
    hull = np.zeros((20, 20), bool)
    hull[16:] = True
    parts, notes, untold = series(hull=hull).parts(image, (40, 40), "a")
    assert set(np.unique(parts)) == {LAND, HULL}
    assert (parts[32:] == HULL).all()
    assert (parts[:31] == LAND).all()
    assert (notes, untold) == ([], ["water", "sky"])
    parts, notes, untold = series(hull=hull, boat=False).parts(image, (80, 80), "a")
    assert (parts == LAND).all()
    assert notes == ["another size than most images: the own boat is not masked"]
    assert untold == ["own boat", "water", "sky"]
    line = np.full(40, 25.0)
    monkeypatch.setattr(masks.SeriesModel, "_lines", lambda self, *words: line)
    above = np.zeros((40, 40), bool)
    above[:10] = True
    monkeypatch.setattr(masks, "sky_pixels", lambda sky, features, may_be: above & may_be)
    monkeypatch.setattr(masks, "fine_features", lambda image: None)
    like = [True]
    monkeypatch.setattr(masks, "looks_like_sky", lambda image, sky, land: like[0])
    made = series(scenery="known", sky="known", hull=hull)
    parts, notes, untold = made.parts(image, (40, 40), "a")
    assert [set(np.unique(parts[rows])) for rows in (np.s_[:10], np.s_[10:24], np.s_[25:31])] == [
        {SKY}, {LAND}, {WATER},
    ]  # fmt: skip
    assert (notes, untold) == ([], [])
    like[0] = False
    parts, notes, untold = made.parts(image, (40, 40), "a")
    assert (SKY not in parts, untold) == (True, ["sky"])
    parts, notes, untold = series(scenery="known", water=False).parts(image, (40, 40), "a")
    assert (WATER not in parts, notes, untold) == (True, [], ["water"])
    line[:] = 80.0
    assert made.parts(image, (40, 40), "a")[1] == ["no water line found"]


def test_of_a_camera_that_stayed_what_moved_is_told():
    still = masks.StillScene.of([grey(np.full((20, 20), 92))] * 3)
    made = series(still=still, boat=False)
    image = grey(np.full((40, 40), 92))
    image[10:20, 10:20] = 200
    parts, notes, untold = made.parts(image, (40, 40), "a")
    assert (parts[12:18, 12:18] == MOVED).all()
    assert (parts[30:] == LAND).all()
    assert (notes, untold) == ([], ["water and sky that keep still"])
    parts, notes, untold = made.parts(image, (40, 30), "a")
    assert (parts == LAND).all()
    assert (notes, untold) == (["another size than most images: nothing is masked"], ["anything"])


def test_angles_of_lines_and_seeds_of_parts():
    below = np.broadcast_to(np.arange(10.0, dtype=np.float32)[:, None], (10, 5))
    found = learning.line_angle(np.array([0, 1, 9, 10, 4]), below)
    np.testing.assert_array_equal(found, [np.nan, 1.0, 9.0, np.nan, 4.0])
    assert learning._whole(np.array([1.4, 1.6, np.nan])).tolist() == [1, 2, -1]
    values = np.r_[np.zeros(50), np.full(50, 1.0)].astype(np.float32)
    assert 0.0 < learning._split(values) < 1.0
