"""LAS/LAZ clouds: LAZ 1.4 written in a stream, read in chunks, frame and time scale always stated.

Files are point format 6, or 7 with colours; coordinates at 1 mm unless asked otherwise, times as adjusted
standard GPS time (``t_gps_s``), WKT in the projection VLR, and the local frame's origin as JSON in a VLR of
user id ``thalweg``. Quantities that LAS does not know are extra bytes whose description names the unit.

Scaling (LAS 1.4 R15, "Intensity", "Red, Green, Blue"): 16 bit = value x 65536 / range, so 8-bit
intensities and colours are multiplied by 256, 16-bit ones are stored as they are. Reading returns 16 bit.
"""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import laspy
import numpy as np
from laspy.header import GpsTimeType
from laspy.vlrs.known import WktCoordinateSystemVlr
from numpy.typing import ArrayLike

import thalweg
from thalweg.core.errors import GeometryError, InputError
from thalweg.core.las.chunks import check_chunks
from thalweg.core.las.columns import (
    OPTIONAL,
    ExtraDimension,
    check_extra_texts,
    columns_of,
    extra_params,
    integers,
    sixteen_bit,
)
from thalweg.core.las.header import (
    VLR_RECORD,
    VLR_USER,
    Frame,
    LazHeader,
    check_las_bytes,
    frame_json,
    frame_wkt,
    header_from_laspy,
    library_errors,
)
from thalweg.core.timescales import unix_from_gps
from thalweg.core.types import AnyArray, ArrayF

__all__ = ["LazHeader", "LazWriter", "iter_laz", "laz_header", "read_laz", "write_laz"]

_MAX_SCALE_M: Final = 0.01
_INT32: Final = np.iinfo(np.int32)


