"""Section ``images``: from photographs of the bank to their exterior orientations and to a cloud."""

from pydantic import Field

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import Finite, NonNegative
from thalweg.settings.images.block import BlockAdjustment, ControlPoints
from thalweg.settings.images.cloud import CameraCloud
from thalweg.settings.images.finished import FinishedOrientations
from thalweg.settings.images.masks import Masks
from thalweg.settings.images.sfm import Features, Mapping
from thalweg.settings.sections.calibration import ImageTimes
from thalweg.settings.sections.logs import FolderName


class StatedClock(Section):
    """What is known of the camera's clock without a calibration, as from a photograph of a clock."""

    offset_s: Finite = Field(default=0.0, description="GPS time minus the stamp of an image, seconds")
    sigma_offset_s: NonNegative = Field(
        default=1.0, le=86_400, description="Standard deviation of that offset, seconds"
    )
    jitter_s: NonNegative = Field(
        default=0.023, le=1, description="Scatter of the images about their stamps, seconds (P2 6.1.2)"
    )


class Images(Section):
    """Orientation of photographs: stamps, masks, features, block, control points."""

    times: ImageTimes = Field(default=ImageTimes(), description="Stamps of the images")
    clock: StatedClock = Field(
        default=StatedClock(),
        description="The camera's clock, where no calibration has found it; a start, refined from the images",
    )
    off_boat: tuple[FolderName, ...] = Field(
        default=(),
        description="Folders of images whose camera is not at `mounts.camera`, in the hand or on another "
        "mount: they join the block and say nothing of the boat",
    )
    masks: Masks = Field(default=Masks(), description="Water, sky and own boat in the images")
    features: Features = Field(default=Features(), description="Features of the images")
    mapping: Mapping = Field(default=Mapping(), description="Structure from motion")
    control: ControlPoints = Field(
        default=ControlPoints(), description="Control points and where they are in the images"
    )
    adjustment: BlockAdjustment = Field(
        default=BlockAdjustment(), description="Bundle adjustment with control points"
    )
    cloud: CameraCloud = Field(default=CameraCloud(), description="Lidar frames at the images")
    finished: FinishedOrientations = Field(
        default=FinishedOrientations(), description="Orientations from other programs"
    )
