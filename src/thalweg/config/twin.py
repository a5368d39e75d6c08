"""Section ``twin``: the digital twin that writes the raw logs of a campaign.

``size`` chooses a set of values; every key given beside it replaces one value of that set. The defaults
of the sensors are the published inputs: 3 cm lidar (P2 eq. 7: 17.3 mm a component), 3 mrad divergence,
0.1/0.1/0.2 degrees attitude, 20/20/30 mm PPK, TLS of 3 mm at 50 m in steps of 2.5 cm, turns of 7 degrees/s.
"""

import datetime as dt
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from thalweg.config.base import Section
from thalweg.config.values import Finite, NonNegative, Positive, Sigma3

Size = Literal["tiny", "demo", "mulde"]
Stream = Literal["lidar", "ins", "gnss", "echo"]
Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0, le=1_000_000)]


def _utc_text(text: str) -> str:
    try:
        moment = dt.datetime.fromisoformat(text)
    except ValueError:
        moment = None
    if moment is None or moment.tzinfo is None or moment.utcoffset() != dt.timedelta(0):
        raise ValueError("not a UTC time such as 2021-05-12T08:31:07Z")
    return text


UtcText = Annotated[str, AfterValidator(_utc_text)]


class TwinScene(Section):
    """The river reach: flow along +east on average, embankment on the right, meadow on the left."""

    length_m: Annotated[float, Field(ge=20, le=2000)] = Field(
        default=280.0, description="Length of the modelled reach along the flow, metres"
    )
    width_m: Annotated[float, Field(ge=12, le=200)] = Field(
        default=40.0, description="Mean width of the water, metres"
    )
    depth_m: Annotated[float, Field(ge=0.5, le=20)] = Field(
        default=2.2, description="Mean depth of the thalweg below the water level, metres"
    )
    water_level_m: Finite = Field(
        default=0.0, description="Height of the water above the origin of the campaign, metres"
    )
    meander_deg: Annotated[float, Field(ge=0, le=20)] = Field(
        default=6.0, description="Greatest angle between flow and valley (sine-generated curve), degrees"
    )
    meander_length_m: Annotated[float, Field(ge=50, le=5000)] = Field(
        default=240.0, description="Wavelength of the meander along the flow, metres"
    )
    embankment_height_m: Annotated[float, Field(ge=1, le=30)] = Field(
        default=6.0, description="Height of the right bank above the water, metres"
    )
    embankment_slope_deg: Annotated[float, Field(ge=10, le=60)] = Field(
        default=33.0, description="Slope of the right bank, degrees"
    )
    roughness_m: NonNegative = Field(
        default=0.06, le=1, description="Amplitude of the roughness of the banks, metres"
    )
    grid_m: Annotated[float, Field(ge=0.05, le=2)] = Field(
        default=0.2, description="Grid step of the banks, metres; the bed is coarser"
    )
    stones_per_m: NonNegative = Field(
        default=9.0, le=100, description="Boulders on the embankment per metre of reach"
    )
    bushes_per_100m: NonNegative = Field(
        default=45.0, le=1000, description="Bushes on both banks per 100 m of reach"
    )
    posts_per_100m: NonNegative = Field(
        default=12.0, le=1000, description="Posts on both banks per 100 m of reach"
    )
    buildings: Annotated[int, Field(ge=0, le=50)] = Field(
        default=3, description="Buildings behind the left bank"
    )


