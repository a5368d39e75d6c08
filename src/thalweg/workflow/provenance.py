"""Where a result comes from: the JSON beside each artefact."""

import hashlib
import importlib.metadata
import json
import platform
import subprocess
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import thalweg

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


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, or of the sorted names and contents of a folder."""
    digest = hashlib.sha256()
    members = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    for member in members:
        if path.is_dir():
            digest.update(member.relative_to(path).as_posix().encode())
        with member.open("rb") as stream:
            while chunk := stream.read(1 << 22):
                digest.update(chunk)
    return digest.hexdigest()


def git_commit(folder: Path) -> str | None:
    """Commit of the checkout that holds a folder, with ``+`` appended if it has changes; None outside git."""
    try:
        commit = _git(folder, "rev-parse", "HEAD")
        dirty = _git(folder, "status", "--porcelain", "--untracked-files=no")
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


def is_made_of(output: Path, wanted: Mapping[str, Any]) -> bool:
    """Whether an output is whole and was made of just this `origin`."""
    try:
        record = json.loads(meta_file(output).read_text(encoding="utf-8"))
        same = {key: record.get(key) for key in wanted} == json.loads(json.dumps(wanted, default=str))
        return same and record["sha256"] == sha256_of(output)
    except (OSError, ValueError, AttributeError, KeyError):
        return False


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
