"""Calibrations that other programs wrote: Kalibr's camera chains, 4x4 matrices, cameras of COLMAP and OpenCV.

Kalibr (``camchain.yaml``, ``camchain-imucam.yaml``) writes for each camera ``cam0``, ``cam1`` ...::

    camera_model: pinhole              intrinsics: [fx, fy, cx, cy]       resolution: [w, h]
    distortion_model: radtan           distortion_coeffs: [k1, k2, p1, p2];    equidistant: [k1, k2, k3, k4]
    camera_model: omni | eucm | ds     intrinsics: [xi, | alpha, beta, | xi, alpha,  fu, fv, pu, pv]
    T_cam_imu: 4x4, x_cam = T_cam_imu @ x_imu      T_cn_cnm1: 4x4, x_cam1 = T_cn_cnm1 @ x_cam0
    timeshift_cam_imu: t_imu = t_cam + timeshift

(OpenVINS writes ``T_imu_cam`` instead of ``T_cam_imu``.) Pixels count from the centre of the first one, those
of Thalweg from its corner: 0.5 is added to cx and cy. The axes of the IMU are taken for those of ics. None of
these files states how well it is known, so whoever imports one must say it.
"""

from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core import (
    PARAMETERS,
    ArrayF,
    Camera,
    ConfigError,
    GeometryError,
    InputError,
    Model,
    Rigid,
    UnsupportedError,
    check_lens,
    read_colmap,
    read_mapping,
    read_metashape,
    read_opencv,
)
from thalweg.core.calibration.model import Block, Calibration, Source, lever_doubt, pose_block
from thalweg.core.geometry import nearest_rotation

MODELS: Final[Mapping[str, Model]] = {"radtan": "perspective", "equidistant": "fisheye"}
"""Kalibr's distortion of a pinhole camera -> model of `thalweg.core.camera`."""

SPHERES: Final[Mapping[str, tuple[int, Callable[..., ArrayF]]]] = {
    "omni": (1, lambda s, c, xi: s / (c + xi)),
    "eucm": (2, lambda s, c, alpha, beta: s / (alpha * np.sqrt(beta * s * s + c * c) + (1 - alpha) * c)),
    "ds": (2, lambda s, c, xi, alpha: s / (alpha * np.hypot(s, xi + c) + (1 - alpha) * (xi + c))),
}
"""Models by a sphere: number of shape parameters, and the radius in units of the focal length by sine and
cosine of the angle from the axis (Mei and Rives 2007; Khomutenko et al. 2016; Usenko et al. 2018)."""

_CLOSE_PX: Final = 0.02
"""A model by a sphere must become a fisheye within so much."""

COEFFICIENTS: Final = tuple(dict.fromkeys(name for names in PARAMETERS.values() for name in names[4:]))
SIGMAS: Final = {
    "angle_deg": "rotations about each axis, degrees",
    "lever_m": "coordinates of the lever arm, metres",
    "focal_px": "focal lengths, pixels",
    "centre_px": "principal point, pixels",
    "distortion": "each distortion coefficient",
    "time_s": "offset of the camera's clock, seconds",
    **{name: f"the distortion coefficient {name}" for name in COEFFICIENTS},
}
"""Standard deviations that an import may need; of a coefficient by its name instead of ``distortion``."""

ORTHOGONAL: Final = 1e-4
"""Rotation matrices are written with five digits or more (CloudCompare has six and more)."""

CLOCK_EQUATION: Final = "t_gps_s = t_camera_s + offset_s"


@dataclass(frozen=True, slots=True, kw_only=True)
class KalibrCamera:
    """One camera of a chain, as Thalweg counts: pixels from the corner, poses as ``T_target_source``.

    Parameters
    ----------
    name : ``cam0``.
    camera : interior orientation, without covariance.
    T_ics_ccs : place on the IMU; None if the file has no IMU.
    T_ccs_previous : ``T_cn_cnm1``, from the frame of the camera before; None for the first one.
    offset_s : ``t_gps_s = t_camera_s + offset_s``; None if not stated.
    """

    name: str
    camera: Camera
    T_ics_ccs: Rigid | None
    T_ccs_previous: Rigid | None
    offset_s: float | None


