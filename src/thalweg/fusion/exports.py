"""Sections and terrain for hydraulic programs: HEC-RAS, SWMM, CSV, GeoJSON, BAG.

Sources: HEC-RAS User's Manual 6.6, "RAS GIS Import File (RASImport.sdf)", keywords of its header table;
Storm Water Management Model User's Manual 5.1, appendix D.2, section [TRANSECTS]; RFC 7946 (GeoJSON;
coordinates stay in the campaign's grid, named as GeoJSON 2008 did, for GIS that read it).
"""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from thalweg.core import ArrayB, ArrayF, InputError, ThalwegError
from thalweg.fusion.dtm import Dtm, cells_inside
from thalweg.fusion.measures import UNTOLD_LENGTH_M, Section, volume_below
from thalweg.fusion.mesh import mesh_river, write_2dm, write_selafin, write_ugrid
from thalweg.fusion.river import River
from thalweg.settings.sections import Fusion

_OF_MESH = ("2dm", "selafin", "ugrid")
_OF_SECTIONS = {"hecras", "swmm", "csv", "geojson"}
_SWMM_MOST_POINTS = 1500
"""SWMM 5 takes no more stations in a transect."""


def export_river(
    folder: Path, model: Dtm, river: River, sections: Sequence[Section], settings: Fusion
) -> dict[str, Any]:
    """Files of `fusion.exports` for other programs.

    Parameters
    ----------
    folder : where they go; it is made.
    model, river, sections : what they hold.

    Returns
    -------
    facts : ``written`` (names), ``not_written`` (format -> why), and of the mesh nodes, faces, least angle.
    """
    folder.mkdir(parents=True, exist_ok=True)
    writers: dict[str, Callable[[], object]] = {
        "hecras": lambda: write_hecras(folder / "RASImport.sdf", sections, river),
        "swmm": lambda: write_swmm(folder / "transects.inp", sections, settings),
        "csv": lambda: write_csv(folder / "sections.csv", sections),
        "geojson": lambda: write_geojson(folder / "lines.geojson", model, sections, river, settings),
        "bag": lambda: write_bag(folder / "terrain.bag", model),
    }
    facts: dict[str, Any] = {"not_written": {}}
    if not sections:
        facts["not_written"] |= dict.fromkeys(_OF_SECTIONS & set(settings.exports), "no cross section")
    wanted = [name for name in settings.exports if name in _OF_MESH]
    if wanted:
        try:
            mesh = mesh_river(model, river, settings.mesh)
        except ThalwegError as error:
            # sections are of use without a mesh
            facts["not_written"] |= dict.fromkeys(wanted, str(error))
        else:
            angles = mesh.least_angles_deg()
            facts["mesh"] = {
                "nodes": len(mesh.nodes_m),
                "faces": len(mesh.faces),
                "least_angle_deg": float(angles.min()),
                "folded": int((angles <= 0).sum()),
            }
            border = mesh.boundary()
            along = river.to_flow(mesh.nodes_m[border, :2])[0]
            inflow = border[along < along.min() + settings.mesh.edge_m / 4]
            outflow = border[along > along.max() - settings.mesh.edge_m / 4]
            writers |= {
                "2dm": lambda: write_2dm(folder / "mesh.2dm", mesh),
                "selafin": lambda: write_selafin(
                    folder / "mesh.slf", folder / "mesh.cli", mesh, inflow=inflow, outflow=outflow
                ),
                "ugrid": lambda: write_ugrid(folder / "mesh.nc", mesh, crs_wkt=model.crs.to_wkt()),
            }
    for name in settings.exports:
        if name in facts["not_written"]:
            continue
        try:
            writers[name]()
        except ThalwegError as error:
            facts["not_written"][name] = str(error)
    return facts | {"written": sorted(path.name for path in folder.iterdir())}


def water_of(
    model: Dtm, river: River, settings: Fusion, *, correlation_m: float | None = None
) -> tuple[ArrayB, dict[str, float]]:
    """Cells (rows, columns) inside the water line, and volume and area of the water with its sigma.

    Parameters
    ----------
    model, river : what is measured.
    settings : length of correlation of errors, if it is stated.
    correlation_m : that of the bed over an area; None: 5 m.
    """
    inside = cells_inside(river.outline_m(), model.corner_m, model.cell_m, model.height_m.shape)
    level = np.full(model.height_m.shape, np.nan)
    level[inside] = river.level_m(river.to_flow(model.centres_m()[inside])[0])
    volume, sigma, area = volume_below(
        model, level, inside, settings.correlation_m or correlation_m or UNTOLD_LENGTH_M
    )
    empty = inside & ~np.isfinite(model.height_m)
    return inside, {
        "volume_m3": volume,
        "sigma_volume_m3": sigma,
        "wet_area_m2": area,
        "inside_m2": float(inside.sum()) * model.cell_m**2,
        "without_height_m2": float(empty.sum()) * model.cell_m**2,
    }


