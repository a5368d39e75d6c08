"""Angles and lever arm that a published table implies but does not print.

The unknowns are the angles of the chain's two frames and the lever arm of the inner one. Every cell that
depends on them is an observation, weighted by its tolerance; a known length of the lever arm is one more.
Totals are left out: they are a check. Levenberg and Marquardt's steps run from many starting points side by
side, since most of them end in a side minimum. The starting points are a fixed sequence, so the same table
gives the same geometry.

Without a row of time the first angle of the outer frame turns the whole world about its x axis, and no cell
changes: it is kept.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
import pandas as pd
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from thalweg.budgets import COORDINATES, TOTAL, Budget, Frame, Motion, frame_columns
from thalweg.core import ArrayF, ArrayI, Link, chain_derivatives, opk_axes, rotation_opk
from thalweg_lab.reproduction.published_budgets import BY_SIGMA, MATCHED, MISSED, verdicts

STARTS: Final = 1024
LEVER_START_M: Final = 0.2
LEVER_WEIGHT_M: Final = 0.005
"""A length printed in full centimetres is known to half of one."""
EQUAL: Final = 0.02
"""Solutions whose cells differ by less, in tolerances of a cell, are the same to a reader of the table."""
_FIRST_STEPS: Final = 20
_LAST_STEPS: Final = 40
_SURVIVORS: Final = 128
Function = Callable[[ArrayF], ArrayF]

NONE: Final = "none: all assumptions hold"
STARTS_OF_ALTERNATIVES: Final = 256
"""Starting points for each alternative: with four times as many the same cells are missed."""
ROOT_3: Final = float(np.sqrt(3.0))


# ---------------------------------------------------------------- reconstruction


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What is taken as known, and what is estimated.

    Parameters
    ----------
    budget : sigmas, direction and motion; the start of all unknowns that are not estimated.
    published : cells, see `thalweg_lab.reproduction.published_budgets`.
    lever_length_m : published length of the inner lever arm; 0 takes the arm away, None leaves it free.
    free_attitude, free_boresight : False keeps the budget's angles of the outer or inner frame.
    """

    budget: Budget
    published: pd.DataFrame
    lever_length_m: float | None = None
    free_attitude: bool = True
    free_boresight: bool = True

    @cached_property
    def start(self) -> ArrayF:
        """Attitude, boresight (radians) and lever arm (metres) of the budget, (9,)."""
        outer, inner = self.budget.frames
        lever = np.zeros(3) if self.lever_length_m == 0 else np.asarray(inner.lever_m)
        angles = [np.deg2rad(list(frame.angles_deg.values())) for frame in (outer, inner)]
        return np.concatenate([*angles, lever])

    @cached_property
    def free(self) -> ArrayI:
        """Places of the unknowns among the nine."""
        attitude = self.free_attitude
        parts = [attitude and self.budget.motion is not None, attitude, attitude]
        return np.flatnonzero([*parts, *[self.free_boresight] * 3, *[self.lever_length_m != 0] * 3])


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """A geometry that a table implies.

    ``budget`` with the estimated frames; ``cost``, half the sum of squared residuals over tolerances;
    ``n_equal`` of ``n_starts`` starting points that end in the same cells, and ``n_geometries``, how many
    different ones they are; ``weakest``, the least singular value of the derivatives at the solution over the
    largest: below 1e-6 a whole line of geometries has the same cells.
    """

    budget: Budget
    cost: float
    n_starts: int
    n_equal: int
    n_geometries: int
    weakest: float


def reconstruct(setup: Setup, *, starts: int = STARTS) -> Solution:
    """Estimate the geometry of a chain of two frames from its published table.

    Of solutions with equal cells those with an attitude's phi within a quarter turn come first, of these that
    with the smallest boresight, then the one with the smallest attitude, as angles of their rotations.

    Parameters
    ----------
    starts : starting points, a power of two.
    """
    residuals = _residuals(setup)
    first = _descend(residuals, _starting_points(setup, starts), _FIRST_STEPS)
    order = np.argsort(np.sum(residuals(first) ** 2, axis=1), kind="stable")
    found = _descend(residuals, first[order[:_SURVIVORS]], _LAST_STEPS)
    r = residuals(found)
    best = r[int(np.argmin(np.sum(r**2, axis=1)))]
    equal = _full(setup, found[np.abs(r - best).max(axis=1) < EQUAL])
    chosen = equal[_preferred(equal)]

    def one(p: ArrayF) -> ArrayF:
        """The residuals of a single set of unknowns."""
        return np.asarray(residuals(p[None])[0])

    fine = least_squares(one, chosen[setup.free], xtol=1e-14, ftol=1e-14, gtol=1e-14)
    values = np.linalg.svd(np.asarray(fine.jac), compute_uv=False)
    return Solution(
        budget=_with(setup, _full(setup, fine.x[None])[0]),
        cost=float(fine.cost),
        n_starts=starts,
        n_equal=len(equal),
        n_geometries=len(np.unique(np.column_stack([_matrices(equal), equal[:, 6:]]).round(3), axis=0)),
        weakest=float(values[-1] / values[0]),
    )


