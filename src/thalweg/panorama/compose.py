"""Two views become one panorama: where both lenses see a thing, their light, the seam, and its error.

A ray of the panorama meets something at the range that the mode gives; that point is projected into both
lenses. Where both see it, the seam runs along the way about the axis on which they agree best (dynamic
programming, closed), and the light of the lenses is brought to one level by the overlap. Details come from
one lens alone, so that nothing is seen twice; broad differences of light fade over some degrees (two bands,
Burt and Adelson 1983).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import ndimage

from thalweg.calibration import LENSES, Rig
from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayU8, njit, optional
from thalweg.lidar import GAMMA, exposure_gains
from thalweg.panorama.sphere import sphere_rays

cv2 = optional("cv2")

_AROUND: Final = 720
"""Places around the axis at which the seam is looked for: half a degree."""
_ACROSS_DEG: Final = 0.25
_STEPS: Final = 2
"""The seam moves at most so many steps across from one place to the next."""
_FADE_DEG: Final = 5.0
_BLUR_PX: Final = 4.0
_ROW: Final = 16_384
_FINE_PX: Final = 2048
"""Wider panoramas are projected at every `_EACH` pixel along both sides, and between them linearly: a fisheye
of 200 px per radian bends by 0.001 px over that."""
_EACH: Final = 4
_NO_MASK: Final = np.zeros((0, 0), dtype=np.uint8)
_BACKGROUND: Final = 128
"""Grey of what no lens shows."""
RIM_DEG: Final = 1.0
"""The outermost part of an image circle is left out."""
_LEAST_TEXTURE: Final = 4.0
_LARGEST_SHIFT_DEG: Final = 1.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Composed:
    """A panorama and what its seam says.

    Parameters
    ----------
    picture : (h, w, 3) uint8, sRGB.
    shown : (h, w) whether a lens shows the pixel.
    front : (h, w) whether the front lens does.
    gains : (3,) light of the back lens over that of the front lens by colour.
    gain_sigma : relative standard deviation of a gain.
    seam_deg : (720,) angle of the seam from the view of the front lens at even azimuths about it.
    seam_px : (k,) shifts between both lenses across the seam where it has texture, pixels of the panorama.
    agreement : correlation of both lenses where they overlap, -1 to 1; NaN without texture.
    """

    picture: ArrayU8
    shown: ArrayB
    front: ArrayB
    gains: ArrayF
    gain_sigma: float
    seam_deg: ArrayF
    seam_px: ArrayF
    agreement: float

    @property
    def seam_rms_px(self) -> float:
        """Root mean square of the shifts across the seam but for the largest twentieth; NaN without any."""
        if len(self.seam_px) < 5:
            return float("nan")
        size = np.sort(np.abs(self.seam_px))
        return float(np.sqrt(np.mean(size[: int(np.ceil(0.95 * len(size)))] ** 2)))


def lens_pixels(
    rig: Rig, directions_front: ArrayF, inverse_range: AnyArray
) -> tuple[dict[str, ArrayF], dict[str, ArrayF]]:
    """Where both lenses see what lies in directions from the middle of the rig.

    Parameters
    ----------
    rig : calibrated.
    directions_front : (n, 3) unit directions in the frame of the front lens.
    inverse_range : (n,) of the things from the middle of the rig, 1/m; 0: infinitely far.

    Returns
    -------
    pixels : (n, 2) by lens, NaN outside the image circle.
    angle_deg : (n,) from the axis, by lens.
    """
    widest = rig.settings.field_of_view_deg / 2 - RIM_DEG
    pixels, angles = {}, {}
    for name, place in rig.T_front_lens.items():
        # homogeneous: a point at infinity does not know where the lens is
        local = (directions_front + inverse_range[:, None] * (rig.centre_front_m - place.shift_m)) @ place.R
        angle = np.rad2deg(np.arctan2(np.hypot(local[:, 0], local[:, 1]), local[:, 2]))
        xy = rig.cameras[name].project(local)
        seen = np.logical_and(angle < widest, rig.cameras[name].inside(xy, 1.0))
        xy[~seen] = np.nan
        pixels[name], angles[name] = xy, angle
    return pixels, angles


def _sampled(view: AnyArray, xy: ArrayF) -> AnyArray:
    """Values (n, ...) of a view at pixels (n, 2), bilinear; where NaN, those of its corner."""
    n = len(xy)
    # OpenCV takes at most 32,767 rows and columns, and counts from the centre of the first pixel
    flat = np.full((-(-n // _ROW) * _ROW, 2), -10.0, dtype=np.float32)
    flat[:n] = np.nan_to_num(xy, nan=-10.0) - 0.5
    maps = flat.reshape(-1, _ROW, 2)
    out = cv2.remap(view, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return out.reshape(-1, *view.shape[2:])[:n]


def compose(
    views: Mapping[str, ArrayU8],
    rig: Rig,
    R_front_pcs: ArrayF,
    inverse_range: AnyArray,
    *,
    masks: Mapping[str, ArrayB] | None = None,
    gains: ArrayF | None = None,
) -> Composed:
    """Sew both views of an exposure.

    Parameters
    ----------
    views : upright views (h, w, 3) uint8 by lens.
    rig : calibrated.
    R_front_pcs : attitude (3, 3) of the panorama in the frame of the front lens.
    inverse_range : (W / 2, W) of things from the middle of the rig, 1/m.
    masks : by lens, where a view may be used (h, w).
    gains : light of the back lens over that of the front lens by colour; None: from the overlap.
    """
    height, width = inverse_range.shape
    step = _EACH if width > _FINE_PX and width % _EACH == height % _EACH == 0 else 1
    shape = (height // step, width // step)
    few = inverse_range
    if step > 1:
        few = cv2.resize(inverse_range, shape[::-1], interpolation=cv2.INTER_AREA)
    directions = sphere_rays(shape[1]).reshape(-1, 3) @ R_front_pcs.T
    pixels, _ = lens_pixels(rig, directions, few.ravel())
    # where the mask of a lens, if it has one, is at least half
    covers = {name: np.asarray((masks or {}).get(name, _NO_MASK), dtype=np.uint8) for name in LENSES}
    usable = {name: np.isfinite(pixels[name][:, 0]) for name in LENSES}
    for name, cover in covers.items():
        if cover.size:
            usable[name] &= _sampled(cover * 255, pixels[name]) > 127
    colour = {name: _sampled(views[name], pixels[name]).astype(np.float32) for name in LENSES}
    both = usable["front"] & usable["back"]
    told = np.ones(3) if gains is None else np.asarray(gains, dtype=np.float64)
    sigma = 0.0
    if gains is None and both.sum() > 100:
        values = np.stack([colour[name][both] for name in LENSES], axis=1).astype(np.uint8)
        every = max(1, len(values) // 40_000)
        pairs = np.tile(np.arange(2), (len(values[::every]), 1))
        found, sigmas, _ = exposure_gains(pairs, values[::every], 2)
        told, sigma = found[1] / found[0], float(np.hypot(*sigmas))
    even = _evened(colour, told)
    seam = _seam(views, rig, R_front_pcs, inverse_range, masks, told)
    difference = np.where(both[:, None], even["front"] - even["back"], 0.0).reshape(*shape, 3)
    broad = _broad_difference(difference, both.reshape(shape))
    picture = np.empty((height, width, 3), dtype=np.uint8)
    front, back = (np.zeros((height, width), dtype=np.bool_) for _ in LENSES)
    _render(
        tuple(np.ascontiguousarray(views[name]) for name in LENSES),
        tuple(covers[name] for name in LENSES),
        tuple(_closed(pixels[name].reshape(*shape, 2).astype(np.float32)) for name in LENSES),
        _closed(broad),
        np.asarray(_levels(told), dtype=np.float32),
        np.r_[seam, seam[0]],
        np.ascontiguousarray(R_front_pcs),
        step,
        picture,
        front,
        back,
    )
    shifts, agreement = _seam_error(views, rig, R_front_pcs, inverse_range, seam, told)
    return Composed(
        picture=picture,
        shown=front | back,
        front=front,
        gains=told,
        gain_sigma=sigma,
        seam_deg=seam,
        seam_px=shifts * width / 360.0,
        agreement=agreement,
    )


@njit(cache=True, error_model="numpy", nogil=True)
def _render(  # type: ignore[no-untyped-def]
    views, masks, grids, broad, levels, seam, R, step, picture, front, back
):
    """Fill a picture: each pixel from the lens on its side of the seam, broad differences faded across it.

    Parameters
    ----------
    views, masks : (h, w, 3) and (h, w) or empty of both lenses.
    grids : (H / step + 2, W / step + 2, 2) their pixels, closed around the panorama; linear between.
    broad : (H / step + 2, W / step + 2, 3) broad difference of their light.
    levels : (2, 3) factors that bring their values to one level.
    seam : (721,) angle of the seam at even azimuths, degrees.
    R : attitude of the panorama in the frame of the front lens.
    picture, front, back : (H, W, 3), (H, W): filled; which lens shows a pixel.
    """
    height, width = front.shape
    xy, d, ok = np.empty((2, 2)), np.empty(3), np.empty(2, dtype=np.bool_)
    for v in range(height):
        lat = (0.5 - (v + 0.5) / height) * np.pi
        y = (v + 0.5) / step + 0.5
        i = int(y)
        fy = y - i
        for u in range(width):
            x = (u + 0.5) / step + 0.5
            j = int(x)
            fx = x - j
            for lens in range(2):
                for axis in range(2):
                    value = 0.0
                    for a in range(2):
                        for b in range(2):
                            weight = (fy if a else 1 - fy) * (fx if b else 1 - fx)
                            if weight > 0:
                                value += weight * grids[lens][i + a, j + b, axis]
                    # OpenCV's count, from the centre of the first pixel
                    xy[lens, axis] = value - 0.5
                ok[lens] = np.isfinite(xy[lens, 0])
                if ok[lens] and masks[lens].size:
                    ok[lens] = _bilinear(masks[lens], xy[lens, 0], xy[lens, 1]) > 0.5
            if not (ok[0] or ok[1]):
                picture[v, u] = _BACKGROUND
                continue
            lens, fade = (0 if ok[0] else 1), 0.0
            if ok[0] and ok[1]:
                lon = ((u + 0.5) / width - 0.5) * 2 * np.pi
                p, q, r = np.cos(lat) * np.sin(lon), -np.sin(lat), np.cos(lat) * np.cos(lon)
                for k in range(3):
                    d[k] = R[k, 0] * p + R[k, 1] * q + R[k, 2] * r
                place = np.arctan2(d[1], d[0]) / (2 * np.pi) % 1.0 * _AROUND
                k = min(int(place), _AROUND - 1)
                limit = seam[k] + (place - k) * (seam[k + 1] - seam[k])
                beyond = np.rad2deg(np.arctan2(np.hypot(d[0], d[1]), d[2])) - limit
                lens = 0 if beyond <= 0 else 1
                # of the broad difference of both lenses each side gives up what the fading asks
                fade = min(max(0.5 - beyond / _FADE_DEG, 0.0), 1.0) - (1 - lens)
            if lens == 0:
                front[v, u] = True
            else:
                back[v, u] = True
            for c in range(3):
                value = min(
                    _bilinear(views[lens][:, :, c], xy[lens, 0], xy[lens, 1]) * levels[lens, c], 255.0
                )
                if fade != 0:
                    for a in range(2):
                        for b in range(2):
                            weight = (fy if a else 1 - fy) * (fx if b else 1 - fx)
                            value += fade * weight * broad[i + a, j + b, c]
                picture[v, u, c] = np.uint8(min(max(np.rint(value), 0.0), 255.0))


@njit(cache=True, error_model="numpy", nogil=True)
def _bilinear(values, x, y):  # type: ignore[no-untyped-def]
    """Value of a picture between the centres of its pixels, the first of which is 0, 0."""
    height, width = values.shape
    x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
    j, i = min(int(x), width - 2), min(int(y), height - 2)
    fx, fy = x - j, y - i
    return (1 - fy) * ((1 - fx) * values[i, j] + fx * values[i, j + 1]) + fy * (
        (1 - fx) * values[i + 1, j] + fx * values[i + 1, j + 1]
    )


def _closed(values: AnyArray) -> AnyArray:
    """Values (h, w, ...) with a column and a row more on each side: once around, and across the poles."""
    half = values.shape[1] // 2
    tall = np.concatenate([np.roll(values[:1], half, axis=1), values, np.roll(values[-1:], half, axis=1)])
    return np.concatenate([tall[:, -1:], tall, tall[:, :1]], axis=1)


def _levels(gains: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Factors of front and back lens to one level of light: half of the difference each."""
    root = np.sqrt(gains) ** (1 / GAMMA)
    return root, 1 / root


