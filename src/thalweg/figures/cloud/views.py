"""Views of a cloud: direction to the bank, parallel projection, splatting of points into pixels.

Points come in chunks of any size and order; the picture depends on neither. Each pixel holds one 64-bit
key, depth in the high half and the value's bits in the low half, so that the nearest point of a pixel is the
smallest key and chunks merge by a minimum.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final, Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from thalweg.core import ArrayB, ArrayF, ArrayU8, GeometryError, Trajectory

DEPTH_STEP_M: Final = 1e-3
"""Resolution of the z-buffer; the range of 32 bits is +-2147 km."""
_DEPTH_ZERO: Final = 2**31
_EMPTY: Final = np.uint64(2**64 - 1)
EDL_RADII_PX: Final = (1, 2, 4)
"""Distances of the neighbours that shade a pixel."""
EDL_CAP: Final = 2.0
"""Most that one neighbour counts, in depth steps per pixel distance: silhouettes stay dark, not black."""

CELL_M: Final = 0.5
"""Cell of what is seen of a bank: smaller ones would count points, larger ones would not show holes."""
BELOW_BOAT_M: Final = 1.0
BANK_M: Final = 3.0
"""The bank is looked at from so far below to so far above the boat's INS: its foot and its face."""
CLEAR_EXTENT: Final = 1.5
"""Length over width from which the track tells the direction of the river."""
_TRACK_CELL_M: Final = 1.0


# ---------------------------------------------------------------- points into pixels


class View(Protocol):
    """What a `Splat` needs to know of a projection."""

    @property
    def width_px(self) -> int:
        """Width of the picture."""

    @property
    def height_px(self) -> int:
        """Height of the picture."""

    @property
    def pixel_m(self) -> float:
        """Size of a pixel at the scene, which scales the shading."""

    def project(self, points_wcs_m: ArrayF) -> ArrayF:
        """Column, row (pixel units, 0 at the upper left corner) and depth in metres, shape (n, 3)."""


ViewT = TypeVar("ViewT", bound=View)


@dataclass(frozen=True, slots=True, kw_only=True)
class ObliqueView:
    """A parallel projection of the world onto a picture.

    Parameters
    ----------
    azimuth_rad : direction of view, clockwise from north; the picture's right is 90 degrees clockwise of it.
    elevation_rad : height of the viewer above the horizon; pi/2 is a plan view, 0 a side view.
    left_m, top_m : coordinates of the picture's upper left corner along its right and up axes.
    pixel_m : size of a pixel in the projection plane.
    width_px, height_px : size of the picture.
    """

    azimuth_rad: float
    elevation_rad: float
    left_m: float
    top_m: float
    pixel_m: float
    width_px: int
    height_px: int

    @property
    def axes(self) -> ArrayF:
        """Rows: right, up and away from the viewer, as unit vectors in wcs; shape (3, 3)."""
        return view_axes(self.azimuth_rad, self.elevation_rad)

    def project(self, points_wcs_m: ArrayF) -> ArrayF:
        """Column, row (pixel units, 0 at the upper left corner) and depth in metres, shape (n, 3)."""
        east, north, height = np.asarray(points_wcs_m, dtype=np.float64).T
        # Not a matrix product: its rounding depends on the number of points, and with it on the chunks.
        right, up, depth = (a[0] * east + a[1] * north + a[2] * height for a in self.axes)
        return np.stack([(right - self.left_m) / self.pixel_m, (self.top_m - up) / self.pixel_m, depth], 1)

    @classmethod
    def fit(
        cls,
        sample_wcs_m: ArrayF,
        *,
        azimuth_rad: float | None = None,
        elevation_rad: float = np.deg2rad(35.0),
        width_px: int = 2000,
        max_height_px: int = 1600,
        keep: float = 0.998,
        margin: float = 0.02,
    ) -> Self:
        """A view that shows a cloud.

        Parameters
        ----------
        sample_wcs_m : (n, 3) the points or a sample of them; NaN are left out.
        azimuth_rad : direction of view; by default across the longest horizontal extent, towards the north.
        elevation_rad : height of the viewer above the horizon.
        width_px : width of the picture.
        max_height_px : the picture is not higher; the pixels grow instead.
        keep : share of the sample inside the picture along each axis: strays do not shrink the rest.
        margin : free border, as a share of the width.

        Raises
        ------
        GeometryError : no finite point.
        """
        sample = np.asarray(sample_wcs_m, dtype=np.float64)
        sample = sample[np.isfinite(sample).all(axis=1)]
        if not len(sample):
            raise GeometryError("a cloud without a finite point", expected="at least one point to show")
        if azimuth_rad is None:
            azimuth_rad = across_azimuth(sample)
        tail = 50.0 * (1.0 - keep)
        right, up, _ = view_axes(azimuth_rad, elevation_rad) @ sample.T
        left, end = np.percentile(right, [tail, 100 - tail])
        bottom, top = np.percentile(up, [tail, 100 - tail])
        span = max(end - left, (top - bottom) * width_px / max_height_px, 1e-3) * (1 + 2 * margin)
        pixel = span / width_px
        height = int(np.clip(np.ceil((top - bottom) / pixel + 2 * margin * width_px), 8, max_height_px))
        return cls(
            azimuth_rad=float(azimuth_rad),
            elevation_rad=float(elevation_rad),
            left_m=float(0.5 * (left + end) - 0.5 * span),
            top_m=float(0.5 * (bottom + top) + 0.5 * height * pixel),
            pixel_m=float(pixel),
            width_px=width_px,
            height_px=height,
        )


