"""When the boat's camera really exposed, and what its clock wrote."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.types import ArrayF, ArrayI
from thalweg.settings.twin.camera import TwinCamera
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import generator
from thalweg_lab.instruments.stamps import start_us
from thalweg_lab.voyage.motion import start_gps_s

_STATIC_S: Final = 1.2
"""A static image is taken this long after the lidar starts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageTimes:
    """Images in time.

    Parameters
    ----------
    t_gps_s : (n,) true middle of the exposure, adjusted standard GPS time.
    stamp_us : (n,) reading of the camera's clock that it wrote, microseconds since 1970, whole milliseconds.
    clock_minus_utc_s : (n,) what the clock was ahead of UTC when it stamped.
    """

    t_gps_s: ArrayF
    stamp_us: ArrayI
    clock_minus_utc_s: ArrayF


def clock_minus_utc_s(camera: TwinCamera, since_s: ArrayF) -> ArrayF:
    """How far the camera's clock is ahead of UTC (n,), seconds after the begin of the run."""
    return np.asarray(camera.clock_offset_s + camera.clock_drift_ppm * 1e-6 * since_s)


def run_times(config: TwinConfig, seed: int) -> ImageTimes:
    """Times of the images of the dynamic run, from its begin to its end.

    The camera's timer releases at nearly even intervals, and its clock stamps the release. The exposure
    follows with a delay that differs from image to image: that is the error of the stamp.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    """
    camera = config.camera
    rng, shutter = generator(seed, "camera timer"), generator(seed, "camera shutter")
    phase = rng.uniform(0.2, 0.8) / camera.rate_hz
    n = max(int((config.duration_s - phase - 0.2 / camera.rate_hz) * camera.rate_hz) + 1, 1)
    released = phase + np.arange(n) / camera.rate_hz
    # Independent errors of std / sqrt 2 about an even grid give intervals of the stated std.
    released = released + rng.standard_normal(n) * camera.interval_jitter_s / np.sqrt(2.0)
    exposed = released + camera.jitter_s * shutter.standard_normal(n)
    return _times(config, released, exposed)


def static_times(config: TwinConfig, seed: int, begin_gps_s: ArrayF) -> ImageTimes:
    """Times of one image in each static position.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    begin_gps_s : (n,) begin of the lidar's recordings.
    """
    shutter = generator(seed, "camera shutter, static").standard_normal(len(begin_gps_s))
    released = np.asarray(begin_gps_s) + _STATIC_S - start_gps_s(config)
    return _times(config, released, released + config.camera.jitter_s * shutter)


def _times(config: TwinConfig, released_s: ArrayF, exposed_s: ArrayF) -> ImageTimes:
    """From seconds since the begin of the run."""
    ahead = clock_minus_utc_s(config.camera, released_s)
    stamp_ms = np.rint((released_s + ahead) * 1e3 + start_us(config) * 1e-3).astype(np.int64)
    return ImageTimes(
        t_gps_s=start_gps_s(config) + exposed_s, stamp_us=1000 * stamp_ms, clock_minus_utc_s=ahead
    )
