"""The calibration field: set-up, positions in it, reference points, markers in an image, cones."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from cmcrameri import cm
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from thalweg.calibration.field import read_field
from thalweg.core import ArrayF, ArrayU8, InputError, root_mean_square
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
    count,
    leave_out,
    new_figure,
    north_arrow,
    plural,
    read_picture,
    robust_limits,
    round_length,
    scale_bar,
    styled,
)
from thalweg.figures.calibration.tables import (
    CONE_POINTS,
    CONES,
    FIELD_POINTS,
    IMAGE_MARKS,
    POSES,
    checked,
    filled,
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
CONE_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "*")
RESIDUAL_MAP: Final[Colormap] = cm.vik
"""Blue inside a cone, brown outside; white is no residual."""
_LIGHT: Final = np.array([0.35, -0.45, 0.82])

LIDAR_GREY: Final = "0.35"
POSITION_COLOURS: Final = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
SENSOR_MARKERS: Final = {"camera": "o", "lidar": "s"}
SENSOR_STYLE: Final = {"camera": (RED, "o"), "lidar": (LIDAR_GREY, "s")}
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
    used: bool

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

    def unrolled(self, points_m: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Angle about the axis in radians, 0 at the top of a lying cone, and distance from the apex."""
        local = (points_m - self.apex_m) @ self.frame.T
        angle = np.arctan2(local[:, 0], local[:, 1])
        c, s = np.cos(self.half_angle_rad), np.sin(self.half_angle_rad)
        return angle, np.asarray(local[:, 2] * c + np.hypot(local[:, 0], local[:, 1]) * s)

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
            used=bool(rows[name]["used"]),
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
    ax: Axes,
    cones: Sequence[FieldCone],
    view: Oblique,
    *,
    colours: Colormap,
    limits_m: tuple[float, float],
    alpha: float = 1.0,
) -> PolyCollection:
    """Draw cones as shaded bodies, coloured by height; nearer facets hide those behind.

    Parameters
    ----------
    cones : drawn together, so that one may stand before another.
    view : how it is seen.
    colours, limits_m : map of heights, metres.
    alpha : opacity.
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
    rgba[:, 3] = alpha
    body = PolyCollection(
        list(np.concatenate(corners)[order]),
        facecolors=rgba[order],
        edgecolors=rgba[order],
        linewidths=0.2,
        zorder=3,
        gid="cones",
        rasterized=True,
    )
    ax.add_collection(body)
    return body


def draw_outlines(
    ax: Axes, cones: Sequence[FieldCone], view: Oblique, *, colour: str = GREY, lw: float = 0.7
) -> None:
    """Draw the outline of each cone: base circle and the two lines that bound it in this view."""
    for cone in cones:
        xy, _ = view.apply(cone.surface(along=1))
        apex, base = xy[0, 0], xy[1]
        ax.plot(base[:, 0], base[:, 1], color=colour, lw=lw, zorder=2, gid="outline")
        way = base - apex
        middle = way.mean(axis=0)
        if np.linalg.norm(middle) < 1e-9:
            continue
        turn = np.arctan2(middle[0] * way[:, 1] - middle[1] * way[:, 0], way @ middle)
        if np.ptp(turn) < np.pi:  # seen from the side: the apex is not inside the base
            for k in (int(np.argmin(turn)), int(np.argmax(turn))):
                ax.plot(*np.stack([apex, base[k]]).T, color=colour, lw=lw, zorder=2, gid="outline")


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
            gid="cone-name",
        )


def cone_look(names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Colour and marker of each cone, the same in every figure."""
    return {
        name: (CONE_COLOURS[k % len(CONE_COLOURS)], CONE_MARKERS[k % len(CONE_MARKERS)])
        for k, name in enumerate(natural(list(names)))
    }


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
    twin: bool = False,
) -> Figure:
    """Cones coloured by height with camera (red) and lidar (grey): oblique view and plan (P2 Fig. 2).

    Parameters
    ----------
    cones, poses : see `thalweg.figures.calibration.tables`; the sensors of the first position are drawn.
    frame : frame of both tables; only in ``wcs`` is y north.
    unseen : names of cones of the field that the tables lack, for the title.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : a column is missing.
    CoverageError : no cone or no pose.
    """
    bodies = list(cones_of(filled(checked(cones, CONES), "cone")).values())
    first = filled(checked(poses, POSES), "pose")
    first = first[first["position"] == first["position"].iloc[0]]
    surface = np.concatenate([cone.surface().reshape(-1, 3) for cone in bodies])
    ground = _ground(surface, points_of(first))
    limits = (float(ground[0, 2]), float(surface[:, 2].max()))
    used = sum(cone.used for cone in bodies)
    head = f"{title}, n = {plural(len(bodies), 'cone')}, {used} of them used"
    head += f"; without data: {', '.join(unseen)}" if unseen else ""
    wide, deep = np.ptp(ground[:, :2], axis=0)
    if wide > LONG * deep:  # one below the other
        figure = new_figure(172.0, head, twin=twin)
        axes = figure.subplot_mosaic([["a"], ["b"], ["c"]], height_ratios=[1.5, 1.0, 0.8])
    else:
        figure = new_figure(150.0, head, twin=twin)
        axes = figure.subplot_mosaic([["a", "a"], ["b", "c"]], height_ratios=[1.0, 0.95])
    south, height = _side_name(frame), f"{'up' if frame == 'wcs' else 'z'} ({frame}) / m"
    for key, view, name in (("a", VIEW, "oblique view"), ("b", PLAN, "plan"), ("c", SOUTH, south)):
        ax = axes[key]
        _draw_ground(ax, ground, view)
        _draw_feet(ax, bodies, view, float(ground[0, 2]))
        draw_cones(ax, bodies, view, colours=HEIGHT_MAP, limits_m=limits)
        name_cones(ax, bodies, view)
        _draw_sensors(ax, first, view)
        width = fit_axes(ax, np.concatenate([view.apply(ground)[0], view.apply(surface)[0]]), margin=0.03)
        if key == "c":  # room for names above and the scale bar below
            low, high = ax.get_ylim()
            ax.set_ylim(low - 0.12 * (high - low), high + 0.35 * (high - low))
        ax.set_title(f"{key}: {name}")
        ax.axis("off")
        scale_bar(ax, span_m=width, xy=(0.02, 0.03) if key != "a" else (0.7, 0.03))
    if frame == "wcs":
        north_arrow(axes["b"])
    _draw_frame(axes["a"], ground, VIEW, frame)
    handles, labels = axes["a"].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=len(labels))
    figure.colorbar(
        ScalarMappable(Normalize(*limits), HEIGHT_MAP),
        ax=list(axes.values()),
        label=height,
        shrink=0.6,
        pad=0.01,
        aspect=28,
    )
    return figure


