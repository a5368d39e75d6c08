"""Clouds and trajectories of all chains -> their numbers side by side, by range, and where curves cross."""

from pathlib import Path

import numpy as np
import pandas as pd

from thalweg.accuracy import (
    CHAINS,
    CLOUD_TO_MESH,
    Chain,
    chains_by_range,
    chains_table,
    crossings_m,
    range_facts,
)
from thalweg.budgets import read_budget, totals_mm
from thalweg.core import Trajectory, read_table, write_json
from thalweg.workflow import run_job


def main(
    *,
    trajectories: list[Path],
    counts: list[Path],
    statistics: list[Path],
    by_range: list[Path],
    distances: list[Path],
    budgets: list[Path],
    chains: Path,
    chains_by_range_csv: Path,
    facts: Path,
) -> None:
    """Lists are in the order of `CHAINS`, strips only where they were adjusted.

    Those of the comparison are empty where there is no reference.
    """
    found = []
    for k, name in enumerate(CHAINS[: len(trajectories)]):
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
    with_ranges = {chain.name: chain.by_range for chain in found if chain.by_range is not None}
    ranges = chains_by_range(with_ranges, published, at_m) if by_range else pd.DataFrame({"range_m": []})
    ranges.to_csv(chains_by_range_csv, index=False, float_format="%.9g")
    said = range_facts(ranges) if by_range else {}
    said["published_crossing_m"] = crossings_m(at_m, published["ins"], published["camera"])
    write_json(facts, said)


if "snakemake" in globals():
    run_job(main, snakemake)
