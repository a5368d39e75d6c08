"""Ranges, light and places of a panorama on a few cells, against values written by hand."""

from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from tests.images.block_scene import FRAME, predictions
from tests.panorama.test_files import SETTINGS, small_rig
from thalweg.core import InputError, Rigid, exp_rotation
from thalweg.panorama import cloud_ranges, files, fill_gaps, places
from thalweg.panorama.compose import _broad_difference, _closed, _levels, correlation
from thalweg.panorama.files import inverse_range
from thalweg.settings.sections import Panorama

INF = np.inf


def test_the_nearest_point_of_each_cell():
    """Cells of 30 degrees about a place, its middle to the east; x of the panorama is south, y down."""
    R = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    centre = np.array([10.0, 20, 5])
    points = centre + np.array(
        [
            [4.0, -0.1, 0.1],
            [3.0, -0.1, 0.1],
            [-2.0, -0.1, -0.1],
            [0.1, 0.1, 0.3],
            [9.0, 0.1, 0.1],
            [0.01, 0.001, 6.0],
        ]
    )
    found = cloud_ranges(points, centre, R, cell_deg=30.0, reach_m=8.0)
    assert found.shape == (6, 12)
    # nearer than 0.4 m is the boat, beyond 8 m nothing counts
    assert np.argwhere(np.isfinite(found)).tolist() == [[0, 5], [2, 6], [3, 11]]
    ranges = [np.linalg.norm(d) for d in ([0.01, 0, 6], [3, 0.1, 0.1], [2, 0.1, 0.1])]
    np.testing.assert_allclose(found[np.isfinite(found)], ranges)
    for distance, counts in ((0.39, 0), (0.41, 1), (7.99, 1), (8.01, 0)):
        one = cloud_ranges(centre + np.array([[distance, 0, 0]]), centre, R, cell_deg=30.0, reach_m=8.0)
        assert np.isfinite(one).sum() == counts


def test_gaps_take_the_nearest_range_at_their_border():
    """Cells of 10 degrees, gaps of 40: two cells to each side, around the picture once."""
    ranges = np.full((18, 36), INF)
    ranges[9, 1], ranges[9, 4], ranges[8, 4] = 5.0, 7.0, 6.0
    found = fill_gaps(ranges, gap_deg=40.0)
    assert found[9, [35, 0, 1, 2, 3, 4, 5, 6]].tolist() == [5, 5, 5, 5, 6, 7, 6, 6]
    assert np.isinf(found[9, [34, 7, 20]]).all()
    assert np.isinf(found[[5, 12], 4]).all()
    assert found[6, 4] == 6.0
    np.testing.assert_array_equal(fill_gaps(ranges, gap_deg=9.9), ranges)
    assert np.isinf(fill_gaps(np.full((18, 36), INF), gap_deg=40.0)).all()


def test_inverse_ranges_between_the_middles_of_cells():
    ranges = np.array([[2.0, 4.0, INF, 2.0], [1.0, 4.0, 4.0, INF]])
    found = inverse_range(ranges, 8)
    inverse = np.array([[0.5, 0.25, 0.0, 0.5], [1.0, 0.25, 0.25, 0.0]])
    assert found.shape == (4, 8)
    # the first pixel lies a quarter of a cell left of the middle of the first one, beside the last
    across = 0.75 * inverse[0] + 0.25 * np.roll(inverse[0], 1)
    np.testing.assert_allclose(found[0, ::2], across)
    np.testing.assert_allclose(found[0, 1::2], 0.75 * inverse[0] + 0.25 * np.roll(inverse[0], -1))
    np.testing.assert_allclose(found[1], 0.75 * found[0] + 0.25 * found[3])
    np.testing.assert_allclose(found[2], 0.25 * found[0] + 0.75 * found[3])


def test_degrees_minutes_and_seconds():
    assert files._sexagesimal(51.5125) == (Fraction(51), Fraction(30), Fraction(45))
    assert files._sexagesimal(0.99999999) == (Fraction(1), Fraction(0), Fraction(0))
    assert files._sexagesimal(1 / 3600 / 4) == (Fraction(0), Fraction(0), Fraction(1, 4))


@pytest.mark.parametrize(("mode", "value"), [("sphere", 1 / 8), ("none", 0.0)])
def test_ranges_without_a_cloud(mode, value):
    inverse, ranged = files._inverse(None, 0, Panorama(mode=mode, radius_m=8.0), 64)
    assert (inverse.shape, ranged) == ((32, 64), 0.0)
    assert (inverse == value).all()


