"""Tables out of decoded SBP messages."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
from pyproj import Transformer

from thalweg.core.frames import R_ENU_NED, rotation_ecef_enu
from thalweg.core.tables import column, frame_of, table_kind
from thalweg.core.timescales import gps_from_week
from thalweg.core.types import AnyArray, ArrayF
from thalweg.ingest.sbp import messages as sm
from thalweg.ingest.sbp.records import Messages, SbpRecords
from thalweg.ingest.sbp.time import WeekTrack, possible_week
from thalweg.ingest.schemas import GNSS_POSITION

_F = pa.float64()
_T = column("t_gps_s", _F, "s", "adjusted standard GPS time; NaN if the log has no GPS week")
_N_SATS = column("n_sats", pa.int32(), "1", "satellites used")

GNSS_BASELINE = table_kind(
    "gnss_baseline",
    1,
    [
        _T,
        column("north_m", _F, "m", "rover minus base, north at the base"),
        column("east_m", _F, "m", "rover minus base, east"),
        column("down_m", _F, "m", "rover minus base, down"),
        column("fix", pa.string(), "1", "single, sbas, dgnss, float, fixed, dead_reckoning"),
        _N_SATS,
        column("sigma_h_m", _F, "m", "standard deviation, horizontal; NaN if unknown"),
        column("sigma_v_m", _F, "m", "standard deviation, vertical; NaN if unknown"),
    ],
)

GNSS_VELOCITY = table_kind(
    "gnss_velocity",
    1,
    [
        _T,
        column("v_north_mps", _F, "m/s", "velocity north"),
        column("v_east_mps", _F, "m/s", "velocity east"),
        column("v_down_mps", _F, "m/s", "velocity down"),
        _N_SATS,
        column("sigma_h_mps", _F, "m/s", "standard deviation, horizontal; NaN if unknown"),
        column("sigma_v_mps", _F, "m/s", "standard deviation, vertical; NaN if unknown"),
    ],
)

GNSS_EVENT = table_kind(
    "gnss_event",
    1,
    [
        _T,
        column("pin", pa.int32(), "1", "number of the pin"),
        column("level", pa.int32(), "1", "level after the edge: 1 rising, 0 falling"),
        column("time_good", pa.bool_(), "1", "the receiver states a time better than 1 us"),
    ],
)

POSITION_GROUPS: Final = (
    (sm.POS_LLH_COV, sm.POS_LLH),
    (sm.POS_ECEF_COV, sm.POS_ECEF),
    (sm.POS_LLH_COV_GNSS, sm.POS_LLH_GNSS),
    (sm.POS_LLH_DEP_A,),
    (sm.POS_ECEF_DEP_A,),
)
"""Sources of positions by preference; inside a group the one with covariances comes first."""

POSITION_KINDS: Final = tuple(kind for group in POSITION_GROUPS for kind in group)
_ECEF_KINDS: Final = frozenset({sm.POS_ECEF, sm.POS_ECEF_COV, sm.POS_ECEF_DEP_A})


@dataclass(slots=True, kw_only=True)
class Dropped:
    """Rows that a table does not hold, by reason."""

    counts: dict[str, int] = field(default_factory=dict)

    def add(self, reason: str, n: int) -> None:
        """Count rows."""
        if n:
            self.counts[reason] = self.counts.get(reason, 0) + int(n)


def positions_table(
    records: SbpRecords, track: WeekTrack, sender: int, dropped: Dropped
) -> tuple[pd.DataFrame, tuple[int, ...]]:
    """Positions with a fix as table kind ``gnss_position``, and the message types that they are from.

    MsgPosLLH and MsgPosLLHCov of one epoch give one row, with the covariances of the latter. Without them
    the sigmas are the accuracies that MsgPosLLH states: the horizontal one is that of the worst direction
    (it equals the longer axis of the error ellipse where a receiver sends both), and is taken for both axes.
    """
    for group in POSITION_GROUPS:
        lost = Dropped()
        parts = [_positions_of(records.of(kind, sender), kind, track, lost) for kind in group]
        if any(part["t_gps_s"].size for part in parts):
            break
    else:
        _count_without_fix(records, sender, dropped)
        return frame_of(GNSS_POSITION, dict.fromkeys(GNSS_POSITION.names, np.empty(0))), ()
    for reason in ("without_fix", "impossible"):
        # both messages of an epoch say the same: counting them once each would double the number
        worst = max((lost.counts.get(f"{reason} {kind}", 0) for kind in group), default=0)
        dropped.add(f"positions_{reason}_dropped", worst)
    rank = np.concatenate([np.full(part["t_gps_s"].size, i) for i, part in enumerate(parts)])
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    if not track.number.size:  # epochs cannot be told apart: one message type only
        keep = np.flatnonzero(rank == rank.min())
    else:
        key = np.round(columns["t_gps_s"] * 1000.0)
        best = np.lexsort((columns["number"], rank))
        _, first = np.unique(key[best], return_index=True)
        keep = best[first]
        repeated = max(int((rank == i).sum()) - np.unique(key[rank == i]).size for i in range(len(parts)))
        dropped.add("positions_repeated_dropped", repeated)
    keep = keep[np.argsort(columns["number"][keep], kind="stable")]
    columns = {name: column_[keep] for name, column_ in columns.items()}
    columns["age_s"] = _age(records, track, sender, columns["t_gps_s"])
    used = tuple(kind for i, kind in enumerate(group) if (rank[keep] == i).any())
    return frame_of(GNSS_POSITION, {n: columns[n] for n in GNSS_POSITION.names}), used


def _count_without_fix(records: SbpRecords, sender: int, dropped: Dropped) -> None:
    sizes = [records.of(kind, sender).number.size for kind in POSITION_KINDS]
    dropped.add("positions_without_fix_dropped", max(sizes, default=0))


def _positions_of(messages: Messages, kind: int, track: WeekTrack, lost: Dropped) -> dict[str, AnyArray]:
    """Columns of one message type, with the number of the message."""
    names = sm.FIX_DEP_A if kind in sm.DEP_A else sm.FIX
    words = names[messages.fields["flags"] & 7]
    first = "x" if kind in _ECEF_KINDS else "lat"
    empty = messages.fields[first] == 0  # a receiver without solution sends zeros
    with_fix = np.asarray((words != "none") & ~empty)
    lost.add(f"without_fix {kind}", int((~with_fix).sum()))
    m = messages.take(with_fix)
    values = _geodetic(m, kind)
    t = track.times(m)
    values |= {"t_gps_s": t, "fix": words[with_fix], "n_sats": m.fields["n_sats"], "number": m.number}
    possible = (np.abs(values["lat_deg"]) <= 90) & (np.abs(values["lon_deg"]) <= 360)
    possible &= np.isfinite(values["h_ell_m"]) & ~(np.isnan(t) & bool(track.number.size))
    lost.add(f"impossible {kind}", int((~possible).sum()))
    nan = np.full(m.number.size, np.nan)
    every = {**dict.fromkeys(GNSS_POSITION.names, nan), **values}
    return {name: np.asarray(value)[possible] for name, value in every.items()}


def _geodetic(m: Messages, kind: int) -> dict[str, Any]:
    """Latitude, longitude, height, sigmas and covariances in east-north-up."""
    f = m.fields
    if kind in _ECEF_KINDS:
        to_geodetic = Transformer.from_crs(4978, 4979, always_xy=True, allow_ballpark=False)
        lon, lat, h = to_geodetic.transform(f["x"], f["y"], f["z"])
        out = {"lat_deg": np.asarray(lat), "lon_deg": np.asarray(lon), "h_ell_m": np.asarray(h)}
        if kind == sm.POS_ECEF_COV:
            R = rotation_ecef_enu(np.where(np.isfinite(lat), lat, 0.0), np.where(np.isfinite(lon), lon, 0.0))
            C = np.swapaxes(R, -1, -2) @ _matrix(f, "xyz") @ R
            out |= _sigmas(C)
        return out
    out = {"lat_deg": f["lat"], "lon_deg": f["lon"], "h_ell_m": f["height"]}
    if kind in (sm.POS_LLH_COV, sm.POS_LLH_COV_GNSS):
        C = _matrix(f, "ned")
        return out | _sigmas(R_ENU_NED @ C @ R_ENU_NED.T)
    horizontal, vertical = _millimetres(f["h_accuracy"]), _millimetres(f["v_accuracy"])
    return out | {"sigma_east_m": horizontal, "sigma_north_m": horizontal, "sigma_up_m": vertical}


def _matrix(f: AnyArray, axes: str) -> ArrayF:
    """Covariance matrices (n, 3, 3) from the six fields of a message."""
    C = np.empty((f.size, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            C[:, i, j] = C[:, j, i] = f[f"cov_{axes[i]}_{axes[j]}"]
    return C


def _sigmas(C_enu: ArrayF) -> dict[str, ArrayF]:
    """Columns of ``gnss_position``; NaN where a variance is not positive (not known)."""
    variance = np.diagonal(C_enu, axis1=1, axis2=2)
    known = np.asarray(np.isfinite(C_enu).all(axis=(1, 2)) & (variance > 0).all(axis=1))
    C = np.where(known[:, None, None], C_enu, np.nan)
    return {
        "sigma_east_m": np.sqrt(C[:, 0, 0]),
        "sigma_north_m": np.sqrt(C[:, 1, 1]),
        "sigma_up_m": np.sqrt(C[:, 2, 2]),
        "cov_en_m2": C[:, 0, 1],
        "cov_eu_m2": C[:, 0, 2],
        "cov_nu_m2": C[:, 1, 2],
    }


def _millimetres(value: AnyArray) -> ArrayF:
    """Accuracy in metres; 0 is not implemented and 65535 out of range, both unknown."""
    return np.where((value > 0) & (value < 0xFFFF), value * 1e-3, np.nan)


def _age(records: SbpRecords, track: WeekTrack, sender: int, t_gps_s: AnyArray) -> ArrayF:
    """Age of the corrections from the MsgAgeCorrections of the same time, NaN where there is none."""
    age = records.of(sm.AGE, sender)
    age = age.take(age.fields["age"] != 0xFFFF)
    out = np.full(t_gps_s.size, np.nan)
    if age.number.size and out.size:
        key, first = np.unique(np.round(track.times(age) * 1000.0), return_index=True)
        wanted = np.round(t_gps_s * 1000.0)
        at = np.minimum(np.searchsorted(key, wanted), key.size - 1)
        same = key[at] == wanted
        out[same] = age.fields["age"][first][at[same]] * 0.1
    return out


def baselines_table(records: SbpRecords, track: WeekTrack, sender: int) -> pd.DataFrame:
    """Baselines with a fix as table kind ``gnss_baseline``."""
    kind = sm.BASELINE_NED if records.of(sm.BASELINE_NED, sender).number.size else sm.BASELINE_NED_DEP_A
    m = records.of(kind, sender)
    words = (sm.FIX_DEP_A if kind in sm.DEP_A else sm.FIX)[m.fields["flags"] & 7]
    good = np.asarray(words != "none")
    m = m.take(good)
    return _once(
        frame_of(
            GNSS_BASELINE,
            {
                "t_gps_s": track.times(m),
                "north_m": m.fields["n"] * 1e-3,
                "east_m": m.fields["e"] * 1e-3,
                "down_m": m.fields["d"] * 1e-3,
                "fix": words[good],
                "n_sats": m.fields["n_sats"],
                "sigma_h_m": _millimetres(m.fields["h_accuracy"]),
                "sigma_v_m": _millimetres(m.fields["v_accuracy"]),
            },
        )
    )


def velocities_table(records: SbpRecords, track: WeekTrack, sender: int) -> pd.DataFrame:
    """Valid velocities as table kind ``gnss_velocity``."""
    kind = sm.VEL_NED if records.of(sm.VEL_NED, sender).number.size else sm.VEL_NED_DEP_A
    m = records.of(kind, sender)
    m = m.take(np.asarray((m.fields["flags"] & 7 != 0) | (kind in sm.DEP_A)))
    return _once(
        frame_of(
            GNSS_VELOCITY,
            {
                "t_gps_s": track.times(m),
                "v_north_mps": m.fields["n"] * 1e-3,
                "v_east_mps": m.fields["e"] * 1e-3,
                "v_down_mps": m.fields["d"] * 1e-3,
                "n_sats": m.fields["n_sats"],
                "sigma_h_mps": _millimetres(m.fields["h_accuracy"]),
                "sigma_v_mps": _millimetres(m.fields["v_accuracy"]),
            },
        )
    )


def events_table(records: SbpRecords) -> pd.DataFrame:
    """External events (camera triggers, PPS) as table kind ``gnss_event``; NaN where the week is not set."""
    f = records.of(sm.EVENT).fields
    known = possible_week(records.of(sm.EVENT))
    t = gps_from_week(f["wn"], f["tow"] * 1e-3) + f["ns"] * 1e-9
    return _once(
        frame_of(
            GNSS_EVENT,
            {
                "t_gps_s": np.where(known, t, np.nan),
                "pin": f["pin"],
                "level": f["flags"] & 1,
                "time_good": f["flags"] & 2 != 0,
            },
        )
    )


def _once(table: pd.DataFrame) -> pd.DataFrame:
    """The table without rows that are repeated in full (files that overlap)."""
    return table.drop_duplicates(ignore_index=True)


def base_positions(records: SbpRecords) -> ArrayF:
    """Earth-centred base positions (n, 3) in metres that the log states, zeros left out."""
    f = records.of(sm.BASE_ECEF).fields
    xyz = np.stack([f["x"], f["y"], f["z"]], axis=-1)
    xyz = xyz[np.isfinite(xyz).all(axis=1) & (np.linalg.norm(xyz, axis=1) > 6e6)]
    if xyz.shape[0]:
        return np.asarray(xyz)
    f = records.of(sm.BASE_LLH).fields
    f = f[(np.abs(f["lat"]) <= 90) & (f["lat"] != 0) & np.isfinite(f["lon"]) & np.isfinite(f["height"])]
    to_ecef = Transformer.from_crs(4979, 4978, always_xy=True, allow_ballpark=False)
    return np.stack(to_ecef.transform(f["lon"], f["lat"], f["height"]), axis=-1).reshape(-1, 3)
