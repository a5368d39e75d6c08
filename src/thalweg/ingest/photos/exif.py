"""What the head of a photograph tells: time with sub-seconds and time zone, camera, focal length, size."""

import datetime as dt
import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from PIL import Image, UnidentifiedImageError

from thalweg.core import InputError
from thalweg.ingest import possible_unix

_DATE = re.compile(r"\s*(\d{4})[:\-/](\d\d)[:\-/](\d\d)[ T](\d\d):(\d\d):(\d\d)(?:[.,](\d+))?\s*\Z")
_OFFSET = re.compile(r"\s*(?:UTC|GMT)?\s*([+-])(\d{1,2})(?::?([0-5]\d))?\s*\Z")
_EXIF_IFD: Final = 0x8769
_GPS_IFD: Final = 0x8825
_MAKE, _MODEL, _FOCAL = 0x010F, 0x0110, 0x920A
_SERIALS: Final = (0xA431, 0xC62F)
"""Serial number of the body: BodySerialNumber (EXIF 2.3), CameraSerialNumber (DNG)."""

# Scanned aerial films and backs of 150 megapixels are photographs too; Pillow refuses from twice that on.
Image.MAX_IMAGE_PIXELS = 250_000_000

_TIMES: Final = (
    (_EXIF_IFD, 0x9003, 0x9291, 0x9011),  # DateTimeOriginal: when the shutter opened
    (_EXIF_IFD, 0x9004, 0x9292, 0x9012),  # DateTimeDigitized
    (0, 0x0132, 0x9290, 0x9010),  # DateTime: of the last change of the file
)
"""Directory, time, its sub-seconds, its offset from UTC (EXIF 2.31), in order of preference."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CivilStamp:
    """A date and time as a clock shows it.

    ``second_s`` is the whole second as Unix time if the clock showed UTC, ``fraction_s`` what is behind it;
    ``resolution_s`` the unit of the last digit; ``utc_offset_s`` clock minus UTC, None if not stated.
    """

    second_s: int
    fraction_s: float
    resolution_s: float
    utc_offset_s: float | None = None

    @property
    def shown_s(self) -> float:
        """Seconds that the clock showed, as Unix time; float64 resolves 240 ns."""
        return self.second_s + self.fraction_s


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageHead:
    """Size in pixels, camera, focal length (NaN if not stated), time (None if there is none), serial number.

    Texts that are not stated are empty. ``of_change``: the time is that of the last change of the file;
    ``gps_unix_s``: UTC of the GPS fix, None if there is none.
    """

    width: int
    height: int
    make: str
    model: str
    focal_mm: float
    stamp: CivilStamp | None
    serial: str = ""
    of_change: bool = False
    gps_unix_s: float | None = None


def read_head(path: Path) -> ImageHead:
    """Head of a photograph; its pixels are not decoded.

    Raises
    ------
    InputError : the file is missing, empty or no image.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # damaged EXIF: what can be read is read, the rest is absent
            with Image.open(path) as image:
                return _head(image)
    except FileNotFoundError as error:
        raise InputError("file not found", where=path, expected="a photograph") from error
    except UnidentifiedImageError as error:
        raise InputError(
            "this is no image" if path.stat().st_size else "the file is empty",
            where=path,
            expected="a photograph (JPEG, TIFF, PNG)",
            cure="Copy it from the camera again, or take it out of the folder",
        ) from error
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"the image cannot be read ({error})", where=path) from error


