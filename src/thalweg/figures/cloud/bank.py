"""Which stretch of bank is shown, and from where: seen evenly from the water, no bridge over it."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayB, ArrayF
from thalweg.figures.cloud.splat import across_azimuth

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
    min_distance_m, max_distance_m : horizontal distance of the bank from the track.
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
        raise GeometryError(
            f"no point lies {min_distance_m:g} to {max_distance_m:g} m beside the track",
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
    kept = [rated for rated, free in zip(found, clear, strict=True) if free] or found
    best = max(score for score, _, _ in kept)
    return max((rated for rated in kept if rated[0] >= ABOUT_AS_GOOD * best), key=lambda rated: rated[1])[2]


def _surroundings(
    points_wcs_m: ArrayF,
    trajectory: Trajectory,
    min_distance_m: float,
    max_distance_m: float,
    *,
    seen_from_track: bool,
) -> _Surroundings:
    from scipy.spatial import cKDTree

    finite = points_wcs_m[np.isfinite(points_wcs_m).all(axis=1)]
    key, n = np.unique(np.floor(finite / CELL_M).astype(np.int64), axis=0, return_counts=True)
    cell = np.asarray((key + 0.5) * CELL_M)
    valid = trajectory.position_wcs_m[trajectory.valid]
    track = _dense(valid)
    distance, nearest = cKDTree(track[:, :2]).query(cell[:, :2])
    above = cell[:, 2] - track[nearest, 2]
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
