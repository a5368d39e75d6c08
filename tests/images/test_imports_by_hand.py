"""Names, files, checks and covariances of imported orientations, at their limits and by hand."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from tests.images.finished_scene import FRAME, TRUTH, predictions
from tests.images.sfm_scene import PERSPECTIVE
from thalweg.core import GeometryError, InputError, Rigid, exp_rotation, rotation_z
from thalweg.core.geometry import fit_points
from thalweg.images.bundle.problem import (
    Antenna,
    RigFrames,
    _velocity,
    antenna_at_images,
    antenna_lever_ccs,
    clock_notes,
)
from thalweg.images.imports import poses as imports
from thalweg.images.imports.formats import _left_px, read_angles_table, read_metashape
from thalweg.images.imports.source import (
    Finished,
    Place,
    check_datum,
    orthogonal,
    place_of,
    raised,
    to_world,
    world_axes,
)
from thalweg.images.model import files
from thalweg.images.model.block import (
    _HUBER,
    _huber,
    is_line,
    predicted_sigmas,
    robust_similarity,
    spread_share,
)
from thalweg.images.model.files import Picture
from thalweg.settings.sections import FinishedOrientations

N = len(TRUTH.images)


def settings(**changes):
    return FinishedOrientations(**changes).model_dump()


def finished(C, R=TRUTH.R, names=TRUTH.images, **more):
    values = {
        "program": "p",
        "where": "f",
        "place": Place(kind="world"),
        "cov": np.full((len(C), 6, 6), np.nan),
    }
    return Finished(names=tuple(names), coordinates=C, R_place_ccs=R, **values | more)


def predicted(**changes):
    values = {
        "frame": FRAME, "centre_wcs_m": TRUTH.C, "R_wcs_ccs": TRUTH.R, "sigma_m": 0.5, "sigma_rad": 0.01,
        "limit_m": 20.0, "limit_rad": 0.3,
    }  # fmt: skip
    return imports.Predicted(**values | changes)


# ---------------------------------------------------------------- checks


@pytest.mark.parametrize(
    ("height", "answer"),
    [
        (2.9, None), (3.1, "note"), (-3.1, "note"), (14.9, "note"), (15.1, "refused"), (-44.0, "refused"),
        (109.9, "refused"), (110.1, "note"),
    ],
)  # fmt: skip
def test_heights_that_differ_by_a_constant(height, answer):
    off = np.tile([0.6, 0.8, height], (N, 1))
    given = finished(TRUTH.C), off, predicted()
    if answer == "refused":
        with pytest.raises(InputError, match=rf"heights {abs(height):.1f} m \w+ the predicted ones") as told:
            imports.check_heights(*given)
        assert f"about {-height:.0f} m, from the geoid" in told.value.cure
        return
    notes = imports.check_heights(*given)
    side = "below" if height < 0 else "above"
    assert notes == ([] if answer is None else [
        f"heights {abs(height):.1f} m {side} the predicted ones, all alike (NMAD 0.00 m), with positions "
        "that fit to 1.0 m: check whether they are above the ellipsoid"
    ])  # fmt: skip
    # beyond three sigmas of the prediction, alike, and with positions that fit
    assert imports.check_heights(given[0], off, predicted(sigma_m=40.0)) == []
    rough = off + np.outer(np.tile([1, -1], 6), [0, 0, 3.1 / 1.4826])
    assert imports.check_heights(given[0], rough, predicted()) == []
    assert imports.check_heights(given[0], off + np.array([21.0, 0, 0]), predicted()) == []


def test_positions_and_attitudes_at_their_limits():
    """Medians of twelve images; single ones beyond are told with the farthest."""
    source = finished(TRUTH.C)
    turn = exp_rotation(np.outer(np.r_[np.full(11, 0.29), 0.31], [0.6, 0.8, 0.0])) @ TRUTH.R
    C = TRUTH.C + np.outer(np.r_[np.full(11, 19.9), 20.1], [0.6, 0.8, 0.0])
    notes, facts = imports.check_poses(source, C, turn, predicted())
    last = TRUTH.images[11]
    assert facts == {
        "images_compared": 12,
        "median_distance_m": pytest.approx(19.9),
        "median_height_difference_m": pytest.approx(0.0),
        "median_angle_deg": pytest.approx(np.rad2deg(0.29)),
    }
    assert notes == [
        "attitudes a median of 16.6 degrees away from the predicted ones, whose standard deviation is 0.6: "
        "check north, axes of the angles, and the mount",
        f"1 of 12 images are more than 20 m away from their prediction, most of all {last} with 20.1 m",
        f"1 of 12 images are more than 17 degrees away from their prediction, most of all {last} with "
        "17.8 degrees",
    ]
    with pytest.raises(InputError, match=r"positions a median of 20 m away .* at most 20 m away"):
        imports.check_poses(source, TRUTH.C + np.array([0, 20.1, 0]), TRUTH.R, predicted())
    with pytest.raises(InputError, match=r"attitudes a median of 17\.8 degrees .* at most 17 degrees"):
        imports.check_poses(source, TRUTH.C, exp_rotation([0.31, 0, 0]) @ TRUTH.R, predicted())
    # told from one degree on, or from four sigmas
    for angle, sigma, told in ((0.99, 0.0, 0), (1.01, 0.0, 1), (2.0, 0.49, 1), (2.0, 0.51, 0)):
        R = exp_rotation([0, np.deg2rad(angle), 0]) @ TRUTH.R
        found, _ = imports.check_poses(source, TRUTH.C, R, predicted(sigma_rad=np.deg2rad(sigma)))
        assert len(found) == told
    two = imports.check_poses(
        finished(TRUTH.C[:2], TRUTH.R[:2], TRUTH.images[:2]), TRUTH.C[:2], TRUTH.R[:2], predicted()
    )
    assert two == (["2 images with a prediction: the poses could not be checked against it"], {})
    assert imports._distance(np.array([[9999.4, 0, 0]])) == "9999 m"
    assert imports._distance(np.array([[10_000.0, 0, 0]])) == "10 km"


def test_limits_of_belief_are_four_sigmas_at_least():
    given = predictions()
    cov = np.tile(np.diag([1.0, 4, 4, 0.04, 0.04, 0.01]), (N, 1, 1))
    given = replace(given, cov_pose_wcs=cov)
    assert predicted_sigmas(given) == pytest.approx((3.0, 0.3))
    found = imports._predicted(given, np.array([3, 1]), settings(most_position_m=5.0, most_angle_deg=10.0))
    assert (found.limit_m, found.limit_rad) == pytest.approx((12.0, 1.2))
    np.testing.assert_array_equal(found.centre_wcs_m, TRUTH.C[[3, 1]])
    wide = imports._predicted(given, np.array([0]), settings(most_position_m=50.0, most_angle_deg=90.0))
    assert (wide.limit_m, wide.limit_rad) == pytest.approx((50.0, np.pi / 2))


# ---------------------------------------------------------------- covariances


def test_covariances_of_neighbours():
    """Of one file without any: a share of their roots, and what all have in common; of two files none."""
    rng = np.random.default_rng(1)
    root = rng.normal(0, 0.1, (5, 6, 6)) * np.r_[[1.0] * 3, [0.01] * 3][:, None]
    cov = root @ np.swapaxes(root, 1, 2)
    cov[1, :3] = cov[1, :, :3] = np.nan
    whole = cov.copy()
    whole[1, :3], whole[1, :, :3] = 0.0, 0.0
    whole[1, :3, :3] = 0.25 * np.eye(3)
    common = 0.01 * np.eye(6)
    oriented = np.array([True, True, False, True, True])
    given = np.zeros((5, 6, 6))
    given[3] = 7.0
    out = SimpleNamespace(
        poses=SimpleNamespace(cov_pose_wcs=cov, cov_next=given.copy()),
        common=np.tile(common, (5, 1, 1)),
        known_following=np.array([-1, -1, -1, 4, -1]),
        source=["a", "a", "", "b", "b"],
    )
    how = settings(sigma_position_m=0.5, sigma_angle_deg=2.0, neighbour_correlation=0.6)
    assert imports._covariances(out, oriented, how) == {"positions": 1, "rotations": 0}
    for k in (0, 1, 3, 4):
        np.testing.assert_allclose(out.poses.cov_pose_wcs[k], whole[k] + common)
    S = []
    for C in whole[[0, 1]]:
        s = np.sqrt(np.diag(C))
        value, vector = np.linalg.eigh(C / np.outer(s, s))
        S.append(np.diag(s) @ vector @ np.diag(np.sqrt(value)) @ vector.T)
    found = out.poses.cov_next
    np.testing.assert_allclose(found[0], 0.6 * S[0] @ S[1] + common, atol=1e-15)
    assert not found[1].any()
    np.testing.assert_array_equal(found[3], given[3])
    assert not found[4].any()
    np.testing.assert_allclose(S[0] @ S[0].T, whole[0])
    # a neighbour that the file names, but without a pose here: what it states is not of this one
    out.known_following[:] = [3, -1, -1, -1, -1]
    out.poses.cov_next[:] = 0.0
    imports._covariances(out, oriented, how)
    assert not found[0][:3, 3:].any()


def test_the_common_error_of_an_aligned_model_is_the_mean_of_the_predictions():
    given = predictions()
    cov = np.arange(1.0, N + 1)[:, None, None] * np.eye(6)
    cov[3, 0, 0] = np.nan
    given = replace(given, cov_pose_wcs=cov, oriented=np.arange(N) != 5)
    mean = np.mean([k + 1.0 for k in range(N) if k not in (3, 5)])
    np.testing.assert_allclose(imports._common(given), mean * np.eye(6))
    assert not imports._common(replace(given, cov_pose_wcs=np.full((N, 6, 6), np.nan))).any()


def test_the_camera_of_most_images():
    a, b = replace(PERSPECTIVE, name="a"), replace(PERSPECTIVE, name="b")
    out = SimpleNamespace(cameras=[a, b, None, b], notes=[])
    assert imports._camera(out) is b
    assert out.notes == ["2 interior orientations; the one of most images (2) is taken: b"]
    alone = SimpleNamespace(cameras=[a, None], notes=[])
    assert (imports._camera(alone), alone.notes) == (a, [])
    assert imports._camera(SimpleNamespace(cameras=[None], notes=[])) is None


def test_missing_rotations_leave_the_covariance_of_places():
    """Axes of the place turn both blocks; whole matrices keep their cross terms."""
    rng = np.random.default_rng(2)
    root = rng.normal(0, 1, (3, 6, 6))
    cov = root @ np.swapaxes(root, 1, 2)
    cov[1, 3:] = cov[1, :, 3:] = np.nan
    C = FRAME.from_geodetic([51.0, 51.1, 51.2], [13.0, 13.1, 13.2], [100.0, 200.0, 300.0])
    lat, lon, h = FRAME.to_geodetic(C)
    source = finished(
        np.column_stack([lon, lat, h]), TRUTH.R[:3], "abc", place=place_of("EPSG:4326", Path("f")), cov=cov
    )
    centre, R, found = to_world(source, FRAME)
    axes = FRAME.R_wcs_enu(lat, lon)
    np.testing.assert_allclose(centre, C, atol=1e-6)
    np.testing.assert_allclose(R, axes @ TRUTH.R[:3], atol=1e-9)
    for k in (0, 2):
        J = np.kron(np.eye(2), axes[k])
        np.testing.assert_allclose(found[k], J @ cov[k] @ J.T, rtol=1e-7)
    np.testing.assert_allclose(found[1, :3, :3], axes[1] @ cov[1, :3, :3] @ axes[1].T, rtol=1e-7)
    assert np.isnan(found[1, 3:, 3:]).all()
    place = Place(kind="world")
    np.testing.assert_array_equal(raised(C, place, 2.0, FRAME), C + np.array([0, 0, 2.0]))
    np.testing.assert_array_equal(world_axes(C, place, FRAME), np.tile(np.eye(3), (3, 1, 1)))


def test_places_rotations_and_datums_that_are_none(tmp_path):
    kinds = {
        "world": "world",
        " World ": "world",
        "EPSG:25833": "map",
        "EPSG:4978": "geocentric",
        "EPSG:4979": "geographic",
    }
    assert {text: place_of(text, tmp_path).kind for text in kinds} == kinds
    assert (Place(kind="world").text, Place(kind="free").text) == ("world frame", "own frame")
    assert place_of("EPSG:25833", tmp_path).text == "ETRS89 / UTM zone 33N"
    with pytest.raises(InputError, match="has no place on the earth"):
        place_of("EPSG:5703", tmp_path)
    R = exp_rotation([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    np.testing.assert_allclose(orthogonal(R * 1.0009, "f", ("a", "b")), R)
    for wrong in (
        R * np.array([1.0, 1.0011])[:, None, None],
        R * [[[1.0]], [[-1.0]]],
        R * [[[1.0]], [[np.nan]]],
    ):
        with pytest.raises(InputError, match="the rotation of b is none"):
            orthogonal(wrong, "f", ("a", "b"))
    check_datum(place_of("EPSG:4258", tmp_path).crs, "f")
    with pytest.raises(InputError, match="another datum"):
        check_datum(place_of("EPSG:4314", tmp_path).crs, "f")
    with pytest.raises(InputError, match="two poses of a; expected each image once"):
        finished(TRUTH.C[:2], TRUTH.R[:2], "aa")
    with pytest.raises(InputError, match="no finite coordinates of b"):
        finished(np.array([[1.0, 2, 3], [1, np.inf, 3]]), TRUTH.R[:2], "ab")
    with pytest.raises(InputError, match="no image with a pose"):
        finished(np.zeros((0, 3)), np.zeros((0, 3, 3)), ())


# ---------------------------------------------------------------- formats


def test_terms_that_have_no_place_move_pixels():
    p = dict.fromkeys(("b2", "k4", "p1", "p2"), 0.0) | {"f": 500.0}
    size = (600, 800)
    assert _left_px(p, "perspective", size) == 0.0
    # half the diagonal is the focal length
    assert _left_px(p | {"b2": -3.0}, "perspective", size) == pytest.approx(3.0)
    assert _left_px(p | {"k4": -0.01, "f": 250.0}, "perspective", size) == pytest.approx(2.5 * 2**9)
    assert _left_px(p | {"p1": 3e-3, "p2": 4e-3, "f": 250.0}, "fisheye", size) == pytest.approx(
        3 * 250 * 5e-3 * 4
    )
    assert _left_px(p | {"b2": 3.0, "k4": 1.0}, "fisheye", size) == pytest.approx(3.0)


HEAD = "image,east_m,north_m,up_m,omega,phi,kappa"


def read(tmp_path, text, **changes):
    path = tmp_path / "eo.csv"
    path.write_text(text)
    return read_angles_table(path, settings(**changes), None)


@pytest.mark.parametrize(
    ("kappa", "words"),
    [
        ("6.28", "taken as degrees (none exceeds two pi: are they radians?)"),
        ("6.29", "taken as degrees"),
        ("-360", None),
    ],
)
def test_angles_that_state_no_unit(tmp_path, kappa, words):
    found = read(tmp_path, f"{HEAD}\na,1,2,3,0,0,{kappa}\n")
    if words:
        assert found.notes[-1] == f"The table states no unit of the angles: {words}"
    np.testing.assert_allclose(
        found.R_place_ccs[0], rotation_z(np.deg2rad(float(kappa))) @ np.diag([1.0, -1, -1])
    )
    with pytest.raises(InputError, match="angles up to 361 without a unit"):
        read(tmp_path, f"{HEAD}\na,1,2,3,0,0,-361\n")
    stated = read(tmp_path, f"{HEAD.replace('kappa', 'kappa [gon]')}\na,1,2,3,0,0,100\n", angle_unit="deg")
    assert stated.notes[-1] == "The header says gon, images.finished.angle_unit deg: deg it is"


def test_a_matrix_beside_the_angles_agrees_to_two_thousandths(tmp_path):
    """As it is or transposed; the worst image is named."""
    names = ",".join(f"r{i}{j}" for i in "123" for j in "123")
    R = rotation_z(np.deg2rad(30.0))
    for M in (R, R.T):
        for off, refused in ((0.0019, False), (0.0021, True)):
            rows = []
            for image, by in (("a", 0.0), ("b", off), ("c", 0.0)):
                values = M.copy()
                values[0, 0] += by
                rows.append(f"{image},1,2,3,0,0,30," + ",".join(f"{v:.9f}" for v in values.ravel()))
            text = f"{HEAD},{names}\n" + "\n".join(rows) + "\n"
            if refused:
                with pytest.raises(
                    InputError, match=r"matrix of b differ by 0\.002; expected less than 0\.002"
                ):
                    read(tmp_path, text)
            else:
                assert not any("no unit" in note for note in read(tmp_path, text).notes)


def test_scales_and_components_of_metashape(tmp_path):
    """Without a chunk transform one component's holds; of two, a camera of the one without has no place."""
    unit = "1 0 0 0 1 0 0 0 1"
    moved = (
        f"<transform><rotation>{unit}</rotation><translation>1 2 3</translation><scale>2</scale></transform>"
    )
    pose = "<transform>1 0 0 5 0 1 0 0 0 0 1 0 0 0 0 1</transform>"
    camera = "<camera id='{0}' label='{0}' component_id='{1}'>" + pose + "</camera>"
    for parts, places, absent in (
        (f"<component id='7'>{moved}</component>", [[11.0, 2, 3], [11, 2, 3]], {}),
        (f"<component id='7'>{moved}</component><component id='8'/>", [[11.0, 2, 3]],
         {"b": "its component has no place in the world"}),
    ):  # fmt: skip
        cameras = camera.format("a", 7) + camera.format("b", 8 if absent else 9)
        path = tmp_path / "c.xml"
        path.write_text(
            f"<document><chunk><components>{parts}</components><cameras>{cameras}"
            "<camera id='5' label='slave' master_id='a'><transform>1</transform></camera></cameras></chunk>"
            "</document>"
        )
        found = read_metashape(path, "world")
        np.testing.assert_allclose(found.coordinates, places)
        assert found.absent == absent
    # a model that stands nowhere keeps its own units
    alone = path.read_text().replace(moved, "")
    (tmp_path / "alone.xml").write_text(alone)
    np.testing.assert_allclose(read_metashape(tmp_path / "alone.xml", None).coordinates, [[5.0, 0, 0]] * 2)
    turned = path.read_text().replace(
        "</transform></camera>", "</transform><orientation>6</orientation></camera>"
    )
    path.write_text(turned)
    assert read_metashape(path, "world").notes[0].startswith("1 images are turned by their EXIF orientation")


