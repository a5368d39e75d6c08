"""Project for QGIS: layers, models and cloud of a campaign in the colours of the figures.

A ``.qgz`` is a zip of one XML file, ``.qgs``. Paths in it are relative to its own folder, and the same
results give the same bytes. It is written in the form of QGIS 3.22 (long-term release); the cloud needs 3.26,
the first that reads COPC.
"""

from itertools import pairwise
from os.path import relpath
from pathlib import Path
from typing import Any, Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np
from cmcrameri import cm
from matplotlib.colors import Colormap, to_rgba
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
    project = _Project(final_path(out).parent, CRS.from_user_input(crs), title)
    project.add_vectors(layers)
    for path in clouds:
        project.add_cloud(path, shown=not rasters)
    for path in rasters:
        project.add_raster(path)
    indent(project.root)
    text = b"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n" + tostring(project.root)
    with ZipFile(out, "w") as archive:
        entry = ZipInfo(f"{final_path(out).stem}.qgs")
        entry.compress_type = ZIP_DEFLATED
        archive.writestr(entry, text)


class _Project:
    """The XML of a project; layers are added from the uppermost to the lowest one."""

    def __init__(self, folder: Path, crs: CRS, title: str) -> None:
        self.folder, self.crs = folder, crs
        self.root = Element("qgis", projectname=title, version="3.22.16")
        _text(self.root, "title", title)
        self._add_crs(SubElement(self.root, "projectCrs"))
        self.tree = SubElement(self.root, "layer-tree-group")
        canvas = SubElement(self.root, "mapcanvas", name="theMapCanvas")
        _text(canvas, "units", "meters")
        self.extent = SubElement(canvas, "extent")
        self._add_crs(SubElement(canvas, "destinationsrs"))
        self.layers = SubElement(self.root, "projectlayers")
        properties = SubElement(self.root, "properties")
        _text(SubElement(properties, "Paths"), "Absolute", "false", type="bool")
        # without it QGIS does not read the system of the project
        _text(SubElement(properties, "SpatialRefSys"), "ProjectionsEnabled", "1", type="int")
        self.bounds = np.array([np.inf, np.inf, -np.inf, -np.inf])

    def add_vectors(self, path: Path) -> None:
        """Layers of a GeoPackage, points above lines."""
        import geopandas
        import pyogrio

        there = [str(name) for name, _ in pyogrio.list_layers(path)]
        changes = [name for name in there if name.startswith("changes_")]
        for name in [*changes, *(name for name in (*_POINTS, *_LINES) if name in there)]:
            table = geopandas.read_file(path, layer=name)
            if not len(table):
                continue
            if name not in ("contours", *changes):  # patches are a part of what was compared
                self._view(table.total_bounds)
            source = f"{self._relative(path)}|layername={name}"
            if name in _LINES:
                title, colour, width_mm, dash = _LINES[name]
                layer = self._add(name, title, "vector", "ogr", source, geometry="Line")
                look = {"line_color": _rgb(colour), "line_width": str(width_mm), "line_style": dash}
                _symbol(SubElement(_renderer(layer, "singleSymbol"), "symbols"), "line", 0, look)
                if name == "contours":
                    _label(layer, "height_m")
                continue
            pair = name.removeprefix("changes_").replace("-", " to ")
            title = _POINTS.get(name, f"Patches of change, epochs {pair}")
            layer = self._add(name, title, "vector", "ogr", source, geometry="Point")
            if name == "soundings":
                _graduated(layer, "height", table.geometry.z.to_numpy())
            elif name == "soundings_left_out":
                reasons = dict(zip(sorted(table["reason"].unique()), _REASON_COLOURS * 2, strict=False))
                _categorized(layer, "reason", reasons, "cross2", 2.0)
            else:
                _categorized(layer, "what", _CHANGES, "diamond", 4.0)

    def add_cloud(self, path: Path, *, shown: bool) -> None:
        """A cloud in COPC, coloured by height."""
        import laspy

        with laspy.open(path) as cloud:
            low, high = np.array(cloud.header.mins), np.array(cloud.header.maxs)
        self._view(np.concatenate([low[:2], high[:2]]), only_first=True)
        layer = self._add(
            "cloud", "Point cloud, height in m", "point-cloud", "copc", self._relative(path), shown=shown
        )
        look = SubElement(
            layer, "renderer", type="ramp", attribute="Z", min=f"{low[2]:.3f}", max=f"{high[2]:.3f}",
            pointSize="0.6", pointSizeUnit="MM", maximumScreenError="0.3", maximumScreenErrorUnit="MM",
        )  # fmt: skip
        _ramp(look, HEIGHT_MAP, float(low[2]), float(high[2]))

    def add_raster(self, path: Path) -> None:
        """The bands of a model: height, its standard deviation (not shown at first), and a shaded relief."""
        kind = path.stem.partition("_")[0]
        pair = path.stem.partition("_")[2].replace("-", " to ")
        with open_raster(path) as file:
            self._view(np.array(file.bounds), only_first=True)
            bands = {name: (i, file.read(i)) for i, name in enumerate(file.descriptions, start=1)}
        for of, name, title, colours, opacity in _BANDS:
            if of != kind:
                continue
            band, values = bands[name]
            low, high = robust_limits(values[np.isfinite(values)], 1.0, 99.0)
            if name.startswith("difference"):
                high = max(abs(low), abs(high))
                low = -high
            title = f"{title}, epochs {pair}" if pair else title
            renderer = self._add_grid(f"{path.stem}_{name}", title, path, shown=name[:5] != "sigma")
            renderer.set("opacity", str(opacity))
            renderer.attrib.update(type="singlebandpseudocolor", band=str(band))
            renderer.attrib.update(classificationMin=f"{low:.4f}", classificationMax=f"{high:.4f}")
            _ramp(SubElement(renderer, "rastershader"), colours, low, high)
        if kind == "dtm":
            renderer = self._add_grid("hillshade", "Terrain, shaded relief", path)
            renderer.attrib.update(type="hillshade", band="1", azimuth="315", angle="45", zfactor="1")
            renderer.set("multidirection", "1")
            # shaded between the cells' centres: each cell by itself would be flat with a dark rim
            pipe = self.layers[-1].find("pipe")
            assert pipe is not None
            smooth = {"enabled": "true", "zoomedInResamplingMethod": "bilinear", "maxOversampling": "2"}
            SubElement(SubElement(pipe, "provider"), "resampling", smooth)
            _text(pipe, "resamplingStage", "provider")

    def _add_grid(self, name: str, title: str, path: Path, *, shown: bool = True) -> Element:
        """A layer of a raster; its renderer, still without a type."""
        layer = self._add(name, title, "raster", "gdal", self._relative(path), shown=shown)
        return SubElement(SubElement(layer, "pipe"), "rasterrenderer", opacity="1", alphaBand="-1")

    def _add(
        self, name: str, title: str, kind: str, provider: str, source: str, *, shown: bool = True, **more: str
    ) -> Element:
        """A layer below all others, in the legend and on the map."""
        identity = f"thalweg_{name.replace('-', '_')}"
        SubElement(
            self.tree, "layer-tree-layer", id=identity, name=title, providerKey=provider, source=source,
            checked="Qt::Checked" if shown else "Qt::Unchecked", expanded="1" if shown else "0",
        )  # fmt: skip
        layer = SubElement(self.layers, "maplayer", {"type": kind} | more)
        _text(layer, "id", identity)
        _text(layer, "datasource", source)
        _text(layer, "layername", title)
        self._add_crs(SubElement(layer, "srs"))
        _text(layer, "provider", provider)
        return layer

    def _add_crs(self, parent: Element) -> None:
        """The plane of the map; heights have no part in where things are drawn."""
        flat = self.crs.sub_crs_list[0] if self.crs.is_compound else self.crs
        system = SubElement(parent, "spatialrefsys")
        _text(system, "wkt", flat.to_wkt())
        if authority := flat.to_authority(min_confidence=100):
            _text(system, "authid", ":".join(authority))

    def _view(self, bounds: ArrayF, *, only_first: bool = False) -> None:
        """The first view shows soundings, track, banks and sections; rasters only without those."""
        if only_first and np.isfinite(self.bounds).all():
            return
        self.bounds[:2] = np.minimum(self.bounds[:2], bounds[:2])
        self.bounds[2:] = np.maximum(self.bounds[2:], bounds[2:])
        self.extent.clear()
        margin_m = 0.05 * (self.bounds[2:] - self.bounds[:2])
        view = np.concatenate([self.bounds[:2] - margin_m, self.bounds[2:] + margin_m])
        for name, value in zip(("xmin", "ymin", "xmax", "ymax"), view, strict=True):
            _text(self.extent, name, f"{value:.3f}")

    def _relative(self, path: Path) -> str:
        return f"./{Path(relpath(path, self.folder)).as_posix()}"


