"""Beds from soundings of others: tables, bank lines and centre lines on a map, without a boat's trajectory.

Heights stay in the table's own vertical system. Without a centre line, one is laid through the middles of the
lines of soundings (sections, zigzag), or along the longest of them where they run down the river.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import pandas as pd
import shapely
from numpy.typing import ArrayLike
from pyproj import CRS
from pyproj.exceptions import CRSError
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree, shortest_path
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from thalweg.bathymetry.banks import SIDES, Banks, beyond, on_their_sides, resampled, side_of
from thalweg.bathymetry.bed import BANDS, OBSERVATIONS, Bed, cells_of_river, gridded, observations_of
from thalweg.bathymetry.crossings import DAY_GAP_S, agreement, runs_by_pauses, since_pauses
from thalweg.bathymetry.flow import FlowLine
from thalweg.bathymetry.lake import (
    Levels,
    Plane,
    area_sounded,
    elongation,
    farthest_told_m,
    lines_or_patches,
    no_half_widths,
    shore_places,
)
from thalweg.bathymetry.signs import asked_of_lake, asked_of_river, asked_of_shores
from thalweg.bathymetry.validation import by_class, measures, validate_bed
from thalweg.bathymetry.variogram import Basin, HalfWidths, choose_model
from thalweg.core import (
    ArrayB,
    ArrayF,
    ArrayI,
    GeometryError,
    Grid,
    InputError,
    LocalFrame,
    frame_of,
    iter_laz,
    laz_header,
    read_dsm,
    read_raster,
    utc_text_from_unix,
    write_raster,
)
from thalweg.core.values import METRE, check_places, is_vector_file, read_vectors, units_of_crs
from thalweg.ingest import NAMES, Table, read_places
from thalweg.ingest.registry import soundings_table
from thalweg.settings.sections import Bathymetry

_DROWNED_M: Final = 0.5
"""Bank lines stand at the water's edge: heights this far below the level are those of another water."""
_BREAK: Final = 8.0
"""A step this many times the usual one ends a line of soundings."""
_TURN_DEG: Final = 45.0
_SHUFFLED: Final = 0.2
"""A file with more breaks than this share of its rows does not follow the boat: its lines are clusters."""
_CONTRADICT: Final = 3.0
"""Soundings of one place that differ by so many sigmas contradict each other."""
_SIGMA_BANK_M: Final = 0.5
_STEEP: Final = 0.3
"""Rise of the bed near the shore, for what a shoreline's error across is in height."""
_STATIONS: Final = 400
_OTHER_DATUM_M: Final = 25.0
"""Ellipsoid and geoid differ by more nearly everywhere in Europe; no river falls so much in a survey."""
_RIVER: Final = 3.0
"""A river's reach is at least so many widths long."""
_REACHED: Final = 0.9
"""Flow coordinates suit a water of which at least this share has them."""
_COURSE: Final = 0.2
"""Lines across a river, or beside each other, leave half of the soundings on more than this share of it."""
_PLACES: Final = 2000
_APART: Final = 30.0
"""In correlation times: errors so far apart are independent."""
_LINE_STRING: Final = 1
"""Of shapely's types."""
_WIDEST_M: Final = 1_000_000.0
_OF_WATER: Final = frozenset(["tide", "heave", "squat", "draft", "draught"])
"""Words in names of columns that may be in the depths already."""
_ALONE: Final = 0.5
"""More soundings than this share outside the banks: they are of another place."""


def map_crs(text: str, *, feet: bool = False) -> CRS:
    """A coordinate system of a map.

    Parameters
    ----------
    feet : also one in feet; else in metres alone.

    Raises
    ------
    InputError : unknown, in degrees, or in feet.
    """
    try:
        crs = CRS.from_user_input(text)
    except CRSError as error:
        raise InputError(
            f"--crs {text}: {error}", expected="a projected system such as EPSG:32633"
        ) from error
    if not crs.is_projected or not (feet or units_of_crs(crs)[0] == METRE):
        raise InputError(
            f"{text} ({crs.name}) is in {crs.axis_info[0].unit_name}{'' if crs.is_projected else 's'}",
            where="--crs",
            expected="a projected system in metres",
            cure="State the UTM zone of the river, such as EPSG:32633: degrees are transformed to it, and "
            "files that state another system",
        )
    return crs


def read_line(
    path: Path, crs: CRS | None = None, notes: list[str] | None = None, *, frame: LocalFrame | None = None
) -> FlowLine:
    """A centre line, downstream: table of places, or a file of vectors with one line.

    Parameters
    ----------
    path, crs : file and map; None: the numbers of the file, in metres.
    notes : takes what was left out or assumed.
    frame : of the world, for a line in wcs instead of on the map.

    Raises
    ------
    InputError : no line, or one in degrees without a map.
    GeometryError : fewer than three places.
    """
    if is_vector_file(path):
        drawn = read_vectors(path)
        if crs is not None:
            drawn = drawn.on_map(crs)
        elif drawn.crs is not None and units_of_crs(drawn.crs)[0] != METRE:
            raise InputError(
                f"a centre line in {drawn.crs.name}",
                where=path,
                expected="places in metres on a map",
                cure="Transform it to the map of the other places, such as the UTM zone of the river",
            )
        lines = drawn.lines()
        if len(lines) != 1:
            raise InputError(f"{len(lines)} lines", where=path, expected="one centre line")
        _keep(drawn.notes, notes)
        xy = lines[0][0][:, :2]
    else:
        xy = read_places(path, crs, any_system=True)[1].xy_m
        xy = xy[np.isfinite(xy).all(axis=1)]
        if crs is not None:
            check_places(xy, crs, where=path, cure="campaign.crs")
    if frame is not None and crs is not None:
        xy = frame.from_map(np.column_stack([xy, np.full(len(xy), frame.h_ell_m)]), crs)[:, :2]
    return FlowLine.through(xy)


def read_islands(path: Path, crs: CRS, notes: list[str] | None = None) -> list[list[tuple[float, float]]]:
    """Outlines of islands, polygons of a file of vectors, on the map.

    Parameters
    ----------
    notes : takes what was left out or assumed.

    Raises
    ------
    InputError : no polygon.
    """
    drawn = read_vectors(path).on_map(crs)
    outlines = [[(x, y) for x, y, *_ in each.exterior.coords] for each in drawn.polygons()]
    if not outlines:
        raise InputError("no polygon", where=path, expected="islands as polygons")
    _keep(drawn.notes, notes)
    return outlines


def _keep(found: Iterable[str], notes: list[str] | None) -> None:
    if notes is not None:
        notes.extend(found)


# ---------------------------------------------------------------- soundings


