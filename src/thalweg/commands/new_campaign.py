"""The commands ``thalweg new-campaign``: a campaign file of a folder of logs, and ``schema``."""

import argparse
import os
import re
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from thalweg.commands.options import CAMPAIGNS, GEODETIC
from thalweg.commands.parser import Commands
from thalweg.core import ConfigError, InputError, ThalwegError


def add_new_campaign_command(commands: Commands) -> None:
    """Add ``new-campaign``."""
    commands.add(
        "new-campaign",
        "write a commented campaign file",
        _new_campaign,
        ("id", str, None, "short name: small letters, digits, underscores"),
        ("--from-logs", Path, "FOLDER", "enter the logs of this folder, recognised by their content"),
        ("--origin", [float], GEODETIC, "point near the survey: origin of the local frame"),
        ("--folder", Path, None, "where to write (default: %(default)s)", CAMPAIGNS),
        (
            "--epochs",
            [str],
            "ID|FILE[@DATE]",
            "compare these epochs, two or more in the order of time: campaigns of the folder, or clouds and "
            "surface models (.tif) with the day of the survey, such as bank.laz@2019-03-13",
        ),
    )


def add_schema_command(commands: Commands) -> None:
    """Add ``schema``."""
    commands.add(
        "schema",
        "JSON schema of campaign files",
        _schema,
        ("--write", bool, None, "write the generated files of the config folder"),
        ("--folder", Path, None, "config folder (default: %(default)s)", CAMPAIGNS.parent),
    )


def _new_campaign(options: argparse.Namespace) -> int:
    from thalweg.settings import ID_PATTERN, campaign_text

    name, folder = options.id, options.folder
    if not re.fullmatch(ID_PATTERN, name):
        raise ConfigError(
            f"{name!r} cannot be the id of a campaign",
            expected="small letters, digits and underscores, beginning with a letter",
            cure="Choose another id: it names files and folders",
        )
    path = folder / f"{name}.yaml"
    if path.exists():
        raise ConfigError("the file exists already", where=path, cure="Choose another id, or edit this file")
    schema = Path(os.path.relpath(CAMPAIGNS.parent.absolute() / "schema.json", folder.absolute())).as_posix()
    if options.epochs:
        text = _epochs_text(name, options, schema)
    else:
        files, remarks, topics = _sort_logs(options.from_logs) if options.from_logs else (None, [], {})
        text = campaign_text(
            name,
            folder=folder,
            files=files,
            origin=tuple(options.origin) if options.origin else _place(files or {}),
            spacing_m=_spacing_m(files or {}),
            remarks=remarks,
            topics=topics,
            schema=schema,
        )
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    print(f"Wrote {path}. Edit the lines marked CHANGE, then run: thalweg check-config {path}")
    return 0


def _epochs_text(name: str, options: argparse.Namespace, schema: str) -> str:
    """Text of a campaign of epochs: of campaigns and of files."""
    from thalweg.deformation.foreign import place_of_file, point_spacing_m
    from thalweg.settings import epochs_text, load_campaign
    from thalweg.settings.sections import CLOUD_ENDINGS, DSM_ENDINGS, TEXT_ENDINGS

    endings = (*CLOUD_ENDINGS, *TEXT_ENDINGS, *DSM_ENDINGS)
    epochs: list[str | tuple[Path, str]] = []
    for item in options.epochs:
        path, _, date = item.partition("@")
        epochs.append((Path(path).absolute(), date) if Path(path).suffix.lower() in endings else item)
    surveys = [each for each in epochs if isinstance(each, str)]
    files = [each[0] for each in epochs if not isinstance(each, str)]
    if surveys:
        place = load_campaign(options.folder / f"{surveys[0]}.yaml").campaign
        if place.origin is None:
            raise ConfigError(
                f"{surveys[0]} has no origin",
                expected="campaigns with a lidar cloud in a frame of the map",
                where=options.folder / f"{surveys[0]}.yaml",
                cure="Name files of its cloud as FILE@DATE instead",
            )
        crs, origin = place.crs, (place.origin.lat_deg, place.origin.lon_deg, place.origin.h_ell_m)
    else:
        crs, origin = place_of_file(files[0], tuple(options.origin) if options.origin else None)
    spacing = point_spacing_m(files[0]) if files else None
    return epochs_text(name, epochs, crs, origin, folder=options.folder, spacing_m=spacing, schema=schema)


