r"""A lidar cloud in the colours of photographs.

A point takes the colours of the best few photographs that show it: taken within a time and a distance of it,
not masked, and not behind something nearer. What is nearer is known from the cloud itself: for each
photograph the least range of the cloud in cells of some tenths of a degree, widened by a cell to each side,
because a scanner leaves gaps between its lines. A point is hidden where its range is larger than that by more
than a step and twice what it and the photograph's pose are uncertain along it.

Of several views those with the smallest pixel on the point and the least age count; their median in linear
light is the colour, and their scatter its standard deviation. A point that no photograph shows has no colour
and is counted with the reason; it is never black by accident, but grey, and its number of views is 0.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from scipy.ndimage import minimum_filter

from thalweg.core import (
    AnyArray,
    ArrayB,
    ArrayF,
    Camera,
    CoverageError,
    InputError,
    LazWriter,
    iter_laz,
    laz_header,
)
from thalweg.images.model import ImagePoses, at_pixels
from thalweg.lidar.cloud import CORRELATION_DIMENSIONS, EXTRA_DIMENSIONS
from thalweg.settings.sections import Colour

COLOUR_DIMENSIONS: Final = {
    "n_views": ("u1", "photographs of the colour"),
    "colour_sigma": ("f4", "scatter of brightness, 0-255"),
    "image": ("i4", "best photograph, -1: none"),
    "age_s": ("f4", "its time less the point's, s"),
}
"""Extra dimensions of a coloured cloud."""
GAMMA: Final = 2.2
"""Photographs store light to the power of 1 / 2.2 (sRGB, but for its linear foot)."""
UNSEEN_GREY: Final = 128
"""Colour of points without one: mid-grey, told apart by ``n_views`` = 0."""
_NEAREST_M: Final = 0.5


class NoColour(IntEnum):
    """Why a point has no colour."""

    COLOURED = 0
    NOT_SHOWN = 1
    MASKED = 2
    HIDDEN = 3


NO_COLOUR: Final = {
    NoColour.COLOURED: "coloured",
    NoColour.NOT_SHOWN: "no photograph of that time and distance shows it",
    NoColour.MASKED: "masked in all that show it: water, sky, own boat",
    NoColour.HIDDEN: "behind something nearer in all that show it",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A photograph that may give colours.

    Parameters
    ----------
    number : of the image among the poses.
    t_gps_s : time of exposure.
    centre_m, R_wcs_ccs : (3,), (3, 3) pose.
    sigma_m : standard deviation of its centre, the largest of the axes.
    path, mask : the photograph, and where it may be used; None: everywhere.
    nearest_m : (rows, columns) least range of the cloud in cells of the picture; infinite: nothing.
    """

    number: int
    t_gps_s: float
    centre_m: ArrayF
    R_wcs_ccs: ArrayF
    sigma_m: float
    path: Path
    mask: Path | None
    nearest_m: ArrayF


