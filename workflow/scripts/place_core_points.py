"""Prepared epochs -> core points on the first and the last surface."""

from pathlib import Path

from thalweg.core import LocalFrame, write_table
from thalweg.deformation import CORE_POINTS, check_order, place_core_points
from thalweg.deformation.foreign import read_epoch
from thalweg.settings.sections import Deformation
from thalweg.surface import Area
from thalweg.workflow import run_job


def main(
    *, epochs: list[Path], core_points: Path, frame: LocalFrame, crs: str, deformation: Deformation
) -> None:
    read = [read_epoch(path.parent) for path in epochs]
    check_order(read)
    area = Area.from_section(deformation.area, frame, crs)
    write_table(core_points, place_core_points(read, deformation, area), CORE_POINTS)


if "snakemake" in globals():
    run_job(main, snakemake)
