"""Image poses with times and INS -> trajectory of the boat by its camera, and the lidar's place by it."""

from pathlib import Path
from typing import Any

import numpy as np

from thalweg.calibration import read_mounts, write_mounts
from thalweg.core import Trajectory, read_table, write_chains, write_json
from thalweg.core.calibration import read_calibration
from thalweg.images.model import ImagePoses
from thalweg.ingest import INS_STATE
from thalweg.navigation.camera import CloudSettings, camera_trajectory, lidar_mount_by_camera
from thalweg.settings.sections import CameraCloud
from thalweg.workflow import run_job


def main(
    *,
    poses: ImagePoses,
    states: Path,
    mounts: Path,
    trajectory_camera: Path,
    mounts_camera: Path,
    images: Path,
    facts: Path,
    errors: Path,
    cloud: CameraCloud,
    orientation: dict[str, Any],
    ins: dict[str, Any],
    trajectory: Trajectory | None,
    boat: Path | None,
) -> None:
    places, T_ics_ccs, placed = lidar_mount_by_camera(
        read_mounts(mounts), read_calibration(boat) if boat else None
    )
    found = camera_trajectory(
        poses,
        T_ics_ccs,
        CloudSettings.of(cloud),
        states=read_table(states, INS_STATE)[0],
        sigma_attitude_rad=np.deg2rad([ins[f"sigma_{a}_deg"] for a in ("roll", "pitch", "heading")]),
        max_attitude_gap_s=orientation["max_attitude_gap_s"],
        trajectory=trajectory,
    )
    found.trajectory.write(trajectory_camera)
    write_mounts(mounts_camera, places)
    found.images.to_csv(images, index=False, float_format="%.6f")
    write_json(facts, {**found.facts, "lidar": placed})
    write_chains(errors, found.error_chains())


if "snakemake" in globals():
    run_job(main, snakemake)
