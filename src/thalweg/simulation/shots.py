"""The truth of single lidar shots: which point of which surface each return came from.

The point of a surface is where the echo arose in the footprint: the centre of energy of what the parts of the
beam met, or the point of the brightest part if the twin makes no mixed pixels. The point of a mixed return
lies between the surfaces, that of a ghost on the surface above the water that the mirrored beam came back
from, and that of the own boat on the boat. The noise of the range is not in it; the beam's offset across
itself is.
"""

from pathlib import Path
from types import TracebackType
from typing import Final, Self

import pyarrow as pa
import pyarrow.parquet as pq

from thalweg.core.tables import column, table_kind
from thalweg.core.types import AnyArray, ArrayF, ArrayU8

_F = pa.float64()

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


class ShotWriter:
    """Writes table kind ``twin_lidar_shots`` piece by piece; does nothing without a path.

    Parameters
    ----------
    path : target, ``.parquet``, or None.
    """

    def __init__(self, path: Path | None) -> None:
        self._writer: pq.ParquetWriter | None = None
        self._schema = LIDAR_SHOTS.with_metadata({**(LIDAR_SHOTS.metadata or {}), b"meta": b"{}"})
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
