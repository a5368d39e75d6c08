"""Text with columns, of any form, read once for all callers: a `thalweg.ingest.Table` of a file.

========== ==================================================================================================
encoding   UTF-8 with or without mark, UTF-16 with mark, else Windows-1252 (noted)
separator  tab, semicolon, bar, comma, blanks: the first that cuts most lines into as many cells
decimals   points or commas, the whole file alike; digits in groups are put together
header     the last line without a number above the first line with one, also behind ``#``, ``%`` or ``//``
========== ==================================================================================================
"""

import contextlib
import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from pyproj import CRS
from pyproj.exceptions import CRSError

from thalweg.core import ArrayB, ArrayI, InputError, require_file
from thalweg.core.values import (
    WORDS,
    Unit,
    check_places,
    in_metres,
    is_vector_file,
    matters,
    read_vectors,
    unit_in_words,
    unit_of_word,
)
from thalweg.ingest.tables import (
    MOST_GARBLED,
    NAMES,
    NO_LENGTHS,
    NUMBER,
    Column,
    Places,
    Table,
    column_of,
    unit_in_brackets,
)

_HEADS: Final = ("#", "%", "//", "!")
"""How lines begin that are no rows."""
_SAMPLE: Final = 400
"""Lines by which the form of a table is told."""
_LARGE: Final = 2_000_000
"""Characters beyond which a table of plain numbers is read as such."""
_ALIKE: Final = 0.8
"""Share of the lines that a separator must cut into the same number of cells."""
_OF_TOTALS: Final = (
    "total sum summe mean average avg mittel mittelwert moyenne media promedio median min max minimum "
    "maximum std stdev count anzahl"
)
_TOTALS: Final = frozenset(_OF_TOTALS.split())
_OF_ROWS: Final = (
    "flag flags qc qf quality valid withheld rejected reject accepted class classification status deleted "
    "outlier outliers suspect bad excluded exclude edited use used fix"
)
_FLAGS: Final = frozenset(_OF_ROWS.split())
"""Names of columns that may say which rows count."""
_LAST_ROWS: Final = 10
"""Rows at the end of a table of which one may hold the mean or the sum of the others."""

_OTHERS: Final = (
    (
        re.compile(rb"(?i)\s*(?:ncols|dsaa|nrows)"),
        "a grid as text (Esri, Surfer)",
        "Convert it to GeoTIFF: gdal_translate FILE FILE.tif",
    ),
    (
        re.compile(rb"\s*\*?11[\d.]{4}[+-]\w{8}"),
        "a file of Leica GSI",
        "Export the points as CSV with names of columns",
    ),
    (
        re.compile(rb"(?i)\s*(?:<\?[^>]*>\s*)*<(?:!doctype html|html|table|workbook)\b"),
        "a page or a workbook in XML",
        "Save the sheet as CSV (UTF-8)",
    ),
    (
        re.compile(
            rb"\s*\d+\s*\n\s*\d+\s*\n(?:[ \t]*[-+.\deE]+){3}\s*\n(?:(?:[ \t]*[-+.\deE]+){3}\s*\n){3}[\s\d]"
        ),
        "a laser scan in PTX, whose first ten lines are its size and pose",
        "Export the scan as LAZ or E57, in the world's coordinates",
    ),
)
"""Texts of another form, by their beginning."""
_COMMA_NUMBER: Final = re.compile(r"[-+−]?\d+(?:,\d+)?")
_VALUE: Final = re.compile(
    r"[-+−]?(?:\d[\d.,'\u00a0\u202f ]*|\.\d+)(?:[eEdD][-+]?\d+)?(?: ?[a-zA-Z]{1,8})?"  # number, with its unit
    r"|\d{1,4}[-./]\d{1,2}[-./]\d{1,4}([T ,]+.*)?|\d{1,2}:\d{2}(:\d{2}.*)?"  # date, time of day
    r"|[NSEWnsew]?\s*[-+]?\d{1,3}[°:d ].*"  # angle
)
"""A cell that holds a value rather than a name."""
_FEW_SYSTEMS: Final = 3
"""A column of more names holds no coordinate systems."""
_OF_SYSTEMS: Final = ("epsg", "srid", "srs", "crs", "cs_name", "coordinate_system", "projection")
_OF_HEIGHTS: Final = re.compile(r"(?i)\b(?:depths?|heights?|elevations?|soundings?|z|tiefen?|höhen?)\b")
_OF_UNITS: Final = re.compile(
    r"(?:(?:depth|height|elevation|altitude|z|linear|length|vertical|tiefen?|höhen?|hoehen?)_?)?"
    r"(?:units?|uom|einheit)(?:_(?:depth|height|elevation|z))?"
)
"""Names of columns that hold the unit of others."""


