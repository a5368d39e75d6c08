"""Every published number, what this project has of it -> ledger with a verdict on each, as table and page."""

import logging
from pathlib import Path

import pandas as pd

from thalweg.settings import load_campaign
from thalweg.workflow import run_job
from thalweg_lab.figures import write_ledger
from thalweg_lab.reproduction import (
    Results,
    by_class,
    headlines,
    missing_items,
    parts_of,
    read_ledgers,
    read_pages,
    recorded,
    told,
    whole_ledger,
)

log = logging.getLogger("thalweg")


def main(
    *,
    published: list[Path],
    named: Path,
    pages: Path,
    records: list[Path],
    campaigns: list[Path],
    ledger: Path,
    verdicts: Path,
    chosen: Path,
    text: Path,
    page: Path,
    results: dict[str, str],
    rules: list[str],
    figures: list[str],
) -> None:
    entries = read_ledgers(published[0].parent)
    if missing := missing_items(entries):
        log.warning("no entry for %s", ", ".join(missing))
    made = {Path(name).relative_to("results").as_posix(): Path(name) for name in results}
    found = Results(
        files=made,
        studies={name.removeprefix("reproduction/"): path for name, path in made.items()},
        settings={path.stem: load_campaign(path).model_dump(mode="json") for path in campaigns},
        records=recorded(records),
        parts=parts_of(rules, figures),
    )
    table = whole_ledger(entries, found, read_pages(pages))
    table.to_csv(ledger, index=False, float_format="%.6g")
    by_class(table).to_csv(verdicts, index=False)
    shown = headlines(table, pd.read_csv(named))
    shown.to_csv(chosen, index=False)
    text.write_text(told(table, shown), encoding="utf-8")
    write_ledger(table, shown, page)
    log.info("%s", text.read_text(encoding="utf-8"))


if "snakemake" in globals():
    run_job(main, snakemake)
