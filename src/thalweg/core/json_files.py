"""JSON files between jobs that say what they are: ``kind`` and ``version`` beside their content."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from thalweg.core.errors import InputError


def write_marked(path: Path, *, kind: str, version: int, content: Mapping[str, Any]) -> None:
    """Write content behind its kind and version; the folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    facts = {"kind": kind, "version": version, **content}
    path.write_text(json.dumps(facts, indent=2) + "\n")


def read_marked(path: Path, key: str, *, kind: str, version: int, what: str, cure: str) -> dict[str, Any]:
    """One mapping of a file that `write_marked` wrote.

    Parameters
    ----------
    path : the file.
    key : name of the mapping in it.
    kind, version : what the file must be.
    what : in words, for messages: "mounts of a campaign".
    cure : how to make the file.

    Raises
    ------
    InputError : the file is missing, no such JSON, or of another kind or version.
    """
    if not path.is_file():
        raise InputError("file not found", expected=what, where=path, cure=cure)
    expected = f"{kind}, version {version}"
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
        found, content = (facts["kind"], facts["version"]), dict(facts[key])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"no {what} ({error!r})", expected=expected, where=path, cure=cure) from error
    if found != (kind, version):
        raise InputError(f"{found[0]}, version {found[1]}", expected=expected, where=path, cure=cure)
    return content
