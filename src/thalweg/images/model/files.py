"""The images of a campaign before their features are looked for: files, cameras, names.

Pixels are those of the stored raster: a rotation noted in EXIF is not applied, because the interior
orientation belongs to the sensor.
"""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import laplace

from thalweg.core import AnyArray, ArrayB, ArrayI, InputError
from thalweg.ingest.photos import ImageHead, Images, named_images, read_head, read_mask

Grey = NDArray[np.uint8]
LEAST_SHARE: Final = 0.005
"""Share of usable pixels below which an image counts as wholly masked."""
CAUSES: Final = ("unreadable", "mask", "masked", "featureless", "double", "size")
"""Kinds of problems: the file, the mask's file, all masked, too few features, same bytes, other size."""

KINDS: Final = ("auto", "folder", "exif", "size")
_CAMERAS_NAMED: Final = 4

_NAMES_SHOWN: Final = 3


# ---------------------------------------------------------------- readable, sharp, usable, doubled or not


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """What is known of an image before its features are looked for.

    Parameters
    ----------
    name : as of `thalweg.ingest.photos.files.named_images`.
    size_px : width and height; zeros if unreadable.
    sha256 : of the file's bytes; empty if unreadable.
    usable_share : share of pixels that no mask covers.
    contrast : standard deviation of the usable grey values, steps of 8 bits.
    sharpness : standard deviation of the Laplacian over that of the grey values; falls with blur.
    problem : why the image cannot take part; empty if it can.
    cause : kind of the problem, one of `CAUSES`; empty without one.
    """

    name: str
    size_px: tuple[int, int] = (0, 0)
    sha256: str = ""
    usable_share: float = 0.0
    contrast: float = 0.0
    sharpness: float = 0.0
    problem: str = ""
    cause: str = ""


def named_once(images: Images) -> dict[str, Path]:
    """The images by name, in natural order of their names; files get names from their folders.

    Raises
    ------
    InputError : no image at all, or a file twice.
    """
    if not images:
        raise InputError("no images", expected="at least two photographs")
    return named_images(images)


def mask_names(image: str) -> tuple[str, ...]:
    """Names under which the mask of an image is looked for in its folder, the best first."""
    path = PurePosixPath(image)
    return tuple(
        path.with_name(name).as_posix()
        for name in (f"{path.name}.png", f"{path.stem}.png", f"{path.stem}_mask.png")
    )


def mask_folder(paths: Sequence[Path]) -> Path | None:
    """Folder of the masks that were named, as a folder or as files; None without any.

    Raises
    ------
    InputError : no such folder, or masks in several folders.
    """
    folders = list(dict.fromkeys(path.parent if path.is_file() else path for path in paths))
    if len(folders) > 1:
        raise InputError(
            f"masks in {len(folders)} folders",
            where=folders[1],
            expected=f"all of them in {folders[0]}",
            cure="Put the masks of all images into one folder, or name the folder above them",
        )
    if folders and not folders[0].is_dir():
        raise InputError("folder not found", expected="masks named <image>.png", where=folders[0])
    return folders[0] if folders else None


def find_mask(image: str, masks: Path | None) -> Path | None:
    """Mask of an image: ``<name with ending>.png``, as COLMAP names it, else ``<name without ending>.png``.

    The latter may end in ``_mask.png``, as Metashape names it. Masks stand in folders like those of their
    images, or all in one folder; there two images of one file name share a mask, see `check_flat_masks`.
    """
    if masks is None:
        return None
    for name in (*mask_names(image), *mask_names(PurePosixPath(image).name)):
        if (masks / name).is_file():
            return masks / name
    return None


