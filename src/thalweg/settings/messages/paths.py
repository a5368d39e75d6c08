"""Paths of raw logs: home folder, patterns, and the nearest name where a file is missing."""

import difflib
import glob
import os
import re
from pathlib import Path

_MAGIC = set("*?[")


def is_pattern(text: str) -> bool:
    """True if the text holds a glob pattern."""
    return bool(_MAGIC & set(text))


def anchor(text: str, folder: Path) -> Path:
    """Absolute path of a text in a campaign file: ``~`` expanded, relative to ``folder``."""
    return Path(os.path.normpath(folder.absolute() / os.path.expanduser(text)))  # noqa: PTH111 - unknown ~user stays


def expand(text: str, folder: Path) -> list[Path]:
    """Files that a path or a pattern names, in `natural_order`; empty if a pattern matches none.

    An existing file whose name holds pattern characters is taken as it is.
    """
    path = anchor(text, folder)
    if not is_pattern(text) or path.exists():
        return [path]
    matches = (Path(m) for m in glob.glob(str(path), recursive=True))  # noqa: PTH207 - absolute patterns
    return sorted((m for m in matches if m.is_file()), key=natural_order)


def natural_order(path: Path) -> tuple[tuple[tuple[str | int, ...], ...], tuple[str, ...]]:
    """Sort key of paths, folder by folder, in which numbers count by value: part_2 before part_10.

    Names that differ in leading zeros only are told apart by their text.

    Examples
    --------
    >>> [p.name for p in sorted(map(Path, ["part_10.pcap", "part_2.pcap", "part.pcap"]), key=natural_order)]
    ['part.pcap', 'part_2.pcap', 'part_10.pcap']
    """
    # the pieces are text, number, text, ... in turn, so that like is compared with like
    pieces = (re.split(r"(\d+)", part) for part in path.parts)
    return tuple(tuple(int(t) if k % 2 else t for k, t in enumerate(p)) for p in pieces), path.parts


def nearest_names(path: Path) -> list[str]:
    """Names in the folder of a missing file that resemble it, best first."""
    if not path.parent.is_dir():
        return []
    try:
        names = sorted(entry.name for entry in path.parent.iterdir())
    except OSError:
        return []
    by_lower = {name.lower(): name for name in names}
    close = difflib.get_close_matches(path.name.lower(), list(by_lower), n=3, cutoff=0.6)
    return [by_lower[name] for name in close]


def missing_cure(path: Path) -> str:
    """What to do about a missing file: the nearest name, or the first folder that does not exist."""
    names = nearest_names(path)
    if names:
        return f"Did you mean {names[0]} in {path.parent}?"
    folder = path.parent
    if folder.is_dir():
        return f"The folder {folder} exists; it holds {_count(folder)}"
    while not folder.parent.is_dir() and folder != folder.parent:
        folder = folder.parent
    near = nearest_names(folder)
    hint = f" Did you mean {folder.parent / near[0]}?" if near else ""
    return f"There is no folder {folder}.{hint} Paths are relative to the campaign file"


def _count(folder: Path) -> str:
    names = sorted(entry.name for entry in folder.iterdir() if entry.is_file())
    if not names:
        return "no files"
    return f"{', '.join(names[:4])}{' …' if len(names) > 4 else ''}"
