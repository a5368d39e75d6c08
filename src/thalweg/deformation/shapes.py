"""Outlines of areas and lines from GeoPackage files: masks of water, stable ground, transects."""

import sqlite3
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pyproj import CRS

from thalweg.core import ArrayB, ArrayF, InputError

_LINE, _POLYGON = 2, 3
_COLLECTIONS = {5: _LINE, 6: _POLYGON}
_ENVELOPE_BYTES = (0, 32, 48, 48, 64)


@dataclass(frozen=True, slots=True)
class Shapes:
    """Lines or polygons of one file.

    Attributes
    ----------
    parts : of each line its corners (k, 2), of each polygon its rings (k, 2); east and north in metres.
    frame : coordinate system, or None where the file states none.
    """

    parts: tuple[tuple[ArrayF, ...], ...]
    frame: CRS | None
    path: Path

    def contain(self, points_m: ArrayF) -> ArrayB:
        """Which points (n, 2) lie in a polygon, holes of it left out."""
        inside = np.zeros(len(points_m), bool)
        for rings in self.parts:
            low, high = rings[0].min(axis=0), rings[0].max(axis=0)
            near = np.flatnonzero(((points_m >= low) & (points_m <= high)).all(axis=1))
            x, y = points_m[near].T
            odd = np.zeros(len(near), bool)
            for ring in rings:
                for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
                    crosses = (a[1] > y) != (b[1] > y)
                    if crosses.any():
                        odd ^= crosses & (x < a[0] + (y - a[1]) * ((b[0] - a[0]) / (b[1] - a[1])))
            inside[near[odd]] = True
        return inside

    def points_along(self, step_m: float) -> ArrayF:
        """Points (n, 2) along each line from its start, one every ``step_m``; the rest of a line has none."""
        points = [np.empty((0, 2))]
        for line in (part for parts in self.parts for part in parts):
            along = np.r_[0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T))]
            places = np.arange(0.0, np.floor(along[-1] / step_m) * step_m, step_m)
            points.append(np.column_stack([np.interp(places, along, line[:, axis]) for axis in (0, 1)]))
        return np.concatenate(points)


def read_shapes(path: Path, where: dict[str, str] | None = None) -> Shapes:
    """Lines or polygons of the first layer of a GeoPackage.

    Parameters
    ----------
    where : columns with the value that counts, such as ``{"location": "mar"}``; compared as text.

    Raises
    ------
    InputError : no such file, no GeoPackage, no such column, or nothing left.
    """
    if not path.is_file():
        raise InputError("no such file", expected="a GeoPackage (.gpkg) of polygons or lines", where=path)
    try:
        with sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True) as file:
            table, geometry, srs = file.execute(
                "SELECT table_name, column_name, srs_id FROM gpkg_geometry_columns"
            ).fetchone()
            columns = [row[1] for row in file.execute(f'PRAGMA table_info("{table}")')]
            unknown = sorted(set(where or {}) - set(columns))
            if unknown:
                raise InputError(
                    f"no column {', '.join(unknown)}", expected=f"one of {', '.join(columns)}", where=path
                )
            wanted = "".join(f' AND CAST("{name}" AS TEXT) = ?' for name in where or {})
            rows = file.execute(
                f'SELECT "{geometry}" FROM "{table}" WHERE "{geometry}" IS NOT NULL{wanted}',
                list((where or {}).values()),
            ).fetchall()
            code = file.execute(
                "SELECT organization, organization_coordsys_id FROM gpkg_spatial_ref_sys WHERE srs_id = ?",
                [srs],
            ).fetchone()
    except (sqlite3.Error, TypeError) as error:
        raise InputError(
            f"no GeoPackage with a layer ({error})", expected="a .gpkg file", where=path
        ) from error
    parts: list[tuple[ArrayF, ...]] = []
    for (blob,) in rows:
        parts += _from_wkb(blob[8 + _ENVELOPE_BYTES[blob[3] >> 1 & 7] :], path)
    if not parts:
        raise InputError(
            f"no polygon or line with {where or 'any value'}", expected="at least one", where=path
        )
    frame = CRS.from_authority(*code) if code and srs > 0 else None
    return Shapes(tuple(parts), frame, path)


def _from_wkb(data: bytes, path: Path) -> list[tuple[ArrayF, ...]]:
    """Parts of a geometry in well-known binary."""
    parts: list[tuple[ArrayF, ...]] = []

    def corners(at: int, order: str, width: int) -> tuple[ArrayF, int]:
        """Corners of a ring and the offset behind them."""
        (n,) = struct.unpack_from(order + "I", data, at)
        values = np.frombuffer(data, order + "f8", n * width, at + 4).reshape(n, width)
        return values[:, :2].astype(np.float64), at + 4 + 8 * n * width

    def geometry(at: int) -> int:
        """Take one geometry; the offset behind it."""
        order = "<" if data[at] else ">"
        (code,) = struct.unpack_from(order + "I", data, at + 1)
        extra = bin(code >> 30).count("1") + {0: 0, 1: 1, 2: 1, 3: 2}[(code & 0xFFFF) // 1000]
        kind, at = (code & 0xFFFF) % 1000, at + 5
        if kind == _LINE:
            line, at = corners(at, order, 2 + extra)
            parts.append((line,))
        elif kind == _POLYGON:
            (n,), at = struct.unpack_from(order + "I", data, at), at + 4
            rings = []
            for _ in range(n):
                ring, at = corners(at, order, 2 + extra)
                rings.append(ring)
            parts.append(tuple(rings))
        elif kind in _COLLECTIONS:
            (n,), at = struct.unpack_from(order + "I", data, at), at + 4
            for _ in range(n):
                at = geometry(at)
        else:
            raise InputError(f"a geometry of type {kind}", expected="polygons or lines", where=path)
        return at

    geometry(0)
    return parts