# ---------------------------------------------------------------- files


def picture(path, values):
    Image.fromarray(np.asarray(values, np.uint8)).save(path)
    return path


def test_what_is_known_of_a_picture(tmp_path):
    """Share, contrast and sharpness of what no mask covers, of the picture scaled by averaging."""
    rng = np.random.default_rng(1)
    values = rng.integers(0, 255, (40, 60))
    path = picture(tmp_path / "a.png", values)
    mask = np.full((40, 60), 255)
    mask[:, :30] = 0
    found, grey, usable = files.inspect(path, picture(tmp_path / "m.png", mask), 3200)
    assert (found.name, found.size_px, found.usable_share, found.problem) == ("a.png", (60, 40), 0.5, "")
    v = values.astype(float)
    assert found.contrast == pytest.approx(v[:, 30:].std(), rel=1e-5)
    wide = np.pad(v, 1, mode="symmetric")
    laplace = wide[2:, 1:-1] + wide[:-2, 1:-1] + wide[1:-1, 2:] + wide[1:-1, :-2] - 4 * v
    assert found.sharpness == pytest.approx(laplace[:, 30:].std() / found.contrast, rel=1e-4)
    np.testing.assert_array_equal(grey, values)
    assert usable.shape == (40, 60)
    small, grey, _ = files.inspect(path, None, 30, name="x/a.png")
    assert (small.name, small.size_px, small.usable_share, grey.shape) == ("x/a.png", (60, 40), 1.0, (20, 30))
    np.testing.assert_allclose(grey, v.reshape(20, 2, 30, 2).mean(axis=(1, 3)), atol=1.01)  # rounded twice
    assert files.inspect(path, None, 60)[1].shape == (40, 60)
    flat, _, _ = files.inspect(picture(tmp_path / "b.png", np.full((4, 4), 7)), None, 9)
    assert (flat.contrast, flat.sharpness) == (0.0, 0.0)
    for rows, problem in ((1, "no usable pixels: 99.6 % are masked"), (2, "")):
        mask = np.zeros((250, 4))
        mask[:rows] = 255
        picture(tmp_path / "m.png", mask)
        found, grey, _ = files.inspect(picture(tmp_path / "c.png", np.arange(1000).reshape(250, 4) % 251),
                                       tmp_path / "m.png", 999)  # fmt: skip
        assert (found.problem, grey.size) == (problem, 0 if problem else 1000)
        assert found.usable_share == rows / 250


