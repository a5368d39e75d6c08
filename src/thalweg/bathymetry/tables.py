"""Beds from soundings of others: tables, bank lines and centre lines on a map, without a boat's trajectory.

Heights stay in the table's own vertical system. Without a centre line, one is laid through the middles of the
lines of soundings (sections, zigzag), or along the longest of them where they run down the river.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree, shortest_path
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from thalweg.bathymetry.banks import SIDES, Banks
from thalweg.bathymetry.bed import BANDS, OBSERVATIONS, Bed, cells_of_river, gridded, observations_of
from thalweg.bathymetry.flow import FlowLine
from thalweg.bathymetry.validation import by_class, measures, validate_bed
from thalweg.bathymetry.variogram import HalfWidths, choose_model
from thalweg.core import (
    ArrayF,
    ArrayI,
    Grid,
    InputError,
    LocalFrame,
    frame_of,
    iter_laz,
    laz_header,
    read_dsm,
    read_raster,
    write_raster,
)
from thalweg.core.values import check_places, utm_of
from thalweg.ingest import Places, Table, read_text_table
from thalweg.settings.sections import Bathymetry

_DROWNED_M: Final = 0.5
"""Bank lines stand at the water's edge: heights this far below the level are those of another water."""
_BREAK: Final = 8.0
"""A step this many times the usual one ends a line of soundings."""
_TURN_DEG: Final = 45.0
_SHUFFLED: Final = 0.2
"""A file with more breaks than this share of its rows does not follow the boat: its lines are clusters."""
_SIGMA_BANK_M: Final = 0.5
_STEEP: Final = 0.3
"""Rise of the bed near the shore, for what a shoreline's error across is in height."""
_STATIONS: Final = 400
_OTHER_DATUM_M: Final = 25.0
"""Ellipsoid and geoid differ by more nearly everywhere in Europe; no river falls so much in a survey."""
_ALONE: Final = 0.5
"""More soundings than this share outside the banks: they are of another place."""


def map_crs(text: str) -> CRS:
    """A coordinate system in metres on a map.

    Raises
    ------
    InputError : unknown, in degrees or in feet.
    """
    try:
        crs = CRS.from_user_input(text)
    except CRSError as error:
        raise InputError(
            f"--crs {text}: {error}", expected="a projected system such as EPSG:32633"
        ) from error
    if not crs.is_projected:
        raise InputError(
            f"{text} ({crs.name}) is in {crs.axis_info[0].unit_name}s",
            where="--crs",
            expected="a projected system in metres",
            cure="Transform the table to the UTM zone of the river, such as EPSG:32633",
        )
    if any(abs(axis.unit_conversion_factor - 1) > 1e-9 for axis in crs.axis_info[:2]):
        raise InputError(
            f"{text} ({crs.name}) is in {crs.axis_info[0].unit_name}",
            where="--crs",
            expected="a projected system in metres",
            cure="Transform places and heights to metres",
        )
    return crs


def read_places(
    path: Path, crs: CRS | None, *, order: Sequence[str] | None = None, any_system: bool = False
) -> tuple[Table, Places]:
    """A table of places: text with names of columns, x y z without, or points of a GIS.

    Parameters
    ----------
    path : see `thalweg.ingest.read_text_table`.
    crs, any_system : of the map, see `thalweg.ingest.Table.places`.
    order : names of the columns, stated by a user.

    Raises
    ------
    InputError : no such file, no table, no coordinates.
    """
    if path.suffix.lower() not in {".geojson", ".json"}:
        table = read_text_table(path, order=order, bare=("x", "y", "z"))
        return table, table.places(crs, any_system=any_system)
    features, source = _features(path)
    points = [f for f in features if (f.get("geometry") or {}).get("type") == "Point"]
    if not points:
        raise InputError(
            "no points",
            where=path,
            expected="GeoJSON of points",
            cure="Export soundings as points, not as lines",
        )
    frame = pd.DataFrame([f.get("properties") or {} for f in points])
    at = [f["geometry"]["coordinates"] for f in points]
    if "z" not in frame and all(len(c) > 2 for c in at):
        frame["z"] = [c[2] for c in at]
    xy = np.array([c[:2] for c in at], dtype=np.float64)
    if source is None and len(xy) and (np.abs(xy) <= [180.0, 90.0]).all():
        source = CRS.from_epsg(4326)
    on = crs or (utm_of(xy[:, 0], xy[:, 1]) if source is not None and source.is_geographic else source)
    return Table.of(frame, path), Places(_on_map(xy, source, on, path), on, [])


