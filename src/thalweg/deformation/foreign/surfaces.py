r"""Surface models of others compared: rasters of heights in, differences and volumes with sigmas out.

The errors of the heights of a raster are correlated between cells, and volumes are sums over cells. With a
standard deviation sigma and a correlation exp(-d / L) of cells at a distance d, the variance of a volume over
a set of cells of area A is

    A^2 sigma^2 sum_i sum_j exp(-d_ij / L),

which Rolstad, Haug and Denby (2009, J. Glaciology 55, https://doi.org/10.3189/002214309789470950) integrate
over a circle of the same area. Here the sum runs over all pairs of cells of the true outline: the number of
pairs at each lag is the autocorrelation of the mask, one pair of Fourier transforms. For a large area both
tend to sigma^2 2 pi L^2 / area for the variance of the mean height; independent cells (L -> 0) give
sigma^2 / n.
"""

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import pandas as pd
import pyarrow as pa
from PIL import TiffImagePlugin
from pyproj import CRS
from pyproj.exceptions import CRSError
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import map_coordinates
from scipy.stats import norm

from thalweg.core import (
    ArrayB,
    ArrayF,
    Frame,
    GeometryError,
    InputError,
    LocalFrame,
    UnsupportedError,
    column,
    frame_of,
    read_raster,
    robust_sigma,
    table_kind,
    write_table,
)
from thalweg.core.geometry import TriangleMesh
from thalweg.ingest import Vectors
from thalweg.settings.sections import DSM_ENDINGS

# ---------------------------------------------------------------- surfaces

SAME_GRID_CELLS = 0.05
"""Cells whose centres differ by less than this part of a cell are the same cell."""
RESAMPLING = ("nearest", "bilinear")

VOLUMES = table_kind(
    "surface_volumes",
    1,
    [
        column("part", pa.string(), "1", "which cells"),
        column("n_cells", pa.int64(), "1", "number of cells"),
        column("area_m2", pa.float64(), "m2", "their area"),
        column("volume_m3", pa.float64(), "m3", "second minus first surface, summed over the cells"),
        column("sigma_m3", pa.float64(), "m3", "standard deviation of the volume"),
        column("low_m3", pa.float64(), "m3", "lower end of the interval of 95 %"),
        column("high_m3", pa.float64(), "m3", "upper end of the interval of 95 %"),
    ],
)
"""One row for each set of cells; cells that were not seen have an area and no volume."""
_COLUMNS = tuple(item.name for item in VOLUMES)

_SCALE, _TIES, _MATRIX, _KEYS, _NODATA, _METADATA = 33550, 33922, 34264, 34735, 42113, 42112
_RASTER_TYPE, _GEOGRAPHIC, _PROJECTED, _LINEAR_UNIT, _VERTICAL, _VERTICAL_UNIT = (
    1025,
    2048,
    3072,
    3076,
    4096,
    4099,
)
_UNITS = {9002: "feet", 9003: "US survey feet"}
_METRE, _USER_DEFINED = 9001, 32767
_LIMITS_M = (-12_000.0, 9_000.0)
_USUAL = (-9999.0, -10_000.0, -32_767.0, -32_768.0, -99_999.0)
"""What programs write where there is no height; no land lies so deep."""
_LEAST_ZEROS = 10
_NAMED_BANDS = (("height_m", "sigma_m", "sigma_common_m"), ("height", "sigma", "sigma_common"))
"""Of ``bed.tif`` and of ``dtm.tif``: height, standard deviation, its part that all heights share."""
_DIFFERENCE_BANDS = ("difference_m", "sigma_m")


