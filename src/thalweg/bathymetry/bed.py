"""The riverbed as a grid: soundings, banks and points of the light sheet, kriged in flow coordinates."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
from pyproj import CRS
from scipy.optimize import brentq
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from thalweg.bathymetry.banks import Banks, bank_observations
from thalweg.bathymetry.flow import FlowLine
from thalweg.bathymetry.kriging import Observations, krige_by_pykrige
from thalweg.bathymetry.lake import Plane
from thalweg.bathymetry.soundings import with_bed_normals
from thalweg.bathymetry.variogram import SHEET_LINE, BedModel, HalfWidths, choose_model
from thalweg.bathymetry.water import WaterLevel
from thalweg.core import (
    ArrayB,
    ArrayF,
    CoverageError,
    Grid,
    InputError,
    LocalFrame,
    column,
    frame_of,
    table_kind,
)
from thalweg.settings.sections import Bathymetry, EchoSounder
from thalweg.surface import Area

OBSERVATIONS = table_kind(
    "bed_observations",
    2,
    [
        column("source", "1", "sounding, table, bank or light sheet", pa.string()),
        column("s_m", "m", "along the centre line"),
        column("n_m", "m", "across it, positive to the left of the flow"),
        *(column(f"{a}_m", "m", f"{a} in wcs") for a in ("east", "north", "up")),
        column("sigma_white_m", "m", "noise of the height"),
        column("sigma_slow_m", "m", "error of the height that lasts"),
        column("sigma_common_m", "m", "error of the height that all of its source share"),
        column("t_even_s", "s", "time in which the error that lasts decays evenly; NaN of banks"),
        column("line", "1", "line of soundings; negative of others", pa.int64()),
    ],
)
"""Heights that the bed is made of."""

BANDS: Final = ("height_m", "sigma_m", "sigma_common_m", "distance_m")
"""Bands of ``bed.tif``: ellipsoidal height; standard deviation without and with what all data share only;
distance to the nearest datum."""

_ALONE: Final = 0.5
"""A larger share of soundings outside the banks is a mistake of the banks."""
_PIECE_M: Final = 0.25
"""Points of a light-sheet image within this are one datum."""
_RELIEF_M: Final = 0.01
"""Floor of the noise of such a datum: grains of the bed."""
_WINDOWS: Final = 16
"""Places about which the covariance of the errors is looked at, with so many cells, data, and points of a
cross-section:"""
_WINDOW_CELLS: Final = 120
_WINDOW_DATA: Final = 300
_SECTION: Final = 40
_LENGTHS_M: Final = (0.05, 1000.0)
_USUAL: Final = (0.05, 0.95)
_BEYOND: Final = 3.0
"""No bed leaves the range of its data by more than so many times that range."""
_APART: Final = 5.0
"""Light-sheet data whose median lies so many standard deviations off the bed of the soundings are of another
bed, or one of both is wrong: they are left out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bed:
    """A kriged bed.

    Parameters
    ----------
    grid : cells.
    up_m, sigma_m, sigma_common_m, distance_m : (rows * columns,) in wcs; NaN where there is no bed.
    model : drift and covariance.
    data : what it is made of, table of kind ``bed_observations``.
    facts : counts and sizes.
    """

    grid: Grid
    up_m: ArrayF
    sigma_m: ArrayF
    sigma_common_m: ArrayF
    distance_m: ArrayF
    model: BedModel
    data: pd.DataFrame
    facts: dict[str, Any]

    def bands(self, frame: LocalFrame) -> dict[str, ArrayF]:
        """Values of `BANDS`: heights become ellipsoidal."""
        height = np.full(len(self.up_m), np.nan)
        known = np.isfinite(self.up_m)
        places = frame.from_map(
            np.column_stack([self.grid.centres_m()[known], np.full(known.sum(), frame.h_ell_m)]),
            self.grid.crs,
        )
        places[:, 2] = self.up_m[known]
        height[known] = frame.to_map(places, self.grid.crs)[:, 2]
        values = (height, self.sigma_m, self.sigma_common_m, self.distance_m)
        return dict(zip(BANDS, values, strict=True))


