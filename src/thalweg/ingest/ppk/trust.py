r"""Which ambiguity fixes may be trusted, and how large the errors of float and fixed positions really are.

A wrong set of integers passes the ratio test now and then; over a long baseline, where the atmosphere differs
between both ends, more often than not. Such a fix is metres off and states millimetres. Three tests, each on
a run of neighbouring fixed epochs:

- the *baseline*: beyond `trusted_baseline_km` integers are not trusted at all;
- its *duration*: a run shorter than `least_fix_s` may be chance;
- its *distance from the float solution* of the same epochs, whose ambiguities are no integers: with the
  covariance of the float solution it is beyond three sigmas for most of the run.

What is refused becomes the float position of that epoch. Standard deviations grow in proportion to the
baseline by what double differences leave of the atmosphere, ``1e-6`` of its length in plan and ``2e-6`` in
height: the proportional parts that makers of receivers state for relative positions (1 mm/km), and twice that
in height, where the troposphere enters by two to three times its delay at the zenith (Teunissen and
Montenbruck 2017, Springer Handbook of Global Navigation Satellite Systems, ch. 6 and 26); those of float
positions by five times that. These are also doubled, because multipath that lasts for minutes is no part of
them, or multiplied by the factor by which a forward and a backward run of the filter differ more than both
say, if that is larger.

The .pos text of the engine becomes a table here, and covariances that cannot be true are replaced.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.stats import chi2

from thalweg.core import ArrayB, ArrayF, ArrayI, InputError, LocalFrame
from thalweg.ingest import GNSS_POSITION
from thalweg.ingest.tracks import read_pos

# ---------------------------------------------------------------- the engine's table

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


# ---------------------------------------------------------------- trust

ATMOSPHERE: Final = np.array([1e-6, 1e-6, 2e-6])
"""Standard deviations east, north, up that the atmosphere adds, in parts of the baseline."""
FLOAT_ATMOSPHERE: Final = np.array([5e-6, 5e-6, 1e-5])
"""The same of float positions, which rest on the code: the ionosphere differs by 1 to 2 mm/km at the zenith,
by 2.4 times that for low satellites, and enters by a dilution of precision of 2 in plan and 3 in height."""
REFUSALS: Final = {
    "baseline": "the baseline is longer than ppk.trusted_baseline_km",
    "duration": "the run of fixed epochs is shorter than ppk.least_fix_s",
    "float": "the fix lies beyond three sigmas of the float solution",
}
"""Why fixes are refused."""
_THREE_SIGMA: Final = float(chi2.ppf(0.9973, 3))
_FLOAT_FLOOR_M: Final = np.array([0.05, 0.05, 0.10])
"""A float solution that has converged states less than multipath and atmosphere leave."""
LEAST_FACTOR: Final = 2.0
"""Float positions err about so many times as much as the engine states: with fixed ones as truth 1.5, 1.7 and
1.8, 1.9 times (root mean square of the axes; forward, backward) on two real recordings over 7 m and 5 km."""
_LARGEST_FACTOR: Final = 10.0
_FEWEST: Final = 30
"""Fewer float epochs of both directions tell no factor."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trust:
    """What the judgement of a solution found.

    Parameters
    ----------
    refused : fixed epochs that became float, by `REFUSALS`.
    float_factor : on the standard deviations of float positions.
    without_float : refused epochs that have no float position and were left out.
    """

    refused: dict[str, int]
    float_factor: float
    without_float: int

    def report(self) -> dict[str, Any]:
        """As details of an integrity report."""
        return {
            "n_fixes_refused": dict(self.refused),
            "float_sigma_factor": self.float_factor,
            "n_refused_without_float": self.without_float,
        }

    def notes(self) -> list[str]:
        """What people should know."""
        said = [
            f"{n:,} fixed epochs count as float: {REFUSALS[why]}." for why, n in self.refused.items() if n
        ]
        if self.float_factor > LEAST_FACTOR:
            said.append(
                f"A forward and a backward run differ {self.float_factor:.1f} times as much as their "
                "standard deviations say: those of float positions are multiplied by that."
            )
        if self.without_float:
            said.append(f"{self.without_float:,} of them have no float position and were left out.")
        return said


