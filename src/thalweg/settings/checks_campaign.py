"""Rules between values: what no single field can see. All of them run before the first job.

Also here: do the recordings of the light-sheet sensor belong together, and does the twin's object make sense?
"""

import datetime as dt
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from thalweg.core import Key, Mistake
from thalweg.settings.campaign import ID_PATTERN, LABORATORY
from thalweg.settings.checks_epochs import check_epochs
from thalweg.settings.checks_files import check_files, no_path, photographs_in
from thalweg.settings.checks_place import (
    check_base,
    check_crs,
    check_mounts_calibration,
    geodetic_place,
    parse_crs,
)
from thalweg.settings.messages import (
    anchor,
    lacking,
    missing_cure,
    mistake,
    radians_cure,
    show,
    single,
    value_at,
)
from thalweg.settings.sections import (
    LOCAL,
    SCAN_PARTS,
    SERIES,
    STREAM_KEYS,
    Accuracy,
    Area,
    CalibrationLogs,
    Georeferencing,
    Lidar,
    Logs,
    Mounts,
    Orientation,
    OrientedMount,
    is_calibration_path,
    is_rinex_name,
    scan_stream,
)

# ---------------------------------------------------------------- recordings of the light-sheet sensor

NEEDED: Final[Mapping[str, str]] = {
    "sensor": "the design of the sensor",
    "camera_marks": "marks that its camera sees through air",
    "mark_points": "the coordinates of these marks",
    "grid_images": "the image of the laser on the grid object",
    "grid": "the grid object with the depths of its levels",
}
"""Keys of ``logs.light_sheet`` without which nothing can be calibrated."""

_PANEL: Final = "images of the panel and its depth in each"
_OF_FIELD: Final = "markers and scale bars of the field"
_TOGETHER: Final = (
    ("panel_images", "panels", _PANEL),
    ("panels", "panel_images", _PANEL),
    ("camera_field_images", "camera_field", _OF_FIELD),
    ("camera_field_marks", "camera_field", _OF_FIELD),
)
"""Key, the key that it needs, and what that holds."""
_ONE_FILE: Final = (
    "sensor",
    "camera_field",
    "camera_field_marks",
    "camera_marks",
    "mark_points",
    "grid",
    "panels",
)
_SHEET: Final = "logs.light_sheet"
_DOCS: Final = "; docs/light_sheet.md says what each file holds"


def check_sheet_logs(logs: Logs, files: Mapping[str, tuple[str, ...]]) -> Iterator[Mistake]:
    """Mistakes between the recordings of the light-sheet sensor.

    Parameters
    ----------
    logs : the section as written.
    files : absolute paths by stream, patterns expanded; see `thalweg.settings.checks_files.check_files`.
    """
    sheet = logs.light_sheet
    if not sheet.given:
        return
    beside = f", beside {_SHEET}."
    yield from lacking(_SHEET, sheet, {k: f"{v}{beside}{sheet.given[0]}" for k, v in NEEDED.items()}, _DOCS)
    seen = [name for name in ("camera_field_images", "camera_field_marks") if getattr(sheet, name)]
    for key, other, what in _TOGETHER:
        if getattr(sheet, key) and key not in seen[1:]:
            yield from lacking(_SHEET, sheet, {other: f"{what}{beside}{key}"}, _DOCS)
    if sheet.camera_field and not seen:
        what = f"pictures of the field, or camera_field_marks{beside}camera_field"
        yield from lacking(_SHEET, sheet, {"camera_field_images": what}, _DOCS)
    if len(seen) == 2:
        yield mistake(
            f"{_SHEET}.camera_field_marks",
            "marks beside the pictures that they were measured in",
            "camera_field_images or camera_field_marks",
            "Leave one of both out",
        )
    streams = {keys[1]: stream for stream, keys in STREAM_KEYS.items() if keys[0] == "light_sheet"}
    yield from single(
        _SHEET,
        {name: len(files.get(streams[name], ())) for name in _ONE_FILE},
        "one file",
        "Name the one that belongs to these recordings; another day is another campaign",
    )
    images = len([*photographs_in(files.get(streams["grid_images"], ()))])
    if images > 1:
        yield mistake(
            "logs.light_sheet.grid_images",
            f"{images} images",
            "one image of the laser on the grid object, to which the depths in grid belong",
            "Name one image; the others may serve in campaigns of their own, as a check",
        )
    for stream, keys in STREAM_KEYS.items():
        if keys[0] != "light_sheet" and logs.files(stream):
            yield mistake(
                ("logs", *keys),
                "recordings of a boat beside those of the light-sheet sensor in a basin",
                "one of both in a campaign: the boat's logs would not be used",
                "Make a campaign of its own for them",
            )


