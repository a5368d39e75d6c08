"""RTKLIB solutions (.pos) in all their variants, into GNSS positions with full covariance.

Time is a calendar date or week and second, in GPST, UTC or JST (UTC + 9 h); coordinates are latitude,
longitude and height (degrees, or degrees, minutes, seconds), earth-centred x, y, z, or a baseline east,
north, up from the base. Standard deviations beside the diagonal are signed roots:
``sdne = sign(cov_ne) sqrt(|cov_ne|)`` (RTKLIB manual 2.4.2, appendix B.1; solution.c, ``sqvar``).
"""

import datetime as dt
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
import pandas as pd

from thalweg.core import (
    ADJUSTED_OFFSET_S,
    DAY_S,
    GPS_EPOCH_UNIX_S,
    WEEK_S,
    AnyArray,
    ArrayF,
    InputError,
    ecef_of,
    frame_of,
    geodetic_of,
    gps_from_unix,
    require_file,
    rotation_ecef_enu,
)
from thalweg.ingest import (
    FIRST_UNIX_S,
    GNSS_POSITION,
    LAST_UNIX_S,
    IntegrityReport,
    PositionLog,
    doubtful_date,
)
from thalweg.ingest.tracks.sbet import half_turn

# ---------------------------------------------------------------- which columns a RTKLIB .pos file has: read
# from its header, or guessed from its first line


SEPARATORS: Final = re.compile(r"[\s,;|]+")
Form = Literal["llh", "xyz", "enu"]

