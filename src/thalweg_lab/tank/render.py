"""An image of the light-sheet sensor, from the true geometry forwards to grey values.

Laser speckle as a camera sees it, and images of straight or curved lines that carry it.

A rough surface scatters each sub-beam with its own random phase. The camera's pupil passes the spatial
frequencies of the field up to ``1 / (2 wavelength N (1 + M))`` (image side; f-number N, magnification M), and
a pixel integrates the intensity (Goodman 2007, *Speckle Phenomena in Optics*, 4.2, 4.5, 7.2). Two forms:

`SpeckleTile`: factors of mean 1 for an intensity that varies slowly against a speckle; for whole images.
`line_intensity`: a laser line whose own field passes the pupil, so that envelope, defocus and speckle belong
together; for tests and studies of detectors. `mean_line_intensity` is its expectation.

Pixels count from the upper left corner: the centre of the first pixel is (0.5, 0.5).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from scipy import fft

from thalweg.core import AnyArray, ArrayF, ArrayF32, ArrayU8, GeometryError, optional
from thalweg.lightsheet.optics import Sensor
from thalweg_lab.settings import Chip, SheetImage
from thalweg_lab.tank.forward import camera_rays
from thalweg_lab.tank.glow import Fan, glow, light_to_dn, splat
from thalweg_lab.tank.surfaces import Posed

cv2 = optional("cv2")

# ---------------------------------------------------------------- speckle

_LEAST_OVERSAMPLING: Final = 2
_MAGNIFICATION: Final = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeckleOptics:
    """What decides about the size and the contrast of speckle in an image.

    ``f_number`` is the engraved one; the working f-number is larger by the magnification.
    ``polarisations`` is 2 for a surface that depolarises (two independent patterns add up, contrast 0.71
    before the pixels average) and 1 for one that does not.
    """

    wavelength_nm: float = 520.0
    f_number: float = 8.0
    pixel_um: float = 5.5
    polarisations: Literal[1, 2] = 2

    @property
    def cutoff_per_px(self) -> float:
        """Highest spatial frequency of the field, cycles per pixel."""
        working = self.f_number * (1.0 + _MAGNIFICATION)
        return self.pixel_um * 1e3 / (2.0 * self.wavelength_nm * working)

    @property
    def oversampling(self) -> int:
        """Samples per pixel and axis from which on the intensity has no aliases.

        A pixel is the mean of so many samples instead of an integral: contrast 2-3 % too high.
        """
        return max(_LEAST_OVERSAMPLING, int(np.ceil(4.0 * self.cutoff_per_px)))


def pupil(shape: tuple[int, int], optics: SpeckleOptics) -> AnyArray:
    """Coherent transfer function (complex64) on the frequencies of `scipy.fft.fft2` of a fine grid."""
    step = optics.oversampling
    fy = fft.fftfreq(shape[0], d=1.0 / step).astype(np.float32)
    fx = fft.fftfreq(shape[1], d=1.0 / step).astype(np.float32)
    rho2 = (fy[:, None] ** 2 + fx[None, :] ** 2) / np.float32(optics.cutoff_per_px**2)
    return np.asarray((rho2 <= 1.0).astype(np.complex64))


def speckle_factor(shape: tuple[int, int], optics: SpeckleOptics, generator: np.random.Generator) -> ArrayF32:
    """Factor of the intensity in each pixel, expectation 1, (height, width); periodic in both axes.

    The spectrum of a field with white random phases behind the pupil is complex Gaussian inside the pupil and
    zero outside (Goodman 2007, 4.2), so it is drawn there directly.

    Parameters
    ----------
    shape : height and width in pixels.
    optics : see `SpeckleOptics`.
    generator : of the cause ``speckle``.

    Raises
    ------
    GeometryError : the window is so small that the pupil holds less than ten frequencies.
    """
    step = optics.oversampling
    fine = (shape[0] * step, shape[1] * step)
    rows, columns = np.nonzero(pupil(fine, optics))
    if rows.size < 10:
        raise GeometryError(
            f"a window of {shape[0]} x {shape[1]} pixels holds {rows.size} frequencies of the pupil",
            expected="10 or more",
            cure="Ask for a larger window, or cut one out of a SpeckleTile",
        )
    total = np.zeros(shape, np.float32)
    scale = np.float32(fine[0] * fine[1] / np.sqrt(2.0 * rows.size * optics.polarisations))
    for _ in range(optics.polarisations):
        spectrum = np.zeros(fine, np.complex64)
        drawn = generator.standard_normal((rows.size, 2), dtype=np.float32)
        spectrum[rows, columns] = (drawn[:, 0] + 1j * drawn[:, 1]) * scale
        total += _pixels(_intensity(fft.ifft2(spectrum, overwrite_x=True)), step)
    return total


@dataclass(frozen=True, slots=True)
class SpeckleTile:
    """Speckle without seams for windows of any size and place: one periodic tile, moved by a random shift.

    ``factor`` (n, n) has expectation 1. Two pixels further apart than a few speckles and nearer than the
    tile's side are independent. `moved` gives another pattern for the next image at no cost.
    """

    factor: ArrayF32
    shift: tuple[int, int] = (0, 0)

    @classmethod
    def make(
        cls, optics: SpeckleOptics, generator: np.random.Generator, *, size_px: int = 1024
    ) -> "SpeckleTile":
        """A new tile; its cost depends on ``size_px`` alone."""
        return cls(speckle_factor((size_px, size_px), optics, generator))

    def moved(self, generator: np.random.Generator) -> "SpeckleTile":
        """The same tile behind a random shift."""
        down, right = (int(v) for v in generator.integers(0, self.factor.shape[0], 2))
        return replace(self, shift=(down, right))

    def window(self, top: int, left: int, height: int, width: int) -> ArrayF32:
        """Factors (height, width) of the pixels from row ``top`` and column ``left`` on."""
        rows = np.arange(top + self.shift[0], top + self.shift[0] + height) % self.factor.shape[0]
        columns = np.arange(left + self.shift[1], left + self.shift[1] + width) % self.factor.shape[1]
        return self.factor[np.ix_(rows, columns)]


def _intensity(field: AnyArray) -> AnyArray:
    """Squared modulus."""
    return np.square(field.real) + np.square(field.imag)


def _pixels(fine: AnyArray, step: int) -> AnyArray:
    """Mean over the samples of each pixel."""
    rows, columns = fine.shape[0] // step, fine.shape[1] // step
    return np.asarray(fine.reshape(rows, step, columns, step).mean(axis=(1, 3)))


# ---------------------------------------------------------------- light beside the line: the scene in
# daylight, and the sheet's own glow in turbid water


# ---------------------------------------------------------------- an image

_NODES: Final = 64
"""Rays of sight are computed for so many cells a side and interpolated between: 0.03 px off in 2048 px."""

_SKYLIGHT: Final = 0.35
"""Light on an upright face as a share of that on a level one."""

"""The glow of the water is computed on blocks of so many pixels a side: its edge at the line stays sharp."""


def stride_of(sensor: Sensor) -> int:
    """Side of the blocks of pixels that share one ray of daylight."""
    return max(1, int(np.ceil(max(sensor.camera.size_px) / 512)))


def daylight(sensor: Sensor, posed: Posed, settings: SheetImage) -> ArrayF32:
    """The scene in daylight, (h, w, 3) red, green, blue; 1 is a white level surface."""
    width, height = sensor.camera.size_px
    stride = stride_of(sensor)
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


# ---------------------------------------------------------------- render


_LARGEST_DN: Final = 255.0
_TILE_PX: Final = 512
_GLARE_WIDTH_PX: Final = 2048


@dataclass(frozen=True, slots=True)
class Darkroom:
    """What images of one sensor have in common: exposure and a tile of speckle.

    ``dn_per_light`` see `light_to_dn`; ``tile`` None without speckle.
    """

    dn_per_light: float
    tile: SpeckleTile | None

    @classmethod
    def of(cls, sensor: Sensor, settings: SheetImage, rng: np.random.Generator) -> "Darkroom":
        """From the generator of the cause ``speckle``."""
        tile = None
        if settings.speckle:
            tile = SpeckleTile.make(speckle_optics(settings), rng, size_px=_TILE_PX)
        return cls(light_to_dn(sensor, settings), tile)


def speckle_optics(settings: SheetImage) -> SpeckleOptics:
    """What decides about the speckle of an image."""
    return SpeckleOptics(
        wavelength_nm=settings.laser.wavelength_nm,
        f_number=settings.lens.f_number,
        pixel_um=settings.lens.pixel_um,
        polarisations=settings.polarisations,
    )


def laser_light(
    sensor: Sensor, surface: Posed, settings: SheetImage, fans: Sequence[Fan] | None = None
) -> ArrayF32:
    """Light (h, w) of all sheets without speckle, in the unit of `glow`."""
    width, height = sensor.camera.size_px
    image = np.zeros((height, width), dtype=np.float32)
    for fan in fans if fans is not None else (sensor.sheet,):
        points = glow(sensor, surface, fan, settings)
        splat(image, points.xy_px, points.light, points.sigma_px)
    return image


def render_sheet_image(
    sensor: Sensor,
    surface: Posed,
    settings: SheetImage,
    generator: np.random.Generator,
    *,
    fans: Sequence[Fan] | None = None,
    darkroom: Darkroom | None = None,
) -> ArrayU8:
    """One image.

    Parameters
    ----------
    sensor : the true one, in the true water.
    surface : what lies under it.
    settings : light, lens, water, sensor.
    generator : of this image; speckle and noise take a child each, so that one effect never shifts the other.
    fans : light sheets that are lit, None: that of the sensor.
    darkroom : for a series of images of one sensor, None: made for this one.

    Returns
    -------
    (h, w) uint8 for ``bayer`` (RGGB: the first pixel is red) and ``mono``, (h, w, 3) red, green, blue for
    ``rgb``.
    """
    for_speckle, for_tile, for_noise = generator.spawn(3)
    room = darkroom or Darkroom.of(sensor, settings, for_tile)
    used = list(fans) if fans is not None else [sensor.sheet]
    laser = laser_light(sensor, surface, settings, used)
    if room.tile is not None:
        _speckled(laser, room.tile.moved(for_speckle))
    laser *= np.float32(room.dn_per_light)
    light = _on_pixels(laser, _daylight_dn(sensor, surface, settings), settings.chip)
    if settings.lens.glare > 0:
        _glare(light, settings)
    return _developed(_exposed(light, settings.chip, for_noise), settings.chip)


def _speckled(laser: ArrayF32, tile: SpeckleTile) -> None:
    """Speckle where there is light; a pixel's pattern depends on its place only."""
    rows, columns = np.flatnonzero(laser.any(axis=1)), np.flatnonzero(laser.any(axis=0))
    if len(rows):
        top, left = int(rows[0]), int(columns[0])
        part = laser[top : int(rows[-1]) + 1, left : int(columns[-1]) + 1]
        part *= tile.window(top, left, *part.shape)


