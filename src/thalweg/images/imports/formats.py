"""Files with orientations of other programs: tables of coordinates and angles, Metashape's cameras XML.

Read are Metashape's export "Omega Phi Kappa" (``# PhotoID, X, Y, Z, Omega, Phi, Kappa, r11 ...``), Pix4D's
``calibrated_external_camera_parameters.txt`` (``imageName X Y Z Omega Phi Kappa``), tables without a header
in this order, and any table with named columns. Equations: `thalweg.images.imports.source`. Where the
table has the rotation matrix beside the angles (as it is or transposed), both must agree.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError

from thalweg.core import (
    PARAMETERS,
    ArrayF,
    Camera,
    GeometryError,
    InputError,
    Model,
    from_metashape,
    parse_xml,
)
from thalweg.images.imports.source import (
    Angles,
    Finished,
    Place,
    angle_covariance,
    ccs_rotations,
    changes,
    conventions,
    image_rotations,
    orthogonal,
    place_of,
)

_COLUMNS: Final[Mapping[str, tuple[str, ...]]] = {
    "image": ("photoid", "image", "imagename", "image_name", "label", "name", "filename", "file", "photo"),
    "x": (
        "x_est",
        "east_m",
        "lon_deg",
        "x",
        "easting",
        "east",
        "x/easting",
        "x/east",
        "x/longitude",
        "longitude",
    ),
    "y": (
        "y_est",
        "north_m",
        "lat_deg",
        "y",
        "northing",
        "north",
        "y/northing",
        "y/north",
        "y/latitude",
        "latitude",
    ),
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
}
"""Headings, in small letters without units, by which a column is known; estimated before stated values."""
_ORDER: Final = ("image", "x", "y", "z", "omega", "phi", "kappa")
_MATRIX: Final = tuple(f"r{i}{j}" for i in "123" for j in "123")
_UNITS: Final = {
    "deg": "deg",
    "°": "deg",
    "degree": "deg",
    "degrees": "deg",
    "gon": "gon",
    "grad": "gon",
    "rad": "rad",
}
_LEAST_SEPARATORS: Final = 3
_AGREE: Final = 2e-3
"""Elements of a rotation matrix beside angles with two digits differ by less."""

NOT_ALIGNED: Final = "not aligned in Metashape"
SWITCHED_OFF: Final = "switched off in Metashape"
_FALSE: Final = ("false", "0")
_EARTH: Final = CRS.from_epsg(4978)
_TYPES: Final[dict[str, Model]] = {
    "frame": "perspective",
    "fisheye": "fisheye",
    "equidistant_fisheye": "fisheye",
}
_NAMES: Final = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2")
_GRID: Final = 25
_MOST_PX: Final = 1.0


# ---------------------------------------------------------------- tables with coordinates and three angles of
# each image, as text


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
        values=values[:, 3:],
        unit=(table.unit or "deg") if unit == "auto" else unit,
        rotation=rotation,
        direction=direction,
        axes=axes,
    )
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
        program="table of angles",
        where=str(path),
        place=_place_of_table(table, crs, default_crs, path),
        names=names,
        coordinates=values[:, :3],
        R_place_ccs=ccs_rotations(angles),
        cov=cov,
        camera=np.full(n, -1, np.int64),
        angles=angles,
        notes=tuple(notes),
    )


def _place_of_table(table: _Table, crs: str | None, default_crs: str | None, path: Path) -> Place:
    if crs is not None:
        return place_of(crs, str(path))
    if table.found["x"] == "east_m":
        return Place(kind="world")
    geographic = table.found["x"] in ("lon_deg", "longitude", "x/longitude")
    stated = table.crs or ("EPSG:4979" if geographic else default_crs)
    if stated is None:
        raise InputError(
            "coordinates without a CRS",
            expected="its name",
            where=path,
            cure="Set images.finished.crs, `world` if they are in the world frame of the campaign",
        )
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
        expected=f"less than {_AGREE:g}",
        where=path,
        cure=cure,
    )


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
    crs = next(
        (
            c.split(":", 1)[1].strip()
            for c in comments
            if re.match(r"(coordinate ?system|crs)\s*:", c, re.IGNORECASE)
        ),
        None,
    )
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
            expected=", ".join(_ORDER),
            where=path,
            cure="Name the columns in the first line",
        )
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


# ---------------------------------------------------------------- cameras XML of Metashape (File, Export,
# Export Cameras)
#
# ``transform`` of a camera is ``T_chunk_ccs`` (ccs as ours: x right, y down, z along the view). The chunk, or
# the component of the chunk, has a transform of its own with rotation, translation and scale::
#
#     x_place = scale R x_chunk + translation
#
# For a chunk with a CRS on the earth, ``x_place`` is geocentric in the datum of that CRS, whatever the CRS,
# so that neither grid north nor scale come in; for local coordinates it is local. ``location_covariance``
# stands in the units and axes of the chunk, ``rotation_covariance`` in radians squared about the axes of the
# camera (so Agisoft's own ``save_estimated_reference.py`` uses both)::
#
#     cov_place = (scale R) C_location (scale R)^T,      cov_rotation = R_place_ccs C_rotation R_place_ccs^T


@dataclass(frozen=True, slots=True)
class _Chunk:
    """``x_place = scale R x_chunk + shift``."""

    scale: float
    R: ArrayF
    shift: ArrayF


def read_metashape(path: Path, crs: str | None) -> Finished:
    """Poses, interior orientations and covariances of a cameras XML.

    Parameters
    ----------
    crs : what local coordinates refer to; files with a CRS on the earth state it themselves.

    Raises
    ------
    InputError : no such file, more than one chunk with cameras, numbers that are none, or another datum.
    """
    chunk = _chunk(path)
    notes: list[str] = []
    sensors = {s.get("id", ""): s for s in chunk.iter("sensor")}
    used: dict[str, int] = {}
    cameras: list[Camera] = []
    for key, sensor in sensors.items():
        camera = sensor_camera(sensor, str(path), notes)
        if camera is not None:
            used[key] = len(cameras)
            cameras.append(camera)
    chunks = _transforms(chunk, path)
    place = _place_of_chunk(chunk, path, crs, notes)
    placed = any(chunks.values())
    if not placed:
        place = Place(kind="free")
    names, matrices, cov_shift, cov_turn, of, index = [], [], [], [], [], []
    absent: dict[str, str] = {}
    turned = 0
    for element in chunk.iter("camera"):
        name, text = element.get("label", ""), element.findtext("transform")
        if not name or element.get("master_id") not in (None, element.get("id")):
            continue
        component = element.get("component_id") or ""
        at = component if component in chunks else ""
        if not text or not text.strip():
            absent[name] = NOT_ALIGNED
        elif element.get("enabled", "true").lower() in _FALSE:
            absent[name] = SWITCHED_OFF
        elif placed and chunks.get(at) is None:
            absent[name] = "its component has no place in the world"
        else:
            names.append(name)
            matrices.append(_numbers(text, 16, path, name).reshape(4, 4))
            cov_shift.append(_optional(element, "location_covariance", path))
            cov_turn.append(_optional(element, "rotation_covariance", path))
            of.append(chunks.get(at) or _Chunk(1.0, np.eye(3), np.zeros(3)))
            index.append(used.get(element.get("sensor_id", ""), -1))
            turned += element.findtext("orientation", "1").strip() not in ("", "1")
    if not names:
        raise InputError(f"no aligned camera of {len(absent)}", expected="at least one", where=path)
    if turned:
        notes.append(
            f"{turned} images are turned by their EXIF orientation; poses refer to the stored pixels"
        )
    T = np.array(matrices)
    R_chunk = orthogonal(T[:, :3, :3], str(path), tuple(names))
    scale, R0 = np.array([c.scale for c in of]), np.array([c.R for c in of])
    R = R0 @ R_chunk
    coordinates = scale[:, None] * np.einsum("nij,nj->ni", R0, T[:, :3, 3]) + np.array([c.shift for c in of])
    cov = np.full((len(names), 6, 6), np.nan)
    cov[:, :3, 3:] = cov[:, 3:, :3] = 0.0
    cov[:, :3, :3] = np.square(scale)[:, None, None] * (R0 @ np.array(cov_shift) @ np.swapaxes(R0, 1, 2))
    cov[:, 3:, 3:] = R @ np.array(cov_turn) @ np.swapaxes(R, 1, 2)
    return Finished(
        program="Metashape",
        where=str(path),
        place=place,
        names=tuple(names),
        coordinates=coordinates,
        R_place_ccs=R,
        cov=cov,
        camera=np.array(index, np.int64),
        cameras=tuple(cameras),
        absent=absent,
        notes=tuple(notes),
    )


def _chunk(path: Path) -> ElementTree.Element:
    try:
        root = parse_xml(path.read_bytes())
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"no XML ({error})", expected="a cameras XML of Metashape", where=path) from error
    chunks = [
        c for c in ([root] if root.tag == "chunk" else root.iter("chunk")) if c.find(".//camera") is not None
    ]
    if len(chunks) != 1:
        raise InputError(
            f"{len(chunks)} chunks with cameras",
            expected="one",
            where=path,
            cure="Export the cameras of one chunk: File, Export, Export Cameras, Agisoft XML",
        )
    return chunks[0]


def _transforms(chunk: ElementTree.Element, path: Path) -> dict[str, _Chunk | None]:
    """Transforms of the components by their id, and of the chunk by ``""``; None where there is no scale."""
    found = {"": _transform(chunk.find("transform"), path)}
    components = list(chunk.iterfind(".//components/component"))
    for component in components:
        found[component.get("id", "")] = _transform(component.find("transform"), path)
    if found[""] is None and len(components) == 1:
        found[""] = found[components[0].get("id", "")]
    return found


def _transform(element: ElementTree.Element | None, path: Path) -> _Chunk | None:
    parts = {} if element is None else {p.tag: p.text or "" for p in element}
    if not {"rotation", "translation", "scale"} <= parts.keys():
        return None
    R = _numbers(parts["rotation"], 9, path, "the chunk").reshape(1, 3, 3)
    scale = float(_numbers(parts["scale"], 1, path, "the chunk")[0])
    if not scale > 0:
        raise InputError(f"a chunk of the scale {scale:g}", expected="a positive number", where=path)
    return _Chunk(
        scale,
        orthogonal(R, str(path), ("the chunk",))[0],
        _numbers(parts["translation"], 3, path, "the chunk"),
    )


def _place_of_chunk(chunk: ElementTree.Element, path: Path, crs: str | None, notes: list[str]) -> Place:
    """Geocentric for a CRS on the earth, else what the campaign says, else a frame of its own."""
    stated = (chunk.findtext("reference") or "").strip()
    if not stated or stated.startswith("LOCAL_CS"):
        return Place(kind="free") if crs is None else place_of(crs, str(path))
    try:
        known = CRS.from_user_input(stated)
    except CRSError as error:
        raise InputError(
            f"the CRS '{stated[:80]}' is not known",
            expected="a CRS on the earth, or local coordinates",
            where=path,
            cure="Export in a CRS with an EPSG code",
        ) from error
    ellipsoid = known.ellipsoid
    if ellipsoid is None or abs(ellipsoid.semi_major_metre - 6_378_137.0) > 0.5:
        raise InputError(
            f"geocentric coordinates in the datum of '{known.name}'",
            expected="a CRS on WGS84 or GRS80",
            where=path,
            cure="Set the chunk to WGS84 or ETRS89 and export again",
        )
    if crs is not None:
        notes.append(f"The file itself states '{known.name}': images.finished.crs is not used")
    return Place(kind="geocentric", crs=_EARTH)


def _numbers(text: str, count: int, path: Path, name: str) -> ArrayF:
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(f"'{text.strip()[:40]}' of {name}", expected=f"{count} numbers", where=path)
    return values


def _optional(element: ElementTree.Element, tag: str, path: Path) -> ArrayF:
    """A covariance (3, 3), NaN where there is none."""
    text = element.findtext(tag)
    if not text or not text.strip():
        return np.full((3, 3), np.nan)
    C = _numbers(text, 9, path, f"{tag} of {element.get('label', '')}").reshape(3, 3)
    C = (C + C.T) / 2
    if np.linalg.eigvalsh(C)[0] < -1e-9 * max(float(np.trace(C)), 1e-300):
        raise InputError(
            f"{tag} of {element.get('label', '')} is no covariance", expected="a covariance", where=path
        )
    return C


# ---------------------------------------------------------------- interior orientations of Metashape
# (appendix "Camera models" of its manual) as ours
#
# With ``x = X/Z``, ``y = Y/Z``, ``r^2 = x^2 + y^2``; for a fisheye ``x`` and ``y`` are those times
# ``atan(r)/r``::
#
#     x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8) + p1 (r^2 + 2 x^2) + 2 p2 x y
#     y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8) + p2 (r^2 + 2 y^2) + 2 p1 x y
#     u = w/2 + cx + x' f + x' b1 + y' b2,      v = h/2 + cy + y' f
#
# Pixels count from the upper left corner, as ours. ``p1`` and ``p2`` are OpenCV's ``p2`` and ``p1``. A skew
# ``b2``, the ``k4`` of a perspective lens and tangential parts of a fisheye have no place in our models: the
# distortion is fitted over the picture, and the largest difference is told.


def sensor_camera(sensor: ElementTree.Element, where: str, notes: list[str]) -> Camera | None:
    """Camera of a sensor, with covariance where the file has one; None with a note where it cannot be ours.

    Raises
    ------
    InputError : numbers that are none.
    """
    label = sensor.get("label") or f"sensor {sensor.get('id', '')}"
    options = sensor.findall("calibration")
    adjusted = [c for c in options if c.get("class") == "adjusted"]
    if not adjusted and not options:
        return None
    calibration = (adjusted or options)[0]
    kind = calibration.get("type") or sensor.get("type") or "frame"
    model, size = _TYPES.get(kind), calibration.find("resolution")
    if model is None or size is None or calibration.find("f") is None:
        notes.append(f"Sensor '{label}' is of the type {kind}, or has no f: no interior orientation")
        return None
    higher = [p for p in ("p3", "p4") if _number(calibration, p, where) != 0.0]
    if higher:
        notes.append(
            f"Sensor '{label}' has {' and '.join(higher)}, which are left out: no interior orientation"
        )
        return None
    p = {name: _number(calibration, name, where) for name in _NAMES}
    try:
        size_px = (int(size.get("width", "")), int(size.get("height", "")))
        return _converted(p, model, size_px, label, _covariance(sensor, where, label, notes), where, notes)
    except (ValueError, GeometryError) as error:
        raise InputError(
            f"sensor '{label}': {error}", expected="an interior orientation", where=where
        ) from error


def project_metashape(p: dict[str, float], model: Model, size_px: tuple[int, int], rays: ArrayF) -> ArrayF:
    """Pixels (n, 2) of rays (n, 3) by Metashape's own equations."""
    x, y = rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2]
    if model == "fisheye":
        r = np.hypot(x, y)
        factor = np.where(r > 1e-12, np.arctan(r) / np.maximum(r, 1e-300), 1.0)
        x, y = x * factor, y * factor
    q = x * x + y * y
    radial = 1 + q * (p["k1"] + q * (p["k2"] + q * (p["k3"] + q * p["k4"])))
    u = x * radial + p["p1"] * (q + 2 * x * x) + 2 * p["p2"] * x * y
    v = y * radial + p["p2"] * (q + 2 * y * y) + 2 * p["p1"] * x * y
    return np.stack(
        [
            size_px[0] / 2 + p["cx"] + u * (p["f"] + p["b1"]) + v * p["b2"],
            size_px[1] / 2 + p["cy"] + v * p["f"],
        ],
        axis=1,
    )


