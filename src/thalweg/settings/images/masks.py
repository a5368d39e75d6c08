"""Section ``images.masks``: which parts of the images are not searched for features."""

from typing import Annotated

from pydantic import Field

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import Share, SigmaAngle

Margin = Annotated[float, Field(ge=0, le=0.2, allow_inf_nan=False)]
"""A strip, as a share of an image's height."""


class Masks(Section):
    """Masks of water, sky and own boat; their colours and textures are learned from each series itself."""

    automatic: bool = Field(
        default=True,
        description="Find the masks of images for which none are supplied; false: such images are used whole",
    )
    analysis_px: Annotated[int, Field(ge=160, le=4000)] = Field(
        default=640,
        description="Longest side of the reduced images that are analysed, pixels; time grows as its square",
    )
    sample_images: Annotated[int, Field(ge=1, le=1000)] = Field(
        default=40,
        description="Images, evenly over the series, from which colours, textures and own boat are learned",
    )
    margin_share: Margin = Field(
        default=0.006,
        description="Strip of the bank above the water line that is masked too, share of the image's height",
    )
    hull_margin_share: Margin = Field(
        default=0.006, description="Strip around the own boat that is masked too, share of the image's height"
    )
    pose_sigma_deg: SigmaAngle = Field(
        default=3.0,
        gt=0,
        description="Least standard deviation of the approximate horizon, from trajectory and mount, degrees",
    )
    least_usable_share: Share = Field(
        default=0.03, description="Images with a smaller usable share are named in the report"
    )
