"""Point clouds of other makers: LAS/LAZ, PLY, E57 and PCD, with every lost point counted.

Coordinates stay in the file's own frame, in float64; nothing is shifted or transformed but the poses of
the scans inside an E57, which belong to the format, units, which become metres, and degrees, which become
the zone of UTM of their middle.

A LAZ file keeps the table of its chunks at the end, and no library reads one without it. Chunks of
layered LAZ (point formats 6 to 10) state the sizes of their layers, so a cut file is walked from the
front, its whole chunks are given a new table in a temporary file, and that is read (LASzip 3
specification, "layered chunked" compressor).

Of PCD files, the Point Cloud Library's, the compressed form is refused by name.
"""

import re
import struct
import tempfile
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import lazrs
import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError
from scipy.spatial.transform import Rotation

from thalweg.core import (
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayF32,
    ArrayI,
    ArrayU8,
    Frame,
    InputError,
    LazHeader,
    LocalFrame,
    UnsupportedError,
    iter_laz,
    laz_header,
    laz_layout,
    library_errors,
    local_crs,
    optional,
    require_file,
    whole_chunks,
)
from thalweg.core.geometry import ORDERS, PlyElement, frame_of_comments, read_ply_header
from thalweg.core.values import (
    check_places,
    far_repeated,
    in_metres,
    is_nothing,
    matters,
    onto_map,
    refuse_depths,
    unit_in_words,
)
from thalweg.ingest import (
    TIME_SCALES,
    IntegrityReport,
    gps_from_scale,
    tell_time_scale,
    time_contradiction,
    time_scale_words,
)

pye57 = optional("pye57")

# ---------------------------------------------------------------- what the cloud readers hand over


NO_CRS: Final = "The file states no coordinate reference system."


@dataclass(slots=True, kw_only=True)
class Cloud:
    """A point cloud in the frame of its file.

    Attributes
    ----------
    points : (n, 3) float64, metres: other units and degrees are converted where the file states them.
    report : counts, losses and notes.
    intensity : (n,) float32 as stored, or None.
    rgb : (n, 3) uint8, or None; 16-bit and unit-interval colours are brought to 8 bit.
    t_gps_s : (n,) adjusted standard GPS time, NaN where unknown, or None.
    ring : (n,) number of the laser, or None.
    frame : local frame or CRS that the file states, else None.
    step_m : coarsest step of the coordinates that the file's number format can tell; 0: far below 1 mm.
    """

    points: ArrayF
    report: IntegrityReport
    intensity: ArrayF32 | None = None
    rgb: ArrayU8 | None = None
    t_gps_s: ArrayF | None = None
    ring: ArrayI | None = None
    frame: Frame = None
    step_m: float = 0.0

    @property
    def crs(self) -> CRS | None:
        """CRS of the points; the engineering CRS of a local frame; None if the file states none."""
        return local_crs(self.frame) if isinstance(self.frame, LocalFrame) else self.frame

    def sentences(self) -> list[str]:
        """Losses and notes of the report, as people read them; that there is no CRS is told by callers."""
        lost = [f"{n:,} {what.replace('_', ' ')}." for what, n in self.report.losses.items()]
        return lost + [text for text in self.report.notes if text != NO_CRS]


def single_step_m(values: AnyArray) -> float:
    """Step of single precision at the largest finite one of some values."""
    reach = np.max(np.abs(values), where=np.isfinite(values), initial=0.0)
    return float(np.spacing(np.float32(min(float(reach), float(np.finfo(np.float32).max) / 2))))


