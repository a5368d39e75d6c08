"""Frame walk through an SBP log for PPK: intact frames, lost bytes, base position, who sent observations.

Frame: 0x55, type u16, sender u16, length u8, payload, CRC16-CCITT (0x1021, start 0) over type to payload, all
little endian (Swift Binary Protocol specification, section 3).
"""

import binascii
import struct
from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.types import ArrayF

MSG_BASE_POS_ECEF: Final = 0x0048
MSG_OBS: Final = 0x004A
OLD_OBSERVATIONS: Final = {0x0043: "MsgObsDepB", 0x0045: "MsgObsDepA", 0x0049: "MsgObsDepC"}
EPHEMERIDES: Final = frozenset(
    {0x001A, 0x0046, 0x0047, 0x0080, 0x0081, 0x0083, 0x0084, 0x0085, 0x0086, 0x0087, 0x0088, 0x0089,
     0x008A, 0x008B, 0x008C, 0x008D, 0x008E, 0x0095}
)  # fmt: skip
"""Message types 0x001A to 0x0095 that carry a broadcast ephemeris of any system."""


@dataclass(frozen=True, slots=True)
class SbpFrames:
    """Intact frames by (type, sender), bytes outside of them, and stated base positions (n, 3) in metres."""

    counts: dict[tuple[int, int], int]
    n_frames: int
    bytes_lost: int
    base_ecef_m: ArrayF

    def observations(self, *, base: bool) -> int:
        """Observation messages of the base (sender 0) or of the rover (any other sender)."""
        return sum(
            n for (kind, sender), n in self.counts.items() if kind == MSG_OBS and (sender == 0) == base
        )

    def of_types(self, kinds: frozenset[int]) -> int:
        """Frames of any of these types."""
        return sum(n for (kind, _), n in self.counts.items() if kind in kinds)


def walk_sbp(data: bytes) -> SbpFrames:
    """Walk through all frames; bytes that belong to no intact frame are counted, never skipped silently."""
    counts: dict[tuple[int, int], int] = {}
    base: list[tuple[float, float, float]] = []
    position = intact = frames = 0
    size = len(data)
    while (position := data.find(b"\x55", position)) >= 0 and position + 8 <= size:
        kind, sender, length = struct.unpack_from("<HHB", data, position + 1)
        end = position + 8 + length
        if end > size or kind == 0:  # 0x55 before a run of zeros passes the CRC; no message has type 0
            position += 1
            continue
        (crc,) = struct.unpack_from("<H", data, end - 2)
        if binascii.crc_hqx(data[position + 1 : end - 2], 0) != crc:
            position += 1
            continue
        counts[kind, sender] = counts.get((kind, sender), 0) + 1
        if kind == MSG_BASE_POS_ECEF and length == 24:
            base.append(struct.unpack_from("<3d", data, position + 6))
        frames += 1
        intact += end - position
        position = end
    return SbpFrames(counts, frames, size - intact, np.array(base, dtype=np.float64).reshape(-1, 3))


def looks_like_sbp(data: bytes) -> bool:
    """True if at least two intact frames lie in the first 64 kB."""
    return walk_sbp(data[:65536]).n_frames >= 2
