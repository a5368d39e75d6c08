r"""Registration of epochs of which one has no trajectory: on ground that somebody drew, or not at all.

What most of a surface agrees on may be a beach that moved, or water: it is reported and never taken off.
How far the epochs lie off each other as a whole is then not known, unless somebody states it of both
(``sigma_common_m``): what is agreed on, the scatter of the distances about it, and the stated standard
deviations, of which nobody knows that they differ from place to place, add up to one error of all heights.

On drawn ground each small place counts alike, by the points inside alone: places that lie off the others of
their area are drawn in to three robust standard deviations, but no area is left out. The motions are least
squares of `thalweg.deformation.coregistration.network_solver`. How well they are known is seen between areas
that lie apart, whatever number of points they hold: with ``p`` from all B areas and ``p_b`` without area b,
the jackknife (Efron and Stein 1981, https://doi.org/10.1214/aos/1176345462) has the covariance

    (B - 1) / B  sum_b (p_b - p)(p_b - p)'.

It stands for a normal distribution in all that follows, so that it is widened to the interval of 95 % of
Student's t with B - 1 degrees of freedom. Of fewer areas than parameters and two, the covariance follows from
stated standard deviations; without them it is the scatter of single places, and no verdict rests on it.

If no standard deviation is stated, the scatter of the places is one, and the length over which it is alike is
that of ``exp(-d / L)`` with the mean correlation that places of one area have.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
import scipy.sparse as sp
import shapely
from scipy.optimize import brentq
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist
from scipy.stats import norm, t as student

from thalweg.core import ArrayB, ArrayF, ArrayI, GeometryError, robust_sigma
from thalweg.deformation.coregistration import (
    BY_DEFAULT,
    MODELS,
    PARAMETERS,
    TOO_FAR,
    design_of,
    facts_of_motion,
    network_solver,
    robust_network,
    sum_of,
)
from thalweg.deformation.epochs import Epoch
from thalweg.deformation.field import COMMON, ErrorField, ErrorGroup, joint_fields
from thalweg.deformation.m3c2 import ColumnIndex, cut_cylinders
from thalweg.deformation.spatial import SpatialErrors, place_in_cells
from thalweg.settings.sections import Deformation

REGISTRATION: Final = "registration"
"""Group of the error of a motion that is known apart from the distances."""
ESTIMATED: Final = "estimated on stable ground"
_LEAST: Final = 10
"""Places that an epoch needs on drawn ground."""
_MOST: Final = 4000
"""Places that count; more are wider."""
_GROUPS: Final = 25
"""Groups that areas are dealt to for the jackknife."""
_PAIRS: Final = 500
"""Places of an area whose pairs tell how far errors are alike."""


@dataclass(frozen=True, slots=True)
class Motions:
    """Motions of n epochs against their mean.

    Attributes
    ----------
    parameters : (n, 6), see `thalweg.deformation.coregistration.PARAMETERS`; their sum is zero.
    cov : (6 n, 6 n).
    stable : (k,) core points on the ground that they rest on.
    facts : for people; ``estimated``: standard deviation and length that the ground shows of one epoch.
    """

    parameters: ArrayF
    cov: ArrayF
    stable: ArrayB
    facts: dict[str, Any]


def motion_kind(epochs: Sequence[Epoch], settings: Deformation) -> str:
    """Which motion is asked for: of rasters alone the height, which is all that their cells show."""
    rasters = [epoch.is_raster for epoch in epochs]
    if settings.registration == "none" or not any(rasters):
        return settings.registration or BY_DEFAULT
    return "height" if all(rasters) else settings.registration or "height"


def moved_apart(
    cores: pd.DataFrame, epochs: Sequence[Epoch], settings: Deformation, along_m: ArrayF, bare: ArrayB
) -> Motions:
    """Motions of epochs of which one has no trajectory; nothing where no stable ground is drawn.

    Parameters
    ----------
    cores : table `thalweg.deformation.core_points.CORE_POINTS`, k rows.
    along_m : (n, k) mean position of each epoch along the normals.
    bare : (k,) bare ground, where the points scatter little.

    Raises
    ------
    GeometryError : too little drawn ground, or epochs that lie too far apart on it.
    """
    kind = motion_kind(epochs, settings)
    model = MODELS[kind]
    places, normals = (
        cores[[f"{name}{axis}{unit}" for axis in ("east", "north", "up")]].to_numpy()
        for name, unit in (("", "_m"), ("normal_", ""))
    )
    n = len(epochs)
    known = all(epoch.sigma_known for epoch in epochs)
    seen = np.isfinite(along_m) & bare
    seen &= seen.sum(axis=0) > 1  # what one epoch alone has lies off nothing
    parameters, cov = np.zeros((n, 6)), np.zeros((6 * n, 6 * n))
    if not model:
        words = {"model": "none", "sigma": "stated" if known else "unknown"}
        return Motions(parameters, cov, np.asarray(seen.all(axis=0)), words)
    if settings.stable is not None:
        return _on_drawn_ground(epochs, settings, kind, places, normals)
    guess, scatter_m = np.zeros((n, 6)), np.zeros(n)
    if (seen.sum(axis=1) >= _LEAST).all():
        H = design_of(places, normals, places.mean(axis=0))[:, model]
        filled = np.nan_to_num(along_m)
        solver = robust_network(H, filled, np.where(seen, 1.0, 0.0))[0]
        guess[:, model] = np.einsum("eafk,fk->ea", solver, filled)
        rest = _off_level(filled - guess[:, model] @ H.T, seen)
        scatter_m = np.array([robust_sigma(row[np.isfinite(row)], 0.0) for row in rest])
        scatter_m *= np.sqrt(n / (n - 1.0))
    stated_whole = all(
        epoch.has_trajectory or COMMON in {group.name for group in epoch.groups} for epoch in epochs
    )
    if not stated_whole:
        cov = np.outer(guess, guess)
        shifts = [i for i in model if i < 3]
        for e, epoch in enumerate(epochs):
            here = [6 * e + i for i in shifts]
            stated = 0.0 if epoch.has_trajectory else _stated_m(epoch)[shifts]
            cov[here, here] += scatter_m[e] ** 2 + np.square(stated)
    facts: dict[str, Any] = {
        "model": "none",
        "areas": "none are drawn",
        "sigma": "stated" if known else "unknown",
        "whole_stated": stated_whole,
        "would_be": [dict(zip(PARAMETERS, each, strict=True)) for each in guess.tolist()],
        "sigma_as_a_whole_m": np.sqrt(np.diag(cov)).reshape(n, 6)[:, :3].tolist(),
    }
    return Motions(parameters, cov, np.zeros(len(cores), bool), facts)


def _stated_m(epoch: Epoch) -> ArrayF:
    """Standard deviations (3,) that points of an epoch share, root mean square over the places."""
    return np.sqrt(sum(np.mean(np.sum(group.root[:, :3] ** 2, axis=2), axis=0) for group in epoch.groups))


# ---------------------------------------------------------------- on drawn ground


def _on_drawn_ground(
    epochs: Sequence[Epoch], settings: Deformation, kind: str, cores_m: ArrayF, core_normals: ArrayF
) -> Motions:
    """Motions by what lies in the drawn areas alone."""
    model, n = MODELS[kind], len(epochs)
    areas = _apart(settings.stable)
    on_ground = [epoch.xyz_m[_within(areas, epoch.xyz_m)] for epoch in epochs]
    places, radius_m = _places(on_ground, settings.core_spacing_m / 4.0)
    normals = core_normals[cKDTree(cores_m).query(places)[1]]
    how = {"radius_m": radius_m, "half_length_m": settings.reach_m}
    along = np.array(
        [
            cut_cylinders(places, normals, ColumnIndex.of(points, radius_m), **how, least=1).along_m
            if len(points)
            else np.full(len(places), np.nan)
            for points in on_ground
        ]
    )
    seen = np.isfinite(along)
    seen &= seen.sum(axis=0) > 1
    counts = seen.sum(axis=1)
    if counts.min() < _LEAST:
        raise GeometryError(
            f"{epochs[int(np.argmin(counts))].name!r} has {counts.min()} places on stable ground that "
            "another epoch has too",
            expected=f"at least {_LEAST}, each a cell of {radius_m * np.sqrt(2.0):.2g} m",
            where="deformation.stable",
            cure="Draw more stable ground where all epochs have points, or set deformation.registration to "
            "none",
        )
    H = design_of(places, normals, cores_m.mean(axis=0))[:, model]
    along = np.where(seen, along, 0.0)
    area = np.asarray(shapely.STRtree(areas).nearest(shapely.points(places[:, :2])), dtype=np.int64)
    along = _drawn_in(along, seen, area)
    solver = network_solver(H, seen.astype(float))
    found = np.einsum("eafk,fk->ea", solver, along)
    for e in range(1, n):
        size = float(np.linalg.norm((found[e] - found[e - 1])[[i < 3 for i in model]]))
        if size > settings.largest_shift_m:
            raise GeometryError(
                f"{epochs[e].name!r} lies {size:.2f} m off {epochs[e - 1].name!r} on stable ground",
                expected=f"at most deformation.largest_shift_m = {settings.largest_shift_m:g} m",
                cure=TOO_FAR,
            )
    rest = _off_level(along - found @ H.T, seen)
    scatter_m = robust_sigma(rest[seen], 0.0) * np.sqrt(n / (n - 1.0))
    known = all(epoch.sigma_known for epoch in epochs)
    covs = {}
    between = _between_areas(H, along, seen, area, found)
    if between is not None:
        covs["the scatter between areas"] = between
    if known:
        index = [ColumnIndex.of(epoch.xyz_m, radius_m) for epoch in epochs]
        fields = joint_fields(
            [
                _without_common(epoch.field(places, normals, own, **how))
                for epoch, own in zip(epochs, index, strict=True)
            ]
        )
        whole = sum_of(fields, solver.reshape(-1, n, len(places)))
        covs["the stated sigmas"] = whole.covariance_with(whole)
    if not covs:
        rows = solver.reshape(len(model) * n, -1)
        covs["the scatter of single places, as if all had one error"] = (
            scatter_m**2 * len(places) * rows @ rows.T
        )
    source = max(covs, key=lambda name: float(np.trace(covs[name])))
    parameters = np.zeros((n, 6))
    parameters[:, model] = found
    at = [6 * e + i for e in range(n) for i in model]
    cov = np.zeros((6 * n, 6 * n))
    cov[np.ix_(at, at)] = covs[source]
    resolution = np.einsum("eafk,kb->eafb", solver, H)
    drawn, places_in = np.unique(area, return_counts=True)
    facts: dict[str, Any] = {
        "model": kind,
        "areas": "drawn",
        "n_areas": len(drawn),
        "sigma": "stated" if known else "unknown" if between is None else "estimated",
        "sigma_from": source,
        "stable_cores": len(places),
        "candidates": len(places),
        "resolution": (resolution[-1, :, -1] - resolution[-1, :, 0]).tolist(),
        "by_area": [
            {
                "east_m": float(areas[i].centroid.x),
                "north_m": float(areas[i].centroid.y),
                "places": int(m),
                "off_m": _median((rest[-1] - rest[0])[area == i]),
            }
            for i, m in zip(drawn, places_in, strict=True)
        ],
    }
    if not known:
        length = _alike_over_m(rest, places[:, :2], area)
        facts["estimated"] = {"sigma_m": float(scatter_m), "correlation_m": length}
    return Motions(
        parameters,
        cov,
        _within([area.buffer(0.5 * settings.core_spacing_m) for area in areas], cores_m),
        facts,
    )


def _off_level(along_m: ArrayF, seen: ArrayB) -> ArrayF:
    """Positions (n, k) off their mean over the epochs; NaN where not seen."""
    level = np.sum(along_m * seen, axis=0) / np.maximum(seen.sum(axis=0), 1)
    return np.where(seen, along_m - level, np.nan)


def _drawn_in(along_m: ArrayF, seen: ArrayB, area: ArrayI) -> ArrayF:
    """The same with places that lie off the others of their area and epoch drawn in."""
    rest = _off_level(along_m, seen)
    out = along_m.copy()
    for i in np.unique(area):
        for e, row in enumerate(rest):
            here = np.flatnonzero((area == i) & seen[e])
            if len(here):
                middle = float(np.median(row[here]))
                limit = 3.0 * robust_sigma(row[here], middle)
                out[e, here] += np.clip(row[here], middle - limit, middle + limit) - row[here]
    return out


def _between_areas(H: ArrayF, along_m: ArrayF, seen: ArrayB, area: ArrayI, found: ArrayF) -> ArrayF | None:
    """Covariance (n p, n p) of motions (n, p) by the jackknife over areas; None of too few areas."""
    groups = np.searchsorted(np.unique(area), area) % _GROUPS
    names = np.unique(groups)
    b = len(names)
    if b < H.shape[1] + 2 or not all((seen & (groups != name)).any(axis=1).all() for name in names):
        return None
    off = []
    for name in names:
        solver = network_solver(H, (seen & (groups != name)).astype(float))
        off.append((np.einsum("eafk,fk->ea", solver, along_m) - found).ravel())
    wide = student.ppf(0.975, b - 1) / norm.ppf(0.975)
    return np.asarray(wide**2 * (b - 1) / b * np.transpose(off) @ off)


def _median(values: ArrayF) -> float | None:
    """Median of the finite ones, None if there are none."""
    some = values[np.isfinite(values)]
    return float(np.median(some)) if len(some) else None


def _apart(polygons: Any) -> list[Any]:
    """Drawn areas that lie apart: those that touch are one."""
    return list(shapely.get_parts(shapely.union_all([shapely.Polygon(each) for each in polygons])))


def _within(areas: Sequence[Any], xyz_m: ArrayF) -> ArrayB:
    """Which points (n, 3) lie in an area."""
    whole = shapely.union_all(list(areas))
    shapely.prepare(whole)
    return np.asarray(shapely.contains_xy(whole, xyz_m[:, 0], xyz_m[:, 1]))


def _places(clouds: Sequence[ArrayF], edge_m: float) -> tuple[ArrayF, float]:
    """Small places (k, 3) where epochs have points, one a cell, and the radius about them.

    A cell is as wide as points lie apart in the epoch where they lie farthest.
    """
    for cloud in clouds:
        if len(cloud) > 1:
            some = cloud[:20_000, :2]
            apart = np.asarray(cKDTree(some).query(some, k=2)[0])[:, 1]
            edge_m = max(edge_m, float(np.median(apart)))
    every = np.concatenate(clouds)
    while True:
        cells, of = np.unique(np.floor(every / edge_m).astype(np.int64), axis=0, return_inverse=True)
        if len(cells) <= _MOST:
            break
        edge_m *= 1.4
    n = np.bincount(of, minlength=len(cells))
    means = [np.bincount(of, every[:, i], minlength=len(cells)) / n for i in range(3)]
    return np.column_stack(means), edge_m / np.sqrt(2.0)


def _alike_over_m(rest_m: ArrayF, plan_m: ArrayF, area: ArrayI) -> float:
    """Length L at which ``exp(-d / L)`` has the mean correlation of residuals (n, k) within areas."""
    limit = 3.0 * robust_sigma(rest_m[np.isfinite(rest_m)], 0.0)
    z: ArrayF = np.asarray(np.clip(rest_m, -limit, limit), dtype=np.float64)
    z = z / max(float(np.sqrt(np.nanmean(z**2))), 1e-12)
    lags, products = [], []
    for i in np.unique(area):
        here = np.flatnonzero(area == i)[:_PAIRS]
        if len(here) < 2:
            continue
        a, b = np.triu_indices(len(here), 1)
        lag = pdist(plan_m[here])
        for row in z:
            product = row[here][a] * row[here][b]
            known = np.isfinite(product) & (lag > 0)
            lags.append(lag[known])
            products.append(product[known])
    lag = np.concatenate(lags) if lags else np.zeros(0)
    if not len(lag):
        return 0.0
    wanted = float(np.concatenate(products).mean())
    least, most = float(lag.min()) / 3.0, float(lag.max())

    def excess(length: float) -> float:
        """Mean correlation at that length beyond the one that is wanted."""
        return float(np.exp(-lag / length).mean()) - wanted

    if excess(least) >= 0 or excess(most) <= 0:
        return least if excess(least) >= 0 else most
    return float(brentq(excess, least, most))


# ---------------------------------------------------------------- as errors of distances


def field_with(
    field: ErrorField, places_m: ArrayF, normals: ArrayF, facts: Mapping[str, Any], epochs: int
) -> ErrorField:
    """A field (k) without what a motion took off, and with what drawn ground shows of errors.

    Parameters
    ----------
    facts : of `Motions`.
    epochs : whose errors the field holds, one or two.
    """
    own = _without_common(field) if facts.get("areas") == "drawn" else field
    parts = list(zip(own.groups, own.rows, strict=True))
    estimated = facts.get("estimated")
    if estimated and estimated["correlation_m"] > 0:
        widest = float(np.ptp(places_m[:, :2], axis=0).max()) / 32.0  # core points lie apart, and draws cost
        length = max(estimated["correlation_m"], widest)
        node, cell, cell_m = place_in_cells(places_m[:, :2], length)
        root = np.sqrt(epochs) * estimated["sigma_m"] * np.broadcast_to(np.eye(3), (len(cell), 3, 3))
        k = len(places_m)
        index = (3 * node[:, None] + np.arange(3)).ravel()
        rows = sp.csr_matrix((normals.ravel(), index, 3 * np.arange(k + 1)), shape=(k, 3 * len(cell)))
        parts.append((SpatialErrors(ESTIMATED, cell, cell_m, root, estimated["correlation_m"]), rows))
    return ErrorField(tuple(group for group, _ in parts), tuple(rows for _, rows in parts))


def _without_common(field: ErrorField) -> ErrorField:
    """A field without the error that all heights of an epoch share: a motion that is taken off holds it."""
    kept = [i for i, group in enumerate(field.groups) if group.name != COMMON]
    return ErrorField(tuple(field.groups[i] for i in kept), tuple(field.rows[i] for i in kept))


def with_motion(field: ErrorField, design: ArrayF, cov: ArrayF) -> ErrorField:
    """A field (k) with the error of a motion (6,) whose covariance is known apart from the distances."""
    values, vectors = np.linalg.eigh(cov)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    group = ErrorGroup(REGISTRATION, np.zeros(1), root[None], np.inf)
    return ErrorField((*field.groups, group), (*field.rows, sp.csr_matrix(design)))


def between_two(motions: Motions) -> tuple[ArrayF, ArrayF, dict[str, Any]]:
    """Motion (6,) of the second epoch against the first, its covariance and facts."""
    differ = np.hstack([-np.eye(6), np.eye(6)])
    parameters = motions.parameters[1] - motions.parameters[0]
    cov = differ @ motions.cov @ differ.T
    facts = dict(motions.facts)
    if "would_be" in facts:
        one, two = facts["would_be"]
        facts["would_be"] = {name: two[name] - one[name] for name in PARAMETERS}
        facts["sigma_as_a_whole_m"] = np.sqrt(np.diag(cov))[:3].tolist()
    elif facts["model"] != "none":
        resolution = np.array(facts.pop("resolution"))
        facts |= facts_of_motion(parameters, cov, MODELS[facts["model"]], resolution)
    return parameters, cov, facts
