"""SBP log as PPK sees it: intact frames, lost bytes, base position, who sent observations."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.types import ArrayF
from thalweg.ingest.sbp.frames import find_messages

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
    found = find_messages(np.frombuffer(data, dtype=np.uint8))
    pairs, number = np.unique(np.stack([found.kind, found.sender]), axis=1, return_counts=True)
    counts = {(int(k), int(s)): int(n) for k, s, n in zip(*pairs, number, strict=True)}
    stated = np.flatnonzero((found.kind == MSG_BASE_POS_ECEF) & (found.length == 24))
    base = found.payloads(stated, 24).view("<f8").astype(np.float64)
    intact = int(found.length.sum()) + 8 * found.length.size
    return SbpFrames(counts, found.kind.size, len(data) - intact, base)


def looks_like_sbp(data: bytes) -> bool:
    """True if at least two intact frames lie in the first 64 kB."""
    return walk_sbp(data[:65536]).n_frames >= 2
