"""Sections ``lidar``, ``lidar_accuracy``, ``georeferencing`` and ``filters``, and ``figures``.

Body frame ics: x forward, y right, z down. The default box holds the HyDrone of the thesis (1.17 m x 0.74 m,
T 2.1) with antenna mast and echo sounder when the INS sits amidships, and the water beside it, which returns
beams that fall steeply.
"""

import math
from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Final, Literal, Self

from pydantic import Field, field_validator, model_validator

from thalweg.settings.sections.base import Finite, NonNegative, Positive, Section, Vector3

if TYPE_CHECKING:
    from thalweg.core import ArrayF


# ---------------------------------------------------------------- decoding and accuracy


Port = Annotated[int, Field(ge=1, le=65535)]


class LidarClockStated(Section):
    """Time of a lidar that had no GPS, or whose stamps are known to be off.

    How well a stated time is known belongs into `lidar_accuracy.sigma_time_s`; an estimated one has a
    standard deviation of its own, which joins it.
    """

    source: Literal["stated", "nmea", "motion"] = Field(
        default="stated",
        description="What tells the time of a lidar without GPS time: `stated` below, `nmea` the sentences "
        "that it received without PPS, `motion` how it turned and moved, against the trajectory",
    )

    first_packet_utc: str | None = Field(
        default=None,
        description="UTC of the first packet, ISO 8601 such as 2026-05-12T09:30:00.25Z, of a lidar without "
        "PPS and NMEA; stretches with GPS time keep their own. With `source: motion` good to a minute, "
        "or left out",
    )
    nmea_delay_s: NonNegative = Field(
        default=0.3,
        le=2,
        description="From the second that a sentence names until the lidar has it, with `source: nmea`, "
        "seconds: a receiver computes, then 70 characters at 9600 baud take 0.07 s",
    )
    sigma_nmea_delay_s: Positive = Field(
        default=0.2, le=2, description="Standard deviation of `nmea_delay_s`, seconds"
    )
    offset_s: Finite = Field(
        default=0.0,
        ge=-1.3e9,
        le=1.3e9,
        description="Added to the time of every packet, seconds; 1024 weeks and the leap seconds since then "
        "where the week counter of the receiver rolled over",
    )

    @field_validator("first_packet_utc")
    @classmethod
    def _check_time(cls, text: str | None) -> str | None:
        if text is not None and datetime.fromisoformat(text).tzinfo is None:
            raise ValueError(f"{text!r} names no zone; add Z for UTC")
        return text

    @property
    def first_packet_unix_s(self) -> float | None:
        """The same as Unix time, None if it is not stated."""
        text = self.first_packet_utc
        return None if text is None else datetime.fromisoformat(text).timestamp()


class Lidar(Section):
    """Decoding of the lidar."""

    model: Literal["auto", "VLP-16", "Puck Hi-Res", "HDL-32E", "VLP-32C"] = Field(
        default="auto", description="Scanner; `auto` trusts the product byte of the packets"
    )
    vertical_corrections: bool = Field(
        default=True, description="Apply the vertical offsets of the lasers from the manual"
    )
    returns: Literal["all", "strongest", "last"] = Field(
        default="all", description="Which returns of a dual-return log are kept"
    )
    data_port: Port = Field(default=2368, description="UDP port of the data packets")
    position_port: Port = Field(default=8308, description="UDP port of the position packets")
    clock: LidarClockStated = Field(default=LidarClockStated(), description="Time that a person states")


WEAK_RANGE_M: Final = 100.0
WEAK_REFLECTIVITY: Final = 10.0
"""The echo to which `sigma_weak_m` belongs: reflectivity in percent, as the sensor reports it."""


