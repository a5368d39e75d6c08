"""Results for a GIS: one GeoPackage with a layer each, the same bytes from the same input."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from pyproj import CRS

from thalweg.bathymetry import REASONS, SIDES, BedOfTable, FlowLine, TableOfSoundings
from thalweg.core import ArrayF, CoverageError, LocalFrame, Trajectory, read_parquet, utc_text_from_gps
from thalweg.fusion.dtm import Dtm
from thalweg.fusion.exports import contour_lines
from thalweg.fusion.measures import cut_sections
from thalweg.fusion.river import read_river
from thalweg.settings.sections import Fusion

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

_TRACK_M: Final = 0.01
"""Vertices of a track that lie nearer to the line without them are left out."""
_CONTOURS: Final = 12
"""About so many heights have contours where no interval is stated."""


def write_layers(path: Path, layers: Mapping[str, "GeoDataFrame"]) -> None:
    """Write a GeoPackage of these layers.

    Its times of change are those of no clock, so that equal results have equal bytes.
    """
    import pyogrio

    path.unlink(missing_ok=True)
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": "2000-01-01T00:00:00Z"})
    try:
        for name, table in layers.items():
            # in a version that long-term releases of QGIS read without a warning
            pyogrio.write_dataframe(
                table, path, layer=name, driver="GPKG", dataset_options={"VERSION": "1.2"}
            )
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": None})


def map_of_campaign(
    out: Path,
    trajectory: list[Path],
    soundings: list[Path],
    pings: list[Path],
    dtm: list[Path],
    banks: list[Path],
    line: list[Path],
    patches: list[Path],
    campaign: dict[str, Any],
    fusion: Fusion,
) -> None:
    """Results of a survey, or of a comparison of epochs, as layers of a GeoPackage.

    Parameters
    ----------
    out : file to write.
    trajectory, soundings, pings, dtm, banks, line : results of a survey, as far as there are: ``pings`` is
        ``soundings.parquet``, whose left-out soundings are a layer with their reasons.
    patches : ``patches_<pair>.csv`` of a comparison, a layer of points for each pair of epochs.
    campaign : origin and crs.
    fusion : interval of contours, distance of sections.
    """
    frame, crs = LocalFrame(**campaign["origin"]), CRS.from_user_input(campaign["crs"])
    layers = {}
    for path in trajectory:
        layers["track"] = _track(Trajectory.read(path), crs)
    for path in soundings:
        layers["soundings"] = _points(pd.read_csv(path), ["east", "north", "height"], crs)
    for path in pings:
        layers["soundings_left_out"] = _left_out(read_parquet(path), frame, crs)
    if dtm:
        layers |= _river(Dtm.read(dtm[0]), banks[0], line[0], frame, crs, fusion)
    for path in patches:
        table = pd.read_csv(path)
        layers[path.stem.replace("patches", "changes")] = _local_points(table, frame, crs)
    write_layers(out, layers)


def _local_points(table: pd.DataFrame, frame: LocalFrame, crs: CRS) -> "GeoDataFrame":
    """Points of a table with places in the local frame."""
    columns = ["east_m", "north_m", "up_m"]
    if len(table):
        table = table.copy()
        table[columns] = frame.to_map(table[columns].to_numpy(np.float64), crs)
    return _points(table, columns, crs)


def _left_out(table: pd.DataFrame, frame: LocalFrame, crs: CRS) -> "GeoDataFrame":
    """Soundings that do not count, as far as they have a place, with the reason in words."""
    away = table[~table["used"] & table["up_m"].notna()]
    columns = ["east_m", "north_m", "up_m", "depth_m", "t_gps_s", "line"]
    return _local_points(away[columns].assign(reason=away["reason"].map(REASONS)), frame, crs)


def map_of_bed(out: Path, found: BedOfTable, soundings: TableOfSoundings) -> None:
    """Soundings and contours of a bed of others' soundings; banks and centre line, or the shores of a lake.

    Parameters
    ----------
    out : file to write.
    found, soundings : of `bed_of_table` and `read_soundings`.
    """
    import shapely

    grid, water = found.bed.grid, found.water
    height = found.bed.up_m.reshape(grid.rows, grid.columns)
    table = pd.DataFrame({"height": soundings.height_m, "sigma": soundings.sigma_m, "line": soundings.line})
    table[["east", "north"]] = soundings.places_m
    layers = {"soundings": _points(table, ["east", "north", "height"], grid.crs)}
    if isinstance(water.line, FlowLine):
        layers["centre_line"] = _lines([(water.line.points_m, {})], grid.crs)
    if water.area is not None:
        rings = shapely.get_parts(shapely.boundary(water.area))
        layers["shores"] = _lines([(shapely.get_coordinates(ring), {}) for ring in rings], grid.crs)
    if water.banks is not None:
        banks = water.banks.table
        sides = [(banks[banks["side"] == side].sort_values("s_m"), side) for side in SIDES]
        layers["banks"] = _lines(
            [(rows[["east_m", "north_m"]].to_numpy(np.float64), {"side": side}) for rows, side in sides],
            grid.crs,
        )
    layers["contours"] = _contours(height, grid.centres_m().reshape(*height.shape, 2), None, grid.crs)
    write_layers(out, layers)


def _track(path: Trajectory, crs: CRS) -> "GeoDataFrame":
    """A line for each run of valid poses, with its times."""
    import shapely

    places = path.frame.to_map(path.position_wcs_m[path.valid], crs)
    times = path.t_gps_s[path.valid]
    run = np.cumsum(np.diff(np.flatnonzero(path.valid), prepend=0) > 1)
    parts = []
    for number in np.unique(run):
        of = run == number
        if of.sum() > 1:
            line = shapely.simplify(shapely.LineString(places[of]), _TRACK_M)
            first, last = (utc_text_from_gps(float(t)) for t in times[of][[0, -1]])
            parts.append((shapely.get_coordinates(line, include_z=True), {"from_utc": first, "to_utc": last}))
    return _lines(parts, crs)


def _river(
    model: Dtm, banks: Path, line: Path, frame: LocalFrame, crs: CRS, settings: Fusion
) -> dict[str, "GeoDataFrame"]:
    """Banks, centre line, thalweg, contours and sections of the terrain model."""
    river = read_river(FlowLine.read(line), banks, frame, crs, separation=model.separation)
    try:
        sections = cut_sections(model, river, settings)
    except CoverageError:  # the rule that measures the river says why
        sections = []
    shores = [(river.banks[river.banks["side"] == side].sort_values("s_m"), side) for side in SIDES]
    along = np.linspace(0.0, river.flow.length_m, max(int(river.flow.length_m / model.cell_m), 2))
    cuts = []
    for each in sections:
        known = np.isfinite(each.height_m)
        corners = np.column_stack([each.places_m, each.height_m])[known]
        cuts.append((corners, {"s_m": each.s_m, "level_m": each.level_m}))
    layers = {
        "banks": _lines(
            [
                (
                    frame.to_map(rows[["east_m", "north_m", "up_m"]].to_numpy(np.float64), crs)[:, :2],
                    {"side": side},
                )
                for rows, side in shores
            ],
            crs,
        ),
        "centre_line": _lines([(river.to_map(along, 0.0), {})], crs),
        "contours": _contours(model.height_m, model.centres_m(), settings.contour_m, crs),
        "sections": _lines(cuts, crs),
    }
    if len(sections) > 1:
        lowest = river.to_map([each.s_m for each in sections], [each.thalweg_m for each in sections])
        layers["thalweg"] = _lines([(lowest, {})], crs)
    return layers


def _contours(height_m: ArrayF, centres_m: ArrayF, interval_m: float | None, crs: CRS) -> "GeoDataFrame":
    """Contours at whole multiples of an interval: that, or 1, 2 or 5 times a power of ten."""
    if interval_m is None:
        rough = max(float(np.nanmax(height_m) - np.nanmin(height_m)) / _CONTOURS, 0.01)
        power = 10.0 ** np.floor(np.log10(rough))
        interval_m = next(float(k * power) for k in (1, 2, 5, 10) if k * power >= rough * (1 - 1e-9))
    found = contour_lines(height_m, centres_m, interval_m)
    return _lines([(line, {"height_m": round(level, 6)}) for level, line in found], crs)


def _lines(parts: list[tuple[ArrayF, dict[str, Any]]], crs: CRS) -> "GeoDataFrame":
    """Lines through at least two corners, with their properties."""
    import geopandas
    import shapely

    kept = [(corners, of) for corners, of in parts if len(corners) > 1]
    return geopandas.GeoDataFrame(
        pd.DataFrame([of for _, of in kept], index=range(len(kept))),
        geometry=[shapely.LineString(corners) for corners, _ in kept],
        crs=crs,
    )


def _points(table: pd.DataFrame, columns: list[str], crs: CRS) -> "GeoDataFrame":
    """Points of a table, whose other columns are their properties."""
    import geopandas
    import shapely

    places: ArrayLike = table[columns].to_numpy(np.float64)
    return geopandas.GeoDataFrame(table.drop(columns=columns), geometry=shapely.points(places), crs=crs)
