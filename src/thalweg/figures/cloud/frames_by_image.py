"""The cloud by the number of the image that oriented each point (P2 Fig. 11)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure

from thalweg.core import ArrayF, ArrayI, GeometryError, InputError, iter_laz
from thalweg.figures import (
    HALO,
    TIME_MAP,
    WIDTH_MM,
    colour_bar,
    count,
    marks_in_free_corners,
    new_figure,
    plural,
    styled,
)
from thalweg.figures.cloud.views import ObliqueView, Splat
from thalweg.images.model import ImagePoses
from thalweg.lidar import sample_cloud

IMAGE_MAP: Final[Colormap] = ListedColormap(TIME_MAP(np.linspace(0.0, 0.92, 256)), "thalweg_image")
"""Without the pale end, which vanishes on paper."""

_LABELS: Final = 8
"""Images that are named in the plan, at most."""
_SIDE_MM: Final = 30.0
"""Least height of the side view on paper."""
_SAMPLE: Final = 500_000


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameImages:
    """Oriented images in order of time: ``number`` (n,) counted from 1 over all images in order of time,
    ``t_gps_s`` (n,), ``centre_wcs_m`` (n, 3); ``total`` number of images with a time.
    """

    number: ArrayI
    t_gps_s: ArrayF
    centre_wcs_m: ArrayF
    total: int

    @classmethod
    def of(cls, poses: ImagePoses) -> Self:
        """From a table of poses.

        Raises
        ------
        InputError : no image has both pose and time.
        """
        timed = np.flatnonzero(np.isfinite(poses.t_gps_s))
        timed = timed[np.argsort(poses.t_gps_s[timed], kind="stable")]
        known = poses.oriented[timed]
        if not known.any():
            raise InputError(
                f"none of {len(poses.images)} images has a pose and a time",
                expected="oriented images with times",
                cure="Run time_images before",
            )
        rows = timed[known]
        return cls(
            number=np.flatnonzero(known) + 1,
            t_gps_s=poses.t_gps_s[rows],
            centre_wcs_m=poses.centre_wcs_m[rows],
            total=len(timed),
        )

    def nearest(self, t_gps_s: ArrayF) -> ArrayI:
        """Index (m,) of the image that is nearest in time to each point."""
        right = np.clip(np.searchsorted(self.t_gps_s, t_gps_s), 0, len(self.t_gps_s) - 1)
        left = np.maximum(right - 1, 0)
        nearer = np.abs(t_gps_s - self.t_gps_s[left]) <= np.abs(self.t_gps_s[right] - t_gps_s)
        return np.asarray(np.where(nearer, left, right))


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameViews:
    """The cloud from above and from the water, each point with the number of its image; ``points`` (n,) of
    each image. From the water only what lies beyond the middle of the images' places is seen.
    """

    plan: Splat[ObliqueView]
    side: Splat[ObliqueView]
    points: ArrayI

    @classmethod
    def of_cloud(cls, cloud: Path, images: FrameImages) -> Self:
        """From a LAZ cloud in the local frame, chunk by chunk.

        Parameters
        ----------
        cloud : LAZ.
        images : that oriented it.
        """
        sample = sample_cloud(cloud, _SAMPLE)["xyz_m"]
        azimuth_rad = _bankward(sample, images.centre_wcs_m)
        both = np.concatenate([sample, images.centre_wcs_m])
        views = cls(
            plan=Splat(ObliqueView.fit(both, azimuth_rad=0.0, elevation_rad=np.pi / 2, width_px=1800)),
            side=Splat(ObliqueView.fit(sample, azimuth_rad=azimuth_rad, elevation_rad=0.0, width_px=1800)),
            points=np.zeros(len(images.number), dtype=np.int64),
        )
        for chunk in iter_laz(cloud, 1_000_000):
            views.add(chunk["xyz_m"], chunk["t_gps_s"], images)
        return views

    def add(self, points_wcs_m: ArrayF, t_gps_s: ArrayF, images: FrameImages) -> None:
        """Draw points (n, 3) with their times (n,)."""
        index = images.nearest(t_gps_s)
        self.points[:] += np.bincount(index, minlength=len(self.points))
        number = images.number[index].astype(np.float64)
        self.plan.add(points_wcs_m, number)
        away = self.side.view.axes[2]
        beyond = (points_wcs_m - images.centre_wcs_m.mean(axis=0)) @ away > 0
        self.side.add(points_wcs_m[beyond], number[beyond])


@styled
def frames_by_image(
    views: FrameViews, images: FrameImages, *, title: str = "Lidar points by the image that orients them"
) -> Figure:
    """The cloud from above and from the water, coloured by image number, with the places of the images.

    Parameters
    ----------
    views : of the cloud.
    images : the same that were given to the views.
    title : first words of the title.

    Raises
    ------
    GeometryError : no point in the picture.
    """
    if not views.plan.n_drawn:
        raise GeometryError("no point to draw", expected="a cloud of the same survey as the images")
    frames = int(np.sum(views.points > 0))
    head = f"{title}, n = {count(frames)} frames, n = {count(views.plan.n_added)} points"
    width_mm = 0.84 * WIDTH_MM
    plan_mm, side_mm = (
        width_mm * view.height_px / view.width_px for view in (views.plan.view, views.side.view)
    )
    side_mm = max(side_mm, _SIDE_MM)
    figure = new_figure(plan_mm + side_mm + 34.0, head)
    upper, lower = figure.subplots(2, 1, height_ratios=[plan_mm, side_mm])
    limits = float(images.number[0]), max(float(images.number[-1]), float(images.number[0]) + 1.0)
    _show(upper, views.plan, limits)
    _places(upper, images, limits, views.points)
    upper.set(xlabel="east / m", ylabel="north / m", title=_words(views, images))
    _show(lower, views.side, limits)
    lower.set(xlabel="along the bank, to the right / m", ylabel="height / m")
    degrees = float(np.rad2deg(views.side.view.azimuth_rad)) % 360.0
    lower.set_title(f"from the water towards {degrees:.0f}°")
    colour_bar([upper, lower], IMAGE_MAP, limits, "image number", aspect=35, pad=0.01)
    return figure


def _show(ax: Axes, splat: Splat[ObliqueView], limits: tuple[float, float]) -> None:
    view = splat.view
    table = IMAGE_MAP(np.linspace(0, 1, 1024))[:, :3]
    picture = splat.image(table, limits, radius_px=splat.radius_px(), shading=0.5)
    right, top = view.left_m + view.width_px * view.pixel_m, view.top_m - view.height_px * view.pixel_m
    ax.imshow(picture, extent=(view.left_m, right, top, view.top_m), interpolation="antialiased")
    ax.set_aspect("equal")


def _places(ax: Axes, images: FrameImages, limits: tuple[float, float], points: ArrayI) -> None:
    """Where the images were taken, filled if lidar points belong to them, some with their number."""
    en = images.centre_wcs_m[:, :2]
    east, north = en.T
    ax.plot(east, north, color="black", lw=0.5, zorder=3)
    ax.scatter(
        east,
        north,
        c=images.number,
        cmap=IMAGE_MAP,
        norm=Normalize(*limits),
        s=14,
        edgecolors="black",
        lw=0.5,
        zorder=4,
    )
    without = points == 0
    if without.any():
        ax.scatter(
            east[without], north[without], s=14, facecolors="white", edgecolors="black", lw=0.5, zorder=5
        )
    step = max(1, -(-len(en) // _LABELS))
    for k in range(0, len(en), step):
        ax.annotate(
            str(int(images.number[k])),
            en[k],
            xytext=(0, 5),
            textcoords="offset points",
            fontsize=7,
            ha="center",
            zorder=6,
            path_effects=HALO,
        )
    marks_in_free_corners(ax, en)


def _words(views: FrameViews, images: FrameImages) -> str:
    with_points = views.points[views.points > 0]
    text = f"from above; {count(len(images.number))} of {plural(images.total, 'image')} oriented"
    empty = len(views.points) - len(with_points)
    text += f", {count(empty)} of them without points" if empty else ""
    return text + f"; median {count(np.median(with_points))} points a frame"


def _bankward(points_wcs_m: ArrayF, centres_wcs_m: ArrayF) -> float:
    """Azimuth across the track of the images, towards the side where most points are."""
    en = centres_wcs_m[:, :2] - centres_wcs_m[:, :2].mean(axis=0)
    _, vectors = np.linalg.eigh(en.T @ en)
    across = vectors[:, 0]
    side = float(np.median((points_wcs_m[:, :2] - centres_wcs_m[:, :2].mean(axis=0)) @ across))
    east, north = across if side >= 0 else -across
    return float(np.arctan2(east, north))


def draw_frames_by_image(*, points: Path, poses: Path, title: str) -> Figure:
    """Cloud by the camera and image poses -> the cloud by image number."""
    images = FrameImages.of(ImagePoses.read(poses))
    return frames_by_image(
        FrameViews.of_cloud(points, images),
        images,
        title=f"Lidar points by the image that orients them: {title}",
    )
