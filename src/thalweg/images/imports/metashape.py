"""Cameras XML of Metashape (File, Export, Export Cameras).

``transform`` of a camera is ``T_chunk_ccs`` (ccs as ours: x right, y down, z along the view). The chunk, or
the component of the chunk, has a transform of its own with rotation, translation and scale::

    x_place = scale R x_chunk + translation

For a chunk with a CRS on the earth, ``x_place`` is geocentric in the datum of that CRS, whatever the CRS,
so that neither grid north nor scale come in; for local coordinates it is local. ``location_covariance``
stands in the units and axes of the chunk, ``rotation_covariance`` in radians squared about the axes of the
camera (so Agisoft's own ``save_estimated_reference.py`` uses both)::

    cov_place = (scale R) C_location (scale R)^T,      cov_rotation = R_place_ccs C_rotation R_place_ccs^T
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError

from thalweg.core.camera.model import Camera
from thalweg.core.errors import InputError
from thalweg.core.types import ArrayF
from thalweg.images.imports.metashape_camera import sensor_camera
from thalweg.images.imports.source import Finished, Place, orthogonal, place_of

NOT_ALIGNED: Final = "not aligned in Metashape"
SWITCHED_OFF: Final = "switched off in Metashape"
_FALSE: Final = ("false", "0")
_EARTH: Final = CRS.from_epsg(4978)


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
    place = _place(chunk, path, crs, notes)
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
        program="Metashape", where=str(path), place=place, names=tuple(names), coordinates=coordinates,
        R_place_ccs=R, cov=cov, camera=np.array(index, np.int64), cameras=tuple(cameras), absent=absent,
        notes=tuple(notes),
    )  # fmt: skip


def _chunk(path: Path) -> ElementTree.Element:
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"no XML ({error})", expected="a cameras XML of Metashape", where=path) from error
    chunks = [
        c for c in ([root] if root.tag == "chunk" else root.iter("chunk")) if c.find(".//camera") is not None
    ]
    if len(chunks) != 1:
        raise InputError(
            f"{len(chunks)} chunks with cameras", expected="one", where=path,
            cure="Export the cameras of one chunk: File, Export, Export Cameras, Agisoft XML",
        )  # fmt: skip
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
    return _Chunk(scale, orthogonal(R, str(path), ("the chunk",))[0],
                  _numbers(parts["translation"], 3, path, "the chunk"))  # fmt: skip


def _place(chunk: ElementTree.Element, path: Path, crs: str | None, notes: list[str]) -> Place:
    """Geocentric for a CRS on the earth, else what the campaign says, else a frame of its own."""
    stated = (chunk.findtext("reference") or "").strip()
    if not stated or stated.startswith("LOCAL_CS"):
        return Place(kind="free") if crs is None else place_of(crs, str(path))
    try:
        known = CRS.from_user_input(stated)
    except CRSError as error:
        raise InputError(
            f"the CRS '{stated[:80]}' is not known", expected="a CRS on the earth, or local coordinates",
            where=path, cure="Export in a CRS with an EPSG code",
        ) from error  # fmt: skip
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