def _daylight_dn(sensor: Sensor, surface: Posed, settings: SheetImage) -> ArrayF32 | None:
    if settings.chip.ambient_dn == 0:
        return None
    return daylight(sensor, surface, settings) * np.float32(settings.chip.ambient_dn)


def _on_pixels(laser: ArrayF32, ambient: ArrayF32 | None, chip: Chip) -> ArrayF32:
    """Light (h, w) that each pixel gets through its own colour filter; unit: grey values."""
    if chip.colour == "mono":
        return laser if ambient is None else laser + ambient.mean(axis=2)
    light = laser.copy()
    light[0::2, 0::2] *= chip.red_of_laser
    light[1::2, 1::2] *= chip.blue_of_laser
    if ambient is not None:
        for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
            light[row::2, column::2] += ambient[row::2, column::2, channel]
    return light


def _glare(light: ArrayF32, settings: SheetImage) -> None:
    """A share of all light spreads widely: computed on blocks of four pixels, wide as it is."""
    height, width = light.shape
    small = cv2.resize(light, (max(width // 4, 1), max(height // 4, 1)), interpolation=cv2.INTER_AREA)
    sigma = settings.lens.glare_px * width / _GLARE_WIDTH_PX / 4
    wide = cv2.resize(cv2.GaussianBlur(small, (0, 0), sigma), (width, height), interpolation=cv2.INTER_LINEAR)
    light *= np.float32(1.0 - settings.lens.glare)
    light += np.float32(settings.lens.glare) * wide


def _exposed(light: ArrayF32, chip: Chip, rng: np.random.Generator) -> ArrayU8:
    """Grey values with shot noise and read noise.

    Shot noise is Gaussian with the variance of Poisson's: with few electrons the read noise of 13 covers the
    difference.
    """
    if chip.noise:
        electrons = np.float32(chip.full_well_electrons / _LARGEST_DN)
        sigma = np.sqrt(light * electrons + np.float32(chip.read_electrons**2)) / electrons
        light = light + sigma * rng.standard_normal(light.shape, dtype=np.float32)
    return np.clip(np.rint(light + np.float32(chip.dark_dn)), 0, _LARGEST_DN).astype(np.uint8)


def _developed(raw: ArrayU8, chip: Chip) -> ArrayU8:
    if chip.colour != "rgb":
        return raw
    if min(raw.shape) < 4:
        raise GeometryError(f"a mosaic of {raw.shape} pixels", expected="at least 4 x 4")
    return np.asarray(cv2.cvtColor(raw, cv2.COLOR_BayerRGGB2RGB))
