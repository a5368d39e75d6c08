"""Images of a fifteen-line laser with their measured and labelled points (T Fig. 4.4): grid, plane, wreck.

On grid and plane the depths are known, and they tell which line a point belongs to. On an object of free
form one image alone does not (T 4.2.1): points get the label that `label_single_image` vouches for, and
``best_line`` holds its guess for the others.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from thalweg.core.types import AnyArray, ArrayF, ArrayI, ArrayU8
from thalweg.lightsheet.lines.detect import detect_lines
from thalweg.lightsheet.lines.points import LinePoints
from thalweg.lightsheet.lines.settings import LineSettings
from thalweg.lightsheet.multi_line.detections import Detections, Hypotheses, LabelSettings, hypotheses
from thalweg.lightsheet.multi_line.sheet_curves import Lines
from thalweg.lightsheet.multi_line.single_image import label_single_image
from thalweg.lightsheet.optics.sensor import Sensor, paper_4
from thalweg.settings.twin.light_sheet import SheetImage
from thalweg_lab.base.random import generator
from thalweg_lab.studies.calibrated_sensor import Size, calibrated_sensor
from thalweg_lab.studies.line_labels import calibrated_lines
from thalweg_lab.tank.fans import lines_of
from thalweg_lab.tank.grating import Grating
from thalweg_lab.tank.line import line_on
from thalweg_lab.tank.plan import calibration_plan, panel_plan, scan_plan
from thalweg_lab.tank.render import render_sheet_image
from thalweg_lab.tank.surfaces import Posed
from thalweg_lab.tank.truth_sensor import sized
from thalweg_lab.tank.wreck import wreck

OBJECTS: Final = ("calibration", "plane", "wreck")
LEVELS_MM: Final = (60.0, 150.0)
"""Of the grid and of the plate below it."""
PLANE_MM: Final = 120.0
WRECK_MM: Final = 165.0
"""Depth of the ground on which the wreck lies."""

_TOLERANCE_MM: Final = 1.5
"""A label off shifts a depth by 2 mm and more on these levels."""
_NEAR_PX: Final = 3.0
_BEAMS: Final = 6001


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiLineImage:
    """An image with what was found in it.

    Parameters
    ----------
    name : one of `OBJECTS`.
    image : (h, w) mosaic.
    points : ``line`` (-1 without label), ``best_line``, ``true_line`` (-1: nothing was there), ``x_px, y_px,
        sigma_px``, and ``x_mm, y_mm, z_mm`` in lcs by the label, NaN without.
    vertices_lcs_mm, faces : (n, 3), (m, 3) of the object under the sensor.
    """

    name: str
    image: ArrayU8
    points: pd.DataFrame
    vertices_lcs_mm: ArrayF
    faces: ArrayI


def multi_line_images(seed: int, *, size: Size = "demo") -> Iterator[MultiLineImage]:
    """Render, measure and label one image of each object, in the order of `OBJECTS`.

    Parameters
    ----------
    seed : of the laser, of the wreck and of all noise.
    size : of the images, see `thalweg_lab.tank.truth_sensor.SIZES`.
    """
    pair = calibrated_sensor(seed, size=size)
    sensor, settings = pair.true, sized(paper_4(), SheetImage(), size)[1]
    grating, lines = calibrated_lines(pair, 0.0, seed)
    fans = lines_of(grating)
    plans = (
        calibration_plan(sensor, seed, positions=1, depths_mm=LEVELS_MM, fans=fans),
        panel_plan(sensor, depths_mm=(PLANE_MM,), fans=fans),
        scan_plan(
            sensor, seed, wreck(seed, step_mm=1.2), lines=5, step_mm=10.0, depth_mm=WRECK_MM, fans=fans
        ),
    )
    for name, plan, depths in zip(OBJECTS, plans, (LEVELS_MM, (PLANE_MM,), ()), strict=True):
        scene = plan.scene(len(plan) // 2)
        image = render_sheet_image(
            sensor, scene, settings, generator(seed, f"multi line image {name}"), fans=fans
        )
        found = detect_lines(image, LineSettings(lines=len(fans), across="rows"))
        points = labelled_points(pair.known, lines, found, depths)
        points["true_line"] = true_lines(sensor, scene, grating, points)
        yield MultiLineImage(
            name=name,
            image=image,
            points=points,
            vertices_lcs_mm=scene.to_lcs(scene.surface.vertices_mm),
            faces=scene.surface.faces,
        )


def labelled_points(
    sensor: Sensor, lines: Lines, found: LinePoints, depths_mm: tuple[float, ...]
) -> pd.DataFrame:
    """Measured points with labels: by the known depths, or by the image alone if there are none."""
    order = np.lexsort((found.x_px, found.y_px))
    x, y = found.x_px[order], found.y_px[order]
    h = hypotheses(sensor, lines, Detections(row=np.floor(y).astype(np.int64), x_px=x), LabelSettings())
    if depths_mm:
        label = best = by_depth(h, depths_mm)
    else:
        labels = label_single_image(h, lines, LabelSettings())
        label, best = labels.label, labels.best
    xyd = np.full((len(x), 3), np.nan)
    has = np.flatnonzero(label >= 0)
    xyd[has] = h.xyd_mm[has, label[has]]
    window = sensor.window
    xyz = xyd * [1.0, 1.0, -1.0] - [0.0, 0.0, window.thickness_mm]
    xyz = xyz @ window.R_lcs_window.T
    return pd.DataFrame({
        "line": label, "best_line": best, "x_px": x, "y_px": y, "sigma_px": found.sigma_px[order],
        "x_mm": xyz[:, 0], "y_mm": xyz[:, 1], "z_mm": xyz[:, 2],
    })  # fmt: skip


def by_depth(h: Hypotheses, depths_mm: tuple[float, ...]) -> ArrayI:
    """Labels (n,) by which points lie on one of the levels; -1 if none or two do so."""
    off = np.abs(h.xyd_mm[:, :, 2, None] - np.asarray(depths_mm)).min(axis=2)
    off = np.where(np.isfinite(off), off, np.inf)
    ranked = np.sort(off, axis=1)
    sure = (ranked[:, 0] < _TOLERANCE_MM) & (ranked[:, 1] > _TOLERANCE_MM)
    return np.where(sure, np.argmin(off, axis=1), -1)


def true_lines(sensor: Sensor, scene: Posed, grating: Grating, points: pd.DataFrame) -> ArrayI:
    """Numbers (n,) of the lines that are really seen at points, -1 where there is none."""
    xy, number = [], []
    a = np.linspace(-grating.half_angle_rad, grating.half_angle_rad, _BEAMS)
    for fan in lines_of(grating):
        met = line_on(sensor, scene, fan, a)
        xy.append(met.xy_px[met.visible])
        number.append(np.full(int(met.visible.sum()), fan.number))
    away, nearest = cKDTree(np.concatenate(xy)).query(points[["x_px", "y_px"]].to_numpy())
    return np.where(np.asarray(away) < _NEAR_PX, np.concatenate(number)[nearest], -1)


def write_images(images: Sequence[MultiLineImage], npz: Path, table: Path) -> None:
    """Write pictures and meshes as NPZ (``image_<name>``, ``vertices_<name>``, ``faces_<name>``) and all
    points as CSV with the column ``object``.
    """
    arrays: dict[str, AnyArray] = {}
    for one in images:
        arrays[f"image_{one.name}"] = one.image
        # a tenth of a micrometre is enough for a drawing
        arrays[f"vertices_{one.name}"] = one.vertices_lcs_mm.astype(np.float32)
        arrays[f"faces_{one.name}"] = one.faces.astype(np.int32)
    np.savez_compressed(npz, allow_pickle=False, **arrays)
    points = pd.concat([one.points.assign(object=one.name) for one in images], ignore_index=True)
    points.to_csv(table, index=False, float_format="%.6g")
