"""Files of the rig, its clock and the trajectory -> when and where the front lens took each of them."""

import logging
from pathlib import Path

import numpy as np

from thalweg.clocks import ClockModel
from thalweg.core import Rigid, Trajectory, write_table
from thalweg.ingest.photos import IMAGE_STAMPS, read_image_stamps
from thalweg.navigation.camera import predict_image_poses
from thalweg.settings.sections import Rig
from thalweg.workflow import run_job


def main(
    *,
    images: list[Path],
    times: list[Path],
    trajectory: Path,
    stamps: Path,
    integrity: Path,
    poses: Path,
    rig: Rig,
) -> None:
    found = read_image_stamps(
        images,
        source=rig.times.source,
        pattern=rig.times.pattern,
        times=times[0] if times else None,
        utc_offset=rig.times.utc_offset,
    )
    write_table(stamps, found.table, IMAGE_STAMPS)
    found.report.write(integrity)
    known = found.table.dropna(subset=["t_device_s"])
    step_s = float(known["resolution_s"].max()) if len(known) else 0.0
    rounding_s = step_s / np.sqrt(12)
    if step_s > 0.1:
        logging.getLogger("thalweg").warning(
            "stamps of the rig are in steps of %g s: each is uncertain by %.2f s. Use the original names of "
            "the camera, which have milliseconds, or a table of times (logs.rig.times)",
            step_s,
            rounding_s,
        )
    clock = ClockModel(
        offset_s=rig.clock.offset_s,
        reference_s=float(known["t_device_s"].median()) if len(known) else 0.0,
        cov=np.diag([rig.clock.sigma_offset_s**2, 0.0]),
        jitter_s=float(np.hypot(rig.clock.jitter_s, rounding_s)),
        source="rig.clock of the campaign file",
    )
    mount = Rigid.from_mount(rig.mount.model_dump())
    predict_image_poses(found.table, clock, Trajectory.read(trajectory), mount).write(poses)


if "snakemake" in globals():
    run_job(main, snakemake)
