r"""Where lines of soundings cross: do they agree, and how large are the slow errors really?

At a crossing both lines give the height of one place. White errors differ, common ones cancel, and of the
slow ones the difference of two times is left. With heights interpolated along each line, the differences
``d`` of all crossings have the covariance

    V = diag(white + relief + slope) + f^2 S(tau),
    S_kl = c(a_k, a_l) - c(a_k, b_l) - c(b_k, a_l) + c(b_k, b_l),   c(t, u) = s(t) s(u) exp(-|t - u| / tau)

for the crossings of the times ``a_k`` and ``b_k`` and stated slow sigmas ``s``. The factor ``f`` and the time
``tau`` that are most probable, given what is stated to within a factor of 2 and 3, replace the stated ones.
The factor that enters predicted sigmas is the root of its expected square, as for the poses
(`thalweg.navigation.ins_gnss.Estimate`).
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.stats import t as student

from thalweg.core import NMAD, ArrayF, ArrayI, utc_text_from_gps
from thalweg.navigation.ins_gnss import Estimate

SPREAD: Final = 2.0
"""Stated slow sigmas may be wrong by this factor (one sigma of its logarithm)."""
TIME_SPREAD: Final = 3.0
"""The stated correlation time may be wrong by this factor."""
FEWEST: Final = 8
"""Fewer crossings tell no size: what is stated stays."""
_OUTLIER: Final = 4.0
"""Crossings whose difference is so many sigmas of its own are left out of the estimate, and counted."""
DAY_GAP_S: Final = 4 * 3600.0
"""A pause of this length begins another day of the survey."""
_PAUSE_S: Final = 60.0
_PAUSE: Final = 20.0
"""A pause so long, and so many times the usual interval, begins another run."""
_NAMED: Final = 6
"""So many pairs of days, runs or lines that contradict each other are named."""
_MOST: Final = 800
"""Crossings that are adjusted together: evenly chosen ones of more."""
_TELLING: Final = 240
"""Crossings that tell the variances of steps."""
_TRIES: Final = 3
_MEDIAN: Final = 1.2533
"""Standard deviation of a median over that of a mean."""
_OUTSIDE: Final = 1.959964
_ONE_SIGMA: Final = 0.841345
"""Share of a normal distribution below one standard deviation."""
_FEWEST_OF_PAIR: Final = 3
_HOLE: Final = 8.0
"""A step so many times the usual one is a hole in a line."""
_GAIN: Final = 10.0
"""Twice the logarithm of the probability that steps must add: by chance they do once in a hundred."""
_NOTHING: Final = 0.005
"""A variance below this share of those of all steps counts as nothing."""
_GAIN_OF_LINES: Final = 4.0
"""The same of a step of each line: where a line crosses one other, nothing tells it from noise."""
_STEP_SPREAD: Final = 3.0
"""One standard deviation of the logarithms of variances, about half the mean square of the differences."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossings:
    """Places where two lines cross, (k,) each.

    Parameters
    ----------
    a_s, b_s : times of both lines there, in which slow errors decay evenly; ``a_s < b_s``.
    east_m, north_m : the place.
    difference_m : height at ``b_s`` less height at ``a_s``.
    white_m2 : variance of the difference by what is new in each ping, relief between pings and slopes.
    slow_a_m, slow_b_m : stated slow sigmas of both heights.
    at_a, at_b : rows of the table of soundings before it.
    """

    a_s: ArrayF
    b_s: ArrayF
    east_m: ArrayF
    north_m: ArrayF
    difference_m: ArrayF
    white_m2: ArrayF
    slow_a_m: ArrayF
    slow_b_m: ArrayF
    at_a: ArrayI
    at_b: ArrayI

    def __len__(self) -> int:
        return len(self.a_s)

    def part(self, keep: ArrayI | np.ndarray[Any, np.dtype[np.bool_]]) -> "Crossings":
        """Those crossings alone."""
        return Crossings(**{name: getattr(self, name)[keep] for name in self.__slots__})

    def slow_covariance_m2(self, time_s: float) -> ArrayF:
        """Covariance (k, k) of the differences by the slow errors as stated, lasting ``time_s``."""
        ends = ((self.b_s, self.slow_b_m, 1.0), (self.a_s, self.slow_a_m, -1.0))
        return np.asarray(
            sum(
                (m * n) * np.outer(s, r) * np.exp(-np.abs(t[:, None] - u[None]) / time_s)
                for t, s, m in ends
                for u, r, n in ends
            )
        )

    def covariance_m2(self, time_s: float) -> ArrayF:
        """Covariance (k, k) of the differences, slow errors and all others."""
        return np.diag(self.white_m2) + self.slow_covariance_m2(time_s)


