"""A laser that projects n lines through a grating, as physics has it and no calibration model does.

A line generator spreads the beam to a fan in the plane y = 0. Behind it stands a grating whose normal leans
out of the fan's axis. In the frame of the grating the tangential part of a direction grows by the order
times wavelength over period (grating equation, Born & Wolf 1999, sec. 8.6)::

    t_out = t_in + j (lambda / Lambda) g,      g = direction across the grooves

so that the line of the order j is no plane, and no exact cone about an axis of the laser either. The element
does not hit this exactly: every line has its own error of spacing and of rotation, and a bow. The light
leaves through a plane cover, behind which a ray of the direction d seems to come from::

    T d_xy (1 / sqrt(n^2 - d_xy^2) - 1 / |d_z|)      in the plane of the true origin

which is a caustic: neither is there a joint centre, nor does an origin stay the same along its line. A
displaced aperture adds an own offset of each line.

**The way of its light.** A sub-beam is followed layer by layer by the angle in each, Snell's law in its
schoolbook form: in each layer it runs aside by the thickness times the tangent of its angle, always in its
own vertical plane::

    sin(w_2) = n_1 sin(w_1) / n_2,      r = h tan(w_air) + t tan(w_glass) + D tan(w_water)

Points are seen by the solution of `thalweg_lab.tank.forward`. The processing of lines
(`thalweg_lab.multi_line`) has a closed form by the slowness along the faces for both, and no
function of refraction is common to the two sides.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from thalweg.core import ArrayB, ArrayF, ArrayI, rotation_opk
from thalweg.lightsheet.optics import Sensor, Window
from thalweg_lab.multi_line import LevelPoints
from thalweg_lab.random_numbers import generator
from thalweg_lab.tank.forward import see


@dataclass(frozen=True, slots=True, kw_only=True)
class GratingErrors:
    """What a manufacturer does not promise.

    Parameters
    ----------
    tilt_deg : (2,) of the grating's normal about the x and the y axis of the laser.
    grooves_deg : rotation of the grooves about the axis.
    cover_mm, cover_index : plate in front of the element.
    sigma_spacing_deg : random error of each line across.
    sigma_rotation_deg : random rotation of each line about the axis.
    sigma_origin_mm : (3,) random offset of the origin of each line.
    sigma_bow : random curvature of each line, direction cosine per squared direction cosine.
    irregular : designed irregularity of the spacing: each step lies uniformly within plus or minus this
        share.
    """

    tilt_deg: tuple[float, float] = (3.0, 2.0)
    grooves_deg: float = 0.5
    cover_mm: float = 2.0
    cover_index: float = 1.52
    sigma_spacing_deg: float = 0.03
    sigma_rotation_deg: float = 0.01
    sigma_origin_mm: tuple[float, float, float] = (0.10, 0.05, 0.05)
    sigma_bow: float = 5e-4
    irregular: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Grating:
    """Truth of a multi-line laser.

    Parameters
    ----------
    origin_lcs_mm, angles_rad : (3,) of the line generator.
    half_angle_rad : of the fan.
    cosine_offsets : (n,) direction cosines that the grating adds across, with all errors of spacing.
    rotations, bows : (n,) linear and quadratic change across with the direction cosine along the line.
    offsets_mm : (n, 3) of the origins, in the frame of the laser.
    errors : what is common to all lines.
    """

    origin_lcs_mm: ArrayF
    angles_rad: ArrayF
    half_angle_rad: float
    cosine_offsets: ArrayF
    rotations: ArrayF
    bows: ArrayF
    offsets_mm: ArrayF
    errors: GratingErrors

    def beams(self, line: ArrayI, a_rad: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Origins and unit directions (n, 3) in lcs of the sub-beams ``a_rad`` (n,) of lines (n,)."""
        tilt = rotation_opk(*np.deg2rad([*self.errors.tilt_deg, 0.0]))
        ray = np.stack([np.sin(a_rad), np.zeros_like(a_rad), -np.cos(a_rad)], axis=1) @ tilt
        groove = np.deg2rad(self.errors.grooves_deg)
        u = ray[:, 0].copy()
        ray[:, 0] += self.cosine_offsets[line] * np.sin(groove)
        ray[:, 1] += self.cosine_offsets[line] * np.cos(groove)
        ray[:, 1] += self.rotations[line] * u + self.bows[line] * u * u
        ray[:, 2] = -np.sqrt(1.0 - np.square(ray[:, :2]).sum(axis=1))
        local = ray @ tilt.T
        flat = np.square(local[:, :2]).sum(axis=1)
        shift = self.errors.cover_mm * (
            1.0 / np.sqrt(self.errors.cover_index**2 - flat) - 1.0 / np.abs(local[:, 2])
        )
        start = self.offsets_mm[line].copy()
        start[:, :2] += local[:, :2] * shift[:, None]
        R = rotation_opk(*(float(angle) for angle in self.angles_rad))
        return self.origin_lcs_mm + start @ R.T, local @ R.T


