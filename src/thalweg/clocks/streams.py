"""Do the streams of a campaign lie on one GPS time axis, and who stamps them how well?"""

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d

from thalweg.clocks.ties import TRIGGERED, ClockModel, image_times_words
from thalweg.core import (
    ArrayF,
    ArrayI,
    ClockError,
    CoverageError,
    GeometryError,
    InputError,
    LocalFrame,
    Trajectory,
    root_mean_square,
    rotation_enu_body,
    utc_text_from_gps,
)
from thalweg.ingest import Gap, IntegrityReport, hours_text

_NAMED_GAPS: Final = 20

LIMIT_S: Final = 0.005
"""Smaller offsets do no harm: at 7 degrees/s they turn the beam by 0.035 degrees, a fifth of its sigma."""
MAX_LAG_S: Final = 1.0
"""An offset of whole seconds (leap seconds, a wrong hour) shows in the common span and in the positions."""
BAND_HZ: Final = (0.1, 2.0)
"""Frequencies of a boat's swaying."""
_LEAST: Final = 50
_ITERATIONS: Final = 8
_SMOOTH: Final = 9
"""Frequencies over which the spectrum of the residuals is averaged."""

_HOUR_S: Final = 3600.0
_SHARED: Final = 0.5
"""Share of the shorter log that must overlap after a shift by whole hours, for the shift to be named."""

COLUMNS: Final = (
    "stream",
    "stamped_by",
    "against",
    "synchronised",
    "offset_s",
    "sigma_offset_s",
    "drift_ppm",
    "sigma_drift_ppm",
    "jitter_s",
    "sigma_jitter_s",
    "resolution_s",
    "lag_against",
    "lag_s",
    "sigma_lag_s",
    "lag_significant",
    "sigma_time_s",
    "range_m",
    "cost_mm",
    "cost_if_ignored_mm",
    "remark",
)
_NEEDED: Final = ("stream", "format", "synchronised", "time_scale", "resolution_s")


@dataclass(frozen=True, slots=True, kw_only=True)
class Lag:
    """What b shows at ``t`` happened in a at ``t - offset_s``: positive if the stamps of b are late.

    ``sigma_s`` holds the correlation of the residuals; NaN offsets if the streams do not tell. ``n`` is the
    number of epochs of b that were used.
    """

    offset_s: float
    sigma_s: float
    n: int

    @property
    def significant(self) -> bool:
        """True if the offset is more than three sigmas from zero and large enough to matter."""
        return bool(abs(self.offset_s) > max(3.0 * self.sigma_s, LIMIT_S))


# ---------------------------------------------------------------- do the streams overlap?


def stream_table(
    reports: list[IntegrityReport], lags: dict[str, tuple[str, Lag]] | None = None
) -> pd.DataFrame:
    """One row a stream: span, rate, jitter, clock state, PPS, gaps and losses.

    Parameters
    ----------
    reports : one report a stream.
    lags : for a stream, the other stream against which its stamps were checked, and the result.

    Returns
    -------
    Columns ``stream, format, model, synchronised, time_scale, t_first_s, t_last_s, first_utc, last_utc,
    duration_s, rate_hz``: ``t_*`` are adjusted GPS times of synchronised streams, device times of others;
    ``rate_hz`` is the first rate that is stated. ``period_s, jitter_s, jitter_max_s, resolution_s, clock,
    clock_offset_s, sigma_clock_offset_s, clock_drift_ppm, sigma_clock_drift_ppm, clock_set_s,
    pps_locked_share, pps_unlocked_start_s, pps_losses, unsynchronised_s`` are explained in
    `thalweg.ingest.stamps.StreamTiming`; empty where the log does not tell. ``lag_against, lag_s,
    sigma_lag_s, lag_n, lag_significant``: how late the stamps are against another stream. ``n_gaps,
    longest_gap_s, gaps`` (begin and length, the longest 20), ``lost_records, lost_bytes, notes``.
    """
    rows = []
    for report in reports:
        first, last = report.t_first_s, report.t_last_s
        gps = report.synchronised and first is not None and last is not None
        rows.append(
            {
                "stream": report.stream,
                "format": report.format,
                "model": report.model,
                "synchronised": report.synchronised,
                "time_scale": report.time_scale,
                "t_first_s": first,
                "t_last_s": last,
                "first_utc": utc_text_from_gps(first) if gps and first is not None else "",
                "last_utc": utc_text_from_gps(last) if gps and last is not None else "",
                "duration_s": last - first if first is not None and last is not None else None,
                "rate_hz": next(iter(report.rates_hz.values()), None),
                **_clock_columns(report),
                **_lag_columns((lags or {}).get(report.stream)),
                "n_gaps": len(report.gaps),
                "longest_gap_s": max((g.duration_s for g in report.gaps), default=0.0),
                "gaps": gaps_text(report.gaps, gps=report.synchronised),
                "lost_records": sum(n for what, n in report.losses.items() if "bytes" not in what),
                "lost_bytes": sum(n for what, n in report.losses.items() if "bytes" in what),
                "notes": " | ".join(report.notes),
            }
        )
    return pd.DataFrame(rows)