@styled
def field_positions(
    cones: pd.DataFrame,
    poses: pd.DataFrame,
    *,
    frame: str = "wcs",
    title: str = "Positions of camera and lidar",
    twin: bool = False,
) -> Figure:
    """Field, and the positions of the boat in it with the z axes of both sensors (P2 Fig. 8).

    Circles are cameras, squares scanners; what stands on the boat together has one colour. The arrows have
    the same length in space and appear shorter where they point toward the viewer or away.

    Parameters and errors: see `field_setup`; all positions are drawn.
    """
    bodies = list(cones_of(filled(checked(cones, CONES), "cone")).values())
    poses = filled(checked(poses, POSES), "pose")
    names = natural(poses["position"].astype(str).tolist())
    used = sum(cone.used for cone in bodies)
    lever = lever_text(poses)
    head = f"{title}, n = {plural(len(names), 'position')}, {used} of {len(bodies)} cones used"
    figure = new_figure(118.0, head + (f"; sensors {lever} apart" if lever else ""), twin=twin)
    arrow_m = _arrow_length(poses)
    spans = [_span(poses, view, arrow_m) for view in (PLAN, SOUTH)]
    parts = _three_parts(figure, bodies, spans)
    _field_plan(parts["a"], bodies, points_of(poses), frame)
    names_of = ("east / m", "north / m", "up / m") if frame == "wcs" else ("x / m", "y / m", "z / m")
    for key, view, name, words in (
        ("b", PLAN, "sensors from above", (names_of[0], names_of[1])),
        ("c", SOUTH, f"sensors {_side_name(frame)}", (names_of[0], names_of[2])),
    ):
        ax, reach = parts[key], []
        for k, position in enumerate(names):
            part = poses[poses["position"].astype(str) == position]
            colour = POSITION_COLOURS[k % len(POSITION_COLOURS)]
            reach.append(_draw_position(ax, part, view, colour=colour, label=position, arrow_m=arrow_m))
        fit_axes(ax, np.concatenate(reach), margin=0.08)
        ax.set_title(f"{key}: {name}")
        ax.set(xlabel=words[0], ylabel=words[1])
        ax.grid()
    middle = parts["b"]
    handles, labels = middle.get_legend_handles_labels()
    for sensor, marker in SENSOR_MARKERS.items():
        handles.append(middle.plot([], [], ls="none", marker=marker, color="0.3", mfc="none", ms=6)[0])
        labels.append("camera" if sensor == "camera" else "scanner")
    figure.legend(
        handles,
        labels,
        loc="outside lower left",
        ncols=min(len(labels), 8),
        title="position of the boat; arrows: z axes of the sensors",
    )
    return figure


