"""The terrestrial scan as it looks from one place (P2 Fig. 7), and a plan of where it lies."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Wedge
from matplotlib.ticker import FuncFormatter

from thalweg.core import AnyArray, ArrayF, GeometryError, Trajectory, iter_laz, read_json
from thalweg.figures import (
    BLUE,
    GREEN,
    HALO,
    ORANGE,
    PURPLE,
    RED,
    REFLECTANCE_MAP,
    SKY,
    VERMILION,
    WIDTH_MM,
    colour_bar,
    count,
    legend_below,
    marks_in_free_corners,
    new_figure,
    robust_limits,
    show_plan,
    styled,
)
from thalweg.figures.cloud import Splat, choose_segment
from thalweg.figures.survey import map_extent, track_of
from thalweg.lidar import sample_cloud

EYE_M: Final = 1.7
"""Height of the viewer above the INS of the boat."""

NEAREST_M: Final = 3.0
"""Points nearer to the viewpoint are left out: in equal angles they would hide half of the picture."""

LEAST_WIDTH_RAD: Final = np.deg2rad(40.0)
"""The view is at least as wide as this, if the cloud is."""

KEEP: Final = 0.97
"""Share of a sample within the picture along each axis."""

MARGIN: Final = 0.01
"""Free border, as a share of the width."""

LEAST_SHAPE: Final = 0.2
"""Least height over width. A long low bank is cut on both sides of its middle: at the ends it is seen along
itself, and the picture would be a thin strip."""

MOST_WIDTH_RAD: Final = np.deg2rad(110.0)
"""The view is not wider: farther aside a bank is seen along itself."""

STATION_COLOURS: Final = (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILION)

MAP_POINTS: Final = 60_000
"""Most points drawn on the plan."""

_MAP_MM: Final = 62.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PanoramaView:
    """A view of equal angles from one point: columns are azimuths, rows are elevations.

    Parameters
    ----------
    viewpoint_wcs_m : (3,) where the viewer is.
    left_rad : azimuth of the left edge, clockwise from north.
    top_rad : elevation of the upper edge above the horizon.
    pixel_rad : size of a pixel both ways.
    width_px, height_px : size of the picture.
    distance_m : typical distance of the scene.
    """

    viewpoint_wcs_m: ArrayF
    left_rad: float
    top_rad: float
    pixel_rad: float
    width_px: int
    height_px: int
    distance_m: float

    @property
    def pixel_m(self) -> float:
        """Size of a pixel at the typical distance."""
        return self.pixel_rad * self.distance_m

    @property
    def extent_deg(self) -> tuple[float, float, float, float]:
        """Azimuth of the left and right edge, elevation of the lower and upper one; right may exceed 360."""
        pixel = np.rad2deg(self.pixel_rad)
        left, top = float(np.rad2deg(self.left_rad)), float(np.rad2deg(self.top_rad))
        return left, float(left + pixel * self.width_px), float(top - pixel * self.height_px), top

    def project(self, points_wcs_m: ArrayF) -> ArrayF:
        """Column, row (pixel units, 0 at the upper left corner) and distance in metres, shape (n, 3)."""
        azimuth, elevation, distance = angles_from(self.viewpoint_wcs_m, points_wcs_m)
        column = np.mod(azimuth - self.left_rad, 2 * np.pi) / self.pixel_rad
        near = np.where(distance >= NEAREST_M, distance, np.nan)
        return np.stack([column, (self.top_rad - elevation) / self.pixel_rad, near], axis=1)

    @classmethod
    def fit(
        cls,
        sample_wcs_m: ArrayF,
        viewpoint_wcs_m: ArrayF,
        *,
        azimuth_rad: float | None = None,
        width_px: int = 1800,
    ) -> Self:
        """The view from a point that shows a cloud.

        Parameters
        ----------
        sample_wcs_m : (n, 3) the points or a sample of them; NaN are left out.
        viewpoint_wcs_m : (3,) where the viewer is.
        azimuth_rad : middle of the picture if the view has to be cut; that of the points by default.
        width_px : width of the picture.

        Raises
        ------
        GeometryError : no finite point farther than `NEAREST_M` from the viewer.
        """
        azimuth, elevation, distance = angles_from(viewpoint_wcs_m, sample_wcs_m)
        seen = np.isfinite(distance) & (distance >= NEAREST_M)
        if not seen.any():
            raise GeometryError(
                f"none of {len(sample_wcs_m)} points lies more than {NEAREST_M:g} m from the viewpoint",
                expected="a cloud to look at",
            )
        azimuth, elevation, distance = azimuth[seen], elevation[seen], distance[seen]
        middle = float(np.arctan2(np.sin(azimuth).mean(), np.cos(azimuth).mean()))
        aside = np.mod(azimuth - middle + np.pi, 2 * np.pi) - np.pi
        tail = 50.0 * (1.0 - KEEP)
        low, high, centre = (float(v) for v in np.percentile(aside, [tail, 100.0 - tail, 50.0]))
        bottom, top = (float(v) for v in np.percentile(elevation, [0.3, 99.9]))
        wide = max(high - low, 1e-3) * (1 + 2 * MARGIN)
        most = float(np.clip((top - bottom) / LEAST_SHAPE, LEAST_WIDTH_RAD, MOST_WIDTH_RAD))
        if wide > most:
            wide = most
            if azimuth_rad is not None:
                centre = float(np.mod(azimuth_rad - middle + np.pi, 2 * np.pi) - np.pi)
            turned = np.mod(aside - centre + np.pi, 2 * np.pi) - np.pi
            inside = np.abs(turned) <= 0.5 * wide
            if not inside.any():
                raise GeometryError(
                    f"no point within {np.rad2deg(0.5 * wide):.0f} degrees of the direction of view",
                    expected="a view that meets the cloud",
                )
            bottom, top = (float(v) for v in np.percentile(elevation[inside], [0.3, 99.9]))
            distance = distance[inside]
        else:
            centre = 0.5 * (low + high)
        pixel = wide / width_px
        high_px = int(np.clip(np.ceil((top - bottom) / pixel + 2 * MARGIN * width_px), 8, width_px))
        return cls(
            viewpoint_wcs_m=np.asarray(viewpoint_wcs_m, dtype=np.float64),
            left_rad=float(np.mod(middle + centre - 0.5 * wide, 2 * np.pi)),
            top_rad=0.5 * (bottom + top) + 0.5 * high_px * pixel,
            pixel_rad=pixel,
            width_px=width_px,
            height_px=high_px,
            distance_m=float(np.median(distance)),
        )


def angles_from(viewpoint_wcs_m: ArrayF, points_wcs_m: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Azimuth clockwise from north and elevation in radians, and distance in metres of points, (n,) each."""
    east, north, up = (np.asarray(points_wcs_m, dtype=np.float64) - viewpoint_wcs_m).T
    level = np.hypot(east, north)
    return np.arctan2(east, north), np.arctan2(up, level), np.hypot(level, up)