def _clock_columns(report: IntegrityReport) -> dict[str, Any]:
    timing = report.timing
    rate_hz = next(iter(report.rates_hz.values()), None)
    return {
        "period_s": timing.period_s if timing.period_s is not None or not rate_hz else 1.0 / rate_hz,
        **{
            name: getattr(timing, name)
            for name in (
                "jitter_s",
                "jitter_max_s",
                "resolution_s",
                "clock",
                "clock_offset_s",
                "sigma_clock_offset_s",
                "clock_drift_ppm",
                "sigma_clock_drift_ppm",
                "clock_set_s",
                "pps_locked_share",
                "pps_unlocked_start_s",
                "pps_losses",
                "unsynchronised_s",
            )
        },
    }


def _lag_columns(checked: tuple[str, Lag] | None) -> dict[str, Any]:
    if checked is None or not np.isfinite(checked[1].offset_s):
        names = ("lag_s", "sigma_lag_s", "lag_n", "lag_significant")
        return {"lag_against": "" if checked is None else checked[0], **dict.fromkeys(names)}
    other, lag = checked
    return {
        "lag_against": other,
        "lag_s": lag.offset_s,
        "sigma_lag_s": lag.sigma_s,
        "lag_n": lag.n,
        "lag_significant": lag.significant,
    }


def gaps_text(gaps: list[Gap], *, gps: bool) -> str:
    """Begin and length of gaps in one cell, the longest 20 in order of time.

    Examples
    --------
    >>> gaps_text([Gap(t_start_s=12.5, duration_s=0.25)], gps=False)
    '12.500 +0.250 s'
    """
    shown = sorted(gaps, key=lambda gap: -gap.duration_s)[:_NAMED_GAPS]
    placed = sorted((gap for gap in shown if np.isfinite(gap.t_start_s)), key=lambda gap: gap.t_start_s)
    words = [f"before the clock was set +{g.duration_s:.3f} s" for g in shown if not np.isfinite(g.t_start_s)]
    words += [
        f"{utc_text_from_gps(gap.t_start_s) if gps else f'{gap.t_start_s:.3f}'} +{gap.duration_s:.3f} s"
        for gap in placed
    ]
    if len(gaps) > len(shown):
        words.append(f"{len(gaps) - len(shown)} shorter ones")
    return " | ".join(words)


