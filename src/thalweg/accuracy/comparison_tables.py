"""Statistics of cloud-to-mesh distances, observed against predicted: in all, and by range (P2 eq. 10).

Ratios are predicted over observed RMSE: above 1 the points are better than their sigmas say. Consistent
sigmas leave a ratio inside its band with a probability of 95 % or more
(`thalweg.accuracy.comparison_tables` says why).
Of 40 range classes at most about two are therefore outside theirs by chance, but neighbouring classes share
poses: one disturbance takes a run of them out of their bands.

A cloud that was fitted to the reference cannot test its sigmas: the fit has taken away part of the errors
that they predict. With registration there are observed numbers only.
"""

from collections.abc import Iterable, Mapping
from typing import Final

import numpy as np
import pandas as pd

from thalweg.accuracy.comparison import ComparisonSettings, normalised_distances
from thalweg.accuracy.statistics import (
    WIDE_BAND,
    chi_square_band,
    consistency_in_words,
    describe_errors,
    describe_shape,
    fit_in_words,
    outlier_limits,
    range_class,
    ratio_band,
)
from thalweg.core import ArrayB, ArrayF, njit, root_mean_square

AS_MEASURED: Final = "as measured"
REGISTERED: Final = "with registration"
ALL: Final = "all"
WITHOUT_OUTLIERS: Final = "without outliers"
NO_TEST: Final = "a cloud that was fitted to the reference cannot test its sigmas"
CERTAIN: Final = 2.0
"""A mean beyond so many of its standard deviations is not what the sigmas predict."""
NMAD_EFFICIENCY: Final = 0.37
"""An NMAD of normal values is worth as much as the standard deviation of this share of them (Rousseeuw and
Croux 1993)."""
STATISTICS_COLUMNS: Final = ("registration", "points", "quantity", "value", "unit")
BY_RANGE_COLUMNS: Final = (
    "registration",
    "points",
    "range_m",
    "n",
    "rmse_observed_m",
    "rmse_predicted_m",
    "rmse_predicted_3d_m",
    "ratio",
    "ratio_low95",
    "ratio_high95",
    "inside",
    "independent_values",
)
_PREDICTED: Final = BY_RANGE_COLUMNS[5:]

_CLASSES_IN_TAU = 20
_MOST_CLASSES = 20_000
_ONE_OVER_E = float(np.exp(-1.0))


# ---------------------------------------------------------------- tables


def point_sets(table: pd.DataFrame) -> dict[str, ArrayB]:
    """Rows of a table `CLOUD_TO_MESH` that statistics are made of: with and without the outlier rule."""
    used, outlier = table["used"].to_numpy(), table["outlier"].to_numpy()
    return {ALL: used, WITHOUT_OUTLIERS: used & ~outlier}


