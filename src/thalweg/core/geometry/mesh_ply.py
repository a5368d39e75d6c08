"""Meshes as PLY files: written with their origin, and read again.

Binary little-endian; vertices double ``x y z`` and float ``sigma_m``, faces ``vertex_indices`` and uchar
``border``. Lines ``comment thalweg ...``, joined, are a JSON text with the origin of the world frame, the
version of the format, and the facts about the mesh. It is cut into short lines because readers built on rply
(Open3D, CloudCompare) refuse lines of more than a thousand characters.

Format: G. Turk, "The PLY Polygon File Format" (1994).
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core.errors import GeometryError, InputError
from thalweg.core.frames import LocalFrame
from thalweg.core.geometry.mesh import TriangleMesh
from thalweg.core.geometry.ply_header import PlyElement, read_ply_header
from thalweg.core.types import AnyArray, ArrayI

FORMAT: Final = 1

_LINE: Final = 200
_CURE: Final = "Build the mesh again with the rule mesh_reference"
_CORNERS: Final = ("vertex_indices", "vertex_index")


def write_mesh(path: Path, mesh: TriangleMesh, frame: LocalFrame, facts: Mapping[str, Any]) -> None:
    """Write a mesh; the file appears under its name only when it is complete.

    Parameters
    ----------
    path : target, ``.ply``.
    mesh : in wcs.
    frame : the world frame.
    facts : JSON-able facts about the mesh.

    Raises
    ------
    GeometryError : more vertices than PLY's 32-bit indices count.
    """
    if len(mesh.vertices_m) > np.iinfo(np.int32).max:
        raise GeometryError(f"{len(mesh.vertices_m):,} vertices", expected="fewer than 2^31", where=path)
    origin = {"lat_deg": frame.lat_deg, "lon_deg": frame.lon_deg, "h_ell_m": frame.h_ell_m}
    text = json.dumps({"format": FORMAT, "origin": origin, "facts": dict(facts)}, separators=(",", ":"))
    comments = [f"comment thalweg {text[i : i + _LINE]}" for i in range(0, len(text), _LINE)]
    vertices = np.empty(len(mesh.vertices_m), dtype=[(a, "<f8") for a in "xyz"] + [("sigma_m", "<f4")])
    for axis, name in enumerate("xyz"):
        vertices[name] = mesh.vertices_m[:, axis]
    vertices["sigma_m"] = mesh.sigma_m
    faces = np.empty(len(mesh.faces), dtype=[("n", "u1"), ("corners", "<i4", (3,)), ("border", "u1")])
    faces["n"], faces["corners"], faces["border"] = 3, mesh.faces, mesh.border_faces()
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *comments,
        f"element vertex {len(vertices)}",
        *(f"property double {name}" for name in "xyz"),
        "property float sigma_m",
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "property uchar border",
        "end_header",
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.partial")
    with partial.open("wb") as stream:
        stream.write(("\n".join(header) + "\n").encode("ascii"))
        vertices.tofile(stream)
        faces.tofile(stream)
    partial.replace(path)


def read_mesh(path: Path) -> tuple[TriangleMesh, LocalFrame, dict[str, Any]]:
    """A mesh written by `write_mesh`, its world frame, and its facts.

    Raises
    ------
    InputError : no PLY, damaged, of another format version, or of another program.
    """
    vertices, faces, told = _read(path)
    try:
        mesh = TriangleMesh(
            vertices_m=np.stack([vertices[a].astype(np.float64) for a in "xyz"], axis=-1),
            faces=faces,
            sigma_m=vertices["sigma_m"].astype(np.float64),
        )
    except GeometryError as error:
        raise InputError(error.found, expected=error.expected, where=path, cure=_CURE) from error
    return mesh, LocalFrame(**told["origin"]), told["facts"]


def _read(path: Path) -> tuple[AnyArray, ArrayI, dict[str, Any]]:
    if not path.is_file():
        raise InputError("file not found", expected="a mesh (PLY)", where=path)
    header = read_ply_header(path, cure=_CURE)
    form, elements = header.form, header.elements
    names = [e.name for e in elements]
    if names.count("vertex") != 1 or names.count("face") != 1:
        raise InputError(
            f"elements {names}", expected="vertices and faces: a mesh, not a cloud", where=path, cure=_CURE
        )
    vertex, face = elements[names.index("vertex")], elements[names.index("face")]
    if not {"x", "y", "z"} <= set(vertex.names) or not set(face.lists) & set(_CORNERS):
        raise InputError(
            f"vertices with {vertex.names}, faces with {face.names}",
            expected="x, y, z and vertex_indices",
            where=path,
            cure=_CURE,
        )
    told = _told(header.comments, path)
    if told is None:
        raise InputError(
            "a mesh of another program: it does not say in which frame it is",
            expected="the comment 'thalweg' with the origin of the world frame",
            where=path,
            cure=_CURE,
        )
    own = form == "binary_little_endian" and names[:2] == ["vertex", "face"] and not vertex.lists
    if not own or len(face.lists) != 1 or "sigma_m" not in set(vertex.names):
        raise InputError(
            f"{form}, elements {names}, vertices with {vertex.names}",
            expected="binary_little_endian, vertices with sigma_m, then faces",
            where=path,
            cure=_CURE,
        )
    return *_triangles(path, header.end, vertex, face), told


def _told(comments: list[str], path: Path) -> dict[str, Any] | None:
    text = "".join(line.removeprefix("thalweg ") for line in comments if line.startswith("thalweg "))
    if not text:
        return None
    try:
        told = json.loads(text)
        version = told["format"]
        LocalFrame(**told["origin"])
        if version == FORMAT and isinstance(told["facts"], dict):
            return dict(told)
    except (ValueError, KeyError, TypeError, GeometryError) as error:
        raise InputError(
            f"the comment 'thalweg' is damaged ({error})", expected="JSON", where=path, cure=_CURE
        ) from error
    raise InputError(
        f"a mesh of format version {version}", expected=f"version {FORMAT}", where=path, cure=_CURE
    )


def _triangles(path: Path, start: int, vertex: PlyElement, face: PlyElement) -> tuple[AnyArray, ArrayI]:
    """Vertices and faces of a file whose faces are all triangles."""
    v_type, f_type = vertex.dtype("<", 3), face.dtype("<", 3)
    room = path.stat().st_size - start
    needed = vertex.count * v_type.itemsize
    if room < needed:
        raise _cut(path, f"{room // v_type.itemsize:,} of {vertex.count:,} vertices")
    vertices = np.fromfile(path, v_type, count=vertex.count, offset=start)
    table = np.fromfile(path, f_type, count=face.count, offset=start + needed)
    name = face.lists[0]
    if not (table[f"n of {name}"] == 3).all():
        raise InputError("faces that are no triangles", expected="triangles", where=path, cure=_CURE)
    if len(table) < face.count:
        raise _cut(path, f"{len(table):,} of {face.count:,} faces")
    return vertices, np.ascontiguousarray(table[name], dtype=np.int64)


def _cut(path: Path, there: str) -> InputError:
    return InputError(
        f"the file is cut: {there} are there", expected="as many as its header says", where=path, cure=_CURE
    )
