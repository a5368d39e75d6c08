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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import pandas as pd
import pyarrow as pa
from pyproj import CRS
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.stats import norm

from thalweg.core import (
    ArrayB,
    ArrayF,
    Dsm,
    Frame,
    GeometryError,
    InputError,
    LocalFrame,
    column,
    frame_of,
    open_raster,
    robust_sigma,
    table_kind,
    write_table,
)
from thalweg.core.values import Vectors, heights_in_words, horizontal_of, same_heights, vertical_of
from thalweg.deformation import torus_spectrum
from thalweg.settings.sections import DSM_ENDINGS

# ---------------------------------------------------------------- surfaces

SAME_GRID_CELLS = 0.05
"""Cells whose centres differ by less than this part of a cell are the same cell."""
RESAMPLING = ("nearest", "bilinear")

VOLUMES = table_kind(
    "surface_volumes",
    1,
    [
        column("part", "1", "which cells", pa.string()),
        column("n_cells", "1", "number of cells", pa.int64()),
        column("area_m2", "m2", "their area"),
        column("volume_m3", "m3", "second minus first surface, summed over the cells"),
        column("sigma_m3", "m3", "standard deviation of the volume"),
        column("low_m3", "m3", "lower end of the interval of 95 %"),
        column("high_m3", "m3", "upper end of the interval of 95 %"),
    ],
)
"""One row for each set of cells; cells that were not seen have an area and no volume."""
_WIDE = float(norm.isf(0.025))
"""Standard deviations of half an interval of 95 %."""

_DIFFERENCE_BANDS = ("difference_m", "sigma_m")


def volume_table(rows: Sequence[tuple[str, int, float, float, float]]) -> pd.DataFrame:
    """Table `VOLUMES` of part, number of cells, area, volume and its standard deviation (or NaN)."""
    names = [item.name for item in VOLUMES]
    table = pd.DataFrame(rows, columns=names[:5])
    half = _WIDE * table["sigma_m3"]
    table["low_m3"], table["high_m3"] = table["volume_m3"] - half, table["volume_m3"] + half
    return frame_of(VOLUMES, {name: table[name].to_numpy() for name in names})


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
    InputError : different frames or heights, or one that is not in metres.
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
    high = [each for each in stated if vertical_of(each.frame) is not None]
    for each in high:
        if not same_heights(high[0].frame, each.frame):
            raise InputError(
                f"{high[0].path} has heights of {heights_in_words(high[0].frame)}, "
                f"{each.path} of {heights_in_words(each.frame)}",
                expected="one system of heights",
                cure="Transform one of them before the comparison",
            )
    missing = [str(each.path) for each in placed if each.frame is None]
    notes = [f"No coordinate system in {', '.join(missing)}: taken as that of the other."] if missing else []
    silent = [
        str(each.path)
        for each in stated
        if isinstance(each.frame, CRS) and not vertical_of(each.frame) and not isinstance(each, Vectors)
    ]
    if high and silent:
        notes.append(
            f"No system of heights in {', '.join(silent)}: taken as {heights_in_words(high[0].frame)}."
        )
    return (high or stated)[0].frame if stated else None, notes


def onto_map(drawn: Sequence[Vectors], frame: Frame) -> list[Vectors]:
    """Areas and lines on the map of a raster or cloud; as they are beside one that states none.

    Raises
    ------
    InputError : places that this map does not have.
    """
    return [each.on_map(frame) if isinstance(frame, CRS) else each for each in drawn]


def _same(a: Frame, b: Frame) -> bool:
    """Whether two frames are one on the map."""
    if isinstance(a, LocalFrame) or isinstance(b, LocalFrame):
        return a == b
    one, two = (each and horizontal_of(each) for each in (a, b))
    return bool(one.equals(two, ignore_axis_order=True)) if one is not None else two is None


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
    spectrum = torus_spectrum(shape, cell_m, errors.correlation_m)
    near = irfft2(spectrum * rfft2(part, shape), shape)[: part.shape[0], : part.shape[1]]
    return area**2 * (float((part * near).sum()) + shared)


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
    second, apart = onto_grid(after, before, resample)
    notes = [*before.notes, *after.notes, *notes]
    if apart > 1e-6 * before.cell_m.max():
        notes.append(
            f"Centres of cells of the second raster lie up to {apart:.3f} m away from those of the first"
            + (f"; resampled: {resample}." if resample else " and count as the same.")
        )
    (east, north), size = after.axes_m(), before.cell_m * before.height_m.shape[::-1]
    across = (east > before.corner_m[0]) & (east < before.corner_m[0] + size[0])
    along = (north < before.corner_m[1]) & (north > before.corner_m[1] - size[1])
    if beyond := int(np.isfinite(after.height_m).sum() - np.isfinite(after.height_m[along][:, across]).sum()):
        notes.append(
            f"{beyond * after.cell_area_m2:,.1f} m2 of the second raster lie beyond the first and are in no "
            "part."
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
    limit = _WIDE * sigma

    def volume(part: str, cells: ArrayB, *, measured: bool = True) -> tuple[str, int, float, float, float]:
        """Row of the table: volume of a set of cells with its standard deviation, or its area alone."""
        n, area = int(cells.sum()), float(cells.sum()) * before.cell_area_m2
        if not measured:
            return part, n, area, np.nan, np.nan
        total = float(difference[cells].sum()) * before.cell_area_m2
        variance = sum(volume_variance(cells, before.cell_m, each) for each in stated)
        return part, n, area, total, float(np.sqrt(variance + (area * sigma_registration_m) ** 2))

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
    raster = replace(before, height_m=difference, frame=frame, notes=())
    return SurfaceDifference(raster, np.where(known, sigma, np.nan), volume_table(rows), notes)


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
    with open_raster(path) as file:
        names = tuple(file.descriptions)
        bands = file.read().astype(np.float64) if names == _DIFFERENCE_BANDS else None
        place, crs = file.transform, file.crs
    if bands is None:
        raise InputError(
            f"bands {', '.join(map(str, names))}", expected=" and ".join(_DIFFERENCE_BANDS), where=path
        )
    corner, cell = np.array([place.c, place.f]), np.array([place.a, -place.e])
    frame = None if crs is None else CRS.from_wkt(crs.to_wkt())
    return SurfaceDifference(Dsm(bands[0], corner, cell, frame, path), bands[1], volume_table([]), [])


def _write_bands(path: Path, grid: Dsm, bands: dict[str, ArrayF]) -> None:
    """A GeoTIFF of 32-bit bands with names."""
    import rasterio

    rows, columns = grid.height_m.shape
    (east, north), (width, height) = grid.corner_m.tolist(), grid.cell_m.tolist()
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        height=rows,
        width=columns,
        count=len(bands),
        dtype="float32",
        crs=None if grid.frame is None else grid.frame.to_wkt(),
        transform=rasterio.Affine(width, 0.0, east, 0.0, -height, north),
        nodata=float("nan"),
        compress="deflate",
    ) as out:
        for k, (name, values) in enumerate(bands.items(), 1):
            out.write(values.astype(np.float32), k)
            out.set_band_description(k, name)
