"""Scans of an E57 file (ASTM E2807), each moved by its pose into the frame of the file."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import pye57
from pyproj import CRS
from pyproj.exceptions import CRSError
from scipy.spatial.transform import Rotation

from thalweg.core.errors import InputError
from thalweg.core.las.header import library_errors
from thalweg.core.types import AnyArray, ArrayF
from thalweg.ingest.clouds.raw import RawCloud, eight_bit, single_step_m
from thalweg.ingest.integrity import IntegrityReport

_CARTESIAN: Final = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL: Final = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_ANGLES: Final = ("Azimuth", "Elevation")
_COLOURS: Final = ("colorRed", "colorGreen", "colorBlue")
_BUFFER_POINTS: Final = 1 << 20
_PAGE: Final = 1024


def read_e57(path: Path, report: IntegrityReport) -> RawCloud:
    """All scans of an E57 file in one cloud.

    A scan that the library stops reading (wrong page checksum, cut file) keeps the points before the
    defect; the others are counted as missing.

    Raises
    ------
    InputError : the file cannot be opened as E57, or holds no points.
    """
    report.format = "E57"
    _check_header(path)
    cure = "Copy the file again from its source; the XML section at the end of an E57 must be whole"
    with library_errors(path, "open the E57 file", cure):
        file = pye57.E57(str(path))
    parts: list[dict[str, AnyArray]] = []
    frame = None
    try:
        with library_errors(path, "read the E57 structure", cure):
            n_scans = file.scan_count
            frame = _crs(file)
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
    return RawCloud(
        points=joined["points"],
        intensity=joined.get("intensity"),
        rgb=eight_bit(joined["rgb"], report) if "rgb" in joined else None,
        frame=frame,
        step_m=max(float(p["step_m"]) for p in parts),
    )


def _check_header(path: Path) -> None:
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(48)
    if len(head) < 48:
        raise InputError(f"{size} bytes", expected="an E57 header of 48 bytes", where=path)
    physical, xml_offset, xml_length, page = (
        int.from_bytes(head[i : i + 8], "little") for i in (16, 24, 32, 40)
    )
    if physical != size or page != _PAGE or not 0 < xml_offset < size or not 0 < xml_length <= size:
        raise InputError(
            f"header states {physical:,} bytes, pages of {page}, XML at {xml_offset:,}; found {size:,}",
            expected="sizes that agree",
            where=path,
            cure="The file is cut or damaged; without the XML at its end no point is found: copy it again",
        )


def _crs(file: Any) -> CRS | None:
    if not file.root.isDefined("coordinateMetadata"):
        return None
    text = str(file.root["coordinateMetadata"].value())
    try:
        return CRS.from_wkt(text) if text.strip() else None
    except CRSError:
        return None


def _scan(file: Any, index: int, path: Path, report: IntegrityReport) -> dict[str, AnyArray] | None:
    with library_errors(path, f"read the header of scan {index + 1}"):
        header = file.get_header(index)
        declared = int(header.point_count)
        fields = list(header.point_fields)
        pose = _pose(header)
        limits = _colour_limit(header) if set(_COLOURS) <= set(fields) else 255.0
    report.count("points_declared", declared)
    system = next((s for s in (_CARTESIAN, _SPHERICAL) if set(s) <= set(fields)), None)
    if system is None:
        report.note(f"Scan {index + 1} has neither cartesian nor spherical coordinates and is left out.")
        report.lose("points_missing", declared)
        return None
    wanted = list(system)
    invalid = "cartesianInvalidState" if system is _CARTESIAN else "sphericalInvalidState"
    wanted += [n for n in (invalid, "intensity") if n in fields]
    if set(_COLOURS) <= set(fields):
        wanted += _COLOURS
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
        if lost := int(np.count_nonzero(~good)):
            report.lose("points_marked_invalid", lost)
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
    if _COLOURS[0] in data:
        colours = np.stack([data[name] for name in _COLOURS], axis=-1)[good]
        part["rgb"] = colours if limits > 255 else np.clip(colours, 0, 255).astype(np.uint8)
    return part


def _records(file: Any, header: Any, names: list[str], declared: int) -> tuple[dict[str, AnyArray], str]:
    """Records of a scan as far as the library reads them, and its last words if it stopped early."""
    types = {"intensity": "f", "cartesianInvalidState": "b", "sphericalInvalidState": "b"}
    types |= dict.fromkeys(_COLOURS, "H")
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


def _pose(header: Any) -> tuple[ArrayF, ArrayF] | None:
    if not header.has_pose():
        return None
    w, x, y, z = (float(v) for v in header.rotation)
    translation = np.asarray(header.translation, dtype=np.float64)
    return Rotation.from_quat([x, y, z, w]).as_matrix(), translation


def _colour_limit(header: Any) -> float:
    node = header.node
    if not node.isDefined("colorLimits"):
        return 255.0
    return max(float(node["colorLimits"][f"{name}Maximum"].value()) for name in _COLOURS)
