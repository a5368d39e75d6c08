"""Sections ``georeferencing`` and ``figures``: what comes out."""

from typing import Annotated

from pydantic import Field

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import NonNegative, Positive


class Georeferencing(Section):
    """Lidar points into the world frame."""

    min_range_m: NonNegative = Field(
        default=0.5, le=250, description="Nearer points are left out, metres; the own boat has its own filter"
    )
    max_range_m: Positive = Field(default=100.0, le=250, description="Farther points are left out, metres")
    chunk_points: int = Field(
        default=1_000_000, ge=10_000, le=50_000_000, description="Points held in memory at a time"
    )
    laz_scale_m: Annotated[float, Field(ge=1e-5, le=0.01, allow_inf_nan=False)] = Field(
        default=0.001, description="Resolution of coordinates in LAZ files, metres"
    )
    correlations: bool = Field(
        default=False,
        description="Write the correlations of each point's coordinates beside its three standard "
        "deviations; always so for a twin, and where there is a reference",
    )
    export_map: bool = Field(
        default=True, description="Also write the cloud in map coordinates (`campaign.crs`)"
    )


class Figures(Section):
    """Pictures."""

    dpi: int = Field(default=200, ge=50, le=1200, description="Resolution, dots per inch")
    max_points: int = Field(
        default=2_000_000, ge=1_000, le=100_000_000, description="Points drawn at most in a scatter plot"
    )
