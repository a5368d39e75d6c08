"""Points, lines and polygons of a GIS or CAD: the one reader of all that is drawn on a map.

The content of a file tells its format, GDAL reads it (https://gdal.org/drivers/vector). Of GeoJSON, which
GDAL takes for longitude and latitude whatever it says, the member ``crs`` of its edition of 2008 counts.
"""

import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd
from pyproj import CRS
from pyproj.exceptions import CRSError

from thalweg.core import ArrayB, ArrayF, InputError, require_file
from thalweg.core.values.places import accuracy_in_words, check_degrees, check_places, utm_of, way_between
from thalweg.core.values.stated import refuse_depths
from thalweg.core.values.units import units_of_crs

if TYPE_CHECKING:
    from geopandas import GeoDataFrame

VECTOR_ENDINGS: Final = (".gpkg", ".shp", ".geojson", ".json", ".kml", ".gml", ".fgb", ".dxf")
VECTOR_FORMATS: Final = {
    "geojson": "GeoJSON",
    "shapefile": "Shapefile",
    "geopackage": "GeoPackage",
    "kml": "KML",
    "gml": "GML",
    "flatgeobuf": "FlatGeobuf",
    "dxf": "DXF",
}
"""Formats of `read_vectors`, and their names for people."""
_HEAD_BYTES: Final = 65_536
"""By which the format of a file is told."""
_PARTS: Final = (".shx", ".dbf", ".prj", ".cpg", ".sbn", ".sbx", ".qix")
"""Files beside a Shapefile's .shp."""
_DXF: Final = re.compile(rb"\A(?:\s*999\r?\n[^\n]*\n)*\s*0\s+SECTION\s")
_CRS: Final = re.compile(rb'"crs"\s*:\s*\{(?:[^{}]*\{[^{}]*"name"\s*:\s*"([^"]*)")?')
_DXF_UNIT: Final = re.compile(rb"\$INSUNITS\s+70\s+(\d+)")
_UNITS_OF_DXF: Final = {
    1: "inches",
    2: "feet",
    4: "millimetres",
    5: "centimetres",
    7: "kilometres",
    10: "yards",
    14: "decimetres",
    21: "US survey feet",
}
_ALTITUDE_MODE: Final = re.compile(rb"<(?:gx:)?altitudeMode>\s*(\w+)")
_DEGREES: Final = (180.0, 90.0)
_POINT, _LINES, _POLYGON, _FIRST_MULTIPLE = 0, (1, 2), 3, 4
"""Numbers of the types of geometries in shapely."""


def vector_format(head: bytes) -> str | None:
    """The key of `VECTOR_FORMATS` that a file with these first bytes is of, None for others."""
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    if head.startswith(b"\0\0\x27\x0a"):
        # the index of a Shapefile begins alike, but with the place of the first record, not its number
        return None if head[100:104] == b"\0\0\0\x32" else "shapefile"
    if head.startswith(b"SQLite format 3\0"):
        return "geopackage" if head[68:70] == b"GP" or b"gpkg_geometry_columns" in head else None
    if head.startswith(b"fgb\x03fgb"):
        return "flatgeobuf"
    if head.startswith(b"AutoCAD Binary DXF") or _DXF.match(head):
        return "dxf"
    if text[:1] in (b"{", b"["):
        return "geojson"
    if text[:1] == b"<":
        if re.search(rb"<(\w+:)?kml\b", text):
            return "kml"
        return "gml" if b"opengis.net/gml" in text and not re.search(rb"<(\w+:)?schema\b", text) else None
    return None


