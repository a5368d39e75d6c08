"""A scan beside its reference: a mesh, or parallel planes of known heights (P4 7.3, Table 3, Fig. 19 and 20).

A mesh of an object that has parallel planes only leaves shifts along them free, so nearest places have
nothing to converge to. Such an object is compared with its planes: two tilts and a height are adjusted.

Where both contradict each other, the mistake is looked for that would explain it. A scan in the wrong medium,
of pictures that were turned, or with the poses of other images lies anywhere. The comparison is then repeated
with part of the points under each reading that is known of, and the reading that fits is named. On an object
of parallel planes exchanged poses give no failure, only lines that disagree by many times what their poses
explain: the same search starts from there.

One profile of the scan is judged by itself (`single_profile`).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.clocks import read_number_columns
from thalweg.core import (
    ArrayB,
    ArrayF,
    GeometryError,
    InputError,
    Rigid,
    ThalwegError,
    column,
    frame_of,
    robust_sigma,
    root_mean_square,
    table_kind,
)
from thalweg.lightsheet.calibration import other_readings
from thalweg.lightsheet.lines import LineFlag
from thalweg.lightsheet.optics import Sensor
from thalweg.lightsheet.poses import M_PER_MM, SensorPoses
from thalweg.lightsheet.scanning.alignment import Alignment, LineCheck, align, check_lines, from_pairs, of_all
from thalweg.lightsheet.scanning.distances import (
    MAX_DISTANCE_MM,
    RULES,
    TABLE_2,
    TABLE_3,
    MeshDistances,
    bimodality,
    border_effect,
    consistency,
    filtered,
    mesh_distances,
    normality,
)
from thalweg.lightsheet.scanning.levels import Levels, fit_levels
from thalweg.lightsheet.scanning.profile import (
    ScanCloud,
    independent_share,
    merge,
    profile_of_table,
    profiles,
    sigma_along,
)
from thalweg.surface import Surface

_MOST_BAD: Final = 0.4
_ROUNDS: Final = 3


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

DOUBT: Final = 25.0
"""Median of the lines' statistics over its expectation: half of the lines are off by five sigmas."""
_BETTER: Final = 0.1
"""A disagreement of lines that many times smaller is an explanation."""
_SHARE: Final = 0.3
"""Of the points that must have a counterpart for a reading to count."""
_LEAST_LINES: Final = 3
_POINTS_OF_LINE: Final = 150
_SHIFTS: Final = (-2, -1, 1, 2)

Pairs = tuple[ArrayF, ArrayF]

TILT_SIGMA_RAD: Final = 0.003
"""How well the window stands parallel to the levels: a single line tells no tilt across itself."""


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
        return _by_rule(self.alignment.cloud, self.distances, self.used)

    def facts(self) -> dict[str, Any]:
        """Everything else a report states."""
        found = self.alignment
        return _shared_facts(found.cloud, self.distances, self.check, self.used, found.sigma0) | {
            "turns": found.turns,
            "sigma_turn_deg": np.rad2deg(found.T_mesh_target.sigma_rotation_rad).tolist(),
            "border": border_effect(self.distances),
        }


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


Compare = Callable[[ScanCloud], Compared]


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
                expected="a few bad poses at most",
                where="scan against its reference",
                cure="Check that images and poses belong together (files in one order, nothing renamed), and "
                "that the panel was not moved on the sensor",
            )
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
    facts = {
        "reference": "mesh",
        **found.facts(),
        "R_reference_target": T.R.tolist(),
        "shift_reference_target_m": T.shift_m.tolist(),
    }
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
        here.xyz_m[on] / M_PER_MM,
        up,
        heights_mm=heights_mm,
        sigma_mm=np.sqrt(own[on]) / M_PER_MM,
        near_mm=near_mm,
    )
    _require_heights(found, heights_mm)
    distance, far = np.full(len(here), near_mm), np.ones(len(here), dtype=np.bool_)
    distance[on], far[on] = np.nan_to_num(found.distance_mm, nan=near_mm), ~found.used
    normal = np.tile(found.normal, (len(here), 1))
    single, pose, _ = here.variances_along(normal)
    distances = MeshDistances(
        distance_mm=distance,
        normal=normal,
        sigma_own_mm=np.sqrt(single) / M_PER_MM,
        sigma_pose_mm=np.sqrt(pose) / M_PER_MM,
        # errors that all points share shift and tilt the planes with them; how they bend them is left out
        sigma_shared_mm=np.zeros(len(here)),
        sigma_reference_mm=np.zeros(len(here)),
        at_border=np.zeros(len(here), dtype=np.bool_),
        far=far,
    )
    check = check_lines(here, distances)
    used = distances.used & ~check.bad
    sigma0 = float(np.sqrt(found.adjusted.sigma0_squared))
    facts = _shared_facts(here, distances, check, used, sigma0) | {
        "reference": "planes",
        "levels": level_facts(found, heights_mm),
        "warnings": level_warnings(found, heights_mm),
        "R_reference_target": T.R.tolist(),
        "shift_reference_target_m": T.shift_m.tolist(),
    }
    return Compared(cloud=here, distances=distances, check=check, facts=facts)


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


