"""Comparisons of the camera's clock with GPS time, or pulses of a trigger -> clock of the camera."""

from pathlib import Path
from typing import Any

from thalweg.core.tables import read_table
from thalweg.ingest.image_stamps import IMAGE_STAMPS
from thalweg.jobs.job import run_job
from thalweg.timing.clock_ties import clock_from_ties, read_ties
from thalweg.timing.hand_tables import read_number_columns
from thalweg.timing.trigger import clock_from_pulses, match_pulses


def main(
    *, ties: list[Path], pulses: list[Path], stamps: list[Path], clock: Path, options: dict[str, Any]
) -> None:
    jitter_s, delay_s = options.get("jitter_s") or 0.0, options.get("delay_s") or 0.0
    if ties:
        found = read_ties(ties[0])
        model = clock_from_ties(found.t_device_s, found.t_gps_s, found.sigma_s, jitter_s=jitter_s)
    else:
        t_device_s = read_table(stamps[0], IMAGE_STAMPS)[0]["t_device_s"].dropna().drop_duplicates()
        (t_pulse_s,) = read_number_columns(pulses[0], ("t_gps_s",))
        match = match_pulses(t_device_s, t_pulse_s)
        model = clock_from_pulses(t_device_s, t_pulse_s, match, delay_s=delay_s)
    model.write(clock)


if "snakemake" in globals():
    run_job(main, snakemake)
