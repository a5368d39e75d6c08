"""From a lidar log to a cloud on disk: streaming, every point counted."""

import hashlib
import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import ArrayLike
from pyproj import CRS

from thalweg.calibration import read_mounts
from thalweg.core import (
    AnyArray,
    ArrayF,
    ArrayF32,
    ArrayI,
    ArrayU8,
    CoverageError,
    ExtraDimension,
    InputError,
    LazWriter,
    LocalFrame,
    Rigid,
    Trajectory,
    column,
    frame_of,
    iter_laz,
    laz_header,
    steps,
    table_kind,
    write_table,
)
from thalweg.ingest import LidarClock, LidarReader, LogWindow, PointBlock
from thalweg.lidar.filters import (
    MOST_RADII,
    REMOVED,
    Occupancy,
    Reason,
    blocks_within,
    classify,
    count_reasons,
    reason_table,
    water_level_m,
)
from thalweg.lidar.georeference import WorldPoints, georeference_points
from thalweg.navigation.ins_gnss import beam_factors
from thalweg.settings.sections import Filters, Georeferencing, LidarAccuracy

SIGMAS: Final = ("sigma_east", "sigma_north", "sigma_up")
"""Extra dimensions with the standard deviations of a point along the axes of wcs, metres."""
CORRELATIONS: Final = ("corr_east_north", "corr_east_up", "corr_north_up")
"""Extra dimensions with the correlations of a point's coordinates; with `SIGMAS` its full covariance."""
EXTRA_DIMENSIONS: Final[dict[str, ExtraDimension]] = {
    "range": ("f4", "measured range, m"),
    "ring": ("u1", "beam by elevation, 0 lowest"),
    **dict.fromkeys(SIGMAS, ("u4", "standard deviation, m", 0.0001)),
}
"""Extra bytes of a georeferenced cloud: name -> (type, description, scale)."""
CORRELATION_DIMENSIONS: Final[dict[str, ExtraDimension]] = dict.fromkeys(
    CORRELATIONS, ("i2", "correlation", 0.0001)
)
"""Extra bytes of the full covariance, on request."""
MANY_BELOW_WATER: Final = 0.25
"""Share of points below the water that waves and mirror images do not explain."""
_CHUNK: Final = 1_000_000
_LOG = logging.getLogger("thalweg")

_WCS = ("east", "north", "up")
REMOVED_POINTS: Final = table_kind(
    "removed_points",
    1,
    [
        column("reason", "1", "name of thalweg.lidar.filters.Reason in small letters", pa.string()),
        column("t_gps_s", "s", "adjusted standard GPS time of the shot; NaN without"),
        *(column(f"{a}_m", "m", f"{a} in wcs; NaN without a pose") for a in _WCS),
        *(column(f"{a}_ics_m", "m", f"{a} in the body frame", pa.float32()) for a in "xyz"),
        column("range_m", "m", "measured range", pa.float32()),
    ],
)
"""An even sample of the points that were left out, so many at most for each reason."""


# ---------------------------------------------------------------- cloud


@dataclass(frozen=True, slots=True, kw_only=True)
class LogSettings:
    """How a lidar log becomes a cloud.

    Parameters
    ----------
    mount : pose of the scanner on the boat with its covariance.
    beam : accuracy of a single measurement.
    filters : which points are left out.
    min_range_m, max_range_m : shorter and longer ranges are left out.
    laz_scale_m : resolution of the coordinates.
    correlations : write the correlations of each point's coordinates too.
    chunk_points : points held at a time.
    """

    mount: Rigid
    beam: LidarAccuracy
    filters: Filters
    min_range_m: float
    max_range_m: float
    laz_scale_m: float = Georeferencing().laz_scale_m
    correlations: bool = False
    chunk_points: int = Georeferencing().chunk_points

    @classmethod
    def of_survey(
        cls,
        mounts: Path,
        error_model: Path,
        clock: LidarClock,
        accuracy: LidarAccuracy,
        filters: Filters,
        georeferencing: Mapping[str, Any],
    ) -> Self:
        """Those of a survey: files of its mounts and errors, clock of the log, sections of its settings."""
        return cls(
            mount=Rigid.from_mount(read_mounts(mounts)["lidar"]),
            beam=accuracy.scaled(**beam_factors(error_model)).with_clock(clock.sigma_s),
            filters=filters,
            **georeferencing,
        )


