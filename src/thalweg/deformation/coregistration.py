"""Registration of two epochs on stable ground, as weights of the distances themselves.

A small motion of the second epoch, a shift and a rotation about the middle of the bank, changes the distance
at a core point by ``h'p`` with ``h = (n, (x - c) x n)``. Its estimate is linear in the distances of stable
core points, ``p = S d``, so that a registered distance is a weighted sum of points like any other,
``d - h'S d``, and its variance follows from the same field of errors: what is common to stable ground and to
the place that is asked for cancels. With the covariance from before the registration normalised distances
come out too small.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from thalweg.core import ArrayB, ArrayF, GeometryError, robust_sigma
from thalweg.deformation.field import ErrorField
from thalweg.settings.sections import Deformation
from thalweg.surface import Area

PARAMETERS = ("east_m", "north_m", "up_m", "turn_east", "turn_north", "turn_up")
_MODELS = {"none": [], "shift": [0, 1, 2], "shift+heading": [0, 1, 2, 5], "rigid": [0, 1, 2, 3, 4, 5]}
_LEAST = 30
"""Stable core points that a registration needs."""
_WEAK = 0.01
"""A motion is not shown by the stable ground if it changes squared distances less than this share of the
best shown motion."""
_MOVED = 4.0
"""A stable area that lies so many standard deviations off the others has moved."""


@dataclass(frozen=True, slots=True)
class Registration:
    """Motion of the second epoch against the first, and how it follows from the distances.

    Attributes
    ----------
    parameters : (6,) see `PARAMETERS`; rotations in radians about the middle. Zero where not estimated.
    cov : (6, 6) of the field and of noise.
    design : (k, 6) change of each distance for each parameter.
    weights : (6, k) ``S``: the parameters are ``S d``.
    stable : (k,) core points that count.
    facts : for people.
    """

    parameters: ArrayF
    cov: ArrayF
    design: ArrayF
    weights: ArrayF
    stable: ArrayB
    facts: dict[str, Any]

    def registered(self, distance_m: ArrayF) -> ArrayF:
        """Distances (k,) without the motion."""
        return np.asarray(distance_m - self.design @ self.parameters)

    def of_errors(self, error_m: ArrayF) -> ArrayF:
        """Errors (k,) of registered distances from errors of distances; NaN of unmeasured ones is left."""
        known = np.where(np.isfinite(error_m), error_m, 0.0)
        return np.asarray(error_m - self.design @ (self.weights @ known))


def design_of(cores_m: ArrayF, normals: ArrayF, middle_m: ArrayF) -> ArrayF:
    """Change (k, 6) of distances along normals for each of `PARAMETERS`, rotations about a middle."""
    return np.column_stack([normals, np.cross(cores_m - middle_m, normals)])


def coregister(
    cores_m: ArrayF,
    normals: ArrayF,
    distance_m: ArrayF,
    white_m: ArrayF,
    calm: ArrayB,
    field: ErrorField,
    settings: Deformation,
) -> Registration:
    """Estimate the motion between two epochs from stable ground.

    Parameters
    ----------
    cores_m, normals : (k, 3).
    distance_m : (k,) measured; NaN where an epoch has too few points.
    white_m : (k,) its standard deviation by noise and roughness.
    calm : (k,) bare ground, where the points scatter little.
    field : shared errors of the distances.
    settings : model, stable areas, largest shift.

    Raises
    ------
    GeometryError : too little stable ground, a stable area that moved, or epochs that lie too far apart.
    """
    model = _MODELS[settings.registration]
    middle = cores_m.mean(axis=0)
    design = design_of(cores_m, normals, middle)
    areas = _areas(cores_m, settings.stable)
    candidates = np.isfinite(distance_m) & np.isfinite(white_m) & calm & areas.any(axis=0)
    nothing = Registration(
        np.zeros(6), np.zeros((6, 6)), design, np.zeros((6, len(cores_m))), candidates, {"model": "none"}
    )
    if not model:
        return nothing
    if candidates.sum() < _LEAST:
        raise GeometryError(
            f"{candidates.sum()} core points on stable ground of which both epochs have points",
            expected=f"at least {_LEAST}",
            where="deformation.stable",
            cure="Draw larger stable areas, or set deformation.registration to none",
        )
    sigma = np.hypot(white_m, np.sqrt(field.variances()))
    weight = np.where(candidates, 1.0 / np.maximum(sigma, 1e-4) ** 2, 0.0)
    kept, estimate, solver = _robust(design, np.nan_to_num(distance_m), weight, model)
    weights = np.zeros((6, len(cores_m)))
    weights[model] = solver
    parameters = np.zeros(6)
    parameters[model] = estimate
    of_field = field.combined(weights)
    cov = of_field.covariance_with(of_field) + (weights * np.nan_to_num(white_m) ** 2) @ weights.T
    found = Registration(parameters, cov, design, weights, kept > 0, {})
    _check_areas(found, distance_m, white_m, areas, field)
    size = float(np.linalg.norm(parameters[:3]))
    if size > settings.largest_shift_m:
        raise GeometryError(
            f"the second epoch lies {size:.2f} m off the first on stable ground",
            expected=f"at most deformation.largest_shift_m = {settings.largest_shift_m:g} m",
            cure="Look at datum, base station and antenna height of both surveys; or is the stable ground "
            "that most of the bank agrees on not stable? Then draw deformation.stable",
        )
    facts = _facts(found, settings, model, solver, candidates, areas)
    return Registration(parameters, cov, design, weights, kept > 0, facts)


def _areas(cores_m: ArrayF, polygons: Sequence[Sequence[tuple[float, float]]] | None) -> ArrayB:
    """Which core points (a, k) lie in which stable area; one area of everything, if none is drawn."""
    if polygons is None:
        return np.ones((1, len(cores_m)), dtype=bool)
    return np.array([Area(polygon_en_m=np.asarray(each, float)).contains(cores_m) for each in polygons])


def _robust(
    design: ArrayF, distance: ArrayF, weight: ArrayF, model: list[int]
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Tukey's estimate: weights (k,), parameters (p,) and how they follow from the distances (p, k)."""
    H = design[:, model]
    use = weight > 0
    scaled = weight / weight[use].mean()
    centre = np.median(distance[use])
    robust = scaled * (np.abs(distance - centre) < 3 * robust_sigma(distance[use], centre) + 1e-9)
    estimate = np.zeros(len(model))
    solver = np.zeros((len(model), len(distance)))
    for _ in range(50):
        solver = _solver(H, robust)
        before, estimate = estimate, solver @ distance
        rest = distance - H @ estimate
        scale = robust_sigma(rest[use], 0.0)
        ratio = rest / (4.685 * max(scale, 1e-6))
        robust = scaled * np.maximum(1.0 - ratio**2, 0.0) ** 2
        if np.allclose(estimate, before, atol=1e-7):
            break
    return robust, estimate, solver