def _text(parent: Element, tag: str, text: str, **attributes: str) -> None:
    SubElement(parent, tag, attributes).text = text


def _rgb(colour: Any) -> str:
    """A colour of Matplotlib as ``red,green,blue,alpha``."""
    return ",".join(str(round(255 * part)) for part in to_rgba(colour))


def _renderer(layer: Element, kind: str, **attributes: str) -> Element:
    return SubElement(layer, "renderer-v2", {"type": kind} | attributes)


def _symbol(symbols: Element, kind: str, name: int, look: dict[str, str]) -> None:
    """A symbol of one layer of `kind`: line or marker."""
    symbol = SubElement(symbols, "symbol", type=kind, name=str(name), alpha="1")
    layer = SubElement(symbol, "layer", {"class": f"Simple{kind.title()}", "enabled": "1", "pass": "0"})
    for key, value in look.items():
        SubElement(layer, "prop", k=key, v=value)


def _marker(shape: str, colour: Any, size_mm: float, *, rim: bool = False) -> dict[str, str]:
    """Look of a marker; without a rim its outline has its own colour, as crosses need."""
    outline = _rgb("0.2" if rim else colour)
    return {
        "name": shape, "color": _rgb(colour), "outline_color": outline, "size": str(size_mm),
        "outline_width": "0.1" if rim else "0.4",
    }  # fmt: skip


