"""Poses of a scan, panel, standing camera, sensor and cloud -> figure of the set-up."""

from pathlib import Path
from typing import Any

from thalweg.core.tables import read_parquet
from thalweg.figures.style import save
from thalweg.lightsheet.figures.scan_setup import scan_setup
from thalweg.lightsheet.optics.sensor_files import read_sensor
from thalweg.lightsheet.poses.files import read_poses
from thalweg.lightsheet.poses.panel_poses import read_panel, read_standing_camera
from thalweg.workflow.job import run_job


def main(
    *, sensor: Path, poses: Path, panel: list[Path], camera: list[Path], points: Path, scan_setup_png: Path,
    figures: dict[str, Any], twin: bool, campaign: dict[str, Any], scanned: str,
) -> None:  # fmt: skip
    figure = scan_setup(
        read_sensor(sensor), read_poses(poses), read_panel(panel[0]).points_pcs,
        read_standing_camera(camera[0]), read_parquet(points),
        title=f"{campaign['title']}, scan of {scanned.replace('_', ' ')}", twin=twin,
    )  # fmt: skip
    save(figure, scan_setup_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
