"""What stands in front of the points of a LAS/LAZ file: frame, CRS, plausibility, and the library's errors.

Sources: LAS 1.4 specification R15 (public header block table 3, VLR header table 4, coordinate reference
systems section 2.4); OGC 18-010r11 (WKT2 engineering CRS).
"""

import contextlib
import json
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

from pyproj import CRS
from pyproj.exceptions import CRSError

from thalweg.core.errors import GeometryError, InputError, ThalwegError
from thalweg.core.frames import LocalFrame

Frame: TypeAlias = LocalFrame | CRS | None
"""Frame of a cloud: the local world frame, a map projection, or unknown."""

VLR_USER: Final = "thalweg"
VLR_RECORD: Final = 1
FORMAT_VERSION: Final = 1
"""Version of the JSON in the VLR (user id ``thalweg``, record 1); raised when a reader would misread it."""

_HEADER_SIZE: Final = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375}
_POINT_SIZE: Final = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
# Far above any real record (a hundred doubles as extra bytes); a damaged length must not ask for gigabytes.
_MAX_POINT_SIZE: Final = 1024
_MIB: Final = 1 << 20


@dataclass(frozen=True, slots=True, kw_only=True)
class LazHeader:
    """Facts about a LAS/LAZ file, without its points.

    ``frame`` is a `LocalFrame`, a CRS or None; ``extra_dimensions`` maps name to (type, description);
    ``standard_time`` is true if times are adjusted standard GPS times; ``has_time`` is false if the
    writer stated that there are none; ``format_version`` is 0 for a foreign file.
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
    crs_note: str = ""


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
        data = json.loads(content)
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
            frame = LocalFrame(**{k: float(origin[k]) for k in ("lat_deg", "lon_deg", "h_ell_m")})
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
    has_time, version, crs_note = True, 0, ""
    own = [v for v in header.vlrs if v.user_id == VLR_USER and v.record_id == VLR_RECORD]
    if own:
        frame, has_time, version = frame_from_json(own[0].record_data, where)
    else:
        try:
            frame = header.parse_crs()
        except Exception as error:  # laspy and pyproj raise whatever the damaged record leads them to
            crs_note = f"The CRS record cannot be read ({error}); the cloud counts as without CRS."
    point_format = header.point_format
    return LazHeader(
        n_points=int(header.point_count),
        frame=frame,
        scale_m=float(max(header.scales)),
        scales_m=(float(header.scales[0]), float(header.scales[1]), float(header.scales[2])),
        offsets_m=(float(header.offsets[0]), float(header.offsets[1]), float(header.offsets[2])),
        point_format=int(point_format.id),
        standard_time=int(header.global_encoding.gps_time_type) == 1,
        has_time=has_time and "gps_time" in point_format.dimension_names,
        extra_dimensions={
            d.name: (str(d.dtype.str if d.dtype is not None else ""), d.description)
            for d in point_format.extra_dimensions
        },
        format_version=version,
        crs_note=crs_note,
    )


def check_las_bytes(path: Path) -> None:
    """Check the public header block before a library believes its sizes.

    Raises
    ------
    InputError : missing, empty, no LAS file, or sizes in the header that contradict the file.
    """
    if not path.is_file():
        raise InputError("file not found", expected="a LAS or LAZ cloud", where=path, cure="Check the path")
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(375)
    cure = "Copy the file again from its source; the header is damaged"

    def refuse(found: str, expected: str) -> InputError:
        """The error of a damaged header."""
        return InputError(found, expected=expected, where=path, cure=cure)

    if head[:4] != b"LASF":
        raise refuse(f"begins with {head[:4]!r}", "'LASF', a LAS or LAZ cloud")
    if size < 227:
        raise refuse(f"cut inside the header: {size} bytes", "at least 227 bytes")
    major, minor = head[24], head[25]
    if major != 1 or minor not in _HEADER_SIZE:
        raise refuse(f"LAS version {major}.{minor}", "1.0 to 1.4")
    header_size, offset, n_vlrs, fmt, record = struct.unpack_from("<HIIBH", head, 94)
    if header_size < _HEADER_SIZE[minor] or size < header_size:
        raise refuse(f"header size {header_size} in a file of {size} bytes", f">= {_HEADER_SIZE[minor]}")
    if not header_size <= offset <= size:
        raise refuse(f"points begin at byte {offset} of {size}", f"{header_size} to {size}")
    if header_size + 54 * n_vlrs > offset:
        raise refuse(f"{n_vlrs} VLRs in {offset - header_size} bytes", "at least 54 bytes each")
    if fmt & 0x3F >= len(_POINT_SIZE):
        raise refuse(f"point format {fmt & 0x3F}", "0 to 10")
    if not _POINT_SIZE[fmt & 0x3F] <= record <= _MAX_POINT_SIZE:
        raise refuse(f"point record length {record}", f"{_POINT_SIZE[fmt & 0x3F]} to {_MAX_POINT_SIZE}")
    if minor == 4:
        first_evlr, n_evlrs, n_points = struct.unpack_from("<QIQ", head, 235)
        if n_evlrs and (first_evlr < offset or first_evlr + 60 * n_evlrs > size):
            raise refuse(
                f"{n_evlrs} extended VLRs from byte {first_evlr} of {size}", "records inside the file"
            )
    else:
        (n_points,) = struct.unpack_from("<I", head, 107)
    # LASzip needs about 0.1 byte a point at the very least (50,000 equal points: 12 bytes a layer).
    if n_points > 1000 * max(size - offset, 0) + 1000:
        raise refuse(f"{n_points:,} points in {size - offset:,} bytes", "a number that fits the file")
    _check_vlrs(path, header_size, offset, n_vlrs, refuse)


def _check_vlrs(path: Path, start: int, stop: int, n_vlrs: int, refuse: Any) -> None:
    with path.open("rb") as stream:
        stream.seek(start)
        for index in range(n_vlrs):
            vlr = stream.read(54)
            user, record, length = vlr[2:18].rstrip(b"\0"), *struct.unpack_from("<HH", vlr, 18)
            if stream.tell() + length > stop:
                raise refuse(
                    f"VLR {index + 1} of {n_vlrs} claims {length} bytes", "records before the points"
                )
            content = stream.read(length)
            if user == b"laszip encoded" and record == 22204:
                (chunk,) = struct.unpack_from("<I", content.ljust(34, b"\0"), 12)
                if chunk != 0xFFFFFFFF and not 0 < chunk <= 64 * _MIB:
                    raise refuse(f"LASzip chunks of {chunk:,} points", "1 to 67,108,864 points")


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
