"""Files of sensor poses: everything for the next job (NPZ), and a table for people (CSV)."""

from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np
import pandas as pd
from numpy.lib.npyio import NpzFile

from thalweg.core.errors import InputError
from thalweg.lightsheet.poses.poses import M_PER_MM, SensorPoses

_ARRAYS: Final = ("R_target_lcs", "shift_m", "cov", "shared", "t_gps_s")
_TEXTS: Final = ("images", "reasons")
_NAMES: Final = ("target", "source")
_MARK: Final = "thalweg sensor poses 1"


def write_poses(path: Path, poses: SensorPoses) -> None:
    """Write poses as NPZ."""
    facts = sorted(poses.facts)
    np.savez_compressed(
        path, allow_pickle=False, mark=np.array(_MARK),
        **{name: getattr(poses, name) for name in _ARRAYS},
        **{name: np.array(getattr(poses, name), dtype=np.str_) for name in (*_TEXTS, *_NAMES)},
        fact_names=np.array(facts, dtype=np.str_),
        fact_values=np.array([poses.facts[name] for name in facts], dtype=np.float64),
    )  # fmt: skip


def read_poses(path: Path) -> SensorPoses:
    """Read what `write_poses` wrote.

    Raises
    ------
    InputError : the file is missing or something else.
    """
    expected = "poses of the light-sheet sensor (NPZ)"
    if not path.is_file():
        raise InputError("file not found", expected=expected, where=path)
    try:
        # opened here, because numpy leaves a damaged file open
        with path.open("rb") as stream:
            return _poses(np.load(stream, allow_pickle=False), path, expected)
    except (OSError, EOFError, BadZipFile, ValueError, KeyError) as error:
        raise InputError(f"this cannot be read ({error})", expected=expected, where=path) from error


def _poses(data: object, path: Path, expected: str) -> SensorPoses:
    """Poses of an opened file."""
    if not isinstance(data, NpzFile):
        raise InputError("an array", expected=expected, where=path)
    if str(data["mark"]) != _MARK:
        raise InputError(f"a file of the kind '{data['mark']}'", expected=expected, where=path)
    names = [str(name) for name in data["fact_names"]]
    images, reasons = (tuple(str(text) for text in data[name]) for name in _TEXTS)
    target, source = (str(data[name]) for name in _NAMES)
    R, shift_m, cov, shared, t_gps_s = (data[name] for name in _ARRAYS)
    return SensorPoses(
        images=images, reasons=reasons, target=target, source=source, R_target_lcs=R,
        shift_m=shift_m, cov=cov, shared=shared, t_gps_s=t_gps_s,
        facts=dict(zip(names, data["fact_values"].tolist(), strict=True)),
    )  # fmt: skip


def pose_table(poses: SensorPoses) -> pd.DataFrame:
    """A row an image: time, place, standard deviations by own and by shared errors, reason."""
    own = np.sqrt(np.diagonal(poses.cov, axis1=1, axis2=2))
    shared = np.sqrt(np.square(poses.shared).sum(axis=2))
    columns: dict[str, object] = {"file": poses.images, "t_gps_s": poses.t_gps_s}
    columns |= {f"{a}_m": poses.shift_m[:, i] for i, a in enumerate("xyz")}
    for words, sigma in (("", own), ("shared_", shared)):
        columns |= {f"sigma_{words}{a}_mm": sigma[:, i] / M_PER_MM for i, a in enumerate("xyz")}
        columns |= {f"sigma_{words}turn_{a}_deg": np.rad2deg(sigma[:, 3 + i]) for i, a in enumerate("xyz")}
    return pd.DataFrame({**columns, "reason": poses.reasons})
