"""Does an image agree with its neighbours, carried by the INS?"""

import numpy as np

from thalweg.core.rigid import rotation_vector
from thalweg.core.types import ArrayB, ArrayF
from thalweg.navigation.camera.carrier import Carrier, attitude_growth
from thalweg.navigation.camera.images import (
    Between,
    BoatImages,
    corrected,
    interpolated_covariance,
)
from thalweg.navigation.camera.settings import CloudSettings


def neighbour_tests(
    images: BoatImages, joined: ArrayB, carrier: Carrier, settings: CloudSettings, common_time_s: float
) -> ArrayF:
    """Statistic (n,) of each image against the pose by both its neighbours, chi-squared with 6.

    NaN for images that are not joined with both.
    """
    out = np.full(len(images.row), np.nan)
    at = np.flatnonzero(joined[1:] & joined[:-1]) + 1 if len(joined) > 1 else np.zeros(0, dtype=np.int64)
    if not len(at):
        return out
    t = images.t_gps_s
    dt, gap = t[at] - t[at - 1], t[at + 1] - t[at - 1]
    between = Between(left=at - 1, right=at + 1, share=dt / gap)
    mine = images.take(at)
    position, R = corrected(images, mine.moments, between)
    d = np.hstack([
        mine.position_wcs_m - position,
        rotation_vector(mine.R_wcs_ics @ np.swapaxes(R, 1, 2)),
    ])  # fmt: skip
    own = Between(left=at, right=at, share=np.zeros(len(at)))
    cov = interpolated_covariance(images, between, common_time_s)
    cov = cov + interpolated_covariance(images, own, common_time_s)
    # what the image has in common with both neighbours cancels
    r, shared = images.moments.rates, np.minimum(np.square(images.sigma_t_s), common_time_s**2)
    for other, share in ((at - 1, 1 - between.share), (at + 1, between.share)):
        X = images.common(at, other)
        X += np.sqrt(shared[at] * shared[other])[:, None, None] * (r[at][:, :, None] * r[other][:, None, :])
        cov -= share[:, None, None] * (X + np.swapaxes(X, 1, 2))
    cov[:, :3, :3] += carrier.way_variance_m2(dt, between.share, gap, settings)[:, None, None] * np.eye(3)
    cov[:, 3:, 3:] += attitude_growth(mine.moments, dt, between.share, gap, settings)
    scale = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    scale = np.where(scale > 0, scale, 1.0)
    white = d / scale
    C = cov / scale[:, :, None] / scale[:, None, :] + 1e-12 * np.eye(6)
    out[at] = np.einsum("ni,ni->n", white, np.linalg.solve(C, white[:, :, None])[:, :, 0])
    return out
