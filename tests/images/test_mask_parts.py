"""Parts of the masks: water line, mirror level, own boat, horizon."""

import itertools

import cv2
import numpy as np
import pytest

from thalweg.core import Camera, InputError, exp_rotation
from thalweg.images.masks.images import (
    Horizons,
    depression,
    learn_series,
    looks_like_sky,
    mirror_level,
    nominal_depression,
    steady_parts,
    steady_share,
)
from thalweg.images.masks.learning import LAND, MOVED, PixelModel, _best_path, read_reduced, water_line
from thalweg.settings.sections import MaskSettings


def test_the_path_is_the_best_of_all(rng):
    cost = rng.normal(0, 2, (4, 5))
    found = _best_path(cost, 0.7, 3)

    def total(rows):
        return sum(cost[r, x] for x, r in enumerate(rows)) + 0.7 * np.sum(np.diff(rows) ** 2)

    best = min(itertools.product(range(4), repeat=5), key=total)
    assert tuple(found) == best


def test_the_water_line_follows_the_evidence_and_may_be_absent():
    y = np.arange(40)[:, None]
    true = np.rint(20 + 4 * np.sin(np.arange(60) / 12)).astype(int)
    ratio = np.where(y >= true, 1.0, -1.0).astype(np.float32)
    prior = np.zeros((41, 60), np.float32)
    # Steps are cheap against a row of wrong pixels, so that the line is met exactly.
    np.testing.assert_array_equal(water_line(ratio, prior, bend=0.1), true)
    assert (water_line(-np.ones((40, 60), np.float32), prior, bend=1.0) == 40).all()
    assert (water_line(np.ones((40, 60), np.float32), prior, bend=1.0) == 0).all()


def test_an_image_mirrors_about_its_level(rng):
    h, w, level = 120, 160, 55
    image = np.full((h, w, 3), 120.0)
    image[:level] = 60 + 120 * rng.random((level, 1, 3)).repeat(w, axis=1)
    image[level : 2 * level] = 0.7 * image[:level][::-1]
    rows, score, agreement = mirror_level(np.rint(image).astype(np.uint8), np.zeros((h, w), bool))
    # the smoothing by three rows leaves half a row
    assert np.abs(rows - level).max() <= 1
    assert score > 0.8
    assert agreement.shape == (h, w)
    noise = rng.integers(0, 256, (h, w, 3)).astype(np.uint8)
    assert mirror_level(noise, np.zeros((h, w), bool))[1] < 0.4


def test_a_prior_draws_the_level(rng):
    noise = rng.integers(0, 256, (120, 160, 3)).astype(np.uint8)
    prior = 0.5 * np.abs(np.arange(120, dtype=np.float32)[:, None] - 80).repeat(160, axis=1)
    assert abs(mirror_level(noise, np.zeros((120, 160), bool), prior)[0].mean() - 80) < 2


def moving_images(rng, n, *, hull=True):
    images = []
    for k in range(n):
        image = rng.integers(20, 90, (30, 40, 3)).astype(np.uint8).repeat(4, axis=0).repeat(4, axis=1)
        if hull:
            # The light changes from image to image, the colour does not.
            image[90:, :110] = np.rint(np.array([150, 160, 170]) * (0.7 + 0.5 * k / n)).astype(np.uint8)
        images.append(image)
    return images


def test_what_keeps_its_place_is_the_own_boat(rng):
    found = steady_parts(moving_images(rng, 12))
    true = np.zeros((120, 160), bool)
    true[90:, :110] = True
    # its rim of one or two pixels is blurred by the windows
    assert (found & true).sum() > 0.93 * true.sum()
    assert (found & ~true).sum() < 0.05 * true.sum()
    assert not steady_parts(moving_images(rng, 12, hull=False)).any()
    assert not steady_parts(moving_images(rng, 7)).any()


@pytest.mark.parametrize("model", ["perspective", "fisheye"])
def test_angles_below_the_horizon_are_those_of_the_rays(model):
    shape = [0.05, -0.02, 0.001, -0.001, 0.0] if model == "perspective" else [0.02, -0.01, 0.0, 0.0]
    camera = Camera(model=model, size_px=(720, 540), parameters=np.array([580.0, 582, 355, 275, *shape]))
    # Looking north, level, then turned by a few degrees about all axes.
    level = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    R = exp_rotation(np.array([0.1, -0.05, 0.3])) @ level
    below = depression(camera, R, (180, 135))
    x, y = np.meshgrid(np.arange(180) * 4.0 + 2, np.arange(135) * 4.0 + 2)
    rays = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1)) @ R.T
    true = -np.rad2deg(np.arcsin(rays[:, 2])).reshape(135, 180)
    # what a grid of 25 nodes leaves, more at the rim, where it is extrapolated
    assert np.abs(below - true).max() < 0.1
    assert np.sqrt(np.mean((below - true) ** 2)) < 0.02
    assert np.all(np.diff(nominal_depression((160, 120)), axis=0) > 0)


