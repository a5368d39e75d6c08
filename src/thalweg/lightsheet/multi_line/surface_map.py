"""The map that grows while labels are given: where a surface was seen, and what light has passed through.

Each labelled point says two things. Its place is occupied; and the ways of the light from the laser to it
and from it to the camera are free. A detection is a camera ray with one place on it for each line; places
in free water, or behind a known surface, cannot be right, and places on a surface that another line has
seen in another image are likely.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from thalweg.core.types import ArrayF, ArrayI, ArrayU8
from thalweg.lightsheet.multi_line import label_kernels
from thalweg.lightsheet.multi_line.detections import Hypotheses

UNKNOWN: Final = 0
SUPPORTED: Final = 1
CONTRADICTED: Final = 2
IMPOSSIBLE: Final = 3

_SLOTS: Final = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """Pose of the sensor's window frame in the frame of the map: ``x_map = R x + t`` in millimetres."""

    t_mm: ArrayF
    R: ArrayF = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True, slots=True, kw_only=True)
class MapSettings:
    """Size and tolerances of the map.

    Parameters
    ----------
    low_mm, high_mm : (2,) extent in the plane.
    min_depth_mm, max_depth_mm : extent in depth, in the frame of the map.
    cell_mm, voxel_mm : size of cells in the plane, and (3,) of the voxels of free water.
    radius_mm : how far in the plane a point supports.
    tolerance_mm, growth : difference of depth that is allowed at no distance, and its growth per millimetre.
    hidden_mm : how far behind a surface a place must be to be hidden.
    free_end_mm : distance from a point at which its rays begin to count as free.
    free_length_mm : how far up the rays are followed.
    free_rays : rays that must have passed through a voxel.
    """

    low_mm: tuple[float, float]
    high_mm: tuple[float, float]
    min_depth_mm: float = 30.0
    max_depth_mm: float = 220.0
    cell_mm: float = 1.0
    voxel_mm: tuple[float, float, float] = (1.0, 1.0, 1.0)
    radius_mm: float = 1.6
    tolerance_mm: float = 0.3
    growth: float = 0.35
    hidden_mm: float = 2.0
    free_end_mm: float = 1.5
    free_length_mm: float = 90.0
    free_rays: int = 2


class SurfaceMap:
    """Cells with points and voxels of free water."""

    def __init__(self, settings: MapSettings) -> None:
        self.settings = settings
        extent = np.asarray(settings.high_mm) - settings.low_mm
        nx, ny = (int(np.ceil(side / settings.cell_mm)) for side in extent)
        self.corner = np.array([*settings.low_mm, settings.min_depth_mm])
        self.voxel = np.asarray(settings.voxel_mm, dtype=np.float64)
        depth = settings.max_depth_mm - settings.min_depth_mm
        size = [int(np.ceil(side / v)) for side, v in zip([*extent, depth], self.voxel, strict=True)]
        self.points = np.zeros((nx, ny, _SLOTS, 3))
        self.who: ArrayI = np.zeros((nx, ny, _SLOTS, 2), dtype=np.int64)
        self.count: ArrayU8 = np.zeros((nx, ny), dtype=np.uint8)
        self.free: ArrayU8 = np.zeros(size, dtype=np.uint8)
        self.n_outside = 0

    def add(
        self, xyd_mm: ArrayF, label: ArrayI, frame: int, camera_slope: ArrayF, laser_slope: ArrayF
    ) -> None:
        """Add labelled points (n, 3: x, y, depth) of an image, with the slopes (n, 2) of their rays."""
        s = self.settings
        self.n_outside += label_kernels.add_points(
            self.points, self.who, self.count, self.corner, s.cell_mm, xyd_mm, label, frame
        )
        for slope in (camera_slope, laser_slope):
            label_kernels.carve(
                self.free, self.corner, self.voxel, xyd_mm, slope, s.free_end_mm, s.free_length_mm
            )

    def ask(self, xyd_mm: ArrayF, slope: ArrayF, possible: ArrayU8, frame: int) -> tuple[ArrayU8, ArrayF]:
        """State (n, L) of hypotheses (n, L, 3) on camera rays (n, 2), and depth of support minus theirs."""
        s = self.settings
        state = np.zeros(possible.shape, dtype=np.uint8)
        off = np.full(possible.shape, np.nan)
        limits = np.array([s.radius_mm, s.tolerance_mm, s.growth, s.hidden_mm, float(s.free_rays)])
        label_kernels.look_up(
            self.points, self.who, self.count, self.corner, s.cell_mm, self.free, self.voxel,
            xyd_mm, slope, possible, limits, frame, state, off,
        )  # fmt: skip
        return state, off


def in_map(h: Hypotheses, pose: Pose) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Hypotheses (n, L, 3: x, y, depth) and slopes (n, 2), (n, L, 2) of their rays, in the map's frame."""
    xyz = h.xyd_mm * [1.0, 1.0, -1.0] @ pose.R.T + pose.t_mm
    return xyz * [1.0, 1.0, -1.0], _turned(h.slope, pose), _turned(h.laser_slope, pose)


def _turned(slope: ArrayF, pose: Pose) -> ArrayF:
    ray = np.concatenate([slope, np.full((*slope.shape[:-1], 1), -1.0)], axis=-1) @ pose.R.T
    return np.asarray(-ray[..., :2] / ray[..., 2:])
