"""A sensor -> budgets of the depth, verdicts on published figures, cost of simpler models, look-up table."""

from pathlib import Path

from thalweg.lightsheet.budget import budget as budgets, calibrated, checks, depth_sigmas, design
from thalweg.lightsheet.optics import look_up_table, model_errors, paper_4, read_sensor
from thalweg.workflow import run_job


def main(
    *,
    sensor: Path,
    budget: Path,
    published: Path,
    contradictions: Path,
    correlations: Path,
    models: Path,
    look_up: Path,
) -> None:
    own = read_sensor(sensor)
    budgets.budget_on_lines(own).to_csv(budget, index=False, float_format="%.6f")
    reference, rows = paper_4(), checks.read_published()
    table = budgets.budget_table(budgets.budget_on_lines(reference))
    found = checks.contradictions(reference, rows)
    checks.verdicts(table, rows, found).to_csv(published, index=False, float_format="%.5f")
    checks.inequality_table(found).to_csv(contradictions, index=False)
    depth_sigmas(reference, calibrated(reference, design(reference))).to_csv(
        correlations, index=False, float_format="%.5f"
    )
    look_up_table(own).write(look_up)
    model_errors(own).to_csv(models, index=False, float_format="%.4f")


if "snakemake" in globals():
    run_job(main, snakemake)
