"""Survey lines between two banks, and how well a bed from their soundings will be known.

The kriging variance depends on places alone, not on depths: with a covariance of the bed, from an earlier
survey or assumed, it says before a survey what the survey will reach.
"""

import json
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from pyproj import CRS, Transformer

from thalweg.bathymetry.banks import Banks
from thalweg.bathymetry.bed import cells_of_river
from thalweg.bathymetry.kriging import CovarianceModel, Observations, krige
from thalweg.core import ArrayF, CoverageError, Grid, InputError, write_raster
from thalweg.settings.sections import Bathymetry

PATTERNS: Final = ("zigzag", "sections", "along")

_LEAST_WAY_M: Final = 0.5
"""Soundings of a plan are at least this far apart: closer ones tell the bed nothing more."""
_MOST: Final = 20_000
_CELLS: Final = 10_000
_QUANTILE: Final = 0.95
"""The wanted sigma holds for this share of the cells."""
_STEPS: Final = 14
"""Bisections of the width of the legs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SurveyPlan:
    """Lines of a survey.

    Parameters
    ----------
    pattern : one of `PATTERNS`.
    leg_m : distance of the legs: along the river, of ``along`` across it.
    waypoints_m : (k, 2) east and north, in the order of the course.
    length_m : of the course.
    grid, sigma_m : predicted standard deviation of the bed, NaN outside the banks.
    sigma_95_m : 95 % of the cells are known at least so well.
    """

    pattern: str
    leg_m: float
    waypoints_m: ArrayF
    length_m: float
    grid: Grid
    sigma_m: ArrayF
    sigma_95_m: float

    def write(self, folder: Path, facts: dict[str, Any]) -> None:
        """``waypoints.geojson`` and ``.gpx`` (WGS 84), ``sigma.tif``, ``plan.json``."""
        folder.mkdir(parents=True, exist_ok=True)
        lon, lat = Transformer.from_crs(self.grid.crs, 4326, always_xy=True).transform(*self.waypoints_m.T)
        at = np.column_stack([lon, lat]).round(8).tolist()
        features: list[dict[str, Any]] = [
            {
                "type": "Feature",
                "properties": {"pattern": self.pattern, "length_m": round(self.length_m, 1)},
                "geometry": {"type": "LineString", "coordinates": at},
            }
        ]
        features += [
            {
                "type": "Feature",
                "properties": {"number": k},
                "geometry": {"type": "Point", "coordinates": place},
            }
            for k, place in enumerate(at, 1)
        ]
        (folder / "waypoints.geojson").write_text(
            json.dumps({"type": "FeatureCollection", "features": features}) + "\n"
        )
        gpx = ET.Element(
            "gpx", version="1.1", creator="thalweg plan-survey", xmlns="http://www.topografix.com/GPX/1/1"
        )
        route = ET.SubElement(gpx, "rte")
        ET.SubElement(route, "name").text = f"{self.pattern}, {self.leg_m:.1f} m"
        for k, (x, y) in enumerate(at, 1):
            point = ET.SubElement(route, "rtept", lat=f"{y:.8f}", lon=f"{x:.8f}")
            ET.SubElement(point, "name").text = str(k)
        ET.ElementTree(gpx).write(folder / "waypoints.gpx", encoding="utf-8", xml_declaration=True)
        write_raster(folder / "sigma.tif", self.grid, {"sigma_m": self.sigma_m})
        (folder / "plan.json").write_text(json.dumps(facts, indent=2) + "\n")


def course(banks: Banks, pattern: str, leg_m: float, margin_m: float, span_m: tuple[float, float]) -> ArrayF:
    """Waypoints (k, 2) in flow coordinates.

    Parameters
    ----------
    banks : both shorelines.
    pattern : one of `PATTERNS`.
    leg_m : way along the river from bank to bank (zigzag) or between sections; across it between lines.
    margin_m : kept off the banks.
    span_m : part of the centre line.

    Raises
    ------
    CoverageError : the river is narrower than twice the margin.
    """
    first, last = span_m

    def shores(s: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Offsets of the left and the right end of a line at places along the river."""
        left, right = banks.half_widths_m(s)
        left, right = left - margin_m, right - margin_m
        if not (np.isfinite(left + right).all() and (left + right > 0).all()):
            raise CoverageError(
                f"no {2 * margin_m:g} m of water between the banks everywhere",
                expected="a river wider than twice the margin",
                cure="Lower --margin",
            )
        return left, -right

    if pattern == "along":
        s = np.linspace(first, last, max(int((last - first) / max(leg_m, 1.0)), 20))
        left, right = shores(s)
        lines = max(round(float(np.median(left - right)) / leg_m), 1) + 1
        parts = [
            np.column_stack([s, right + share * (left - right)])[:: 1 if k % 2 == 0 else -1]
            for k, share in enumerate(np.linspace(0.0, 1.0, lines))
        ]
        return np.concatenate(parts)
    s = np.linspace(first, last, max(round((last - first) / leg_m), 1) + 1)
    left, right = shores(s)
    even = np.arange(len(s)) % 2 == 0
    if pattern == "zigzag":
        return np.column_stack([s, np.where(even, left, right)])
    ends = np.column_stack([np.where(even, left, right), np.where(even, right, left)])
    return np.column_stack([np.repeat(s, 2), ends.ravel()])


