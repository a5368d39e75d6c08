"""One job at a time writes a set of outputs, on whatever computer it runs.

A driver that is killed leaves its jobs running, on a cluster as on a laptop, and the next one starts the same
jobs again. A job therefore claims its outputs by a folder with a file in it whose name says which process it
is. As long as that process lives, another job with the same outputs waits.

Whether a process of this computer lives is asked of the system. Of another computer it is told by the age of
the claim, which its owner renews; both times are those of the shared file system, so that clocks of computers
that differ do no harm.

Each step is one renaming, which the file system does as a whole for one process and refuses to the others: a
folder with the claim in it gets its name, which fails where one is; and the file of a dead process gets the
name of the one that takes over, which fails once another has done so.
"""

import hashlib
import json
import os
import secrets
import shutil
import socket
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, Self

from thalweg.core import InputError

CLAIM: Final = "claim"
RENEWED_EVERY_S: Final = 10.0
STALE_AFTER_S: Final = 120.0
"""A process may be stopped, or a file system slow, for so long before its claim counts as left behind."""


@dataclass(frozen=True, slots=True)
class Owner:
    """A process that writes outputs; ``job`` is its number on a cluster, or empty."""

    rule: str
    host: str
    process: int
    job: str
    since_utc: str

    @classmethod
    def here(cls, rule: str) -> Self:
        """The process that asks."""
        return cls(
            rule=rule,
            host=socket.gethostname(),
            process=os.getpid(),
            job=os.environ.get("SLURM_JOB_ID", ""),
            since_utc=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        )

    def __str__(self) -> str:
        job = f", job {self.job} of the cluster" if self.job else ""
        return f"process {self.process} on {self.host}{job}, since {self.since_utc}"


UNKNOWN: Final = Owner("", "another computer", 0, "", "a moment ago")


class Claim:
    """The folder by which outputs are claimed, renewed until it is given up.

    Parameters
    ----------
    folder : it stands for the outputs; any process that writes them names the same one.
    rule : name of the rule.
    """

    def __init__(self, folder: Path, rule: str) -> None:
        self.folder, self.owner = folder, Owner.here(rule)
        self.file = folder / claim_name(os.getpid())
        self._given_up = threading.Event()

    def take(self) -> Owner | None:
        """Claim the outputs, or say who has them. What a dead process left in the folder is removed.

        Raises
        ------
        OSError : the folder cannot be made.
        """
        self.folder.parent.mkdir(parents=True, exist_ok=True)
        made = self.folder.with_name(f"{self.folder.name}-{self.file.name}")
        made.mkdir()
        try:
            self._write(made / self.file.name)
            while True:
                try:
                    made.rename(self.folder)
                    break
                except OSError:
                    if not self.folder.is_dir():
                        raise
                if (claimed := claim_of(self.folder)) is None:
                    continue  # given up a moment ago
                owner = owner_of(claimed)
                if owner is not None:
                    return owner
                if self._take_over(claimed):
                    break
        finally:
            shutil.rmtree(made, ignore_errors=True)
        for left in self.folder.parent.glob(f"{self.folder.name}-{CLAIM}-*"):  # on its way in, or out
            if not _lives(left.name.removeprefix(f"{self.folder.name}-"), left):
                shutil.rmtree(left, ignore_errors=True)
        threading.Thread(target=self._renew, daemon=True).start()
        return None

    def _take_over(self, claimed: Path) -> bool:
        try:
            os.utime(claimed)
            claimed.rename(self.file)
        except FileNotFoundError:  # another was faster
            return False
        self._write(self.file)
        for each in self.folder.iterdir():
            if each != self.file:
                shutil.rmtree(each) if each.is_dir() and not each.is_symlink() else each.unlink()
        return True

    def _write(self, file: Path) -> None:
        new = file.with_name("new")
        new.write_text(json.dumps(asdict(self.owner)) + "\n", encoding="utf-8")
        new.replace(file)

    def _renew(self) -> None:
        while not self._given_up.wait(RENEWED_EVERY_S):
            try:
                os.utime(self.file)
            except OSError:  # a full or absent file system speaks up where outputs are written
                continue

    def check(self) -> None:
        """Refuse to go on after another process took the outputs over.

        Raises
        ------
        InputError : it did, because this computer did not answer for minutes.
        """
        if not self.file.exists():
            claimed = claim_of(self.folder)
            raise InputError(
                f"{(claimed and owner_of(claimed)) or UNKNOWN} writes the same outputs by now",
                expected=f"a claim that is renewed every {RENEWED_EVERY_S:.0f} s; after {STALE_AFTER_S:.0f} s"
                " without it counts as left behind",
                where=f"rule {self.owner.rule}, {self.file}",
                cure="Let that job finish: its results are whole. Was this one suspended, or the disk away?",
            )

    def give_up(self) -> None:
        """Remove the folder with all that is in it, if it is still the own one."""
        self._given_up.set()
        grave = self.folder.with_name(f"{self.folder.name}-{self.file.name}")
        if self.file.exists():
            self.folder.rename(grave)
            shutil.rmtree(grave, ignore_errors=True)


def claim_name(process: int) -> str:
    """Name of the claim of a process of this computer: place, number, start, and a number of its own."""
    return f"{CLAIM}-{_place()}-{process}-{_started(process)}-{secrets.token_hex(4)}"


def claim_of(folder: Path) -> Path | None:
    """The file that claims a folder; None if there is none."""
    return next(folder.glob(f"{CLAIM}-*"), None)


def owner_of(claimed: Path) -> Owner | None:
    """The process that lives and made or took this claim; None if it has died or given it up."""
    try:
        lives = _lives(claimed.name, claimed)
        return Owner(**json.loads(claimed.read_text(encoding="utf-8"))) if lives else None
    except FileNotFoundError:
        return None
    except (ValueError, TypeError):
        return UNKNOWN


def _lives(name: str, path: Path) -> bool:
    """Whether the process that a claim names lives; of another computer: whether it was renewed lately."""
    _, place, process, started, _ = name.split("-")
    if place == _place():
        return _started(int(process)) == started
    return _age_s(path) < STALE_AFTER_S


def _age_s(path: Path) -> float:
    """Seconds since a change, by the clock of the file system that holds it."""
    probe = path.parent / f".clock-{socket.gethostname()}-{os.getpid()}"
    probe.touch()
    try:
        return probe.stat().st_mtime - path.stat().st_mtime
    finally:
        probe.unlink(missing_ok=True)


def _place() -> str:
    """Host, start of its system and space of process numbers: where a process number means one process."""
    parts = [socket.gethostname()]
    boot, processes = Path("/proc/sys/kernel/random/boot_id"), Path("/proc/self/ns/pid")
    if boot.exists():
        parts.append(boot.read_text(encoding="utf-8"))
    if processes.is_symlink():
        parts.append(str(processes.readlink()))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:12]


def _started(process: int) -> str | None:
    """When a process of this computer was started, in its own units; None if it has ended."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except FileNotFoundError:
        if Path("/proc/self").exists():
            return None
        try:  # no /proc, as on macOS
            os.kill(process, 0)
        except ProcessLookupError:
            return None
        except PermissionError:  # it runs, for another user
            return "running"
        return "running"
    return None if fields[0] in "ZX" else fields[19]