# ---------------------------------------------------------------- recordings of a calibration field

_CALIBRATION: Final = "logs.calibration"
_BY_HAND = {"reference_images": "images of the field by a hand-held camera"}
_STATIC = {
    "position_images": "an image of the boat's camera at each static position",
    "position_scans": "a lidar capture of each static position",
}
_CLOCKS = {"clock_ties": "comparisons", "trigger_pulses": "pulses"}


def check_calibration_logs(
    logs: CalibrationLogs, *, jitter_s: object = None, has_run: bool = False
) -> Iterator[Mistake]:
    """Mistakes between the recordings of a calibration field or of a board; patterns are not expanded yet.

    ``jitter_s`` is ``calibration.clock.jitter_s`` as written, None if absent. ``has_run``: whether lidar and
    INS were recorded on the moving boat; their mount then needs no camera and no static positions.
    """
    given = {name for name in type(logs).model_fields if getattr(logs, name)}
    if logs.field:
        static = not has_run or not given.isdisjoint(_STATIC)
        needed = (_BY_HAND | _STATIC if static else _BY_HAND).items()
        yield from lacking(_CALIBRATION, logs, {k: f"{v}, beside logs.calibration.field" for k, v in needed})
    elif not given.isdisjoint((*_BY_HAND, *_STATIC, "run_images")):
        yield mistake(
            "logs.calibration.field",
            "missing",
            "the description of the field: cones, markers, scale bars, targets",
            "Write it as docs/calibration.md shows",
        )
    yield from single(
        _CALIBRATION, {"field": len(logs.field)}, "one description", "Put all cones and targets into one file"
    )
    if logs.board_images and not (logs.board_scans and logs.board_camera):
        key = "board_camera" if logs.board_scans else "board_scans"
        what = "images, scans and the interior orientation of the camera"
        yield from lacking(_CALIBRATION, logs, {key: what})
    for name, what in _CLOCKS.items():
        if name in given and not logs.run_images:
            yield mistake(
                "logs.calibration.run_images",
                "missing",
                f"the images whose times {name} tells; without images it would not be used",
                f"Add the line `run_images: [...]`, or remove {name}",
            )
        count = {name: len(getattr(logs, name))}
        yield from single(_CALIBRATION, count, f"one table of {what}", "Put all rows into one file")
    if logs.clock_ties and logs.trigger_pulses:
        yield mistake(
            "logs.calibration.clock_ties",
            "both clock_ties and trigger_pulses are given",
            "one of them: pulses say when each image was taken, ties how the camera's clock runs",
            "Remove clock_ties if the camera was triggered, else trigger_pulses",
        )
    if logs.clock_ties and not logs.display and jitter_s is None:
        yield mistake(
            "calibration.clock.jitter_s",
            "missing",
            "the jitter of the camera's stamps, seconds: ties do not tell it",
            "State calibration.clock.jitter_s, or give logs.calibration.display",
        )


def check_interior(chosen: Any, folder: Path) -> Iterator[Mistake]:
    """Is the file of ``calibration.boat_camera.interior`` there?

    Parameters
    ----------
    chosen : the value as written; what is no text is another check's.
    folder : folder of the campaign file.
    """
    if not isinstance(chosen, str) or not chosen:
        return
    where = ("calibration", "boat_camera", "interior")
    if (wrong := no_path(where, chosen, folder)) is not None:
        yield wrong
        return
    path = anchor(chosen, folder)
    if not path.is_file():
        yield mistake(
            where,
            f"{chosen}: {'this is a folder' if path.is_dir() else 'no such file'}",
            f"an interior orientation at {path}",
            "Name the file in it" if path.is_dir() else missing_cure(path),
        )


# ---------------------------------------------------------------- is the area of interest a polygon, and near
# the survey?


MAX_AREA_KM = 20.0
"""Farther from the origin lies another survey."""
NEAR_M = 50.0
"""Banks rise less than this above the water; heights of the two frames differ by the origin's height."""

_PATH = ("accuracy", "area", "polygon")


