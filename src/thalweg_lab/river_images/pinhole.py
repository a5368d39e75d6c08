"""A camera without distortion."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import ArrayF, GeometryError


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureCamera:
    """A camera without distortion whose principal point is the middle of the picture.

    Parameters
    ----------
    position_wcs_m : (3,) projection centre.
    R_wcs_ccs : (3, 3) rotation; camera x to the right, y down, z along the view.
    focal_px : focal length in pixels.
    size_px : width and height.
    """

    position_wcs_m: ArrayF
    R_wcs_ccs: ArrayF
    focal_px: float
    size_px: tuple[int, int]

    def __post_init__(self) -> None:
        R = np.asarray(self.R_wcs_ccs)
        # 1e-9: a product of three rotations in float64 is orthogonal to a few 1e-16.
        if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-9) or np.linalg.det(R) < 0:
            raise GeometryError("R_wcs_ccs is no rotation matrix", expected="orthogonal, determinant +1")
        if self.focal_px <= 0 or min(self.size_px) < 1:
            raise GeometryError(f"{self.focal_px=}, {self.size_px=}", expected="positive numbers")

    @classmethod
    def look(
        cls, position_wcs_m: ArrayLike, target_wcs_m: ArrayLike, *, focal_px: float, size_px: tuple[int, int]
    ) -> Self:
        """A level camera at a position that looks at a target.

        Raises
        ------
        GeometryError : the target is straight above or below, or where the camera is.
        """
        position = np.asarray(position_wcs_m, dtype=np.float64)
        view = np.asarray(target_wcs_m, dtype=np.float64) - position
        flat = float(np.hypot(view[0], view[1]))
        if flat < 1e-6:
            raise GeometryError("the target is above or below the camera", expected="a target beside it")
        view = view / np.linalg.norm(view)
        right = np.array([view[1], -view[0], 0.0]) / np.hypot(view[0], view[1])
        R = np.stack([right, np.cross(view, right), view], axis=1)
        return cls(position_wcs_m=position, R_wcs_ccs=R, focal_px=focal_px, size_px=size_px)

    def rays(self, offset_px: tuple[float, float] = (0.5, 0.5)) -> ArrayF:
        """Unit directions (h * w, 3) in wcs through a place of each pixel; (0, 0) is its upper left."""
        width, height = self.size_px
        u = (np.arange(width) + offset_px[0] - width / 2) / self.focal_px
        v = (np.arange(height) + offset_px[1] - height / 2) / self.focal_px
        x, y = np.meshgrid(u, v)
        length = np.sqrt(x * x + y * y + 1.0)
        ray = np.stack([x / length, y / length, 1.0 / length], axis=-1).reshape(-1, 3)
        return np.asarray(ray @ self.R_wcs_ccs.T)

    def project(self, points_wcs_m: ArrayLike) -> tuple[ArrayF, ArrayF]:
        """Column and row (n, 2) in pixels from the upper left corner, and depth (n,) along the view.

        Points that are not in front of the camera have NaN for column and row.
        """
        local = (np.asarray(points_wcs_m, dtype=np.float64) - self.position_wcs_m) @ self.R_wcs_ccs
        depth = local[:, 2]
        ahead = np.where(depth > 0, depth, np.nan)
        middle = np.array(self.size_px) / 2
        return self.focal_px * local[:, :2] / ahead[:, None] + middle, depth