def write_csv(path: Path, sections: Sequence[Section]) -> None:
    """Points of all sections: s, n, east, north, height, sigma, water level; heights with three digits."""
    parts = [
        pd.DataFrame(
            {
                "s_m": section.s_m,
                "n_m": section.n_m,
                "east_m": section.places_m[:, 0],
                "north_m": section.places_m[:, 1],
                "height_m": section.height_m,
                "sigma_m": section.sigma_m,
                "level_m": section.level_m,
            }
        )[np.isfinite(section.height_m)]
        for section in sections
    ]
    pd.concat(parts).to_csv(path, index=False, float_format="%.4f")


def write_hecras(path: Path, sections: Sequence[Section], river: River, *, name: str = "River") -> None:
    """Geometry of a river for HEC-RAS (``RASImport.sdf``): centre line and cut lines, from left to right.

    Stations count from the lower end upstream, as HEC-RAS wants them; cut lines begin at the left bank as one
    looks downstream.
    """
    ordered = sorted(sections, key=lambda section: section.s_m)
    length = river.flow.length_m
    line = river.to_map(np.linspace(0, length, max(int(length / 5) + 1, 2)), 0.0)
    places = np.concatenate([line, *(section.places_m for section in ordered)])
    low, high = places.min(axis=0), places.max(axis=0)
    zone = river.crs.utm_zone
    out = [
        "BEGIN HEADER:",
        "UNITS: METRIC",
        "DTM TYPE: GRID",
        "DTM: dtm.tif",
        "STREAM LAYER: centre line",
        "CROSS-SECTION LAYER: sections",
        f"MAP PROJECTION: {'UTM' if zone else river.crs.name}",
        f"PROJECTION ZONE: {zone[:-1] if zone else ''}",
        f"DATUM: {river.crs.geodetic_crs.name if river.crs.geodetic_crs else ''}",
        f"VERTICAL DATUM: {'ELLIPSOIDAL' if not river.separation_m else 'ORTHOMETRIC'}",
        "NUMBER OF REACHES: 1",
        f"NUMBER OF CROSS-SECTIONS: {len(ordered)}",
        "BEGIN SPATIAL EXTENT:",
        f"XMIN: {low[0]:.3f}", f"YMIN: {low[1]:.3f}", f"XMAX: {high[0]:.3f}", f"YMAX: {high[1]:.3f}",
        "END SPATIAL EXTENT:",
        "END HEADER:",
        "",
        "BEGIN STREAM NETWORK:",
        f"ENDPOINT: {line[0, 0]:.3f}, {line[0, 1]:.3f}, 0, 1",
        f"ENDPOINT: {line[-1, 0]:.3f}, {line[-1, 1]:.3f}, 0, 2",
        "REACH:",
        f"STREAM ID: {name}",
        "REACH ID: Reach",
        "FROM POINT: 1",
        "TO POINT: 2",
        "CENTERLINE:",
        *(f"{x:.3f}, {y:.3f}, 0, 0" for x, y in line),
        "END:",
        "END STREAM NETWORK:",
        "",
        "BEGIN CROSS-SECTIONS:",
    ]  # fmt: skip
    for i, section in enumerate(ordered):
        known = np.isfinite(section.height_m)
        n, xy, z = (a[known][::-1] for a in (section.n_m, section.places_m, section.height_m))
        width = n[0] - n[-1]
        bank = [float((n[0] - offset) / width) for offset in (section.left_m, section.right_m)]
        ahead = ordered[i + 1].s_m - section.s_m if i + 1 < len(ordered) else 0.0
        out += [
            "CROSS-SECTION:",
            f"STREAM ID: {name}",
            "REACH ID: Reach",
            f"STATION: {length - section.s_m:.2f}",
            f"BANK POSITIONS: {bank[0]:.5f}, {bank[1]:.5f}",
            f"REACH LENGTHS: {ahead:.2f}, {ahead:.2f}, {ahead:.2f}",
            "CUT LINE:",
            *(f"{x:.3f}, {y:.3f}" for x, y in (xy[0], xy[-1])),
            "SURFACE LINE:",
            *(f"{x:.3f}, {y:.3f}, {h:.3f}" for (x, y), h in zip(xy, z, strict=True)),
            "END:",
        ]
    path.write_text("\n".join([*out, "END CROSS-SECTIONS:", ""]))


