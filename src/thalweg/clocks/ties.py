"""Clocks against GPS time by ties or by a hardware trigger, and the times of images that follow.

The stamp ``t_device_s`` of a clock lies on the axis of adjusted GPS time as if the clock were right. What is
left is::

    t_gps = t_device + offset + drift (t_device - reference) + jitter of the single stamp

With a trigger an image takes the time of its pulse, plus the delay from the pulse to the middle of the
exposure; what the camera's own stamps say is then used to find the pulse, and for images without pulse only.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import pandas as pd
import pyarrow as pa
import yaml
from numpy.typing import ArrayLike
from scipy.stats import chi2

from thalweg.core import (
    ArrayB,
    ArrayF,
    ArrayI,
    ClockError,
    InputError,
    column,
    frame_of,
    read_table,
    read_yaml,
    robust_sigma,
    table_kind,
    utc_text_from_gps,
)
from thalweg.ingest import explain_shift, read_text_table

RUN_IMAGE_TIMES = table_kind(
    "run_image_times",
    1,
    [
        column("file", "1", "name of the image", pa.string()),
        column("t_device_s", "s", "stamp, adjusted GPS time if the camera's clock were right"),
        column("t_gps_s", "s", "adjusted GPS time of the middle of the exposure; NaN if unknown"),
        column("sigma_s", "s", "its standard deviation, jitter of the image included"),
        column("matched", "1", "whether the time is that of a pulse of the trigger", pa.bool_()),
        column("reason", "1", "why not", pa.string()),
    ],
)
_NAMED: Final = 5
_NO_TIME: Final = "no stamp"
_SHARED: Final = "another image has the same stamp"
_NO_PULSE: Final = "no pulse: time by the camera's own clock"
_TIES: Final = "no pulses: time by ties"

_LEAST_SPAN_S: Final = 1.0
_PROBABILITY: Final = 0.999
_WILD_DRIFT: Final = 1e-3
"""No quartz runs 1000 ppm wrong: a tie was misread, or the clock was set in between."""

TRIGGERED: Final = "hardware trigger"
"""How the source of a clock begins whose stamps are the pulses."""
_LEAST_SHARE: Final = 0.5
_MOST_SHIFT: Final = 50
_TIE: Final = 1.05
"""A second alignment that fits nearly as well: nothing tells which one is right."""

QUARTZ_DRIFT: Final = 50e-6
"""Sigma of the drift of a clock of which nothing is known: quartz oscillators of consumer devices are
specified to 20 to 50 ppm over their temperature range."""
_KEY: Final = "thalweg_clock"
_VERSION: Final = 1
TIE_COLUMNS: Final = ("t_device_s", "t_gps_s", "sigma_s")
"""Columns of a table of simultaneous readings of both clocks, and the sigma of their difference."""
_NUMBERS: Final = ("offset_s", "reference_s", "drift", "jitter_s", "sigma_jitter_s", "t_first_s", "t_last_s")


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockModel:
    """A clock against GPS time.

    Parameters
    ----------
    offset_s : GPS time minus stamp at the reference.
    drift : change of the offset a second.
    reference_s : stamp at which the offset holds.
    cov : (2, 2) covariance of offset and drift, s^2 and 1.
    jitter_s : standard deviation of a single stamp about the straight line.
    sigma_jitter_s : standard deviation of that, NaN if not estimated.
    source : how it was found, in words.
    t_first_s, t_last_s : stamps between which it was determined; beyond them it is extrapolated.
    notes : sentences for people.

    Raises
    ------
    ClockError : a number is not finite, or the covariance is none.
    """

    offset_s: float
    reference_s: float
    cov: ArrayF
    drift: float = 0.0
    jitter_s: float = 0.0
    sigma_jitter_s: float = float("nan")
    source: str = ""
    t_first_s: float = float("nan")
    t_last_s: float = float("nan")
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        cov = np.asarray(self.cov, dtype=np.float64)
        object.__setattr__(self, "cov", cov)
        for name in _NUMBERS:
            object.__setattr__(self, name, float(getattr(self, name)))
        numbers = (self.offset_s, self.reference_s, self.drift, self.jitter_s)
        if not all(math.isfinite(value) for value in numbers) or self.jitter_s < 0:
            raise ClockError(
                f"a clock with offset {self.offset_s} s, drift {self.drift}, reference {self.reference_s} s "
                f"and jitter {self.jitter_s} s",
                expected="finite numbers, and a jitter of at least 0",
            )
        if (
            cov.shape != (2, 2)
            or not np.isfinite(cov).all()
            or np.linalg.eigvalsh(cov)[0] < -1e-12 * cov.max()
        ):
            raise ClockError(f"a covariance {cov.tolist()} of offset and drift", expected="2x2, not negative")

    def to_gps(self, t_device_s: ArrayLike, *, jitter: bool = True) -> tuple[ArrayF, ArrayF]:
        """GPS time of stamps (n,), and its sigma.

        Parameters
        ----------
        t_device_s : (n,) stamps.
        jitter : the sigma is that of a single stamp; False: of the clock without the jitter of stamps.
        """
        t = np.asarray(t_device_s, dtype=np.float64)
        since = t - self.reference_s
        variance = self.cov[0, 0] + 2 * self.cov[0, 1] * since + self.cov[1, 1] * since**2
        variance = np.maximum(variance, 0.0) + (self.jitter_s**2 if jitter else 0.0)
        return t + self.offset_s + self.drift * since, np.sqrt(variance)

    @property
    def sigma_offset_s(self) -> float:
        """Standard deviation of the offset at the reference."""
        return float(np.sqrt(self.cov[0, 0]))

    @property
    def sigma_drift(self) -> float:
        """Standard deviation of the drift."""
        return float(np.sqrt(self.cov[1, 1]))

    def lines(self) -> list[str]:
        """The clock in words, for a terminal."""
        out = [
            f"offset    {self.offset_s * 1e3:+.3f} ms, sigma {self.sigma_offset_s * 1e3:.3f} ms, at "
            f"{utc_text_from_gps(self.reference_s)}",
            f"drift     {self.drift * 1e6:+.3f} ppm, sigma {self.sigma_drift * 1e6:.3f} ppm",
            f"jitter    {self.jitter_s * 1e3:.3f} ms a stamp"
            + (f", sigma {self.sigma_jitter_s * 1e3:.3f} ms" if math.isfinite(self.sigma_jitter_s) else ""),
        ]
        if math.isfinite(self.t_first_s) and math.isfinite(self.t_last_s):
            span = f"{utc_text_from_gps(self.t_first_s)} .. {utc_text_from_gps(self.t_last_s)}"
            out.append(f"known     {span}, extrapolated outside")
        return [f"clock     {self.source}", *out, *(f"note      {sentence}" for sentence in self.notes)]

    def write(self, path: Path) -> None:
        """Write as YAML."""
        values = asdict(self) | {"cov": self.cov.tolist(), "notes": list(self.notes)}
        plain = {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in values.items()
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        head = (
            "# Clock against GPS time: t_gps = t_device + offset_s + drift (t_device - reference_s).\n"
            "# Seconds; stamps on the axis of adjusted GPS time as if the clock were right.\n"
        )
        body = yaml.safe_dump({_KEY: _VERSION, **plain}, sort_keys=False, width=100, allow_unicode=True)
        path.write_text(head + body, encoding="utf-8")

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read what `write` wrote.

        Raises
        ------
        InputError : the file is missing or not of this form.
        """
        document = read_yaml(path)
        for mistake in document.mistakes:
            raise InputError(mistake.found, where=path, expected="a clock file", cure=mistake.cure)
        data = document.data
        if not isinstance(data, dict) or data.pop(_KEY, None) != _VERSION:
            raise InputError("this is no clock file", where=path, expected=f"the key {_KEY}: {_VERSION}")
        try:
            nan = {name: float("nan") for name in _NUMBERS if name in data and data[name] is None}
            data |= nan | {"notes": tuple(data.get("notes", ()))}
            return cls(**data)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"a key is missing, unknown or holds no number ({error})", where=path, expected="a clock file"
            ) from error
        except ClockError as error:
            raise InputError(error.found, where=path, expected=error.expected) from error