def georeference_log(
    reader: LidarReader,
    clock: LidarClock,
    trajectory: Trajectory,
    settings: LogSettings,
    out: Path,
    *,
    out_removed: Path | None = None,
) -> pd.DataFrame:
    """Stream a lidar log into a LAZ cloud in the world frame; memory does not grow with the log.

    The log is decoded twice where a filter has to know what lies about a point: the first pass counts points
    in a sparse grid, the second one writes.

    Parameters
    ----------
    reader : the log, see `thalweg.ingest.registry.lidar.lidar_reader`.
    clock : GPS time of each packet, from the reader's scan.
    trajectory : poses of the boat with their covariance.
    settings : mount, accuracy, filters.
    out : target, ``.laz``.
    out_removed : where to write a sample of the points that were left out, table kind ``removed_points``.

    Returns
    -------
    What became of the points, see `thalweg.lidar.filters.reason_table`; the numbers add up to all that were
    decoded.

    Raises
    ------
    CoverageError : no point is left.
    """
    occupancy = None
    if settings.filters.needs_occupancy:
        occupancy, _ = _count_neighbours(reader, clock, trajectory, settings)
        occupancy.freeze()
    with _writer(out, trajectory, settings) as writer:
        counts, removed = _write_window(reader, clock, trajectory, settings, writer, occupancy)
        _check_left(counts, reader.files)
    if out_removed is not None:
        write_table(out_removed, removed.table(), REMOVED_POINTS)
    return reason_table(counts)


def write_density(
    reader: LidarReader,
    clock: LidarClock,
    trajectory: Trajectory,
    settings: LogSettings,
    window: LogWindow,
    out: Path,
) -> None:
    """First pass over a window of a log, as a file for `georeference_window`.

    Parameters
    ----------
    reader, clock, trajectory, settings : as for `georeference_log`.
    window : which part of the log.
    out : ``.npz``: blocks of the grid, and the box of east and north about all that the filters look at.
    """
    occupancy = Occupancy(settings.filters.isolated_radius_m)
    box = np.array([np.full(2, np.inf), np.full(2, -np.inf)])
    if settings.filters.needs_occupancy:
        occupancy, box = _count_neighbours(reader, clock, trajectory, settings, window)
    keys, counts = occupancy.blocks()
    np.savez_compressed(out, keys=keys, counts=counts, box_en_m=box)


def _count_neighbours(
    reader: LidarReader,
    clock: LidarClock,
    trajectory: Trajectory,
    settings: LogSettings,
    window: LogWindow | None = None,
) -> tuple[Occupancy, ArrayF]:
    """First pass over a log or a window of it: the points about each place, and the box (2, 2) of east and
    north about all places that will be asked for.
    """
    occupancy = Occupancy(settings.filters.isolated_radius_m)
    low_m, high_m = np.full(2, np.inf), np.full(2, -np.inf)
    blocks = reader.points(clock, max_points=settings.chunk_points, window=window)
    for block in steps(blocks, "density, block"):
        first = _classified(block, trajectory, settings, None)
        occupancy.add(first.points.points_wcs_m, first.reasons == Reason.KEPT)
        if window is not None:
            asked = (first.reasons == Reason.KEPT) | (first.reasons == Reason.BELOW_WATER)
            en_m = first.points.points_wcs_m[asked, :2]
            low_m = np.minimum(low_m, en_m.min(axis=0, initial=np.inf))
            high_m = np.maximum(high_m, en_m.max(axis=0, initial=-np.inf))
    reach_m = MOST_RADII * occupancy.radius_m + occupancy.cell_m
    return occupancy, np.array([low_m - reach_m, high_m + reach_m])


