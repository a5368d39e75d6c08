"""What a display's text means in seconds, and which readings of a series cannot be."""

from typing import Final

import numpy as np

from thalweg.core.types import ArrayB, ArrayF

_UNITS: Final = {"H": 3600.0, "M": 60.0, "S": 1.0}
_LIMITS: Final = {"H": 24, "M": 60}
_AROUND: Final = 12
"""Readings before and behind that are asked."""
_LEAST: Final = 5
_FAR: Final = 10.0
"""Scatters from the neighbours beyond which a reading is impossible: clocks do have late moments."""
_DOUBT: Final = 3.0
_LEAST_S: Final = 0.05
_NMAD: Final = 1.4826


def seconds_of(text: str, pattern: str) -> float | None:
    """Seconds of the day (or of what the display counts) of a text; None if it is no time.

    Examples
    --------
    >>> seconds_of("08:31:07.42", "HH:MM:SS.ff")
    30667.42
    >>> seconds_of("08:71:07.42", "HH:MM:SS.ff") is None
    True
    """
    parts = {mark: "".join(c for c, m in zip(text, pattern, strict=True) if m == mark) for mark in "HMSf"}
    if not all(part.isdecimal() for part in parts.values() if part):
        return None
    seconds = 0.0
    for mark, unit in _UNITS.items():
        value = int(parts[mark] or 0)
        limit = _LIMITS.get(mark, 60 if "M" in pattern else 10**9)
        if value >= limit:
            return None
        seconds += unit * value
    digits = parts["f"]
    return seconds + (int(digits) / 10 ** len(digits) if digits else 0.0)


def out_of_sequence(
    t_s: ArrayF, other_s: ArrayF | None = None, *, day_s: float = 86_400.0
) -> tuple[ArrayF, ArrayB, ArrayB]:
    """Readings counted on over the end of the day, which of them cannot be, and which are in doubt.

    A reading is compared with those before it, and with those behind it: one of both is enough, so that a
    series may jump where photographs are missing.

    Parameters
    ----------
    t_s : (n,) readings in the order of the photographs, NaN where there is none.
    other_s : (n,) what they would be with the second best digit, NaN if that is out of the question.
    day_s : period of the display.

    Returns
    -------
    t_s : (n,) with whole periods added.
    wrong : (n,) readings that cannot be.
    doubtful : (n,) readings away from their neighbours where the second best digit would not be.
    """
    t = np.array(t_s, dtype=np.float64)
    known = np.flatnonzero(np.isfinite(t))
    wrong, doubtful = np.zeros(len(t), dtype=bool), np.zeros(len(t), dtype=bool)
    if known.size < _LEAST:
        return t, wrong, doubtful
    t[known] += day_s * np.concatenate([[0], np.cumsum(_turns(np.diff(t[known]), day_s))])
    x, y = known.astype(np.float64), t[known]
    interval = float(np.median(np.diff(y) / np.diff(x)))
    off = y - interval * x
    before, behind = _medians(off)
    away = np.fmin(np.abs(off - before), np.abs(off - behind))
    scatter = _NMAD * float(np.nanmedian(away))
    wrong[known] = away > max(_FAR * scatter, _LEAST_S)
    if other_s is not None:
        shift = (other_s - t_s)[known]
        there = np.fmin(np.abs(off + shift - before), np.abs(off + shift - behind))
        doubtful[known] = (away > _DOUBT * scatter) & (there < away / 2)
    return t, wrong, doubtful & ~wrong


def _turns(step: ArrayF, day_s: float) -> ArrayF:
    """Whole periods between readings: 1 where the display began again; a single misread hour takes none."""
    return np.where(step < -day_s / 2, 1.0, np.where(step > day_s / 2, -1.0, 0.0))


def _medians(off: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Median of up to 12 values before, and behind, each (n,); NaN with fewer than three."""
    n = len(off)
    padded = np.concatenate([np.full(_AROUND, np.nan), off, np.full(_AROUND, np.nan)])
    windows = np.lib.stride_tricks.sliding_window_view(padded, _AROUND)
    enough = 3
    out = []
    for part in (windows[:n], windows[_AROUND + 1 : _AROUND + 1 + n]):
        known = np.isfinite(part).sum(axis=1) >= enough
        value = np.full(n, np.nan)
        value[known] = np.nanmedian(part[known], axis=1)
        out.append(value)
    return out[0], out[1]