# ---------------------------------------------------------------- GPS times of the images of a run


def jitter_of_ties(stated_s: float | None, stability: Mapping[str, Any] | None) -> tuple[float, str]:
    """Jitter of a stamp for a clock that was tied to GPS time, seconds, and where it is from.

    Ties tell nothing about the jitter of single images.

    Parameters
    ----------
    stated_s : ``calibration.clock.jitter_s``, or None.
    stability : facts of `thalweg.clocks.stability`, if the camera was tested.

    Raises
    ------
    ClockError : neither is given.
    """
    if stated_s is not None:
        return float(stated_s), f"Jitter of {stated_s * 1e3:g} ms a stamp as stated, not measured."
    if stability:
        jitter_s = float(stability["image_error_s"])
        return (
            jitter_s,
            f"Jitter of {jitter_s * 1e3:.1f} ms a stamp from the display test, not from the ties.",
        )
    raise ClockError(
        "the jitter of the camera's stamps is not known: ties do not tell it, and there is no display test",
        expected="calibration.clock.jitter_s, or photographs of a running clock",
        cure="State calibration.clock.jitter_s, seconds, or give logs.calibration.display",
    )


def tied_images(stamps: pd.DataFrame, clock: ClockModel) -> pd.DataFrame:
    """Times of images by a clock that was tied to GPS time.

    Parameters
    ----------
    stamps : table kind ``image_stamps``.
    clock : of the camera.

    Returns
    -------
    Table kind ``run_image_times``.
    """
    t = stamps["t_device_s"].to_numpy(np.float64)
    t_gps_s, sigma_s = clock.to_gps(t)
    reason = np.where(np.isfinite(t), _TIES, _NO_TIME)
    return _table(stamps, t_gps_s, sigma_s, np.zeros(len(t), dtype=bool), reason)