def is_vector_file(path: Path) -> bool:
    """Whether a file is for `read_vectors`: by its ending, else by its content; ``FILE?layer=NAME`` too."""
    file = _choice(path, None)[0]
    if file.suffix.lower() in (*VECTOR_ENDINGS, ".kmz", *_PARTS):
        return True
    if not file.is_file():
        return False
    return vector_format(_head(file)) is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class Vectors:
    """What a layer of a file has drawn.

    Parameters
    ----------
    path : the file.
    kind : its format, a key of `VECTOR_FORMATS`.
    table : a row for each point, line or polygon; collections are taken apart.
    crs : horizontal coordinate system, None where the file states none.
    notes : what was left out or assumed, a sentence each.
    """

    path: Path
    kind: str
    table: "GeoDataFrame"
    crs: CRS | None
    notes: tuple[str, ...] = ()

    @property
    def frame(self) -> CRS | None:
        """The same as ``crs``."""
        return self.crs

    def usual_map(self) -> CRS | None:
        """The map that a file states, of degrees the zone of UTM in their middle; None: none is stated."""
        import shapely

        if self.crs is not None and not self.crs.is_geographic:
            return self.crs
        xy = shapely.get_coordinates(self.table.geometry)
        degrees = self.crs is not None or (np.abs(xy) <= _DEGREES).all()
        if self.crs is not None:
            xy = shapely.get_coordinates(self.table.to_crs(4326).geometry)
        return utm_of(xy[:, 0], xy[:, 1]) if degrees else None

    def on_map(self, crs: CRS) -> "Vectors":
        """The same on another map.

        Without a stated system, numbers that can be degrees are longitude and latitude in WGS 84 (RFC 7946),
        others, and those of drawings, are taken for places on that map already. All this is noted, except
        that GeoJSON in degrees needs no statement.

        Raises
        ------
        InputError : places that the map does not have.
        """
        import shapely

        source, notes = self.crs, self.notes
        if source is None:
            xy = shapely.get_coordinates(self.table.geometry)
            degrees = self.kind != "dxf" and bool((np.abs(xy) <= _DEGREES).all())
            source = CRS.from_epsg(4326) if degrees else crs
            if source is crs:
                notes += (f"{self.path.name} states no coordinate system: taken for places in {crs.name}",)
            elif self.kind != "geojson":
                notes += (
                    f"{self.path.name} states no coordinate system: taken for degrees of longitude and "
                    "latitude in WGS 84, which the numbers can be",
                )
        xy = shapely.get_coordinates(self.table.geometry)
        if self.crs is not None and source.is_projected:
            check_degrees(xy, where=self.path, cure=f"Correct its coordinate system, now {source.name}")
        degrees = source.is_geographic and bool((np.abs(xy) <= _DEGREES).all())
        if crs.is_projected and (degrees or (self.crs is None and self.kind != "dxf")):
            check_places(xy, crs, where=self.path, degrees=degrees, one_survey=False)
        if source.equals(crs, ignore_axis_order=True):
            return replace(self, crs=crs, notes=notes)
        way = way_between(source, _plane(crs))
        shapes = way and shapely.transform(
            self.table.geometry.to_numpy(),
            lambda xyz: np.column_stack([*way.transform(*xyz.T[:2]), *xyz.T[2:]]),
            include_z=True,
        )
        if way is None or not np.isfinite(shapely.get_coordinates(shapes)).all():
            raise InputError(
                f"places in {source.name} have none in {crs.name}",
                where=self.path,
                expected=f"places in {crs.name}, and a way to it that PROJ knows",
                cure="Look whether its numbers are in the system that it states, and degrees in the order "
                "longitude, latitude; between datums transform it with the grid files of the land survey",
            )
        if source.is_projected or accuracy_in_words(way):
            notes += (
                f"{self.path.name} states {source.name}: its places were transformed to "
                f"{crs.name}{accuracy_in_words(way)}",
            )
        table = self.table.set_geometry(shapes).set_crs(_plane(crs), allow_override=True)
        return replace(self, table=table, crs=crs, notes=notes)

    def lines(self) -> list[tuple[ArrayF, dict[str, Any]]]:
        """Corners (k, 2), or with heights (k, 3), of lines and of the outlines of polygons; properties."""
        import shapely

        rows = self.table[self._of(*_LINES, _POLYGON)]
        shapes = [each.exterior if each.geom_type == "Polygon" else each for each in rows.geometry]
        properties = rows.drop(columns=rows.geometry.name).to_dict("records")
        corners = [shapely.get_coordinates(each, include_z=each.has_z) for each in shapes]
        return list(zip(corners, properties, strict=True))

    def polygons(self) -> list[Any]:
        """Polygons of shapely, with their holes."""
        return list(self.table.geometry[self._of(_POLYGON)])

    def points(self) -> tuple[pd.DataFrame, ArrayF]:
        """Properties of points, and their coordinates (n, 2), or (n, 3) if all have heights."""
        import shapely

        rows = self.table[self._of(_POINT)]
        places = shapely.get_coordinates(
            rows.geometry, include_z=len(rows) > 0 and bool(shapely.has_z(rows.geometry).all())
        )
        return pd.DataFrame(rows.drop(columns=rows.geometry.name)).reset_index(drop=True), places

    def contain(self, points_m: ArrayF) -> ArrayB:
        """Which points (n, 2) lie in a polygon, holes of it left out.

        Raises
        ------
        InputError : no polygon.
        """
        import shapely

        polygons = self.polygons()
        if not polygons:
            raise InputError("no polygon", where=self.path, expected="areas as polygons")
        area = shapely.union_all(polygons)
        shapely.prepare(area)
        return np.asarray(shapely.contains_xy(area, points_m[:, 0], points_m[:, 1]))

    def points_along(self, step_m: float) -> ArrayF:
        """Points (n, 2) along each line from its start, one every ``step_m``; the rest of a line has none."""
        import shapely

        points = [np.empty((0, 2))]
        for corners, _ in self.lines():
            line = shapely.LineString(corners[:, :2])
            along = np.arange(0.0, np.floor(line.length / step_m) * step_m, step_m)
            points.append(shapely.get_coordinates(shapely.line_interpolate_point(line, along)))
        return np.concatenate(points)

    def _of(self, *types: int) -> ArrayB:
        import shapely

        return np.isin(shapely.get_type_id(self.table.geometry), types)


