"""Volumes of change with standard deviations from the field of errors, never from independent cells.

A volume is the sum of distances times the areas that their core points stand for: one product of the points
like any other, so that its variance has the same recursion. What no epoch saw is an area beside the volume,
not a zero in it.
"""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from scipy.stats import norm

from thalweg.core import ArrayB, ArrayF
from thalweg.deformation.changes import Compared
from thalweg.settings.sections import Deformation

UNSEEN = ("not seen", "not seen in first", "not seen in second")
IN_VOLUME = ("erosion", "deposition", "no significant change")
"""States of the core points that a volume sums: plants and objects are in none."""
_BIAS_DRAWS = 50


def estimate_volumes(
    table: pd.DataFrame, compared: Compared, settings: Deformation, seed: int
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Volumes of the bank, and along it.

    ``erosion`` and ``deposition`` sum the places that changed significantly, ``net`` all places that both
    epochs saw: a sum of what passed a threshold is biased, a net volume is not. ``bias_m3`` is what the
    threshold does to such a sum, by repeated draws of all errors around the measured distances.

    Parameters
    ----------
    table : with final states.
    compared : distances with their field.
    settings : length of stretches.
    seed : of the draws.

    Returns
    -------
    volumes : ``what, volume_m3, sigma_m3, low_m3, high_m3, bias_m3, area_m2, not_seen_m2``.
    along : the same for each stretch of bank, with ``s_from_m, s_to_m``.
    """
    area = compared.pair.cores["area_m2"].to_numpy()
    parts = _parts(table)
    unseen = float(area[table["state"].isin(UNSEEN)].sum())
    rows = [
        {"what": name} | row | {"not_seen_m2": unseen}
        for name, row in zip(parts, _sums(list(parts.values()), area, compared), strict=True)
    ]
    bias = _threshold_bias(table, compared, area, parts["net"], seed)
    for row in rows:
        row["bias_m3"] = bias.get(str(row["what"]), 0.0)
    volumes = pd.DataFrame(rows)[
        ["what", "volume_m3", "sigma_m3", "low_m3", "high_m3", "bias_m3", "area_m2", "not_seen_m2"]
    ]
    return volumes, _along(table, compared, settings, area)


def _parts(table: pd.DataFrame) -> dict[str, ArrayB]:
    """Core points (k,) of erosion, deposition and net volume: measured ones."""
    measured = np.isfinite(table["distance_m"].to_numpy())
    state = table["state"].to_numpy()
    return {
        "erosion": measured & (state == "erosion"),
        "deposition": measured & (state == "deposition"),
        "net": measured & np.isin(state, IN_VOLUME),
    }


def _sums(parts: list[ArrayB], area_m2: ArrayF, compared: Compared) -> Iterator[dict[str, float]]:
    """Volume, sigma, 95 % interval and area of each set of core points."""
    products = np.array([np.where(part, area_m2, 0.0) for part in parts])
    distance = np.nan_to_num(compared.distance_m)
    field, white = compared.variances(products)
    sigma = np.sqrt(field + white)
    wide = norm.isf(0.025) * sigma
    for volume, one, half, product in zip(products @ distance, sigma, wide, products, strict=True):
        yield {
            "volume_m3": float(volume),
            "sigma_m3": float(one),
            "low_m3": float(volume - half),
            "high_m3": float(volume + half),
            "area_m2": float(product.sum()),
        }


def _along(table: pd.DataFrame, compared: Compared, settings: Deformation, area_m2: ArrayF) -> pd.DataFrame:
    """Volumes of stretches of the bank."""
    s = compared.pair.cores["s_m"].to_numpy()
    stretch = np.floor(s / settings.station_m).astype(np.int64)
    rows = []
    unseen = table["state"].isin(UNSEEN).to_numpy()
    parts = _parts(table)
    for name, use in parts.items():
        numbers = np.unique(stretch)
        for number, row in zip(
            numbers, _sums([use & (stretch == n) for n in numbers], area_m2, compared), strict=True
        ):
            here = stretch == number
            rows.append(
                {
                    "what": name,
                    "s_from_m": number * settings.station_m,
                    "s_to_m": (number + 1) * settings.station_m,
                    **row,
                    "not_seen_m2": float(area_m2[here & unseen].sum()),
                }
            )
    return pd.DataFrame(rows)


def _threshold_bias(
    table: pd.DataFrame, compared: Compared, area_m2: ArrayF, use: ArrayB, seed: int
) -> dict[str, float]:
    """What the threshold of significance does to sums of erosion and deposition, cubic metres.

    The measured distances stand for the true ones, and errors are drawn on top of them.
    """
    z = np.abs(compared.distance_m) / compared.sigma_m
    counted = use & table["significant"].to_numpy(dtype=bool)
    if not counted.any():
        return {}
    limit = float(z[counted].min())

    def sums(distance: ArrayF) -> ArrayF:
        """Erosion and deposition of distances (k,) beyond the limit."""
        beyond = use & (np.abs(distance) >= limit * compared.sigma_m)
        volume = np.where(beyond, distance * area_m2, 0.0)
        return np.array([volume[volume < 0].sum(), volume[volume > 0].sum()])

    drawn = [sums(compared.distance_m + error) for error in compared.draws(_BIAS_DRAWS, seed)]
    bias = np.mean(drawn, axis=0) - sums(compared.distance_m)
    return {"erosion": float(bias[0]), "deposition": float(bias[1])}
