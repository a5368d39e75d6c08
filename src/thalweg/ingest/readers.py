"""What a reader of a kind of recording offers: protocols, and the tables and blocks that they hand on.

`lidar`, `calibration` and comparisons know these alone; which reader a file needs is told by
`thalweg.ingest.registry`.
"""

import datetime as dt
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, Protocol, Self

import numpy as np
import pandas as pd

from thalweg.core import (
    ArrayB,
    ArrayF,
    ArrayF32,
    ArrayI,
    ArrayU8,
    ConfigError,
    InputError,
    LocalFrame,
    require_file,
)
from thalweg.ingest.integrity import IntegrityReport
from thalweg.ingest.schemas import DEPTH, GNSS_POSITION
from thalweg.settings.sections import Lidar

HEAD_BYTES: Final = 65_536
"""So many first bytes tell the format of a file."""
RETURN_CHOICES: Final = ("all", "strongest", "last")


@dataclass(frozen=True, slots=True, kw_only=True)
class PointBlock:
    """Points of a piece of the recording, in the order of firing.

    Attributes
    ----------
    t_gps_s : (n,) adjusted GPS time of the shot; NaN where the sensor was unsynchronised.
    t_device_s : (n,) seconds past the hour of the first packet on the device's clock, unrolled; it jumps only
        where the sensor set its clock.
    xyz_scs_m : (n, 3) coordinates in the sensor frame: x right, y forward (azimuth 0), z up. range_m : (n,)
    measured distance. azimuth_rad : (n,) clockwise from forward, seen from above, [0, 2 pi]. ring : (n,)
    laser by elevation, 0 is the lowest. laser : (n,) laser in the order of the data.
    intensity : (n,) calibrated reflectivity, 0..100 diffuse, 101..255 retro-reflecting. return_number :
    (n,) as in LAS: 1 is the nearest return of the shot, whichever was stronger. n_returns : (n,) returns of
    the shot that the packet holds: 1, or 2 in dual mode. packet : (n,) index of the data packet, over all
    files, dropped packets counted too.
    """

    t_gps_s: ArrayF
    t_device_s: ArrayF
    xyz_scs_m: ArrayF32
    range_m: ArrayF32
    azimuth_rad: ArrayF32
    ring: ArrayU8
    laser: ArrayU8
    intensity: ArrayU8
    return_number: ArrayU8
    n_returns: ArrayU8
    packet: ArrayI

    @property
    def n(self) -> int:
        """Number of points."""
        return int(self.range_m.size)

    def where(self, keep: ArrayB) -> "PointBlock":
        """The points for which ``keep`` (n,) is true."""
        return PointBlock(**{name: getattr(self, name)[keep] for name in self.__dataclass_fields__})


