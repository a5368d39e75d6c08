"""Poses and cameras from Metashape's XML, written by hand from known ones and read back."""

from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS

from tests.images.finished_scene import (
    FRAME,
    LOCAL,
    UTM33,
    assert_poses,
    geocentric,
    grid_rotations,
    predictions,
    scene,
    settings,
    write_metashape,
)
from thalweg.core import InputError, exp_rotation, from_metashape
from thalweg.images.imports import import_orientations
from thalweg.images.model import ImagePoses


@pytest.fixture
def truth():
    return scene()


# ---------------------------------------------------------------- Metashape


@pytest.mark.parametrize("component", [False, True], ids=["chunk", "component"])
@pytest.mark.parametrize("epsg", [4326, 25833, 4258])
def test_metashape_is_geocentric_whatever_its_crs(tmp_path, truth, epsg, component):
    wkt = CRS.from_epsg(epsg).to_wkt("WKT1_GDAL")
    path = write_metashape(
        tmp_path / "c.xml", truth.images, *geocentric(truth), reference=wkt, component=component
    )
    found = import_orientations([path], predictions(truth), settings())
    # earth-centred coordinates of 5e6 m have 1e-9 m; the scale and back some of them
    assert_poses(found.poses, truth, atol_m=1e-8)


def test_metashape_in_local_coordinates_of_the_world_frame_or_of_a_grid(tmp_path, truth):
    path = write_metashape(tmp_path / "c.xml", truth.images, truth.C, truth.R, reference=LOCAL)
    assert_poses(import_orientations([path], predictions(truth), settings(crs="world")).poses, truth)
    C = FRAME.to_map(truth.C, UTM33)
    path = write_metashape(tmp_path / "c.xml", truth.images, C, grid_rotations(truth), reference=LOCAL)
    found = import_orientations([path], predictions(truth), settings(crs="EPSG:25833"))
    assert_poses(found.poses, truth, atol_m=1e-7, atol=3e-8)


def test_metashape_covariances(tmp_path, truth):
    """Position in the units and axes of the chunk, rotation about the axes of the camera."""
    A = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 3.0]])
    location, rotation = 1e-6 * A, 1e-8 * A[::-1, ::-1]
    path = write_metashape(
        tmp_path / "c.xml", truth.images, truth.C, truth.R, reference=LOCAL, covariance=(location, rotation)
    )
    found = import_orientations([path], predictions(truth), settings(crs="world"))
    R0 = exp_rotation(np.array([0.3, -1.1, 0.7]))
    for k, C in enumerate(found.poses.cov_pose_wcs):
        np.testing.assert_allclose(C[:3, :3], 3.7**2 * R0 @ location @ R0.T, rtol=1e-9, atol=1e-18)
        np.testing.assert_allclose(C[3:, 3:], truth.R[k] @ rotation @ truth.R[k].T, rtol=1e-9, atol=1e-18)
        assert not C[:3, 3:].any()


def test_cameras_that_metashape_left_out(tmp_path, truth):
    names = [Path(name).stem for name in truth.images]
    extra = (
        '<camera id="90" sensor_id="0" label="IMG_0010" enabled="false">'
        "<transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform></camera>"
        '<camera id="91" sensor_id="0" label="IMG_0011"><orientation>1</orientation></camera>'
    )
    path = write_metashape(
        tmp_path / "c.xml", names[:10], truth.C[:10], truth.R[:10], reference=LOCAL, extra=extra
    )
    found = import_orientations([path], predictions(truth), settings(crs="world"))
    assert found.poses.oriented.tolist() == [True] * 10 + [False] * 2
    assert found.poses.reasons[10:] == ("switched off in Metashape", "not aligned in Metashape")
    assert found.facts["without_pose"] == dict(zip(truth.images[10:], found.poses.reasons[10:], strict=True))
    assert np.isnan(found.poses.cov_pose_wcs[10:]).all()
    found.poses.write(tmp_path / "poses.parquet")
    assert ImagePoses.read(tmp_path / "poses.parquet").reasons == found.poses.reasons