def _three_parts(figure: Figure, bodies: Sequence[FieldCone], spans: Sequence[float]) -> dict[str, Axes]:
    """Axes of the plan, and of the sensors from above and from the side; a long field lies across."""
    wide, deep = np.ptp(np.concatenate([cone.surface().reshape(-1, 3)[:, :2] for cone in bodies]), axis=0)
    if wide > LONG * deep:
        return dict(figure.subplot_mosaic([["a", "a"], ["b", "c"]], height_ratios=[deep / wide + 0.2, 1.0]))
    heights = list(spans)
    return dict(
        figure.subplot_mosaic([["a", "b"], ["a", "c"]], width_ratios=[1.2, 1.0], height_ratios=heights)
    )


def axes_of(poses: pd.DataFrame) -> ArrayF:
    """(n, 3, 3) rotations from the sensors' frames to that of the table."""
    return np.asarray(Rotation.from_quat(poses[["qx", "qy", "qz", "qw"]].to_numpy(np.float64)).as_matrix())


def lever_text(poses: pd.DataFrame) -> str:
    """Distance between camera and scanner, mean of the positions: ``16.2 cm``; "" if one is missing."""
    both = {
        sensor: points_of(part.sort_values("position")) for sensor, part in poses.groupby("sensor", sort=True)
    }
    if set(both) < {"camera", "lidar"} or len(both["camera"]) != len(both["lidar"]):
        return ""
    return f"{100 * float(np.linalg.norm(both['camera'] - both['lidar'], axis=1).mean()):.1f} cm"


def _arrow_length(poses: pd.DataFrame) -> float:
    """Length of the arrows: as the sensors lie apart, rounded up a little."""
    xyz = points_of(poses)
    spread = float(np.ptp(xyz, axis=0).max())
    return float(np.clip(0.35 * spread, 0.08, 1.0))


def _span(poses: pd.DataFrame, view: Oblique, arrow_m: float) -> float:
    """Height of the sensors and their arrows in a view, never less than a quarter of the width."""
    xyz = points_of(poses)
    xy = view.apply(np.concatenate([xyz, xyz + arrow_m * axes_of(poses)[:, :, 2]]))[0]
    width, height = np.ptp(xy, axis=0)
    return float(max(height, 0.25 * width))


def _draw_position(
    ax: Axes, part: pd.DataFrame, view: Oblique, *, colour: str, label: str, arrow_m: float
) -> ArrayF:
    xyz = points_of(part)
    tips = xyz + arrow_m * axes_of(part)[:, :, 2]
    start, end = view.apply(xyz)[0], view.apply(tips)[0]
    ax.plot(start[:, 0], start[:, 1], color=colour, lw=1.0, ls=":", zorder=3)
    for k, sensor in enumerate(part["sensor"]):
        ax.annotate(
            "",
            end[k],
            xytext=start[k],
            zorder=4,
            gid="z-axis",
            arrowprops={
                "arrowstyle": "-|>",
                "color": colour,
                "lw": 1.1,
                "shrinkA": 3,
                "shrinkB": 0,
                "mutation_scale": 8,
            },
        )
        ax.plot(
            start[k, 0],
            start[k, 1],
            ls="none",
            marker=SENSOR_MARKERS[sensor],
            ms=7,
            color=colour,
            mfc="white",
            mew=1.5,
            zorder=5,
            gid=f"{sensor}-{label}",
            label=label.replace("_", " ") if k == 0 else None,
        )
    return np.concatenate([start, end])


