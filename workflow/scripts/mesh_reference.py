"""Reference cloud and trajectory -> surface mesh of the bank."""

import json
from pathlib import Path
from typing import Any

from thalweg.core.frames import LocalFrame
from thalweg.core.mesh_ply import write_mesh
from thalweg.core.trajectory import Trajectory
from thalweg.jobs.job import run_job
from thalweg.surface.area import Area
from thalweg.surface.near_area import area_margin_m, read_reference
from thalweg.surface.reference_mesh import ReferenceSettings, mesh_reference


def main(
    *,
    cloud: Path,
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
    points, counts = read_reference(cloud, frame, limits, margin_m=area_margin_m(how))
    track = Trajectory.read(trajectory)
    surface, about = mesh_reference(points, track_m=track.position_wcs_m[track.valid], settings=how)
    about |= {"area": limits.describe(), "area_margin_m": area_margin_m(how)}
    about["counts"] = counts | about["counts"]
    write_mesh(mesh, surface, frame, about)
    facts.write_text(json.dumps({"origin": campaign["origin"], **about}, indent=2) + "\n")


if "snakemake" in globals():
    run_job(main, snakemake)
