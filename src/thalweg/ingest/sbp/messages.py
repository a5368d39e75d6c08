"""Layouts and flags of the SBP messages that are read.

All little endian. Source: Swift Navigation, SBP specification 6.5 (as in the library ``sbp`` 6.5.2, against
which the tests compare each field).

A frame is 0x55, type u16, sender u16, length u8, payload and CRC16-CCITT (polynomial 0x1021, start 0) over
type to payload, all little endian (Swift Navigation, SBP specification, "Message framing"). No message has
type 0.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core import ArrayU8
from thalweg.ingest.framing import (
    CHUNK_BYTES,
    LogRecords,
    PacketBlock,
    StreamTally,
    find_in,
    find_sbp,
    read_packets,
)

GPS_TIME, GPS_TIME_DEP_A, GPS_TIME_GNSS, UTC_TIME = 0x0102, 0x0100, 0x0104, 0x0103
POS_LLH, POS_LLH_DEP_A, POS_LLH_GNSS = 0x020A, 0x0201, 0x022A
POS_LLH_COV, POS_LLH_COV_GNSS = 0x0211, 0x0231
POS_ECEF, POS_ECEF_DEP_A, POS_ECEF_COV = 0x0209, 0x0200, 0x0214
BASE_LLH, BASE_ECEF, AGE, EVENT, OBS = 0x0044, 0x0048, 0x0210, 0x0101, 0x004A

_WEEK = [("wn", "<u2"), ("tow", "<u4"), ("ns", "<i4")]
_LLH = [("tow", "<u4"), ("lat", "<f8"), ("lon", "<f8"), ("height", "<f8")]
_ECEF = [("tow", "<u4"), ("x", "<f8"), ("y", "<f8"), ("z", "<f8")]
_ACCURACY = [("h_accuracy", "<u2"), ("v_accuracy", "<u2")]
_END = [("n_sats", "u1"), ("flags", "u1")]


def _covariance(axes: str) -> list[tuple[str, str]]:
    a, b, c = list(axes)
    return [(f"cov_{i}_{j}", "<f4") for i, j in ((a, a), (a, b), (a, c), (b, b), (b, c), (c, c))]


_L_TIME = np.dtype([*_WEEK, ("flags", "u1")])
_L_LLH = np.dtype([*_LLH, *_ACCURACY, *_END])
_L_LLH_COV = np.dtype([*_LLH, *_covariance("ned"), *_END])
_L_ECEF = np.dtype([*_ECEF, ("accuracy", "<u2"), *_END])

LAYOUTS: Final[Mapping[int, np.dtype[Any]]] = {
    GPS_TIME: _L_TIME,
    GPS_TIME_DEP_A: _L_TIME,
    GPS_TIME_GNSS: _L_TIME,
    UTC_TIME: np.dtype(
        [
            ("flags", "u1"),
            ("tow", "<u4"),
            ("year", "<u2"),
            ("month", "u1"),
            ("day", "u1"),
            ("hours", "u1"),
            ("minutes", "u1"),
            ("seconds", "u1"),
            ("ns", "<u4"),
        ]
    ),
    POS_LLH: _L_LLH,
    POS_LLH_DEP_A: _L_LLH,
    POS_LLH_GNSS: _L_LLH,
    POS_LLH_COV: _L_LLH_COV,
    POS_LLH_COV_GNSS: _L_LLH_COV,
    POS_ECEF: _L_ECEF,
    POS_ECEF_DEP_A: _L_ECEF,
    POS_ECEF_COV: np.dtype([*_ECEF, *_covariance("xyz"), *_END]),
    BASE_LLH: np.dtype(_LLH[1:]),
    BASE_ECEF: np.dtype(_ECEF[1:]),
    AGE: np.dtype([("tow", "<u4"), ("age", "<u2")]),
    OBS: np.dtype([("tow", "<u4"), ("ns", "<i4"), ("wn", "<u2"), ("n_obs", "u1")]),
}
"""Messages that are decoded; of MsgObs only the head, which 17 bytes a signal follow."""

OBS_SIGNAL_BYTES: Final = 17
"""Bytes of one signal in MsgObs: P u32, L i32 + u8, D i16 + u8, cn0, lock, flags, satellite, code."""

IMU_RAW, MAG_RAW = 0x0900, 0x0902

FIX: Final = np.array(
    ["none", "single", "dgnss", "float", "fixed", "dead_reckoning", "sbas", "none"], dtype=object
)
"""Bits 0-2 of the flags of positions and baselines."""

FIX_DEP_A: Final = np.array(["single", "fixed", "float", *["none"] * 5], dtype=object)
"""The same bits in the deprecated messages ..._DEP_A, where 0 is a single point solution."""

DEP_A: Final = frozenset({POS_LLH_DEP_A, POS_ECEF_DEP_A})


# ---------------------------------------------------------------- Framing of the Swift Binary Protocol


def find_messages(buf: ArrayU8, tally: StreamTally | None = None) -> PacketBlock:
    """All intact messages of a buffer.

    Parameters
    ----------
    buf : (n,) bytes; cut messages at either end are left out.
    tally : takes the bytes outside of messages.

    Examples
    --------
    >>> import numpy as np
    >>> raw = bytes.fromhex("55 0b 01 d3 88 07 28 f4 7a 13 03 00 01")  # a frame cut in its payload
    >>> find_messages(np.frombuffer(raw, np.uint8)).kind.size
    0
    """
    block, _ = find_in(buf, find_sbp, StreamTally() if tally is None else tally)
    return block


# ---------------------------------------------------------------- Decoded SBP messages by type


CURE = "Give files as the receiver logs them (.sbp, .bin), not the JSON of Swift Console"


@dataclass(slots=True, kw_only=True)
class SbpRecords(LogRecords):
    """All decoded messages of a log."""

    layouts: Mapping[int, np.dtype[Any]] = field(default_factory=lambda: LAYOUTS)
    tails: Mapping[int, int] = field(default_factory=lambda: {OBS: OBS_SIGNAL_BYTES})
    signals: Counter[tuple[int, int]] = field(default_factory=Counter)
    """Observed signals by (sender, code)."""

    def senders(self, kinds: Iterable[int]) -> Counter[int]:
        """Senders of some types other than 0, and how many messages each sent."""
        wanted = set(kinds)
        out: Counter[int] = Counter()
        for (kind, sender), n in self.counts.items():
            if kind in wanted and sender:
                out[sender] += n
        return out


def collect(files: Sequence[Path], chunk_bytes: int = CHUNK_BYTES) -> SbpRecords:
    """Read all messages of a log that are of interest.

    Raises
    ------
    InputError : no files, a file that cannot be read, is no SBP log, or all files are empty.
    """
    out = SbpRecords()
    for block in read_packets(
        files, find_sbp, out.tally, what="SBP message", cure=CURE, chunk_bytes=chunk_bytes
    ):
        out.feed(block)
        _count_signals(block, out.signals)
    return out


def _count_signals(block: PacketBlock, signals: Counter[tuple[int, int]]) -> None:
    head = LAYOUTS[OBS].itemsize
    beyond = block.length - head
    rows = np.flatnonzero((block.kind == OBS) & (beyond >= 0) & (beyond % OBS_SIGNAL_BYTES == 0))
    n = beyond[rows] // OBS_SIGNAL_BYTES
    message = np.repeat(rows, n)
    inside = np.arange(message.size) - np.repeat(np.cumsum(n) - n, n)
    last_byte = block.offset[message] + head + (inside + 1) * OBS_SIGNAL_BYTES - 1
    both = block.sender[message].astype(np.int64) << 8 | block.buf[last_byte]
    for value, count in zip(*np.unique(both, return_counts=True), strict=True):
        signals[int(value) >> 8, int(value) & 0xFF] += int(count)