_FILES_NAMED = 5
"""Of one kind in one folder; more are counted."""


def _sort_logs(folder: Path) -> tuple[dict[str, list[Path]], list[str], dict[str, tuple[str, ...]]]:
    """Files of a folder by stream, recognised by their content, what was chosen, and topics of containers."""
    from thalweg.ingest.registry import (
        ALSO_MARKS,
        KINDS,
        LOOSE_KINDS,
        TABLE_KINDS,
        also_streams,
        choose_tracks,
        mounts_of_bag,
        recognise,
        stream_of,
        topics_to_choose,
        what_it_is_for,
    )
    from thalweg.settings import natural_order

    if not folder.is_dir():
        raise InputError("no such folder", where=folder, expected="a folder of raw logs")
    streams: dict[str, list[Path]] = {}
    pictures: Counter[tuple[str, Path]] = Counter()
    left_out: dict[str, list[Path]] = {}
    loose: list[tuple[str, str, Path]] = []
    known: list[tuple[str, str, Path]] = []
    beside: dict[str, list[Path]] = {}
    choices: dict[str, list[tuple[str, ...]]] = {}
    remarks: list[str] = []
    for path in sorted((p for p in folder.rglob("*") if p.is_file()), key=natural_order):
        try:
            kind = recognise(path)
            stream = stream_of(kind, path)
        except ThalwegError as error:
            unknown = error.found.startswith("unrecognised file")
            left_out.setdefault("unrecognised" if unknown else error.found, []).append(path)
            continue
        if kind in LOOSE_KINDS:
            loose.append((LOOSE_KINDS[kind], kind, path))
        elif stream is None:
            left_out.setdefault(f"{KINDS[kind]}: {what_it_is_for(kind, path)}", []).append(path)
        elif kind == "photograph":
            pictures[stream, path.parent] += 1
        else:
            known.append((stream, kind, path))
            streams.setdefault(stream, []).append(path)
            for other in also_streams(kind, path):
                beside.setdefault(other, []).append(path)
            choices |= topics_to_choose(kind, path)
            if kind == "rosbag":
                remarks += [
                    f"{name} as {path.name} states it (tf_static): {place}; CHANGE: enter it below mounts"
                    for name, place in mounts_of_bag(path).items()
                ]
            if kind in ALSO_MARKS:
                streams.setdefault("image_marks", []).append(path)
    logged = {stream for stream, kind, _ in known if kind not in TABLE_KINDS}
    for stream, kind, path in [each for each in known if each[1] in TABLE_KINDS and each[0] in logged]:
        known.remove((stream, kind, path))
        streams[stream].remove(path)
        left_out.setdefault(f"{KINDS[kind]}, beside a log of the same", []).append(path)
    for (stream, parent), n in pictures.items():
        if any((stream, above) in pictures for above in parent.parents):
            print(f"{stream:10s} {parent} ({n} photographs, below a folder that is named)")
            continue
        print(f"{stream:10s} {parent} (folder with {n} photographs)")
        streams.setdefault(stream, []).append(parent)
    for stream, paths in beside.items():
        if stream not in streams:  # a log of its own comes first
            streams[stream] = paths
            for path in paths:
                print(f"{stream:10s} {path} (the same file)")
    wanted = _wanted(streams, loose)
    for stream, kind, path in loose:
        if stream in wanted:
            known.append((stream, kind, path))
            streams.setdefault(stream, []).append(path)
        else:
            left_out.setdefault(f"{KINDS[kind]}: no stream of a survey", []).append(path)
    told: set[tuple[str, str, Path]] = set()
    alike = Counter((stream, kind, path.parent) for stream, kind, path in known)
    for stream, kind, path in known:
        n, first = alike[stream, kind, path.parent], (stream, kind, path.parent) not in told
        told.add((stream, kind, path.parent))
        if n <= _FILES_NAMED:
            print(f"{stream:10s} {path} ({kind})")
        elif first:
            print(f"{stream:10s} {path.parent} ({n} files, {kind})")
    streams = _of_receivers(_of_one_kind(streams))
    others: dict[str, list[Path]] = {}
    if "pos" in streams:
        kept, second = choose_tracks(streams.pop("pos"))
        if kept:
            streams["pos"] = kept
        for path, why in second.items():
            others.setdefault(why, []).append(path)
    left_out |= others
    for why, paths in others.items():
        remarks.append(f"left out, {why}: {', '.join(path.name for path in paths)}")
    if chosen := _chosen_source(streams):
        remarks.append(chosen)
        print(chosen, file=sys.stderr)
    for why, paths in left_out.items():
        named = ", ".join(str(path.relative_to(folder)) for path in paths[:3])
        more = f" and {len(paths) - 3} more" if len(paths) > 3 else ""
        print(f"left out, {why}: {named}{more}", file=sys.stderr)
    topics = {stream: equals[0] for stream, equals in choices.items() if stream in streams}
    for stream, meant in topics.items():
        also = " or ".join(" with ".join(each) for each in choices[stream][1:])
        remarks.append(f"{stream} from {' with '.join(meant)}; CHANGE: or name {also}")
        print(f"{remarks[-1].replace('CHANGE: ', '')}", file=sys.stderr)
    if left_out:
        print("Run `thalweg describe FILE` to inspect one file", file=sys.stderr)
    if not streams:
        raise InputError(
            "no raw log was recognised",
            where=folder,
            expected="logs of a lidar, INS, autopilot, receiver or echo sounder, clouds or photographs",
            cure="A bed of soundings makes `thalweg bed FILE`; look at files with `thalweg describe FILE`",
        )
    return streams, remarks, topics


