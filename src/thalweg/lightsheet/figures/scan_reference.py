"""A scanned object: its picture, its reference, the scan on it, planes of its levels (P4 Fig. 14, 15, 20)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from cmcrameri import cm
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.ndimage import uniform_filter

from thalweg.core.errors import InputError
from thalweg.core.geometry.mesh import TriangleMesh
from thalweg.core.types import AnyArray, ArrayF, ArrayU8
from thalweg.figures.calibration.field_views import Oblique
from thalweg.figures.images.pictures import read_picture
from thalweg.figures.style import HEIGHT_MAP, count, new_figure, plural, styled
from thalweg.lightsheet.figures.mesh_views import mesh_picture
from thalweg.lightsheet.figures.views import DEPTH_LOOKS, axes_cross, need

POINTS: Final = ("file", "x_m", "y_m", "z_m", "distance_mm", "used")
VIEW: Final = Oblique(azimuth_deg=25.0, elevation_deg=32.0)
BRIGHTENING: Final = 0.6
"""Exponent of grey values of the picture."""
LARGEST_NOISE: Final = 0.85
"""Share of the variance of neighbouring pixels that is noise, from which on a picture shows nothing; noise
alone has 0.96."""

_MM_PER_M: Final = 1e3
_BLOCK: Final = 5
_MOST_POINTS: Final = 20_000
_ABOVE_MM: Final = 0.15
"""Points are drawn so far above the mesh, as seen from the viewer's side."""


@styled
def scan_reference(
    photo: ArrayU8,
    extent_mm: tuple[float, float, float, float],
    mesh: TriangleMesh,
    points: pd.DataFrame,
    *,
    levels: Sequence[Mapping[str, Any]] = (),
    title: str = "Scanned object",
    twin: bool = False,
) -> Figure:
    """Orthophoto; reference; scan in the same view; for an object with levels also their planes.

    Parameters
    ----------
    photo : (h, w, 3) or (h, w) orthophoto, see `read_orthophoto`.
    extent_mm : its left, right, lower and upper edge in the frame of the reference.
    mesh : the reference.
    points : columns `POINTS`, in the frame of the reference.
    levels : ``height_mm, measured_mm, rms_own_plane_mm, n`` of each level; empty for other objects.
    title : first words of the title.
    twin : true if the digital twin made the recordings.

    Raises
    ------
    InputError : an empty table, one that lacks columns, or no point on the reference.
    """
    used = need(need(points, POINTS, "points of the scan")[points["used"]], POINTS, "points on the reference")
    head = (
        f"{title}: reference of {count(len(mesh.faces))} faces, n = {count(len(used))} points of "
        f"{plural(int(used['file'].nunique()), 'line')} on it"
    )
    figure = new_figure(164.0 if levels else 118.0, head, twin=twin)
    grid = figure.add_gridspec(2 + bool(levels), 2, height_ratios=[1.0, 1.1, 0.9][: 2 + bool(levels)])
    _photo(figure.add_subplot(grid[0, :]), photo, extent_mm)
    reference, scan = figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1])
    vertices = _MM_PER_M * mesh.vertices_m
    box = vertices.min(axis=0), vertices.max(axis=0)
    for ax, colours in ((reference, HEIGHT_MAP), (scan, "0.92")):
        picture = mesh_picture(vertices, mesh.faces, VIEW, colours=colours, pixels=500)
        picture.show(ax)
        axes_cross(ax, VIEW, np.array([box[0][0], box[0][1] - 12.0, box[0][2]]), 25.0)
        left, right, low, high = picture.extent
        ax.set_xlim(left - 22.0, right + 4.0)
        ax.set_ylim(low - 14.0, high + 4.0)
        ax.axis("off")
    heights = ScalarMappable(Normalize(float(box[0][2]), float(box[1][2])), HEIGHT_MAP)
    figure.colorbar(heights, ax=reference, label="z / mm", location="bottom", aspect=30, pad=0.02, shrink=0.8)
    reference.set_title("b: reference; axes 25 mm long")
    shades = _scan(scan, used)
    figure.colorbar(
        shades, ax=scan, label="number of the line", location="bottom", aspect=30, pad=0.02, shrink=0.8
    )
    scan.set_title("c: points of the scan on the reference")
    if levels:
        _levels(figure.add_subplot(grid[2, :]), used, levels)
    return figure