def read_text(path: Path) -> tuple[str, list[str]]:
    """Text of a file and what had to be assumed about its encoding.

    Raises
    ------
    InputError : no such file, a folder or device, empty, a workbook, or no text.
    """
    require_file(path, "a table")
    data = path.read_bytes()
    if data.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        raise InputError(
            "a workbook or a zip archive",
            expected="a table as text",
            where=path,
            cure="Save the sheet as CSV (UTF-8)",
        )
    notes: list[str] = []
    for form, words, cure in _OTHERS:
        if form.match(data[:400]):
            raise InputError(words, expected="a table with a row for each point", where=path, cure=cure)
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = data.decode("utf-16", "replace")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("cp1252", "replace")
            notes.append("The text is no UTF-8 and is read as Windows-1252 (Latin-1).")
    if "\0" in text[:100_000]:
        raise InputError("zero bytes", expected="a table as text", where=path, cure="Save it as CSV (UTF-8)")
    if not text.strip():
        raise InputError("the file is empty", expected="a table", where=path, cure="Export it again")
    return text, notes


def read_text_table(path: Path, *, order: Sequence[str] | None = None, bare: Sequence[str] = ()) -> Table:
    """Read a table of any form.

    Parameters
    ----------
    path : the file.
    order : names of the columns as a user states them, ``-`` for one that is left out; a header of the file
        is then not used.
    bare : names of the columns of a file without header of just so many columns, such as x, y, z.

    Raises
    ------
    InputError : no table: see `read_text`; lines that no separator cuts alike; decimal commas in a table
        that commas separate; no names of columns where they are needed; a second header with other names.
    """
    text, notes = read_text(path)
    lines = re.split(r"\r\n|\r|\n", text[: 200 * _SAMPLE])[: -1 if len(text) > 200 * _SAMPLE else None]
    sample = [line for line in lines if line.strip() and not line.lstrip().startswith(_HEADS)][:_SAMPLE]
    if not sample:
        raise InputError("comments only", expected="rows of numbers", where=path, cure="Export it again")
    separator = _separator(sample)
    if separator == ",":
        _refuse_decimal_commas(sample, path)
    head, below, first = _header(_cells("\n".join(lines), separator, path), lines, separator)
    body = _numbers_alone(text, separator, first) if len(text) > _LARGE else None
    if body is None or (head and len(head) != body.shape[1]):
        body = _cells(text, separator, path).iloc[first:]
        filled = (body != "").any(axis=1).to_numpy()
        number = np.flatnonzero(filled) + first + 1
        body = body[filled].reset_index(drop=True)
        width = _usual_width(body) if head is None else max(len(head), _usual_width(body))
        if head is not None and width > len(head):
            head = _more_names(head, body, width, notes)
    else:
        number, width = np.arange(first + 1, first + 1 + len(body)), body.shape[1]
    table = Table(
        path=path,
        columns=_with_units(_columns(head, order, bare, width, path), below, path),
        named=head is not None or order is not None,
        cells=body,
        line=number.astype(np.int64),
        notes=notes,
    )
    if bare and not table.named and width == len(bare):
        notes.append(f"The file names no columns: taken as {', '.join(bare)}")
    if body[0].dtype.kind == "f":
        return _heed(_remarks(text, lines[:first], table), table)
    table = _whole_rows(table, head, width)
    table = _heed(_remarks(text, lines[:first], table), table)
    decimal, thousands = _marks(table, separator)
    return replace(table, decimal=decimal, thousands=thousands)


