"""Units of length as files state them, by word, letter or code: one table for all readers.

What a file states decides. What it does not state is taken as metres, and the note says so; a unit that is
stated and not known is refused by the caller, never passed over.

Codes and factors are those of the EPSG database, as PROJ ships it. The US survey foot is 1200/3937 m, the
international foot 0.3048 m: they differ by 2 ppm, 11 m in a northing of 5,600 km.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final

from pyproj import CRS
from pyproj.database import get_units_map


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of length: its name in the singular as a note prints it, and how many metres it has."""

    name: str
    metres: float

    @property
    def is_metre(self) -> bool:
        """True if nothing is to be converted."""
        return abs(self.metres - 1.0) < 1e-12

    @property
    def plural(self) -> str:
        """Its name as a sentence has it, such as ``US survey feet``."""
        return self.name.replace("foot", "feet") if "foot" in self.name else f"{self.name}s"


METRE: Final = Unit("metre", 1.0)
FOOT: Final = Unit("foot", 0.3048)
US_SURVEY_FOOT: Final = Unit("US survey foot", 1200 / 3937)
FATHOM: Final = Unit("fathom", 1.8288)
_WORDS: Final[Mapping[Unit, str]] = {
    METRE: "m metre metres meter meters mtr mtrs",
    Unit("decimetre", 0.1): "dm decimetre decimetres decimeter decimeters dezimeter",
    Unit("centimetre", 0.01): "cm centimetre centimetres centimeter centimeters zentimeter",
    Unit("millimetre", 0.001): "mm millimetre millimetres millimeter millimeters",
    Unit("kilometre", 1000.0): "km kilometre kilometres kilometer kilometers",
    FOOT: "ft foot feet ' ′ ft_int ft_intl feet_int ift int_ft international_foot international_feet intl_ft "
    "fuß fuss pies pieds",
    US_SURVEY_FOOT: "ft_us ftus us_ft usft us_foot us_feet foot_us feet_us survey_foot survey_feet "
    "us_survey_foot us_survey_feet us_survey_ft survey_ft usfoot usfeet sft ussft ft_survey feet_survey "
    "u_s_ft u_s_feet u_s_survey_foot u_s_survey_feet u_s_survey_ft",
    FATHOM: "ftm fathom fathoms fth fm",
    Unit("inch", 0.0254): "in inch inches",
    Unit("yard", 0.9144): "yd yds yard yards",
}
_OF_WORD: Final = {word: unit for unit, words in _WORDS.items() for word in words.split()}
SPOKEN: Final = frozenset(_OF_WORD) - {*_WORDS[METRE].split(), "in", "fm", "'", "′"}
"""Words of units other than metres that mean nothing else in a sentence or a name."""
_SPOKEN_FIRST: Final = "|".join(sorted((w.replace("_", r"[ _.]*") for w in SPOKEN), key=len, reverse=True))
_STATED: Final = re.compile(
    rf"(?i)(?:\b(?:units?|einheit(?:en)?)\b[^.;]{{0,20}}?|\bin |[\[(]\s*)\b({_SPOKEN_FIRST})\b"
)
_OF_VALUES: Final = re.compile(
    r"(?i)\b(?:units?|values?|numbers|coordinates|positions?|depths?|heights?|elevations?|[xyz]|d[est]m|"
    r"einheit(?:en)?|werte?|tiefen?|höhen?|koordinaten)\b"
)
_OF_OTHERS: Final = re.compile(
    r"(?i)antenna|instrument|sensor|accuracy|precision|sigma|error|cell|resolution|spacing|dra(?:ugh|f)t|offset"
)
_LETTERS: Final = {"M": METRE, "f": FOOT, "F": FATHOM}


def unit_of_word(text: str) -> Unit | None:
    """The unit that a word or short phrase names, in any case, such as ``ft``, ``US survey feet``, ``[m]``.

    Examples
    --------
    >>> unit_of_word("(US ft)").metres == 1200 / 3937
    True
    >>> unit_of_word("degrees") is None
    True
    """
    bare = re.sub(r"[^a-z0-9'′ß]+", "_", text.strip().lower()).strip("_")
    return _OF_WORD.get(bare)


def unit_in_words(text: str) -> Unit | None:
    """The unit other than metres in which a sentence says that coordinates, depths or heights are.

    Examples
    --------
    >>> unit_in_words("Depth units: Feet").name, unit_in_words("# z in US survey feet").name
    ('foot', 'US survey foot')
    >>> unit_in_words("antenna height [mm]: 1200") is None
    True
    >>> unit_in_words("DepthUnits=ft").name, unit_in_words("VERTICAL_UNITS;Feet").name
    ('foot', 'foot')
    """
    text = re.sub(r"(?<=[a-z])(?=[A-Z])|_", " ", re.sub(r"[;|\t](?=\S)", ": ", text))
    found = None if _OF_OTHERS.search(text) or not _OF_VALUES.search(text) else _STATED.search(text)
    return None if found is None else unit_of_word(found[1])


def unit_of_letter(letter: str) -> Unit | None:
    """The unit of a letter of NMEA 0183: M metres, f feet, F fathoms; case matters."""
    return _LETTERS.get(letter.strip())


@cache
def unit_of_code(epsg: int) -> Unit | None:
    """The unit of an EPSG code of lengths, as GeoKeys 3076 and 4099 state it; None for another code."""
    found = next(
        (u for u in get_units_map(auth_name="EPSG", category="linear").values() if int(u.code) == epsg), None
    )
    return None if found is None else _named(found.name, float(found.conv_factor))


def units_of_crs(crs: CRS) -> tuple[Unit | None, Unit | None]:
    """Units of the horizontal and of the vertical axes of a CRS, also of one put together from both.

    Returns
    -------
    horizontal : None for degrees, or without such an axis.
    vertical : None without a vertical axis.
    """
    across: Unit | None = None
    up: Unit | None = None
    for part in crs.sub_crs_list or [crs]:
        for axis in part.axis_info:
            if axis.direction.lower() in ("up", "down"):
                up = _named(axis.unit_name, axis.unit_conversion_factor)
            elif not part.is_geographic:
                across = _named(axis.unit_name, axis.unit_conversion_factor)
    return across, up


def _named(name: str, metres: float) -> Unit:
    """Our unit of this length, so that notes call it by one name; rounded factors (0.304800609601219) too."""
    ours = next((u for u in _WORDS if abs(u.metres / metres - 1.0) < 1e-9), None)
    return ours or Unit(name, metres)