@dataclass(frozen=True, slots=True, kw_only=True)
class TableOfSoundings:
    """Soundings of a table.

    Parameters
    ----------
    places_m : (n, 2) east and north.
    height_m, sigma_m : (n,) and their noise.
    line : (n,) number of the line.
    crs : of the map.
    column, depth : name of the column of values, and whether they are depths.
    notes : what was converted, assumed and left out.
    day : (n,) number of the day; None: unknown.
    days : names of the days.
    t_s : (n,) seconds since 1970 UTC; None: unknown.
    level_m : height of the water in the median, where it is told by time.
    run : (n,) number of the run, within which the height of the transducer, the water level and the speed of
        sound are the same; None: the days are runs, or there is one.
    runs : names of the runs.
    """

    places_m: ArrayF
    height_m: ArrayF
    sigma_m: ArrayF
    line: ArrayI
    crs: CRS
    column: str
    depth: bool
    notes: tuple[str, ...] = ()
    day: ArrayI | None = None
    days: tuple[str, ...] = ()
    t_s: ArrayF | None = None
    level_m: float | None = None
    run: ArrayI | None = None
    runs: tuple[str, ...] = ()

    def above(self, levels: Levels) -> Self:
        """Depths, which `height_m` holds below zero, as heights below levels of the water.

        Raises
        ------
        InputError : the table has no times, or there is no level for some.
        """
        if self.t_s is None:
            raise InputError(
                "soundings without times",
                where="--levels",
                expected="a column of times beside the depths",
                cure="Name the column of the times, or state one --level",
            )
        level = levels.at(self.t_s)
        notes = (*self.notes, *(f"{levels.path.name}: {note}" for note in levels.notes))
        return replace(self, height_m=self.height_m + level, level_m=float(np.median(level)), notes=notes)


def read_soundings(
    path: Path,
    crs: CRS | None,
    *,
    column: str | None,
    depth: bool | None,
    level_m: float | None,
    line_column: str | None,
    sigma_m: float,
    order: Sequence[str] | None = None,
    nothing: Sequence[float] = (),
    keep: Sequence[float] = (),
) -> TableOfSoundings:
    """Soundings of a table.

    Parameters
    ----------
    path, crs, order : see `thalweg.ingest.read_places`.
    column : of heights, or of depths below ``level_m`` (0 where none is stated); None: as the names tell.
    depth : whether its values are depths; None: as its name tells.
    nothing, keep : values that stand for none beside the usual ones, and such of them that are meant.
    line_column : numbers or names of lines, files, launches: each is a run of its own. None: lines from the
        course, or from clusters; runs from pauses, if there are times.
    sigma_m : noise of a height, where the table has no column ``sigma`` or ``sigma_m``.

    Raises
    ------
    InputError : no such column, or none that says whether it holds depths; depths that are heights or the
        other way round; places that the map does not have; fewer than four soundings; all in one place or on
        one straight line.
    """
    if (recorded := soundings_table(path)) is None:
        table, found = read_places(path, crs, order=order)
    else:
        table = Table.of(recorded[0], path)
        found = table.places(crs)
        found = replace(found, notes=[*recorded[1], *found.notes])
    assert found.crs is not None
    up = None if crs is None else units_of_crs(crs)[1]
    if up is not None and not up.is_metre:  # as --crs EPSG:2263+6360 states
        table = table.heights_in(up)
    k, depth = _column_of_values(table, column, depth)
    column, places = table.columns[k].name, found.xy_m
    value = table.numbers(k, "depth" if depth else "height", nothing=nothing, keep=keep)
    at_sigma = table.find("sigma")
    sigma = np.full(len(table), sigma_m) if at_sigma is None else table.numbers(at_sigma, "sigma")
    known = np.isfinite(value) & np.isfinite(places).all(axis=1) & np.isfinite(sigma) & (sigma > 0)
    notes = [*table.notes, *found.notes, *table.unit_notes(k), *table.loss_notes()]
    if not depth:
        notes.append(f"column {column} taken as heights, positive upwards: depths need --depth {column}")
    if at_sigma is not None:
        notes.append(f"column {table.columns[at_sigma].name} taken as standard deviations of the {column}")
    of_water = _OF_WATER | {*f"{NAMES['draught']} {NAMES['level']}".split()}
    notes += [
        f"column {other.name} is not added: depths are taken from the water"
        for other in (table.columns if depth else ())
        if other.words in of_water or _OF_WATER & {*other.words.split("_")}
    ]
    if known.any():
        notes.append(
            check_places(
                places[known],
                found.crs,
                where=path,
                height_m=-value[known] if depth else value[known],
                cure="--crs",
            )
        )
    if depth and known.any() and np.mean(value[known] < 0) > 0.5:
        raise InputError(
            f"{np.mean(value[known] < 0):.0%} of the depths in {column} are negative",
            where=path,
            expected="depths, positive downwards",
            cure=f"Use --height {column} if they are heights",
        )
    if not depth and level_m is not None and known.any() and np.mean(value[known] > level_m) > 0.5:
        raise InputError(
            f"{np.mean(value[known] > level_m):.0%} of the heights in {column} are above the level of "
            f"{level_m:g} m",
            where=path,
            expected="heights of a bed under water",
            cure=f"Use --depth {column} if they are depths; look at --level",
        )
    if depth and (n := int(np.count_nonzero(value[known] < 0))):
        notes.append(f"{n:,} depths in {column} are negative: above the level that they count from")
    height = (level_m or 0.0) - value if depth else value
    t_s = np.full(len(table), np.nan)
    if (when := table.times()) is not None:
        t_s, said = when
        notes += said
    # a row that stands twice, as in a file joined with itself, is one sounding on one line
    again = pd.DataFrame(np.column_stack([places, height, t_s])).duplicated().to_numpy() & known
    known &= ~again
    if n := int(again.sum()):
        notes.append(f"{n:,} rows stand in the table before, with the same place and value: taken once")
    names = (
        np.full(len(table), "") if line_column is None else np.array(table.text(table.column(line_column)))
    )
    named, name = pd.factorize(names[known])
    line = _lines_by_place(places[known]) if line_column is None else named.astype(np.int64)
    of = pd.DataFrame(
        {
            "x": np.round(places[known, 0], 3),
            "y": np.round(places[known, 1], 3),
            "h": height[known],
            "v": sigma[known] ** 2,
            "line": line,
            "name": named,
            "t": t_s[known],
            "day": since_pauses(t_s[known], DAY_GAP_S),
        }
    )
    groups = of.groupby(["x", "y", "day"], sort=False, dropna=False)
    spread = groups["h"].agg(np.ptp)
    more = len(of) - len(spread)
    if more:
        notes.append(
            f"{more:,} soundings lie at the place of another one of the same day: their mean is taken"
        )
        differ = int((spread > _CONTRADICT * np.sqrt(2 * groups["v"].max())).sum())
        if differ:
            notes[-1] += (
                f"; at {differ:,} places they differ by more than {_CONTRADICT:g} sigmas, and half of the "
                "difference is taken as their sigma"
            )
        first = {k: (k, "first") for k in ("line", "name", "t")}
        one = groups.agg(h=("h", "mean"), v=("v", "mean"), **first)
        one = one.reset_index()
        # soundings of one place that differ by more than their noise: half the difference is their sigma
        one["v"] = np.maximum(one["v"], (spread.to_numpy() / 2) ** 2)
        of = one
    xy = of[["x", "y"]].to_numpy(np.float64)
    if len(of) < 4:
        more += int(again.sum())
        raise InputError(
            f"{len(of)} soundings" + (f", {more:,} more rows at the same places (degrees?)" if more else ""),
            where=path,
            expected="at least four, on two lines or more",
            cure="Look at the columns of places and values: rows without numbers are left out",
        )
    narrow = np.linalg.svd(xy - xy.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(xy))
    if narrow < 0.05:
        raise InputError(
            f"all soundings lie within {narrow:.2f} m of one straight line",
            where=path,
            expected="soundings across the river: what lies beside a single line cannot be told",
            cure="Survey a zigzag or sections",
        )
    timed = bool(of["t"].notna().all())
    begins: list[float] = of.groupby("day")["t"].min().tolist() if timed else []
    days = tuple(utc_text_from_unix(float(t))[:10] for t in begins)
    run, runs = _runs(of, None if line_column is None else name.tolist(), days)
    return TableOfSoundings(
        places_m=xy,
        height_m=of["h"].to_numpy(np.float64),
        sigma_m=np.sqrt(of["v"].to_numpy(np.float64)),
        line=of["line"].to_numpy(np.int64),
        crs=found.crs,
        column=column,
        depth=depth,
        notes=tuple(notes),
        day=of["day"].to_numpy(np.int64) if timed else None,
        days=days,
        t_s=of["t"].to_numpy(np.float64) if timed else None,
        run=run,
        runs=runs,
    )


