"""A calibrated rig: where its lenses sit and how well that is known, and residuals over the angle of view."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from thalweg.calibration import Rig as CalibratedRig, read_rig, read_views
from thalweg.core import ArrayF, ArrayU8, Camera
from thalweg.figures import BLUE, GREY, VERMILION, count, new_figure, styled
from thalweg.ingest.photos import find_images
from thalweg.settings.sections import Rig

COLOURS: Final = {"front": BLUE, "back": VERMILION}


def draw_rig_field(*, images: list[Path], residuals: Path, calibration: Path, rig: Rig, title: str) -> Figure:
    """Files of the field, residuals and calibration of a rig -> the file with most marks, in both lenses."""
    views, table = _best_file(images, residuals, rig)
    found = read_rig(calibration, rig)
    return rig_field(views, table, found, title=f"Field of the rig: {title}")


def _best_file(images: list[Path], residuals: Path, rig: Rig) -> tuple[dict[str, ArrayU8], pd.DataFrame]:
    """Views of the file with most marks, and its residuals."""
    table = pd.read_csv(residuals)
    file = str(table["file"].value_counts().index[0])
    path = next(path for path in find_images(images).files if path.name == file)
    return read_views(path, rig), table[table["file"] == file]


def _pixels(table: pd.DataFrame, camera: Camera) -> ArrayF:
    """Where marks (n, 2) of a lens are, by their angle from the axis and azimuth."""
    t, a = (np.deg2rad(table[name].to_numpy()) for name in ("angle_deg", "azimuth_deg"))
    return camera.project(np.stack([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)], axis=1))


@styled
def rig_field(views: Mapping[str, ArrayU8], table: pd.DataFrame, rig: CalibratedRig, *, title: str) -> Figure:
    """Marks of a field in both image circles of a file, with their residuals.

    Parameters
    ----------
    views : upright views (h, w, 3) by lens.
    table : their rows of the residuals: lens, angle_deg, azimuth_deg, vx_px, vy_px, used.
    rig : calibrated; says where angles and azimuths lie in a view.
    title : first words of the title.
    """
    times = 300
    figure = new_figure(95.0, f"{title}, n = {count(table['used'].sum())} marks")
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


@styled
def rig_residuals(table: pd.DataFrame, *, title: str = "Residuals of the rig") -> Figure:
    """Radial and tangential residuals of both lenses over the angle from the axis.

    Parameters
    ----------
    table : lens, angle_deg, azimuth_deg, vx_px, vy_px, used.
    title : first words of the title.
    """
    used = table[table["used"]]
    figure = new_figure(100.0, f"{title}, n = {count(len(used))} marks of {count(len(table))}")
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
            classes = pd.Series(v).groupby(10.0 * np.floor(angle / 10.0)).agg(["mean", "sem", "size"])
            classes = classes[classes["size"] >= 10]
            ax.errorbar(
                classes.index + 5.0,
                classes["mean"],
                2 * classes["sem"],
                color="black",
                fmt="o-",
                markersize=3,
                capsize=2,
                linewidth=0.8,
            )
            ax.set_title(f"{lens} lens, {name}, rms {np.sqrt(np.mean(v**2)):.3f} px", fontsize=9)
            ax.set_ylim(-limit, limit)
    for ax in axes[1]:
        ax.set_xlabel("angle from the axis / °")
    figure.supylabel("observed minus computed / px", fontsize=9)
    return figure
