"""What was found out about INS, camera and fused trajectory -> one page."""

import json
from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.accuracy.solutions.comparison import CHAINS
from thalweg.accuracy.solutions.outages import outage_table
from thalweg.core.trajectory import Trajectory
from thalweg.figures.solutions.costs import computing_seconds
from thalweg.figures.solutions.page import trajectory_comparison_page
from thalweg.figures.solutions.words import Costs
from thalweg.workflow.job import run_job


def main(
    *, chains: Path, by_range: Path, facts: Path, camera_facts: Path, control: list[Path], truth: list[Path],
    fused_facts: Path, trajectories: list[Path], steps_ins: list[Path], steps_camera: list[Path],
    steps_fused: list[Path], pictures: list[Path], captions: list[Path], page: Path, twin: bool,
    campaign: dict[str, Any],
) -> None:  # fmt: skip
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
        captions={path.stem: " ".join(path.read_text(encoding="utf-8").split()) for path in captions},
        title=f"INS, camera and fused trajectory: {campaign['title']}",
        twin=twin,
    ).write(page)


if "snakemake" in globals():
    run_job(main, snakemake)
