"""The calibration field: set-up, positions in it, reference points, markers in an image, cones."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from cmcrameri import cm
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from thalweg.calibration.field import read_field
from thalweg.core import ArrayF, ArrayU8, root_mean_square
from thalweg.figures import (
    BLUE,
    GREEN,
    GREY,
    HALO,
    HEIGHT_MAP,
    ORANGE,
    PURPLE,
    RED,
    SIGMA_MAP,
    SKY,
    VERMILION,
    colour_bar,
    count,
    leave_out,
    legend_below,
    new_figure,
    north_arrow,
    plural,
    read_picture,
    robust_limits,
    round_length,
    scale_bar,
    styled,
    thinned,
)
from thalweg.figures.calibration.tables import (
    XYZ,
    first_picture,
    natural,
    placed,
    points_of,
    read_cones,
    read_figure_table,
    read_image_marks,
    read_place,
)

AROUND: Final = 48
ALONG: Final = 12
"""Facets of a cone."""
CONE_COLOURS: Final = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, "black", "0.55")
RESIDUAL_MAP: Final[Colormap] = cm.vik
"""Blue inside a cone, brown outside; white is no residual."""
_LIGHT: Final = np.array([0.35, -0.45, 0.82])

POSITION_COLOURS: Final = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
SENSORS: Final = {"camera": (RED, "o", "camera"), "lidar": ("0.35", "s", "scanner")}
"""Colour, marker and word of each sensor."""
GRID_M: Final = 2.0
LONG: Final = 2.0
"""A field this many times longer than wide has its views one below the other."""
GROUND_STEP_M: Final = 0.5
"""The grid lies at the next such height below the lowest cone."""

POINTS_SHOWN: Final = 12_000
COLUMNS: Final = 3
VECTOR_SHARE: Final = 0.035
"""Length of a large residual vector, as a share of the picture's width."""


