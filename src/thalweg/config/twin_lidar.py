"""The laser scanners of the digital twin and their faults."""

from typing import Annotated, Literal

from pydantic import Field

from thalweg.config.base import Section
from thalweg.config.values import Finite, NonNegative, Share


class TwinLidar(Section):
    """Velodyne VLP-16."""

    returns: Literal["strongest", "last", "dual"] = Field(default="strongest", description="Return mode")
    rotation_hz: Annotated[float, Field(ge=5, le=20)] = Field(
        default=10.0, description="Revolutions per second"
    )
    sigma_range_m: NonNegative = Field(
        default=0.0173, le=1, description="Noise of the range, metres (3 cm / sqrt 3, P2 eq. 7)"
    )
    sigma_lateral_m: NonNegative = Field(
        default=0.0173, le=1, description="Offset of the beam in each of two directions across it, metres"
    )
    divergence_mrad: NonNegative = Field(
        default=3.0, le=20, description="Full divergence of the beam, milliradians"
    )
    max_range_m: Annotated[float, Field(gt=0, le=130)] = Field(
        default=100.0, description="Longest range with a return, metres"
    )
    water_returns: Share = Field(
        default=0.05, description="Share of shots straight down on water that return; none at grazing angles"
    )
    dropouts: Share = Field(default=0.005, description="Share of all other shots that are lost by chance")
    vertical_offsets: bool = Field(
        default=True,
        description="Lasers leave at the heights of the manual's table; false: all at the centre",
    )
    position_rate_hz: Annotated[float, Field(gt=0, le=1000)] = Field(
        default=50.0, description="Rate of the position packets, Hz"
    )
    host_clock_offset_s: Finite = Field(
        default=0.4, description="Recording computer's clock minus UTC, seconds"
    )
    nanoseconds: bool = Field(default=False, description="Capture file with nanosecond stamps")


class TwinTls(Section):
    """Terrestrial laser scans of the right bank from stations on the left bank."""

    spacing_m: Annotated[float, Field(ge=0.005, le=1)] = Field(
        default=0.025, description="Point spacing on the right shore across the beam, metres"
    )
    sigma_50m_m: NonNegative = Field(
        default=0.003, le=1, description="3D error at 50 m distance, metres; proportional to distance"
    )
    sigma_station_m: NonNegative = Field(
        default=0.0, le=1, description="Error of each station's position per axis, metres"
    )
    coordinates: Literal["map", "local"] = Field(
        default="map", description="Coordinates in the files: grid of campaign.crs, or the local frame"
    )
