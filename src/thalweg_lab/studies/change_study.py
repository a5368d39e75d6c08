"""Two surveys of unchanged ground, many times over: do limits of detection and intervals of volumes hold?

A pair is two surveys of one river with errors of their own. Nothing moved, so that each distance and each
volume is an error. Three models of the errors predict them: the field (poses correlated in time, as the
pipeline has it), independent points (each point's covariance over their number, as M3C2 has it), and one
error of the whole epoch at each core point (as M3C2-EP has it for fixed scan positions); volumes of the
latter two sum independent cells. For the power of detection the second epoch is displaced along the normals
in patches.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.stats import norm

from thalweg.core import ArrayB, ArrayF, ErrorChain
from thalweg.deformation import (
    Compared,
    Epoch,
    ErrorField,
    Pair,
    benjamini_hochberg,
    measure_pair,
    place_core_points,
    prepare_epoch,
    register_pair,
    registered_distances,
)
from thalweg.navigation.ins_gnss import PoseCorrelation
from thalweg.settings.sections import Deformation
from thalweg.surface import Area
from thalweg_lab.studies.chain_study import MOUNTS, ImageErrors, trajectories_of
from thalweg_lab.studies.study import Result, Seed, Study, Tables
from thalweg_lab.studies.survey import BARE, orient, record, survey_settings

TWIN: Final[dict[str, Any]] = {
    "size": "tiny",
    "duration_s": 16.0,
    "scene": BARE | {"length_m": 60.0, "grid_m": 0.25},
    "ins": {"attitude_time_s": 20.0},
    "gnss": {"correlation_time_s": 10.0},
    "lidar": {"mirror_ghosts": False},
}
"""Section ``twin`` of both surveys: bare banks, errors of poses as long as those of an INS."""
AREA: Final = Area(lowest_m=0.3)
"""Above waves and mirror images."""
WITHIN_M: Final = 30.0
"""Core points farther from the boat are not asked for."""
CHANGE_M: Final = {"ins": 0.10, "camera": 0.10, "fused": 0.06}
"""Size of the changes that the power is asked for, by chain."""
RECEIVER_S: Final = 0.1
"""Between solutions of the twin's receiver."""
LEVEL: Final = 0.05
CHAINS: Final = ("ins", "camera", "fused")
Z95: Final = float(norm.isf(0.025))
FIELD: Final = "field"
MODELS: Final = (FIELD, "independent", "ep", "field, correlation times a tenth", "field, sigmas halved")
"""The pipeline's model, two others, and, for INS and receiver, the pipeline's with two mistakes put in."""


def rows(seed: Seed) -> Tables:
    """What one pair says of each chain and model: means over its core points, and three volumes."""
    settings = Deformation()
    first, second = (_epochs(seed, number, settings) for number in (0, 1))
    parts: list[dict[str, Any]] = []
    for chain in CHAINS:
        before, after = first[chain], second[chain]
        cores = place_core_points([before, after], settings, AREA)
        pair = measure_pair(cores, before, after, settings)
        compared = registered_distances(pair, register_pair(pair, settings))
        near = np.linalg.norm(before.scanner_m[:, None] - pair.found.cores_m, axis=2).min(axis=0)
        use = np.isfinite(compared.distance_m) & (near < WITHIN_M) & pair.bare
        thirds = _thirds(cores["s_m"].to_numpy(), use)
        parts += [
            {"seed": seed.number, "chain": chain, "model": model}
            | _judged(compared, model, use, thirds, CHANGE_M[chain], seed.number)
            for model in (MODELS if chain == "ins" else MODELS[:3])
        ]
    return {"pairs": pd.DataFrame(parts)}


def _epochs(seed: Seed, number: int, settings: Deformation) -> dict[str, Epoch]:
    """One survey of the seed's river by each chain, processed as a campaign that states no errors is.

    Errors of INS and receiver are those that the logs state, with correlation times taken as certain; what
    camera and fused trajectory find out about their errors is theirs.
    """
    twin = {**TWIN, "scene": {**TWIN["scene"], "seed": seed.number}}
    if number:
        twin["start_utc"] = "2023-05-10T09:41:20Z"
    s = survey_settings(twin, seed=2 * seed.number + number, mounts=MOUNTS)
    logs = record(s, seed.folder / f"epoch_{number}")
    trajectories, mounts, _, chains = trajectories_of(logs, ImageErrors())
    correlation: dict[str, PoseCorrelation | list[ErrorChain]] = {
        "ins": PoseCorrelation(
            position_s=TWIN["gnss"]["correlation_time_s"],
            attitude_s=TWIN["ins"]["attitude_time_s"],
            white_share=s["orientation"]["error_model"]["white_share"],
            receiver_s=RECEIVER_S,
        )
    } | {chain: errors() for chain, errors in chains.items()}
    epochs = {}
    for chain in CHAINS:
        survey = orient(logs, trajectories[chain], name=chain, mount=mounts[chain])
        epochs[chain] = prepare_epoch(
            f"epoch {number + 1}",
            survey.points,
            survey.trajectory,
            survey.mount,
            correlation[chain],
            frame=logs.frame,
            area=AREA,
            moment_s=settings.errors.moment_s,
            water_line_ics_m=s["filters"]["water_line_ics_m"],
            margin_m=settings.reach_m,
        )
    logs.remove()
    return epochs


def _thirds(s_m: ArrayF, use: ArrayB) -> list[ArrayB]:
    """Three stretches (k,) of the bank with as many core points each."""
    edges = np.quantile(s_m[use], [0.0, 1 / 3, 2 / 3, 1.0])
    return [use & (s_m >= low) & (s_m < high) for low, high in pairwise(edges)]