def viewpoint_on_track(sample_wcs_m: ArrayF, trajectory: Trajectory) -> tuple[ArrayF, float]:
    """A place on the boat's track opposite the densest part of a cloud, and the direction of view.

    Files of scans seldom tell where the scanner stood, and a merged cloud has no one centre. The river is
    where everything that the lidar surveys can be seen from. Of the track abreast of the densest stretch of
    bank the point farthest from that bank is taken: it shows most.

    Parameters
    ----------
    sample_wcs_m : (n, 3) the reference cloud or an even sample of it.
    trajectory : track of the boat.

    Returns
    -------
    viewpoint_wcs_m : (3,).
    azimuth_rad : across the river onto that bank, clockwise from north.

    Raises
    ------
    GeometryError : the cloud lies nowhere near the track.
    """
    bank = choose_segment(sample_wcs_m, trajectory, length_m=30.0)
    track = trajectory.position_wcs_m[trajectory.valid]
    along, away = bank.along_and_away(track)
    abreast = np.abs(along - 0.5 * bank.length_m)
    # On the water's side only. A zigzag passes the place on several legs: a metre farther off outweighs two
    # metres to the side, which half of the stretch bounds: farther aside one would look along the bank.
    near = (abreast <= max(0.5 * bank.length_m, float(abreast.min()) + 1.0)) & (away < 0)
    best = (
        int(np.argmin(np.where(near, away + 0.5 * abreast, np.inf)))
        if near.any()
        else int(np.argmin(abreast))
    )
    return np.asarray(track[best] + np.array([0.0, 0.0, EYE_M])), bank.azimuth_rad


@styled
def reference_view(
    splat: Splat[PanoramaView],
    sample_wcs_m: ArrayF,
    source: AnyArray,
    trajectory: Trajectory,
    *,
    shown: int,
    names: Mapping[int, str],
    counts: Mapping[int, int],
    title: str = "Terrestrial laser scan",
) -> Figure:
    """Panorama of equal angles, and a plan of the scans and the viewpoint.

    Parameters
    ----------
    splat : the scan that is shown, its values the intensities.
    sample_wcs_m : (n, 3) even sample of all scans, for the plan.
    source : (n,) number of the scan of each point of the sample.
    trajectory : track of the boat, for the plan.
    shown : number of the scan in the panorama.
    names : number of a scan -> its name; others have their number.
    counts : number of a scan -> its points.
    title : first words of the title.

    Raises
    ------
    GeometryError : no point in the panorama.
    """
    if not splat.n_drawn:
        raise GeometryError(
            f"none of {splat.n_added} points lies in the panorama", expected="a view that meets the scan"
        )
    view = splat.view
    of_all = f"n = {count(splat.n_drawn)} of {count(splat.n_added)} points"
    tall = float(np.clip(0.86 * WIDTH_MM * view.height_px / view.width_px, 22.0, 120.0))
    figure = new_figure(tall + _MAP_MM + 36.0, f"{title}, scan {names.get(shown, shown)}, {of_all}")
    upper, lower = figure.subplots(2, 1, height_ratios=[tall + 14.0, _MAP_MM])
    _draw_panorama(upper, splat)
    _draw_plan(lower, view, sample_wcs_m, source, trajectory, names, counts)
    legend_below(figure, lower)
    return figure