def _evened(colour: Mapping[str, AnyArray], gains: ArrayF) -> dict[str, AnyArray]:
    """Both lenses at one level of light, so that neither burns out."""
    return {
        name: np.minimum(colour[name] * level.astype(np.float32), 255.0)
        for name, level in zip(LENSES, _levels(gains), strict=True)
    }


def overlap(
    views: Mapping[str, ArrayU8],
    rig: Rig,
    R_front_pcs: ArrayF,
    inverse_range: AnyArray,
    masks: Mapping[str, ArrayB] | None,
    gains: ArrayF,
) -> tuple[ArrayF, dict[str, AnyArray], ArrayB]:
    """The overlap about the axis of the front lens: angles (a,), colours (720, a, 3), usable (720, a)."""
    widest = rig.settings.field_of_view_deg / 2 - RIM_DEG
    angle = np.arange(180.0 - widest, widest, _ACROSS_DEG)
    azimuth = np.arange(_AROUND) * 2 * np.pi / _AROUND
    t = np.deg2rad(angle)[None, :]
    directions = np.stack(
        np.broadcast_arrays(
            np.sin(t) * np.cos(azimuth)[:, None], np.sin(t) * np.sin(azimuth)[:, None], np.cos(t)
        ),
        axis=-1,
    ).reshape(-1, 3)
    height, width = inverse_range.shape
    pcs = directions @ R_front_pcs
    lon, lat = np.arctan2(pcs[:, 0], pcs[:, 2]), np.arcsin(np.clip(-pcs[:, 1], -1, 1))
    row = np.clip((0.5 - lat / np.pi) * height, 0, height - 1).astype(np.int64)
    column = ((lon / (2 * np.pi) + 0.5) * width).astype(np.int64) % width
    pixels, _ = lens_pixels(rig, directions, inverse_range[row, column])
    usable = np.isfinite(pixels["front"][:, 0]) & np.isfinite(pixels["back"][:, 0])
    if masks:
        for name, mask in masks.items():
            usable &= _sampled(mask.astype(np.uint8) * 255, pixels[name]) > 127
    colour = {name: _sampled(views[name], pixels[name]).astype(np.float32) for name in LENSES}
    shape = (_AROUND, len(angle))
    even = {name: values.reshape(*shape, 3) for name, values in _evened(colour, gains).items()}
    return angle, even, usable.reshape(shape)


