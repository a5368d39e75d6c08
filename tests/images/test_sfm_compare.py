"""Pairs of images dealt out to jobs, and blocks of two cameras with pictures of one size."""

import runpy
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from tests.images.sfm_scene import PERSPECTIVE, photographs, similarity
from thalweg.core import InputError
from thalweg.images.model import ImageBlock
from thalweg.images.sfm import (
    ComparedPairs,
    Known,
    Matches,
    colmap,
    compare_pairs,
    extract_features,
    joined_parts,
    map_images,
    match_images,
    part_of_pairs,
)
from thalweg.images.sfm.features import Features
from thalweg.images.sfm.mapping import held_cameras
from thalweg.images.sfm.matching import fill_database, plan_matches
from thalweg.ingest.photos import named_images
from thalweg.settings.sections import FeatureSettings, MappingSettings

LONG = replace(PERSPECTIVE, parameters=PERSPECTIVE.parameters * np.array([1.4, 1.4, 1, 1, 1, 1, 1, 1, 1]))
"""A camera of the same picture size with 378 px instead of 270 px."""
SETTINGS = FeatureSettings(max_features=1000)


class Two:
    """Two cameras along one wall, both with images image_01.png ... in folders of their own."""

    def __init__(self, folder: Path) -> None:
        left = photographs(folder / "left", PERSPECTIVE, x=np.linspace(-2.2, 2.2, 6))
        right = photographs(folder / "right", LONG, x=np.linspace(-1.9, 1.9, 6))
        self.images = named_images([folder])
        self.centre = np.concatenate([left.centre, right.centre])
        self.features = extract_features(self.images, settings=SETTINGS)

    def away(self, block: ImageBlock) -> float:
        """Largest error of a projection centre after a similarity, units of the scene."""
        rows = [list(self.images).index(name) for name in block.images]
        scale, R, shift = similarity(block.centre_block_m, self.centre[rows])
        moved = block.transformed(R, shift, scale)
        return float(np.linalg.norm(moved.centre_block_m - self.centre[rows], axis=1).max())


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    return Two(tmp_path_factory.mktemp("two"))


@pytest.fixture(scope="module")
def whole(two):
    """All pairs compared in one job."""
    return match_images(two.features, two.images)


@pytest.fixture(scope="module")
def half_known(two):
    """With the camera of one folder."""
    return match_images(two.features, two.images, known=Known(of_folder={"right": LONG}))


def test_two_cameras_of_one_size_have_focal_lengths_of_their_own(two, whole):
    found = whole
    assert found.camera.tolist() == [0] * 6 + [1] * 6
    (block,) = map_images(found).pieces
    assert block.images == tuple(two.images)
    assert block.camera.tolist() == [0] * 6 + [1] * 6
    assert [camera.name for camera in block.cameras] == ["left", "right"]
    focal = [camera.parameters[0] for camera in block.cameras]
    # 384 px were guessed for both; one radial term stands for two and takes some of the focal length
    assert focal == pytest.approx([270, 378], rel=0.02)
    assert two.away(block) < 0.04
    # as one camera they have one focal length, which is that of neither
    section = MappingSettings(cameras="size")
    pieces = map_images(match_images(two.features, two.images, section=section)).pieces
    assert all(len(piece.cameras) == 1 for piece in pieces)
    assert not any(len(p.images) == 12 and two.away(p) < 0.04 for p in pieces)


def test_a_given_camera_stays_while_that_of_another_folder_is_estimated(two, half_known):
    found = half_known
    assert held_cameras(found, MappingSettings()) == {2}
    assert held_cameras(found, MappingSettings(interior="estimated")) == {2}
    assert held_cameras(found, MappingSettings(interior="fixed")) == set()
    (block,) = map_images(found).pieces
    np.testing.assert_array_equal(block.cameras[1].parameters, LONG.parameters)
    assert block.cameras[0].parameters[0] == pytest.approx(270, rel=0.02)
    both = match_images(two.features, two.images, known=Known(of_folder={"left": PERSPECTIVE, "right": LONG}))
    (block,) = map_images(both).pieces
    assert [c.parameters[0] for c in block.cameras] == [270.0, 378.0]
    # marks of 0.1 to 0.2 px at 270 px, 6 units away, as in test_sfm_block
    assert two.away(block) < 0.02


