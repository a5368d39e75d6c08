"""Rasters of heights, of this pipeline and of others, read and written by rasterio.

Ours have named bands in cloud-optimised GeoTIFF. Those of others may have any unit, scale, order of rows and
value for "no height": `read_dsm` brings them to metres from north to south, and says what it did.
"""

import re
import struct
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from PIL import TiffImagePlugin
from pyproj import CRS
from pyproj.crs import CompoundCRS
from pyproj.exceptions import CRSError
from scipy.ndimage import binary_dilation, map_coordinates

from thalweg.core.errors import GeometryError, InputError, UnsupportedError, require_file
from thalweg.core.geometry import TriangleMesh
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI
from thalweg.core.values import (
    HIGHEST_M,
    HUGE,
    LOWEST_M,
    Unit,
    check_degrees,
    check_stated,
    crs_of_geokeys,
    far_repeated,
    is_nothing,
    unit_in_words,
    unit_of_word,
    units_of_crs,
    utm_of,
)

MOST_CELLS: Final = 400_000_000
"""Of a raster: 3 GB of numbers, several times while it is worked on."""
_PROJECTED, _GEO_KEYS = 3072, 34735
_LEAST_ZEROS: Final = 10
_SAMPLE: Final = 1000
"""Rows by which the usual heights of a raster are told."""
_MIXED, _FAR = 0.05, 500.0
"""Share of a value for no height that tells a mixture from a height, and how far it is from them at least."""
_NAMED_BANDS: Final = (("height_m", "sigma_m", "sigma_common_m"), ("height", "sigma", "sigma_common"))
"""Of ``bed.tif`` and of ``dtm.tif``: height, standard deviation, its part that all heights share."""
_HEIGHT: Final = re.compile(
    r"\b(heights?|elevations?|altitudes?|z|dem|dsm|dtm|dgm|bathymetry)\b", re.IGNORECASE
)
_OTHER: Final = re.compile(
    r"(?i:\b(?:slope|aspect|hillshade|shade|std ?dev|stdev|std|sigma|uncertainty|error|count|density|"
    r"intensity|roughness|difference|dod)\b)"
)
"""What GIS make of heights, by the names of bands."""
_OF_HEIGHTS: Final = re.compile(rf"{_OTHER.pattern}(?: of\b| from\b| in\b|(?: \w\w?)? *(?:;|$))")
"""The same beside a word for heights: elevation error, sigma of height (m), but not slope-corrected dem."""
_DEPTH: Final = re.compile(r"(?i)(?<!bit )(?:^|_|\b)(?:depth|(?:wasser)?tiefe|profond|profundi|diepte)")
_TAGS_OF_NAMES: Final = ("long_name", "standard_name", "netcdf_varname", "tifftag_imagedescription")
_UNIT_TAG: Final = re.compile(r"(?:(?:vertical|vert|z|elevation|height|dem)_?)?units?")
_IN_BRACKETS: Final = re.compile(r"[\[(]([^\])]+)[\])]\s*$")


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """Cells of a raster, from north to south and west to east.

    Parameters
    ----------
    west_m, north_m : outer corner of the first cell, on the map.
    cell_m : width and height of a cell.
    rows, columns : their numbers.
    crs : of the map.
    """

    west_m: float
    north_m: float
    cell_m: float
    rows: int
    columns: int
    crs: CRS

    @classmethod
    def around(cls, places_m: ArrayF, cell_m: float, crs: CRS, *, margin_m: float = 0.0) -> Self:
        """Cells at whole multiples of their width about places (n, 2).

        Raises
        ------
        GeometryError : more than 400 million cells.
        """
        low, high = places_m.min(axis=0) - margin_m, places_m.max(axis=0) + margin_m
        first, last = np.floor(low / cell_m), np.ceil(high / cell_m)
        columns, rows = (last - first).astype(np.int64).tolist()
        if rows * columns > MOST_CELLS:
            raise GeometryError(
                f"{columns} by {rows} cells of {cell_m:g} m",
                expected="at most 400 million",
                cure="Choose larger cells, or look for a place far away from the others",
            )
        return cls(
            west_m=float(first[0] * cell_m),
            north_m=float(last[1] * cell_m),
            cell_m=cell_m,
            rows=max(rows, 1),
            columns=max(columns, 1),
            crs=crs,
        )

    def centres_m(self) -> ArrayF:
        """Centres (rows * columns, 2) of the cells, row by row."""
        east = self.west_m + (np.arange(self.columns) + 0.5) * self.cell_m
        north = self.north_m - (np.arange(self.rows) + 0.5) * self.cell_m
        return np.column_stack([np.tile(east, self.rows), np.repeat(north, self.columns)])

    def at(self, places_m: ArrayF) -> tuple[ArrayI, ArrayI]:
        """Row and column (n,) of places (n, 2); -1 outside."""
        column = np.floor((places_m[:, 0] - self.west_m) / self.cell_m)
        row = np.floor((self.north_m - places_m[:, 1]) / self.cell_m)
        inside = (row >= 0) & (row < self.rows) & (column >= 0) & (column < self.columns)
        return np.where(inside, row, -1).astype(np.int64), np.where(inside, column, -1).astype(np.int64)