def common_span(reports: list[IntegrityReport], needed: list[str]) -> tuple[float, float]:
    """First and last instant, in adjusted GPS time, that all needed streams cover.

    Parameters
    ----------
    reports : one report a stream.
    needed : names of streams without which there is no chain.

    Raises
    ------
    ClockError : a needed stream is absent, has no GPS time, or does not overlap with the others.
    """
    by_name = {report.stream: report for report in reports}
    for name in needed:
        report = by_name.get(name)
        if report is None:
            raise ClockError(
                f"there is no stream '{name}'", expected=f"the streams {needed}", cure="Add its logs"
            )
        if not report.synchronised or report.t_first_s is None or report.t_last_s is None:
            raise ClockError(
                f"stream '{name}' ({report.format}) never gets GPS time: " + "; ".join(report.notes),
                where=", ".join(report.files),
                expected="stamps that are tied to GPS or UTC",
                cure="Check PPS and NMEA cabling and the GNSS reception of that instrument"
                + ("; or state the time: lidar.clock.first_packet_utc" if name == "lidar" else ""),
            )
    spans = {name: (by_name[name].t_first_s or 0.0, by_name[name].t_last_s or 0.0) for name in needed}
    first = max(span[0] for span in spans.values())
    last = min(span[1] for span in spans.values())
    if last <= first:
        text = "; ".join(f"{name} {span_text(*span)}" for name, span in spans.items()) + _shifts(spans)
        raise ClockError(
            f"the streams have no common time: {text}",
            expected="logs of one survey",
            cure="Check the dates of the files, the leap seconds and the hour of the lidar",
        )
    return first, last


def _shifts(spans: dict[str, tuple[float, float]]) -> str:
    """Which stream is apart from which, as a further part of a sentence."""
    names = list(spans)
    words = {
        (name, other): apart_words(spans[name], spans[other])
        for k, other in enumerate(names)
        for name in names[:k]
    }
    return "".join(f"; {name} against {other}: {how}" for (name, other), how in words.items() if how)


# ---------------------------------------------------------------- offset between the stamps of two streams
# that show the same motion


def stream_lag(
    t_a: ArrayLike, v_a: ArrayLike, t_b: ArrayLike, v_b: ArrayLike, max_lag_s: float = MAX_LAG_S
) -> Lag:
    """Time offset between two records of the same quantity, by least squares on its derivative.

    The best offset on a grid is refined by Newton steps on the score ``sum w (v_b(t) - v_a(t - offset) - c)``
    with ``w``, the derivative of a within `BAND_HZ`: slower errors of both streams then play no part, nor has
    the noise of the derivative. The variance is ``sum_f |W(f)|^2 S(f)`` over the square of the score's slope,
    with the spectrum ``W`` and the smoothed spectrum ``S`` of the residuals. Those of differenced positions
    are blue, those of slow errors red, and only what lies at the frequencies of the motion counts. In the
    slope, the term of the second derivative takes off what the noise of a itself adds to ``sum w w``.

    Parameters
    ----------
    t_a, t_b : (n,), (m,) increasing, seconds. b is regular but for missing epochs, a denser than the motion.
    v_a, v_b : (n,) or (n, k), (m,) or (m, k) the same quantity, such as a velocity.
    max_lag_s : the offset is looked for between minus and plus this.

    Returns
    -------
    Offset and sigma are NaN if fewer than 50 epochs overlap, if nothing moves, or if the best offset is at an
    end of what was searched.

    Raises
    ------
    GeometryError : shapes that do not belong together.
    """
    ta, tb = np.asarray(t_a, np.float64), np.asarray(t_b, np.float64)
    va, vb = (np.asarray(v, np.float64).reshape(len(t), -1) for v, t in ((v_a, ta), (v_b, tb)))
    if va.shape[1] != vb.shape[1]:
        raise GeometryError(f"{va.shape=}, {vb.shape=}", expected="the same number of components")
    known = np.isfinite(ta) & np.isfinite(va).all(axis=1)
    ta, va = ta[known], va[known]
    known = np.isfinite(tb) & np.isfinite(vb).all(axis=1)
    if len(ta) >= 4:
        known &= (tb > ta[0] + max_lag_s) & (tb < ta[-1] - max_lag_s)
    tb, vb = tb[known], vb[known]
    nothing = Lag(offset_s=float("nan"), sigma_s=float("nan"), n=len(tb))
    if len(ta) < 4 or len(tb) < _LEAST:
        return nothing
    spline = CubicSpline(ta - ta[0], va)
    t = tb - ta[0]
    offset = _coarse(spline, t, vb, max_lag_s)
    grid = _Grid.of(t)
    for _ in range(_ITERATIONS):
        residual = vb - spline(t - offset)
        residual = residual - residual.mean(axis=0)
        weight, change = grid.instrument(spline, offset)
        score = float((weight * residual).sum())
        power = float((weight * spline(t - offset, 1)).sum() - (change * residual).sum())
        if not power > 0:
            return nothing
        offset = float(np.clip(offset - score / power, -max_lag_s, max_lag_s))
        if abs(score / power) < 1e-6:
            break
    if abs(offset) >= max_lag_s:
        return nothing
    return Lag(offset_s=offset, sigma_s=grid.score_sigma(weight, residual) / power, n=len(tb))


