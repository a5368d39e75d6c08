"""Images of a laser line for the tests of its measurement: speckle, blur, halo, grey values, mosaic."""

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy import fft

from thalweg.core import AnyArray, ArrayF, ArrayF32
from thalweg_lab.tank.render import SpeckleOptics, _intensity, _pixels, pupil


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


def one_sided_halo(intensity: ArrayF, *, share: float, length_px: float) -> ArrayF:
    """Intensity with a halo on the left: what a specular or subsurface lobe adds to a line (P4 7.2).

    A share of each pixel's light is spread along its row to one side, falling as ``exp(-distance / length)``.
    Where the sensor saturates, such a halo widens the line on one side and moves what is measured.
    """
    kernel = np.exp(-np.arange(int(np.ceil(6.0 * length_px)) + 1) / length_px)
    kernel /= kernel.sum()
    spread = np.apply_along_axis(lambda row: np.convolve(row, kernel)[: row.size], 1, intensity[:, ::-1])
    return np.asarray((1.0 - share) * intensity + share * spread[:, ::-1])


FULL_WELL, READ_NOISE, DARK_DN = 13_500.0, 13.0, 3.0
"""Electrons of the grey value 255, noise of reading in electrons, offset in grey values."""


def grey_values(intensity: ArrayF, generator: np.random.Generator, peak_dn: float = 150.0) -> AnyArray:
    """Raw grey values of intensity, 1 being ``peak_dn``: shot noise, read noise, rounding, saturation."""
    electrons = generator.poisson(np.clip(intensity, 0.0, None) * peak_dn * (FULL_WELL / 255)).astype(float)
    electrons += generator.normal(0.0, READ_NOISE, electrons.shape)
    return np.clip(np.round(electrons * (255 / FULL_WELL) + DARK_DN), 0, 255).astype(np.uint8)


def laser_mosaic(green: AnyArray) -> AnyArray:
    """RGGB mosaic of a green laser's image: red and blue pixels see 8 and 20 % of the light."""
    out = green.copy()
    for first, share in ((0, 0.08), (1, 0.2)):
        part = green[first::2, first::2].astype(np.float64)
        out[first::2, first::2] = np.round(np.clip((part - DARK_DN) * share, 0.0, None) + DARK_DN)
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


COLOURS = {"red": (1.0, 0.12, 0.04), "green": (0.10, 1.0, 0.20), "blue": (0.05, 0.25, 1.0)}
"""What red, green and blue pixels see of a laser."""


def daylight_board(
    seed: int, colour: str, *, inner: tuple[int, int] | None = None
) -> tuple[AnyArray, ArrayF]:
    """A laser line on a checkerboard in daylight as a camera stores it, (480, 640, 3), and its true x by row.

    Squares of an albedo of 12 and 85 %, turned; light that changes over the picture, with a shadow whose edge
    lies elsewhere in each picture; the line as bright as the albedo; shot and read noise; a Bayer mosaic,
    interpolated; JPEG.

    ``inner``: corners of a whole board with a white margin; behind it the line lies elsewhere, as on a wall.
    """
    generator = np.random.default_rng([seed, *colour.encode()])
    h, w = 480, 640
    y, x = np.mgrid[:h, :w].astype(float)
    turn, side = np.deg2rad(generator.uniform(-20, 20)), generator.uniform(35, 55)
    u, v = (x * np.cos(turn) - y * np.sin(turn)) / side, (x * np.sin(turn) + y * np.cos(turn)) / side
    albedo = np.where((np.floor(u) + np.floor(v)) % 2 == 0, 0.12, 0.85)
    board = (x > 60) & (x < w - 60) & (y > 40) & (y < h - 40)
    if inner is not None:
        outside = np.maximum(
            np.abs(u - u.mean()) - (inner[0] + 1) / 2, np.abs(v - v.mean()) - (inner[1] + 1) / 2
        )
        even = np.floor(u - u.mean() + (inner[0] + 1) / 2) + np.floor(v - v.mean() + (inner[1] + 1) / 2)
        albedo, board = np.where((outside < 0) & (even % 2 == 0), 0.12, 0.85), outside < 0.4
    albedo = np.where(board, albedo, 0.35 + 0.1 * np.sin(x / 90) * np.cos(y / 70))
    albedo = cv2.GaussianBlur(albedo, (0, 0), 0.9)
    edge = generator.uniform(0.3, 0.7) * w + 0.3 * (y - h / 2)
    light = 150.0 * (0.75 + 0.25 * x / w + 0.1 * y / h) * (1 - 0.5 / (1 + np.exp(-(x - edge) / 6)))
    row = np.arange(h)
    centre = w * generator.uniform(0.35, 0.65) + generator.uniform(-0.15, 0.15) * (row - h / 2)
    centre = centre + 6 * np.sin(row / 60)
    aside = 0.0 if inner is None else np.where(board, 0.0, 60.0)
    away = (x + 0.5 - centre[:, None] - aside) / generator.uniform(3, 5)
    line = 120.0 * np.exp(-2 * away**2) * albedo / 0.85
    white = np.array([0.92, 1.0, 0.8])
    dn = (light * albedo)[..., None] * white + line[..., None] * np.array(COLOURS[colour])
    electrons = generator.poisson(dn * FULL_WELL / 255) + generator.normal(0, READ_NOISE, dn.shape)
    dn = electrons * 255 / FULL_WELL + DARK_DN
    mosaic = dn[..., 1].copy()
    mosaic[0::2, 0::2], mosaic[1::2, 1::2] = dn[0::2, 0::2, 0], dn[1::2, 1::2, 2]
    stored = cv2.cvtColor(np.clip(np.rint(mosaic), 0, 255).astype(np.uint8), cv2.COLOR_BayerBG2BGR)
    _, data = cv2.imencode(".jpg", stored, [cv2.IMWRITE_JPEG_QUALITY, 90])
    return cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB), centre
