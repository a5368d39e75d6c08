"""How far plane spots lie apart that a lidar saw early and late on its way, with the sigma of that.

    python config/campaigns/voyage/looks.py results/drive/lidar/points.laz ...

Cells of 0.5 m whose points, every eighth of the cloud, lie within 0.15 m of a plane (rms) are spots. Points
before and after the middle of the time that a spot was seen, at least 0.5 s away from it, are its two looks.
Their distance, late less early, is that of their means along the normal, which points up. Its variance is
the sum of those of a point of either look: errors that both share are counted as if they differed.
"""

import sys
from pathlib import Path

import laspy
import numpy as np

CELL_M, LEAST_POINTS, THICKEST_M, APART_S, THINNED = 0.5, 10, 0.15, 0.5, 8


def sums(values: np.ndarray, owner: np.ndarray, n: int) -> np.ndarray:
    """Sums (n, k) of the rows of values (m, k) by owner."""
    return np.stack([np.bincount(owner, column, n) for column in values.T], axis=1)


def looks(cloud: laspy.LasData) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Distances, sigmas (m), times between both looks (s) and steepness of the normal (n,) of spots."""
    x = np.asarray(cloud.xyz)
    variance = np.stack(
        [np.asarray(cloud[f"sigma_{axis}"], float) ** 2 for axis in ("east", "north", "up")], axis=1
    )
    t = np.asarray(cloud.gps_time, float)
    key = np.floor(x / CELL_M).astype(np.int64)
    key -= key.min(axis=0)
    _, owner = np.unique(np.ravel_multi_index(tuple(key.T), tuple(key.max(axis=0) + 1)), return_inverse=True)
    n = owner.max() + 1
    first, last = np.full(n, np.inf), np.full(n, -np.inf)
    np.minimum.at(first, owner, t)
    np.maximum.at(last, owner, t)
    since_s = t - ((first + last) / 2.0)[owner]
    count = np.bincount(owner, minlength=n)
    centre = sums(x, owner, n) / count[:, None]
    off = x - centre[owner]
    moments = sums((off[:, :, None] * off[:, None, :]).reshape(-1, 9), owner, n) / count[:, None]
    values, axes = np.linalg.eigh(moments.reshape(-1, 3, 3))
    normal = axes[:, :, 0]
    good = (values[:, 0] < THICKEST_M**2) & (values[:, 1] > (0.2 * CELL_M) ** 2)
    of_look, sight = [], []
    for look in (since_s < -APART_S, since_s > APART_S):
        here = owner[look]
        points = np.bincount(here, minlength=n)
        good &= points >= LEAST_POINTS
        share = np.maximum(points, 1)[:, None]
        of_look.append((sums(off[look], here, n) / share, sums(variance[look], here, n) / share))
        sight.append(np.bincount(here, t[look], n) / share[:, 0])
    (early, of_early), (late, of_late) = of_look
    plane = normal[good]
    apart = np.sum((late - early)[good] * plane, axis=1) * np.where(plane[:, 2] < 0, -1.0, 1.0)
    sigma = np.sqrt(np.sum((of_early + of_late)[good] * plane**2, axis=1))
    return apart, sigma, (sight[1] - sight[0])[good], np.abs(plane[:, 2])


def main(files: list[str]) -> None:
    """Print a row of Markdown for each cloud and each kind of surface."""
    print("| cloud | surfaces | spots | s between | median, m | rms, m | half within, m | sigma, m | NEES |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for file in files:
        cloud = laspy.read(file)
        apart, sigma, seconds, steep = looks(cloud[::THINNED])
        for words, rows in (("ground and roofs", steep > 0.9), ("walls", steep < 0.3)):
            d, s = apart[rows], sigma[rows]
            figures = (np.median(d), np.sqrt(np.mean(d**2)), np.median(np.abs(d)), np.median(s))
            print(
                f"| {Path(file).parts[-3]} | {words} | {len(d)} | {np.median(seconds[rows]):.1f} | "
                + " | ".join(f"{value:.3f}" for value in figures)
                + f" | {np.mean((d / s) ** 2):.2f} |"
            )


if __name__ == "__main__":
    main(sys.argv[1:])
