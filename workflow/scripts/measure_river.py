"""Terrain dtm, banks and centre line -> sections, profile, volumes, and files for hydraulic programs."""

from pathlib import Path

import numpy as np
import pandas as pd
from pyproj import CRS

from thalweg.bathymetry import FlowLine
from thalweg.core import CoverageError, LocalFrame, read_json, write_json
from thalweg.fusion import (
    Dtm,
    cut_sections,
    depths_along,
    export_river,
    hydraulic_table,
    hypsometry,
    long_profile,
    read_river,
    water_of,
)
from thalweg.settings.sections import Fusion
from thalweg.workflow import run_job


def main(
    *,
    dtm: Dtm,
    banks: Path,
    line: FlowLine,
    variogram: Path,
    profile: Path,
    hydraulics: Path,
    volumes: Path,
    facts: Path,
    exports: Path,
    frame: LocalFrame,
    crs: CRS,
    fusion: Fusion,
) -> None:
    river = read_river(line, banks, frame, crs, separation=dtm.separation)
    notes = []
    try:
        sections = cut_sections(dtm, river, fusion)
    except CoverageError as error:  # the model and its volume are of use without sections
        sections = []
        notes.append(str(error))
    along = long_profile(sections)
    along.to_csv(profile, index=False, float_format="%.4f")
    weir_s_m = None if fusion.weir is None else float(river.flow.to_flow(np.array([fusion.weir]))[0][0])
    try:
        by_width = depths_along(along, weir_s_m=weir_s_m)
    except CoverageError as error:  # a short reach tells nothing of it
        by_width = {"not_told": str(error)}
    lengths = read_json(variogram)["facts"]["error correlation_m"]
    tables = [hydraulic_table(section, fusion, correlation_m=lengths["section"]) for section in sections]
    (pd.concat(tables) if tables else pd.DataFrame()).to_csv(hydraulics, index=False, float_format="%.4f")
    inside, water = water_of(dtm, river, fusion, correlation_m=lengths["area"])
    hypsometry(dtm, inside, fusion, correlation_m=lengths["area"]).to_csv(
        volumes, index=False, float_format="%.4f"
    )
    found = export_river(exports, dtm, river, sections, fusion)
    told = {"sections": len(sections), "notes": notes, "water": water, "depth_and_width": by_width}
    write_json(facts, told | found)


if "snakemake" in globals():
    run_job(main, snakemake)