def _runs(
    of: pd.DataFrame, names: list[str] | None, days: tuple[str, ...]
) -> tuple[ArrayI | None, tuple[str, ...]]:
    """Numbers (n,) and names of runs: of a column, each day anew, or pieces between pauses; None: untold."""
    if not days and names is None:
        return None, ()
    if names is not None:
        keys = of[["day", "name"]].fillna(0).astype(np.int64)
        number, first = pd.factorize(pd.MultiIndex.from_frame(keys), sort=True)
        texts = [f"{names[k]} of {days[int(d)]}" if len(days) > 1 else names[k] for d, k in first]
        return number.astype(np.int64), tuple(texts)
    t = of["t"].to_numpy(np.float64)
    number = runs_by_pauses(t)
    begins = pd.Series(t).groupby(number).min()
    return number, tuple(f"the run of {utc_text_from_unix(float(b))[:16].replace('T', ' ')}" for b in begins)


def _column_of_values(table: Table, column: str | None, depth: bool | None) -> tuple[int, bool]:
    """Place of the column of depths or heights, and which of both it holds."""
    if column is None:
        found = {q: k for q in ("depth", "height") if (k := table.find(q)) is not None}
        if len(found) != 1:
            raise InputError(
                f"columns {table.listed()}",
                where=table.path,
                expected="one column of depths or of heights by its name",
                cure="Name it: --depth COLUMN, or --height COLUMN",
            )
        return next(iter(found.values())), "depth" in found
    k = table.column(column)
    words = table.columns[k].words.split("_")
    says = "depth" if "depth" in words else "height" if {"height", "elevation", "altitude"} & {*words} else ""
    if depth is None:
        depth = says == "depth"
    elif says and depth != (says == "depth"):
        raise InputError(
            f"column {table.columns[k].name} holds {says}s by its name",
            where=table.path,
            expected="depths" if depth else "heights",
            cure=f"Use --{says} {table.columns[k].name}, or name the column otherwise",
        )
    return k, depth


def read_other_soundings(
    paths: Sequence[Path], frame: LocalFrame, crs: CRS, settings: Bathymetry
) -> pd.DataFrame:
    """Soundings of others for the bed of a survey.

    Parameters
    ----------
    paths : tables, see `read_soundings`.
    frame, crs : of the world and of the map.
    settings : column, depth or height, sigmas of tables.

    Returns
    -------
    table : columns east_m, north_m, up_m in wcs (NaN of depths), depth_m below the water (NaN of heights),
        sigma_white_m, sigma_common_m, line.

    Raises
    ------
    InputError : see `read_soundings`; heights that lie far from the survey's.
    """
    of, parts, first = settings.table, [], 0
    for path in paths:
        found = read_soundings(
            path,
            crs,
            column=of.column,
            depth=of.depth,
            level_m=None,
            line_column=of.line_column,
            sigma_m=of.sigma_m,
        )
        height = np.full(len(found.height_m), frame.h_ell_m) if of.depth else found.height_m
        if not of.depth and abs(float(np.median(height)) - frame.h_ell_m) > _OTHER_DATUM_M:
            raise InputError(
                f"heights about {np.median(height):.1f} m, the survey's are about {frame.h_ell_m:.1f} m",
                where=path,
                expected="ellipsoidal heights",
                cure="Add the geoid's height, or state bathymetry.table.depth if they are depths",
            )
        places = frame.from_map(np.column_stack([found.places_m, height]), crs)
        parts.append(
            pd.DataFrame(
                {
                    "east_m": places[:, 0],
                    "north_m": places[:, 1],
                    "up_m": np.nan if of.depth else places[:, 2],
                    # of a table without a level, heights count from the water
                    "depth_m": -found.height_m if of.depth else np.nan,
                    "sigma_white_m": found.sigma_m,
                    "sigma_common_m": of.sigma_common_m,
                    "line": found.line + first,
                }
            )
        )
        first = int(parts[-1]["line"].max()) + 1
    return pd.concat(parts, ignore_index=True)


def usual_cell_m(places_m: ArrayF) -> float:
    """Cells as wide as soundings lie apart, in steps of 1, 2 and 5, and at most half a million of them."""
    near = np.asarray(cKDTree(places_m).query(places_m, k=2)[0])[:, 1]
    least = float(np.sqrt(np.prod(np.ptp(places_m, axis=0)) / 5e5))
    wanted = max(float(np.median(near)), least, 0.1)
    return float(min(s for s in (a * 10.0**k for k in range(-1, 5) for a in (1, 2, 5)) if s >= 0.99 * wanted))


def _lines_by_place(xy: ArrayF) -> ArrayI:
    """Lines of soundings (n,): pieces of the course in the order of the file; if it is shuffled, clusters."""
    if len(xy) < 4:
        return np.zeros(len(xy), dtype=np.int64)
    step = np.diff(xy, axis=0)
    way = np.asarray(np.linalg.norm(step, axis=1))
    usual = max(float(np.median(way)), 1e-3)
    spacing = max(float(np.median(np.asarray(cKDTree(xy).query(xy, k=2)[0])[:, 1])), 1e-3)
    gap = way > _BREAK * usual
    if usual < 4 * spacing and gap.mean() < _SHUFFLED:
        out, current, reference = np.zeros(len(xy), dtype=np.int64), 0, float("nan")
        heading = np.angle(step[:, 0] + 1j * step[:, 1]).tolist()
        for k in range(len(way)):
            off = (heading[k] - reference + np.pi) % (2 * np.pi) - np.pi if np.isfinite(reference) else 0.0
            if gap[k]:
                current, reference = current + 1, float("nan")
            elif way[k] > 0.3 * usual:
                if abs(np.rad2deg(off)) > _TURN_DEG:
                    current, reference = current + 1, heading[k]
                else:
                    reference = heading[k] if np.isnan(reference) else reference + 0.2 * off
            out[k + 1] = current
        few = np.bincount(out) < 3  # scraps of turns go to the line before them
        for k in np.flatnonzero(few).tolist():
            out[out == k] = max(k - 1, 0)
        found = np.unique(out, return_inverse=True)[1].astype(np.int64)
        if found.max() + 1 < len(xy) / 3:
            return found
    pairs = cKDTree(xy).query_pairs(_BREAK * spacing, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(xy), len(xy)))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


