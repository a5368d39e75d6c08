"""A scan beside its reference; where both contradict each other, which mistake would explain it.

A scan in the wrong medium, of pictures that were turned, or with the poses of other images lies anywhere. The
comparison is then repeated with part of the points under each reading that is known of, and the reading that
fits is named. On an object of parallel planes exchanged poses give no failure, only lines that disagree by
many times what their poses explain: the same search starts from there.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.errors import GeometryError, ThalwegError
from thalweg.core.types import ArrayF
from thalweg.lightsheet.calibration.other_readings import other_readings
from thalweg.lightsheet.lines.settings import LineFlag
from thalweg.lightsheet.optics.sensor import Sensor
from thalweg.lightsheet.poses.poses import SensorPoses
from thalweg.lightsheet.scanning.bimodality import bimodality
from thalweg.lightsheet.scanning.cloud import ScanCloud, merge
from thalweg.lightsheet.scanning.compare import Compared, compare_with_levels, compare_with_mesh
from thalweg.lightsheet.scanning.outliers import NMAD
from thalweg.lightsheet.scanning.profile import profiles
from thalweg.surface.cloud_to_mesh import Surface

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
Compare = Callable[[ScanCloud], Compared]


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
    Compared; its facts have ``brightness`` (`thalweg.lightsheet.scanning.bimodality`) and ``warnings``.

    Raises
    ------
    InputError : no image gives a point, or none has a pose.
    GeometryError : scan and reference contradict each other; the cure names the reading of pictures, medium
        or order that would explain it, if one of those known does.
    """

    def compare(cloud: ScanCloud) -> Compared:
        if levels_mm is None:
            return compare_with_mesh(cloud, surface, pairs)
        return compare_with_levels(cloud, surface, levels_mm, pairs)

    try:
        found = compare(merge(profiles(sensor, line_points)[0], poses))
    except GeometryError as error:
        cure = explanation(sensor, line_points, poses, compare, limit=DOUBT)
        raise GeometryError(
            error.found, expected=error.expected, where=error.where or "scan against its reference",
            cure=cure or error.cure,
        ) from error  # fmt: skip
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


def _by_brightness(found: Compared) -> tuple[dict[str, float | bool | str], str]:
    """Whether brightness shifts the distances (P4 7.2), and a warning if by more than they scatter."""
    on = found.used
    d, bright = found.distances.distance_mm[on], (found.cloud.flags[on] & LineFlag.SATURATED) != 0
    try:
        modes = bimodality(
            d, found.cloud.peak_dn[on], independent_share=found.cloud.where(on).independent_share,
            bright=bright if 3 <= bright.sum() <= len(bright) - 3 else None,
        )  # fmt: skip
    except GeometryError as error:
        return {"words": error.found}, ""
    facts: dict[str, float | bool | str] = {
        "shift_mm": modes.shift_mm, "sigma_shift_mm": modes.sigma_shift_mm,
        "by_brightness": modes.by_brightness, "two_modes": modes.bimodal, "words": modes.words(),
    }  # fmt: skip
    nmad = NMAD * float(np.median(np.abs(d - np.median(d))))
    if not modes.by_brightness or abs(modes.shift_mm) < nmad:
        return facts, ""
    what = "over-exposed" if np.isnan(modes.threshold_dn) else "bright"
    return facts, (
        f"{what} points lie {modes.shift_mm:+.2f} mm from the others, which scatter by {nmad:.2f} mm: the "
        "line is measured aside there (P4 7.2); expose shorter, or cover white markers"
    )


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
            rms = float(np.sqrt(np.mean(np.square(found.distances.distance_mm[used]))))
            best, told = scale, f"{cure} (then {rms:.2f} mm root mean square)"
    return told


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
