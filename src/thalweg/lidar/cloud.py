"""From a lidar log to a cloud on disk: streaming, every point counted."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from pyproj import CRS

from thalweg.core.errors import CoverageError, InputError
from thalweg.core.frames import LocalFrame
from thalweg.core.las import LazWriter, iter_laz, laz_header
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import AnyArray
from thalweg.ingest.velodyne import LidarClock, LidarOptions, iter_points
from thalweg.lidar.georeference import Mount, georeference_points

EXTRA_DIMENSIONS = {
    "range": ("f4", "measured range, m"),
    "ring": ("u1", "beam, 0 lowest .. 15 highest"),
}
"""Extra bytes of a georeferenced cloud: name -> (type, description)."""


@dataclass(slots=True, kw_only=True)
class Tally:
    """What became of the points of a log; ``written`` and the reasons add up to ``decoded``."""

    decoded: int = 0
    written: int = 0
    without_gps_time: int = 0
    nearer_than_min_range: int = 0
    farther_than_max_range: int = 0
    without_pose: int = 0

    def table(self) -> pd.DataFrame:
        """Columns ``what``, ``n``."""
        words = {name: name.replace("_", " ") for name in self.__slots__}
        return pd.DataFrame([(words[name], getattr(self, name)) for name in words], columns=["what", "n"])


def georeference_log(
    files: Sequence[Path],
    options: LidarOptions,
    clock: LidarClock,
    trajectory: Trajectory,
    mount: Mount,
    out: Path,
    *,
    min_range_m: float,
    max_range_m: float,
    laz_scale_m: float,
    chunk_points: int = 1_000_000,
) -> Tally:
    """Stream a lidar log into a LAZ cloud in the world frame; memory does not grow with the log.

    Parameters
    ----------
    files : the log, in order of time.
    options : how packets become points.
    clock : GPS time of each packet, from `scan_lidar`.
    trajectory, mount : poses.
    out : target, ``.laz``.
    min_range_m, max_range_m : shorter (own hull) and longer ranges are left out, and counted.
    laz_scale_m : resolution of the coordinates.
    chunk_points : points held at a time.

    Raises
    ------
    CoverageError : no point got a pose.
    """
    tally = Tally()
    with LazWriter(out, trajectory.frame, scale_m=laz_scale_m, extra_dimensions=EXTRA_DIMENSIONS) as writer:
        for block in iter_points(files, options, clock=clock, max_points=chunk_points):
            timed = np.isfinite(block.t_gps_s)
            near = timed & (block.range_m < min_range_m)
            far = timed & (block.range_m > max_range_m)
            points, has_pose = georeference_points(block.xyz_scs_m, block.t_gps_s, trajectory, mount)
            keep = has_pose & ~near & ~far
            tally.decoded += len(timed)
            tally.without_gps_time += int((~timed).sum())
            tally.nearer_than_min_range += int(near.sum())
            tally.farther_than_max_range += int(far.sum())
            tally.without_pose += int((timed & ~near & ~far & ~has_pose).sum())
            tally.written += int(keep.sum())
            if keep.any():
                writer.append(
                    points[keep],
                    t_gps_s=block.t_gps_s[keep],
                    intensity=block.intensity[keep],
                    return_number=block.return_number[keep],
                    number_of_returns=block.n_returns[keep],
                    extra={"range": block.range_m[keep], "ring": block.ring[keep]},
                )
        if not tally.written:
            raise CoverageError(
                f"none of {tally.decoded:,} lidar points got a pose ({tally})",
                expected="a trajectory that covers the lidar log",
                where=", ".join(str(f) for f in files),
                cure="Look at streams.csv: do the streams overlap, is the lidar synchronised?",
            )
    return tally


def export_map(points: Path, out: Path, crs: str, chunk_points: int = 1_000_000) -> None:
    """Write a cloud of the world frame in map coordinates with ellipsoidal heights.

    Parameters
    ----------
    points : LAZ in the local frame.
    out : target LAZ.
    crs : projected CRS.

    Raises
    ------
    InputError : the cloud is not in a local frame of Thalweg.
    GeometryError : the CRS is no map projection.
    """
    header = laz_header(points)
    frame = header.frame
    if not isinstance(frame, LocalFrame):
        raise InputError(
            "the cloud is not in a local frame", where=points, expected="a cloud made by Thalweg"
        )
    target = CRS.from_user_input(crs)
    with LazWriter(out, target, scale_m=header.scale_m, extra_dimensions=EXTRA_DIMENSIONS) as writer:
        for chunk in iter_laz(points, chunk_points):
            writer.append(
                frame.to_map(chunk["xyz_m"], target),
                t_gps_s=chunk["t_gps_s"],
                intensity=chunk["intensity"],
                return_number=chunk["return_number"],
                number_of_returns=chunk["number_of_returns"],
                extra={name: chunk[name] for name in EXTRA_DIMENSIONS},
            )


def sample_cloud(points: Path, max_points: int) -> dict[str, AnyArray]:
    """An even sample of a cloud for pictures and checks: every k-th point, at most ``max_points`` of them.

    Returns
    -------
    ``xyz_m`` (n, 3), ``t_gps_s``, ``intensity``, ``range``, ``ring`` and the other dimensions of the cloud.
    """
    step = -(-laz_header(points).n_points // max_points)
    parts: list[dict[str, AnyArray]] = []
    first = 0
    for chunk in iter_laz(points, 1_000_000):
        n = len(chunk["t_gps_s"])
        parts.append({name: values[first::step] for name, values in chunk.items()})
        first = (first - n) % step
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
