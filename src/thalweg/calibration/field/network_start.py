"""Approximate poses and points of a block of marker pictures, without any hand work.

Each sheet of known size has a distance from the camera in each picture. So the picture with the most markers
gives a first rough field; a second picture is resected on the centres of its sheets; from then on saddles are
intersected from the pictures that are known, and picture after picture is resected on them. Planar poses of a
sheet have two solutions that lie close together for a small sheet; only the centre, which hardly depends on
which one is right, is used, and intersection settles the rest.

A wrong mark makes its sheet look like no flat square: the marks of such sheets make no points until the poses
are known. Where too few markers link a picture to the others, three sheets of known distance do.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from thalweg.calibration.markers.mark_block import Block, sheet_centres
from thalweg.calibration.markers.ray_resection import improved_pose, pose_from_rays
from thalweg.calibration.markers.sheets import MarkerLayout
from thalweg.core.errors import GeometryError
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayB, ArrayF, ArrayI

_ROUGH_RAD: Final = 0.06
"""Directions to the centres of sheets from their distances in one other picture."""
_FINE_RAD: Final = 0.01
"""Directions to intersected saddles with nominal interior orientation."""
_LEAST_MARKERS: Final = 4
_LEAST_SADDLES: Final = 7
_LEAST_ANGLE_RAD: Final = 0.03
_FITS_WELL: Final = 0.85
"""Share of fitting marks from which on a picture's pose is taken as right."""
_LEAST_ALIGNED: Final = 3
_ALIGNED: Final = 0.1
"""Median difference of the centres of aligned sheets over the size of their layout."""
_LEAST_WIDTH: Final = 0.05
"""Width of the aligned sheets' layout over their distance: in one line they leave a turn free."""


@dataclass(slots=True)
class Start:
    """Approximate values: poses ``T_pcs_ccs`` by image, points (p, 3), NaN if unknown, images left out."""

    poses: dict[int, Rigid]
    points: ArrayF
    left_out: dict[str, str] = field(default_factory=dict)


def start_network(block: Block, layout: MarkerLayout) -> Start:
    """Approximate values in the frame of one picture; see the module.

    Raises
    ------
    GeometryError : no picture shows enough markers, or no two belong together.
    """
    centres, rays, odd = sheet_centres(block, layout)
    # marks of odd sheets make no points; for a pose, wrong ones among many do no harm
    sure = replace(block, rays=np.where(odd[:, None], np.nan, block.rays))
    count = {i: len(seen) for i, seen in centres.items()}
    if not count or max(count.values()) < _LEAST_MARKERS:
        best = max(count.values(), default=0)
        raise GeometryError(
            f"at most {best} whole markers in one picture",
            expected=f"pictures with {_LEAST_MARKERS} markers or more",
            cure="Take pictures from farther away or with a wider lens, so that each shows several sheets",
        )
    first = max(sorted(count), key=lambda i: count[i])
    start = Start({first: Rigid(R=np.eye(3), shift_m=np.zeros(3))}, np.full((len(block.points), 3), np.nan))
    rough = dict(centres[first])
    waiting = set(range(len(block.images))) - {first}
    next_sweep = 3
    while waiting:
        solved = np.isfinite(start.points[:, 0])
        score = {i: _known(block, i, solved, rough, rays.get(i, {})) for i in sorted(waiting)}
        order = sorted(waiting, key=lambda i: (-max(score[i]), i))
        found = _first((i, _resected(block, i, start, solved, rough, rays.get(i, {}))) for i in order)
        if found is None:
            # a weak link, only where no other is left
            places = rough | _centres(block, start)
            found = _first((i, _aligned(centres.get(i, {}), places)) for i in order)
        if found is None:
            break
        image, pose = found
        start.poses[image] = pose
        waiting.remove(image)
        for marker, centre in centres.get(image, {}).items():
            rough.setdefault(marker, pose.apply(centre[None])[0])
        if len(start.poses) >= next_sweep or not waiting:
            next_sweep = max(next_sweep + 1, round(1.3 * next_sweep))
            _sweep(block, sure, start, 3)
        else:
            start.points = _intersect(sure, start.poses)
    waiting -= _join(block, sure, start, waiting, centres, layout)
    for image in sorted(waiting):
        n = len(set(block.marker[block.image == image]))
        seen = f"{n} marker{'s' if n != 1 else ''}"
        start.left_out[block.images[image]] = f"shows {seen}, too few that other pictures show, too"
    if len(start.poses) < 2:
        raise GeometryError(
            "no two pictures show the same four markers",
            expected="overlapping pictures of one field",
            cure="Take more pictures, each with at least half of the markers of the one before",
        )
    _sweep(block, sure, start, 4)
    _repair(block, sure, start)
    _sweep(block, sure, start, 2)
    unsolved = np.isnan(start.points[:, 0])
    start.points[unsolved] = _intersect(block, start.poses)[unsolved]
    return start


