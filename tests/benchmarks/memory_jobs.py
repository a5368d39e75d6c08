"""Jobs whose memory `test_memory.py` measures: python -m tests.benchmarks.memory_jobs JOB FOLDER.

Pieces are made small, so that a survey of seconds is as much larger than a piece as a river is in earnest.
"""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from tests.benchmarks import long_bank, turns
from thalweg.core import LazWriter, Rigid, Trajectory, iter_laz
from thalweg.deformation import compare
from thalweg.figures.viewer import read_view, write_viewer
from thalweg.fusion.clouds import read_ground
from thalweg.images.sfm.features import extract_features
from thalweg.ingest import LidarOptions
from thalweg.ingest.registry import lidar_reader
from thalweg.lidar import (
    EXTRA_DIMENSIONS,
    LogSettings,
    Photographs,
    colour,
    export_copc,
    export_map,
    georeference_log,
    sample_cloud,
)
from thalweg.settings.sections import Colour, Filters, GroundFilter, LidarAccuracy
from thalweg.settings.sections.images import FeatureSettings
from thalweg_lab.studies.sensors.colours import CAMERA, EAST, FRAME, poses_of

PIECE = 50_000
SIZES = (1, 4, 16)
POINTS = 100_000
"""Of the smallest cloud; a metre of bank has a thousand."""
IMAGES = 2
UTM = "EPSG:32633"
ANGLES = ("omega", "phi", "kappa")
MOUNT = {"lever_ics_m": [-0.35, 0.0, -0.25], "sigma_lever_m": [0.005] * 3} | {
    f"{sigma}{name}_deg": value
    for name, value in zip(ANGLES, (0.0, -90.0, 0.0), strict=True)
    for sigma, value in (("", value), ("sigma_", 0.05))
}


def cloud(path: Path, n: int) -> None:
    """A bank of a metre for each thousand points, in the order of the boat."""
    rng = np.random.default_rng(1)
    with LazWriter(path, FRAME, extra_dimensions=EXTRA_DIMENSIONS) as writer:
        for first in range(0, n, PIECE):
            x = (first + np.sort(rng.uniform(0, PIECE, PIECE))) / 1000
            z = rng.uniform(-2.0, 4.0, PIECE)
            y = long_bank.FOOT_M + z / 0.65 + 0.2 * np.sin(x / 7) + rng.normal(0, 0.02, PIECE)
            one = np.ones(PIECE, np.uint8)
            writer.append(
                np.column_stack([x, y, z]), t_gps_s=1e9 + x / 1.2, intensity=(40 * one).astype(np.uint16),
                return_number=one, number_of_returns=one,
                extra={name: np.full(PIECE, 0.02) for name in EXTRA_DIMENSIONS} | {"ring": one},
            )  # fmt: skip


def clouds(folder: Path) -> None:
    """Those that other jobs read."""
    for size in SIZES:
        cloud(folder / f"{size}.laz", size * POINTS)


def georeference(folder: Path, size: int) -> None:
    """Packets -> cloud with sigmas."""
    seconds = long_bank.seconds_for(size * POINTS)
    log, path = folder / f"{size}.pcap", folder / f"{size}.parquet"
    long_bank.write_log(log, seconds)
    long_bank.trajectory(seconds).write(path)
    reader = lidar_reader([log], LidarOptions())
    settings = LogSettings(
        mount=Rigid.from_mount(MOUNT),
        beam=LidarAccuracy(),
        filters=Filters(),
        min_range_m=1.0,
        max_range_m=100.0,
        chunk_points=PIECE,
    )
    georeference_log(
        reader, reader.scan().clock, Trajectory.read(path), settings, folder / "cloud.laz",
        out_removed=folder / "removed.parquet",
    )  # fmt: skip


def to_map(folder: Path, size: int) -> None:
    """Local frame -> map grid."""
    export_map(folder / f"{size}.laz", folder / "map.laz", UTM, PIECE)


def to_copc(folder: Path, size: int) -> None:
    """The octree in one file."""
    export_copc(folder / f"{size}.laz", folder / "map.copc.laz", points_at_once=PIECE)


