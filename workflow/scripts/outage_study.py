"""Outages of GNSS on the twin -> position errors of INS, camera and fused trajectory by outage length."""

from pathlib import Path

from thalweg.workflow.job import run_job
from thalweg_lab.studies.outage import as_markdown, outage_study, summarised


def main(*, table: Path, page: Path, first_seed: int, seeds: int) -> None:
    found = summarised(outage_study(range(first_seed, first_seed + seeds)))
    found.to_csv(table, index=False, float_format="%.6g")
    page.write_text(as_markdown(found), encoding="utf-8")


if "snakemake" in globals():
    run_job(main, snakemake)
