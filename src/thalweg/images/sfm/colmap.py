"""COLMAP: its Python module, quiet and seeded, and its cameras.

Whatever draws random numbers in COLMAP does so from a generator of the calling thread or from a seed in its
options. `colmap` sets the first back to a fixed seed each time it is called, and the callers set the second,
so that no result depends on what ran before in the same process.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.calibration import nominal_camera
from thalweg.core import COLMAP_MODELS, PARAMETERS, ArrayF, Camera, InputError, missing_package

SEED: Final = 0
"""Of all random choices inside COLMAP: samples of RANSAC, starts of the global mapper."""

FOCAL_FACTOR: Final = 1.2
"""Focal length of a camera of which nothing is known, in units of the longer side; as in COLMAP."""
_CARDS: Final = (Path("/dev/nvidiactl"), Path("/dev/dxg"))
"""What the driver of a graphics card shows: on Linux, and on Linux within Windows."""
_GRID: Final = 25
_DENOMINATOR: Final = ("k4", "k5", "k6")


# ---------------------------------------------------------------- the module: quiet, seeded, loaded when it
# is needed


def colmap() -> Any:
    """The module ``pycolmap``, its log reduced to fatal errors and its generator set to `SEED`.

    COLMAP's log writes lines for every image; what matters of them is found and said by the callers.

    Raises
    ------
    UnsupportedError : the module is not installed, or cannot be loaded.
    """
    try:
        import pycolmap
    except ImportError as error:
        raise missing_package(error) from error
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.FATAL)
    pycolmap.set_random_seed(SEED)
    return pycolmap


def uses_gpu(device: str) -> bool:
    """Whether COLMAP works on a graphics card.

    Parameters
    ----------
    device : ``images.device``; ``auto``: if pycolmap was built for CUDA and the system has a card.

    Raises
    ------
    InputError : ``cuda``, and pycolmap was built without it.
    """
    built = bool(colmap().has_cuda)
    if device == "cuda" and not built:
        raise InputError(
            "pycolmap without CUDA",
            expected="pycolmap built for graphics cards, such as the package pycolmap-cuda12",
            where="images.device",
            cure="Install it, or set images.device to auto or cpu",
        )
    return device == "cuda" or (device == "auto" and built and any(path.exists() for path in _CARDS))


# ---------------------------------------------------------------- interior orientations to COLMAP and back
#
# COLMAP's models are those of `thalweg.core.camera.COLMAP_MODELS`. Its FULL_OPENCV has a denominator
# (k4, k5, k6) that Brown's model has not, and its OPENCV lacks Brown's k3. Where the other side has no place
# for a parameter the distortion is fitted over the picture, and the largest difference is told.


@dataclass(frozen=True, slots=True, kw_only=True)
class StartCamera:
    """An interior orientation to begin with.

    Parameters
    ----------
    camera : its parameters.
    lens : model of COLMAP in which it takes part.
    known : whether the focal length is more than a guess.
    source : where it comes from, for the report.
    """

    camera: Camera
    lens: str
    known: bool
    source: str


def start_given(camera: Camera, lens: str = "auto", *, fixed: bool = False) -> StartCamera:
    """A given camera as start.

    Parameters
    ----------
    camera : interior orientation.
    lens : model of COLMAP; ``auto``: OPENCV_FISHEYE for a fisheye, else OPENCV, and FULL_OPENCV for a camera
        with k3 that stays fixed. FULL_OPENCV is not estimated by ``auto``: its denominator and k3 are hardly
        separable.

    Raises
    ------
    InputError : the model of the lens does not belong to the model of the camera.
    """
    if lens == "auto":
        whole = fixed and camera.model == "perspective" and camera.parameters[8] != 0
        lens = "OPENCV_FISHEYE" if camera.model == "fisheye" else "FULL_OPENCV" if whole else "OPENCV"
    if COLMAP_MODELS[lens][0] != camera.model:
        raise InputError(
            f"lens {lens} for the {camera.model} camera {camera.name!r}",
            expected="auto, or a model of the same kind",
            where="images.mapping.lens",
        )
    return StartCamera(camera=camera, lens=lens, known=True, source="given")


def start_guessed(image: Path, size_px: tuple[int, int], lens: str = "auto") -> StartCamera:
    """A camera from the focal length in EXIF (35 mm equivalent), else `FOCAL_FACTOR`."""
    lens = "SIMPLE_RADIAL" if lens == "auto" else lens
    model = COLMAP_MODELS[lens][0]
    inferred = focal_from_exif(image)
    known = inferred is not None
    camera = nominal_camera("camera", model, size_px, inferred or FOCAL_FACTOR * max(size_px))
    source = f"EXIF of {image.name}" if known else f"{FOCAL_FACTOR:g} times the longer side, a guess"
    return StartCamera(camera=camera, lens=lens, known=known, source=source)


def to_colmap(start: StartCamera, key: int) -> tuple[Any, float]:
    """COLMAP's camera number ``key``, and the largest difference of both models in the picture, pixels."""
    pc = colmap()
    camera, names = start.camera, COLMAP_MODELS[start.lens][1]
    values = dict(zip(camera.parameter_names, camera.parameters.tolist(), strict=True))
    lost = [
        k
        for k, value in values.items()
        if value != 0 and k not in names and not (k in ("fx", "fy") and "f" in names)
    ]
    if "f" in names:
        values["f"] = (values["fx"] + values["fy"]) / 2
    error_px = 0.0
    if lost or ("f" in names and values["fx"] != values["fy"]):
        free = [k for k in names if k.startswith(("k", "p")) and k not in _DENOMINATOR]
        focal = (values["f"], values["f"]) if "f" in names else (values["fx"], values["fy"])
        kept = camera.with_parameters(
            np.array([*focal, *camera.parameters[2:4], *np.zeros(len(camera.parameters) - 4)])
        )
        fitted, error_px = _fit(kept, free, *_picture_rays(camera))
        values |= dict(zip(camera.parameter_names[4:], fitted.parameters[4:].tolist(), strict=True))
    made = pc.Camera(
        camera_id=key,
        model=getattr(pc.CameraModelId, start.lens),
        width=camera.size_px[0],
        height=camera.size_px[1],
        params=[values.get(k, 0.0) for k in names],
    )
    made.has_prior_focal_length = start.known
    return made, error_px


