"""Marks of a block of pictures as arrays, and how far each sheet is from the camera."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import pandas as pd

from thalweg.calibration.markers.sheets import MarkerLayout
from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayB, ArrayF, ArrayI

_BENT: Final = 0.06
"""Misfit of a sheet to a flat square over its size. Sheets on cones have 0.01, printed ones on walls 0.004;
one mark that is wrong by a third of the sheet's side makes 0.1 or more."""
_TIMES_MEDIAN: Final = 6.0
"""Sheets on thin posts are all bent; directions by a focal length that is off are all wrong a little."""


@dataclass(slots=True)
class Block:
    """Marks of a block of pictures as arrays.

    Parameters
    ----------
    images : names; ``camera_of`` (i,) name of the camera of each.
    points : (marker, corner) of each point.
    image, point : (m,) indices of each mark.
    xy_px, sigma_px : (m, 2) and (m,).
    rays : (m, 3) unit directions in ccs, by nominal interior orientations.
    """

    images: tuple[str, ...]
    camera_of: tuple[str, ...]
    points: tuple[tuple[int, int], ...]
    image: ArrayI
    point: ArrayI
    xy_px: ArrayF
    sigma_px: ArrayF
    rays: ArrayF

    @property
    def marker(self) -> ArrayI:
        """(m,) marker of each mark."""
        return np.array([p[0] for p in self.points], np.int64)[self.point]


def block_of(marks: pd.DataFrame, cameras: Mapping[str, Camera]) -> Block:
    """Arrays of a table of marks (image, camera, marker, corner, x_px, y_px, sigma_px).

    Raises
    ------
    GeometryError : a camera is missing, or no marks at all.
    """
    if len(marks) == 0:
        raise GeometryError(
            "no marks in any picture", expected="pictures of the field", cure="Check detection and dictionary"
        )
    missing = sorted(set(marks["camera"]) - set(cameras))
    if missing:
        raise GeometryError(
            f"no interior orientation of the camera {missing[0]!r}", expected=str(list(cameras))
        )
    marks = marks.sort_values(["image", "marker", "corner"], kind="stable")
    images = tuple(dict.fromkeys(marks["image"]))
    first = marks.drop_duplicates("image").set_index("image")["camera"]
    keys = list(zip(marks["marker"].astype(int), marks["corner"].astype(int), strict=True))
    points = tuple(sorted(set(keys)))
    at_image, at_point = {n: i for i, n in enumerate(images)}, {p: i for i, p in enumerate(points)}
    xy = marks[["x_px", "y_px"]].to_numpy(np.float64)
    rays = np.empty((len(marks), 3))
    for name in set(marks["camera"]):
        rows = (marks["camera"] == name).to_numpy()
        rays[rows] = cameras[name].rays(xy[rows])
    return Block(
        images=images,
        camera_of=tuple(first.loc[list(images)]),
        points=points,
        image=np.array([at_image[n] for n in marks["image"]], np.int64),
        point=np.array([at_point[k] for k in keys], np.int64),
        xy_px=xy,
        sigma_px=marks["sigma_px"].to_numpy(np.float64),
        rays=rays,
    )


def sheet_centres(
    block: Block, layout: MarkerLayout
) -> tuple[dict[int, dict[int, ArrayF]], dict[int, dict[int, ArrayF]], ArrayB]:
    """Centres of whole sheets in ccs [m] and unit directions to them, by image and marker.

    Sheets that look like no flat square are left out; (m,) tells their marks.
    """
    found: list[tuple[ArrayI, ArrayF | None, float]] = []
    order = np.lexsort((block.point, block.image))
    markers = block.marker
    key = block.image[order] * 100_000 + markers[order]
    for rows in np.split(order, np.flatnonzero(np.diff(key)) + 1):
        if len(rows) != 4 or not np.isfinite(block.rays[rows]).all():
            continue
        marker = int(markers[rows[0]])
        found.append((rows, *_sheet_centre(block.rays[rows], layout.saddles_m(marker))))
    misfits = [misfit for _, _, misfit in found if np.isfinite(misfit)]
    limit = max(_BENT, _TIMES_MEDIAN * float(np.median(misfits))) if misfits else _BENT
    centres: dict[int, dict[int, ArrayF]] = {}
    rays: dict[int, dict[int, ArrayF]] = {}
    odd = np.zeros(len(block.image), np.bool_)
    for rows, centre, misfit in found:
        if centre is None or misfit > limit:
            odd[rows] = True
            continue
        image, marker = int(block.image[rows[0]]), int(markers[rows[0]])
        centres.setdefault(image, {})[marker] = centre
        rays.setdefault(image, {})[marker] = centre / np.linalg.norm(centre)
    return centres, rays, odd


def _sheet_centre(rays: ArrayF, saddles_m: ArrayF) -> tuple[ArrayF | None, float]:
    """Centre of a sheet (3,) in ccs, None if no planar pose fits, and its misfit over the sheet's size."""
    axis = rays.mean(axis=0)
    axis /= np.linalg.norm(axis)
    # into a camera that looks at the sheet, so that directions beyond 90 degrees do no harm
    side = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    turn = np.stack([side, np.cross(axis, side), axis])
    local = rays @ turn.T
    if (local[:, 2] < 0.1).any():
        return None, np.inf
    flat = local[:, :2] / local[:, 2:]
    n, _, shifts, errors = cv2.solvePnPGeneric(saddles_m, flat, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    ahead = [np.ravel(t) for t in shifts[:n] if np.isfinite(t).all() and t[2] > 0]
    size = np.sqrt(np.square(flat - flat.mean(axis=0)).sum() / len(flat))
    misfit = float(np.nanmin(errors)) / size if n else np.inf
    return (np.mean(ahead, axis=0) @ turn, misfit) if ahead else (None, np.inf)
