"""The base of all sections of a campaign file, and the kinds of values that they share."""

from typing import Annotated, Any, Final, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from pydantic.config import JsonDict


def or_file(schema: JsonDict) -> None:
    """What is drawn may also be the name of a file of a GIS, whose corners the loader takes."""
    told = {key: schema.pop(key) for key in ("type", "items") if key in schema}
    schema["anyOf"] = [*([told] if told else schema["anyOf"]), {"type": "string"}]  # type: ignore[misc]


class Section(BaseModel):
    """A section of the campaign file: unknown keys are refused, values never change after loading."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    def replace(self, **changes: Any) -> Self:
        """The same with other values, checked like those of a file."""
        return type(self)(**(dict(self) | changes))


# ---------------------------------------------------------------- values

LOCAL: Final = "local"
"""In place of a CRS: coordinates x, y, z of a frame of the surveyor's own, in metres and right-handed."""


Finite = Annotated[float, Field(allow_inf_nan=False)]
"""A number that is neither infinite nor NaN."""

NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
"""A finite number of at least zero."""

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
"""A finite number above zero."""

Vector3 = tuple[Finite, Finite, Finite]
"""Three numbers, x, y, z."""

Sigma3 = tuple[NonNegative, NonNegative, NonNegative]
"""Standard deviations of three components."""

Angle = Annotated[float, Field(ge=-360, le=360, allow_inf_nan=False)]
"""An angle in degrees."""

SigmaAngle = Annotated[float, Field(ge=0, le=90, allow_inf_nan=False)]
"""Standard deviation of an angle in degrees."""
Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0, le=1_000_000)]


def _odd(value: int) -> int:
    if value % 2 == 0:
        raise ValueError("an even number, which has no middle")
    return value


Odd = Annotated[int, Field(ge=1), AfterValidator(_odd)]
"""A number of rows or columns with one in the middle."""
