"""Section ``fusion``: one terrain model of bed, banks and surroundings, and what is made from it."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from thalweg.settings.sections.accuracy import Corner
from thalweg.settings.sections.base import Finite, NonNegative, Positive, Section, or_file


class GroundFilter(Section):
    """Which points of a cloud of the banks are ground."""

    clearance_m: Positive = Field(
        default=0.15,
        le=5,
        description="Points up to this above the lower envelope of the cloud are ground, metres",
    )
    last_returns: bool = Field(
        default=True, description="Of beams with several echoes only the last one may be ground"
    )


class CloudFit(Section):
    """How the cloud of the surroundings is laid on the ground that the boat has measured."""

    motion: Literal["none", "shift", "rigid"] = Field(
        default="rigid", description="Motion that stable ground may show"
    )
    stable: list[Annotated[list[Corner], Field(min_length=3)]] | None = Field(
        default=None,
        description="Polygons east, north of bare, stable ground, local frame, metres, or a file of a GIS; "
        "null: all ground that both clouds have",
        json_schema_extra=or_file,
    )
    cell_m: float = Field(
        default=0.5, ge=0.1, le=20, description="Both clouds are compared in cells of this width, metres"
    )
    sigma_m: Positive = Field(
        default=0.05, le=5, description="Standard deviation of a point where its file states none, metres"
    )
    sigma_datum_m: NonNegative = Field(
        default=0.1,
        le=50,
        description="How far the cloud may lie off in a motion that stable ground does not show, standard "
        "deviation of its points, metres",
    )
    largest_shift_m: Positive = Field(
        default=1.0, le=50, description="A larger motion is a mistake of the datum, not a fit, metres"
    )
    largest_spread_m: Positive = Field(
        default=0.15,
        le=5,
        description="Robust standard deviation of the distances after the fit above which the clouds do not "
        "show the same ground, metres",
    )
    block_m: Positive = Field(
        default=10.0,
        le=1000,
        description="Width of the blocks of ground that err together, for the motion's covariance, metres",
    )


class Vertical(Section):
    """Heights above a level surface instead of the ellipsoid."""

    name: str | None = Field(
        default=None,
        min_length=1,
        description="Name of the height system, such as DHHN2016; null: heights above the ellipsoid",
    )
    separation_m: Finite = Field(
        default=0.0,
        ge=-150,
        le=150,
        description="Height of its zero above the ellipsoid at the survey, metres; 0 beside `logs.geoid`",
    )
    sigma_separation_m: NonNegative = Field(
        default=0.0, le=10, description="Standard deviation of that separation, or of the grid, metres"
    )

    @model_validator(mode="after")
    def _check_name(self) -> Self:
        if (self.name is None) != (self.separation_m == 0 and self.sigma_separation_m == 0):
            raise ValueError("a separation without the name of its height system, or a name without one")
        return self


class MeshSettings(Section):
    """Triangles for hydraulic models."""

    edge_m: float = Field(
        default=2.0, ge=0.05, le=500, description="Length of the edges that is aimed at, metres"
    )
    least_angle_deg: float = Field(
        default=20.0, ge=5, le=30, description="No triangle may have a smaller angle, degrees"
    )


class SectionSettings(Section):
    """Cross sections."""

    spacing_m: float = Field(
        default=10.0, ge=0.2, le=10_000, description="Distance of cross sections along the river, metres"
    )
    overbank_m: NonNegative = Field(
        default=5.0, le=1000, description="Length of a section beyond either bank, metres"
    )
    manning: float = Field(
        default=0.035,
        ge=0.005,
        le=0.5,
        description="Manning's n that is written into exports; nothing is computed with it",
    )
    levels: int = Field(
        default=25, ge=3, le=500, description="Levels of hydraulic tables and of the hypsometry"
    )


class Fusion(Section):
    """One model of bed and banks, and its exports."""

    ground: GroundFilter = Field(default=GroundFilter(), description="Ground of the banks")
    fit: CloudFit = Field(default=CloudFit(), description="Cloud of the surroundings (`logs.uav`)")
    cell_m: Annotated[float, Field(ge=0.05, le=100)] | None = Field(
        default=None, description="Cell of the terrain model, metres; null: that of the bed"
    )
    blend_m: Positive = Field(
        default=1.0, le=50, description="Over this length a source fades out at its border, metres"
    )
    fill: Literal["none", "interpolate"] = Field(
        default="none",
        description="Gaps outside the water: left empty, or interpolated and named in the band of sources",
    )
    fill_m: Positive = Field(
        default=5.0, le=500, description="Cells farther from data than this stay empty all the same, metres"
    )
    vertical: Vertical = Field(default=Vertical(), description="Heights above a level surface")
    correlation_m: Positive | None = Field(
        default=None,
        le=1000,
        description="Distance over which errors of the model fall to 1/e, besides the common part, metres; "
        "null: as the kriging of the bed says, for areas and across the river apart",
    )
    weir: Corner | None = Field(
        default=None,
        description="East, north of the middle of a weir at the lower end, local frame, metres, or a file of "
        "a GIS with this point: is the river deeper before it? null: there is none",
        json_schema_extra=or_file,
    )
    contour_m: Positive = Field(default=0.25, le=100, description="Interval of contours, metres")
    sections: SectionSettings = Field(default=SectionSettings(), description="Cross sections")
    mesh: MeshSettings = Field(default=MeshSettings(), description="Triangles for hydraulic models")
    exports: list[Literal["2dm", "selafin", "ugrid", "hecras", "swmm", "csv", "bag"]] = Field(
        default=["2dm", "selafin", "ugrid", "hecras", "swmm", "csv", "bag"],
        description="Files that are written for other programs",
    )

    @model_validator(mode="after")
    def _check_exports(self) -> Self:
        if len(set(self.exports)) != len(self.exports):
            raise ValueError(f"exports names a format twice: {', '.join(self.exports)}")
        return self
