"""Error budgets -> influences as CSV and LaTeX, a page with a verdict on each published cell, and a text."""

from pathlib import Path

import pandas as pd

from thalweg.budgets import (
    latex,
    long_table,
    page,
    read_budget,
    read_published,
    statements,
    terminal_text,
    what_the_cells_tell,
)
from thalweg.workflow import run_job


def main(
    *,
    budgets: list[Path],
    published: list[Path],
    assumptions: Path,
    solutions: Path,
    tables: list[Path],
    latex_tables: list[Path],
    budget_page: Path,
    verdicts_text: Path,
    camera: str,
    ins: str,
) -> None:
    cells = {path.stem: read_published(path) for path in published}
    read = {path.stem: (read_budget(path), cells.get(path.stem)) for path in budgets}
    for (budget, known), csv, tex in zip(read.values(), tables, latex_tables, strict=True):
        long_table(budget, known).to_csv(csv, index=False)
        tex.write_text(latex(budget, known), encoding="utf-8")
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
