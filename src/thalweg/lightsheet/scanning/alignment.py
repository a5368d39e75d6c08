"""Alignment of a scan with a reference mesh, and whole scan lines that lie off (P4 7.3).

The motion begins from picked pairs and goes on by iterated nearest places. Each turn takes the tangential
plane at the nearest place of each point (Chen and Medioni 1992) and adjusts a shift and a small rotation
through `thalweg.core.adjustment.solve`, each distance weighted by what is predicted for it; nearest places on
the border of the mesh take no part.

Points of a line share the error of their pose, and all points share those of the sensor; the adjustment knows
nothing of that. The covariance of the motion therefore is not that of the normal equations but ::

    K S K^T,    K = N^-1 A^T W,    S = own errors (with their neighbours) + poses + shared errors

**Lines whose poses are worse than their sigmas say.** For each line its distances from the reference give a
mean and a slope along the line. Both are predicted by the covariance of the line's pose and by the errors of
its points::

    e = B^+ d,     Cov e = B^+ (G C_pose G^T + own errors) B^+^T,     T = e^T Cov^-1 e

with ``B = [1, s]``. T follows a chi-square distribution of two degrees of freedom if the pose is as good as
stated. The limit scales with the median of T over all lines where that is larger than expected: errors that
all lines have, such as those of the sensor, do not make a pose bad.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import chi2

from thalweg.core import (
    NMAD,
    ArrayB,
    ArrayF,
    ArrayI,
    GeometryError,
    Linear,
    Observations,
    Rigid,
    UnobservableError,
    adjust,
    plane_rates,
    root_mean_square,
)
from thalweg.core.geometry import fit_points
from thalweg.lightsheet.poses import M_PER_MM
from thalweg.lightsheet.scanning.distances import MAX_DISTANCE_MM, MeshDistances, mesh_distances
from thalweg.lightsheet.scanning.profile import ScanCloud
from thalweg.surface import Surface

MOST_POINTS: Final = 20_000
_LEAST_POINTS: Final = 50
_STEP_NMAD: Final = 0.02
"""Largest motion of a point in the last turn, as a share of the scatter of distances."""
_TURNS: Final = 60
_WHOLE_STEPS: Final = 15
_NAMES: Final = ("shift x", "shift y", "shift z", "turn about x", "turn about y", "turn about z")
_REJECT: Final = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Alignment:
    """Result of `align`.

    ``T_mesh_target`` brings the scan onto the mesh, with the covariance of everything that is known;
    ``cov_fit`` (6, 6) the part of it that other lines of the same sensor would change (no shared errors);
    ``by_shared`` (6, k) change of the motion by each shared error;
    ``cloud`` and ``distances`` of all points, aligned; ``sigma0`` of the last adjustment; ``turns``, ``n``
    points that took part; ``last_step_mm`` largest motion of a point in the last turn.
    """

    T_mesh_target: Rigid
    cov_fit: ArrayF
    by_shared: ArrayF
    cloud: ScanCloud
    distances: MeshDistances
    sigma0: float
    turns: int
    n: int
    last_step_mm: float

    @property
    def sigma_shift_mm(self) -> ArrayF:
        """(3,) of a shift of the middle of the points."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.cov_fit)[:3], 0.0)) / M_PER_MM)


def from_pairs(scan_m: ArrayF, mesh_m: ArrayF) -> Rigid:
    """Rigid motion that brings picked points of a scan (n, 3) onto those of a mesh (n, 3) (Kabsch 1976).

    Raises
    ------
    GeometryError : fewer than three pairs, pairs on a line, or pairs that are no motion of each other.
    """
    a, b = np.asarray(scan_m, dtype=np.float64), np.asarray(mesh_m, dtype=np.float64)
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] != 3 or len(a) < 3:
        raise GeometryError(f"picked points {a.shape} and {b.shape}", expected="three and more pairs")
    spread = np.linalg.svd(a - a.mean(axis=0), compute_uv=False)
    if spread[1] < 0.05 * spread[0]:
        raise GeometryError("the picked points lie on a line", expected="points that span the object")
    R, shift_m, _ = fit_points(a, b)
    off = b - a @ R.T - shift_m
    rms = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    if rms > 0.2 * float(spread[0]) / np.sqrt(len(a)):
        raise GeometryError(
            f"the pairs differ by {1e3 * rms:.1f} mm after the best motion",
            expected="the same points in both lists, in the same order",
            where="picked pairs",
        )
    return Rigid(R=R, shift_m=shift_m)


