"""Data of the bed and its covariance -> what it foretells of left-out lines, beside other interpolators."""

from pathlib import Path

from pyproj import CRS

from thalweg.bathymetry import OBSERVATIONS, Banks, BedModel, FlowLine, against_reference, validate_bed
from thalweg.core import read_json, read_table, write_json
from thalweg.settings.sections import Bathymetry
from thalweg.workflow import run_job


def main(
    *,
    used: Path,
    soundings: Path,
    variogram: Path,
    line: FlowLine,
    banks: Path,
    bed: Path,
    reference: list[Path],
    surveyed: list[Path],
    validation: Path,
    predicted: Path,
    methods: Path,
    crs: CRS,
    bathymetry: Bathymetry,
) -> None:
    facts, table, compared = validate_bed(
        read_table(used, OBSERVATIONS)[0],
        BedModel.of_report(read_json(variogram)),
        Banks.read(banks, line).half_widths_m,
        bathymetry,
    )
    if agreed := read_json(soundings)["crossings"].get("agreement"):
        facts["agreement"] = agreed
    if reference or surveyed:
        facts["reference"] = against_reference(bed, reference + surveyed, crs, bathymetry)
    write_json(validation, facts)
    table.to_parquet(predicted, index=False)
    compared.to_csv(methods, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