def observations_of(table: pd.DataFrame) -> Observations:
    """Rows of kind ``bed_observations`` as kriging takes them."""
    return Observations(
        s_m=table["s_m"].to_numpy(np.float64),
        n_m=table["n_m"].to_numpy(np.float64),
        height_m=table["up_m"].to_numpy(np.float64),
        sigma_white_m=table["sigma_white_m"].to_numpy(np.float64),
        sigma_slow_m=table["sigma_slow_m"].to_numpy(np.float64),
        t_s=table["t_even_s"].to_numpy(np.float64),
        line=table["line"].to_numpy(np.int64),
    )


def bed_observations(
    soundings: pd.DataFrame,
    line: FlowLine,
    banks: Banks,
    level: WaterLevel,
    strip: pd.DataFrame | None,
    *,
    bank_as_data: bool,
    others: pd.DataFrame | None = None,
) -> tuple[pd.DataFrame, dict[str, int]]:
    """Everything that says how high the bed is, in flow coordinates.

    Parameters
    ----------
    soundings : table of kind ``soundings``.
    line, banks, level : of the river.
    strip : points of the light sheet, kind ``bed_points``; None: there are none.
    bank_as_data : shorelines are data.
    others : soundings of others, `thalweg.bathymetry.read_other_soundings`; None: there are none.

    Returns
    -------
    table : kind ``bed_observations``.
    counts : by source, and ``folded``: where flow coordinates fold.

    Raises
    ------
    CoverageError : no sounding is left.
    InputError : most of them lie outside the banks.
    """
    used = soundings[soundings["used"]]
    s, n, fold = line.to_flow(used[["east_m", "north_m"]].to_numpy(np.float64))
    parts = [
        pd.DataFrame(
            {
                "source": "sounding",
                "s_m": s,
                "n_m": n,
                **{
                    k: used[k].to_numpy()
                    for k in (
                        "east_m",
                        "north_m",
                        "up_m",
                        "sigma_white_m",
                        "sigma_slow_m",
                        "sigma_common_m",
                        "t_even_s",
                        "line",
                    )
                },
            }
        )[~fold]
    ]
    counts = {"soundings": int((~fold).sum()), "folded": int(fold.sum())}
    if not counts["soundings"]:
        raise CoverageError(
            f"none of {len(used)} soundings lies beside the centre line",
            expected="soundings along the river",
            where="bathymetry/centre_line.csv",
            cure="State logs.centre_line, drawn along all soundings",
        )
    outside = banks.outside(s, n) & ~fold if len(banks.table) else np.zeros(len(s), dtype=np.bool_)
    counts["outside the banks"] = int(outside.sum())
    if outside.sum() > _ALONE * counts["soundings"]:
        raise InputError(
            f"{outside.sum()} of {counts['soundings']} soundings lie outside the banks",
            expected="soundings between the banks",
            where="bathymetry/banks.csv",
            cure="Look at logs.bank_lines and their coordinate system; islands of the cloud are no bank",
        )
    if others is not None and len(others):
        first = int(used["line"].max()) + 1
        parts.append(_of_others(others, line, level, first))
        counts["soundings of others"] = len(parts[-1])
    if bank_as_data and len(banks.table):
        of = bank_observations(banks, level)
        places = banks.table[["east_m", "north_m"]].to_numpy(np.float64)
        parts.append(
            pd.DataFrame(
                {
                    "source": "bank",
                    "s_m": of["s_m"],
                    "n_m": of["n_m"],
                    "east_m": places[:, 0],
                    "north_m": places[:, 1],
                    "up_m": of["height_m"],
                    "sigma_white_m": of["sigma_white_m"],
                    "sigma_slow_m": 0.0,
                    "sigma_common_m": of["sigma_slow_m"],
                    "t_even_s": np.nan,
                    "line": of["line"],
                }
            )
        )
        counts["bank places"] = len(places)
    if strip is not None and len(strip):
        times = np.sort(soundings[["t_gps_s", "t_even_s"]].dropna().to_numpy(np.float64), axis=0)
        parts.append(_of_strip(strip, line, times))
        counts["light sheet"] = len(parts[-1])
    table = pd.concat(parts, ignore_index=True)
    return frame_of(OBSERVATIONS, {name: table[name] for name in OBSERVATIONS.names}), counts


