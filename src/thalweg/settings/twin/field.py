"""Section ``twin.field``: a calibration field on land instead of a river (P1 2.3, P2 3.1 and 5.2, T 3.1.1).

A yard with eight cones, six of them lying on both sides of the boat, printed markers, scale bars and RTK
targets. The boat stands in it three times, mostly turned, and is then moved around in it.
"""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import Angle, NonNegative, Positive, Sigma3

Tilt = Annotated[float, Field(ge=-30, le=30, allow_inf_nan=False)]
"""A small angle in degrees."""

Marker = Annotated[int, Field(ge=0, le=249)]
"""Id of a printed marker."""

CONES = ("C1", "C2", "C3", "C4", "C5", "C6", "C7", "C8")
"""Names of the cones: three to the west, three to the east, and two upright ones north and south."""


class StaticPosition(Section):
    """Where the boat stands while image and lidar are recorded."""

    east_m: Annotated[float, Field(ge=-2, le=2)] = Field(
        default=0.0, description="East of the middle, metres"
    )
    north_m: Annotated[float, Field(ge=-2, le=2)] = Field(default=0.0, description="North of it, metres")
    heading_deg: Angle = Field(default=0.0, description="Heading, clockwise from north, degrees")
    roll_deg: Tilt = Field(default=0.0, description="Roll, right side down, degrees")
    pitch_deg: Tilt = Field(default=0.0, description="Pitch, nose up, degrees")


class TwinFieldRun(Section):
    """The dynamic run: figures of eight in the middle of the yard that turn slowly about it."""

    speed_mps: Annotated[float, Field(ge=0.2, le=3)] = Field(
        default=0.65,
        description="Mean speed, m/s; it swings between 0.65 and 1.35 of that, and a little more",
    )
    reach_m: Annotated[float, Field(ge=0.5, le=10)] = Field(
        default=2.9, description="Greatest distance of the boat from the middle of the yard, metres"
    )
    turn_of_eight_degpmin: Annotated[float, Field(ge=-360, le=360)] = Field(
        default=80.0, description="Rate at which the figure of eight turns about its middle, degrees/min"
    )


class TwinFieldEffects(Section):
    """Faults of a calibration; all off unless switched on."""

    passers_by: Annotated[int, Field(ge=0, le=20)] = Field(
        default=0, description="People who stand near the cones in lidar recordings, other places each time"
    )
    toppled_cone: str | None = Field(
        default=None, description="Cone that was knocked over after the reference images, C1 to C8"
    )
    toppled_by_deg: Tilt = Field(default=8.0, description="Angle by which it leans then, degrees")
    moved_marker: Marker | None = Field(
        default=None,
        description="Marker that was moved after the reference images; one that the boat can see",
    )
    moved_by_m: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.02, description="Distance by which it was moved along its board or cone, metres"
    )
    swapped_ids: tuple[tuple[Marker, Marker], ...] = Field(
        default=(), description="Pairs of markers glued in each other's place against the description"
    )
    mirrored_ids: tuple[Marker, ...] = Field(default=(), description="Markers printed in a mirror")
    outside_view: str | None = Field(
        default=None, description="Lying cone that stands outside the lidar's view in the static positions"
    )
    wrong_bar: str | None = Field(default=None, description="Scale bar whose certificate is wrong, S1 to S3")
    wrong_bar_by_m: Annotated[float, Field(ge=-0.1, le=0.1)] = Field(
        default=0.003, description="Error of that certificate, metres"
    )

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        for key, known in (
            ("toppled_cone", CONES),
            ("outside_view", CONES[:6]),
            ("wrong_bar", ("S1", "S2", "S3")),
        ):
            name = getattr(self, key)
            if name is not None and name not in known:
                raise ValueError(f"{key} is '{name}', but must be one of {', '.join(known)}")
        return self


class TwinField(Section):
    """The calibration field, its targets, and the boat's places in it."""

    half_angle_deg: Annotated[float, Field(ge=10, le=45)] = Field(
        default=25.0, description="Nominal angle between axis and surface of the cones, degrees"
    )
    sigma_half_angle_deg: Annotated[float, Field(ge=0, le=2)] = Field(
        default=0.1, description="Scatter of the built half angles, degrees"
    )
    cone_length_m: Annotated[float, Field(ge=0.3, le=2)] = Field(
        default=0.70, description="From the apex to the base along the axis, metres"
    )
    cone_tip_m: Annotated[float, Field(ge=0.005, le=0.25)] = Field(
        default=0.05,
        description="Where the blunt tip of the cones lies, from the apex along the axis, metres",
    )
    module_m: Annotated[float, Field(ge=0.002, le=0.02)] = Field(
        default=0.012, description="Side of a module of the markers on cones, metres"
    )
    flat_module_m: Annotated[float, Field(ge=0.002, le=0.05)] = Field(
        default=0.016, description="Side of a module of the other markers, metres"
    )
    n_boards: Annotated[int, Field(ge=0, le=40)] = Field(
        default=36, description="Markers on boards on posts around the yard; targets and bars come on top"
    )
    n_ground: Annotated[int, Field(ge=0, le=12)] = Field(default=8, description="Markers on the ground")
    fence_m: Annotated[float, Field(ge=9, le=40)] = Field(
        default=12.0, description="Distance of the fence from the middle, metres"
    )
    bar_length_m: Annotated[float, Field(ge=0.5, le=3)] = Field(
        default=1.5, description="Nominal length of the three scale bars, metres"
    )
    sigma_bar_m: NonNegative = Field(
        default=0.00003, le=0.01, description="Error of the certificates of the scale bars, metres"
    )
    tour: Literal["in turn", "planned"] = Field(
        default="in turn",
        description="Reference images: `in turn` near a cone and across the yard, at two heights; `planned` "
        "35 views chosen so that nearly every marker stands in three images",
    )
    n_targets: Annotated[int, Field(ge=0, le=6)] = Field(
        default=6, description="Markers that were measured with RTK"
    )
    sigma_target_m: Sigma3 = Field(
        default=(0.008, 0.008, 0.012), description="Error east, north, up of these measurements, metres"
    )
    antenna_offset_m: Annotated[float, Field(ge=-0.5, le=0.5)] = Field(
        default=-0.030,
        description="Phase centre above the antenna's marker along the normal of the print, metres; "
        "negative: the marker lies on top of the antenna",
    )
    sigma_antenna_offset_m: Annotated[float, Field(ge=0, le=0.05)] = Field(
        default=0.001, description="Error of the stated offset, metres"
    )
    ics_height_m: Annotated[float, Field(ge=0.2, le=2)] = Field(
        default=0.6, description="Height of the ics origin above the ground on the trolley, metres"
    )
    positions: tuple[StaticPosition, ...] = Field(
        default=(
            StaticPosition(east_m=0.05, north_m=0.30, heading_deg=4.0, roll_deg=2.0, pitch_deg=-1.5),
            StaticPosition(east_m=-0.12, north_m=-0.25, heading_deg=177.0, roll_deg=-3.0, pitch_deg=2.5),
            StaticPosition(east_m=0.15, north_m=0.40, heading_deg=-7.0, roll_deg=4.0, pitch_deg=1.0),
        ),
        min_length=1,
        max_length=20,
        description="Where the boat stands; the positions differ mostly in orientation",
    )
    position_s: Positive = Field(
        default=5.0, le=60, description="Length of the lidar recording of each position, seconds"
    )
    run: TwinFieldRun = Field(default=TwinFieldRun(), description="Dynamic run")
    effects: TwinFieldEffects = Field(default=TwinFieldEffects(), description="Faults of the calibration")
