"""Set-up of a scan with marker panel and standing camera: the whole, and three images (P4 Fig. 8 and 17)."""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.core import ArrayF, Camera, InputError, read_parquet
from thalweg.figures import BLUE, GREEN, PURPLE, VERMILION, new_figure, plural, styled
from thalweg.figures.calibration import Oblique
from thalweg.lightsheet.figures.views import GLASS_COLOUR, LIGHT_COLOUR, Space, dots, need, pair
from thalweg.lightsheet.optics import Sensor, read_sensor
from thalweg.lightsheet.poses import SensorPoses, read_panel, read_poses, read_standing_camera, sigmas_at

POINTS: Final = ("file", "x_m", "y_m", "z_m")
STYLES: Final = ((VERMILION, "o"), (GREEN, "s"), (BLUE, "^"))
"""Colour and marker of the panel's marks in the first, the middle and the last image."""

_MOST_POINTS: Final = 6000
_MM_PER_M: Final = 1e3


@styled
def scan_setup(
    sensor: Sensor,
    poses: SensorPoses,
    panel_m: ArrayF,
    camera: Camera,
    points: pd.DataFrame,
    *,
    title: str = "Set-up of a scan",
) -> Figure:
    """Standing camera, panel, sensor and scanned points; places of panel, camera and laser at three images.

    Parameters
    ----------
    sensor : calibrated.
    poses : of the sensor in the frame of the standing camera.
    panel_m : (k, 3) marks of the panel in lcs, metres.
    camera : the standing one.
    points : columns `POINTS`, of the scan in the frame of the standing camera.
    title : first words of the title.

    Raises
    ------
    InputError : no pose, or an empty table, or one that lacks columns.
    """
    need(points, POINTS, "points of the scan")
    there = np.flatnonzero([not reason for reason in poses.reasons])
    if not len(there):
        raise InputError("no pose", expected="poses of the sensor", where="set-up of a scan")
    three = there[np.unique([0, len(there) // 2, len(there) - 1])]
    place_mm, turn_deg = sigmas_at(poses, _MM_PER_M * panel_m.mean(axis=0))
    sigma_mm, sigma_deg = (np.median(sigma[there].max(axis=1)) for sigma in (place_mm, turn_deg))
    head = (
        f"{title}: {plural(len(there), 'pose')} by {plural(len(panel_m), 'mark')}, median of the largest "
        f"sigma {sigma_mm:.3f} mm and {sigma_deg:.4f}° "
        "(P4 7.3: 0.05 mm, 0.01°)"
    )
    figure = new_figure(120.0, head)
    grid = figure.add_gridspec(2, 2, height_ratios=[1.0, 1.1])
    _whole(
        figure.add_subplot(grid[0, :]), sensor, poses, int(three[len(three) // 2]), panel_m, camera, points
    )
    seen, above = figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1])
    _three(seen, sensor, poses, panel_m, three, (0, 1))
    seen.invert_yaxis()
    seen.set(title="b: as the camera sees it", xlabel="x / m", ylabel="y / m")
    _three(above, sensor, poses, panel_m, three, (0, 2))
    above.set(title="c: from above", xlabel="x / m", ylabel="z, along the view / m")
    figure.legend(*above.get_legend_handles_labels(), loc="outside lower right", ncols=5)
    return figure


def _three(
    ax: Axes, sensor: Sensor, poses: SensorPoses, panel_m: ArrayF, three: ArrayF, axes: tuple[int, int]
) -> None:
    """Marks, camera and laser at some images in two coordinates of the standing camera's frame."""
    devices = np.stack([sensor.camera_origin_lcs_mm, sensor.sheet.origin_lcs_mm]) / _MM_PER_M
    for k, (colour, marker) in zip(three, STYLES, strict=False):
        marks, both = (
            (part @ poses.R_target_lcs[k].T + poses.shift_m[k])[:, axes] for part in (panel_m, devices)
        )
        dots(ax, *pair(marks.T), colour, marker, ms=2.4, zorder=3, label=f"marks, image {k + 1}")
        ax.plot(*both.T, color=colour, lw=0.6, zorder=2)
        dots(ax, *pair(both[:1].T), colour, "x", ms=6, zorder=4)
        dots(ax, *pair(both[1:].T), colour, "s", ms=5, mfc="none", mew=1.0, zorder=4)
    dots(ax, [], [], "black", "x", ms=6, label="camera")
    dots(ax, [], [], "black", "s", ms=5, mfc="none", mew=1.0, label="laser")
    ax.set_aspect("equal", adjustable="datalim")
    ax.grid()


def _whole(
    ax: Axes,
    sensor: Sensor,
    poses: SensorPoses,
    image: int,
    panel_m: ArrayF,
    camera: Camera,
    points: pd.DataFrame,
) -> None:
    """The set-up at one image, in lcs."""

    def in_sensor(points_m: ArrayF) -> ArrayF:
        """Points (n, 3) of the standing camera's frame in lcs, millimetres."""
        return np.asarray(_MM_PER_M * (points_m - poses.shift_m[image]) @ poses.R_target_lcs[image])

    eye, marks = in_sensor(np.zeros((1, 3)))[0], _MM_PER_M * panel_m
    way = marks.mean(axis=0) - eye
    # from the side of the line between standing camera and panel, a little from behind
    azimuth = float(np.rad2deg(np.arctan2(way[0], way[1]))) + 62.0
    space = Space(ax, Oblique(azimuth_deg=azimuth, elevation_deg=16.0))
    xyz = in_sensor(points[["x_m", "y_m", "z_m"]].to_numpy()[:: max(1, len(points) // _MOST_POINTS)])
    space.dots(xyz, "0.35", ms=0.8, zorder=2)
    laser, own = sensor.sheet.origin_lcs_mm, sensor.camera_origin_lcs_mm
    low, high = np.minimum(laser, own) - 40.0, np.maximum(laser, own) + 40.0
    for z in (-sensor.window.thickness_mm, 0.0):
        space.plate(low, high, z, GLASS_COLOUR, alpha=0.5, zorder=5)
    for beam in sensor.sheet.beams(np.deg2rad([-20.0, 20.0])):
        space.path(np.stack([laser, laser - beam * laser[2] / beam[2]]), LIGHT_COLOUR, lw=1.0, zorder=6)
    space.device(laser, "laser")
    space.device(own, "camera")
    space.dots(marks, STYLES[1][0], "o", zorder=8)
    space.words(marks.mean(axis=0), "   panel")
    width, height = camera.size_px
    corners = camera.rays(np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]))
    far_m = float(np.linalg.norm(way)) / _MM_PER_M
    frame = in_sensor(corners / corners[:, 2:] * (0.35 * far_m))
    for edge in [*(np.stack([eye, corner]) for corner in frame), np.concatenate([frame, frame[:1]])]:
        space.path(edge, PURPLE, lw=0.8, zorder=8)
    space.path(in_sensor(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, far_m]])), PURPLE, lw=0.8, ls=":", zorder=7)
    space.dots(eye, PURPLE, "o", ms=7, mfc="none", mew=1.6, zorder=9)
    space.words(eye, "   standing camera")
    space.finish(f"a: the whole; standing camera and panel are {far_m:.2f} m apart")


def draw_scan_setup(
    *, sensor: Path, poses: Path, panel: list[Path], camera: list[Path], points: Path, scan: str, title: str
) -> Figure:
    """Poses of a scan, panel, standing camera, sensor and cloud -> figure of the set-up."""
    return scan_setup(
        read_sensor(sensor),
        read_poses(poses),
        read_panel(panel[0]).points_pcs,
        read_standing_camera(camera[0]),
        read_parquet(points),
        title=f"{title}, scan of {scan.replace('_', ' ')}",
    )
