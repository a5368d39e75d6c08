"""Calibration of camera and lidar in four pictures: reference, image, lidar points, residuals (P1 Fig. 2)."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from thalweg.core.errors import InputError
from thalweg.core.types import ArrayF, ArrayU8
from thalweg.figures.calibration.field_views import (
    RESIDUAL_MAP,
    FieldCone,
    Oblique,
    cone_look,
    cones_of,
    draw_outlines,
    fit_axes,
    name_cones,
)
from thalweg.figures.calibration.tables import (
    CONE_POINTS,
    CONES,
    FIELD_POINTS,
    IMAGE_MARKS,
    checked,
    filled,
    points_of,
)
from thalweg.figures.style import (
    ORANGE,
    SIGMA_MAP,
    SKY,
    count,
    new_figure,
    plural,
    robust_limits,
    round_length,
    scale_bar,
    styled,
)

VIEW: Final = Oblique(azimuth_deg=28.0, elevation_deg=24.0)
POINTS_SHOWN: Final = 12_000
COLUMNS: Final = 3
VECTOR_SHARE: Final = 0.035
"""Length of a large residual vector, as a share of the picture's width."""


@styled
def field_reference(
    field_points: pd.DataFrame,
    cones: pd.DataFrame,
    image: ArrayU8,
    marks: pd.DataFrame,
    cone_points: pd.DataFrame,
    *,
    image_name: str = "",
    title: str = "Calibration of camera and lidar",
    twin: bool = False,
) -> Figure:
    """Reference points, markers in an image with residuals, lidar points by cone, residuals of the fit.

    Parameters
    ----------
    field_points, cones, marks, cone_points : see `thalweg.figures.calibration.tables`; marks of one image,
        and cone points of the lidar at one position or several.
    image : (h, w) or (h, w, 3) uint8, the picture with the marks.
    image_name : shown above it.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : a column is missing, or the picture is none.
    CoverageError : a table is empty.
    """
    points = filled(checked(field_points, FIELD_POINTS), "reference point")
    bodies = cones_of(filled(checked(cones, CONES), "cone"))
    lidar = filled(checked(cone_points, CONE_POINTS), "lidar point on a cone")
    marks = filled(checked(marks, IMAGE_MARKS), "mark in an image")
    if image.dtype != np.uint8 or image.ndim not in (2, 3):
        raise InputError(
            f"image of shape {image.shape} and type {image.dtype}", expected="(h, w[, 3]) of uint8"
        )
    used = lidar[lidar["used"].astype(bool)]
    head = f"{title}, n = {plural(len(points), 'reference point')}, {plural(len(used), 'lidar point')}"
    figure = new_figure(128.0, head, twin=twin)
    axes = figure.subplots(2, 2, height_ratios=[1.0, 1.0])
    _reference(figure, axes[0, 0], points, bodies)
    _image(axes[0, 1], image, marks, image_name)
    _lidar(axes[1, 0], used, bodies)
    _residuals(figure, axes[1, 1], used, bodies)
    return figure


def _reference(figure: Figure, ax: Axes, points: pd.DataFrame, bodies: dict[str, FieldCone]) -> None:
    xy, depth = VIEW.apply(points_of(points))
    sigma_mm = 1e3 * np.sqrt((points[["sigma_x_m", "sigma_y_m", "sigma_z_m"]] ** 2).sum(axis=1)).to_numpy()
    limits = robust_limits(sigma_mm, 0.0, 99.0)
    order = np.argsort(depth)
    draw_outlines(ax, list(bodies.values()), VIEW)
    ax.scatter(xy[order, 0], xy[order, 1], s=5, c=sigma_mm[order], cmap=SIGMA_MAP, norm=Normalize(*limits),
               lw=0, zorder=4, gid="reference")  # fmt: skip
    name_cones(ax, list(bodies.values()), VIEW)
    _frame(ax, np.concatenate([xy, _outline(bodies)]))
    ax.set_title(f"a: reference points, median 3D sigma {np.median(sigma_mm):.2f} mm")
    figure.colorbar(
        ScalarMappable(Normalize(*limits), SIGMA_MAP), ax=ax, label="3D sigma / mm", shrink=0.7, pad=0.02
    )


def _image(ax: Axes, image: ArrayU8, marks: pd.DataFrame, name: str) -> None:
    h, w = image.shape[:2]
    used = marks["used"].to_numpy(bool)
    xy = marks[["x_px", "y_px"]].to_numpy(np.float64)
    vector = marks[["residual_x_px", "residual_y_px"]].to_numpy(np.float64)
    length = np.hypot(*vector.T)
    rms = float(np.sqrt(np.mean(vector[used] ** 2))) if used.any() else float("nan")
    large = float(np.percentile(length[used], 95)) if used.any() else 1.0
    scale = round_length(VECTOR_SHARE * w / max(large, 1e-6))
    # pixel coordinates count from the corner: the picture fills 0..w, 0..h
    ax.imshow(image, cmap="gray", extent=(0, w, h, 0), interpolation="antialiased", alpha=0.75)
    ax.plot(xy[used, 0], xy[used, 1], ls="none", marker=".", ms=2.0, color=SKY, gid="marks")
    if not used.all():
        ax.plot(xy[~used, 0], xy[~used, 1], ls="none", marker="x", ms=4, color=ORANGE, gid="rejected",
                label=f"{plural(int((~used).sum()), 'mark')} rejected")  # fmt: skip
        ax.legend(loc="lower right")
    ends = xy + scale * vector
    ax.quiver(
        xy[used, 0], xy[used, 1], *(ends - xy)[used].T, angles="xy", scale_units="xy", scale=1.0,
        color=ORANGE, width=0.003, headwidth=3.5, headlength=4, gid="residuals", zorder=5,
    )  # fmt: skip
    ax.set_xlim(0, w)
    ax.set_ylim(h, 0)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.set_title(f"b: {plural(len(marks), 'mark')} in {name or 'an image'}, RMS {rms:.3f} px,\n"
                 f"residuals enlarged {count(int(scale)) if scale >= 1 else f'{scale:g}'} times")  # fmt: skip


