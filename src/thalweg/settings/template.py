"""A new campaign file with comments, from nothing or from a folder of logs."""

import glob
import os
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Final

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

_SURVEYED: Final = "surveyed points; role check: judges, takes no part"
_OF_A_BOAT: Final = ("lidar", "ins", "rover", "base", "pos", "sbet", "depth")
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
    place = origin or (51.05, 13.25, 300.0)
    listed = {k: list(v) for k, v in PLACEHOLDERS.items()}
    if files is not None:
        listed = {k: _listed(v, folder) for k, v in files.items()}
    for stream, meant in (topics or {}).items():
        listed[stream] = [f"{text}#{topic}" for text in listed[stream] for topic in meant]
    source = _source(listed)
    return _written(
        name,
        schema,
        kind=_kind(listed) if files is not None else "boat",
        logs=listed,
        spacing_m=spacing_m,
        usual_edge_m=ReferenceSettings().longest_edge_m,
        surveyed=_SURVEYED,
        origin=origin,
        place=place,
        crs=utm_code(*place[:2]),
        source=source,
        in_real_time=source == "pos" and not all(text.endswith(".pos") for text in listed.get("pos", [])),
        remarks=remarks,
    )


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
    return _written(
        name,
        schema,
        kind="epochs",
        crs=crs,
        origin=origin,
        epochs=[each if isinstance(each, str) else (_surface(each[0], folder), each[1]) for each in epochs],
        spacing_m=spacing_m,
        # four spacings where points lie farther apart than a boat's
        cell_m=float(f"{max(4.0 * (spacing_m or 0.0), 0.5):.2g}"),
    )


def _written(name: str, schema: str, *, logs: Mapping[str, Sequence[str]] | None = None, **facts: Any) -> str:
    """The template ``new_campaign.yaml.j2`` with these facts."""
    from jinja2 import Environment

    listed = logs or {}

    def files(key: str, stream: str, meaning: str, indent: int = 2, *, one: bool = False) -> str:
        """The lines of a key with the files of a stream, or how to write them where there are none."""
        paths = [_quoted(path) for path in listed.get(stream, [])]
        if one and len(paths) > 1:
            meaning = f"{meaning}; CHANGE: keep one of {len(paths)}"
        first = f"{key}: [{paths[0]}]" if len(paths) == 1 else f"{key}:" if paths else f"# {key}: []"
        lines = [f"{first}  # {meaning}", *(f"  - {path}" for path in paths if len(paths) > 1)]
        return "\n".join(" " * indent + line for line in lines)

    text = Path(__file__).with_name("new_campaign.yaml.j2").read_text(encoding="utf-8")
    made = Environment(trim_blocks=True, keep_trailing_newline=True).from_string(text)
    return made.render(name=name, schema=schema, logs=listed, files=files, **facts)


def _surface(path: Path, folder: Path) -> str:
    """The file of an epoch under its key."""
    text = _relative(path, folder)
    return f"dsm: {text}" if path.suffix.lower() in DSM_ENDINGS else f"clouds: [{text}]"


def _kind(listed: Mapping[str, Sequence[str]]) -> str:
    """What was surveyed, by the logs that are there."""
    if listed.get("fixed_marks"):
        return "fixed_camera"
    if listed.get("cloud"):
        return "cloud"
    moved = any(listed.get(stream) for stream in _OF_A_BOAT)
    return "photographs" if listed.get("time_lapse") and not moved else "boat"


def _source(listed: Mapping[str, Sequence[str]]) -> str:
    """Best source of positions for these logs."""
    found = {"ins": "ins", "nmea": "depth"}
    logged = [source for source, stream in found.items() if listed.get(stream)]
    return next(iter(position_sources(listed) or logged), "pos")


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
