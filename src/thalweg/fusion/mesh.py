"""Triangles for hydraulic models: rows across the river, with banks, toes and thalweg as edges.

Nodes stand in rows across the flow line; between two neighbouring lines (bank, toe, thalweg) a row has as
many as its width asks for, and the strip between two rows is closed by the shorter diagonal. Where two
lines come closer than half an edge they become one. What is left of small angles and of folds on the inner
side of bends goes by collapsing the shortest edge of such a triangle, as long as that makes no smaller
angle.
"""

import struct
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from thalweg.core import ArrayF, ArrayI, GeometryError
from thalweg.fusion.dtm import Dtm
from thalweg.fusion.river import River
from thalweg.settings.sections import MeshSettings

LINES: Final = ("right bank", "right toe", "thalweg", "left toe", "left bank")
_ROUNDS: Final = 60
_BESIDE: Final = 2.0
"""A node without a height takes that of a cell within so many cells."""
_TOE_SHARE: Final = 0.8
"""A toe stands where so much of the depth of the thalweg is reached."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RiverMesh:
    """Triangles over the bed.

    Parameters
    ----------
    nodes_m : (n, 3) in the map grid and the heights of the model.
    faces : (m, 3) against the clock seen from above.
    lines : name of a line -> nodes along it, downstream.
    """

    nodes_m: ArrayF
    faces: ArrayI
    lines: dict[str, ArrayI]

    def least_angles_deg(self) -> ArrayF:
        """Smallest angle (m,) of each triangle; negative for a folded one."""
        return least_angles_deg(self.nodes_m[:, :2], self.faces)

    def boundary(self) -> ArrayI:
        """Nodes (b,) of the outer border, against the clock, each once.

        Raises
        ------
        GeometryError : the border is not one ring.
        """
        edges = np.concatenate([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]])
        there = {(int(a), int(b)) for a, b in edges}
        following: dict[int, int] = {a: b for a, b in there if (b, a) not in there}
        start = min(following)
        ring, at = [start], following[start]
        while at != start and len(ring) <= len(following):
            ring.append(at)
            at = following[at]
        if len(ring) != len(following):
            raise GeometryError("a mesh with islands or in pieces", expected="one ring of border edges")
        return np.array(ring)


def least_angles_deg(places_m: ArrayF, faces: ArrayI) -> ArrayF:
    """Smallest angle (m,) of triangles in plan; negative for those that turn with the clock."""
    p = places_m[faces]
    angles = []
    for k in range(3):
        a, b = p[:, (k + 1) % 3] - p[:, k], p[:, (k + 2) % 3] - p[:, k]
        cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        angles.append(np.rad2deg(np.arctan2(cross, np.sum(a * b, axis=1))))
    return np.asarray(np.min(angles, axis=0))


def mesh_river(model: Dtm, river: River, settings: MeshSettings) -> RiverMesh:
    """Mesh between the banks.

    Raises
    ------
    GeometryError : the river is narrower than an edge, or no mesh with the wanted angles was found.
    """
    edge, (first, last) = settings.edge_m, river.span_m
    # a cell inside both ends: beyond them the model has no height
    margin = min(model.cell_m, (last - first) / 10)
    rows = np.linspace(first + margin, last - margin, max(round((last - first) / edge), 2) + 1)
    offsets = _line_offsets(model, river, rows, edge)
    n_of, line_of = [], []
    for at in offsets:
        n, line = [at[0]], [0]
        for a, b in pairwise(at):
            k = round(float(b - a) / edge) if b - a > 0 else 0
            k = max(k, 1) if b - a >= edge / 2 else 0
            n += [a + (b - a) * i / k for i in range(1, k + 1)]
            line.append(len(n) - 1)
        n_of.append(np.array(n))
        line_of.append(line)
    start = np.concatenate([[0], np.cumsum([len(n) for n in n_of])])
    places = river.to_map(np.repeat(rows, np.diff(start)), np.concatenate(n_of))
    faces: list[tuple[int, int, int]] = []
    for i in range(len(rows) - 1):
        for k in range(len(LINES) - 1):
            one = range(start[i] + line_of[i][k], start[i] + line_of[i][k + 1] + 1)
            two = range(start[i + 1] + line_of[i + 1][k], start[i + 1] + line_of[i + 1][k + 1] + 1)
            faces += _strip(places, list(one), list(two))
    lines = {
        name: np.array([start[i] + line_of[i][k] for i in range(len(rows))]) for k, name in enumerate(LINES)
    }
    held = np.zeros(len(places), np.int64)
    for nodes in lines.values():
        held[nodes] += 1
    for end in (range(start[0], start[1]), range(start[-2], start[-1])):
        held[list(end)] += 2
    mesh, lines = _improved(places, np.array(faces), lines, held, settings.least_angle_deg)
    places, triangles = mesh
    worst = float(least_angles_deg(places, triangles).min())
    if worst < settings.least_angle_deg:
        raise GeometryError(
            f"the best mesh has an angle of {worst:.1f} degrees",
            expected=f"at least fusion.mesh.least_angle_deg = {settings.least_angle_deg:g}",
            cure="Take another fusion.mesh.edge_m, or a smoother centre line",
        )
    height = model.at(places)[0]
    empty = np.flatnonzero(~np.isfinite(height))
    if len(empty):
        # the corner of the water line may lie just outside the last cell with a height
        known = np.isfinite(model.height_m)
        away, near = cKDTree(model.centres_m()[known]).query(places[empty])
        near_enough = away <= _BESIDE * model.cell_m
        height[empty[near_enough]] = model.height_m[known][np.asarray(near)[near_enough]]
    if not np.isfinite(height).all():
        raise GeometryError(
            f"{int((~np.isfinite(height)).sum())} nodes without a height",
            expected="a model that is watertight between the banks",
        )
    return RiverMesh(nodes_m=np.column_stack([places, height]), faces=triangles, lines=lines)


def _line_offsets(model: Dtm, river: River, rows: ArrayF, edge: float) -> ArrayF:
    """Offsets (rows, 5) of right bank, right toe, thalweg, left toe, left bank, in this order across."""
    left, right = (gaussian_filter1d(side, 1.0) for side in river.offsets_m(rows))
    if (left - right < edge).any():
        raise GeometryError(
            f"a river of {float((left - right).min()):.1f} m width",
            expected=f"at least one edge of {edge:g} m",
            cure="Take a smaller fusion.mesh.edge_m",
        )
    share = np.linspace(0.05, 0.95, 37)
    n = right[:, None] + (left - right)[:, None] * share
    height = model.at(river.to_map(np.repeat(rows, len(share)), n.ravel()))[0].reshape(n.shape)
    height = np.where(np.isfinite(height), height, np.nanmax(height))
    lowest = height.argmin(axis=1)
    top = river.level_m(rows)
    wet = height <= (top - _TOE_SHARE * (top - height.min(axis=1)))[:, None]
    middle, toe_right, toe_left = (
        share[lowest],
        share[wet.argmax(axis=1)],
        share[::-1][wet[:, ::-1].argmax(axis=1)],
    )
    width = left - right
    found = [np.zeros(len(rows)), toe_right, middle, toe_left, np.ones(len(rows))]
    smooth = [gaussian_filter1d(f, 3.0) for f in found]
    at: ArrayF = right[:, None] + width[:, None] * np.sort(np.stack(smooth, axis=1), axis=1)
    # lines closer than half an edge become one: the toe joins the bank, or the thalweg
    for k, neighbour in ((1, 0), (3, 4), (1, 2), (3, 2)):
        close = np.abs(at[:, k] - at[:, neighbour]) < 0.75 * edge
        at[close, k] = at[close, neighbour]
    for side in (0, 4):
        close = np.abs(at[:, 2] - at[:, side]) < 0.75 * edge
        at[close, 1:4] = at[close, side][:, None]
    return at


def _strip(p: ArrayF, one: list[int], two: list[int]) -> list[tuple[int, int, int]]:
    """Triangles between two rows of nodes (both from right to left, the second downstream)."""
    out, i, j = [], 0, 0
    while i < len(one) - 1 or j < len(two) - 1:
        first = j == len(two) - 1 or (
            i < len(one) - 1
            and np.sum((p[one[i + 1]] - p[two[j]]) ** 2) <= np.sum((p[one[i]] - p[two[j + 1]]) ** 2)
        )
        if first:
            out.append((one[i], two[j], one[i + 1]))
            i += 1
        else:
            out.append((one[i], two[j], two[j + 1]))
            j += 1
    return out


def _improved(
    places: ArrayF, faces: ArrayI, lines: dict[str, ArrayI], held: ArrayI, least_deg: float
) -> tuple[tuple[ArrayF, ArrayI], dict[str, ArrayI]]:
    """Collapse shortest edges of triangles that are folded or too sharp."""
    merged = np.arange(len(places))
    for _ in range(_ROUNDS):
        angle = least_angles_deg(places, faces)
        bad = np.flatnonzero(angle < least_deg)
        if not len(bad):
            break
        touched: set[int] = set()
        changed = False
        for f in bad[np.argsort(angle[bad])]:
            corners = faces[f].tolist()
            if touched & set(corners):
                continue
            edges = sorted(
                ((corners[k], corners[(k + 1) % 3]) for k in range(3)),
                key=lambda e: float(np.sum((places[e[0]] - places[e[1]]) ** 2)),
            )
            for a, b in edges:
                keep, drop = (a, b) if held[a] >= held[b] else (b, a)
                around = np.flatnonzero((faces == drop).any(axis=1))
                new = np.where(faces[around] == drop, keep, faces[around])
                new = new[(new[:, 0] != new[:, 1]) & (new[:, 1] != new[:, 2]) & (new[:, 2] != new[:, 0])]
                before = float(angle[around].min())
                if len(new) and float(least_angles_deg(places, new).min()) <= before:
                    continue
                faces = np.where(faces == drop, keep, faces)
                merged = np.where(merged == drop, keep, merged)
                held[keep] = max(held[keep], held[drop])
                touched |= set(new.ravel().tolist()) | {keep, drop}
                changed = True
                break
        whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
        faces = faces[whole]
        if not changed:
            break
    used, packed = np.unique(faces, return_inverse=True)
    number = np.full(len(places), -1)
    number[used] = np.arange(len(used))
    kept = {}
    for name, nodes in lines.items():
        at = number[merged[nodes]]
        kept[name] = at[np.concatenate([[True], at[1:] != at[:-1]])]
    return (places[used], packed.reshape(-1, 3)), kept


# ---------------------------------------------------------------- files


def write_2dm(path: Path, mesh: RiverMesh) -> None:
    """Mesh of SMS (2dm): ND, E3T, node strings of the lines; numbers from 1."""
    out = ["MESH2D", 'MESHNAME "river"']
    out += [f"E3T {i} {a + 1} {b + 1} {c + 1} 1" for i, (a, b, c) in enumerate(mesh.faces.tolist(), start=1)]
    out += [f"ND {i} {x:.4f} {y:.4f} {z:.4f}" for i, (x, y, z) in enumerate(mesh.nodes_m.tolist(), start=1)]
    for nodes in mesh.lines.values():
        numbers = (nodes + 1).tolist()
        numbers[-1] = -numbers[-1]
        out.append("NS " + " ".join(map(str, numbers)))
    path.write_text("\n".join([*out, ""]))


def write_selafin(path: Path, boundary: Path, mesh: RiverMesh, *, inflow: ArrayI, outflow: ArrayI) -> None:
    """Geometry and boundary of TELEMAC-2D (SERAFIN, single precision, big endian; ``.cli``).

    Nodes of the inflow get a given discharge (4 5 5), of the outflow a given level (5 4 4), others are solid.
    Coordinates are counted from a whole kilometre, which the file states (I_ORIG, J_ORIG): single precision
    has seven digits.
    """
    origin = np.floor(mesh.nodes_m[:, :2].min(axis=0) / 1000) * 1000
    ring = mesh.boundary()
    rank = np.zeros(len(mesh.nodes_m), np.int32)
    rank[ring] = np.arange(1, len(ring) + 1)
    flags = [1, 0, int(origin[0]), int(origin[1]), 0, 0, 0, 0, 0, 0]
    size = [len(mesh.faces), len(mesh.nodes_m), 3, 1]

    def record(data: bytes) -> bytes:
        """A Fortran record: its length before and after it."""
        mark = struct.pack(">i", len(data))
        return mark + data + mark

    def integers(values: Any) -> bytes:
        """A record of 32-bit integers, big-endian."""
        return record(np.asarray(values, ">i4").tobytes())

    def numbers(values: Any) -> bytes:
        """A record of 32-bit floats, big-endian."""
        return record(np.asarray(values, ">f4").tobytes())

    path.write_bytes(
        b"".join(
            [
                record(b"Thalweg".ljust(72) + b"SERAFIN "),
                integers([1, 0]),
                record(b"BOTTOM".ljust(16) + b"M".ljust(16)),
                integers(flags),
                integers(size),
                integers(mesh.faces + 1),
                integers(rank),
                numbers(mesh.nodes_m[:, 0] - origin[0]),
                numbers(mesh.nodes_m[:, 1] - origin[1]),
                numbers([0.0]),
                numbers(mesh.nodes_m[:, 2]),
            ]
        )
    )
    codes = {**dict.fromkeys(inflow.tolist(), "4 5 5"), **dict.fromkeys(outflow.tolist(), "5 4 4")}
    rows = [
        f"{codes.get(int(node), '2 2 2')} 0.0 0.0 0.0 0.0 2 0.0 0.0 0.0 {node + 1} {i}"
        for i, node in enumerate(ring.tolist(), start=1)
    ]
    boundary.write_text("\n".join([*rows, ""]))


def write_ugrid(path: Path, mesh: RiverMesh, *, crs_wkt: str) -> None:
    """Mesh as NetCDF 3 by the UGRID conventions 1.0 (Delft3D FM and others)."""
    from scipy.io import netcdf_file

    file: Any
    with netcdf_file(str(path), "w") as file:
        file.Conventions = "CF-1.8 UGRID-1.0"
        file.createDimension("node", len(mesh.nodes_m))
        file.createDimension("face", len(mesh.faces))
        file.createDimension("three", 3)
        topology = file.createVariable("mesh2d", "i", ())
        topology.data[()] = 0
        topology.cf_role, topology.topology_dimension = "mesh_topology", 2
        topology.node_coordinates, topology.face_node_connectivity = (
            "mesh2d_node_x mesh2d_node_y",
            "mesh2d_face_nodes",
        )
        grid = file.createVariable("projected_coordinate_system", "i", ())
        grid.data[()] = 0
        # areas of use are written with a degree sign; NetCDF's text is UTF-8
        grid.crs_wkt = crs_wkt.encode()
        for name, words, values in (
            ("x", "projection_x_coordinate", mesh.nodes_m[:, 0]),
            ("y", "projection_y_coordinate", mesh.nodes_m[:, 1]),
            ("z", "altitude", mesh.nodes_m[:, 2]),
        ):
            column = file.createVariable(f"mesh2d_node_{name}", "d", ("node",))
            column[:] = values
            column.standard_name, column.units, column.mesh, column.location = words, "m", "mesh2d", "node"
            column.grid_mapping = "projected_coordinate_system"
        faces = file.createVariable("mesh2d_face_nodes", "i", ("face", "three"))
        faces[:] = mesh.faces + 1
        faces.cf_role, faces.start_index = "face_node_connectivity", 1
