"""Data of the bed and its covariance -> what it foretells of left-out lines, beside other interpolators."""

import json
from pathlib import Path
from typing import Any

from pyproj import CRS

from thalweg.bathymetry import OBSERVATIONS, Banks, BedModel, FlowLine, against_reference, validate_bed
from thalweg.core import read_table
from thalweg.settings.sections import Bathymetry
from thalweg.workflow import run_job


def main(
    *,
    used: Path,
    soundings: Path,
    variogram: Path,
    line: Path,
    banks: Path,
    bed: Path,
    reference: list[Path],
    surveyed: list[Path],
    validation: Path,
    predicted: Path,
    methods: Path,
    campaign: dict[str, Any],
    bathymetry: Bathymetry,
) -> None:
    facts, table, compared = validate_bed(
        read_table(used, OBSERVATIONS)[0],
        BedModel.of_report(json.loads(variogram.read_text())),
        Banks.read(banks, FlowLine.read(line)).half_widths_m,
        bathymetry,
    )
    if agreed := json.loads(soundings.read_text())["crossings"].get("agreement"):
        facts["agreement"] = agreed
    if reference or surveyed:
        crs = CRS.from_user_input(campaign["crs"])
        facts["reference"] = against_reference(bed, reference + surveyed, crs, bathymetry)
    validation.write_text(json.dumps(facts, indent=2) + "\n")
    table.to_parquet(predicted, index=False)
    compared.to_csv(methods, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
