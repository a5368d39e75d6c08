"""What the camera sees of its own boat: a float whose bow reaches into the lower edge of the images.

The catamaran of `thalweg_lab.river.hull` itself lies below the field of view of a camera on its mast. The
float beside it keeps such a small boat upright, and it is what masks have to find. It moves with the camera,
so its pixels are the same in all images; only its light changes.
"""

from collections.abc import Mapping
from typing import Any, Final, Self

import cv2
import numpy as np

from thalweg.core.geometry.raycast import RayCaster
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayB, ArrayF, ArrayF32, ArrayI
from thalweg_lab.river.mesh import tube_faces, tubes
from thalweg_lab.river_images.daylight import Sun
from thalweg_lab.yard.boat_look import boat_mesh, sensor_mesh
from thalweg_lab.yard_images.lens_rays import LensRays

_AWAY_M: Final = 0.65
"""Distance of the float's axis from the camera."""

_TOP: Final = 0.72
"""Where the top of the float is seen, as a share of the way from the middle of the image down."""

_BOW: Final = 0.62
"""Where its bow is seen, as a share of the way from the middle of the image to the edge at the bow's side."""

_RADIUS_M: Final = 0.075
_BEHIND_M: Final = 1.1
_SIDES: Final = 24
_PARTS: Final = 4
_DISC_BELOW_M: Final = 0.06
_WHITE: Final = np.array([0.62, 0.60, 0.52])
_BAND: Final = np.array([0.55, 0.16, 0.05])


class OwnBoat:
    """The boat's image in one camera.

    Parameters
    ----------
    share : (h, w) part of each pixel that the boat covers.
    albedo : (h, w, 3) mean colour of that part.
    normal_ics : (h, w, 3) mean normal, toward the camera.
    """

    def __init__(self, share: ArrayF32, albedo: ArrayF32, normal_ics: ArrayF32) -> None:
        self.share, self.albedo, self.normal_ics = share, albedo, normal_ics
        self.full: ArrayB = share >= 1.0
        """(h, w) pixels that show nothing else."""

    @classmethod
    def seen(cls, lens: LensRays, mounts: Mapping[str, Any], T_ics_ccs: Rigid, *, waterline_m: float) -> Self:
        """The boat in a camera.

        Parameters
        ----------
        lens : ray of each pixel.
        mounts : true mounts; with antenna and lidar the boat carries them.
        T_ics_ccs : mount of the camera.
        waterline_m : height of the ics origin above the water.
        """
        vertices, triangles, n_float, axis = _mesh(lens, mounts, T_ics_ccs, waterline_m)
        caster = RayCaster(vertices, triangles)
        h, w, _ = lens.rays_ccs.shape
        rough = caster.cast(T_ics_ccs.shift_m, _in_ics(lens.rays_ccs.reshape(-1, 3), T_ics_ccs))
        met = np.isfinite(rough.t_hit_m).reshape(h, w).astype(np.uint8)
        some = np.flatnonzero(cv2.dilate(met, np.ones((5, 5), np.uint8)).ravel())
        share = np.zeros(h * w, dtype=np.float32)
        albedo, normal = np.zeros((h * w, 3), dtype=np.float32), np.zeros((h * w, 3), dtype=np.float32)
        if len(some):
            share[some], albedo[some], normal[some] = _averaged(caster, lens, some, T_ics_ccs, n_float, axis)
        share[~np.isfinite(lens.rays_ccs[..., 0].ravel())] = 1.0
        return cls(share.reshape(h, w), albedo.reshape(h, w, 3), normal.reshape(h, w, 3))

    def over(self, light: ArrayF32, R_wcs_ics: ArrayF, sun: Sun, sky: ArrayF) -> ArrayF32:
        """An image (h, w, 3) with the boat before it, in the sun and under a sky of a mean light (3,)."""
        out = light.copy()
        some = np.flatnonzero(self.share.ravel() > 0)
        normal = self.normal_ics.reshape(-1, 3)[some] @ R_wcs_ics.T.astype(np.float32)
        facing = np.maximum(normal @ sun.direction_wcs.astype(np.float32), 0)[:, None]
        around = (0.55 + 0.45 * normal[:, 2:]) * sky.astype(np.float32)
        own = self.albedo.reshape(-1, 3)[some] * (facing * sun.colour.astype(np.float32) + around)
        share = self.share.ravel()[some][:, None]
        flat = out.reshape(-1, 3)
        flat[some] = flat[some] * (1 - share) + own * share
        return out


def _in_ics(rays_ccs: ArrayF32, T_ics_ccs: Rigid) -> ArrayF32:
    return np.asarray(rays_ccs @ T_ics_ccs.R.T.astype(np.float32))


def _mesh(
    lens: LensRays, mounts: Mapping[str, Any], T_ics_ccs: Rigid, waterline_m: float
) -> tuple[ArrayF, ArrayI, int, ArrayF]:
    """Boat in ics; the first triangles, whose number is given, are the float about an axis (k, 3)."""
    points, faces, axis = _float(lens, T_ics_ccs, waterline_m)
    parts = [(points, faces)]
    if "antenna" in mounts:
        antenna = np.asarray(mounts["antenna"]["lever_ics_m"], dtype=np.float64)
        parts.append(boat_mesh(antenna, disc_below_m=_DISC_BELOW_M, waterline_m=waterline_m))
        if "lidar" in mounts:
            lidar = np.asarray(mounts["lidar"]["lever_ics_m"], dtype=np.float64)
            parts.append(sensor_mesh(antenna, lidar, None, waterline_m=waterline_m))
    first = np.cumsum([0] + [len(p) for p, _ in parts])
    triangles = np.concatenate([f + k for (_, f), k in zip(parts, first[:-1], strict=True)])
    return np.concatenate([p for p, _ in parts]), triangles, len(faces), axis