def write_raster(
    path: Path, grid: Grid, bands: Mapping[str, AnyArray], *, tags: Mapping[str, str] | None = None
) -> None:
    """Write bands (rows, columns) as float32, NaN where there is no value; same values, same bytes."""
    import rasterio

    with rasterio.open(
        path,
        "w",
        driver="COG",
        height=grid.rows,
        width=grid.columns,
        count=len(bands),
        dtype="float32",
        crs=grid.crs.to_wkt(),
        transform=rasterio.Affine(grid.cell_m, 0.0, grid.west_m, 0.0, -grid.cell_m, grid.north_m),
        nodata=float("nan"),
        compress="deflate",
        predictor="yes",
        overview_resampling="nearest",
        num_threads=1,
    ) as out:
        for k, (name, values) in enumerate(bands.items(), 1):
            out.write(np.asarray(values, dtype=np.float32).reshape(grid.rows, grid.columns), k)
            out.set_band_description(k, name)
        out.update_tags(**(tags or {}))


@contextmanager
def open_raster(path: Path, *, whole: bool = True) -> Iterator[Any]:
    """A raster of any format of GDAL, open for reading; whatever fails within the block is told of the file.

    Parameters
    ----------
    whole : bands are read at once, which needs memory for all cells.

    Raises
    ------
    InputError : no such file, no raster, a damaged one, or more cells than are read at once: some hundred
        bytes can stand for thousands of millions.
    """
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    require_file(path, "a GeoTIFF")
    try:
        with warnings.catch_warnings(), rasterio.Env(GTIFF_REPORT_COMPD_CS=True):
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as file:
                if whole and file.width * file.height > MOST_CELLS:
                    raise InputError(
                        f"{file.width:,} by {file.height:,} cells",
                        expected=f"at most {MOST_CELLS // 1_000_000} million at once",
                        where=path,
                        cure="Cut out the survey (gdal_translate -projwin), or make the cells larger (-tr)",
                    )
                yield file
    except (RasterioError, CRSError) as error:
        raise InputError(
            f"no raster that can be read ({error})",
            expected="a GeoTIFF that is whole",
            where=path,
            cure="Export it again (one band of heights as 32-bit numbers), or copy it again from its source",
        ) from error


def read_raster(path: Path) -> tuple[Grid, dict[str, ArrayF], dict[str, str]]:
    """Grid, bands by name (``band 1``, ... where they have none) with NaN for nodata, and tags.

    Raises
    ------
    InputError : no raster, no CRS, a raster that is turned, or cells that are not square.
    """
    with open_raster(path) as file:
        t = file.transform
        if file.crs is None or t.b != 0 or t.d != 0 or abs(t.a + t.e) > 1e-9 * t.a:
            crs = None if file.crs is None else CRS.from_wkt(file.crs.to_wkt()).name
            raise InputError(
                f"a raster with CRS {crs} and transform {tuple(t)[:6]}",
                where=path,
                expected="a CRS, and square cells whose rows run from north to south",
            )
        grid = Grid(
            west_m=t.c,
            north_m=t.f,
            cell_m=t.a,
            rows=file.height,
            columns=file.width,
            crs=CRS.from_wkt(file.crs.to_wkt()),
        )
        values: Any = file.read(masked=True).astype(np.float64).filled(np.nan)
        names = [name or f"band {k}" for k, name in enumerate(file.descriptions, 1)]
        return grid, dict(zip(names, values, strict=True)), dict(file.tags())