def statistics_table(
    table: pd.DataFrame, settings: ComparisonSettings, registration: str = AS_MEASURED
) -> pd.DataFrame:
    """Statistics of the distances, with and without the outlier rule.

    Parameters
    ----------
    table : kind `CLOUD_TO_MESH`.
    settings : those of the comparison.
    registration : what the first column says.

    Returns
    -------
    One row a quantity with `STATISTICS_COLUMNS`. ``bias``, ``std``, ``rmse``, ``median``, ``nmad``, ``p95``:
    see `describe_errors`; bias and std are the normal distribution of largest likelihood, median and NMAD the
    robust one. Shape: see `describe_shape`. ``range_p99``: 99 % of the points were measured nearer.
    ``outliers``, ``outliers_in_front``, ``outliers_behind``: how many there are, and on which side;
    ``outlier_limit_low``, ``outlier_limit_high``: of a distance over its sigma.

    As measured also: ``predicted_rmse``: normal component and reference; ``predicted_rmse_3d``: P2 eq. 9.
    ``sigma_of_bias``: what the sigmas and the correlation time predict for the mean. ``ratio``: predicted
    over observed RMSE, consistent between ``ratio_low95`` and ``ratio_high95``. ``independent_values``: how
    many the band rests on. ``normalised_squared_error``: mean of squared distance over its variance,
    consistent between ``consistent_low95`` and ``consistent_high95``. ``normalised_median``,
    ``normalised_nmad``: of distance over its sigma; ``ratio_of_middle``: predicted over observed for a normal
    distribution with these two, whatever the tails do, consistent between ``middle_low95`` and
    ``middle_high95``. ``observed_correlation``: see `observed_correlation_s`.
    """
    rows: list[tuple[str, str, str, float, str]] = []
    for name, use in point_sets(table).items():
        rows += [(registration, name, *row) for row in _observed(table[use])]
        if registration == AS_MEASURED and use.any():
            rows += [(registration, name, *row) for row in _predicted(table[use], settings)]
    z = normalised_distances(table)
    low, high = outlier_limits(z[table["used"].to_numpy()], settings.outlier_nmads)
    outlier = table["outlier"].to_numpy()
    for quantity, value in (
        ("outliers", outlier.sum()),
        ("outliers_in_front", (outlier & (z > high)).sum()),
        ("outliers_behind", (outlier & (z < low)).sum()),
        ("outlier_limit_low", low),
        ("outlier_limit_high", high),
    ):
        rows.append((registration, WITHOUT_OUTLIERS, quantity, float(value), "1"))
    return pd.DataFrame(rows, columns=list(STATISTICS_COLUMNS))


def _observed(points: pd.DataFrame) -> list[tuple[str, float, str]]:
    distance = points["distance_m"].to_numpy()
    rows: list[tuple[str, float, str]] = []
    for quantity, value in describe_errors(distance).items():
        bare, _, unit = quantity.rpartition("_")
        rows.append((bare or quantity, value, unit if bare else "1"))
    if len(distance):
        rows += [(quantity, value, "1") for quantity, value in describe_shape(distance).items()]
        rows.append(("range_p99", float(np.percentile(points["range_m"], 99)), "m"))
    return rows


def _predicted(points: pd.DataFrame, settings: ComparisonSettings) -> list[tuple[str, float, str]]:
    distance = points["distance_m"].to_numpy()
    changing, constant, three_d = _variances(points, settings)
    variance = changing + constant
    t = points["t_gps_s"].to_numpy()
    n_rmse = independent_squares(t, changing, settings.correlation_s, constant_m2=constant)
    share = changing / variance
    n_normalised = independent_squares(t, share, settings.correlation_s, constant_m2=1.0 - share)
    ratio = float(np.sqrt(variance.mean() / np.mean(distance**2)))
    low, high = ratio_band(n_rmse)
    consistent_low, consistent_high = chi_square_band(n_normalised)
    normalised = normalised_distances(points)
    middle = describe_errors(normalised)
    middle_low, middle_high = ratio_band(NMAD_EFFICIENCY * n_normalised)
    return [
        ("predicted_rmse", float(np.sqrt(variance.mean())), "m"),
        ("predicted_rmse_3d", float(np.sqrt(three_d.mean())), "m"),
        ("sigma_of_bias", float(np.sqrt(_variance_of_mean(t, changing, constant, settings))), "m"),
        ("ratio", ratio, "1"),
        ("ratio_low95", low, "1"),
        ("ratio_high95", high, "1"),
        ("independent_values", n_rmse, "1"),
        ("normalised_squared_error", float(np.mean(normalised**2)), "1"),
        ("consistent_low95", consistent_low, "1"),
        ("consistent_high95", consistent_high, "1"),
        ("normalised_median", middle["median_m"], "1"),
        ("normalised_nmad", middle["nmad_m"], "1"),
        ("ratio_of_middle", 1 / max(float(np.hypot(middle["median_m"], middle["nmad_m"])), 1e-9), "1"),
        ("middle_low95", middle_low, "1"),
        ("middle_high95", middle_high, "1"),
        ("observed_correlation", observed_correlation_s(t, normalised, settings.correlation_s), "s"),
    ]


