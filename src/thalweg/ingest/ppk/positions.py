"""What the engine wrote: its .pos text as a table, and covariances that cannot be true replaced."""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import ArrayB, ArrayF, InputError
from thalweg.ingest import GNSS_POSITION
from thalweg.ingest.tracks import read_pos

SIGMA_FLOOR_M: Final = 0.0005
"""Least standard deviation of one epoch in any direction: 3 mm of phase noise over 30 satellites."""

NEIGHBOURS: Final = 15
"""Positions of the same fix on either side whose median replaces a covariance."""


def read_solution(path: Path) -> pd.DataFrame:
    """Table of kind `GNSS_POSITION`; zero rows if the engine wrote no solution.

    Raises
    ------
    InputError : the engine wrote lines that are no positions.
    """
    lines = path.read_bytes().splitlines() if path.is_file() else []
    if all(line.startswith(b"%") or not line.strip() for line in lines):
        return pd.DataFrame({name: np.zeros(0) for name in GNSS_POSITION.names})
    log = read_pos([path])
    if not log.report.clean and log.report.losses.get("damaged_lines"):
        raise InputError(
            f"{log.report.losses['damaged_lines']} lines of the engine's solution are damaged",
            expected="whole lines",
            where=path.name,
            cure="Check the free space of the temporary folder and run again",
        )
    return log.positions


def covariance_enu(positions: pd.DataFrame) -> ArrayF:
    """Covariances (n, 3, 3) in east, north, up from the columns of `GNSS_POSITION`."""
    C = np.empty((len(positions), 3, 3))
    for k, name in enumerate(("east", "north", "up")):
        C[:, k, k] = positions[f"sigma_{name}_m"].to_numpy() ** 2
    for i, j, name in ((0, 1, "en"), (0, 2, "eu"), (1, 2, "nu")):
        C[:, i, j] = C[:, j, i] = positions[f"cov_{name}_m2"].to_numpy()
    return C


def with_covariance_enu(positions: pd.DataFrame, covariance_m2: ArrayF) -> pd.DataFrame:
    """A copy with those covariances (n, 3, 3) in east, north, up."""
    out = positions.copy()
    for k, name in enumerate(("east", "north", "up")):
        out[f"sigma_{name}_m"] = np.sqrt(covariance_m2[:, k, k])
    for i, j, name in ((0, 1, "en"), (0, 2, "eu"), (1, 2, "nu")):
        out[f"cov_{name}_m2"] = covariance_m2[:, i, j]
    return out


def replace_covariances(positions: pd.DataFrame) -> tuple[pd.DataFrame, int]:
    """Replace covariances that are not positive definite, or smaller than an epoch can be.

    Without a dynamic model the engine starts each epoch from a position variance of 900 m^2. The update to
    some 1e-6 m^2 costs so many digits that covariances of fixed epochs carry noise of that size and may be
    indefinite. The median over the neighbours of the same fix has little of this noise; what is still too
    small is raised to `SIGMA_FLOOR_M`.

    Parameters
    ----------
    positions : table of kind `GNSS_POSITION`.

    Returns
    -------
    The table, and how many covariances were replaced.
    """
    if positions.empty:
        return positions, 0
    C = covariance_enu(positions)
    bad = _too_small(C)
    replaced = C.copy()
    fix = positions["fix"].to_numpy()
    for index in np.flatnonzero(bad):
        same = np.flatnonzero(fix == fix[index])
        at = int(np.searchsorted(same, index))
        near = C[same[max(0, at - NEIGHBOURS) : at + NEIGHBOURS + 1]]
        value, axes = np.linalg.eigh(np.median(near, axis=0))
        replaced[index] = (axes * np.maximum(value, SIGMA_FLOOR_M**2)) @ axes.T
    out = positions.copy()
    for name, values in with_covariance_enu(positions, replaced).items():
        out.loc[bad, name] = values[bad]
    return out, int(np.sum(bad))


def _too_small(C: ArrayF) -> ArrayB:
    """Where an eigenvalue is below the floor; unknown covariances (NaN) are left as they are."""
    known = np.all(np.isfinite(C), axis=(1, 2))
    least = np.full(len(C), np.inf)
    least[known] = np.linalg.eigvalsh(C[known])[:, 0]
    return np.asarray(least < SIGMA_FLOOR_M**2)
