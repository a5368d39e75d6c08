"""A new campaign file with comments, from nothing or from a folder of logs."""

import glob
import os
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Final

from thalweg.settings.checks_place import utm_code
from thalweg.settings.sections import DSM_ENDINGS, ReferenceSettings, is_rinex_name

PLACEHOLDERS: Mapping[str, Sequence[str]] = {
    "lidar": ["raw/lidar/*.pcap"],
    "ins": ["raw/ins/*.anpp"],
    "pos": ["raw/gnss/boat.pos"],
    "depth": [],
    "reference": [],
}
"""Logs of a campaign of which no files are known yet."""

_BESIDE_IMAGES: Final = (
    ("control_points", "control_points", "surveyed points on the bank"),
    ("image_marks", "marks", "where they are in the images; without: found automatically"),
    ("time_lapse_times", "times", "times of the images"),
    ("masks", "masks", "masks made elsewhere; without: made automatically"),
    ("finished_orientations", "orientations", "orientations from another program"),
)
"""Stream, key of ``logs.time_lapse``, meaning."""
_ORDINARY_GNSS: Final = [
    "  accept_fixes: [single, sbas, dgnss, float, fixed]",
    "  sigma_position_m: [2.0, 2.0, 4.0]  # CHANGE: east, north, up, where the log states none (NMEA: GST)",
    "  # antenna_h_ell_m: 0.0  # ellipsoidal height of the antenna, where the log has none",
    "  max_gap_s: 5.0  # longest hole between positions that is interpolated",
]
"""Lines of ``orientation`` for a receiver that writes NMEA or GPX."""
_SIGMAS_OF_SBET: Final = [
    "",
    "ins:",
    "  sigma_position_m: [0.03, 0.03, 0.05]  # CHANGE: east, north, up, where no SMRMSG states them",
]
_ON_LAND: Final = (
    "# filters: {below_water_m: null, mirror_ghosts: false, hull_low_ics_m: null, hull_high_ics_m: null}"
    "  # where there is no water, and no boat about the lidar"
)
_SURVEYED: Final = "surveyed points; role check: judges, takes no part"
_NAMED: Final = 8
"""Files of one folder and ending that are named one by one; more are a pattern."""


