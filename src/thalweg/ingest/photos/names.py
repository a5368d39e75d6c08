"""Times in the names of photographs: the usual patterns, and a pattern of the user."""

import re
from typing import Final

from thalweg.core.errors import InputError
from thalweg.ingest.photos.exif import CivilStamp, civil_second
from thalweg.ingest.stamps import possible_unix

_TOKENS: Final = {
    "%Y": r"(?P<Y>\d{4})",
    "%m": r"(?P<m>\d\d)",
    "%d": r"(?P<d>\d\d)",
    "%H": r"(?P<H>\d\d)",
    "%M": r"(?P<M>\d\d)",
    "%S": r"(?P<S>\d\d)",
    "%f": r"(?P<f>\d{1,9})",
    "%s": r"(?P<s>\d{9,10})",
    "%%": "%",
    "*": r".*?",
}

_USUAL: Final = (
    # R20210512_083107123, IMG_20210512_083107_123, 2021-05-12T08-31-07.123, PXL_20210512_083107123
    re.compile(
        r"(?<!\d)(?P<Y>(?:19|20)\d\d)[-_.:]?(?P<m>[01]\d)[-_.:]?(?P<d>[0-3]\d)[-_.T ]{0,3}"
        r"(?P<H>[0-2]\d)[-_.:h]?(?P<M>[0-5]\d)[-_.:m]?(?P<S>[0-5]\d)(?:[-_., s]?(?P<f>\d{6}|\d{3}))?(?!\d)"
    ),
    # Unix time in ms or us, 1620808267123, and in seconds with a fraction, 1620808267.123
    re.compile(r"(?<!\d)(?P<s>1\d{9})[._]?(?P<f>\d{6}|\d{3})(?!\d)"),
)


def stamp_from_name(stem: str, pattern: str | None = None) -> CivilStamp | None:
    """Time in the name of a file without its ending; None if there is none.

    The usual names are year to second with or without separators, with three or six digits behind the second
    or none, and Unix time in ms or us.

    Parameters
    ----------
    stem : name without folder and ending.
    pattern : the user's own, see `compile_pattern`.

    Examples
    --------
    >>> stamp_from_name("R20210512_083107125").shown_s
    1620808267.125
    >>> stamp_from_name("1620808267125").resolution_s
    0.001
    >>> stamp_from_name("boat 12.05.2021 083107", "*%d.%m.%Y %H%M%S").shown_s
    1620808267.0
    """
    for form in [compile_pattern(pattern)] if pattern else _USUAL:
        found = form.fullmatch(stem) if pattern else form.search(stem)
        if not found:
            continue
        parts = found.groupdict()
        digits = parts.get("f") or ""
        if parts.get("s"):
            second: int | None = int(parts["s"])
        else:
            second = civil_second(*(int(parts.get(name) or 0) for name in "YmdHMS"))
        if second is None or not possible_unix(second):
            continue
        fraction = int(digits) / 10 ** len(digits) if digits else 0.0
        return CivilStamp(second_s=second, fraction_s=fraction, resolution_s=10.0 ** -len(digits))
    return None


def compile_pattern(pattern: str) -> re.Pattern[str]:
    """The user's pattern for names without ending: %Y %m %d %H %M %S, %f (fraction), %s (Unix), * (any).

    Raises
    ------
    InputError : the pattern holds no full time, an unknown token or a token twice.
    """
    text, expression, seen = pattern, "", set()
    while text:
        head = text[:2] if text[0] == "%" else text[0]
        if head[0] == "%" and head not in _TOKENS:
            raise InputError(
                f"the pattern '{pattern}' holds '{head}'", expected="%Y %m %d %H %M %S %f %s, * or plain text"
            )
        if head in seen:
            raise InputError(f"the pattern '{pattern}' holds '{head}' twice", expected="each part once")
        if len(head) == 2 and head != "%%":
            seen.add(head)
        expression += _TOKENS.get(head, re.escape(head))
        text = text[len(head) :]
    if not ({"%Y", "%m", "%d", "%H", "%M", "%S"} <= seen or "%s" in seen):
        raise InputError(
            f"the pattern '{pattern}' holds no full time",
            expected="%Y %m %d %H %M %S, or %s",
            cure="A name without date cannot be placed: give a table of times instead",
        )
    return re.compile(expression)