_DATE: Final = re.compile(r"\d{4}[/-]\d{1,2}[/-]\d{1,2}$")
_POSITION: Final = {"latitude": "llh", "x-ecef": "xyz", "e-baseline": "enu"}
_COORDINATES: Final = {
    "llh": ("latitude(deg)", "longitude(deg)", "height(m)"),
    "xyz": ("x-ecef(m)", "y-ecef(m)", "z-ecef(m)"),
    "enu": ("e-baseline(m)", "n-baseline(m)", "u-baseline(m)"),
}
_ORDER: Final[dict[str, tuple[str, ...]]] = {
    # names of the standard deviations and covariances in the order in which RTKLIB writes them
    "llh": ("sdn", "sde", "sdu", "sdne", "sdeu", "sdun"),
    "xyz": ("sdx", "sdy", "sdz", "sdxy", "sdyz", "sdzx"),
    "enu": ("sde", "sdn", "sdu", "sden", "sdnu", "sdue"),
}
_TAIL: Final = ("Q", "ns")


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Columns of a .pos file.

    ``form`` is the kind of coordinates, ``dms`` says whether latitude and longitude are degrees, minutes
    and seconds (three fields each), ``calendar`` whether time is a date and a time (else week and
    second), ``scale`` the time scale, ``geodetic`` whether heights are above the geoid, ``names`` the
    columns behind the coordinates, and ``guesses`` what the header did not say.
    """

    form: Form
    dms: bool
    calendar: bool
    scale: Literal["gps", "utc", "jst"]
    geodetic: bool
    names: tuple[str, ...]
    guesses: tuple[str, ...] = ()

    @property
    def n_position(self) -> int:
        """Fields of the coordinates."""
        return 7 if self.dms else 3

    @property
    def n_fields(self) -> int:
        """Fields of a whole line."""
        return 2 + self.n_position + len(self.names)


def layout_from_header(header_lines: list[str], first_fields: list[str]) -> Layout:
    """Layout of a .pos file.

    Parameters
    ----------
    header_lines : lines that begin with ``%``, without it.
    first_fields : fields of the first data line; they tell the form of the time, which no header names.
    """
    calendar = _DATE.match(first_fields[0]) is not None
    text = "\n".join(header_lines)
    geodetic = re.search(r"=\s*\w+/(?!ellipsoidal)\w+", text) is not None
    for line in header_lines:
        bare = _bare_names(line)
        form = next((_POSITION[n] for n in bare if n in _POSITION), None)
        if form is None or "Q" not in bare:
            continue
        columns = bare[bare.index("Q") :]
        if len(columns) >= 8 and all(n.startswith("sd") for n in columns[2:8]):
            # RTKLIB prints "sdue" above the column "sdun" of degrees-minutes-seconds; its order is fixed.
            columns[2:8] = _ORDER[form]
        scale = {"UTC": "utc", "JST": "jst"}.get(bare[0], "gps")
        return Layout(
            form=form,  # type: ignore[arg-type]
            dms="d'" in line,
            calendar=calendar,
            scale=scale,  # type: ignore[arg-type]
            geodetic=geodetic,
            names=tuple(columns),
            guesses=() if bare[0] in ("GPST", "UTC", "JST") else ("times are taken as GPS time",),
        )
    return _guess(first_fields, calendar, geodetic)


def names_columns(line: str) -> bool:
    """Whether a header line without its ``%`` names the columns."""
    bare = _bare_names(line)
    return "Q" in bare and any(name in bare for name in _POSITION)


def _bare_names(line: str) -> list[str]:
    """Words of a header line without their units."""
    return [re.sub(r"\(.*", "", name) for name in SEPARATORS.split(line.strip()) if name]


def _guess(fields: list[str], calendar: bool, geodetic: bool) -> Layout:
    numbers = [_number(f) for f in fields[2:]]
    # RTKLIB writes 13 fields behind the time, 9 more with velocities, 4 more with degrees-minutes-seconds.
    dms = len(numbers) in (17, 26) and numbers[3] not in range(8) and numbers[7] in range(8)
    first = numbers[:3]
    radius = sum(n * n for n in first) ** 0.5
    form: Form
    if dms:
        form, words = "llh", "degrees, minutes and seconds"
    elif 6.3e6 < radius < 6.5e6:
        form, words = "xyz", "earth-centred coordinates"
    elif len(first) == 3 and abs(first[0]) <= 90 and abs(first[1]) <= 360:
        form, words = "llh", "latitude, longitude and ellipsoidal height"
    else:
        form, words = "enu", "an east-north-up baseline"
    count = len(numbers) - (7 if dms else 3)
    names = (*_TAIL, *_ORDER[form], "age", "ratio")[: max(count, 0)]
    extra = tuple(f"field_{i}" for i in range(len(names), max(count, 0)))
    guess = f"coordinates are taken as {words}"
    return Layout(
        form=form,
        dms=dms,
        calendar=calendar,
        scale="gps",
        geodetic=geodetic,
        names=names + extra,
        guesses=(guess, "times are taken as GPS time"),
    )


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


# ---------------------------------------------------------------- rtklib pos


FIX_OF_QUALITY: Final = {
    0: "none", 1: "fixed", 2: "float", 3: "sbas", 4: "dgnss", 5: "single", 6: "ppp", 7: "dead_reckoning",
}  # fmt: skip
"""RTKLIB's Q -> fix of table kind ``gnss_position``."""

_JST_S: Final = 9 * 3600
_REF_POS: Final = re.compile(r"^%\s*ref pos\s*:\s*(.*)$", re.MULTILINE)
_DATUM: Final = re.compile(r"lat/lon/height=\s*(\w+)/")
_MAX_LINES_SHOWN: Final = 20
_SAME_EPOCH_S: Final = 1e-3
_ON_LINE_DEG: Final = 5e-9
"""Five units of the last digit that RTKLIB writes, half a millimetre: waves and noise are larger."""
_NEARLY_ALL: Final = 0.9