def _categorized(layer: Element, column: str, colours: dict[str, str], shape: str, size_mm: float) -> None:
    """A colour for each word of a column."""
    renderer = _renderer(layer, "categorizedSymbol", attr=column)
    categories, symbols = SubElement(renderer, "categories"), SubElement(renderer, "symbols")
    for i, (word, colour) in enumerate(colours.items()):
        SubElement(categories, "category", symbol=str(i), value=word, label=word, render="true")
        _symbol(symbols, "marker", i, _marker(shape, colour, size_mm, rim=shape == "diamond"))


def _graduated(layer: Element, quantity: str, values: ArrayF) -> None:
    """A colour for each class of heights; as many soundings in each."""
    edges = np.unique(np.quantile(values, np.linspace(0, 1, _STOPS + 1)).round(2))
    edges[0], edges[-1] = np.floor(100 * values.min()) / 100, np.ceil(100 * values.max()) / 100
    renderer = _renderer(layer, "graduatedSymbol", attr="z($geometry)", graduatedMethod="GraduatedColor")
    ranges, symbols = SubElement(renderer, "ranges"), SubElement(renderer, "symbols")
    for i, (low, high) in enumerate(pairwise(edges)):
        label = f"{low:.2f} to {high:.2f}"
        SubElement(
            ranges, "range", lower=str(low), upper=str(high), symbol=str(i), label=label, render="true"
        )
        colour = DEPTH_MAP.reversed()(i / max(len(edges) - 2, 1))
        _symbol(symbols, "marker", i, _marker("circle", colour, 2.0, rim=True))


def _ramp(parent: Element, colours: Colormap, low: float, high: float) -> None:
    """A continuous scale of colours."""
    shader = SubElement(
        parent, "colorrampshader", colorRampType="INTERPOLATED", classificationMode="2", clip="0",
        minimumValue=f"{low:.4f}", maximumValue=f"{high:.4f}",
    )  # fmt: skip
    for share in np.linspace(0, 1, _STOPS):
        red, green, blue = (round(255 * part) for part in colours(share)[:3])
        value = low + share * (high - low)
        SubElement(
            shader, "item", value=f"{value:.4f}", label=f"{value:.2f}", alpha="255",
            color=f"#{red:02x}{green:02x}{blue:02x}",
        )  # fmt: skip


def _label(layer: Element, column: str) -> None:
    """Numbers on lines, with a white rim."""
    layer.set("labelsEnabled", "1")
    settings = SubElement(SubElement(layer, "labeling", type="simple"), "settings")
    style = SubElement(settings, "text-style", fieldName=column, fontSize="7", textColor=_rgb("0.25"))
    SubElement(style, "text-buffer", bufferDraw="1", bufferSize="0.7", bufferColor=_rgb("white"))
    SubElement(settings, "placement", placement="2", placementFlags="9")
