"""Section ``lidar``: how scanner packets become points."""

from typing import Annotated, Literal

from pydantic import Field

from thalweg.config.base import Section
from thalweg.config.values import NonNegative, Positive

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
    min_range_m: NonNegative = Field(
        default=0.5, le=250, description="Shorter measured ranges are dropped at decoding, metres"
    )
    max_range_m: Positive = Field(
        default=130.0, le=250, description="Longer measured ranges are dropped at decoding, metres"
    )
    sigma_component_m: Positive = Field(
        default=0.0173,
        le=1,
        description="Standard deviation of each coordinate of a point, metres (3 cm / sqrt 3, P2 eq. 7)",
    )
    data_port: Port = Field(default=2368, description="UDP port of the data packets")
    position_port: Port = Field(default=8308, description="UDP port of the position packets")
