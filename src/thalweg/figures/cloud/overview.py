"""The cloud of a reach: overview and a detail of the bank (P1 Fig. 4 and 5)."""

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from thalweg.core import AnyArray, ArrayF, ArrayU8, GeometryError, Trajectory, iter_laz
from thalweg.figures import (
    HALO,
    HEIGHT_MAP,
    INTENSITY_MAP,
    WIDTH_MM,
    colour_bar,
    count,
    new_figure,
    plural,
    robust_limits,
    scale_bar,
    styled,
)
from thalweg.figures.cloud.views import (
    BankSegment,
    ObliqueView,
    Splat,
    bankward_azimuth,
    choose_segment,
    pack_rgb,
)
from thalweg.figures.survey import track_gaps
from thalweg.lidar import sample_cloud

NOISE_M: Final = 0.03
"""Accuracy of a lidar point (P2 eq. 7); shading at a finer scale would show noise."""
STRIP: Final = 0.09
"""Free strip below the picture of a reach, for scale bar and axes, as a share of the width."""
_LEAST_MM: Final = 34.0
"""Least height of a panel: its label has some words."""
STRAYS: Final = 30
"""Most points above the upper edge of a detail that are taken for strays."""


@styled
def cloud_overview(
    splat: Splat[ObliqueView], trajectory: Trajectory, *, title: str = "Point cloud of the reach"
) -> Figure:
    """The cloud of the reach seen obliquely from above, coloured by height, with track, scale bar and north.

    Parameters
    ----------
    splat : to which chunks were added with their heights as values.
    trajectory : track of the boat, drawn as a line.
    title : first words of the title.
    """
    view = splat.view
    # trees would leave the lowest fifth of the colours to a bank, which the survey is about
    limits = robust_limits(splat.buffers()[1], 0.5, 90.0)
    of_all = f" of {count(splat.n_added)}" if splat.n_drawn < splat.n_added else ""
    head = f"{title}, n = {count(splat.n_drawn)}{of_all} points"
    tall_mm = 0.84 * WIDTH_MM * (view.height_px / view.width_px + STRIP)
    figure = new_figure(max(tall_mm + 12.0, 60.0), head)
    ax = figure.add_subplot()
    strip_px = STRIP * view.width_px
    _show(ax, splat, HEIGHT_MAP, limits, shading=1.0)
    ax.set_axis_off()
    pixels = view.project(trajectory.position_wcs_m)[:, :2]
    pixels[~trajectory.valid] = np.nan
    gaps = track_gaps(trajectory)
    label = "track of the boat" + (f", {plural(len(gaps), 'gap')}" if gaps else "")
    ax.plot(*pixels.T, color="black", lw=0.9, label=label, gid="track", path_effects=HALO)
    ax.legend(loc="lower center", frameon=False)
    ax.set(xlim=(0, view.width_px), ylim=(view.height_px + strip_px, 0))
    scale_bar(ax, span_m=view.width_px * view.pixel_m)
    _draw_north(ax, view, strip_px)
    words = "height in the local frame / m"
    colour_bar(ax, HEIGHT_MAP, limits, words, aspect=25, shrink=0.9, pad=0.01, extend="both")
    return figure


