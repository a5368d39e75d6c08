"""Interior orientations in files of other programs: COLMAP's ``cameras.txt``, OpenCV and ROS (YAML, JSON).

COLMAP counts pixels from the upper left corner of the picture, as Thalweg does; OpenCV and ROS from the
centre of the first pixel, so 0.5 is added to their cx and cy on reading and taken off on writing. None of
these files says how well the numbers are known; Thalweg's own calibration files do
(`thalweg.core.calibration.files`).
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core.camera.model import PARAMETERS, Camera, Model
from thalweg.core.errors import GeometryError, InputError, UnsupportedError
from thalweg.core.types import ArrayF
from thalweg.core.yaml_lines import parse_yaml

COLMAP_MODELS: Final[dict[str, tuple[Model, tuple[str, ...]]]] = {
    "SIMPLE_PINHOLE": ("perspective", ("f", "cx", "cy")),
    "PINHOLE": ("perspective", ("fx", "fy", "cx", "cy")),
    "SIMPLE_RADIAL": ("perspective", ("f", "cx", "cy", "k1")),
    "RADIAL": ("perspective", ("f", "cx", "cy", "k1", "k2")),
    "OPENCV": ("perspective", ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")),
    "FULL_OPENCV": (
        "perspective", ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    ),
    "SIMPLE_RADIAL_FISHEYE": ("fisheye", ("f", "cx", "cy", "k1")),
    "RADIAL_FISHEYE": ("fisheye", ("f", "cx", "cy", "k1", "k2")),
    "OPENCV_FISHEYE": ("fisheye", ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")),
}  # fmt: skip
"""Model of COLMAP -> model of `thalweg.core.camera.model`, names of its parameters; k4 to k6 are a
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
    "D", "distortion_coefficients", "dist_coeffs", "distCoeffs", "dist_coeff", "Distortion_Coefficients",
    "distortion_coeffs",
)  # fmt: skip
_WIDTH: Final = ("width", "image_width", "image_Width")
_HEIGHT: Final = ("height", "image_height", "image_Height")
_MODEL: Final = ("distortion_model", "camera_model", "model")
_FISHEYE: Final = {"fisheye", "equidistant", "kannala_brandt", "kannalabrandt", "kannala_brandt4"}
_PERSPECTIVE: Final = {
    "plumb_bob",
    "radtan",
    "brown",
    "rational_polynomial",
    "pinhole",
    "perspective",
    "opencv",
}
_OPENCV_ORDER: Final = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_HALF: Final = 0.5


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
    """A camera as OpenCV or ROS writes it, YAML or JSON.

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
    kind = model or _model(data, D.size, path)
    size = size_px or _size(data, path)
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
    if not path.is_file():
        raise InputError("file not found", expected="a camera file", where=path)
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
        return Camera(model=model, size_px=size, parameters=p, name=name)
    except GeometryError as error:
        raise InputError(error.found, expected=error.expected, where=where) from error


def _numbers(data: Mapping[str, Any], keys: Sequence[str], path: Path) -> ArrayF:
    key = next((key for key in keys if key in data), None)
    if key is None:
        raise InputError(
            f"none of the keys {', '.join(keys)}", expected="a camera of OpenCV or ROS", where=path
        )
    value = data[key]
    if isinstance(value, dict):
        value = value.get("data")
    try:
        return np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise InputError(f"{key} holds no numbers", expected="a matrix", where=path) from error


def _model(data: Mapping[str, Any], coefficients: int, path: Path) -> Model:
    for key in _MODEL:
        word = str(data.get(key, "")).lower()
        if word in _FISHEYE:
            return "fisheye"
        # "pinhole" alone may have a fisheye's distortion beside it
        if word in _PERSPECTIVE and not (word == "pinhole" and key != "distortion_model"):
            return "perspective"
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
