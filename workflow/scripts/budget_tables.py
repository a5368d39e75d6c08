"""Error budgets -> tables, page with a verdict on each published cell."""

from pathlib import Path

from thalweg.budgets import long_table, read_budget
from thalweg.workflow import run_job
from thalweg_lab.reproduction import page, read_published, what_the_cells_tell


def main(
    *,
    budgets: list[Path],
    published: list[Path],
    tables: list[Path],
    budget_page: Path,
    verdicts_text: Path,
    camera: str,
    ins: str,
) -> None:
    read = {
        budget.stem: (read_budget(budget), read_published(cells))
        for budget, cells in zip(budgets, published, strict=True)
    }
    for (budget, _), csv in zip(read.values(), tables, strict=True):
        long_table(budget).to_csv(csv, index=False)
    worth = what_the_cells_tell([read[camera], read[ins]])
    budget_page.write_text(page(read, camera=camera, ins=ins, worth=worth), encoding="utf-8")
    verdicts_text.write_text(f"{worth}\nCell by cell: {budget_page}\n", encoding="utf-8")


if "snakemake" in globals():
    run_job(main, snakemake)