def _by_rule(cloud: ScanCloud, distances: MeshDistances, used: ArrayB) -> pd.DataFrame:
    """All outlier rules, with the lines of bad poses and without them."""
    rows = []
    for lines, keep in (("all lines", distances.used), ("without bad poses", used)):
        n = len(np.unique(cloud.number[keep]))
        d = distances.distance_mm[keep]
        rows += [{"points": lines, "lines": n, **filtered(d, rule).row()} for rule in RULES]
    return pd.DataFrame(rows)


def _shared_facts(
    cloud: ScanCloud, distances: MeshDistances, check: LineCheck, used: ArrayB, sigma0: float
) -> dict[str, Any]:
    """What is stated of distances from a mesh and of those from planes."""
    share = cloud.where(used).independent_share
    return {
        "counts": {
            **cloud.counts,
            **distances.counts(),
            "on_bad_lines": int((distances.used & check.bad).sum()),
        },
        "images_left_out": cloud.left_out,
        "images_with_bad_pose": check.images,
        "line_limit_scale": check.scale,
        "sigma0": sigma0,
        "shape": normality(distances.distance_mm[used], share),
        "consistency": consistency(distances.distance_mm, distances.sigma_mm, used),
        "independent_share": share,
    }


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
    rows = _by_rule(found.cloud, found.distances, found.used)
    return pd.concat([rows, published(name, TABLE_3)], ignore_index=True)


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
    return frame_of(
        SCAN_DISTANCES,
        {
            "file": names[cloud.number],
            **{f"{a}_m": cloud.xyz_m[:, i] for i, a in enumerate("xyz")},
            "distance_mm": d.distance_mm,
            "sigma_mm": d.sigma_mm,
            "sigma_own_mm": d.sigma_own_mm,
            "sigma_pose_mm": d.sigma_pose_mm,
            "peak_dn": cloud.peak_dn,
            "flags": cloud.flags,
            "used": found.used,
            "reason": reason.astype(object),
        },
    )


def to_reference(facts: dict[str, Any]) -> Rigid:
    """Motion from the frame of the poses to that of the reference, as the facts of a comparison have it."""
    return Rigid(
        R=np.asarray(facts["R_reference_target"], dtype=np.float64),
        shift_m=np.asarray(facts["shift_reference_target_m"], dtype=np.float64),
    )