def triggered_images(
    stamps: pd.DataFrame, t_pulse_s: ArrayF, *, delay_s: float = 0.0, jitter_s: float | None = None
) -> tuple[ClockModel, pd.DataFrame, dict[str, Any]]:
    """Times of images that a hardware trigger made.

    Images that share a stamp cannot be told apart and find no pulse.

    Parameters
    ----------
    stamps : table kind ``image_stamps``.
    t_pulse_s : (m,) GPS times of the pulses, increasing.
    delay_s : from the pulse to the middle of the exposure.
    jitter_s : standard deviation of the delay from image to image; None: 0, as of a trigger.

    Returns
    -------
    The clock of the trigger (stamps are the pulses), table kind ``run_image_times``, and facts: names of
    the images and times of the pulses that stay alone.

    Raises
    ------
    ClockError : images and pulses do not match, see `thalweg.clocks.ties.match_pulses`.
    """
    t = stamps["t_device_s"].to_numpy(np.float64)
    pulse_s = np.asarray(t_pulse_s, np.float64)
    known = np.isfinite(t)
    alone = known & ~stamps["t_device_s"].duplicated(keep=False).to_numpy()
    at = np.flatnonzero(alone)
    at = at[np.argsort(t[at], kind="stable")]
    match = match_pulses(t[at], pulse_s)
    own = clock_from_pulses(t[at], pulse_s, match, delay_s=delay_s)
    t_gps_s, sigma_s = own.to_gps(t)
    reason = np.where(known, np.where(alone, _NO_PULSE, _SHARED), _NO_TIME).astype(object)
    has = match.pulse >= 0
    jitter = 0.0 if jitter_s is None else float(jitter_s)
    t_gps_s[at[has]] = pulse_s[match.pulse[has]] + delay_s
    sigma_s[at[has]] = jitter
    reason[at[has]] = ""
    matched = np.zeros(len(t), dtype=bool)
    matched[at[has]] = True
    without = [str(name) for name in stamps["file"].to_numpy()[~matched]]
    unseen = pulse_s[match.image < 0]
    clock = trigger_clock(
        t_first_s=float(pulse_s[0]), t_last_s=float(pulse_s[-1]), delay_s=delay_s, jitter_s=jitter
    )
    notes = (
        f"Stamps are the pulses: {int(matched.sum())} of {len(t)} images have theirs.",
        f"Images without pulse: {_names(without)}.",
        f"Pulses without image: {_names([utc_text_from_gps(value) for value in unseen])}.",
        f"The camera's own clock, for images without pulse: offset {own.offset_s:+.4f} s, drift "
        f"{own.drift * 1e6:+.1f} ppm; its stamps scatter by {own.jitter_s * 1e3:.2f} ms.",
        *(["Jitter of the trigger not stated: taken as 0."] if jitter_s is None else []),
    )
    facts = {"images_without_pulse": without, "pulses_without_image_s": unseen.tolist()}
    return replace(clock, notes=notes), _table(stamps, t_gps_s, sigma_s, matched, reason), facts


