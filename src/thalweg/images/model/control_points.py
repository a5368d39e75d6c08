"""Control and check points: surveyed coordinates with covariances, and their marks in images."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlPoints:
    """Surveyed points in wcs.

    Parameters
    ----------
    names : k names.
    points_wcs_m : (k, 3) surveyed coordinates.
    cov_wcs_m2 : (k, 3, 3) their covariances.
    check : (k,) whether a point only checks the result.

    Raises
    ------
    GeometryError : shapes that differ, a name twice, or a covariance that is not positive.
    """

    names: tuple[str, ...]
    points_wcs_m: ArrayF
    cov_wcs_m2: ArrayF
    check: ArrayB

    def __post_init__(self) -> None:
        k = len(self.names)
        if len(set(self.names)) != k:
            twice = sorted({n for n in self.names if self.names.count(n) > 1})
            raise GeometryError(
                f"control point{'s' if len(twice) > 1 else ''} {', '.join(twice)} more than once",
                expected="one row for each point",
            )
        shapes = (self.points_wcs_m.shape, self.cov_wcs_m2.shape, self.check.shape)
        if shapes != ((k, 3), (k, 3, 3), (k,)):
            raise GeometryError(f"control points of the shapes {shapes}", expected=f"{k} points")
        bad = [
            n
            for n, c in zip(self.names, self.cov_wcs_m2, strict=True)
            if not np.isfinite(c).all() or np.linalg.eigvalsh(c)[0] <= 0
        ]
        if bad:
            raise GeometryError(
                f"no positive standard deviations of {', '.join(bad[:5])}",
                expected="metres above zero for each coordinate",
                cure="State how well the point was surveyed; 0 would make it perfect",
            )

    @classmethod
    def none(cls) -> "ControlPoints":
        """No points at all."""
        return cls(
            names=(),
            points_wcs_m=np.empty((0, 3)),
            cov_wcs_m2=np.empty((0, 3, 3)),
            check=np.empty(0, np.bool_),
        )

    @classmethod
    def joined(cls, parts: Sequence["ControlPoints"]) -> "ControlPoints":
        """Points of several surveys as one."""
        every = [cls.none(), *parts]
        return cls(
            names=tuple(name for part in every for name in part.names),
            points_wcs_m=np.concatenate([part.points_wcs_m for part in every]),
            cov_wcs_m2=np.concatenate([part.cov_wcs_m2 for part in every]),
            check=np.concatenate([part.check for part in every]),
        )

    def chosen(self, rows: AnyArray) -> "ControlPoints":
        """Some of the points, by index or mask."""
        at = np.arange(len(self.names))[rows]
        return ControlPoints(
            names=tuple(self.names[i] for i in at),
            points_wcs_m=self.points_wcs_m[at],
            cov_wcs_m2=self.cov_wcs_m2[at],
            check=self.check[at],
        )

    def as_check(self, names: Sequence[str]) -> "ControlPoints":
        """The same points, some of them made check points."""
        return replace(self, check=self.check | np.isin(np.array(self.names, object), list(names)))


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlMarks:
    """Marks of control and check points in images.

    Parameters
    ----------
    image, point : (n,) indices of images of the block and of control points.
    xy_px, sigma_px : (n, 2) pixels from the upper left corner, (n,) standard deviation of each coordinate.
    """

    image: ArrayI
    point: ArrayI
    xy_px: ArrayF
    sigma_px: ArrayF

    def __post_init__(self) -> None:
        n = len(self.image)
        shapes = (self.point.shape, self.xy_px.shape, self.sigma_px.shape)
        if shapes != ((n,), (n, 2), (n,)):
            raise GeometryError(f"marks of the shapes {shapes}", expected=f"{n} marks")
        if n and not (self.sigma_px > 0).all():
            raise GeometryError(
                f"a standard deviation of {self.sigma_px.min():g} px of a mark", expected="positive pixels"
            )

    @classmethod
    def none(cls) -> "ControlMarks":
        """No marks at all."""
        empty = np.empty(0, np.int64)
        return cls(image=empty, point=empty, xy_px=np.empty((0, 2)), sigma_px=np.empty(0))

    def chosen(self, rows: AnyArray) -> "ControlMarks":
        """Some of the marks, by index or mask."""
        return ControlMarks(
            image=self.image[rows],
            point=self.point[rows],
            xy_px=self.xy_px[rows],
            sigma_px=self.sigma_px[rows],
        )

    def counts(self, n_points: int) -> ArrayI:
        """Number of marks of each point."""
        return np.bincount(self.point, minlength=n_points).astype(np.int64)
