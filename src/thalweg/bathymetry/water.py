r"""The water level along the river and over time, with its sigma, from a boat that floats on it.

    level(s, t) = a + b (s - s0) + c (t - t0)

by generalised least squares from the heights of the water line at the boat. Its errors last as positions do
(Gauss-Markov), heave is white and is found from differences of second to second. Fall and rise are kept only
where the survey tells them: beyond twice their sigma, and not as one for the other.
"""

from dataclasses import asdict, dataclass
from typing import Any, Final, Self

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from thalweg.core import NMAD, ArrayF, CoverageError, Trajectory
from thalweg.navigation.ins_gnss import PoseCorrelation

_STEP_S: Final = 1.0
_MOST_NODES: Final = 3000
"""More seconds than this are thinned: the errors of the level last longer than that anyway."""
_DETERMINED: Final = 2.0
"""A fall or a rise of so many sigmas is kept."""
_CONFOUNDED: Final = 0.95
"""Correlation of place and time above which the survey cannot tell a fall from a rise."""
_LEAST_HEAVE_M: Final = 0.002


@dataclass(frozen=True, slots=True, kw_only=True)
class WaterLevel:
    """Height of the water.

    Parameters
    ----------
    level_m : at ``s0_m`` and ``t0_gps_s``, up in wcs.
    slope : rise per metre downstream (negative: it falls).
    rise_m_per_s : change in time.
    cov : (3, 3) of the three.
    s0_m, t0_gps_s : where and when.
    sigma_heave_m : of the boat about the level.
    notes : what the survey could not tell.
    """

    level_m: float
    slope: float = 0.0
    rise_m_per_s: float = 0.0
    cov: ArrayF
    s0_m: float = 0.0
    t0_gps_s: float = 0.0
    sigma_heave_m: float = 0.0
    notes: tuple[str, ...] = ()

    def at(self, s_m: ArrayF, t_gps_s: ArrayF | float | None = None) -> tuple[ArrayF, ArrayF]:
        """Level (n,) and its standard deviation along the river; by default at the middle of the survey."""
        s = np.asarray(s_m, dtype=np.float64) - self.s0_m
        t = np.zeros_like(s) if t_gps_s is None else np.asarray(t_gps_s, dtype=np.float64) - self.t0_gps_s
        rows = np.stack(np.broadcast_arrays(np.ones_like(s), s, t), axis=-1)
        level = rows @ np.array([self.level_m, self.slope, self.rise_m_per_s])
        variance = np.einsum("...i,ij,...j->...", rows, self.cov, rows)
        return np.asarray(level), np.sqrt(variance)

    def report(self) -> dict[str, Any]:
        """For the page and for later rules."""
        return asdict(self) | {
            "cov": self.cov.tolist(),
            "notes": list(self.notes),
            "fall_m_per_km": -1000 * self.slope,
            "sigma_fall_m_per_km": 1000 * float(np.sqrt(self.cov[1, 1])),
            "rise_m_per_h": 3600 * self.rise_m_per_s,
            "sigma_m": float(np.sqrt(self.cov[0, 0])),
        }

    @classmethod
    def of_report(cls, report: dict[str, Any]) -> Self:
        """Of what `report` gave."""
        names = cls.__dataclass_fields__
        found = {name: report[name] for name in names}
        return cls(**found | {"cov": np.asarray(report["cov"]), "notes": tuple(report["notes"])})


def level_water(
    trajectory: Trajectory,
    correlation: PoseCorrelation,
    s_of: Any,
    *,
    water_line_ics_m: float,
    sigma_datum_m: float,
) -> WaterLevel:
    """The level from the heights of the water line at the boat.

    Parameters
    ----------
    trajectory, correlation : poses with covariances, and how their errors last.
    s_of : gives places along the river (n,) of places (n, 2).
    water_line_ics_m : down coordinate of the water line in the body frame.
    sigma_datum_m : common error of all heights.

    Raises
    ------
    CoverageError : the trajectory is shorter than three seconds.
    """
    first, last = trajectory.span()
    step = max(_STEP_S, (last - first) / _MOST_NODES)
    t = np.arange(first, last, step)
    place, _, valid = trajectory.at(t)
    t, place = t[valid], place[valid]
    if len(t) < 3:
        raise CoverageError(
            f"{len(t)} seconds with a pose", expected="a trajectory of more than three seconds on the water"
        )
    up = place[:, 2] - water_line_ics_m
    s = np.asarray(s_of(place[:, :2]), dtype=np.float64)
    own = trajectory.cov_at(t)[:, 2, 2]
    slow, white = (1 - correlation.white_share) * own, correlation.white_share * own
    near = np.abs(np.diff(t) - step) < 0.5 * step
    jitter = NMAD * float(np.median(np.abs(np.diff(up)[near]))) / np.sqrt(2) if near.any() else 0.0
    heave = max(float(np.sqrt(max(jitter**2 - np.median(white), 0.0))), _LEAST_HEAVE_M)
    s0, t0 = float(s.mean()), float(t.mean())
    rows = np.column_stack([np.ones(len(t)), s - s0, t - t0])
    apart = np.abs(t[:, None] - t[None]) / correlation.position_s
    cov = np.sqrt(np.outer(slow, slow)) * np.exp(-apart) + np.diag(white + heave**2)
    factor = cho_factor(cov, lower=True)

    def fit(columns: list[int]) -> tuple[ArrayF, ArrayF]:
        """Values and covariance of some of level, fall and rise."""
        design = rows[:, columns]
        weighted = cho_solve(factor, design)
        inverse = np.linalg.inv(design.T @ weighted)
        return np.asarray(inverse @ (weighted.T @ up)), np.asarray(inverse)

    columns, notes = [0], []
    spread = np.std(rows[:, 1:], axis=0)
    both = spread.min() > 0 and abs(np.corrcoef(rows[:, 1], rows[:, 2])[0, 1]) < _CONFOUNDED
    for k, name in ((1, "fall along the river"), (2, "rise in time")):
        if spread[k - 1] == 0 or (k == 2 and not both):
            notes.append(f"{name}: not told, the boat went down the river only once")
            continue
        value, matrix = fit([*columns, k])
        if abs(value[-1]) > _DETERMINED * np.sqrt(matrix[-1, -1]):
            columns.append(k)
        else:
            notes.append(
                f"{name}: {value[-1]:.2g} with a sigma of {np.sqrt(matrix[-1, -1]):.2g}, taken as none"
            )
    value, matrix = fit(columns)
    # residuals that are larger than stated enlarge the sigma
    rest = up - rows[:, columns] @ value
    size = float(rest @ cho_solve(factor, rest)) / max(len(t) - len(columns), 1)
    full, cov_full = np.zeros(3), np.zeros((3, 3))
    full[columns] = value
    cov_full[np.ix_(columns, columns)] = matrix * max(size, 1.0)
    cov_full[0, 0] += sigma_datum_m**2
    return WaterLevel(
        level_m=float(full[0]),
        slope=float(full[1]),
        rise_m_per_s=float(full[2]),
        cov=cov_full,
        s0_m=s0,
        t0_gps_s=t0,
        sigma_heave_m=heave,
        notes=tuple(notes),
    )