def check_accuracy_area(section: Accuracy, crs: Any, origin: Any) -> Iterator[Mistake]:
    """The polygon encloses an area, its heights are not those of another frame, and it lies near the origin.

    Parameters
    ----------
    section : section ``accuracy``.
    crs, origin : ``campaign.crs`` and ``campaign.origin`` as written.
    """
    area = section.area
    yield from _check_heights(area, origin)
    if area.polygon is None:
        return
    from thalweg.core.geometry import LEAST_AREA_M2, crossing_in_words, first_crossing, polygon_area_m2

    crossing = first_crossing(area.polygon)
    if crossing is not None:
        yield mistake(
            _PATH,
            crossing_in_words(area.polygon, crossing),
            "a polygon whose edges do not cross",
            "Give the corners in their order along the outline",
        )
        return
    if polygon_area_m2(area.polygon) < LEAST_AREA_M2:
        yield mistake(
            _PATH,
            "the corners enclose no area",
            "at least three corners that are not on one line, in order around the area",
            "Copy the corners from a map program in the order in which they were drawn",
        )
        return
    if area.frame == "local":
        yield from _check_local(area.polygon)
    else:
        yield from _check_map(area.polygon, crs, origin)


def _check_heights(area: Area, origin: Any) -> Iterator[Mistake]:
    """Heights above the origin in the frame of the map, or heights above the ellipsoid in the local one."""
    origin_m = origin.get("h_ell_m") if isinstance(origin, dict) else None
    if isinstance(origin_m, bool) or not isinstance(origin_m, int | float) or abs(origin_m) <= 2 * NEAR_M:
        return  # too near to each other to tell the two apart
    frames = {"local": (0.0, "above campaign.origin"), "map": (float(origin_m), "above the ellipsoid")}
    other = "map" if area.frame == "local" else "local"
    for key in ("min_height_m", "max_height_m"):
        height = getattr(area, key)
        if height is None or abs(height - frames[other][0]) > NEAR_M:
            continue
        yield mistake(
            ("accuracy", "area", key),
            f"found {height:g}, with frame: {area.frame} and an origin at {origin_m:g} m",
            f"a height {frames[area.frame][1]}, metres, near {frames[area.frame][0]:g}",
            f"Heights {frames[other][1]}? Then write frame: {other}"
            if area.polygon is None
            else f"Write it in the frame of the polygon, {area.frame}",
        )


def _check_local(polygon: Sequence[tuple[float, float]]) -> Iterator[Mistake]:
    for number, corner in enumerate(polygon):
        far_km = math.hypot(*corner) / 1000
        if far_km > MAX_AREA_KM:
            yield mistake(
                (*_PATH, number),
                f"a corner {far_km:,.0f} km from campaign.origin",
                f"east and north from campaign.origin in metres, within {MAX_AREA_KM:g} km",
                "Map coordinates? Then write frame: map",
            )
            return


def _check_map(polygon: Sequence[tuple[float, float]], crs: Any, origin: Any) -> Iterator[Mistake]:
    place = geodetic_place(origin)
    grid = parse_crs(crs.strip()) if isinstance(crs, str) else None
    if place is None or grid is None or isinstance(grid, str) or not grid.is_projected:
        return  # those mistakes are told by others
    from pyproj import Transformer

    to_map = Transformer.from_crs(grid.geodetic_crs, grid, always_xy=True)
    east, north = to_map.transform(place[1], place[0])
    for number, corner in enumerate(polygon):
        far_km = math.dist(corner, (east, north)) / 1000
        if far_km > MAX_AREA_KM:
            swapped_km = math.dist(corner[::-1], (east, north)) / 1000
            local = math.hypot(*corner) / 1000 < MAX_AREA_KM
            path: tuple[Key, ...] = (*_PATH, number)
            yield mistake(
                path,
                f"a corner {far_km:,.0f} km from campaign.origin",
                f"east and north in {crs.strip()}, within {MAX_AREA_KM:g} km of {east:.0f}, {north:.0f}",
                "Local coordinates? Then write frame: local"
                if local
                else "East comes first: swap the two numbers of each corner"
                if swapped_km < MAX_AREA_KM
                else "Check the CRS of the map program that the polygon comes from",
            )
            return


# ---------------------------------------------------------------- rules between values about photographs of
# the bank


_FIELD = ("field", "field_images", "field_points")


