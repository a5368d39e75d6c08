"""Antenna positions from whichever source a campaign chooses, in one table kind."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from thalweg.core.errors import InputError
from thalweg.core.tables import read_table
from thalweg.ingest.integrity import IntegrityReport
from thalweg.ingest.ppk.positions import replace_covariances
from thalweg.ingest.registry.recognise import recognise
from thalweg.ingest.schemas import GNSS_POSITION, INS_STATE


def positions_from_states(states: pd.DataFrame) -> pd.DataFrame:
    """The positions inside INS states as table kind ``gnss_position``: of the ics origin, not an antenna."""
    table = pd.DataFrame({name: states[name] for name in ("t_gps_s", "lat_deg", "lon_deg", "h_ell_m", "fix")})
    for name in ("sigma_east_m", "sigma_north_m", "sigma_up_m"):
        table[name] = states[name]
    table["n_sats"] = -1
    for name in GNSS_POSITION.names:
        if name not in table:
            table[name] = float("nan")
    return table[list(GNSS_POSITION.names)]


def read_receiver(files: list[Path]) -> tuple[pd.DataFrame, IntegrityReport]:
    """The solution that a GNSS receiver computed on board, from its SBP log.

    A receiver that logged raw observations only (RINEX) has none: the table is then empty, and the report is
    that of the observations.

    Parameters
    ----------
    files : log of the rover, SBP or RINEX observations.

    Raises
    ------
    InputError : a file is neither.
    """
    sbp = [path for path in files if recognise(path) == "sbp"]
    if sbp:
        from thalweg.ingest.sbp.reader import read_sbp

        log = read_sbp(sbp)
        return log.positions, log.report
    from thalweg.ingest.ppk.rinex import describe_rinex

    report = describe_rinex(files[0])
    report.stream = "gnss"
    return GNSS_POSITION.empty_table().to_pandas(), report


def read_positions(
    source: str,
    logs: list[Path],
    *,
    states: Path,
    base: list[Path],
    nav: list[Path],
    ppk: dict[str, Any],
    base_position: dict[str, Any],
) -> tuple[pd.DataFrame, IntegrityReport]:
    """Positions of the antenna.

    Parameters
    ----------
    source : ``pos``, ``sbp``, ``ppk``, ``sbet`` or ``ins``.
    logs : the source's own files: .pos, SBP, or the rover's raw GNSS.
    states : table of INS states, for the sources ``sbet`` and ``ins``.
    base, nav : the base's raw GNSS and navigation files, for ``ppk``.
    ppk : options of the engine, as in the section ``ppk`` of a campaign file.
    base_position : one of the keys ``base_ecef_m``, ``base_llh`` and ``base_from``.

    Raises
    ------
    InputError : the source is unknown, or its files cannot be used.
    """
    if source == "pos":
        from thalweg.ingest.tracks.rtklib_pos import read_pos

        pos = read_pos(logs)
        positions, report = pos.positions, pos.report
    elif source == "sbp":
        from thalweg.ingest.sbp.reader import read_sbp

        sbp = read_sbp(logs)
        positions, report = sbp.positions, sbp.report
    elif source == "ppk":
        from thalweg.ingest.ppk.solution import PpkOptions, run_ppk

        solution = run_ppk(logs, base or None, nav, PpkOptions.from_sections(ppk, base_position))
        positions, report = solution.positions, solution.report
    elif source in ("ins", "sbet"):
        table, _ = read_table(states, INS_STATE)
        positions = positions_from_states(table)
        t = positions["t_gps_s"].dropna()
        report = IntegrityReport(
            stream="positions",
            format=f"positions of the {'INS' if source == 'ins' else 'SBET'} states",
            files=[str(states)],
            time_scale="gps",
            synchronised=bool(len(t)),
            t_first_s=float(t.min()) if len(t) else None,
            t_last_s=float(t.max()) if len(t) else None,
            counts={"positions": len(positions)},
        )
    else:
        raise InputError(f"position source '{source}'", expected="pos, sbp, ppk, sbet or ins")
    report.stream = "positions"
    if report.timing.period_s is None:
        t_gps_s = positions["t_gps_s"].to_numpy()
        report.timing.describe_stamps(t_gps_s)
        untimed = int((~np.isfinite(t_gps_s)).sum())
        report.timing.unsynchronised_s = untimed * (report.timing.period_s or 0.0)
    if source != "ppk":  # which has done so itself
        positions, n_replaced = replace_covariances(positions)
        if n_replaced:
            report.count("covariances_replaced", n_replaced)
            report.note(
                f"{n_replaced} covariances were not positive definite, or below 0.5 mm: replaced by the "
                "median of their neighbours of the same fix."
            )
    return positions, report
