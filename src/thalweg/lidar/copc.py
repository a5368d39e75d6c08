"""Cloud-optimised point clouds (COPC 1.0, copc.io): a chunk of LAZ for each node of an octree.

Records are sorted on the disk, so that memory holds a part of the cloud at a time, however long it is: they
are unpacked, dealt out to the parts of `parts_of`, each part is sorted and its nodes compressed. Nodes of
which several parts have points wait until the last of these: one at a time of each level. At the end chunks
are put in the order of the tree, coarse ones first.
"""

import struct
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, Final

import laspy
import lazrs
import numpy as np
from laspy.vlrs.vlrlist import VLRList

from thalweg.core import AnyArray, ArrayF, CoverageError, InputError, laz_header, library_errors
from thalweg.core.geometry import CELLS_BITS, Part, codes_of, cube_size_m, grow, node_key, parts_of

_FORMATS: Final = (6, 7, 8)
_POINTS_AT_ONCE: Final = 1_000_000
_NODES_AT_ONCE: Final = 64
"""Nodes that are compressed at once."""
_EVLR_HEADER: Final = 60


def export_copc(points: Path, out: Path, *, points_at_once: int = _POINTS_AT_ONCE) -> None:
    """Sort a cloud into an octree: a cloud-optimised point cloud, which any reader of LAZ reads, too.

    Programs read what they show of it from disk or over a network. Records are kept as they are, extra bytes
    and VLRs, too; in a node they stand in the order of the file. Memory: some 250 bytes for each of the
    points at once, whatever the size of the cloud. The disk of ``out`` holds the uncompressed file twice
    meanwhile.

    Parameters
    ----------
    points : LAS or LAZ of point format 6, 7 or 8, as Thalweg writes.
    out : target, ``.copc.laz``.
    points_at_once : in memory, at least 50,000; the file is the same for any number.

    Raises
    ------
    InputError : no such cloud, or damaged.
    CoverageError : it has no points.
    """
    n_points = laz_header(points).n_points
    with TemporaryDirectory(dir=out.parent) as name:
        folder = Path(name)
        with library_errors(points, "read its points"):
            cloud = _unpack(points, folder / "records", points_at_once)
        if cloud.n < n_points or not cloud.n:
            raise CoverageError(
                f"{cloud.n:,} points", expected=f"{max(n_points, 1):,}, as its header says", where=points
            )
        parts = parts_of(
            lambda: (cloud.codes(piece) for _, piece in cloud.pieces(points_at_once)), points_at_once
        )
        _deal_out(cloud, parts, folder / "dealt", points_at_once)
        cloud.records.unlink()
        laz = lazrs.LazVlr.new_for_compression(
            cloud.header.point_format.id,
            cloud.header.point_format.num_extra_bytes,
            use_variable_size_chunks=True,
        )
        nodes: list[tuple[int, int]] = []
        with (folder / "packed").open("w+b") as packed:
            packer = lazrs.ParLasZipCompressor(packed, laz)
            for batch in _batches(_nodes(cloud, parts, folder / "dealt")):
                packer.compress_chunks([records.tobytes() for _, records in batch])
                nodes += [node for node, _ in batch]
            packer.done()
            (folder / "dealt").unlink()
            packed.seek(0)
            chunks = lazrs.read_chunk_table(packed, laz)
            partial = folder / out.name
            with partial.open("w+b") as stream:
                _write(stream, packed, cloud, laz, nodes, chunks)
        partial.replace(out)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Cloud:
    """Uncompressed records of a cloud on the disk, in the order of the file."""

    records: Path
    header: Any
    n: int
    low_m: ArrayF
    size_m: float
    span_s: tuple[float, float]

    @property
    def dtype(self) -> Any:
        """Of a record of the file."""
        return self.header.point_format.dtype()

    @property
    def numbered(self) -> Any:
        """Of a record with its row in the file."""
        return np.dtype([("row", "<i8"), ("record", self.dtype)])

    def pieces(self, points_at_once: int) -> Iterator[tuple[int, AnyArray]]:
        """Row of the first, and records, of so many points."""
        for row in range(0, self.n, points_at_once):
            at = row * self.dtype.itemsize
            yield row, np.fromfile(self.records, self.dtype, points_at_once, offset=at)

    def codes(self, records: AnyArray) -> AnyArray:
        """Places (n,) of records (n,) on the curve that fills the root's cube."""
        return codes_of(_places_m(records, self.header), self.low_m, self.size_m)


def _places_m(records: AnyArray, header: Any) -> ArrayF:
    steps = np.stack([records[axis] for axis in "XYZ"], axis=1)
    return np.asarray(steps * header.scales + header.offsets)


def _unpack(points: Path, records: Path, points_at_once: int) -> _Cloud:
    """Write the records of a cloud as they are; its extent is that of the points, not of the header."""
    with laspy.open(points) as reader, records.open("wb") as stream:
        header = deepcopy(reader.header)
        if header.point_format.id not in _FORMATS:
            raise InputError(
                f"point format {header.point_format.id}",
                expected="6, 7 or 8, the formats of COPC",
                where=points,
                cure="Convert the file to LAS 1.4, such as by LazWriter or las2las",
            )
        n, low, high = 0, np.full(4, np.inf), np.full(4, -np.inf)
        for chunk in reader.chunk_iterator(points_at_once):
            stream.write(chunk.array.tobytes())
            n += len(chunk)
            facts = np.column_stack([_places_m(chunk.array, header), chunk.array["gps_time"]])
            low, high = np.minimum(low, facts.min(axis=0)), np.maximum(high, facts.max(axis=0))
    return _Cloud(
        records=records,
        header=header,
        n=n,
        low_m=low[:3],
        size_m=cube_size_m(low[:3], high[:3]) if n else 0.0,
        span_s=(float(low[3]), float(high[3])),
    )


