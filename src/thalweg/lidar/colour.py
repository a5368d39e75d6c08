r"""A lidar cloud in the colours of photographs.

A point takes the colours of the best few photographs that show it: taken within a time and a distance of it,
not masked, and not behind something nearer. What is nearer is known from the cloud itself: for each
photograph the least range of the cloud in cells of some tenths of a degree, widened by a cell to each side,
because a scanner leaves gaps between its lines. A point is hidden where its range is larger than that by more
than a step and twice what it and the photograph's pose are uncertain along it.

Of several views those with the smallest pixel on the point and the least age count; their median in linear
light is the colour, and their scatter its standard deviation. Before that, photographs are brought to one
exposure: a gain for each of them and each colour is adjusted from points that several show. A point that no
photograph shows has no colour and is counted with the reason; it is never black by accident, but grey, and
its number of views is 0.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

import numpy as np
import pandas as pd
from scipy import sparse
from scipy.ndimage import minimum_filter
from scipy.sparse import csgraph

from thalweg.core import (
    NMAD,
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayI,
    ArrayU8,
    Camera,
    CoverageError,
    InputError,
    LazWriter,
    frame_in_words,
    iter_laz,
    laz_header,
    njit,
    prange,
)
from thalweg.images.model import ImagePoses
from thalweg.ingest.photos import read_mask
from thalweg.lidar.cloud import CORRELATION_DIMENSIONS, EXTRA_DIMENSIONS, columns_to_write
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
_BLOCK: Final = 2048
"""Neighbours in the file, which lie in one sector of a scan: most photographs miss all of a block."""
_CHUNK: Final = 4_000_000
"""Points in memory; each photograph is opened once for so many."""
_SAMPLE: Final = 100_000
"""Points whose views are compared for the exposures."""
_SHOWN, _USABLE = 1, 2
_DARK, _BRIGHT = 15, 240
"""Darker or brighter pixels tell nothing of an exposure."""
_PRIOR: Final = 0.3
"""Exposures of one camera are known to be so equal beforehand: one sigma of the logarithm of light."""
_HUBER: Final = 1.5
_ROUNDS: Final = 6
_LEAST_SPREAD: Final = 0.01
_LIGHT: Final = (np.arange(256) / 255.0) ** GAMMA
T = TypeVar("T")
U = TypeVar("U")


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


class Lens(NamedTuple):
    """A camera as the kernels take it: parameters, width and height, widest angle from the axis and width of
    a pixel (radians).
    """

    fisheye: bool
    parameters: ArrayF
    size_px: ArrayF
    widest_rad: float
    pixel_rad: float


def lens_of(camera: Camera) -> Lens:
    """The same camera."""
    width, height = camera.size_px
    edge, ones = np.linspace(0, 1, 33), np.ones(33)
    border = np.vstack(
        [np.column_stack([edge * width, y * ones]) for y in (0, height)]
        + [np.column_stack([x * ones, edge * height]) for x in (0, width)]
    )
    z = camera.rays(border)[:, 2]
    # a border that the model does not reach leaves all that it does
    whole = np.pi if camera.model == "fisheye" else np.pi / 2
    widest = min(whole, 1.05 * float(np.arccos(z).max()) + 0.01) if np.isfinite(z).all() else whole
    return Lens(
        fisheye=camera.model == "fisheye",
        parameters=camera.parameters,
        size_px=np.array(camera.size_px, dtype=np.float64),
        widest_rad=widest,
        pixel_rad=1.0 / float(np.mean(camera.parameters[:2])),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Photographs:
    """Photographs of one lens.

    Parameters
    ----------
    poses : with times of exposure.
    images, masks : files by name; an image without a mask may be used everywhere.
    camera : of all images.
    cut : takes the picture (h, w, 3) of the lens out of that of a file; None: it is the file.
    file_px : width and height of the files, where they are not those of the camera.
    widest_rad : angle from the axis up to which the lens may be used.
    """

    poses: ImagePoses
    images: Mapping[str, Path]
    masks: Mapping[str, Path]
    camera: Camera
    cut: Callable[[AnyArray], AnyArray] | None = None
    file_px: tuple[int, int] | None = None
    widest_rad: float = np.pi

    def lens(self) -> Lens:
        """The camera as the kernels take it."""
        lens = lens_of(self.camera)
        return lens._replace(widest_rad=min(lens.widest_rad, self.widest_rad))

    def read(self, path: Path) -> AnyArray:
        """The picture (h, w, 3) of the lens in a file."""
        picture = read_picture(path, self.file_px or self.camera.size_px)
        return picture if self.cut is None else self.cut(picture)


@dataclass(frozen=True, slots=True, kw_only=True)
class Views:
    """Photographs that may give colours.

    Parameters
    ----------
    number : (v,) of the images among the poses, those of the second lens behind those of the first.
    names : of the images.
    lenses, of : the lenses, and (v,) which of them took each photograph.
    sources : the photographs of each lens.
    t_gps_s : (v,) times of exposure.
    centre_m, R_wcs_ccs : (v, 3), (v, 3, 3) poses.
    sigma_m : (v,) standard deviation of each centre, the largest of the axes.
    paths, masks : the photographs, and where they may be used; None: everywhere.
    nearest_m : v times (rows, columns), least range of the cloud in cells of the picture; infinite: nothing.
    cell_px : width of a cell by lens.
    """

    number: ArrayI
    names: list[str]
    lenses: tuple[Lens, ...]
    of: ArrayI
    sources: tuple[Photographs, ...]
    t_gps_s: ArrayF
    centre_m: ArrayF
    R_wcs_ccs: ArrayF
    sigma_m: ArrayF
    paths: list[Path]
    masks: list[Path | None]
    nearest_m: list[AnyArray]
    cell_px: tuple[int, ...]

    def read(self, v: int) -> AnyArray:
        """The picture (h, w, 3) of a view."""
        return self.sources[self.of[v]].read(self.paths[v])


@dataclass(frozen=True, slots=True, kw_only=True)
class Chosen:
    """The best views of points.

    Parameters
    ----------
    view : (n, k) places among the views, -1: none.
    pixel : (n, k, 2) x and y in them, from the upper left corner.
    score : (n, k) size of a pixel on the point, and age, the less the better.
    state : (n,) whether some view shows a point, and whether it may be used there (bits).
    """

    view: AnyArray
    pixel: AnyArray
    score: AnyArray
    state: ArrayU8


@dataclass(frozen=True, slots=True, kw_only=True)
class Coloured:
    """What became of the points and of the photographs.

    Parameters
    ----------
    counts : columns reason, words, n; they add up to all points.
    gains : columns image, gain_red, gain_green, gain_blue, sigma, n: a row a photograph, its light over that
        of all, the relative standard deviation of a gain, and the points that tell.
    """

    counts: pd.DataFrame
    gains: pd.DataFrame


# ---------------------------------------------------------------- which photographs show a point


@njit(inline="always", cache=True, error_model="numpy")
def _pixel(x: float, y: float, z: float, fisheye: bool, p: ArrayF) -> tuple[float, float]:
    """`thalweg.core.Camera.project` of one point; NaN where there is no image."""
    if fisheye:
        h = np.sqrt(x * x + y * y)
        t = np.arctan2(h, z)
        q = t * t
        if 1 + q * (3 * p[4] + q * (5 * p[5] + q * (7 * p[6] + q * 9 * p[7]))) <= 0:
            return np.nan, np.nan
        if h < 1e-12 * abs(z):
            ratio = 1.0 / z if z > 0 else np.nan
        else:
            ratio = t * (1 + q * (p[4] + q * (p[5] + q * (p[6] + q * p[7])))) / h
        return p[0] * x * ratio + p[2], p[1] * y * ratio + p[3]
    if z <= 0:
        return np.nan, np.nan
    a, b = x / z, y / z
    q = a * a + b * b
    radial = 1 + q * (p[4] + q * (p[5] + q * p[8]))
    # where the distorted radius no longer grows the polynomial folds back
    if radial + 2 * q * (p[4] + q * (2 * p[5] + 3 * p[8] * q)) <= 0:
        return np.nan, np.nan
    u = a * radial + 2 * p[6] * a * b + p[7] * (q + 2 * a * a)
    v = b * radial + p[6] * (q + 2 * b * b) + 2 * p[7] * a * b
    return p[0] * u + p[2], p[1] * v + p[3]


@njit(inline="always", cache=True, error_model="numpy")
def _seen(
    xyz: ArrayF, centre: ArrayF, R: ArrayF, lens: Lens, reach: float, cosine: float
) -> tuple[float, float, float]:
    """Pixel and range of a point (3,) in a photograph; range -1: not in it."""
    dx, dy, dz = xyz[0] - centre[0], xyz[1] - centre[1], xyz[2] - centre[2]
    z = dx * R[0, 2] + dy * R[1, 2] + dz * R[2, 2]
    r2 = dx * dx + dy * dy + dz * dz
    if r2 > reach * reach or z < cosine * np.sqrt(r2):
        return 0.0, 0.0, -1.0
    if (r2 if lens.fisheye else z * abs(z)) <= _NEAREST_M**2:
        return 0.0, 0.0, -1.0
    x = dx * R[0, 0] + dy * R[1, 0] + dz * R[2, 0]
    y = dx * R[0, 1] + dy * R[1, 1] + dz * R[2, 1]
    u, v = _pixel(x, y, z, lens.fisheye, lens.parameters)
    if not (0 <= u <= lens.size_px[0] and 0 <= v <= lens.size_px[1]):
        return 0.0, 0.0, -1.0
    # a pixel on the very edge belongs to the picture
    return min(u, lens.size_px[0] - 1e-6), min(v, lens.size_px[1] - 1e-6), np.sqrt(r2)


@njit(inline="always", cache=True, error_model="numpy")
def _missed(ball: ArrayF, centre: ArrayF, R: ArrayF, lens: Lens, reach: float) -> bool:
    """Whether a photograph misses all of a ball (x, y, z, radius): too far, or outside its widest cone."""
    dx, dy, dz = ball[0] - centre[0], ball[1] - centre[1], ball[2] - centre[2]
    d = np.sqrt(dx * dx + dy * dy + dz * dz)
    if d > reach + ball[3]:
        return True
    if d <= ball[3]:
        return False
    z = dx * R[0, 2] + dy * R[1, 2] + dz * R[2, 2]
    return np.arccos(min(1.0, max(-1.0, z / d))) - np.arcsin(ball[3] / d) > lens.widest_rad


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def _nearest(
    xyz: ArrayF,
    balls: ArrayF,
    centre: ArrayF,
    R: ArrayF,
    lens: Lens,
    reach: float,
    cell: int,
    nearest: AnyArray,
) -> None:
    """Take points (n, 3) into the least ranges of all photographs."""
    cosine = np.cos(lens.widest_rad)
    for v in prange(len(centre)):
        for b in range(len(balls)):
            if _missed(balls[b], centre[v], R[v], lens, reach):
                continue
            for i in range(b * _BLOCK, min(len(xyz), (b + 1) * _BLOCK)):
                x, y, r = _seen(xyz[i], centre[v], R[v], lens, reach, cosine)
                if r > 0:
                    row, column = int(y) // cell, int(x) // cell
                    if r < nearest[v, row, column]:
                        nearest[v, row, column] = r


@njit(cache=True, nogil=True, error_model="numpy")
def seen_pixels(
    xyz: ArrayF, centre: ArrayF, R: ArrayF, lens: Lens, reach: float
) -> tuple[ArrayI, ArrayF, ArrayF]:
    """Points (n, 3) that a photograph shows: their rows (k,), pixels (k, 2) and ranges (k,)."""
    rows, pixels, ranges = np.empty(len(xyz), np.int64), np.empty((len(xyz), 2)), np.empty(len(xyz))
    n = 0
    cosine = np.cos(lens.widest_rad)
    for i in range(len(xyz)):
        x, y, r = _seen(xyz[i], centre, R, lens, reach, cosine)
        if r > 0:
            rows[n], pixels[n, 0], pixels[n, 1], ranges[n] = i, x, y, r
            n += 1
    return rows[:n], pixels[:n], ranges[:n]


class Rules(NamedTuple):
    """What of the settings decides whether a photograph may colour a point."""

    reach_m: float
    window_s: float
    cell_px: int
    step_m: float
    step_share: float


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def _offer(
    xyz: ArrayF, t: ArrayF, sigma: ArrayF, balls: ArrayF, centre: ArrayF, R: ArrayF, lens: Lens, rules: Rules,
    view: int, t_view: float, sigma_view: float, mask: AnyArray, nearest: AnyArray,
    chosen: AnyArray, pixel: AnyArray, score: AnyArray, state: ArrayU8,
) -> None:  # fmt: skip
    """Offer a photograph to points (n, 3): it takes the place of their worst view where it is better."""
    cosine = np.cos(lens.widest_rad)
    for b in prange(len(balls)):
        if _missed(balls[b], centre, R, lens, rules.reach_m):
            continue
        for i in range(b * _BLOCK, min(len(xyz), (b + 1) * _BLOCK)):
            age = abs(t[i] - t_view)
            if age > rules.window_s:
                continue
            x, y, r = _seen(xyz[i], centre, R, lens, rules.reach_m, cosine)
            if r < 0:
                continue
            state[i] |= _SHOWN
            if mask.size:
                # the colour is interpolated from four pixels: one of sky would tint a thin crown
                usable = True
                for corner in range(4):
                    v = max(y - 0.5 + corner // 2, 0.0) * (mask.shape[0] / lens.size_px[1])
                    u = max(x - 0.5 + corner % 2, 0.0) * (mask.shape[1] / lens.size_px[0])
                    usable &= mask[min(int(v), mask.shape[0] - 1), min(int(u), mask.shape[1] - 1)]
                if not usable:
                    continue
            state[i] |= _USABLE
            # a surface seen at a slant differs in range within a cell
            step = rules.step_m + rules.step_share * r + 2 * np.sqrt(sigma[i] ** 2 + sigma_view**2)
            if r > nearest[int(y) // rules.cell_px, int(x) // rules.cell_px] + step:
                continue
            value = (1.0 + age / rules.window_s) * r * lens.pixel_rad
            worst = 0
            for k in range(1, score.shape[1]):
                if score[i, k] > score[i, worst]:
                    worst = k
            if value < score[i, worst]:
                score[i, worst] = value
                chosen[i, worst] = view
                pixel[i, worst, 0], pixel[i, worst, 1] = x, y


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def _blend(
    view: AnyArray, values: ArrayU8, table: ArrayF, gains: ArrayF, rgb: ArrayU8, scatter: AnyArray
) -> None:
    """Median (n, 3) of the colours of each point's views in linear light, and the scatter of brightness."""
    most = view.shape[1]
    for i in prange(len(view)):
        light = np.empty((3, most))
        n = 0
        total = square = 0.0
        for k in range(most):
            if view[i, k] < 0:
                continue
            for c in range(3):
                light[c, n] = table[values[i, k, c]] / gains[view[i, k], c]
            bright = 255.0 * ((light[0, n] + light[1, n] + light[2, n]) / 3.0) ** (1 / GAMMA)
            total += bright
            square += bright * bright
            n += 1
        if not n:
            continue
        for c in range(3):
            row = np.sort(light[c, :n])
            middle = 0.5 * (row[(n - 1) // 2] + row[n // 2])
            rgb[i, c] = min(255, int(np.round(255.0 * middle ** (1 / GAMMA))))
        if n > 1:
            scatter[i] = np.sqrt(max(0.0, square - total * total / n) / (n - 1))


def views_of(points: Path, sources: Sequence[Photographs], settings: Colour) -> Views:
    """The oriented images with a time, each with an empty map of ranges.

    Parameters
    ----------
    points : the cloud, in the frame of the poses.
    sources : photographs of one or more lenses.
    settings : section ``colour``.

    Raises
    ------
    InputError : the cloud lies in another frame.
    CoverageError : no image has pose, time and file.
    """
    parts = [_views_of_lens(points, source, settings) for source in sources]
    if not any(len(part.number) for part in parts):
        raise CoverageError(
            f"none of {sum(len(each.poses.images) for each in sources)} images has a pose, a time and a file",
            expected="oriented photographs of the survey",
            cure="Look at orientation/image_poses_timed.parquet and logs.time_lapse",
        )
    before = np.cumsum([0, *(len(each.poses.images) for each in sources)])
    return Views(
        number=np.concatenate([part.number + b for part, b in zip(parts, before[:-1], strict=True)]),
        names=[name for part in parts for name in part.names],
        lenses=tuple(each.lens() for each in sources),
        of=np.repeat(np.arange(len(sources)), [len(part.number) for part in parts]),
        sources=tuple(sources),
        t_gps_s=np.concatenate([part.t_gps_s for part in parts]),
        centre_m=np.concatenate([part.centre_m for part in parts]),
        R_wcs_ccs=np.concatenate([part.R_wcs_ccs for part in parts]),
        sigma_m=np.concatenate([part.sigma_m for part in parts]),
        paths=[path for part in parts for path in part.paths],
        masks=[mask for part in parts for mask in part.masks],
        nearest_m=[nearest for part in parts for nearest in part.nearest_m],
        cell_px=tuple(part.cell_px[0] for part in parts),
    )


def _views_of_lens(points: Path, source: Photographs, settings: Colour) -> Views:
    """The photographs of one lens that can be used."""
    poses, camera, images, masks = source.poses, source.camera, source.images, source.masks
    frame = laz_header(points).frame
    if frame != poses.frame:
        raise InputError(
            f"a cloud in the frame {frame_in_words(frame)}",
            expected=f"that of the image poses, {frame_in_words(poses.frame)}",
            where=points,
            cure="Colour the cloud of the same campaign",
        )
    middle = np.array(camera.size_px) / 2
    a, b = camera.rays(np.stack([middle, middle + np.array([10.0, 0.0])]))
    cell_px = max(2, round(10.0 / float(np.linalg.norm(a - b)) * np.deg2rad(settings.cell_deg)))
    rows = [
        k
        for k, name in enumerate(poses.images)
        if poses.oriented[k] and np.isfinite(poses.t_gps_s[k]) and name in images
    ]
    shape = (-(-camera.size_px[1] // cell_px), -(-camera.size_px[0] // cell_px))
    variances = np.diagonal(poses.cov_pose_wcs[rows], axis1=1, axis2=2)[:, :3]
    return Views(
        number=np.array(rows, dtype=np.int64),
        names=[poses.images[k] for k in rows],
        lenses=(source.lens(),),
        of=np.zeros(len(rows), dtype=np.int64),
        sources=(source,),
        t_gps_s=poses.t_gps_s[rows],
        centre_m=np.ascontiguousarray(poses.centre_wcs_m[rows]),
        R_wcs_ccs=np.ascontiguousarray(poses.R_wcs_ccs[rows]),
        sigma_m=np.sqrt(variances.max(axis=1, initial=0.0)),
        paths=[images[poses.images[k]] for k in rows],
        masks=[masks.get(poses.images[k]) for k in rows],
        nearest_m=[np.full(shape, np.inf, dtype=np.float32) for _ in rows],
        cell_px=(cell_px,),
    )


def _balls(xyz_m: ArrayF) -> ArrayF:
    """Balls (b, 4) about the boxes of blocks of points: middle and radius."""
    first = np.arange(0, len(xyz_m), _BLOCK)
    low, high = np.minimum.reduceat(xyz_m, first), np.maximum.reduceat(xyz_m, first)
    return np.column_stack([(low + high) / 2, np.linalg.norm(high - low, axis=1) / 2 + 1e-6])


def _concerned(
    views: Views, xyz_m: ArrayF, t_gps_s: ArrayF, settings: Colour, *, any_time: bool = False
) -> ArrayI:
    """Views that may show some of the points, by the box about these and their times."""
    low, high = xyz_m.min(axis=0), xyz_m.max(axis=0)
    away = np.maximum(np.maximum(low - views.centre_m, views.centre_m - high), 0.0)
    near = np.linalg.norm(away, axis=1) < settings.max_range_m
    if any_time:
        return np.flatnonzero(near)
    in_time = (views.t_gps_s >= t_gps_s.min() - settings.window_s) & (
        views.t_gps_s <= t_gps_s.max() + settings.window_s
    )
    return np.flatnonzero(near & in_time)


def choose_views(
    chunk: Mapping[str, AnyArray], views: Views, settings: Colour, pool: ThreadPoolExecutor
) -> Chosen:
    """The best views of some points.

    Parameters
    ----------
    chunk : columns ``xyz_m``, ``t_gps_s`` and the three sigmas.
    views : photographs with their maps of ranges.
    settings : section ``colour``.
    pool : opens the masks.

    Raises
    ------
    InputError : a mask cannot be read, or is none of its photograph.
    """
    xyz, t = np.ascontiguousarray(chunk["xyz_m"]), chunk["t_gps_s"]
    n, k = len(xyz), settings.views
    sigma = np.maximum(chunk["sigma_east"], np.maximum(chunk["sigma_north"], chunk["sigma_up"]))
    found = Chosen(
        view=np.full((n, k), -1, dtype=np.int32),
        pixel=np.zeros((n, k, 2), dtype=np.float32),
        score=np.full((n, k), np.inf, dtype=np.float32),
        state=np.zeros(n, dtype=np.uint8),
    )
    rules = [
        Rules(
            reach_m=settings.max_range_m,
            window_s=settings.window_s,
            cell_px=cell_px,
            step_m=settings.step_m,
            step_share=settings.step_share,
        )
        for cell_px in views.cell_px
    ]
    balls, concerned = _balls(xyz), _concerned(views, xyz, t, settings)
    masks = _ahead(pool, _mask, [(views.masks[v], views.lenses[views.of[v]].size_px) for v in concerned])
    for v, mask in zip(concerned, masks, strict=True):
        _offer(
            xyz, t, sigma, balls, views.centre_m[v], views.R_wcs_ccs[v], views.lenses[views.of[v]],
            rules[views.of[v]], v, views.t_gps_s[v], views.sigma_m[v], mask, views.nearest_m[v],
            found.view, found.pixel, found.score, found.state,
        )  # fmt: skip
    return found


# ---------------------------------------------------------------- colours


def _ahead(
    pool: ThreadPoolExecutor, read: Callable[[U], T], items: Iterable[U], ahead: int = 4
) -> Iterator[T]:
    """Results of a reader in order, a few of them read ahead by other threads."""
    waiting: deque[Future[T]] = deque()
    for item in items:
        waiting.append(pool.submit(read, item))
        if len(waiting) > ahead:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def _interpolate(picture: ArrayU8, rows: ArrayI, pixel: AnyArray, colours: ArrayU8) -> None:
    """Colours (n, 3) at places (n, 2) of some rows, linear between the middles of pixels."""
    h, w = picture.shape[:2]
    for j in prange(len(rows)):
        i = rows[j]
        x = min(max(pixel[i, 0] - 0.5, 0.0), w - 1.0)
        y = min(max(pixel[i, 1] - 0.5, 0.0), h - 1.0)
        a, b = min(int(x), w - 2), min(int(y), h - 2)
        s, t = x - a, y - b
        for c in range(3):
            above = (1 - s) * picture[b, a, c] + s * picture[b, a + 1, c]
            below = (1 - s) * picture[b + 1, a, c] + s * picture[b + 1, a + 1, c]
            colours[i, c] = int((1 - t) * above + t * below + 0.5)


def _sampled(chosen: Chosen, views: Views, pool: ThreadPoolExecutor) -> ArrayU8:
    """Colours (n, k, 3) at the chosen places; each photograph is opened once."""
    values = np.zeros((*chosen.view.shape, 3), dtype=np.uint8)
    flat, pixel = values.reshape(-1, 3), chosen.pixel.reshape(-1, 2)
    order = np.argsort(chosen.view, axis=None, kind="stable")
    first = np.searchsorted(chosen.view.ravel()[order], np.arange(len(views.paths) + 1))
    used = np.flatnonzero(np.diff(first)).tolist()
    for v, picture in zip(used, _ahead(pool, views.read, used), strict=True):
        _interpolate(np.ascontiguousarray(picture), order[first[v] : first[v + 1]], pixel, flat)
    return values


def exposure_gains(
    view: AnyArray, values: ArrayU8, n_views: int, level: AnyArray | float = 1.0
) -> tuple[ArrayF, ArrayF, ArrayI]:
    """Gains that bring photographs to one exposure, from points that several of them show.

    The logarithm of the light of a point in a photograph is that of the point plus the gain of the
    photograph; both are adjusted by least squares, the points eliminated, values that do not fit weighted
    down (Huber). A weak prior that gains are 1 holds photographs that share no points, and the level of all.

    Parameters
    ----------
    view : (n, k) photographs of each point, -1: none.
    values : (n, k, 3) their 8-bit colours.
    n_views : number of photographs.
    level : light (n, k, 3) of each value by what is known of its gain already.

    Returns
    -------
    gains : (v, 3) light of a photograph over that of all, by colour.
    sigma : (v,) standard deviation of its logarithm against their mean, the largest of the colours.
    n : (v,) points that tell.
    """
    # what is nearly black or saturated tells nothing of the exposure
    good = (view >= 0) & (values.min(axis=2) >= _DARK) & (values.max(axis=2) <= _BRIGHT)
    good &= (good.sum(axis=1) > 1)[:, None]
    photograph, (_, point) = view[good], np.unique(np.nonzero(good)[0], return_inverse=True)
    gains, variance = np.ones((n_views, 3)), np.full((n_views, 3), _PRIOR**2)
    if not len(point):
        return gains, np.sqrt(variance[:, 0]), np.zeros(n_views, dtype=np.int64)
    many = np.bincount(point)[point]
    known = np.broadcast_to(np.asarray(level), values.shape)[good]
    for colour in range(3):
        light = GAMMA * np.log(values[good][:, colour] / 255.0) - np.log(known[:, colour])
        weight, found, spread = np.ones(len(light)), np.zeros(n_views), 1.0
        for _ in range(_ROUNDS):
            W = sparse.csr_array((weight, (point, photograph)), shape=(point.max() + 1, n_views))
            # each point takes the weighted mean of its photographs out of the normal equations
            of_point = W.sum(axis=1)
            N = np.diag(W.sum(axis=0)) - (W.T @ (sparse.diags_array(1 / of_point) @ W)).toarray()
            rest = weight * (light - (np.bincount(point, weight * light) / of_point)[point])
            inverse = np.linalg.inv(N + np.eye(n_views) * (spread / _PRIOR) ** 2)
            found = inverse @ np.bincount(photograph, rest, minlength=n_views)
            residual = light - found[photograph]
            residual -= (np.bincount(point, weight * residual) / of_point)[point]
            # the mean of few follows each of them
            residual *= np.sqrt(many / (many - 1))
            spread = max(NMAD * float(np.median(np.abs(residual))), _LEAST_SPREAD)
            weight = np.minimum(1.0, _HUBER * spread / np.maximum(np.abs(residual), 1e-12))
        # gains are those against the mean of the photographs that points connect; one alone keeps the prior
        _, group = csgraph.connected_components(sparse.csr_array(N))
        size = np.bincount(group)[group]
        S = np.eye(n_views) - (group[:, None] == group) * np.where(size > 1, 1 / size, 0.0)
        gains[:, colour] = np.exp(S @ found)
        variance[:, colour] = spread**2 * np.einsum("ij,jk,ik->i", S, inverse, S)
    return gains, np.sqrt(variance.max(axis=1)), np.bincount(photograph, minlength=n_views)


def view_gains(
    view: AnyArray, values: ArrayU8, lens: ArrayI, t_gps_s: ArrayF
) -> tuple[ArrayF, ArrayF, ArrayI]:
    """Gains of photographs, some of which lenses of one rig took at once.

    A plant is brighter seen from where the sun stands. Lenses that look apart have few points in common but
    from different sides, so that such points would tell of the sides and not of the lenses: in the twin they
    put the back lens of a rig at 1.2 to 1.5 times the light of the front lens instead of 1.12. What lenses of
    one exposure differ by is therefore told by those points alone that several of them show at once; all
    others tell of the exposures.

    Parameters
    ----------
    view, values : as of `exposure_gains`.
    lens, t_gps_s : (v,) lens and time of each photograph.

    Returns
    -------
    gains, sigma, n : as of `exposure_gains`.
    """
    n = len(lens)
    exposure = np.unique(np.round(t_gps_s, 6), return_inverse=True, equal_nan=False)[1]
    own, sigma_own = np.ones((n, 3)), np.zeros(n)
    # points that several photographs of one exposure show
    places = [(i, j) for i in range(view.shape[1]) for j in range(i)]
    shown, of = view >= 0, exposure[view]
    rows = [np.flatnonzero(shown[:, i] & shown[:, j] & (of[:, i] == of[:, j])) for i, j in places]
    at = np.concatenate([*rows, np.empty(0, np.int64)]).astype(np.int64)
    if len(at):
        columns = np.repeat(np.array(places), [len(each) for each in rows], axis=0)
        pairs, light = view[at[:, None], columns], values[at[:, None], columns]
        usual = exposure_gains(lens[pairs], light, int(lens.max()) + 1)[0][lens]
        more, sigma_own, _ = exposure_gains(pairs, light, n, usual[pairs])
        own = usual * more
    gains, sigma, told = exposure_gains(np.where(shown, of, -1), values, int(exposure.max()) + 1, own[view])
    return own * gains[exposure], np.hypot(sigma_own, sigma[exposure]), told[exposure]


def colour_cloud(
    points: Path, out: Path, sources: Sequence[Photographs], settings: Colour, *, occlusion: bool = True
) -> Coloured:
    """Give the points of a cloud colours.

    Parameters
    ----------
    points : LAZ of `thalweg.lidar.georeference_log`, in the frame of the poses.
    out : target: the same points with colours and `COLOUR_DIMENSIONS`.
    sources : photographs of one or more lenses; ``image`` counts through those of all.
    settings : section ``colour``.
    occlusion : leave out hidden points; False shows what that is worth.

    Raises
    ------
    InputError : the cloud lies in another frame, or a photograph cannot be read.
    CoverageError : no image can be used.
    """
    header = laz_header(points)
    views = views_of(points, sources, settings)
    sample = survey_cloud(points, views, settings, occlusion=occlusion)
    known = EXTRA_DIMENSIONS | CORRELATION_DIMENSIONS
    extra = {name: known[name] for name in header.extra_dimensions if name in known}
    counts = np.zeros(len(NoColour), dtype=np.int64)
    with (
        ThreadPoolExecutor(max_workers=2) as pool,
        LazWriter(
            out,
            header.frame,
            scale_m=header.scale_m,
            offset_m=header.offsets_m,
            extra_dimensions=extra | COLOUR_DIMENSIONS,
        ) as writer,
    ):
        gains, table = _exposures(sample, views, settings, pool)
        for chunk in iter_laz(points, _CHUNK):
            chosen = choose_views(chunk, views, settings, pool)
            values = _sampled(chosen, views, pool)
            found = _coloured(chunk, chosen, values, views, gains)
            counts += np.bincount(found["reason"], minlength=len(NoColour))
            writer.append(**columns_to_write(chunk | found, [*extra, *COLOUR_DIMENSIONS]), rgb=found["rgb"])
    rows = [(reason.name.lower(), NO_COLOUR[reason], int(counts[reason])) for reason in NoColour]
    table.insert(0, "image", views.names)
    table.insert(1, "number", views.number)
    return Coloured(counts=pd.DataFrame(rows, columns=["reason", "words", "n"]), gains=table)


def survey_cloud(
    points: Path, views: Views, settings: Colour, *, occlusion: bool = True, most: int = _SAMPLE
) -> dict[str, AnyArray]:
    """Fill the maps of ranges of the views from all points, and hold an even sample of about so many."""
    every = max(1, laz_header(points).n_points // most)
    parts: dict[str, list[AnyArray]] = {
        name: [] for name in ("xyz_m", "t_gps_s", "intensity", "sigma_east", "sigma_north", "sigma_up")
    }
    for chunk in iter_laz(points):
        for name, held in parts.items():
            held.append(chunk[name][::every].copy())  # a view would keep the whole piece
        concerned = _concerned(views, chunk["xyz_m"], chunk["t_gps_s"], settings, any_time=True)
        if occlusion and len(concerned):
            xyz = np.ascontiguousarray(chunk["xyz_m"])
            balls = _balls(xyz)
            for k, (lens, cell_px) in enumerate(zip(views.lenses, views.cell_px, strict=True)):
                v = concerned[views.of[concerned] == k]
                if not len(v):
                    continue
                nearest = np.stack([views.nearest_m[i] for i in v])
                centre, R = views.centre_m[v], views.R_wcs_ccs[v]
                _nearest(xyz, balls, centre, R, lens, settings.max_range_m, cell_px, nearest)
                for i, found in zip(v, nearest, strict=True):
                    views.nearest_m[i][:] = found
    for nearest in views.nearest_m:
        nearest[:] = minimum_filter(nearest, size=3)
    return {name: np.concatenate(held) for name, held in parts.items()}


def _exposures(
    sample: Mapping[str, AnyArray], views: Views, settings: Colour, pool: ThreadPoolExecutor
) -> tuple[ArrayF, pd.DataFrame]:
    """Gains (v, 3) of the photographs, 1 where they are not wanted, and their table."""
    n = len(views.paths)
    gains, sigma, told = np.ones((n, 3)), np.zeros(n), np.zeros(n, dtype=np.int64)
    if settings.even_exposures:
        # one view of each point tells nothing, whatever the colours are made of
        several = settings.model_copy(update={"views": max(settings.views, Colour().views)})
        chosen = choose_views(sample, views, several, pool)
        gains, sigma, told = view_gains(
            chosen.view, _sampled(chosen, views, pool), np.asarray(views.of), np.asarray(views.t_gps_s)
        )
    columns = {f"gain_{name}": gains[:, k] for k, name in enumerate(("red", "green", "blue"))}
    return gains, pd.DataFrame(columns | {"sigma": sigma, "n": told})


def read_picture(path: Path, size_px: tuple[int, int]) -> AnyArray:
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


def _mask(of: tuple[Path | None, tuple[int, int]]) -> ArrayB:
    """Where a photograph of a size may be used (h, w), of whatever scale; of no size: everywhere."""
    path, size_px = of
    return np.zeros((0, 0), dtype=np.bool_) if path is None else read_mask(path, size_px)


def _coloured(
    chunk: Mapping[str, AnyArray], chosen: Chosen, values: ArrayU8, views: Views, gains: ArrayF
) -> dict[str, AnyArray]:
    """Colours of some points, their views, scatter, age, and why there is none."""
    n = len(chosen.view)
    many = (chosen.view >= 0).sum(axis=1)
    rgb = np.full((n, 3), UNSEEN_GREY, dtype=np.uint8)
    scatter = np.full(n, np.nan, dtype=np.float32)
    _blend(chosen.view, values, _LIGHT, gains, rgb, scatter)
    best = np.take_along_axis(chosen.view, chosen.score.argmin(axis=1)[:, None], axis=1)[:, 0]
    reason = np.full(n, NoColour.HIDDEN, dtype=np.int64)
    reason[chosen.state & _USABLE == 0] = NoColour.MASKED
    reason[chosen.state & _SHOWN == 0] = NoColour.NOT_SHOWN
    reason[many > 0] = NoColour.COLOURED
    return {
        "rgb": rgb,
        "n_views": many.astype(np.uint8),
        "colour_sigma": scatter,
        "image": np.where(many > 0, views.number[best], -1).astype(np.int32),
        "age_s": np.where(many > 0, views.t_gps_s[best] - chunk["t_gps_s"], np.nan).astype(np.float32),
        "reason": reason,
    }