def georeference_window(
    reader: LidarReader,
    clock: LidarClock,
    trajectory: Trajectory,
    settings: LogSettings,
    window: LogWindow,
    densities: Sequence[Path],
    out: Path,
    out_rest: Path,
) -> None:
    """Second pass over a window of a log, knowing the first pass over all windows.

    Parameters
    ----------
    reader, clock, trajectory, settings : as for `georeference_log`.
    window : which part of the log.
    densities : of all windows, see `write_density`. Of them only what lies about this window's stretch of
        the trajectory is held.
    out : points, ``.las``; for `join_windows`.
    out_rest : what was left out of it, ``.npz``.
    """
    occupancy = None
    if settings.filters.needs_occupancy:
        occupancy = Occupancy(settings.filters.isolated_radius_m)
        with np.load(densities[window.index]) as own:
            box_en_m = own["box_en_m"]
        for path in densities:
            with np.load(path) as found:
                keys, counts = found["keys"], found["counts"]
            near = blocks_within(keys, occupancy.cell_m, *box_en_m)
            occupancy.add_blocks(keys[near], counts[near])
        occupancy.freeze()
    with _writer(out, trajectory, settings) as writer:
        n, removed = _write_window(reader, clock, trajectory, settings, writer, occupancy, window)
    np.savez(out_rest, n=n, sha256=_sha256(out), **removed.arrays())


def join_windows(
    points: Sequence[Path],
    rests: Sequence[Path],
    trajectory: Trajectory,
    settings: LogSettings,
    out: Path,
    *,
    out_removed: Path,
    log_files: Sequence[Path],
) -> pd.DataFrame:
    """The cloud of a log from those of its windows in their order: the same bytes as by `georeference_log`.

    Parameters
    ----------
    points, rests : of `georeference_window`, in the order of the windows.
    trajectory, settings, out, out_removed : as for `georeference_log`.
    log_files : of the log, for messages.

    Returns
    -------
    As `georeference_log`.

    Raises
    ------
    CoverageError : no point is left.
    InputError : the points of a window have changed since.
    """
    counts, removed = np.zeros(len(Reason), dtype=np.int64), RemovedSample()
    for path, rest in zip(points, rests, strict=True):
        with np.load(rest) as found:
            counts += found["n"]
            removed.add_arrays(found)
            if str(found["sha256"]) != _sha256(path):
                raise InputError(
                    "the points of a window are not those that its job wrote",
                    expected=f"a file of SHA-256 {found['sha256']}",
                    where=path,
                    cure="Remove it, so that it is made again",
                )
    with _writer(out, trajectory, settings) as writer:
        for path in points:
            for chunk in iter_laz(path, settings.chunk_points):
                writer.append(**columns_to_write(chunk, extra_dimensions(settings)))
        _check_left(counts, log_files)
    write_table(out_removed, removed.table(), REMOVED_POINTS)
    return reason_table(counts)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def columns_to_write(chunk: Mapping[str, AnyArray], extra: Iterable[str]) -> dict[str, Any]:
    """Columns of `iter_laz` of a georeferenced cloud as arguments of `LazWriter.append`."""
    names = ("xyz_m", "t_gps_s", "intensity", "return_number", "number_of_returns")
    return {name: chunk[name] for name in names} | {"extra": {name: chunk[name] for name in extra}}


def extra_dimensions(settings: LogSettings) -> dict[str, ExtraDimension]:
    """Extra dimensions of a cloud that is made so."""
    return EXTRA_DIMENSIONS | (CORRELATION_DIMENSIONS if settings.correlations else {})