def _field_plan(ax: Axes, bodies: Sequence[FieldCone], sensors: ArrayF, frame: str) -> None:
    used, unused = [c for c in bodies if c.used], [c for c in bodies if not c.used]
    surface = np.concatenate([cone.surface().reshape(-1, 3) for cone in bodies])
    limits = (float(_ground(surface, sensors)[0, 2]), float(surface[:, 2].max()))
    if used:
        draw_cones(ax, used, PLAN, colours=HEIGHT_MAP, limits_m=limits)
    draw_outlines(ax, unused, PLAN)
    name_cones(ax, bodies, PLAN, dy_points=7.0)
    xy = PLAN.apply(sensors)[0]
    ax.plot(xy[:, 0], xy[:, 1], ls="none", marker="+", color="black", ms=6, zorder=6, label="sensors")
    width = fit_axes(ax, np.concatenate([PLAN.apply(surface)[0], xy]))
    ax.set_title("a: field; outlined: cone not used")
    ax.axis("off")
    scale_bar(ax, span_m=width)
    if frame == "wcs":
        north_arrow(ax)


def _side_name(frame: str) -> str:
    return "from the south" if frame == "wcs" else "against y"


def _ground(surface: ArrayF, sensors: ArrayF) -> ArrayF:
    """Corners (4, 3) of a horizontal grid below the field: the tables do not know the ground itself."""
    both = np.concatenate([surface, sensors])[:, :2]
    low = GRID_M * np.floor(both.min(axis=0) / GRID_M)
    high = GRID_M * np.ceil(both.max(axis=0) / GRID_M)
    z = GROUND_STEP_M * np.floor(float(surface[:, 2].min()) / GROUND_STEP_M)
    return np.array([[low[0], low[1], z], [high[0], low[1], z], [high[0], high[1], z], [low[0], high[1], z]])


def _draw_ground(ax: Axes, ground: ArrayF, view: Oblique) -> None:
    (x0, y0, z), (x1, y1, _) = ground[0], ground[2]
    lines = [[(x, y0, z), (x, y1, z)] for x in np.arange(x0, x1 + 0.01, GRID_M)]
    lines += [[(x0, y, z), (x1, y, z)] for y in np.arange(y0, y1 + 0.01, GRID_M)]
    for line in lines:
        xy, _ = view.apply(np.array(line))
        ax.plot(xy[:, 0], xy[:, 1], color="0.85", lw=0.6, zorder=1)


def _draw_feet(ax: Axes, bodies: Sequence[FieldCone], view: Oblique, ground_m: float) -> None:
    """A thin line from the middle of each cone to the grid: it shows place and height."""
    for cone in bodies:
        middle = cone.apex_m + 0.6 * cone.length_m * cone.axis
        xy, _ = view.apply(np.array([middle, [middle[0], middle[1], ground_m]]))
        ax.plot(xy[:, 0], xy[:, 1], color="0.6", lw=0.8, zorder=2)


def _draw_sensors(ax: Axes, poses: pd.DataFrame, view: Oblique) -> None:
    xyz = points_of(poses)
    xy, _ = view.apply(xyz)
    tips, _ = view.apply(xyz + 0.9 * axes_of(poses)[:, :, 2])
    for k, sensor in enumerate(poses["sensor"]):
        colour, marker = SENSOR_STYLE[sensor]
        ax.annotate(
            "",
            tips[k],
            xytext=xy[k],
            zorder=5,
            arrowprops={
                "arrowstyle": "-|>",
                "color": colour,
                "lw": 1.2,
                "shrinkA": 2,
                "shrinkB": 0,
                "mutation_scale": 8,
            },
        )
        ax.plot(
            xy[k, 0],
            xy[k, 1],
            ls="none",
            marker=marker,
            ms=5.5,
            color=colour,
            mec="white",
            mew=0.8,
            zorder=6,
            label=f"{sensor} (arrow: z axis)",
            gid=sensor,
        )


