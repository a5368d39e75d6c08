"""Photographs as cameras store them: JPEG with EXIF 2.32 (CIPA DC-008-2019)."""

import datetime as dt
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image

from thalweg.core.types import ArrayU8

MAKE: Final = "Thalweg"
SOFTWARE: Final = "digital twin"

_MAKE, _MODEL, _SOFTWARE, _CHANGED, _EXIF_IFD = 0x010F, 0x0110, 0x0131, 0x0132, 0x8769
_EXPOSURE_TIME, _TAKEN, _DIGITISED, _ZONE = 0x829A, 0x9003, 0x9004, 0x9011
_FOCAL_LENGTH, _SUB_SECONDS, _WIDTH, _HEIGHT = 0x920A, 0x9291, 0xA002, 0xA003
_ORIENTATION: Final = 0x0112
_FOCAL_35MM: Final = 0xA405


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoFacts:
    """What a camera knows of its photograph.

    Parameters
    ----------
    model : of the camera.
    clock_us : reading of the camera's clock when it was taken, microseconds since 1970; None: no clock.
    sub_seconds : digits behind the second that the camera writes, 0 to 6; they are cut, not rounded.
    zone : offset of the camera's clock from UTC as ``+00:00``; None: not written.
    focal_mm : focal length.
    focal_35mm : focal length that sees as wide on a picture of 36 mm, whole millimetres.
    exposure_s : exposure time.
    """

    model: str
    clock_us: int | None = None
    sub_seconds: int = 0
    zone: str | None = None
    focal_mm: float | None = None
    focal_35mm: int | None = None
    exposure_s: float | None = None


def jpeg_bytes(image: ArrayU8, facts: PhotoFacts, *, quality: int) -> bytes:
    """A JPEG file.

    Parameters
    ----------
    image : (h, w, 3) sRGB or (h, w) grey.
    facts : written as EXIF.
    quality : 1 to 100.
    """
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(
        buffer, format="JPEG", quality=quality, exif=_exif(image, facts)
    )
    return buffer.getvalue()


def write_jpeg(path: Path, image: ArrayU8, facts: PhotoFacts, *, quality: int) -> None:
    """Write a photograph; see `jpeg_bytes`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(jpeg_bytes(image, facts, quality=quality))


def exif_time(clock_us: int, digits: int) -> tuple[str, str]:
    """Date and time as EXIF writes it, and the digits behind the second.

    Examples
    --------
    >>> exif_time(1620808267_042900, 3)
    ('2021:05:12 08:31:07', '042')
    """
    whole, micros = divmod(clock_us, 1_000_000)
    moment = dt.datetime.fromtimestamp(whole, dt.UTC)
    return f"{moment:%Y:%m:%d %H:%M:%S}", f"{micros:06d}"[:digits]


def _exif(image: ArrayU8, facts: PhotoFacts) -> Image.Exif:
    exif = Image.Exif()
    exif[_MAKE], exif[_MODEL], exif[_SOFTWARE] = MAKE, facts.model, SOFTWARE
    exif[_ORIENTATION] = 1
    own = exif.get_ifd(_EXIF_IFD)
    own[_WIDTH], own[_HEIGHT] = image.shape[1], image.shape[0]
    if facts.clock_us is not None:
        text, digits = exif_time(facts.clock_us, facts.sub_seconds)
        exif[_CHANGED] = own[_TAKEN] = own[_DIGITISED] = text
        if digits:
            own[_SUB_SECONDS] = digits
        if facts.zone is not None:
            own[_ZONE] = facts.zone
    if facts.focal_mm is not None:
        own[_FOCAL_LENGTH] = facts.focal_mm
    if facts.focal_35mm is not None:
        own[_FOCAL_35MM] = facts.focal_35mm
    if facts.exposure_s is not None:
        own[_EXPOSURE_TIME] = facts.exposure_s
    return exif