def _chosen_source(streams: dict[str, list[Path]]) -> str:
    """Which of several sources of positions is taken and why; empty where there is no choice."""
    from thalweg.core import utc_text_from_gps
    from thalweg.settings import position_sources

    first, *others = position_sources(streams) or [""]
    if not others:
        return ""
    also = " or ".join(others)
    chosen = f"positions from {first}: a finished solution before raw logs; these logs would also give {also}"
    solved, raw = (_span(streams.get(stream, [])) for stream in ("pos", "rover"))
    if solved and raw and (raw[1] < solved[0] or solved[1] < raw[0]):
        day = utc_text_from_gps(raw[0])[:10]
        chosen += f"; CHANGE: the raw GNSS is of another time ({day}), keep one of both"
    return chosen


def _span(files: Sequence[Path]) -> tuple[float, float] | None:
    """First and last GPS time of files; None where they tell none, or cannot be read."""
    from thalweg.ingest.registry import describe

    try:
        told = [describe(path) for path in files]
    except ThalwegError:  # which the check of the campaign says
        return None
    times = [t for each in told for t in (each.t_first_s, each.t_last_s) if t is not None]
    return (min(times), max(times)) if times else None


def _wanted(streams: dict[str, list[Path]], loose: list[tuple[str, str, Path]]) -> set[str]:
    """Which streams of `LOOSE_KINDS` something is made of beside the logs that a folder holds."""
    marks = any(stream == "fixed_marks" for stream, _, _ in loose) and "control_points" in streams
    wanted = {"fixed_marks"} if marks else set()
    if marks or "time_lapse" in streams:
        wanted.add("interior")
    return wanted | ({"cloud"} if set(streams) <= {"reference"} else set())


def _of_one_kind(streams: dict[str, list[Path]]) -> dict[str, list[Path]]:
    """The same, where files mean something else without a boat: a camera that stays, a finished cloud.

    A table of marks for each picture comes from a camera that stays; of clouds alone, the one called after a
    reference or else the largest is the reference.
    """
    if streams.get("fixed_marks"):
        named = {"control_points": "fixed_points", "interior": "fixed_interior"}
        kept = {"fixed_marks": streams["fixed_marks"]}
        kept |= {named[stream]: paths for stream, paths in streams.items() if stream in named}
        others = sorted(set(streams) - {*named, "fixed_marks"})
        if others:
            print(f"left out, not needed for a camera that stays: {', '.join(others)}", file=sys.stderr)
        return kept
    clouds = [*streams.get("reference", []), *streams.get("cloud", [])]
    if set(streams) <= {"reference", "cloud"} and len(clouds) > 1:
        chosen = [path for path in clouds if re.search("ref|tls", path.stem.lower())]
        largest = chosen[0] if chosen else max(clouds, key=lambda path: path.stat().st_size)
        return {"reference": [largest], "cloud": [path for path in clouds if path != largest]}
    return streams