def check_rig(
    logs: Mapping[str, Any] | None,
    rig: Any,
    lidar: bool,
    panorama: Any,
    images: Any = None,
    twin: Any = None,
    mounts: Any = None,
) -> Iterator[Mistake]:
    """Mistakes in what belongs to a camera with two fisheye lenses.

    Parameters
    ----------
    logs : ``logs.rig`` as written.
    rig, panorama, images, twin, mounts : the sections of these names as written.
    lidar : whether there is a lidar.
    """
    given = logs if isinstance(logs, Mapping) else {}
    field = [key for key in _FIELD if given.get(key)]
    if field and len(field) < len(_FIELD):
        missing = " and ".join(f"logs.rig.{key}" for key in _FIELD if key not in field)
        yield mistake(
            ("logs", "rig", field[0]),
            f"a field of the rig without {missing}",
            "its description, its pictures and its surveyed marks",
            f"State {missing}, or leave the field out and name logs.rig.calibration",
        )
    if value_at(images, "source") == "rig" and not given.get("images") and not value_at(twin, "dual_fisheye"):
        yield mistake(
            "images.source",
            "rig, and no files of a rig",
            "files of a camera with two lenses and its calibration",
            "State logs.rig.images and what calibrates it, or write source: camera",
        )
    if not given.get("images"):
        return
    chosen = value_at(mounts, "calibration")
    # whether a campaign of that name calibrates a rig is seen where all campaigns are
    elsewhere = isinstance(chosen, str) and not is_calibration_path(chosen)
    if not field and not given.get("calibration") and not elsewhere:
        yield mistake(
            "logs.rig.images",
            "files of a rig, and nothing that calibrates it",
            "logs.rig.calibration, a field of marks around the rig, or mounts.calibration with one",
            "State logs.rig.field, field_images and field_points, or logs.rig.calibration",
        )
    if not value_at(rig, "mount"):
        yield mistake(
            "rig",
            "files of a rig, but no place of it on the boat",
            cure="State rig.mount: the front lens in the body frame of the INS",
        )
    if not lidar and (value_at(panorama, "mode") or "depth") == "depth":
        yield mistake(
            "panorama.mode",
            "depth, and no lidar whose cloud says how far things are",
            "sphere or none without a lidar",
            "Set panorama.mode: sphere and panorama.radius_m, or state logs.lidar",
        )


_BESIDE = ("times", "control_points", "marks", "masks", "interior", "interiors", "orientations")
_SOLVED = {"ins": "the INS's own filter", "sbet": "an Applanix trajectory"}


def check_images(
    logs: Mapping[str, Any] | None, mounts: Any, images: Any, twin: Any, orientation: Any = None
) -> Iterator[Mistake]:
    """Mistakes in what belongs to images of the bank.

    Parameters
    ----------
    logs : ``logs.time_lapse`` as written.
    mounts, images, twin, orientation : the sections of these names as written.
    """
    given = logs if isinstance(logs, Mapping) else {}
    by_rig = value_at(images, "source") == "rig"
    taken = by_rig or bool(given.get("images")) or bool(value_at(twin, "time_lapse"))
    if not taken:
        for key in _BESIDE:
            if given.get(key):
                yield mistake(
                    ("logs", "time_lapse", key),
                    "files that belong to images, but there are none",
                    cure="State logs.time_lapse.images, or leave this out",
                )
        return
    placed = isinstance(mounts, Mapping) and ("camera" in mounts or "calibration" in mounts)
    if not placed and not by_rig:
        yield mistake(
            "mounts",
            "images of the bank, but no place of the camera on the boat",
            cure="State mounts.camera, or name the calibration that found it as mounts.calibration",
        )
    adjusted = (by_rig and not twin) or (bool(given.get("images")) and not given.get("orientations"))
    antenna = value_at(images, "adjustment", "antenna", "use") is True
    source = value_at(orientation, "position_source")
    if adjusted and not given.get("control_points") and not antenna:
        place = (
            "; positions that are part of the INS's solution cannot take their place"
            if source in _SOLVED
            else ", or let the antenna's positions take their place: images.adjustment.antenna.use: true"
        )
        yield mistake(
            "logs.time_lapse",
            "images without control points",
            cure=f"State logs.time_lapse.control_points, or orientations of another program{place}",
        )
    if antenna and source in _SOLVED and not given.get("orientations"):
        yield mistake(
            "images.adjustment.antenna.use",
            f"true, with positions of {_SOLVED[source]} (orientation.position_source: {source})",
            "positions of a GNSS antenna: pos, sbp or ppk",
            "Such positions are those of the body's origin and not of the antenna, and the trajectory "
            "that the images are joined with has their GNSS inside: it would count twice. Write use: false "
            "and give control points, or name GNSS positions of the antenna and their position_source",
        )
    interiors = given.get("interiors")
    for folder, files in interiors.items() if isinstance(interiors, Mapping) else ():
        if isinstance(files, list) and len(files) != 1:
            yield mistake(
                ("logs", "time_lapse", "interiors", folder),
                f"{len(files)} files",
                "one interior orientation for the camera of a folder",
                "Name one file; a second camera has a folder of its own",
            )