def _draw_panorama(ax: Axes, splat: Splat[PanoramaView]) -> None:
    radius = splat.radius_px()
    limits = robust_limits(splat.buffers(radius)[1], 1.0, 99.0)
    table = REFLECTANCE_MAP(np.linspace(0.0, 1.0, 256))[:, :3]
    picture = splat.image(table, limits, radius_px=radius, shading=0.35, background=(0.0, 0.0, 0.0))
    ax.imshow(picture, extent=splat.view.extent_deg, interpolation="antialiased", aspect="equal")
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value % 360:g}"))
    ax.set(xlabel="azimuth, clockwise from north / °", ylabel="elevation / °")
    look = {"location": "bottom", "pad": 0.02, "aspect": 50, "shrink": 0.7, "extend": "both"}
    colour_bar(ax, REFLECTANCE_MAP, limits, "intensity as the files state it", **look)


def _draw_plan(
    ax: Axes,
    view: PanoramaView,
    sample: ArrayF,
    source: AnyArray,
    trajectory: Trajectory,
    names: Mapping[int, str],
    counts: Mapping[int, int],
) -> None:
    eye = view.viewpoint_wcs_m
    track = track_of(trajectory)
    places = np.concatenate([track[trajectory.valid], eye[None, :2]])
    step = max(1, len(sample) // MAP_POINTS)
    points, which = sample[::step, :2], source[::step]
    # A fixed shuffle: no scan lies on top of the others.
    order = np.argsort((np.arange(len(points)) * 2_654_435_761) % 2**32)
    colours = {int(k): STATION_COLOURS[i % len(STATION_COLOURS)] for i, k in enumerate(np.unique(source))}
    drawn = [colours[int(k)] for k in which[order]]
    ax.scatter(points[order, 0], points[order, 1], c=drawn, s=0.5, lw=0, alpha=0.6, rasterized=True)
    for k, colour in colours.items():
        ax.plot([], [], "s", color=colour, label=f"scan {names.get(k, k)}, n = {count(counts[k])}")
    ax.plot(*track.T, color="black", lw=0.9, label="track of the boat", gid="track", path_effects=HALO)
    label = "viewpoint of the upper picture, on the track"
    ax.plot(*eye[:2], "^", ms=7, mfc=RED, mec="white", mew=0.8, zorder=6, label=label)
    left, right, _, _ = view.extent_deg
    # Wedges turn anticlockwise from east, azimuths clockwise from north.
    sector = Wedge((float(eye[0]), float(eye[1])), 1.3 * view.distance_m, 90.0 - right, 90.0 - left)
    sector.set(facecolor=(*to_rgb(RED), 0.1), edgecolor=RED, linewidth=0.8, zorder=2)
    ax.add_patch(sector)
    show_plan(ax, *map_extent(places, sample))
    marks_in_free_corners(ax, np.concatenate([points, places]))


def draw_reference_view(*, reference: Path, integrity: Path, trajectory: Path, title: str) -> Figure:
    """Reference cloud and trajectory -> the terrestrial scan as it looks from the river."""
    sample, track = sample_cloud(reference, 500_000), Trajectory.read(trajectory)
    source = sample["point_source_id"]
    viewpoint, azimuth_rad = viewpoint_on_track(sample["xyz_m"], track)
    view = PanoramaView.fit(sample["xyz_m"], viewpoint, azimuth_rad=azimuth_rad)
    column, row, _ = view.project(sample["xyz_m"]).T
    seen = (column >= 0) & (column < view.width_px) & (row >= 0) & (row < view.height_px)
    # The scan with most points in the picture; mixed scans would show each other's shadows filled.
    shown = int(np.argmax(np.bincount(source[seen])))
    splat, n = Splat(view), np.zeros(2**16, dtype=np.int64)
    for chunk in iter_laz(reference, 1_000_000):
        n += np.bincount(chunk["point_source_id"], minlength=len(n))
        part = chunk["point_source_id"] == shown
        splat.add(chunk["xyz_m"][part], chunk["intensity"][part])
    files = read_json(integrity)["files"]
    return reference_view(
        splat,
        sample["xyz_m"],
        source,
        track,
        shown=shown,
        counts=dict(enumerate(n.tolist())),
        names={number: Path(file).stem for number, file in enumerate(files, start=1)},
        title=f"Terrestrial laser scan: {title}",
    )