def _preferred(p: ArrayF) -> int:
    """Which of equal solutions (m, 9) is shown; rounded, so that no machine's last digits choose."""
    attitude, boresight = (Rotation.from_euler("XYZ", p[:, k : k + 3]).magnitude().round(3) for k in (0, 3))
    return int(np.lexsort((*p.T.round(3), attitude, boresight, np.abs(p[:, 1]) > np.pi / 2))[0])


def _matrices(p: ArrayF) -> ArrayF:
    """Both rotations of parameters (m, 9), (m, 18): the same for angles that differ by full turns."""
    turns = [rotation_opk(*p[:, k : k + 3].T).reshape(len(p), 9) for k in (0, 3)]
    return np.concatenate(turns, axis=1)


def _starting_points(setup: Setup, starts: int) -> ArrayF:
    """(m, q): angles anywhere, lever arm within a cube."""
    size = np.array([np.pi] * 6 + [LEVER_START_M] * 3)
    points = qmc.Sobol(len(setup.free), scramble=False).random(starts)
    # half a step off: the first point of the sequence is the corner, where every angle is a half turn
    return np.asarray((2 * points - 1 + 1 / starts) * size[setup.free])


def _full(setup: Setup, p: ArrayF) -> ArrayF:
    """All nine (m, 9) from the unknowns (m, q), angles within a half turn.

    Angles ``(w, p, k)`` and ``(w + pi, pi - p, k + pi)`` are the same rotation. Where no angle has a speed of
    its own, the one with phi within a quarter turn is taken.
    """
    out = np.tile(setup.start, (len(p), 1))
    out[:, setup.free] = p
    for k in (0, 3) if setup.budget.motion is None else (3,):
        far = np.cos(out[:, k + 1]) < 0
        out[far, k + 1] = np.pi - out[far, k + 1]
        out[far, k], out[far, k + 2] = out[far, k] + np.pi, out[far, k + 2] + np.pi
    out[:, :6] = np.pi - np.mod(np.pi - out[:, :6], 2 * np.pi)
    return out


def _residuals(setup: Setup) -> Function:
    """Function of unknowns (m, q): residuals (m, r) over tolerances, all points of one chain."""
    budget = setup.budget
    outer, inner = budget.frames
    sigma_mm = {item.key: 1e3 * item.sigma_si for item in budget.inputs}
    names = [f"{frame.name}.{part}" for frame in (outer, inner) for part in (*frame.angles_deg, *COORDINATES)]
    angular = [name for name in names if name.rpartition(".")[2] not in COORDINATES]
    cells = setup.published[setup.published["input"].isin([*angular, "time"])]
    distances = np.unique(cells["distance_m"].to_numpy(float))
    at = np.searchsorted(distances, cells["distance_m"])
    column = np.array([[*names, "time"].index(key) for key in cells["input"]])
    factor = np.array([sigma_mm[key] for key in cells["input"]])
    value, tolerance = cells["value_mm"].to_numpy(float), cells["tolerance_mm"].to_numpy(float)
    points = distances[:, None] * (np.asarray(budget.direction) / np.linalg.norm(budget.direction))
    rates = None if budget.motion is None else budget.motion.rates()

    def residuals(p: ArrayF) -> ArrayF:
        """The table's cells, and the length of the lever arm."""
        nine = _full(setup, p)
        all_nine = np.repeat(nine, len(distances), axis=0)
        turns = (all_nine[:, 0:3], all_nine[:, 3:6])
        links = [
            Link(rotation=np.repeat(rotation_opk(*turn.T), len(distances), axis=0), shift_m=shift)
            for turn, shift in ((nine[:, 0:3], np.zeros(3)), (nine[:, 3:6], all_nine[:, 6:]))
        ]
        chain = chain_derivatives(links, np.tile(points, (len(p), 1)))
        frames, time = frame_columns(chain, [opk_axes(turn[:, 0], turn[:, 1]) for turn in turns], rates)
        parts = [*frames, *([] if time is None else [time[:, :, None]])]
        size = np.linalg.norm(np.concatenate(parts, axis=2), axis=1).reshape(len(p), len(distances), -1)
        out = (size[:, at, column] * factor - value) / tolerance
        if setup.lever_length_m:
            length = np.linalg.norm(nine[:, 6:], axis=1)
            out = np.column_stack([out, (length - setup.lever_length_m) / LEVER_WEIGHT_M])
        return np.asarray(out)

    return residuals


