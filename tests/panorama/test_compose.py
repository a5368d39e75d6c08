"""Parallax at the seam, its cure by ranges, gains, and lenses read in a wrong way."""

import importlib

import numpy as np
import pytest
from scipy.optimize import brentq

from thalweg.calibration import Rig
from thalweg.core import Camera, Rigid
from thalweg.panorama import compose, reading_that_fits, sphere_rays
from thalweg.panorama.compose import lens_pixels
from thalweg.settings.sections import Rig as RigSettings

compose_module = importlib.import_module("thalweg.panorama.compose")
BASE_M = 0.0194
WIDTH = 1200
"""Of a panorama as fine as the lenses."""


def rig_of_the_shelf() -> Rig:
    """A rig with lenses of 191 px, 19.4 mm apart, 179.8 degrees."""
    tilt = np.deg2rad(0.2)
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    R = turn @ np.diag([-1.0, 1.0, -1.0])
    parameters = np.array([190.9, 190.9, 321.0, 319.0, -0.0286, 0.0232, -0.0095, 0.0006])
    cameras = {
        name: Camera(model="fisheye", size_px=(640, 640), parameters=parameters, name=name)
        for name in ("front", "back")
    }
    return Rig(
        cameras=cameras,
        T_back_front=Rigid(R=R, shift_m=-R @ np.array([0.0, 0.0, -BASE_M])),
        settings=RigSettings(),
    )


def texture(directions: np.ndarray) -> np.ndarray:
    """Grey values (n, 3) of smooth noise on a sphere, waves of 2 to 12 degrees."""
    rng = np.random.default_rng(8)
    value = np.zeros((len(directions), 3))
    for _ in range(40):
        k = rng.standard_normal(3)
        k *= 2 * np.pi / np.deg2rad(rng.uniform(2, 12)) / np.linalg.norm(k)
        phase = rng.uniform(0, 2 * np.pi, 3)
        wave = directions @ k
        # sin(wave + phase) of three phases by one sine and one cosine
        value += np.column_stack([np.sin(wave), np.cos(wave)]) @ np.stack([np.cos(phase), np.sin(phase)])
    return 120 + 15.6 * value


def views_of_a_sphere(rig: Rig, radius_m: float, back_light: float = 1.0) -> dict[str, np.ndarray]:
    """What both lenses see of a sphere about the middle of the rig."""
    views = {}
    for name, place in rig.T_front_lens.items():
        y, x = np.mgrid[0:640, 0:640] + 0.5
        rays = rig.cameras[name].rays(np.column_stack([x.ravel(), y.ravel()])) @ place.R.T
        origin = place.shift_m - rig.centre_front_m
        # |origin + s ray| = radius
        b = rays @ origin
        s = -b + np.sqrt(b * b - origin @ origin + radius_m**2)
        at = (origin + s[:, None] * rays) / radius_m
        seen = np.arccos(np.clip(rays @ place.R[:, 2], -1, 1)) <= np.deg2rad(101)
        seen &= np.isfinite(s)
        value = texture(at[seen])
        if name == "back":
            value = 255 * (back_light * (np.clip(value, 0, 255) / 255) ** 2.2) ** (1 / 2.2)
        picture = np.zeros((len(rays), 3))
        picture[seen] = np.clip(np.rint(value), 0, 255)
        views[name] = np.ascontiguousarray(picture.reshape(640, 640, 3).astype(np.uint8))
    return views


FINE = 5376
"""Width of a panorama of a Theta V, for which the cost of the base is stated."""


def seam_offset_px(range_m: float, taken_m: float) -> float:
    """How far a point beside the rig comes out twice if it is taken to be at another range."""
    rig = rig_of_the_shelf()
    taken = 0.0 if np.isinf(taken_m) else 1.0 / taken_m

    def direction(angle: float) -> np.ndarray:
        return np.array([[np.sin(angle), 0.0, np.cos(angle)]])

    seen, _ = lens_pixels(rig, direction(np.pi / 2), np.array([1.0 / range_m]))
    angles = {}
    for name in ("front", "back"):

        def off(angle: float, name: str = name) -> float:
            pixels, _ = lens_pixels(rig, direction(angle), np.array([taken]))
            return float(pixels[name][0, 0] - seen[name][0, 0])

        angles[name] = brentq(off, np.deg2rad(82), np.deg2rad(98), xtol=1e-12)
    return abs(angles["front"] - angles["back"]) * FINE / (2 * np.pi)


