"""What a calibration run must have, and the words for what it lacks."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2

from thalweg.calibration.ins_lidar.model import Known
from thalweg.calibration.ins_lidar.motion_search import OnCones
from thalweg.calibration.ins_lidar.run_points import FieldCones
from thalweg.core.adjustment.solve import UnobservableError
from thalweg.core.errors import CoverageError, GeometryError
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF

PARAMETERS: Final = ("lever_x", "lever_y", "lever_z", "rotation_x", "rotation_y", "rotation_z")
"""Unknowns of the mount, in ics."""

UNLIKELY: Final = 1e-6
"""Probability below which a cone's disagreement with its reference is no chance."""

_MOST_OFF: Final = 0.7
"""Share of beams toward a cone that something else may return: the ground, passers-by."""

_BIN_DEG: Final = 5
_LEAST_SHARE: Final = 0.002
"""Of the points in a bin of headings, to count as seen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunGates:
    """What a run must have.

    Parameters
    ----------
    min_cones : cones with enough points.
    min_points_per_cone : points on a cone, to count.
    min_headings_deg : range of headings in which cones were seen.
    max_sigma_lever_m, max_sigma_rotation_deg : a parameter with a larger formal sigma is not determined.
    """

    min_cones: int = 3
    min_points_per_cone: int = 100
    min_headings_deg: float = 90.0
    max_sigma_lever_m: float = 0.005
    max_sigma_rotation_deg: float = 0.1


def check_cones(
    selection: OnCones, cones: FieldCones, gates: RunGates, dropped: dict[str, str]
) -> tuple[int, str] | None:
    """A cone with too few points, if enough others are left: its number and the reason to leave it out.

    Raises
    ------
    CoverageError : too few cones are left; names those that are missing.
    """
    c = len(cones.names)
    on = selection.cone >= 0
    used = np.bincount(selection.cone[selection.used], minlength=c)
    near = np.bincount(selection.cone[on], minlength=c)
    few = [k for k in range(c) if used[k] < gates.min_points_per_cone]
    if c - len(few) < gates.min_cones:
        lost = {cones.names[k]: f"{used[k]} of {near[k]} points near it lie on it" for k in few} | dropped
        raise CoverageError(
            f"{c - len(few)} cones were seen by the lidar; not "
            + "; ".join(f"{name}: {why}" for name, why in lost.items()),
            expected=f"{gates.min_cones} cones with {gates.min_points_per_cone} points each",
            cure="Check that the cones stand as they were measured"
            + (
                "; as most of them are off, that heights and datum of the targets are those of the positions"
                if 2 * len(lost) > c + len(dropped)
                else ""
            )
            + ". Record the run again so that the scan planes sweep over them",
        )
    if not few:
        return None
    k = min(few, key=lambda i: int(used[i]))
    return k, f"{used[k]} of {near[k]} points near it lie on its surface"


def moved_cone(
    shift_m: ArrayF, square: ArrayF, selection: OnCones, cones: FieldCones
) -> tuple[int, str] | None:
    """The cone that does not stand where it was measured: moved, toppled or mistaken for another one.

    Parameters
    ----------
    shift_m : (c, 3) by which the run would move each cone if it alone were free.
    square : (c,) its squared size in units of its covariance.
    selection : points of the last pass.
    cones : of the field.
    """
    c = len(cones.names)
    used, far = (np.bincount(selection.cone[rows], minlength=c) for rows in (selection.used, selection.far))
    off = far / np.maximum(used + far, 1)
    cure = "it was moved, has toppled, or its reference is another cone's. Measure the field again"
    if off.max() > _MOST_OFF:
        k = int(np.argmax(off))
        return k, f"{far[k]} of {used[k] + far[k]} beams toward it end before or behind its surface: {cure}"
    k = int(np.argmax(square))
    if square[k] > chi2.isf(UNLIKELY, 3):
        return k, f"its points lie {1e3 * np.linalg.norm(shift_m[k]):.0f} mm beside its reference: {cure}"
    return None


def check_antenna(known: Known, mount: Rigid) -> None:
    """Refuse an antenna by its marker that contradicts the run.

    Parameters
    ----------
    known : with the antenna seen from the scanner; nothing is tested without.
    mount : ``T_ics_scs`` with covariance from the run without that antenna.

    Raises
    ------
    GeometryError : both are farther apart than their sigmas explain, but for a probability of `UNLIKELY`.
    """
    if known.antenna is None:
        return
    point = known.antenna.x_scs_m[None]
    off = mount.apply(point)[0] - known.lever_ics_antenna_m
    J = mount.by_error(point)[0]
    cov = J @ mount.cov @ J.T + mount.R @ known.antenna.cov_m2 @ mount.R.T
    if off @ np.linalg.solve(cov, off) > chi2.isf(UNLIKELY, 3):
        sigma = float(np.sqrt(np.trace(cov)))
        raise GeometryError(
            f"the antenna by its marker lies {1e3 * np.linalg.norm(off):.0f} mm from where the run has it",
            expected=f"agreement within some {1e3 * sigma:.0f} mm (one sigma)",
            cure="Check antenna.marker and antenna.offset_m of the field description (negative for a print "
            "on top of the antenna), that the marker lies on the antenna, and that heights and datum of the "
            "field's targets are those of the positions",
        )


def seen_headings_deg(heading_rad: ArrayF) -> float:
    """Range of headings: the circle without its largest gap, in bins of 5 degrees.

    Examples
    --------
    >>> seen_headings_deg(np.deg2rad([2.0, 8.0, 91.0, 358.0]))
    100.0
    """
    bins = 360 // _BIN_DEG
    number = np.floor(np.rad2deg(heading_rad) % 360.0 / _BIN_DEG).astype(np.int64) % bins
    counts = np.bincount(number, minlength=bins)
    seen = np.flatnonzero(counts >= max(1.0, _LEAST_SHARE * len(heading_rad)))
    gaps = np.diff(np.append(seen, seen[0] + bins)) - 1
    return float(_BIN_DEG * (bins - int(gaps.max())))


def check_turns(heading_rad: ArrayF, gates: RunGates) -> None:
    """Refuse a run in one heading: an offset of the positions or of the field is then a lever arm.

    Raises
    ------
    UnobservableError : the boat turned too little while it saw cones.
    """
    span = seen_headings_deg(heading_rad)
    if span < gates.min_headings_deg:
        raise UnobservableError(
            ["lever_x", "lever_y"],
            defects=2,
            cure=f"The missing motion is a turn: cones were seen in headings that span {span:.0f} deg, "
            f"needed are {gates.min_headings_deg:.0f}. Drive circles or a figure of eight between the cones",
        )


def check_geometry(normals: ArrayF, gates: RunGates) -> None:
    """Refuse cones that leave a parameter of the mount to noise even if all else were known.

    Parameters
    ----------
    normals : (6, 6) normal equations of the mount from the points alone.
    gates : limits of the formal sigmas.

    Raises
    ------
    UnobservableError : names the parameters.
    """
    limit = np.r_[np.full(3, gates.max_sigma_lever_m), np.full(3, np.deg2rad(gates.max_sigma_rotation_deg))]
    power, axes = np.linalg.eigh(normals * np.outer(limit, limit))
    free = power < 1.0
    if not free.any():
        return
    part = np.sqrt(np.square(axes[:, free]).sum(axis=1))
    order = np.argsort(-part)
    raise UnobservableError(
        [PARAMETERS[i] for i in order if part[i] > 0.3 * part[order[0]]],
        defects=int(free.sum()),
        cure="Use cones on both sides of the boat, in different heights and distances, and pass them all",
    )