def campaign_text(
    name: str,
    *,
    folder: Path,
    files: Mapping[str, Sequence[Path]] | None = None,
    origin: tuple[float, float, float] | None = None,
    spacing_m: float | None = None,
    schema: str = "../schema.json",
    remarks: Sequence[str] = (),
    topics: Mapping[str, Sequence[str]] | None = None,
) -> str:
    """Text of a new campaign file.

    Parameters
    ----------
    name : id of the campaign.
    folder : folder that the file will stand in; paths are written relative to it where that is short.
    files : logs by stream; placeholders if None.
    origin : latitude and longitude in degrees and ellipsoidal height in metres; a placeholder if None.
    spacing_m : distance of the points of a reference cloud from each other; None: as dense as usual.
    schema : path of the JSON schema from ``folder``, for editors.
    remarks : sentences on what was chosen among the logs, written below them.
    topics : of streams whose files are containers with several: those that are meant.
    """
    lat, lon, h = origin or (51.05, 13.25, 300.0)
    mark = "" if origin else "  # CHANGE: a point near the survey"
    grid = "UTM at the origin, or the grid that maps shall have: projected, in metres"
    grid = grid if origin else f"CHANGE: {grid}"
    listed = {k: list(v) for k, v in PLACEHOLDERS.items()}
    if files is not None:
        listed = {k: _listed(v, folder) for k, v in files.items()}
    for stream, meant in (topics or {}).items():
        listed[stream] = [f"{text}#{topic}" for text in listed[stream] for topic in meant]
    alone = _alone(listed, spacing_m) if files is not None else []
    if alone:
        return "\n".join([*_head(name, schema), *alone]) + "\n"
    source, gnss = _source(listed)
    fixes = "auto" if source == "ppk" else "[fixed]"
    in_real_time = source == "pos" and not all(text.endswith(".pos") for text in listed.get("pos", []))
    levers = "  # CHANGE: metres forward, right, down of the INS"
    if not (listed.get("ins") or listed.get("sbet")):
        levers = "  # CHANGE: metres forward, right, down of any fixed point of the boat"
    lines = [
        *_head(name, schema),
        f"  crs: {utm_code(lat, lon)}  # {grid}",
        f"  origin: {{lat_deg: {lat}, lon_deg: {lon}, h_ell_m: {h}}}{mark}",
        "  seed: 1",
        "",
        "logs:  # relative to this file or absolute; ~ and patterns like raw/*.pcap work",
        *_list("lidar", listed.get("lidar", []), "Velodyne captures"),
        *_list("ins", listed.get("ins", []), "INS or autopilot"),
        *gnss,
        *_list("positions", listed.get("pos", []), "RTKLIB .pos, NMEA or GPX"),
        *_list("sbet", listed.get("sbet", []), "Applanix SBET; needs gps_week"),
        *_beside_sbet(listed),
        *_list("depth", listed.get("depth", []), "echo sounder"),
        *(
            ["  # depth_date: 2026-05-12  # UTC day of its start, where it has none"]
            if listed.get("depth")
            else []
        ),
        *_list("reference", listed.get("reference", []), "clouds to compare with: LAS, LAZ, PLY, E57"),
        *_photographs(listed),
        *(f"  # {remark}" for remark in remarks),
        "",
        "mounts:  # body frame of the INS, or of the boat: x forward, y right, z down",
        *_lidar(listed, levers),
        *_antenna(listed, source, levers),
        *(["  echo_sounder:", f"    lever_ics_m: CHANGE{levers}"] if listed.get("depth") else []),
        *_camera(listed, levers),
        "",
        "orientation:",
        f"  position_source: {source}  # pos, sbp, ppk, nmea, gpx, sbet or ins",
        *(_ORDINARY_GNSS if source in ("nmea", "gpx") or in_real_time else [f"  accept_fixes: {fixes}"]),
        *_without_control(listed, source),
        *(_SIGMAS_OF_SBET if source == "sbet" and not listed.get("smrmsg") else []),
        *(["", _ON_LAND] if listed.get("lidar") else []),
    ]
    return "\n".join(lines) + "\n"


def epochs_text(
    name: str,
    epochs: Sequence[str | tuple[Path, str]],
    crs: str,
    origin: tuple[float, float, float],
    *,
    folder: Path,
    spacing_m: float | None = None,
    schema: str = "../schema.json",
) -> str:
    """Text of a campaign file that compares surveys.

    Parameters
    ----------
    name : id of the campaign.
    epochs : in the order of time: ids of campaigns that surveyed the bank, or a file of a cloud or surface
        model with its date (empty if unknown).
    crs : map grid; origin : latitude, longitude, ellipsoidal height of the frame of all.
    folder, spacing_m, schema : as for `campaign_text`, of the points of the first file.
    """
    place = f"lat_deg: {origin[0]}, lon_deg: {origin[1]}, h_ell_m: {origin[2]}"
    lines = [
        *_head(name, schema),
        f"  crs: {crs}",
        f"  origin: {{{place}}}",
        "  seed: 1",
        "",
        "epochs:  # in the order of time; chain: ins, camera, fused or strips",
        *(line for epoch in epochs for line in _epoch(epoch, folder)),
        "",
        "deformation:",
        "  # area: {polygon: [[east, north], ...], min_height_m: 0.0}  # part of the bank to compare",
        *_stable(epochs),
        *_core_points(spacing_m),
    ]
    return "\n".join(lines) + "\n"


def _beside_sbet(listed: Mapping[str, Sequence[str]]) -> list[str]:
    """What an SBET does not hold itself."""
    if not listed.get("sbet"):
        return []
    sigmas = _list(
        "smrmsg", listed.get("smrmsg", []), "its standard deviations; without, those of section ins"
    )
    return ["  gps_week: CHANGE  # week of the SBET, as 2235", *sigmas]


