"""Footprints of the mobile lidar on the bank (P2 Fig. 17)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from thalweg.calibration import read_mounts
from thalweg.core import ArrayB, ArrayF, GeometryError, Trajectory, iter_laz
from thalweg.figures import (
    HALO,
    ORANGE,
    RANGE_MAP,
    RED,
    VERMILION,
    colour_bar,
    count,
    legend_below,
    marks_in_free_corners,
    new_figure,
    robust_limits,
    show_plan,
    styled,
)
from thalweg.figures.survey import map_extent
from thalweg.lidar import sample_cloud

REVOLUTION_S: Final = 0.1
"""One revolution of the scanner at 10 Hz."""

DISTANCE_M: Final = 30.0
"""Measuring distance of the detail view of P2 Fig. 17b."""

PATCH_M: Final = 3.0
"""Sides of the detail view."""

DISTANCE_CLASS_M: Final = 2.0
"""Patches whose distances differ by less count as equally near; of those the one with more points wins."""

TOLERANCE_M: Final = 3.0
"""Points whose distance differs by no more from the wanted one say which revolution is shown."""

_BAR: Final[dict[str, Any]] = {"location": "bottom", "pad": 0.02, "aspect": 30, "extend": "both"}

TLS_DIVERGENCE_MRAD: Final = 0.3
"""Of the terrestrial scanner: the footprint of the lidar is ten times the size of its spot (P2 section 7)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Patch:
    """A square piece of the bank as it is seen along the beams that meet it.

    Parameters
    ----------
    centre_wcs_m : (3,) its middle.
    right, up, away : (3,) unit vectors in wcs; away is the mean direction of the beams, right is horizontal.
    inside : (n,) true for the points of the frame that lie within the square, seen along ``away``.
    range_m : median measured range of these points.
    """

    centre_wcs_m: ArrayF
    right: ArrayF
    up: ArrayF
    away: ArrayF
    inside: ArrayB
    range_m: float

    def project(self, points_wcs_m: ArrayF) -> ArrayF:
        """Metres to the right and up of the centre, shape (n, 2)."""
        return np.asarray((points_wcs_m - self.centre_wcs_m) @ np.stack([self.right, self.up], axis=1))


def best_moment(t_gps_s: ArrayF, range_m: ArrayF, *, distance_m: float = DISTANCE_M) -> float:
    """Begin of the revolution with most points near a distance, or near the one that comes nearest to it.

    Parameters
    ----------
    t_gps_s, range_m : (n,) adjusted GPS time and measured range of the points or of an even sample.
    distance_m : wanted distance.
    """
    off_m = np.abs(range_m - distance_m)
    near = t_gps_s[off_m <= np.nanmin(off_m) + TOLERANCE_M]
    turns, n = np.unique(np.floor((near - near.min()) / REVOLUTION_S), return_counts=True)
    return float(near.min() + REVOLUTION_S * turns[np.argmax(n)])


def scanner_positions(
    t_gps_s: ArrayF, trajectory: Trajectory, lever_ics_m: ArrayLike
) -> tuple[ArrayF, ArrayB]:
    """Where the scanner was, (n, 3) in wcs, and whether there is a pose, (n,)."""
    position_m, R_wcs_ics, has_pose = trajectory.at(t_gps_s)
    return position_m + R_wcs_ics @ np.asarray(lever_ics_m, dtype=np.float64), has_pose


def choose_patch(
    points_wcs_m: ArrayF, scanner_wcs_m: ArrayF, *, distance_m: float = DISTANCE_M, size_m: float = PATCH_M
) -> Patch:
    """The square with most points among those nearest to a distance.

    Parameters
    ----------
    points_wcs_m : (n, 3) points of one frame.
    scanner_wcs_m : (n, 3) where the scanner was at each point's moment.
    distance_m : wanted distance.
    size_m : sides of the square.

    Raises
    ------
    GeometryError : no point with a position of the scanner, or only points in the scanner itself.
    """
    beam = points_wcs_m - scanner_wcs_m
    range_m = np.linalg.norm(beam, axis=1)
    usable = np.flatnonzero(np.isfinite(range_m) & (range_m > 1e-3))
    if not usable.size:
        raise GeometryError(
            f"a frame of {len(points_wcs_m)} points without a beam",
            expected="points, and a pose of the boat at their times",
            cure="Choose another moment",
        )
    tree = cKDTree(points_wcs_m[usable])
    near = np.array(tree.query_ball_point(points_wcs_m[usable], 0.6 * size_m, return_length=True))
    off_m = np.abs(range_m[usable] - distance_m)
    best = usable[np.lexsort((off_m, -near, np.floor(off_m / DISTANCE_CLASS_M)))[0]]
    around = usable[np.linalg.norm(points_wcs_m[usable] - points_wcs_m[best], axis=1) <= 0.5 * size_m]
    away = np.mean(beam[around] / range_m[around, None], axis=0)
    away /= np.linalg.norm(away)
    # Straight up or down no direction is level: east stands in.
    level = np.array([away[1], -away[0], 0.0])
    right = level / np.linalg.norm(level) if np.linalg.norm(level) > 1e-6 else np.array([1.0, 0.0, 0.0])
    up = np.cross(right, away)
    centre = points_wcs_m[best]
    u, v = ((points_wcs_m - centre) @ np.stack([right, up], axis=1)).T
    with np.errstate(invalid="ignore"):
        # Twice the size in depth: what lies farther behind is another surface.
        depth = np.abs((points_wcs_m - centre) @ away) <= 2.0 * size_m
        inside = (np.abs(u) <= 0.5 * size_m) & (np.abs(v) <= 0.5 * size_m) & depth & (range_m > 1e-3)
    return Patch(
        centre_wcs_m=centre,
        right=right,
        up=up,
        away=away,
        inside=inside,
        range_m=float(np.median(range_m[inside])),
    )


