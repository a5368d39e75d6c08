"""Section ``twin`` of calibrations: the field with its markers, and the basin of the light sheet.

A yard with eight cones, six of them lying on both sides of the boat, printed markers, scale bars and RTK
targets. The boat stands in it three times, mostly turned, and is then moved around in it.

How an image comes about (laser, water, lens, chip) has a section each, and each effect a switch.
"""

from typing import Annotated, Literal

from pydantic import Field

from thalweg.settings.sections import Angle, NonNegative, Positive, Section, Share, Sigma3

# ---------------------------------------------------------------- calibration field


Tilt = Annotated[float, Field(ge=-30, le=30, allow_inf_nan=False)]
"""A small angle in degrees."""


class StaticPosition(Section):
    """Where the boat stands while image and lidar are recorded."""

    east_m: float = Field(default=0.0, ge=-2, le=2, description="East of the middle, metres")
    north_m: float = Field(default=0.0, ge=-2, le=2, description="North of it, metres")
    heading_deg: Angle = Field(default=0.0, description="Heading, clockwise from north, degrees")
    roll_deg: Tilt = Field(default=0.0, description="Roll, right side down, degrees")
    pitch_deg: Tilt = Field(default=0.0, description="Pitch, nose up, degrees")


class TwinFieldRun(Section):
    """The dynamic run: figures of eight in the middle of the yard that turn slowly about it."""

    speed_mps: float = Field(
        default=0.65,
        ge=0.2,
        le=3,
        description="Mean speed, m/s; it swings between 0.65 and 1.35 of that, and a little more",
    )
    reach_m: float = Field(
        default=2.9,
        ge=0.5,
        le=10,
        description="Greatest distance of the boat from the middle of the yard, metres",
    )


class TwinFieldEffects(Section):
    """Faults of a calibration; all off unless switched on."""

    passers_by: int = Field(
        default=0,
        ge=0,
        le=20,
        description="People who stand near the cones in lidar recordings, other places each time",
    )


class TwinField(Section):
    """The calibration field, its targets, and the boat's places in it."""

    half_angle_deg: float = Field(
        default=25.0, ge=10, le=45, description="Nominal angle between axis and surface of the cones, degrees"
    )
    module_m: float = Field(
        default=0.012, ge=0.002, le=0.02, description="Side of a module of the markers on cones, metres"
    )
    tour: Literal["in turn", "planned"] = Field(
        default="in turn",
        description="Reference images: `in turn` near a cone and across the yard, at two heights; `planned` "
        "35 views chosen so that nearly every marker stands in three images",
    )
    n_targets: int = Field(default=6, ge=0, le=6, description="Markers that were measured with RTK")
    sigma_target_m: Sigma3 = Field(
        default=(0.008, 0.008, 0.012), description="Error east, north, up of these measurements, metres"
    )
    positions: tuple[StaticPosition, ...] = Field(
        default=(
            StaticPosition(east_m=0.05, north_m=0.30, heading_deg=4.0, roll_deg=2.0, pitch_deg=-1.5),
            StaticPosition(east_m=-0.12, north_m=-0.25, heading_deg=177.0, roll_deg=-3.0, pitch_deg=2.5),
            StaticPosition(east_m=0.15, north_m=0.40, heading_deg=-7.0, roll_deg=4.0, pitch_deg=1.0),
        ),
        min_length=1,
        max_length=20,
        description="Where the boat stands; the positions differ mostly in orientation",
    )
    position_s: Positive = Field(
        default=5.0, le=60, description="Length of the lidar recording of each position, seconds"
    )
    run: TwinFieldRun = Field(default=TwinFieldRun(), description="Dynamic run")
    effects: TwinFieldEffects = Field(default=TwinFieldEffects(), description="Faults of the calibration")


# ---------------------------------------------------------------- strip of the light sheet from the boat


class TwinSheetStrip(Section):
    """Images of the sensor on the boat over a shallow piece of bed; the sensor is that of its calibration."""

    lines: int = Field(default=24, ge=3, le=400, description="Images of the strip")
    rate_hz: float = Field(
        default=50.0, ge=1, le=100, description="Images a second; at 1.2 m/s, 50 of them are 24 mm apart"
    )
    depth_m: float = Field(
        default=0.13, ge=0.05, le=0.25, description="Mean depth of the bed below the window, metres"
    )
    step_mm: Positive = Field(default=1.0, description="Width of the mesh of the true bed, mm")


# ---------------------------------------------------------------- basin of the light sheet


Colour = Literal["bayer", "rgb", "mono"]


class Laser(Section):
    """The light sheet itself."""

    waist_mm: Positive = Field(
        default=0.11,
        description="Radius of the beam across the sheet at its waist, to 1/e^2 of the intensity, before the "
        "window; refraction makes a tilted sheet a few percent wider, mm",
    )
    waist_depth_mm: Positive = Field(default=125.0, description="Depth of the waist in mid-fan, mm")
    wavelength_nm: float = Field(
        default=520.0,
        gt=300,
        lt=1000,
        description="Wavelength in vacuum; with the waist it decides how the line widens, nm",
    )
    profile: Literal["powell"] = Field(
        default="powell", description="Intensity along the line: even, but for the ends (Powell lens)"
    )


class Water(Section):
    """What the water does to the light."""

    attenuation_per_m: NonNegative = Field(
        default=0.2, description="Beam attenuation; 0.2 is clear lake water, 5 and more is turbid, 1/m"
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
    offsets: int = Field(default=9, ge=3, le=41, description="Rays across the sheet for each sub-beam")
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
    temperature_c: float = Field(
        default=18.0,
        ge=0,
        le=40,
        description="Temperature of the water, for its refractive index, degrees Celsius",
    )
    levels_mm: tuple[Positive, ...] = Field(
        default=(60.0, 150.0),
        min_length=2,
        max_length=3,
        description="Depths of the calibration object's levels, mm (P4 4.3)",
    )
    panels_mm: tuple[Positive, ...] = Field(
        default=(128.9, 122.7, 83.1, 72.7),
        min_length=1,
        description="Depths of the plane panel, mm (P3 3.1.2)",
    )
    scan_lines: int = Field(
        default=40,
        ge=0,
        le=400,
        description="Images of each scan, of the stepped object and of the wreck; 0: none",
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
    lens_pictures: int = Field(
        default=24,
        ge=0,
        le=200,
        description="Pictures of a field of markers in air, for the interior orientation of the sensor's "
        "camera (P3 2.4); 0: none, the design holds it as given",
    )
    image: SheetImage = Field(default_factory=SheetImage, description="Light, water, lens and chip")
