"""Point clouds of other makers: LAS/LAZ, PLY and E57, with every lost point counted.

Coordinates stay in the file's own frame, in float64; nothing is shifted or transformed but the poses of
the scans inside an E57, which belong to the format.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from pyproj import CRS

from thalweg.core.errors import InputError, UnsupportedError
from thalweg.core.frames import LocalFrame
from thalweg.core.las.header import Frame, local_crs
from thalweg.core.types import AnyArray, ArrayF, ArrayF32, ArrayU8
from thalweg.ingest.clouds.e57 import read_e57
from thalweg.ingest.clouds.las import read_las
from thalweg.ingest.clouds.ply import read_ply
from thalweg.ingest.clouds.raw import RawCloud
from thalweg.ingest.integrity import IntegrityReport

__all__ = ["NO_CRS", "Cloud", "read_cloud"]

_READERS: Final = {b"LASF": read_las, b"ply": read_ply, b"ASTM-E57": read_e57}
NO_CRS: Final = "The file states no coordinate reference system."
_FINE_M: Final = 1.01e-3
"""Steps of a millimetre are usual and are not told."""


@dataclass(slots=True, kw_only=True)
class Cloud:
    """A point cloud in the frame of its file.

    Attributes
    ----------
    points : (n, 3) float64, m (or the unit of the file's CRS).
    intensity : (n,) float32 as stored, or None.
    rgb : (n, 3) uint8, or None; 16-bit and unit-interval colours are brought to 8 bit.
    normals : (n, 3) float32 in the file's frame, or None.
    t_gps_s : (n,) adjusted standard GPS time, NaN where unknown, or None.
    frame : local frame or CRS that the file states, else None.
    report : counts, losses and notes.
    step_m : coarsest step of the coordinates that the file's number format can tell; 0: far below 1 mm.
    """

    points: ArrayF
    intensity: ArrayF32 | None
    rgb: ArrayU8 | None
    normals: ArrayF32 | None
    t_gps_s: ArrayF | None
    frame: Frame
    report: IntegrityReport
    step_m: float = 0.0

    @property
    def crs(self) -> CRS | None:
        """CRS of the points; the engineering CRS of a local frame; None if the file states none."""
        return local_crs(self.frame) if isinstance(self.frame, LocalFrame) else self.frame


def read_cloud(path: Path) -> Cloud:
    """Read a cloud; the format is recognised by content.

    Parameters
    ----------
    path : LAS, LAZ, PLY or E57.

    Returns
    -------
    The finite points. Points that are not finite, marked invalid, or missing at the end of a cut file
    are counted in ``report.losses``.

    Raises
    ------
    InputError : missing, empty, damaged beyond reading, or without any finite point.
    UnsupportedError : another format.
    """
    if not path.is_file():
        raise InputError(
            "file not found", expected="a LAS, LAZ, PLY or E57 cloud", where=path, cure="Check the path"
        )
    with path.open("rb") as stream:
        head = stream.read(16)
    if not head:
        raise InputError("the file is empty", expected="a LAS, LAZ, PLY or E57 cloud", where=path)
    reader = next((r for magic, r in _READERS.items() if head.startswith(magic)), None)
    if reader is None:
        raise UnsupportedError(
            f"begins with {head[:8]!r}",
            expected="a LAS, LAZ, PLY or E57 cloud",
            where=path,
            cure="Export the cloud as LAZ",
        )
    report = IntegrityReport(stream="cloud", format="", files=[str(path)], bytes_read=path.stat().st_size)
    return _cloud(reader(path, report), report, path)


def _cloud(raw: RawCloud, report: IntegrityReport, path: Path) -> Cloud:
    finite: AnyArray = np.all(np.isfinite(raw.points), axis=1)
    if lost := int(np.count_nonzero(~finite)):
        report.lose("points_not_finite", lost)
    if not finite.any():
        raise InputError(
            f"none of {len(finite):,} points is finite",
            expected="points",
            where=path,
            cure="Export the cloud again",
        )
    if raw.step_m > _FINE_M:
        reach = float(np.abs(raw.points[finite]).max())
        report.note(
            f"Coordinates up to {reach:.0f} m resolve {raw.step_m * 1000:.3g} mm only (single precision, or "
            "a coarse scale). Export doubles, a finer scale, or coordinates with a shift."
        )

    def keep(values: AnyArray | None) -> AnyArray | None:
        """A column without the rows of points that are not finite."""
        if values is None:
            return None
        return values if lost == 0 else values[finite]

    points = np.ascontiguousarray(raw.points[finite] if lost else raw.points, dtype=np.float64)
    report.count("points", len(points))
    t = keep(raw.t_gps_s)
    if t is not None and np.isfinite(t).any():
        report.synchronised, report.time_scale = True, "gps"
        report.t_first_s, report.t_last_s = float(np.nanmin(t)), float(np.nanmax(t))
    if raw.frame is None:
        report.note(NO_CRS)
    return Cloud(
        points=points,
        intensity=keep(raw.intensity),
        rgb=keep(raw.rgb),
        normals=keep(raw.normals),
        t_gps_s=t,
        frame=raw.frame,
        report=report,
        step_m=raw.step_m,
    )