def _solver(H: ArrayF, weight: ArrayF) -> ArrayF:
    """``S`` (p, k) of weighted least squares in the motions that the ground shows, zero in the others."""
    length = np.sqrt(np.average(H**2, axis=0, weights=weight))
    scale = np.where(np.arange(H.shape[1]) < 3, 1.0, np.maximum(length, 1e-12))
    A = H / scale
    values, vectors = np.linalg.eigh(A.T @ (A * weight[:, None]))
    shown = values > _WEAK * values[-1]
    inverse = (vectors[:, shown] / values[shown]) @ vectors[:, shown].T
    return np.asarray((inverse @ (A * weight[:, None]).T) / scale[:, None])


def _check_areas(
    found: Registration, distance_m: ArrayF, white_m: ArrayF, areas: ArrayB, field: ErrorField
) -> None:
    """Refuse a drawn stable area whose mean lies off the motion that all stable areas agree on."""
    if len(areas) < 2:
        return
    rest = found.registered(distance_m)
    for i, inside in enumerate(areas):
        use = inside & np.isfinite(rest)
        if use.sum() < 5:
            continue
        mean = np.where(use, 1.0 / use.sum(), 0.0)
        row = mean - (mean @ found.design) @ found.weights
        variance = float(field.combined(row[None]).variances()[0])
        sigma = np.sqrt(variance + float(np.sum((row * np.nan_to_num(white_m)) ** 2)))
        off = float(np.median(rest[use]))
        if abs(off) > _MOVED * sigma:
            raise GeometryError(
                f"stable area {i + 1} of {len(areas)} lies {off:+.3f} m off the motion of all, with a "
                f"standard deviation of {sigma:.3f} m",
                expected=f"less than {_MOVED:g} standard deviations",
                where=f"deformation.stable[{i}]",
                cure="It moved: leave it out",
            )


def _facts(
    found: Registration,
    settings: Deformation,
    model: list[int],
    solver: ArrayF,
    candidates: ArrayB,
    areas: ArrayB,
) -> dict[str, Any]:
    """Parameters with sigmas, whether a registration is needed, and what the ground does not show."""
    cov = found.cov[np.ix_(model, model)]
    values, vectors = np.linalg.eigh(cov)
    shown = values > 1e-9 * values[-1]
    z = vectors[:, shown].T @ found.parameters[model]
    statistic = float(np.sum(z**2 / values[shown]))
    left = np.eye(len(model)) - solver @ found.design[:, model]
    share, direction = np.linalg.eigh(0.5 * (left + left.T))
    weak = direction[:, share > 0.5].T.round(3).tolist()
    return {
        "model": settings.registration,
        "parameters": dict(zip(PARAMETERS, found.parameters.tolist(), strict=True)),
        "sigmas": dict(zip(PARAMETERS, np.sqrt(np.diag(found.cov)).tolist(), strict=True)),
        "test_statistic": statistic,
        "degrees_of_freedom": int(shown.sum()),
        "p_value": float(chi2.sf(statistic, shown.sum())),
        "needed": bool(chi2.sf(statistic, shown.sum()) < 0.05),
        "not_shown": weak,  # directions in the space of the estimated parameters
        "stable_cores": int(found.stable.sum()),
        "candidates": int(candidates.sum()),
        "areas": "drawn" if settings.stable is not None else "what most of the bank agrees on",
        "n_areas": len(areas),
    }


def write_registration(json_path: Path, weights_path: Path, found: Registration) -> None:
    """Write facts as JSON for people, and the arrays that later steps need as npz."""
    json_path.write_text(json.dumps(found.facts, indent=2) + "\n")
    np.savez(
        weights_path,
        allow_pickle=False,
        parameters=found.parameters,
        cov=found.cov,
        design=found.design,
        weights=found.weights,
        stable=found.stable,
    )


def read_registration(json_path: Path, weights_path: Path) -> Registration:
    """Read what `write_registration` wrote."""
    with np.load(weights_path) as stored:
        return Registration(facts=json.loads(json_path.read_text()), **stored)
