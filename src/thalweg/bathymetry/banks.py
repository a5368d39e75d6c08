"""Bank lines where the ground of the lidar cloud meets the water, and the centre line between them.

At stations along the river, points less than a step above the water are sorted into slices by height. The
distance of the ground from the centre line is linear in height near the water,

    n(h) = n_0 + h / slope,

so that the median distance of each slice gives the shoreline ``n_0`` with ``sigma_across = sigma_up / slope``
and the scatter of the slices. A bank that nobody saw is bridged over short gaps, and marked; farther it is
left out.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from pyproj import CRS
from scipy.signal import fftconvolve

from thalweg.bathymetry.flow import FlowLine
from thalweg.bathymetry.water import WaterLevel
from thalweg.core import (
    NMAD,
    AnyArray,
    ArrayB,
    ArrayF,
    CoverageError,
    GeometryError,
    InputError,
    LocalFrame,
    iter_laz,
)
from thalweg.core.values import read_vectors
from thalweg.settings.sections import Bathymetry

SIDES: Final = {"left": 1.0, "right": -1.0}
"""Sides of the flow, and the sign of n there."""

_SLICES_M: Final = np.array([0.04, 0.12, 0.2, 0.3, 0.42, 0.56, 0.72])
"""Heights above the water that bound the slices."""
_LOWEST_M: Final = 0.42
"""A bank is seen where one slice lies below this height: higher ground says nothing about the shore."""
_FEWEST: Final = 4
"""Points of a slice."""
_STEEPEST: Final = 0.02
"""Floor of the standard deviation of a shoreline, metres."""
_WORSE: Final = 0.15
"""A bridged shoreline is this much less certain for each metre to the next one that was seen."""
_SHORE_POINTS: Final = 2_000_000
"""Points near the water that are held at least, if there are so many, and at most twice so many."""
_FARTHEST_M: Final = 250.0
_RESAMPLED_M: Final = 0.5
_END_M: Final = 40.0
"""The centre line goes on straight beyond the survey for this length."""
_JUDGED: Final = 8000
"""Places of a track from which an axis is judged."""
_BEND: Final = 0.6
"""An axis of the track bends at most so much: half its width times its curvature."""
_PLATEAU: Final = 1.15
"""Twice the smoothing spreads the track about its axis by less than this: the zigzag is gone."""
_BACK: Final = 1.6
"""A track whose smoothed length is so many times its extent went up and down."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Banks:
    """Both shorelines in flow coordinates.

    Parameters
    ----------
    table : columns side, s_m, n_m, east_m, north_m, up_m, sigma_across_m, seen; sorted by side and s.
    line : the centre line.
    """

    table: pd.DataFrame
    line: FlowLine

    def half_widths_m(self, s_m: ArrayLike) -> tuple[ArrayF, ArrayF]:
        """Distances (n,) of the left and the right shore from the centre line; NaN where there is none."""
        s = np.asarray(s_m, dtype=np.float64)
        out = []
        for side in SIDES:
            of = self.table[self.table["side"] == side]
            place, n = of["s_m"].to_numpy(np.float64), np.abs(of["n_m"].to_numpy(np.float64))
            if len(place) < 2:
                out.append(np.full(s.shape, np.nan))
                continue
            after = np.clip(np.searchsorted(place, s), 1, len(place) - 1)
            # no bank between stations that are far apart: there the gap was not bridged
            near = (place[after] - place[after - 1]) < 2.5 * float(np.median(np.diff(place)))
            inside = (s >= place[0]) & (s <= place[-1]) & near
            out.append(np.where(inside, np.interp(s, place, n), np.nan))
        return out[0], out[1]

    def outside(self, s_m: ArrayF, n_m: ArrayF) -> ArrayB:
        """Which flow coordinates (n,) lie behind a shore; none where there is none."""
        left, right = self.half_widths_m(s_m)
        return np.asarray((n_m > left) | (n_m < -right))

    def write(self, path: Path) -> None:
        """As CSV, places in wcs."""
        self.table.to_csv(path, index=False, float_format="%.4f")

    @classmethod
    def read(cls, path: Path, line: FlowLine) -> "Banks":
        """What `write` wrote."""
        return cls(table=pd.read_csv(path), line=line)


