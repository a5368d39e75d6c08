"""A scan beside its reference: a mesh, or parallel planes of known heights (P4 7.3, Table 3, Fig. 19 and 20).

A mesh of an object that has parallel planes only leaves shifts along them free, so nearest places have
nothing to converge to. Such an object is compared with its planes: two tilts and a height are adjusted.

One profile of the scan is judged by itself (`single_profile`).

**Alignment** of a scan with a reference mesh, and whole scan lines that lie off (P4 7.3). The motion begins
from picked pairs and goes on by iterated nearest places. Each turn takes the tangential plane at the nearest
place of each point (Chen and Medioni 1992) and adjusts a shift and a small rotation through
`thalweg.core.adjustment.solve`, each distance weighted by what is predicted for it; nearest places on the
border of the mesh take no part.

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
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.stats import chi2

from thalweg.clocks import read_number_columns
from thalweg.core import (
    NMAD,
    ArrayB,
    ArrayF,
    ArrayI,
    GeometryError,
    InputError,
    Linear,
    Observations,
    Rigid,
    UnobservableError,
    adjust,
    column,
    frame_of,
    plane_rates,
    robust_sigma,
    root_mean_square,
    table_kind,
)
from thalweg.core.geometry import fit_points
from thalweg.lightsheet.lines import LineFlag
from thalweg.lightsheet.optics import Sensor
from thalweg.lightsheet.poses import M_PER_MM, SensorPoses
from thalweg.lightsheet.scanning.distances import (
    MAX_DISTANCE_MM,
    RULES,
    TABLE_2,
    TABLE_3,
    MeshDistances,
    bimodality,
    border_effect,
    consistency,
    filtered,
    mesh_distances,
    normality,
)
from thalweg.lightsheet.scanning.levels import NEAR_MM, Levels, fit_levels
from thalweg.lightsheet.scanning.profile import (
    ScanCloud,
    independent_share,
    merge,
    profile_of_table,
    profiles,
    sigma_along,
)
from thalweg.surface import Surface

# ---------------------------------------------------------------- alignment with a mesh

MOST_POINTS: Final = 20_000
_PICKED_MM: Final = 8.0
"""How far points may lie from the mesh after the picked pairs alone."""
_OFF_OBJECT_MM: Final = 4.0
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


def align(cloud: ScanCloud, surface: Surface, start: Rigid, *, start_mm: float = _PICKED_MM) -> Alignment:
    """Align a scan with a mesh.

    Parameters
    ----------
    cloud : in the frame of its poses.
    surface : the reference in its own frame, metres.
    start : approximate ``T_mesh_target``, such as that of `from_pairs`.
    start_mm : how far points may lie from the mesh at the start; the limit narrows down to
        `MAX_DISTANCE_MM`.

    Raises
    ------
    UnobservableError : the surface leaves motions free, such as shifts along a plane.
    GeometryError : too few points near the mesh, or no convergence.
    """
    step = max(1, len(cloud) // MOST_POINTS)
    few = cloud.where(np.arange(len(cloud)) % step == 0)
    T, limit, moved_mm, turns = start, max(start_mm, MAX_DISTANCE_MM), np.inf, 0
    kept, sigma0 = np.zeros(len(few), dtype=np.bool_), 1.0
    while turns < _TURNS:
        here = few.moved(T)
        found = mesh_distances(here, surface, max_distance_mm=limit)
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
        narrow = max(MAX_DISTANCE_MM, 6.0 * NMAD * float(np.median(np.abs(d))))
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
    last = mesh_distances(here, surface, max_distance_mm=limit)
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
    return of_all(done, cloud, surface)


def of_all(found: Alignment, cloud: ScanCloud, surface: Surface) -> Alignment:
    """The same motion applied to all points; shared sigmas are what the alignment leaves of them."""
    T = found.T_mesh_target
    whole = cloud.moved(T)
    distances = mesh_distances(whole, surface)
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


def check_lines(cloud: ScanCloud, found: MeshDistances) -> LineCheck:
    """Find lines whose distances do not agree with the covariance of their pose.

    Parameters
    ----------
    cloud, found : points in the frame of the reference, and their distances. Lines with fewer than
        `LEAST_POINTS` points on the reference are not judged.
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
    limit = scale * float(chi2.isf(LEVEL / max(int(judged.sum()), 1), _DEGREES))
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


