"""What was found out about INS, camera and fused trajectory -> one page."""

import json
from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.accuracy import CHAINS, outage_table
from thalweg.core import Trajectory
from thalweg.figures.solutions import Costs, computing_seconds, trajectory_comparison_page
from thalweg.workflow import run_job


def main(
    *,
    chains: Path,
    by_range: Path,
    facts: Path,
    camera_facts: Path,
    control: list[Path],
    truth: list[Path],
    fused_facts: Path,
    trajectories: list[Path],
    steps_ins: list[Path],
    steps_camera: list[Path],
    steps_fused: list[Path],
    pictures: list[Path],
    captions: dict[str, str],
    page: Path,
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    steps = dict(zip(CHAINS, (steps_ins, steps_camera, steps_fused), strict=True))
    trajectory_comparison_page(
        pd.read_csv(chains),
        pd.read_csv(by_range),
        json.loads(facts.read_text()),
        truth=pd.read_csv(truth[0]) if truth else None,
        costs=Costs(
            control=pd.read_csv(control[0]) if control else None,
            images=json.loads(camera_facts.read_text())["images_used"],
            seconds=computing_seconds(steps),
            outages=outage_table(
                json.loads(fused_facts.read_text())["outages"],
                {name: Trajectory.read(path) for name, path in zip(CHAINS, trajectories, strict=True)},
            ),
        ),
        pictures=pictures,
        captions=captions,
        title=f"INS, camera and fused trajectory: {campaign['title']}",
        twin=twin,
    ).write(page)


if "snakemake" in globals():
    run_job(main, snakemake)
