"""Order of images and the pairs that are compared."""

from types import SimpleNamespace

import numpy as np
import pytest

from thalweg.core import Camera, GeometryError
from thalweg.images.sfm.colmap import StartCamera
from thalweg.images.sfm.mapping import _components, _elsewhere, firm_parts
from thalweg.images.sfm.matching import _named, image_pairs, order_in_time
from thalweg.settings.sections import MappingSettings

NAMES = ["img_2.jpg", "img_10.jpg", "img_1.jpg", "img_3.jpg"]


def as_set(pairs: np.ndarray) -> set[tuple[int, int]]:
    return {(int(a), int(b)) for a, b in pairs}


OTHER_ORDER = "names do not follow time at 1 places: the order in time counts"
WITHOUT_TIME = "1 images without time, such as img_2.jpg, are placed by their names"


@pytest.mark.parametrize(
    ("t_s", "numbers", "notes"),
    [
        pytest.param(None, [1, 2, 3, 10], [], id="names count by their numbers"),
        pytest.param([np.nan] * 4, [1, 2, 3, 10], [], id="no image has a time"),
        pytest.param([20, 5, 10, 30], [10, 1, 2, 3], [OTHER_ORDER], id="time counts before names"),
        pytest.param([10, 10.5, 10, 10], [1, 2, 3, 10], [], id="equal times follow the names"),
        pytest.param([np.nan, 5, 10, 30], [10, 1, 2, 3], [WITHOUT_TIME, OTHER_ORDER], id="behind its name"),
        pytest.param(
            [np.nan, 30, 10, 5], [3, 1, 2, 10], [WITHOUT_TIME, OTHER_ORDER], id="between the others"
        ),
    ],
)
def test_the_order_of_images(t_s, numbers, notes):
    order, told = order_in_time(NAMES, None if t_s is None else np.array(t_s, float))
    assert [NAMES[k] for k in order] == [f"img_{n}.jpg" for n in numbers]
    assert told == notes


def test_sequential_pairs():
    order = np.array([3, 1, 0, 2, 4, 5])
    pairs, kind = image_pairs(order, MappingSettings(pairs="sequential", overlap=1, quadratic=False))
    assert kind == "sequential"
    assert as_set(pairs) == {(1, 3), (0, 1), (0, 2), (2, 4), (4, 5)}
    pairs, _ = image_pairs(np.arange(20), MappingSettings(pairs="sequential", overlap=3))
    # steps 1, 2, 3 and the powers of two below 2^3
    assert set((pairs[:, 1] - pairs[:, 0]).tolist()) == {1, 2, 3, 4}
    assert len(pairs) == 19 + 18 + 17 + 16


def test_pairs_by_position_join_two_passes_of_the_same_bank():
    x = np.concatenate([np.arange(40.0), np.arange(40.0)[::-1]])
    position = np.column_stack([x, np.zeros(80), np.zeros(80)])
    settings = MappingSettings(pairs="auto", overlap=3, quadratic=False, max_distance_m=2.5, max_neighbours=4)
    pairs, kind = image_pairs(np.arange(80), settings, position)
    assert kind == "spatial"
    found = as_set(pairs)
    assert (10, 69) in found  # the same place on the way back
    far = [abs(x[a] - x[b]) for a, b in found if b - a > 3]
    assert far
    assert max(far) <= 2.5
    only_time, _ = image_pairs(np.arange(80), MappingSettings(pairs="sequential", overlap=3, quadratic=False))
    assert as_set(only_time) < found
    # images without position are still neighbours in time
    position[20:25] = np.nan
    pairs, _ = image_pairs(np.arange(80), settings, position)
    assert (21, 22) in as_set(pairs)
    assert not any(a in range(20, 25) and b - a > 3 for a, b in as_set(pairs))


def test_auto_compares_few_images_all_with_all():
    pairs, kind = image_pairs(np.array([0, 2, 5]), MappingSettings())
    assert (kind, as_set(pairs)) == ("exhaustive", {(0, 2), (0, 5), (2, 5)})
    assert image_pairs(np.arange(31), MappingSettings())[1] == "sequential"
    pairs, _ = image_pairs(np.array([4]), MappingSettings())
    assert pairs.shape == (0, 2)


def test_pairs_by_position_need_positions():
    with pytest.raises(
        GeometryError, match=r"no image has an approximate position.*sequential or exhaustive"
    ):
        image_pairs(np.arange(5), MappingSettings(pairs="spatial"), np.full((5, 3), np.nan))


def test_names_of_cameras_are_their_own():
    camera = Camera(model="perspective", size_px=(9, 9), parameters=np.ones(9), name="given")
    start = StartCamera(camera=camera, lens="", known=True, source="")
    groups = [SimpleNamespace(name="GoPro"), SimpleNamespace(name="phone")]
    assert _named(start, 1, groups, ["phone", "phone_2"], given=True).camera.name == "phone_3"
    assert _named(start, 0, groups[1:], [], given=True).camera.name == "given"
    assert _named(start, 0, groups[1:], [], given=False).camera.name == "phone"


def test_groups_of_joined_images_the_largest_first():
    assert _components(8, np.array([[6, 7], [2, 1], [3, 2], [4, 5]])).tolist() == [-1, 0, 0, 0, 1, 1, 2, 2]


def test_parts_that_share_enough_points_by_hand():
    """Images 0 and 1 share two points, 1 and 2 one; without marks a block is one part."""
    block = SimpleNamespace(
        images=("a", "b", "c"),
        mark_image=np.array([0, 1, 0, 1, 1, 2]),
        mark_point=np.array([0, 0, 1, 1, 2, 2]),
        points_block_m=np.zeros((3, 3)),
    )
    for least, parts in ((1, [[0, 1, 2]]), (2, [[0, 1], [2]]), (3, [[0], [1], [2]])):
        assert [part.tolist() for part in firm_parts(block, least)] == parts
    block.mark_image = np.zeros(0, np.int64)
    assert [part.tolist() for part in firm_parts(block, 1)] == [[0, 1, 2]]


def test_an_image_of_another_piece_is_told_the_pair_that_is_closest_to_joining_it():
    """Pairs within a piece, or with a third one, have more points and do not count."""
    pairs = np.array([[0, 1], [2, 3], [1, 2], [0, 3], [1, 4], [2, 4]])
    matches = SimpleNamespace(
        pictures=[SimpleNamespace(name=name) for name in "abcde"],
        pairs=pairs,
        n_common=np.array([90, 80, 5, 7, 60, 70]),
    )
    mapped = SimpleNamespace(pieces=[SimpleNamespace(images="ab"), SimpleNamespace(images="cd")])
    piece, head = np.array([0, 0, 1, 1, 2]), "in piece 1 of 2 images, oriented apart from the main block; "
    assert _elsewhere(matches, mapped, piece, 1) == head + "closest pair across: a with d, 7 points"
    matches.n_common[2:4] = 0
    assert _elsewhere(matches, mapped, piece, 1) == head + "no common points with the main block"