def _of_others(others: pd.DataFrame, line: FlowLine, level: WaterLevel, first: int) -> pd.DataFrame:
    """Soundings of others beside the centre line; their lines count on from the first free number."""
    s, n, fold = line.to_flow(others[["east_m", "north_m"]].to_numpy(np.float64))
    up, sigma = level.at(s)
    depth = others["depth_m"].to_numpy(np.float64)
    told = np.isfinite(depth)
    return pd.DataFrame(
        {
            "source": "table",
            "s_m": s,
            "n_m": n,
            **{k: others[k].to_numpy() for k in ("east_m", "north_m", "sigma_white_m")},
            "up_m": np.where(told, up - depth, others["up_m"].to_numpy(np.float64)),
            "sigma_slow_m": 0.0,
            "sigma_common_m": np.hypot(
                others["sigma_common_m"].to_numpy(np.float64), np.where(told, sigma, 0.0)
            ),
            "t_even_s": np.nan,
            "line": others["line"].to_numpy() + first,
        }
    )[~fold]


def _of_strip(strip: pd.DataFrame, line: FlowLine, times: ArrayF) -> pd.DataFrame:
    """Points of the light sheet: medians of pieces of each image's line; GPS and even times (k, 2)."""
    piece = np.floor(strip[["east_m", "north_m"]].to_numpy(np.float64) / _PIECE_M).astype(np.int64)
    groups = strip.assign(a=piece[:, 0], b=piece[:, 1]).groupby(["t_gps_s", "a", "b"], sort=True)
    of = groups[["east_m", "north_m", "up_m", "sigma_line_m", "cov_uu_m2"]].median().reset_index()
    count = groups.size().to_numpy(np.float64)
    s, n, fold = line.to_flow(of[["east_m", "north_m"]].to_numpy(np.float64))
    own = of["sigma_line_m"].to_numpy(np.float64)
    return pd.DataFrame(
        {
            "source": "light sheet",
            "s_m": s,
            "n_m": n,
            **{k: of[k].to_numpy() for k in ("east_m", "north_m", "up_m")},
            "t_even_s": np.interp(of["t_gps_s"].to_numpy(np.float64), *times.T),
            "sigma_white_m": np.hypot(1.25 * own / np.sqrt(count), _RELIEF_M),
            "sigma_slow_m": np.sqrt(np.maximum(of["cov_uu_m2"].to_numpy(np.float64) - own**2, 0.0)),
            "sigma_common_m": 0.0,
            "line": SHEET_LINE - pd.factorize(of["t_gps_s"])[0],
        }
    )[~fold]


def cells_of_river(
    places: ArrayF,
    line: FlowLine | Plane,
    half_widths: HalfWidths,
    span_m: tuple[float, float],
    settings: Bathymetry,
) -> tuple[ArrayF, ArrayB]:
    """Flow coordinates (m, 2) of places, and which of them are bed: between the shores, not on islands."""
    s, n, fold = line.to_flow(places)
    left, right = half_widths(s)
    inside = ~fold & (s >= span_m[0]) & (s <= span_m[1])
    # a side without any shore ends where the data end; one with gaps has no bed there
    for width, across in ((left, n), (right, -n)):
        if np.isfinite(width).any():
            inside &= (across <= 0) | (across <= width)
    for corners in settings.islands:
        island = Area(polygon_en_m=np.asarray(corners, dtype=np.float64))
        inside &= ~island.contains(np.column_stack([places, np.zeros(len(places))]))
    return np.column_stack([s, n]), inside


