"""Images as poses of the boat at their times, and how the errors of neighbours hang together.

``T_wcs_ics = T_wcs_ccs T_ccs_ics``. The mount of the camera is taken as it is: the lidar is placed on the
boat through the same mount (`thalweg.navigation.camera.mounts`), so that its error drops out of
the cloud.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from thalweg.core.propagation import cross_matrix
from thalweg.core.rigid import Rigid, rotation_vector
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI
from thalweg.images.model.poses import ImagePoses
from thalweg.navigation.camera.carrier import Carrier, Moments, stretch_of

SAME_TIME_S: Final = 1e-6
"""Images whose times differ by less are the same one twice."""

NO_POSE: Final = "no pose"
NO_TIME: Final = "no time"
NO_COVARIANCE: Final = "no covariance"
TWICE: Final = "same time as another image"
NO_INS: Final = "the INS does not cover its time"
CONTRADICTS: Final = "contradicts its neighbours and the INS"

_LONGEST_LINK: Final = 64
"""Images between two for which their common error is followed; farther ones are taken as unlike."""

_MOST_ALIKE: Final = 0.9999
"""Greatest correlation of two images' errors."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoatImages:
    """Images of a table of poses, in order of time, as poses of the boat.

    ``row`` (n,) rows of the table; ``t_gps_s``, ``sigma_t_s`` (n,); ``position_wcs_m`` (n, 3) and
    ``R_wcs_ics`` (n, 3, 3); ``cov`` (n, 6, 6) of the ics pose without mount and time; ``moments`` the carrier
    at their times; ``stretch`` (n,) the unbroken stretch of the carrier that each lies in; ``root`` (n, 6, 6)
    with ``root root^T = cov``; ``rank`` (n,) place among the oriented images of the table; ``alike`` (m - 1,
    6, 6) correlation of each oriented image with the next one, in units of the roots.
    """

    row: ArrayI
    t_gps_s: ArrayF
    sigma_t_s: ArrayF
    position_wcs_m: ArrayF
    R_wcs_ics: ArrayF
    cov: ArrayF
    moments: Moments
    stretch: ArrayI
    root: ArrayF
    rank: ArrayI
    alike: ArrayF

    def take(self, which: AnyArray) -> "BoatImages":
        """Some of the images."""
        m = self.moments
        return BoatImages(
            row=self.row[which],
            t_gps_s=self.t_gps_s[which],
            sigma_t_s=self.sigma_t_s[which],
            position_wcs_m=self.position_wcs_m[which],
            R_wcs_ics=self.R_wcs_ics[which],
            cov=self.cov[which],
            moments=Moments(
                way_m=m.way_m[which],
                R_wcs_ics=m.R_wcs_ics[which],
                sigma_rad=m.sigma_rad[which],
                rates=m.rates[which],
            ),
            stretch=self.stretch[which],
            root=self.root[which],
            rank=self.rank[which],
            alike=self.alike,
        )

    def corrections(self) -> tuple[ArrayF, ArrayF]:
        """Images minus carrier: shift (n, 3) of the way and rotation (n, 3, 3), both in wcs."""
        turn = self.R_wcs_ics @ np.swapaxes(self.moments.R_wcs_ics, 1, 2)
        return self.position_wcs_m - self.moments.way_m, turn

    def common(self, first: ArrayI, second: ArrayI) -> ArrayF:
        """Covariance (k, 6, 6) of the errors of images ``first`` with those of images ``second``."""
        out = np.zeros((len(first), 6, 6))
        for k, (a, b) in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
            link = self._link(int(self.rank[a]), int(self.rank[b]))
            out[k] = self.root[a] @ link @ self.root[b].T
        return out

    def _link(self, a: int, b: int) -> ArrayF:
        if b < a:
            return self._link(b, a).T
        if b - a > _LONGEST_LINK:
            return np.zeros((6, 6))
        link = np.eye(6)
        for k in range(a, b):
            link = link @ self.alike[k]
        return link