# ---------------------------------------------------------------- the river


def centre_of_lines(xy: ArrayF, height_m: ArrayF, line: ArrayI) -> FlowLine:
    """A line down the river through the middles of lines across it, or along the longest line.

    Parameters
    ----------
    xy : (n, 2).
    height_m : (n,) the river falls where that can be told.
    line : (n,).
    """
    middles, lengths = [], []
    for number in np.unique(line):
        p = xy[line == number]
        axis = np.linalg.svd(p - p.mean(axis=0), full_matrices=False)[2][0] if len(p) > 1 else np.zeros(2)
        along = (p - p.mean(axis=0)) @ axis
        middles.append(p.mean(axis=0) + (along.max() + along.min()) / 2 * axis)
        lengths.append(float(np.ptp(along)))
    m = np.array(middles)
    chain = _chain(m)
    if len(chain) >= 4 and np.linalg.norm(np.diff(m[chain], axis=0), axis=1).sum() > 2 * np.median(lengths):
        places = m[chain]
    else:
        mean = xy.mean(axis=0)
        axis = np.linalg.svd(xy - mean, full_matrices=False)[2][0]
        along, across = (xy - mean) @ axis, (xy - mean) @ np.array([-axis[1], axis[0]])
        edges = np.linspace(along.min(), along.max(), 9)
        of = np.clip(np.searchsorted(edges, along) - 1, 0, 7)
        n = [
            (across[of == k].max() + across[of == k].min()) / 2 if (of == k).any() else 0.0 for k in range(8)
        ]
        at = (edges[1:] + edges[:-1]) / 2
        places = mean + at[:, None] * axis + np.array(n)[:, None] * np.array([-axis[1], axis[0]])
    if _rises(places, xy, height_m):
        places = places[::-1]
    width = max(float(np.median(lengths)), 1.0)
    return FlowLine.through(beyond(places, 2 * width))


def _chain(places: ArrayF) -> ArrayI:
    """Longest way through the minimum spanning tree of places."""
    if len(places) < 2:
        return np.arange(len(places))
    tree = minimum_spanning_tree(cdist(places, places))
    far, before = shortest_path(tree, directed=False, return_predecessors=True)
    start, end = np.unravel_index(int(np.argmax(far)), far.shape)
    out = [int(end)]
    while out[-1] != start:
        out.append(int(before[start, out[-1]]))
    return np.array(out[::-1], dtype=np.int64)


def read_bank_lines(
    path: Path,
    crs: CRS,
    line: FlowLine | None,
    level_m: float | None,
    height_m: tuple[ArrayF, ArrayF],
    notes: list[str] | None = None,
) -> tuple[Banks, pd.DataFrame]:
    """Bank lines of a file of vectors, with or without a property ``side``, or the water as a polygon.

    Parameters
    ----------
    path, crs : file and map.
    line : centre line; None: half way between the banks.
    level_m : height of the water; None: heights of the file, if it has any.
    height_m : places (n, 2) and heights (n,) of the soundings, which tell the direction of a line.
    notes : takes what was left out or assumed.

    Returns
    -------
    banks : both shorelines.
    data : columns s_m, n_m, east_m, north_m, up_m, sigma_m of shorelines whose height is known.

    Raises
    ------
    InputError : no lines, or no bank on one side.
    GeometryError : left and right are exchanged.
    """
    drawn = read_vectors(path).on_map(crs)
    parts = [(xyz, side_of(properties)) for xyz, properties in drawn.lines()]
    if not parts:
        raise InputError(
            "no line and no polygon", where=path, expected="bank lines, or the water as a polygon"
        )
    _keep(drawn.notes, notes)
    if line is None:
        line = _between(parts, path, height_m)
    tables = []
    for xyz, side in parts:
        dense = _dense(xyz)
        s, n, fold = line.to_flow(dense[:, :2])
        # the ends of a polygon run across the river and are no bank
        across = np.abs(np.gradient(n)) > 2 * np.abs(np.gradient(s))
        of = pd.DataFrame(
            {
                "side": side if side in SIDES else np.where(n > 0, "left", "right"),
                "s_m": s,
                "n_m": n,
                "east_m": dense[:, 0],
                "north_m": dense[:, 1],
                "up_m": dense[:, 2] if dense.shape[1] > 2 else np.nan,
                "sigma_across_m": _SIGMA_BANK_M,
                "seen": True,
            }
        )
        tables.append(of[~fold & ~across])
    table = on_their_sides(pd.concat(tables, ignore_index=True), path)
    for side in SIDES:
        if (table["side"] == side).sum() < 2:
            raise InputError(
                f"no {side} bank beside the centre line", where=path, expected="a left and a right bank"
            )
    # heights of zero everywhere are how 2D lines are written in 3D
    data = table[np.isfinite(table["up_m"])] if table["up_m"].fillna(0).abs().max() > 0 else table[:0]
    if level_m is not None:
        above = level_m - float(data["up_m"].median()) if len(data) else 0.0
        if above > _DROWNED_M:
            raise InputError(
                f"the level of {level_m:g} m lies {above:.1f} m above the bank lines",
                where=path,
                expected="bank lines at the edge of that water",
                cure="Look at this level, or leave it out: then the heights of the banks count",
            )
        data = table.assign(up_m=level_m)
    banks = Banks(table=_at_stations(table), line=line)
    return banks, data.assign(sigma_m=_STEEP * data["sigma_across_m"])


def _at_stations(table: pd.DataFrame) -> pd.DataFrame:
    """Banks at even places along the line."""
    parts = []
    for side, of in table.groupby("side"):
        s, first = np.unique(of["s_m"].to_numpy(np.float64), return_index=True)
        at = np.linspace(s[0], s[-1], _STATIONS)
        values = {
            k: np.interp(at, s, of[k].to_numpy(np.float64)[first]) for k in ("n_m", "east_m", "north_m")
        }
        parts.append(pd.DataFrame({"side": side, "s_m": at} | values))
    return pd.concat(parts, ignore_index=True)


def _dense(xyz: ArrayF) -> ArrayF:
    """Corners of a line, with or without heights, and so many between them that no step is long."""
    line = shapely.LineString(xyz)
    return np.asarray(
        shapely.get_coordinates(shapely.segmentize(line, line.length / _STATIONS), include_z=line.has_z)
    )