def by_range_table(
    table: pd.DataFrame, settings: ComparisonSettings, registration: str = AS_MEASURED
) -> pd.DataFrame:
    """Observed and predicted RMSE in the range classes of P2 eq. 10, each with its band.

    Parameters
    ----------
    table, settings, registration : as for `statistics_table`.

    Returns
    -------
    One row a class that has points, with `BY_RANGE_COLUMNS`. The band of a class follows from the times of
    its own points; ``inside`` says whether the ratio lies in it. The 3D total is no prediction of a distance:
    it stands there because P2 compared with it. With registration only ``n`` and the observed RMSE are there:
    the prediction is that of the cloud before it was fitted.
    """
    rows = []
    for name, use in point_sets(table).items():
        points = table[use]
        # of equal classes the points stay together, so that each class is a slice
        centre = range_class(points["range_m"].to_numpy().astype(np.float64))
        order = np.argsort(centre, kind="stable")
        points, centre = points.iloc[order], centre[order]
        distance, t = points["distance_m"].to_numpy(), points["t_gps_s"].to_numpy()
        changing, constant, three_d = _variances(points, settings)
        classes, first, count = np.unique(centre, return_index=True, return_counts=True)
        for middle, start, n in zip(classes, first, count, strict=True):
            part = slice(start, start + n)
            values = independent_squares(
                t[part], changing[part], settings.correlation_s, constant_m2=constant[part]
            )
            observed = root_mean_square(distance[part])
            predicted = float(np.sqrt(np.mean(changing[part] + constant[part])))
            ratio = predicted / observed if observed > 0 else np.inf
            low, high = ratio_band(values)
            rows.append(
                (
                    registration,
                    name,
                    int(middle),
                    int(n),
                    observed,
                    predicted,
                    float(np.sqrt(np.mean(three_d[part]))),
                    ratio,
                    low,
                    high,
                    low <= ratio <= high,
                    values,
                )
            )
    found = pd.DataFrame(rows, columns=list(BY_RANGE_COLUMNS))
    if registration != AS_MEASURED:
        found[list(_PREDICTED)] = None
    return found


def verdicts(statistics: pd.DataFrame, by_range: pd.DataFrame) -> list[dict[str, str]]:
    """What the tables say, in words: one entry a registration and set of points.

    Returns
    -------
    Entries ``registration``, ``points``, ``sigmas`` (are they consistent?), ``parts`` (which part of the
    distances is as predicted: their middle, their mean?), ``normal`` (does a normal distribution fit?) and
    ``classes`` (how many range classes are outside their bands). A fitted cloud has only ``normal`` of them.
    """
    out = []
    for (registration, points), rows in statistics.groupby(["registration", "points"], sort=False):
        value = dict(zip(rows["quantity"], rows["value"], strict=True))
        if not value.get("n"):
            continue
        entry = {
            "registration": str(registration),
            "points": str(points),
            "sigmas": NO_TEST,
            "parts": "",
            "normal": fit_in_words(value),
            "classes": "",
        }
        if "ratio" in value:
            classes = by_range.query("registration == @registration and points == @points")
            entry["sigmas"] = consistency_in_words(
                value["ratio"], value["ratio_low95"], value["ratio_high95"]
            )
            entry["parts"] = parts_in_words(value)
            entry["classes"] = classes_in_words(classes)
        out.append(entry)
    return out


def parts_in_words(value: Mapping[str, float]) -> str:
    """Which part of the distances is as predicted, from the quantities of `statistics_table`.

    Where distances are larger than predicted this says whether their middle is, too, or only their tails.
    Distances alone do not tell what made the tails.
    """
    mean, sigma, middle = (value[name] for name in ("bias", "sigma_of_bias", "ratio_of_middle"))
    low, high = value["middle_low95"], value["middle_high95"]
    agrees = low <= middle <= high
    words = (
        f"the mean offset, {1000 * mean:+.0f} mm, is {'beyond' if abs(mean) > CERTAIN * sigma else 'within'} "
        f"2 sigma (sigma = {1000 * sigma:.0f} mm); the robust ratio of predicted to observed, {middle:.2f}, "
        f"is {'inside' if agrees else 'outside'} its 95 % acceptance band ({low:.2f} to {high:.2f})"
    ).replace("-", "\N{MINUS SIGN}")
    if value["ratio"] < value["ratio_low95"] and agrees:
        words += (
            f". The tails bring the ratio from {middle:.2f} to {value['ratio']:.2f}: wrong points, or plants "
            "and objects that the reference does not have"
        )
    return words


