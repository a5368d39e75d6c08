"""The whole campaign file as one model."""

from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from pydantic import ConfigDict, Field

from thalweg.settings.sections import (
    STREAM_KEYS,
    Accuracy,
    Bathymetry,
    Calibration,
    Colour,
    Deformation,
    EchoSounder,
    Epoch,
    Figures,
    Filters,
    Finite,
    Fused,
    Fusion,
    Georeferencing,
    Images,
    Ins,
    Lidar,
    LidarAccuracy,
    LightSheet,
    Logs,
    Mounts,
    Orientation,
    Panorama,
    Ppk,
    ReferenceSettings,
    Rig,
    Scatter,
    Section,
    Strips,
    is_rinex_name,
)

# ---------------------------------------------------------------- section ``twin``


def _laboratory() -> ModuleType | None:
    try:
        return import_module("thalweg_lab.settings")
    except ModuleNotFoundError as error:
        if error.name not in ("thalweg_lab", "thalweg_lab.settings"):
            raise
        return None


LABORATORY: Final = _laboratory()
"""What the laboratory adds to campaign files: the section ``twin`` (`TwinConfig`) and the checks of it
(`twin_mistakes`). The library never needs it, and without it a campaign with a twin is refused."""

if TYPE_CHECKING:
    Twin = Any
else:
    Twin = None if LABORATORY is None else LABORATORY.TwinConfig | None

# ---------------------------------------------------------------- section ``campaign``


Kind = Literal["survey", "calibration", "basin", "change", "photographs", "fixed_camera", "cloud"]
"""A river by boat, a calibration field, the light-sheet sensor in a basin, epochs, or one thing alone."""
ID_PATTERN = "^[a-z][a-z0-9_]*$"


class Origin(Section):
    """Origin of the local east-north-up frame wcs, geodetic."""

    lat_deg: float = Field(
        ge=-90,
        le=90,
        allow_inf_nan=False,
        description="Latitude of the origin of the local frame, degrees, north positive",
        examples=[51.05],
    )
    lon_deg: float = Field(
        ge=-180,
        le=180,
        allow_inf_nan=False,
        description="Longitude of the origin, degrees, east positive",
        examples=[13.25],
    )
    h_ell_m: Finite = Field(
        ge=-500,
        le=9000,
        description="Ellipsoidal (not orthometric) height of the origin, metres",
        examples=[300.0],
    )


class Identity(Section):
    """Name, map and world frame of the campaign."""

    id: str = Field(
        pattern=ID_PATTERN,
        max_length=60,
        description="Short name: small letters, digits, underscores; equals the name of the file",
        examples=["mulde"],
    )
    title: str = Field(
        min_length=1, description="One line for figures and reports", examples=["Mulde near Grimma, May 2021"]
    )
    crs: str = Field(
        description="Projected, metric CRS of the map exports: EPSG code or PROJ definition; without a boat "
        "also `local`, a frame of the surveyor's own",
        examples=["EPSG:25833"],
    )
    origin: Origin | None = Field(
        default=None,
        description="Origin of the local east-north-up frame: near the survey; not needed without a boat",
    )
    seed: int = Field(
        default=1, ge=0, le=2**32 - 1, description="Seed of everything random (digital twin, sampling)"
    )


# ---------------------------------------------------------------- the whole file