def since_pauses(t_s: ArrayF, pause_s: float) -> ArrayF:
    """Number of pauses (n,) before times: a day ends with a pause of hours, wherever midnight of UTC is."""
    out = np.full(len(t_s), np.nan)
    order = np.argsort(t_s, kind="stable")[: int(np.isfinite(t_s).sum())]
    out[order] = np.cumsum(np.diff(t_s[order], prepend=t_s[order][:1]) > pause_s)
    return out


def runs_by_pauses(t_s: ArrayF) -> ArrayI:
    """Number of the run (n,), from 0: a pause of a minute, and of many usual intervals, ends one."""
    usual = float(np.median(np.diff(np.sort(t_s)))) if len(t_s) > 1 else 0.0
    return since_pauses(t_s, max(_PAUSE_S, _PAUSE * usual)).astype(np.int64)


def find_crossings(soundings: pd.DataFrame) -> Crossings:
    """All crossings of lines of soundings, also of one line with itself.

    Parameters
    ----------
    soundings : table kind ``soundings``.
    """
    at = np.flatnonzero(soundings["used"] & (soundings["line"] >= 0))
    at = at[np.argsort(soundings["t_gps_s"].to_numpy(np.float64)[at], kind="stable")]
    used = soundings.iloc[at]
    t, even = (used[name].to_numpy(np.float64) for name in ("t_gps_s", "t_even_s"))
    place = used[["east_m", "north_m"]].to_numpy(np.float64)
    h = used["up_m"].to_numpy(np.float64)
    line = used["line"].to_numpy(np.int64)
    white = used["sigma_white_m"].to_numpy(np.float64) ** 2
    slow = used["sigma_slow_m"].to_numpy(np.float64)
    across = used["sigma_horizontal_m"].to_numpy(np.float64) ** 2
    step_s = np.diff(t)
    usual = float(np.median(step_s)) if len(step_s) else 0.0
    first = np.flatnonzero((line[1:] == line[:-1]) & (step_s > 0) & (step_s < 3 * usual))
    i, j, u, v = _intersections(place[first], place[first + 1])
    # neighbours along the track meet in their common ping
    apart = t[first[j]] - t[first[i] + 1] > 2 * usual
    i, j, u, v = first[i[apart]], first[j[apart]], u[apart], v[apart]

    def along(k: ArrayI, share: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF]:
        """Even time, height, variance without the slow part, and slow sigma between pings k and k + 1."""
        # pings nearer to each other than they are known show no slope
        length2 = np.maximum(np.sum((place[k + 1] - place[k]) ** 2, axis=1), across[k])
        slope2 = (h[k + 1] - h[k]) ** 2 / np.maximum(length2, 1e-12)
        variance = (1 - share) ** 2 * white[k] + share**2 * white[k + 1]
        variance += 4 * share * (1 - share) * relief_m2 + slope2 * across[k]
        mix = [(1 - share) * x[k] + share * x[k + 1] for x in (even, h, slow)]
        return mix[0], mix[1], variance, mix[2]

    relief_m2 = _relief_m2(h, white, line)
    t_a, h_a, var_a, slow_a = along(i, u)
    t_b, h_b, var_b, slow_b = along(j, v)
    met = place[i] + u[:, None] * (place[i + 1] - place[i])
    return Crossings(
        a_s=t_a,
        b_s=t_b,
        east_m=met[:, 0],
        north_m=met[:, 1],
        difference_m=h_b - h_a,
        white_m2=var_a + var_b,
        slow_a_m=slow_a,
        slow_b_m=slow_b,
        at_a=at[i],
        at_b=at[j],
    )


