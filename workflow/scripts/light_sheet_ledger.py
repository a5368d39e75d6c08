"""Published numbers and what was measured on the twin -> ledger with a verdict on each, as table and page."""

import logging
from pathlib import Path
from typing import Any

from thalweg.workflow import run_job
from thalweg_lab.reproduction import (
    Results,
    counts,
    distinct,
    judged,
    markdown,
    read_ledger,
    recorded,
    sentence,
)

log = logging.getLogger("thalweg")


def main(
    *,
    published: Path,
    results: list[Path],
    records: list[Path],
    ledger: Path,
    text: Path,
    numbers: Path,
    folder: str,
    studies: dict[str, str],
    light_sheet: dict[str, Any] | None,
    title: str,
    twin: bool,
) -> None:
    files = {path.relative_to(folder).as_posix(): path for path in results}
    found = Results(
        files=files,
        studies={Path(name).name: Path(name) for name in studies},
        settings=light_sheet,
        records=recorded(records),
    )
    table = judged(read_ledger(published), found)
    table.to_csv(ledger, index=False, float_format="%.6g")
    counts(table).to_csv(numbers, index=False)
    text.write_text(markdown(table, title=title, twin=twin), encoding="utf-8")
    log.info("%s", sentence(distinct(table)))


if "snakemake" in globals():
    run_job(main, snakemake)
