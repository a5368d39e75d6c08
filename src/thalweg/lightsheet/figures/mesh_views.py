"""Shaded pictures of triangle meshes in oblique views, with hidden surfaces hidden."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, Normalize, to_rgba

from thalweg.core.errors import GeometryError
from thalweg.core.geometry.raycast import RayCaster
from thalweg.core.types import AnyArray, ArrayF
from thalweg.figures.calibration.field_views import Oblique

LIGHT: Final = np.array([-0.35, 0.45, 0.82])
"""Where the light comes from: to the right, up in the picture, toward the viewer."""

_DARKEST: Final = 0.35
_OVERSAMPLED: Final = 2


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
            self.rgba, extent=self.extent, origin="lower", interpolation="antialiased", zorder=zorder,
            gid=gid, aspect="equal",
        )  # fmt: skip


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
