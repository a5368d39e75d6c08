"""Outputs of a job: whole under their final names, or not there at all.

The job writes into a folder ``.part-...`` inside the folder where an output will stand, on the same file
system, under the output's own name. When all are written they are brought to the disk, those of an earlier
run are taken away, and each new one is renamed. Whatever ends a job before that leaves nothing under a final
name; what ends it between two renamings leaves outputs that are missing, never a mixture of two runs.
"""

import errno
import hashlib
import logging
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

from thalweg.core import UNFINISHED, InputError, ThalwegError

log = logging.getLogger("thalweg")

FULL_BELOW_BYTES: Final = 1 << 20
"""With less free than this any failure to write is told as a full disk: libraries say it in many ways."""
_SYNCED_AT_ONCE: Final = 16
"""Files brought to the disk together share one entry in the journal of the file system: ten times as fast."""
_DISK: Final = {
    errno.ENOSPC: ("no space is left on the disk", "Make room there"),
    errno.EDQUOT: ("the quota of the disk is used up", "Make room there, or ask for a larger quota"),
    errno.EROFS: (
        "the disk can only be read",
        "Mount it for writing, or work in another folder (--directory)",
    ),
    errno.EACCES: ("access is not permitted", "Change the rights or the owner"),
    errno.EPERM: ("access is not permitted", "Change the rights or the owner"),
    errno.EIO: ("the disk answers with an error", "Look at the disk and the network, and"),
}


class Staging:
    """Where the outputs of one job are until they are whole.

    Parameters
    ----------
    outputs : files and folders that the job makes.
    rule : name of its rule.
    """

    def __init__(self, outputs: Iterable[Path], rule: str) -> None:
        self.outputs, self.rule = list(outputs), rule
        key = hashlib.sha256("\n".join(str(each) for each in self.outputs).encode()).hexdigest()[:12]
        self.name = f"{UNFINISHED}{key}"
        self._folders = _tops(self.outputs)

    def path(self, text: str) -> str:
        """Where an output, or a folder that holds some, is until the job is done; other texts as they are."""
        path = Path(text)
        if path in self.outputs or path in {each.parent for each in self.outputs}:
            for top in self._folders:
                if path.is_relative_to(top):
                    return str(top / self.name / path.relative_to(top))
        return text

    def begin(self) -> None:
        """Make the folders, without what an earlier job left in them."""
        self.end()
        for lies in self.places().values():
            lies.parent.mkdir(parents=True, exist_ok=True)

    def job(self, job: Any) -> Any:
        """A job of Snakemake with the places where its outputs are until they are whole."""
        return mapped(job, self.path, ("output", "params"))

    def places(self) -> dict[Path, Path]:
        """Final names of the outputs, and where they lie now."""
        return {output: Path(self.path(str(output))) for output in self.outputs}

    def absent(self) -> list[str]:
        """Outputs that have not been written."""
        return [str(output) for output, lies in self.places().items() if not lies.exists()]

    def commit(self, beside: Sequence[str] = ()) -> None:
        """Bring all outputs to the disk and give them their names.

        Parameters
        ----------
        beside : endings of files that lie beside each output and come with it.
        """
        pairs = [
            (lies.with_name(lies.name + ending), output.with_name(output.name + ending))
            for output, lies in self.places().items()
            for ending in (*beside, "")
        ]
        _sync([staged for staged, _ in pairs])
        for k, (staged, output) in enumerate(pairs):
            output.parent.mkdir(parents=True, exist_ok=True)
            if os.path.lexists(output):
                output.rename(staged.with_name(f"{UNFINISHED}before-{k}"))
        for staged, output in pairs:
            staged.rename(output)
        _sync_each(list(dict.fromkeys(output.parent for _, output in pairs)))
        if undeclared := self._others():
            log.warning("not declared as outputs, and removed: %s", ", ".join(undeclared))

    def _others(self) -> list[str]:
        """What was written beside the outputs: left by libraries, or a result that the rule does not name."""
        old = f"{UNFINISHED}before-"
        return [
            path.relative_to(top / self.name).as_posix()
            for top in self._folders
            for path in sorted((top / self.name).rglob("*"))
            if path.is_file() and old not in path.as_posix()
        ]

    def end(self) -> None:
        """Remove what is left of the folders."""
        for each in self._folders:
            shutil.rmtree(each / self.name, ignore_errors=True)


@contextmanager
def staged(outputs: Iterable[Path], rule: str) -> Iterator[Staging]:
    """Folders for the outputs of a job within the block, and clean up afterwards.

    Parameters
    ----------
    outputs : files and folders that the job makes.
    rule : name of its rule.

    Yields
    ------
    Staging
        Begun.

    Raises
    ------
    InputError : the disk is full, can only be read, or is lost; with its free space and a cure.
    """
    staging = Staging(outputs, rule)
    with disk_in_words(staging.outputs, rule):
        staging.begin()
        try:
            with disk_in_words(staging.outputs, rule):  # before there is room again
                yield staging
        finally:
            staging.end()


