"""Errors of PPK positions over their standard deviations: short baselines, good and bad receivers.

``python -m thalweg_lab.studies.by_hand.ppk FIRST_SEED NUMBER`` prints a line for each baseline and receiver:
mean of the normalised squared errors (1 if sigmas are right) of fixed and of float positions of runs of five
minutes. Fixed positions whose integers are wrong, `_WRONG_M` off, are counted beside.
"""

import sys
import tempfile
from pathlib import Path
from typing import Final

import numpy as np

from thalweg.core import ArrayF, InputError, LocalFrame
from thalweg.ingest.ppk import PpkOptions, covariance_enu, run_ppk
from thalweg_lab.instruments import Receiver, record_raw_gnss

BASELINES_M: Final = (1.0, 100.0, 5000.0)
RECEIVERS: Final = {
    "good": Receiver(
        sigma_code_m=0.1, sigma_carrier_m=0.0007, multipath_code_m=0.1, multipath_carrier_m=0.0007
    ),
    "usual": Receiver(),
    "bad": Receiver(sigma_code_m=0.4, sigma_carrier_m=0.003, multipath_code_m=0.6, multipath_carrier_m=0.003),
}
_BASE: Final = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
_START_GPS_S: Final = 304_845_206.0
_S: Final = np.arange(300.0)
_WRONG_M: Final = 0.15


def track_m(baseline_m: float) -> ArrayF:
    """A boat in waves (300, 3), 1 m/s and 50 m below the base where it is far from it."""
    far = baseline_m >= 100.0
    east, up = 0.8 * baseline_m + _S * far, 0.05 * np.sin(_S / 1.3) - 50.0 * far
    return np.column_stack([east, 0.6 * baseline_m + 5.0 * np.sin(_S / 10.0), up])


def normalised_squares(seed: int, baseline_m: float, receiver: Receiver, folder: Path) -> dict[str, ArrayF]:
    """Normalised squared errors by degree of freedom, and largest errors in metres, (n, 2) by fix."""
    rover, base, nav = (folder / name for name in ("rover.obs", "base.obs", "gps.nav"))
    true = track_m(baseline_m)
    record_raw_gnss(seed, _START_GPS_S + _S, true, _BASE, rover, base, nav, rover=receiver, base=receiver)
    options = PpkOptions(base_ecef_m=tuple(_BASE.origin_ecef_m.tolist()))
    table = run_ppk([rover], [base], [nav], options).positions
    row = np.rint(table["t_gps_s"] - _START_GPS_S).astype(int)
    error = _BASE.from_geodetic(table["lat_deg"], table["lon_deg"], table["h_ell_m"]) - true[row]
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance_enu(table)), error) / 3
    size = np.abs(error).max(axis=1)
    return {
        fix: np.column_stack([square, size])[(table["fix"] == fix).to_numpy()] for fix in ("fixed", "float")
    }


def main(first_seed: int, number: int) -> None:
    """Print the table."""
    for baseline_m in BASELINES_M:
        for name, receiver in RECEIVERS.items():
            means: dict[str, list[float]] = {"fixed": [], "float": []}
            wrong = none = 0
            for seed in range(first_seed, first_seed + number):
                with tempfile.TemporaryDirectory() as folder:
                    try:
                        found = normalised_squares(seed, baseline_m, receiver, Path(folder))
                    except InputError:
                        none += 1
                        continue
                off = found["fixed"][:, 1] > _WRONG_M
                wrong += int(off.sum())
                found["fixed"] = found["fixed"][~off]
                for fix, rows in found.items():
                    if len(rows) >= 5:
                        means[fix].append(float(rows[:, 0].mean()))
            said = "; ".join(
                f"{fix}: {len(each)} runs, mean {np.mean(each):.2f}, median {np.median(each):.2f}"
                for fix, each in means.items()
                if each
            )
            print(f"{baseline_m:6.0f} m {name:5s} {said}; {wrong} epochs wrongly fixed, {none} no solution")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
