"""Photographs that stand in figures."""

from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from thalweg.core import ArrayU8, InputError


def read_picture(path: Path) -> ArrayU8:
    """A photograph as (h, w) or (h, w, 3) uint8, as its pixels lie: EXIF does not turn it.

    Raises
    ------
    InputError : the file is missing or no picture.
    """
    if not path.is_file():
        raise InputError("file not found", expected="a picture", where=path)
    try:
        with Image.open(path) as image:
            data = image if image.mode == "L" else image.convert("RGB")
            return np.asarray(data, dtype=np.uint8)
    except (UnidentifiedImageError, OSError, ValueError) as error:
        raise InputError(f"no picture ({error})", expected="JPEG or PNG", where=path) from error
