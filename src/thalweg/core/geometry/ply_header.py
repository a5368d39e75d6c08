"""The header of a PLY file: format, elements with their properties, comments.

Format: G. Turk, "The PLY Polygon File Format" (1994).
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core.errors import InputError

ORDERS: Final = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
"""Formats, and the byte order of their numbers as numpy writes it."""

_TYPES: Final = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_HEAD_BYTES: Final = 1 << 20


@dataclass(slots=True)
class PlyElement:
    """An element; ``fields`` are names in small letters and types, of lists ``count type:item type``."""

    name: str
    count: int
    fields: list[tuple[str, str]]

    def dtype(self, order: str, corners: int = 0) -> np.dtype[Any]:
        """Type of a row whose lists all hold ``corners`` items."""
        parts: list[Any] = []
        for name, kind in self.fields:
            if ":" in kind:
                length, item = kind.split(":")
                parts += [(f"n of {name}", order + length), (name, order + item, (corners,))]
            else:
                parts.append((name, order + kind))
        return np.dtype(parts)

    @property
    def names(self) -> list[str]:
        """Names of all properties."""
        return [name for name, _ in self.fields]

    @property
    def lists(self) -> list[str]:
        """Names of the properties that are lists."""
        return [name for name, kind in self.fields if ":" in kind]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlyHeader:
    """``form`` is a key of `ORDERS`; ``end`` is the byte at which the data begin."""

    form: str
    elements: list[PlyElement]
    comments: list[str]
    end: int


def read_ply_header(path: Path, *, cure: str) -> PlyHeader:
    """The header of a file.

    Parameters
    ----------
    path : PLY.
    cure : what to do if it is damaged.

    Raises
    ------
    InputError : no header, one without an end, or a line that PLY 1.0 does not know.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
    end = re.search(rb"(?:^|[\r\n])end_header[ \t]*(\r\n|\n|\r)", head)
    if not head.startswith(b"ply") or end is None:
        raise InputError(
            "the header has no end" if head.startswith(b"ply") else "no PLY header",
            expected="'ply' first, and a line 'end_header'",
            where=path,
            cure=cure,
        )
    form, elements, comments = _parsed(head[: end.start()].decode("latin-1"), path, cure)
    return PlyHeader(form=form, elements=elements, comments=comments, end=end.end())


def _parsed(text: str, path: Path, cure: str) -> tuple[str, list[PlyElement], list[str]]:
    form, elements, comments = "", [], []  # type: str, list[PlyElement], list[str]
    for number, line in enumerate(re.split(r"\r\n|\n|\r", text), start=1):
        known = True
        try:
            match line.split():
                case ["ply"] | [] | ["obj_info", *_]:
                    pass
                case ["comment", *_]:
                    comments.append(line[8:])
                case ["format", kind, "1.0"] if kind in ORDERS:
                    form = kind
                case ["element", name, count]:
                    elements.append(PlyElement(name, int(count), []))
                case ["property", "list", length, item, name] if elements:
                    elements[-1].fields.append((name.lower(), f"{_TYPES[length]}:{_TYPES[item]}"))
                case ["property", kind, name] if elements:
                    elements[-1].fields.append((name.lower(), _TYPES[kind]))
                case _:
                    known = False
        except (ValueError, KeyError):
            known = False
        if not known:
            raise InputError(
                f"line {number} of the header is {line[:60]!r}",
                expected="format, element or property of PLY 1.0",
                where=path,
                cure=cure,
            )
    if not form or any(e.count < 0 for e in elements):
        raise InputError("the header states no format, or negative counts", expected="PLY 1.0", where=path)
    return form, elements, comments