def read_vectors(
    path: Path | str, *, layer: str | None = None, where: Mapping[str, str] | None = None
) -> Vectors:
    """Points, lines and polygons of a file: GeoJSON, Shapefile, GeoPackage, KML, GML, FlatGeobuf, DXF.

    Parameters
    ----------
    path : the file; ``FILE?COLUMN=VALUE,...`` takes only what has these values, ``FILE?layer=NAME`` a layer.
    layer : of several; None: the only one that has geometries.
    where : column -> value that counts, compared as text.

    Raises
    ------
    InputError : no such file, no such format, several layers, no such layer or column, nothing left that can
        be drawn, a coordinate system that is unknown.
    """
    import pyogrio
    import shapely

    path, chosen = _choice(Path(path), where)
    layer = chosen.pop("layer", layer)
    kind = _format_of(path)
    try:
        with warnings.catch_warnings():
            # of GDAL and GEOS about what is counted below
            warnings.simplefilter("ignore", RuntimeWarning)
            source = _source(path, kind)
            layer = _only(path, _layers(source), layer)
            table = pyogrio.read_dataframe(source, layer=layer, datetime_as_string=True)
    except (RuntimeError, ValueError, shapely.errors.ShapelyError) as error:
        raise _unreadable(path, kind, error) from error
    if kind == "dxf":
        # a closed line of a drawing is the outline of an area
        table = table.set_geometry(
            [
                shapely.Polygon(each)
                if each is not None and each.geom_type == "LineString" and each.is_ring
                else each
                for each in table.geometry
            ]
        )
    for name, value in chosen.items():
        if name not in table or name == "geometry":
            names = ", ".join(str(c) for c in table.columns if c != "geometry")
            raise InputError(f"no column {name}", where=path, expected=f"one of {names}")
        # whole numbers with gaps become 7.0
        text = table[name].astype("string").str.removesuffix(".0")
        table = table[(text == value.removesuffix(".0")).fillna(False)]
    table, notes = _simple(table)
    notes += _not_followed(path, kind, table)
    if not len(table):
        raise InputError(
            "nothing that is drawn"
            + (f" with {', '.join(f'{k}={v}' for k, v in chosen.items())}" if chosen else "")
            + "".join(f"; {note}" for note in notes),
            where=path,
            expected="points, lines or polygons whose coordinates are numbers",
            cure="Look at the file in a GIS, and export the layer again",
        )
    crs = _stated(path, kind, table.crs)
    if crs is not None:
        table, notes = _heights_in_metres(table, crs, notes, path)
        crs = _plane(crs)
    return Vectors(
        path=path, kind=kind, table=table.set_crs(crs, allow_override=True), crs=crs, notes=tuple(notes)
    )


