"""A scan beside its reference: a mesh, or parallel planes of known heights (P4 7.3, Table 3, Fig. 19 and 20).

A mesh of an object that has parallel planes only leaves shifts along them free, so nearest places have
nothing to converge to. Such an object is compared with its planes: two tilts and a height are adjusted.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.clocks.ties.hand_tables import read_number_columns
from thalweg.core.errors import GeometryError
from thalweg.core.rigid import Rigid
from thalweg.core.tables import column, frame_of, table_kind
from thalweg.core.types import ArrayB, ArrayF
from thalweg.lightsheet.poses.poses import M_PER_MM
from thalweg.lightsheet.scanning.against_mesh import MeshDistances, honesty, mesh_distances, normality
from thalweg.lightsheet.scanning.alignment import from_pairs
from thalweg.lightsheet.scanning.cloud import ScanCloud
from thalweg.lightsheet.scanning.levels import Levels, fit_levels
from thalweg.lightsheet.scanning.line_check import LineCheck, check_lines
from thalweg.lightsheet.scanning.outliers import RULES, TABLE_2, TABLE_3, filtered
from thalweg.lightsheet.scanning.scan import scan_against_mesh
from thalweg.surface.cloud_to_mesh import Surface

PUBLISHED_NAMES: Final = {"stepped": "stepped_object"}
"""Scan -> object in the published tables, where they differ."""

_LEVELS_OFF: Final = 3.0
_LEAST_OFF_MM: Final = 0.4
"""Scatter about the common planes, in that about planes of their own and in mm, that only wrong heights
leave."""

_LEAST_ON_LEVEL: Final = 10
_MANY_BESIDE: Final = 0.3

PAIR_COLUMNS: Final = tuple(f"{where}_{a}_m" for where in ("scan", "mesh") for a in "xyz")
_F = pa.float64()

SCAN_DISTANCES: Final = table_kind(
    "scan_distances",
    1,
    [
        column("file", pa.string(), "1", "name of the image"),
        *(column(f"{a}_m", _F, "m", f"{a} in the frame of the reference") for a in "xyz"),
        column("distance_mm", _F, "mm", "signed distance from the reference, positive in front of it"),
        column("sigma_mm", _F, "mm", "its predicted standard deviation"),
        column("sigma_own_mm", _F, "mm", "share of the image measurement"),
        column("sigma_pose_mm", _F, "mm", "share of the pose of the image"),
        column("peak_dn", _F, "1", "height of the line above its background"),
        column("flags", pa.uint8(), "1", "as in the line points"),
        column("used", pa.bool_(), "1", "the point has a counterpart and its line a good pose"),
        column("reason", pa.string(), "1", "why it is not used: far, at_border, bad_pose"),
    ],
)
"""Points of a scan with their distances."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """A scan in the frame of its reference, distances of all points, lines with bad poses, and facts."""

    cloud: ScanCloud
    distances: MeshDistances
    check: LineCheck
    facts: dict[str, Any]

    @property
    def used(self) -> ArrayB:
        """(n,) points with a counterpart on lines with good poses."""
        return self.distances.used & ~self.check.bad


def read_pairs(path: Path) -> tuple[ArrayF, ArrayF]:
    """Picked places (n, 3) of scan and mesh, metres, from a CSV table.

    Raises
    ------
    InputError : the file is missing, or lacks a column or a number.
    """
    columns = read_number_columns(path, PAIR_COLUMNS)
    return np.stack(columns[:3], axis=1), np.stack(columns[3:], axis=1)


def compare_with_mesh(
    cloud: ScanCloud, surface: Surface, pairs: tuple[ArrayF, ArrayF], *, picked_mm: float = 8.0
) -> Compared:
    """Align a scan with a mesh and measure distances, see `scan_against_mesh`.

    Parameters
    ----------
    cloud : in the frame of its poses.
    surface : of the reference.
    pairs : picked places, see `read_pairs`.
    picked_mm : how far points may lie off after the pairs alone.
    """
    found = scan_against_mesh(cloud, surface, from_pairs(*pairs), start_mm=picked_mm)
    T = found.alignment.T_mesh_target
    facts = {"reference": "mesh", **found.facts(), "R_reference_target": T.R.tolist(),
             "shift_reference_target_m": T.shift_m.tolist()}  # fmt: skip
    return Compared(cloud=found.alignment.cloud, distances=found.distances, check=found.check, facts=facts)


def compare_with_levels(
    cloud: ScanCloud,
    surface: Surface,
    heights_mm: tuple[float, ...],
    pairs: tuple[ArrayF, ArrayF],
    *,
    picked_mm: float = 4.0,
    near_mm: float = 3.0,
) -> Compared:
    """Distances of a scan from parallel planes that are fitted to it.

    Parameters
    ----------
    cloud : in the frame of its poses.
    surface : mesh of the object: points that lie farther than ``picked_mm`` from it after the pairs alone are
        not on the object. The ground around it may be nearer to a level than the next level is.
    heights_mm : of the planes, growing.
    pairs : picked places; they tell which way is up, the planes tell the rest.
    near_mm : half width of the layers whose points lie on a plane.

    Raises
    ------
    GeometryError : see `fit_levels`; levels that are plane each, but do not lie at these heights.
    """
    T = from_pairs(*pairs)
    here = cloud.moved(T, "reference")
    up = np.array([0.0, 0.0, 1.0])
    own, _, _ = here.variances_along(np.tile(up, (len(here), 1)))
    on = mesh_distances(here, surface, max_distance_mm=picked_mm).used
    found = fit_levels(
        here.xyz_m[on] / M_PER_MM, up, heights_mm=heights_mm, sigma_mm=np.sqrt(own[on]) / M_PER_MM,
        near_mm=near_mm,
    )  # fmt: skip
    _require_heights(found, heights_mm)
    distance, far = np.full(len(here), near_mm), np.ones(len(here), dtype=np.bool_)
    distance[on], far[on] = np.nan_to_num(found.distance_mm, nan=near_mm), ~found.used
    normal = np.tile(found.normal, (len(here), 1))
    single, pose, _ = here.variances_along(normal)
    distances = MeshDistances(
        distance_mm=distance, normal=normal,
        sigma_own_mm=np.sqrt(single) / M_PER_MM, sigma_pose_mm=np.sqrt(pose) / M_PER_MM,
        # errors that all points share shift and tilt the planes with them; how they bend them is left out
        sigma_shared_mm=np.zeros(len(here)), sigma_reference_mm=np.zeros(len(here)),
        at_border=np.zeros(len(here), dtype=np.bool_), far=far,
    )  # fmt: skip
    check = check_lines(here, distances)
    used = distances.used & ~check.bad
    share = here.where(used).independent_share
    facts = {
        "reference": "planes", "counts": {**here.counts, **distances.counts(),
                                          "on_bad_lines": int((distances.used & check.bad).sum())},
        "images_left_out": here.left_out, "images_with_bad_pose": check.images,
        "line_limit_scale": check.scale, "sigma0": float(np.sqrt(found.adjusted.sigma0_squared)),
        "shape": normality(distances.distance_mm[used], share),
        "honesty": honesty(distances.distance_mm, distances.sigma_mm, used), "independent_share": share,
        "levels": level_facts(found, heights_mm), "warnings": level_warnings(found, heights_mm),
        "R_reference_target": T.R.tolist(),
        "shift_reference_target_m": T.shift_m.tolist(),
    }  # fmt: skip
    return Compared(cloud=here, distances=distances, check=check, facts=facts)


def _require_heights(found: Levels, heights_mm: tuple[float, ...]) -> None:
    """Refuse heights that are not those of the object: a tilt then takes up the mean of their errors."""
    n = np.maximum(found.plane_n - 3, 0)
    if not n.any():
        return
    own = float(np.sqrt(np.nansum(n * found.plane_rms_mm**2) / n.sum()))
    off = float(np.sqrt(np.mean(np.square(found.distance_mm[found.used]))))
    if off > max(_LEVELS_OFF * own, _LEAST_OFF_MM):
        raise GeometryError(
            f"each level is plane to {own:.2f} mm, but together they lie {off:.2f} mm off planes at "
            f"{', '.join(f'{h:g}' for h in heights_mm)} mm",
            expected="levels at these heights", where="levels",
            cure="Check light_sheet.levels_mm of this scan, and the refractive indices of the sensor",
        )  # fmt: skip


def level_warnings(found: Levels, heights_mm: tuple[float, ...]) -> list[str]:
    """What a reader must know of the levels: some without points, or many points on none."""
    told = []
    empty = [h for h, n in zip(heights_mm, found.plane_n, strict=True) if n < _LEAST_ON_LEVEL]
    if empty:
        told.append(
            f"hardly a point lies on the level at {', '.join(f'{h:g}' for h in empty)} mm: it was not "
            "scanned, or lies at another height"
        )
    beside = int((~found.used).sum())
    if beside > _MANY_BESIDE * len(found.used):
        told.append(
            f"{beside} of {len(found.used)} points on the object lie on none of its levels: check "
            "light_sheet.levels_mm"
        )
    return told


def level_facts(found: Levels, heights_mm: tuple[float, ...]) -> list[dict[str, float]]:
    """Height of each level over the first plane beside the stated one, and RMS from a plane of its own."""
    return [
        {"height_mm": float(h), "measured_mm": float(m), "rms_own_plane_mm": float(r), "n": int(n)}
        for h, m, r, n in zip(
            heights_mm, found.plane_height_mm, found.plane_rms_mm, found.plane_n, strict=True
        )
    ]


def statistics(found: Compared, name: str) -> pd.DataFrame:
    """All outlier rules with all lines and without bad poses, beside P4 Table 3 where it has the object."""
    rows = []
    for lines, keep in (("all lines", found.distances.used), ("without bad poses", found.used)):
        n = len(np.unique(found.cloud.number[keep]))
        d = found.distances.distance_mm[keep]
        rows += [{"points": lines, "lines": n, **filtered(d, rule).row()} for rule in RULES]
    return pd.concat([pd.DataFrame(rows), published(name, TABLE_3)], ignore_index=True)


def published(name: str, table: pd.DataFrame = TABLE_2) -> pd.DataFrame:
    """Row of a published table for an object, with the columns of `statistics`; empty if it has none."""
    known = table[table["object"] == PUBLISHED_NAMES.get(name, name)]
    share = known["n_kept"] / known["n"]
    return known.drop(columns="object").assign(points="published", rule="3 sigma", share_kept=share)


def distance_table(found: Compared) -> pd.DataFrame:
    """Table of kind `SCAN_DISTANCES`."""
    cloud, d = found.cloud, found.distances
    reason = np.select([d.far, d.at_border, found.check.bad], ["far", "at_border", "bad_pose"], default="")
    names = np.array(cloud.poses.images, dtype=object)
    return frame_of(SCAN_DISTANCES, {
        "file": names[cloud.number], **{f"{a}_m": cloud.xyz_m[:, i] for i, a in enumerate("xyz")},
        "distance_mm": d.distance_mm, "sigma_mm": d.sigma_mm, "sigma_own_mm": d.sigma_own_mm,
        "sigma_pose_mm": d.sigma_pose_mm, "peak_dn": cloud.peak_dn, "flags": cloud.flags,
        "used": found.used, "reason": reason.astype(object),
    })  # fmt: skip


def to_reference(facts: dict[str, Any]) -> Rigid:
    """Motion from the frame of the poses to that of the reference, as the facts of a comparison have it."""
    return Rigid(
        R=np.asarray(facts["R_reference_target"], dtype=np.float64),
        shift_m=np.asarray(facts["shift_reference_target_m"], dtype=np.float64),
    )