def _draw_frame(ax: Axes, ground: ArrayF, view: Oblique, frame: str) -> None:
    """Axes of the frame in the corner of the grid."""
    corner = ground[0]
    for k, name in enumerate("xyz"):
        ends, _ = view.apply(np.array([corner, corner + 1.2 * np.eye(3)[k]]))
        ax.annotate(
            "",
            ends[1],
            xytext=ends[0],
            arrowprops={
                "arrowstyle": "-|>",
                "color": "black",
                "lw": 1.0,
                "shrinkA": 0,
                "shrinkB": 0,
                "mutation_scale": 7,
            },
            zorder=4,
        )
        x, y = ends[0] + 1.18 * (ends[1] - ends[0])
        ax.text(x, y, name, ha="center", va="center", fontsize=7, path_effects=HALO, zorder=7)
    ax.annotate(
        frame,
        tuple(view.apply(corner)[0]),
        xytext=(-4, -7),
        textcoords="offset points",
        ha="right",
        fontsize=7,
        color=GREY,
    )


def draw_field_setup(*, cones: Path, field: Path, place: Path, poses: Path, title: str, twin: bool) -> Figure:
    """Cones and poses of a calibration -> figure of the field."""
    T_wcs_pcs = read_place(place)
    bodies = placed(read_cones(cones, field), T_wcs_pcs)
    stands = placed(read_figure_table(poses, POSES), T_wcs_pcs)
    frame = "pcs" if T_wcs_pcs is None else "wcs"
    described = [cone.name for cone in read_field(field).cones]
    unseen = [name for name in described if name not in set(bodies["name"].astype(str))]
    return field_setup(bodies, stands, frame=frame, unseen=unseen, title=title, twin=twin)


def draw_field_positions(*, cones: Path, field: Path, place: Path, poses: Path, twin: bool) -> Figure:
    """Cones and poses of a calibration -> figure of the positions in the field."""
    T_wcs_pcs = read_place(place)
    bodies = placed(read_cones(cones, field), T_wcs_pcs)
    stands = placed(read_figure_table(poses, POSES), T_wcs_pcs)
    frame = "pcs" if T_wcs_pcs is None else "wcs"
    return field_positions(bodies, stands, frame=frame, twin=twin)


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
    xy, depth = REFERENCE_VIEW.apply(points_of(points))
    sigma_mm = 1e3 * np.sqrt((points[["sigma_x_m", "sigma_y_m", "sigma_z_m"]] ** 2).sum(axis=1)).to_numpy()
    limits = robust_limits(sigma_mm, 0.0, 99.0)
    order = np.argsort(depth)
    draw_outlines(ax, list(bodies.values()), REFERENCE_VIEW)
    ax.scatter(
        xy[order, 0],
        xy[order, 1],
        s=5,
        c=sigma_mm[order],
        cmap=SIGMA_MAP,
        norm=Normalize(*limits),
        lw=0,
        zorder=4,
        gid="reference",
    )
    name_cones(ax, list(bodies.values()), REFERENCE_VIEW)
    _frame(ax, np.concatenate([xy, _outline(bodies)]))
    ax.set_title(f"a: reference points,\nmedian 3D sigma {np.median(sigma_mm):.2f} mm")
    figure.colorbar(
        ScalarMappable(Normalize(*limits), SIGMA_MAP), ax=ax, label="3D sigma / mm", shrink=0.7, pad=0.02
    )


