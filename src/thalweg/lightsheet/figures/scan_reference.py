"""The scanned object: orthophoto, reference, the scan on it (P4 Fig. 14, 15 and 20)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, Normalize, to_rgba
from matplotlib.figure import Figure
from scipy.ndimage import uniform_filter

from thalweg.core import AnyArray, ArrayF, ArrayU8, GeometryError, InputError, read_parquet
from thalweg.core.geometry import RayCaster, TriangleMesh, read_mesh
from thalweg.figures import HEIGHT_MAP, count, new_figure, plural, read_picture, styled, thinned
from thalweg.figures.calibration import Oblique
from thalweg.lightsheet.figures.views import Space, line_numbers, need, pair, spots

LIGHT: Final = np.array([-0.35, 0.45, 0.82])
"""Where the light comes from: to the right, up in the picture, toward the viewer."""
_DARKEST: Final = 0.35
_OVERSAMPLED: Final = 2

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


# ---------------------------------------------------------------- views of a mesh


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshPicture:
    """A drawn mesh.

    ``rgba`` (h, w, 4), transparent where there is nothing; ``extent`` left, right, bottom, top in the plane
    of the view, in the unit of the mesh.
    """

    rgba: ArrayF
    extent: tuple[float, float, float, float]

    @property
    def covered(self) -> float:
        """Share of the picture that shows the mesh."""
        return float((self.rgba[..., 3] > 0).mean())

    def show(self, ax: Axes, *, zorder: float = 1.0, gid: str = "mesh") -> None:
        """Draw it; limits of the axes stay as the caller sets them."""
        ax.imshow(
            self.rgba,
            extent=self.extent,
            origin="lower",
            interpolation="antialiased",
            zorder=zorder,
            gid=gid,
            aspect="equal",
        )


def mesh_picture(
    vertices: ArrayF,
    faces: AnyArray,
    view: Oblique,
    *,
    colours: Colormap | str,
    inside: tuple[ArrayF, ArrayF] | None = None,
    pixels: int = 600,
) -> MeshPicture:
    """Cast parallel rays on a mesh and shade what they meet.

    Parameters
    ----------
    vertices, faces : (n, 3) of any unit, (m, 3).
    view : how it is seen.
    colours : map of heights (z) of the part; or one colour.
    inside : lowest and highest corner (3,) of the part that is shown; None: all. What lies before it hides
        it.
    pixels : of the longer side.

    Raises
    ------
    GeometryError : no vertex.
    """
    if not len(vertices):
        raise GeometryError("no vertex", expected="a mesh", where="picture of a mesh")
    box = inside or (vertices.min(axis=0), vertices.max(axis=0))
    corners = np.array(np.meshgrid(*np.transpose(box))).reshape(3, -1).T
    flat, toward = view.apply(corners)
    low, high = flat.min(axis=0), flat.max(axis=0)
    step = float((high - low).max()) / (pixels * _OVERSAMPLED)
    n_x, n_y = (max(int(n), 1) * _OVERSAMPLED for n in np.ceil((high - low) / step / _OVERSAMPLED))
    x, y = low[0] + step * (np.arange(n_x) + 0.5), low[1] + step * (np.arange(n_y) + 0.5)
    right, up, viewer = view.axes
    # in front of everything, also of what lies outside of the part
    front = max(float(toward.max()), float(view.apply(vertices)[1].max())) + 1.0
    start = x[None, :, None] * right + y[:, None, None] * up + front * viewer
    rays = start.reshape(-1, 3)
    hits = RayCaster(vertices, faces).cast(rays, np.tile(-viewer, (len(rays), 1)))
    met = hits.primitive >= 0
    at = rays - np.where(met, hits.t_hit_m, 0.0)[:, None] * viewer
    margin = 1e-6 * float(np.ptp(corners))
    met &= ((at >= box[0] - margin) & (at <= box[1] + margin)).all(axis=1)
    rgba = _coloured(at[:, 2], hits.normal @ view.axes.T, met, colours, (float(box[0][2]), float(box[1][2])))
    k = _OVERSAMPLED
    blocks = rgba.reshape(n_y // k, k, n_x // k, k, 4)
    alpha = blocks[..., 3].mean(axis=(1, 3))
    mean = (blocks[..., :3] * blocks[..., 3:]).mean(axis=(1, 3)) / np.maximum(alpha, 1e-9)[..., None]
    extent = (float(low[0]), float(low[0] + step * n_x), float(low[1]), float(low[1] + step * n_y))
    return MeshPicture(rgba=np.concatenate([mean, alpha[..., None]], axis=2), extent=extent)


def _coloured(
    height: ArrayF, normal: ArrayF, met: AnyArray, colours: Colormap | str, limits: tuple[float, float]
) -> ArrayF:
    """Colours (n, 4) of hits: by height or one for all, darker where the surface is turned from the light.

    ``normal`` (n, 3) in the axes of the view; a face shows the same from both sides.
    """
    if isinstance(colours, str):
        rgba = np.tile(to_rgba(colours), (len(height), 1))
    else:
        rgba = np.array(colours(Normalize(*limits)(height)))
    facing = np.where(normal[:, 2:] < 0, -normal, normal)
    shine = np.clip(facing @ (LIGHT / np.linalg.norm(LIGHT)), 0.0, 1.0)
    rgba[:, :3] *= (_DARKEST + (1.0 - _DARKEST) * shine)[:, None]
    rgba[:, 3] = met
    return np.asarray(rgba, dtype=np.float64)


# ---------------------------------------------------------------- the object and its levels


@styled
def scan_reference(
    photo: ArrayU8,
    extent_mm: tuple[float, float, float, float],
    mesh: TriangleMesh,
    points: pd.DataFrame,
    *,
    title: str = "Scanned object",
) -> Figure:
    """Orthophoto; reference; scan in the same view.

    Parameters
    ----------
    photo : (h, w, 3) or (h, w) orthophoto, see `read_orthophoto`.
    extent_mm : its left, right, lower and upper edge in the frame of the reference.
    mesh : the reference.
    points : columns `POINTS`, in the frame of the reference.
    title : first words of the title.

    Raises
    ------
    InputError : an empty table, one that lacks columns, or no point on the reference.
    """
    used = need(need(points, POINTS, "points of the scan")[points["used"]], POINTS, "points on the reference")
    head = (
        f"{title}: reference of {count(len(mesh.faces))} faces, n = {count(len(used))} points of "
        f"{plural(used['file'].nunique(), 'line')} on it"
    )
    figure = new_figure(118.0, head)
    grid = figure.add_gridspec(2, 2, height_ratios=[1.0, 1.1])
    _photo(figure.add_subplot(grid[0, :]), photo, extent_mm)
    reference, scan = figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1])
    vertices = _MM_PER_M * mesh.vertices_m
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    for ax, colours in ((reference, HEIGHT_MAP), (scan, "0.92")):
        picture = mesh_picture(vertices, mesh.faces, VIEW, colours=colours, pixels=500)
        picture.show(ax)
        Space(ax, VIEW).cross(np.array([low[0], low[1] - 12.0, low[2]]), 25.0)
        left, right, bottom, top = picture.extent
        ax.set_xlim(left - 22.0, right + 4.0)
        ax.set_ylim(bottom - 14.0, top + 4.0)
        ax.axis("off")
    heights = ScalarMappable(Normalize(float(low[2]), float(high[2])), HEIGHT_MAP)
    shown = thinned(used, _MOST_POINTS)
    number, shades = line_numbers(shown["file"])
    xyz = _MM_PER_M * shown[["x_m", "y_m", "z_m"]].to_numpy() + _ABOVE_MM * VIEW.axes[2]
    spots(scan, *pair(VIEW.apply(xyz)[0].T), shades.to_rgba(number), s=0.7, zorder=3)
    for ax, colour, words in ((reference, heights, "z / mm"), (scan, shades, "number of the line")):
        figure.colorbar(colour, ax=ax, label=words, location="bottom", aspect=30, pad=0.02, shrink=0.8)
    reference.set_title("b: reference; axes 25 mm long")
    scan.set_title("c: points of the scan on the reference")
    return figure


def _photo(ax: Axes, photo: AnyArray, extent_mm: tuple[float, float, float, float]) -> None:
    bright = np.asarray(photo, dtype=np.float64) / max(float(np.percentile(photo, 99.5)), 1.0)
    ax.imshow(
        np.clip(bright, 0.0, 1.0) ** BRIGHTENING,
        extent=extent_mm,
        aspect="equal",
        cmap="gray" if bright.ndim == 2 else None,
    )
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


def draw_scan_reference(
    *, picture: Path, world: Path, reference: list[Path], distances: Path, scan: str, title: str
) -> Figure:
    """Orthophoto, reference and distances of a scan -> figure of the object."""
    photo, extent_mm = read_orthophoto(picture, world)
    return scan_reference(
        photo,
        extent_mm,
        read_mesh(reference[0])[0],
        read_parquet(distances),
        title=f"{title}, {scan.replace('_', ' ')}",
    )
