"""How images are masked, and what the parts of an image are called."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final, Self

SKY: Final = 0
WATER: Final = 1
LAND: Final = 2
HULL: Final = 3
"""Codes of label pictures; only land is usable."""

PARTS: Final[dict[str, int]] = {"sky": SKY, "water": WATER, "land": LAND, "hull": HULL}


@dataclass(frozen=True, slots=True, kw_only=True)
class MaskSettings:
    """Section ``images.masks`` of a campaign file, for the functions that mask.

    Parameters
    ----------
    analysis_px : longest side at which images are analysed; the water line at half of it.
    sample_images : images at most, evenly over the series, from which the colours are learned.
    margin_share : strip above the water line that is masked as well, share of the image's height.
    hull_margin_share : the same around the own hull.
    pose_sigma_deg : least standard deviation of an approximate horizon, degrees.
    least_usable_share : images with a smaller usable share are named in the note.
    seed : for the choice of sample pixels.
    """

    analysis_px: int = 640
    sample_images: int = 40
    margin_share: float = 0.006
    hull_margin_share: float = 0.006
    pose_sigma_deg: float = 3.0
    least_usable_share: float = 0.03
    seed: int = 0

    @classmethod
    def from_section(cls, section: Mapping[str, Any], seed: int = 0) -> Self:
        """From section ``images.masks`` and the campaign's seed."""
        names = {f.name for f in fields(cls)} & set(section)
        return cls(**{name: section[name] for name in names}, seed=seed)