def _coarse(spline: CubicSpline, t: ArrayF, v: ArrayF, max_lag_s: float) -> float:
    """The offset on a grid that leaves least, taken over at most 2000 epochs."""
    few = np.linspace(0, len(t) - 1, min(len(t), 2000)).astype(np.int64)
    step = max(0.2 * float(np.median(np.diff(t))), max_lag_s / 200)
    grid = np.arange(-max_lag_s, max_lag_s + step / 2, step)

    def misfit(offset: float) -> float:
        """Sum of squares that an offset leaves, after a constant difference of both series."""
        rest = v[few] - spline(t[few] - offset)
        return float(np.square(rest - rest.mean(axis=0)).sum())

    return float(grid[int(np.argmin([misfit(float(x)) for x in grid]))])


@dataclass(frozen=True, slots=True)
class _Grid:
    """The regular grid of the epochs of b, with the places that are filled."""

    first_s: float
    step_s: float
    place: ArrayI
    n: int

    @classmethod
    def of(cls, t: ArrayF) -> Self:
        """The regular grid on which times (n,) lie."""
        step = float(np.median(np.diff(t)))
        place = np.rint((t - t[0]) / step).astype(np.int64)
        return cls(float(t[0]), step, place, int(place[-1]) + 1)

    def instrument(self, spline: CubicSpline, offset_s: float) -> tuple[ArrayF, ArrayF]:
        """Derivative of a within the band of a boat's motion, and the change of that, at the epochs."""
        t = self.first_s + np.arange(self.n) * self.step_s - offset_s
        f = np.fft.rfftfreq(self.n, self.step_s)[:, None]
        spectrum = np.fft.rfft(spline(t, 1), axis=0) * ((f >= BAND_HZ[0]) & (f <= BAND_HZ[1]))
        weight = np.fft.irfft(spectrum, self.n, axis=0)
        change = np.fft.irfft(spectrum * 2j * np.pi * f, self.n, axis=0)
        return weight[self.place], change[self.place]

    def score_sigma(self, weight: ArrayF, residual: ArrayF) -> float:
        """Standard deviation of ``sum(weight * residual)`` for stationary residuals; missing epochs are 0."""
        total = 0.0
        for axis in range(weight.shape[1]):
            w, r = np.zeros(self.n), np.zeros(self.n)
            w[self.place], r[self.place] = weight[:, axis], residual[:, axis]
            size = 2 * self.n  # zeros behind it: the ends of the record are no neighbours
            spectrum = np.square(np.abs(np.fft.fft(r, size)))
            smooth = uniform_filter1d(spectrum, 2 * _SMOOTH, mode="wrap") / len(residual)
            total += float(np.sum(np.square(np.abs(np.fft.fft(w, size))) * smooth) / size)
        # the offset was fitted: at the frequencies of the motion what is left is too small by as much
        return float(np.sqrt(total * _SMOOTH / (_SMOOTH - 1.0)))