def read_places(
    path: Path, crs: CRS | None, *, order: Sequence[str] | None = None, any_system: bool = False
) -> tuple[Table, Places]:
    """A table of places: text with names of columns, x y z without, or points of a GIS.

    Of points of a GIS their coordinates are columns x, y, z, and what the layer holds beside are the others.

    Parameters
    ----------
    path, order : see `read_text_table`.
    crs, any_system : of the map, see `Table.places`.

    Raises
    ------
    InputError : no such file, no table, no coordinates.
    """
    if not is_vector_file(path):
        table = read_text_table(path, order=order, bare=("x", "y", "z"))
        return table, table.places(crs, any_system=any_system)
    drawn = read_vectors(path)
    on = crs or drawn.usual_map()
    states, drawn = drawn.crs, drawn if on is None else drawn.on_map(on)
    frame, at = drawn.points()
    if not len(at):
        raise InputError(
            "no points", where=path, expected="a layer of points", cure="Export them as points, not as lines"
        )
    placed = {word for quantity in ("east", "north", "lat", "lon") for word in NAMES[quantity].split()}
    frame = frame[[name for name in frame if column_of(str(name)).words not in placed]]
    if on is not None and states is not None and states.is_projected and not states.equals(on):
        check_places(
            at[:, :2],
            on,
            where=f"{path}, which states {states.name}",
            cure="campaign.crs: without it the file's own counts",
        )
    notes = list(drawn.notes)
    if on is not None and (metric := in_metres(on)).factors[0] != 1.0:
        notes.append(f"east and north taken in the unit of {on.name} ({metric.factors[0]:.10g} m)")
        at[:, :2] *= metric.factors[0]
        on = metric.crs
    frame = frame.assign(x=at[:, 0], y=at[:, 1])
    if "z" not in frame and at.shape[1] > 2:
        frame = frame.assign(z=at[:, 2])
    table = Table.of(frame, path)
    return _heed(_remarks("", (), table), table), Places(at[:, :2], on, notes)


def _remarks(text: str, above: Sequence[str], table: Table) -> list[tuple[int, str]]:
    """What a file says in words, with the lines: above its rows, behind marks of a comment, at its end."""
    found = dict(enumerate(above, 1))
    first, last = (
        text[: 200 * _SAMPLE].splitlines()[:_SAMPLE],
        text.rstrip()[-4000:].splitlines()[-_LAST_ROWS:],
    )
    found |= {n: line for n, line in enumerate(first, 1) if line.lstrip().startswith(_HEADS)}
    for n, line in enumerate(last, text.rstrip().count("\n") + 2 - len(last)):
        prose = re.match(r"\s*[^\W\d]", line) and not re.search(r"\d\.\d", line)
        if prose or line.lstrip().startswith(_HEADS):
            found.setdefault(n, line)
    names = "|".join(
        re.escape(n) for n in sorted((c.name for c in table.columns), key=len, reverse=True) if n
    )
    words = {n: re.sub(names, " ", line) if table.named else line for n, line in found.items()}
    said = {
        n: found[n].strip()
        for n in sorted(found)
        if re.search(r"[^\W\d_]{3}", words[n]) and not _are_units(re.split(r"[,;|\s]+", found[n]))
    }
    for k, column in enumerate(table.columns):
        if _OF_UNITS.fullmatch(column.words):
            what = "depth unit" if _OF_HEIGHTS.search(column.words.replace("_", " ")) else "unit"
            said |= {int(n): f"{what}: {cell}" for n, cell in zip(table.line, table.text(k), strict=True)}
    return list(said.items())


