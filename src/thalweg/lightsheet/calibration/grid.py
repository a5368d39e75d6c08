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

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core.errors import ConfigError, GeometryError
from thalweg.core.mistakes import Key, Mistake
from thalweg.core.types import ArrayF
from thalweg.core.yaml_lines import Document, parse_yaml, read_yaml

VERSION: Final = 1
PATTERNS: Final = ("grid", "plate")
LEAST_SPACING_MM: Final = 10.0
"""Levels closer than this fix neither the direction of a sub-beam nor the sheet: at 10 mm, edges of half a
pixel leave the laser uncertain by centimetres."""

_SECTIONS: Final = ("thalweg_grid", "name", "levels", "sigma_common_mm", "grid")


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """A plane parallel to the window.

    Parameters
    ----------
    name : for tables and messages.
    pattern : ``grid`` if it lets parts of the light through, ``plate`` if not.
    depth_mm, sigma_mm : below the outer face of the window.
    """

    name: str
    pattern: str
    depth_mm: float
    sigma_mm: float


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
            )  # fmt: skip

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
    reader = _Reader(document)
    found = reader.grid() if not document.mistakes else None
    if reader.mistakes or found is None:
        told = sorted(reader.mistakes, key=lambda mistake: mistake.line)
        count = (
            f"{len(told)} mistake{'s' if len(told) > 1 else ''} in the description of the calibration object"
        )
        raise ConfigError(count + "".join(f"\n  {mistake}" for mistake in told), where=path or "")
    return GridObject(**found)


class _Reader:
    """Takes a document apart and notes every mistake on the way."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.mistakes = list(document.mistakes)

    def wrong(self, path: tuple[Key, ...], found: str, expected: str = "", cure: str = "") -> None:
        """Note a mistake with the line where it stands."""
        line = self.document.line(path)
        self.mistakes.append(Mistake(path=path, found=found, expected=expected, cure=cure, line=line))

    def grid(self) -> dict[str, Any] | None:
        """Arguments of `GridObject`, None if the document holds no keys."""
        data = self.document.data
        if not isinstance(data, dict):
            self.wrong((), "no keys with values", "a description that begins with thalweg_grid: 1")
            return None
        if data.get("thalweg_grid") != VERSION:
            self.wrong(
                ("thalweg_grid",), f"found {data.get('thalweg_grid')!r}", f"thalweg_grid: {VERSION}",
                "Add this line at the top",
            )  # fmt: skip
        self._known((), data, _SECTIONS)
        pattern = self._mapping(("grid",), data.get("grid"), ("thickness_mm", "along_x", "along_y"))
        return {
            "name": str(data.get("name") or "calibration object"),
            "levels": self._levels(data.get("levels")),
            "sigma_common_mm": self._number((), data, "sigma_common_mm", 0.0, 100.0, 0.0),
            "thickness_mm": self._number(("grid",), pattern, "thickness_mm", 0.0, 50.0, 0.0),
            "gaps_x_mm": self._gaps("along_x", pattern),
            "gaps_y_mm": self._gaps("along_y", pattern),
        }

    def _levels(self, data: Any) -> tuple[Level, ...]:
        if not isinstance(data, list) or not data:
            self.wrong(
                ("levels",),
                "missing" if data is None else f"found {data!r}",
                "a list, each entry with a dash",
            )
            return ()
        levels = []
        for i, item in enumerate(data):
            path: tuple[Key, ...] = ("levels", i)
            entry = self._mapping(path, item, ("name", "pattern", "depth_mm", "sigma_mm"), needed=True)
            if entry.get("pattern") not in PATTERNS:
                self.wrong(
                    (*path, "pattern"), f"found {entry.get('pattern')!r}", f"one of {', '.join(PATTERNS)}"
                )
            levels.append(
                Level(
                    name=str(entry.get("name") or f"level {i + 1}"),
                    pattern=str(entry.get("pattern")),
                    depth_mm=self._number(path, entry, "depth_mm", 0.0, 10000.0),
                    sigma_mm=self._number(path, entry, "sigma_mm", 0.0, 100.0),
                )
            )
        return tuple(levels)

    def _gaps(self, side: str, pattern: dict[str, Any]) -> ArrayF:
        path: tuple[Key, ...] = ("grid", side)
        if side not in pattern:
            return np.empty((0, 2))
        data = self._mapping(path, pattern[side], ("bar_mm", "gap_mm", "gaps", "gaps_mm"), needed=True)
        if "gaps_mm" in data:
            stated = data["gaps_mm"]
            good = isinstance(stated, list) and all(_interval(item) for item in stated)
            edges = np.asarray(stated, dtype=np.float64).reshape(-1, 2) if good else np.empty((0, 2))
            if not good or not (np.diff(edges.ravel()) > 0).all():
                self.wrong(
                    (*path, "gaps_mm"), f"found {stated!r}", "gaps as [from, to] in mm, one after the other"
                )
                return np.empty((0, 2))
            return edges
        bar = self._number(path, data, "bar_mm", 0.01, 1000.0)
        gap = self._number(path, data, "gap_mm", 0.01, 1000.0)
        count = self._number(path, data, "gaps", 1, 1000)
        if not (math.isfinite(count) and count == int(count)):
            if math.isfinite(count):
                self.wrong((*path, "gaps"), f"found {count:g}", "a whole number")
            return np.empty((0, 2))
        begin = bar + (bar + gap) * np.arange(int(count))
        return np.column_stack([begin, begin + gap])

    def _mapping(
        self, path: tuple[Key, ...], data: Any, keys: tuple[str, ...], *, needed: bool = False
    ) -> dict[str, Any]:
        if data is None and not needed:
            return {}
        if not isinstance(data, dict):
            self.wrong(path, f"found {data!r}", f"the keys {', '.join(keys)}")
            return {}
        self._known(path, data, keys)
        return data

    def _known(self, path: tuple[Key, ...], data: dict[str, Any], keys: tuple[str, ...]) -> None:
        for key in data:
            if key not in keys:
                self.wrong((*path, key), "unknown key", f"one of {', '.join(keys)}")

    def _number(
        self,
        path: tuple[Key, ...],
        data: dict[str, Any],
        key: str,
        low: float,
        high: float,
        default: float | None = None,
    ) -> float:
        value: Any = data.get(key, default)
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not math.isfinite(value) or not low <= value <= high:
            found = "missing" if key not in data else f"found {value!r}"
            self.wrong((*path, key), f"{key}: {found}", f"a number from {low:g} to {high:g}")
            return math.nan
        return float(value)


def _interval(item: Any) -> bool:
    """Whether an entry is a pair of finite numbers."""
    return (
        isinstance(item, list)
        and len(item) == 2
        and all(isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in item)
    )
