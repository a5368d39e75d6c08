"""Orientations as a file of another program has them, before they are put into the world frame.

The coordinates of a pose stand in the frame of the file (`Place`); its rotation leads from the camera frame
ccs (x right, y down, z along the view) into that frame: in a map grid east, north, up of the grid, in
geographic coordinates those of the place itself.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError

from thalweg.core.camera.model import Camera
from thalweg.core.errors import InputError
from thalweg.core.types import AnyArray, ArrayF, ArrayI

Kind = Literal["world", "map", "geographic", "geocentric", "free"]

WORLD = "world"
"""Name of the campaign's world frame, where a CRS is asked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """What coordinates refer to.

    Parameters
    ----------
    kind : ``world`` wcs; ``map`` easting, northing, height; ``geographic`` longitude, latitude in degrees,
        height; ``geocentric``; ``free`` a frame with a scale and an attitude of its own.
    crs : of the coordinates; None in ``world`` and ``free``.
    """

    kind: Kind
    crs: CRS | None = None

    @property
    def text(self) -> str:
        """For people."""
        return (
            self.crs.name
            if self.crs is not None
            else {"world": "world frame", "free": "own frame"}[self.kind]
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Angles:
    """Three angles of each pose as they stand in a table, (n, 3) in ``unit``, and how they were read."""

    values: ArrayF
    unit: str
    rotation: str
    direction: str
    axes: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """Poses of one file.

    Parameters
    ----------
    program : what wrote the file.
    where : the file.
    place : what the coordinates refer to.
    names : n names of images.
    coordinates : (n, 3) projection centres.
    R_place_ccs : (n, 3, 3).
    cov : (n, 6, 6) of (shift in metres; rotation vector) about the axes to which the rotations refer; NaN
        where the file states nothing.
    camera : (n,) index of the interior orientation; -1 if the file has none.
    cameras : interior orientations.
    n_marks : (n,) tie points in each image, 0 if not known.
    absent : images of the file without pose, and why.
    angles : as they stand in a table; None for other files.
    notes : for people.
    """

    program: str
    where: str
    place: Place
    names: tuple[str, ...]
    coordinates: ArrayF
    R_place_ccs: ArrayF
    cov: ArrayF
    camera: ArrayI
    cameras: tuple[Camera, ...] = ()
    n_marks: ArrayF = field(default_factory=lambda: np.empty(0))
    absent: Mapping[str, str] = field(default_factory=dict)
    angles: Angles | None = None
    notes: tuple[str, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not len(self.n_marks):
            object.__setattr__(self, "n_marks", np.zeros(len(self.names)))
        if not len(self.names):
            raise InputError("no image with a pose", expected="at least one", where=self.where)
        twice = sorted(name for name, times in Counter(self.names).items() if times > 1)[:3]
        if twice:
            raise InputError(f"two poses of {', '.join(twice)}", expected="each image once", where=self.where)
        bad = ~np.isfinite(self.coordinates).all(axis=1)
        if bad.any():
            name = self.names[int(np.argmax(bad))]
            raise InputError(f"no finite coordinates of {name}", expected="three numbers", where=self.where)
        gram = self.R_place_ccs @ np.swapaxes(self.R_place_ccs, 1, 2)
        # the readers have made them orthogonal, see `orthogonal`
        off = np.abs(gram - np.eye(3)).max(axis=(1, 2))
        odd = ~(off < 1e-9) | (np.linalg.det(self.R_place_ccs) < 0)
        if odd.any():
            name = self.names[int(np.argmax(odd))]
            raise InputError(
                f"the rotation of {name} is none", expected="an orthogonal matrix, no reflection",
                where=self.where,
            )  # fmt: skip

    def chosen(self, rows: AnyArray) -> "Finished":
        """Some of the poses, by index."""
        angles = self.angles
        if angles is not None:
            angles = replace(angles, values=angles.values[rows])
        return replace(
            self, names=tuple(self.names[i] for i in rows), coordinates=self.coordinates[rows],
            R_place_ccs=self.R_place_ccs[rows], cov=self.cov[rows], camera=self.camera[rows],
            n_marks=self.n_marks[rows], angles=angles,
        )  # fmt: skip


def place_of(text: str | CRS, where: str) -> Place:
    """From the name of a CRS, or ``world``.

    Raises
    ------
    InputError : an unknown CRS, or one that is neither projected nor geographic nor geocentric.
    """
    if isinstance(text, str) and text.strip().lower() == WORLD:
        return Place(kind="world")
    try:
        crs = CRS.from_user_input(text)
    except CRSError as error:
        raise InputError(
            f"the CRS '{str(text)[:80]}' is not known", expected="such as EPSG:25833, or world", where=where
        ) from error
    base = crs.sub_crs_list[0] if crs.is_compound else crs
    if base.is_projected:
        return Place(kind="map", crs=crs)
    if base.is_geocentric:
        return Place(kind="geocentric", crs=crs)
    if base.is_geographic:
        return Place(kind="geographic", crs=crs)
    raise InputError(
        f"the CRS '{crs.name}' has no place on the earth", expected="a grid, or geographic coordinates",
        where=where, cure="Name the CRS in images.finished.crs",
    )  # fmt: skip


def orthogonal(R: ArrayF, where: str, names: tuple[str, ...]) -> ArrayF:
    """The rotations (n, 3, 3) closest to matrices with few digits.

    Raises
    ------
    InputError : a matrix is more than 1e-3 away from any rotation.
    """
    if not np.isfinite(R).all():
        k = int(np.argmax(~np.isfinite(R).all(axis=(1, 2))))
        raise InputError(f"the rotation of {names[k]} holds no numbers", expected="a rotation", where=where)
    U, s, Vt = np.linalg.svd(R)
    bad = (np.abs(s - 1) > 1e-3).any(axis=1) | (np.linalg.det(R) < 0)
    if bad.any():
        name = names[int(np.argmax(bad))]
        raise InputError(
            f"the rotation of {name} is none", expected="an orthogonal matrix, no reflection", where=where
        )
    return np.asarray(U @ Vt)
