"""Views of a cloud: direction to the bank, parallel projection, splatting of points into pixels.

Points come in chunks of any size and order; the picture depends on neither. Each pixel holds one 64-bit
key, depth in the high half and the value's bits in the low half, so that the nearest point of a pixel is the
smallest key and chunks merge by a minimum.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

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
OVERHEAD_M: Final = 2.0
"""What lies so far above the track and no farther aside is a bridge, a cable or a roof."""
BESIDE_OVERHEAD_M: Final = 10.0
"""A stretch keeps so far away from such things: abutments and ramps are wider than the deck."""
LONGEST_GAP_M: Final = 50.0
"""Gaps of the track up to this length are taken as straight: under a bridge there is often no pose."""
EVEN_SHARE: Final = 0.1
"""Share of the metres of a stretch that may be covered worse than the stretch is said to be."""
ABOUT_AS_GOOD: Final = 0.9
"""Of stretches covered so well, in units of the best, the one with most points wins."""
BACKGROUND_FROM_M: Final = 3.0
"""Things this far behind the face of the bank and above the bank are background."""
CLEARLY_HIGHER_M: Final = 1.0
"""Difference of the heights of both sides (90th percentile) from which the higher one is put behind."""
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


FARTHEST_M: Final = 300.0
"""No lidar of a boat reaches farther."""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class _Surroundings:
    """Cells of the cloud with what the search asks of them, and the track.

    Parameters
    ----------
    cell_m : (n, 3) middles of the cells that hold a point.
    weight : (n,) points, times the square of their distance from the track if they were seen from there.
    above_m : (n,) height above the nearest piece of the track.
    beside : (n,) true within the wanted distances from the track.
    overhead : (n,) true for what hangs over the track.
    track_en_m : (k, 2) the track, a point a metre.
    """

    cell_m: ArrayF
    weight: ArrayF
    above_m: ArrayF
    beside: ArrayB
    overhead: ArrayB
    track_en_m: ArrayF


def choose_segment(
    points_wcs_m: ArrayF,
    trajectory: Trajectory,
    *,
    length_m: float = 14.0,
    min_distance_m: float = 2.0,
    max_distance_m: float = 25.0,
    background_m: float = 0.0,
    seen_from_track: bool = True,
) -> BankSegment:
    """The stretch of bank that is covered best along its whole length, looked at across the river.

    What counts is the seen share of the face of the bank, metre by metre from its foot to `BANK_M` above the
    boat, where it is nearly worst: a pier or a wall in a gap does not win by its points. With a background,
    stretches with things standing behind them come first. Places beside a bridge are left out as long as
    there are others. Of stretches about as good the one with most points wins; those of a cloud measured
    from the track count with the square of their distance, so that a bank does not win for being near.

    Parameters
    ----------
    points_wcs_m : (n, 3) the cloud or an even sample of it.
    trajectory : track of the boat, to know the side of the water.
    length_m : length of the stretch.
    min_distance_m, max_distance_m : horizontal distance of the bank from the track; where nothing lies there,
        as in a room or on a wide river, up to that of 95 % of the cloud, and `FARTHEST_M`.
    background_m : depth of the background that belongs to the stretch.
    seen_from_track : true if the cloud was measured from the track, false for one from elsewhere.

    Raises
    ------
    GeometryError : no point lies at such a distance.
    """
    around = _surroundings(
        points_wcs_m, trajectory, min_distance_m, max_distance_m, seen_from_track=seen_from_track
    )
    if not around.beside.any():
        around = _surroundings(points_wcs_m, trajectory, 0.0, None, seen_from_track=seen_from_track)
    if not around.beside.any():
        raise GeometryError(
            f"no point lies within {FARTHEST_M:g} m of the track",
            expected="a cloud of the banks",
            cure="Check the mount of the lidar and the time axis of the streams",
        )
    places = np.unique(np.rint(around.track_en_m / (0.1 * length_m)), axis=0) * 0.1 * length_m
    found: list[tuple[float, float, BankSegment]] = []
    clear: list[bool] = []
    for place in places:
        across = _across_river(around.track_en_m, place, reach_m=2.0 * length_m)
        for away in (across, -across):
            azimuth = float(np.arctan2(away[0], away[1]))
            stretch = BankSegment(
                centre_en_m=place, azimuth_rad=azimuth, length_m=length_m, background_m=background_m
            )
            rated = _rate(around, stretch)
            if rated is not None:
                found.append(rated)
                clear.append(not _is_overhead(around, stretch))
    if not found:
        raise GeometryError(
            f"no point of the cloud lies between {BELOW_BOAT_M:g} m below and {BANK_M:g} m above the track",
            expected="a cloud of the banks",
            cure="Check the mount of the lidar and the time axis of the streams",
        )
    kept = [rated for rated, free in zip(found, clear, strict=True) if free] or found
    best = max(score for score, _, _ in kept)
    return max((rated for rated in kept if rated[0] >= ABOUT_AS_GOOD * best), key=lambda rated: rated[1])[2]


def _surroundings(
    points_wcs_m: ArrayF,
    trajectory: Trajectory,
    min_distance_m: float,
    max_distance_m: float | None,
    *,
    seen_from_track: bool,
) -> _Surroundings:
    """Cells of the cloud about the track; without a largest distance those within that of 95 % of them."""
    from scipy.spatial import cKDTree

    finite = points_wcs_m[np.isfinite(points_wcs_m).all(axis=1)]
    key, n = np.unique(np.floor(finite / CELL_M).astype(np.int64), axis=0, return_counts=True)
    cell = np.asarray((key + 0.5) * CELL_M)
    valid = trajectory.position_wcs_m[trajectory.valid]
    track = _dense(valid)
    distance, nearest = cKDTree(track[:, :2]).query(cell[:, :2])
    above = cell[:, 2] - track[nearest, 2]
    if max_distance_m is None:
        max_distance_m = min(float(np.quantile(distance, 0.95)), FARTHEST_M) if len(cell) else 0.0
    beside = np.asarray((distance >= min_distance_m) & (distance <= max_distance_m))
    low = beside & (above >= -BELOW_BOAT_M) & (above <= BANK_M)
    return _Surroundings(
        cell_m=cell,
        weight=np.asarray(n * distance**2 if seen_from_track else n, dtype=np.float64),
        # A cloud without a point at the height of the boat is another kind of reference: all of it counts.
        above_m=above if low.any() else above - above[beside].min(initial=np.inf) - BELOW_BOAT_M,
        beside=beside,
        overhead=(distance <= OVERHEAD_M) & (above >= OVERHEAD_M),
        track_en_m=track[:, :2],
    )


def _dense(track_m: ArrayF) -> ArrayF:
    """The track with a point a metre, straight over gaps up to `LONGEST_GAP_M`."""
    thin = track_m[np.r_[True, np.any(np.diff(np.rint(track_m[:, :2] / _TRACK_CELL_M), axis=0) != 0, axis=1)]]
    step = np.linalg.norm(np.diff(thin[:, :2], axis=0), axis=1)
    wide = np.flatnonzero((step > 2.0 * _TRACK_CELL_M) & (step <= LONGEST_GAP_M))
    bridges = [np.linspace(thin[k], thin[k + 1], int(step[k] / _TRACK_CELL_M) + 2)[1:-1] for k in wide]
    return np.concatenate([thin, *bridges])


def _rate(around: _Surroundings, place: BankSegment) -> tuple[float, float, BankSegment] | None:
    """Coverage and weight of the bank on one side of a place on the track, and the stretch itself."""
    along, away = place.along_and_away(around.cell_m)
    column = np.floor(along).astype(np.int64)
    n_columns = max(int(place.length_m), 1)
    within = (column >= 0) & (column < n_columns) & (away > 0)
    level = np.floor((around.above_m + BELOW_BOAT_M) / CELL_M).astype(np.int64)
    n_levels = round((BELOW_BOAT_M + BANK_M) / CELL_M)
    face = within & around.beside & (level >= 0) & (level < n_levels)
    if not face.any():
        return None
    seen = np.zeros((n_columns, n_levels), dtype=bool)
    seen[column[face], level[face]] = True
    score = float(np.quantile(seen.mean(axis=1), EVEN_SHARE))
    weight = around.weight[face]
    middle = float(np.average(away[face], weights=weight))
    if place.background_m > 0:
        behind = within & (level >= n_levels) & (away >= middle + BACKGROUND_FROM_M)
        behind &= away <= middle + place.depth_m + place.background_m
        score *= 0.5 + 0.5 * np.unique(column[behind]).size / n_columns
    view = np.array([np.sin(place.azimuth_rad), np.cos(place.azimuth_rad)])
    stretch = BankSegment(
        centre_en_m=place.centre_en_m + middle * view,
        azimuth_rad=place.azimuth_rad,
        length_m=place.length_m,
        depth_m=place.depth_m,
        background_m=place.background_m,
    )
    return score, float(weight.sum()), stretch


def _is_overhead(around: _Surroundings, place: BankSegment) -> bool:
    """True if something hangs over the track abreast of a stretch or near its ends."""
    along, away = place.along_and_away(around.cell_m[around.overhead])
    aside = (along >= -BESIDE_OVERHEAD_M) & (along <= place.length_m + BESIDE_OVERHEAD_M)
    return bool(np.any(aside & (np.abs(away) <= place.length_m)))


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
    Where neither side is taller, the best measured bank shows its face.

    Parameters
    ----------
    points_wcs_m : (n, 3) the cloud or an even sample of it.
    trajectory : the boat, which saw the faces.
    """
    from scipy.spatial import cKDTree

    across = across_azimuth(points_wcs_m)
    finite = points_wcs_m[np.isfinite(points_wcs_m).all(axis=1)]
    finite = finite[:: max(1, len(finite) // 50_000)]
    track = trajectory.position_wcs_m[trajectory.valid, :2]
    _, nearest = cKDTree(track).query(finite[:, :2])
    far_side = (finite[:, :2] - track[nearest]) @ np.array([np.sin(across), np.cos(across)]) > 0
    if far_side.any() and not far_side.all():
        tall = [float(np.percentile(finite[side, 2], 90.0)) for side in (far_side, ~far_side)]
        higher = tall[0] - tall[1]
        if abs(higher) > CLEARLY_HIGHER_M:
            return across if higher > 0 else across + np.pi
    bank = choose_segment(points_wcs_m, trajectory).azimuth_rad
    return across if np.cos(across - bank) >= 0 else across + np.pi