def _writer(out: Path, trajectory: Trajectory, settings: LogSettings) -> LazWriter:
    """Writer of a georeferenced cloud, its offset in whole metres amid the boat's way."""
    way_m = trajectory.position_wcs_m[trajectory.valid]
    return LazWriter(
        out,
        trajectory.frame,
        scale_m=settings.laz_scale_m,
        extra_dimensions=extra_dimensions(settings),
        offset_m=np.round((way_m.min(axis=0) + way_m.max(axis=0)) / 2) if len(way_m) else np.zeros(3),
    )


def _write_window(
    reader: LidarReader,
    clock: LidarClock,
    trajectory: Trajectory,
    settings: LogSettings,
    writer: LazWriter,
    occupancy: Occupancy | None,
    window: LogWindow | None = None,
) -> tuple[ArrayI, "RemovedSample"]:
    """Write the points of a log or of a window of it; number of each reason (10,), sample of the others."""
    counts, removed = np.zeros(len(Reason), dtype=np.int64), RemovedSample()
    blocks = reader.points(clock, max_points=settings.chunk_points, window=window)
    for block in steps(blocks, "cloud, block"):
        found = _classified(block, trajectory, settings, occupancy)
        counts += count_reasons(found.reasons)
        keep = found.reasons == Reason.KEPT
        removed.add(
            found.reasons,
            t_gps_s=block.t_gps_s,
            points_wcs_m=found.points.points_wcs_m,
            x_ics_m=found.x_ics_m,
            range_m=block.range_m,
        )
        if keep.any():
            kept = found.points.where(keep)
            values = {"range": block.range_m[keep], "ring": block.ring[keep]}
            values |= dict(zip(SIGMAS, kept.sigmas_m().T, strict=True))
            if settings.correlations:
                values |= dict(zip(CORRELATIONS, kept.correlations().T, strict=True))
            writer.append(
                kept.points_wcs_m,
                t_gps_s=block.t_gps_s[keep],
                intensity=block.intensity[keep],
                return_number=block.return_number[keep],
                number_of_returns=block.n_returns[keep],
                extra=values,
            )
    return counts, removed


def _check_left(counts: ArrayI, log_files: Sequence[Path]) -> None:
    """Refuse a cloud of no points, and tell of water where there should be none."""
    if not counts[Reason.KEPT]:
        table = reason_table(counts).query("n > 0")
        what = ", ".join(f"{row.n:,} {row.reason}" for row in table.itertuples()) or "no points at all"
        raise CoverageError(
            f"none of {counts.sum():,} lidar points is left: {what}",
            expected="a trajectory that covers the lidar log, and filters that leave something",
            where=", ".join(str(f) for f in log_files),
            cure=_cure(Reason(int(np.argmax(counts)))),
        )
    _warn_of_water(counts)


@dataclass(frozen=True, slots=True, kw_only=True)
class LogSample:
    """Points of a span of a log: ``xyz_wcs_m`` (n, 3), ``t_gps_s``, ``range_m`` and ``reflectivity`` (n,)."""

    xyz_wcs_m: ArrayF
    t_gps_s: ArrayF
    range_m: ArrayF
    reflectivity: ArrayF


def sample_log(
    reader: LidarReader,
    clock: LidarClock,
    trajectory: Trajectory,
    settings: LogSettings,
    windows: Sequence[tuple[float, float]],
    max_points: int = 400_000,
) -> list[LogSample]:
    """Points above the water of some spans of a log, without a cloud on disk.

    Parameters
    ----------
    reader, clock, trajectory, settings : as for `georeference_log`; single points are not looked for.
    windows : start and length of each span, GPS seconds.
    max_points : a random sample of so many points a span, the same in each run.
    """
    parts: list[list[ArrayF]] = [[np.empty((0, 6))] for _ in windows]
    for block in reader.points(clock, max_points=settings.chunk_points):
        for part, (start_s, length_s) in zip(parts, windows, strict=True):
            inside = (block.t_gps_s >= start_s) & (block.t_gps_s < start_s + length_s)
            if not inside.any():
                continue
            part.append(kept_points(block.where(inside), trajectory, settings))
    samples = []
    for part in parts:
        rows = np.concatenate(part)
        if len(rows) > max_points:
            some = np.sort(np.random.default_rng(len(rows)).choice(len(rows), max_points, replace=False))
            rows = rows[some]
        samples.append(
            LogSample(xyz_wcs_m=rows[:, :3], t_gps_s=rows[:, 3], range_m=rows[:, 4], reflectivity=rows[:, 5])
        )
    return samples


