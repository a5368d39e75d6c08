"""Sections ``epochs`` and ``deformation``: surveys of one bank at different times, and what changed."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from thalweg.settings.sections.accuracy import Area, Corner
from thalweg.settings.sections.base import NonNegative, Positive, Section


class Epoch(Section):
    """One survey of the series."""

    campaign: str = Field(description="Id of the campaign whose cloud is compared", examples=["mulde"])
    chain: Literal["ins", "camera", "fused"] = Field(
        default="ins", description="Trajectory that georeferenced its cloud: of the INS, the camera, or all"
    )


class EpochErrors(Section):
    """Errors that the points of an epoch share."""

    moment_s: Annotated[float, Field(ge=0.02, le=2, allow_inf_nan=False)] = Field(
        default=0.1, description="Points within this time share the error of one pose, seconds"
    )
    position_time_s: Positive | None = Field(
        default=None,
        description="Correlation time of positions by INS and GNSS, seconds; null: as estimated from the "
        "survey. Camera and fused trajectory tell how their errors last",
    )
    attitude_time_s: Positive | None = Field(
        default=None,
        description="Correlation time of attitudes by INS and GNSS, seconds; null: as estimated from the "
        "survey",
    )
    common_mounts: bool = Field(
        default=False,
        description="All epochs carry the sensors in the same places: errors of the mounts are the same",
    )


class Visibility(Section):
    """Whether an epoch could have seen a place."""

    max_range_m: Positive = Field(default=60.0, le=300, description="Farther places are not seen, metres")
    max_incidence_deg: Annotated[float, Field(gt=0, le=90, allow_inf_nan=False)] = Field(
        default=82.0, description="Beams that graze the surface more than this give no echo, degrees"
    )
    water_margin_m: NonNegative = Field(
        default=0.1, le=5, description="Places lower than this above the water of the epoch are water, metres"
    )
    voxel_m: Annotated[float, Field(ge=0.05, le=5, allow_inf_nan=False)] = Field(
        default=0.25, description="Cells in which beams look for what is in their way, metres"
    )


class Classes(Section):
    """What a change is called."""

    vegetation_roughness_m: Positive = Field(
        default=0.15,
        le=5,
        description="Points scatter more than this along the normal, in one epoch: vegetation, metres",
    )
    object_m: NonNegative = Field(
        default=2.5,
        le=50,
        description="A change no longer than this with sharp edges is an object (boulder, trunk), metres; "
        "0: none",
    )
    least_patch_m2: NonNegative = Field(
        default=1.0, description="Smaller connected changes are no patch of their own, square metres"
    )


class Deformation(Section):
    """What changed between epochs (T 4.1)."""

    area: Area = Field(default=Area(), description="Part of the bank that is compared")
    core_spacing_m: Annotated[float, Field(ge=0.05, le=20, allow_inf_nan=False)] = Field(
        default=0.5, description="Core points: one a cell of this width on the surfaces, metres"
    )
    scales_m: Annotated[list[Positive], Field(min_length=1, max_length=8)] = Field(
        default=[0.5, 1.0, 2.0],
        description="Radii at which normals are fitted, metres; the most planar counts",
    )
    cylinder_radius_m: Positive = Field(default=0.5, le=20, description="Radius of the cylinders, metres")
    reach_m: Positive = Field(
        default=3.0, le=50, description="Reach of the cylinders along the normal, to both sides, metres"
    )
    least_in_cylinder: int = Field(
        default=5, ge=2, le=10_000, description="Points that a mean needs in each epoch"
    )
    stable: list[Annotated[list[Corner], Field(min_length=3)]] | None = Field(
        default=None,
        description="Polygons east, north of ground that did not move, local frame, metres; null: what most "
        "of the bank agrees on",
    )
    registration: Literal["none", "shift", "shift+heading", "rigid"] = Field(
        default="shift+heading", description="Motion between the epochs that stable ground shows"
    )
    largest_shift_m: Positive = Field(
        default=0.5,
        le=10,
        description="A larger motion between epochs is a mistake, not a registration, metres",
    )
    level: Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)] = Field(
        default=0.05, description="Level of significance"
    )
    control: Literal["fdr", "family", "none"] = Field(
        default="fdr",
        description="What the level holds for: `fdr` the share of false ones among all changes, `family` the "
        "chance of a single false one anywhere, `none` each core point by itself",
    )
    station_m: Positive = Field(
        default=5.0, description="Length of a stretch of bank for volumes and retreat, metres"
    )
    line_height_m: Annotated[float, Field(allow_inf_nan=False)] | None = Field(
        default=None,
        description="Height of the bank line, local frame, metres; null: half a metre above the highest "
        "water of the epochs",
    )
    draws: int = Field(default=200, ge=20, le=10_000, description="Draws of the errors of all poses")
    errors: EpochErrors = Field(default=EpochErrors(), description="Errors that points of an epoch share")
    visibility: Visibility = Field(default=Visibility(), description="What an epoch could see")
    classes: Classes = Field(default=Classes(), description="What a change is called")

    @model_validator(mode="after")
    def _check_reach(self) -> Self:
        if self.reach_m < self.cylinder_radius_m:
            raise ValueError(
                f"reach_m {self.reach_m:g} is below cylinder_radius_m {self.cylinder_radius_m:g}: the "
                "cylinders would be discs"
            )
        return self
