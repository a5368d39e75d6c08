"""What a reader says about a log: counts, losses, gaps, clock state. Nothing is lost without a number."""

import json
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, Self, SupportsInt

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from thalweg.core import AnyArray, ArrayB, ArrayF, read_json, utc_text_from_gps
from thalweg.ingest.stamps import StreamTiming

TimeScale = Literal["gps", "utc", "device", "host", "none"]
"""Scale of a stream's own stamps: GPS or UTC if disciplined, else its free-running clock."""


@dataclass(slots=True, kw_only=True)
class Gap:
    """A hole in a stream: where it begins, how long it is and what is known about its cause.

    ``t_start_s`` is on the time scale of the stream, NaN where its clock was not set yet.
    """

    t_start_s: float
    duration_s: float
    lost: int = 0
    """Records estimated to be lost, 0 if unknown."""


@dataclass(slots=True, kw_only=True)
class IntegrityReport:
    """Findings about one stream of one or several files.

    ``t_first_s`` and ``t_last_s`` are adjusted GPS times if ``synchronised`` is true, else seconds on
    the device's own clock. ``losses`` counts what is missing or damaged (bytes or records, the key
    says which); ``timing`` is the state of the clock; ``notes`` are sentences for people, worst first.
    """

    stream: str
    format: str
    files: list[str]
    model: str = ""
    time_scale: TimeScale = "none"
    synchronised: bool = False
    t_first_s: float | None = None
    t_last_s: float | None = None
    bytes_read: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    losses: dict[str, int] = field(default_factory=dict)
    rates_hz: dict[str, float] = field(default_factory=dict)
    gaps: list[Gap] = field(default_factory=list)
    timing: StreamTiming = field(default_factory=StreamTiming)
    details: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, stream: str, words: str, files: Iterable[Path], **more: Any) -> Self:
        """A report of files whose format is ``words``."""
        return cls(stream=stream, format=words, files=[str(path) for path in files], **more)

    @property
    def clean(self) -> bool:
        """True if nothing is missing or damaged."""
        return not any(self.losses.values()) and not self.gaps

    def lose(self, what: str, n: SupportsInt = 1) -> None:
        """Count a loss; nothing lost leaves no entry."""
        if int(n):
            self.losses[what] = self.losses.get(what, 0) + int(n)

    def count(self, what: str, n: int = 1) -> None:
        """Count something read."""
        self.counts[what] = self.counts.get(what, 0) + int(n)

    def count_some(self, what: str, n: SupportsInt) -> None:
        """Count something read; none of it leaves no entry."""
        if int(n):
            self.count(what, int(n))

    def note(self, sentence: str) -> None:
        """Add a sentence for people, once."""
        if sentence not in self.notes:
            self.notes.append(sentence)

    def take_times(self, t_s: ArrayLike, rows: str, resolution_s: float | None = None) -> None:
        """Take span, gaps, rate, jitter, times that step back or repeat from the times of the stream.

        Parameters
        ----------
        t_s : (n,) in the order of the log, NaN for a row without a time.
        rows : what has these times, in the plural.
        resolution_s : unit of the stamps, if the format tells.
        """
        every = np.asarray(t_s, dtype=np.float64)
        t = every[np.isfinite(every)]
        self.timing.describe_stamps(t, resolution_s)
        self.timing.unsynchronised_s = (every.size - t.size) * (self.timing.period_s or 0.0)
        self.gaps = find_gaps(t)
        if t.size:
            self.t_first_s, self.t_last_s = float(t.min()), float(t.max())
        step = np.diff(t)
        if np.any(step > 0):
            self.rates_hz[rows] = 1.0 / float(np.median(step[step > 0]))
        for what, n in (
            ("time_steps_back", int(np.sum(step < 0))),
            ("repeated_times", int(np.sum(step == 0))),
        ):
            self.lose(what, n)

    def take_gps_times(self, t_gps_s: ArrayLike, rows: str) -> None:
        """Count the rows, and `take_times` of them: synchronised where one has GPS time."""
        self.synchronised = bool(np.isfinite(np.asarray(t_gps_s, np.float64)).any())
        self.count(rows, np.size(t_gps_s))
        self.take_times(t_gps_s, rows)

    def keep_once(self, table: pd.DataFrame, file: AnyArray, what: str) -> ArrayB:
        """False (n,) for rows that an earlier file holds already; they are counted as ``what``, a plural."""
        again = repeated_rows(table, file)
        if n := int(again.sum()):
            self.count(f"repeated_{what.replace(' ', '_')}_dropped", n)
            self.note(f"The files overlap: {n:,} {what} that occur in two of them are kept once.")
        return ~again

    def to_json(self) -> str:
        """JSON text; NaN is written as null."""
        return json.dumps(_plain(asdict(self)), indent=2, allow_nan=False) + "\n"

    def write(self, path: Path) -> None:
        """Write the report as JSON."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(self.to_json())

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a report written by `write`."""
        data = read_json(path, "a report of a reader")
        # JSON knows no NaN: a hole before the clock was set has no time
        data["gaps"] = [
            Gap(**(gap | {"t_start_s": math.nan if gap["t_start_s"] is None else gap["t_start_s"]}))
            for gap in data["gaps"]
        ]
        timing = StreamTiming(**data.pop("timing", {}))
        timing.unsynchronised = [(float(a), float(b)) for a, b in timing.unsynchronised]
        data["timing"] = timing
        return cls(**data)

    def lines(self) -> list[str]:
        """The report as text lines for a terminal."""
        out = [f"{self.stream}: {self.format}" + (f", {self.model}" if self.model else "")]
        out += [f"  file      {name}" for name in self.files]
        if self.t_first_s is not None and self.t_last_s is not None:
            span = self.t_last_s - self.t_first_s
            if self.synchronised:
                out.append(
                    f"  time      {utc_text_from_gps(self.t_first_s)} .. "
                    f"{utc_text_from_gps(self.t_last_s)} ({span:.3f} s), stamps in {self.time_scale.upper()}"
                )
            else:
                out.append(
                    f"  time      unsynchronised: {self.t_first_s:.6f} .. {self.t_last_s:.6f} s "
                    f"({span:.3f} s) on the {self.time_scale} clock"
                )
        else:
            out.append("  time      none")
        for title, numbers in (("counts", self.counts), ("losses", self.losses)):
            text = ", ".join(f"{k} {v:,}" for k, v in numbers.items()) or "none"
            out.append(f"  {title:9s} {text}")
        if self.timing.period_s is not None and self.timing.jitter_s is not None:
            out.append(
                f"  stamps    every {self.timing.period_s:.6g} s, jitter {self.timing.jitter_s:.2g} s, "
                f"at most {self.timing.jitter_max_s or 0.0:.2g} s"
            )
        if self.rates_hz:
            out.append("  rates     " + ", ".join(f"{k} {v:.4g} Hz" for k, v in self.rates_hz.items()))
        if self.gaps:
            longest = max(self.gaps, key=lambda g: g.duration_s)
            lost = sum(g.lost for g in self.gaps)
            out.append(
                f"  gaps      {len(self.gaps)}, longest {longest.duration_s:.6g} s"
                + (f", about {lost:,} records lost" if lost else "")
            )
        for key, value in self.details.items():
            if isinstance(value, dict):
                value = ", ".join(
                    f"{k} {v:,}" if isinstance(v, int) else f"{k} {v}" for k, v in value.items()
                )
            out.append(f"  {key:9s} {value}")
        out += [f"  note      {sentence}" for sentence in self.notes]
        return out


