"""Look-ups in the JSON schema of a campaign: allowed keys, limits, units."""

import re
from collections.abc import Iterator
from functools import cache
from typing import Any

from thalweg.core.mistakes import Key
from thalweg.settings.campaign import Campaign

Node = dict[str, Any]

_UNITS = {
    "m": "metres", "mm": "millimetres", "km": "kilometres", "deg": "degrees", "rad": "radians",
    "mrad": "milliradians", "s": "seconds", "ms": "milliseconds", "min": "minutes", "mps": "m/s",
    "hz": "Hz", "rpm": "rpm", "degps": "degrees/s", "degpmin": "degrees/min", "nm": "nanometres",
    "px": "pixels",
}  # fmt: skip


@cache
def schema() -> Node:
    """JSON schema of the campaign file."""
    return Campaign.model_json_schema()


def resolve(node: Node) -> Node:
    """A schema node with its reference followed, and the non-null part of an optional value."""
    for _ in range(8):
        if "$ref" in node:
            rest = {k: v for k, v in node.items() if k != "$ref"}
            node = {**schema()["$defs"][node["$ref"].rsplit("/", 1)[1]], **rest}
            continue
        options = node.get("anyOf") or node.get("allOf") or []
        real = [o for o in options if o.get("type") != "null" and "required" not in o]
        if "properties" in node or not real:
            return node
        node = {**{k: v for k, v in node.items() if k not in {"anyOf", "allOf"}}, **real[0]}
    return node


def node_at(path: tuple[Key, ...]) -> Node:
    """Schema of a path; empty if the path is not part of it."""
    node = resolve(schema())
    for key in path:
        if isinstance(key, int):
            items = node.get("prefixItems", [])
            child = items[key] if key < len(items) else node.get("items", {})
        else:
            child = node.get("properties", {}).get(key) or _of_any_name(node, key)
        node = resolve(child) if isinstance(child, dict) else {}
    return node


def _of_any_name(node: Node, key: str) -> Any:
    """Schema of what stands below a name that the user chooses, such as that of a scan; empty if none may."""
    for pattern, child in node.get("patternProperties", {}).items():
        if re.search(pattern, key):
            return child
    return node.get("additionalProperties") or {}


def keys_at(path: tuple[Key, ...]) -> list[str]:
    """Keys that are allowed below a path."""
    return list(node_at(path).get("properties", {}))


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
        text = "a whole number" if kind == "integer" else "a number"
        low, high = node.get("minimum"), node.get("maximum")
        above, below = node.get("exclusiveMinimum"), node.get("exclusiveMaximum")
        if low is not None and high is not None:
            text += f" from {_number(low)} to {_number(high)}"
        else:
            text += f" of at least {_number(low)}" if low is not None else ""
            text += f" above {_number(above)}" if above is not None else ""
            text += f" up to {_number(high)}" if high is not None else ""
            text += f" below {_number(below)}" if below is not None else ""
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


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) or not float(value).is_integer() else str(int(value))
