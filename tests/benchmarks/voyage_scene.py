"""Common points of images of a boat that passes a bank, without pictures."""

import numpy as np

from tests.images.block_scene import looking, project
from thalweg.core import ArrayI, Camera
from thalweg.images.model import Picture
from thalweg.images.sfm.colmap import start_given
from thalweg.images.sfm.matching import Matches

CAMERA = Camera(
    model="perspective", size_px=(4590, 3440), parameters=np.array([3700.0, 3700, 2295, 1720, 0, 0, 0, 0, 0])
)
NEIGHBOURS = 10
DENSITY = 120
"""Places for each metre of the bank; an image finds three of ten within 12 m."""


def voyage(n: int, *, seed: int = 1, density: int = DENSITY) -> Matches:
    """An image a metre, 16 to 26 m off the bank; marks of 0.4 px, one common point of a hundred is false."""
    rng = np.random.default_rng(seed)
    t, m = np.linspace(0.0, n - 1.0, n), density * (n + 30)
    C = np.stack([t, 2 * np.sin(t / 6.4) + 0.3 * np.sin(t), 1.5 + 0.05 * np.cos(0.7 * t)], axis=1)
    yaw = 0.03 * np.sin(1.3 * t) - 0.08 * np.sin(t / 6.4 + 1)
    turns = np.stack([yaw, 0.02 * np.sin(2 * t), 0.03 * np.cos(1.7 * t)], axis=1)
    R = np.array([looking(*angles) for angles in turns])
    X = np.stack([rng.uniform(-15, n + 15, m), rng.uniform(18, 24, m), rng.uniform(-3, 6, m)], axis=1)
    seen = []
    for k in range(n):
        near = np.flatnonzero((np.abs(X[:, 0] - t[k]) < 12) & (rng.random(m) < 0.3))
        xy = project(CAMERA, R, C, np.full(len(near), k), X[near])
        inside = ((xy > 0) & (xy < CAMERA.size_px)).all(axis=1)
        seen.append((near[inside], xy[inside] + 0.4 * rng.standard_normal((int(inside.sum()), 2))))
    pairs = np.array([(a, b) for a in range(n) for b in range(a + 1, min(a + 1 + NEIGHBOURS, n))])
    common = [_common(rng, seen[a][0], seen[b][0]) for a, b in pairs]
    place = [np.column_stack([xy, np.full(len(xy), 2.0)]) for _, xy in seen]
    names = tuple(f"{k:04d}.jpg" for k in range(n))
    counts = np.array([len(c) for c in common])
    return Matches(
        pictures=tuple(Picture(name=name, size_px=CAMERA.size_px) for name in names),
        order=np.arange(n),
        starts=(start_given(CAMERA),),
        camera=np.zeros(n, np.int64),
        start=np.concatenate([[0], np.cumsum([len(p) for p in place])]),
        place=np.concatenate(place).astype(np.float32),
        pairs=pairs,
        n_matches=counts,
        config=np.full(len(pairs), 2),
        geometry=np.full((len(pairs), 4, 3, 4), np.nan),
        pair_start=np.concatenate([[0], np.cumsum(counts)]),
        common=np.concatenate(common).astype(np.uint32),
        facts={"max_size_px": 3200, "notes": []},
    )


def _common(rng: np.random.Generator, one: ArrayI, two: ArrayI) -> ArrayI:
    """Features of the same places, and some false ones."""
    rows = np.column_stack(np.intersect1d(one, two, return_indices=True)[1:])
    false = rng.random(len(rows)) < 0.01
    rows[false, 1] = rng.integers(0, len(two), int(false.sum()))
    return np.asarray(rows[np.unique(rows[:, 1], return_index=True)[1]])
