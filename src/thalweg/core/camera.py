"""Interior orientation of a camera: from directions in its frame to pixels and back.

Camera frame ccs: x to the right, y down, z along the view. Pixel coordinates count from the upper left
*corner* of the picture, so that the centre of its first pixel is (0.5, 0.5), as in COLMAP; OpenCV counts from
that centre.

``perspective`` (Brown 1971, in the form of OpenCV and COLMAP), with ``a = X/Z``, ``b = Y/Z`` and
``q = a^2 + b^2``::

    a' = a (1 + k1 q + k2 q^2 + k3 q^3) + 2 p1 a b + p2 (q + 2 a^2)
    b' = b (1 + k1 q + k2 q^2 + k3 q^3) + p1 (q + 2 b^2) + 2 p2 a b
    x = fx a' + cx,   y = fy b' + cy

``fisheye`` (equidistant; P1 eq. 2-3 with the radial part of their corrections), with the angle ``t`` between
ray and view and ``h = sqrt(X^2 + Y^2)``::

    d = t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)
    x = fx d X/h + cx,   y = fy d Y/h + cy

Both limits for ``h -> 0`` are taken, and a fisheye sees beyond 90 degrees.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core.documents import parse_xml, parse_yaml
from thalweg.core.errors import GeometryError, InputError, UnsupportedError, require_file
from thalweg.core.types import ArrayF

Model = Literal["perspective", "fisheye"]
PARAMETERS: Final[dict[str, tuple[str, ...]]] = {
    "perspective": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"),
    "fisheye": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
}
"""Names of the parameters of each model: pixels for the first four, without unit the others."""
_ITERATIONS: Final = 30
_CLOSE: Final = 1e-13

COLMAP_MODELS: Final[dict[str, tuple[Model, tuple[str, ...]]]] = {
    "SIMPLE_PINHOLE": ("perspective", ("f", "cx", "cy")),
    "PINHOLE": ("perspective", ("fx", "fy", "cx", "cy")),
    "SIMPLE_RADIAL": ("perspective", ("f", "cx", "cy", "k1")),
    "RADIAL": ("perspective", ("f", "cx", "cy", "k1", "k2")),
    "OPENCV": ("perspective", ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")),
    "FULL_OPENCV": ("perspective", ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "SIMPLE_RADIAL_FISHEYE": ("fisheye", ("f", "cx", "cy", "k1")),
    "RADIAL_FISHEYE": ("fisheye", ("f", "cx", "cy", "k1", "k2")),
    "OPENCV_FISHEYE": ("fisheye", ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")),
}
"""Model of COLMAP -> model of `thalweg.core.camera`, names of its parameters; k4 to k6 are a
denominator.
"""
_MATRIX: Final = (
    "K",
    "camera_matrix",
    "cameraMatrix",
    "Camera_Matrix",
    "camera_intrinsics",
    "intrinsic_matrix",
)
_DISTORTION: Final = (
    "D",
    "distortion_coefficients",
    "dist_coeffs",
    "distCoeffs",
    "dist_coeff",
    "Distortion_Coefficients",
    "distortion_coeffs",
)
_WIDTH: Final = ("width", "image_width", "image_Width")
_HEIGHT: Final = ("height", "image_height", "image_Height")
_MODEL: Final = ("distortion_model", "camera_model", "model")
_FISHEYE: Final = {
    "fisheye",
    "equidistant",
    "kannala_brandt",
    "kannalabrandt",
    "kannala_brandt4",
    "opencv_fisheye",
}
_PERSPECTIVE: Final = {
    "plumb_bob", "plumbbob", "radtan", "radtan4", "radtan5", "radtan8", "radial_tangential", "brown",
    "brown5", "brown_conrady", "rational", "rational_polynomial", "pinhole", "perspective", "opencv",
    "opencv5", "full_opencv", "standard",
}  # fmt: skip
_OTHER_LENSES: Final = {
    "omni", "omnidir", "omnidirectional", "mei", "ucm", "eucm", "ds", "double_sphere", "scaramuzza", "ocam",
    "ocamcalib", "fov", "ftheta", "division", "thin_prism_fisheye", "spherical", "equirectangular",
    "cylindrical",
}  # fmt: skip
"""Words of `_MODEL` for lenses that are neither."""
_METASHAPE: Final = ("f", "cx", "cy", "b1", "k1", "k2", "k3", "k4", "p1", "p2")
_OPENCV_ORDER: Final = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_TURNED: Final = 0.05
"""Of a picture, that a principal point lies from the middle where width and height may be exchanged."""
_OFF_CENTRE: Final = 0.35
"""Of a picture, that a principal point lies from its middle at most."""
_HALF: Final = 0.5
_N, _Z = r"\s+[-+.\deE]+", r"\s+0\.?0*"
LENS_LINE: Final = re.compile(rf"\s*\d+\s+\d+{_N}{_Z}{_N}{_Z}{_N}{_N}{_Z}{_Z}\s+1\.?0*({_N}){{4,8}}\s*\Z")
"""A file of numbers alone, as ICEpy4D has: width, height, OpenCV's camera matrix by rows, its distortion."""