def test_a_view_of_a_file(tmp_path):
    """Its own size, its own mask, and other bytes than those of another lens."""
    values = np.arange(200).reshape(10, 20)
    path = picture(tmp_path / "a.png", values)
    usable = np.ones((10, 8), bool)
    usable[5:] = False
    views = [files.LensView(lens=name, cut=lambda v: v[:, 2:10], usable=usable) for name in ("front", "back")]
    found, grey, seen = files.inspect(path, None, 99, view=views[0])
    assert (found.size_px, found.usable_share) == ((8, 10), 0.5)
    np.testing.assert_array_equal(grey, values[:, 2:10])
    np.testing.assert_array_equal(seen, usable)
    assert found.sha256 != files.inspect(path, None, 99, view=views[1])[0].sha256 != ""
    mask = np.zeros((10, 8))
    mask[:, :4] = 255
    both, _, _ = files.inspect(path, picture(tmp_path / "m.png", mask), 99, view=views[0])
    assert both.usable_share == 0.25
    wrong = files.LensView(lens="front", cut=lambda v: v[:, :9], usable=usable)
    told, _, _ = files.inspect(path, None, 99, view=wrong)
    assert (told.problem, told.cause) == ("its view has 9 x 10 pixels, the lens (8, 10)", "size")


def test_names_of_masks_and_their_folders(tmp_path):
    assert files.mask_names("x/a.JPG") == ("x/a.JPG.png", "x/a.png", "x/a_mask.png")
    (tmp_path / "x").mkdir()
    for name in ("a_mask.png", "x/a.png", "b.JPG.png"):
        (tmp_path / name).touch()
    assert files.find_mask("x/a.JPG", tmp_path) == tmp_path / "x/a.png"
    assert files.find_mask("y/a.JPG", tmp_path) == tmp_path / "a_mask.png"
    assert files.find_mask("y/b.JPG", tmp_path) == tmp_path / "b.JPG.png"
    assert files.find_mask("c", tmp_path) is files.find_mask("a", None) is None
    files.check_flat_masks(["x/a.JPG", "y/b.JPG", "y/b.PNG"], tmp_path)
    with pytest.raises(InputError, match=r"one mask b\.JPG\.png for y/b\.JPG and z/b\.JPG"):
        files.check_flat_masks(["y/b.JPG", "z/b.JPG"], tmp_path)
    assert files.mask_folder([]) is None
    assert files.mask_folder([tmp_path / "a_mask.png", tmp_path]) == tmp_path
    with pytest.raises(InputError, match="masks in 2 folders") as told:
        files.mask_folder([tmp_path, tmp_path / "x"])
    assert str(told.value.where) == str(tmp_path / "x")
    with pytest.raises(InputError, match="folder not found"):
        files.mask_folder([tmp_path / "no"])


