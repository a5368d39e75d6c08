"""A light sheet on a surface: what each sub-beam meets, whether the camera sees it, how bright it is in the
image.

The units of light cancel: `light_to_dn` sets the exposure by a grey panel, as one who operates the camera.

Light of single points is spread on the pixels as a Gaussian that is integrated over them. No finer grid is
needed, so no half pixel can be lost between two grids: pixel i covers i to i + 1, and the share of a point at
x with the standard deviation s is ``Phi((i + 1 - x) / s) - Phi((i - x) / s)``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from thalweg.core import ArrayB, ArrayF, ArrayF32, njit
from thalweg.lightsheet.optics import LightSheet, Sensor
from thalweg_lab.settings import Laser, SheetImage
from thalweg_lab.tank.forward import Seen, WaterBeams, beams_in_water, in_picture, see
from thalweg_lab.tank.grating import Grating
from thalweg_lab.tank.objects import panel
from thalweg_lab.tank.surfaces import GREEN, Posed

_EDGE: Final = 1.6
"""Rays across the sheet reach so many radii; outside lies 0.14 % of its light."""

_FINE_RAD: Final = 1e-6
"""Step of the fan angle for the direction across the sheet."""

_BESIDE_PX: Final = 60.0
"""Sub-beams whose middle falls further beside the picture send nothing into it."""

_WHITE: Final = 0.9
_HALO_PARTS: Final = 5

_REACH: Final = 4.0
"""Sigmas that a point reaches; 1.3e-4 of its light lies outside and is given to what is inside."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GratingLine:
    """One line of a grating, by its number from 0."""

    grating: Grating
    number: int

    @property
    def half_angle_rad(self) -> float:
        """Largest fan angle on either side."""
        return self.grating.half_angle_rad


Fan = LightSheet | GratingLine


@dataclass(frozen=True, slots=True, kw_only=True)
class LinePoints:
    """Points (n) where sub-beams meet a surface.

    ``fan_angle_rad``; ``xyz_lcs_mm`` (n, 3); ``lit``: the sub-beam meets the surface; ``visible``: the
    camera sees the point, within its picture or beside it; ``albedo`` in green; ``laser_mm``: way of the
    laser in the water; ``cosine`` between the normal and the way to the camera; ``along`` (n, 3): the part
    of the sub-beam's direction along the surface. ``seen``: the image of each point.
    """

    fan_angle_rad: ArrayF
    xyz_lcs_mm: ArrayF
    lit: ArrayB
    visible: ArrayB
    albedo: ArrayF
    laser_mm: ArrayF
    cosine: ArrayF
    along: ArrayF
    seen: Seen

    @property
    def xy_px(self) -> ArrayF:
        """(n, 2) pixels, NaN where the sub-beam meets nothing."""
        return self.seen.xy_px


@dataclass(frozen=True, slots=True, kw_only=True)
class Glow:
    """Points of light: ``xy_px`` (n, 2), ``light`` (n,), ``sigma_px`` (n,) of their image."""

    xy_px: ArrayF
    light: ArrayF
    sigma_px: ArrayF


def lines_of(grating: Grating, numbers: Sequence[int] | None = None) -> tuple[GratingLine, ...]:
    """Lines of a grating, all if no numbers are given."""
    wanted = range(len(grating.cosine_offsets)) if numbers is None else numbers
    return tuple(GratingLine(grating=grating, number=k) for k in wanted)


