"""How large the errors of the inputs were and how long they lasted, from the survey itself.

What a campaign states of an error is where the search starts, and a prior: the logarithm of a size or of a
correlation time is normal about what is stated, with a factor (`Prior`); so are the sizes of slow and white
errors of the positions, which makes their white share normal on the logit. The survey speaks through the
innovations of the filter (Schweppe 1965)::

    -2 log L(h) = sum (log S + nu^2 / S),      -2 log p(h) = -2 log L(h) + sum ((h - h0) / w)^2

Its least value is sought by Fisher's scoring, with derivatives of innovations and their variances by
differences; half of the expected second derivatives, inverted, are the covariance of ``h``::

    g_i  = sum (dS_i / S (1 - nu^2 / S) + 2 nu dnu_i / S) + 2 (h_i - h0_i) / w_i^2
    F_ij = sum (dS_i dS_j / S^2 + 2 dnu_i dnu_j / S) + 2 delta_ij / w_i^2,         cov h = 2 F^-1

Nobody knows ``h`` better than that, so poses are those at its best value and their covariance is the mean
over what ``h`` may be (law of total covariance), taken over points that have the mean and the covariance of
``h``: both ends of orthogonal diameters, ``h +- sqrt(k) L q_j`` with ``L L^T = cov h``::

    C = mean of C(h) + (x(h) - x) (x(h) - x)^T

A size that the survey does not tell so enlarges a variance by nearly ``E[f^2] = exp(2 ln(factor)^2)``, 2.6
for a factor of 2. As the variance of Student's distribution does, that counts few observations as few.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Self

import numpy as np

from thalweg.core import ArrayF
from thalweg.navigation.fusion import solver
from thalweg.navigation.fusion.model import (
    GROUPS,
    MODEL,
    POSE,
    SIZE_OF,
    TIMES,
    Factors,
    FusionSettings,
    Layout,
    Nodes,
    Reference,
    transitions,
)
from thalweg.navigation.fusion.solver import Observed, Solved, first_offset, linearised, smooth, solve

SHARE: Final = "gnss_white_share"

LEAST_POINTS: Final = 16
"""Solutions over which the uncertainty of the errors is averaged, at least."""

DETERMINED: Final = 0.5
"""A value counts as told by the survey if its sigma is at most this part of the prior's."""

_STEP: Final = 3e-3
_STILL: Final = 0.01
"""The search ends where a step would change -2 log p by less."""
_ROUNDS: Final = 15
_LONGEST_STEP: Final = 1.5
"""Of a logarithm in one round."""
_AGAIN: Final = 3
"""Estimates, as the observations that are rejected change with the sizes of their errors."""
_SEED: Final = 1965