def compare_scan(
    sensor: Sensor,
    line_points: pd.DataFrame,
    poses: SensorPoses,
    surface: Surface,
    pairs: Pairs,
    levels_mm: tuple[float, ...] | None = None,
) -> Compared:
    """Compare a scan with its reference.

    Parameters
    ----------
    sensor : calibrated.
    line_points : of all images, `thalweg.lightsheet.poses.series.SERIES_POINTS`.
    poses : of the images.
    surface : reference mesh.
    pairs : picked places, see `thalweg.lightsheet.scanning.compare.read_pairs`.
    levels_mm : heights of the planes of an object that consists of such; None: compared with the mesh.

    Returns
    -------
    Compared; its facts have ``brightness`` (`thalweg.lightsheet.scanning.distances`) and ``warnings``.

    Raises
    ------
    InputError : no image gives a point, or none has a pose.
    GeometryError : scan and reference contradict each other; the cure names the reading of pictures, medium
        or order that would explain it, if one of those known does.
    """

    def compare(cloud: ScanCloud) -> Compared:
        """One cloud against the reference."""
        if levels_mm is None:
            return compare_with_mesh(cloud, surface, pairs)
        return compare_with_levels(cloud, surface, levels_mm, pairs)

    try:
        found = compare(merge(profiles(sensor, line_points)[0], poses))
    except GeometryError as error:
        cure = explanation(sensor, line_points, poses, compare, limit=DOUBT)
        raise GeometryError(
            error.found,
            expected=error.expected,
            where=error.where or "scan against its reference",
            cure=cure or error.cure,
        ) from error
    warnings = found.facts.setdefault("warnings", [])
    found.facts["brightness"], bias = _by_brightness(found)
    if bias:
        warnings.append(bias)
    if found.check.scale < DOUBT:
        return found
    words = (
        f"half of the lines lie off the reference by more than {np.sqrt(found.check.scale):.0f} times what "
        "their poses explain"
    )
    cure = explanation(sensor, line_points, poses, compare, limit=_BETTER * found.check.scale)
    if cure:
        raise GeometryError(
            words, expected="lines that agree with each other", where="scan against its reference", cure=cure
        )
    warnings.append(f"{words}: no line can be told from the others by its pose")
    return found


