r"""Which ambiguity fixes may be trusted, and how large the errors of float and fixed positions really are.

A wrong set of integers passes the ratio test now and then; over a long baseline, where the atmosphere differs
between both ends, more often than not. Such a fix is metres off and states millimetres. Three tests, each on
a run of neighbouring fixed epochs:

- the *baseline*: beyond `trusted_baseline_km` integers are not trusted at all;
- its *duration*: a run shorter than `least_fix_s` may be chance;
- its *distance from the float solution* of the same epochs, whose ambiguities are no integers: with the
  covariance of the float solution it is beyond three sigmas for most of the run.

What is refused becomes the float position of that epoch. The engine's covariances are multiplied by what the
residuals show (`thalweg.ingest.ppk.residuals`); those of float positions by what they show of means over as
many epochs as the filter has seen. To these comes what double differences leave of the atmosphere in all
satellites alike, which no residual shows: in proportion to the baseline `ATMOSPHERE`, that of float positions
`FLOAT_ATMOSPHERE`, and in height `RISE` times the difference of heights.

The .pos text of the engine becomes a table here, and covariances that cannot be true are replaced.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.special import chdtri

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

ATMOSPHERE: Final = np.array([2e-6, 2e-6, 3e-6])
"""Standard deviations east, north, up that the atmosphere adds, in parts of the baseline: the ionosphere
differs by 1 mm/km at the zenith on L1 and 1.6 times that on L2, of which the engine takes the mean, and
enters by a dilution of precision of 1.5 in plan and 2.3 in height (Teunissen and Montenbruck 2017, ch. 6 and
26)."""
FLOAT_ATMOSPHERE: Final = np.array([5e-6, 5e-6, 1e-5])
"""The same of float positions, which rest on the code: 1 to 2 mm/km at the zenith, 2.4 times that for low
satellites, by a dilution of precision of 2 in plan and 3 in height."""
RISE: Final = 1.5e-4
"""Standard deviation of a height by water vapour between the heights of both antennas, of which the engine's
troposphere knows nothing: 0.12 m at the zenith that fade over 2 km (6e-5 of the rise), which heights feel 2.5
times."""
REFUSALS: Final = {
    "baseline": "the baseline is longer than ppk.trusted_baseline_km",
    "duration": "the run of fixed epochs is shorter than ppk.least_fix_s",
    "float": "the fix lies beyond three sigmas of the float solution",
}
"""Why fixes are refused."""
_THREE_SIGMA: Final = float(chdtri(3, 1 - 0.9973))
_FLOAT_FLOOR_M: Final = np.array([0.05, 0.05, 0.10])
"""A float solution that has converged states less than multipath and atmosphere leave."""
UNKNOWN_FACTOR: Final = 2.0
"""On the standard deviations of float positions where too few epochs tell one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trust:
    """What the judgement of a solution found.

    Parameters
    ----------
    refused : fixed epochs that became float, by `REFUSALS`.
    fixed_factor : on the standard deviations of fixed positions.
    float_factors : on those of float positions, in the first and in the last epoch of the filter.
    known : whether the residuals told the latter.
    without_float : refused epochs that have no float position and were left out.
    """

    refused: dict[str, int]
    fixed_factor: float
    float_factors: tuple[float, float]
    known: bool
    without_float: int

    def report(self) -> dict[str, Any]:
        """As details of an integrity report."""
        return {
            "n_fixes_refused": dict(self.refused),
            "fixed_sigma_factor": self.fixed_factor,
            "float_sigma_factors": list(self.float_factors),
            "n_refused_without_float": self.without_float,
        }

    def notes(self) -> list[str]:
        """What people should know."""
        said = [
            f"{n:,} fixed epochs count as float: {REFUSALS[why]}." for why, n in self.refused.items() if n
        ]
        if not self.known:
            said.append(
                "Too few epochs and satellites tell how large the errors of the code are: standard "
                f"deviations of float positions are {UNKNOWN_FACTOR:g} times the engine's."
            )
        if self.without_float:
            said.append(f"{self.without_float:,} of them have no float position and were left out.")
        return said


def trust_fixes(
    positions: pd.DataFrame,
    floats: pd.DataFrame,
    fixed_variance: float,
    float_variance: tuple[ArrayF, ArrayF] | None,
    baseline_m: ArrayF,
    rise_m: ArrayF,
    *,
    trusted_baseline_km: float,
    least_fix_s: float,
    direction: str = "forward",
) -> tuple[pd.DataFrame, Trust]:
    """Judge the fixes of a solution, and give all positions standard deviations that hold.

    Parameters
    ----------
    positions : table of kind ``gnss_position``, the solution with integer ambiguities.
    floats : the same observations with float ambiguities.
    fixed_variance : factor of `phase_factor`.
    float_variance : numbers of epochs and factors of `code_factors`; None: `UNKNOWN_FACTOR` squared.
    baseline_m, rise_m : (n,) distance of each of `positions` from the base, and difference of their heights.
    trusted_baseline_km : integers of longer baselines are not trusted.
    least_fix_s : nor those of shorter runs.
    direction : in which the filter ran: ``forward``, ``backward`` or ``combined``.

    Returns
    -------
    positions : with refused fixes as float positions.
    trust : counts and factors.
    """
    after, factors = float_variance or (np.ones(1), np.full(1, UNKNOWN_FACTOR**2))
    n_epochs = len(floats)

    def float_factor(t_gps_s: ArrayF) -> ArrayF:
        """Of the variances at these times, by how many epochs the filter has seen."""
        seen = np.searchsorted(floats["t_gps_s"].to_numpy(np.float64), t_gps_s - 1e-3) + 1
        seen = {"forward": seen, "backward": n_epochs + 1 - seen, "combined": np.full(len(seen), n_epochs)}[
            direction
        ]
        return np.asarray(np.exp(np.interp(np.log(np.maximum(seen, 1)), np.log(after), np.log(factors))))

    floats = _scaled(floats, float_factor(floats["t_gps_s"].to_numpy(np.float64)))
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
    kinds = positions["fix"].to_numpy()
    out = _scaled(
        positions, np.where(fixed, fixed_variance, np.where(kinds == "float", float_factor(t), 1.0))
    )
    take = refused & known
    for name in positions.columns:
        out.loc[take, name] = floats[name].to_numpy()[beside[take]]
    covariance = covariance_enu(out)
    parts = np.where((out["fix"] == "float").to_numpy()[:, None], FLOAT_ATMOSPHERE, ATMOSPHERE)
    covariance[:, range(3), range(3)] += (baseline_m[:, None] * parts) ** 2
    covariance[:, 2, 2] += (RISE * rise_m) ** 2
    out = with_covariance_enu(out, covariance)
    lost = refused & ~known
    counts = {name: int((why == name).sum()) for name in REFUSALS}
    found = Trust(
        refused=counts,
        fixed_factor=float(np.sqrt(fixed_variance)),
        float_factors=(float(np.sqrt(factors[0])), float(np.sqrt(factors[-1]))),
        known=float_variance is not None,
        without_float=int(lost.sum()),
    )
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


def _scaled(table: pd.DataFrame, factor: ArrayF) -> pd.DataFrame:
    """The table with variances multiplied (n,)."""
    return with_covariance_enu(table, covariance_enu(table) * factor[:, None, None])
