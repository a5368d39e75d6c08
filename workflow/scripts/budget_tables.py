"""Error budgets -> tables, what whole published tables imply, page with a verdict on each published cell."""

from pathlib import Path

import pandas as pd

from thalweg.budgets import long_table, read_budget
from thalweg.workflow import run_job
from thalweg_lab.reproduction import (
    left_out,
    page,
    published_setup,
    read_published,
    reconstruct,
    solution_facts,
    what_the_cells_tell,
)


def main(
    *,
    budgets: list[Path],
    published: list[Path],
    tables: list[Path],
    budget_page: Path,
    verdicts_text: Path,
    lever_lengths_m: dict[str, float],
    camera: str,
    ins: str,
) -> None:
    read = {
        budget.stem: (read_budget(budget), read_published(cells))
        for budget, cells in zip(budgets, published, strict=True)
    }
    for (budget, _), csv in zip(read.values(), tables, strict=True):
        long_table(budget).to_csv(csv, index=False)
    facts, needed = [], []
    for name, length_m in lever_lengths_m.items():
        setup = published_setup(*read[name], length_m)
        facts.append({"table": name, **solution_facts(reconstruct(setup))})
        needed.append(left_out(setup).assign(table=name))
    worth = what_the_cells_tell([read[camera], read[ins]])
    text = page(
        read,
        camera=camera,
        ins=ins,
        worth=worth,
        assumptions=pd.concat(needed),
        solutions=pd.DataFrame(facts),
    )
    budget_page.write_text(text, encoding="utf-8")
    verdicts_text.write_text(f"{worth}\nCell by cell: {budget_page}\n", encoding="utf-8")


if "snakemake" in globals():
    run_job(main, snakemake)