def test_the_model_tells_what_is_inside_from_what_is_around(rng):
    x = rng.normal(0, 1, (4000, 2)).astype(np.float32)
    part = (np.hypot(*x.T) > 1).astype(np.int64)
    model = PixelModel.learn(x, part, 2)
    right = (np.argmax(model.log_probability(x), axis=1) == part).mean()
    # products of two features draw the circle; without them there is only a line
    assert right > 0.95
    flat = PixelModel.learn(x, part, 2, products=False)
    assert (np.argmax(flat.log_probability(x), axis=1) == part).mean() < 0.8
    np.testing.assert_allclose(np.exp(model.log_probability(x)).sum(axis=1), 1.0, rtol=1e-5)


def test_missing_images_are_told(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_reduced(tmp_path / "no.jpg", 100)


def still_images(rng, n):
    """A slope with texture; water in the lower third that is another in each picture; light that changes."""
    scene = rng.integers(40, 200, (40, 60, 1)).repeat(4, axis=0).repeat(4, axis=1).repeat(3, axis=2)
    images = []
    for k in range(n):
        image = scene.astype(float)
        image[107:] = (
            rng.integers(40, 200, (14, 60, 1)).repeat(4, axis=0).repeat(4, axis=1)[:53].repeat(3, axis=2)
        )
        image = image * (0.7 + 0.05 * k) + rng.normal(0, 2, image.shape)
        images.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    return images


def test_whether_the_camera_stayed(rng):
    assert steady_share(still_images(rng, 12)) > 0.6
    assert steady_share(still_images(rng, 5)) == 0.0  # too few to tell
    assert steady_share(moving_images(rng, 12)) < 0.6
    assert steady_share(moving_images(rng, 12, hull=False)) < 0.25


def test_sky_is_smooth_and_brighter_than_land(rng):
    """Snow and meadows are as bright, night is as smooth; of either alone nobody can tell."""
    image = rng.integers(60, 110, (120, 640, 3)).astype(np.uint8)
    upper = np.zeros((120, 640), dtype=bool)
    upper[:50] = True
    image[upper] = np.linspace(190, 215, upper.sum()).astype(np.uint8)[:, None]
    assert looks_like_sky(image, upper, ~upper)
    assert not looks_like_sky(255 - image, upper, ~upper)
    snow = image.copy()
    snow[upper] = rng.integers(170, 250, (upper.sum(), 3))
    assert not looks_like_sky(snow, upper, ~upper)
    none = np.zeros_like(upper)
    assert looks_like_sky(image, none, ~none)
    assert not looks_like_sky(image, ~none, none)


def test_of_a_camera_that_stayed_only_what_moved_is_masked(rng, tmp_path):
    """Nothing is own boat or water by standing still, such as a glacier and gravel before a fixed camera."""
    images = still_images(rng, 12)
    images[4][30:70, 100:140] = 250  # somebody walks by
    files = {}
    for k, image in enumerate(images):
        files[f"{k}.png"] = tmp_path / f"{k}.png"
        cv2.imwrite(str(files[f"{k}.png"]), image)
    settings = MaskSettings(analysis_px=320)
    model = learn_series(files, settings, Horizons.of(None, None, settings))
    assert "cannot tell water and sky that kept still" in model.notes[0]
    parts, notes, untold = model.parts(images[4], (240, 160), "4.png")
    assert not notes
    assert untold == ["water and sky that keep still"]
    assert set(np.unique(parts)) == {LAND, MOVED}
    assert (parts[35:65, 105:135] == MOVED).all()
    assert (parts[112:] == MOVED).mean() > 0.95
    rest = parts[:100].copy()
    rest[24:76, 94:146] = LAND
    assert (rest == MOVED).mean() < 0.02
    parts, _, _ = model.parts(images[5], (240, 160), "5.png")
    assert (parts[:100] == MOVED).mean() < 0.02
