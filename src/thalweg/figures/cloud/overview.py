"""The cloud of a reach: overview, detail, predicted sigma, range, and the twin's bank as a camera sees it."""

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, Normalize, PowerNorm
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from thalweg.core import AnyArray, ArrayF, ArrayU8, GeometryError, Trajectory, iter_laz
from thalweg.figures import (
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
TICK_APART: Final = 0.055
"""Least distance of two ticks of a bent colour scale, as a share of its length."""
STRIP: Final = 0.09
"""Free strip below the picture of a reach, for scale bar and axes, as a share of the width."""
_LEAST_MM: Final = 34.0
"""Least height of a panel: its label has some words."""
STRAYS: Final = 30
"""Most points above the upper edge of a detail that are taken for strays."""


# ---------------------------------------------------------------- overview and detail (P1 Fig. 4 and 5)


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
    colours: Colormap | None,
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
    colours, limits : colour scale of the splat's values; None: they are colours (`pack_rgb`).
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
    if colours is None:
        return
    ends = factor * limits[0], factor * limits[1]
    figure.colorbar(
        ScalarMappable(PowerNorm(gamma, *ends), colours),
        ax=ax,
        label=label,
        aspect=25,
        shrink=0.9,
        pad=0.01,
        extend="both",
        ticks=None if gamma == 1.0 else bent_ticks(ends, gamma),
        format=None if gamma == 1.0 else "{x:g}",
    )


def bent_ticks(limits: tuple[float, float], gamma: float) -> list[float]:
    """Round values that fill a bent colour scale: the roundest first, then what fits between them.

    Examples
    --------
    >>> bent_ticks((0.0, 30.0), 0.5)
    [0.0, 0.2, 1.0, 2.0, 3.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0]
    """
    low, high = limits
    unit, top = 10.0 ** np.floor(np.log10(high - low)), high
    ticks: list[float] = []
    places: list[float] = []
    for step in unit * np.array([1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01]):
        for k in range(int(np.ceil(low / step - 1e-9)), int(np.floor(top / step + 1e-9)) + 1):
            place = max((k * step - low) / (high - low), 0.0) ** gamma
            if all(abs(place - other) >= TICK_APART for other in places):
                ticks.append(round(float(k * step), 9) + 0.0)
                places.append(place)
        if step == 0.5 * unit and len(ticks) > 1:
            # Finer ones only at the lower end, which the bend stretches.
            top = sorted(ticks)[1]
    return sorted(ticks)


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
    twin: bool = False,
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
    twin : true if the digital twin made the data.

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
    figure = new_figure(len(looks) * each_mm + 26.0, head, twin=twin)
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
    figure.colorbar(
        ScalarMappable(Normalize(*limits), INTENSITY_MAP),
        ax=ax,
        aspect=25,
        pad=0.01,
        extend="both",
        label=f"intensity   ({percentiles[0]:g} to {percentiles[1]:g} %)",
    )
    return figure


def _splat_of(points_wcs_m: ArrayF) -> Splat[ObliqueView]:
    splat = Splat(ObliqueView.fit(points_wcs_m))
    splat.add(points_wcs_m, points_wcs_m[:, 2])
    return splat


def _show(
    ax: Axes,
    splat: Splat[ObliqueView],
    colours: Colormap | None,
    limits: tuple[float, float],
    *,
    shading: float,
    noise_m: float = 0.0,
    gamma: float = 1.0,
    extent: tuple[float, float, float, float] | None = None,
) -> None:
    # The splat's own scale is linear: the table bends.
    table = None if colours is None else colours(np.linspace(0, 1, 4096) ** gamma)[:, :3]
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
    tips = size * view.axes[:2].T * np.array([1.0, -1.0])
    texts = tips * (1.0 + 0.4 * size / np.maximum(np.linalg.norm(tips, axis=1, keepdims=True), 1e-6 * size))
    for k in range(3):
        # Axes that fall on one line have their names on either side of it.
        crowd = np.linalg.norm(texts - texts[k], axis=1) < 0.6 * size
        if crowd.sum() > 1:
            texts[crowd, 0] += 0.3 * size * np.linspace(-1.0, 1.0, int(crowd.sum()))
    for tip, text, name in zip(origin + tips, origin + texts, "ENU", strict=True):
        ax.annotate(
            "",
            xy=(tip[0], tip[1]),
            xytext=(origin[0], origin[1]),
            annotation_clip=False,
            arrowprops={"arrowstyle": "-|>", "lw": 0.9, "color": "black", "shrinkA": 0, "shrinkB": 0},
        )
        ax.text(text[0], text[1], name, fontsize=7, ha="center", va="center", gid=f"axis-{name}")


def draw_cloud_detail(*, points: Path, trajectory: Path, title: str, twin: bool) -> Figure:
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
        twin=twin,
    )