def test_the_same_file_twice_is_double_once():
    given = [
        ("a", "1", ""),
        ("b", "1", ""),
        ("c", "", "bad"),
        ("d", "", "bad"),
        ("e", "1", "masked"),
        ("f", "2", ""),
    ]
    found = files.without_doubles([Picture(name=n, sha256=s, problem=p) for n, s, p in given])
    assert [p.problem for p in found] == ["", "the same file as a", "bad", "bad", "masked", ""]
    assert [p.cause for p in found] == ["", "double", "", "", "", ""]


def test_pixels_of_masks_of_another_scale():
    mask = np.array([[True, False, False], [False, True, True]])
    x, y = np.array([0.0, 1.99, 2.01, 5.9, 9.0, -1.0]), np.array([0.0, 1.0, 1.0, 3.9, 9.0, -1.0])
    assert files.at_pixels(mask, x, y, (6, 4)).tolist() == [True, True, False, True, True, True]


def test_names_of_groups_of_images():
    groups = [
        ("", ["left/1", "left/2"]),
        ("", ["left/3"]),
        ("own", ["a/1", "b/1"]),
        ("", ["a/2", "b/2"]),
        ("", ["3"]),
    ]
    assert files._names(groups) == ["left", "left 2", "own", "camera", "camera 2"]
    assert files._names(groups[:1]) == ["camera"]
    many = [files.ImageCamera(name=f"c{k}", images=("a",) * k) for k in range(6)]
    assert files.camera_note(many[:1]) == ""
    assert "images of 6 cameras" in files.camera_note(many)
    assert "c3 (3 images) and 2 more: each" in files.camera_note(many)
    assert "c3 (3 images): each" in files.camera_note(many[:4])


