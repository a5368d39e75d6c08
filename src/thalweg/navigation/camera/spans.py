"""When the camera gives a pose: frames about images, and what is bridged between them."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.types import ArrayB, ArrayF
from thalweg.navigation.camera.carrier import Carrier, stretches
from thalweg.navigation.camera.images import Between, BoatImages
from thalweg.navigation.camera.settings import CloudSettings

_SAME_S: Final = 1e-6
"""Nodes that are nearer are one: lidar points lie microseconds apart."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spans:
    """``begin_s``, ``end_s`` (n,) of the frame of each image; ``whole_s`` (k, 2) the spans with poses, in
    order and apart.
    """

    begin_s: ArrayF
    end_s: ArrayF
    whole_s: ArrayF

    def inside(self, t_gps_s: ArrayF) -> ArrayB:
        """Whether times (n,) have a pose."""
        k = np.searchsorted(self.whole_s[:, 0], t_gps_s, side="right") - 1
        return np.asarray((k >= 0) & (t_gps_s <= self.whole_s[np.maximum(k, 0), 1]))

    def between(self, t_gps_s: ArrayF, t_images_s: ArrayF, joined: ArrayB) -> Between:
        """Images that count at times within the spans, and how much."""
        n = len(t_images_s)
        after = np.searchsorted(t_images_s, t_gps_s, side="right")
        left, right = np.maximum(after - 1, 0), np.minimum(after, n - 1)
        both = (left < right) & np.append(joined, False)[left]
        gap = np.where(both, t_images_s[right] - t_images_s[left], 1.0)
        share = np.where(both, (t_gps_s - t_images_s[left]) / gap, 0.0)
        # between images that nothing joins: the one in whose frame it is, of both the nearer
        in_left, in_right = t_gps_s <= self.end_s[left], t_gps_s >= self.begin_s[right]
        nearer = np.abs(t_gps_s - t_images_s[left]) <= np.abs(t_images_s[right] - t_gps_s)
        one = np.where(in_left & (nearer | ~in_right), left, right)
        return Between(left=np.where(both, left, one), right=np.where(both, right, one), share=share)


def pose_spans(images: BoatImages, joined: ArrayB, carrier: Carrier, settings: CloudSettings) -> Spans:
    """Frames about the images, and with ``bridge`` also the time between images that are joined.

    A frame ends where the INS has a hole: nothing is extrapolated.
    """
    first, last = stretches(carrier)
    begin = np.maximum(images.t_gps_s - settings.half_rotation_s, first[images.stretch])
    end = np.minimum(images.t_gps_s + settings.half_rotation_s, last[images.stretch])
    low, high = [begin], [end]
    if settings.frames == "bridge":
        low.append(images.t_gps_s[:-1][joined])
        high.append(images.t_gps_s[1:][joined])
    return Spans(begin_s=begin, end_s=end, whole_s=_merged(np.concatenate(low), np.concatenate(high)))


def node_times(spans: Spans, carrier: Carrier, t_images_s: ArrayF) -> tuple[ArrayF, ArrayB]:
    """Times of the nodes and whether they are valid.

    Nodes at the rate of the INS, at the images and at the borders of the spans; an invalid one between two
    spans, so that nothing is interpolated across.
    """
    exact = np.concatenate([spans.whole_s.ravel(), t_images_s])
    exact = np.unique(exact[spans.inside(exact)])
    exact = exact[np.append(True, np.diff(exact) > _SAME_S)]
    own = carrier.t_gps_s[spans.inside(carrier.t_gps_s)]
    right = np.clip(np.searchsorted(exact, own), 1, max(len(exact) - 1, 1))
    near = np.minimum(np.abs(own - exact[right - 1]), np.abs(exact[np.minimum(right, len(exact) - 1)] - own))
    middle = (spans.whole_s[1:, 0] + spans.whole_s[:-1, 1]) / 2
    t = np.concatenate([exact, own[near > _SAME_S], middle])
    valid = np.append(np.ones(len(t) - len(middle), dtype=np.bool_), np.zeros(len(middle), dtype=np.bool_))
    order = np.argsort(t, kind="stable")
    return t[order], valid[order]


def _merged(begin: ArrayF, end: ArrayF) -> ArrayF:
    """Spans (k, 2) that do not meet, from some that do."""
    order = np.argsort(begin, kind="stable")
    begin, reach = begin[order], np.maximum.accumulate(end[order])
    fresh = np.append(True, begin[1:] > reach[:-1] + 2 * _SAME_S)
    return np.stack([begin[fresh], reach[np.append(np.flatnonzero(fresh)[1:] - 1, len(begin) - 1)]], axis=1)
