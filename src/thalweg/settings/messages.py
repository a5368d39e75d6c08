"""Mistakes of campaign files in words: what was found where, what was expected, what to do."""

import difflib
import glob
import math
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Final

from pydantic_core import ErrorDetails

from thalweg.core import ConfigError, Key, Mistake, Node, Schema, number_in_words
from thalweg.settings.campaign import Campaign

# ---------------------------------------------------------------- the error that lists all


class CampaignError(ConfigError):
    """All mistakes of one or several campaign files, one a line.

    Parameters
    ----------
    mistakes : at least one.
    """

    def __init__(self, mistakes: Sequence[Mistake]) -> None:
        self.mistakes = tuple(mistakes)
        n = len(self.mistakes)
        lines = "\n".join(f"  {mistake}" for mistake in self.mistakes)
        head = f"{n} mistake{'s' if n > 1 else ''} in the campaign settings"
        super().__init__(f"{head}:\n{lines}")
        # The base class ends its text with a stop; here each line has one.
        self.args = (self.found,)


# ---------------------------------------------------------------- mistakes as rows


def value_at(section: Any, *keys: str) -> Any:
    """A value below a section as written in the file, None if absent."""
    for key in keys:
        section = section.get(key) if isinstance(section, Mapping) else None
    return section


def mistake(where: str | tuple[Key, ...], found: str, expected: str = "", cure: str = "") -> Mistake:
    """A mistake at a path: its keys, or these with dots between them."""
    path = tuple(where.split(".")) if isinstance(where, str) else where
    return Mistake(path=path, found=found, expected=expected, cure=cure)


def lacking(where: str, given: Any, needed: Mapping[str, str], more: str = "") -> Iterator[Mistake]:
    """Keys below a place that are needed and not given.

    Parameters
    ----------
    where : the place, with dots between its keys.
    given : the section.
    needed : what each key holds.
    more : where to read on, behind the cure.
    """
    for key, what in needed.items():
        if not getattr(given, key):
            yield mistake(f"{where}.{key}", "missing", what, f"Add the line `{key}: [...]`{more}")


def single(where: str, counts: Mapping[str, int], expected: str, cure: str) -> Iterator[Mistake]:
    """Keys below a place that name several files where one is expected."""
    for key, count in counts.items():
        if count > 1:
            yield mistake(f"{where}.{key}", f"{count} files", expected, cure)


# ---------------------------------------------------------------- paths of raw logs


_MAGIC = set("*?[")


def is_pattern(text: str) -> bool:
    """True if the text holds a glob pattern."""
    return bool(_MAGIC & set(text))


def anchor(text: str, folder: Path) -> Path:
    """Absolute path of a text in a campaign file: ``~`` expanded, relative to ``folder``."""
    return Path(os.path.normpath(folder.absolute() / os.path.expanduser(text)))  # noqa: PTH111 - unknown ~user stays


MOST_FILES: Final = 100_000
"""No stream of a survey has that many; a pattern of a level too high soon has."""


def expand(text: str, folder: Path) -> list[Path]:
    """Files that a path or a pattern names, in `natural_order`; empty if a pattern matches none.

    An existing file whose name holds pattern characters is taken as it is.

    Raises
    ------
    ConfigError : the pattern searches a whole disk, or matches more than `MOST_FILES`.
    """
    path = anchor(text, folder)
    if not is_pattern(text) or path.exists():
        return [path]
    everywhere = path.parts.index("**") if "**" in path.parts else len(path.parts)
    matches = [] if everywhere < 2 else list(islice(glob.iglob(str(path), recursive=True), MOST_FILES + 1))  # noqa: PTH207 - absolute patterns
    if everywhere < 2 or len(matches) > MOST_FILES:
        raise ConfigError(
            f"the pattern {text!r} searches a whole disk"
            if everywhere < 2
            else f"the pattern {text!r} matches more than {MOST_FILES:,} files and folders",
            expected="the files of one stream",
            cure="Name the folder that holds them, for instance raw/lidar/*.pcap",
        )
    return sorted((m for m in map(Path, matches) if m.is_file()), key=natural_order)