def _head(image: Image.Image) -> ImageHead:
    try:
        exif = image.getexif()
        tags: dict[int, dict[int, Any]] = {
            0: dict(exif),
            **{folder: dict(exif.get_ifd(folder)) for folder in (_EXIF_IFD, _GPS_IFD)},
        }
    except (OSError, SyntaxError, ValueError, KeyError, TypeError, EOFError):
        tags = {0: {}, _EXIF_IFD: {}, _GPS_IFD: {}}
    every = {**tags[0], **tags[_EXIF_IFD]}
    stamp, of_change = None, False
    for folder, when, fraction, offset in _TIMES:
        of_change = stamp is None and folder == 0
        # some cameras put sub-seconds and offset of DateTime into the first directory
        stamp = stamp or stamp_from_exif(tags[folder].get(when), every.get(fraction), every.get(offset))
    return ImageHead(
        width=image.width,
        height=image.height,
        make=_text(tags[0].get(_MAKE)),
        model=_text(tags[0].get(_MODEL)),
        focal_mm=_number(every.get(_FOCAL)),
        stamp=stamp,
        serial=next((text for tag in _SERIALS if (text := _text(every.get(tag)))), ""),
        of_change=of_change and stamp is not None,
        gps_unix_s=_gps_time(tags[_GPS_IFD]),
    )


def _gps_time(tags: dict[int, Any]) -> float | None:
    """UTC of GPSDateStamp and GPSTimeStamp as Unix time; None if they are absent or impossible."""
    try:
        hour, minute, second = (float(part) for part in tags[0x0007])
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    found = re.fullmatch(r"\s*(\d{4})[:\-/](\d\d)[:\-/](\d\d)\s*", _text(tags.get(0x001D)))
    day = civil_second(int(found[1]), int(found[2]), int(found[3]), 0, 0, 0) if found else None
    if day is None or not possible_unix(day) or not 0 <= hour < 24:
        return None
    return day + 3600.0 * hour + 60.0 * minute + second


def stamp_from_exif(when: Any, fraction: Any = None, offset: Any = None) -> CivilStamp | None:
    """Stamp from the texts of the three EXIF tags; None if the date is absent or impossible.

    Parameters
    ----------
    when : ``2021:05:12 08:31:07``; other separators are met too.
    fraction : decimal digits behind the second (SubSecTime).
    offset : clock minus UTC, ``+02:00`` (OffsetTime).

    Examples
    --------
    >>> stamp_from_exif("2021:05:12 10:31:07", "250", "+02:00")
    CivilStamp(second_s=1620815467, fraction_s=0.25, resolution_s=0.001, utc_offset_s=7200.0)
    """
    found = _DATE.match(_text(when))
    if not found:
        return None
    second = civil_second(*(int(part) for part in found.groups()[:6]))
    if second is None or not possible_unix(second):
        return None
    digits = found.group(7) or _text(fraction).strip()
    if not digits.isdecimal() or not digits.isascii():
        digits = ""
    return CivilStamp(
        second_s=second,
        fraction_s=int(digits) / 10 ** len(digits) if digits else 0.0,
        resolution_s=10.0 ** -len(digits),
        utc_offset_s=offset_seconds(_text(offset)),
    )


def civil_second(year: int, month: int, day: int, hour: int, minute: int, second: int) -> int | None:
    """Unix time of a date and time shown by a clock on UTC; None if there is no such date."""
    try:
        moment = dt.datetime(year, month, day, hour, minute, second, tzinfo=dt.UTC)
    except ValueError:
        return None
    return int(moment.timestamp())


def offset_seconds(text: str) -> float | None:
    """Offset of a clock from UTC in seconds; None if the text is none.

    Examples
    --------
    >>> [offset_seconds(t) for t in ("+02:00", "-0330", "UTC+1", "Z", "soon")]
    [7200.0, -12600.0, 3600.0, 0.0, None]
    """
    if text.strip().upper() in ("Z", "UTC", "GMT"):
        return 0.0
    found = _OFFSET.match(text.upper())
    if not found or int(found.group(2)) > 14:
        return None
    seconds = 3600.0 * int(found.group(2)) + 60.0 * int(found.group(3) or 0)
    return -seconds if found.group(1) == "-" else seconds


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    return "" if value is None else str(value).split("\0")[0].strip()


def _number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return float("nan")