def kept_points(block: PointBlock, trajectory: Trajectory, settings: LogSettings) -> ArrayF:
    """Rows (n, 6) of the points above the water: east, north, up, time, range, reflectivity."""
    found = _classified(block, trajectory, settings, None)
    columns = (found.points.points_wcs_m, block.t_gps_s, block.range_m, block.intensity)
    return np.asarray(np.column_stack(columns)[found.reasons == Reason.KEPT])


def _warn_of_water(counts: ArrayI) -> None:
    """Say so if an unlikely share of the points lies below the water: is it where it is thought to be?"""
    wet = int(counts[Reason.BELOW_WATER] + counts[Reason.MIRROR_GHOST])
    share = wet / max(wet + int(counts[Reason.KEPT]), 1)
    if share > MANY_BELOW_WATER:
        _LOG.warning(
            "%.0f %% of the points lie below the water level at the boat. Check filters.water_line_ics_m and "
            "the heights of the positions; below a weir set filters.below_water_m to null",
            100 * share,
        )


def _cure(most: Reason) -> str:
    """What to do if nothing is left, by the reason that took most."""
    match most:
        case Reason.NO_GPS_TIME | Reason.NO_POSE:
            return "Look at streams.csv: do the streams overlap, and is the lidar synchronised"
        case Reason.TOO_NEAR | Reason.TOO_FAR:
            return "Widen georeferencing.min_range_m and georeferencing.max_range_m"
        case _:
            return f"Relax the section filters: most points were left out as {most.name.lower()}"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Classified:
    """Points of a block in the world and in the body frame, and the reason of each to be left out."""

    points: WorldPoints
    x_ics_m: ArrayF32
    reasons: ArrayU8


def _classified(
    block: PointBlock, trajectory: Trajectory, settings: LogSettings, occupancy: Occupancy | None
) -> _Classified:
    filters = settings.filters
    points = georeference_points(
        block.xyz_scs_m,
        block.t_gps_s,
        trajectory,
        settings.mount,
        beam=settings.beam,
        range_m=block.range_m,
        reflectivity=block.intensity,
    )
    sigmas_m = points.sigmas_m()
    x_ics_m = in_body(block.xyz_scs_m, settings.mount)
    reasons = classify(
        timed=np.isfinite(block.t_gps_s),
        has_pose=points.has_pose,
        range_m=block.range_m,
        x_ics_m=x_ics_m,
        points_wcs_m=points.points_wcs_m,
        water_level_m=water_level_m(block.t_gps_s, trajectory, filters.water_line_ics_m),
        settings=filters,
        min_range_m=settings.min_range_m,
        max_range_m=settings.max_range_m,
        sigma_max_m=sigmas_m.max(axis=1) if filters.max_sigma_m is not None else None,
        sigma_up_m=_sigma_above_boat_m(points, block.t_gps_s, trajectory),
        occupancy=occupancy,
    )
    return _Classified(points=points, x_ics_m=x_ics_m, reasons=reasons)


def _sigma_above_boat_m(points: WorldPoints, t_gps_s: ArrayF, trajectory: Trajectory) -> ArrayF:
    """Standard deviation (n,) of points' heights above the boat: its own error of height is in both."""
    cov = np.square(points.sigmas_m()[:, 2], dtype=np.float64)
    of_boat = np.interp(t_gps_s, trajectory.t_gps_s, trajectory.cov_pose_wcs[:, 2, 2])
    return np.sqrt(np.maximum(cov - of_boat, 0.0))


