"""Calibrated sensor -> what it adds to an echo sounder on a small river: table, facts, measured places."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from thalweg.lightsheet.optics import read_sensor
from thalweg.lightsheet.scanning import LASER_M, SurveyPlan, joint_survey, small_river, swath
from thalweg.workflow import run_job


def main(*, sensor: Path, table: Path, facts: Path, places: Path, window_depth_m: float) -> None:
    widths = swath(read_sensor(sensor), window_depth_m, np.linspace(*LASER_M, 7).tolist())
    river = small_river()
    found = joint_survey(river, replace(SurveyPlan(), swath_m=widths))
    found.table.to_csv(table, index=False, float_format="%.6g")
    facts.write_text(json.dumps(found.facts, indent=2) + "\n")
    section = pd.DataFrame(
        {"along_m": np.nan, "across_m": river.across_m, "depth_m": river.depth_m, "instrument": "section"}
    )
    named = np.where(found.instrument == 1, "echo sounder", "light sheet")
    measured = pd.DataFrame(found.places_m, columns=["along_m", "across_m", "depth_m"])
    track = pd.DataFrame(found.track_m, columns=["along_m", "across_m"]).assign(instrument="track")
    joined = [section, track.assign(depth_m=np.nan), measured.assign(instrument=named)]
    pd.concat(joined, ignore_index=True).to_parquet(places, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