def krige_bed(
    soundings: pd.DataFrame,
    line: FlowLine,
    banks: Banks,
    level: WaterLevel,
    strip: pd.DataFrame | None,
    *,
    frame: LocalFrame,
    crs: CRS,
    echo: EchoSounder,
    settings: Bathymetry,
    slow_time_s: float,
    seed: int,
    others: pd.DataFrame | None = None,
) -> Bed:
    """The riverbed of a survey.

    The return of a wide beam from a slope needs the slope, which needs the bed: it is kriged, and kriged
    again with the slopes that it shows.

    Points of the light sheet that contradict the soundings at the same places are left out; ``facts`` hold
    their number and by how much they lie above.

    Parameters
    ----------
    soundings, line, banks, level, strip : see `bed_observations`.
    frame, crs : of the world and of the map.
    echo, settings : see there.
    slow_time_s : correlation time of positions.
    seed : of the choice of left-out lines.
    others : soundings of others.

    Raises
    ------
    GeometryError : a single line of soundings.
    CoverageError : no sounding beside the centre line, or no cell near enough to one.
    """
    table, counts = bed_observations(
        soundings, line, banks, level, strip, bank_as_data=settings.bank_as_data, others=others
    )
    sheet = table["source"] == "light sheet"
    model = choose_model(
        observations_of(table[~sheet]), banks.half_widths_m, settings, slow_time_s=slow_time_s, seed=seed
    )
    against = _against_soundings(table, sheet.to_numpy(), model, settings.neighbours)
    if against and against["light sheet left out"]:
        strip = None
        table = table[~sheet].reset_index(drop=True)
    data = observations_of(table)
    around = frame.to_map(table[["east_m", "north_m", "up_m"]].to_numpy(np.float64), crs)[:, :2]
    grid = Grid.around(around, settings.cell_m, crs, margin_m=2 * settings.cell_m)
    reach = settings.reach * model.covariance.range_s_m
    span = (float(data.s_m.min()) - reach, float(data.s_m.max()) + reach)
    centres = grid.centres_m()
    cells = frame.from_map(np.column_stack([centres, np.full(len(centres), frame.h_ell_m)]), crs)[:, :2]
    flow, inside = cells_of_river(cells, line, banks.half_widths_m, span, settings)
    if echo.beam_deg > 0:
        height, _ = _solved(model, data, flow, inside, settings)
        east, north = _slopes(grid, height, frame, soundings)
        soundings = with_bed_normals(soundings, east, north, echo)
        table, counts = bed_observations(
            soundings, line, banks, level, strip, bank_as_data=settings.bank_as_data, others=others
        )
    return gridded(table, model, grid, flow, inside, settings, counts | against)


def _against_soundings(
    table: pd.DataFrame, sheet: ArrayB, model: BedModel, neighbours: int
) -> dict[str, int | float]:
    """How far the light sheet lies above the bed of everything else, and how many of its data are left out.

    Empty if there is none. Errors that all of its data share are part of the standard deviation, so that
    the median does not become surer by more points.
    """
    if not sheet.any():
        return {}
    there = observations_of(table[sheet])
    height, sigma = model.predict(observations_of(table[~sheet]), there.places_m, neighbours=neighbours)
    common = table["sigma_common_m"].to_numpy(np.float64)
    shared = np.hypot(np.median(common[~sheet]), common[sheet])
    above = there.height_m - height
    off = above / np.sqrt(sigma**2 + model.own_variance(there) + shared**2)
    apart = bool(abs(np.median(off)) > _APART)
    return {
        "light sheet": int(sheet.sum()),
        "light sheet above the soundings_m": float(np.median(above)),
        "light sheet above the soundings, sigmas": float(np.median(off)),
        "light sheet left out": int(sheet.sum()) if apart else 0,
    }


def gridded(
    table: pd.DataFrame,
    model: BedModel,
    grid: Grid,
    flow: ArrayF,
    inside: ArrayB,
    settings: Bathymetry,
    counts: dict[str, Any],
) -> Bed:
    """Kriged cells.

    Parameters
    ----------
    table : kind ``bed_observations``.
    model : drift and covariance.
    grid : cells.
    flow : (m, 2) flow coordinates of all cells.
    inside : (m,) cells of the bed.
    settings : engine, neighbours, reach.
    counts : of the table, for the facts.

    Raises
    ------
    CoverageError : no cell is near enough to a datum, or heights are none that the data can tell.
    """
    data = observations_of(table)
    height, sigma = _solved(model, data, flow, inside, settings)
    sigma = model.steepened(sigma, _steepness(grid, height))
    common, distance, far = _nearest(table, data, model, flow, inside, settings.reach)
    for values in (height, sigma, common, distance):
        values[far | ~inside] = np.nan
    known = int(np.isfinite(height).sum())
    if not known:
        raise CoverageError(
            "no cell of the bed is near enough to a sounding",
            expected="cells within bathymetry.reach ranges of data",
            where="the grid of the bed",
            cure="Raise bathymetry.reach or lower bathymetry.cell_m",
        )
    _refuse_impossible(height, sigma, data)
    facts: dict[str, Any] = counts | {
        "cells": known,
        "area_m2": known * settings.cell_m**2,
        "cells too far from data": int((far & inside).sum()),
        "median sigma_m": float(np.nanmedian(sigma)),
        "median sigma_common_m": float(np.nanmedian(common)),
        "error correlation_m": error_lengths(model, data, flow[np.isfinite(height)]),
    }
    return Bed(
        grid=grid,
        up_m=height,
        sigma_m=sigma,
        sigma_common_m=common,
        distance_m=distance,
        model=model,
        data=table,
        facts=facts,
    )


