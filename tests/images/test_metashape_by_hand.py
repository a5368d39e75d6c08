"""Interior orientations of Metashape in our parameters: each sign and each name by hand."""

from xml.etree import ElementTree

import numpy as np
import pytest

from thalweg.core.camera import Camera, from_metashape
from thalweg.images.imports.formats import sensor_camera

SIZE_PX = (720, 540)
STATED = {
    "f": 600.0, "b1": 4.0, "b2": 0.0, "cx": 7.0, "cy": -5.0,
    "k1": -0.1, "k2": 0.02, "k3": -0.003, "k4": 0.0, "p1": 0.001, "p2": -0.002,
}  # fmt: skip


def test_the_principal_point_counts_from_the_middle_to_the_right_and_down():
    ours = from_metashape(STATED, SIZE_PX)
    assert (ours["cx"], ours["cy"]) == (367.0, 265.0)
    assert (ours["fx"], ours["fy"]) == (604.0, 600.0)
    assert (ours["p1"], ours["p2"]) == (-0.002, 0.001)
    lens = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
    camera = Camera(
        model="perspective", size_px=SIZE_PX, parameters=np.array([ours[n] for n in lens]), name="a"
    )
    assert camera.parameter_names == lens
    rays = np.array([[0.0, 0.0, 1.0], [0.3, -0.2, 1.0], [-0.1, 0.4, 2.0]])
    assert camera.project(rays)[0] == pytest.approx([367.0, 265.0])
    # x = 0.3, y = -0.2, r2 = 0.13: the equations of the manual, written out
    radial = 1 - 0.1 * 0.13 + 0.02 * 0.13**2 - 0.003 * 0.13**3
    u = 0.3 * radial + 0.001 * (0.13 + 2 * 0.09) + 2 * -0.002 * 0.3 * -0.2
    v = -0.2 * radial + -0.002 * (0.13 + 2 * 0.04) + 2 * 0.001 * 0.3 * -0.2
    assert camera.project(rays)[1] == pytest.approx([367.0 + 604.0 * u, 265.0 + 600.0 * v])


def test_a_covariance_changes_its_names_with_its_parameters():
    """fx is f + b1, fy is f: variances and all covariances of the sums."""
    stated = ("f", "b1", "cx", "p1", "p2")
    root = np.random.default_rng(13).standard_normal((5, 5))
    C = root @ root.T
    values = "".join(f"<{name}>{value}</{name}>" for name, value in STATED.items() if value)
    sensor = ElementTree.fromstring(
        f"""<sensor label="a" type="frame"><calibration type="frame" class="adjusted">
        <resolution width="720" height="540"/>{values}</calibration>
        <covariance><params>{" ".join(stated)}</params>
        <coeffs>{" ".join(map(repr, C.ravel().tolist()))}</coeffs></covariance></sensor>"""
    )
    camera = sensor_camera(sensor, "a.xml", [])
    at = [camera.parameter_names.index(name) for name in ("fx", "fy", "cx", "cy", "p1", "p2")]
    found = camera.cov[np.ix_(at, at)]
    assert found[0, 0] == pytest.approx(C[0, 0] + 2 * C[0, 1] + C[1, 1])
    assert found[0, 1] == pytest.approx(C[0, 0] + C[0, 1])
    assert found[0, 2] == pytest.approx(C[0, 2] + C[1, 2])
    assert found[1, 1] == pytest.approx(C[0, 0])
    assert found[3] == pytest.approx(np.zeros(6))
    assert found[4, 4] == pytest.approx(C[4, 4])  # our p1 is their p2
    assert found[0, 5] == pytest.approx(C[0, 3] + C[1, 3])