# ---------------------------------------------------------------- camera


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """Interior orientation.

    Parameters
    ----------
    model : ``perspective`` or ``fisheye``.
    size_px : width and height.
    parameters : (k,) in the order of `PARAMETERS`.
    cov : (k, k) covariance of the parameters.
    name : for tables and messages.

    Raises
    ------
    GeometryError : an unknown model, a wrong number of parameters, or focal lengths that are not positive.
    """

    model: Model
    size_px: tuple[int, int]
    parameters: ArrayF
    cov: ArrayF = field(default_factory=lambda: np.zeros((0, 0)))
    name: str = "camera"

    def __post_init__(self) -> None:
        names = PARAMETERS.get(self.model)
        if names is None:
            raise GeometryError(f"camera model {self.model!r}", expected=f"one of {', '.join(PARAMETERS)}")
        p = np.asarray(self.parameters, dtype=np.float64)
        C = np.asarray(self.cov, dtype=np.float64)
        C = np.zeros((len(names), len(names))) if C.size == 0 else C
        if p.shape != (len(names),) or not np.isfinite(p).all() or not (p[:2] > 0).all():
            raise GeometryError(
                f"parameters {np.round(p, 6).tolist()} of the camera {self.name!r}",
                expected=f"{len(names)} numbers {', '.join(names)} with positive focal lengths",
            )
        if C.shape != (len(names), len(names)) or not np.allclose(C, C.T, atol=1e-30):
            raise GeometryError(
                f"a covariance of the shape {C.shape} of the camera {self.name!r}",
                expected=f"a symmetric {len(names)}x{len(names)} matrix",
            )
        if min(self.size_px) < 1:
            raise GeometryError(f"a picture of {self.size_px} pixels", expected="positive numbers")
        object.__setattr__(self, "parameters", p)
        object.__setattr__(self, "cov", C)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return PARAMETERS[self.model]

    def with_parameters(self, parameters: ArrayF, cov: ArrayF | None = None) -> "Camera":
        """The same camera with other parameters and, if given, their covariance."""
        given = self.cov if cov is None else cov
        return Camera(
            model=self.model, size_px=self.size_px, parameters=parameters, cov=given, name=self.name
        )

    def scaled(self, size_px: tuple[int, int]) -> "Camera":
        """The same lens and sensor with larger or smaller pixels: a camera set to another picture size.

        Raises
        ------
        GeometryError : the sides have another ratio, so that the new picture would be a part of the old one.
        """
        factor = np.array([new / old for new, old in zip(size_px, self.size_px, strict=True)])
        # a picture of whole pixels is up to half a pixel off the ratio on either side
        if abs(factor[0] / factor[1] - 1) > 0.5 / min(size_px) + 0.5 / min(self.size_px):
            raise GeometryError(
                f"a picture of {size_px[0]} x {size_px[1]} pixels, and a calibration of the camera "
                f"{self.name!r} for {self.size_px[0]} x {self.size_px[1]}",
                expected="the same ratio of the sides",
                cure="Calibrate the camera with the picture format of the survey, or leave its interior "
                "orientation to be estimated",
            )
        scale = np.ones(len(self.parameters))
        scale[:4] = factor[[0, 1, 0, 1]]
        return Camera(
            model=self.model,
            size_px=size_px,
            parameters=self.parameters * scale,
            cov=self.cov * np.outer(scale, scale),
            name=self.name,
        )

    def project(self, points_ccs: ArrayLike) -> ArrayF:
        """Pixels (n, 2) of points (n, 3); NaN for points that the model cannot image.

        A perspective camera images what is in front of it. Far outside the picture its polynomial may fold
        back into it: directions beyond where its radius stops growing give NaN, too. A point outside the
        picture keeps its numbers; ask `inside`.
        """
        points = np.atleast_2d(np.asarray(points_ccs, dtype=np.float64))
        plane = _perspective if self.model == "perspective" else _fisheye
        uv = plane(points, self.parameters[4:], derivatives=False)[0]
        return np.asarray(uv * self.parameters[:2] + self.parameters[2:4])

    def inside(self, xy_px: ArrayF, margin_px: float = 0.0) -> ArrayF:
        """Whether pixels (n, 2) lie in the picture, at least a margin away from its edges."""
        low, high = margin_px, np.asarray(self.size_px) - margin_px
        with np.errstate(invalid="ignore"):
            return np.asarray(((xy_px >= low) & (xy_px <= high)).all(axis=1))

    def project_with_derivatives(self, points_ccs: ArrayLike) -> tuple[ArrayF, ArrayF, ArrayF]:
        """Pixels (n, 2), their derivatives (n, 2, 3) by the points and (n, 2, k) by the parameters."""
        points = np.atleast_2d(np.asarray(points_ccs, dtype=np.float64))
        plane = _perspective if self.model == "perspective" else _fisheye
        uv, by_point, by_shape = plane(points, self.parameters[4:])
        f = self.parameters[:2]
        by_parameters = np.zeros((len(points), 2, len(self.parameters)))
        by_parameters[:, 0, 0], by_parameters[:, 1, 1] = uv[:, 0], uv[:, 1]
        by_parameters[:, 0, 2] = by_parameters[:, 1, 3] = 1.0
        by_parameters[:, :, 4:] = f[:, None] * by_shape
        return uv * f + self.parameters[2:4], f[:, None] * by_point, by_parameters

    def rays(self, xy_px: ArrayLike) -> ArrayF:
        """Unit directions (n, 3) in ccs of pixels (n, 2): the inverse of `project`; NaN where none is."""
        xy = np.atleast_2d(np.asarray(xy_px, dtype=np.float64))
        uv = (xy - self.parameters[2:4]) / self.parameters[:2]
        if self.model == "fisheye":
            return _fisheye_rays(uv, self.parameters[4:])
        return _perspective_rays(uv, self.parameters[4:])