def in_body(xyz_scs_m: ArrayF32, mount: Rigid) -> ArrayF32:
    """Points (n, 3) of the scanner in the body frame ics, float32."""
    R, lever = mount.R.astype(np.float32), mount.shift_m.astype(np.float32)
    x, y, z = xyz_scs_m.T
    out = np.empty_like(xyz_scs_m)
    for i in range(3):  # a matrix product would wake the threads of BLAS, which costs more than it does
        out[:, i] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z + lever[i]
    return out


def export_map(points: Path, out: Path, crs: str, chunk_points: int = Georeferencing().chunk_points) -> None:
    """Write a cloud of the world frame in map coordinates with ellipsoidal heights.

    Standard deviations and correlations are copied: they refer to true east and north, from which the axes of
    the grid differ by the meridian convergence.

    Parameters
    ----------
    points : LAZ in the local frame.
    out : target LAZ.
    crs : projected CRS.

    Raises
    ------
    InputError : the cloud is not in a local frame of Thalweg.
    GeometryError : the CRS is no map projection.
    """
    header = laz_header(points)
    frame = header.frame
    if not isinstance(frame, LocalFrame):
        raise InputError(
            "the cloud is not in a local frame", where=points, expected="a cloud made by Thalweg"
        )
    target = CRS.from_user_input(crs)
    known = EXTRA_DIMENSIONS | CORRELATION_DIMENSIONS
    extra = {name: known[name] for name in header.extra_dimensions if name in known}
    with LazWriter(out, target, scale_m=header.scale_m, extra_dimensions=extra) as writer:
        for chunk in iter_laz(points, chunk_points):
            columns = columns_to_write(chunk, extra)
            writer.append(**columns | {"xyz_m": frame.to_map(chunk["xyz_m"], target)})


