"""Post-processed kinematic positions from raw observations of a rover and a base, by RTKLIB (pyrtklib5).

The engine runs in a child process under a time limit. Inputs are checked before it starts, and what it was
told is read back and compared. Positions are those of the rover antenna's phase centre, in the frame of the
base position.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from pyproj import Transformer

from thalweg.core.errors import InputError
from thalweg.core.frames import rotation_ecef_enu
from thalweg.core.types import ArrayF
from thalweg.ingest.integrity import IntegrityReport, find_gaps
from thalweg.ingest.ppk.engine import (
    EngineAnswer,
    check_settings,
    engine_version,
    run_worker,
    write_settings,
)
from thalweg.ingest.ppk.inputs import PpkInputs, preflight, prepare_inputs
from thalweg.ingest.ppk.options import PpkOptions, ecef_fault, engine_settings
from thalweg.ingest.ppk.positions import read_solution, replace_covariances

__all__ = ["PpkOptions", "PpkSolution", "run_ppk"]

_BASE_LIMIT_M = (
    1000.0  # a single-point position is good to 10 m: more than 1 km is another place or a typing error
)
_BASE_DOUBT_M = 30.0  # three times the 95 % error of a single-point position
_HEADER_DELTA_M = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class PpkSolution:
    """Positions of kind `GNSS_POSITION`, the report, the options, and the base position used, shape (3,)."""

    positions: pd.DataFrame
    report: IntegrityReport
    options: PpkOptions
    base_ecef_m: ArrayF

    @property
    def fixed(self) -> pd.DataFrame:
        """The positions with fixed ambiguities only."""
        return self.positions[self.positions["fix"] == "fixed"].reset_index(drop=True)

    @property
    def fix_ratio(self) -> float:
        """Share of all rover epochs, those without solution included, that have a fixed position."""
        return float(self.report.details["fix_ratio"])

    def require_fixed(self, share: float) -> None:
        """Refuse a solution with too few fixed epochs.

        Parameters
        ----------
        share : least `fix_ratio`, 0 to 1.

        Raises
        ------
        InputError : fewer are fixed; the message holds all counts.
        """
        if self.fix_ratio >= share:
            return
        d = self.report.details
        counts = ", ".join(f"{d[f'n_{name}']} {name}" for name in ("fixed", "float", "single", "other"))
        raise InputError(
            f"{100 * self.fix_ratio:.1f} % of {d['n_rover_epochs']} rover epochs are fixed ({counts}, "
            f"{d['n_none']} without solution)",
            expected=f"at least {100 * share:.1f} %",
            where=self.report.files[0],
            cure="Try direction='combined', more systems, another elevation mask or a nearer base, or accept "
            "float positions with their larger sigma",
        )


def run_ppk(
    rover: Sequence[Path],
    base: Sequence[Path] | None,
    nav: Sequence[Path],
    options: PpkOptions,
    *,
    time_limit_s: float = 900.0,
) -> PpkSolution:
    """Positions of a rover relative to a base.

    Parameters
    ----------
    rover : SBP logs (joined in this order) or RINEX observation files of the rover.
    base : the same of the base; None takes the corrections (sender 0) inside the rover's SBP log.
    nav : RINEX navigation files; may be empty if an SBP log holds ephemerides.
    options : see `PpkOptions`.
    time_limit_s : each run of the engine is stopped after that.

    Returns
    -------
    PpkSolution; ``report.details`` holds fix_ratio (of all rover epochs), n_fixed, n_float, n_single,
    n_other, n_none, n_rover_epochs, baseline_m (median) and baseline_max_m, base_ecef_m, base_check_m
    (distance to the base's own single-point position), n_covariances_replaced, engine and options.

    Raises
    ------
    InputError : inputs are missing, of the wrong kind, do not overlap, hold no ephemerides or no base
        position; or the engine crashed, ran too long, or found no solution.
    ConfigError : the engine did not take an option.
    """
    with tempfile.TemporaryDirectory(prefix="thalweg-ppk-") as name:
        folder = Path(name)
        inputs = prepare_inputs(rover, base, nav, folder, time_limit_s=time_limit_s)
        rover_file, base_file = Path(rover[0]), Path(rover[0] if base is None else base[0])
        notes = preflight(inputs, options, rover_file, base_file)
        base_ecef_m, base_notes = _base_position(inputs, options, base_file)
        where = f"{rover_file}, {base_file}"
        single, _ = _solve(folder, inputs, options, base_ecef_m, where, time_limit_s, single=True)
        base_check_m, check_notes = _check_base(single, base_ecef_m, base_file)
        positions, answer = _solve(folder, inputs, options, base_ecef_m, where, time_limit_s, single=False)
    if positions.empty:
        raise InputError(
            f"the RTKLIB engine found no position for {inputs.rover_t_gps_s.size} rover epochs; it printed: "
            f"{answer.output}",
            expected="at least one position",
            where=where,
            cure="; ".join(notes + base_notes + check_notes)
            or "Check systems and frequencies of both receivers",
        )
    positions, n_replaced = replace_covariances(positions)
    files = [str(file) for file in [*rover, *(base or []), *nav]]
    report = _report(positions, inputs, options, base_ecef_m, answer, files)
    report.details |= {"base_check_m": base_check_m, "n_covariances_replaced": n_replaced}
    if n_replaced:
        report.note(
            f"{n_replaced} covariances of the engine were indefinite or below 0.5 mm (lost digits) and are "
            "replaced by the median of their neighbours"
            + ("." if options.dynamics else "; with dynamics=True the engine keeps its digits.")
        )
    for sentence in inputs.notes + check_notes + base_notes + notes:
        report.note(sentence)
    return PpkSolution(positions=positions, report=report, options=options, base_ecef_m=base_ecef_m)


def _base_position(inputs: PpkInputs, options: PpkOptions, base_file: Path) -> tuple[ArrayF, list[str]]:
    """Position of the base's antenna reference point in earth-centred metres, and notes."""
    notes: list[str] = []
    scan = inputs.base[0]
    height, east, north = scan.antenna_delta_hen_m
    header_delta = np.array([east, north, height])
    delta = np.asarray(options.base_antenna_delta_enu_m, dtype=np.float64)
    position = options.explicit_base_ecef_m
    if options.base_source == "from_sbp":
        position = _sbp_base(inputs, base_file, notes)
    elif options.base_source == "rinex_header":
        position = scan.approx_ecef_m
        fault = "is absent" if position is None else ecef_fault(position)
        if position is None or fault:
            raise InputError(
                f"the APPROX POSITION XYZ of the base {fault}",
                expected="earth-centred coordinates of the base",
                where=base_file,
                cure="Give base_ecef_m or base_llh from the survey of the base",
            )
        notes.append(
            "The base position is the approximate position of a RINEX header: it may be metres off, and "
            "every position is off with it."
        )
        delta = delta + header_delta
    elif np.linalg.norm(header_delta - delta) > _HEADER_DELTA_M and np.any(header_delta):
        notes.append(
            f"The base header states an antenna offset of {east:.4f}, {north:.4f}, {height:.4f} m (east, "
            f"north, up); used is {delta[0]:.4f}, {delta[1]:.4f}, {delta[2]:.4f} m."
        )
    assert position is not None
    if np.any(delta):
        lat, lon, _ = _geodetic(position)
        position = position + rotation_ecef_enu(lat, lon) @ delta
    return np.asarray(position, dtype=np.float64), notes


def _sbp_base(inputs: PpkInputs, base_file: Path, notes: list[str]) -> ArrayF:
    rows = [frames.base_ecef_m for frames in (inputs.rover_sbp, inputs.base_sbp) if frames is not None]
    stated = np.concatenate(rows) if rows else np.zeros((0, 3))
    valid = stated[[not ecef_fault(row) for row in stated]] if stated.size else stated
    if not valid.size:
        raise InputError(
            f"no valid MsgBasePosECEF among {stated.shape[0]} in the SBP logs",
            expected="the surveyed position of the base in the log",
            where=base_file,
            cure="Give base_ecef_m or base_llh from the survey of the base",
        )
    position = np.median(valid, axis=0)
    spread = float(np.max(np.linalg.norm(valid - position, axis=1)))
    if spread > 0.01:
        notes.append(
            f"The base positions stated in the SBP log differ by up to {spread:.3f} m; their median is used."
        )
    return np.asarray(position)


def _solve(
    folder: Path,
    inputs: PpkInputs,
    options: PpkOptions,
    base_ecef_m: ArrayF,
    where: str,
    time_limit_s: float,
    *,
    single: bool,
) -> tuple[pd.DataFrame, EngineAnswer]:
    """One run of the engine: PPK of the rover, or single-point positions of the base every 30 s."""
    name = "single" if single else "ppk"
    config, readback, output = (folder / f"{name}.{end}" for end in ("conf", "taken", "pos"))
    settings = engine_settings(options, base_ecef_m, single=single)
    write_settings(config, settings)
    task = {
        "action": "solve",
        "config": str(config),
        "readback": str(readback),
        "inputs": [inputs.base_glob, *inputs.nav_files] if single else inputs.engine_files,
        "output": str(output),
        "interval_s": 30.0 if single else 0.0,
    }
    answer = run_worker([task], folder, where=where, time_limit_s=time_limit_s)
    check_settings(readback, settings)
    return read_solution(output), answer


def _check_base(single: pd.DataFrame, base_ecef_m: ArrayF, base_file: Path) -> tuple[float | None, list[str]]:
    """Distance of the base position from its own single-point position; refuses another place."""
    if single.empty:
        return None, [
            "The base position could not be checked: its observations give no single-point position."
        ]
    to_ecef = Transformer.from_crs(4979, 4978, always_xy=True, allow_ballpark=False)
    xyz = np.stack(
        to_ecef.transform(*(single[c].to_numpy() for c in ("lon_deg", "lat_deg", "h_ell_m"))), axis=-1
    )
    distance = float(np.linalg.norm(np.median(xyz, axis=0) - base_ecef_m))
    if distance > _BASE_LIMIT_M:
        raise InputError(
            f"the base position lies {distance / 1000.0:.1f} km from where its own observations put it",
            expected=f"less than {_BASE_LIMIT_M / 1000.0:g} km",
            where=base_file,
            cure="Check order, sign and unit of the base coordinates and that the file is of this base",
        )
    if distance > _BASE_DOUBT_M:
        return distance, [
            f"The base position lies {distance:.0f} m from the base's own single-point position: check it."
        ]
    return distance, []


def _report(
    positions: pd.DataFrame,
    inputs: PpkInputs,
    options: PpkOptions,
    base_ecef_m: ArrayF,
    answer: EngineAnswer,
    files: list[str],
) -> IntegrityReport:
    t = positions["t_gps_s"].to_numpy()
    n_rover = inputs.rover_t_gps_s.size
    by_fix = positions["fix"].value_counts().to_dict()
    n = {name: int(by_fix.get(name, 0)) for name in ("fixed", "float", "single")}
    n_none = max(0, n_rover - len(positions))
    report = IntegrityReport(
        stream="PPK positions",
        format="SBP" if inputs.rover_sbp is not None else f"RINEX {inputs.rover[0].version}",
        files=files,
        model=inputs.rover[0].text("REC # / TYPE / VERS", 20, 40),
        time_scale="gps",
        synchronised=True,
        t_first_s=float(t[0]),
        t_last_s=float(t[-1]),
        bytes_read=inputs.bytes_read,
        counts={
            "rover epochs": n_rover,
            "base epochs": inputs.base_t_gps_s.size,
            "ephemerides": sum(scan.t_gps_s.size for scan in inputs.nav),
            "positions": len(positions),
        },
        losses=dict(inputs.losses),
        gaps=find_gaps(t),
    )
    if n_none:
        report.lose("rover epochs without solution", n_none)
    step = np.diff(t)
    if step.size:
        report.rates_hz["positions"] = 1.0 / float(np.median(step))
    baseline = _baseline_m(positions, base_ecef_m)
    report.details = {
        "fix_ratio": n["fixed"] / n_rover,
        "n_rover_epochs": n_rover,
        **{f"n_{name}": count for name, count in n.items()},
        "n_other": len(positions) - sum(n.values()),
        "n_none": n_none,
        "baseline_m": float(np.median(baseline)),
        "baseline_max_m": float(np.max(baseline)),
        "base_ecef_m": [float(x) for x in base_ecef_m],
        "engine": f"{engine_version()} ({answer.engine})",
        "options": options.plain(),
    }
    if not n["fixed"]:
        report.note("No position is fixed: the ambiguities stayed float; expect decimetres, not centimetres.")
    if options.ambiguity == "instantaneous":
        report.note("Ambiguity 'instantaneous' fixes next to nothing in this engine: use 'continuous'.")
    if options.direction == "combined":
        report.note(
            "Direction 'combined' weights two filters over the same observations as if they were "
            "independent: the stated sigmas are up to 1.4 times too small."
        )
    if n["single"]:
        report.note(f"{n['single']} positions are single-point: metres, without the base.")
    return report


def _baseline_m(positions: pd.DataFrame, base_ecef_m: ArrayF) -> ArrayF:
    to_ecef = Transformer.from_crs(4979, 4978, always_xy=True, allow_ballpark=False)
    columns = (positions[c].to_numpy() for c in ("lon_deg", "lat_deg", "h_ell_m"))
    return np.asarray(np.linalg.norm(np.stack(to_ecef.transform(*columns), axis=-1) - base_ecef_m, axis=1))


def _geodetic(xyz_ecef_m: ArrayF) -> tuple[float, float, float]:
    to_geodetic = Transformer.from_crs(4978, 4979, always_xy=True, allow_ballpark=False)
    lon, lat, h = to_geodetic.transform(*(float(x) for x in xyz_ecef_m))
    return float(lat), float(lon), float(h)