def test_shares_of_a_file_that_are_of_the_campaign():
    at, names = np.array([0, -1, -1, -1]), ["a", "b", "c", "d"]
    files.check_share(at, names, ["a"], 0.25, "f")
    with pytest.raises(
        InputError, match=r"1 of 4 images of the file .* not so b, c, d; .* at least 26 % of them"
    ):
        files.check_share(at, names, ["a"], 0.26, "f")
    with pytest.raises(InputError, match=r"0 of 4 .* not so a, b, c \.\.\."):
        files.check_share(np.full(4, -1), names, ["x"], 0.0, "f")
    twice = files.matched(["a.jpg", "A"], ["a.jpg"], "f", once=False)
    assert twice.tolist() == [0, 0]


# ---------------------------------------------------------------- where a block lies


def test_points_on_a_line_and_those_that_do_not_fit():
    line = np.column_stack([np.arange(5.0), np.zeros((5, 2))])
    assert spread_share(line) == pytest.approx(0.0)
    assert spread_share(np.ones((4, 3))) == 0.0
    assert spread_share(line + np.outer([0, 1, -2, 1, 0], [0, 0.1, 0])) == pytest.approx(np.sqrt(0.06 / 10))
    # two roots of ten are the lengths of both extents, along and across
    for share, told in ((0.0099, True), (0.0101, False)):
        points = line + np.outer([1, -1, 0, -1, 1], [0, 0, share * np.sqrt(10 / 4)])
        assert is_line(points) == told
    with pytest.raises(GeometryError, match="all 5 dots lie on a line"):
        robust_similarity(line, line, "abcde", what="dots")
    rng = np.random.default_rng(3)
    source = rng.uniform(-5, 5, (8, 3))
    target = 2.0 * source @ rotation_z(0.4).T + [10, 20, 30]
    target[2, 2] += 5.0
    extent = np.linalg.norm(np.ptp(target, axis=0))
    found = robust_similarity(source, target, "abcdefgh", what="dots")
    assert (found.scale, found.fits.tolist()) == (pytest.approx(2.0), [k != 2 for k in range(8)])
    np.testing.assert_allclose(found.R, rotation_z(0.4), atol=1e-9)
    np.testing.assert_allclose(found.shift_m, [10, 20, 30], atol=1e-9)
    assert found.notes == ["c is 5.00 m away from where the other dots put it: left out"]
    # three hundredths of the extent, or what is said, are no misfit
    for off, fits in ((0.025, True), (0.06, False)):
        near = target.copy()
        near[2, 2] += off * extent - 5.0
        assert robust_similarity(source, near, "abcdefgh", what="dots").fits[2] == fits
    wide = robust_similarity(source, target, "abcdefgh", what="dots", tolerance_m=9.0)
    assert wide.fits.all()
    R, shift, scale = fit_points(source, target[::-1], scaled=True)
    off = np.linalg.norm(scale * source @ R.T + shift - target[::-1], axis=1)
    words = f"{'abcdefgh'[np.argmax(off)]} is off by {off.max():.2f} m, the median is {np.median(off):.2f} m"
    with pytest.raises(GeometryError, match=f"dots and the block do not have the same shape: .*{words}"):
        robust_similarity(source, target[::-1], "abcdefgh", what="dots")
    with pytest.raises(GeometryError, match="2 dots measured in two images or more"):
        robust_similarity(source[:2], target[:2], "ab", what="dots")