@dataclass(frozen=True, slots=True, kw_only=True)
class Prior:
    """What is stated of an error: ``centre``, and the ``width`` of one sigma.

    ``kind`` is ``size`` (factor of a sigma, on the logarithm), ``time`` (seconds, on the logarithm) or
    ``share`` (on the logit); ``width`` is a factor, of a share that of ``w / (1 - w)``.
    """

    kind: str
    centre: float
    width: float

    @property
    def at(self) -> float:
        """The centre on its scale."""
        log = float(np.log(self.centre))
        return log - float(np.log1p(-self.centre)) if self.kind == "share" else log

    def value(self, h: float) -> float:
        """Back from the scale."""
        return float(1.0 / (1.0 + np.exp(-h))) if self.kind == "share" else float(np.exp(h))


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionErrors:
    """Sizes and times of the errors, as the prior and the survey have them.

    Parameters
    ----------
    priors : by name: groups of `thalweg.navigation.fusion.model.GROUPS`, times and the white share.
    h : (k,) best values on the scales of the priors, in their order.
    cov : (k, k) their covariance.
    white_share : stated share of the positions' variance that is white, if slow and white errors have sizes
        of their own; 0: not so.
    """

    priors: Mapping[str, Prior]
    h: ArrayF
    cov: ArrayF
    white_share: float = 0.0

    @classmethod
    def stated(cls, settings: FusionSettings, layout: Layout, nodes: Nodes) -> Self:
        """What is known without a survey: the priors."""
        priors = priors_of(settings, layout, nodes)
        width = np.array([np.log(p.width) for p in priors.values()])
        centre = np.array([p.at for p in priors.values()])
        return cls(
            priors=priors,
            h=centre,
            cov=np.diag(width**2).reshape(len(priors), len(priors)),
            white_share=settings.gnss_white_share if "gnss_white" in priors else 0.0,
        )

    def values(self, h: ArrayF | None = None) -> dict[str, float]:
        """By name: factors of sigmas, seconds, shares; the best ones, or those at ``h`` (k,)."""
        at = self.h if h is None else h
        return {n: p.value(float(x)) for (n, p), x in zip(self.priors.items(), at, strict=True)}

    def points(self) -> Iterator[ArrayF]:
        """Equally likely values of ``h`` (k,) with its mean and covariance; at least `LEAST_POINTS`."""
        k = len(self.h)
        if not k:
            return
        root = np.linalg.cholesky(self.cov)
        rng = np.random.default_rng(_SEED)
        for _ in range(-(-LEAST_POINTS // (2 * k))):
            turned, _ = np.linalg.qr(rng.standard_normal((k, k)))
            for direction in turned.T:
                away = np.sqrt(k) * root @ direction
                yield self.h + away
                yield self.h - away

    def facts(self) -> dict[str, dict[str, Any]]:
        """By name: stated value, its factor, estimate, range of 95 %, and whether the survey told it."""
        sigma = np.sqrt(np.diag(self.cov)) if len(self.h) else self.h
        each = zip(self.priors.items(), self.h.tolist(), sigma.tolist(), strict=True)
        out = {name: _fact(prior, x, s) for (name, prior), x, s in each}
        if self.white_share:
            out[SHARE] = self._share()
        return out

    def _share(self) -> dict[str, Any]:
        """The share of white errors by the sizes of both: ``logit w = logit w0 + 2 (ln f_white - ln f)``."""
        names = list(self.priors)
        by = np.zeros(len(names))
        by[names.index("gnss_white")] = 2.0
        by[names.index("gnss")] = -2.0
        width = 2 * np.hypot(*(np.log(self.priors[n].width) for n in ("gnss", "gnss_white")))
        prior = Prior(kind="share", centre=self.white_share, width=float(np.exp(width)))
        return _fact(prior, prior.at + float(by @ self.h), float(np.sqrt(by @ self.cov @ by)))

    def untold(self) -> list[str]:
        """Names that the survey says next to nothing of."""
        return [name for name, fact in self.facts().items() if not fact["determined_by_survey"]]

    def notes(self) -> list[str]:
        """For people: what the survey does not show of its errors, if anything."""
        names = self.untold()
        if not names:
            return []
        facts = self.facts()
        stated = ", ".join(
            f"{n} {facts[n]['stated']:g} ({facts[n]['stated_within_factor']:.2g})" for n in names
        )
        return [
            f"The survey does not show how large or how lasting these errors were: {stated}. What is stated "
            "of them counts, with the factor in brackets as one sigma, and enlarges the predicted sigmas"
        ]


def _fact(prior: Prior, h: float, sigma: float) -> dict[str, Any]:
    """What is known of one value at ``h`` with a ``sigma`` on the scale of its prior."""
    return {
        "kind": prior.kind,
        "stated": prior.centre,
        "stated_within_factor": prior.width,
        "estimated": prior.value(h),
        "low": prior.value(h - 1.96 * sigma),
        "high": prior.value(h + 1.96 * sigma),
        "determined_by_survey": bool(sigma <= DETERMINED * np.log(prior.width)),
    }


def priors_of(settings: FusionSettings, layout: Layout, nodes: Nodes) -> dict[str, Prior]:
    """What is to be estimated, and what is stated of it; nothing without ``settings.estimate_errors``."""
    if not settings.estimate_errors:
        return {}
    blind = nodes.kind[1:] == MODEL
    groups = {
        "velocity": bool((~blind).any()),
        "acceleration": bool(blind.any()),
        "roll_pitch": True,
        "heading": True,
        "disturbance": settings.heading_disturbance_deg > 0,
        "gnss": layout.gnss >= 0,
        "camera": layout.camera >= 0,
        "jitter": layout.camera >= 0,
    }
    times = {"velocity_time_s": groups["velocity"], "attitude_time_s": True, "gnss_time_s": groups["gnss"]}
    kept = {SIZE_OF.get(name, name) for name in settings.fixed}
    spread = settings.spread
    out = {
        name: Prior(kind="size", centre=1.0, width=spread.get(name, spread["size"]))
        for name, there in groups.items()
        if there and name not in kept
    }
    out |= {
        name: Prior(kind="time", centre=getattr(settings, name), width=spread.get(name, spread["time"]))
        for name in TIMES
        if times[name] and name not in kept
    }
    if groups["gnss"] and SHARE not in kept:
        # w / (1 - w) goes with the square of the size
        out["gnss_white"] = Prior(kind="size", centre=1.0, width=float(np.sqrt(spread["share"])))
    return out


def applied(values: Mapping[str, float], settings: FusionSettings) -> tuple[FusionSettings, Factors]:
    """Settings with the times, and factors of all sigmas, of `FusionErrors.values`.

    Slow and white errors of the positions have sizes of their own; one size if the white share is fixed.
    """
    times: dict[str, Any] = {name: values[name] for name in TIMES if name in values}
    out = dict.fromkeys(GROUPS, 1.0) | {"gnss_white": values.get("gnss", 1.0)}
    out |= {name: f for name, f in values.items() if name not in times}
    return settings.model_copy(update=times), out


def with_errors(
    reference: Reference,
    nodes: Nodes,
    observed: Observed,
    solved: Solved,
    layout: Layout,
    settings: FusionSettings,
    *,
    clock_start_s: float,
    spread: bool = True,
) -> tuple[Nodes, FusionSettings, Solved, FusionErrors]:
    """The solution with errors of the sizes and times that the survey shows.

    Parameters
    ----------
    reference, nodes, observed, layout, settings : the task; ``observed`` receives the weights.
    solved : a solution of it.
    clock_start_s : prior mean of the clock offset about the nodes of the images.
    spread : whether covariances count what is not known of the errors; without, they are those at the best.

    Returns
    -------
    nodes, settings with the times, solution whose covariances count what is not known of the errors, and the
    errors. In the nodes the noise of gaps stays what it was, whatever the size of the steps' own.
    """
    model: FusionErrors | None = None
    now, steps = settings, solved.n_solutions
    for _ in range(_AGAIN):
        model = estimated(
            reference, nodes, observed, solved, layout, settings, clock_start_s=clock_start_s, start=model
        )
        if not model.priors:
            return nodes, settings, solved, model
        now, factors = applied(model.values(), settings)
        change = (solved.factors["acceleration"] / factors["acceleration"]) ** 2
        walk = np.where(nodes.walk > 1.0, np.maximum(nodes.walk * change, 1.0), nodes.walk)
        nodes = replace(nodes, walk=walk)
        before = observed.weight_antenna.copy(), observed.weight_camera.copy()
        solved = solve(
            reference,
            nodes,
            observed,
            layout,
            now.model_copy(update={"estimate_errors": False}),
            clock_start_s=clock_start_s,
            factors=factors,
            start=solved.x,
        )
        steps += solved.n_solutions
        if np.array_equal(before[0], observed.weight_antenna) and np.array_equal(
            before[1], observed.weight_camera
        ):
            break
    assert model is not None
    if spread:
        solved = spread_over(
            model, reference, nodes, observed, solved, layout, settings, clock_start_s=clock_start_s
        )
    return nodes, now, replace(solved, n_solutions=steps), model


def estimated(
    reference: Reference,
    nodes: Nodes,
    observed: Observed,
    solved: Solved,
    layout: Layout,
    settings: FusionSettings,
    *,
    clock_start_s: float,
    start: FusionErrors | None = None,
) -> FusionErrors:
    """The errors of a survey.

    Parameters
    ----------
    reference, nodes, observed, layout, settings : the task; ``settings`` as stated.
    solved : a solution of it, at which observations are linearised.
    clock_start_s : prior mean of the clock offset about the nodes of the images.
    start : an earlier estimate to start from; by default the factors of ``solved``.
    """
    nothing = FusionErrors.stated(settings, layout, nodes)
    priors, centre = nothing.priors, nothing.h
    width = np.array([np.log(p.width) for p in priors.values()])
    k = len(priors)
    if not k:
        return nothing
    innovations = _Innovations(reference, nodes, observed, solved, layout, settings, clock_start_s)

    def at(h: ArrayF) -> tuple[ArrayF, ArrayF, float]:
        """Innovations and their variances (r,), and -2 log p."""
        nu, S = innovations(*applied(nothing.values(h), settings))
        return nu, S, float(np.sum(np.log(S) + nu**2 / S) + np.sum(((h - centre) / width) ** 2))

    h = _start(priors, solved.factors, centre) if start is None else start.h.copy()
    nu, S, cost = at(h)
    F = np.diag(2 / width**2)
    for _ in range(_ROUNDS):
        d_nu, d_S = np.empty((k, len(nu))), np.empty((k, len(nu)))
        for i in range(k):
            moved = h.copy()
            moved[i] += _STEP
            nu_i, S_i, _ = at(moved)
            d_nu[i], d_S[i] = (nu_i - nu) / _STEP, (S_i - S) / _STEP
        g = d_S @ ((1 - nu**2 / S) / S) + 2 * d_nu @ (nu / S) + 2 * (h - centre) / width**2
        a, b = d_S / S, d_nu / np.sqrt(S)
        F = a @ a.T + 2 * b @ b.T + np.diag(2 / width**2)
        step = -np.linalg.solve(F, g)
        if -float(g @ step) < _STILL:
            break
        step *= min(1.0, _LONGEST_STEP / float(np.abs(step).max()))
        for _ in range(5):
            tried = at(h + step)
            if tried[2] < cost:
                break
            step = step / 3
        else:
            break
        h = h + step
        nu, S, cost = tried
    return replace(nothing, h=h, cov=np.asarray(2 * np.linalg.inv(F), dtype=np.float64))


def spread_over(
    model: FusionErrors,
    reference: Reference,
    nodes: Nodes,
    observed: Observed,
    solved: Solved,
    layout: Layout,
    settings: FusionSettings,
    *,
    clock_start_s: float,
    part: int = POSE,
) -> Solved:
    """A solution whose covariances are the mean over what the errors may be; states stay.

    Parameters
    ----------
    model : how well the errors are known.
    reference, nodes, observed, layout, settings : the task.
    solved : its solution at the best values of ``model``.
    clock_start_s : as for `estimated`.
    part : the first ``part`` states get covariances.
    """
    at = reference.at(nodes.t_gps_s)
    start_m = first_offset(at, observed)
    cov, cross = np.zeros((2, len(nodes.t_gps_s), part, part))
    last = np.zeros_like(solved.last)
    # nothing that `applied` changes enters the rows themselves
    rows = linearised(solved.x, at, observed, layout, settings)
    n = 0
    for h in model.points():
        changed, factors = applied(model.values(h), settings)
        found = smooth(
            solved.x,
            at,
            nodes,
            observed,
            layout,
            changed,
            factors,
            start_m=start_m,
            clock_start_s=clock_start_s,
            part=part,
            rows=rows,
        )
        away = found.x - solved.x
        pose = away[:, :part]
        cov += found.cov + pose[:, :, None] * pose[:, None, :]
        cross += found.cross
        cross[:-1] += pose[:-1, :, None] * pose[1:, None, :]
        last += found.last + np.outer(away[-1], away[-1])
        n += 1
    return solved if not n else replace(solved, cov=cov / n, cross=cross / n, last=last / n)


def _start(priors: Mapping[str, Prior], factors: Factors, centre: ArrayF) -> ArrayF:
    """Where the search starts (k,): the factors of a solution within a sigma of what is stated."""
    out = centre.copy()
    for i, (name, prior) in enumerate(priors.items()):
        if prior.kind == "size":
            reach = np.log(prior.width)
            out[i] = np.clip(np.log(factors[name]), -reach, reach)
    return out


class _Innovations:
    """Innovations of the filter as a function of settings and factors, linearised where the solution is."""

    def __init__(
        self,
        reference: Reference,
        nodes: Nodes,
        observed: Observed,
        solved: Solved,
        layout: Layout,
        settings: FusionSettings,
        clock_start_s: float,
    ) -> None:
        at = reference.at(nodes.t_gps_s)
        self._start_m = first_offset(at, observed)
        self._rows = linearised(solved.x, at, observed, layout, settings)
        self._first_row = np.searchsorted(self._rows.node, np.arange(len(solved.x) + 1))
        self._task = nodes, observed, layout, clock_start_s

    def __call__(self, settings: FusionSettings, factors: Factors) -> tuple[ArrayF, ArrayF]:
        """Innovations (r,) and their variances (r,), in units that do not change with the factors."""
        nodes, observed, layout, clock_start_s = self._task
        rows = self._rows.weighted(factors)
        t = transitions(
            nodes,
            layout,
            settings,
            factors,
            start_m=self._start_m,
            antenna=observed.antenna,
            camera=observed.camera,
            clock_start_s=clock_start_s,
        )
        n, r = layout.n, len(rows.y)
        S, nu = np.empty(r), np.empty(r)
        solver.forward(
            t.x0,
            t.p0,
            t.pair,
            t.walk,
            t.phi,
            t.q,
            layout.camera,
            t.image_of,
            t.G,
            t.W,
            self._first_row,
            rows.H,
            rows.y,
            np.empty((0, n)),
            np.empty((0, n, n)),
            np.empty((0, n)),
            S,
            nu,
        )
        # rows are in units of their sigmas, which grow with the factors
        unit = self._rows.unit(factors)
        return nu * unit, S * unit**2
