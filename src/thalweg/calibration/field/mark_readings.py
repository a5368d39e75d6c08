"""Other readings of the marks of a picture that fits no pose: in reverse order, or of a mirrored picture."""

from collections.abc import Callable
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.errors import ThalwegError

FITS: Final = 4.0
"""Sigma of unit weight below which a reading explains the marks."""

_BETTER: Final = 0.2


def reading_that_fits(
    marks: pd.DataFrame, size_px: tuple[int, int], sigma0_of: Callable[[pd.DataFrame], float], sigma0: float
) -> str:
    """Which other reading fits a pose, as a sentence without its full stop; "" if none does.

    Parameters
    ----------
    marks : marker, corner, x_px, y_px, sigma_px of one picture.
    size_px : width and height of the picture.
    sigma0_of : sigma of unit weight of marks, infinite if many do not fit; may refuse.
    sigma0 : of the marks as they are, infinite if they fit no pose at all.
    """
    width, height = size_px
    xy = marks[["x_px", "y_px"]].to_numpy(np.float64)
    readings = {
        "in reverse order": xy[::-1],
        "if the picture is mirrored left to right": xy * [-1.0, 1.0] + [width, 0.0],
        "if the picture is mirrored top to bottom": xy * [1.0, -1.0] + [0.0, height],
    }
    found: dict[str, float] = {}
    for words, moved in readings.items():
        try:
            found[words] = sigma0_of(marks.assign(x_px=moved[:, 0], y_px=moved[:, 1]))
        except (ThalwegError, np.linalg.LinAlgError):
            continue
    limit = min(FITS, _BETTER * sigma0)
    # a symmetric panel read backwards looks as in a mirror: then both are named
    fitting = [words for words, value in found.items() if value < limit]
    if not fitting:
        return ""
    return f"The marks fit {', and '.join(fitting)}: check their numbers, and use the files as stored"
