"""The SBP reader: logs of Swift Navigation's receivers as tables and an integrity report.

Frames are found and decoded in compiled code and numpy; the library ``sbp`` names the message types and is
the oracle of the tests. Sender 0 relays the base, any other sender is the rover.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import (
    GPS_EPOCH_UNIX_S,
    LEAP_TABLE_VALID_UNTIL,
    R_ENU_NED,
    WEEK_S,
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayI,
    ecef_of,
    frame_of,
    geodetic_of,
    gps_from_week,
    gps_minus_utc,
    rotation_ecef_enu,
    utc_text_from_unix,
)
from thalweg.ingest import GNSS_POSITION, IntegrityReport, PositionLog
from thalweg.ingest.framing import CHUNK_BYTES, Records
from thalweg.ingest.sbp import messages as sm
from thalweg.ingest.sbp.messages import SbpRecords, collect

# ---------------------------------------------------------------- GPS time of SBP messages: most carry the
# time of the week only


_WEEK_MS: Final = WEEK_S * 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class WeekTrack:
    """Full GPS time at some messages, in the order of the log.

    Attributes
    ----------
    number : (n,) number of the message.
    week, tow_ms, ns : (n,) GPS week, millisecond of the week, rest of the millisecond in ns.
    source : words for the message that they are from; empty if the log has none.
    """

    number: ArrayI
    week: ArrayI
    tow_ms: ArrayI
    ns: ArrayI
    source: str = ""

    @property
    def t_gps_s(self) -> ArrayF:
        """Adjusted GPS time of the track itself."""
        return np.asarray(gps_from_week(self.week, self.tow_ms * 1e-3) + self.ns * 1e-9)

    def before(self, number: ArrayI) -> ArrayI:
        """Index of the last entry before each message, of the first one where there is none before."""
        return np.maximum(np.searchsorted(self.number, number, side="right").astype(np.int64) - 1, 0)

    def times(self, messages: Records) -> ArrayF:
        """Adjusted GPS time of messages with a field ``tow`` in ms; NaN without week or with a false tow.

        The week is that of the entry before (of the first entry for messages ahead of it). A tow that is
        more than half a week away from that entry's lies on the other side of a week rollover.
        """
        tow = messages.fields["tow"].astype(np.int64)
        if not self.number.size:
            return np.full(tow.size, np.nan)
        index = self.before(messages.number)
        behind = self.tow_ms[index] - tow
        week = self.week[index] + (behind > _WEEK_MS // 2) - (behind < -(_WEEK_MS // 2))
        ns = np.where(behind == 0, self.ns[index], 0)
        t = gps_from_week(week, tow * 1e-3) + ns * 1e-9
        return np.where(tow < _WEEK_MS, t, np.nan)


def possible_week(messages: Records) -> ArrayB:
    """True where a message with week and tow can be a time: power-up sends week 0."""
    return np.asarray((messages.fields["wn"] > 0) & (messages.fields["tow"] < _WEEK_MS))


def build_track(records: SbpRecords, sender: int | None) -> WeekTrack:
    """Time axis from MsgGPSTime; else from its variants, else from the observations.

    Parameters
    ----------
    records : the log.
    sender : the rover; None takes any sender.
    """
    for kind, name in (
        (sm.GPS_TIME, "MsgGPSTime"),
        (sm.GPS_TIME_GNSS, "MsgGPSTimeGnss"),
        (sm.GPS_TIME_DEP_A, "MsgGPSTimeDepA"),
        (sm.OBS, "MsgObs"),
    ):
        found = records.of(kind, sender)
        good = possible_week(found)
        if kind in (sm.GPS_TIME, sm.GPS_TIME_GNSS):
            good &= found.fields["flags"] & 7 != 0
        if good.any():
            m = found.take(good)
            return WeekTrack(
                number=m.number,
                week=m.fields["wn"].astype(np.int64),
                tow_ms=m.fields["tow"].astype(np.int64),
                ns=m.fields["ns"].astype(np.int64),
                source=name,
            )
    none = np.empty(0, dtype=np.int64)
    return WeekTrack(number=none, week=none, tow_ms=none, ns=none)


def measured_gps_minus_utc(
    records: SbpRecords, track: WeekTrack, sender: int | None
) -> tuple[ArrayF, ArrayF]:
    """GPS - UTC (rounded to ms) and Unix time of each MsgUtcTime that stands with a GPS time of its tow."""
    utc = records.of(sm.UTC_TIME, sender)
    utc = utc.take(utc.fields["flags"] & 7 != 0)
    if not track.number.size or not utc.number.size:
        return np.empty(0), np.empty(0)
    index = track.before(utc.number)
    names = {"year": "year", "month": "month", "day": "day", "hour": "hours", "minute": "minutes"}
    parts = pd.DataFrame({ours: utc.fields[name] for ours, name in names.items()})
    moment = pd.to_datetime(parts, errors="coerce").to_numpy("datetime64[s]")
    same = (track.tow_ms[index] == utc.fields["tow"]) & ~np.isnat(moment)
    f, index = utc.fields[same], index[same]
    seconds = moment[same].astype(np.int64) + f["seconds"]
    gps = track.week[index] * WEEK_S + track.tow_ms[index] // 1000 + GPS_EPOCH_UNIX_S
    rest = (track.tow_ms[index] % 1000) * 1e-3 + track.ns[index] * 1e-9 - f["ns"] * 1e-9
    return np.round((gps - seconds) + rest, 3), np.asarray(seconds + f["ns"] * 1e-9, dtype=np.float64)


# ---------------------------------------------------------------- tables out of decoded SBP messages


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


def positions_table(
    records: SbpRecords, track: WeekTrack, sender: int, dropped: Counter[str]
) -> tuple[pd.DataFrame, tuple[int, ...]]:
    """Positions with a fix as table kind ``gnss_position``, and the message types that they are from.

    MsgPosLLH and MsgPosLLHCov of one epoch give one row, with the covariances of the latter. Without them
    the sigmas are the accuracies that MsgPosLLH states: the horizontal one is that of the worst direction
    (it equals the longer axis of the error ellipse where a receiver sends both), and is taken for both axes.
    """
    for group in POSITION_GROUPS:
        lost: Counter[str] = Counter()
        parts = [_positions_of(records.of(kind, sender), kind, track, lost) for kind in group]
        if any(map(len, parts)):
            break
    else:
        sizes = [records.of(kind, sender).number.size for kind in POSITION_KINDS]
        dropped["positions_without_fix_dropped"] += max(sizes, default=0)
        return frame_of(GNSS_POSITION, dict.fromkeys(GNSS_POSITION.names, np.empty(0))), ()
    for reason in ("without_fix", "impossible"):
        # both messages of an epoch say the same: counting them once each would double the number
        dropped[f"positions_{reason}_dropped"] += max(lost[f"{reason} {kind}"] for kind in group)
    table = pd.concat([part.assign(rank=i) for i, part in enumerate(parts)], ignore_index=True)
    if not track.number.size:  # epochs cannot be told apart: one message type only
        table = table[table["rank"] == table["rank"].min()]
    else:
        table["epoch_ms"] = np.round(table["t_gps_s"] * 1000.0)
        again = table.duplicated(["rank", "epoch_ms"]).groupby(table["rank"]).sum()
        dropped["positions_repeated_dropped"] += int(again.max())
        table = table.sort_values(["rank", "number"], kind="stable").drop_duplicates("epoch_ms")
    table = table.sort_values("number", kind="stable", ignore_index=True)
    table["age_s"] = _age(records, track, sender, table["t_gps_s"])
    used = tuple(group[i] for i in sorted(table["rank"].unique()))
    return frame_of(GNSS_POSITION, dict(table)), used


def _positions_of(messages: Records, kind: int, track: WeekTrack, lost: Counter[str]) -> pd.DataFrame:
    """Columns of one message type, with the number of the message."""
    names = sm.FIX_DEP_A if kind in sm.DEP_A else sm.FIX
    words = names[messages.fields["flags"] & 7]
    first = "x" if kind in _ECEF_KINDS else "lat"
    empty = messages.fields[first] == 0  # a receiver without solution sends zeros
    with_fix = np.asarray((words != "none") & ~empty)
    lost[f"without_fix {kind}"] += int((~with_fix).sum())
    m = messages.take(with_fix)
    values = _geodetic(m, kind)
    t = track.times(m)
    values |= {"t_gps_s": t, "fix": words[with_fix], "n_sats": m.fields["n_sats"], "number": m.number}
    possible = (np.abs(values["lat_deg"]) <= 90) & (np.abs(values["lon_deg"]) <= 360)
    possible &= np.isfinite(values["h_ell_m"]) & ~(np.isnan(t) & bool(track.number.size))
    lost[f"impossible {kind}"] += int((~possible).sum())
    return pd.DataFrame({**dict.fromkeys(GNSS_POSITION.names, np.nan), **values})[possible]


def _geodetic(m: Records, kind: int) -> dict[str, Any]:
    """Latitude, longitude, height, sigmas and covariances in east-north-up."""
    f = m.fields
    if kind in _ECEF_KINDS:
        lat, lon, h = geodetic_of(np.stack([f["x"], f["y"], f["z"]], axis=-1))
        out: dict[str, Any] = {"lat_deg": lat, "lon_deg": lon, "h_ell_m": h}
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


def _age(records: SbpRecords, track: WeekTrack, sender: int, t_gps_s: "pd.Series[float]") -> ArrayF:
    """Age of the corrections from the MsgAgeCorrections of the same time, NaN where there is none."""
    age = records.of(sm.AGE, sender)
    age = age.take(age.fields["age"] != 0xFFFF)
    stated = pd.Series(age.fields["age"] * 0.1, index=np.round(track.times(age) * 1000.0))
    return np.asarray(stated[~stated.index.duplicated()].reindex(np.round(t_gps_s * 1000.0)))


def base_positions(records: SbpRecords) -> ArrayF:
    """Earth-centred base positions (n, 3) in metres that the log states, zeros left out."""
    f = records.of(sm.BASE_ECEF).fields
    xyz = np.stack([f["x"], f["y"], f["z"]], axis=-1)
    xyz = xyz[np.isfinite(xyz).all(axis=1) & (np.linalg.norm(xyz, axis=1) > 6e6)]
    if xyz.shape[0]:
        return np.asarray(xyz)
    f = records.of(sm.BASE_LLH).fields
    f = f[(np.abs(f["lat"]) <= 90) & (f["lat"] != 0) & np.isfinite(f["lon"]) & np.isfinite(f["height"])]
    return ecef_of(f["lat"], f["lon"], f["height"])


# ---------------------------------------------------------------- what the integrity report says about an SBP
# log: messages, clock, UTC offset, base, gaps


_BASE_MOVE_M: Final = 0.001
_MILLISECOND_S: Final = 1e-3
_NANOSECOND_S: Final = 1e-9
_UTC_TOLERANCE_S: Final = 0.0015
"""Offsets are rounded to a millisecond; leap seconds differ by whole seconds."""


def message_name(kind: int) -> str | None:
    """Name of a message type in the library ``sbp``, None if it knows none.

    Examples
    --------
    >>> message_name(0x020A), message_name(0xFFF0)
    ('MsgPosLLH', None)
    """
    from sbp.table import lookup  # takes as long to import as numpy, and every `describe` imports this module

    found = lookup(kind)
    return None if found is None else str(found.__name__)


def _clock(report: IntegrityReport, track: WeekTrack, positions: pd.DataFrame) -> None:
    """Times of the positions, or without any of the messages that state them."""
    t, what = positions["t_gps_s"].to_numpy(), "positions"
    if not np.isfinite(t).any():
        t, what = track.t_gps_s, "time messages"
        t = t[np.diff(t, prepend=np.nan) != 0]  # an epoch has several messages of observations
    if not t.size:
        report.note(
            "No message states a valid GPS week (MsgGPSTime, MsgObs): the time of the week alone is no date, "
            "and nothing in this log can be timed."
        )
        return
    report.synchronised, report.time_scale = True, "gps"
    report.take_times(t, what, _NANOSECOND_S if track.ns.any() else _MILLISECOND_S)
    report.details["GPS week from"] = track.source
    if back := report.losses.get("time_steps_back", 0):
        report.note(f"Time steps backwards {back:,} times among {t.size:,} {what}.")


def _messages(report: IntegrityReport, records: SbpRecords) -> None:
    counts = sorted(records.counts.items(), key=lambda item: -item[1])
    by_type: Counter[int] = Counter()
    for (kind, _), n in counts:
        by_type[kind] += n
    unknown = {kind: n for kind, n in by_type.items() if message_name(kind) is None}
    if unknown:
        report.count("messages_of_unknown_type", sum(unknown.values()))
        report.note(
            "Message types that the SBP specification does not name: "
            + ", ".join(f"0x{kind:04X} ({n:,})" for kind, n in unknown.items())
            + "."
        )
    wrong = sum(records.wrong_size.values())
    if wrong:
        report.lose("messages_of_wrong_size", wrong)
        report.note(
            "Messages not of the documented size, left out: "
            + ", ".join(f"{message_name(kind)} ({n:,})" for kind, n in records.wrong_size.items())
            + "."
        )
    ephemerides = sum(n for kind, n in by_type.items() if (message_name(kind) or "").startswith("MsgEphem"))
    for name, n in (
        ("imu_raw", by_type[sm.IMU_RAW]),
        ("mag_raw", by_type[sm.MAG_RAW]),
        ("ephemerides", ephemerides),
    ):
        report.count_some(name, n)
    if events := by_type[sm.EVENT]:
        report.note(f"Not read: {events:,} times of events, such as pulses of a camera (MsgExtEvent).")
    for sender in sorted({s for s, _ in records.signals}):
        report.details[f"signals by code, sender {sender}"] = {
            str(code): n for (s, code), n in sorted(records.signals.items()) if s == sender
        }
    report.details["messages by type and sender"] = {
        f"{message_name(kind) or f'0x{kind:04X}'} {sender}": n for (kind, sender), n in counts
    }


def _utc(report: IntegrityReport, offset_s: ArrayF, unix_s: ArrayF) -> None:
    """Compare the receiver's GPS - UTC with the table of leap seconds."""
    if not offset_s.size:
        return
    values, counts = np.unique(offset_s, return_counts=True)
    report.details["GPS - UTC"] = {f"{value:.3f} s": int(n) for value, n in zip(values, counts, strict=True)}
    table = gps_minus_utc(unix_s)
    wrong = np.abs(offset_s - table) > _UTC_TOLERANCE_S
    if wrong.any():
        first = int(np.argmax(wrong))
        moment = utc_text_from_unix(unix_s[first])
        report.note(
            f"The receiver states GPS - UTC = {offset_s[first]:.3f} s at {moment}, "
            f"the table of leap seconds (complete until {LEAP_TABLE_VALID_UNTIL}) {table[first]:.0f} s "
            f"({int(wrong.sum()):,} of {wrong.size:,} stamps differ). GPS times come from MsgGPSTime and do "
            "not depend on it."
        )


