"""NMEA sentences inside ANPP serial port passthrough packets (10)."""

import re
from functools import reduce
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.tables import frame_of
from thalweg.ingest.anpp.records import AnppRecords, Clock
from thalweg.ingest.anpp.tables import PASSTHROUGH, stamps

_ROUTES: Final = {0: "gpio", 1: "auxiliary"}
_SENTENCE: Final = re.compile(rb"[$!]([ \"#%-)+-~]{1,250})\*([0-9A-Fa-f]{2})")


def passthrough_table(records: AnppRecords, clock: Clock) -> tuple[pd.DataFrame, int]:
    """Sentences with a right checksum as table kind ``anpp_passthrough``; and how many had a wrong one.

    The bytes of each route are joined over packets, because a sentence may be split between two. A sentence
    takes the time of the time packet before the packet in which it ends.
    """
    rows: list[tuple[int, str, str]] = []
    wrong = 0
    for route in sorted({r for _, r, _ in records.passthrough}):
        pieces = [(packet, data) for packet, r, data in records.passthrough if r == route]
        ends = np.cumsum([len(data) for _, data in pieces])
        for found in _SENTENCE.finditer(b"".join(data for _, data in pieces)):
            if reduce(int.__xor__, found[1]) != int(found[2], 16):
                wrong += 1
                continue
            packet = pieces[int(np.searchsorted(ends, found.end()))][0]
            rows.append((packet, _ROUTES.get(route, str(route)), found[0].decode("ascii")))
    rows.sort(key=lambda row: row[0])
    packet_number = np.array([row[0] for row in rows], dtype=np.int64)
    t_gps, t_device = stamps(clock, packet_number)
    table = frame_of(
        PASSTHROUGH,
        {
            "t_gps_s": t_gps,
            "t_device_s": t_device,
            "route": np.array([row[1] for row in rows], dtype=object),
            "sentence": np.array([row[2] for row in rows], dtype=object),
            "packet": packet_number + 1,
        },
    )
    return table, wrong
