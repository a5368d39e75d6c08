"""Where a second epoch differs from the first one.

Each change has a place of its own along the flow, a function of the settings alone, and acts inside it only.
Vegetation that has grown is the exception: bushes, grass and reeds are larger everywhere.
"""

from dataclasses import dataclass

import numpy as np

from thalweg.core.types import AnyArray, ArrayB, ArrayF
from thalweg.settings.twin.scene import Change, TwinScene


@dataclass(frozen=True, slots=True)
class Stretch:
    """A part of the reach along the flow: its middle and half length, metres."""

    middle_m: float
    half_m: float

    def bump(self, s_m: AnyArray) -> ArrayF:
        """One in the middle, exactly zero outside, smooth to the first derivative."""
        x = (np.asarray(s_m, dtype=np.float64) - self.middle_m) / self.half_m
        return np.asarray(np.where(np.abs(x) < 1.0, (1.0 - np.minimum(x * x, 1.0)) ** 2, 0.0))

    def holds(self, s_m: AnyArray) -> ArrayB:
        """Whether places lie inside."""
        return np.asarray(np.abs(np.asarray(s_m) - self.middle_m) < self.half_m)


_PLACES: dict[str, tuple[float, float]] = {
    # Share of the length, greatest half length in metres.
    "undercut_bank": (0.15, 45.0),
    "moved_boulders": (0.02, 20.0),
    "scour": (-0.10, 12.0),
    "fallen_tree": (-0.22, 9.0),
    "gravel_bar": (-0.34, 22.0),
}
_SHARE = 0.11
"""No change is longer than twice this share of the reach."""


def stretch(scene: TwinScene, change: Change) -> Stretch:
    """Where along the reach a change acts; the whole reach for ``grown_vegetation``."""
    if change == "grown_vegetation":
        return Stretch(0.0, scene.length_m)
    place, half = _PLACES[change]
    return Stretch(place * scene.length_m, min(half, _SHARE * scene.length_m))