def ins_position_lag(
    states: pd.DataFrame,
    positions: pd.DataFrame,
    frame: LocalFrame,
    *,
    lever_ics_antenna_m: ArrayLike,
    max_lag_s: float = MAX_LAG_S,
) -> Lag:
    """Offset of the positions' stamps against those of the INS, from the velocity of the antenna.

    The INS gives the velocity of the antenna (its own, and the turning lever arm), averaged over the step of
    the positions; the positions give their differences over that step. Both are then the same quantity.

    Parameters
    ----------
    states : table kind ``ins_state`` with velocities.
    positions : table kind ``gnss_position``, of the antenna.
    frame : the world frame.
    lever_ics_antenna_m : (3,) antenna in the body frame.
    max_lag_s : as in `stream_lag`.

    Returns
    -------
    NaN where there are no velocities, or too few neighbouring epochs of the same fix.
    """
    columns = ["t_gps_s", "v_east_mps", "v_north_mps", "v_down_mps", "roll_rad", "pitch_rad", "heading_rad"]
    ins = states.dropna(subset=columns).sort_values("t_gps_s", kind="stable").drop_duplicates("t_gps_s")
    known = positions.dropna(subset=["t_gps_s", "lat_deg", "lon_deg", "h_ell_m"])
    known = known.sort_values("t_gps_s", kind="stable").drop_duplicates("t_gps_s")
    t = known["t_gps_s"].to_numpy()
    if len(ins) < 4 or len(known) < _LEAST:
        return Lag(offset_s=float("nan"), sigma_s=float("nan"), n=0)
    step = float(np.median(np.diff(t)))
    z = frame.from_geodetic(known["lat_deg"], known["lon_deg"], known["h_ell_m"])
    fix = known["fix"].to_numpy()
    good = (np.abs(np.diff(t) - step) < 0.1 * step) & (fix[1:] == fix[:-1])
    velocity_b = (np.diff(z, axis=0) / np.diff(t)[:, None])[good]
    t_a = ins["t_gps_s"].to_numpy()
    turning = rotation_enu_body(ins["roll_rad"], ins["pitch_rad"], ins["heading_rad"])
    arm = turning @ np.asarray(lever_ics_antenna_m, dtype=np.float64)
    own = np.column_stack([ins["v_east_mps"], ins["v_north_mps"], -ins["v_down_mps"]])
    inside = (t_a > t_a[0] + step) & (t_a < t_a[-1] - step)
    s = t_a - t_a[0]
    way = CubicSpline(s, own).antiderivative()
    swing = CubicSpline(s, arm)
    at = s[inside]
    if len(at) < 4:
        return Lag(offset_s=float("nan"), sigma_s=float("nan"), n=0)
    ahead, behind = at + step / 2, at - step / 2
    velocity_a = (way(ahead) + swing(ahead) - way(behind) - swing(behind)) / step
    middle = ((t[1:] + t[:-1]) / 2)[good]
    return stream_lag(t_a[inside], velocity_a, middle, velocity_b, max_lag_s)


# ---------------------------------------------------------------- two logs that share no time


def span_text(first_s: float, last_s: float) -> str:
    """A span of GPS time as UTC text."""
    return f"{utc_text_from_gps(first_s)} .. {utc_text_from_gps(last_s)}"


def apart_words(span_s: tuple[float, float], other_s: tuple[float, float]) -> str:
    """How a log has to be shifted to overlap with another one, in words; empty if they overlap.

    A lidar stamps within the hour, and clocks are set to the wrong zone: a shift by whole hours is no chance.

    Parameters
    ----------
    span_s, other_s : first and last GPS time of the log and of the other one.

    Examples
    --------
    >>> apart_words((3600.0, 3720.0), (5.0, 140.0))
    'shifted by -1:00 h it would overlap: its hour or its time zone is wrong'
    >>> apart_words((0.0, 100.0), (700.0, 900.0))
    'it ends 600 s before the other begins'
    >>> apart_words((0.0, 100.0), (90.0, 900.0))
    ''
    """
    if min(span_s[1], other_s[1]) > max(span_s[0], other_s[0]):
        return ""
    hours = round((sum(other_s) - sum(span_s)) / 2 / _HOUR_S)
    shift = hours * _HOUR_S
    shared = min(span_s[1] + shift, other_s[1]) - max(span_s[0] + shift, other_s[0])
    shorter = min(span_s[1] - span_s[0], other_s[1] - other_s[0])
    if hours and shared >= _SHARED * shorter and shared > 0:
        wrong = "its hour or its time zone" if hours % 24 else "its date"
        return f"shifted by {hours_text(shift)} h it would overlap: {wrong} is wrong"
    if span_s[1] <= other_s[0]:
        return f"it ends {other_s[0] - span_s[1]:.0f} s before the other begins"
    return f"it begins {span_s[0] - other_s[1]:.0f} s after the other ends"