def footprint_ellipses(
    beam_wcs_m: ArrayF, patch: Patch, *, divergence_mrad: float
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Widths, heights (n,) in metres and angles (n,) in degrees of footprints in the plane of a patch.

    A footprint is a circle of diameter ``divergence * range`` across its own beam. Seen along the mean beam
    it is an ellipse whose short axis lies along the projection of its own beam.

    Parameters
    ----------
    beam_wcs_m : (n, 3) from the scanner to the points.
    patch : the plane of projection.
    divergence_mrad : full divergence of the beam.
    """
    range_m = np.linalg.norm(beam_wcs_m, axis=1)
    direction = beam_wcs_m / range_m[:, None]
    diameter = 1e-3 * divergence_mrad * range_m
    short = diameter * np.abs(direction @ patch.away)
    angle = np.arctan2(direction @ patch.up, direction @ patch.right)
    return short, diameter, np.rad2deg(angle)


@styled
def footprints(
    points_wcs_m: ArrayF,
    scanner_wcs_m: ArrayF,
    *,
    divergence_mrad: float,
    distance_m: float = DISTANCE_M,
    title: str = "Footprints of the mobile lidar",
) -> Figure:
    """One revolution of the lidar in plan view, and a patch of the bank with the footprints to scale.

    Parameters
    ----------
    points_wcs_m : (n, 3) points of one revolution.
    scanner_wcs_m : (n, 3) position of the scanner at each point's time; rows with NaN are left out.
    divergence_mrad : full divergence of the beam.
    distance_m : wanted distance of the patch; the nearest there is will do.
    title : first words of the title.

    Raises
    ------
    GeometryError : no point, or no beam.
    """
    points, scanner = points_wcs_m, scanner_wcs_m
    patch = choose_patch(points, scanner, distance_m=distance_m)
    posed = np.isfinite(points).all(axis=1) & np.isfinite(scanner).all(axis=1)
    points, scanner = points[posed], scanner[posed]
    inside = patch.inside[posed]
    head = f"{title}, one revolution ({REVOLUTION_S:g} s), n = {count(len(points))} points"
    figure = new_figure(100.0, head)
    left, right = figure.subplots(1, 2, width_ratios=[1.0, 1.0])
    _draw_frame(left, points, scanner, patch)
    _draw_patch(right, points[inside], scanner[inside], patch, divergence_mrad)
    legend_below(figure, left)
    return figure


def _draw_frame(ax: Axes, points: ArrayF, scanner: ArrayF, patch: Patch) -> None:
    range_m = np.linalg.norm(points - scanner, axis=1)
    bulk = np.percentile(points[:, :2], [4, 96], axis=0)
    low, high = map_extent(np.concatenate([scanner[:, :2], patch.centre_wcs_m[None, :2], bulk]), None)
    # The panel is a square.
    middle, half = 0.5 * (low + high), 0.5 * float(np.max(high - low))
    show_plan(ax, middle - half, middle + half)
    order = np.argsort(-range_m)
    norm = Normalize(*robust_limits(range_m, 1.0, 99.0))
    ax.scatter(
        points[order, 0],
        points[order, 1],
        s=1.6,
        c=range_m[order],
        cmap=RANGE_MAP,
        norm=norm,
        lw=0,
        rasterized=True,
    )
    place = scanner.mean(axis=0)
    ax.plot(*place[:2], "^", ms=6, mfc="white", mec="black", zorder=6, label="lidar")
    words = f"line of sight of b, {patch.range_m:.1f} m"
    sight = np.stack([place[:2], patch.centre_wcs_m[:2]])
    ax.plot(*sight.T, color=VERMILION, lw=0.8, ls="--", zorder=5, label=words, path_effects=HALO)
    ax.add_patch(
        Polygon(
            _outline(patch), fill=False, ec=ORANGE, lw=1.8, zorder=6, label="area of b", path_effects=HALO
        )
    )
    outside = int(np.sum(np.any(np.abs(points[:, :2] - middle) > half, axis=1)))
    ax.set_title(f"a: scan pattern in plan view, n = {count(len(points))}\n{count(outside)} beyond the map")
    marks_in_free_corners(ax, np.concatenate([points[:, :2], sight]))
    colour_bar(ax, RANGE_MAP, norm, "measured range / m", **_BAR)


def _outline(patch: Patch) -> ArrayF:
    """Corners of the patch in plan, drawn a metre deep where it is seen edge-on."""
    along, deep = 0.5 * PATCH_M * patch.right[:2], 0.5 * PATCH_M * patch.up[:2]
    if np.hypot(*deep) < 0.5:
        deep = 0.5 * np.array([-patch.right[1], patch.right[0]])
    centre = patch.centre_wcs_m[:2]
    return np.stack(
        [centre - along - deep, centre + along - deep, centre + along + deep, centre - along + deep]
    )


def _draw_patch(ax: Axes, points: ArrayF, scanner: ArrayF, patch: Patch, divergence_mrad: float) -> None:
    beam = points - scanner
    range_m = np.linalg.norm(beam, axis=1)
    place = patch.project(points)
    widths, heights, angles = footprint_ellipses(beam, patch, divergence_mrad=divergence_mrad)
    norm = Normalize(*robust_limits(range_m, 1.0, 99.0))
    # Far ones first: nearer surfaces lie in front.
    order = np.argsort(-range_m)
    widths, heights, angles, place = widths[order], heights[order], angles[order], place[order]
    faces = RANGE_MAP(norm(range_m[order]), alpha=0.6)
    half = 0.5 * PATCH_M + 0.08
    ax.set_xlim(-half, half)
    ax.set_ylim(-half, half)
    ax.set_aspect("equal")
    ax.set_xlabel("to the right, across the beams / m")
    ax.set_ylabel("up, across the beams / m")
    ax.add_collection(
        EllipseCollection(
            widths,
            heights,
            angles,
            units="xy",
            offsets=place,
            offset_transform=ax.transData,
            facecolors=faces,
            edgecolors="0.15",
            linewidths=0.5,
            zorder=3,
        ),
        autolim=False,
    )
    one = int(np.argmin(np.linalg.norm(place, axis=1)))
    size_m, spot_m = float(heights[one]), float(heights[one]) * TLS_DIVERGENCE_MRAD / divergence_mrad
    ax.set_title(
        f"b: footprints seen along the beams, n = {count(len(points))}\n"
        f"{divergence_mrad:g} mrad · {range_m[order][one]:.1f} m = {100 * size_m:.1f} cm"
        f"; TLS spot {100 * spot_m:.1f} cm"
    )
    for diameter_m, look in ((size_m, {"fill": False, "ec": RED, "lw": 1.4}), (spot_m, {"fc": RED})):
        ax.add_patch(Circle(place[one], 0.5 * diameter_m, **look, zorder=6))
    colour_bar(ax, RANGE_MAP, norm, "measured range / m", **_BAR)


def draw_footprints(
    *, points: Path, trajectory: Path, mounts: Path, divergence_mrad: float, title: str
) -> Figure:
    """Cloud and trajectory -> one revolution of the lidar and its footprints on the bank."""
    sample, track = sample_cloud(points, 2_000_000), Trajectory.read(trajectory)
    lever_m = read_mounts(mounts)["lidar"]["lever_ics_m"]
    start = best_moment(sample["t_gps_s"], sample["range"])
    xyz_m, t_gps_s = [], []
    for chunk in iter_laz(points, 1_000_000):
        turn = (chunk["t_gps_s"] >= start) & (chunk["t_gps_s"] < start + REVOLUTION_S)
        xyz_m.append(chunk["xyz_m"][turn])
        t_gps_s.append(chunk["t_gps_s"][turn])
    scanner_m, has_pose = scanner_positions(np.concatenate(t_gps_s), track, lever_m)
    return footprints(
        np.concatenate(xyz_m)[has_pose],
        scanner_m[has_pose],
        divergence_mrad=divergence_mrad,
        title=f"Footprints of the mobile lidar: {title}",
    )
