"""The truth of single lidar shots: which point of which surface each return came from.

The point of a surface is where the echo arose in the footprint: the centre of energy of what the parts of the
beam met, or the point of the brightest part if the twin makes no mixed pixels. The point of a mixed return
lies between the surfaces, that of a ghost on the surface above the water that the mirrored beam came back
from, and that of the own boat on the boat. The noise of the range is not in it; the beam's offset across
itself is.

A long recording has more shots than anybody needs to judge it by, so the truth is kept of whole packets drawn
at random: each with the same chance, such that about 2.5 million shots are drawn, or all if there are fewer.
The chance (``share``), the number of packets fired and of those drawn stand in the table's facts. A packet
that is not drawn has no rows; a shot of a drawn packet has a row for each of its returns, so none if it has
no return. Packets that the log lost later may be among them.
"""

import json
from collections.abc import Mapping
from enum import IntEnum
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import pyarrow as pa
import pyarrow.parquet as pq

from thalweg.core.tables import column, table_kind
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayU8
from thalweg_lab.base.random import generator

_F = pa.float64()

MANY_SHOTS: Final = 2.5e6
"""Shots whose truth is kept on average, of recordings with more than that."""


class EchoKind(IntEnum):
    """What an echo is, for scoring filters."""

    SURFACE = 0
    MIXED = 1
    GHOST = 2
    HULL = 3


LIDAR_SHOTS: Final = table_kind(
    "twin_lidar_shots",
    2,
    [
        column("t_gps_s", _F, "s", "adjusted standard GPS time of the shot; shots are 2.304 us apart"),
        *(column(f"{a}_m", _F, "m", f"{a} of the surface point, wcs") for a in ("east", "north", "up")),
        column("material", pa.uint8(), "1", "material, numbers of the scene file; 255 is the own boat"),
        column("return_number", pa.uint8(), "1", "1 is the nearest return of the shot"),
        column("kind", pa.uint8(), "1", "0 surface, 1 mixed of several, 2 mirror ghost, 3 own boat"),
    ],
)  # fmt: skip


def drawn_packets(seed: int, n_packets: int, shots_per_packet: int) -> tuple[ArrayB, float]:
    """Which packets (n_packets,) keep the truth of their shots, and the chance that each of them had."""
    share = min(1.0, MANY_SHOTS / max(n_packets * shots_per_packet, 1))
    return generator(seed, "lidar truth packets").random(n_packets) < share, share


class ShotWriter:
    """Writes table kind ``twin_lidar_shots`` piece by piece; does nothing without a path.

    Parameters
    ----------
    path : target, ``.parquet``, or None.
    facts : JSON-able facts of the whole table.
    """

    def __init__(self, path: Path | None, facts: Mapping[str, Any]) -> None:
        self._writer: pq.ParquetWriter | None = None
        meta = json.dumps(dict(facts)).encode()
        self._schema = LIDAR_SHOTS.with_metadata({**(LIDAR_SHOTS.metadata or {}), b"meta": meta})
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(path, self._schema, compression="zstd")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._writer is not None:
            self._writer.close()

    def add(
        self, t_gps_s: ArrayF, point_wcs_m: ArrayF, material: ArrayU8, return_number: AnyArray, kind: ArrayU8
    ) -> None:
        """Add returns: (n,) times, (n, 3) points, (n,) materials, numbers and kinds."""
        if self._writer is None:
            return
        arrays = [t_gps_s, *point_wcs_m.T, material, return_number.astype("uint8"), kind]
        columns = [pa.array(a, type=f.type) for a, f in zip(arrays, self._schema, strict=True)]
        self._writer.write_table(pa.Table.from_arrays(columns, schema=self._schema))
