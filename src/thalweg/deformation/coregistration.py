"""Registration of two epochs on stable ground, as weights of the distances themselves.

A small motion of the second epoch, a shift and a rotation about the middle of the bank, changes the distance
at a core point by ``h'p`` with ``h = (n, (x - c) x n)``. Its estimate is linear in the distances of stable
core points, ``p = S d``, so that a registered distance is a weighted sum of points like any other,
``d - h'S d``, and its variance follows from the same field of errors: what is common to stable ground and to
the place that is asked for cancels. With the covariance from before the registration normalised distances
come out too small.

More than two epochs make one network: at each stable core point the ground has one height of its own, and
each epoch a motion, ``m_e = level + h'p_e``. Levels are eliminated, so that all motions follow from all
means in one adjustment; they are known but for a motion of all epochs together: the sum of all is set to
zero. The motion between two epochs is the same by whatever way, so that changes close.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from thalweg.core import ArrayB, ArrayF, GeometryError, read_json, robust_sigma
from thalweg.deformation.field import ErrorField
from thalweg.settings.sections import Deformation
from thalweg.surface import Area

TOO_FAR = (
    "Look at datum, base station and antenna height of both surveys; or is the stable ground that most of "
    "the bank agrees on not stable? Then draw deformation.stable"
)
PARAMETERS = ("east_m", "north_m", "up_m", "turn_east", "turn_north", "turn_up")
MODELS = {
    "none": [],
    "height": [2],
    "shift": [0, 1, 2],
    "shift+heading": [0, 1, 2, 5],
    "rigid": [0, 1, 2, 3, 4, 5],
}
BY_DEFAULT = "shift+heading"
"""Motion of a boat's epochs: a heading's error is the largest that it has."""
_LEAST = 30
"""Stable core points that a registration needs."""
_WEAK = 0.01
"""A motion is not shown by the stable ground if it changes squared distances less than this share of the
best shown motion."""
_MOVED = 4.0
"""A stable area that lies so many standard deviations off the others has moved."""


@dataclass(frozen=True, slots=True)
class _Motion:
    """Motions of epochs from stable ground.

    Attributes
    ----------
    parameters : see `PARAMETERS`; rotations in radians about the middle. Zero where not estimated.
    cov : of the field and of noise.
    design : (k, 6) change of each distance, or mean position, for each parameter.
    weights : how the parameters follow from distances, or means.
    stable : (k,) core points that count.
    facts : for people.
    """

    parameters: ArrayF
    cov: ArrayF
    design: ArrayF
    weights: ArrayF
    stable: ArrayB
    facts: dict[str, Any]


class Registration(_Motion):
    """Motion of the second epoch against the first, and how it follows from the distances.

    ``parameters`` (6,), ``cov`` (6, 6), ``weights`` (6, k): ``S``, the parameters are ``S d``.
    """

    __slots__ = ()

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
    bare: ArrayB,
    field: ErrorField,
    settings: Deformation,
) -> Registration:
    """Estimate the motion between two epochs from stable ground.

    Parameters
    ----------
    cores_m, normals : (k, 3).
    distance_m : (k,) measured; NaN where an epoch has too few points.
    white_m : (k,) its standard deviation by noise and roughness.
    bare : (k,) bare ground, where the points scatter little.
    field : shared errors of the distances.
    settings : model, stable areas, largest shift.

    Raises
    ------
    GeometryError : too little stable ground, a stable area that moved, or epochs that lie too far apart.
    """
    model = MODELS[settings.registration or BY_DEFAULT]
    middle = cores_m.mean(axis=0)
    design = design_of(cores_m, normals, middle)
    areas = _areas(cores_m, settings)
    candidates = np.isfinite(distance_m) & np.isfinite(white_m) & bare & areas.any(axis=0)
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
            cure=TOO_FAR,
        )
    facts = _facts(found, settings, model, solver, candidates, areas)
    return Registration(parameters, cov, design, weights, kept > 0, facts)


def _areas(cores_m: ArrayF, settings: Deformation) -> ArrayB:
    """Which core points (a, k) lie in which stable area; one area of everything, if none is drawn."""
    polygons = settings.stable
    if polygons is None:
        return np.ones((1, len(cores_m)), dtype=bool)
    assert not isinstance(polygons, str), (
        "files are read before: thalweg.deformation.foreign.with_drawn_areas"
    )
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
    return {
        "model": settings.registration or BY_DEFAULT,
        **facts_of_motion(found.parameters, found.cov, model, solver @ found.design[:, model]),
        "stable_cores": int(found.stable.sum()),
        "candidates": int(candidates.sum()),
        "areas": "drawn" if settings.stable is not None else "what most of the bank agrees on",
        "n_areas": len(areas),
    }


def facts_of_motion(parameters: ArrayF, cov: ArrayF, model: list[int], resolution: ArrayF) -> dict[str, Any]:
    """Parameters (6,) with sigmas, whether they are more than nothing, directions that are not shown.

    Parameters
    ----------
    model : which are estimated, p of them.
    resolution : (p, p) change of the estimates for a change of the motion: the identity if all is shown.
    """
    part = cov[np.ix_(model, model)]
    values, vectors = np.linalg.eigh(part)
    shown = values > 1e-9 * values[-1]
    z = vectors[:, shown].T @ parameters[model]
    statistic = float(np.sum(z**2 / values[shown]))
    left = np.eye(len(model)) - resolution
    share, direction = np.linalg.eigh(0.5 * (left + left.T))
    return {
        "parameters": dict(zip(PARAMETERS, parameters.tolist(), strict=True)),
        "sigmas": dict(zip(PARAMETERS, np.sqrt(np.diag(cov)).tolist(), strict=True)),
        "test_statistic": statistic,
        "degrees_of_freedom": int(shown.sum()),
        "p_value": float(chi2.sf(statistic, shown.sum())),
        "needed": bool(chi2.sf(statistic, shown.sum()) < 0.05),
        "not_shown": direction[:, share > 0.5].T.round(3).tolist(),  # in the space of the parameters
    }


# ---------------------------------------------------------------- more than two epochs


class Network(_Motion):
    """Motions of n epochs against their common ground.

    ``parameters`` (n, 6) of each epoch, their sum is zero; ``cov`` (6 n, 6 n); ``weights`` (n, 6, n, k): how
    the motion of an epoch follows from the means of all epochs; nothing where it is known apart from them.
    """

    __slots__ = ()

    def registered(self, along_m: ArrayF) -> ArrayF:
        """Means (n, k) of all epochs without their motions."""
        return np.asarray(along_m - self.parameters @ self.design.T)

    def variances(
        self, fields: Sequence[ErrorField], white_m: ArrayF, products: ArrayF | None = None
    ) -> ArrayF:
        """Variances (n, k) of the registered means of each epoch, or (n, q) of weighted sums of them.

        Parameters
        ----------
        fields : of all epochs on the same groups (`thalweg.deformation.field.joint_fields`).
        white_m : (n, k) standard deviations by noise.
        products : (q, k) weights; None: each core point by itself.
        """
        noise = np.nan_to_num(white_m) ** 2
        out = []
        for e, own in enumerate(fields):
            by_motion = self.weights[e]  # (6, n, k)
            motion = sum_of(fields, by_motion)
            design = self.design if products is None else products @ self.design
            asked = own if products is None else own.combined(products)
            spread = self.cov[6 * e : 6 * e + 6, 6 * e : 6 * e + 6]
            shared = asked.covariance_with(motion)
            mine = by_motion[:, e].T * noise[e][:, None]
            shared = shared + (mine if products is None else products @ mine)
            alone = noise[e] if products is None else products**2 @ noise[e]
            variance = asked.variances() + alone - 2.0 * np.sum(design * shared, axis=1)
            out.append(variance + np.einsum("ki,ij,kj->k", design, spread, design))
        return np.maximum(np.array(out), 0.0)


def sum_of(fields: Sequence[ErrorField], weights: ArrayF) -> ErrorField:
    """Weighted sums (q, n, k) of the products of n epochs, on the groups of all."""
    total = fields[0].combined(weights[:, 0])
    for e in range(1, len(fields)):
        total = total + fields[e].combined(weights[:, e])
    return total


def coregister_network(
    cores_m: ArrayF,
    normals: ArrayF,
    along_m: ArrayF,
    white_m: ArrayF,
    bare: ArrayB,
    fields: Sequence[ErrorField],
    settings: Deformation,
) -> Network:
    """Estimate the motions of all epochs from stable ground in one adjustment.

    Parameters
    ----------
    cores_m, normals : (k, 3).
    along_m : (n, k) mean position of each epoch along the normals; NaN where it has too few points.
    white_m : (n, k) standard deviation by noise and roughness.
    bare : (k,) bare ground, where the points scatter little.
    fields : shared errors of the means of each epoch, on the groups of all.
    settings : model, stable areas, largest shift.

    Raises
    ------
    GeometryError : too little stable ground, a stable area that moved, or epochs that lie too far apart.
    """
    model = MODELS[settings.registration or BY_DEFAULT]
    n, k = along_m.shape
    design = design_of(cores_m, normals, cores_m.mean(axis=0))
    areas = _areas(cores_m, settings)
    seen = np.isfinite(along_m) & np.isfinite(white_m)
    candidates = (seen.sum(axis=0) > 1) & bare & areas.any(axis=0)
    weights = np.zeros((n, 6, n, k))
    if not model:
        return Network(np.zeros((n, 6)), np.zeros((6 * n, 6 * n)), design, weights, candidates, {})
    counts = [int((candidates & each).sum()) for each in seen]
    if min(counts) < _LEAST:
        raise GeometryError(
            f"epoch {int(np.argmin(counts)) + 1} has {min(counts)} core points on stable ground that another "
            "epoch saw too",
            expected=f"at least {_LEAST}",
            where="deformation.stable",
            cure="Draw larger stable areas, or set deformation.registration to none",
        )
    variance = np.array([field.variances() for field in fields]) + np.nan_to_num(white_m) ** 2
    weight = np.where(candidates & seen, 1.0 / np.maximum(variance, 1e-8), 0.0)
    known = np.nan_to_num(along_m)
    solver, kept = robust_network(design[:, model], known, weight)
    weights[:, model] = solver
    parameters = np.einsum("eafk,fk->ea", weights, known)
    every = weights.reshape(6 * n, n, k)
    motions = sum_of(fields, every)
    cov = motions.covariance_with(motions)
    cov += np.einsum("xnk,nk,ynk->xy", every, np.nan_to_num(white_m) ** 2, every, optimize=True)
    found = Network(parameters, cov, design, weights, kept, {})
    _check_network(found, along_m, white_m, areas, fields, settings)
    facts = {
        "model": settings.registration or BY_DEFAULT,
        "parameters": [dict(zip(PARAMETERS, each, strict=True)) for each in parameters.tolist()],
        "sigmas": [
            dict(zip(PARAMETERS, each, strict=True))
            for each in np.sqrt(np.maximum(np.diag(cov), 0.0)).reshape(n, 6).tolist()
        ],
        "stable_cores": int(kept.sum()),
        "candidates": int(candidates.sum()),
    }
    return Network(parameters, cov, design, weights, kept, facts)


def robust_network(H: ArrayF, along: ArrayF, weight: ArrayF) -> tuple[ArrayF, ArrayB]:
    """Tukey's estimate: how motions (n, p) follow from means (n, k), as (n, p, n, k); core points that count.

    A core point counts with all its epochs or not at all: one that moved tells of no epoch.
    """
    seen = weight > 0
    before = np.zeros((len(along), H.shape[1]))
    use = seen.any(axis=0)
    middle = np.full(along.shape, np.nan)
    middle[seen] = along[seen]
    middle[:, use] -= np.nanmedian(middle[:, use], axis=0)
    start = np.nanmedian(middle[:, use], axis=1)  # each epoch off the ground as such
    rest = np.where(seen, middle - start[:, None], 0.0)
    solver = np.zeros((len(along), H.shape[1], *along.shape))
    for _ in range(50):
        worst = np.max(np.abs(rest), axis=0)
        scale = robust_sigma(rest[seen], 0.0)
        share = np.where(use, np.maximum(1.0 - (worst / (4.685 * max(scale, 1e-6))) ** 2, 0.0) ** 2, 0.0)
        solver = network_solver(H, weight * share)
        motion = np.einsum("eafk,fk->ea", solver, along)
        left = along - motion @ H.T
        level = np.sum(weight * left, axis=0) / np.maximum(np.sum(weight, axis=0), 1e-300)
        rest = np.where(seen, left - level, 0.0)
        if np.allclose(motion, before, atol=1e-7):
            break
        before = motion
    return solver, share > 0


def network_solver(H: ArrayF, weight: ArrayF) -> ArrayF:
    """Least squares (n, p, n, k) without the levels, in the motions that the ground shows."""
    n, k = weight.shape
    p = H.shape[1]
    total = weight.sum(axis=0)
    length = np.sqrt(np.average(H**2, axis=0, weights=total))
    scale = np.where(np.arange(p) < 3, 1.0, np.maximum(length, 1e-12))
    A = H / scale
    part = weight / np.where(total > 0, total, 1.0)
    N = np.zeros((n, p, n, p))
    for e in range(n):
        for f in range(n):
            w = weight[e] * ((e == f) - part[f])
            N[e, :, f] = A.T @ (A * w[:, None])
    values, vectors = np.linalg.eigh(N.reshape(n * p, n * p))
    shown = values > _WEAK * values[-1]
    inverse = ((vectors[:, shown] / values[shown]) @ vectors[:, shown].T).reshape(n, p, n, p)
    out = np.zeros((n, p, n, k))
    for f in range(n):
        for g in range(n):  # means of f move the right-hand side of g
            w = weight[g] * ((g == f) - part[f])
            out[:, :, f] += np.einsum("eap,kp->eak", inverse[:, :, g], A * w[:, None])
    return np.asarray(out / scale[:, None, None])


def _check_network(
    found: Network,
    along_m: ArrayF,
    white_m: ArrayF,
    areas: ArrayB,
    fields: Sequence[ErrorField],
    settings: Deformation,
) -> None:
    """Refuse epochs that lie too far apart, and a drawn stable area that moved between two epochs."""
    for e in range(1, len(along_m)):
        size = float(np.linalg.norm(found.parameters[e, :3] - found.parameters[e - 1, :3]))
        if size > settings.largest_shift_m:
            raise GeometryError(
                f"epoch {e + 1} lies {size:.2f} m off the one before on stable ground",
                expected=f"at most deformation.largest_shift_m = {settings.largest_shift_m:g} m",
                cure=TOO_FAR,
            )
    if len(areas) < 2:
        return
    rest = found.registered(along_m)
    noise = np.nan_to_num(white_m) ** 2
    for e in range(1, len(along_m)):
        step = rest[e] - rest[e - 1]
        for i, inside in enumerate(areas):
            use = inside & np.isfinite(step)
            if use.sum() < 5:
                continue
            mean = np.where(use, 1.0 / use.sum(), 0.0)
            row = -np.einsum("a,ank->nk", mean @ found.design, found.weights[e] - found.weights[e - 1])
            row[e] += mean
            row[e - 1] -= mean
            variance = float(sum_of(fields, row[None]).variances()[0]) + float(np.sum(row**2 * noise))
            off = float(np.median(step[use]))
            if abs(off) > _MOVED * np.sqrt(variance):
                raise GeometryError(
                    f"stable area {i + 1} of {len(areas)} lies {off:+.3f} m off the motion of all between "
                    f"epochs {e} and {e + 1}, with a standard deviation of {np.sqrt(variance):.3f} m",
                    expected=f"less than {_MOVED:g} standard deviations",
                    where=f"deformation.stable[{i}]",
                    cure="It moved: leave it out",
                )


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
        return Registration(facts=read_json(json_path), **stored)