# ---------------------------------------------------------------- time of the whole boat
#
# An error ``dt`` of a stamp moves a point at the distance ``r`` by ``|v + omega x r| dt`` (P2 eq. 6). With
# the speeds of the survey itself, root mean square over its trajectory, and a point across the axis of the
# turn::
#
#     cost = sqrt( v_rms^2 + (omega_rms r)^2 ) sigma_dt


@dataclass(frozen=True, slots=True, kw_only=True)
class Speeds:
    """Root mean square speeds of a survey: ``linear_mps`` and ``angular_radps``."""

    linear_mps: float
    angular_radps: float

    @classmethod
    def of(cls, trajectory: Trajectory) -> "Speeds":
        """Speeds between valid nodes, weighted by time.

        Noise of the poses makes speeds over one step of the INS too large: steps of a second and more are
        taken.

        Raises
        ------
        CoverageError : no second without a gap.
        """
        t = trajectory.t_gps_s
        start = np.flatnonzero(trajectory.valid)
        stop = np.searchsorted(t, t[start] + 1.0)
        broken = np.concatenate([[0], np.cumsum(~trajectory.valid)])
        inside = stop < len(t)
        start, stop = start[inside], stop[inside]
        # no invalid node in between, and no hole without nodes
        longest_s = max(1.5, 1.5 * float(np.median(np.diff(t)))) if len(t) > 1 else 1.5
        whole = (broken[stop + 1] == broken[start]) & (t[stop] - t[start] < longest_s)
        start, stop = start[whole], stop[whole]
        if not start.size:
            raise CoverageError(
                "the trajectory has no second without a gap",
                expected="a survey",
                cure="Look at the gaps of INS and positions",
            )
        step = (t[stop] - t[start])[:, None]
        x, q = trajectory.position_wcs_m, trajectory.quaternion_wcs_ics
        linear = (x[stop] - x[start]) / step
        # the angle between two attitudes; q and -q are the same
        cosine = np.clip(np.abs(np.sum(q[start] * q[stop], axis=1)), 0.0, 1.0)
        angular = 2.0 * np.arccos(cosine) / step[:, 0]
        return cls(
            linear_mps=float(np.sqrt(np.square(linear).sum(axis=1).mean())),
            angular_radps=root_mean_square(angular),
        )

    def cost_mm(self, dt_s: float, range_m: float) -> float:
        """How far a time error moves a point at a range."""
        return float(np.hypot(self.linear_mps, self.angular_radps * range_m) * abs(dt_s) * 1e3)


def time_report(
    streams: pd.DataFrame,
    speeds: Speeds,
    *,
    camera: ClockModel | None = None,
    stability: dict[str, Any] | None = None,
    image_times: pd.DataFrame | None = None,
    range_m: float = 25.0,
) -> pd.DataFrame:
    """One row a stream.

    Parameters
    ----------
    streams : table of `thalweg.clocks.streams.stream_table`, or its CSV file read again.
    speeds : of the survey.
    camera : the camera's clock against GPS time, if there is one.
    stability : facts of `thalweg.clocks.stability`, if the camera was tested.
    image_times : table kind ``run_image_times``, if the times of the images come from ties or pulses.
    range_m : distance for which the cost is stated.

    Returns
    -------
    Columns `COLUMNS`. ``offset_s`` is GPS time minus stamp, ``sigma_time_s`` what is left of a single stamp
    after the corrections that Thalweg makes, ``cost_mm`` what that moves a point at ``range_m``;
    ``cost_if_ignored_mm`` the same for the offset or the lag if nothing were done. Empty where nothing was
    measured: the unit of the stamps (``resolution_s``) is no accuracy.

    Raises
    ------
    InputError : columns are missing.
    """
    missing = [name for name in _NEEDED if name not in streams]
    if missing:
        raise InputError(f"columns missing: {missing}", expected="the table of streams (timing/streams.csv)")
    rows = []
    for record in streams.to_dict("records"):
        if str(record["stream"]) == "camera":
            continue
        rows.append(_stream_row({str(k): v for k, v in record.items()}, speeds, range_m))
    known = streams[streams["stream"] == "camera"].to_dict("records")
    if camera is not None or known or stability:
        facts = {str(k): v for k, v in known[0].items()} if known else {}
        row = _camera_row(facts, camera, stability or {}, speeds, range_m)
        if image_times is not None:
            row["remark"] = f"{row['remark']} {image_times_words(image_times)}".strip()
        rows.append(row)
    return pd.DataFrame(rows, columns=list(COLUMNS))