def _descend(residuals: Function, p: ArrayF, steps: int) -> ArrayF:
    """Levenberg and Marquardt's steps from all starting points (m, q) side by side."""
    m, q = p.shape
    step = 1e-6
    damping = np.full(m, 1e-2)
    r = residuals(p)
    cost = np.sum(r**2, axis=1)
    for _ in range(steps):
        moved = (p[:, None, :] + step * np.eye(q)).reshape(m * q, q)
        J = (residuals(moved).reshape(m, q, -1) - r[:, None, :]) / step
        N = J @ np.swapaxes(J, 1, 2)
        slope = np.einsum("mqr,mr->mq", J, r)
        system = N + (damping * np.einsum("mqq->m", N))[:, None, None] * np.eye(q)
        tried = p - np.linalg.solve(system, slope[:, :, None])[:, :, 0]
        r_tried = residuals(tried)
        cost_tried = np.sum(r_tried**2, axis=1)
        better = cost_tried < cost
        p, r = np.where(better[:, None], tried, p), np.where(better[:, None], r_tried, r)
        cost = np.where(better, cost_tried, cost)
        damping = np.clip(np.where(better, damping / 5, damping * 4), 1e-8, 1e4)
    return p


def _with(setup: Setup, p: ArrayF) -> Budget:
    """The budget with estimated frames; ``p`` (9,)."""
    outer, inner = setup.budget.frames
    lever = (float(p[6]), float(p[7]), float(p[8]))
    frames = (
        replace(outer, angles_deg=_degrees(outer, p[:3])),
        replace(inner, angles_deg=_degrees(inner, p[3:6]), lever_m=lever),
    )
    return replace(setup.budget, frames=frames)


def _degrees(frame: Frame, angles: ArrayF) -> dict[str, float]:
    return dict(zip(frame.angles_deg, (float(a) for a in np.rad2deg(angles)), strict=True))


def solution_facts(solution: Solution) -> dict[str, object]:
    """What a page says about a solution, as plain values."""
    facts: dict[str, object] = {
        "cost": solution.cost,
        "n_starts": solution.n_starts,
        "n_kept": min(_SURVIVORS, solution.n_starts),
        "n_equal": solution.n_equal,
        "n_geometries": solution.n_geometries,
        "weakest": solution.weakest,
    }
    for frame in solution.budget.frames:
        facts |= {f"{frame.name}_{angle}_deg": value for angle, value in frame.angles_deg.items()}
        facts |= {f"{frame.name}_{c}_m": x for c, x in zip(COORDINATES, frame.lever_m, strict=True)}
    return facts


# ---------------------------------------------------------------- which assumptions a published table needs
#
# What is left out may come in several ways (along which axis?); the way that comes nearest to the table
# counts. Beside assumptions that the table needs stand those that it does not settle.


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
            left_out="point in equal parts along the scanner's axes",
            instead=f"point along {name}",
            setup=replace(setup, budget=replace(budget, direction=(along[0], along[1], along[2]))),
        )
    yield Alternative(
        left_out="direction around the scanner's z axis",
        instead="point at (1.41, 0, 1)",
        needed=False,
        setup=replace(setup, budget=replace(budget, direction=(float(np.sqrt(2.0)), 0.0, 1.0))),
    )
    yield Alternative(
        left_out="angles of the platform",
        instead="parallel to the world",
        setup=replace(setup, free_attitude=False),
    )
    yield Alternative(
        left_out="angles of the mount",
        instead="parallel to the platform",
        setup=replace(setup, free_boresight=False),
    )
    if setup.lever_length_m:
        yield Alternative(left_out="lever arm", instead="none", setup=replace(setup, lever_length_m=0.0))
        yield Alternative(
            left_out="length of the lever arm",
            instead="any length",
            needed=False,
            setup=replace(setup, lever_length_m=None),
        )
    else:
        yield Alternative(
            left_out="lever arm of zero",
            instead="0.16 m, as on the camera's mount",
            needed=False,
            setup=replace(setup, lever_length_m=0.16),
        )
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
            left_out=left_out,
            instead=instead,
            setup=replace(setup, budget=replace(setup.budget, motion=speeds)),
            **how,
        )

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
        yield other(
            "0.4 m/s on the third axis",
            f"all but {name}",
            turn,
            tuple(v * (i != k) for i, v in enumerate(move)),
            needed=False,
        )


def left_out(setup: Setup, *, starts: int = STARTS_OF_ALTERNATIVES) -> pd.DataFrame:
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
