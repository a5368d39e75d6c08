"""Two epochs -> the motion between them that stable ground shows."""

from pathlib import Path

from thalweg.core import LocalFrame, read_table
from thalweg.deformation import CORE_POINTS, measure_pair, register_pair, write_registration
from thalweg.deformation.foreign import read_epoch, with_drawn_areas
from thalweg.settings.sections import Deformation
from thalweg.workflow import run_job


def main(
    *,
    epochs: list[Path],
    core_points: Path,
    registration: Path,
    weights: Path,
    frame: LocalFrame,
    crs: str,
    deformation: Deformation,
) -> None:
    settings = with_drawn_areas(deformation, frame, crs)
    before, after = (read_epoch(path.parent) for path in epochs)
    pair = measure_pair(read_table(core_points, CORE_POINTS)[0], before, after, settings)
    write_registration(registration, weights, register_pair(pair, settings))


if "snakemake" in globals():
    run_job(main, snakemake)
