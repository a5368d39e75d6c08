"""Adjustment of the image block, and the control points on the bank."""

from typing import Annotated, Literal

from pydantic import Field

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import Finite, NonNegative, Positive, Sigma3
from thalweg.settings.sections.navigation import Fix


class AntennaPositions(Section):
    """GNSS positions at the exposures as observations of the projection centres."""

    use: bool = Field(
        default=False,
        description="Positions of the antenna take part in the adjustment; they replace control points where "
        "the track is good",
    )
    accept_fixes: tuple[Fix, ...] = Field(
        default=("fixed",), min_length=1, description="Kinds of GNSS solution that may enter"
    )
    max_gap_s: Positive = Field(
        default=1.0, le=60, description="Longest hole between positions in which an image gets one, seconds"
    )
    correlation_time_s: NonNegative = Field(
        default=10.0,
        description="Correlation time of the positions' errors, seconds; 0: independent of each other",
    )
    shift: bool = Field(default=False, description="Estimate a common shift of all positions")
    drift: bool = Field(default=False, description="Estimate a shift that grows with time")


class BlockAdjustment(Section):
    """Bundle adjustment of the images with control points inside."""

    interior: Literal["auto", "free", "weighted", "fixed"] = Field(
        default="auto",
        description="Interior orientation: `free`: estimated; `weighted`: estimated with the calibration's "
        "covariance as observation; `fixed`: as calibrated; `auto`: weighted where a calibration with "
        "covariance is given, else free",
    )
    free_parameters: tuple[Literal["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2"], ...] = Field(
        default=("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
        description="Interior parameters to estimate freely; those that the lens model does not have are "
        "left out. Distortion that is not named is estimated about its start value with the sigma that "
        "lenses have",
    )
    square_pixels: bool = Field(
        default=True,
        description="The focal lengths in x and y change together where the interior orientation is free",
    )
    interior_variance: float = Field(
        default=2.0,
        ge=1,
        le=100,
        description="Least variance of what the images tell of the interior orientation over that by their "
        "residuals: features of one bank err in common, which residuals do not show. 2 by rendered blocks "
        "(`image_block_study`) and a real aerial one; parts of a block that disagree about the lens raise "
        "it; 1 counts the residuals alone. A calibration's covariance does not change",
    )
    loss: Literal["none", "huber", "cauchy"] = Field(
        default="huber", description="Robust weights of image measurements"
    )
    loss_limit: Positive = Field(
        default=3.0, le=20, description="Residual over its sigma at which robust weights begin to fall"
    )
    reject_limit: Positive = Field(
        default=5.0, le=100, description="Residual over its sigma beyond which a measurement is left out"
    )
    restless_limit: Positive = Field(
        default=4.0,
        le=1000,
        description="Variance of the errors around a point over the usual one beyond which its surroundings "
        "(leaves in the wind, edge of the water) take no part",
    )
    correlated: bool = Field(
        default=True,
        description="Estimate from the block how the errors of a point's measurements are correlated between "
        "views; false: independent errors, and sigmas that come out too small",
    )
    least_angle_deg: NonNegative = Field(
        default=1.0, le=30, description="Points whose rays differ by less take no part, degrees"
    )
    max_iterations: Annotated[int, Field(ge=5, le=500)] = Field(
        default=50, description="Iterations after which the adjustment gives up"
    )
    antenna: AntennaPositions = Field(
        default=AntennaPositions(), description="GNSS positions at the exposures as observations"
    )


class ControlPoints(Section):
    """Surveyed points on the bank and how they are found in the images."""

    crs: str | None = Field(
        default=None,
        description="CRS of coordinates x, y, z of tables that state none, such as EPSG:25833; null: "
        "campaign.crs",
    )
    height_offset_m: Finite = Field(
        default=0.0,
        ge=-200,
        le=200,
        description="Added to the heights of the points, metres: height of the geoid above the ellipsoid "
        "where they are above the geoid; not to up_m of the world frame",
    )

    sigma_m: Sigma3 = Field(
        default=(0.010, 0.010, 0.015),
        description="Standard deviations east, north, up of points whose table states none, metres (RTK)",
    )
    sigma_px: Positive = Field(
        default=0.5, le=50, description="Standard deviation of marks whose table states none, pixels"
    )
    detect: bool = Field(
        default=True, description="Find 2 by 2 checker boards in the images where no table of marks is given"
    )
    board_m: Annotated[float, Field(ge=0.05, le=5)] = Field(
        default=0.6, description="Side of a board, rim included, metres"
    )
    rim_share: Annotated[float, Field(ge=0, le=0.3)] = Field(
        default=0.06, description="Width of the white rim as a share of the side"
    )
    upper_left: Literal["black", "white", "either"] = Field(
        default="either", description="Colour of the upper left quarter of a board"
    )
    search_m: NonNegative = Field(
        default=0.5,
        le=20,
        description="How far the block may be off in the world before control points are measured (one "
        "sigma), metres; the window of the search is three times as large",
    )
    least_board_px: Annotated[float, Field(ge=5, le=1000)] = Field(
        default=8.0, description="Least height of a board that is measured, pixels"
    )
    least_score: Annotated[float, Field(ge=0.3, lt=1)] = Field(
        default=0.7, description="Least correlation of a picture with a checker"
    )
    least_images: Annotated[int, Field(ge=2, le=50)] = Field(
        default=3, description="Images that must agree on where a board is"
    )
