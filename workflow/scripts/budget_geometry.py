"""Published error tables -> the geometry that they imply, and what each assumption is needed for."""

from pathlib import Path

import pandas as pd

from thalweg.budgets import (
    left_out,
    published_setup,
    read_budget,
    read_published,
    reconstruct,
    solution_facts,
)
from thalweg.workflow import run_job


def main(
    *,
    budgets: list[Path],
    published: list[Path],
    assumptions: Path,
    solutions: Path,
    lever_lengths_m: dict[str, float],
) -> None:
    tables, facts = [], []
    for file, cells in zip(budgets, published, strict=True):
        setup = published_setup(read_budget(file), read_published(cells), lever_lengths_m[file.stem])
        facts.append({"table": file.stem, **solution_facts(reconstruct(setup))})
        tables.append(left_out(setup).assign(table=file.stem))
    pd.DataFrame(facts).to_csv(solutions, index=False)
    pd.concat(tables).to_csv(assumptions, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
