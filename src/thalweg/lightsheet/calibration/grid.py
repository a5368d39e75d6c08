"""The grid calibration object: levels at known depths; the upper ones let parts of the sheet through.

A YAML file describes it::

    thalweg_grid: 1
    name: printed grid over a plate
    levels:
      - {name: grid, pattern: grid, depth_mm: 60.0, sigma_mm: 0.05}
      - {name: plate, pattern: plate, depth_mm: 150.0, sigma_mm: 0.05}
    sigma_common_mm: 0.0
    grid:
      thickness_mm: 0.0
      along_x: {bar_mm: 9.0, gap_mm: 6.0, gaps: 12}
      along_y: {gaps_mm: [[10.0, 90.0]]}

Depths count from the outer face of the window. ``sigma_mm`` is that of each level for itself,
``sigma_common_mm`` that of the whole object below the window. The grid begins and ends with a bar; gaps are
stated by their number and widths, or as a list of [from, to] from the edge of the object (P3 fig. 4, P4 fig.
9).
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Final, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from thalweg.core import ArrayF, Document, GeometryError, Part, checked, parse_yaml, read_yaml, wrong

LEAST_SPACING_MM: Final = 10.0
"""Levels closer than this fix neither the direction of a sub-beam nor the sheet: at 10 mm, edges of half a
pixel leave the laser uncertain by centimetres."""


class Level(Part):
    """A plane parallel to the window.

    Parameters
    ----------
    name : for tables and messages.
    pattern : ``grid`` if it lets parts of the light through, ``plate`` if not.
    depth_mm, sigma_mm : below the outer face of the window.
    """

    name: str = ""
    pattern: Literal["grid", "plate"]
    depth_mm: Annotated[float, Field(ge=0.0, le=10_000.0)]
    sigma_mm: Annotated[float, Field(ge=0.0, le=100.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class GridObject:
    """Calibration object of two or three levels.

    Parameters
    ----------
    name : for people.
    levels : from the nearest to the farthest; the last one is a plate, all others are grids.
    sigma_common_mm : of the depth of the whole object.
    gaps_x_mm, gaps_y_mm : (g, 2) begin and end of the gaps of the grid along both sides of the object.
    thickness_mm : of the bars; a thick bar shades one more strip below it.

    Raises
    ------
    GeometryError : fewer than two levels, swapped levels, or levels too close together.
    """

    name: str
    levels: tuple[Level, ...]
    sigma_common_mm: float = 0.0
    gaps_x_mm: ArrayF = field(default_factory=lambda: np.empty((0, 2)))
    gaps_y_mm: ArrayF = field(default_factory=lambda: np.empty((0, 2)))
    thickness_mm: float = 0.0

    def __post_init__(self) -> None:
        where = f"calibration object {self.name!r}"
        names = [level.name for level in self.levels]
        if len(self.levels) < 2:
            raise GeometryError(
                f"{len(self.levels)} level ({', '.join(names)})" if names else "no level",
                expected="two or three levels: a line on one level leaves the sheet free to turn about it",
                where=where,
                cure="Put a plate below the grid, and measure the depth of both",
            )
        if len(set(names)) < len(names):
            raise GeometryError(f"levels {', '.join(names)}", expected="each name once", where=where)
        for upper, lower in zip(self.levels[:-1], self.levels[1:], strict=True):
            if upper.pattern == "plate" or lower.depth_mm < upper.depth_mm:
                raise GeometryError(
                    f"the levels are swapped: {upper.name!r} ({upper.pattern}, {upper.depth_mm:g} mm deep) "
                    "stands "
                    f"above {lower.name!r} ({lower.pattern}, {lower.depth_mm:g} mm deep)",
                    expected="grids first and the plate at the end, each deeper than the one before: light "
                    "passes "
                    "a grid, not a plate",
                    where=where,
                    cure="Exchange their depths or their patterns; depths count from the outer face of the "
                    "window",
                )
            if lower.depth_mm - upper.depth_mm < LEAST_SPACING_MM:
                raise GeometryError(
                    f"the levels {upper.name!r} and {lower.name!r} are {lower.depth_mm - upper.depth_mm:.2f} "
                    "mm apart",
                    expected=f"at least {LEAST_SPACING_MM:g} mm, better levels at both ends of the working "
                    "range",
                    where=where,
                    cure="Move the plate down: outside the levels the sigma of the depth grows fast",
                )
        if self.levels[-1].pattern != "plate":
            raise GeometryError(
                f"the deepest level {names[-1]!r} is a grid",
                expected="a plate that stops the light",
                where=where,
                cure="State pattern: plate for the deepest level",
            )

    @property
    def depths_mm(self) -> ArrayF:
        """(k,) depths of the levels."""
        return np.array([level.depth_mm for level in self.levels])

    @property
    def cov_depths_mm2(self) -> ArrayF:
        """(k, k) covariance of the depths."""
        own = np.diag(np.square([level.sigma_mm for level in self.levels]))
        return np.asarray(own + self.sigma_common_mm**2)


def read_grid(path: Path) -> GridObject:
    """Read the description of a calibration object.

    Raises
    ------
    ConfigError : the file is missing or holds mistakes; all are told, each with its line.
    GeometryError : an object that cannot calibrate anything.
    """
    return _described(read_yaml(path), path)


def parse_grid(text: str) -> GridObject:
    """The same from text."""
    return _described(parse_yaml(text), None)


def _described(document: Document, path: Path | None) -> GridObject:
    found = checked(_Object, document, what="description of the calibration object", where=path)
    return GridObject(
        name=found.name or "calibration object",
        levels=tuple(
            level if level.name else level.model_copy(update={"name": f"level {i}"})
            for i, level in enumerate(found.levels, 1)
        ),
        sigma_common_mm=found.sigma_common_mm,
        thickness_mm=found.grid.thickness_mm if found.grid else 0.0,
        gaps_x_mm=_edges(found.grid.along_x if found.grid else None),
        gaps_y_mm=_edges(found.grid.along_y if found.grid else None),
    )


_Width = Annotated[float, Field(ge=0.01, le=1000.0)]


class _Gaps(Part):
    bar_mm: _Width | None = None
    gap_mm: _Width | None = None
    gaps: Annotated[int, Field(ge=1, le=1000)] | None = None
    gaps_mm: list[Annotated[list[float], Field(min_length=2, max_length=2)]] | None = Field(
        default=None, description="gaps as [from, to] in mm, one after the other"
    )

    @model_validator(mode="after")
    def _stated(self) -> Self:
        lacking = [name for name in ("bar_mm", "gap_mm", "gaps") if getattr(self, name) is None]
        if self.gaps_mm is None and lacking:
            raise wrong(f"{', '.join(lacking)}: missing", "bar_mm, gap_mm and gaps, or gaps_mm")
        if self.gaps_mm is not None and not (np.diff(np.ravel(self.gaps_mm)) > 0).all():
            expected = "gaps as [from, to] in mm, one after the other"
            raise wrong(f"found {self.gaps_mm!r}", expected, at=("gaps_mm",))
        return self


class _Pattern(Part):
    thickness_mm: Annotated[float, Field(ge=0.0, le=50.0)] = 0.0
    along_x: _Gaps | None = None
    along_y: _Gaps | None = None


class _Object(Part):
    thalweg_grid: Literal[1]
    name: str | None = None
    levels: list[Level] = Field(min_length=1)
    sigma_common_mm: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0
    grid: _Pattern | None = None


def _edges(gaps: _Gaps | None) -> ArrayF:
    """(g, 2) begin and end of the gaps."""
    if gaps is None:
        return np.empty((0, 2))
    if gaps.gaps_mm is not None:
        return np.asarray(gaps.gaps_mm, dtype=np.float64).reshape(-1, 2)
    assert gaps.bar_mm is not None
    assert gaps.gap_mm is not None
    begin = gaps.bar_mm + (gaps.bar_mm + gaps.gap_mm) * np.arange(gaps.gaps or 0)
    return np.column_stack([begin, begin + gaps.gap_mm])
