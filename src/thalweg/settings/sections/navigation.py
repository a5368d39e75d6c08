"""Sections ``ins``, ``ppk``, ``orientation`` and ``fused``: from INS, GNSS and images to trajectories."""

from typing import Annotated, Literal

from pydantic import Field

from thalweg.settings.sections.base import Finite, NonNegative, Positive, Section, Sigma3

# ---------------------------------------------------------------- INS, GNSS, trajectory


SigmaAttitude = Annotated[float, Field(gt=0, le=45, allow_inf_nan=False)]
Fix = Literal["fixed", "float", "sbas", "dgnss", "single", "ppp", "omnistar", "dead_reckoning"]
GnssSystem = Literal["GPS", "GLO", "GAL", "QZS", "BDS", "SBS"]
PositionSource = Literal["pos", "sbp", "ppk", "nmea", "gpx", "sbet", "ins"]


class Ins(Section):
    """Accuracy of the INS, where its log states none, and what a table of poses does not state."""

    sigma_roll_deg: SigmaAttitude = Field(
        default=0.1,
        description="Standard deviation of roll, degrees (Advanced Navigation Spatial, T 2.2.1); to within "
        "`orientation.error_model.spread`, as those below",
    )
    sigma_pitch_deg: SigmaAttitude = Field(
        default=0.1, description="Standard deviation of pitch, degrees (Advanced Navigation Spatial, T 2.2.1)"
    )
    sigma_heading_deg: SigmaAttitude = Field(
        default=0.2,
        description="Standard deviation of heading, degrees (Advanced Navigation Spatial, T 2.2.1)",
    )
    sigma_position_m: Sigma3 | None = Field(
        default=None,
        description="Standard deviations east, north, up of positions from `ins` or `sbet` whose log states "
        "none, metres",
    )
    body_axes: Literal["forward-right-down", "forward-left-up", "right-down-forward"] | None = Field(
        default=None,
        description="Body axes x-y-z of a table of poses in `logs.ins` (TUM, EuRoC), whose frame is that of "
        "`campaign.origin`, x east, y north, z up",
    )
    time_scale: Literal["utc", "gps"] | None = Field(
        default=None, description="Stamps of such a table: `utc` Unix time, `gps` seconds since 1980-01-06"
    )
    upside_down: bool = Field(
        default=False,
        description="The INS is mounted upside down; else poses that are so throughout are refused",
    )


class Ppk(Section):
    """Post-processing of raw GNSS with RTKLIB; used if `orientation.position_source` is `ppk`."""

    elevation_mask_deg: float = Field(
        default=15.0, ge=0, le=60, allow_inf_nan=False, description="Satellites below are left out, degrees"
    )
    systems: Annotated[tuple[GnssSystem, ...], Field(min_length=1)] | Literal["auto"] = Field(
        default="auto",
        description="Satellite systems; `auto`: of GPS, Galileo and QZSS those that both logs hold",
    )
    frequencies: Literal["l1", "l1+l2", "l1+l2+l5", "l1+l2+l5+l6"] = Field(
        default="l1+l2", description="Carrier frequencies; Galileo's E5b counts as l2"
    )
    ambiguity: Literal["continuous", "fix-and-hold", "instantaneous", "off"] = Field(
        default="continuous",
        description="Ambiguity resolution; `instantaneous` fixed nothing on two real recordings",
    )
    fix_glonass: bool = Field(
        default=False, description="Resolve ambiguities of GLONASS too (receivers of the same make)"
    )
    fix_beidou: bool = Field(default=False, description="Resolve ambiguities of BeiDou too")
    direction: Literal["forward", "backward", "combined"] = Field(
        default="forward", description="Direction of the filter through the log"
    )
    ratio_threshold: float = Field(
        default=3.0,
        ge=1,
        lt=1000,
        allow_inf_nan=False,
        description="Ratio test: second-best over best residual needed for a fix",
    )
    iono: Literal["off", "brdc", "dual-freq", "est-stec"] = Field(
        default="brdc", description="Model of the ionosphere, in RTKLIB's words"
    )
    tropo: Literal["off", "saas", "est-ztd", "est-ztdgrad"] = Field(
        default="saas", description="Model of the troposphere, in RTKLIB's words"
    )
    dynamics: bool = Field(default=False, description="Estimate velocity and acceleration in the filter")
    max_age_s: float = Field(
        default=30.0,
        gt=0,
        le=3600,
        allow_inf_nan=False,
        description="Older base observations are not used, seconds",
    )
    trusted_baseline_km: Positive = Field(
        default=20.0,
        le=1000,
        description="Ambiguity fixes over a longer baseline count as float: the atmosphere differs too much, "
        "kilometres",
    )
    least_fix_s: NonNegative = Field(
        default=5.0, le=600, description="Runs of fixed epochs that are shorter count as float, seconds"
    )


