"""Named defects of logs, drawn from the seed and each of them reported."""

from pathlib import Path
from typing import Any

import numpy as np

from thalweg.core import ArrayB, ArrayF, ArrayI
from thalweg_lab.settings import Stream, TwinEffects

_SPARED_BYTES = 64
"""Begin of a file that is never damaged: without its file header a capture is no capture."""


def lost_packets(effects: TwinEffects, n: int, rng: np.random.Generator) -> ArrayB:
    """Which of ``n`` packets are missing: bursts at random places, (n,) bool."""
    pieces = -(-n // effects.lost_burst)
    bursts = min(pieces, round(effects.lost_packets * n / effects.lost_burst))
    hit = np.zeros(pieces, dtype=np.bool_)
    hit[rng.choice(pieces, bursts, replace=False)] = True
    return np.repeat(hit, effects.lost_burst)[:n]


def packet_order(effects: TwinEffects, n: int, rng: np.random.Generator) -> ArrayI:
    """Packets in the order in which they are captured: with losses, copies and swapped neighbours."""
    order = np.flatnonzero(~lost_packets(effects, n, rng))
    if effects.swapped_packets and len(order) > 1:
        pairs = rng.choice(len(order) // 2, min(effects.swapped_packets, len(order) // 2), replace=False)
        first = 2 * np.sort(pairs)
        order[first], order[first + 1] = order[first + 1], order[first].copy()
    if effects.duplicate_packets and len(order):
        again = np.sort(rng.choice(len(order), min(effects.duplicate_packets, len(order)), replace=False))
        order = np.insert(order, again + 1, order[again])
    return order


def inside(t_s: ArrayF, spans: tuple[tuple[float, float], ...]) -> ArrayB:
    """Which times lie in one of the spans (begin, length)."""
    hit = np.zeros(np.shape(t_s), dtype=np.bool_)
    for begin, length in spans:
        hit |= (t_s >= begin) & (t_s < begin + length)
    return hit


def damage_file(path: Path, stream: Stream, effects: TwinEffects, rng: np.random.Generator) -> dict[str, Any]:
    """Replace bytes and cut the end of a log, as the settings say.

    Returns
    -------
    facts : offsets of the replaced bytes, and the number of bytes cut.
    """
    if stream not in effects.damaged_streams or not (effects.corrupt_bytes or effects.cut_end_bytes):
        return {"corrupt_offsets": [], "cut_end_bytes": 0}
    size = path.stat().st_size
    cut = min(effects.cut_end_bytes, max(0, size - _SPARED_BYTES))
    offsets: list[int] = []
    with path.open("r+b") as file:
        file.truncate(size - cut)
        room = size - cut - _SPARED_BYTES
        if room > 0:
            count = min(effects.corrupt_bytes, room)
            offsets = sorted(int(o) + _SPARED_BYTES for o in rng.choice(room, count, replace=False))
        for offset in offsets:
            file.seek(offset)
            old = file.read(1)[0]
            file.seek(offset)
            # Never the same byte again: each offset in the report is a real damage.
            file.write(bytes([(old + int(rng.integers(1, 256))) % 256]))
    return {"corrupt_offsets": offsets, "cut_end_bytes": cut}
