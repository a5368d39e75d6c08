"""Photographs of folders and files: which files they are, the names by which all tables call them, masks.

A folder is searched with the folders below it. The name of an image is its path below the folder that holds
all that was given, with ``/``: ``IMG_1.jpg`` where one folder holds all images, ``left/IMG_1.jpg`` where
several cameras have folders of their own.
"""

import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

import numpy as np
from PIL import Image

from thalweg.core import ArrayB, InputError

IMAGE_ENDINGS: Final = (".jpg", ".jpeg", ".png", ".tif", ".tiff")

Images = Mapping[str, Path] | Sequence[Path]
"""Photographs by name, or files that get their names from their folders."""

_SYSTEM: Final = ("@eadir", "__macosx")
"""Folders in which systems keep previews."""
_MASKS: Final = "mask"
"""Folders whose name holds this hold no photographs; as `thalweg.settings.template.stream_of`
takes them.
"""
_ENDINGS_NAMED: Final = 4
_SHAPE: Final = 0.01
"""Sides of a mask and of its image may differ by this share after scaling."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundImages:
    """Photographs ``files`` in the order of what was given; ``others`` lie beside them and are not read.

    Others are files with another ending, hidden ones, previews of systems, and masks: PNG files named like a
    photograph with ``.png`` or ``_mask.png`` behind, and what is in a folder whose name holds ``mask``.
    """

    files: tuple[Path, ...]
    others: tuple[Path, ...]

    def others_in_words(self) -> str:
        """How many files of which ending are not read; empty without any."""
        if not self.others:
            return ""
        endings = Counter(path.suffix.lower() or path.name for path in self.others).most_common()
        told = ", ".join(f"{n} {ending}" for ending, n in endings[:_ENDINGS_NAMED])
        more = ", ..." if len(endings) > _ENDINGS_NAMED else ""
        return f"{len(self.others)} other files beside the photographs are not read: {told}{more}."


def natural_key(name: str) -> list[tuple[bool, int, str]]:
    """Sort key of names in which numbers count by value: ``IMG_2`` stands before ``IMG_10``."""
    return [
        (not part.isdecimal(), int(part) if part.isdecimal() else 0, part)
        for part in re.split(r"(\d+)", name)
    ]


def find_images(paths: Path | Sequence[Path]) -> FoundImages:
    """Photographs of folders and files: files as they are given, folders in natural order.

    Parameters
    ----------
    paths : a folder or a file, or a list of them. Of a folder and of those below it those files count that
        end like a photograph.

    Raises
    ------
    InputError : there is no such folder or file, no photograph in a folder, or the list is empty.
    """
    given = [paths] if isinstance(paths, Path) else list(paths)
    if not given:
        raise InputError("no photographs", expected="at least one image, or a folder of them")
    files: list[Path] = []
    others: list[Path] = []
    for path in given:
        found = FoundImages(files=(path,), others=()) if path.is_file() else _of_folder(path)
        files += found.files
        others += found.others
    return FoundImages(files=tuple(files), others=tuple(others))


def list_images(paths: Path | Sequence[Path]) -> list[Path]:
    """The files of `find_images`, for readers that call a photograph by the name of its file alone.

    Raises
    ------
    InputError : as of `find_images`; or the same name in two folders below one that was given.
    """
    given = [paths] if isinstance(paths, Path) else list(paths)
    out: list[Path] = []
    if not given:
        return list(find_images(given).files)
    for path in given:
        files = find_images(path).files
        files_by_name(
            files, where=" below one folder", cure="Rename one of them, or name the folders that count"
        )
        out += files
    return out


def named_images(images: Images) -> dict[str, Path]:
    """Photographs by name, in natural order of the names.

    Parameters
    ----------
    images : folders and files, as of `find_images`; or photographs that have their names already. A file that
        is missing keeps its name, so that who reads it can say so.

    Raises
    ------
    InputError : no photographs, a folder without them; or a photograph is named twice.
    """
    if isinstance(images, Mapping):
        return dict(sorted(images.items(), key=lambda item: natural_key(item[0])))
    if not images:
        raise InputError("no photographs", expected="at least one image, or a folder of them")
    found = [
        file
        for path in images
        for file in (
            [path] if path.suffix.lower() in IMAGE_ENDINGS and not path.is_dir() else find_images(path).files
        )
    ]
    files = [os.path.abspath(path) for path in found]  # noqa: PTH100 - links stay
    tops = [path if path.is_dir() else path.parent for path in images]
    root = os.path.commonpath([os.path.abspath(top) for top in tops])  # noqa: PTH100
    out: dict[str, Path] = {}
    for file in files:
        name = Path(os.path.relpath(file, root)).as_posix()
        if name in out:
            raise InputError(
                f"the photograph {name} is named twice",
                where=root,
                expected="each file once",
                cure="Name a folder or the files in it, not both, and no folder beside one that holds it",
            )
        out[name] = Path(file)
    return dict(sorted(out.items(), key=lambda item: natural_key(item[0])))


def files_by_name(
    files: Sequence[Path], *, where: str = "", cure: str = "Rename one of them, or leave one folder out"
) -> dict[str, Path]:
    """Photographs by the names of their files alone, in the order given.

    Parameters
    ----------
    where, cure : words for the error.

    Raises
    ------
    InputError : the same name in two folders.
    """
    out: dict[str, Path] = {}
    for file in files:
        other = out.setdefault(file.name, file)
        if other != file:
            raise InputError(
                f"two images of the name {file.name}{where}",
                where=file.parent,
                expected=f"names that differ from those in {other.parent}",
                cure=cure,
            )
    return out


def by_any_name(names: Sequence[str]) -> dict[str, str]:
    """From names as people write them to those of images: with folders, and without where that is clear.

    Endings may be left out. A name without folders that fits images of several folders is not in it.

    Examples
    --------
    >>> found = by_any_name(["left/a.jpg", "right/a.jpg", "right/b.jpg"])
    >>> found["left/a"], found["b.jpg"], found.get("a.jpg")
    ('left/a.jpg', 'right/b.jpg', None)
    """
    out: dict[str, str] = {}
    for key in (
        lambda name: name,
        lambda name: PurePosixPath(name).with_suffix("").as_posix(),
        lambda name: PurePosixPath(name).name,
        lambda name: PurePosixPath(name).stem,
    ):
        times = Counter(key(name) for name in names)
        out |= {key(name): name for name in names if times[key(name)] == 1 and key(name) not in out}
    return out


def read_mask(path: Path, size_px: tuple[int, int] | None = None) -> ArrayB:
    """Where an image may be used (h, w), of whatever scale: its mask is there neither black nor transparent.

    Parameters
    ----------
    size_px : width and height of the image; None: of any shape.

    Raises
    ------
    InputError : the mask cannot be read, or is of another shape than the image.
    """
    try:
        with Image.open(path) as file:
            usable = np.asarray(file.convert("L")) > 0
            if file.has_transparency_data:
                usable &= np.asarray(file.convert("RGBA"))[..., 3] > 0
    except (OSError, ValueError, SyntaxError) as error:
        text = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(
            f"no mask: it cannot be read ({text})", expected="a whole PNG, 0 where not to be used", where=path
        ) from error
    height, width = usable.shape
    if size_px is not None and abs((size_px[0] / width) / (size_px[1] / height) - 1) > _SHAPE:
        raise InputError(
            f"a mask of {width} x {height} pixels, the image has {size_px[0]} x {size_px[1]}",
            expected="a mask with the sides of its image, stored as it is",
            where=path,
        )
    return np.asarray(usable)


def _of_folder(folder: Path) -> FoundImages:
    if not folder.is_dir():
        raise InputError("there is no such folder or file", where=folder, expected="photographs")
    files, others = _walk(folder, set(), hidden=False)
    names = {path.name for path in files}
    stems = {path.stem for path in files if not path.stem.endswith("_mask")}
    masks = {
        path
        for path in files
        if path.suffix.lower() == ".png"
        and (path.stem in names or (path.stem.endswith("_mask") and path.stem.removesuffix("_mask") in stems))
    }
    files = [path for path in files if path not in masks]
    if not files:
        raise InputError(
            "no photograph in this folder",
            where=folder,
            expected=f"files that end in {', '.join(IMAGE_ENDINGS)}",
        )
    ordered = sorted(files, key=lambda path: natural_key(path.relative_to(folder).as_posix()))
    return FoundImages(files=tuple(ordered), others=tuple(sorted([*others, *masks])))


def _walk(folder: Path, seen: set[str], *, hidden: bool) -> tuple[list[Path], list[Path]]:
    """Photographs and other files of a folder and of those below it; links are followed, each folder once."""
    real = os.path.realpath(folder)
    if real in seen:
        return [], []
    seen.add(real)
    files: list[Path] = []
    others: list[Path] = []
    for path in sorted(folder.iterdir()):
        unseen = hidden or path.name.startswith(".")
        if path.is_dir():
            aside = unseen or path.name.lower() in _SYSTEM or _MASKS in path.name.lower()
            more, rest = _walk(path, seen, hidden=aside)
            files += more
            others += rest
        elif path.is_file():
            photograph = path.suffix.lower() in IMAGE_ENDINGS and not unseen
            (files if photograph else others).append(path)
    return files, others
