"""Sections ``epochs`` and ``deformation``: surveys of one bank at different times, and what changed."""

import datetime as dt
from typing import Annotated, Final, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from thalweg.settings.sections.accuracy import Area, Corner
from thalweg.settings.sections.base import Finite, NonNegative, Positive, Section, Vector3


def _moment(text: str) -> dt.datetime | None:
    """A UTC time, or noon of a day; None if the text is neither."""
    try:
        moment = dt.datetime.fromisoformat(text)
    except ValueError:
        return None
    if len(text) == len("2021-05-12"):
        return moment.replace(hour=12, tzinfo=dt.UTC)
    return moment if moment.utcoffset() == dt.timedelta(0) else None


def _day_or_time(text: str) -> str:
    if _moment(text) is None:
        raise ValueError("not a day such as 2021-05-12 or a UTC time such as 2021-05-12T08:31:07Z")
    return text


CLOUD_ENDINGS: Final = (".las", ".laz", ".ply", ".e57")
"""Files of point clouds."""
TEXT_ENDINGS: Final = (".xyz", ".txt", ".csv", ".asc", ".pts")
"""Tables of points: x, y, z in the first three columns, a head of any number of lines."""
DSM_ENDINGS: Final = (".tif", ".tiff")
"""Rasters of heights."""


class Epoch(Section):
    """One survey of the series: a campaign, or a cloud or surface model from elsewhere with its date."""

    campaign: str | None = Field(
        default=None, description="Id of the campaign whose cloud is compared", examples=["mulde"]
    )
    chain: Literal["ins", "camera", "fused", "strips"] = Field(
        default="ins",
        description="Trajectory that georeferenced its cloud: by INS, camera, all sensors, or strips",
    )
    surface: Literal["bank", "bed"] = Field(
        default="bank", description="Of a campaign: the cloud of its bank, or the riverbed of its soundings"
    )
    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=60)] | None = Field(
        default=None, description="Of files: short name in tables and pictures; null: epoch_ and its number"
    )
    clouds: list[str] = Field(
        default=[],
        description="Point cloud from elsewhere: LAS, LAZ, PLY, E57, x y z text; several files are one epoch",
        examples=[["tls_2019/*.laz"]],
    )
    dsm: str | None = Field(
        default=None,
        description="Surface model from elsewhere: GeoTIFF of heights in metres; a band sigma_m is used",
        examples=["dsm_20190313.tif"],
    )
    date_utc: Annotated[str, AfterValidator(_day_or_time)] | None = Field(
        default=None,
        description="Of files: day or UTC time of the survey",
        examples=["2019-03-13", "2019-03-13T10:20:00Z"],
    )
    crs: str | None = Field(
        default=None,
        description="Of files: map grid, with its heights if they are not ellipsoidal (EPSG:25833+7837); "
        "null: as the file states, or campaign.crs",
    )
    sigma_m: NonNegative | None = Field(
        default=None,
        description="Of files: standard deviation that neighbouring points share (of clouds: of each "
        "coordinate; of surface models: of the height), metres; null: unknown, no verdict without drawn "
        "stable ground",
    )
    sigma_common_m: NonNegative | None = Field(
        default=None,
        description="Of files: standard deviation that all heights share (datum, base station, control), "
        "metres; not needed where stable ground is drawn; null: unknown",
    )
    correlation_m: NonNegative | None = Field(
        default=None,
        le=100_000,
        description="With sigma_m or the bed of a campaign: distance at which the correlation of shared "
        "errors is 1/e, metres; 0: none",
    )
    nodata: Finite | Literal["none"] | None = Field(
        default=None,
        description="Of files: value of missing heights beside the declared one; `none`: there is no other",
    )
    leave_out: list[str] = Field(
        default=[],
        description="Of files: polygons (GeoPackage, Shapefile, GeoJSON, KML) without comparison, such as "
        "water; FILE?COLUMN=VALUE,... chooses some of a file, FILE?layer=NAME a layer",
        examples=[["watermasks.gpkg?location=mar,raw_date=20180727"]],
    )

    @property
    def of_files(self) -> bool:
        """True if the epoch is a cloud or surface model from elsewhere."""
        return self.campaign is None

    @property
    def has_trajectory(self) -> bool:
        """True if a boat's trajectory says what errs: the cloud of a campaign's bank."""
        return self.campaign is not None and self.surface == "bank"

    def called(self, number: int) -> str:
        """Name of the epoch with a number from 0: of its campaign (``_bed`` for its bed), or its own."""
        if self.campaign is not None:
            return self.campaign if self.surface == "bank" else f"{self.campaign}_bed"
        return self.name or f"epoch_{number + 1}"

    @property
    def moment_utc(self) -> dt.datetime | None:
        """Time of the survey, if stated."""
        return None if self.date_utc is None else _moment(self.date_utc)


