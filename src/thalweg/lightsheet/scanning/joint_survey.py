"""Echo sounder and light sheet on one boat: who measures which part of a river bed (T 3.2, Fig. 3.5).

The echo sounder is taken as reliable from 20 cm of water on, the light sheet from 5 to 20 cm. On a zigzag
across the river the first measures single spots along the track, the second a strip as wide as its line. The
gain is what of the bed is measured at all, how far the measured bed comes to the banks, and how well a cross
section is known that is interpolated from the measurements.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import ArrayB, ArrayF, ArrayI, GeometryError, root_mean_square
from thalweg.lightsheet.optics import Sensor, depth_lines

ECHO_LEAST_M: Final = 0.2
LASER_M: Final = (0.05, 0.2)
"""Depths of water that T 3.2 assumes."""

CELL_M: Final = 0.05
_CLASSES_M: Final = (0.0, 0.05, 0.2, 0.5, 1.0, np.inf)
ECHO, LASER = 1, 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A cross-section of a river that is alike along its course.

    ``across_m`` (n,) growing, ``depth_m`` (n,) below the water level; zero at both ends: the water's edges.

    Raises
    ------
    GeometryError : numbers that do not grow, depths that are negative, or a bank under water.
    """

    across_m: ArrayF
    depth_m: ArrayF

    def __post_init__(self) -> None:
        y, d = self.across_m, self.depth_m
        if (
            y.shape != d.shape
            or len(y) < 3
            or not (np.diff(y) > 0).all()
            or (d < 0).any()
            or max(d[0], d[-1]) > 0
        ):
            raise GeometryError(
                f"a cross-section of {y.shape} places and {d.shape} depths",
                where="joint survey",
                expected="three and more growing places with depths of zero at both edges of the water",
            )

    def depth(self, across_m: ArrayF) -> ArrayF:
        """Depths (n,) at places (n,), zero on land."""
        return np.interp(across_m, self.across_m, self.depth_m, left=0.0, right=0.0)

    @property
    def width_m(self) -> float:
        """From edge to edge."""
        return float(self.across_m[-1] - self.across_m[0])


def small_river(width_m: float = 10.0, deepest_m: float = 2.5) -> Section:
    """A section as T 3.2 describes it: 10 m wide, up to 2.5 m deep, shallow ground in front of both banks."""
    u = np.linspace(0.0, 1.0, 201)
    channel = deepest_m * np.exp(-(((u - 0.58) / 0.17) ** 2))
    shallow = 0.16 * np.sin(np.pi * u) ** 0.5
    depth = np.minimum(channel + shallow, deepest_m) * np.minimum(1.0, np.minimum(u, 1 - u) / 0.03)
    depth[0] = depth[-1] = 0.0
    return Section(across_m=width_m * u, depth_m=depth)


@dataclass(frozen=True, slots=True, kw_only=True)
class SurveyPlan:
    """How the boat goes, and how its instruments measure.

    Parameters
    ----------
    length_m : of the river.
    wavelength_m : of the zigzag along the river: there and back.
    speed_mps : over ground.
    least_depth_m : of water in which the boat turns.
    echo_hz, echo_beam_deg : soundings a second, full opening angle of the beam.
    laser_hz : lines a second; laser_points : points of a line.
    swath_m : depths of water and widths of the line there, see `swath`.
    """

    length_m: float = 30.0
    wavelength_m: float = 6.0
    speed_mps: float = 0.5
    least_depth_m: float = 0.06
    echo_hz: float = 10.0
    echo_beam_deg: float = 9.0
    laser_hz: float = 10.0
    laser_points: int = 500
    swath_m: tuple[ArrayF, ArrayF] = field(
        default_factory=lambda: (np.array([0.05, 0.2]), np.array([0.13, 0.2]))
    )


