"""Poses and cameras from Metashape's XML, written by hand from known ones and read back."""

from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS

from tests.images.finished_scene import (
    FRAME,
    LOCAL,
    UTM33,
    Scene,
    assert_poses,
    geocentric,
    grid_rotations,
    predictions,
    scene,
    settings,
    write_metashape,
)
from thalweg.core import ArrayF, exp_rotation
from thalweg.images.imports import import_orientations
from thalweg.images.imports.formats import project_metashape
from thalweg.images.model import ImagePoses


@pytest.fixture
def truth() -> Scene:
    return scene()


# ---------------------------------------------------------------- Metashape


@pytest.mark.parametrize("component", [False, True], ids=["chunk", "component"])
@pytest.mark.parametrize("epsg", [4326, 25833, 4258])
def test_metashape_is_geocentric_whatever_its_crs(
    tmp_path: Path, truth: Scene, epsg: int, component: bool
) -> None:
    wkt = CRS.from_epsg(epsg).to_wkt("WKT1_GDAL")
    path = write_metashape(
        tmp_path / "c.xml", truth.images, *geocentric(truth), reference=wkt, component=component
    )
    found = import_orientations([path], predictions(truth), settings())
    # earth-centred coordinates of 5e6 m have 1e-9 m; the scale and back some of them
    assert_poses(found.poses, truth, atol_m=1e-8)


def test_metashape_in_local_coordinates_of_the_world_frame_or_of_a_grid(tmp_path: Path, truth: Scene) -> None:
    path = write_metashape(tmp_path / "c.xml", truth.images, truth.C, truth.R, reference=LOCAL)
    assert_poses(import_orientations([path], predictions(truth), settings(crs="world")).poses, truth)
    C = FRAME.to_map(truth.C, UTM33)
    path = write_metashape(tmp_path / "c.xml", truth.images, C, grid_rotations(truth), reference=LOCAL)
    found = import_orientations([path], predictions(truth), settings(crs="EPSG:25833"))
    assert_poses(found.poses, truth, atol_m=1e-7, atol=3e-8)


def test_metashape_covariances(tmp_path: Path, truth: Scene) -> None:
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


def test_cameras_that_metashape_left_out(tmp_path: Path, truth: Scene) -> None:
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


METASHAPE = {"f": 582.0, "cx": 1.5, "cy": -2.0, "b1": 0.5, "b2": 0.0, "k1": -0.05, "k2": 0.012, "k3": 0.001,
             "k4": 0.0, "p1": 3e-4, "p2": -2e-4}  # fmt: skip


def rays() -> ArrayF:
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 9), np.linspace(-0.4, 0.4, 7))
    return np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])


@pytest.mark.parametrize(
    ("changes", "kind", "model", "off_px"),
    [
        ({}, "frame", "perspective", 1e-9),
        # a skew of 0.3 px over 0.5: 0.15 px, of which a fitted distortion takes a part
        ({"b2": 0.3}, "frame", "perspective", 0.2),
        ({"p1": 0.0, "p2": 0.0, "k4": 0.002}, "equidistant_fisheye", "fisheye", 1e-9),
        ({"p1": 1e-4, "p2": 0.0}, "fisheye", "fisheye", 0.1),
    ],
    ids=["frame", "skew", "fisheye", "fisheye with a tangential part"],
)
def test_interior_orientation_of_metashape(
    tmp_path: Path, truth: Scene, changes: dict[str, float], kind: str, model: str, off_px: float
) -> None:
    terms = METASHAPE | changes
    path = write_metashape(tmp_path / "c.xml", truth.images, truth.C, truth.R, reference=LOCAL, terms=terms)
    path.write_text(path.read_text().replace('type="frame" class', f'type="{kind}" class'))
    found = import_orientations([path], predictions(truth), settings(crs="world"))
    assert found.camera is not None
    assert found.camera.model == model
    expected = project_metashape(terms, model, (720, 540), rays())  # type: ignore[arg-type]
    np.testing.assert_allclose(found.camera.project(rays()), expected, rtol=0, atol=off_px)
    assert any("different in the picture" in note for note in found.facts["notes"]) == (off_px > 1e-6)


def test_metashape_projects_as_its_manual_says() -> None:
    """One ray by hand: x = 0.3, y = -0.2, q = 0.13."""
    q = 0.13
    radial = 1 - 0.05 * q + 0.012 * q**2 + 0.001 * q**3
    u = 0.3 * radial + 3e-4 * (q + 2 * 0.09) + 2 * (-2e-4) * 0.3 * (-0.2)
    v = -0.2 * radial - 2e-4 * (q + 2 * 0.04) + 2 * 3e-4 * 0.3 * (-0.2)
    found = project_metashape(METASHAPE, "perspective", (720, 540), np.array([[0.6, -0.4, 2.0]]))
    np.testing.assert_allclose(found, [[360 + 1.5 + u * 582.5, 270 - 2 + v * 582]], rtol=1e-14)


def test_covariance_of_the_interior_orientation(tmp_path: Path, truth: Scene) -> None:
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
