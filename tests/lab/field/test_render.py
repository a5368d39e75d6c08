"""Photographs of the yard against an independent projection, brute force, and a fit of crossings."""

import numba
import numpy as np
import pytest

from thalweg.calibration import MarkerLayout, sheet_picture
from thalweg.core import Camera
from thalweg_lab.settings import TwinConfig, TwinLens
from thalweg_lab.yard import FieldCone, Yard, build_field, field_scene
from thalweg_lab.yard.tour import looking
from thalweg_lab.yard_images import LensRays, exposed, true_camera, turned
from thalweg_lab.yard_images.images import SUN, synthetic_view
from thalweg_lab.yard_images.render import PaintTable, Photographer, changes

SEED = 5
EYE = np.array([0.1, -0.2, 0.8])
LENS = TwinLens(size_px=(700, 520), focal_px=3200.0, principal_offset_px=(3.3, -2.1), noise=0.0)
WIDE = TwinLens(size_px=(420, 320), focal_px=1300.0, principal_offset_px=(3.3, -2.1), noise=0.0)


@pytest.fixture(scope="module")
def field():
    return build_field(TwinConfig.of_size("field_tiny"), SEED)


@pytest.fixture(scope="module")
def photographer(field):
    return Photographer(Yard.of(field_scene(field), field.sheets), SUN)


@pytest.fixture(scope="module")
def rays():
    return LensRays(true_camera(LENS, "test"))


@pytest.fixture(scope="module")
def wide():
    return LensRays(true_camera(WIDE, "wide"))


def toward(field, cone, eye=EYE, roll_rad=0.0):
    return looking(eye, field.cone(cone).middle_wcs_m, roll_rad=roll_rad)


def pixels_of(sheet, modules, camera, pose):
    return camera.project(pose.inverse().apply(sheet.to_wcs(modules)))


# ---------------------------------------------------------------- rays


@pytest.mark.parametrize("model", ["perspective", "fisheye"])
def test_the_ray_of_each_pixel_is_that_of_the_camera(model):
    distortion = (-0.062, 0.081, 0.0004, -0.0003, -0.018) if model == "perspective" else (0.01, -0.003, 0, 0)
    lens = TwinLens(
        model=model,
        size_px=(203, 151),
        focal_px=140.0 if model == "perspective" else 50.0,
        distortion=distortion,
    )
    camera = true_camera(lens, "test")
    rays = LensRays(camera).rays_ccs
    y, x = np.mgrid[0:151, 0:203] + 0.5
    xy = np.stack([x.ravel(), y.ravel()], axis=1)
    sees = np.isfinite(rays.reshape(-1, 3)).all(axis=1)
    assert sees.mean() > 0.7
    # float32 steps by 6e-8, that is 1e-5 px here.
    np.testing.assert_allclose(camera.project(rays.reshape(-1, 3)[sees]), xy[sees], atol=5e-5)


# ---------------------------------------------------------------- prints


def true_shares(sheet, camera, pose, n):
    """Pixels (k, 2) about a sheet and the shares of paper and ink in each, by n x n rays in float64."""
    rim = np.array([[u, v] for u in (-0.5, 5, 10.5) for v in (-0.5, 5, 10.5)])
    xy = pixels_of(sheet, rim, camera, pose)
    low, high = np.floor(xy.min(axis=0)).astype(int), np.ceil(xy.max(axis=0)).astype(int)
    x, y = (a.ravel() for a in np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1])))
    a, b = (o.ravel() for o in np.meshgrid(*2 * [(np.arange(n) + 0.5) / n]))
    sub = np.stack([(x[:, None] + a).ravel(), (y[:, None] + b).ravel()], axis=1)
    ray, eye, surface = camera.rays(sub) @ pose.R.T, pose.shift_m, sheet.surface
    if isinstance(surface, FieldCone):
        o, d = surface.to_cocs(eye[None])[0], ray @ surface.R_cocs_wcs.T
        k = np.array([1.0, 1.0, -(np.tan(surface.half_angle_rad) ** 2)])
        qa, qb, qc = (d * d) @ k, (d * o) @ k, (o * o) @ k
        root = np.sqrt(np.where(qb * qb > qa * qc, qb * qb - qa * qc, np.nan))
        t = np.minimum((-qb - root) / qa, (-qb + root) / qa)
    else:
        t = (surface.origin_wcs_m - eye) @ surface.normal_wcs / (ray @ surface.normal_wcs)
    modules = np.nan_to_num(sheet.to_modules(eye + t[:, None] * ray), nan=-9.0)
    paper = np.all((modules >= -0.5) & (modules <= 10.5), axis=1)
    picture = np.pad(sheet_picture(sheet.marker, MarkerLayout(), 2)[1:-1:2, 1:-1:2] == 0, 1)
    u, v = (np.clip(np.floor(m).astype(int), -1, 10) + 1 for m in modules.T)
    return np.stack([x, y], axis=1), *(
        s.reshape(len(x), -1).mean(axis=1) for s in (paper, paper & picture[v, u])
    )