def rays_of(fan: Fan, a_rad: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Origins and unit directions (n, 3) in air, lcs, of sub-beams (n,)."""
    if isinstance(fan, GratingLine):
        return fan.grating.beams(np.full(len(a_rad), fan.number), a_rad)
    return np.broadcast_to(fan.origin_lcs_mm, (len(a_rad), 3)), fan.beams(a_rad)


def line_on(sensor: Sensor, posed: Posed, fan: Fan, a_rad: ArrayF) -> LinePoints:
    """What sub-beams of the fan angles (n,) meet: the exact line, without width."""
    return meet(sensor, posed, a_rad, beams_in_water(*rays_of(fan, a_rad), sensor.window))


def meet(sensor: Sensor, posed: Posed, a_rad: ArrayF, beams: WaterBeams) -> LinePoints:
    """Where rays in the water meet a surface, and which of these points the camera sees."""
    hits = posed.first_hits(beams.start_mm, beams.direction)
    under = sensor.window.depth_mm(np.where(hits.met[:, None], hits.xyz_lcs_mm, 0.0)) > 0
    lit = hits.met & under
    seen = see(sensor, np.where(lit[:, None], hits.xyz_lcs_mm, np.nan))
    cosine = np.einsum("ni,ni->n", hits.normal_lcs, seen.up)
    visible = lit & np.isfinite(seen.xy_px).all(axis=1) & (cosine > 0)
    at = np.flatnonzero(visible)
    visible[at] = ~posed.blocked(hits.xyz_lcs_mm[at], seen.up[at], seen.water_mm[at])
    into = np.einsum("ni,ni->n", hits.normal_lcs, beams.direction)
    return LinePoints(
        fan_angle_rad=a_rad,
        xyz_lcs_mm=np.where(lit[:, None], hits.xyz_lcs_mm, np.nan),
        lit=lit,
        visible=visible,
        albedo=hits.albedo[:, GREEN],
        laser_mm=hits.way_mm,
        cosine=cosine,
        along=beams.direction - into[:, None] * hits.normal_lcs,
        seen=seen,
    )


def fan_angles(sensor: Sensor, fan: Fan, settings: SheetImage) -> ArrayF:
    """Evenly spaced fan angles, dense enough for the image: middles of equal parts of the fan."""
    share = fan.half_angle_rad / np.deg2rad(45.0)
    n = int(np.ceil(settings.beams_per_px * max(sensor.camera.size_px) * share))
    return np.asarray(fan.half_angle_rad * (2.0 * (np.arange(n) + 0.5) / n - 1.0))


def power(a_rad: ArrayF, half_angle_rad: float) -> ArrayF:
    """Light per fan angle (n,), 1 in the middle; a Powell line fades over the outer 4 % of the fan."""
    return np.asarray(np.clip((1.0 - np.abs(a_rad) / half_angle_rad) / 0.04, 0.0, 1.0))


def beam_radius_mm(laser: Laser, n_water: float, beyond_waist_mm: ArrayF) -> ArrayF:
    """Radius (n,) of a Gaussian beam: ``w = w0 sqrt(1 + (s / zR)^2)``, ``zR = pi w0^2 n / wavelength``."""
    rayleigh = np.pi * laser.waist_mm**2 * n_water / (laser.wavelength_nm * 1e-6)
    return np.asarray(laser.waist_mm * np.sqrt(1.0 + (beyond_waist_mm / rayleigh) ** 2))


def on_sheet(sensor: Sensor, fan: Fan, depth_mm: float) -> tuple[ArrayF, float]:
    """Point (3,) of the middle sub-beam at a depth, lcs, and its way in the water."""
    beam = beams_in_water(*rays_of(fan, np.zeros(1)), sensor.window)
    way = depth_mm / -float(beam.direction[0] @ sensor.window.normal_lcs)
    return beam.start_mm[0] + way * beam.direction[0], way


def blur_px(sensor: Sensor, settings: SheetImage, axial_mm: ArrayF) -> ArrayF:
    """Standard deviation (n,) of the image of points at apparent distances along the optical axis.

    A lens of the focal length f and the aperture f / N focused at s0 images a point at s as a disc of the
    diameter ``f / N * f / (s0 - f) * |s - s0| / s``; a disc has the standard deviation of a quarter diameter.
    """
    lens = settings.lens
    if not lens.defocus:
        return np.full(len(axial_mm), lens.sharpness_px)
    focus, _ = on_sheet(sensor, sensor.sheet, lens.focus_depth_mm)
    s0 = float(see(sensor, focus[None]).axial_mm[0])
    disc_mm = (
        lens.focal_mm
        / lens.f_number
        * lens.focal_mm
        / (s0 - lens.focal_mm)
        * np.abs(axial_mm - s0)
        / axial_mm
    )
    return np.hypot(lens.sharpness_px, disc_mm * 1e3 / lens.pixel_um / 4.0)


def glow(sensor: Sensor, posed: Posed, fan: Fan, settings: SheetImage, a_rad: ArrayF | None = None) -> Glow:
    """Light that a sheet of finite width sends from a surface to the camera.

    Each sub-beam is a bundle of parallel rays across the sheet, as wide as the Gaussian beam where the middle
    ray meets the surface. A surface scatters as Lambert: what the aperture gets is proportional to albedo,
    cosine and inverse squared apparent distance.
    """
    a = fan_angles(sensor, fan, settings) if a_rad is None else a_rad
    step = (a[-1] - a[0]) / (len(a) - 1)
    middle = line_on(sensor, posed, fan, a)
    near = ~middle.lit | in_picture(sensor, middle.xy_px, _BESIDE_PX)
    a, way = a[near], middle.laser_mm[near]
    _, waist_mm = on_sheet(sensor, fan, settings.laser.waist_depth_mm)
    # beside a surface the middle ray meets nothing: there the bundle is as wide as at the waist
    radius = beam_radius_mm(
        settings.laser, sensor.window.n_water, np.where(np.isfinite(way), way - waist_mm, 0.0)
    )
    origins, d = rays_of(fan, a)
    across = np.cross(d, rays_of(fan, a + _FINE_RAD)[1] - rays_of(fan, a - _FINE_RAD)[1])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    k = settings.offsets
    u = _EDGE * (2.0 * (np.arange(k) + 0.5) / k - 1.0)
    weight = np.exp(-2.0 * u * u)
    start = origins[:, None] + (radius[:, None] * u)[:, :, None] * across[:, None, :]
    beams = beams_in_water(start.reshape(-1, 3), np.repeat(d, k, axis=0), sensor.window)
    points = meet(sensor, posed, np.repeat(a, k), beams)
    sent = np.repeat(power(a, fan.half_angle_rad) * step, k) * np.tile(weight / weight.sum(), len(a))
    got = sent * points.albedo * points.cosine / points.seen.apparent_mm**2
    got *= np.exp(-settings.water.attenuation_per_m * 1e-3 * (points.laser_mm + points.seen.water_mm))
    visible = points.visible
    out = Glow(
        xy_px=points.xy_px[visible],
        light=got[visible],
        sigma_px=blur_px(sensor, settings, points.seen.axial_mm[visible]),
    )
    return _with_halo(sensor, settings, points, out) if settings.halo_share > 0 else out


def light_to_dn(sensor: Sensor, settings: SheetImage) -> float:
    """Grey values per light: the line on a grey panel at the focused depth peaks at ``chip.peak_dn``."""
    bare = settings.model_copy(update={"halo_share": 0.0})
    fan = sensor.sheet
    at, _ = on_sheet(sensor, fan, settings.lens.focus_depth_mm)
    a = fan_angles(sensor, fan, settings)
    a = a[np.abs(a) < 40.0 / (settings.beams_per_px * max(sensor.camera.size_px))]
    grey = glow(sensor, Posed(surface=panel(), shift_lcs_mm=at), fan, bare, a)
    corner = np.floor(grey.xy_px.min(axis=0)) - 30.0
    size = np.ceil(grey.xy_px.max(axis=0) - corner).astype(int) + 30
    image = np.zeros((int(size[1]), int(size[0])), dtype=np.float32)
    splat(image, grey.xy_px - corner, grey.light, grey.sigma_px)
    return settings.chip.peak_dn / float(image.max())


def splat(image: ArrayF32, xy_px: ArrayF, light: ArrayF, sigma_px: ArrayF) -> None:
    """Add points to an image in place.

    Parameters
    ----------
    image : (h, w); what falls outside is lost.
    xy_px : (n, 2), counted from the upper left corner.
    light : (n,) sum over the pixels of each point.
    sigma_px : (n,) standard deviation of its Gaussian.
    """
    finite = np.isfinite(xy_px).all(axis=1) & np.isfinite(light) & (light > 0)
    _splat(image, np.ascontiguousarray(xy_px[finite]), light[finite], sigma_px[finite], _REACH)


def _with_halo(sensor: Sensor, settings: SheetImage, points: LinePoints, direct: Glow) -> Glow:
    """A share of the light leaves the surface further on, where the laser runs along it."""
    visible = points.visible
    share = settings.halo_share * np.minimum(points.albedo[visible] / _WHITE, 1.0)
    along = points.along[visible]
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    parts = [replace(direct, light=direct.light * (1.0 - share))]
    for k in range(_HALO_PARTS):
        # equal shares of an exponential: the middle quantile of each
        shift = -settings.halo_mm * np.log(1.0 - (k + 0.5) / _HALO_PARTS)
        moved = see(sensor, points.xyz_lcs_mm[visible] + shift * along)
        wider = np.hypot(direct.sigma_px, 0.25 * settings.halo_mm * _px_per_mm(sensor, moved.axial_mm))
        parts.append(Glow(xy_px=moved.xy_px, light=direct.light * share / _HALO_PARTS, sigma_px=wider))
    return Glow(
        xy_px=np.concatenate([p.xy_px for p in parts]),
        light=np.concatenate([p.light for p in parts]),
        sigma_px=np.concatenate([p.sigma_px for p in parts]),
    )


def _px_per_mm(sensor: Sensor, axial_mm: ArrayF) -> ArrayF:
    return np.asarray(sensor.camera.parameters[0] / axial_mm)


@njit(cache=True, nogil=True, error_model="numpy")
def _splat(image: ArrayF32, xy: ArrayF, light: ArrayF, sigma: ArrayF, reach: float) -> None:
    height, width = image.shape
    for n in range(len(xy)):
        x, y, s = xy[n, 0], xy[n, 1], sigma[n]
        if not (x > -reach * s and y > -reach * s and x < width + reach * s and y < height + reach * s):
            continue
        left, right = math.floor(x - reach * s), math.floor(x + reach * s)
        top, bottom = math.floor(y - reach * s), math.floor(y + reach * s)
        nx, ny = int(right - left) + 1, int(bottom - top) + 1
        along, down = np.empty(nx), np.empty(ny)
        scale = 1.0 / (s * math.sqrt(2.0))
        before, total_x = math.erf((left - x) * scale), 0.0
        for i in range(nx):
            after = math.erf((left + i + 1 - x) * scale)
            along[i] = after - before
            total_x += along[i]
            before = after
        before, total_y = math.erf((top - y) * scale), 0.0
        for j in range(ny):
            after = math.erf((top + j + 1 - y) * scale)
            down[j] = after - before
            total_y += down[j]
            before = after
        share = light[n] / (total_x * total_y)
        for j in range(ny):
            row = int(top) + j
            if row < 0 or row >= height:
                continue
            part = share * down[j]
            for i in range(nx):
                column = int(left) + i
                if column >= 0 and column < width:
                    image[row, column] += part * along[i]
