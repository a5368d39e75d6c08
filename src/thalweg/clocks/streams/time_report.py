"""The time of the whole boat: who stamps each stream, how well, and what that costs at the bank.

An error ``dt`` of a stamp moves a point at the distance ``r`` by ``|v + omega x r| dt`` (P2 eq. 6). With the
speeds of the survey itself, root mean square over its trajectory, and a point across the axis of the turn::

    cost = sqrt( v_rms^2 + (omega_rms r)^2 ) sigma_dt
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.clocks.ties.model import ClockModel
from thalweg.clocks.ties.run_image_times import image_times_words
from thalweg.clocks.ties.trigger import TRIGGERED
from thalweg.core.errors import CoverageError, InputError
from thalweg.core.trajectory import Trajectory

COLUMNS: Final = (
    "stream", "stamped_by", "against", "synchronised", "offset_s", "sigma_offset_s", "drift_ppm",
    "sigma_drift_ppm", "jitter_s", "sigma_jitter_s", "resolution_s", "lag_against", "lag_s", "sigma_lag_s",
    "lag_significant", "sigma_time_s", "range_m", "cost_mm", "cost_if_ignored_mm", "remark",
)  # fmt: skip

_NEEDED: Final = ("stream", "format", "synchronised", "time_scale", "resolution_s")


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
        whole = (broken[stop + 1] == broken[start]) & (t[stop] - t[start] < 1.5)
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
            angular_radps=float(np.sqrt(np.square(angular).mean())),
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
    streams : table of `thalweg.clocks.streams.streams.stream_table`, or its CSV file read again.
    speeds : of the survey.
    camera : the camera's clock against GPS time, if there is one.
    stability : facts of `thalweg.clocks.display.stability`, if the camera was tested.
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
            ("offset", "ms", 1e3), ("drift", "ppm", 1.0), ("jitter", "ms", 1e3), ("lag", "ms", 1e3),
        ):  # fmt: skip
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
