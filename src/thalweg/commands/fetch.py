"""The command ``thalweg fetch``: public recordings of other people."""

import argparse
import os
from pathlib import Path

from thalweg.commands.parser import Commands


def add_fetch_command(commands: Commands) -> None:
    """Add ``fetch``."""
    commands.add(
        "fetch",
        "download public recordings from their origins; without names, list them",
        _fetch,
        ("names", str, "NAME", "recording, as the list names it", None, {"nargs": "*"}),
        ("--all", bool, None, "every recording of the list"),
        ("--to", Path, "FOLDER", "where to write: a folder for each recording (default: here)", Path()),
    )


def _fetch(options: argparse.Namespace) -> int:
    from thalweg.ingest import fetch_recording, public_recordings, recording_named

    known = public_recordings()
    chosen = [*known.values()] if options.all else [recording_named(each, known) for each in options.names]
    if not chosen:
        for each in known.values():
            print(f"{each.name:33s} {each.size_bytes / 1e3:7,.0f} kB  {each.what} ({each.licence})")
        print("Fetch one with `thalweg fetch NAME`, all of them with `thalweg fetch --all --to FOLDER`.")
    mirror = Path(text) if (text := os.environ.get("THALWEG_DATA")) else None
    for each in chosen:
        folder = fetch_recording(each, options.to, mirror)
        print(f"{folder}: {len(each.files)} files, {each.size_bytes / 1e3:,.0f} kB: {each.what}")
        print(f"    by {each.credit}; licence {each.licence}; {each.page}")
        if each.elsewhere:
            print(f"    not among them: {each.elsewhere}")
    return 0