def eight_bit(rgb: AnyArray, report: IntegrityReport) -> ArrayU8:
    """Colours to 8 bit: uint8 as they are, floats from 0..1, wider integers by their high byte.

    Integers of 16 bit that never exceed 255 are taken as 8-bit values; floats above 1 as 0..255.
    """
    if rgb.dtype == np.uint8:
        return rgb
    if rgb.dtype.kind == "f":
        clean = np.nan_to_num(rgb, nan=0.0, posinf=0.0, neginf=0.0)
        factor = 255.0 if not clean.size or clean.max() <= 1.0 else 1.0
        return np.clip(np.rint(clean * factor), 0, 255).astype(np.uint8)
    if not rgb.size or rgb.max() <= 255:
        return np.clip(rgb, 0, 255).astype(np.uint8)
    report.note("Colours of 16 bit are brought to 8 bit.")
    return np.clip(rgb // 256, 0, 255).astype(np.uint8)


# ---------------------------------------------------------------- LAS and LAZ clouds of other makers,
# whole or cut


WEEK_TIMES: Final = "Times are seconds of an unstated GPS week: they are left empty."
NO_TIMES: Final = "All times are 0: the points have none."
NO_USE: Final = (WEEK_TIMES, NO_TIMES)
"""Notes of no use where times do not count."""

_CHUNK_POINTS: Final = 500_000
_DEGREE_M: Final = 111_195.0
"""Length of a degree on a sphere as large as the earth."""
_NAMES: Final[tuple[str, ...]] = ("xyz_m", "intensity", "rgb", "t_gps_s", "t_week_s", "classification")
_WATER: Final = {9: "water", 41: "water surface", 42: "derived water surface", 45: "no bottom found"}
"""Classes of the ASPRS, those above 9 of its bathymetric profile."""


def read_las(path: Path, report: IntegrityReport) -> Cloud:
    """All points of a LAS or LAZ file that can be read.

    Raises
    ------
    InputError : the header is damaged, or no point can be read.
    """
    header = laz_header(path)
    report.format = f"LAS/LAZ, point format {header.point_format}"
    report.count("points_declared", header.n_points)
    for sentence in header.notes:
        report.note(sentence)
    parts: list[dict[str, AnyArray]] = []
    marked: Counter[str] = Counter()
    try:
        _collect(iter_laz(path, _CHUNK_POINTS, marked), parts)
    except InputError as error:
        if not parts:
            _salvage(path, parts, marked, error)
        report.note(f"The file is cut or damaged: {error.found}.")
    n = sum(len(part["xyz_m"]) for part in parts)
    for what, lost in marked.items():
        report.lose(what, lost)
    if not n:
        words = " and ".join(f"{lost:,} {what.replace('_', ' ')}" for what, lost in marked.items())
        raise InputError(
            f"the cloud has no points but {words}" if words else "the cloud has no points",
            expected="at least one point" + (" that is meant" if words else ""),
            where=path,
            cure="Clear these flags or classes where the points count; write them with an offset near them"
            if words
            else "Export it again, or name another file",
        )
    if (there := n + marked.total()) < header.n_points:
        report.lose("points_missing", header.n_points - there)
        report.note(f"{there:,} of {header.n_points:,} points could be read.")
    columns = {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}
    for number, what in _WATER.items():
        if n := int(np.count_nonzero(columns["classification"] == number)):
            report.note(
                f"{n:,} points of class {number} ({what}) are kept: leave them out where ground counts."
            )
    return _raw(columns, header, report)


def _collect(chunks: Iterable[dict[str, AnyArray]], parts: list[dict[str, AnyArray]]) -> None:
    for chunk in chunks:
        kept: dict[str, AnyArray] = {name: chunk[name] for name in _NAMES if name in chunk}
        parts.append(kept)  # one by one: what was read before an error stays


def _raw(columns: dict[str, AnyArray], header: LazHeader, report: IntegrityReport) -> Cloud:
    points = columns["xyz_m"]
    if header.box_m is not None and not header.format_version:
        step = 1.5 * np.array(header.scales_m)
        outside = ((points < header.box_m[0] - step) | (points > header.box_m[1] + step)).any(axis=1)
        if n := int(np.count_nonzero(outside)):
            report.note(f"{n:,} points lie outside of the box that the header states; the points count.")
    t = columns["t_gps_s"]
    if not header.format_version and header.has_time:
        t = _times(columns["t_gps_s" if header.standard_time else "t_week_s"], header, report)
    steps = header.scales_m
    if isinstance(header.frame, CRS) and header.frame.is_geographic:
        steps = (steps[0] * _DEGREE_M, steps[1] * _DEGREE_M, steps[2])
    return Cloud(
        report=report,
        points=points,
        intensity=columns["intensity"].astype(np.float32) if "intensity" in columns else None,
        rgb=eight_bit(columns["rgb"], report) if "rgb" in columns else None,
        t_gps_s=t if np.isfinite(t).any() else None,
        frame=header.frame,
        step_m=max(steps),
    )


def _times(values: ArrayF, header: LazHeader, report: IntegrityReport) -> ArrayF:
    """Times (n,) by their size, whatever the flag of the header says; NaN where there is none."""
    t = np.where(values == 0.0, np.nan, values)
    scale = "adjusted_s" if header.standard_time else "week_s"
    if not np.isfinite(t).any():
        report.note(NO_TIMES)
        return t
    told = [each for each in tell_time_scale(t) if each != "day_s"]
    wrong = time_contradiction(t, scale)
    if wrong or (told and scale not in told):
        if len(told) != 1:
            report.note(f"Times are left empty: {time_scale_words(t, told) if told else wrong}.")
            return np.full(len(t), np.nan)
        if told[0] != "week_s":
            report.note(f"The header states {TIME_SCALES[scale]}, but {wrong or time_scale_words(t, told)}.")
        scale = told[0]
    if scale == "week_s":
        report.note(WEEK_TIMES)
        return np.full(len(t), np.nan)
    report.lose("times_that_are_zero", np.count_nonzero(np.isnan(t)))
    return gps_from_scale(t, scale)


def _salvage(path: Path, parts: list[dict[str, AnyArray]], marked: Counter[str], error: InputError) -> None:
    """Read the whole chunks of a cut layered LAZ; raises the first error again if there are none."""
    layout = laz_layout(path)
    table, end = whole_chunks(path, layout) if layout is not None else ([], 0)
    if layout is None or not table:
        raise error
    with tempfile.TemporaryDirectory() as folder:
        mended = Path(folder) / path.name
        with path.open("rb") as source, mended.open("wb") as out:
            head = bytearray(source.read(layout.start))
            # no extended VLRs, and the number of points that are left; format 6+ has no 32-bit count
            struct.pack_into("<QIQ", head, 235, 0, 0, sum(n for n, _ in table))
            out.write(head)
            out.write(struct.pack("<q", end))
            source.seek(layout.start + 8)
            for _, length in table:
                out.write(source.read(length))
            with library_errors(path, "mend the LAZ file"):
                lazrs.write_chunk_table(out, table, lazrs.LazVlr(layout.laszip))
        try:
            _collect(iter_laz(mended, _CHUNK_POINTS, marked), parts)
        except InputError:
            if not parts:
                raise error from None


# ---------------------------------------------------------------- scans of an E57 file (ASTM E2807), each
# moved by its pose into the frame of the file


_CARTESIAN: Final = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL: Final = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_ANGLES: Final = ("Azimuth", "Elevation")
_e57_COLOURS: Final = ("colorRed", "colorGreen", "colorBlue")
_BUFFER_POINTS: Final = 1 << 20
_ROUNDED: Final = 0.05
"""A rotation whose numbers were rounded has a length that differs from 1 by less."""


def read_e57(path: Path, report: IntegrityReport) -> Cloud:
    """All scans of an E57 file in one cloud.

    A scan that the library stops reading (wrong page checksum, cut file) keeps the points before the
    defect; the others are counted as missing.

    Raises
    ------
    InputError : the file cannot be opened as E57, or holds no points.
    """
    report.format = "E57"
    cure = "Copy the file again from its source; the XML section at the end of an E57 must be whole"
    with library_errors(path, "open the E57 file", cure):
        file = pye57.E57(str(path))
    parts: list[dict[str, AnyArray]] = []
    frame = None
    try:
        with library_errors(path, "read the E57 structure", cure):
            n_scans = file.scan_count
            frame = _crs(file, report)
            refuse_depths(frame, path)
        for index in range(n_scans):
            part = _scan(file, index, path, report)
            if part is not None:
                parts.append(part)
                report.count("scans")
    finally:
        file.close()
    if not parts:
        raise InputError(f"no points in {n_scans} scans", expected="at least one scan", where=path, cure=cure)
    columns = [set(p) - {"step_m"} for p in parts]
    common = set.intersection(*columns)
    for name in sorted(set.union(*columns) - common):
        report.note(f"'{name}' is not in all scans and is left out.")
    joined = {name: np.concatenate([p[name] for p in parts]) for name in common}
    return Cloud(
        report=report,
        points=joined["points"],
        intensity=joined.get("intensity"),
        rgb=eight_bit(joined["rgb"], report) if "rgb" in joined else None,
        frame=frame,
        step_m=max(float(p["step_m"]) for p in parts),
    )


def _crs(file: Any, report: IntegrityReport) -> CRS | None:
    """CRS of the file; its coordinates are metres by the standard, whatever unit the text has."""
    if not file.root.isDefined("coordinateMetadata"):
        return None
    text = str(file.root["coordinateMetadata"].value()).strip()
    try:
        return in_metres(CRS.from_wkt(text)).crs if text else None
    except CRSError:
        report.note(f"The text on coordinates is no CRS ({text[:60]!r}): the cloud counts as without one.")
        return None


def _scan(file: Any, index: int, path: Path, report: IntegrityReport) -> dict[str, AnyArray] | None:
    with library_errors(path, f"read the header of scan {index + 1}"):
        header = file.get_header(index)
        declared = int(header.point_count)
        fields = list(header.point_fields)
        pose = _pose(header, index, report)
    report.count("points_declared", declared)
    system = next((s for s in (_CARTESIAN, _SPHERICAL) if set(s) <= set(fields)), None)
    if system is None:
        report.note(f"Scan {index + 1} has neither cartesian nor spherical coordinates and is left out.")
        report.lose("points_missing", declared)
        return None
    wanted = list(system)
    invalid = "cartesianInvalidState" if system is _CARTESIAN else "sphericalInvalidState"
    wanted += [n for n in (invalid, "intensity") if n in fields]
    if set(_e57_COLOURS) <= set(fields):
        wanted += _e57_COLOURS
    data, error = _records(file, header, wanted, declared)
    n = len(data[wanted[0]])
    if n < declared:
        report.lose("points_missing", declared - n)
        report.note(f"Scan {index + 1} ends after {n:,} of {declared:,} points ({error or 'cut'}).")
    if not n:
        return None
    good = np.ones(n, dtype=np.bool_)
    if invalid in data:
        # 1: direction only, 2: nothing valid
        good = data[invalid] == 0
        report.lose("points_marked_invalid", np.count_nonzero(~good))
    at_scanner = np.all([data[name] == 0.0 for name in system[: 1 if system is _SPHERICAL else 3]], axis=0)
    if lost := int(np.count_nonzero(at_scanner & good)):
        report.lose("points_at_the_scanner_itself", lost)
        good &= ~at_scanner
    xyz = np.stack([data[name] for name in system], axis=-1)[good]
    # the poses are doubles: what counts are the numbers before them
    steps = [_step(header, name, xyz[:, i]) for i, name in enumerate(system) if not name.endswith(_ANGLES)]
    if system is _SPHERICAL:
        r, azimuth, elevation = xyz.T
        flat = r * np.cos(elevation)
        xyz = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), r * np.sin(elevation)], axis=-1)
    if pose is not None:
        rotation, translation = pose
        xyz = xyz @ rotation.T + translation
    part: dict[str, AnyArray] = {"points": xyz, "step_m": np.array(max(steps))}
    if "intensity" in data:
        part["intensity"] = data["intensity"][good]
    if _e57_COLOURS[0] in data:
        part["rgb"] = np.stack([data[name] for name in _e57_COLOURS], axis=-1)[good]
    return part


