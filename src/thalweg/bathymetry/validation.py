"""What a bed foretells of data that it did not see, and what other interpolators foretell of them.

Soundings of one line are neighbours of each other: leaving out single ones says nothing about the bed
between the lines. Whole lines are left out, and stretches along the river; the drift is fitted anew each
time.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.interpolate import LinearNDInterpolator, RBFInterpolator
from scipy.spatial import QhullError, cKDTree

from thalweg.bathymetry.bed import observations_of
from thalweg.bathymetry.kriging import CovarianceModel, Observations
from thalweg.bathymetry.variogram import MARGIN, Basin, BedModel, Drift, HalfWidths
from thalweg.core import ArrayB, ArrayF, ArrayI
from thalweg.settings.sections import Bathymetry

_OUTSIDE: Final = 1.959964
_MOST_LINES: Final = 40
"""Of more lines, so many are left out, evenly chosen."""
_MOST_OF_LINE: Final = 200
_BLOCKS: Final = 8
_CLASSES: Final = {
    "distance_m": ("{} from data", " m", (0.0, 1.0, 2.0, 4.0, 8.0, 16.0, np.inf)),
    "depth_m": ("{} deep", " m", (-np.inf, 0.5, 1.0, 2.0, 4.0, np.inf)),
    "slope": ("slope {}", "", (0.0, 0.1, 0.2, 0.4, np.inf)),
}
"""Words, unit and limits of classes of what is predicted."""
_IDW: Final = 12
_SPLINE: Final = 48

Method = Callable[[Observations, ArrayF], tuple[ArrayF, ArrayF | None]]
"""Heights and, where it has them, standard deviations (m,) at flow coordinates (m, 2) from observations."""


def validate_bed(
    table: pd.DataFrame, model: BedModel, half_widths: HalfWidths, settings: Bathymetry
) -> tuple[dict[str, Any], pd.DataFrame, pd.DataFrame]:
    """Lines and stretches foretold from everything else.

    Parameters
    ----------
    table : kind ``bed_observations``.
    model : drift and covariance; the covariance stays, the drift is fitted anew without what is left out.
    half_widths : of the river.
    settings : number of neighbours.

    Returns
    -------
    facts : rmse_m, bias_m, normalised_square, outside_95 (share), lines, n; the same of ``blocks``, and in
        ``classes`` by distance to the nearest datum that was left in, by depth (below the shorelines, where
        they are data) and predicted slope of the bed, and of margin and channel.
    predicted : columns group (line, block), number, s_m, n_m, up_m, predicted_m, sigma_m (of a datum there),
        distance_m, depth_m, slope, margin.
    methods : columns method, rmse_m, bias_m, normalised_square, outside_95, n; lines left out.
    """
    data = observations_of(table)
    sounding = table["source"].isin(["sounding", "table"]).to_numpy()
    parts = [
        _predicted(data, part, group, model, half_widths, settings)
        for group, splits in (("line", _lines(data, sounding)), ("block", _blocks(data, sounding)))
        for part in splits
    ]
    predicted = pd.concat([part for part in parts if len(part)], ignore_index=True)
    shore = table[table["source"] == "bank"].sort_values("s_m")
    level = np.interp(predicted["s_m"], shore["s_m"], shore["up_m"]) if len(shore) else np.nan
    predicted["depth_m"] = level - predicted["up_m"]
    of_lines, of_blocks = (predicted[predicted["group"] == group] for group in ("line", "block"))
    classes = by_class(of_lines)
    margin = of_lines["margin"]
    for name, inside in (("channel", ~margin), ("margin", margin)) if margin.any() else ():
        if inside.sum() >= 10:
            classes[name] = measures(of_lines[inside])
    facts = measures(of_lines) | {
        "lines": int(of_lines["number"].nunique()),
        "blocks": measures(of_blocks) if len(of_blocks) else None,
        "classes": classes,
    }
    rows = []
    for name, method in methods(model, settings).items():
        rows.append({"method": name} | measures(_by_method(data, sounding, method)))
    return facts, predicted, pd.DataFrame(rows)


def by_class(predicted: pd.DataFrame) -> dict[str, Any]:
    """Measures by distance to the nearest datum and, where these are columns, by depth and slope."""
    classes = {}
    for name, (words, unit, limits) in _CLASSES.items():
        for low, high in pairwise(limits) if name in predicted else ():
            of = predicted[(predicted[name] >= low) & (predicted[name] < high)]
            if len(of) >= 10:
                least = f"{max(low, 0.0):g}{unit}"
                most = "more" if high == np.inf else f"{high:g}{unit}"
                classes[words.format(f"{least} to {most}")] = measures(of)
    return classes


def measures(predicted: pd.DataFrame) -> dict[str, Any]:
    """Root mean square error, bias (predicted less measured), normalised square, share outside 95 %, n."""
    error = (predicted["predicted_m"] - predicted["up_m"]).to_numpy()
    known = np.isfinite(error)
    z = error[known] / predicted["sigma_m"].to_numpy()[known]
    z = z[np.isfinite(z)]  # of places without a sigma nothing is said
    return {
        "rmse_m": float(np.sqrt(np.mean(error[known] ** 2))) if known.any() else np.nan,
        "bias_m": float(np.mean(error[known])) if known.any() else np.nan,
        "normalised_square": float(np.mean(z**2)) if len(z) else np.nan,
        "outside_95": float(np.mean(np.abs(z) > _OUTSIDE)) if len(z) else np.nan,
        "n": int(known.sum()),
        "not_foretold": int((~known).sum()),
    }


def _lines(data: Observations, sounding: ArrayB) -> Iterator[tuple[int, ArrayB, ArrayI]]:
    """Number, membership (n,) and places in it that are foretold, of lines to be left out."""
    numbers = np.unique(data.line[sounding])
    step = -(-len(numbers) // _MOST_LINES)
    for number in numbers[::step].tolist():
        out = sounding & (data.line == number)
        yield number, out, _some(out)


def _blocks(data: Observations, sounding: ArrayB) -> Iterator[tuple[int, ArrayB, ArrayI]]:
    """The same of stretches along the river, ends left in."""
    s = data.s_m[sounding]
    edges = np.linspace(s.min(), s.max(), 2 * _BLOCKS + 1)
    for k in range(1, 2 * _BLOCKS - 1, 2):
        inside = (data.s_m >= edges[k]) & (data.s_m < edges[k + 1])
        if (inside & sounding).sum() >= 5:
            yield k // 2, inside & sounding, _some(inside & sounding)


def _some(out: ArrayB) -> ArrayI:
    at = np.flatnonzero(out)
    return at[:: -(-len(at) // _MOST_OF_LINE)]


def _predicted(
    data: Observations,
    part: tuple[int, ArrayB, ArrayI],
    group: str,
    model: BedModel,
    half_widths: HalfWidths,
    settings: Bathymetry,
) -> pd.DataFrame:
    number, out, at = part
    rest, there = data.where(~out), data.where(at)
    if len(rest) < 4:
        return pd.DataFrame()
    height, sigma, slope = model.fitted_to(rest).predict_slope(
        rest, there.places_m, neighbours=settings.neighbours, step_m=settings.cell_m
    )
    left, right = half_widths(there.s_m)
    across = model.drift.across
    near_shore = (
        across.margin(there.places_m) > 0.5
        if isinstance(across, Basin)
        else np.abs(there.n_m) > MARGIN * np.where(there.n_m > 0, left, right)
    )
    return pd.DataFrame(
        {
            "group": group,
            "number": number,
            "s_m": there.s_m,
            "n_m": there.n_m,
            "up_m": there.height_m,
            "predicted_m": height,
            "sigma_m": model.steepened(np.sqrt(sigma**2 + model.own_variance(there)), slope),
            "slope": slope,
            "distance_m": cKDTree(rest.places_m).query(there.places_m)[0],
            "margin": near_shore,
        }
    )


def _by_method(data: Observations, sounding: ArrayB, method: Method) -> pd.DataFrame:
    parts = []
    for _, out, at in _lines(data, sounding):
        there = data.where(at)
        height, sigma = method(data.where(~out), there.places_m)
        own = there.sigma_white_m**2 + there.sigma_slow_m**2
        parts.append(
            pd.DataFrame(
                {
                    "up_m": there.height_m,
                    "predicted_m": height,
                    "sigma_m": np.nan if sigma is None else np.sqrt(sigma**2 + own),
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def methods(model: BedModel, settings: Bathymetry) -> dict[str, Method]:
    """Ways to interpolate, by name; all take flow coordinates, stretched by the anisotropy where it says so.

    Merwade et al. (2006, Advances in Water Resources 29) compare such methods on rivers.
    """
    of = model.covariance
    stretch = np.array([of.range_n_m / of.range_s_m, 1.0])
    even = replace(of, range_s_m=of.range_n_m)
    none = Drift(kind="none", across=model.drift.across)

    def kriged(covariance: CovarianceModel, *, drift: bool) -> Method:
        """Kriging with a covariance."""

        def solve(rest: Observations, places: ArrayF) -> tuple[ArrayF, ArrayF | None]:
            """Heights and sigmas at places."""
            again = replace(model, covariance=covariance, drift=model.drift if drift else none)
            height, sigma = again.fitted_to(rest).predict(rest, places, neighbours=settings.neighbours)
            return height, np.hypot(sigma, model.roughness(places) * np.sqrt(covariance.micro_m2))

        return solve

    def inverse_distance(scale: ArrayF) -> Method:
        """Inverse squared distances with coordinates scaled."""

        def solve(rest: Observations, places: ArrayF) -> tuple[ArrayF, ArrayF | None]:
            """Heights and sigmas at places."""
            tree = cKDTree(rest.places_m * scale)
            d, near = tree.query(places * scale, k=min(_IDW, len(rest)))
            w = 1.0 / np.maximum(d, 1e-6) ** 2
            return np.sum(w * rest.height_m[near], axis=1) / np.sum(w, axis=1), None

        return solve

    def triangles(rest: Observations, places: ArrayF) -> tuple[ArrayF, ArrayF | None]:
        """Linear within triangles."""
        try:
            return LinearNDInterpolator(rest.places_m * stretch, rest.height_m)(places * stretch), None
        except QhullError:  # all on one line
            return np.full(len(places), np.nan), None

    def splines(rest: Observations, places: ArrayF) -> tuple[ArrayF, ArrayF | None]:
        """Thin-plate splines of the nearest data."""
        p = rest.places_m * stretch
        _, first = np.unique(np.round(p, 6), axis=0, return_index=True)
        smoothing = float(np.median(rest.sigma_white_m**2))
        spline = RBFInterpolator(
            p[first], rest.height_m[first], neighbors=min(_SPLINE, len(first)), smoothing=smoothing
        )
        try:
            return spline(places * stretch), None
        except np.linalg.LinAlgError:  # the nearest data of a place are all on one line
            return np.full(len(places), np.nan), None

    return {
        "kriging": kriged(of, drift=True),
        "kriging, no drift": kriged(of, drift=False),
        "kriging, same range along and across": kriged(even, drift=False),
        "inverse distance, elliptical": inverse_distance(stretch),
        "inverse distance": inverse_distance(np.ones(2)),
        "triangles": triangles,
        "thin plates": splines,
    }
