"""Layouts and flags of the SBP messages that are read.

All little endian. Source: Swift Navigation, SBP specification 6.5 (as in the library ``sbp`` 6.5.2, against
which the tests compare each field).
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

GPS_TIME, GPS_TIME_DEP_A, GPS_TIME_GNSS, UTC_TIME = 0x0102, 0x0100, 0x0104, 0x0103
POS_LLH, POS_LLH_DEP_A, POS_LLH_GNSS = 0x020A, 0x0201, 0x022A
POS_LLH_COV, POS_LLH_COV_GNSS = 0x0211, 0x0231
POS_ECEF, POS_ECEF_DEP_A, POS_ECEF_COV = 0x0209, 0x0200, 0x0214
VEL_NED, VEL_NED_DEP_A = 0x020E, 0x0205
BASELINE_NED, BASELINE_NED_DEP_A = 0x020C, 0x0203
BASE_LLH, BASE_ECEF, AGE, EVENT, OBS = 0x0044, 0x0048, 0x0210, 0x0101, 0x004A

_WEEK = [("wn", "<u2"), ("tow", "<u4"), ("ns", "<i4")]
_LLH = [("tow", "<u4"), ("lat", "<f8"), ("lon", "<f8"), ("height", "<f8")]
_ECEF = [("tow", "<u4"), ("x", "<f8"), ("y", "<f8"), ("z", "<f8")]
_NED = [("tow", "<u4"), ("n", "<i4"), ("e", "<i4"), ("d", "<i4")]
_ACCURACY = [("h_accuracy", "<u2"), ("v_accuracy", "<u2")]
_END = [("n_sats", "u1"), ("flags", "u1")]


def _covariance(axes: str) -> list[tuple[str, str]]:
    a, b, c = list(axes)
    return [(f"cov_{i}_{j}", "<f4") for i, j in ((a, a), (a, b), (a, c), (b, b), (b, c), (c, c))]


_L_TIME = np.dtype([*_WEEK, ("flags", "u1")])
_L_LLH = np.dtype([*_LLH, *_ACCURACY, *_END])
_L_LLH_COV = np.dtype([*_LLH, *_covariance("ned"), *_END])
_L_ECEF = np.dtype([*_ECEF, ("accuracy", "<u2"), *_END])
_L_NED = np.dtype([*_NED, *_ACCURACY, *_END])

LAYOUTS: Final[Mapping[int, np.dtype[Any]]] = {
    GPS_TIME: _L_TIME,
    GPS_TIME_DEP_A: _L_TIME,
    GPS_TIME_GNSS: _L_TIME,
    UTC_TIME: np.dtype(
        [("flags", "u1"), ("tow", "<u4"), ("year", "<u2"), ("month", "u1"), ("day", "u1"), ("hours", "u1"),
         ("minutes", "u1"), ("seconds", "u1"), ("ns", "<u4")]
    ),
    POS_LLH: _L_LLH,
    POS_LLH_DEP_A: _L_LLH,
    POS_LLH_GNSS: _L_LLH,
    POS_LLH_COV: _L_LLH_COV,
    POS_LLH_COV_GNSS: _L_LLH_COV,
    POS_ECEF: _L_ECEF,
    POS_ECEF_DEP_A: _L_ECEF,
    POS_ECEF_COV: np.dtype([*_ECEF, *_covariance("xyz"), *_END]),
    VEL_NED: _L_NED,
    VEL_NED_DEP_A: _L_NED,
    BASELINE_NED: _L_NED,
    BASELINE_NED_DEP_A: _L_NED,
    BASE_LLH: np.dtype(_LLH[1:]),
    BASE_ECEF: np.dtype(_ECEF[1:]),
    AGE: np.dtype([("tow", "<u4"), ("age", "<u2")]),
    EVENT: np.dtype([*_WEEK, ("flags", "u1"), ("pin", "u1")]),
    OBS: np.dtype([("tow", "<u4"), ("ns", "<i4"), ("wn", "<u2"), ("n_obs", "u1")]),
}  # fmt: skip
"""Messages that are decoded; of MsgObs only the head, which 17 bytes a signal follow."""

OBS_SIGNAL_BYTES: Final = 17
"""Bytes of one signal in MsgObs: P u32, L i32 + u8, D i16 + u8, cn0, lock, flags, satellite, code."""

IMU_RAW, MAG_RAW = 0x0900, 0x0902

FIX: Final = np.array(
    ["none", "single", "dgnss", "float", "fixed", "dead_reckoning", "sbas", "none"], dtype=object
)
"""Bits 0-2 of the flags of positions and baselines."""

FIX_DEP_A: Final = np.array(["single", "fixed", "float", *["none"] * 5], dtype=object)
"""The same bits in the deprecated messages ..._DEP_A, where 0 is a single point solution."""

DEP_A: Final = frozenset({POS_LLH_DEP_A, POS_ECEF_DEP_A, VEL_NED_DEP_A, BASELINE_NED_DEP_A})
