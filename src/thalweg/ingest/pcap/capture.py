"""UDP payloads out of captured network traffic: pcap, pcapng, or bare payloads one after another.

The file is read in pieces, so memory does not grow with the log. Records are walked in compiled code.
Whatever is not wanted (other ports, TCP, ARP, IPv6) is counted, whatever is damaged is counted as lost,
and reading goes on behind a damaged record where the next sound one can be found.

Sources: libpcap file format (draft-ietf-opsawg-pcap), pcapng (draft-ietf-opsawg-pcapng), link types of
tcpdump.org, RFC 791 (IPv4), RFC 768 (UDP).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from thalweg.core.errors import InputError
from thalweg.core.types import ArrayF, ArrayI, ArrayU8
from thalweg.ingest.pcap import kernels as frames
from thalweg.ingest.pcap.records import (
    CURE,
    PCAP_MAGIC,
    PCAPNG_MAGIC,
    BareFormat,
    BarePayloads,
    Pcap,
    Pcapng,
    RecordFormat,
    Sinks,
    Stream,
    Window,
)

__all__ = ["CHUNK_BYTES", "BarePayloads", "CaptureTally", "PayloadBlock", "Stream", "read_payloads"]

CHUNK_BYTES: Final = 8 << 20
"""Bytes read at a time."""

_NAMED_DAMAGES: Final = 20
"""Damages that are named one by one; the rest is only counted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PayloadBlock:
    """Payloads of one stream out of one piece of the file.

    Attributes
    ----------
    payload : (n, size) bytes.
    record : (n,) number of the record in the file, from 0; it orders the streams among each other.
    offset_b : (n,) byte of the file at which the payload begins.
    sender : (n,) IPv4 address of the sender as a number; 0 in bare files.
    t_host_s : (n,) stamp of the capturing computer (Unix time), NaN if the file has none. For findings
        about that clock only: no measurement is ever timed by it.
    """

    payload: ArrayU8
    record: ArrayI
    offset_b: ArrayI
    sender: ArrayI
    t_host_s: ArrayF


@dataclass(slots=True, kw_only=True)
class CaptureTally:
    """What a capture file held besides the payloads; one may be used for several files."""

    format: str = ""
    bytes_read: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    losses: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    foreign_ports: dict[int, int] = field(default_factory=dict)
    """Payloads of the first stream's size that went to other ports: a hint at a wrong port setting."""


def _format_of(w: Window, path: Path, streams: Sequence[Stream], bare: BarePayloads | None) -> RecordFormat:
    head = w.buf[: min(w.n, 64)].tobytes()
    if not head:
        raise InputError("file is empty", expected="pcap or pcapng", where=path, cure=CURE)
    if head[:4] in PCAP_MAGIC:
        return Pcap(head, path)
    if head[:4] == PCAPNG_MAGIC:
        return Pcapng()
    if bare is not None:
        form = BareFormat(streams[0].size, bare)
        status, _ = form.find(w, 0)
        if status == frames.FOUND:
            return form
    packed = {b"\x1f\x8b": "gzip", b"BZh": "bzip2", b"\xfd7zXZ": "xz", b"\x28\xb5\x2f\xfd": "zstd"}
    kind = next((name for magic, name in packed.items() if head.startswith(magic)), "")
    raise InputError(
        f"a {kind} archive" if kind else f"not a capture: the file begins with {head[:4].hex(' ')}",
        expected="pcap, pcapng" + (" or bare payloads" if bare else ""),
        where=path,
        cure="Unpack it first" if kind else CURE,
    )


