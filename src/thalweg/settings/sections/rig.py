"""Sections ``rig`` and ``panorama``: a camera with two fisheye lenses back to back, and its panoramas."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from thalweg.settings.sections.base import NonNegative, Positive, Section
from thalweg.settings.sections.calibration import ImageTimes
from thalweg.settings.sections.images import StatedClock
from thalweg.settings.sections.mounts import CameraMount

Pixels = Annotated[int, Field(ge=0, le=100_000)]


class RigLens(Section):
    """One lens as a view of a file: a box of its pixels, turned upright."""

    box_px: tuple[Pixels, Pixels, Pixels, Pixels] = Field(
        default=(0, 0, 640, 640),
        description="Box of the file that the lens fills: left, top, width, height, pixels",
    )
    turn_deg: Literal[0, 90, 180, 270] = Field(
        default=0, description="Clockwise turn that sets the picture of the lens upright, degrees"
    )
    mask: str | None = Field(
        default=None,
        description="Picture of the size of the upright view, 0 where it is not to be used (boat, mast); "
        "path from the folder of the run",
    )

    @model_validator(mode="after")
    def _box_has_pixels(self) -> Self:
        if min(self.box_px[2:]) < 16:
            raise ValueError(
                f"box_px has the width and height {self.box_px[2]} x {self.box_px[3]}, at least 16 are needed"
            )
        return self


class Rig(Section):
    """Two lenses that look apart and expose together; the frame of the rig is that of the front lens."""

    size_px: tuple[Pixels, Pixels] = Field(
        default=(1280, 640), description="Width and height of the files, pixels"
    )
    model: Literal["fisheye", "perspective"] = Field(
        default="fisheye", description="Kind of both lenses; two cameras back to back are `perspective`"
    )
    front: RigLens = Field(default=RigLens(), description="Lens that gives the rig its frame")
    back: RigLens = Field(
        default=RigLens(box_px=(640, 0, 640, 640), turn_deg=180), description="The lens opposite"
    )
    field_of_view_deg: Annotated[float, Field(gt=10, lt=300)] = Field(
        default=202.0, description="Full angle of the image circles, or of wide enough a cone, degrees"
    )
    mount: CameraMount = Field(
        default=CameraMount(), description="Front lens in the body frame of the INS, see `mounts.camera`"
    )
    times: ImageTimes = Field(default=ImageTimes(), description="Stamps of the files")
    clock: StatedClock = Field(default=StatedClock(), description="What is known of the clock of the rig")


class Panorama(Section):
    """Panoramas of the rig."""

    mode: Literal["depth", "sphere", "none"] = Field(
        default="depth",
        description="Where things are taken to be: `depth` at the range of the lidar cloud, `sphere` all at "
        "one range, `none` infinitely far",
    )
    radius_m: Positive = Field(default=8.0, le=1000, description="Range of everything for `sphere`, metres")
    width_px: Annotated[int, Field(ge=64, le=32_768, multiple_of=2)] | None = Field(
        default=None, description="Width, pixels; null: as fine as the lenses in their middle"
    )
    every: Annotated[int, Field(ge=1, le=10_000)] = Field(
        default=1, description="A panorama of each so many exposures"
    )
    reach_m: Positive = Field(
        default=80.0, le=1000, description="Points of the cloud so near are ranges of a panorama, metres"
    )
    cell_deg: Annotated[float, Field(ge=0.05, le=5, allow_inf_nan=False)] = Field(
        default=0.5, description="Cells in which the nearest point is looked for, degrees"
    )
    gap_deg: NonNegative = Field(
        default=6.0, le=45, description="Gaps of the cloud so wide are filled from their border, degrees"
    )
    boat: Literal["keep", "mask"] = Field(
        default="keep", description="What the masks of the lenses hide: kept in the picture, or grey"
    )
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] = Field(
        default=92, description="Quality of the JPEG files, 1 to 100"
    )
