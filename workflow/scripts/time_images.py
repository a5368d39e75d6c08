"""Image poses, stamps, positions and INS -> the same poses with times, and the camera's clock."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from thalweg.calibration import read_mounts
from thalweg.clocks import ClockModel, Track, synchronise
from thalweg.core import LocalFrame, read_table, write_json, write_table
from thalweg.core.calibration import read_calibration
from thalweg.images.model import ImagePoses, in_folders
from thalweg.ingest import GNSS_POSITION, INS_STATE
from thalweg.ingest.photos import IMAGE_STAMPS
from thalweg.navigation.camera import antenna_in_camera, lidar_mount_by_camera, time_images
from thalweg.navigation.ins_gnss import with_stated
from thalweg.workflow import run_job


def main(
    *,
    poses: Path,
    stamps: Path,
    positions: Path,
    states: Path,
    mounts: Path,
    timed: Path,
    times: Path,
    clock: Path,
    report: Path,
    frame: LocalFrame,
    source: str,
    stated: dict[str, Any],
    options: dict[str, Any],
    cloud: dict[str, Any],
    camera_clock: ClockModel | None,
    boat: Path | None,
    off_boat: list[str],
) -> None:
    places = read_mounts(mounts)
    _, T_ics_ccs, _ = lidar_mount_by_camera(places, read_calibration(boat) if boat else None)
    # the INS's own positions, and an SBET's, are those of the body's origin
    own = {"lever_ics_m": (0.0, 0.0, 0.0), "sigma_lever_m": (0.0, 0.0, 0.0)}
    measured = own if source in ("ins", "sbet") else places["antenna"]
    lever_m, cov_m2 = antenna_in_camera(T_ics_ccs, measured["lever_ics_m"], measured["sigma_lever_m"])
    gnss = Track.from_table(
        with_stated(read_table(positions, GNSS_POSITION)[0], **stated),
        frame,
        correlation_time_s=options["position_time_s"],
        white_share=options["white_share"],
    )
    table = read_table(stamps, IMAGE_STAMPS)[0]
    found = time_images(
        ImagePoses.read(poses),
        table[~in_folders(table["file"], off_boat)],
        track=gnss,
        ins=synchronise.run_attitude(read_table(states, INS_STATE)[0], frame, options),
        clock=camera_clock,
        options=replace(synchronise.offset_options(options), lever_m=lever_m, cov_lever_m2=cov_m2),
        use=cloud["image_times"],
        clock_from=cloud["clock"],
        images_together=cloud["images_together"],
    )
    found.poses.write(timed)
    write_table(times, found.table, synchronise.IMAGE_TIMES)
    found.clock.write(clock)
    write_json(report, found.facts)


if "snakemake" in globals():
    run_job(main, snakemake)
