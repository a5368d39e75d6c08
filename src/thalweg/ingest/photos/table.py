"""Times of photographs from a table that a person or another program wrote."""

import csv
import datetime as dt
import math
import re
from pathlib import Path
from typing import Final

from thalweg.core.errors import InputError
from thalweg.core.timescales import unix_from_gps
from thalweg.ingest.photos.exif import CivilStamp
from thalweg.ingest.stamps import possible_unix

TIME_COLUMNS: Final = ("time_utc", "unix_s", "t_gps_s")
"""ISO 8601 text (UTC, or with its own offset), Unix time, or adjusted GPS time."""


def read_time_table(path: Path) -> dict[str, CivilStamp]:
    """Stamps by file name, from a CSV table with the columns ``file`` and one of `TIME_COLUMNS`.

    An empty cell is an image without time. The unit of a stamp is that of its last digit.

    Raises
    ------
    InputError : the table is missing, lacks a column, or holds a time that is none, or a file twice.
    """
    if not path.is_file():
        raise InputError("file not found", where=path, expected="a CSV table of times")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError("the table is no UTF-8 text", where=path, cure="Save it as CSV in UTF-8") from error
    separator = ";" if text.split("\n", 1)[0].count(";") else ","
    rows = csv.DictReader(text.splitlines(), delimiter=separator)
    names = [name.strip() for name in rows.fieldnames or []]
    rows.fieldnames = names
    known = [name for name in TIME_COLUMNS if name in names]
    if "file" not in names or len(known) != 1:
        raise InputError(
            f"columns {names}",
            where=path,
            expected=f"the columns file and one of {', '.join(TIME_COLUMNS)}",
        )
    out: dict[str, CivilStamp] = {}
    for row in rows:
        where = f"{path}:{rows.line_num}"
        file, value = (row["file"] or "").strip(), (row[known[0]] or "").strip()
        if not file:
            raise InputError("a row without file name", where=where, expected="the name of an image")
        if file in out:
            raise InputError(f"'{file}' stands there twice", where=where, expected="each image once")
        if value:
            out[file] = _stamp(value, known[0], where)
    return out


def _stamp(text: str, form: str, where: str) -> CivilStamp:
    digits = len(found.group(1)) if (found := re.search(r"[.,](\d+)", text)) else 0
    fraction = int(found.group(1)) / 10**digits if found else 0.0
    whole = re.sub(r"[.,]\d+", "", text)
    try:
        if form == "time_utc":
            moment = dt.datetime.fromisoformat(whole.replace("Z", "+00:00"))
            own = moment.utcoffset()
            offset_s = 0.0 if own is None else own.total_seconds()
            second = int(moment.replace(tzinfo=dt.UTC).timestamp())
        else:
            value = float(text.replace(",", "."))
            if not math.isfinite(value):
                raise ValueError(text)  # noqa: TRY301
            offset_s = 0.0
            if form == "t_gps_s":
                value = float(unix_from_gps(value))
            second = math.floor(value)
            fraction = fraction if form == "unix_s" else value - second
    except (ValueError, OverflowError) as error:
        raise InputError(
            f"'{text}' is no time",
            where=where,
            expected="ISO 8601, such as 2021-05-12T08:31:07.123Z" if form == "time_utc" else "a number",
        ) from error
    if not possible_unix(second):
        raise InputError(f"'{text}' is no date of a survey", where=where, expected="a time after 1980")
    return CivilStamp(second_s=second, fraction_s=fraction, resolution_s=10.0**-digits, utc_offset_s=offset_s)
