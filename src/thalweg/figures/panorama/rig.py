"""A calibrated rig: where its lenses sit and how well that is known, and residuals over the angle of view."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from scipy.interpolate import LinearNDInterpolator

from thalweg.calibration import Rig as CalibratedRig, read_rig, read_views
from thalweg.calibration.field import read_points, resect
from thalweg.core import ArrayF, ArrayU8, Camera, Rigid
from thalweg.core.calibration import read_calibration
from thalweg.figures import BLUE, GREY, VERMILION, count, new_figure, styled
from thalweg.ingest.photos import find_images
from thalweg.panorama import compose, default_width_px, pixels_of
from thalweg.settings.sections import Rig

_HALF_DEG: Final = 15.0
COLOURS: Final = {"front": BLUE, "back": VERMILION}
_CONFIDENCE: Final = 2.4477
"""Half axes of an ellipse that holds 95 % of a plane normal error, in sigmas."""


def draw_rig_sketch(*, calibration: Path, title: str, twin: bool) -> Figure:
    """Calibration of a rig -> its lenses from above and from the side, with ellipses."""
    found = read_calibration(calibration)
    return rig_sketch(found.pose("back_front"), title=f"Rig of two lenses: {title}", twin=twin)


@styled
def rig_sketch(T_back_front: Rigid, *, title: str, twin: bool) -> Figure:
    """Both projection centres and views in the frame of the front lens.

    Parameters
    ----------
    T_back_front : relative orientation with covariance.
    title : first words of the title.
    twin : true if the digital twin made the data.
    """
    back = T_back_front.inverse()
    base_mm = 1e3 * float(np.linalg.norm(back.shift_m))
    along = back.shift_m / np.linalg.norm(back.shift_m)
    sigma_base = 1e3 * float(np.sqrt(along @ back.cov[:3, :3] @ along))
    apart = float(np.rad2deg(np.arccos(np.clip(T_back_front.R[2, 2], -1, 1))))
    sigma_turn = np.rad2deg(T_back_front.sigma_rotation_rad)
    # ellipses so large that they are seen
    sigma_mm = 1e3 * np.sqrt(np.diag(back.cov)[:3])
    times = 10 ** max(0, int(np.floor(np.log10(0.25 * base_mm / (_CONFIDENCE * sigma_mm.max())))))
    words = (
        f"{title}, base {base_mm:.2f} mm (sigma {sigma_base:.2f}), views {apart:.3f} degrees apart "
        f"(sigma {sigma_turn[:2].max():.3f})"
    )
    figure = new_figure(85.0, words, twin=twin)
    axes = figure.subplots(1, 2, sharey=True)
    for ax, across, name in zip(axes, (0, 1), ("from above", "from the right"), strict=True):
        for lens, place in {"front": Rigid(R=np.eye(3), shift_m=np.zeros(3)), "back": back}.items():
            at, view = 1e3 * place.shift_m[[across, 2]], place.R[[across, 2], 2]
            ax.plot(*at, "o", color=COLOURS[lens], markersize=5, label=f"{lens} lens")
            ax.annotate(
                "",
                xytext=at,
                xy=at + 0.6 * base_mm * view,
                arrowprops={"arrowstyle": "-|>", "color": COLOURS[lens], "shrinkA": 0, "shrinkB": 0},
            )
        ax.add_patch(
            _ellipse(1e6 * back.cov[np.ix_([across, 2], [across, 2])], 1e3 * back.shift_m, across, times)
        )
        ax.axvline(0.0, color=GREY, linewidth=0.6, linestyle=":")
        ax.set_xlim(-1.1 * base_mm, 1.1 * base_mm)
        ax.set_ylim(-1.8 * base_mm, 0.8 * base_mm)
        ax.set_aspect("equal", adjustable="box")
        ax.set_title(name)
        ax.set_xlabel(f"{'xy'[across]} of the front lens / mm")
    axes[0].set_ylabel("z of the front lens, its view / mm")
    axes[1].legend(
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
        fontsize=8,
        title=f"ellipse: 95 %, {times} times enlarged",
    )
    return figure


def _ellipse(cov_mm2: ArrayF, at_mm: ArrayF, across: int, times: int) -> Ellipse:
    values, vectors = np.linalg.eigh(cov_mm2)
    width, height = 2 * _CONFIDENCE * times * np.sqrt(np.maximum(values, 0.0))
    return Ellipse(
        (at_mm[across], at_mm[2]),
        width,
        height,
        angle=float(np.rad2deg(np.arctan2(vectors[1, 0], vectors[0, 0]))),
        facecolor="none",
        edgecolor=COLOURS["back"],
        linewidth=1.2,
    )


def draw_rig_field(
    *, images: list[Path], residuals: Path, calibration: Path, rig: Rig, title: str, twin: bool
) -> Figure:
    """Files of the field, residuals and calibration of a rig -> the file with most marks, in both lenses."""
    views, table = _best_file(images, residuals, rig)
    found = read_rig(calibration, rig)
    return rig_field(views, table, found, title=f"Field of the rig: {title}", twin=twin)


def _best_file(images: list[Path], residuals: Path, rig: Rig) -> tuple[dict[str, ArrayU8], pd.DataFrame]:
    """Views of the file with most marks, and its residuals."""
    table = pd.read_csv(residuals)
    file = str(table["file"].value_counts().index[0])
    path = next(path for path in find_images(images).files if path.name == file)
    return read_views(path, rig), table[table["file"] == file]


def _pixels(table: pd.DataFrame, camera: Camera) -> ArrayF:
    """Where marks (n, 2) of a lens are, by their angle from the axis and azimuth."""
    t, a = (np.deg2rad(table[name].to_numpy(np.float64)) for name in ("angle_deg", "azimuth_deg"))
    return camera.project(np.stack([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)], axis=1))


@styled
def rig_field(
    views: Mapping[str, ArrayU8], table: pd.DataFrame, rig: CalibratedRig, *, title: str, twin: bool
) -> Figure:
    """Marks of a field in both image circles of a file, with their residuals.

    Parameters
    ----------
    views : upright views (h, w, 3) by lens.
    table : their rows of the residuals: lens, angle_deg, azimuth_deg, vx_px, vy_px, used.
    rig : calibrated; says where angles and azimuths lie in a view.
    title : first words of the title.
    twin : true if the digital twin made the data.
    """
    times = 300
    figure = new_figure(95.0, f"{title}, n = {count(int(table['used'].sum()))} marks", twin=twin)
    for ax, (lens, view) in zip(figure.subplots(1, 2), views.items(), strict=True):
        mine = table[table["lens"] == lens]
        x, y = _pixels(mine, rig.cameras[lens]).T
        ax.imshow(view, extent=(0, view.shape[1], view.shape[0], 0))
        used = mine["used"].to_numpy(dtype=bool)
        ax.plot(x[used], y[used], ".", color=BLUE, markersize=2)
        ax.plot(x[~used], y[~used], "x", color=VERMILION, markersize=4)
        v = mine[["vx_px", "vy_px"]].to_numpy()[used].T * times
        ax.quiver(x[used], y[used], *v, color=VERMILION, angles="xy", scale_units="xy", scale=1, width=0.003)
        # circles of equal angle from the axis; the field of view ends at the outermost
        for angle in (30, 60, 90):
            ring = pd.DataFrame({"angle_deg": angle, "azimuth_deg": np.arange(0.0, 361.0, 2.0)})
            ax.plot(*_pixels(ring, rig.cameras[lens]).T, color="white", linewidth=0.6)
        ax.set_xlim(0, view.shape[1])
        ax.set_ylim(view.shape[0], 0)
        ax.set_title(f"{lens} lens, {int(used.sum())} marks", fontsize=9)
        ax.set_xlabel(f"x / px (residuals {times} times)")
    figure.axes[0].set_ylabel("y / px")
    return figure


def draw_rig_residuals(*, residuals: Path, title: str, twin: bool) -> Figure:
    """Residuals of the marks of a rig -> their parts along and across the radius, over the angle of view."""
    return rig_residuals(pd.read_csv(residuals), title=f"Residuals of the rig: {title}", twin=twin)


@styled
def rig_residuals(table: pd.DataFrame, *, title: str, twin: bool) -> Figure:
    """Radial and tangential residuals of both lenses over the angle from the axis.

    Parameters
    ----------
    table : lens, angle_deg, azimuth_deg, vx_px, vy_px, used.
    title : first words of the title.
    twin : true if the digital twin made the data.
    """
    used = table[table["used"]]
    figure = new_figure(100.0, f"{title}, n = {count(len(used))} marks of {count(len(table))}", twin=twin)
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    limit = 4.0 * float(np.sqrt(np.square(used[["vx_px", "vy_px"]].to_numpy()).mean()))
    for row, lens in enumerate(COLOURS):
        mine = used[used["lens"] == lens]
        a = np.deg2rad(mine["azimuth_deg"].to_numpy())
        vx, vy = mine["vx_px"].to_numpy(), mine["vy_px"].to_numpy()
        parts = {"radial": vx * np.cos(a) + vy * np.sin(a), "tangential": vy * np.cos(a) - vx * np.sin(a)}
        angle = mine["angle_deg"].to_numpy()
        for column, (name, v) in enumerate(parts.items()):
            ax = axes[row, column]
            ax.axhline(0.0, color=GREY, linewidth=0.6)
            ax.plot(angle, v, ".", markersize=1.5, color=COLOURS[lens], rasterized=True)
            edges = np.arange(0.0, 111.0, 10.0)
            number = np.digitize(angle, edges) - 1
            middle, mean, error = [], [], []
            for k in range(len(edges) - 1):
                inside = v[number == k]
                if len(inside) >= 10:
                    middle.append(edges[k] + 5)
                    mean.append(inside.mean())
                    error.append(2 * inside.std(ddof=1) / np.sqrt(len(inside)))
            ax.errorbar(
                middle, mean, yerr=error, color="black", fmt="o-", markersize=3, capsize=2, linewidth=0.8
            )
            ax.set_title(f"{lens} lens, {name}, rms {np.sqrt(np.mean(v**2)):.3f} px", fontsize=9)
            ax.set_ylim(-limit, limit)
    for ax in axes[1]:
        ax.set_xlabel("angle from the axis / degrees")
    figure.supylabel("observed less computed / px", fontsize=9)
    return figure


def draw_seam_views(
    *,
    images: list[Path],
    residuals: Path,
    calibration: Path,
    points: list[Path],
    rig: Rig,
    title: str,
    twin: bool,
) -> Figure:
    """Files of the field of a rig and its points -> the seam of near things, without and with ranges."""
    views, table = _best_file(images, residuals, rig)
    found, field = read_rig(calibration, rig), read_points(points[0])
    front = table[(table["lens"] == "front") & table["used"]].reset_index(drop=True)
    xy = _pixels(front, found.cameras["front"])
    marks = front[["marker", "corner", "sigma_px"]].assign(x_px=xy[:, 0], y_px=xy[:, 1])
    pose = resect(found.cameras["front"], marks, field, with_interior=False).T_pcs_ccs
    local = (field.points_pcs - pose.shift_m) @ pose.R - found.centre_front_m
    width = default_width_px(found.cameras["front"])
    inverse = {"all far": np.zeros((width // 2, width)), "ranges of the marks": _inverse_of(local, width)}
    composed = {words: compose(views, found, np.eye(3), each) for words, each in inverse.items()}
    return seam_views(
        {words: (each.picture, each.seam_rms_px) for words, each in composed.items()},
        title=f"Seam of a panorama: {title}",
        twin=twin,
    )


def _inverse_of(points_m: ArrayF, width: int) -> ArrayF:
    """Inverse ranges (W / 2, W): linear between points (n, 3), infinitely far beyond them."""
    uv, inverse = pixels_of(points_m, width), 1 / np.linalg.norm(points_m, axis=1)
    around = np.concatenate([uv + np.array([k * width, 0]) for k in (-1, 0, 1)])
    v, u = np.mgrid[0 : width // 2, 0:width] + 0.5
    return np.nan_to_num(LinearNDInterpolator(around, np.tile(inverse, 3))(u, v))


@styled
def seam_views(found: Mapping[str, tuple[ArrayU8, float]], *, title: str, twin: bool) -> Figure:
    """Both sides of the seam, a row for each way of making the panorama.

    Parameters
    ----------
    found : panorama (h, 2 h, 3) and the rms of its shifts at the seam in pixels, by words.
    title : first words of the title.
    twin : true if the digital twin made the data.
    """
    width = next(iter(found.values()))[0].shape[1]
    figure = new_figure(125.0, f"{title}, {width} px", twin=twin)
    axes = figure.subplots(len(found), 2, sharex="col", sharey=True)
    px = width / 360.0
    for row, (words, (picture, rms_px)) in zip(axes, found.items(), strict=True):
        for ax, side in zip(row, (-90.0, 90.0), strict=True):
            columns = slice(round((side + 180 - _HALF_DEG) * px), round((side + 180 + _HALF_DEG) * px))
            rows = slice(round((90 - _HALF_DEG) * px), round((90 + _HALF_DEG) * px))
            box = (side - _HALF_DEG, side + _HALF_DEG, -_HALF_DEG, _HALF_DEG)
            ax.imshow(picture[rows, columns], extent=box, interpolation="nearest")
            ax.set_title(f"{words}: rms at the stitching line {rms_px:.2f} px", fontsize=9)
        row[0].set_ylabel("up / degrees")
    for ax in axes[-1]:
        ax.set_xlabel("from the view of the front lens / degrees")
    return figure
