"""Points of the cones with approximate and with calibrated orientation of the lidar (T Fig. 3.1)."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from thalweg.core.errors import CoverageError
from thalweg.core.types import ArrayF
from thalweg.figures.calibration.field_views import FieldCone, Oblique, cones_of, draw_outlines
from thalweg.figures.calibration.tables import CONE_POINTS, CONES, checked, filled, points_of
from thalweg.figures.style import TIME_MAP, count, new_figure, plural, scale_bar, styled

POINTS_SHOWN: Final = 6000
REACH: Final = 1.9
"""Half width of the view along the axis, in radii of the cone."""

FROM_APEX: Final = 0.25
"""Points nearer to the apex than this share of the length say little about the radius."""


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
    InputError : a column is missing.
    CoverageError : the cone has no points.
    """
    columns = (*CONE_POINTS, "t_gps_s")
    tables = [checked(table, columns) for table in (before, after)]
    tables = [table[table["used"].astype(bool)] for table in tables]
    used = filled(tables[1], "point used")
    bodies = cones_of(checked(cones, CONES))
    name = cone or str(used["cone"].astype(str).value_counts().index[0])
    parts = [table[table["cone"].astype(str) == name] for table in tables]
    if name not in bodies or not all(len(part) for part in parts):
        raise CoverageError(
            f"no points of cone {name} before or after", expected=f"one of {', '.join(bodies)}"
        )
    t0 = float(parts[1]["t_gps_s"].min())
    span = max(float(parts[1]["t_gps_s"].max()) - t0, 1e-3)
    step = max(-(-max(len(part) for part in parts) // POINTS_SHOWN), 1)
    few = "" if step == 1 else f", 1 of {step} shown"
    figure = new_figure(138.0, f"{title}: {name}, n = {plural(len(parts[1]), 'point')}{few}", twin=twin)
    axes = figure.subplots(2, 2, height_ratios=[1.0, 1.15])
    view = _view(bodies[name], points_of(parts[1]))
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
            f"{words}\noff the cone: mean {mm.mean():+.1f} mm, RMS {np.sqrt(np.mean(mm**2)):.1f} mm"
        )
        _along_axis(axes[1, k], bodies[name], points_of(shown), elapsed, span)
    figure.colorbar(
        ScalarMappable(Normalize(0, span), TIME_MAP), ax=list(axes.ravel()), label="time of the run / s",
        shrink=0.6, pad=0.01, aspect=30,
    )  # fmt: skip
    return figure


def _view(cone: FieldCone, points: ArrayF) -> Oblique:
    """From the side on which the points are, a little from above."""
    xyz = points - cone.apex_m
    side = (xyz - np.outer(xyz @ cone.axis, cone.axis)).mean(axis=0)
    return Oblique(azimuth_deg=float(np.rad2deg(np.arctan2(-side[0], -side[1]))), elevation_deg=12.0)


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
    ax.scatter(xy[:, 0], xy[:, 1], c=elapsed, cmap=TIME_MAP, norm=Normalize(0, span), s=2.0, lw=0,
               rasterized=True, zorder=1, gid="side")  # fmt: skip
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
    ax.scatter(xy[:, 0], xy[:, 1], c=elapsed[far], cmap=TIME_MAP, norm=Normalize(0, span), s=2.0, lw=0,
               rasterized=True, zorder=2, gid="along")  # fmt: skip
    ax.set_aspect("equal")
    ax.set(xlim=(-REACH, REACH), ylim=(-REACH, REACH), xlabel="$x_{cocs}/(z\\,\\tan\\alpha)$ / 1",
           ylabel="$y_{cocs}/(z\\,\\tan\\alpha)$ / 1")  # fmt: skip
    beyond = int(np.sum(np.abs(xy).max(axis=1) > REACH)) if len(xy) else 0
    outside = f";\n{count(beyond)} of {count(len(xy))} beyond the view" if beyond else ""
    ax.set_title(f"along the axis, in radii of the cone{outside}", fontsize=7)
    ax.grid()