def read_run_image_times(path: Path) -> pd.DataFrame:
    """Table kind ``run_image_times``, as ``timing/image_times_ties.parquet`` holds it.

    Raises
    ------
    InputError : the file is missing or another table.
    """
    return read_table(path, RUN_IMAGE_TIMES)[0]


def image_times_words(times: pd.DataFrame) -> str:
    """How many images have their time from where, and how good it is, in a sentence.

    Parameters
    ----------
    times : table kind ``run_image_times``.
    """
    known = np.isfinite(times["t_gps_s"].to_numpy(np.float64))
    by_pulse = known & times["matched"].to_numpy(dtype=bool)
    groups = (("by their pulse", by_pulse), ("by the camera's own clock", known & ~by_pulse))
    parts = []
    for words, rows in groups:
        if rows.any():
            worst_ms = 1e3 * float(times["sigma_s"].to_numpy(np.float64)[rows].max())
            parts.append(f"{int(rows.sum())} {words} (sigma up to {worst_ms:.2f} ms)")
    if not known.all():
        parts.append(f"{int((~known).sum())} without a time")
    return f"Times of {len(times)} images: {', '.join(parts) or 'none'}."


def _table(
    stamps: pd.DataFrame, t_gps_s: ArrayF, sigma_s: ArrayF, matched: np.ndarray, reason: np.ndarray
) -> pd.DataFrame:
    return frame_of(
        RUN_IMAGE_TIMES,
        {
            "file": stamps["file"].to_numpy(),
            "t_device_s": stamps["t_device_s"].to_numpy(np.float64),
            "t_gps_s": t_gps_s,
            "sigma_s": sigma_s,
            "matched": matched,
            "reason": [str(words) for words in reason],
        },
    )


