"""The campaign's source of positions -> one table of antenna positions and its integrity report."""

from pathlib import Path
from typing import Any

from thalweg.core.tables import write_table
from thalweg.ingest.registry.positions import read_positions
from thalweg.ingest.schemas import GNSS_POSITION
from thalweg.workflow.job import run_job


def main(
    *,
    logs: list[Path],
    base: list[Path],
    nav: list[Path],
    states: Path,
    positions: Path,
    integrity: Path,
    source: str,
    ppk: dict[str, Any],
    base_position: dict[str, Any],
) -> None:
    table, report = read_positions(
        source, logs, states=states, base=base, nav=nav, ppk=ppk, base_position=base_position
    )
    write_table(positions, table, GNSS_POSITION)
    report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
