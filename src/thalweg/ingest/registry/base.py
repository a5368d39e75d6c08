"""A row of the registry: one format, how it is told from others, and who reads it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from thalweg.ingest import (
    HEAD_BYTES as HEAD_BYTES,
    CloudReader,
    LidarOptions,
    LidarReader,
    PoseReader,
    PositionLog,
    PositionReader,
    TrackOptions,
    read_head as read_head,
)

SURE: Final = 1.0
"""What `Format.matches` gives for content that is of no other format."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """One format that Thalweg reads.

    Attributes
    ----------
    kind : its name in code.
    words : its name for people.
    streams : where files of it stand in ``logs`` (names of `thalweg.settings.sections.logs.STREAM_KEYS`);
        the first one is where `thalweg new-campaign` puts them.
    holds : of a container, a file of many streams: those that this one holds, its own first, and for each the
        topics that it may be read from, several together or one of several; none where nothing is to name.
    use : what a file of no stream is good for.
    magic : first bytes, any of them.
    matches : head of a file (`HEAD_BYTES`) and size of the file -> how sure its content is of this format,
        0 to `SURE`; asked where no ``magic`` is given, or behind it.
    lidar, poses, positions, cloud : its reader, by what it yields.
    depths : its reader of depths, where that of positions or poses needs more than these.
    describe : kind, files and options -> what the files hold; None: what its reader finds in them.
    """

    kind: str
    words: str
    describe: Callable[[str, list[Path], dict[str, Any]], PositionLog] | None = None
    streams: tuple[str, ...] = ()
    holds: Callable[[Path], Mapping[str, Sequence[tuple[str, ...]]]] | None = None
    use: str = ""
    magic: tuple[bytes, ...] = ()
    matches: Callable[[bytes, int], float] | None = None
    lidar: Callable[[Sequence[Path], LidarOptions], LidarReader] | None = None
    poses: PoseReader | None = None
    positions: PositionReader | None = None
    depths: PositionReader | None = None
    cloud: CloudReader | None = None

    def sureness(self, head: bytes, size: int) -> float:
        """How sure a file with this head is of this format, 0 to `SURE`."""
        if self.magic and not head.startswith(self.magic):
            return 0.0
        return SURE if self.matches is None else float(self.matches(head, size))

    def read(self, files: list[Path], options: dict[str, Any]) -> PositionLog:
        """Report of files of this format, with the positions, depths and states that they hold."""
        if self.describe is not None:
            return self.describe(self.kind, files, options)
        if self.lidar is not None:
            return PositionLog(report=self.lidar(files, LidarOptions(**options)).scan().report)
        if self.cloud is not None:
            return PositionLog(report=self.cloud(files[0]).report)
        reader = self.poses or self.positions
        assert reader is not None
        return reader(files, TrackOptions(**options))


def find_format(formats: Sequence[Format], path: Path) -> Format | None:
    """The format of which a file is surest, the first of several alike; None if there is none.

    Raises
    ------
    InputError : see `read_head`.
    """
    head, size = read_head(path), path.stat().st_size
    best, most = None, 0.0
    for each in formats:
        sure = each.sureness(head, size)
        if sure >= SURE:
            return each
        if sure > most:
            best, most = each, sure
    return best


def framed_share(framed_bytes: int, head: bytes) -> float:
    """Sureness by the share of the head inside frames of right check sums."""
    share = framed_bytes / len(head)
    # a tenth: real logs begin with garbage, and a chance CRC match covers a few bytes of 65,536 only
    return min(share, 0.99 * SURE) if share > 0.1 else 0.0