def _intersections(start: ArrayF, stop: ArrayF) -> tuple[ArrayI, ArrayI, ArrayF, ArrayF]:
    """Segments (m, 2) that cross: numbers i < j and the shares of both at which they do."""
    if len(start) < 2:
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), np.empty(0)
    way = stop - start
    longest = float(np.linalg.norm(way, axis=1).max())
    pairs = cKDTree((start + stop) / 2).query_pairs(longest, output_type="ndarray")
    i, j = np.sort(pairs, axis=1).T if len(pairs) else np.empty((2, 0), np.int64)
    cross = way[i, 0] * way[j, 1] - way[i, 1] * way[j, 0]
    i, j, cross = (x[np.abs(cross) > 1e-9] for x in (i, j, cross))
    between = start[j] - start[i]
    u = (between[:, 0] * way[j, 1] - between[:, 1] * way[j, 0]) / cross
    v = (between[:, 0] * way[i, 1] - between[:, 1] * way[i, 0]) / cross
    meet = (u >= 0) & (u < 1) & (v >= 0) & (v < 1)
    order = np.lexsort((j[meet], i[meet]))
    return i[meet][order], j[meet][order], u[meet][order], v[meet][order]


def _relief_m2(h: ArrayF, white_m2: ArrayF, line: ArrayI) -> float:
    """Variance of the bed half-way between two pings about the straight line through them.

    From pings against the mean of their neighbours, which are twice as far apart: half of the variance that
    their noise does not explain, as on a bed whose variogram rises linearly.
    """
    inner = np.flatnonzero(line[2:] == line[:-2]) + 1
    if not len(inner):
        return 0.0
    rest = h[inner] - (h[inner - 1] + h[inner + 1]) / 2
    noise = white_m2[inner] + (white_m2[inner - 1] + white_m2[inner + 1]) / 4
    return max((NMAD * float(np.median(np.abs(rest)))) ** 2 - float(np.median(noise)), 0.0) / 2