def _photo(ax: Axes, photo: AnyArray, extent_mm: tuple[float, float, float, float]) -> None:
    bright = np.asarray(photo, dtype=np.float64) / max(float(np.percentile(photo, 99.5)), 1.0)
    ax.imshow(np.clip(bright, 0.0, 1.0) ** BRIGHTENING, extent=extent_mm, gid="photo", aspect="equal",
              cmap="gray" if bright.ndim == 2 else None)  # fmt: skip
    ax.set(xlabel="x / mm", ylabel="y / mm")
    noise = share_of_noise(photo) > LARGEST_NOISE
    ax.set_title("a: orthophoto, noise: no light but the laser's" if noise else "a: orthophoto, brightened")


def share_of_noise(photo: AnyArray) -> float:
    """Share of the variance of grey values that the mean of 5 x 5 pixels takes away, where all are seen."""
    grey = np.asarray(photo, dtype=np.float64)
    grey = grey.mean(axis=2) if grey.ndim == 3 else grey
    inside = uniform_filter((grey > 0).astype(np.float64), _BLOCK) > 1.0 - 1e-9
    raw = float(grey[inside].var()) if inside.any() else 0.0
    return 1.0 - float(uniform_filter(grey, _BLOCK)[inside].var()) / raw if raw > 0 else 1.0


def _scan(ax: Axes, used: pd.DataFrame) -> ScalarMappable:
    """Points that are used, coloured by the number of their line."""
    step = max(1, -(-len(used) // _MOST_POINTS))
    number = 1.0 + pd.factorize(used["file"])[0][::step]
    xyz = _MM_PER_M * used[["x_m", "y_m", "z_m"]].to_numpy(np.float64)[::step] + _ABOVE_MM * VIEW.axes[2]
    shades = ScalarMappable(Normalize(1, max(float(number.max()), 2.0)), cm.batlow)
    flat = VIEW.apply(xyz)[0]
    ax.scatter(flat[:, 0], flat[:, 1], c=shades.to_rgba(number), s=0.7, lw=0, gid="scan", zorder=3,
               rasterized=True)  # fmt: skip
    return shades


def _levels(ax: Axes, used: pd.DataFrame, levels: Sequence[Mapping[str, Any]]) -> None:
    """Distances of points from the planes of the levels, along the object."""
    x, z = (_MM_PER_M * used[name].to_numpy(np.float64) for name in ("x_m", "z_m"))
    off = used["distance_mm"].to_numpy(np.float64)
    stated = np.array([float(level["height_mm"]) for level in levels])
    nearest = np.argmin(np.abs(z[:, None] - stated), axis=1)
    for k, level in enumerate(levels):
        colour, _, marker = DEPTH_LOOKS[k]
        mine = nearest == k
        words = (
            f"{stated[k]:g} mm: {level['measured_mm']:.3f} mm, rms {level['rms_own_plane_mm']:.3f} mm, "
            f"n = {count(int(level['n']))}"
        )
        ax.plot(x[mine], off[mine], ls="none", marker=marker, ms=1.2, mew=0, color=colour, gid=f"level {k}",
                rasterized=True, zorder=2)  # fmt: skip
        ax.plot([], [], ls="none", marker=marker, ms=4, mew=0, color=colour, label=words)
    limit = 1.4 * float(np.quantile(np.abs(off), 0.998)) + 1e-6
    ax.set_ylim(-limit, 2.2 * limit)
    ax.axhline(0.0, color="black", lw=0.7)
    ax.set(xlabel="x / mm", ylabel="distance / mm")
    beyond = int((np.abs(off) > limit).sum())
    ax.set_title(f"d: distance from the planes of the levels, {count(beyond)} points beyond the axis")
    words = "height stated: measured, rms from its own plane"
    ax.legend(loc="upper left", title=words, ncols=2, fontsize=6.5, title_fontsize=6.5)
    ax.grid()


def read_orthophoto(picture: Path, world: Path) -> tuple[ArrayU8, tuple[float, float, float, float]]:
    """Picture, and its left, right, lower and upper edge in millimetres.

    Raises
    ------
    InputError : a file is missing, or the world file holds other numbers than those of a level picture.
    """
    photo = read_picture(picture)
    expected = "a world file: six numbers, the second and the third zero"
    if not world.is_file():
        raise InputError("file not found", expected=expected, where=world)
    try:
        cell_x, turn_y, turn_x, cell_y, x, y = (float(line) for line in world.read_text().split())
    except ValueError as error:
        raise InputError(f"this cannot be read ({error})", expected=expected, where=world) from error
    if turn_x or turn_y:
        raise InputError("a turned picture", expected=expected, where=world)
    rows, columns = photo.shape[:2]
    left, top = x - 0.5 * cell_x, y - 0.5 * cell_y
    edges: ArrayF = _MM_PER_M * np.array([left, left + columns * cell_x, top + rows * cell_y, top])
    return photo, (float(edges[0]), float(edges[1]), float(edges[2]), float(edges[3]))
