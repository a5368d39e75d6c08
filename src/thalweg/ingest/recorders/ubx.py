"""u-blox receivers: UBX logs, alone or mixed with NMEA and RTCM, read by ``pyubx2`` (extra ``ubx``).

Positions are those of NAV-PVT, finer by NAV-HPPOSLLH and with the covariances of NAV-COV where these are
logged; receivers before the M8 log NAV-POSLLH, whose fix NAV-SOL or NAV-STATUS tells. Stamps are GPS time of
the week; the week is that of NAV-PVT's date, of NAV-TIMEGPS, NAV-SOL or the raw observations. Raw
observations (RXM-RAWX) go through RTKLIB.

hAcc is radial: in logs that hold both, its square is posCovNN + posCovEE, and that of vAcc is posCovDD
(NEO-M9N, ZED-F9P and ZED-X20P in the test files of pyubx2).
Source: u-blox F9 HPG 1.32 Interface Description, UBX-22008968.
"""

import datetime as dt
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import (
    WEEK_S,
    AnyArray,
    InputError,
    frame_of,
    gps_from_unix,
    gps_from_week,
    missing_package,
    utc_text_from_gps,
)
from thalweg.ingest import GNSS_POSITION, IntegrityReport, PositionLog, TrackOptions
from thalweg.ingest.nmea import read_nmea

RAW_OBSERVATIONS: Final = ("RXM-RAWX", "RXM-RAW")
_PLACES: Final = ("NAV-PVT", "NAV-HPPOSLLH", "NAV-POSLLH")
"""Messages with positions, the one that says most first."""
_POSITIONS: Final = (*_PLACES, "NAV-COV", "NAV-TIMEGPS", "NAV-SOL", "NAV-STATUS", "NAV-RELPOSNED")
_FIX_TYPE: Final = {0: "none", 1: "dead_reckoning", 2: "single", 3: "single", 4: "single", 5: "none"}
_CARRIER: Final = {1: "float", 2: "fixed"}
_AFTER_VERSION: Final = ("NAV-HPPOSLLH", "NAV-RELPOSNED")
"""Messages whose time of week stands behind four other bytes."""
_FIX_OK: Final = {"NAV-SOL": "gpsfixOK", "NAV-STATUS": "gpsFixOk"}
"""Messages that say of the position of their epoch whether it is a fix, and their field for it."""
_WEEK_OK: Final = {"NAV-TIMEGPS": "weekValid", "NAV-SOL": "wknSet"}


def ubx_share(head: bytes, size: int) -> float:
    """How sure a head is of UBX: wholly by two frames with right check sums, whatever stands between them."""
    at, frames = 0, 0
    while frames < 2 and 0 <= (at := head.find(b"\xb5\x62", at)) <= len(head) - 8:
        end = at + 6 + int.from_bytes(head[at + 4 : at + 6], "little")
        if head[end : end + 2] == _check_sum(head[at + 2 : end]):
            frames, at = frames + 1, end
        else:
            at += 2
    return 1.0 if frames == 2 or (frames == 1 and size < 1_000) else 0.0


def _check_sum(data: bytes) -> bytes:
    """8-bit Fletcher sum of a frame's class, number, length and payload."""
    values = np.frombuffer(data, np.uint8).astype(np.int64)
    return bytes([int(values.sum()) & 0xFF, int(values.cumsum().sum()) & 0xFF])


def ubx_frames(path: Path, report: IntegrityReport | None = None) -> Iterator[tuple[str, bytes]]:
    """Name and bytes of each intact UBX message of a log; all else is counted.

    Raises
    ------
    UnsupportedError : pyubx2 is not installed.
    """
    try:
        from pyubx2 import ERR_IGNORE, UBX_MSGIDS, UBXReader
    except ImportError as error:
        raise missing_package(error, path) from error
    covered: Counter[str] = Counter()
    with path.open("rb") as stream:
        reader = UBXReader(stream, quitonerror=ERR_IGNORE, parsing=False)
        while True:
            try:
                raw, _ = next(reader)
            except StopIteration:
                break
            except UnicodeDecodeError:  # of a dollar sign amid damage, which the library takes for NMEA
                continue
            if raw is None:
                continue
            ubx = raw[:2] == b"\xb5\x62"
            if ubx and raw[-2:] != _check_sum(raw[2:-2]):
                continue
            covered["UBX" if ubx else "NMEA" if raw[:1] == b"$" else "RTCM"] += len(raw)
            if ubx:
                yield UBX_MSGIDS.get(raw[2:4], f"{raw[2]:02X}-{raw[3]:02X}"), raw
    if report is not None:
        size = path.stat().st_size
        report.bytes_read += size
        for other in ("NMEA", "RTCM"):
            report.count_some(f"bytes_of_{other}", covered[other])
        report.lose("bytes_outside_messages", size - covered.total())


