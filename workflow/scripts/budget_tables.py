"""Error budgets -> CSV and LaTeX, what whole tables imply, page and text with verdicts on published cells."""

from pathlib import Path

import pandas as pd

from thalweg.budgets import (
    latex,
    left_out,
    long_table,
    page,
    published_setup,
    read_budget,
    read_published,
    reconstruct,
    solution_facts,
    statements,
    terminal_text,
    what_the_cells_tell,
)
from thalweg.workflow import run_job


def main(
    *,
    budgets: list[Path],
    published: list[Path],
    tables: list[Path],
    latex_tables: list[Path],
    budget_page: Path,
    verdicts_text: Path,
    assumptions: Path,
    solutions: Path,
    lever_lengths_m: dict[str, float],
    camera: str,
    ins: str,
) -> None:
    cells = {path.stem: read_published(path) for path in published}
    read = {path.stem: (read_budget(path), cells.get(path.stem)) for path in budgets}
    for (budget, known), csv, tex in zip(read.values(), tables, latex_tables, strict=True):
        long_table(budget, known).to_csv(csv, index=False)
        tex.write_text(latex(budget, known), encoding="utf-8")
    facts, needed = [], []
    for name, length_m in lever_lengths_m.items():
        budget, known = read[name]
        setup = published_setup(budget, known, length_m)
        facts.append({"table": name, **solution_facts(reconstruct(setup))})
        needed.append(left_out(setup).assign(table=name))
    pd.DataFrame(facts).to_csv(solutions, index=False)
    pd.concat(needed).to_csv(assumptions, index=False)
    worth = what_the_cells_tell([read[camera], read[ins]])
    text = page(
        read,
        camera=camera,
        ins=ins,
        worth=worth,
        statements=statements(read[camera][0], read[ins][0]),
        assumptions=pd.read_csv(assumptions),
        solutions=pd.read_csv(solutions),
    )
    budget_page.write_text(text, encoding="utf-8")
    verdicts_text.write_text(terminal_text(read, (camera, ins), worth=worth), encoding="utf-8")


if "snakemake" in globals():
    run_job(main, snakemake)
