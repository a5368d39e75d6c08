"""Set-up of a scan with marker panel and standing camera: the whole, and three images (P4 Fig. 8 and 17)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from cmcrameri import cm
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from thalweg.core import ArrayF, Camera, InputError, read_parquet
from thalweg.figures import BLUE, GREEN, PURPLE, VERMILION, new_figure, plural, styled
from thalweg.figures.calibration import Oblique
from thalweg.lightsheet.figures.views import (
    GLASS_COLOUR,
    LIGHT_COLOUR,
    axes_cross,
    fill_oblique,
    need,
    plate,
    words_oblique,
)
from thalweg.lightsheet.optics import Sensor, read_sensor
from thalweg.lightsheet.poses import SensorPoses, read_panel, read_poses, read_standing_camera, sigmas_at

POINTS: Final = ("file", "x_m", "y_m", "z_m")
STYLES: Final = ((VERMILION, "o"), (GREEN, "s"), (BLUE, "^"))
"""Colour and marker of the panel's marks in the first, the middle and the last image."""

VIEW: Final = Oblique(azimuth_deg=62.0, elevation_deg=24.0)

_MOST_POINTS: Final = 6000
_MM_PER_M: Final = 1e3
_CAMERA_COLOUR: Final = PURPLE


@styled
def scan_setup(
    sensor: Sensor,
    poses: SensorPoses,
    panel_m: ArrayF,
    camera: Camera,
    points: pd.DataFrame,
    *,
    title: str = "Set-up of a scan",
    twin: bool = False,
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
    twin : true if the digital twin made the recordings.

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
    figure = new_figure(138.0, head, twin=twin)
    grid = figure.add_gridspec(2, 3, height_ratios=[1.0, 1.25], width_ratios=[1.25, 1.0, 1.0])
    middle = int(three[len(three) // 2])
    seen_from = InSensor(R=poses.R_target_lcs[middle], shift_m=poses.shift_m[middle])
    _whole(figure.add_subplot(grid[0, :]), sensor, seen_from, panel_m, camera, points)
    detail = figure.add_subplot(grid[1, 0])
    shades = _detail(detail, sensor, seen_from, points)
    figure.colorbar(shades, ax=detail, label="number of the line", location="bottom", aspect=30, pad=0.02)
    seen, above = figure.add_subplot(grid[1, 1]), figure.add_subplot(grid[1, 2])
    _three(seen, sensor, poses, panel_m, three, (0, 1))
    seen.invert_yaxis()
    seen.set(title="c: as the camera sees it", xlabel="x / m", ylabel="y / m")
    _three(above, sensor, poses, panel_m, three, (0, 2))
    above.set(title="d: from above", xlabel="x / m", ylabel="z, along the view / m")
    figure.legend(*above.get_legend_handles_labels(), loc="outside lower right", ncols=5)
    return figure


@dataclass(frozen=True, slots=True, kw_only=True)
class InSensor:
    """From the frame of the standing camera (metres) to lcs at one image (millimetres)."""

    R: ArrayF
    shift_m: ArrayF

    def apply(self, points_m: ArrayF) -> ArrayF:
        """Points (n, 3) in lcs, millimetres."""
        return np.asarray(_MM_PER_M * (points_m - self.shift_m) @ self.R)

    def scan(self, points: pd.DataFrame) -> tuple[ArrayF, ArrayF]:
        """Some thousand points (n, 3) of a scan, and the numbers (n,) of their lines from 1."""
        step = max(1, -(-len(points) // _MOST_POINTS))
        xyz = points[["x_m", "y_m", "z_m"]].to_numpy(np.float64)[::step]
        number = pd.factorize(points["file"])[0][::step].astype(np.float64)
        return self.apply(xyz), np.asarray(1.0 + number)


def _three(
    ax: Axes, sensor: Sensor, poses: SensorPoses, panel_m: ArrayF, three: ArrayF, axes: tuple[int, int]
) -> None:
    """Marks, camera and laser at some images in two coordinates of the standing camera's frame."""
    i, j = axes
    camera, laser = sensor.camera_origin_lcs_mm / _MM_PER_M, sensor.sheet.origin_lcs_mm / _MM_PER_M
    for k, (colour, marker) in zip(three, STYLES, strict=False):
        marks, both = (
            part @ poses.R_target_lcs[k].T + poses.shift_m[k] for part in (panel_m, np.stack([camera, laser]))
        )
        ax.plot(
            marks[:, i],
            marks[:, j],
            ls="none",
            marker=marker,
            ms=2.4,
            mew=0,
            color=colour,
            zorder=3,
            gid=f"marks {k}",
            label=f"marks, image {k + 1}",
        )
        ax.plot(both[:, i], both[:, j], color=colour, lw=0.6, zorder=2)
        ax.plot(both[0, i], both[0, j], marker="x", ms=6, mew=1.4, color=colour, zorder=4, gid=f"camera {k}")
        ax.plot(both[1, i], both[1, j], marker="s", ms=5, mfc="none", mec=colour, zorder=4, gid=f"laser {k}")
    ax.plot([], [], ls="none", marker="x", color="black", label="camera")
    ax.plot([], [], ls="none", marker="s", mfc="none", color="black", label="laser")
    ax.set_aspect("equal", adjustable="datalim")
    ax.grid()


def _whole(
    ax: Axes, sensor: Sensor, here: InSensor, panel_m: ArrayF, camera: Camera, points: pd.DataFrame
) -> None:
    eye, marks = here.apply(np.zeros((1, 3)))[0], _MM_PER_M * panel_m
    view = Oblique(azimuth_deg=_beside(eye, marks.mean(axis=0)), elevation_deg=16.0)
    xyz, _ = here.scan(points)
    ax.plot(*view.apply(xyz)[0].T, ls="none", marker=".", ms=0.8, mew=0, color="0.35", gid="scan", zorder=2)
    _sensor(ax, view, sensor)
    ax.plot(
        *view.apply(marks)[0].T,
        ls="none",
        marker="o",
        ms=2.0,
        mew=0,
        color=STYLES[1][0],
        zorder=8,
        gid="panel",
    )
    corners = frame_corners(camera)
    far_m = float(np.linalg.norm(marks.mean(axis=0) - eye)) / _MM_PER_M
    cone = here.apply(corners / corners[:, 2:] * (0.35 * far_m))
    edges = [np.stack([eye, corner]) for corner in cone] + [np.concatenate([cone, cone[:1]])]
    for edge in edges:
        ax.plot(*view.apply(edge)[0].T, color=_CAMERA_COLOUR, lw=0.8, zorder=8)
    axis = here.apply(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, far_m]]))
    ax.plot(*view.apply(axis)[0].T, color=_CAMERA_COLOUR, lw=0.8, ls=":", zorder=7)
    ax.plot(
        *view.apply(eye)[0],
        marker="o",
        ms=7,
        mfc="none",
        mec=_CAMERA_COLOUR,
        mew=1.6,
        zorder=9,
        gid="standing camera",
    )
    words_oblique(ax, view, eye, "   standing camera")
    flat = view.apply(marks)[0]
    ax.annotate(
        "panel",
        (float(flat[:, 0].min()), float(flat[:, 1].mean())),
        xytext=(-4, 0),
        ha="right",
        textcoords="offset points",
        fontsize=7,
        va="center",
    )
    window = sensor.camera_origin_lcs_mm * [1.0, 1.0, 0.0]
    for words, place in (("sensor", window), ("object", xyz.mean(axis=0))):
        height = float(view.apply(place)[0][1])
        ax.annotate(
            words,
            (float(flat[:, 0].min()), height),
            xytext=(-30, 0),
            ha="right",
            va="center",
            textcoords="offset points",
            fontsize=7,
        )
    ax.set_aspect("equal")
    ax.margins(0.06)
    ax.axis("off")
    ax.set_title(f"a: the whole; standing camera and panel are {far_m:.2f} m apart")


def _detail(ax: Axes, sensor: Sensor, here: InSensor, points: pd.DataFrame) -> ScalarMappable:
    xyz, number = here.scan(points)
    shades = ScalarMappable(Normalize(1, max(float(number.max()), 2.0)), cm.batlow)
    flat = VIEW.apply(xyz)[0]
    ax.scatter(
        flat[:, 0], flat[:, 1], c=shades.to_rgba(number), s=0.8, lw=0, gid="lines", zorder=2, rasterized=True
    )
    _sensor(ax, VIEW, sensor)
    words_oblique(ax, VIEW, sensor.camera_origin_lcs_mm, "   camera")
    words_oblique(ax, VIEW, sensor.sheet.origin_lcs_mm, "   laser")
    axes_cross(ax, VIEW, np.array([xyz[:, 0].min(), xyz[:, 1].max() + 45.0, xyz[:, 2].min()]), 40.0)
    ax.set_aspect("equal")
    ax.margins(0.06)
    ax.axis("off")
    ax.set_title("b: sensor and points of the scan")
    return shades


def _sensor(ax: Axes, view: Oblique, sensor: Sensor) -> None:
    camera, laser = sensor.camera_origin_lcs_mm, sensor.sheet.origin_lcs_mm
    both = np.stack([camera, laser])
    low, high = both.min(axis=0) - 40.0, both.max(axis=0) + 40.0
    for z in (-sensor.window.thickness_mm, 0.0):
        fill_oblique(ax, view, plate(low, high, z), GLASS_COLOUR, alpha=0.5, zorder=5)
    edges = np.deg2rad([-20.0, 20.0])
    for beam in sensor.sheet.beams(edges):
        end = laser - beam * laser[2] / beam[2]
        ax.plot(*view.apply(np.stack([laser, end]))[0].T, color=LIGHT_COLOUR, lw=1.0, zorder=6)
    ax.plot(*view.apply(camera)[0], marker="x", ms=6, mew=1.5, color="black", zorder=9)
    ax.plot(*view.apply(laser)[0], marker="s", ms=5, color="black", zorder=9)


def _beside(eye: ArrayF, middle: ArrayF) -> float:
    """Azimuth of a view from the side of the line between standing camera and panel, a little from behind."""
    way = middle - eye
    return float(np.rad2deg(np.arctan2(way[0], way[1]))) + 62.0


def frame_corners(camera: Camera) -> ArrayF:
    """Directions (4, 3) in ccs of the corners of the picture."""
    width, height = camera.size_px
    return camera.rays(np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]))


def draw_scan_setup(
    *,
    sensor: Path,
    poses: Path,
    panel: list[Path],
    camera: list[Path],
    points: Path,
    scan: str,
    title: str,
    twin: bool,
) -> Figure:
    """Poses of a scan, panel, standing camera, sensor and cloud -> figure of the set-up."""
    return scan_setup(
        read_sensor(sensor),
        read_poses(poses),
        read_panel(panel[0]).points_pcs,
        read_standing_camera(camera[0]),
        read_parquet(points),
        title=f"{title}, scan of {scan.replace('_', ' ')}",
        twin=twin,
    )