def describe_layers(path: Path) -> list[dict[str, Any]]:
    """Layers of a file: name, geometry (its type), n, crs; tables without geometry are left out.

    Raises
    ------
    InputError : see `read_vectors`.
    """
    import pyogrio

    kind = _format_of(path)
    try:
        source = _source(path, kind)
        found = [pyogrio.read_info(source, layer=name, force_feature_count=True) for name in _layers(source)]
    except (RuntimeError, ValueError) as error:
        raise _unreadable(path, kind, error) from error
    out = []
    for of in found:
        crs = _stated(path, kind, of["crs"])
        out.append(
            {
                "name": of["layer_name"],
                "geometry": of["geometry_type"],
                "n": of["features"],
                "crs": "none stated" if crs is None else crs.name,
            }
        )
    return out


def _choice(path: Path, where: Mapping[str, str] | None) -> tuple[Path, dict[str, str]]:
    """A file, and what of it counts by column; a file whose own name holds the mark is taken as it is."""
    chosen = dict(where or {})
    name, mark, rest = str(path).partition("?")
    if not mark or path.exists():
        return path, chosen
    pairs = [part.partition("=")[::2] for part in rest.split(",") if part]
    if not all(value for _, value in pairs):
        raise InputError(
            f"{rest!r} after the name of a file", where=name, expected="COLUMN=VALUE,COLUMN=VALUE"
        )
    return Path(name), chosen | dict(pairs)