def check_flat_masks(images: Sequence[str], masks: Path) -> None:
    """Refuse masks in one folder of which it cannot be told to which of two images they belong.

    Raises
    ------
    InputError : two images of one file name in different folders have the same mask.
    """
    of: dict[Path, str] = {}
    for image in images:
        mask = find_mask(image, masks)
        other = image if mask is None else of.setdefault(mask, image)
        if mask is not None and PurePosixPath(other).parent != PurePosixPath(image).parent:
            raise InputError(
                f"one mask {mask.name} for {other} and {image}",
                where=masks,
                expected=f"folders like those of the images, as {image}.png",
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class LensView:
    """A lens as a view of a file: ``cut`` takes it out of the pixels (H, W) of the file, ``usable`` (h, w)
    tells where, and ``lens`` is its name.
    """

    lens: str
    cut: Callable[[AnyArray], AnyArray]
    usable: ArrayB


def inspect(
    path: Path,
    mask_path: Path | None,
    max_size_px: int,
    *,
    name: str | None = None,
    view: LensView | None = None,
) -> tuple[Picture, Grey, ArrayB]:
    """Read an image and its mask.

    Parameters
    ----------
    name : of the image; None: that of its file.
    path, mask_path : files, see `read_mask`.
    max_size_px : longest side of the grey picture that is handed on; larger images are scaled by averaging.
    view : the part of the file that is the image; None: all of it.

    Returns
    -------
    picture : facts, with a problem if the image cannot take part.
    grey : (rows, columns) picture, scaled; empty if there is a problem.
    usable : (rows, columns) of the mask file, any scale; (1, 1) without a mask.
    """
    none, everything = np.zeros((0, 0), np.uint8), np.ones((1, 1), bool)
    name = name or path.name
    try:
        data = path.read_bytes()
        grey, size_px = _read_grey(path, max_size_px, view)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        text = (str(error).splitlines() or [type(error).__name__])[0].replace(str(path), path.name)
        problem = f"cannot be read ({text})" if path.is_file() else "there is no such file"
        return Picture(name=name, problem=problem, cause="unreadable"), none, everything
    sha256 = hashlib.sha256(data + (b"" if view is None else view.lens.encode())).hexdigest()
    known = Picture(name=name, size_px=size_px, sha256=sha256)
    usable = everything
    if view is not None and view.usable.shape != size_px[::-1]:
        problem = f"its view has {size_px[0]} x {size_px[1]} pixels, the lens {view.usable.shape[::-1]}"
        return with_problem(known, problem, "size"), none, everything
    if mask_path is not None:
        try:
            usable = read_mask(mask_path, size_px)
        except InputError as error:
            return with_problem(known, error.found, "mask"), none, everything
    if view is not None:
        usable = view.usable & at_pixels(usable, *_centres(view.usable.shape), size_px)
    inside = at_pixels(usable, *_centres(grey.shape), (grey.shape[1], grey.shape[0]))
    share = float(inside.mean())
    if share < LEAST_SHARE:
        problem = f"no usable pixels: {100 * (1 - share):.1f} % are masked"
        return replace(with_problem(known, problem, "masked"), usable_share=share), none, usable
    values = grey.astype(np.float32)
    contrast = float(values[inside].std())
    sharpness = float(laplace(values)[inside].std()) / contrast if contrast > 0 else 0.0
    picture = Picture(
        name=name, size_px=size_px, sha256=sha256, usable_share=share, contrast=contrast, sharpness=sharpness
    )
    return picture, grey, usable


def at_pixels(
    usable: ArrayB, x_px: NDArray[np.floating], y_px: NDArray[np.floating], size_px: tuple[int, int]
) -> ArrayB:
    """Values of a mask, of whatever scale, at pixels of a picture of the given width and height."""
    rows, columns = usable.shape
    column = np.clip((x_px * (columns / size_px[0])).astype(np.int64), 0, columns - 1)
    row = np.clip((y_px * (rows / size_px[1])).astype(np.int64), 0, rows - 1)
    return np.asarray(usable[row, column])


def without_doubles(pictures: Sequence[Picture]) -> list[Picture]:
    """The same pictures; of files with the same bytes all but the first get a problem."""
    first: dict[str, str] = {}
    out = []
    for picture in pictures:
        twin = first.setdefault(picture.sha256, picture.name) if picture.sha256 else picture.name
        double = twin != picture.name and not picture.problem
        out.append(with_problem(picture, f"the same file as {twin}", "double") if double else picture)
    return out


def with_problem(picture: Picture, problem: str, cause: str) -> Picture:
    """The same image with a problem."""
    return replace(picture, problem=problem, cause=cause)


def _centres(shape: tuple[int, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    y, x = np.mgrid[: shape[0], : shape[1]]
    return x + 0.5, y + 0.5


def _read_grey(path: Path, max_size_px: int, view: LensView | None) -> tuple[Grey, tuple[int, int]]:
    with Image.open(path) as image:
        size = image.size
        image.draft("L", size)  # of a JPEG only its brightness is decoded
        if image.mode.startswith("I"):  # 16 bits
            picture = Image.fromarray((np.asarray(image).astype(np.int64) >> 8).clip(0, 255).astype(np.uint8))
        else:
            picture = image.convert("L")
    if view is not None:
        picture = Image.fromarray(np.ascontiguousarray(view.cut(np.asarray(picture))))
        size = picture.size
    factor = max_size_px / max(size)
    if factor < 1:
        small = (max(1, round(size[0] * factor)), max(1, round(size[1] * factor)))
        picture = picture.resize(small, Image.Resampling.BOX)
    return np.asarray(picture), size


# ---------------------------------------------------------------- which images one camera took


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
    told = ", ".join(f"{c.name} ({len(c.images)} images)" for c in cameras[:_CAMERAS_NAMED])
    more = f" and {len(cameras) - _CAMERAS_NAMED} more" if len(cameras) > _CAMERAS_NAMED else ""
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


# ---------------------------------------------------------------- which image a name in another program's
# file means


def base_name(name: str) -> str:
    """Name without folders, also those of Windows."""
    return PurePosixPath(name.strip().strip('"').replace("\\", "/")).name


def near_name(name: str) -> str:
    """Name with its last folder."""
    return "/".join(PurePosixPath(name.strip().strip('"').replace("\\", "/")).parts[-2:])


_KEYS: Final[tuple[Callable[[str], str], ...]] = (
    lambda name: name,
    near_name,
    base_name,
    lambda name: PurePosixPath(base_name(name)).stem,
    lambda name: base_name(name).casefold(),
    lambda name: PurePosixPath(base_name(name)).stem.casefold(),
)
"""From the strictest to the loosest: as it is, with its last folder, without folders, without suffix, in any
case, both."""


def matched(names: Sequence[str], images: Sequence[str], where: str, *, once: bool = True) -> ArrayI:
    """Index (n,) of each name among the images; -1 where none or more than one fits.

    Raises
    ------
    InputError : two names mean the same image; not asked without ``once``.
    """
    found = np.full(len(names), -1, np.int64)
    for key in _KEYS:
        keys = [key(image) for image in images]
        times = Counter(keys)
        index = {k: i for i, k in enumerate(keys) if times[k] == 1}
        for row in np.flatnonzero(found < 0).tolist():
            found[row] = index.get(key(names[row]), -1)
    hit = found[found >= 0]
    twice = [i for i, n in Counter(hit.tolist()).items() if n > 1]
    if once and twice:
        same = [name for name, i in zip(names, found, strict=True) if i == twice[0]]
        raise InputError(
            f"{' and '.join(same[:_NAMES_SHOWN])} both mean the image {images[twice[0]]}",
            expected="one pose of each image",
            where=where,
            cure="Export with the whole names of the images",
        )
    return found


def check_share(
    found: ArrayI, names: Sequence[str], images: Sequence[str], least_share: float, where: str
) -> None:
    """Refuse a file of which too few names are images of the campaign.

    Raises
    ------
    InputError : none is, or a smaller share than ``least_share``.
    """
    hit = int((found >= 0).sum())
    if hit and hit >= least_share * len(names):
        return
    lost = [name for name, i in zip(names, found, strict=True) if i < 0]
    raise InputError(
        f"{hit} of {len(names)} images of the file are images of the campaign; not so {_some(lost)}",
        expected=f"names as {_some(images)}, at least {100 * least_share:.0f} % of them",
        where=where,
        cure="Check that the file belongs to these images, or lower images.finished.least_matched",
    )


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:_NAMES_SHOWN]) + (" ..." if len(names) > _NAMES_SHOWN else "")
