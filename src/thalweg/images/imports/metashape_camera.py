"""Interior orientations of Metashape (appendix "Camera models" of its manual) as ours.

With ``x = X/Z``, ``y = Y/Z``, ``r^2 = x^2 + y^2``; for a fisheye ``x`` and ``y`` are those times
``atan(r)/r``::

    x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8) + p1 (r^2 + 2 x^2) + 2 p2 x y
    y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8) + p2 (r^2 + 2 y^2) + 2 p1 x y
    u = w/2 + cx + x' f + x' b1 + y' b2,      v = h/2 + cy + y' f

Pixels count from the upper left corner, as ours. ``p1`` and ``p2`` are OpenCV's ``p2`` and ``p1``. A skew
``b2``, the ``k4`` of a perspective lens and tangential parts of a fisheye have no place in our models: the
distortion is fitted over the picture, and the largest difference is told.
"""

from typing import Final
from xml.etree import ElementTree

import numpy as np

from thalweg.core.camera.model import PARAMETERS, Camera, Model
from thalweg.core.errors import GeometryError, InputError
from thalweg.core.types import ArrayF

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
