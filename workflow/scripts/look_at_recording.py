"""One real recording -> integrity report and first pictures."""

from pathlib import Path
from typing import Any

from thalweg.figures import save
from thalweg.figures.firstlook import first_looks_of
from thalweg.ingest.registry import load_recording
from thalweg.workflow import run_job


def main(
    *,
    files: list[Path],
    base: list[Path],
    nav: list[Path],
    integrity: Path,
    pictures: Path,
    reader: str,
    title: str,
    options: dict[str, Any],
) -> None:
    recording = load_recording(files, reader=reader, base=base, nav=nav, options=options)
    recording.report.write(integrity)
    pictures.mkdir(parents=True, exist_ok=True)
    for name, figure in first_looks_of(recording, title=title).items():
        save(figure, pictures / f"{name}.png")


if "snakemake" in globals():
    run_job(main, snakemake)
