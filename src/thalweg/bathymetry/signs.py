"""What no water does, asked about: signs, directions and levels that files of others seldom state.

Water runs downhill, its bed is deepest away from both sides, its shores stand at its level and above its bed.
Where data say otherwise they may be right, for there are bars, weirs and floods: nothing is refused here, but
what was seen is said, and which option settles it.
"""

from typing import Any, Final

import numpy as np
import pandas as pd
import shapely
from scipy.stats import binom, linregress, spearmanr

from thalweg.bathymetry.variogram import HalfWidths
from thalweg.core import ArrayF

_FEWEST: Final = 5
"""Stretches that say something of a reach."""
_IN_A_PART: Final = 2
"""Soundings that a third of a stretch needs."""
_CHANCE: Final = 0.01
"""Share of beds without any shape that are asked about."""
_ABOVE: Final = 0.05
"""A larger share of soundings above the shore beside them is no bar alone."""
_LEVELS_APART_M: Final = 0.5
_CERTAIN: Final = 4.0
"""A rise so many times its standard deviation."""
_ALIKE: Final = 0.5


def asked_of_river(table: pd.DataFrame, half_widths_m: HalfWidths, *, depths: bool) -> list[str]:
    """Sentences about a river whose bed rises in its middle, or that flows uphill.

    Parameters
    ----------
    table : kind ``bed_observations``; places of the shores are of the source ``bank``.
    half_widths_m : of the river.
    depths : the table held depths, whose heights do not tell a fall.
    """
    notes = []
    sounding = (table["source"] == "sounding").to_numpy()
    s, n, up = (table[name].to_numpy(np.float64) for name in ("s_m", "n_m", "up_m"))
    left, right = half_widths_m(s)
    width = float(np.nanmedian(left + right))
    part = np.digitize(np.where(n > 0, n / left, n / right), (-1 / 3, 1 / 3))
    stretch = np.floor((s - s.min()) / width)
    groups = pd.DataFrame({"up": up, "s": s})[sounding].groupby([stretch[sounding], part[sounding]])["up"]
    thirds = groups.median()[groups.size() >= _IN_A_PART].unstack()
    if {0, 1, 2} <= set(thirds.columns) and len(thirds := thirds[[0, 1, 2]].dropna()) >= _FEWEST:
        rise = (thirds[1] - (thirds[0] + thirds[2]) / 2).to_numpy()
        lean = float(np.median(np.abs(thirds[0] - thirds[2]) / 2))
        risen = int((rise > 0).sum())
        # a bar on one side leans; what rises towards the middle rises by more than it leans
        if np.median(rise) > lean and binom.sf(risen - 1, len(rise), 0.5) < _CHANCE:
            kind, option = ("heights", "--height") if depths else ("depths", "--depth")
            notes.append(
                f"the bed rises in mid-river: in {risen} of {len(rise)} stretches the middle is above the "
                f"sides, by {np.median(rise):.2f} m in the median. Are these {kind}? Then {option}; bars all "
                "along the river look alike"
            )
    for what, of, cure in (
        ("banks rise", ~sounding, "reverse --centre-line, or exchange the sides in --banks"),
        (
            "bed rises",
            sounding & (not depths),
            "reverse --centre-line; a bed that rises to a weir or a bar looks alike",
        ),
    ):
        middle = pd.DataFrame({"s": s, "up": up})[of].groupby(stretch[of]).median()
        if len(middle) < _FEWEST:
            continue
        line = linregress(middle["s"], middle["up"])
        rise = line.slope * float(np.ptp(middle["s"]))
        left_m = float(np.std(middle["up"] - line.intercept - line.slope * middle["s"]))
        if rise > 2 * left_m and line.slope > _CERTAIN * line.stderr and rise > 0.01:
            notes.append(
                f"the river flows uphill: along the centre line the {what} {rise:.2f} m over "
                f"{np.ptp(middle['s']):,.0f} m. If it flows the other way, {cure}"
            )
            break
    return notes


def asked_of_lake(outline: Any, places_m: ArrayF, height_m: ArrayF, *, depths: bool) -> list[str]:
    """A sentence about a lake whose bed rises away from its shores.

    Parameters
    ----------
    outline : polygon of the water, islands left out.
    places_m, height_m : (n, 2) and (n,) of the soundings.
    depths : the table held depths.
    """
    if len(height_m) < _FEWEST or not np.ptp(height_m):
        return []
    from_shore = shapely.distance(shapely.boundary(outline), shapely.points(places_m))
    alike = float(spearmanr(from_shore, height_m).statistic)
    if not alike > _ALIKE:
        return []
    which = ("heights", "--height") if depths else ("depths", "--depth")
    return [
        f"the bed rises away from the shores (rank correlation {alike:.2f}). Are these {which[0]}? Then "
        f"{which[1]}; a shoal in the middle looks alike"
    ]


def asked_of_shores(table: pd.DataFrame, level_m: float | None) -> list[str]:
    """Sentences about shores below the bed beside them, or below the water.

    Parameters
    ----------
    table : kind ``bed_observations``.
    level_m : height of the water that soundings were counted from, if the shores tell their own.
    """
    shore = table[table["source"] == "bank"].sort_values("s_m")
    bed = table[table["source"] == "sounding"]
    if not len(shore):
        return []
    notes = []
    # both sides within a station stand at one level
    beside = np.interp(bed["s_m"], shore["s_m"], shore["up_m"].rolling(4, min_periods=1, center=True).mean())
    above = bed["up_m"].to_numpy() - beside
    if (share := float(np.mean(above > 3 * bed["sigma_white_m"]))) > _ABOVE:
        notes.append(
            f"{share:.0%} of the soundings lie above the shore beside them, by up to {above.max():.2f} m: "
            "are both in one vertical system? Look at --level and at the heights of --banks"
        )
    higher = 0.0 if level_m is None else level_m - float(shore["up_m"].median())
    if higher > _LEVELS_APART_M:
        notes.append(
            f"the water stands {higher:.2f} m above the shores in the median: are its levels and the heights "
            "of the shores in one vertical system? Look at --level, --levels and the heights of --banks"
        )
    return notes
