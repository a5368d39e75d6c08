"""LAS and LAZ clouds of other makers, whole or cut.

A LAZ file keeps the table of its chunks at the end, and no library reads one without it. Chunks of
layered LAZ (point formats 6 to 10) state the sizes of their layers, so a cut file is walked from the
front, its whole chunks are given a new table in a temporary file, and that is read (LASzip 3
specification, "layered chunked" compressor).
"""

import struct
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import lazrs
import numpy as np

from thalweg.core.errors import InputError
from thalweg.core.las.chunks import laz_layout, whole_chunks
from thalweg.core.las.files import iter_laz, laz_header
from thalweg.core.las.header import LazHeader, library_errors
from thalweg.core.types import AnyArray
from thalweg.ingest.clouds.raw import RawCloud, eight_bit
from thalweg.ingest.integrity import IntegrityReport

WEEK_TIMES: Final = "Times are seconds of an unstated GPS week: they are left empty."

_CHUNK_POINTS: Final = 500_000
_LAYERED: Final = 3
_NAMES: Final[tuple[str, ...]] = ("xyz_m", "intensity", "rgb", "t_gps_s", "t_week_s")


def read_las(path: Path, report: IntegrityReport) -> RawCloud:
    """All points of a LAS or LAZ file that can be read.

    Raises
    ------
    InputError : the header is damaged, or no point can be read.
    """
    header = laz_header(path)
    report.format = f"LAS/LAZ, point format {header.point_format}"
    report.count("points_declared", header.n_points)
    if header.crs_note:
        report.note(header.crs_note)
    parts: list[dict[str, AnyArray]] = []
    try:
        _collect(iter_laz(path, _CHUNK_POINTS), parts)
    except InputError as error:
        if not parts:
            _salvage(path, parts, error)
        report.note(f"The file is cut or damaged: {error.found}.")
    n = sum(len(part["xyz_m"]) for part in parts)
    if not n:
        raise InputError("the cloud has no points", expected="at least one point", where=path)
    if n < header.n_points:
        report.lose("points_missing", header.n_points - n)
        report.note(f"{n:,} of {header.n_points:,} points could be read.")
    return _raw({name: np.concatenate([p[name] for p in parts]) for name in parts[0]}, header, report)


def _collect(chunks: Iterable[dict[str, AnyArray]], parts: list[dict[str, AnyArray]]) -> None:
    for chunk in chunks:
        kept: dict[str, AnyArray] = {name: chunk[name] for name in _NAMES if name in chunk}
        parts.append(kept)  # one by one: what was read before an error stays


def _raw(columns: dict[str, AnyArray], header: LazHeader, report: IntegrityReport) -> RawCloud:
    if "t_week_s" in columns:
        report.note(WEEK_TIMES)
    t = columns["t_gps_s"]
    return RawCloud(
        points=columns["xyz_m"],
        intensity=columns["intensity"].astype(np.float32) if "intensity" in columns else None,
        rgb=eight_bit(columns["rgb"], report) if "rgb" in columns else None,
        t_gps_s=t if np.isfinite(t).any() else None,
        frame=header.frame,
        step_m=header.scale_m,
    )


def _salvage(path: Path, parts: list[dict[str, AnyArray]], error: InputError) -> None:
    """Read the whole chunks of a cut layered LAZ; raises the first error again if there are none."""
    layout = laz_layout(path)
    table, end = whole_chunks(path, layout) if layout is not None else ([], 0)
    if layout is None or not table:
        raise error
    with tempfile.TemporaryDirectory() as folder:
        mended = Path(folder) / path.name
        with path.open("rb") as source, mended.open("wb") as out:
            head = bytearray(source.read(layout.start))
            # no extended VLRs, and the number of points that are left; format 6+ has no 32-bit count
            struct.pack_into("<QIQ", head, 235, 0, 0, sum(n for n, _ in table))
            out.write(head)
            out.write(struct.pack("<q", end))
            source.seek(layout.start + 8)
            for _, length in table:
                out.write(source.read(length))
            with library_errors(path, "mend the LAZ file"):
                lazrs.write_chunk_table(out, table, lazrs.LazVlr(layout.laszip))
        try:
            _collect(iter_laz(mended, _CHUNK_POINTS), parts)
        except InputError:
            if not parts:
                raise error from None
