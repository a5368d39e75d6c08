"""Surveys of the digital twin by INS, camera and fused trajectory -> distances to one bank, and goals."""

import json
import tempfile
from pathlib import Path

import numpy as np

from thalweg.accuracy.cloud_to_mesh.comparison import CLOUD_TO_MESH
from thalweg.accuracy.solutions.comparison import CHAINS
from thalweg.accuracy.solutions.ranges import range_facts
from thalweg.budgets.budget_file import read_budget
from thalweg.budgets.influences import totals_mm
from thalweg.core.tables import write_table
from thalweg.workflow.job import run_job
from thalweg_lab.studies import chain_study_tables as tables
from thalweg_lab.studies.chain_study import chain_study, comparison_settings


def main(
    *, budgets: list[Path], table: Path, goals: Path, by_range: Path, facts: Path, distances: list[Path],
    page: Path, first_seed: int, seeds: int, threads: int,
) -> None:  # fmt: skip
    """Budgets and distances are in the order of `CHAINS`."""
    studies = tables.both_settings()
    with tempfile.TemporaryDirectory(prefix="thalweg_chains_") as folder:
        found = chain_study(
            Path(folder), studies, seeds=range(first_seed, first_seed + seeds), processes=threads
        )
    numbers = tables.study_table(found)
    numbers.to_csv(table, index=False, float_format="%.6g")
    tables.goals_table(numbers).to_csv(goals, index=False, float_format="%.6g")
    at_m = np.linspace(1.0, 200.0, 797)
    published = {
        name: totals_mm(read_budget(path), at_m) for name, path in zip(CHAINS, budgets, strict=False)
    }
    settings = comparison_settings(studies[0].settings(1), 1)
    ranges = tables.ranges_of(found[tables.DISTURBED], settings, published, at_m)
    ranges.to_csv(by_range, index=False, float_format="%.9g")
    said = range_facts(ranges)
    facts.write_text(json.dumps(said, indent=2) + "\n")
    for path, rows in zip(distances, tables.pooled(found[tables.DISTURBED]).values(), strict=True):
        write_table(path, rows, CLOUD_TO_MESH, {"setting": tables.DISTURBED, "surveys": seeds})
    page.write_text(tables.as_markdown(numbers, said), encoding="utf-8")


if "snakemake" in globals():
    run_job(main, snakemake)
