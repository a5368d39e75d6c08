"""GPS time of SBP messages: most carry the time of the week only."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.timescales import GPS_EPOCH_UNIX_S, WEEK_S, gps_from_week
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.ingest.sbp import messages as sm
from thalweg.ingest.sbp.records import Messages, SbpRecords

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

    def times(self, messages: Messages) -> ArrayF:
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


def possible_week(messages: Messages) -> ArrayB:
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
    f = utc.fields
    ok = (f["flags"] & 7 != 0) & (f["month"] >= 1) & (f["month"] <= 12) & (f["day"] >= 1) & (f["day"] <= 31)
    ok &= (f["year"] >= 1980) & (f["year"] < 2200) & (f["hours"] < 24) & (f["minutes"] < 60)
    if not track.number.size or not ok.any():
        return np.empty(0), np.empty(0)
    utc = utc.take(np.asarray(ok))
    index = track.before(utc.number)
    same = track.tow_ms[index] == utc.fields["tow"]
    f, index = utc.fields[same], index[same]
    months = (f["year"].astype(np.int64) - 1970) * 12 + f["month"] - 1
    days = months.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64) + f["day"] - 1
    seconds = ((days * 24 + f["hours"]) * 60 + f["minutes"]) * 60 + f["seconds"]
    gps = track.week[index] * WEEK_S + track.tow_ms[index] // 1000 + GPS_EPOCH_UNIX_S
    rest = (track.tow_ms[index] % 1000) * 1e-3 + track.ns[index] * 1e-9 - f["ns"] * 1e-9
    return np.round((gps - seconds) + rest, 3), np.asarray(seconds + f["ns"] * 1e-9, dtype=np.float64)
