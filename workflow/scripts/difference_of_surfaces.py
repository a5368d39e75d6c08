"""Two registered epochs, or two surface models -> differences of heights with sigmas, and volumes."""

import logging
from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame, read_table
from thalweg.deformation import CORE_POINTS, read_registration
from thalweg.deformation.foreign import (
    difference_of_epochs,
    difference_of_models,
    read_epoch,
    write_difference,
)
from thalweg.settings.sections import Deformation, Epoch
from thalweg.surface import Area
from thalweg.workflow import run_job

log = logging.getLogger("thalweg")


def main(
    *,
    epochs: list[Path],
    core_points: Path,
    registration: Path,
    weights: Path,
    difference: Path,
    volumes: Path,
    models: list[dict[str, Any]],
    frame: LocalFrame,
    crs: str,
    deformation: Deformation,
) -> None:
    moved = read_registration(registration, weights)
    if models:
        first, second = (Epoch(**each) for each in models)
        found = difference_of_models(first, second, deformation, crs, moved)
    else:
        before, after = (read_epoch(path.parent) for path in epochs)
        found = difference_of_epochs(
            read_table(core_points, CORE_POINTS)[0],
            before,
            after,
            moved,
            deformation,
            Area.from_section(deformation.area, frame, crs),
            frame=frame,
            crs=crs,
        )
    for note in found.notes:
        log.info("%s", note)
    write_difference(difference, found)
    write_difference(volumes, found)


if "snakemake" in globals():
    run_job(main, snakemake)
