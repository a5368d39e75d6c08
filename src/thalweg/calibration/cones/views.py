"""Why a lidar does not see a cone where the reference says, and what to record again.

A beam that meets nothing returns nothing, so that a scan tells where a cone is missing only by its other
beams: by those beside it, and by how far off the plane of the scanner it stands.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from thalweg.calibration.cones.cone import Cone
from thalweg.calibration.cones.selection import Position, Selection, Verdict
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF

AGAIN: Final = "photograph the field and record the positions again, or leave the cone out"
_GAP_DEG: Final = 5
"""Azimuths without returns that count as a gap, degrees."""
_IN_GAP: Final = 0.2
"""Share of a cone in a gap, from which on the gap is told."""
_EDGE_DEG: Final = 0.5
_BESIDE_SIGMAS: Final = 2.5
"""Mean offset of the points of a cone in sigmas of one; the search is right to a fraction of that."""


def gaps_deg(points_scs_m: ArrayF) -> list[tuple[int, int]]:
    """Ranges of azimuth without a return, degrees, from the scanner's y toward x; the end may exceed 360.

    Parameters
    ----------
    points_scs_m : (n, 3) in the frame of the scanner.
    """
    azimuth = np.rad2deg(np.arctan2(points_scs_m[:, 0], points_scs_m[:, 1]))
    seen = np.zeros(360, dtype=np.bool_)
    seen[np.floor(azimuth).astype(np.int64) % 360] = True
    if not seen.any():
        return [(0, 360)]
    first = int(np.flatnonzero(seen)[0])
    ends = np.append(np.flatnonzero(np.roll(seen, -first)), 360) + first
    return [(int(a) + 1, int(b)) for a, b in pairwise(ends) if b - a - 1 >= _GAP_DEG]


def out_of_view(cone: Cone, length_m: float, T_pcs_scs: Rigid, position: Position) -> str:
    """Why no or few beams meet a cone; empty if nothing about the view tells it.

    Parameters
    ----------
    cone, length_m : in pcs.
    T_pcs_scs : where the scanner stands.
    position : its points.
    """
    points = position.points_scs_m
    elevation = np.rad2deg(np.arcsin(points[:, 2] / np.linalg.norm(points, axis=1)))
    low, high = float(elevation.min()), float(elevation.max())
    surface = T_pcs_scs.inverse().apply(_surface(cone, length_m))
    up = np.rad2deg(np.arcsin(surface[:, 2] / np.linalg.norm(surface, axis=1)))
    inside = (up > low - _EDGE_DEG) & (up < high + _EDGE_DEG)
    if not inside.any():
        off = float(up[np.abs(up).argmin()])
        return (
            f"outside the lidar's view: it begins {abs(off):.0f} deg off the plane in which the scanner "
            f"turns, whose beams reach from {low:.0f} to {high:.0f} deg. Set it up in that plane, beside the "
            f"boat, or turn the boat; then {AGAIN}"
        )
    azimuth = np.rad2deg(np.arctan2(surface[inside, 0], surface[inside, 1]))
    for begin, end in gaps_deg(points):
        if np.mean((azimuth - begin) % 360 < end - begin) > _IN_GAP:
            return (
                f"no returns between the azimuths {begin % 360} and {end % 360} deg of the scanner, where it "
                "should be: the recording is cut short or limited to a sector, or the cone is gone with "
                "nothing behind its place. Record the position again with whole rotations and the cone there"
            )
    return ""


def without_support(
    counts: Mapping[Verdict, int], *, least_points: int, least_support: float, view: Callable[[], str]
) -> str:
    """Why a cone takes no part at a position before anything is adjusted; empty if it does.

    Parameters
    ----------
    counts : of its beams.
    least_points : beams that must meet it inside its outline.
    least_support : share of the beams through its place that must end on it rather than behind.
    view : gives what `out_of_view` says of it.
    """
    used, through, before = (counts[v] for v in (Verdict.USED, Verdict.BEHIND, Verdict.IN_FRONT))
    aimed = used + through + before
    if sum(counts.values()) == 0:
        return (
            view()
            or f"no beam should meet it: others hide it, or it is too small there. Move it, then {AGAIN}"
        )
    if before > used + through:
        return (
            f"hidden: {before} of {aimed} beams were reflected before it, by something in front or by the "
            f"cone itself, fallen toward the boat. Clear the view or set it up, then {AGAIN}"
        )
    if aimed < least_points:
        few = f"too few points: {aimed} beams meet it inside its outline, at least {least_points} are needed"
        return f"{few}. {view() or f'Record longer, or set it up nearer to the boat; then {AGAIN}'}"
    if used < least_support * (used + through):
        return (
            f"not where the reference says: {through} of {used + through} beams went through its place; it "
            f"fell over or was moved. Set it up, then {AGAIN}"
        )
    return ""


def nowhere(selection: Selection, cones: int, out: Mapping[int, str]) -> bool:
    """Whether none of several cones that the beams of a position should meet is where it should be.

    Parameters
    ----------
    selection : of the position.
    cones : number of cones.
    out : cones that take no part there.
    """
    met = [k for k in range(cones) if sum(selection.counts(k).values())]
    return len(met) > 1 and all(k in out for k in met)


def beside_its_place(
    cones: Sequence[Cone], T_pcs_scs: Rigid, position: Position, selection: Selection
) -> dict[int, str]:
    """Cones whose points lie clearly before or behind them, the worst first, with words for it.

    Parameters
    ----------
    cones : in pcs.
    T_pcs_scs : where the scanner stands.
    position, selection : its points, and which of them were taken.
    """
    points = position.points_scs_m
    found: list[tuple[float, int, str]] = []
    for k, cone in enumerate(cones):
        rows = selection.rows(k)
        if not len(rows):
            continue
        reach = np.linalg.norm(points[rows], axis=1)
        met = cone.meet(T_pcs_scs.shift_m, points[rows] @ T_pcs_scs.R.T / reach[:, None])
        off = reach - met.range_m - selection.excess_m[rows]
        sigmas = float(np.mean(off / np.sqrt(selection.variance_m2[rows])))
        if abs(sigmas) > _BESIDE_SIGMAS:
            where = "before" if sigmas < 0 else "behind"
            words = f"its points lie {1e3 * abs(float(np.mean(off))):.0f} mm {where} it on average"
            told = (
                f"not where the reference says: {words}; it fell over or was moved. Set it up, then {AGAIN}"
            )
            found.append((-abs(sigmas), k, told))
    return {k: words for _, k, words in sorted(found)}


def _surface(cone: Cone, length_m: float) -> ArrayF:
    """(n, 3) points on a cone."""
    z, turn = np.meshgrid(
        np.linspace(0.05, 1.0, 12) * length_m, np.linspace(0, 2 * np.pi, 24, endpoint=False)
    )
    z, turn = z.reshape(-1, 1), turn.reshape(-1, 1)
    across = np.cos(turn) * cone.tangents[0] + np.sin(turn) * cone.tangents[1]
    return np.asarray(cone.apex_m + z * (cone.axis + np.tan(cone.half_angle_rad) * across))
