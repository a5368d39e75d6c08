"""Laser speckle as a camera sees it, and images of straight or curved lines that carry it.

A rough surface scatters each sub-beam with its own random phase. The camera's pupil passes the spatial
frequencies of the field up to ``1 / (2 wavelength N (1 + M))`` (image side; f-number N, magnification M), and
a pixel integrates the intensity (Goodman 2007, *Speckle Phenomena in Optics*, 4.2, 4.5, 7.2). Two forms:

`SpeckleTile`: factors of mean 1 for an intensity that varies slowly against a speckle; for whole images.
`line_intensity`: a laser line whose own field passes the pupil, so that envelope, defocus and speckle belong
together; for tests and studies of detectors. `mean_line_intensity` is its expectation.

Pixels count from the upper left corner: the centre of the first pixel is (0.5, 0.5).
"""

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import fft

from thalweg.core import AnyArray, ArrayF, ArrayF32, GeometryError

_LEAST_OVERSAMPLING: Final = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeckleOptics:
    """What decides about the size and the contrast of speckle in an image.

    ``f_number`` is the engraved one; the working f-number is ``f_number (1 + magnification)``.
    ``polarisations`` is 2 for a surface that depolarises (two independent patterns add up, contrast 0.71
    before the pixels average) and 1 for one that does not. ``defocus_px`` is the diameter of the blur disc of
    geometrical optics; it changes lines only.
    """

    wavelength_nm: float = 520.0
    f_number: float = 8.0
    magnification: float = 0.1
    pixel_um: float = 5.5
    polarisations: Literal[1, 2] = 2
    defocus_px: float = 0.0

    def __post_init__(self) -> None:
        """Refuse optics that do not exist.

        Raises
        ------
        GeometryError : a length or number is not positive, or there are neither one nor two polarisations.
        """
        for name in ("wavelength_nm", "f_number", "pixel_um"):
            if not getattr(self, name) > 0.0:
                raise GeometryError(f"{name} = {getattr(self, name)}", expected="a positive number")
        if self.polarisations not in (1, 2) or min(self.magnification, self.defocus_px) < 0.0:
            raise GeometryError(
                f"polarisations {self.polarisations}, magnification {self.magnification}, "
                f"defocus {self.defocus_px} px",
                expected="1 or 2 polarisations, magnification and defocus not negative",
            )

    @property
    def cutoff_per_px(self) -> float:
        """Highest spatial frequency of the field, cycles per pixel."""
        working = self.f_number * (1.0 + self.magnification)
        return self.pixel_um * 1e3 / (2.0 * self.wavelength_nm * working)

    @property
    def oversampling(self) -> int:
        """Samples per pixel and axis from which on the intensity has no aliases.

        A pixel is the mean of so many samples instead of an integral: contrast 2-3 % too high.
        """
        return max(_LEAST_OVERSAMPLING, int(np.ceil(4.0 * self.cutoff_per_px)))

    @property
    def blur_phase_rad(self) -> float:
        """Phase of the defocus at the pupil's edge: ``2 pi W20 / wavelength``, ``W20 = blur / (8 N)``."""
        working = self.f_number * (1.0 + self.magnification)
        path_nm = self.defocus_px * self.pixel_um * 1e3 / (8.0 * working)
        return 2.0 * np.pi * path_nm / self.wavelength_nm


def pupil(shape: tuple[int, int], optics: SpeckleOptics) -> AnyArray:
    """Coherent transfer function (complex64) on the frequencies of `scipy.fft.fft2` of a fine grid."""
    step = optics.oversampling
    fy = fft.fftfreq(shape[0], d=1.0 / step).astype(np.float32)
    fx = fft.fftfreq(shape[1], d=1.0 / step).astype(np.float32)
    rho2 = (fy[:, None] ** 2 + fx[None, :] ** 2) / np.float32(optics.cutoff_per_px**2)
    inside = (rho2 <= 1.0).astype(np.complex64)
    if optics.defocus_px > 0.0:
        inside *= np.exp(np.complex64(1j * optics.blur_phase_rad) * rho2)
    return inside


def speckle_factor(shape: tuple[int, int], optics: SpeckleOptics, generator: np.random.Generator) -> ArrayF32:
    """Factor of the intensity in each pixel, expectation 1, (height, width); periodic in both axes.

    The spectrum of a field with white random phases behind the pupil is complex Gaussian inside the pupil and
    zero outside (Goodman 2007, 4.2), so it is drawn there directly.

    Parameters
    ----------
    shape : height and width in pixels.
    optics : see `SpeckleOptics`; defocus changes nothing here, as it must not in a uniform field.
    generator : of the cause ``speckle``.

    Raises
    ------
    GeometryError : the window is so small that the pupil holds less than ten frequencies.
    """
    step = optics.oversampling
    fine = (shape[0] * step, shape[1] * step)
    rows, columns = np.nonzero(pupil(fine, replace(optics, defocus_px=0.0)))
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


def line_intensity(
    centre_px: ArrayLike,
    width: int,
    half_width_px: float,
    optics: SpeckleOptics,
    generator: np.random.Generator,
) -> ArrayF:
    """A speckled line from top to bottom, (rows, width); 1 is the peak of the mean without defocus.

    Parameters
    ----------
    centre_px : (rows,) x of the line in the centre of each row.
    width : columns of the image.
    half_width_px : horizontal distance at which the line's intensity on the object falls to 1/e^2.
    optics : see `SpeckleOptics`.
    generator : of the cause ``speckle``.
    """
    amplitude = _amplitude(np.asarray(centre_px, np.float64), width, half_width_px, optics.oversampling)
    transfer = pupil(amplitude.shape, optics)
    total = np.zeros((np.size(centre_px), width))
    inside = float(np.count_nonzero(transfer)) / transfer.size
    for _ in range(optics.polarisations):
        drawn = generator.standard_normal((*amplitude.shape, 2), dtype=np.float32)
        scattered = amplitude * (drawn[..., 0] + 1j * drawn[..., 1])
        field = fft.ifft2(fft.fft2(scattered, overwrite_x=True) * transfer, overwrite_x=True)
        total += _pixels(_intensity(field), optics.oversampling) / (2.0 * inside * optics.polarisations)
    return total


