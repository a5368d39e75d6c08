"""Which image of the campaign a name in another program's file means."""

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import PurePosixPath
from typing import Final

import numpy as np

from thalweg.core.errors import InputError
from thalweg.core.types import ArrayI

_NAMED: Final = 3


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
            f"{' and '.join(same[:_NAMED])} both mean the image {images[twice[0]]}",
            expected="one pose of each image", where=where, cure="Export with the whole names of the images",
        )  # fmt: skip
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
        expected=f"names as {_some(images)}, at least {100 * least_share:.0f} % of them", where=where,
        cure="Check that the file belongs to these images, or lower images.finished.least_matched",
    )  # fmt: skip


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:_NAMED]) + (" ..." if len(names) > _NAMED else "")
