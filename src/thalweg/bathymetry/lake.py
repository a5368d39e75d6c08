"""Waters that are no rivers: coordinates along two directions of the map, shores as data, levels of water.

A lake, a pond, a harbour has no centre line. Its bed is kriged in east and north, turned so that the first
axis is the direction in which heights change least: of squared differences of near soundings

    (z_i - z_j)^2 = c + h' M h,        h the vector between both,

the eigenvector of M with the smaller eigenvalue (the variogram at short lags: Chiles and Delfiner 2012,
Geostatistics, 2.5 on geometric anisotropy). The ranges along and across it are found as in a river.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import pandas as pd
import shapely
from numpy.typing import ArrayLike
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

from thalweg.core import ArrayB, ArrayF, ArrayI, GeometryError, InputError
from thalweg.ingest import NAMES, read_text_table, stated_zone

_PAIRED: Final = 1000
_NEAR: Final = 0.15
"""So many soundings tell the direction, by pairs that are nearer than this share of the whole extent."""
_HULL: Final = 0.2
"""Of the concave hull: 0 follows each sounding, 1 is convex."""
_SHORE_PLACES: Final = 800
_STRETCH: Final = 20
"""So many places of a shore count as one line."""
_PATCHES: Final = 24
_SCRAP: Final = 0.1
"""Lines shorter than this share of the whole extent are scraps."""
_FEWEST_LINES: Final = 4
_ASKED: Final = 60
_CLOCK: Final = r"\d{1,2}:\d{2}(:\d{2})?"
_DATE: Final = r"\d{4}-\d{2}-\d{2}|\d{1,2}\.\d{1,2}\.\d{4}"
_PARTS: Final = ("date", "time", "level")
_WORDS_OF_TIME: Final = frozenset(f"{NAMES['date']} {NAMES['time']}".split())
_WORDS_OF_VALUE: Final = frozenset(["value", "wert", "w", "valeur", "valor"])
"""Names of levels beside which others stand, such as a quality or a discharge."""
_DAY_S: Final = 86_400.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane:
    """Coordinates along two perpendicular directions of the map, in the place of a `FlowLine`.

    Parameters
    ----------
    centre_m : (2,) east and north of the origin.
    axis : (2,) unit vector of the first coordinate.
    """

    centre_m: ArrayF
    axis: ArrayF

    @classmethod
    def of(cls, places_m: ArrayF, height_m: ArrayF) -> Self:
        """Along the direction in which heights (n,) of places (n, 2) change least; east if all are alike."""
        some = slice(None, None, -(-len(places_m) // _PAIRED))
        xy, z = places_m[some], height_m[some]
        i, j = np.triu_indices(len(xy), 1)
        h = xy[j] - xy[i]
        near = np.hypot(*h.T) < _NEAR * float(np.hypot(*np.ptp(xy, axis=0)))
        h, square = h[near], (z[j] - z[i])[near] ** 2
        rows = np.column_stack([np.ones(len(h)), h[:, 0] ** 2, 2 * h[:, 0] * h[:, 1], h[:, 1] ** 2])
        _, ee, en, nn = np.linalg.lstsq(rows, square, rcond=None)[0]
        axis = (
            np.linalg.eigh(np.array([[ee, en], [en, nn]]))[1][:, 0] if square.any() else np.array([1.0, 0.0])
        )
        return cls(centre_m=xy.mean(axis=0), axis=axis if axis[0] >= 0 else -axis)

    @property
    def azimuth_deg(self) -> float:
        """Of the first axis, from grid north, 0 to 180."""
        return float(np.rad2deg(np.arctan2(*self.axis)) % 180.0)

    def turned(self, places_m: ArrayF) -> ArrayF:
        """Coordinates (m, 2) of places (m, 2)."""
        return (places_m - self.centre_m) @ np.array([self.axis, [-self.axis[1], self.axis[0]]]).T

    def to_flow(self, places_m: ArrayLike) -> tuple[ArrayF, ArrayF, ArrayB]:
        """Coordinates (m,) of places (m, 2), and whether they are ambiguous, which they never are."""
        s, n = self.turned(np.asarray(places_m, dtype=np.float64).reshape(-1, 2)).T
        return s, n, np.zeros(len(s), dtype=np.bool_)


def no_half_widths(s_m: ArrayLike) -> tuple[ArrayF, ArrayF]:
    """Of a water without a left and a right shore: NaN."""
    nothing = np.full(np.shape(s_m), np.nan)
    return nothing, nothing


def elongation(area: Any) -> float:
    """How many times longer than wide a water is: of a strip of this area, as wide as its widest place."""
    radius = shapely.maximum_inscribed_circle(area).length
    return float(shapely.area(area) / max(2 * radius, 1e-9) ** 2)


def area_sounded(places_m: ArrayF, margin_m: float) -> Any:
    """Polygon around places (n, 2), following their bays."""
    hull = shapely.concave_hull(shapely.multipoints(np.unique(places_m, axis=0)), ratio=_HULL)
    return shapely.buffer(hull, margin_m)


def shore_places(area: Any, least_m: float) -> tuple[ArrayF, ArrayI]:
    """Evenly spaced places (n, 2) on the shores of a polygon, islands included, and numbers of stretches."""
    rings = shapely.get_parts(shapely.boundary(area))
    step = max(float(shapely.length(rings).sum()) / _SHORE_PLACES, least_m)
    of_ring = [
        shapely.get_coordinates(shapely.line_interpolate_point(ring, np.arange(0.0, ring.length, step)))
        for ring in rings
    ]
    stretch = [
        np.char.add(f"{k} ", (np.arange(len(places)) // _STRETCH).astype(str))
        for k, places in enumerate(of_ring)
    ]
    return np.concatenate(of_ring), pd.factorize(np.concatenate(stretch))[0].astype(np.int64)


def lines_or_patches(places_m: ArrayF, line: ArrayI, seed: int) -> tuple[ArrayI, bool]:
    """Lines (n,) that can be left out one by one, or compact patches, and whether they are patches.

    A track that winds about falls into scraps, which their neighbours foretell whatever the bed is like; a
    single one cannot be left out. Patches are foretold from what lies around them.
    """
    middle = places_m - places_m.mean(axis=0)
    ends = pd.DataFrame(middle).groupby(line).agg(np.ptp)
    if len(ends) >= _FEWEST_LINES and np.median(np.hypot(*ends.to_numpy().T)) > _SCRAP * np.hypot(
        *np.ptp(middle, axis=0)
    ):
        return line, False
    k = min(_PATCHES, len(places_m) // 5)
    if k < 2:
        raise GeometryError(
            f"{len(places_m)} soundings on {len(ends)} lines",
            where="lines of soundings",
            expected="four lines, or ten soundings, of which some can be foretold from the others",
            cure="Survey more lines",
        )
    return np.asarray(kmeans2(middle, k, minit="++", rng=seed)[1], dtype=np.int64), True


def farthest_told_m(places_m: ArrayF, line: ArrayI) -> float:
    """How far from all others soundings (n,) lie when their line is left out: the usual greatest distance.

    Beyond it nothing was ever foretold: that a bed is as smooth beside a single track as along it is a guess.
    """
    numbers = np.unique(line)
    far = []
    for number in numbers[:: -(-len(numbers) // _ASKED)].tolist():
        out = line == number
        far.append(np.max(cKDTree(places_m[~out]).query(places_m[out])[0]))
    return float(np.median(far))


# ---------------------------------------------------------------- levels of the water


@dataclass(frozen=True, slots=True, kw_only=True)
class Levels:
    """Heights of the water by time.

    Parameters
    ----------
    t_s : (k,) seconds since 1970 UTC, or since midnight (``clock``).
    level_m : (k,).
    clock : times of day without a date.
    daily : one level a day; else levels between two times are interpolated.
    path : of the file.
    notes : what was assumed of it.
    """

    t_s: ArrayF
    level_m: ArrayF
    clock: bool
    daily: bool
    path: Path
    notes: tuple[str, ...] = ()

    @classmethod
    def read(cls, path: Path) -> Self:
        """A table of date or time (UTC) and level, or of date, time and level, in metres or as its name says.

        Raises
        ------
        InputError : no such table, or times that are neither ``2024-05-01``, ``2024-05-01T12:30`` nor
            ``12:30``.
        """
        table = read_text_table(path, bare=("time", "level"))
        if not table.named and len(table.columns) == len(_PARTS):
            table = read_text_table(path, order=_PARTS)
        at = table.find("level")
        of_time = [k for k, c in enumerate(table.columns) if {c.words} & _WORDS_OF_TIME]
        others = [k for k in range(len(table.columns)) if k not in of_time]
        value = next((k for k in others if table.columns[k].words in _WORDS_OF_VALUE), len(table.columns) - 1)
        last = value if at is None else at
        level = table.numbers(last, "level")
        notes = table.unit_notes(last) if table.named else []
        if at is None and table.named and len(others) > 1:
            notes.append(f"column {table.columns[last].name} taken as the level, of {table.listed()}")
        when = pd.Series(["T".join(row) for row in table.cells.iloc[:, of_time].to_numpy()], dtype=str)
        clock, daily = (bool(len(when)) and bool(when.str.fullmatch(p).all()) for p in (_CLOCK, _DATE))
        zone = stated_zone(*(table.columns[k].name for k in of_time), *table.remarks)
        if clock and zone is not None:
            raise InputError(
                f"times of day in the zone {zone}",
                where=path,
                expected="times of day in UTC, or dates beside them",
                cure="Write them as 2024-05-01T12:30+02:00",
            )
        told = None if clock or not len(table) else table.times()
        t = np.full(len(table), np.nan) if told is None else told[0]
        if clock:
            t = (
                pd.to_timedelta(when.where(when.str.count(":") > 1, when + ":00"))
                .dt.total_seconds()
                .to_numpy()
            )
        bad = np.flatnonzero(np.isnan(t) | np.isnan(level))
        if len(bad) or not len(table):
            raise InputError(
                f"no time and level: {', '.join(table.cells.iloc[bad[0]])}" if len(bad) else "no level",
                where=f"{path}:{table.line[bad[0]]}" if len(bad) else path,
                expected="times and levels",
                cure="Write date or time, and level: 2024-05-01,312.45 or 2024-05-01T12:30,312.45",
            )
        order = np.argsort(t, kind="stable")
        again = np.flatnonzero((np.diff(t[order]) == 0) & (np.diff(level[order]) != 0))
        if len(again):
            first, second = order[again[0] : again[0] + 2]
            raise InputError(
                f"two levels of one time: {', '.join(table.cells.iloc[first])}",
                where=f"{path}:{table.line[second]}",
                expected="one level a time",
                cure="Write times in UTC: a clock that is set back shows an hour twice",
            )
        notes = [*table.notes, *notes, *(told[1] if told else ())]
        return cls(
            t_s=t[order], level_m=level[order], clock=clock, daily=daily, path=path, notes=tuple(notes)
        )

    def at(self, t_s: ArrayF) -> ArrayF:
        """Level (n,) at times (n,), seconds since 1970 UTC.

        Raises
        ------
        InputError : times of other days or beyond the first and the last level.
        """
        t = np.asarray(t_s, dtype=np.float64)
        if self.clock:
            if len(days := np.unique(t // _DAY_S)) > 1:
                raise InputError(
                    f"levels by time of day, soundings of {len(days)} days",
                    where=self.path,
                    expected="dates beside the times",
                    cure="Add the date of each level",
                )
            t = t % _DAY_S
        if self.daily:
            at = np.searchsorted(self.t_s, t, side="right") - 1
            known = (at >= 0) & (t - self.t_s[at] < _DAY_S)
            value = self.level_m[at]
        else:
            known = (t >= self.t_s[0]) & (t <= self.t_s[-1])
            value = np.interp(t, self.t_s, self.level_m)
        if not known.all():
            first = pd.Timestamp(t_s[~known].min(), unit="s")
            raise InputError(
                f"no level for {int((~known).sum()):,} of {len(t):,} soundings, "
                f"the first at {first:%Y-%m-%d %H:%M} UTC",
                where=self.path,
                expected="levels of all days"
                if self.daily
                else "levels from before the first to after the last",
                cure="Add levels, or leave these soundings out",
            )
        return np.asarray(value)
