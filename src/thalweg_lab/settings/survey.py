"""Section ``twin`` of a survey: scene, boat, instruments, and the section as a whole.

Errors that the published sigmas contain are on. Faults that the processing cannot know (fields of the motors,
drift, multipath) are off unless switched on, as are shadows, which need trees, banks or a bridge.

The defaults of the boat's camera are those of the Panasonic GX80 with 14 mm lens of P2 section 5 at half
resolution (4592 x 3448 pixels of 3.77 micrometres, so 3716 pixels of focal length there and 1858 here). The
clock and the display test are those of P2 6.1.2.

Time-lapse images have the lens, sensor and clock of that camera; a smaller picture is the same lens with all
its pixels larger.

``size`` chooses a set of values; every key given beside it replaces one value of that set. The defaults
of the sensors are the published inputs: 3 cm lidar (P2 eq. 7: 17.3 mm a component), 3 mrad divergence,
0.1/0.1/0.2 degrees attitude, 20/20/30 mm PPK, TLS of 3 mm at 50 m in steps of 2.5 cm, turns of 7 degrees/s.
"""

import datetime as dt
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from thalweg.settings.sections import (
    Angle,
    Count,
    Finite,
    NonNegative,
    Positive,
    Section,
    Share,
    Sigma3,
    Vector3,
)
from thalweg_lab.settings.yard import TwinField, TwinLightSheet, TwinSheetStrip

# ---------------------------------------------------------------- river, banks and boat


Change = Literal[
    "undercut_bank",
    "bank_retreat",
    "niche",
    "collapsed_niche",
    "change_patches",
    "moved_boulders",
    "new_boulders",
    "gravel_bar",
    "scour",
    "fallen_tree",
    "grown_vegetation",
]
"""What epochs may differ by: on the left bank `undercut_bank`, `gravel_bar` and `fallen_tree`, on the right
one those of boulders, `bank_retreat`, both niches (an overhang, and what is left of it), `change_patches`."""


class TwinScene(Section):
    """The river reach: railway embankment on the right, meadow on the left (P2: Freiberger Mulde)."""

    length_m: float = Field(
        default=250.0, ge=20, le=2000, description="Length of the modelled reach along the flow, metres"
    )
    width_m: float = Field(default=40.0, ge=6, le=200, description="Mean width of the water, metres")
    depth_m: float = Field(
        default=2.2, ge=0.5, le=20, description="Mean depth of the thalweg below the water level, metres"
    )
    water_level_m: Finite = Field(
        default=0.0,
        description="Height above the origin of the campaign, metres, of the water for which the ground is "
        "made; the ground moves with it",
    )
    stage_m: float = Field(
        default=0.0,
        ge=-2,
        le=0.8,
        description="Water level of the day above `water_level_m`, metres; water and boat move by it, the "
        "ground stays",
    )
    flow_deg: Angle = Field(
        default=0.0, description="Mean direction of the flow, degrees from east, counter-clockwise"
    )
    meander_deg: float = Field(
        default=6.0,
        ge=0,
        le=20,
        description="Greatest angle between flow and valley (sine-generated curve), degrees",
    )
    meander_length_m: float = Field(
        default=240.0, ge=50, le=5000, description="Wavelength of the meander along the flow, metres"
    )
    shelf_width_m: float = Field(
        default=2.5,
        ge=0,
        le=20,
        description="Mean width of the shallow shelf along both shores, metres; wider on inner bends",
    )
    shelf_depth_m: float = Field(
        default=0.3, ge=0.02, le=2, description="Depth at the outer edge of the shelf, metres"
    )
    sections: tuple[tuple[Share, ...], ...] = Field(
        default=(),
        description="Cross-sections in place of shelf, thalweg and pools, evenly spaced down the reach: "
        "depths at even steps from the right to the left shore, as shares of `depth_m`",
    )
    embankment_height_m: float = Field(
        default=6.0, ge=1, le=30, description="Height of the right bank above the water, metres"
    )
    embankment_slope_deg: float = Field(
        default=33.0, ge=10, le=60, description="Slope of the right bank, degrees"
    )
    roughness_m: NonNegative = Field(
        default=0.06,
        le=1,
        description="Amplitude of the roughness of the banks, metres; half of it on the bed",
    )
    grid_m: float = Field(
        default=0.05,
        ge=0.02,
        le=2,
        description="Grid step of the terrain within a metre of the shores, metres; coarser further away",
    )
    weir: bool = Field(default=False, description="Whether a weir closes the reach")
    weir_place: float = Field(
        default=0.92,
        ge=-1,
        le=1,
        description="Where the weir stands, as a share of the half length; 1: lower end",
    )
    bridge: bool = Field(default=False, description="Whether a bridge crosses the river")
    bridge_place: float = Field(
        default=-0.35, ge=-1, le=1, description="Where the bridge stands, as a share of the half length"
    )
    railway: bool = Field(default=True, description="Whether a track lies on the embankment")
    water_fall_m_per_km: float = Field(
        default=0.0, ge=0, le=20, description="Fall of water and ground along the reach, metres a kilometre"
    )
    weeds_cover: Share = Field(default=0.0, description="Share of the bed on which weeds grow")
    weeds_height_m: Positive = Field(
        default=0.5, le=5, description="Greatest height of weeds above the bed, metres; they end under water"
    )
    stones_per_m: NonNegative = Field(
        default=20.0, le=100, description="Boulders of 0.2 to 0.8 m per metre of reach, most on the right toe"
    )
    cobbles_per_m: NonNegative = Field(
        default=100.0, le=2000, description="Stones of 3 to 10 cm along the water lines per metre of reach"
    )
    bushes_per_100m: NonNegative = Field(
        default=100.0, le=1000, description="Bushes on both banks per 100 m of reach"
    )
    trees_per_100m: NonNegative = Field(
        default=14.0,
        le=500,
        description="Trees on both banks per 100 m of reach; five times as many plain ones stand behind",
    )
    grass_per_m: NonNegative = Field(
        default=40.0, le=500, description="Tufts of grass on both banks per metre of reach"
    )
    reeds_per_m: NonNegative = Field(
        default=6.0, le=200, description="Stalks of reed in the margins per metre of reach"
    )
    leaves_per_bush: int = Field(
        default=600,
        ge=10,
        le=20000,
        description="Leaves of a bush of mean size; fewer leaves are larger ones",
    )
    leaves_per_tree: int = Field(
        default=5000,
        ge=10,
        le=100000,
        description="Leaves of a tree of mean size; fewer leaves are larger ones",
    )
    posts_per_100m: NonNegative = Field(
        default=12.0, le=1000, description="Posts on both banks per 100 m of reach"
    )
    buildings: int = Field(default=3, ge=0, le=50, description="Buildings behind the left bank")
    seed: Annotated[int, Field(ge=0, lt=2**31)] | None = Field(
        default=None,
        description="Seed of the river, for a second epoch with errors of its own; without it the campaign's",
    )
    changes: tuple[Change, ...] = Field(
        default=(),
        description="What this epoch has beside the plain river; all the rest is the same to the last bit",
    )
    retreat_m: float = Field(
        default=7.0,
        ge=0,
        le=15,
        description="Greatest retreat of the left bank by `undercut_bank` and of the right one by "
        "`bank_retreat`, metres (T 4.1: 7)",
    )

    @model_validator(mode="after")
    def _check_sections(self) -> Self:
        lengths = {len(each) for each in self.sections}
        if self.sections and (len(lengths) > 1 or min(lengths) < 3):
            raise ValueError(
                f"sections of {sorted(lengths)} depths; all of them have as many, three at least"
            )
        return self


