"""When and where the files of a rig were taken: stamps, the clock of the rig, the trajectory of the boat."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import Rigid, Trajectory
from thalweg.images.model import ImagePoses
from thalweg.ingest import IntegrityReport
from thalweg.ingest.photos import read_image_stamps
from thalweg.navigation.camera import predict_image_poses, stated_clock
from thalweg.settings.sections import Rig

COARSE_S: Final = 0.1
"""Stamps in steps from this on are warned of: the boat moves by a decimetre in a tenth of a second."""
_LOG = logging.getLogger("thalweg")


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacedFiles:
    """Files of a rig: table kind ``image_stamps``, its report, and poses of the front lens."""

    stamps: pd.DataFrame
    report: IntegrityReport
    poses: ImagePoses


def place_rig_files(
    images: Sequence[Path], trajectory: Trajectory, rig: Rig, *, times: Path | None = None
) -> PlacedFiles:
    """Poses of the front lens at all files.

    Parameters
    ----------
    images : files, or folders of them.
    trajectory : ``T_wcs_ics`` of the boat.
    rig : section ``rig``: how the times are written, clock, mount.
    times : table of times, if neither names nor EXIF have them.

    Returns
    -------
    placed : a file without stamp, outside the trajectory or of the same time as another one has no pose and
        says why. A stamp in whole seconds adds 0.29 s to its standard deviation, and this is told.

    Raises
    ------
    InputError, ClockError : no file, or none with a time.
    CoverageError : none lies inside the trajectory.
    """
    found = read_image_stamps(
        list(images),
        source=rig.times.source,
        pattern=rig.times.pattern,
        times=times,
        utc_offset=rig.times.utc_offset,
    )
    known = found.table.dropna(subset=["t_device_s"])
    step_s = float(known["resolution_s"].max())
    rounding_s = step_s / np.sqrt(12)
    if step_s > COARSE_S:
        note = (
            f"Stamps of the rig are in steps of {step_s:g} s: each is uncertain by {rounding_s:.2f} s. Use "
            "the original names of the camera, which have milliseconds, or a table of times (logs.rig.times)."
        )
        found.report.note(note)
        _LOG.warning(note)
    if rig.clock.sigma_offset_s > COARSE_S:
        note = (
            f"The clock of the rig is known to {rig.clock.sigma_offset_s:g} s only (rig.clock), and so are "
            "the places of its files along the way. Photograph a clock that shows GPS time or UTC, and state "
            "rig.clock.offset_s with its sigma."
        )
        found.report.note(note)
        _LOG.warning(note)
    clock = stated_clock(found.table, rig.clock, "rig.clock of the campaign file")
    mount = Rigid.from_mount(rig.mount.model_dump())
    poses = predict_image_poses(found.table, clock, trajectory, mount)
    return PlacedFiles(
        stamps=found.table, report=found.report, poses=_each_time_once(poses, found.table, found.report)
    )


def _each_time_once(poses: ImagePoses, stamps: pd.DataFrame, report: IntegrityReport) -> ImagePoses:
    """Of files of one time the first has a pose."""
    t = stamps["t_device_s"]
    twice = (t.duplicated() & t.notna()).to_numpy()
    if not twice.any():
        return poses
    names = stamps["file"].astype(str).tolist()
    reasons = list(poses.reasons)
    for k in np.flatnonzero(twice):
        first = names[int(np.flatnonzero((t == t.iloc[k]).to_numpy())[0])]
        reasons[k] = f"of the same time as {first}"
        report.note(f"{names[k]} is of the same time as {first}: a copy, or a clock that stood still.")
    report.lose("files_of_one_time", int(twice.sum()))
    return replace(poses, oriented=poses.oriented & ~twice, reasons=tuple(reasons))
