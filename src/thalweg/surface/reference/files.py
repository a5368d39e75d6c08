"""Do the files of a reference agree? Heights of one above the other where both have seen the bank.

Two scans that were registered apart, or at two epochs, give a mesh that follows the one farther behind, or
runs to and fro between both, and nothing in it tells so.
"""

from collections.abc import Mapping
from itertools import combinations
from typing import Any, Final

import numpy as np

from thalweg.core.types import ArrayF, ArrayI
from thalweg.surface.bank_frame import BankFrame
from thalweg.surface.reference.near_area import ReferencePoints

APART_M: Final = 0.05
"""Stations of one survey agree within centimetres; grass that only one of them sees stays below that."""

_CELL_M: Final = 0.5
_LEAST_POINTS: Final = 5
_LEAST_CELLS: Final = 20


def compare_files(read: ReferencePoints, frame: BankFrame) -> tuple[list[dict[str, Any]], list[str]]:
    """How far apart two files each lie along `out` of the bank, and sentences about those that differ.

    Parameters
    ----------
    read : points with the numbers of their files.
    frame : of the bank.

    Returns
    -------
    pairs : of files that share 20 cells or more: their names; `cells`; `apart_m`, the median over these cells
        of the difference of the median heights in them, positive if the second stands in front; `spread_m`,
        the NMAD of these differences.
    notes : sentences for people.
    """
    columns = _medians(read, frame)
    pairs, notes = [], []
    for one, other in combinations(columns, 2):
        shared = [key for key in columns[one] if key in columns[other]]
        if len(shared) < _LEAST_CELLS:
            continue
        differences = np.array([columns[other][key] - columns[one][key] for key in shared])
        apart = float(np.median(differences))
        spread = 1.4826 * float(np.median(np.abs(differences - apart)))
        names = [read.files[number]["file"] for number in (one, other)]
        pairs.append({"files": names, "cells": len(shared), "apart_m": round(apart, 5)})
        pairs[-1]["spread_m"] = round(spread, 5)
        # in crowns two stations see different leaves: those differences have no common value
        if abs(apart) > max(APART_M, spread):
            side = "in front of" if apart > 0 else "behind"
            notes.append(
                f"{names[1]} lies {abs(apart):.2f} m {side} {names[0]} where they meet: another epoch, "
                "registration or height system? Remove one of them from logs.reference."
            )
    return pairs, notes


def _medians(read: ReferencePoints, frame: BankFrame) -> Mapping[int, dict[int, float]]:
    """Median height in each cell of the plane of the bank that holds five points of a file or more."""
    if len(read.files) < 2:
        return {}
    good = np.isfinite(read.points_m).all(axis=1)
    bank, source = frame.to_bank(read.points_m[good]), read.source[good]
    cell = np.floor(bank[:, :2] / _CELL_M).astype(np.int64)
    cell -= cell.min(axis=0, initial=0)
    key = cell[:, 0] * (int(cell[:, 1].max(initial=0)) + 1) + cell[:, 1]
    return {number: _of_one(key[source == number], bank[source == number, 2]) for number in read.files}


def _of_one(key: ArrayI, height_m: ArrayF) -> dict[int, float]:
    order = np.lexsort((height_m, key))
    cells, start, n = np.unique(key[order], return_index=True, return_counts=True)
    many = n >= _LEAST_POINTS
    middle = height_m[order[(start + n // 2)[many]]]
    return dict(zip(cells[many].tolist(), middle.tolist(), strict=True))
