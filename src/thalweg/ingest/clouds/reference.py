"""Reference clouds of any format -> one cloud in the world frame."""

from pathlib import Path
from typing import Final

import numpy as np
from pyproj import CRS

from thalweg.core import AnyArray, ArrayF, Frame, InputError, LazWriter, LocalFrame
from thalweg.core.values import FORMS, near_world
from thalweg.ingest import IntegrityReport
from thalweg.ingest.clouds.reader import NO_USE, Cloud, read_cloud

FARTHEST_M: Final = 20_000.0
"""A reference farther from the origin belongs to another survey, or is in another grid than was thought."""
CHUNK = 1_000_000

COARSEST_M: Final = 0.01
"""Coordinates in coarser steps are no reference: scanners measure millimetres."""


_ENOUGH: Final = 1000
_SAMPLE: Final = 200_000


def to_world(points: ArrayF, stated: Frame, frame: LocalFrame, crs: str, where: Path) -> tuple[ArrayF, str]:
    """Points of a cloud in the world frame, and a note about what had to be assumed.

    Parameters
    ----------
    points : (n, 3) as the file has them, map heights are ellipsoidal.
    stated : frame of the file: a map grid, a local frame, or None.
    frame : the world frame.
    crs : map grid of the campaign; assumed where the file states none.
    where : file, for messages.

    Raises
    ------
    InputError : the file is in another local frame than the campaign.
    GeometryError : the coordinates do not lie in the map grid, or more than 20 km from the origin; the
        message says where they lie and what they may be (`near_world`).
    """
    if isinstance(stated, LocalFrame):
        if stated != frame:
            raise InputError(
                f"the cloud is in the local frame at {stated}",
                expected=f"the campaign's own, {frame}",
                where=where,
                cure="Process both with the same campaign.origin",
            )
        return points, ""
    said = f"states no CRS, taken as {crs}" if stated is None else f"states {stated.name}"
    local = near_world(
        points,
        FORMS[2],
        stated or CRS.from_user_input(crs),
        frame,
        where,
        what=f"points (the file {said})",
        cure=f"Export the file in {crs}, or check campaign.crs and campaign.origin",
        farthest_m=FARTHEST_M,
    )
    if stated is None:
        return local, f"{where.name} states no CRS: taken as {crs} with ellipsoidal heights."
    note = ""
    if stated.is_compound:
        note = f"{where.name}: heights of '{stated.name}' are taken as ellipsoidal, no geoid applied."
    return local, note


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

    Raises
    ------
    InputError : there are no files, one cannot be read, or its coordinates resolve no centimetre.
    GeometryError : one lies elsewhere.
    """
    if not files:
        raise InputError(
            "no reference cloud",
            expected="at least one file",
            where="logs.reference",
            cure="Name the terrestrial scans there, or do not ask for a comparison with a reference",
        )
    total = IntegrityReport.of("reference", "reference clouds", files)
    with LazWriter(out, frame) as writer:
        for number, path in enumerate(files, start=1):
            cloud = read_cloud(path)
            points, note = to_world(cloud.points, cloud.frame, frame, crs, path)
            _refuse_coarse(cloud, path)
            for sentence in filter(None, (note, *_stepped(cloud.points, path))):
                total.note(sentence)
            total.count(f"points_{number}", len(points))
            total.count("points", len(points))
            total.bytes_read += cloud.report.bytes_read
            for what, n in cloud.report.losses.items():
                total.lose(what, n)
            for sentence in cloud.sentences():
                if sentence not in NO_USE:
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


def _refuse_coarse(cloud: Cloud, path: Path) -> None:
    if cloud.step_m > COARSEST_M:
        raise InputError(
            f"coordinates up to {np.abs(cloud.points).max():.0f} m that resolve {cloud.step_m * 1000:.3g} mm",
            expected=f"{COARSEST_M * 1000:g} mm or finer",
            where=path,
            cure="Export doubles (LAZ: a scale of 1 mm), or coordinates with a shift near zero",
        )


def _stepped(points: ArrayF, path: Path) -> list[str]:
    """Sentences about axes whose values come in coarse steps: rounded before they came into this file."""
    notes: list[str] = []
    if len(points) < _ENOUGH:
        return notes
    for axis, name in enumerate(("east", "north", "height")):
        step = np.diff(np.unique(points[:: -(-len(points) // _SAMPLE), axis]))
        if len(step) and step.min() > COARSEST_M:
            notes.append(
                f"{path.name}: its {name} coordinates come in steps of {step.min() * 1000:.3g} mm: rounded "
                "before this export (single precision?), or a raster. The reference is no better than that."
            )
    return notes


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