def _core_points(spacing_m: float | None) -> list[str]:
    """Lines of cells and cylinders, four spacings wide where points lie farther apart than a boat's."""
    cell = float(f"{max(4.0 * (spacing_m or 0.0), 0.5):.2g}")
    lines = [
        f"  core_spacing_m: {cell:g}",
        f"  reach_m: {max(2.0 * cell, 3.0):g}  # farther than the largest retreat",
    ]
    if cell > 0.5:
        lines += [
            f"  # the points of the first file are {spacing_m:.2g} m apart",
            f"  scales_m: [{cell:g}, {2 * cell:g}, {4 * cell:g}]",
            f"  cylinder_radius_m: {cell:g}",
            f"  classes: {{vegetation_roughness_m: {0.25 * cell:.2g}}}  # CHANGE: above its relief",
        ]
    return lines


def _epoch(epoch: str | tuple[Path, str], folder: Path) -> list[str]:
    """Lines of one epoch."""
    if isinstance(epoch, str):
        return [f"  - {{campaign: {epoch}, chain: ins}}"]
    path, date = epoch
    text = _relative(path, folder)
    key = f"dsm: {text}" if path.suffix.lower() in DSM_ENDINGS else f"clouds: [{text}]"
    return [
        f"  - {key}",
        f"    date_utc: {date}" if date else "    date_utc: CHANGE  # day or UTC time of the survey",
        "    # crs: EPSG:25833+7837  # grid and heights, where the file states none",
        "    sigma_m: CHANGE  # errors that neighbouring points share, as 0.03; null: unknown, no verdict",
        "    correlation_m: CHANGE  # distance over which they are alike, as 20.0; null with sigma_m: null",
        "    # sigma_common_m: 0.05  # error of all heights together, where no stable ground is drawn",
        "    leave_out: CHANGE  # polygons of water, waves, plants, cars: [water.gpkg]; []: all is ground",
    ]


def _stable(epochs: Sequence[str | tuple[Path, str]]) -> list[str]:
    """Lines of ground that did not move, which epochs without a trajectory need."""
    if all(isinstance(epoch, str) for epoch in epochs):
        return [
            "  # stable: [[[east, north], ...], ...]  # unmoved ground; without: what most of it agrees on"
        ]
    return [
        "  stable: CHANGE  # ground that did not move, in three and more areas: roads.gpkg (polygons, lines,",
        "    # points); null: nothing is taken off, and the epochs may lie off each other as a whole",
    ]


def _head(name: str, schema: str) -> list[str]:
    """First lines of every campaign file."""
    return [
        f"# yaml-language-server: $schema={schema}",
        "# Every key, its unit and its default: config/README.md. Check with: thalweg check-config THIS_FILE",
        "campaign:",
        f"  id: {name}",
        f"  title: {name}  # CHANGE: one line for figures and reports",
    ]


def _alone(listed: Mapping[str, Sequence[str]], spacing_m: float | None) -> list[str]:
    """Lines of a campaign without a boat, behind its head; none where a boat recorded something."""
    frame = [
        "  crs: local  # CHANGE: map grid of the coordinates, as EPSG:25833; or local, a frame of your own",
        "  seed: 1",
        "",
        "logs:  # relative to this file or absolute; ~ and patterns like raw/*.jpg work",
    ]
    if listed.get("fixed_marks"):
        parts: tuple[tuple[str, str, str], ...] = (
            ("fixed_marks", "marks", "where the control points are in the pictures"),
            ("fixed_points", "control_points", _one_of(listed, "fixed_points", _SURVEYED)),
            ("fixed_interior", "interior", _one_of(listed, "fixed_interior", "interior orientation")),
        )[: 3 if listed.get("fixed_interior") else 2]  # which the points tell, too
        return [
            *frame,
            "  fixed_camera:  # a camera that stays: docs/images.md",
            *_nested(listed, parts),
            "",
            "images:",
            "  control:  # CHANGE: standard deviations of marks and points whose tables state none",
            "    sigma_px: 0.5",
            "    sigma_m: [0.010, 0.010, 0.015]",
        ]
    if listed.get("cloud"):
        return [
            *frame,
            *_list("cloud", listed["cloud"], "the cloud that is judged"),
            *_list("reference", listed.get("reference", []), "CHANGE: mesh or cloud that it is judged by"),
            "",
            "reference:",
            "  sigma_m: 0.005  # CHANGE: registration and georeferencing of the reference, one sigma",
            *(
                [
                    f"  # the points of the reference are {spacing_m:.3g} m apart",
                    f"  cell_m: {spacing_m / 2:.2g}",
                    f"  longest_edge_m: {5 * spacing_m:.2g}",
                    f"  isolated_radius_m: {5 * spacing_m:.2g}",
                ]
                if spacing_m is not None and 5 * spacing_m > ReferenceSettings().longest_edge_m
                else []
            ),
            "  # seen_from_m: [0.0, 0.0, 0.0]  # place in front of a bank or wall; without: from above",
        ]
    moved = ("lidar", "ins", "rover", "base", "pos", "sbet", "depth")
    if not listed.get("time_lapse") or any(listed.get(stream) for stream in moved):
        return []
    parts = (
        ("time_lapse", "images", "a folder, or files"),
        ("control_points", "control_points", _one_of(listed, "control_points", _SURVEYED)),
        ("image_marks", "marks", _one_of(listed, "image_marks", "where they are in the photographs")),
        ("camera_positions", "positions", "where the camera was; beside control points or instead"),
        ("finished_orientations", "orientations", "orientations from another program, instead of our own"),
        ("interior", "interior", _one_of(listed, "interior", "interior orientation; without: estimated")),
        ("masks", "masks", "what is not to be used"),
    )
    return [*frame, "  time_lapse:  # photographs without a boat: docs/images.md", *_nested(listed, parts)]


