"""Images of a camera that is triggered by hardware, or that marks its exposures: pulses against images.

Each image then has a pulse on GPS time (an event of the INS or of the GNSS receiver), and the clock of the
camera only has to tell which image belongs to which pulse. Pulses without image and images without pulse are
found from the intervals: both series are matched in order, with the camera's clock free by an offset.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.clocks.ties.model import ClockModel
from thalweg.core.errors import ClockError
from thalweg.core.types import ArrayB, ArrayF, ArrayI

TRIGGERED: Final = "hardware trigger"
"""How the source of a clock begins whose stamps are the pulses."""

_LEAST_SHARE: Final = 0.5
_MOST_SHIFT: Final = 50
_TIE: Final = 1.05
"""A second alignment that fits nearly as well: nothing tells which one is right."""


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
    *,
    t_first_s: float,
    t_last_s: float,
    delay_s: float = 0.0,
    sigma_delay_s: float = 0.0,
    jitter_s: float = 0.0,
) -> ClockModel:
    """Clock of images whose stamps *are* the pulses: no offset but the delay from pulse to exposure.

    Parameters
    ----------
    t_first_s, t_last_s : first and last pulse.
    delay_s, sigma_delay_s : from the pulse to the middle of the exposure.
    jitter_s : standard deviation of the delay from image to image.
    """
    return ClockModel(
        offset_s=delay_s,
        reference_s=(t_first_s + t_last_s) / 2,
        cov=np.diag([sigma_delay_s**2, 0.0]),
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
        other for n, other, scatter in ranked if n == n_best and abs(other - offset) > near
        and scatter <= _TIE * misfit + 1e-4
    ]  # fmt: skip
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
    t_device_s: ArrayLike,
    t_pulse_s: ArrayLike,
    match: PulseMatch,
    *,
    delay_s: float = 0.0,
    sigma_delay_s: float = 0.0,
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
        cov=np.diag([jitter**2 / residual.size + sigma_delay_s**2, jitter**2 / spread]),
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
    offset, used = start, np.zeros(t.size, dtype=bool)
    for _ in range(5):
        pulse = _nearest(t, p, offset, near)
        used = pulse >= 0
        if not used.any():
            return 0, offset, float("inf")
        offset = float(np.median(p[pulse[used]] - t[used]))
    pulse = _nearest(t, p, offset, near)
    used = pulse >= 0
    if not used.any():
        return 0, offset, float("inf")
    return int(used.sum()), offset, _scatter(p[pulse[used]] - t[used] - offset)


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


def _scatter(values: ArrayF) -> float:
    return float(1.4826 * np.median(np.abs(values - np.median(values))))