def trust_fixes(
    positions: pd.DataFrame,
    floats: pd.DataFrame,
    backward: pd.DataFrame | None,
    baseline_m: ArrayF,
    *,
    trusted_baseline_km: float,
    least_fix_s: float,
) -> tuple[pd.DataFrame, Trust]:
    """Judge the fixes of a solution, and give all positions standard deviations that hold.

    Parameters
    ----------
    positions : table of kind ``gnss_position``, the solution with integer ambiguities.
    floats : the same observations with float ambiguities.
    backward : float ambiguities by a filter that runs backward; None: the factor is `LEAST_FACTOR`.
    baseline_m : (n,) distance of each of `positions` from the base.
    trusted_baseline_km : integers of longer baselines are not trusted.
    least_fix_s : nor those of shorter runs.

    Returns
    -------
    positions : with refused fixes as float positions.
    trust : counts and factor.
    """
    factor = LEAST_FACTOR if backward is None else _float_factor(floats, backward)
    floats = _scaled(floats, factor)
    t = positions["t_gps_s"].to_numpy(np.float64)
    fixed = (positions["fix"] == "fixed").to_numpy()
    beside, known = _at(floats, t)
    far = _beyond(positions, floats, beside, known, baseline_m)
    run = np.cumsum(np.diff(fixed.astype(np.int64), prepend=0) != 0)
    step_s = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    why = np.full(len(t), "", dtype=object)
    for number in np.unique(run[fixed]):
        of = np.flatnonzero(run == number)
        long = baseline_m[of] > 1000 * trusted_baseline_km
        if t[of[-1]] - t[of[0]] + step_s < least_fix_s:
            why[of] = "duration"
        elif known[of].any() and far[of][known[of]].mean() > 0.5:
            why[of] = "float"
        why[of[long]] = "baseline"
    refused = why != ""
    out = _scaled(positions, factor, positions["fix"].to_numpy() == "float")
    take = refused & known
    for name in positions.columns:
        out.loc[take, name] = floats[name].to_numpy()[beside[take]]
    covariance = covariance_enu(out)
    parts = np.where((out["fix"] == "float").to_numpy()[:, None], FLOAT_ATMOSPHERE, ATMOSPHERE)
    covariance[:, range(3), range(3)] += (baseline_m[:, None] * parts) ** 2
    out = with_covariance_enu(out, covariance)
    lost = refused & ~known
    counts = {name: int((why == name).sum()) for name in REFUSALS}
    found = Trust(refused=counts, float_factor=factor, without_float=int(lost.sum()))
    return out[~lost].reset_index(drop=True), found


def _at(floats: pd.DataFrame, t: ArrayF) -> tuple[ArrayI, ArrayB]:
    """Row of the float solution at each time, and whether there is one."""
    when = floats["t_gps_s"].to_numpy(np.float64)
    if not len(when):
        return np.zeros(len(t), np.int64), np.zeros(len(t), np.bool_)
    row = np.clip(np.searchsorted(when, t - 1e-3), 0, len(when) - 1)
    good = (np.abs(when[row] - t) < 1e-3) & (floats["fix"] == "float").to_numpy()[row]
    return row, np.asarray(good)


def _beyond(
    positions: pd.DataFrame, floats: pd.DataFrame, beside: ArrayI, known: ArrayB, baseline_m: ArrayF
) -> ArrayB:
    """Whether each position lies beyond three sigmas of the float one of its epoch."""
    far = np.zeros(len(positions), dtype=np.bool_)
    if not known.any():
        return far
    d = _enu(positions[known], floats.iloc[beside[known]])
    cov = covariance_enu(floats.iloc[beside[known]])
    atmosphere = (baseline_m[known, None] * ATMOSPHERE) ** 2
    cov[:, range(3), range(3)] += atmosphere + _FLOAT_FLOOR_M**2
    far[known] = np.einsum("ni,ni->n", d, np.linalg.solve(cov, d[..., None])[..., 0]) > _THREE_SIGMA
    return far


def _enu(a: pd.DataFrame, b: pd.DataFrame) -> ArrayF:
    """Differences a - b (n, 3) east, north, up."""
    names = ["lat_deg", "lon_deg", "h_ell_m"]
    lat, lon, h = b[names].to_numpy(np.float64)[0]
    frame = LocalFrame(lat_deg=float(lat), lon_deg=float(lon), h_ell_m=float(h))
    places = (frame.from_geodetic(*each[names].to_numpy(np.float64).T) for each in (a, b))
    return np.asarray(next(places) - next(places))


def _float_factor(forward: pd.DataFrame, backward: pd.DataFrame) -> float:
    """How many times both directions differ more than their sigmas say; at least `LEAST_FACTOR`.

    Both share the observations, so that their difference says too little rather than too much.
    """
    beside, known = _at(backward, forward["t_gps_s"].to_numpy(np.float64))
    known &= (forward["fix"] == "float").to_numpy()
    if known.sum() < _FEWEST:
        return LEAST_FACTOR
    a, b = forward[known], backward.iloc[beside[known]]
    variance = sum(np.diagonal(covariance_enu(each), axis1=1, axis2=2) for each in (a, b))
    # the median, so that the first minutes of either direction do not rule
    square = np.median(_enu(a, b) ** 2 / variance, axis=0) / chi2.ppf(0.5, 1)
    return float(np.clip(np.sqrt(np.mean(square)), LEAST_FACTOR, _LARGEST_FACTOR))


def _scaled(table: pd.DataFrame, factor: float, rows: ArrayB | None = None) -> pd.DataFrame:
    """The table with standard deviations of those rows multiplied."""
    scale = np.where(np.ones(len(table), bool) if rows is None else rows, factor**2, 1.0)
    return with_covariance_enu(table, covariance_enu(table) * scale[:, None, None])
