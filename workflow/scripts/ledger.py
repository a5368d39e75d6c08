"""Every published number, what this project has of it -> ledger with a verdict on each, as table and page."""

import logging
from pathlib import Path

from thalweg.settings import load_campaign
from thalweg.workflow import run_job
from thalweg_lab.figures import write_ledger
from thalweg_lab.reproduction import (
    Results,
    ledger_counts,
    missing_items,
    parts_of,
    read_ledgers,
    read_pages,
    recorded,
    whole_ledger,
)

log = logging.getLogger("thalweg")


def main(
    *,
    published: list[Path],
    pages: Path,
    campaigns: list[Path],
    ledger: Path,
    verdicts: Path,
    page: Path,
    root: str,
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
        records=recorded(Path(root)),
        parts=parts_of(rules, figures),
    )
    table = whole_ledger(entries, found, read_pages(pages))
    table.to_csv(ledger, index=False, float_format="%.6g")
    counts = ledger_counts(table)
    counts.to_csv(verdicts, index=False)
    write_ledger(table, page)
    log.info("%s", counts.to_string(index=False))


if "snakemake" in globals():
    run_job(main, snakemake)
