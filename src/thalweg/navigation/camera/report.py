"""What became of the images and of the time on the way to the camera's trajectory."""

from typing import Any

import numpy as np
import pandas as pd

from thalweg.core.types import ArrayB, ArrayF
from thalweg.images.model.poses import ImagePoses
from thalweg.navigation.camera.carrier import Carrier, stretches
from thalweg.navigation.camera.images import BoatImages
from thalweg.navigation.camera.settings import CloudSettings
from thalweg.navigation.camera.spans import Spans


def image_table(
    poses: ImagePoses, images: BoatImages, reasons: list[str], joined: ArrayB, spans: Spans
) -> pd.DataFrame:
    """A row an image, in the order of the poses.

    Columns ``image, t_gps_s, sigma_t_s, used, reason``; ``frame_begin_s, frame_end_s`` of its lidar frame,
    GPS time; ``joined_with_next`` whether the INS joins it with the next image in time; ``speed_mps`` and
    ``turn_rate_degps`` of the boat, and what one sigma of the time does with them: ``by_time_m``,
    ``by_time_deg``.
    """
    table = pd.DataFrame({
        "image": list(poses.images),
        "t_gps_s": poses.t_gps_s,
        "sigma_t_s": poses.sigma_t_s,
        "used": [not reason for reason in reasons],
        "reason": reasons,
    })  # fmt: skip
    speed = np.linalg.norm(images.moments.rates[:, :3], axis=1)
    rate = np.rad2deg(np.linalg.norm(images.moments.rates[:, 3:], axis=1))
    columns: dict[str, Any] = {
        "frame_begin_s": spans.begin_s,
        "frame_end_s": spans.end_s,
        "speed_mps": speed,
        "turn_rate_degps": rate,
        "by_time_m": speed * images.sigma_t_s,
        "by_time_deg": rate * images.sigma_t_s,
    }
    for name, values in columns.items():
        column = np.full(len(table), np.nan)
        column[images.row] = values
        table[name] = column
    to_next = np.zeros(len(table), dtype=np.bool_)
    to_next[images.row] = np.append(joined, False)
    table["joined_with_next"] = to_next
    return table


def time_facts(
    images: BoatImages, joined: ArrayB, spans: Spans, carrier: Carrier, settings: CloudSettings
) -> dict[str, Any]:
    """How much of the time of the INS has a pose of the camera, and why the rest has none.

    Returns
    -------
    ``frames_made`` (one an image), ``spans``, ``time_s`` of the whole INS, ``time_with_pose_s``, and
    ``time_lost_s`` by reason; they add up.
    """
    t = images.t_gps_s
    first, last = float(carrier.t_gps_s[0]), float(carrier.t_gps_s[-1])
    covered = float(np.sum(np.diff(spans.whole_s, axis=1)))
    begin, end = stretches(carrier)
    holes = np.stack([np.append(first, end), np.append(begin, last)], axis=1)
    gaps = np.stack([spans.whole_s[:-1, 1], spans.whole_s[1:, 0]], axis=1)
    # between which images each gap lies
    left = np.clip(np.searchsorted(t, gaps[:, 0], side="right") - 1, 0, max(len(t) - 2, 0))
    far = np.diff(t)[left] > settings.max_gap_s if len(t) > 1 else np.zeros(len(gaps), dtype=np.bool_)
    in_hole = np.array([_overlap(gap, holes) for gap in gaps])
    rest = np.diff(gaps, axis=1)[:, 0] - in_hole
    outside = np.array([[first, spans.whole_s[0, 0]], [spans.whole_s[-1, 1], last]])
    outside_hole = sum(_overlap(span, holes) for span in outside)
    lost = {
        "before the first and behind the last image": float(np.diff(outside, axis=1).sum()) - outside_hole,
        "images farther apart than max_gap_s": float(rest[far].sum()),
        "between the frames of images": float(rest[~far].sum()),
        "hole of the INS": float(in_hole.sum()) + outside_hole,
    }
    return {
        "frames_made": len(t),
        "spans": len(spans.whole_s),
        "neighbours_joined": int(joined.sum()),
        "neighbours_not_joined": int((~joined).sum()),
        "longest_interval_s": float(np.diff(t).max()) if len(t) > 1 else None,
        "time_s": last - first,
        "time_with_pose_s": covered,
        "time_lost_s": {reason: max(value, 0.0) for reason, value in lost.items()},
    }


def _overlap(span: ArrayF, holes: ArrayF) -> float:
    """Length that a span shares with holes, seconds."""
    shared = np.minimum(span[1], holes[:, 1]) - np.maximum(span[0], holes[:, 0])
    return float(np.maximum(shared, 0.0).sum())
