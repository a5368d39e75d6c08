"""Clouds or a surface model from elsewhere -> points with the errors that are stated of them."""

from pathlib import Path

from thalweg.core import LocalFrame, read_parquet
from thalweg.deformation.foreign import prepare_foreign_epoch
from thalweg.settings.sections import Deformation, Epoch
from thalweg.surface import Area
from thalweg.workflow import run_job


def main(
    *,
    positions: Path | None,
    prepared: Path,
    errors: Path,
    name: str,
    stated: Epoch,
    frame: LocalFrame,
    crs: str,
    deformation: Deformation,
) -> None:
    epoch = prepare_foreign_epoch(
        name,
        stated,
        frame=frame,
        crs=crs,
        area=Area.from_section(deformation.area, frame, crs),
        margin_m=deformation.reach_m + 1.0,
        start_gps_s=float(read_parquet(positions)["t_gps_s"].min()) if positions else None,
    )
    epoch.write(prepared, errors)


if "snakemake" in globals():
    run_job(main, snakemake)