def classes_in_words(classes: pd.DataFrame) -> str:
    """How many rows of `by_range_table` are outside their bands, and how many would hardly notice."""
    outside = classes[~classes["inside"].astype(bool)]
    inside = classes[classes["inside"].astype(bool)]
    wide = int((inside["ratio_high95"] > WIDE_BAND * inside["ratio_low95"]).sum())
    runs = runs_of(outside["range_m"].tolist())
    far = ", ".join(f"{first} to {last}" if last > first else f"{first}" for first, last in runs)
    words = f"{len(outside)} of {len(classes)} range classes are outside their band" + (
        f" ({far} m)" if far else ""
    )
    words += f"; about {0.05 * len(classes):.1f} are expected there by chance"
    if len(outside):
        words += " (neighbouring classes share poses)"
    if wide:
        some = "all" if wide == len(inside) else f"{wide}"
        words += f". Of the {len(inside)} inside, {some} have a band wider than a factor of {WIDE_BAND:g}"
    return words


def _variance_of_mean(
    t_gps_s: ArrayF, changing_m2: ArrayF, constant_m2: ArrayF, settings: ComparisonSettings
) -> float:
    """Predicted variance of the mean of distances whose errors share poses and a reference."""
    order = np.argsort(t_gps_s, kind="stable")
    shared = correlated_sum(t_gps_s[order], np.sqrt(changing_m2[order]), settings.correlation_s)
    return (shared + float(np.sqrt(constant_m2).sum()) ** 2) / len(t_gps_s) ** 2


def runs_of(numbers: Iterable[int]) -> list[list[int]]:
    """First and last of each run of neighbouring whole numbers, which are sorted."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return runs


def _variances(points: pd.DataFrame, settings: ComparisonSettings) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Predicted variance (n,) of each distance that changes in time, that is constant, and the 3D total.

    Constant is the reference's position as a whole; the noise of its vertices counts as changing.
    """
    reference = points["sigma_reference_m"].to_numpy().astype(np.float64) ** 2
    constant = np.minimum(reference, settings.reference_sigma_m**2)
    changing = points["sigma_normal_m"].to_numpy().astype(np.float64) ** 2 + reference - constant
    return changing, constant, points["sigma_3d_m"].to_numpy().astype(np.float64) ** 2


# ---------------------------------------------------------------- independent values among correlated ones
#
# Points of a cloud share the errors of their poses. With the covariance ``C_ij`` between the errors of two
# points the sum of squared errors has the variance ``2 sum_ij C_ij^2``, as a sum of that many independent
# normal squares would have::
#
#     N = (sum_i C_ii)^2 / sum_ij C_ij^2                                                  (Satterthwaite 1946)
#
# Here ``C_ij = sqrt(a_i a_j) exp(-|t_i - t_j| / tau) + sqrt(b_i b_j)``: a part ``a`` of each variance
# follows a Gauss-Markov process of correlation time ``tau``, a part ``b`` is one constant error of all
# points.
#
# **What is on the safe side.** All of a point's own variance counts as correlated. The white part of it, the
# lidar's own noise, would add independent values; so would the several errors of a pose, which act on points
# in different directions differently. The real number of independent values is larger, a band from this one
# too wide rather than too narrow. Errors that are constant, but not told, are on the other side: a mount that
# is wrong is one value for a whole campaign.


