"""Test objects with known geometry: a plane panel, the stepped object of P4 7.1, the two-level grid (P3 2.4).

Frames of the objects are in millimetres with Z up; X runs along the laser line.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayF
from thalweg_lab.tank.meshes import Pieces, box, rectangle
from thalweg_lab.tank.surfaces import Spots, Surface

STEP_HEIGHTS_MM: Final = (0.006, 20.195, 40.135)
"""Levels of the stepped object from plane fits (P4 7.1)."""

STEP_SIZE_MM: Final = (300.0, 65.0, 45.0)
"""Length, width and height of the stepped object (P4 7.1)."""

BLACK: Final = (0.04, 0.04, 0.04)
WHITE: Final = (0.9, 0.9, 0.9)
GREY: Final = (0.45, 0.45, 0.45)
SAND: Final = (0.42, 0.36, 0.28)


def panel(
    *, size_mm: float = 420.0, albedo: tuple[float, float, float] = GREY, markers: bool = False
) -> Surface:
    """A plane panel about its origin, if wished with a grid of black round marks of 3 mm radius."""
    pieces = Pieces()
    half = size_mm / 2
    pieces.add(rectangle((-half, half), (-half, half), 0.0), 0)
    spots = None
    if markers:
        at = np.arange(-half + 20.0, half, 40.0)
        X, Y = np.meshgrid(at, at)
        centre = np.stack([X.ravel(), Y.ravel(), np.zeros(X.size)], axis=1)
        spots = Spots(centre_mm=centre, radius_mm=np.full(len(centre), 3.0), albedo=BLACK)
    return pieces.surface(np.array([albedo]), "panel", spots=spots)


def stepped_markers_mm() -> ArrayF:
    """(n, 3) centres of the white marks on the three levels of the stepped object."""
    out = []
    for level, height in enumerate(STEP_HEIGHTS_MM):
        for x in -150.0 + 100.0 * level + np.array([14.0, 32.0, 50.0, 68.0, 86.0]):
            out += [(x, y, height) for y in (-22.0, -7.0, 8.0, 23.0)]
    return np.array(out)


def stepped_object(*, markers: bool = True, marker_radius_mm: float = 4.0) -> Surface:
    """The black stepped object on a sandy ground; its origin is the middle at height 0."""
    length, width, height = STEP_SIZE_MM
    ground = STEP_HEIGHTS_MM[-1] - height
    pieces = Pieces()
    for level, top in enumerate(STEP_HEIGHTS_MM):
        x = -length / 2 + level * length / 3
        low, high = np.array([x, -width / 2, ground]), np.array([x + length / 3, width / 2, top])
        pieces.add(box(low, high), 0)
    pieces.add(rectangle((-260.0, 260.0), (-260.0, 260.0), ground), 1)
    spots = None
    if markers:
        centres = stepped_markers_mm()
        spots = Spots(centre_mm=centres, radius_mm=np.full(len(centres), marker_radius_mm), albedo=WHITE)
    return pieces.surface(np.array([BLACK, SAND]), "stepped_object", spots=spots)


@dataclass(frozen=True, slots=True, kw_only=True)
class GridPattern:
    """Geometry of the calibration object with two or three levels, in its own frame.

    X runs along the line, Y across, Z up; Z = 0 is the top of the upper plate.

    Parameters
    ----------
    gaps_mm : (k, 2) begin and end of each gap of the upper plate along X, in order.
    levels_mm : heights of the levels, the upper first: (0, -90) or (0, -45, -90).
    slot_half_mm : the gaps reach from -this to +this in Y.
    half_size_mm : half length and half width of the upper plate.
    thickness_mm : of the upper plate; 0 for bevelled edges, which clip a beam at one place.
    """

    gaps_mm: ArrayF
    levels_mm: tuple[float, ...] = (0.0, -90.0)
    slot_half_mm: float = 22.0
    half_size_mm: tuple[float, float] = (95.0, 30.0)
    thickness_mm: float = 0.0

    def __post_init__(self) -> None:
        """Refuse gaps and levels that make no grid.

        Raises
        ------
        GeometryError : gaps overlap or leave the plate, or levels do not go downwards.
        """
        edges = np.asarray(self.gaps_mm, dtype=np.float64).ravel()
        if not (np.diff(edges) > 0).all() or np.abs(edges).max() >= self.half_size_mm[0]:
            raise GeometryError(
                f"gaps with the edges {edges.tolist()} mm",
                expected=f"growing numbers within {self.half_size_mm[0]:g} mm of the middle",
            )
        if (
            len(self.levels_mm) not in (2, 3)
            or self.levels_mm[0] != 0.0
            or not (np.diff(self.levels_mm) < 0).all()
        ):
            raise GeometryError(f"levels {self.levels_mm} mm", expected="two or three, from 0 downwards")

    @classmethod
    def regular(
        cls,
        *,
        count: int = 11,
        pitch_mm: float = 10.0,
        gap_mm: float = 3.5,
        levels_mm: tuple[float, ...] = (0.0, -90.0),
    ) -> "GridPattern":
        """Equal gaps; the middle one is half as wide again, so that a shift by one gap shows."""
        centre = pitch_mm * (np.arange(count) - (count - 1) / 2)
        width = np.full(count, gap_mm)
        width[count // 2] *= 1.5
        gaps = np.stack([centre - width / 2, centre + width / 2], axis=1)
        return cls(gaps_mm=gaps, levels_mm=levels_mm)

    def bars_mm(self) -> ArrayF:
        """(k + 1, 2) begin and end of what is between the gaps, the ends of the plate included."""
        edges = np.concatenate([[-self.half_size_mm[0]], self.gaps_mm.ravel(), [self.half_size_mm[0]]])
        return edges.reshape(-1, 2)


def grid_object(pattern: GridPattern) -> Surface:
    """The calibration object: a white plate with gaps above a white plate; a third level fills one half.

    The middle level lies below the half with X > 0 only, so that gaps there show the first and the second
    level and the others the first and the third.
    """
    pieces = Pieces()
    half_x, half_y = pattern.half_size_mm
    slot, t = pattern.slot_half_mm, pattern.thickness_mm
    parts = [((-half_x, half_x), (-half_y, -slot)), ((-half_x, half_x), (slot, half_y))]
    parts += [((float(a), float(b)), (-slot, slot)) for a, b in pattern.bars_mm()]
    for x, y in parts:
        if t > 0:
            pieces.add(box(np.array([x[0], y[0], -t]), np.array([x[1], y[1], 0.0])), 0)
        else:
            pieces.add(rectangle(x, y, 0.0), 0)
    if len(pattern.levels_mm) == 3:
        pieces.add(rectangle((0.0, 200.0), (-160.0, 160.0), pattern.levels_mm[1]), 1)
    pieces.add(rectangle((-260.0, 260.0), (-260.0, 260.0), pattern.levels_mm[-1]), 1)
    return pieces.surface(np.array([GREY, GREY]), "calibration_grid")
