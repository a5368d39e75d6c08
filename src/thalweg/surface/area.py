"""The part of a cloud that is compared: a polygon in plan and a range of heights.

**Border.** A point on the western or southern side of the polygon belongs to it, one on the eastern or
northern side does not: of two areas with a common side each point lies in one. Heights include both limits.

**Map coordinates.** Corners in the campaign's map grid are brought to wcs at the height of the origin.
Verticals converge, so a point far above or below the origin is off by its height times its distance over
the radius of the earth: 4 mm at 50 m of height and 500 m of distance. Heights are ellipsoidal, and wcs is a
plane: 2 cm between both at 500 m. That is taken into account at each point, by the two radii of curvature
at the origin.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from pyproj import CRS

from thalweg.core import (
    GRS80_SEMI_MAJOR_M,
    ArrayB,
    ArrayF,
    ArrayI,
    GeometryError,
    InputError,
    LocalFrame,
    njit,
    prange,
)
from thalweg.core.geometry import LEAST_AREA_M2, crossing_in_words, first_crossing, polygon_area_m2
from thalweg.settings.sections import Area as AreaSection

LONGEST_MAP_EDGE_M: Final = 500.0
"""Longer edges in map coordinates get corners in between: a straight line of a grid is curved in wcs, by less
than 0.2 mm on this length inside a zone of UTM."""

_ECCENTRICITY_SQUARED: Final = 0.00669438
_MOST_STRIPS: Final = 1024
_WHERE: Final = "accuracy.area.polygon"


@dataclass(frozen=True, slots=True, kw_only=True)
class Area:
    """A polygon in plan and a range of heights, in wcs.

    Parameters
    ----------
    polygon_en_m : (k, 2) corners east, north, in either sense of rotation, the first one repeated at the end
        or not; None: no limit in plan.
    lowest_m, highest_m : limits of the height; infinite: none.
    ellipsoid : if given, the limits are ellipsoidal heights, and this is the frame of the points.

    Raises
    ------
    InputError : fewer than three corners, corners that are not finite, or edges that cross.

    Examples
    --------
    >>> area = Area(polygon_en_m=np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0]]))
    >>> area.contains(np.array([[1.0, 1.0, 0.0], [2.0, 3.0, 0.0]]))
    array([ True, False])
    """

    polygon_en_m: ArrayF | None = None
    lowest_m: float = -np.inf
    highest_m: float = np.inf
    ellipsoid: LocalFrame | None = None

    def __post_init__(self) -> None:
        if not self.lowest_m < self.highest_m:
            raise InputError(
                f"heights from {self.lowest_m:g} to {self.highest_m:g} m",
                expected="a lowest below the highest",
                where="accuracy.area",
            )
        if self.polygon_en_m is not None:
            object.__setattr__(self, "polygon_en_m", checked_polygon(self.polygon_en_m))

    @classmethod
    def from_section(cls, section: AreaSection, frame: LocalFrame, crs: str) -> Self:
        """The area that a campaign file describes.

        Parameters
        ----------
        section : `accuracy.area`.
        frame : the world frame.
        crs : the campaign's map grid.

        Raises
        ------
        InputError : the polygon is none, or its corners do not lie in the map grid.
        """
        corners = section.polygon
        low, high = section.min_height_m, section.max_height_m
        in_map = section.frame == "map"
        polygon = None
        if corners is not None:
            polygon = checked_polygon(np.asarray(corners, dtype=np.float64))
            if in_map:
                polygon = _from_map(polygon, frame, crs)
        return cls(
            polygon_en_m=polygon,
            lowest_m=-np.inf if low is None else float(low),
            highest_m=np.inf if high is None else float(high),
            ellipsoid=frame if in_map else None,
        )

    @property
    def is_everything(self) -> bool:
        """True if no limit is set."""
        return self.polygon_en_m is None and np.isinf(self.lowest_m) and np.isinf(self.highest_m)

    def contains(self, points_m: ArrayF) -> ArrayB:
        """Whether each point (n, 3) of wcs lies inside; points that are not finite do not."""
        points = np.ascontiguousarray(points_m, dtype=np.float64)
        lower, upper, start, listed, south, per_m = _strips(self.polygon_en_m)
        east_curve, north_curve, base = self._curvature()
        return np.asarray(
            _contains(
                points,
                lower,
                upper,
                start,
                listed,
                south,
                per_m,
                self.lowest_m,
                self.highest_m,
                east_curve,
                north_curve,
                base,
            )
        )

    def heights_m(self, points_m: ArrayF) -> ArrayF:
        """Heights (n,) of points in the sense of the limits: wcs up, or ellipsoidal."""
        east_curve, north_curve, base = self._curvature()
        p = points_m
        return np.asarray(base + p[:, 2] + east_curve * p[:, 0] ** 2 + north_curve * p[:, 1] ** 2)

    def size_m2(self) -> float:
        """Area of the polygon in plan; infinite without one."""
        return float(np.inf) if self.polygon_en_m is None else polygon_area_m2(self.polygon_en_m)

    def box(self, margin_m: float) -> tuple[ArrayF, ArrayF]:
        """Lowest and highest corner (3,) of the box about the area and a margin; infinite without limits."""
        low, high = np.array([-np.inf] * 3), np.array([np.inf] * 3)
        if self.polygon_en_m is not None:
            low[:2], high[:2] = self.polygon_en_m.min(axis=0), self.polygon_en_m.max(axis=0)
        low[2], high[2] = self.lowest_m, self.highest_m
        return low - margin_m, high + margin_m

    def describe(self) -> str:
        """The limits in words."""
        if self.is_everything:
            return "all that the reference covers"
        parts = []
        if self.polygon_en_m is not None:
            (e0, n0), (e1, n1) = self.polygon_en_m.min(axis=0), self.polygon_en_m.max(axis=0)
            parts.append(
                f"a polygon of {len(self.polygon_en_m)} corners and {self.size_m2():,.0f} m², "
                f"east {e0:,.1f} to {e1:,.1f} m, north {n0:,.1f} to {n1:,.1f} m"
            )
        kind = "ellipsoidal height" if self.ellipsoid is not None else "height"
        if np.isfinite(self.lowest_m):
            parts.append(f"{kind} from {self.lowest_m:g} m")
        if np.isfinite(self.highest_m):
            parts.append(f"{kind} up to {self.highest_m:g} m")
        return ", ".join(parts)

    def _curvature(self) -> tuple[float, float, float]:
        """Half curvatures east and north, 1/m, and the height of wcs zero; zeros without an ellipsoid."""
        if self.ellipsoid is None:
            return 0.0, 0.0, 0.0
        frame = self.ellipsoid
        root = 1.0 - _ECCENTRICITY_SQUARED * np.sin(np.deg2rad(frame.lat_deg)) ** 2
        across = GRS80_SEMI_MAJOR_M / np.sqrt(root) + frame.h_ell_m
        along = GRS80_SEMI_MAJOR_M * (1 - _ECCENTRICITY_SQUARED) / root**1.5 + frame.h_ell_m
        return float(0.5 / across), float(0.5 / along), float(frame.h_ell_m)


def checked_polygon(corners: ArrayF) -> ArrayF:
    """Corners (k, 2) without repeated ones.

    Raises
    ------
    InputError : fewer than three corners, corners that are not finite, no area, or edges that cross.
    """
    if corners.ndim != 2 or corners.shape[1] != 2 or not np.isfinite(corners).all():
        raise InputError(
            f"corners of shape {corners.shape}, or not finite",
            expected="(k, 2) finite east and north",
            where=_WHERE,
        )
    polygon = corners[np.any(corners != np.roll(corners, 1, axis=0), axis=1)]
    if len(polygon) < 3:
        raise InputError(f"{len(polygon)} different corners", expected="at least three", where=_WHERE)
    if crossing := first_crossing(polygon):
        raise InputError(
            crossing_in_words(polygon, crossing),
            expected="a polygon whose edges do not cross",
            where=_WHERE,
            cure="Give the corners in their order along the outline",
        )
    if polygon_area_m2(polygon) < LEAST_AREA_M2:
        raise InputError(
            "a polygon without area: all corners lie on a line",
            expected="corners around the area",
            where=_WHERE,
            cure="Copy the corners from a map program in the order in which they were drawn",
        )
    return np.asarray(polygon)


def _from_map(polygon: ArrayF, frame: LocalFrame, crs: str) -> ArrayF:
    """Corners in wcs of corners in a map grid, with more of them on long edges."""
    nexts = np.roll(polygon, -1, axis=0)
    pieces = np.maximum(1, np.ceil(np.linalg.norm(nexts - polygon, axis=1) / LONGEST_MAP_EDGE_M)).astype(int)
    if pieces.sum() > 100_000:
        raise InputError(
            f"an outline of {np.linalg.norm(nexts - polygon, axis=1).sum() / 1000:,.0f} km",
            expected="the area of a survey",
            where=_WHERE,
        )
    dense = np.concatenate(
        [a + np.arange(n)[:, None] / n * (b - a) for a, b, n in zip(polygon, nexts, pieces, strict=True)]
    )
    heights = np.full((len(dense), 1), frame.h_ell_m)
    try:
        return frame.from_map(np.hstack([dense, heights]), CRS.from_user_input(crs))[:, :2]
    except GeometryError as error:
        raise InputError(
            f"corners from {dense.min(axis=0).round(1).tolist()} to {dense.max(axis=0).round(1).tolist()} "
            f"do not lie in {crs}: {error.found}",
            expected=f"eastings and northings of {crs}",
            where=_WHERE,
            cure="Set accuracy.area.frame to local if these are coordinates of the world frame",
        ) from error


def _strips(polygon: ArrayF | None) -> tuple[ArrayF, ArrayF, ArrayI, ArrayI, float, float]:
    """Edges by their southern and northern ends, and which of them touch each strip of northings.

    A point is tested against the edges of its strip only, so that outlines of thousands of corners stay fast.
    """
    if polygon is None:
        nothing = np.zeros((0, 2))
        return nothing, nothing, np.zeros(1, dtype=np.int64), np.zeros(0, dtype=np.int64), 0.0, 0.0
    a, b = polygon, np.roll(polygon, -1, axis=0)
    sloping = a[:, 1] != b[:, 1]
    a, b = a[sloping], b[sloping]
    # both areas on a common side compute the same crossing: from the southern end
    swap = a[:, 1] > b[:, 1]
    lower, upper = np.where(swap[:, None], b, a), np.where(swap[:, None], a, b)
    south, north = float(polygon[:, 1].min()), float(polygon[:, 1].max())
    n_strips = min(max(len(polygon), 1), _MOST_STRIPS)
    per_m = n_strips / (north - south)
    first = np.clip(((lower[:, 1] - south) * per_m).astype(np.int64), 0, n_strips - 1)
    last = np.clip(((upper[:, 1] - south) * per_m).astype(np.int64), 0, n_strips - 1)
    count = last - first + 1
    edge = np.repeat(np.arange(len(lower)), count)
    strip = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count) + first[edge]
    order = np.argsort(strip, kind="stable")
    start = np.searchsorted(strip[order], np.arange(n_strips + 1))
    return np.ascontiguousarray(lower), np.ascontiguousarray(upper), start, edge[order], south, per_m


@njit(parallel=True, cache=True, error_model="numpy")
def _contains(
    points: ArrayF,
    lower: ArrayF,
    upper: ArrayF,
    start: ArrayI,
    listed: ArrayI,
    south: float,
    per_m: float,
    lowest: float,
    highest: float,
    east_curve: float,
    north_curve: float,
    base: float,
) -> ArrayB:
    """Even-odd rule: inside if an odd number of edges lies to the east; edges lack their northern ends."""
    out = np.zeros(len(points), dtype=np.bool_)
    n_strips = len(start) - 1
    for i in prange(len(points)):
        x, y = points[i, 0], points[i, 1]
        height = base + points[i, 2] + east_curve * x * x + north_curve * y * y
        if not (lowest <= height <= highest and np.isfinite(x) and np.isfinite(y) and np.isfinite(height)):
            continue
        if n_strips == 0:
            out[i] = True
            continue
        place = (y - south) * per_m
        if not (0.0 <= place <= n_strips):
            continue
        strip = min(int(place), n_strips - 1)
        inside = False
        for k in range(start[strip], start[strip + 1]):
            e = listed[k]
            if lower[e, 1] <= y < upper[e, 1]:
                share = (y - lower[e, 1]) / (upper[e, 1] - lower[e, 1])
                if x < lower[e, 0] + share * (upper[e, 0] - lower[e, 0]):
                    inside = not inside
        out[i] = inside
    return out
