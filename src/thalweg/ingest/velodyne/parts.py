"""The parts of a VLP-16 recording, one a file, and whether they were given in the order of time."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from thalweg.core.types import ArrayI
from thalweg.ingest.velodyne.clock import LidarClock
from thalweg.ingest.velodyne.packets import LATE, STEP_BACK, PacketBlock

ORDER_S: Final = 0.1
"""Packets that the network has delivered in another order are closer together than this."""


@dataclass(slots=True)
class Part:
    """Packets kept of one file, or of what follows behind a clock that was set back inside of one.

    Attributes
    ----------
    file : number of the file that begins here, -1 inside of a file.
    packet : index of the first packet kept.
    jump_us : its distance from the newest packet before.
    event : its event, see `velodyne_packets`.
    first_us, newest_us : oldest and newest unrolled stamp.
    n : packets kept.
    """

    file: int
    packet: int
    jump_us: int
    event: int
    first_us: int
    newest_us: int
    n: int = 0


@dataclass(slots=True)
class Parts:
    """Parts of a recording, in the order given, that grow while packets stream by.

    ``file_starts`` is the list of the packet stream: index of the first data packet of each file.
    """

    file_starts: list[int] = field(default_factory=list)
    parts: list[Part] = field(default_factory=list)
    _next_file: int = 0

    def feed(self, block: PacketBlock, keep: ArrayI) -> None:
        """Take in the next block, of which the rows ``keep`` are used."""
        if not keep.size:
            return
        files = self._begins(block, keep)
        back = keep[block.event[keep] == STEP_BACK]
        edges = np.unique(np.array([keep[0], *files, *back], dtype=np.int64))
        for rows in np.split(keep, np.searchsorted(keep, edges)[1:]):
            row, t_us = int(rows[0]), block.t_us[rows]
            first, newest = int(t_us.min()), int(t_us.max())
            if row in files or block.event[row] == STEP_BACK or not self.parts:
                packet, jump_us = block.first_packet + row, int(block.jump_us[row])
                event = int(block.event[row])
                self.parts.append(Part(files.get(row, -1), packet, jump_us, event, first, newest))
            part = self.parts[-1]
            part.first_us, part.newest_us = min(part.first_us, first), max(part.newest_us, newest)
            part.n += rows.size

    def _begins(self, block: PacketBlock, keep: ArrayI) -> dict[int, int]:
        """Rows of the first packets kept of files -> number of the file."""
        packet = block.first_packet + keep
        found: dict[int, int] = {}
        while self._next_file < len(self.file_starts):
            at = int(np.searchsorted(packet, self.file_starts[self._next_file]))
            if at == keep.size:  # begins further on
                break
            found[int(keep[at])] = self._next_file
            self._next_file += 1
        return found

    def early(self, clock: LidarClock) -> list[tuple[Part, float]]:
        """Files that begin before the end of the one before, and by how many seconds.

        Packets that both files hold are none: they are dropped before.
        """
        found = []
        for part in self.parts:
            if part.file > 0 and part.event in (LATE, STEP_BACK):
                extra_s = clock.extra_s(np.array([part.packet - 1, part.packet]))
                ahead_s = -part.jump_us * 1e-6 - float(extra_s[1] - extra_s[0])
                if ahead_s > ORDER_S:
                    found.append((part, ahead_s))
        return found

    def newest_s(self, clock: LidarClock) -> float:
        """Device time of the newest packet, since the clock was last set back inside a file."""
        inside = [i for i, part in enumerate(self.parts) if part.file < 0]
        parts = self.parts[inside[-1] if inside else 0 :]
        return max(p.newest_us * 1e-6 + _extra_s(clock, p) for p in parts)

    def first_s(self, clock: LidarClock) -> tuple[float, float]:
        """Oldest device time and oldest GPS time (NaN if unsynchronised) at the begin of a part."""
        device = [p.first_us * 1e-6 + _extra_s(clock, p) for p in self.parts]
        offset = clock.offset_s(np.array([p.packet for p in self.parts]))
        gps = np.array(device) + offset
        known = gps[np.isfinite(gps)]
        return min(device), float(known.min()) if known.size else float("nan")

    def within(self, start_us: int, stop_us: int) -> int:
        """Packets of the parts that lie as a whole between two stamps."""
        return sum(p.n for p in self.parts if start_us < p.first_us and p.newest_us < stop_us)


def _extra_s(clock: LidarClock, part: Part) -> float:
    return float(clock.extra_s(np.array([part.packet]))[0])
