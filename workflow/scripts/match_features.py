"""Features of all parts -> what the pairs of images of one part have in common."""

import logging
from pathlib import Path

import numpy as np

from thalweg.images.sfm import MatchInputs, compare_pairs, part_of_pairs, plan_of
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
    pairs: Path,
    part: int,
    parts: int,
    options: MappingSettings,
    folders: list[str],
    threads: int,
    device: str,
) -> None:
    inputs = MatchInputs(
        features=features,
        images=images,
        camera=camera,
        interiors=dict(zip(folders, interiors, strict=True)),
        times=times,
        trajectory=trajectory,
    )
    plan, descriptor = plan_of(inputs, options)
    rows = part_of_pairs(plan, part, parts)
    log = logging.getLogger("thalweg")
    log.info("part %d of %d: %d of %d pairs", part + 1, parts, len(rows), len(plan.pairs))
    found = compare_pairs(plan, descriptor, rows, settings=options, threads=threads, device=device)
    log.info("%d pairs have common points", np.count_nonzero(np.diff(found.pair_start)))
    found.write(pairs)


if "snakemake" in globals():
    run_job(main, snakemake)