def _image(ax: Axes, image: ArrayU8, marks: pd.DataFrame, name: str) -> None:
    h, w = image.shape[:2]
    used = marks["used"].to_numpy(bool)
    xy = marks[["x_px", "y_px"]].to_numpy(np.float64)
    vector = marks[["residual_x_px", "residual_y_px"]].to_numpy(np.float64)
    length = np.hypot(*vector.T)
    rms = root_mean_square(vector[used]) if used.any() else float("nan")
    large = float(np.percentile(length[used], 95)) if used.any() else 1.0
    scale = round_length(VECTOR_SHARE * w / max(large, 1e-6))
    # pixel coordinates count from the corner: the picture fills 0..w, 0..h
    ax.imshow(image, cmap="gray", extent=(0, w, h, 0), interpolation="antialiased", alpha=0.75)
    ax.plot(xy[used, 0], xy[used, 1], ls="none", marker=".", ms=2.0, color=SKY, gid="marks")
    if not used.all():
        ax.plot(
            xy[~used, 0],
            xy[~used, 1],
            ls="none",
            marker="x",
            ms=4,
            color=ORANGE,
            gid="rejected",
            label=f"{plural(int((~used).sum()), 'mark')} rejected",
        )
        ax.legend(loc="lower right")
    ends = xy + scale * vector
    ax.quiver(
        xy[used, 0],
        xy[used, 1],
        *(ends - xy)[used].T,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        color=ORANGE,
        width=0.003,
        headwidth=3.5,
        headlength=4,
        gid="residuals",
        zorder=5,
    )
    ax.set_xlim(0, w)
    ax.set_ylim(h, 0)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.set_title(
        f"b: {plural(len(marks), 'mark')} in {name or 'an image'}, RMS {rms:.3f} px,\n"
        f"residuals enlarged {count(int(scale)) if scale >= 1 else f'{scale:g}'} times"
    )


def _lidar(ax: Axes, points: pd.DataFrame, bodies: dict[str, FieldCone]) -> None:
    shown = _thinned(points)
    looks = cone_look(list(bodies))
    reach = []
    for name, cone, view, at in _contact_sheet(shown, bodies):
        xy = view.apply(points_of(shown[shown["cone"].astype(str) == name]) - cone.apex_m)[0] + at
        colour, _ = looks[name]
        ax.plot(
            xy[:, 0],
            xy[:, 1],
            ls="none",
            marker=".",
            ms=1.8,
            mew=0,
            color=colour,
            gid=f"cone-{name}",
            rasterized=True,
            zorder=4,
        )
        reach.append(_outline_of(ax, cone, view, at))
    if not reach:
        leave_out(ax, "no lidar point on a cone that is known")
        return
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
            xy[:, 0],
            xy[:, 1],
            s=2.2,
            c=1e3 * part["residual_m"].to_numpy(),
            cmap=RESIDUAL_MAP,
            norm=norm,
            lw=0,
            zorder=4,
            gid="fit",
            rasterized=True,
        )
        reach.append(_outline_of(ax, cone, view, at))
    if not reach:
        leave_out(ax, "no lidar point on a cone that is known")
        return
    _frame(ax, np.concatenate(reach))
    ax.set_title(f"d: residuals, mean {residual_mm.mean():+.1f} mm, std {residual_mm.std():.1f} mm")
    figure.colorbar(
        ScalarMappable(norm, RESIDUAL_MAP),
        ax=ax,
        label="outside +, inside − / mm",
        shrink=0.7,
        pad=0.02,
        extend="both",
    )


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
    return np.concatenate(
        [REFERENCE_VIEW.apply(cone.surface(along=1).reshape(-1, 3))[0] for cone in bodies.values()]
    )


def _thinned(points: pd.DataFrame) -> pd.DataFrame:
    """An even sample of at most `POINTS_SHOWN` rows."""
    step = -(-len(points) // POINTS_SHOWN)
    return points.iloc[:: max(step, 1)]


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
    twin: bool,
) -> Figure:
    """Reference points, an image with its marks, lidar points of the cones -> figure of the calibration."""
    all_marks = read_image_marks(marks, measured)
    image = first_picture(images, choice=all_marks["image"].unique().tolist())
    T_wcs_pcs = read_place(place)
    return field_reference(
        placed(read_figure_table(field_points, FIELD_POINTS), T_wcs_pcs),
        placed(read_cones(cones, field), T_wcs_pcs),
        read_picture(image),
        all_marks[all_marks["image"] == image.name],
        placed(read_figure_table(cone_points, CONE_POINTS), T_wcs_pcs),
        image_name=image.name,
        title=title,
        twin=twin,
    )