# ---------------------------------------------------------------- views of the field


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldCone:
    """A cone as it is drawn: apex, axis into the body, half angle, length along the axis."""

    name: str
    apex_m: ArrayF
    axis: ArrayF
    half_angle_rad: float
    length_m: float

    @property
    def frame(self) -> ArrayF:
        """(3, 3) rows x, y, z of the cone's frame: z the axis, y as upright as it can be, x to its right."""
        z = self.axis / np.linalg.norm(self.axis)
        up = np.array([0.0, 0.0, 1.0]) if abs(z[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
        y = up - (up @ z) * z
        y = y / np.linalg.norm(y)
        return np.stack([np.cross(y, z), y, z])

    def surface(self, around: int = AROUND, along: int = ALONG) -> ArrayF:
        """(along + 1, around + 1, 3) grid of points of the surface, from the apex to the base."""
        z = np.linspace(0.0, self.length_m, along + 1)[:, None]
        turn = np.linspace(0.0, 2 * np.pi, around + 1)[None, :]
        radius = z * np.tan(self.half_angle_rad)
        local = np.stack(
            [radius * np.cos(turn), radius * np.sin(turn), np.broadcast_to(z, (along + 1, around + 1))], -1
        )
        return np.asarray(self.apex_m + local @ self.frame)

    def distance(self, points_m: ArrayF) -> ArrayF:
        """Signed distances (n,) of points (n, 3) from the surface, which goes on without end; outside +."""
        local = (points_m - self.apex_m) @ self.frame.T
        c, s = np.cos(self.half_angle_rad), np.sin(self.half_angle_rad)
        return np.asarray(np.hypot(local[:, 0], local[:, 1]) * c - local[:, 2] * s)


def cones_of(table: pd.DataFrame) -> dict[str, FieldCone]:
    """Cones of a table (see `thalweg.figures.calibration.tables`) by name, in natural order."""
    rows = {str(row["name"]): row for _, row in table.iterrows()}
    return {
        name: FieldCone(
            name=name,
            apex_m=np.array([rows[name][f"apex_{a}_m"] for a in "xyz"], dtype=np.float64),
            axis=np.array([rows[name][f"axis_{a}"] for a in "xyz"], dtype=np.float64),
            half_angle_rad=float(np.deg2rad(rows[name]["half_angle_deg"])),
            length_m=float(rows[name]["length_m"]),
        )
        for name in natural(list(rows))
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class Oblique:
    """Oblique parallel projection: a view along ``azimuth`` (from north over east), down by ``elevation``."""

    azimuth_deg: float = 35.0
    elevation_deg: float = 24.0

    @property
    def axes(self) -> ArrayF:
        """(3, 3) rows: to the right, up in the picture, toward the viewer."""
        a, e = np.deg2rad([self.azimuth_deg, self.elevation_deg])
        view = np.array([np.sin(a) * np.cos(e), np.cos(a) * np.cos(e), -np.sin(e)])
        right = np.array([np.cos(a), -np.sin(a), 0.0])
        return np.stack([right, np.cross(right, view), -view])

    def apply(self, points_m: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Points (..., 2) of the picture in metres, and their distance (...) toward the viewer."""
        local = np.asarray(points_m) @ self.axes.T
        return local[..., :2], local[..., 2]


PLAN: Final = Oblique(azimuth_deg=0.0, elevation_deg=90.0)


def draw_cones(
    ax: Axes, cones: Sequence[FieldCone], view: Oblique, *, colours: Colormap, limits_m: tuple[float, float]
) -> None:
    """Draw cones as shaded bodies, coloured by height; nearer facets hide those behind.

    Parameters
    ----------
    cones : drawn together, so that one may stand before another.
    view : how it is seen.
    colours, limits_m : map of heights, metres.
    """
    corners, heights, shades, depths = [], [], [], []
    for cone in cones:
        grid = cone.surface()
        quads = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2).reshape(
            -1, 4, 3
        )
        normal = np.cross(quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        shine = 0.62 + 0.38 * np.abs(normal @ (_LIGHT / np.linalg.norm(_LIGHT)))
        xy, depth = view.apply(quads)
        corners.append(xy)
        heights.append(quads[:, :, 2].mean(axis=1))
        shades.append(shine)
        depths.append(depth.mean(axis=1))
    order = np.argsort(np.concatenate(depths))
    rgba = colours(Normalize(*limits_m)(np.concatenate(heights)))
    rgba[:, :3] *= np.concatenate(shades)[:, None]
    body = PolyCollection(
        list(np.concatenate(corners)[order]),
        facecolors=rgba[order],
        edgecolors=rgba[order],
        linewidths=0.2,
        zorder=3,
        rasterized=True,
    )
    ax.add_collection(body)


def draw_outlines(
    ax: Axes, cones: Sequence[FieldCone], view: Oblique, *, colour: str = GREY, lw: float = 0.7
) -> None:
    """Draw the outline of each cone: base circle and the two lines that bound it in this view."""
    for cone in cones:
        xy, _ = view.apply(cone.surface(along=1))
        apex, base = xy[0, 0], xy[1]
        ax.plot(base[:, 0], base[:, 1], color=colour, lw=lw, zorder=2)
        way = base - apex
        middle = way.mean(axis=0)
        if np.linalg.norm(middle) < 1e-9:
            continue
        turn = np.arctan2(middle[0] * way[:, 1] - middle[1] * way[:, 0], way @ middle)
        if np.ptp(turn) < np.pi:  # seen from the side: the apex is not inside the base
            for k in (int(np.argmin(turn)), int(np.argmax(turn))):
                ax.plot(*np.stack([apex, base[k]]).T, color=colour, lw=lw, zorder=2)


def name_cones(ax: Axes, cones: Sequence[FieldCone], view: Oblique, *, dy_points: float = 9.0) -> None:
    """Write the name of each cone above it."""
    for cone in cones:
        xy, _ = view.apply(cone.surface().reshape(-1, 3))
        top = xy[np.argmax(xy[:, 1])]
        ax.annotate(
            cone.name,
            (float(xy[:, 0].mean()), float(top[1])),
            xytext=(0, dy_points),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=7,
            path_effects=HALO,
            zorder=8,
        )


def fit_axes(ax: Axes, xy: ArrayF, *, margin: float = 0.06) -> float:
    """Set equal scales and limits around points (n, 2); returns the width in metres."""
    low, high = np.nanmin(xy, axis=0), np.nanmax(xy, axis=0)
    pad = margin * max(float((high - low).max()), 1e-3)
    ax.set_xlim(low[0] - pad, high[0] + pad)
    ax.set_ylim(low[1] - pad, high[1] + pad)
    ax.set_aspect("equal", adjustable="box")
    return float(high[0] - low[0] + 2 * pad)


# ---------------------------------------------------------------- set-up and positions (P2 Fig. 2 and 8)


VIEW: Final = Oblique(azimuth_deg=28.0, elevation_deg=30.0)


SOUTH: Final = Oblique(azimuth_deg=0.0, elevation_deg=0.0)


@styled
def field_setup(
    cones: pd.DataFrame,
    poses: pd.DataFrame,
    *,
    frame: str = "wcs",
    unseen: Sequence[str] = (),
    title: str = "Calibration field",
) -> Figure:
    """Cones coloured by height with camera (red) and lidar (grey): oblique view and plan (P2 Fig. 2).

    Parameters
    ----------
    cones, poses : see `thalweg.figures.calibration.tables`; the sensors of the first position are drawn.
    frame : frame of both tables; only in ``wcs`` is y north.
    unseen : names of cones of the field that the tables lack, for the title.
    title : first words of the title.
    """
    bodies = list(cones_of(cones).values())
    first = poses[poses["position"] == poses["position"].iloc[0]]
    ground, surface = _ground(bodies, points_of(first)), _surface(bodies)
    limits = (float(ground[0, 2]), float(surface[:, 2].max()))
    head = f"{title}, n = {plural(len(bodies), 'cone')}"
    head += f"; without data: {', '.join(unseen)}" if unseen else ""
    figure = new_figure(150.0, head)
    long = _is_long(bodies)
    axes = figure.subplot_mosaic([["a"], ["b"], ["c"]] if long else [["a", "a"], ["b", "c"]])
    for key, view, name in (("a", VIEW, "oblique view"), ("b", PLAN, "plan"), ("c", SOUTH, _side(frame))):
        ax = axes[key]
        _draw_ground(ax, bodies, ground, view)
        draw_cones(ax, bodies, view, colours=HEIGHT_MAP, limits_m=limits)
        name_cones(ax, bodies, view)
        draw_sensors(ax, first, view, arrow_m=0.9)
        width = fit_axes(ax, np.concatenate([view.apply(ground)[0], view.apply(surface)[0]]), margin=0.03)
        if key == "c":  # room for names above and the scale bar below
            low, high = ax.get_ylim()
            ax.set_ylim(low - 0.12 * (high - low), high + 0.35 * (high - low))
        ax.set_title(f"{key}: {name}")
        ax.axis("off")
        scale_bar(ax, span_m=width, xy=(0.02 if key != "a" else 0.7, 0.03))
    if frame == "wcs":
        north_arrow(axes["b"])
    legend_below(figure, axes["a"])
    words = f"{'up' if frame == 'wcs' else 'z'} ({frame}) / m"
    colour_bar(list(axes.values()), HEIGHT_MAP, limits, words, shrink=0.65, pad=0.02)
    return figure


@styled
def field_positions(
    cones: pd.DataFrame,
    poses: pd.DataFrame,
    *,
    frame: str = "wcs",
    title: str = "Positions of camera and lidar",
) -> Figure:
    """Field, and the positions of the boat in it with the z axes of both sensors (P2 Fig. 8).

    Circles are cameras, squares scanners; what stands on the boat together has one colour. The arrows have
    the same length in space and appear shorter where they point toward the viewer or away.

    Parameters: see `field_setup`; all positions are drawn.
    """
    bodies, sensors = list(cones_of(cones).values()), points_of(poses)
    names = natural(poses["position"].astype(str).tolist())
    head = f"{title}, n = {plural(len(names), 'position')}, {plural(len(bodies), 'cone')}"
    figure = new_figure(118.0, head)
    long = _is_long(bodies)
    parts = figure.subplot_mosaic([["a", "a"], ["b", "c"]] if long else [["a", "b"], ["a", "c"]])
    plan, surface = parts["a"], _surface(bodies)
    limits = (float(_ground(bodies, sensors)[0, 2]), float(surface[:, 2].max()))
    draw_cones(plan, bodies, PLAN, colours=HEIGHT_MAP, limits_m=limits)
    name_cones(plan, bodies, PLAN, dy_points=7.0)
    plan.plot(*sensors[:, :2].T, "+", color="black", ms=6, zorder=6)
    plan.set_title("a: field")
    plan.axis("off")
    scale_bar(plan, span_m=fit_axes(plan, np.concatenate([surface[:, :2], sensors[:, :2]])))
    if frame == "wcs":
        north_arrow(plan)
    # as the sensors lie apart
    arrow_m = float(np.clip(0.35 * np.ptp(sensors, axis=0).max(), 0.08, 1.0))
    words = ("east / m", "north / m", "up / m") if frame == "wcs" else ("x / m", "y / m", "z / m")
    for key, view, name, axis in (("b", PLAN, "from above", 1), ("c", SOUTH, _side(frame), 2)):
        ax, reach = parts[key], []
        for k, position in enumerate(names):
            part = poses[poses["position"].astype(str) == position]
            colour = POSITION_COLOURS[k % len(POSITION_COLOURS)]
            reach.append(draw_sensors(ax, part, view, arrow_m=arrow_m, colour=colour, position=position))
        fit_axes(ax, np.concatenate(reach), margin=0.08)
        ax.set_title(f"{key}: sensors {name}")
        ax.set(xlabel=words[0], ylabel=words[axis])
        ax.grid()
    for _, marker, word in SENSORS.values():
        parts["b"].plot([], [], marker, color="0.3", mfc="none", ms=6, label=word)
    legend_below(figure, parts["b"], title="position of the boat; arrows: z axes of the sensors")
    return figure


def draw_sensors(
    ax: Axes, poses: pd.DataFrame, view: Oblique, *, arrow_m: float, colour: str = "", position: str = ""
) -> ArrayF:
    """Draw sensors with their z axes, in their own colours or in one; returns both ends of the arrows."""
    xyz = points_of(poses)
    turns = Rotation.from_quat(points_of(poses, ("qx", "qy", "qz", "qw"))).as_matrix()
    start, end = view.apply(xyz)[0], view.apply(xyz + arrow_m * turns[:, :, 2])[0]
    for k, sensor in enumerate(poses["sensor"]):
        own, marker, _ = SENSORS[sensor]
        look = {"arrowstyle": "-|>", "color": colour or own, "lw": 1.1, "shrinkA": 3, "shrinkB": 0}
        ax.annotate("", end[k], xytext=start[k], zorder=4, arrowprops=look)
        words = position.replace("_", " ") if k == 0 else None
        ax.plot(
            *start[k], marker, ms=6, color=colour or own, mfc="white" if position else None, mew=1.2,
            zorder=5, gid=f"{sensor}-{position}" if position else sensor,
            label=words if position else f"{sensor} (arrow: z axis)",
        )  # fmt: skip
    return np.concatenate([start, end])


def _side(frame: str) -> str:
    return "from the south" if frame == "wcs" else "against y"


def _is_long(bodies: Sequence[FieldCone]) -> bool:
    """Whether views of a field lie one below the other."""
    wide, deep = np.ptp(_surface(bodies)[:, :2], axis=0)
    return bool(wide > LONG * deep)


def _surface(bodies: Sequence[FieldCone]) -> ArrayF:
    return np.concatenate([cone.surface().reshape(-1, 3) for cone in bodies])


def _ground(bodies: Sequence[FieldCone], sensors: ArrayF) -> ArrayF:
    """Corners (4, 3) of a horizontal grid below the field: the tables do not know the ground itself."""
    surface = _surface(bodies)
    both = np.concatenate([surface, sensors])[:, :2]
    low = GRID_M * np.floor(both.min(axis=0) / GRID_M)
    high = GRID_M * np.ceil(both.max(axis=0) / GRID_M)
    z = GROUND_STEP_M * np.floor(surface[:, 2].min() / GROUND_STEP_M)
    return np.array([[low[0], low[1], z], [high[0], low[1], z], [high[0], high[1], z], [low[0], high[1], z]])


def _draw_ground(ax: Axes, bodies: Sequence[FieldCone], ground: ArrayF, view: Oblique) -> None:
    """The grid, and a thin line from the middle of each cone to it, which shows place and height."""
    (x0, y0, z), (x1, y1, _) = ground[0], ground[2]
    lines = [[(x, y0, z), (x, y1, z)] for x in np.arange(x0, x1 + 0.01, GRID_M)]
    lines += [[(x0, y, z), (x1, y, z)] for y in np.arange(y0, y1 + 0.01, GRID_M)]
    for line in lines:
        ax.plot(*view.apply(np.array(line))[0].T, color="0.85", lw=0.6, zorder=1)
    for cone in bodies:
        x, y, up = cone.apex_m + 0.6 * cone.length_m * cone.axis
        ax.plot(*view.apply(np.array([(x, y, up), (x, y, z)]))[0].T, color="0.6", lw=0.8, zorder=2)


def _in_world(cones: Path, field: Path, place: Path, poses: Path) -> tuple[pd.DataFrame, pd.DataFrame, str]:
    """Cones and poses of a calibration in the world, or without a place of the field in its own frame."""
    T_wcs_pcs = read_place(place)
    bodies = placed(read_cones(cones, field), T_wcs_pcs)
    return bodies, placed(read_figure_table(poses), T_wcs_pcs), "pcs" if T_wcs_pcs is None else "wcs"


def draw_field_setup(*, cones: Path, field: Path, place: Path, poses: Path, title: str) -> Figure:
    """Cones and poses of a calibration -> figure of the field."""
    bodies, stands, frame = _in_world(cones, field, place, poses)
    described = [cone.name for cone in read_field(field).cones]
    unseen = [name for name in described if name not in set(bodies["name"])]
    return field_setup(bodies, stands, frame=frame, unseen=unseen, title=title)


def draw_field_positions(*, cones: Path, field: Path, place: Path, poses: Path) -> Figure:
    """Cones and poses of a calibration -> figure of the positions in the field."""
    bodies, stands, frame = _in_world(cones, field, place, poses)
    return field_positions(bodies, stands, frame=frame)


# ---------------------------------------------------------------- reference points, an image, cones (P1 Fig.
# 2)


REFERENCE_VIEW: Final = Oblique(azimuth_deg=28.0, elevation_deg=24.0)


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
) -> Figure:
    """Reference points, markers in an image with residuals, lidar points by cone, residuals of the fit.

    Parameters
    ----------
    field_points, cones, marks, cone_points : see `thalweg.figures.calibration.tables`; marks of one image,
        and cone points of the lidar at one position or several.
    image : (h, w) or (h, w, 3) uint8, the picture with the marks.
    image_name : shown above it.
    title : first words of the title.
    """
    bodies = cones_of(cones)
    used = cone_points[cone_points["used"].astype(bool)]
    head = f"{title}, n = {plural(len(field_points), 'reference point')}, {plural(len(used), 'lidar point')}"
    figure = new_figure(128.0, head)
    axes = figure.subplots(2, 2)
    _reference(axes[0, 0], field_points, list(bodies.values()))
    _image(axes[0, 1], image, marks, image_name)
    shown = thinned(used, POINTS_SHOWN)
    colours = {name: CONE_COLOURS[k % len(CONE_COLOURS)] for k, name in enumerate(bodies)}
    _on_cones(axes[1, 0], shown, bodies, c=shown["cone"].astype(str).map(colours))
    part = f", {count(len(shown))} of {count(len(used))} shown" if len(shown) < len(used) else ""
    axes[1, 0].set_title(f"c: lidar points on {plural(used['cone'].nunique(), 'cone')}{part}")
    mm = 1e3 * used["residual_m"].to_numpy()
    limit = max(abs(x) for x in robust_limits(mm, 2.0, 98.0))
    norm = Normalize(-limit, limit)
    _on_cones(axes[1, 1], shown, bodies, c=1e3 * shown["residual_m"], cmap=RESIDUAL_MAP, norm=norm)
    axes[1, 1].set_title(f"d: residuals, mean {mm.mean():+.1f} mm, std {mm.std():.1f} mm")
    colour_bar(axes[1, 1], RESIDUAL_MAP, norm, "outside +, inside − / mm", shrink=0.65, pad=0.02)
    return figure


def _reference(ax: Axes, points: pd.DataFrame, bodies: Sequence[FieldCone]) -> None:
    xy, depth = REFERENCE_VIEW.apply(points_of(points))
    sigma_mm = 1e3 * np.linalg.norm(points_of(points, [f"sigma_{name}" for name in XYZ]), axis=1)
    limits = robust_limits(sigma_mm, 0.0, 99.0)
    order = np.argsort(depth)
    draw_outlines(ax, bodies, REFERENCE_VIEW)
    ax.scatter(
        xy[order, 0],
        xy[order, 1],
        s=5,
        c=sigma_mm[order],
        cmap=SIGMA_MAP,
        norm=Normalize(*limits),
        lw=0,
        zorder=4,
    )
    name_cones(ax, bodies, REFERENCE_VIEW)
    _frame(ax, np.concatenate([xy, REFERENCE_VIEW.apply(_surface(bodies))[0]]))
    ax.set_title(f"a: reference points,\nmedian 3D sigma {np.median(sigma_mm):.2f} mm")
    colour_bar(ax, SIGMA_MAP, limits, "3D sigma / mm", shrink=0.65, pad=0.02)


def _image(ax: Axes, image: ArrayU8, marks: pd.DataFrame, name: str) -> None:
    h, w = image.shape[:2]
    used = marks["used"].to_numpy(bool)
    xy = points_of(marks, ("x_px", "y_px"))
    vector = points_of(marks, ("residual_x_px", "residual_y_px"))
    large = float(np.percentile(np.hypot(*vector[used].T), 95)) if used.any() else 1.0
    scale = round_length(VECTOR_SHARE * w / max(large, 1e-6))
    # pixel coordinates count from the corner: the picture fills 0..w, 0..h
    ax.imshow(image, cmap="gray", extent=(0, w, h, 0), interpolation="antialiased", alpha=0.75)
    ax.plot(*xy[used].T, ".", ms=2.0, color=SKY)
    if not used.all():
        words = f"{plural((~used).sum(), 'mark')} rejected"
        ax.plot(*xy[~used].T, "x", ms=4, color=ORANGE, label=words)
        ax.legend(loc="lower right")
    ax.quiver(
        *xy[used].T,
        *scale * vector[used].T,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        color=ORANGE,
        width=0.003,
        zorder=5,
    )
    ax.set(xlim=(0, w), ylim=(h, 0), xticks=[], yticks=[])
    rms = root_mean_square(vector[used])
    ax.set_title(
        f"b: {plural(len(marks), 'mark')} in {name or 'an image'}, RMS {rms:.3f} px,\n"
        f"residuals enlarged {count(scale) if scale >= 1 else f'{scale:g}'} times"
    )


def _on_cones(
    ax: Axes, points: pd.DataFrame, bodies: Mapping[str, FieldCone], *, c: pd.Series, **look: Any
) -> None:
    """Each cone with points beside the others, seen from the side on which these are, coloured by ``c``."""
    names, size = points["cone"].astype(str), 1.6 * max(cone.length_m for cone in bodies.values())
    reach = []
    for k, name in enumerate(name for name in bodies if (names == name).any()):
        cone, xyz = bodies[name], points_of(points[names == name]) - bodies[name].apex_m
        view = facing(cone, xyz, elevation_deg=15.0)
        at = size * np.array([k % COLUMNS, -(k // COLUMNS)]) - view.apply(0.5 * cone.length_m * cone.axis)[0]
        # not sorted by depth: points outside the cone are nearer and would hide those inside
        xy = view.apply(xyz)[0] + at
        ax.scatter(
            xy[:, 0], xy[:, 1], s=2.2, c=c[names == name], **look, lw=0, zorder=4, rasterized=True,
        )  # fmt: skip
        moved = replace(cone, apex_m=at @ view.axes[:2])
        draw_outlines(ax, [moved], view)
        name_cones(ax, [moved], view, dy_points=7.0)
        reach.append(view.apply(moved.surface(along=1).reshape(-1, 3))[0])
    if reach:
        _frame(ax, np.concatenate(reach))
    else:
        leave_out(ax, "no lidar point on a cone that is known")


def facing(cone: FieldCone, from_apex_m: ArrayF, *, elevation_deg: float) -> Oblique:
    """View of a cone from the side on which points (n, 3) are, counted from its apex; a little from above."""
    side = (from_apex_m - np.outer(from_apex_m @ cone.axis, cone.axis)).mean(axis=0)
    return Oblique(azimuth_deg=float(np.rad2deg(np.arctan2(-side[0], -side[1]))), elevation_deg=elevation_deg)


def _frame(ax: Axes, xy: ArrayF) -> None:
    width = fit_axes(ax, xy, margin=0.05)
    low, high = ax.get_ylim()
    ax.set_ylim(low - 0.12 * (high - low), high + 0.10 * (high - low))  # room for the bar and the names
    ax.axis("off")
    scale_bar(ax, span_m=width, xy=(0.02, 0.02))


def draw_field_reference(
    *,
    field_points: Path,
    cones: Path,
    field: Path,
    place: Path,
    images: list[Path],
    marks: Path,
    measured: Path,
    cone_points: Path,
    title: str,
) -> Figure:
    """Reference points, an image with its marks, lidar points of the cones -> figure of the calibration."""
    all_marks = read_image_marks(marks, measured)
    image = first_picture(images, choice=all_marks["image"].unique().tolist())
    T_wcs_pcs = read_place(place)
    return field_reference(
        placed(read_figure_table(field_points), T_wcs_pcs),
        placed(read_cones(cones, field), T_wcs_pcs),
        read_picture(image),
        all_marks[all_marks["image"] == image.name],
        placed(read_figure_table(cone_points), T_wcs_pcs),
        image_name=image.name,
        title=title,
    )
