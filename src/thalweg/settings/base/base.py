"""The common base of all sections of a campaign file."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """A section of the campaign file: unknown keys are refused, values never change after loading."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)
