"""A river of formulas: flow line, bed, banks, and what sensors would give of them."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from pyproj import CRS

from thalweg.core import LocalFrame

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=150.0)
GRID = CRS.from_epsg(25833)
LEVEL_UP_M = -2.0
HALF_WIDTH_M = 6.0
DEPTH_M = 2.0


@dataclass(frozen=True)
class Arc:
    """A flow line on a circle; `radius_m` infinite: straight to the east."""

    length_m: float = 80.0
    radius_m: float = 60.0

    def to_map(self, s_m, n_m):
        s, n = np.broadcast_arrays(np.asarray(s_m, float), np.asarray(n_m, float))
        if np.isinf(self.radius_m):
            return np.column_stack([s.ravel(), n.ravel()])
        angle, radius = s.ravel() / self.radius_m, self.radius_m - n.ravel()
        return np.column_stack([radius * np.sin(angle), self.radius_m - radius * np.cos(angle)])

    def to_flow(self, places):
        places = np.asarray(places, float)
        if np.isinf(self.radius_m):
            s, n = places[:, 0], places[:, 1]
        else:
            s = self.radius_m * np.arctan2(places[:, 0], self.radius_m - places[:, 1])
            n = self.radius_m - np.hypot(places[:, 0], self.radius_m - places[:, 1])
        fold = (s < 0) | (s > self.length_m) | (np.abs(n / self.radius_m) >= 0.9)
        return s, n, fold


def bed_up_m(s_m, n_m):
    """Parabola below the water with its thalweg in the middle, banks of slope 1:2 above, plain beyond."""
    n = np.abs(np.asarray(n_m, float)) + 0.0 * np.asarray(s_m, float)
    below = LEVEL_UP_M - DEPTH_M * (1 - (n / HALF_WIDTH_M) ** 2)
    above = LEVEL_UP_M + np.minimum(0.5 * (n - HALF_WIDTH_M), 1.5)
    return np.where(n < HALF_WIDTH_M, below, above)


@pytest.fixture
def arc():
    return Arc()


@pytest.fixture
def banks(arc):
    """The table of banks.csv."""
    s = np.arange(0.0, arc.length_m + 0.1, 2.0)
    rows = []
    for side, n in (("left", HALF_WIDTH_M), ("right", -HALF_WIDTH_M)):
        place = arc.to_map(s, np.full(len(s), n))
        rows.append(
            pd.DataFrame(
                {
                    "side": side,
                    "s_m": s,
                    "east_m": place[:, 0],
                    "north_m": place[:, 1],
                    "up_m": LEVEL_UP_M,
                    "sigma_across_m": 0.1,
                    "seen": True,
                }
            )
        )
    return pd.concat(rows, ignore_index=True)
