"""Which images one camera took: by their folders, and by what EXIF says of camera and focal length."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final

import numpy as np

from thalweg.core.errors import InputError
from thalweg.core.types import ArrayB
from thalweg.ingest.photos.exif import ImageHead, read_head

KINDS: Final = ("auto", "folder", "exif", "size")

_NAMED: Final = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageCamera:
    """A camera: ``name`` for tables, its ``images`` in natural order, and the ``folder`` whose interior
    orientation is given, empty if that is the common one or none.
    """

    name: str
    images: tuple[str, ...]
    folder: str = ""


def below(image: str, folder: str) -> bool:
    """Whether an image lies in a folder or below it; both as named from the common folder."""
    return PurePosixPath(folder) in PurePosixPath(image).parents


def cameras_of(
    images: Mapping[str, Path], by: str = "auto", folders: Sequence[str] = ()
) -> tuple[ImageCamera, ...]:
    """Cameras of images, in the order of their first image.

    Parameters
    ----------
    images : photographs by name, in natural order.
    by : ``folder``: those of one folder have one camera; ``exif``: those for which EXIF states the same
        maker, model, serial number and focal length; ``auto``: those of which both is true, where images with
        the same serial number may lie in several folders; ``size``: all, and only pictures of another size
        tell a camera apart.
    folders : whose camera has an interior orientation of its own, whatever ``by`` says.

    Raises
    ------
    InputError : an unknown ``by``, or a folder without images.
    """
    if by not in KINDS:
        raise InputError(f"cameras told apart by {by!r}", expected=f"one of {', '.join(KINDS)}")
    for folder in folders:
        if not any(below(name, folder) for name in images):
            raise InputError(
                f"no image in the folder {folder!r}",
                expected=f"one of {', '.join(_folders(images)) or 'folders below logs.time_lapse.images'}",
                where="logs.time_lapse.interiors",
                cure="Name the folder as the images' names begin, from the folder that holds all images",
            )
    groups: dict[tuple[Any, ...], list[str]] = {}
    own_of: dict[tuple[Any, ...], str] = {}
    for name, path in images.items():
        own = max((f for f in folders if below(name, f)), key=len, default="")
        key = (own, *_key(name, _head(path) if by in ("auto", "exif") else None, by, own))
        groups.setdefault(key, []).append(name)
        own_of[key] = own
    names = _names([(own_of[key], found) for key, found in groups.items()])
    return tuple(
        ImageCamera(name=label, images=tuple(found), folder=own_of[key])
        for label, (key, found) in zip(names, groups.items(), strict=True)
    )


def camera_note(cameras: Sequence[ImageCamera]) -> str:
    """What is to be said of several cameras; empty for one."""
    if len(cameras) < 2:
        return ""
    told = ", ".join(f"{c.name} ({len(c.images)} images)" for c in cameras[:_NAMED])
    more = f" and {len(cameras) - _NAMED} more" if len(cameras) > _NAMED else ""
    return (
        f"images of {len(cameras)} cameras, told apart by folder and EXIF: {told}{more}: each has an "
        "interior orientation of its own (images.mapping.cameras)"
    )


def in_folders(images: Iterable[str], folders: Sequence[str]) -> ArrayB:
    """(n,) whether each image lies in one of the folders or below it."""
    return np.array([any(below(str(name), folder) for folder in folders) for name in images], dtype=np.bool_)


def _key(name: str, head: ImageHead | None, by: str, own: str) -> tuple[Any, ...]:
    folder = "" if own else str(PurePosixPath(name).parent)
    if by in ("size", "folder"):
        return (folder,) if by == "folder" else ()
    told = (
        None
        if head is None
        else (head.make, head.model, head.serial, round(head.focal_mm, 2) if head.focal_mm > 0 else None)
    )
    if by == "exif" or (head is not None and head.serial):
        return (told,)
    return (folder, told)


def _head(path: Path) -> ImageHead | None:
    try:
        return read_head(path)
    except InputError:
        return None


def _names(groups: Sequence[tuple[str, Sequence[str]]]) -> list[str]:
    """A name of its own for each group: its folder, with a number where that is not enough."""
    if len(groups) == 1:
        return ["camera"]
    out: list[str] = []
    for own, images in groups:
        folders = _folders(images)
        base = own or (folders[0] if len(folders) == 1 else "") or "camera"
        n = sum(name == base or name.startswith(f"{base} ") for name in out)
        out.append(base if not n else f"{base} {n + 1}")
    return out


def _folders(images: Mapping[str, Path] | Sequence[str]) -> list[str]:
    found = dict.fromkeys(PurePosixPath(name).parent.as_posix() for name in images)
    return [folder for folder in found if folder != "."]