def from_colmap(made: Any, name: str = "camera") -> tuple[Camera, float]:
    """Camera of Thalweg, and the largest difference of both models in the picture, pixels.

    Raises
    ------
    InputError : a model of COLMAP that Thalweg has not.
    """
    if made.model_name not in COLMAP_MODELS:
        raise InputError(f"camera model {made.model_name}", expected=f"one of {', '.join(COLMAP_MODELS)}")
    model, names = COLMAP_MODELS[made.model_name]
    values = dict(zip(names, np.asarray(made.params, float).tolist(), strict=True))
    if "f" in values:
        values["fx"] = values["fy"] = values.pop("f")
    size_px = (int(made.width), int(made.height))
    p = np.array([values.get(k, 0.0) for k in PARAMETERS[model]])
    camera = Camera(model=model, size_px=size_px, parameters=p, name=name)
    if model == "fisheye" or not any(values.get(k, 0.0) for k in _DENOMINATOR):
        return camera, 0.0
    xy = _pixels(size_px)
    plane = np.asarray(made.cam_from_img(xy), float).reshape(-1, 2)
    rays = np.column_stack([plane, np.ones(len(plane))])
    return _fit(camera, ["k1", "k2", "p1", "p2", "k3"], rays, xy)


def cameras_by_size(
    sizes_px: Sequence[tuple[int, int]], given: Sequence[Camera]
) -> tuple[list[int], list[str]]:
    """Which of the given cameras took each image, by the size of the picture; -1 and the reason if none did.

    Raises
    ------
    InputError : two cameras of the same size, or no image fits any camera.
    """
    known = {camera.size_px: k for k, camera in enumerate(given)}
    if len(known) < len(given):
        raise InputError(
            "two given cameras with pictures of the same size",
            expected="sizes that tell which camera took an image",
            cure="Orient the images of each camera as a block of its own",
        )
    shapes = " or ".join(f"{w} x {h}" for w, h in known)
    found = [known.get(size, -1) for size in sizes_px]
    if sizes_px and all(k < 0 for k in found):
        w, h = sizes_px[0]
        raise InputError(
            f"images of {w} x {h} pixels",
            expected=f"{shapes} as the interior orientation says",
            cure="Calibrate the camera at the size of these images, or give no interior orientation",
        )
    reasons = [
        "" if k >= 0 else f"{w} x {h} pixels, the camera has {shapes}"
        for k, (w, h) in zip(found, sizes_px, strict=True)
    ]
    return found, reasons


def focal_from_exif(image: Path) -> float | None:
    """COLMAP's guess, which knows the sensors of many cameras; None if it has none."""
    pc = colmap()
    try:
        made = pc.infer_camera_from_image(image)
    except (RuntimeError, ValueError):
        return None
    return float(made.mean_focal_length()) if made.has_prior_focal_length else None


def _pixels(size_px: tuple[int, int]) -> ArrayF:
    x, y = np.meshgrid(np.linspace(0, size_px[0], _GRID), np.linspace(0, size_px[1], _GRID))
    return np.column_stack([x.ravel(), y.ravel()])


def _picture_rays(camera: Camera) -> tuple[ArrayF, ArrayF]:
    xy = _pixels(camera.size_px)
    rays = camera.rays(xy)
    known = np.isfinite(rays).all(axis=1)
    return rays[known], xy[known]


def _fit(camera: Camera, free: Sequence[str], rays: ArrayF, xy_px: ArrayF) -> tuple[Camera, float]:
    """Distortion that sends the rays closest to the pixels: both models are linear in it."""
    columns = [camera.parameter_names.index(name) for name in free]
    p = camera.parameters.copy()
    p[4:] = 0
    bare = camera.with_parameters(p)
    got, _, by = bare.project_with_derivatives(rays)
    good = np.isfinite(got).all(axis=1) & np.isfinite(xy_px).all(axis=1)
    A = by[good][:, :, columns].reshape(-1, len(columns))
    if columns:
        p[columns] = np.linalg.lstsq(A, (xy_px[good] - got[good]).ravel(), rcond=None)[0]
    fitted = bare.with_parameters(p)
    off = np.linalg.norm(fitted.project(rays[good]) - xy_px[good], axis=1)
    return fitted, float(np.nanmax(off, initial=0.0))
