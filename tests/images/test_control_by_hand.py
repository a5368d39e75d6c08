"""Tables of marks and positions, and boards that roughly known poses predict, against values by hand."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pyproj import CRS

from tests.images.block_scene import FRAME, without_points
from thalweg.core import Camera, GeometryError, InputError
from thalweg.images import control as c
from thalweg.images.model import ControlMarks, ControlPoints, ImageBlock
from thalweg.settings.sections import LOCAL, ControlSettings

PINHOLE = Camera(
    model="perspective", size_px=(400, 300), parameters=np.array([200.0, 200.0, 200.0, 150.0, 0, 0, 0, 0, 0])
)
NORTH = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
"""``R_wcs_ccs`` of a level camera that looks north."""


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def control_of(places, check=None):
    n = len(places)
    return ControlPoints(
        names=tuple(f"T{k}" for k in range(n)),
        points_wcs_m=np.array(places, float),
        check=np.zeros(n, bool) if check is None else np.array(check),
        cov_wcs_m2=np.tile(1e-4 * np.eye(3), (n, 1, 1)),
    )


def block_of(C, camera=PINHOLE) -> ImageBlock:
    n = len(C)
    return without_points(
        (camera,), [f"{k}.png" for k in range(n)], np.array(C, float), np.tile(NORTH, (n, 1, 1))
    )


def test_marks_of_several_files_are_one_table(tmp_path):
    """A table without images is of the picture that it is called like; an accuracy is of the pixels."""
    head = "image,point,x_px,y_px"
    a = write(tmp_path, "a.csv", f"{head},used\n1.jpg,A,5,6,no\n2.jpg,A,7,8,\n1.jpg,B,9,9,maybe\n")
    b = write(tmp_path, "3.csv", "point,x,y,accuracy\nA,1.5,2.5,0.25\n")
    xml = write(
        tmp_path,
        "m.xml",
        "<d><chunk><cameras><camera id='0' label='4.jpg'/></cameras>"
        "<markers><marker id='0' label='A'/></markers>"
        "<frames><frame><markers><marker marker_id='0'><location camera_id='0' pinned='1' x='3' y='4'/>"
        "<location camera_id='0' pinned='0' x='3' y='4'/></marker></markers></frame></frames></chunk></d>",
    )
    found = c.read_all_marks([a, b, xml])
    assert found.image == ("1.jpg", "2.jpg", "1.jpg", "3", "4.jpg")
    assert found.point == ("A", "A", "B", "A", "A")
    assert found.xy_px.tolist() == [[5, 6], [7, 8], [9, 9], [1.5, 2.5], [3, 4]]
    assert found.used.tolist() == [False, True, False, True, True]
    np.testing.assert_array_equal(found.sigma_px, [np.nan] * 3 + [0.25, np.nan])
    assert found.skipped == {"placed by the program, not by a person": 1}
    assert found.without({"1.jpg", "4.jpg"}).image == ("2.jpg", "3")
    with pytest.raises(InputError, match=r"point A stands twice in image 1\.jpg"):
        c.read_all_marks([a, a])


@pytest.mark.parametrize(("most", "refused"), [(1.99, True), (2.01, False)])
def test_shares_of_a_picture_are_no_pixels(tmp_path, most, refused):
    text = f"image,point,x_px,y_px\n1.jpg,A,0.5,0.25\n1.jpg,B,0.5,{most}\n"
    if refused:
        with pytest.raises(InputError, match=rf"image points up to {most}; expected pixels"):
            c.read_marks(write(tmp_path, "m.csv", text))
    else:
        assert c.read_marks(write(tmp_path, "m.csv", text)).xy_px.max() == most
    # a single mark may lie in the corner
    one = write(tmp_path, "one.csv", "image,point,x_px,y_px\n1.jpg,A,0.5,0.25\n")
    assert c.read_marks(one).xy_px.tolist() == [[0.5, 0.25]]


def test_positions_of_the_camera(tmp_path):
    """With sigmas for each axis or one accuracy; an image twice, or without either, is refused."""
    text = "label,x,y,z,sigma_x_m,sigma_y_m,sigma_z_m\na.jpg,1,2,3,0.1,0.2,0.3\nb.jpg,4,5,6,0.4,0.5,0.6\n"
    found = c.read_camera_positions(write(tmp_path, "p.csv", text), FRAME, crs=LOCAL, height_offset_m=2.0)
    assert found.images == ("a.jpg", "b.jpg")
    np.testing.assert_array_equal(found.centre_wcs_m, [[1, 2, 5], [4, 5, 8]])
    np.testing.assert_array_equal(found.sigma_m, [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    for cells, words in (
        ("image,x,y,z\na,1,2,3\n", "positions of the camera without standard deviations"),
        ("image,x,y,z,sigma_x_m,sigma_y_m\na,1,2,3,1,1\n", "without standard deviations"),
        ("image,x,y,z,accuracy\na,1,2,3,0.1\na,1,2,3,0.1\n", "two positions of a; expected each image once"),
        ("image,x,y,z,accuracy\na,1,2,3,-0.1\n", r"a standard deviation of -0\.1 m of a"),
        ("image,x,y,z,accuracy\n", "no positions"),
    ):
        with pytest.raises(InputError, match=words):
            c.read_camera_positions(write(tmp_path, "q.csv", cells), FRAME, crs=LOCAL)


def test_the_frame_amid_points(tmp_path):
    """The median of all tables; of the ellipsoid of the grid; of a local frame or of nothing no place."""
    places = [(51.0, 13.0, 100.0), (51.001, 13.002, 200.0), (51.3, 13.3, 250.0)]
    rows = [f"P{k},{lat},{lon},{h}" for k, (lat, lon, h) in enumerate(places)]
    head = "id,lat_deg,lon_deg,h_ell_m\n"
    a = write(tmp_path, "a.csv", head + rows[0] + "\n")
    b = write(tmp_path, "b.csv", head + "\n".join(rows[1:]) + "\n")
    found = c.frame_about([a, b], crs="EPSG:25833")
    # 30 km from there the earth bends away by 70 m, so heights do not come in as they are
    assert (found.lat_deg, found.lon_deg) == pytest.approx((51.001, 13.002), abs=2e-4)
    assert found.h_ell_m == pytest.approx(200.0, abs=0.5)
    assert found.ellipsoid == c.ellipsoid_of(CRS("EPSG:25833"))
    krassowsky = c.frame_about([a], crs="EPSG:28413")
    assert krassowsky.ellipsoid == c.ellipsoid_of(CRS("EPSG:28413")) != found.ellipsoid
    for paths, crs in (([a], LOCAL), ([], "EPSG:25833")):
        nowhere = c.frame_about(paths, crs=crs)
        assert (nowhere.lat_deg, nowhere.lon_deg, nowhere.h_ell_m) == (0.0, 0.0, 0.0)
    names = write(tmp_path, "l.csv", "id,role\nA,check\n")
    with pytest.raises(InputError, match="control points without a place on the earth"):
        c.frame_about([names], crs=None)
    assert c.frame_about([names, a], crs=None).h_ell_m == pytest.approx(100.0)


def test_systems_by_their_names(tmp_path):
    for text, code in (
        ("WGS84 UTM 33N", 32633),
        ("wgs84 utm 5 s", 32705),
        (" EPSG::25833", 25833),
        ("EPSG:25832 ", 25832),
    ):
        assert c.crs_of(text, tmp_path).to_epsg() == code
    for text, is_list in (
        ("\n EPSG:32633\n", True),
        ("wgs84 utm 33N\n1 2", True),
        ("+proj=utm +zone=33\n", True),
        ("id,x\nEPSG:32633\n", False),
        ("", False),
    ):
        assert c.is_gcp_list(text) == is_list
    with pytest.raises(InputError, match="'ETRS89'"):
        c.map_grid("EPSG:4258", tmp_path)


def test_numbers_of_cells(tmp_path):
    row = {"a": "1.5", "b": "", "c": "None", "d": "-", "e": "inf", c.LINE: "7"}
    assert c.number(row, "a", tmp_path) == 1.5
    assert [c.number(row, name, tmp_path, 4.0) for name in "bcdf"] == [4.0] * 4
    for name, default in (("e", 4.0), ("c", None), ("b", None)):
        with pytest.raises(InputError):
            c.number(row, name, tmp_path, default)
    assert c.place_of(row, Path("x")) == "x:7"
    assert c.place_of({}, Path("x")) == "x"
    assert c.listed(list("abcde")) == "a, b, c, d, e"
    assert c.listed(list("abcdefg")) == "a, b, c, d, e and 2 more"
    assert c.numbers([], "ab", tmp_path).shape == (0, 2)
    rows = [{"s": "2", c.LINE: "7"}, {"id": "P", "s": "0"}]
    np.testing.assert_array_equal(c.sigmas(rows[:1], tmp_path, (1.0, np.nan), ("s", "t")), [[2.0, np.nan]])
    with pytest.raises(InputError, match="a standard deviation of 0 of P"):
        c.sigmas(rows, tmp_path, (1.0,), ("s",))


@pytest.mark.parametrize(
    ("value", "refused"), [("-9999,5,1", True), ("0,0.5,0", False), ("5,5,0", False), ("5,5,-9999", True)]
)
def test_what_stands_for_no_place(tmp_path, value, refused):
    path = write(tmp_path, "p.csv", f"id,east_m,north_m,up_m\nA,7,8,9\nB,{value}\n")
    read = {"crs": None, "sigma_m": (1.0, 1.0, 1.0)}
    if refused:
        with pytest.raises(InputError, match=r"csv:3: \w+ -?\d+, which stands for no value"):
            c.read_control_points(path, FRAME, **read)
    else:
        assert len(c.read_control_points(path, FRAME, **read).names) == 2


def test_a_height_offset_is_of_what_is_not_of_the_world(tmp_path):
    world = write(tmp_path, "w.csv", "id,east_m,north_m,up_m\nA,7,8,9\n")
    local = write(tmp_path, "l.csv", "id,x,y,z\nA,7,8,9\n")
    for path, crs, up in ((world, None, 9.0), (local, LOCAL, 14.0)):
        found = c.read_control_points(path, FRAME, crs=crs, sigma_m=(1.0, 2.0, 3.0), height_offset_m=5.0)
        np.testing.assert_allclose(found.points_wcs_m, [[7, 8, up]])
        np.testing.assert_array_equal(found.cov_wcs_m2, [np.diag([1.0, 4.0, 9.0])])


@pytest.mark.parametrize(("usual", "sigma"), [("0.25", 0.25), ("0", 3.0)])
def test_markers_of_metashape_that_are_no_control_points(tmp_path, usual, sigma):
    """Without coordinates; an accuracy of 0 of the chunk states none; a switched off one is a check point."""
    settings = f"<settings><property name='accuracy_markers' value='{usual}'/></settings>"
    text = (
        f"<d><chunk>{settings}<markers><marker label='A'><reference x='1' y='2' z='3' enabled='1'/></marker>"
        "<marker label='B'/><marker label='C'><reference enabled='true'/></marker>"
        "<marker label='D'><reference x='4' y='5' z='6' enabled='0' sxyz='2' sz='1'/></marker></markers>"
        "</chunk></d>"
    )
    found = c.read_control_points(write(tmp_path, "m.xml", text), FRAME, crs=LOCAL, sigma_m=(3.0, 3.0, 3.0))
    assert (found.names, found.check.tolist()) == (("A", "D"), [False, True])
    variances = found.cov_wcs_m2.diagonal(axis1=1, axis2=2)
    np.testing.assert_allclose(np.sqrt(variances), [[sigma] * 3, [2, 2, 1]])


@pytest.mark.parametrize(
    ("words", "told"), [("sigma_x,sigma_y", True), ("sigma_z,accuracy", False), ("a,b", False)]
)
def test_sigmas_of_some_axes_are_told(tmp_path, caplog, words, told):
    text = f"id,x,y,z,{words}\nA,1,2,3,0.5,0.5\n"
    c.read_control_points(write(tmp_path, "p.csv", text), FRAME, crs=LOCAL, sigma_m=(1.0, 1.0, 1.0))
    assert ("read of sigma_east_m, sigma_north_m; for the others" in caplog.text) == told


BOARDS = ControlSettings(board_m=0.5, search_m=0.25, least_board_px=5.0, least_images=2)


def test_where_boards_should_be_seen():
    """Cameras 10 m south of boards of two modules of 0.22 m: 20 px a metre."""
    block = block_of([[0, -10, 0], [8, -10, 0], [0, 10, 0]])
    control = control_of([[1.0, 0, 0.5], [40.0, 0, 0], [-9.8, 0, 0]])
    found = c._sights(block, control, BOARDS, 0.25, lambda name: None)
    # the third camera looks away; the second board is outside of all, the third at the edge of the first
    assert [(s.image, s.point) for s in found] == [(0, 0), (1, 0), (0, 2)]
    s = found[0]
    np.testing.assert_allclose(s.xy, [200 + 20, 150 - 10])
    # right of the board, as the nearest cameras see it, and downwards
    away = np.array([8 / 3 - 1, -10 / 3])
    right = np.array([-away[1], away[0]]) / np.linalg.norm(away)
    expected = 0.22 * np.array([[20 * right[0] - 2 * right[1], 0.0], [1.0 * right[1], 20.0]])
    np.testing.assert_allclose(s.by_module, expected, atol=1e-9)
    # 4.4 px a module: seven tenths of it, and three times 0.25 m
    assert s.reach_px == pytest.approx(0.7 * 4.4 + 3 * 0.25 * 20)
    assert c._reach_px(block, s, BOARDS, 0.0) == pytest.approx(0.7 * 4.4)
    s.by_module = s.by_module / 5
    assert c._reach_px(block, s, BOARDS, 0.0) == 3.0
    small = c._sights(block, control, BOARDS.replace(least_board_px=11.0), 0.25, lambda name: None)
    assert [s.reason for s in small] == ["too small: 9 px"] * 3
    assert {s.reason for s in c._sights(block, control, BOARDS.replace(least_board_px=8.5), 0.25, print)} == {
        ""
    }


def test_a_masked_board_is_measured_in_no_narrow_window():
    block, control = block_of([[0, -10, 0], [1, -10, 0]]), control_of([[0.0, 0, 0]])
    mask = np.ones((300, 400), np.uint8)
    mask[150, 200] = 0
    asked = []

    def masks(name):
        asked.append(name)
        return mask

    assert [s.reason for s in c._sights(block, control, BOARDS, 0.0, masks)] == ["masked", ""]
    assert [s.reason for s in c._sights(block, control, BOARDS, 0.25, masks)] == ["", ""]
    small = BOARDS.replace(least_board_px=40.0)
    assert [s.reason for s in c._sights(block, control, small, 0.0, masks)] == ["too small: 9 px"] * 2
    assert asked == ["0.png", "1.png"] * 3
    # a camera below a board has no right and left of it
    assert c._sights(block_of([[0, 0, -5]]), control, BOARDS, 0.0, masks) == []


def sights_of(block, places, offsets, scores):
    """Candidates of each board in each image: its place moved by so many pixels."""
    out = []
    for (image, point), moved in offsets.items():
        d = (np.array(places[point]) - block.centre_block_m[image]) @ NORTH
        xy = np.array([200 + 200 * d[0] / d[2], 150 + 200 * d[1] / d[2]])
        found = [(scores.get((image, point), 0.9) - 0.1 * k, xy + m, 1) for k, m in enumerate(moved)]
        sight = c._Sight(image, point, xy, np.diag([5.0, 5.0]), 3.0, found)
        sight.score = found[0][0] if found else 0.1
        out.append(sight)
    return out


def test_the_place_on_which_most_images_agree():
    """The best candidate of two images is another thing, as it is alone in a third."""
    block = block_of([[0, -10, 0], [3, -10, 0], [6, -10, 1], [9, -10, 0]])
    places = [[4.0, 0, 0.5], [5.0, 1, 1], [2.0, 0, 0]]
    right = [0.0, 0.0]
    offsets = {
        (0, 0): [[30.0, 5.0], right],
        (1, 0): [right],
        (2, 0): [[-40.0, 20.0], right],
        (3, 0): [[1.7, 0.0]],
        (0, 1): [right],
        (1, 1): [],
        (1, 2): [right],
        (2, 2): [[0.0, 9.0]],
    }
    sights = sights_of(block, places, offsets, {})
    found = c._agreed(block, sights, 3, BOARDS)
    # the candidate 1.7 px off lies within 0.35 modules of 5 px, as 1.5 px would not
    np.testing.assert_allclose(found[0], places[0], atol=0.1)
    assert np.isnan(found[1:]).all()
    assert np.isnan(c._agreed(block, sights, 3, BOARDS.replace(least_images=5))[0]).all()
    near = c._near(block, [(sights[3], sights[3].found[0][1])], np.array(places[0]))
    assert len(near) == 1
    sights[3].by_module = np.diag([4.0, 4.0])
    assert c._near(block, [(sights[3], sights[3].found[0][1])], np.array(places[0])) == []


def test_a_block_is_moved_onto_three_boards_or_more():
    control = control_of([[0.0, 0, 0], [10, 0, 0], [0, 10, 1], [5, 5, 0]])
    notes: list[str] = []
    points = control.points_wcs_m / 2.0 + [1.0, 2.0, 3.0]
    points[3] = np.nan
    found = c._moved(points, control, notes)
    np.testing.assert_allclose(found.apply(points[:3]), control.points_wcs_m[:3], atol=1e-9)
    assert (found.scale, notes) == (pytest.approx(2.0), [])
    points[2] = np.nan
    assert c._moved(points, control, notes) is None
    assert notes == ["Only 2 boards were found in the first search; the block stays where it was"]
    on_a_line = control_of([[0.0, 0, 0], [10, 0, 0], [20, 0, 0]])
    assert c._moved(on_a_line.points_wcs_m, on_a_line, notes) is None
    assert notes[1].startswith("The block stays where it was: all 3 boards lie on a line")


def test_marks_as_a_table_with_what_was_lost():
    block, control = block_of([[0, 0, 0], [1, 0, 0]]), control_of([[0.0, 9, 0], [1, 9, 0], [2, 9, 0]])

    def sight(image, point, reason, fitted=None, sigma=np.nan, score=0.5):
        return SimpleNamespace(
            image=image, point=point, reason=reason, xy=np.array([1.0, 2]), score=score, sigma_px=sigma,
            fitted=None if fitted is None else np.array(fitted),
        )  # fmt: skip

    sights = [
        sight(1, 1, "too small: 3 px"),
        sight(1, 0, "", [7.0, 8.0], 0.25),
        sight(0, 0, "", [5.0, 6.0], 0.5, 0.75),
        sight(0, 1, "too small: 4 px"),
        sight(0, 2, "ambiguous", [3.0, 4.0], 0.125),
    ]
    found = c._table(block, control, sights, [])
    assert found.table.fillna(-1).values.tolist() == [
        ["0.png", "T0", 5, 6, 0.5, 0.75, True, ""],
        ["1.png", "T0", 7, 8, 0.25, 0.5, True, ""],
        ["0.png", "T1", 1, 2, -1, 0.5, False, "too small: 4 px"],
        ["1.png", "T1", 1, 2, -1, 0.5, False, "too small: 3 px"],
        ["0.png", "T2", 3, 4, 0.125, 0.5, False, "ambiguous"],
    ]
    assert found.counts == {"used": 2, "too small": 2, "ambiguous": 1}
    assert found.notes == ["T1 was not measured: 0 marks", "T2 was not measured: 0 marks"]
    none = c._table(block, control, sights[:3], [])
    assert none.notes[-1] == "T2 was not measured: no image shows its place"


def test_control_points_and_marks_of_wrong_shapes_or_sigmas():
    control = control_of([[0.0, 0, 0], [1, 1, 1]], [False, True])
    assert control.as_check(["T0"]).check.tolist() == [True, True]
    both = ControlPoints.joined([control.chosen(np.array([1])), control.chosen(np.array([True, False]))])
    assert (both.names, both.check.tolist()) == (("T1", "T0"), [True, False])
    np.testing.assert_array_equal(both.points_wcs_m, [[1, 1, 1], [0, 0, 0]])
    for change, words in (
        ({"names": ("A", "A")}, "control point A more than once"),
        ({"check": np.zeros(1, bool)}, "control points of the shapes"),
        (
            {"cov_wcs_m2": np.array([np.eye(3), np.diag([1, 0, 1.0])])},
            "no positive standard deviations of T1",
        ),
        ({"cov_wcs_m2": np.array([np.eye(3), np.diag([1, np.nan, 1.0])])}, "deviations of T1"),
    ):
        with pytest.raises(GeometryError, match=words):
            replace(control, **change)
    with pytest.raises(GeometryError, match="control points A, B more than once"):
        replace(ControlPoints.joined([]), names=("A", "B", "A", "B"))
    marks = ControlMarks(
        image=np.array([0, 1, 1]), point=np.array([1, 1, 0]), xy_px=np.zeros((3, 2)), sigma_px=np.ones(3)
    )
    assert marks.counts(4).tolist() == [1, 2, 0, 0]
    assert marks.chosen(marks.image == 1).point.tolist() == [1, 0]
    for wrong in (np.array([1.0, 0, 1]), np.array([1.0, 1, -1]), np.array([np.nan, 1, 1])):
        with pytest.raises(GeometryError, match=r"standard deviation of .* px of a mark; expected positive"):
            replace(marks, sigma_px=wrong)
    with pytest.raises(GeometryError, match="marks of the shapes"):
        replace(marks, point=np.zeros(2, int))
    assert ControlMarks.none().counts(2).tolist() == [0, 0]
