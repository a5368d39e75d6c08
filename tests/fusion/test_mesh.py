"""Triangles: sharp angles and folds there are none, and each file is read back."""

import numpy as np
import py2dm
import pytest
from pyproj import CRS
from scipy.io import netcdf_file

from tests.fusion.test_measures_and_exports import model, river  # noqa: F401
from thalweg.core import GeometryError
from thalweg.fusion.exports import least_angles_deg, mesh_river, write_2dm, write_selafin, write_ugrid
from thalweg.settings.sections import MeshSettings


@pytest.fixture
def mesh(model, river):  # noqa: F811
    return mesh_river(model, river, MeshSettings(edge_m=1.5))


def test_no_triangle_is_sharp_or_folded_and_all_water_is_covered(mesh, river):  # noqa: F811
    assert mesh.least_angles_deg().min() >= 20
    p = mesh.nodes_m[mesh.faces][:, :, :2]
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    area = np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    assert area == pytest.approx(12 * river.flow.length_m, rel=0.02)
    edges = {
        tuple(sorted(e)) for f in mesh.faces.tolist() for e in ((f[0], f[1]), (f[1], f[2]), (f[2], f[0]))
    }
    for name in ("left bank", "thalweg", "right bank"):
        nodes = mesh.lines[name]
        assert all(
            tuple(sorted(e)) in edges for e in zip(nodes[:-1].tolist(), nodes[1:].tolist(), strict=True)
        ), name


def test_a_folded_triangle_has_a_negative_angle():
    places = np.array([[0.0, 0], [1, 0], [0, 1]])
    assert least_angles_deg(places, np.array([[0, 1, 2]])) == pytest.approx(45)
    assert least_angles_deg(places, np.array([[0, 2, 1]])) < 0


def test_a_river_narrower_than_an_edge_is_refused(model, river):  # noqa: F811
    with pytest.raises(GeometryError, match="width"):
        mesh_river(model, river, MeshSettings(edge_m=20.0))


def test_2dm_is_read_by_py2dm(mesh, tmp_path):
    write_2dm(tmp_path / "river.2dm", mesh)
    with py2dm.Reader(str(tmp_path / "river.2dm")) as file:
        nodes = np.array([node.pos for node in file.iter_nodes()])
        faces = np.array([element.nodes for element in file.iter_elements()]) - 1
    assert nodes == pytest.approx(mesh.nodes_m, abs=1e-4)
    assert (faces == mesh.faces).all()


def test_ugrid_is_read_by_scipy(mesh, tmp_path):
    wkt = CRS("EPSG:25833").to_wkt()  # "Europe between 12°E and 18°E ..."
    write_ugrid(tmp_path / "river.nc", mesh, crs_wkt=wkt)
    with netcdf_file(str(tmp_path / "river.nc"), mmap=False) as file:
        assert file.variables["mesh2d"].cf_role == b"mesh_topology"
        assert file.variables["projected_coordinate_system"].crs_wkt.decode() == wkt
        assert (file.variables["mesh2d_face_nodes"][:] - 1 == mesh.faces).all()
        assert (file.variables["mesh2d_node_z"][:] == mesh.nodes_m[:, 2]).all()


def test_selafin_and_its_boundary_are_read_back(mesh, river, tmp_path):  # noqa: F811
    s = river.to_flow(mesh.nodes_m[:, :2])[0]
    ends = [np.flatnonzero(s < s.min() + 0.1), np.flatnonzero(s > s.max() - 0.1)]
    write_selafin(tmp_path / "r.slf", tmp_path / "r.cli", mesh, inflow=ends[0], outflow=ends[1])
    data, at, records = (tmp_path / "r.slf").read_bytes(), 0, []
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        records.append(data[at + 4 : at + 4 + size])
        assert data[at + 4 + size : at + 8 + size] == data[at : at + 4]
        at += size + 8
    assert records[0].endswith(b"SERAFIN ")
    flags, size = np.frombuffer(records[3], ">i4"), np.frombuffer(records[4], ">i4")
    assert size[:3].tolist() == [len(mesh.faces), len(mesh.nodes_m), 3]
    assert (np.frombuffer(records[5], ">i4").reshape(-1, 3) - 1 == mesh.faces).all()
    east = np.frombuffer(records[7], ">f4").astype(float) + float(flags[2])
    assert east == pytest.approx(mesh.nodes_m[:, 0], abs=1e-3)
    assert np.frombuffer(records[10], ">f4") == pytest.approx(mesh.nodes_m[:, 2], abs=1e-4)
    rows = [line.split() for line in (tmp_path / "r.cli").read_text().split("\n") if line]
    assert len(rows) == (np.frombuffer(records[6], ">i4") > 0).sum()
    assert {" ".join(r[:3]) for r in rows} == {"2 2 2", "4 5 5", "5 4 4"}
