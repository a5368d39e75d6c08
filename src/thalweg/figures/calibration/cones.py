"""Cones of a calibration field: their frame, residuals on them, before and after the lidar's calibration."""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.stats import norm as normal

from thalweg.core import ArrayF, CoverageError, robust_sigma, root_mean_square
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
    robust_limits,
    scale_bar,
    styled,
)
from thalweg.figures.calibration.field import (
    AROUND,
    RESIDUAL_MAP,
    FieldCone,
    Oblique,
    cones_of,
    draw_outlines,
)
from thalweg.figures.calibration.tables import (
    CONE_POINTS,
    CONES,
    checked,
    filled,
    natural,
    points_of,
    read_cones,
    read_figure_table,
)

HALF_ANGLE_DEG: Final = 25.0
VIEW: Final = Oblique(azimuth_deg=72.0, elevation_deg=18.0)
CONE: Final = FieldCone(
    name="",
    apex_m=np.array([0.0, 0.0, 0.55]),
    axis=np.array([0.78, -1.0, 0.2]),
    half_angle_rad=float(np.deg2rad(HALF_ANGLE_DEG)),
    length_m=1.6,
    used=True,
)
_OFF_M: Final = 0.16
"""How far the drawn point lies off the surface, to show what a residual is."""

COLUMNS: Final = 3
POINTS_SHOWN: Final = 4000
"""Of each cone; an even sample of them."""
BINS: Final = 61

POINTS_SHOWN_OF_CONE: Final = 6000
REACH: Final = 1.9
"""Half width of the view along the axis, in radii of the cone."""
FROM_APEX: Final = 0.25
"""Points nearer to the apex than this share of the length say little about the radius."""


# ---------------------------------------------------------------- cone coordinate system (P2 Fig. 3)


@styled
def cone_frame() -> Figure:
    """Left: a cone in its frame and in that of the field. Right: the plane of its axis and a point."""
    figure = new_figure(74.0, "A cone and its coordinate system (no data)", twin=False)
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
    _space(left)
    _section(right)
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


def _flat(points: ArrayF) -> ArrayF:
    return VIEW.apply(np.asarray(points))[0]


def _space(ax: Axes) -> None:
    x, y, z = CONE.frame
    base = _flat(CONE.surface()[-1])
    apex = _flat(CONE.apex_m)
    edges = [base[int(np.argmin(base[:, 1]))], base[int(np.argmax(base[:, 1]))]]
    ax.fill(
        *np.concatenate([base, [edges[0], apex, edges[1]]]).T, facecolor="0.93", edgecolor="none", zorder=1
    )
    ax.plot(base[:, 0], base[:, 1], color="0.6", lw=0.8, ls="--", zorder=2)
    for edge in edges:
        ax.plot(*np.stack([apex, edge]).T, color="0.35", lw=1.0, zorder=2)
    for share in (0.35, 0.7):
        ring = _flat(CONE.apex_m + share * (CONE.surface()[-1] - CONE.apex_m))
        ax.plot(ring[:, 0], ring[:, 1], color="0.78", lw=0.6, zorder=1)
    for axis, name, reach in ((x, "x", 0.6), (y, "y", 0.55), (z, "z", 2.3)):
        _arrow(ax, apex, _flat(CONE.apex_m + reach * axis), f"${name}_{{cocs}}$", colour=BLUE, away=0.12)
    _words(ax, apex + np.array([0.02, -0.16]), "$a$", colour="black")
    ax.plot(*apex, marker="o", ms=4, color="black", zorder=6)
    origin = np.array([0.0, 1.2, -0.25])
    for k, name in enumerate("xyz"):
        _arrow(ax, _flat(origin), _flat(origin + 0.45 * np.eye(3)[k]), f"${name}_{{pcs}}$", colour="black")
    look = {"arrowstyle": "-|>", "color": "0.5", "ls": "--", "lw": 0.9, "shrinkB": 4}
    ax.annotate("", tuple(apex), xytext=tuple(_flat(origin)), zorder=1, arrowprops=look)
    _words(ax, 0.5 * (apex + _flat(origin)) + np.array([0.36, -0.1]), "$(x_a,\\,y_a,\\,z_a)$", colour="0.3")
    turn = np.deg2rad(-35.0)
    radius = 1.05 * np.tan(CONE.half_angle_rad)
    on = CONE.apex_m + np.array([radius * np.sin(turn), radius * np.cos(turn), 1.05]) @ CONE.frame
    ax.plot(*_flat(on), marker="o", ms=4.5, color=VERMILION, zorder=6)
    _words(ax, _flat(on) + np.array([0.0, 0.14]), "$p_j$", colour=VERMILION)
    ax.set_title("a: in space; the axis has two angles\n($\\lambda$, $\\theta$) in pcs")
    _clean(ax, (-1.75, 2.3), (-0.8, 1.75))


