"""Which covariance the bed has, by what it foretells of lines that it did not see.

The model, its parameters and the drift are those with the best score of left-out lines,

    mean of  log(var)/2 + error^2 / (2 var)  +  sum of  (log(parameter / usual) / log(factor))^2 / (2 m),

the negative logarithm of the normal density that kriging gives to soundings that it was not shown (Gneiting
and Raftery 2007, J. Am. Stat. Assoc. 102), and of what is usual in rivers, where ``m`` is the number of
left-out lines: the errors of a line go together, it counts as one. Four lines alone say little: their score
is as good with a range of 600 m as with one of 100 m, and the standard deviations differ by a factor of
three. Ranges and anisotropy are bounded as well. A line is foretold without its part in the drift.

Shorelines are data, but they judge nothing: they are level all along by definition, and a model that
foretells them best is too smooth for the bed.

Near the banks a bed is rougher than in the channel: the standard deviation of its relief has a factor there,
one of the parameters. Where a boat keeps off the banks no sounding tells it, and what is usual holds: with
one relief for all, beds of the twin between 0.6 and 0.9 of the half width erred by 1.3 times their sigma. A
variogram by Cressie and Hawkins (1980) is made for the picture alone.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any, Final, NamedTuple, Self

import numpy as np
import shapely
from numpy.typing import ArrayLike
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from thalweg.bathymetry.kriging import (
    KINDS,
    CovarianceModel,
    Observations,
    error_covariance,
    fit_drift,
    krige,
    krige_dense,
)
from thalweg.core import ArrayF, ArrayI, GeometryError
from thalweg.settings.sections import Bathymetry

HalfWidths = Callable[[ArrayLike], tuple[ArrayF, ArrayF]]
"""Gives the distances of the left and the right shore from the centre line at places along it."""

DRIFTS: Final = ("none", "section", "section_width", "fall")
_WIDTHS: Final = 60
_WIDEST_GAP: Final = 0.25
"""A mean cross-section is only taken where data lie across the whole width; in half widths. No sounding
judges the curve in a gap: with gaps of 0.35 beside the banks, beds of the twin erred by twice their sigma."""
_DEGREE: Final = 4
"""Of the mean cross-section over the width."""
_OUTSIDE: Final = 1.2
"""Beyond so many half widths the mean cross-section goes on level."""
MARGIN: Final = 0.7
"""Farther across than this share of the half width is margin."""
_BLEND: Final = 0.1
"""Channel and margin pass into each other over this share to both sides."""
_SHORE_STEPS: Final = 200
"""Places of a shore are so many times nearer to each other than the middle of the lake is to it."""
_TEST: Final = 1200
"""Soundings that are foretold to judge a model, in at most so many left-out lines:"""
_LINES: Final = 32
SHEET_LINE: Final = -1_000_000
"""Lines of the light sheet count down from here; negative lines above it are stretches of the banks."""
_DATA: Final = 1500
"""Soundings that they are foretold from."""
_STEPS: Final = 90
_ALL: Final = 512
"""So few data make each cell all together: no step where neighbours change."""
_NEIGHBOURS: Final = 24
"""Data that a left-out sounding is foretold from while models are compared."""
_BOUNDS: Final = {
    "range": (0.15, 4.0),
    "anisotropy": (1.0, 40.0),
    "sill": (0.05, 20.0),
    "micro": (1e-6, 1.0),
    "margin": (1.0, 4.0),
}
"""Range across in half widths; anisotropy; sill and micro-relief in variances of the heights; margin: a
shoreline is level all along, which would make any bed beside it look smoother than it is, so that no less
than one is believed."""
_USUAL: Final = (1.0, 6.0, 1.0, 1e-3, 1.4)
"""The same, where nothing is known: anisotropies of river beds are published from 2 to 20 (Merwade 2009, J.
Hydrol. 372; the settings of RiverBottomInterpolator, 10 and 20), and a cross-section is one bump. The margins
of the two rivers of RiverBottomInterpolator fit best with 1.7 (29 sections) and 1.2 (15)."""
_FACTORS: Final = (2.5, 2.5, 3.0, 10.0, 2.0)
"""One standard deviation of the logarithm of each."""


_USUAL_BY_SLOPE: Final = (1.0, 2.0)
_BY_SLOPE_FACTORS: Final = (2.0, 3.0)
"""Level of the variance of errors over that of kriging, and its growth with the slope (doubled at a slope of
0.5), each to within a factor."""
_LEAST_LEFT: Final = 4


class Usual(NamedTuple):
    """What is usual of a kind of water: bounds, values and factors of `_BOUNDS`, `_USUAL`, `_FACTORS`."""

    bounds: tuple[tuple[float, float], ...]
    values: tuple[float, ...]
    factors: tuple[float, ...]


RIVER: Final = Usual(tuple(_BOUNDS.values()), _USUAL, _FACTORS)
LAKE: Final = Usual(
    ((0.02, 4.0), (0.5, 20.0), *RIVER.bounds[2:]), (1.0, 1.5, *_USUAL[2:]), (2.5, 2.0, *_FACTORS[2:])
)
"""Of a water with no flow: half of its extent is the half width, nothing makes a direction the longer one."""
_STRIDES: Final = (0.5, 0.7, 0.5, 1.0, 0.3)


@dataclass(frozen=True, slots=True, kw_only=True)
class Across:
    """Where places lie across the river.

    Parameters
    ----------
    s_m : (k,) places along the river where both half widths are known.
    width_m : (k, 2) left and right half width there.
    """

    s_m: tuple[float, ...] = ()
    width_m: tuple[tuple[float, float], ...] = ()

    @classmethod
    def of(cls, data: Observations, half_widths: HalfWidths) -> Self:
        """Along a survey."""
        at = np.linspace(data.s_m.min(), data.s_m.max(), _WIDTHS)
        left, right = half_widths(at)
        known = np.isfinite(left) & np.isfinite(right)
        width = zip(left[known].tolist(), right[known].tolist(), strict=True)
        return cls(s_m=tuple(at[known].tolist()), width_m=tuple(width))

    def at(self, places_m: ArrayF) -> ArrayF:
        """Place (m,) across the river: -1 at the right bank, 1 at the left one; 0 if no banks are known."""
        if len(self.s_m) < 2:
            return np.zeros(len(places_m))
        left, right = self._at(places_m[:, 0])
        n = places_m[:, 1]
        return np.asarray(np.clip(n / np.where(n > 0, left, right), -_OUTSIDE, _OUTSIDE))

    def _at(self, s_m: ArrayF) -> tuple[ArrayF, ArrayF]:
        width = np.array(self.width_m)
        return np.interp(s_m, self.s_m, width[:, 0]), np.interp(s_m, self.s_m, width[:, 1])

    def narrowness(self, s_m: ArrayF) -> ArrayF:
        """Logarithm of the usual width over the width (m,), which is the mean over a width along the river.

        Bays of the shore that are shorter than the river is wide tell nothing of its depth.
        """
        if len(self.s_m) < 2:
            return np.zeros(len(s_m))
        width = np.array(self.width_m).sum(axis=1)
        usual = float(np.exp(np.mean(np.log(width))))
        apart = (np.asarray(s_m)[:, None] - np.array(self.s_m)) / (usual / 2)
        weight = np.exp(-(apart**2) / 2)
        # beyond the ends the last width goes on
        weight[np.arange(len(weight)), np.abs(apart).argmin(axis=1)] += 1e-12
        return np.asarray(-(weight @ np.log(width / usual)) / weight.sum(axis=1))

    def margin(self, places_m: ArrayF) -> ArrayF:
        """How much of the margin (m,) a place is: 0 in the channel, 1 near the banks."""
        rise = (np.abs(self.at(places_m)) - MARGIN + _BLEND) / (2 * _BLEND)
        return np.clip(rise, 0.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Basin(Across):
    """Where places lie between the shores and the middle of a lake.

    Parameters
    ----------
    wkt : polygon of the water in coordinates of kriging; empty: no shore is known.
    radius_m : distance of its middle from the shores.
    """

    wkt: str = ""
    radius_m: float = 0.0

    def at(self, places_m: ArrayF) -> ArrayF:
        """Place (m,) between middle and shore: 0 as far from all shores as can be, 1 on them and beyond."""
        if not self.wkt:
            return np.zeros(len(places_m))
        area, shores = _shores(self.wkt, self.radius_m / _SHORE_STEPS)
        far = shores.query(places_m)[0] * shapely.contains_xy(area, places_m)
        return np.asarray(1.0 - np.minimum(far / self.radius_m, 1.0))


@cache
def _shores(wkt: str, step_m: float) -> tuple[Any, Any]:
    """A prepared polygon, and a tree of places on its boundary: asked for the same data again and again."""
    area = shapely.from_wkt(wkt)
    shapely.prepare(area)
    return area, cKDTree(shapely.get_coordinates(shapely.segmentize(area.boundary, step_m)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """What is removed before kriging, besides a mean.

    Parameters
    ----------
    kind : one of `DRIFTS`.
    across : of the river, or of the lake.
    coefficients : of q, q^2, q^3, q^4 with q = n over half width (section); of these, of the narrowness N and
        of N (1 - q^2) (section_width): a river is deeper where it is narrower, because the same water must
        pass; of s (fall).
    cov : of the coefficients; empty: they count as true.
    s0_m : where s counts from.
    """

    kind: str
    across: Across = Across()
    coefficients: tuple[float, ...] = ()
    cov: tuple[tuple[float, ...], ...] = ()
    s0_m: float = 0.0

    @classmethod
    def fitted(cls, kind: str, data: Observations, across: Across) -> Self:
        """By least squares, all heights alike: where the covariance is not known yet.

        Raises
        ------
        GeometryError : the drift ``section`` or ``section_width`` without banks on both sides.
        """
        basin = isinstance(across, Basin) and across.wkt and kind == "section"
        if kind.startswith("section") and not basin and len(across.s_m) < 2:
            raise GeometryError(
                f"no half widths for the drift {kind}",
                expected="both banks along the survey; for a mean section of a lake its outline",
            )
        bare = cls(kind=kind, across=across, s0_m=float(data.s_m.mean()))
        rows = np.column_stack([np.ones(len(data)), bare.functions(data.places_m)])
        value = np.linalg.lstsq(rows, data.height_m - data.height_m.mean(), rcond=None)[0]
        return replace(bare, coefficients=tuple(value[1:].tolist()))

    def at(self, places_m: ArrayF) -> ArrayF:
        """Height (m,) at flow coordinates (m, 2)."""
        return np.asarray(self.functions(places_m) @ np.array(self.coefficients))

    def functions(self, places_m: ArrayF) -> ArrayF:
        """What the coefficients belong to (m, p)."""
        if self.kind == "none":
            return np.empty((len(places_m), 0))
        if self.kind == "fall":
            return np.asarray(places_m)[:, :1] - self.s0_m
        q = self.across.at(places_m)
        section = q[:, None] ** np.arange(1, _DEGREE + 1)
        if self.kind == "section":
            return np.asarray(section)
        narrow = self.across.narrowness(np.asarray(places_m)[:, 0])
        return np.column_stack([section, narrow, narrow * np.maximum(1 - q**2, 0.0)])


@dataclass(frozen=True, slots=True, kw_only=True)
class BedModel:
    """Drift and covariance of a bed, and how they were found.

    Parameters
    ----------
    drift, covariance : see there.
    margin : factor on the standard deviation of the relief near the banks.
    score : mean negative log density of left-out soundings; NaN if nothing was compared.
    compared : score by drift and model.
    reason : in a sentence.
    of_line : at most so many soundings of one line make a cell; 0: any.
    level, per_slope : variances of errors are level (1 + (per_slope slope)^2) times those of kriging.
    """

    drift: Drift
    covariance: CovarianceModel
    margin: float = 1.0
    score: float = np.nan
    compared: dict[str, float]
    reason: str
    of_line: int = 0
    level: float = 1.0
    per_slope: float = 0.0

    def fitted_to(self, data: Observations) -> Self:
        """The same covariance with the drift of other data, and its errors."""
        if self.drift.kind == "none":
            return self
        functions = self.drift.functions(data.places_m)
        value, cov = fit_drift(data, functions, self.covariance, self.roughness(data.places_m))
        rows = tuple(tuple(row) for row in cov.tolist())
        return replace(self, drift=replace(self.drift, coefficients=tuple(value.tolist()), cov=rows))

    def roughness(self, places_m: ArrayF) -> ArrayF:
        """Factor (m,) on the standard deviation of the relief at flow coordinates (m, 2)."""
        return np.asarray(1.0 + (self.margin - 1.0) * self.drift.across.margin(np.asarray(places_m)))

    def predict(self, data: Observations, places_m: ArrayF, *, neighbours: int) -> tuple[ArrayF, ArrayF]:
        """Height and standard deviation (m,) of the bed at flow coordinates (m, 2)."""
        there = np.asarray(places_m, dtype=np.float64)
        rest = data.lifted(data.height_m - self.drift.at(data.places_m))
        functions = (self.drift.functions(data.places_m), self.drift.functions(there))
        roughness = (self.roughness(data.places_m), self.roughness(there))
        if len(data) <= _ALL:
            of = functions if self.drift.cov else None
            height, sigma = krige_dense(rest, there, self.covariance, roughness=roughness, functions=of)
        else:
            height, sigma = krige(
                rest,
                there,
                self.covariance,
                roughness=roughness,
                drift=(*functions, np.array(self.drift.cov)) if self.drift.cov else None,
                neighbours=neighbours,
                of_line=self.of_line,
            )
        return height + self.drift.at(there), sigma

    def steepened(self, sigma_m: ArrayF, slope: ArrayF) -> ArrayF:
        """Standard deviations (m,) where the bed has slopes (m,), of those of kriging."""
        return sigma_m * np.sqrt(self.level * (1 + (self.per_slope * slope) ** 2))

    def predict_slope(
        self, data: Observations, places_m: ArrayF, *, neighbours: int, step_m: float
    ) -> tuple[ArrayF, ArrayF, ArrayF]:
        """Height and standard deviation of `predict`, and the slope (m,) from places a step beside."""
        beside = places_m + step_m * np.array([[[0.0, 0.0]], [[1.0, 0.0]], [[0.0, 1.0]]])
        height, sigma = self.predict(data, beside.reshape(-1, 2), neighbours=neighbours)
        height = height.reshape(3, -1)
        return height[0], sigma[: len(places_m)], np.hypot(*(height[1:] - height[0])) / step_m

    def error_covariance(self, data: Observations, places_m: ArrayF) -> ArrayF:
        """Covariance (m, m) of the errors of what `predict` says with all data as neighbours."""
        functions = (self.drift.functions(data.places_m), self.drift.functions(places_m))
        return error_covariance(
            data,
            places_m,
            self.covariance,
            roughness=(self.roughness(data.places_m), self.roughness(places_m)),
            drift=(*functions, np.array(self.drift.cov)) if self.drift.cov else None,
        )

    def own_variance(self, there: Observations) -> ArrayF:
        """What sounded heights (n,) have of their own, besides the bed's: errors and small relief."""
        relief = self.covariance.micro_m2 * self.roughness(there.places_m) ** 2
        return np.asarray(there.sigma_white_m**2 + there.sigma_slow_m**2 + relief)

    def report(self) -> dict[str, Any]:
        """For ``variogram.json``."""
        return asdict(self)

    @classmethod
    def of_report(cls, report: dict[str, Any]) -> Self:
        """Of what `report` gave."""
        drift: dict[str, Any] = dict(report["drift"])
        across = drift["across"]
        across |= {"s_m": tuple(across["s_m"]), "width_m": tuple(map(tuple, across["width_m"]))}
        drift["across"] = Basin(**across) if "wkt" in across else Across(**across)
        drift["coefficients"] = tuple(drift["coefficients"])
        drift["cov"] = tuple(map(tuple, drift["cov"]))
        values: dict[str, Any] = {name: report[name] for name in cls.__dataclass_fields__ if name in report}
        values |= {"drift": Drift(**drift), "covariance": CovarianceModel(**report["covariance"])}
        return cls(**values)


