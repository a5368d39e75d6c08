"""A budget with angles and lever arms drawn at random: what of a published table does any geometry meet?"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from thalweg.budgets.budget import Budget, Frame
from thalweg.core.types import ArrayF

SEED: Final = 1
DRAWS: Final = 300


def drawn(budget: Budget, draws: int = DRAWS, *, seed: int = SEED) -> Iterator[Budget]:
    """The budget with random frames, ``draws`` times; the same for the same seed.

    Every angle is uniform over the full turn; a lever arm keeps its length and takes any direction, so that
    one of zero stays zero. Sigmas, direction and motion stay.
    """
    rng = np.random.default_rng(seed)
    for _ in range(draws):
        yield replace(budget, frames=tuple(_frame(frame, rng) for frame in budget.frames))


def _frame(frame: Frame, rng: np.random.Generator) -> Frame:
    angles_deg = rng.uniform(-180.0, 180.0, len(frame.angles_deg))
    way: ArrayF = rng.normal(size=3)
    x, y, z = way * (np.linalg.norm(frame.lever_m) / np.linalg.norm(way))
    return replace(
        frame,
        angles_deg=dict(zip(frame.angles_deg, map(float, angles_deg), strict=True)),
        lever_m=(float(x), float(y), float(z)),
    )
