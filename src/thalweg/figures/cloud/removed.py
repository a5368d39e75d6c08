"""What each filter left out of the cloud: one small picture for each reason that took a point."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from scipy.spatial import cKDTree

from thalweg.core import ArrayF, GeometryError, Trajectory, read_table
from thalweg.figures import BLUE, HALO, VERMILION, count, legend_below, new_figure, styled
from thalweg.lidar import REMOVED, REMOVED_POINTS, WORDS, Reason, sample_cloud

MOST_KEPT = 200_000

COLUMNS: Final = 2
PANEL_MM: Final = 58.0
KEPT_COLOUR: Final = "0.70"

TRACK_STEP_M: Final = 0.5
"""Distance of the points of the track from which distances are taken."""

ALONG_M: Final = 15.0
"""The direction of the river is that of the track from so far behind to so far ahead."""

_LIMITS: Final = (0.2, 99.8)
"""Percentiles of the removed points that the axes hold; what lies beyond is counted in the panel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """What all panels share.

    Parameters
    ----------
    removed : (n) table of kind ``removed_points``.
    n : number of removed points of each reason, of which the table holds a sample.
    kept_wcs_m : (m, 3) even sample of the cloud.
    trajectory : poses of the boat.
    filters : section ``filters`` of the campaign, or part of it.
    """

    removed: pd.DataFrame
    n: Mapping[Reason, int]
    kept_wcs_m: ArrayF
    trajectory: Trajectory
    filters: Mapping[str, Any]

    def of(self, reason: Reason, *columns: str) -> ArrayF:
        """Columns of the sampled points of a reason, (n, k)."""
        here = self.removed["reason"] == reason.name.lower()
        return self.removed.loc[here, list(columns)].to_numpy(dtype=np.float64)


