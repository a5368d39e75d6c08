"""Soundings, banks and points of the light sheet -> riverbed with sigmas, and its covariance."""

import json
from pathlib import Path
from typing import Any

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
from thalweg.core import LocalFrame, read_table, write_raster, write_table
from thalweg.lightsheet.scanning import BED_POINTS
from thalweg.settings.sections import Bathymetry, EchoSounder
from thalweg.workflow import run_job


def main(
    *,
    soundings: Path,
    facts: Path,
    banks: Path,
    line: Path,
    level: Path,
    strip: list[Path],
    others: list[Path],
    bed: Path,
    variogram: Path,
    used: Path,
    campaign: dict[str, Any],
    echo_sounder: EchoSounder,
    bathymetry: Bathymetry,
) -> None:
    frame, centre = LocalFrame(**campaign["origin"]), FlowLine.read(line)
    crs = CRS.from_user_input(campaign["crs"])
    found = krige_bed(
        read_table(soundings, SOUNDINGS)[0],
        centre,
        Banks.read(banks, centre),
        WaterLevel.of_report(json.loads(level.read_text())),
        read_table(strip[0], BED_POINTS)[0] if strip else None,
        frame=frame,
        crs=crs,
        echo=echo_sounder,
        settings=bathymetry,
        slow_time_s=json.loads(facts.read_text())["position_time_s"],
        seed=campaign["seed"],
        others=read_other_soundings(others, frame, crs, bathymetry) if others else None,
    )
    tags = {"heights": "ellipsoidal, metres", "campaign": campaign["id"]}
    write_raster(bed, found.grid, found.bands(frame), tags=tags)
    variogram.write_text(json.dumps(found.model.report() | {"facts": found.facts}, indent=2) + "\n")
    write_table(used, found.data, OBSERVATIONS)


if "snakemake" in globals():
    run_job(main, snakemake)