def _judged(
    compared: Compared, model: str, use: ArrayB, thirds: Sequence[ArrayB], change_m: float, seed: int
) -> dict[str, float]:
    """Measures of one model on one pair."""
    changed = _with_times(compared, 0.1) if "tenth" in model else compared
    factor = 0.5 if "halved" in model else 1.0
    sigma = factor * (_other_sigma(compared, model) if model in ("independent", "ep") else changed.sigma_m)
    z = compared.distance_m[use] / sigma[use]
    area = compared.pair.cores["area_m2"].to_numpy()
    products = np.array([np.where(third, area, 0.0) for third in thirds])
    volume = products @ np.nan_to_num(compared.distance_m)
    if model in ("independent", "ep"):
        spread = np.sqrt((products**2) @ np.nan_to_num(sigma) ** 2)
    else:
        spread = factor * np.sqrt(sum(changed.variances(products)))
    return {
        "cores": float(use.sum()),
        "normalised_square": float(np.mean(z**2)),
        "false_alarm_95": float(np.mean(np.abs(z) > Z95)),
        **{f"volume_{i + 1}": float(v) for i, v in enumerate(volume / spread)},
        "mean": _mean(changed, sigma / factor, factor, model, use),
        **_power(compared, sigma, use, change_m, seed),
    }


def _mean(compared: Compared, sigma: ArrayF, factor: float, model: str, use: ArrayB) -> float:
    """Normalised mean distance of the bank before any registration: how far the epochs as such lie apart."""
    row = np.where(use, 1.0 / use.sum(), 0.0)
    mean = float(row @ np.nan_to_num(compared.pair.found.distance_m))
    if model in ("independent", "ep"):
        return mean / float(np.sqrt((row**2) @ np.nan_to_num(sigma) ** 2))
    variance = float(compared.pair.field.combined(row[None]).variances()[0])
    return mean / (factor * float(np.sqrt(variance + (row**2) @ np.nan_to_num(compared.pair.white_m) ** 2)))


def _with_times(compared: Compared, factor: float) -> Compared:
    """The same with other correlation times of the field."""
    field = compared.pair.field
    groups = tuple(replace(group, correlation_s=factor * group.correlation_s) for group in field.of_poses)
    pair = replace(compared.pair, field=ErrorField(groups, field.rows))
    return registered_distances(pair, compared.registration)


def _other_sigma(compared: Compared, model: str) -> ArrayF:
    """Sigma (k,) of the distances if all points of a core point err alike (ep), or none with another."""
    pair: Pair = compared.pair
    total = np.zeros(len(pair.white_m))
    n = pair.found.n.astype(float)
    half = len(pair.field.of_poses) // 2
    for i, part in enumerate((slice(0, half), slice(half, None))):
        groups = tuple(group.alike() for group in pair.field.of_poses[part])
        alike = ErrorField(groups, pair.field.rows[part]).variances()
        total += alike if model == "ep" else alike / np.maximum(n[:, i], 1.0)
    return np.sqrt(total + pair.white_m**2)


def _power(compared: Compared, sigma: ArrayF, use: ArrayB, change_m: float, seed: int) -> dict[str, float]:
    """Sensitivity, specificity and false discoveries with patches of change put into the second epoch."""
    rng = np.random.default_rng(seed)
    places = compared.pair.found.cores_m
    rows = np.flatnonzero(use)
    moved = np.zeros(len(use))
    for middle in places[rng.choice(rows, 4, replace=False)]:
        inside = np.linalg.norm(places - middle, axis=1) < 2.5
        moved[inside] = change_m * rng.choice([-1.0, 1.0])
    z = (compared.distance_m + moved)[use] / sigma[use]
    q = benjamini_hochberg(2.0 * norm.sf(np.abs(z)))
    found, true = q <= LEVEL, moved[use] != 0.0
    limit = float(np.abs(z[found]).min()) if found.any() else np.inf
    offset = change_m / sigma[use][true]
    return {
        "sensitivity": float(found[true].mean()),
        "predicted_sensitivity": float(np.mean(norm.cdf(offset - limit) + norm.cdf(-offset - limit))),
        "specificity": float(1.0 - found[~true].mean()),
        "false_discovery": float(found[~true].sum() / max(found.sum(), 1)),
    }


def results(tables: Tables, files: Sequence[Path]) -> Mapping[str, Result]:
    """Measures of each model over all pairs."""
    out = []
    for (chain, model), part in tables["pairs"].groupby(["chain", "model"], sort=False):
        volumes = part[[f"volume_{i}" for i in (1, 2, 3)]].to_numpy()
        values = {
            "normalised_square": part["normalised_square"].mean(),
            "false_alarm_95": part["false_alarm_95"].mean(),
            "volume_coverage_95": float(np.mean(np.abs(volumes) <= Z95)),
            "volume_normalised_square": float(np.mean(volumes**2)),
            "mean_normalised_square": float(np.mean(part["mean"] ** 2)),
            **{name: part[name].mean() for name in ("sensitivity", "specificity", "false_discovery")},
            "power_gap": float((part["sensitivity"] - part["predicted_sensitivity"]).mean()),
        }
        out += [
            {"chain": chain, "model": model, "measure": name, "value": value, "pairs": len(part)}
            for name, value in values.items()
        ]
    return {"table": pd.DataFrame(out)}


CHANGE_STUDY: Final = Study(rows=rows, results=results)
