"""Sections ``echo_sounder`` and ``bathymetry``: from depths to the riverbed."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from thalweg.settings.sections.accuracy import Corner
from thalweg.settings.sections.base import Finite, NonNegative, Positive, Section, or_file


class EchoSounder(Section):
    """The echo sounder and the water that its sound went through."""

    beam_deg: float = Field(
        default=5.0,
        ge=0,
        le=60,
        allow_inf_nan=False,
        description="Full opening angle of the beam (-3 dB), degrees; 0: a ray",
    )
    tilt_deg: tuple[Finite, Finite] = Field(
        default=(0.0, 0.0),
        description="Direction of the beam against the body frame's down axis, forward and right, degrees",
    )
    sigma_tilt_deg: NonNegative = Field(default=1.0, le=20, description="Standard deviation of both, degrees")
    latency_s: Finite = Field(
        default=0.0,
        ge=-2,
        le=10,
        description="How much later than its ping a depth is stamped, own filters of the instrument "
        "included, seconds",
    )
    sigma_latency_s: NonNegative = Field(default=0.05, le=10, description="Standard deviation of it, seconds")
    set_sound_speed_mps: Annotated[float, Field(ge=1300, le=1700)] | None = Field(
        default=None,
        description="Speed of sound that the instrument computes with, metres a second; null: that of the "
        "water, its depths are right",
    )
    water_temperature_c: Annotated[float, Field(ge=-2, le=40)] | None = Field(
        default=None, description="Temperature of the water, degrees Celsius; null: that of the log (MTW)"
    )
    sigma_temperature_c: NonNegative = Field(
        default=1.0, le=20, description="Standard deviation of the temperature, degrees"
    )
    salinity_g_kg: float = Field(
        default=0.0, ge=0, le=42, description="Salinity of the water, grams a kilogram; 0: fresh water"
    )
    sigma_sound_speed: NonNegative = Field(
        default=0.002, le=0.1, description="Error of the speed of sound that is left, relative"
    )
    sigma_depth_m: Positive = Field(default=0.02, le=1, description="Noise of a single depth, metres")
    dead_zone_m: NonNegative = Field(
        default=0.2, le=5, description="The instrument measures no smaller depth, metres"
    )
    max_depth_m: Positive = Field(default=100.0, le=12_000, description="Nor a larger one, metres")


class SoundingTable(Section):
    """Tables of soundings and of points of a reference bed (`logs.soundings`, `logs.reference_bed`)."""

    column: str = Field(default="z", min_length=1, description="Column of the values")
    depth: bool = Field(
        default=False,
        description="The values are depths below the water level of the survey; else ellipsoidal heights",
    )
    line_column: str | None = Field(
        default=None, description="Column with numbers or names of lines; null: from the course"
    )
    sigma_m: Positive = Field(
        default=0.05, le=5, description="Noise of a value where there is no column sigma, metres"
    )
    sigma_common_m: NonNegative = Field(
        default=0.02, le=5, description="Error that all values of a file share, its datum's, metres"
    )


class Bathymetry(Section):
    """The riverbed from soundings, banks and points of the light sheet."""

    spike_m: Positive = Field(
        default=0.15,
        le=10,
        description="Farther from the median of its neighbours along the track than this and than four times "
        "their scatter: a spike, metres",
    )
    weeds_m: NonNegative = Field(
        default=6.0,
        le=100,
        description="Scattered echoes above the bed in a patch narrower than this along the track, with "
        "eleven pings or more, are weeds or stones and left out, metres; 0: all are the bed",
    )
    max_turn_deg_per_s: Positive = Field(
        default=40.0, le=360, description="Faster turns cast the beam aside: left out, degrees a second"
    )
    line_turn_deg: float = Field(
        default=45.0, gt=0, lt=180, description="A change of course that ends a line of soundings, degrees"
    )
    sigma_datum_m: NonNegative = Field(
        default=0.0, le=5, description="Common error of all heights that nothing else holds, metres"
    )
    position_time_s: Positive | None = Field(
        default=None,
        description="Correlation time of errors of the boat's height, seconds; null: as estimated from the "
        "survey",
    )
    bank_station_m: float = Field(
        default=2.0,
        ge=0.2,
        le=100,
        description="Distance of the places along the river at which banks are sought, metres",
    )
    bank_gap_m: NonNegative = Field(
        default=20.0, description="Banks that were not seen are bridged up to this length, metres"
    )
    bank_as_data: bool = Field(
        default=True, description="Bank lines are data of the bed: the water level, with their sigma"
    )
    islands: list[Annotated[list[Corner], Field(min_length=3)]] = Field(
        default=[],
        description="Polygons east, north that are no bed, local frame, metres, or a file of a GIS",
        json_schema_extra=or_file,
    )
    cell_m: float = Field(default=0.5, ge=0.05, le=100, description="Cell of the bed, metres")
    model: Literal["auto", "exponential", "matern32", "spherical"] = Field(
        default="auto", description="Covariance of the bed; auto: the one that predicts left-out lines best"
    )
    drift: Literal["auto", "none", "section", "section_width", "fall"] = Field(
        default="auto",
        description="What is removed before: nothing, the mean cross-section over the width, that and a "
        "depth that grows where the river is narrower, the fall along the river",
    )
    margin_roughness: Annotated[float, Field(ge=1, le=4)] | None = Field(
        default=None,
        description="Standard deviation of the relief in the outer 0.3 of the half width against the "
        "channel; null: as left-out lines tell",
    )
    table: SoundingTable = Field(default=SoundingTable(), description="Soundings of others as tables")
    neighbours: int = Field(
        default=48,
        ge=4,
        le=512,
        description="Soundings that make the height of a cell; up to 512 data make each cell all together",
    )
    reach: Positive = Field(
        default=2.0, le=50, description="Cells farther from data than this many ranges have no height"
    )
    engine: Literal["own", "pykrige"] = Field(
        default="own", description="What solves; `pykrige`: at most 2,000 soundings, errors independent"
    )

    @model_validator(mode="after")
    def _check_engine(self) -> Self:
        if self.engine == "pykrige" and self.model == "auto":
            raise ValueError("engine pykrige wants a stated model; choose exponential, matern32 or spherical")
        return self