def _lidar(ax: Axes, points: pd.DataFrame, bodies: dict[str, FieldCone]) -> None:
    shown = _thinned(points)
    looks = cone_look(list(bodies))
    reach = []
    for name, cone, view, at in _contact_sheet(shown, bodies):
        xy = view.apply(points_of(shown[shown["cone"].astype(str) == name]) - cone.apex_m)[0] + at
        colour, _ = looks[name]
        ax.plot(xy[:, 0], xy[:, 1], ls="none", marker=".", ms=1.8, mew=0, color=colour, gid=f"cone-{name}",
                rasterized=True, zorder=4)  # fmt: skip
        reach.append(_outline_of(ax, cone, view, at))
    _frame(ax, np.concatenate(reach))
    part = f", {count(len(shown))} of {count(len(points))} shown" if len(shown) < len(points) else ""
    ax.set_title(f"c: lidar points on {plural(points['cone'].nunique(), 'cone')}{part}")


def _residuals(figure: Figure, ax: Axes, points: pd.DataFrame, bodies: dict[str, FieldCone]) -> None:
    residual_mm = 1e3 * points["residual_m"].to_numpy(np.float64)
    limit = max(abs(x) for x in robust_limits(residual_mm, 2.0, 98.0))
    norm = Normalize(-limit, limit)
    shown = _thinned(points)
    reach = []
    for name, cone, view, at in _contact_sheet(shown, bodies):
        part = shown[shown["cone"].astype(str) == name]
        xy = view.apply(points_of(part) - cone.apex_m)[0] + at
        # not sorted by depth: points outside the cone are nearer and would hide those inside
        ax.scatter(
            xy[:, 0], xy[:, 1], s=2.2, c=1e3 * part["residual_m"].to_numpy(), cmap=RESIDUAL_MAP, norm=norm,
            lw=0, zorder=4, gid="fit", rasterized=True,
        )  # fmt: skip
        reach.append(_outline_of(ax, cone, view, at))
    _frame(ax, np.concatenate(reach))
    ax.set_title(f"d: residuals, mean {residual_mm.mean():+.1f} mm, std {residual_mm.std():.1f} mm")
    figure.colorbar(
        ScalarMappable(norm, RESIDUAL_MAP), ax=ax, label="outside +, inside − / mm", shrink=0.7, pad=0.02,
        extend="both",
    )  # fmt: skip


def _contact_sheet(
    points: pd.DataFrame, bodies: dict[str, FieldCone]
) -> Iterator[tuple[str, FieldCone, Oblique, ArrayF]]:
    """Each cone with points, the view from the side on which these are, and its place in the picture."""
    names = [name for name in bodies if (points["cone"].astype(str) == name).any()]
    columns = min(len(names), COLUMNS)
    size = 1.25 * max(2 * cone.length_m for cone in bodies.values()) / 1.6
    for k, name in enumerate(names):
        cone = bodies[name]
        xyz = points_of(points[points["cone"].astype(str) == name]) - cone.apex_m
        side = (xyz - np.outer(xyz @ cone.axis, cone.axis)).mean(axis=0)
        view = Oblique(azimuth_deg=float(np.rad2deg(np.arctan2(-side[0], -side[1]))), elevation_deg=15.0)
        middle = view.apply(0.5 * cone.length_m * cone.axis)[0]
        yield name, cone, view, size * np.array([k % columns, -(k // columns)]) - middle


def _outline_of(ax: Axes, cone: FieldCone, view: Oblique, at: ArrayF) -> ArrayF:
    """Draw a cone of the contact sheet with its name; returns what it covers."""
    moved = replace(cone, apex_m=at @ view.axes[:2])
    draw_outlines(ax, [moved], view)
    name_cones(ax, [moved], view, dy_points=7.0)
    return view.apply(moved.surface(along=1).reshape(-1, 3))[0]


def _frame(ax: Axes, xy: ArrayF) -> None:
    width = fit_axes(ax, xy, margin=0.05)
    low, high = ax.get_ylim()
    ax.set_ylim(low - 0.12 * (high - low), high + 0.10 * (high - low))  # room for the bar and the names
    ax.axis("off")
    scale_bar(ax, span_m=width, xy=(0.02, 0.02))


def _outline(bodies: dict[str, FieldCone]) -> ArrayF:
    return np.concatenate([VIEW.apply(cone.surface(along=1).reshape(-1, 3))[0] for cone in bodies.values()])


def _thinned(points: pd.DataFrame) -> pd.DataFrame:
    """An even sample of at most `POINTS_SHOWN` rows."""
    step = -(-len(points) // POINTS_SHOWN)
    return points.iloc[:: max(step, 1)]
