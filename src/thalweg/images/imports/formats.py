"""Files with orientations of other programs: tables of coordinates and angles, Metashape's cameras XML.

Read are Metashape's export "Omega Phi Kappa" (``# PhotoID, X, Y, Z, Omega, Phi, Kappa, r11 ...``), Pix4D's
``calibrated_external_camera_parameters.txt`` (``imageName X Y Z Omega Phi Kappa``), tables without a header
in this order, and any table with named columns. Equations: `thalweg.images.imports.source`. Where the
table has the rotation matrix beside the angles (as it is or transposed), both must agree.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import numpy as np
from pyproj import CRS

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
from thalweg.core.values import FORMS
from thalweg.images import NAMES, crs_of, named_rows, numbers, required, sigmas
from thalweg.images.imports.source import (
    WORLD,
    Angles,
    Finished,
    Place,
    angle_covariance,
    ccs_rotations,
    check_datum,
    image_rotations,
    orthogonal,
    place_of,
)
from thalweg.ingest import Table, read_text, read_text_table

_ORDER: Final = ("image", "x", "y", "z", "omega", "phi", "kappa")
_ANGLES: Final = _ORDER[4:]
_MATRIX: Final = tuple(f"r{i}{j}" for i in "123" for j in "123")
_UNITS: Final = {
    **dict.fromkeys(("deg", "degs", "degree", "degrees", "decimal degrees", "dd", "°"), "deg"),
    **dict.fromkeys(("gon", "gons", "grad", "grads", "gradian", "gradians"), "gon"),
    **dict.fromkeys(("rad", "rads", "radian", "radians"), "rad"),
}
_COLUMNS: Final[Mapping[str, tuple[str, ...]]] = {
    **NAMES,
    "image": ("photoid", *NAMES["image"], "label", "name"),
    **{axis: (f"{axis}_est", *NAMES[axis]) for axis in "xyz"},
    **{
        ours: tuple(f"{name}{unit}" for name in names for unit in ("", *(f"_{u}" for u in _UNITS)))
        for a in _ANGLES
        for ours, names in ((a, (f"{a}_est", a)), (f"sigma_{a}", (f"sigma_{a}", f"s{a}", f"s_{a}")))
    },
    **{name: (name,) for name in _MATRIX},
}
"""Headings, in small letters, by which a column is known; estimated before stated values."""
_AGREE: Final = 2e-3
"""Elements of a rotation matrix beside angles with two digits differ by less."""

NOT_ALIGNED: Final = "not aligned in Metashape"
SWITCHED_OFF: Final = "switched off in Metashape"
_FALSE: Final = ("false", "0")
_TYPES: Final[dict[str, Model]] = {
    "frame": "perspective",
    "fisheye": "fisheye",
    "equidistant_fisheye": "fisheye",
}
_TERMS: Final = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
_MOST_PX: Final = 1.0


# ---------------------------------------------------------------- tables with coordinates and three angles of
# each image, as text


def read_angles_table(path: Path, settings: Mapping[str, Any], default_crs: str | None) -> Finished:
    """Poses of a table of coordinates and angles.

    Parameters
    ----------
    settings : section ``images.finished``: what the coordinates refer to (``crs``; None: as the file says,
        else ``default_crs``), the unit of the angles (``angle_unit``; ``auto``: as the header says, else
        degrees), and how to read them (``rotation``, ``direction``, ``axes``).

    Raises
    ------
    InputError : columns that are missing, numbers that are none, no CRS, or a matrix against the angles.
    """
    table = read_text_table(path, bare=_ORDER)
    if not table.named and len(table.columns) == len(_ORDER) + len(_MATRIX):
        table = read_text_table(path, order=(*_ORDER, *_MATRIX))
    rows = named_rows(table, _COLUMNS)
    if not rows:
        raise InputError("no row", expected="one an image", where=path)
    estimated = any(column.name.lower() == "x_est" for column in table.columns)
    known = FORMS[2:] if estimated else FORMS
    form = next((form for form in known if rows[0].keys() >= set(form)), FORMS[2])
    if missing := [name for name in ("image", *form, *_ANGLES) if name not in rows[0]]:
        turned = re.search(r"(?i)yaw|pitch", table.listed())
        yaw = " (yaw, pitch, roll are not read: export omega, phi, kappa)" if turned else ""
        raise InputError(
            f"no column {', '.join(missing)} among {table.listed()[:120]}{yaw}",
            expected=", ".join(_ORDER),
            where=path,
            cure="Name the columns in the first line",
        )
    off = {row["image"]: "switched off in the table" for row in rows if row.get("used", "").lower() in _FALSE}
    rows = [row for row in rows if row["image"] not in off]
    coordinates = numbers(rows, form, path)
    names = tuple(required(row, "image", path) for row in rows)
    stated = _angle_unit(table)
    crs, unit, notes = settings["crs"], settings["angle_unit"], list(table.notes)
    values = numbers(rows, _ANGLES, path)
    if unit == "auto":
        unit = stated or "deg"
        if stated is None and np.abs(values).max() > 360.0:
            raise InputError(
                f"angles up to {np.abs(values).max():g} without a unit",
                expected="degrees up to 360",
                where=path,
                cure="State their unit: images.finished.angle_unit: gon",
            )
        if stated is None and not rows[0].keys() >= set(_MATRIX):
            also = " (none exceeds two pi: are they radians?)" if np.abs(values).max() <= 2 * np.pi else ""
            words = f"no unit of the angles: taken as degrees{also}"
            if table.named or not notes:
                notes.append(f"The table states {words}")
            else:  # the note that it names no columns
                notes[-1] += f", and {words}"
    elif stated not in (None, unit):
        notes.append(f"The header says {stated}, images.finished.angle_unit {unit}: {unit} it is")
    how = (settings[name] for name in ("rotation", "direction", "axes"))
    angles = Angles(values, unit, *how)
    if rows[0].keys() >= set(_MATRIX):
        _check_matrix(angles, numbers(rows, _MATRIX, path).reshape(-1, 3, 3), names, path)
    unknown = (np.nan, np.nan, np.nan)
    cov = np.zeros((len(rows), 6, 6))
    cov[:, :3, :3] = np.square(sigmas(rows, path, unknown))[:, :, None] * np.eye(3)
    sigma_angles = sigmas(rows, path, unknown, [f"sigma_{a}" for a in _ANGLES])
    if np.isfinite(sigma_angles).any() and _angle_unit(table, "sigma_", "s_", "s") not in (None, unit):
        raise InputError(
            f"angles in {unit}, and their standard deviations in another unit",
            expected="one unit",
            where=path,
            cure="Convert them",
        )
    cov[:, 3:, 3:] = angle_covariance(angles, sigma_angles)
    if crs is None and form == FORMS[0]:
        crs = WORLD
    if crs is None:
        comment = re.search(r"(?im)^\s*#\s*(?:coordinate ?system|crs)\s*:\s*(\S.*)$", read_text(path)[0])
        crs = comment[1] if comment else "EPSG:4979" if "lon_deg" in rows[0] else default_crs
    if crs is None:
        raise InputError(
            "coordinates without a CRS",
            expected="its name",
            where=path,
            cure="Set images.finished.crs, `world` if they are in the world frame of the campaign",
        )
    place = place_of(crs, path)
    if place.kind == "geographic":
        notes.append("Coordinates are in degrees: angles are taken from true north, not from that of a grid")
    return Finished(
        program="table of angles",
        where=str(path),
        place=place,
        names=names,
        coordinates=coordinates[:, [1, 0, 2]] if form == FORMS[1] else coordinates,
        R_place_ccs=ccs_rotations(angles),
        cov=cov,
        absent=off,
        angles=angles,
        notes=notes,
    )


def _angle_unit(table: Table, *before: str) -> str | None:
    """Unit that the names of the columns of angles state, or else a remark above them.

    Parameters
    ----------
    before : how the names of the columns begin, for those of standard deviations.

    Raises
    ------
    InputError : several units, or one that is none of `_UNITS`.
    """
    known = "|".join(_UNITS)
    units = set()
    for column in table.columns:
        head = column.name.lower()
        if not re.match(rf"(?:{'|'.join(before)})(?:{'|'.join(_ANGLES)})", head):
            continue
        if found := re.search(rf"_({known})$|[\[(]([^\])]*)[\])]\s*$", head):
            unit = _UNITS.get(found[1] or found[2].strip())
            if unit is None:
                raise InputError(
                    f"the column {column.name}",
                    expected="degrees, gon or radians",
                    where=table.path,
                    cure="Convert it",
                )
            units.add(unit)
    if not units and not before:
        for line in table.remarks:
            if re.search(r"(?i)\b(?:angles?|rotations?|omega)\b", line):
                units |= {_UNITS[word] for word in re.findall(rf"\b({known})\b", line.lower())}
    if len(units) > 1:
        raise InputError(
            f"angles in {' and '.join(sorted(units))}",
            expected="one unit",
            where=table.path,
            cure="Convert them",
        )
    return next(iter(units), None)


def _check_matrix(angles: Angles, given: ArrayF, names: tuple[str, ...], path: Path) -> None:
    """Compare the angles with the matrix that stands beside them, as it is or transposed.

    Raises
    ------
    InputError : they differ.
    """
    R = image_rotations(angles)
    sides = [np.abs(M - given).max(axis=(1, 2)) for M in (R, np.swapaxes(R, 1, 2))]
    off = min(sides, key=lambda s: float(np.median(s)))
    worst = int(np.argmax(off))
    if off[worst] > _AGREE:
        raise InputError(
            f"angles and rotation matrix of {names[worst]} differ by {off[worst]:.3f}",
            expected=f"less than {_AGREE:g}",
            where=path,
            cure="Check the settings of the export, and images.finished.angle_unit, rotation and direction",
        )


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


_Chunk = tuple[float, ArrayF, ArrayF]
"""Scale, R, shift: ``x_place = scale R x_chunk + shift``."""


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
    cameras = {
        sensor.get("id", ""): sensor_camera(sensor, str(path), notes) for sensor in chunk.iter("sensor")
    }
    chunks = _transforms(chunk, path)
    placed = any(chunks.values())
    place = _place_of_chunk(chunk, path, crs, notes) if placed else Place(kind="free")
    names, matrices, cov_shift, cov_turn, of, lenses = [], [], [], [], [], []
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
            cov_shift.append(_covariance_of(element, "location_covariance", path))
            cov_turn.append(_covariance_of(element, "rotation_covariance", path))
            of.append(chunks.get(at) or (1.0, np.eye(3), np.zeros(3)))
            lenses.append(cameras.get(element.get("sensor_id", "")))
            turned += element.findtext("orientation", "1").strip() not in ("", "1")
    if not names:
        raise InputError(f"no aligned camera of {len(absent)}", expected="at least one", where=path)
    if turned:
        notes.append(
            f"{turned} images are turned by their EXIF orientation; poses refer to the stored pixels"
        )
    shutters = {
        (e.get("value") or e.text or "").strip().lower()
        for e in chunk.iter()
        if "rolling_shutter" in (e.tag, e.get("name"))
    }
    if shutters - {"", "false", "0", "disabled"}:
        notes.append(
            "The poses are those of a rolling shutter, which moves while it exposes row after row: here they "
            "count for all rows of a picture"
        )
    T = np.array(matrices)
    R_chunk = orthogonal(T[:, :3, :3], str(path), tuple(names))
    scale, R0, shift = (np.array(values) for values in zip(*of, strict=True))
    R = R0 @ R_chunk
    coordinates = scale[:, None] * np.einsum("nij,nj->ni", R0, T[:, :3, 3]) + shift
    cov = np.zeros((len(names), 6, 6))
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
        cameras=tuple(lenses),
        absent=absent,
        notes=notes,
    )


def _chunk(path: Path) -> ElementTree.Element:
    root = parse_xml(path.read_bytes(), path, "a cameras XML of Metashape")
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
    shift = _numbers(parts["translation"], 3, path, "the chunk")
    return scale, orthogonal(R, str(path), ("the chunk",))[0], shift


def _place_of_chunk(chunk: ElementTree.Element, path: Path, crs: str | None, notes: list[str]) -> Place:
    """Geocentric for a CRS on the earth, else what the campaign says, else a frame of its own."""
    stated = (chunk.findtext("reference") or "").strip()
    if stated.startswith("LOCAL_CS"):
        own = crs_of(stated, path)
        if own.axis_info and own.axis_info[0].unit_conversion_factor != 1.0:
            raise InputError(
                f"coordinates in '{own.name}'",
                expected="metres",
                where=path,
                cure="Export the cameras in local coordinates in metres",
            )
    if not stated or stated.startswith("LOCAL_CS"):
        return Place(kind="free") if crs is None else place_of(crs, path)
    known = crs_of(stated, path)
    check_datum(known, path)
    if crs is not None:
        notes.append(f"The file itself states '{known.name}': images.finished.crs is not used")
    return Place(kind="geocentric", crs=CRS.from_epsg(4978))


def _numbers(text: str, count: int, path: Path | str, name: str) -> ArrayF:
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(f"'{text.strip()[:40]}' of {name}", expected=f"{count} numbers", where=path)
    return values


def _covariance_of(element: ElementTree.Element, tag: str, path: Path) -> ArrayF:
    """A covariance (3, 3), NaN where there is none."""
    text = element.findtext(tag)
    if not text or not text.strip():
        return np.full((3, 3), np.nan)
    name = f"{tag} of {element.get('label', '')}"
    C = _numbers(text, 9, path, name).reshape(3, 3)
    C = (C + C.T) / 2
    if np.linalg.eigvalsh(C)[0] < -1e-9 * max(float(np.trace(C)), 1e-300):
        raise InputError(f"{name} is no covariance", expected="a covariance", where=path)
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
# ``b2``, the ``k4`` of a perspective lens and tangential parts of a fisheye have no place in our models: they
# are left out where they move no pixel by more than one, and what they move is told.


def sensor_camera(sensor: ElementTree.Element, where: str, notes: list[str]) -> Camera | None:
    """Camera of a sensor, with covariance where the file has one; None with a note where it cannot be ours.

    Raises
    ------
    InputError : numbers that are none.
    """
    label = f"Sensor '{sensor.get('label') or sensor.get('id', '')}'"
    options = sensor.findall("calibration")
    calibration = next((c for c in options if c.get("class") == "adjusted"), next(iter(options), None))
    if calibration is None:
        return None
    kind = calibration.get("type") or sensor.get("type") or "frame"
    model, size = _TYPES.get(kind), calibration.find("resolution")
    if model is None or size is None or calibration.find("f") is None:
        notes.append(f"{label} is of the type {kind}, or has no f: no interior orientation")
        return None
    p = {
        name: float(_numbers(calibration.findtext(name) or "0", 1, where, f"{name} of {label}")[0])
        for name in _TERMS
    }
    if higher := [name for name in ("p3", "p4") if p[name]]:
        notes.append(f"{label} has {' and '.join(higher)}, which are left out: no interior orientation")
        return None
    try:
        size_px = (int(size.get("width", "")), int(size.get("height", "")))
        ours, names = from_metashape(p, size_px), PARAMETERS[model]
        values = np.array([ours[name] for name in names])
        camera = Camera(model=model, size_px=size_px, parameters=values, name=label[8:-1])
    except (ValueError, GeometryError) as error:
        raise InputError(f"{label}: {error}", expected="an interior orientation", where=where) from error
    if (off_px := _left_px(p, model, size_px)) > 0:
        notes.append(f"{label} as our {model} model: up to {off_px:.2f} px different in the picture")
        if off_px > _MOST_PX:
            notes.append(f"{label}: too much, no interior orientation taken over")
            return None
    stated = (sensor.findtext("covariance/params") or "").split()
    if sensor.find("covariance") is None:
        return camera
    k = len(stated)
    try:
        C = _numbers(sensor.findtext("covariance/coeffs") or "", max(k * k, 1), where, label).reshape(k, k)
    except InputError:
        notes.append(f"{where}: the covariance of {label} is not {k} x {k} numbers, and is left out")
        return camera
    J = np.zeros((len(names), k))
    ours_of = {"f": ("fx", "fy"), "b1": ("fx",), "p1": ("p2",), "p2": ("p1",)}
    for column, name in enumerate(stated):
        J[[names.index(each) for each in ours_of.get(name, (name,)) if each in names], column] = 1.0
    cov = J @ C @ J.T
    return camera.with_parameters(camera.parameters, (cov + cov.T) / 2)


def _left_px(p: Mapping[str, float], model: Model, size_px: tuple[int, int]) -> float:
    """At most so many pixels at a corner of the picture by the terms that our models do not have."""
    half = np.hypot(*size_px) / 2 / p["f"]
    if model == "perspective":
        return float(abs(p["b2"]) * half + p["f"] * abs(p["k4"]) * half**9)
    return float(abs(p["b2"]) * half + 3 * p["f"] * np.hypot(p["p1"], p["p2"]) * half**2)
