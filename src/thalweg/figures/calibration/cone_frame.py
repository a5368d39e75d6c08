"""Sketch of a cone's own coordinate system (P2 Fig. 3): apex, axis, half angle, a point and its distance."""

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.core.types import ArrayF
from thalweg.figures.calibration.field_views import AROUND, FieldCone, Oblique
from thalweg.figures.style import BLUE, GREEN, HALO, ORANGE, VERMILION, new_figure, styled

HALF_ANGLE_DEG: Final = 25.0
VIEW: Final = Oblique(azimuth_deg=72.0, elevation_deg=18.0)
CONE: Final = FieldCone(
    name="", apex_m=np.array([0.0, 0.0, 0.55]), axis=np.array([0.78, -1.0, 0.2]),
    half_angle_rad=float(np.deg2rad(HALF_ANGLE_DEG)), length_m=1.6, used=True,
)  # fmt: skip
_OFF_M: Final = 0.16
"""How far the drawn point lies off the surface, to show what a residual is."""


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
    ax.text(float(place[0]), float(place[1]), words, color=colour, fontsize=size, ha="center", va="center",
            path_effects=HALO, zorder=7)  # fmt: skip


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
        _arrow(ax, _flat(origin), _flat(origin + 0.45 * np.eye(3)[k]),
               f"${name}_{{pcs}}$", colour="black")  # fmt: skip
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