@dataclass(frozen=True, slots=True)
class Dsm:
    """A raster of heights.

    Attributes
    ----------
    height_m : (rows, columns) from north to south and west to east; NaN where there is no height.
    corner_m : (2,) east and north of the outer corner of the first cell.
    cell_m : (2,) width (east) and height (north) of a cell, both positive.
    frame : coordinate system of the map, None where the file states none.
    heights : EPSG code of the heights' coordinate system, None where none is stated.
    notes : what was masked on reading, with counts.
    sigma_m : (rows, columns) standard deviation of each height, where a band holds it (a kriged bed).
    common_m : (rows, columns) its part that all heights of the raster share, in addition to ``sigma_m``.
    """

    height_m: ArrayF
    corner_m: ArrayF
    cell_m: ArrayF
    frame: CRS | None
    heights: int | None
    path: Path
    notes: tuple[str, ...] = ()
    sigma_m: ArrayF | None = None
    common_m: ArrayF | None = None

    @property
    def cell_area_m2(self) -> float:
        """Area of a cell on the map."""
        return float(self.cell_m[0] * self.cell_m[1])

    def centres_m(self) -> ArrayF:
        """Centres (rows * columns, 2) of all cells, row by row."""
        rows, columns = self.height_m.shape
        east = self.corner_m[0] + (np.arange(columns) + 0.5) * self.cell_m[0]
        north = self.corner_m[1] - (np.arange(rows) + 0.5) * self.cell_m[1]
        return np.column_stack([np.tile(east, rows), np.repeat(north, columns)])

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


@dataclass(frozen=True, slots=True)
class HeightErrors:
    """What is stated of the errors of a raster's heights.

    Attributes
    ----------
    sigma_m : standard deviation of a height, or (rows, columns) of each.
    correlation_m : distance at which the correlation of two heights has fallen to 1/e; 0 for independent
        cells.
    common_m : standard deviation that all heights share, in addition, or (rows, columns) with one sign.
    """

    sigma_m: float | ArrayF
    correlation_m: float = 0.0
    common_m: float | ArrayF = 0.0

    def __post_init__(self) -> None:
        sigma, common = (np.asarray(each, np.float64) for each in (self.sigma_m, self.common_m))
        known = [each[~np.isnan(each)] if each.ndim else each for each in (sigma, common)]
        if not all(((each >= 0) & (each < np.inf)).all() for each in known) or not self.correlation_m >= 0:
            low = min(float(each.min()) for each in known if each.size)
            raise InputError(
                f"heights with {low:g} m, correlated over {self.correlation_m:g} m",
                expected="a standard deviation and a length of zero or more",
            )

    @classmethod
    def of_bands(cls, surface: Dsm, correlation_m: float | None) -> "HeightErrors | None":
        """What the bands of a raster say of its errors; None if it has none.

        Raises
        ------
        InputError : bands, and no correlation length.
        """
        if surface.sigma_m is None:
            return None
        if correlation_m is None:
            raise InputError(
                "a raster with a band of standard deviations, and no correlation length of its errors",
                expected="the distance at which the correlation of two heights has fallen to 1/e",
                where=surface.path,
                cure="State --correlation-m (in a campaign correlation_m): of a bed about half the distance "
                "of the lines of soundings",
            )
        return cls(surface.sigma_m, correlation_m, 0.0 if surface.common_m is None else surface.common_m)

    def resampled(self, surface: Dsm, centres_m: ArrayF, shape: tuple[int, ...], how: str) -> "HeightErrors":
        """Rasters of errors at other centres (n, 2), as the heights of their surface are."""
        on_grid = [
            each
            if isinstance(each, float)
            else replace(surface, height_m=np.asarray(each)).at(centres_m, how).reshape(shape)
            for each in (self.sigma_m, self.common_m)
        ]
        return HeightErrors(on_grid[0], self.correlation_m, on_grid[1])

    @property
    def single_m(self) -> float | ArrayF:
        """Standard deviation of a single height."""
        return np.hypot(self.sigma_m, self.common_m)


@dataclass(frozen=True, slots=True)
class SurfaceDifference:
    """Second minus first raster on the grid of the first, its sigma, and volumes.

    Attributes
    ----------
    raster : heights are differences; NaN where they are not known.
    sigma_m : (rows, columns) standard deviation of each difference.
    volumes : table `VOLUMES`.
    """

    raster: Dsm
    sigma_m: ArrayF
    volumes: pd.DataFrame
    notes: list[str]


# ---------------------------------------------------------------- frames


class Placed(Protocol):
    """What lies in a frame: a cloud, a raster, polygons of a file."""

    @property
    def frame(self) -> Frame:
        """Coordinate system; None where none is stated."""

    @property
    def path(self) -> Path:
        """File that it comes from."""