def _records(file: Any, header: Any, names: list[str], declared: int) -> tuple[dict[str, AnyArray], str]:
    """Records of a scan as far as the library reads them, and its last words if it stopped early."""
    types = {"intensity": "f", "cartesianInvalidState": "b", "sphericalInvalidState": "b"}
    types |= dict.fromkeys(_e57_COLOURS, "H")
    capacity = max(1, min(declared, _BUFFER_POINTS))
    arrays = {name: np.empty(capacity, types.get(name, "d")) for name in names}
    parts: dict[str, list[AnyArray]] = {name: [array[:0].copy()] for name, array in arrays.items()}
    done, words = 0, ""
    try:
        with library_errors(Path(), "read points"):
            buffers = pye57.libe57.VectorSourceDestBuffer()
            for name, array in arrays.items():
                buffers.append(
                    pye57.libe57.SourceDestBuffer(file.image_file, name, array, capacity, True, True)
                )
            reader = header.points.reader(buffers)
            while done < declared and (n := int(reader.read())):
                n = min(n, declared - done)
                for name, array in arrays.items():
                    parts[name].append(array[:n].copy())
                done += n
    except InputError as error:
        words = error.found
    return {name: np.concatenate(blocks) for name, blocks in parts.items()}, words


def _step(header: Any, name: str, values: ArrayF) -> float:
    """Step of a column by its number format, metres."""
    node = pye57.libe57.StructureNode(header.points.prototype())[name]
    if isinstance(node, pye57.libe57.ScaledIntegerNode):
        return float(node.scale())
    if (
        isinstance(node, pye57.libe57.FloatNode)
        and node.precision() == pye57.libe57.FloatPrecision.E57_SINGLE
    ):
        return single_step_m(values)
    return 0.0


