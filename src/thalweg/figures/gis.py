"""Project for QGIS: layers, models and cloud of a campaign in the colours of the figures.

A ``.qgz`` is a zip of one XML file, ``.qgs``. Paths in it are relative to its own folder, and the same
results give the same bytes. It is written in the form of QGIS 3.22 (long-term release); the cloud needs 3.26,
the first that reads COPC.
"""

from collections.abc import Iterable, Iterator
from itertools import pairwise
from os.path import relpath
from pathlib import Path
from typing import Any, Final
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np
from cmcrameri import cm
from jinja2 import Environment
from matplotlib.colors import Colormap, to_hex, to_rgba
from pyproj import CRS

from thalweg.core import ArrayF, final_path, open_raster
from thalweg.figures.style import (
    BLUE,
    DEPTH_MAP,
    HEIGHT_MAP,
    ORANGE,
    PURPLE,
    RED,
    SIGMA_MAP,
    SKY,
    VERMILION,
    robust_limits,
)

_STOPS: Final = 7
"""Colours of a scale, and classes of soundings."""
_VEIL: Final = 0.55
"""Opacity of the colours of the terrain, so that the shaded relief below them is seen."""
_LINES: Final = {
    "track": ("Track of the boat", VERMILION, 0.5, "solid"),
    "thalweg": ("Thalweg", PURPLE, 0.5, "solid"),
    "sections": ("Cross sections", "0.25", 0.3, "solid"),
    "centre_line": ("Centre line", BLUE, 0.3, "dash"),
    "banks": ("Bank lines", BLUE, 0.5, "solid"),
    "contours": ("Contours, height in m", "0.35", 0.2, "solid"),
}
_POINTS: Final = {
    "soundings": "Soundings, height in m",
    "soundings_left_out": "Soundings left out, by reason",
}
_REASON_COLOURS: Final = (RED, ORANGE, PURPLE, SKY, "0.3", VERMILION, BLUE, "black")
_CHANGES: Final = {"erosion": BLUE, "deposition": VERMILION}
_BANDS: Final = (
    ("bed", "height_m", "Riverbed, height in m", DEPTH_MAP.reversed(), 1.0),
    ("bed", "sigma_m", "Riverbed, standard deviation in m", SIGMA_MAP, 1.0),
    ("dtm", "height", "Terrain, height in m", HEIGHT_MAP, _VEIL),
    ("dtm", "sigma", "Terrain, standard deviation in m", SIGMA_MAP, 1.0),
    ("dod", "difference_m", "Change of height in m", cm.vik, 1.0),
    ("dod", "sigma_m", "Change of height, standard deviation in m", SIGMA_MAP, 1.0),
)


def write_gis_project(
    layers: Path, rasters: list[Path], clouds: list[Path], out: Path, title: str, crs: str
) -> None:
    """Write the project.

    Parameters
    ----------
    layers : GeoPackage of the campaign.
    rasters : ``dtm.tif`` and ``bed.tif`` of a survey, or ``dod_<pair>.tif`` of a comparison.
    clouds : in map coordinates, as COPC.
    out : file to write; paths in it are relative to its folder.
    title : of the campaign.
    crs : of the map.
    """
    folder, system = final_path(out).parent, CRS.from_user_input(crs)
    flat = system.sub_crs_list[0] if system.is_compound else system
    shown = [*_vectors(layers), *(_cloud(path, shown=not rasters) for path in clouds)]
    shown += [layer for path in rasters for layer in _grids(path)]
    of_all = [layer["bounds"] for layer in shown if layer["kind"] == "vector" and layer["bounds"] is not None]
    of_all = of_all or [layer["bounds"] for layer in shown if layer["bounds"] is not None][:1]
    extent: Iterable[tuple[str, float]] = ()
    if of_all:
        low, high = np.min(of_all, axis=0)[:2], np.max(of_all, axis=0)[2:]
        margin_m = 0.05 * (high - low)
        extent = zip(("xmin", "ymin", "xmax", "ymax"), (*(low - margin_m), *(high + margin_m)), strict=True)
    for layer in shown:
        path = f"./{Path(relpath(layer['path'], folder)).as_posix()}"
        layer["source"] = f"{path}|layername={layer['name']}" if layer["kind"] == "vector" else path
        layer["id"] = f"thalweg_{layer['name'].replace('-', '_')}"
    template = Path(__file__).with_name("project.qgs.j2").read_text(encoding="utf-8")
    made = Environment(trim_blocks=True, autoescape=True).from_string(template)
    text = made.render(
        title=title,
        wkt=flat.to_wkt(),
        authority=":".join(flat.to_authority(min_confidence=100) or ()),
        extent=extent,
        layers=shown,
        rgb=_rgb,
        stops=_stops,
    )
    with ZipFile(out, "w") as archive:
        entry = ZipInfo(f"{final_path(out).stem}.qgs")
        entry.compress_type = ZIP_DEFLATED
        archive.writestr(entry, text)