class LidarAccuracy(Section):
    """What a single measurement of the scanner is worth; makes the covariance of each point."""

    sigma_component_m: Positive = Field(
        default=0.0173,
        le=1,
        description="Standard deviation along the beam and in both directions across it, metres "
        "(Velodyne VLP-16: 3 cm in space, P1 and P2 eq. 7, over sqrt 3); to within a factor of 1.5",
    )
    divergence_mrad: NonNegative = Field(
        default=3.0,
        le=50,
        description="Full divergence of the beam, milliradians (Velodyne VLP-16, P2 section 7); to within a "
        "factor of 1.5",
    )
    footprint_share: NonNegative = Field(
        default=0.177,
        le=0.5,
        description="Standard deviation of the echo's place in its footprint, in each direction, as a share "
        "of the diameter: 0.25 if it may be anywhere (Lichti and Gordon 2004), 0.177 if three speckle cells "
        "share the energy",
    )
    sigma_weak_m: NonNegative = Field(
        default=0.03,
        le=10,
        description="Further range noise of the echo of a 10 % target at 100 m, metres; goes with the square "
        "of the range over the reflectivity; presumed, no data sheet has it",
    )
    sigma_time_s: NonNegative = Field(
        default=1e-6, le=1, description="Standard deviation of the scanner's stamps, seconds (PPS, T 3.1.2)"
    )

    def with_clock(self, sigma_s: float) -> Self:
        """The same with the standard deviation of an estimated clock."""
        return self.model_copy(update={"sigma_time_s": math.hypot(self.sigma_time_s, sigma_s)})

    @property
    def divergence_rad(self) -> float:
        """Full divergence of the beam."""
        return self.divergence_mrad / 1000.0

    def scaled(self, *, component: float, footprint: float) -> Self:
        """The same with other sizes: range and directions, and the echo's place in its footprint."""
        return self.model_copy(
            update={
                "sigma_component_m": component * self.sigma_component_m,
                "sigma_weak_m": component * self.sigma_weak_m,
                "footprint_share": footprint * self.footprint_share,
            }
        )

    def variances(self, range_m: "ArrayF", reflectivity: "ArrayF") -> "tuple[ArrayF, ArrayF]":
        """Variances along the beam and across it in each direction, m^2, both (n,).

        Parameters
        ----------
        range_m : (n,) measured range.
        reflectivity : (n,) percent, as the sensor reports it; below 1 counts as 1.
        """
        import numpy as np  # here: the command line imports this module, and needs no arrays

        r = np.asarray(range_m, dtype=np.float64)
        faint = WEAK_REFLECTIVITY / np.maximum(reflectivity, 1.0) * (r / WEAK_RANGE_M) ** 2
        base = self.sigma_component_m**2
        along = base + (self.sigma_weak_m * faint) ** 2
        across = base + (self.footprint_share * self.divergence_rad * r) ** 2
        return along, across


# ---------------------------------------------------------------- filters


class Filters(Section):
    """Points that are left out of the cloud and counted; each has one reason, the first that holds."""

    hull_low_ics_m: Vector3 | None = Field(
        default=(-0.90, -1.50, -0.80),
        description="Box around the own boat and the water beside it in the body frame, lowest forward, "
        "right, down, metres; null in both corners: off",
    )
    hull_high_ics_m: Vector3 | None = Field(
        default=(0.90, 1.50, 0.45),
        description="The other corner of that box, highest forward, right, down, metres",
    )
    max_sigma_m: Positive | None = Field(
        default=None,
        description="Points with a larger predicted sigma in any axis are left out, metres; null: off",
    )
    water_line_ics_m: Finite = Field(
        default=0.2,
        ge=-5,
        le=5,
        description="Water line below the INS, boat at rest, metres; roll and pitch are not regarded",
    )
    below_water_m: NonNegative | None = Field(
        default=0.05,
        le=50,
        description="Points farther below the water level at the boat are left out, metres; null: off, for "
        "instance below a weir, where land may lie lower than the boat",
    )
    below_water_sigmas: NonNegative = Field(
        default=2.0,
        le=10,
        description="That margin grows by so many times the predicted sigma of the point's height above the "
        "boat",
    )
    mirror_ghosts: bool = Field(
        default=True,
        description="Name points below the water mirror ghosts if their mirror image lies on the cloud",
    )
    isolated_radius_m: float = Field(
        default=0.5,
        ge=0.05,
        le=20,
        allow_inf_nan=False,
        description="Radius of the neighbourhood of a point, metres",
    )
    isolated_neighbours: int = Field(
        default=3,
        ge=0,
        le=200,
        description="Points with fewer others within the radius are left out; 0: off. One shot gives two "
        "points at most, so from 2 on it cannot save itself",
    )

    @model_validator(mode="after")
    def _check_hull(self) -> Self:
        low, high = self.hull_low_ics_m, self.hull_high_ics_m
        if (low is None) != (high is None):
            raise ValueError("the box of the hull has one corner only: give both or set both to null")
        if low is not None and high is not None and not all(a < b for a, b in zip(low, high, strict=True)):
            raise ValueError(
                f"the box of the hull is empty: hull_low_ics_m {list(low)} is not below "
                f"hull_high_ics_m {list(high)} in all three axes"
            )
        return self

    @property
    def needs_occupancy(self) -> bool:
        """Whether a first pass over the cloud changes anything."""
        return self.isolated_neighbours > 0 or (self.below_water_m is not None and self.mirror_ghosts)


