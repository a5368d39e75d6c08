"""Interior orientations as calibration files with their covariance, and cameras from files of any kind."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from thalweg.core import (
    LENS_LINE,
    PARAMETERS,
    ArrayF,
    Camera,
    ConfigError,
    GeometryError,
    InputError,
    Model,
    read_colmap,
    read_mapping,
    read_metashape,
    read_opencv,
)
from thalweg.core.calibration import Block, Calibration, Source, read_calibration

SUFFIX: Final = "_interior"
"""Of the block of a camera: ``camera_interior``."""

TRIED: Final = {"perspective": (0.62, 0.8, 1.0, 1.25, 1.6, 2.1), "fisheye": (0.24, 0.3, 0.36, 0.44, 0.54)}
"""Focal lengths over the longer side: 22 to 76 mm on full frame; fisheyes of 106 to 240 degrees."""

LENS_SIGMA: Final = {"k1": 0.1, "k2": 0.1, "k3": 0.05, "k4": 0.02, "p1": 0.002, "p2": 0.002}
"""Sigmas of distortion about zero: what lenses have."""
FOCAL_SHARE: Final = 0.02
"""Sigma of a focal length that nobody calibrated at this focus, over itself: EXIF, another program's file."""
_SQUARE: Final = 1e-4
"""Sigma of the ratio of both focal lengths: pixels are square."""
_CENTRE_SHARE: Final = 0.01
"""Sigma of a principal point, over the longer side of the picture."""
_FREE: Final = {"focal": ("fx", "fy"), "centre": ("cx", "cy")}
"""Words for parameters that belong together; ``focal`` is one number, because pixels are square."""
_TOLD_FOCAL, _TOLD_CENTRE = 0.1, 0.02
"""Sigmas, over the focal length and over the longer side, at which points tell no more than a guess does."""


# ---------------------------------------------------------------- files


def interior_calibration(camera: Camera, source: Source, *, block: str = "camera") -> Calibration:
    """A calibration that holds the interior orientation of one camera as the block ``<block>_interior``."""
    part = Block(
        name=block + SUFFIX,
        quantities=camera.parameter_names,
        values=camera.parameters,
        equation=f"pixels = {camera.model}(x_ccs)",
        convention="pixels count from the upper left corner; ccs: x right, y down, z view",
        facts={"model": camera.model, "width_px": camera.size_px[0], "height_px": camera.size_px[1]},
    )
    return Calibration(
        title=f"Interior orientation of {camera.name}", blocks=(part,), cov=camera.cov, source=source
    )


def camera_of(calibration: Calibration, block: str = "camera") -> Camera:
    """The camera of a block ``<block>_interior`` with its covariance.

    Raises
    ------
    InputError : the block states no known model or size, or other quantities.
    """
    name = block + SUFFIX
    found = calibration.find(name)
    model = str(found.facts.get("model", ""))
    size = [found.facts.get(key) for key in ("width_px", "height_px")]
    if PARAMETERS.get(model) != found.quantities or not all(isinstance(s, int) for s in size):
        raise InputError(
            f"block '{name}' with the model '{model}' and the size {size}",
            expected=f"one of {', '.join(PARAMETERS)} with its parameters, width_px and height_px",
        )
    values, cov = calibration.block(name)
    kind: Model = "fisheye" if model == "fisheye" else "perspective"
    width, height = (int(s) for s in size if s is not None)
    return Camera(model=kind, size_px=(width, height), parameters=values, cov=cov, name=block)


def read_camera(path: Path) -> Camera:
    """A camera from a calibration file of Thalweg, of OpenCV or ROS, Metashape or COLMAP's ``cameras.txt``.

    Raises
    ------
    InputError : the file is missing or none of these; or it holds more than one camera.
    """
    if not path.is_file():
        raise InputError("file not found", expected="an interior orientation", where=path)
    if path.suffix.lower() == ".txt" and not LENS_LINE.match(path.read_text(errors="replace")):
        cameras = read_colmap(path)
        if len(cameras) > 1:
            raise InputError(
                f"{len(cameras)} cameras",
                expected="one",
                where=path,
                cure="Keep the line of the boat's camera",
            )
        return next(iter(cameras.values()))
    if path.suffix.lower() == ".xml":
        return read_metashape(path)
    try:
        keys = set(read_mapping(path)[0])
    except ConfigError:
        keys = set()  # OpenCV's own head and tags are no plain YAML
    if any(key.startswith("thalweg") for key in keys):
        calibration = read_calibration(path)
        blocks = [b.name.removesuffix(SUFFIX) for b in calibration.blocks if b.name.endswith(SUFFIX)]
        if len(blocks) != 1:
            raise InputError(f"the cameras {blocks}", expected="one interior orientation", where=path)
        return camera_of(calibration, blocks[0])
    return read_opencv(path)


def same_size(camera: Camera, size_px: tuple[int, int]) -> Camera:
    """The camera if its pictures have this size.

    Raises
    ------
    InputError : they have not.
    """
    if camera.size_px != size_px:
        width, height = camera.size_px
        raise InputError(
            f"pictures of {size_px[0]} x {size_px[1]} pixels",
            expected=f"{width} x {height}, as the interior orientation of {camera.name} has it",
            cure="Use the original files of the camera that was calibrated, in the same mode",
        )
    return camera


# ---------------------------------------------------------------- nominal interior orientation


