"""Cures for values: wrong units, decimal commas, near-miss names."""

import difflib
import math
import re
from collections.abc import Iterable
from typing import Any

from thalweg.core.mistakes import Key
from thalweg.settings.messages.shape import all_paths, keys_at, limits_at, unit_at

_COMMA = re.compile(r"^\s*([-+]?\d+),(\d+)\s*$")
_WITH_UNIT = re.compile(r"^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-z°µ%/'\"]+)\s*$")
_NUMBER = re.compile(r"^\s*[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?\s*$")


def nearest(word: str, names: Iterable[str], cutoff: float = 0.6) -> str:
    """The name that most resembles a word, without regard to case; ``""`` if none does."""
    by_lower = {str(name).lower(): str(name) for name in names}
    found = difflib.get_close_matches(word.lower(), list(by_lower), n=1, cutoff=cutoff)
    return by_lower[found[0]] if found else ""


def unknown_key_cure(path: tuple[Key, ...]) -> str:
    """Cure for an unknown key: the nearest one, or the section that it belongs to."""
    key, parent = str(path[-1]), path[:-1]
    if key.isdigit():
        return "A decimal comma splits a number into two: write a decimal point"
    allowed = keys_at(parent)
    near = nearest(key, allowed, cutoff=0.7)
    elsewhere = [p for p in all_paths() if p[-1] == key]
    if elsewhere and (not near or near.lower() != key.lower()):
        places = " or ".join(".".join(p) for p in elsewhere[:3])
        return f"This key belongs to {places}: move it there"
    if near:
        unit = unit_at((near,))
        given = unit_at((key,))
        note = f", in {unit}" if unit and given and unit != given else ""
        return f"Did you mean {near}{note}?"
    far = [p for p in all_paths() if nearest(key, [p[-1]], cutoff=0.85)]
    if far:
        return f"Did you mean {'.'.join(far[0])}?"
    return f"Remove it, or use one of: {', '.join(allowed)}"


def number_cure(path: tuple[Key, ...], value: Any) -> str:
    """Cure for a value that should be a number and is not."""
    unit = unit_at(path)
    if isinstance(value, str):
        if match := _COMMA.match(value):
            return f"Write a decimal point: {match[1]}.{match[2]}"
        if match := _WITH_UNIT.match(value):
            told = f": the unit is fixed, {unit}" if unit else ""
            return f"Write the number alone{told}"
        if _NUMBER.match(value):
            return "Remove the quotes"
    if value is None:
        return "Write a value after the colon, or remove the line: then the default holds"
    if isinstance(value, list):
        return "Write one number without brackets"
    return "Write a number"


def range_cure(path: tuple[Key, ...], value: float) -> str:
    """Cure for a number outside its limits: the unit that was probably meant."""
    low, high = limits_at(path)
    key = next((k for k in reversed(path) if isinstance(k, str)), "")

    def fits(number: float) -> bool:
        """Is a number inside the limits of the key?"""
        return (low is None or number >= low) and (high is None or number <= high)

    if key == "gps_week" and 0 <= value < 1024:
        return f"This looks like a week modulo 1024: write {int(value) + 2048} for surveys since April 2019"
    if key in {"lat_deg", "lon_deg"}:
        whole, minutes = divmod(abs(value), 100)
        if minutes < 60 and fits(whole + minutes / 60) and abs(value) > 180:
            number = math.copysign(whole + minutes / 60, value)
            return f"This looks like NMEA degrees and minutes: write {number:.8f}"
        if key == "lat_deg" and abs(value) <= 180:
            return "Latitude and longitude may be swapped"
        return "Give degrees, not map coordinates"
    unit = unit_at(path)
    for name, smaller, factor in (
        ("metres", "millimetres", 1000), ("metres", "centimetres", 100), ("seconds", "milliseconds", 1000),
    ):  # fmt: skip
        if unit == name and high is not None and value > high and fits(value / factor):
            return f"This looks like {smaller}: write {value / factor:g}"
    if value < 0 and low is not None and low >= 0 and fits(-value):
        return f"Write it without the sign: {-value:g}"
    return f"Choose a value inside the limits, in {unit}" if unit else "Choose a value inside the limits"


def radians_cure(key: str, value: float) -> str:
    """Cure if an angle in degrees is a rounded multiple of pi/4, thus probably in radians; else ``""``.

    Only a value that equals the multiple to all of its own digits is suspected, and at least two of them:
    1.57 is, a calibrated 1.5731 is not.
    """
    digits = len(f"{value!r}".partition(".")[2])
    if value == 0 or digits < 2:
        return ""
    steps = round(value / (math.pi / 4))
    if steps == 0 or abs(steps) > 8 or round(steps * math.pi / 4, digits) != value:
        return ""
    return (
        f"{key} = {value!r} looks like radians: write {steps * 45}, "
        f"or {value + math.copysign(10.0 ** -(digits + 2), value):.{digits + 2}f} if degrees are meant"
    )