@pytest.mark.parametrize(("marker", "roll_rad"), [(1, 0.0), (5, 0.0), (6, 0.4), (66, 0.0), (75, 0.2)])
def test_a_pixel_sees_as_much_ink_as_lies_in_it(field, photographer, wide, marker, roll_rad):
    """Cone and board, straight and turned: the shares of 256 rays a pixel in float64."""
    sheet = field.sheet(marker)
    pose = looking(EYE, sheet.centre_wcs_m(), roll_rad=roll_rad)
    pixels, paper, ink = true_shares(sheet, wide.camera, pose, 16)
    w, _ = wide.camera.size_px
    index = pixels[:, 1] * w + pixels[:, 0]
    grid = turned(wide.rays_ccs.reshape(-1, 3), pose.R).reshape(wide.rays_ccs.shape)
    ray, (dx, dy) = grid.reshape(-1, 3)[index], changes(grid, index)
    t, primitive = photographer._cast(pose.shift_m, ray)
    thing = photographer._things(primitive)
    # This sheet alone: its neighbours on the cone may lie in the same window.
    table = PaintTable.of([sheet], photographer.yard.names, MarkerLayout())
    got_paper, got_ink = table.paint(pose.shift_m, ray, dx, dy, t.astype(np.float64), thing, 4)
    on = thing == photographer.yard.names.index(sheet.thing)
    assert on.mean() > 0.6
    assert ink[on].std() > 0.3
    for got, true in ((got_paper, paper), (got_ink, ink)):
        # A pixel's parts are taken as squares along the print: 0.004 of a pixel where edges are slanted, and
        # up to a few hundredths at corners. The brute force is itself true to 1/16 of an edge's pixel.
        assert np.sqrt(np.mean((got - true)[on] ** 2)) < 0.006
    # As a shift of the whole print: error of the ink along its gradient.
    shape = np.unique(pixels[:, 1]).size, np.unique(pixels[:, 0]).size
    gy, gx = (g.ravel()[on] for g in np.gradient(ink.reshape(shape)))
    shift = np.linalg.lstsq(np.stack([gx, gy], axis=1), (ink - got_ink)[on], rcond=None)[0]
    # A hundredth of what a saddle can be measured to.
    assert np.abs(shift).max() < 0.003


# ---------------------------------------------------------------- light


def test_the_picture_is_the_same_at_each_run_and_with_one_thread(field, photographer, wide):
    pose = toward(field, "C2")
    first = photographer.see(wide, pose).light
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        again = Photographer(photographer.yard, SUN).see(wide, pose).light
    finally:
        numba.set_num_threads(threads)
    np.testing.assert_array_equal(first, again)


def test_smear_and_blur_move_nothing():
    """A bright point stays where it is; its centre of mass tells."""
    light = np.zeros((41, 41, 3), dtype=np.float32)
    light[20, 20] = 0.2
    lens = TwinLens(noise=0.0, sharpness_px=0.8)
    image = exposed(light.copy(), lens, np.random.default_rng(0), smear_px=(2.3, -1.1)).astype(float)[..., 0]
    image -= image.min()
    y, x = np.mgrid[0:41, 0:41]
    assert image[20, 22] > image[22, 20]
    # Steps of 8 bits.
    assert abs(np.sum(image * x) / image.sum() - 20) < 0.05
    assert abs(np.sum(image * y) / image.sum() - 20) < 0.05


# ---------------------------------------------------------------- other views


def test_a_fisheye_sees_behind_itself_and_is_dark_outside_its_circle(field):
    """190 degrees: the upright cone in the north stands 92 degrees off a view to the west by south."""
    camera = Camera(
        model="fisheye", size_px=(400, 400), parameters=np.array([119, 119, 201, 199, 0.01, -0.002, 0, 0])
    )
    eye = np.array([0.0, 0.0, 0.9])
    cone = field.cone("C7").middle_wcs_m
    view = np.array([cone[1], -cone[0], 0.0])
    turn = np.deg2rad(2.0)
    back = np.cos(turn) * view / np.linalg.norm(view) - np.sin(turn) * (cone - eye) / np.linalg.norm(
        cone - eye
    )
    pose = looking(eye, eye + back * [1, 1, 0])
    seen = synthetic_view(field, camera, pose, SUN)
    ray = pose.inverse().apply(cone[None])
    assert ray[0, 2] < 0
    x, y = camera.project(ray)[0].astype(int)
    assert seen.cone[y, x] == [c.name for c in field.cones].index("C7")
    assert seen.range_m[y, x] == pytest.approx(np.linalg.norm(cone - eye), abs=0.35)  # its surface
    assert seen.image[2, 2].max() <= 2
    rays = LensRays(camera, field_of_view_deg=190.0).rays_ccs
    lit = np.isfinite(rays[..., 0])
    assert np.nanmin(rays[..., 2]) == pytest.approx(np.cos(np.deg2rad(95.0)), abs=0.01)
    assert (seen.image[~lit].max(axis=1) < 40).mean() > 0.97  # the rim is blurred
    assert (seen.image[lit].max(axis=1) > 40).mean() > 0.97
