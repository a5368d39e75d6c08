"""The campaign's source of positions -> one table of antenna positions and its integrity report."""

import datetime as dt
from pathlib import Path
from typing import Any

from thalweg.core import write_table
from thalweg.ingest import GNSS_POSITION
from thalweg.ingest.registry import read_positions
from thalweg.workflow import run_job


def main(
    *,
    logs: list[Path],
    base: list[Path],
    nav: list[Path],
    states: Path | None,
    positions: Path,
    integrity: Path,
    source: str,
    date: str | None,
    topics: list[str],
    ppk: dict[str, Any],
    base_position: dict[str, Any],
) -> None:
    table, report = read_positions(
        source,
        logs,
        states=states,
        date=dt.date.fromisoformat(date) if date else None,
        topics=topics,
        base=base,
        nav=nav,
        ppk=ppk,
        base_position=base_position,
    )
    write_table(positions, table, GNSS_POSITION)
    report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
