"""Images and scans by the twin's fifteen-line laser -> pictures, labelled points, fit of shifted labels."""

from pathlib import Path

from thalweg.workflow import run_job
from thalweg_lab.studies.sensors import labelled_scans, multi_line_images, write_images


def main(*, images: Path, image_points: Path, scan_points: Path, shifts: Path, seed: int) -> None:
    write_images(list(multi_line_images(seed)), images, image_points)
    table, test = labelled_scans(seed)
    table.to_parquet(scan_points, index=False)
    test.to_csv(shifts, index=False, float_format="%.6g")


if "snakemake" in globals():
    run_job(main, snakemake)