# ---------------------------------------------------------------- heights of others


@dataclass(frozen=True, slots=True)
class Dsm:
    """A raster of heights, metres.

    Attributes
    ----------
    height_m : (rows, columns) from north to south and west to east; NaN where there is no height.
    corner_m : (2,) east and north of the outer corner of the first cell.
    cell_m : (2,) width (east) and height (north) of a cell, both positive.
    frame : coordinate system of the map and, where it is stated, of the heights; None where the file states
        none.
    notes : what was masked on reading, with counts, and converted.
    sigma_m : (rows, columns) standard deviation of each height, where a band holds it (a kriged bed).
    common_m : (rows, columns) its part that all heights of the raster share, in addition to ``sigma_m``.
    """

    height_m: ArrayF
    corner_m: ArrayF
    cell_m: ArrayF
    frame: CRS | None
    path: Path
    notes: tuple[str, ...] = ()
    sigma_m: ArrayF | None = None
    common_m: ArrayF | None = None

    @property
    def cell_area_m2(self) -> float:
        """Area of a cell on the map."""
        return float(self.cell_m[0] * self.cell_m[1])

    def axes_m(self) -> tuple[ArrayF, ArrayF]:
        """East (columns,) and north (rows,) of the centres of cells."""
        rows, columns = self.height_m.shape
        east = self.corner_m[0] + (np.arange(columns) + 0.5) * self.cell_m[0]
        return east, self.corner_m[1] - (np.arange(rows) + 0.5) * self.cell_m[1]

    def centres_m(self) -> ArrayF:
        """Centres (rows * columns, 2) of all cells, row by row."""
        east, north = self.axes_m()
        return np.column_stack([np.tile(east, len(north)), np.repeat(north, len(east))])

    def points_m(self) -> ArrayF:
        """Centres (n, 3) of the cells that have a height, row by row."""
        points = np.column_stack([self.centres_m(), self.height_m.ravel()])
        return points[np.isfinite(points[:, 2])]

    def mesh(self, sigma_m: float = 0.0) -> TriangleMesh:
        """Triangles between the centres of neighbouring cells, two for each four, facing up."""
        number = np.full(self.height_m.shape, -1)
        known = np.isfinite(self.height_m)
        number[known] = np.arange(known.sum())
        nw, ne, sw, se = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
        faces = np.concatenate(
            [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((nw, sw, ne), (ne, sw, se))]
        )
        points = self.points_m()
        return TriangleMesh(
            vertices_m=points, faces=faces[(faces >= 0).all(axis=1)], sigma_m=np.full(len(points), sigma_m)
        )

    def places(self, points_m: ArrayF) -> ArrayF:
        """Row and column (n, 2) of points (n, 2) in the raster; whole numbers are centres of cells."""
        east, north = ((points_m - self.corner_m) * (1.0, -1.0) / self.cell_m - 0.5).T
        return np.column_stack([north, east])

    def at(self, points_m: ArrayF, how: str = "nearest") -> ArrayF:
        """Heights (n,) at points (n, 2): of the cell that holds each, or bilinear between four known ones."""
        place = self.places(points_m)
        if how == "bilinear":
            return np.asarray(map_coordinates(self.height_m, place.T, order=1, cval=np.nan))
        row, col = np.floor(place + 0.5).astype(np.int64).T
        rows, columns = self.height_m.shape
        within = (row >= 0) & (row < rows) & (col >= 0) & (col < columns)
        heights = np.full(len(points_m), np.nan)
        heights[within] = self.height_m[row[within], col[within]]
        return heights


