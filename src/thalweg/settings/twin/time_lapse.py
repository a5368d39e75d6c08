"""The time-lapse images of the boat's camera on the river, and the control points on the bank.

Lens, sensor and clock are those of `thalweg.settings.twin.camera`; a smaller picture is the same lens with
all its pixels larger.
"""

from typing import Annotated, Literal

from pydantic import Field

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import NonNegative, Positive, Share, Sigma3
from thalweg.settings.twin.camera import Side

Images = Annotated[int, Field(ge=0, le=10_000)]
"""A number of images."""


class TimeLapseEffects(Section):
    """What is in the images, and named defects of them; each can be switched alone."""

    waves: bool = Field(
        default=True, description="Moving waves on the water; off: a mirror that stands still"
    )
    clouds: bool = Field(default=True, description="Clouds that drift; off: a clear sky")
    glare: bool = Field(
        default=True, description="The sun's own light in the sky and its glints on the water"
    )
    hull: bool = Field(
        default=True, description="A float of the own boat at the lower edge of the images, with its bow"
    )
    noise: bool = Field(default=True, description="Sensor noise of the camera's strength")
    blur: bool = Field(
        default=True, description="Softness of the lens and smear by the boat's motion during the exposure"
    )
    unstamped: Images = Field(
        default=0, description="Images without time in name and EXIF, as after a clock that lost its battery"
    )
    duplicated: Images = Field(
        default=0, description="Images that lie in the folder a second time, as copies of a file manager"
    )
    blurred: Images = Field(default=0, description="Images that are out of focus by several pixels")
    swapped_points: Annotated[int, Field(ge=0, le=100)] = Field(
        default=0, description="Pairs of control points whose names are swapped in the survey's table"
    )


class TwinTimeLapse(Section):
    """Time-lapse images along the voyage and the targets of the control points."""

    size_px: tuple[Side, Side] = Field(
        default=(720, 540),
        description="Width and height of an image, pixels; the camera's lens with larger or smaller pixels",
    )
    rate_hz: Annotated[float, Field(gt=0, le=60)] = Field(default=1.0, description="Images per second")
    share: Share = Field(
        default=1.0, description="Share of the voyage that images are taken of, from its begin"
    )
    supersampling: Annotated[int, Field(ge=1, le=4)] = Field(
        default=2,
        description="Rays along each side of a pixel where something ends in it; 1: one ray a pixel, jagged",
    )
    side: Literal["seen", "left", "right"] = Field(
        default="seen",
        description="Bank of the control points, looking downstream; `seen`: the one that the camera sees",
    )
    n_targets: Annotated[int, Field(ge=0, le=200)] = Field(
        default=12, description="Targets on the bank; every third is a check point"
    )
    target_size_m: Annotated[float, Field(ge=0.05, le=3)] = Field(
        default=0.6, description="Side of a target, a square board with a 2 by 2 checker, metres"
    )
    sigma_target_m: Sigma3 = Field(
        default=(0.005, 0.005, 0.008),
        description="Standard deviations of the survey of the targets (RTK): east, north, up, metres",
    )
    least_images: Annotated[int, Field(ge=1, le=1000)] = Field(
        default=3, description="Images that each target must be seen in, free and large enough"
    )
    least_target_px: Positive = Field(
        default=10.0, description="Least width of a target in an image that counts as seeing it, pixels"
    )
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] = Field(
        default=93, description="Quality of the JPEG files, 1 to 100"
    )
    defocus_px: NonNegative = Field(
        default=5.0, le=50, description="Sigma of the blur of images that are out of focus, pixels"
    )
    effects: TimeLapseEffects = Field(
        default=TimeLapseEffects(), description="What is in the images, and their defects"
    )
