"""Section ``twin.light_sheet``: the underwater light-sheet sensor in a basin, and its images.

How an image comes about (laser, water, lens, chip) has a section each, and each effect a switch.
"""

from typing import Annotated, Literal

from pydantic import Field

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import NonNegative, Positive, Share

Colour = Literal["bayer", "rgb", "mono"]


class Laser(Section):
    """The light sheet itself."""

    waist_mm: Positive = Field(
        default=0.11,
        description="Radius of the beam across the sheet at its waist, to 1/e^2 of the intensity, before the "
        "window; refraction makes a tilted sheet a few percent wider, mm",
    )
    waist_depth_mm: Positive = Field(default=125.0, description="Depth of the waist in mid-fan, mm")
    wavelength_nm: Annotated[float, Field(gt=300, lt=1000)] = Field(
        default=520.0, description="Wavelength in vacuum; with the waist it decides how the line widens, nm"
    )
    profile: Literal["powell", "gauss"] = Field(
        default="powell", description="Intensity along the line: even (Powell lens) or Gaussian"
    )
    profile_deg: Positive = Field(
        default=35.0, description="Fan angle at which a Gaussian profile falls to 1/e^2, degrees"
    )


class Water(Section):
    """What the water does to the light."""

    attenuation_per_m: NonNegative = Field(
        default=0.2, description="Beam attenuation; 0.2 is clear lake water, 5 and more is turbid, 1/m"
    )
    scatter_per_m: NonNegative = Field(
        default=0.0,
        description="Light that the sheet sends to the camera on its way through the water, as the share "
        "that 1 m of water sends like a white surface, 1/m; 0: no veil",
    )
    veil_dn: NonNegative = Field(
        default=0.0, description="Even veil by daylight that turbid water sends back, grey values"
    )


class Lens(Section):
    """What the lens does to the light."""

    f_number: Positive = Field(default=8.0, description="Engraved f-number")
    focal_mm: Positive = Field(default=12.0, description="Focal length for the size of the blur disc, mm")
    pixel_um: Positive = Field(
        default=5.5, description="Side of a pixel for the size of speckle and of the blur disc, micrometres"
    )
    sharpness_px: Positive = Field(
        default=0.5, description="Standard deviation of the sharp lens' point image, pixels"
    )
    focus_depth_mm: Positive = Field(
        default=120.0, description="Depth of the sheet in mid-fan at which the lens is focused, mm"
    )
    defocus: bool = Field(default=True, description="Blur out of focus, by thin-lens optics")
    glare: Share = Field(default=0.01, description="Share of all light that the lens spreads widely")
    glare_px: Positive = Field(
        default=25.0, description="Standard deviation of that spread in an image 2048 pixels wide, pixels"
    )


class Chip(Section):
    """What the sensor does to the light."""

    colour: Colour = Field(
        default="bayer",
        description="Raw mosaic RGGB (bayer), three interpolated colours (rgb), or one (mono)",
    )
    peak_dn: Positive = Field(
        default=150.0,
        description="Exposure: peak of the line on a grey panel (albedo 0.45) at the focused depth without "
        "speckle, grey values; above 255 it saturates",
    )
    ambient_dn: NonNegative = Field(default=6.0, description="Daylight on a white level surface, grey values")
    dark_dn: NonNegative = Field(default=3.0, description="Grey value of no light")
    full_well_electrons: Positive = Field(default=13_500.0, description="Electrons of the largest grey value")
    read_electrons: NonNegative = Field(default=13.0, description="Noise of reading, electrons")
    noise: bool = Field(default=True, description="Shot noise and read noise")
    red_of_laser: Share = Field(default=0.08, description="Share of the laser's light that red pixels see")
    blue_of_laser: Share = Field(default=0.2, description="Share of the laser's light that blue pixels see")