def find_gaps(t_s: ArrayLike, factor: float = 1.5) -> list[Gap]:
    """Gaps of a regular stream: steps longer than ``factor`` times the median step.

    Parameters
    ----------
    t_s : (n,) stamps in seconds, increasing; NaN are left out.
    factor : what counts as a gap, in steps.
    """
    t = np.asarray(t_s, dtype=np.float64)
    t = t[np.isfinite(t)]
    if t.size < 3:
        return []
    step = np.diff(t)
    normal = float(np.median(step[step > 0])) if np.any(step > 0) else 0.0
    if normal <= 0:
        return []
    holes = np.flatnonzero(step > factor * normal)
    return [
        Gap(t_start_s=float(t[i]), duration_s=float(step[i]), lost=max(0, round(float(step[i]) / normal) - 1))
        for i in holes
    ]


LONGEST_BRIDGE_S: Final = 2.0
"""Between stamps farther apart a boat is not taken to keep its course, unless they always are."""


def interpolated(t_s: ArrayLike, known_s: ArrayLike, values: ArrayLike) -> ArrayF:
    """Values (n,) at other times; NaN outside of the known times and in their holes.

    Parameters
    ----------
    t_s : (n,) times.
    known_s, values : (m,) times that increase, and values at these; holes are steps longer than
        `LONGEST_BRIDGE_S` and than 1.5 times the median step.
    """
    t, known, of_known = (np.asarray(each, np.float64) for each in (t_s, known_s, values))
    after = np.clip(np.searchsorted(known, t), 1, max(known.size - 1, 0))
    step, usual_s = known[after] - known[after - 1], np.median(np.diff(known)) if known.size > 1 else 0.0
    within = (t > known[after - 1]) & (t < known[after]) & (step > max(LONGEST_BRIDGE_S, 1.5 * usual_s))
    return np.where(within, np.nan, np.interp(t, known, of_known, left=np.nan, right=np.nan))


def _plain(value: Any) -> Any:
    """The value with numpy scalars as Python numbers and non-finite numbers as None, for JSON."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


# ---------------------------------------------------------------- Rows that two files of one recording
# both hold


def repeated_rows(table: pd.DataFrame, file: AnyArray) -> ArrayB:
    """True for rows that an earlier file holds already, with the same content in all columns.

    Rows that are repeated inside one file are none of these: an instrument may send the same value twice.

    Parameters
    ----------
    table : (n,) rows, their time among the columns; NaN equals NaN.
    file : (n,) number of the file of each row.

    Examples
    --------
    >>> rows = pd.DataFrame({"t_gps_s": [1.0, 2.0, 2.0, 2.0, 3.0], "depth_m": [5.0, 6.0, 6.0, 6.0, 6.0]})
    >>> repeated_rows(rows, np.array([0, 0, 0, 1, 1])).tolist()
    [False, False, False, True, False]
    """
    number = np.asarray(file, dtype=np.int64)
    if number.size == 0 or number.min() == number.max():
        return np.zeros(number.size, dtype=np.bool_)
    group = table.groupby(list(table.columns), dropna=False, sort=False).ngroup().to_numpy()
    first = np.full(int(group.max()) + 1, number.max(), dtype=np.int64)
    np.minimum.at(first, group, number)
    return np.asarray(number > first[group])