def _vectors(path: Path) -> Iterator[dict[str, Any]]:
    """Points and lines, in their order from the uppermost."""
    import geopandas
    import pyogrio

    there = [str(name) for name, _ in pyogrio.list_layers(path)]
    changes = [name for name in there if name.startswith("changes_")]
    for name in [*changes, *(name for name in (*_POINTS, *_LINES) if name in there)]:
        table = geopandas.read_file(path, layer=name)
        if not len(table):
            continue
        bounds = None if name in ("contours", *changes) else table.total_bounds
        layer = {"name": name, "kind": "vector", "provider": "ogr", "path": path, "shown": True}
        layer |= {"geometry": "Line" if name in _LINES else "Point", "bounds": bounds}
        if name in _LINES:
            title, *look = _LINES[name]
            yield layer | {"title": title, "line": look, "label": "height_m" if name == "contours" else ""}
        elif name == "soundings":
            yield layer | {"title": _POINTS[name], "classes": _classes(table.geometry.z.to_numpy())}
        elif name == "soundings_left_out":
            reasons = dict(zip(sorted(table["reason"].unique()), _REASON_COLOURS * 2, strict=False))
            layer |= {"column": "reason", "colours": reasons, "shape": "cross2", "size_mm": 2.0}
            yield layer | {"title": _POINTS[name]}
        else:
            pair = name.removeprefix("changes_").replace("-", " to ")
            layer |= {"column": "what", "colours": _CHANGES, "shape": "diamond", "size_mm": 4.0}
            yield layer | {"title": f"Patches of change, epochs {pair}"}


def _cloud(path: Path, *, shown: bool) -> dict[str, Any]:
    import laspy

    with laspy.open(path) as cloud:
        low, high = np.array(cloud.header.mins), np.array(cloud.header.maxs)
    layer = {"name": "cloud", "kind": "point-cloud", "provider": "copc", "path": path, "shown": shown}
    bounds = np.concatenate([low[:2], high[:2]])
    return layer | {
        "title": "Point cloud, height in m",
        "bounds": bounds,
        "ramp": (HEIGHT_MAP, float(low[2]), float(high[2])),
    }


def _grids(path: Path) -> Iterator[dict[str, Any]]:
    """Bands of a raster, and the relief of the terrain below them."""
    kind, _, pair = path.stem.partition("_")
    with open_raster(path) as file:
        bounds = np.array(file.bounds)
        bands = {name: (i, file.read(i)) for i, name in enumerate(file.descriptions, start=1)}
    layer = {"kind": "raster", "provider": "gdal", "path": path, "bounds": bounds}
    for of, name, title, colours, opacity in _BANDS:
        if of != kind:
            continue
        band, values = bands[name]
        low, high = robust_limits(values[np.isfinite(values)], 1.0, 99.0)
        if name.startswith("difference"):
            high = max(abs(low), abs(high))
            low = -high
        yield layer | {
            "name": f"{path.stem}_{name}",
            "title": f"{title}, epochs {pair.replace('-', ' to ')}" if pair else title,
            "shown": name[:5] != "sigma",
            "band": band,
            "ramp": (colours, low, high),
            "opacity": opacity,
        }
    if kind == "dtm":
        yield layer | {"name": "hillshade", "title": "Terrain, shaded relief", "shown": True}


def _rgb(colour: Any) -> str:
    """A colour of Matplotlib as ``red,green,blue,alpha``."""
    return ",".join(str(round(255 * part)) for part in to_rgba(colour))


def _classes(values: ArrayF) -> list[tuple[float, float, Any]]:
    """A colour for each class of heights; as many soundings in each."""
    edges = np.unique(np.quantile(values, np.linspace(0, 1, _STOPS + 1)).round(2))
    edges[0], edges[-1] = np.floor(100 * values.min()) / 100, np.ceil(100 * values.max()) / 100
    shades = DEPTH_MAP.reversed()(np.arange(len(edges) - 1) / max(len(edges) - 2, 1))
    return [(low, high, shade) for (low, high), shade in zip(pairwise(edges), shades, strict=True)]


def _stops(colours: Colormap, low: float, high: float) -> Iterator[tuple[float, str]]:
    """Values and colours of a continuous scale."""
    for share in np.linspace(0, 1, _STOPS):
        yield low + share * (high - low), to_hex(colours(share))
