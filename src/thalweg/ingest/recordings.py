"""Recordings of other people: fetched from their public origins, checked, never part of Thalweg."""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple
from urllib.parse import urljoin

from thalweg.core import InputError, did_you_mean, read_yaml, steps

REGISTRY: Final = Path(__file__).with_name("recordings.yaml")
"""What there is to fetch; its first lines say what stands in it."""
PATIENCE_S: Final = 30.0
"""Silence of a server that is waited for."""


class PublicFile(NamedTuple):
    """A file at its origin."""

    size_bytes: int
    sha256: str
    address: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PublicRecording:
    """Files of one recording, whose they are, and what may be done with them."""

    name: str
    """Also of the folder that it is written to."""
    what: str
    licence: str
    credit: str
    page: str
    files: Mapping[str, PublicFile]
    """By their paths in the folder."""
    unpack: bool = False
    """Archives among the files are unpacked beside them."""
    elsewhere: str = ""
    """What tests use beside these files, and where it is from."""

    @property
    def size_bytes(self) -> int:
        """Of all files."""
        return sum(file.size_bytes for file in self.files.values())


def public_recordings(registry: Path = REGISTRY) -> dict[str, PublicRecording]:
    """What can be fetched, by name.

    Parameters
    ----------
    registry : in the form of ``recordings.yaml`` beside this module.
    """
    found = {}
    for name, row in read_yaml(registry).data.items():
        base, files = row.pop("from"), {}
        for path, text in row.pop("files").items():
            size, sha256, *other = text.split()
            files[path] = PublicFile(int(size), sha256, urljoin(base, (other or [path])[0]))
        found[name] = PublicRecording(name=name, files=files, **row)
    return found


def recording_named(name: str, known: Mapping[str, PublicRecording]) -> PublicRecording:
    """A recording by its name, or by the last part of it.

    Raises
    ------
    InputError : there is none.
    """
    short = {each.rsplit("/", 1)[-1]: recording for each, recording in known.items()}
    if found := known.get(name) or short.get(name):
        return found
    raise InputError(
        f"no recording {name!r}", expected="one that `thalweg fetch` lists", cure=did_you_mean(name, short)
    )


def fetch_recording(recording: PublicRecording, folder: Path, mirror: Path | None = None) -> Path:
    """Bring the files of a recording that are not there yet; each is either whole or absent.

    Parameters
    ----------
    recording : of `public_recordings`.
    folder : a folder of the recording's name is made in it.
    mirror : folder of recordings; a file that stands there is copied, others are downloaded.

    Returns
    -------
    Path
        The recording's folder.

    Raises
    ------
    InputError : no network, no such address, no room, or a file whose checksum is not that of the registry.
    OSError : files cannot be written.
    """
    import pooch

    target = folder / recording.name
    lacking = {}
    for path, file in recording.files.items():
        if not (target / path).exists():
            lacking[path] = file
        elif pooch.file_hash(target / path) != file.sha256:
            raise InputError(
                "this is another file than the recording's",
                expected=f"SHA-256 {file.sha256[:12]}...",
                where=target / path,
                cure="Move it away, and fetch again",
            )
    _check_room(sum(file.size_bytes for file in lacking.values()), target)
    pooch.get_logger().setLevel("WARNING")
    origin = pooch.create(
        path=target,
        base_url="",
        registry={path: f"sha256:{file.sha256}" for path, file in lacking.items()},
        urls={path: file.address for path, file in lacking.items()},
    )
    for path, file in steps(lacking.items(), f"file of {recording.name}"):
        copy = mirror / recording.name / path if mirror else None
        if copy and not copy.is_file():
            copy = None
        try:
            origin.fetch(
                path, downloader=_copying(copy) if copy else pooch.HTTPDownloader(timeout=PATIENCE_S)
            )
        except ValueError as error:  # so pooch says that a checksum is wrong
            raise InputError(
                "this is another file than the recording's: the checksum differs",
                expected=f"{file.size_bytes} bytes, SHA-256 {file.sha256[:12]}...",
                where=copy or file.address,
                cure="Take it out of the folder THALWEG_DATA"
                if copy
                else "Fetch again; a page of a proxy may have come in its place",
            ) from error
        except OSError as error:
            if error.errno is not None:  # of the disk; those of requests have none
                raise
            status = getattr(getattr(error, "response", None), "status_code", None)
            raise InputError(
                f"could not be downloaded ({f'status {status}' if status else type(error).__name__})",
                expected=f"{file.size_bytes} bytes",
                where=file.address,
                cure=f"See whether {recording.page} still has it"
                if status
                else "Fetch again; where there is no network, set THALWEG_DATA to a folder "
                "that `thalweg fetch --all --to FOLDER` has filled on another machine",
            ) from error
    if recording.unpack:
        for path in recording.files:
            if path.endswith((".zip", ".tar.gz", ".tgz")):
                unpack = pooch.Unzip if path.endswith(".zip") else pooch.Untar
                unpack(extract_dir=".")(str(target / path), "download", origin)
    return target


def _copying(source: Path) -> Callable[[str, str, object], None]:
    """A downloader of pooch that takes a file from a mirror."""

    def download(address: str, part: str, origin: object) -> None:
        """Copy where pooch would download."""
        shutil.copyfile(source, part)

    return download


def _check_room(needed_bytes: int, target: Path) -> None:
    """Refuse before the first byte what the disk has no room for."""
    disk = next(each for each in (target.absolute(), *target.absolute().parents) if each.exists())
    if (free_bytes := shutil.disk_usage(disk).free) < needed_bytes:
        raise InputError(
            f"{free_bytes / 1e6:.1f} MB are free",
            expected=f"{needed_bytes / 1e6:.1f} MB",
            where=target,
            cure="Make room, or name another folder with --to",
        )
