"""Where a result comes from: the JSON beside each artefact."""

import hashlib
import importlib.metadata
import json
import platform
import shlex
import shutil
import subprocess
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import thalweg
from thalweg.core import UNFINISHED, InputError, steps

FORMAT_VERSION = 1
LIBRARIES = (
    "numpy",
    "scipy",
    "pandas",
    "pyarrow",
    "numba",
    "laspy",
    "pyproj",
    "open3d-cpu",
    "open3d",
    "sbp",
    "pyrtklib5",
    "matplotlib",
    "snakemake",
)


STAMP: Final = ".snakemake_timestamp"
"""Snakemake puts it into a folder that a job has made, when its checksum is known already."""


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, or of the sorted names and contents of a folder."""
    digest = hashlib.sha256()
    members = (
        sorted(p for p in path.rglob("*") if p.is_file() and p.name != STAMP) if path.is_dir() else [path]
    )
    for member in members:
        if path.is_dir():
            digest.update(member.relative_to(path).as_posix().encode())
        with member.open("rb") as stream:
            while chunk := stream.read(1 << 22):
                digest.update(chunk)
    return digest.hexdigest()


def git_commit(folder: Path) -> str | None:
    """Commit of the checkout that holds a folder; None outside git.

    ``+`` is appended if files have changed, but for those of ``docs``: records and pages make no result.
    """
    try:
        commit = _git(folder, "rev-parse", "HEAD")
        dirty = _git(folder, "status", "--porcelain", "--untracked-files=no", ":(top)", ":(top,exclude)docs")
    except (OSError, subprocess.CalledProcessError):
        return None
    return commit + ("+" if dirty else "")


def _git(folder: Path, *words: str) -> str:
    run = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, check=True)
    return run.stdout.strip()


def library_versions() -> dict[str, str]:
    """Versions of Python and of the libraries that shape results, as installed."""
    versions = {"python": platform.python_version()}
    for name in LIBRARIES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return versions


def origin(*, rule: str, inputs: list[Path], params: Mapping[str, Any], code: str) -> dict[str, Any]:
    """What decides the outputs of a job: rule, version, code hash, parameters and checksums of all inputs."""
    return {
        "format_version": FORMAT_VERSION,
        "rule": rule,
        "thalweg": thalweg.__version__,
        "code": code,
        "params": {k: params[k] for k in sorted(params)},
        "inputs": {str(p): sha256_of(p) for p in inputs if p.exists()},
    }


def refuse_damage(inputs: Mapping[str, str], rule: str) -> None:
    """Refuse inputs that are not what the job wrote that made them.

    Parameters
    ----------
    inputs : name and checksum of each; those that have no provenance beside them are raw data.
    rule : of the job that reads them.

    Raises
    ------
    InputError : a checksum is not that of the provenance: a disk lost bytes, or somebody changed the file.
    """
    damaged = []
    for name, digest in inputs.items():
        try:
            record = json.loads(meta_file(Path(name)).read_text(encoding="utf-8"))
            # a copy elsewhere, which its provenance came along with, is raw data again
            if record["output"] == name and record["sha256"] != digest:
                damaged.append(name)
        except (OSError, ValueError, TypeError, KeyError):
            continue
    if damaged:
        raise InputError(
            f"{len(damaged)} of the inputs are not what was written: {', '.join(damaged[:3])}",
            expected=f"the checksum that stands beside each, in its {META}",
            where=f"rule {rule}",
            cure=f"Look at the disk, remove them and start again, and they are made anew; if one was changed"
            f" on purpose remove its {META}",
        )


def other_versions(outputs: Iterable[Path]) -> dict[str, int]:
    """Versions of Thalweg, but this one, that made results which are there; how many each."""
    found: dict[str, int] = {}
    for output in outputs:
        try:
            version = str(json.loads(meta_file(output).read_text(encoding="utf-8"))["thalweg"])
        except (OSError, ValueError, TypeError, KeyError):
            continue  # not made yet, or a page of Snakemake's
        if version != thalweg.__version__:
            found[version] = found.get(version, 0) + 1
    return found


TEMPORARY: Final = frozenset(
    {
        "georeference_window",
        "count_neighbours",
        "extract_features",
        "match_features",
        "simulate_field_images_part",
        "simulate_time_lapse_part",
    }
)
"""Rules whose outputs are removed once they have been used (``temp`` of Snakemake)."""


@dataclass(frozen=True, slots=True)
class Verified:
    """What became of the files of a folder of results since they were written.

    Attributes
    ----------
    as_written : number of outputs, files and folders, whose content has the recorded checksum.
    wrong : output by its name in the run -> what is wrong with it, in words.
    unrecorded : files that no job recorded, such as notes, reports and catalogues.
    """

    as_written: int
    wrong: Mapping[str, str]
    unrecorded: Sequence[Path]

    def commands(self) -> list[str]:
        """Commands that make again what is wrong, one for each campaign."""
        by_folder: dict[str, list[str]] = {}
        for name in self.wrong:
            by_folder.setdefault(Path(name).parts[1] if len(Path(name).parts) > 2 else "", []).append(name)
        return [
            shlex.join(
                [
                    *("snakemake", "--cores", "all"),
                    # studies, published numbers and real recordings are of no campaign
                    *(["--config", f"campaign={folder}"] if _is_campaign(folder) else []),
                    *("--force", *names),
                ]
            )
            for folder, names in by_folder.items()
        ]


def _is_campaign(name: str) -> bool:
    return any(Path("config", "campaigns").rglob(f"{name}.yaml"))


def verify(results: Path) -> Verified:
    """Hold all files of a folder of results against the records beside them.

    A file that was cut or changed and has its old time would otherwise stay for ever: Snakemake compares
    times alone, and what no job reads, such as a page, no job checks (`refuse_damage`).
    """
    records = sorted(results.rglob(f"*{META}"))
    outputs = {each.with_name(each.name.removesuffix(META)): each for each in records}
    as_written, wrong = 0, {}
    for output, beside in steps(outputs.items(), "output"):
        name = str(output)
        try:
            record = json.loads(beside.read_text(encoding="utf-8"))
            name, rule = record["output"], record["rule"]
            if not output.exists():
                words = "" if rule in TEMPORARY else f"is missing; {rule} wrote it on {record['written_utc']}"
            elif sha256_of(output) != record["sha256"]:
                words = f"is not what {rule} wrote on {record['written_utc']}"
            else:
                words, as_written = "", as_written + 1
        except (ValueError, TypeError, KeyError):
            words = f"has a record that is damaged ({beside.name})"
        if words:
            wrong[name] = words
    unrecorded = [
        path
        for path in sorted(results.rglob("*"))
        if path.is_file()
        and not path.name.startswith(".")
        and not path.name.endswith(META)
        and UNFINISHED not in path.as_posix()
        and not any(each in outputs for each in (path, *path.parents))
    ]
    return Verified(as_written, wrong, unrecorded)


META: Final = ".meta.json"


def meta_file(output: Path) -> Path:
    """Where the provenance of an output lies."""
    return output.with_name(output.name + META)


def write_provenance(
    outputs: Mapping[Path, Path],
    made_of: Mapping[str, Any],
    *,
    threads: int,
    wall_s: float,
    cpu_s: float,
    costs: Mapping[str, float | None],
) -> None:
    """Write ``<output>.meta.json`` beside each output of a job.

    It holds the origin, the commit, the checksum of the output itself, the library versions, threads, wall
    time and time of the processor. No host, user or absolute path of the package is recorded.

    Parameters
    ----------
    outputs : final names, and where each lies now.
    made_of : `origin` of the job.
    threads, wall_s, cpu_s, costs : what the job took.
    """
    record = {
        **made_of,
        "commit": git_commit(Path(thalweg.__file__).parent),
        "libraries": library_versions(),
        "threads": threads,
        "wall_s": round(wall_s, 3),
        "cpu_s": round(cpu_s, 3),
        "costs": costs,
        "written_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
    for output, lies in outputs.items():
        text = json.dumps({"output": str(output), "sha256": sha256_of(lies), **record}, indent=2, default=str)
        meta_file(lies).write_text(text + "\n", encoding="utf-8")


def bring_provenance(outputs: Iterable[Path], results: Path | None) -> None:
    """Copy the provenance of outputs from node-local scratch, where the job works, to the folder of the run.

    Snakemake brings the outputs themselves. ``results`` is what `work_in_scratch` gave; None: nothing to do.
    """
    if results is None:
        return
    for record in (meta_file(output) for output in outputs if not output.is_absolute()):
        target = results / record
        target.parent.mkdir(parents=True, exist_ok=True)
        made = target.with_name(f"{UNFINISHED}{target.name}")
        shutil.copyfile(record, made)
        made.replace(target)