def _one_of(listed: Mapping[str, Sequence[str]], stream: str, meaning: str) -> str:
    """Meaning of a table of which a survey has one; of several the user has to choose."""
    n = len(listed.get(stream, []))
    return f"{meaning}; CHANGE: keep one of {n}" if n > 1 else meaning


def _nested(listed: Mapping[str, Sequence[str]], parts: Sequence[tuple[str, str, str]]) -> list[str]:
    """Lines of a part of ``logs``: stream, key and meaning of each."""
    lines = [line for stream, key, meaning in parts for line in _list(key, listed.get(stream, []), meaning)]
    return [f"  {line}" for line in lines]


def _photographs(listed: Mapping[str, Sequence[str]]) -> list[str]:
    """Lines of ``logs.time_lapse``; what belongs to images stays out where there are none."""
    images = listed.get("time_lapse", [])
    if not images:
        return ["  # time_lapse: {images: [], control_points: []}  # photographs of the bank: docs/images.md"]
    lines = ["  time_lapse:  # photographs of the bank: docs/images.md"]
    more = "" if len(images) == 1 else "; CHANGE: keep those of the survey"
    lines += [f"  {line}" for line in _list("images", images, f"a folder, or files{more}")]
    for stream, key, meaning in _BESIDE_IMAGES:
        lines += [f"  {line}" for line in _list(key, listed.get(stream, []), meaning)]
    return lines


def _antenna(listed: Mapping[str, Sequence[str]], source: str, levers: str) -> list[str]:
    """Lines of ``mounts.antenna``; of a receiver alone the trajectory is that of its antenna."""
    if source in ("ins", "sbet"):
        return ["  antenna: {lever_ics_m: [0.0, 0.0, 0.0]}  # not used: positions are those of the INS"]
    if any(listed.get(stream) for stream in ("lidar", "ins", "sbet", "depth", "time_lapse")):
        return ["  antenna:", f"    lever_ics_m: CHANGE{levers}"]
    return ["  antenna:", "    lever_ics_m: [0.0, 0.0, 0.0]  # metres; the trajectory is that of the antenna"]


def _lidar(listed: Mapping[str, Sequence[str]], levers: str) -> list[str]:
    """Lines of ``mounts.lidar`` of a campaign with a lidar."""
    if not listed.get("lidar"):
        return []
    return [
        "  lidar:",
        "    omega_deg: 0.0",
        "    phi_deg: -90.0  # spin axis points backwards",
        "    kappa_deg: 0.0",
        f"    lever_ics_m: CHANGE{levers}",
    ]