def _between(parts: list[tuple[ArrayF, str | None]], path: Path, height_m: tuple[ArrayF, ArrayF]) -> FlowLine:
    """The line half way between two banks."""
    if len(parts) == 1 and np.array_equal(parts[0][0][0, :2], parts[0][0][-1, :2]):
        # an outline: it turns back at its ends
        ring = _dense(parts[0][0])[:, :2]
        ends = divmod(int(np.argmax(cdist(ring, ring))), len(ring))
        first, last = sorted(ends)
        halves = (ring[first : last + 1], np.concatenate([ring[last:], ring[: first + 1]]))
        return _between([(half, None) for half in halves], path, height_m)
    sides = [side for _, side in parts]
    outlines = any(np.array_equal(xyz[0, :2], xyz[-1, :2]) for xyz, _ in parts)
    if (len(parts) != 2 or outlines) and set(sides) != set(SIDES):
        raise InputError(
            f"{len(parts)} lines with sides {sorted({str(s) for s in sides})}",
            where=path,
            expected="two bank lines, several with a property side: left or right, or one polygon",
            cure="Or give --centre-line",
        )
    if len(parts) == 2:
        a, b = (xyz[:, :2] for xyz, _ in parts)
    else:
        a, b = (np.concatenate([x[:, :2] for x, s in parts if s == side]) for side in SIDES)
    if np.linalg.norm(a[0] - b[0]) + np.linalg.norm(a[-1] - b[-1]) > np.linalg.norm(
        a[0] - b[-1]
    ) + np.linalg.norm(a[-1] - b[0]):
        b = b[::-1]
    a, b = _dense(a), _dense(b)
    # pairs of nearest places follow the bends better than equal shares of the length
    near_b, near_a = b[cKDTree(b).query(a)[1]], a[cKDTree(a).query(b)[1]]
    width = float(np.median(np.linalg.norm(a - near_b, axis=1)))
    middle = ((a + near_b) / 2 + resampled((b + near_a) / 2, len(a))) / 2
    length = np.linalg.norm(np.diff(middle, axis=0), axis=1).sum()
    k = int(np.clip(length / max(width, 1e-6), 8, 200))
    even = resampled(middle, 8 * k)
    smooth = gaussian_filter1d(even, 4, axis=0, mode="nearest")
    smooth[[0, -1]] = even[[0, -1]]
    places = smooth[:: 8 if k > 8 else 4]
    if "left" in sides:
        left = parts[sides.index("left")][0]
        turn = bool(np.median(FlowLine.through(places).to_flow(left[:, :2])[1]) < 0)
    else:
        turn = _rises(places, *height_m)
    return FlowLine.through(beyond(places[::-1] if turn else places, width))


def _rises(places: ArrayF, xy: ArrayF, height_m: ArrayF) -> bool:
    """Whether heights rise from the first place to the last one."""
    if not len(height_m):
        return False
    at = cKDTree(places).query(xy)[1]
    return bool(np.sum((at - at.mean()) * (height_m - height_m.mean())) > 0)


def hull_of_lines(s: ArrayF, n: ArrayF, line: ArrayI) -> HalfWidths:
    """Half widths of what was sounded: farthest to each side within a neighbourhood of two lines."""
    middles = np.sort([float(np.median(s[line == k])) for k in np.unique(line)])
    gaps = np.diff(middles)
    reach = max(float(np.max(gaps)) if len(gaps) else 0.0, float(np.ptp(s)) / 50, 1.0)
    at = np.linspace(s.min(), s.max(), 100)
    near = np.abs(s[None] - at[:, None]) <= reach
    left = np.array([max(float(n[k].max(initial=0.0)), 0.5) for k in near])
    right = np.array([max(float((-n[k]).max(initial=0.0)), 0.5) for k in near])

    def half_widths(where: ArrayLike) -> tuple[ArrayF, ArrayF]:
        """Left and right half widths at places along the river; NaN beyond the soundings."""
        x = np.asarray(where, dtype=np.float64)
        # beyond the first and the last sounding nothing is known
        sides = (np.interp(x, at, width, left=np.nan, right=np.nan) for width in (left, right))
        return np.asarray(next(sides)), np.asarray(next(sides))

    return half_widths


# ---------------------------------------------------------------- the bed


@dataclass(frozen=True, slots=True, kw_only=True)
class Water:
    """Coordinates of a water, and where it has a bed.

    Parameters
    ----------
    line : along and across a river, or along two directions of the map.
    half_widths_m : of a river; NaN elsewhere.
    basin : of a lake; None: a river.
    width_m : of the water.
    shore : places of the shores whose height is known, kind ``bed_observations``.
    area : polygon of the water, islands left out: its outline, or what a lake's soundings surround; None: the
        half widths say it.
    edge : what its rings are.
    banks : of a river, where they are given.
    reason : why these coordinates.
    notes : what was left out or assumed.
    """

    line: FlowLine | Plane
    half_widths_m: HalfWidths
    basin: Basin | None
    width_m: float
    shore: pd.DataFrame
    area: Any
    edge: str
    reason: str
    notes: tuple[str, ...]
    banks: Banks | None = None


def water_of(
    soundings: TableOfSoundings,
    crs: CRS,
    settings: Bathymetry,
    *,
    line: FlowLine | None = None,
    banks: Path | None = None,
    level_m: float | None = None,
    depths: bool = False,
    coordinates: str = "auto",
) -> Water:
    """The coordinates that suit a water: along its flow, or east and north where nothing shows a river.

    A river is a centre line that is given, two bank lines, an outline that is at least three times as long as
    it is wide and whose water lies between the banks that it is cut into (nine tenths of it), or soundings
    three times as far along the line through their middles as across, nearly all of them beside it and not
    all on one course.

    Parameters
    ----------
    soundings, crs, settings : see `bed_of_table`.
    line : centre line, downstream.
    banks : file with bank lines, or with the water as a polygon.
    level_m : height of the water at the shores.
    depths : the soundings are depths: without a level, the shores of a lake are at zero.
    coordinates : ``flow``, ``map`` or ``auto``.

    Raises
    ------
    InputError : most soundings lie outside the banks or beside the centre line's perpendiculars; places too
        far apart for one water.
    GeometryError : no centre line, although ``flow`` is stated.
    """
    extent = np.ptp(soundings.places_m, axis=0)
    if extent.max() > _WIDEST_M:
        raise InputError(
            f"soundings {extent.max() / 1000:,.0f} km apart",
            where="the table",
            expected=f"places of one water, less than {_WIDEST_M / 1000:,.0f} km",
            cure="Look at --crs and at the columns of the coordinates",
        )
    outline, outline_m = (None, None) if banks is None else _outline(banks, crs)

    def river(reason: str) -> Water:
        """Along the flow."""
        return _river(soundings, crs, settings, line, banks, level_m, reason, outline)

    def lake(reason: str) -> Water:
        """In east and north."""
        shore_m = next((h for h in (level_m, outline_m, 0.0 if depths else None) if h is not None), None)
        found = _lake(soundings, settings, outline, shore_m, reason)
        if level_m is None or outline_m is None or abs(level_m - outline_m) <= _DROWNED_M:
            return found
        side = "above" if level_m > outline_m else "below"
        told = (
            f"the level of {level_m:g} m lies {abs(level_m - outline_m):.1f} m {side} the outline of "
            "--banks: are both in one vertical system? Without --level the heights of the outline count"
        )
        return replace(found, notes=(*found.notes, told))

    if coordinates == "map":
        return lake("as stated")
    if coordinates == "flow":
        return river("as stated")
    if line is not None:
        return river("along the centre line that is given")
    if banks is not None and outline is None:
        return river("two bank lines")
    long = np.inf if outline is None else elongation(outline)
    if long < _RIVER:
        return lake(f"the outline is {long:.1f} times as long as it is wide, which is no river")
    try:
        found = river("")
    except (GeometryError, InputError) as error:
        return lake(f"no course of a river: {error.found}")
    s, n, fold = found.line.to_flow(soundings.places_m)
    if outline is not None:
        reached = _share_reached(outline, found, settings)
        if reached < _REACHED:
            return lake(
                f"between the banks of a river lie {reached:.0%} of the outline: bays would be cut off"
            )
        return replace(found, reason=f"the outline is {long:.1f} times as long as it is wide")
    if fold.mean() > 1 - _REACHED:
        return lake(f"{fold.mean():.0%} of the soundings have no place along a line through their middles")
    long = float(np.ptp(s[~fold])) / found.width_m
    if long < _RIVER:
        return lake(f"the soundings reach {long:.1f} times as far along their middles as across")
    half = float(np.ptp(np.quantile(n[~fold], [0.25, 0.75])))
    if half < _COURSE * found.width_m:
        return lake(
            f"the soundings follow one course, half of them within {half:.1f} m across it: the way of "
            "a boat, which shows no river"
        )
    return replace(found, reason=f"the soundings reach {long:.1f} times as far along their middles as across")