def _pose(header: Any, index: int, report: IntegrityReport) -> tuple[ArrayF, ArrayF] | None:
    if not header.has_pose():
        return None
    w, x, y, z = (float(v) for v in header.rotation)
    translation = np.asarray(header.translation, dtype=np.float64)
    length = float(np.linalg.norm([w, x, y, z]))
    if not abs(length - 1.0) < _ROUNDED:
        report.note(
            f"Scan {index + 1} states the quaternion {w:g}, {x:g}, {y:g}, {z:g}, which is no rotation: its "
            "points are shifted and not turned."
        )
        return np.eye(3), translation
    return Rotation.from_quat([x, y, z, w]).as_matrix(), translation


# ---------------------------------------------------------------- vertices of a PLY file (ascii, binary of
# either byte order), whose faces are no points and are left out; points of a PCD file
#
# Formats: G. Turk, "The PLY Polygon File Format" (1994); "The PCD file format", Point Cloud Library, 0.7.


_INTENSITY: Final = ("intensity", "scalar_intensity", "reflectance", "scalar_reflectance")
_PCD_HEAD: Final = re.compile(rb"(?:[^\n]*\n)*?DATA[ \t]+\w+[ \t]*\r?\n")
_COLOURS: Final = (
    ("red", "green", "blue"),
    ("r", "g", "b"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
)


def read_ply(path: Path, report: IntegrityReport) -> Cloud:
    """Vertices of a PLY file.

    Raises
    ------
    InputError : the header is damaged, or there are no vertices with x, y, z.
    UnsupportedError : vertices with list properties, or behind an element with lists.
    """
    header = read_ply_header(path, cure="Export or copy the file again")
    form, elements = header.form, header.elements
    report.format = f"PLY {form}"
    frame = _frame_of_remarks(header.comments, path, report)
    if header.comments:
        report.details["comments"] = "; ".join(text.strip() for text in header.comments)[:500]
    index = next((i for i, e in enumerate(elements) if e.name == "vertex"), None)
    if index is None:
        raise InputError("no element 'vertex'", expected="points", where=path)
    vertex, before = elements[index], elements[:index]
    if vertex.lists or any(e.lists for e in before):
        raise UnsupportedError(
            "list properties in or before the vertices",
            expected="plain vertices first",
            where=path,
            cure="Export as LAZ",
        )
    for element in elements[index + 1 :]:
        if element.count:
            report.note(f"{element.count:,} elements '{element.name}' are no points and are left out.")
    cloud = _of_vertices(path, header.end, form, before, vertex, report)
    cloud.frame = frame
    return cloud


def _frame_of_remarks(comments: list[str], path: Path, report: IntegrityReport) -> LocalFrame | None:
    """The frame that a mesh of Thalweg states in its comments; notes of what those of others may change.

    Raises
    ------
    InputError : coordinates in another unit than metres.
    """
    frame = frame_of_comments(comments, path)
    for text in comments if frame is None else ():
        if unit_in_words(text) is not None:
            raise InputError(
                f"the comment '{text.strip()[:60]}'",
                expected="coordinates in metres",
                where=path,
                cure="Export metres, or LAS with its unit",
            )
        if matters(text):
            report.note(f"A comment says '{text.strip()[:80]}': coordinates are taken as they stand.")
    return frame


_PCD_FORMS: Final = {"ascii": "ascii", "binary": "binary_little_endian"}
_HEAD_BYTES: Final = 1 << 14


def read_pcd(path: Path, report: IntegrityReport) -> Cloud:
    """Points of a PCD file.

    Raises
    ------
    InputError : the head is damaged, or there are no fields x, y, z.
    UnsupportedError : the data are compressed.
    """
    with path.open("rb") as stream:
        match = _PCD_HEAD.match(stream.read(_HEAD_BYTES))
    try:
        text = match[0].decode("latin-1") if match else ""
        head = dict(line.partition(" ")[::2] for line in text.splitlines())
        names, sizes, types = (head[key].split() for key in ("FIELDS", "SIZE", "TYPE"))
        counts = map(int, head.get("COUNT", "1 " * len(names)).split())
        fields = [
            (name if name != "_" and not k else f"{name} {i} {k}", f"{kind.lower()}{size}")
            for i, (name, size, kind, count) in enumerate(zip(names, sizes, types, counts, strict=True))
            for k in range(count)
        ]
        points, end = PlyElement("points", int(head["POINTS"]), fields), match.end() if match else 0
        points.dtype("<")
    except (KeyError, ValueError, TypeError) as error:
        raise InputError(
            f"no PCD head ({error})",
            expected="FIELDS, SIZE, TYPE, POINTS and DATA",
            where=path,
            cure="Export or copy the file again",
        ) from error
    form = _PCD_FORMS.get(head["DATA"].strip())
    if form is None:
        raise UnsupportedError(
            f"data in the form {head['DATA']!r}",
            expected=" or ".join(_PCD_FORMS),
            where=path,
            cure="Convert it with pcl_convert_pcd_ascii_binary <in> <out> 0",
        )
    report.format = f"PCD {form}"
    _frame_of_remarks([line[1:] for line in text.splitlines() if line.startswith("#")], path, report)
    if head.get("VIEWPOINT", "").split()[:7] not in ([], ["0", "0", "0", "1", "0", "0", "0"]):
        report.note(
            f"It states a VIEWPOINT ({head['VIEWPOINT'].strip()}): coordinates are taken as they stand."
        )
    return _of_vertices(path, end, form, [], points, report)


def _of_vertices(
    path: Path, start: int, form: str, before: list[PlyElement], vertex: PlyElement, report: IntegrityReport
) -> Cloud:
    """Cloud of the rows of a table of points, which begins at the byte ``start``."""
    names = vertex.names
    if not {"x", "y", "z"} <= set(names) or len(set(names)) < len(names):
        raise InputError(f"properties {names} of points", expected="x, y, z, each once", where=path)
    table = _body(path, start, form, before, vertex, report)
    report.count("points_declared", vertex.count)
    types = dict(vertex.fields)
    points = np.stack([table[a].astype(np.float64) for a in "xyz"], axis=-1)
    single = [i for i, a in enumerate("xyz") if types[a] == "f4" and form != "ascii"]
    colours = next((c for c in _COLOURS if set(c) <= set(types)), None)
    return Cloud(
        report=report,
        points=points,
        intensity=next((table[n].astype(np.float32) for n in _INTENSITY if n in types), None),
        rgb=eight_bit(np.stack([table[n] for n in colours], axis=-1), report) if colours else None,
        ring=table["ring"].astype(np.int64) if "ring" in types else None,
        step_m=single_step_m(points[:, single]) if single else 0.0,
    )


def _body(
    path: Path, start: int, form: str, before: list[PlyElement], vertex: PlyElement, report: IntegrityReport
) -> AnyArray:
    """Vertices present, as a structured array."""
    if form == "ascii":
        return _ascii(path, start, sum(e.count for e in before), vertex, report)
    order = ORDERS[form]
    start += sum(e.count * e.dtype(order).itemsize for e in before)
    dtype = vertex.dtype(order)
    present = min(max(path.stat().st_size - start, 0) // dtype.itemsize, vertex.count)
    _cut(present, vertex.count, report)
    return np.fromfile(path, dtype, count=present, offset=start) if present else np.zeros(0, dtype)


def _ascii(path: Path, start: int, skip: int, vertex: PlyElement, report: IntegrityReport) -> AnyArray:
    with path.open("rb") as stream:
        stream.seek(start)
        lines = stream.read().decode("latin-1").splitlines()[skip:]
    lines = [line for line in lines if line.strip()][: vertex.count]
    width = len(vertex.fields)
    rows = []
    for line in lines:
        try:
            row = [float(x) for x in line.split()]
        except ValueError:
            row = []
        if len(row) == width:
            rows.append(row)
    report.lose("damaged_lines", len(lines) - len(rows))
    _cut(len(lines), vertex.count, report)
    values = np.array(rows, dtype=np.float64).reshape(-1, width)
    table = np.zeros(len(values), dtype=[(n, t if t in ("u1", "u2") else "f8") for n, t in vertex.fields])
    for i, (name, kind) in enumerate(vertex.fields):
        column = values[:, i]
        if kind in ("u1", "u2"):
            column = np.clip(np.nan_to_num(column), 0, np.iinfo(kind).max)
        table[name] = column
    return table


def _cut(present: int, declared: int, report: IntegrityReport) -> None:
    if present < declared:
        report.lose("points_missing", declared - present)
        report.note(f"The file is cut: {present:,} of {declared:,} points are there.")


# ---------------------------------------------------------------- reader


_READERS: Final = {
    b"LASF": read_las,
    b"ply": read_ply,
    b"ASTM-E57": read_e57,
    b"# .PCD": read_pcd,
    b"VERSION": read_pcd,
}
_KINDS: Final = "a LAS, LAZ, PLY, E57 or PCD cloud"
_FINE_M: Final = 1.01e-3
"""Steps of a millimetre are usual and are not told."""
_FAR_FROM_ZERO_M: Final = 1000.0
"""In a cloud on a map a point at 0, 0, 0 is none."""


_SAMPLE: Final = 1000
"""Points by which the place of a cloud is judged."""


def _without_height(z: ArrayF, good: ArrayB) -> ArrayB:
    """Which heights (n,) of the good points stand for none."""
    none = np.zeros(len(z), dtype=np.bool_)
    while len(left := z[good & ~none]):
        ends = np.array([left.min(), left.max()])
        found = [*ends[is_nothing(ends, "height")], *far_repeated(left)]
        if not found:
            break
        none |= good & np.isin(z, found)
    return none


def _note_coarse(points: ArrayF, step_m: float, report: IntegrityReport) -> None:
    """Tell of coordinates (n, 3) whose number format is coarser than a millimetre."""
    if step_m > _FINE_M:
        report.note(
            f"Coordinates up to {np.abs(points).max():.0f} m resolve {step_m * 1000:.3g} mm only (single "
            "precision, or a coarse scale). Export doubles, a finer scale, or coordinates with a shift."
        )


def corners_of_mesh(path: Path, xyz_m: ArrayF) -> Cloud:
    """Corners (n, 3) of a mesh (PLY), with the frame and what else its file says of them.

    Raises
    ------
    InputError : the header is damaged, or states another unit than metres.
    """
    header = read_ply_header(path, cure="Export the mesh again as PLY")
    report = IntegrityReport.of("mesh", "", [path])
    frame = _frame_of_remarks(header.comments, path, report)
    types = dict(next(each.fields for each in header.elements if each.name == "vertex"))
    single = [i for i, axis in enumerate("xyz") if types[axis] == "f4"]
    step_m = single_step_m(xyz_m[:, single]) if single and header.form != "ascii" else 0.0
    _note_coarse(xyz_m, step_m, report)
    return Cloud(points=xyz_m, report=report, frame=frame, step_m=step_m)


def read_cloud(path: Path) -> Cloud:
    """Read a cloud; the format is recognised by content.

    Parameters
    ----------
    path : LAS, LAZ, PLY, E57 or PCD.

    Returns
    -------
    The points that are meant. Points that are not finite, marked as invalid, withheld, synthetic or noise,
    or missing at the end of a cut file are counted in ``report.losses``.

    Raises
    ------
    InputError : missing, empty, damaged beyond reading, or without any finite point.
    UnsupportedError : another format.
    """
    require_file(path, _KINDS)
    with path.open("rb") as stream:
        head = stream.read(16)
    reader = next((r for magic, r in _READERS.items() if head.startswith(magic)), None)
    if reader is None:
        raise UnsupportedError(
            f"begins with {head[:8].hex(' ')}", expected=_KINDS, where=path, cure="Export the cloud as LAZ"
        )
    report = IntegrityReport.of("cloud", "", [path], bytes_read=path.stat().st_size)
    cloud = reader(path, report)
    good: AnyArray = np.all(np.isfinite(cloud.points), axis=1)
    report.lose("points_not_finite", np.count_nonzero(~good))
    zero: AnyArray = good & ~np.any(cloud.points, axis=1)
    if zero.any() and np.linalg.norm(np.median(cloud.points[good], axis=0)) > _FAR_FROM_ZERO_M:
        report.lose("points_at_zero", int(np.count_nonzero(zero)))
        good &= ~zero
    if lost := int(np.count_nonzero(none := _without_height(cloud.points[:, 2], good))):
        report.lose("points_with_a_height_that_stands_for_none", lost)
        good &= ~none
    if not good.any():
        raise InputError(
            f"none of {len(good):,} points is finite",
            expected="points",
            where=path,
            cure="Export the cloud again",
        )
    if not good.all():
        for name in ("points", "intensity", "rgb", "t_gps_s", "ring"):
            if (values := getattr(cloud, name)) is not None:
                setattr(cloud, name, values[good])
    _note_coarse(cloud.points, cloud.step_m, report)
    if isinstance(cloud.frame, CRS) and not cloud.frame.is_geocentric:
        some, degrees = cloud.points[:: max(len(cloud.points) // _SAMPLE, 1), :2], cloud.frame.is_geographic
        try:
            check_places(some, cloud.frame, where=path, degrees=degrees)
        except InputError as error:  # which may be looked at for all that
            report.note(f"Its coordinates contradict its coordinate system: {error.found}.")
    if isinstance(cloud.frame, CRS) and (cloud.frame.is_geographic or cloud.frame.is_geocentric):
        cloud.points, cloud.frame, note = onto_map(cloud.points, cloud.frame)
        report.note(note)
    cloud.points = np.ascontiguousarray(cloud.points)
    report.count("points", len(cloud.points))
    t = cloud.t_gps_s
    if t is not None and np.isfinite(t).any():
        report.synchronised, report.time_scale = True, "gps"
        report.t_first_s, report.t_last_s = float(np.nanmin(t)), float(np.nanmax(t))
    if cloud.frame is None:
        report.note(NO_CRS)
    return cloud
