"""Whether both views are read as they were when the rig was calibrated.

Along the seam both lenses see the same things. If one of the views is turned by half against the other they
do not; that is found from the pictures alone. The seam cannot tell views that are changed over, mirrored or
upside down *both*: the same pixels still lie on each other there, elsewhere. The cloud can: intensities of
its points and the brightness of the pixels that show them depend on each other only if these are the same
things (`thalweg.lidar.check_colours` tests clock and mount in the same way).
"""

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from scipy import ndimage

from thalweg.calibration import LENSES, Rig
from thalweg.core import AnyArray, ArrayF, ArrayU8, Rigid
from thalweg.panorama.compose import RIM_DEG, correlation, overlap
from thalweg.panorama.sphere import pixels_of

TURNED: Final = "turned by half against each other"
_AGREES: Final = 0.6
_CLEARLY: Final = 0.3
_CELLS: Final = 12
"""Surroundings whose means are taken out: this part of the width of a view."""

Views = Mapping[str, ArrayU8]
READINGS: Final[Mapping[str, Callable[[Views], Views]]] = {
    "": lambda views: views,
    "changed over": lambda views: {"front": views["back"], "back": views["front"]},
    "mirrored": lambda views: {name: np.ascontiguousarray(view[:, ::-1]) for name, view in views.items()},
    "upside down": lambda views: {
        name: np.ascontiguousarray(view[::-1, ::-1]) for name, view in views.items()
    },
    "changed over and upside down": lambda views: {
        "front": np.ascontiguousarray(views["back"][::-1, ::-1]),
        "back": np.ascontiguousarray(views["front"][::-1, ::-1]),
    },
}
"""Ways in which both views may be read; the first is the right one."""


def reading_that_fits(views: Views, rig: Rig) -> str:
    """The way in which both views agree along the seam: "" as they are, or `TURNED`.

    Another one is told only if it agrees clearly and the given one does not.
    """
    turned = [
        {**views, name: np.ascontiguousarray(views[name][::-1, ::-1])} for name in LENSES
    ]  # nearly the same, but for principal points that lie beside the middle
    far = np.zeros((64, 128))
    score = []
    for read in (views, *turned):
        _, even, usable = overlap(read, rig, np.eye(3), far, None, np.ones(3))
        grey = [ndimage.gaussian_filter(even[lens].mean(axis=2), (2, 1)) for lens in LENSES]
        score.append(float(np.nan_to_num(correlation(grey[0], grey[1], usable), nan=-1.0)))
    other = max(score[1:])
    return TURNED if other > _AGREES and other > score[0] + _CLEARLY else ""


def dependence_on_cloud(
    views: Views, rig: Rig, front: Rigid, xyz_wcs_m: ArrayF, intensity: ArrayF
) -> dict[str, float]:
    """How much intensities of the cloud and brightness depend on each other, by reading of the views.

    Parameters
    ----------
    views : upright views (h, w, 3) by lens.
    rig : calibrated.
    front : ``T_wcs_front`` of the exposure.
    xyz_wcs_m, intensity : (n, 3), (n,) points around it; in each direction the nearest counts.

    Returns
    -------
    ``-n/2 ln(1 - r^2)`` in nats by key of `READINGS`, of both lenses together.
    """
    found = dict.fromkeys(READINGS, 0.0)
    read = {reading: turn(views) for reading, turn in READINGS.items()}
    for name, place in rig.T_front_lens.items():
        pose, camera = front @ place, rig.cameras[name]
        local = (xyz_wcs_m - pose.shift_m) @ pose.R
        r = np.linalg.norm(local, axis=1)
        widest = np.cos(np.deg2rad(rig.settings.field_of_view_deg / 2 - RIM_DEG))
        seen = np.flatnonzero(local[:, 2] > widest * r)
        # the nearest point of each cell of half a degree is not hidden
        cell = pixels_of(local[seen], 720).astype(np.int64) @ np.array([1, 720])
        order = np.argsort(r[seen], kind="stable")
        first = order[np.unique(cell[order], return_index=True)[1]]
        points = seen[first]
        xy = camera.project(local[points])
        inside = camera.inside(xy, 1.0)
        points, pixel = points[inside], xy[inside].astype(np.int64)
        if len(points) < 100:
            continue
        around = pixel // (camera.size_px[0] // _CELLS) @ np.array([1, 4 * _CELLS])
        a = _about_means(intensity[points], around)
        for reading, view in read.items():
            grey = ndimage.uniform_filter(view[name].mean(axis=2), 3)
            b = _about_means(grey[pixel[:, 1], pixel[:, 0]], around)
            norm = float(np.sqrt((a @ a) * (b @ b)))
            rho = float(a @ b) / norm if norm > 0 else 0.0
            found[reading] += -0.5 * len(a) * float(np.log1p(-min(rho**2, 1 - 1e-9)))
    return found


def _about_means(values: AnyArray, group: AnyArray) -> ArrayF:
    n = np.maximum(np.bincount(group), 1)
    return np.asarray(values - (np.bincount(group, values) / n)[group])
