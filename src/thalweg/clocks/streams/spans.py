"""Two logs that share no time: how far apart they are, and whether whole hours would bring them together."""

from typing import Final

from thalweg.core.timescales import utc_text_from_gps
from thalweg.ingest.clock_shift import hours_text

_HOUR_S: Final = 3600.0
_SHARED: Final = 0.5
"""Share of the shorter log that must overlap after a shift by whole hours, for the shift to be named."""


def span_text(first_s: float, last_s: float) -> str:
    """A span of GPS time as UTC text."""
    return f"{utc_text_from_gps(first_s)} .. {utc_text_from_gps(last_s)}"


def apart_words(span_s: tuple[float, float], other_s: tuple[float, float]) -> str:
    """How a log has to be shifted to overlap with another one, in words; empty if they overlap.

    A lidar stamps within the hour, and clocks are set to the wrong zone: a shift by whole hours is no chance.

    Parameters
    ----------
    span_s, other_s : first and last GPS time of the log and of the other one.

    Examples
    --------
    >>> apart_words((3600.0, 3720.0), (5.0, 140.0))
    'shifted by -1:00 h it would overlap: its hour or its time zone is wrong'
    >>> apart_words((0.0, 100.0), (700.0, 900.0))
    'it ends 600 s before the other begins'
    >>> apart_words((0.0, 100.0), (90.0, 900.0))
    ''
    """
    if min(span_s[1], other_s[1]) > max(span_s[0], other_s[0]):
        return ""
    hours = round((sum(other_s) - sum(span_s)) / 2 / _HOUR_S)
    shift = hours * _HOUR_S
    shared = min(span_s[1] + shift, other_s[1]) - max(span_s[0] + shift, other_s[0])
    shorter = min(span_s[1] - span_s[0], other_s[1] - other_s[0])
    if hours and shared >= _SHARED * shorter and shared > 0:
        wrong = "its hour or its time zone" if hours % 24 else "its date"
        return f"shifted by {hours_text(shift)} h it would overlap: {wrong} is wrong"
    if span_s[1] <= other_s[0]:
        return f"it ends {other_s[0] - span_s[1]:.0f} s before the other begins"
    return f"it begins {span_s[0] - other_s[1]:.0f} s after the other ends"