class TwinBoat(Section):
    """True motion: zigzag between the banks, and the swaying of a small boat."""

    speed_mps: float = Field(default=0.4, gt=0, le=10, description="Speed over ground, m/s (P2: 0.4)")
    turn_rate_degps: float = Field(
        default=7.0,
        gt=0,
        le=60,
        description="Greatest turn rate of the course, degrees/s (P2: 7); yawing comes on top",
    )
    zigzag_deg: float = Field(
        default=50.0, ge=0, le=80, description="Angle between the legs of the zigzag and the flow, degrees"
    )
    pattern: Literal["zigzag", "sections"] = Field(
        default="zigzag", description="Course: `zigzag` between the banks, `sections` across the river"
    )
    line_spacing_m: Positive = Field(default=10.0, le=200, description="Distance of `sections`, metres")
    bank_distance_m: Positive = Field(
        default=6.0, le=100, description="Distance from the shores at which the boat turns, metres"
    )
    course_offset_m: float = Field(
        default=0.0,
        ge=-50,
        le=50,
        description="The course lies so far left of the middle of the river, metres; its zigzag is narrower "
        "by as much on both sides",
    )
    upstream: bool = Field(default=False, description="The boat sails against the flow")
    height_m: Positive = Field(
        default=0.2, le=5, description="Height of the INS above the water at rest, metres"
    )
    roll_deg: NonNegative = Field(default=1.5, le=20, description="Amplitude of roll, degrees")
    pitch_deg: NonNegative = Field(default=0.8, le=20, description="Amplitude of pitch, degrees")
    yaw_deg: NonNegative = Field(
        default=1.0, le=20, description="Amplitude of yawing about the course, degrees"
    )
    heave_m: NonNegative = Field(default=0.02, le=1, description="Amplitude of heave, metres")
    heel_share: NonNegative = Field(
        default=0.5,
        le=5,
        description="Heel in turns, outwards, as a share of speed times turn rate over gravity; 0: none",
    )


# ---------------------------------------------------------------- INS, GNSS receiver, echo sounder