def read_kalibr(path: Path) -> list[KalibrCamera]:
    """Cameras of a Kalibr chain.

    Raises
    ------
    ConfigError : no valid YAML, a key is missing or holds something else.
    InputError : a matrix is none, or its shift is in millimetres.
    UnsupportedError : a camera model other than pinhole with radtan or equidistant distortion, or omni, eucm
        and ds without one.
    """
    data, lines = read_mapping(path)
    names = [name for name in data if name.startswith("cam") and name[3:].isdigit()]
    if not names:
        raise ConfigError("no camera", where=path, expected="sections cam0, cam1 ... as Kalibr writes them")
    names.sort(key=lambda name: int(name[3:]))
    return [_camera(path, lines, name, data[name]) for name in names]


def _camera(path: Path, lines: Mapping[tuple[str, ...], int], name: str, data: Any) -> KalibrCamera:
    def where(key: str) -> str:
        """File and line of a key of this camera."""
        return f"{path}:{lines.get((name, key), lines.get((name,), 1))}"

    def numbers(key: str, n: int) -> ArrayF:
        """That many numbers of a key."""
        value = data.get(key) if isinstance(data, dict) else None
        try:
            out = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            out = np.zeros(0)
        if out.shape != (n,) or not np.isfinite(out).all():
            raise ConfigError(f"{name}.{key}: found {value!r}", where=where(key), expected=f"{n} numbers")
        return out

    def pose(key: str) -> Rigid | None:
        """The motion of a key; None if it is not given."""
        if data.get(key) is None:
            return None
        place = f"{where(key)}: {name}.{key}"
        return _near(rigid_of(data[key], where=place), place)

    size = numbers("resolution", 2)
    kinds = (str(data.get("camera_model")), str(data.get("distortion_model")))
    plain = kinds[1] == "none" or not np.any(data.get("distortion_coeffs") or [0.0])
    if kinds[0] in SPHERES and plain:
        model: Model = "fisheye"
        values = numbers("intrinsics", SPHERES[kinds[0]][0] + 4)
        parameters = fisheye_of_sphere(kinds[0], values, size, f"{where('camera_model')}: {name}")
    elif kinds[0] == "pinhole" and kinds[1] in MODELS:
        model = MODELS[kinds[1]]
        parameters = np.zeros(len(PARAMETERS[model]))
        parameters[:8] = np.concatenate([numbers("intrinsics", 4), numbers("distortion_coeffs", 4)])
    else:
        raise UnsupportedError(
            f"{name}: camera model {kinds[0]} with distortion {kinds[1]}",
            where=where("distortion_model" if kinds[0] in {"pinhole", *SPHERES} else "camera_model"),
            expected=f"pinhole with {' or '.join(MODELS)}, or {', '.join(SPHERES)} with none",
            cure="Calibrate again with --models pinhole-radtan, pinhole-equi or omni-none",
        )
    parameters[2:4] += 0.5
    shift = data.get("timeshift_cam_imu")
    if shift is not None and (isinstance(shift, bool) or not isinstance(shift, int | float)):
        raise ConfigError(
            f"{name}.timeshift_cam_imu: found {shift!r}", where=where("timeshift_cam_imu"), expected="seconds"
        )
    try:
        camera = Camera(model=model, size_px=(int(size[0]), int(size[1])), parameters=parameters, name=name)
    except GeometryError as error:
        raise ConfigError(error.found, where=where("intrinsics"), expected=error.expected) from error
    check_lens(camera, where("intrinsics"))
    to_imu = pose("T_cam_imu")
    return KalibrCamera(
        name=name,
        camera=camera,
        T_ics_ccs=to_imu.inverse() if to_imu else pose("T_imu_cam"),
        T_ccs_previous=pose("T_cn_cnm1"),
        offset_s=None if shift is None else float(shift),
    )


