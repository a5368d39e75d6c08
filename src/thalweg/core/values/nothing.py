"""Numbers and words that stand for no value: one list a quantity, for all readers.

A number counts as nothing only where it is met exactly: no depth is refused for being near to 999. What a
file declares as nothing (nodata of a raster, a setting) comes on top of the list.
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import ArrayB

_TEXTS: Final = (
    "|-|--|---|----|n/a|#n/a|na|nan|-nan|null|none|nil|void|nodata|no data|no_data|missing|invalid|?|*|**|***"
    "|****|inf|-inf|+inf|1.#qnan|-1.#ind|1.#inf|#null!|#value!|#div/0!|\\n"
)
WORDS: Final = frozenset(_TEXTS.split("|"))
"""Texts of a cell without a value, small letters."""
_ANY: Final = (-9999.0, -99999.0, -999999.0, -32768.0, -32767.0, -9999.99, -9999.9, -777.0)
HUGE: Final = 1e9
"""No length, angle or depth of a survey: 1.70141e38 (Surfer), 3.4028e38 (float32) and their like."""
NOTHING: Final[Mapping[str, tuple[float, ...]]] = {
    "depth": (
        *_ANY,
        0.0,
        999.0,
        999.9,
        999.99,
        9999.0,
        9999.9,
        99999.0,
        -999.0,
        -99.0,
        -1.0,
        32767.0,
        65535.0,
    ),
    "height": (*_ANY, 9999.0, 9999.9, 99999.0, -999.0, -999.9, -10_000.0, 32767.0),
    "position": (*_ANY, 99999.0, 999999.0, 9999999.0),
    "sigma": (*_ANY, -1.0, 999.0, 9999.0, 99999.0),
    "time": (0.0, -1.0, *_ANY),
    "other": _ANY,
}
"""Values of a quantity, in the unit of the file, that instruments and programs write where they have none."""


_REPEATED, _FEWEST_OTHERS, _DISTINCT, _APART = 3, 20, 5, 10.0
"""Of a number that stands for none: how often it is met at least, how many others, and different ones, there
are, and its distance from them in spans of theirs."""


def is_nothing(
    values: ArrayLike, quantity: str, extra: Sequence[float] = (), keep: Sequence[float] = ()
) -> ArrayB:
    """Which numbers (any shape) stand for no value: those of the list, NaN and infinities.

    Parameters
    ----------
    values : in the unit of the file, before any conversion.
    quantity : a key of `NOTHING`.
    extra : more values without a meaning, as a file or a person states them.
    keep : values of the list that are meant, as a person states them.
    """
    x = np.asarray(values, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        out = ~np.isfinite(x) | (np.abs(x) >= HUGE)
    for value in {*NOTHING[quantity], *extra} - set(keep):
        out |= np.isclose(x, value, rtol=1e-7, atol=0.0)  # single precision rounds what it stores
    return np.asarray(out)


def far_repeated(values: ArrayLike) -> tuple[float, ...]:
    """The lowest, the highest number or both, where each repeats exactly and far away from all others.

    So programs write that there is no value: -99, 0 among heights of 97 m, 65.535, whatever number they take.

    Parameters
    ----------
    values : depths or heights of any shape; NaN are left out.

    Examples
    --------
    >>> depth_m = [2.0 + 0.01 * k for k in range(30)]
    >>> far_repeated([*depth_m, 65.535, 65.535, 65.535])
    (65.535,)
    >>> far_repeated([*depth_m, 65.535])
    ()
    """
    x = np.asarray(values, dtype=np.float64).ravel()
    x = x[np.isfinite(x)]
    if x.size <= _FEWEST_OTHERS:
        return ()
    low, high = float(x.min()), float(x.max())
    for ends in ((low,), (high,), (low, high)):
        others = x[~np.isin(x, ends)]
        if others.size < _FEWEST_OTHERS or len(np.unique(others[:1000])) < _DISTINCT:
            continue
        least, most = float(others.min()), float(others.max())
        if all(
            np.count_nonzero(x == end) >= _REPEATED
            and max(least - end, end - most) > _APART * (most - least)
            and (abs(end) > 2 * max(-least, most) or end <= 0 < least or most < 0 <= end)
            for end in ends
        ):
            return ends
    return ()