# ---------------------------------------------------------------- comparison

_MOST_BAD: Final = 0.4
_ROUNDS: Final = 3


PUBLISHED_NAMES: Final = {"stepped": "stepped_object"}
"""Scan -> object in the published tables, where they differ."""

_LEVELS_OFF: Final = 3.0
_LEAST_OFF_MM: Final = 0.4
"""Scatter about the common planes, in that about planes of their own and in mm, that only wrong heights
leave."""

_LEAST_ON_LEVEL: Final = 10
_MANY_BESIDE: Final = 0.3

PAIR_COLUMNS: Final = tuple(f"{where}_{a}_m" for where in ("scan", "mesh") for a in "xyz")

SCAN_DISTANCES: Final = table_kind(
    "scan_distances",
    1,
    [
        column("file", "1", "name of the image", pa.string()),
        *(column(f"{a}_m", "m", f"{a} in the frame of the reference") for a in "xyz"),
        column("distance_mm", "mm", "signed distance from the reference, positive in front of it"),
        column("sigma_mm", "mm", "its predicted standard deviation"),
        column("sigma_own_mm", "mm", "share of the image measurement"),
        column("sigma_pose_mm", "mm", "share of the pose of the image"),
        column("peak_dn", "1", "height of the line above its background"),
        column("flags", "1", "as in the line points", pa.uint8()),
        column("used", "1", "the point has a counterpart and its line a good pose", pa.bool_()),
        column("reason", "1", "why it is not used: far, at_border, bad_pose", pa.string()),
    ],
)
"""Points of a scan with their distances."""

DOUBT: Final = 25.0
"""Median of the lines' statistics over its expectation: half of the lines are off by five sigmas."""

Pairs = tuple[ArrayF, ArrayF]