def _float(lens: LensRays, T_ics_ccs: Rigid, waterline_m: float) -> tuple[ArrayF, ArrayI, ArrayF]:
    """A round float along x with two pointed ends, beside the boat where the camera looks; and its axis."""
    view = T_ics_ccs.R[:, 2]
    side = 1.0 if view[1] >= 0 else -1.0
    camera = lens.camera
    w, h = camera.size_px
    middle = camera.rays([[w / 2, h / 2]])[0]
    below = camera.rays([[w / 2, h / 2 + _TOP * h / 2]])[0]
    down = np.arccos(np.clip(np.dot(middle, below), -1.0, 1.0))
    # The bow lies to the right of a camera that looks to port, to the left of one that looks to starboard.
    ahead = np.sign(T_ics_ccs.R[0, 0]) or 1.0
    edge = camera.rays([[w / 2 + ahead * _BOW * w / 2, h / 2]])[0]
    across = np.arccos(np.clip(np.dot(middle, edge), -1.0, 1.0))
    x, y, z = T_ics_ccs.shift_m
    top = min(z + _AWAY_M * np.tan(min(down, 1.2)), waterline_m - 0.03)
    bow = x + _AWAY_M * np.tan(min(across, 1.2))
    at = np.array([bow, bow - 0.03, bow - 0.12, bow - 0.28, bow - _BEHIND_M, bow - _BEHIND_M - 0.3])
    girth = _RADIUS_M * np.array([0.05, 0.35, 0.78, 1.0, 1.0, 0.1])
    axis = np.stack([at, np.full(6, y + side * _AWAY_M), top + girth * 0 + _RADIUS_M], axis=1)
    # The bow is drawn up.
    axis[:3, 2] -= _RADIUS_M * np.array([0.55, 0.40, 0.12])
    return tubes(axis[None], girth[None], _SIDES)[0], tube_faces(_SIDES, 6), axis


def _averaged(
    caster: RayCaster, lens: LensRays, pixels: ArrayI, T_ics_ccs: Rigid, n_float: int, axis: ArrayF
) -> tuple[ArrayF32, ArrayF32, ArrayF32]:
    """Covered share (n,), mean colour (n, 3) and mean normal (n, 3) of pixels from 4 x 4 rays."""
    w = lens.rays_ccs.shape[1]
    y, x = np.divmod(pixels, w)
    off = (np.arange(_PARTS) + 0.5) / _PARTS
    a, b = (o.ravel() for o in np.meshgrid(off, off))
    xy = np.stack([(x[:, None] + a).ravel(), (y[:, None] + b).ravel()], axis=1)
    rays = lens.camera.rays(xy).astype(np.float32)
    hits = caster.cast(T_ics_ccs.shift_m, _in_ics(rays, T_ics_ccs))
    met = np.isfinite(hits.t_hit_m)
    point = T_ics_ccs.shift_m + np.where(met, hits.t_hit_m, 0.0)[:, None] * _in_ics(rays, T_ics_ccs)
    normal = np.where((hits.primitive < n_float)[:, None], _round(point, axis), hits.normal)
    normal[np.sum(normal * _in_ics(rays, T_ics_ccs), axis=1) > 0] *= -1.0
    # A band around the float, seams and stains: pattern that a search for features takes for a thing.
    phase = np.mod(point[:, 0], 0.30)
    colour = np.where((phase < 0.05)[:, None], _BAND, _WHITE)
    stain = np.sin(61.0 * point[:, 0] + 23.0 * point[:, 2]) * np.sin(47.0 * point[:, 1] - 39.0 * point[:, 0])
    colour = colour * (1.0 - 0.18 * np.clip(3.0 * stain - 1.5, 0.0, 1.0))[:, None]
    colour = np.where((hits.primitive < n_float)[:, None], colour, 0.35)
    weight = met.astype(np.float64).reshape(len(pixels), -1)
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1.0)
    mean = [(weight[..., None] * v.reshape(len(pixels), -1, 3)).sum(axis=1) / total for v in (colour, normal)]
    mean[1] /= np.maximum(np.linalg.norm(mean[1], axis=1, keepdims=True), 1e-9)
    return weight.mean(axis=1).astype(np.float32), mean[0].astype(np.float32), mean[1].astype(np.float32)


def _round(point: ArrayF, axis: ArrayF) -> ArrayF:
    """Normals (n, 3) across the axis (k, 3): a tube without facets."""
    along = np.clip(point[:, 0], axis[-1, 0], axis[0, 0])
    y, z = (np.interp(along, axis[::-1, 0], axis[::-1, i]) for i in (1, 2))
    out = np.stack([np.zeros(len(point)), point[:, 1] - y, point[:, 2] - z], axis=1)
    return np.asarray(out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9))
