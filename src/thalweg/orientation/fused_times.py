"""Correlation times of the errors of INS and positions, from a survey with images.

The images tell how the attitudes of the INS change from one second to the next, and images and velocity
together how the positions do. The likelihood of all innovations (Schweppe 1965) weighs that for any pair of
times by one pass of the filter::

    -2 log L = sum (log S + nu^2 / S)

The greatest of it is sought for one time after the other, each together with the size of its error: short
times look like large errors of long ones. A survey of a few correlation times says little of them: what is
stated counts, of a time as a normal distribution of its logarithm.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np
from scipy.optimize import minimize

from thalweg.core.types import ArrayF
from thalweg.orientation import fused_kernels as kernels
from thalweg.orientation.fused_inputs import Nodes
from thalweg.orientation.fused_model import Factors, transitions
from thalweg.orientation.fused_reference import Reference
from thalweg.orientation.fused_settings import FACTORS, PRIOR_REDUNDANCY, FusionSettings, Layout
from thalweg.orientation.fused_solver import Observed, Solved, first_offset, linearised

LEAST_IMAGES: Final = 20
"""Fewer say next to nothing of a time."""

BOUNDS_S: Final = (0.3, 300.0)

_SPREAD: Final = 1.0
"""Standard deviation of the logarithm of a time about the stated one: a factor of 2.7."""

_STILL: Final = 0.05

_SIZE_OF: Final = {"attitude_time_s": "roll_pitch", "gnss_time_s": "gnss"}
"""Group of errors whose size goes with a time; that of the heading is as stated."""


def correlation_times(
    reference: Reference,
    nodes: Nodes,
    observed: Observed,
    solved: Solved,
    layout: Layout,
    settings: FusionSettings,
    *,
    clock_start_s: float,
) -> FusionSettings:
    """Settings with the times that ``settings.estimate_times`` names, as the survey has them.

    Parameters
    ----------
    reference, nodes, observed, layout : the task.
    solved : a solution of it, at which observations are linearised and whose factors of the sigmas hold.
    settings : its settings; unchanged ones come back where there are too few images.
    clock_start_s : prior mean of the clock offset about the nodes of the images.
    """
    if observed.camera is None or int((observed.weight_camera > 0).sum()) < LEAST_IMAGES:
        return settings
    misfit = _misfit(reference, nodes, observed, solved, layout, clock_start_s=clock_start_s)
    factors = dict(solved.factors)
    for name in settings.estimate_times:
        if name == "gnss_time_s" and observed.antenna is None:
            continue
        group, about = _SIZE_OF[name], float(np.log(getattr(settings, name)))
        found = minimize(
            _of_pair(misfit, settings, factors, name, about),
            np.array([about, 0.0]),
            method="Nelder-Mead",
            bounds=[tuple(np.log(BOUNDS_S)), tuple(np.log(FACTORS))],
            options={"initial_simplex": _simplex(about), "xatol": _STILL, "fatol": _STILL},
        )
        values: dict[str, Any] = {name: float(np.exp(found.x[0]))}
        settings = replace(settings, **values)
        factors[group] = float(np.exp(found.x[1]))
    return settings


def _simplex(about: float) -> ArrayF:
    """First triangle (3, 2) of the search: shorter and longer, smaller and larger."""
    return np.array([[about - 1.0, 0.3], [about + 1.0, 0.3], [about, -0.4]])


def times_facts(settings: FusionSettings, given: FusionSettings) -> dict[str, Any]:
    """The times that were used, and which of them the survey gave."""
    names = ("attitude_time_s", "gnss_time_s")
    return {
        "correlation_times": {
            **{name: getattr(settings, name) for name in names},
            "estimated": [n for n in names if getattr(settings, n) != getattr(given, n)],
            "asked_for": list(given.estimate_times),
        }
    }


def _of_pair(
    misfit: Callable[[FusionSettings, Factors], float],
    settings: FusionSettings,
    factors: Factors,
    name: str,
    about: float,
) -> Callable[[ArrayF], float]:
    """Misfit as a function of the logarithms of a time and of the size of its error, with what was stated."""

    def at(logarithms: ArrayF) -> float:
        time, size = (float(x) for x in logarithms)
        values: dict[str, Any] = {name: float(np.exp(time))}
        # an estimated variance of n values has the relative variance 2 / n, its root's logarithm 1 / (2 n)
        stated = ((time - about) / _SPREAD) ** 2 + 2 * PRIOR_REDUNDANCY * size**2
        changed = factors | {_SIZE_OF[name]: float(np.exp(size))}
        return misfit(replace(settings, **values), changed) + stated

    return at


def _misfit(
    reference: Reference,
    nodes: Nodes,
    observed: Observed,
    solved: Solved,
    layout: Layout,
    *,
    clock_start_s: float,
) -> Callable[[FusionSettings, Factors], float]:
    """``-2 log L`` as a function of settings and factors, linearised where the solution is."""
    at = reference.at(nodes.t_gps_s)
    start_m = first_offset(at, observed)
    m, n = solved.x.shape

    def value(settings: FusionSettings, factors: Factors) -> float:
        rows = linearised(solved.x, at, observed, layout, settings, factors)
        t = transitions(
            nodes, layout, settings, factors,
            start_m=start_m, antenna=observed.antenna, camera=observed.camera, clock_start_s=clock_start_s,
        )  # fmt: skip
        first_row = np.searchsorted(rows.node, np.arange(m + 1))
        x, P = np.empty((m, n)), np.empty((m, n, n))
        K, S, nu = np.empty((len(rows.y), n)), np.empty(len(rows.y)), np.empty(len(rows.y))
        kernels.forward(
            t.x0, t.p0, t.pair, t.walk, t.phi, t.q, layout.camera, t.image_of, t.G, t.W, first_row, rows.H,
            rows.y, x, P, K, S, nu,
        )  # fmt: skip
        # rows are in units of their sigmas, which grow with the factor
        units = 2 * float(rows.of_antenna.sum()) * np.log(factors["gnss_white"])
        return float(np.sum(np.log(S) + nu**2 / S) + units)

    return value
