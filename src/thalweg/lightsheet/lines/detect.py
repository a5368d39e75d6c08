"""Lines of an image, measured: the four methods, sigmas, flags, and counts of what was dropped.

Start values come from `search`; row-wise, patch-wise and direction-normal fits from `patch`; the height of
patches from `height`; halos from `halo`; ridges from `steger`; edges of the albedo from `albedo`.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from thalweg.core.errors import InputError
from thalweg.core.types import AnyArray, ArrayF, ArrayI
from thalweg.lightsheet.lines import patch
from thalweg.lightsheet.lines.albedo import albedo_edges, remove_width_shift
from thalweg.lightsheet.lines.green import GreenImage, green_image
from thalweg.lightsheet.lines.halo import NO_HALO, find_halo
from thalweg.lightsheet.lines.height import patch_heights
from thalweg.lightsheet.lines.noise import LAG, PixelNoise, first_noise, speckle_noise
from thalweg.lightsheet.lines.points import LinePoints
from thalweg.lightsheet.lines.search import Starts, find_starts, runs_down
from thalweg.lightsheet.lines.settings import LineFlag, LineSettings
from thalweg.lightsheet.lines.steger import ridge_points
from thalweg.lightsheet.lines.windows import patch_windows

_ACROSS: Final = 2.2
"""Half width of a patch in half widths of the line: beyond, a Gaussian has 6e-5 of its peak."""
_PILOT_ROWS: Final = 15
_PILOTS: Final = 200
_TURNS: Final = 40
_SATURATED_SHARE: Final = 0.1
"""A few bright speckles saturate in any image; beyond that share of the line's width it is over-exposed."""
_LEAST_REACH_ROWS: Final = 2
_SLOPE_ROWS: Final = 5
"""Patches lower than that keep the slope of their start: their rows do not determine it."""


def detect_lines(image: AnyArray, settings: LineSettings | None = None) -> LinePoints:
    """Measure the laser lines of an image.

    Parameters
    ----------
    image : (h, w) monochrome or Bayer mosaic, or (h, w, 3) colours; uint8 or uint16.
    settings : see `LineSettings`.

    Returns
    -------
    LinePoints
        One point for each row (or column) and line; with flags, and counts of everything that was dropped.

    Raises
    ------
    InputError : no image, an over-exposed one, or one without a line.

    Notes
    -----
    P3 2.2, P4 4.1. The default method weighs by speckle and adapts the height of its patch to the surface.
    """
    settings = settings or LineSettings()
    green = green_image(np.asarray(image), settings)
    if settings.method != "speckle_patch":
        green = green.taken_as_measured()
    by_rows = settings.across == "rows" or (settings.across == "auto" and runs_down(green))
    points = _measure(green if by_rows else green.transposed(), settings)
    if not by_rows:
        points = _exchanged(points)
    return points


def _exchanged(points: LinePoints) -> LinePoints:
    """Points of the transposed image in the image itself."""
    return replace(points, x_px=points.y_px, y_px=points.x_px, angle_rad=0.5 * np.pi - points.angle_rad)


def _measure(green: GreenImage, settings: LineSettings) -> LinePoints:
    """Points of lines that run from top to bottom."""
    starts = find_starts(green, settings)
    noise = _noise(green, starts, settings)
    bias = np.zeros(starts.row.size)
    halo, halo_px = NO_HALO, 0.0
    normal = np.zeros(starts.row.size)
    if settings.direction == "normal":
        normal = -np.arctan(starts.slope)
    if settings.method == "steger":
        scale = settings.steger_scale_px or starts.half_width_px
        fitted = ridge_points(green, starts.row, starts.x_px, scale, noise)
        rows = np.full(starts.row.size, 2 * int(np.ceil(2.0 * scale)) + 1)
    elif settings.method == "speckle_patch":
        if settings.correct_albedo:
            halo, halo_px = _halo(green, starts, noise)
        fitted, rows, bias = _speckle_patches(green, starts, noise, normal, halo, settings)
    elif settings.method == "lsm":
        rows = np.full(starts.row.size, settings.patch_rows)
        fitted = _fit(
            green, starts, rows, noise, normal, half_across=settings.patch_columns / 2 - 0.5,
            free_slope=settings.shear, keep_slope=settings.shear,
        )  # fmt: skip
    else:
        rows = np.ones(starts.row.size, np.int64)
        fitted = _fit(green, starts, rows, noise, normal, half_across=_ACROSS * starts.half_width_px)
    return _points(green, starts, fitted, rows, bias, normal, noise, halo_px, settings)


