"""Clouds in the ASCII form of the Point Cloud Library's PCD files, version 0.7, as single scans often come.

Binary forms are told from it and refused by name: `pcl_convert_pcd_ascii_binary` turns them into ASCII.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from thalweg.core.errors import InputError, UnsupportedError
from thalweg.core.types import ArrayF

_KEYS: Final = ("FIELDS", "POINTS", "DATA")
_HEAD_LINES: Final = 30


@dataclass(frozen=True, slots=True, kw_only=True)
class PcdCloud:
    """Points of a file: ``xyz_m`` (n, 3), all ``fields`` (n,) by name, number of points left out."""

    xyz_m: ArrayF
    fields: dict[str, ArrayF]
    n_left_out: int


def read_pcd(path: Path) -> PcdCloud:
    """Read an ASCII PCD file.

    Points with coordinates that are not finite (PCL writes ``nan`` for missing returns) are left out and
    counted.

    Raises
    ------
    InputError : the file is missing, is none, or holds other than the stated number of points and fields.
    UnsupportedError : the data are binary.
    """
    if not path.is_file():
        raise InputError("file not found", expected="a PCD cloud", where=path)
    raw = path.read_bytes()
    head, body = _head(raw, path)
    names = head["FIELDS"].split()
    if head["DATA"] != "ascii":
        raise UnsupportedError(
            f"data in the form {head['DATA']!r}",
            expected="ascii",
            where=path,
            cure="Convert it with pcl_convert_pcd_ascii_binary <in> <out> 0",
        )
    if any(count != "1" for count in head.get("COUNT", "").split()):
        raise UnsupportedError(
            f"fields with several values each (COUNT {head['COUNT']})", expected="COUNT 1", where=path
        )
    missing = [name for name in "xyz" if name not in names]
    if missing:
        raise InputError(f"no fields {', '.join(missing)}", expected="x, y and z", where=path)
    table = _numbers(raw[body:], len(names), path)
    if not head["POINTS"].isdigit() or len(table) != int(head["POINTS"]):
        raise InputError(
            f"{len(table)} points where the head says {head['POINTS']}",
            expected="a whole file",
            where=path,
            cure="Copy the file again: it is cut off or was joined with another one",
        )
    good = np.isfinite(table[:, [names.index(a) for a in "xyz"]]).all(axis=1)
    fields = {name: table[good, i] for i, name in enumerate(names)}
    xyz = np.stack([fields[a] for a in "xyz"], axis=1)
    return PcdCloud(xyz_m=xyz, fields=fields, n_left_out=int(np.count_nonzero(~good)))


def _head(raw: bytes, path: Path) -> tuple[dict[str, str], int]:
    """Entries of the head, and where the data begin."""
    head: dict[str, str] = {}
    start = 0
    for _ in range(_HEAD_LINES):
        end = raw.find(b"\n", start)
        line = raw[start : end if end >= 0 else len(raw)].decode("ascii", errors="replace").strip()
        if line and not line.startswith("#"):
            key, _, value = line.partition(" ")
            head[key] = value.strip()
        if end < 0 or "DATA" in head:
            break
        start = end + 1
    missing = [key for key in _KEYS if key not in head]
    if missing:
        raise InputError(
            f"no PCD head (without {', '.join(missing)})", expected="FIELDS, POINTS and DATA", where=path
        )
    return head, end + 1 if end >= 0 else len(raw)


def _numbers(text: bytes, columns: int, path: Path) -> ArrayF:
    lines = [line for line in text.split(b"\n") if line.strip()]
    table = np.empty((len(lines), columns))
    for i, line in enumerate(lines):
        words = line.split()
        try:
            table[i] = [float(word) for word in words]
        except ValueError as error:
            raise InputError(
                f"point {i + 1} is {line[:60].decode('ascii', errors='replace')!r}",
                expected=f"{columns} numbers",
                where=path,
            ) from error
    return table
