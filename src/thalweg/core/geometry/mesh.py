"""Triangle meshes of surfaces, and their PLY files."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from thalweg.core import (
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayI,
    GeometryError,
    InputError,
    LocalFrame,
    njit,
    parse_json,
)

NO_FACE: Final = -1
"""Stands for the face on the other side of a border edge."""

FORMAT: Final = 1
_LINE: Final = 200
_CURE: Final = "Build the mesh again with the rule mesh_reference"
_CORNERS: Final = ("vertex_indices", "vertex_index")

ORDERS: Final = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
"""Formats, and the byte order of their numbers as numpy writes it."""
_TYPES: Final = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_HEAD_BYTES: Final = 1 << 20
_HUB: Final = 64
"""Edges at the hub of a fan: more are sorted by numpy, as every one against every other would be slow."""


@dataclass(slots=True)
class PlyElement:
    """An element; ``fields`` are names in small letters and types, of lists ``count type:item type``."""

    name: str
    count: int
    fields: list[tuple[str, str]]

    def dtype(self, order: str, corners: int = 0) -> np.dtype[Any]:
        """Type of a row whose lists all hold ``corners`` items."""
        parts: list[Any] = []
        for name, kind in self.fields:
            if ":" in kind:
                length, item = kind.split(":")
                parts += [(f"n of {name}", order + length), (name, order + item, (corners,))]
            else:
                parts.append((name, order + kind))
        return np.dtype(parts)

    @property
    def names(self) -> list[str]:
        """Names of all properties."""
        return [name for name, _ in self.fields]

    @property
    def lists(self) -> list[str]:
        """Names of the properties that are lists."""
        return [name for name, kind in self.fields if ":" in kind]


# ---------------------------------------------------------------- mesh


@dataclass(frozen=True, slots=True, kw_only=True)
class TriangleMesh:
    """A surface of triangles; the front is the side from which their corners run counter-clockwise.

    Parameters
    ----------
    vertices_m : (n, 3) wcs.
    faces : (m, 3) indices of corners.
    sigma_m : (n,) standard deviation of each vertex along the surface normal.

    Raises
    ------
    GeometryError : shapes do not fit, values are not finite, or a face refers to a missing vertex.
    """

    vertices_m: ArrayF
    faces: ArrayI
    sigma_m: ArrayF

    def __post_init__(self) -> None:
        v, f = self.vertices_m, self.faces
        if v.shape != (len(v), 3) or f.shape != (len(f), 3) or self.sigma_m.shape != (len(v),):
            raise GeometryError(
                f"vertices {v.shape}, faces {f.shape}, sigmas {self.sigma_m.shape}",
                expected="(n, 3), (m, 3) and (n,)",
            )
        if not (np.isfinite(v).all() and np.isfinite(self.sigma_m).all() and (self.sigma_m >= 0).all()):
            raise GeometryError("a mesh whose vertices or sigmas are not finite, or a negative sigma")
        if len(f) and (f.min() < 0 or f.max() >= len(v)):
            raise GeometryError(f"corners from {f.min()} to {f.max()}", expected=f"0 to {len(v) - 1}")

    def face_normals(self) -> ArrayF:
        """Unit normals (m, 3) to the front; zero for faces without area."""
        a, b, c = (self.vertices_m[self.faces[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        return np.asarray(np.divide(normal, length, out=np.zeros_like(normal), where=length > 0))

    def neighbours(self) -> ArrayI:
        """Face (m, 3) across the edge from corner k to corner k + 1, `NO_FACE` on a border.

        An edge of more than two faces counts as a border: its surface has no two sides there.
        """
        faces = np.ascontiguousarray(self.faces, dtype=np.int64)
        start, edge, other = _edges(faces, len(self.vertices_m))
        for v in np.flatnonzero(np.diff(start) > _HUB):
            part = slice(start[v], start[v + 1])
            order = np.argsort(other[part], kind="stable")
            edge[part], other[part] = edge[part][order], other[part][order]
        out = np.full(faces.shape, NO_FACE, dtype=np.int64)
        _join(start, edge, other, out)
        return out

    def border_faces(self) -> ArrayB:
        """Faces (m,) with at least one edge of their own alone, or shared by more than two."""
        return np.asarray((self.neighbours() == NO_FACE).any(axis=1))

    def areas_m2(self) -> ArrayF:
        """Areas (m,) of the faces."""
        a, b, c = (self.vertices_m[self.faces[:, k]] for k in range(3))
        return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)

    def part(self, keep: ArrayB) -> "TriangleMesh":
        """The faces for which ``keep`` (m,) is true, and the vertices that they need."""
        faces = self.faces[keep]
        used = np.zeros(len(self.vertices_m), dtype=np.bool_)
        used[faces] = True
        number = np.cumsum(used) - 1
        return TriangleMesh(vertices_m=self.vertices_m[used], faces=number[faces], sigma_m=self.sigma_m[used])

    def pieces(self) -> ArrayI:
        """Number (m,) of the connected piece of each face; faces are connected by a common edge."""
        across = self.neighbours()
        face, corner = np.nonzero(across != NO_FACE)
        links = coo_array(
            (np.ones(len(face), dtype=np.int8), (face, across[face, corner])), shape=(len(across),) * 2
        )
        return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)


@njit(cache=True, nogil=True, error_model="numpy")
def _edges(faces: ArrayI, n: int) -> tuple[ArrayI, ArrayI, ArrayI]:
    """Edges laid down at their lower corner: first of each corner, number of each edge, its other corner.

    A corner has some six edges, so few need to be sorted: 5 million faces take well below a second, a sort of
    their 15 million edges several.
    """
    m = len(faces)
    start = np.zeros(n + 1, dtype=np.int64)
    for f in range(m):
        for k in range(3):
            start[min(faces[f, k], faces[f, (k + 1) % 3]) + 1] += 1
    for v in range(n):
        start[v + 1] += start[v]
    fill = start[:n].copy()
    edge, other = np.empty(3 * m, dtype=np.int64), np.empty(3 * m, dtype=np.int64)
    for f in range(m):
        for k in range(3):
            a, b = faces[f, k], faces[f, (k + 1) % 3]
            at = fill[min(a, b)]
            edge[at], other[at] = 3 * f + k, max(a, b)
            fill[min(a, b)] += 1
    return start, edge, other


@njit(cache=True, nogil=True, error_model="numpy")
def _join(start: ArrayI, edge: ArrayI, other: ArrayI, out: ArrayI) -> None:
    """Put the faces (m, 3) across each edge into ``out``: partners are looked for at the lower corner."""
    for v in range(len(start) - 1):
        first, end = start[v], start[v + 1]
        if end - first <= _HUB:
            for i in range(first + 1, end):
                e, o, j = edge[i], other[i], i - 1
                while j >= first and other[j] > o:
                    edge[j + 1], other[j + 1] = edge[j], other[j]
                    j -= 1
                edge[j + 1], other[j + 1] = e, o
        i = first
        while i < end:
            j = i + 1
            while j < end and other[j] == other[i]:
                j += 1
            if j - i == 2:
                one, two = edge[i], edge[i + 1]
                out[one // 3, one % 3], out[two // 3, two % 3] = two // 3, one // 3
            i = j


# ---------------------------------------------------------------- PLY files
#
# Binary little-endian; vertices double ``x y z`` and float ``sigma_m``, faces ``vertex_indices`` and uchar
# ``border``. Lines ``comment thalweg ...``, joined, are a JSON text with the origin of the world frame, the
# version of the format, and the facts about the mesh. It is cut into short lines because readers built on
# rply (Open3D, CloudCompare) refuse lines of more than a thousand characters.
#
# Format: G. Turk, "The PLY Polygon File Format" (1994).


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
    told = _facts_of_comments(header.comments, path)
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


def frame_of_comments(comments: list[str], path: Path) -> LocalFrame | None:
    """The world frame that a mesh of `write_mesh` states; None for one of another program.

    Raises
    ------
    InputError : the statement is damaged, or of another version.
    """
    told = _facts_of_comments(comments, path)
    return None if told is None else LocalFrame(**told["origin"])


def _facts_of_comments(comments: list[str], path: Path) -> dict[str, Any] | None:
    text = "".join(line.removeprefix("thalweg ") for line in comments if line.startswith("thalweg "))
    if not text:
        return None
    try:
        told = parse_json(text, path)
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


# ---------------------------------------------------------------- header of a PLY file
#
# Format: G. Turk, "The PLY Polygon File Format" (1994).


@dataclass(frozen=True, slots=True, kw_only=True)
class PlyHeader:
    """``form`` is a key of `ORDERS`, ``comments`` also those of obj_info, ``end`` where the data begin."""

    form: str
    elements: list[PlyElement]
    comments: list[str]
    end: int


def read_ply_header(path: Path, *, cure: str) -> PlyHeader:
    """The header of a file.

    Parameters
    ----------
    path : PLY.
    cure : what to do if it is damaged.

    Raises
    ------
    InputError : no header, one without an end, or a line that PLY 1.0 does not know.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
    end = re.search(rb"(?:^|[\r\n])end_header[ \t]*(\r\n|\n|\r)", head)
    if not head.startswith(b"ply") or end is None:
        raise InputError(
            "the header has no end" if head.startswith(b"ply") else "no PLY header",
            expected="'ply' first, and a line 'end_header'",
            where=path,
            cure=cure,
        )
    form, elements, comments = _parsed(head[: end.start()].decode("latin-1"), path, cure)
    return PlyHeader(form=form, elements=elements, comments=comments, end=end.end())


