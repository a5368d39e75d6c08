"""Residuals on the surfaces of the cones, unrolled, and their distribution."""

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.stats import norm as normal

from thalweg.core.types import ArrayF
from thalweg.figures.calibration.field_views import RESIDUAL_MAP, FieldCone, cones_of
from thalweg.figures.calibration.tables import CONE_POINTS, CONES, checked, filled, natural, points_of
from thalweg.figures.style import BLUE, VERMILION, count, new_figure, plural, robust_limits, styled

COLUMNS: Final = 3
POINTS_SHOWN: Final = 4000
"""Of each cone; an even sample of them."""

BINS: Final = 61
NMAD: Final = 1.4826


@styled
def cone_residuals(
    points: pd.DataFrame, cones: pd.DataFrame, *, title: str = "Residuals on the cones", twin: bool = False
) -> Figure:
    """Each cone unrolled, coloured by the signed distance from its surface, and a histogram of all.

    Parameters
    ----------
    points, cones : see `thalweg.figures.calibration.tables`; points that were not used are grey.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : a column is missing.
    CoverageError : no point was used.
    """
    points = checked(points, CONE_POINTS)
    used = filled(points[points["used"].astype(bool)], "point used")
    bodies = cones_of(checked(cones, CONES))
    names = [name for name in natural(used["cone"].astype(str).tolist()) if name in bodies]
    residual_mm = 1e3 * used["residual_m"].to_numpy(np.float64)
    limit = max(abs(x) for x in robust_limits(residual_mm, 2.0, 98.0))
    rows = -(-len(names) // COLUMNS)
    rejected = len(points) - len(used)
    head = f"{title}, n = {plural(len(used), 'point')} on {plural(len(names), 'cone')}"
    head += f", {count(rejected)} not used"
    figure = new_figure(24.0 + 44.0 * rows + 42.0, head, twin=twin)
    grid = figure.add_gridspec(rows + 1, COLUMNS, height_ratios=[*([1.0] * rows), 0.95])
    norm = Normalize(-limit, limit)
    cells = [figure.add_subplot(grid[k // COLUMNS, k % COLUMNS]) for k in range(len(names))]
    for k, (ax, name) in enumerate(zip(cells, names, strict=True)):
        _unrolled(ax, bodies[name], points[points["cone"].astype(str) == name], norm)
        ax.set_xlabel("angle about the axis / °" if k // COLUMNS == rows - 1 else "")
        ax.set_ylabel("distance from apex / m" if k % COLUMNS == 0 else "")
    figure.colorbar(
        ScalarMappable(norm, RESIDUAL_MAP), ax=cells, label="residual, outside + / mm", extend="both",
        pad=0.01, aspect=30, shrink=0.85,
    )  # fmt: skip
    _histogram(figure.add_subplot(grid[rows, :2]), residual_mm, limit)
    _by_cone(figure.add_subplot(grid[rows, 2]), used, names)
    return figure


def _unrolled(ax: Axes, cone: FieldCone, points: pd.DataFrame, norm: Normalize) -> None:
    angle, along = cone.unrolled(points_of(points))
    used = points["used"].to_numpy(bool)
    residual_mm = 1e3 * points["residual_m"].to_numpy(np.float64)
    step = max(-(-int(used.sum()) // POINTS_SHOWN), 1)
    at = np.flatnonzero(used)[::step]
    angle_deg = np.rad2deg(_unwrapped(angle, used))
    ax.plot(
        angle_deg[~used], along[~used], ls="none", marker=".", ms=1.6, mew=0, color="0.75", gid="rejected",
        rasterized=True,
    )  # fmt: skip
    ax.scatter(angle_deg[at], along[at], c=residual_mm[at], cmap=RESIDUAL_MAP, norm=norm, s=3.0, lw=0.0,
               rasterized=True, gid="residuals")  # fmt: skip
    edge = cone.length_m / np.cos(cone.half_angle_rad)
    ax.set_ylim(1.06 * edge, 0.0)
    ax.axhline(edge, color="0.4", lw=0.7, ls="--")
    ax.set_title(
        f"{cone.name}: n = {count(int(used.sum()))}\nmean {residual_mm[used].mean():+.1f}, "
        f"std {residual_mm[used].std():.1f} mm",
        fontsize=7,
    )
    ax.grid()


def _unwrapped(angle_rad: ArrayF, used: ArrayF) -> ArrayF:
    """Angles about their mean direction, so that a patch is not cut at ±180°."""
    middle = np.angle(np.mean(np.exp(1j * angle_rad[used.astype(bool)]))) if used.any() else 0.0
    return np.asarray(middle + (angle_rad - middle + np.pi) % (2 * np.pi) - np.pi)


def _histogram(ax: Axes, residual_mm: ArrayF, limit: float) -> None:
    reach = 2.0 * limit
    edges = np.linspace(-reach, reach, BINS + 1)
    n, _ = np.histogram(residual_mm, edges)
    ax.stairs(n, edges, fill=True, color="0.75", gid="histogram")
    width = float(edges[1] - edges[0])
    x = np.linspace(-reach, reach, 401)
    middle = float(np.median(residual_mm))
    nmad = NMAD * float(np.median(np.abs(residual_mm - middle)))
    for name, centre, spread, colour, dashes in (
        ("mean, std", float(residual_mm.mean()), float(residual_mm.std()), VERMILION, "-"),
        ("median, NMAD", middle, nmad, BLUE, "--"),
    ):
        if spread > 0:
            y = residual_mm.size * width * normal.pdf(x, centre, spread)
            label = f"normal, {name}: {centre:+.1f}, {spread:.1f} mm"
            ax.plot(x, y, color=colour, ls=dashes, lw=1.4, label=label)
    beyond = int(np.sum(np.abs(residual_mm) > reach))
    ax.set_title(f"all cones; {count(beyond) if beyond else 'none'} beyond the axis")
    ax.set(xlabel="residual / mm", ylabel=f"points per {width:.2g} mm / 1", xlim=(-reach, reach))
    ax.set_ylim(0, 1.45 * max(float(n.max()), 1.0))
    ax.legend(loc="upper left")


def _by_cone(ax: Axes, used: pd.DataFrame, names: list[str]) -> None:
    """Mean residual of each cone at each position: what a wrong orientation leaves behind."""
    positions = natural(used["position"].astype(str).tolist())
    markers = "os^Dv"
    for k, position in enumerate(positions[:5]):
        part = used[used["position"].astype(str) == position]
        groups = part.groupby(part["cone"].astype(str))["residual_m"]
        mean: pd.Series[float] = 1e3 * groups.mean()
        error: pd.Series[float] = 1e3 * groups.std() / np.sqrt(groups.size())
        at = [i for i, name in enumerate(names) if name in mean.index]
        shift = 0.16 * (k - (min(len(positions), 5) - 1) / 2)
        ax.errorbar(
            np.array(at) + shift, [mean[names[i]] for i in at], yerr=[2 * error[names[i]] for i in at],
            ls="none", marker=markers[k], ms=3.0, lw=0.8, label=position.replace("_", " "),
        )  # fmt: skip
    ax.axhline(0.0, color="black", lw=0.7)
    ax.set_xticks(range(len(names)), names)
    ax.set_title("mean by cone and position,\nbars: 2 sigma")
    ax.set_ylabel("mean residual / mm")
    if 1 < len(positions) <= 5:
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.42 * (high - low))
        ax.legend(loc="upper left", fontsize=6, ncols=2, columnspacing=0.8, handletextpad=0.3)
    ax.grid(axis="y")