def _converted(
    p: dict[str, float],
    model: Model,
    size_px: tuple[int, int],
    label: str,
    cov: tuple[tuple[str, ...], ArrayF] | None,
    where: str,
    notes: list[str],
) -> Camera | None:
    ours = from_metashape(p, size_px)
    names = PARAMETERS[model]
    lost = p["b2"] != 0 or (p["k4"] != 0 if model == "perspective" else p["p1"] != 0 or p["p2"] != 0)
    camera = Camera(model=model, size_px=size_px, parameters=np.array([ours[n] for n in names]), name=label)
    if lost:
        camera, off_px = _fitted(camera, p)
        notes.append(f"Sensor '{label}' as our {model} model: up to {off_px:.3f} px different in the picture")
        if off_px > _MOST_PX:
            notes.append(f"Sensor '{label}': too much, no interior orientation taken over")
            return None
        return camera
    return camera if cov is None else camera.with_parameters(camera.parameters, _carried(names, *cov))


def _carried(names: tuple[str, ...], stated: tuple[str, ...], C: ArrayF) -> ArrayF:
    """Covariance in our parameters."""
    J = np.zeros((len(names), len(stated)))
    swap = {"p1": "p2", "p2": "p1"}
    for column, name in enumerate(stated):
        targets = {"f": ("fx", "fy"), "b1": ("fx",)}.get(name, (swap.get(name, name),))
        for target in targets:
            if target in names:
                J[names.index(target), column] = 1.0
    out = J @ C @ J.T
    return np.asarray((out + out.T) / 2)