def _refuse_impossible(height: ArrayF, sigma: ArrayF, data: Observations) -> None:
    """Beds that leave the range of their data far behind, or know less than it: data of no one water.

    Left-out lines cannot tell: rubbish that agrees with itself is foretold well.
    """
    low, high = float(data.height_m.min()), float(data.height_m.max())
    # data that are all alike differ by their noise; a few that are far off are no range to be unsure in
    noise = 4 * float(np.median(data.sigma_white_m))
    span, usual = high - low + noise, float(np.diff(np.quantile(data.height_m, _USUAL))[0]) + noise
    beyond = (height < low - _BEYOND * span) | (height > high + _BEYOND * span)
    unsure = float(np.nanmedian(sigma))
    if beyond.any():
        found = f"{int(beyond.sum()):,} cells between {np.nanmin(height):,.1f} and {np.nanmax(height):,.1f} m"
    elif unsure > usual:
        found = (
            f"a median sigma of {unsure:,.2f} m, nine tenths of the data lie within {usual - noise:,.2f} m"
        )
    else:
        return
    raise CoverageError(
        f"{found}; the data lie between {low:,.1f} and {high:,.1f} m",
        expected="heights and sigmas within the range of the data",
        where="the grid of the bed",
        cure="Look for soundings of another place or unit and for values that stand for none; or lower reach",
    )


