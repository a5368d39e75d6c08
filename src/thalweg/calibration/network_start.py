"""Approximate poses and points of a block of marker pictures, without any hand work.

Each sheet of known size has a distance from the camera in each picture. So the picture with the most markers
gives a first rough field; a second picture is resected on the centres of its sheets; from then on saddles are
intersected from the pictures that are known, and picture after picture is resected on them. Planar poses of a
sheet have two solutions that lie close together for a small sheet; only the centre, which hardly depends on
which one is right, is used, and intersection settles the rest.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import cv2
import numpy as np
import pandas as pd

from thalweg.calibration.marker_sheets import MarkerLayout
from thalweg.calibration.ray_resection import improved_pose, pose_from_rays
from thalweg.core.camera import Camera
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


@dataclass(slots=True)
class Block:
    """Marks of a block of pictures as arrays.

    Parameters
    ----------
    images : names; ``camera_of`` (i,) name of the camera of each.
    points : (marker, corner) of each point.
    image, point : (m,) indices of each mark.
    xy_px, sigma_px : (m, 2) and (m,).
    rays : (m, 3) unit directions in ccs, by nominal interior orientations.
    """

    images: tuple[str, ...]
    camera_of: tuple[str, ...]
    points: tuple[tuple[int, int], ...]
    image: ArrayI
    point: ArrayI
    xy_px: ArrayF
    sigma_px: ArrayF
    rays: ArrayF

    @property
    def marker(self) -> ArrayI:
        """(m,) marker of each mark."""
        return np.array([p[0] for p in self.points], np.int64)[self.point]


@dataclass(slots=True)
class Start:
    """Approximate values: poses ``T_pcs_ccs`` by image, points (p, 3), NaN if unknown, images left out."""

    poses: dict[int, Rigid]
    points: ArrayF
    left_out: dict[str, str] = field(default_factory=dict)


def block_of(marks: pd.DataFrame, cameras: Mapping[str, Camera]) -> Block:
    """Arrays of a table of marks (image, camera, marker, corner, x_px, y_px, sigma_px).

    Raises
    ------
    GeometryError : a camera is missing, or no marks at all.
    """
    if len(marks) == 0:
        raise GeometryError(
            "no marks in any picture", expected="pictures of the field", cure="Check detection and dictionary"
        )
    missing = sorted(set(marks["camera"]) - set(cameras))
    if missing:
        raise GeometryError(
            f"no interior orientation of the camera {missing[0]!r}", expected=str(list(cameras))
        )
    marks = marks.sort_values(["image", "marker", "corner"], kind="stable")
    images = tuple(dict.fromkeys(marks["image"]))
    first = marks.drop_duplicates("image").set_index("image")["camera"]
    keys = list(zip(marks["marker"].astype(int), marks["corner"].astype(int), strict=True))
    points = tuple(sorted(set(keys)))
    at_image, at_point = {n: i for i, n in enumerate(images)}, {p: i for i, p in enumerate(points)}
    xy = marks[["x_px", "y_px"]].to_numpy(np.float64)
    rays = np.empty((len(marks), 3))
    for name in set(marks["camera"]):
        rows = (marks["camera"] == name).to_numpy()
        rays[rows] = cameras[name].rays(xy[rows])
    return Block(
        images=images,
        camera_of=tuple(first.loc[list(images)]),
        points=points,
        image=np.array([at_image[n] for n in marks["image"]], np.int64),
        point=np.array([at_point[k] for k in keys], np.int64),
        xy_px=xy,
        sigma_px=marks["sigma_px"].to_numpy(np.float64),
        rays=rays,
    )


def start_network(block: Block, layout: MarkerLayout) -> Start:
    """Approximate values in the frame of one picture; see the module.

    Raises
    ------
    GeometryError : no picture shows enough markers, or no two belong together.
    """
    centres, rays = _sheets(block, layout)
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
    rough = {m: (c, first) for m, c in centres[first].items()}
    waiting = set(range(len(block.images))) - {first}
    next_sweep = 3
    while waiting:
        solved = np.isfinite(start.points[:, 0])
        score = {i: _known(block, i, solved, rough, rays.get(i, {})) for i in sorted(waiting)}
        for image in sorted(waiting, key=lambda i: (-max(score[i]), i)):
            pose = _resected(block, image, start, solved, rough, rays.get(image, {}))
            if pose is not None:
                break
        else:
            break
        start.poses[image] = pose
        waiting.remove(image)
        for marker, centre in centres.get(image, {}).items():
            rough.setdefault(marker, (pose.apply(centre[None])[0], image))
        if len(start.poses) >= next_sweep or not waiting:
            next_sweep = max(next_sweep + 1, round(1.3 * next_sweep))
            _sweep(block, start, 3)
        else:
            start.points = _intersect(block, start.poses)
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
    _sweep(block, start, 4)
    return start


def misfit_px(block: Block, start: Start, focal_px: float) -> float:
    """How badly a start fits: median angle of rays in pixels, more if pictures are missing."""
    rows = np.isfinite(start.points[block.point, 0]) & np.isin(block.image, list(start.poses))
    R = np.stack([start.poses[i].R if i in start.poses else np.eye(3) for i in range(len(block.images))])
    C = np.stack(
        [start.poses[i].shift_m if i in start.poses else np.zeros(3) for i in range(len(block.images))]
    )
    away = start.points[block.point[rows]] - C[block.image[rows]]
    local = np.einsum("mji,mj->mi", R[block.image[rows]], away)
    off = np.linalg.norm(_unit(local) - block.rays[rows], axis=1)
    if len(off) == 0:
        return float("inf")
    return float(np.median(off)) * focal_px * (len(block.image) / len(off)) ** 2


def _sheets(
    block: Block, layout: MarkerLayout
) -> tuple[dict[int, dict[int, ArrayF]], dict[int, dict[int, ArrayF]]]:
    """Centres of whole sheets in ccs [m] and unit directions to them, by image and marker."""
    centres: dict[int, dict[int, ArrayF]] = {}
    rays: dict[int, dict[int, ArrayF]] = {}
    order = np.lexsort((block.point, block.image))
    key = block.image[order] * 100_000 + block.marker[order]
    for rows in np.split(order, np.flatnonzero(np.diff(key)) + 1):
        if len(rows) != 4 or not np.isfinite(block.rays[rows]).all():
            continue
        image, marker = int(block.image[rows[0]]), int(block.marker[rows[0]])
        found = _sheet_centre(block.rays[rows], layout.saddles_m(marker))
        if found is not None:
            centres.setdefault(image, {})[marker] = found
            rays.setdefault(image, {})[marker] = found / np.linalg.norm(found)
    return centres, rays


def _sheet_centre(rays: ArrayF, saddles_m: ArrayF) -> ArrayF | None:
    """Centre of a sheet (3,) in ccs, None if no planar pose fits."""
    axis = rays.mean(axis=0)
    axis /= np.linalg.norm(axis)
    # into a camera that looks at the sheet, so that directions beyond 90 degrees do no harm
    side = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    turn = np.stack([side, np.cross(axis, side), axis])
    local = rays @ turn.T
    if (local[:, 2] < 0.1).any():
        return None
    flat = local[:, :2] / local[:, 2:]
    n, _, shifts, _ = cv2.solvePnPGeneric(saddles_m, flat, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    ahead = [np.ravel(t) for t in shifts[:n] if np.isfinite(t).all() and t[2] > 0]
    return np.mean(ahead, axis=0) @ turn if ahead else None


def _known(
    block: Block, image: int, solved: ArrayB, rough: dict[int, tuple[ArrayF, int]], rays: dict[int, ArrayF]
) -> tuple[int, int]:
    mine = block.image == image
    return len(set(block.marker[mine & solved[block.point]])), len(set(rays) & set(rough))


def _resected(
    block: Block,
    image: int,
    start: Start,
    solved: ArrayB,
    rough: dict[int, tuple[ArrayF, int]],
    rays: dict[int, ArrayF],
) -> Rigid | None:
    """Pose of an image on intersected saddles, or else on the centres of sheets; None if neither is safe."""
    mine = np.flatnonzero((block.image == image) & solved[block.point])
    mine = mine[np.isfinite(block.rays[mine]).all(axis=1)]
    markers = len(set(block.marker[mine]))
    if markers >= 2 and len(mine) >= _LEAST_SADDLES:
        pose, angles = pose_from_rays(
            start.points[block.point[mine]], block.rays[mine], block.marker[mine], cap_rad=_FINE_RAD
        )
        if (angles < _FINE_RAD).mean() > (0.6 if markers >= _LEAST_MARKERS else 0.85):
            return pose
    both = sorted(set(rays) & set(rough))
    if len(both) < _LEAST_MARKERS:
        return None
    points, directions = np.array([rough[m][0] for m in both]), np.array([rays[m] for m in both])
    pose, angles = pose_from_rays(points, directions, np.array(both), cap_rad=_ROUGH_RAD)
    enough = (angles < _ROUGH_RAD).sum() >= max(_LEAST_MARKERS, 0.6 * len(both))
    return pose if enough else None


def _sweep(block: Block, start: Start, times: int) -> None:
    """Points from poses and poses from points, in turns."""
    for _ in range(times):
        start.points = _intersect(block, start.poses)
        for image, pose in start.poses.items():
            mine = np.flatnonzero((block.image == image) & np.isfinite(start.points[block.point, 0]))
            points, rays = start.points[block.point[mine]], block.rays[mine]
            off = np.linalg.norm(_unit((points - pose.shift_m) @ pose.R) - rays, axis=1)
            near = off < max(_FINE_RAD, 3 * float(np.median(off))) if len(off) else off > 0
            if near.sum() >= 6:
                start.poses[image] = improved_pose(pose, points[near], rays[near])
    start.points = _intersect(block, start.poses)


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
