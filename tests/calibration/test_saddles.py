"""Crossings of a real board: what the fit says of its own errors."""

import cv2
import numpy as np
import pytest

from thalweg.calibration import fit_saddles

pytestmark = pytest.mark.real

POSES = (1, 9, 17, 25, 33)
INNER = (7, 5)


def by_module(corners: np.ndarray) -> np.ndarray:
    """(n, 2, 2) pixels by the squares of the board."""
    grid = corners.reshape(INNER[1], INNER[0], 2)
    along = [np.gradient(grid, axis=axis).reshape(-1, 2) for axis in (1, 0)]
    return np.stack(along, axis=2)


def signs(picture: np.ndarray, corners: np.ndarray, A: np.ndarray) -> np.ndarray:
    """+1 where the squares at which both coordinates grow or fall are white."""

    def grey(u: float, v: float) -> np.ndarray:
        at = np.floor(corners + A @ np.array([u, v])).astype(int)
        return picture[at[:, 1], at[:, 0]].astype(float)

    return np.sign(grey(0.3, 0.3) + grey(-0.3, -0.3) - grey(0.3, -0.3) - grey(-0.3, 0.3))


def smaller(picture: np.ndarray, times: int, *, jpeg: bool) -> np.ndarray:
    """Mean of ``times`` x ``times`` pixels, as a camera of fewer pixels sees."""
    h, w = (n // times for n in picture.shape)
    mean = picture[: h * times, : w * times].reshape(h, times, w, times).mean(axis=(1, 3))
    out = mean.round().astype(np.uint8)
    if jpeg:
        out = cv2.imdecode(cv2.imencode(".jpg", out, [cv2.IMWRITE_JPEG_QUALITY, 93])[1], cv2.IMREAD_GRAYSCALE)
    return np.asarray(out)


def test_errors_of_crossings_in_small_photographs_are_as_stated(data_dir):
    """Three photographs of a board (ACFR), 40 to 64 px a square, made 4 to 16 times smaller.

    Each board errs as a whole, too, by up to 0.03 px, so these are fewer errors than crossings.
    """
    folder = data_dir / "acfr_vlp16_camera/data/vlp/images"
    off: dict[int, list[np.ndarray]] = {4: [], 8: [], 16: []}
    for pose in POSES[::2]:
        picture = cv2.imread(str(folder / f"pose{pose}.png"), cv2.IMREAD_GRAYSCALE)
        assert picture is not None
        # the board is in this part; cv2 counts from the centre of the first pixel
        found, corners = cv2.findChessboardCorners(picture, INNER)
        assert found
        start = corners.reshape(-1, 2) + 0.5
        A = by_module(start)
        sign = signs(picture, start, A)
        full = fit_saddles(picture, start, A, sign)
        assert full.good.mean() > 0.7
        for times in off:
            small = smaller(picture, times, jpeg=True)
            begin = np.where(full.good[:, None], full.xy_px, start) / times
            fit = fit_saddles(small, begin, A / times, sign)
            error = (fit.xy_px - full.xy_px / times) / fit.sigma_px[:, None]
            off[times].append(error[fit.good & full.good])
    for times, errors in off.items():
        e = np.concatenate(errors)
        # blunders count apart
        sigma = 1.4826 * np.median(np.abs(e))
        assert 0.6 < sigma < 1.3, times
        assert (np.abs(e).max(axis=1) > 5).mean() < 0.03, times
