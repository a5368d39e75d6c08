"""Matches -> block of images in its own frame, its pieces, and what became of each image."""

import logging
from pathlib import Path

from thalweg.core import write_json
from thalweg.images.sfm import Matches, block_facts, image_table, main_block, map_images
from thalweg.settings.sections import MappingSettings
from thalweg.workflow import run_job


def main(
    *,
    matches: Matches,
    block: Path,
    pieces: Path,
    images: Path,
    facts: Path,
    options: MappingSettings,
    threads: int,
    device: str,
) -> None:
    mapped = map_images(matches, settings=options, threads=threads, device=device)
    table = image_table(matches, mapped)
    told = block_facts(matches, mapped, table)
    for note in told["notes"]:
        logging.getLogger("thalweg").warning(note)
    why = {name: dict(zip(table["image"], table[name], strict=True)) for name in ("reason", "cause")}
    main_block(mapped, why["reason"], why["cause"]).write(block)
    pieces.mkdir(parents=True, exist_ok=True)
    for k, piece in enumerate(mapped.pieces[1:], start=1):
        piece.write(pieces / f"piece_{k}.npz")
    table.to_csv(images, index=False)
    write_json(facts, told)


if "snakemake" in globals():
    run_job(main, snakemake)