def read_ubx(files: Sequence[Path], options: TrackOptions) -> PositionLog:
    """Positions of the antenna, and depths where NMEA of an echo sounder is mixed in.

    Parameters
    ----------
    files : logs of one receiver in the order of time.
    options : ``date`` for NMEA without dates.

    Returns
    -------
    ``positions`` of kind ``gnss_position``, empty for a log of raw observations alone.

    Raises
    ------
    InputError : messages of two receivers.
    UnsupportedError : see `ubx_frames`.
    """
    from pyubx2 import UBXReader

    report = IntegrityReport.of("gnss", "u-blox UBX log", files, time_scale="gps")
    numbers: Counter[str] = Counter()
    parts = []
    for path in files:  # each with weeks of its own: the same second of two weeks is told apart
        rows: dict[str, list[dict[str, Any]]] = {name: [] for name in (*_POSITIONS, *RAW_OBSERVATIONS)}
        for name, raw in ubx_frames(path, report):
            numbers[name] += 1
            if name in rows:
                at = 10 if name in _AFTER_VERSION else 6
                tow_s = int.from_bytes(raw[at : at + 4], "little") * 1e-3
                wanted = name in _POSITIONS
                fields = vars(UBXReader.parse(raw)) if wanted else {"week": _week_of_raw(name, raw)}
                if name == "RXM-RAWX":
                    tow_s = float(np.frombuffer(raw, "<f8", 1, 6)[0])
                rows[name].append({**fields, "tow_s": tow_s})
        tables = {name: pd.DataFrame(part) for name, part in rows.items() if part}
        parts.append(_positions(tables, report, path))
        if "NAV-RELPOSNED" in tables:
            _say_heading(tables["NAV-RELPOSNED"], report)
    report.details["messages"] = dict(sorted(numbers.items()))
    positions = pd.concat(parts, ignore_index=True)
    log = PositionLog(report=report, positions=positions)
    if report.counts.get("bytes_of_NMEA"):
        t = positions["t_gps_s"].dropna()
        day = utc_text_from_gps(float(t.iloc[0]))[:10] if len(t) else ""
        beside = read_nmea(files, date=options.date or (dt.date.fromisoformat(day) if day else None))
        log.depths = beside.depths
        if len(log.depths):
            for sentence in beside.report.notes:
                report.note(sentence)
            report.details |= {k: v for k, v in beside.report.details.items() if k == "DPT offsets"}
            for what in ("depths", "no_bottom"):
                report.count_some(what, beside.report.counts.get(what, 0))
        if positions.empty and len(beside.positions):
            log.positions = beside.positions
            report.note("Positions are those of its NMEA sentences: no NAV message with one is logged.")
    report.take_gps_times(log.positions["t_gps_s"], "positions")
    raw_epochs = sum(numbers[name] for name in RAW_OBSERVATIONS)
    if raw_epochs:
        report.count("raw_epochs", raw_epochs)
        report.note(
            f"{raw_epochs:,} epochs of raw observations: name the log in gnss.rover (or base) for PPK."
        )
    elif log.positions.empty and not any(numbers[name] for name in _PLACES):
        report.note(f"No message states positions that are read ({', '.join(_PLACES)}).")
    if numbers["TIM-TM2"]:
        report.note(f"{numbers['TIM-TM2']:,} time marks (TIM-TM2) are not read.")
    return log


def _week_of_raw(name: str, raw: bytes) -> int:
    at = 14 if name == "RXM-RAWX" else 10
    return int.from_bytes(raw[at : at + 2], "little")


