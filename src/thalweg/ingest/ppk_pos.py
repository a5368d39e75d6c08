"""Minimal reader of the .pos text that `run_ppk` asks for: degrees, ellipsoidal height, GPS week, second."""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.errors import InputError
from thalweg.core.timescales import gps_from_week

FIX_OF_QUALITY: Final = {
    1: "fixed", 2: "float", 3: "sbas", 4: "dgnss", 5: "single", 6: "ppp", 7: "dead_reckoning",
}  # fmt: skip
"""Meaning of RTKLIB's quality flag Q (RTKLIB manual 2.4.2, appendix B.1)."""


def read_engine_pos(path: Path) -> pd.DataFrame:
    """Table of kind `GNSS_POSITION`; zero rows if the engine wrote no solution.

    The mixed terms ``sdne``, ``sdeu``, ``sdun`` are square roots of covariances that carry their sign.

    Raises
    ------
    InputError : a line has not the 15 numbers asked for.
    """
    rows: list[list[float]] = []
    for number, line in enumerate(path.read_text(errors="replace").splitlines() if path.is_file() else [], 1):
        if line.startswith("%") or not line.strip():
            continue
        try:
            row = [float(word) for word in line.split()]
        except ValueError:
            row = []
        if len(row) != 15:
            raise InputError(
                f"{line[:60]!r} is no solution line of the engine",
                expected="15 numbers",
                where=f"{path.name}, line {number}",
                cure="Run again; if it comes back, the engine's version is not the tested one",
            )
        rows.append(row)
    a = np.array(rows, dtype=np.float64).reshape(-1, 15)

    def signed_square(column: int) -> "np.typing.NDArray[np.float64]":
        return np.asarray(np.sign(a[:, column]) * a[:, column] ** 2)

    return pd.DataFrame(
        {
            "t_gps_s": gps_from_week(a[:, 0], a[:, 1]),
            "lat_deg": a[:, 2],
            "lon_deg": a[:, 3],
            "h_ell_m": a[:, 4],
            "fix": pd.Series([FIX_OF_QUALITY.get(int(q), "none") for q in a[:, 5]], dtype=object),
            "n_sats": a[:, 6].astype(np.int32),
            "sigma_east_m": a[:, 8],
            "sigma_north_m": a[:, 7],
            "sigma_up_m": a[:, 9],
            "cov_en_m2": signed_square(10),
            "cov_eu_m2": signed_square(11),
            "cov_nu_m2": signed_square(12),
            "age_s": a[:, 13],
            "ratio": a[:, 14],
        }
    )