def _parsed(text: str, path: Path, cure: str) -> tuple[str, list[PlyElement], list[str]]:
    form, elements, comments = "", [], []  # type: str, list[PlyElement], list[str]
    for number, line in enumerate(re.split(r"\r\n|\n|\r", text), start=1):
        known = True
        try:
            match line.split():
                case ["ply"] | []:
                    pass
                case ["comment" | "obj_info" as word, *_]:
                    comments.append(line[len(word) + 1 :])
                case ["format", kind, "1.0"] if kind in ORDERS:
                    form = kind
                case ["element", name, count]:
                    elements.append(PlyElement(name, int(count), []))
                case ["property", "list", length, item, name] if elements:
                    elements[-1].fields.append((name.lower(), f"{_TYPES[length]}:{_TYPES[item]}"))
                case ["property", kind, name] if elements:
                    elements[-1].fields.append((name.lower(), _TYPES[kind]))
                case _:
                    known = False
        except (ValueError, KeyError):
            known = False
        if not known:
            raise InputError(
                f"line {number} of the header is {line[:60]!r}",
                expected="format, element or property of PLY 1.0",
                where=path,
                cure=cure,
            )
    if not form or any(e.count < 0 for e in elements):
        raise InputError("the header states no format, or negative counts", expected="PLY 1.0", where=path)
    return form, elements, comments
