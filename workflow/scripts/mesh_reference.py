"""Reference cloud, its integrity report and trajectory -> surface mesh of the bank."""

from pathlib import Path
from typing import Any

import numpy as np

from thalweg.core import LocalFrame, Trajectory, write_json
from thalweg.core.geometry import write_mesh
from thalweg.ingest import IntegrityReport
from thalweg.settings.sections import Area as AreaSection, ReferenceSettings
from thalweg.surface import Area, BankFrame, area_margin_m, compare_files, mesh_reference, read_reference
from thalweg.workflow import run_job


def main(
    *,
    cloud: Path,
    integrity: Path,
    trajectory: Path,
    mesh: Path,
    facts: Path,
    origin: dict[str, Any],
    crs: str,
    reference: ReferenceSettings,
    area: AreaSection,
) -> None:
    frame, how = LocalFrame(**origin), reference
    limits = Area.from_section(area, frame, crs)
    report = IntegrityReport.read(integrity)
    names = [Path(file).name for file in report.files]
    read = read_reference(cloud, frame, limits, margin_m=area_margin_m(how), files=names)
    track = Trajectory.read(trajectory)
    surface, about = mesh_reference(read.points_m, track_m=track.position_wcs_m[track.valid], settings=how)
    bank = about["bank_frame"]
    bank_frame = BankFrame(origin_m=np.array(bank["origin_m"]), R_bank_wcs=np.array(bank["R_bank_wcs"]))
    pairs, apart = compare_files(read, bank_frame)
    about |= {
        "area": limits.describe(),
        "area_margin_m": area_margin_m(how),
        "files": list(read.files.values()),
        "pairs_of_files": pairs,
    }
    about |= {"ingest_losses": report.losses, "ingest_notes": report.notes}
    about["counts"] = read.counts | about["counts"]
    about["notes"] = [*read.notes, *apart, *about["notes"]]
    write_mesh(mesh, surface, frame, about)
    write_json(facts, {"origin": origin, **about})


if "snakemake" in globals():
    run_job(main, snakemake)