def _names(names: list[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more if names else "none"


# ---------------------------------------------------------------- offset and drift of a clock from
# comparisons with GPS time (T 2.3)
#
# The camera is connected to a computer on GPS time at the quay, and both clocks are read; again when the boat
# is back. A straight line through the ties is the clock in between; outside, its sigma grows with that of the
# drift.


def clock_from_ties(
    t_device_s: ArrayLike,
    t_gps_s: ArrayLike,
    sigma_s: ArrayLike,
    *,
    sigma_drift: float = QUARTZ_DRIFT,
    jitter_s: float = 0.0,
) -> ClockModel:
    """Offset and drift from ties by weighted least squares, with their covariance.

    One tie, or several at one moment, give the offset only: the drift is then 0 with ``sigma_drift``, and
    the sigma of a time grows with its distance from the tie. With more than two ties the straight line is
    tested.

    Parameters
    ----------
    t_device_s, t_gps_s : (n,) what both clocks showed at the same moments.
    sigma_s : scalar or (n,) sigma of the difference of a pair.
    sigma_drift : sigma of the drift where the ties do not tell.
    jitter_s : standard deviation of a single stamp of the camera, from elsewhere: ties do not tell it, see
        `thalweg.clocks.ties.jitter_of_ties`.

    Raises
    ------
    ClockError : no tie, sigmas that are not above zero, a clock that was set between two ties, or ties that
        do not lie on a straight line.
    """
    t, gps = np.asarray(t_device_s, np.float64).ravel(), np.asarray(t_gps_s, np.float64).ravel()
    sigma = np.broadcast_to(np.asarray(sigma_s, np.float64), t.shape)
    if not t.size or t.shape != gps.shape or not np.isfinite([t, gps, sigma]).all() or not (sigma > 0).all():
        raise ClockError(
            f"{t.size} stamps, {gps.size} GPS times, sigmas {np.unique(sigma).tolist()}",
            expected="at least one tie of finite times with a sigma above 0",
            cure="Compare the camera's clock with GPS time before and after the run",
        )
    order = np.argsort(t, kind="stable")
    t, d, weight = t[order], (gps - t)[order], 1.0 / sigma[order] ** 2
    notes = []
    reference = float(np.average(t, weights=weight))
    # near zero: sums of clocks that are hours apart would lose digits
    d0 = float(d[0])
    y, x = d - d0, t - reference
    middle = float(np.average(y, weights=weight))
    variance = 1.0 / float(weight.sum())
    words = explain_shift(d0 + middle)
    if words:
        notes.append(f"The offset is {d0 + middle:+.3f} s, which looks like {words}.")
    if t[-1] - t[0] < _LEAST_SPAN_S:
        notes.append(
            f"Ties at one moment only: the drift is not determined and taken as 0 with a sigma of "
            f"{sigma_drift * 1e6:g} ppm. An hour away the time is uncertain by {sigma_drift * 3.6e6:.0f} ms. "
            "A tie after the run would settle it."
        )
        drift, cov = 0.0, np.diag([variance, sigma_drift**2])
    else:
        spread = float((weight * x * x).sum())
        drift, cov = float((weight * x * y).sum()) / spread, np.diag([variance, 1.0 / spread])
        _check_line(t, y - middle - drift * x, weight, drift)
        if t.size > 2:
            notes.append(f"{t.size} ties fit a straight line.")
        else:
            notes.append("Two ties: a straight line always fits them; a third one would check it.")
    return ClockModel(
        offset_s=d0 + middle,
        drift=drift,
        reference_s=reference,
        cov=cov,
        jitter_s=jitter_s,
        source=f"{t.size} tie{'s' if t.size > 1 else ''} to GPS time",
        t_first_s=float(t[0]),
        t_last_s=float(t[-1]),
        notes=tuple(notes),
    )


def _check_line(t: ArrayF, residual: ArrayF, weight: ArrayF, drift: float) -> None:
    """Refuse a clock that was set in between, and ties that no straight line meets."""
    if abs(drift) > _WILD_DRIFT:
        step = drift * (t[-1] - t[0])
        words = explain_shift(step)
        raise ClockError(
            f"between the first and the last tie the offset changes by {step:+.3f} s ({drift * 1e6:+.0f} ppm"
            + (f"; {words})" if words else ")"),
            expected=f"less than {_WILD_DRIFT * 1e6:.0f} ppm: no quartz is so far off",
            cure="A tie was misread, or the clock was set in between; use the stretches of the run apart",
        )
    excess = float((weight * residual**2).sum())
    free = t.size - 2
    if free and excess > chi2.ppf(_PROBABILITY, free):
        worst = int(np.argmax(weight * residual**2))
        raise ClockError(
            f"{t.size} ties are not on a straight line: tie {worst + 1} is off by "
            f"{residual[worst] * 1e3:+.1f} ms, sigma {weight[worst] ** -0.5 * 1e3:.1f} ms",
            expected=f"a sum of squared standardised residuals below {chi2.ppf(_PROBABILITY, free):.1f}, "
            f"not {excess:.1f}",
            cure="Drop the tie if it was misread; state larger sigmas if the clock wanders",
        )


# ---------------------------------------------------------------- pulses against images
#
# Each image then has a pulse on GPS time (an event of the INS or of the GNSS receiver), and the clock of
# the camera only has to tell which image belongs to which pulse. Pulses without image and images without
# pulse are found from the intervals: both series are matched in order, with the camera's clock free by an
# offset.


@dataclass(frozen=True, slots=True, kw_only=True)
class PulseMatch:
    """Which pulse each image belongs to.

    ``pulse`` (n,) number of the pulse of each image, -1 if none; ``image`` (m,) the same for pulses;
    ``offset_s`` median of pulse minus stamp, ``misfit_s`` robust scatter about it.
    """

    pulse: ArrayI
    image: ArrayI
    offset_s: float
    misfit_s: float

    @property
    def images_without_pulse(self) -> int:
        """Images that no pulse explains: taken by hand, or a pulse was not recorded."""
        return int((self.pulse < 0).sum())

    @property
    def pulses_without_image(self) -> int:
        """Pulses that made no image: the camera was busy, or the file is lost."""
        return int((self.image < 0).sum())


def trigger_clock(
    *, t_first_s: float, t_last_s: float, delay_s: float = 0.0, jitter_s: float = 0.0
) -> ClockModel:
    """Clock of images whose stamps *are* the pulses: no offset but the delay from pulse to exposure.

    Parameters
    ----------
    t_first_s, t_last_s : first and last pulse.
    delay_s : from the pulse to the middle of the exposure.
    jitter_s : standard deviation of the delay from image to image.
    """
    return ClockModel(
        offset_s=delay_s,
        reference_s=(t_first_s + t_last_s) / 2,
        cov=np.zeros((2, 2)),
        jitter_s=jitter_s,
        source=TRIGGERED + (f" with a delay of {delay_s * 1e3:g} ms" if delay_s else ""),
        t_first_s=t_first_s,
        t_last_s=t_last_s,
    )


def match_pulses(
    t_device_s: ArrayLike, t_pulse_s: ArrayLike, *, tolerance_s: float | None = None
) -> PulseMatch:
    """Match images to pulses, with lost ones on both sides.

    Every alignment by up to 50 images or pulses is tried; the one that explains most images wins, then the
    one whose differences scatter least. If pulses are perfectly regular and one is missing at an end, two
    alignments explain the data equally well: that is refused rather than guessed.

    Parameters
    ----------
    t_device_s : (n,) stamps of the images, increasing; the clock may be off by any offset.
    t_pulse_s : (m,) GPS times of the pulses, increasing.
    tolerance_s : how far stamp and pulse may differ about the offset; None: a third of the interval of
        pulses.

    Raises
    ------
    ClockError : too few of either, no alignment that explains half of the images, or several that do.
    """
    t, p = np.asarray(t_device_s, np.float64).ravel(), np.asarray(t_pulse_s, np.float64).ravel()
    if min(t.size, p.size) < 3 or not (np.diff(t) > 0).all() or not (np.diff(p) > 0).all():
        raise ClockError(
            f"{t.size} images and {p.size} pulses",
            expected="at least three of each, in order of time, without repeated stamps",
        )
    near = tolerance_s if tolerance_s is not None else float(np.median(np.diff(p))) / 3
    tried: dict[int, tuple[int, float, float]] = {}
    reach = min(_MOST_SHIFT + abs(p.size - t.size), max(t.size, p.size) - 2)
    for shift in range(-reach, reach + 1):
        if shift >= p.size or -shift >= t.size:
            continue
        start = float(p[max(shift, 0)] - t[max(-shift, 0)])
        tried[shift] = _fit(t, p, start, near)
    # one offset is met by several shifts where images or pulses are missing
    ranked = sorted(tried.values(), key=lambda found: (-found[0], found[2]))
    n_best, offset, misfit = ranked[0]
    if n_best < _LEAST_SHARE * min(t.size, p.size):
        raise ClockError(
            f"at best {n_best} of {t.size} images meet one of {p.size} pulses within {near:.3f} s",
            expected="pulses and images of the same run",
            cure="Check that both are of one run, and that the camera was in trigger mode",
        )
    rivals = [
        other
        for n, other, scatter in ranked
        if n == n_best and abs(other - offset) > near and scatter <= _TIE * misfit + 1e-4
    ]
    if rivals:
        raise ClockError(
            f"{len(rivals) + 1} alignments of {t.size} images with {p.size} pulses fit alike, with offsets "
            f"of {offset:+.3f} and {rivals[0]:+.3f} s",
            expected="one",
            cure="Break the rhythm once while recording (pause for two images), or tie the camera's clock to "
            "GPS time within half an interval",
        )
    pulse = _nearest(t, p, offset, near)
    image = np.full(p.size, -1, dtype=np.int64)
    image[pulse[pulse >= 0]] = np.flatnonzero(pulse >= 0)
    return PulseMatch(pulse=pulse, image=image, offset_s=offset, misfit_s=misfit)


def clock_from_pulses(
    t_device_s: ArrayLike, t_pulse_s: ArrayLike, match: PulseMatch, *, delay_s: float = 0.0
) -> ClockModel:
    """Offset, drift and jitter of the camera's own stamps, from the images that have a pulse.

    Needed for the images without pulse only; the others take the time of their pulse, see `trigger_clock`.
    """
    t, p = np.asarray(t_device_s, np.float64).ravel(), np.asarray(t_pulse_s, np.float64).ravel()
    has = match.pulse >= 0
    x, y = t[has], p[match.pulse[has]] - t[has] + delay_s
    reference, d0 = float(x.mean()), float(y.mean())
    x = x - reference
    spread = float((x * x).sum())
    drift = float((x * (y - d0)).sum()) / spread
    residual = y - d0 - drift * x
    free = max(residual.size - 2, 1)
    jitter = float(np.sqrt((residual**2).sum() / free))
    return ClockModel(
        offset_s=d0,
        drift=drift,
        reference_s=reference,
        cov=np.diag([jitter**2 / residual.size, jitter**2 / spread]),
        jitter_s=jitter,
        sigma_jitter_s=jitter / np.sqrt(2.0 * free),
        source=f"{residual.size} pulses of a hardware trigger",
        t_first_s=float(t[has][0]),
        t_last_s=float(t[has][-1]),
        notes=(
            f"{match.images_without_pulse} images without pulse, {match.pulses_without_image} pulses without "
            "image.",
        ),
    )


def _fit(t: ArrayF, p: ArrayF, start: float, near: float) -> tuple[int, float, float]:
    """Images explained, offset and scatter of an alignment, from a first offset."""
    offset = start
    for iteration in range(6):
        pulse = _nearest(t, p, offset, near)
        used = pulse >= 0
        if not used.any():
            return 0, offset, float("inf")
        off = p[pulse[used]] - t[used]
        if iteration < 5:
            offset = float(np.median(off))
    return int(used.sum()), offset, robust_sigma(off - offset)


def _nearest(t: ArrayF, p: ArrayF, offset: float, near: float) -> ArrayI:
    """Number of the pulse within ``near`` of each image; a pulse belongs to its nearest image only."""
    at = np.clip(np.searchsorted(p, t + offset), 1, p.size - 1)
    left: ArrayB = np.abs(p[at - 1] - t - offset) <= np.abs(p[at] - t - offset)
    best = np.where(left, at - 1, at)
    away = np.abs(p[best] - t - offset)
    order = np.lexsort((away, best))
    first = np.ones(t.size, dtype=bool)
    first[order[1:]] = best[order][1:] != best[order][:-1]
    return np.where(first & (away <= near), best, -1).astype(np.int64)


# ---------------------------------------------------------------- small CSV tables that people write: ties,
# pulses, labels


def read_text_columns(path: Path, names: tuple[str, ...]) -> list[list[str]]:
    """Columns of a CSV table as texts without blanks around them; other columns are left out.

    Raises
    ------
    InputError : the file is missing, empty or no table, or lacks a column.
    """
    table = read_text_table(path)
    of = {column.name: k for k, column in enumerate(table.columns)}
    missing = [name for name in names if name not in of]
    if missing or not len(table):
        raise InputError(
            f"columns missing: {', '.join(missing)}" if missing else "no row",
            where=path,
            expected=f"a CSV table with the columns {', '.join(names)}",
        )
    return [table.text(of[name]) for name in names]


def read_number_columns(path: Path, names: tuple[str, ...]) -> list[ArrayF]:
    """Columns of a CSV table as finite numbers (n,).

    Raises
    ------
    InputError : see `read_text_columns`, or a cell holds no finite number.
    """
    out = []
    for name, texts in zip(names, read_text_columns(path, names), strict=True):
        values = pd.to_numeric(pd.Series(texts), errors="coerce").to_numpy(np.float64)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise InputError(
                f"'{texts[int(bad[0])]}' in column {name}, row {int(bad[0]) + 1}",
                where=path,
                expected="a number",
            )
        out.append(values)
    return out