class SheetImage(Section):
    """An image of the light-sheet sensor."""

    laser: Laser = Field(default_factory=Laser, description="The light sheet")
    water: Water = Field(default_factory=Water, description="The water")
    lens: Lens = Field(default_factory=Lens, description="The lens")
    chip: Chip = Field(default_factory=Chip, description="The sensor of the camera")
    speckle: bool = Field(default=True, description="Speckle of the laser")
    polarisations: Literal[1, 2] = Field(
        default=2, description="Independent speckle patterns: 2 on surfaces that depolarise, else 1"
    )
    halo_share: Share = Field(
        default=0.0,
        description="Share of the light on a white surface that leaves it further on along the laser's "
        "direction (subsurface lobe of P4 Fig. 16); it falls with the albedo; 0: none",
    )
    halo_mm: Positive = Field(default=0.5, description="Length to which that lobe falls to 1/e, mm")
    ambient_stride: Annotated[int, Field(ge=0, le=16)] = Field(
        default=0,
        description="Daylight is computed for blocks of so many pixels a side; 0: 1, 2, 4 for 512, 1024, "
        "2048 pixels",
    )
    offsets: Annotated[int, Field(ge=3, le=41)] = Field(
        default=9, description="Rays across the sheet for each sub-beam"
    )
    beams_per_px: Positive = Field(
        default=2.5, description="Sub-beams of a fan of 90 degrees, by the larger side of the image in pixels"
    )

    def clean(self) -> "SheetImage":
        """The same light without anything random and without wide light: for tests of the geometry."""
        return self.model_copy(
            update={
                "speckle": False,
                "halo_share": 0.0,
                "chip": self.chip.model_copy(update={"noise": False, "ambient_dn": 0.0}),
                "lens": self.lens.model_copy(update={"glare": 0.0, "defocus": False}),
                "water": Water(),
            }
        )


class TwinLightSheet(Section):
    """The sensor, what it takes images of, and how these come about."""

    size: Literal["tiny", "demo", "full"] = Field(
        default="demo",
        description="Pixels a side of an image: 512, 1024 or 2048; the geometry of P4's sensor stays, and "
        "all that counts in pixels",
    )
    temperature_c: Annotated[float, Field(ge=0, le=40)] = Field(
        default=18.0, description="Temperature of the water, for its refractive index, degrees Celsius"
    )
    levels_mm: Annotated[tuple[Positive, ...], Field(min_length=2, max_length=3)] = Field(
        default=(60.0, 150.0), description="Depths of the calibration object's levels, mm (P4 4.3)"
    )
    panels_mm: Annotated[tuple[Positive, ...], Field(min_length=1)] = Field(
        default=(128.9, 122.7, 83.1, 72.7), description="Depths of the plane panel, mm (P3 3.1.2)"
    )
    scan_lines: Annotated[int, Field(ge=0, le=400)] = Field(
        default=40, description="Images of each scan, of the stepped object and of the wreck; 0: none"
    )
    scan_step_mm: Positive = Field(
        default=3.0, description="Mean step from line to line, mm (P4 7.3: 2 to 5)"
    )
    black_exposure: Positive = Field(
        default=4.0,
        description="Exposure of the scan of the black stepped object as a multiple of the others: its line "
        "must be seen between the white markers, which saturate then (P4 7.2); the room is dark",
    )
    reference_mm: Positive = Field(
        default=0.5, description="Longest edge in the reference meshes of scanned objects, mm (P4 7.1: 0.1)"
    )
    lens_pictures: Annotated[int, Field(ge=0, le=200)] = Field(
        default=24,
        description="Pictures of a field of markers in air, for the interior orientation of the sensor's "
        "camera (P3 2.4); 0: none, the design holds it as given",
    )
    lost_pulses: Annotated[int, Field(ge=0, le=50)] = Field(
        default=0, description="Pulses of the trigger that were not recorded, in each series"
    )
    image: SheetImage = Field(default_factory=SheetImage, description="Light, water, lens and chip")
