"""What the cloud readers hand over, and colours to 8 bit."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from thalweg.core.types import AnyArray, ArrayF, ArrayU8
from thalweg.ingest.integrity import IntegrityReport


@dataclass(slots=True, kw_only=True)
class RawCloud:
    """Columns of a cloud before points that are not finite are dropped.

    ``step_m`` is the coarsest step of the coordinates that the number format can tell.
    """

    points: ArrayF
    intensity: AnyArray | None = None
    rgb: AnyArray | None = None
    normals: AnyArray | None = None
    t_gps_s: AnyArray | None = None
    frame: Any = None
    step_m: float = 0.0


def single_step_m(values: AnyArray) -> float:
    """Step of single precision at the largest finite one of some values."""
    reach = np.max(np.abs(values), where=np.isfinite(values), initial=0.0)
    return float(np.spacing(np.float32(min(float(reach), float(np.finfo(np.float32).max) / 2))))


def eight_bit(rgb: AnyArray, report: IntegrityReport) -> ArrayU8:
    """Colours to 8 bit: uint8 as they are, floats from 0..1, wider integers by their high byte.

    Integers of 16 bit that never exceed 255 are taken as 8-bit values; floats above 1 as 0..255.
    """
    if rgb.dtype == np.uint8:
        return rgb
    if rgb.dtype.kind == "f":
        clean = np.nan_to_num(rgb, nan=0.0, posinf=0.0, neginf=0.0)
        factor = 255.0 if not clean.size or clean.max() <= 1.0 else 1.0
        return np.clip(np.rint(clean * factor), 0, 255).astype(np.uint8)
    if not rgb.size or rgb.max() <= 255:
        return np.clip(rgb, 0, 255).astype(np.uint8)
    report.note("Colours of 16 bit are brought to 8 bit.")
    return np.clip(rgb // 256, 0, 255).astype(np.uint8)
