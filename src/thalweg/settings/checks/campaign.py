"""Rules between values: what no single field can see. All of them run before the first job."""

import datetime as dt
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thalweg.core.mistakes import Key, Mistake
from thalweg.settings.base.mounts import Mounts, OrientedMount
from thalweg.settings.checks.area import check_accuracy_area
from thalweg.settings.checks.calibration import check_calibration_logs, check_interior
from thalweg.settings.checks.files import check_files
from thalweg.settings.checks.images import check_images
from thalweg.settings.checks.light_sheet import check_sheet_logs, check_sheet_twin
from thalweg.settings.checks.mounts import check_mounts_calibration
from thalweg.settings.checks.place import check_base, check_crs
from thalweg.settings.checks.sheet_scans import check_scans
from thalweg.settings.identity import ID_PATTERN
from thalweg.settings.messages.hints import radians_cure
from thalweg.settings.messages.messages import show
from thalweg.settings.sections.accuracy import Accuracy
from thalweg.settings.sections.lidar import Lidar
from thalweg.settings.sections.logs import Logs, is_rinex_name
from thalweg.settings.sections.navigation import Orientation
from thalweg.settings.sections.products import Georeferencing

RESERVED_IDS = frozenset({"real_logs"})
"""Names that other targets use below ``results``."""

MAX_LEVER_M = 10.0
"""A boat is shorter: longer lever arms are in millimetres."""

MAX_SIGMA_LEVER_M = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """What the domain checks look at: the data as written, and the sections that could be read."""

    path: Path
    data: dict[str, Any]
    logs: Logs | None
    lidar: Lidar | None
    mounts: Mounts | None
    orientation: Orientation | None
    georeferencing: Georeferencing | None
    accuracy: Accuracy | None

    def raw(self, *keys: str) -> Any:
        """Value as written in the file, None if absent."""
        value: Any = self.data
        for key in keys:
            value = value.get(key) if isinstance(value, dict) else None
        return value


def domain_mistakes(parts: Parts) -> tuple[list[Mistake], dict[str, tuple[str, ...]]]:
    """All mistakes between values, and the files of each stream as absolute paths."""
    mistakes = [
        *_check_id(parts),
        *_check_input(parts),
        *check_crs(parts.raw("campaign", "crs"), parts.raw("campaign", "origin")),
        *_check_ranges(parts),
        *_check_ports(parts),
        *_check_mounts(parts),
        *check_mounts_calibration(parts.raw("mounts"), parts.raw("campaign", "id"), parts.path.parent),
        *check_interior(parts.raw("calibration", "boat_camera", "interior"), parts.path.parent),
        *check_images(
            parts.raw("logs", "time_lapse"),
            parts.raw("mounts"),
            parts.raw("images"),
            parts.raw("twin"),
            parts.raw("orientation"),
        ),
        *_check_lists(parts),
        *_check_ppk(parts),
        *_check_bed(parts),
    ]
    if parts.accuracy is not None:
        place = (parts.raw("campaign", "crs"), parts.raw("campaign", "origin"))
        mistakes += check_accuracy_area(parts.accuracy, *place)
    files: dict[str, tuple[str, ...]] = {}
    if parts.logs is not None:
        found, files = check_files(parts.logs, parts.path.parent)
        mistakes += found
        mistakes += _check_source(parts, parts.logs)
        mistakes += _check_logs(parts.logs)
        jitter_s = parts.raw("calibration", "clock", "jitter_s")
        has_run = bool(parts.logs.lidar and parts.logs.ins)
        mistakes += check_calibration_logs(parts.logs.calibration, jitter_s=jitter_s, has_run=has_run)
        mistakes += check_base(parts.logs.gnss, parts.raw("campaign", "origin"))
        mistakes += check_sheet_logs(parts.logs, files)
        mistakes += check_scans(parts.logs, files)
    elif parts.raw("twin") is not None:
        mistakes += _check_twin_source(parts)
        mistakes += check_sheet_twin(parts.raw("twin"), parts.raw("light_sheet"))
    return mistakes, files


def _check_id(parts: Parts) -> Iterator[Mistake]:
    name = parts.raw("campaign", "id")
    if not isinstance(name, str):
        return
    path: tuple[Key, ...] = ("campaign", "id")
    if name in RESERVED_IDS:
        yield Mistake(
            path=path,
            found=f"found {name!r}, which names another target",
            expected="an id of your own",
            cure="Choose another id, and rename the file with it",
        )
    if name != parts.path.stem and re.fullmatch(ID_PATTERN, name):
        yield Mistake(
            path=path,
            found=f"found {name!r} in a file named {parts.path.name}",
            expected=f"the name of the file, {parts.path.stem!r}",
            cure=f"Write id: {parts.path.stem}, or rename the file to {name}.yaml",
        )