def read_line(path: Path, crs: CRS | None = None) -> FlowLine:
    """A centre line, downstream: table of places, or GeoJSON with one line.

    Raises
    ------
    InputError : no line.
    GeometryError : fewer than three places.
    """
    if path.suffix.lower() in {".geojson", ".json"}:
        features, source = _features(path)
        parts = [xyz for f in features for xyz, _ in _lines_of(f)]
        if len(parts) != 1:
            raise InputError(f"{len(parts)} lines", where=path, expected="one centre line")
        xy = parts[0][:, :2]
        return FlowLine.through(_on_map(xy, source, crs, path) if crs is not None else xy)
    places = read_places(path, crs, any_system=True)[1].xy_m
    return FlowLine.through(places[np.isfinite(places).all(axis=1)])


def read_islands(path: Path, crs: CRS) -> list[list[tuple[float, float]]]:
    """Outlines of islands of a GeoJSON file, on the map.

    Raises
    ------
    InputError : no polygon.
    """
    features, source = _features(path)
    outlines = [
        [(float(east), float(north)) for east, north in _on_map(xyz[:, :2], source, crs, path)]
        for feature in features
        if "Polygon" in str((feature.get("geometry") or {}).get("type"))
        for xyz, _ in _lines_of(feature)
    ]
    if not outlines:
        raise InputError("no polygon", where=path, expected="islands as polygons")
    return outlines


def _features(path: Path) -> tuple[list[dict[str, Any]], CRS | None]:
    """Features of a GeoJSON file and the coordinate system that it names."""
    try:
        content = json.loads(path.read_text())
        features = content["features"]
        name = ((content.get("crs") or {}).get("properties") or {}).get("name")
        return features, CRS.from_user_input(name) if name else None
    except FileNotFoundError as error:
        raise InputError(
            "no such file", where=path, expected="a GeoJSON file", cure="Check the path"
        ) from error
    except (ValueError, KeyError, TypeError, AttributeError, CRSError) as error:
        raise InputError(
            f"{error}",
            where=path,
            expected="GeoJSON, a FeatureCollection",
            cure="Export the lines from a GIS as GeoJSON",
        ) from error


def _on_map(xy: ArrayF, source: CRS | None, crs: CRS, path: Path) -> ArrayF:
    """Places on the map; GeoJSON without a named system is in degrees (RFC 7946), or on the map already."""
    if source is None and len(xy) and (np.abs(xy) <= [180.0, 90.0]).all():
        source = CRS.from_epsg(4326)
    if source is None or source.equals(crs, ignore_axis_order=True):
        return xy
    east, north = Transformer.from_crs(source, crs, always_xy=True).transform(xy[:, 0], xy[:, 1])
    out = np.column_stack([east, north])
    if not np.isfinite(out).all():
        raise InputError(
            f"places in {source.name} have none in {crs.name}", where=path, expected=f"places in {crs.name}"
        )
    return out


def _lines_of(feature: dict[str, Any]) -> list[tuple[ArrayF, str | None]]:
    """Lines (k, 2 or 3) of a feature, outlines of polygons too, and the side that it names."""
    geometry = feature.get("geometry") or {}
    at: Any = geometry.get("coordinates")
    kind = geometry.get("type")
    side = (feature.get("properties") or {}).get("side")
    if kind == "LineString":
        parts = [at]
    elif kind in {"MultiLineString", "Polygon"}:
        parts = at if kind == "MultiLineString" else at[:1]
    elif kind == "MultiPolygon":
        parts = [rings[0] for rings in at]
    else:
        return []
    return [(np.array(part, dtype=np.float64), side) for part in parts]


# ---------------------------------------------------------------- soundings