def natural_order(path: Path) -> tuple[tuple[tuple[str | int, ...], ...], tuple[str, ...]]:
    """Sort key of paths, folder by folder, in which numbers count by value: part_2 before part_10.

    Names that differ in leading zeros only are told apart by their text.

    Examples
    --------
    >>> [p.name for p in sorted(map(Path, ["part_10.pcap", "part_2.pcap", "part.pcap"]), key=natural_order)]
    ['part.pcap', 'part_2.pcap', 'part_10.pcap']
    """
    # the pieces are text, number, text, ... in turn, so that like is compared with like
    pieces = (re.split(r"(\d+)", part) for part in path.parts)
    return tuple(tuple(int(t) if k % 2 else t for k, t in enumerate(p)) for p in pieces), path.parts


def nearest_names(path: Path) -> list[str]:
    """Names in the folder of a missing file that resemble it, best first."""
    if not path.parent.is_dir():
        return []
    try:
        names = sorted(entry.name for entry in path.parent.iterdir())
    except OSError:
        return []
    by_lower = {name.lower(): name for name in names}
    close = difflib.get_close_matches(path.name.lower(), list(by_lower), n=3, cutoff=0.6)
    return [by_lower[name] for name in close]


def missing_cure(path: Path) -> str:
    """What to do about a missing file: the nearest name, or the first folder that does not exist."""
    names = nearest_names(path)
    if names:
        return f"Did you mean {names[0]} in {path.parent}?"
    folder = path.parent
    if folder.is_dir():
        return f"The folder {folder} exists; it holds {_some_names(folder)}"
    while not folder.parent.is_dir() and folder != folder.parent:
        folder = folder.parent
    near = nearest_names(folder)
    hint = f" Did you mean {folder.parent / near[0]}?" if near else ""
    return f"There is no folder {folder}.{hint} Paths are relative to the campaign file"


def _some_names(folder: Path) -> str:
    names = sorted(entry.name for entry in folder.iterdir() if entry.is_file())
    if not names:
        return "no files"
    return f"{', '.join(names[:4])}{' …' if len(names) > 4 else ''}"


# ---------------------------------------------------------------- look-ups in the JSON schema


_UNITS = {
    "m": "metres",
    "mm": "millimetres",
    "km": "kilometres",
    "deg": "degrees",
    "rad": "radians",
    "mrad": "milliradians",
    "s": "seconds",
    "ms": "milliseconds",
    "min": "minutes",
    "mps": "m/s",
    "hz": "Hz",
    "rpm": "rpm",
    "degps": "degrees/s",
    "degpmin": "degrees/min",
    "nm": "nanometres",
    "px": "pixels",
}


_SCHEMA: Final = Schema(Campaign)
resolve: Final = _SCHEMA.resolve
node_at: Final = _SCHEMA.at
keys_at: Final = _SCHEMA.keys


def schema() -> Node:
    """JSON schema of the campaign file."""
    return _SCHEMA.whole


