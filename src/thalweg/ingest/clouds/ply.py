"""Vertices of a PLY file (ascii, binary of either byte order); faces are no points and are left out.

Format: G. Turk, "The PLY Polygon File Format" (1994).
"""

from pathlib import Path
from typing import Final

import numpy as np

from thalweg.core.errors import InputError, UnsupportedError
from thalweg.core.geometry.ply_header import ORDERS, PlyElement, read_ply_header
from thalweg.core.types import AnyArray
from thalweg.ingest.clouds.raw import RawCloud, eight_bit, single_step_m
from thalweg.ingest.integrity import IntegrityReport

_INTENSITY: Final = ("intensity", "scalar_intensity", "reflectance", "scalar_reflectance")
_COLOURS: Final = (
    ("red", "green", "blue"),
    ("r", "g", "b"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
)


def read_ply(path: Path, report: IntegrityReport) -> RawCloud:
    """Vertices of a PLY file.

    Raises
    ------
    InputError : the header is damaged, or there are no vertices with x, y, z.
    UnsupportedError : vertices with list properties, or behind an element with lists.
    """
    header = read_ply_header(path, cure="Export or copy the file again")
    form, elements = header.form, header.elements
    report.format = f"PLY {form}"
    if header.comments:
        report.details["comments"] = "; ".join(text.strip() for text in header.comments)[:500]
    index = next((i for i, e in enumerate(elements) if e.name == "vertex"), None)
    if index is None:
        raise InputError("no element 'vertex'", expected="points", where=path)
    vertex, before = elements[index], elements[:index]
    if vertex.lists or any(e.lists for e in before):
        raise UnsupportedError(
            "list properties in or before the vertices",
            expected="plain vertices first",
            where=path,
            cure="Export as LAZ",
        )
    names = vertex.names
    if not {"x", "y", "z"} <= set(names) or len(set(names)) < len(names):
        raise InputError(f"vertex properties {names}", expected="x, y, z, each once", where=path)
    table = _body(path, header.end, form, before, vertex, report)
    report.count("points_declared", vertex.count)
    for element in elements[index + 1 :]:
        if element.count:
            report.note(f"{element.count:,} elements '{element.name}' are no points and are left out.")
    types = dict(vertex.fields)
    points = np.stack([table[a].astype(np.float64) for a in "xyz"], axis=-1)
    single = [i for i, a in enumerate("xyz") if types[a] == "f4" and form != "ascii"]
    return RawCloud(
        points=points,
        intensity=next((table[n].astype(np.float32) for n in _INTENSITY if n in types), None),
        rgb=next((eight_bit(_stack(table, c), report) for c in _COLOURS if set(c) <= set(types)), None),
        normals=_stack(table, ("nx", "ny", "nz")).astype(np.float32)
        if {"nx", "ny", "nz"} <= set(types)
        else None,
        step_m=single_step_m(points[:, single]) if single else 0.0,
    )


def _body(
    path: Path, start: int, form: str, before: list[PlyElement], vertex: PlyElement, report: IntegrityReport
) -> AnyArray:
    """Vertices present, as a structured array."""
    if form == "ascii":
        return _ascii(path, start, sum(e.count for e in before), vertex, report)
    order = ORDERS[form]
    start += sum(e.count * e.dtype(order).itemsize for e in before)
    dtype = vertex.dtype(order)
    present = min(max(path.stat().st_size - start, 0) // dtype.itemsize, vertex.count)
    _cut(present, vertex.count, report)
    return np.fromfile(path, dtype, count=present, offset=start) if present else np.zeros(0, dtype)


def _ascii(path: Path, start: int, skip: int, vertex: PlyElement, report: IntegrityReport) -> AnyArray:
    with path.open("rb") as stream:
        stream.seek(start)
        lines = stream.read().decode("latin-1").splitlines()[skip:]
    lines = [line for line in lines if line.strip()][: vertex.count]
    width = len(vertex.fields)
    rows = []
    for line in lines:
        try:
            row = [float(x) for x in line.split()]
        except ValueError:
            row = []
        if len(row) == width:
            rows.append(row)
    if damaged := len(lines) - len(rows):
        report.lose("damaged_lines", damaged)
    _cut(len(lines), vertex.count, report)
    values = np.array(rows, dtype=np.float64).reshape(-1, width)
    table = np.zeros(len(values), dtype=[(n, t if t in ("u1", "u2") else "f8") for n, t in vertex.fields])
    for i, (name, kind) in enumerate(vertex.fields):
        column = values[:, i]
        if kind in ("u1", "u2"):
            column = np.clip(np.nan_to_num(column), 0, np.iinfo(kind).max)
        table[name] = column
    return table


def _cut(present: int, declared: int, report: IntegrityReport) -> None:
    if present < declared:
        report.lose("points_missing", declared - present)
        report.note(f"The file is cut: {present:,} of {declared:,} points are there.")


def _stack(table: AnyArray, names: tuple[str, ...]) -> AnyArray:
    return np.stack([table[n] for n in names], axis=-1)
