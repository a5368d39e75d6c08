"""Calibration of a twin's boat -> its errors against its true sensors and its true clock."""

from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.calibration import read_camera
from thalweg.clocks import ClockModel
from thalweg.core.calibration import read_calibration
from thalweg.settings.twin import TwinConfig
from thalweg.workflow import run_job
from thalweg_lab.truth import compare_calibration, compare_clock, compare_interior
from thalweg_lab.voyage import read_true_mounts, start_gps_s
from thalweg_lab.yard_images import true_camera


def main(
    *,
    boat: Path,
    camera_lidar: Path,
    camera: Path,
    clock: Path,
    true_mounts: Path,
    table: Path,
    twin: dict[str, Any],
) -> None:
    mounts, config = read_true_mounts(true_mounts), TwinConfig(**twin)
    lens = true_camera(config.camera, "boat")
    parts = [
        compare_calibration(read_calibration(camera_lidar), mounts),
        compare_calibration(read_calibration(boat), mounts),
        compare_interior(read_camera(camera), dict(zip(lens.parameter_names, lens.parameters, strict=True))),
        compare_clock(
            ClockModel.read(clock),
            start_gps_s=start_gps_s(config),
            ahead_s=config.camera.clock_offset_s,
            drift_ppm=config.camera.clock_drift_ppm,
        ),
    ]
    pd.concat(parts, ignore_index=True).to_csv(table, index=False, float_format="%.9g")


if "snakemake" in globals():
    run_job(main, snakemake)