def views_of(
    poses: ImagePoses, images: Mapping[str, Path], masks: Mapping[str, Path], camera: Camera, cell_px: int
) -> list[View]:
    """The oriented images with a time, each with an empty map of ranges.

    Parameters
    ----------
    poses : with times of exposure.
    images, masks : files by name; an image without a mask may be used everywhere.
    camera : of all images.
    cell_px : width of a cell of the map of ranges.

    Raises
    ------
    CoverageError : no image has pose, time and file.
    """
    shape = (-(-camera.size_px[1] // cell_px), -(-camera.size_px[0] // cell_px))
    found = []
    for k, name in enumerate(poses.images):
        if not (poses.oriented[k] and np.isfinite(poses.t_gps_s[k]) and name in images):
            continue
        found.append(
            View(
                number=k,
                t_gps_s=float(poses.t_gps_s[k]),
                centre_m=poses.centre_wcs_m[k],
                R_wcs_ccs=poses.R_wcs_ccs[k],
                sigma_m=float(np.sqrt(np.diag(poses.cov_pose_wcs[k])[:3].max())),
                path=images[name],
                mask=masks.get(name),
                nearest_m=np.full(shape, np.inf),
            )
        )
    if not found:
        raise CoverageError(
            f"none of {len(poses.images)} images has a pose, a time and a file",
            expected="oriented photographs of the survey",
            cure="Look at orientation/image_poses_timed.parquet and logs.time_lapse",
        )
    return found


def seen_by(view: View, camera: Camera, xyz_m: ArrayF, max_range_m: float) -> tuple[AnyArray, ArrayF, ArrayF]:
    """Points in front of a photograph: their rows (k,), pixels (k, 2) and ranges (k,)."""
    # which ones may be in the picture at all: single precision does for that, and most are not
    x, y, z = (xyz_m - view.centre_m).astype(np.float32).dot(view.R_wcs_ccs.astype(np.float32)).T
    near = np.flatnonzero((z > _NEAREST_M) & (z < max_range_m) & (x * x + y * y < (_widest(camera) * z) ** 2))
    ccs = (xyz_m[near] - view.centre_m) @ view.R_wcs_ccs
    pixels = camera.project(ccs)
    r = np.linalg.norm(ccs, axis=1)
    inside = np.isfinite(pixels).all(axis=1) & (r < max_range_m)
    inside &= np.asarray(camera.inside(pixels), dtype=np.bool_)
    # a pixel on the very edge belongs to the picture
    return near[inside], np.minimum(pixels[inside], np.nextafter(camera.size_px, 0.0)), r[inside]


def _near(views: list[View], xyz_m: ArrayF, max_range_m: float) -> list[View]:
    """Views that may show some of the points (n, 3), by the box about these."""
    low, high = xyz_m.min(axis=0), xyz_m.max(axis=0)
    away = [np.maximum(np.maximum(low - view.centre_m, view.centre_m - high), 0.0) for view in views]
    return [view for view, d in zip(views, away, strict=True) if d @ d < max_range_m**2]


def _widest(camera: Camera) -> float:
    """Tangent of the widest angle from the axis that the picture shows, with a margin."""
    width, height = camera.size_px
    corners = camera.rays(np.array([[0, 0], [width, 0], [0, height], [width, height]], dtype=np.float64))
    return float(1.1 * np.nanmax(np.hypot(corners[:, 0], corners[:, 1]) / np.maximum(corners[:, 2], 0.05)))


def colour_cloud(
    points: Path,
    out: Path,
    poses: ImagePoses,
    images: Mapping[str, Path],
    masks: Mapping[str, Path],
    camera: Camera,
    settings: Colour,
    *,
    occlusion: bool = True,
) -> pd.DataFrame:
    """Give the points of a cloud colours.

    Parameters
    ----------
    points : LAZ of `thalweg.lidar.georeference_log`, in the frame of the poses.
    out : target: the same points with colours and `COLOUR_DIMENSIONS`.
    poses, images, masks, camera : see `views_of`.
    settings : section ``colour``.
    occlusion : leave out hidden points; False shows what that is worth.

    Returns
    -------
    counts : columns reason, words, n; they add up to all points.

    Raises
    ------
    InputError : the cloud lies in another frame, or a photograph cannot be read.
    CoverageError : no image can be used.
    """
    header = laz_header(points)
    if header.frame != poses.frame:
        raise InputError(
            f"a cloud in the frame {header.frame}",
            expected=f"that of the image poses, {poses.frame}",
            where=points,
            cure="Colour the cloud of the same campaign",
        )
    middle = np.array(camera.size_px) / 2
    a, b = camera.rays(np.stack([middle, middle + np.array([10.0, 0.0])]))
    cell_px = max(2, round(10.0 / float(np.linalg.norm(a - b)) * np.deg2rad(settings.cell_deg)))
    views = views_of(poses, images, masks, camera, cell_px)
    if occlusion:
        for chunk in iter_laz(points):
            for view in _near(views, chunk["xyz_m"], settings.max_range_m):
                _, pixels, r = seen_by(view, camera, chunk["xyz_m"], settings.max_range_m)
                cell = (pixels // cell_px).astype(np.int64)
                np.minimum.at(view.nearest_m, (cell[:, 1], cell[:, 0]), r)
        for view in views:
            view.nearest_m[:] = minimum_filter(view.nearest_m, size=3)
    known = EXTRA_DIMENSIONS | CORRELATION_DIMENSIONS
    extra = {name: known[name] for name in header.extra_dimensions if name in known}
    counts = np.zeros(len(NoColour), dtype=np.int64)
    with LazWriter(
        out,
        header.frame,
        scale_m=header.scale_m,
        offset_m=header.offsets_m,
        extra_dimensions=extra | COLOUR_DIMENSIONS,
    ) as writer:
        for chunk in iter_laz(points):
            found = _coloured(chunk, views, camera, cell_px, settings)
            counts += np.bincount(found["reason"], minlength=len(NoColour))
            writer.append(
                chunk["xyz_m"],
                t_gps_s=chunk["t_gps_s"],
                intensity=chunk["intensity"],
                rgb=found["rgb"],
                return_number=chunk["return_number"],
                number_of_returns=chunk["number_of_returns"],
                extra={name: chunk[name] for name in extra}
                | {name: found[name] for name in COLOUR_DIMENSIONS},
            )
    rows = [(reason.name.lower(), NO_COLOUR[reason], int(counts[reason])) for reason in NoColour]
    return pd.DataFrame(rows, columns=["reason", "words", "n"])


def _picture(path: Path, size_px: tuple[int, int]) -> AnyArray:
    """A photograph (h, w, 3) uint8 as its pixels lie.

    Raises
    ------
    InputError : it cannot be read, or has another size than its camera was calibrated for.
    """
    from PIL import Image

    try:
        with Image.open(path) as file:
            picture = np.asarray(file.convert("RGB"), dtype=np.uint8)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no picture ({error})", expected="a whole JPEG or PNG", where=path, cure="Copy it again"
        ) from error
    if picture.shape[:2] != size_px[::-1]:
        raise InputError(
            f"a picture of {picture.shape[1]} x {picture.shape[0]} pixels",
            expected=f"{size_px[0]} x {size_px[1]}, as its camera was calibrated",
            where=path,
        )
    return picture


def _mask(path: Path) -> ArrayB:
    """Where a photograph may be used (h, w), of whatever scale.

    Raises
    ------
    InputError : the mask cannot be read.
    """
    from PIL import Image

    try:
        with Image.open(path) as file:
            return np.asarray(file.convert("L")) > 0
    except (OSError, ValueError) as error:
        raise InputError(
            f"no mask ({error})", expected="a whole PNG, 0 where not to be used", where=path
        ) from error


def _coloured(
    chunk: Mapping[str, AnyArray], views: list[View], camera: Camera, cell_px: int, settings: Colour
) -> dict[str, AnyArray]:
    """Colours of some points, their views, scatter, age, and why there is none."""
    xyz, t = chunk["xyz_m"], chunk["t_gps_s"]
    n, k = len(xyz), settings.views
    own_sigma = np.maximum(chunk["sigma_east"], np.maximum(chunk["sigma_north"], chunk["sigma_up"]))
    score = np.full((n, k), np.inf)
    light = np.full((n, k, 3), np.nan, dtype=np.float32)
    image = np.full((n, k), -1, dtype=np.int32)
    age = np.full((n, k), np.nan, dtype=np.float32)
    shown, usable = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    first, last = float(t.min()), float(t.max())
    for view in _near(views, xyz, settings.max_range_m):
        if view.t_gps_s < first - settings.window_s or view.t_gps_s > last + settings.window_s:
            continue
        row, pixels, r = seen_by(view, camera, xyz, settings.max_range_m)
        of_time = np.abs(t[row] - view.t_gps_s) <= settings.window_s
        row, pixels, r = row[of_time], pixels[of_time], r[of_time]
        shown[row] = True
        if view.mask is not None:
            good = at_pixels(_mask(view.mask), pixels[:, 0], pixels[:, 1], camera.size_px)
            row, pixels, r = row[good], pixels[good], r[good]
        usable[row] = True
        cell = (pixels // cell_px).astype(np.int64)
        uncertain = np.hypot(own_sigma[row], view.sigma_m)
        # a surface seen at a slant differs in range within a cell
        step = settings.step_m + settings.step_share * r + 2 * uncertain
        good = r <= view.nearest_m[cell[:, 1], cell[:, 0]] + step
        row, pixels, r = row[good], pixels[good].astype(np.int64), r[good]
        value = (1.0 + np.abs(t[row] - view.t_gps_s) / settings.window_s) * r
        worst = score[row].argmax(axis=1)
        better = value < score[row, worst]
        row, worst, pixels, value = row[better], worst[better], pixels[better], value[better]
        if not len(row):
            continue
        colour = _picture(view.path, camera.size_px)[pixels[:, 1], pixels[:, 0]]
        score[row, worst] = value
        light[row, worst] = (colour / 255.0) ** GAMMA
        image[row, worst] = view.number
        age[row, worst] = view.t_gps_s - t[row]
    many = np.isfinite(score).sum(axis=1)
    has, several = many > 0, many > 1
    rgb = np.full((n, 3), UNSEEN_GREY, dtype=np.uint8)
    scatter = np.full(n, np.nan, dtype=np.float32)
    if has.any():
        rgb[has] = np.round(255 * np.nanmedian(light[has], axis=1) ** (1 / GAMMA)).astype(np.uint8)
    if several.any():
        scatter[several] = np.nanstd(255 * light[several].mean(axis=2) ** (1 / GAMMA), axis=1, ddof=1)
    best = score.argmin(axis=1)[:, None]
    reason = np.full(n, NoColour.HIDDEN, dtype=np.int64)
    reason[~usable] = NoColour.MASKED
    reason[~shown] = NoColour.NOT_SHOWN
    reason[has] = NoColour.COLOURED
    return {
        "rgb": rgb,
        "n_views": many.astype(np.uint8),
        "colour_sigma": scatter,
        "image": np.take_along_axis(image, best, axis=1)[:, 0],
        "age_s": np.take_along_axis(age, best, axis=1)[:, 0],
        "reason": reason,
    }