# ---------------------------------------------------------------- antenna and rig


def test_positions_of_an_antenna_and_their_covariance():
    """Slow errors of each axis, and jitter of single times along the motion."""
    t, sigma = np.array([0.0, 1.0, 4.0]), np.array([[0.1, 0.2, 0.3], [0.2, 0.3, 0.4], [0.1, 0.1, 0.1]])
    v, jitter = np.array([[1.0, 0, 0], [1, 2, 0], [0, 0, 1]]), np.array([0.01, 0.02, 0.03])
    made = Antenna(
        image=np.arange(3), t_s=t, position_wcs_m=np.zeros((3, 3)), sigma_m=sigma, lever_ccs_m=np.zeros(3),
        velocity_wcs_m_s=v, sigma_jitter_s=jitter, correlation_time_s=2.0,
    )  # fmt: skip
    expected = np.zeros((9, 9))
    for i in range(3):
        for j in range(3):
            for a in range(3):
                expected[3 * i + a, 3 * j + a] = sigma[i, a] * sigma[j, a] * np.exp(-abs(t[i] - t[j]) / 2.0)
        expected[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += jitter[i] ** 2 * np.outer(v[i], v[i])
    np.testing.assert_allclose(
        np.linalg.inv(made.inverse_covariance.reshape(9, 9)), expected, rtol=1e-6, atol=1e-12
    )
    alone = replace(made, correlation_time_s=0.0, sigma_jitter_s=None)
    np.testing.assert_allclose(alone.inverse_covariance.reshape(9, 9), np.diag(1 / sigma.ravel() ** 2))
    assert made.extras == ()
    full = replace(made, shift=True, drift=True, sigma_lever_m=np.array([0.0, 0.1, 0]), sigma_clock_s=0.1)
    assert full.extras == (
        *(f"antenna shift {a}" for a in "enu"), *(f"antenna drift {a}" for a in "enu"),
        *(f"antenna lever arm {a}" for a in "xyz"), full.extras[-1],
    )  # fmt: skip
    assert len(full.extras) == 10
    assert (full.late, replace(full, velocity_wcs_m_s=None).late, made.late) == (True, False, False)
    with pytest.raises(GeometryError, match="a standard deviation of 0 m of an antenna position"):
        replace(made, sigma_m=sigma * [1, 1, 0])


def test_positions_at_exposures_at_the_limits():
    """Linear between positions, the larger sigma of both; at a position none other is needed."""
    t = np.array([0.0, 1.0, 2.0, 5.0])
    xyz = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 1], [9, 3, 1]])
    lat, lon, h = FRAME.to_geodetic(xyz)
    table = pd.DataFrame({
        "t_gps_s": t, "lat_deg": lat, "lon_deg": lon, "h_ell_m": h, "fix": "fixed",
        "sigma_east_m": [0.1, 0.2, 0.1, 0.3], "sigma_north_m": 0.1, "sigma_up_m": [0.4, 0.3, 0.2, 0.1],
    })  # fmt: skip
    at = np.array([-0.1, 0.0, 0.25, 1.0, 2.0, 3.0, 5.0, 5.1, np.nan])
    how = {"lever_ccs_m": np.zeros(3), "sigma_lever_m": np.zeros(3), "accept_fixes": ("fixed",)}
    found, counts = antenna_at_images(
        table, FRAME, at, np.full(9, 0.05), sigma_clock_s=0.03, max_gap_s=1.0, **how
    )
    assert found.image.tolist() == [1, 2, 3, 4, 6]
    assert counts == {"images with a position": 5, "images without time": 1, "images without a position": 3}
    np.testing.assert_allclose(
        found.position_wcs_m, [[0, 0, 0], [0.25, 0, 0], [1, 0, 0], [3, 0, 1], [9, 3, 1]], atol=1e-6
    )
    np.testing.assert_allclose(found.sigma_m[1], [0.2, 0.1, 0.4])
    np.testing.assert_allclose(found.sigma_jitter_s, 0.04)
    wide, _ = antenna_at_images(table, FRAME, at, np.full(9, 0.02), sigma_clock_s=0.03, max_gap_s=3.0, **how)
    assert wide.image.tolist() == [1, 2, 3, 4, 5, 6]
    assert not wide.sigma_jitter_s.any()
    np.testing.assert_allclose(wide.position_wcs_m[4], [5, 1, 1], atol=1e-6)
    none, counts = antenna_at_images(table[:1], FRAME, at, np.full(9, 0.05), max_gap_s=1.0, **how)
    assert (none, counts["images without a position"]) == (None, 8)
    lever = antenna_lever_ccs(Rigid(R=rotation_z(0.3), shift_m=np.array([1.0, 2, 3])), [2.0, 4, 6])
    np.testing.assert_allclose(lever, rotation_z(0.3).T @ [1, 2, 3])
    # over twice the step there, within the track
    way = _velocity(t, xyz, np.array([1.0, 3.0, 5.0]), np.array([0.5, 3.0, 3.0]))
    half = np.interp(1.5, t, xyz[:, 0]) - np.interp(0.5, t, xyz[:, 0])
    assert way[0, 0] == pytest.approx(half / 1.0) or way[0, 0] == pytest.approx(3 / 2)
    np.testing.assert_allclose(way[1], xyz[3] / 5.0)
    np.testing.assert_allclose(way[2], (xyz[3] - xyz[2]) / 3.0)


