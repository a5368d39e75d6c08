"""Marks in pictures of a marker field, by the sensor's camera in air -> its interior orientation."""

import json
import logging
from pathlib import Path
from typing import Any

from thalweg.calibration.field.description import read_field
from thalweg.calibration.markers.camera_file import interior_calibration
from thalweg.core.calibration.files import write_calibration
from thalweg.core.calibration.model import Source
from thalweg.core.frames import LocalFrame
from thalweg.lightsheet.lens.lens import NAME, calibrate_lens
from thalweg.lightsheet.lens.marks import read_lens_marks
from thalweg.lightsheet.lens.report import lens_report
from thalweg.lightsheet.optics.sensor_files import read_sensor
from thalweg.workflow.job import run_job


def main(
    *, design: Path, marks: Path, field: Path, camera: Path, report: Path, residuals: Path,
    campaign: dict[str, Any], twin: bool,
) -> None:  # fmt: skip
    nominal = read_sensor(design).camera
    found = calibrate_lens(
        read_lens_marks(marks, nominal.size_px), nominal, read_field(field),
        LocalFrame(**campaign["origin"]), where=marks.name,
    )  # fmt: skip
    for note in found.notes:
        logging.getLogger("thalweg").warning(note)
    facts = found.measured.network.report
    source = Source(
        run=str(campaign["id"]), method="self-calibrating bundle adjustment of a marker field in air",
        observations=2 * facts["marks"], sigma0=facts["sigma0"], twin=twin,
    )  # fmt: skip
    write_calibration(camera, interior_calibration(found.camera, source, block=NAME))
    report.write_text(json.dumps(lens_report(found), indent=2, allow_nan=False) + "\n")
    found.measured.network.residuals.to_csv(residuals, index=False, float_format="%.5f")


if "snakemake" in globals():
    run_job(main, snakemake)
