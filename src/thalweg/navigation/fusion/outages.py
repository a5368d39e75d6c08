"""Stretches that the fused trajectory had to bridge: without GNSS, or without images."""

from itertools import pairwise
from typing import Any, Final

import numpy as np

from thalweg.core.types import ArrayF
from thalweg.navigation.fusion.solver import Observed
from thalweg.navigation.ins_gnss.reference import Reference

LEAST_S: Final = 1.0
"""Shorter gaps are none."""

_USUAL: Final = 3.0
"""Neither are those of less than so many usual intervals."""


def outages_of(observed: Observed, reference: Reference) -> list[dict[str, Any]]:
    """Spans of the INS without positions, and without images, that were used.

    Returns
    -------
    ``without`` (positions, images), ``begin_gps_s``, ``end_gps_s`` of each, in order of time; of a kind that
    there is nothing of, the whole survey.
    """
    first, last = float(reference.t_gps_s[0]), float(reference.t_gps_s[-1])
    out: list[dict[str, Any]] = []
    for kind, given, weight in (
        ("positions", observed.antenna, observed.weight_antenna),
        ("images", observed.camera, observed.weight_camera),
    ):
        t = np.zeros(0) if given is None else given.t_gps_s[weight > 0]
        out += [{"without": kind, "begin_gps_s": a, "end_gps_s": b} for a, b in _gaps(t, first, last)]
    return sorted(out, key=lambda gap: gap["begin_gps_s"])


def _gaps(t_gps_s: ArrayF, first: float, last: float) -> list[tuple[float, float]]:
    steps = np.diff(t_gps_s)
    usual_s = float(np.median(steps)) if len(steps) else 0.0
    edges = np.concatenate([[first], np.sort(t_gps_s), [last]])
    limit = max(LEAST_S, _USUAL * usual_s)
    return [(float(a), float(b)) for a, b in pairwise(edges.tolist()) if b - a > limit]