@contextmanager
def disk_in_words(outputs: Sequence[Path], rule: str) -> Iterator[None]:
    """Turn failures of the disk within the block into messages with cause and cure."""
    try:
        yield
    except ThalwegError:
        raise
    except Exception as error:
        folder = next((each for each in (outputs[0].parents if outputs else ()) if each.exists()), Path())
        free = shutil.disk_usage(folder).free
        number = error.errno if isinstance(error, OSError) else None
        if number not in _DISK and free < FULL_BELOW_BYTES:
            number = errno.ENOSPC
        if number not in _DISK:
            raise
        found, cure = _DISK[number]
        if isinstance(error, OSError) and error.filename and number in (errno.EACCES, errno.EPERM):
            folder = Path(str(error.filename))
        raise InputError(
            f"{found} ({error})",
            expected=f"to write the outputs; {free / 1e6:.0f} MB are free",
            where=f"rule {rule}, {folder.absolute()}",
            cure=f"{cure}, then start again: finished results remain, and nothing half-written is left",
        ) from error


SCRATCH: Final = "THALWEG_STORAGE"
"""Variable of the environment with the folder of node-local copies, if a run has one (profiles/storage)."""


def use_scratch(folder: Path) -> None:
    """State for this process and its jobs where the copies lie that Snakemake makes of their inputs."""
    os.environ[SCRATCH] = str(folder.absolute())


def work_in_scratch(job: Any) -> tuple[Any, Path | None]:
    """Go to the folder of node-local copies, where files have the names that they have in the run's.

    So parameters and reports that name files are the same.

    Parameters
    ----------
    job : of Snakemake.

    Returns
    -------
    job
        With names relative to that folder.
    Path or None
        The folder of the run, to which results come later; None where jobs work in it.
    """
    scratch, results = Path(os.environ.get(SCRATCH, "")).absolute(), Path.cwd()
    if not os.environ.get(SCRATCH) or not any(Path(each).is_relative_to(scratch) for each in job.output):
        return job, None

    def below(name: str) -> str:
        """Its name below the scratch folder, where it lies there."""
        path = Path(name).absolute()
        return str(path.relative_to(scratch) if path.is_relative_to(scratch) else path)

    os.chdir(scratch)
    return mapped(job, below, ("input", "output", "log")), results


def mapped(job: Any, rename: Callable[[str], str], parts: Sequence[str]) -> Any:
    """A job of Snakemake whose texts in these parts are renamed; they keep the names that rules give them."""
    found = SimpleNamespace(
        **{name: getattr(job, name) for name in ("rule", "threads", "input", "output", "params", "log")},
        resources=getattr(job, "resources", None),
    )

    def renamed(value: Any) -> Any:
        """A text by its new name; other values as they are."""
        return rename(value) if isinstance(value, str) else value

    for name in parts:
        part = getattr(job, name)
        setattr(found, name, type(part)(toclone=part, custom_map=renamed))
    return found


def state_of(paths: Iterable[Path]) -> dict[str, tuple[int, int]]:
    """Size and time of change of each file, and of each in a folder; what is not there is left out."""
    found: dict[str, tuple[int, int]] = {}
    for path in paths:
        members = [p for p in path.rglob("*") if p.is_file()] if path.is_dir() else [path]
        for member in members:
            try:
                seen = member.stat()
            except FileNotFoundError:
                continue
            found[str(member)] = (seen.st_size, seen.st_mtime_ns)
    return found


def refuse_changes(before: dict[str, tuple[int, int]], inputs: Iterable[Path], rule: str) -> None:
    """Refuse to keep results of inputs that were changed while the job ran.

    Raises
    ------
    InputError : files that were written, added or removed since ``before`` was taken.
    """
    after = state_of(inputs)
    changed = sorted(name for name in {*before, *after} if before.get(name) != after.get(name))
    if changed:
        raise InputError(
            f"{len(changed)} of the inputs changed while the job ran: {', '.join(changed[:3])}",
            expected="inputs that stay as they are until the results are written",
            where=f"rule {rule}",
            cure="Let whatever writes them finish, then start again; nothing of this job was kept",
        )


def _tops(outputs: Iterable[Path]) -> list[Path]:
    """Folders of outputs, without those that lie inside another one."""
    folders = list(dict.fromkeys(each.parent for each in outputs))
    return [each for each in folders if not any(each != o and each.is_relative_to(o) for o in folders)]


def _sync(paths: Iterable[Path]) -> None:
    """Bring files, and folders with all that is in them, to the disk."""
    every: list[Path] = []
    for path in paths:
        every += [path, *path.rglob("*")] if path.is_dir() else [path]
    _sync_each(every)


def _sync_each(paths: Sequence[Path]) -> None:
    def sync(path: Path) -> None:
        """Wait until a file or folder is on the disk."""
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # no fsync of folders on some file systems
                raise
        finally:
            os.close(handle)

    with ThreadPoolExecutor(_SYNCED_AT_ONCE) as pool:
        list(pool.map(sync, paths))
