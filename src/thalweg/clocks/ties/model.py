"""What is known of a clock against GPS time, in one form for every way in which it was found.

The stamp ``t_device_s`` of a clock lies on the axis of adjusted GPS time as if the clock were right. What is
left is::

    t_gps = t_device + offset + drift (t_device - reference) + jitter of the single stamp
"""

import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import yaml
from numpy.typing import ArrayLike

from thalweg.core.errors import ClockError, InputError
from thalweg.core.timescales import utc_text_from_gps
from thalweg.core.types import ArrayF

QUARTZ_DRIFT: Final = 50e-6
"""Sigma of the drift of a clock of which nothing is known: quartz oscillators of consumer devices are
specified to 20 to 50 ppm over their temperature range."""

_KEY: Final = "thalweg_clock"
_VERSION: Final = 1


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
        if not path.is_file():
            raise InputError("file not found", where=path, expected="a clock file (camera_clock.yaml)")
        try:
            data: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise InputError(f"no YAML ({error})", where=path) from error
        if not isinstance(data, dict) or data.pop(_KEY, None) != _VERSION:
            raise InputError("this is no clock file", where=path, expected=f"the key {_KEY}: {_VERSION}")
        try:
            values = {name: _value(name, value) for name, value in data.items()}
            return cls(**values)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"a key is missing, unknown or holds no number ({error})", where=path, expected="a clock file"
            ) from error
        except ClockError as error:
            raise InputError(error.found, where=path, expected=error.expected) from error


_NUMBERS: Final = ("offset_s", "reference_s", "drift", "jitter_s", "sigma_jitter_s", "t_first_s", "t_last_s")


def _value(name: str, value: Any) -> Any:
    if name in _NUMBERS:
        return float("nan") if value is None else float(value)
    if name == "cov":
        return np.array(value, dtype=np.float64)
    return tuple(value) if name == "notes" else value