def _check_input(parts: Parts) -> Iterator[Mistake]:
    twin, logs = parts.raw("twin") is not None, parts.raw("logs") is not None
    if twin and logs:
        yield Mistake(
            path=("twin",),
            found="both twin and logs are given",
            expected="exactly one: logs of a survey, or the digital twin that writes them",
            cure="Remove the section twin for a real survey, or the section logs for a simulation",
        )
    if not twin and not logs:
        given = [name for name in ("twin", "logs") if name in parts.data]
        yield Mistake(
            path=(given[0],) if given else (),
            found=f"the section {given[0]} is empty" if given else "neither logs nor twin is given",
            expected="exactly one: logs of a survey, or the digital twin that writes them",
            cure="Add a section `logs:` with the files of your survey, or `twin: {size: tiny}`",
        )


def _check_ranges(parts: Parts) -> Iterator[Mistake]:
    section = parts.georeferencing
    if section is not None and section.min_range_m >= section.max_range_m:
        key = "min_range_m" if parts.raw("georeferencing", "min_range_m") is not None else "max_range_m"
        yield Mistake(
            path=("georeferencing", key),
            found=f"min_range_m = {section.min_range_m:g} and max_range_m = {section.max_range_m:g}",
            expected="a minimum below the maximum",
            cure="Swap the two numbers, or widen the range",
        )


def _check_ports(parts: Parts) -> Iterator[Mistake]:
    lidar = parts.lidar
    if lidar and lidar.data_port == lidar.position_port:
        yield Mistake(
            path=("lidar", "position_port" if parts.raw("lidar", "position_port") else "data_port"),
            found=f"data_port and position_port are both {lidar.data_port}",
            expected="two different UDP ports",
            cure="The VLP-16 sends data to 2368 and positions to 8308",
        )


def _check_mounts(parts: Parts) -> Iterator[Mistake]:
    if parts.mounts is None:
        return
    for name in ("lidar", "camera", "antenna", "echo_sounder"):
        mount = getattr(parts.mounts, name)
        for key, limit in (("lever_ics_m", MAX_LEVER_M), ("sigma_lever_m", MAX_SIGMA_LEVER_M)):
            values = getattr(mount, key)
            if max(abs(v) for v in values) >= limit:
                as_mm, as_cm = (", ".join(f"{v / unit:g}" for v in values) for unit in (1000, 100))
                # Nobody mounts a sensor 35 mm away by the decimetre: below a metre centimetres are as likely.
                small = key == "lever_ics_m" and max(abs(v) for v in values) < 100
                both = f"centimetres: write [{as_cm}]; or millimetres: [{as_mm}]"
                yield Mistake(
                    path=("mounts", name, key),
                    found=f"found {show(list(values))}",
                    expected=f"components below {limit:g} m",
                    cure="This looks like " + (both if small else f"millimetres: write [{as_mm}]"),
                )
        if isinstance(mount, OrientedMount):
            for key in ("omega_deg", "phi_deg", "kappa_deg"):
                if cure := radians_cure(key, getattr(mount, key)):
                    yield Mistake(
                        path=("mounts", name, key),
                        found=f"found {getattr(mount, key)!r}",
                        expected="an angle in degrees",
                        cure=cure,
                    )


def _check_lists(parts: Parts) -> Iterator[Mistake]:
    for keys in (("orientation", "accept_fixes"), ("ppk", "systems")):
        values = parts.raw(*keys)
        for i, value in enumerate(values if isinstance(values, list) else []):
            if value in values[:i]:
                yield Mistake(
                    path=(*keys, i), found=f"{value} stands twice", expected="each once", cure="Remove one"
                )


_NEEDS: dict[str, tuple[str, ...]] = {
    "pos": ("positions",),
    "sbp": ("gnss.rover",),
    "ppk": ("gnss.rover",),
    "sbet": ("sbet", "gps_week"),
    "ins": (),
}
_BASE_KEYS = ("base_ecef_m", "base_llh", "base_from")
_WHAT = {
    "positions": "RTKLIB .pos files", "gnss.rover": "the raw log of the boat's receiver",
    "sbet": "SBET files", "gps_week": "the GPS week of the SBET", "ins": "ANPP logs: attitudes",
    "lidar": "Velodyne captures",
}  # fmt: skip


def _check_ppk(parts: Parts) -> Iterator[Mistake]:
    if parts.raw("ppk", "iono") == "dual-freq" and parts.raw("ppk", "frequencies") == "l1":
        yield Mistake(
            path=("ppk", "iono"),
            found="found 'dual-freq' with frequencies: l1",
            expected="two frequencies for this model",
            cure="Write frequencies: l1+l2, or iono: brdc",
        )


