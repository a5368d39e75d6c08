"""Interior orientation of a camera: from directions in its frame to pixels and back.

Camera frame ccs: x to the right, y down, z along the view. Pixel coordinates count from the upper left
*corner* of the picture, so that the centre of its first pixel is (0.5, 0.5), as in COLMAP; OpenCV counts from
that centre.

``perspective`` (Brown 1971, in the form of OpenCV and COLMAP), with ``a = X/Z``, ``b = Y/Z`` and
``q = a^2 + b^2``::

    a' = a (1 + k1 q + k2 q^2 + k3 q^3) + 2 p1 a b + p2 (q + 2 a^2)
    b' = b (1 + k1 q + k2 q^2 + k3 q^3) + p1 (q + 2 b^2) + 2 p2 a b
    x = fx a' + cx,   y = fy b' + cy

``fisheye`` (equidistant; P1 eq. 2-3 with the radial part of their corrections), with the angle ``t`` between
ray and view and ``h = sqrt(X^2 + Y^2)``::

    d = t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)
    x = fx d X/h + cx,   y = fy d Y/h + cy

Both limits for ``h -> 0`` are taken, and a fisheye sees beyond 90 degrees.
"""

from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayF

Model = Literal["perspective", "fisheye"]

PARAMETERS: Final[dict[str, tuple[str, ...]]] = {
    "perspective": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"),
    "fisheye": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
}
"""Names of the parameters of each model: pixels for the first four, without unit the others."""

_ITERATIONS: Final = 30
_CLOSE: Final = 1e-13


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """Interior orientation.

    Parameters
    ----------
    model : ``perspective`` or ``fisheye``.
    size_px : width and height.
    parameters : (k,) in the order of `PARAMETERS`.
    cov : (k, k) covariance of the parameters.
    name : for tables and messages.

    Raises
    ------
    GeometryError : an unknown model, a wrong number of parameters, or focal lengths that are not positive.
    """

    model: Model
    size_px: tuple[int, int]
    parameters: ArrayF
    cov: ArrayF = field(default_factory=lambda: np.zeros((0, 0)))
    name: str = "camera"

    def __post_init__(self) -> None:
        names = PARAMETERS.get(self.model)
        if names is None:
            raise GeometryError(f"camera model {self.model!r}", expected=f"one of {', '.join(PARAMETERS)}")
        p = np.asarray(self.parameters, dtype=np.float64)
        C = np.asarray(self.cov, dtype=np.float64)
        C = np.zeros((len(names), len(names))) if C.size == 0 else C
        if p.shape != (len(names),) or not np.isfinite(p).all() or not (p[:2] > 0).all():
            raise GeometryError(
                f"parameters {np.round(p, 6).tolist()} of the camera {self.name!r}",
                expected=f"{len(names)} numbers {', '.join(names)} with positive focal lengths",
            )
        if C.shape != (len(names), len(names)) or not np.allclose(C, C.T, atol=1e-30):
            raise GeometryError(
                f"a covariance of the shape {C.shape} of the camera {self.name!r}",
                expected=f"a symmetric {len(names)}x{len(names)} matrix",
            )
        if min(self.size_px) < 1:
            raise GeometryError(f"a picture of {self.size_px} pixels", expected="positive numbers")
        object.__setattr__(self, "parameters", p)
        object.__setattr__(self, "cov", C)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return PARAMETERS[self.model]

    def with_parameters(self, parameters: ArrayF, cov: ArrayF | None = None) -> "Camera":
        """The same camera with other parameters and, if given, their covariance."""
        given = self.cov if cov is None else cov
        return Camera(
            model=self.model, size_px=self.size_px, parameters=parameters, cov=given, name=self.name
        )

    def scaled(self, size_px: tuple[int, int]) -> "Camera":
        """The same lens and sensor with larger or smaller pixels: a camera set to another picture size.

        Raises
        ------
        GeometryError : the sides have another ratio, so that the new picture would be a part of the old one.
        """
        factor = np.array([new / old for new, old in zip(size_px, self.size_px, strict=True)])
        # a picture of whole pixels is up to half a pixel off the ratio on either side
        if abs(factor[0] / factor[1] - 1) > 0.5 / min(size_px) + 0.5 / min(self.size_px):
            raise GeometryError(
                f"a picture of {size_px[0]} x {size_px[1]} pixels, and a calibration of the camera "
                f"{self.name!r} for {self.size_px[0]} x {self.size_px[1]}",
                expected="the same ratio of the sides",
                cure="Calibrate the camera with the picture format of the survey, or leave its interior "
                "orientation to be estimated",
            )
        scale = np.ones(len(self.parameters))
        scale[:4] = factor[[0, 1, 0, 1]]
        return Camera(
            model=self.model,
            size_px=size_px,
            parameters=self.parameters * scale,
            cov=self.cov * np.outer(scale, scale),
            name=self.name,
        )

    def project(self, points_ccs: ArrayLike) -> ArrayF:
        """Pixels (n, 2) of points (n, 3); NaN for points that the model cannot image.

        A perspective camera images what is in front of it. Far outside the picture its polynomial may fold
        back into it: directions beyond where its radius stops growing give NaN, too. A point outside the
        picture keeps its numbers; ask `inside`.
        """
        return self.project_with_derivatives(points_ccs)[0]

    def inside(self, xy_px: ArrayF, margin_px: float = 0.0) -> ArrayF:
        """Whether pixels (n, 2) lie in the picture, at least a margin away from its edges."""
        low, high = margin_px, np.asarray(self.size_px) - margin_px
        with np.errstate(invalid="ignore"):
            return np.asarray(((xy_px >= low) & (xy_px <= high)).all(axis=1))

    def project_with_derivatives(self, points_ccs: ArrayLike) -> tuple[ArrayF, ArrayF, ArrayF]:
        """Pixels (n, 2), their derivatives (n, 2, 3) by the points and (n, 2, k) by the parameters."""
        points = np.atleast_2d(np.asarray(points_ccs, dtype=np.float64))
        plane = _perspective if self.model == "perspective" else _fisheye
        uv, by_point, by_shape = plane(points, self.parameters[4:])
        f = self.parameters[:2]
        by_parameters = np.zeros((len(points), 2, len(self.parameters)))
        by_parameters[:, 0, 0], by_parameters[:, 1, 1] = uv[:, 0], uv[:, 1]
        by_parameters[:, 0, 2] = by_parameters[:, 1, 3] = 1.0
        by_parameters[:, :, 4:] = f[:, None] * by_shape
        return uv * f + self.parameters[2:4], f[:, None] * by_point, by_parameters

    def rays(self, xy_px: ArrayLike) -> ArrayF:
        """Unit directions (n, 3) in ccs of pixels (n, 2): the inverse of `project`; NaN where none is."""
        xy = np.atleast_2d(np.asarray(xy_px, dtype=np.float64))
        uv = (xy - self.parameters[2:4]) / self.parameters[:2]
        if self.model == "fisheye":
            return _fisheye_rays(uv, self.parameters[4:])
        return _perspective_rays(uv, self.parameters[4:])


