"""Lever arms in another unit than metres: no sensor of a survey boat sits 20 m from its INS."""

from collections.abc import Sequence
from typing import Final

MAX_LEVER_M: Final = 20.0
"""Components of a lever arm in a calibration; a longer one is in millimetres or centimetres."""


def lever_doubt(lever_m: Sequence[float]) -> tuple[str, str, str] | None:
    """Found, expected and cure if a lever arm is too long to be in metres, else None.

    Parameters
    ----------
    lever_m : its components as they stand in a file that has metres.

    Examples
    --------
    >>> lever_doubt([-0.351, 0.002, -0.249])
    >>> found, _, cure = lever_doubt([-351.0, 2.0, -249.0])
    >>> found
    'a lever arm of (-351, 2, -249) m'
    >>> cure
    'Are these millimetres? Then write (-0.351, 0.002, -0.249), and the sigmas in metres, too'
    """
    longest = max((abs(value) for value in lever_m), default=0.0)
    if longest <= MAX_LEVER_M:
        return None
    as_mm, as_cm = (_listed([value / factor for value in lever_m]) for factor in (1000.0, 100.0))
    # Nobody mounts a sensor 35 mm away by the decimetre: below a metre centimetres are as likely.
    units = f"millimetres? Then write {as_mm}, or {as_cm} if centimetres" if longest < 100 else ""
    return (
        f"a lever arm of {_listed(lever_m)} m",
        f"components up to {MAX_LEVER_M:g} m",
        f"Are these {units or f'millimetres? Then write {as_mm}'}, and the sigmas in metres, too",
    )


def _listed(values: Sequence[float]) -> str:
    return f"({', '.join(f'{value:.9g}' for value in values)})"
