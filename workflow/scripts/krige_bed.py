"""Soundings, banks and points of the light sheet -> riverbed with sigmas, and its covariance."""

from pathlib import Path

from pyproj import CRS

from thalweg.bathymetry import (
    OBSERVATIONS,
    SOUNDINGS,
    Banks,
    FlowLine,
    WaterLevel,
    krige_bed,
    read_other_soundings,
)
from thalweg.core import LocalFrame, read_json, read_table, write_json, write_raster, write_table
from thalweg.lightsheet.scanning import BED_POINTS
from thalweg.settings.sections import Bathymetry, EchoSounder
from thalweg.workflow import run_job


def main(
    *,
    soundings: Path,
    facts: Path,
    banks: Path,
    line: FlowLine,
    level: Path,
    strip: Path | None,
    others: list[Path],
    bed: Path,
    variogram: Path,
    used: Path,
    run: str,
    frame: LocalFrame,
    crs: CRS,
    seed: int,
    echo_sounder: EchoSounder,
    bathymetry: Bathymetry,
) -> None:
    found = krige_bed(
        read_table(soundings, SOUNDINGS)[0],
        line,
        Banks.read(banks, line),
        WaterLevel.of_report(read_json(level)),
        read_table(strip, BED_POINTS)[0] if strip else None,
        frame=frame,
        crs=crs,
        echo=echo_sounder,
        settings=bathymetry,
        slow_time_s=read_json(facts)["position_time_s"],
        seed=seed,
        others=read_other_soundings(others, frame, crs, bathymetry) if others else None,
    )
    tags = {"heights": "ellipsoidal, metres", "campaign": run}
    write_raster(bed, found.grid, found.bands(frame), tags=tags)
    write_json(variogram, found.model.report() | {"facts": found.facts})
    write_table(used, found.data, OBSERVATIONS)


if "snakemake" in globals():
    run_job(main, snakemake)
