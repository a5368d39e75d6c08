"""Marks of the reflex camera's pictures -> reference points of the calibration field with covariance."""

import logging
from pathlib import Path

from thalweg.calibration import MARKS, interior_calibration
from thalweg.calibration.field import (
    measure,
    point_table,
    read_field,
    starting_camera,
    write_facts,
    write_points,
)
from thalweg.core import LocalFrame, read_table
from thalweg.core.calibration import Source, write_calibration
from thalweg.workflow import run_job


def main(
    *,
    marks: Path,
    field: Path,
    points: Path,
    facts: Path,
    residuals: Path,
    camera: Path,
    run: str,
    frame: LocalFrame,
    model: str,
    focal_px: float | None,
) -> None:
    log = logging.getLogger("thalweg")
    description = read_field(field)
    table, meta = read_table(marks, MARKS)
    cameras = {
        name: starting_camera(table, description, name, tuple(size), model=model, focal_px=focal_px)
        for name, size in meta["sizes_px"].items()
    }
    found = measure(table, cameras, description, frame)
    for note in found.notes:
        log.warning(note)
    write_points(points, found.points, point_table(description, found))
    write_facts(facts, found.network, found.datum, found.notes)
    found.network.residuals.to_csv(residuals, index=False, float_format="%.5f")
    (reference,) = found.network.cameras.values()
    source = Source(
        run=run,
        method="self-calibrating bundle adjustment of the field",
        observations=2 * found.network.report["marks"],
        sigma0=found.network.report["sigma0"],
    )
    write_calibration(camera, interior_calibration(reference, source, block="reference"))


if "snakemake" in globals():
    run_job(main, snakemake)
