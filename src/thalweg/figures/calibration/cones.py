"""Cones of a calibration field: their frame, and their points before and after the lidar's calibration."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from thalweg.core import ArrayF, CoverageError, root_mean_square
from thalweg.figures import (
    BLUE,
    GREEN,
    HALO,
    ORANGE,
    TIME_MAP,
    VERMILION,
    count,
    new_figure,
    plural,
    scale_bar,
    styled,
)
from thalweg.figures.calibration.field import AROUND, FieldCone, Oblique, cones_of, draw_outlines, facing
from thalweg.figures.calibration.tables import points_of, read_cones, read_figure_table

HALF_ANGLE_DEG: Final = 25.0
LENGTH_M: Final = 1.6
_OFF_M: Final = 0.16
"""How far the drawn point lies off the surface, to show what a residual is."""

POINTS_SHOWN_OF_CONE: Final = 6000
REACH: Final = 1.9
"""Half width of the view along the axis, in radii of the cone."""
_DOTS: Final[dict[str, Any]] = {"cmap": TIME_MAP, "s": 2.0, "lw": 0, "rasterized": True}
FROM_APEX: Final = 0.25
"""Points nearer to the apex than this share of the length say little about the radius."""


# ---------------------------------------------------------------- cone coordinate system (P2 Fig. 3)


@styled
def draw_cone_frame() -> Figure:
    """Sketch of a cone's coordinate system, in the plane of its axis and a point."""
    figure = new_figure(84.0, "A cone and its coordinate system (no data)", twin=False)
    ax, alpha, length = figure.subplots(), np.deg2rad(HALF_ANGLE_DEG), LENGTH_M
    edge = length * np.tan(alpha)
    ax.fill([0, length, length], [0, edge, -edge], facecolor="0.93", edgecolor="none", zorder=1)
    ax.plot([length, 0, length], [edge, 0, -edge], color="0.35", lw=1.2, zorder=2)
    _arrow(ax, np.array([0.0, 0.0]), np.array([1.95, 0.0]), "$z_{cocs}$", colour=BLUE, away=0.14)
    _arrow(ax, np.array([0.0, 0.0]), np.array([0.0, 0.95]), "$\\rho=\\sqrt{x^2+y^2}$", colour=BLUE, away=0.09)
    arc = np.linspace(0, alpha, AROUND)
    ax.plot(0.62 * np.cos(arc), 0.62 * np.sin(arc), color=GREEN, lw=1.3)
    _words(ax, 0.44 * np.array([np.cos(alpha / 2), np.sin(alpha / 2)]), "$\\alpha$", colour=GREEN)
    foot = 1.15 * np.array([np.cos(alpha), np.sin(alpha)])
    point = foot + _OFF_M * np.array([-np.sin(alpha), np.cos(alpha)]) * 1.4
    ax.plot(*np.stack([foot, point]).T, color=VERMILION, lw=1.6, zorder=4)
    ax.plot(*point, marker="o", ms=5, color=VERMILION, zorder=5)
    _words(ax, point + np.array([0.02, 0.10]), "$p_j$", colour=VERMILION)
    _words(ax, 0.5 * (foot + point) + np.array([0.15, 0.03]), "$s_j$", colour=VERMILION)
    way = np.array([-np.sin(alpha), np.cos(alpha)])
    low, high = -0.10 * way, foot - 0.10 * way
    look = {"arrowstyle": "<->", "color": ORANGE, "lw": 1.1, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", tuple(high), xytext=tuple(low), zorder=4, arrowprops=look)
    _words(ax, 0.80 * high - 0.20 * way, "$l_j$", colour=ORANGE)
    ax.plot(0, 0, marker="o", ms=4, color="black", zorder=6)
    _words(ax, np.array([-0.09, -0.09]), "$a$")
    ax.set_title("in the plane of axis and point: $s_j=\\rho\\cos\\alpha-z\\sin\\alpha$, zero on the surface")
    ax.set_aspect("equal", adjustable="box")
    ax.set(xlim=(-0.25, 2.35), ylim=(-0.95, 1.3))
    ax.axis("off")
    return figure


def _arrow(ax: Axes, start: ArrayF, end: ArrayF, words: str, *, colour: str, away: float = 0.09) -> None:
    look = {"arrowstyle": "-|>", "color": colour, "lw": 1.3, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", tuple(end), xytext=tuple(start), zorder=5, arrowprops=look)
    way = end - start
    place = end + away * way / np.linalg.norm(way)
    _words(ax, place, words, colour=colour)


def _words(ax: Axes, place: ArrayF, words: str, *, colour: str = "black", size: float = 9.0) -> None:
    ax.text(
        float(place[0]),
        float(place[1]),
        words,
        color=colour,
        fontsize=size,
        ha="center",
        va="center",
        path_effects=HALO,
        zorder=7,
    )


# ---------------------------------------------------------------- from the moving boat (T Fig. 3.1)


@styled
def cone_before_after(
    before: pd.DataFrame,
    after: pd.DataFrame,
    cones: pd.DataFrame,
    *,
    cone: str = "",
    title: str = "Lidar points of a cone",
    twin: bool = False,
) -> Figure:
    """One cone: from the side, and along its axis with each point divided by the radius where it lies.

    Parameters
    ----------
    before, after : points with the approximate and the calibrated orientation; see
        `thalweg.figures.calibration.tables`, and a column ``t_gps_s``.
    cones : see there.
    cone : which one; by default that with most points after.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    CoverageError : the cone has no points.
    """
    tables = [table[table["used"].astype(bool)] for table in (before, after)]
    bodies = cones_of(cones)
    name = cone or str(tables[1]["cone"].astype(str).value_counts().index[0])
    parts = [table[table["cone"].astype(str) == name] for table in tables]
    if name not in bodies or not all(len(part) for part in parts):
        raise CoverageError(
            f"no points of cone {name} before or after", expected=f"one of {', '.join(bodies)}"
        )
    t0 = float(parts[1]["t_gps_s"].min())
    span = max(float(parts[1]["t_gps_s"].max()) - t0, 1e-3)
    step = max(-(-max(len(part) for part in parts) // POINTS_SHOWN_OF_CONE), 1)
    few = "" if step == 1 else f", 1 of {step} shown"
    figure = new_figure(138.0, f"{title}: {name}, n = {plural(len(parts[1]), 'point')}{few}", twin=twin)
    axes = figure.subplots(2, 2, height_ratios=[1.0, 1.15])
    view = facing(bodies[name], points_of(parts[1]) - bodies[name].apex_m, elevation_deg=12.0)
    limits = _limits(bodies[name], view, [points_of(part) for part in parts])
    for k, (part, words) in enumerate(
        zip(parts, ("a: approximate mount", "b: calibrated mount"), strict=True)
    ):
        # not those of the table: it has none for points beyond the ends of the cone
        mm = 1e3 * bodies[name].distance(points_of(part))
        shown = part.iloc[::step]
        elapsed = shown["t_gps_s"].to_numpy(np.float64) - t0
        _side(axes[0, k], bodies[name], view, points_of(shown), elapsed, span, limits)
        axes[0, k].set_title(
            f"{words}\noff the cone: mean {mm.mean():+.1f} mm, RMS {root_mean_square(mm):.1f} mm"
        )
        _along_axis(axes[1, k], bodies[name], points_of(shown), elapsed, span)
    figure.colorbar(
        ScalarMappable(Normalize(0, span), TIME_MAP),
        ax=list(axes.ravel()),
        label="time of the run / s",
        shrink=0.6,
        pad=0.01,
        aspect=30,
    )
    return figure


def _limits(cone: FieldCone, view: Oblique, clouds: list[ArrayF]) -> ArrayF:
    """(2, 2) lower and upper corner that hold the cone and nearly all points of both clouds."""
    xy = np.concatenate([view.apply(cloud)[0] for cloud in clouds])
    body = view.apply(cone.surface(along=1).reshape(-1, 3))[0]
    low = np.minimum(np.percentile(xy, 0.5, axis=0), body.min(axis=0))
    high = np.maximum(np.percentile(xy, 99.5, axis=0), body.max(axis=0))
    pad = 0.06 * float((high - low).max())
    return np.stack([low - pad - [0.0, 2.0 * pad], high + pad])  # the scale bar stands below


def _side(
    ax: Axes, cone: FieldCone, view: Oblique, points: ArrayF, elapsed: ArrayF, span: float, limits: ArrayF
) -> None:
    xy, _ = view.apply(points)
    draw_outlines(ax, [cone], view, colour="black", lw=0.9)
    ax.scatter(xy[:, 0], xy[:, 1], c=elapsed, norm=Normalize(0, span), **_DOTS, zorder=1, gid="side")
    ax.set_aspect("equal")
    ax.set_xlim(*limits[:, 0])
    ax.set_ylim(*limits[:, 1])
    ax.axis("off")
    scale_bar(ax, span_m=float(np.ptp(limits[:, 0])), xy=(0.02, 0.02))


def _along_axis(ax: Axes, cone: FieldCone, points: ArrayF, elapsed: ArrayF, span: float) -> None:
    local = (points - cone.apex_m) @ cone.frame.T
    far = local[:, 2] > FROM_APEX * cone.length_m
    radius = local[far, 2] * np.tan(cone.half_angle_rad)
    xy = local[far, :2] / radius[:, None]
    turn = np.linspace(0, 2 * np.pi, 181)
    ax.fill(np.cos(turn), np.sin(turn), facecolor="none", edgecolor="black", lw=0.9, zorder=3)
    ax.scatter(xy[:, 0], xy[:, 1], c=elapsed[far], norm=Normalize(0, span), **_DOTS, zorder=2, gid="along")
    ax.set_aspect("equal")
    ax.set(
        xlim=(-REACH, REACH),
        ylim=(-REACH, REACH),
        xlabel="x / (z tan \N{GREEK SMALL LETTER ALPHA}) in cocs",
        ylabel="y / (z tan \N{GREEK SMALL LETTER ALPHA}) in cocs",
    )
    beyond = int(np.sum(np.abs(xy).max(axis=1) > REACH)) if len(xy) else 0
    outside = f";\n{count(beyond)} of {count(len(xy))} beyond the view" if beyond else ""
    ax.set_title(f"along the axis, in radii of the cone{outside}", fontsize=7)
    ax.grid()


def draw_cone_before_after(*, before: Path, after: Path, cones: Path, field: Path, twin: bool) -> Figure:
    """Lidar points of the cones before and after the calibration -> figure of one cone."""
    return cone_before_after(
        read_figure_table(before),
        read_figure_table(after),
        read_cones(cones, field),
        title="Lidar points of a cone from the moving boat",
        twin=twin,
    )