def mean_line_intensity(
    centre_px: ArrayLike, width: int, half_width_px: float, optics: SpeckleOptics | None = None
) -> ArrayF:
    """Expectation of `line_intensity`: without speckle, blurred by diffraction, defocus and pixels.

    Without ``optics`` there is neither diffraction nor defocus: a Gaussian integrated over each pixel.
    """
    used = optics or SpeckleOptics()
    amplitude = _amplitude(np.asarray(centre_px, np.float64), width, half_width_px, used.oversampling)
    intensity = (amplitude.astype(np.float64)) ** 2
    if optics is not None:
        spread = _intensity(fft.ifft2(pupil(amplitude.shape, optics))).astype(np.float64)
        transfer = fft.rfft2(spread / spread.sum())
        intensity = fft.irfft2(fft.rfft2(intensity) * transfer, s=intensity.shape)
    return _pixels(intensity, used.oversampling)


def one_sided_halo(intensity: ArrayF, *, share: float, length_px: float, to_left: bool = True) -> ArrayF:
    """Intensity with a halo on one side: what a specular or subsurface lobe adds to a line (P4 7.2).

    A share of each pixel's light is spread along its row to one side, falling as ``exp(-distance / length)``.
    Where the sensor saturates, such a halo widens the line on one side and moves what is measured.
    """
    reach = int(np.ceil(6.0 * length_px))
    kernel = np.exp(-np.arange(reach + 1) / length_px)
    kernel /= kernel.sum()
    source = intensity[:, ::-1] if to_left else intensity
    spread = np.apply_along_axis(lambda row: np.convolve(row, kernel)[: row.size], 1, source)
    return np.asarray((1.0 - share) * intensity + share * (spread[:, ::-1] if to_left else spread))


@dataclass(frozen=True, slots=True, kw_only=True)
class GreyValues:
    """How a sensor turns intensity into grey values.

    ``peak_dn`` of intensity 1, noise of reading in electrons, ``dark_dn`` offset, ``ambient_dn`` light beside
    the laser, ``bits`` 8 or up to 16; ``full_well_electrons`` fills the whole range.
    """

    peak_dn: float = 150.0
    ambient_dn: float = 0.0
    dark_dn: float = 3.0
    full_well_electrons: float = 13_500.0
    read_electrons: float = 13.0
    bits: int = 8

    @property
    def largest_dn(self) -> int:
        """Largest grey value."""
        return int(2**self.bits - 1)


def grey_values(intensity: ArrayF, sensor: GreyValues, generator: np.random.Generator) -> AnyArray:
    """Raw grey values (uint8, or uint16 beyond 8 bits): shot noise, read noise, rounding, saturation."""
    top = sensor.largest_dn
    light_dn = np.clip(intensity, 0.0, None) * sensor.peak_dn + sensor.ambient_dn
    electrons = generator.poisson(light_dn * (sensor.full_well_electrons / top)).astype(np.float64)
    electrons += generator.normal(0.0, sensor.read_electrons, electrons.shape)
    grey = np.round(electrons * (top / sensor.full_well_electrons) + sensor.dark_dn)
    return np.clip(grey, 0, top).astype(np.uint8 if sensor.bits <= 8 else np.uint16)


def laser_mosaic(green: AnyArray, *, red: float = 0.08, blue: float = 0.2, dark_dn: float = 3.0) -> AnyArray:
    """RGGB mosaic of a green laser's image: red and blue pixels see that share of the light."""
    out = green.copy()
    for (row, column), share in (((0, 0), red), ((1, 1), blue)):
        part = green[row::2, column::2].astype(np.float64)
        out[row::2, column::2] = np.round(np.clip((part - dark_dn) * share, 0.0, None) + dark_dn)
    return out


def _amplitude(centre_px: ArrayF, width: int, half_width_px: float, step: int) -> ArrayF32:
    """Amplitude of the line's field on the fine grid; its rows follow the centre linearly."""
    rows = np.arange(centre_px.size) + 0.5
    fine_y = (np.arange(centre_px.size * step) + 0.5) / step
    slope = np.gradient(centre_px) if centre_px.size > 1 else np.zeros(1)
    nearest = np.minimum((fine_y).astype(np.int64), centre_px.size - 1)
    # inside its own row a line runs straight through the stated centre with the local slope
    centre = centre_px[nearest] + slope[nearest] * (fine_y - rows[nearest])
    fine_x = (np.arange(width * step) + 0.5) / step
    away = (fine_x[None, :] - centre[:, None]) / half_width_px
    return np.exp(-(away**2)).astype(np.float32)


def _intensity(field: AnyArray) -> AnyArray:
    """Squared modulus."""
    return np.square(field.real) + np.square(field.imag)


def _pixels(fine: AnyArray, step: int) -> AnyArray:
    """Mean over the samples of each pixel."""
    rows, columns = fine.shape[0] // step, fine.shape[1] // step
    return np.asarray(fine.reshape(rows, step, columns, step).mean(axis=(1, 3)))