@pytest.mark.parametrize(("late", "told"), [(0.349, False), (0.351, True), (-0.351, True)])
def test_a_clock_that_is_off_by_more_than_its_sigma_says(late, told):
    made = SimpleNamespace(late=True, sigma_clock_s=0.1)
    notes = clock_notes(made, late)
    assert bool(notes) == told
    if told:
        assert f"taken {late:+.3f} s later than by the camera's clock, 3.5 times its sigma" in notes[0]
    assert clock_notes(SimpleNamespace(late=False, sigma_clock_s=0.1), late) == clock_notes(None, late) == []


def test_poses_of_lenses_from_those_of_their_exposures():
    """Places of lenses count as known; rotations of the rig move the other lens."""
    place = Rigid(R=rotation_z(0.5), shift_m=np.array([0.1, 0.2, -0.3]))
    made = RigFrames(
        exposures=("a", "b"), exposure=np.array([0, 0, 1]), cov=np.diag(np.r_[np.ones(6), np.zeros(6)]),
        T_rig_lens=(place, Rigid(R=np.eye(3), shift_m=np.zeros(3))),
    )  # fmt: skip
    assert made.sought.tolist() == [True, False]
    assert replace(made, places="fixed").sought.tolist() == [False, False]
    rng = np.random.default_rng(4)
    root = rng.normal(0, 0.1, (6, 6))
    given = predictions()
    given = replace(
        given, images=("b", "a", *given.images[2:]), oriented=np.arange(N) != 0,
        cov_pose_wcs=np.tile(root @ root.T, (N, 1, 1)),
    )  # fmt: skip
    found = made.lens_poses(given, ["f/a", "g/a", "f/b"], np.array([0, 1, 0]))
    assert found.images == ("f/a", "g/a", "f/b")
    assert found.oriented.tolist() == [True, True, False]
    arm = given.R_wcs_ccs[1] @ place.shift_m
    np.testing.assert_allclose(found.centre_wcs_m[0], given.centre_wcs_m[1] + arm)
    np.testing.assert_allclose(found.R_wcs_ccs[0], given.R_wcs_ccs[1] @ place.R)
    x, y, z = arm
    J = np.eye(6)
    J[:3, 3:] = -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    np.testing.assert_allclose(found.cov_pose_wcs[0], J @ root @ root.T @ J.T)
    np.testing.assert_allclose(found.cov_pose_wcs[1], root @ root.T)
    assert not found.cov_next[:2].any()
    assert np.isnan(found.cov_next[2]).all()