def estimate_slow_errors(
    soundings: pd.DataFrame, time_s: float
) -> tuple[pd.DataFrame, float, dict[str, Any]]:
    """Slow errors as large and as long as crossings say; steps of days and runs beyond them adjusted.

    Runs that disagree by more than slow errors explain are brought to their mean (`agreement`). What is left
    of the steps is part of the common error; the slow errors are then those that crossings within runs tell.

    Parameters
    ----------
    soundings : table kind ``soundings``.
    time_s : stated correlation time of its slow errors.

    Returns
    -------
    soundings : with other ``up_m``, ``sigma_slow_m``, ``sigma_common_m``, and covariances enlarged as much in
        height.
    time_s : the estimated correlation time.
    facts : crossings found and left out, their differences before and after, the estimates, ``agreement`` of
        days and runs where several cross, and ``notes`` of it.
    """
    everything = find_crossings(soundings)
    crossings = everything
    if len(crossings) > _MOST:
        crossings = crossings.part(np.unique(np.linspace(0, len(crossings) - 1, _MOST).astype(np.int64)))
    facts: dict[str, Any] = {"n": len(everything), "left_out": 0, "estimated": False}
    if not len(crossings):
        return soundings, time_s, facts
    stated = np.diag(crossings.covariance_m2(time_s))
    facts["rms_m"] = float(np.sqrt(np.mean(crossings.difference_m**2)))
    facts["predicted_m"] = float(np.sqrt(np.mean(stated)))
    facts["normalised_square"] = float(np.mean(crossings.difference_m**2 / stated))
    out = soundings.copy()
    t = out["t_gps_s"].to_numpy(np.float64)
    day, run = since_pauses(t, DAY_GAP_S).astype(np.int64), runs_by_pauses(t)
    same_day, same_run = (crossings.part(of[crossings.at_a] == of[crossings.at_b]) for of in (day, run))
    telling = same_day
    if len(same_run) < len(crossings):
        factor, lasts_s = 1.0, time_s
        if len(same_run) >= FEWEST:
            of_runs, lasting, _ = _estimated(same_run, time_s)
            factor, lasts_s = of_runs.predictive, lasting.value
        slow = {name: factor * getattr(crossings, name) for name in ("slow_a_m", "slow_b_m")}
        steps = _steps(replace(crossings, **slow), {"day": day, "run": run}, lasts_s)
        begins = [pd.Series(t).groupby(of).min().map(utc_text_from_gps) for of in (day, run)]
        names = {
            "day": tuple(text[:10] for text in begins[0]),
            "run": tuple(f"the run of {text[:16].replace('T', ' ')}" for text in begins[1]),
        }
        facts["agreement"], facts["notes"] = steps.told(names)
        left = np.hypot(steps.sigma_m, steps.sigma_common_m)[run]
        if left.any():
            telling = same_run
            for name in ("up_m", "transducer_up_m"):
                out[name] -= steps.shift_m[run]
            out["sigma_common_m"] = np.hypot(out["sigma_common_m"], left)
            out["cov_uu_m2"] += left**2
    if len(telling) < FEWEST:
        return out, time_s, facts
    estimate, time, kept = _estimated(telling, time_s)
    variance = telling.white_m2 + estimate.predictive**2 * np.diag(telling.slow_covariance_m2(time.value))
    inside = telling.difference_m[kept] ** 2 / variance[kept]
    facts |= {
        "estimated": True,
        "left_out": int((~kept).sum()),
        "slow_factor": estimate.value,
        "slow_factor_sigma_log": estimate.sigma_log,
        "slow_factor_predictive": estimate.predictive,
        "time_s": time.value,
        "time_sigma_log": time.sigma_log,
        "normalised_square_after": float(np.mean(inside)),
    }
    before = out["sigma_slow_m"].to_numpy(np.float64)
    out["sigma_slow_m"] = before * estimate.predictive
    out["cov_uu_m2"] += before**2 * (estimate.predictive**2 - 1)
    return out, time.value, facts


def _estimated(
    crossings: Crossings, time_s: float
) -> tuple[Estimate, Estimate, np.ndarray[Any, np.dtype[np.bool_]]]:
    """Factor on the slow sigmas, their time, and which crossings are no outliers."""
    kept = np.ones(len(crossings), dtype=np.bool_)
    spreads = np.log([SPREAD, TIME_SPREAD])
    x = np.zeros(2)
    for _ in range(3):
        of = crossings.part(kept)

        def cost(x: ArrayF, of: Crossings = of) -> float:
            """Twice the negative logarithm of the probability, but for a constant."""
            cov = np.diag(of.white_m2) + np.exp(2 * x[0]) * of.slow_covariance_m2(time_s * np.exp(x[1]))
            lower = cho_factor(cov, lower=True)
            fit = of.difference_m @ cho_solve(lower, of.difference_m)
            return float(fit + 2 * np.log(np.diag(lower[0])).sum() + np.sum((x / spreads) ** 2))

        x = minimize(cost, x, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-4}).x
        slow = np.exp(2 * x[0]) * np.diag(crossings.slow_covariance_m2(time_s * np.exp(x[1])))
        good = crossings.difference_m**2 < _OUTLIER**2 * (crossings.white_m2 + slow)
        if (good == kept).all() or good.sum() < FEWEST:
            break
        kept = good
    sigma = np.sqrt(np.diag(np.linalg.inv(_curvature(cost, x) / 2)))
    factor, time = (
        Estimate(
            value=float(scale * np.exp(value)),
            sigma_log=float(min(s, spread)),
            prior=scale,
            prior_sigma_log=float(spread),
        )
        for scale, value, s, spread in zip((1.0, time_s), x, sigma, spreads, strict=True)
    )
    return factor, time, kept


