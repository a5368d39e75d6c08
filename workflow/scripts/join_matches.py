"""Compared pairs of all parts -> which images have which points in common."""

import logging
from pathlib import Path
from typing import Any

from thalweg.images.sfm.compare import ComparedPairs, joined_parts
from thalweg.images.sfm.job import MatchInputs, plan_of
from thalweg.workflow.job import run_job


def main(
    *,
    features: list[Path],
    images: list[Path],
    camera: list[Path],
    interiors: list[Path],
    times: list[Path],
    trajectory: list[Path],
    pairs: list[Path],
    matches: Path,
    options: dict[str, Any],
    folders: list[str],
) -> None:
    inputs = MatchInputs(
        features=features, images=images, camera=camera, interiors=dict(zip(folders, interiors, strict=True)),
        times=times, trajectory=trajectory,
    )  # fmt: skip
    plan, _ = plan_of(inputs, options, descriptors=False)
    found = joined_parts(plan, [ComparedPairs.read(path) for path in pairs])
    for note in found.facts["notes"]:
        logging.getLogger("thalweg").warning(note)
    found.write(matches)


if "snakemake" in globals():
    run_job(main, snakemake)