class TwinBoat(Section):
    """True motion: zigzag between the banks, and the swaying of a small boat."""

    speed_mps: Annotated[float, Field(gt=0, le=10)] = Field(
        default=1.2, description="Speed over ground, m/s (P2: 0.4)"
    )
    turn_rate_degps: Annotated[float, Field(gt=0, le=60)] = Field(
        default=7.0, description="Greatest turn rate, degrees/s (P2: 7)"
    )
    zigzag_deg: Annotated[float, Field(ge=0, le=80)] = Field(
        default=50.0, description="Angle between the legs of the zigzag and the flow, degrees"
    )
    bank_distance_m: Positive = Field(
        default=6.0, le=100, description="Distance from the shores at which the boat turns, metres"
    )
    height_m: Positive = Field(
        default=0.2, le=5, description="Height of the INS above the water at rest, metres"
    )
    roll_deg: NonNegative = Field(default=1.5, le=20, description="Amplitude of roll, degrees")
    pitch_deg: NonNegative = Field(default=0.8, le=20, description="Amplitude of pitch, degrees")
    yaw_deg: NonNegative = Field(
        default=1.0, le=20, description="Amplitude of yawing about the course, degrees"
    )
    heave_m: NonNegative = Field(default=0.02, le=1, description="Amplitude of heave, metres")


class TwinLidar(Section):
    """Velodyne VLP-16."""

    returns: Literal["strongest", "last", "dual"] = Field(default="strongest", description="Return mode")
    rotation_hz: Annotated[float, Field(ge=5, le=20)] = Field(
        default=10.0, description="Revolutions per second"
    )
    sigma_range_m: NonNegative = Field(
        default=0.0173, le=1, description="Noise of the range, metres (3 cm / sqrt 3, P2 eq. 7)"
    )
    sigma_lateral_m: NonNegative = Field(
        default=0.0173, le=1, description="Offset of the beam in each of two directions across it, metres"
    )
    divergence_mrad: NonNegative = Field(
        default=3.0, le=20, description="Full divergence of the beam, milliradians"
    )
    max_range_m: Annotated[float, Field(gt=0, le=130)] = Field(
        default=100.0, description="Longest range with a return, metres"
    )
    water_returns: Share = Field(
        default=0.05, description="Share of shots straight down on water that return; none at grazing angles"
    )
    dropouts: Share = Field(default=0.005, description="Share of all other shots that are lost by chance")
    vertical_offsets: bool = Field(
        default=True,
        description="Lasers leave at the heights of the manual's table; false: all at the centre",
    )
    position_rate_hz: Annotated[float, Field(gt=0, le=1000)] = Field(
        default=50.0, description="Rate of the position packets, Hz"
    )
    host_clock_offset_s: Finite = Field(
        default=0.4, description="Recording computer's clock minus UTC, seconds"
    )
    nanoseconds: bool = Field(default=False, description="Capture file with nanosecond stamps")


class TwinIns(Section):
    """Advanced Navigation Spatial."""

    rate_hz: Annotated[float, Field(ge=1, le=1000)] = Field(
        default=50.0, description="Rate of the state packets, Hz"
    )
    sigma_roll_deg: NonNegative = Field(default=0.1, le=10, description="Error of roll, degrees")
    sigma_pitch_deg: NonNegative = Field(default=0.1, le=10, description="Error of pitch, degrees")
    sigma_heading_deg: NonNegative = Field(default=0.2, le=45, description="Error of heading, degrees")
    attitude_time_s: Positive = Field(
        default=20.0, description="Correlation time of the attitude errors (Gauss-Markov), seconds"
    )
    sigma_position_m: Sigma3 = Field(
        default=(0.6, 0.6, 1.0), description="Error east, north, up of the INS's own position, metres (P1)"
    )
    position_time_s: Positive = Field(
        default=60.0, description="Correlation time of the position errors, seconds"
    )
    heading_drift_degpmin: Finite = Field(
        default=0.0, description="Drift of the heading on top of its error, degrees/min"
    )
    depth_rate_hz: NonNegative = Field(
        default=0.0, le=50, description="Rate of external depth packets (ANPP 53), Hz; 0: none"
    )


class TwinGnss(Section):
    """Multiband receiver: its own RTK solution (SBP) and a post-processed track (.pos)."""

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


