"""Features of all parts -> what the pairs of images of one part have in common."""

import logging
from pathlib import Path
from typing import Any

import numpy as np

from thalweg.images.sfm.compare import compare_pairs, part_of_pairs
from thalweg.images.sfm.job import MatchInputs, plan_of
from thalweg.images.sfm.matching import MatchSettings
from thalweg.workflow.job import run_job


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
    options: dict[str, Any],
    folders: list[str],
    threads: int,
) -> None:
    inputs = MatchInputs(
        features=features, images=images, camera=camera, interiors=dict(zip(folders, interiors, strict=True)),
        times=times, trajectory=trajectory,
    )  # fmt: skip
    plan, descriptor = plan_of(inputs, options)
    rows = part_of_pairs(plan, part, options["parts"])
    log = logging.getLogger("thalweg")
    log.info("part %d of %d: %d of %d pairs", part + 1, options["parts"], len(rows), len(plan.pairs))
    settings = MatchSettings.from_section(options)
    found = compare_pairs(plan, descriptor, rows, settings=settings, threads=threads)
    log.info("%d pairs have common points", np.count_nonzero(np.diff(found.pair_start)))
    found.write(pairs)


if "snakemake" in globals():
    run_job(main, snakemake)
