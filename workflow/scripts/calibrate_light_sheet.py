"""Line points on the grid object and the oriented camera -> the calibrated light sheet."""

from pathlib import Path
from typing import Any

from thalweg.core import read_table, write_json
from thalweg.core.calibration import Source
from thalweg.lightsheet.calibration import CalibrationSettings, calibrate_sheet, read_grid, report as tables
from thalweg.lightsheet.lines import LineFlag
from thalweg.lightsheet.optics import WaterState, in_measured_water, read_sensor, write_sensor
from thalweg.lightsheet.poses import SERIES_POINTS, require_levels, require_one_image
from thalweg.workflow import run_job


def main(
    *,
    camera: Path,
    line_points: Path,
    grid: Path,
    sensor: Path,
    report: Path,
    parameters: Path,
    residuals: Path,
    pairs: Path,
    run: str,
    calibration: dict[str, Any],
    water: dict[str, Any],
    twin: bool,
) -> None:
    points = require_one_image(read_table(line_points, SERIES_POINTS)[0], where=line_points)
    described = read_grid(grid)
    require_levels(described, calibration["levels"], where=grid)
    # three levels check each other: held fixed, errors of their depths would pass for errors of the line
    jointly = (*calibration["jointly"], *(("levels",) if len(described.levels) > 2 else ()))
    settings = CalibrationSettings(
        # points at the end of a piece leave its line; they still show where it ends
        drop_flags=LineFlag.NEAR_JUMP,
        jointly=tuple(dict.fromkeys(jointly)),
        reject_sigmas=calibration["reject_sigmas"],
        largest_misfit_px=calibration["largest_misfit_px"],
    )
    start, medium = in_measured_water(read_sensor(camera), WaterState(**water))
    found = calibrate_sheet(start, points, described, settings)
    method = f"grid object in {len(described.levels)} levels (P3 2.4, P4 4.3)"
    source = Source(run=run, method=method, twin=twin)
    write_sensor(sensor, found.sensor, source=source, title="Light-sheet sensor, calibrated")
    tables.parameter_table(found).to_csv(parameters, index=False)
    tables.residual_table(found).to_csv(residuals, index=False, float_format="%.5f")
    tables.pair_table(found).to_csv(pairs, index=False, float_format="%.5f")
    told = tables.calibration_report(found) | {"water": medium}
    write_json(report, told)


if "snakemake" in globals():
    run_job(main, snakemake)
