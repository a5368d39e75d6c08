"""Distances of a scan from a reference: predicted sigmas, outlier rules, shape and modes (P4 7.2, 7.3).

Points whose nearest place is on a border of the mesh are left out: there the distance says where the mesh
ends, at a hole that a marker left, and not where the surface is. Points farther than a limit lie on
something that is not part of the reference, such as the ground around the object.

**Outlier rules**, always with the numbers on both sides (P4 Tables 2 and 3). P4 takes the standard deviation
of all distances, leaves out what is farther than three of them, and states the standard deviation of the
rest. That rule depends on the outliers it removes: with some large ones the limit is wide (2.24 mm, where the
rest has 0.22 mm), and with none it still cuts 0.3 % of normal errors. The robust rule takes 1.4826 times the
median absolute deviation instead.

**Modes** (P4 7.2, Fig. 16, 19 d, 20 d). White markers on a black object saturate; with light that spreads to
one side the line is then measured beside its place, and the histogram of distances has two peaks. Two tests
that know nothing of each other:

* two normal distributions with one standard deviation against one, by Schwarz's criterion, with Ashman's
  distance ``D = |m_1 - m_2| / sigma`` between them (below 2 a sum of two normal densities has one peak);
* the mean distance of bright points less that of dark ones, parted by the brightness alone
  (saturated or not, or by Otsu's threshold, 1979).

Neighbouring points share the pixels of their patches: both count ``n * independent_share`` points.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Literal

import numpy as np
import pandas as pd

from thalweg.core import AnyArray, ArrayB, ArrayF, GeometryError, robust_sigma, root_mean_square
from thalweg.lightsheet.poses import M_PER_MM
from thalweg.lightsheet.scanning.profile import ScanCloud
from thalweg.surface import Surface

MAX_DISTANCE_MM: Final = 3.0


Rule = Literal["3 sigma", "3 sigma repeated", "robust"]
RULES: Final[tuple[Rule, ...]] = ("3 sigma", "3 sigma repeated", "robust")

TABLE_2: Final = pd.DataFrame(
    [("stepped_object", 1, 1461, 0.75, 2.24, 1448, 0.22), ("wreck", 1, 1105, 0.38, 1.15, 1105, 0.38)],
    columns=["object", "lines", "n", "std_mm", "limit_mm", "n_kept", "std_kept_mm"],
)
"""P4 Table 2, single profiles."""

TABLE_3: Final = pd.DataFrame(
    [("stepped_object", 7, 4656, 0.3, 0.9, 4587, 0.20), ("wreck", 70, 66666, 0.4, 1.2, 65987, 0.29)],
    columns=["object", "lines", "n", "std_mm", "limit_mm", "n_kept", "std_kept_mm"],
)
"""P4 Table 3, scans."""

_REPEATS: Final = 50

CLEAR_BIC: Final = 10.0
"""Difference of the criterion that counts as very strong (Kass and Raftery 1995)."""

ASHMAN: Final = 2.0
_SIGNIFICANT: Final = 4.0
_TURNS: Final = 500
_LEAST_SHARE: Final = 0.02
"""A mode of less than that share of the points is a group of outliers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshDistances:
    """Distances of the points of a cloud, in its order.

    ``distance_mm`` (n,) positive in front of the mesh; ``normal`` (n, 3) of the mesh at the nearest place;
    ``sigma_mm`` (n,) predicted along that normal, reference included; ``sigma_own_mm``, ``sigma_pose_mm``,
    ``sigma_shared_mm``, ``sigma_reference_mm`` (n,) its parts; ``at_border``, ``far`` (n,) why a point is
    not ``used``.
    """

    distance_mm: ArrayF
    normal: ArrayF
    sigma_own_mm: ArrayF
    sigma_pose_mm: ArrayF
    sigma_shared_mm: ArrayF
    sigma_reference_mm: ArrayF
    at_border: ArrayB
    far: ArrayB

    @property
    def used(self) -> ArrayB:
        """(n,) points that have a counterpart."""
        return ~self.at_border & ~self.far

    @property
    def sigma_mm(self) -> ArrayF:
        """(n,) predicted standard deviation of the distance."""
        parts = (self.sigma_own_mm, self.sigma_pose_mm, self.sigma_shared_mm, self.sigma_reference_mm)
        return np.sqrt(np.sum(np.square(parts), axis=0))

    def counts(self) -> dict[str, int]:
        """What became of the points; the numbers add up."""
        return {
            "points": len(self.distance_mm),
            "far": int(self.far.sum()),
            "at_border": int((self.at_border & ~self.far).sum()),
            "used": int(self.used.sum()),
        }

    def with_shared(self, sigma_shared_mm: ArrayF) -> "MeshDistances":
        """The same distances with other shared sigmas, as after an alignment."""
        return replace(self, sigma_shared_mm=sigma_shared_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class Filtered:
    """Distances before and after an outlier rule.

    ``n``, ``mean_mm``, ``std_mm``, ``nmad_mm`` of all; ``limit_mm`` half width of the rule about its
    ``centre_mm``; ``n_kept``, ``mean_kept_mm``, ``std_kept_mm`` of what is left; ``kept`` (n,).
    """

    rule: Rule
    n: int
    mean_mm: float
    std_mm: float
    nmad_mm: float
    centre_mm: float
    limit_mm: float
    n_kept: int
    mean_kept_mm: float
    std_kept_mm: float
    kept: ArrayB

    def row(self) -> dict[str, Any]:
        """Everything but the mask, for tables."""
        out = asdict(self)
        del out["kept"]
        out["share_kept"] = self.n_kept / self.n
        return out


@dataclass(frozen=True, slots=True, kw_only=True)
class Bimodality:
    """Result of `bimodality`.

    ``modes_mm`` (2,) means of both modes, ``shares`` (2,), ``sigma_mm`` of each; ``ashman`` their distance in
    sigmas; ``bic_gain`` by which two modes are better than one; ``bimodal`` verdict of the shapes alone.
    ``shift_mm`` of bright against dark points, ``sigma_shift_mm``, ``threshold_dn`` that parts them (NaN if
    they were given), ``by_brightness`` whether the shift is clear; ``n`` points without
    gross outliers.
    """

    n: int
    modes_mm: tuple[float, float]
    shares: tuple[float, float]
    sigma_mm: float
    ashman: float
    bic_gain: float
    bimodal: bool
    shift_mm: float
    sigma_shift_mm: float
    threshold_dn: float
    by_brightness: bool

    def words(self) -> str:
        """One sentence for a report."""
        shape = (
            f"two modes at {self.modes_mm[0]:+.2f} and {self.modes_mm[1]:+.2f} mm, "
            f"{self.ashman:.1f} sigmas apart"
            if self.bimodal
            else f"one mode (Ashman's D {self.ashman:.1f}, gain of Schwarz's criterion {self.bic_gain:.0f})"
        )
        verdict = "clear" if self.by_brightness else "not significant"
        return (
            f"{shape}; bright points lie {self.shift_mm:+.3f} mm (sigma {self.sigma_shift_mm:.3f}) from dark "
            f"ones: {verdict}"
        )


def mesh_distances(
    cloud: ScanCloud, surface: Surface, *, max_distance_mm: float = MAX_DISTANCE_MM
) -> MeshDistances:
    """Signed distances of all points of a scan from a mesh in the same frame.

    Parameters
    ----------
    cloud, surface : in one frame, metres.
    max_distance_mm : points farther away are not part of the reference.
    """
    found = surface.distances(cloud.xyz_m)
    own, pose, shared = cloud.variances_along(found.normal)
    distance = found.distance_m / M_PER_MM
    known = found.normal.any(axis=1)
    return MeshDistances(
        distance_mm=distance,
        normal=found.normal,
        sigma_own_mm=np.sqrt(own) / M_PER_MM,
        sigma_pose_mm=np.sqrt(pose) / M_PER_MM,
        sigma_shared_mm=np.sqrt(shared) / M_PER_MM,
        sigma_reference_mm=found.sigma_m / M_PER_MM,
        at_border=found.at_border | ~known,
        far=np.abs(distance) > max_distance_mm,
    )


def border_effect(found: MeshDistances) -> dict[str, float]:
    """Mean and standard deviation with and without the points at the mesh's border.

    Raises
    ------
    GeometryError : no point is left without them.
    """
    near = ~found.far
    inner, border = found.distance_mm[found.used], found.distance_mm[near & found.at_border]
    if len(inner) < 2:
        raise GeometryError(f"{len(inner)} points off the border of the mesh", expected="at least two")
    with_border = found.distance_mm[near]
    return {
        "n_border": float(len(border)),
        "n": float(len(inner)),
        "mean_border_mm": float(border.mean()) if len(border) else float("nan"),
        "mean_mm": float(inner.mean()),
        "std_mm": float(inner.std(ddof=1)),
        "mean_with_border_mm": float(with_border.mean()),
        "std_with_border_mm": float(with_border.std(ddof=1)),
    }


def normality(distance_mm: ArrayF, independent_share: float = 1.0) -> dict[str, float]:
    """Shape of distances: skewness and excess of kurtosis, each over its sigma for that many free points.

    P4 7.2 calls the wreck's distances normally distributed, with a histogram that the registration shifts.
    """
    d = np.asarray(distance_mm, dtype=np.float64)
    z = (d - d.mean()) / d.std()
    n = max(len(d) * independent_share, 8.0)
    skewness, excess = float((z**3).mean()), float((z**4).mean() - 3.0)
    return {
        "mean_mm": float(d.mean()),
        "std_mm": float(d.std(ddof=1)),
        "nmad_mm": robust_sigma(d),
        "skewness": skewness,
        "excess": excess,
        "skewness_sigmas": skewness / float(np.sqrt(6.0 / n)),
        "excess_sigmas": excess / float(np.sqrt(24.0 / n)),
    }


def consistency(distance_mm: ArrayF, sigma_mm: ArrayF, keep: AnyArray) -> dict[str, Any]:
    """Observed against predicted: RMS of the distances, of their sigmas, and of their ratio."""
    d, s = distance_mm[keep], sigma_mm[keep]
    return {
        "n": len(d),
        "rms_mm": root_mean_square(d),
        "predicted_mm": root_mean_square(s),
        "rms_over_sigma": root_mean_square(d / s),
    }


def filtered(distance_mm: ArrayF, rule: Rule = "3 sigma", *, factor: float = 3.0) -> Filtered:
    """Apply an outlier rule.

    Parameters
    ----------
    distance_mm : (n,) signed distances from a reference.
    rule : ``3 sigma`` once about the mean, as P4 does; ``3 sigma repeated`` until nothing changes; ``robust``
        about the median with 1.4826 times the median absolute deviation.
    factor : width of the rule.

    Raises
    ------
    GeometryError : fewer than three distances, or some that are not finite.

    Examples
    --------
    >>> errors = np.r_[np.tile([-0.2, 0.2], 200), 8.0]
    >>> once = filtered(errors)
    >>> round(once.std_mm, 2), round(once.limit_mm, 2), once.n_kept, round(once.std_kept_mm, 2)
    (0.45, 1.34, 400, 0.2)
    """
    d = np.asarray(distance_mm, dtype=np.float64)
    if d.ndim != 1 or len(d) < 3 or not np.isfinite(d).all():
        raise GeometryError(
            f"{len(d)} distances, {int((~np.isfinite(d)).sum())} of them not finite",
            expected="at least three finite ones",
            where="outlier rule",
        )
    median = float(np.median(d))
    nmad = robust_sigma(d, median)
    kept = np.ones(len(d), dtype=np.bool_)
    if rule == "robust":
        centre, limit = median, factor * nmad
        kept = np.abs(d - centre) <= limit
    else:
        centre, limit = float(d.mean()), factor * float(d.std(ddof=1))
        for _ in range(_REPEATS if rule == "3 sigma repeated" else 1):
            inside = np.abs(d - centre) <= limit
            if np.array_equal(inside, kept):
                break
            kept = inside
            if rule == "3 sigma repeated":
                centre, limit = float(d[kept].mean()), factor * float(d[kept].std(ddof=1))
    left = d[kept]
    return Filtered(
        rule=rule,
        n=len(d),
        mean_mm=float(d.mean()),
        std_mm=float(d.std(ddof=1)),
        nmad_mm=nmad,
        centre_mm=centre,
        limit_mm=limit,
        n_kept=len(left),
        mean_kept_mm=float(left.mean()),
        std_kept_mm=float(left.std(ddof=1)) if len(left) > 1 else 0.0,
        kept=kept,
    )


def bimodality(
    distance_mm: ArrayF, peak_dn: ArrayF, *, bright: ArrayB | None = None, independent_share: float = 1.0
) -> Bimodality:
    """Test distances for two modes, and for a shift between bright and dark points.

    Parameters
    ----------
    distance_mm, peak_dn : (n,) signed distances, and height of the line above its background.
    bright : (n,) which points are bright, such as those with saturated pixels; None: parted by ``peak_dn``.
    independent_share : independent points per point, see `profile.independent_share`.

    Raises
    ------
    GeometryError : fewer than 20 points.
    """
    d, peak = np.asarray(distance_mm, dtype=np.float64), np.asarray(peak_dn, dtype=np.float64)
    if len(d) < 20 or d.shape != peak.shape:
        raise GeometryError(f"{len(d)} distances and {len(peak)} brightnesses", expected="20 or more of both")
    # gross outliers would become a mode of their own; two modes do not make each other outliers of 6 NMAD
    kept = filtered(d, "robust", factor=6.0).kept
    d, peak = d[kept], peak[kept]
    n_free = max(len(d) * independent_share, 4.0)
    means, shares, sigma = _two_normals(d)
    one = -0.5 * np.log(2 * np.pi * d.var()) - 0.5
    z = (d[:, None] - means) / sigma
    density = (shares * np.exp(-0.5 * z**2)).sum(axis=1) / (np.sqrt(2 * np.pi) * sigma)
    gain = 2.0 * n_free * (float(np.log(np.maximum(density, 1e-300)).mean()) - float(one)) - 2.0 * np.log(
        n_free
    )
    ashman = float(abs(means[1] - means[0]) / sigma)
    threshold, above = otsu(peak)
    if bright is not None:
        above, threshold = np.asarray(bright, dtype=np.bool_)[kept], float("nan")
    shift, sigma_shift = _shift(d, above, independent_share)
    return Bimodality(
        n=len(d),
        modes_mm=(float(means[0]), float(means[1])),
        shares=(float(shares[0]), float(shares[1])),
        sigma_mm=float(sigma),
        ashman=ashman,
        bic_gain=float(gain),
        bimodal=bool(gain > CLEAR_BIC and ashman > ASHMAN and shares.min() > _LEAST_SHARE),
        shift_mm=shift,
        sigma_shift_mm=sigma_shift,
        threshold_dn=threshold,
        by_brightness=bool(sigma_shift > 0 and abs(shift) > _SIGNIFICANT * sigma_shift),
    )


def otsu(values: ArrayF) -> tuple[float, ArrayB]:
    """Threshold between two classes of positive values by their logarithm, and which are above (n,)."""
    x = np.log(np.maximum(np.asarray(values, dtype=np.float64), 1e-3))
    order = np.sort(x)
    n = np.arange(1, len(x))
    total = np.cumsum(order)
    low, high = total[:-1] / n, (total[-1] - total[:-1]) / (len(x) - n)
    between = n * (len(x) - n) * (high - low) ** 2
    k = int(np.argmax(between)) if len(x) > 1 else 0
    cut = float(0.5 * (order[k] + order[min(k + 1, len(x) - 1)]))
    return float(np.exp(cut)), x > cut


def _two_normals(d: ArrayF) -> tuple[ArrayF, ArrayF, float]:
    """Means, shares and common standard deviation of two normals, by expectation maximisation."""
    best: tuple[float, ArrayF, ArrayF, float] | None = None
    for low, high in ((5.0, 60.0), (25.0, 75.0), (40.0, 95.0)):
        means, shares = np.percentile(d, [low, high]), np.array([0.5, 0.5])
        sigma = max(float(d.std()) / 2, 1e-9)
        last = -np.inf
        for _ in range(_TURNS):
            z = (d[:, None] - means) / sigma
            weight = shares * np.exp(-0.5 * z**2) + 1e-300
            level = float(np.log(weight.sum(axis=1)).mean() - np.log(sigma))
            weight /= weight.sum(axis=1, keepdims=True)
            count = weight.sum(axis=0) + 1e-300
            means, shares = (weight * d[:, None]).sum(axis=0) / count, count / len(d)
            sigma = max(float(np.sqrt((weight * (d[:, None] - means) ** 2).sum() / len(d))), 1e-9)
            if level - last < 1e-9:
                break
            last = level
        if best is None or last > best[0]:
            best = (last, means, shares, sigma)
    assert best is not None
    order = np.argsort(best[1])
    return best[1][order], best[2][order], best[3]


def _shift(d: ArrayF, bright: ArrayB, share: float) -> tuple[float, float]:
    """Mean of bright less mean of dark distances, and its standard deviation."""
    if min(bright.sum(), (~bright).sum()) < 3:
        return float("nan"), 0.0
    parts = [d[bright], d[~bright]]
    variance = sum(float(p.var(ddof=1)) / max(len(p) * share, 1.0) for p in parts)
    return float(parts[0].mean() - parts[1].mean()), float(np.sqrt(variance))
