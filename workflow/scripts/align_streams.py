"""Integrity reports of all streams, INS states and positions -> table of the common time axis."""

from pathlib import Path

from thalweg.calibration import read_mounts
from thalweg.clocks import Lag, common_span, ins_position_lag, stream_table
from thalweg.core import LocalFrame, read_table
from thalweg.ingest import GNSS_POSITION, INS_STATE, IntegrityReport
from thalweg.workflow import run_job


def main(
    *,
    reports: list[Path],
    states: Path | None,
    positions: Path,
    mounts: Path,
    streams: Path,
    frame: LocalFrame,
    source: str,
) -> None:
    found = [IntegrityReport.read(path) for path in reports]
    needed = ("lidar", "ins", "positions") if states else ("depth", "positions")
    common_span(found, needed=[each.stream for each in found if each.stream in needed])
    lags: dict[str, tuple[str, Lag]] = {}
    if states and source not in ("ins", "sbet"):  # whose positions are those of the INS itself
        lag = ins_position_lag(
            read_table(states, INS_STATE)[0],
            read_table(positions, GNSS_POSITION)[0],
            frame,
            lever_ics_antenna_m=read_mounts(mounts)["antenna"]["lever_ics_m"],
        )
        lags["positions"] = ("ins", lag)
    stream_table(found, lags).to_csv(streams, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