def read_dsm(path: Path, *, nodata: float | None = None) -> Dsm:
    """Heights of a GeoTIFF in metres: unit, scale and offset of the band and units of the map applied.

    A raster with bands of heights and standard deviations (``bed.tif``, ``dtm.tif`` of this pipeline) gives
    both.

    Cells with the declared value for "no height", outside of the mask of the file, NaN, or a value that only
    stands for that (-9999, -32768, ...) have none; how many is told in the notes. A value that may be either
    is refused: exact zeros in ten cells or more, and heights that no place on Earth has.

    Parameters
    ----------
    nodata : value without a height, beside a declared one; NaN says that all that is left are heights.

    Raises
    ------
    InputError : no such file, no raster, no place on the map, no heights, or values that may be none.
    UnsupportedError : several bands of which none is called height, a turned raster, degrees, or an
        unknown unit.
    """
    require_file(path, "a GeoTIFF of heights")
    with open_raster(path) as file:
        return _heights(file, path, nodata)


def _heights(file: Any, path: Path, nodata: float | None) -> Dsm:
    corner, cell, flipped = _placement(file, path)
    names = [name or "" for name in file.descriptions]
    ours = next((each for each in _NAMED_BANDS if set(each[:2]) <= set(names)), None)
    number = names.index(ours[0]) + 1 if ours else _height_band(file, names, path)
    keys = _geo_keys(path)
    crs = CRS.from_wkt(file.crs.to_wkt()) if file.crs else None
    tags = {key.lower(): value for key, value in (file.tags() | file.tags(number)).items()}
    tagged = next((tags[key] for key in sorted(tags) if _UNIT_TAG.fullmatch(key)), None)
    up = _unit_of_band(file.units[number - 1] or tagged or _old_unit(path), names[number - 1], path)
    words = _names(file, number)
    if "down" in tags.get("positive", "").lower() or any(_DEPTH.search(w) for w in words):
        raise UnsupportedError(
            f"depths ({'; '.join(filter(None, words)) or 'positive down'})",
            expected="heights, positive upwards", where=path,
            cure="Change their sign, and call the band height, in a GIS or by gdal_calc",
        )  # fmt: skip
    up = up or next((unit for each in words if (unit := unit_in_words(each)) is not None), None)
    of_crs = None if crs is None else units_of_crs(crs)[1]
    if up is not None and of_crs is not None and abs(up.metres / of_crs.metres - 1.0) > 1e-9:
        raise InputError(
            f"heights in {up.plural} by the band, in {of_crs.plural} by the coordinate system",
            expected="one unit",
            where=path,
            cure="Correct the one that is wrong (gdal_edit)",
        )
    # without the type of the model GDAL passes degrees over
    stated = crs_of_geokeys(keys, crs=crs, up=up, where=path)
    if stated.crs is None and _PROJECTED in keys[4::4]:
        raise UnsupportedError(
            "a coordinate system without EPSG code or parameters", expected="one that GDAL knows", where=path,
            cure="Export the raster with the EPSG code of its coordinate system",
        )  # fmt: skip
    if stated.crs is None:
        check_degrees(
            corner + cell * np.array([[0.0, 0.0], [file.width, -file.height]]),
            where=path,
            cure="State its coordinate system (gdal_edit -a_srs), and transform it with gdalwarp",
        )
    elif stated.crs.is_geographic:
        middle = (corner + 0.5 * cell * (file.width, -file.height))[:, None]
        raise UnsupportedError(
            "cells in degrees", expected="a projected coordinate system in metres", where=path,
            cure="Transform the raster to a map projection: gdalwarp -r bilinear -t_srs "
            f"EPSG:{utm_of(middle[0], middle[1]).to_epsg()} {path.name} in_metres.tif",
        )  # fmt: skip
    else:
        corners = corner + cell * np.array([[0.0, 0.0], [file.width, -file.height]])
        check_stated(corners * stated.factors[:2], stated.crs, where=path)
    scale, offset = float(file.scales[number - 1]), float(file.offsets[number - 1])
    metres = stated.factors[2]
    raw = file.read(number)
    values, notes = mask_missing(
        raw.astype(np.float64),
        path,
        "cells",
        nodata=nodata,
        declared=file.nodatavals[number - 1],
        also=_outside_of_mask(file, number),
        of_type=raw.dtype,
        # of whole numbers zero is one among others where there are ones and twos; ours have no such gaps
        zeros=ours is None and (raw.dtype.kind == "f" or not np.isin(raw, (-2, -1, 1, 2)).any()),
        to_metres=(scale * metres, offset * metres),
    )
    said = list(stated.notes)
    if (scale, offset) != (1.0, 0.0):
        said.append(f"Heights are the numbers of the file times {scale:g} plus {offset:g}, as it states.")
    if ours is None and "bathy" in names[number - 1].lower() and np.nanmedian(values) > 0.0:
        said.append(f"Positive values of {names[number - 1]!r} are taken as heights, not as depths.")
    if file.count > 1 and ours is None:
        said.append(
            f"Band {number} ({names[number - 1] or 'without a name'}) of {file.count} holds the heights."
        )

    def turned(band: ArrayF) -> ArrayF:
        """Rows from north to south, columns from west to east."""
        return np.ascontiguousarray(band[:: -1 if flipped[1] else 1, :: -1 if flipped[0] else 1])

    bands: list[ArrayF | None] = [None, None]
    if ours:
        known = np.isfinite(values)
        stated_crs, said = _with_heights(stated.crs, file.tags().get("heights", "ellipsoidal"), path), []
        for k, name in enumerate(ours[1:]):
            if name in names:
                band = file.read(names.index(name) + 1, masked=True).astype(np.float64).filled(np.nan)
                bands[k] = turned(np.where(known, band, np.nan))
    else:
        stated_crs = stated.crs
    across = np.array(stated.factors[:2])
    return Dsm(
        height_m=turned(values),
        corner_m=corner * across,
        cell_m=cell * across,
        frame=stated_crs,
        path=path,
        notes=(*notes, *(f"{path.name}: {sentence}" for sentence in said)),
        sigma_m=bands[0],
        common_m=bands[1],
    )