def explanation(
    sensor: Sensor, line_points: pd.DataFrame, poses: SensorPoses, compare: Compare, *, limit: float
) -> str:
    """The reading under which the lines of a scan agree best; "" if none makes them agree.

    Parameters
    ----------
    sensor, line_points, poses : see `compare_scan`.
    compare : of a cloud in the frame of the poses.
    limit : disagreement of lines (`thalweg.lightsheet.scanning.compare.LineCheck.scale`) that a reading
        must stay below.
    """
    few = line_points.iloc[:: max(1, len(line_points) // (_POINTS_OF_LINE * max(len(poses), 1)))]
    best, told = limit, ""
    for cure, other, points, moved in _readings(sensor, few, poses):
        try:
            found = compare(merge(profiles(other, points)[0], moved))
        except (ThalwegError, np.linalg.LinAlgError):
            continue
        used, scale = found.distances.used, found.check.scale
        judged = int(found.check.table["statistic"].notna().sum())
        if used.mean() > _SHARE and judged >= _LEAST_LINES and scale < best:
            rms = root_mean_square(found.distances.distance_mm[used])
            best, told = scale, f"{cure} (then {rms:.2f} mm root mean square)"
    return told


def middle_image(distances: pd.DataFrame) -> str:
    """Name of the image in the middle of a scan, among those that have at least half of the most points.

    Parameters
    ----------
    distances : `thalweg.lightsheet.scanning.compare.SCAN_DISTANCES`.

    Raises
    ------
    InputError : no point is used.
    """
    counts = distances[distances["used"]].groupby("file", sort=False).size()
    if not len(counts):
        raise InputError("no point of the scan is used", expected="points on the reference", where="profile")
    full = counts[counts >= 0.5 * counts.max()].index
    return str(full[len(full) // 2])


def single_profile(
    sensor: Sensor,
    line_points: pd.DataFrame,
    distances: pd.DataFrame,
    name: str,
    heights_mm: tuple[float, ...] | None = None,
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Statistics of the scan's middle profile.

    Parameters
    ----------
    sensor : calibrated.
    line_points : of all images of the scan.
    distances : of the scan from its reference; for an object without levels its alignment counts for the
        profile too, because a line alone leaves the motion along a surface free.
    name : of the scan.
    heights_mm : levels of the object, which are then fitted to this line alone.

    Returns
    -------
    A row for each outlier rule and the published one, and facts: image, levels, bimodality.
    """
    image = middle_image(distances)
    facts: dict[str, Any] = {"image": image}
    if heights_mm is None:
        mine = distances[(distances["file"] == image) & distances["used"]]
        d, peak = mine["distance_mm"].to_numpy(), mine["peak_dn"].to_numpy()
        share = 1.0 / max(float(line_points["rows"][line_points["file"] == image].mean()), 1.0)
    else:
        one = profile_of_table(sensor, line_points, image)
        up = sensor.window.normal_lcs
        own, _ = sigma_along(one.own_mm, one.shared_mm, up)
        found = fit_levels(
            one.xyz_lcs_mm, up, heights_mm=heights_mm, sigma_mm=own, tilt_sigma_rad=TILT_SIGMA_RAD
        )
        on = found.used
        d, peak = found.distance_mm[on], one.peak_dn[on]
        share = independent_share(one.rows[on], one.piece[on])
        facts |= {"levels": level_facts(found, heights_mm), "points_on_no_level": int((~on).sum())}
    rows = pd.DataFrame([{"points": "middle line", "lines": 1, **filtered(d, rule).row()} for rule in RULES])
    try:
        facts["bimodality"] = bimodality(d, peak, independent_share=share).words()
    except GeometryError as error:
        facts["bimodality"] = error.found
    facts["rms_mm"] = root_mean_square(d)
    return pd.concat([rows, published(name, TABLE_2)], ignore_index=True), facts


def _require_heights(found: Levels, heights_mm: tuple[float, ...]) -> None:
    """Refuse heights that are not those of the object: a tilt then takes up the mean of their errors."""
    n = np.maximum(found.plane_n - 3, 0)
    if not n.any():
        return
    own = float(np.sqrt(np.nansum(n * found.plane_rms_mm**2) / n.sum()))
    off = root_mean_square(found.distance_mm[found.used])
    if off > max(_LEVELS_OFF * own, _LEAST_OFF_MM):
        raise GeometryError(
            f"each level is plane to {own:.2f} mm, but together they lie {off:.2f} mm off planes at "
            f"{', '.join(f'{h:g}' for h in heights_mm)} mm",
            expected="levels at these heights",
            where="levels",
            cure="Check light_sheet.levels_mm of this scan, and the refractive indices of the sensor",
        )


def _by_brightness(found: Compared) -> tuple[dict[str, float | bool | str], str]:
    """Whether brightness shifts the distances (P4 7.2), and a warning if by more than they scatter."""
    on = found.used
    d, bright = found.distances.distance_mm[on], (found.cloud.flags[on] & LineFlag.SATURATED) != 0
    try:
        modes = bimodality(
            d,
            found.cloud.peak_dn[on],
            independent_share=found.cloud.where(on).independent_share,
            bright=bright if 3 <= bright.sum() <= len(bright) - 3 else None,
        )
    except GeometryError as error:
        return {"words": error.found}, ""
    facts: dict[str, float | bool | str] = {
        "shift_mm": modes.shift_mm,
        "sigma_shift_mm": modes.sigma_shift_mm,
        "by_brightness": modes.by_brightness,
        "two_modes": modes.bimodal,
        "words": modes.words(),
    }
    nmad = robust_sigma(d)
    if not modes.by_brightness or abs(modes.shift_mm) < nmad:
        return facts, ""
    what = "over-exposed" if np.isnan(modes.threshold_dn) else "bright"
    return facts, (
        f"{what} points lie {modes.shift_mm:+.2f} mm from the others, which scatter by {nmad:.2f} mm: the "
        "line is measured aside there (P4 7.2); expose shorter, or cover white markers"
    )


def _readings(
    sensor: Sensor, points: pd.DataFrame, poses: SensorPoses
) -> Iterator[tuple[str, Sensor, pd.DataFrame, SensorPoses]]:
    """What else the scan could be: cure, sensor, points, poses."""
    for reading in other_readings(sensor, points):
        yield reading.cure, reading.sensor, reading.points, poses
    names = poses.images
    yield (
        "The poses fit the images in reverse order: the recordings of both run against each other, sort the "
        "files by time",
        sensor,
        points,
        replace(poses, images=names[::-1]),
    )
    for shift in _SHIFTS:
        if len(names) > 4 * abs(shift):
            yield (
                f"Each pose fits the image {abs(shift)} {'before' if shift > 0 else 'after'} its own: one "
                "recording began later, or lost a picture; give marks the names of the images they belong to",
                sensor,
                points,
                replace(poses, images=(*names[-shift:], *names[:-shift])),
            )
