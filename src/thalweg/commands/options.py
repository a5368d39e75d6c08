"""Options that several commands share, and the kinds of their values."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Final, TypeVar

from thalweg.commands.parser import REQUIRED

T = TypeVar("T")


def checked(read: Callable[[str], T], expected: str, fits: Callable[[T], bool]) -> Callable[[str], T]:
    """The kind of an option whose value is `read` from the text, and refused where it does not fit."""

    def kind(text: str) -> T:
        """The value, or the refusal that names what was expected."""
        refusal = argparse.ArgumentTypeError(f"{text!r}; expected {expected}")
        try:
            value = read(text)
        except ValueError:
            raise refusal from None
        if not fits(value):
            raise refusal
        return value

    return kind


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split(","))


def _is_above_zero(value: float) -> bool:
    return 0 < value < float("inf")


def lengths(expected: str) -> Callable[[str], tuple[float, ...]]:
    """Lengths above zero with commas between them."""
    return checked(_numbers, expected, lambda values: all(map(_is_above_zero, values)))


positive: Final = checked(float, "a number above zero", _is_above_zero)
above_zero: Final = checked(float, "a length above zero", _is_above_zero)
length: Final = checked(float, "one length in metres", lambda value: 0 <= value < float("inf"))
count: Final = checked(int, "a whole number, 1 or more", lambda value: value >= 1)
nodata: Final = checked(
    lambda text: float("nan" if text.lower() == "none" else text), "a number or none", lambda _: True
)
place: Final = checked(_numbers, "a place such as 412000,5651000,150", lambda values: len(values) == 3)
direction: Final = checked(
    _numbers,
    "a direction such as 0,0,1",
    lambda values: len(values) == 3 and _is_above_zero(sum(value**2 for value in values)),
)
size: Final = checked(
    lambda text: tuple(int(part) if part.isdigit() else 0 for part in text.lower().split("x")),
    "width x height such as 640x480",
    lambda values: len(values) == 2 and all(values),
)

CAMPAIGNS: Final = Path("config") / "campaigns"
GEODETIC: Final = ("LAT_DEG", "LON_DEG", "H_ELL_M")
XYZ: Final = ("X_M", "Y_M", "Z_M")
LENSES: Final = ("perspective", "fisheye")
INTERIORS: Final = ("auto", "free", "weighted", "fixed")
CLOUDS: Final = "LAS, LAZ, PLY, E57, x y z text"
LINE: Final = "one line of a GIS, or CSV with east, north, in downstream order"

CENTRE_LINE: Final = ("--centre-line", Path, "FILE", f"{LINE} (default: from banks or soundings)")
FOLDER: Final = ("--out", Path, "FOLDER", "folder of the results", REQUIRED)
PHOTOGRAPHS: Final = ("photographs", [Path], "PHOTO", "folders or files")


def folder(default: str) -> tuple[object, ...]:
    """Folder of the results, with a name of its own."""
    return ("--out", Path, "FOLDER", "folder of the results (default: %(default)s)", Path(default))
