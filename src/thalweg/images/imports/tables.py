"""Tables with coordinates and three angles of each image, as text.

Read are Metashape's export "Omega Phi Kappa" (``# PhotoID, X, Y, Z, Omega, Phi, Kappa, r11 ...``), Pix4D's
``calibrated_external_camera_parameters.txt`` (``imageName X Y Z Omega Phi Kappa``), tables without a header
in this order, and any table with named columns. Equations: `thalweg.images.imports.angles`. Where the
table has the rotation matrix beside the angles (as it is or transposed), both must agree.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from thalweg.core.errors import InputError
from thalweg.core.types import ArrayF
from thalweg.images.imports.angles import (
    angle_covariance,
    ccs_rotations,
    changes,
    conventions,
    image_rotations,
)
from thalweg.images.imports.source import Angles, Finished, Place, place_of

_COLUMNS: Final[Mapping[str, tuple[str, ...]]] = {
    "image": ("photoid", "image", "imagename", "image_name", "label", "name", "filename", "file", "photo"),
    "x": ("x_est", "east_m", "lon_deg", "x", "easting", "east", "x/easting", "x/east", "x/longitude",
          "longitude"),
    "y": ("y_est", "north_m", "lat_deg", "y", "northing", "north", "y/northing", "y/north", "y/latitude",
          "latitude"),
    "z": ("z_est", "up_m", "h_ell_m", "z", "altitude", "height", "z/altitude", "alt", "h"),
    "omega": ("omega_est", "omega", "omega_deg", "omega_gon", "omega_rad"),
    "phi": ("phi_est", "phi", "phi_deg", "phi_gon", "phi_rad"),
    "kappa": ("kappa_est", "kappa", "kappa_deg", "kappa_gon", "kappa_rad"),
    "sigma_x": ("sigma_x", "sigma_x_m", "sigma_east_m", "sx", "x sigma", "accuracy"),
    "sigma_y": ("sigma_y", "sigma_y_m", "sigma_north_m", "sy", "y sigma", "accuracy"),
    "sigma_z": ("sigma_z", "sigma_z_m", "sigma_up_m", "sz", "z sigma", "accuracy"),
    **{
        f"sigma_{a}": (f"sigma_{a}", f"sigma_{a}_deg", f"sigma_{a}_gon", f"sigma_{a}_rad", f"s{a}", f"s_{a}")
        for a in ("omega", "phi", "kappa")
    },
}  # fmt: skip
"""Headings, in small letters without units, by which a column is known; estimated before stated values."""

_ORDER: Final = ("image", "x", "y", "z", "omega", "phi", "kappa")
_MATRIX: Final = tuple(f"r{i}{j}" for i in "123" for j in "123")
_UNITS: Final = {"deg": "deg", "°": "deg", "degree": "deg", "degrees": "deg", "gon": "gon", "grad": "gon",
                 "rad": "rad"}  # fmt: skip
_LEAST_SEPARATORS: Final = 3
_AGREE: Final = 2e-3
"""Elements of a rotation matrix beside angles with two digits differ by less."""


@dataclass(frozen=True, slots=True)
class _Table:
    """Columns by our names, rows of words with their line numbers."""

    columns: dict[str, int]
    rows: list[tuple[int, list[str]]]
    crs: str | None
    unit: str | None
    found: dict[str, str]


def read_angles_table(
    path: Path,
    *,
    crs: str | None,
    default_crs: str | None,
    unit: str,
    rotation: str,
    direction: str,
    axes: str,
) -> Finished:
    """Poses of a table of coordinates and angles.

    Parameters
    ----------
    crs : what the coordinates refer to; None: as the file says, else ``default_crs``.
    unit : ``deg``, ``gon``, ``rad``; ``auto``: as the header says, else degrees.
    rotation, direction, axes : how to read the angles.

    Raises
    ------
    InputError : columns that are missing, numbers that are none, no CRS, or a matrix against the angles.
    """
    table = _table(path)
    values = np.array([[_value(row, table.columns, c, path, n) for c in _ORDER[1:]] for n, row in table.rows])
    names = tuple(row[table.columns["image"]] for _, row in table.rows)
    empty = [n for (n, _), name in zip(table.rows, names, strict=True) if not name]
    if empty:
        raise InputError(
            "a pose without a name", expected="the name of its image", where=f"{path}:{empty[0]}"
        )
    angles = Angles(
        values=values[:, 3:], unit=(table.unit or "deg") if unit == "auto" else unit, rotation=rotation,
        direction=direction, axes=axes,
    )  # fmt: skip
    notes = []
    if unit not in ("auto", table.unit or unit):
        notes.append(f"The header says {table.unit}, images.finished.angle_unit {unit}: {unit} it is")
    if all(name in table.columns for name in _MATRIX):
        given = np.array([[_value(row, table.columns, c, path, n) for c in _MATRIX] for n, row in table.rows])
        _check_matrix(angles, given.reshape(-1, 3, 3), names, path)
    n = len(names)
    sigma = np.full((n, 6), np.nan)
    for k, name in enumerate(_ORDER[1:]):
        if f"sigma_{name}" in table.columns:
            sigma[:, k] = [_value(row, table.columns, f"sigma_{name}", path, i) for i, row in table.rows]
    if (sigma <= 0).any():
        raise InputError(
            "a standard deviation that is not positive", expected="sigmas above zero", where=path
        )
    cov = np.full((n, 6, 6), np.nan)
    cov[:, :3, 3:] = cov[:, 3:, :3] = 0.0
    cov[:, :3, :3] = np.square(sigma[:, :3])[:, :, None] * np.eye(3)
    cov[:, 3:, 3:] = angle_covariance(angles, sigma[:, 3:])
    return Finished(
        program="table of angles", where=str(path), place=_place(table, crs, default_crs, path), names=names,
        coordinates=values[:, :3], R_place_ccs=ccs_rotations(angles), cov=cov,
        camera=np.full(n, -1, np.int64), angles=angles, notes=tuple(notes),
    )  # fmt: skip


def _place(table: _Table, crs: str | None, default_crs: str | None, path: Path) -> Place:
    if crs is not None:
        return place_of(crs, str(path))
    if table.found["x"] == "east_m":
        return Place(kind="world")
    geographic = table.found["x"] in ("lon_deg", "longitude", "x/longitude")
    stated = table.crs or ("EPSG:4979" if geographic else default_crs)
    if stated is None:
        raise InputError(
            "coordinates without a CRS", expected="its name", where=path,
            cure="Set images.finished.crs, `world` if they are in the world frame of the campaign",
        )  # fmt: skip
    return place_of(stated, str(path))


def _check_matrix(angles: Angles, given: ArrayF, names: tuple[str, ...], path: Path) -> None:
    """Compare the angles with the matrix that stands beside them.

    Raises
    ------
    InputError : they differ; it names the reading of the angles that agrees.
    """

    def off(reading: Angles) -> ArrayF:
        """Largest difference (n,) of the rotations of a reading from the given ones."""
        R = image_rotations(reading)
        sides = [np.abs(M - given).max(axis=(1, 2)) for M in (R, np.swapaxes(R, 1, 2))]
        return np.asarray(min(sides, key=lambda s: float(np.median(s))))

    own = off(angles)
    if (own <= _AGREE).all():
        return
    words, cure = "", "Check the settings of the export and images.finished"
    for other in conventions(angles):
        if other.axes == angles.axes and (off(other) <= _AGREE).all():
            changed = changes(angles, other)
            words = f"; with {' and '.join(changed)} they agree"
            cure = f"Set {', '.join(f'images.finished.{c}' for c in changed)}"
            break
    worst = int(np.argmax(own))
    raise InputError(
        f"angles and rotation matrix of {names[worst]} differ by {own[worst]:.3f}{words}",
        expected=f"less than {_AGREE:g}", where=path, cure=cure,
    )  # fmt: skip


def _table(path: Path) -> _Table:
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError("no UTF-8 text", expected="a table", where=path, cure="Save it as UTF-8") from error
    numbered = [(n, line) for n, line in enumerate(lines, 1) if line.strip()]
    comments = [line.strip().lstrip("#").strip() for _, line in numbered if line.lstrip().startswith("#")]
    data = [(n, line.strip()) for n, line in numbered if not line.lstrip().startswith("#")]
    head = next((c for c in reversed(comments) if _is_head(c)), None)
    if data and _is_head(data[0][1]):
        head, data = data[0][1], data[1:]
    if not data:
        raise InputError("no row", expected="one an image", where=path)
    crs = next((c.split(":", 1)[1].strip() for c in comments
                if re.match(r"(coordinate ?system|crs)\s*:", c, re.IGNORECASE)), None)  # fmt: skip
    titles = list(_ORDER) if head is None else _split(head, None)
    if head is None and len(_split(data[0][1], 7)) == 7 + len(_MATRIX):
        titles += _MATRIX
    keys = [_key(t) for t in titles]
    columns: dict[str, int] = {}
    found: dict[str, str] = {}
    for ours, known in _COLUMNS.items():
        name = next((k for k in known if k in keys), None)
        if name is not None:
            columns[ours], found[ours] = keys.index(name), name
    columns |= {name: keys.index(name) for name in _MATRIX if name in keys}
    missing = [name for name in _ORDER if name not in columns]
    if missing:
        yaw = (
            " (yaw, pitch, roll are not read: export omega, phi, kappa)"
            if {"yaw", "pitch"} & set(keys)
            else ""
        )
        raise InputError(
            f"no column {', '.join(missing)} among {', '.join(titles)[:120]}{yaw}",
            expected=", ".join(_ORDER), where=path, cure="Name the columns in the first line",
        )  # fmt: skip
    units = {
        u
        for t in titles
        for u in [_unit(t)]
        if u is not None and re.match(r"\W*(omega|phi|kappa)", t.lower())
    }
    if len(units) > 1:
        raise InputError(f"angles in {' and '.join(sorted(units))}", expected="one unit", where=path)
    rows = []
    for n, line in data:
        cells = _split(line, len(keys))
        if len(cells) < len(keys):
            raise InputError(f"{len(cells)} columns", expected=f"{len(keys)}", where=f"{path}:{n}")
        rows.append((n, cells))
    return _Table(columns, rows, crs, next(iter(units), None), found)


def _is_head(line: str) -> bool:
    return "omega" in line.lower() or ("yaw" in line.lower() and "pitch" in line.lower())


def _split(line: str, count: int | None) -> list[str]:
    """Cells of a line; ``count``: columns, for names with blanks in tables that blanks divide."""
    for separator in ("\t", ";", ","):
        if line.count(separator) >= _LEAST_SEPARATORS:
            return [cell.strip().strip('"') for cell in line.split(separator)]
    cells = line.split()
    if count is not None and len(cells) > count and not _is_number(cells[1]):
        cells = [" ".join(cells[: len(cells) - count + 1]), *cells[len(cells) - count + 1 :]]
    return cells


def _key(title: str) -> str:
    return re.sub(r"[\s_]*[\[(].*?[\])]$", "", title.strip().strip('"').lower()).strip()


def _unit(title: str) -> str | None:
    stated = re.search(r"[\[(_](deg|gon|rad|grad|°|degrees?)[\])]?$", title.strip().strip('"').lower())
    return _UNITS[stated[1]] if stated else None


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _value(row: list[str], columns: Mapping[str, int], name: str, path: Path, number: int) -> float:
    text = row[columns[name]]
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        hint = "Write decimals with a point" if re.fullmatch(r"-?\d+,\d+", text) else ""
        raise InputError(f"{name} '{text}'", expected="a number", where=f"{path}:{number}", cure=hint)
    return value