def _curvature(cost: Any, x: ArrayF, step: float = 0.05) -> ArrayF:
    """Second derivatives (2, 2) of a function; the prior alone holds its eigenvalues from below."""
    e = np.eye(2) * step
    H = np.empty((2, 2))
    for i in range(2):
        for j in range(2):
            H[i, j] = (
                cost(x + e[i] + e[j]) - cost(x + e[i] - e[j]) - cost(x - e[i] + e[j]) + cost(x - e[i] - e[j])
            ) / (4 * step**2)
    values, vectors = np.linalg.eigh((H + H.T) / 2)
    return np.asarray(vectors * np.maximum(values, 2 / np.log(TIME_SPREAD) ** 2) @ vectors.T)


# ---------------------------------------------------------------- steps of days, runs and lines


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """How runs, or days, of soundings agree where their lines cross.

    Parameters
    ----------
    pairs : of ``day``, ``run`` and ``line``: columns a, b (numbers), n, difference_m (median height of b less
        a), sigma_m of it, contradicts (beyond its 95 %; at least three crossings).
    shift_m : (runs,) step of each run, as it is most probable.
    sigma_m : (runs,) what is left of it against the other runs when it is taken off.
    sigma_common_m : (runs,) what is left in the mean of those that crossings tie together, half a 68 %
        interval: the mean of a few days is as uncertain as their scatter says, by Student's distribution
        because they are few, and a run that crosses no other is wrong by the whole of it.
    sigma_line_m : step of a line within its run.
    sigma_run_m, sigma_day_m : how far steps of runs and of days scatter; 0: these agree.
    """

    pairs: dict[str, pd.DataFrame]
    shift_m: ArrayF
    sigma_m: ArrayF
    sigma_common_m: ArrayF
    sigma_line_m: float
    sigma_run_m: float
    sigma_day_m: float

    def told(self, names: dict[str, tuple[str, ...]]) -> tuple[dict[str, Any], list[str]]:
        """Facts for a report and notes, of the names of days, runs and, of a single run, lines."""
        many = len(names["run"]) > 1
        notes = []
        if many:
            of_days = f" on {len(names['day'])} days" if len(names["day"]) > 1 else ""
            notes.append(f"{len(names['run'])} runs{of_days}, compared where they cross")
        facts: dict[str, Any] = {}
        told, others = [], 0
        same = names["run"] == names["day"]
        for kind, skip in (("day", len(names["day"]) < 2), ("run", not many or same), ("line", many)):
            if skip:
                continue
            of = self.pairs[kind]
            of = of.assign(a=[names[kind][k] for k in of["a"]], b=[names[kind][k] for k in of["b"]])
            facts[f"pairs of {kind}s"] = (of if kind != "line" else of[of["contradicts"]]).to_dict("records")
            apart = of[of["contradicts"]].to_dict("records")
            told += apart[:_NAMED]
            others += len(apart[_NAMED:])
        notes += [
            f"{of['b']} lies {abs(of['difference_m']):.3f} m "
            f"{'above' if of['difference_m'] > 0 else 'below'} {of['a']} "
            f"(median of {of['n']} crossings, sigma {of['sigma_m']:.3f} m)"
            for of in told
        ]
        if others:
            notes.append(f"{others} more such pairs: validation.json")
        tied = set(self.pairs["run"]["a"]) | set(self.pairs["run"]["b"])
        alone = [name for k, name in enumerate(names["run"]) if k not in tied]
        if many and alone:
            more = f" and {len(alone) - _NAMED} more" if len(alone) > _NAMED else ""
            notes.append(
                f"{', '.join(alone[:_NAMED])}{more} "
                f"cross{'es' if len(alone) == 1 else ''} no other: nothing tells the level"
            )
        scatter = {k: v for k in names if (v := float(getattr(self, f"sigma_{k}_m"))) > 0}
        for kind, sigma in scatter.items():
            facts[f"sigma_{kind}_m"] = sigma
        if {"day", "run"} & {*scatter}:
            rows = zip(names["run"], self.shift_m, self.sigma_m, self.sigma_common_m, strict=True)
            facts["steps"] = [
                {"run": name, "step_m": float(u), "sigma_m": float(own), "sigma_common_m": float(common)}
                for name, u, own, common in rows
            ]
            kinds = " and ".join(f"{k}s by {scatter[k]:.3f} m" for k in ("day", "run") if k in scatter)
            most = max(facts["steps"], key=lambda of: abs(of["step_m"]))
            notes.append(
                f"steps brought to their mean: they scatter, {kinds} (one sigma); the largest, "
                f"{most['run']}, is {most['step_m']:+.3f} m with a sigma of {most['sigma_m']:.3f} m; "
                f"the mean may be wrong by {np.median(self.sigma_common_m):.3f} m "
                "(one sigma, sigma_common_m of the bed)"
            )
        if "line" in scatter:
            notes.append(
                f"lines differ by {np.sqrt(2) * scatter['line']:.3f} m where they cross (one sigma of the "
                "difference), beside noise and steps: an error of each whole line, in the sigmas"
            )
        return facts, notes