@dataclass(frozen=True, slots=True, kw_only=True)
class SubBeams:
    """Rays in the water in the frame of the window: the place is ``start_mm + slope * depth``.

    ``start_mm`` (n, 2) on the outer face; ``slope`` (n, 2) mm for each mm of depth; NaN for rays that never
    get into the water.
    """

    start_mm: ArrayF
    slope: ArrayF

    def at_depth(self, depth_mm: ArrayF, window: Window) -> ArrayF:
        """Points (n, 3) in lcs at depths (n,) below the outer face."""
        xy = self.start_mm + self.slope * depth_mm[:, None]
        local = np.column_stack([xy, -depth_mm - window.thickness_mm])
        return np.asarray(local @ window.R_lcs_window.T)


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenPoints:
    """Points (n) in the image.

    ``xy_px`` (n, 2), NaN without an image; ``inside`` (n,) the picture; ``slope`` (n, 2) change of x and y of
    the camera's ray for each mm of depth, in the frame of the window.
    """

    xy_px: ArrayF
    inside: ArrayB
    slope: ArrayF


def make_grating(sensor: Sensor, seed: int, *, errors: GratingErrors | None = None) -> Grating:
    """A grating in the place of the sensor's laser; T 4.2 has 15 lines, 1.7 degrees apart, 28.2 wide."""
    errors = GratingErrors() if errors is None else errors

    def white(name: str, *shape: int) -> ArrayF:
        """Normal numbers of a stream of their own."""
        return generator(seed, f"grating_{name}").standard_normal(shape)

    n = 15
    design = generator(seed, "grating_irregular").uniform(-1.0, 1.0, n - 1)
    places = np.concatenate([[0.0], np.cumsum(1.0 + errors.irregular * design)])
    # the opening of the whole stays, so that designs are compared on the same width
    places *= np.sin(np.deg2rad(1.7)) * (n - 1) / places[-1]
    places -= places[-1] / 2
    return Grating(
        origin_lcs_mm=sensor.sheet.origin_lcs_mm,
        angles_rad=sensor.sheet.angles_rad,
        half_angle_rad=float(np.deg2rad(28.2 / 2)),
        cosine_offsets=places + np.deg2rad(errors.sigma_spacing_deg) * white("spacing", n),
        rotations=np.deg2rad(errors.sigma_rotation_deg) * white("rotation", n),
        bows=errors.sigma_bow * white("bow", n),
        offsets_mm=np.asarray(errors.sigma_origin_mm) * white("origin", n, 3),
        errors=errors,
    )


def image_of_level(
    sensor: Sensor, grating: Grating, line: ArrayI, a_rad: ArrayF, depth_mm: ArrayF
) -> tuple[ArrayF, ArrayF]:
    """Pixels (n, 2) of sub-beams on levels, NaN outside of the picture; directions (n,) across the line."""

    def image(a: ArrayF) -> ArrayF:
        """Pixels of points of the line at angles of the fan."""
        beams = sub_beams(*grating.beams(line, a), sensor.window)
        return seen_points(sensor, beams.at_depth(depth_mm, sensor.window)).xy_px

    xy = image(a_rad)
    along = image(a_rad + 1e-5) - image(a_rad - 1e-5)
    xy[np.logical_not(sensor.camera.inside(xy))] = np.nan
    return xy, np.arctan2(along[:, 0], -along[:, 1])