def _perspective(points: ArrayF, shape: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
    k1, k2, p1, p2, k3 = shape
    z = np.where(points[:, 2] > 0, points[:, 2], np.nan)
    a, b = points[:, 0] / z, points[:, 1] / z
    q = a * a + b * b
    radial = 1 + q * (k1 + q * (k2 + q * k3))
    slope = k1 + q * (2 * k2 + 3 * k3 * q)
    # Where the distorted radius no longer grows the polynomial folds back.
    a = np.where(radial + 2 * q * slope > 0, a, np.nan)
    uv = np.stack([
        a * radial + 2 * p1 * a * b + p2 * (q + 2 * a * a),
        b * radial + p1 * (q + 2 * b * b) + 2 * p2 * a * b,
    ], axis=1)  # fmt: skip
    by_ab = np.empty((len(a), 2, 2))
    by_ab[:, 0, 0] = radial + 2 * a * a * slope + 2 * p1 * b + 6 * p2 * a
    by_ab[:, 0, 1] = by_ab[:, 1, 0] = 2 * a * b * slope + 2 * p1 * a + 2 * p2 * b
    by_ab[:, 1, 1] = radial + 2 * b * b * slope + 6 * p1 * b + 2 * p2 * a
    ab_by_point = np.zeros((len(a), 2, 3))
    ab_by_point[:, 0, 0] = ab_by_point[:, 1, 1] = 1 / z
    ab_by_point[:, 0, 2], ab_by_point[:, 1, 2] = -a / z, -b / z
    by_shape = np.stack([
        np.stack([a * q, a * q**2, 2 * a * b, q + 2 * a * a, a * q**3], axis=1),
        np.stack([b * q, b * q**2, q + 2 * b * b, 2 * a * b, b * q**3], axis=1),
    ], axis=1)  # fmt: skip
    return uv, by_ab @ ab_by_point, by_shape


def _fisheye(points: ArrayF, shape: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
    x, y, z = points.T
    h2 = x * x + y * y
    h, r2 = np.sqrt(h2), h2 + z * z
    t = np.arctan2(h, z)
    t2 = t * t
    poly = 1 + t2 * (shape[0] + t2 * (shape[1] + t2 * (shape[2] + t2 * shape[3])))
    slope = 1 + t2 * (3 * shape[0] + t2 * (5 * shape[1] + t2 * (7 * shape[2] + t2 * 9 * shape[3])))
    d = np.where(slope > 0, t * poly, np.nan)
    # On the axis d/h -> 1/z; behind the camera the axis itself has no image.
    on_axis = h < 1e-12 * np.sqrt(r2)
    safe_h = np.where(on_axis, 1.0, h)
    ahead = np.where(z > 0, z, np.nan)
    ratio = np.where(on_axis, 1.0 / ahead, d / safe_h)
    uv = np.stack([x * ratio, y * ratio], axis=1)
    # d ratio / dh at constant z, over h; and d ratio / dz
    with np.errstate(divide="ignore", invalid="ignore"):
        by_h = np.where(on_axis, 0.0, (slope * z / r2 - ratio) / np.where(on_axis, 1.0, h2))
        by_z = np.where(on_axis, 0.0, -slope / r2)
    by_point = np.empty((len(points), 2, 3))
    by_point[:, 0, 0], by_point[:, 1, 1] = ratio + x * x * by_h, ratio + y * y * by_h
    by_point[:, 0, 1] = by_point[:, 1, 0] = x * y * by_h
    by_point[:, 0, 2], by_point[:, 1, 2] = x * by_z, y * by_z
    unit = np.stack([x, y], axis=1) / safe_h[:, None]
    powers = np.stack([t**3, t**5, t**7, t**9], axis=1)
    return uv, by_point, unit[:, :, None] * powers[:, None, :]


def _perspective_rays(uv: ArrayF, shape: ArrayF) -> ArrayF:
    """Newton steps on the distortion from the undistorted start."""
    ab = uv.copy()
    for _ in range(_ITERATIONS):
        got, by_point, _ = _perspective(np.concatenate([ab, np.ones((len(ab), 1))], axis=1), shape)
        J = by_point[:, :, :2]
        off = uv - got
        det = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
        with np.errstate(invalid="ignore", divide="ignore"):
            step = np.stack([
                J[:, 1, 1] * off[:, 0] - J[:, 0, 1] * off[:, 1],
                J[:, 0, 0] * off[:, 1] - J[:, 1, 0] * off[:, 0],
            ], axis=1) / det[:, None]  # fmt: skip
        ab = ab + step
        if not np.nanmax(np.abs(step), initial=0.0) > _CLOSE:
            break
    ray = np.concatenate([ab, np.ones((len(ab), 1))], axis=1)
    return np.asarray(ray / np.linalg.norm(ray, axis=1, keepdims=True))


def _fisheye_rays(uv: ArrayF, shape: ArrayF) -> ArrayF:
    d = np.hypot(uv[:, 0], uv[:, 1])
    t = np.minimum(d, np.pi)
    for _ in range(_ITERATIONS):
        t2 = t * t
        poly = 1 + t2 * (shape[0] + t2 * (shape[1] + t2 * (shape[2] + t2 * shape[3])))
        slope = 1 + t2 * (3 * shape[0] + t2 * (5 * shape[1] + t2 * (7 * shape[2] + t2 * 9 * shape[3])))
        step = (d - t * poly) / np.where(slope > 0, slope, np.nan)
        t = t + step
        if not np.nanmax(np.abs(step), initial=0.0) > _CLOSE:
            break
    t = np.where((t >= 0) & (t <= np.pi), t, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = np.where(d[:, None] > 0, uv / np.where(d > 0, d, 1.0)[:, None], 0.0)
    return np.concatenate([np.sin(t)[:, None] * unit, np.cos(t)[:, None]], axis=1)