def _of_receivers(streams: dict[str, list[Path]]) -> dict[str, list[Path]]:
    """Raw GNSS of a folder by receiver, where names do not tell.

    RINEX beside an SBP log is what somebody made of that log; of two receivers in RINEX the one that moves
    less is the base.
    """
    from thalweg.ingest.ppk import base_extent_m
    from thalweg.ingest.registry import describe, recognise

    rover = streams.get("rover", [])
    rinex = [path for path in rover if recognise(path) == "rinex"]
    if not rinex:
        return streams
    if len(rinex) < len(rover):
        named = ", ".join(path.name for path in rinex)
        print(f"left out, RINEX beside the SBP log of the rover: {named}", file=sys.stderr)
        return streams | {"rover": [path for path in rover if path not in rinex]}
    receivers: dict[tuple[str, ...], list[Path]] = {}
    for path in rinex:
        told = describe(path)
        of = tuple(map(str, (told.model, told.details.get("marker"), told.details.get("antenna"))))
        receivers.setdefault(of, []).append(path)
    if streams.get("base") or len(receivers) != 2:
        return streams
    one, other = receivers.values()
    nav = streams.get("nav", [])
    try:
        moves_less = base_extent_m(other, one, nav) < base_extent_m(one, other, nav)
    except ThalwegError as error:
        print(f"which of two receivers is the base is not known: {error}", file=sys.stderr)
        return streams
    base, boat = (one, other) if moves_less else (other, one)
    for path in base:
        print(f"base       {path} (of two receivers the one that moves less)")
    return streams | {"base": base, "rover": boat}


def _spacing_m(files: dict[str, list[Path]]) -> float | None:
    """How far the points of a reference cloud are from their nearest neighbours; None for all else."""
    if not (files.get("cloud") and files.get("reference")):
        return None
    from thalweg.deformation.foreign import point_spacing_m

    return point_spacing_m(files["reference"][0])


def _place(files: dict[str, list[Path]]) -> tuple[float, float, float] | None:
    """Latitude, longitude and ellipsoidal height in the middle of the positions of a survey; None: unknown.

    Rounded to about a metre: it is a name for a place and no measurement.
    """
    from thalweg.core import LocalFrame
    from thalweg.ingest import PoseLog
    from thalweg.ingest.registry import load_recording

    for stream in ("pos", "sbet", "ins", "rover", "depth"):
        for path in files.get(stream, []):
            try:
                log = load_recording([path])
            except ThalwegError:  # such as an SBET, whose week is not known yet
                continue
            header = log.report.details.get("approx_ecef_m")
            if isinstance(header, list) and any(header):  # raw observations: the place in their header
                anywhere = LocalFrame(lat_deg=0.0, lon_deg=0.0, h_ell_m=0.0)
                lat, lon, h = (float(x[0]) for x in anywhere.to_geodetic(anywhere.from_ecef([header])))
                return round(lat, 5), round(lon, 5), round(h)
            table = log.states if isinstance(log, PoseLog) and log.positions.empty else log.positions
            placed = table.dropna(subset=["lat_deg", "lon_deg"])
            if len(placed):
                lat, lon, h = (float(placed[name].median()) for name in ("lat_deg", "lon_deg", "h_ell_m"))
                return round(lat, 5), round(lon, 5), round(h) if h == h else 0.0
    return None


def _schema(options: argparse.Namespace) -> int:
    from thalweg.settings import schema_text, write_generated

    if not options.write:
        print(schema_text(), end="")
        return 0
    if not options.folder.is_dir():
        raise ConfigError(
            "no such folder",
            where=options.folder,
            expected="the config folder of the repository",
            cure="Run the command at the root of the repository, or give --folder",
        )
    changed = write_generated(options.folder)
    print(f"Renewed {', '.join(map(str, changed))}" if changed else "All generated files are in step")
    return 0
