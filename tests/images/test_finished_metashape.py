"""Poses and cameras from Metashape's XML, written by hand from known ones and read back."""

from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS

from tests.images.finished_scene import (
    TRUTH,
    Scene,
    assert_poses,
    geocentric,
    imported,
    in_grid,
    write_metashape,
)
from thalweg.core import exp_rotation, from_metashape
from thalweg.images.model import ImagePoses

# ---------------------------------------------------------------- Metashape


@pytest.mark.parametrize("component", [False, True], ids=["chunk", "component"])
@pytest.mark.parametrize("epsg", [4326, 25833, 4258])
def test_metashape_is_geocentric_whatever_its_crs(tmp_path, epsg, component):
    wkt = CRS.from_epsg(epsg).to_wkt("WKT1_GDAL")
    path = write_metashape(tmp_path / "c.xml", geocentric(), reference=wkt, component=component)
    # earth-centred coordinates of 5e6 m have 1e-9 m; the scale and back some of them
    assert_poses(imported(path, crs=None), atol_m=1e-8)


def test_metashape_in_local_coordinates_of_the_world_frame_or_of_a_grid(tmp_path):
    assert_poses(imported(write_metashape(tmp_path / "c.xml")))
    path = write_metashape(tmp_path / "c.xml", in_grid())
    assert_poses(imported(path, crs="EPSG:25833"), atol_m=1e-7, atol=3e-8)


def test_metashape_covariances(tmp_path):
    """Position in the units and axes of the chunk, rotation about the axes of the camera."""
    A = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 3.0]])
    location, rotation = 1e-6 * A, 1e-8 * A[::-1, ::-1]
    path = write_metashape(tmp_path / "c.xml", covariance=(location, rotation))
    found = imported(path)
    R0 = exp_rotation(np.array([0.3, -1.1, 0.7]))
    for k, C in enumerate(found.poses.cov_pose_wcs):
        np.testing.assert_allclose(C[:3, :3], 3.7**2 * R0 @ location @ R0.T, rtol=1e-9, atol=1e-18)
        np.testing.assert_allclose(C[3:, 3:], TRUTH.R[k] @ rotation @ TRUTH.R[k].T, rtol=1e-9, atol=1e-18)
        assert not C[:3, 3:].any()


def test_cameras_that_metashape_left_out(tmp_path):
    names = tuple(Path(name).stem for name in TRUTH.images[:10])
    extra = (
        '<camera id="90" sensor_id="0" label="IMG_0010" enabled="false">'
        "<transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform></camera>"
        '<camera id="91" sensor_id="0" label="IMG_0011"><orientation>1</orientation></camera>'
    )
    path = write_metashape(tmp_path / "c.xml", Scene(names, TRUTH.C[:10], TRUTH.R[:10]), extra=extra)
    found = imported(path)
    assert found.poses.oriented.tolist() == [True] * 10 + [False] * 2
    assert found.poses.reasons[10:] == ("switched off in Metashape", "not aligned in Metashape")
    assert found.facts["without_pose"] == dict(zip(TRUTH.images[10:], found.poses.reasons[10:], strict=True))
    assert np.isnan(found.poses.cov_pose_wcs[10:]).all()
    found.poses.write(tmp_path / "poses.parquet")
    assert ImagePoses.read(tmp_path / "poses.parquet").reasons == found.poses.reasons


@pytest.mark.parametrize("value", ["true", "false"])
def test_a_rolling_shutter_is_told(tmp_path, value):
    path = write_metashape(tmp_path / "c.xml")
    shutter = f'<property name="rolling_shutter" value="{value}"/></sensor>'
    path.write_text(path.read_text().replace("</sensor>", shutter))
    notes = imported(path).facts["notes"]
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
def test_terms_that_our_models_do_not_have_are_told_or_refused(tmp_path, changes, kind, model, told):
    terms = METASHAPE | changes
    path = write_metashape(tmp_path / "c.xml", terms=terms)
    path.write_text(path.read_text().replace('type="frame" class', f'type="{kind}" class'))
    found = imported(path)
    notes = " ".join(found.facts["notes"])
    assert told in notes
    assert ("px different" in notes) == bool(told)
    assert (found.camera and found.camera.model) == model
    if found.camera is not None:
        ours = from_metashape(terms, (720, 540))
        assert found.camera.parameters.tolist() == [ours[name] for name in found.camera.parameter_names]


def test_covariance_of_the_interior_orientation(tmp_path):
    C = np.diag([0.04, 0.01, 0.02, 1e-8]) + 1e-10
    coefficients = " ".join(map(repr, C.ravel().tolist()))
    calibration = f"<covariance><params>f cx cy p1</params><coeffs>{coefficients}</coeffs></covariance>"
    path = write_metashape(tmp_path / "c.xml", calibration=calibration)
    camera = imported(path).camera
    cov = dict(zip(camera.parameter_names, camera.cov, strict=True))
    order = camera.parameter_names.index
    assert cov["fx"][order("fx")] == cov["fx"][order("fy")] == cov["fy"][order("fy")] == C[0, 0]
    assert cov["p2"][order("p2")] == C[3, 3]
    assert not cov["p1"].any()