_TO_CHECK: Final = (
    "Check that images and poses belong together and are in one order, the index of the water, and that no "
    "picture is turned or mirrored"
)
TILT_SIGMA_RAD: Final = 0.003
"""How well the window stands parallel to the levels: a single line tells no tilt across itself."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanResult:
    """Result of `scan_against_mesh`.

    ``alignment`` of the lines with good poses; ``distances`` and ``check`` of all points and lines, in the
    frame of the mesh; ``used`` (n,) points of good lines that have a counterpart.
    """

    alignment: Alignment
    check: LineCheck
    used: ArrayB

    @property
    def distances(self) -> MeshDistances:
        """Distances of all points."""
        return self.alignment.distances

    @property
    def distance_mm(self) -> ArrayF:
        """Distances of the points that count."""
        return self.distances.distance_mm[self.used]

    def table(self) -> pd.DataFrame:
        """All outlier rules, with the lines of bad poses and without them."""
        return _by_rule(self.alignment.cloud, self.distances, self.used)

    def facts(self) -> dict[str, Any]:
        """Everything else a report states."""
        found = self.alignment
        return _shared_facts(found.cloud, self.distances, self.check, self.used, found.sigma0) | {
            "turns": found.turns,
            "sigma_turn_deg": np.rad2deg(found.T_mesh_target.sigma_rotation_rad).tolist(),
            "border": border_effect(self.distances),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """A scan in the frame of its reference, distances of all points, lines with bad poses, and facts."""

    cloud: ScanCloud
    distances: MeshDistances
    check: LineCheck
    facts: dict[str, Any]

    @property
    def used(self) -> ArrayB:
        """(n,) points with a counterpart on lines with good poses."""
        return self.distances.used & ~self.check.bad


def scan_against_mesh(cloud: ScanCloud, surface: Surface, start: Rigid) -> ScanResult:
    """Align a scan, find lines with bad poses, align again without them.

    Parameters
    ----------
    cloud, surface, start : see `align`.

    Raises
    ------
    GeometryError : more than 40 % of the lines lie off, or see `align`.
    UnobservableError : see `align`.
    """
    found = align(cloud, surface, start)
    check = check_lines(found.cloud, found.distances)
    for _ in range(_ROUNDS):
        if not check.bad.any():
            break
        judged = int(np.isfinite(check.table["statistic"]).sum())
        if len(check.images) > _MOST_BAD * judged:
            raise GeometryError(
                f"{len(check.images)} of {judged} lines lie off by more than their poses explain",
                expected="a few bad poses at most",
                where="scan against its reference",
                cure="Check that images and poses belong together (files in one order, nothing renamed), and "
                "that the panel was not moved on the sensor",
            )
        good = align(cloud.where(~check.bad), surface, found.T_mesh_target, start_mm=MAX_DISTANCE_MM)
        found = of_all(good, cloud, surface)
        again = check_lines(found.cloud, found.distances)
        if again.images == check.images:
            check = again
            break
        check = again
    return ScanResult(alignment=found, check=check, used=found.distances.used & ~check.bad)


def read_pairs(path: Path) -> tuple[ArrayF, ArrayF]:
    """Picked places (n, 3) of scan and mesh, metres, from a CSV table.

    Raises
    ------
    InputError : the file is missing, or lacks a column or a number.
    """
    columns = read_number_columns(path, PAIR_COLUMNS)
    return np.stack(columns[:3], axis=1), np.stack(columns[3:], axis=1)


def compare_with_mesh(cloud: ScanCloud, surface: Surface, pairs: tuple[ArrayF, ArrayF]) -> Compared:
    """Align a scan with a mesh and measure distances, see `scan_against_mesh`.

    Parameters
    ----------
    cloud : in the frame of its poses.
    surface : of the reference.
    pairs : picked places, see `read_pairs`.
    """
    found = scan_against_mesh(cloud, surface, from_pairs(*pairs))
    T = found.alignment.T_mesh_target
    facts = {
        "reference": "mesh",
        **found.facts(),
        "R_reference_target": T.R.tolist(),
        "shift_reference_target_m": T.shift_m.tolist(),
    }
    return Compared(cloud=found.alignment.cloud, distances=found.distances, check=found.check, facts=facts)


def compare_with_levels(
    cloud: ScanCloud, surface: Surface, heights_mm: tuple[float, ...], pairs: tuple[ArrayF, ArrayF]
) -> Compared:
    """Distances of a scan from parallel planes that are fitted to it.

    Parameters
    ----------
    cloud : in the frame of its poses.
    surface : mesh of the object: points that lie farther than 4 mm from it after the pairs alone are not on
        the object. The ground around it may be nearer to a level than the next level is.
    heights_mm : of the planes, growing.
    pairs : picked places; they tell which way is up, the planes tell the rest.

    Raises
    ------
    GeometryError : see `fit_levels`; levels that are plane each, but do not lie at these heights.
    """
    T = from_pairs(*pairs)
    here = cloud.moved(T, "reference")
    up = np.array([0.0, 0.0, 1.0])
    own, _, _ = here.variances_along(np.tile(up, (len(here), 1)))
    on = mesh_distances(here, surface, max_distance_mm=_OFF_OBJECT_MM).used
    found = fit_levels(
        here.xyz_m[on] / M_PER_MM, up, heights_mm=heights_mm, sigma_mm=np.sqrt(own[on]) / M_PER_MM
    )
    _require_heights(found, heights_mm)
    distance, far = np.full(len(here), NEAR_MM), np.ones(len(here), dtype=np.bool_)
    distance[on], far[on] = np.nan_to_num(found.distance_mm, nan=NEAR_MM), ~found.used
    normal = np.tile(found.normal, (len(here), 1))
    single, pose, _ = here.variances_along(normal)
    distances = MeshDistances(
        distance_mm=distance,
        normal=normal,
        sigma_own_mm=np.sqrt(single) / M_PER_MM,
        sigma_pose_mm=np.sqrt(pose) / M_PER_MM,
        # errors that all points share shift and tilt the planes with them; how they bend them is left out
        sigma_shared_mm=np.zeros(len(here)),
        sigma_reference_mm=np.zeros(len(here)),
        at_border=np.zeros(len(here), dtype=np.bool_),
        far=far,
    )
    check = check_lines(here, distances)
    used = distances.used & ~check.bad
    sigma0 = float(np.sqrt(found.adjusted.sigma0_squared))
    facts = _shared_facts(here, distances, check, used, sigma0) | {
        "reference": "planes",
        "levels": level_facts(found, heights_mm),
        "warnings": level_warnings(found, heights_mm),
        "R_reference_target": T.R.tolist(),
        "shift_reference_target_m": T.shift_m.tolist(),
    }
    return Compared(cloud=here, distances=distances, check=check, facts=facts)


def level_warnings(found: Levels, heights_mm: tuple[float, ...]) -> list[str]:
    """What a reader must know of the levels: some without points, or many points on none."""
    told = []
    empty = [h for h, n in zip(heights_mm, found.plane_n, strict=True) if n < _LEAST_ON_LEVEL]
    if empty:
        told.append(
            f"hardly a point lies on the level at {', '.join(f'{h:g}' for h in empty)} mm: it was not "
            "scanned, or lies at another height"
        )
    beside = int((~found.used).sum())
    if beside > _MANY_BESIDE * len(found.used):
        told.append(
            f"{beside} of {len(found.used)} points on the object lie on none of its levels: check "
            "light_sheet.levels_mm"
        )
    return told


def _by_rule(cloud: ScanCloud, distances: MeshDistances, used: ArrayB) -> pd.DataFrame:
    """All outlier rules, with the lines of bad poses and without them."""
    rows = []
    for lines, keep in (("all lines", distances.used), ("without bad poses", used)):
        n = len(np.unique(cloud.number[keep]))
        d = distances.distance_mm[keep]
        rows += [{"points": lines, "lines": n, **filtered(d, rule).row()} for rule in RULES]
    return pd.DataFrame(rows)


def _shared_facts(
    cloud: ScanCloud, distances: MeshDistances, check: LineCheck, used: ArrayB, sigma0: float
) -> dict[str, Any]:
    """What is stated of distances from a mesh and of those from planes."""
    share = cloud.where(used).independent_share
    return {
        "counts": {
            **cloud.counts,
            **distances.counts(),
            "on_bad_lines": int((distances.used & check.bad).sum()),
        },
        "images_left_out": cloud.left_out,
        "images_with_bad_pose": check.images,
        "line_limit_scale": check.scale,
        "sigma0": sigma0,
        "shape": normality(distances.distance_mm[used], share),
        "consistency": consistency(distances.distance_mm, distances.sigma_mm, used),
        "independent_share": share,
    }


def level_facts(found: Levels, heights_mm: tuple[float, ...]) -> list[dict[str, float]]:
    """Height of each level over the first plane beside the stated one, and RMS from a plane of its own."""
    return [
        {"height_mm": float(h), "measured_mm": float(m), "rms_own_plane_mm": float(r), "n": int(n)}
        for h, m, r, n in zip(
            heights_mm, found.plane_height_mm, found.plane_rms_mm, found.plane_n, strict=True
        )
    ]


def statistics(found: Compared, name: str) -> pd.DataFrame:
    """All outlier rules with all lines and without bad poses, beside P4 Table 3 where it has the object."""
    rows = _by_rule(found.cloud, found.distances, found.used)
    return pd.concat([rows, published(name, TABLE_3)], ignore_index=True)


def published(name: str, table: pd.DataFrame = TABLE_2) -> pd.DataFrame:
    """Row of a published table for an object, with the columns of `statistics`; empty if it has none."""
    known = table[table["object"] == PUBLISHED_NAMES.get(name, name)]
    share = known["n_kept"] / known["n"]
    return known.drop(columns="object").assign(points="published", rule="3 sigma", share_kept=share)


def distance_table(found: Compared) -> pd.DataFrame:
    """Table of kind `SCAN_DISTANCES`."""
    cloud, d = found.cloud, found.distances
    reason = np.select([d.far, d.at_border, found.check.bad], ["far", "at_border", "bad_pose"], default="")
    names = np.array(cloud.poses.images, dtype=object)
    return frame_of(
        SCAN_DISTANCES,
        {
            "file": names[cloud.number],
            **{f"{a}_m": cloud.xyz_m[:, i] for i, a in enumerate("xyz")},
            "distance_mm": d.distance_mm,
            "sigma_mm": d.sigma_mm,
            "sigma_own_mm": d.sigma_own_mm,
            "sigma_pose_mm": d.sigma_pose_mm,
            "peak_dn": cloud.peak_dn,
            "flags": cloud.flags,
            "used": found.used,
            "reason": reason.astype(object),
        },
    )


def to_reference(facts: dict[str, Any]) -> Rigid:
    """Motion from the frame of the poses to that of the reference, as the facts of a comparison have it."""
    return Rigid(
        R=np.asarray(facts["R_reference_target"], dtype=np.float64),
        shift_m=np.asarray(facts["shift_reference_target_m"], dtype=np.float64),
    )


def compare_scan(
    sensor: Sensor,
    line_points: pd.DataFrame,
    poses: SensorPoses,
    surface: Surface,
    pairs: Pairs,
    levels_mm: tuple[float, ...] | None = None,
) -> Compared:
    """Compare a scan with its reference.

    Parameters
    ----------
    sensor : calibrated.
    line_points : of all images, `thalweg.lightsheet.poses.series.SERIES_POINTS`.
    poses : of the images.
    surface : reference mesh.
    pairs : picked places, see `thalweg.lightsheet.scanning.compare.read_pairs`.
    levels_mm : heights of the planes of an object that consists of such; None: compared with the mesh.

    Returns
    -------
    Compared; its facts have ``brightness`` (`thalweg.lightsheet.scanning.distances`) and ``warnings``.

    Raises
    ------
    InputError : no image gives a point, or none has a pose.
    GeometryError : scan and reference contradict each other.
    """
    cloud = merge(profiles(sensor, line_points)[0], poses)
    try:
        if levels_mm is None:
            found = compare_with_mesh(cloud, surface, pairs)
        else:
            found = compare_with_levels(cloud, surface, levels_mm, pairs)
    except GeometryError as error:
        where = error.where or "scan against its reference"
        cure = f"{error.cure}. {_TO_CHECK}"
        raise GeometryError(error.found, expected=error.expected, where=where, cure=cure) from error
    warnings = found.facts.setdefault("warnings", [])
    found.facts["brightness"], bias = _by_brightness(found)
    if bias:
        warnings.append(bias)
    if found.check.scale >= DOUBT:
        warnings.append(
            f"half of the lines lie off the reference by more than {np.sqrt(found.check.scale):.0f} times "
            f"what their poses explain: no line can be told from the others by its pose. {_TO_CHECK}"
        )
    return found


def middle_image(distances: pd.DataFrame) -> str:
    """Name of the image in the middle of a scan, among those that have at least half of the most points.

    Parameters
    ----------
    distances : `thalweg.lightsheet.scanning.compare.SCAN_DISTANCES`.

    Raises
    ------
    InputError : no point is used.
    """
    counts = distances[distances["used"]].groupby("file", sort=False).size()
    if not len(counts):
        raise InputError("no point of the scan is used", expected="points on the reference", where="profile")
    full = counts[counts >= 0.5 * counts.max()].index
    return str(full[len(full) // 2])


def single_profile(
    sensor: Sensor,
    line_points: pd.DataFrame,
    distances: pd.DataFrame,
    name: str,
    heights_mm: tuple[float, ...] | None = None,
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Statistics of the scan's middle profile.

    Parameters
    ----------
    sensor : calibrated.
    line_points : of all images of the scan.
    distances : of the scan from its reference; for an object without levels its alignment counts for the
        profile too, because a line alone leaves the motion along a surface free.
    name : of the scan.
    heights_mm : levels of the object, which are then fitted to this line alone.

    Returns
    -------
    A row for each outlier rule and the published one, and facts: image, levels, bimodality.
    """
    image = middle_image(distances)
    facts: dict[str, Any] = {"image": image}
    if heights_mm is None:
        mine = distances[(distances["file"] == image) & distances["used"]]
        d, peak = mine["distance_mm"].to_numpy(), mine["peak_dn"].to_numpy()
        share = 1.0 / max(float(line_points["rows"][line_points["file"] == image].mean()), 1.0)
    else:
        one = profile_of_table(sensor, line_points, image)
        up = sensor.window.normal_lcs
        own, _ = sigma_along(one.own_mm, one.shared_mm, up)
        found = fit_levels(
            one.xyz_lcs_mm, up, heights_mm=heights_mm, sigma_mm=own, tilt_sigma_rad=TILT_SIGMA_RAD
        )
        on = found.used
        d, peak = found.distance_mm[on], one.peak_dn[on]
        share = independent_share(one.rows[on], one.piece[on])
        facts |= {"levels": level_facts(found, heights_mm), "points_on_no_level": int((~on).sum())}
    rows = pd.DataFrame([{"points": "middle line", "lines": 1, **filtered(d, rule).row()} for rule in RULES])
    try:
        facts["bimodality"] = bimodality(d, peak, independent_share=share).words()
    except GeometryError as error:
        facts["bimodality"] = error.found
    facts["rms_mm"] = root_mean_square(d)
    return pd.concat([rows, published(name, TABLE_2)], ignore_index=True), facts


