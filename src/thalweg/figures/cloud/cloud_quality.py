"""The cloud by what is known of its points: predicted sigma and measured range."""

from typing import Final

import numpy as np
from cmcrameri import cm
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, ListedColormap, LogNorm
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from thalweg.core.errors import InputError
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayF
from thalweg.figures.cloud.overview import draw_reach, reach_mm
from thalweg.figures.cloud.splat import ObliqueView, Splat
from thalweg.figures.style import (
    BLUE,
    HALO,
    RANGE_MAP,
    SIGMA_MAP,
    VERMILION,
    count,
    new_figure,
    robust_limits,
    styled,
)

DENSITY_MAP: Final[Colormap] = ListedColormap(cm.grayC_r(np.linspace(0.06, 0.85, 256)), "thalweg_density")

THESIS_RANGE_M: Final = (5.0, 10.0, 25.0, 50.0)
THESIS_SIGMA_CM: Final = (5.4, 6.2, 10.1, 18.3)
"""3D standard deviation of an INS-based lidar point by range (T Table 3.1)."""

RANGE_CLASSES: Final = 160
SIGMA_CLASSES: Final = 110
"""Cells of the density of sigma over range."""

LEAST_IN_CLASS: Final = 20
"""The median of a range class with fewer points is not drawn."""

_PANEL_MM: Final = 62.0


def sigma_3d_m(sigma_east_m: ArrayLike, sigma_north_m: ArrayLike, sigma_up_m: ArrayLike) -> ArrayF:
    """3D standard deviation, the root of the trace of the covariance: ``sqrt(sE^2 + sN^2 + sU^2)``.

    Examples
    --------
    >>> float(sigma_3d_m(0.02, 0.03, 0.06))
    0.07
    """
    parts = [np.asarray(s, dtype=np.float64) for s in (sigma_east_m, sigma_north_m, sigma_up_m)]
    return np.asarray(np.sqrt(sum(s**2 for s in parts)))


@styled
def cloud_by_sigma(
    splat: Splat[ObliqueView],
    range_m: ArrayF,
    sigma_m: ArrayF,
    trajectory: Trajectory | None = None,
    *,
    thesis: bool = True,
    title: str = "Predicted accuracy of the cloud",
    twin: bool = False,
) -> Figure:
    """The reach coloured by predicted 3D sigma, and the sigma against the measured range.

    Parameters
    ----------
    splat : the reach, its values the 3D sigmas in metres, see `sigma_3d_m`.
    range_m, sigma_m : (n,) range and 3D sigma of all points or an even sample of them.
    trajectory : track of the boat, drawn as a line.
    thesis : draw T Table 3.1 for comparison.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : arrays of different length, or no point with a positive, finite sigma and range.
    """
    range_m, sigma_m = _same_length(range_m, sigma_m)
    usable = np.isfinite(range_m) & np.isfinite(sigma_m) & (range_m > 0) & (sigma_m > 0)
    if not usable.any():
        raise InputError(
            f"none of {len(range_m)} points has a sigma",
            expected="columns sigma_east, sigma_north, sigma_up above 0",
            cure="Georeference the cloud again: sigmas come from the covariances of the trajectory",
        )
    r, sigma_cm = range_m[usable], 100.0 * sigma_m[usable]
    limits_cm = robust_limits(sigma_cm, 0.5, 99.0)
    figure, upper, lower = _two_panels(splat, f"{title}, n = {count(splat.n_drawn)} points", twin=twin)
    limits = limits_cm[0] / 100.0, limits_cm[1] / 100.0
    draw_reach(
        figure, upper, splat, SIGMA_MAP, limits, label="predicted 3D sigma / cm", trajectory=trajectory,
        shading=0.6, factor=100.0,
    )  # fmt: skip
    top_cm, far_m = _density(figure, lower, r, sigma_cm, thesis=thesis)
    lost = int(len(range_m) - usable.sum())
    beyond = int(np.sum((sigma_cm > top_cm) | (r > far_m)))
    text = f"n = {count(len(r))} points" + (" sampled" if len(r) + lost < splat.n_added else "")
    text += f", median {np.median(sigma_cm):.1f} cm, 95 % below {np.percentile(sigma_cm, 95):.1f} cm"
    text += f"; {count(beyond)} beyond the axes" if beyond else ""
    text += f"; {count(lost)} without a sigma" if lost else ""
    lower.set_title(text)
    return figure


