"""Sections ``lidar`` and ``lidar_accuracy``: how scanner packets become points, and what those are worth."""

from typing import Annotated, Literal

from pydantic import Field

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import NonNegative, Positive

Port = Annotated[int, Field(ge=1, le=65535)]


class Lidar(Section):
    """Decoding of the lidar."""

    model: Literal["auto", "VLP-16"] = Field(
        default="auto", description="Scanner; `auto` trusts the product byte of the packets"
    )
    vertical_corrections: bool = Field(
        default=True, description="Apply the vertical offsets of the lasers from the VLP-16 manual"
    )
    returns: Literal["all", "strongest", "last"] = Field(
        default="all", description="Which returns of a dual-return log are kept"
    )
    data_port: Port = Field(default=2368, description="UDP port of the data packets")
    position_port: Port = Field(default=8308, description="UDP port of the position packets")


class LidarAccuracy(Section):
    """What a single measurement of the scanner is worth; makes the covariance of each point."""

    sigma_component_m: Positive = Field(
        default=0.0173,
        le=1,
        description="Standard deviation along the beam and in both directions across it, metres "
        "(3 cm / sqrt 3, P2 eq. 7)",
    )
    divergence_mrad: NonNegative = Field(
        default=3.0, le=50, description="Full divergence of the beam, milliradians (P2 section 7)"
    )
    footprint_share: NonNegative = Field(
        default=0.177,
        le=0.5,
        description="Standard deviation of the echo's place in its footprint, in each direction, as a share "
        "of the diameter: 0.25 if it may be anywhere (Lichti and Gordon 2004), 0.177 if three speckle cells "
        "share the energy",
    )
    sigma_weak_m: NonNegative = Field(
        default=0.03,
        le=10,
        description="Further range noise of the echo of a 10 % target at 100 m, metres; goes with the square "
        "of the range over the reflectivity",
    )
    sigma_time_s: NonNegative = Field(
        default=1e-6, le=1, description="Standard deviation of the scanner's stamps, seconds (PPS, T 3.1.2)"
    )