def view_axes(azimuth_rad: float, elevation_rad: float) -> ArrayF:
    """Right, up and away axes (rows) of a viewer who looks towards an azimuth from an elevation."""
    sa, ca = np.sin(azimuth_rad), np.cos(azimuth_rad)
    se, ce = np.sin(elevation_rad), np.cos(elevation_rad)
    return np.array([[ca, -sa, 0.0], [sa * se, ca * se, ce], [sa * ce, ca * ce, -se]])


def across_azimuth(points_wcs_m: ArrayF) -> float:
    """Azimuth across the longest horizontal extent of points, of the two the one nearer to north.

    The farthest 2 % of the points have no say: one stray would turn the view.
    """
    en = points_wcs_m[:, :2] - np.median(points_wcs_m[:, :2], axis=0)
    distance = np.linalg.norm(en, axis=1)
    en = en[distance <= np.percentile(distance, 98.0)]
    en = en - en.mean(axis=0)
    _, vectors = np.linalg.eigh(en.T @ en)
    east, north = vectors[:, 0] * (1.0 if vectors[1, 0] >= 0 else -1.0)
    return float(np.arctan2(east, north))


class Splat(Generic[ViewT]):
    """A picture that grows chunk by chunk.

    Parameters
    ----------
    view : the projection.

    Attributes
    ----------
    n_added, n_drawn : points given, and points of them that are finite and inside the picture.
    """

    def __init__(self, view: ViewT) -> None:
        self.view = view
        self.n_added = 0
        self.n_drawn = 0
        self._keys: NDArray[np.uint64] = np.full(view.height_px * view.width_px, _EMPTY)

    def add(self, points_wcs_m: ArrayF, values: ArrayF) -> None:
        """Draw points.

        Parameters
        ----------
        points_wcs_m : (n, 3); rows with NaN are not drawn.
        values : (n,) what the colour shows; stored as float32.
        """
        points = np.asarray(points_wcs_m)
        shown = np.ascontiguousarray(values, dtype=np.float32)
        if points.ndim != 2 or points.shape[1] != 3 or shown.shape != points.shape[:1]:
            raise GeometryError(
                f"points {points.shape} with values {shown.shape}", expected="points (n, 3) and values (n,)"
            )
        self.n_added += len(points)
        column, row, depth = self.view.project(points).T
        with np.errstate(invalid="ignore"):
            inside = (column >= 0) & (column < self.view.width_px) & (row >= 0) & (row < self.view.height_px)
        inside &= np.isfinite(depth)
        pixel = row[inside].astype(np.int64) * self.view.width_px + column[inside].astype(np.int64)
        steps = np.clip(np.rint(depth[inside] / DEPTH_STEP_M) + _DEPTH_ZERO, 0, 2**32 - 2).astype(np.uint64)
        keys = (steps << np.uint64(32)) | shown[inside].view(np.uint32).astype(np.uint64)
        np.minimum.at(self._keys, pixel, keys)
        self.n_drawn += int(pixel.size)

    @property
    def coverage(self) -> float:
        """Share of the pixels that hold a point."""
        return float(np.mean(self._keys != _EMPTY))

    def radius_px(self, largest: int = 4) -> int:
        """Half size of a point at which about 95 % of the shape of the cloud are filled, at least 1.

        Points are taken as scattered evenly over the shape, which is what they cover at a large radius.
        """
        shape = float(np.mean(np.isfinite(self.buffers(2 * largest)[0])))
        if shape <= 0:
            return 1
        per_pixel = -np.log(max(1.0 - self.coverage / shape, 1e-9))
        return int(np.clip(np.ceil((np.sqrt(3.0 / per_pixel) - 1.0) / 2.0), 1, largest))

    def buffers(self, radius_px: int = 0) -> tuple[ArrayF, ArrayF]:
        """Depth in metres and values, both (height, width), NaN where nothing is.

        With a radius each point is a square of ``2 radius + 1`` pixels; nearer squares hide others.
        """
        keys = self._keys.reshape(self.view.height_px, self.view.width_px)
        for axis in (0, 1):
            grown = keys.copy()
            for there, here in _shifted(keys.shape, axis, radius_px):
                np.minimum(grown[here], keys[there], out=grown[here])
            keys = grown
        empty = keys == _EMPTY
        depth = ((keys >> np.uint64(32)).astype(np.float64) - _DEPTH_ZERO) * DEPTH_STEP_M
        values = (keys & np.uint64(2**32 - 1)).astype(np.uint32).view(np.float32).astype(np.float64)
        return np.where(empty, np.nan, depth), np.where(empty, np.nan, values)

    def image(
        self,
        colours: ArrayF | None,
        limits: tuple[float, float] = (0.0, 1.0),
        *,
        radius_px: int = 1,
        shading: float = 1.0,
        noise_m: float = 0.0,
        background: tuple[float, float, float] = (1.0, 1.0, 1.0),
    ) -> ArrayU8:
        """The picture as RGB, shape (height, width, 3).

        Parameters
        ----------
        colours : (k, 3) table from low to high, each 0..1; None: the values are colours of `pack_rgb`.
        limits : values of the first and the last colour; values beyond take those.
        radius_px : half size of a point.
        shading : strength of the eye-dome shading, 0 for none.
        noise_m : depth noise of the points, which the shading is not to show.
        background : colour where nothing is, 0..1.
        """
        depth, values = self.buffers(radius_px)
        filled = np.isfinite(depth)
        low, high = limits
        if colours is None:
            code = np.where(filled, values, 0.0).astype(np.int64)
            picture = (code[..., None] >> np.array([16, 8, 0]) & 255) / 255.0
        else:
            share = np.clip((np.where(np.isfinite(values), values, low) - low) / (high - low), 0.0, 1.0)
            picture = np.asarray(colours)[np.rint(share * (len(colours) - 1)).astype(np.int64)]
        if shading > 0:
            picture = picture * np.exp(-shading * eye_dome(depth, self.view.pixel_m, noise_m))[..., None]
        picture = np.where(filled[..., None], picture, np.asarray(background))
        return np.asarray(np.rint(picture * 255.0), dtype=np.uint8)