def one_frame(placed: Sequence[Placed]) -> tuple[Frame, list[str]]:
    """The frame of all, and a note of those that state none.

    Raises
    ------
    InputError : different frames, or one that is not in metres.
    """
    stated = [each for each in placed if each.frame is not None]
    for each in stated:
        if isinstance(each.frame, CRS):
            units = {axis.unit_name for axis in each.frame.axis_info}
            if units - {"metre"}:
                raise InputError(
                    f"{each.frame.name}: coordinates in {', '.join(sorted(units - {'metre'}))}",
                    expected="east, north and heights in metres",
                    where=each.path,
                    cure="Transform them to a map projection and heights in metres",
                )
        if not _same(stated[0].frame, each.frame):
            names = [
                item.frame.name if isinstance(item.frame, CRS) else "a local frame"
                for item in (stated[0], each)
            ]
            raise InputError(
                f"{stated[0].path} states {names[0]}, {each.path} {names[1]}",
                expected="one coordinate system, with the same heights",
                cure="Transform one of them before the comparison",
            )
    missing = [str(each.path) for each in placed if each.frame is None]
    notes = [f"No coordinate system in {', '.join(missing)}: taken as that of the other."] if missing else []
    return (stated[0].frame if stated else None), notes


def onto_map(drawn: Sequence[Vectors], frame: Frame) -> list[Vectors]:
    """Areas and lines on the map of a raster or cloud; as they are beside one that states none.

    Raises
    ------
    InputError : places that this map does not have.
    """
    return [each.on_map(frame) if isinstance(frame, CRS) else each for each in drawn]


def _same(a: Frame, b: Frame) -> bool:
    if isinstance(a, LocalFrame) or isinstance(b, LocalFrame):
        return a == b
    return bool(a.equals(b, ignore_axis_order=True)) if a is not None else b is None


# ---------------------------------------------------------------- reading


def read_dsm(path: Path, *, nodata: float | None = None) -> Dsm:
    """Heights of a GeoTIFF.

    A raster with bands of heights and standard deviations (``bed.tif``, ``dtm.tif`` of this pipeline) gives
    both.

    Cells with the declared value for "no height", NaN, or a value that only stands for that (-9999, -10000,
    ...) have none; how many is told in the notes. A value that may be either is refused: exact zeros in ten
    cells or more, and heights that no place on Earth has.

    Parameters
    ----------
    nodata : value without a height, beside a declared one; NaN says that all that is left are heights.

    Raises
    ------
    InputError : no such file, no raster, no place on the map, no heights, or values that may be no heights.
    UnsupportedError : several bands, rotated rasters, degrees, feet, a coordinate system without EPSG code.
    """
    if (named := _named_bands(path)) is not None:
        return named
    tags, values = _read_tiff(path)
    keys = _geo_keys(tags)
    frame, heights = _frame(keys, path)
    corner, cell = _placement(tags, keys, path)
    whole = np.issubdtype(values.dtype, np.integer)
    declared = _number(tags[_NODATA], path) if _NODATA in tags else None
    values, notes = mask_missing(
        values.astype(np.float64), path, "cells", nodata=nodata, declared=declared, zeros=not whole
    )
    return Dsm(values, corner, cell, frame, heights, path, notes)


def mask_missing(
    heights_m: ArrayF,
    path: Path,
    what: str,
    *,
    nodata: float | None,
    declared: float | None = None,
    zeros: bool = True,
) -> tuple[ArrayF, tuple[str, ...]]:
    """Heights with NaN where there is none, and sentences that count them; rules of `read_dsm`.

    Parameters
    ----------
    what : "cells" or "points".
    nodata, declared : values without a height, as stated and as the file declares.
    zeros : ten exact zeros and more are refused unless ``nodata`` says what they are.
    """
    values = heights_m
    masked: dict[str, int] = {}

    def mask(which: ArrayB, words: str) -> None:
        """Make heights empty, and count those that this takes."""
        nonlocal values
        if n := int((which & np.isfinite(values)).sum()):
            masked[words] = n
            values = np.where(which, np.nan, values)

    if not np.isfinite(values).all():
        masked["NaN"] = int((~np.isfinite(values)).sum())
        values = np.where(np.isfinite(values), values, np.nan)
    if declared is not None and np.isfinite(declared):
        mask(np.isclose(values, declared, rtol=1e-6, atol=0.0), f"declared value {declared:g}")
    if nodata is not None and np.isfinite(nodata):
        mask(np.isclose(values, nodata, rtol=1e-6, atol=0.0), f"value {nodata:g}, as stated")
    for usual in _USUAL:
        mask(values == usual, f"undeclared value {usual:g}")
    mask(np.abs(values) > 1e30, "undeclared value beyond 1e30")
    one = what.removesuffix("s")
    if not np.isfinite(values).any():
        raise InputError(f"no {one} has a height", expected="heights in metres", where=path)
    if nodata is None and zeros and (n := int((values == 0.0).sum())) >= _LEAST_ZEROS:
        raise InputError(
            f"{n:,} of {values.size:,} {what} are exactly 0 m, and no value for missing heights is declared",
            expected="heights, or a declared value where there are none",
            where=path,
            cure="State --nodata 0 where they are no heights, or --nodata none where they are (in a "
            "campaign: nodata)",
        )
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if low < _LIMITS_M[0] or high > _LIMITS_M[1]:
        raise InputError(
            f"heights from {low:g} to {high:g} m",
            expected=f"heights between {_LIMITS_M[0]:g} and {_LIMITS_M[1]:g} m",
            where=path,
            cure="State the value that stands for missing heights (--nodata; in a campaign nodata), or "
            "export metres",
        )
    count = f"of {values.size:,} {what} without a height"
    return values, tuple(f"{path.name}: {n:,} {count} ({words})." for words, n in masked.items())


