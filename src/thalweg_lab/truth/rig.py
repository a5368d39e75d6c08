"""A calibrated rig and its panoramas against the truth of the twin."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy import ndimage

from thalweg.calibration import LENSES, read_rig
from thalweg.core import (
    ArrayF,
    InputError,
    Rigid,
    decode_picture,
    iter_laz,
    optional,
    read_marked,
    read_table,
)
from thalweg.images.model import ImagePoses
from thalweg.lidar import GAMMA
from thalweg.panorama import PANORAMAS, pixels_of, sphere_rays
from thalweg.settings.sections import Rig as RigSettings

cv2 = optional("cv2")

TRUTH: Final[Mapping[str, Any]] = {
    "kind": "thalweg twin dual fisheye",
    "version": 1,
    "what": "truth of the rig",
    "cure": "Simulate it again",
}
"""How `read_marked` reads the truth of a rig."""
_UNKNOWNS: Final = 22
_TILE: Final = 96
_STEP: Final = 48
_LEAST_RESPONSE: Final = 0.3
_COLOUR_M: Final = 40.0
_SAME_M: Final = 0.2
"""Points so far off the true range are not what is seen: relief and errors of the cloud are smaller."""
_PATCH: Final = 8
_LEAST_POINTS: Final = 20
_SKY_DEG: Final = 25.0
"""Tiles farther from the horizon show the own boat, or sky alone."""


def judge_rig(
    calibration: Path,
    poses: Path,
    panoramas: Path,
    pictures: Path,
    truth: Path,
    true_poses: Path,
    true_panorama: Path,
    coloured: list[Path],
    rig: dict[str, Any],
    out: Path,
) -> None:
    """Write errors of rig, poses and the middle panorama as CSV: measure, value, n.

    Parameters
    ----------
    calibration, poses, panoramas, pictures : results of the processing.
    truth, true_poses, true_panorama : of the twin.
    coloured : the cloud in colour, if there is a lidar.
    rig : section ``rig``.
    out : target.
    """
    found = read_rig(calibration, RigSettings(**rig))
    true = read_marked(truth, "rig", **TRUTH)
    T = Rigid.from_matrix(true["T_back_front"])
    off = found.T_back_front.error_from(T)
    parts = [(found.cameras[name], np.array(list(true["lenses"][name].values()))) for name in LENSES]
    interior = [
        (camera.parameters - p) @ np.linalg.solve(camera.cov, camera.parameters - p) for camera, p in parts
    ]
    squares = off @ np.linalg.solve(found.T_back_front.cov, off)
    placed, there = ImagePoses.read(poses), ImagePoses.read(true_poses)
    rows: list[tuple[str, float, int]] = [
        ("base: error, mm", 1e3 * (found.base_m - float(true["base_m"])), 1),
        ("relative rotation: error, deg", float(np.rad2deg(np.linalg.norm(off[3:]))), 1),
        ("relative orientation: mean of squared error over variance", float(squares) / 6, 6),
        ("interiors: mean of squared error over variance", float(np.sum(interior)) / 16, 16),
        *_poses(placed, there),
        *_panorama(panoramas, pictures, true_panorama),
        *(row for path in coloured for row in judge_colours(path, true_panorama)),
    ]
    pd.DataFrame(rows, columns=["measure", "value", "n"]).to_csv(out, index=False, float_format="%.6g")


def _poses(placed: ImagePoses, there: ImagePoses) -> list[tuple[str, float, int]]:
    """Errors of the front lens at the files of the survey."""
    squares, shift, turn = [], [], []
    for k, name in enumerate(placed.images):
        if not placed.oriented[k]:
            continue
        pose = placed.pose(k)
        error = pose.error_from(there.pose(there.images.index(name)))
        squares.append(float(error @ np.linalg.solve(pose.cov, error)) / 6)
        shift.append(float(np.linalg.norm(error[:3])))
        turn.append(float(np.rad2deg(np.linalg.norm(error[3:]))))
    n = len(squares)
    return [
        ("poses: mean of squared error over variance", float(np.mean(squares)), 6 * n),
        ("poses: largest error of the place, m", float(np.max(shift)), n),
        ("poses: largest rotation, deg", float(np.max(turn)), n),
    ]


def _panorama(table: Path, pictures: Path, truth: Path) -> list[tuple[str, float, int]]:
    """Shifts of tiles of the middle panorama against what is truly seen from its centre, about the horizon.

    What all tiles have in common is the error of the pose, which is judged by itself.
    """
    rows = read_table(table, PANORAMAS)[0]
    row = rows.iloc[len(rows) // 2]
    picture = decode_picture(np.fromfile(pictures / str(row["panorama"]), np.uint8), cv2.IMREAD_COLOR)
    if picture is None:
        raise InputError("no picture", expected="a panorama", where=pictures / str(row["panorama"]))
    with np.load(truth) as stored:
        light = stored["light"].astype(np.float32)
    grey = (np.clip(light.mean(axis=2) / 2.3, 0, 1) ** (1 / 2.2)).astype(np.float32)
    ours = (cv2.resize(picture, grey.shape[::-1]).mean(axis=2) / 255).astype(np.float32)
    width = grey.shape[1]
    window = cv2.createHanningWindow((_TILE, _TILE), cv2.CV_32F)
    shifts = []
    rays = sphere_rays(width)
    reach = np.deg2rad(_SKY_DEG)
    for y in range(0, grey.shape[0] - _TILE, _STEP):
        for x in range(0, width - _TILE, _STEP):
            if abs(np.arcsin(rays[y + _TILE // 2, x, 1])) > reach:
                continue
            tile = np.s_[y : y + _TILE, x : x + _TILE]
            (dx, dy), response = cv2.phaseCorrelate(grey[tile], ours[tile], window)
            if response > _LEAST_RESPONSE:
                shifts.append((dx, dy))
    found = np.array(shifts).reshape(-1, 2)
    middle = np.median(found, axis=0) if len(found) else np.full(2, np.nan)
    spread: ArrayF = np.linalg.norm(found - middle, axis=1)
    return [
        ("panorama: common shift to the right, px", float(middle[0]), len(found)),
        ("panorama: common shift down, px", float(middle[1]), len(found)),
        ("panorama: median of the other shifts, px", float(np.median(spread)), len(found)),
    ]


def judge_colours(points: Path, truth: Path) -> list[tuple[str, float, int]]:
    """Colours of the cloud against what is truly seen of its points from the middle of the rig.

    A point is visible if the true range in its direction is its own, and that of all neighbours, too: edges
    are left out. Both lights differ by the exposure, one factor a colour, which is taken out. The truth is of
    pixels as wide as those of the rig: grain finer than these, which a finer camera shows, counts as an error
    of points; means of patches tell the colours. Free of shade is a point whose pixel and all neighbours are
    in the sun.
    """
    with np.load(truth) as stored:
        light, range_m = stored["light"].astype(np.float64), stored["range_m"]
        pose, free = Rigid.from_matrix(stored["T_wcs_pano"]), ndimage.minimum_filter(stored["sunlit"], 3)
    low, high = ndimage.minimum_filter(range_m, 3), ndimage.maximum_filter(range_m, 3)
    seen: list[ArrayF] = []
    for chunk in iter_laz(points):
        local = (chunk["xyz_m"] - pose.shift_m) @ pose.R
        far = np.linalg.norm(local, axis=1)
        uv = pixels_of(local, light.shape[1])
        column, row = uv.astype(np.int64).T
        row, column = np.clip(row, 0, light.shape[0] - 1), column % light.shape[1]
        visible = (far < _COLOUR_M) & (far - low[row, column] < _SAME_M) & (high[row, column] - far < _SAME_M)
        at = uv[:, ::-1].T - 0.5
        true = np.stack(
            [ndimage.map_coordinates(light[..., c], at, order=1, mode="nearest") for c in range(3)], 1
        )
        patch = row // _PATCH * light.shape[1] + column // _PATCH
        given = (chunk["rgb"] / 65535.0) ** GAMMA
        seen.append(np.column_stack([given, true, chunk["n_views"], patch, free[row, column]])[visible])
    found = np.concatenate(seen)
    has = found[:, 6] > 0
    given, true, patch = found[has, :3], found[has, 3:6], found[has, 7].astype(np.int64)
    sunny = found[has, 8] > 0
    true *= np.median(given / np.maximum(true, 1e-9), axis=0)
    n = np.bincount(patch)
    full = n >= _LEAST_POINTS
    means = [
        np.stack([np.bincount(patch, part[:, c])[full] / n[full] for c in range(3)], axis=1)
        for part in (given, true)
    ]

    def error(a: ArrayF, b: ArrayF) -> float:
        """Median difference of two lights (n, 3), of 255."""
        tones = [255 * np.clip(light, 0, 1) ** (1 / GAMMA) for light in (a, b)]
        return float(np.median(np.abs(tones[0] - tones[1])))

    return [
        ("colours: share of visible points that have one", float(has.mean()), len(has)),
        ("colours: median error of a point, of 255", error(given, true), len(given)),
        (
            "colours: median error of a point free of shade, of 255",
            error(given[sunny], true[sunny]),
            int(sunny.sum()),
        ),
        ("colours: median error of a patch, of 255", error(means[0], means[1]), int(full.sum())),
    ]