@styled
def removed_points(
    removed: pd.DataFrame,
    counts: pd.DataFrame,
    kept_wcs_m: ArrayF,
    trajectory: Trajectory,
    *,
    filters: Mapping[str, Any] | None = None,
    title: str = "Points left out of the cloud",
) -> Figure:
    """What each filter left out: in plan, across the river, from the boat, or over time.

    Parameters
    ----------
    removed : table of kind ``removed_points``, a sample for each reason.
    counts : columns ``reason`` and ``n``, see `thalweg.lidar.filters.reason_table`.
    kept_wcs_m : (m, 3) even sample of the cloud, drawn in grey.
    trajectory : poses of the boat.
    filters : section ``filters``, whose limits are drawn.
    title : first words of the title.

    Raises
    ------
    GeometryError : the trajectory has no valid node.
    """
    listed = counts.set_index("reason")["n"]
    n = {reason: int(listed.get(reason.name.lower(), 0)) for reason in Reason}
    if not trajectory.valid.any():
        raise GeometryError("a trajectory without a valid node", expected="at least one pose to draw")
    scene = Scene(
        removed=removed, n=n, kept_wcs_m=kept_wcs_m, trajectory=trajectory, filters=dict(filters or {})
    )
    shown = [reason for reason in REMOVED if n[reason]]
    total, left_out = sum(n.values()), sum(n[reason] for reason in shown)
    share = f" ({_percent(left_out, total)})" if left_out else ""
    rows = max(1, -(-len(shown) // COLUMNS))
    head = f"{title}, n = {count(left_out)} of {count(total)} points{share}"
    figure = new_figure(PANEL_MM * rows + 24.0, head)
    if not shown:
        ax = figure.add_subplot()
        ax.set_axis_off()
        ax.text(0.5, 0.5, "No filter left out a point.", ha="center", va="center", transform=ax.transAxes)
        return figure
    axes = figure.subplots(rows, min(COLUMNS, len(shown)), squeeze=False).ravel()
    for ax, reason in zip(axes, shown, strict=False):
        drawn, beyond = PANELS[reason](ax, scene, reason)
        _entitle(ax, reason, n[reason], total, drawn=drawn, beyond=beyond)
    for ax in axes[len(shown) :]:
        ax.set_axis_off()
    # the filters that found nothing are named, so that their absence is no riddle
    idle = [_name(reason) for reason in REMOVED if not n[reason]]
    legend_below(figure, *axes[: len(shown)], title="Left out nothing: " + ", ".join(idle) if idle else None)
    return figure


def _percent(part: int, whole: int) -> str:
    """``12.3 %``, or ``below 0.01 %`` rather than a zero that is none.

    Examples
    --------
    >>> [_percent(n, 100000) for n in (1, 25, 12345)]
    ['below 0.01 %', '0.03 %', '12 %']
    """
    percent = 100.0 * part / whole
    if percent < 0.01:
        return "below 0.01 %"
    return f"{percent:.{2 if percent < 1 else 1 if percent < 10 else 0}f} %"


def _name(reason: Reason) -> str:
    return reason.name.replace("_", " ").lower().replace("gps", "GPS")


def _entitle(ax: Axes, reason: Reason, n: int, total: int, *, drawn: int, beyond: int) -> None:
    ax.set_title(f"{_name(reason)}: n = {count(n)}, {_percent(n, total)}\n{WORDS[reason]}")
    notes = [f"{count(drawn)} drawn"] if drawn + beyond < n else []
    notes += [f"{count(beyond)} beyond the axes"] if beyond else []
    ax.text(
        0.99,
        0.98,
        ", ".join(notes),
        transform=ax.transAxes,
        ha="right",
        va="top",
        fontsize=7,
        zorder=9,
        path_effects=HALO,
    )


# ---------------------------------------------------------------- kinds of panels

Drawn = tuple[int, int]
"""Points drawn, and points beyond the axes."""


def _scatter(ax: Axes, xy: ArrayF, limits: ArrayF) -> Drawn:
    """Draw removed points; few of them get large marks. ``limits`` are low and high corner."""
    inside = np.all((xy >= limits[0]) & (xy <= limits[1]), axis=1)
    size = float(np.clip(40.0 / np.sqrt(max(len(xy), 1)), 0.6, 3.0))
    ax.plot(*xy[inside].T, "o", ms=size, mew=0, color=VERMILION, rasterized=True, zorder=3)
    ax.plot([], [], "o", ms=3.0, mew=0, color=VERMILION, label="left out")
    return int(inside.sum()), int(np.sum(~inside))


def _grey(ax: Axes, xy: ArrayF) -> None:
    ax.plot(*xy.T, ",", color=KEPT_COLOUR, rasterized=True, zorder=1)
    ax.plot([], [], "s", ms=3.0, color=KEPT_COLOUR, label="cloud, even sample")


def _limits(*parts: ArrayF, margin: float = 0.06) -> ArrayF:
    """Low and high corner that hold nearly all points of each part, with a margin."""
    corners = np.concatenate([np.percentile(part, _LIMITS, axis=0) for part in parts if len(part)])
    low, high = corners.min(axis=0), corners.max(axis=0)
    room = np.maximum(margin * (high - low), 0.05)
    return np.stack([low - room, high + room])


def _to_scale(ax: Axes, limits: ArrayF) -> None:
    """Equal scales on both axes, in a box of the same size for all panels: one axis gets more room."""
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlim(*limits[:, 0], auto=True)
    ax.set_ylim(*limits[:, 1], auto=True)


def along_reach(track_wcs_m: ArrayF) -> ArrayF:
    """Rotation (2, 2) from (east, north) to (along, left of) the longest extent of a track, eastward.

    Examples
    --------
    >>> along_reach(np.array([[0.0, 0.0], [0.0, 5.0], [1.0, 10.0]])).round(2)
    array([[ 0.1,  1. ],
           [-1. ,  0.1]])
    """
    _, vectors = np.linalg.eigh(np.cov(track_wcs_m[:, :2].T))
    east, north = vectors[:, 1] * (1.0 if vectors[0, 1] >= 0 else -1.0)
    return np.array([[east, north], [-north, east]])


def _plan(ax: Axes, scene: Scene, reason: Reason) -> Drawn:
    """Seen from above, over the cloud and the track, the reach lying along the paper."""
    track = scene.trajectory.position_wcs_m[:, :2].copy()
    valid = scene.trajectory.valid
    R = along_reach(track[valid])
    track[~valid] = np.nan
    first = track[valid][0]
    xy, kept, track = (
        (part - first) @ R.T
        for part in (scene.of(reason, "east_m", "north_m"), scene.kept_wcs_m[:, :2], track)
    )
    limits = _limits(xy, track[valid], kept)
    _grey(ax, kept)
    ax.plot(*track.T, color="black", lw=0.7, zorder=2, label="track of the boat")
    drawn = _scatter(ax, xy, limits)
    _to_scale(ax, limits)
    ax.set_xlabel("along the reach, from the first pose / m")
    ax.set_ylabel("across / m")
    return drawn


def _section(ax: Axes, scene: Scene, reason: Reason) -> Drawn:
    """Across the river: height above the water at the boat over the distance from the track."""
    across = Across(scene.trajectory, float(scene.filters.get("water_line_ics_m", 0.0)))
    xy = across(scene.of(reason, "east_m", "north_m", "up_m"))
    kept = across(scene.kept_wcs_m)
    limits = _limits(xy)
    # as much above the water as below it, so that a mirror image is seen with its origin
    limits[1, 1] = max(limits[1, 1], -limits[0, 1])
    _grey(ax, kept)
    ax.axhline(0.0, color=BLUE, lw=0.8, zorder=2, label="water level at the boat")
    margin = scene.filters.get("below_water_m")
    if margin is not None:
        grows = scene.filters.get("below_water_sigmas") or 0
        label = "limit below the water" + (f", + {grows:g} sigma" if grows else "")
        ax.axhline(-margin, color=BLUE, lw=0.8, ls="--", zorder=2, label=label)
    drawn = _scatter(ax, xy, limits)
    ax.set_xlim(*limits[:, 0])
    ax.set_ylim(*limits[:, 1])
    ax.set_xlabel("left  ←  distance from the track / m  →  right")
    ax.set_ylabel("above the water / m")
    return drawn


def _from_behind(ax: Axes, scene: Scene, reason: Reason) -> Drawn:
    """In the body frame, seen from the stern: up over right, the INS at zero."""
    xy = scene.of(reason, "y_ics_m", "z_ics_m") * [1.0, -1.0]
    limits = _limits(xy)
    low, high = scene.filters.get("hull_low_ics_m"), scene.filters.get("hull_high_ics_m")
    if reason == Reason.OWN_HULL and low is not None and high is not None:
        corner, opposite = np.array([low[1], -high[2]]), np.array([high[1], -low[2]])
        limits = np.stack([np.minimum(limits[0], corner - 0.05), np.maximum(limits[1], opposite + 0.05)])
        size = opposite - corner
        ax.add_patch(Rectangle((corner[0], corner[1]), size[0], size[1], fill=False, ls="--"))
        ax.plot([], [], color="black", ls="--", lw=0.6, label="box of the own boat")
    drawn = _scatter(ax, xy, limits)
    ax.plot(0.0, 0.0, "+", color="black", ms=6, zorder=4, label="INS")
    if "water_line_ics_m" in scene.filters:
        ax.axhline(
            -scene.filters["water_line_ics_m"], color=BLUE, lw=0.8, zorder=2, label="water level at the boat"
        )
    _to_scale(ax, limits)
    ax.set_xlabel("right / m   (body frame, seen from the stern)")
    ax.set_ylabel("up / m")
    return drawn


def _over_time(ax: Axes, scene: Scene, reason: Reason) -> Drawn:
    """How many points were lost when, with the times that have poses."""
    t = scene.of(reason, "t_gps_s").ravel()
    first, last = scene.trajectory.span()
    begin, end = min(first, float(np.min(t, initial=first))), max(last, float(np.max(t, initial=last)))
    edges = np.linspace(begin, end, 121) - first
    n, _ = np.histogram(t - first, edges)
    # the sample stands for all
    rate = n * scene.n[reason] / max(len(t), 1) / np.diff(edges)
    ax.stairs(rate, edges, fill=True, color=VERMILION)
    ax.plot([], [], "o", ms=3.0, mew=0, color=VERMILION, label="left out")
    node_t, valid = scene.trajectory.t_gps_s - first, scene.trajectory.valid
    poses, place = np.where(valid, -0.06, np.nan), ax.get_xaxis_transform()
    ax.plot(
        node_t,
        poses,
        transform=place,
        color="black",
        lw=2.5,
        solid_capstyle="butt",
        clip_on=False,
        label="times with a pose",
    )
    ax.tick_params(axis="x", pad=7)
    ax.set_xlim(edges[0], edges[-1])
    ax.set_ylim(0.0)
    ax.set_xlabel("time since the first pose / s")
    ax.set_ylabel("left out / (points/s)")
    return len(t), 0


PANELS: Final[Mapping[Reason, Callable[[Axes, Scene, Reason], Drawn]]] = {
    Reason.NO_GPS_TIME: _from_behind,
    Reason.NO_POSE: _over_time,
    Reason.TOO_NEAR: _from_behind,
    Reason.TOO_FAR: _plan,
    Reason.OWN_HULL: _from_behind,
    Reason.UNCERTAIN: _plan,
    Reason.BELOW_WATER: _section,
    Reason.MIRROR_GHOST: _section,
    Reason.ISOLATED: _plan,
}
"""How each reason is shown."""


class Across:
    """Distance from the track, right of its general direction positive, and height above the water there.

    Parameters
    ----------
    trajectory : poses of the boat; invalid nodes are left out.
    water_line_ics_m : depth of the water line below the ics origin.
    """

    def __init__(self, trajectory: Trajectory, water_line_ics_m: float) -> None:
        track = trajectory.position_wcs_m[trajectory.valid]
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(track[:, :2], axis=0), axis=1))])
        at = np.arange(0.0, way[-1] + TRACK_STEP_M, TRACK_STEP_M)
        self._en = self._along(at, way, track)
        ahead = self._along(at + ALONG_M, way, track) - self._along(at - ALONG_M, way, track)
        self._right = np.column_stack([ahead[:, 1], -ahead[:, 0]])
        self._level = np.interp(at, way, track[:, 2]) - water_line_ics_m
        self._tree = cKDTree(self._en)

    @staticmethod
    def _along(at: ArrayF, way: ArrayF, track: ArrayF) -> ArrayF:
        return np.column_stack([np.interp(at, way, track[:, axis]) for axis in (0, 1)])

    def __call__(self, points_wcs_m: ArrayF) -> ArrayF:
        """Distance and height (n, 2) of points in wcs."""
        distance, nearest = self._tree.query(points_wcs_m[:, :2])
        offset = points_wcs_m[:, :2] - self._en[nearest]
        right = np.sum(offset * self._right[nearest], axis=1) >= 0
        return np.column_stack(
            [np.where(right, distance, -distance), points_wcs_m[:, 2] - self._level[nearest]]
        )


def draw_removed_points(
    *,
    points: Path,
    removed: Path,
    counts: Path,
    trajectory: Path,
    max_points: int,
    filters: dict[str, Any],
    title: str,
) -> Figure:
    """Cloud, removed points and their counts -> what each filter left out."""
    return removed_points(
        read_table(removed, REMOVED_POINTS)[0],
        pd.read_csv(counts),
        sample_cloud(points, min(MOST_KEPT, max_points))["xyz_m"],
        Trajectory.read(trajectory),
        filters=filters,
        title=f"Points left out of the cloud: {title}",
    )
