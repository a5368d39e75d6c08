"""Interior orientations of the cameras of a block: which are given, and what became of them."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.calibration.markers.camera_file import interior_calibration, read_camera
from thalweg.core.calibration.files import write_calibration
from thalweg.core.calibration.model import Source
from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError
from thalweg.images.bundle.consent import Interiors
from thalweg.images.bundle.result import adjusted_cameras
from thalweg.images.bundle.run import Oriented
from thalweg.images.model.block import ImageBlock
from thalweg.images.model.cameras import below

_OTHER_LENS: Final = 1.25
"""Ratio of two focal lengths beyond which they are not of one lens and zoom; as in `sfm_assign`."""


def given_interiors(
    block: ImageBlock, common: Camera | None, of_folder: Mapping[str, Camera]
) -> tuple[Camera | None, ...]:
    """Given interior orientation of each camera of a block, None where there is none.

    Parameters
    ----------
    block : its cameras are told apart as of `image_cameras.cameras_of`.
    common : of all cameras of its size and focal length that have none of their own.
    of_folder : by folder; also for images below it.
    """
    out: list[Camera | None] = []
    for c, camera in enumerate(block.cameras):
        names = [name for name, k in zip(block.images, block.camera, strict=True) if k == c]
        own = max((f for f in of_folder if names and below(names[0], f)), key=len, default="")
        found = of_folder[own] if own else common
        if found is not None and not own:
            ratio = camera.parameters[0] / found.parameters[0]
            alike = camera.size_px == found.size_px and camera.model == found.model
            found = found if alike and 1 / _OTHER_LENS < ratio < _OTHER_LENS else None
        try:
            out.append(None if found is None else found.scaled(camera.size_px))
        except GeometryError:
            out.append(None)
    return tuple(out)


def read_interiors(
    common: Sequence[Path], folders: Sequence[str], of_folder: Sequence[Path]
) -> tuple[Camera | None, dict[str, Camera]]:
    """The common interior orientation, if there is one, and those of the cameras of folders."""
    given = {folder: read_camera(path) for folder, path in zip(folders, of_folder, strict=True)}
    return (read_camera(common[0]) if common else None), given


def interiors_of(
    blocks: Sequence[ImageBlock], common: Camera | None, of_folder: Mapping[str, Camera]
) -> Interiors:
    """Given interior orientations for the adjustment of all pieces of a block.

    One camera in all of them has the common one whatever its focal length: the adjustment says if it does not
    fit. Of several each has its own, by name.
    """
    if not of_folder and len({camera.name for block in blocks for camera in block.cameras}) == 1:
        return common
    return {
        camera.name: own
        for block in blocks
        for camera, own in zip(block.cameras, given_interiors(block, common, of_folder), strict=True)
        if own is not None
    }


def write_cameras(path: Path, table: Path, oriented: Sequence[Oriented], source: Source) -> None:
    """Write the camera of most images of the main piece as a calibration, and all of them as a table."""
    found = [adjusted_cameras(piece.adjusted) for piece in oriented]
    blocks = [piece.adjusted.problem.block for piece in oriented]
    write_calibration(path, interior_calibration(main_camera(found[0], blocks[0]), source))
    camera_table(found, blocks).to_csv(table, index=False)


def main_camera(cameras: Sequence[Camera], block: ImageBlock) -> Camera:
    """The camera of most images of a block."""
    return cameras[int(np.argmax(np.bincount(block.camera, minlength=len(cameras))))]


def camera_table(cameras: Sequence[Sequence[Camera]], blocks: Sequence[ImageBlock]) -> pd.DataFrame:
    """One row per camera and piece of a block.

    Columns: ``piece``, ``camera``, ``images``, ``first`` (an image), ``model``, ``width_px``, ``height_px``,
    and each parameter with its standard deviation ``sigma_...``; empty where the model has no such parameter.
    """
    rows = []
    for piece, (found, block) in enumerate(zip(cameras, blocks, strict=True)):
        counts = Counter(block.camera.tolist())
        for k, camera in enumerate(found):
            sigma = np.sqrt(np.clip(np.diag(camera.cov), 0, None))
            first = next((n for n, c in zip(block.images, block.camera, strict=True) if c == k), "")
            row = {
                "piece": piece, "camera": camera.name, "images": counts[k], "first": first,
                "model": camera.model, "width_px": camera.size_px[0], "height_px": camera.size_px[1],
            }  # fmt: skip
            for name, value, spread in zip(camera.parameter_names, camera.parameters, sigma, strict=True):
                row |= {name: float(value), f"sigma_{name}": float(spread)}
            rows.append(row)
    return pd.DataFrame(rows)
