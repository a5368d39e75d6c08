"""Are the logs there, are they files with content, and is each named once?"""

import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Final

from thalweg.core import Key, Mistake
from thalweg.settings.messages import anchor, expand, is_pattern, missing_cure, mistake
from thalweg.settings.sections import SHARED_PARTS, Logs

PHOTOGRAPHS: Final = frozenset(
    {
        "time_lapse",
        "run_images",
        "reference_images",
        "position_images",
        "display",
        "grid_images",
        "panel_images",
        "camera_field_images",
        "rig_images",
        "rig_field_images",
    }
)
"""Streams of photographs: a folder of them may be named instead of its files."""

FOLDERS: Final = PHOTOGRAPHS | {"masks", "finished_orientations"}
"""Streams for which a folder may be named."""

IMAGE_ENDINGS: Final = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
"""As `thalweg.ingest.photos.files` knows photographs, which is not imported for a quick check."""

_ONE_RECORDER: Final = frozenset({"lidar", "ins", "positions", "depth", "times"})
"""Streams that one file may hold together: a bag of ROS, the log of an autopilot, NMEA; ``times`` are those
of camera triggers."""
_TRIGGERS: Final = {".bin", ".log", ".tlog"}
"""Endings of the logs of an autopilot, which hold triggers of a camera beside positions."""
_MANY_PARTS: Final = {"control_points", "marks", "orientations"}
"""Keys that may name one file: OpenDroneMap and Metashape write points, marks and poses together."""


def check_files(logs: Logs, folder: Path) -> tuple[list[Mistake], dict[str, tuple[str, ...]]]:
    """Check every path of a campaign.

    Parameters
    ----------
    logs : paths and patterns as written.
    folder : folder of the campaign file.

    Returns
    -------
    mistakes : missing, empty or unreadable files, patterns without match, files named twice.
    files : absolute paths of each stream, patterns replaced by their sorted matches.
    """
    mistakes: list[Mistake] = []
    files: dict[str, tuple[str, ...]] = {}
    first_use: dict[tuple[Path, str], tuple[tuple[Key, ...], str]] = {}
    searched: dict[Path, tuple[Key, ...]] = {}
    for stream, keys in logs.streams().items():
        paths: list[str] = []
        for i, (text, topic) in enumerate(logs.named(stream)):
            where: tuple[Key, ...] = ("logs", *keys, i)
            if (wrong_name := no_path(where, text, folder)) is not None:
                mistakes.append(wrong_name)
                continue
            matches = expand(text, folder)
            if not matches:
                mistakes.append(no_match(where, text, folder))
            for path in matches:
                if (wrong_name := no_path(where, str(path), folder)) is not None:
                    mistakes.append(wrong_name)
                    break
                photographs = stream in PHOTOGRAPHS or (keys[-1] == "images" and keys[0] == "light_sheet")
                if (photographs or stream in FOLDERS) and path.is_dir():
                    mistakes += _check_folder(where, text, path, photographs=photographs)
                    if photographs:
                        searched.setdefault(path.resolve(), where)
                else:
                    wrong = list(check_file(where, text, path))
                    mistakes += wrong
                    if wrong:
                        paths.append(str(path))
                        continue
                mistakes += _check_twice(where, path, topic, first_use)
                paths.append(f"{path}#{topic}" if topic else str(path))
        files[stream] = tuple(paths)
    return [*mistakes, *_check_nested(first_use, searched)], files


def no_path(where: tuple[Key, ...], text: str, folder: Path) -> Mistake | None:
    """The mistake of a path below a folder that no file can have, or in which Snakemake reads wildcards."""
    if "\0" in text:
        cure = "Remove the character \\0 from the path"
        return mistake(where, f"found {text!r}", "a path", cure)
    path = str(anchor(text, folder))
    if found := sorted(set("<>{}") & set(path)):
        return mistake(
            where,
            f"the path {path} holds {' '.join(found)}",
            "names without < > { }, which Snakemake reads as wildcards",
            "Rename the file or folder",
        )
    return None


def no_match(where: tuple[Key, ...], text: str, folder: Path) -> Mistake:
    """The mistake of a pattern that matches no file below a folder."""
    path = anchor(text, folder)
    fixed = path.parent
    while is_pattern(str(fixed)):
        fixed = fixed.parent
    return mistake(
        where, f"{text}: the pattern matches no file", "at least one file", missing_cure(fixed / path.name)
    )


