"""The command ``thalweg describe``: what a raw log or calibration file holds, or one that belongs to it."""

import argparse
import math
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from thalweg.commands.parser import EXIT_MISTAKE, Commands
from thalweg.core import InputError, ThalwegError

if TYPE_CHECKING:
    from thalweg.ingest import IntegrityReport

_HEAD_BYTES: Final = 4096

_MARKS: Final = (
    ("field", re.compile(rb"(?m)^thalweg_field[ \t]*:")),
    ("clock", re.compile(rb"(?m)^thalweg_clock[ \t]*:")),
    ("mounts", re.compile(rb"\A\s*\{\s*\"kind\"\s*:\s*\"thalweg mounts\"")),
)
"""Files of a calibration campaign that no room above `calibration` can read: how their content begins."""


def add_describe_command(commands: Commands) -> None:
    """Add ``describe``."""
    commands.add(
        "describe",
        "content of a raw log (counts, gaps, losses, clock), of a calibration file, or of the files "
        "that belong to it: description of the field, clock of the camera, mounting",
        _describe,
        ("files", [Path], "FILE", "raw logs, clouds, calibration files"),
        ("--model", str, None, "lidar model, if the packets state a wrong one"),
        ("--json", bool, None, "print JSON"),
    )


def _describe(options: argparse.Namespace) -> int:
    from thalweg.ingest.registry import LIDAR_KINDS, describe, recognise

    code = 0
    texts: list[str] = []
    antennas: list[tuple[str, list[float]]] = []
    for path in options.files:
        try:
            report = _describe_marked(path)
            if report is None:
                lidar = options.model is not None and recognise(path) in LIDAR_KINDS
                report = describe(path, {"model": options.model} if lidar else None)
        except ThalwegError as error:
            sys.stdout.flush()
            print(error, file=sys.stderr)
            code = EXIT_MISTAKE
            continue
        if options.json:
            texts.append(report.to_json().rstrip("\n"))
        else:
            print("\n".join(report.lines()))
        place = report.details.get("approx_ecef_m")
        if place and any(place) and not options.json:
            for name, other in antennas:
                print(f"  distance  {math.dist(place, other) / 1000:.3f} km from {name}, by their headers")
            antennas.append((path.name, place))
    if options.json and texts:
        print(texts[0] if len(options.files) == 1 else "[\n" + ",\n".join(texts) + "\n]")
    return code


def _describe_marked(path: Path) -> "IntegrityReport | None":
    """Report on a file that a calibration campaign reads or writes; None if it is none of these.

    Parameters
    ----------
    path : the description of a field, the clock of a camera, or the mounts of a campaign.

    Raises
    ------
    ConfigError, InputError : it is one, and wrong; see the readers.
    """
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except OSError:
        return None  # the reader of logs has words for it
    kind = next((name for name, mark in _MARKS if mark.search(head)), None)
    if kind is None:
        return None
    from thalweg.ingest.registry import CalibrationReport

    formats = {
        "field": "description of a calibration field",
        "clock": "clock against GPS time",
        "mounts": "places of the sensors in ics (x forward, y right, z down)",
    }
    report = CalibrationReport(stream=kind, format=formats[kind], files=[str(path)])
    report.bytes_read = path.stat().st_size
    match kind:
        case "field":
            _describe_field(path, report)
        case "clock":
            _describe_clock(path, report)
        case _:
            from thalweg.calibration import read_mounts

            for sensor, mount in read_mounts(path).items():
                report.count("sensors")
                report.details[sensor] = _mount_lines(mount, path)
    return report


def _describe_field(path: Path, report: "IntegrityReport") -> None:
    from thalweg.calibration.field import read_field
    from thalweg.ingest.registry import with_sigma

    field = read_field(path)
    layout, antenna = field.layout, field.antenna
    sizes = [f"{first} to {last}: {m * 1e3:g} mm" for first, last, m in layout.sizes]
    report.details["markers"] = [f"{layout.dictionary}, modules of {layout.module_m * 1e3:g} mm", *sizes]
    report.details["cones"] = [
        f"{len(field.cones)}; their form is nominal",
        *(
            f"{c.name:5s} markers {_ids(c.markers)}, half angle {c.half_angle_rad * _DEG:.6g} deg, "
            f"length {c.length_m:g} m"
            for c in field.cones
        ),
    ]
    report.details["scale bars"] = [
        str(len(field.scale_bars)),
        *(
            f"{b.name:5s} {b.start} to {b.end}  {with_sigma(b.length_m, b.sigma_m)} m"
            for b in field.scale_bars
        ),
    ]
    report.details["targets"] = [
        str(len(field.targets)),
        *(
            f"{t.name:5s} marker {t.marker}  {t.lat_deg:.9f} deg, {t.lon_deg:.9f} deg, {t.h_ell_m:.4f} m, "
            f"sigma {', '.join(f'{s:g}' for s in t.sigma_m)} m east, north, up"
            for t in field.targets
        ),
    ]
    report.details["antenna"] = (
        "no marker on it"
        if antenna is None
        else f"marker {antenna.marker}, phase centre {with_sigma(antenna.offset_m, antenna.sigma_m)} m "
        "out of the print"
    )
    for name in ("cones", "scale_bars", "targets"):
        report.count(name, len(getattr(field, name)))


_DEG: Final = 57.29577951308232


def _ids(markers: tuple[int, ...]) -> str:
    whole = tuple(range(min(markers), max(markers) + 1)) if markers else ()
    return f"{whole[0]} to {whole[-1]}" if markers == whole else ", ".join(map(str, markers))


def _describe_clock(path: Path, report: "IntegrityReport") -> None:
    from thalweg.clocks import ClockModel

    for line in ClockModel.read(path).lines():
        key, _, words = line.partition(" ")
        if key == "note":
            report.note(words.strip())
        else:
            report.details["source" if key == "clock" else key] = words.strip()


def _mount_lines(mount: Mapping[str, Any], path: Path) -> list[str]:
    """Value, sigma and unit of each quantity of a mount."""
    from thalweg.core.calibration import ANGLES, LEVER
    from thalweg.ingest.registry import with_sigma

    try:
        angles = [
            (name, float(mount[name]), float(mount[f"sigma_{name}"])) for name in ANGLES if name in mount
        ]
        values, sigmas = (map(float, mount[key]) for key in ("lever_ics_m", "sigma_lever_m"))
        lever = [
            f"{name:12s} {with_sigma(value, sigma)} m"
            for name, value, sigma in zip(LEVER, values, sigmas, strict=True)
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"no mount ({error!r})", where=path, expected="lever_ics_m, and angles, each with its sigma"
        ) from error
    about_axes = mount.get("sigma_axes") == "ics"
    lines = [
        f"{name:12s} {with_sigma(value, None if about_axes else sigma)} deg" for name, value, sigma in angles
    ]
    if angles and about_axes:
        lines.append(f"turned by    ± {', '.join(f'{s:.2g}' for _, _, s in angles)} deg about x, y, z of ics")
    rows = mount.get("correlation") or ()
    joint = any(rho != 0.0 for i, row in enumerate(rows) for j, rho in enumerate(row) if i != j)
    known = ", with correlations" if joint else ""
    return [f"from {mount.get('source', 'an unknown source')}{known}", *lines, *lever]
