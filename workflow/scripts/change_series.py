"""All epochs of a bank -> trend and step of each core point, epochs that jump and return."""

from dataclasses import asdict
from pathlib import Path

from thalweg.core import LocalFrame, read_table, write_json, write_table
from thalweg.deformation import (
    CORE_POINTS,
    HEIGHTS,
    SERIES,
    find_jumps,
    fit_series,
    heights_table,
    series_of_epochs,
)
from thalweg.deformation.foreign import read_epoch, with_drawn_areas
from thalweg.settings.sections import Deformation
from thalweg.workflow import run_job


def main(
    *,
    epochs: list[Path],
    core_points: Path,
    series: Path,
    heights: Path,
    jumps: Path,
    retreat: Path,
    frame: LocalFrame,
    crs: str,
    deformation: Deformation,
) -> None:
    settings = with_drawn_areas(deformation, frame, crs)
    read = [read_epoch(path.parent) for path in epochs]
    found = series_of_epochs(read_table(core_points, CORE_POINTS)[0], read, settings)
    write_table(series, fit_series(found.years, found.height_m, found.sigma_m), SERIES)
    write_table(heights, heights_table(found.years, found.height_m, found.sigma_m), HEIGHTS)
    moving = fit_series(found.years, found.line_m, found.line_sigma_m)
    rates = found.lines.assign(
        n_epochs=moving["n_epochs"], lrr_m_a=moving["trend_m_a"], sigma_lrr_m_a=moving["sigma_trend_m_a"]
    )
    rates.to_csv(retreat, index=False)
    told = [
        asdict(jump) | {"name": read[jump.epoch].name}
        for jump in find_jumps(found.raw_m, found.sigma_apart_m, limit=2.0)
    ]
    facts = {"epochs": told, "closure": asdict(found.misclosure), "network": found.network.facts}
    write_json(jumps, facts)


if "snakemake" in globals():
    run_job(main, snakemake)
