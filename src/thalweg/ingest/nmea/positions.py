"""Positions of NMEA epochs: one a time, with the standard deviations of GST."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.types import ArrayF, ArrayI
from thalweg.ingest.integrity import IntegrityReport
from thalweg.ingest.schemas import GNSS_POSITION

_NAN: Final = float("nan")
_RANK: Final = {"GGA": 0, "RMC": 1, "GLL": 2}

Seconds = Callable[[ArrayF, ArrayF, ArrayF], ArrayF]
"""Second of the day, midnights since the start, day of midnight 0 -> ``t_gps_s``."""


@dataclass(slots=True)
class Fix:
    """Position of one sentence."""

    kind: str
    lat_deg: float
    lon_deg: float
    h_ell_m: float = _NAN
    fix: str = "none"
    n_sats: int = -1
    age_s: float = _NAN
    second: float = _NAN
    midnights: int = 0
    day_zero: float = _NAN
    file: int = 0
    """Number of the file that holds the sentence."""


def position_table(
    fixes: list[Fix], sigmas: list[tuple[float, ...]], seconds: Seconds, report: IntegrityReport
) -> tuple[pd.DataFrame, ArrayI]:
    """Table of kind ``gnss_position``, one row an epoch, and the number of the file of each row.

    Parameters
    ----------
    fixes : positions in the order of the log.
    sigmas : of GST: second of the day, midnights, semi-major and semi-minor standard deviation (m), its
        orientation (degrees from true north), standard deviations of latitude, longitude, height (m).
    seconds : time onto the GPS axis.
    report : takes the counts.
    """
    kept: list[Fix] = []
    for fix in fixes:
        last = kept[-1] if kept else None
        if (
            last is None
            or fix.second != fix.second
            or (fix.second, fix.midnights) != (last.second, last.midnights)
        ):
            kept.append(fix)
        elif _RANK[fix.kind] < _RANK[last.kind]:
            kept[-1] = fix
    if fixes:
        report.count("position_sentences", len(fixes))
    n = len(kept)
    by_time = {(s[0], int(s[1])): s[2:] for s in sigmas if s[0] == s[0]}
    none = (_NAN,) * 6
    gst = np.array([by_time.get((f.second, f.midnights), none) for f in kept], dtype=np.float64).reshape(
        -1, 6
    )
    major, minor, angle = gst[:, 0], gst[:, 1], np.deg2rad(gst[:, 2])
    sigma_north, sigma_east = gst[:, 3], gst[:, 4]
    cov_en = (major**2 - minor**2) * np.sin(angle) * np.cos(angle)
    # An ellipse that contradicts the standard deviations by more than the rounding to 1 mm is not used.
    bound = sigma_north * sigma_east
    inside = np.abs(cov_en) <= bound
    lost = int(np.count_nonzero(np.isfinite(cov_en) & ~inside))
    if lost:
        report.lose("contradicting_error_ellipses", lost)
    columns = {name: np.array([getattr(f, name) for f in kept], dtype=np.float64) for name in _FLOATS}
    unknown = np.full(n, np.nan)
    table = pd.DataFrame(
        {
            "t_gps_s": seconds(columns["second"], columns["midnights"], columns["day_zero"]),
            "lat_deg": columns["lat_deg"],
            "lon_deg": columns["lon_deg"],
            "h_ell_m": columns["h_ell_m"],
            "fix": pd.Series([f.fix for f in kept], dtype=object),
            "n_sats": np.array([f.n_sats for f in kept], dtype=np.int32),
            "sigma_east_m": sigma_east,
            "sigma_north_m": sigma_north,
            "sigma_up_m": gst[:, 5],
            "cov_en_m2": np.where(inside, cov_en, np.nan),
            "cov_eu_m2": unknown,
            "cov_nu_m2": unknown,
            "age_s": columns["age_s"],
            "ratio": unknown,
        }
    )
    bare = sum(f.kind == "GGA" and f.h_ell_m != f.h_ell_m for f in kept)
    if bare:
        report.note(f"{bare} GGA sentences have no geoid separation: no ellipsoidal height can be given.")
    return table[list(GNSS_POSITION.names)], np.array([f.file for f in kept], dtype=np.int64)


_FLOATS: Final = ("second", "midnights", "day_zero", "lat_deg", "lon_deg", "h_ell_m", "age_s")