def agreement(
    places_m: ArrayF, height_m: ArrayF, sigma_m: ArrayF, line: ArrayI, run: ArrayI, day: ArrayI | None = None
) -> Agreement:
    """Compare parts of a table, rows (n,) in the order in which they were sounded.

    A difference of two lines at a place is

        d = (day_b + run_b + line_b) - (day_a + run_a + line_a) + noise,

    each a step drawn anew. Their variances, and that of noise beyond the stated one, are the most probable
    ones; steps count only if the differences are clearly foretold better with them than with noise alone.
    Given the variances the steps of days and runs follow by least squares, with these as prior knowledge.

    Parameters
    ----------
    places_m : (n, 2).
    height_m, sigma_m : (n,) and their noise.
    line : (n,) number of the line.
    run : (n,) number of the run, from 0.
    day : (n,) number of the day, from 0; None: one day.
    """
    day = np.zeros(len(run), dtype=np.int64) if day is None else day
    row = np.arange(len(run), dtype=np.float64)
    # a line that goes on after a hole, or in the next run, is another one
    way = np.linalg.norm(np.diff(places_m, axis=0, prepend=places_m[:1]), axis=1)
    apart = way > _HOLE * np.median(way)
    for of in (day, run, line):
        apart |= np.diff(of, prepend=of[:1]) != 0
    piece = np.cumsum(apart)
    found = find_crossings(
        pd.DataFrame(
            {
                **dict.fromkeys(("t_gps_s", "t_even_s"), row),
                **dict(zip(("east_m", "north_m"), places_m.T, strict=True)),
                "up_m": height_m,
                "sigma_white_m": sigma_m,
                "line": piece,
                "used": True,
                "sigma_slow_m": 0.0,
                "sigma_horizontal_m": 0.0,
            }
        )
    )
    steps = _steps(found, {"day": day, "run": run, "line": piece}, time_s=1.0)
    return replace(steps, pairs=steps.pairs | {"line": _pairs(found, line, time_s=1.0)})


