"""Pictures of a field around the rig -> both interiors and the relative orientation, with one covariance."""

import logging
from pathlib import Path

from thalweg.calibration import (
    calibrate_rig,
    check_rig,
    detect_rig_marks,
    remeasure_rig_marks,
    rig_calibration_file,
)
from thalweg.calibration.field import read_field, read_points
from thalweg.core import write_json
from thalweg.core.calibration import Source, write_calibration
from thalweg.ingest.photos import list_images
from thalweg.settings.sections import Rig
from thalweg.workflow import run_job


def main(
    *,
    images: list[Path],
    field: list[Path],
    points: list[Path],
    calibration: Path,
    residuals: Path,
    exposures: Path,
    report: Path,
    run: str,
    rig: Rig,
) -> None:
    check_rig(rig)
    files, known = list_images(images), read_points(points[0])
    marks = detect_rig_marks(files, rig, read_field(field[0]).layout)
    rough = calibrate_rig(marks, known, rig)
    marks = remeasure_rig_marks(files, rig, marks, rough.rig.cameras)
    found = calibrate_rig(marks, known, rig, nominal=rough.rig.cameras)
    for row in found.rejected.itertuples():
        logging.getLogger("thalweg").warning("%s %s: %s", row.what, row.name, row.reason)
    source = Source(
        run=run,
        method="adjustment of both lenses on a field of marks",
        observations=2 * int(found.residuals["used"].sum()),
        sigma0=found.report["sigma0"],
    )
    write_calibration(calibration, rig_calibration_file(found, source))
    found.residuals.to_csv(residuals, index=False, float_format="%.5f")
    found.exposures.to_csv(exposures, index=False, float_format="%.6f")
    facts = {
        "adjustment": found.report,
        "base_m": found.rig.base_m,
        "axes_deg": found.rig.axes_deg,
        "exposures_sigma0": found.sigma0,
        "rejected": found.rejected.to_dict("records"),
    }
    write_json(report, facts)


if "snakemake" in globals():
    run_job(main, snakemake)
