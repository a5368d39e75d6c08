"""What pydantic finds wrong, told to the people who wrote the file."""

import re
from typing import Any

from pydantic_core import ErrorDetails

from thalweg.core.mistakes import Key, Mistake
from thalweg.settings.messages.hints import nearest, number_cure, range_cure, unknown_key_cure
from thalweg.settings.messages.shape import describe_expected, keys_at, node_at

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
        cure = range_cure(path, float(value)) if isinstance(value, int | float) else ""
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
    elif kind.startswith("string"):
        expected, cure = _text(path, kind, value, expected)
    else:
        # A rule of the section itself: its own words say what is wrong.
        found += f": {error['msg'].removeprefix('Value error, ').rstrip('.')}"
        expected = _lower(str(node_at(path).get("description", ""))) or expected
        cure = "Correct the value"
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
    return f"Write at least {least} values in brackets" if least > 1 else (
        "Write at least one value, or remove the line"
    )  # fmt: skip


def _count(value: Any) -> str:
    n = len(value) if isinstance(value, list) else 0
    return "1 value" if n == 1 else f"{n} values"


def _is_float(value: Any) -> bool:
    return isinstance(value, float)


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:] if text[1:2].islower() or text[1:2] == " " else text
