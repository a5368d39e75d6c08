"""Section ``twin.light_sheet_strip``: a strip of the bed under the boat, seen by the light-sheet sensor."""

from typing import Annotated

from pydantic import Field

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import NonNegative, Positive


class TwinSheetStrip(Section):
    """Images of the sensor on the boat over a shallow piece of bed; the sensor is that of its calibration."""

    lines: Annotated[int, Field(ge=3, le=400)] = Field(default=24, description="Images of the strip")
    rate_hz: Annotated[float, Field(ge=1, le=100)] = Field(
        default=50.0, description="Images a second; at 1.2 m/s, 50 of them are 24 mm apart"
    )
    begin_s: NonNegative | None = Field(
        default=None,
        description="First image after the start of the lidar log, seconds; null: where the boat is slow and "
        "goes straight",
    )
    depth_m: Annotated[float, Field(ge=0.05, le=0.25)] = Field(
        default=0.13, description="Mean depth of the bed below the window, metres"
    )
    step_mm: Positive = Field(default=1.0, description="Width of the mesh of the true bed, mm")