def nominal_camera(name: str, model: Model, size_px: tuple[int, int], focal_px: float) -> Camera:
    """A camera with its principal point in the middle and without distortion."""
    p = np.zeros(len(PARAMETERS[model]))
    p[:4] = focal_px, focal_px, size_px[0] / 2, size_px[1] / 2
    return Camera(model=model, size_px=size_px, parameters=p, name=name)


def free_of_lens(camera: Camera, words: Sequence[str]) -> dict[str, ArrayF]:
    """What is to be estimated of a lens: name of an unknown -> (k,) change of the parameters by it.

    Parameters
    ----------
    camera : parameters that its covariance observes are left to that.
    words : ``focal`` (one for both axes), ``centre`` (principal point), or names of parameters.

    Raises
    ------
    InputError : a word that is none of them.
    """
    names = camera.parameter_names
    open_ = {name for name, variance in zip(names, np.diag(camera.cov), strict=True) if not variance > 0}
    found: dict[str, ArrayF] = {}
    for word in words:
        parts = _FREE.get(word, (word,))
        if not set(parts) <= set(names):
            raise InputError(
                f"{word!r} to be estimated", expected=f"some of {', '.join([*_FREE, *names])}, with commas"
            )
        unit = {name: np.eye(len(names))[names.index(name)] for name in parts if name in open_}
        if word == "focal" and len(unit) == 2:
            # one unknown, in pixels of the mean focal length
            unit = {"focal": sum(unit.values()) * camera.parameters / camera.parameters[:2].mean()}
        found |= unit
    return found


def guessed_lens(camera: Camera, free: Sequence[str] = ()) -> Camera:
    """The camera with standard deviations of what lenses have, for values that nobody stated any of.

    A file without sigmas is not exact: held fixed, a focal length that was 3 % off put projection centres
    9 m away that claimed 0.08 m. Focal lengths err by 2 % alike, the principal point by 1 % of the longer
    side, distortion by `LENS_SIGMA`.

    Parameters
    ----------
    camera : its covariance does not count.
    free : what has no standard deviation because it is estimated freely, see `free_of_lens`.
    """
    p, names = camera.parameters, camera.parameter_names
    centre = _CENTRE_SHARE * max(camera.size_px)
    sigma = {"fx": _SQUARE * p[0], "fy": _SQUARE * p[1], "cx": centre, "cy": centre, **LENS_SIGMA}
    cov = np.diag(np.square([sigma[name] for name in names]))
    cov[:2, :2] += FOCAL_SHARE**2 * np.outer(p[:2], p[:2])
    for change in free_of_lens(replace(camera, cov=np.zeros_like(cov)), free).values():
        cov[change != 0] = 0.0
        cov[:, change != 0] = 0.0
    return replace(camera, cov=cov)


def require_told(camera: Camera, names: Collection[str]) -> None:
    """Refuse parameters about which an estimate says no more than what lenses have anyway.

    Parameters
    ----------
    camera : estimated, with covariance.
    names : of `free_of_lens`.

    Raises
    ------
    GeometryError : names the parameters with their sigmas.
    """
    known = dict(zip(camera.parameter_names, np.sqrt(np.diag(camera.cov)), strict=True))
    focal = _TOLD_FOCAL * camera.parameters[0]
    centre = _TOLD_CENTRE * max(camera.size_px)
    limits = {"fx": focal, "fy": focal, "cx": centre, "cy": centre, **LENS_SIGMA}
    parameters = dict.fromkeys(p for name in names for p in (("fx",) if name == "focal" else (name,)))
    vague = [p for p in parameters if not known[p] <= limits[p]]
    if vague:
        said = ", ".join(
            f"{'focal' if p == 'fx' else p} to {known[p]:.2g}, not {limits[p]:.2g}" for p in vague
        )
        raise GeometryError(
            f"the points determine {said}",
            expected="less than what is known of a lens without them",
            cure="Leave these out of --free, or measure more points: at different distances, and towards the "
            "corners of the picture",
        )


def starting_camera_by(
    misfit: Callable[[Camera], float],
    name: str,
    model: Model,
    size_px: tuple[int, int],
    focal_px: float | None,
) -> Camera:
    """The nominal camera of a stated focal length, or else that of the tried ones with the smallest misfit.

    Raises
    ------
    GeometryError : none of them gives any solution.
    """
    if focal_px is not None:
        return nominal_camera(name, model, size_px, focal_px)
    return best_nominal(name, model, size_px, misfit, TRIED[model])


def best_nominal(
    name: str,
    model: Model,
    size_px: tuple[int, int],
    misfit: Callable[[Camera], float],
    shares: Sequence[float],
) -> Camera:
    """The tried focal length with the smallest misfit.

    Parameters
    ----------
    name, model, size_px : of the camera.
    misfit : of a camera; `GeometryError` counts as infinite.
    shares : focal lengths over the longer side.

    Raises
    ------
    GeometryError : none of them gives any solution; the last reason is told.
    """
    best: tuple[float, Camera] | None = None
    reason: GeometryError | None = None
    for share in shares:
        camera = nominal_camera(name, model, size_px, share * max(size_px))
        try:
            value = misfit(camera)
        except GeometryError as error:
            reason = error
            continue
        if best is None or value < best[0]:
            best = (value, camera)
    if best is None:
        assert reason is not None
        raise reason
    return best[1]