def _section(ax: Axes) -> None:
    alpha, length = CONE.half_angle_rad, CONE.length_m
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
    ax.set_title(
        "b: in the plane of axis and point\n$s_j=\\rho\\cos\\alpha-z\\sin\\alpha$, zero on the surface"
    )
    _clean(ax, (-0.25, 2.35), (-0.95, 1.3))


def _clean(ax: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlim(*x)
    ax.set_ylim(*y)
    ax.axis("off")


def draw_cone_frame() -> Figure:
    """Sketch of a cone's coordinate system."""
    return cone_frame()


# ---------------------------------------------------------------- residuals of the points of a cone


@styled
def cone_residuals(
    points: pd.DataFrame, cones: pd.DataFrame, *, title: str = "Residuals on the cones", twin: bool = False
) -> Figure:
    """Each cone unrolled, coloured by the signed distance from its surface, and a histogram of all.

    Parameters
    ----------
    points, cones : see `thalweg.figures.calibration.tables`; points that were not used are grey.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : a column is missing.
    CoverageError : no point was used.
    """
    points = checked(points, CONE_POINTS)
    used = filled(points[points["used"].astype(bool)], "point used")
    bodies = cones_of(checked(cones, CONES))
    names = [name for name in natural(used["cone"].astype(str).tolist()) if name in bodies]
    residual_mm = 1e3 * used["residual_m"].to_numpy(np.float64)
    limit = max(abs(x) for x in robust_limits(residual_mm, 2.0, 98.0))
    rows = -(-len(names) // COLUMNS)
    rejected = len(points) - len(used)
    head = f"{title}, n = {plural(len(used), 'point')} on {plural(len(names), 'cone')}"
    head += f", {count(rejected)} not used"
    figure = new_figure(24.0 + 44.0 * rows + 42.0, head, twin=twin)
    grid = figure.add_gridspec(rows + 1, COLUMNS, height_ratios=[*([1.0] * rows), 0.95])
    norm = Normalize(-limit, limit)
    cells = [figure.add_subplot(grid[k // COLUMNS, k % COLUMNS]) for k in range(len(names))]
    for k, (ax, name) in enumerate(zip(cells, names, strict=True)):
        _unrolled(ax, bodies[name], points[points["cone"].astype(str) == name], norm)
        ax.set_xlabel("angle about the axis / °" if k // COLUMNS == rows - 1 else "")
        ax.set_ylabel("distance from apex / m" if k % COLUMNS == 0 else "")
    figure.colorbar(
        ScalarMappable(norm, RESIDUAL_MAP),
        ax=cells,
        label="residual, outside + / mm",
        extend="both",
        pad=0.01,
        aspect=30,
        shrink=0.85,
    )
    _histogram(figure.add_subplot(grid[rows, :2]), residual_mm, limit)
    _by_cone(figure.add_subplot(grid[rows, 2]), used, names)
    return figure


def _unrolled(ax: Axes, cone: FieldCone, points: pd.DataFrame, norm: Normalize) -> None:
    angle, along = cone.unrolled(points_of(points))
    used = points["used"].to_numpy(bool)
    residual_mm = 1e3 * points["residual_m"].to_numpy(np.float64)
    step = max(-(-int(used.sum()) // POINTS_SHOWN), 1)
    at = np.flatnonzero(used)[::step]
    angle_deg = np.rad2deg(_unwrapped(angle, used))
    ax.plot(
        angle_deg[~used],
        along[~used],
        ls="none",
        marker=".",
        ms=1.6,
        mew=0,
        color="0.75",
        gid="rejected",
        rasterized=True,
    )
    ax.scatter(
        angle_deg[at],
        along[at],
        c=residual_mm[at],
        cmap=RESIDUAL_MAP,
        norm=norm,
        s=3.0,
        lw=0.0,
        rasterized=True,
        gid="residuals",
    )
    edge = cone.length_m / np.cos(cone.half_angle_rad)
    ax.set_ylim(1.06 * edge, 0.0)
    ax.axhline(edge, color="0.4", lw=0.7, ls="--")
    ax.set_title(
        f"{cone.name}: n = {count(int(used.sum()))}\nmean {residual_mm[used].mean():+.1f}, "
        f"std {residual_mm[used].std():.1f} mm",
        fontsize=7,
    )
    ax.grid()


def _unwrapped(angle_rad: ArrayF, used: ArrayF) -> ArrayF:
    """Angles about their mean direction, so that a patch is not cut at ±180°."""
    middle = np.angle(np.mean(np.exp(1j * angle_rad[used.astype(bool)]))) if used.any() else 0.0
    return np.asarray(middle + (angle_rad - middle + np.pi) % (2 * np.pi) - np.pi)


def _histogram(ax: Axes, residual_mm: ArrayF, limit: float) -> None:
    reach = 2.0 * limit
    edges = np.linspace(-reach, reach, BINS + 1)
    n, _ = np.histogram(residual_mm, edges)
    ax.stairs(n, edges, fill=True, color="0.75", gid="histogram")
    width = float(edges[1] - edges[0])
    x = np.linspace(-reach, reach, 401)
    middle = float(np.median(residual_mm))
    nmad = robust_sigma(residual_mm, middle)
    for name, centre, spread, colour, dashes in (
        ("mean, std", float(residual_mm.mean()), float(residual_mm.std()), VERMILION, "-"),
        ("median, NMAD", middle, nmad, BLUE, "--"),
    ):
        if spread > 0:
            y = residual_mm.size * width * normal.pdf(x, centre, spread)
            label = f"normal, {name}: {centre:+.1f}, {spread:.1f} mm"
            ax.plot(x, y, color=colour, ls=dashes, lw=1.4, label=label)
    beyond = int(np.sum(np.abs(residual_mm) > reach))
    ax.set_title(f"all cones; {count(beyond) if beyond else 'none'} beyond the axis")
    ax.set(xlabel="residual / mm", ylabel=f"points per {width:.2g} mm", xlim=(-reach, reach))
    ax.set_ylim(0, 1.45 * max(float(n.max()), 1.0))
    ax.legend(loc="upper left")


def _by_cone(ax: Axes, used: pd.DataFrame, names: list[str]) -> None:
    """Mean residual of each cone at each position: what a wrong orientation leaves behind."""
    positions = natural(used["position"].astype(str).tolist())
    markers = "os^Dv"
    for k, position in enumerate(positions[:5]):
        part = used[used["position"].astype(str) == position]
        groups = part.groupby(part["cone"].astype(str))["residual_m"]
        mean: pd.Series[float] = 1e3 * groups.mean()
        error: pd.Series[float] = 1e3 * groups.std() / np.sqrt(groups.size())
        at = [i for i, name in enumerate(names) if name in mean.index]
        shift = 0.16 * (k - (min(len(positions), 5) - 1) / 2)
        ax.errorbar(
            np.array(at) + shift,
            [mean[names[i]] for i in at],
            yerr=[2 * error[names[i]] for i in at],
            ls="none",
            marker=markers[k],
            ms=3.0,
            lw=0.8,
            label=position.replace("_", " "),
        )
    ax.axhline(0.0, color="black", lw=0.7)
    ax.set_xticks(range(len(names)), names)
    ax.set_title("mean by cone and position,\nbars: 2 sigma")
    ax.set_ylabel("mean residual / mm")
    if 1 < len(positions) <= 5:
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.42 * (high - low))
        ax.legend(loc="upper left", fontsize=6, ncols=2, columnspacing=0.8, handletextpad=0.3)
    ax.grid(axis="y")


def draw_cone_residuals(*, cone_points: Path, cones: Path, field: Path, twin: bool) -> Figure:
    """Lidar points of the cones with their distances -> figure of the unrolled cones."""
    return cone_residuals(
        read_figure_table(cone_points, CONE_POINTS),
        read_cones(cones, field),
        title="Residuals on the cones",
        twin=twin,
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
    step = max(-(-max(len(part) for part in parts) // POINTS_SHOWN_OF_CONE), 1)
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
    ax.scatter(
        xy[:, 0],
        xy[:, 1],
        c=elapsed,
        cmap=TIME_MAP,
        norm=Normalize(0, span),
        s=2.0,
        lw=0,
        rasterized=True,
        zorder=1,
        gid="side",
    )
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
    ax.scatter(
        xy[:, 0],
        xy[:, 1],
        c=elapsed[far],
        cmap=TIME_MAP,
        norm=Normalize(0, span),
        s=2.0,
        lw=0,
        rasterized=True,
        zorder=2,
        gid="along",
    )
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
        read_figure_table(before, (*CONE_POINTS, "t_gps_s")),
        read_figure_table(after, (*CONE_POINTS, "t_gps_s")),
        read_cones(cones, field),
        title="Lidar points of a cone from the moving boat",
        twin=twin,
    )