class TwinEcho(Section):
    """Single-beam echo sounder."""

    rate_hz: Annotated[float, Field(gt=0, le=50)] = Field(default=10.0, description="Soundings per second")
    sigma_m: NonNegative = Field(default=0.02, le=1, description="Noise of the depth, metres")
    offset_m: Finite = Field(default=0.1, description="Offset in DPT: transducer to water line, metres")
    max_depth_m: Positive = Field(default=100.0, description="Range scale, metres")


class TwinTls(Section):
    """Terrestrial laser scans of the right bank from stations on the left bank."""

    spacing_m: Annotated[float, Field(ge=0.005, le=1)] = Field(
        default=0.025, description="Point spacing on the right shore across the beam, metres"
    )
    sigma_50m_m: NonNegative = Field(
        default=0.003, le=1, description="3D error at 50 m distance, metres; proportional to distance"
    )
    sigma_station_m: NonNegative = Field(
        default=0.0, le=1, description="Error of each station's position per axis, metres"
    )
    coordinates: Literal["map", "local"] = Field(
        default="map", description="Coordinates in the files: grid of campaign.crs, or the local frame"
    )


class TwinEffects(Section):
    """Named defects of logs; all off unless switched on. Positions in the logs are drawn from the seed."""

    lost_packets: Share = Field(default=0.0, description="Share of lidar packets that are missing")
    lost_burst: Annotated[int, Field(ge=1, le=10000)] = Field(
        default=5, description="Lidar packets that are lost at a time"
    )
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
    mixed_pixels: bool = Field(
        default=False, description="Beams that meet two near surfaces return a range between them"
    )


SIZES: Final[Mapping[str, Mapping[str, Any]]] = {
    "tiny": {
        # 12 s before a full hour: the lidar's time of the hour rolls over inside the log.
        "start_utc": "2021-05-12T08:59:48Z",
        "duration_s": 25.0,
        "scene": {
            "length_m": 130.0, "width_m": 22.0, "depth_m": 1.6, "embankment_height_m": 4.0, "grid_m": 0.25,
            "stones_per_m": 5.0, "bushes_per_100m": 25.0, "buildings": 1,
        },
        "boat": {"speed_mps": 2.4, "turn_rate_degps": 24.0, "zigzag_deg": 50.0, "bank_distance_m": 5.0},
        "tls": {"spacing_m": 0.05},
        # Short correlation: 25 s then hold enough independent errors to compare them with their sigmas.
        "ins": {"attitude_time_s": 1.0},
        "gnss": {"correlation_time_s": 1.0},
    },
    "demo": {"duration_s": 180.0},
    "mulde": {
        "duration_s": 1025.0,
        "scene": {"length_m": 460.0, "grid_m": 0.25},
        "boat": {"speed_mps": 0.4},
    },
}  # fmt: skip
"""What the sizes change against the defaults."""


class TwinConfig(Section):
    """The digital twin: river, boat, sensors and defects."""

    size: Size = Field(
        default="demo",
        description="Set of values: `tiny` 25 s for tests, `demo` 3 min, `mulde` 17 min as in P2",
    )
    start_utc: UtcText = Field(
        default="2021-05-12T08:31:07Z", description="Begin of the lidar log, UTC, as 2021-05-12T08:31:07Z"
    )
    duration_s: Annotated[float, Field(ge=1, le=7200)] = Field(
        default=180.0, description="Length of the lidar log, seconds; the others begin and end 2 s outside it"
    )
    scene: TwinScene = Field(default=TwinScene(), description="River reach")
    boat: TwinBoat = Field(default=TwinBoat(), description="True motion of the boat")
    lidar: TwinLidar = Field(default=TwinLidar(), description="Mobile lidar")
    ins: TwinIns = Field(default=TwinIns(), description="Inertial navigation system")
    gnss: TwinGnss = Field(default=TwinGnss(), description="GNSS receiver")
    echo: TwinEcho = Field(default=TwinEcho(), description="Echo sounder")
    tls: TwinTls = Field(default=TwinTls(), description="Reference scans")
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
