"""Boards found in rendered pictures where roughly known poses predict them."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from tests.images import block_scene
from thalweg.core import Camera, GeometryError, exp_rotation
from thalweg.images import COLUMNS, Measured, measure_boards
from thalweg.images.bundle import grey_loader, mask_loader
from thalweg.images.control import _consistent, _correlate
from thalweg.images.model import ControlPoints, ImageBlock
from thalweg.settings.sections import ControlSettings

SIZE = (720, 540)
FOCAL = 600.0
BOARD = ControlSettings(board_m=0.6, search_m=0.3)
PLACES = np.array([[2.0, 0.0, 2.0], [6.0, 3.0, 3.2], [10.0, 1.0, 2.2], [14.0, 4.0, 3.5]])
FINE = 2


def block_of(n: int = 8) -> ImageBlock:
    """Cameras on a line before the bank."""
    camera = Camera(
        model="perspective", size_px=SIZE, parameters=np.array([FOCAL, FOCAL, 360.0, 270.0, 0, 0, 0, 0, 0])
    )
    C = np.stack([np.linspace(0, 16, n), -14 + 2 * np.sin(np.arange(n)), np.full(n, 2.5)], axis=1)
    R = np.array([block_scene.looking(0.05 * np.sin(k), 0.01 * k, 0.03 * np.cos(k)) for k in range(n)])
    return block_scene.without_points((camera,), [f"{k}.png" for k in range(n)], C, R)


def picture(block: ImageBlock, k: int, places: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A bank of speckles with boards: upright squares toward the river, upper left quarter black."""
    w, h = SIZE
    image = rng.normal(110, 35, (h * FINE // 6, w * FINE // 6)).astype(np.float32)
    image = cv2.resize(image, (w * FINE, h * FINE), interpolation=cv2.INTER_CUBIC)
    for place in places:
        seen = block.R_block_ccs[k].T @ (place - block.centre_block_m[k])
        if seen[2] <= 0:
            continue
        # the board and as much around it
        half = int(0.6 * FOCAL / seen[2] * FINE)
        column, row = (int((FOCAL * seen[a] / seen[2] + (360, 270)[a]) * FINE) for a in (0, 1))
        rows = slice(max(row - half, 0), max(row + half, 0))
        columns = slice(max(column - half, 0), max(column + half, 0))
        y, x = np.mgrid[: h * FINE, : w * FINE][:, rows, columns]
        rays = np.stack([(x + 0.5) / FINE - 360, (y + 0.5) / FINE - 270, np.full(x.shape, FOCAL)], axis=2)
        rays = rays.reshape(-1, 3) @ block.R_block_ccs[k].T
        t = (place[1] - block.centre_block_m[k, 1]) / rays[:, 1]
        hit = block.centre_block_m[k] + t[:, None] * rays
        u, v = hit[:, 0] - place[0], place[2] - hit[:, 2]
        inside = (np.maximum(np.abs(u), np.abs(v)) < 0.3).reshape(x.shape)
        dark = (np.maximum(np.abs(u), np.abs(v)) < 0.3 * (1 - 2 * 0.06)) & (u * v > 0)
        part = image[rows, columns]
        part[inside] = np.where(dark.reshape(x.shape), 30.0, 220.0)[inside]
    small = cv2.resize(image.astype(np.float32), SIZE, interpolation=cv2.INTER_AREA)
    noisy = cv2.GaussianBlur(small, (0, 0), 0.6) + rng.normal(0, 2, small.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def pictures():
    rng = np.random.default_rng(3)
    block = block_of()
    return {name: picture(block, k, PLACES, rng) for k, name in enumerate(block.images)}


def survey(places: np.ndarray = PLACES) -> ControlPoints:
    n = len(places)
    return ControlPoints(
        names=tuple(f"T{k}" for k in range(n)),
        points_wcs_m=places,
        check=np.zeros(n, bool),
        cov_wcs_m2=np.tile(1e-4 * np.eye(3), (n, 1, 1)),
    )


def roughly(block: ImageBlock) -> ImageBlock:
    """The block where a trajectory puts it: 0.4 m and a third of a degree off."""
    middle = block.centre_block_m.mean(axis=0)
    turned = block.transformed(np.eye(3), -middle, 1.0)
    return turned.transformed(
        exp_rotation([0.004, -0.003, 0.006]), middle + np.array([0.3, -0.2, 0.25]), 1.003
    )


def measure(pictures: dict[str, np.ndarray], control: ControlPoints, **changes) -> Measured:
    options = {"block": roughly(block_of()), "boards": BOARD, "mask": lambda name: None} | changes
    return measure_boards(options["block"], control, options["boards"], pictures.get, options["mask"])


def errors_px(found: Measured, places: np.ndarray = PLACES) -> np.ndarray:
    block, rows = block_of(), found.table[found.table["used"].astype(bool)]
    image = np.array([block.images.index(name) for name in rows["image"]])
    point = np.array([int(name[1:]) for name in rows["point"]])
    true = block_scene.project(
        block.cameras[0], block.R_block_ccs, block.centre_block_m, image, places[point]
    )
    return rows[["x_px", "y_px"]].to_numpy() - true


def test_boards_are_measured_to_a_tenth_of_a_pixel(pictures):
    found = measure(pictures, survey())
    assert tuple(found.table.columns) == COLUMNS
    off = errors_px(found)
    # every board that is whole in a picture, and nothing else
    block = block_of()
    k, p = np.meshgrid(np.arange(8), np.arange(4))
    xy = block_scene.project(
        block.cameras[0], block.R_block_ccs, block.centre_block_m, k.ravel(), PLACES[p.ravel()]
    )
    assert len(off) >= 0.95 * block.cameras[0].inside(xy, 16.0).sum()
    assert np.sqrt(np.square(off).mean()) < 0.1
    assert np.abs(off).max() < 0.5
    sigma = found.table.loc[found.table["used"].astype(bool), "sigma_px"]
    assert ((sigma >= 0.1) & (sigma < 0.4)).all()
    assert found.counts["used"] == len(off)
    same = measure(pictures, survey())
    assert same.table.equals(found.table)


def test_a_board_that_is_not_there_is_not_found(pictures):
    ghost = np.concatenate([PLACES, [[8.0, 2.0, 4.5]]])
    found = measure(pictures, survey(ghost))
    rows = found.table[found.table["point"] == "T4"]
    assert not rows["used"].any()
    assert (rows["reason"] != "").all()
    assert any(note.startswith("T4 was not measured") for note in found.notes)
    assert found.table["used"].sum() > 15


def test_a_point_surveyed_wrongly_is_named(pictures):
    wrong = PLACES.copy()
    wrong[1, 0] += 0.7
    found = measure(pictures, survey(wrong), boards=BOARD.replace(search_m=0.5))
    assert any("T1 is 0." in note for note in found.notes)
    # its marks are those of the board, not of the survey
    assert np.abs(errors_px(found)).max() < 0.5


def test_a_second_candidate_nearly_as_good_makes_a_mark_ambiguous():
    """Less than 0.05 behind the mark in its image; the second board is seen in one image only."""
    block, images, boards = block_of(), np.array([1, 2, 2]), [1, 1, 2]
    at = block_scene.project(
        block.cameras[0], block.R_block_ccs, block.centre_block_m, images, PLACES[boards]
    )
    sights = [
        SimpleNamespace(
            image=k,
            point=point,
            fitted=xy,
            score=0.9,
            reason="",
            by_module=np.diag([9.0, 9.0]),
            found=[(0.95, xy, 1), (second, xy + 30.0, 1)],
        )
        for k, point, xy, second in zip(images, boards, at, (0.84, 0.86, 0.3), strict=True)
    ]
    _consistent(block, sights, 4, BOARD)
    assert [sight.reason for sight in sights] == ["", "ambiguous", "in one image only"]


def test_masked_and_small_boards_are_counted(pictures):
    hidden = np.full((SIZE[1], SIZE[0]), 255, np.uint8)
    hidden[:, :360] = 0
    found = measure(pictures, survey(), mask=lambda name: hidden)
    # of another scale its pixels were taken for those of the picture
    small = measure(pictures, survey(), mask=lambda name: hidden[::2, ::2])
    assert small.counts["masked"] == found.counts["masked"]
    used = found.table[found.table["used"].astype(bool)]
    assert found.counts["masked"] > 3
    assert (used["x_px"] > 358).all()
    far = measure(pictures, survey(), boards=BOARD.replace(least_board_px=40.0))
    assert far.counts["too small"] > 10
    assert far.table["reason"].str.startswith("too small: ").any()


def test_the_colour_of_the_upper_left_quarter_counts(pictures):
    right = measure(pictures, survey(), boards=BOARD.replace(upper_left="black"))
    wrong = measure(pictures, survey(), boards=BOARD.replace(upper_left="white"))
    assert right.counts["used"] > 15
    assert wrong.counts["used"] == 0


def test_images_that_cannot_be_read_are_told(pictures):
    found = measure({k: v for k, v in pictures.items() if k != "3.png"}, survey())
    rows = found.table[found.table["image"] == "3.png"]
    assert set(rows["reason"]) == {"no picture"}
    with pytest.raises(GeometryError, match="no control points to look for"):
        measure(pictures, ControlPoints.none())


def test_pictures_and_masks_are_found_by_name(tmp_path):
    (tmp_path / "deep").mkdir()
    cv2.imwrite(str(tmp_path / "deep" / "a.jpg"), np.full((4, 5), 200, np.uint8))
    (tmp_path / "b.jpg").write_text("none")
    load = grey_loader([tmp_path])
    found = load("a.jpg")
    assert found is not None
    assert found.shape == (4, 5)
    assert load("b.jpg") is None
    assert load("c.jpg") is None
    cv2.imwrite(str(tmp_path / "a.jpg.png"), np.zeros((4, 5), np.uint8))
    cv2.imwrite(str(tmp_path / "d.png"), np.full((4, 5), 255, np.uint8))
    masks = mask_loader(tmp_path)
    for name, value in (("a.jpg", 0), ("d.jpg", 255)):
        mask = masks(name)
        assert mask is not None
        assert (mask == value).all()
    assert masks("e.jpg") is None
    assert mask_loader(None)("a.jpg") is None


@pytest.mark.parametrize("turned", [False, True])
def test_a_crossing_in_a_window_that_holds_its_template(turned):
    """A board seen askew: its template is wider than high, as is the picture, or both the other way round."""
    y, x = np.mgrid[:26, :220] + 0.5
    picture = np.where((x - 90.5) * (y - 13.5) > 0, 220, 30).astype(np.uint8)
    sight = SimpleNamespace(
        xy=np.array([91.0, 13.0]),
        by_module=np.diag([40.0, 5.0]),
        reach_px=3.0,
        found=[],
        reason="",
        score=0.0,
    )
    if turned:
        picture, sight.xy, sight.by_module = picture.T, sight.xy[::-1], np.diag([5.0, 40.0])
    _correlate(picture, sight, BOARD)
    (score, place, sign) = sight.found[0]
    assert (score, sign, sight.reason) == (sight.score, 1, "")
    assert np.abs(place - ([13.5, 90.5] if turned else [90.5, 13.5])).max() <= 1.0
    sight.found = []
    _correlate(picture[:3, :3], sight, BOARD)
    assert (sight.found, sight.reason) == ([], "at the edge of the image")
