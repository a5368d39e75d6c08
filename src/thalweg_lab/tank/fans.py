"""What is lit: a single light sheet, or the lines of a laser behind a grating."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thalweg.core.types import ArrayF
from thalweg.lightsheet.optics.sensor import LightSheet
from thalweg_lab.tank.grating import Grating


@dataclass(frozen=True, slots=True, kw_only=True)
class GratingLine:
    """One line of a grating, by its number from 0."""

    grating: Grating
    number: int

    @property
    def half_angle_rad(self) -> float:
        """Largest fan angle on either side."""
        return self.grating.half_angle_rad


Fan = LightSheet | GratingLine


def lines_of(grating: Grating, numbers: Sequence[int] | None = None) -> tuple[GratingLine, ...]:
    """Lines of a grating, all if no numbers are given."""
    wanted = range(len(grating.cosine_offsets)) if numbers is None else numbers
    return tuple(GratingLine(grating=grating, number=k) for k in wanted)


def rays_of(fan: Fan, a_rad: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Origins and unit directions (n, 3) in air, lcs, of sub-beams (n,)."""
    if isinstance(fan, GratingLine):
        return fan.grating.beams(np.full(len(a_rad), fan.number), a_rad)
    return np.broadcast_to(fan.origin_lcs_mm, (len(a_rad), 3)), fan.beams(a_rad)
