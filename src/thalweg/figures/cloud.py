"""Pictures of the point cloud: the whole reach (P1 Fig. 4) and a detail of the bank (P1 Fig. 5)."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, Normalize, PowerNorm
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from thalweg.core.errors import GeometryError
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayB, ArrayF
from thalweg.figures.maps import track_gaps
from thalweg.figures.splat import ObliqueView, Splat, across_azimuth
from thalweg.figures.style import (
    HALO,
    HEIGHT_MAP,
    INTENSITY_MAP,
    WIDTH_MM,
    count,
    new_figure,
    plural,
    robust_limits,
    scale_bar,
    styled,
)

SEARCH_CELL_M: Final = 1.0
"""Cell of the grid on which the densest stretch of bank is looked for."""

NOISE_M: Final = 0.03
"""Accuracy of a lidar point (P2 eq. 7); shading at a finer scale would show noise."""

CLEARLY_HIGHER_M: Final = 1.0
"""Difference of the heights of both sides (90th percentile) from which the higher one is put behind."""

STRIP: Final = 0.09
"""Free strip below the picture of a reach, for scale bar and axes, as a share of the width."""

CLEAR_EXTENT: Final = 1.5
"""Length over width from which the track tells the direction of the river."""


@styled
def cloud_overview(
    cloud: ArrayF | Splat[ObliqueView],
    trajectory: Trajectory | None = None,
    *,
    height_limits_m: tuple[float, float] | None = None,
    title: str = "Point cloud of the reach",
    twin: bool = False,
) -> Figure:
    """The cloud of the reach seen obliquely from above, coloured by height.

    Parameters
    ----------
    cloud : (n, 3) points in wcs, or a `Splat` to which chunks were added with their heights as values.
    trajectory : track of the boat, drawn as a line.
    height_limits_m : heights at the ends of the colour scale; by default percentiles of the picture.
    title : first words of the title.
    twin : true if the digital twin made the data.
    """
    splat = cloud if isinstance(cloud, Splat) else _splat_of(cloud)
    view = splat.view
    heights = splat.buffers()[1]
    limits = height_limits_m or robust_limits(heights, 0.5, 99.5)
    of_all = f" of {count(splat.n_added)}" if splat.n_drawn < splat.n_added else ""
    head = f"{title}, n = {count(splat.n_drawn)}{of_all} points"
    figure = new_figure(max(reach_mm(view) + 12.0, 60.0), head, twin=twin)
    ax = figure.add_subplot()
    label = "height in the local frame / m"
    gamma = balanced_gamma(heights, limits)
    draw_reach(figure, ax, splat, HEIGHT_MAP, limits, label=label, trajectory=trajectory, gamma=gamma)
    return figure


def balanced_gamma(values: ArrayF, limits: tuple[float, float]) -> float:
    """Exponent of a colour scale that puts the median of the values at its middle; 0.4 to 1.

    Trees of 30 m leave the lowest fifth of a linear scale to a bank of 6 m, which the survey is about.
    """
    finite = values[np.isfinite(values)]
    if not finite.size:
        return 1.0
    share = float((np.median(finite) - limits[0]) / (limits[1] - limits[0]))
    return float(np.clip(np.log(0.5) / np.log(np.clip(share, 1e-6, 0.999)), 0.4, 1.0))


def reach_mm(view: ObliqueView) -> float:
    """Height on paper of a view of the reach that fills the width beside its colour bar."""
    return 0.84 * WIDTH_MM * (view.height_px / view.width_px + STRIP)


def draw_reach(
    figure: Figure,
    ax: Axes,
    splat: Splat[ObliqueView],
    colours: Colormap,
    limits: tuple[float, float],
    *,
    label: str,
    trajectory: Trajectory | None = None,
    shading: float = 1.0,
    factor: float = 1.0,
    gamma: float = 1.0,
) -> None:
    """The picture of a reach with its colour bar, track, scale bar and directions.

    Parameters
    ----------
    figure, ax : where.
    splat : the picture.
    colours, limits : colour scale of the splat's values.
    label : of the colour bar.
    trajectory : track of the boat, drawn as a line.
    shading : strength of the eye-dome shading.
    factor : units of the colour bar in one unit of the splat's values.
    gamma : exponent of the colour scale, below 1 for more colours at its lower end.
    """
    view = splat.view
    strip_px = STRIP * view.width_px
    _show(ax, splat, colours, limits, shading=shading, gamma=gamma)
    ax.set_axis_off()
    if trajectory is not None:
        _draw_track(ax, view, trajectory)
    ax.set_xlim(0, view.width_px)
    ax.set_ylim(view.height_px + strip_px, 0)
    scale_bar(ax, span_m=view.width_px * view.pixel_m)
    _axes_triad(ax, view, strip_px)
    figure.colorbar(
        ScalarMappable(PowerNorm(gamma, factor * limits[0], factor * limits[1]), colours), ax=ax,
        label=label, aspect=25, shrink=0.9, pad=0.01, extend="both",
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class BankSegment:
    """A stretch of bank as it is seen from the water.

    Parameters
    ----------
    centre_en_m : (2,) middle of the stretch in wcs.
    azimuth_rad : direction of view from the water onto the bank, clockwise from north.
    length_m : length along the bank.
    depth_m : how far before and behind the centre points belong to it.
    background_m : how far behind it points still do, so that trees and buildings stand in the background.
    """

    centre_en_m: ArrayF
    azimuth_rad: float
    length_m: float
    depth_m: float = 12.0
    background_m: float = 0.0

    def along_and_away(self, points_wcs_m: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Metres along the bank from the left end, and metres away from the water behind the centre."""
        s, c = np.sin(self.azimuth_rad), np.cos(self.azimuth_rad)
        east, north = (points_wcs_m[:, :2] - self.centre_en_m).T
        return east * c - north * s + 0.5 * self.length_m, east * s + north * c

    def contains(self, points_wcs_m: ArrayF) -> ArrayB:
        """(n,) true for points of the stretch; use it to pick them from chunks."""
        along, away = self.along_and_away(points_wcs_m)
        with np.errstate(invalid="ignore"):
            beside = (along >= 0) & (along <= self.length_m)
            return np.asarray(beside & (away >= -self.depth_m) & (away <= self.depth_m + self.background_m))


