"""Images before their features, and features in parts."""

import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from tests.images.block_scene import without_points
from tests.images.sfm_scene import photographs
from thalweg.core import Camera, InputError
from thalweg.images.model import Picture, inspect
from thalweg.images.sfm import extract_features, part_of
from thalweg.images.sfm.features import Features, join_features, to_the_rim
from thalweg.settings.sections import FeatureSettings

SETTINGS = FeatureSettings(max_features=400)


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    return photographs(tmp_path_factory.mktemp("wall"))


def same(a: Features, b: Features) -> bool:
    arrays = all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in ("start", "place", "descriptor")
    )
    return arrays and a.pictures == b.pictures


def test_any_split_gives_the_same_features(wall, tmp_path):
    files = wall.files[:4]
    whole = extract_features(files[::-1], settings=SETTINGS, threads=2)
    parts = [extract_features(part_of(files, k, 3), settings=SETTINGS) for k in range(3)]
    assert [p.name for part in parts for p in part.pictures] != [p.name for p in whole.pictures]
    assert same(join_features(parts[::-1]), whole)
    whole.write(tmp_path / "a.npz")
    join_features(parts).write(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert same(Features.read(tmp_path / "a.npz"), whole)
    assert [p.name for p in whole.pictures] == [f.name for f in files]
    assert whole.descriptor.shape == (whole.start[-1], 128)
    # the largest are kept
    assert (np.diff(whole.start) <= 400).all()
    some = extract_features(files[:1], settings=SETTINGS.replace(max_features=100))
    all_of_it = whole.place[whole.rows(0)]
    assert some.place[:, 2].min() >= np.sort(all_of_it[:, 2])[-101]


def test_features_of_a_scaled_image_stand_in_pixels_of_the_full_one(wall, tmp_path):
    with Image.open(wall.files[0]) as image:
        image.resize((960, 720), Image.Resampling.BICUBIC).save(tmp_path / wall.files[0].name)
    large = extract_features([tmp_path / wall.files[0].name], settings=SETTINGS.replace(max_size_px=320))
    small = extract_features(wall.files[:1], settings=SETTINGS)
    assert large.pictures[0].size_px == (960, 720)
    near = np.linalg.norm(large.place[:, None, :2] / 3 - small.place[None, :, :2], axis=2).min(axis=1)
    # enlarging and averaging again changes the grey values a little; half of the features stay in place
    assert np.median(near) < 0.1
    assert np.median(large.place[:, 2]) == pytest.approx(3 * np.median(small.place[:, 2]), rel=0.1)


def test_masks_are_honoured_and_do_not_cost_features(wall, tmp_path):
    few = FeatureSettings(max_features=150)
    mask = np.zeros((240, 320), np.uint8)
    mask[:, :100] = 255
    for name in ("image_01.png.png", "image_02.png"):  # both ways to name a mask
        Image.fromarray(mask).save(tmp_path / name)
    Image.fromarray(mask[::2, ::2]).save(tmp_path / "image_03.png.png")  # of another scale
    found = extract_features(wall.files[:4], masks=tmp_path, settings=few)
    free = extract_features(wall.files[:4], settings=few)
    assert [round(p.usable_share, 3) for p in found.pictures] == [0.312, 0.312, 0.312, 1.0]
    for k in range(3):
        assert found.place[found.rows(k), 0].max() < 100
        in_the_open = (free.place[free.rows(k), 0] < 100).sum()
        # what a mask covers does not use up the number of features
        assert len(found.place[found.rows(k)]) > 1.5 * in_the_open
    assert np.array_equal(found.place[found.rows(3)], free.place[free.rows(3)])


def test_unusable_images_say_why_and_the_rest_goes_on(wall, tmp_path):
    good = tmp_path / "good.png"
    shutil.copy(wall.files[0], good)
    shutil.copy(wall.files[0], tmp_path / "zz_twin.png")
    (tmp_path / "empty.jpg").write_bytes(b"")
    with Image.open(good) as image:
        image.convert("L").save(tmp_path / "whole.jpg")
    data = (tmp_path / "whole.jpg").read_bytes()
    (tmp_path / "cut.jpg").write_bytes(data[: len(data) // 2])
    (tmp_path / "whole.jpg").unlink()
    Image.new("L", (320, 240), 90).save(tmp_path / "blank.png")
    smooth = np.add.outer(np.linspace(0, 120, 240), np.linspace(0, 120, 320)).astype(np.uint8)
    Image.fromarray(smooth).save(tmp_path / "fog.png")
    shutil.copy(wall.files[1], tmp_path / "masked.png")
    shutil.copy(wall.files[2], tmp_path / "mismatch.png")
    masks = tmp_path / "masks"
    masks.mkdir()
    Image.new("L", (320, 240), 0).save(masks / "masked.png")
    Image.new("L", (320, 320), 255).save(masks / "mismatch.png")
    (masks / "good.png").write_bytes(b"no picture")
    names = (
        "good.png",
        "zz_twin.png",
        "empty.jpg",
        "cut.jpg",
        "blank.png",
        "fog.png",
        "masked.png",
        "mismatch.png",
    )
    files = [tmp_path / name for name in names] + [tmp_path / "absent.png"]
    found = join_features([extract_features(files, masks=masks)])
    told = {p.name: (p.cause, p.problem) for p in found.pictures}
    assert told["absent.png"] == ("unreadable", "there is no such file")
    assert told["empty.jpg"][0] == told["cut.jpg"][0] == "unreadable"
    assert "truncated" in told["cut.jpg"][1]
    assert "blank (contrast 0.0" in told["blank.png"][1]
    assert "too blurred or without texture" in told["fog.png"][1]
    assert told["masked.png"] == ("masked", "no usable pixels: 100.0 % are masked")
    assert told["mismatch.png"] == ("mask", "a mask of 320 x 320 pixels, the image has 320 x 240")
    assert told["good.png"][0] == "mask"
    assert "cannot be read" in told["good.png"][1]
    assert told["zz_twin.png"] == ("double", "the same file as good.png")
    assert found.start[-1] == 0
    (masks / "good.png").unlink()
    again = join_features([extract_features(files, masks=masks)])
    used = {p.name: int(n) for p, n in zip(again.pictures, np.diff(again.start), strict=True) if n}
    assert list(used) == ["good.png"]


def test_a_rotation_noted_in_exif_is_not_applied(tmp_path, wall):
    exif = Image.Exif()
    exif[0x0112] = 6
    with Image.open(wall.files[0]) as image:
        image.save(tmp_path / "a.jpg", exif=exif, quality=95)
    picture, grey, _ = inspect(tmp_path / "a.jpg", None, 3200)
    assert picture.size_px == (320, 240)
    assert grey.shape == (240, 320)


def test_images_of_16_bits(tmp_path, wall):
    with Image.open(wall.files[0]) as image:
        values = np.asarray(image)
    Image.fromarray(values.astype(np.uint16) << 8).save(tmp_path / "a.png")
    picture, grey, _ = inspect(tmp_path / "a.png", None, 3200)
    assert not picture.problem
    assert np.array_equal(grey, values)


def test_wrong_calls_are_refused(wall, tmp_path):
    (tmp_path / "other").mkdir()
    shutil.copy(wall.files[0], tmp_path / "other")
    with pytest.raises(InputError, match=r"image_01.png is named twice.*Name a folder or the files"):
        extract_features([wall.files[0], wall.files[0]])
    # the same name in two folders is another image
    shutil.copytree(tmp_path / "other", tmp_path / "more")
    found = extract_features([tmp_path / "other", tmp_path / "more" / "image_01.png"], settings=SETTINGS)
    assert [p.name for p in found.pictures] == ["more/image_01.png", "other/image_01.png"]
    assert join_features([found]).pictures[1].problem == "the same file as more/image_01.png"
    with pytest.raises(InputError, match="folder not found"):
        extract_features(wall.files[:1], masks=tmp_path / "nowhere")
    one = extract_features(wall.files[:1], settings=SETTINGS)
    with pytest.raises(InputError, match=r"image_01.png stands in two parts"):
        join_features([one, one])
    with pytest.raises(InputError, match="different settings"):
        join_features([one, extract_features(wall.files[1:2])])
    with pytest.raises(InputError, match="no features"):
        join_features([])
    with pytest.raises(InputError, match="part 3; expected 0 to 2"):
        part_of(wall.files, 3, 3)
    (tmp_path / "x.npz").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"x.npz: not readable"):
        Features.read(tmp_path / "x.npz")
    assert join_features([one, extract_features([], settings=SETTINGS)]).pictures == one.pictures


@pytest.mark.parametrize("enlarged", [1, 2])
def test_pixels_count_from_the_corner_of_the_image(tmp_path, enlarged):
    """Blobs whose middle is known; a scaled image must not shift them."""
    w, h = 320 * enlarged, 240 * enlarged
    x, y = np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5)
    at = np.array([(a, b) for a in np.arange(40.25, 300, 40) for b in np.arange(30.75, 220, 40)]) * enlarged
    grey = np.full((h, w), 60.0)
    for a, b in at:
        grey += 150 * np.exp(-((x - a) ** 2 + (y - b) ** 2) / (2 * (3.0 * enlarged) ** 2))
    Image.fromarray(grey.round().astype(np.uint8)).save(tmp_path / "blobs.png")
    found = extract_features(
        [tmp_path / "blobs.png"], settings=FeatureSettings(max_size_px=320, min_features=8)
    )
    off = found.place[:, None, :2] - at[None]
    nearest = off[np.arange(len(off)), np.linalg.norm(off, axis=2).argmin(axis=1)]
    close = nearest[np.linalg.norm(nearest, axis=1) < 2 * enlarged]
    assert len(close) >= len(at)
    # grey values are rounded to steps of 1/150 of the blob; half a pixel would be a wrong corner
    assert np.abs(np.median(close, axis=0)).max() < 0.1 * enlarged


def test_marks_at_the_rim_are_of_points_that_are_expected_there():
    """Eight points 90 degrees aside of the first picture, before the second one; the last four are two pairs
    half a degree apart, 1.37 px at the rim."""
    camera = Camera(
        model="fisheye", size_px=(400, 400), parameters=np.r_[100.0, 100.0, 200.0, 200.0, np.zeros(4)]
    )
    a = np.deg2rad([-40, -30, -20, -10, 10, 10.5, 20, 20.5])
    rim = 200 + 50 * np.pi * np.column_stack([np.cos(a), np.sin(a)])
    own = np.random.default_rng(1).integers(20, 230, (8, 128))
    own[5] = own[4] + 1
    between = own[4] + np.tile([0, 12], 64)  # 96 from the one of a pair, 88 from the other
    size, sigma = np.repeat([2.0, 4.0], 4), np.repeat([0.5, 1.0], 4)
    seen = np.column_stack([np.full(8, 200.0), 200 + 100 * a]) + [0.48, 0.64] * sigma[:, None]
    there = [  # of which point, off its place by px, descriptor
        (0, [0, 1.5], own[0] + 2),
        (0, [1, 0], own[0] + 4),
        (1, [0, 0], 255 - own[1]),  # another thing
        (2, [0, 3.5], own[2]),
        (3, [2, 0], own[3] + 2),
        (4, [0, 0], between),
        (6, [0, 0], own[7] + 2),
        (0, [-200, 0], own[0]),
    ]
    names = ("front/1.png", "front/2.png")
    features = Features(
        pictures=tuple(Picture(name=name, size_px=camera.size_px) for name in names),
        start=np.array([0, 8, 16]),
        place=np.column_stack(
            [np.vstack([*(rim[k] + off for k, off, _ in there), seen]), np.r_[size, size]]
        ).astype(np.float32),
        descriptor=np.vstack([*(d for _, _, d in there), own]).astype(np.uint8),
        settings=SETTINGS,
    )
    block = replace(
        without_points(
            (camera,), names, np.zeros((2, 3)), np.array([np.eye(3), [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]])
        ),
        points_block_m=np.column_stack([10 * np.cos(a), 10 * np.sin(a), np.zeros(8)]),
        mark_image=np.ones(8, np.int64),
        mark_point=np.arange(8),
        mark_px=seen,
        sigma_px=sigma,
    )
    found = to_the_rim(block, features, SimpleNamespace(cameras={"front": camera}))
    assert found.mark_image.tolist() == [1] * 8 + [0] * 3
    assert found.mark_point[8:].tolist() == [0, 3, 7]
    np.testing.assert_allclose(found.mark_px[8:], rim[[0, 3, 6]] + [[0, 1.5], [2, 0], [0, 0]], atol=1e-4)
    # 3, 2 and 1.37 sigmas of their sizes off, where marks of the block are 0.8: 2.5 times in the median
    assert found.sigma_px[8:] == pytest.approx([1.25, 2.5, 2.5], rel=1e-4)
