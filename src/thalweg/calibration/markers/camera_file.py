"""Interior orientations as calibration files with their covariance, and cameras from files of any kind."""

from pathlib import Path
from typing import Final

from thalweg.core.calibration.files import read_calibration
from thalweg.core.calibration.model import Block, Calibration, Source
from thalweg.core.camera.files import read_colmap, read_opencv
from thalweg.core.camera.model import PARAMETERS, Camera, Model
from thalweg.core.errors import ConfigError, InputError
from thalweg.core.yaml_lines import read_mapping

SUFFIX: Final = "_interior"
"""Of the block of a camera: ``camera_interior``."""


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


def read_camera(path: Path, model: Model | None = None) -> Camera:
    """A camera from a calibration file of Thalweg, a file of OpenCV or ROS, or COLMAP's ``cameras.txt``.

    Parameters
    ----------
    path : the file.
    model : where a file of OpenCV does not say it.

    Raises
    ------
    InputError : the file is missing or none of these; or it holds more than one camera.
    """
    if path.suffix.lower() == ".txt":
        cameras = read_colmap(path)
        if len(cameras) > 1:
            raise InputError(
                f"{len(cameras)} cameras",
                expected="one",
                where=path,
                cure="Keep the line of the boat's camera",
            )
        return next(iter(cameras.values()))
    if not path.is_file():
        raise InputError("file not found", expected="an interior orientation", where=path)
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
    return read_opencv(path, model)


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