def boat_images(
    poses: ImagePoses, T_ics_ccs: Rigid, carrier: Carrier, *, sigma_time_s: float
) -> tuple[BoatImages, list[str]]:
    """Images that can carry the boat, and for each image of the table why it cannot ("" if it can).

    The order of the table is that of its neighbours' covariances; times may be in any order. Where two
    images are no neighbours in the table, their common error follows from those between them as in a Markov
    chain.

    Parameters
    ----------
    poses : of all images.
    T_ics_ccs : mount of the camera.
    carrier : the INS.
    sigma_time_s : stands in where the table states no sigma of a time.
    """
    oriented = np.flatnonzero(poses.oriented)
    has_cov = np.isfinite(poses.cov_pose_wcs).all(axis=(1, 2))
    reason = np.full(len(poses.images), "", dtype=object)
    reason[~has_cov] = NO_COVARIANCE
    reason[~np.isfinite(poses.t_gps_s)] = NO_TIME
    for row in np.flatnonzero(~poses.oriented):
        reason[row] = f"{NO_POSE}: {poses.reasons[row]}" if poses.reasons[row] else NO_POSE
    rows = np.flatnonzero(reason == "")
    reason[rows[stretch_of(carrier, poses.t_gps_s[rows]) < 0]] = NO_INS
    rows = np.flatnonzero(reason == "")
    rows = rows[np.argsort(poses.t_gps_s[rows], kind="stable")]
    again = np.append(False, np.diff(poses.t_gps_s[rows]) <= SAME_TIME_S)[: len(rows)]
    reason[rows[again]] = TWICE
    rows = rows[~again]
    T_ccs_ics = T_ics_ccs.inverse()
    R = poses.R_wcs_ccs[oriented]
    arm = R @ T_ccs_ics.shift_m
    J = np.tile(np.eye(6), (len(oriented), 1, 1))
    J[:, :3, 3:] = -cross_matrix(arm)
    root, alike = _chain(poses.cov_pose_wcs[oriented], poses.cov_next[oriented])
    rank = np.searchsorted(oriented, rows)
    sigma = poses.sigma_t_s[rows]
    own = (J @ root)[rank]
    images = BoatImages(
        row=rows,
        t_gps_s=poses.t_gps_s[rows],
        sigma_t_s=np.where(np.isfinite(sigma), sigma, sigma_time_s),
        position_wcs_m=(poses.centre_wcs_m[oriented] + arm)[rank],
        R_wcs_ics=(R @ T_ccs_ics.R)[rank],
        cov=own @ np.swapaxes(own, 1, 2),
        moments=carrier.at(poses.t_gps_s[rows]),
        stretch=stretch_of(carrier, poses.t_gps_s[rows]),
        root=own,
        rank=rank,
        alike=alike,
    )
    return images, reason.astype(str).tolist()


@dataclass(frozen=True, slots=True, kw_only=True)
class Between:
    """Times between images: ``left``, ``right`` (n,) images, equal where only one counts; ``share`` (n,) of
    the right one.
    """

    left: ArrayI
    right: ArrayI
    share: ArrayF


def corrected(images: BoatImages, at: Moments, between: Between) -> tuple[ArrayF, ArrayF]:
    """Position (n, 3) and ``R_wcs_ics`` (n, 3, 3): the carrier with the correction of the images.

    Shifts are interpolated linearly, rotations along the shortest arc.
    """
    shift, turn = images.corrections()
    a, b, u = between.left, between.right, between.share[:, None]
    arc = rotation_vector(turn[b] @ np.swapaxes(turn[a], 1, 2)) if len(a) else np.zeros((0, 3))
    D = Rotation.from_rotvec(arc * u).as_matrix() @ turn[a]
    return at.way_m + (1 - u) * shift[a] + u * shift[b], D @ at.R_wcs_ics


def interpolated_covariance(images: BoatImages, between: Between, common_time_s: float) -> ArrayF:
    """Covariance (n, 6, 6) of interpolated corrections: of the images' poses and of their times (P2 eq. 6).

    An error of time moves an image by the speed of the boat, linear and angular, at that moment.

    Parameters
    ----------
    images, between : which images count how much.
    common_time_s : sigma of the part of the times' errors that all images share.
    """
    a, b = between.left, between.right
    pairs, place = np.unique(np.stack([a, b]), axis=1, return_inverse=True)
    X = images.common(pairs[0], pairs[1])[place.ravel()]
    variance = np.square(images.sigma_t_s)
    shared = np.minimum(variance, common_time_s**2)
    r = images.moments.rates
    own = images.cov + variance[:, None, None] * (r[:, :, None] * r[:, None, :])
    X = X + np.sqrt(shared[a] * shared[b])[:, None, None] * (r[a][:, :, None] * r[b][:, None, :])
    u = between.share[:, None, None]
    mixed = (1 - u) ** 2 * own[a] + u**2 * own[b] + u * (1 - u) * (X + np.swapaxes(X, 1, 2))
    return np.asarray(np.where((a == b)[:, None, None], own[a], mixed))


def linked(images: BoatImages, max_gap_s: float) -> ArrayB:
    """Whether the carrier joins each image (n - 1,) with the next one."""
    near = np.diff(images.t_gps_s) <= max_gap_s + SAME_TIME_S
    return np.asarray(near & (np.diff(images.stretch) == 0))


def _chain(cov: ArrayF, following: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Roots (m, 6, 6) of covariances and the correlation (m - 1, 6, 6) of neighbours in their units.

    Singular values of a correlation are at most 1; more, and an interpolation would be free of error.
    """
    sigma = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 0.0))
    scale = np.nan_to_num(np.where(sigma > 0, sigma, 1.0), nan=1.0)
    value, vector = np.linalg.eigh(np.nan_to_num(cov) / scale[:, :, None] / scale[:, None, :])
    size = np.sqrt(np.maximum(value, 0.0))
    root = scale[:, :, None] * vector * size[:, None, :]
    safe = np.where(size > 1e-6, size, np.inf)
    inverse = np.swapaxes(vector, 1, 2) / safe[:, :, None] / scale[:, None, :]
    if len(cov) < 2:
        return root, np.zeros((0, 6, 6))
    raw = inverse[:-1] @ np.nan_to_num(following[:-1]) @ np.swapaxes(inverse[1:], 1, 2)
    left, s, right = np.linalg.svd(raw)
    return root, np.asarray(left * np.minimum(s, _MOST_ALIKE)[:, None, :] @ right)