def test_weights_of_what_lies_far_off():
    """One up to the limit, then its share: roots, of lengths over the root of three components."""
    size = np.array([0.0, 0.5 * _HUBER, _HUBER, 4.0 * _HUBER])
    v = np.outer(size * np.sqrt(3.0), [0.6, 0.0, -0.8])
    np.testing.assert_allclose(_huber(v), [[1.0], [1.0], [1.0], [0.5]])


def test_a_model_in_its_own_frame_takes_scale_and_turn_of_its_similarity(monkeypatch):
    """Places and their covariance are scaled, rotations are only turned; what is unknown stays so."""
    rng = np.random.default_rng(5)
    R = rotation_z(0.6)
    fit = SimpleNamespace(scale=3.0, R=R, shift_m=np.array([10.0, 20.0, 30.0]), rms_m=0.4, rms_rad=0.02)
    monkeypatch.setattr(imports, "align", lambda *words: fit)
    root = rng.normal(0, 1, (2, 6, 6))
    cov = root @ np.swapaxes(root, 1, 2)
    cov[1, 0, 0] = np.nan
    chosen = SimpleNamespace(
        program="Metashape", where="a.xml", coordinates=rng.normal(0, 1, (2, 3)), cov=cov, names=("a", "b"),
        R_place_ccs=exp_rotation(rng.normal(0, 1, (2, 3))),
    )  # fmt: skip
    limits = {"limit_m": 0.5, "limit_rad": 0.03}
    near = SimpleNamespace(centre_wcs_m=None, R_wcs_ccs=None, sigma_m=0.1, sigma_rad=0.1, **limits)
    how = {"align": "predictions"}
    centre, turned, moved, told = imports._aligned(chosen, chosen, near, how)
    np.testing.assert_allclose(centre, 3.0 * chosen.coordinates @ R.T + fit.shift_m)
    np.testing.assert_allclose(turned, R @ chosen.R_place_ccs)
    J = np.zeros((6, 6))
    J[:3, :3], J[3:, 3:] = 3.0 * R, R
    np.testing.assert_allclose(moved[0], J @ cov[0] @ J.T)
    assert np.isnan(moved[1, 0, 0])
    assert told == {"scale": 3.0, "rms_m": 0.4, "rms_deg": pytest.approx(np.rad2deg(0.02)), "images": 2.0}
    with pytest.raises(InputError, match="no image has a prediction"):
        imports._aligned(chosen, None, near, how)
    words = r"a similarity of the scale 3 puts it .* rms of 0\.40 m and 1\.15 degrees in 2 images"
    with pytest.raises(InputError, match=words):
        imports._aligned(chosen, chosen, near, {"align": "refuse"})
    for name in limits:
        far = SimpleNamespace(**{**vars(near), name: 0.0})
        with pytest.raises(InputError, match="it is not the same track"):
            imports._aligned(chosen, chosen, far, how)
