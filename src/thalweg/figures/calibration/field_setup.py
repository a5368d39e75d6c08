"""The calibration field with camera and lidar (P2 Fig. 2), and where the boat stood in it (P2 Fig. 8)."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from thalweg.core.types import ArrayF
from thalweg.figures.calibration.field_views import (
    PLAN,
    FieldCone,
    Oblique,
    cones_of,
    draw_cones,
    draw_outlines,
    fit_axes,
    name_cones,
)
from thalweg.figures.calibration.tables import CONES, POSES, checked, filled, natural, points_of
from thalweg.figures.style import (
    BLUE,
    GREEN,
    GREY,
    HALO,
    HEIGHT_MAP,
    ORANGE,
    PURPLE,
    RED,
    SKY,
    VERMILION,
    new_figure,
    north_arrow,
    plural,
    scale_bar,
    styled,
)

VIEW: Final = Oblique(azimuth_deg=28.0, elevation_deg=30.0)
SOUTH: Final = Oblique(azimuth_deg=0.0, elevation_deg=0.0)
LIDAR_GREY: Final = "0.35"
POSITION_COLOURS: Final = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
SENSOR_MARKERS: Final = {"camera": "o", "lidar": "s"}

SENSOR_LOOK: Final = {"camera": (RED, "o"), "lidar": (LIDAR_GREY, "s")}
GRID_M: Final = 2.0
LONG: Final = 2.0
"""A field this many times longer than wide has its views one below the other."""

GROUND_STEP_M: Final = 0.5
"""The grid lies at the next such height below the lowest cone."""


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
        ScalarMappable(Normalize(*limits), HEIGHT_MAP), ax=list(axes.values()), label=height,
        shrink=0.6, pad=0.01, aspect=28,
    )  # fmt: skip
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
            "", end[k], xytext=start[k], zorder=4, gid="z-axis",
            arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.1, "shrinkA": 3, "shrinkB": 0,
                        "mutation_scale": 8},
        )  # fmt: skip
        ax.plot(
            start[k, 0], start[k, 1], ls="none", marker=SENSOR_MARKERS[sensor], ms=7, color=colour,
            mfc="white", mew=1.5, zorder=5, gid=f"{sensor}-{label}",
            label=label.replace("_", " ") if k == 0 else None,
        )  # fmt: skip
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
        colour, marker = SENSOR_LOOK[sensor]
        ax.annotate(
            "", tips[k], xytext=xy[k], zorder=5,
            arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.2, "shrinkA": 2, "shrinkB": 0,
                        "mutation_scale": 8},
        )  # fmt: skip
        ax.plot(
            xy[k, 0], xy[k, 1], ls="none", marker=marker, ms=5.5, color=colour, mec="white", mew=0.8,
            zorder=6, label=f"{sensor} (arrow: z axis)", gid=sensor,
        )  # fmt: skip


def _draw_frame(ax: Axes, ground: ArrayF, view: Oblique, frame: str) -> None:
    """Axes of the frame in the corner of the grid."""
    corner = ground[0]
    for k, name in enumerate("xyz"):
        ends, _ = view.apply(np.array([corner, corner + 1.2 * np.eye(3)[k]]))
        ax.annotate("", ends[1], xytext=ends[0], arrowprops={"arrowstyle": "-|>", "color": "black", "lw": 1.0,
                    "shrinkA": 0, "shrinkB": 0, "mutation_scale": 7}, zorder=4)  # fmt: skip
        x, y = ends[0] + 1.18 * (ends[1] - ends[0])
        ax.text(x, y, name, ha="center", va="center", fontsize=7,
                path_effects=HALO, zorder=7)  # fmt: skip
    ax.annotate(frame, tuple(view.apply(corner)[0]), xytext=(-4, -7), textcoords="offset points", ha="right",
                fontsize=7, color=GREY)  # fmt: skip
