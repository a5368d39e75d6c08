"""Ties of the camera's clock to GPS time, or pulses of its trigger -> its clock, times of images."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

from thalweg.clocks import TIE_COLUMNS, clock_from_ties, read_number_columns, ties as times
from thalweg.core import InputError, read_json, read_table, write_table
from thalweg.ingest.photos import IMAGE_STAMPS
from thalweg.workflow import run_job

log = logging.getLogger("thalweg")


def main(
    *,
    ties: list[Path],
    pulses: list[Path],
    stamps: Path,
    stability: Path | None,
    clock: Path,
    images: Path,
    options: dict[str, Any],
) -> None:
    jitter_s, delay_s = options["jitter_s"], options["delay_s"]
    stamped = read_table(stamps, IMAGE_STAMPS)[0]
    facts: dict[str, Any] = {}
    if len(ties) + len(pulses) != 1:
        raise InputError(
            f"{len(ties)} tables of ties and {len(pulses)} of pulses",
            where=", ".join(str(path) for path in (*ties, *pulses)),
            expected="one table",
            cure="Put all rows into one file; give clock_ties or trigger_pulses, not both",
        )
    if ties:
        found = read_number_columns(ties[0], TIE_COLUMNS)
        tested = read_json(stability) if stability else None
        jitter_s, words = times.jitter_of_ties(jitter_s, tested)
        model = clock_from_ties(*found, jitter_s=jitter_s)
        model = replace(model, notes=(*model.notes, words))
        table = times.tied_images(stamped, model)
    else:
        (t_pulse_s,) = read_number_columns(pulses[0], ("t_gps_s",))
        model, table, facts = times.triggered_images(stamped, t_pulse_s, delay_s=delay_s, jitter_s=jitter_s)
    for line in model.lines():
        log.info("%s", line)
    model.write(clock)
    write_table(images, table, times.RUN_IMAGE_TIMES, facts)


if "snakemake" in globals():
    run_job(main, snakemake)
