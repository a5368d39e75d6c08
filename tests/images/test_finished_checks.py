"""Wrong files of finished orientations: what is found, and what is said to be right."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from pyproj import CRS

from tests.bands import band
from tests.images.finished_scene import (
    FLIP,
    FRAME,
    TRUTH,
    Scene,
    angles_deg,
    assert_poses,
    geocentric,
    imported,
    in_grid,
    predictions,
    scene,
    table,
    write_colmap_text,
    write_metashape,
)
from thalweg.core import GeometryError, InputError, exp_rotation, read_colmap
from thalweg.images import place_files
from thalweg.images.model import align, mean_rotation, unknown_poses
from thalweg.settings.sections import LOCAL, ControlSettings, FinishedOrientations

NO_NAMES = (
    "eo.txt: The file names no columns: taken as image, x, y, z, omega, phi, kappa, "
    "and no unit of the angles: taken as degrees"
)


def refused(path: Path, rng: np.random.Generator, crs: str) -> str:
    """The message, with predictions that are off by 0.3 m and 0.5 degrees."""
    with pytest.raises(InputError) as found:
        imported(path, given=predictions(rng), crs=crs)
    assert str(path) in str(found.value)
    return str(found.value)


def turned(degrees: float) -> Scene:
    """Cameras that are turned about their upright axes."""
    return Scene(TRUTH.images, TRUTH.C, TRUTH.R @ exp_rotation(np.array([0.0, np.deg2rad(degrees), 0.0])))


# ---------------------------------------------------------------- angles


def test_a_matrix_beside_the_angles_tells_their_unit(tmp_path):
    matrix = (TRUTH.R @ FLIP).reshape(-1, 9)
    rows = np.column_stack([angles_deg(TRUTH.R) * 10 / 9, matrix])
    path = table(tmp_path / "eo.txt", angles=rows)
    # without any prediction of use
    with pytest.raises(InputError, match=r"differ by .*images\.finished\.angle_unit"):
        imported(path)
    assert_poses(imported(path, angle_unit="gon"))


def test_a_wrong_mount_is_refused(tmp_path, rng):
    path = write_colmap_text(tmp_path / "m", turned(50.0))
    with pytest.raises(InputError, match=r"attitudes a median of (49|50|51)\.\d degrees away"):
        imported(path, given=predictions(rng))


@pytest.mark.parametrize(("turned_deg", "told"), [(6.0, True), (0.3, False)])
def test_attitudes_off_by_more_than_their_prediction_may_be_are_told(tmp_path, rng, turned_deg, told):
    """Another north, for example: below the limit of refusal, above chance."""
    path = write_colmap_text(tmp_path / "m", turned(turned_deg))
    notes = imported(path, given=predictions(rng, sigma_deg=0.2)).facts["notes"]
    assert any("degrees away from the predicted ones" in note for note in notes) == told


def test_small_errors_of_the_prediction_are_no_mistake(tmp_path, rng):
    given = predictions(rng, sigma_m=2.0, sigma_deg=4.0)
    found = imported(table(tmp_path / "eo.txt"), given=given)
    assert_poses(found)
    assert found.facts["notes"] == [NO_NAMES]
    assert found.facts["files"][0]["images_compared"] == 12


# ---------------------------------------------------------------- positions


@pytest.mark.parametrize("known", [True, False], ids=["predicted", "blind"])
def test_coordinates_of_another_order_are_refused(tmp_path, rng, known):
    grid = in_grid()
    path = table(tmp_path / "eo.txt", grid.C[:, [1, 0, 2]], of=grid)
    given = predictions(rng) if known else unknown_poses(FRAME, TRUTH.images)
    with pytest.raises(InputError, match=r"Check images\.finished\.crs .*order and unit of the columns"):
        imported(path, given=given, campaign="EPSG:25833", crs=None)
    right = imported(table(tmp_path / "right.txt", of=grid), given=given, campaign="EPSG:25833", crs=None)
    assert_poses(right, atol_m=1e-7, atol=3e-8)


def test_heights_above_the_geoid_are_named_and_their_cure_works(tmp_path, rng):
    grid = in_grid()
    path = table(tmp_path / "eo.txt", grid.C - [0.0, 0.0, 44.2], of=grid)
    message = refused(path, rng, "EPSG:25833")
    assert "m below the predicted ones, all alike" in message
    assert re.search(r"about 4[45] m", message)  # the prediction itself is off by 0.3 m
    found = imported(path, crs="EPSG:25833", height_offset_m=44.2)
    assert_poses(found, atol_m=1e-7, atol=3e-8)
    # a quarter of a metre of geoid is within what predictions know
    near = imported(path, crs="EPSG:25833", height_offset_m=44.45)
    np.testing.assert_allclose(near.poses.centre_wcs_m[:, 2] - TRUTH.C[:, 2], 0.25, atol=1e-3)
    # 10 m are told, and nothing more
    told = imported(path, crs="EPSG:25833", height_offset_m=34.2)
    assert "heights 10.0 m below" in told.facts["notes"][1]


def test_geocentric_heights_are_raised_along_the_vertical(tmp_path):
    lat, lon, h = FRAME.to_geodetic(TRUTH.C)
    low = Scene(TRUTH.images, FRAME.from_geodetic(lat, lon, h - 44.2), TRUTH.R)
    wkt = CRS.from_epsg(4326).to_wkt("WKT1_GDAL")
    path = write_metashape(tmp_path / "c.xml", geocentric(low), reference=wkt)
    found = imported(path, crs=None, height_offset_m=44.2)
    assert_poses(found, atol_m=1e-8)


def test_another_survey_is_refused(tmp_path, rng):
    path = table(tmp_path / "eo.txt", TRUTH.C + np.array([3000.0, 0.0, 0.0]))
    message = refused(path, rng, "world")
    assert "positions a median of 3000 m away" in message
    assert "clock" in message


def test_a_single_far_image_is_told(tmp_path):
    C = TRUTH.C.copy()
    C[4, 0] += 60.0
    path = table(tmp_path / "eo.txt", C)
    note = imported(path).facts["notes"][1]
    assert "1 of 12 images are more than 20 m away" in note
    assert TRUTH.images[4] in note


def test_another_datum_is_refused(tmp_path):
    path = table(tmp_path / "eo.txt", in_grid().C)
    with pytest.raises(InputError, match="Bessel"):
        imported(path, crs="EPSG:31469")
    wkt = CRS.from_epsg(4314).to_wkt("WKT1_GDAL")
    path = write_metashape(tmp_path / "c.xml", geocentric(), reference=wkt)
    with pytest.raises(InputError, match="'DHDN' is on the ellipsoid Bessel 1841, another datum"):
        imported(path, crs=None)


# ---------------------------------------------------------------- models without place


R_FREE = exp_rotation(np.array([0.4, 1.9, -0.6]))
FREE = Scene(TRUTH.images, (TRUTH.C - [480.0, -190.0, 3.0]) @ R_FREE / 7.3, R_FREE.T @ TRUTH.R)


def test_a_free_model_is_refused_with_what_a_similarity_leaves(tmp_path):
    path = write_colmap_text(tmp_path / "m", FREE)
    with pytest.raises(InputError) as found:
        imported(path, crs=None)
    assert "a similarity of the scale 7.3 puts it onto the predicted poses" in str(found.value)
    assert "an rms of 0.00 m and 0.00 degrees in 12 images" in str(found.value)
    assert "control points" in str(found.value)
    assert "align: predictions" in str(found.value)
    aligned = imported(path, crs=None, align="predictions")
    # a similarity of float64 at 500 m
    assert_poses(aligned, atol_m=1e-8)
    assert aligned.facts["files"][0]["aligned"]["scale"] == pytest.approx(7.3, rel=1e-9)
    assert any("errs as a whole as the prediction does" in note for note in aligned.facts["notes"])


def test_an_aligned_model_errs_as_the_prediction_does(tmp_path, rng):
    path = write_colmap_text(tmp_path / "m", FREE)
    chi = []
    for _ in range(60):
        given = predictions(rng, sigma_m=0.2, sigma_deg=0.3)
        found = imported(path, given=given, crs=None, align="predictions").poses
        error = found.centre_wcs_m[5] - TRUTH.C[5]
        chi.append(error @ np.linalg.solve(found.cov_pose_wcs[5, :3, :3], error) / 3)
        # the common part makes neighbours alike
        assert np.trace(found.cov_next[5]) > 0.95 * np.trace(found.cov_pose_wcs[5])
    low, high = band(3 * len(chi))  # the own tenth of the noise adds 1 %
    assert low < np.mean(chi) < high


def test_a_free_model_of_another_track_is_refused_even_so(tmp_path, rng):
    shuffled = rng.permutation(12)
    path = write_colmap_text(tmp_path / "m", Scene(FREE.images, FREE.C[shuffled], FREE.R[shuffled]))
    with pytest.raises(InputError, match="not the same track"):
        imported(path, crs=None, align="predictions")


@pytest.mark.parametrize("chunk", [True, False])
def test_local_coordinates_without_a_name_are_free(tmp_path, chunk):
    path = write_metashape(tmp_path / "c.xml", FREE, chunk=chunk)
    with pytest.raises(InputError, match="Metashape in a frame of its own"):
        imported(path, crs=None)
    assert_poses(imported(path, crs=None, align="predictions"), atol_m=1e-8)


def test_a_straight_track_is_aligned_by_its_attitudes(rng):
    track = scene(8)
    C = np.array([10.0, 0.0, 0.0]) * np.arange(8)[:, None]
    R = exp_rotation(np.array([0.2, 0.5, -0.9]))
    model = (C - 5.0) @ R / 3.0, R.T @ track.R
    found = align(*model, C, track.R, 0.1, 0.01)
    np.testing.assert_allclose(found.centre_wcs_m, C, atol=1e-9)
    np.testing.assert_allclose(found.R, R, atol=1e-9)
    # predictions without errors have at least 1 cm and 0.1 mrad
    sure = align(*model, C, track.R, 0.0, 0.0)
    np.testing.assert_allclose(sure.centre_wcs_m, C, atol=1e-9)
    with pytest.raises(GeometryError, match=r"predictions good to 0\.01 m"):
        align(C[:2], track.R[:2], C[:2], track.R[:2], 0.0, 0.0)
    # two outliers of eight in the predictions hardly move it: weights fall with the distance
    wrong = C.copy()
    wrong[[2, 5]] += [0.0, 8.0, 3.0]
    near = align(*model, wrong, track.R, 0.1, 0.01)
    assert np.abs(near.centre_wcs_m - C).max() < 0.3


def test_images_at_one_place_give_no_scale(tmp_path):
    still = Scene(TRUTH.images, np.tile(TRUTH.C[0], (12, 1)), TRUTH.R)
    path = write_colmap_text(tmp_path / "m")
    with pytest.raises(InputError, match="cannot be put onto the prediction"):
        imported(path, given=predictions(truth=still), crs=None, align="predictions")


def test_the_mean_rotation_is_not_that_of_outliers(rng):
    R = exp_rotation(np.array([0.3, -0.2, 1.0]))
    turns = exp_rotation(0.001 * rng.normal(size=(20, 3))) @ R
    turns[:4] = exp_rotation(np.array([0.0, 2.0, 0.0])) @ R
    # 16 rotations of 1e-3 rad: 2.5e-4 in the mean
    assert np.abs(mean_rotation(turns) - R).max() < 1e-3


# ---------------------------------------------------------------- photographs


@pytest.mark.parametrize(
    ("sizes", "words"),
    [
        ([(1440, 1080)] * 12, ""),
        ([(736, 542)] * 12, "the same ratio of the sides"),  # a model of undistorted pictures
        ([(720, 540)] * 11 + [(1440, 1080)], "pictures of 1440 x 1080 pixels; expected 720 x 540"),
    ],
)
def test_marks_are_those_of_the_photographs_whatever_size_the_model_is_of(tmp_path, sizes, words):
    """Marks of the photographs counted in the smaller pixels of the model, hundreds of them away."""
    lens = read_colmap(write_colmap_text(tmp_path / "model") / "cameras.txt")[7]
    for name, size in zip(TRUTH.images, sizes, strict=True):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        Image.new("L", size).save(tmp_path / name, "JPEG")
    rows = ["image,point,x_px,y_px,sigma_px"]
    points = {f"p{k}": TRUTH.C[k] + TRUTH.R[k] @ [0.3 * k - 1.0, 0.5, 20.0] for k in (4, 5, 6)}
    for i, name in enumerate(TRUTH.images):
        for point, xyz in points.items():
            (xy,) = lens.project((xyz - TRUTH.C[i]) @ TRUTH.R[i])
            if lens.inside(xy[None])[0]:
                x, y = xy * np.divide(sizes[0], lens.size_px)
                rows.append(f"{Path(name).name},{point},{x:.4f},{y:.4f},0.5")
    (tmp_path / "marks.csv").write_text("\n".join(rows))
    places = [f"{name},{x:.5f},{y:.5f},{z:.5f}" for name, (x, y, z) in points.items()]
    (tmp_path / "points.csv").write_text("\n".join(["id,x,y,z", *places]))
    given = {
        "images": [tmp_path / "run"],
        "control_points": [tmp_path / "points.csv"],
        "marks": [tmp_path / "marks.csv"],
        "interior": [],
        "orientations": [tmp_path / "model"],
        "folder": tmp_path / "out",
        "campaign": {"id": "a", "crs": LOCAL, "origin": None},
        "finished": FinishedOrientations(crs="world"),
        "control": ControlSettings(),
    }
    if words:
        with pytest.raises((GeometryError, InputError), match=words):
            place_files(**given)
    else:
        place_files(**given)
        off = pd.read_csv(tmp_path / "out/finished_points.csv").query("role == 'check'")
        assert len(off) == 3
        # marks and coordinates are rounded to 0.1 um of the picture and 10 um
        assert off[[f"off_{axis}_mm" for axis in ("east", "north", "up")]].abs().to_numpy().max() < 1.0