def pack_rgb(rgb: ArrayU8) -> ArrayF:
    """Colours (n, 3) as values (n,) of a `Splat`: 24 bits, which its single precision holds."""
    return np.asarray(rgb.astype(np.int64) @ np.array([65536, 256, 1]), dtype=np.float64)


def eye_dome(depth_m: ArrayF, pixel_m: float, noise_m: float = 0.0) -> ArrayF:
    """How far each pixel lies behind its neighbours; 0 on a plane of any slope.

    Mean over four pairs of opposite neighbours and the radii `EDL_RADII_PX` of the depth by which the pixel
    lies behind the middle of the pair, in units of their distance in the picture, capped. This is the
    eye-dome lighting of Boucheny (2009) for a parallel projection, with pairs in place of single neighbours,
    so that a slope is not darkened as a whole. Where nothing is, a neighbour counts as level.

    Parameters
    ----------
    depth_m : (h, w) depth, NaN where nothing is.
    pixel_m : size of a pixel.
    noise_m : added to the distance in the picture, so that depth noise casts no shade.
    """
    total = np.zeros_like(depth_m)
    h, w = depth_m.shape
    for radius in EDL_RADII_PX:
        padded = np.pad(depth_m, radius, constant_values=np.nan)
        for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
            behind = np.zeros_like(depth_m)
            for sign in (-1, 1):
                y, x = radius * (1 + sign * dy), radius * (1 + sign * dx)
                behind += np.nan_to_num(depth_m - padded[y : y + h, x : x + w])
            total += np.clip(0.5 * behind / (pixel_m * radius + noise_m), 0.0, EDL_CAP)
    return total / (4 * len(EDL_RADII_PX))


