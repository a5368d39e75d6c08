"""Interior orientation from a calibration -> the same for the size of the survey's images."""

from pathlib import Path

from thalweg.calibration import interior_calibration, read_camera
from thalweg.core import read_table
from thalweg.core.calibration import Source, write_calibration
from thalweg.images.model import in_folders
from thalweg.ingest.photos import IMAGE_STAMPS
from thalweg.workflow import run_job


def main(*, calibrated: Path, stamps: Path, camera: Path, run: str, folders: list[str]) -> None:
    table = read_table(stamps, IMAGE_STAMPS)[0]
    mine = table["width"].gt(0) & ~in_folders(table["file"], folders)
    sizes = table.loc[mine if mine.any() else table["width"] > 0, ["width", "height"]].value_counts()
    width, height = sizes.index[0]
    found = read_camera(calibrated).scaled((int(width), int(height)))
    source = Source(run=run, method=f"{calibrated.name} for {width} x {height} pixels")
    write_calibration(camera, interior_calibration(found, source))


if "snakemake" in globals():
    run_job(main, snakemake)