def choose_segment(
    points_wcs_m: ArrayF,
    trajectory: Trajectory,
    *,
    length_m: float = 14.0,
    min_distance_m: float = 2.0,
    max_distance_m: float = 25.0,
    background_m: float = 0.0,
) -> BankSegment:
    """The stretch of bank with most points, looked at from the nearest piece of the track.

    Parameters
    ----------
    points_wcs_m : (n, 3) the cloud or an even sample of it.
    trajectory : track of the boat, to know the side of the water.
    length_m : length of the stretch.
    min_distance_m, max_distance_m : horizontal distance of the bank from the track.
    background_m : depth of the background that belongs to the stretch.

    Raises
    ------
    GeometryError : no point lies at such a distance.
    """
    from scipy.ndimage import distance_transform_edt, uniform_filter

    finite = points_wcs_m[np.isfinite(points_wcs_m).all(axis=1)]
    track = trajectory.position_wcs_m[trajectory.valid, :2]
    low = track.min(axis=0) - max_distance_m - length_m
    shape = np.ceil((track.max(axis=0) + max_distance_m + length_m - low) / SEARCH_CELL_M).astype(int)
    cell = np.floor((finite[:, :2] - low) / SEARCH_CELL_M)
    cell = cell[np.all((cell >= 0) & (cell < shape), axis=1)].astype(np.int64)
    n = np.bincount(cell[:, 0] * shape[1] + cell[:, 1], minlength=int(shape.prod())).reshape(shape)
    on_track = np.zeros(shape, dtype=bool)
    dense = np.unique(np.floor((track - low) / SEARCH_CELL_M).astype(np.int64), axis=0)
    on_track[dense[:, 0], dense[:, 1]] = True
    distance, nearest = distance_transform_edt(~on_track, sampling=SEARCH_CELL_M, return_indices=True)
    n = np.where((distance >= min_distance_m) & (distance <= max_distance_m), n, 0)
    if not n.any():
        raise GeometryError(
            f"no point lies {min_distance_m:g} to {max_distance_m:g} m beside the track",
            expected="a cloud of the banks",
            cure="Check the mount of the lidar and the time axis of the streams",
        )
    window = max(3, round(length_m / SEARCH_CELL_M))
    score = uniform_filter(n.astype(np.float64), window, mode="constant")
    at = np.array(np.unravel_index(int(np.argmax(score)), score.shape))
    around = tuple(slice(max(0, a - window // 2), a + window // 2 + 1) for a in at)
    weight = n[around].astype(np.float64)
    cells = (np.arange(s.start, s.start + k) for s, k in zip(around, weight.shape, strict=True))
    grid = np.stack(np.meshgrid(*cells, indexing="ij"), axis=-1)
    middle = np.average(grid.reshape(-1, 2), axis=0, weights=weight.ravel())
    centre = low + (middle + 0.5) * SEARCH_CELL_M
    towards = np.average((grid - nearest[(slice(None), *around)].transpose(1, 2, 0)).reshape(-1, 2), axis=0,
                         weights=weight.ravel())  # fmt: skip
    away = _across_river(track, centre, towards, reach_m=2.0 * length_m)
    return BankSegment(
        centre_en_m=centre,
        azimuth_rad=float(np.arctan2(away[0], away[1])),
        length_m=length_m,
        background_m=background_m,
    )


def _across_river(track_en_m: ArrayF, centre_en_m: ArrayF, towards: ArrayF, *, reach_m: float) -> ArrayF:
    """Unit vector from the water to the bank, across the axis of the track nearby.

    A zigzag changes its direction at each turn, its longest extent does not. Where the track nearby has no
    clear longest extent, the mean direction from the track to the bank stands in.
    """
    cells = np.unique(np.rint(track_en_m / SEARCH_CELL_M), axis=0) * SEARCH_CELL_M
    near = np.linalg.norm(cells - centre_en_m, axis=1)
    local = cells[near <= near.min() + reach_m]
    spread, vectors = np.linalg.eigh(np.cov(local.T) if len(local) > 2 else np.eye(2))
    if spread[1] < CLEAR_EXTENT**2 * spread[0]:
        return np.asarray(towards / np.linalg.norm(towards))
    across = vectors[:, 0]
    return np.asarray(across if across @ towards >= 0 else -across)


def bankward_azimuth(points_wcs_m: ArrayF, trajectory: Trajectory) -> float:
    """Direction of view across the reach from which the banks hide each other least.

    The side with the taller things stands behind: seen the other way its trees would hide its own slope.
    Where neither side is taller, the best measured bank shows its face.

    Parameters
    ----------
    points_wcs_m : (n, 3) the cloud or an even sample of it.
    trajectory : the boat, which saw the faces.
    """
    from scipy.spatial import cKDTree

    across = across_azimuth(points_wcs_m)
    finite = points_wcs_m[np.isfinite(points_wcs_m).all(axis=1)]
    finite = finite[:: max(1, len(finite) // 50_000)]
    track = trajectory.position_wcs_m[trajectory.valid, :2]
    _, nearest = cKDTree(track).query(finite[:, :2])
    far_side = (finite[:, :2] - track[nearest]) @ np.array([np.sin(across), np.cos(across)]) > 0
    if far_side.any() and not far_side.all():
        tall = [float(np.percentile(finite[side, 2], 90.0)) for side in (far_side, ~far_side)]
        higher = tall[0] - tall[1]
        if abs(higher) > CLEARLY_HIGHER_M:
            return across if higher > 0 else across + np.pi
    bank = choose_segment(points_wcs_m, trajectory).azimuth_rad
    return across if np.cos(across - bank) >= 0 else across + np.pi


@styled
def cloud_detail(
    points_wcs_m: ArrayF,
    intensity: ArrayLike,
    *,
    segment: BankSegment,
    percentiles: tuple[float, float] = (2.0, 98.0),
    width_px: int = 1800,
    title: str = "Detail of the bank, seen from the water",
    twin: bool = False,
) -> Figure:
    """A stretch of bank as seen from the water, coloured by intensity; both axes to scale.

    Parameters
    ----------
    points_wcs_m : (n, 3) points in wcs; those outside the segment are left out.
    intensity : (n,) as the instrument states it.
    segment : the stretch, from `choose_segment` or by hand.
    percentiles : of the intensities, at the ends of the colour scale.
    width_px : width of the picture.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    GeometryError : no point in the segment.
    """
    inside = segment.contains(points_wcs_m)
    points, shown = points_wcs_m[inside], np.asarray(intensity, dtype=np.float64)[inside]
    if not len(points):
        raise GeometryError("no point in the stretch of bank", expected="a segment that meets the cloud")
    low, high = (float(v) for v in np.percentile(points[:, 2], [0.1, 99.9]))
    low, high = low - 0.3, min(high, low + 0.6 * segment.length_m) + 0.3
    pixel = segment.length_m / width_px
    right = np.array([np.cos(segment.azimuth_rad), -np.sin(segment.azimuth_rad)])
    view = ObliqueView(
        azimuth_rad=segment.azimuth_rad,
        elevation_rad=0.0,
        left_m=float(right @ segment.centre_en_m) - 0.5 * segment.length_m,
        top_m=high,
        pixel_m=pixel,
        width_px=width_px,
        height_px=int(np.ceil((high - low) / pixel)),
    )
    splat = Splat(view)
    splat.add(points, shown)
    limits = robust_limits(shown, *percentiles)
    head = f"{title}, n = {count(splat.n_drawn)} points"
    figure = new_figure(0.80 * WIDTH_MM * view.height_px / view.width_px + 26.0, head, twin=twin)
    ax = figure.add_subplot()
    bottom = high - view.height_px * pixel
    _show(
        ax,
        splat,
        INTENSITY_MAP,
        limits,
        shading=0.8,
        noise_m=NOISE_M,
        extent=(0.0, segment.length_m, bottom, high),
    )
    ax.set_xlabel("along the bank / m")
    ax.set_ylabel("height in the local frame / m")
    figure.colorbar(
        ScalarMappable(Normalize(*limits), INTENSITY_MAP), ax=ax, aspect=25, pad=0.01, extend="both",
        label=f"intensity / 1   ({percentiles[0]:g} to {percentiles[1]:g} %)",
    )  # fmt: skip
    return figure


def _splat_of(points_wcs_m: ArrayF) -> Splat[ObliqueView]:
    splat = Splat(ObliqueView.fit(points_wcs_m))
    splat.add(points_wcs_m, points_wcs_m[:, 2])
    return splat


def _show(
    ax: Axes,
    splat: Splat[ObliqueView],
    colours: Colormap,
    limits: tuple[float, float],
    *,
    shading: float,
    noise_m: float = 0.0,
    gamma: float = 1.0,
    extent: tuple[float, float, float, float] | None = None,
) -> None:
    # The splat's own scale is linear: the table bends.
    table = colours(np.linspace(0, 1, 4096) ** gamma)[:, :3]
    picture = splat.image(table, limits, radius_px=splat.radius_px(), shading=shading, noise_m=noise_m)
    box = extent or (0.0, float(splat.view.width_px), float(splat.view.height_px), 0.0)
    ax.imshow(picture, extent=box, interpolation="antialiased", gid="cloud")


def _draw_track(ax: Axes, view: ObliqueView, trajectory: Trajectory) -> None:
    pixels = view.project(trajectory.position_wcs_m)[:, :2]
    pixels[~trajectory.valid] = np.nan
    gaps = track_gaps(trajectory)
    label = "track of the boat" + (f", {plural(len(gaps), 'gap')}" if gaps else "")
    ax.plot(*pixels.T, color="black", lw=0.9, label=label, gid="track", path_effects=HALO)
    ax.legend(loc="lower center", frameon=False)


def _axes_triad(ax: Axes, view: ObliqueView, strip_px: float) -> None:
    """Small arrows of the directions of east, north and up in the strip below the picture."""
    size = 0.5 * strip_px
    origin = np.array([view.width_px - 2.0 * size, view.height_px + 1.3 * size])
    for axis, name in enumerate("ENU"):
        tip = origin + size * view.axes[:2, axis] * np.array([1.0, -1.0])
        ax.annotate(
            "", xy=(tip[0], tip[1]), xytext=(origin[0], origin[1]), annotation_clip=False,
            arrowprops={"arrowstyle": "-|>", "lw": 0.9, "color": "black", "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
        # Seen along a meridian north and up fall on one line: their names stand on either side of it.
        aside = {"N": 0.35, "U": -0.35}.get(name, 0.0) * size
        text = origin + 1.3 * (tip - origin) + np.array([aside, 0.0])
        ax.text(text[0], text[1], name, fontsize=7, ha="center", va="center", gid=f"axis-{name}")
