"""Capture files of a VLP-16: data packets to UDP 2368, position packets to UDP 8308.

Sources: VLP-16 User Manual 63-9243 Rev. D, chapter 9 (packets); libpcap file format (headers); RFC 791, 768.
"""

import struct
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Final, Self

import numpy as np

from thalweg.core.types import AnyArray, ArrayI, ArrayU8

DATA_PAYLOAD: Final = 1206
POSITION_PAYLOAD: Final = 512
_HEAD: Final = 42
"""Ethernet 14, IPv4 20, UDP 8 bytes."""

_RETURN_BYTE: Final = {"strongest": 0x37, "last": 0x38, "dual": 0x39}
_PRODUCT: Final = 0x22


def _network_head(payload: int, port: int) -> bytes:
    ethernet = bytes.fromhex("ffffffffffff 607688000000 0800")
    fields = (0x45, 0, 20 + 8 + payload, 0, 0x4000, 255, 17, 0, bytes([192, 168, 1, 201]), bytes([255] * 4))
    ip = bytearray(struct.pack(">BBHHHBBH4s4s", *fields))
    total = sum(struct.unpack(">10H", ip))
    total = (total & 0xFFFF) + (total >> 16)
    total = (total & 0xFFFF) + (total >> 16)
    struct.pack_into(">H", ip, 10, ~total & 0xFFFF)
    # A UDP checksum of zero means "none", which is what the sensor sends.
    return ethernet + bytes(ip) + struct.pack(">HHHH", port, port, 8 + payload, 0)


_DATA_HEAD: Final = _network_head(DATA_PAYLOAD, 2368)
_POSITION_HEAD: Final = _network_head(POSITION_PAYLOAD, 8308)


def data_payloads(
    azimuth_cdeg: ArrayI, distance_2mm: AnyArray, intensity: AnyArray, toh_us: ArrayI, returns: str
) -> ArrayU8:
    """Payloads (n, 1206) of data packets.

    Parameters
    ----------
    azimuth_cdeg : (n, 12) azimuth of each block, 0 to 35999 hundredths of a degree.
    distance_2mm : (n, 12, 32) distances in units of 2 mm, 0 where there is no return.
    intensity : (n, 12, 32) calibrated reflectivity, 0 to 255.
    toh_us : (n,) microseconds past the hour of the first firing.
    returns : ``strongest``, ``last`` or ``dual``.
    """
    n = len(toh_us)
    out = np.zeros((n, DATA_PAYLOAD), dtype=np.uint8)
    blocks = out[:, :1200].reshape(n, 12, 100)
    blocks[..., 0], blocks[..., 1] = 0xFF, 0xEE
    blocks[..., 2:4] = azimuth_cdeg.astype("<u2")[..., None].view(np.uint8)
    shots = blocks[..., 4:].reshape(n, 12, 32, 3)
    shots[..., :2] = np.ascontiguousarray(distance_2mm, dtype="<u2")[..., None].view(np.uint8)
    shots[..., 2] = intensity
    blocks[..., 4:] = shots.reshape(n, 12, 96)
    out[:, 1200:1204] = np.ascontiguousarray(toh_us, dtype="<u4")[:, None].view(np.uint8)
    out[:, 1204], out[:, 1205] = _RETURN_BYTE[returns], _PRODUCT
    return out


def position_payload(toh_us: int, pps: int, sentence: str) -> bytes:
    """Payload of a position packet: time past the hour, PPS state and the last RMC sentence.

    Parameters
    ----------
    toh_us : microseconds past the hour.
    pps : 0 absent, 1 synchronising, 2 locked, 3 error.
    sentence : RMC with ``$`` and checksum, or empty if there is no receiver.
    """
    out = bytearray(POSITION_PAYLOAD)
    struct.pack_into("<IB", out, 198, toh_us, pps)
    text = (sentence + "\r\n").encode("ascii") if sentence else b""
    out[206 : 206 + len(text)] = text
    return bytes(out)


class CaptureWriter:
    """Writes a classic pcap file, packet by packet.

    Parameters
    ----------
    path : target.
    nanoseconds : stamps in nanoseconds instead of microseconds.
    """

    def __init__(self, path: Path, *, nanoseconds: bool = False) -> None:
        self._nano = nanoseconds
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file: BinaryIO = path.open("wb")
        magic = 0xA1B23C4D if nanoseconds else 0xA1B2C3D4
        self._file.write(struct.pack("<IHHiIII", magic, 2, 4, 0, 0, 65535, 1))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    def data(self, host_ns: int, payload: bytes) -> None:
        """Write a data packet; ``host_ns`` is Unix time of the recording computer in nanoseconds."""
        self._frame(host_ns, _DATA_HEAD, payload)

    def position(self, host_ns: int, payload: bytes) -> None:
        """Write a position packet."""
        self._frame(host_ns, _POSITION_HEAD, payload)

    def _frame(self, host_ns: int, head: bytes, payload: bytes) -> None:
        seconds, rest = divmod(int(host_ns), 1_000_000_000)
        length = len(head) + len(payload)
        fraction = rest if self._nano else rest // 1000
        self._file.write(struct.pack("<IIII", seconds, fraction, length, length) + head + payload)