def report_lines(table: pd.DataFrame, speeds: Speeds) -> list[str]:
    """The report as text for people."""
    turning = np.rad2deg(speeds.angular_radps)
    out = [f"speeds    {speeds.linear_mps:.2f} m/s, {turning:.1f} degrees/s (root mean square)"]
    for row in table.to_dict("records"):
        out.append(f"{row['stream']}: stamped by {row['stamped_by']}, against {row['against']}")
        parts = []
        for name, unit, factor in (
            ("offset", "ms", 1e3),
            ("drift", "ppm", 1.0),
            ("jitter", "ms", 1e3),
            ("lag", "ms", 1e3),
        ):
            end = "ppm" if unit == "ppm" else "s"
            value, sigma = (_number(row.get(f"{prefix}{name}_{end}")) for prefix in ("", "sigma_"))
            if np.isfinite(value):
                text = f"{name} {value * factor:+.3f} {unit}"
                parts.append(text + (f" (sigma {sigma * factor:.3f})" if np.isfinite(sigma) else ""))
        unit_s = _number(row.get("resolution_s"))
        if np.isfinite(unit_s):
            parts.append(f"unit of the stamps {unit_s * 1e3:g} ms")
        if parts:
            out.append(f"  {', '.join(parts)}")
        if _is_number(row["cost_mm"]):
            out.append(
                f"  a stamp is good to {row['sigma_time_s'] * 1e3:.3f} ms: {row['cost_mm']:.1f} mm at "
                f"{row['range_m']:g} m"
                + (
                    f"; {row['cost_if_ignored_mm']:,.0f} mm if nothing were done"
                    if _is_number(row["cost_if_ignored_mm"])
                    else ""
                )
            )
        if row["remark"]:
            out.append(f"  {row['remark']}")
    return out


def _stream_row(record: dict[str, Any], speeds: Speeds, range_m: float) -> dict[str, Any]:
    by, against = _who(record)
    resolution, lag, sigma_lag = (_number(record.get(k)) for k in ("resolution_s", "lag_s", "sigma_lag_s"))
    significant = str(record.get("lag_significant")) == "True"
    synchronised = str(record["synchronised"]) == "True"
    # a lag that was looked for and not found bounds what is left; without, nothing was measured
    sigma = float("nan")
    if synchronised and np.isfinite(sigma_lag):
        rounding = resolution / np.sqrt(12.0) if np.isfinite(resolution) else 0.0
        sigma = float(np.sqrt(rounding**2 + sigma_lag**2 + (lag**2 if significant else 0.0)))
    remarks = []
    if not synchronised:
        remarks.append("Never on GPS time: not used.")
    elif significant:
        remarks.append(f"Late by {lag * 1e3:+.1f} ms against {record.get('lag_against')}: not corrected.")
    elif not np.isfinite(sigma_lag):
        remarks.append("Not checked against another stream: how good its stamps are was not measured.")
    lost = _number(record.get("unsynchronised_s"))
    if synchronised and lost > 0:
        remarks.append(f"{lost:.1f} s without GPS time.")
    return {
        "stream": record["stream"],
        "stamped_by": by,
        "against": against,
        "synchronised": synchronised,
        "offset_s": np.nan,
        "sigma_offset_s": np.nan,
        "drift_ppm": np.nan,
        "sigma_drift_ppm": np.nan,
        "jitter_s": _number(record.get("jitter_s")),
        "sigma_jitter_s": np.nan,
        "resolution_s": resolution,
        "lag_against": record.get("lag_against") if isinstance(record.get("lag_against"), str) else "",
        "lag_s": lag,
        "sigma_lag_s": sigma_lag,
        "lag_significant": significant,
        "sigma_time_s": sigma,
        "range_m": range_m,
        "cost_mm": speeds.cost_mm(sigma, range_m),
        "cost_if_ignored_mm": speeds.cost_mm(lag, range_m) if significant else np.nan,
        "remark": " ".join(remarks),
    }