def _check_bed(parts: Parts) -> Iterator[Mistake]:
    if parts.raw("logs", "bed") and not parts.raw("logs", "depth"):
        yield Mistake(
            path=("logs", "bed"),
            found="a surveyed bed without soundings",
            expected="the log of the echo sounder, whose place it is for",
            cure="Add the line `depth: …`, or remove `bed`",
        )
    twin = parts.raw("twin") or {}
    on_land = isinstance(twin, dict) and (
        isinstance(twin.get("field"), dict) or str(twin.get("size")).startswith("field")
    )
    if on_land and parts.raw("twin", "echo", "bed_survey"):
        yield Mistake(
            path=("twin", "echo", "bed_survey"),
            found="a calibration field on land has no river bed",
            expected="bed_survey in a survey campaign",
            cure="Remove the line, or move it to a campaign on the river",
        )


def _check_source(parts: Parts, logs: Logs) -> Iterator[Mistake]:
    at_rest = logs.calibration
    if (at_rest.field or at_rest.board_images or at_rest.board_observations) and not logs.lidar:
        return  # a calibration without a dynamic run needs no trajectory
    if parts.orientation is None or logs.light_sheet.given:
        return  # a sensor in a basin has no trajectory either
    source = parts.orientation.position_source
    needs = [*_NEEDS[source], *([] if source == "sbet" else ["ins"])]
    for need in needs:
        if not parts.raw("logs", *need.split(".")):
            others = [s for s, keys in _NEEDS.items() if keys and s != source and _given(logs, keys)]
            hint = f", or choose position_source: {others[0]}" if others and need != "ins" else ""
            yield Mistake(
                path=("logs", *need.split(".")),
                found="missing",
                expected=f"{_WHAT[need]}, needed for orientation.position_source: {source}",
                cure=f"Add the line `{need.split('.')[-1]}: …`{hint}",
            )
    if not parts.raw("logs", "lidar"):
        yield Mistake(
            path=("logs", "lidar"),
            found="missing",
            expected=_WHAT["lidar"],
            cure="Add the line `lidar: [lidar/*.pcap]`",
        )
    rover = logs.gnss.rover
    if source == "sbp" and rover and all(is_rinex_name(Path(name)) for name in rover):
        yield Mistake(
            path=("logs", "gnss", "rover"),
            found="RINEX files only, which hold observations and no positions",
            expected="SBP logs, needed for orientation.position_source: sbp",
            cure="Name the SBP log, or choose position_source: ppk",
        )
    if source == "ppk" and not any(parts.raw("logs", "gnss", key) for key in _BASE_KEYS):
        yield Mistake(
            path=("logs", "gnss"),
            found="the position of the base antenna is missing",
            expected=f"one of {', '.join(_BASE_KEYS)}, needed for orientation.position_source: ppk",
            cure="Add `base_from: sbp` if the log carries it, else its coordinates, for instance "
            "base_llh: {lat_deg: …, lon_deg: …, h_ell_m: …}",
        )
    if parts.mounts is None or parts.mounts.calibration is not None:
        return
    sensors = ["lidar", *(["antenna"] if source in {"pos", "sbp", "ppk"} else [])]
    for sensor in sensors:
        if parts.raw("mounts", sensor, "lever_ics_m") is None:
            yield Mistake(
                path=("mounts", sensor, "lever_ics_m"),
                found="missing",
                expected=f"the place of the {sensor} in the body frame, metres forward, right, down",
                cure="Measure it and write lever_ics_m: [x, y, z]; zeros only if it sits at the INS itself",
            )


def _given(logs: Logs, keys: tuple[str, ...]) -> bool:
    return all((logs.gnss.rover if key == "gnss.rover" else getattr(logs, key)) for key in keys)


def _check_twin_source(parts: Parts) -> Iterator[Mistake]:
    if parts.orientation is not None and parts.orientation.position_source in {"ppk", "sbet"}:
        yield Mistake(
            path=("orientation", "position_source"),
            found=f"found {parts.orientation.position_source!r}, but the twin does not write such logs",
            expected="pos, sbp or ins",
            cure="Write position_source: pos",
        )
    mode = parts.raw("twin", "gnss", "mode")
    if mode is None and parts.raw("twin", "size") == "reach":
        mode = "single_frequency"
    source = parts.orientation
    single = mode == "single_frequency" and source is not None and source.position_source != "ins"
    if source is not None and single and "single" not in source.accept_fixes:
        yield Mistake(
            path=("orientation", "accept_fixes"),
            found=f"found {list(source.accept_fixes)}, but twin.gnss.mode is single_frequency",
            expected="single among them: such a receiver never has a fixed solution",
            cure="Write accept_fixes: [single], or position_source: ins",
        )


def _check_logs(logs: Logs) -> Iterator[Mistake]:
    if logs.depth_date is not None:
        try:
            dt.date.fromisoformat(logs.depth_date)
        except ValueError:
            yield Mistake(
                path=("logs", "depth_date"),
                found=f"found {logs.depth_date!r}, no day of the calendar",
                expected="a date YYYY-MM-DD",
                cure="Write the UTC date of the first sounding, like 2021-05-12",
            )
