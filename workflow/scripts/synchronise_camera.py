"""Poses of the calibration run and positions, or ties, or pulses -> clock of the camera against GPS time."""

import json
from pathlib import Path
from typing import Any

from thalweg.calibration import read_poses
from thalweg.calibration.field import read_place
from thalweg.clocks import ANTENNA_TRACK, IMAGE_FIXES, Track, antenna_track, image_fixes, synchronise
from thalweg.core import LocalFrame, read_table, write_json, write_table
from thalweg.ingest import GNSS_POSITION, INS_STATE
from thalweg.ingest.photos import IMAGE_STAMPS
from thalweg.workflow import run_job


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
    fixes: Path,
    track: Path,
    frame: LocalFrame,
    options: dict[str, Any],
) -> None:
    table, oriented = read_poses(poses)
    run, field_error, counts = synchronise.run_poses(
        list(table["image"]), oriented, read_place(place), read_table(stamps, IMAGE_STAMPS)[0]
    )
    gnss = Track.from_table(
        read_table(positions, GNSS_POSITION)[0],
        frame,
        correlation_time_s=options["position_time_s"],
        white_share=options["white_share"],
    )
    ins = synchronise.run_attitude(read_table(states, INS_STATE)[0], frame, options)
    done = synchronise.synchronise_run(
        run, gnss, ins=ins, field_error=field_error, options=synchronise.offset_options(options)
    )
    done.result.clock.write(clock)
    write_table(images, done.result.images, synchronise.IMAGE_TIMES)
    write_table(fixes, image_fixes(done.result, run, gnss), IMAGE_FIXES)
    write_table(track, antenna_track(gnss), ANTENNA_TRACK)
    variants = json.loads(done.variants.to_json(orient="records"))
    facts = synchronise.run_facts(done) | counts | {"variants": variants}
    write_json(report, facts)


if "snakemake" in globals():
    run_job(main, snakemake)
