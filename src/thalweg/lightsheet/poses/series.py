"""Line points of a series of images, and their places in the sensor's frame."""

import logging
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.core import (
    AnyArray,
    ArrayF,
    GeometryError,
    InputError,
    ThalwegError,
    column,
    decode_picture,
    frame_of,
    optional,
    table_kind,
)
from thalweg.lightsheet.calibration import GridObject
from thalweg.lightsheet.lines import (
    LINE_POINTS,
    LinePoints,
    LineSettings,
    detect_lines,
    pooled_shift,
    without_shift,
)
from thalweg.lightsheet.optics import Sensor, Status, sheet_derivatives

cv2 = optional("cv2")

log = logging.getLogger("thalweg")

SERIES_POINTS: Final = table_kind(
    "sheet_line_points", 1, [column("file", "1", "name of the image", pa.string()), *LINE_POINTS]
)
"""Line points of all images of a series."""

SHEET_POINTS: Final = table_kind(
    "sheet_points",
    1,
    [
        column("file", "1", "name of the image", pa.string()),
        column("line", "1", "number of the laser line, -1 if unknown", pa.int32()),
        *(column(f"{a}_mm", "mm", f"{a} in the sensor's frame lcs") for a in "xyz"),
        column("depth_mm", "mm", "depth below the outer face of the window"),
        column("fan_angle_rad", "rad", "fan angle of the sub-beam"),
        column("x_px", "px", "column of the image point"),
        column("y_px", "px", "row of the image point"),
        *(
            column(f"cov_{a}{b}_mm2", "mm^2", f"covariance of {a} and {b} by the image point")
            for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")
        ),
        column("sigma_depth_mm", "mm", "of the depth, by image point and sensor"),
        column("flags", "1", "as in the line points", pa.uint8()),
    ],
)
"""Points on the light sheet; the covariances hold the image point's share, which is independent from point to
point; the sensor's share is common to all points and comes from the sensor's file."""


def read_sheet_image(path: Path) -> AnyArray:
    """Pixels (h, w), raw mosaic or grey, or (h, w, 3) red, green, blue.

    Raises
    ------
    InputError : the file is no image.
    """
    stored = np.fromfile(path, np.uint8) if path.is_file() else np.empty(0, np.uint8)
    data = decode_picture(stored, cv2.IMREAD_UNCHANGED)
    if data is None:
        found = "cannot be read as an image" if stored.size else "the file is empty or missing"
        raise InputError(
            found,
            expected="PNG, TIFF or JPEG of the sensor's camera",
            where=path,
            cure="Copy the file again from the camera's disk",
        )
    return data if data.ndim == 2 else np.ascontiguousarray(data[:, :, 2::-1])


