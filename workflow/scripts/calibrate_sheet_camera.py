"""Marks in pictures of a marker field, by the sensor's camera in air -> its interior orientation."""

import json
import logging
from pathlib import Path

from thalweg.calibration import interior_calibration
from thalweg.calibration.field import read_field
from thalweg.core import LocalFrame
from thalweg.core.calibration import Source, write_calibration
from thalweg.lightsheet.calibration import NAME, calibrate_lens, lens_report, read_lens_marks
from thalweg.lightsheet.optics import read_sensor
from thalweg.workflow import run_job


def main(
    *,
    design: Path,
    marks: Path,
    field: Path,
    camera: Path,
    report: Path,
    residuals: Path,
    run: str,
    frame: LocalFrame,
    twin: bool,
) -> None:
    nominal = read_sensor(design).camera
    found = calibrate_lens(
        read_lens_marks(marks, nominal.size_px), nominal, read_field(field), frame, where=marks.name
    )
    for note in found.notes:
        logging.getLogger("thalweg").warning(note)
    facts = found.measured.network.report
    source = Source(
        run=run,
        method="self-calibrating bundle adjustment of a marker field in air",
        observations=2 * facts["marks"],
        sigma0=facts["sigma0"],
        twin=twin,
    )
    write_calibration(camera, interior_calibration(found.camera, source, block=NAME))
    report.write_text(json.dumps(lens_report(found), indent=2, allow_nan=False) + "\n")
    found.measured.network.residuals.to_csv(residuals, index=False, float_format="%.5f")


if "snakemake" in globals():
    run_job(main, snakemake)
