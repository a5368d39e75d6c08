"""Section ``filters``: which lidar points are left out of the cloud, besides those out of range.

Body frame ics: x forward, y right, z down. The default box holds the HyDrone of the thesis (1.17 m x 0.74 m,
T 2.1) with antenna mast and echo sounder when the INS sits amidships, and the water beside it, which returns
beams that fall steeply.
"""

from typing import Annotated, Self

from pydantic import Field, model_validator

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import Finite, NonNegative, Positive, Vector3


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
    isolated_radius_m: Annotated[float, Field(ge=0.05, le=20, allow_inf_nan=False)] = Field(
        default=0.5, description="Radius of the neighbourhood of a point, metres"
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
