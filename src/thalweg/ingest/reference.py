"""Reference clouds of any format -> one cloud in the world frame."""

from pathlib import Path

import numpy as np
from pyproj import CRS

from thalweg.core.errors import InputError
from thalweg.core.frames import LocalFrame
from thalweg.core.las import LazWriter
from thalweg.core.types import AnyArray, ArrayF
from thalweg.ingest.clouds import Cloud, read_cloud
from thalweg.ingest.integrity import IntegrityReport

CHUNK = 1_000_000


def to_world(cloud: Cloud, frame: LocalFrame, crs: str, where: Path) -> tuple[ArrayF, str]:
    """Points of a cloud in the world frame, and a note about what had to be assumed.

    Parameters
    ----------
    cloud : in a map grid with ellipsoidal heights, in a local frame, or without a stated frame.
    frame : the world frame.
    crs : map grid of the campaign; assumed where the file states none.
    where : file, for messages.

    Raises
    ------
    InputError : the file is in another local frame than the campaign.
    GeometryError : the coordinates do not lie in the map grid.
    """
    if isinstance(cloud.frame, LocalFrame):
        if cloud.frame != frame:
            raise InputError(
                f"the cloud is in the local frame at {cloud.frame}",
                expected=f"the campaign's own, {frame}",
                where=where,
                cure="Process both with the same campaign.origin",
            )
        return cloud.points, ""
    if cloud.frame is None:
        return frame.from_map(cloud.points, CRS.from_user_input(crs)), (
            f"{where.name} states no CRS: taken as {crs} with ellipsoidal heights."
        )
    note = ""
    if cloud.frame.is_compound:
        note = f"{where.name}: heights of '{cloud.frame.name}' are taken as ellipsoidal, no geoid applied."
    return frame.from_map(cloud.points, cloud.frame), note


def gather_reference(files: list[Path], out: Path, frame: LocalFrame, crs: str) -> IntegrityReport:
    """Write all reference clouds as one LAZ in the world frame; ``point_source_id`` counts the files from 1.

    Parameters
    ----------
    files : LAS, LAZ, PLY or E57.
    out : target.
    frame : the world frame.
    crs : map grid, see `to_world`.

    Returns
    -------
    report : losses of all files, and the number of points of each.
    """
    total = IntegrityReport(stream="reference", format="reference clouds", files=[str(f) for f in files])
    with LazWriter(out, frame) as writer:
        for number, path in enumerate(files, start=1):
            cloud = read_cloud(path)
            points, note = to_world(cloud, frame, crs, path)
            if note:
                total.note(note)
            total.count(f"points_{number}", len(points))
            total.count("points", len(points))
            total.bytes_read += cloud.report.bytes_read
            for what, n in cloud.report.losses.items():
                total.lose(what, n)
            for sentence in cloud.report.notes:
                total.note(f"{path.name}: {sentence}")
            intensity = _sixteen_bit(cloud.intensity, len(points))
            for start in range(0, len(points), CHUNK):
                part = slice(start, start + CHUNK)
                n = len(points[part])
                writer.append(
                    points[part],
                    intensity=intensity[part],
                    point_source_id=np.full(n, number, dtype=np.uint16),
                )
    return total


def _sixteen_bit(intensity: AnyArray | None, n: int) -> AnyArray:
    """Intensities as uint16: as they are if they fit, else stretched over the full scale."""
    if intensity is None or not n:
        return np.zeros(n, dtype=np.uint16)
    values = np.nan_to_num(np.asarray(intensity, dtype=np.float64))
    low, high = float(values.min()), float(values.max())
    if low >= 0 and 1 < high <= 65_535:
        return np.asarray(np.rint(values).astype(np.uint16))
    span = high - low or 1.0
    return np.asarray(np.rint((values - low) / span * 65_535).astype(np.uint16))
