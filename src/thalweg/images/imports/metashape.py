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

from thalweg.core.camera.model import PARAMETERS, Camera, Model
from thalweg.core.errors import GeometryError, InputError
from thalweg.core.types import ArrayF
from thalweg.images.imports.source import Finished, Place, orthogonal, place_of

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


_TYPES: Final[dict[str, Model]] = {
    "frame": "perspective", "fisheye": "fisheye", "equidistant_fisheye": "fisheye",
}  # fmt: skip
_NAMES: Final = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2")
_GRID: Final = 25
_MOST_PX: Final = 1.0


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
    return np.stack([
        size_px[0] / 2 + p["cx"] + u * (p["f"] + p["b1"]) + v * p["b2"], size_px[1] / 2 + p["cy"] + v *
        p["f"],
    ], axis=1)  # fmt: skip


def _converted(
    p: dict[str, float], model: Model, size_px: tuple[int, int], label: str,
    cov: tuple[tuple[str, ...], ArrayF] | None, where: str, notes: list[str],
) -> Camera | None:  # fmt: skip
    ours = {
        "fx": p["f"] + p["b1"], "fy": p["f"], "cx": size_px[0] / 2 + p["cx"], "cy": size_px[1] / 2 + p["cy"],
        "k1": p["k1"], "k2": p["k2"], "k3": p["k3"], "k4": p["k4"], "p1": p["p2"], "p2": p["p1"],
    }  # fmt: skip
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


# ---------------------------------------------------------------- metashape


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