class EpochErrors(Section):
    """Errors that the points of an epoch share."""

    moment_s: float = Field(
        default=0.1,
        ge=0.02,
        le=2,
        allow_inf_nan=False,
        description="Points within this time share the error of one pose, seconds",
    )
    position_time_s: Positive | None = Field(
        default=None,
        description="Correlation time of positions by INS and GNSS, seconds; null: as estimated from the "
        "survey. Camera and fused trajectory tell how their errors last",
    )
    attitude_time_s: Positive | None = Field(
        default=None,
        description="Correlation time of attitudes by INS and GNSS, seconds; null: as estimated from the "
        "survey",
    )
    common_mounts: bool = Field(
        default=False,
        description="All epochs carry the sensors in the same places: errors of the mounts are the same",
    )


class Visibility(Section):
    """Whether an epoch could have seen a place."""

    max_range_m: Positive = Field(default=60.0, le=300, description="Farther places are not seen, metres")
    max_incidence_deg: float = Field(
        default=82.0,
        gt=0,
        le=90,
        allow_inf_nan=False,
        description="Beams that graze the surface more than this give no echo, degrees",
    )


class Classes(Section):
    """What a change is called."""

    vegetation_roughness_m: Positive = Field(
        default=0.15,
        le=5,
        description="Points scatter more than this along the normal, in one epoch: vegetation, metres",
    )
    object_m: NonNegative = Field(
        default=2.5,
        le=50,
        description="A change no longer than this with sharp edges is an object (boulder, trunk), metres; "
        "0: none",
    )
    least_patch_m2: NonNegative = Field(
        default=1.0, description="Smaller connected changes are no patch of their own, square metres"
    )


class Deformation(Section):
    """What changed between epochs (T 4.1)."""

    area: Area = Field(default=Area(), description="Part of the bank that is compared")
    core_spacing_m: float = Field(
        default=0.5,
        ge=0.05,
        le=20,
        allow_inf_nan=False,
        description="Core points: one a cell of this width on the surfaces, metres",
    )
    scales_m: list[Positive] = Field(
        default=[0.5, 1.0, 2.0],
        min_length=1,
        max_length=8,
        description="Radii at which normals are fitted, metres; the most planar counts",
    )
    cylinder_radius_m: Positive = Field(default=0.5, le=20, description="Radius of the cylinders, metres")
    reach_m: Positive = Field(
        default=3.0, le=50, description="Reach of the cylinders along the normal, to both sides, metres"
    )
    least_in_cylinder: int = Field(
        default=5, ge=2, le=10_000, description="Points that a mean needs in each epoch"
    )
    stable: list[Annotated[list[Corner], Field(min_length=3)]] | str | None = Field(
        default=None,
        description="Ground that did not move: polygons east, north, local frame, metres, or a file of "
        "polygons, lines and points (FILE?COLUMN=VALUE chooses). Null: of boats what most of the bank agrees "
        "on; of clouds and surface models nothing is taken off",
        examples=["roads.gpkg"],
    )
    registration: Literal["none", "height", "shift", "shift+heading", "rigid"] | None = Field(
        default=None,
        description="Motion between the epochs that stable ground shows; null: shift+heading, with a surface "
        "model height. Two surface models show their height alone",
    )
    towards: Vector3 = Field(
        default=(0.0, 0.0, 1.0),
        description="Direction to which normals point and in which distances are positive, east, north, up, "
        "where no epoch has a trajectory of the scanner",
    )
    resample: Literal["nearest", "bilinear"] | None = Field(
        default=None,
        description="How the second of two surface models comes onto the grid of the first; null: not at all",
    )
    largest_shift_m: Positive = Field(
        default=0.5,
        le=10,
        description="A larger motion between epochs is a mistake, not a registration, metres",
    )
    level: float = Field(default=0.05, gt=0, lt=1, allow_inf_nan=False, description="Level of significance")
    control: Literal["fdr", "family", "none"] = Field(
        default="fdr",
        description="What the level holds for: `fdr` the share of false ones among all changes, `family` the "
        "chance of a single false one anywhere, `none` each core point by itself",
    )
    station_m: Positive = Field(
        default=5.0, description="Length of a stretch of bank for volumes and retreat, metres"
    )
    line_height_m: Annotated[float, Field(allow_inf_nan=False)] | None = Field(
        default=None,
        description="Height of the bank line, local frame, metres; null: half a metre above the highest "
        "water of the epochs",
    )
    draws: int = Field(default=200, ge=20, le=10_000, description="Draws of the errors of all poses")
    errors: EpochErrors = Field(default=EpochErrors(), description="Errors that points of an epoch share")
    visibility: Visibility = Field(default=Visibility(), description="What an epoch could see")
    classes: Classes = Field(default=Classes(), description="What a change is called")

    @model_validator(mode="after")
    def _check_reach(self) -> Self:
        if self.reach_m < self.cylinder_radius_m:
            raise ValueError(
                f"reach_m {self.reach_m:g} is below cylinder_radius_m {self.cylinder_radius_m:g}: the "
                "cylinders would be discs"
            )
        if not any(self.towards):
            raise ValueError("towards (0, 0, 0) is no direction")
        return self
