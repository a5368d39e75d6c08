"""Which columns a RTKLIB .pos file has: read from its header, or guessed from its first line."""

import re
from dataclasses import dataclass
from typing import Final, Literal

SEPARATORS: Final = re.compile(r"[\s,;|]+")
Form = Literal["llh", "xyz", "enu"]

_DATE: Final = re.compile(r"\d{4}[/-]\d{1,2}[/-]\d{1,2}$")
_POSITION: Final = {"latitude": "llh", "x-ecef": "xyz", "e-baseline": "enu"}
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
    geodetic = re.search(r"=\s*\w+/geodetic", text) is not None
    for line in header_lines:
        names = [n for n in SEPARATORS.split(line.strip()) if n]
        bare = [re.sub(r"\(.*", "", n) for n in names]
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


def _guess(fields: list[str], calendar: bool, geodetic: bool) -> Layout:
    numbers = [_number(f) for f in fields[2:]]
    # RTKLIB writes 13 fields behind the time, 9 more with velocities, 4 more with degrees-minutes-seconds.
    dms = len(numbers) in (17, 26) and not _is_quality(numbers, 3) and _is_quality(numbers, 7)
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


def covariance_names(form: Form) -> tuple[str, ...]:
    """Names of the three standard deviations and three signed roots of covariances, in RTKLIB's order."""
    return _ORDER[form]


def _is_quality(numbers: list[float], index: int) -> bool:
    return index < len(numbers) and numbers[index] in range(8)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