def test_the_database_has_a_camera_for_each_folder(two, tmp_path):
    plan = plan_matches(two.features, two.images, known=Known(of_folder={"left": PERSPECTIVE, "right": LONG}))
    fill_database(tmp_path / "block.db", plan, descriptor=two.features.descriptor)
    with colmap().Database.open(tmp_path / "block.db") as database:
        cameras = {camera.camera_id: camera.params[0] for camera in database.read_all_cameras()}
        of_image = {image.image_id: image.camera_id for image in database.read_all_images()}
    assert cameras == {1: 270.0, 2: 378.0}
    assert of_image == {k + 1: 1 if k < 6 else 2 for k in range(12)}


def equal(a: Matches, b: Matches) -> bool:
    names = ("pairs", "n_matches", "config", "geometry", "pair_start", "common")
    return all(np.array_equal(getattr(a, n), getattr(b, n), equal_nan=n == "geometry") for n in names)


@pytest.mark.parametrize("parts", [1, 7])
def test_any_number_of_parts_gives_the_same_matches(two, whole, tmp_path, parts):
    plan = plan_matches(two.features, two.images)
    rows = [part_of_pairs(plan, k, parts) for k in range(parts)]
    assert np.array_equal(np.concatenate(rows), np.arange(len(plan.pairs)))
    done = []
    for k in range(parts):
        compare_pairs(plan, two.features.descriptor, rows[k], threads=1 + k % 2).write(tmp_path / f"{k}.npz")
        done.append(ComparedPairs.read(tmp_path / f"{k}.npz"))
    joined = joined_parts(plan, done[::-1])
    assert equal(joined, whole)
    joined.write(tmp_path / "joined.npz")
    whole.write(tmp_path / "whole.npz")
    assert (tmp_path / "joined.npz").read_bytes() == (tmp_path / "whole.npz").read_bytes()
    if parts > 1:
        with pytest.raises(
            InputError, match=rf"compared pairs of images in {parts - 1} parts; expected the 66"
        ):
            joined_parts(plan, done[1:])
        with pytest.raises(InputError, match="each once"):
            joined_parts(plan, [*done, done[0]])


def test_parts_cost_alike_and_may_be_empty(two):
    plan = plan_matches(two.features, two.images)
    n = np.diff(plan.start)
    cost = n[plan.pairs[:, 0]] * n[plan.pairs[:, 1]]
    shares = [cost[part_of_pairs(plan, k, 4)].sum() / cost.sum() for k in range(4)]
    # a part ends with a whole pair: up to the largest pair's share off on either side
    assert np.abs(np.array(shares) - 0.25).max() <= cost.max() / cost.sum()
    many = [part_of_pairs(plan, k, 200) for k in range(200)]
    assert all(a[-1] < b[0] for a, b in pairwise([part for part in many if len(part)]))
    assert np.array_equal(np.concatenate(many), np.arange(len(plan.pairs)))
    empty = compare_pairs(plan, two.features.descriptor, np.zeros(0, np.int64))
    assert len(empty.pairs) == 0
    with pytest.raises(InputError, match="part 4; expected 0 to 3"):
        part_of_pairs(plan, 4, 4)


def test_the_jobs_of_the_parts_and_their_join(two, half_known, repository, tmp_path):
    two.features.write(tmp_path / "features.npz")
    assert Features.read(tmp_path / "features.npz", descriptors=False).descriptor.shape == (0, 128)
    shared = {
        "features": [tmp_path / "features.npz"],
        "images": [next(iter(two.images.values())).parents[1]],
        "camera": [],
        "times": [],
        "trajectory": [],
        "interiors": [tmp_path / "cameras.txt"],
        "folders": ["right"],
    }
    values = " ".join(str(v) for v in LONG.parameters[:8])
    (tmp_path / "cameras.txt").write_text(f"1 OPENCV 320 240 {values}\n")
    written = []
    for parts in (1, 2):
        options = MappingSettings()
        pairs = [tmp_path / f"pairs_{k}.npz" for k in range(parts)]
        for k, path in enumerate(pairs):
            script(repository, "match_features")(
                pairs=path, part=k, parts=parts, options=options, threads=1, device="cpu", **shared
            )
        out = tmp_path / f"matches_{parts}.npz"
        script(repository, "join_matches")(pairs=pairs, matches=out, options=options, **shared)
        written.append(out.read_bytes())
    assert written[0] == written[1]
    assert equal(Matches.read(tmp_path / "matches_2.npz"), half_known)


def script(repository: Path, name: str):
    return runpy.run_path(str(repository / f"workflow/scripts/{name}.py"))["main"]