def _require_heights(found: Levels, heights_mm: tuple[float, ...]) -> None:
    """Refuse heights that are not those of the object: a tilt then takes up the mean of their errors."""
    n = np.maximum(found.plane_n - 3, 0)
    if not n.any():
        return
    own = float(np.sqrt(np.nansum(n * found.plane_rms_mm**2) / n.sum()))
    off = root_mean_square(found.distance_mm[found.used])
    if off > max(_LEVELS_OFF * own, _LEAST_OFF_MM):
        raise GeometryError(
            f"each level is plane to {own:.2f} mm, but together they lie {off:.2f} mm off planes at "
            f"{', '.join(f'{h:g}' for h in heights_mm)} mm",
            expected="levels at these heights",
            where="levels",
            cure="Check light_sheet.levels_mm of this scan, and the refractive indices of the sensor",
        )


def _by_brightness(found: Compared) -> tuple[dict[str, float | bool | str], str]:
    """Whether brightness shifts the distances (P4 7.2), and a warning if by more than they scatter."""
    on = found.used
    d, bright = found.distances.distance_mm[on], (found.cloud.flags[on] & LineFlag.SATURATED) != 0
    try:
        modes = bimodality(
            d,
            found.cloud.peak_dn[on],
            independent_share=found.cloud.where(on).independent_share,
            bright=bright if 3 <= bright.sum() <= len(bright) - 3 else None,
        )
    except GeometryError as error:
        return {"words": error.found}, ""
    facts: dict[str, float | bool | str] = {
        "shift_mm": modes.shift_mm,
        "sigma_shift_mm": modes.sigma_shift_mm,
        "by_brightness": modes.by_brightness,
        "two_modes": modes.bimodal,
        "words": modes.words(),
    }
    nmad = robust_sigma(d)
    if not modes.by_brightness or abs(modes.shift_mm) < nmad:
        return facts, ""
    what = "over-exposed" if np.isnan(modes.threshold_dn) else "bright"
    return facts, (
        f"{what} points lie {modes.shift_mm:+.2f} mm from the others, which scatter by {nmad:.2f} mm: the "
        "line is measured aside there (P4 7.2); expose shorter, or cover white markers"
    )
