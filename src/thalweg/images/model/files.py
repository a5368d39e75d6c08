"""Images before their features are looked for: readable, sharp, how much of them is usable, doubled or not.

Pixels are those of the stored raster: a rotation noted in EXIF is not applied, because the interior
orientation belongs to the sensor.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import laplace

from thalweg.core.errors import InputError
from thalweg.core.types import ArrayB
from thalweg.ingest.photos.files import Images, named_images

Grey = NDArray[np.uint8]

LEAST_SHARE: Final = 0.005
"""Share of usable pixels below which an image counts as wholly masked."""

CAUSES: Final = ("unreadable", "mask", "masked", "featureless", "double", "size")
"""Kinds of problems: the file, the mask's file, all masked, too few features, same bytes, other size."""

_SHAPE: Final = 0.01
"""Sides of a mask and of its image may differ by this share after scaling."""


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
            f"masks in {len(folders)} folders", where=folders[1], expected=f"all of them in {folders[0]}",
            cure="Put the masks of all images into one folder, or name the folder above them",
        )  # fmt: skip
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


def inspect(
    path: Path, mask_path: Path | None, max_size_px: int, *, name: str | None = None
) -> tuple[Picture, Grey, ArrayB]:
    """Read an image and its mask.

    Parameters
    ----------
    name : of the image; None: that of its file.
    path, mask_path : files; 0 in the mask is masked, anything else is usable.
    max_size_px : longest side of the grey picture that is handed on; larger images are scaled by averaging.

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
        grey, size_px = _read_grey(path, max_size_px)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        text = (str(error).splitlines() or [type(error).__name__])[0].replace(str(path), path.name)
        problem = f"cannot be read ({text})" if path.is_file() else "there is no such file"
        return Picture(name=name, problem=problem, cause="unreadable"), none, everything
    sha256 = hashlib.sha256(data).hexdigest()
    known = Picture(name=name, size_px=size_px, sha256=sha256)
    usable = everything
    if mask_path is not None:
        try:
            with Image.open(mask_path) as mask:
                usable = np.asarray(mask.convert("L")) > 0
        except (OSError, ValueError, SyntaxError) as error:
            text = (str(error).splitlines() or [type(error).__name__])[0]
            return with_problem(known, f"its mask cannot be read ({text})", "mask"), none, everything
        ratio = (size_px[0] / usable.shape[1]) / (size_px[1] / usable.shape[0])
        if abs(ratio - 1) > _SHAPE:
            shape = f"{usable.shape[1]} x {usable.shape[0]}"
            problem = f"its mask has {shape} pixels, the image {size_px[0]} x {size_px[1]}"
            return with_problem(known, problem, "mask"), none, everything
    inside = at_pixels(usable, *_centres(grey.shape), (grey.shape[1], grey.shape[0]))
    share = float(inside.mean())
    if share < LEAST_SHARE:
        problem = f"no usable pixels: {100 * (1 - share):.1f} % are masked"
        return replace(with_problem(known, problem, "masked"), usable_share=share), none, usable
    values = grey.astype(np.float32)
    contrast = float(values[inside].std())
    sharpness = float(laplace(values)[inside].std()) / contrast if contrast > 0 else 0.0
    picture = Picture(
        name=name,
        size_px=size_px,
        sha256=sha256,
        usable_share=share,
        contrast=contrast,
        sharpness=sharpness,
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


def _read_grey(path: Path, max_size_px: int) -> tuple[Grey, tuple[int, int]]:
    with Image.open(path) as image:
        size = image.size
        image.draft("L", size)  # of a JPEG only its brightness is decoded
        if image.mode.startswith("I"):  # 16 bits
            picture = Image.fromarray((np.asarray(image).astype(np.int64) >> 8).clip(0, 255).astype(np.uint8))
        else:
            picture = image.convert("L")
    factor = max_size_px / max(size)
    if factor < 1:
        small = (max(1, round(size[0] * factor)), max(1, round(size[1] * factor)))
        picture = picture.resize(small, Image.Resampling.BOX)
    return np.asarray(picture), size
