"""The cameras of the digital twin: lens, sensor and clock of the boat's camera, and the reflex camera.

The defaults of the boat's camera are those of the Panasonic GX80 with 14 mm lens of P2 section 5 at half
resolution (4592 x 3448 pixels of 3.77 micrometres, so 3716 pixels of focal length there and 1858 here). The
clock and the display test are those of P2 6.1.2.
"""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import Finite, Positive, Share

Side = Annotated[int, Field(ge=16, le=10_000)]
"""Pixels along a side of an image."""

Quality = Annotated[int, Field(ge=1, le=100)]
"""Quality of JPEG as Pillow and libjpeg count it."""

PERSPECTIVE = ("k1", "k2", "p1", "p2", "k3")
FISHEYE = ("k1", "k2", "k3", "k4")


class TwinLens(Section):
    """True interior orientation and image quality of a camera."""

    model: Literal["perspective", "fisheye"] = Field(
        default="perspective",
        description="`perspective`: Brown's lens; `fisheye`: equidistant, sees behind itself",
    )
    size_px: tuple[Side, Side] = Field(default=(2296, 1724), description="Width and height, pixels")
    focal_px: Positive = Field(default=1858.0, description="Camera constant, pixels")
    principal_offset_px: tuple[Finite, Finite] = Field(
        default=(6.3, -4.1),
        description="Principal point minus middle of the image, to the right and down, pixels",
    )
    distortion: tuple[Finite, ...] = Field(
        default=(-0.062, 0.081, 0.0004, -0.0003, -0.018),
        description="True distortion, no unit: k1, k2, p1, p2, k3 of Brown in the order of OpenCV for "
        "`perspective`, k1, k2, k3, k4 of the equidistant model for `fisheye`",
    )
    field_of_view_deg: Annotated[float, Field(gt=0, le=360)] = Field(
        default=190.0,
        description="Full angle of the image circle of a fisheye lens, degrees; other lenses have none",
    )
    sharpness_px: Annotated[float, Field(ge=0, le=10)] = Field(
        default=0.65,
        description="Sigma of the Gaussian point spread function, pixels; 0: as sharp as the pixel",
    )
    noise: Annotated[float, Field(ge=0, le=50)] = Field(
        default=1.6, description="Sensor noise of a middle grey, steps of 8 bits; 0: none"
    )
    jpeg_quality: Quality = Field(default=92, description="Quality of the JPEG files, 1 to 100")

    @model_validator(mode="after")
    def _check_distortion(self) -> Self:
        names = PERSPECTIVE if self.model == "perspective" else FISHEYE
        if len(self.distortion) != len(names):
            raise ValueError(
                f"distortion has {len(self.distortion)} numbers, but a {self.model} lens has {len(names)}: "
                f"{', '.join(names)}"
            )
        return self


class TwinReference(TwinLens):
    """The reflex camera that photographs the calibration field, and its tour."""

    size_px: tuple[Side, Side] = Field(default=(3000, 2000), description="Width and height, pixels")
    focal_px: Positive = Field(default=2350.0, description="Camera constant, pixels (28 mm on full frame)")
    principal_offset_px: tuple[Finite, Finite] = Field(
        default=(-8.7, 5.2),
        description="Principal point minus middle of the image, to the right and down, pixels",
    )
    distortion: tuple[Finite, ...] = Field(
        default=(-0.081, 0.064, -0.0002, 0.0003, 0.0),
        description="True distortion, no unit, as of the boat's camera",
    )
    n_images: Annotated[int, Field(ge=4, le=500)] = Field(
        default=36, description="Images of the tour around the field; the two of the boat come on top"
    )
    heights_m: tuple[Positive, Positive] = Field(
        default=(0.9, 2.1), description="Two heights of the camera above the ground, in turn, metres"
    )
    rolled: Share = Field(
        default=0.25, description="Share of the images taken with the camera turned by 90 degrees"
    )


class TwinDisplay(Section):
    """Photographs of a running clock: the test of the camera's clock (P2 6.1.2)."""

    duration_s: Annotated[float, Field(ge=2, le=86_400)] = Field(
        default=5400.0, description="Length of the test, seconds"
    )
    interval_mean_s: Annotated[float, Field(ge=0.1, le=60)] = Field(
        default=0.999, description="Mean time between two photographs, seconds"
    )
    interval_std_s: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.023, description="Standard deviation of the time between two photographs, seconds"
    )
    rate_hz: Annotated[float, Field(gt=0, le=1000)] = Field(
        default=100.0, description="Rate at which the display counts, Hz"
    )
    digits: Literal["segments", "font"] = Field(
        default="font",
        description="Look of the digits: seven segments that shine, or a font on a light window",
    )
    size_px: tuple[Side, Side] = Field(
        default=(320, 120), description="Width and height of a photograph, pixels"
    )
    exposure_s: Annotated[float, Field(gt=0, le=0.1)] = Field(
        default=0.004,
        description="Exposure: where the display changes in it, two numbers lie over each other; seconds",
    )
    glare: Share = Field(
        default=0.5, description="Strength of a reflex of the sun that wanders over the display; 0: none"
    )
    blur_px: Annotated[float, Field(ge=0, le=10)] = Field(
        default=0.9, description="Sigma of the blur of a good photograph, pixels"
    )
    noise: Annotated[float, Field(ge=0, le=50)] = Field(
        default=3.0, description="Image noise, steps of 8 bits"
    )
    unreadable: Share = Field(
        default=0.02,
        description="Share of photographs spoiled by chance: shaken, out of focus, covered, burnt out",
    )
    jpeg_quality: Quality = Field(default=85, description="Quality of the JPEG files, 1 to 100")


class TwinCamera(TwinLens):
    """The boat's camera and its clock, the reflex camera and the display test."""

    rate_hz: Annotated[float, Field(gt=0, le=60)] = Field(default=1.0, description="Images per second")
    clock_offset_s: Finite = Field(
        default=2.3471, description="Reading of the camera's clock minus UTC at the begin of the run, seconds"
    )
    clock_drift_ppm: Annotated[float, Field(ge=-1000, le=1000)] = Field(
        default=12.0, description="Rate of the camera's clock minus that of UTC, parts per million"
    )
    jitter_s: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.023,
        description="Standard deviation of the true exposure about its stamp, seconds (P2 6.1.2)",
    )
    interval_jitter_s: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.004, description="Standard deviation of the stamps about even intervals, seconds"
    )
    exposure_s: Annotated[float, Field(ge=0, le=0.1)] = Field(
        default=0.0008, description="Exposure: the moving boat smears its images by as much; seconds"
    )
    reference: TwinReference = Field(
        default=TwinReference(), description="Reflex camera for the reference of the calibration field"
    )
    display: TwinDisplay = Field(default=TwinDisplay(), description="Clock test with a running display")