def test_ranges_of_the_cloud_and_how_much_of_them_there_is():
    maps = [np.full((18, 36), INF), np.full((18, 36), INF)]
    maps[1][9, 9] = 2.0
    settings = Panorama(gap_deg=40.0)
    inverse, ranged = files._inverse(maps, 1, settings, 36)
    assert ranged == 1 / 648
    np.testing.assert_allclose(inverse, inverse_range(fill_gaps(maps[1], gap_deg=40.0), 36))
    assert files._inverse(maps, 0, settings, 36)[1] == 0.0


def test_the_row_of_a_panorama():
    rig = small_rig()
    R = exp_rotation([0.1, 0.2, 0.7]) @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    cov = np.diag(np.square([0.1, 0.2, 0.3, *np.deg2rad([1, 2, 3])]))
    front = Rigid(R=R, shift_m=np.array([5.0, 6, 7]), cov=cov)
    place = files._place(front, rig)
    np.testing.assert_allclose(place.shift_m, [5, 6, 7] + R @ rig.centre_front_m)
    np.testing.assert_allclose(place.R[:, 1], [0, 0, -1], atol=1e-12)
    poses = predictions(np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)), sigma_t_s=np.array([0.01, 0.02]))
    result = SimpleNamespace(
        gains=np.array([1.1, 1.2, 1.3]), gain_sigma=0.01, seam_rms_px=0.5, seam_px=np.zeros(7), agreement=0.9,
        shown=np.array([True, True, True, False]),
    )  # fmt: skip
    row = files._row("f.jpg", "i.jpg", poses, 1, place, result, "depth", 64, 0.25)
    assert [row[k] for k in ("panorama", "image", "mode", "width_px", "ranged")] == [
        "f.jpg",
        "i.jpg",
        "depth",
        64,
        0.25,
    ]
    assert (row["t_gps_s"], row["sigma_t_s"]) == (poses.t_gps_s[1], 0.02)
    axes = ("east", "north", "up")
    np.testing.assert_allclose([row[f"{a}_m"] for a in axes], place.shift_m)
    np.testing.assert_allclose([row[f"sigma_{a}_m"] for a in axes], place.sigma_shift_m)
    # the middle of the rig lies a centimetre off: its sigma is that of the lens
    np.testing.assert_allclose([row[f"sigma_{a}_m"] for a in axes], [0.1, 0.2, 0.3], rtol=1e-4)
    np.testing.assert_allclose([row[f"sigma_rotation_{a}_deg"] for a in axes], [1, 2, 3])
    east, north = R[:2, 2]
    assert row["heading_deg"] == pytest.approx(np.rad2deg(np.arctan2(east, north)) % 360)
    x, y, z, w = (row[f"q{a}"] for a in "xyzw")
    rotation = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    np.testing.assert_allclose(rotation, place.R, atol=1e-12)
    assert w >= 0
    llh = np.array([row["lat_deg"], row["lon_deg"], row["h_ell_m"]])
    np.testing.assert_allclose(llh, np.array(FRAME.to_geodetic(place.shift_m)).ravel())
    assert [row[f"gain_{a}"] for a in ("red", "green", "blue")] == [1.1, 1.2, 1.3]
    assert [row[k] for k in ("gain_sigma", "seam_rms_px", "seam_places", "agreement", "shown")] == [
        0.01,
        0.5,
        7,
        0.9,
        0.75,
    ]


@pytest.mark.parametrize(("turned", "refused"), [(2, False), (3, True)])
def test_most_of_the_files_must_be_read_as_calibrated(monkeypatch, tmp_path, turned, refused):
    names = [tmp_path / f"{k}.jpg" for k in range(5)]
    monkeypatch.setattr(files, "read_views", lambda path, settings: int(path.stem))
    monkeypatch.setattr(
        files, "reading_that_fits", lambda view, rig: files.TURNED if view >= 5 - turned else ""
    )
    if refused:
        with pytest.raises(InputError, match="in 3 of 5 files") as told:
            files._check_reading(names, small_rig())
        assert str(told.value.where) == str(names[2])
    else:
        files._check_reading(names, small_rig())


@pytest.mark.parametrize(
    ("scores", "turned"),
    [
        ((0.2, 0.61, 0.0), True),
        ((0.2, 0.0, 0.61), True),
        ((0.2, 0.59, 0.0), False),
        ((0.35, 0.64, 0.0), False),
    ],
)
def test_another_reading_must_agree_clearly(monkeypatch, scores, turned):
    seen = iter(scores)
    views = {name: np.arange(27, dtype=np.uint8).reshape(3, 3, 3) for name in ("front", "back")}
    asked = []

    def overlap(read, *words):
        asked.append({name: view[0, 0, 0] for name, view in read.items()})
        return None, {name: np.zeros((4, 4, 3)) for name in views}, None

    monkeypatch.setattr(files, "overlap", overlap)
    monkeypatch.setattr(files, "correlation", lambda a, b, usable: next(seen))
    assert files.reading_that_fits(views, small_rig()) == (files.TURNED if turned else "")
    assert asked == [{"front": 0, "back": 0}, {"front": 24, "back": 0}, {"front": 0, "back": 24}]


