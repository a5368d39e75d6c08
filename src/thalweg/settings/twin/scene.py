"""The world of the digital twin: river reach and boat."""

from typing import Annotated, Literal

from pydantic import Field

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import Angle, Finite, NonNegative, Positive

Change = Literal["undercut_bank", "moved_boulders", "gravel_bar", "scour", "fallen_tree", "grown_vegetation"]
"""What a second epoch may differ by."""


class TwinScene(Section):
    """The river reach: railway embankment on the right, meadow on the left (P2: Freiberger Mulde)."""

    length_m: Annotated[float, Field(ge=20, le=2000)] = Field(
        default=250.0, description="Length of the modelled reach along the flow, metres"
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
    flow_deg: Angle = Field(
        default=0.0, description="Mean direction of the flow, degrees from east, counter-clockwise"
    )
    meander_deg: Annotated[float, Field(ge=0, le=20)] = Field(
        default=6.0, description="Greatest angle between flow and valley (sine-generated curve), degrees"
    )
    meander_length_m: Annotated[float, Field(ge=50, le=5000)] = Field(
        default=240.0, description="Wavelength of the meander along the flow, metres"
    )
    shelf_width_m: Annotated[float, Field(ge=0, le=20)] = Field(
        default=2.5,
        description="Mean width of the shallow shelf along both shores, metres; wider on inner bends",
    )
    shelf_depth_m: Annotated[float, Field(ge=0.02, le=2)] = Field(
        default=0.3, description="Depth at the outer edge of the shelf, metres"
    )
    embankment_height_m: Annotated[float, Field(ge=1, le=30)] = Field(
        default=6.0, description="Height of the right bank above the water, metres"
    )
    embankment_slope_deg: Annotated[float, Field(ge=10, le=60)] = Field(
        default=33.0, description="Slope of the right bank, degrees"
    )
    roughness_m: NonNegative = Field(
        default=0.06,
        le=1,
        description="Amplitude of the roughness of the banks, metres; half of it on the bed",
    )
    grid_m: Annotated[float, Field(ge=0.02, le=2)] = Field(
        default=0.05,
        description="Grid step of the terrain within a metre of the shores, metres; coarser further away",
    )
    weir: bool = Field(default=False, description="Whether a weir closes the reach")
    weir_place: Annotated[float, Field(ge=-1, le=1)] = Field(
        default=0.92, description="Where the weir stands, as a share of the half length; 1: lower end"
    )
    weir_pool_m: NonNegative = Field(
        default=1.8, le=20, description="How much deeper the bed is before the weir, metres"
    )
    bridge: bool = Field(default=False, description="Whether a bridge crosses the river")
    bridge_place: Annotated[float, Field(ge=-1, le=1)] = Field(
        default=-0.35, description="Where the bridge stands, as a share of the half length"
    )
    railway: bool = Field(default=True, description="Whether a track lies on the embankment")
    stones_per_m: NonNegative = Field(
        default=20.0, le=100, description="Boulders of 0.2 to 0.8 m per metre of reach, most on the right toe"
    )
    cobbles_per_m: NonNegative = Field(
        default=100.0, le=2000, description="Stones of 3 to 10 cm along the water lines per metre of reach"
    )
    bushes_per_100m: NonNegative = Field(
        default=100.0, le=1000, description="Bushes on both banks per 100 m of reach"
    )
    trees_per_100m: NonNegative = Field(
        default=14.0,
        le=500,
        description="Trees on both banks per 100 m of reach; five times as many plain ones stand behind",
    )
    grass_per_m: NonNegative = Field(
        default=40.0, le=500, description="Tufts of grass on both banks per metre of reach"
    )
    reeds_per_m: NonNegative = Field(
        default=6.0, le=200, description="Stalks of reed in the margins per metre of reach"
    )
    leaves_per_bush: Annotated[int, Field(ge=10, le=20000)] = Field(
        default=600, description="Leaves of a bush of mean size; fewer leaves are larger ones"
    )
    leaves_per_tree: Annotated[int, Field(ge=10, le=100000)] = Field(
        default=5000, description="Leaves of a tree of mean size; fewer leaves are larger ones"
    )
    posts_per_100m: NonNegative = Field(
        default=12.0, le=1000, description="Posts on both banks per 100 m of reach"
    )
    buildings: Annotated[int, Field(ge=0, le=50)] = Field(
        default=3, description="Buildings behind the left bank"
    )
    seed: Annotated[int, Field(ge=0, lt=2**31)] | None = Field(
        default=None,
        description="Seed of the river, for a second epoch with errors of its own; without it the campaign's",
    )
    changes: tuple[Change, ...] = Field(
        default=(), description="What differs from the first epoch; all the rest is the same to the last bit"
    )
    retreat_m: Annotated[float, Field(ge=0, le=15)] = Field(
        default=7.0, description="Greatest retreat of the left bank by `undercut_bank`, metres (T 4.1: 7)"
    )


class TwinBoat(Section):
    """True motion: zigzag between the banks, and the swaying of a small boat."""

    speed_mps: Annotated[float, Field(gt=0, le=10)] = Field(
        default=0.4, description="Speed over ground, m/s (P2: 0.4)"
    )
    turn_rate_degps: Annotated[float, Field(gt=0, le=60)] = Field(
        default=7.0, description="Greatest turn rate of the course, degrees/s (P2: 7); yawing comes on top"
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
    heel_share: NonNegative = Field(
        default=0.5,
        le=5,
        description="Heel in turns, outwards, as a share of speed times turn rate over gravity; 0: none",
    )