def calibration_points(
    sensor: Sensor,
    grating: Grating,
    levels_mm: tuple[float, ...],
    seed: int,
    *,
    points_per_line: int = 60,
    pairs_per_line: int = 6,
    sigma_px: float = 0.3,
    paired_lines: tuple[int, ...] | None = None,
    name: str = "calibration",
) -> LevelPoints:
    """Line points on levels, with pairs between each two levels.

    Parameters
    ----------
    levels_mm : depths below the window.
    paired_lines : lines that show gaps and segments; all if None. Other lines are seen on the first level
        only, as on the pattern of T 4.2.1.
    name : of the streams of random numbers.
    """
    n = len(grating.cosine_offsets)
    both = tuple(range(n)) if paired_lines is None else paired_lines
    fan = 0.97 * grating.half_angle_rad
    along_line = np.linspace(-fan, fan, points_per_line)
    marks = np.linspace(-0.8 * fan, 0.8 * fan, pairs_per_line)
    # line, depth, sub-beams, role: 0 point of the line, 1 upper and 2 lower end of a pair
    parts = [
        (j, depth, along_line, 0)
        for level, depth in enumerate(levels_mm)
        for j in (range(n) if level == 0 else both)
    ]
    for upper, lower in combinations(levels_mm, 2) if pairs_per_line else ():
        for j in both:
            parts += [(j, upper, marks, 1), (j, lower, marks, 2)]
    line = np.concatenate([np.full(len(a), j) for j, _, a, _ in parts])
    depths = np.concatenate([np.full(len(a), depth) for _, depth, a, _ in parts])
    role = np.concatenate([np.full(len(a), r) for _, _, a, r in parts])
    xy, angle = image_of_level(sensor, grating, line, np.concatenate([a for _, _, a, _ in parts]), depths)
    across = generator(seed, f"{name}_across").standard_normal(len(line)) * sigma_px
    along = generator(seed, f"{name}_along").standard_normal(len(line)) * (role > 0)
    u = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    xy = xy + across[:, None] * u + along[:, None] * np.stack([-u[:, 1], u[:, 0]], axis=1)
    first = np.flatnonzero(role == 1)
    points = LevelPoints(
        line=line,
        xy_px=np.nan_to_num(xy),
        angle_rad=np.nan_to_num(angle),
        sigma_px=np.full(len(line), sigma_px),
        depth_mm=depths,
        pairs=np.stack([first, first + len(marks)], axis=1),
        sigma_along_px=np.ones(len(first)),
    )
    return points.of(np.isfinite(xy).all(axis=1))


def sub_beams(origins_mm: ArrayF, directions: ArrayF, window: Window) -> SubBeams:
    """Rays behind the window from origins (n, 3) and unit directions (n, 3) in air, lcs."""
    R = window.R_lcs_window
    o, d = origins_mm @ R, directions @ R
    sine = np.hypot(d[:, 0], d[:, 1])
    azimuth = np.arctan2(d[:, 1], d[:, 0])
    with np.errstate(invalid="ignore"):
        in_air = np.where(d[:, 2] < 0, np.arctan2(sine, -d[:, 2]), np.nan)
        in_glass = np.arcsin(window.n_air * sine / window.n_glass)
        in_water = np.arcsin(window.n_glass * np.sin(in_glass) / window.n_water)
    reach = o[:, 2] * np.tan(in_air) + window.thickness_mm * np.tan(in_glass)
    aside = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    return SubBeams(
        start_mm=o[:, :2] + reach[:, None] * aside,
        slope=np.where(np.isnan(reach), np.nan, np.tan(in_water))[:, None] * aside,
    )


def seen_points(sensor: Sensor, xyz_lcs_mm: ArrayF) -> SeenPoints:
    """Points (n, 3) of the water, lcs, as the camera sees them; hidden or not."""
    seen = see(sensor, xyz_lcs_mm)
    up = seen.up @ sensor.window.R_lcs_window
    return SeenPoints(
        xy_px=seen.xy_px,
        inside=np.asarray(sensor.camera.inside(seen.xy_px), dtype=np.bool_),
        slope=-up[:, :2] / up[:, 2:],
    )