@styled
def cloud_detail(
    points_wcs_m: ArrayF,
    intensity: ArrayLike,
    *,
    segment: BankSegment,
    rgb: ArrayU8 | None = None,
    percentiles: tuple[float, float] = (2.0, 98.0),
    width_px: int = 1800,
    title: str = "Detail of the bank, seen from the water",
) -> Figure:
    """A stretch of bank as seen from the water, by intensity, and above in colour; both axes to scale.

    Parameters
    ----------
    points_wcs_m : (n, 3) points in wcs; those outside the segment are left out.
    intensity : (n,) as the instrument states it.
    segment : the stretch, from `choose_segment` or by hand.
    rgb : (n, 3) colours, if there are any.
    percentiles : of the intensities, at the ends of the colour scale.
    width_px : width of the picture.
    title : first words of the title.

    Raises
    ------
    GeometryError : no point in the segment.
    """
    inside = segment.contains(points_wcs_m)
    points, shown = points_wcs_m[inside], np.asarray(intensity, dtype=np.float64)[inside]
    if not len(points):
        raise GeometryError("no point in the stretch of bank", expected="a segment that meets the cloud")
    # A share of the points would cut the crowns, which are far off and hold few of them.
    strays = min(STRAYS, len(points) // 1000)
    low = float(np.percentile(points[:, 2], 0.1))
    high = float(np.partition(points[:, 2], -1 - strays)[-1 - strays])
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
    limits = robust_limits(shown, *percentiles)
    looks: list[tuple[ArrayF, Colormap | None]] = [(shown, INTENSITY_MAP)]
    if rgb is not None:
        looks.insert(0, (pack_rgb(rgb[inside]), None))
    head = f"{title}, n = {count(len(points))} points"
    each_mm = max(0.80 * WIDTH_MM * view.height_px / view.width_px, _LEAST_MM)
    figure = new_figure(len(looks) * each_mm + 26.0, head)
    axes = figure.subplots(len(looks), 1, sharex=True, squeeze=False)[:, 0]
    bottom = high - view.height_px * pixel
    for ax, (values, colours) in zip(axes, looks, strict=True):
        splat = Splat(view)
        splat.add(points, values)
        _show(
            ax,
            splat,
            colours,
            limits,
            shading=0.8,
            noise_m=NOISE_M,
            extent=(0.0, segment.length_m, bottom, high),
        )
        ax.set_ylabel("height in the local frame / m")
    ax = axes[-1]
    ax.set_xlabel("along the bank / m")
    words = f"intensity   ({percentiles[0]:g} to {percentiles[1]:g} %)"
    colour_bar(ax, INTENSITY_MAP, limits, words, aspect=25, pad=0.01, extend="both")
    return figure


def _show(
    ax: Axes,
    splat: Splat[ObliqueView],
    colours: Colormap | None,
    limits: tuple[float, float],
    *,
    shading: float,
    noise_m: float = 0.0,
    extent: tuple[float, float, float, float] | None = None,
) -> None:
    table = None if colours is None else colours(np.linspace(0, 1, 256))[:, :3]
    picture = splat.image(table, limits, radius_px=splat.radius_px(), shading=shading, noise_m=noise_m)
    box = extent or (0.0, float(splat.view.width_px), float(splat.view.height_px), 0.0)
    ax.imshow(picture, extent=box, interpolation="antialiased")


def _draw_north(ax: Axes, view: ObliqueView, strip_px: float) -> None:
    """An arrow to the north in the strip below the picture."""
    middle = np.array([view.width_px - strip_px, view.height_px + 0.5 * strip_px])
    tip = 0.4 * strip_px * view.axes[:2, 1] * np.array([1.0, -1.0])
    look = {"arrowstyle": "-|>", "lw": 1.1, "color": "black", "shrinkA": 6, "shrinkB": 0}
    ax.annotate(
        "N",
        tuple(middle + tip),
        xytext=tuple(middle - tip),
        arrowprops=look,
        ha="center",
        va="center",
        fontsize=8,
        fontweight="bold",
        annotation_clip=False,
    )


def draw_cloud_detail(*, points: Path, trajectory: Path, title: str) -> Figure:
    """Cloud and trajectory -> a detail of the bank by intensity, where photographs saw any in colour, too."""
    sample, track = sample_cloud(points, 500_000), Trajectory.read(trajectory)
    coloured = sample["n_views"] > 0 if "n_views" in sample else np.ones(len(sample["xyz_m"]), dtype=np.bool_)
    segment = choose_segment(sample["xyz_m"][coloured], track, length_m=40.0, background_m=80.0)
    parts: dict[str, list[AnyArray]] = {}
    for chunk in iter_laz(points, 1_000_000):
        inside = segment.contains(chunk["xyz_m"])
        for name in ("xyz_m", "intensity", "rgb"):
            if name in chunk:
                parts.setdefault(name, []).append(chunk[name][inside])
    rgb = (np.concatenate(parts["rgb"]) >> 8).astype(np.uint8) if "rgb" in parts else None
    return cloud_detail(
        np.concatenate(parts["xyz_m"]),
        np.concatenate(parts["intensity"]),
        rgb=rgb,
        segment=segment,
        title=f"Detail of the bank, seen from the water: {title}",
    )


def draw_cloud_overview(*, points: Path, trajectory: Path, title: str) -> Figure:
    """Cloud and trajectory -> oblique view of the reach."""
    sample, track = sample_cloud(points, 500_000)["xyz_m"], Trajectory.read(trajectory)
    splat = Splat(ObliqueView.fit(sample, azimuth_rad=bankward_azimuth(sample, track)))
    for chunk in iter_laz(points, 1_000_000):
        splat.add(chunk["xyz_m"], chunk["xyz_m"][:, 2])
    return cloud_overview(splat, track, title=f"Point cloud of the reach: {title}")