def _named_bands(path: Path) -> Dsm | None:
    """A raster of this pipeline, whose bands have names; None of others.

    Raises
    ------
    InputError : it is turned, or has no coordinate system.
    """
    try:
        with path.open("rb") as file:
            header = file.read(8)
            header += file.read(8) if 43 in header[2:4] else b""  # BigTIFF
            first = TiffImagePlugin.ImageFileDirectory_v2(header)
            file.seek(first.next)
            first.load(file)
            described = str(first.get(_METADATA, ""))
    except (SyntaxError, OSError, ValueError, struct.error):
        return None  # whoever reads it says what it is

    def has(names: tuple[str, str, str]) -> bool:
        """Whether bands have the first two names."""
        return all(f'role="description">{name}<' in described for name in names[:2])

    names = next(filter(has, _NAMED_BANDS), None)
    if names is None:
        return None
    grid, bands, tags = read_raster(path)
    height, sigma, common = (bands.get(name) for name in names)
    if height is None or sigma is None:
        return None
    heights = tags.get("heights", "ellipsoidal")
    known = np.isfinite(height)
    return Dsm(
        height,
        np.array([grid.west_m, grid.north_m]),
        np.full(2, grid.cell_m),
        grid.crs,
        _vertical_code(heights, path),
        path,
        (),
        np.where(known, sigma, np.nan),
        None if common is None else np.where(known, common, np.nan),
    )


def _vertical_code(heights: str, path: Path) -> int | None:
    """EPSG code of heights that a tag names; None of ellipsoidal ones.

    Raises
    ------
    UnsupportedError : PROJ does not know them.
    """
    if heights.startswith("ellipsoidal"):
        return None
    try:
        return CRS.from_user_input(heights).to_epsg()
    except CRSError as error:
        raise UnsupportedError(
            f"heights {heights!r}", expected="a height system that PROJ knows", where=path
        ) from error


def _read_tiff(path: Path) -> tuple[dict[int, object], ArrayF]:
    if not path.is_file() or not path.stat().st_size:
        raise InputError(
            "an empty file" if path.is_file() else "no such file", expected="a GeoTIFF of heights", where=path
        )
    try:
        # not Image.open: it takes rasters of more than 179 million cells for an attack
        with TiffImagePlugin.TiffImageFile(path) as image:
            tags = dict(image.tag_v2)
            values = np.array(image)
    except (SyntaxError, OSError, ValueError, KeyError, EOFError) as error:
        raise InputError(
            f"no raster that can be read ({error})",
            expected="a GeoTIFF with one band of heights",
            where=path,
            cure="Export one band again, as 32-bit numbers",
        ) from error
    if values.ndim != 2:
        raise UnsupportedError(
            f"{values.shape[2]} bands",
            expected="one band of heights",
            where=path,
            cure="Export heights alone",
        )
    return tags, values


def _number(declared: object, path: Path) -> float:
    try:
        return float(str(declared).strip("\0 "))
    except ValueError:
        raise InputError(
            f"{declared!r} as the value for missing heights", expected="a number", where=path
        ) from None


