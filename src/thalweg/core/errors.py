"""What Thalweg shows to people: errors, and how far a long step is.

The message of an error answers four questions in the same order: where, what was found, what was expected,
what to do about it.
"""

import errno
import logging
import os
import re
import stat
import time
from collections.abc import Iterable, Iterator, Mapping, Sized
from pathlib import Path
from typing import Final, TypeVar

# ---------------------------------------------------------------- how far a long step is

T = TypeVar("T")
EVERY_S: Final = 5.0
"""People look up after some seconds; a log of an hour stays below a thousand lines."""
log = logging.getLogger(__name__)


def steps(items: Iterable[T], what: str) -> Iterator[T]:
    """The items one by one, with a message every 5 seconds; none where all of them take less.

    Jobs write the message to their log, where `make demo` reads it, and commands to the terminal.

    Parameters
    ----------
    items : what a loop works on.
    what : in plain words and the singular, such as ``image``.
    """
    of = f" of {len(items)}" if isinstance(items, Sized) else ""
    last_s = time.monotonic()
    for k, item in enumerate(items):
        if time.monotonic() - last_s > EVERY_S:
            last_s = time.monotonic()
            log.info("%s %d%s", what, k + 1, of)
        yield item


def to_terminal() -> None:
    """Show the messages of `steps` on a terminal, each in the place of the one before."""
    handler = logging.StreamHandler()
    handler.terminator = "\r"
    handler.setFormatter(logging.Formatter("  %(message)s\033[K"))
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    log.propagate = False


# ---------------------------------------------------------------- errors

FULL: Final = frozenset({errno.ENOSPC, errno.EDQUOT})
"""What the system says of a disk without room."""


_UNBROKEN: Final = re.compile(r"(\S{150})\S{150,}")
"""Of a file that is damaged, a message may quote a word of thousands of letters: its beginning is enough."""


class ThalwegError(Exception):
    """Base of all errors raised on purpose; its text is meant to be read by a user.

    Parameters
    ----------
    found : what is wrong, with the value that was met.
    expected : what would have been right.
    where : file, and inside it the packet, line or byte offset.
    cure : what the user can do.
    """

    def __init__(self, found: str, *, expected: str = "", where: str | Path = "", cure: str = "") -> None:
        self.found, self.expected = (_UNBROKEN.sub(r"\1...", each) for each in (found, expected))
        found, expected = self.found, self.expected
        self.where = str(where)
        self.cure = cure
        text = f"{self.where}: {found}" if self.where else found
        if expected:
            text += f"; expected {expected}"
        text += "."
        if cure:
            text += f" {cure}" if cure.endswith("?") else f" {cure.rstrip('.')}."
        super().__init__(text)


class InputError(ThalwegError):
    """A file or table cannot be used: missing, empty, of another format, or damaged beyond reading."""


class UnsupportedError(InputError):
    """A file is valid, but of an instrument model or variant that is not implemented."""


class ClockError(ThalwegError):
    """A stream cannot be put on the GPS time axis."""


class GeometryError(ThalwegError):
    """A frame, pose or coordinate operation is undefined or would lose accuracy."""


class ConfigError(ThalwegError):
    """The campaign file is wrong; the message lists every mistake with its path and cure."""


class CoverageError(ThalwegError):
    """Data are asked for outside the time span or area in which they exist."""


def others_may_write(folder: Path) -> bool:
    """Whether another user may put something into a folder, which would be believed or run as one's own.

    Of a folder that is not there yet the next one above it is asked: where that has the sticky bit, as
    ``/tmp`` has it, nobody can take away what one makes there. A group of the user alone counts as the user,
    and so does the super-user. False where systems know no owners.
    """
    if not hasattr(os, "getuid"):
        return False
    import grp
    import pwd

    folder = folder.absolute()
    place = next(each for each in (folder, *folder.parents) if each.exists())
    found = place.stat()
    shared = found.st_mode & stat.S_IWOTH
    try:
        own_group = grp.getgrgid(found.st_gid).gr_name == pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # numbers without names, as in a container
        own_group = False
    if found.st_mode & stat.S_IWGRP and not own_group:
        shared = True
    if place != folder:
        return bool(shared) and not found.st_mode & stat.S_ISVTX
    return bool(shared) or found.st_uid not in (0, os.getuid())


def require_file(path: Path, expected: str) -> None:
    """Refuse a path where no file stands, or an empty one.

    Parameters
    ----------
    expected : what the file should be, such as "a RINEX file".

    Raises
    ------
    InputError : missing, a folder, a pipe or device, or empty.
    """
    found, cure = "the file is empty", "Copy or export it again"
    if not path.exists():
        found, cure = "file not found", "Check the path"
    elif not path.is_file():
        found = "this is a folder" if path.is_dir() else "this is a pipe or a device"
        cure = "Name a file"
    elif path.stat().st_size:
        return
    raise InputError(found, expected=expected, where=path, cure=cure)


def in_options(text: str, options: Mapping[str, str]) -> str:
    """A message of a command, whose reader has no campaign: with options in the place of settings.

    Parameters
    ----------
    text : names settings of campaigns, such as ``reference.cell_m``.
    options : the option of the command that stands for a setting, by the name of the setting; or words, by
        those in whose place they stand.
    """
    for setting, option in options.items():
        whole = (r"(?<![\w.])", r"(?!\w|\.\w)") if re.fullmatch(r"[\w.]+", setting) else ("", "")
        text = re.sub(re.escape(setting).join(whole), option, text)
    return text


def file_trouble(error: OSError) -> str:
    """What the system says of a file, with the file and what to do, as a sentence for people."""
    cure = (
        "Make room there, or write to another disk"
        if error.errno in FULL
        else "Check the path and its permissions"
    )
    return f"{error.filename or 'a file'}: {error.strerror or error}. {cure}."