@dataclass(frozen=True, slots=True, kw_only=True)
class TableOfSoundings:
    """Soundings of a table.

    Parameters
    ----------
    places_m : (n, 2) east and north.
    height_m, sigma_m : (n,) and their noise.
    line : (n,) number of the line.
    counts : rows read, repeated, repeated and different.
    crs : of the map.
    column, depth : name of the column of values, and whether they are depths.
    notes : what was converted, assumed and left out.
    """

    places_m: ArrayF
    height_m: ArrayF
    sigma_m: ArrayF
    line: ArrayI
    counts: dict[str, int]
    crs: CRS
    column: str
    depth: bool
    notes: tuple[str, ...] = ()


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
    path, crs, order : see `read_places`.
    column : of heights, or of depths below ``level_m`` (0 where none is stated); None: as the names tell.
    depth : whether its values are depths; None: as its name tells.
    nothing, keep : values that stand for none beside the usual ones, and such of them that are meant.
    line_column : numbers or names of lines; None: from the course, or from clusters.
    sigma_m : noise of a height, where the table has no column ``sigma`` or ``sigma_m``.

    Raises
    ------
    InputError : no such column, or none that says whether it holds depths; depths that are heights or the
        other way round; places that the map does not have; fewer than four soundings; all in one place or on
        one straight line.
    """
    table, found = read_places(path, crs, order=order)
    assert found.crs is not None
    k, depth = _column_of_values(table, column, depth)
    column, places = table.columns[k].name, found.xy_m
    value = table.numbers(k, "depth" if depth else "height", nothing=nothing, keep=keep)
    at_sigma = table.find("sigma")
    sigma = np.full(len(table), sigma_m) if at_sigma is None else table.numbers(at_sigma, "sigma")
    known = np.isfinite(value) & np.isfinite(places).all(axis=1) & np.isfinite(sigma) & (sigma > 0)
    counts = {"rows": len(table)}
    notes = [*table.notes, *found.notes, *table.unit_notes(k), *table.loss_notes()]
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
    height = (level_m or 0.0) - value if depth else value
    if line_column is None:
        line = _lines_by_place(places[known])
    else:
        names = np.array(table.text(table.column(line_column)))[known]
        line = pd.factorize(names)[0].astype(np.int64)
    of = pd.DataFrame(
        {
            "x": np.round(places[known, 0], 3),
            "y": np.round(places[known, 1], 3),
            "h": height[known],
            "v": sigma[known] ** 2,
            "line": line,
        }
    )
    groups = of.groupby(["x", "y"], sort=False)
    spread = groups["h"].agg(np.ptp)
    counts["repeated"] = len(of) - len(spread)
    counts["repeated and different"] = int((spread > 3 * np.sqrt(2 * groups["v"].max())).sum())
    if counts["repeated"]:
        one = groups.agg(h=("h", "mean"), v=("v", "mean"), line=("line", "first")).reset_index()
        # soundings of one place that differ by more than their noise: half the difference is their sigma
        one["v"] = np.maximum(one["v"], (spread.to_numpy() / 2) ** 2)
        of = one
    xy = of[["x", "y"]].to_numpy(np.float64)
    if len(of) < 4:
        again = (
            f", {counts['repeated']:,} more rows at the same places (degrees?)" if counts["repeated"] else ""
        )
        raise InputError(
            f"{len(of)} soundings{again}",
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
    return TableOfSoundings(
        places_m=xy,
        height_m=of["h"].to_numpy(np.float64),
        sigma_m=np.sqrt(of["v"].to_numpy(np.float64)),
        line=of["line"].to_numpy(np.int64),
        counts=counts,
        crs=found.crs,
        column=column,
        depth=depth,
        notes=tuple(notes),
    )


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
    return FlowLine.through(_beyond(places, 2 * width))


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


def _beyond(places: ArrayF, reach_m: float) -> ArrayF:
    """Places of a line that goes on straight beyond both ends."""
    ends = []
    for a, b in ((places[1], places[0]), (places[-2], places[-1])):
        ends.append(b + reach_m * (b - a) / max(float(np.linalg.norm(b - a)), 1e-9))
    return np.concatenate([ends[:1], places, ends[1:]])


def read_bank_lines(
    path: Path, crs: CRS, line: FlowLine | None, level_m: float | None, height_m: tuple[ArrayF, ArrayF]
) -> tuple[Banks, pd.DataFrame]:
    """Bank lines of a GeoJSON file: lines, with or without a property ``side``, or the water as a polygon.

    Parameters
    ----------
    path, crs : file and map.
    line : centre line; None: half way between the banks.
    level_m : height of the water; None: heights of the file, if it has any.
    height_m : places (n, 2) and heights (n,) of the soundings, which tell the direction of a line.

    Returns
    -------
    banks : both shorelines.
    data : columns s_m, n_m, east_m, north_m, up_m, sigma_m of shorelines whose height is known.

    Raises
    ------
    InputError : no lines, or no bank on one side.
    GeometryError : left and right are exchanged.
    """
    features, source = _features(path)
    parts = [part for f in features for part in _lines_of(f)]
    if not parts:
        raise InputError(
            "no line and no polygon", where=path, expected="bank lines, or the water as a polygon"
        )
    parts = [
        (np.column_stack([_on_map(xyz[:, :2], source, crs, path), xyz[:, 2:]]), side) for xyz, side in parts
    ]
    if line is None:
        line = _between(parts, path, height_m)
    tables = []
    for xyz, side in parts:
        dense = _densified(xyz)
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
    table = pd.concat(tables, ignore_index=True)
    wrong = float(np.mean(table["side"].map(SIDES) * table["n_m"] <= 0)) if len(table) else 0.0
    if wrong > 0.05:
        raise InputError(
            f"{wrong:.0%} of the bank's places lie on the other side of the centre line",
            where=path,
            expected="left and right of the flow, downstream",
            cure="Turn the centre line round, or exchange the sides" if wrong > 0.5 else "The banks cross",
        )
    table = table[table["side"].map(SIDES) * table["n_m"] > 0]
    for side in SIDES:
        if (table["side"] == side).sum() < 2:
            raise InputError(
                f"no {side} bank beside the centre line", where=path, expected="a left and a right bank"
            )
    table = table.sort_values(["side", "s_m"], kind="stable", ignore_index=True)
    # heights of zero everywhere are how 2D lines are written in 3D
    data = table[np.isfinite(table["up_m"])] if table["up_m"].fillna(0).abs().max() > 0 else table[:0]
    if level_m is not None:
        above = level_m - float(data["up_m"].median()) if len(data) else 0.0
        if above > _DROWNED_M:
            raise InputError(
                f"the level of {level_m:g} m lies {above:.1f} m above the bank lines",
                where=path,
                expected="bank lines at the edge of that water",
                cure="Look at --level, or leave it out: then the heights of the banks count",
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


def _densified(xyz: ArrayF) -> ArrayF:
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xyz[:, :2], axis=0), axis=1))])
    at = np.unique(np.concatenate([way, np.linspace(0, way[-1], _STATIONS)]))
    return np.column_stack([np.interp(at, way, xyz[:, k]) for k in range(xyz.shape[1])])


def _between(parts: list[tuple[ArrayF, str | None]], path: Path, height_m: tuple[ArrayF, ArrayF]) -> FlowLine:
    """The line half way between two banks."""
    if len(parts) == 1 and np.array_equal(parts[0][0][0, :2], parts[0][0][-1, :2]):
        # an outline: it turns back at its ends
        ring = _densified(parts[0][0])[:, :2]
        ends = divmod(int(np.argmax(cdist(ring, ring))), len(ring))
        first, last = sorted(ends)
        halves = (ring[first : last + 1], np.concatenate([ring[last:], ring[: first + 1]]))
        return _between([(half, None) for half in halves], path, height_m)
    sides = [side for _, side in parts]
    if len(parts) != 2 and set(sides) != set(SIDES):
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
    a, b = _densified(a), _densified(b)
    # pairs of nearest places follow the bends better than equal shares of the length
    near_b, near_a = b[cKDTree(b).query(a)[1]], a[cKDTree(a).query(b)[1]]
    width = float(np.median(np.linalg.norm(a - near_b, axis=1)))
    middle = ((a + near_b) / 2 + _even((b + near_a) / 2, len(a))) / 2
    length = np.linalg.norm(np.diff(middle, axis=0), axis=1).sum()
    k = int(np.clip(length / max(width, 1e-6), 8, 200))
    places = _smoothed_line(_even(middle, 8 * k), 4)[:: 8 if k > 8 else 4]
    left = parts[0][0] if sides[0] == "left" else parts[1][0] if sides[1] == "left" else None
    if left is not None:
        t, d = places[1] - places[0], left[:, :2] - places[0]
        k = int(np.argmin(np.linalg.norm(d, axis=1)))
        turn = t[0] * d[k, 1] - t[1] * d[k, 0] < 0
    else:
        xy, z = height_m
        turn = _rises(places, xy, z)
    return FlowLine.through(_beyond(places[::-1] if turn else places, width))


def _rises(places: ArrayF, xy: ArrayF, height_m: ArrayF) -> bool:
    """Whether heights rise from the first place to the last one."""
    if not len(height_m):
        return False
    at = cKDTree(places).query(xy)[1]
    return bool(np.sum((at - at.mean()) * (height_m - height_m.mean())) > 0)


def _even(p: ArrayF, n: int) -> ArrayF:
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    at = np.linspace(0, way[-1], n)
    return np.column_stack([np.interp(at, way, p[:, k]) for k in (0, 1)])


def _smoothed_line(p: ArrayF, sigma: int) -> ArrayF:
    from scipy.ndimage import gaussian_filter1d

    inner = gaussian_filter1d(p, sigma, axis=0, mode="nearest")
    inner[0], inner[-1] = p[0], p[-1]
    return np.asarray(inner)


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
class BedOfTable:
    """A bed from soundings of others.

    Parameters
    ----------
    bed : grid with sigmas; heights in the table's system.
    line : centre line.
    validation : facts of `validate_bed`.
    predicted, methods : its tables.
    notes : what was left out or assumed.
    """

    bed: Bed
    line: FlowLine
    validation: dict[str, Any]
    predicted: pd.DataFrame
    methods: pd.DataFrame
    notes: tuple[str, ...]

    def write(self, folder: Path, tags: dict[str, str]) -> None:
        """``bed.tif``, ``validation.json``, ``variogram.json``, ``centre_line.csv`` and tables."""
        folder.mkdir(parents=True, exist_ok=True)
        of = self.bed
        values = (of.up_m, of.sigma_m, of.sigma_common_m, of.distance_m)
        write_raster(folder / "bed.tif", of.grid, dict(zip(BANDS, values, strict=True)), tags=tags)
        facts = self.validation | {"notes": list(self.notes), "bed": of.facts}
        (folder / "validation.json").write_text(json.dumps(facts, indent=2) + "\n")
        (folder / "variogram.json").write_text(json.dumps(of.model.report(), indent=2) + "\n")
        self.line.write(folder / "centre_line.csv")
        self.predicted.to_csv(folder / "predicted.csv", index=False, float_format="%.4f")
        self.methods.to_csv(folder / "methods.csv", index=False, float_format="%.4f")


def bed_of_table(
    soundings: TableOfSoundings,
    crs: CRS,
    settings: Bathymetry,
    *,
    line: FlowLine | None = None,
    banks: tuple[Banks, pd.DataFrame] | None = None,
    seed: int = 1,
) -> BedOfTable:
    """The bed that soundings of a table show.

    Parameters
    ----------
    soundings : see there.
    crs : of the map.
    settings : cell, model, drift, neighbours, reach.
    line : centre line; None: that of the banks, or from the lines of soundings.
    banks : of `read_bank_lines`.
    seed : of the choice of left-out lines.

    Raises
    ------
    InputError : most soundings lie outside the banks or beside the centre line's perpendiculars.
    GeometryError : a single line of soundings.
    CoverageError : no cell near enough to data.
    """
    notes = [
        *soundings.notes,
        *(f"{n:,} {what}" for what, n in soundings.counts.items() if what != "rows" and n),
    ]
    if line is None:
        line = (
            banks[0].line
            if banks is not None
            else centre_of_lines(soundings.places_m, soundings.height_m, soundings.line)
        )
        notes.append("centre line half way between the banks" if banks else "centre line from the soundings")
    s, n, fold = line.to_flow(soundings.places_m)
    if fold.mean() > _ALONE:
        raise InputError(
            f"{fold.mean():.0%} of the soundings lie beyond the ends of the centre line, or where it "
            "bends too sharply for them",
            where="the centre line",
            expected="a centre line along all of them",
            cure="Look at --centre-line, --banks and --crs",
        )
    outside = banks[0].outside(s, n) & ~fold if banks is not None else np.zeros(len(s), dtype=np.bool_)
    if outside.mean() > _ALONE:
        raise InputError(
            f"{outside.mean():.0%} of the soundings lie outside the banks",
            expected="soundings between the banks",
            cure="Look at --crs and at the columns of the coordinates",
        )
    if fold.any():
        notes.append(f"{int(fold.sum()):,} soundings without flow coordinates left out")
    if outside.any():
        notes.append(f"{int(outside.sum()):,} soundings outside the banks, used")
    keep = ~fold
    half_widths = (
        banks[0].half_widths_m if banks is not None else hull_of_lines(s[keep], n[keep], soundings.line[keep])
    )
    table = _observations(
        "sounding", s, n, soundings.places_m, soundings.height_m, soundings.sigma_m, soundings.line
    )[keep]
    counts = {"soundings": len(table), "folded": int(fold.sum())}
    if banks is not None and len(banks[1]) and settings.bank_as_data:
        of = banks[1].sort_values(["side", "s_m"], kind="stable")
        spacing = max(float(np.median(half_widths(s)[0] + half_widths(s)[1])) / 20, settings.cell_m)
        of = of[~of.assign(k=(of["s_m"] // spacing)).duplicated(["side", "k"])]
        stretch = (of["s_m"] // (20 * spacing)).to_numpy(np.int64)
        number = -2 - 2 * (stretch - stretch.min()) - (of["side"] == "left").to_numpy(np.int64)
        table = pd.concat(
            [
                table,
                _observations(
                    "bank",
                    of["s_m"].to_numpy(np.float64),
                    of["n_m"].to_numpy(np.float64),
                    of[["east_m", "north_m"]].to_numpy(np.float64),
                    of["up_m"].to_numpy(np.float64),
                    of["sigma_m"].to_numpy(np.float64),
                    number,
                ),
            ],
            ignore_index=True,
        )
        counts["bank places"] = len(of)
    table = frame_of(OBSERVATIONS, {name: table[name] for name in OBSERVATIONS.names})
    _refuse_other_heights(table, half_widths)
    data = observations_of(table)
    model = choose_model(data, half_widths, settings, slow_time_s=0.0, seed=seed)
    grid = Grid.around(
        table[["east_m", "north_m"]].to_numpy(np.float64), settings.cell_m, crs, margin_m=2 * settings.cell_m
    )
    reach = settings.reach * model.covariance.range_s_m
    span = (float(data.s_m.min()) - reach, float(data.s_m.max()) + reach)
    flow, inside = cells_of_river(grid.centres_m(), line, half_widths, span, settings)
    bed = gridded(table, model, grid, flow, inside, settings, counts)
    facts, predicted, methods = validate_bed(table, model, half_widths, settings)
    return BedOfTable(
        bed=bed, line=line, validation=facts, predicted=predicted, methods=methods, notes=tuple(notes)
    )


def _refuse_other_heights(table: pd.DataFrame, half_widths: HalfWidths) -> None:
    """Soundings above the shores, or deeper below them than the river is wide: heights of another kind."""
    up = table.groupby("source")["up_m"].median()
    if "bank" not in up:
        return
    below = float(up["bank"] - up["sounding"])
    width = float(np.nanmedian(np.sum(half_widths(table["s_m"]), axis=0)))
    if below < 0 or below > width:
        raise InputError(
            f"the soundings lie {abs(below):.1f} m {'below' if below > 0 else 'above'} the banks in the "
            f"median, the river is {width:.0f} m wide",
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
    source: str,
    s: ArrayF,
    n: ArrayF,
    places: ArrayF,
    height: ArrayF,
    sigma: ArrayF,
    line: ArrayI | Sequence[int],
) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "source": source,
            "s_m": s,
            "n_m": n,
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
