"""Reference cloud, its integrity report and trajectory -> surface mesh of the bank."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from thalweg.core.frames import LocalFrame
from thalweg.core.geometry.mesh_ply import write_mesh
from thalweg.core.trajectory import Trajectory
from thalweg.ingest.integrity import IntegrityReport
from thalweg.surface.area import Area
from thalweg.surface.bank_frame import BankFrame
from thalweg.surface.reference.files import compare_files
from thalweg.surface.reference.mesh import ReferenceSettings, mesh_reference
from thalweg.surface.reference.near_area import area_margin_m, read_reference
from thalweg.workflow.job import run_job


def main(
    *,
    cloud: Path,
    integrity: Path,
    trajectory: Path,
    mesh: Path,
    facts: Path,
    campaign: dict[str, Any],
    reference: dict[str, Any],
    area: dict[str, Any],
) -> None:
    frame = LocalFrame(**campaign["origin"])
    how = ReferenceSettings.from_section(reference)
    limits = Area.from_section(area, frame, campaign["crs"])
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
    facts.write_text(json.dumps({"origin": campaign["origin"], **about}, indent=2) + "\n")


if "snakemake" in globals():
    run_job(main, snakemake)
