"""What a calibration file says, in lines for a terminal: values, sigmas, correlations, equations, source."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core import (
    LENS_LINE,
    ArrayF,
    Camera,
    Rigid,
    opk_of,
    read_colmap,
    read_opencv,
    rotation_opk,
    rotation_vector,
)
from thalweg.core.calibration import (
    VERSION,
    Block,
    Calibration,
    KalibrCamera,
    lever_doubt,
    read_calibration,
    read_kalibr,
    read_matrix,
    unit_of,
)
from thalweg.ingest import IntegrityReport, PositionLog
from thalweg.ingest.registry.base import Format

LARGEST: Final = 5
"""Correlations that are listed."""

_NO_SIGMA: Final = (
    "The file does not say how well its values are known: `thalweg import-calibration` asks for it."
)


@dataclass(slots=True, kw_only=True)
class CalibrationReport(IntegrityReport):
    """A report of a file that is no stream: its lines are those of ``details``."""

    def lines(self) -> list[str]:
        """The report as text lines for a terminal."""
        head = f"{self.stream}: {self.format}" + (f", {self.model}" if self.model else "")
        out = [head, *(f"  file      {name}" for name in self.files)]
        for key, value in self.details.items():
            first, *rest = value if isinstance(value, list) else [value]
            out += [f"  {key:9s} {first}".rstrip(), *(f"    {line}" for line in rest)]
        return out + [f"  note      {sentence}" for sentence in self.notes]


def _calibration(path: Path) -> IntegrityReport:
    calibration = read_calibration(path)
    report = _report(path, f"Thalweg calibration, version {VERSION}", calibration.title)
    source = calibration.source
    words = [f"run {source.run}", source.method]
    words += [f"{source.observations:,} observations"] if source.observations else []
    words += [f"sigma0 {source.sigma0:.3g}"] if np.isfinite(source.sigma0) else []
    words += [source.created] if source.created else []
    words += ["digital twin"] if source.twin else []
    report.details["source"] = "; ".join(words)
    report.count("quantities", len(calibration.labels))
    for block in calibration.blocks:
        report.details[block.name] = _block_lines(calibration, block)
    report.details["largest correlations"] = ["", *largest_correlations(calibration)]
    return report


def _block_lines(calibration: Calibration, block: Block) -> list[str]:
    values, cov = calibration.block(block.name)
    sigma: list[float | None] = [float(s) for s in np.sqrt(np.diag(cov))]
    facts = [", ".join(f"{key} {value}" for key, value in block.facts.items())] if block.facts else []
    lines = [block.equation, *([block.convention] if block.convention else []), *facts]
    turned = _turn_lines(calibration.pose(block.name).R, sigma[:3]) if block.is_pose else []
    if block.is_pose:
        sigma[:3] = [None] * 3  # not those of the angles themselves
    lines += [
        f"{name:12s} {with_sigma(value, s)} {unit_of(name)}".removesuffix(" 1")
        for name, value, s in zip(block.quantities, values.tolist(), sigma, strict=True)
    ]
    return lines + turned


def _turn_lines(R: ArrayF, sigma_deg: Sequence[float | None] = (None, None, None)) -> list[str]:
    """A rotation as people picture it: small turns away from one with parallel axes."""
    axes = nearest_axes(R)
    turn = np.rad2deg(rotation_vector(R @ axes.T)).round(6) + 0.0
    parts = [
        f"{name} {with_sigma(angle, sigma)}"
        for name, angle, sigma in zip("xyz", turn.tolist(), sigma_deg, strict=True)
    ]
    quarter = ", ".join(f"{a + 0.0:.0f}" for a in np.rad2deg(opk_of(axes)).round())
    return [f"turned by     {', '.join(parts)} deg about the target's axes from {quarter} deg"]


def nearest_axes(R: ArrayF) -> ArrayF:
    """The rotation (3, 3) nearest to ``R`` whose axes are parallel to the coordinate axes, one of 24."""
    quarter = 0.5 * np.pi * np.arange(4)
    all_of_them = [rotation_opk(a, b, c) for a in quarter for b in quarter for c in quarter]
    return np.round(max(all_of_them, key=lambda A: float(np.sum(A * R))))


def with_sigma(value: float, sigma: float | None) -> str:
    """A value with as many places as two digits of its sigma have.

    Examples
    --------
    >>> with_sigma(-0.250312, 0.00041), with_sigma(2.3e-13, 0.0), with_sigma(3.25, None)
    ('-0.25031 ± 0.00041', '0 (fixed)', '3.25')
    """
    value = round(value, 12)  # what computing leaves of nothing
    if sigma is None:
        return f"{value:.9g}"
    if sigma == 0:
        return f"{value:.9g} (fixed)"
    places = max(0, 1 - int(np.floor(np.log10(sigma))))
    return f"{value:.{places}f} ± {sigma:.{places}f}"


def largest_correlations(calibration: Calibration, n: int = LARGEST) -> list[str]:
    """The pairs of quantities that are correlated most, largest first."""
    matrix, labels = calibration.correlation(), calibration.labels
    i, j = np.tril_indices(len(labels), -1)
    order = np.argsort(-np.abs(matrix[i, j]), kind="stable")[:n]
    pairs = [(labels[i[k]], labels[j[k]], matrix[i[k], j[k]]) for k in order if matrix[i[k], j[k]] != 0.0]
    return [f"{rho:+.3f}  {a}, {b}" for a, b, rho in pairs] or ["none"]


def _report(path: Path, kind: str, title: str = "") -> CalibrationReport:
    report = CalibrationReport.of("calibration", kind, [path], model=title)
    report.bytes_read = path.stat().st_size
    return report


def _kalibr(path: Path) -> IntegrityReport:
    report = _report(path, "Kalibr camera chain")
    for found in read_kalibr(path):
        report.details[found.name] = _kalibr_lines(found)
        report.count("cameras")
    report.note(_NO_SIGMA)
    return report


def _kalibr_lines(found: KalibrCamera) -> list[str]:
    lines = camera_lines(found.camera)
    for pose, words in ((found.T_ics_ccs, "T_ics_ccs"), (found.T_ccs_previous, "T_ccs_previous")):
        lines += [f"{words}:", *_pose_lines(pose)] if pose is not None else []
    lines += (
        [f"offset_s     {found.offset_s:.9g} (t_imu = t_camera + offset)"]
        if found.offset_s is not None
        else []
    )
    return lines


def _colmap(path: Path) -> IntegrityReport:
    cameras = read_colmap(path)
    return _cameras(_report(path, "COLMAP cameras"), {f"camera {k}": each for k, each in cameras.items()})


def _opencv(path: Path) -> IntegrityReport:
    return _cameras(_report(path, "camera file of OpenCV or ROS"), {"camera": read_opencv(path)})


def _cameras(report: CalibrationReport, cameras: Mapping[str, Camera]) -> IntegrityReport:
    report.count("cameras", len(cameras))
    report.details |= {name: camera_lines(camera) for name, camera in cameras.items()}
    report.note("The file does not say how well its values are known.")
    return report


def camera_lines(camera: Camera) -> list[str]:
    """An interior orientation as lines: model, size, parameters."""
    width, height = camera.size_px
    values = zip(camera.parameter_names, camera.parameters, strict=True)
    return [
        f"{camera.model}, {width} x {height} pixels, counted from the upper left corner",
        *(f"{name:12s} {value:.9g}" for name, value in values),
    ]


def _pose_lines(pose: Rigid) -> list[str]:
    angles = ", ".join(f"{a:.5f}" for a in np.rad2deg(opk_of(pose.R)))
    lever = ", ".join(f"{x:.5f}" for x in pose.shift_m)
    return [
        f"  omega, phi, kappa  {angles} deg",
        f"  x, y, z  {lever} m",
        *(f"  {t}" for t in _turn_lines(pose.R)),
    ]


def _matrix(path: Path) -> IntegrityReport:
    report, pose = _report(path, "4x4 matrix"), read_matrix(path)
    report.details["pose"] = [
        "x_target = T @ x_source; the file does not name the frames",
        *_pose_lines(pose),
    ]
    report.note(_NO_SIGMA)
    doubt = lever_doubt(pose.shift_m.tolist())
    if doubt is not None:
        report.note(f"No lever arm in metres: {doubt[0]}. {doubt[2]}.")
    return report


def is_text(head: bytes) -> bool:
    """True if the bytes hold no control characters but tabs and ends of lines."""
    return not _CONTROL.search(head)


def _matches(pattern: re.Pattern[bytes], head: bytes, size: int) -> bool:
    return is_text(head) and pattern.search(head) is not None


def _describe(
    told: Callable[[Path], IntegrityReport], kind: str, files: list[Path], options: dict[str, Any]
) -> PositionLog:
    return PositionLog(report=told(files[0]))


_CONTROL = re.compile(rb"[^\t\n\r\x20-\xff]")
_TEXTS: Final = (
    ("calibration", "calibration file", _calibration, re.compile(rb"(?m)^thalweg_calibration[ \t]*:")),
    ("kalibr", "Kalibr camera chain", _kalibr, re.compile(rb"(?m)^cam0[ \t]*:")),
    (
        "colmap",
        "COLMAP cameras.txt",
        _colmap,
        re.compile(
            rb"(?m)\A(?:[ \t]*#[^\n]*\n)*\d+[ \t]+[A-Z_]+[ \t]+\d+[ \t]+\d+(?:[ \t]+[-+.\deE]+)+[ \t\r]*$"
        ),
    ),
    (
        "opencv",
        "camera file of OpenCV or ROS",
        _opencv,
        re.compile(
            rb"(?m)^[ \t{]*\"?(?:camera_matrix|cameraMatrix|Camera_Matrix|camera_intrinsics|intrinsic_matrix"
            rb"|K)\"?[ \t]*:|\A" + LENS_LINE.pattern.encode()
        ),
    ),
    (
        "matrix",
        "4x4 matrix in a text file",
        _matrix,
        re.compile(
            rb"\A(?:\s*(?:#|//)[^\n]*\n)*(?:[ \t]*(?:[-+.\deE]+(?:[ \t,;]+|(?=[\r\n]|\Z))){4}[\r\n]*){4}\s*\Z"
        ),
    ),
)
"""Kind, words for people, what describes it, and what the content holds, which is text."""

CALIBRATIONS: Final = tuple(
    Format(kind=kind, words=words, matches=partial(_matches, pattern), describe=partial(_describe, told))
    for kind, words, told, pattern in _TEXTS
)