def fisheye_of_sphere(kind: str, values: ArrayF, size_px: ArrayF, where: str = "") -> ArrayF:
    """Parameters of a fisheye (`thalweg.core.camera`) that images like a model by a sphere.

    Parameters
    ----------
    kind : key of `SPHERES`.
    values : its shape parameters, then fu, fv, pu, pv, pixels.
    size_px : (2,) width and height: the fisheye is fitted as far as the picture reaches, to at most 0.95 of
        the angle that the model images.
    where : file and line, for the message.

    Raises
    ------
    UnsupportedError : the fisheye's four coefficients do not follow the model.
    """
    n, radius = SPHERES[kind]
    shape, (fu, fv, pu, pv) = values[:n], values[n:]
    angle = np.deg2rad(np.arange(0.1, 175.0, 0.1))
    with np.errstate(divide="ignore", invalid="ignore"):
        d = radius(np.sin(angle), np.cos(angle), *shape)
        # beyond the first place where the radius no longer grows the model images nothing
        grows = np.isfinite(d) & (np.diff(d, prepend=0.0) > 0)
    last = len(d) if grows.all() else int(np.argmin(grows))
    corner = np.hypot(max(pu, size_px[0] - pu) / fu, max(pv, size_px[1] - pv) / fv)
    reach = min(int(0.95 * last), int(np.searchsorted(d[:last], corner)) + 1)
    residual, parameters = np.inf, np.zeros(8)
    if fu > 0 and fv > 0 and reach >= 2 * len(parameters):
        t, wanted = angle[:reach], d[:reach]
        # denser towards the end, where a polynomial goes astray
        weight = 1 / np.sqrt(1.02 - (t / t[-1]) ** 2)
        A = t[:, None] ** np.arange(1, 10, 2)
        c = np.linalg.lstsq(A * weight[:, None], wanted * weight, rcond=None)[0]
        residual = float(np.abs(A @ c - wanted).max() * max(fu, fv))
        parameters = np.array([fu * c[0], fv * c[0], pu, pv, *(c[1:] / c[0])])
    if not residual <= _CLOSE_PX:
        raise UnsupportedError(
            f"camera model {kind} with {values.round(4).tolist()}",
            where=where,
            expected=f"one that a fisheye with four coefficients follows within {_CLOSE_PX} px",
            cure="Calibrate again with --models pinhole-equi",
        )
    return parameters


def import_kalibr(path: Path, sigmas: Mapping[str, float], *, run: str = "") -> Calibration:
    """Calibration of a Kalibr chain with stated standard deviations, uncorrelated.

    Blocks: ``camera`` (place in ics), ``camera_interior``, ``camera_clock`` for cam0; the same with its
    number (``camera_1``) for a further one. Without IMU the place of a further camera is
    ``camera_1_camera_0``, where ``camera_0`` is cam0.

    Parameters
    ----------
    path : camchain file.
    sigmas : standard deviations, keys of `SIGMAS`; a key that the file has no use for may be missing.
    run : name of the recording; the name of the file by default.

    Raises
    ------
    ConfigError, UnsupportedError : see `read_kalibr`.
    InputError : a sigma that is needed is not stated, or is negative; or see `read_kalibr`.
    """
    parts: list[tuple[Block, ArrayF]] = []
    for k, found in enumerate(read_kalibr(path)):
        name = "camera" if k == 0 else f"camera_{k}"
        if found.T_ics_ccs is not None:
            pose = found.T_ics_ccs.with_cov(_pose_cov(sigmas, path))
            parts.append(pose_block(name, pose, target="ics", source="ccs"))
        elif k and found.T_ccs_previous is not None:
            pose = found.T_ccs_previous.with_cov(_pose_cov(sigmas, path))
            before = f"camera_{k - 1}"
            parts.append(
                pose_block(f"camera_{k}_{before}", pose, target="ccs", source="ccs", facts={"source": before})
            )
        # Kalibr has no k3
        held = {"k3"} if found.camera.model == "perspective" else set()
        parts.append(_interior(f"{name}_interior", found.camera, sigmas, path, held))
        if found.offset_s is not None:
            clock = Block(
                name=f"{name}_clock",
                quantities=("offset_s",),
                values=np.array([found.offset_s]),
                equation=CLOCK_EQUATION,
            )
            parts.append((clock, np.array([[_sigma(sigmas, "time_s", path) ** 2]])))
    return _joined(
        parts, title=f"Kalibr: {path.name}", run=run or path.stem, method="Kalibr, sigmas as stated"
    )


