"""Made-up recordings, one writer each, and readers on damaged ones."""

import binascii
import struct
from collections.abc import Callable, Iterator
from functools import reduce
from io import StringIO
from operator import xor
from pathlib import Path
from typing import Any

import pandas as pd
from pyproj import CRS

from tests.conftest import check_whole
from thalweg.bathymetry import read_soundings
from thalweg.cli import main
from thalweg.core import ThalwegError

ROVER = 12027
"""A sender of SBP."""


def nmea(body: str) -> str:
    """A sentence of NMEA 0183 with its check sum."""
    return f"${body}*{reduce(xor, body.encode()):02X}\r\n"


def anpp(packet_id: int, payload: bytes) -> bytes:
    """A packet of an INS of Advanced Navigation."""
    head = bytes([packet_id, len(payload)]) + struct.pack("<H", binascii.crc_hqx(payload, 0xFFFF))
    return bytes([-sum(head) & 0xFF]) + head + payload


def sbp(kind: int, payload: bytes, sender: int = ROVER) -> bytes:
    """A message of a receiver of Swift Navigation."""
    body = struct.pack("<HHB", kind, sender, len(payload)) + payload
    return b"\x55" + body + struct.pack("<H", binascii.crc_hqx(body, 0))


def files_of(folder: Path, *contents: bytes | str, name: str = "log") -> list[Path]:
    """Files with these contents, in their order."""
    files = [folder / f"{name}{k}" for k in range(len(contents))]
    for path, data in zip(files, contents, strict=True):
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return files


def noted(found: Any, *words: str) -> bool:
    """Whether one note of a report, or of the report of what was read, holds all these words."""
    notes = getattr(found, "report", found).notes
    return any(all(word in note for word in words) for note in notes)


def new_campaign(logs: Path, folder: Path) -> Path:
    """The file of a new campaign of these logs, with a lever arm where one is asked for."""
    assert main(["new-campaign", "boat", "--from-logs", str(logs), "--folder", str(folder)]) == 0
    path = folder / "boat.yaml"
    path.write_text(path.read_text().replace("lever_ics_m: CHANGE", "lever_ics_m: [0.0, 0.0, 0.3]"))
    return path


def sounded(path: Path, crs: CRS | None, **how: Any) -> Any:
    """Soundings of a table of which nothing is stated beside it."""
    nothing = dict.fromkeys(("column", "depth", "level_m", "line_column"))
    return read_soundings(path, crs, **{**nothing, "sigma_m": 0.02, **how})


def numbers(text: str) -> pd.DataFrame:
    """A table as it stands on paper: names in the first line, blanks between the columns."""
    return pd.read_csv(StringIO(text), sep=r"\s+")


def read_or_refused(
    fuzz: Any, path: Path, read: Callable[[list[Path]], Any], *sources: bytes, **how: Any
) -> Iterator[tuple[bytes, Any]]:
    """Damaged files, and what a reader made of each that it did not refuse by a whole message."""
    for data in fuzz.inputs(*sources, **how):
        path.write_bytes(data)
        try:
            found = read([path])
        except ThalwegError as error:
            check_whole(error)
            continue
        fuzz.was_read(reported=not found.report.clean)
        yield data, found
