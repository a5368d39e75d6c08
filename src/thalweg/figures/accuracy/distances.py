"""What the figures of distances to a reference share: the rows that count, round limits, words."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.accuracy.cloud_to_mesh.statistics import NMAD_FACTOR
from thalweg.core.errors import CoverageError, InputError
from thalweg.core.types import ArrayF
from thalweg.surface.bank_frame import BankFrame

COLUMNS: Final = ("east_m", "north_m", "up_m", "distance_m", "at_border", "used", "outlier")
"""Columns of a comparison that the figures need."""

_TIE: Final = "\N{NO-BREAK SPACE}"


def bank_frame_of(mesh_facts: Mapping[str, Any]) -> BankFrame:
    """The frame of the bank that the facts of a reference mesh state.

    Raises
    ------
    InputError : the facts name no bank frame.
    """
    stated = mesh_facts.get("bank_frame")
    if not stated:
        raise InputError(
            "facts of a mesh without a bank frame", expected="'bank_frame' with 'origin_m' and 'R_bank_wcs'",
            cure="Mesh the reference again with this version of Thalweg",
        )  # fmt: skip
    return BankFrame(
        origin_m=np.asarray(stated["origin_m"], dtype=np.float64),
        R_bank_wcs=np.asarray(stated["R_bank_wcs"], dtype=np.float64),
    )


def compared(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of a comparison that count.

    Raises
    ------
    InputError : a column is missing.
    CoverageError : no row counts.
    """
    missing = [name for name in COLUMNS if name not in table.columns]
    if missing:
        raise InputError(f"columns missing: {missing}", expected="a table of kind 'cloud_to_mesh'")
    used = table[table["used"].to_numpy(bool)]
    if used.empty:
        raise CoverageError(
            f"none of {len(table)} points was compared with the reference",
            expected="points near the reference and not only at its border",
            cure="See the counts of the comparison; check accuracy.area and accuracy.max_distance_m",
        )
    return used


def statistics_text(distance_m: ArrayF, *, std: bool = False) -> str:
    """``mean +4.1 cm, RMSE 9.8 cm``, on request with the standard deviation between them."""
    mean, rmse = float(np.mean(distance_m)), float(np.sqrt(np.mean(distance_m**2)))
    parts = [f"mean{_TIE}{centimetres(mean, sign=True)}", f"RMSE{_TIE}{centimetres(rmse)}"]
    spread = [f"std{_TIE}{centimetres(float(np.std(distance_m)))}"] if std else []
    return ", ".join([parts[0], *spread, parts[1]])


def centimetres(value_m: float, *, sign: bool = False) -> str:
    """A length in centimetres that no line break tears apart.

    Examples
    --------
    >>> centimetres(-0.0412, sign=True).split("\N{NO-BREAK SPACE}")
    ['−4.1', 'cm']
    """
    text = f"{100 * value_m:{'+' if sign else ''}.1f}".replace("-", "\N{MINUS SIGN}")
    return f"{text}{_TIE}cm"


def robust_fit(distance_m: ArrayF) -> tuple[float, float]:
    """Median and NMAD."""
    median = float(np.median(distance_m))
    return median, float(NMAD_FACTOR * np.median(np.abs(distance_m - median)))


def round_above(value: float) -> float:
    """The smallest of 1, 1.5, 2, 3, 5 times a power of ten that is not below a positive value.

    Examples
    --------
    >>> [round_above(x) for x in (0.12, 0.2, 40.0, 0.7)]
    [0.15, 0.2, 50.0, 1.0]
    """
    power = 10.0 ** np.floor(np.log10(value))
    return round(float(min(f * power for f in (1, 1.5, 2, 3, 5, 10) if f * power >= value * (1 - 1e-9))), 12)


def round_limit_m(distance_m: ArrayF) -> float:
    """Round end of a symmetric scale: the median and three NMAD about it are inside.

    Examples
    --------
    >>> round_limit_m(np.array([-0.1, 0.0, 0.1]))
    0.5
    """
    median, nmad = robust_fit(distance_m)
    return round_above(max(abs(median) + 3.0 * nmad, 1e-3))
