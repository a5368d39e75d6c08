"""Clouds and trajectories of all chains -> their numbers side by side, by range, and where curves cross."""

import json
from pathlib import Path

import numpy as np
import pandas as pd

from thalweg.accuracy.cloud_to_mesh.comparison import CLOUD_TO_MESH
from thalweg.accuracy.solutions.comparison import CHAINS, Chain, chains_table
from thalweg.accuracy.solutions.ranges import chains_by_range, crossings_m, range_facts
from thalweg.budgets.budget_file import read_budget
from thalweg.budgets.influences import totals_mm
from thalweg.core.tables import read_table
from thalweg.core.trajectory import Trajectory
from thalweg.workflow.job import run_job


def main(
    *, trajectories: list[Path], counts: list[Path], statistics: list[Path], by_range: list[Path],
    distances: list[Path], budgets: list[Path], chains: Path, chains_by_range_csv: Path, facts: Path,
) -> None:  # fmt: skip
    """Lists are in the order of `CHAINS`; those of the comparison are empty where there is no reference."""
    found = []
    for k, name in enumerate(CHAINS):
        table, compared = read_table(distances[k], CLOUD_TO_MESH) if distances else (None, None)
        found.append(
            Chain(
                name=name,
                counts=pd.read_csv(counts[k]),
                trajectory=Trajectory.read(trajectories[k]),
                statistics=pd.read_csv(statistics[k]) if statistics else None,
                by_range=pd.read_csv(by_range[k]) if by_range else None,
                distances=table,
                facts=compared,
            )
        )
    chains_table(found).to_csv(chains, index=False, float_format="%.9g")
    at_m = np.linspace(1.0, 200.0, 797)
    published = {
        name: totals_mm(read_budget(path), at_m) for name, path in zip(CHAINS, budgets, strict=False)
    }
    ranges = chains_by_range(found, published, at_m) if by_range else pd.DataFrame({"range_m": []})
    ranges.to_csv(chains_by_range_csv, index=False, float_format="%.9g")
    said = range_facts(ranges) if by_range else {}
    said["published_crossing_m"] = crossings_m(at_m, published["ins"], published["camera"])
    facts.write_text(json.dumps(said, indent=2) + "\n")


if "snakemake" in globals():
    run_job(main, snakemake)
