"""Line points on levels of known depth: what the lines of a multi-line laser are calibrated from.

A calibration target shows planes at known depths below the window, or a plane is lowered step by step. With
the camera calibrated, a pixel and its depth give an object point; the lines must pass through these points.
Where gaps in the upper plane let the light through to the lower one, both ends belong to one sub-beam: a
pair (P3 2.4).
"""

from dataclasses import dataclass, field, replace

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, GeometryError
from thalweg.lightsheet.optics import Sensor, refract_to_water


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelPoints:
    """Image points of lines on levels.

    Parameters
    ----------
    line : (n,) number of the line.
    xy_px : (n, 2) pixels, corner origin.
    angle_rad : (n,) direction in the image along which the point was measured, from x towards y.
    sigma_px : (n,) of the point along this direction.
    depth_mm : (n,) of its level below the outer face of the window.
    pairs : (m, 2) indices of two points of one sub-beam on different levels.
    sigma_along_px : (m,) of the ends of a pair along the line.

    Raises
    ------
    GeometryError : arrays of different lengths, sigmas that are not positive, or pairs that are none.
    """

    line: ArrayI
    xy_px: ArrayF
    angle_rad: ArrayF
    sigma_px: ArrayF
    depth_mm: ArrayF
    pairs: ArrayI = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    sigma_along_px: ArrayF = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        n, m = len(self.line), len(self.pairs)
        lengths = [len(self.xy_px), len(self.angle_rad), len(self.sigma_px), len(self.depth_mm)]
        if lengths != [n] * 4 or len(self.sigma_along_px) != m:
            raise GeometryError(f"line points with columns of the lengths {[n, *lengths]}", expected="one")
        values = (self.xy_px, self.angle_rad, self.sigma_px, self.depth_mm, self.sigma_along_px)
        if not all(np.isfinite(value).all() for value in values):
            raise GeometryError("line points that are not finite", expected="numbers in every row")
        if not ((self.sigma_px > 0).all() and (self.sigma_along_px > 0).all()):
            raise GeometryError("line points without a sigma", expected="positive sigmas in pixels")
        if m and (self.pairs.min() < 0 or self.pairs.max() >= n):
            raise GeometryError(
                "a pair of a point that does not exist", expected=f"indices from 0 to {n - 1}"
            )
        one, other = self.pairs.T if m else (np.zeros(0, dtype=np.int64),) * 2
        same_beam = (self.line[one] == self.line[other]) & (self.depth_mm[one] != self.depth_mm[other])
        if not same_beam.all():
            raise GeometryError(
                f"{(~same_beam).sum()} of {m} pairs between different lines or on one level",
                expected="both ends on the same line and on different levels",
                cure="Check the assignment of gaps and segments",
            )

    def of(self, chosen: ArrayB) -> "LevelPoints":
        """Some of the points, with the pairs of which both ends are among them."""
        number = np.cumsum(chosen) - 1
        kept = chosen[self.pairs].all(axis=1) if len(self.pairs) else np.zeros(0, dtype=np.bool_)

        def some(values: AnyArray) -> AnyArray:
            """The chosen rows."""
            return values[chosen]

        return replace(
            self,
            line=some(self.line),
            xy_px=some(self.xy_px),
            angle_rad=some(self.angle_rad),
            sigma_px=some(self.sigma_px),
            depth_mm=some(self.depth_mm),
            pairs=number[self.pairs[kept]],
            sigma_along_px=self.sigma_along_px[kept],
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectPoints:
    """Object points of `LevelPoints` in the frame of the window.

    ``xyd_mm`` (n, 3): x, y and depth; ``across_mm``, ``along_mm`` (n, 2): their movement on the level for one
    pixel along the measuring direction and at a right angle to it.
    """

    xyd_mm: ArrayF
    across_mm: ArrayF
    along_mm: ArrayF


def on_levels(sensor: Sensor, points: LevelPoints) -> ObjectPoints:
    """Object points of image points whose depth is known.

    Raises
    ------
    GeometryError : pixels whose rays do not reach the water.
    """
    u = np.stack([np.cos(points.angle_rad), np.sin(points.angle_rad)], axis=1)
    w = np.stack([-u[:, 1], u[:, 0]], axis=1)
    here, lost = _on_level(sensor, points.xy_px, points.depth_mm)
    if lost.any():
        raise GeometryError(
            f"{lost.sum()} of {len(lost)} line points whose rays do not reach the water",
            expected="pixels of the camera that look through the window",
            cure="Check the orientation of the camera",
        )
    across, along = (
        _on_level(sensor, points.xy_px + half, points.depth_mm)[0]
        - _on_level(sensor, points.xy_px - half, points.depth_mm)[0]
        for half in (0.5 * u, 0.5 * w)
    )
    return ObjectPoints(
        xyd_mm=np.concatenate([here, points.depth_mm[:, None]], axis=1), across_mm=across, along_mm=along
    )


def _on_level(sensor: Sensor, xy_px: ArrayF, depth_mm: ArrayF) -> tuple[ArrayF, ArrayB]:
    rays = sensor.camera.rays(xy_px) @ sensor.R_lcs_ccs.T
    water = refract_to_water(sensor.camera_origin_lcs_mm, rays, sensor.window)
    return water.A + water.B * depth_mm[:, None], np.asarray(water.status != 0)