def import_camera(
    path: Path,
    sigmas: Mapping[str, float],
    *,
    kind: str,
    number: int | None = None,
    model: Model | None = None,
    size_px: tuple[int, int] | None = None,
    name: str = "camera",
) -> Calibration:
    """Interior orientation of a file of COLMAP, OpenCV or ROS with stated standard deviations, uncorrelated.

    Coefficients that are exactly zero beside others are no part of the model that was calibrated: the sigma
    of ``distortion`` is not theirs. Where all are zero nobody calibrated any, and it is that of the radial
    ones. A sigma by the name of a parameter always counts. The facts of the block name what is ``held``.

    Parameters
    ----------
    path : ``cameras.txt``, or YAML or JSON of OpenCV or ROS.
    sigmas : ``focal_px``, ``centre_px``, ``distortion``, or names of parameters.
    kind : ``colmap``, ``opencv`` or ``metashape_lens``.
    number : of the camera, where COLMAP has several.
    model, size_px : where a file of OpenCV does not say them.
    name : the block is ``<name>_interior``.

    Raises
    ------
    InputError, UnsupportedError : see `read_colmap` and `read_opencv`; or no such camera, or a sigma is not
        stated.
    """
    if kind == "colmap":
        camera = _one_camera(read_colmap(path), number, path)
    else:
        camera = read_opencv(path, model, size_px) if kind == "opencv" else read_metashape(path)
    coefficients = dict(zip(camera.parameter_names[4:], camera.parameters[4:], strict=True))
    calibrated = {name for name, value in coefficients.items() if value != 0.0}
    held = set(coefficients) - (calibrated or {name for name in coefficients if name.startswith("k")})
    block, cov = _interior(f"{name}_interior", camera, sigmas, path, held)
    left = [
        n for n, variance in zip(block.quantities, np.diag(cov), strict=True) if n in held and variance == 0
    ]
    part = (replace(block, facts={**block.facts, "held": left}) if left else block, cov)
    words = {"colmap": "COLMAP", "opencv": "OpenCV", "metashape_lens": "Metashape"}[kind]
    return _joined([part], title=f"{words}: {path.name}", run=path.stem, method=f"{words}, sigmas as stated")


def _one_camera(cameras: Mapping[int, Camera], number: int | None, path: Path) -> Camera:
    if number is None and len(cameras) == 1:
        return next(iter(cameras.values()))
    if number is None or number not in cameras:
        raise InputError(
            f"{len(cameras)} cameras" if number is None else f"there is no camera {number}",
            where=path,
            expected=f"the number of one: {', '.join(map(str, cameras))}",
            cure="State it: --camera NUMBER",
        )
    return cameras[number]


def _interior(
    name: str, camera: Camera, sigmas: Mapping[str, float], path: Path, held: Set[str]
) -> tuple[Block, ArrayF]:
    """Block and covariance; parameters that are ``held`` have no error unless one is stated by their name."""
    names = PARAMETERS[camera.model]
    if strange := [key for key in sigmas if key in COEFFICIENTS and key not in names]:
        raise InputError(
            f"a sigma of {strange[0]}, which a {camera.model} camera does not have",
            where=path,
            expected=f"one of {', '.join(names)}",
        )
    keys = ["focal_px", "focal_px", "centre_px", "centre_px", *["distortion"] * (len(names) - 4)]
    stated = [(name, name if name in sigmas else key) for name, key in zip(names, keys, strict=True)]
    sigma = np.array(
        [0.0 if name in held and key != name else _sigma(sigmas, key, path) for name, key in stated]
    )
    block = Block(
        name=name,
        quantities=names,
        values=camera.parameters,
        equation=f"pixels = {camera.model}(x_ccs)",
        convention="pixels count from the upper left corner; ccs: x right, y down, z view",
        facts={"model": camera.model, "width_px": camera.size_px[0], "height_px": camera.size_px[1]},
    )
    return block, np.diag(sigma**2)


def import_matrix(
    path: Path, sigmas: Mapping[str, float], *, name: str = "lidar", target: str = "", source: str = ""
) -> Calibration:
    """Calibration of a pose that stands as a 4x4 matrix in a text file, as CloudCompare writes it.

    Parameters
    ----------
    path : four lines of four numbers, row after row: ``x_target = T @ x_source``.
    sigmas : ``angle_deg`` and ``lever_m``.
    name : of the block.
    target, source : frames, where the name does not say them.

    Raises
    ------
    InputError : no such matrix, one by columns, with scale or reflection, a shift in millimetres, or a
        sigma is not stated.
    """
    pose = _near(read_matrix(path), str(path)).with_cov(_pose_cov(sigmas, path))
    part = pose_block(name, pose, target=target, source=source)
    return _joined(
        [part], title=f"4x4 matrix: {path.name}", run=path.stem, method="4x4 matrix, sigmas as stated"
    )


