"""From photographs of a known scene to a block: poses, tracks, repeatability, pieces, and reasons."""

import json
import runpy
import shutil
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pycolmap
import pytest
from PIL import Image, ImageFilter

from tests.benchmarks.voyage_scene import voyage
from tests.images.sfm_scene import FISHEYE, PERSPECTIVE, Photographs, photographs, similarity
from thalweg.core import Camera, InputError, LocalFrame, Trajectory
from thalweg.images.model import ImageBlock
from thalweg.images.sfm import (
    Known,
    Matches,
    block_facts,
    extract_features,
    image_table,
    main_block,
    map_images,
    match_images,
)
from thalweg.images.sfm.features import Features, join_features
from thalweg.images.sfm.mapping import Mapped, firm_parts, impossible_lens, part_of_block
from thalweg.images.sfm.matching import read_times
from thalweg.settings.sections import FeatureSettings, MappingSettings

KNOWN = Known(cameras=(PERSPECTIVE,))
FIXED = MappingSettings(interior="fixed")


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    return photographs(tmp_path_factory.mktemp("wall"))


@pytest.fixture(scope="module")
def features(wall):
    return extract_features(wall.files, threads=2)


@pytest.fixture(scope="module")
def matches(wall, features):
    return match_images(features, wall.files, known=KNOWN)


def errors(block: ImageBlock, truth: Photographs) -> tuple[float, float]:
    """Largest errors of centres, units of the scene, and of attitudes, degrees, after a similarity."""
    k = [int(name[6:8]) - 1 for name in block.images]
    scale, R, shift = similarity(block.centre_block_m, truth.centre[k])
    moved = block.transformed(R, shift, scale)
    turned = np.einsum("kji,kjl->kil", moved.R_block_ccs, truth.R[k])
    angle = np.arccos(np.clip((np.trace(turned, axis1=1, axis2=2) - 1) / 2, -1, 1))
    away = np.linalg.norm(moved.centre_block_m - truth.centre[k], axis=1)
    return float(away.max()), float(np.degrees(angle).max())


def equal(a: ImageBlock, b: ImageBlock) -> bool:
    names = [n for n in ImageBlock.__dataclass_fields__ if n not in ("cameras", "images")]
    return (
        a.images == b.images
        and all(np.array_equal(getattr(a, n), getattr(b, n)) for n in names)
        and all(np.array_equal(x.parameters, y.parameters) for x, y in zip(a.cameras, b.cameras, strict=True))
    )


def test_poses_are_those_of_the_scene(wall, matches):
    mapped = map_images(matches, settings=FIXED)
    (block,) = mapped.pieces
    assert block.images == tuple(f.name for f in wall.files)
    away, angle = errors(block, wall)
    # marks of 0.1 to 0.2 px at 270 px, 6 units away: 3 mm of a unit each; a block of 9 images and 500 marks
    # an image errs by as much at its ends
    assert away < 0.015
    assert angle < 0.4
    assert np.array_equal(block.cameras[0].parameters, PERSPECTIVE.parameters)
    rms = np.sqrt(np.mean(np.sum(block.residuals_px() ** 2, axis=1)))
    assert rms == pytest.approx(mapped.facts["pieces"][0]["rms_px"])
    assert rms < 0.5


def test_tracks_have_two_images_and_no_doubled_marks(matches):
    mapped = map_images(matches, settings=FIXED)
    (block,) = mapped.pieces
    assert np.bincount(block.mark_point).min() >= 2
    pairs = np.column_stack([block.mark_image, block.mark_point])
    assert len(np.unique(pairs, axis=0)) == len(pairs)
    # SIFT's second direction at the same place
    places = np.column_stack([block.mark_image, block.mark_px])
    assert len(np.unique(places, axis=0)) == len(places)
    left_out = mapped.facts["pieces"][0]["marks_left_out"]
    assert left_out["same_place_as_a_longer_track"] > 100
    # large features are placed less well, as their residuals say
    classes = mapped.facts["pieces"][0]["sigma_classes"]
    assert classes[-1]["spread_px"] > 2 * classes[0]["spread_px"]
    assert block.sigma_px.max() > 2 * block.sigma_px.min()
    assert np.median(block.sigma_px) == pytest.approx(0.4, rel=0.1)


