"""LAS/LAZ clouds: LAZ 1.4 written in a stream, read in chunks, frame and time scale always stated.

Files are point format 6, or 7 with colours; coordinates at 1 mm unless asked otherwise, times as adjusted
standard GPS time (``t_gps_s``), WKT in the projection VLR, and the local frame's origin as JSON in a VLR of
user id ``thalweg``. Quantities that LAS does not know are extra bytes whose description names the unit.

Scaling (LAS 1.4 R15, "Intensity", "Red, Green, Blue"): 16 bit = value x 65536 / range, so 8-bit
intensities and colours are multiplied by 256, 16-bit ones are stored as they are. Reading returns 16 bit.
"""

import contextlib
import json
import logging
import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Final, Self, TypeAlias

import laspy
import lazrs
import numpy as np
from laspy.header import GpsTimeType
from laspy.vlrs.known import WktCoordinateSystemVlr
from numpy.typing import ArrayLike
from pyproj import CRS
from pyproj.exceptions import CRSError

import thalweg
from thalweg.core.documents import parse_json
from thalweg.core.errors import GeometryError, InputError, ThalwegError, require_file
from thalweg.core.frames import LocalFrame
from thalweg.core.timescales import unix_from_gps
from thalweg.core.types import AnyArray, ArrayB, ArrayF
from thalweg.core.values import Stated, crs_of_geokeys, horizontal_of, in_metres

log = logging.getLogger("thalweg")
__all__ = ["LazHeader", "LazWriter", "iter_laz", "laz_header", "read_laz"]
_MAX_SCALE_M: Final = 0.01
_INT32: Final = np.iinfo(np.int32)

Frame: TypeAlias = LocalFrame | CRS | None


def frame_in_words(frame: Frame) -> str:
    """A frame for a message: of a coordinate system its name, without its kilobyte of WKT."""
    return frame.name if isinstance(frame, CRS) else str(frame)


"""Frame of a cloud: the local world frame, a map projection, or unknown."""
VLR_USER: Final = "thalweg"
VLR_RECORD: Final = 1
FORMAT_VERSION: Final = 1
"""Version of the JSON in the VLR (user id ``thalweg``, record 1); raised when a reader would misread it."""
_HEADER_SIZE: Final = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375}
_POINT_SIZE: Final = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
# Far above any real record (a hundred doubles as extra bytes); a damaged length must not ask for gigabytes.
_MAX_POINT_SIZE: Final = 1024
_LARGEST_SCALE, _LARGEST_OFFSET = 1e4, 1e11
"""Of coordinates: the Earth is 4e7 m around, 4e10 mm."""
_MOST_IN_CHUNK: Final = 1 << 26
_VARIABLE_CHUNKS: Final = 0xFFFFFFFF

ExtraDimension = tuple[str, str] | tuple[str, str, float]
"""Type (numpy code such as ``f4``, ``u1``), description with unit, and optionally the scale of an integer."""
OPTIONAL: Final = {"classification": np.uint8, "point_source_id": np.uint16, "user_data": np.uint8}
"""LAS dimensions that may be given and are read back under their own names."""
_TEXT_BYTES: Final = 32