def _placement(file: Any, path: Path) -> tuple[ArrayF, ArrayF, tuple[bool, bool]]:
    """Outer corner in the north-west, size of a cell, and whether columns and rows run backwards."""
    t = file.transform
    if t.is_identity and file.gcps[0] == []:
        raise InputError(
            "a raster without a place on the map", expected="a GeoTIFF (scale and tie point)", where=path,
            cure="Export it as GeoTIFF, or with a world file (.tfw) beside it",
        )  # fmt: skip
    if t.is_identity or abs(t.b) > 1e-9 * abs(t.a) or abs(t.d) > 1e-9 * abs(t.e) or not t.a * t.e:
        raise UnsupportedError(
            "a raster that is turned or bent", expected="rows along east", where=path,
            cure=f"Resample it to a grid along east and north: gdalwarp -r bilinear {path.name} straight.tif",
        )  # fmt: skip
    flipped = (t.a < 0, t.e > 0)
    corner = np.array([t.c + min(t.a, 0.0) * file.width, t.f + max(t.e, 0.0) * file.height])
    return corner, np.array([abs(t.a), abs(t.e)]), flipped


def _height_band(file: Any, names: list[str], path: Path) -> int:
    """Number of the band of heights: the only one, or the only one that is called so."""
    bands = [k for k, colour in enumerate(file.colorinterp, 1) if colour.name != "alpha"]
    # a description may be long
    titles = {k: "; ".join(filter(None, _names(file, k)[:-1])) for k in bands}
    spoken = {k: re.sub(r"[^\w;]+|_", " ", title) for k, title in titles.items()}
    heights = {k for k, words in spoken.items() if _HEIGHT.search(words)}
    other = {k for k, words in spoken.items() if (_OF_HEIGHTS if k in heights else _OTHER).search(words)}
    coloured = any(colour.name == "palette" for colour in file.colorinterp)
    if len(bands) == 1 and (other or coloured):
        raise UnsupportedError(
            "a band of numbers of colours" if coloured else f"a band of {titles[bands[0]]!r}",
            expected="one band of heights",
            where=path,
            cure="Export heights, or call the band height",
        )
    called = sorted(heights - other)
    if len(bands) > 1:
        if len(called) != 1:
            words = ", ".join(repr(name) for name in names if name) or "without names"
            raise UnsupportedError(
                f"{len(bands)} bands ({words})",
                expected="one band of heights, or one that is called height or elevation",
                where=path,
                cure="Export heights alone",
            )
        bands = called
    return bands[0]


