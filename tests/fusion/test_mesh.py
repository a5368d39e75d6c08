"""Triangles: sharp angles and folds there are none, and each file is read back."""

import numpy as np
import py2dm
import pytest
from pyproj import CRS
from scipy.io import netcdf_file

from tests.fusion.test_measures_and_exports import model, river  # noqa: F401
from thalweg.core import GeometryError
from thalweg.fusion.exports import (
    _improved,
    export_river,
    least_angles_deg,
    mesh_river,
    water_of,
    write_2dm,
    write_selafin,
    write_ugrid,
)
from thalweg.settings.sections import Fusion, MeshSettings


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


def test_a_sharp_triangle_is_collapsed_onto_the_corner_that_is_held():
    """A square with a node just above its southern edge: it goes to a corner, or the corner to it."""
    places = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.02]])
    faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    lines = {"south": np.array([0, 4, 1]), "north": np.array([3, 2])}
    corners = np.array([2, 2, 2, 2, 0])
    (found, left), kept = _improved(places, faces, lines, corners.copy(), 20.0)
    assert found.tolist() == places[:4].tolist()
    assert sorted(sorted(f) for f in left.tolist()) == [[0, 1, 3], [1, 2, 3]]
    assert least_angles_deg(found, left) == pytest.approx([45.0, 45.0])
    assert {name: nodes.tolist() for name, nodes in kept.items()} == {"south": [0, 1], "north": [3, 2]}
    (found, left), kept = _improved(places, faces, lines, np.array([2, 2, 2, 2, 3]), 20.0)
    assert found.tolist() == places[[0, 2, 3, 4]].tolist()
    assert sorted(sorted(f) for f in left.tolist()) == [[0, 2, 3], [1, 2, 3]]
    assert {name: nodes.tolist() for name, nodes in kept.items()} == {"south": [0, 3], "north": [2, 1]}
    # sharp as it is, it stays where less is wanted
    for least, n in ((2.2, 4), (2.4, 2)):  # atan(0.02 / 0.5) = 2.29 degrees
        assert len(_improved(places, faces, lines, corners.copy(), least)[0][1]) == n
    # a triangle that would fold over others is not helped: all stays
    flat = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.02], [0.5, -0.02]])
    (found, left), _ = _improved(flat, np.array([[0, 1, 2], [1, 0, 3]]), {}, np.zeros(4), 20.0)
    assert len(found) in (0, 4)
    assert len(left) in (0, 2)


def test_exports_of_a_mesh_with_their_ends_and_numbers(model, river, tmp_path):  # noqa: F811
    """Nodes within a quarter of an edge of the first and last place are the inflow and the outflow."""
    settings = Fusion(exports=["2dm", "selafin", "ugrid"], mesh={"edge_m": 1.5})
    facts = export_river(tmp_path / "e", model, river, [], settings)
    mesh = mesh_river(model, river, settings.mesh)
    angles = mesh.least_angles_deg()
    assert facts == {
        "not_written": {},
        "mesh": {
            "nodes": len(mesh.nodes_m),
            "faces": len(mesh.faces),
            "least_angle_deg": angles.min(),
            "folded": 0,
        },
        "written": ["mesh.2dm", "mesh.cli", "mesh.nc", "mesh.slf"],
    }
    border = mesh.boundary()
    s = river.to_flow(mesh.nodes_m[:, :2])[0]
    first, last = s[border].min(), s[border].max()
    rows = [line.split() for line in (tmp_path / "e/mesh.cli").read_text().splitlines()]
    assert [int(row[11]) - 1 for row in rows] == border.tolist()
    for row, node in zip(rows, border, strict=True):
        kind = "4 5 5" if s[node] < first + 0.375 else "5 4 4" if s[node] > last - 0.375 else "2 2 2"
        assert " ".join(row[:3]) == kind
    # a mesh that cannot be leaves the sections
    facts = export_river(tmp_path / "f", model, river, [], Fusion(exports=["2dm"], mesh={"edge_m": 20.0}))
    assert list(facts["not_written"]) == ["2dm"]
    assert "width" in facts["not_written"]["2dm"]
    assert facts["written"] == []


def test_volume_and_area_of_the_water_by_sums_over_cells(model, river):  # noqa: F811
    inside, facts = water_of(model, river, Fusion())
    centres = model.centres_m()
    s, n, _ = river.to_flow(centres.reshape(-1, 2))
    # the outline is a polygon through places 2 m apart: it cuts the arc by less than a cell
    sure = (np.abs(n) < 5.7) & (s > 0.3) & (s < river.flow.length_m - 0.3)
    assert inside.ravel()[sure].all()
    assert not inside.ravel()[np.abs(n) > 6.3].any()
    depth = river.level_m(s).reshape(inside.shape) - model.height_m
    wet = inside & (depth > 0)
    assert facts["volume_m3"] == pytest.approx(depth[wet].sum() * 0.25**2, rel=1e-6)
    assert facts["wet_area_m2"] == pytest.approx(wet.sum() * 0.25**2)
    assert facts["inside_m2"] == inside.sum() * 0.25**2
    assert facts["without_height_m2"] == (inside & np.isnan(model.height_m)).sum() * 0.25**2
    # errors that last over 10 m add up to more than those of 5 m, which is usual
    of_bed = water_of(model, river, Fusion(), correlation_m=10.0)[1]["sigma_volume_m3"]
    assert facts["sigma_volume_m3"] < of_bed
    stated = water_of(model, river, Fusion(correlation_m=10.0), correlation_m=3.0)[1]["sigma_volume_m3"]
    assert stated == of_bed