def test_local_coordinates_in_feet_are_refused(tmp_path, truth):
    feet = LOCAL.replace('UNIT["metre",1', 'UNIT["foot",0.3048')
    path = write_metashape(tmp_path / "c.xml", truth.images, truth.C, truth.R, reference=feet)
    assert feet != LOCAL
    with pytest.raises(InputError, match=r"coordinates in '.*'; expected metres"):
        import_orientations([path], predictions(truth), settings(crs="world"))


@pytest.mark.parametrize("value", ["true", "false"])
def test_a_rolling_shutter_is_told(tmp_path, truth, value):
    path = write_metashape(tmp_path / "c.xml", truth.images, truth.C, truth.R, reference=LOCAL)
    shutter = f'<property name="rolling_shutter" value="{value}"/></sensor>'
    path.write_text(path.read_text().replace("</sensor>", shutter))
    notes = import_orientations([path], predictions(truth), settings(crs="world")).facts["notes"]
    assert any("those of a rolling shutter" in note for note in notes) == (value == "true")


METASHAPE = {"f": 582.0, "cx": 1.5, "cy": -2.0, "b1": 0.5, "b2": 0.0, "k1": -0.05, "k2": 0.012, "k3": 0.001,
             "k4": 0.0, "p1": 3e-4, "p2": -2e-4}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "kind", "model", "told"),
    [
        ({}, "frame", "perspective", ""),
        ({"p1": 0.0, "p2": 0.0, "k4": 0.002}, "equidistant_fisheye", "fisheye", ""),
        # the corner lies 450 px from the middle, 450 / 582 of the focal length
        ({"b2": 0.3}, "frame", "perspective", "up to 0.23 px"),
        ({"p1": 1e-4, "p2": 0.0}, "fisheye", "fisheye", "up to 0.10 px"),
        ({"k4": 0.002}, "frame", "perspective", "up to 0.11 px"),
        ({"b2": 9.0}, "frame", None, "too much, no interior orientation"),
    ],
)
def test_terms_that_our_models_do_not_have_are_told_or_refused(tmp_path, truth, changes, kind, model, told):
    terms = METASHAPE | changes
    path = write_metashape(tmp_path / "c.xml", truth.images, truth.C, truth.R, reference=LOCAL, terms=terms)
    path.write_text(path.read_text().replace('type="frame" class', f'type="{kind}" class'))
    found = import_orientations([path], predictions(truth), settings(crs="world"))
    notes = " ".join(found.facts["notes"])
    assert told in notes
    assert ("px different" in notes) == bool(told)
    assert (found.camera and found.camera.model) == model
    if found.camera is not None:
        ours = from_metashape(terms, (720, 540))
        assert found.camera.parameters.tolist() == [ours[name] for name in found.camera.parameter_names]


def test_covariance_of_the_interior_orientation(tmp_path, truth):
    C = np.diag([0.04, 0.01, 0.02, 1e-8]) + 1e-10
    coefficients = " ".join(map(repr, C.ravel().tolist()))
    calibration = f"<covariance><params>f cx cy p1</params><coeffs>{coefficients}</coeffs></covariance>"
    path = write_metashape(
        tmp_path / "c.xml", truth.images, truth.C, truth.R, reference=LOCAL, calibration=calibration
    )
    camera = import_orientations([path], predictions(truth), settings(crs="world")).camera
    assert camera is not None
    cov = dict(zip(camera.parameter_names, camera.cov, strict=True))
    order = camera.parameter_names.index
    assert cov["fx"][order("fx")] == cov["fx"][order("fy")] == cov["fy"][order("fy")] == C[0, 0]
    assert cov["p2"][order("p2")] == C[3, 3]
    assert not cov["p1"].any()