def check_file(where: tuple[Key, ...], text: str, path: Path) -> Iterator[Mistake]:
    """A path, written as ``text``, is a file that can be read and holds something."""
    try:
        if path.is_dir():
            yield mistake(
                where,
                f"{text}: this is a folder",
                "a file",
                f"Name the files in it, for instance with a pattern: {text.rstrip('/')}/*",
            )
        elif path.is_symlink() and not path.exists():
            yield mistake(
                where,
                f"{text}: a link that leads to no file",
                f"a log at {path}",
                "Link it to the log, or copy the log there",
            )
        elif not path.exists():
            yield mistake(where, f"{text}: no such file", f"a log at {path}", missing_cure(path))
        elif not path.is_file():
            yield mistake(
                where,
                f"{text}: this is a pipe or a device",
                "a file",
                "Write what it gives into a file, and name that",
            )
        elif path.stat().st_size == 0:
            yield mistake(
                where,
                f"{text}: the file is empty ({path})",
                "a log with content",
                "Copy the log again, or remove the file from the list",
            )
        else:
            with path.open("rb"):
                pass
    except OSError as error:
        yield mistake(
            where,
            f"{text}: {error.strerror or error} ({path})",
            "a readable file",
            "Check the permissions of the file and of its folder",
        )


def _check_folder(where: tuple[Key, ...], text: str, folder: Path, *, photographs: bool) -> Iterator[Mistake]:
    """A folder is not empty, and one of photographs holds some, in folders below it if not itself."""
    try:
        names = sorted(entry.name for entry in folder.iterdir())
    except OSError as error:
        yield mistake(
            where,
            f"{text}: {error.strerror or error} ({folder})",
            "a readable folder",
            "Check the permissions of the folder",
        )
        return
    if not (any(photographs_in([folder])) if photographs else names):
        what = "no photograph" if photographs else "nothing"
        yield mistake(
            where,
            f"{text}: there is {what} in this folder ({folder})",
            f"files that end in {', '.join(IMAGE_ENDINGS)}" if photographs else "files",
            "Name the folder that holds them, or one above it",
        )


def photographs_in(paths: Iterable[str | Path]) -> Iterator[str]:
    """Names that end like those of photographs, of files and in folders and those below them."""
    for path in map(Path, paths):
        walked = os.walk(path, followlinks=True) if path.is_dir() else [("", [], [path.name])]
        yield from (name for _, _, names in walked for name in names if name.lower().endswith(IMAGE_ENDINGS))


def _check_nested(
    first_use: Mapping[tuple[Path, str], tuple[tuple[Key, ...], str]], folders: Mapping[Path, tuple[Key, ...]]
) -> Iterator[Mistake]:
    """Folders of photographs are searched with those below them, where nothing else may lie but masks."""
    for (path, _), (where, name) in first_use.items():
        over = next((folder for folder in path.parents if folder in folders), None)
        if over is None or "mask" in str(path.relative_to(over)).lower():
            continue
        if not any(photographs_in([path])):
            continue
        before = mistake(folders[over], "").dotted
        yield mistake(
            where,
            f"{name} lies below {over.name} of {before}, whose photographs are searched there too",
            "folders beside each other",
            f"Name the folders in {over.name} that belong to {before}, or move one of the two",
        )


def _check_twice(
    where: tuple[Key, ...],
    path: Path,
    topic: str,
    first_use: dict[tuple[Path, str], tuple[tuple[Key, ...], str]],
) -> Iterator[Mistake]:
    real = path.resolve(), topic
    if real not in first_use:
        first_use[real] = (where, path.name)
        return
    other, _ = first_use[real]
    if other[:2] == where[:2] == ("logs", "time_lapse") and {other[2], where[2]} <= _MANY_PARTS:
        return
    if other[:3] == where[:3] == ("logs", "time_lapse", "interiors"):
        return
    one, two = (keys[2] if keys[1:3] == ("time_lapse", "times") else keys[1] for keys in (other, where))
    shared = {one, two} <= _ONE_RECORDER and ("times" not in (one, two) or path.suffix.lower() in _TRIGGERS)
    if other[0] == where[0] == "logs" and one != two and shared:
        return
    if other[:3] == where[:3] == ("logs", "light_sheet", "scans") and {other[4], where[4]} <= SHARED_PARTS:
        return
    before = mistake(other, "").dotted
    same_stream = other[:-1] == where[:-1]
    if {other[2:3], where[2:3]} <= {("rover",), ("base",), ("nav",)} and not same_stream:
        key = str(where[2])
        cure = (
            f"Remove it from {key}: an empty {key} means that the rover's SBP log carries "
            f"{'the corrections of the base' if key == 'base' else 'the ephemerides'}"
        )
    elif same_stream:
        cure = "Remove one of them: each record would be read twice"
    else:
        cure = "One file is one stream: remove it where it does not belong"
    yield mistake(where, f"{path.name} is already named at {before}", "each file once", cure)
