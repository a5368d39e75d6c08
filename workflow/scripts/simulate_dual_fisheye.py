"""River reach, campaign file and true mounts -> files of the dual fisheye and of its field, and the truth."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame
from thalweg.settings.sections import Rig
from thalweg.settings.twin import TwinConfig, TwinDualFisheye
from thalweg.workflow import run_job
from thalweg_lab.dual_fisheye import simulate_dual_fisheye
from thalweg_lab.voyage import read_true_mounts


def main(
    *,
    scene: Path,
    true_mounts: Path,
    images: Path,
    field_images: Path,
    field: Path,
    field_points: Path,
    poses: Path,
    panorama: Path,
    truth: Path,
    campaign: dict[str, Any],
    twin: dict[str, Any],
    dual_fisheye: dict[str, Any],
    rig: dict[str, Any],
) -> None:
    simulate_dual_fisheye(
        TwinConfig(**twin),
        TwinDualFisheye(**dual_fisheye),
        campaign["seed"],
        LocalFrame(**campaign["origin"]),
        scene,
        read_true_mounts(true_mounts),
        Rig(**rig),
        images=images,
        field_images=field_images,
        field=field,
        field_points=field_points,
        poses=poses,
        panorama=panorama,
        truth=truth,
    )


if "snakemake" in globals():
    run_job(main, snakemake)
