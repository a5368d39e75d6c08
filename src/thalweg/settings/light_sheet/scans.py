"""Section ``logs.light_sheet.scans``: recordings of one scanned object each."""

from typing import Annotated, Final

from pydantic import Field

from thalweg.settings.base.base import Section

Files = tuple[Annotated[str, Field(min_length=1)], ...]

ScanName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,39}$")]
"""Name of a scan; it becomes the name of a folder below ``results/<campaign>/triangulation``."""


class SheetScan(Section):
    """One scan of an object: images of the sensor, and a panel on it that a standing camera sees (P4 7.3)."""

    images: Files = Field(default=(), description="Images of the sensor: a folder, or files in their order")
    pulses: Files = Field(
        default=(), description="GPS times of the pulses that triggered them (CSV: t_gps_s); empty: no times"
    )
    panel: Files = Field(
        default=(), description="Marks of the panel in the sensor's frame (CSV: marker, x_mm ... sigma_mm)"
    )
    marks: Files = Field(
        default=(),
        description="Marks in the pictures of the standing camera (CSV: file of the sensor's image, marker, "
        "x_px, y_px, sigma_px)",
    )
    camera: Files = Field(
        default=(),
        description="Interior orientation of the standing camera (JSON: model, size_px, parameters)",
    )
    reference: Files = Field(
        default=(), description="Mesh of the object by a better method, in metres (PLY); empty: no comparison"
    )
    pairs: Files = Field(
        default=(),
        description="Three and more places picked in scan and mesh, metres (CSV: scan_x_m ... mesh_z_m)",
    )


SERIES: Final = frozenset({"calibration", "panels", "strip"})
"""Names that other series of images have."""

SCAN_PARTS: Final = tuple(SheetScan.model_fields)
SHARED_PARTS: Final = frozenset({"panel", "camera", "reference"})
"""Files that several scans may have in common."""


def scan_stream(scan: str, part: str) -> str:
    """Name of the stream of a part; images go by the name of the scan alone.

    Examples
    --------
    >>> scan_stream("wreck", "images"), scan_stream("wreck", "pairs")
    ('wreck', 'wreck.pairs')
    """
    return scan if part == "images" else f"{scan}.{part}"