def choose_model(
    data: Observations,
    half_widths: HalfWidths,
    settings: Bathymetry,
    *,
    slow_time_s: float,
    seed: int,
    basin: Basin | None = None,
) -> BedModel:
    """The drift and the covariance that foretell left-out lines best.

    Parameters
    ----------
    data : soundings, which judge, and banks and points of the light sheet, which only help to foretell.
    half_widths : of the river.
    settings : what is stated.
    slow_time_s : correlation time of errors that last.
    seed : of the choice of lines and soundings, where there are many.
    basin : of a lake; None: a river.

    Raises
    ------
    GeometryError : all soundings are of one line: nothing tells how the bed varies beside it.
    """
    rng = np.random.default_rng(seed)
    lines = np.unique(data.line[data.line >= 0])
    if len(lines) < 2:
        raise GeometryError(
            f"{len(lines)} line of soundings",
            where="lines of soundings",
            expected="at least two: what lies beside a single line cannot be told",
            cure="Survey a zigzag or sections; if lines run together, tell them apart by "
            "bathymetry.line_turn_deg; "
            "a table may be mapped with --coordinates map, as if the bed were as smooth across as along",
        )
    test, train = _thinned(data, lines, rng)
    half = _typical_half_width(data, half_widths)
    across = Across.of(data, half_widths) if basin is None else basin
    share = across.margin(data.places_m)
    # without banks nothing is margin
    margin = settings.margin_roughness or (None if share.any() else 1.0)
    known = bool(np.isfinite(half_widths(data.s_m)[0]).any() and np.isfinite(half_widths(data.s_m)[1]).any())
    covered = known and len(across.s_m) > 1 and _widest_gap(data, half_widths) <= _WIDEST_GAP
    drifts = [d for d in DRIFTS if covered or not d.startswith("section")]
    if basin is not None and basin.wkt and np.diff(np.sort(basin.at(data.places_m))).max() <= _WIDEST_GAP:
        drifts.append("section")
    drifts = drifts if settings.drift == "auto" else [settings.drift]
    kinds = KINDS if settings.model == "auto" else (settings.model,)
    compared: dict[str, float] = {}
    best: BedModel | None = None
    tried: list[tuple[str, str, ArrayF | None]] = [(kinds[0], drift, None) for drift in drifts]
    while tried:
        kind, drift_kind, start = tried.pop(0)
        drift = Drift.fitted(drift_kind, data, across)
        rest = data.lifted(data.height_m - drift.at(data.places_m))
        parts = _left_out(data, share, test, train, drift)
        found, rough, score = _fitted(
            rest, parts, kind, half, slow_time_s, start, margin, RIVER if basin is None else LAKE
        )
        compared[f"{drift_kind}, {kind}"] = score
        if best is None or score < best.score:
            best = BedModel(
                drift=drift, covariance=found, margin=rough, score=score, compared=compared, reason=""
            )
        if not tried and len(compared) == len(drifts) and len(kinds) > 1:
            tried = [(k, best.drift.kind, _parameters(best, half, rest)) for k in kinds[1:]]
    assert best is not None
    best = best.fitted_to(data)
    # The nearest soundings may all be of one or two lines. Whether a line may make at most a quarter of a
    # cell, so that four lines do, is judged in the same way, with as many neighbours as a cell will have.
    parts = _left_out(data, share, test, train, best.drift)
    quarter = max(settings.neighbours // 4, 1)
    any_line, four_lines = (
        _score(best.covariance, best.margin, parts, neighbours=settings.neighbours, of_line=k, candidates=256)
        for k in (0, quarter)
    )
    of_margins = f", relief of the margins {best.margin:.2f} times the channel's" if margin is None else ""
    if four_lines < any_line:
        best = replace(best, of_line=quarter)
    level, per_slope = _by_slope(best, data, test, settings)
    best = replace(best, level=level, per_slope=per_slope)
    second = sorted(compared.values())[1] if len(compared) > 1 else np.nan
    reason = (
        f"drift {best.drift.kind}, model {best.covariance.kind}"
        f"{', at most a quarter of a cell from one line' if best.of_line else ''}{of_margins}: mean log "
        f"score of left-out lines {best.score:.3f}, the next best {second:.3f} (smaller is better)"
        if len(compared) > 1
        else "drift and model as stated; ranges by the log score of left-out lines"
    )
    return replace(best, reason=reason)


def _widest_gap(data: Observations, half_widths: HalfWidths) -> float:
    """Widest part of the cross-section without data, in half widths."""
    left, right = half_widths(data.s_m)
    q = np.sort(data.n_m / np.where(data.n_m > 0, left, right))
    q = np.concatenate([[-1.0], q[np.isfinite(q) & (np.abs(q) < 1)], [1.0]])
    return float(np.diff(q).max())


def _thinned(data: Observations, lines: ArrayI, rng: np.random.Generator) -> tuple[list[ArrayI], ArrayI]:
    """Soundings to foretell, by left-out line, and data that they are foretold from."""
    chosen = rng.choice(lines, min(_LINES, len(lines)), replace=False)
    test = []
    for line in np.sort(chosen).tolist():
        of = np.flatnonzero(data.line == line)
        test.append(of[:: max(1, _ceil_of(len(of) * len(chosen), _TEST))])
    train = np.arange(len(data))
    if len(data) > _DATA:
        keep = np.zeros(len(data), dtype=np.bool_)
        keep[:: _ceil_of(len(data), _DATA)] = True
        train = np.flatnonzero(keep)
    return test, train


def _ceil_of(a: int, b: int) -> int:
    """Quotient of two whole numbers, rounded up."""
    return -(-a // b)


def _typical_half_width(data: Observations, half_widths: HalfWidths) -> float:
    left, right = half_widths(data.s_m)
    width = np.nanmedian(left + right) / 2 if np.isfinite(left + right).any() else np.nan
    return float(width) if np.isfinite(width) else max(float(np.ptp(data.n_m)) / 2, 1.0)


_Part = tuple[Observations, Observations, ArrayF, ArrayF]
"""What is known without a left-out line, what is foretold of it, and how much of the margin either is."""


def _fitted(
    rest: Observations,
    parts: list[_Part],
    kind: str,
    half_m: float,
    slow_time_s: float,
    start: ArrayF | None,
    margin: float | None,
    of: Usual,
) -> tuple[CovarianceModel, float, float]:
    """Parameters of a model with the best score, the factor of the margin, and the score."""
    variance = max(float(rest.height_m.var()), 1e-6)
    n = len(of.values) if margin is None else len(of.values) - 1
    low, high = np.log(of.bounds)[:n].T
    usual, spread = np.log(of.values)[:n], np.log(of.factors)[:n]

    def model_of(q: ArrayF) -> tuple[CovarianceModel, float]:
        """Covariance and margin of logarithms of range, anisotropy, sill, micro-relief and margin."""
        across, stretch, sill, micro, *rough = np.exp(np.clip(q, low, high))
        found = CovarianceModel(
            kind=kind,
            sill_m2=sill * variance,
            range_s_m=across * half_m * stretch,
            range_n_m=across * half_m,
            micro_m2=micro * variance,
            slow_time_s=slow_time_s,
        )
        return found, float(rough[0]) if margin is None else margin

    def score(q: ArrayF) -> float:
        """Log score and what is usual; worse beyond the bounds."""
        outside = float(np.sum(np.maximum(low - q, 0) + np.maximum(q - high, 0)))
        unusual = float(np.sum(((q - usual) / spread) ** 2)) / (2 * len(parts))
        return _score(*model_of(q), parts) + unusual + outside

    first = (usual if start is None else start)[:n]
    simplex = np.vstack([first, first + np.diag(_STRIDES[:n])])
    found = minimize(
        score,
        first,
        method="Nelder-Mead",
        options={"maxiter": _STEPS, "xatol": 0.05, "fatol": 1e-3, "initial_simplex": simplex},
    )
    return *model_of(found.x), float(found.fun)


def _left_out(
    data: Observations, share: ArrayF, test: list[ArrayI], train: ArrayI, drift: Drift
) -> list[_Part]:
    """By left-out line, its drift removed: that of all other data."""
    out = []
    for of in test:
        if len(of):
            others = data.line != data.line[of[0]]
            known = train[others[train]]
            again = Drift.fitted(drift.kind, data.where(others), drift.across)
            rest = data.lifted(data.height_m - again.at(data.places_m))
            out.append((rest.where(known), rest.where(of), share[known], share[of]))
    return out


def _score(
    model: CovarianceModel,
    margin: float,
    parts: list[_Part],
    *,
    neighbours: int = _NEIGHBOURS,
    of_line: int = 0,
    candidates: int = 96,
) -> float:
    """Mean negative log density of what was left out."""
    total, n = 0.0, 0
    for known, left_out, share, share_there in parts:
        g, g_there = 1 + (margin - 1) * share, 1 + (margin - 1) * share_there
        height, sigma = krige(
            known,
            left_out.places_m,
            model,
            roughness=(g, g_there),
            neighbours=neighbours,
            of_line=of_line,
            candidates=candidates,
        )
        var = sigma**2 + g_there**2 * model.micro_m2 + left_out.sigma_white_m**2 + left_out.sigma_slow_m**2
        total += float(np.sum(np.log(var) / 2 + (left_out.height_m - height) ** 2 / (2 * var)))
        n += len(left_out)
    return total / n if np.isfinite(total) else 1e6


def _by_slope(
    model: BedModel, data: Observations, test: list[ArrayI], settings: Bathymetry
) -> tuple[float, float]:
    """Level of the errors of left-out lines and growth with the slope: most probable, with what is usual.

    One covariance for all of a bed knows neither that a steep part is rougher than a level one, nor that
    places that are a little wrong make heights wrong there. It has been fitted to steep and level parts
    alike: growth alone would count the steep ones twice.
    """
    square, slope = [], []
    for of in test:
        others = data.where(data.line != data.line[of[0]]) if len(of) else data
        if len(of) and len(others) >= _LEAST_LEFT:
            there = data.where(of)
            height, sigma, steep = model.fitted_to(others).predict_slope(
                others, there.places_m, neighbours=settings.neighbours, step_m=settings.cell_m
            )
            square.append((there.height_m - height) ** 2 / (sigma**2 + model.own_variance(there)))
            slope.append(steep)
    if not square:
        return 1.0, 0.0
    z2, s2 = np.concatenate(square), np.concatenate(slope) ** 2
    known = np.isfinite(z2) & np.isfinite(s2)
    usual, spread = np.log(_USUAL_BY_SLOPE), np.log(_BY_SLOPE_FACTORS)

    def cost(x: ArrayF) -> float:
        """Mean negative log density, and what is usual."""
        factor = np.exp(x[0]) * (1 + np.exp(2 * x[1]) * s2[known])
        unusual = np.sum(((x - usual) / spread) ** 2) / (2 * len(square))
        return float(np.mean(np.log(factor) + z2[known] / factor) / 2 + unusual)

    level, per_slope = np.exp(minimize(cost, usual, method="Nelder-Mead").x).tolist()
    return level, per_slope


def _parameters(model: BedModel, half_m: float, rest: Observations) -> ArrayF:
    """Where the fit of another kind begins."""
    variance, of = max(float(rest.height_m.var()), 1e-6), model.covariance
    return np.log(
        [
            of.range_n_m / half_m,
            of.range_s_m / of.range_n_m,
            of.sill_m2 / variance,
            max(of.micro_m2 / variance, 1e-6),
            model.margin,
        ]
    )
