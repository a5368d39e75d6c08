"""Compared pairs of all parts -> which images have which points in common."""

import logging
from pathlib import Path

from thalweg.images.sfm import ComparedPairs, MatchInputs, joined_parts, plan_of
from thalweg.settings.sections import MappingSettings
from thalweg.workflow import run_job


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
    options: MappingSettings,
    folders: list[str],
) -> None:
    inputs = MatchInputs(
        features=features,
        images=images,
        camera=camera,
        interiors=dict(zip(folders, interiors, strict=True)),
        times=times,
        trajectory=trajectory,
    )
    plan, _ = plan_of(inputs, options, descriptors=False)
    found = joined_parts(plan, [ComparedPairs.read(path) for path in pairs])
    for note in found.facts["notes"]:
        logging.getLogger("thalweg").warning(note)
    found.write(matches)


if "snakemake" in globals():
    run_job(main, snakemake)