class ErrorModel(Section):
    """How the poses of INS and GNSS err: what is presumed, and how far the survey may correct it."""

    estimate: bool = Field(
        default=True,
        description="Sizes and correlation times of the errors are estimated from surfaces that the lidar "
        "saw again; what is stated is prior knowledge. `false`: it is taken as certain",
    )
    spread: float = Field(
        default=2.0,
        gt=1,
        le=10,
        description="Stated sigmas may be wrong by this factor (one sigma of its logarithm)",
    )
    time_spread: float = Field(
        default=3.0, gt=1, le=20, description="The correlation times below may be wrong by this factor"
    )
    position_time_s: Positive = Field(
        default=10.0,
        le=3600,
        description="Correlation time of the positions' slow errors, seconds; presumed, no data sheet has it",
    )
    attitude_time_s: Positive = Field(
        default=20.0,
        le=3600,
        description="Correlation time of the attitude errors, seconds; presumed, no data sheet has it",
    )
    white_share: float = Field(
        default=0.25,
        ge=0.01,
        le=0.99,
        description="Share of the positions' variance that is new in each epoch; presumed, no data sheet has "
        "it; as wide as sizes",
    )


class Orientation(Section):
    """How positions and attitudes are joined into the trajectory."""

    position_source: PositionSource = Field(
        default="pos",
        description="Positions from: `pos` RTKLIB files, `sbp` the receiver's own solution, `ppk` raw GNSS, "
        "`nmea` NMEA 0183 (`logs.positions`, else the log of the echo sounder), `gpx` a track, "
        "`sbet` Applanix trajectory, `ins` the INS's own filter",
    )
    accept_fixes: Annotated[tuple[Fix, ...], Field(min_length=1)] | Literal["auto"] = Field(
        default=("fixed",),
        description="Kinds of GNSS solution that may enter the trajectory; `auto`: fixed ones, and float "
        "ones where these leave a hole longer than `max_gap_s`: beyond `ppk.trusted_baseline_km` all",
    )
    interpolation: Literal["cubic", "ins_velocity"] = Field(
        default="cubic",
        description="Positions between epochs: `cubic` spline, or along the velocity of the INS, which keeps "
        "motion that is faster than the epochs",
    )
    max_gap_s: Positive = Field(
        default=1.0, le=60, description="Longest hole between positions that is interpolated, seconds"
    )
    max_attitude_gap_s: Positive = Field(
        default=0.1,
        le=10,
        description="Longest hole between INS states that is interpolated, seconds; turning evenly is "
        "assumed across it, and what that misses is in no sigma",
    )
    sigma_position_m: Sigma3 | None = Field(
        default=None,
        description="Standard deviations east, north, up of positions whose log states none (`gpx`, `nmea` "
        "without GST), metres",
    )
    antenna_h_ell_m: Finite | None = Field(
        default=None,
        description="Ellipsoidal height of the antenna, for logs whose positions have none (NMEA GLL, RMC, "
        "GPX), metres: that of the water level and the antenna above it",
    )
    sigma_level_deg: SigmaAttitude = Field(
        default=3.0, description="Without an INS the boat counts as level to this standard deviation, degrees"
    )
    sigma_course_deg: SigmaAttitude = Field(
        default=10.0,
        description="Without an INS it heads along its course to this standard deviation, degrees",
    )
    error_model: ErrorModel = Field(
        default=ErrorModel(), description="How the poses err, and what the survey says of that"
    )