class LazWriter:
    """Streaming writer of a LAZ cloud; the file appears under its name only when it is complete.

    Parameters
    ----------
    path : target, ``.laz`` (or ``.las`` for an uncompressed file).
    frame : frame of the points: `LocalFrame`, a projected CRS, or None if unknown.
    scale_m : resolution of the coordinates, at most 0.01.
    extra_dimensions : name -> (type, description with unit[, scale]); an integer with a scale stores
        ``value / scale`` rounded.
    offset_m : (3,) offset of the coordinates; the rounded middle of the first chunk if None.

    Raises
    ------
    GeometryError : scale, frame or points that the file cannot hold.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from thalweg.core.frames import LocalFrame
    >>> folder = TemporaryDirectory()
    >>> path = Path(folder.name) / "cloud.laz"
    >>> with LazWriter(path, LocalFrame(lat_deg=51.0, lon_deg=13.0, h_ell_m=150.0)) as writer:
    ...     writer.append(np.array([[1.0, 2.0, 3.0]]), t_gps_s=np.array([178649913.4]))
    >>> columns, header = read_laz(path)
    >>> columns["xyz_m"], header.frame.lat_deg
    (array([[1., 2., 3.]]), 51.0)
    >>> folder.cleanup()
    """

    def __init__(
        self,
        path: Path,
        frame: Frame,
        *,
        scale_m: float = 0.001,
        extra_dimensions: Mapping[str, ExtraDimension] | None = None,
        offset_m: ArrayLike | None = None,
    ) -> None:
        if not 0 < scale_m <= _MAX_SCALE_M:
            raise GeometryError(f"scale_m={scale_m}", expected="above 0 and at most 0.01 m", where=path)
        self.path = path
        self.n_points = 0
        self._wkt = frame_wkt(frame)
        self._frame = frame
        self._scale_m = scale_m
        self._extra = dict(extra_dimensions or {})
        check_extra_texts(self._extra, path)
        self._offset = None if offset_m is None else np.asarray(offset_m, dtype=np.float64)
        self._columns: frozenset[str] = frozenset()
        self._header: Any = None
        self._writer: Any = None
        self._partial = path.with_name(f".{path.name}.partial")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()

    def append(
        self,
        xyz_m: ArrayLike,
        *,
        t_gps_s: ArrayLike | None = None,
        intensity: ArrayLike | None = None,
        rgb: ArrayLike | None = None,
        return_number: ArrayLike | None = None,
        number_of_returns: ArrayLike | None = None,
        classification: ArrayLike | None = None,
        point_source_id: ArrayLike | None = None,
        user_data: ArrayLike | None = None,
        extra: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        """Write points; every call must give the same columns.

        Parameters
        ----------
        xyz_m : (n, 3) in the frame of the file, finite.
        t_gps_s : (n,) adjusted standard GPS time, finite; leave it out if the points have no time.
        intensity : (n,) uint8 (stored x 256) or uint16.
        rgb : (n, 3) uint8 (stored x 256) or uint16.
        return_number, number_of_returns : (n,) from 1 to 15, 1 if left out.
        classification, point_source_id, user_data : (n,) as LAS names them, 0 if left out.
        extra : values of all extra dimensions.

        Raises
        ------
        GeometryError : coordinates or times that are not finite or do not fit the scale; columns of other
            length or type, or other columns than before.
        """
        xyz = np.asarray(xyz_m, dtype=np.float64)
        if xyz.ndim != 2 or xyz.shape[1] != 3:
            raise GeometryError(f"points of shape {xyz.shape}", expected="(n, 3)", where=self.path)
        columns: dict[str, AnyArray] = {}
        given: dict[str, ArrayLike | None] = {
            "t_gps_s": t_gps_s,
            "intensity": intensity,
            "rgb": rgb,
            "return_number": return_number,
            "number_of_returns": number_of_returns,
            "classification": classification,
            "point_source_id": point_source_id,
            "user_data": user_data,
            **(extra or {}),
        }
        for name, values in given.items():
            if values is not None:
                columns[name] = np.asarray(values)
                shape = (len(xyz), 3) if name == "rgb" else (len(xyz),)
                if columns[name].shape != shape:
                    raise GeometryError(
                        f"column '{name}' of shape {columns[name].shape}",
                        expected=str(shape),
                        where=self.path,
                    )
        if set(extra or {}) != set(self._extra):
            raise GeometryError(
                f"extra dimensions {sorted(extra or {})}", expected=str(sorted(self._extra)), where=self.path
            )
        if not len(xyz):
            return
        for name, values in (("xyz_m", xyz), ("t_gps_s", columns.get("t_gps_s", np.zeros(1)))):
            bad = int(np.size(values) - np.count_nonzero(np.isfinite(values)))
            if bad:
                raise GeometryError(
                    f"{bad} values of '{name}' are not finite",
                    expected="finite values",
                    where=self.path,
                    cure="Drop these points and count them",
                )
        if self._writer is None:
            self._open(xyz, columns)
        elif self._columns != frozenset(columns):
            raise GeometryError(
                f"columns {sorted(columns)}", expected=f"as before: {sorted(self._columns)}", where=self.path
            )
        self._writer.write_points(self._record(xyz, columns))
        self.n_points += len(xyz)

    def close(self) -> None:
        """Finish the file and give it its name; a cloud of no points is a valid file."""
        if self._writer is None:
            self._open(np.zeros((1, 3)), {name: np.zeros(1) for name in self._extra})
        self._writer.close()
        self._partial.replace(self.path)

    def abort(self) -> None:
        """Throw the unfinished file away; a file of an earlier run keeps standing."""
        if self._writer is not None:
            self._writer.dest.close()
        self._partial.unlink(missing_ok=True)

    def _open(self, xyz: ArrayF, columns: Mapping[str, AnyArray]) -> None:
        if self._offset is None:
            # whole metres: the grid of coordinates is then the same whatever the offset
            self._offset = np.round((xyz.min(axis=0) + xyz.max(axis=0)) / 2)
        header = laspy.LasHeader(point_format=7 if "rgb" in columns else 6, version="1.4")
        header.scales = np.full(3, self._scale_m)
        header.offsets = self._offset
        header.global_encoding.gps_time_type = GpsTimeType.STANDARD
        header.system_identifier = "thalweg"
        header.generating_software = f"thalweg {thalweg.__version__}"
        # The day of the data, not of the run: the same input gives the same bytes.
        t = columns.get("t_gps_s")
        header.creation_date = _date_of(float(t[0])) if t is not None else None
        header.add_extra_dims([extra_params(name, spec) for name, spec in self._extra.items()])
        header.global_encoding.wkt = True  # formats 6 and above demand the bit, with or without a CRS
        if self._wkt:
            header.vlrs.append(WktCoordinateSystemVlr(self._wkt))
        facts = frame_json(self._frame, has_time="t_gps_s" in columns)
        header.vlrs.append(laspy.VLR(VLR_USER, VLR_RECORD, "frame and format version, JSON", facts))
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._header, self._columns = header, frozenset(columns)
        self._writer = laspy.open(
            self._partial, mode="w", header=header, do_compress=self.path.suffix.lower() != ".las"
        )

    def _record(self, xyz: ArrayF, columns: Mapping[str, AnyArray]) -> Any:
        record = laspy.ScaleAwarePointRecord.zeros(len(xyz), header=self._header)
        for axis, name in enumerate("XYZ"):
            steps = np.rint((xyz[:, axis] - self._header.offsets[axis]) / self._scale_m)
            if steps.min() < _INT32.min or steps.max() > _INT32.max:
                worst = float(xyz[int(np.argmax(np.abs(steps))), axis])
                reach = self._scale_m * _INT32.max
                raise GeometryError(
                    f"{name.lower()} = {worst:.3f} m cannot be stored",
                    expected=f"within {reach:.0f} m of the offset {self._header.offsets[axis]:.0f} m "
                    f"(32 bit at a scale of {self._scale_m} m)",
                    where=self.path,
                    cure="Remove stray points, or take a coarser scale",
                )
            record.array[name] = steps.astype(np.int32)
        if "t_gps_s" in columns:
            record.array["gps_time"] = columns["t_gps_s"]
        if "intensity" in columns:
            record.array["intensity"] = sixteen_bit("intensity", columns["intensity"], self.path)
        if "rgb" in columns:
            rgb = sixteen_bit("rgb", columns["rgb"], self.path)
            for axis, name in enumerate(("red", "green", "blue")):
                record.array[name] = rgb[:, axis]
        one = np.ones(len(xyz), dtype=np.uint8)
        number, of = columns.get("return_number", one), columns.get("number_of_returns", one)
        if number.min() < 1 or of.max() > 15 or np.any(number > of):
            raise GeometryError(
                f"returns {number.min()}..{number.max()} of {of.min()}..{of.max()}",
                expected="1 <= return_number <= number_of_returns <= 15",
                where=self.path,
            )
        record["return_number"], record["number_of_returns"] = number, of
        for name, dtype in OPTIONAL.items():
            if name in columns:
                record[name] = integers(name, columns[name], np.dtype(dtype), self.path)
        for name, spec in self._extra.items():
            stored = np.dtype(spec[0])
            if stored.kind == "f":
                record.array[name] = columns[name]
            else:
                values = columns[name] / spec[2] if len(spec) == 3 else columns[name]
                record.array[name] = integers(name, values, stored, self.path)
        return record


def write_laz(
    path: Path,
    chunks: Iterable[Mapping[str, Any]],
    frame: Frame,
    *,
    scale_m: float = 0.001,
    extra_dimensions: Mapping[str, ExtraDimension] | None = None,
) -> int:
    """Write a cloud from chunks, each a mapping of the arguments of `LazWriter.append`; returns the count."""
    with LazWriter(path, frame, scale_m=scale_m, extra_dimensions=extra_dimensions) as writer:
        for chunk in chunks:
            writer.append(**chunk)
    return writer.n_points


def laz_header(path: Path) -> LazHeader:
    """Facts about a LAS/LAZ file without reading its points.

    Raises
    ------
    InputError : missing, no LAS file, or a damaged header.
    """
    check_las_bytes(path)
    with library_errors(path, "read the LAS header"), laspy.open(path) as reader:
        return header_from_laspy(reader.header, path)


def iter_laz(path: Path, chunk_points: int = 1_000_000) -> Iterator[dict[str, AnyArray]]:
    """Points of a LAS/LAZ file, chunk by chunk.

    Yields
    ------
    ``xyz_m`` (n, 3) float64; ``t_gps_s`` (n,) NaN if the file has no adjusted standard times (then
    ``t_week_s`` holds the second of an unstated GPS week, if any); ``intensity`` uint16, ``return_number``,
    ``number_of_returns``, ``classification``, ``point_source_id``, ``user_data``; ``rgb`` (n, 3) uint16 if
    there are colours; extra dimensions by name, scaled ones as float64.

    Raises
    ------
    InputError : not a LAS file, or fewer points than the header declares (after the whole chunks).
    """
    check_las_bytes(path)
    check_chunks(path)
    with library_errors(path, "read the LAS header"):
        reader = laspy.open(path)
    with reader:
        header = header_from_laspy(reader.header, path)
        done, present = 0, header.n_points
        if not reader.header.are_points_compressed:
            room = path.stat().st_size - reader.header.offset_to_point_data
            present = min(present, room // reader.header.point_format.size)
        while done < present:
            want = min(chunk_points, present - done)
            with library_errors(path, f"read points {done:,} to {done + want:,} of {header.n_points:,}"):
                points = reader.read_points(want)
                columns = columns_of(points, header)
            yield columns
            done += len(points)
            if len(points) < want:
                break
        if done < header.n_points:
            raise InputError(
                f"the file ends after {done:,} points",
                expected=f"{header.n_points:,} points as its header says",
                where=path,
                cure="Copy the file again from its source",
            )


def read_laz(path: Path) -> tuple[dict[str, AnyArray], LazHeader]:
    """All points of a LAS/LAZ file (the columns of `iter_laz`) and its header.

    Raises
    ------
    InputError : not a LAS file, or it is cut.
    """
    header = laz_header(path)
    chunks = list(iter_laz(path))
    if not chunks:
        empty = laspy.ScaleAwarePointRecord.zeros(0, header=_laspy_header(path))
        chunks = [columns_of(empty, header)]
    return {name: np.concatenate([chunk[name] for chunk in chunks]) for name in chunks[0]}, header


def _laspy_header(path: Path) -> Any:
    with laspy.open(path) as reader:
        return reader.header


def _date_of(t_gps_s: float) -> Any:
    return np.datetime64(int(unix_from_gps(t_gps_s)), "s").astype("datetime64[D]").item()
