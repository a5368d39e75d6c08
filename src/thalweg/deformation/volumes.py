"""What a change is, and how much: classes, connected patches, volumes with sigmas from the field of errors.

A volume is the sum of distances times the areas that their core points stand for: one product of the points
like any other, so that its variance has the same recursion, never that of independent cells. What no epoch
saw is an area beside the volume, not a zero in it.
"""

from collections.abc import Iterator

import numpy as np
import pandas as pd
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.stats import norm

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI
from thalweg.deformation.changes import Compared
from thalweg.deformation.core_points import bank_line_m, lines_of_bank
from thalweg.settings.sections import Classes, Deformation

# ---------------------------------------------------------------- classes and patches

STATES = (
    "erosion",
    "deposition",
    "no significant change",
    "vegetation",
    "object",
    "not seen in first",
    "not seen in second",
    "not seen",
    "no normal",
)
"""What is known of a core point; only the first two count in volumes."""

_SEVERAL = 0.3
"""Beams with more than one echo, as a share, that show plants."""
_EDGE = 0.3
"""Share of the core points around a patch with a sharp edge in their cylinders that an object has."""


def classify_changes(
    table: pd.DataFrame, compared: Compared, visibility: pd.DataFrame, settings: Deformation
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """States of core points, and connected patches of change.

    A core point that the second epoch did not see is eroded only where its beams passed through the place
    (free space); the distance of such a place is not measured.

    Parameters
    ----------
    table : `thalweg.deformation.compare.CHANGES` of both epochs.
    compared : what it was made from.
    visibility : table `thalweg.deformation.visibility.VISIBILITY`.
    settings : see `thalweg.settings.sections.Classes`.

    Returns
    -------
    The table with its final states, and one row a patch: what, core points, area, volume, mean and largest
    distance, middle.
    """
    limits = settings.classes
    state = table["state"].to_numpy(dtype=object).copy()
    scatter = np.nan_to_num(compared.pair.scatter_m, nan=0.0).max(axis=1)
    several = np.nan_to_num(compared.pair.several, nan=0.0).max(axis=1)
    plants = (scatter > limits.vegetation_roughness_m) | (several > _SEVERAL)
    measured = np.isfinite(table["distance_m"].to_numpy())
    state[plants & measured] = "vegetation"
    free = (state == "not seen in second") & (visibility["reason_2"] == "free space").to_numpy()
    free &= compared.pair.cores["surface"].to_numpy() == 1
    state[free] = "erosion"
    filled = (state == "not seen in first") & (visibility["reason_1"] == "free space").to_numpy()
    filled &= compared.pair.cores["surface"].to_numpy() != 1
    state[filled] = "deposition"
    places = compared.pair.found.cores_m
    patch = _patches(places, state, 1.8 * settings.core_spacing_m)
    for number in np.unique(patch[patch >= 0]):
        if _is_object(places, ~compared.pair.bare, patch, number, settings):
            state[patch == number] = "object"
    out = table.assign(state=state)
    return out, _rows(out, compared.pair.cores["area_m2"].to_numpy(), patch, limits)


def _patches(places_m: ArrayF, state: AnyArray, reach_m: float) -> ArrayI:
    """Number of the connected patch (k,) of each eroded or deposited core point, -1 for the others."""
    patch = np.full(len(state), -1)
    last = 0
    for what in ("erosion", "deposition"):
        rows = np.flatnonzero(state == what)
        if not len(rows):
            continue
        pairs = cKDTree(places_m[rows]).query_pairs(reach_m, output_type="ndarray")
        graph = sp.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(rows), len(rows)))
        n, of = connected_components(graph, directed=False)
        patch[rows] = of + last
        last += n
    return patch


def _is_object(places_m: ArrayF, rough: ArrayB, patch: ArrayI, number: int, settings: Deformation) -> bool:
    """Whether a patch is short and has sharp edges: a boulder or a trunk that came or went."""
    rows = np.flatnonzero(patch == number)
    if len(rows) < 2 or np.linalg.norm(np.ptp(places_m[rows], axis=0)) > settings.classes.object_m:
        return False
    near = cKDTree(places_m).query_ball_point(places_m[rows], 2.5 * settings.core_spacing_m)
    around = np.setdiff1d(np.concatenate([np.asarray(each, dtype=np.int64) for each in near]), rows)
    return bool(len(around) and np.mean(rough[around]) >= _EDGE)


def _rows(table: pd.DataFrame, area_m2: ArrayF, patch: ArrayI, limits: Classes) -> pd.DataFrame:
    """One row for each patch that is large enough, the largest first."""
    rows = []
    distance = table["distance_m"].to_numpy()
    for number in np.unique(patch[patch >= 0]):
        use = patch == number
        area = float(area_m2[use].sum())
        if area < limits.least_patch_m2:
            continue
        moved = use & np.isfinite(distance)
        middle = table.loc[use, ["east_m", "north_m", "up_m"]].mean()
        rows.append(
            {
                "what": table.loc[use, "state"].iloc[0],
                "cores": int(use.sum()),
                "area_m2": area,
                "volume_m3": float(np.sum(distance[moved] * area_m2[moved])),
                "mean_distance_m": float(distance[moved].mean()) if moved.any() else np.nan,
                "largest_distance_m": float(distance[moved][np.argmax(np.abs(distance[moved]))])
                if moved.any()
                else np.nan,
                **{name: float(middle[name]) for name in ("east_m", "north_m", "up_m")},
            }
        )
    names = ["what", "cores", "area_m2", "volume_m3", "mean_distance_m", "largest_distance_m"]
    found = pd.DataFrame(rows, columns=[*names, "east_m", "north_m", "up_m"])
    order = np.argsort(-found["area_m2"].to_numpy(), kind="stable")
    return found.iloc[order].reset_index(drop=True)


# ---------------------------------------------------------------- volumes

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


# ---------------------------------------------------------------- retreat of the bank


def estimate_retreat(
    table: pd.DataFrame, compared: Compared, settings: Deformation, *, water_m: float, years: float
) -> pd.DataFrame:
    """How far bank line and bank top moved in each stretch, and how fast; positive: towards the river.

    Net movement and end point rate are those of DSAS (Himmelstoss et al. 2018, USGS Open-File Report
    2018-1179), of whose transects a stretch is the mean. Plants, objects and what an epoch did not see are
    left out.

    Parameters
    ----------
    table : with final states.
    compared : distances with their field.
    settings : length of stretches, height of the bank line.
    water_m : highest water of both epochs, which the bank line lies half a metre above unless its height is
        stated.
    years : between both epochs.

    Returns
    -------
    ``line, height_m, s_from_m, s_to_m, cores, nsm_m, sigma_m, low_m, high_m, epr_m_a, sigma_epr_m_a``: net
    movement of the line, its standard deviation and 95 % interval, end point rate.
    """
    use = _parts(table)["net"]
    rows, products = lines_of_bank(compared.pair.cores, use, settings, bank_line_m(settings, water_m))
    moved = products @ np.nan_to_num(compared.distance_m)
    sigma = np.sqrt(sum(compared.variances(products))) if len(rows) else np.zeros(0)
    wide = norm.isf(0.025) * sigma
    return rows.assign(
        nsm_m=moved,
        sigma_m=sigma,
        low_m=moved - wide,
        high_m=moved + wide,
        epr_m_a=moved / years,
        sigma_epr_m_a=sigma / years,
    )