_LAYERED: Final = 3
_COMPRESSORS: Final = (1, 2, 3)
_LAYERS: Final = {10: 9, 11: 1, 12: 2, 13: 1}
_BYTES_LAYERED: Final = 14
_WKT, _GEO_KEYS, _GEO_DOUBLES, _GEO_TEXT, _PROJECTED = 2112, 34735, 34736, 34737, 3072
_FARTHEST_M: Final = 1e9
_NOISE: Final = {7: "points_of_class_7_noise", 18: "points_of_class_18_noise"}
"""Classes of the ASPRS for low and high points that are none of a surface."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LazHeader:
    """Facts about a LAS/LAZ file, without its points.

    ``frame`` is a `LocalFrame`, a CRS or None; ``extra_dimensions`` maps name to (type, description);
    ``standard_time`` is true if times are adjusted standard GPS times; ``has_time`` is false if the
    writer stated that there are none; ``format_version`` is 0 for a foreign file. Of a foreign file scales
    and offsets are in metres, whatever its unit (degrees stay degrees); ``notes`` are sentences about what
    it states and what not. ``box_m`` (2, 3) holds the lowest and highest coordinates that the header states.
    """

    n_points: int
    frame: Frame
    scale_m: float
    scales_m: tuple[float, float, float]
    offsets_m: tuple[float, float, float]
    point_format: int
    standard_time: bool
    has_time: bool
    extra_dimensions: Mapping[str, tuple[str, str]]
    format_version: int
    notes: tuple[str, ...] = ()
    box_m: ArrayF | None = None


# ---------------------------------------------------------------- files


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
        for text in (text for name, spec in self._extra.items() for text in (name, spec[1])):
            if len(text.encode()) > _TEXT_BYTES:
                raise GeometryError(
                    f"'{text}' has {len(text.encode())} bytes",
                    expected=f"at most {_TEXT_BYTES} (LAS extra bytes)",
                    where=path,
                )
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
        for vlr in self._writer.header.vlrs.get("ExtraBytesVlr"):
            for found in vlr.extra_bytes_structs:
                # laspy 2.7 takes the first point of each piece for its extremes: better state none
                found.options &= ~(found.MIN_BIT_MASK | found.MAX_BIT_MASK)
                found._min[:] = found._max[:] = type(found._min)()
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
        header.creation_date = None
        if t is not None:
            second = np.datetime64(int(unix_from_gps(float(t[0]))), "s")
            header.creation_date = second.astype("datetime64[D]").item()
        header.add_extra_dims(
            [
                laspy.ExtraBytesParams(
                    name=name,
                    type=np.dtype(spec[0]),
                    description=spec[1],
                    scales=np.array(spec[2:]) if len(spec) == 3 else None,
                    offsets=np.zeros(1) if len(spec) == 3 else None,
                )
                for name, spec in self._extra.items()
            ]
        )
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


def laz_header(path: Path) -> LazHeader:
    """Facts about a LAS/LAZ file without reading its points.

    Raises
    ------
    InputError : missing, no LAS file, or a damaged header.
    """
    check_las_bytes(path)
    with library_errors(path, "read the LAS header"), laspy.open(path) as reader:
        return header_from_laspy(reader.header, path)


def iter_laz(
    path: Path, chunk_points: int = 1_000_000, left_out: Counter[str] | None = None
) -> Iterator[dict[str, AnyArray]]:
    """Points of a LAS/LAZ file, chunk by chunk.

    Of foreign files points that are marked as none of the surface (withheld, synthetic, noise of class 7 and
    18) are left out; their numbers are added to ``left_out``, or told in the log where there is none.

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
        counts: Counter[str] = Counter() if left_out is None else left_out
        done, present = 0, header.n_points
        if not reader.header.are_points_compressed:
            room = path.stat().st_size - reader.header.offset_to_point_data
            present = min(present, room // reader.header.point_format.size)
        while done < present:
            want = min(chunk_points, present - done)
            with library_errors(path, f"read points {done:,} to {done + want:,} of {header.n_points:,}"):
                points = reader.read_points(want)
                n = len(points)
                if not header.format_version:
                    points = _kept(points, counts)
                columns = columns_of(points, header)
            if len(points):
                yield columns
            done += n
            if n < want:
                break
        if left_out is None:
            for what, n in counts.items():
                log.warning("%s: %s %s left out.", path.name, f"{n:,}", what.replace("_", " "))
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
        with laspy.open(path) as reader:
            empty = laspy.ScaleAwarePointRecord.zeros(0, header=reader.header)
        chunks = [columns_of(empty, header)]
    return {name: np.concatenate([chunk[name] for chunk in chunks]) for name in chunks[0]}, header


# ---------------------------------------------------------------- header: frame, CRS, plausibility
#
# Sources: LAS 1.4 specification R15 (public header block table 3, VLR header table 4, coordinate reference
# systems section 2.4); OGC 18-010r11 (WKT2 engineering CRS).


def local_crs(frame: LocalFrame) -> CRS:
    """Engineering CRS of a local frame, its geodetic origin in the name of the datum.

    Examples
    --------
    >>> crs = local_crs(LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0))
    >>> crs.is_engineering, crs.axis_info[2].direction
    (True, 'up')
    """
    origin = f"lat {frame.lat_deg!r} deg, lon {frame.lon_deg!r} deg, ellipsoidal height {frame.h_ell_m!r} m"
    axes = "".join(
        f'AXIS["{name}",{name},ORDER[{order}],LENGTHUNIT["metre",1]],'
        for order, name in enumerate(("east", "north", "up"), start=1)
    )
    return CRS.from_wkt(
        'ENGCRS["Thalweg local east-north-up",'
        f'EDATUM["Topocentric origin at {origin} (WGS 84)"],CS[Cartesian,3],{axes.rstrip(",")}]'
    )


def frame_wkt(frame: Frame) -> str:
    """WKT for the projection VLR: WKT1 as LAS 1.4 asks where it can say the CRS, else WKT2.

    Raises
    ------
    GeometryError : the CRS is geographic or geocentric: coordinates must be metric.
    """
    if frame is None:
        return ""
    if isinstance(frame, LocalFrame):
        return local_crs(frame).to_wkt("WKT2_2019")
    if not (frame.is_projected or frame.is_engineering):
        raise GeometryError(
            f"a cloud in '{frame.name}' ({frame.type_name})",
            expected="a local frame or a projected CRS, in metres",
            cure="Transform the points first",
        )
    try:
        return frame.to_wkt("WKT1_GDAL")
    except CRSError:
        return frame.to_wkt("WKT2_2019")


def frame_json(frame: Frame, *, has_time: bool) -> bytes:
    """Content of Thalweg's own VLR."""
    content: dict[str, Any] = {"format_version": FORMAT_VERSION, "has_time": has_time}
    if isinstance(frame, LocalFrame):
        content["local_frame"] = {
            "lat_deg": frame.lat_deg,
            "lon_deg": frame.lon_deg,
            "h_ell_m": frame.h_ell_m,
            "axes": "east, north, up of WGS 84 at the origin, m",
        }
    elif frame is not None:
        content["crs_wkt2"] = frame.to_wkt("WKT2_2019")
    return json.dumps(content).encode()


def frame_from_json(content: bytes, where: Path) -> tuple[Frame, bool, int]:
    """Frame, has_time and format version out of Thalweg's own VLR.

    Raises
    ------
    InputError : the content is damaged or of a newer version.
    """
    try:
        data = parse_json(content, where, "JSON in the thalweg VLR")
        version = int(data["format_version"])
        if version > FORMAT_VERSION:
            raise InputError(
                f"format version {version} of the thalweg VLR",
                expected=f"at most {FORMAT_VERSION}",
                where=where,
                cure="Use a newer version of Thalweg",
            )
        frame: Frame = None
        if "local_frame" in data:
            origin = data["local_frame"]
            lat_deg, lon_deg, h_ell_m = (float(origin[k]) for k in ("lat_deg", "lon_deg", "h_ell_m"))
            frame = LocalFrame(lat_deg=lat_deg, lon_deg=lon_deg, h_ell_m=h_ell_m)
        elif "crs_wkt2" in data:
            frame = CRS.from_wkt(data["crs_wkt2"])
        return frame, bool(data["has_time"]), version
    except (ValueError, KeyError, TypeError, CRSError) as error:
        raise InputError(
            f"the thalweg VLR is damaged ({error!r})",
            expected=f"JSON of format version {FORMAT_VERSION}",
            where=where,
            cure="Write the cloud again",
        ) from error


def header_from_laspy(header: Any, where: Path) -> LazHeader:
    """Facts out of a laspy header.

    Raises
    ------
    InputError : Thalweg's own VLR is damaged.
    """
    frame: Frame = None
    has_time, version = True, 0
    stated = Stated(None, (1.0, 1.0, 1.0), ())
    own = [v for v in header.vlrs if v.user_id == VLR_USER and v.record_id == VLR_RECORD]
    if own:
        frame, has_time, version = frame_from_json(own[0].record_data, where)
    else:
        stated = _stated(header, where)
        frame = stated.crs
    factors = np.asarray(stated.factors)
    scales, offsets = np.asarray(header.scales) * factors, np.asarray(header.offsets) * factors
    if not ((scales > 0) & (scales < _FARTHEST_M)).all() or not (np.abs(offsets) < _FARTHEST_M).all():
        raise InputError(
            f"coordinates in steps of {header.scales.tolist()} from {header.offsets.tolist()}",
            expected="steps above zero, and an offset on the earth",
            where=where,
            cure="The header is damaged: export the cloud again",
        )
    point_format = header.point_format
    return LazHeader(
        n_points=int(header.point_count),
        frame=frame,
        scale_m=float(scales.max()),
        scales_m=(float(scales[0]), float(scales[1]), float(scales[2])),
        offsets_m=(float(offsets[0]), float(offsets[1]), float(offsets[2])),
        point_format=int(point_format.id),
        standard_time=int(header.global_encoding.gps_time_type) == 1,
        has_time=has_time and "gps_time" in point_format.dimension_names,
        extra_dimensions={
            d.name: (str(d.dtype.str if d.dtype is not None else ""), d.description)
            for d in point_format.extra_dimensions
        },
        format_version=version,
        notes=stated.notes + _uncounted(header, where),
        box_m=np.array([header.mins, header.maxs]) * factors,
    )


def _uncounted(header: Any, where: Path) -> tuple[str, ...]:
    """A sentence where an uncompressed file has more points than its header counts, as a cut recording."""
    if header.are_points_compressed or header.number_of_evlrs or header.start_of_waveform_data_packet_record:
        return ()
    room = (where.stat().st_size - header.offset_to_point_data) // header.point_format.size
    more = room - int(header.point_count)
    return (f"Behind the points that the header counts is room for {more:,} more: not read.",) * (more > 0)


def _stated(header: Any, where: Path) -> Stated:
    """What the records of a foreign file state of its coordinates: WKT, GeoKeys, or both.

    Raises
    ------
    InputError : a unit that no table knows.
    """
    records: dict[int, bytes] = {}
    for vlr in (*header.vlrs, *(header.evlrs or ())):
        if vlr.user_id.rstrip("\0") == "LASF_Projection":
            records.setdefault(int(vlr.record_id), bytes(vlr.record_data_bytes()))
    directory, doubles = (
        np.frombuffer(raw[: len(raw) // size * size], kind).tolist()
        for raw, size, kind in (
            (records.get(_GEO_KEYS, b""), 2, "<u2"),
            (records.get(_GEO_DOUBLES, b""), 8, "<f8"),
        )
    )
    keys = directory, doubles, records.get(_GEO_TEXT, b"").decode("latin-1").strip("\0")
    text = records.get(_WKT, b"").decode("utf-8", errors="replace").strip("\0 \r\n")
    problem, crs = "", None
    try:
        crs = CRS.from_wkt(text) if text else None
    except CRSError as error:
        problem = f"The CRS record cannot be read ({str(error).splitlines()[0]}); "
    try:
        found = crs_of_geokeys(*keys, crs=crs, where=where)
    except InputError:
        raise
    except Exception as error:  # GDAL and pyproj raise whatever the damaged record leads them to
        found, problem = in_metres(None), f"The CRS record cannot be read ({error}); "
    code = dict(zip(directory[4::4], directory[7::4], strict=False)).get(_PROJECTED, 0)
    with contextlib.suppress(CRSError):  # a code that PROJ does not know says nothing
        beside = CRS.from_epsg(code)
        if crs and not horizontal_of(beside).equals(horizontal_of(crs), ignore_axis_order=True):
            said = f"The WKT states {crs.name}, the GeoKeys {beside.name}: the WKT counts."
            found = replace(found, notes=(said, *found.notes))
    then = "the cloud counts as without CRS" if found.crs is None else "GeoKeys count"
    return replace(found, notes=(f"{problem}{then}.", *found.notes)) if problem else found


def check_las_bytes(path: Path) -> None:
    """Compare the public header block with the file before a library believes its sizes.

    Raises
    ------
    InputError : missing, no LAS file, or sizes in the header that contradict the file.
    """
    require_file(path, "a LAS or LAZ cloud")
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(375)

    def refuse(found: str, expected: str) -> InputError:
        """The error of a damaged header."""
        cure = "Copy the file again from its source; the header is damaged"
        return InputError(found, expected=expected, where=path, cure=cure)

    if head[:4] != b"LASF":
        raise refuse(f"begins with {head[:4].hex(' ')}", "4c 41 53 46 (LASF), a LAS or LAZ cloud")
    least = _HEADER_SIZE.get(head[25], 0) if len(head) >= 227 and head[24] == 1 else 0
    if size < max(least, 227):
        raise refuse(f"cut inside the header: {size} bytes", f"at least {max(least, 227)} bytes")
    if not least:
        raise refuse(f"LAS version {head[24]}.{head[25]}", "1.0 to 1.4")
    header_size, start, n_vlrs, kind, record = struct.unpack_from("<HIIBH", head, 94)
    first_evlr, n_evlrs, n_points = 0, 0, struct.unpack_from("<I", head, 107)[0]
    if head[25] == 4:
        first_evlr, n_evlrs, n_points = struct.unpack_from("<QIQ", head, 235)
    kind &= 0x3F
    for what, found, low, high in (
        ("header size", header_size, least, size),
        ("first byte of the points", start, header_size + 54 * n_vlrs, size),
        ("end of the extended VLRs", first_evlr + 60 * n_evlrs if n_evlrs else start, start, size),
        ("point format", kind, 0, len(_POINT_SIZE) - 1),
        ("point record length", record, _POINT_SIZE[min(kind, len(_POINT_SIZE) - 1)], _MAX_POINT_SIZE),
        # LASzip needs about 0.1 byte a point at the very least (50,000 equal points: 12 bytes a layer)
        ("points", n_points, 0, 1000 * max(size - start, 0) + 1000),
    ):
        if not low <= found <= high:
            raise refuse(f"{what}: {found:,} in a file of {size:,} bytes", f"{low:,} to {high:,}")
    scales, offsets = np.frombuffer(head, "<f8", 6, 131).reshape(2, 3)
    # the compared sides are NaN where one of them is
    if n_points and not ((scales > 0.0) & (scales < _LARGEST_SCALE) & (abs(offsets) < _LARGEST_OFFSET)).all():
        raise refuse(
            f"scales {', '.join(f'{s:g}' for s in scales)}, offsets {', '.join(f'{o:g}' for o in offsets)}",
            f"scales between 0 and {_LARGEST_SCALE:g}, offsets within {_LARGEST_OFFSET:g} of 0",
        )


@contextlib.contextmanager
def library_errors(
    where: Path, doing: str, cure: str = "Copy the file again from its source"
) -> Iterator[None]:
    """Turn whatever a third-party reader raises into an `InputError`; a Rust panic is no ``Exception``."""
    try:
        yield
    except (ThalwegError, KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except BaseException as error:
        text = str(error).strip().splitlines()
        raise InputError(
            f"cannot {doing} ({type(error).__name__}: {text[0] if text else 'no message'})",
            where=where,
            cure=cure,
        ) from error


# ---------------------------------------------------------------- columns and their LAS types


def _kept(points: Any, counts: Counter[str]) -> Any:
    """Points of a laspy record that are meant; the others are counted under their first reason."""
    keep = np.ones(len(points), dtype=np.bool_)
    classes = np.asarray(points["classification"])
    ends = np.iinfo(np.int32)
    reasons: list[tuple[str, ArrayB]] = [
        (f"points_{flag}", np.asarray(points[flag]) != 0) for flag in ("withheld", "synthetic")
    ]
    # a writer whose offset was too far away for the range of the integers
    beyond = np.any([np.isin(points.array[axis], (ends.min, ends.max)) for axis in "XYZ"], axis=0)
    reasons.append(("points_beyond_the_range_of_the_numbers_in_the_file", beyond))
    for name, marked in (*reasons, *((name, classes == number) for number, name in _NOISE.items())):
        if n := int(np.count_nonzero(marked & keep)):
            counts[name] += n
            keep &= ~marked
    return points if keep.all() else points[keep]


def columns_of(points: Any, header: LazHeader) -> dict[str, AnyArray]:
    """Columns of a laspy point record, as `iter_laz` describes them."""
    n = len(points)
    dimensions = set(points.point_format.dimension_names)
    xyz = np.empty((n, 3))
    for axis, name in enumerate("XYZ"):
        xyz[:, axis] = points.array[name] * header.scales_m[axis] + header.offsets_m[axis]
    columns: dict[str, AnyArray] = {"xyz_m": xyz, "t_gps_s": np.full(n, np.nan)}
    if header.has_time:
        columns["t_gps_s" if header.standard_time else "t_week_s"] = np.array(points["gps_time"])
        if not header.format_version:  # others write 0 where there is no time
            columns["t_gps_s"][columns["t_gps_s"] == 0.0] = np.nan
    for name in ("intensity", "return_number", "number_of_returns", *OPTIONAL):
        if name in dimensions:
            columns[name] = np.array(points[name])
    if "red" in dimensions:
        columns["rgb"] = np.stack([points[name] for name in ("red", "green", "blue")], axis=-1)
    for name in header.extra_dimensions:
        columns[name] = np.array(points[name])
    return columns


def sixteen_bit(name: str, values: AnyArray, path: Path) -> AnyArray:
    """Bring 8-bit values to 16 bit (x 256); 16-bit ones stay.

    Raises
    ------
    GeometryError : another type, whose range is not known.
    """
    if values.dtype == np.uint8:
        return values.astype(np.uint16) * np.uint16(256)
    if values.dtype == np.uint16:
        return values
    raise GeometryError(f"'{name}' of type {values.dtype}", expected="uint8 or uint16", where=path)


def integers(name: str, values: AnyArray, dtype: np.dtype[Any], path: Path) -> AnyArray:
    """Round to an integer type, checked.

    Raises
    ------
    GeometryError : a value is not finite or does not fit.
    """
    if values.dtype == dtype:
        return values
    rounded = np.rint(values)
    limits = np.iinfo(dtype)
    if not np.all((rounded >= limits.min) & (rounded <= limits.max)):
        raise GeometryError(
            f"values of '{name}' do not fit {dtype} ({np.min(rounded)} to {np.max(rounded)} stored)",
            expected=f"{limits.min} to {limits.max}",
            where=path,
        )
    return rounded.astype(dtype)


# ---------------------------------------------------------------- chunks of a LAZ file
#
# The library aborts the whole process when a damaged size asks for more memory than there is, so every
# size is compared with the file first. Layout: LASzip specification (record 22204 "laszip encoded", chunk
# table, layered chunks of point formats 6 to 10).


@dataclass(frozen=True, slots=True)
class LazLayout:
    """Where the chunks begin, the point record's length, layers a chunk (0 if not layered), LASzip record."""

    start: int
    record: int
    layers: int
    laszip: bytes


def laz_layout(path: Path) -> LazLayout | None:
    """Layout of a LAZ file whose header is sound (`check_las_bytes`); None if not compressed.

    Raises
    ------
    InputError : the LASzip record is missing or contradicts the header.
    """
    with path.open("rb") as stream, library_errors(path, "read the LAS header"):
        header = laspy.LasHeader.read_from(stream)
    if not header.are_points_compressed:
        return None
    laszip = next((vlr.record_data for vlr in header.vlrs if vlr.user_id == "laszip encoded"), b"")
    compressor, chunk, n = struct.unpack_from("<H10xI16xH", laszip.ljust(34, b"\0"))
    items = list(struct.iter_unpack("<HHH", laszip[34 : 34 + 6 * n])) if len(laszip) >= 34 + 6 * n else []
    record = header.point_format.size
    sound = 0 < chunk <= _MOST_IN_CHUNK or chunk == _VARIABLE_CHUNKS
    if compressor not in _COMPRESSORS or not sound or sum(size for _, size, _ in items) != record:
        raise InputError(
            f"the LASzip record (compressor {compressor}, chunks of {chunk:,}, items {items}) contradicts "
            f"{record}-byte points",
            expected="items that add up to the point record",
            where=path,
            cure="Copy the file again from its source; the header is damaged",
        )
    layers = sum(size if kind == _BYTES_LAYERED else _LAYERS.get(kind, 0) for kind, size, _ in items)
    start = int(header.offset_to_point_data)
    return LazLayout(start, record, layers if compressor == _LAYERED else 0, laszip)


def check_chunks(path: Path) -> None:
    """Compare the chunk table and the sizes inside layered chunks with the file.

    Raises
    ------
    InputError : a size points outside the file.
    """
    layout = laz_layout(path)
    if layout is None:
        return
    size = path.stat().st_size

    def refuse(found: str) -> InputError:
        """The error of a damaged chunk table."""
        return InputError(
            found,
            expected="a chunk table that fits the file",
            where=path,
            cure="The file is cut or damaged: copy it again from its source",
        )

    with path.open("rb") as stream:
        stream.seek(layout.start)
        stated = stream.read(8)
        if len(stated) < 8:
            raise refuse("the file ends before the points")
        table_at = struct.unpack("<q", stated)[0]
        if table_at == -1:
            stream.seek(size - 8)
            table_at = struct.unpack("<q", stream.read(8))[0]
        first = layout.start + 8
        if not first <= table_at <= size - 8:
            raise refuse(f"the chunk table should be at byte {table_at:,} of {size:,}")
        stream.seek(table_at)
        n_chunks = struct.unpack("<II", stream.read(8))[1]
        if n_chunks * layout.record > table_at - first:
            raise refuse(f"{n_chunks:,} chunks in {table_at - first:,} bytes")
        stream.seek(layout.start)
        with library_errors(path, "read the chunk table"):
            table = lazrs.read_chunk_table(stream, lazrs.LazVlr(layout.laszip)) if n_chunks else []
        at = first
        for number, (_, length) in enumerate(table, start=1):
            if length < 0 or at + length > table_at:
                raise refuse(f"chunk {number} of {n_chunks} claims {length:,} bytes")
            if layout.layers and _layered(stream, at, layout)[1] > length:
                raise refuse(f"the layers of chunk {number} of {n_chunks} exceed its {length:,} bytes")
            at += length


def whole_chunks(path: Path, layout: LazLayout) -> tuple[list[tuple[int, int]], int]:
    """Whole chunks (points, bytes) of a layered LAZ file from the front, and the byte behind the last.

    Each chunk is the first point, the number of points, the sizes of its layers, and the layers; nothing
    at the end of the file is needed.
    """
    size = path.stat().st_size
    table: list[tuple[int, int]] = []
    with path.open("rb") as stream:
        stream.seek(layout.start)
        stated = struct.unpack("<q", stream.read(8).ljust(8, b"\0"))[0]
        stop = stated if layout.start < stated <= size else size
        at = layout.start + 8
        while layout.layers:
            points, length = _layered(stream, at, layout)
            if not points or at + length > stop:  # no points: the file ends there
                break
            table.append((points, length))
            at += length
    return table, at


def _layered(stream: BinaryIO, at: int, layout: LazLayout) -> tuple[int, int]:
    stream.seek(at + layout.record)
    raw = stream.read(4 + 4 * layout.layers)
    if len(raw) < 4 + 4 * layout.layers:
        return 0, 0
    points, *sizes = struct.unpack(f"<I{layout.layers}I", raw)
    return points, layout.record + len(raw) + sum(sizes)