def _positions(tables: dict[str, pd.DataFrame], report: IntegrityReport, path: Path) -> pd.DataFrame:
    main = next((name for name in _PLACES if name in tables), None)
    if main is None:
        return GNSS_POSITION.empty_table().to_pandas()
    if apart := int((tables[main].groupby("tow_s")[["lat", "lon"]].nunique() > 1).any(axis=1).sum()):
        raise InputError(
            f"{main} states two places for {apart:,} times",
            expected="messages of one receiver",
            where=path,
            cure="Log each receiver to a file of its own",
        )
    table = tables[main].drop_duplicates("tow_s", keep="last").set_index("tow_s", drop=False)
    fine = tables.get("NAV-HPPOSLLH")
    if fine is not None and main == "NAV-PVT":
        fine = fine[fine["invalidLlh"] == 0].drop_duplicates("tow_s").set_index("tow_s")
        for name in ("lat", "lon", "height", "hAcc", "vAcc"):
            table[name] = fine[name].reindex(table.index).fillna(table[name])
    if main == "NAV-PVT":
        fix = table["carrSoln"].map(_CARRIER)
        plain = table["fixType"].map(_FIX_TYPE).where(table["gnssFixOk"] == 1, "none")
        plain = plain.where(table["invalidLlh"] == 0, "none")
        plain = plain.where((plain != "single") | (table["diffSoln"] == 0), "dgnss")
        fix = fix.where((plain != "none") & fix.notna(), plain)
    else:
        fix = pd.Series("single", index=table.index)
        if main == "NAV-HPPOSLLH":
            fix = fix.where(table["invalidLlh"] == 0, "none")
        name = next((name for name in _FIX_OK if name in tables), "")
        if name:
            told = tables[name].drop_duplicates("tow_s").set_index("tow_s")
            kind = told["gpsFix"].map(_FIX_TYPE).where(told[_FIX_OK[name]] == 1, "none").reindex(fix.index)
            fix = fix.where((fix == "none") | kind.isna(), kind)
        elif main == "NAV-POSLLH":
            report.note("No NAV-SOL or NAV-STATUS says which positions are fixes: all count as such.")
    radial = table["hAcc"].astype(float) * 1e-3 / np.sqrt(2.0)
    values = {
        "t_gps_s": _t_gps_s(table, tables, report),
        "lat_deg": table["lat"],
        "lon_deg": table["lon"],
        "h_ell_m": table["height"] * 1e-3,
        "fix": fix,
        "n_sats": table.get("numSV", pd.Series(-1, index=table.index)),
        "sigma_east_m": radial,
        "sigma_north_m": radial,
        "sigma_up_m": table["vAcc"].astype(float) * 1e-3,
    }
    if "NAV-COV" in tables:
        cov = tables["NAV-COV"].query("posCovValid == 1").drop_duplicates("tow_s").set_index("tow_s")
        cov = cov.reindex(table.index)
        for ours, theirs in (("east", "EE"), ("north", "NN"), ("up", "DD")):
            name = f"sigma_{ours}_m"
            variance = cov[f"posCov{theirs}"]
            values[name] = np.sqrt(variance.where(variance > 0)).fillna(values[name])
        values |= {
            "cov_en_m2": cov["posCovNE"], "cov_eu_m2": -cov["posCovED"], "cov_nu_m2": -cov["posCovND"]
        }  # fmt: skip
    found = frame_of(GNSS_POSITION, values, unknown=np.nan)
    without = found["fix"] == "none"
    report.count_some("positions_without_fix", without.sum())
    return found[~without].reset_index(drop=True)


def _t_gps_s(table: pd.DataFrame, tables: dict[str, pd.DataFrame], report: IntegrityReport) -> AnyArray:
    """GPS time of rows with ``tow_s``; NaN where no message tells the week."""
    tow_s = table["tow_s"].to_numpy(np.float64)
    week = np.full(len(tow_s), np.nan)
    if "validDate" in table:
        known = ((table["validDate"] == 1) & (table["validTime"] == 1)).to_numpy()
        parts = ["year", "month", "day", "hour", "min", "second"]
        date = table.loc[known, parts].rename(columns={"min": "minute"})
        unix = pd.to_datetime(date).to_numpy().astype("datetime64[s]").astype(np.float64)
        whole = gps_from_unix(unix) - gps_from_week(0, 0.0)
        week[known] = np.round((whole - tow_s[known]) / WEEK_S)
    for name in ("NAV-TIMEGPS", "NAV-SOL", *RAW_OBSERVATIONS):
        if name in tables and not np.isfinite(week).all():
            valid = tables[name].query(f"{_WEEK_OK[name]} == 1") if name in _WEEK_OK else tables[name]
            if valid.empty:
                continue
            told = valid[["tow_s", "week"]].astype(float).sort_values("tow_s")
            near = np.clip(np.searchsorted(told["tow_s"], tow_s), 0, len(told) - 1)
            week = np.where(np.isfinite(week), week, told["week"].to_numpy()[near])
    if np.isnan(week).any():
        report.count("positions_without_week", int(np.isnan(week).sum()))
        report.note("No message tells the week of some positions: they have no GPS time.")
    return gps_from_week(week, tow_s)


def _say_heading(table: pd.DataFrame, report: IntegrityReport) -> None:
    valid = table[table["relPosHeadingValid"] == 1]
    report.count("headings_of_two_antennas", len(valid))
    if len(valid):
        report.note(
            f"{len(valid):,} headings between two antennas (NAV-RELPOSNED, median sigma "
            f"{valid['accHeading'].median():.2f} deg) are not used: roll and pitch need an INS beside them."
        )
