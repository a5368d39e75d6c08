"""Values of a table of other people: columns by their names, units, signs, places and times.

What the file states decides. What it does not state is refused where it cannot be told, and noted where one
answer is usual. A row that is not taken is counted with its reason and the line at which that happened first.
How a text becomes such a table: `thalweg.ingest.text_tables`.

======= ======================================================================================================
units   in the name (``depth_ft``, ``WaterDepthFt``, ``Depth (m)``), in a line below it, or in cells
nothing words and numbers of `thalweg.core.values.NOTHING`
======= ======================================================================================================
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from pyproj import CRS, Transformer

from thalweg.core import (
    WEEK_S,
    ArrayB,
    ArrayF,
    ArrayI,
    InputError,
    gps_from_unix,
    gps_from_week,
    unix_from_gps,
)
from thalweg.core.values import (
    METRE,
    NOTHING,
    SPOKEN,
    WORDS,
    Unit,
    accuracy_in_words,
    check_places,
    far_repeated,
    in_metres,
    in_words,
    is_nothing,
    says_downwards,
    unit_of_word,
    utm_of,
    way_between,
)
from thalweg.ingest.moments import CLOCK, past_midnight, unix_of_texts
from thalweg.ingest.stamps import doubtful_date, possible_unix

# ---------------------------------------------------------------- names of columns


NAMES: Final[Mapping[str, str]] = {
    "east": "east easting e x eastings rechtswert ostwert rw ost est este oost utm_e utm_x xcoord",
    "north": "north northing n y northings hochwert nordwert hw nord norte noord utm_n utm_y ycoord",
    "lat": "lat latitude breite latitud latitudine breedtegraad",
    "lon": "lon long lng longitude laenge länge longitud longitudine lengtegraad",
    "height": "height z elevation elev alt altitude h h_ell ell_height sfm_z hoehe höhe rl up hauteur "
    "altura quota hoogte",
    "depth": "depth d tiefe wassertiefe profondeur prof profundidad profundidade profondità diepte sounding "
    "soundings wd",
    "sigma": "sigma sigma_z sigma_up sigma_height sigma_depth sd std stdev stddev uncertainty tvu accuracy",
    "line": "line line_id line_name profile section transect track run survey_line",
    "time": "time local_time timestamp datetime date_time date_time_utc datetime_utc timestamp_utc time_utc "
    "utc utc_time gps_time epoch epoch_ms unix unix_s t "
    "uhrzeit zeit zeitstempel heure hora ora tijd",
    "week": "week gps_week gpsweek wn",
    "tow": "tow sow gps_sow gps_tow seconds_of_week",
    "date": "date day datum date_utc fecha",
    "draught": "draught draft tiefgang tirant",
    "level": "level water_level wl stage gauge wasserstand pegel",
}
"""Quantities and the names, small letters without units, by which columns of them are known."""
_KIND: Final = {"east": "position", "north": "position", "level": "height"}
"""Row of `NOTHING` for a quantity whose name is none."""
_FILLER_WORDS: Final = (
    "point coord coordinate coordinates coords gps gnss utm water mean avg average measured corrected of "
    "the in wgs epsg value bottom bed river lake decimal degrees deg dd degree pos position map grid "
    "surveyed nhn nn msl asl"
)
_FILLERS: Final = frozenset(_FILLER_WORDS.split())
"""Words in names that change nothing of what is meant."""
_ANGLES: Final = {"rad": 180.0 / np.pi, "radian": 180.0 / np.pi, "radians": 180.0 / np.pi, "gon": 0.9}
"""Units of latitude and longitude other than degrees -> degrees."""
_OTHER_UNITS: Final = (
    "% bar dbar mbar kpa hpa pa psi ms us s sec min v mv counts raw_counts px pixel pixels "
    + " ".join(_ANGLES)
)
NO_LENGTHS: Final = frozenset(_OTHER_UNITS.split())
"""Units that are known and are no lengths."""
_OF_ATTITUDE: Final = ("omega", "phi", "kappa")
_OF_IMAGES: Final = frozenset(["px", "pixel", "pixels", "s", "ms", "us"])
"""Those of them that belong to places and times of pictures."""
MOST_GARBLED: Final = 0.05
"""Share of cells without a number beyond which a column is refused rather than thinned."""
_SECOND_M: Final = 10.0
"""Two statements of one place (degrees, and metres of the grid) that differ by more contradict each other."""

NUMBER: Final = re.compile(r"[-+−]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?")
_SECONDS: Final = {"s": 1.0, "sec": 1.0, "ms": 1e3, "us": 1e6}
"""Units of time -> how many of them make a second."""
_UTM_ZONE: Final = re.compile(r"(?i)(?<![a-z])UTM[\W_]*(?:zone[\W_]*)?(\d\d?)(?!\d)")
_OF_ZONES: Final = ("timezone", "time_zone", "tz", "tz_cd", "utc_offset", "utcoffset")
_PACKED: Final = re.compile(r"(?i)[(\[_ ]d+[.°]?m[m.]|[(\[_ ](?:dms|ddm|dmm)\b")
"""Names of angles whose minutes follow the degrees in one number."""
_NEGATIVE: Final = {"lat": {"s", "south", "süd"}, "lon": {"w", "west", "ouest", "oeste"}}
_EITHER: Final = {"n", "north", "e", "east", "neg", "negative", "positive"}
"""Words in the name of an angle: counted to the other side, or the sign tells."""
_OF_SIDES: Final = re.compile(r"(?i)hemi|[_ ](?:ref|dir)|^(?:n\W?s|e\W?w)$|^(?:lat|lon)\w*[ _](?:ns|ew)")
"""Names of columns with the letters N, S, E, W that do not stand beside their angles."""
_OF_NOTHING: Final = re.compile(
    r"(?i)(?:no[ _-]?data(?:[ _-]?value)?|(?:missing|fill|null|dummy)[ _-]?value)\W{1,3}?(-?\d+(?:\.\d+)?)"
)
"""A remark that states which number stands for none."""
_OF_95: Final = re.compile(r"(?i)95|1[.,]96|\b2\W?(?:s|sd|std|sigma|σ)\b")
"""Names of uncertainties that hold with 95 %."""
_OF_DATUM: Final = re.compile(r"(?i)\b(?:dhhn|nhn|nn|navd|ngvd|a?msl|asl|mllw|orthom|geoid|egm)")
"""Heights above something else than the ellipsoid."""
_FEWEST_HEIGHTS: Final = 5
"""Different ones that show a 0 far from all of them to be none."""
_ANGLE: Final = re.compile(
    r"\s*([NSEW])?\s*([-+−]?\d+(?:[.,]\d+)?)\s*(?:[°d:\s]\s*(\d+(?:[.,]\d+)?)\s*(?:['′m:\s]\s*(\d+(?:[.,]\d+)?)\s*(?:''|\"|″|s)?)?)?"
    r"\s*['′°]?\s*([NSEW])?\s*",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True)
class Column:
    """A column: name as the file has it, the words of it without unit, and its unit, if one is stated.

    ``foreign`` is a stated unit that is no length.
    """

    name: str
    words: str
    unit: Unit | None = None
    foreign: str = ""


_GLUED: Final = re.compile(
    r"(depth|tiefe|height|elev|elevation|altitude|easting|northing|level|stage)(ft|feet|usft|[cdm]m|m|fathoms?)"
)
"""A quantity and its unit without anything between them."""
_LONGEST_NAME: Final = 200
"""Letters of a column's name; the first line of what is no table may be one of a megabyte."""


