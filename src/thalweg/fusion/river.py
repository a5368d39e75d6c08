"""The river in the map: flow coordinates, banks and water level, in the grid and the heights of the model.

Bed and banks come in wcs, terrain models and exports are in a map grid. Between both stand the local frame
and the projection; the flow line turns places along and across the river into either.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from pyproj import CRS

from thalweg.core import ArrayB, ArrayF, CoverageError, InputError, LocalFrame
from thalweg.fusion.dtm import separation_at

SIDES: Final = ("left", "right")
BANK_COLUMNS: Final = ("side", "s_m", "east_m", "north_m", "up_m", "sigma_across_m", "seen")


class Flow(Protocol):
    """What is needed of a flow line (`thalweg.bathymetry.FlowLine`)."""

    @property
    def length_m(self) -> float:
        """Length of the centre line."""

    def to_flow(self, places: ArrayF, /) -> tuple[ArrayF, ArrayF, ArrayB]:
        """Distance along, offset to the left, and fold (m,) of places (m, 2) in wcs."""

    def to_map(self, s_m: ArrayF, n_m: ArrayF, /) -> ArrayF:
        """East, north (m, 2) in wcs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class River:
    """Flow line and banks with their place in the map.

    Parameters
    ----------
    flow : the flow line.
    banks : table of banks, columns `BANK_COLUMNS`.
    frame : wcs.
    crs : the map grid.
    separation : height of the zero of the model's heights above the ellipsoid, as of `Dtm`.

    Raises
    ------
    InputError : a side is missing, crosses the other, or columns are missing.
    """

    flow: Flow
    banks: pd.DataFrame
    frame: LocalFrame
    crs: CRS
    separation: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        missing = [c for c in BANK_COLUMNS if c not in self.banks.columns]
        if missing:
            raise InputError(
                f"banks without {', '.join(missing)}", expected=f"columns {', '.join(BANK_COLUMNS)}"
            )
        for side in SIDES:
            if (self.banks["side"] == side).sum() < 2:
                raise InputError(
                    f"no {side} bank line", expected="both banks, at least two points each",
                    cure="Look at the coverage of the banks, or give logs.bank_lines",
                )  # fmt: skip
        s_m = np.linspace(0.0, self.flow.length_m, 200)
        left, right = self.offsets_m(s_m)
        if (left <= right).any():
            at = float(s_m[np.argmax(left <= right)])
            raise InputError(
                f"the left bank lies right of the right one at {at:.0f} m along the river",
                expected="left and right as one looks downstream",
                where="banks",
                cure="Are the banks swapped, or does the centre line run upstream?",
            )

    def offsets_m(self, s_m: ArrayLike) -> tuple[ArrayF, ArrayF]:
        """Offsets n (m,) of the left and of the right bank at distances s (m,) along the river."""
        return self._of_side("left", s_m), self._of_side("right", s_m)

    @property
    def span_m(self) -> tuple[float, float]:
        """Part of the flow line beside which both banks are known."""
        ends = []
        for side in SIDES:
            places = self.banks.loc[self.banks["side"] == side, ["east_m", "north_m"]].to_numpy(float)
            s = self.flow.to_flow(places)[0]
            ends.append((float(s.min()), float(s.max())))
        return max(a for a, _ in ends), min(b for _, b in ends)

    def _of_side(self, side: str, s_m: ArrayLike) -> ArrayF:
        rows = self.banks[self.banks["side"] == side]
        s, n, _ = self.flow.to_flow(rows[["east_m", "north_m"]].to_numpy(float))
        order = np.argsort(s)
        return np.asarray(np.interp(np.asarray(s_m, float), s[order], n[order]))

    def level_m(self, s_m: ArrayLike) -> ArrayF:
        """Height (m,) of the water at distances along the river, in the heights of the model."""
        shape, s = np.shape(s_m), np.atleast_1d(np.asarray(s_m, float))
        rows = self.banks.sort_values("s_m")
        up = np.interp(s, rows["s_m"], rows["up_m"].rolling(5, center=True, min_periods=1).mean())
        place = self.flow.to_map(s, np.zeros_like(s))
        found = self.frame.to_map(np.column_stack([place, up]), self.crs)
        return np.asarray(found[:, 2] - separation_at(self.separation, found)).reshape(shape)

    def to_map(self, s_m: ArrayLike, n_m: ArrayLike) -> ArrayF:
        """East, north (m, 2) in the map grid of places in flow coordinates."""
        s, n = (np.ravel(a) for a in np.broadcast_arrays(np.asarray(s_m, float), np.asarray(n_m, float)))
        places = self.flow.to_map(s, n)
        up = np.full(len(places), float(self.banks["up_m"].mean()))
        return np.asarray(self.frame.to_map(np.column_stack([places, up]), self.crs)[:, :2])

    def to_flow(self, places_m: ArrayF) -> tuple[ArrayF, ArrayF, ArrayB]:
        """Flow coordinates s, n and fold (m,) of places (m, 2) in the map grid."""
        height = self.frame.h_ell_m + float(self.banks["up_m"].mean())
        local = self.frame.from_map(np.column_stack([places_m, np.full(len(places_m), height)]), self.crs)
        return self.flow.to_flow(local[:, :2])

    def shore_m(self) -> ArrayF:
        """Places (k, 3) of the water line in wcs."""
        return self.banks[["east_m", "north_m", "up_m"]].to_numpy(float)

    def outline_m(self) -> ArrayF:
        """Water line (k, 2) in the map grid: left bank downstream, right bank upstream."""
        sides = []
        for side, sign in zip(SIDES, (1, -1), strict=True):
            rows = self.banks[self.banks["side"] == side].sort_values("s_m")
            local = rows[["east_m", "north_m", "up_m"]].to_numpy(float)
            sides.append(self.frame.to_map(local, self.crs)[::sign, :2])
        return np.concatenate(sides)


def read_river(
    flow: Flow,
    banks: Path,
    frame: LocalFrame,
    crs: CRS,
    *,
    separation: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> River:
    """The river from its flow line and ``banks.csv``.

    Raises
    ------
    InputError : no such file, or banks that cannot be used.
    """
    if not banks.is_file():
        raise InputError("no such file", expected="bank lines (CSV)", where=banks)
    table = pd.read_csv(banks)
    values: Any = table.reindex(columns=["s_m", "east_m", "north_m", "up_m"]).to_numpy(float)
    if len(table) == 0 or not np.isfinite(values).all():
        raise CoverageError("banks with empty places", expected="finite numbers", where=banks)
    return River(flow=flow, banks=table, frame=frame, crs=crs, separation=separation)