def _deal_out(cloud: _Cloud, parts: Sequence[Part], dealt: Path, points_at_once: int) -> None:
    """Write the records with their rows, those of each part together, in the order of the file."""
    first = np.array([part.first_code for part in parts], np.uint64)
    to = np.array([part.begin for part in parts])
    with dealt.open("wb") as stream:
        for row, records in cloud.pieces(points_at_once):
            of_part = np.searchsorted(first, cloud.codes(records), side="right") - 1
            order = np.argsort(of_part, kind="stable")
            own, begin, n = np.unique(of_part[order], return_index=True, return_counts=True)
            for part, rows in zip(own, np.split(order, begin[1:]), strict=True):
                numbered = np.empty(len(rows), cloud.numbered)
                numbered["row"], numbered["record"] = row + rows, records[rows]
                stream.seek(int(to[part]) * cloud.numbered.itemsize)
                stream.write(numbered.tobytes())
            to[own] += n


def _nodes(cloud: _Cloud, parts: Sequence[Part], dealt: Path) -> Iterator[tuple[tuple[int, int], AnyArray]]:
    """Nodes (level, cube) and their records: of each part, and those of several after the last of these."""
    waiting: dict[tuple[int, int], list[AnyArray]] = {}
    for k, part in enumerate(parts):
        at = part.begin * cloud.numbered.itemsize
        records = np.fromfile(dealt, cloud.numbered, part.n, offset=at)
        code = cloud.codes(records["record"])
        order = np.argsort(code, kind="stable")
        for level, cube, places, _ in grow(code[order], part):
            own = records[np.sort(order[places])]
            if level < part.level:
                waiting.setdefault((level, cube), []).append(own)
            else:
                yield (level, cube), own["record"]
        following = parts[k + 1] if k + 1 < len(parts) else None
        for level, cube in list(waiting):
            if following is None or following.cube_at(level) != cube:
                whole = np.concatenate(waiting.pop((level, cube)))
                yield (level, cube), whole[np.argsort(whole["row"])]["record"]


def _batches(
    nodes: Iterator[tuple[tuple[int, int], AnyArray]],
) -> Iterator[list[tuple[tuple[int, int], AnyArray]]]:
    batch: list[tuple[tuple[int, int], AnyArray]] = []
    for each in nodes:
        batch.append(each)
        if len(batch) == _NODES_AT_ONCE:
            yield batch
            batch = []
    yield batch


def _write(
    stream: BinaryIO,
    packed: BinaryIO,
    cloud: _Cloud,
    laz: Any,
    nodes: Sequence[tuple[int, int]],
    chunks: Sequence[tuple[int, int]],
) -> None:
    """Header, chunks in the order of the tree, their table, list of the nodes."""
    _write_header(stream, cloud, laz, (0, 0))
    start = stream.tell()
    stream.write(bytes(8))  # where the table of chunks will be
    # the first eight bytes say the same of the packed ones
    begin = 8 + np.cumsum([0, *(n_bytes for _, n_bytes in chunks)])
    order = sorted(range(len(nodes)), key=nodes.__getitem__)
    entries = b""
    for k in order:
        n_points, n_bytes = chunks[k]
        packed.seek(int(begin[k]))
        entries += struct.pack("<4iQ2i", *_voxel(*nodes[k]), stream.tell(), n_bytes, n_points)
        stream.write(packed.read(n_bytes))
    table = stream.tell()
    lazrs.write_chunk_table(stream, [chunks[k] for k in order], laz)
    end = stream.seek(0, 2)
    stream.write(struct.pack("<H16sHQ32s", 0, b"copc", 1000, len(entries), b"hierarchy of nodes") + entries)
    stream.seek(start)
    stream.write(struct.pack("<q", table))
    stream.seek(0)
    _write_header(stream, cloud, laz, (end + _EVLR_HEADER, len(entries)))
    assert stream.tell() == start, "a header of the same size"


def _write_header(stream: BinaryIO, cloud: _Cloud, laz: Any, page: tuple[int, int]) -> None:
    """Header and VLRs; page: where the list of the nodes begins, and how long it is."""
    info = struct.pack(
        "<5d2Q2d88x",
        *(cloud.low_m + cloud.size_m / 2),
        cloud.size_m / 2,
        cloud.size_m / 2**CELLS_BITS,
        *page,
        *cloud.span_s,
    )
    own = deepcopy(cloud.header)
    kept = [vlr for vlr in own.vlrs if vlr.user_id not in ("copc", "laszip encoded")]
    packing = laspy.VLR("laszip encoded", 22204, "lazrs variable chunks", laz.record_data())
    own.vlrs = VLRList([laspy.VLR("copc", 1, "COPC info", info), *kept, packing])
    own.extra_header_bytes = own.extra_vlr_bytes = b""
    own.are_points_compressed = True
    own.start_of_first_evlr, own.number_of_evlrs = (page[0] - _EVLR_HEADER, 1) if page[0] else (0, 0)
    own.write_to(stream)


def _voxel(level: int, cube: int) -> tuple[int, int, int, int]:
    """Level, x, y, z of a node."""
    key = node_key(level, cube)
    x, y, z = (
        sum((int(digit) >> axis & 1) << k for k, digit in enumerate(reversed(key))) for axis in range(3)
    )
    return level, x, y, z
