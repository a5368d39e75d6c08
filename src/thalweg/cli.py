"""The command ``thalweg``: what is not a rule of the workflow.

Heavy libraries are imported by the commands that need them, so that help and mistakes come at once.
"""

import argparse
import math
import os
import re
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import thalweg
from thalweg.commands import (
    GEODETIC,
    Commands,
    add_bathymetry_commands,
    add_calibration_commands,
    add_cluster_commands,
    add_deformation_commands,
    add_fetch_command,
    add_image_commands,
    add_result_commands,
    add_survey_commands,
    describe_marked,
    lengths,
    refuse_overwriting,
    summarise_changes,
)
from thalweg.core import ConfigError, InputError, ThalwegError, file_trouble, in_options, to_terminal

if TYPE_CHECKING:
    from thalweg.settings import Campaign

CAMPAIGNS = Path("config") / "campaigns"

EXIT_MISTAKE = 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line.

    Parameters
    ----------
    arguments : words after ``thalweg``; those of the process if None.

    Returns
    -------
    int
        0 if all is well, 2 for mistakes of the user or damaged files.
    """
    options = _parser().parse_args(arguments)
    command: Callable[[argparse.Namespace], int] = options.command
    warnings.showwarning = _show_warning  # type: ignore[assignment]
    if sys.stderr.isatty():
        to_terminal()
    try:
        _refuse_no_files(options)
        refuse_overwriting(options)
        code = command(options)
        sys.stdout.flush()
    except ThalwegError as error:
        sys.stdout.flush()
        print(in_options(str(error), getattr(options, "settings", {})), file=sys.stderr)
        return EXIT_MISTAKE
    except OSError as error:
        if isinstance(error, BrokenPipeError):
            # The reader of a pipe (`head`) has seen enough. Python would complain again while it shuts down.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        sys.stdout.flush()
        print(file_trouble(error), file=sys.stderr)
        return EXIT_MISTAKE
    return code


def _refuse_no_files(options: argparse.Namespace) -> None:
    """Refuse pipes and devices, whose reading may never end, among the paths of a command."""
    for value in vars(options).values():
        for path in value if isinstance(value, list) else [value]:
            if isinstance(path, Path) and path.exists() and not path.is_file() and not path.is_dir():
                raise InputError(
                    "this is a pipe or a device",
                    where=path,
                    expected="a file",
                    cure="Write what it gives into a file, and name that",
                )


def _show_warning(message: Warning | str, *_: object) -> None:
    """Warnings as sentences: people do not need the line of the library that had them."""
    print(f"note: {message}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="thalweg",
        description="Raw logs of a survey boat -> models of riverbanks and riverbed. Whole surveys are "
        "processed by `snakemake`; these commands prepare them, or process single files without a campaign.",
    )
    parser.add_argument("--version", action="version", version=f"thalweg {thalweg.__version__}")
    commands = Commands(parser)

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
    commands.add(
        "check-config",
        "check campaign files; report all mistakes at once",
        _check_config,
        ("files", [str], "FILE", "campaign file, or id of one"),
    )
    commands.add(
        "describe",
        "content of a raw log (counts, gaps, losses, clock), of a calibration file, or of the files "
        "that belong to it: description of the field, clock of the camera, mounting",
        _describe,
        ("files", [Path], "FILE", "raw logs, clouds, calibration files"),
        ("--model", str, None, "lidar model, if the packets state a wrong one"),
        ("--json", bool, None, "print JSON"),
    )
    add_fetch_command(commands)
    add_calibration_commands(commands)
    add_deformation_commands(commands)
    add_bathymetry_commands(commands)
    add_survey_commands(commands)
    add_image_commands(commands)
    commands.add(
        "summary",
        "print the summary of a processed campaign",
        _summary,
        ("folder", Path, "FOLDER", "results/<campaign>"),
    )
    commands.add(
        "budget",
        "error budget of a chain of frames: effect of each input on a point",
        _budget,
        ("file", Path, "FILE", "budget file; docs/budgets.md describes it"),
        (
            "--distances",
            lengths("distances in metres such as 5,10,25,50"),
            "M,M,...",
            "other distances than the file's, in metres",
        ),
        ("--published", Path, "CSV", "published values, to compare with"),
        ("--csv", Path, "OUT", "write all influences to a CSV file"),
    )
    add_result_commands(commands)
    add_cluster_commands(commands)
    commands.add(
        "schema",
        "JSON schema of campaign files",
        _schema,
        ("--write", bool, None, "write the generated files of the config folder"),
        ("--folder", Path, None, "config folder (default: %(default)s)", CAMPAIGNS.parent),
    )
    return parser


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
        except ThalwegError as error:
            unknown = error.found.startswith("the content is of no known kind")
            left_out.setdefault("of no known kind" if unknown else error.found, []).append(path)
            continue
        stream = stream_of(kind, path)
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
        print("What a single file is, says `thalweg describe FILE`", file=sys.stderr)
    if not streams:
        raise InputError(
            "no raw log was recognised",
            where=folder,
            expected="Velodyne, ANPP, SBP, RINEX, NMEA, .pos, SBET, point clouds or photographs",
            cure="Look at single files with `thalweg describe FILE`",
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
    from thalweg.ingest.registry import load_recording

    for stream in ("pos", "sbet", "ins", "rover", "depth"):
        for path in files.get(stream, []):
            try:
                recording = load_recording([path], points=False)
            except ThalwegError:  # such as an SBET, whose week is not known yet
                continue
            tables, header = recording.tables, recording.report.details.get("approx_ecef_m")
            if isinstance(header, list) and any(header):  # raw observations: the place in their header
                anywhere = LocalFrame(lat_deg=0.0, lon_deg=0.0, h_ell_m=0.0)
                lat, lon, h = (float(x[0]) for x in anywhere.to_geodetic(anywhere.from_ecef([header])))
                return round(lat, 5), round(lon, 5), round(h)
            table = tables.get("positions", tables.get("states"))
            placed = None if table is None else table.dropna(subset=["lat_deg", "lon_deg"])
            if placed is not None and len(placed):
                lat, lon, h = (float(placed[name].median()) for name in ("lat_deg", "lon_deg", "h_ell_m"))
                return round(lat, 5), round(lon, 5), round(h) if h == h else 0.0
    return None


def _check_config(options: argparse.Namespace) -> int:
    from thalweg.commands import FirstJobs
    from thalweg.settings import load_campaigns
    from thalweg.settings.sections import STREAM_KEYS
    from thalweg.workflow import CampaignFiles

    for name, campaign in load_campaigns(options.files, CAMPAIGNS).items():
        for path in [path for stream in STREAM_KEYS for path in campaign.log_files(stream)]:
            if path.is_symlink() and not path.resolve().is_relative_to(path.parent.resolve()):
                print(f"note: {path} is a link out of its folder, to {path.resolve()}", file=sys.stderr)
        _check_contents(campaign)
        _check_epochs(campaign)
        files = CampaignFiles(name=name, campaigns={name: campaign})
        jobs = FirstJobs(files) if campaign.logs else None
        if jobs and jobs.errors:
            raise ConfigError(
                "what the first jobs would refuse:\n"
                + "\n".join(f"  {each}" for each in jobs.errors).rstrip("."),
                where=name,
            )
        counts = {stream: len(campaign.log_files(stream)) for stream in STREAM_KEYS}
        named = ", ".join(f"{n} {stream}" for stream, n in counts.items() if n)
        source = f"files: {named}" if campaign.logs else "digital twin"
        identity = campaign.campaign
        if campaign.is_change:
            epochs = ", ".join(campaign.epoch_names)
            print(f"{name}: ok. {identity.title}; {identity.crs}; epochs {epochs}")
            continue
        if campaign.logs and campaign.logs.kind != "boat":
            print(f"{name}: ok. {identity.title}; {identity.crs}; {source}")
        else:
            print(
                f"{name}: ok. {identity.title}; {identity.crs}; "
                f"positions from {campaign.orientation.position_source}; {source}"
            )
            print(f"  places of the sensors: {_places(campaign)}")
        if jobs and jobs.skipped:
            print(f"  not checked: {', '.join(jobs.skipped)}")
        for note in jobs.notes if jobs else ():
            print(f"note: {note}", file=sys.stderr)
        products = files.products() if campaign.logs else []
        for made, words in ((True, "gives"), (False, "more logs would add")):
            listed = [f"{p.name}{'' if made else f' ({p.needs})'}" for p in products if p.made is made]
            if listed:
                print(f"  {words}: {', '.join(listed)}")
    return 0


def _places(campaign: "Campaign") -> str:
    """Where the place of each sensor comes from, in words."""
    from thalweg.settings import mount_sources

    by_source: dict[str, list[str]] = {}
    for sensor, source in mount_sources(campaign).items():
        by_source.setdefault(source, []).append(sensor)
    parts = [
        f"{', '.join(sensors)} {f'from {source}' if source else 'not stated, values by default'}"
        for source, sensors in by_source.items()
    ]
    return "; ".join(parts)


def _check_contents(campaign: "Campaign") -> None:
    """Are the logs what the campaign file takes them for? All misplaced files are named at once."""
    from thalweg.ingest.registry import KINDS, KINDS_OF_STREAM, SOURCES_OF_THEIR_OWN, recognise
    from thalweg.settings.sections import STREAM_KEYS

    wrong = []
    for stream, keys in STREAM_KEYS.items():
        # tables that people write, and pictures, have no mark of their own
        for path in campaign.log_files(stream) if stream in KINDS_OF_STREAM else []:
            try:
                kind = recognise(path)
            except InputError as error:
                if KINDS_OF_STREAM[stream]:  # else a kind that has no mark of its own
                    wrong.append(f"  logs.{'.'.join(keys)}: {error}")
                continue
            fitting = KINDS_OF_STREAM["cloud" if campaign.kind == "cloud" else stream]
            source = campaign.orientation.position_source
            if stream == "pos":
                own = SOURCES_OF_THEIR_OWN & {source}
                fitting = tuple(own or (each for each in fitting if each not in SOURCES_OF_THEIR_OWN))
            if fitting and kind not in fitting:
                expected = " or ".join(KINDS[name] for name in fitting)
                wrong.append(f"  logs.{'.'.join(keys)}: {path} holds a {KINDS[kind]}; expected: {expected}.")
    if wrong:
        raise ConfigError(
            "files that are not what they are named for:\n" + "\n".join(wrong),
            where=campaign.id,
            cure="Name each file under its own key; `thalweg describe FILE` says what a file is",
        )


def _check_epochs(campaign: "Campaign") -> None:
    """Do files of epochs hold what the campaign file says? All mistakes are named at once."""
    if not any(epoch.of_files for epoch in campaign.epochs or []):
        return
    from thalweg.core import LocalFrame
    from thalweg.deformation.foreign import check_epoch_files, dsm_of, onto_grid, with_drawn_areas

    wrong = []
    assert campaign.campaign.origin is not None  # epochs have one
    frame = LocalFrame(**campaign.campaign.origin.model_dump())
    for number, epoch in enumerate(campaign.epochs or []):
        try:
            check_epoch_files(epoch, frame, campaign.campaign.crs)
        except ThalwegError as error:
            wrong.append(f"  epochs[{number}]: {error}")
    try:
        with_drawn_areas(campaign.deformation, frame, campaign.campaign.crs)
    except ThalwegError as error:
        wrong.append(f"  deformation.stable: {error}")
    for number, (before, after) in enumerate(pairwise(campaign.epochs or [])):
        if wrong or before.dsm is None or after.dsm is None:
            continue
        try:
            onto_grid(dsm_of(after), dsm_of(before), campaign.deformation.resample)
        except ThalwegError as error:
            wrong.append(f"  epochs[{number + 1}]: {error}")
    if wrong:
        told = "\n".join(wrong).rstrip(".")
        raise ConfigError(f"files of epochs that cannot be used:\n{told}", where=campaign.id)


def _describe(options: argparse.Namespace) -> int:
    from thalweg.ingest.registry import LIDAR_KINDS, describe, recognise

    code = 0
    texts: list[str] = []
    antennas: list[tuple[str, list[float]]] = []
    for path in options.files:
        try:
            report = describe_marked(path)
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


WORTH_OPENING = (
    "index.html",
    "accuracy/index.html",
    "figures/cloud_overview.png",
    "figures/scene_view.png",
    "bathymetry/index.html",
    "calibration/index.html",
    "triangulation/index.html",
    "lidar/by_fused/points.laz",
    "lidar/points.laz",
    "figures/survey_map.png",
    "summary.csv",
)
"""Files of a campaign below its folder, the best first; a run ends with the first five that exist."""


def _summary(options: argparse.Namespace) -> int:
    path = options.folder / "summary.csv"
    if not path.is_file() and any((options.folder / "deformation").glob("volumes_*.csv")):
        return summarise_changes(options.folder)
    if not path.is_file():
        raise InputError(
            "no such file",
            where=path,
            expected="results of a processed campaign",
            cure=f"Run: snakemake --cores all --config campaign={options.folder.name}",
        )
    import pandas as pd

    from thalweg.accuracy import summary_lines

    print(f"\nSummary of campaign {options.folder.name}")
    print("\n".join(summary_lines(pd.read_csv(path))))
    files = [p for p in options.folder.rglob("*") if p.is_file() and "simulation" not in p.parts]
    kinds = {"pictures": {".png", ".pdf"}, "clouds": {".laz"}, "tables": {".csv", ".parquet"}}
    counts = (f"{sum(p.suffix in ends for p in files)} {kind}" for kind, ends in kinds.items())
    print(f"\n{', '.join(counts)} in {options.folder}. Worth opening first:")
    worth = [options.folder / name for name in WORTH_OPENING]
    print("\n".join(f"  {p}" for p in [p for p in worth if p.is_file()][:5]))
    return 0


def _budget(options: argparse.Namespace) -> int:
    from dataclasses import replace

    from thalweg.budgets import long_table, marks_line, read_budget, read_published, text_lines

    budget = read_budget(options.file)
    if options.distances:
        budget = replace(budget, distances_m=options.distances)
    published = read_published(options.published) if options.published else None
    table = long_table(budget, published)
    print("\n".join(text_lines(budget, published)))
    if published is not None and table["verdict"].astype(bool).any():
        print(f"  printed, computed, verdict: {marks_line(table['verdict'])}")
    if options.csv:
        if not options.csv.parent.is_dir():
            raise InputError("no such folder", where=options.csv.parent, cure="Make it, or name another file")
        table.to_csv(options.csv, index=False)
        print(f"Wrote {options.csv}")
    return 0


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