# ---------------------------------------------------------------- is each scan of the light-sheet sensor
# complete?


_NEEDED: Final = {
    "images": "images of the sensor",
    "panel": "coordinates of the panel's marks",
    "marks": "marks in the pictures of the standing camera",
    "camera": "interior orientation of the standing camera",
}


def check_scans(logs: Logs, files: Mapping[str, tuple[str, ...]]) -> Iterator[Mistake]:
    """Mistakes in ``logs.light_sheet.scans``.

    Parameters
    ----------
    logs : the section as written.
    files : absolute paths by stream, patterns expanded; see `thalweg.settings.checks_files.check_files`.
    """
    for name, scan in logs.light_sheet.scans.items():
        where = f"{_SHEET}.scans.{name}"
        if name in SERIES or name in STREAM_KEYS:
            yield mistake(
                where,
                f"a scan called {name}",
                "a name that no other series of images has",
                "Call the scan by its object",
            )
            continue
        yield from lacking(where, scan, _NEEDED, _DOCS)
        for one, other in (("reference", "pairs"), ("pairs", "reference")):
            if getattr(scan, one) and not getattr(scan, other):
                yield mistake(
                    f"{where}.{other}",
                    "missing",
                    f"both reference and pairs, beside {one}",
                    "Pick three or more places that scan and mesh both show",
                )
        counts = {part: len(files.get(scan_stream(name, part), ())) for part in SCAN_PARTS[1:]}
        cure = "Name the one of this scan; another scan gets a name of its own"
        yield from single(where, counts, "one file", cure)


# ---------------------------------------------------------------- campaign


RESERVED_IDS = frozenset({"reproduction", "site"})
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
        return value_at(self.data, *keys)

    @property
    def boat(self) -> bool:
        """False for photographs, a camera that stays, or a finished cloud alone."""
        return self.logs is None or self.logs.kind == "boat"


