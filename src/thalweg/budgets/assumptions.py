"""Which assumptions a published table needs: each is left out, and the rest estimated anew.

What is left out may come in several ways (along which axis?); the way that comes nearest to the table counts.
Beside assumptions that the table needs stand those that it does not settle.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pandas as pd

from thalweg.budgets.budget import Budget, Motion
from thalweg.budgets.influences import TOTAL
from thalweg.budgets.published import BY_SIGMA, MATCHED, MISSED, verdicts
from thalweg.budgets.reconstruct import Setup, Solution, reconstruct

NONE: Final = "none: all assumptions hold"
STARTS: Final = 256
"""Starting points for each alternative: with four times as many the same cells are missed."""

ROOT_3: Final = float(np.sqrt(3.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Alternative:
    """What was left out, what stands in its place, and whether the table is thought to need it."""

    left_out: str
    instead: str
    setup: Setup
    needed: bool = True


def published_setup(budget: Budget, published: pd.DataFrame, lever_length_m: float | None) -> Setup:
    """The assumptions under which a table is met; the budget's own angles and lever arm are forgotten."""
    frames = tuple(
        replace(frame, angles_deg=dict.fromkeys(frame.angles_deg, 0.0), lever_m=(0.0, 0.0, 0.0))
        for frame in budget.frames
    )
    return Setup(budget=replace(budget, frames=frames), published=published, lever_length_m=lever_length_m)


def alternatives(setup: Setup) -> Iterator[Alternative]:
    """The assumptions themselves, then with one of them left out at a time."""
    budget = setup.budget
    yield Alternative(left_out=NONE, instead="", setup=setup)
    for axis, name in enumerate("xyz"):
        along = tuple(float(k == axis) for k in range(3))
        yield Alternative(
            left_out="point in equal parts along the scanner's axes", instead=f"point along {name}",
            setup=replace(setup, budget=replace(budget, direction=(along[0], along[1], along[2]))),
        )  # fmt: skip
    yield Alternative(
        left_out="direction around the scanner's z axis", instead="point at (1.41, 0, 1)", needed=False,
        setup=replace(setup, budget=replace(budget, direction=(float(np.sqrt(2.0)), 0.0, 1.0))),
    )  # fmt: skip
    yield Alternative(
        left_out="angles of the platform", instead="parallel to the world",
        setup=replace(setup, free_attitude=False),
    )  # fmt: skip
    yield Alternative(
        left_out="angles of the mount", instead="parallel to the platform",
        setup=replace(setup, free_boresight=False),
    )  # fmt: skip
    if setup.lever_length_m:
        yield Alternative(left_out="lever arm", instead="none", setup=replace(setup, lever_length_m=0.0))
        yield Alternative(
            left_out="length of the lever arm", instead="any length", needed=False,
            setup=replace(setup, lever_length_m=None),
        )  # fmt: skip
    else:
        yield Alternative(
            left_out="lever arm of zero", instead="0.16 m, as on the camera's mount", needed=False,
            setup=replace(setup, lever_length_m=0.16),
        )  # fmt: skip
    if budget.motion is not None:
        yield from _motions(setup, budget.motion)


def _motions(setup: Setup, motion: Motion) -> Iterator[Alternative]:
    """Other readings of "0.4 m/s (lateral) and 7 deg/s (angular)"."""
    turn, move = motion.angles_deg_per_s, motion.axes_m_per_s

    def other(
        left_out: str, instead: str, turn: tuple[float, ...], move: tuple[float, ...], **how: bool
    ) -> Alternative:
        """A setup with other speeds."""
        speeds = Motion(
            angles_deg_per_s=(turn[0], turn[1], turn[2]), axes_m_per_s=(move[0], move[1], move[2])
        )
        return Alternative(
            left_out=left_out, instead=instead,
            setup=replace(setup, budget=replace(setup.budget, motion=speeds)), **how,
        )  # fmt: skip

    yield other("speed along the axes", "none", turn, (0.0, 0.0, 0.0))
    yield other("speed of the angles", "none", (0.0, 0.0, 0.0), move)
    for k, name in enumerate(("omega", "phi", "kappa")):
        yield other(
            "7 deg/s on each angle", f"{name} alone", tuple(v * (i == k) for i, v in enumerate(turn)), move
        )
    for k, name in enumerate(("omega", "phi", "kappa")):
        yield other(
            "7 deg/s on each angle", f"all but {name}", tuple(v * (i != k) for i, v in enumerate(turn)), move
        )
    yield other("7 deg/s on each angle", "7 deg/s in all", tuple(v / ROOT_3 for v in turn), move)
    for k, name in enumerate("xyz"):
        yield other(
            "0.4 m/s on more than one axis",
            f"{name} alone",
            turn,
            tuple(v * (i == k) for i, v in enumerate(move)),
        )
    yield other("0.4 m/s on more than one axis", "0.4 m/s in all", turn, tuple(v / ROOT_3 for v in move))
    for k, name in enumerate("xyz"):
        yield other("0.4 m/s on the third axis", f"all but {name}", turn,
                    tuple(v * (i != k) for i, v in enumerate(move)), needed=False)  # fmt: skip


def left_out(setup: Setup, *, starts: int = STARTS) -> pd.DataFrame:
    """What becomes of the table when an assumption is left out.

    Columns ``left_out, instead, needed, matched, by_sigma, missed, totals_missed, missed_cells, lever_m,
    cost``; one row for each assumption, with the alternative that misses fewest cells.
    """
    rows = []
    for way in alternatives(setup):
        solution = reconstruct(way.setup, starts=starts)
        rows.append(
            {
                "left_out": way.left_out,
                "instead": way.instead,
                "needed": way.needed,
                **_outcome(way, solution),
            }
        )
    table = pd.DataFrame(rows)
    order = table.sort_values(["missed", "by_sigma", "cost"], kind="stable").drop_duplicates("left_out").index
    return table.loc[sorted(order)].reset_index(drop=True)


def _outcome(way: Alternative, solution: Solution) -> dict[str, object]:
    cells = verdicts(solution.budget, way.setup.published)
    missed = cells[cells["met"] == MISSED]
    inner = solution.budget.frames[-1]
    return {
        "matched": int((cells["met"] == MATCHED).sum()),
        "by_sigma": int((cells["met"] == BY_SIGMA).sum()),
        "missed": len(missed),
        "totals_missed": int((missed["input"] == TOTAL).sum()),
        "missed_cells": "; ".join(
            f"{row.input} at {row.distance_m:g} m: {row.printed} printed, {row.computed_mm:.4g}"
            for row in missed.itertuples(index=False)
        ),
        "lever_m": float(np.linalg.norm(inner.lever_m)),
        "cost": solution.cost,
    }