def read_pos(files: Sequence[Path]) -> PositionLog:
    """Read one or several .pos files.

    Parameters
    ----------
    files : in the order of time; positions that two of them hold alike are kept once. Files of event marks
        beside their track (`event_marks`) are left out.

    Returns
    -------
    Positions with ``t_gps_s``, latitude, longitude, ellipsoidal height (NaN if the file has heights above
    a geoid) and covariance in the east-north-up axes of each position. Damaged lines are counted and
    their numbers kept in ``report.details``.

    Raises
    ------
    InputError : a file is missing, empty, no .pos file, or has no readable line; a baseline has no base; two
        files are solutions of the same time.
    """
    if not files:
        raise InputError("no .pos file given", expected="at least one file")
    report = IntegrityReport.of("positions", "RTKLIB .pos", files, time_scale="gps")
    report.synchronised = True
    tables = [_read_one(path, report) for path in files]
    marks = event_marks(files, tables)
    if len(marks) == len(files):  # nothing else was asked for
        marks = {}
    for path, n in marks.items():
        report.lose("event_marks", n)
        report.note(
            f"{path.name} holds {n} times of events (pulses of a camera), whose positions were interpolated "
            "between the epochs: left out of the track."
        )
    tracks = [path for path in files if path not in marks]
    tables = [table for path, table in zip(files, tables, strict=True) if path not in marks]
    if len(files) == 1 and _named_events(files[0]):
        report.note(
            "By its name these are times of events (pulses of a camera) with positions interpolated between "
            "the epochs of a solution: no track."
        )
    positions = pd.concat(tables, ignore_index=True)
    file = np.repeat(np.arange(len(tables)), [len(x) for x in tables])
    once = report.keep_once(positions, file, "positions")
    positions, file = positions[once].reset_index(drop=True), file[once]
    _refuse_two_solutions(positions["t_gps_s"], file, tracks)
    t = positions["t_gps_s"].to_numpy()
    report.take_times(t, "positions")
    report.count("positions", len(positions))
    if doubt := doubtful_date(t):
        report.note(doubt)
    for fix, n in positions["fix"].value_counts().items():
        report.count(f"fix_{fix}", int(n))
    return PositionLog(positions=positions, report=report)


def _refuse_two_solutions(t_gps_s: pd.Series, file: AnyArray, files: Sequence[Path]) -> None:
    """Raise InputError where two files hold other positions for most epochs of the shorter one."""
    # the first file of an epoch and of each that comes after it
    first = pd.Series(file).groupby(t_gps_s).transform("first").to_numpy()
    for k in np.unique(file[file != first]):
        for other in np.unique(first[(file == k) & (first != k)]):
            n = int(((file == k) & (first == other)).sum())
            if n > 0.5 * min((file == k).sum(), (file == other).sum()):
                raise InputError(
                    f"{n} epochs have other positions in {files[k].name} than in {files[other].name}",
                    expected="one solution of each time",
                    where=files[k],
                    cure="Give one of both: those with more fixed positions",
                )


def _read_one(path: Path, report: IntegrityReport) -> pd.DataFrame:
    cure = "Check that this is a solution of RTKLIB (not NMEA, not a statistics file)"
    require_file(path, "a RTKLIB .pos file")
    raw = path.read_bytes()
    report.bytes_read += len(raw)
    lines = raw.decode("ascii", errors="replace").splitlines()
    tables: list[pd.DataFrame] = []
    bad: list[int] = []
    scales: list[str] = []
    for heads, numbered in _sections(lines):
        layout: Layout | None = None
        rows: list[list[float]] = []
        first = 0
        for number, line in numbered:
            fields = [f for f in SEPARATORS.split(line.strip()) if f]
            if layout is None and len(fields) >= 5:
                layout = layout_from_header([h[1:] for h in heads], fields)
                _refuse_other_columns(heads, layout, path)
            row = _row(fields, layout) if layout is not None else None
            if row is None:
                bad.append(number)
                continue
            if not rows:
                first = number
                _note_resolution(fields[1], report)
            rows.append(row)
        if layout is not None and rows:
            _say_layout(layout, path, report)
            if (datum := _DATUM.search("\n".join(heads))) and datum[1].upper() not in ("WGS84", "WGS"):
                report.note(f"{path.name} states the datum {datum[1]}: its positions are taken as WGS 84.")
            scales.append(f"{layout.scale.upper()} from line {first} on")
            tables.append(
                _table(np.array(rows), layout, _base(heads, path) if layout.form == "enu" else None, report)
            )
    first_bad = f"line {bad[0]}: {lines[bad[0] - 1][:60]!r}" if bad else ""
    if not tables:
        raise InputError(
            f"none of {len(lines)} lines is a position ({first_bad or 'only a header'})",
            expected="lines of time, three coordinates, Q, ns, standard deviations, age, ratio",
            where=path,
            cure=_cure_of_line(lines[bad[0] - 1]) or cure if bad else cure,
        )
    if bad:
        report.lose("damaged_lines", len(bad))
        shown = ", ".join(map(str, bad[:_MAX_LINES_SHOWN])) + (" ..." if len(bad) > _MAX_LINES_SHOWN else "")
        report.details.setdefault("damaged_lines", {})[str(path)] = shown
        report.note(f"{len(bad)} damaged lines of {path.name} are left out, the first is {first_bad}.")
    if len({scale.split()[0] for scale in scales}) > 1:
        report.note(
            f"{path.name} is joined of solutions in several time scales ({', '.join(scales)}): each is read "
            "in its own."
        )
    return pd.concat(tables, ignore_index=True)


