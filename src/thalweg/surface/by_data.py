"""Lengths that suit a cloud: from the spacing of its points and how far they scatter about their surface.

The spacing is that of a square raster as dense as the cloud, seen along the mean direction of its surface.
The sixth neighbour stands sqrt(2) spacings away, in a raster exactly, among random places in the mean within
3 %. The scatter is that of a point and its nearest ones in that view about their plane: noise, and roughness
finer than their distances. Both are medians over the cloud.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ValidationError
from scipy.spatial import cKDTree

from thalweg.core import ArrayF, ArrayI, ConfigError
from thalweg.settings.sections import ReferenceSettings
from thalweg.surface.meshing import BankFrame, fit_bank, thin_track, triangulate
from thalweg.surface.reference import finite_and_single

_ASKED: Final = 5_000
"""So many points, evenly spread over the file, tell spacing and scatter."""
_SIXTH: Final = 6
_NEAREST: Final = 16
_SLOPE: Final = 0.05
"""A cell is wide enough if the mean of its points is uncertain by this share of its width."""
_SIDES: Final = 5.0
"""Triangles with edges so many times the usual one are holes."""


@dataclass(frozen=True, slots=True)
class Texture:
    """Spacing and scatter of a cloud, metres, and the frame along whose axis `out` it was seen."""

    spacing_m: float
    scatter_m: float
    frame: BankFrame

    @property
    def cell_m(self) -> float:
        """Cells in which the points of noisy clouds become one; without noise they are too small for two.

        The mean of the ``(cell / spacing)^2`` points of a cell has the sigma ``scatter * spacing / cell``.
        """
        return float(np.sqrt(max(self.scatter_m / _SLOPE, 0.25 * self.spacing_m) * self.spacing_m))


def texture_of(points_m: ArrayF, seen_from_m: ArrayLike) -> Texture:
    """Spacing and scatter of points of a surface.

    Parameters
    ----------
    points_m : (n, 3).
    seen_from_m : (k, 3) places in front of the surface.

    Raises
    ------
    InputError : fewer than three points.
    GeometryError : all of them on a line.
    """
    points_m = finite_and_single(points_m)[0]
    frame = fit_bank(points_m, thin_track(np.atleast_2d(seen_from_m))).frame
    seen = frame.to_bank(points_m)
    some = seen[:: -(-len(seen) // _ASKED)]
    k = min(_NEAREST + 1, len(seen))
    distance, near = (np.asarray(each) for each in cKDTree(seen[:, :2]).query(some[:, :2], k=k, workers=-1))
    spacing = float(np.median(distance[:, min(_SIXTH, k - 1)])) / np.sqrt(2.0)
    scatter = 0.0
    if k > _SIXTH:
        about = seen[near] - some[:, None]
        rows = np.concatenate([np.ones((len(some), k, 1)), about[..., :2] / max(spacing, 1e-300)], axis=2)
        plane = np.einsum("pij,pj->pi", np.linalg.pinv(rows), about[..., 2])
        left = about[..., 2] - np.einsum("pij,pj->pi", rows, plane)
        scatter = float(np.sqrt(np.median(np.sum(left**2, axis=1)) / (k - 3)))
    return Texture(spacing, scatter, frame)


def meshing_by_data(
    points_m: ArrayF, seen_from_m: ArrayLike, stated: Mapping[str, Any]
) -> tuple[ReferenceSettings, Texture]:
    """How to mesh a cloud: as stated, and with lengths of its own where nothing is.

    Nothing of it is left out unless that is stated: neither plants nor lonely points, which have no edges
    short enough for a surface.

    Parameters
    ----------
    points_m, seen_from_m : as of `texture_of`.
    stated : settings of the section ``reference``; None counts as not stated.

    Raises
    ------
    ConfigError : settings that contradict each other, or beyond their limits.
    InputError, GeometryError : as of `texture_of`.
    """
    texture = texture_of(points_m, seen_from_m)
    known = {name: value for name, value in stated.items() if value is not None}
    cell = float(known.setdefault("cell_m", texture.cell_m))
    if "longest_edge_m" not in known:
        place = np.floor(texture.frame.to_bank(points_m)[:, :2] / cell).astype(np.int64)
        one = points_m[np.unique(place, axis=0, return_index=True)[1]]
        edge = _SIDES * usual_side_m(one, triangulate(one, texture.frame, longest_edge_m=np.inf).faces)
        known["longest_edge_m"] = max(edge, 2.0 * cell)
    try:
        chosen = {"isolated_neighbours": 0, "clearance_m": None, "sigma_m": 0.0} | known
        return ReferenceSettings.model_validate(chosen), texture
    except ValidationError as error:
        raise ConfigError(
            "; ".join(each["msg"].removeprefix("Value error, ") for each in error.errors()),
            expected="lengths that fit each other",
            cure="Leave out reference.cell_m and reference.longest_edge_m: the data tell both",
        ) from error


def usual_side_m(vertices_m: ArrayF, faces: ArrayI) -> float:
    """Median of the longest sides of triangles (m, 3) over vertices (n, 3)."""
    corners = vertices_m[faces]
    return float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)))