def _covariance(
    sensor: ElementTree.Element, where: str, label: str, notes: list[str]
) -> tuple[tuple[str, ...], ArrayF] | None:
    element = sensor.find("covariance")
    if element is None:
        return None
    stated = tuple((element.findtext("params") or "").split())
    try:
        values = np.array([float(word) for word in (element.findtext("coeffs") or "").split()])
    except ValueError:
        values = np.empty(0)
    k = len(stated)
    if not k or len(values) != k * k or not np.isfinite(values).all():
        notes.append(f"{where}: the covariance of sensor '{label}' is not {k} x {k} numbers, and is left out")
        return None
    C = values.reshape(k, k)
    return stated, (C + C.T) / 2


def _fitted(camera: Camera, p: dict[str, float]) -> tuple[Camera, float]:
    """Our parameters whose pixels are closest to Metashape's over the picture, and the largest difference."""
    x, y = np.meshgrid(np.linspace(0, camera.size_px[0], _GRID), np.linspace(0, camera.size_px[1], _GRID))
    rays = camera.rays(np.column_stack([x.ravel(), y.ravel()]))
    rays = rays[np.isfinite(rays).all(axis=1) & (rays[:, 2] > 1e-3)]
    target = project_metashape(p, camera.model, camera.size_px, rays)
    for _ in range(20):
        got, _, by = camera.project_with_derivatives(rays)
        good = np.isfinite(got).all(axis=1)
        A = by[good].reshape(-1, len(camera.parameters))
        size = np.maximum(np.abs(A).max(axis=0), 1e-300)
        d = np.linalg.lstsq(A / size, (target[good] - got[good]).ravel(), rcond=None)[0] / size
        camera = camera.with_parameters(camera.parameters + d)
        if np.abs(A * d).max() < 1e-9:
            break
    off = np.linalg.norm(camera.project(rays) - target, axis=1)
    return camera, float(np.nanmax(off))


def _number(element: ElementTree.Element, name: str, where: str) -> float:
    text = (element.findtext(name) or "").strip()
    try:
        return float(text) if text else 0.0
    except ValueError as error:
        raise InputError(f"{name} '{text}'", expected="a number", where=where) from error
