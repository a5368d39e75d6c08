"""A scan against its reference: aligned, bad poses found, numbers as P4 Table 3 (P4 7.3)."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core.errors import GeometryError
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayB, ArrayF
from thalweg.lightsheet.scanning.against_mesh import (
    MAX_DISTANCE_MM,
    MeshDistances,
    border_effect,
    honesty,
    normality,
)
from thalweg.lightsheet.scanning.alignment import Alignment, align, of_all
from thalweg.lightsheet.scanning.cloud import ScanCloud
from thalweg.lightsheet.scanning.line_check import LineCheck, check_lines
from thalweg.lightsheet.scanning.outliers import RULES, filtered
from thalweg.surface.cloud_to_mesh import Surface

_MOST_BAD: Final = 0.4
_ROUNDS: Final = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanResult:
    """Result of `scan_against_mesh`.

    ``alignment`` of the lines with good poses; ``distances`` and ``check`` of all points and lines, in the
    frame of the mesh; ``used`` (n,) points of good lines that have a counterpart.
    """

    alignment: Alignment
    check: LineCheck
    used: ArrayB

    @property
    def distances(self) -> MeshDistances:
        """Distances of all points."""
        return self.alignment.distances

    @property
    def distance_mm(self) -> ArrayF:
        """Distances of the points that count."""
        return self.distances.distance_mm[self.used]

    def table(self) -> pd.DataFrame:
        """All outlier rules, with the lines of bad poses and without them."""
        everything = self.distances.used
        rows = []
        for lines, keep in (("all lines", everything), ("without bad poses", self.used)):
            n = len(np.unique(self.alignment.cloud.number[keep]))
            d = self.distances.distance_mm[keep]
            rows += [{"points": lines, "lines": n, **filtered(d, rule).row()} for rule in RULES]
        return pd.DataFrame(rows)

    def facts(self) -> dict[str, Any]:
        """Everything else a report states."""
        found = self.alignment
        share = found.cloud.where(self.used).independent_share
        return {
            "counts": {**found.cloud.counts, **self.distances.counts(), "on_bad_lines": int(
                (self.distances.used & self.check.bad).sum()
            )},
            "images_left_out": found.cloud.left_out, "images_with_bad_pose": self.check.images,
            "line_limit_scale": self.check.scale, "sigma0": found.sigma0, "turns": found.turns,
            "sigma_turn_deg": np.rad2deg(found.T_mesh_target.sigma_rotation_rad).tolist(),
            "border": border_effect(self.distances), "shape": normality(self.distance_mm, share),
            "honesty": honesty(self.distances.distance_mm, self.distances.sigma_mm, self.used),
            "independent_share": share,
        }  # fmt: skip


def scan_against_mesh(
    cloud: ScanCloud,
    surface: Surface,
    start: Rigid,
    *,
    start_mm: float = 8.0,
    max_distance_mm: float = MAX_DISTANCE_MM,
    reference_sigma_mm: float = 0.0,
) -> ScanResult:
    """Align a scan, find lines with bad poses, align again without them.

    Parameters
    ----------
    cloud, surface, start, start_mm, max_distance_mm, reference_sigma_mm : see `align`.

    Raises
    ------
    GeometryError : more than 40 % of the lines lie off, or see `align`.
    UnobservableError : see `align`.
    """
    options = {"max_distance_mm": max_distance_mm, "reference_sigma_mm": reference_sigma_mm}
    found = align(cloud, surface, start, start_mm=start_mm, **options)
    check = check_lines(found.cloud, found.distances)
    for _ in range(_ROUNDS):
        if not check.bad.any():
            break
        judged = int(np.isfinite(check.table["statistic"]).sum())
        if len(check.images) > _MOST_BAD * judged:
            raise GeometryError(
                f"{len(check.images)} of {judged} lines lie off by more than their poses explain",
                expected="a few bad poses at most", where="scan against its reference",
                cure="Check that images and poses belong together (files in one order, nothing renamed), and "
                "that the panel was not moved on the sensor",
            )  # fmt: skip
        good = align(
            cloud.where(~check.bad), surface, found.T_mesh_target, start_mm=max_distance_mm, **options
        )
        found = of_all(good, cloud, surface, **options)
        again = check_lines(found.cloud, found.distances)
        if again.images == check.images:
            check = again
            break
        check = again
    return ScanResult(alignment=found, check=check, used=found.distances.used & ~check.bad)