def domain_mistakes(parts: Parts) -> tuple[list[Mistake], dict[str, tuple[str, ...]]]:
    """All mistakes between values, and the files of each stream as absolute paths."""
    mistakes = [
        *_check_id(parts),
        *_check_input(parts),
        *_check_frame(parts),
        *_check_ranges(parts),
        *_check_ports(parts),
        *_check_stated_clock(parts),
        *_check_mounts(parts),
        *check_mounts_calibration(parts.raw("mounts"), parts.raw("campaign", "id"), parts.path.parent),
        *check_interior(parts.raw("calibration", "boat_camera", "interior"), parts.path.parent),
        *_check_photographs(parts),
        *check_rig(
            parts.raw("logs", "rig"),
            parts.raw("rig"),
            bool(parts.raw("logs", "lidar")),
            parts.raw("panorama"),
            parts.raw("images"),
            parts.raw("twin"),
            parts.raw("mounts"),
        ),
        *check_epochs(
            parts.raw("epochs"),
            parts.raw("campaign") or {},
            parts.raw("deformation") or {},
            parts.path.parent,
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
        mistakes += _check_source(parts, parts.logs) if parts.boat else _check_alone(parts.logs)
        mistakes += _check_logs(parts.logs)
        jitter_s = parts.raw("calibration", "clock", "jitter_s")
        has_run = bool(parts.logs.lidar and parts.logs.ins)
        mistakes += check_calibration_logs(parts.logs.calibration, jitter_s=jitter_s, has_run=has_run)
        mistakes += check_base(parts.logs.gnss, parts.raw("campaign", "origin"))
        mistakes += check_sheet_logs(parts.logs, files)
        mistakes += check_scans(parts.logs, files)
    elif LABORATORY is not None and parts.raw("twin") is not None:
        mistakes += LABORATORY.twin_mistakes(parts.data, parts.orientation)
    return mistakes, files


def _check_frame(parts: Parts) -> Iterator[Mistake]:
    """A map and an origin; what no boat recorded may stand in a frame of the surveyor's own."""
    crs, origin = parts.raw("campaign", "crs"), parts.raw("campaign", "origin")
    if not parts.boat and crs == LOCAL:
        return
    yield from check_crs(crs, origin)
    if parts.boat and origin is None:
        yield mistake(
            "campaign.origin",
            "missing",
            "latitude, longitude and ellipsoidal height of a point near the survey",
            "Add the line `origin: {lat_deg: …, lon_deg: …, h_ell_m: …}`",
        )


def _check_photographs(parts: Parts) -> Iterator[Mistake]:
    """Photographs of a boat need the camera's place on it; others points, positions or orientations."""
    sections = (parts.raw("images"), parts.raw("twin"), parts.raw("orientation"))
    logs = parts.logs
    if logs is None or logs.kind != "photographs":
        yield from check_images(parts.raw("logs", "time_lapse"), parts.raw("mounts"), *sections)
        if logs is not None and logs.time_lapse.positions:
            yield mistake(
                "logs.time_lapse.positions",
                "positions of the camera beside other logs",
                "photographs without a boat, whose trajectory would say the same",
                "Remove the line, or the other logs",
            )
        return
    given = logs.time_lapse
    if given.control_points and not given.marks:
        yield mistake(
            "logs.time_lapse.marks",
            "missing",
            "where the control points are in the photographs: without a boat nothing tells roughly",
            "Add the line `marks: [...]` (CSV: image, point, x_px, y_px)",
        )
    if not (given.control_points or given.positions or given.orientations):
        yield mistake(
            "logs.time_lapse",
            "photographs alone",
            "control_points with marks, positions of the camera, or finished orientations",
            "Add what is known of them, or the logs of the boat: lidar, ins, positions, depth",
        )
    if (
        given.orientations
        and not given.control_points
        and not (parts.raw("campaign", "origin") or parts.raw("campaign", "crs") == LOCAL)
    ):
        yield mistake(
            "campaign.origin",
            "missing",
            "a place on the earth for orientations in a map grid",
            "Write origin: {lat_deg: …, lon_deg: …, h_ell_m: …}, or crs: local",
        )
    if given.orientations and given.positions:
        yield mistake(
            "logs.time_lapse.positions",
            "positions of the camera beside finished orientations, which hold them",
            "one of both",
            "Remove the line, or remove orientations: the photographs are then oriented here",
        )
    for name in ("positions", "interior", "marks"):
        if len(getattr(given, name)) > 1:
            yield mistake(
                ("logs", "time_lapse", name),
                f"{len(getattr(given, name))} files",
                "one",
                "Put all rows into one file"
                if name != "interior"
                else "Photographs of several cameras: one campaign each",
            )


def _check_alone(logs: Logs) -> Iterator[Mistake]:
    """What a camera that stays and a finished cloud need."""
    if logs.kind == "fixed_camera":
        needed = {"marks": "where control points are in the pictures", "control_points": "surveyed points"}
        yield from lacking("logs.fixed_camera", logs.fixed_camera, needed)
        yield from single(
            "logs.fixed_camera",
            {"interior": len(logs.fixed_camera.interior)},
            "one file; a second camera is another campaign",
            "Name one",
        )
    elif logs.kind == "cloud":
        for name in ("cloud", "reference"):
            count = len(getattr(logs, name))
            if count != 1:
                yield mistake(
                    ("logs", name),
                    "missing" if not count else f"{count} files",
                    "one file: a finished cloud is compared with one reference",
                    f"Add the line `{name}: [...]`"
                    if not count
                    else "Name one; merge the others first. Surveys of several dates: "
                    "thalweg new-campaign NAME --epochs FILE@DATE FILE@DATE",
                )
    if logs.kind in ("fixed_camera", "cloud"):
        kept = {"fixed_camera": {"fixed_camera"}, "cloud": {"cloud", "reference"}}[logs.kind]
        given = [
            keys for stream, keys in logs.streams().items() if logs.files(stream) and keys[0] not in kept
        ]
        for keys in given:
            yield mistake(
                ("logs", *keys),
                f"logs beside logs.{logs.kind}, which would not be used",
                f"{' and '.join(sorted(kept))} alone",
                "Put them into a campaign of their own",
            )


def _check_id(parts: Parts) -> Iterator[Mistake]:
    name = parts.raw("campaign", "id")
    if not isinstance(name, str):
        return
    path: tuple[Key, ...] = ("campaign", "id")
    if name in RESERVED_IDS:
        yield mistake(
            path,
            f"found {name!r}, which names another target",
            "an id of your own",
            "Choose another id, and rename the file with it",
        )
    if name != parts.path.stem and re.fullmatch(ID_PATTERN, name):
        yield mistake(
            path,
            f"found {name!r} in a file named {parts.path.name}",
            f"the name of the file, {parts.path.stem!r}",
            f"Write id: {parts.path.stem}, or rename the file to {name}.yaml",
        )


def _check_input(parts: Parts) -> Iterator[Mistake]:
    given = [name for name in ("twin", "logs", "epochs") if parts.raw(name) is not None]
    expected = "exactly one: logs of a survey, the digital twin that writes them, or epochs to compare"
    if len(given) > 1:
        yield mistake(
            (given[0],),
            f"{'all of ' if len(given) > 2 else 'both '}{' and '.join(given)} are given",
            expected,
            "Remove the section twin for a real survey, or the section logs for a simulation; epochs "
            "name campaigns that have their own",
        )
    if not given:
        empty = [name for name in ("twin", "logs", "epochs") if name in parts.data]
        yield mistake(
            (empty[0],) if empty else (),
            f"the section {empty[0]} is empty" if empty else "neither logs nor twin is given",
            expected,
            "Add a section `logs:` with the files of your survey, or `twin: {size: tiny}`",
        )


def _check_ranges(parts: Parts) -> Iterator[Mistake]:
    section = parts.georeferencing
    if section is not None and section.min_range_m >= section.max_range_m:
        key = "min_range_m" if parts.raw("georeferencing", "min_range_m") is not None else "max_range_m"
        yield mistake(
            ("georeferencing", key),
            f"min_range_m = {section.min_range_m:g} and max_range_m = {section.max_range_m:g}",
            "a minimum below the maximum",
            "Swap the two numbers, or widen the range",
        )


def _check_ports(parts: Parts) -> Iterator[Mistake]:
    lidar = parts.lidar
    if lidar and lidar.data_port == lidar.position_port:
        yield mistake(
            ("lidar", "position_port" if parts.raw("lidar", "position_port") else "data_port"),
            f"data_port and position_port are both {lidar.data_port}",
            "two different UDP ports",
            "A Velodyne sends data to 2368 and positions to 8308",
        )


def _check_stated_clock(parts: Parts) -> Iterator[Mistake]:
    """A time that a person states is not as good as PPS, which the default stands for."""
    stated = parts.raw("lidar", "clock")
    given = [key for key in ("first_packet_utc", "offset_s") if isinstance(stated, dict) and stated.get(key)]
    if (
        given
        and parts.raw("lidar", "clock", "source") in (None, "stated")
        and (parts.raw("lidar_accuracy", "sigma_time_s") is None)
    ):
        yield mistake(
            ("lidar", "clock", given[0]),
            "a stated time, without saying how well it is known",
            "lidar_accuracy.sigma_time_s, seconds",
            "Write lidar_accuracy: {sigma_time_s: 0.1}, if it is good to a tenth of a second",
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
                yield mistake(
                    ("mounts", name, key),
                    f"found {show(list(values))}",
                    f"components below {limit:g} m",
                    "This looks like " + (both if small else f"millimetres: write [{as_mm}]"),
                )
        if isinstance(mount, OrientedMount):
            for key in ("omega_deg", "phi_deg", "kappa_deg"):
                if cure := radians_cure(key, getattr(mount, key)):
                    yield mistake(
                        ("mounts", name, key), f"found {getattr(mount, key)!r}", "an angle in degrees", cure
                    )


def _check_lists(parts: Parts) -> Iterator[Mistake]:
    for keys in (("orientation", "accept_fixes"), ("ppk", "systems")):
        values = parts.raw(*keys)
        for i, value in enumerate(values if isinstance(values, list) else []):
            if value in values[:i]:
                yield mistake((*keys, i), f"{value} stands twice", "each once", "Remove one")


_NEEDS: dict[str, tuple[str, ...]] = {
    "pos": ("positions",),
    "sbp": ("gnss.rover",),
    "ppk": ("gnss.rover",),
    "nmea": (),
    "gpx": ("positions",),
    "sbet": ("sbet", "gps_week"),
    "ins": (),
}
_BASE_KEYS = ("base_ecef_m", "base_llh", "base_from")
_WHAT = {
    "positions": "positions of the boat's antenna",
    "gnss.rover": "the raw log of the boat's receiver",
    "sbet": "SBET files",
    "gps_week": "the GPS week of the SBET",
    "ins": "attitudes (ANPP logs, or poses of other programs)",
}


def _check_ppk(parts: Parts) -> Iterator[Mistake]:
    if parts.raw("ppk", "iono") == "dual-freq" and parts.raw("ppk", "frequencies") == "l1":
        yield mistake(
            "ppk.iono",
            "found 'dual-freq' with frequencies: l1",
            "two frequencies for this model",
            "Write frequencies: l1+l2, or iono: brdc",
        )


def _check_bed(parts: Parts) -> Iterator[Mistake]:
    if parts.raw("logs", "bed") and not parts.raw("logs", "depth"):
        yield mistake(
            "logs.bed",
            "a surveyed bed without soundings",
            "the log of the echo sounder, whose place it is for",
            "Add the line `depth: …`, or remove `bed`",
        )
    stated = parts.raw("fusion", "vertical") or {}
    sigma = isinstance(stated, dict) and stated.get("name") and stated.get("sigma_separation_m")
    if parts.raw("logs", "geoid") and (not sigma or stated.get("separation_m")):
        yield mistake(
            "logs.geoid",
            "a grid of a geoid" + (" beside a single separation" if sigma else " without name and sigma"),
            "the height system that it belongs to, and how good it is",
            "Write fusion.vertical: {name: …, sigma_separation_m: …}, without separation_m",
        )


def _check_source(parts: Parts, logs: Logs) -> Iterator[Mistake]:
    at_rest = logs.calibration
    if (at_rest.field or at_rest.board_images) and not logs.lidar:
        return  # a calibration without a dynamic run needs no trajectory
    if parts.orientation is None or logs.light_sheet.given:
        return  # a sensor in a basin has no trajectory either
    source = parts.orientation.position_source
    # a lidar and a camera need attitudes; soundings do with a boat that is level and heads along its course
    attitude = source == "ins" or bool(
        parts.raw("logs", "lidar") or parts.raw("logs", "time_lapse", "images")
    )
    needs = [*_NEEDS[source], *(["ins"] if attitude and source != "sbet" else [])]
    if source == "nmea" and not (logs.positions or logs.depth):
        needs.append("positions")
    for need in needs:
        if not parts.raw("logs", *need.split(".")):
            others = [s for s, keys in _NEEDS.items() if keys and s != source and _given(logs, keys)]
            hint = f", or choose position_source: {others[0]}" if others and need != "ins" else ""
            if need == "ins" and source != "ins":
                hint = ", or name an SBET (`sbet: …` with position_source: sbet), which has both"
            yield mistake(
                ("logs", *need.split(".")),
                "missing",
                f"{_WHAT[need]}, "
                + (
                    "needed with a lidar or photographs"
                    if need == "ins" and source != "ins"
                    else f"needed for orientation.position_source: {source}"
                ),
                f"Add the line `{need.split('.')[-1]}: …`{hint}",
            )
    rover = logs.gnss.rover
    if source == "sbp" and rover and all(is_rinex_name(Path(name)) for name in rover):
        yield mistake(
            "logs.gnss.rover",
            "RINEX files only, which hold observations and no positions",
            "SBP logs, needed for orientation.position_source: sbp",
            "Name the SBP log, or choose position_source: ppk",
        )
    if source == "ppk" and not any(parts.raw("logs", "gnss", key) for key in _BASE_KEYS):
        yield mistake(
            "logs.gnss",
            "the position of the base antenna is missing",
            f"one of {', '.join(_BASE_KEYS)}, needed for orientation.position_source: ppk",
            "Add `base_from: sbp` if the log carries it, else its coordinates, for instance "
            "base_llh: {lat_deg: …, lon_deg: …, h_ell_m: …}",
        )
    if parts.mounts is None or parts.mounts.calibration is not None:
        return
    recorded = {"lidar": bool(logs.lidar), "echo_sounder": bool(logs.depth)}
    recorded["antenna"] = any(recorded.values()) and source in {"pos", "sbp", "ppk", "nmea", "gpx"}
    sensors = [sensor for sensor, is_there in recorded.items() if is_there]
    for sensor in sensors:
        if parts.raw("mounts", sensor, "lever_ics_m") is None:
            yield mistake(
                ("mounts", sensor, "lever_ics_m"),
                "missing",
                f"the place of the {sensor} in the body frame, metres forward, right, down",
                "Measure it and write lever_ics_m: [x, y, z]; zeros only if it sits at the INS itself",
            )


def _given(logs: Logs, keys: tuple[str, ...]) -> bool:
    return all((logs.gnss.rover if key == "gnss.rover" else getattr(logs, key)) for key in keys)


def _check_logs(logs: Logs) -> Iterator[Mistake]:
    if logs.depth_date is not None:
        try:
            dt.date.fromisoformat(logs.depth_date)
        except ValueError:
            yield mistake(
                "logs.depth_date",
                f"found {logs.depth_date!r}, no day of the calendar",
                "a date YYYY-MM-DD",
                "Write the UTC date of the first sounding, like 2021-05-12",
            )