def _heed(remarks: Sequence[tuple[int, str]], table: Table) -> Table:
    """The table with what remarks say of it; units, and depths that are not named so, are refused.

    What may matter and is not read, such as a draught, a datum or a zone of time, is quoted.
    """
    named = [column for column in table.columns if column.unit is not None]
    upright = {*f"{NAMES['depth']} {NAMES['height']}".split()}
    bare = not any(column.words in upright for column in named)
    codes, ups = set[int](), set[Unit]()
    for number, line in remarks:
        # beside x_m, y_m a unit of depths is still missing
        if (not named or (bare and _OF_HEIGHTS.search(line))) and unit_in_words(line) is not None:
            raise InputError(
                f"'{line[:60]}' beside columns that name no unit: {table.listed()}",
                expected="a unit behind the name of each column that it is meant for, such as depth_ft",
                where=f"{table.path}:{number}",
                cure="Rename these columns, or state all with --columns",
            )
        if matters(line):
            table.notes.append(f"line {number} says '{line[:80]}'")
    for words in (*(line for _, line in remarks), *(column.name for column in table.columns)):
        codes |= {int(code) for code in re.findall(r"(?i)\bEPSG\W{0,2}(\d{4,5})\b", words)}
    for k, column in enumerate(table.columns):
        if _FLAGS & {*column.words.split("_")} and len({*table.text(k)}) > 1:
            table.notes.append(f"column {column.name} may mark rows that do not count: it is not read")
        cells = {*table.text(k)} if column.words in (*_OF_SYSTEMS, "datum") else set()
        if column.words in f"{NAMES['lat']} {NAMES['lon']}".split():  # Latitude (NAD27)
            cells = set(re.findall(r"[A-Z]{2,}[ _-]?\d{2,4}\b", column.name))
        if len(cells) <= _FEW_SYSTEMS:
            codes |= {code for cell in cells if (code := _code_of(cell)) is not None}
            ups |= {unit for c in cells if " + " in c and (unit := column_of(c).unit) is not None}
    maps, degrees = [], []
    for code in codes:
        with contextlib.suppress(CRSError):
            known = CRS.from_epsg(code)
            maps += [code] * known.is_projected
            degrees += [code] * (known.is_geographic and len(known.axis_info) == 2)
    lines = tuple(line for _, line in remarks)
    if len(ups) == 1:
        table = table.heights_in(ups.pop())
    return replace(
        table,
        code=maps[0] if len(maps) == 1 else None,
        degrees=degrees[0] if len(degrees) == 1 else None,
        remarks=lines,
    )


def _code_of(text: str) -> int | None:
    """EPSG code of a coordinate system by its number or its name, of one with heights that of the map."""
    number = re.fullmatch(r"(?:EPSG:)?(\d{4,5})", text)
    with contextlib.suppress(CRSError):
        found = CRS.from_epsg(int(number[1])) if number else CRS.from_user_input(text.partition(" + ")[0])
        return found.to_2d().to_epsg() if found.is_projected else found.to_epsg()
    return None


def _numbers_alone(text: str, separator: str, first: int) -> pd.DataFrame | None:
    """The rows of a large file of plain numbers, which are read ten times as fast; None for any other."""
    try:
        frame = pd.read_csv(
            StringIO(text),
            sep=separator,
            header=None,
            skiprows=first,
            skipinitialspace=True,
            skip_blank_lines=False,
            dtype=np.float64,
            engine="c",
        )
    except (ValueError, pd.errors.ParserError):
        return None
    return None if frame.isna().to_numpy().any() else frame


def _split(line: str, separator: str) -> list[str]:
    if separator == r"\s+":
        return line.split()
    if len(separator) > 1:
        return re.split(separator, line)
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        return line.split(separator)