def viewer(folder: Path, size: int) -> None:
    """Nodes of the viewer."""
    write_viewer(
        read_view(folder / f"{size}.laz", PIECE // 2), folder / "viewer", title="x", most_points=PIECE // 2
    )


def picture(folder: Path, size: int) -> None:
    """What the front page and other pictures draw."""
    sample_cloud(folder / f"{size}.laz", PIECE)


def ground(folder: Path, size: int) -> None:
    """Ground of the banks, the input of the terrain model."""
    read_ground(folder / f"{size}.laz", FRAME, UTM, GroundFilter(), sigma_m=0.05)  # type: ignore[arg-type]


def colours(folder: Path, size: int) -> None:
    """Colours of photographs, one for each four metres of bank."""
    x = np.arange(0.0, size * POINTS / 1000, 4.0)
    poses = poses_of(
        np.column_stack([x, np.zeros((len(x), 2))]), np.tile(EAST, (len(x), 1, 1)), 1e9 + x / 1.2
    )
    image = folder / "image.png"
    width, height = CAMERA.size_px
    Image.fromarray(np.random.default_rng(2).integers(0, 256, (height, width, 3), np.uint8)).save(image)
    source = Photographs(poses=poses, images=dict.fromkeys(poses.images, image), masks={}, camera=CAMERA)
    colour.colour_cloud(folder / f"{size}.laz", folder / "coloured.laz", [source], Colour())


def change(folder: Path, size: int) -> None:
    """Distances between two epochs, points of the area in memory."""
    before = np.concatenate([piece["xyz_m"] for piece in iter_laz(folder / f"{size}.laz")])
    cores, towards = before[:: len(before) // 500], np.array([0.0, -1.0, 0.0])
    compare.measure_distances(cores, before, before - 0.05 * towards, compare.Comparison(), towards=towards)


def features(folder: Path, size: int) -> None:
    """Features of images; what is found is the output."""
    rng, images = np.random.default_rng(3), []
    for k in range(size * IMAGES):
        images.append(folder / f"{k}.jpg")
        Image.fromarray(rng.integers(0, 256, (300, 400), np.uint8)).save(images[-1])
    extract_features(images, settings=FeatureSettings(double_size=False))


@dataclass(frozen=True, slots=True)
class Job:
    """What a job does with a size, and the memory that is stated of it, bytes.

    Parameters
    ----------
    held_b : for each of the `PIECE` points that it holds at a time.
    grows_b : for each point, or image, of the survey.
    """

    run: Callable[[Path, int], None]
    holds: str
    held_b: int = 0
    grows_b: int = 0
    unit: int = POINTS


JOBS = {
    "georeference_lidar": Job(georeference, "a piece, and the surface that was seen", 400, 20),
    "export_map": Job(to_map, "a piece", 400),
    "export_copc": Job(to_copc, "a part, sorted and packed", 440),
    "viewer_page": Job(viewer, "four times the points shown, which are half a piece", 400),
    "pictures": Job(picture, "a sample, as the front page and other pictures of a cloud", 400),
    "build_dtm": Job(ground, "a piece, ground of the banks and its grid", 400, 100),
    "colour_points": Job(colours, "a piece, and a map of ranges for each photograph", 400, 24),
    "compare_epochs": Job(change, "a tile, and the points of the area of both epochs", 400, 120),
    "extract_features": Job(features, "four images; what is found in all", 400, 1_000_000, IMAGES),
}


def main(name: str, folder: Path) -> None:
    """Peaks of one job at all sizes above what the idle process holds, as JSON."""
    if name == "clouds":
        return clouds(folder)
    iter_laz.__defaults__ = (PIECE, None)
    colour._CHUNK = PIECE
    compare._POINTS_A_TILE = PIECE
    job, peaks = JOBS[name].run, []
    job(folder, SIZES[0])  # libraries and kernels are loaded by it
    for size in SIZES:
        Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
        idle_gb = turns.peak_gb()
        job(folder, size)
        peaks.append(1000 * (turns.peak_gb() - idle_gb))
    print(json.dumps({"peaks_mb": peaks, "cpu_s": turns.cpu()}))
    return None


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