def _camera_row(
    record: dict[str, Any],
    clock: ClockModel | None,
    stability: dict[str, Any],
    speeds: Speeds,
    range_m: float,
) -> dict[str, Any]:
    resolution = _number(record.get("resolution_s"))
    # the stamps are then the pulses: neither unit nor jitter of the camera's own ones count
    triggered = clock is not None and clock.source.startswith(TRIGGERED)
    nothing = dict.fromkeys(COLUMNS, np.nan)
    row = nothing | {
        "stream": "camera",
        "stamped_by": "the pulses of its trigger" if triggered else "the camera's own clock",
        "synchronised": clock is not None,
        "against": clock.source if clock is not None else "nothing",
        "resolution_s": resolution,
        "lag_against": "",
        "lag_significant": False,
        "range_m": range_m,
    }
    remarks = []
    if clock is None:
        remarks.append("Its clock is not tied to GPS time: images cannot be used with the other streams.")
    else:
        middle = np.array([clock.t_first_s, clock.t_last_s])
        _, sigmas = clock.to_gps(middle if np.isfinite(middle).all() else [clock.reference_s])
        unit_counts = np.isfinite(resolution) and not clock.jitter_s and not triggered
        rounding = resolution / np.sqrt(12.0) if unit_counts else 0.0
        sigma = float(np.hypot(sigmas.max(), rounding))
        row |= {
            "offset_s": clock.offset_s,
            "sigma_offset_s": clock.sigma_offset_s,
            "drift_ppm": clock.drift * 1e6,
            "sigma_drift_ppm": clock.sigma_drift * 1e6,
            "jitter_s": clock.jitter_s,
            "sigma_jitter_s": clock.sigma_jitter_s,
            "sigma_time_s": sigma,
            "cost_mm": speeds.cost_mm(sigma, range_m),
            "cost_if_ignored_mm": speeds.cost_mm(clock.offset_s, range_m),
        }
        systematic = speeds.cost_mm(clock.sigma_offset_s, range_m)
        remarks.append(
            f"Of {row['cost_mm']:.1f} mm, {systematic:.1f} mm are common to all images (offset), the rest is "
            "new in each (jitter)."
        )
        remarks.extend(clock.notes)
    if stability:
        remarks.append(
            f"Display test: {stability['mean_s']:.4f} s between images, standard deviation "
            f"{stability['std_s'] * 1e3:.1f} ms ({stability['kind']}); an image is off by "
            f"{stability['image_error_s'] * 1e3:.1f} ms."
        )
        if not triggered and (clock is None or not clock.jitter_s):
            row["jitter_s"] = stability["image_error_s"]
    return row | {"remark": " ".join(remarks)}


def _who(record: dict[str, Any]) -> tuple[str, str]:
    """Who stamps a stream, and against what, from its format and time scale."""
    form, scale = str(record["format"]).lower(), str(record["time_scale"])
    if scale in ("device", "none"):
        return "its own free-running clock", "nothing"
    if scale == "host":
        return "the logging computer", "its system clock"
    name = {"gps": "GPS time", "utc": "UTC, put on GPS time with the leap seconds"}.get(scale, scale)
    for words, by in (
        (("velodyne", "pcap", "capture"), "the lidar's clock, set by pulse per second and NMEA"),
        (("anpp", "sbet"), "the INS, steered by its GNSS receiver"),
        (("sbp", "rtklib", "rinex", ".pos"), "the GNSS receiver"),
        (("nmea",), "the time sentences of the same line"),
    ):
        if any(word in form for word in words):
            return by, name
    return "the instrument", name


def _number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        return float("nan")


def _is_number(value: Any) -> bool:
    return bool(np.isfinite(_number(value)))
