"""Tables with named columns as people and other programs write them: text to rows by our own names."""

import csv
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from thalweg.core.errors import InputError

_NAMED: Final = 5
"""Names that a message lists."""

NAMES: Final[Mapping[str, tuple[str, ...]]] = {
    "id": ("id", "label", "name", "point", "gcp", "marker", "gcp_name"),
    "image": ("image", "photo", "camera", "image_name", "file", "filename", "camera_label"),
    "point": ("point", "gcp", "marker", "label", "id", "gcp_name", "marker_label"),
    "x_px": ("x_px", "u", "u_px", "im_x", "image_u", "x"),
    "y_px": ("y_px", "v", "v_px", "im_y", "image_v", "y"),
    "sigma_px": ("sigma_px", "accuracy_px"),
    "east_m": ("east_m",),
    "north_m": ("north_m",),
    "up_m": ("up_m",),
    "lat_deg": ("lat_deg", "latitude", "y/latitude"),
    "lon_deg": ("lon_deg", "longitude", "x/longitude"),
    "h_ell_m": ("h_ell_m", "h_m", "altitude", "z/altitude"),
    "x": ("x", "x/east", "x/easting", "easting", "east"),
    "y": ("y", "y/north", "y/northing", "northing", "north"),
    "z": ("z", "z/altitude", "altitude", "height"),
    "sigma_east_m": ("sigma_east_m", "sigma_x_m", "x/east accuracy", "x accuracy", "sx"),
    "sigma_north_m": ("sigma_north_m", "sigma_y_m", "y/north accuracy", "y accuracy", "sy"),
    "sigma_up_m": ("sigma_up_m", "sigma_z_m", "z/altitude accuracy", "z accuracy", "sz"),
    "accuracy": ("accuracy", "accuracy (m)"),
    "role": ("role", "type"),
    "used": ("used",),
}
"""Headings, in small letters, by which a column is known."""

LINE: Final = "line"
"""Key of a row under which the number of its line stands."""


def read_text(path: Path) -> str:
    """Text of a table.

    Raises
    ------
    InputError : no such file, or no text in UTF-8.
    """
    if not path.is_file():
        raise InputError("file not found", expected="a table", where=path)
    data = path.read_bytes()
    if data.startswith(b"PK\x03\x04"):
        raise InputError(
            "a workbook or a zip archive", expected="a table as text", where=path,
            cure="Save the sheet as CSV (UTF-8)",
        )  # fmt: skip
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError("no UTF-8 text", expected="a table", where=path, cure="Save it as UTF-8") from error
    if "\0" in text:
        raise InputError("zero bytes", expected="a table as text", where=path, cure="Save it as CSV (UTF-8)")
    return text


def table_rows(path: Path, text: str, needed: Sequence[str] = ()) -> list[dict[str, str]]:
    """Rows of a table with named columns, by our names of these.

    Decimal commas are read where columns are apart by semicolons or tabs.

    Parameters
    ----------
    needed : our names of columns without which the table is of no use, for the message.

    Raises
    ------
    InputError : an empty table, no headings, or a row that is too short.
    """
    numbered = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    while (
        numbered
        and numbered[0][1].startswith("#")
        and not re.match(r"#\s*label", numbered[0][1], re.IGNORECASE)
    ):
        numbered = numbered[1:]
    if not numbered:
        raise InputError("an empty table", expected="a first line with the names of the columns", where=path)
    first = numbered[0][1].lstrip("#").lstrip()
    numbered = [item for item in numbered[1:] if not item[1].startswith("#")]
    separator = max(",;\t", key=first.count)
    head = [re.sub(r"[_ ]\((m|px|deg|°)\)$", "", name.strip().lower()) for name in _cells(first, separator)]
    ours = {
        name: head.index(found)
        for name, known in NAMES.items()
        if (found := next((k for k in known if k in head), None)) is not None
    }
    lacking = [name for name in needed if name not in ours]
    if lacking and sum(_is_number(cell) for cell in head) >= 2:
        raise InputError(
            f"no names of columns: the first line is '{first[:60]}'",
            expected=f"a first line such as {','.join(needed)}", where=path,
            cure="Write the names of the columns above the numbers",
        )  # fmt: skip
    rows = []
    for number, line in numbered:
        cells = _cells(line, separator)
        if len(cells) < len(head):
            raise InputError(
                f"{len(cells)} columns",
                expected=f"{len(head)} as in the first line",
                where=f"{path}:{number}",
            )
        if separator != ",":
            cells = [re.sub(r"^\s*([-+]?\d+),(\d+)\s*$", r"\1.\2", cell) for cell in cells]
        rows.append({name: cells[at].strip() for name, at in ours.items()} | {LINE: str(number)})
    return rows


def required(row: Mapping[str, str], name: str, path: Path) -> str:
    """A value that must be there.

    Raises
    ------
    InputError : no such column, or no value in this row.
    """
    value = row.get(name, "")
    if not value:
        known = " or ".join(NAMES.get(name, (name,))[:3])
        raise InputError(
            f"no {name}", expected=f"a column {known} with a value in each row", where=place_of(row, path)
        )
    return value


def number(row: Mapping[str, str], name: str, path: Path, default: float | None = None) -> float:
    """A finite number, or the default where the row has none.

    Raises
    ------
    InputError : no number, and no default.
    """
    text = row.get(name, "").strip()
    if not text or (default is not None and text.casefold() in ("nan", "none", "-")):
        if default is None:
            required(row, name, path)
        return float(default if default is not None else math.nan)
    if not _is_number(text):
        comma = "" if "," not in text else "Write decimals with a point"
        raise InputError(f"{name} '{text}'", expected="a number", where=place_of(row, path), cure=comma)
    return float(text)


def place_of(row: Mapping[str, str], path: Path) -> str:
    """File and line of a row."""
    return f"{path}:{row[LINE]}" if LINE in row else str(path)


def listed(names: Sequence[str]) -> str:
    """The first names, and how many more."""
    return ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")


def _cells(line: str, separator: str) -> list[str]:
    return next(csv.reader([line], delimiter=separator))


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