def swath(sensor: Sensor, window_depth_m: float, depths_m: Sequence[float]) -> tuple[ArrayF, ArrayF]:
    """Width of the line on a level bed, for depths of water.

    Parameters
    ----------
    sensor : the light-sheet sensor.
    window_depth_m : of the outer face of its window below the water level.
    depths_m : of water; those at which no line is in the picture have the width 0.
    """
    depths = np.asarray(depths_m, dtype=np.float64)
    below = (depths - window_depth_m) * 1e3
    lines = depth_lines(sensor, below[below > 0].tolist())
    width = np.zeros(len(depths))
    width[below > 0] = [
        1e-3 * float(np.linalg.norm(np.ptp(line.xyz_lcs_mm[:, :2], axis=0)))
        if len(line.xyz_lcs_mm) > 1
        else 0.0
        for line in lines
    ]
    return depths, width


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSurvey:
    """Simulated survey: ``track_m`` (k, 2) along and across; measured places ``places_m`` (n, 3) along,
    across, depth, and ``instrument`` (n,) `ECHO` or `LASER`; ``table`` by class of depth; ``facts``.
    """

    track_m: ArrayF
    places_m: ArrayF
    instrument: ArrayI
    table: pd.DataFrame
    facts: dict[str, Any]


def joint_survey(section: Section, plan: SurveyPlan | None = None) -> JointSurvey:
    """What a zigzag measures with either instrument, and what the light sheet adds.

    Raises
    ------
    GeometryError : the river is nowhere deep enough for the boat.
    """
    plan = plan or SurveyPlan()
    track = _track(section, plan)
    echo = _soundings(section, plan, track)
    laser = _lines(section, plan, track)
    places = np.concatenate([echo, laser])
    kind = np.concatenate([np.full(len(echo), ECHO), np.full(len(laser), LASER)]).astype(np.int64)
    return JointSurvey(
        track_m=track,
        places_m=places,
        instrument=kind,
        table=_by_depth(section, plan, echo, laser),
        facts=_facts(section, plan, echo, laser),
    )


def _track(section: Section, plan: SurveyPlan) -> ArrayF:
    """Places (k, 2) along and across, a centimetre apart, between the limits of the boat."""
    y = np.linspace(section.across_m[0], section.across_m[-1], 2001)
    deep = y[section.depth(y) >= plan.least_depth_m]
    if not len(deep):
        raise GeometryError(
            f"a river of at most {section.depth_m.max():.2f} m",
            where="joint survey",
            expected=f"{plan.least_depth_m} m for the boat",
        )
    corners = np.arange(0.0, plan.length_m + plan.wavelength_m / 2, plan.wavelength_m / 2)
    corner_y = np.where(np.arange(len(corners)) % 2 == 0, deep[0], deep[-1])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(corners), np.diff(corner_y)))])
    s = np.arange(0.0, way[-1], 0.01)
    track = np.stack([np.interp(s, way, corners), np.interp(s, way, corner_y)], axis=1)
    return np.asarray(track[track[:, 0] <= plan.length_m])


def _every(track: ArrayF, plan: SurveyPlan, hz: float) -> ArrayI:
    """Rows of the track at which an instrument measures."""
    step = plan.speed_mps / hz / 0.01
    return np.unique(np.arange(0.0, len(track), step).astype(np.int64))


def _soundings(section: Section, plan: SurveyPlan, track: ArrayF) -> ArrayF:
    at = track[_every(track, plan, plan.echo_hz)]
    depth = section.depth(at[:, 1])
    return np.column_stack([at, depth])[depth >= ECHO_LEAST_M]


def _lines(section: Section, plan: SurveyPlan, track: ArrayF) -> ArrayF:
    """Points of the light sheet; the line stands across the course."""
    rows = _every(track, plan, plan.laser_hz)
    ahead = np.gradient(track, axis=0)[rows]
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    width = np.interp(section.depth(track[rows, 1]), *plan.swath_m, left=plan.swath_m[1][0])
    u = np.linspace(-0.5, 0.5, plan.laser_points)
    xy = (track[rows, None] + (width[:, None] * u)[:, :, None] * aside[:, None]).reshape(-1, 2)
    depth = section.depth(xy[:, 1])
    use = (depth >= LASER_M[0]) & (depth <= LASER_M[1]) & (xy[:, 0] >= 0) & (xy[:, 0] <= plan.length_m)
    return np.column_stack([xy, depth])[use]


