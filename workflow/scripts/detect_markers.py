"""Pictures with printed markers -> table of marks (sub-pixel saddles), and what was seen and not used."""

import logging
from pathlib import Path

from thalweg.calibration import MARKS, detect_pictures, recordings_folder, report_of
from thalweg.calibration.field import read_field
from thalweg.core import write_json, write_table
from thalweg.ingest.photos import list_images
from thalweg.workflow import run_job


def main(
    *, folders: list[Path], field: Path, marks: Path, report: Path, rejected: Path, camera: str, threads: int
) -> None:
    log = logging.getLogger("thalweg")
    description = read_field(field)
    pictures = list_images(folders)
    found = detect_pictures(
        {camera: pictures},
        description.layout,
        base=recordings_folder(pictures),
        threads=threads,
        told=log.info,
    )
    facts = report_of(found)
    for note in facts["notes"]:
        log.warning(note)
    write_table(marks, found.marks, MARKS, {"sizes_px": {camera: found.size_px(camera)}})
    found.rejected.to_csv(rejected, index=False)
    write_json(report, {**facts, "pictures": found.images.to_dict("records")})


if "snakemake" in globals():
    run_job(main, snakemake)
