"""Masks of time-lapse images: water with its reflections, sky and own boat are not to be matched (P2 6.1.1).

A mask is a picture of its image's size, 0 where masked and 255 where usable, named ``<image>.png`` as COLMAP
wants it. Masks that the user made win over those found here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import pandas as pd
from PIL import Image

from thalweg.calibration import read_camera
from thalweg.core import ArrayU8, Camera, InputError, decode_picture
from thalweg.images.masks.learning import LAND, PARTS, read_reduced
from thalweg.images.masks.series import ASPECT, Horizons, SeriesModel, learn_series
from thalweg.images.model import ImagePoses, cameras_of, check_flat_masks, find_mask, named_once
from thalweg.ingest.photos import Images
from thalweg.settings.sections import MaskSettings

COLUMNS: Final = (
    "image",
    "usable_share",
    "water_share",
    "sky_share",
    "hull_share",
    "moved_share",
    "source",
    "note",
)
"""Columns of the table of masks; shares of masks that the user made are unknown but for the usable one."""


# ---------------------------------------------------------------- masks of images


def make_masks(
    images: Images,
    out_dir: Path,
    settings: MaskSettings | None = None,
    poses: ImagePoses | None = None,
    *,
    camera: Camera | None = None,
    supplied: Path | None = None,
    seed: int = 0,
) -> pd.DataFrame:
    """Mask a series of images.

    Parameters
    ----------
    images : of one camera on one boat, by name or as files.
    out_dir : folder for the masks, made if needed.
    settings : how images are analysed.
    poses : approximate poses by the images' names; only the direction of the horizon is used. None: colour,
        texture and mirroring alone.
    camera : interior orientation that goes with the poses.
    supplied : folder of masks that win over those found here.
    seed : for the choice of sample pixels.

    Returns
    -------
    table : `COLUMNS`, one row per image in natural order; ``source`` is automatic, supplied or none.
        ``attrs["notes"]`` holds what concerns the whole series.

    Raises
    ------
    InputError : no images, the same image twice, no readable image, the folder of masks is missing or has no
        mask for any image, or poses without a fitting camera.
    """
    use = settings or MaskSettings()
    ordered = named_once(images)
    own, problems = _supplied_masks(ordered, supplied)
    rest = {name: path for name, path in ordered.items() if name not in own}
    notes: list[str] = []
    model = learn_series(rest, use, Horizons.of(poses, camera, use), seed) if rest and use.automatic else None
    if model is not None:
        notes += model.notes
    if supplied is not None:
        missing = [name for name in ordered if name not in own]
        if missing:
            notes.append(
                f"{len(missing)} of {len(ordered)} images have no usable supplied mask: {_few(missing)}"
            )
    out_dir.mkdir(parents=True, exist_ok=True)
    rows = []
    for name, path in ordered.items():
        row, mask = _one(name, path, own.get(name), model, use, problems.get(name, []), poses)
        rows.append(row)
        if mask is not None:
            write_mask(out_dir / f"{name}.png", mask)
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    table.attrs["notes"] = notes
    return table


def _one(
    name: str,
    path: Path,
    own: ArrayU8 | None,
    model: SeriesModel | None,
    settings: MaskSettings,
    problems: list[str],
    poses: ImagePoses | None,
) -> tuple[dict[str, Any], ArrayU8 | None]:
    """Row of the table and mask of one image; no mask of a file that is no picture."""
    if own is not None:
        share = float((own > 0).mean())
        return _row(name, "supplied", {"usable": share}, _sparse({"usable": share}, settings)), own
    try:
        image, (w, h) = read_reduced(path, settings.analysis_px)
    except InputError as error:
        return _row(name, "none", {}, [*problems, f"no mask: {error.found}"]), None
    if model is None:
        return _row(name, "none", {"usable": 1.0}, problems), np.full((h, w), 255, dtype=np.uint8)
    parts, notes = model.parts(image, (w, h), name)
    counts = np.bincount(parts.ravel(), minlength=len(PARTS)) / parts.size
    shares = {part: float(counts[code]) for part, code in PARTS.items()}
    shares["usable"] = shares.pop("land")
    if poses is not None and name not in model.horizons.R_wcs_ccs:
        problems = [*problems, "no approximate pose"]
    usable = ((parts == LAND) * np.uint8(255)).astype(np.uint8)
    if usable.shape != (h, w):
        usable = cv2.resize(usable, (w, h), interpolation=cv2.INTER_LINEAR)
        usable = ((usable > 127) * np.uint8(255)).astype(np.uint8)
    found = [*problems, *notes, *_sparse(shares, settings)]
    return _row(name, "automatic", shares, found), usable


def _row(image: str, source: str, shares: dict[str, float], notes: Sequence[str]) -> dict[str, Any]:
    values = {
        f"{name}_share": round(shares.get(name, np.nan), 5)
        for name in ("usable", "water", "sky", "hull", "moved")
    }
    return {"image": image, **values, "source": source, "note": "; ".join(notes)}


def _sparse(shares: dict[str, float], settings: MaskSettings) -> list[str]:
    """A note where next to nothing is usable, with the part that rules."""
    if shares["usable"] >= settings.least_usable_share:
        return []
    others = {part: share for part, share in shares.items() if part != "usable"}
    most = max(others, key=lambda part: others[part], default="")
    words = f"; {100 * others[most]:.0f} % {_WORDS[most]}" if most else ""
    return [f"nearly all masked: {100 * shares['usable']:.1f} % usable{words}"]


_WORDS: Final = {"water": "water", "sky": "sky", "hull": "own boat", "moved": "moved while the camera stayed"}


def _supplied_masks(
    images: Mapping[str, Path], folder: Path | None
) -> tuple[dict[str, ArrayU8], dict[str, list[str]]]:
    """Masks of the user by image, and what is wrong with the others."""
    if folder is None:
        return {}, {}
    if not folder.is_dir():
        raise InputError("folder not found", expected="masks named <image>.png", where=folder)
    check_flat_masks(list(images), folder)
    masks: dict[str, ArrayU8] = {}
    problems: dict[str, list[str]] = {}
    for name, path in images.items():
        file = find_mask(name, folder)
        if file is None:
            problems[name] = ["no supplied mask"]
            continue
        mask = decode_picture(np.fromfile(file, dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
        size = size_of(path)
        if mask is None:
            problems[name] = ["the supplied mask is no picture"]
        elif size is not None and mask.shape[::-1] != size:
            problems[name] = [
                f"the supplied mask has {mask.shape[1]} x {mask.shape[0]} pixels, "
                f"the image {size[0]} x {size[1]}"
            ]
        else:
            masks[name] = ((mask > 0) * np.uint8(255)).astype(np.uint8)
    if not masks:
        reasons = sorted({problem for found in problems.values() for problem in found})
        raise InputError(
            f"no usable mask for any of {len(images)} images ({_few(reasons)})",
            expected=f"files as {next(iter(images))}.png of the images' size",
            where=folder,
            cure="Name and scale the masks like their images (<image>.jpg.png, <image>.png or "
            "<image>_mask.png), or set no folder",
        )
    return masks, problems


def size_of(path: Path) -> tuple[int, int] | None:
    """Width and height of an image as stored; None if the file is no picture."""
    try:
        with Image.open(path) as image:
            return image.size
    except (OSError, ValueError, Image.DecompressionBombError):
        return None


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def write_mask(path: Path, mask: ArrayU8) -> None:
    """Write a mask (h, w) as PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(".png", mask)[1].tobytes())


# ---------------------------------------------------------------- several cameras: each has its own fixed
# places


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
            own,
            out_dir,
            settings,
            poses if camera is not None else None,
            camera=camera,
            supplied=supplied if found or len(groups) == 1 else None,
            **options,
        )
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