def _refuse_other_columns(heads: list[str], layout: Layout, path: Path) -> None:
    """Raise InputError where the names of the coordinates state another order or unit than RTKLIB's."""
    expected = _COORDINATES[layout.form]
    for line in filter(names_columns, (head[1:] for head in heads)):
        words = [name for name in SEPARATORS.split(line.strip()) if name]
        stated = [name.lower().replace("d'\"", "deg") for name in words[: _bare_names(line).index("Q")][-3:]]
        if any(
            name not in (usual, usual.partition("(")[0])
            for name, usual in zip(stated, expected, strict=False)
        ):
            raise InputError(
                f"columns {' '.join(stated)}",
                expected=" ".join(expected),
                where=path,
                cure="Write them as RTKLIB does, or name the columns of a table of positions with times",
            )


def _sections(lines: list[str]) -> Iterator[tuple[list[str], list[tuple[int, str]]]]:
    """Header lines and numbered lines of data of each solution of a file: joined ones have a header each.

    Remarks between lines of data open no solution, only a line that names the columns does.
    """
    heads: list[str] = []
    rows: list[tuple[int, str]] = []
    remarks: list[str] = []
    for number, line in enumerate(lines, start=1):
        if line.startswith("%"):
            remarks.append(line)
        elif line.strip():
            if rows and any(names_columns(remark[1:]) for remark in remarks):
                yield heads, rows
                heads, rows = [], []
            heads += remarks
            remarks = []
            rows.append((number, line))
    yield heads + remarks, rows


def _say_layout(layout: Layout, path: Path, report: IntegrityReport) -> None:
    for guess in layout.guesses:
        report.note(f"{path.name} has no column header: {guess}.")
    if layout.geodetic:
        report.note(
            f"{path.name} gives heights above a geoid, not the ellipsoid: h_ell_m is left empty. Solve again "
            "with out-height=ellipsoidal."
        )
    if layout.scale != "gps":
        report.time_scale = "utc"
    variant = f"{layout.form}{' d:m:s' if layout.dms else ''}, {layout.scale} time"
    told = report.details.get("variant", "")
    if variant not in told.split("; "):
        report.details["variant"] = f"{told}; {variant}" if told else variant


def event_marks(files: Sequence[Path], tables: Sequence[pd.DataFrame]) -> dict[Path, int]:
    """Those files of positions that hold times of events on the track of another one, and how many.

    RTKLIB (demo5) writes ``NAME_events.pos`` beside ``NAME.pos``: at each pulse of a camera the straight line
    between the neighbouring epochs. Told by its name, or by positions on these lines that no track keeps to.

    Parameters
    ----------
    files : with the positions of each in ``tables``, of kind ``gnss_position``.
    """
    pairs = list(zip(files, tables, strict=True))
    tracks = [table for path, table in pairs if not _named_events(path)]
    return {
        path: len(table)
        for path, table in pairs
        if _named_events(path) or any(_lies_on(table, track) for track in tracks if track is not table)
    }


def _named_events(path: Path) -> bool:
    return path.stem.lower().endswith("_events")