def _covered(
    section: Section, plan: SurveyPlan, echo: ArrayF, laser: ArrayF
) -> tuple[ArrayF, ArrayB, ArrayB]:
    """Depth of each cell of the wet bed, and whether it was measured by either instrument."""
    x = np.arange(CELL_M / 2, plan.length_m, CELL_M)
    y = np.arange(section.across_m[0] + CELL_M / 2, section.across_m[-1], CELL_M)
    shape = (len(y), len(x))

    def marked(points: ArrayF) -> ArrayB:
        """Cells that hold one of the points."""
        out = np.zeros(shape, dtype=np.bool_)
        i = ((points[:, 1] - section.across_m[0]) / CELL_M).astype(np.int64)
        j = (points[:, 0] / CELL_M).astype(np.int64)
        inside = (i >= 0) & (i < shape[0]) & (j >= 0) & (j < shape[1])
        out[i[inside], j[inside]] = True
        return out

    # the footprint of a sounding, as points on its disc
    radius = echo[:, 2] * np.tan(np.deg2rad(plan.echo_beam_deg / 2))
    ring = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    disc = np.concatenate(
        [[[0.0, 0.0]], *(r * np.stack([np.cos(ring), np.sin(ring)], axis=1) for r in (0.5, 1.0))]
    )
    spots = (echo[:, None, :2] + radius[:, None, None] * disc).reshape(-1, 2)
    depth = np.repeat(section.depth(y)[:, None], len(x), axis=1)
    return depth, marked(spots), marked(laser)


def _by_depth(section: Section, plan: SurveyPlan, echo: ArrayF, laser: ArrayF) -> pd.DataFrame:
    depth, by_echo, by_laser = _covered(section, plan, echo, laser)
    rows = []
    for low, high in pairwise(_CLASSES_M):
        cells = (depth >= low) & (depth < high)
        area = float(cells.sum()) * CELL_M**2
        if not area:
            continue
        n = [int(((p[:, 2] >= low) & (p[:, 2] < high)).sum()) for p in (echo, laser)]
        rows.append(
            {
                "from_m": low,
                "to_m": high,
                "area_m2": area,
                "soundings": n[0],
                "laser_points": n[1],
                "soundings_per_m2": n[0] / area,
                "laser_points_per_m2": n[1] / area,
                "share_echo": float(by_echo[cells].mean()),
                "share_laser": float(by_laser[cells].mean()),
                "share_joint": float((by_echo | by_laser)[cells].mean()),
            }
        )
    return pd.DataFrame(rows)


def _facts(section: Section, plan: SurveyPlan, echo: ArrayF, laser: ArrayF) -> dict[str, Any]:
    """Gain: shares of the wet width, gaps to the water's edge, error of the interpolated section."""
    y = np.linspace(section.across_m[0], section.across_m[-1], 4001)
    depth = section.depth(y)
    deep, shallow = depth >= ECHO_LEAST_M, (depth >= LASER_M[0]) & (depth < LASER_M[1])
    joint = np.concatenate([echo, laser])
    spacing = plan.speed_mps / plan.echo_hz
    out: dict[str, Any] = {
        "width_m": section.width_m,
        "share_of_width_echo": float(deep.mean()),
        "share_of_width_laser": float(shallow.mean()),
        "share_of_width_joint": float((deep | shallow).mean()),
        "soundings": len(echo),
        "laser_points": len(laser),
        "echo_spacing_m": spacing,
        "laser_line_spacing_m": plan.speed_mps / plan.laser_hz,
        "points_per_sounding": len(laser) / max(len(echo), 1),
    }
    for name, points in (("echo", echo), ("joint", joint)):
        first, last = (
            (float(points[:, 1].min()), float(points[:, 1].max())) if len(points) else (np.nan, np.nan)
        )
        out[f"gap_left_{name}_m"] = first - float(section.across_m[0])
        out[f"gap_right_{name}_m"] = float(section.across_m[-1]) - last
        error = _interpolated(section, points, y) - depth
        out[f"rmse_section_{name}_m"] = root_mean_square(error)
        out[f"rmse_shallow_{name}_m"] = root_mean_square(error[shallow]) if shallow.any() else np.nan
    return out


def _interpolated(section: Section, points: ArrayF, y: ArrayF) -> ArrayF:
    """Section (n,) through measured places and the water's edges, straight between them."""
    order = np.argsort(points[:, 1], kind="stable")
    across = np.concatenate([[section.across_m[0]], points[order, 1], [section.across_m[-1]]])
    return np.interp(y, across, np.concatenate([[0.0], points[order, 2], [0.0]]))