# ---------------------------------------------------------------- an axis to begin with


def axis_of_track(track_m: ArrayF) -> FlowLine:
    """A line down the river from the boat's track, smoothed just so much that its zigzag is gone.

    Parameters
    ----------
    track_m : (n, 2) east and north, in the order of time.

    Raises
    ------
    GeometryError : the boat did not move, or went up and down: then a centre line must be given.
    """
    p = np.asarray(track_m, dtype=np.float64)
    p = p[np.isfinite(p).all(axis=1)]
    # a boat that stands jitters: only steps beyond the jitter count
    kept, last = [0], 0
    for k in range(1, len(p)):
        if np.hypot(*(p[k] - p[last])) >= _RESAMPLED_M:
            kept.append(k)
            last = k
    p = p[kept]
    if len(p) < 8:
        raise GeometryError(
            f"a track of {len(p)} places {_RESAMPLED_M:g} m apart",
            expected="a boat that went along the river",
            where="the trajectory",
            cure="State logs.centre_line",
        )
    way = _way(p)
    at = np.arange(0.0, way[-1], _RESAMPLED_M)
    even = np.column_stack([np.interp(at, way, each) for each in p.T])
    # Smoothing beyond the zigzag's own length moves the line no more; far beyond, it cuts the bends.
    usable: list[tuple[FlowLine, float]] = []
    every = -(-len(even) // _JUDGED)
    sigma = 4.0
    while sigma < way[-1] / 2:
        smooth = _smoothed(even, sigma / _RESAMPLED_M)
        line = _through(smooth)
        s, n, fold = line.to_flow(even[::every])
        reach = float(np.abs(n).max())
        bend = float(np.abs(line.curvature(np.linspace(0, line.length_m, 200))).max()) * max(reach, 1.0)
        spread = float(np.sqrt(np.mean(n**2)))
        length = np.linalg.norm(np.diff(smooth, axis=0), axis=1).sum()
        straight = length < _BACK * np.linalg.norm(smooth[-1] - smooth[0]) or length > 20 * reach
        if usable and spread < _PLATEAU * usable[-1][1]:
            return usable[-1][0]
        if not fold.any() and bend < _BEND and np.mean(np.diff(s) < -0.05 * every) < 0.02 and straight:
            usable.append((line, spread))
        else:
            usable.clear()
        sigma *= 2.0
    if usable:
        return usable[-1][0]
    middle = even.mean(axis=0)
    axes = np.linalg.svd(even - middle, full_matrices=False)[2]
    along, across = ((even - middle) @ axes.T).T
    if np.ptp(along) < 1.5 * np.ptp(across):
        raise GeometryError(
            "the track shows no direction of the river",
            expected="a survey along the river",
            where="the trajectory",
            cure="State logs.centre_line: CSV east_m, north_m, downstream",
        )
    if (even[-1] - even[0]) @ axes[0] < 0:
        axes, along = -axes, -along
    ends = np.linspace(float(along.min()), float(along.max()), 20)
    return _through(middle + ends[:, None] * axes[0])


def _smoothed(points: ArrayF, sigma: float) -> ArrayF:
    """Points smoothed along their line; the ends go on by reflection through themselves."""
    pad = min(round(4 * sigma), len(points) - 1)
    head = 2 * points[0] - points[pad:0:-1]
    tail = 2 * points[-1] - points[-2 : -pad - 2 : -1]
    wide = np.concatenate([head, points, tail])
    reach = int(4 * sigma + 0.5)
    bell = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    wide = np.pad(wide, [(reach, reach), (0, 0)], mode="edge")
    middle = wide.mean(axis=0)  # small numbers keep their digits
    smooth = middle + fftconvolve(wide - middle, (bell / bell.sum())[:, None], mode="valid", axes=0)
    return np.asarray(smooth[pad : pad + len(points)])


def _through(points: ArrayF) -> FlowLine:
    """A centre line through points, sampled coarsely, that goes on straight beyond them."""
    n = max(int(_way(points)[-1] / 4.0), 4)
    return FlowLine.through(beyond(resampled(points, n), _END_M, steps=5))


def resampled(line_m: ArrayF, n: int) -> ArrayF:
    """``n`` places at even distances along a line (k, 2), from its start to its end."""
    # shapely would look for each place from the start of the line
    way = _way(line_m)
    at = np.linspace(0.0, way[-1], n)
    return np.column_stack([np.interp(at, way, each) for each in line_m.T])


def _way(line_m: ArrayF) -> ArrayF:
    """Distances (k,) of the corners of a line from its start, along it."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line_m, axis=0), axis=1))])


def beyond(line_m: ArrayF, reach_m: float, *, steps: int = 1) -> ArrayF:
    """Places (k, 2) of a line that goes on straight beyond both ends, in so many steps."""
    away = np.linspace(0.0, reach_m, steps + 1)[1:, None]
    before, after = (
        b + away * (b - a) / max(float(np.linalg.norm(b - a)), 1e-9) for a, b in (line_m[1::-1], line_m[-2:])
    )
    return np.concatenate([before[::-1], line_m, after])


# ---------------------------------------------------------------- banks


def trace_banks(
    cloud_m: ArrayF,
    sigma_up_m: ArrayF,
    sigma_horizontal_m: ArrayF,
    axis: FlowLine,
    level: WaterLevel,
    span_m: tuple[float, float],
    settings: Bathymetry,
) -> pd.DataFrame:
    """Shorelines on both sides of an axis.

    Parameters
    ----------
    cloud_m : (n, 3) points of the banks in wcs.
    sigma_up_m, sigma_horizontal_m : (n,) of each.
    axis : near the middle of the river.
    level : of the water along this axis.
    span_m : part of the axis that was surveyed.
    settings : stations and gaps.

    Returns
    -------
    table : see `Banks`.
    """
    rows: list[tuple[Any, ...]] = []
    stations = np.arange(span_m[0], span_m[1] + settings.bank_station_m, settings.bank_station_m)
    low = cloud_m[:, 2] <= float(level.at(np.array(span_m))[0].max()) + _SLICES_M[-1]
    cloud_m, sigma_up_m, sigma_horizontal_m = cloud_m[low], sigma_up_m[low], sigma_horizontal_m[low]
    s, n, fold = axis.to_flow(cloud_m[:, :2])
    above = cloud_m[:, 2] - level.at(s)[0]
    near = ~fold & (np.abs(n) < _FARTHEST_M) & (above > _SLICES_M[0]) & (above < _SLICES_M[-1])
    for side, sign in SIDES.items():
        mine = np.flatnonzero(near & (n * sign > 0))
        mine = mine[np.argsort(s[mine], kind="stable")]
        first = np.searchsorted(s[mine], stations - settings.bank_station_m / 2)
        last = np.searchsorted(s[mine], stations + settings.bank_station_m / 2)
        found = []
        for station, a, b in zip(stations.tolist(), first, last, strict=True):
            at = mine[a:b]
            shore = _shore(above[at], np.abs(n[at]))
            if shore is None:
                continue
            n0, rate, scatter = shore
            up = np.hypot(np.median(sigma_up_m[at]), level.at(np.array([station]))[1][0])
            sigma = np.sqrt(
                (up * rate) ** 2 + np.median(sigma_horizontal_m[at]) ** 2 + scatter**2 + _STEEPEST**2
            )
            found.append((station, sign * n0, sigma))
        rows += _bridged(side, np.array(found).reshape(-1, 3), stations, settings.bank_gap_m)
    table = pd.DataFrame(rows, columns=["side", "s_m", "n_m", "sigma_across_m", "seen"])
    return _placed(table, axis, level)


def _shore(height_m: ArrayF, n_m: ArrayF) -> tuple[float, float, float] | None:
    """Distance of the shoreline, metres across per metre up, and standard deviation of the fit."""
    number = np.digitize(height_m, _SLICES_M) - 1
    h, n, w = [], [], []
    for k in range(len(_SLICES_M) - 1):
        of = number == k
        if of.sum() >= _FEWEST:
            h.append(float(np.median(height_m[of])))
            n.append(float(np.median(n_m[of])))
            w.append(NMAD * float(np.median(np.abs(n_m[of] - n[-1]))) / np.sqrt(of.sum()) + 0.01)
    if len(h) < 2 or h[0] > _LOWEST_M:
        return None
    x, y, e = np.array(h[:4]), np.array(n[:4]), np.array(w[:4])
    # ground rises away from the water: medians that come back are plants that hang over
    design = np.column_stack([np.ones(len(x)), x]) / e[:, None]
    inverse = np.linalg.inv(design.T @ design + np.diag([0.0, 1e-4]))
    value = inverse @ (design.T @ (y / e))
    rest = (y - value[0] - value[1] * x) / e
    size = max(float(rest @ rest) / max(len(x) - 2, 1), 1.0)
    rate = float(np.clip(value[1], 0.0, 50.0))
    n0 = float(value[0]) if value[1] >= 0 else float(np.average(y, weights=1 / e**2))
    return n0, rate, float(np.sqrt(inverse[0, 0] * size))


def _bridged(side: str, found: ArrayF, stations: ArrayF, gap_m: float) -> list[tuple[Any, ...]]:
    """Rows of one side: seen ones, and those between them over gaps that are short enough."""
    if not len(found):
        return []
    rows = []
    place = found[:, 0]
    for s in stations.tolist():
        k = int(np.searchsorted(place, s))
        if k < len(place) and place[k] == s:
            rows.append((side, s, float(found[k, 1]), float(found[k, 2]), True))
        elif 0 < k < len(place) and place[k] - place[k - 1] <= gap_m:
            n = float(np.interp(s, place, found[:, 1]))
            away = min(s - place[k - 1], place[k] - s)
            sigma = float(np.hypot(np.interp(s, place, found[:, 2]), _WORSE * away))
            rows.append((side, s, n, sigma, False))
    return rows


def _placed(table: pd.DataFrame, line: FlowLine, level: WaterLevel) -> pd.DataFrame:
    """With places in the world."""
    xy = line.to_map(table["s_m"].to_numpy(np.float64), table["n_m"].to_numpy(np.float64))
    up = level.at(table["s_m"].to_numpy(np.float64))[0]
    table = table.assign(east_m=xy[:, 0], north_m=xy[:, 1], up_m=up)
    return table[["side", "s_m", "n_m", "east_m", "north_m", "up_m", "sigma_across_m", "seen"]]


def centre_of(banks: pd.DataFrame, axis: FlowLine) -> FlowLine:
    """The line half way between both banks, smoothed; the axis where there are not both."""
    left, right = (banks[banks["side"] == side].set_index("s_m")["n_m"] for side in SIDES)
    both = left.index.intersection(right.index)
    if len(both) < 4:
        return axis
    s = both.to_numpy(np.float64)
    n = (left.loc[both].to_numpy(np.float64) + right.loc[both].to_numpy(np.float64)) / 2
    width = float(np.median(left.loc[both].to_numpy() - right.loc[both].to_numpy()))
    step = float(np.median(np.diff(s)))
    n = _smoothed(n[:, None], max(width / 2 / step, 1.0))[:, 0] if len(n) > 8 else n
    at = np.arange(0.0, axis.length_m, max(step, 1.0))
    return FlowLine.through(
        axis.to_map(at, np.interp(at, s, n))[:: max(1, round(width / 4 / max(step, 1.0)))]
    )


def onto_line(banks: pd.DataFrame, line: FlowLine) -> pd.DataFrame:
    """The same banks in the flow coordinates of another line.

    Raises
    ------
    GeometryError : left and right are swapped, or a bank crosses the centre line.
    """
    if not len(banks):
        return banks
    s, n, _ = line.to_flow(banks[["east_m", "north_m"]].to_numpy(np.float64))
    return on_their_sides(banks.assign(s_m=s, n_m=n), "bank lines (logs.bank_lines, --banks)")


def on_their_sides(banks: pd.DataFrame, where: Path | str) -> pd.DataFrame:
    """Places of banks that lie on the side of the centre line that they name, in order.

    Raises
    ------
    GeometryError : one of twenty or more does not.
    """
    right = banks["side"].map(SIDES).astype(np.float64) * banks["n_m"] > 0
    wrong = float(np.mean(~right)) if len(banks) else 0.0
    if wrong > 0.05:
        raise GeometryError(
            f"{wrong:.0%} of the bank's places lie on the other side of the centre line",
            expected="left and right of the flow, downstream",
            where=where,
            cure="Turn the centre line round, or exchange the sides"
            if wrong > 0.5
            else "Draw the bank lines so that they do not cross",
        )
    return banks[right].sort_values(["side", "s_m"], kind="stable", ignore_index=True)


def side_of(properties: Mapping[str, Any]) -> str | None:
    """The side of a bank line by its property ``side``, or by the layer of a drawing or its name."""
    of = {name.lower(): str(value).strip().lower() for name, value in properties.items()}
    return next((of[name] for name in ("side", "layer", "name") if of.get(name) in SIDES), None)


def read_banks(path: Path, frame: LocalFrame, crs: CRS, notes: list[str] | None = None) -> pd.DataFrame:
    """Bank lines of a file of vectors: lines with a property ``side``.

    Parameters
    ----------
    frame, crs : of the world; the campaign's map, where the file states no coordinate system.
    notes : takes what was left out or assumed.

    Returns
    -------
    table : columns side, east_m, north_m (wcs), sigma_across_m, seen.

    Raises
    ------
    InputError : no file of vectors, no lines, or no side.
    """
    drawn = read_vectors(path).on_map(crs)
    parts = []
    kinds = drawn.table.geometry.geom_type
    for xyz, properties in drawn.lines() if (kinds == "LineString").all() else [(np.empty((0, 2)), {})]:
        side = side_of(properties)
        if side is None:
            raise InputError(
                f"{', '.join(kinds.unique())} with side {properties.get('side')!r}",
                where=path,
                expected="lines with a property side: left or right of the flow",
                cure="Add the property, as one looks downstream",
            )
        wcs = frame.from_map(np.column_stack([xyz[:, :2], np.full(len(xyz), frame.h_ell_m)]), crs)
        sigma = pd.to_numeric(properties.get("sigma_m", np.nan), errors="coerce")
        parts.append(
            pd.DataFrame(
                {
                    "side": side,
                    "east_m": wcs[:, 0],
                    "north_m": wcs[:, 1],
                    "sigma_across_m": 0.5 if pd.isna(sigma) else float(sigma),
                }
            )
        )
    if {str(p["side"].iloc[0]) for p in parts} != set(SIDES):
        raise InputError(
            "not both banks",
            where=path,
            expected="at least a left and a right bank line",
            cure="Draw the other bank, or leave the file out where the lidar saw both",
        )
    if notes is not None:
        notes.extend(drawn.notes)
    return pd.concat(parts, ignore_index=True).assign(seen=True)


def flow_of_survey(
    track_m: ArrayF,
    cloud: tuple[ArrayF, ArrayF, ArrayF],
    level_of: Any,
    settings: Bathymetry,
    *,
    given_line: FlowLine | None = None,
    given_banks: pd.DataFrame | None = None,
) -> tuple[Banks, WaterLevel]:
    """Centre line, banks and water level of a survey: each needs the others, so that it is done twice.

    Parameters
    ----------
    track_m : (n, 2) of the boat.
    cloud : points (n, 3), sigmas up and horizontal (n,); none without a lidar, then banks are given.
    level_of : gives the `WaterLevel` along a line.
    settings : see there.
    given_line, given_banks : by the user, instead.

    Raises
    ------
    CoverageError : no bank was seen and none is given.
    """
    line = given_line or axis_of_track(track_m)
    table = given_banks if given_banks is not None else pd.DataFrame()
    for _ in range(2):
        level = level_of(line)
        s = line.to_flow(track_m)[0]
        if given_banks is None:
            table = trace_banks(*cloud, line, level, (float(s.min()), float(s.max())), settings)
        else:
            table = onto_line(given_banks, line)
            table = _placed(table, line, level)
        if given_line is None:
            line = centre_of(_at_stations(table, settings.bank_station_m), line)
            table = onto_line(table, line)
    level = level_of(line)
    if not len(table):
        raise CoverageError(
            "no bank: no ground of the cloud lies within 0.7 m above the water",
            expected="points of at least one bank near the water",
            where="the cloud of the banks",
            cure="Look at filters.water_line_ics_m, or state logs.bank_lines and logs.centre_line",
        )
    return Banks(table=table, line=line), level


def shore_points(paths: Sequence[Path], level_m: float) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Points of a cloud that may show where the ground meets the water, with their sigmas.

    Parameters
    ----------
    paths : clouds with the standard deviations of their points.
    level_m : about the height of the water.

    Returns
    -------
    points_m : (n, 3) in wcs, a metre below the level and two above it; of more than 4 million every second,
        fourth and so on, so that memory does not grow with the log.
    sigma_up_m, sigma_horizontal_m : (n,) of each.

    Raises
    ------
    InputError : the points carry no standard deviations.
    """
    parts, step, n, held = [np.empty((0, 5))], 1, 0, 0
    for path in paths:
        for chunk in iter_laz(path):
            if "sigma_up" not in chunk:
                raise InputError(
                    "the cloud has no standard deviations", where=path, expected="a cloud made by Thalweg"
                )
            near = np.flatnonzero(np.abs(chunk["xyz_m"][:, 2] - level_m - 0.5) < 1.5)
            n, near = n + len(near), near[-n % step :: step]
            across = np.hypot(chunk["sigma_east"][near], chunk["sigma_north"][near]) / np.sqrt(2)
            parts.append(np.column_stack([chunk["xyz_m"][near], chunk["sigma_up"][near], across]))
            held += len(near)
            while held > 2 * _SHORE_POINTS:
                parts, step = [np.concatenate(parts)[::2]], 2 * step
                held = len(parts[0])
    rows = np.concatenate(parts)
    return rows[:, :3], rows[:, 3], rows[:, 4]


def _at_stations(table: pd.DataFrame, step_m: float) -> pd.DataFrame:
    """Banks at common places along the line, so that left and right can be paired."""
    parts = []
    for side, of in table.groupby("side"):
        s = of["s_m"].to_numpy(np.float64)
        at = np.arange(np.ceil(s.min() / step_m), np.floor(s.max() / step_m) + 1) * step_m
        near = np.abs(s[np.clip(np.searchsorted(s, at), 0, len(s) - 1)] - at) < 3 * step_m
        parts.append(pd.DataFrame({"side": side, "s_m": at, "n_m": np.interp(at, s, of["n_m"])})[near])
    return pd.concat(parts, ignore_index=True) if parts else table


def bank_observations(banks: Banks, level: WaterLevel) -> dict[str, AnyArray]:
    """Shorelines as data of the bed: heights of the water, uncertain by the slope that the bank has there.

    Returns
    -------
    columns : s_m, n_m, height_m, sigma_white_m, sigma_slow_m, line; line is negative, one a stretch of 20 m.
    """
    table = banks.table
    s, n = table["s_m"].to_numpy(np.float64), table["n_m"].to_numpy(np.float64)
    height, sigma_level = level.at(s)
    # what a shift across means in height: the bed near the shore falls by about its depth over the half width
    steep = 0.3
    stretch = (s // 20.0).astype(np.int64)
    line = -2 - 2 * (stretch - stretch.min()) - (table["side"] == "left").to_numpy(np.int64)
    return {
        "s_m": s,
        "n_m": n,
        "height_m": height,
        "sigma_white_m": np.maximum(steep * table["sigma_across_m"].to_numpy(np.float64), 0.01),
        "sigma_slow_m": sigma_level,
        "line": line,
    }