def read_payloads(
    path: Path,
    streams: Sequence[Stream],
    *,
    bare: BarePayloads | None = None,
    tally: CaptureTally | None = None,
    chunk_bytes: int = CHUNK_BYTES,
) -> Iterator[list[PayloadBlock]]:
    """Read the payloads of some UDP streams, piece by piece.

    Parameters
    ----------
    path : pcap (micro- or nanoseconds), pcapng, or payloads of the first stream without any header.
    streams : what is wanted; the first one is the main stream.
    bare : how to recognise bare payloads; None refuses such files.
    tally : takes counts, losses and notes; complete when the iterator is exhausted.
    chunk_bytes : size of a piece.

    Yields
    ------
    One `PayloadBlock` a stream for each piece (some may be empty).

    Raises
    ------
    InputError : no such file, empty, or not a capture.
    UnsupportedError : a link type that is not implemented.
    """
    found = CaptureTally() if tally is None else tally
    try:
        file = path.open("rb")
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", where=path, cure="Check the path of the lidar log"
        ) from error
    with file:
        w = Window(file, max(int(chunk_bytes), 4096))
        w.fill()
        form = _format_of(w, path, streams, bare)
        found.format = form.name
        sinks = Sinks(streams, w.buf.size // (min(s.size for s in streams) + 16) + 2)
        yield from _read(w, form, sinks, path, found)
    found.bytes_read += w.base + w.n
    _settle(sinks, found)


def _read(
    w: Window, form: RecordFormat, sinks: Sinks, path: Path, found: CaptureTally
) -> Iterator[list[PayloadBlock]]:
    """Walk all records; at a damaged one look for the next sound one and count the bytes between."""
    o, previous, floor = form.start, -1, -1
    while True:
        status, o, last, rows, _ = form.walk(w, o, sinks)
        if rows:
            yield _blocks(w, sinks, rows)
        previous = w.base + last if last >= 0 else previous
        if status == frames.META:
            status, o = form.meta(w, o)
        if status == frames.NEED and not w.final:
            w.refill(o)
            o = 0
            continue
        if status == frames.NEED and o >= w.n:
            return
        if status in (frames.BAD, frames.NEED):
            cut, bad = status == frames.NEED, w.base + o
            # The length of the record before may be what is wrong, so the search begins inside it; never
            # before the last resumption, so that each search ends further on.
            inside = previous + 17 if previous >= w.base and not cut else bad + 1
            o = _resume(w, form, max(min(inside, bad + 1), floor + 1) - w.base)
            floor = w.base + o
            _report_damage(found, path, bad, floor, cut and o >= w.n)
            if o >= w.n:
                return


def _resume(w: Window, form: RecordFormat, o: int) -> int:
    """Offset in the (moved on) window of the next sound record, or its end if there is none."""
    while True:
        status, o = form.find(w, o)
        if status == frames.FOUND:
            return o
        if w.final:
            return w.n
        w.refill(o)
        o = 0


def _report_damage(found: CaptureTally, path: Path, bad: int, resumed: int, cut: bool) -> None:
    skipped = max(0, resumed - bad)
    found.losses["bytes_skipped"] = found.losses.get("bytes_skipped", 0) + skipped
    if cut:
        found.losses["cut_records"] = found.losses.get("cut_records", 0) + 1
        found.notes.append(f"{path.name} ends inside a packet: the last {skipped} bytes are unusable.")
        return
    n = found.losses.get("damaged_records", 0) + 1
    found.losses["damaged_records"] = n
    if n <= _NAMED_DAMAGES:
        found.notes.append(f"{path.name}: damaged at byte {bad}, reading goes on at byte {resumed}.")


def _blocks(w: Window, sinks: Sinks, rows: int) -> list[PayloadBlock]:
    """Copy the payloads that were found out of the window, one block a stream."""
    blocks = []
    for i, size in enumerate(sinks.sizes):
        mine = np.flatnonzero(sinks.out[:rows, 1] == i)
        start = sinks.out[mine, 0]
        payload = np.empty((mine.size, int(size)), dtype=np.uint8)
        frames.gather(w.buf, start, payload)
        blocks.append(
            PayloadBlock(
                payload=payload,
                record=sinks.out[mine, 2],
                offset_b=start + w.base,
                sender=sinks.out[mine, 3],
                t_host_s=sinks.out_t[mine],
            )
        )
    return blocks


def _settle(sinks: Sinks, found: CaptureTally) -> None:
    for names, target in ((frames.COUNT_NAMES, found.counts), (frames.LOSS_NAMES, found.losses)):
        for index, name in names.items():
            if sinks.tally[index]:
                target[name] = target.get(name, 0) + int(sinks.tally[index])
    for port in np.flatnonzero(sinks.foreign):
        found.foreign_ports[int(port)] = found.foreign_ports.get(int(port), 0) + int(sinks.foreign[port])
