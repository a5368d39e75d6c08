"""Orthophoto, reference and distances of a scan -> figure of the object."""

import json
from pathlib import Path
from typing import Any

from thalweg.core.geometry.mesh_ply import read_mesh
from thalweg.core.tables import read_parquet
from thalweg.figures.style import save
from thalweg.lightsheet.figures.scan_reference import read_orthophoto, scan_reference
from thalweg.workflow.job import run_job


def main(
    *, picture: Path, world: Path, reference: list[Path], distances: Path, facts: Path,
    scan_reference_png: Path, figures: dict[str, Any], twin: bool, campaign: dict[str, Any], scanned: str,
) -> None:  # fmt: skip
    photo, extent_mm = read_orthophoto(picture, world)
    figure = scan_reference(
        photo, extent_mm, read_mesh(reference[0])[0], read_parquet(distances),
        levels=json.loads(facts.read_text(encoding="utf-8")).get("levels", ()),
        title=f"{campaign['title']}, {scanned.replace('_', ' ')}", twin=twin,
    )  # fmt: skip
    save(figure, scan_reference_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
