"""Where a block lies in the world: a similarity from control points or from approximate camera positions.

The frame of structure from motion has any scale and attitude. Three points that are not on a line fix it;
more points tell which of them are wrong before the adjustment takes them for true.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Final

import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.images.model.block import ImageBlock
from thalweg.images.model.control_points import ControlMarks, ControlPoints

FAR_M: Final = 10_000.0
"""Distance of control points from a block whose place is known beyond which the coordinates are others."""
_FIT_SHARE: Final = 0.03
"""Misfit of a point, as a share of the extent of all, that a bent model may have."""
_LEAST_FIT_M: Final = 0.3
_LINE_SHARE: Final = 0.01
"""Spread across the longest direction, as a share of that along it, below which points are a line."""
_CROSSED: Final = 0.3
"""Distance of two points from each other's coordinates, as a share of their own: swapped up to it."""
_MOST_TRIPLES: Final = 2000
_MOST_PAIRS: Final = 150
_LEAST_ANGLE_RAD: Final = 0.003
"""Rays that meet within so much are never called wrong: two pixels of a wide lens."""
CURE_LINE: Final = (
    "Add a control point off the line, at another height or farther up the bank, or positions of the camera "
    "from a track that is not straight"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Similarity:
    """``x_target = scale R x_source + shift``, and how points fit it.

    ``misfit_m`` (n,) distance of each point; ``fits`` (n,) those that made it; ``notes`` for people.
    """

    scale: float
    R: ArrayF
    shift_m: ArrayF
    misfit_m: ArrayF
    fits: ArrayB
    notes: list[str] = field(default_factory=list)

    def apply(self, points: ArrayF) -> ArrayF:
        """Points (n, 3) of the source in the target frame."""
        return np.asarray(self.scale * points @ self.R.T + self.shift_m)


def similarity(source: ArrayF, target: ArrayF) -> tuple[float, ArrayF, ArrayF]:
    """Scale, rotation and shift of least squares between points (n, 3) (Umeyama 1991)."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    U, S, Vt = np.linalg.svd((target - b).T @ (source - a))
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    R = U @ D @ Vt
    scale = float((S * np.diag(D)).sum() / np.square(source - a).sum())
    return scale, R, b - scale * R @ a


def spread_share(points: ArrayF) -> float:
    """Second extent of points (n, 3) as a share of the first: 0 on a line."""
    s = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(s[1] / s[0]) if s[0] > 0 else 0.0


def is_line(points: ArrayF) -> bool:
    """Whether points (n, 3) lie on a line, as far as a block is concerned that they are to hold."""
    return spread_share(points) < _LINE_SHARE


def robust_similarity(
    source: ArrayF, target: ArrayF, names: Sequence[str], *, what: str, tolerance_m: float | None = None
) -> Similarity:
    """Similarity between points of which some may be wrong.

    All triples, or an evenly spread choice of them, are tried; the one that most points fit wins, and the
    fitting points are adjusted together. Points that do not fit are named with their misfit, and pairs whose
    names look swapped.

    Parameters
    ----------
    source, target : (n, 3) in the frame of the block and in the world.
    names : of the points.
    what : what the points are, for messages.
    tolerance_m : misfit that is still good; None: 3 % of the extent, at least 0.3 m.

    Raises
    ------
    GeometryError : fewer than three points, or all on a line; or fewer than half of them agree.
    """
    n = len(source)
    if n < 3:
        raise GeometryError(
            f"{n} {what} measured in two images or more",
            expected="at least 3 that are not on a line",
            cure="Measure more of them, or give approximate positions of the camera",
        )
    for points in (source, target):
        if is_line(points):
            raise GeometryError(
                f"all {n} {what} lie on a line, about which the block can turn",
                expected=f"a spread across it of {100 * _LINE_SHARE:g} % of its length at least",
                cure=CURE_LINE,
            )
    extent = float(np.linalg.norm(np.ptp(target, axis=0)))
    tolerance = max(_LEAST_FIT_M, _FIT_SHARE * extent) if tolerance_m is None else tolerance_m
    best, fits = -1.0, np.ones(n, np.bool_)
    for triple in _triples(n):
        chosen = list(triple)
        if spread_share(source[chosen]) < 5 * _LINE_SHARE or spread_share(target[chosen]) < 5 * _LINE_SHARE:
            continue
        off = _misfit(similarity(source[chosen], target[chosen]), source, target)
        good = off < tolerance
        score = float(np.maximum(1.0 - np.square(off / tolerance), 0.0).sum())
        if good.sum() >= 3 and score > best:
            best, fits = score, good
    if best < 0 or fits.sum() < max(3, n / 2):
        found = similarity(source, target)
        off = _misfit(found, source, target)
        worst = int(np.argmax(off))
        raise GeometryError(
            f"{what} and the block do not have the same shape: after the best similarity {names[worst]} is "
            f"off by {off[worst]:.2f} m, the median is {np.median(off):.2f} m",
            expected=f"most of them within {tolerance:.2f} m",
            cure="Check the names of the points, the order of the coordinates and their CRS",
        )
    for _ in range(5):
        found = similarity(source[fits], target[fits])
        off = _misfit(found, source, target)
        if np.array_equal(off < tolerance, fits) or (off < tolerance).sum() < 3:
            break
        fits = off < tolerance
    notes = [
        f"{names[i]} is {off[i]:.2f} m away from where the other {what} put it: left out"
        for i in np.flatnonzero(~fits).tolist()
    ]
    scale, R, shift = found
    notes += swapped(scale * source @ R.T + shift, target, names, np.flatnonzero(~fits), tolerance)
    return Similarity(scale=scale, R=R, shift_m=shift, misfit_m=off, fits=fits, notes=notes)


def swapped(
    found: ArrayF, target: ArrayF, names: Sequence[str], wrong: ArrayI, tolerance_m: float
) -> list[str]:
    """Notes on pairs of wrong points of which each lies where the other was surveyed."""

    def crossed(i: int, j: int) -> float:
        """Distance of either from the other's coordinates, beyond belief if they are as near themselves."""
        off = max(np.linalg.norm(found[i] - target[j]), np.linalg.norm(found[j] - target[i]))
        return float(off) if off < _CROSSED * np.linalg.norm(target[i] - target[j]) else np.inf

    return [
        f"The names of {names[i]} and {names[j]} seem to be swapped: each lies within "
        f"{crossed(i, j):.2f} m of the other's coordinates"
        for i, j in combinations(wrong.tolist(), 2)
        if crossed(i, j) < tolerance_m
    ]


def _triples(n: int) -> list[tuple[int, int, int]]:
    triples = list(combinations(range(n), 3)) if n <= 40 else []
    if not triples:
        # evenly over the points: neighbours give poor triples
        rng = np.random.default_rng(n)
        triples = [tuple(sorted(rng.choice(n, 3, replace=False).tolist())) for _ in range(_MOST_TRIPLES)]
    step = max(1, len(triples) // _MOST_TRIPLES)
    return triples[::step]


def _misfit(found: tuple[float, ArrayF, ArrayF], source: ArrayF, target: ArrayF) -> ArrayF:
    scale, R, shift = found
    return np.asarray(np.linalg.norm(scale * source @ R.T + shift - target, axis=1))


def triangulated(block: ImageBlock, marks: ControlMarks, n_points: int) -> ArrayF:
    """(k, 3) points of control marks in the frame of the block; NaN where fewer than two rays meet."""
    out = np.full((n_points, 3), np.nan)
    rays = np.empty((len(marks.image), 3))
    for i, (image, xy) in enumerate(zip(marks.image, marks.xy_px, strict=True)):
        camera = block.cameras[block.camera[image]]
        rays[i] = block.R_block_ccs[image] @ camera.rays(xy[None])[0]
    centres = block.centre_block_m[marks.image]
    for k in range(n_points):
        rows = np.flatnonzero((marks.point == k) & np.isfinite(rays).all(axis=1))
        if len(rows) >= 2:
            out[k] = nearest_to_rays(centres[rows], rays[rows])
    return out


def nearest_to_rays(centres: ArrayF, rays: ArrayF) -> ArrayF:
    """Point (3,) nearest to most of the rays (n, 3); NaN where they are parallel.

    Of the points of all pairs, or an even choice of them, that with the least median angle to all rays tells
    which rays belong together.
    """
    n = len(rays)
    if n <= 2:
        return _meeting(centres, rays)
    pairs = list(combinations(range(n), 2))
    best, least = np.full(3, np.nan), np.inf
    for pair in pairs[:: max(1, len(pairs) // _MOST_PAIRS)]:
        chosen = list(pair)
        point = _meeting(centres[chosen], rays[chosen])
        if not np.isfinite(point).all():
            continue
        # the pair itself fits by itself
        off = float(np.sort(_angles(point, centres, rays))[(n + 2) // 2])
        if off < least:
            best, least = point, off
    if not np.isfinite(least):
        return best
    keep = _angles(best, centres, rays) <= max(3.0 * least, _LEAST_ANGLE_RAD)
    return _meeting(centres[keep], rays[keep])


def _meeting(centres: ArrayF, rays: ArrayF) -> ArrayF:
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    A = across.sum(axis=0)
    if not np.isfinite(A).all() or np.linalg.eigvalsh(A)[0] < 1e-7 * len(rays):
        return np.full(3, np.nan)
    return np.asarray(np.linalg.solve(A, np.einsum("nij,nj->i", across, centres)))


def _angles(point: ArrayF, centres: ArrayF, rays: ArrayF) -> ArrayF:
    away = point - centres
    return np.asarray(
        np.linalg.norm(np.cross(away, rays), axis=1) / np.maximum(np.linalg.norm(away, axis=1), 1e-12)
    )


def start_from_control(block: ImageBlock, control: ControlPoints, marks: ControlMarks) -> Similarity:
    """Similarity from control points that are marked in two images or more; check points stay out of it."""
    found = triangulated(block, marks, len(control.names))
    rows = np.flatnonzero(np.isfinite(found[:, 0]) & ~control.check)
    result = robust_similarity(
        found[rows], control.points_wcs_m[rows], [control.names[i] for i in rows], what="control points"
    )
    fits = np.ones(len(control.names), np.bool_)
    fits[rows] = result.fits
    misfit = np.full(len(control.names), np.nan)
    misfit[rows] = result.misfit_m
    return Similarity(
        scale=result.scale, R=result.R, shift_m=result.shift_m, misfit_m=misfit, fits=fits, notes=result.notes
    )


def start_from_positions(block: ImageBlock, at: ArrayI, positions_wcs_m: ArrayF) -> Similarity:
    """Similarity from approximate positions (n, 3) of the cameras of images ``at`` (n,)."""
    return robust_similarity(
        block.centre_block_m[at], positions_wcs_m, [block.images[i] for i in at], what="camera positions",
        tolerance_m=max(2.0, _FIT_SHARE * float(np.linalg.norm(np.ptp(positions_wcs_m, axis=0)))),
    )  # fmt: skip


def check_place(control: ControlPoints, near_wcs_m: ArrayF) -> None:
    """Raise if control points lie far from where the images were taken.

    Raises
    ------
    GeometryError : a control point is more than 10 km from the middle of ``near_wcs_m`` (n, 3).
    """
    if not len(control.names) or not len(near_wcs_m):
        return
    middle = np.median(near_wcs_m, axis=0)
    away = np.linalg.norm(control.points_wcs_m - middle, axis=1)
    nearest, worst = int(np.argmin(away)), int(np.argmax(away))
    if away[worst] <= FAR_M:
        return
    single = away[nearest] <= FAR_M
    raise GeometryError(
        f"control point {control.names[worst]} lies {away[worst] / 1000:.1f} km from the images"
        + ("" if single else f", and the nearest, {control.names[nearest]}, {away[nearest] / 1000:.1f} km"),
        expected=f"control points within {FAR_M / 1000:g} km",
        cure="Check its coordinates" if single else "Check the CRS of the control points, and campaign.crs",
    )