class Campaign(Section):
    """One survey: who, where, its logs (or the digital twin that writes them), and all settings.

    A campaign of `epochs` has no logs: it compares the clouds of other campaigns.
    """

    model_config = ConfigDict(
        json_schema_extra={
            "anyOf": [{"required": ["twin"]}, {"required": ["logs"]}, {"required": ["epochs"]}]
        }
    )

    campaign: Identity = Field(description="Name, map and world frame")
    twin: Twin = Field(
        default=None,
        description="The digital twin writes the logs; exactly one of `twin`, `logs` and `epochs`",
    )
    logs: Logs | None = Field(
        default=None, description="Raw logs of a real survey; exactly one of `twin`, `logs` and `epochs`"
    )
    epochs: Annotated[list[Epoch], Field(min_length=2, max_length=50)] | None = Field(
        default=None,
        description="Surveys of one bank in the order of time; exactly one of `twin`, `logs` and `epochs`",
    )
    lidar: Lidar = Field(default=Lidar(), description="Decoding of the lidar")
    lidar_accuracy: LidarAccuracy = Field(
        default=LidarAccuracy(), description="Accuracy of a single measurement of the lidar"
    )
    mounts: Mounts = Field(default=Mounts(), description="Sensors in the body frame of the INS")
    calibration: Calibration = Field(default=Calibration(), description="Evaluation of a calibration field")
    ins: Ins = Field(default=Ins(), description="Accuracy of the INS attitude")
    ppk: Ppk = Field(default=Ppk(), description="Post-processing of raw GNSS")
    orientation: Orientation = Field(default=Orientation(), description="Trajectory")
    images: Images = Field(default=Images(), description="Orientation of photographs of the bank")
    fused: Fused = Field(default=Fused(), description="Trajectory from INS, antenna and images together")
    rig: Rig = Field(default=Rig(), description="Camera with two fisheye lenses")
    panorama: Panorama = Field(default=Panorama(), description="Panoramas of that camera")
    light_sheet: LightSheet = Field(
        default=LightSheet(), description="Underwater light-sheet sensor in a basin"
    )
    georeferencing: Georeferencing = Field(
        default=Georeferencing(), description="Lidar points into the world"
    )
    strips: Strips = Field(
        default=Strips(), description="The trajectory corrected by surfaces that the lidar saw again"
    )
    scatter: Scatter = Field(default=Scatter(), description="Long logs as several jobs")
    colour: Colour = Field(default=Colour(), description="Colours of the cloud from photographs")
    filters: Filters = Field(default=Filters(), description="Points that are left out of the cloud")
    reference: ReferenceSettings = Field(
        default=ReferenceSettings(), description="Reference cloud -> surface mesh"
    )
    accuracy: Accuracy = Field(default=Accuracy(), description="Comparison of the cloud with the reference")
    echo_sounder: EchoSounder = Field(default=EchoSounder(), description="Echo sounder and water")
    bathymetry: Bathymetry = Field(default=Bathymetry(), description="Riverbed from soundings")
    fusion: Fusion = Field(default=Fusion(), description="One model of bed, banks and surroundings")
    deformation: Deformation = Field(default=Deformation(), description="Change between epochs")
    figures: Figures = Field(default=Figures(), description="Pictures")

    @property
    def id(self) -> str:
        """Short name of the campaign."""
        return self.campaign.id

    @property
    def kind(self) -> Kind:
        """What kind of recording this is: decides about rules, pages and pictures."""
        if self.is_basin:
            return "basin"
        if self.is_change:
            return "change"
        if self.is_calibration:
            return "calibration"
        if self.logs is not None and self.logs.kind != "boat":
            return self.logs.kind
        return "survey"

    @property
    def is_calibration(self) -> bool:
        """True if the campaign records a calibration field, not a river."""
        if self.twin is not None:
            return self.twin.field is not None
        given = self.logs.calibration if self.logs is not None else None
        return given is not None and bool(given.field or given.board_images)

    @property
    def is_basin(self) -> bool:
        """True if the campaign records the underwater light-sheet sensor in a basin: there is no boat."""
        if self.twin is not None:
            return self.twin.light_sheet is not None
        return self.logs is not None and bool(self.logs.light_sheet.given)

    @property
    def is_change(self) -> bool:
        """True if the campaign compares epochs that other campaigns surveyed."""
        return self.epochs is not None

    @property
    def epoch_names(self) -> list[str]:
        """Names of the epochs, in the order of time."""
        return [epoch.called(number) for number, epoch in enumerate(self.epochs or [])]

    def log_files(self, stream: str) -> list[Path]:
        """Files of one stream of a real survey, absolute; empty for a twin.

        Parameters
        ----------
        stream : ``lidar``, ``ins``, ``rover``, ``sbp`` (rover files without RINEX), ``base``, ``nav``,
            ``pos``, ``sbet``, ``depth``, ``reference``, ``bed``, or one of `CalibrationLogs`.

        Raises
        ------
        KeyError : no such stream.
        """
        key = "rover" if stream == "sbp" else stream
        if key not in (self.logs.streams() if self.logs else STREAM_KEYS):
            raise KeyError(stream)
        named = self.logs.named(key) if self.logs else []
        paths = list(dict.fromkeys(Path(path) for path, _ in named))
        return [p for p in paths if not is_rinex_name(p)] if stream == "sbp" else paths

    def topics(self, stream: str) -> list[str]:
        """Topics of its containers that a stream of a real survey names; none: whatever fits."""
        named = self.logs.named(stream) if self.logs else []
        return list(dict.fromkeys(topic for _, topic in named if topic))

    def plain(self) -> dict[str, Any]:
        """All settings as plain dicts, lists, text and numbers, as Snakemake compares them."""
        return self.model_dump(mode="json")