@styled
def cloud_by_range(
    splat: Splat[ObliqueView],
    range_m: ArrayF,
    trajectory: Trajectory | None = None,
    *,
    title: str = "Measured range of the cloud's points",
    twin: bool = False,
) -> Figure:
    """The reach coloured by measured range, and how many points lie at which range.

    Parameters
    ----------
    splat : the reach, its values the ranges in metres.
    range_m : (n,) range of all points or an even sample of them.
    trajectory : track of the boat, drawn as a line.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : no point with a finite range.
    """
    r = np.asarray(range_m, dtype=np.float64)
    finite = r[np.isfinite(r) & (r >= 0)]
    if not finite.size:
        raise InputError(f"none of {len(r)} points has a range", expected="the column 'range' in metres")
    figure, upper, lower = _two_panels(
        splat, f"{title}, n = {count(splat.n_drawn)} points", twin=twin, panel_mm=0.75 * _PANEL_MM
    )
    limits = robust_limits(finite, 0.5, 99.0)
    draw_reach(
        figure, upper, splat, RANGE_MAP, limits, label="measured range / m", trajectory=trajectory,
        shading=0.6,
    )  # fmt: skip
    far = max(float(np.ceil(np.percentile(finite, 99.9))), 1.0)
    width = 1.0 if far > 20 else 0.25
    edges = np.arange(0.0, far + width, width)
    n, _ = np.histogram(finite, edges)
    lower.stairs(100.0 * n / finite.size, edges, fill=True, color=BLUE, alpha=0.6, gid="histogram")
    lower.set_xlim(0.0, edges[-1])
    lower.set_xlabel("measured range / m")
    lower.set_ylabel(f"points per {width:g} m / %")
    beyond = int(np.sum(finite > edges[-1]))
    text = f"n = {count(finite.size)} points" + (" sampled" if finite.size < splat.n_added else "")
    quartiles = np.percentile(finite, [25, 50, 75])
    text += f", median {quartiles[1]:.1f} m, half of them between {quartiles[0]:.1f} and {quartiles[2]:.1f} m"
    text += f"; {count(beyond)} beyond the axis" if beyond else ""
    lower.set_title(text)
    lower.grid(axis="y")
    return figure


def _same_length(range_m: ArrayF, sigma_m: ArrayF) -> tuple[ArrayF, ArrayF]:
    r, s = np.asarray(range_m, dtype=np.float64), np.asarray(sigma_m, dtype=np.float64)
    if r.shape != s.shape or r.ndim != 1:
        raise InputError(f"ranges {r.shape} and sigmas {s.shape}", expected="two arrays (n,) of one length")
    return r, s


def _two_panels(
    splat: Splat[ObliqueView], head: str, *, twin: bool, panel_mm: float = _PANEL_MM
) -> tuple[Figure, Axes, Axes]:
    reach = max(reach_mm(splat.view), 35.0)
    figure = new_figure(reach + panel_mm + 18.0, head, twin=twin)
    upper, lower = figure.subplots(2, 1, height_ratios=[reach + 4.0, panel_mm])
    return figure, upper, lower


def _density(
    figure: Figure, ax: Axes, range_m: ArrayF, sigma_cm: ArrayF, *, thesis: bool
) -> tuple[float, float]:
    """Density of the points over range and sigma with the median of each class; returns the axes' ends."""
    far = 1.05 * max(float(np.percentile(range_m, 99.9)), 1.0)
    top = 1.15 * float(np.percentile(sigma_cm, 99.8))
    if thesis:
        top = max(top, 1.25 * max(s for r, s in zip(THESIS_RANGE_M, THESIS_SIGMA_CM, strict=True) if r <= 25))
    edges = np.linspace(0.0, far, RANGE_CLASSES + 1), np.linspace(0.0, top, SIGMA_CLASSES + 1)
    n, _, _ = np.histogram2d(range_m, sigma_cm, edges)
    shown = np.ma.masked_less(n.T, 1)
    mesh = ax.pcolormesh(
        *edges, shown, cmap=DENSITY_MAP, norm=LogNorm(1, max(10.0, float(n.max()))), rasterized=True,
        gid="density",
    )  # fmt: skip
    figure.colorbar(mesh, ax=ax, label="points per cell / 1", pad=0.01, aspect=18)
    coarse = edges[0][::4]
    index = np.digitize(range_m, coarse) - 1
    order = np.argsort(index, kind="stable")
    parts = np.split(sigma_cm[order], np.searchsorted(index[order], np.arange(1, len(coarse))))
    median = [float(np.median(part)) if len(part) >= LEAST_IN_CLASS else np.nan for part in parts]
    middles = coarse + 0.5 * (coarse[1] - coarse[0])
    ax.plot(middles, median, color=BLUE, lw=1.6, label="median of a range class", gid="median",
            path_effects=HALO)  # fmt: skip
    if thesis:
        ax.plot(
            THESIS_RANGE_M, THESIS_SIGMA_CM, color=VERMILION, lw=1.2, ls="--", marker="D", ms=4, mfc="white",
            label="T Table 3.1", gid="thesis", path_effects=HALO,
        )  # fmt: skip
    ax.set_xlim(0.0, far)
    ax.set_ylim(0.0, top)
    ax.set_xlabel("measured range / m")
    ax.set_ylabel("predicted 3D sigma / cm")
    ax.legend(loc="upper left")
    return top, far