def _seam(
    views: Mapping[str, ArrayU8],
    rig: Rig,
    R_front_pcs: ArrayF,
    inverse_range: AnyArray,
    masks: Mapping[str, ArrayB] | None,
    gains: ArrayF,
) -> ArrayF:
    """Angle (720,) of the seam from the axis of the front lens, degrees."""
    angle, even, usable = overlap(views, rig, R_front_pcs, inverse_range, masks, gains)
    cost = np.abs(even["front"] - even["back"]).mean(axis=2)
    cost = ndimage.uniform_filter(cost, size=(3, 3), mode=("wrap", "nearest"))
    # sharpness falls towards the rim: a middle place is a little better than another
    cost = cost + 0.1 * np.abs(angle - 90.0) + np.where(usable, 0.0, 1e3)
    n, k = cost.shape
    # closed: twice around, the second round is taken
    total = np.zeros((2 * n, k))
    came = np.zeros((2 * n, k), dtype=np.int64)
    total[0] = cost[0]
    moves = np.arange(-_STEPS, _STEPS + 1)
    for i in range(1, 2 * n):
        padded = np.pad(total[i - 1], _STEPS, constant_values=np.inf)
        choices = np.stack([padded[_STEPS + m : _STEPS + m + k] + 0.3 * abs(m) for m in moves])
        best = choices.argmin(axis=0)
        came[i] = np.arange(k) + moves[best]
        total[i] = choices.min(axis=0) + cost[i % n]
    at = int(total[-1].argmin())
    path = np.empty(2 * n, dtype=np.int64)
    for i in range(2 * n - 1, -1, -1):
        path[i] = at
        at = came[i, at]
    # the middle of both rounds knows nothing of either end
    ring = np.empty(n, dtype=np.int64)
    half = n // 2
    for i in range(half, half + n):
        ring[i % n] = path[i]
    return np.asarray(angle[ring], dtype=np.float64)


