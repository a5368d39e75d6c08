"""Cones of a calibration field: their frame, and their points before and after the lidar's calibration."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from thalweg.core import ArrayF, CoverageError, root_mean_square
from thalweg.figures import TIME_MAP, colour_bar, count, new_figure, plural, scale_bar, styled
from thalweg.figures.calibration.field import FieldCone, Oblique, cones_of, draw_outlines, facing
from thalweg.figures.calibration.tables import points_of, read_cones, read_figure_table

POINTS_SHOWN_OF_CONE: Final = 6000
REACH: Final = 1.9
"""Half width of the view along the axis, in radii of the cone."""
_DOTS: Final[dict[str, Any]] = {"cmap": TIME_MAP, "s": 2.0, "lw": 0, "rasterized": True}
FROM_APEX: Final = 0.25
"""Points nearer to the apex than this share of the length say little about the radius."""


# ---------------------------------------------------------------- from the moving boat (T Fig. 3.1)


@styled
def cone_before_after(
    before: pd.DataFrame,
    after: pd.DataFrame,
    cones: pd.DataFrame,
    *,
    cone: str = "",
    title: str = "Lidar points of a cone",
) -> Figure:
    """One cone: from the side, and along its axis with each point divided by the radius where it lies.

    Parameters
    ----------
    before, after : points with the approximate and the calibrated orientation; see
        `thalweg.figures.calibration.tables`, and a column ``t_gps_s``.
    cones : see there.
    cone : which one; by default that with most points after.
    title : first words of the title.

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
    figure = new_figure(138.0, f"{title}: {name}, n = {plural(len(parts[1]), 'point')}{few}")
    axes = figure.subplots(2, 2, height_ratios=[1.0, 1.15])
    view = facing(bodies[name], points_of(parts[1]) - bodies[name].apex_m, elevation_deg=12.0)
    limits = _limits(bodies[name], view, [points_of(part) for part in parts])
    for k, (part, words) in enumerate(
        zip(parts, ("a: approximate mount", "b: calibrated mount"), strict=True)
    ):
        # not those of the table: it has none for points beyond the ends of the cone
        mm = 1e3 * bodies[name].distance(points_of(part))
        shown = part.iloc[::step]
        elapsed = shown["t_gps_s"].to_numpy() - t0
        _side(axes[0, k], bodies[name], view, points_of(shown), elapsed, span, limits)
        axes[0, k].set_title(
            f"{words}\noff the cone: mean {mm.mean():+.1f} mm, RMS {root_mean_square(mm):.1f} mm"
        )
        _along_axis(axes[1, k], bodies[name], points_of(shown), elapsed, span)
    colour_bar(axes, TIME_MAP, (0, span), "time of the run / s", shrink=0.6, pad=0.01, aspect=30)
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
    ax.scatter(xy[:, 0], xy[:, 1], c=elapsed, norm=Normalize(0, span), **_DOTS, zorder=1)
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
    ax.scatter(xy[:, 0], xy[:, 1], c=elapsed[far], norm=Normalize(0, span), **_DOTS, zorder=2)
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


def draw_cone_before_after(*, before: Path, after: Path, cones: Path, field: Path) -> Figure:
    """Lidar points of the cones before and after the calibration -> figure of one cone."""
    return cone_before_after(
        read_figure_table(before),
        read_figure_table(after),
        read_cones(cones, field),
        title="Lidar points of a cone from the moving boat",
    )
