"""Everything that was found out about a light-sheet sensor -> one page."""

import json
from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.core import read_parquet
from thalweg.lightsheet.figures import light_sheet_page, read_scans
from thalweg.workflow import run_job
from thalweg_lab.figures import ledger_section


def main(
    *,
    calibration: Path,
    camera: list[Path],
    lens: list[Path],
    budget: Path,
    published: Path,
    contradictions: Path,
    correlations: Path,
    models: Path,
    panels: list[Path],
    truth: list[Path],
    counts: list[Path],
    line_points: list[Path],
    scan_files: list[Path],
    scan_pictures: list[Path],
    pictures: list[Path],
    captions: dict[str, str],
    ledger: list[Path],
    page: Path,
    twin: bool,
    campaign: dict[str, Any],
    scans: list[str],
) -> None:
    built = light_sheet_page(
        json.loads(calibration.read_text(encoding="utf-8")),
        *(pd.read_csv(path) for path in (budget, published, contradictions, correlations, models)),
        panels=pd.read_csv(panels[0]) if panels else None,
        truth=pd.read_csv(truth[0]) if truth else None,
        camera=json.loads(camera[0].read_text(encoding="utf-8")) if camera else None,
        lens=json.loads(lens[0].read_text(encoding="utf-8")) if lens else None,
        counts={path.parent.name: pd.read_csv(path) for path in counts},
        points={path.parent.name: read_parquet(path) for path in line_points},
        scans=read_scans(scans, scan_files, scan_pictures, captions),
        pictures=pictures,
        captions=captions,
        title=f"Light-sheet sensor: {campaign['title']}",
        twin=twin,
    )
    ledger_section(built, pd.read_csv(ledger[0]) if ledger else None).write(page)


if "snakemake" in globals():
    run_job(main, snakemake)