def _steps(found: Crossings, parts: dict[str, ArrayI], time_s: float) -> Agreement:
    """Agreement of parts, numbers (n,) of rows, beside slow errors as stated that last ``time_s``."""
    d, day, run = found.difference_m, parts["day"], parts["run"]
    ends = {name: (of[found.at_a], of[found.at_b]) for name, of in parts.items()}
    variance, kept = _variances_of_steps(found, ends, time_s)
    of_day = np.zeros(int(run.max()) + 1, dtype=np.int64)
    of_day[run] = day
    prior = variance["day"] * (of_day[:, None] == of_day) + variance["run"] * np.eye(len(of_day))
    design = np.zeros((len(kept), len(of_day)))
    design[np.arange(len(kept)), ends["run"][1][kept]] += 1.0
    design[np.arange(len(kept)), ends["run"][0][kept]] -= 1.0
    gain = prior @ design.T
    cov_d = found.part(kept).covariance_m2(time_s) + variance["noise"] * np.eye(len(kept)) + gain.T @ design.T
    if "line" in ends:
        cov_d += variance["line"] * _shared(ends["line"], kept)
    weights = np.linalg.solve(cov_d, gain.T).T
    cov = prior - weights @ gain.T
    tied = connected_components(design.T @ design, directed=False)[1]
    mean = (tied[:, None] == tied) / np.bincount(tied)[tied]
    common = np.diag(mean @ cov @ mean)
    # the scatter of so few parts is hardly known itself: two thirds of the means lie within this of the truth
    part = of_day if variance["day"] > 0 else np.arange(len(of_day))
    free = max(len(np.unique(part)) - len(np.unique(tied)), 1)
    return Agreement(
        pairs={name: _pairs(found, of, time_s) for name, of in parts.items()},
        shift_m=weights @ d[kept],
        sigma_m=np.sqrt(np.maximum(np.diag(cov) - common, 0.0)),
        sigma_common_m=np.sqrt(np.maximum(common, 0.0)) * float(student.ppf(_ONE_SIGMA, free)),
        **{f"sigma_{name}_m": float(np.sqrt(variance.get(name, 0.0))) for name in ("day", "run", "line")},
    )


_Ends = tuple[ArrayI, ArrayI]
"""Numbers of the day, the run or the line of both heights of each crossing."""


def _shared(ends: _Ends, kept: ArrayI) -> ArrayF:
    """Covariance (k, k) of differences by steps of variance 1 at their ends."""
    a, b = (of[kept] for of in ends)
    same = [p[:, None] == q for p, q in ((b, b), (a, a), (a, b), (b, a))]
    return 1.0 * same[0] + same[1] - same[2] - same[3]


def _variances_of_steps(
    found: Crossings, ends: dict[str, _Ends], time_s: float
) -> tuple[dict[str, float], ArrayI]:
    """Variances of steps by kind, and of noise that is not stated, and the crossings that are no outliers."""
    d = found.difference_m
    variance = dict.fromkeys((*ends, "noise"), 0.0)
    kept = np.arange(len(d))
    for _ in range(_TRIES):
        if not len(kept):
            break
        some = kept[np.unique(np.linspace(0, len(kept) - 1, min(len(kept), _TELLING)).astype(np.int64))]
        shared: dict[str, ArrayF] = {}
        for name, of in ends.items():
            # days of one run each, runs of one line each: one step
            new = _shared(of, some)
            if new.any() and not any(np.array_equal(new, old) for old in shared.values()):
                shared[name] = new
        usual = max(float(np.mean(d[some] ** 2)) / 2, 1e-12)
        own = found.part(some).covariance_m2(time_s)
        noise, alone = _most_probable(d[some], own, {}, usual)
        steps, together = _most_probable(d[some], own, shared, usual)
        if "line" in shared:
            less = {name: m for name, m in shared.items() if name != "line"}
            fewer, without = _most_probable(d[some], own, less, usual) if less else (noise, alone)
            if without - together < _GAIN_OF_LINES:
                steps, together = fewer, without
        variance = dict.fromkeys(variance, 0.0) | (steps if alone - together > _GAIN else noise)
        # the smallest of a few variances is never found to be nothing
        least = _NOTHING * sum(variance[name] for name in ends)
        variance |= {name: 0.0 for name in ends if variance[name] < least}
        rest = found.white_m2 + found.slow_a_m**2 + found.slow_b_m**2 + variance["noise"]
        rest += 2 * sum(variance[name] for name in ends)
        good = np.flatnonzero(d**2 < _OUTLIER**2 * rest)
        if np.array_equal(good, kept):
            break
        kept = good
    return variance, kept[np.unique(np.linspace(0, len(kept) - 1, min(len(kept), _MOST)).astype(np.int64))]


