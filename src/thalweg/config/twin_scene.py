"""The world of the digital twin: river reach and boat."""

from typing import Annotated

from pydantic import Field

from thalweg.config.base import Section
from thalweg.config.values import Finite, NonNegative, Positive


class TwinScene(Section):
    """The river reach: flow along +east on average, embankment on the right, meadow on the left."""

    length_m: Annotated[float, Field(ge=20, le=2000)] = Field(
        default=280.0, description="Length of the modelled reach along the flow, metres"
    )
    width_m: Annotated[float, Field(ge=12, le=200)] = Field(
        default=40.0, description="Mean width of the water, metres"
    )
    depth_m: Annotated[float, Field(ge=0.5, le=20)] = Field(
        default=2.2, description="Mean depth of the thalweg below the water level, metres"
    )
    water_level_m: Finite = Field(
        default=0.0, description="Height of the water above the origin of the campaign, metres"
    )
    meander_deg: Annotated[float, Field(ge=0, le=20)] = Field(
        default=6.0, description="Greatest angle between flow and valley (sine-generated curve), degrees"
    )
    meander_length_m: Annotated[float, Field(ge=50, le=5000)] = Field(
        default=240.0, description="Wavelength of the meander along the flow, metres"
    )
    embankment_height_m: Annotated[float, Field(ge=1, le=30)] = Field(
        default=6.0, description="Height of the right bank above the water, metres"
    )
    embankment_slope_deg: Annotated[float, Field(ge=10, le=60)] = Field(
        default=33.0, description="Slope of the right bank, degrees"
    )
    roughness_m: NonNegative = Field(
        default=0.06, le=1, description="Amplitude of the roughness of the banks, metres"
    )
    grid_m: Annotated[float, Field(ge=0.05, le=2)] = Field(
        default=0.2, description="Grid step of the banks, metres; the bed is coarser"
    )
    stones_per_m: NonNegative = Field(
        default=9.0, le=100, description="Boulders on the embankment per metre of reach"
    )
    bushes_per_100m: NonNegative = Field(
        default=45.0, le=1000, description="Bushes on both banks per 100 m of reach"
    )
    posts_per_100m: NonNegative = Field(
        default=12.0, le=1000, description="Posts on both banks per 100 m of reach"
    )
    buildings: Annotated[int, Field(ge=0, le=50)] = Field(
        default=3, description="Buildings behind the left bank"
    )


class TwinBoat(Section):
    """True motion: zigzag between the banks, and the swaying of a small boat."""

    speed_mps: Annotated[float, Field(gt=0, le=10)] = Field(
        default=1.2, description="Speed over ground, m/s (P2: 0.4)"
    )
    turn_rate_degps: Annotated[float, Field(gt=0, le=60)] = Field(
        default=7.0, description="Greatest turn rate, degrees/s (P2: 7)"
    )
    zigzag_deg: Annotated[float, Field(ge=0, le=80)] = Field(
        default=50.0, description="Angle between the legs of the zigzag and the flow, degrees"
    )
    bank_distance_m: Positive = Field(
        default=6.0, le=100, description="Distance from the shores at which the boat turns, metres"
    )
    height_m: Positive = Field(
        default=0.2, le=5, description="Height of the INS above the water at rest, metres"
    )
    roll_deg: NonNegative = Field(default=1.5, le=20, description="Amplitude of roll, degrees")
    pitch_deg: NonNegative = Field(default=0.8, le=20, description="Amplitude of pitch, degrees")
    yaw_deg: NonNegative = Field(
        default=1.0, le=20, description="Amplitude of yawing about the course, degrees"
    )
    heave_m: NonNegative = Field(default=0.02, le=1, description="Amplitude of heave, metres")
