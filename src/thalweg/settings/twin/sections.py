"""Section ``twin``: the digital twin that writes the raw logs of a campaign.

``size`` chooses a set of values; every key given beside it replaces one value of that set. The defaults
of the sensors are the published inputs: 3 cm lidar (P2 eq. 7: 17.3 mm a component), 3 mrad divergence,
0.1/0.1/0.2 degrees attitude, 20/20/30 mm PPK, TLS of 3 mm at 50 m in steps of 2.5 cm, turns of 7 degrees/s.
"""

import datetime as dt
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import Count, NonNegative, Positive, Share
from thalweg.settings.twin.camera import TwinCamera
from thalweg.settings.twin.field import TwinField
from thalweg.settings.twin.lidar import TwinLidar, TwinTls
from thalweg.settings.twin.light_sheet import TwinLightSheet
from thalweg.settings.twin.navigation import TwinEcho, TwinGnss, TwinIns
from thalweg.settings.twin.scene import TwinBoat, TwinScene
from thalweg.settings.twin.sheet_strip import TwinSheetStrip
from thalweg.settings.twin.time_lapse import TwinTimeLapse

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
    mount_errors: bool = Field(
        default=True,
        description="Sensors sit off the campaign's mounts by errors of the stated sigmas",
    )


SIZES: Final[Mapping[str, Mapping[str, Any]]] = {
    "tiny": {
        # 12 s before a full hour: the lidar's time of the hour rolls over inside the log.
        "start_utc": "2021-05-12T08:59:48Z",
        "duration_s": 25.0,
        "scene": {
            "length_m": 130.0, "width_m": 22.0, "depth_m": 1.6, "embankment_height_m": 4.0, "grid_m": 0.1,
            "shelf_width_m": 1.5, "stones_per_m": 8.0, "cobbles_per_m": 30.0, "bushes_per_100m": 30.0,
            "trees_per_100m": 9.0, "grass_per_m": 12.0, "reeds_per_m": 3.0, "leaves_per_bush": 300,
            "leaves_per_tree": 1500, "buildings": 1,
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
            "length_m": 1640.0, "flow_deg": 180.0, "meander_deg": 9.0, "meander_length_m": 520.0,
            "grid_m": 0.1, "weir": True, "weir_place": 0.97, "bridge": True, "stones_per_m": 7.0,
            "cobbles_per_m": 20.0, "bushes_per_100m": 60.0, "trees_per_100m": 14.0, "grass_per_m": 14.0,
            "reeds_per_m": 3.0, "leaves_per_bush": 300, "leaves_per_tree": 1600, "buildings": 14,
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
            "size_px": (1600, 1200), "focal_px": 1295.0, "principal_offset_px": (4.4, -2.9),
            "reference": {
                "n_images": 35, "size_px": (2100, 1400), "focal_px": 1645.0,
                "principal_offset_px": (-6.1, 3.6),
            },
        },
    },
    # As many markers and cones, so that every method works, but a short run.
    "field_tiny": {
        "start_utc": "2021-05-11T13:02:11Z",
        "duration_s": 40.0,
        "field": {"position_s": 2.0},
        "camera": {
            "size_px": (1600, 1200), "focal_px": 1295.0, "principal_offset_px": (4.4, -2.9),
            "reference": {
                "n_images": 28, "size_px": (2100, 1400), "focal_px": 1645.0,
                "principal_offset_px": (-6.1, 3.6),
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
}  # fmt: skip
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
    camera: TwinCamera = Field(default=TwinCamera(), description="Cameras and the camera's clock")
    field: TwinField | None = Field(
        default=None,
        description="Calibration field on land; null: the boat sails on a river",
    )
    time_lapse: TwinTimeLapse | None = Field(
        default=None,
        description="Images of the bank along the voyage, and control points; null: the camera takes none",
    )
    light_sheet: TwinLightSheet | None = Field(
        default=None,
        description="Underwater light-sheet sensor in a basin; null: there is none",
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