def _most_probable(
    d: ArrayF, own: ArrayF, shared: dict[str, ArrayF], usual: float
) -> tuple[dict[str, float], float]:
    """Variances of shared steps and of noise, and twice the negative logarithm of the probability.

    Differences (k,) have the covariance ``own`` (k, k) without them.
    """
    names = (*shared, "noise")
    # of few crossings the noise is as stated: nothing tells it from steps
    few = len(d) < FEWEST
    middle = np.log([usual] * len(shared) + [_NOTHING * float(np.diag(own).mean()) if few else usual])
    spread = np.array([_STEP_SPREAD] * len(shared) + [_NOTHING if few else _STEP_SPREAD])

    def cost(x: ArrayF) -> float:
        """Of logarithms of the variances."""
        v = np.exp(np.clip(x, -40.0, 20.0))
        cov = own + v[-1] * np.eye(len(d))
        cov += sum((k * m for k, m in zip(v, shared.values(), strict=False)), 0.0)
        lower = cho_factor(cov, lower=True)
        fit = d @ cho_solve(lower, d)
        return float(fit + 2 * np.log(np.diag(lower[0])).sum() + np.sum(((x - middle) / spread) ** 2))

    simplex = middle + (np.vstack([np.zeros(len(middle)), 2 * np.eye(len(middle))]) - 1) * spread / 3
    found = minimize(
        cost, middle, method="Nelder-Mead", options={"xatol": 0.05, "fatol": 0.05, "initial_simplex": simplex}
    )
    return dict(zip(names, np.exp(found.x).tolist(), strict=True)), float(found.fun)


def _pairs(found: Crossings, part: ArrayI, time_s: float) -> pd.DataFrame:
    """Median differences of pairs of parts, numbers (n,) of rows, and whether they contradict each other."""
    a, b = part[found.at_a], part[found.at_b]
    sign = np.where(a <= b, 1.0, -1.0)
    between = pd.DataFrame({"a": np.minimum(a, b), "b": np.maximum(a, b), "d": found.difference_m * sign})
    between["v"] = found.white_m2
    if found.slow_a_m.any() or found.slow_b_m.any():
        pair = between.groupby(["a", "b"]).ngroup().to_numpy()
        together = found.slow_covariance_m2(time_s) * (pair[:, None] == pair)
        between["v"] += sign * (together @ sign)
    between = between[between["a"] != between["b"]]
    groups = between.groupby(["a", "b"])
    rest = between["d"] - groups["d"].transform("median")
    # the median takes one degree of freedom of each pair
    free = max(1.0 - groups.ngroups / max(len(between), 1), 0.2)
    scatter = NMAD * float(rest.abs().median()) / np.sqrt(free) if len(between) else 0.0
    pairs = groups.agg(n=("d", "size"), difference_m=("d", "median"), v=("v", "mean")).reset_index()
    pairs["sigma_m"] = _MEDIAN * np.maximum(np.sqrt(pairs.pop("v")), scatter) / np.sqrt(pairs["n"])
    pairs["contradicts"] = (pairs["n"] >= _FEWEST_OF_PAIR) & (
        pairs["difference_m"].abs() > _OUTSIDE * pairs["sigma_m"]
    )
    return pairs