def detect_series(
    images: Sequence[Path], settings: LineSettings, size_px: tuple[int, int], *, threads: int = 1
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Measure the lines of all images.

    Parameters
    ----------
    images : files, in order.
    settings : see `LineSettings`.
    size_px : width and height by the sensor's interior orientation.
    threads : images at a time.

    Returns
    -------
    points (`SERIES_POINTS`; where brightness changes, ``attrs`` has the ``width_shift`` of the series), and a
    table with a row an image: file, points, what was dropped, and why an image gives nothing.

    Raises
    ------
    InputError : there are no images, two have one name, none of them has a line, or their size is not that of
        the sensor.
    """
    if not images:
        raise InputError(
            "no images", expected="images of the light-sheet sensor", cure="Check the paths in logs"
        )
    twice = [name for name, n in Counter(path.name for path in images).items() if n > 1]
    if twice:
        raise InputError(
            f"two images are called {twice[0]}",
            expected="a name of its own for each image",
            where=images[0].parent,
            cure="Rename them, or name one folder only",
        )
    with ThreadPoolExecutor(threads) as pool:
        found = list(pool.map(lambda path: _detect(path, settings, size_px), images))
    shift = pooled_shift([points.facts for points, _ in found if points])
    found = [(without_shift(points, shift) if points else None, failed) for points, failed in found]
    counts = pd.DataFrame(
        [
            {
                "file": path.name,
                "points": len(points) if points else 0,
                **(points.counts if points else {}),
                "reason": failed.found if failed else "",
            }
            for path, (points, failed) in zip(images, found, strict=True)
        ]
    )
    tables = [
        points.to_frame().assign(file=path.name)
        for path, (points, _) in zip(images, found, strict=True)
        if points
    ]
    first = next((failed for _, failed in found if failed), None)
    if not tables:
        raise InputError(
            f"none of {len(images)} images shows a line; {images[0].name}: {first.found if first else ''}",
            expected="a laser line in each image",
            where=images[0].parent,
            cure=first.cure if first else "",
        )
    for path, (_, failed) in zip(images, found, strict=True):
        if failed:
            log.warning("%s gives no points: %s", path.name, failed)
    joined = pd.concat(tables, ignore_index=True)
    if shift.applied:
        log.info(
            "over-exposed points were moved by %.3f px for each pixel by which the line is wider there "
            "(sigma %.3f, %d edges of brightness)",
            -shift.coefficient,
            shift.sigma,
            shift.edges,
        )
    numbers = {name: "int64" for name in counts.columns if name not in ("file", "reason")}
    counts = counts.fillna(dict.fromkeys(numbers, 0)).astype(numbers)
    points = frame_of(SERIES_POINTS, {name: joined[name] for name in SERIES_POINTS.names})
    if shift.edges:
        points.attrs["width_shift"] = {
            "coefficient": shift.coefficient,
            "sigma": shift.sigma,
            "edges": shift.edges,
            "applied": shift.applied,
        }
    return points, counts


def require_one_image(line_points: pd.DataFrame, *, where: Path) -> pd.DataFrame:
    """The points, if they are of one image: a grid object is calibrated from one picture.

    Raises
    ------
    InputError : points of several images.
    """
    names = line_points["file"].unique()
    if len(names) != 1:
        raise InputError(
            f"line points of {len(names)} images, such as {names[0]} and {names[-1]}",
            expected="one image of the laser on the grid object",
            where=where,
            cure="Name one image in logs.light_sheet.grid_images, with the depths of its levels in grid",
        )
    return line_points


def require_levels(grid: GridObject, levels: int, *, where: Path) -> None:
    """Refuse a grid object with another number of levels than lines were looked for side by side.

    Raises
    ------
    InputError : they differ.
    """
    if len(grid.levels) != levels:
        raise InputError(
            f"{len(grid.levels)} levels ({', '.join(level.name for level in grid.levels)})",
            expected=f"{levels}, as light_sheet.calibration.levels says",
            where=where,
            cure=f"Write light_sheet.calibration.levels: {len(grid.levels)}, or correct the description",
        )


def _detect(
    path: Path, settings: LineSettings, size_px: tuple[int, int]
) -> tuple[LinePoints | None, ThalwegError | None]:
    image = read_sheet_image(path)
    if image.shape[1::-1] != tuple(size_px):
        raise InputError(
            f"an image of {image.shape[1]} x {image.shape[0]} pixels",
            expected=f"{size_px[0]} x {size_px[1]}, as the sensor's interior orientation says",
            where=path,
            cure="Set the camera to the format of its calibration, or calibrate it for this format",
        )
    try:
        return detect_lines(image, settings), None
    except ThalwegError as error:
        return None, error


def points_on_sheet(sensor: Sensor, line_points: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, int]]:
    """Intersect line points with the light sheet.

    Parameters
    ----------
    sensor : calibrated.
    line_points : `SERIES_POINTS`.

    Returns
    -------
    points (`SHEET_POINTS`), and counts by status; points without an intersection are counted only.

    Raises
    ------
    GeometryError : not one of the points lies on the light sheet in the water.
    """
    xy = line_points[["x_px", "y_px"]].to_numpy(np.float64)
    d = sheet_derivatives(sensor, xy)
    ok = d.points.ok
    codes, numbers = np.unique(d.points.status, return_counts=True)
    counts = {Status(code).name.lower(): int(n) for code, n in zip(codes, numbers, strict=True)}
    if len(xy) and not ok.any():
        told = ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in counts.items())
        raise GeometryError(
            f"none of {len(xy)} line points lies on the light sheet in the water ({told})",
            expected="points in front of the window",
            where=f"sensor {sensor.name!r}",
            cure="Were these images taken with this sensor, and neither mirrored nor turned?",
        )
    cov = image_covariance(
        d.by_pixel[ok], line_points["sigma_px"].to_numpy()[ok], line_points["angle_rad"].to_numpy()[ok]
    )
    by_parameters = d.depth_by_parameters[ok]
    normal = sensor.window.normal_lcs
    own = np.einsum("i,nij,j->n", normal, cov, normal)
    common = np.einsum("ni,ij,nj->n", by_parameters, sensor.cov, by_parameters)
    xyz = d.points.xyz_lcs_mm[ok]
    pairs = {"xx": (0, 0), "xy": (0, 1), "xz": (0, 2), "yy": (1, 1), "yz": (1, 2), "zz": (2, 2)}
    table = frame_of(
        SHEET_POINTS,
        {
            "file": line_points["file"].to_numpy()[ok],
            "line": line_points["line"].to_numpy()[ok],
            **{f"{a}_mm": xyz[:, i] for i, a in enumerate("xyz")},
            "depth_mm": d.points.depth_mm[ok],
            "fan_angle_rad": d.points.fan_angle_rad[ok],
            "x_px": xy[ok, 0],
            "y_px": xy[ok, 1],
            **{f"cov_{key}_mm2": cov[:, i, j] for key, (i, j) in pairs.items()},
            "sigma_depth_mm": np.sqrt(own + common),
            "flags": line_points["flags"].to_numpy()[ok],
        },
    )
    return table, counts


def image_covariance(by_pixel: ArrayF, sigma_px: ArrayF, angle_rad: ArrayF) -> ArrayF:
    """Covariance (n, 3, 3) of points by the place of the line in the image, uncertain only across it."""
    across = np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=1)
    step = np.einsum("nij,nj->ni", by_pixel, across)
    return np.asarray(np.square(sigma_px)[:, None, None] * step[:, :, None] * step[:, None, :])
