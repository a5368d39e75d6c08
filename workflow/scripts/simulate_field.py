"""Campaign file -> description of the twin's calibration field, its truth and the true static poses."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame
from thalweg.settings.twin import TwinConfig
from thalweg.workflow import run_job
from thalweg_lab.yard_records import simulate_field


def main(
    *, field: Path, field_truth: Path, field_poses: Path, campaign: dict[str, Any], twin: dict[str, Any]
) -> None:
    simulate_field(
        TwinConfig(**twin),
        campaign["seed"],
        LocalFrame(**campaign["origin"]),
        out_field=field,
        out_truth=field_truth,
        out_poses=field_poses,
    )


if "snakemake" in globals():
    run_job(main, snakemake)