def _geo_keys(tags: dict[int, object]) -> dict[int, int]:
    """GeoKeys with a number of their own (OGC 19-008r4, 7.1.2)."""
    directory = np.asarray(tags.get(_KEYS, (1, 1, 0, 0)), np.int64).reshape(-1, 4)[1:]
    return {int(key): int(value) for key, place, _, value in directory if place == 0}


def _frame(keys: dict[int, int], path: Path) -> tuple[CRS | None, int | None]:
    for key, what in ((_LINEAR_UNIT, "a map"), (_VERTICAL_UNIT, "heights")):
        if keys.get(key, _METRE) != _METRE:
            unit = _UNITS.get(keys[key], f"units with the EPSG code {keys[key]}")
            raise UnsupportedError(
                f"{what} in {unit}", expected="metres", where=path, cure="Transform the raster to metres"
            )
    code = keys.get(_PROJECTED)
    if code is None:
        if _GEOGRAPHIC in keys:
            raise UnsupportedError(
                "cells in degrees", expected="a projected coordinate system in metres", where=path,
                cure="Transform the raster to a map projection such as UTM",
            )  # fmt: skip
        return None, keys.get(_VERTICAL)
    try:
        frame = CRS.from_epsg(code)  # 32767 stands for a coordinate system that has none
    except CRSError as error:
        raise UnsupportedError(
            f"coordinate system {code}: {error}", expected="one with an EPSG code", where=path,
            cure="Export the raster with the EPSG code of its coordinate system",
        ) from error  # fmt: skip
    vertical = keys.get(_VERTICAL)
    return frame, None if vertical == _USER_DEFINED else vertical


def _placement(tags: dict[int, object], keys: dict[int, int], path: Path) -> tuple[ArrayF, ArrayF]:
    if _MATRIX in tags:
        m = np.asarray(tags[_MATRIX], float).reshape(4, 4)
        cell, corner, turned = np.array([m[0, 0], -m[1, 1]]), m[:2, 3], m[0, 1] != 0 or m[1, 0] != 0
    elif _SCALE in tags and _TIES in tags:
        cell, ties = np.asarray(tags[_SCALE], float)[:2], np.asarray(tags[_TIES], float)
        corner, turned = ties[3:5] - ties[:2] * cell * (1.0, -1.0), len(ties) != 6
    else:
        raise InputError(
            "a raster without a place on the map", expected="a GeoTIFF (scale and tie point)", where=path,
            cure="Export it as GeoTIFF; world files (.tfw) are not read",
        )  # fmt: skip
    if turned or not (cell > 0).all():
        raise UnsupportedError(
            "a raster that is turned, mirrored or bent", expected="rows from north to south", where=path,
            cure="Resample it to a grid along east and north",
        )  # fmt: skip
    if keys.get(_RASTER_TYPE) == 2:  # the place is that of the centre of a cell
        corner = corner - 0.5 * cell * (1.0, -1.0)
    return np.asarray(corner, float), np.asarray(cell, float)


# ---------------------------------------------------------------- difference


def onto_grid(surface: Dsm, grid: Dsm, resample: str | None = None) -> tuple[Dsm, float]:
    """Heights of a raster in the cells of another one, and how far centres of cells lie apart at most (m).

    Parameters
    ----------
    resample : one of `RESAMPLING`, or None: only grids that are the same to 5 % of a cell.

    Raises
    ------
    InputError : another grid without ``resample``.
    GeometryError : rasters that do not overlap.
    """
    if resample not in (None, *RESAMPLING):
        raise InputError(f"resampling {resample!r}", expected=" or ".join(RESAMPLING))
    centres = grid.centres_m()
    place = surface.places(centres)
    rows, columns = surface.height_m.shape
    within = ((place > -0.5) & (place < (rows - 0.5, columns - 0.5))).all(axis=1)
    if not within.any():
        raise GeometryError(
            f"{grid.path} and {surface.path} share no cell: their corners lie at "
            f"{grid.corner_m.round().tolist()} and {surface.corner_m.round().tolist()} m",
            expected="rasters that overlap, in one coordinate system",
        )
    off = np.abs(place[within] - np.floor(place[within] + 0.5))
    apart = float(np.hypot(*(off * surface.cell_m[::-1]).T).max())
    other = off.max() > SAME_GRID_CELLS or np.abs(surface.cell_m / grid.cell_m - 1.0).max() > 0.5
    if other and resample is None:
        raise InputError(
            f"another grid: cells of {surface.cell_m.round(5).tolist()} m from {surface.corner_m.tolist()}; "
            f"{grid.path.name}: {grid.cell_m.round(5).tolist()} m from {grid.corner_m.tolist()} m",
            expected="one grid",
            where=surface.path,
            cure="Export both on one grid, or resample the second (--resample nearest or bilinear; in a "
            "campaign deformation.resample)",
        )
    heights = surface.at(centres, resample or "nearest").reshape(grid.height_m.shape)
    return replace(surface, height_m=heights, corner_m=grid.corner_m, cell_m=grid.cell_m), apart


