"""Design, lens, marks in an image through air, and their places -> sensor with its camera over the window."""

from pathlib import Path
from typing import Any

from thalweg.calibration import read_camera
from thalweg.calibration.field import read_points
from thalweg.core import write_json
from thalweg.core.calibration import Source
from thalweg.lightsheet.calibration import orient_camera, read_camera_marks, with_lens
from thalweg.lightsheet.optics import read_sensor, write_sensor
from thalweg.workflow import run_job


def main(
    *,
    design: Path,
    interior: Path | None,
    marks: Path,
    points: Path,
    sensor: Path,
    report: Path,
    run: str,
    calibration: dict[str, Any],
    twin: bool,
) -> None:
    nominal = read_sensor(design)
    if interior:
        nominal = with_lens(nominal, read_camera(interior))
    found = orient_camera(
        nominal,
        read_camera_marks(marks),
        read_points(points),
        calibration["window_markers"],
        where=marks.name,
    )
    source = Source(run=run, method="resection in air over the window's plane", twin=twin)
    write_sensor(sensor, found.applied(nominal), source=source, title="Light-sheet sensor, camera oriented")
    lens = "pictures of a marker field" if interior else "the design"
    write_json(report, {**found.facts(), "interior_orientation": lens})


if "snakemake" in globals():
    run_job(main, snakemake)
