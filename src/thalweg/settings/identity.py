"""Section ``campaign``: what the survey is called and where its world frame lies."""

from typing import Annotated

from pydantic import Field

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import Finite

ID_PATTERN = "^[a-z][a-z0-9_]*$"


class Origin(Section):
    """Origin of the local east-north-up frame wcs, geodetic."""

    lat_deg: Annotated[float, Field(ge=-90, le=90, allow_inf_nan=False)] = Field(
        description="Latitude of the origin of the local frame, degrees, north positive", examples=[51.05]
    )
    lon_deg: Annotated[float, Field(ge=-180, le=180, allow_inf_nan=False)] = Field(
        description="Longitude of the origin, degrees, east positive", examples=[13.25]
    )
    h_ell_m: Finite = Field(
        ge=-500, le=9000, description="Ellipsoidal (not orthometric) height of the origin, metres",
        examples=[300.0],
    )  # fmt: skip


class Identity(Section):
    """Name, map and world frame of the campaign."""

    id: str = Field(
        pattern=ID_PATTERN,
        max_length=60,
        description="Short name: small letters, digits, underscores; equals the name of the file",
        examples=["mulde"],
    )
    title: str = Field(
        min_length=1, description="One line for figures and reports", examples=["Mulde near Grimma, May 2021"]
    )
    crs: str = Field(
        description="Projected, metric CRS of the map exports: EPSG code or PROJ definition",
        examples=["EPSG:25833"],
    )
    origin: Origin = Field(description="Origin of the local east-north-up frame: near the survey")
    seed: int = Field(
        default=1, ge=0, le=2**32 - 1, description="Seed of everything random (digital twin, sampling)"
    )