def _shifted(
    shape: tuple[int, ...], axis: int, radius: int
) -> Iterator[tuple[tuple[slice, ...], tuple[slice, ...]]]:
    """Pairs of slices that lay an array onto itself shifted by 1..radius both ways along an axis."""
    for shift in range(1, min(radius, shape[axis] - 1) + 1):
        front = [slice(None)] * len(shape)
        back = [slice(None)] * len(shape)
        front[axis], back[axis] = slice(0, shape[axis] - shift), slice(shift, None)
        yield tuple(front), tuple(back)
        yield tuple(back), tuple(front)


# ---------------------------------------------------------------- the bank beside the track


FARTHEST_M: Final = 400.0
"""A cloud that lies farther from the track is taken for one of another place."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BankSegment:
    """A stretch of bank as it is seen from the water.

    Parameters
    ----------
    centre_en_m : (2,) middle of the stretch in wcs.
    azimuth_rad : direction of view from the water onto the bank, clockwise from north.
    length_m : length along the bank.
    depth_m : how far before and behind the centre points belong to it.
    background_m : how far behind it points still do, so that trees and buildings stand in the background.
    """

    centre_en_m: ArrayF
    azimuth_rad: float
    length_m: float
    depth_m: float = 12.0
    background_m: float = 0.0

    def along_and_away(self, points_wcs_m: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Metres along the bank from the left end, and metres away from the water behind the centre."""
        s, c = np.sin(self.azimuth_rad), np.cos(self.azimuth_rad)
        east, north = (points_wcs_m[:, :2] - self.centre_en_m).T
        return east * c - north * s + 0.5 * self.length_m, east * s + north * c

    def contains(self, points_wcs_m: ArrayF) -> ArrayB:
        """(n,) true for points of the stretch; use it to pick them from chunks."""
        along, away = self.along_and_away(points_wcs_m)
        with np.errstate(invalid="ignore"):
            beside = (along >= 0) & (along <= self.length_m)
            return np.asarray(beside & (away >= -self.depth_m) & (away <= self.depth_m + self.background_m))


