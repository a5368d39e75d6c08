"""Sections, terrain and triangles for hydraulic programs: HEC-RAS, SWMM, CSV, BAG, meshes.

Sources: HEC-RAS User's Manual 6.6, "RAS GIS Import File (RASImport.sdf)", keywords of its header table;
Storm Water Management Model User's Manual 5.1, appendix D.2, section [TRANSECTS].

**Triangles** have banks, toes and thalweg as edges. Nodes stand in rows across the flow line; between two
neighbouring lines (bank, toe, thalweg) a row has as many as its width asks for, and the strip between two
rows is closed by the shorter diagonal. Where two lines come closer than half an edge they become one. What is
left of small angles and of folds on the inner side of bends goes by collapsing the shortest edge of such a
triangle, as long as that makes no smaller angle.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from thalweg.core import ArrayB, ArrayF, ArrayI, GeometryError, InputError, ThalwegError
from thalweg.fusion.dtm import Dtm, cells_inside
from thalweg.fusion.measures import UNTOLD_LENGTH_M, Section, volume_below
from thalweg.fusion.river import River
from thalweg.settings.sections import Fusion, MeshSettings

# ---------------------------------------------------------------- triangles

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


# ---------------------------------------------------------------- exports

_OF_MESH = ("2dm", "selafin", "ugrid")
_OF_SECTIONS = {"hecras", "swmm", "csv"}
_SWMM_MOST_POINTS = 1500
"""SWMM 5 takes no more stations in a transect."""


def export_river(
    folder: Path, model: Dtm, river: River, sections: Sequence[Section], settings: Fusion
) -> dict[str, Any]:
    """Files of `fusion.exports` for other programs.

    Parameters
    ----------
    folder : where they go; it is made.
    model, river, sections : what they hold.

    Returns
    -------
    facts : ``written`` (names), ``not_written`` (format -> why), and of the mesh nodes, faces, least angle.
    """
    folder.mkdir(parents=True, exist_ok=True)
    writers: dict[str, Callable[[], object]] = {
        "hecras": lambda: write_hecras(folder / "RASImport.sdf", sections, river),
        "swmm": lambda: write_swmm(folder / "transects.inp", sections, settings),
        "csv": lambda: write_csv(folder / "sections.csv", sections),
        "bag": lambda: write_bag(folder / "terrain.bag", model),
    }
    facts: dict[str, Any] = {"not_written": {}}
    if not sections:
        facts["not_written"] |= dict.fromkeys(_OF_SECTIONS & set(settings.exports), "no cross section")
    wanted = [name for name in settings.exports if name in _OF_MESH]
    if wanted:
        try:
            mesh = mesh_river(model, river, settings.mesh)
        except ThalwegError as error:
            # sections are of use without a mesh
            facts["not_written"] |= dict.fromkeys(wanted, str(error))
        else:
            angles = mesh.least_angles_deg()
            facts["mesh"] = {
                "nodes": len(mesh.nodes_m),
                "faces": len(mesh.faces),
                "least_angle_deg": float(angles.min()),
                "folded": int((angles <= 0).sum()),
            }
            border = mesh.boundary()
            along = river.to_flow(mesh.nodes_m[border, :2])[0]
            inflow = border[along < along.min() + settings.mesh.edge_m / 4]
            outflow = border[along > along.max() - settings.mesh.edge_m / 4]
            writers |= {
                "2dm": lambda: write_2dm(folder / "mesh.2dm", mesh),
                "selafin": lambda: write_selafin(
                    folder / "mesh.slf", folder / "mesh.cli", mesh, inflow=inflow, outflow=outflow
                ),
                "ugrid": lambda: write_ugrid(folder / "mesh.nc", mesh, crs_wkt=model.crs.to_wkt()),
            }
    for name in settings.exports:
        if name in facts["not_written"]:
            continue
        try:
            writers[name]()
        except ThalwegError as error:
            facts["not_written"][name] = str(error)
    return facts | {"written": sorted(path.name for path in folder.iterdir())}


def water_of(
    model: Dtm, river: River, settings: Fusion, *, correlation_m: float | None = None
) -> tuple[ArrayB, dict[str, float]]:
    """Cells (rows, columns) inside the water line, and volume and area of the water with its sigma.

    Parameters
    ----------
    model, river : what is measured.
    settings : length of correlation of errors, if it is stated.
    correlation_m : that of the bed over an area; None: 5 m.
    """
    inside = cells_inside(river.outline_m(), model.corner_m, model.cell_m, model.height_m.shape)
    level = np.full(model.height_m.shape, np.nan)
    level[inside] = river.level_m(river.to_flow(model.centres_m()[inside])[0])
    volume, sigma, area = volume_below(
        model, level, inside, settings.correlation_m or correlation_m or UNTOLD_LENGTH_M
    )
    empty = inside & ~np.isfinite(model.height_m)
    return inside, {
        "volume_m3": volume,
        "sigma_volume_m3": sigma,
        "wet_area_m2": area,
        "inside_m2": float(inside.sum()) * model.cell_m**2,
        "without_height_m2": float(empty.sum()) * model.cell_m**2,
    }


def write_csv(path: Path, sections: Sequence[Section]) -> None:
    """Points of all sections: s, n, east, north, height, sigma, water level; heights with three digits."""
    parts = [
        pd.DataFrame(
            {
                "s_m": section.s_m,
                "n_m": section.n_m,
                "east_m": section.places_m[:, 0],
                "north_m": section.places_m[:, 1],
                "height_m": section.height_m,
                "sigma_m": section.sigma_m,
                "level_m": section.level_m,
            }
        )[np.isfinite(section.height_m)]
        for section in sections
    ]
    pd.concat(parts).to_csv(path, index=False, float_format="%.4f")


def write_hecras(path: Path, sections: Sequence[Section], river: River, *, name: str = "River") -> None:
    """Geometry of a river for HEC-RAS (``RASImport.sdf``): centre line and cut lines, from left to right.

    Stations count from the lower end upstream, as HEC-RAS wants them; cut lines begin at the left bank as one
    looks downstream.
    """
    ordered = sorted(sections, key=lambda section: section.s_m)
    length = river.flow.length_m
    line = river.to_map(np.linspace(0, length, max(int(length / 5) + 1, 2)), 0.0)
    places = np.concatenate([line, *(section.places_m for section in ordered)])
    low, high = places.min(axis=0), places.max(axis=0)
    zone = river.crs.utm_zone
    out = [
        "BEGIN HEADER:",
        "UNITS: METRIC",
        "DTM TYPE: GRID",
        "DTM: dtm.tif",
        "STREAM LAYER: centre line",
        "CROSS-SECTION LAYER: sections",
        f"MAP PROJECTION: {'UTM' if zone else river.crs.name}",
        f"PROJECTION ZONE: {zone[:-1] if zone else ''}",
        f"DATUM: {river.crs.geodetic_crs.name if river.crs.geodetic_crs else ''}",
        f"VERTICAL DATUM: {'ELLIPSOIDAL' if not any(river.separation) else 'ORTHOMETRIC'}",
        "NUMBER OF REACHES: 1",
        f"NUMBER OF CROSS-SECTIONS: {len(ordered)}",
        "BEGIN SPATIAL EXTENT:",
        f"XMIN: {low[0]:.3f}", f"YMIN: {low[1]:.3f}", f"XMAX: {high[0]:.3f}", f"YMAX: {high[1]:.3f}",
        "END SPATIAL EXTENT:",
        "END HEADER:",
        "",
        "BEGIN STREAM NETWORK:",
        f"ENDPOINT: {line[0, 0]:.3f}, {line[0, 1]:.3f}, 0, 1",
        f"ENDPOINT: {line[-1, 0]:.3f}, {line[-1, 1]:.3f}, 0, 2",
        "REACH:",
        f"STREAM ID: {name}",
        "REACH ID: Reach",
        "FROM POINT: 1",
        "TO POINT: 2",
        "CENTERLINE:",
        *(f"{x:.3f}, {y:.3f}, 0, 0" for x, y in line),
        "END:",
        "END STREAM NETWORK:",
        "",
        "BEGIN CROSS-SECTIONS:",
    ]  # fmt: skip
    for i, section in enumerate(ordered):
        known = np.isfinite(section.height_m)
        n, xy, z = (a[known][::-1] for a in (section.n_m, section.places_m, section.height_m))
        width = n[0] - n[-1]
        bank = [float((n[0] - offset) / width) for offset in (section.left_m, section.right_m)]
        ahead = ordered[i + 1].s_m - section.s_m if i + 1 < len(ordered) else 0.0
        out += [
            "CROSS-SECTION:",
            f"STREAM ID: {name}",
            "REACH ID: Reach",
            f"STATION: {length - section.s_m:.2f}",
            f"BANK POSITIONS: {bank[0]:.5f}, {bank[1]:.5f}",
            f"REACH LENGTHS: {ahead:.2f}, {ahead:.2f}, {ahead:.2f}",
            "CUT LINE:",
            *(f"{x:.3f}, {y:.3f}" for x, y in (xy[0], xy[-1])),
            "SURFACE LINE:",
            *(f"{x:.3f}, {y:.3f}, {h:.3f}" for (x, y), h in zip(xy, z, strict=True)),
            "END:",
        ]
    path.write_text("\n".join([*out, "END CROSS-SECTIONS:", ""]))


def write_swmm(path: Path, sections: Sequence[Section], settings: Fusion) -> None:
    """Transects of SWMM: NC, X1, GR lines; stations from the left end as one looks downstream."""
    rough = settings.sections.manning
    out = ["[TRANSECTS]", ";;Transect data in HEC-2 format", ""]
    for section in sections:
        known = np.flatnonzero(np.isfinite(section.height_m))[::-1]
        if len(known) > _SWMM_MOST_POINTS:
            known = known[np.unique(np.linspace(0, len(known) - 1, _SWMM_MOST_POINTS).astype(int))]
        n, z = section.n_m[known], section.height_m[known]
        station = n[0] - n
        left, right = n[0] - section.left_m, n[0] - section.right_m
        pairs = [f"{h:.3f} {x:.3f}" for h, x in zip(z, station, strict=True)]
        out += [
            f"NC {rough:g} {rough:g} {rough:g}",
            f"X1 S{section.s_m:.1f} {len(pairs)} {left:.3f} {right:.3f} 0 0 0 0 0",
            *("GR " + " ".join(pairs[i : i + 5]) for i in range(0, len(pairs), 5)),
            "",
        ]
    path.write_text("\n".join(out))


def contour_lines(height_m: ArrayF, centres_m: ArrayF, interval_m: float) -> list[tuple[float, ArrayF]]:
    """Contours of heights (rows, columns): height and vertices (k, 2) in the map grid.

    Parameters
    ----------
    centres_m : (rows, columns, 2) of the cells.
    """
    from contourpy import contour_generator

    known = np.isfinite(height_m)
    low, high = float(height_m[known].min()), float(height_m[known].max())
    drawn = contour_generator(
        x=centres_m[0, :, 0], y=centres_m[:, 0, 1], z=np.ma.masked_array(height_m, ~known)
    )
    levels = np.arange(np.ceil(low / interval_m), np.floor(high / interval_m) + 1) * interval_m
    lines: Any = [(float(level), drawn.lines(float(level))) for level in levels]
    return [(level, np.asarray(line)) for level, of_level in lines for line in of_level]


def write_bag(path: Path, model: Dtm) -> None:
    """Elevation and uncertainty as Bathymetric Attributed Grid (by GDAL's driver).

    Raises
    ------
    InputError : GDAL was built without the driver, or cannot write the file.
    """
    import rasterio
    from rasterio import Affine
    from rasterio.errors import RasterioError
    from rasterio.shutil import copy

    with rasterio.Env() as env:
        able = "BAG" in env.drivers()
    if not able:
        raise InputError(
            "GDAL without the driver BAG", expected="GDAL built with HDF5", where=path,
            cure="Leave bag out of fusion.exports; dtm.tif holds the same heights and sigmas",
        )  # fmt: skip
    nodata, (rows, columns) = 1_000_000.0, model.height_m.shape
    bands = [np.where(np.isfinite(model.height_m), b, nodata) for b in (model.height_m, model.sigma_m)]
    place = Affine(model.cell_m, 0.0, model.corner_m[0], 0.0, -model.cell_m, model.corner_m[1])
    try:
        with rasterio.MemoryFile() as memory:
            with memory.open(
                driver="GTiff", width=columns, height=rows, count=2, dtype="float32", nodata=nodata,
                crs=model.crs.to_wkt(), transform=place,
            ) as file:  # fmt: skip
                for i, band in enumerate(bands, start=1):
                    file.write(band.astype(np.float32), i)
            with memory.open() as file:
                copy(file, str(path), driver="BAG")
    except (RasterioError, OSError) as wrong:
        raise InputError(
            f"cannot be written as BAG ({wrong})", expected="a writable file", where=path
        ) from wrong