def write_swmm(path: Path, sections: Sequence[Section], settings: Fusion) -> None:
    """Transects of SWMM: NC, X1, GR lines; stations from the left end as one looks downstream."""
    rough = settings.sections.manning
    out = ["[TRANSECTS]", ";;Transect data in HEC-2 format", ""]
    for section in sections:
        known = np.flatnonzero(np.isfinite(section.height_m))[::-1]
        if len(known) > _SWMM_MOST_POINTS:
            known = known[np.unique(np.linspace(0, len(known) - 1, _SWMM_MOST_POINTS).astype(int))]
        n, z = section.n_m[known], section.height_m[known]
        station = n[0] - n
        left, right = n[0] - section.left_m, n[0] - section.right_m
        pairs = [f"{h:.3f} {x:.3f}" for h, x in zip(z, station, strict=True)]
        out += [
            f"NC {rough:g} {rough:g} {rough:g}",
            f"X1 S{section.s_m:.1f} {len(pairs)} {left:.3f} {right:.3f} 0 0 0 0 0",
            *("GR " + " ".join(pairs[i : i + 5]) for i in range(0, len(pairs), 5)),
            "",
        ]
    path.write_text("\n".join(out))


def contour_lines(model: Dtm, interval_m: float) -> list[tuple[float, ArrayF]]:
    """Contours of a model: height and vertices (k, 2) in the map grid."""
    from contourpy import contour_generator

    centres = model.centres_m()
    known = np.isfinite(model.height_m)
    low, high = float(model.height_m[known].min()), float(model.height_m[known].max())
    drawn = contour_generator(
        x=centres[0, :, 0], y=centres[:, 0, 1], z=np.ma.masked_array(model.height_m, ~known)
    )
    levels = np.arange(np.ceil(low / interval_m), np.floor(high / interval_m) + 1) * interval_m
    lines: Any = [(float(level), drawn.lines(float(level))) for level in levels]
    return [(level, np.asarray(line)) for level, of_level in lines for line in of_level]


def write_geojson(
    path: Path, model: Dtm, sections: Sequence[Section], river: River, settings: Fusion
) -> None:
    """Contours, thalweg, water line and sections as lines in the campaign's grid."""
    features = [
        _line(line, kind="contour", height_m=level)
        for level, line in contour_lines(model, settings.contour_m)
    ]
    thalweg = np.concatenate([river.to_map([s.s_m], [s.thalweg_m]) for s in sections])
    features.append(_line(thalweg, kind="thalweg"))
    outline = river.outline_m()
    features.append(_line(np.vstack([outline, outline[:1]]), kind="water line"))
    features += [_line(s.places_m[[0, -1]], kind="section", s_m=round(s.s_m, 3)) for s in sections]
    code = model.crs.to_epsg()
    told: dict[str, Any] = {"type": "FeatureCollection"}
    if code:
        told["crs"] = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{code}"}}
    path.write_text(json.dumps(told | {"features": features}))


def _line(places_m: ArrayF, **properties: Any) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": "LineString", "coordinates": np.round(places_m, 3).tolist()},
    }


def write_bag(path: Path, model: Dtm) -> None:
    """Elevation and uncertainty as Bathymetric Attributed Grid (by GDAL's driver).

    Raises
    ------
    InputError : GDAL was built without the driver, or cannot write the file.
    """
    import rasterio
    from rasterio import Affine
    from rasterio.errors import RasterioError
    from rasterio.shutil import copy

    with rasterio.Env() as env:
        able = "BAG" in env.drivers()
    if not able:
        raise InputError(
            "GDAL without the driver BAG", expected="GDAL built with HDF5", where=path,
            cure="Leave bag out of fusion.exports; dtm.tif holds the same heights and sigmas",
        )  # fmt: skip
    nodata, (rows, columns) = 1_000_000.0, model.height_m.shape
    bands = [np.where(np.isfinite(model.height_m), b, nodata) for b in (model.height_m, model.sigma_m)]
    place = Affine(model.cell_m, 0.0, model.corner_m[0], 0.0, -model.cell_m, model.corner_m[1])
    try:
        with rasterio.MemoryFile() as memory:
            with memory.open(
                driver="GTiff", width=columns, height=rows, count=2, dtype="float32", nodata=nodata,
                crs=model.crs.to_wkt(), transform=place,
            ) as file:  # fmt: skip
                for i, band in enumerate(bands, start=1):
                    file.write(band.astype(np.float32), i)
            with memory.open() as file:
                copy(file, str(path), driver="BAG")
    except (RasterioError, OSError) as wrong:
        raise InputError(
            f"cannot be written as BAG ({wrong})", expected="a writable file", where=path
        ) from wrong
