"""Reference clouds of any format -> one cloud in the world frame."""

from pathlib import Path
from typing import Final

import numpy as np
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from thalweg.core import AnyArray, ArrayF, Frame, GeometryError, InputError, LazWriter, LocalFrame
from thalweg.core.values import FORMS, away_m, readings
from thalweg.ingest import IntegrityReport
from thalweg.ingest.clouds.reader import NO_USE, Cloud, read_cloud

# ---------------------------------------------------------------- A reference that does not lie where the
# campaign is: where it lies, and what it may be instead


FARTHEST_M: Final = 20_000.0
"""A reference farther from the origin belongs to another survey, or is in another grid than was thought."""

_MOST_POINTS: Final = 100_000
_EARTH_M: Final = (6.33e6, 6.40e6)
_OTHER_GRIDS: Final = (31466, 31467, 31468, 31469, 4647, 5650)
"""Gauss-Krueger of Germany, and UTM with the zone before the easting."""


def place_in_words(points: ArrayF) -> str:
    """Smallest and largest coordinates of a file."""
    low, high = points.min(axis=0), points.max(axis=0)
    names = zip(("east", "north", "height"), low, high, strict=True)
    return ", ".join(f"{name} {round(a, 4):.10g} to {round(b, 4):.10g}" for name, a, b in names)


def check_near(
    local_m: ArrayF, points: ArrayF, frame: LocalFrame, crs: str, stated: str, where: Path
) -> None:
    """Refuse a cloud whose middle is more than 20 km from the origin.

    Parameters
    ----------
    local_m : (n, 3) wcs.
    points : (n, 3) as the file has them.
    frame, crs : world frame and map grid of the campaign.
    stated : CRS that the file states; empty if it states none.
    where : the file.

    Raises
    ------
    GeometryError : with the coordinates of the file and a guess at what they are.
    """
    middle = _middle(local_m)
    away_m = float(np.hypot(middle[0], middle[1]))
    if not away_m <= FARTHEST_M:
        raise misplaced(f"{away_m / 1000:,.0f} km from campaign.origin", points, frame, crs, stated, where)


def misplaced(
    found: str, points: ArrayF, frame: LocalFrame, crs: str, stated: str, where: Path
) -> GeometryError:
    """The error for coordinates that are none of the campaign's place; parameters as for `check_near`."""
    said = f"the file states {stated}" if stated else f"the file states no CRS, taken as {crs}"
    origin = _origin(frame, crs)
    expected = "" if origin is None else f"a place near east {origin[0]:.0f}, north {origin[1]:.0f} ({crs})"
    return GeometryError(
        f"{place_in_words(points)} ({said}): {found}",
        expected=expected,
        where=where,
        cure=_guess(points, frame, crs, origin),
    )


def _guess(points: ArrayF, frame: LocalFrame, crs: str, origin: ArrayF | None) -> str:
    """What the file may be, and what to do about it."""
    middle = _middle(points)
    export = f"export the file in {crs}"
    if _EARTH_M[0] < float(np.linalg.norm(middle)) < _EARTH_M[1] and abs(middle[2]) > 1e4:
        return f"Earth-centred coordinates: {export}"
    if origin is not None and np.hypot(*(middle - origin)[:2]) < FARTHEST_M:
        away = np.hypot(*(points - origin)[:, :2].T) > FARTHEST_M
        if n := int(np.count_nonzero(away)):
            return f"Delete {n:,} stray points: the others lie where they should"
        return f"They fit {crs}: correct the CRS that the file states"
    for other in readings(middle[None], FORMS[2], CRS.from_user_input(crs), frame):
        if away_m(other, frame) < FARTHEST_M:
            if other.form == FORMS[0]:
                return f"Local coordinates of the scanner or of a project? Give the file its place: {export}"
            return f"{other.words[0].upper()}{other.words[1:]} would fit: {export}"
    for code in _OTHER_GRIDS:
        if _fits(code, float(middle[0]), float(middle[1]), frame):
            grid = CRS.from_epsg(code)
            how = ", with the grid files of the land survey" if "DHDN" in grid.name else ""
            return f"They fit EPSG:{code} ({grid.name}): {export}{how}"
    return f"Coordinates of another grid or place: {export}; check campaign.crs and campaign.origin"


def _fits(code: int, x: float, y: float, frame: LocalFrame) -> bool:
    try:
        lon, lat = Transformer.from_crs(CRS.from_epsg(code), 4326, always_xy=True).transform(x, y)
    except ProjError:
        return False
    return bool(abs(lon - frame.lon_deg) < 0.3 and abs(lat - frame.lat_deg) < 0.2)


def _origin(frame: LocalFrame, crs: str) -> ArrayF | None:
    try:
        return frame.to_map(np.zeros(3), CRS.from_user_input(crs))
    except GeometryError:
        return None


def _middle(points: ArrayF) -> ArrayF:
    return np.asarray(np.median(points[:: -(-len(points) // _MOST_POINTS)], axis=0))


# ---------------------------------------------------------------- reference


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
        message says where they lie and what they may be.
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
    name = "" if stated is None else stated.name
    try:
        local = frame.from_map(points, stated or CRS.from_user_input(crs))
    except GeometryError as error:
        raise misplaced(error.found, points, frame, crs, name, where) from error
    check_near(local, points, frame, crs, name, where)
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
    total = IntegrityReport(stream="reference", format="reference clouds", files=[str(f) for f in files])
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