def _outline(path: Path, crs: CRS) -> tuple[Any, float | None]:
    """The water as a polygon, and its height if the file has one; None if the file holds open lines."""
    shapes = np.asarray(read_vectors(path).on_map(crs).table.geometry)
    lines = shapes[shapely.get_type_id(shapes) == _LINE_STRING]
    rings = np.concatenate([shapely.get_rings(shapes), lines])
    if not len(rings) or not shapely.is_closed(lines).all():
        return None, None
    height = shapely.get_coordinates(rings, include_z=True)[:, 2]
    # rings within rings are islands; heights of zero everywhere are how 2D lines are written in 3D
    area = shapely.build_area(shapely.union_all(rings))
    told = bool(np.isfinite(height).all() and height.any())
    return (None if area.is_empty else area), float(np.median(height)) if told else None


def _share_reached(outline: Any, water: Water, settings: Bathymetry) -> float:
    """How much of an outline lies between the banks of a river."""
    step = float(np.sqrt(shapely.area(outline) / _PLACES))
    west, south, east, north = shapely.bounds(outline)
    x, y = np.meshgrid(np.arange(west, east, step), np.arange(south, north, step))
    places = np.column_stack([x.ravel(), y.ravel()])
    places = places[shapely.contains_xy(outline, places)]
    bare = settings.model_copy(update={"islands": []})
    _, inside = cells_of_river(places, water.line, water.half_widths_m, (-np.inf, np.inf), bare)
    return float(inside.mean())