def misfit_px(block: Block, start: Start, focal_px: float) -> float:
    """How badly a start fits: median angle of rays in pixels, more if pictures are missing."""
    off = _off_rad(block, start)
    off = off[np.isfinite(off)]
    if len(off) == 0:
        return float("inf")
    return float(np.median(off)) * focal_px * (len(block.image) / len(off)) ** 2


def _off_rad(block: Block, start: Start) -> ArrayF:
    """(m,) angle between the ray of a mark and the direction to its point, NaN where one is unknown."""
    R = np.full((len(block.images), 3, 3), np.nan)
    C = np.full((len(block.images), 3), np.nan)
    for image, pose in start.poses.items():
        R[image], C[image] = pose.R, pose.shift_m
    away = start.points[block.point] - C[block.image]
    local = np.einsum("mji,mj->mi", R[block.image], away)
    return np.asarray(np.linalg.norm(_unit(local) - block.rays, axis=1))


def _known(
    block: Block, image: int, solved: ArrayB, rough: dict[int, ArrayF], rays: dict[int, ArrayF]
) -> tuple[int, int]:
    mine = block.image == image
    return len(set(block.marker[mine & solved[block.point]])), len(set(rays) & set(rough))


def _resected(
    block: Block,
    image: int,
    start: Start,
    solved: ArrayB,
    rough: dict[int, ArrayF],
    rays: dict[int, ArrayF],
) -> Rigid | None:
    """Pose of an image on intersected saddles, or else on the centres of sheets; None if neither is safe."""
    mine = np.flatnonzero((block.image == image) & solved[block.point])
    mine = mine[np.isfinite(block.rays[mine]).all(axis=1)]
    markers = len(set(block.marker[mine]))
    if markers >= 2 and len(mine) >= _LEAST_SADDLES:
        pose, angles = _pose(start.points[block.point[mine]], block.rays[mine], block.marker[mine], _FINE_RAD)
        if pose is not None and (angles < _FINE_RAD).mean() > (0.6 if markers >= _LEAST_MARKERS else 0.85):
            return pose
    both = sorted(set(rays) & set(rough))
    if len(both) < _LEAST_MARKERS:
        return None
    points, directions = np.array([rough[m] for m in both]), np.array([rays[m] for m in both])
    pose, angles = _pose(points, directions, np.array(both), _ROUGH_RAD)
    enough = (angles < _ROUGH_RAD).sum() >= max(_LEAST_MARKERS, 0.6 * len(both))
    return pose if enough else None


def _pose(points: ArrayF, rays: ArrayF, groups: ArrayI, cap_rad: float) -> tuple[Rigid | None, ArrayF]:
    """A pose and the angles of rays (n,), None if no three rays give one: another picture goes on."""
    try:
        return pose_from_rays(points, rays, groups, cap_rad=cap_rad)
    except GeometryError:
        return None, np.full(len(points), np.pi)


def _first(tried: Iterable[tuple[int, Rigid | None]]) -> tuple[int, Rigid] | None:
    """The first image that has a pose; None if no image has one."""
    return next(((image, pose) for image, pose in tried if pose is not None), None)


def _centres(block: Block, start: Start) -> dict[int, ArrayF]:
    """Centres (3,) of markers whose four saddles were intersected."""
    solved = [(p[0], x) for p, x in zip(block.points, start.points, strict=True) if np.isfinite(x).all()]
    sums: dict[int, list[ArrayF]] = {}
    for marker, x in solved:
        sums.setdefault(marker, []).append(x)
    return {marker: np.mean(xs, axis=0) for marker, xs in sums.items() if len(xs) == 4}


def _places(block: Block, start: Start, centres: dict[int, dict[int, ArrayF]]) -> dict[int, ArrayF]:
    """Places (3,) of markers: intersected, or else by their distances in the pictures that show them."""
    seen: dict[int, list[ArrayF]] = {}
    for image, pose in start.poses.items():
        for marker, centre in centres.get(image, {}).items():
            seen.setdefault(marker, []).append(pose.apply(centre[None])[0])
    return {m: np.median(xs, axis=0) for m, xs in seen.items()} | _centres(block, start)


def _aligned(centres: dict[int, ArrayF], places: dict[int, ArrayF]) -> Rigid | None:
    """Pose from three common sheets or more: their centres in ccs, with the distances, laid upon pcs."""
    both = sorted(set(centres) & set(places))
    if len(both) < _LEAST_ALIGNED:
        return None
    ccs, pcs = (np.array([at[m] for m in both]) for at in (centres, places))
    pose = _between(ccs, pcs)
    off = np.linalg.norm(pose.apply(ccs) - pcs, axis=1)
    size = np.linalg.svd(ccs - ccs.mean(axis=0), compute_uv=False) / np.sqrt(len(ccs))
    narrow = size[1] < _LEAST_WIDTH * float(np.linalg.norm(ccs, axis=1).max())
    return None if narrow or np.median(off) > _ALIGNED * np.linalg.norm(size) else pose


