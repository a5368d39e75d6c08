"""Soundings of the twin against the truth of each ping: errors by depth, and whether reasons are right."""

from itertools import pairwise
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import ArrayB, ArrayF, CoverageError, root_mean_square

DEPTHS_M: Final = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0, np.inf)
"""Limits of the classes of depth below the transducer."""
SILENT: Final = ("no bottom", "turn")
"""Effects that leave no depth."""
LEAST_BLUNDER_SIGMAS: Final = 4.0
"""A depth that its faults displace by less than so many sigmas is none that a filter must find."""
_PARTS: Final = ("white", "slow", "common")
SAME_PING: Final = 0.45
"""A sounding and a ping are the same within this share of the time between pings."""


def compare_soundings(
    soundings: pd.DataFrame, stamp_gps_s: ArrayF, truth: pd.DataFrame
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Soundings against the places that their pings truly met.

    Parameters
    ----------
    soundings : table kind ``soundings``.
    stamp_gps_s : (m,) stamps of the pings chosen of the log, to which ``row`` of the soundings points.
    truth : table kind ``twin_soundings`` of the same log.

    Returns
    -------
    errors : a row a class of true depth, and first one for all: n, bias_m and rmse_m of the height of
        soundings that are used and were disturbed by nothing, predicted_white_m, predicted_slow_m,
        predicted_common_m (root mean squares), normalised_square with all three parts, outside_95 (share).
        Heights are compared where the beam's axis meets the bed, so errors of the place are in them on slopes
        alone.
    reasons : a row an effect: pings that it spoilt, left_out (for any reason) and their share; the last row
        ``none`` holds the soundings that nothing spoilt, and those of them that were left out nevertheless.

    Raises
    ------
    CoverageError : no sounding belongs to a ping of the truth.
    """
    known = truth.sort_values("stamp_gps_s", kind="stable").reset_index(drop=True)
    stamp = known["stamp_gps_s"].to_numpy(np.float64)
    # The processing removes what it believes to be lag and latency, so the stamps of the log tell.
    t = stamp_gps_s[soundings["row"].to_numpy(np.int64)]
    step = float(np.median(np.diff(stamp))) if len(stamp) > 1 else 0.0
    at = np.clip(np.searchsorted(stamp, t), 1, max(len(stamp) - 1, 1))
    at = np.where(t - stamp[at - 1] < stamp[at] - t, at - 1, at)
    same = np.isfinite(t) & (np.abs(t - stamp[at]) <= SAME_PING * step)
    if not same.any():
        raise CoverageError(
            f"none of {len(t):,} soundings belongs to one of {len(stamp):,} true pings",
            expected="soundings and truth of the same log",
            where="soundings of the twin",
        )
    found, ping = soundings[same].reset_index(drop=True), known.iloc[at[same]].reset_index(drop=True)
    sigma = np.sqrt(sum(found[f"sigma_{part}_m"].to_numpy(np.float64) ** 2 for part in _PARTS))
    effect = ping["effect"].to_numpy().astype(str)
    gross = np.abs(ping["blunder_m"].to_numpy(np.float64)) > LEAST_BLUNDER_SIGMAS * np.nan_to_num(sigma)
    faulty = np.isin(effect, SILENT) | ~np.isfinite(ping["stated_m"].to_numpy()) | gross
    used = found["used"].to_numpy(dtype=np.bool_)
    error = (found["up_m"] - ping["up_m"]).to_numpy(np.float64)
    quiet = used & ~faulty & (effect == "") & np.isfinite(error)
    depth = ping["depth_m"].to_numpy(np.float64)
    rows = [_row("all", error, sigma, found, quiet)]
    for low, high in pairwise(DEPTHS_M):
        inside = quiet & (depth >= low) & (depth < high)
        if inside.any():
            rows.append(_row(f"{low:g} to {high:g} m", error, sigma, found, inside))
    scores = []
    for name in np.unique(effect[faulty]):
        of = faulty & (effect == name)
        scores.append((name or "filters of the instrument", int(of.sum()), int((of & ~used).sum())))
    scores.append(("none", int((~faulty).sum()), int((~faulty & ~used).sum())))
    reasons = pd.DataFrame(scores, columns=["effect", "pings", "left_out"])
    return pd.DataFrame(rows), reasons.assign(share=reasons["left_out"] / reasons["pings"].clip(lower=1))


def _row(name: str, error: ArrayF, sigma: ArrayF, soundings: pd.DataFrame, of: ArrayB) -> dict[str, Any]:
    e, s = error[of], sigma[of]
    if not len(e):
        e, s = np.full(1, np.nan), np.ones(1)
    parts = {f"predicted_{part}_m": root_mean_square(soundings.loc[of, f"sigma_{part}_m"]) for part in _PARTS}
    return {
        "depth": name,
        "n": int(of.sum()),
        "bias_m": float(np.mean(e)),
        "rmse_m": root_mean_square(e),
        **parts,
        "normalised_square": float(np.mean((e / s) ** 2)),
        "outside_95": float(np.mean(np.abs(e) > 1.96 * s)),
    }
