"""The laser scanners of the digital twin and their faults; each fault has a key that switches it off."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import Finite, NonNegative, Share

Cells = Annotated[int, Field(ge=1, le=16)]
"""Number of sub-rays of a beam."""


class EchoFaults(Section):
    """What any laser scanner makes of the light that comes back."""

    mixed_pixels: bool = Field(
        default=True,
        description="Beams that meet two near surfaces return a range between them; "
        "false: that of the brightest part",
    )
    dark_dropouts: bool = Field(
        default=True,
        description="Echoes that are too weak for their range are lost, those near the limit by chance",
    )
    detection_width: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.2,
        description="Noise of the received signal at the limit of detection, as a share of the limit",
    )
    wet_band_m: NonNegative = Field(
        default=0.1, le=2, description="Ground is wet up to this height above the water, metres"
    )


class TwinLidar(EchoFaults):
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
    sigma_weak_m: NonNegative = Field(
        default=0.03,
        le=1,
        description="Further noise of the weakest echo, a 10 % target at 100 m; goes with range squared over "
        "reflectance times cosine of incidence; metres",
    )
    divergence_mrad: NonNegative = Field(
        default=3.0, le=20, description="Full divergence of the beam, milliradians; 0: no footprint"
    )
    speckle_cells: Cells = Field(
        default=3, description="Parts of the footprint that shine independently of each other (speckle)"
    )
    max_range_m: Annotated[float, Field(gt=0, le=130)] = Field(
        default=100.0, description="Longest range with a return, metres"
    )
    dropouts: Share = Field(
        default=0.005, description="Share of all shots except those on water that are lost by chance"
    )
    water_returns: Share = Field(
        default=0.05, description="Share of shots straight down on water that return; none at grazing angles"
    )
    wet_reflectance: Share = Field(
        default=0.5, description="Reflectance of wet ground relative to dry; 1: no effect"
    )
    mirror_ghosts: bool = Field(
        default=True, description="Water mirrors beams onto the bank, which then appears below the water"
    )
    wave_slope: Annotated[float, Field(ge=0, le=0.3)] = Field(
        default=0.03, description="Rms slope of the waves that mirror the beams; 0: a flat mirror"
    )
    own_hull: bool = Field(
        default=True, description="The boat is in the way of beams and returns some of them"
    )
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
    host_delay_s: NonNegative = Field(
        default=0.0003,
        le=0.1,
        description="Mean delay from a packet's arrival to the recording computer's stamp (exponential), "
        "seconds; 0: none",
    )
    nanoseconds: bool = Field(default=False, description="Capture file with nanosecond stamps")


class TwinTls(EchoFaults):
    """Terrestrial laser scans of the right bank from stations on the left bank: Riegl VZ-400i (P2 5.1)."""

    spacing_m: Annotated[float, Field(ge=0.005, le=1)] = Field(
        default=0.025, description="Point spacing on the right shore across the beam, metres"
    )
    sigma_50m_m: NonNegative = Field(
        default=0.003,
        le=1,
        description="3D error at 50 m distance, metres; the part that grows with distance "
        "and the floor together",
    )
    sigma_floor_m: NonNegative = Field(
        default=0.001,
        le=1,
        description="Part of the 3D error that is the same at each distance, metres; at most sigma_50m_m",
    )
    sigma_station_m: NonNegative = Field(
        default=0.0, le=1, description="Error of each station's position per axis, metres"
    )
    divergence_mrad: NonNegative = Field(
        default=0.3, le=20, description="Full divergence of the beam, milliradians; 0: no footprint"
    )
    speckle_cells: Cells = Field(
        default=2, description="Parts of the footprint that shine independently of each other (speckle)"
    )
    multi_target: bool = Field(
        default=True, description="All echoes of a beam are written; false: the strongest only"
    )
    wavelength_nm: Literal[905, 1550] = Field(
        default=1550, description="Wavelength, nanometres: leaves and wet ground are darker at 1550"
    )
    max_range_m: Annotated[float, Field(gt=0, le=1000)] = Field(
        default=250.0, description="Longest range with a return, metres"
    )
    dropouts: Share = Field(default=0.0, description="Share of all other shots that are lost by chance")
    wet_reflectance: Share = Field(
        default=0.3, description="Reflectance of wet ground relative to dry; 1: no effect"
    )
    coordinates: Literal["map", "local"] = Field(
        default="map", description="Coordinates in the files: grid of campaign.crs, or the local frame"
    )

    @model_validator(mode="after")
    def _check_floor(self) -> Self:
        if self.sigma_floor_m > self.sigma_50m_m:
            raise ValueError(
                f"sigma_floor_m {self.sigma_floor_m} is larger than sigma_50m_m {self.sigma_50m_m}, of which "
                "it is a part: lower it, to 0 for scans without noise"
            )
        return self