def _river(
    soundings: TableOfSoundings,
    crs: CRS,
    settings: Bathymetry,
    line: FlowLine | None,
    path: Path | None,
    level_m: float | None,
    reason: str,
    outline: Any = None,
) -> Water:
    """Coordinates along the flow, between banks, within an outline or as far as soundings reach."""
    xy, height = soundings.places_m, soundings.height_m
    notes: list[str] = []
    if line is None:
        notes.append("centre line half way between the banks" if path else "centre line from the soundings")
    banks = None if path is None else read_bank_lines(path, crs, line, level_m, (xy, height), notes)
    if banks is not None:
        line = banks[0].line
    elif line is None:
        line = centre_of_lines(xy, height, soundings.line)
    s, n, fold = line.to_flow(xy)
    if fold.mean() > _ALONE:
        raise InputError(
            f"{fold.mean():.0%} of the soundings lie beyond the ends of the centre line, or where it "
            "bends too sharply for them",
            where="the centre line",
            expected="a centre line along all of them",
            cure="Look at --centre-line, --banks and --crs; a lake needs --coordinates map",
        )
    if banks is None:
        half_widths = hull_of_lines(s[~fold], n[~fold], soundings.line[~fold])
    else:
        half_widths = banks[0].half_widths_m
        outside = banks[0].outside(s, n) & ~fold
        if outline is not None:
            outside = ~shapely.contains_xy(shapely.buffer(outline, _SIGMA_BANK_M), xy)
        _refuse_outside(outside)
        if outside.any():
            notes.append(f"{int(outside.sum()):,} soundings outside the banks, used")
    width = float(np.nanmedian(np.sum(half_widths(s), axis=0)))
    shore = _observations("bank", np.empty((0, 2)), np.empty((0, 2)), np.empty(0), np.empty(0), [])
    if banks is not None and len(banks[1]) and settings.bank_as_data:
        of = banks[1].sort_values(["side", "s_m"], kind="stable")
        spacing = max(width / 20, settings.cell_m)
        of = of[~of.assign(k=(of["s_m"] // spacing)).duplicated(["side", "k"])]
        stretch = (of["s_m"] // (20 * spacing)).to_numpy(np.int64)
        number = -2 - 2 * (stretch - stretch.min()) - (of["side"] == "left").to_numpy(np.int64)
        flow, places = (
            of[[*names]].to_numpy(np.float64) for names in (("s_m", "n_m"), ("east_m", "north_m"))
        )
        shore = _observations("bank", flow, places, of["up_m"].array, of["sigma_m"].array, number)
    return Water(
        line=line,
        half_widths_m=half_widths,
        basin=None,
        width_m=width,
        shore=shore,
        area=outline if outline is None else _without_islands(outline, settings),
        edge="banks" if outline is None else "shore",
        reason=reason,
        notes=tuple(notes),
        banks=None if banks is None else banks[0],
    )


def _refuse_outside(outside: ArrayB) -> None:
    if outside.mean() > _ALONE:
        raise InputError(
            f"{outside.mean():.0%} of the soundings lie outside the banks",
            where="--banks",
            expected="soundings between the banks",
            cure="Look at --crs and at the columns of the coordinates",
        )


def _without_islands(area: Any, settings: Bathymetry) -> Any:
    return shapely.difference(area, shapely.union_all([shapely.polygons(of) for of in settings.islands]))


def _lake(
    soundings: TableOfSoundings, settings: Bathymetry, outline: Any, shore_m: float | None, reason: str
) -> Water:
    """East and north, turned; within the outline, or within a hull of the soundings."""
    xy = soundings.places_m
    plane = Plane.of(xy, soundings.height_m)
    area = _without_islands(area_sounded(xy, settings.cell_m) if outline is None else outline, settings)
    notes = []
    outside = ~shapely.contains_xy(shapely.buffer(area, _SIGMA_BANK_M), xy)
    _refuse_outside(outside)
    if outside.any():
        notes.append(f"{int(outside.sum()):,} soundings outside the shores, used")
    places, number = shore_places(area, settings.cell_m)
    # shores of another part of the water say nothing of what was sounded
    near = cKDTree(xy).query(places)[0] < np.hypot(*np.ptp(xy, axis=0)) / 2
    if outline is None or shore_m is None or not settings.bank_as_data:
        near[:] = False
        if outline is not None:
            notes.append("the shore has no height and is no datum: state --level")
    places, number = places[near], number[near]
    up, sigma = np.full(len(places), shore_m, dtype=np.float64), np.full(len(places), _STEEP * _SIGMA_BANK_M)
    radius = float(shapely.maximum_inscribed_circle(area).length)
    # the edge of what was sounded is no shore
    turned = "" if outline is None else shapely.to_wkt(shapely.transform(area, plane.turned), 3)
    return Water(
        line=plane,
        half_widths_m=no_half_widths,
        basin=Basin(wkt=turned, radius_m=radius),
        width_m=2 * radius,
        shore=_observations("bank", plane.turned(places), places, up, sigma, -2 - number),
        area=area,
        edge="edge of the soundings" if outline is None else "shore",
        reason=reason,
        notes=tuple(notes),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class BedOfTable:
    """A bed from soundings of others.

    Parameters
    ----------
    bed : grid with sigmas; heights in the table's system.
    water : its coordinates and shores.
    validation : facts of `validate_bed`.
    predicted, methods : its tables.
    notes : what was left out or assumed.
    """

    bed: Bed
    water: Water
    validation: dict[str, Any]
    predicted: pd.DataFrame
    methods: pd.DataFrame
    notes: tuple[str, ...]

    def write(self, folder: Path, tags: dict[str, str]) -> None:
        """``bed.tif``, ``validation.json``, ``variogram.json`` and tables; of a river ``centre_line.csv``."""
        folder.mkdir(parents=True, exist_ok=True)
        of = self.bed
        values = (of.up_m, of.sigma_m, of.sigma_common_m, of.distance_m)
        write_raster(folder / "bed.tif", of.grid, dict(zip(BANDS, values, strict=True)), tags=tags)
        facts = self.validation | {"notes": list(self.notes), "bed": of.facts}
        (folder / "validation.json").write_text(json.dumps(facts, indent=2) + "\n")
        (folder / "variogram.json").write_text(json.dumps(of.model.report(), indent=2) + "\n")
        (folder / "centre_line.csv").unlink(missing_ok=True)
        if isinstance(self.water.line, FlowLine):
            self.water.line.write(folder / "centre_line.csv")
        self.predicted.to_csv(folder / "predicted.csv", index=False, float_format="%.4f")
        self.methods.to_csv(folder / "methods.csv", index=False, float_format="%.4f")


def bed_of_table(
    soundings: TableOfSoundings, crs: CRS, settings: Bathymetry, water: Water, *, seed: int = 1
) -> BedOfTable:
    """The bed that soundings of a table show.

    Days and runs whose lines contradict each other where they cross are brought to their mean, which is as
    uncertain as they scatter; what is left of each step, and a step of each line, are errors of soundings.

    Parameters
    ----------
    soundings : see there.
    crs : of the map.
    settings : cell, model, drift, neighbours, reach.
    water : of `water_of`.
    seed : of the choice of left-out lines.

    Raises
    ------
    InputError : soundings above the shores.
    GeometryError : a single line of soundings along a river.
    CoverageError : no cell near enough to data, or heights that the data cannot tell.
    """
    lake = water.basin
    notes = [
        *soundings.notes,
        f"{'flow' if lake is None else 'map'} coordinates: {water.reason}",
        *water.notes,
    ]
    soundings, left, steps, of_steps = _agreed(soundings)
    number, patches = soundings.line, False
    if lake is not None:
        number, patches = lines_or_patches(soundings.places_m, soundings.line, seed)
    if patches:
        notes.append("no four long lines: patches of soundings are left out and predicted instead")
    s, n, fold = water.line.to_flow(soundings.places_m)
    if fold.any():
        notes.append(f"{int(fold.sum()):,} soundings without flow coordinates left out")
    flow = np.column_stack([s, n])
    table = _observations(
        "sounding", flow, soundings.places_m, soundings.height_m, soundings.sigma_m, number
    ).assign(**left)[~fold]
    counts = {"soundings": len(table), "folded": int(fold.sum())}
    if len(water.shore):
        table = pd.concat([table, water.shore], ignore_index=True)
        counts["bank places"] = len(water.shore)
    table = frame_of(OBSERVATIONS, {name: table[name] for name in OBSERVATIONS.names})
    _refuse_other_heights(table, water.width_m)
    if lake is None:
        notes += asked_of_river(table, water.half_widths_m, depths=soundings.depth)
    elif lake.wkt:
        places, height = soundings.places_m, soundings.height_m
        notes += asked_of_lake(water.area, places, height, depths=soundings.depth)
    notes += asked_of_shores(table, soundings.level_m)
    data = observations_of(table)
    half_widths = water.half_widths_m
    model = choose_model(
        data, half_widths, settings, slow_time_s=1.0 * bool(left["sigma_slow_m"].any()), seed=seed, basin=lake
    )
    reach = settings.reach * model.covariance.range_s_m
    around = table[["east_m", "north_m"]].to_numpy(np.float64)
    if lake is not None:
        farthest = max(reach, settings.reach * model.covariance.range_n_m)
        corners = np.reshape(shapely.bounds(water.area), (2, 2))
        around = np.clip(corners, around.min(axis=0) - farthest, around.max(axis=0) + farthest)
    grid = Grid.around(around, settings.cell_m, crs, margin_m=2 * settings.cell_m)
    span = (float(data.s_m.min()) - reach, float(data.s_m.max()) + reach)
    # an outline is the map, bays included, which lie beyond half widths
    edges = half_widths if water.area is None else no_half_widths
    flow, inside = cells_of_river(grid.centres_m(), water.line, edges, span, settings)
    if water.area is not None:
        places = soundings.places_m[~fold]
        row, column = grid.at(places[shapely.contains_xy(water.area, places)])
        of_soundings = np.zeros(len(inside), dtype=np.bool_)
        of_soundings[row * grid.columns + column] = True
        of_water = shapely.contains_xy(water.area, grid.centres_m())
        if water.basin is None and (lost := int((of_water & ~inside).sum())):
            notes.append(
                f"{lost:,} cells of the outline are no bed: beyond the ends of the centre line, or it bends "
                "too sharply for them; --coordinates map has them"
            )
        inside = (inside & of_water) | of_soundings
    if lake is not None and not lake.wkt:
        far = cKDTree(soundings.places_m).query(grid.centres_m())[0]
        inside &= far <= farthest_told_m(soundings.places_m, number)
    bed = gridded(table, model, grid, flow, inside, settings, counts)
    facts, predicted, methods = validate_bed(table, model, half_widths, settings)
    facts["coordinates"] = {"kind": "flow" if lake is None else "map", "reason": water.reason}
    facts["left_out"] = "patches" if patches else "lines"
    if isinstance(water.line, Plane):
        facts["coordinates"]["azimuth_deg"] = water.line.azimuth_deg
    return BedOfTable(
        bed=bed,
        water=water,
        validation=facts | {"agreement": steps},
        predicted=predicted,
        methods=methods,
        notes=(*notes, *of_steps),
    )


def _agreed(soundings: TableOfSoundings) -> tuple[TableOfSoundings, pd.DataFrame, dict[str, Any], list[str]]:
    """Soundings without the steps of days and runs, what is left of them, facts and notes.

    What is left: columns sigma_common_m, sigma_slow_m and t_even_s of kind ``bed_observations``. A line keeps
    a step of its own, which kriging adjusts: which of two lines is wrong nobody knows.
    """
    day, run, line = soundings.day, soundings.run, soundings.line
    if run is None:
        run = np.zeros(len(line), dtype=np.int64) if day is None else day
    names = {
        "day": soundings.days,
        "run": soundings.runs or soundings.days or ("",),
        "line": tuple(f"line {k}" for k in range(int(line.max()) + 1)),
    }
    found = agreement(soundings.places_m, soundings.height_m, soundings.sigma_m, line, run, day)
    facts, notes = found.told(names)
    # an error of a run and one of each of its lines: neighbouring lines share what is the run's
    pieces = pd.MultiIndex.from_arrays([run, line])
    number, first = pd.factorize(pieces, sort=True)
    of_run = found.sigma_m[first.get_level_values(0)]
    whole = np.hypot(of_run, found.sigma_line_m)
    with np.errstate(divide="ignore", invalid="ignore"):
        apart_s = np.minimum(-2 * np.log(of_run / whole), _APART)
    apart_s[np.diff(first.get_level_values(0), prepend=-1) != 0] = _APART
    left = pd.DataFrame(
        {
            "sigma_common_m": found.sigma_common_m[run],
            "sigma_slow_m": whole[number],
            "t_even_s": np.cumsum(np.nan_to_num(apart_s, nan=_APART))[number],
        }
    )
    return replace(soundings, height_m=soundings.height_m - found.shift_m[run]), left, facts, notes


def _refuse_other_heights(table: pd.DataFrame, width_m: float) -> None:
    """Soundings above the shores, or deeper below them than the water is wide: heights of another kind."""
    up = table.groupby("source")["up_m"].median()
    if "bank" not in up:
        return
    below = float(up["bank"] - up["sounding"])
    if below < 0 or below > width_m:
        raise InputError(
            f"the soundings lie {abs(below):.1f} m {'below' if below > 0 else 'above'} the banks in the "
            f"median, the water is {width_m:.0f} m wide",
            where="--banks",
            expected="heights of soundings and banks in one system, the bed somewhat below the banks",
            cure="Name heights as --height and depths as --depth; look at --level and the heights of --banks",
        )


def against_reference(
    bed: Path, references: Sequence[Path], crs: CRS, settings: Bathymetry
) -> dict[str, Any]:
    """A bed beside surfaces and points that had no part in it.

    Each cell is compared with the mean of what a reference has in it; the standard deviation is that of the
    cell, its common part included, with the common error of the reference and its noise.

    Parameters
    ----------
    bed : ``bed.tif``.
    references : GeoTIFF, LAS, LAZ, or tables of ellipsoidal heights, in ``crs``; a surveyed bed as the
        calibration of an echo sounder reads it (column h_ell_m) too.
    crs : of the map.
    settings : column of tables, sigmas of a reference.

    Returns
    -------
    facts : by name of the file, `measures` of bed less reference, and the same by distance to data.

    Raises
    ------
    InputError : a reference that cannot be read, or that has nothing within the bed.
    """
    grid, bands, _ = read_raster(bed)
    up, distance = bands["height_m"].ravel(), bands["distance_m"].ravel()
    own = np.hypot(bands["sigma_m"].ravel(), bands["sigma_common_m"].ravel())
    facts = {}
    for path in references:
        places, height, sigma = _reference_points(path, crs, settings)
        row, column = grid.at(places)
        cell = (row * grid.columns + column)[row >= 0]
        n = np.bincount(cell, minlength=len(up))
        mean = np.bincount(cell, weights=height[row >= 0], minlength=len(up)) / np.maximum(n, 1)
        both = (n > 0) & np.isfinite(up)
        if not both.any():
            raise InputError(
                f"none of {len(height):,} heights lies on a cell of the bed",
                where=path,
                expected=f"heights along the survey in {crs.name}",
                cure="Transform the reference to campaign.crs, or look whether it is of this reach",
            )
        noise = np.bincount(cell, sigma[row >= 0] ** 2, len(up)) / np.maximum(n, 1) ** 2
        noise += settings.table.sigma_common_m**2
        pairs = pd.DataFrame(
            {
                "up_m": mean[both],
                "predicted_m": up[both],
                "sigma_m": np.sqrt(own**2 + noise)[both],
                "distance_m": distance[both],
            }
        )
        facts[path.name] = measures(pairs) | {"classes": by_class(pairs)}
    return facts


def _reference_points(path: Path, crs: CRS, settings: Bathymetry) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Places (n, 2) on the map, heights (n,) of a reference, and their noise."""
    stated = settings.table.sigma_m
    kind = path.suffix.lower()
    if kind in {".tif", ".tiff", ".las", ".laz"}:
        raster = read_dsm(path) if kind.startswith(".t") else None
        of = laz_header(path).frame if raster is None else raster.frame
        if of is not None and (
            isinstance(of, LocalFrame) or not of.to_2d().equals(crs, ignore_axis_order=True)
        ):
            raise InputError(
                f"a {'cloud' if raster is None else 'raster'} in "
                f"{'a local frame' if isinstance(of, LocalFrame) else of.name}",
                where=path,
                expected=crs.name,
                cure="Transform it to campaign.crs, with ellipsoidal heights",
            )
        if raster is not None:
            xyz = raster.points_m()
        else:
            xyz = np.concatenate([np.empty((0, 3)), *(chunk["xyz_m"] for chunk in iter_laz(path))])
        return xyz[:, :2], xyz[:, 2], np.full(len(xyz), stated)
    table, found = read_places(path, crs)
    places = found.xy_m
    k = table.find("height")
    value = table.numbers(table.column(settings.table.column) if k is None else k, "height")
    own = table.find("sigma")
    sigma = np.full(len(table), stated) if own is None else table.numbers(own, "sigma")
    sigma = np.where(np.isfinite(sigma), sigma, stated)
    known = np.isfinite(value) & np.isfinite(places).all(axis=1)
    return places[known], value[known], sigma[known]


def _observations(
    source: str, flow: ArrayF, places: ArrayF, height: Any, sigma: Any, line: ArrayI | Sequence[int]
) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "source": source,
            "s_m": flow[:, 0],
            "n_m": flow[:, 1],
            "east_m": places[:, 0],
            "north_m": places[:, 1],
            "up_m": height,
            "sigma_white_m": sigma,
            "sigma_slow_m": 0.0,
            "sigma_common_m": 0.0,
            "t_even_s": np.nan,
            "line": line,
        }
    )