@pytest.mark.parametrize(
    ("settings", "threads"),
    [(MappingSettings(interior="estimated"), 2), (MappingSettings(method="global"), 2)],
    ids=["incremental", "global"],
)
def test_the_same_matches_give_the_same_block(matches, settings, threads):
    first = map_images(matches, settings=settings, threads=threads)
    again = map_images(matches, settings=settings, threads=1)
    assert equal(first.pieces[0], again.pieces[0])
    assert first.facts == again.facts


def test_threads_and_files_change_nothing(wall, features, matches, tmp_path):
    other = match_images(features, wall.files[::-1], known=KNOWN, threads=2)
    other.write(tmp_path / "b.npz")
    matches.write(tmp_path / "a.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    read = Matches.read(tmp_path / "a.npz")
    assert equal(map_images(read, settings=FIXED).pieces[0], map_images(matches, settings=FIXED).pieces[0])


def test_a_camera_of_which_nothing_is_known(wall, features):
    found = match_images(features, wall.files)
    assert found.facts["interior"] == ["1.2 times the longer side, a guess, SIMPLE_RADIAL, 384.0 px"]
    (block,) = map_images(found).pieces
    assert len(block.images) == len(wall.files)
    # 384 px were guessed, 270 px are true; one radial term for two takes some of the focal length
    assert block.cameras[0].parameters[0] == pytest.approx(270, rel=0.02)
    assert errors(block, wall)[0] < 0.04


@pytest.fixture(scope="module")
def fisheyes(tmp_path_factory):
    truth = photographs(tmp_path_factory.mktemp("fisheyes"), FISHEYE, x=np.linspace(-2.1, 2.1, 6))
    return truth, match_images(extract_features(truth.files), truth.files, known=Known(cameras=(FISHEYE,)))


@pytest.mark.parametrize("method", ["incremental", "global"])
def test_fisheyes(fisheyes, method):
    truth, found = fisheyes
    settings = MappingSettings(method=method, interior="estimated")
    (block,) = map_images(found, settings=settings).pieces
    assert len(block.images) == 6
    assert block.cameras[0].model == "fisheye"
    away, angle = errors(block, truth)
    # as above; a fisheye of 110 px sees three times as wide
    assert away < 0.015
    assert angle < 0.4
    # the self-calibration stays at the truth within a hundredth
    assert block.cameras[0].parameters[:2] == pytest.approx([110, 110], rel=0.01)


def test_a_block_that_splits_is_said_and_kept(tmp_path):
    x = np.concatenate([np.linspace(-2.4, -0.3, 5), np.linspace(13.0, 14.4, 4)])
    truth = photographs(tmp_path, x=x)
    found = match_images(extract_features(truth.files), truth.files, known=KNOWN)
    mapped = map_images(found, settings=FIXED)
    assert [len(piece.images) for piece in mapped.pieces] == [5, 4]
    assert all(errors(piece, truth)[0] < 0.03 for piece in mapped.pieces)
    table = image_table(found, mapped)
    assert table["component"].tolist() == table["piece"].tolist() == [0] * 5 + [1] * 4
    assert table["registered"].tolist() == [True] * 5 + [False] * 4
    assert set(table["cause"][5:]) == {"other_piece"}
    assert "in piece 1 of 4 images" in table["reason"][5]
    facts = block_facts(found, mapped, table)
    assert facts["left_out"] == {"other_piece": 4}
    (gap,) = facts["gaps"]
    assert (gap["after"], gap["before"], gap["images_between"]) == ("image_05.png", "image_06.png", 0)
    said = "the block falls into 2 pieces: 5 images (image_01.png to image_05.png), 4 images (image_06.png to"
    assert any(note.startswith(said) for note in facts["notes"])
    assert facts["pieces"][1]["names"] == [f"image_0{k}.png" for k in range(6, 10)]
    json.dumps(facts)


def test_a_large_block_in_overlapping_parts_is_that_of_all_images(monkeypatch):
    """Also where each part has estimated its lens from a guess that is 3 % wrong."""
    voyage_of = voyage(40, density=40)
    guess = np.multiply(voyage_of.starts[0].camera.parameters, [1.03, 1.03, *[1.0] * 7])
    camera = replace(voyage_of.starts[0].camera, parameters=guess)
    guessed = replace(voyage_of, starts=(replace(voyage_of.starts[0], source="guess", camera=camera),))
    for matches, f_within_px in ((voyage_of, 0.0), (guessed, 0.5)):
        whole = map_images(matches)
        with monkeypatch.context() as patched:
            patched.setattr("thalweg.images.sfm.mapping.LARGE_BLOCK", 20)
            patched.setattr("thalweg.images.sfm.mapping._SHARED", 8)
            parts = map_images(matches)
            assert equal(parts.pieces[0], map_images(matches, threads=2).pieces[0])
            # put together by half of the features, with the points of all
            patched.setattr("thalweg.images.sfm.mapping._SEARCHED", 150)
            (few,) = map_images(matches).pieces
        assert parts.facts["notes"] == ["40 images were mapped in overlapping parts of at most 20"]
        (one,), (joined,) = whole.pieces, parts.pieces
        assert joined.images == one.images
        assert abs(joined.cameras[0].parameters[0] - one.cameras[0].parameters[0]) <= f_within_px
        scale, R, shift = similarity(joined.centre_block_m, one.centre_block_m)
        moved = joined.transformed(R, shift, scale)
        bank_m = np.ptp(one.centre_block_m, axis=0).max()  # 39 m, so that the limit is 2 mm
        assert np.linalg.norm(moved.centre_block_m - one.centre_block_m, axis=1).max() < 5e-5 * bank_m
        assert few.images == one.images
        assert not equal(few, joined)
        assert len(few.mark_image) == pytest.approx(len(one.mark_image), rel=0.01)
        scale, R, shift = similarity(few.centre_block_m, one.centre_block_m)
        moved = few.transformed(R, shift, scale)
        # half of the features, and no adjustment with all: 1.5e-4 was seen
        assert np.linalg.norm(moved.centre_block_m - one.centre_block_m, axis=1).max() < 5e-4 * bank_m


def test_parts_that_are_not_joined_are_mapped_in_one(matches, monkeypatch):
    monkeypatch.setattr("thalweg.images.sfm.mapping.LARGE_BLOCK", 5)
    whole = pycolmap.incremental_mapping

    def two_models(*arguments: Any) -> dict[int, Any]:
        (model,) = whole(*arguments[:3], arguments[3].incremental_options).values()
        *first, last = model.reg_frame_ids()
        parts = [pycolmap.Reconstruction(model) for _ in range(2)]
        parts[0].deregister_frame(first[0])
        parts[1].deregister_frame(last)
        return dict(enumerate(parts))

    monkeypatch.setattr(pycolmap, "hierarchical_mapping", two_models)
    mapped = map_images(matches, settings=FIXED)
    n = len(matches.order)
    assert mapped.facts["notes"] == [f"{n} images were mapped in one: parts of them could not be joined"]
    (block,) = mapped.pieces
    assert len(block.images) == n


def test_a_part_of_a_block_has_the_same_marks_at_the_same_residuals(matches):
    (block,) = map_images(matches, settings=FIXED).pieces
    assert [part.tolist() for part in firm_parts(block, 15)] == [list(range(9))]
    piece, rows = part_of_block(block, np.arange(4))
    assert piece.images == block.images[:4]
    assert np.bincount(piece.mark_point).min() >= 2
    np.testing.assert_array_equal(piece.residuals_px(), block.residuals_px()[rows])


def test_auto_keeps_a_given_camera_and_estimates_a_guess(wall, matches):
    (held,) = map_images(matches, settings=MappingSettings()).pieces
    assert held.cameras[0].parameters[0] == 270
    (block,) = map_images(matches, settings=MappingSettings(interior="estimated")).pieces
    assert 0 < abs(block.cameras[0].parameters[0] - 270) < 5


def test_a_given_camera_is_freed_once_the_block_stands(wall, features):
    """Two per cent off, as after another focus: the first pairs keep it, nine images tell."""
    off = PERSPECTIVE.with_parameters(
        PERSPECTIVE.parameters * np.r_[1.02, 1.02, np.ones(len(PERSPECTIVE.parameters) - 2)]
    )
    known = replace(off, cov=np.diag(np.r_[0.09, 0.09, np.zeros(len(off.parameters) - 2)]))
    found = match_images(features, wall.files, known=Known(cameras=(known,)))
    mapped = map_images(found, settings=MappingSettings(interior="estimated"))
    (block,) = mapped.pieces
    assert len(block.images) == len(wall.files)
    assert block.cameras[0].parameters[0] == pytest.approx(270, rel=0.012)
    assert any("of its standard deviations: another zoom or focus?" in note for note in mapped.facts["notes"])
    (few,) = map_images(
        match_images(extract_features(wall.files[:4]), wall.files[:4], known=Known(cameras=(known,))),
        settings=MappingSettings(interior="estimated"),
    ).pieces
    assert few.cameras[0].parameters[0] == pytest.approx(1.02 * 270)  # four do not


@pytest.mark.parametrize(
    ("f", "k1", "k2", "words"),
    [
        (400.0, -0.2, 0.05, ""),
        (400.0, 0.3, 0.0, ""),
        (10.3, 0.0, 0.0, "impossible, f 10 px for pictures of 640 px"),
        (400.0, -0.6, 0.0, "it folds the picture"),
        (1542.0, 0.1, -13.7, "it folds the picture"),  # what two images of a turntable gave, k2 of a fold
    ],
)
def test_impossible_lenses_are_told(f, k1, k2, words):
    side = 2400 if f > 1000 else 640
    size = (side, side * 3 // 4)
    lens = Camera(
        model="perspective",
        size_px=size,
        parameters=np.array([f, f, size[0] / 2, size[1] / 2, k1, k2, 0.0, 0.0, 0.0]),
    )
    assert words in impossible_lens(lens)
    assert bool(words) == bool(impossible_lens(lens))


def test_every_image_that_stays_out_has_its_reason(wall, tmp_path):
    for file in wall.files[:5]:
        shutil.copy(file, tmp_path)
    shutil.copy(wall.files[1], tmp_path / "image_20.png")
    (tmp_path / "image_21.png").write_bytes(b"broken")
    noise = np.random.default_rng(5).normal(128, 60, (240, 320)).clip(0, 255).astype(np.uint8)
    Image.fromarray(noise).filter(ImageFilter.GaussianBlur(1.2)).save(tmp_path / "image_22.png")
    with Image.open(wall.files[5]) as image:
        image.filter(ImageFilter.GaussianBlur(3.5)).save(tmp_path / "image_23.png")
        image.resize((240, 320)).save(tmp_path / "image_24.png")
    files = sorted(tmp_path.glob("*.png"))
    settings = FeatureSettings(min_features=10)
    found = match_images(join_features([extract_features(files, settings=settings)]), files, known=KNOWN)
    mapped = map_images(found, settings=FIXED)
    table = image_table(found, mapped).set_index("image")
    cause = table["cause"]
    assert (cause[:5] == "").all()
    assert table["registered"].sum() == 5 + (cause["image_23.png"] == "")
    assert cause["image_20.png"] == "double"
    assert cause["image_21.png"] == "unreadable"
    assert cause["image_22.png"] == "no_overlap"
    assert "no overlap with the 6 images" in table["reason"]["image_22.png"]
    assert cause["image_24.png"] == "size"
    assert table["reason"]["image_24.png"] == "240 x 320 pixels, the camera has 320 x 240"
    assert table["sharpness"]["image_23.png"] < 0.5 * table["sharpness"]["image_01.png"]
    facts = block_facts(found, mapped, table.reset_index())
    assert facts["left_out"]["double"] == facts["left_out"]["unreadable"] == facts["left_out"]["size"] == 1
    assert any("are not of the size of the given camera" in note for note in facts["notes"])
    assert "1 images, such as image_20.png, are the same files as others: left out" in facts["notes"]
    assert table["marks"].sum() == len(mapped.pieces[0].mark_image)
    assert (table["pairs_compared"][["image_20.png", "image_21.png", "image_24.png"]] == 0).all()


def test_one_image_and_none_that_overlap(wall, tmp_path, features):
    one = extract_features(wall.files[:1])
    with pytest.raises(InputError, match=r"1 of 1 images can take part; expected at least two"):
        match_images(one, wall.files, known=KNOWN)
    truth = photographs(tmp_path, x=np.array([-2.0, 13.0]))
    found = match_images(extract_features(truth.files), truth.files, known=KNOWN)
    mapped = map_images(found, settings=FIXED)
    assert mapped.pieces == ()
    table = image_table(found, mapped)
    assert table["cause"].tolist() == ["no_overlap"] * 2
    with pytest.raises(
        InputError, match=r"no two of 2 images could be oriented.*no overlap with the 1 images"
    ):
        main_block(mapped, dict(zip(table["image"], table["reason"], strict=True)))
    assert block_facts(found, mapped, table)["registered"] == 0
    assert main_block(Mapped(pieces=(mapped_two(wall, features),), facts={}), {}).images


def test_a_camera_that_stood_still_is_named(wall, tmp_path, rng):
    """Three pictures of one place, each with noise of its own: no depth, and the cure is a resection."""
    for k in range(3):
        with Image.open(wall.files[3]) as image:
            seen = np.asarray(image, np.float64)
        noisy = seen + rng.normal(0.0, 2.0, seen.shape)
        Image.fromarray(noisy.clip(0, 255).astype(np.uint8)).save(tmp_path / f"image_{k}.png")
    files = sorted(tmp_path.glob("*.png"))
    found = match_images(extract_features(files), files, known=KNOWN)
    mapped = map_images(found, settings=FIXED)
    table = image_table(found, mapped)
    assert mapped.pieces == ()
    assert table["cause"].tolist() == ["stood_still"] * 3
    assert table["reason"].str.contains("lie where they were.*thalweg resect").all()


def mapped_two(wall: Photographs, features: Features) -> ImageBlock:
    """Two images are a block."""
    two = extract_features(wall.files[3:5])
    (block,) = map_images(match_images(two, wall.files, known=KNOWN), settings=FIXED).pieces
    assert len(block.images) == 2
    assert len(block.points_block_m) > 100
    return block


def test_sizes_without_a_given_camera_have_cameras_of_their_own(wall, tmp_path):
    for k, file in enumerate(wall.files[2:7]):
        with Image.open(file) as image:
            size = (480, 360) if k == 2 else image.size
            image.resize(size, Image.Resampling.BICUBIC).save(tmp_path / file.name)
    files = sorted(tmp_path.glob("*.png"))
    found = match_images(extract_features(files), files)
    assert found.facts["notes"] == ["images of 2 sizes: each size has an interior orientation of its own"]
    (block,) = map_images(found).pieces
    assert [camera.size_px for camera in block.cameras] == [(320, 240), (480, 360)]
    assert block.camera.tolist() == [0, 0, 1, 0, 0]
    with pytest.raises(InputError, match="none is given"):
        match_images(extract_features(files), files, section=MappingSettings(interior="fixed"))


def test_times_and_a_trajectory_choose_the_pairs(wall, features, tmp_path):
    t = {file.name: 100.0 + k for k, file in enumerate(wall.files)}
    pd.DataFrame({"file": list(t), "t_gps_s": list(t.values())}).to_parquet(tmp_path / "times.parquet")
    assert read_times(tmp_path / "times.parquet") == t
    n = len(wall.files)
    trajectory = Trajectory(
        frame=LocalFrame(lat_deg=48.0, lon_deg=14.0, h_ell_m=250.0),
        t_gps_s=np.array([99.0, 120.0]),
        position_wcs_m=np.array([[-3.0, 0, 0], [60.0, 0, 0]]),
        quaternion_wcs_ics=np.array([[0, 0, 0, 1.0], [0, 0, 0, 1.0]]),
        cov_pose_wcs=np.tile(np.eye(6), (2, 1, 1)),
        valid=np.array([True, True]),
    )
    known = replace(KNOWN, t_s=t, trajectory=trajectory)
    section = MappingSettings(pairs="spatial", overlap=1, quadratic=False, max_distance_m=6.5)
    found = match_images(features, wall.files, known=known, section=section)
    assert (found.facts["images_with_time"], found.facts["images_with_position"]) == (n, n)
    # 3 units a second: neighbours in time, and the next but one 6 units away
    assert set((found.pairs[:, 1] - found.pairs[:, 0]).tolist()) == {1, 2}
    pd.DataFrame({"a": [1]}).to_parquet(tmp_path / "other.parquet")
    with pytest.raises(InputError, match="the columns a; expected file or image"):
        read_times(tmp_path / "other.parquet")


def test_the_four_scripts(wall, matches, repository, tmp_path):
    def script(name: str) -> object:
        return runpy.run_path(str(repository / f"workflow/scripts/{name}.py"))["main"]

    parts = [tmp_path / f"part_{k}.npz" for k in range(2)]
    alone = {"threads": 1, "device": "cpu"}
    for k, part in enumerate(parts):
        script("extract_features")(  # type: ignore[operator]
            images=wall.files, masks=[], features=part, part=k, parts=2, options=FeatureSettings(), **alone
        )
    camera = tmp_path / "cameras.txt"
    values = " ".join(str(v) for v in PERSPECTIVE.parameters[:8])
    camera.write_text(f"1 OPENCV 320 240 {values}\n")
    mapping = MappingSettings(interior="fixed")
    shared = {
        "features": parts,
        "images": wall.files,
        "camera": [camera],
        "interiors": [],
        "folders": [],
        "times": [],
        "trajectory": [],
        "options": mapping,
    }
    script("match_features")(pairs=tmp_path / "pairs.npz", part=0, parts=1, **alone, **shared)  # type: ignore[operator]
    script("join_matches")(  # type: ignore[operator]
        pairs=[tmp_path / "pairs.npz"], matches=tmp_path / "matches.npz", **shared
    )
    assert np.array_equal(Matches.read(tmp_path / "matches.npz").common, matches.common)
    script("map_images")(  # type: ignore[operator]
        matches=Matches.read(tmp_path / "matches.npz"),
        block=tmp_path / "block.npz",
        pieces=tmp_path / "pieces",
        images=tmp_path / "images.csv",
        facts=tmp_path / "facts.json",
        options=mapping,
        threads=1,
        device="cpu",
    )
    block = ImageBlock.read(tmp_path / "block.npz")
    assert equal(block, map_images(matches, settings=FIXED).pieces[0])
    assert pd.read_csv(tmp_path / "images.csv")["registered"].all()
    assert json.loads((tmp_path / "facts.json").read_text())["registered"] == len(wall.files)
    assert list((tmp_path / "pieces").iterdir()) == []