_NONE: Final = np.empty(0)
"""Derivatives that nobody asked for."""


def _perspective(points: ArrayF, shape: ArrayF, *, derivatives: bool = True) -> tuple[ArrayF, ArrayF, ArrayF]:
    z = np.where(points[:, 2] > 0, points[:, 2], np.nan)
    a, b = points[:, 0] / z, points[:, 1] / z
    q = a * a + b * b
    uv, a, by_ab = _distorted(a, b, shape, derivatives=derivatives)
    if not derivatives:
        return uv, _NONE, _NONE
    ab_by_point = np.zeros((len(a), 2, 3))
    ab_by_point[:, 0, 0] = ab_by_point[:, 1, 1] = 1 / z
    ab_by_point[:, 0, 2], ab_by_point[:, 1, 2] = -a / z, -b / z
    by_shape = np.stack(
        [
            np.stack([a * q, a * q**2, 2 * a * b, q + 2 * a * a, a * q**3], axis=1),
            np.stack([b * q, b * q**2, q + 2 * b * b, 2 * a * b, b * q**3], axis=1),
        ],
        axis=1,
    )
    return uv, by_ab @ ab_by_point, by_shape


def _distorted(a: ArrayF, b: ArrayF, shape: ArrayF, *, derivatives: bool) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Places (n, 2) of directions (a, b, 1); a, NaN where none is; derivatives (n, 2, 2) by (a, b)."""
    k1, k2, p1, p2, k3 = shape
    q = a * a + b * b
    radial = 1 + q * (k1 + q * (k2 + q * k3))
    slope = k1 + q * (2 * k2 + 3 * k3 * q)
    # Where the distorted radius no longer grows the polynomial folds back.
    a = np.where(radial + 2 * q * slope > 0, a, np.nan)
    uv = np.stack(
        [
            a * radial + 2 * p1 * a * b + p2 * (q + 2 * a * a),
            b * radial + p1 * (q + 2 * b * b) + 2 * p2 * a * b,
        ],
        axis=1,
    )
    if not derivatives:
        return uv, a, _NONE
    by_ab = np.empty((len(a), 2, 2))
    by_ab[:, 0, 0] = radial + 2 * a * a * slope + 2 * p1 * b + 6 * p2 * a
    by_ab[:, 0, 1] = by_ab[:, 1, 0] = 2 * a * b * slope + 2 * p1 * a + 2 * p2 * b
    by_ab[:, 1, 1] = radial + 2 * b * b * slope + 6 * p1 * b + 2 * p2 * a
    return uv, a, by_ab


def _fisheye(points: ArrayF, shape: ArrayF, *, derivatives: bool = True) -> tuple[ArrayF, ArrayF, ArrayF]:
    x, y, z = points.T
    h2 = x * x + y * y
    h, r2 = np.sqrt(h2), h2 + z * z
    t = np.arctan2(h, z)
    t2 = t * t
    poly = 1 + t2 * (shape[0] + t2 * (shape[1] + t2 * (shape[2] + t2 * shape[3])))
    slope = 1 + t2 * (3 * shape[0] + t2 * (5 * shape[1] + t2 * (7 * shape[2] + t2 * 9 * shape[3])))
    d = np.where(slope > 0, t * poly, np.nan)
    # On the axis d/h -> 1/z; behind the camera the axis itself has no image.
    on_axis = h < 1e-12 * np.sqrt(r2)
    safe_h = np.where(on_axis, 1.0, h)
    ahead = np.where(z > 0, z, np.nan)
    ratio = np.where(on_axis, 1.0 / ahead, d / safe_h)
    uv = np.stack([x * ratio, y * ratio], axis=1)
    if not derivatives:
        return uv, _NONE, _NONE
    # d ratio / dh at constant z, over h; and d ratio / dz
    with np.errstate(divide="ignore", invalid="ignore"):
        by_h = np.where(on_axis, 0.0, (slope * z / r2 - ratio) / np.where(on_axis, 1.0, h2))
        by_z = np.where(on_axis, 0.0, -slope / r2)
    by_point = np.empty((len(points), 2, 3))
    by_point[:, 0, 0], by_point[:, 1, 1] = ratio + x * x * by_h, ratio + y * y * by_h
    by_point[:, 0, 1] = by_point[:, 1, 0] = x * y * by_h
    by_point[:, 0, 2], by_point[:, 1, 2] = x * by_z, y * by_z
    unit = np.stack([x, y], axis=1) / safe_h[:, None]
    powers = np.stack([t**3, t**5, t**7, t**9], axis=1)
    return uv, by_point, unit[:, :, None] * powers[:, None, :]


def _perspective_rays(uv: ArrayF, shape: ArrayF) -> ArrayF:
    """Newton steps on the distortion from the undistorted start."""
    ab = uv.copy()
    for _ in range(_ITERATIONS):
        got, _, J = _distorted(ab[:, 0], ab[:, 1], shape, derivatives=True)
        off = uv - got
        det = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
        with np.errstate(invalid="ignore", divide="ignore"):
            step = (
                np.stack(
                    [
                        J[:, 1, 1] * off[:, 0] - J[:, 0, 1] * off[:, 1],
                        J[:, 0, 0] * off[:, 1] - J[:, 1, 0] * off[:, 0],
                    ],
                    axis=1,
                )
                / det[:, None]
            )
        ab = ab + step
        if not np.nanmax(np.abs(step), initial=0.0) > _CLOSE:
            break
    ray = np.concatenate([ab, np.ones((len(ab), 1))], axis=1)
    return np.asarray(ray / np.linalg.norm(ray, axis=1, keepdims=True))


def _fisheye_rays(uv: ArrayF, shape: ArrayF) -> ArrayF:
    d = np.hypot(uv[:, 0], uv[:, 1])
    t = np.minimum(d, np.pi)
    for _ in range(_ITERATIONS):
        t2 = t * t
        poly = 1 + t2 * (shape[0] + t2 * (shape[1] + t2 * (shape[2] + t2 * shape[3])))
        slope = 1 + t2 * (3 * shape[0] + t2 * (5 * shape[1] + t2 * (7 * shape[2] + t2 * 9 * shape[3])))
        step = (d - t * poly) / np.where(slope > 0, slope, np.nan)
        t = t + step
        if not np.nanmax(np.abs(step), initial=0.0) > _CLOSE:
            break
    t = np.where((t >= 0) & (t <= np.pi), t, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = np.where(d[:, None] > 0, uv / np.where(d > 0, d, 1.0)[:, None], 0.0)
    return np.concatenate([np.sin(t)[:, None] * unit, np.cos(t)[:, None]], axis=1)


# ---------------------------------------------------------------- files of COLMAP, OpenCV and ROS
#
# COLMAP counts pixels from the upper left corner of the picture, as Thalweg does; OpenCV and ROS from the
# centre of the first pixel, so 0.5 is added to their cx and cy on reading and taken off on writing. None of
# these files says how well the numbers are known; Thalweg's own calibration files do
# (`thalweg.core.calibration.model`).


def read_colmap(path: Path) -> dict[int, Camera]:
    """Cameras of a ``cameras.txt`` by their number.

    Raises
    ------
    InputError : no such file, or a line that is no camera.
    UnsupportedError : a model that Thalweg has not, or a denominator in FULL_OPENCV.
    """
    cameras: dict[int, Camera] = {}
    for number, line in enumerate(_text(path).splitlines(), start=1):
        words = line.split("#")[0].split()
        if not words:
            continue
        where = f"{path}:{number}"
        model = COLMAP_MODELS.get(words[1]) if len(words) > 1 else None
        if len(words) > 1 and model is None and words[0].isdigit():
            expected = f"one of {', '.join(COLMAP_MODELS)}"
            raise UnsupportedError(f"camera model {words[1]}", expected=expected, where=where)
        try:
            key, size = int(words[0]), (int(words[2]), int(words[3]))
            values = [float(word) for word in words[4:]]
        except (ValueError, IndexError):
            model = None
        if model is None or len(values) != len(model[1]):
            names = f"{', '.join(model[1])}" if model else "parameters"
            raise InputError(
                f"no camera: {line.strip()[:60]!r}",
                expected=f"number model width height {names}",
                where=where,
            )
        if key in cameras:
            raise InputError(f"camera {key} stands twice", expected="each camera once", where=where)
        cameras[key] = _named(
            model[0], size, dict(zip(model[1], values, strict=True)), f"camera_{key}", where
        )
    if not cameras:
        raise InputError("no camera", expected="COLMAP's cameras.txt", where=path)
    return cameras


def read_metashape(path: Path) -> Camera:
    """A lens that Metashape or PhotoScan saved alone (XML), see `from_metashape`.

    Raises
    ------
    InputError : no such file, or numbers that are none.
    UnsupportedError : a skew, a fourth radial or a higher tangential term other than zero.
    """
    root = parse_xml(_text(path), path, "a lens that Metashape saved")
    try:
        found = {e.tag: (e.text or "").strip() for e in root}
        size = (int(found["width"]), int(found["height"]))
        p = {k: float(found.get(k, 0.0)) for k in _METASHAPE}
        lost = {k: float(found[k]) for k in ("b2", "p3", "p4") if float(found.get(k, 0.0)) != 0.0}
    except (KeyError, ValueError) as error:
        raise InputError(f"no lens: {error}", expected="width, height, f and so on", where=path) from error
    projection = found.get("projection", "frame")
    if projection not in ("frame", "fisheye", "equidistant_fisheye"):
        raise UnsupportedError(
            f"the projection {projection}", expected="frame or equidistant_fisheye", where=path
        )
    model: Model = "perspective" if projection == "frame" else "fisheye"
    lost |= {k: p[k] for k in (("k4",) if model == "perspective" else ("p1", "p2")) if p[k]}
    if lost:
        raise UnsupportedError(
            f"terms of the lens that Thalweg's {model} model has not: {lost}",
            expected="them to be zero",
            where=path,
            cure="Fix them at zero in Metashape (Optimize Cameras) and export again",
        )
    known = {k: v for k, v in from_metashape(p, size).items() if k in PARAMETERS[model]}
    return _named(model, size, known, "camera", str(path))


def from_metashape(p: Mapping[str, float], size_px: tuple[int, int]) -> dict[str, float]:
    """Our parameters of Metashape's, by the equations of its manual, appendix C, for both models.

    Its ``cx, cy`` count from the middle of the picture, its ``p1`` and ``p2`` are OpenCV's ``p2`` and ``p1``.
    """
    width, height = size_px
    same = {name: p[name] for name in ("k1", "k2", "k3", "k4")}
    lens = {"fx": p["f"] + p["b1"], "fy": p["f"], "cx": width / 2 + p["cx"], "cy": height / 2 + p["cy"]}
    return lens | same | {"p1": p["p2"], "p2": p["p1"]}


def write_colmap(path: Path, cameras: Mapping[int, Camera]) -> None:
    """Write a ``cameras.txt``: OPENCV, FULL_OPENCV where there is a k3, or OPENCV_FISHEYE."""
    lines = [
        "# Camera list with one line of data per camera:",
        "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]",
    ]
    for key, camera in cameras.items():
        p = dict(zip(camera.parameter_names, camera.parameters.tolist(), strict=True))
        name = "OPENCV_FISHEYE" if camera.model == "fisheye" else "FULL_OPENCV" if p["k3"] else "OPENCV"
        values = " ".join(repr(float(p.get(k, 0.0))) for k in COLMAP_MODELS[name][1])
        lines.append(f"{key} {name} {camera.size_px[0]} {camera.size_px[1]} {values}")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


def read_opencv(path: Path, model: Model | None = None, size_px: tuple[int, int] | None = None) -> Camera:
    """A camera as OpenCV or ROS writes it, YAML or JSON, or as a line of numbers (`LENS_LINE`).

    Parameters
    ----------
    path : file with a camera matrix (``K``, ``camera_matrix`` ...) and a distortion (``D``, ``dist_coeffs``
    ...).
    model : needed where the file does not say it: four coefficients may be Brown's or a fisheye's.
    size_px : width and height, needed where the file does not say them.

    Raises
    ------
    InputError : the file is missing or no such file; model or size are not stated.
    UnsupportedError : a skew, thin prisms or a denominator other than zero.
    """
    text = _text(path)
    if LENS_LINE.match(text):
        v = text.split()
        text = (
            f"image_width: {v[0]}\nimage_height: {v[1]}\ndistortion_model: plumb_bob\n"
            f"camera_matrix: [{', '.join(v[2:11])}]\ndistortion_coefficients: [{', '.join(v[11:])}]\n"
        )
    if "opencv-matrix" in text or text.startswith("%YAML"):
        # OpenCV's head is that of no YAML version, and its tag is its own
        rows = [row for row in text.splitlines() if not row.startswith("%")]
        text = "\n".join(rows).replace("!!opencv-matrix", "")
    document = parse_yaml(text)
    data = document.data
    if document.mistakes or not isinstance(data, dict):
        found = document.mistakes[0].found if document.mistakes else "no keys with values"
        raise InputError(found, expected="a camera of OpenCV or ROS", where=path)
    K, D = _numbers(data, _MATRIX, path), _numbers(data, _DISTORTION, path)
    if K.size != 9:
        raise InputError(f"a camera matrix of {K.size} numbers", expected="3 x 3", where=path)
    K = K.reshape(3, 3)
    if abs(K[0, 1]) > 1e-9 or abs(K[1, 0]) > 1e-9 or not np.allclose(K[2], [0, 0, 1]):
        raise UnsupportedError(
            f"a camera matrix with skew: {K.tolist()}", expected="fx 0 cx, 0 fy cy, 0 0 1", where=path
        )
    kind = model or _model(data, D.size, path, distorted=bool(np.any(D)))
    size = size_px or _size(data, path)
    region = data.get("roi")
    if isinstance(region, dict) and (region.get("x_offset") or region.get("y_offset")):
        raise UnsupportedError(
            f"pictures that are a part of {size[0]} x {size[1]} pixels: roi {region}",
            expected="whole pictures",
            where=path,
            cure="Take x_offset and y_offset off the principal point and write the size of the part",
        )
    names = ("k1", "k2", "k3", "k4") if kind == "fisheye" else _OPENCV_ORDER
    if D.size > len(names) and np.any(D[len(names) :]):
        raise UnsupportedError(
            f"{D.size} distortion coefficients", expected=f"{', '.join(names)}", where=path
        )
    values = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2] + _HALF, "cy": K[1, 2] + _HALF}
    values |= dict(zip(names, D[: len(names)].tolist(), strict=False))
    name = data.get("camera_name")
    return _named(kind, size, values, name if isinstance(name, str) and name else path.stem, str(path))


def write_opencv(path: Path, camera: Camera) -> None:
    """Write a camera as ROS and OpenCV read it: YAML with ``!!opencv-matrix``, or JSON for ``.json``."""
    fx, fy, cx, cy = camera.parameters[:4].tolist()
    K = [fx, 0.0, cx - _HALF, 0.0, fy, cy - _HALF, 0.0, 0.0, 1.0]
    D = camera.parameters[4:].tolist()
    model = "equidistant" if camera.model == "fisheye" else "plumb_bob"
    path.parent.mkdir(parents=True, exist_ok=True)
    head: dict[str, Any] = {
        "camera_name": camera.name,
        "image_width": camera.size_px[0],
        "image_height": camera.size_px[1],
        "distortion_model": model,
    }
    if path.suffix.lower() == ".json":
        rows = [K[:3], K[3:6], K[6:]]
        path.write_text(
            json.dumps({**head, "camera_matrix": rows, "distortion_coefficients": D}, indent=2) + "\n"
        )
        return
    lines = ["%YAML:1.0", "---", *(f"{key}: {json.dumps(value)}" for key, value in head.items())]
    for key, rows_, cols, values in (("camera_matrix", 3, 3, K), ("distortion_coefficients", 1, len(D), D)):
        lines += [f"{key}: !!opencv-matrix", f"   rows: {rows_}", f"   cols: {cols}", "   dt: d"]
        lines.append(f"   data: [ {', '.join(repr(float(v)) for v in values)} ]")
    path.write_text("\n".join(lines) + "\n")


def _text(path: Path) -> str:
    require_file(path, "a camera file")
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError("no text file", expected="a camera file in UTF-8", where=path) from error


def _named(model: Model, size: tuple[int, int], values: Mapping[str, float], name: str, where: str) -> Camera:
    extra = {
        k: v for k, v in values.items() if k in {"k4", "k5", "k6"} and model == "perspective" and v != 0.0
    }
    if extra:
        raise UnsupportedError(
            f"a rational distortion ({', '.join(f'{k} = {v:g}' for k, v in extra.items())})",
            expected="k4, k5, k6 = 0: the model of Brown has no denominator",
            where=where,
            cure="Calibrate again without CALIB_RATIONAL_MODEL",
        )
    given = dict(values)
    if "f" in given:
        given["fx"] = given["fy"] = given.pop("f")
    try:
        p = np.array([given.get(k, 0.0) for k in PARAMETERS[model]])
        camera = Camera(model=model, size_px=size, parameters=p, name=name)
    except GeometryError as error:
        raise InputError(error.found, expected=error.expected, where=where) from error
    check_lens(camera, where)
    return camera


def check_lens(camera: Camera, where: str | Path) -> None:
    """Refuse a focal length or a principal point that no lens has behind a picture of this size.

    Raises
    ------
    InputError : parameters in millimetres or without a unit, or those of a picture of another size.
    """
    fx, fy, cx, cy = camera.parameters[:4].tolist()
    w, h = camera.size_px
    off = max(abs(cx / w - 0.5), abs(cy / h - 0.5))
    if off > 3.0 * _TURNED and max(abs(cx / h - 0.5), abs(cy / w - 0.5)) < _TURNED:
        raise InputError(
            f"the principal point {cx:g}, {cy:g} of {w} x {h} pixels",
            expected=f"one near the middle: this is the middle of {h} x {w}",
            where=where,
            cure="Look whether width and height are exchanged, or the picture was turned",
        )
    if min(fx, fy) < 0.1 * max(w, h) or max(fx, fy) > 100.0 * max(w, h) or off > _OFF_CENTRE:
        raise InputError(
            f"focal lengths {fx:g}, {fy:g} and principal point {cx:g}, {cy:g} of {w} x {h} pixels",
            expected="pixels of this very picture, the principal point from its corner and near its middle",
            where=where,
            cure="Look at the unit, at the size, and whether the picture was turned or made smaller",
        )


def _numbers(data: Mapping[str, Any], keys: Sequence[str], path: Path) -> ArrayF:
    named = [key for key in keys if key in data]
    if not named:
        raise InputError(
            f"none of the keys {', '.join(keys)}", expected="a camera of OpenCV or ROS", where=path
        )
    key = named[0]
    value = data[key]
    if other := next((name for name in named if data[name] != value), None):
        raise InputError(
            f"{key} and {other}, which differ", expected="one of them", where=path, cure="Leave the other out"
        )
    if isinstance(value, dict):
        value = value.get("data")
    try:
        return np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise InputError(f"{key} holds no numbers", expected="a matrix", where=path) from error


def _model(data: Mapping[str, Any], coefficients: int, path: Path, *, distorted: bool) -> Model:
    for key in (*_MODEL, "model_type"):
        word = re.sub(r"[ -]+", "_", str(data.get(key) or "").strip().lower())
        if word in _FISHEYE:
            return "fisheye"
        # "pinhole" alone may have a fisheye's distortion beside it
        if word in _PERSPECTIVE and not (word == "pinhole" and key != "distortion_model"):
            return "perspective"
        plain = word in ("", "none", "no_distortion") and not distorted
        if word in _OTHER_LENSES or (key == "distortion_model" and word and not plain):
            raise UnsupportedError(
                f"{key}: {data[key]}",
                expected=f"one of {', '.join(sorted(_PERSPECTIVE | _FISHEYE))}",
                where=path,
                cure="Calibrate with one of these lens models",
            )
    for key in ("fisheye_model", "fisheye"):
        if key in data:
            return "fisheye" if data[key] in (1, True, "1", "true") else "perspective"
    if coefficients in (5, 8, 12, 14):
        return "perspective"
    raise InputError(
        f"{coefficients} distortion coefficients and no distortion_model",
        expected="distortion_model: plumb_bob or fisheye",
        where=path,
        cure="Say which lens it is: add this line to the file",
    )


def _size(data: Mapping[str, Any], path: Path) -> tuple[int, int]:
    width = next((data[k] for k in _WIDTH if k in data), None)
    height = next((data[k] for k in _HEIGHT if k in data), None)
    if not isinstance(width, int) or not isinstance(height, int):
        raise InputError("no size of the picture", expected="image_width and image_height", where=path)
    return width, height