def sample_cloud(points: Path, max_points: int) -> dict[str, AnyArray]:
    """An even sample of a cloud for pictures and checks: every k-th point, at most ``max_points`` of them.

    Returns
    -------
    ``xyz_m`` (n, 3), ``t_gps_s``, ``intensity``, ``range``, ``ring`` and the other dimensions of the cloud.
    """
    step = -(-laz_header(points).n_points // max_points)
    parts: list[dict[str, AnyArray]] = []
    first = 0
    for chunk in iter_laz(points):
        n = len(chunk["t_gps_s"])
        # copies: a view would keep the whole piece
        parts.append({name: values[first::step].copy() for name, values in chunk.items()})
        first = (first - n) % step
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def cloud_covariance(cloud: Mapping[str, AnyArray], path: Path) -> ArrayF:
    """Covariance (n, 3, 3) that the points of a cloud carry.

    Raises
    ------
    InputError : the cloud has no standard deviations or no correlations.
    """
    lacking = [name for name in (*SIGMAS, *CORRELATIONS) if name not in cloud]
    if lacking:
        raise InputError(
            f"the cloud has no {', '.join(lacking)}",
            expected="standard deviations and correlations of each point",
            where=path,
            cure="Set georeferencing.correlations to true and georeference again",
        )
    sigma = np.stack([cloud[name] for name in SIGMAS], axis=1).astype(np.float64)
    correlation = np.tile(np.eye(3), (len(sigma), 1, 1))
    for name, i, j in zip(CORRELATIONS, (0, 0, 1), (1, 2, 2), strict=True):
        correlation[:, i, j] = correlation[:, j, i] = cloud[name]
    return np.asarray(correlation * sigma[:, :, None] * sigma[:, None, :])


# ---------------------------------------------------------------- a sample of the points that were removed


class RemovedSample:
    """An even sample of the removed points of each reason, of bounded size, from a log of unknown length.

    A hash of a point's time and place on the boat decides: those below a threshold stay, and when they become
    too many the threshold is halved. So each point has the same chance, the sample does not depend on the
    pieces in which the log comes, nor on whether one job saw them all, and holds about half of ``most``
    points or more. Every k-th point would not do: a scanner of 16 lasers repeats itself.

    Parameters
    ----------
    most : points kept at most for each reason.
    """

    def __init__(self, most: int = 20_000) -> None:
        self.most = most
        self._threshold: dict[Reason, int] = dict.fromkeys(REMOVED, 1 << 64)
        self._hashes: dict[Reason, AnyArray] = {r: np.empty(0, np.uint64) for r in REMOVED}
        self._rows: dict[Reason, ArrayF] = {r: np.empty((0, 8)) for r in REMOVED}

    def add(
        self,
        reasons: ArrayU8,
        *,
        t_gps_s: ArrayLike,
        points_wcs_m: ArrayLike,
        x_ics_m: ArrayLike,
        range_m: ArrayLike,
    ) -> None:
        """Take part of the removed points of a chunk.

        Parameters
        ----------
        reasons : (n,) from `classify` with the grid.
        t_gps_s, points_wcs_m, x_ics_m, range_m : (n,), (n, 3), (n, 3), (n,) of the same points.
        """
        columns = [np.asarray(values) for values in (t_gps_s, points_wcs_m, x_ics_m, range_m)]
        for reason in REMOVED:
            index = np.flatnonzero(reasons == reason)
            if not len(index):
                continue
            t_gps_s, _, x_ics_m, _ = (values[index] for values in columns)
            hashes = _stirred(t_gps_s.astype(np.float64).view(np.uint64))
            for axis in x_ics_m.T.astype(np.float64):
                hashes = _stirred(hashes ^ axis.view(np.uint64))
            drawn = hashes <= np.uint64(self._threshold[reason] - 1)
            rows = np.column_stack([values[index[drawn]] for values in columns])
            self._add(reason, hashes[drawn], rows)

    def _add(self, reason: Reason, hashes: AnyArray, rows: ArrayF) -> None:
        """Take points of a reason in whose hashes (n,) lie below the threshold, and halve it as need be."""
        hashes = np.concatenate([self._hashes[reason], hashes])
        rows = np.concatenate([self._rows[reason], rows])
        while len(hashes) > self.most:
            self._threshold[reason] //= 2
            stay = hashes <= np.uint64(self._threshold[reason] - 1)
            hashes, rows = hashes[stay], rows[stay]
        self._hashes[reason], self._rows[reason] = hashes, rows

    def arrays(self) -> dict[str, Any]:
        """The sample of a part of a log as arrays, for `add_arrays`."""
        parts = {"hashes": self._hashes, "rows": self._rows}
        return {f"{name}_{r}": part[r] for name, part in parts.items() for r in REMOVED}

    def add_arrays(self, arrays: Mapping[str, AnyArray]) -> None:
        """Take in the sample of the next part of the log: what comes out is the sample of both."""
        for reason in REMOVED:
            hashes, rows = arrays[f"hashes_{reason}"], arrays[f"rows_{reason}"]
            drawn = hashes <= np.uint64(self._threshold[reason] - 1)
            self._add(reason, hashes[drawn], rows[drawn])

    def table(self) -> pd.DataFrame:
        """The sample as a table of kind ``removed_points``: reason by reason, in the order of the log."""
        rows = np.concatenate([self._rows[reason] for reason in REMOVED])
        names = [name for name in REMOVED_POINTS.names if name != "reason"]
        reason = [r.name.lower() for r in REMOVED for _ in range(len(self._rows[r]))]
        return frame_of(REMOVED_POINTS, {"reason": reason, **dict(zip(names, rows.T, strict=True))})


def _stirred(numbers: AnyArray) -> AnyArray:
    """Hash of (n,) uint64 numbers, even over all 64 bits: SplitMix64 (Steele, Lea and Flood 2014)."""
    z = numbers.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))