def align(
    cloud: ScanCloud,
    surface: Surface,
    start: Rigid,
    *,
    start_mm: float = 8.0,
    max_distance_mm: float = MAX_DISTANCE_MM,
    reference_sigma_mm: float = 0.0,
) -> Alignment:
    """Align a scan with a mesh.

    Parameters
    ----------
    cloud : in the frame of its poses.
    surface : the reference in its own frame, metres.
    start : approximate ``T_mesh_target``, such as that of `from_pairs`.
    start_mm : how far points may lie from the mesh at the start; the limit narrows down to
        ``max_distance_mm``.
    max_distance_mm, reference_sigma_mm : see `mesh_distances`.

    Raises
    ------
    UnobservableError : the surface leaves motions free, such as shifts along a plane.
    GeometryError : too few points near the mesh, or no convergence.
    """
    step = max(1, len(cloud) // MOST_POINTS)
    few = cloud.where(np.arange(len(cloud)) % step == 0)
    T, limit, moved_mm, turns = start, max(start_mm, max_distance_mm), np.inf, 0
    kept, sigma0 = np.zeros(len(few), dtype=np.bool_), 1.0
    while turns < _TURNS:
        here = few.moved(T)
        found = mesh_distances(here, surface, max_distance_mm=limit, reference_sigma_mm=reference_sigma_mm)
        if found.used.sum() < _LEAST_POINTS:
            raise GeometryError(
                f"{int(found.used.sum())} of {len(here)} points lie within {limit:.1f} mm of the mesh",
                expected=f"at least {_LEAST_POINTS}",
                where="alignment with the reference",
                cure="Give a better start: pick points that can be seen in both, and check the units",
            )
        dx, kept, sigma0 = _step(here, found, T.shift_m)
        # points that change between two faces at every turn would swing for ever
        dx = dx if turns < _WHOLE_STEPS else dx / 2
        arms = here.xyz_m - T.shift_m
        T = T.moved(dx)
        far = np.linalg.norm(dx[:3] + np.cross(dx[3:], arms[found.used]), axis=1)
        moved_mm, turns = float(far.max()) / M_PER_MM, turns + 1
        d = found.distance_mm[found.used]
        narrow = max(max_distance_mm, 6.0 * NMAD * float(np.median(np.abs(d))))
        steady = narrow >= limit - 1e-9
        limit = min(limit, narrow)
        if steady and moved_mm < _STEP_NMAD * NMAD * float(np.median(np.abs(d))):
            break
    else:
        raise GeometryError(
            f"no convergence in {_TURNS} turns; the last step was {moved_mm:.3f} mm",
            expected="a start within some millimetres, and surfaces in three directions",
            where="alignment with the reference",
            cure="Give a better start; an object of parallel planes is compared with planes instead",
        )
    here = few.moved(T)
    last = mesh_distances(here, surface, max_distance_mm=limit, reference_sigma_mm=reference_sigma_mm)
    kept &= last.used
    cov_fit, by_shared = _covariances(here.where(kept), last, kept, T.shift_m, step)
    done = Alignment(
        T_mesh_target=T.with_cov(cov_fit + by_shared @ by_shared.T),
        cov_fit=cov_fit,
        by_shared=by_shared,
        cloud=here,
        distances=last,
        sigma0=sigma0,
        turns=turns,
        n=int(kept.sum()),
        last_step_mm=moved_mm,
    )
    return of_all(
        done, cloud, surface, max_distance_mm=max_distance_mm, reference_sigma_mm=reference_sigma_mm
    )


def of_all(
    found: Alignment,
    cloud: ScanCloud,
    surface: Surface,
    *,
    max_distance_mm: float = MAX_DISTANCE_MM,
    reference_sigma_mm: float = 0.0,
) -> Alignment:
    """The same motion applied to all points of a scan; shared sigmas are what the alignment leaves of them.

    Parameters are those of `align`.
    """
    T = found.T_mesh_target
    whole = cloud.moved(T)
    distances = mesh_distances(
        whole, surface, max_distance_mm=max_distance_mm, reference_sigma_mm=reference_sigma_mm
    )
    left = whole.shared_rates(distances.normal) - _rates(whole, distances.normal, T.shift_m) @ found.by_shared
    sigma_mm = np.linalg.norm(left, axis=1) / M_PER_MM
    return replace(found, cloud=whole, distances=distances.with_shared(sigma_mm))


def _rates(cloud: ScanCloud, normal: ArrayF, origin_m: ArrayF) -> ArrayF:
    """(n, 6) change of distances with the error (shift, turn) of the motion, as `Rigid.moved` counts it."""
    return plane_rates(normal, cloud.xyz_m - origin_m)


def _step(cloud: ScanCloud, found: MeshDistances, shift_m: ArrayF) -> tuple[ArrayF, ArrayB, float]:
    """Motion (6,) about the middle of the points, who took part (n,), sigma of unit weight.

    The turn of `Rigid.moved` is about the origin of the scan's frame; unknowns are about the middle of the
    points, where shift and turn are not correlated.
    """
    use = np.flatnonzero(found.used)
    normal, centre = found.normal[use], cloud.xyz_m[use].mean(axis=0)
    A = _rates(cloud.where(use), normal, centre)
    d, variance = found.distance_mm[use] * M_PER_MM, (found.sigma_mm[use] * M_PER_MM) ** 2

    def planes(x: ArrayF) -> Linear:
        """Distances from the tangential planes."""
        return Linear(residual=d + A @ x, jacobian=A, cov=variance)

    try:
        done = adjust(
            [Observations("distances", planes)], np.zeros(6), _NAMES, loss="huber", reject_sigmas=_REJECT
        )
    except UnobservableError as error:
        raise UnobservableError(
            error.parameters,
            defects=error.defects,
            cure="Align on an object with surfaces in three directions, or compare with planes",
        ) from error
    kept = np.zeros(len(cloud), dtype=np.bool_)
    kept[use] = done.used["distances"]
    dx = np.concatenate([done.x[:3] + np.cross(done.x[3:], shift_m - centre), done.x[3:]])
    return dx, kept, float(np.sqrt(done.sigma0_squared))


def _covariances(
    cloud: ScanCloud, found: MeshDistances, kept: ArrayB, shift_m: ArrayF, step: int
) -> tuple[ArrayF, ArrayF]:
    """Covariance (6, 6) of the motion by own errors and poses, and its change (6, k) by each shared error.

    ``cloud`` are the points that took part, ``found`` and ``kept`` belong to all that were asked.
    """
    normal = found.normal[kept]
    A = _rates(cloud, normal, shift_m)
    weight = 1.0 / (found.sigma_mm[kept] * M_PER_MM) ** 2
    N = A.T @ (weight[:, None] * A)
    K = np.linalg.solve(N, (weight[:, None] * A).T)
    neighbours = max(1.0 / cloud.independent_share / step, 1.0)
    single = neighbours * found.sigma_own_mm[kept] ** 2 + found.sigma_reference_mm[kept] ** 2
    cov = (K * (single * M_PER_MM**2)) @ K.T
    by_pose = cloud.pose_rates(normal)
    for k in np.unique(cloud.number):
        own = cloud.number == k
        moved = K[:, own] @ by_pose[own]
        cov += moved @ cloud.poses.cov[k] @ moved.T
    return np.asarray((cov + cov.T) / 2), np.asarray(K @ cloud.shared_rates(normal))


LEVEL: Final = 0.01
"""Probability with which a scan without bad poses gets one marked."""

LEAST_POINTS: Final = 30
_CUT_NMAD: Final = 5.0
_DEGREES: Final = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class LineCheck:
    """Result of `check_lines`.

    ``table`` one row for each image: image, number, n, mean_mm, sigma_mean_mm (predicted), slope_mm (half the
    change along the line), sigma_slope_mm, statistic, limit, bad, reason; ``scale`` by which the limit was
    widened; ``bad`` (n,) points of bad lines.
    """

    table: pd.DataFrame
    scale: float
    bad: ArrayB

    @property
    def images(self) -> list[str]:
        """Names of the images with bad poses."""
        return [str(name) for name in self.table["image"][self.table["bad"]]]


def check_lines(cloud: ScanCloud, found: MeshDistances, *, level: float = LEVEL) -> LineCheck:
    """Find lines whose distances do not agree with the covariance of their pose.

    Parameters
    ----------
    cloud, found : points in the frame of the reference, and their distances. Lines with fewer than
        `LEAST_POINTS` points on the reference are not judged.
    level : probability of a false alarm in the whole scan.
    """
    rates = cloud.pose_rates(found.normal) / M_PER_MM
    rows = []
    for k in range(len(cloud.poses)):
        on = np.flatnonzero((cloud.number == k) & found.used)
        row = {"image": cloud.poses.images[k], "number": k, "n": len(on)}
        if len(on) < LEAST_POINTS:
            rows.append({**row, "reason": f"fewer than {LEAST_POINTS} points on the reference"})
            continue
        rows.append({**row, **_line(cloud, found, rates, on), "reason": ""})
    columns = [
        "image",
        "number",
        "n",
        "mean_mm",
        "sigma_mean_mm",
        "slope_mm",
        "sigma_slope_mm",
        "statistic",
        "reason",
    ]
    table = pd.DataFrame(rows, columns=columns)
    values = table["statistic"].to_numpy(np.float64)
    judged = np.isfinite(values)
    scale = 1.0
    if judged.sum() >= 3:
        scale = max(1.0, float(np.median(values[judged])) / float(chi2.median(_DEGREES)))
    limit = scale * float(chi2.isf(level / max(int(judged.sum()), 1), _DEGREES))
    table["limit"] = limit
    table["bad"] = judged & (np.nan_to_num(values) > limit)
    bad_numbers: ArrayI = table["number"].to_numpy(np.int64)[table["bad"].to_numpy()]
    return LineCheck(table=table, scale=scale, bad=np.isin(cloud.number, bad_numbers))


def _line(cloud: ScanCloud, found: MeshDistances, rates: ArrayF, on: ArrayI) -> dict[str, float]:
    """Mean and slope of one line, their predicted sigmas, and the statistic."""
    d = found.distance_mm[on]
    away = np.abs(d - np.median(d))
    on = on[away <= _CUT_NMAD * max(NMAD * float(np.median(away)), 1e-6)]
    d = found.distance_mm[on]
    X = cloud.xyz_m[on] - cloud.xyz_m[on].mean(axis=0)
    along = X @ np.linalg.svd(X, full_matrices=False)[2][0]
    half = max(float(np.abs(along).max()), 1e-9)
    B = np.stack([np.ones(len(on)), along / half], axis=1)
    back = np.linalg.pinv(B)
    e = back @ d
    by_pose = back @ rates[on]
    # what the image measurement leaves: predicted, or what the line shows where that is more
    single = np.hypot(found.sigma_own_mm[on], found.sigma_reference_mm[on])
    seen = float(np.std(d - B @ e)) / max(root_mean_square(single), 1e-12)
    variance = (single * max(seen, 1.0)) ** 2 / cloud.where(on).independent_share
    cov = by_pose @ cloud.poses.cov[cloud.number[on[0]]] @ by_pose.T + (back * variance) @ back.T
    sigma = np.sqrt(np.diag(cov))
    return {
        "mean_mm": float(e[0]),
        "sigma_mean_mm": float(sigma[0]),
        "slope_mm": float(e[1]),
        "sigma_slope_mm": float(sigma[1]),
        "statistic": float(e @ np.linalg.solve(cov, e)),
    }