def error_lengths(model: BedModel, data: Observations, flow: ArrayF) -> dict[str, float | None]:
    """Over which distance errors of the bed fall to 1/e, for sums over areas and along cross-sections.

    The covariance of the errors of kriging is that of the field given the data: between two lines of
    soundings errors are alike, beyond a line they are not. For an area (cells within two spacings of lines
    along the river, or its width) and for cross-sections, the length is the one with which
    ``sum sigma_i sigma_j exp(-d_ij / length)`` is the sum of all covariances.

    Parameters
    ----------
    model, data : of the bed.
    flow : (m, 2) flow coordinates of its cells.

    Returns
    -------
    lengths : ``area`` and ``section``, metres; None where too few data lie about the cells.
    """
    rng = np.random.default_rng(0)
    lines = max(len(np.unique(data.line[data.line >= 0])), 1)
    width = float(np.ptp(flow[:, 1]))
    reach = max(2 * float(np.ptp(flow[:, 0])) / lines, width)
    parts: dict[str, list[tuple[ArrayF, ArrayF]]] = {"area": [], "section": []}
    for k in rng.choice(len(flow), min(_WINDOWS, len(flow)), replace=False).tolist():
        apart = np.abs(flow[:, 0] - flow[k, 0])
        use = np.flatnonzero(np.abs(data.s_m - flow[k, 0]) <= 2 * reach)
        rest = data.where(use[:: max(1, -(-len(use) // _WINDOW_DATA))])
        near = np.flatnonzero(apart <= reach)
        if len(rest) < 4 or len(near) < 4:
            continue
        across = flow[near, 1]
        section = np.column_stack(
            [np.full(_SECTION, flow[k, 0]), np.linspace(across.min(), across.max(), _SECTION)]
        )
        area = flow[np.sort(rng.choice(near, min(_WINDOW_CELLS, len(near)), replace=False))]
        for name, cells in (("area", area), ("section", section)):
            parts[name].append((model.error_covariance(rest, cells), cdist(cells, cells)))
    return {name: _length_of(of) for name, of in parts.items()}


def _length_of(parts: list[tuple[ArrayF, ArrayF]]) -> float | None:
    """Length with which exponential correlations have the same sum as covariances at distances."""
    if not parts:
        return None
    total = sum(float(cov.sum()) for cov, _ in parts)
    sigmas = [np.sqrt(np.maximum(np.diag(cov), 0.0)) for cov, _ in parts]

    def beyond(log_length: float) -> float:
        """Sum with a length less the sum of covariances."""
        length = np.exp(log_length)
        return (
            sum(float(s @ np.exp(-d / length) @ s) for s, (_, d) in zip(sigmas, parts, strict=True)) - total
        )

    low, high = np.log(_LENGTHS_M)
    if beyond(low) >= 0:
        return float(_LENGTHS_M[0])
    return float(np.exp(brentq(beyond, low, high))) if beyond(high) > 0 else float(_LENGTHS_M[1])


def _solved(
    model: BedModel, data: Observations, flow: ArrayF, inside: ArrayB, settings: Bathymetry
) -> tuple[ArrayF, ArrayF]:
    height, sigma = np.full(len(flow), np.nan), np.full(len(flow), np.nan)
    if settings.engine == "pykrige":
        rest = data.lifted(
            data.height_m - model.drift.at(data.places_m)
        )  # its errors, and margins, not counted
        found, sigma[inside] = krige_by_pykrige(rest, flow[inside], model.covariance)
        height[inside] = found + model.drift.at(flow[inside])
    else:
        height[inside], sigma[inside] = model.predict(data, flow[inside], neighbours=settings.neighbours)
    return height, sigma


def _slopes(grid: Grid, up_m: ArrayF, frame: LocalFrame, soundings: pd.DataFrame) -> tuple[ArrayF, ArrayF]:
    """Rise of the bed to the east and the north (n,) at soundings; NaN where it is not known."""
    surface = up_m.reshape(grid.rows, grid.columns)
    if min(surface.shape) < 3:
        return np.full(len(soundings), np.nan), np.full(len(soundings), np.nan)
    north, east = np.gradient(surface, -grid.cell_m, grid.cell_m)
    places = soundings[["east_m", "north_m", "up_m"]].to_numpy(np.float64)
    known = np.isfinite(places).all(axis=1)
    row, col = np.full(len(places), -1), np.full(len(places), -1)
    row[known], col[known] = grid.at(frame.to_map(places[known], grid.crs)[:, :2])
    return (np.where(row >= 0, east[row, col], np.nan), np.where(row >= 0, north[row, col], np.nan))


def _steepness(grid: Grid, up_m: ArrayF) -> ArrayF:
    """Slope (m,) of cells towards their neighbours that have a height; 0 without any."""
    surface = up_m.reshape(grid.rows, grid.columns)
    square = np.zeros_like(surface)
    for axis in (0, 1):
        edge = [(1, 1) if k == axis else (0, 0) for k in (0, 1)]
        rise = np.pad(np.diff(surface, axis=axis) / grid.cell_m, edge, constant_values=np.nan)
        sides = np.stack([np.delete(rise, end, axis=axis) for end in (0, -1)])
        known = np.isfinite(sides).sum(axis=0)
        square += (np.nansum(sides, axis=0) / np.maximum(known, 1)) ** 2
    return np.sqrt(square).ravel()


def _nearest(
    table: pd.DataFrame, data: Observations, model: BedModel, flow: ArrayF, inside: ArrayB, reach: float
) -> tuple[ArrayF, ArrayF, ArrayB]:
    """Common sigma and distance of the nearest datum of each cell, and whether it is too far away."""
    common, distance = np.full(len(flow), np.nan), np.full(len(flow), np.nan)
    far = np.zeros(len(flow), dtype=np.bool_)
    if not inside.any():
        return common, distance, far
    distance[inside], at = cKDTree(data.places_m).query(flow[inside])
    common[inside] = table["sigma_common_m"].to_numpy(np.float64)[at]
    scaled = cKDTree(model.covariance.scaled(data.places_m)).query(model.covariance.scaled(flow[inside]))[0]
    far[inside] = scaled > reach
    return common, distance, far