def _lies_on(marks: pd.DataFrame, track: pd.DataFrame) -> bool:
    """Whether positions lie between the epochs of a track, on the straight lines between them."""
    t, epochs = marks["t_gps_s"].to_numpy(), track["t_gps_s"].to_numpy()
    if (
        len(epochs) < 2
        or np.any(np.diff(epochs) <= 0)
        or not (epochs[0] <= t.min() and t.max() <= epochs[-1])
    ):
        return False
    after = np.clip(np.searchsorted(epochs, t), 1, len(epochs) - 1)
    apart_s = np.minimum(epochs[after] - t, t - epochs[after - 1])
    between = np.abs(apart_s) > _SAME_EPOCH_S
    off_deg = [
        np.abs(np.interp(t, epochs, track[name]) - marks[name]).to_numpy() for name in ("lat_deg", "lon_deg")
    ]
    on_line = between & (np.maximum(*off_deg) < _ON_LINE_DEG)
    return bool(between.mean() > _NEARLY_ALL and on_line.sum() > _NEARLY_ALL * between.sum())


def _note_resolution(text: str, report: IntegrityReport) -> None:
    """The unit of the stamps of a file, from the decimals of its first; the coarsest of all files counts."""
    unit_s = 10.0 ** -len(text.partition(".")[2])
    report.timing.resolution_s = max(unit_s, report.timing.resolution_s or 0.0)


def _cure_of_line(line: str) -> str:
    """What to do about a line that is nearly a position; empty where nothing is known."""
    words = line.split()
    if sum(re.fullmatch(r"-?\d+,\d+", word) is not None for word in words) >= 3:
        return "Its numbers have decimal commas: write points, as RTKLIB does (sed 's/,/./g')"
    if len(words) >= 5 and re.fullmatch(r"\d{5,6}(\.\d*)?|\d{1,4}\.\d*", words[0]):  # a week has four digits
        return "It begins with seconds of a week without their week: solve with out-timeform=tow or hms"
    return ""


def _row(fields: list[str], layout: Layout) -> list[float] | None:
    """Numbers of a line: second of its scale since 1970, leap second 0/1, coordinates, other columns."""
    if len(fields) != layout.n_fields:
        return None
    try:
        numbers = [float(x) for x in fields[2:]]
        if layout.calendar:
            days = dt.date(*map(int, re.split("[/-]", fields[0]))).toordinal() - _UNIX_ORDINAL
            hours, minutes, seconds = fields[1].split(":")
            hour, minute, second = int(hours), int(minutes), float(seconds)
            if not (0 <= hour < 24 and 0 <= minute < 60 and 0 <= second < 61):
                return None
            # 23:59:60 belongs to the day before; Unix time cannot say it, so it is carried apart.
            leap = float(second >= 60)
            time, fraction = float(days * DAY_S + hour * 3600 + minute * 60), second - leap
        else:
            week, fraction, leap = int(fields[0]), float(fields[1]), 0.0
            if not (0 <= fraction < WEEK_S + 1):
                return None
            time = float(GPS_EPOCH_UNIX_S + week * WEEK_S)
        if not FIRST_UNIX_S <= time + fraction <= LAST_UNIX_S:
            return None
        position, rest = numbers[:3], numbers[3:]
        if layout.dms:
            position = [_degrees(fields[2:5]), _degrees(fields[5:8]), numbers[6]]
            rest = numbers[7:]
    except (TypeError, ValueError):
        return None
    quality = rest[layout.names.index("Q")] if "Q" in layout.names else 0.0
    if not np.all(np.isfinite(position)) or quality not in FIX_OF_QUALITY:
        return None
    if layout.form == "llh" and not (abs(position[0]) <= 90 and abs(position[1]) <= 360):
        return None
    return [time, fraction, leap, *position, *rest]


def _degrees(fields: list[str]) -> float:
    """Degrees from degrees, minutes, seconds; the sign may stand before a zero."""
    degrees, minutes, seconds = (float(x) for x in fields)
    if not (0 <= minutes < 60 and 0 <= seconds <= 60):
        raise ValueError(fields)
    size = abs(degrees) + minutes / 60 + seconds / 3600
    return -size if fields[0].startswith("-") else size