def draw_cloud_overview(*, points: Path, trajectory: Path, title: str, twin: bool) -> Figure:
    """Cloud and trajectory -> oblique view of the reach."""
    sample, track = sample_cloud(points, 500_000)["xyz_m"], Trajectory.read(trajectory)
    splat = Splat(ObliqueView.fit(sample, azimuth_rad=bankward_azimuth(sample, track)))
    for chunk in iter_laz(points, 1_000_000):
        splat.add(chunk["xyz_m"], chunk["xyz_m"][:, 2])
    return cloud_overview(splat, track, title=f"Point cloud of the reach: {title}", twin=twin)


def draw_coloured_reach(*, points: Path, trajectory: Path, title: str, twin: bool) -> Figure:
    """Coloured cloud and trajectory -> oblique view of the reach in colour and by intensity."""
    sample, track = sample_cloud(points, 500_000), Trajectory.read(trajectory)
    view = ObliqueView.fit(sample["xyz_m"], azimuth_rad=bankward_azimuth(sample["xyz_m"], track))
    colour, intensity = Splat(view), Splat(view)
    for chunk in iter_laz(points, 1_000_000):
        colour.add(chunk["xyz_m"], pack_rgb((chunk["rgb"] >> 8).astype(np.uint8)))
        intensity.add(chunk["xyz_m"], chunk["intensity"])
    return coloured_reach(
        colour,
        intensity,
        robust_limits(sample["intensity"], 2.0, 98.0),
        track,
        title=f"Cloud of the reach in colour and by intensity: {title}",
        twin=twin,
    )


@styled
def coloured_reach(
    colour: Splat[ObliqueView],
    intensity: Splat[ObliqueView],
    limits: tuple[float, float],
    trajectory: Trajectory,
    *,
    title: str,
    twin: bool,
) -> Figure:
    """The cloud of the reach seen obliquely from above, twice: in the colours of photographs, by intensity.

    Parameters
    ----------
    colour, intensity : the same view with packed colours and with intensities.
    limits : intensities at the ends of the colour scale.
    trajectory : track of the boat.
    title : first words of the title.
    twin : true if the digital twin made the data.
    """
    each_mm = max(reach_mm(colour.view), 50.0)
    head = f"{title}, n = {count(colour.n_drawn)} points"
    figure = new_figure(2 * each_mm + 18.0, head, twin=twin)
    above, below = figure.subplots(2, 1)
    draw_reach(figure, above, colour, None, (0.0, 1.0), label="", trajectory=trajectory, shading=0.6)
    label = "intensity   (2 to 98 %)"
    draw_reach(
        figure, below, intensity, INTENSITY_MAP, limits, label=label, trajectory=trajectory, shading=0.6
    )
    above.set_title("a  colours of the photographs; mid-grey: none shows the point", loc="left", fontsize=8)
    below.set_title("b  intensity of the lidar return", loc="left", fontsize=8)
    return figure


# ---------------------------------------------------------------- by predicted sigma and by range


# ---------------------------------------------------------------- the bank as a camera on the boat would see
# it
