"""Exterior orientations that another program has found."""

from typing import Literal

from pydantic import Field

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import Finite, Positive, Share


class FinishedOrientations(Section):
    """Poses of the images from COLMAP, Metashape, Pix4D or a table, instead of the own adjustment."""

    crs: str | None = Field(
        default=None,
        description="What the coordinates of the file refer to: the name of a CRS such as EPSG:25833, or "
        "`world` for the world frame of the campaign; null: as the file says, a table without it in "
        "campaign.crs, and a COLMAP model in a frame of its own",
    )
    rotation: Literal["omega_phi_kappa", "phi_omega_kappa", "kappa_phi_omega"] = Field(
        default="omega_phi_kappa",
        description="Order of the rotations of a table: `omega_phi_kappa` is Rx(omega) Ry(phi) Rz(kappa)",
    )
    direction: Literal["image_to_world", "world_to_image"] = Field(
        default="image_to_world", description="What the rotation of a table turns into what"
    )
    axes: Literal[
        "right_up_back", "right_down_forward", "up_left_back", "left_down_back", "down_right_back"
    ] = Field(
        default="right_up_back",
        description="Directions of the image's x, y and z axes to which the angles of a table refer: "
        "`right_up_back` in aerial photogrammetry, `right_down_forward` in computer vision",
    )
    angle_unit: Literal["auto", "deg", "gon", "rad"] = Field(
        default="auto", description="Unit of a table's angles; `auto`: as its header says, else degrees"
    )
    north: Literal["grid", "true"] = Field(
        default="grid",
        description="North to which the angles of a table in a map grid refer; `grid` in Metashape and Pix4D",
    )
    height_offset_m: Finite = Field(
        default=0.0,
        ge=-200,
        le=200,
        description="Added to the heights of the file, metres: height of the geoid above the ellipsoid where "
        "the file's heights are above the geoid",
    )
    align: Literal["none", "predictions"] = Field(
        default="none",
        description="`predictions`: a model in a frame of its own is put onto the predicted trajectory, "
        "whose errors it then has; `none`: it is refused",
    )
    sigma_position_m: Positive = Field(
        default=0.02,
        le=100,
        description="Standard deviation of a coordinate where the file states none, metres",
    )
    sigma_angle_deg: Positive = Field(
        default=0.05,
        le=30,
        description="Standard deviation of a rotation where the file states none, degrees",
    )
    neighbour_correlation: Share = Field(
        default=0.9,
        description="Correlation of the errors of neighbouring images, which no program exports; 0 "
        "would make the mean of some images better than it is",
    )
    least_matched: Share = Field(
        default=0.5, description="Least share of the file's images that must be images of the campaign"
    )
    most_position_m: Positive = Field(
        default=20.0,
        description="Median distance from the predicted positions that is still believed, metres",
    )
    most_angle_deg: Positive = Field(
        default=20.0, le=180, description="Median angle from the predicted attitude still believed, degrees"
    )
