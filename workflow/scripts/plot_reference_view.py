"""Reference cloud and trajectory -> the terrestrial scan as it looks from the river."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from thalweg.core.las.files import iter_laz
from thalweg.core.trajectory import Trajectory
from thalweg.figures.accuracy.reference_view import PanoramaView, reference_view, viewpoint_on_track
from thalweg.figures.cloud.splat import Splat
from thalweg.figures.style import save
from thalweg.lidar.cloud import sample_cloud
from thalweg.workflow.job import run_job


def main(
    *,
    reference: Path,
    integrity: Path,
    trajectory: Path,
    reference_view_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    sample, track = sample_cloud(reference, 500_000), Trajectory.read(trajectory)
    source = sample["point_source_id"]
    viewpoint, azimuth_rad = viewpoint_on_track(sample["xyz_m"], track)
    view = PanoramaView.fit(sample["xyz_m"], viewpoint, azimuth_rad=azimuth_rad)
    column, row, _ = view.project(sample["xyz_m"]).T
    seen = (column >= 0) & (column < view.width_px) & (row >= 0) & (row < view.height_px)
    # The scan with most points in the picture; mixed scans would show each other's shadows filled.
    shown = int(np.argmax(np.bincount(source[seen])))
    splat, n = Splat(view), np.zeros(2**16, dtype=np.int64)
    for chunk in iter_laz(reference, 1_000_000):
        n += np.bincount(chunk["point_source_id"], minlength=len(n))
        part = chunk["point_source_id"] == shown
        splat.add(chunk["xyz_m"][part], chunk["intensity"][part])
    files = json.loads(integrity.read_text())["files"]
    figure = reference_view(
        splat,
        sample["xyz_m"],
        source,
        track,
        shown=shown,
        counts=dict(enumerate(n.tolist())),
        names={number: Path(file).stem for number, file in enumerate(files, start=1)},
        title=f"Terrestrial laser scan: {campaign['title']}",
        twin=twin,
    )
    save(figure, reference_view_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