def _some(starts: Starts, number: int) -> Starts:
    """Evenly spaced starts."""
    n = starts.row.size
    return starts.where(np.unique(np.linspace(0, n - 1, min(n, number)).astype(np.int64)))


def _halo(green: GreenImage, starts: Starts, noise: PixelNoise) -> tuple[ArrayF, float]:
    """Halo of the image, and its length."""
    some = _some(starts, _PILOTS // 2)
    rows, straight = np.full(some.row.size, _PILOT_ROWS), np.zeros(some.row.size)
    across = _ACROSS * starts.half_width_px

    def fit(table: ArrayF) -> ArrayF:
        return _fit(
            green, some, rows, noise, straight, half_across=across, speckle=True, free_slope=True, halo=table
        )

    return find_halo(fit, starts.half_width_px, across)


def _noise(green: GreenImage, starts: Starts, settings: LineSettings) -> PixelNoise:
    """Noise of the pixels, with the speckle as the residuals of some patches show it."""
    first = first_noise(green, settings.full_well_electrons)
    some = _some(starts, _PILOTS)
    rows = np.full(some.row.size, _PILOT_ROWS)
    fitted = _fit(
        green, some, rows, first, np.zeros(some.row.size), half_across=_ACROSS * starts.half_width_px,
        speckle=True, free_slope=True, peak_per_row=False,
    )  # fmt: skip
    good = np.isfinite(fitted[:, patch.MEAN])
    shape = fitted[good][:, [patch.WIDTH, patch.PEAK, patch.BACKGROUND, patch.SLOPE]]
    places = some.x_px[good] + fitted[good, patch.MEAN]
    return speckle_noise(green, first, places, some.row[good].astype(np.float64), shape, _PILOT_ROWS // 2)


def _speckle_patches(
    green: GreenImage,
    starts: Starts,
    noise: PixelNoise,
    normal_rad: ArrayF,
    halo: ArrayF,
    settings: LineSettings,
) -> tuple[ArrayF, ArrayI, ArrayF]:
    """Patches with speckle weights; their height follows the unevenness of the line."""
    across = _ACROSS * starts.half_width_px
    rows = np.full(starts.row.size, settings.largest_rows)
    bias = np.zeros(starts.row.size)
    if settings.adaptive and settings.largest_rows > 1:
        single = np.ones(starts.row.size, np.int64)
        rough = _fit(green, starts, single, noise, normal_rad, half_across=across, speckle=True, halo=halo)
        rows, bias = patch_heights(
            starts.row, starts.x_px + rough[:, patch.MEAN] / np.cos(normal_rad), rough[:, patch.SIGMA],
            starts.piece, noise.correlation[:, LAG], settings.largest_rows,
        )  # fmt: skip
    fitted = _fit(
        green,
        starts,
        rows,
        noise,
        normal_rad,
        half_across=across,
        speckle=True,
        free_slope=True,
        halo=halo,
    )
    return fitted, rows, bias


def _fit(
    green: GreenImage,
    starts: Starts,
    rows: ArrayI,
    noise: PixelNoise,
    normal_rad: ArrayF,
    *,
    half_across: float,
    speckle: bool = False,
    free_slope: bool = False,
    keep_slope: bool | None = None,
    peak_per_row: bool = True,
    halo: ArrayF = NO_HALO,
) -> ArrayF:
    """Patches around the starts; see `patch.fit_patches`.

    With speckle weights the window follows the line's slope, each row has its own peak (unless a window
    stands oblique to the rows), and interpolated pixels are left out; the classical methods take rectangular
    windows of the interpolated image as it is.
    """
    n = starts.row.size
    slope = starts.slope if (speckle if keep_slope is None else keep_slope) else np.zeros(n)
    slope = np.where(normal_rad != 0.0, 0.0, slope)
    across = np.minimum(half_across, np.maximum(starts.room_px, 2.0))
    half_width = np.full(n, starts.half_width_px)
    windows = patch_windows(
        green.dn, starts.row, starts.x_px, starts.first_row, starts.last_row, slope, normal_rad, across,
        rows // 2 + 0.0, half_width, speckle,
    )  # fmt: skip
    return np.asarray(
        patch.fit_patches(
            green.dn, green.bits, starts.row, starts.x_px, *windows, slope, normal_rad, across, half_width,
            (rows >= _SLOPE_ROWS) & free_slope, speckle, speckle and peak_per_row and not normal_rad.any(),
            speckle and green.kind == "mosaic", noise.vector(), noise.correlation,
            green.saturation_dn if speckle else np.inf, halo, _TURNS,
        )
    )  # fmt: skip


def _points(
    green: GreenImage,
    starts: Starts,
    fitted: ArrayF,
    rows: ArrayI,
    bias: ArrayF,
    normal_rad: ArrayF,
    noise: PixelNoise,
    halo_px: float,
    settings: LineSettings,
) -> LinePoints:
    """Table of the points that are fit to be used, with flags, corrections and counts."""
    height, width = green.dn.shape
    x = starts.x_px + np.cos(normal_rad) * fitted[:, patch.MEAN]
    y = starts.row + 0.5 + np.sin(normal_rad) * fitted[:, patch.MEAN]
    sigma = np.hypot(fitted[:, patch.SIGMA], bias)
    found = np.isfinite(x)
    inside = (x > 0.0) & (x < width) & (y > 0.0) & (y < height)
    steady = sigma <= settings.largest_sigma_px
    counts = {
        **starts.counts,
        "not_converged": int(np.count_nonzero(~found)),
        "outside_the_image": int(np.count_nonzero(found & ~inside)),
        "sigma_too_large": int(np.count_nonzero(found & inside & ~steady)),
    }
    keep = found & inside & steady
    if not keep.any():
        raise InputError(
            f"none of {keep.size} places of the line could be measured: {counts}",
            expected="a line with a profile like a Gaussian",
            cure="Check focus and exposure, or state 'half_width_px'",
        )
    shape, piece, rows = fitted[keep], starts.piece[keep], rows[keep]
    x, y, sigma = x[keep], y[keep], sigma[keep]
    core = 2.0 * shape[:, patch.WIDTH] * (1 if settings.method == "steger" else rows)
    saturated = shape[:, patch.SATURATED_PIXELS] > _SATURATED_SHARE * core
    near_edge, edges = albedo_edges(piece, shape[:, patch.PEAK], rows, settings.albedo_ratio)
    facts = {
        "half_width_px": starts.half_width_px,
        "contrast": noise.contrast,
        "read_dn": noise.read_dn,
        "saturation_dn": green.saturation_dn,
        "halo_px": halo_px,
        "albedo_edges": float(edges.size),
        "judged_by_colour": float(green.other is not None),
    }
    if settings.correct_albedo:
        corrected, wider_sigma, shift = remove_width_shift(
            x, shape[:, patch.WIDTH], sigma, saturated, piece, edges, rows
        )
        if settings.apply_shift:
            # measured along the normal, a point moves along it
            y = y + np.tan(normal_rad[keep]) * (corrected - x)
            x, sigma = corrected, wider_sigma
        facts |= {
            "width_shift": shift.coefficient,
            "sigma_width_shift": shift.sigma,
            "width_shift_edges": float(shift.edges),
            "width_shift_applied": float(shift.applied and settings.apply_shift),
            "width_unsaturated_px": shift.usual_width_px,
        }
    flags = (
        saturated * int(LineFlag.SATURATED)
        | (shape[:, patch.PEAK] < settings.least_snr * noise.read_dn) * int(LineFlag.WEAK)
        | _near_jump(starts, keep, rows, height) * int(LineFlag.NEAR_JUMP)
        | near_edge * int(LineFlag.ALBEDO_EDGE)
    )
    counts["points"] = int(x.size)
    return LinePoints(
        line=np.full(x.size, 0 if settings.lines == 1 else -1),
        piece=piece, x_px=x, y_px=y, sigma_px=sigma, angle_rad=normal_rad[keep],
        peak_dn=shape[:, patch.PEAK], width_px=shape[:, patch.WIDTH],
        background_dn=shape[:, patch.BACKGROUND], rows=rows, flags=flags.astype(np.int64),
        counts=counts, facts=facts,
    )  # fmt: skip


def _near_jump(starts: Starts, keep: AnyArray, rows: ArrayI, height: int) -> AnyArray:
    """Points whose patch would reach beyond the end of their piece, where that end is inside the image."""
    row, first, last = starts.row[keep], starts.first_row[keep], starts.last_row[keep]
    reach = np.maximum(rows // 2, _LEAST_REACH_ROWS)
    return ((row - first < reach) & (first > 1)) | ((last - row < reach) & (last < height - 2))