# ---------------------------------------------------------------- reader


def read_sbp(files: Sequence[Path], *, chunk_bytes: int = CHUNK_BYTES) -> PositionLog:
    """The receiver's own solution, epochs with a fix.

    Parameters
    ----------
    files : parts of one recording in the order of recording. Epochs that two files share are kept once; a
        message split between two files is whole again.
    chunk_bytes : bytes read at a time.

    Raises
    ------
    InputError : no files, a file that cannot be read or holds no SBP message, or all files are empty.
    """
    records = collect([Path(f) for f in files], chunk_bytes)
    # a number that no receiver should send is a finding in the report, not an error of arithmetic
    with np.errstate(over="ignore", invalid="ignore"):
        return _log_of(records)


def _log_of(records: SbpRecords) -> PositionLog:
    sender, others = _rover(records)
    track = build_track(records, sender or None)
    dropped: Counter[str] = Counter()
    positions, kinds = positions_table(records, track, sender, dropped)
    base = base_positions(records)
    report = IntegrityReport.of("gnss", "SBP", ())
    _clock(report, track, positions)
    records.tally.write(report, "message")
    _messages(report, records)
    _utc(report, *measured_gps_minus_utc(records, track, sender or None))
    report.count("positions", len(positions))
    if len(positions):
        report.details["positions from"] = " + ".join(str(message_name(k)) for k in kinds)
        report.details["fixes"] = {str(k): int(v) for k, v in positions["fix"].value_counts().items()}
    else:
        report.note("The log holds no position with a fix.")
    if len(base):
        report.count("base_positions", len(base))
        if len(positions):
            rover = ecef_of(*positions[["lat_deg", "lon_deg", "h_ell_m"]].median())
            away_m = float(np.linalg.norm(rover - np.median(base, axis=0)))
            report.details["distance of the base"] = f"{away_m / 1000:.3f} km, median"
        spread = float(np.ptp(base, axis=0).max())
        if spread > _BASE_MOVE_M:
            report.note(
                f"The base positions stated in the log differ by up to {spread:.3f} m; the median is used."
            )
    obs = records.of(sm.OBS)
    obs = obs.take(possible_week(obs))
    epochs = pd.DataFrame({"sender": obs.sender, "wn": obs.fields["wn"], "tow": obs.fields["tow"]})
    for who, n in epochs.drop_duplicates()["sender"].value_counts().sort_index().items():
        report.count("observation_epochs_base" if who == 0 else f"observation_epochs_{who}", int(n))
    report.lose("positions_impossible", dropped.pop("positions_impossible_dropped", 0))
    for name, n in dropped.items():
        report.count_some(name, n)
    if others:
        report.note(
            f"Positions of sender {sender} are used; those of {', '.join(map(str, sorted(others)))} "
            f"({sum(others.values()):,} messages) are not."
        )
    return PositionLog(positions=positions, report=report)


def _rover(records: SbpRecords) -> tuple[int, dict[int, int]]:
    """The sender with most positions (else times, else observations; 0 if none), and the other ones."""
    for kinds in (POSITION_KINDS, (sm.GPS_TIME, sm.GPS_TIME_DEP_A), (sm.OBS,)):
        found = records.senders(kinds)
        if found:
            best = max(sorted(found), key=lambda sender: found[sender])
            others = {s: n for s, n in found.items() if s != best}
            return best, others if kinds == POSITION_KINDS else {}
    return 0, {}