def _names(file: Any, number: int) -> list[str]:
    """What a file calls a band, by its name and in tags; empty where it does not."""
    tags = {key.lower(): value for key, value in (file.tags() | file.tags(number)).items()}
    return [file.descriptions[number - 1] or "", *(tags.get(key, "") for key in _TAGS_OF_NAMES)]


def _old_unit(path: Path) -> str | None:
    """Unit of heights in a ``.prj`` of Arc/Info, a keyword a line, of which GDAL reads the map alone."""
    beside = path.with_suffix(".prj")
    if not beside.is_file():
        return None
    stated = re.search(r"(?im)^\s*zunits\s+(\S+)", beside.read_text(encoding="latin-1"))
    return None if stated is None or stated[1].lower() == "no" else stated[1].lower()


def _unit_of_band(unit: str | None, name: str, path: Path) -> Unit | None:
    """Unit of length that the band itself states, as its unit or in brackets behind its name.

    Raises
    ------
    UnsupportedError : another unit.
    """
    if unit and unit.lower() not in {"unknown", "none", "1"}:
        found = unit_of_word(unit) or unit_of_word(unit.split()[0])
        if found is None:
            raise UnsupportedError(
                f"heights in {unit!r}",
                expected="a unit of length",
                where=path,
                cure="Export heights in metres",
            )
        return found
    bracket = _IN_BRACKETS.search(name)
    return unit_of_word(bracket[1] if bracket else name.rpartition("_")[2])


def _geo_keys(path: Path) -> list[int]:
    """The GeoKey directory of a TIFF; of it GDAL does not hand over the units that contradict a code."""
    try:
        with path.open("rb") as file:
            header = file.read(8)
            header += file.read(8) if 43 in header[2:4] else b""  # BigTIFF
            first = TiffImagePlugin.ImageFileDirectory_v2(header)
            file.seek(first.next)
            first.load(file)
            return [int(key) for key in first.get(_GEO_KEYS, ())]
    except (SyntaxError, OSError, ValueError, struct.error):
        return []  # a raster of another format


def _outside_of_mask(file: Any, number: int) -> ArrayB | None:
    """Cells (rows, columns) that a mask of the file, or an opaque band, leaves out; None without one."""
    flags = {flag.name for flag in file.mask_flag_enums[number - 1]}
    if flags & {"per_dataset", "alpha"}:
        return file.read_masks(number) == 0
    # GDAL takes no band of floating-point numbers, nor one of three, for a mask
    opaque = next((k for k, colour in enumerate(file.colorinterp, 1) if colour.name == "alpha"), None)
    return None if opaque is None else file.read(opaque) == 0


def _with_heights(crs: CRS | None, heights: str, path: Path) -> CRS | None:
    """A map with the heights that a tag of this pipeline names.

    Raises
    ------
    UnsupportedError : PROJ does not know them.
    """
    if crs is None:
        return None
    if heights.startswith("ellipsoidal"):
        return crs.to_3d()
    try:
        vertical = CRS.from_user_input(heights)
    except CRSError as error:
        raise UnsupportedError(
            f"heights {heights!r}", expected="a height system that PROJ knows", where=path
        ) from error
    return CompoundCRS(f"{crs.name} + {vertical.name}", [crs, vertical])