def _head(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(_HEAD_BYTES)


def _format_of(path: Path) -> str:
    """The format, by the content. Python opens the file: so a rule sees what the twin keeps from it."""
    require_file(path, "a file of a map")
    head = _head(path)
    kind = vector_format(head)
    if kind is not None:
        return kind
    cure = "Export the layer from a GIS as GeoPackage or GeoJSON"
    if path.suffix.lower() in _PARTS:
        cure = f"Name {path.stem}.shp: this is a part of it"
    elif head.startswith(b"PK\x03\x04"):
        cure = "Unpack it, and name the file inside"
    elif head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        cure = "Save it as UTF-8"
    raise InputError(
        "no format of a map that is known", where=path, expected=", ".join(VECTOR_FORMATS.values()), cure=cure
    )


def _unreadable(path: Path, kind: str, error: Exception) -> InputError:
    told = re.sub(r"\S+\.cpp, \d+: ", "", str(error).partition("; It might help")[0])
    if "not recognized" in told:
        told = f"no {VECTOR_FORMATS[kind]} that is whole"
    cure = "Look at the file in a GIS, and export it again"
    if kind == "shapefile" and not any(path.with_suffix(s).exists() for s in (".shx", ".SHX")):
        told, cure = "its index (.shx) is missing", "Copy the files of the same name beside it too"
    elif isinstance(error, UnicodeDecodeError):
        told, cure = f"text that is no {error.encoding}", "Save its text as UTF-8"
    return InputError(told, where=path, expected=f"a {VECTOR_FORMATS[kind]}", cure=cure)


def _source(path: Path, kind: str) -> Path | bytes:
    """What GDAL opens: the file, or of GML its content, as it would write another file beside it."""
    return path.read_bytes() if kind == "gml" else path


def _layers(source: Path | bytes) -> list[str]:
    """Layers with geometries."""
    import pyogrio

    return [str(name) for name, geometry in pyogrio.list_layers(source) if geometry is not None]


def _only(path: Path, names: list[str], layer: str | None) -> str:
    """The layer that is asked for, or the only one."""
    if layer is None and len(names) == 1:
        return names[0]
    if layer in names:
        return str(layer)
    raise InputError(
        f"no layer {layer}" if layer is not None else f"{len(names)} layers with geometries",
        where=path,
        expected=f"one of {', '.join(names)}" if names else "a layer of points, lines or polygons",
        cure=f"Name it: {path.name}?layer={names[0]}" if names else "Export the layer again",
    )


def _simple(table: Any) -> tuple[Any, list[str]]:
    """Single points, lines and valid polygons, each with coordinates; what was left out or mended."""
    import shapely

    notes = []

    def lose(which: ArrayB, words: str) -> None:
        """Leave rows out, and count them."""
        nonlocal table
        if which.any():
            notes.append(f"{int(which.sum()):,} {words}, left out")
            table = table[~which]

    lose(np.asarray(table.geometry.isna() | table.geometry.is_empty), "without a geometry")
    while (shapely.get_type_id(table.geometry) >= _FIRST_MULTIPLE).any():
        table = table.explode(ignore_index=True)
    table = table[~table.geometry.is_empty]
    coordinates, of = shapely.get_coordinates(table.geometry, return_index=True)
    broken = np.bincount(of[~np.isfinite(coordinates).all(axis=1)], minlength=len(table)) > 0
    lose(broken, "with coordinates that are no numbers")
    lose(shapely.get_type_id(table.geometry) > _POLYGON, "of another kind than points, lines, polygons")
    wrong = np.asarray(~table.geometry.is_valid & (shapely.get_type_id(table.geometry) == _POLYGON))
    if wrong.any():
        reason = shapely.is_valid_reason(table.geometry[wrong].iloc[0])
        notes.append(f"{int(wrong.sum()):,} polygons with a wrong outline ({reason}), mended")
        shapes = table.geometry.to_numpy().copy()
        shapes[wrong] = shapely.make_valid(shapes[wrong], method="structure", keep_collapsed=False)
        table = table.set_geometry(shapes).explode(ignore_index=True)
        lose(np.asarray(table.geometry.is_empty), "polygons without an area")
    return table.reset_index(drop=True), notes


def _not_followed(path: Path, kind: str, table: Any) -> list[str]:
    """Statements of a KML about its heights, and of a drawing about its unit, that programs seldom mean."""
    if kind == "dxf" and (found := _DXF_UNIT.search(_head(path))) and int(found[1]) in _UNITS_OF_DXF:
        return [
            f"the drawing states its unit as {_UNITS_OF_DXF[int(found[1])]} ($INSUNITS): metres are taken"
        ]
    if kind == "kml" and table.has_z.any():
        modes = {mode.decode() for mode in _ALTITUDE_MODE.findall(path.read_bytes())} or {"clampToGround"}
        if modes != {"absolute"}:
            return [f"heights have the altitudeMode {', '.join(sorted(modes))}: taken as they stand"]
    return []


def _stated(path: Path, kind: str, crs: Any) -> CRS | None:
    """The coordinate system that a file states."""
    if kind == "geojson":
        found = _CRS.search(path.read_bytes())
        if found is None:
            return None
        crs = crs if found[1] is None else found[1].decode(errors="replace")
    try:
        known = None if crs is None else CRS.from_user_input(crs)
    except CRSError as error:
        raise InputError(
            f"the coordinate system {crs} is not known",
            where=path,
            expected="one of the EPSG registry",
            cure="Assign the layer its coordinate system in a GIS, and export it again",
        ) from error
    # a grid of a site has no relation to a map
    return None if known is None or known.is_engineering else known


def _plane(crs: CRS) -> CRS:
    """The horizontal part."""
    return crs.sub_crs_list[0] if crs.is_compound else crs.to_2d()


def _heights_in_metres(table: Any, crs: CRS, notes: list[str], path: Path) -> tuple[Any, list[str]]:
    """Heights in metres where the file states another unit; a note if it states none beside a map in feet."""
    import shapely

    if not shapely.has_z(table.geometry).any():
        return table, notes
    refuse_depths(crs, path)
    across, up = units_of_crs(crs)
    if up is not None and not up.is_metre:
        shapes = shapely.force_3d(table.geometry.to_numpy())
        metres = shapely.transform(shapes, lambda xyz: xyz * (1.0, 1.0, up.metres), include_z=True)
        return table.set_geometry(metres), [
            *notes,
            f"heights in {up.name}, as the file states: turned into metres",
        ]
    if up is None and across is not None and not across.is_metre:
        notes = [*notes, f"heights without a stated unit beside a map in {across.name}: taken for metres"]
    return table, notes