def plan_survey(
    banks: Banks,
    crs: CRS,
    model: CovarianceModel,
    *,
    pattern: str,
    sigma_m: float,
    leg_m: float | None = None,
    margin_m: float = 2.0,
    sigma_sounding_m: float = 0.05,
) -> SurveyPlan:
    """Lines of a survey and the standard deviation of the bed that they give.

    Parameters
    ----------
    banks : both shorelines; the plan covers the part of the river where both are known.
    crs : of the map.
    model : covariance of the bed.
    pattern : one of `PATTERNS`.
    sigma_m : wanted for 95 % of the bed.
    leg_m : distance of the legs; None: the widest that reach ``sigma_m``.
    margin_m : kept off the banks.
    sigma_sounding_m : noise of a sounding.

    Raises
    ------
    InputError : the wanted sigma cannot be reached by any legs.
    CoverageError : the river is too narrow for the margin, or its banks do not run beside each other.
    """
    line = banks.line
    s = np.linspace(0, line.length_m, 2000)
    left, right = banks.half_widths_m(s)
    both = np.isfinite(left) & np.isfinite(right)
    if not both.any():
        raise CoverageError(
            "the banks do not lie beside each other anywhere", expected="two banks of one reach"
        )
    span = (float(s[both].min()), float(s[both].max()))
    width = float(np.median((left + right)[both]))
    cell = float(np.sqrt((span[1] - span[0]) * width / _CELLS))
    digits = 10.0 ** np.floor(np.log10(cell))
    cell = max(float(np.ceil(cell / digits) * digits), 0.1)
    shore = banks.table[["east_m", "north_m"]].to_numpy(np.float64)
    grid = Grid.around(shore, cell, crs, margin_m=cell)
    flow, inside = cells_of_river(
        grid.centres_m(), line, banks.half_widths_m, span, Bathymetry(cell_m=max(cell, 0.05))
    )

    def planned(leg: float) -> tuple[ArrayF, float, ArrayF, float]:
        """Corners and length of a course, sigma of all cells, and its 95 % quantile."""
        corners = line.to_map(*course(banks, pattern, leg, margin_m, span).T)
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
        step = max(_LEAST_WAY_M, leg / 20, float(way[-1]) / _MOST)
        at = np.arange(0.0, way[-1], step)
        xy = np.column_stack([np.interp(at, way, corners[:, k]) for k in (0, 1)])
        ps, pn, fold = line.to_flow(xy)
        ps, pn = ps[~fold], pn[~fold]
        known = Observations(
            s_m=ps,
            n_m=pn,
            height_m=np.zeros(len(ps)),
            sigma_white_m=np.full(len(ps), sigma_sounding_m),
            sigma_slow_m=np.zeros(len(ps)),
            t_s=np.full(len(ps), np.nan),
            line=np.zeros(len(ps), dtype=np.int64),
        )
        sigma = np.full(len(flow), np.nan)
        sigma[inside] = krige(known, flow[inside], model)[1]
        return corners, float(way[-1]), sigma, float(np.quantile(sigma[inside], _QUANTILE))

    if leg_m is None:
        low, high = max(width / 100, 0.5), span[1] - span[0] if pattern != "along" else width
        best = planned(low)
        if best[3] > sigma_m:
            raise InputError(
                f"{pattern} with legs of {low:.1f} m leaves 95 % of the bed known to {best[3]:.3f} m",
                expected=f"--sigma above that; {sigma_m:g} was wanted",
                cure="Lower --margin, take a smoother --relief or --variogram, or more exact soundings",
            )
        leg_m = low
        for _ in range(_STEPS):
            middle = float(np.sqrt(low * high))
            found = planned(middle)
            if found[3] <= sigma_m:
                low, best, leg_m = middle, found, middle
            else:
                high = middle
            if high / low < 1.03:
                break
    else:
        best = planned(leg_m)
    return SurveyPlan(
        pattern=pattern,
        leg_m=leg_m,
        waypoints_m=best[0],
        length_m=best[1],
        grid=grid,
        sigma_m=best[2],
        sigma_95_m=best[3],
    )