# ---------------------------------------------------------------- all sensors together


FixedError = Literal[
    "sigma_velocity_mps",
    "velocity_time_s",
    "sigma_acceleration",
    "attitude_time_s",
    "heading_disturbance_deg",
    "gnss_time_s",
    "gnss_white_share",
    "sigma_jitter_s",
]
"""What `estimate_errors` may leave as it is stated."""


class Fused(Section):
    """How INS, antenna positions and image poses are joined, and how each of them errs."""

    accept_fixes: tuple[Fix, ...] = Field(
        default=("fixed", "float"),
        min_length=1,
        description="Kinds of GNSS solution that may enter; each weighs as its sigmas say",
    )
    use_ins_velocity: bool = Field(
        default=True, description="The velocity of the INS carries the position between the observations"
    )
    sigma_velocity_mps: Positive = Field(
        default=0.05,
        le=10,
        description="Error of the INS's velocity in each component, m/s "
        "(Advanced Navigation Spatial, data sheet)",
    )
    velocity_time_s: Positive | Literal["auto"] = Field(
        default="auto",
        description="Correlation time of the velocity's error, seconds; `auto`: about 10 s is presumed, "
        "no data sheet has it",
    )
    sigma_acceleration: Positive = Field(
        default=0.2,
        le=100,
        description="Where the INS gives no velocity: random walk of the boat's own, m/s in one second",
    )
    attitude_time_s: Positive | Literal["auto"] = Field(
        default="auto",
        description="Correlation time of the INS's attitude errors, seconds; `auto`: about 20 s is presumed, "
        "no data sheet has it",
    )
    heading_disturbance_deg: NonNegative = Field(
        default=0.3,
        le=45,
        description="Heading error that the INS's sigma lacks (motors' fields, drift), degrees; 0: none",
    )
    disturbance_time_s: Positive = Field(default=60.0, description="Correlation time of that error, seconds")
    gnss_time_s: Positive | Literal["auto"] = Field(
        default="auto",
        description="Correlation time of the positions' slow errors, seconds; `auto`: about 10 s is "
        "presumed, no data sheet has it",
    )
    gnss_white_share: Annotated[float, Field(ge=0.01, lt=1)] | Literal["auto"] = Field(
        default="auto",
        description="Share of the positions' variance that is new in each epoch; `auto`: about 0.25 is "
        "presumed, no data sheet has it",
    )
    sigma_clock_offset_s: NonNegative = Field(
        default=0.02,
        le=10,
        description="What the images' times may all be off, seconds (one sigma); it is estimated",
    )
    clock_walk_s: NonNegative = Field(
        default=1e-5, le=1, description="Random walk of that offset in one second, seconds"
    )
    sigma_jitter_s: NonNegative = Field(
        default=0.016,
        le=1,
        description="Scatter of the images' times where their table states none, seconds (one camera, P2 "
        "6.1.2: 0.023 s of intervals, which are differences of two)",
    )
    estimate_errors: bool = Field(
        default=True,
        description="Sizes, correlation times and white share of the errors are estimated from the survey; "
        "what is stated of them here and by the logs is presumed to within a factor of 2 (sizes), 3 (times), "
        "and what stays unknown enlarges the predicted sigmas. `false`: all of it is taken as stated",
    )
    fixed: tuple[FixedError, ...] = Field(
        default=(), description="Settings of this section that are taken as stated all the same"
    )
    outlier_probability: float = Field(
        default=1e-4,
        gt=0,
        le=0.05,
        description="An observation whose error is less probable than this is rejected",
    )
    node_s: Positive = Field(
        default=1.0, le=60, description="Greatest interval of the nodes between observations, seconds"
    )
    max_iterations: int = Field(
        default=30,
        ge=4,
        le=100,
        description="Greatest number of solutions until weights, sigmas and poses stand",
    )
    max_sigma_position_m: Positive = Field(
        default=0.15,
        le=100,
        description="The trajectory is valid where each coordinate is known this well, metres",
    )
    max_sigma_attitude_deg: float = Field(
        default=2.0,
        gt=0,
        le=45,
        description="The trajectory is valid where each angle is known this well, degrees",
    )