def test_photographs_of_both_lenses():
    """A place without a pose stays one; covariances of the front lens go on to the back lens."""
    rig = small_rig()
    R = np.array([exp_rotation([0.1, 0.2, 0.7]), np.full((3, 3), np.nan)])
    poses = predictions(np.array([[1.0, 2, 3], [np.nan] * 3]), R, oriented=np.array([True, False]))
    front, back = files.rig_photographs({"a": "x"}, poses, rig)
    assert back.poses.images == ("back/0000.jpg", "back/0001.jpg")
    assert (front.images, back.images) == ({"front/a": "x"}, {"back/a": "x"})
    place = rig.T_front_lens["back"]
    np.testing.assert_allclose(back.poses.centre_wcs_m[0], [1, 2, 3] + R[0] @ place.shift_m)
    np.testing.assert_allclose(back.poses.R_wcs_ccs[0], R[0] @ place.R)
    np.testing.assert_allclose(back.poses.cov_pose_wcs[0], (poses.pose(0) @ place).cov)
    np.testing.assert_allclose(front.poses.centre_wcs_m[0], [1, 2, 3])
    assert np.isnan(back.poses.R_wcs_ccs[1]).all()
    assert front.widest_rad == pytest.approx(np.deg2rad(SETTINGS.field_of_view_deg / 2 - 1.0))
    assert (front.file_px, front.masks) == (SETTINGS.size_px, {})


def test_light_at_one_level_and_pictures_closed_around():
    front, back = _levels(np.array([1.44, 1.0, 0.25]))
    np.testing.assert_allclose(front * back, 1.0)
    np.testing.assert_allclose(front**2.2, [1.2, 1.0, 0.5])
    values = np.arange(8.0).reshape(2, 4)
    assert _closed(values).tolist() == [
        [1, 2, 3, 0, 1, 2], [3, 0, 1, 2, 3, 0], [7, 4, 5, 6, 7, 4], [5, 6, 7, 4, 5, 6],
    ]  # fmt: skip


def test_correlation_needs_texture():
    rng = np.random.default_rng(1)
    a, b = rng.normal(0, 5, (2, 4, 5))
    usable = np.ones((4, 5), bool)
    usable[0, 0] = False
    assert correlation(a, b, usable) == pytest.approx(np.corrcoef(a[usable], b[usable])[0, 1])
    flat = 0.99 * (a - a[usable].mean()) / a[usable].std()
    assert np.isnan(correlation(flat, b, usable))
    assert np.isnan(correlation(b, flat, usable))
    assert np.isfinite(correlation(flat / 0.98, b, usable))
    few = np.arange(20).reshape(4, 5) < 15
    assert np.isnan(correlation(a, b, few))
    assert np.isfinite(correlation(a, b, np.arange(20).reshape(4, 5) < 16))


@pytest.mark.parametrize("width", [96, 960])
def test_a_broad_difference_is_the_mean_of_what_both_show(width):
    """The same everywhere where both show it, and nothing far from there."""
    both = np.zeros((width // 2, width), bool)
    both[:, : width // 8] = both[:, -width // 16 :] = True
    found = _broad_difference(np.where(both[..., None], [3.0, -2.0, 0.0], 0.0), both)
    np.testing.assert_allclose(found[both], np.tile([3.0, -2.0, 0.0], (both.sum(), 1)), atol=1e-3)
    np.testing.assert_allclose(found[:, width // 2], 0.0, atol=1e-3)


def test_of_files_of_one_time_the_first_has_a_place():
    lost, notes = {}, []
    report = SimpleNamespace(note=notes.append, lose=lambda name, n: lost.update({name: n}))
    stamps = pd.DataFrame({"file": list("abcde"), "t_device_s": [1.0, 2.0, 1.0, np.nan, np.nan]})
    poses = predictions(np.zeros((5, 3)), np.tile(np.eye(3), (5, 1, 1)))
    found = places._each_time_once(poses, stamps, report)
    assert found.oriented.tolist() == [True, True, False, True, True]
    assert found.reasons == ("", "", "of the same time as a", "", "")
    assert lost == {"files_of_one_time": 1}
    assert notes == ["c is of the same time as a: a copy, or a clock that stood still."]
    assert places._each_time_once(poses, stamps[:2], report) is poses
