"""Sketch of the coordinate system of a cone (P2 Fig. 3)."""

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.core import ArrayF
from thalweg.figures import BLUE, GREEN, HALO, ORANGE, VERMILION, new_figure, styled

HALF_ANGLE_DEG: Final = 25.0
LENGTH_M: Final = 1.6
_OFF_M: Final = 0.16
"""How far the drawn point lies off the surface, to show what a residual is."""


@styled
def cone_frame() -> Figure:
    """Sketch of a cone's coordinate system, in the plane of its axis and a point."""
    figure = new_figure(84.0, "A cone and its coordinate system (no data)")
    ax, alpha, length = figure.subplots(), np.deg2rad(HALF_ANGLE_DEG), LENGTH_M
    edge = length * np.tan(alpha)
    ax.fill([0, length, length], [0, edge, -edge], facecolor="0.93", edgecolor="none", zorder=1)
    ax.plot([length, 0, length], [edge, 0, -edge], color="0.35", lw=1.2, zorder=2)
    _arrow(ax, np.array([0.0, 0.0]), np.array([1.95, 0.0]), "$z_{cocs}$", colour=BLUE, away=0.14)
    _arrow(ax, np.array([0.0, 0.0]), np.array([0.0, 0.95]), "$\\rho=\\sqrt{x^2+y^2}$", colour=BLUE, away=0.09)
    arc = np.linspace(0, alpha, 48)
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


def _words(ax: Axes, place: ArrayF, words: str, *, colour: str = "black") -> None:
    ax.text(
        float(place[0]),
        float(place[1]),
        words,
        color=colour,
        fontsize=9.0,
        ha="center",
        va="center",
        path_effects=HALO,
        zorder=7,
    )
