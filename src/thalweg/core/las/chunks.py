"""The chunks of a LAZ file: checked before the library believes their sizes, and found again in a cut file.

The library aborts the whole process when a damaged size asks for more memory than there is, so every
size is compared with the file first. Layout: LASzip specification (record 22204 "laszip encoded", chunk
table, layered chunks of point formats 6 to 10).
"""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import lazrs

from thalweg.core.errors import InputError
from thalweg.core.las.header import library_errors

_LAYERED: Final = 3
_COMPRESSORS: Final = (1, 2, 3)
_LAYERS: Final = {10: 9, 11: 1, 12: 2, 13: 1}
_BYTES_LAYERED: Final = 14
_MIN_TABLE_BYTES: Final = 8


@dataclass(frozen=True, slots=True)
class LazLayout:
    """Where the chunks begin, the point record's length, layers a chunk (0 if not layered), LASzip record."""

    start: int
    record: int
    layers: int
    laszip: bytes


def laz_layout(path: Path) -> LazLayout | None:
    """Layout of a LAZ file whose header is sound (`las_header.check_las_bytes`); None if not compressed.

    Raises
    ------
    InputError : the LASzip record is missing or contradicts the header.
    """
    with path.open("rb") as stream:
        head = stream.read(375)
        header_size, start, n_vlrs, fmt, record = struct.unpack_from("<HIIBH", head, 94)
        if not fmt & 0xC0:
            return None
        stream.seek(header_size)
        laszip = b""
        for _ in range(n_vlrs):
            vlr = stream.read(54)
            number, length = struct.unpack_from("<HH", vlr, 18)
            content = stream.read(length)
            if vlr[2:18].rstrip(b"\0") == b"laszip encoded" and number == 22204:
                laszip = content
    items: list[tuple[int, int, int]] = []
    if len(laszip) >= 34:
        n_items = struct.unpack_from("<H", laszip, 32)[0]
        if len(laszip) >= 34 + 6 * n_items:
            items = [struct.unpack_from("<HHH", laszip, 34 + 6 * i) for i in range(n_items)]
    compressor = struct.unpack_from("<H", laszip)[0] if items else 0
    if compressor not in _COMPRESSORS or sum(size for _, size, _ in items) != record:
        raise InputError(
            f"the LASzip record (compressor {compressor}, items {items}) contradicts {record}-byte points",
            expected="items that add up to the point record",
            where=path,
            cure="Copy the file again from its source; the header is damaged",
        )
    layers = sum(size if kind == _BYTES_LAYERED else _LAYERS.get(kind, 0) for kind, size, _ in items)
    return LazLayout(start, record, layers if compressor == _LAYERED else 0, laszip)


def check_chunks(path: Path) -> None:
    """Compare the chunk table and the sizes inside layered chunks with the file.

    Raises
    ------
    InputError : a size points outside the file.
    """
    layout = laz_layout(path)
    if layout is None:
        return
    size = path.stat().st_size

    def refuse(found: str) -> InputError:
        """The error of a damaged chunk table."""
        return InputError(
            found,
            expected="a chunk table that fits the file",
            where=path,
            cure="The file is cut or damaged: copy it again from its source",
        )

    with path.open("rb") as stream:
        stream.seek(layout.start)
        stated = stream.read(8)
        if len(stated) < 8:
            raise refuse("the file ends before the points")
        table_at = struct.unpack("<q", stated)[0]
        if table_at == -1:
            stream.seek(size - 8)
            table_at = struct.unpack("<q", stream.read(8))[0]
        first = layout.start + 8
        if not first <= table_at <= size - _MIN_TABLE_BYTES:
            raise refuse(f"the chunk table should be at byte {table_at:,} of {size:,}")
        stream.seek(table_at)
        n_chunks = struct.unpack("<II", stream.read(8))[1]
        if n_chunks * layout.record > table_at - first:
            raise refuse(f"{n_chunks:,} chunks in {table_at - first:,} bytes")
        stream.seek(layout.start)
        with library_errors(path, "read the chunk table"):
            table = lazrs.read_chunk_table(stream, lazrs.LazVlr(layout.laszip)) if n_chunks else []
        at = first
        for number, (_, length) in enumerate(table, start=1):
            if length < 0 or at + length > table_at:
                raise refuse(f"chunk {number} of {n_chunks} claims {length:,} bytes")
            if layout.layers and _layered(stream, at, layout)[1] > length:
                raise refuse(f"the layers of chunk {number} of {n_chunks} exceed its {length:,} bytes")
            at += length


def whole_chunks(path: Path, layout: LazLayout) -> tuple[list[tuple[int, int]], int]:
    """Whole chunks (points, bytes) of a layered LAZ file from the front, and the byte behind the last.

    Each chunk is the first point, the number of points, the sizes of its layers, and the layers; nothing
    at the end of the file is needed.
    """
    size = path.stat().st_size
    table: list[tuple[int, int]] = []
    with path.open("rb") as stream:
        stream.seek(layout.start)
        stated = struct.unpack("<q", stream.read(8).ljust(8, b"\0"))[0]
        stop = stated if layout.start < stated <= size else size
        at = layout.start + 8
        while layout.layers and at + layout.record + 4 + 4 * layout.layers <= stop:
            points, length = _layered(stream, at, layout)
            if not points or at + length > stop:
                break
            table.append((points, length))
            at += length
    return table, at


def _layered(stream: BinaryIO, at: int, layout: LazLayout) -> tuple[int, int]:
    stream.seek(at + layout.record)
    raw = stream.read(4 + 4 * layout.layers)
    if len(raw) < 4 + 4 * layout.layers:
        return 0, 0
    points, *sizes = struct.unpack(f"<I{layout.layers}I", raw)
    return points, layout.record + len(raw) + sum(sizes)
