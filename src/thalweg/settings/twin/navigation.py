"""INS, GNSS receiver and echo sounder of the digital twin and their faults.

Errors that the published sigmas contain are on. Faults that the processing cannot know (fields of the motors,
drift, multipath) are off unless switched on, as are shadows, which need trees, banks or a bridge.
"""

from typing import Annotated, Literal

from pydantic import Field

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import Finite, NonNegative, Positive, Share, Sigma3, Vector3


class TwinIns(Section):
    """Advanced Navigation Spatial."""

    rate_hz: Annotated[float, Field(ge=1, le=1000)] = Field(
        default=50.0, description="Rate of the state packets, Hz"
    )
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
    standing_drift_degpmin: Finite = Field(
        default=0.0,
        description="Drift of the heading while the boat stands (T 3.1.1), degrees/min; not in the sigmas",
    )
    standing_speed_mps: NonNegative = Field(
        default=0.1, le=5, description="Speed over ground below which the boat counts as standing, m/s"
    )
    standing_recovery_s: Positive = Field(
        default=30.0, description="Time constant with which a moving boat loses the standing drift, seconds"
    )
    gyro_bias_degps: NonNegative = Field(
        default=0.0,
        le=5,
        description="Sigma of a constant bias of each raw gyroscope, degrees/s; the filter's rates lack it",
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
    depth_rate_hz: NonNegative = Field(
        default=0.0, le=50, description="Rate of external depth packets (ANPP 53), Hz; 0: none"
    )


class TwinGnss(Section):
    """Multiband receiver: its own RTK solution (SBP) and a post-processed track (.pos)."""

    mode: Literal["ppk", "single_frequency"] = Field(
        default="ppk",
        description="`ppk`: carrier phases and a base (P2, T); `single_frequency`: code only, no base (P1)",
    )
    rate_hz: Annotated[float, Field(ge=0.1, le=50)] = Field(default=10.0, description="Rate of positions, Hz")
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
    mask_deg: Annotated[float, Field(ge=0, le=60)] = Field(
        default=10.0, description="Elevation below which satellites are not used, degrees"
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
    water_reflection: Share = Field(
        default=0.2,
        description="Weight of a satellite that the water reflects in the multipath error; a dimmed one: 1",
    )


class TwinEcho(Section):
    """Single-beam echo sounder."""

    rate_hz: Annotated[float, Field(gt=0, le=50)] = Field(default=10.0, description="Soundings per second")
    sigma_m: NonNegative = Field(default=0.02, le=1, description="Noise of the depth, metres")
    offset_m: Finite = Field(default=0.1, description="Offset in DPT: transducer to water line, metres")
    max_depth_m: Positive = Field(default=100.0, description="Range scale, metres")
    bed_survey: bool = Field(
        default=False, description="Points of the bed are surveyed with an RTK pole in shallow water"
    )
    sigma_bed_m: Annotated[float, Field(gt=0, le=1)] = Field(
        default=0.02, description="Error of a surveyed point in each coordinate, metres"
    )
    sigma_bed_datum_m: NonNegative = Field(
        default=0.005, le=1, description="Common error of the heights of all surveyed points, metres"
    )
