"""Light beside the line: the scene in daylight, and the sheet's own glow in turbid water."""

from typing import Final

import cv2
import numpy as np

from thalweg.core.types import AnyArray, ArrayF, ArrayF32
from thalweg.lightsheet.optics.sensor import Sensor
from thalweg.settings.twin.light_sheet import SheetImage
from thalweg_lab.tank.fans import Fan, rays_of
from thalweg_lab.tank.forward import beams_in_water, camera_rays, see
from thalweg_lab.tank.glow import power
from thalweg_lab.tank.splat import splat
from thalweg_lab.tank.surfaces import Posed

_NODES: Final = 64
"""Rays of sight are computed for so many cells a side and interpolated between: 0.03 px off in 2048 px."""

_SKYLIGHT: Final = 0.35
"""Light on an upright face as a share of that on a level one."""

_COARSE: Final = 2
"""The glow of the water is computed on blocks of so many pixels a side: its edge at the line stays sharp."""

_SPACING_PX: Final = 2.5
_VEIL_SIGMA: Final = 1.6
_DEEPEST_MM: Final = 400.0


def stride_of(sensor: Sensor, settings: SheetImage) -> int:
    """Side of the blocks of pixels that share one ray of daylight."""
    return settings.ambient_stride or max(1, int(np.ceil(max(sensor.camera.size_px) / 512)))


def daylight(sensor: Sensor, posed: Posed, settings: SheetImage) -> ArrayF32:
    """The scene in daylight, (h, w, 3) red, green, blue; 1 is a white level surface."""
    width, height = sensor.camera.size_px
    stride = stride_of(sensor, settings)
    columns, rows = int(np.ceil(width / stride)), int(np.ceil(height / stride))
    start, direction = _rays(sensor, columns, rows, stride)
    surface = posed.surface
    origins, directions = posed.to_object(start), direction @ posed.R_lcs_obj
    hits = surface.caster.cast(origins, directions)
    met = np.flatnonzero(hits.primitive >= 0)
    face = hits.primitive[met]
    light = np.zeros((rows * columns, 3), dtype=np.float32)
    points = origins[met] + directions[met] * hits.t_hit_m[met, None]
    upright = np.abs(surface.normals[face] @ posed.R_lcs_obj[2])
    light[met] = surface.albedo(points, face) * (_SKYLIGHT + (1.0 - _SKYLIGHT) * upright)[:, None]
    image = light.reshape(rows, columns, 3)
    if stride == 1:
        return image
    large = cv2.resize(image, (columns * stride, rows * stride), interpolation=cv2.INTER_LINEAR)
    return np.asarray(large[:height, :width], dtype=np.float32)


def veil(sensor: Sensor, posed: Posed, fan: Fan, settings: SheetImage) -> ArrayF32:
    """Light (h, w) that the water in the sheet scatters to the camera, in the unit of `glow`.

    Single scattering, the same in all directions, from the window down to the surface.
    """
    width, height = sensor.camera.size_px
    n = int(np.ceil(max(width, height) / _SPACING_PX))
    a = fan.half_angle_rad * (2.0 * (np.arange(n) + 0.5) / n - 1.0)
    beams = beams_in_water(*rays_of(fan, a), sensor.window)
    hits = posed.first_hits(beams.start_mm, beams.direction)
    reach = np.where(hits.met, hits.way_mm, _DEEPEST_MM)
    part = (np.arange(n) + 0.5) / n
    way = reach[:, None] * part
    points = beams.start_mm[:, None] + way[:, :, None] * beams.direction[:, None]
    seen = see(sensor, points.reshape(-1, 3))
    step = 2.0 * fan.half_angle_rad / n
    scattered = settings.water.scatter_per_m * 1e-3 * (reach / n)[:, None]
    light = (power(settings.laser, a, fan.half_angle_rad) * step)[:, None] * scattered * np.ones_like(way)
    loss = np.exp(-settings.water.attenuation_per_m * 1e-3 * (way.ravel() + seen.water_mm))
    small = np.zeros((height // _COARSE + 1, width // _COARSE + 1), dtype=np.float32)
    light = light.ravel() * loss / seen.apparent_mm**2
    splat(small, seen.xy_px / _COARSE, light, np.full(way.size, _VEIL_SIGMA))
    size = (small.shape[1] * _COARSE, small.shape[0] * _COARSE)
    large = cv2.resize(small, size, interpolation=cv2.INTER_LINEAR)
    # a coarse pixel holds the light of all its fine ones
    return np.asarray(large[:height, :width] / _COARSE**2, dtype=np.float32)


def _rays(sensor: Sensor, columns: int, rows: int, stride: int) -> tuple[ArrayF, ArrayF]:
    """Start and unit direction (rows * columns, 3) in the water, lcs, of the middles of blocks."""
    x = np.asarray((np.arange(columns) + 0.5) * stride)
    y = np.asarray((np.arange(rows) + 0.5) * stride)
    node_x = np.linspace(0.0, columns * stride, min(_NODES, columns) + 1)
    node_y = np.linspace(0.0, rows * stride, min(_NODES, rows) + 1)
    X, Y = np.meshgrid(node_x, node_y)
    beams = camera_rays(sensor, np.stack([X.ravel(), Y.ravel()], axis=1))
    both = np.concatenate([beams.start_mm, beams.direction], axis=1).reshape(len(node_y), len(node_x), 6)
    wx, wy = _weights(x, node_x), _weights(y, node_y)
    across = np.einsum("xk,nkc->nxc", wx, both, optimize=True)
    full = np.tensordot(wy, across, axes=(1, 0)).reshape(-1, 6)
    return full[:, :3], full[:, 3:] / np.linalg.norm(full[:, 3:], axis=1, keepdims=True)


def _weights(at: ArrayF, nodes: AnyArray) -> ArrayF:
    """Weights (n, k) of linear interpolation."""
    left = np.clip(np.searchsorted(nodes, at) - 1, 0, len(nodes) - 2)
    share = (at - nodes[left]) / (nodes[left + 1] - nodes[left])
    out = np.zeros((len(at), len(nodes)))
    out[np.arange(len(at)), left] = 1.0 - share
    out[np.arange(len(at)), left + 1] = share
    return out
