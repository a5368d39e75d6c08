r"""What hydraulic engineers read off a terrain model: sections, long profile, hypsometry, volumes.

Errors of neighbouring heights are alike. With standard deviations ``sigma_i`` and a correlation
``exp(-d / L)`` over the distance d, a sum with weights ``w`` has the variance
``sum_i sum_j w_i w_j sigma_i sigma_j exp(-d_ij / L)``, to which the common part adds
``(sum_i w_i sigma_c,i)^2``. Over a raster the double sum is a convolution (Rolstad, Haug and Denby 2009
integrate the same over a circle).
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.signal import fftconvolve
from scipy.stats import norm, t as student

from thalweg.core import ArrayB, ArrayF, CoverageError
from thalweg.fusion.dtm import Dtm
from thalweg.fusion.river import River
from thalweg.settings.sections import Fusion

_FADED: Final = 9.0
"""Errors so many lengths of correlation apart share nothing (1e-4)."""
_TILE: Final = 512
UNTOLD_LENGTH_M: Final = 5.0
"""Correlation of errors where neither the settings nor the bed say one."""
_FEWEST_SECTIONS: Final = 8
WIDE: Final = float(norm.isf(0.025))
"""Standard deviations of a 95 % band to either side."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A cross section.

    Parameters
    ----------
    s_m : distance along the river.
    n_m : (k,) offsets from right to left: from negative to positive.
    places_m : (k, 2) in the map grid.
    height_m, sigma_m, sigma_common_m : (k,) of the terrain; NaN without a height.
    level_m : height of the water.
    left_m, right_m : offsets of the banks.
    """

    s_m: float
    n_m: ArrayF
    places_m: ArrayF
    height_m: ArrayF
    sigma_m: ArrayF
    sigma_common_m: ArrayF
    level_m: float
    left_m: float
    right_m: float

    @property
    def thalweg_m(self) -> float:
        """Offset of the lowest place between the banks."""
        inside = (self.n_m >= self.right_m) & (self.n_m <= self.left_m) & np.isfinite(self.height_m)
        return float(self.n_m[inside][np.argmin(self.height_m[inside])])


def cut_sections(model: Dtm, river: River, settings: Fusion) -> list[Section]:
    """Cross sections every `fusion.sections.spacing_m`, a point a cell.

    Raises
    ------
    CoverageError : no section has heights from bank to bank.
    """
    how, found = settings.sections, []
    margin = min(model.cell_m, river.flow.length_m / 4)
    count = max(int((river.flow.length_m - 2 * margin) // how.spacing_m), 1) + 1
    stations = np.linspace(margin, river.flow.length_m - margin, count)
    rows = zip(stations, *river.offsets_m(stations), river.level_m(stations), strict=True)
    for s, left, right, level in ((float(value) for value in row) for row in rows):
        reach = np.arange(right - how.overbank_m, left + how.overbank_m + 1e-9, model.cell_m)
        # the banks themselves are points of the section; no two points share a station of a centimetre
        reach = reach[np.minimum(np.abs(reach - left), np.abs(reach - right)) > 0.01]
        n = np.unique(np.concatenate([reach, [right, left]]))
        places = river.to_map(np.full(len(n), s), n)
        folded = river.to_flow(places)[2]
        height, sigma = model.at(places)
        height = np.where(folded, np.nan, height)
        inside = (n >= right) & (n <= left)
        if not np.isfinite(height[inside]).all():
            continue
        found.append(
            Section(
                s_m=s,
                n_m=n,
                places_m=places,
                height_m=height,
                sigma_m=sigma,
                sigma_common_m=np.nan_to_num(model.at_common(places)),
                level_m=level,
                left_m=left,
                right_m=right,
            )
        )
    if not found:
        raise CoverageError(
            "no cross section has heights from bank to bank",
            expected="a terrain model that is watertight between the banks",
            cure="Do model, banks and centre line belong to one campaign?",
        )
    return found


def correlated_sigma(
    weights: ArrayF, sigma: ArrayF, common: ArrayF, distance: ArrayF, length_m: float
) -> float:
    """Sigma of a weighted sum of values in a row whose errors fall off exponentially.

    Parameters
    ----------
    weights, sigma, common, distance : (k,) weights, standard deviations (common part included), common parts,
        places along the row.
    length_m : distance of a correlation of 1/e.
    """
    own = weights * np.sqrt(np.maximum(sigma**2 - common**2, 0.0))
    rho = np.exp(-np.abs(distance[:, None] - distance) / length_m)
    return float(np.sqrt(own @ rho @ own + (weights @ common) ** 2))


def hydraulic_table(
    section: Section, settings: Fusion, *, correlation_m: float | None = None
) -> pd.DataFrame:
    """Area, wetted perimeter and hydraulic radius at levels from the thalweg to the lower bank top.

    Parameters
    ----------
    section : see there.
    settings : levels, and the length of correlation if it is stated.
    correlation_m : that of the bed across the river; None: 5 m.

    Returns
    -------
    columns ``s_m, level_m, area_m2, sigma_area_m2, low_area_m2, high_area_m2, perimeter_m, radius_m,
    sigma_radius_m, low_radius_m, high_radius_m, width_m``; bands are 95 %.
    """
    n, z, known = section.n_m, section.height_m, np.isfinite(section.height_m)
    n, z = n[known], z[known]
    sigma, common = section.sigma_m[known], section.sigma_common_m[known]
    middle = int(np.argmin(np.where((n >= section.right_m) & (n <= section.left_m), z, np.inf)))
    top = min(float(z[: middle + 1].max()), float(z[middle:].max()))
    rows, length = [], settings.correlation_m or correlation_m or UNTOLD_LENGTH_M
    for level in np.linspace(z[middle], top, settings.sections.levels + 1)[1:]:
        # only water that is connected with the thalweg
        a = middle - int(np.argmax(z[middle::-1] >= level)) if (z[: middle + 1] >= level).any() else 0
        b = middle + int(np.argmax(z[middle:] >= level)) if (z[middle:] >= level).any() else len(n) - 1
        area, perimeter, width, weights = _wetted(n[a : b + 1], z[a : b + 1], float(level))
        spread = correlated_sigma(weights, sigma[a : b + 1], common[a : b + 1], n[a : b + 1], length)
        radius, of_radius = area / perimeter, spread / perimeter
        rows.append(
            {
                "s_m": section.s_m,
                "level_m": float(level),
                "area_m2": area,
                "sigma_area_m2": spread,
                "low_area_m2": max(area - WIDE * spread, 0.0),
                "high_area_m2": area + WIDE * spread,
                "perimeter_m": perimeter,
                "radius_m": radius,
                "sigma_radius_m": of_radius,
                "low_radius_m": max(radius - WIDE * of_radius, 0.0),
                "high_radius_m": radius + WIDE * of_radius,
                "width_m": width,
            }
        )
    return pd.DataFrame(rows)


def _wetted(n: ArrayF, z: ArrayF, level: float) -> tuple[float, float, float, ArrayF]:
    """Area, perimeter, width below a level, and how much the area falls with each height (k,)."""
    depth = level - z
    d0, d1, step = depth[:-1], depth[1:], np.diff(n)
    both, left, right = (d0 > 0) & (d1 > 0), (d0 > 0) & (d1 <= 0), (d0 <= 0) & (d1 > 0)
    share = np.where(both, 1.0, 0.0)
    share[left] = d0[left] / (d0[left] - d1[left])
    share[right] = d1[right] / (d1[right] - d0[right])
    mean = (np.maximum(d0, 0.0) + np.maximum(d1, 0.0)) / 2
    area = float(np.sum(mean * share * step))
    slant = np.hypot(step, np.diff(z))
    weights = np.zeros(len(z))
    wet = share * step / 2
    weights[:-1] += np.where(d0 > 0, np.where(both, wet, 2 * wet), 0.0)
    weights[1:] += np.where(d1 > 0, np.where(both, wet, 2 * wet), 0.0)
    return area, float(np.sum(share * slant)), float(np.sum(share * step)), weights


_PROFILE: Final = ("s_m", "thalweg_n_m", "thalweg_m", "sigma_thalweg_m", "mean_bed_m", "level_m", "width_m")


def long_profile(sections: list[Section]) -> pd.DataFrame:
    """Thalweg, mean bed, banks and level along the river: a row a section."""
    rows = []
    for section in sections:
        inside = (section.n_m >= section.right_m) & (section.n_m <= section.left_m)
        z, n = section.height_m[inside], section.n_m[inside]
        lowest = int(np.argmin(z))
        rows.append(
            {
                "s_m": section.s_m,
                "thalweg_n_m": float(n[lowest]),
                "thalweg_m": float(z[lowest]),
                "sigma_thalweg_m": float(section.sigma_m[inside][lowest]),
                "mean_bed_m": float(np.trapezoid(z, n) / (n[-1] - n[0])),
                "level_m": section.level_m,
                "width_m": section.left_m - section.right_m,
            }
        )
    return pd.DataFrame(rows, columns=list(_PROFILE))


def depths_along(
    profile: pd.DataFrame, *, weir_s_m: float | None = None, backwater_m: float = 60.0
) -> dict[str, Any]:
    """Whether the river is deeper where it is narrower, and before a weir.

    ``log(mean depth) = a + b log(width) + c r(s) + e``, where ``r`` rises from 0 to 1 over the backwater of
    the weir: its water is level, the bed falls. The deviations ``e`` of neighbouring sections go together
    (first-order autoregression, estimated and taken out after Prais and Winsten 1954): pools are longer than
    the distance of the sections.

    Parameters
    ----------
    profile : of `long_profile`, sections at even distances.
    weir_s_m : place of a weir along the river; None: there is none.
    backwater_m : length of the reach before it over which it deepens.

    Returns
    -------
    facts : ``sections``, ``correlation`` of neighbouring sections, ``exponent`` b and ``sigma_exponent``,
        ``deeper_where_narrower`` (b below zero at 97.5 %); with a weir ``ratio_at_weir`` (depth at its foot
        over depth elsewhere at the same width), ``sigma_ratio_at_weir``, ``deeper_before_weir``.

    Raises
    ------
    CoverageError : too few sections, one width all along, or no section before the weir or none elsewhere.
    """
    depth = (profile["level_m"] - profile["mean_bed_m"]).to_numpy(np.float64)
    width, s = profile["width_m"].to_numpy(np.float64), profile["s_m"].to_numpy(np.float64)
    wet = np.isfinite(depth) & (depth > 0) & (width > 0)
    columns = [np.ones(int(wet.sum())), np.log(width[wet])]
    if weir_s_m is not None:
        columns.append(
            np.where(s[wet] > weir_s_m, 0.0, np.maximum(1 - (weir_s_m - s[wet]) / backwater_m, 0.0))
        )
    X, y = np.column_stack(columns), np.log(depth[wet])
    if (
        len(y) < _FEWEST_SECTIONS
        or np.linalg.matrix_rank(X - [0.0, *X[:, 1:].mean(axis=0)], 1e-6) < X.shape[1]
    ):
        raise CoverageError(
            f"{len(y)} sections with water, width {np.ptp(width[wet]) if len(y) else 0.0:.2f} m more or less"
            + ("" if weir_s_m is None else f", {int((X[:, 2] > 0).sum())} of them before the weir"),
            expected=f"at least {_FEWEST_SECTIONS} of different width, before the weir and elsewhere",
            cure="Lower fusion.sections.spacing_m",
        )
    rho, n = 0.0, len(y)
    for _ in range(5):
        # Prais and Winsten: what the section before does not foretell; the first one keeps its share
        whiten = np.eye(n) - rho * np.eye(n, k=-1)
        whiten[0, 0] = np.sqrt(1 - rho**2)
        A, b = whiten @ X, whiten @ y
        inverse = np.linalg.inv(A.T @ A)
        beta = inverse @ A.T @ b
        rest = y - X @ beta
        # the estimate of a correlation from n values is too small by about (1 + 4 rho) / n (Kendall 1954)
        found = float(rest[1:] @ rest[:-1] / max(rest @ rest, 1e-300))
        rho = float(np.clip(found + (1 + 4 * found) / n, 0.0, 0.95))
    variance = float(np.sum((b - A @ beta) ** 2)) / (n - len(beta))
    sigma = np.sqrt(np.diag(inverse) * variance)
    wide = float(student.isf(0.025, n - len(beta)))
    facts: dict[str, Any] = {
        "sections": n,
        "correlation": rho,
        "exponent": float(beta[1]),
        "sigma_exponent": float(sigma[1]),
        "deeper_where_narrower": bool(beta[1] + wide * sigma[1] < 0),
    }
    if weir_s_m is not None:
        ratio = float(np.exp(beta[2]))
        facts["ratio_at_weir"] = ratio
        facts["sigma_ratio_at_weir"] = float(ratio * sigma[2])
        facts["deeper_before_weir"] = bool(beta[2] - wide * sigma[2] > 0)
    return facts


def volume_below(
    model: Dtm, level_m: float | ArrayF, inside: ArrayB, correlation_m: float
) -> tuple[float, float, float]:
    """Volume between terrain and a level, its sigma, and the wet area.

    Parameters
    ----------
    level_m : one height, or (rows, columns).
    inside : (rows, columns) cells that count.
    correlation_m : distance over which errors fall to 1/e.
    """
    depth = np.where(inside & np.isfinite(model.height_m), level_m - model.height_m, 0.0)
    wet = depth > 0
    area = model.cell_m**2
    common = np.where(wet, np.nan_to_num(model.sigma_common_m), 0.0)
    own = np.sqrt(np.maximum(np.where(wet, np.nan_to_num(model.sigma_m), 0.0) ** 2 - common**2, 0.0))
    variance = _convolved(own, model.cell_m, correlation_m) + float(common.sum()) ** 2
    return float(depth[wet].sum() * area), float(np.sqrt(variance) * area), float(wet.sum() * area)


def _convolved(own: ArrayF, cell_m: float, correlation_m: float) -> float:
    """``sum_i sum_j own_i own_j exp(-d_ij / L)`` of all cells, tile by tile: rivers are thin."""
    reach = int(np.ceil(_FADED * correlation_m / cell_m))
    lag = np.arange(-reach, reach + 1) * cell_m
    bell = np.exp(-np.hypot(lag[:, None], lag) / correlation_m)
    size, total = max(_TILE, 2 * reach), 0.0
    for row in range(0, own.shape[0], size):
        for column in range(0, own.shape[1], size):
            tile = own[row : row + size, column : column + size]
            rows, columns = np.flatnonzero(tile.any(axis=1)), np.flatnonzero(tile.any(axis=0))
            if not len(rows):
                continue
            a, b = row + int(rows[0]), row + int(rows[-1]) + 1
            c, d = column + int(columns[0]), column + int(columns[-1]) + 1
            top, west = max(a - reach, 0), max(c - reach, 0)
            wide = own[top : b + reach, west : d + reach]
            near = fftconvolve(wide, bell, mode="same")[a - top : b - top, c - west : d - west]
            total += float(np.sum(own[a:b, c:d] * near))
    return total


def hypsometry(
    model: Dtm, inside: ArrayB, settings: Fusion, *, correlation_m: float | None = None
) -> pd.DataFrame:
    """Wet area and volume below levels from the lowest to the highest cell inside.

    Parameters
    ----------
    model, inside : terrain, and cells (rows, columns) that count.
    settings : levels, and the length of correlation if it is stated.
    correlation_m : that of the bed over an area; None: 5 m.

    Raises
    ------
    CoverageError : no cell inside has a height.
    """
    known = inside & np.isfinite(model.height_m)
    if not known.any():
        raise CoverageError("no cell has a height there", expected="a model that covers the water line")
    low, high = float(model.height_m[known].min()), float(model.height_m[known].max())
    rows, length = [], settings.correlation_m or correlation_m or UNTOLD_LENGTH_M
    for level in np.linspace(low, high, settings.sections.levels):
        volume, sigma, area = volume_below(model, float(level), known, length)
        rows.append(
            {
                "level_m": float(level),
                "area_m2": area,
                "volume_m3": volume,
                "sigma_volume_m3": sigma,
                "low_m3": max(volume - WIDE * sigma, 0.0),
                "high_m3": volume + WIDE * sigma,
            }
        )
    return pd.DataFrame(rows)
