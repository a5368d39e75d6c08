"""Arrays with a head as one ``.npz``, of stated kind and version; the same content gives the same bytes."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from thalweg.core import Camera, InputError, parse_json


def write_arrays(
    path: Path,
    kind: str,
    version: int,
    head: Mapping[str, Any],
    arrays: Mapping[str, Any],
    *,
    compressed: bool = True,
) -> None:
    """Write what `read_arrays` reads; ``head`` is JSON-able."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"kind": kind, "version": version, **head})
    with path.open("wb") as file:
        (np.savez_compressed if compressed else np.savez)(file, head=np.array(text), **arrays)


def read_arrays(
    path: Path, kind: str, version: int, without: Sequence[str] = ()
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Head and arrays of an ``.npz`` of the expected kind, those named in ``without`` left out.

    Raises
    ------
    InputError : no such file, or of another kind or version.
    """
    if not path.is_file():
        raise InputError("file not found", expected=f"{kind} in an .npz", where=path)
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files if name not in without}
        head = parse_json(str(arrays.pop("head")), path)
    except (ValueError, KeyError, OSError, EOFError) as error:
        raise InputError(f"not readable ({error})", expected=f"{kind} in an .npz", where=path) from error
    if (head.get("kind"), head.get("version")) != (kind, version):
        raise InputError(
            f"{head.get('kind')} version {head.get('version')}",
            expected=f"{kind} version {version}",
            where=path,
            cure="Rebuild it with this version of Thalweg",
        )
    return head, arrays


def camera_record(camera: Camera) -> dict[str, Any]:
    """A camera as JSON holds it."""
    return {
        "name": camera.name,
        "model": camera.model,
        "size_px": list(camera.size_px),
        "parameters": camera.parameters.tolist(),
        "cov": camera.cov.tolist(),
    }


def camera_of_record(record: Mapping[str, Any]) -> Camera:
    """The camera of `camera_record`; other keys do not matter."""
    return Camera(
        name=record["name"],
        model=record["model"],
        size_px=(record["size_px"][0], record["size_px"][1]),
        parameters=np.array(record["parameters"], np.float64),
        cov=np.array(record["cov"], np.float64),
    )