_SCALE: Final = re.compile(r"(?<!\d)[x×*/]\s*[\d.]+|^(?:1/|0?\.)\d+\s*[a-z]", re.IGNORECASE)
"""Tenths of a unit and the like: ``ft/10``, ``x 0.1 m``, ``1/10 ft``, ``0.1 m``."""


def unit_in_brackets(text: str) -> tuple[Unit | None, str]:
    """The unit of length in the words behind a name, and what they state that is none.

    Examples
    --------
    >>> unit_in_brackets("ft, MLLW")[0].name, unit_in_brackets("in US survey feet below datum")[0].name
    ('foot', 'US survey foot')
    >>> unit_in_brackets("x0.1 ft"), unit_in_brackets("mbar"), unit_in_brackets("200 kHz")
    ((None, 'x0.1 ft'), (None, 'mbar'), (None, ''))
    """
    word = text.strip().lower()
    if (unit := unit_of_word(text)) is not None:
        return unit, ""
    if word in NO_LENGTHS:
        return None, word
    pieces, units, k = re.split(r"[\s,;:&+]+", word), set(), 0
    if "deg" in word or "dd" in pieces or "ddd" in pieces:  # whose minutes are mm
        return None, ""
    while k < len(pieces):
        parts = [(n, unit_of_word(" ".join(pieces[k : k + n]))) for n in (3, 2, 1)]
        n, unit = next((each for each in parts if each[1] is not None), (1, None))
        if unit is not None and pieces[k : k + n] != ["in"]:
            units.add(unit)
        k += n
    if len(units) > 1 or (_SCALE.search(word) and any(unit_of_word(w) for w in re.findall("[a-z]+", word))):
        return None, word
    return next(iter(units), None), ""