def empty_points(n: int) -> PointBlock:
    """A block of ``n`` points to be filled."""
    return PointBlock(
        t_gps_s=np.empty(n),
        t_device_s=np.empty(n),
        xyz_scs_m=np.empty((n, 3), dtype=np.float32),
        range_m=np.empty(n, dtype=np.float32),
        azimuth_rad=np.empty(n, dtype=np.float32),
        ring=np.empty(n, dtype=np.uint8),
        laser=np.empty(n, dtype=np.uint8),
        intensity=np.empty(n, dtype=np.uint8),
        return_number=np.empty(n, dtype=np.uint8),
        n_returns=np.empty(n, dtype=np.uint8),
        packet=np.empty(n, dtype=np.int64),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarClock:
    """Puts packets on GPS time, by stretches of the packet index.

    Attributes
    ----------
    first_packet : first packet index of each stretch; the first one is 0.
    device_extra_s : added to the unrolled stamp: whole hours that a hole has hidden.
    gps_minus_device_s : adjusted GPS time minus device time, NaN where the sensor was unsynchronised.
    sigma_s : standard deviation of times that were estimated; 0 where PPS or a person tells them.
    """

    first_packet: tuple[int, ...] = (0,)
    device_extra_s: tuple[float, ...] = (0.0,)
    gps_minus_device_s: tuple[float, ...] = (math.nan,)
    sigma_s: float = 0.0

    def _stretch(self, packet: ArrayI) -> ArrayI:
        return np.searchsorted(np.array(self.first_packet), packet, side="right") - 1

    def extra_s(self, packet: ArrayI) -> ArrayF:
        """Hidden hours in seconds, shape of ``packet``."""
        return np.array(self.device_extra_s, dtype=np.float64)[self._stretch(packet)]

    def offset_s(self, packet: ArrayI) -> ArrayF:
        """GPS minus device time in seconds, shape of ``packet``; NaN if unsynchronised."""
        return np.array(self.gps_minus_device_s, dtype=np.float64)[self._stretch(packet)]

    def gps_time(self, packet: ArrayI, t_device_s: ArrayF) -> ArrayF:
        """Adjusted GPS time of packets from their index and device time; NaN if unsynchronised."""
        return np.asarray(t_device_s + self.offset_s(packet))

    def to_dict(self) -> dict[str, Any]:
        """Plain lists for JSON or YAML; NaN becomes None."""
        return {
            "first_packet": list(self.first_packet),
            "device_extra_s": list(self.device_extra_s),
            "gps_minus_device_s": [None if math.isnan(v) else v for v in self.gps_minus_device_s],
            "sigma_s": self.sigma_s,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """The inverse of `to_dict`."""
        return cls(
            first_packet=tuple(int(v) for v in data["first_packet"]),
            device_extra_s=tuple(float(v) for v in data["device_extra_s"]),
            gps_minus_device_s=tuple(math.nan if v is None else float(v) for v in data["gps_minus_device_s"]),
            sigma_s=float(data.get("sigma_s", 0.0)),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarOptions:
    """How to read a recording.

    Parameters
    ----------
    model : ``"auto"`` (product byte of the packets) or the name of a model (whatever that byte says).
    vertical_corrections : add the manual's height of each laser to z.
    min_range_m, max_range_m : returns outside are left out, limits included.
    returns : ``"all"``; in dual mode also ``"strongest"`` or ``"last"`` (the farthest) return of each
        shot. A single-return recording has one return a shot, which is kept in any case.
    data_port, position_port : UDP ports of a Velodyne; an Ouster names its own.
    topics : of the clouds in a bag of ROS that holds several.

    Raises
    ------
    ConfigError : a value is out of its domain.
    """

    model: str = "auto"
    vertical_corrections: bool = True
    min_range_m: float = 0.0
    max_range_m: float = math.inf
    returns: Literal["all", "strongest", "last"] = "all"
    data_port: int = Lidar().data_port
    position_port: int = Lidar().position_port
    topics: Sequence[str] = ()

    def __post_init__(self) -> None:
        if self.returns not in RETURN_CHOICES:
            raise ConfigError(
                f"lidar.returns '{self.returns}'", expected="all, strongest or last", cure="Set lidar.returns"
            )
        if not 0 <= self.min_range_m < self.max_range_m:
            raise ConfigError(
                f"lidar ranges {self.min_range_m} .. {self.max_range_m} m",
                expected="0 <= min_range_m < max_range_m",
                cure="Set georeferencing.min_range_m and georeferencing.max_range_m",
            )
        for port in (self.data_port, self.position_port):
            if not 0 < port < 65536:
                raise ConfigError(
                    f"UDP port {port}", expected="1 .. 65535", cure="Set the ports of the lidar"
                )


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarScan:
    """What a recording holds.

    Attributes
    ----------
    report : integrity report, stream ``"lidar"``.
    clock : puts its packets on GPS time; give it to `iter_points`.
    model : decoded as this model.
    return_mode : strongest, last, dual, or mixed if it changes.
    n_points : points that `iter_points` yields with the same options.
    sentences : device time and GPS time of each NMEA sentence that came without PPS; the first is when
        the sensor sent it on.
    """

    report: IntegrityReport
    clock: LidarClock
    model: str
    return_mode: str
    n_points: int
    sentences: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class LogWindow:
    """One of the windows of equal length into which a recording is cut in the order of its stream.

    Parameters
    ----------
    index : of the window, from 0.
    count : number of windows; the last one takes all that is left.
    seconds : length of the others, from the first packet of the recording.
    """

    index: int
    count: int
    seconds: float

    def number_of(self, since_first_s: ArrayF) -> ArrayI:
        """Windows (n,) of times since the first packet (n,), seconds."""
        return np.clip(np.floor(since_first_s / self.seconds), 0, self.count - 1).astype(np.int64)


class LidarReader(Protocol):
    """A recording of a lidar, with the options of its decoding."""

    @property
    def files(self) -> Sequence[Path]:
        """Parts of the recording in the order of time."""

    def scan(self) -> LidarScan:
        """Read the recording once: integrity, clock, model and number of points."""

    def length_s(self) -> float:
        """About how long the recording is, by its first packets and its size; NaN where these do not tell."""

    def points(
        self, clock: LidarClock | None = None, *, max_points: int = 1_000_000, window: LogWindow | None = None
    ) -> Iterator[PointBlock]:
        """Points block by block in stream order, the same each time.

        Parameters
        ----------
        clock : of `scan`; without it the recording is scanned first.
        max_points : no block is larger.
        window : only the points of its packets; all windows together give each point once.
        """


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackOptions:
    """What files of positions and poses do not state themselves.

    Parameters
    ----------
    gps_week : full GPS week of the first record of an SBET.
    smrmsg : standard deviations beside an SBET.
    date : UTC date of the first sentence of NMEA without dates.
    frame : the local frame that a table of poses is in.
    body_axes : axes x-y-z of its body: ``forward-right-down``, ``forward-left-up`` (ROS),
        ``right-down-forward`` (a camera).
    time_scale : of its stamps: ``utc`` (Unix time) or ``gps`` (seconds since 1980-01-06).
    sigma_position_m, sigma_attitude_deg : standard deviations where a file holds none, each axis; NaN: they
        are stated later.
    times : stamps beside a KITTI table.
    upside_down : the body is upside down, and it is meant.
    topics : those of a container, such as a bag of ROS, that are meant; none: whatever fits.
    """

    gps_week: int | None = None
    smrmsg: tuple[Path, ...] = ()
    date: dt.date | None = None
    frame: LocalFrame | None = None
    body_axes: str | None = None
    time_scale: str | None = None
    sigma_position_m: float | None = None
    sigma_attitude_deg: float | None = None
    times: Path | None = None
    upside_down: bool = False
    topics: Sequence[str] = ()


@dataclass(slots=True, kw_only=True)
class PositionLog:
    """``positions`` of table kind ``gnss_position`` and ``depths`` of kind ``depth``, empty if it has none.

    ``soundings`` are depths of a log that tells the place of each: columns ``latitude``, ``longitude``,
    ``depth_m`` and, where it is known, ``time``. ``triggers_gps_s`` (n,) are when a camera was triggered, NaN
    where the log has no GPS time. Positions beyond the poles, or at 0, 0 as before a first fix, are left out
    and counted.
    """

    report: IntegrityReport
    positions: pd.DataFrame = field(default_factory=lambda: GNSS_POSITION.empty_table().to_pandas())
    depths: pd.DataFrame = field(default_factory=lambda: DEPTH.empty_table().to_pandas())
    soundings: pd.DataFrame = field(default_factory=pd.DataFrame)
    triggers_gps_s: ArrayF | None = None

    def __post_init__(self) -> None:
        """Leave positions out that are none."""
        lat, lon = (self.positions[name].to_numpy(np.float64) for name in ("lat_deg", "lon_deg"))
        none = (np.abs(lat) > 90.0) | (np.abs(lon) > 360.0) | ((lat == 0.0) & (lon == 0.0))
        if n := int(np.count_nonzero(none)):
            self.report.lose("positions_at_no_place", n)
            self.positions = self.positions[~none].reset_index(drop=True)


@dataclass(slots=True, kw_only=True)
class PoseLog(PositionLog):
    """``states`` of table kind ``ins_state``; ``positions`` are the log's own GNSS beside them."""

    states: pd.DataFrame


_BEST: Final = ("DPT", "DBT", "ANPP53", "DBS")
"""Sentences that state depths, best first: one ping often gives several."""


def pings_of(depths: pd.DataFrame) -> tuple[pd.DataFrame, int]:
    """The rows of the sentence that states depths best, one a ping, and how many rows state them again.

    Parameters
    ----------
    depths : table kind ``depth``.

    Raises
    ------
    InputError : the table is empty.
    """
    if not len(depths):
        raise InputError("no soundings", expected="a log of the echo sounder with depths")
    present = depths["sentence"].value_counts()
    # the best sentence that comes about as often as any other
    often = [name for name in _BEST if present.get(name, 0) >= 0.9 * present.max()]
    chosen = depths[depths["sentence"] == (often[0] if often else present.index[0])]
    return chosen, len(depths) - len(chosen)


class PositionReader(Protocol):
    """Positions of an antenna from the files of one recording in the order of time."""

    def __call__(self, files: Sequence[Path], options: TrackOptions) -> PositionLog:
        """Read ``files``; ``options`` say what they do not state."""


class PoseReader(Protocol):
    """Positions and attitudes of the body from the files of one recording in the order of time."""

    def __call__(self, files: Sequence[Path], options: TrackOptions) -> PoseLog:
        """Read ``files``; ``options`` say what they do not state."""


class Cloud(Protocol):
    """A finished point cloud: ``points`` (n, 3) in metres, ``intensity`` (n,) or None."""

    report: IntegrityReport
    points: ArrayF
    intensity: ArrayF32 | None


class CloudReader(Protocol):
    """A finished point cloud from one file."""

    def __call__(self, path: Path) -> Cloud:
        """Read a file."""


def read_head(path: Path) -> bytes:
    """First `HEAD_BYTES` of a file.

    Raises
    ------
    InputError : the file is missing, empty, a folder, or cannot be read.
    """
    require_file(path, "a raw log")
    try:
        with path.open("rb") as stream:
            return stream.read(HEAD_BYTES)
    except OSError as error:
        raise InputError(
            f"the file cannot be read: {error.strerror}",
            where=path,
            cure="Check its permissions and the disk",
        ) from error