def read_matrix(path: Path) -> Rigid:
    """The transform of a text file with a 4x4 matrix.

    Raises
    ------
    InputError : see `import_matrix`.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise InputError("file not found", where=path, cure="Check the path") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"not a text file ({error})", where=path, expected="a 4x4 matrix") from error
    rows = [line.replace(",", " ").replace(";", " ").split() for line in text.splitlines()]
    rows = [row for row in rows if row and not row[0].startswith(("#", "//"))]
    return rigid_of(rows, where=str(path))


def rigid_of(rows: Any, *, where: str) -> Rigid:
    """Rigid transform of 4x4 numbers or words; rounding of the rotation is smoothed out.

    Raises
    ------
    InputError : no 4x4 matrix, one by columns, with scale or reflection.
    """
    expected = "4x4 numbers, row after row, the last row 0 0 0 1"
    try:
        T = np.asarray(rows, dtype=np.float64)
    except (TypeError, ValueError):
        T = np.zeros(0)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise InputError("this is no 4x4 matrix", where=where, expected=expected)
    last = np.array([0.0, 0.0, 0.0, 1.0])
    # 1e-9: zeros and ones are written as such.
    if np.abs(T[3] - last).max() > 1e-9:
        by_columns = np.abs(T[:, 3] - last).max() <= 1e-9
        raise InputError(
            "the matrix stands column after column" if by_columns else f"the last row is {T[3].tolist()}",
            where=where,
            expected=expected,
            cure="Transpose it" if by_columns else "",
        )
    R = T[:3, :3]
    gram, det = R.T @ R, float(np.linalg.det(R))
    scale = float(np.cbrt(abs(det)))
    if np.abs(gram - np.eye(3)).max() > ORTHOGONAL or det < 0:
        only_scale = scale > 0 and np.abs(gram / scale**2 - np.eye(3)).max() <= ORTHOGONAL
        what = f"a scale of {scale:.9g}" if only_scale and abs(scale - 1) > ORTHOGONAL / 4 else "no rotation"
        what = "a reflection (determinant below zero)" if det < 0 else what
        raise InputError(
            f"the upper left 3x3 part is {what}",
            where=where,
            expected="a rotation: orthogonal, determinant +1",
            cure="Register again without scale" if only_scale and det > 0 else "Check order and signs",
        )
    return Rigid(R=nearest_rotation(R), shift_m=T[:3, 3])


def _near(pose: Rigid, where: str) -> Rigid:
    """The same pose if its shift may be a lever arm in metres.

    Raises
    ------
    InputError : it is too long for that.
    """
    doubt = lever_doubt(pose.shift_m.tolist())
    if doubt is not None:
        found, expected, cure = doubt
        raise InputError(found, where=where, expected=expected, cure=cure)
    return pose


def _pose_cov(sigmas: Mapping[str, float], path: Path) -> ArrayF:
    """(6, 6) of (shift, metres; rotation, radians)."""
    angle, lever = np.deg2rad(_sigma(sigmas, "angle_deg", path)), _sigma(sigmas, "lever_m", path)
    return np.diag([lever**2] * 3 + [float(angle) ** 2] * 3)


def _sigma(sigmas: Mapping[str, float], key: str, path: Path) -> float:
    value = sigmas.get(key)
    if value is None or not np.isfinite(value) or value < 0:
        raise InputError(
            f"the file does not say how well it is known: no sigma {key}"
            if value is None
            else f"sigma {key} is {value}",
            where=path,
            expected=f"the standard deviation of {SIGMAS[key]}",
            cure=f"State it: --sigma {key}=..., from the report of the program that wrote the file",
        )
    return float(value)


def _joined(parts: list[tuple[Block, ArrayF]], *, title: str, run: str, method: str) -> Calibration:
    source = Source(run=run, method=method)
    single = [Calibration(title=title, blocks=(block,), cov=cov, source=source) for block, cov in parts]
    return Calibration.merged(single, title=title, source=source)
