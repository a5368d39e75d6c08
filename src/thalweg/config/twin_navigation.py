"""INS, GNSS receiver and echo sounder of the digital twin and their faults."""

from typing import Annotated

from pydantic import Field

from thalweg.config.base import Section
from thalweg.config.values import Finite, NonNegative, Positive, Share, Sigma3


class TwinIns(Section):
    """Advanced Navigation Spatial."""

    rate_hz: Annotated[float, Field(ge=1, le=1000)] = Field(
        default=50.0, description="Rate of the state packets, Hz"
    )
    sigma_roll_deg: NonNegative = Field(default=0.1, le=10, description="Error of roll, degrees")
    sigma_pitch_deg: NonNegative = Field(default=0.1, le=10, description="Error of pitch, degrees")
    sigma_heading_deg: NonNegative = Field(default=0.2, le=45, description="Error of heading, degrees")
    attitude_time_s: Positive = Field(
        default=20.0, description="Correlation time of the attitude errors (Gauss-Markov), seconds"
    )
    sigma_position_m: Sigma3 = Field(
        default=(0.6, 0.6, 1.0), description="Error east, north, up of the INS's own position, metres (P1)"
    )
    position_time_s: Positive = Field(
        default=60.0, description="Correlation time of the position errors, seconds"
    )
    heading_drift_degpmin: Finite = Field(
        default=0.0, description="Drift of the heading on top of its error, degrees/min"
    )
    depth_rate_hz: NonNegative = Field(
        default=0.0, le=50, description="Rate of external depth packets (ANPP 53), Hz; 0: none"
    )


class TwinGnss(Section):
    """Multiband receiver: its own RTK solution (SBP) and a post-processed track (.pos)."""

    rate_hz: Annotated[float, Field(ge=0.1, le=50)] = Field(default=10.0, description="Rate of positions, Hz")
    sigma_m: Sigma3 = Field(
        default=(0.020, 0.020, 0.030), description="Total error east, north, up, metres (P2, T Table 3.1)"
    )
    white_share: Share = Field(
        default=0.25, description="Share of the error's variance that is new in each epoch"
    )
    correlation_time_s: Positive = Field(
        default=10.0, description="Correlation time of the rest (Gauss-Markov), seconds"
    )
    sigma_float_m: Positive = Field(
        default=0.3, description="Error east and north of float solutions, metres; up is 1.5 times that"
    )


class TwinEcho(Section):
    """Single-beam echo sounder."""

    rate_hz: Annotated[float, Field(gt=0, le=50)] = Field(default=10.0, description="Soundings per second")
    sigma_m: NonNegative = Field(default=0.02, le=1, description="Noise of the depth, metres")
    offset_m: Finite = Field(default=0.1, description="Offset in DPT: transducer to water line, metres")
    max_depth_m: Positive = Field(default=100.0, description="Range scale, metres")