def volume_variance(cells: ArrayB, cell_m: ArrayF, errors: HeightErrors) -> float:
    """Variance (m^6) of the volume over a set of cells (rows, columns), whose heights have these errors.

    The sum of the covariances of all pairs of cells; pairs at more than 30 correlation lengths are left out.
    """
    area = float(cell_m[0] * cell_m[1])
    weight, common = (
        np.where(cells, np.broadcast_to(each, cells.shape), 0.0) for each in (errors.sigma_m, errors.common_m)
    )
    shared = float(common.sum()) ** 2
    if not cells.any() or errors.correlation_m == 0:
        return area**2 * (float((weight**2).sum()) + shared)
    rows, columns = np.flatnonzero(cells.any(axis=1)), np.flatnonzero(cells.any(axis=0))
    part = weight[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    reach = [
        int(min(size - 1, np.ceil(30.0 * errors.correlation_m / each)))
        for size, each in zip(part.shape, cell_m[::-1], strict=True)
    ]
    shape = tuple(next_fast_len(size + far, real=True) for size, far in zip(part.shape, reach, strict=True))
    pairs = irfft2(np.abs(rfft2(part, shape)) ** 2, shape)
    down, right = (np.r_[0 : far + 1, -far:0] for far in reach)
    distance = np.hypot(down[:, None] * cell_m[1], right * cell_m[0])
    products = pairs[np.ix_(down, right)]
    return area**2 * (float((products * np.exp(-distance / errors.correlation_m)).sum()) + shared)


def difference_of_surfaces(
    before: Dsm,
    after: Dsm,
    errors: tuple[HeightErrors | None, HeightErrors | None] = (None, None),
    *,
    sigma_registration_m: float = 0.0,
    resample: str | None = None,
    leave_out: Sequence[Vectors] = (),
) -> SurfaceDifference:
    """Second minus first surface, with sigmas, and volumes of erosion and deposition with intervals.

    Parameters
    ----------
    errors : of the first and second raster; None if unknown.
    sigma_registration_m : standard deviation of a height offset between both, common to all cells.
    resample : see `onto_grid`.
    leave_out : polygons without comparison, such as water in either epoch.

    Raises
    ------
    InputError : other coordinate systems, grids, or units of heights.
    GeometryError : no cell with a height in both.
    """
    leave_out = onto_map(leave_out, before.frame)
    frame, notes = one_frame([before, after, *leave_out])
    notes += [note for each in leave_out for note in each.notes]
    if None not in (before.heights, after.heights) and before.heights != after.heights:
        raise InputError(
            f"{before.path} has heights of EPSG:{before.heights}, {after.path} of EPSG:{after.heights}",
            expected="one system of heights",
            cure="Transform one of them before the comparison",
        )
    second, apart = onto_grid(after, before, resample)
    notes = [*before.notes, *after.notes, *notes]
    if apart > 1e-6 * before.cell_m.max():
        notes.append(
            f"Centres of cells of the second raster lie up to {apart:.3f} m away from those of the first"
            + (f"; resampled: {resample}." if resample else " and count as the same.")
        )
    out = np.zeros(before.height_m.shape, bool)
    for each in leave_out:
        inside = each.contain(before.centres_m()).reshape(out.shape)
        if not inside.any():
            notes.append(f"No cell lies in a polygon of {each.path}.")
        out |= inside
    seen = [np.isfinite(each.height_m) for each in (before, second)]
    difference = np.where(out, np.nan, second.height_m - before.height_m)
    known = np.isfinite(difference)
    if not known.any():
        raise GeometryError(
            f"no cell has a height in both of {before.path} and {after.path}",
            expected="rasters whose heights overlap",
            cure="Check the coordinate systems, values for missing heights, and masks",
        )
    _refuse_other_units(before, second, known)
    stated = [each or HeightErrors(0.0) for each in errors]
    shape = before.height_m.shape
    stated[1] = stated[1].resampled(after, before.centres_m(), shape, resample or "nearest")
    if unknown := None in errors:
        notes.append("Without sigmas of both rasters there are no limits and no intervals.")
        sigma_registration_m = np.nan
    sigma = np.hypot(np.hypot(stated[0].single_m, stated[1].single_m), sigma_registration_m)
    limit = float(norm.isf(0.025)) * sigma

    def volume(part: str, cells: ArrayB, *, measured: bool = True) -> dict[str, object]:
        """Row of the table: volume of a set of cells with its 95 % interval, or its area alone."""
        n, area = int(cells.sum()), float(cells.sum()) * before.cell_area_m2
        total = float(difference[cells].sum()) * before.cell_area_m2 if measured else np.nan
        variance = sum(volume_variance(cells, before.cell_m, each) for each in stated) if measured else np.nan
        spread = float(np.sqrt(variance + (area * sigma_registration_m) ** 2))
        half = float(norm.isf(0.025)) * spread
        values = (part, n, area, total, spread, total - half, total + half)
        return dict(zip(_COLUMNS, values, strict=True))

    with np.errstate(invalid="ignore"):
        rows = [volume("net", known), volume("erosion", difference < 0), volume("deposition", difference > 0)]
        if not unknown:
            rows += [
                volume("erosion beyond the level of detection", difference < -limit),
                volume("deposition beyond the level of detection", difference > limit),
            ]
    for part, cells in (
        ("left out", out),
        ("not seen in first", ~seen[0] & seen[1] & ~out),
        ("not seen in second", seen[0] & ~seen[1] & ~out),
        ("not seen", ~seen[0] & ~seen[1] & ~out),
    ):
        rows.append(volume(part, cells, measured=False))
    table = pd.DataFrame(rows)
    raster = replace(before, height_m=difference, frame=frame, notes=())
    return SurfaceDifference(
        raster,
        np.where(known, sigma, np.nan),
        frame_of(VOLUMES, {name: table[name].to_numpy() for name in _COLUMNS}),
        notes,
    )


def _refuse_other_units(before: Dsm, second: Dsm, known: ArrayB) -> None:
    """Heights of one relief in metres and feet have slopes of 3.28 against each other."""
    a, b = before.height_m[known], second.height_m[known]
    if len(a) < 100 or not a.std() or not b.std():
        return
    ratio = float(b.std() / a.std())
    for factor, unit in ((1 / 0.3048, "feet"), (1000.0, "millimetres"), (100.0, "centimetres")):
        for found, path in ((ratio, second.path), (1.0 / ratio, before.path)):
            if abs(found / factor - 1.0) < 0.03 and np.corrcoef(a, b)[0, 1] > 0.95:
                raise InputError(
                    f"heights that rise {found:.2f} times as steeply as those of the other raster",
                    expected="both in metres",
                    where=path,
                    cure=f"They look like {unit}: export metres",
                )


@dataclass(frozen=True, slots=True)
class StableGround:
    """Differences on ground that is held for stable: number of points, median and robust spread (m)."""

    n: int
    median_m: float
    nmad_m: float


def difference_on_lines(before: Dsm, after: Dsm, lines: Vectors, step_m: float = 1.0) -> StableGround:
    """Median and NMAD (1.4826 times the median absolute deviation) of differences along lines.

    Parameters
    ----------
    lines : on stable ground; a point every ``step_m`` takes the height of its cell in each raster.

    Raises
    ------
    GeometryError : no point with a height in both.
    """
    (lines,) = onto_map([lines], before.frame)
    one_frame([before, after, lines])
    points = lines.points_along(step_m)
    difference = after.at(points) - before.at(points)
    difference = difference[np.isfinite(difference)]
    if not len(difference):
        raise GeometryError(
            "no point of the lines has a height in both rasters", expected="lines within both"
        )
    middle = float(np.median(difference))
    return StableGround(len(difference), middle, robust_sigma(difference, middle))


# ---------------------------------------------------------------- writing


def write_difference(path: Path, found: SurfaceDifference) -> None:
    """Write a GeoTIFF of two bands (difference, sigma), or the table of volumes as CSV or Parquet.

    Raises
    ------
    InputError : another suffix, or a folder that is not there.
    """
    suffix = path.suffix.lower()
    if suffix not in {*DSM_ENDINGS, ".csv", ".parquet"}:
        raise InputError(f"suffix {path.suffix!r}", expected=".tif, .csv or .parquet", where=path)
    if not path.parent.is_dir():
        raise InputError("no such folder", where=path.parent, cure="Make it, or name another file")
    if suffix == ".csv":
        found.volumes.to_csv(path, index=False)
    elif suffix == ".parquet":
        write_table(path, found.volumes, VOLUMES)
    else:
        bands = (found.raster.height_m, found.sigma_m)
        _write_bands(path, found.raster, dict(zip(_DIFFERENCE_BANDS, bands, strict=True)))


def read_difference(path: Path) -> SurfaceDifference:
    """Both bands of a GeoTIFF of `write_difference`; its volumes are in no raster.

    Raises
    ------
    InputError : no such file, or a raster with other bands.
    """
    import rasterio
    from rasterio.errors import RasterioError

    try:
        with rasterio.open(path) as file:
            names = tuple(file.descriptions)
            bands = file.read().astype(np.float64) if names == _DIFFERENCE_BANDS else None
            place, crs = file.transform, file.crs
    except RasterioError as error:
        raise InputError(f"{error}", where=path, expected="a difference of surfaces (.tif)") from error
    if bands is None:
        raise InputError(
            f"bands {', '.join(map(str, names))}", expected=" and ".join(_DIFFERENCE_BANDS), where=path
        )
    corner, cell = np.array([place.c, place.f]), np.array([place.a, -place.e])
    frame = None if crs is None else CRS.from_wkt(crs.to_wkt())
    none = frame_of(VOLUMES, {item.name: np.empty(0, item.type.to_pandas_dtype()) for item in VOLUMES})
    return SurfaceDifference(Dsm(bands[0], corner, cell, frame, None, path), bands[1], none, [])


def _write_bands(path: Path, grid: Dsm, bands: dict[str, ArrayF]) -> None:
    """A GeoTIFF of 32-bit bands in one compressed strip; Pillow writes its tags, but not two bands."""
    rows, columns = grid.height_m.shape
    strip = zlib.compress(np.stack(list(bands.values()), axis=-1).astype("<f4").tobytes())
    names = "".join(
        f'<Item name="DESCRIPTION" sample="{i}" role="description">{name}</Item>'
        for i, name in enumerate(bands)
    )
    keys = [1024, 0, 1, 1, _RASTER_TYPE, 0, 1, 1]
    if grid.frame is not None and (code := grid.frame.to_epsg()):
        keys += [_PROJECTED, 0, 1, code]
    if grid.heights:
        keys += [_VERTICAL, 0, 1, grid.heights]
    short, whole, double, text = 3, 4, 12, 2
    tags: dict[int, tuple[int, object]] = {
        256: (whole, columns),
        257: (whole, rows),
        258: (short, (32,) * len(bands)),
        259: (short, 8),  # deflate
        262: (short, 1),
        273: (whole, 0),  # the strip follows the tags; Pillow adds their length
        277: (short, len(bands)),
        278: (whole, rows),
        279: (whole, len(strip)),
        284: (short, 1),  # band beside band
        338: (short, (0,) * (len(bands) - 1)),
        339: (short, (3,) * len(bands)),  # floating point
        _SCALE: (double, (*grid.cell_m.tolist(), 0.0)),
        _TIES: (double, (0.0, 0.0, 0.0, *grid.corner_m.tolist(), 0.0)),
        _KEYS: (short, (1, 1, 0, len(keys) // 4, *keys)),
        _METADATA: (text, f"<GDALMetadata>{names}</GDALMetadata>"),
        _NODATA: (text, "nan"),
    }
    directory = TiffImagePlugin.ImageFileDirectory_v2(b"II\x2a\x00\x00\x00\x00\x00")
    for tag, (kind, value) in tags.items():
        directory.tagtype[tag] = kind
        directory[tag] = value
    with path.open("wb") as file:
        directory.save(file)
        file.write(strip)
