"""Terrain model, banks and centre line -> sections, profile, volumes, and files for hydraulic programs."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pyproj import CRS

from thalweg.bathymetry import FlowLine
from thalweg.core import CoverageError, LocalFrame
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
    dtm: Path,
    banks: Path,
    line: Path,
    variogram: Path,
    profile: Path,
    hydraulics: Path,
    volumes: Path,
    facts: Path,
    exports: Path,
    campaign: dict[str, Any],
    fusion: Fusion,
) -> None:
    model = Dtm.read(dtm)
    frame, crs = LocalFrame(**campaign["origin"]), CRS.from_user_input(campaign["crs"])
    river = read_river(FlowLine.read(line), banks, frame, crs, separation=model.separation)
    notes = []
    try:
        sections = cut_sections(model, river, fusion)
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
    lengths = json.loads(variogram.read_text())["facts"]["error correlation_m"]
    tables = [hydraulic_table(section, fusion, correlation_m=lengths["section"]) for section in sections]
    (pd.concat(tables) if tables else pd.DataFrame()).to_csv(hydraulics, index=False, float_format="%.4f")
    inside, water = water_of(model, river, fusion, correlation_m=lengths["area"])
    hypsometry(model, inside, fusion, correlation_m=lengths["area"]).to_csv(
        volumes, index=False, float_format="%.4f"
    )
    found = export_river(exports, model, river, sections, fusion)
    facts.write_text(
        json.dumps(
            {"sections": len(sections), "notes": notes, "water": water, "depth_and_width": by_width} | found,
            indent=2,
        )
        + "\n"
    )


if "snakemake" in globals():
    run_job(main, snakemake)
