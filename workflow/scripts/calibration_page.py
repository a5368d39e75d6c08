"""Everything that a calibration found out -> one page."""

import json
from pathlib import Path
from typing import Any

from thalweg.core.calibration import read_calibration
from thalweg.figures.calibration import calibration_page, read_figure_table
from thalweg.workflow import run_job


def main(
    *,
    calibrations: list[Path],
    tables: list[Path],
    pictures: list[Path],
    captions: dict[str, str],
    truth: list[Path],
    facts: list[Path],
    page: Path,
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    calibration_page(
        [read_calibration(path) for path in calibrations],
        [
            (f"{path.stem.replace('_', ' ').capitalize()} ({path.name})", read_figure_table(path, ()))
            for path in tables
        ],
        pictures=pictures,
        captions=captions,
        truth=read_figure_table(truth[0], ()) if truth else None,
        facts={path.stem: json.loads(path.read_text(encoding="utf-8")) for path in facts},
        title=f"Calibration: {campaign['title']}",
        twin=twin,
    ).write(page)


if "snakemake" in globals():
    run_job(main, snakemake)