def _broad_difference(difference: AnyArray, both: ArrayB) -> AnyArray:
    """Broad part (h, w, 3) of the difference of both lenses, from where both show the same."""
    height, width = both.shape
    sigma = _FADE_DEG / 2 / 360.0 * width
    pad = min(width, int(4 * sigma) + 1)
    # some pixels to a standard deviation are enough for what is smooth over many
    less = max(1, int(sigma / _BLUR_PX))
    small = (-(-width // less), -(-height // less))

    def broad(values: AnyArray) -> AnyArray:
        """Gaussian mean, closed to the left and right."""
        few = cv2.resize(values, small, interpolation=cv2.INTER_AREA) if less > 1 else values
        rim = min(few.shape[1], pad // less + 1)
        wide = np.concatenate([few[:, -rim:], few, few[:, :rim]], axis=1)
        soft = cv2.GaussianBlur(wide, (0, 0), sigma / less, borderType=cv2.BORDER_REPLICATE)[:, rim:-rim]
        return cv2.resize(soft, (width, height), interpolation=cv2.INTER_LINEAR) if less > 1 else soft

    weight = broad(both.astype(np.float32))
    return broad(difference.astype(np.float32)) / np.maximum(weight, 1e-3)[..., None]


def _seam_error(
    views: Mapping[str, ArrayU8],
    rig: Rig,
    R_front_pcs: ArrayF,
    inverse_range: AnyArray,
    seam: ArrayF,
    gains: ArrayF,
) -> tuple[ArrayF, float]:
    """Shifts (k,) of both lenses against each other across the seam, degrees; correlation in the overlap."""
    angle, even, usable = overlap(views, rig, R_front_pcs, inverse_range, None, gains)
    grey = {name: even[name].mean(axis=2).astype(np.float64) for name in LENSES}
    agreement = correlation(grey["front"], grey["back"], usable)
    reach, half, length = round(_LARGEST_SHIFT_DEG / _ACROSS_DEG), round(2.0 / _ACROSS_DEG), 8
    shifts = []
    for i in range(0, _AROUND, length):
        j = round((float(np.median(seam[i : i + length])) - angle[0]) / _ACROSS_DEG)
        low, high = j - half, j + half + 1
        if low - reach < 0 or high + reach > len(angle):
            low, high = max(reach, low), min(len(angle) - reach, high)
        if high - low < half:
            continue
        rows = slice(i, i + length)
        if not usable[rows, low - reach : high + reach].all():
            continue
        a = grey["front"][rows, low:high]
        if np.abs(np.diff(a, axis=1)).mean() < _LEAST_TEXTURE / 4 or a.std() < _LEAST_TEXTURE:
            continue
        score = np.array(
            [
                correlation(a, grey["back"][rows, low + s : high + s], np.ones(a.shape, bool))
                for s in range(-reach, reach + 1)
            ]
        )
        best = int(np.nanargmax(score)) if np.isfinite(score).any() else 0
        if not 0 < best < 2 * reach or score[best] < 0.7:
            continue
        # the peak between the steps by a parabola
        y0, y1, y2 = score[best - 1 : best + 2]
        bend = y0 - 2 * y1 + y2
        shifts.append((best - reach + (0.5 * (y0 - y2) / bend if bend < 0 else 0.0)) * _ACROSS_DEG)
    return np.array(shifts), agreement


def correlation(a: AnyArray, b: AnyArray, usable: ArrayB) -> float:
    """Correlation of two pictures of one shape where they may be used; NaN without texture."""
    x, y = a[usable], b[usable]
    if len(x) < 16 or x.std() < 1.0 or y.std() < 1.0:
        return float("nan")
    return float(np.corrcoef(x, y)[0, 1])