def all_paths(path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Every path of the schema: sections first, then what they hold."""
    for key in keys_at(path):
        yield (*path, key)
        yield from all_paths((*path, key))


def unit_at(path: tuple[Key, ...]) -> str:
    """Unit of a value from the ending of its key, ``""`` if it has none."""
    names = [key for key in path if isinstance(key, str)]
    if not names or "_" not in names[-1] or "_per_" in names[-1]:
        return ""
    return _UNITS.get(names[-1].rsplit("_", 1)[-1], "")


def limits_at(path: tuple[Key, ...]) -> tuple[float | None, float | None]:
    """Lowest and highest allowed number, whether or not they are included themselves."""
    node = node_at(path)
    low, high = node.get("minimum"), node.get("maximum")
    return (
        node.get("exclusiveMinimum") if low is None else low,
        node.get("exclusiveMaximum") if high is None else high,
    )


def describe_expected(path: tuple[Key, ...]) -> str:
    """What a value should be, in words: kind, limits, unit."""
    node = node_at(path)
    if "enum" in node or "const" in node:
        return "one of " + ", ".join(str(v) for v in node.get("enum", [node.get("const")]))
    kind = node.get("type", "")
    if kind in {"number", "integer"}:
        text = number_in_words(node)
        unit = unit_at(path)
        return f"{text} ({unit})" if unit else text
    if kind == "array":
        least, most = node.get("minItems", 0), node.get("maxItems")
        unit = unit_at(path)
        if most:
            range_ = f"{least} to {most}" if least else f"at most {most}"
            many = f"{most} numbers" if least == most else f"{range_} values"
            return f"a list of {many}" + (f" ({unit})" if unit else "")
        items = resolve(node.get("items", {}))
        if "enum" in items:
            return "a list of " + ", ".join(str(v) for v in items["enum"])
        return "a list"
    return {"boolean": "true or false", "string": "text", "object": "a section with keys"}.get(kind, "")


# ---------------------------------------------------------------- cures for values


_COMMA = re.compile(r"^\s*([-+]?\d+),(\d+)\s*$")
_WITH_UNIT = re.compile(r"^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-z°µ%/'\"]+)\s*$")
_LIKE_NUMBER = re.compile(r"^\s*[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?\s*$")


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
        if _LIKE_NUMBER.match(value):
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
        ("metres", "millimetres", 1000),
        ("metres", "centimetres", 100),
        ("seconds", "milliseconds", 1000),
    ):
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


# ---------------------------------------------------------------- what pydantic finds


_RANGE = {"greater_than", "greater_than_equal", "less_than", "less_than_equal", "finite_number"}
_NUMBER = {"float_type", "float_parsing", "int_type", "int_parsing", "int_from_float", "int_parsing_size"}
_SECTION = {"model_type", "model_attributes_type", "dict_type", "dataclass_type"}
_LIST = {"tuple_type", "list_type"}


def show(value: Any) -> str:
    """A value as it may stand in a message: short, text in quotes."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "a section" + (f" with {', '.join(map(str, list(value)[:4]))}" if value else "")
    if isinstance(value, list):
        text = f"[{', '.join(show(v) for v in value[:4])}{', …' if len(value) > 4 else ''}]"
        return text if len(text) <= 60 else f"a list of {len(value)}"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…'"


def mistake_of(error: ErrorDetails) -> Mistake:
    """One finding of pydantic as a mistake with its cure."""
    kind, value = error["type"], error["input"]
    path = known_path(tuple(error["loc"]))
    found, expected, cure = f"found {show(value)}", describe_expected(path), ""
    if kind == "extra_forbidden":
        path = tuple(error["loc"])
        found, expected, cure = (
            "unknown key",
            f"one of {', '.join(keys_at(path[:-1]))}",
            unknown_key_cure(path),
        )
    elif kind == "missing":
        return _missing(path, value)
    elif kind in _RANGE:
        if isinstance(value, int) and abs(value) > sys.float_info.max:
            cure = "Write fewer digits"
        elif isinstance(value, int | float):
            cure = range_cure(path, float(value))
    elif kind in _NUMBER:
        cure = "Write it without decimals" if kind == "int_from_float" or _is_float(value) else ""
        cure = cure or number_cure(path, value)
    elif kind in {"literal_error", "enum"}:
        near = nearest(str(show(value)).strip("'"), node_at(path).get("enum", []))
        cure = f"Did you mean {near}?" if near else "Choose one of these"
    elif kind.startswith("bool"):
        cure = "Write true or false without quotes"
    elif kind in _LIST:
        cure = f"Write a list: [{value}]" if isinstance(value, str) else "Write values in brackets, [a, b, c]"
    elif kind in {"too_short", "too_long"}:
        found, cure = f"found {_count(value)}: {show(value)}", _length_cure(path, kind)
    elif kind in _SECTION:
        found = "the section is empty" if value is None else found
        keys = ", ".join(keys_at(path)[:5])
        cure = f"Write keys below it, indented by two spaces ({keys} …), or remove the line"
    elif kind == "none_required":
        found = "a digital twin, but the laboratory that simulates it (package thalweg_lab) is not installed"
        expected = "logs of a survey, or epochs to compare"
        cure = "Install the wheel with the laboratory, or process this campaign in the repository"
    elif kind.startswith("string"):
        expected, cure = _text(path, kind, value, expected)
    else:
        # A rule of the section itself: its own words say what is wrong.
        found += f": {error['msg'].removeprefix('Value error, ').rstrip('.')}"
        expected = _lower(str(node_at(path).get("description", ""))) or expected
        cure = "Correct the value"
    if value == "CHANGE" and kind in _LIST | _NUMBER:
        found, cure = "not filled in yet", "Write the value in place of the word CHANGE"
    return Mistake(path=path, found=found, expected=expected, cure=cure)


def known_path(loc: tuple[Key, ...]) -> tuple[Key, ...]:
    """The path in the file: pydantic adds names of variants to it, which are no keys."""
    path: tuple[Key, ...] = ()
    for key in loc:
        if isinstance(key, int) or key in keys_at(path):
            path = (*path, key)
    return path


def _missing(path: tuple[Key, ...], value: Any) -> Mistake:
    if path and isinstance(path[-1], int):
        path = path[:-1]
        return Mistake(
            path=path,
            found=f"found {_count(value)}: {show(value)}",
            expected=describe_expected(path),
            cure=_length_cure(path, "too_short"),
        )
    node = node_at(path)
    examples = node.get("examples") or [None]
    example = f"{path[-1]}: {examples[0]}" if examples[0] is not None else f"{path[-1]}: …"
    if "properties" in node:
        example = f"{path[-1]}: {{{', '.join(f'{k}: …' for k in node['properties'])}}}"
    description = str(node.get("description", "")) or describe_expected(path)
    return Mistake(path=path, found="missing", expected=_lower(description), cure=f"Add the line `{example}`")


def _text(path: tuple[Key, ...], kind: str, value: Any, expected: str) -> tuple[str, str]:
    key = str(path[-1]) if path else ""
    if key == "crs" and isinstance(value, int):
        return "an EPSG code or a definition for PROJ", f"Write EPSG:{value}"
    if key == "id":
        slug = re.sub(r"[^a-z0-9_]+", "_", str(value).lower()).strip("_")
        slug = slug if slug[:1].isalpha() else f"c{slug}"
        return (
            "small letters, digits and underscores, beginning with a letter",
            f"Write for instance {slug[:60]}, and name the file {slug[:60]}.yaml",
        )
    if key == "depth_date":
        return "a date YYYY-MM-DD", "Write the UTC date like 2021-05-12"
    if kind == "string_too_short":
        return "text that is not empty", "Write a value after the colon"
    if value is None:
        return expected, "Write a value after the colon"
    if isinstance(value, list):
        return expected, "Write one value without brackets"
    if kind == "string_type" and not isinstance(value, dict):
        return expected, f'Put it in quotes: "{show(value)}"'
    pattern = node_at(path).get("pattern")
    return (f"text like {pattern}" if pattern else expected), "Correct the text"


def _length_cure(path: tuple[Key, ...], kind: str) -> str:
    node = node_at(path)
    least, most = node.get("minItems", 0), node.get("maxItems")
    if least == most == 3:
        return "Write all three components in brackets, [x, y, z], with decimal points"
    if least == most and most:
        return f"Write {most} values in brackets"
    if kind == "too_long":
        return f"Write at most {most} values in brackets"
    return (
        f"Write at least {least} values in brackets"
        if least > 1
        else ("Write at least one value, or remove the line")
    )


def _count(value: Any) -> str:
    n = len(value) if isinstance(value, list) else 0
    return "1 value" if n == 1 else f"{n} values"


def _is_float(value: Any) -> bool:
    return isinstance(value, float)


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:] if text[1:2].islower() or text[1:2] == " " else text