# ---------------------------------------------------------------- georeferencing and pictures


class Georeferencing(Section):
    """Lidar points into the world frame."""

    min_range_m: NonNegative = Field(
        default=0.5, le=250, description="Nearer points are left out, metres; the own boat has its own filter"
    )
    max_range_m: Positive = Field(default=100.0, le=250, description="Farther points are left out, metres")
    chunk_points: int = Field(
        default=1_000_000, ge=10_000, le=50_000_000, description="Points held in memory at a time"
    )
    laz_scale_m: float = Field(
        default=0.001,
        ge=1e-5,
        le=0.01,
        allow_inf_nan=False,
        description="Resolution of coordinates in LAZ files, metres",
    )
    correlations: bool = Field(
        default=False,
        description="Write the correlations of each point's coordinates beside its three standard "
        "deviations; always so for a twin, and where there is a reference",
    )
    export_map: bool = Field(
        default=True, description="Also write the cloud in map coordinates (`campaign.crs`)"
    )


class Scatter(Section):
    """Long logs, whose heavy steps run as several jobs."""

    seconds: Literal["auto"] | Annotated[float, Field(ge=1, le=86_400)] = Field(
        default="auto",
        description="Length of the windows of the lidar's log that are jobs of their own, seconds; the "
        "result is the same for any. `auto`: one window on this machine, half an hour each on a cluster",
    )


class Colour(Section):
    """The lidar cloud in the colours of photographs."""

    window_s: Positive = Field(
        default=30.0,
        le=3600,
        description="Photographs so long before or after a point may colour it, seconds",
    )
    max_range_m: Positive = Field(
        default=60.0, le=500, description="Photographs from farther away do not colour a point, metres"
    )
    views: int = Field(default=4, ge=1, le=16, description="Best photographs whose median is the colour")
    even_exposures: bool = Field(
        default=True, description="Bring photographs to one exposure by the points that several of them show"
    )
    cell_deg: float = Field(
        default=0.3,
        ge=0.02,
        le=5,
        allow_inf_nan=False,
        description="Cells in which the nearest thing of a photograph is looked for, degrees",
    )
    step_m: NonNegative = Field(
        default=0.15,
        le=10,
        description="Points so much farther than the nearest thing are not hidden, metres",
    )
    step_share: NonNegative = Field(
        default=0.03, le=1, description="And this share of their range: surfaces are seen at a slant"
    )


class Figures(Section):
    """Pictures."""

    dpi: int = Field(default=200, ge=50, le=1200, description="Resolution, dots per inch")
    formats: list[Literal["png", "pdf", "svg"]] = Field(
        default=["png"], description="Files of each picture; the PNG, which pages show, is always made"
    )
    titles: bool = Field(
        default=True, description="Titles on pictures; false for papers, which have captions"
    )
    max_points: int = Field(
        default=2_000_000, ge=1_000, le=100_000_000, description="Points drawn at most in a scatter plot"
    )


class Strips(Section):
    """How surfaces that the lidar saw again correct the trajectory."""

    adjust: bool = Field(
        default=False, description="Correct the best trajectory by the bank, and make a cloud by it"
    )
    use: bool = Field(
        default=False,
        description="Place bed, colours and all else by the corrected trajectory; includes `adjust`",
    )
    knot_s: Annotated[float, Field(ge=0.25, le=2)] = Field(
        default=0.5, description="Interval of the poses' corrections, seconds"
    )
    max_knots: Annotated[int, Field(ge=10, le=4000)] = Field(
        default=1000, description="Of more knots the interval grows; memory and time grow with their square"
    )
    max_planes: Annotated[int, Field(ge=100, le=100_000)] = Field(
        default=6000, description="Plane spots that are taken, evenly from all stretches and directions"
    )
    sigma_range_m: NonNegative = Field(
        default=0.0,
        le=0.5,
        description="How far all ranges may be off alike, metres, such as 0.02; 0: no such unknown",
    )
    sigma_clock_s: NonNegative = Field(
        default=0.0,
        le=1,
        description="How far the lidar's clock may be off, seconds, such as 0.005; 0: no such unknown",
    )
    sigma_stable_m: Annotated[float, Field(gt=0, le=1)] = Field(
        default=0.01,
        description="Standard deviation of `logs.stable` along the normals, one value a cell, metres",
    )
    sigma_stable_shift_m: NonNegative = Field(
        default=0.0,
        le=10,
        description="How far `logs.stable` may be shifted and turned as a whole, metres; 0: not at all",
    )