def _base(heads: Sequence[str], path: Path) -> ArrayF:
    """Earth-centred position (3,) of the base of a baseline, as the header states (``ref pos``)."""
    found = _REF_POS.search("\n".join(heads))
    text = found[1].strip() if found else ""
    fields = [f for f in SEPARATORS.split(text) if f]
    try:
        numbers = [float(f) for f in fields]
        if len(numbers) == 7:
            numbers = [_degrees(fields[:3]), _degrees(fields[3:6]), numbers[6]]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not np.any(numbers):
        raise InputError(
            f"a baseline east, north, up without the position of its base (ref pos {text!r})",
            expected="a header line '% ref pos : ...'",
            where=path,
            cure="Solve with out-solformat=llh or xyz",
        )
    return np.array(numbers) if np.linalg.norm(numbers) > 6e6 else ecef_of(*numbers)


def _table(rows: ArrayF, layout: Layout, base: ArrayF | None, report: IntegrityReport) -> pd.DataFrame:
    time, fraction, leap, position = rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3:6]
    values = dict(zip(layout.names, rows[:, 6:].T, strict=True))
    if layout.scale == "gps":
        t = time - (GPS_EPOCH_UNIX_S + ADJUSTED_OFFSET_S) + fraction + leap
    else:
        zone = _JST_S if layout.scale == "jst" else 0.0
        # The whole second decides on the leap second; the fraction is added where digits are still fine.
        whole = np.floor(fraction)
        t = gps_from_unix(time - zone + whole) + (fraction - whole) + leap
    n = len(rows)
    covariance = _covariance(values, layout, n)
    if not covariance.any():
        report.note("All standard deviations are 0: taken as unknown.")
        covariance[:] = np.nan
    height = position[:, 2]
    if layout.form == "llh":
        lat, lon = position[:, 0], position[:, 1]
        if layout.geodetic:
            height = np.full(n, np.nan)
    else:
        if base is None:
            xyz = position
        else:
            R_base = rotation_ecef_enu(*geodetic_of(base)[:2])
            xyz = position @ R_base.T + base
            covariance = R_base @ covariance @ R_base.T
        lat, lon, height = geodetic_of(xyz)
        R = rotation_ecef_enu(lat, lon)
        covariance = np.swapaxes(R, 1, 2) @ covariance @ R
    sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
    return frame_of(
        GNSS_POSITION,
        {
            "t_gps_s": t,
            "lat_deg": lat,
            "lon_deg": half_turn(lon),
            "h_ell_m": height,
            "fix": [FIX_OF_QUALITY[int(q)] for q in values.get("Q", np.zeros(n))],
            "n_sats": values.get("ns", -1),
            "sigma_east_m": sigma[:, 0],
            "sigma_north_m": sigma[:, 1],
            "sigma_up_m": sigma[:, 2],
            "cov_en_m2": covariance[:, 0, 1],
            "cov_eu_m2": covariance[:, 0, 2],
            "cov_nu_m2": covariance[:, 1, 2],
            "age_s": values.get("age", np.nan),
            "ratio": values.get("ratio", np.nan),
        },
    )


def _covariance(values: Mapping[str, ArrayF], layout: Layout, n: int) -> ArrayF:
    """(n, 3, 3) in the file's own axes: east-north-up or earth-centred; NaN where not stated."""
    axes = {"e": 0, "n": 1, "u": 2} if layout.form != "xyz" else {"x": 0, "y": 1, "z": 2}
    covariance = np.full((n, 3, 3), np.nan)
    for name in _ORDER[layout.form]:
        if name in values:
            i, j = axes[name[2]], axes[name[-1]]
            covariance[:, i, j] = covariance[:, j, i] = values[name] * np.abs(values[name])
    return covariance


_UNIX_ORDINAL: Final = dt.date(1970, 1, 1).toordinal()