class TwinIns(Section):
    """Advanced Navigation Spatial."""

    rate_hz: float = Field(default=50.0, ge=1, le=1000, description="Rate of the state packets, Hz")
    sigma_roll_deg: NonNegative = Field(default=0.1, le=10, description="Error of roll, degrees (T 2.2.1)")
    sigma_pitch_deg: NonNegative = Field(default=0.1, le=10, description="Error of pitch, degrees (T 2.2.1)")
    sigma_heading_deg: NonNegative = Field(
        default=0.2, le=45, description="Error of heading, degrees (T 2.2.1)"
    )
    attitude_time_s: Positive = Field(
        default=20.0, description="Correlation time of the attitude errors (Gauss-Markov), seconds"
    )
    sigma_position_m: Sigma3 = Field(
        default=(0.6, 0.6, 1.0), description="Error east, north, up of the INS's own position, metres (P1)"
    )
    position_time_s: Positive = Field(
        default=60.0, description="Correlation time of the position errors, seconds"
    )
    sigma_velocity_mps: NonNegative = Field(
        default=0.05,
        le=10,
        description="Error of the velocity north, east and down, m/s (data sheet of the Spatial)",
    )
    velocity_time_s: Positive = Field(
        default=10.0, description="Correlation time of the velocity errors (Gauss-Markov), seconds"
    )
    heading_drift_degpmin: Finite = Field(
        default=0.0, description="Drift of the heading on top of its error, degrees/min; not in the sigmas"
    )
    motor_field_mg: tuple[Vector3, Vector3] = Field(
        default=((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        description="Magnetic fields of the left and the right motor's current at the INS, at full thrust: "
        "forward, right, down, milligauss; 10 A in leads 2 cm apart make 4 mG at 0.3 m; not in the sigmas",
    )
    hard_iron_mg: Vector3 = Field(
        default=(0.0, 0.0, 0.0),
        description="Field fixed to the boat that the magnetic calibration has left: forward, right, down, "
        "milligauss; not in the sigmas",
    )
    magnetic_weight: Share = Field(
        default=1.0,
        description="How far the heading follows the magnetometer; 1: fully, a slow boat gets none from GNSS",
    )
    magnetic_time_s: Positive = Field(
        default=20.0, description="Time constant with which the filter follows its magnetometer, seconds"
    )


class TwinGnss(Section):
    """Multiband receiver: its own RTK solution (SBP) and a post-processed track (.pos)."""

    mode: Literal["ppk", "single_frequency"] = Field(
        default="ppk",
        description="`ppk`: carrier phases and a base (P2, T); `single_frequency`: code only, no base (P1)",
    )
    rate_hz: float = Field(default=10.0, ge=0.1, le=50, description="Rate of positions, Hz")
    base_km: Positive = Field(
        default=1.0,
        le=1000,
        description="Distance of the base, kilometres; its raw observations and the rover's are written for "
        "`position_source: ppk`",
    )
    sigma_m: Sigma3 = Field(
        default=(0.020, 0.020, 0.030), description="Total error east, north, up, metres (P2, T Table 3.1)"
    )
    white_share: Share = Field(
        default=0.25, description="Share of the error's variance that is new in each epoch"
    )
    correlation_time_s: Positive = Field(
        default=10.0, description="Correlation time of the rest (Gauss-Markov), seconds"
    )
    sigma_float_m: Positive = Field(
        default=0.3, description="Error east and north of float solutions, metres; up is 1.5 times that"
    )
    sigma_single_m: Sigma3 = Field(
        default=(0.6, 0.6, 1.0), description="Error east, north, up of code solutions, metres (P1)"
    )
    single_time_s: Positive = Field(
        default=100.0, description="Correlation time of code solutions (Gauss-Markov), seconds"
    )
    sigma_velocity_mps: NonNegative = Field(
        default=0.03,
        le=10,
        description="Noise of the receiver's Doppler velocity north, east and down, m/s; new in each epoch",
    )
    shadow: bool = Field(
        default=False,
        description="Leaves dim satellites; banks, walls, trunks and bridges hide them. Solutions become "
        "float, single or none, errors and sigmas grow with the dilution of precision",
    )
    mask_deg: float = Field(
        default=10.0, ge=0, le=60, description="Elevation below which satellites are not used, degrees"
    )
    refix_s: NonNegative = Field(
        default=10.0, le=600, description="Time to fix ambiguities again when the sky is free again, seconds"
    )
    multipath_m: NonNegative = Field(
        default=0.0,
        le=10,
        description="Sigma of an extra error if all satellites were dimmed, metres; in proportion to their "
        "share; not in the sigmas. Below 0.05 for carrier phases, metres for code",
    )
    multipath_time_s: Positive = Field(
        default=5.0, description="Correlation time of the multipath error (Gauss-Markov), seconds"
    )


class TwinEcho(Section):
    """Single-beam echo sounder."""

    rate_hz: float = Field(default=10.0, gt=0, le=50, description="Soundings per second")
    sigma_m: NonNegative = Field(default=0.02, le=1, description="Noise of the depth, metres")
    offset_m: Finite = Field(default=0.1, description="Offset in DPT: transducer to water line, metres")
    beam_deg: float = Field(
        default=0.0,
        ge=0,
        le=60,
        description="Full opening angle of the beam, first return in it; degrees; 0: a ray",
    )
    boulders: bool = Field(
        default=False,
        description="All that is firm returns the sound, boulders and sills too; false: the bed alone",
    )
    tilt_deg: tuple[Finite, Finite] = Field(
        default=(0.0, 0.0),
        description="True direction of the beam against the body's down axis, forward and right, degrees",
    )
    latency_s: float = Field(
        default=0.0,
        ge=0,
        le=2,
        description="How much later than its ping a depth is stamped, without the filters; seconds",
    )
    water_temperature_c: float = Field(
        default=10.0, ge=0, le=40, description="True temperature of the water, degrees Celsius"
    )
    assumed_sound_speed_mps: Annotated[float, Field(ge=1000, le=2000)] | None = Field(
        default=None,
        description="Speed of sound that the instrument computes with, m/s; null: that of the water",
    )
    dead_zone_m: NonNegative = Field(
        default=0.0,
        le=5,
        description="Smaller depths are lost or come out doubled, half of them each, metres; 0: none",
    )
    second_echo_share: Share = Field(
        default=0.0, description="Share of pings that give the echo that went over the surface once more"
    )
    spike_share: Share = Field(default=0.0, description="Share of pings that give any depth")
    no_bottom_share: Share = Field(default=0.0, description="Share of pings that give none")
    turn_dropout_share: Share = Field(
        default=0.0,
        description="Share of pings that give none while the boat turns faster than half its greatest rate",
    )
    weed_share: Share = Field(
        default=0.0, description="Share of pings over weeds (`scene.weeds_cover`) that return from them"
    )
    zeros: bool = Field(
        default=False, description="A ping without bottom is written as depth 0; false: nothing is written"
    )
    median_pings: int = Field(
        default=1, ge=1, le=21, description="The instrument's running median over its last pings; 1: none"
    )
    temperature_sentences: bool = Field(
        default=False, description="Temperature of the water once a second (MTW)"
    )
    tilt_sentences: bool = Field(
        default=False, description="The transducer's own pitch and roll once a second (XDR)"
    )
    bed_survey: bool = Field(
        default=False, description="Points of the bed are surveyed with an RTK pole in shallow water"
    )
    sigma_bed_m: float = Field(
        default=0.02, gt=0, le=1, description="Error of a surveyed point in each coordinate, metres"
    )
    sigma_bed_datum_m: NonNegative = Field(
        default=0.005, le=1, description="Common error of the heights of all surveyed points, metres"
    )


class TwinUav(Section):
    """Cloud of the surroundings from pictures of a drone."""

    spacing_m: float = Field(default=0.25, ge=0.05, le=5, description="Mean distance of its points, metres")
    reach_m: float = Field(
        default=40.0, gt=0, le=60, description="How far it reaches behind the mean shores, metres"
    )
    sigma_m: NonNegative = Field(
        default=0.03, le=1, description="Noise of heights on firm ground, half of it in position, metres"
    )
    sigma_shift_m: Sigma3 = Field(
        default=(0.03, 0.03, 0.05), description="Shift of the whole cloud east, north, up, metres"
    )
    crown_share: Share = Field(
        default=0.3, description="Share of the places in crowns that give a point; below them none do"
    )
    sigma_crown_m: NonNegative = Field(default=0.25, le=5, description="Noise of heights in crowns, metres")


# ---------------------------------------------------------------- laser scanners


Cells = Annotated[int, Field(ge=1, le=16)]
"""Number of sub-rays of a beam."""


class EchoFaults(Section):
    """What any laser scanner makes of the light that comes back."""

    mixed_pixels: bool = Field(
        default=True,
        description="Beams that meet two near surfaces return a range between them; "
        "false: that of the brightest part",
    )
    dark_dropouts: bool = Field(
        default=True,
        description="Echoes that are too weak for their range are lost, those near the limit by chance",
    )
    wet_band_m: NonNegative = Field(
        default=0.1, le=2, description="Ground is wet up to this height above the water, metres"
    )


class TwinLidar(EchoFaults):
    """Velodyne VLP-16."""

    returns: Literal["strongest", "last", "dual"] = Field(default="strongest", description="Return mode")
    sigma_range_m: NonNegative = Field(
        default=0.0173, le=1, description="Noise of the range, metres (3 cm / sqrt 3, P2 eq. 7)"
    )
    sigma_lateral_m: NonNegative = Field(
        default=0.0173, le=1, description="Offset of the beam in each of two directions across it, metres"
    )
    sigma_weak_m: NonNegative = Field(
        default=0.03,
        le=1,
        description="Further noise of the weakest echo, a 10 % target at 100 m; goes with range squared over "
        "reflectance times cosine of incidence; metres",
    )
    divergence_mrad: NonNegative = Field(
        default=3.0, le=20, description="Full divergence of the beam, milliradians; 0: no footprint"
    )
    speckle_cells: Cells = Field(
        default=3, description="Parts of the footprint that shine independently of each other (speckle)"
    )
    max_range_m: float = Field(default=100.0, gt=0, le=130, description="Longest range with a return, metres")
    dropouts: Share = Field(
        default=0.005, description="Share of all shots except those on water that are lost by chance"
    )
    water_returns: Share = Field(
        default=0.05, description="Share of shots straight down on water that return; none at grazing angles"
    )
    wet_reflectance: Share = Field(
        default=0.5, description="Reflectance of wet ground relative to dry; 1: no effect"
    )
    mirror_ghosts: bool = Field(
        default=True, description="Water mirrors beams onto the bank, which then appears below the water"
    )
    wave_slope: float = Field(
        default=0.03,
        ge=0,
        le=0.3,
        description="Rms slope of the waves that mirror the beams; 0: a flat mirror",
    )
    own_hull: bool = Field(
        default=True, description="The boat is in the way of beams and returns some of them"
    )
    vertical_offsets: bool = Field(
        default=True,
        description="Lasers leave at the heights of the manual's table; false: all at the centre",
    )
    host_delay_s: NonNegative = Field(
        default=0.0003,
        le=0.1,
        description="Mean delay from a packet's arrival to the recording computer's stamp (exponential), "
        "seconds; 0: none",
    )
    nanoseconds: bool = Field(default=False, description="Capture file with nanosecond stamps")


class TwinTls(EchoFaults):
    """Terrestrial laser scans of the right bank from stations on the left bank: Riegl VZ-400i (P2 5.1)."""

    spacing_m: float = Field(
        default=0.025, ge=0.005, le=1, description="Point spacing on the right shore across the beam, metres"
    )
    sigma_50m_m: NonNegative = Field(
        default=0.003,
        le=1,
        description="3D error at 50 m distance, metres; the part that grows with distance "
        "and the floor together",
    )
    sigma_floor_m: NonNegative = Field(
        default=0.001,
        le=1,
        description="Part of the 3D error that is the same at each distance, metres; at most sigma_50m_m",
    )
    sigma_station_m: NonNegative = Field(
        default=0.0, le=1, description="Error of each station's position per axis, metres"
    )
    divergence_mrad: NonNegative = Field(
        default=0.3, le=20, description="Full divergence of the beam, milliradians; 0: no footprint"
    )
    speckle_cells: Cells = Field(
        default=2, description="Parts of the footprint that shine independently of each other (speckle)"
    )
    wavelength_nm: Literal[905, 1550] = Field(
        default=1550, description="Wavelength, nanometres: leaves and wet ground are darker at 1550"
    )
    max_range_m: float = Field(
        default=250.0, gt=0, le=1000, description="Longest range with a return, metres"
    )
    dropouts: Share = Field(default=0.0, description="Share of all other shots that are lost by chance")
    wet_reflectance: Share = Field(
        default=0.3, description="Reflectance of wet ground relative to dry; 1: no effect"
    )
    coordinates: Literal["map", "local"] = Field(
        default="map", description="Coordinates in the files: grid of campaign.crs, or the local frame"
    )

    @model_validator(mode="after")
    def _check_floor(self) -> Self:
        if self.sigma_floor_m > self.sigma_50m_m:
            raise ValueError(
                f"sigma_floor_m {self.sigma_floor_m} is larger than sigma_50m_m {self.sigma_50m_m}, of which "
                "it is a part: lower it, to 0 for scans without noise"
            )
        return self


# ---------------------------------------------------------------- cameras


Side = Annotated[int, Field(ge=16, le=10_000)]
"""Pixels along a side of an image."""


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
    field_of_view_deg: float = Field(
        default=190.0,
        gt=0,
        le=360,
        description="Full angle of the image circle of a fisheye lens, degrees; other lenses have none",
    )
    sharpness_px: float = Field(
        default=0.65,
        ge=0,
        le=10,
        description="Sigma of the Gaussian point spread function, pixels; 0: as sharp as the pixel",
    )
    noise: float = Field(
        default=1.6, ge=0, le=50, description="Sensor noise of a middle grey, steps of 8 bits; 0: none"
    )

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
    n_images: int = Field(
        default=36,
        ge=4,
        le=500,
        description="Images of the tour around the field; the two of the boat come on top",
    )
    heights_m: tuple[Positive, Positive] = Field(
        default=(0.9, 2.1), description="Two heights of the camera above the ground, in turn, metres"
    )
    rolled: Share = Field(
        default=0.25, description="Share of the images taken with the camera turned by 90 degrees"
    )


class TwinDisplay(Section):
    """Photographs of a running clock: the test of the camera's clock (P2 6.1.2)."""

    duration_s: float = Field(default=5400.0, ge=2, le=86_400, description="Length of the test, seconds")
    interval_mean_s: float = Field(
        default=0.999, ge=0.1, le=60, description="Mean time between two photographs, seconds"
    )
    rate_hz: float = Field(default=100.0, gt=0, le=1000, description="Rate at which the display counts, Hz")
    digits: Literal["segments", "font"] = Field(
        default="font",
        description="Look of the digits: seven segments that shine, or a font on a light window",
    )
    size_px: tuple[Side, Side] = Field(
        default=(320, 120), description="Width and height of a photograph, pixels"
    )
    exposure_s: float = Field(
        default=0.004,
        gt=0,
        le=0.1,
        description="Exposure: where the display changes in it, two numbers lie over each other; seconds",
    )
    glare: Share = Field(
        default=0.5, description="Strength of a reflex of the sun that wanders over the display; 0: none"
    )
    blur_px: float = Field(
        default=0.9, ge=0, le=10, description="Sigma of the blur of a good photograph, pixels"
    )
    noise: float = Field(default=3.0, ge=0, le=50, description="Image noise, steps of 8 bits")
    unreadable: Share = Field(
        default=0.02,
        description="Share of photographs spoiled by chance: shaken, out of focus, covered, burnt out",
    )


class TwinCamera(TwinLens):
    """The boat's camera and its clock, the reflex camera and the display test."""

    rate_hz: float = Field(default=1.0, gt=0, le=60, description="Images per second")
    clock_offset_s: Finite = Field(
        default=2.3471, description="Reading of the camera's clock minus UTC at the begin of the run, seconds"
    )
    clock_drift_ppm: float = Field(
        default=12.0,
        ge=-1000,
        le=1000,
        description="Rate of the camera's clock minus that of UTC, parts per million",
    )
    jitter_s: float = Field(
        default=0.023,
        ge=0,
        le=1,
        description="Standard deviation of the true exposure about its stamp, seconds (P2 6.1.2)",
    )
    exposure_s: float = Field(
        default=0.0008,
        ge=0,
        le=0.1,
        description="Exposure: the moving boat smears its images by as much; seconds",
    )
    reference: TwinReference = Field(
        default=TwinReference(), description="Reflex camera for the reference of the calibration field"
    )
    display: TwinDisplay = Field(default=TwinDisplay(), description="Clock test with a running display")


# ---------------------------------------------------------------- time-lapse images


Images = Annotated[int, Field(ge=0, le=10_000)]
"""A number of images."""


class TwinTimeLapse(Section):
    """Time-lapse images along the voyage and the targets of the control points."""

    size_px: tuple[Side, Side] = Field(
        default=(720, 540),
        description="Width and height of an image, pixels; the camera's lens with larger or smaller pixels",
    )
    rate_hz: float = Field(default=1.0, gt=0, le=60, description="Images per second")
    share: Share = Field(
        default=1.0, description="Share of the voyage that images are taken of, from its begin"
    )
    supersampling: int = Field(
        default=2,
        ge=1,
        le=4,
        description="Rays along each side of a pixel where something ends in it; 1: one ray a pixel, jagged",
    )
    side: Literal["seen", "left", "right"] = Field(
        default="seen",
        description="Bank of the control points, looking downstream; `seen`: the one that the camera sees",
    )
    n_targets: int = Field(
        default=12, ge=0, le=200, description="Targets on the bank; every third is a check point"
    )
    target_size_m: float = Field(
        default=0.6,
        ge=0.05,
        le=3,
        description="Side of a target, a square board with a 2 by 2 checker, metres",
    )
    sigma_target_m: Sigma3 = Field(
        default=(0.005, 0.005, 0.008),
        description="Standard deviations of the survey of the targets (RTK): east, north, up, metres",
    )
    least_images: int = Field(
        default=3, ge=1, le=1000, description="Images that each target must be seen in, free and large enough"
    )


# ---------------------------------------------------------------- dual fisheye


class TwinDualFisheye(Section):
    """A camera with two fisheye lenses: its true geometry and clock, its pictures of survey and field.

    With ``lens: perspective`` they are two synchronised perspective cameras back to back (T 2.2.3).

    Defaults: a Ricoh Theta S as two calibrations published it (base 19.36 mm, axes 179.776 degrees apart),
    and as its front lens was measured from the corners of 23 boards.
    """

    lens: Literal["fisheye", "perspective"] = Field(
        default="fisheye", description="Kind of both lenses; a perspective one fills its square"
    )
    circle_px: Side = Field(
        default=640, description="Side of the square of an image circle; a file holds two of them, pixels"
    )
    focal_px: Positive = Field(default=190.9, description="Camera constant of the front lens, pixels")
    principal_offset_px: tuple[Finite, Finite] = Field(
        default=(1.5, -0.3),
        description="Principal point of the front lens minus middle of its square, pixels; that of the back "
        "lens is the opposite",
    )
    distortion: tuple[Finite, Finite, Finite, Finite] = Field(
        default=(-0.0286, 0.0232, -0.0095, 0.0006),
        description="k1, k2, k3, k4 of both lenses, of perspective ones k1, k2, p1, p2; no unit",
    )
    field_of_view_deg: float = Field(
        default=202.0, gt=10, lt=300, description="Full angle of the image circles, degrees"
    )
    base_m: Positive = Field(default=0.0194, le=1, description="Distance of the projection centres, metres")
    axes_deg: float = Field(
        default=179.8, ge=170, le=180, description="Angle between the views of both lenses, degrees"
    )
    vignetting: Share = Field(default=0.25, description="Light that is missing at the rim of the circles")
    sharpness_px: float = Field(
        default=0.6, ge=0, le=10, description="Sigma of the Gaussian point spread function, pixels"
    )
    noise: float = Field(
        default=1.6, ge=0, le=50, description="Sensor noise of a middle grey, steps of 8 bits; 0: none"
    )
    glare: bool = Field(default=False, description="The sun's disc and its glow in sky and water")
    rate_hz: float = Field(default=1.0, gt=0, le=10, description="Exposures per second")
    images: int = Field(
        default=3, ge=1, le=10_000, description="Exposures of the survey, the middle one at half time"
    )
    zone: str = Field(
        default="+02:00", pattern=r"^[+-]\d{2}:\d{2}$", description="Zone of the local time in the names"
    )
    clock_offset_s: Finite = Field(
        default=-0.612, description="Reading of the clock minus UTC at the begin of the survey, seconds"
    )
    clock_drift_ppm: float = Field(
        default=-8.0, ge=-1000, le=1000, description="Rate of the clock minus that of UTC, parts per million"
    )
    jitter_s: float = Field(
        default=0.01,
        ge=0,
        le=1,
        description="Standard deviation of the true exposure about its stamp, seconds",
    )
    field_images: int = Field(
        default=12, ge=3, le=200, description="Exposures amid the field of the calibration"
    )
    sigma_field_m: NonNegative = Field(
        default=0.0002,
        le=0.1,
        description="Standard deviation of each coordinate of the field's marks, metres",
    )
    supersampling: int = Field(
        default=2, ge=1, le=4, description="Rays along each side of a pixel where something ends in it"
    )
    hull: bool = Field(default=True, description="The own boat in view")


# ---------------------------------------------------------------- section ``twin``


Size = Literal["tiny", "demo", "mulde", "reach", "field", "field_tiny", "basin", "basin_tiny"]
Stream = Literal["lidar", "ins", "gnss", "echo"]


def _utc_text(text: str) -> str:
    try:
        moment = dt.datetime.fromisoformat(text)
    except ValueError:
        moment = None
    if moment is None or moment.tzinfo is None or moment.utcoffset() != dt.timedelta(0):
        raise ValueError("not a UTC time such as 2021-05-12T08:31:07Z")
    return text


UtcText = Annotated[str, AfterValidator(_utc_text)]


class TwinEffects(Section):
    """Named defects of logs; all off unless switched on. Positions in the logs are drawn from the seed."""

    lost_packets: Share = Field(default=0.0, description="Share of lidar packets that are missing")
    lost_burst: int = Field(default=5, ge=1, le=10000, description="Lidar packets that are lost at a time")
    duplicate_packets: Count = Field(default=0, description="Lidar packets that are captured twice")
    swapped_packets: Count = Field(default=0, description="Pairs of lidar packets in wrong order")
    corrupt_bytes: Count = Field(default=0, description="Bytes replaced by chance in each damaged stream")
    cut_end_bytes: Count = Field(default=0, description="Bytes cut from the end of each damaged stream")
    damaged_streams: tuple[Stream, ...] = Field(
        default=("lidar", "ins", "gnss", "echo"),
        description="Streams that corrupt_bytes and cut_end_bytes act on",
    )
    pps_late_s: NonNegative = Field(
        default=0.0, description="Time until the lidar has PPS and RMC; its clock runs freely before, seconds"
    )
    ins_clock_late_s: NonNegative = Field(
        default=0.0, description="Time until the INS knows UTC; it counts from 1970 before, seconds"
    )
    gnss_outages: tuple[tuple[NonNegative, Positive], ...] = Field(
        default=(), description="Outages of GNSS: begin after the start and length, seconds"
    )
    gnss_floats: tuple[tuple[NonNegative, Positive], ...] = Field(
        default=(), description="Times with float solutions only: begin after the start and length, seconds"
    )
    mount_errors: bool = Field(
        default=True, description="Sensors sit off the campaign's mounts by errors of the stated sigmas"
    )
    misstated: bool = Field(
        default=False,
        description="Instruments err otherwise than their logs and the defaults state: in sizes, "
        "correlation times, shares and the beam by factors from 1/2 to 2, drawn from the seed; "
        "false: known errors",
    )


SIZES: Final[Mapping[str, Mapping[str, Any]]] = {
    "tiny": {
        # 12 s before a full hour: the lidar's time of the hour rolls over inside the log.
        "start_utc": "2021-05-12T08:59:48Z",
        "duration_s": 25.0,
        "scene": {
            "length_m": 130.0,
            "width_m": 22.0,
            "depth_m": 1.6,
            "embankment_height_m": 4.0,
            "grid_m": 0.1,
            "shelf_width_m": 1.5,
            "stones_per_m": 8.0,
            "cobbles_per_m": 30.0,
            "bushes_per_100m": 30.0,
            "trees_per_100m": 9.0,
            "grass_per_m": 12.0,
            "reeds_per_m": 3.0,
            "leaves_per_bush": 300,
            "leaves_per_tree": 1500,
            "buildings": 1,
        },
        "boat": {"speed_mps": 2.4, "turn_rate_degps": 24.0, "zigzag_deg": 50.0, "bank_distance_m": 5.0},
        "tls": {"spacing_m": 0.05},
        # Short correlation: 25 s then hold enough independent errors to compare them with their sigmas.
        "ins": {"attitude_time_s": 1.0},
        "gnss": {"correlation_time_s": 1.0},
    },
    # Under the bridge the receiver loses its fix: a gap that is meant to be seen.
    "demo": {
        "duration_s": 180.0,
        "scene": {"weir": True, "bridge": True, "bridge_place": 0.3},
        "boat": {"speed_mps": 1.2},
        "gnss": {"shadow": True},
        "camera": {"size_px": (1600, 1200), "focal_px": 1295.0, "principal_offset_px": (4.4, -2.9)},
    },
    "mulde": {
        "duration_s": 1025.0,
        "scene": {"length_m": 370.0, "leaves_per_bush": 550, "leaves_per_tree": 4500, "buildings": 4},
        "boat": {"speed_mps": 0.4},
        "gnss": {"shadow": True},
    },
    # P1: the weir stands in the west, so the river flows there; its pool is the deep water beside it. At this
    # speed about 75 million shots of the lidar meet something else than water.
    "reach": {
        "duration_s": 4150.0,
        "scene": {
            "length_m": 1640.0,
            "flow_deg": 180.0,
            "meander_deg": 9.0,
            "meander_length_m": 520.0,
            "grid_m": 0.1,
            "weir": True,
            "weir_place": 0.97,
            "bridge": True,
            "stones_per_m": 7.0,
            "cobbles_per_m": 20.0,
            "bushes_per_100m": 60.0,
            "trees_per_100m": 14.0,
            "grass_per_m": 14.0,
            "reeds_per_m": 3.0,
            "leaves_per_bush": 300,
            "leaves_per_tree": 1600,
            "buildings": 14,
        },
        "boat": {"speed_mps": 0.518},
        "gnss": {"mode": "single_frequency", "shadow": True},
    },
    # Calibration on land: the boat is moved about by hand on a trolley. A third of the Panasonic's pixels
    # along a side are enough: the static camera is placed to 0.2 mm.
    "field": {
        "start_utc": "2021-05-11T13:02:11Z",
        "duration_s": 150.0,
        "field": {"tour": "planned"},
        "camera": {
            "size_px": (1600, 1200),
            "focal_px": 1295.0,
            "principal_offset_px": (4.4, -2.9),
            "reference": {
                "n_images": 35,
                "size_px": (2100, 1400),
                "focal_px": 1645.0,
                "principal_offset_px": (-6.1, 3.6),
            },
        },
    },
    # As many markers and cones, so that every method works, but a short run and half the pixels of `field`.
    "field_tiny": {
        "start_utc": "2021-05-11T13:02:11Z",
        "duration_s": 40.0,
        "field": {"position_s": 2.0},
        "camera": {
            "size_px": (1120, 840),
            "focal_px": 906.5,
            "principal_offset_px": (3.1, -2.0),
            "reference": {
                "n_images": 28,
                "size_px": (1470, 980),
                "focal_px": 1151.5,
                "principal_offset_px": (-4.3, 2.5),
            },
            "display": {"duration_s": 120.0},
        },
        "ins": {"attitude_time_s": 1.0},
        "gnss": {"correlation_time_s": 1.0},
    },
    "basin": {"light_sheet": {"size": "demo"}},
    "basin_tiny": {
        "light_sheet": {"size": "tiny", "scan_lines": 12, "scan_step_mm": 6.0, "reference_mm": 2.0}
    },
}
"""What the sizes change against the defaults."""


class TwinConfig(Section):
    """The digital twin: river or calibration field, boat, sensors and defects."""

    size: Size = Field(
        default="demo",
        description="Set of values: `tiny` 25 s for tests, `demo` 3 min, `mulde` 17 min as in P2, "
        "`reach` 1.5 km as in P1, `field` a calibration field on land with a run of 2.5 min, `field_tiny` "
        "the same with a run of 40 s, `basin` the underwater light-sheet sensor in the laboratory, "
        "`basin_tiny` the same with small images",
    )
    start_utc: UtcText = Field(
        default="2021-05-12T08:31:07Z", description="Begin of the lidar log, UTC, as 2021-05-12T08:31:07Z"
    )
    duration_s: float = Field(
        default=180.0,
        ge=1,
        le=7200,
        description="Length of the lidar log, seconds; the others begin and end 2 s outside it",
    )
    scene: TwinScene = Field(default=TwinScene(), description="River reach")
    boat: TwinBoat = Field(default=TwinBoat(), description="True motion of the boat")
    lidar: TwinLidar = Field(default=TwinLidar(), description="Mobile lidar")
    ins: TwinIns = Field(default=TwinIns(), description="Inertial navigation system")
    gnss: TwinGnss = Field(default=TwinGnss(), description="GNSS receiver")
    echo: TwinEcho = Field(default=TwinEcho(), description="Echo sounder")
    tls: TwinTls = Field(default=TwinTls(), description="Reference scans")
    uav: TwinUav | None = Field(
        default=None, description="Cloud of the surroundings by a drone; null: there is none"
    )
    camera: TwinCamera = Field(default=TwinCamera(), description="Cameras and the camera's clock")
    field: TwinField | None = Field(
        default=None, description="Calibration field on land; null: the boat sails on a river"
    )
    time_lapse: TwinTimeLapse | None = Field(
        default=None,
        description="Images of the bank along the voyage, and control points; null: the camera takes none",
    )
    dual_fisheye: TwinDualFisheye | None = Field(
        default=None, description="Camera with two fisheye lenses on the boat; null: there is none"
    )
    light_sheet: TwinLightSheet | None = Field(
        default=None, description="Underwater light-sheet sensor in a basin; null: there is none"
    )
    light_sheet_strip: TwinSheetStrip | None = Field(
        default=None,
        description="Strip of the bed by the light-sheet sensor on the boat, whose calibration "
        "`light_sheet.sensor` names; null: the boat has none",
    )
    effects: TwinEffects = Field(default=TwinEffects(), description="Defects of the logs")

    @model_validator(mode="before")
    @classmethod
    def _fill_from_size(cls, data: Any) -> Any:
        """Values of the size where the campaign file gives none."""
        if not isinstance(data, Mapping):
            return data
        size = data.get("size", "demo")
        known = isinstance(size, str) and size in SIZES
        return _with_tuples(_merge(SIZES[size], data) if known else data)

    @classmethod
    def of_size(cls, size: Size, **changes: Any) -> Self:
        """The twin of a size, with changes given as nested plain values.

        Examples
        --------
        >>> TwinConfig.of_size("tiny", lidar={"returns": "dual"}).lidar.returns
        'dual'
        """
        return cls.model_validate({"size": size, **changes})


def _merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        both = isinstance(value, Mapping) and isinstance(below, Mapping)
        merged[key] = _merge(below, value) if both else value  # type: ignore[arg-type]
    return merged


def _with_tuples(value: Any) -> Any:
    # What a validator hands back counts as Python data: in strict mode a list is no tuple there.
    if isinstance(value, Mapping):
        return {key: _with_tuples(item) for key, item in value.items()}
    return tuple(_with_tuples(item) for item in value) if isinstance(value, list) else value