def choose_segment(
    points_wcs_m: ArrayF,
    trajectory: Trajectory,
    *,
    length_m: float = 14.0,
    max_distance_m: float = 25.0,
    background_m: float = 0.0,
) -> BankSegment:
    """The stretch of bank that is covered best, looked at across the river.

    What counts is how much of the face of the bank, from its foot to `BANK_M` above the boat, holds a point:
    a wall in a gap does not win by its points. Of stretches covered alike the one with most points wins.

    Parameters
    ----------
    points_wcs_m : (n, 3) the cloud or an even sample of it.
    trajectory : track of the boat, to know the side of the water.
    length_m : length of the stretch.
    max_distance_m : horizontal distance of the bank from the track; where nothing lies so near, as on a wide
        river, a little more than that of the nearest, up to `FARTHEST_M`.
    background_m : depth of the background that belongs to the stretch.

    Raises
    ------
    GeometryError : no point lies at such a distance.
    """
    finite = points_wcs_m[np.isfinite(points_wcs_m).all(axis=1)]
    key, n = np.unique(np.floor(finite / CELL_M), axis=0, return_counts=True)
    track = trajectory.position_wcs_m[trajectory.valid]
    track = track[np.unique(np.rint(track[:, :2] / _TRACK_CELL_M), axis=0, return_index=True)[1]]
    found = cKDTree(track[:, :2]).query((key[:, :2] + 0.5) * CELL_M)
    distance, nearest = np.asarray(found[0]), np.asarray(found[1])
    above = (key[:, 2] + 0.5) * CELL_M - track[nearest, 2]
    face = (above >= -BELOW_BOAT_M) & (above <= BANK_M)
    face |= not face.any()  # a reference without a point at the height of the boat is all looked at
    closest_m = float(np.asarray(distance)[face].min(initial=np.inf))
    if closest_m > FARTHEST_M:
        raise GeometryError(
            f"no point lies within {FARTHEST_M:g} m of the track",
            expected="a cloud of the banks",
            cure="Check the mount of the lidar, the time axis of the streams, and the CRS of a reference",
        )
    face &= distance <= max(max_distance_m, 1.5 * closest_m)
    cell, n = (key[face] + 0.5) * CELL_M, n[face]
    best: tuple[int, int] = (0, 0)
    chosen: BankSegment | None = None
    for place in np.unique(np.rint(track[:, :2] / (0.1 * length_m)), axis=0) * 0.1 * length_m:
        across = _across_river(track[:, :2], place, reach_m=2.0 * length_m)
        for away in (across, -across):
            azimuth = float(np.arctan2(away[0], away[1]))
            stretch = BankSegment(
                centre_en_m=place, azimuth_rad=azimuth, length_m=length_m, background_m=background_m
            )
            along, off = stretch.along_and_away(cell)
            inside = (along >= 0) & (along <= length_m) & (off > 0)
            columns = np.floor(along[inside] / CELL_M), cell[inside, 2]
            rated = np.unique(np.stack(columns), axis=1).shape[1], int(n[inside].sum())
            if rated > best:
                middle = float(np.average(off[inside], weights=n[inside]))
                best, chosen = rated, replace(stretch, centre_en_m=place + middle * away)
    assert chosen is not None  # the nearest cell lies beside some place of the track
    return chosen


def _across_river(track_en_m: ArrayF, place_en_m: ArrayF, *, reach_m: float) -> ArrayF:
    """Unit vector across the axis of the track near a place.

    A zigzag changes its direction at each turn, its longest extent does not. Where the track nearby has no
    clear longest extent, the whole track has the say.
    """
    cells = np.unique(np.rint(track_en_m / _TRACK_CELL_M), axis=0) * _TRACK_CELL_M
    near = np.linalg.norm(cells - place_en_m, axis=1)
    for part in (cells[near <= near.min() + reach_m], cells):
        spread, vectors = np.linalg.eigh(np.cov(part.T) if len(part) > 2 else np.eye(2))
        if spread[1] >= CLEAR_EXTENT**2 * spread[0]:
            break
    return np.asarray(vectors[:, 0])


def bankward_azimuth(points_wcs_m: ArrayF, trajectory: Trajectory) -> float:
    """Direction of view across the reach from which the banks hide each other least.

    The side with the taller things stands behind: seen the other way its trees would hide its own slope.

    Parameters
    ----------
    points_wcs_m : (n, 3) the cloud or an even sample of it.
    trajectory : the boat, which saw the faces.
    """
    across = across_azimuth(points_wcs_m)
    finite = points_wcs_m[np.isfinite(points_wcs_m).all(axis=1)]
    finite = finite[:: max(1, len(finite) // 50_000)]
    track = trajectory.position_wcs_m[trajectory.valid, :2]
    _, nearest = cKDTree(track).query(finite[:, :2])
    far_side = (finite[:, :2] - track[nearest]) @ np.array([np.sin(across), np.cos(across)]) > 0
    if not far_side.any() or far_side.all():
        return across if far_side.any() else across + np.pi
    tall = [float(np.percentile(finite[side, 2], 90.0)) for side in (far_side, ~far_side)]
    return across if tall[0] >= tall[1] else across + np.pi
