"""Poses of the calibration run and positions, or ties, or pulses -> clock of the camera against GPS time."""

import json
from pathlib import Path
from typing import Any

from thalweg.calibration.camera_poses import read_poses
from thalweg.calibration.field_facts import read_place
from thalweg.core.frames import LocalFrame
from thalweg.core.tables import read_table, write_table
from thalweg.ingest.image_stamps import IMAGE_STAMPS
from thalweg.ingest.schemas import GNSS_POSITION, INS_STATE
from thalweg.jobs.job import run_job
from thalweg.timing.synchronise import (
    IMAGE_TIMES,
    offset_options,
    run_attitude,
    run_facts,
    run_poses,
    synchronise_run,
)
from thalweg.timing.track import Track


def main(
    *,
    poses: Path,
    place: Path,
    stamps: Path,
    positions: Path,
    states: Path,
    clock: Path,
    images: Path,
    report: Path,
    campaign: dict[str, Any],
    options: dict[str, Any],
) -> None:
    table, oriented = read_poses(poses)
    frame = LocalFrame(**campaign["origin"])
    run, field_error, counts = run_poses(
        list(table["image"]), oriented, read_place(place), read_table(stamps, IMAGE_STAMPS)[0]
    )
    track = Track.from_table(
        read_table(positions, GNSS_POSITION)[0],
        frame,
        correlation_time_s=options["position_time_s"],
        white_share=options["white_share"],
    )
    ins = run_attitude(read_table(states, INS_STATE)[0], frame, options)
    done = synchronise_run(run, track, ins=ins, field_error=field_error, options=offset_options(options))
    done.result.clock.write(clock)
    write_table(images, done.result.images, IMAGE_TIMES)
    facts = run_facts(done) | counts | {"variants": json.loads(done.variants.to_json(orient="records"))}
    report.write_text(json.dumps(facts, indent=2) + "\n")


if "snakemake" in globals():
    run_job(main, snakemake)
