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
from scipy import fft

from thalweg.core import AnyArray, ArrayF32, GeometryError

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


def _intensity(field: AnyArray) -> AnyArray:
    """Squared modulus."""
    return np.square(field.real) + np.square(field.imag)


def _pixels(fine: AnyArray, step: int) -> AnyArray:
    """Mean over the samples of each pixel."""
    rows, columns = fine.shape[0] // step, fine.shape[1] // step
    return np.asarray(fine.reshape(rows, step, columns, step).mean(axis=(1, 3)))
