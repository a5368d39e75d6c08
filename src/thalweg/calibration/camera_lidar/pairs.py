"""Do scan and picture of each static position belong together? Which assignment fits better?

Recordings are renamed by hand. If the scan of one position stands with the picture of another one, no cone is
where it should be, and nothing in the message of a single cone tells why. So each scan that does not fit is
tried with the picture of every position.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from thalweg.calibration.cones.cone import Cone
from thalweg.calibration.cones.search import Found, SearchRange, fit_of, search
from thalweg.calibration.cones.selection import Position
from thalweg.core.errors import GeometryError
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF

_FITS: Final = 0.4
"""Balance of the beams of a scan with the picture that it belongs to."""
_SCANS: Final = 2
"""Scans that are searched with each picture; any one right pair gives the orientation."""


def refuse_swapped(
    cones: Sequence[Cone],
    lengths_m: Sequence[float],
    positions: Sequence[Position],
    nominal: Rigid,
    within: SearchRange,
    found: Found,
    least_score: float,
) -> list[str]:
    """Positions whose scan does not fit, with its balance; refuse those that fit the picture of another one.

    Parameters
    ----------
    cones, lengths_m, positions, nominal, within : of `thalweg.calibration.cones.search.search`.
    found : its result.
    least_score : balance below which a scan does not fit.

    Raises
    ------
    GeometryError : scans fit the pictures of other positions; names both.
    """
    own = [fit_of(found.T_ccs_scs, cones, lengths_m, p.T_pcs_ccs, p) for p in positions]
    odd = [i for i, score in enumerate(own) if score < least_score]
    told = [f"{positions[i].name}: {own[i]:.2f}" for i in odd]
    if not odd or len(positions) < 2:
        return told
    scores = _best_scores(cones, lengths_m, positions, nominal, within, found.T_ccs_scs, odd)
    best = scores.argmax(axis=1)
    swapped = [i for i in range(len(positions)) if best[i] != i and scores[i, best[i]] > _FITS > scores[i, i]]
    if not swapped:
        return told
    names = [p.name for p in positions]
    raise GeometryError(
        "; ".join(
            f"the scan of {names[i]} fits the picture of {names[best[i]]} (balance of its beams "
            f"{scores[i, best[i]]:.2f}) and not its own ({scores[i, i]:.2f})"
            for i in swapped
        ),
        expected="scan and picture of one position together",
        cure="Rename the recordings of "
        + ", ".join(dict.fromkeys(n for i in swapped for n in (names[i], names[best[i]])))
        + " so that scan and picture of one position have the same name",
    )


def _best_scores(
    cones: Sequence[Cone],
    lengths_m: Sequence[float],
    positions: Sequence[Position],
    nominal: Rigid,
    within: SearchRange,
    first: Rigid,
    odd: Sequence[int],
) -> ArrayF:
    """(n, n) balance of each scan (row) with each picture, at the orientation at which most scans fit one."""

    def table_at(T: Rigid) -> ArrayF:
        """The balances at one orientation."""
        return np.array([[fit_of(T, cones, lengths_m, q.T_pcs_ccs, p) for q in positions] for p in positions])

    best = table_at(first)
    for i in odd[:_SCANS]:
        for picture in positions:
            if float(best.max(axis=1).min()) > _FITS:
                return best
            try:
                pair = positions[i].at(picture.T_pcs_ccs)
                found = search(cones, lengths_m, [pair], nominal, within)
            except GeometryError:
                continue
            best = max(best, table_at(found.T_ccs_scs), key=lambda table: float(table.max(axis=1).sum()))
    return best