def mask_missing(
    heights: ArrayF,
    path: Path,
    what: str,
    *,
    nodata: float | None,
    declared: float | None = None,
    also: ArrayB | None = None,
    of_type: Any = np.float64,
    zeros: bool = True,
    to_metres: tuple[float, float] = (1.0, 0.0),
) -> tuple[ArrayF, tuple[str, ...]]:
    """Heights in metres with NaN where there is none, and sentences that count these; see `read_dsm`.

    Parameters
    ----------
    heights : numbers as the file has them.
    what : "cells" or "points".
    nodata, declared : values without a height, as stated and as the file declares.
    also : of the same shape, which have none by a mask.
    of_type : of the numbers in the file: the ends of an integer type of 16 or more bits stand for nothing.
    zeros : ten exact zeros and more are refused unless ``nodata`` says what they are.
    to_metres : factor and summand that make metres of the numbers.
    """
    values = heights.copy()
    masked: dict[str, int] = {}

    def mask(which: ArrayB, words: str) -> None:
        """Make heights empty, and count those that this takes."""
        which &= ~np.isnan(values)
        if n := int(which.sum()):
            masked[words] = n
            values[which] = np.nan

    if not np.isfinite(values).all():
        masked["NaN"] = int((~np.isfinite(values)).sum())
        values[~np.isfinite(values)] = np.nan
    gone: list[float] = []
    for value, words in ((declared, "declared value {:g}"), (nodata, "value {:g}, as stated")):
        if value is not None and np.isfinite(value):
            gone.append(value)
            mask(np.isclose(values, value, rtol=1e-6, atol=0.0), words.format(value))
    if also is not None:
        mask(also.copy(), "mask of the file")
    extremes: tuple[int, ...] = ()
    if np.issubdtype(of_type, np.integer) and np.dtype(of_type).itemsize > 1:
        extremes = (int(np.iinfo(of_type).min) or -1, int(np.iinfo(of_type).max))
    # in centimetres 9999 is a height like others
    plain = abs(to_metres[0] - 1.0) < 1e-9
    undeclared = is_nothing(values, "height" if plain else "other", extra=extremes) & np.isfinite(values)
    mask(undeclared & (np.abs(values) >= HUGE), f"undeclared value beyond {HUGE:g}")
    for value in np.unique(values[undeclared & np.isfinite(values)]):
        gone.append(value)
        mask(values == value, f"undeclared value {value:g}")
    for value in far_repeated(values):
        if value != 0.0 or not zeros or (values == 0.0).sum() < _LEAST_ZEROS:
            mask(values == value, f"undeclared value {value:g}, far from all others")
    one = what.removesuffix("s")
    if not np.isfinite(values).any():
        raise InputError(f"no {one} has a height", expected="heights in metres", where=path)
    _refuse_mixed(values, gone, path)
    if nodata is None and zeros and (n := int((values == 0.0).sum())) >= _LEAST_ZEROS:
        raise InputError(
            f"{n:,} of {values.size:,} {what} are exactly 0 m, and no value for missing heights is declared",
            expected="heights, or a declared value where there are none",
            where=path,
            cure="State --nodata 0 where they are no heights, or --nodata none where they are (in a "
            "campaign: nodata)",
        )
    values = values * to_metres[0] + to_metres[1]
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if low < LOWEST_M or high > HIGHEST_M:
        raise InputError(
            f"heights from {low:g} to {high:g} m",
            expected=f"heights between {LOWEST_M:g} and {HIGHEST_M:g} m",
            where=path,
            cure="State the value that stands for missing heights (--nodata; in a campaign nodata), or "
            "export metres",
        )
    count = f"of {values.size:,} {what} without a height"
    return values, tuple(f"{path.name}: {n:,} {count} ({words})." for words, n in masked.items())


def _refuse_mixed(heights: ArrayF, gone: list[float], path: Path) -> None:
    """Refuse means of heights and a value that stands for none, which resampling leaves along borders.

    Parameters
    ----------
    heights : (rows, columns), NaN where there is none.
    gone : values that stood for none.

    Raises
    ------
    InputError : cells beside those without a height lie far from all others, on the way to such a value.
    """
    if heights.ndim != 2 or not np.isfinite(heights).any():
        return
    low, middle, high = np.nanpercentile(heights[:: -(-heights.shape[0] // _SAMPLE)], (25.0, 50.0, 75.0))
    for value in gone:
        if not abs(value - middle) > _FAR:
            continue
        share = (heights - middle) / (value - middle)
        mixed = (share > _MIXED) & (share < 1.0) & (np.abs(heights - middle) > 20.0 * max(high - low, 1.0))
        if mixed.any():
            mixed &= binary_dilation(np.isnan(heights), np.ones((3, 3), bool))
        if n := int(mixed.sum()):
            raise InputError(
                f"{n:,} cells beside those without a height are {heights[mixed].min():g} to "
                f"{heights[mixed].max():g} m, between the others and {value:g}: means of both",
                expected="heights that were not mixed with the value for none",
                where=path,
                cure=f"Resample it again from its source, this value declared: gdalwarp -srcnodata {value:g}",
            )