def independent_squares(
    t_gps_s: ArrayF, changing_m2: ArrayF, correlation_s: float, *, constant_m2: ArrayF | float = 0.0
) -> float:
    """Number of independent values in the sum of the squared errors of points; from 1 to n.

    Parameters
    ----------
    t_gps_s : (n,) time of each point, in any order.
    changing_m2 : (n,) variance that changes with the correlation time.
    correlation_s : correlation time of the errors; squares are correlated over half of it.
    constant_m2 : (n,) or one variance: of an error that is the same for all points.

    Examples
    --------
    >>> t = np.arange(0.0, 1000.0, 0.1)
    >>> round(independent_squares(t, np.ones(10_000), 20.0), 1)
    50.5
    """
    if not len(t_gps_s):
        return 0.0
    a = np.asarray(changing_m2, dtype=np.float64)
    b = np.broadcast_to(np.asarray(constant_m2, dtype=np.float64), a.shape)
    order = np.argsort(t_gps_s, kind="stable")
    t, a, b = np.ascontiguousarray(t_gps_s[order], dtype=np.float64), a[order], b[order]
    squares = correlated_sum(t, a, correlation_s / 2)
    if b.any():
        squares += 2 * correlated_sum(t, np.sqrt(a * b), correlation_s) + float(b.sum()) ** 2
    total = float(a.sum() + b.sum())
    return max(1.0, total**2 / squares) if squares > 0 else float(len(t))


def observed_correlation_s(t_gps_s: ArrayF, normalised: ArrayF, assumed_s: float) -> float:
    """Correlation time that distances themselves show: the lag at which their autocorrelation is 1/e.

    The assumed time rules every band, and nobody measures it. Covariances of points so far apart in time are
    averaged in classes of a twentieth of the assumed time. That of pairs of one class, not of points with
    themselves, is taken for lag zero: the white noise of single points has no part in it. The mean is taken
    off first, which makes the lag of a short survey too small; plants and errors of the reference that are
    seen for some time count like errors of the pose.

    Parameters
    ----------
    t_gps_s : (n,) time of each point, in any order.
    normalised : (n,) its distance over its sigma.
    assumed_s : correlation time that was assumed.

    Returns
    -------
    Seconds; NaN if the points share nothing, or if no lag up to half of the survey's time is long enough.

    Examples
    --------
    >>> t = np.arange(0.0, 100.0, 0.01)
    >>> round(observed_correlation_s(t, np.sign(np.sin(np.pi * t / 10.0)), 5.0), 1)
    3.4
    """
    if len(t_gps_s) < 2:
        return float(np.nan)
    duration = float(np.ptp(t_gps_s))
    step = max(assumed_s / _CLASSES_IN_TAU, duration / _MOST_CLASSES)
    place = np.floor((t_gps_s - t_gps_s.min()) / step).astype(np.int64)
    values = normalised - normalised.mean()
    n, total = np.bincount(place).astype(np.float64), np.bincount(place, weights=values)
    pairs = float(np.sum(n * (n - 1)))
    start = float(np.sum(total**2) - np.sum(values**2)) / pairs if pairs else 0.0
    if start <= 0:
        return float(np.nan)
    before = 1.0
    for lag in range(1, len(n) // 2 + 1):
        weight = float(n[:-lag] @ n[lag:])
        if weight:
            now = float(total[:-lag] @ total[lag:]) / weight / start
            if now < _ONE_OVER_E:
                return float(step * (lag - (_ONE_OVER_E - now) / (before - now)))
            before = now
    return float(np.nan)


def correlated_sum(t_sorted_s: ArrayF, weight: ArrayF, decay_s: float) -> float:
    """``sum_ij w_i w_j exp(-|t_i - t_j| / decay)`` over all pairs, exact, in one pass over sorted times."""
    return float(_correlated_sum(t_sorted_s, np.ascontiguousarray(weight), decay_s))


@njit(cache=True, error_model="numpy")
def _correlated_sum(t: ArrayF, weight: ArrayF, decay_s: float) -> float:
    # the weighted sum over all earlier points decays from one point to the next
    total, before = 0.0, 0.0
    for i in range(len(t)):
        if i > 0:
            before = (before + weight[i - 1]) * np.exp(-(t[i] - t[i - 1]) / decay_s)
        total += weight[i] * (weight[i] + 2.0 * before)
    return total