def _separator(sample: Sequence[str]) -> str:
    """What stands between the cells; a table of one column counts as separated by commas."""
    tail = sample[len(sample) // 3 :] if len(sample) > 2 else sample

    def cuts(separator: str) -> bool:
        """Whether most lines have the same number of cells, two or more."""
        counts = np.bincount([len(_split(line, separator)) for line in tail])
        return bool(counts[2:].max(initial=0) >= _ALIKE * len(tail))

    for mark in "\t;|":
        if cuts(mark):
            return mark

    def commas_inside(separator: str) -> bool:
        """Whether all cells are numbers, and some have a comma."""
        cells = [cell for line in tail for cell in _split(line.strip(), separator) if cell]
        return any("," in c for c in cells) and all(_COMMA_NUMBER.fullmatch(c) for c in cells)

    for blank in (r"\s+", r",\s+"):
        if cuts(blank) and commas_inside(blank):
            return blank
    if cuts(","):
        return ","
    return r"\s+" if cuts(r"\s+") else ","


def _refuse_decimal_commas(sample: Sequence[str], path: Path) -> None:
    """Whole numbers only, and each second one with the same digits or a zero in front: x,xx,y,yy."""
    rows = [[cell.strip() for cell in line.split(",")] for line in sample]
    body = [row for row in rows if all(re.fullmatch(r"[-+]?\d+", cell) for cell in row)]
    names = [row for row in rows if not any(re.fullmatch(r"[-+]?[\d.]+", cell) for cell in row)]
    ragged = len({len(row) for row in body}) > 1
    more = bool(names) and sum(len(row) > len(names[0]) for row in body) > 0.5 * (len(rows) - len(names))
    pairs = False
    if body and not ragged and len(body[0]) % 2 == 0 and len(body) >= _ALIKE * len(rows):
        after = [row[1::2] for row in body]
        pairs = len(body[0]) >= 4 and any(c.startswith("0") and len(c) > 1 for row in after for c in row)
    if pairs or (body and more):
        raise InputError(
            f"numbers with decimal commas in a table that commas separate, such as {','.join(body[0])[:60]}",
            expected="decimal points, or another separator",
            where=path,
            cure="Save it with semicolons between the columns, or with decimal points",
        )


def _cells(text: str, separator: str, path: Path) -> pd.DataFrame:
    """All lines of a file as texts, a row for each line, so that rows keep their line numbers."""
    if any(mark in text for mark in _HEADS):
        text = re.sub(r"(?m)^[ \t]*(?:#|%|//|!).*$", "", text)
    text = re.sub(r"\r\n|\r", "\n", text)
    if separator == r",\s+":
        text, separator = re.sub(r",[ \t]+", ";", text), ";"
    sample = text[: 200 * _SAMPLE].split("\n")
    width = max(len(_split(line, separator)) for line in sample) + 1
    try:
        frame = pd.read_csv(
            StringIO(text),
            sep=separator,
            header=None,
            names=range(width),
            skipinitialspace=True,
            dtype=str,
            keep_default_na=False,
            na_filter=False,
            skip_blank_lines=False,
            engine="c",
        )
    except (pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise InputError(
            f"no table ({str(error).splitlines()[0].strip()})",
            expected="lines with the same number of cells",
            where=path,
            cure="Look at that line: a quotation mark or a separator too many",
        ) from error
    if not text.rstrip("\n").count("\n") + 1 <= len(frame) <= text.count("\n") + 1:
        raise InputError(
            f"{text.count(chr(10)) + 1:,} lines, of which quotation marks make {len(frame):,} rows",
            expected="a row in each line",
            where=path,
            cure="Look for a quotation mark without its partner",
        )
    frame = frame.fillna("").astype(str)
    return frame.apply(lambda column: column.str.strip())


def _header(
    cells: pd.DataFrame, lines: Sequence[str], separator: str
) -> tuple[list[str] | None, list[str], int]:
    """Names of the columns, units in a line of their own, and how many lines stand above the first row."""
    few = cells.iloc[: len(lines)].to_numpy()
    values = [[bool(c) and _VALUE.fullmatch(c) is not None for c in row] for row in few]
    counts = [len([c for c in row if c]) for row in few]
    usual = (
        int(np.bincount(np.array(counts[len(counts) // 3 :] or counts)[-_SAMPLE:]).argmax()) if counts else 0
    )
    first = next(
        (k for k, row in enumerate(values) if any(row) and counts[k] >= max(1, usual // 2)), len(values)
    )
    if first == len(values):  # names alone, or a table of texts
        first = next((k for k, n in enumerate(counts) if n), -1) + 1
    named = next(
        (k for k, row in enumerate(few) if not any(values[k]) and counts[k] >= usual - 1 and _known(row) > 1),
        -1,
    )
    # a line above the names may hold a value, such as a date, but is no row
    if named >= first and not any(counts[k] == usual and all(values[k][:usual]) for k in range(first, named)):
        first = next((k for k in range(named + 1, len(values)) if any(values[k])), named + 1)
    units: list[str] = []
    for k in range(min(first, len(values)) - 1, -1, -1):
        row = list(few[k])
        while row and not row[-1]:
            row.pop()
        if row and not units and _are_units(row):
            units = row
        elif row and len(row) >= max(1, usual - 1) and not any(values[k]):
            if separator == r"\s+" and len(row) > usual:  # a unit in brackets belongs to the name before it
                row = re.split(r"\s+(?![(\[])(?![^(\[]*[)\]])", " ".join(row))
            above = [c for c in few[k - 1] if c] if k else []
            return row, above if not units and len(above) == len(row) and _are_units(above) else units, first
        elif row and not 0 <= named < k:  # a remark between the names and the numbers
            break
    comments = [x.lstrip() for x in lines[:first] if x.lstrip().startswith(_HEADS)]
    for line in reversed(comments):
        line = re.sub(r"(?i)^[#%/!\s]+(?:(?:columns?|fields?|format|header|order)\s*[:=])?\s*", "", line)
        names = [c.strip() for c in _split(line, separator)]
        if len(names) < 2 or len(names) != usual:
            names = line.replace(",", " ").split()
        if len(names) == usual and _known(names) >= 2:
            return names, units, first
    return None, units, first


def _known(row: Iterable[str]) -> int:
    """How many cells are names of quantities."""
    return sum(any(column_of(c).words in words.split() for words in NAMES.values()) for c in row if c)


def _are_units(row: Sequence[str]) -> bool:
    """Whether a line below the names holds units."""
    words = [c.strip("()[]{}").lower() for c in row if c]
    known = [
        unit_of_word(re.split(r"[\s,]", w)[0]) is not None  # ft MLLW
        or unit_of_word(w) is not None
        or not w.strip("-=_")
        or w in NO_LENGTHS
        or re.fullmatch(
            r"°|-|1|utc|(?:decimal )?deg(?:rees?)?(?:[_ ](?:north|east))?|[ymdhs]+([-/:.][ymdhs]+)+", w
        )
        for w in words
    ]
    return bool(words) and all(known)


def _usual_width(body: pd.DataFrame) -> int:
    filled = (body.iloc[:_SAMPLE] != "").to_numpy()
    last = filled.shape[1] - np.argmax(filled[:, ::-1], axis=1)
    return int(np.bincount(last).argmax()) if len(last) else 0


def _more_names(head: list[str], body: pd.DataFrame, width: int, notes: list[str]) -> list[str]:
    """Names of all columns where rows have more cells than the header: R leaves out the rows' own names."""
    more = [f"column {k}" for k in range(len(head) + 1, width + 1)]
    counted = body[0].tolist() == [str(k) for k in range(1, len(body) + 1)]
    if len(more) == 1 and (counted or not body[0].str.fullmatch(NUMBER).any()):
        notes.append("The first column has no name in the header: the others are named from the second on.")
        return ["row", *head]
    notes.append(f"{len(more)} columns behind {head[-1]} have no name.")
    return [*head, *more]


def _columns(
    head: list[str] | None, order: Sequence[str] | None, bare: Sequence[str], width: int, path: Path
) -> tuple[Column, ...]:
    if order is not None:
        if len(order) > width:
            raise InputError(
                f"{width} columns",
                where=path,
                expected=f"{len(order)} as stated: {', '.join(order)}",
                cure="State as many names as the table has columns, - for one that is not used",
            )
        names = [*order, *(f"column {k}" for k in range(len(order) + 1, width + 1))]
        return tuple(
            column_of(name) if name != "-" else Column(f"column {k}", "") for k, name in enumerate(names, 1)
        )
    if head is not None:
        return tuple(column_of(name) for name in head)
    if bare and width == len(bare):
        return tuple(column_of(name) for name in bare)
    return tuple(Column(f"column {k}", "") for k in range(1, width + 1))


def _whole_rows(table: Table, head: list[str] | None, width: int) -> Table:
    """The table without repeated headers and without rows of more cells than there are columns."""
    cells = table.cells
    keep = np.ones(len(cells), dtype=np.bool_)
    named = "|".join(re.escape(c.name.lower()) for c in table.columns if c.name)
    label = rf"(?:{'|'.join(_TOTALS)})(?: (?:of )?(?:{named}))?:?"
    total = cells[0].str.lower().str.fullmatch(label).to_numpy(np.bool_).copy()
    total[:-_LAST_ROWS] = False
    if total.any() and not total.all():
        table.losses["of a total or a mean"] = _count(total, table.line)
        keep &= ~total
    if head is not None and len(cells):
        again = (cells.iloc[:, : len(head)] == head).all(axis=1).to_numpy()
        if again.any():
            table.losses["with the names of the columns again"] = _count(again, table.line)
            keep &= ~again
        names = cells[0].str.lower().isin([head[0].lower(), *(w for x in NAMES.values() for w in x.split())])
        of_numbers = {w for q in ("east", "north", "lat", "lon", "height", "depth") for w in NAMES[q].split()}
        k = next((k for k, c in enumerate(table.columns) if c.words in of_numbers), 0)
        names |= cells[k].str.fullmatch(r"[^\W\d_]\D*") & ~cells[k].str.lower().isin(WORDS)
        for row in np.flatnonzero(names.to_numpy() & keep).tolist():
            others = [column_of(c) for c in cells.iloc[row] if c]
            other = [c.words for c in others]
            known = [w for w in other if any(w in x.split() for x in NAMES.values())]
            of_unit = [
                a.name
                for a, b in zip(others, table.columns, strict=False)
                if a.unit is not None and b.unit is not None and a.unit != b.unit
            ]
            if len(known) >= 2 and (of_unit or other != [c.words for c in table.columns][: len(other)]):
                raise InputError(
                    f"a second header with other columns: {', '.join(c for c in cells.iloc[row] if c)}",
                    where=f"{table.path}:{table.line[row]}",
                    expected=table.listed(),
                    cure="Split the file there",
                )
    long = (cells.iloc[:, width:] != "").any(axis=1).to_numpy()
    if long.any():
        if long.mean() > MOST_GARBLED:
            raise InputError(
                f"{int(long.sum()):,} of {len(long):,} rows have more than {width} cells",
                where=f"{table.path}:{table.line[np.argmax(long)]}",
                expected=f"{width} as most rows have: {table.listed()}",
                cure="Decimal commas between commas do this: save it with semicolons, or decimal points",
            )
        table.losses[f"of more than {width} cells"] = _count(long, table.line)
        keep &= ~long
    return replace(table, cells=cells[keep].iloc[:, :width].reset_index(drop=True), line=table.line[keep])


def _count(mark: ArrayB, line: ArrayI) -> tuple[int, int]:
    return int(mark.sum()), int(line[np.argmax(mark)])


def _with_units(columns: tuple[Column, ...], below: Sequence[str], path: Path) -> tuple[Column, ...]:
    """The columns with the units of a line below their names.

    Raises
    ------
    InputError : a name states another unit.
    """
    out = list(columns)
    for k, word in enumerate(below[: len(out)]):
        unit, foreign = unit_in_brackets(word.strip("()[]{}"))
        if unit is None and not foreign:
            continue
        if (out[k].unit, out[k].foreign) not in ((None, ""), (unit, foreign)):
            raise InputError(
                f"column {out[k].name}, and '{word}' as its unit in the line below",
                where=path,
                expected="one unit",
                cure="Correct one of them",
            )
        out[k] = replace(out[k], unit=unit, foreign=foreign)
    return tuple(out)


def _marks(table: Table, separator: str) -> tuple[str, str]:
    """Decimal mark and mark between groups of digits; the whole file decides.

    Raises
    ------
    InputError : some numbers have decimal points and others decimal commas.
    """
    point = comma = ""
    groups: dict[str, bool] = {",": False, ".": False}
    plain: dict[str, bool] = {",": True, ".": True}
    for k, column in enumerate(table.columns):
        cells = table.cells[k]
        for mark, other in ((",", "."), (".", ",")):
            if separator == "," and mark == "," and not cells.str.contains(",", regex=False).any():
                continue
            m, o = re.escape(mark), re.escape(other)
            hits = cells[cells.str.fullmatch(rf"[-+−]?\d+{m}\d+(?:[eE][-+]?\d+)?").fillna(False).astype(bool)]
            if len(hits):
                comma, point = (column.name, point) if mark == "," else (comma, column.name)
                plain[mark] &= bool(hits.str.fullmatch(rf"[-+−]?[1-9]\d{{0,2}}{m}\d{{3}}").all())
            many = cells.str.fullmatch(
                rf"[-+−]?\d{{1,3}}(?:{m}\d{{3}})+{o}\d+|[-+−]?\d{{1,3}}(?:{m}\d{{3}}){{2,}}"
            )
            groups[mark] |= bool(many.any())
    if groups[","] and plain[","] and not groups["."]:
        return ".", ","
    if groups["."] and plain["."] and not groups[","]:
        return ",", "."
    if comma and point:
        raise InputError(
            f"decimal commas in column {comma} and decimal points in column {point}",
            where=table.path,
            expected="one decimal mark in the whole file",
            cure="Save the table again with decimal points",
        )
    return (",", "") if comma else (".", "")