@pytest.mark.parametrize(("range_m", "cost_px"), [(1.0, 16.6), (2.0, 8.3), (5.0, 3.3), (10.0, 1.7)])
def test_what_the_base_costs_where_everything_is_taken_to_be_far(range_m, cost_px):
    assert seam_offset_px(range_m, np.inf) == pytest.approx(cost_px, abs=0.05)
    assert seam_offset_px(range_m, np.inf) == pytest.approx(BASE_M / range_m * FINE / (2 * np.pi), rel=0.002)


def test_one_range_for_all_is_right_there_alone_and_the_true_range_everywhere():
    # a sphere of 8 m leaves base (1/d - 1/8)
    left = BASE_M * (1 / 2 - 1 / 8) * FINE / (2 * np.pi)
    assert seam_offset_px(2.0, 8.0) == pytest.approx(left, rel=0.002)
    for range_m in (2.0, 5.0, 20.0):
        assert seam_offset_px(range_m, range_m) < 1e-6


@pytest.fixture(scope="module")
def near():
    return views_of_a_sphere(rig_of_the_shelf(), 2.0, back_light=1.2)


@pytest.fixture(scope="module")
def depth(near):
    """The panorama of the sphere at its range."""
    return compose(near, rig_of_the_shelf(), np.eye(3), np.full((WIDTH // 2, WIDTH), 1 / 2.0))


def test_with_the_range_both_lenses_agree_to_a_pixel_of_a_fine_panorama(near, depth):
    rig, fine = rig_of_the_shelf(), FINE / WIDTH
    far = compose(near, rig, np.eye(3), np.zeros((WIDTH // 2, WIDTH)))
    assert len(depth.seam_px) > 60
    assert depth.seam_rms_px * fine <= 1.0
    # 8.3 px for a point at right angles to the axis
    assert far.seam_rms_px * fine == pytest.approx(8.3, rel=0.1)
    assert depth.agreement > 0.99


def test_the_panorama_shows_the_sphere(depth):
    found = depth
    assert found.shown.all()
    # light of the back lens over that of the front lens
    assert found.gains == pytest.approx([1.2] * 3, abs=0.01)
    true = 255 * (texture(sphere_rays(WIDTH)[::2, ::2].reshape(-1, 3)) / 255).clip(0, 1) ** 2.2
    level = np.sqrt(1.2)
    true = 255 * (level * true / 255) ** (1 / 2.2)
    off = found.picture[::2, ::2].reshape(-1, 3) - true.clip(0, 255)
    assert np.abs(off).mean() < 2.0
    # no jump of the light where the lens changes: columns left and right of the seam
    edge = found.front[:, 1:] != found.front[:, :-1]
    jump = np.abs(np.diff(found.picture.astype(float), axis=1)).mean(axis=2)
    assert jump[edge].mean() < 1.2 * jump[~edge].mean()


def test_wide_panoramas_are_projected_at_some_pixels_and_lose_nothing(near, monkeypatch):
    # narrower than in use, where this begins above 2048 px, with steps of as many pixels of the lens
    rig, width = rig_of_the_shelf(), WIDTH
    monkeypatch.setattr(compose_module, "_FINE_PX", width - 1)
    monkeypatch.setattr(compose_module, "_EACH", 2)
    inverse = np.full((width // 2, width), 1 / 2.0)
    found = compose(near, rig, np.eye(3), inverse, gains=np.full(3, 1.2))
    monkeypatch.setattr(compose_module, "_FINE_PX", width)
    exact = compose(near, rig, np.eye(3), inverse, gains=np.full(3, 1.2))
    assert (found.front == exact.front).mean() > 0.9999
    # the rim of a circle may lose the pixels of a step
    both = found.shown & exact.shown
    assert both.sum() > 0.999 * exact.shown.sum()
    off = np.abs(found.picture.astype(int) - exact.picture)[both].max(axis=1)
    assert np.quantile(off, 0.999) <= 1
    assert off.max() <= 12  # a detail at the border of both lenses


def test_what_a_mask_hides_is_grey_where_the_other_lens_does_not_show_it(near):
    rig = rig_of_the_shelf()
    mask = np.ones((640, 640), dtype=bool)
    mask[400:, :] = False
    found = compose(near, rig, np.eye(3), np.full((150, 300), 1 / 2.0), masks={"front": mask})
    hidden = ~found.shown
    assert 0.03 < hidden.mean() < 0.3
    assert (found.picture[hidden] == 128).all()


def test_views_that_are_turned_against_each_other_are_told(near):
    rig = rig_of_the_shelf()
    assert reading_that_fits(near, rig) == ""
    for lens in ("front", "back"):
        turned = near | {lens: np.ascontiguousarray(near[lens][::-1, ::-1])}
        assert reading_that_fits(turned, rig) == "turned by half against each other"