def column_of(name: str) -> Column:
    """What the name of a column says.

    Examples
    --------
    >>> column_of("WaterDepthFt").words, column_of("WaterDepthFt").unit.name
    ('depth', 'foot')
    >>> column_of("Depth_in_Feet").words, column_of("depth (US ft)").unit.name
    ('depth', 'US survey foot')
    >>> column_of("POINT_Z").words, column_of("DEPTHFT").unit.name, column_of("depth_ft_avg").unit.name
    ('z', 'foot', 'foot')
    >>> column_of("Depth (ft, MLLW)").unit.name, column_of("Depth (ft/10)").foreign
    ('foot', 'ft/10')
    """
    bare = name.strip()[:_LONGEST_NAME].strip("\"'").strip()
    unit, foreign, rest = None, "", re.sub(r"(?i)\b(?:[xyz]|date)/(?=\w\w)", "", bare)
    if bracket := re.search(r"[(\[{<]([^)\]}>]*)[)\]}>]\s*$", rest):
        rest = rest[: bracket.start()]
        unit, foreign = unit_in_brackets(bracket[1])
    split = re.sub(r"([a-zäöüß])([A-ZÄÖÜ])", r"\1 \2", rest)
    tokens = re.findall(r"[^\W\d_]+", re.sub(r"([A-Z]+)([A-Z][a-z])", r"\1 \2", split).lower())
    if unit is None and not foreign:
        if glued := _GLUED.fullmatch("_".join(tokens)):
            tokens = list(glued.groups())
        for k in (3, 2, 1):
            if len(tokens) > k and (unit := unit_of_word("_".join(tokens[-k:]))) is not None:
                tokens = tokens[:-k]
                break
        else:
            inside = [k for k, token in enumerate(tokens) if token in SPOKEN and len(tokens) > 1]
            if len(inside) == 1:
                unit = unit_of_word(tokens.pop(inside[0]))
            elif len(tokens) > 1 and tokens[-1] in NO_LENGTHS:
                foreign = tokens.pop()
    kept = [t for t in tokens if t not in _FILLERS] or tokens
    return Column(bare, "_".join(kept), unit, foreign)


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table as a file has it.

    Attributes
    ----------
    path : the file.
    columns : of the header; without one named by their place (``column 1``) or as the caller states.
    named : whether the file names its columns.
    cells : (n, k) texts without blanks around them.
    line : (n,) number of each row's line in the file, from 1.
    decimal, thousands : marks inside numbers; no ``thousands`` if empty.
    code, degrees : EPSG codes of the map, and of latitudes and longitudes, that the file states.
    remarks : what the file says in words beside its rows.
    losses : rows that were not taken: reason -> their number and the first line; grows as columns are read.
    notes : what was assumed.
    """

    path: Path
    columns: tuple[Column, ...]
    named: bool
    cells: pd.DataFrame
    line: ArrayI
    decimal: str = "."
    thousands: str = ""
    code: int | None = None
    degrees: int | None = None
    remarks: tuple[str, ...] = ()
    losses: dict[str, tuple[int, int]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.line)

    @classmethod
    def of(cls, frame: pd.DataFrame, path: Path) -> "Table":
        """The table of values that another format holds, such as attributes of points."""
        cells = frame.astype(object).where(frame.notna(), "").astype(str)
        return cls(
            path=path,
            columns=tuple(column_of(str(name)) for name in frame),
            named=True,
            cells=cells.set_axis(range(frame.shape[1]), axis=1).reset_index(drop=True),
            line=np.arange(1, len(frame) + 1),
        )

    def heights_in(self, unit: Unit) -> "Table":
        """The same, with heights whose columns name no unit in that of their coordinate system."""
        known = NAMES["height"].split()
        columns = (
            replace(c, unit=unit) if c.words in known and c.unit is None and not c.foreign else c
            for c in self.columns
        )
        return replace(self, columns=tuple(columns))

    # -------------------------------- which column

    def find(self, quantity: str, names: Mapping[str, str] = NAMES) -> int | None:
        """Place of the column of a quantity; None if there is none.

        Raises
        ------
        InputError : several columns may be meant.
        """
        found = self._all(quantity, names)
        plain = [k for k in found if _without_unit(self.columns[k].name) in names[quantity].split()]
        if len(found) > 1 and len(plain) == 1:  # depth beside depth_corrected: what is named without more
            return plain[0]
        if len(found) > 1:
            self._refuse_several(quantity, found)
        return found[0] if found else None

    def _refuse_several(self, quantity: str, found: Sequence[int]) -> None:
        listed = ", ".join(self.columns[k].name for k in found)
        raise InputError(
            f"several columns of {quantity}: {listed}",
            expected="one of them",
            where=self.path,
            cure="Name the one that is meant, or rename the others",
        )

    def _all(self, quantity: str, names: Mapping[str, str] = NAMES) -> list[int]:
        known = names[quantity].split()
        angle = quantity in ("lat", "lon")  # whose minutes and seconds may stand in lat_m, lat_s
        return [
            k
            for k, c in enumerate(self.columns)
            if (c.words in known or c.name.lower() in known)
            and not (angle and (c.unit or (c.foreign and c.foreign not in _ANGLES)))
        ]

    def column(self, name: str) -> int:
        """Place of a column by the name that a user states: as in the file, in another case, or a quantity.

        Raises
        ------
        InputError : no such column.
        """
        wanted = name.strip()
        for same in (str, str.casefold):
            found = [k for k, c in enumerate(self.columns) if same(c.name) == same(wanted)]
            if found:
                return found[0]
        by_quantity = self.find(wanted) if wanted in NAMES else None
        if by_quantity is None:
            raise InputError(
                f"no column {name}",
                where=self.path,
                expected=f"one of {self.listed()}",
                cure="Name one of these",
            )
        return by_quantity

    def listed(self) -> str:
        """Names of the columns, for a message."""
        return ", ".join(c.name for c in self.columns)

    def having(self, quantities: Sequence[str]) -> bool:
        """Whether there is a column of each quantity."""
        return all(self.find(q) is not None for q in quantities)

    # -------------------------------- what stands in it

    def text(self, k: int) -> list[str]:
        """Cells of a column."""
        cells = self.cells[k]
        return [f"{v:.15g}" for v in cells] if cells.dtype.kind == "f" else list(cells)

    def numbers(
        self, k: int, quantity: str = "other", *, nothing: Sequence[float] = (), keep: Sequence[float] = ()
    ) -> ArrayF:
        """Numbers (n,) of a column in metres (other quantities as they stand); NaN where there is no value.

        Cells without a value are counted by reason, each row at its first.

        Parameters
        ----------
        k : place of the column.
        quantity : which values stand for none, see `thalweg.core.values.NOTHING`.
        nothing, keep : more such values, and such that are meant.

        Raises
        ------
        InputError : a unit that is no length, or text in more than a twentieth of the cells.
        """
        column, cells = self.columns[k], self.cells[k]
        if column.foreign and not (quantity == "time" and column.foreign in _SECONDS):
            raise InputError(
                f"column {column.name} in {column.foreign}",
                where=self.path,
                expected="a unit of length",
                cure="Convert it to metres, or name another column",
            )
        if quantity in ("height", "level"):
            self._refuse_depths(k)
        values, metres = self._values(k)
        if np.isnan(values).any():
            words = np.asarray(cells.str.lower().isin(WORDS), dtype=np.bool_)
            self._lose("without a value", column.name, words)
            odd = np.isnan(values) & ~words
            if odd.any():
                row = int(np.argmax(odd))
                first = f"'{cells.iloc[row][:40]}'"
                if odd.mean() > MOST_GARBLED:
                    raise InputError(
                        f"{first} in column {column.name}, and {int(odd.sum()) - 1:,} more of "
                        f"{len(values):,} rows without a number",
                        expected="numbers",
                        where=f"{self.path}:{self.line[row]}",
                        cure="Look at the separator and the decimal mark, or name another column",
                    )
                self._lose(f"with {first} for a number", column.name, odd)
        kind = quantity if quantity in NOTHING else _KIND.get(quantity, "other")
        declared = [float(value) for line in self.remarks for value in _OF_NOTHING.findall(line)]
        none = is_nothing(values, kind, [*nothing, *declared], keep) & np.isfinite(values)
        if kind == "sigma":
            none |= values <= 0
            metres = metres / self._sigmas_in(k)
        if kind in ("depth", "height"):
            none |= _stand_ins(np.where(none, np.nan, values), keep)
        if none.any():
            shown = ", ".join(f"{v:g}" for v in np.unique(values[none])[:3])
            self._lose(f"with {shown}, which stands for no value,", column.name, none)
        return np.where(none, np.nan, values * metres)

    def _sigmas_in(self, k: int) -> float:
        """How many standard deviations the values of a column of them are."""
        if not _OF_95.search(name := self.columns[k].name):
            return 1.0
        self._note(f"column {name} divided by 1.96, from 95 % to one standard deviation")
        return 1.96

    def _refuse_depths(self, k: int) -> None:
        """Refuse a column of heights that counts downwards by its name or a remark; note another datum."""
        name = self.columns[k].name
        down = next((line for line in (name, *self.remarks) if says_downwards(line)), None)
        if down is None and re.search(r"(?i)\b(?:down(?:wards?)?|below|depth)\b", name.replace("_", " ")):
            down = name
        if down is not None and self.find("depth") is None:
            raise InputError(
                f"heights in column {name}, and "
                + ("its name" if down == name else f"the remark '{down[:60]}'"),
                where=self.path,
                expected="heights, positive upwards",
                cure="Call the column depth, or change its sign",
            )
        if _OF_DATUM.search(name.replace("_", " ")):
            self._note(f"column {name}: its datum is not read, the heights are taken as they stand")

    def _values(self, k: int) -> tuple[ArrayF, ArrayF]:
        """Numbers (n,) of a column as they stand, NaN where there is none, and the metres of their units.

        A unit in a cell goes before that of the column.
        """
        cells, column = self.cells[k], self.columns[k]
        values, usual = self._parsed(cells), column.unit or METRE
        metres, others = np.full(len(values), usual.metres), Counter[str]()
        if (none := np.isnan(values)).any():
            # a unit behind the number, group marks, Fortran's exponents
            for row in np.flatnonzero(none & cells.str.match(r"[-+−.,\d]").to_numpy(np.bool_)).tolist():
                values[row], own = self._odd(cells.iloc[row])
                metres[row] = (own or usual).metres
                others.update([] if own in (None, usual) else [own.plural])
        for unit, n in others.items():
            self._note(f"{n:,} of {len(cells):,} cells of column {column.name} state {unit}, and are read so")
        return values, metres

    def _note(self, sentence: str) -> None:
        if sentence not in self.notes:
            self.notes.append(sentence)

    def _parsed(self, cells: "pd.Series[Any]") -> ArrayF:
        if cells.dtype.kind == "f":
            return cells.to_numpy(np.float64).copy()
        if self.thousands:
            cells = cells.str.replace(self.thousands, "", regex=False)
        if self.decimal == ",":
            cells = cells.str.replace(",", ".", regex=False)
        return pd.to_numeric(cells, errors="coerce").to_numpy(np.float64, na_value=np.nan).copy()

    def _odd(self, text: str) -> tuple[float, Unit | None]:
        """A number that pandas does not read, and the unit behind it; NaN for any other text."""
        bare = re.sub(r"(?<=\d)['\u00a0\u202f ](?=\d{3})", "", text.replace("−", "-"))
        if self.thousands:
            bare = bare.replace(self.thousands, "")
        if self.decimal == ",":
            bare = bare.replace(",", ".")
        found = re.fullmatch(rf"({NUMBER.pattern})\s*([^\d\s.,].*)?", bare.strip())
        unit = unit_of_word(found[2]) if found and found[2] else None
        if not found or (found[2] and unit is None):
            return np.nan, None
        return float(re.sub("[dD]", "e", found[1])), unit

    def _lose(self, reason: str, column: str, rows: ArrayB) -> None:
        if n := int(rows.sum()):
            self.losses[f"{reason} in column {column}"] = (n, int(self.line[np.argmax(rows)]))

    def loss_notes(self) -> list[str]:
        """A sentence for each reason for which rows were not taken."""
        return [
            f"{n:,} row{'s' if n > 1 else ''} {reason}, left out, the first in line {line}"
            for reason, (n, line) in self.losses.items()
        ]

    def unit_notes(self, *places: int) -> list[str]:
        """What was converted, or taken as metres, of some columns."""
        out = []
        for k in places:
            c = self.columns[k]
            if c.unit is None:
                out.append(f"column {c.name} states no unit: taken as metres")
            elif not c.unit.is_metre:
                out.append(f"column {c.name} converted from {c.unit.name} ({c.unit.metres:.10g} m)")
        return out

    # -------------------------------- places

    def places(self, crs: CRS | None, *, any_system: bool = False) -> "Places":
        """East and north of each row on a map.

        Columns of latitude and longitude are transformed, onto the zone of UTM in their middle without a
        stated map; of a file that states both, the two are compared.

        Parameters
        ----------
        crs : of the map, in metres or feet, which the result is not; None where the table states degrees.
        any_system : coordinates in metres need no CRS.

        Raises
        ------
        InputError : no columns of coordinates, or none of a stated system.
        """
        metric, angular = self.having(("east", "north")), self.having(("lat", "lon"))
        if crs is None:
            crs = None if self.code is None or angular else CRS.from_epsg(self.code)
        elif not angular:
            self.refuse_other_map(crs)
        stated, unit_m = crs, 1.0
        if crs is not None:
            found = in_metres(crs)
            crs, unit_m = found.crs, found.factors[0]
        if not (metric or angular):
            raise InputError(
                f"columns {self.listed()}",
                where=self.path,
                expected="coordinates: east, north; x, y; latitude, longitude",
                cure="Name the columns in the first line"
                + ("" if self.named else ", or state their order: --columns x,y,z"),
            )
        if angular:
            lat, lon = self.angles("lat"), self.angles("lon")
            lost = (lat == 0.0) & (lon == 0.0)  # receivers without a fix
            self._lose("with 0, 0, which is no place,", "latitude, longitude", lost)
            lat[lost] = lon[lost] = np.nan
            known = np.isfinite(lat) & np.isfinite(lon)
            if not known.any():
                raise InputError(
                    "no row has a latitude and a longitude",
                    where=self.path,
                    expected="degrees",
                    cure="Look whether the receiver had a fix",
                )
            on = crs if crs is not None else utm_of(lon[known], lat[known])
            way, said = self.way_of_degrees(on)
            east, north = way.transform(lon, lat)
            xy = np.column_stack([east, north])
            xy[~known] = np.nan
            also = ", the zone of UTM of the data" if crs is None else ""
            notes = [
                f"latitude and longitude {said} and transformed to {on.name}{also}{accuracy_in_words(way)}"
            ]
            if not (metric and crs is not None):
                if not np.isfinite(xy[known]).all():
                    middle = in_words(float(np.median(lon[known])), float(np.median(lat[known])))
                    raise InputError(
                        f"places about {middle} have none in {on.name}",
                        where=self.path,
                        expected=f"places in {on.name}",
                        cure="Look at campaign.crs: is it used at these places?",
                    )
                check_places(np.column_stack([lon, lat])[known], on, where=self.path, degrees=True)
                return Places(xy, on, notes)
        e, n = (self.find(q) for q in ("east", "north"))
        assert e is not None
        assert n is not None
        first = None if crs is None else crs.axis_info[0]
        by_letter = {self.columns[e].words, self.columns[n].words} == {"x", "y"}
        if crs is None and not any_system:
            raise InputError(
                f"columns {self.columns[e].name}, {self.columns[n].name} without a coordinate system",
                where=self.path,
                expected="its code",
                cure="State campaign.crs, such as EPSG:32633, or name the columns lat, lon of degrees",
            )
        own = np.column_stack([self.numbers(e, "east"), self.numbers(n, "north")])
        notes = [x for x in self.unit_notes(e, n) if "converted" in x]
        if by_letter and first is not None and (first.abbrev.lower(), first.direction) == ("x", "north"):
            notes.append(
                f"columns x, y are taken as east, north; in {crs and crs.name} x is the northing: name "
                "them east and north if they are exchanged"
            )
        if unit_m != 1.0 and stated is not None:
            if self.columns[e].unit is None:
                own *= unit_m
                notes.append(f"east and north taken in the unit of {stated.name} ({unit_m:.10g} m)")
            whole = np.isfinite(own).all(axis=1)
            check_places(own[whole] / unit_m, stated, where=self.path, cure="campaign.crs")
        if angular and crs is not None:
            both = np.isfinite(own).all(axis=1) & np.isfinite(xy).all(axis=1)
            apart = np.linalg.norm(own - xy, axis=1)[both]
            if len(apart) and np.median(apart) > _SECOND_M:
                raise InputError(
                    f"columns {self.columns[e].name}, {self.columns[n].name} lie {np.median(apart):,.0f} m "
                    "from those of latitude and longitude in the median",
                    where=self.path,
                    expected=f"one place in each row, in {on.name}",
                    cure="Look at campaign.crs, or leave two of the columns out",
                )
        if crs is not None:  # in a system of its own the origin is a place
            lost = (own == 0.0).all(axis=1)
            self._lose("with 0, 0, which is no place,", "east, north", lost)
            own[lost] = np.nan
        return Places(own, crs, notes)

    def way_of_degrees(self, on: CRS) -> tuple[Transformer, str]:
        """From latitude and longitude in the system that the file states, else WGS 84, to a map; in words.

        Raises
        ------
        InputError : no transformation from another datum is known.
        """
        source = CRS.from_epsg(self.degrees or 4326)
        if self.degrees in (None, 4326):
            return Transformer.from_crs(4326, on, always_xy=True), "taken as WGS 84"
        if (way := way_between(source, on)) is not None:
            return way, f"are in {source.name}, as the file states,"
        raise InputError(
            f"latitude and longitude in {source.name}, by the file",
            where=self.path,
            expected=f"a system from which a transformation to {on.name} is known",
            cure="Transform them with the grid files of the land survey",
        )

    def refuse_other_map(self, crs: CRS) -> None:
        """Refuse a map that is not the one which the file states by a code, a name or a zone of UTM.

        Raises
        ------
        InputError : they differ, or the rows are of several zones.
        """
        if self.code is not None and crs.to_2d().to_epsg() not in (None, self.code):
            own = CRS.from_epsg(self.code).name
            raise InputError(
                f"places in {own} (EPSG:{self.code}) by the file, in {crs.name} as stated",
                where=self.path,
                expected="one coordinate system",
                cure=f"State EPSG:{self.code}, or correct the file",
            )
        if not crs.utm_zone:
            return
        wanted = int(crs.utm_zone[:-1])
        words = (*self.remarks, *(column.name for column in self.columns))
        remarks = {int(zone) for each in words for zone in _UTM_ZONE.findall(each)}
        said = set() if wanted in remarks else remarks
        for k, column in enumerate(self.columns):
            if column.words in ("zone", "utm_zone", "zone_utm"):
                cells = {*self.text(k)}
                told = {
                    int(found[1]) for c in cells if (found := re.fullmatch(r"(?:UTM)?\s?(\d\d?)\s?[A-Z]?", c))
                }
                # a bare number may count areas of the survey, but hardly by the zones beside its own
                if told and ("utm" in column.words or all(abs(zone - wanted) <= 1 for zone in told)):
                    said |= told
        if said - {wanted}:
            raise InputError(
                f"places in {crs.name} as stated, in zone {', '.join(map(str, sorted(said)))} by the file",
                where=self.path,
                expected="one zone of UTM",
                cure="State the zone of the file, or split it by its zones",
            )

    def _has_sides(self, k: int, quantity: str) -> bool:
        """Whether numbers alone do not tell an angle: by its name, letters, minutes."""
        beside = any(_OF_SIDES.search(column.name) for column in self.columns)
        said = set(re.findall(r"[a-z]+", self.columns[k].name.lower()))
        return beside or bool(said & _NEGATIVE[quantity]) or bool(np.isnan(self._parsed(self.cells[k])).any())

    def angles(self, quantity: str) -> ArrayF:
        """Degrees (n,) of the column of latitude or longitude; NaN where there is no value.

        Decimal degrees, degrees with minutes and seconds, and letters of the hemisphere are read, the letter
        also in a column of its own.

        Raises
        ------
        InputError : no such column, or angles beyond 90 or 180.
        """
        k = self.find(quantity)
        assert k is not None
        letters, limit = ("NS", 90.0) if quantity == "lat" else ("EW", 180.0)
        cells = self.cells[k]
        values = self._parsed(cells)
        for row in np.flatnonzero(np.isnan(values)).tolist():
            values[row] = _angle(cells.iloc[row], letters)
        values[is_nothing(values, "position")] = np.nan
        values *= _ANGLES.get(self.columns[k].foreign, 1.0)
        if _PACKED.search(self.columns[k].name) and np.isfinite(self._parsed(cells)).mean() > 0.5:
            raise InputError(
                f"numbers such as {cells.iloc[0]} in column {self.columns[k].name}",
                where=self.path,
                expected="decimal degrees, or blanks between degrees and minutes",
                cure="Write decimal degrees: degrees and minutes in one number cannot be told from these",
            )
        none = ~np.isfinite(values)
        if none.mean() > MOST_GARBLED and not cells[none].str.lower().isin(WORDS).all():
            bad = int(np.flatnonzero(none)[0])
            raise InputError(
                f"'{cells.iloc[bad][:40]}' in column {self.columns[k].name}, {int(none.sum()):,} such cells",
                expected=f"a {'latitude' if quantity == 'lat' else 'longitude'} in degrees",
                where=f"{self.path}:{self.line[bad]}",
                cure="Write decimal degrees, or degrees, minutes and seconds with blanks between them",
            )
        self._lose("without a value", self.columns[k].name, none)
        said = set(re.findall(r"[a-z]+", self.columns[k].name.lower()))
        if said & _NEGATIVE[quantity] and not said & _EITHER and not (values < 0).any():
            values = -values
            self.notes.append(
                f"column {self.columns[k].name} counts to the {'south' if letters == 'NS' else 'west'}"
            )
        for beside, column in enumerate(self.columns):
            if abs(beside - k) != 1 and not _OF_SIDES.search(column.name):
                continue
            side = pd.Series(self.text(beside)).str.upper()
            if len(side) and side.isin([*letters, ""]).all() and side.isin(list(letters)).any():
                values = np.where(side == letters[1], -np.abs(values), values)
        known = values[np.isfinite(values)]
        if quantity == "lon" and len(known) and known.min() >= 0.0 and known.max() <= 360.0:
            values = np.where(values > limit, values - 360.0, values)  # counted eastwards all around
            known = values[np.isfinite(values)]
        if len(known) and np.abs(known).max() > limit:
            minutes = (np.abs(known) % 100 < 60).all() and np.abs(known).max() < 100 * limit
            scaled = (known % 1 == 0).all() and np.abs(known).max() > 1e7  # more metres than any northing
            raise InputError(
                f"{known[np.argmax(np.abs(known))]:g} in column {self.columns[k].name}",
                expected=f"degrees up to {limit:.0f}",
                where=self.path,
                cure="These look like degrees and minutes in one number (ddmm.mmmm): write decimal degrees"
                if minutes
                else "These look like degrees times 1e7, as autopilots log them: divide them by it"
                if scaled
                else "Look at the order of the columns: latitude and longitude may be exchanged",
            )
        return values

    # -------------------------------- times

    def times(self) -> tuple[ArrayF, list[str]] | None:
        """Unix time (n,) of each row, NaN where there is none, and what was assumed; None without a date.

        Read are ISO 8601 and days with points (day first) or slashes, where the whole file tells which number
        is the month, in one column or in a date and a time; and numbers since 1970 in s, ms, us or ns.
        Without a stated zone times count as UTC.

        Raises
        ------
        InputError : days and months that may be exchanged.
        """
        date, found = self.find("date"), None
        named = sorted(self._all("time"), key=lambda k: "utc" not in self.columns[k].name.lower())
        columns: Sequence[int | None] = named or [None]
        for time in columns:
            found = self._moments(date, time)
            if found is None or np.isfinite(found[0]).any():
                if found is not None and len(named) > 1:
                    others = ", ".join(self.columns[k].name for k in named if k != time)
                    found[1].append(f"times of column {self.columns[time or 0].name}, not of {others}")
                break
        if found is not None:
            possible = np.where(possible_unix(found[0]), found[0], np.nan)
            found[1].extend(x for x in (doubtful_date(gps_from_unix(possible)),) if x)
        return found

    def _moments(self, date: int | None, time: int | None) -> tuple[ArrayF, list[str]] | None:
        """Times by a column of dates, one of times, or both; see `times`."""
        if time is None:  # a clock under any name
            cells = {k: pd.Series(self.text(k)) for k in range(len(self.columns)) if k != date}
            clocks = [k for k, c in cells.items() if len(c) and c.str.fullmatch(CLOCK).all()]
            time = clocks[0] if len(clocks) == 1 else None
        parts = [pd.Series(self.text(k)) for k in (date, time) if k is not None]
        week, tow = self.find("week"), self.find("tow")
        if not parts and week is not None and tow is not None:
            second = self.numbers(tow, "time")
            unit = self.columns[tow].foreign or ("ms" if (second > 2 * WEEK_S).any() else "s")
            t_gps_s = gps_from_week(self.numbers(week, "time"), second / _SECONDS[unit])
            notes = [
                f"times taken as GPS weeks and seconds of the week ({self.columns[tow].name}, in {unit})"
            ]
            return unix_from_gps(t_gps_s), notes
        if not parts:
            return None
        of_zones = next((k for k, c in enumerate(self.columns) if c.words in _OF_ZONES), None)
        unix, notes = unix_of_texts(
            parts[0] if len(parts) == 1 else parts[0].str.cat(parts[1], sep=" "),
            self.columns[time if time is not None else date or 0].name,
            remarks=self.remarks,
            zones=None if of_zones is None else (self.columns[of_zones].name, pd.Series(self.text(of_zones))),
            where=self.path,
        )
        if len(parts) == 2 and parts[0].nunique() == 1 and (later := past_midnight(unix)) is not unix:
            name = self.columns[date or 0].name
            return later, [*notes, f"times pass midnight and the date in column {name} stays: next day"]
        return unix, notes

    # -------------------------------- rows as texts

    def rows(self, names: Mapping[str, Iterable[str]]) -> list[dict[str, str]]:
        """Rows as texts by the caller's own names of columns, numbers with a decimal point and in metres.

        Parameters
        ----------
        names : our name -> names, small letters, by which the column is known; the first one counts.
        """
        heads = {c.name.lower(): k for k, c in reversed(list(enumerate(self.columns)))}
        words = {c.words: k for k, c in reversed(list(enumerate(self.columns)))}
        where = {
            ours: k
            for ours, known in names.items()
            if (k := next((d[n] for n in known for d in (heads, words) if n in d), None)) is not None
        }
        of_heights = NAMES["height"].split()
        of_sigmas = {ours for ours in names if ours.startswith("sigma") or ours == "accuracy"}
        for ours, k in where.items():
            fits = _OF_IMAGES | (_ANGLES.keys() if ours in _OF_ATTITUDE else set())
            if self.columns[k].foreign and self.columns[k].foreign not in fits:
                self.numbers(k)  # refuses it
            others = [j for j in range(len(self.columns)) if j != k and self.text(j) != self.text(k)]
            name = self.columns[k].name
            if again := [j for j in others if self.columns[j].name.lower() == name.lower()]:
                self._refuse_several(name, [k, *again])
            if ours in ("z", "up_m", "h_ell_m"):
                self._refuse_depths(k)
                heights = [c.name for c in map(self.columns.__getitem__, others) if c.words in of_heights]
                if heights:
                    self._note(f"column {name} taken as the height, not {', '.join(heights)}")
        columns = {ours: self._plain(k, sigma=ours in of_sigmas) for ours, k in where.items()}
        for ours, quantity in (("lat_deg", "lat"), ("lon_deg", "lon")):
            k = where.get(ours)
            if k is not None and self.find(quantity) == k and self._has_sides(k, quantity):
                told = zip(self.angles(quantity).tolist(), columns[ours], strict=True)
                columns[ours] = [repr(value) if np.isfinite(value) else cell for value, cell in told]
        return (
            [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
            if columns
            else []
        )

    def _plain(self, k: int, *, sigma: bool) -> list[str]:
        """Cells of a column, numbers as Python reads them and in metres."""
        out, (values, factors) = self.text(k), self._values(k)
        factors = factors / self._sigmas_in(k) if sigma else factors
        for row, (value, metres) in enumerate(zip(values.tolist(), factors.tolist(), strict=True)):
            if not np.isnan(value) and (metres != 1.0 or not NUMBER.fullmatch(out[row]) or self.thousands):
                out[row] = repr(value * metres)
        return out


@dataclass(frozen=True, slots=True)
class Places:
    """East and north (n, 2) on the map ``crs`` (None: none is stated), NaN where a row has none; notes."""

    xy_m: ArrayF
    crs: CRS | None
    notes: list[str]


def _stand_ins(values: ArrayF, keep: Sequence[float]) -> ArrayB:
    """Depths and heights that repeat far from all others; 0, and such as 99.9, where others are far away."""
    known = np.unique(values[np.isfinite(values)])
    found = set(far_repeated(values))
    if len(known) > 1 and known[-1] > 3 * np.abs(known[[0, -2]]).max():
        found |= {float(known[-1])} if re.fullmatch(r"99+(\.9+)?|9\.9+", f"{known[-1]:.15g}") else set()
    others = known[known != 0]
    if _FEWEST_HEIGHTS <= len(others) < len(known) and np.abs(others).min() > 10 * np.ptp(others):
        found |= {0.0}
    return np.isin(values, list(found - set(keep)))


def _without_unit(name: str) -> str:
    """A name in small letters without its unit, but with all other words."""
    bare = re.sub(r"[(\[{<][^)\]}>]*[)\]}>]\s*$", "", name).strip().lower()
    head, _, tail = bare.rpartition("_")
    return head if head and unit_of_word(tail) is not None else bare


def _angle(text: str, letters: str) -> float:
    """Degrees of an angle as people write it; NaN for anything else."""
    found = _ANGLE.fullmatch(text.replace("−", "-"))
    if not found or (found[1] and found[5]):
        return np.nan
    letter = (found[1] or found[5] or letters[0]).upper()
    parts = [float((found[k] or "0").replace(",", ".")) for k in (2, 3, 4)]
    if letter not in letters or parts[1] >= 60 or parts[2] >= 60:
        return np.nan
    size = abs(parts[0]) + parts[1] / 60 + parts[2] / 3600
    return -size if letter == letters[1] or found[2].startswith("-") else size
