"""Sections ``reference`` and ``accuracy``: what the cloud is compared with, and how."""

from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from thalweg.settings.sections.base import Finite, NonNegative, Positive, Section, Vector3, or_file

EDGES_PER_CELL: Final = 1.5
"""Points of cells side by side are a cell apart, and across the corner 1.4 times that."""

Corner = tuple[Finite, Finite]
"""Corner of a polygon: east and north, metres."""


class Area(Section):
    """Part of the cloud that is compared; nothing said: all that the reference covers."""

    polygon: Annotated[list[Corner], Field(min_length=3, max_length=10_000)] | None = Field(
        default=None,
        description="Corners east, north in the coordinates of `frame`, metres, or a file of a GIS with one "
        "polygon, FILE?COLUMN=VALUE of several; null: no limit in plan",
        json_schema_extra=or_file,
    )
    frame: Literal["local", "map"] = Field(
        default="local",
        description="`local`: world frame of the campaign; `map`: `campaign.crs` with ellipsoidal heights. "
        "For the polygon and for the heights",
    )
    min_height_m: Finite | None = Field(
        default=None, description="Lowest height in the coordinates of `frame`, metres; null: no limit"
    )
    max_height_m: Finite | None = Field(
        default=None, description="Highest height in the coordinates of `frame`, metres; null: no limit"
    )

    @model_validator(mode="after")
    def _check_heights(self) -> Self:
        low, high = self.min_height_m, self.max_height_m
        if low is not None and high is not None and low >= high:
            raise ValueError(f"min_height_m {low:g} is not below max_height_m {high:g}")
        return self


class ReferenceSettings(Section):
    """Reference cloud (TLS) -> surface mesh."""

    sigma_m: NonNegative = Field(
        default=0.005,
        le=1,
        description="Standard deviation of the reference's position along its surface normal, metres: "
        "registration of the stations and georeferencing. Noise of single points adds to it by itself",
    )
    method: Literal["delaunay", "poisson"] = Field(
        default="delaunay",
        description="`delaunay`: triangles in the plane of the bank, goes through the data; `poisson`: "
        "smooth surface through oriented points, also for overhangs",
    )
    cell_m: Positive = Field(
        default=0.05, description="The cloud is thinned to one point a cell of this width, metres"
    )
    longest_edge_m: Positive = Field(
        default=0.5, description="Triangles with a longer edge are holes: no surface is made up, metres"
    )
    isolated_radius_m: Positive = Field(
        default=0.25, description="Radius of the neighbourhood of a reference point, metres"
    )
    isolated_neighbours: int = Field(
        default=4, ge=0, le=200, description="Points with fewer others within the radius are left out; 0: off"
    )
    clearance_m: Positive | None = Field(
        default=0.3,
        description="Points that stand farther than this in front of the lower envelope of the cloud are "
        "vegetation or loose objects and left out, metres along the bank's normal; null: off, and spikes of "
        "single cells stay as well",
    )
    seen_from_m: Vector3 | None = Field(
        default=None,
        description="Place in front of the reference, in its coordinates, metres: there distances are "
        "positive. For logs.cloud; null: from above. A boat is in front by itself",
    )
    poisson_depth: int | None = Field(
        default=None,
        ge=5,
        le=14,
        description="Depth of the octree of the Poisson reconstruction; null: deep enough for `cell_m`, "
        "at most 12",
    )

    @model_validator(mode="after")
    def _check_edge(self) -> Self:
        if self.longest_edge_m < EDGES_PER_CELL * self.cell_m:
            raise ValueError(
                f"longest_edge_m {self.longest_edge_m:g} is below {EDGES_PER_CELL:g} times cell_m "
                f"{self.cell_m:g}: points of neighbouring cells would make no triangle"
            )
        return self


class Sections(Section):
    """Cross sections through cloud and reference (P2 Fig. 15)."""

    count: int = Field(default=3, ge=1, le=12, description="Sections spread evenly over the area")
    stations_m: Annotated[list[Finite], Field(min_length=1, max_length=12)] | None = Field(
        default=None,
        description="Places along the bank, metres from the middle of the area; overrides `count`",
    )
    thickness_m: float = Field(
        default=0.2,
        gt=0,
        le=10,
        allow_inf_nan=False,
        description="Thickness of the slab that is drawn, metres",
    )


class Accuracy(Section):
    """Comparison of the cloud with the reference mesh."""

    area: Area = Field(default=Area(), description="Area of interest")
    border: Literal["exclude", "keep"] = Field(
        default="exclude",
        description="Points whose nearest place of the mesh lies on its border: their distance says where "
        "the reference ends, not how good the point is (P4 7.3). They are counted in both cases",
    )
    max_distance_m: Positive = Field(
        default=2.0, le=100, description="Points farther from the mesh have no counterpart, metres; counted"
    )
    max_points: int = Field(
        default=1_000_000,
        ge=1_000,
        le=100_000_000,
        description="Points compared at most: of more, a random sample, the same in each run",
    )
    outlier_nmads: float = Field(
        default=5.0,
        ge=1,
        le=100,
        allow_inf_nan=False,
        description="Outlier rule: points whose distance, divided by its own sigma, is farther from the "
        "median than this many NMAD. All statistics are given with and without the rule",
    )
    correlation_s: Annotated[float, Field(gt=0, le=3600)] | Literal["auto"] = Field(
        default="auto",
        description="Correlation time of the slowest error of the trajectory, seconds: decides how many "
        "independent values a comparison holds, and so its confidence bands; `auto`: as estimated from the "
        "survey (`orientation/error_model.json`)",
    )
    registration: bool = Field(
        default=True,
        description="Also fit the cloud to the mesh by a rigid motion and report that apart, as "
        "`with registration` (P2 section 7)",
    )
    sections: Sections = Field(default=Sections(), description="Cross sections")