def _between(ccs: ArrayF, pcs: ArrayF) -> Rigid:
    a, b = ccs - ccs.mean(axis=0), pcs - pcs.mean(axis=0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return Rigid(R=R, shift_m=pcs.mean(axis=0) - R @ ccs.mean(axis=0))


def _sweep(block: Block, sure: Block, start: Start, times: int) -> None:
    """Points from poses and the sure marks, and poses from points, in turns."""
    for _ in range(times):
        start.points = _intersect(sure, start.poses)
        for image, pose in start.poses.items():
            mine = np.flatnonzero((block.image == image) & np.isfinite(start.points[block.point, 0]))
            mine = mine[np.isfinite(block.rays[mine]).all(axis=1)]
            points, rays = start.points[block.point[mine]], block.rays[mine]
            off = np.linalg.norm(_unit((points - pose.shift_m) @ pose.R) - rays, axis=1)
            near = off < max(_FINE_RAD, 3 * float(np.median(off))) if len(off) else off > 0
            if near.sum() >= 6:
                start.poses[image] = improved_pose(pose, points[near], rays[near])
    start.points = _intersect(sure, start.poses)


def _join(
    block: Block,
    sure: Block,
    start: Start,
    waiting: set[int],
    centres: dict[int, dict[int, ArrayF]],
    layout: MarkerLayout,
) -> set[int]:
    """Pictures that hang together among themselves are laid upon the others by markers that both show.

    Returns those that are joined.
    """
    rows = np.isin(block.image, list(waiting))
    if len(waiting) < 2 or len(start.poses) < 2 or not rows.any():
        return set()
    part = replace(
        block, image=block.image[rows], point=block.point[rows], xy_px=block.xy_px[rows],
        sigma_px=block.sigma_px[rows], rays=block.rays[rows],
    )  # fmt: skip
    try:
        other = start_network(part, layout)
    except GeometryError:
        return set()
    T = _aligned(_places(block, other, centres), _places(block, start, centres))
    if T is None:
        return set()
    start.poses |= {image: T @ pose for image, pose in other.poses.items()}
    _sweep(block, sure, start, 3)
    return set(other.poses)


def _repair(block: Block, sure: Block, start: Start) -> None:
    """Pictures that fit badly are resected anew on what the others say: a wrong pose spoils points, too."""
    off = _off_rad(block, start)
    fitting = {i: float(np.mean(off[block.image == i] < _FINE_RAD)) for i in start.poses}
    for image in sorted((i for i in fitting if fitting[i] < _FITS_WELL), key=lambda i: (fitting[i], i)):
        others = {i: pose for i, pose in start.poses.items() if i != image}
        points = _intersect(sure, others)
        mine = np.flatnonzero((block.image == image) & np.isfinite(points[block.point, 0]))
        mine = mine[np.isfinite(block.rays[mine]).all(axis=1)]
        if len(mine) < _LEAST_SADDLES or len(set(block.marker[mine])) < _LEAST_MARKERS:
            continue
        there, rays = points[block.point[mine]], block.rays[mine]
        pose, angles = _pose(there, rays, block.marker[mine], _FINE_RAD)
        old = start.poses[image]
        before = np.linalg.norm(_unit((there - old.shift_m) @ old.R) - rays, axis=1)
        if pose is not None and (angles < _FINE_RAD).mean() > (before < _FINE_RAD).mean():
            start.poses[image] = pose


def _intersect(block: Block, poses: dict[int, Rigid]) -> ArrayF:
    """Points (p, 3) nearest to their rays, wrong ones weighted down; NaN without two that cross."""
    n = len(block.points)
    rows = np.flatnonzero(np.isin(block.image, list(poses)) & np.isfinite(block.rays).all(axis=1))
    R = np.stack([poses[i].R if i in poses else np.eye(3) for i in range(len(block.images))])
    C = np.stack([poses[i].shift_m if i in poses else np.zeros(3) for i in range(len(block.images))])
    image, point = block.image[rows], block.point[rows]
    d = np.einsum("mij,mj->mi", R[image], block.rays[rows])
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    weight = np.ones(len(rows))
    points = np.full((n, 3), np.nan)
    for _ in range(4):
        A, b = np.zeros((n, 3, 3)), np.zeros((n, 3))
        np.add.at(A, point, weight[:, None, None] * across)
        np.add.at(b, point, weight[:, None] * np.einsum("mij,mj->mi", across, C[image]))
        count = np.bincount(point, minlength=n)
        smallest = np.linalg.eigvalsh(A)[:, 0]
        mass = np.bincount(point, weights=weight, minlength=n)
        fixed = (count >= 2) & (smallest > mass * _LEAST_ANGLE_RAD**2 / 4)
        points[:] = np.nan
        points[fixed] = np.linalg.solve(A[fixed], b[fixed][:, :, None])[:, :, 0]
        off = np.linalg.norm(np.einsum("mij,mj->mi", across, points[point] - C[image]), axis=1)
        distance = np.linalg.norm(points[point] - C[image], axis=1)
        weight = 1e-3 / np.maximum(np.nan_to_num(off / distance, nan=1.0), 1e-3)
    return points


def _unit(v: ArrayF) -> ArrayF:
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))
