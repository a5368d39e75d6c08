"""Poses of the static positions and points of the field out of one bundle, with their joint covariance.

The pictures of the static positions help to calibrate the boat's camera and to refine the points of the
field, and the poses come from the same marks. Taken as independent, these marks would be used twice, and the
sigmas of what follows come out too small. So the camera-lidar adjustment starts from a block of one solution:
the adjusted poses and points of `thalweg.calibration.camera.boat_camera.orient_on_field`, with all that they
share.

Points ``u`` of the field that no picture of the boat's camera shows are not in that bundle, but they hang
together with those that are (``s``). With ``C`` the covariance of the field before, ``x`` and ``Q`` the
bundle's values and covariance after::

    x_u = x_u0 + G (x_s - x_s0),   G = C_us C_ss^-1
    Q_u = C_uu - G C_su + G Q_s G^T,   Q_(u, pose) = G Q_(s, pose)

That is what the bundle would give with these points among its unknowns.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from thalweg.calibration.camera_lidar.model import FieldErrors
from thalweg.calibration.field.description import FieldDescription
from thalweg.calibration.field.network import FieldNetwork
from thalweg.calibration.field.points import FieldPoints
from thalweg.core.errors import InputError
from thalweg.core.rigid import Rigid
from thalweg.core.types import AnyArray, ArrayF

KIND: Final = "thalweg static positions"
VERSION: Final = 1
_SINGULAR_M: Final = 1e-6
"""Added to each coordinate, as in the bundle: a free network has no error along its datum."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Statics:
    """Poses of pictures and points of the field from one adjustment.

    Parameters
    ----------
    images : (n,) names of the pictures.
    poses : (n,) ``T_pcs_ccs`` with their own covariance.
    points : the field as adjusted; (m) saddles.
    cov : (6n + 3m, 6n + 3m) joint covariance: shift and rotation vector in pcs of each pose, then the
        coordinates of each point.
    lost : pictures that were asked for and have no pose, with the reason.
    """

    images: tuple[str, ...]
    poses: tuple[Rigid, ...]
    points: FieldPoints
    cov: ArrayF
    lost: Mapping[str, str]

    def errors(self, field: FieldDescription, images: Sequence[str]) -> FieldErrors:
        """Joint errors of some poses and of the marks on the cones, as `calibrate_camera_lidar` takes them.

        Parameters
        ----------
        field : description with the cones.
        images : pictures of the static positions, in their order.
        """
        at = [
            np.array([i for i, (m, _) in enumerate(self.points.points) if m in cone.markers], dtype=np.int64)
            for cone in field.cones
        ]
        poses = [6 * self.images.index(image) + np.arange(6) for image in images]
        rows = np.concatenate([*poses, 6 * len(self.images) + _triples(np.concatenate(at))])
        counts = {c.name: len(k) for c, k in zip(field.cones, at, strict=True)}
        return FieldErrors(cov=self.cov[np.ix_(rows, rows)], points=counts)


def statics_of(network: FieldNetwork, field: FieldPoints, images: Sequence[str]) -> Statics:
    """Poses and points of an adjusted bundle of the boat's camera.

    Parameters
    ----------
    network : as `thalweg.calibration.camera.boat_camera.orient_on_field` gives it.
    field : the points that it started from.
    images : pictures of the static positions; those without a pose are listed with the reason.
    """
    names, cov = tuple(network.poses), network.adjusted.cov
    oriented = tuple(image for image in images if image in network.poses)
    reasons = {str(r.name): str(r.reason) for r in network.rejected.itertuples() if r.what == "image"}
    lost = {
        i: reasons.get(i, "no markers of the field were found in it") for i in images if i not in oriented
    }
    index = field.index
    old = np.array([index[point] for point in network.points], np.int64)
    new = np.array(sorted(set(range(len(field.points))) - set(old.tolist())), np.int64)
    poses = [np.arange(6) + network.layout.pose(names.index(i)).start for i in oriented]
    known = np.concatenate([*poses, network.layout.points + np.arange(3 * len(old))]).astype(np.int64)
    Q = cov[np.ix_(known, known)]
    s, u = _triples(old), _triples(new)
    before = field.cov[np.ix_(s, s)] + np.eye(len(s)) * _SINGULAR_M**2
    G = np.linalg.solve(before, field.cov[np.ix_(s, u)]).T
    n = 6 * len(oriented)
    # [poses, s, u] from [poses, s], then into the order of the field
    B = np.zeros((n + len(s) + len(u), len(known)))
    B[: len(known)] = np.eye(len(known))
    B[len(known) :, n:] = G
    whole = B @ Q @ B.T
    whole[len(known) :, len(known) :] += field.cov[np.ix_(u, u)] - G @ field.cov[np.ix_(s, u)]
    place = np.concatenate([np.arange(n), n + s, n + u])
    joint = np.empty_like(whole)
    joint[np.ix_(place, place)] = (whole + whole.T) / 2
    xyz = field.points_pcs.copy()
    change = (network.points_pcs - field.points_pcs[old]).ravel()
    xyz[old] = network.points_pcs
    xyz[new] += (G @ change).reshape(-1, 3)
    return Statics(
        images=oriented,
        poses=tuple(network.poses[i] for i in oriented),
        points=FieldPoints(points=field.points, points_pcs=xyz, cov=joint[n:, n:]),
        cov=joint,
        lost=lost,
    )


def write_statics(path: Path, statics: Statics) -> None:
    """Write what `read_statics` reads (NumPy archive)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    matrices = [T.matrix for T in statics.poses]
    with path.open("wb") as file:
        np.savez(
            file,
            kind=np.array(f"{KIND} {VERSION}"),
            images=np.array(json.dumps(list(statics.images))),
            lost=np.array(json.dumps(dict(statics.lost))),
            poses=np.array(matrices).reshape(-1, 4, 4),
            points=np.array(statics.points.points, np.int64).reshape(-1, 2),
            points_pcs=statics.points.points_pcs,
            cov=statics.cov,
        )


def read_statics(path: Path) -> Statics:
    """Read what `write_statics` wrote.

    Raises
    ------
    InputError : the file is missing or something else.
    """
    expected = f"{KIND}, version {VERSION}, as the orientation of the boat's camera writes it"
    if not path.is_file():
        raise InputError("file not found", expected=expected, where=path)
    try:
        with np.load(path, allow_pickle=False) as stored:
            part = {name: stored[name] for name in stored.files}
        kind, images, lost = (str(part[name]) for name in ("kind", "images", "lost"))
        names, reasons, cov = tuple(json.loads(images)), json.loads(lost), part["cov"]
        points = tuple((int(m), int(c)) for m, c in part["points"])
        n = 6 * len(names)
        poses = tuple(
            Rigid.from_matrix(T, cov[6 * k : 6 * k + 6, 6 * k : 6 * k + 6])
            for k, T in enumerate(part["poses"])
        )
        known = FieldPoints(points=points, points_pcs=part["points_pcs"], cov=cov[n:, n:])
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise InputError(f"no static positions ({error!r})", expected=expected, where=path) from error
    size = n + 3 * len(points)
    if kind != f"{KIND} {VERSION}" or cov.shape != (size, size) or len(poses) != len(names):
        raise InputError(
            f"'{kind}' with {len(names)} pictures and a covariance of {cov.shape}",
            expected=expected,
            where=path,
        )
    return Statics(images=names, poses=poses, points=known, cov=cov, lost=reasons)


def _triples(at: AnyArray) -> AnyArray:
    """Places of the coordinates of points."""
    return (3 * np.asarray(at, np.int64).ravel()[:, None] + np.arange(3)).ravel()
