"""Views of a calibration field: oblique parallel projection, cones as shaded bodies, cones unrolled."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
from cmcrameri import cm
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Colormap, Normalize

from thalweg.core.types import ArrayF
from thalweg.figures.calibration.tables import natural
from thalweg.figures.style import BLUE, GREEN, GREY, HALO, ORANGE, PURPLE, SKY, VERMILION

AROUND: Final = 48
ALONG: Final = 12
"""Facets of a cone."""

CONE_COLOURS: Final = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, "black", "0.55")
CONE_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "*")

RESIDUAL_MAP: Final[Colormap] = cm.vik
"""Blue inside a cone, brown outside; white is no residual."""

_LIGHT: Final = np.array([0.35, -0.45, 0.82])


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
        list(np.concatenate(corners)[order]), facecolors=rgba[order], edgecolors=rgba[order], linewidths=0.2,
        zorder=3, gid="cones", rasterized=True,
    )  # fmt: skip
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
            cone.name, (float(xy[:, 0].mean()), float(top[1])), xytext=(0, dy_points),
            textcoords="offset points", ha="center", va="center", fontsize=7, path_effects=HALO, zorder=8,
            gid="cone-name",
        )  # fmt: skip


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
