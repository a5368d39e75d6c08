"""Masks of the images of several cameras: what keeps its place in the picture is learned for each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.calibration.markers.camera_file import read_camera
from thalweg.core.camera.model import Camera
from thalweg.core.errors import InputError
from thalweg.images.masks.images import make_masks, size_of
from thalweg.images.masks.series import ASPECT
from thalweg.images.masks.settings import MaskSettings
from thalweg.images.model.cameras import cameras_of
from thalweg.images.model.files import check_flat_masks, find_mask
from thalweg.images.model.poses import ImagePoses


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownCameras:
    """Approximate ``poses`` of images, and interior orientations: the common one and those ``of_folder``."""

    poses: ImagePoses | None = None
    camera: Camera | None = None
    of_folder: Mapping[str, Camera] = field(default_factory=dict)


def known_camera(
    camera: Sequence[Path], predictions: Sequence[Path], interiors: Mapping[str, Path]
) -> KnownCameras:
    """From the files of a campaign; a pose says where the horizon is only together with a camera."""
    if not predictions:
        return KnownCameras()
    return KnownCameras(
        poses=ImagePoses.read(predictions[0]),
        camera=read_camera(camera[0]) if camera else None,
        of_folder={folder: read_camera(path) for folder, path in interiors.items()},
    )


def make_masks_of_cameras(
    images: Mapping[str, Path],
    out_dir: Path,
    settings: MaskSettings,
    known: KnownCameras,
    *,
    by: str = "auto",
    supplied: Path | None = None,
    **options: Any,
) -> pd.DataFrame:
    """Mask the images of each camera by themselves, as of `make_masks`.

    Parameters
    ----------
    images : photographs by name.
    by : how cameras are told apart, see `cameras_of`.
    supplied : folder of masks for images of any of the cameras.

    Raises
    ------
    InputError : as of `make_masks`; masks are supplied, but for none of the images.
    """
    groups = cameras_of(images, by, tuple(known.of_folder))
    if supplied is not None and len(groups) > 1:
        check_flat_masks(list(images), supplied)
    tables, notes = [], []
    for group in groups:
        own = {name: images[name] for name in group.images}
        camera, poses = known.of_folder[group.folder] if group.folder else known.camera, known.poses
        if len(groups) > 1 and not _usable(own, camera, poses):
            camera, poses = None, None
        found = supplied is not None and any(find_mask(name, supplied) for name in own)
        table = make_masks(
            own, out_dir, settings, poses if camera is not None else None, camera=camera,
            supplied=supplied if found or len(groups) == 1 else None, **options,
        )  # fmt: skip
        tables.append(table)
        notes += [note if len(groups) == 1 else f"{group.name}: {note}" for note in table.attrs["notes"]]
        if supplied is not None and not found and len(groups) > 1:
            notes.append(f"{group.name}: none of its {len(own)} images has a supplied mask")
    if supplied is not None and not any((table["source"] == "supplied").any() for table in tables):
        raise InputError(
            f"no usable mask for any of {len(images)} images",
            expected=f"files as {next(iter(images))}.png of the images' size",
            where=supplied,
        )
    out = pd.concat(tables, ignore_index=True) if len(tables) > 1 else tables[0]
    out.attrs["notes"] = notes
    return out


def _usable(images: Mapping[str, Path], camera: Camera | None, poses: ImagePoses | None) -> bool:
    """Whether poses are those of a camera's images, and the camera has the proportions of one of them."""
    if camera is None or poses is None:
        return False
    placed = {name for name, oriented in zip(poses.images, poses.oriented, strict=True) if oriented}
    if placed.isdisjoint(images):
        return False
    size = next((size for path in images.values() if (size := size_of(path)) is not None), None)
    if size is None:
        return False
    (w, h), (a, b) = camera.size_px, size
    return abs(w * b - a * h) <= ASPECT * w * b