def _camera(listed: Mapping[str, Sequence[str]], levers: str) -> list[str]:
    """Lines of ``mounts.camera`` of a campaign with photographs."""
    if not listed.get("time_lapse"):
        return []
    return [
        "  camera:  # or, for all sensors: calibration: NAME_OF_A_CALIBRATION_CAMPAIGN",
        "    omega_deg: -90.0  # CHANGE: looks to starboard; 90.0 and kappa_deg: 0.0 to port",
        "    phi_deg: 0.0",
        "    kappa_deg: 180.0",
        f"    lever_ics_m: CHANGE{levers}",
    ]


def _without_control(listed: Mapping[str, Sequence[str]], source: str) -> list[str]:
    """Photographs alone need the antenna's positions in their adjustment; beside an SBET its way."""
    needs = listed.get("time_lapse") and not (
        listed.get("control_points") or listed.get("finished_orientations")
    )
    if listed.get("time_lapse") and source == "sbet":
        return ["", "images:", "  cloud: {motion: trajectory}  # velocity, where the SBET holds right ones"]
    if not needs or source in ("ins", "sbet"):  # these are no positions of the antenna: `check_images`
        return []
    return [
        "",
        "images:",
        "  adjustment:",
        "    antenna: {use: true}  # no control points were found: positions of the antenna take their place",
    ]


def _source(listed: Mapping[str, Sequence[str]]) -> tuple[str, list[str]]:
    """Best source of positions for these logs, and the lines of the GNSS logs."""
    gnss: list[str] = []
    if any(listed.get(key) for key in ("rover", "base", "nav")):
        gnss = ["  gnss:"]
        for key, meaning in (("rover", "the boat"), ("base", "the base"), ("nav", "ephemerides")):
            gnss += [f"  {line}" for line in _list(key, listed.get(key, []), meaning)]
    else:
        gnss = ["  # gnss: {rover: [], base: [], nav: []}  # raw GNSS: SBP or RINEX"]
    sources = position_sources(listed)
    if sources and sources[0] == "ppk":
        gnss.append("    base_from: rinex_header  # CHANGE: or sbp, base_ecef_m, base_llh")
    found = {"ins": "ins", "nmea": "depth"}
    return next(iter(sources or [s for s, stream in found.items() if listed.get(stream)]), "pos"), gnss


def position_sources(listed: Mapping[str, Sequence[str | Path]]) -> list[str]:
    """What GNSS logs by stream can be ``orientation.position_source``: finished before raw, best first."""
    found = []
    if listed.get("pos"):
        found.append("gpx" if all(Path(name).suffix.lower() == ".gpx" for name in listed["pos"]) else "pos")
    if listed.get("sbet"):
        found.append("sbet")
    rover = listed.get("rover")
    if listed.get("base") or (rover and all(is_rinex_name(Path(name)) for name in rover)):
        found.append("ppk")
    elif rover:
        found.append("sbp")
    return found


def _list(key: str, paths: Sequence[str], meaning: str) -> list[str]:
    if not paths:
        return [f"  # {key}: []  # {meaning}"]
    if len(paths) == 1:
        return [f"  {key}: [{_quoted(paths[0])}]  # {meaning}"]
    return [f"  {key}:  # {meaning}", *(f"    - {_quoted(path)}" for path in paths)]


def _quoted(text: str) -> str:
    plain = all(c.isalnum() or c in "/._-~+#" for c in text) and text[0] not in "-~"
    return text if plain else '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _listed(paths: Sequence[Path], folder: Path) -> list[str]:
    """Paths as text; many of one folder and ending as a pattern, if it finds these and no others."""
    out: list[str] = []
    for (parent, suffix), group in groupby(paths, key=lambda path: (path.parent, path.suffix)):
        own = list(group)
        begin = os.path.commonprefix([path.stem for path in own])  # noqa: RUF071  (letters, no folders)
        pattern, plain = f"{begin}*{suffix}", str(parent / begin)
        if len(own) > _NAMED and glob.escape(plain) == plain and set(parent.glob(pattern)) == set(own):
            own = [parent / pattern]
        out += [_relative(path, folder) for path in own]
    return out


def _relative(path: Path, folder: Path) -> str:
    relative = os.path.relpath(path.absolute(), folder.absolute())
    return path.absolute().as_posix() if relative.count("..") > 3 else Path(relative).as_posix()
