"""Signed distances of a scan from a reference mesh, with what each point's sigmas predict (P4 7.2, 7.3).

Points whose nearest place is on a border of the mesh are left out: there the distance says where the mesh
ends, at a hole that a marker left, and not where the surface is. Points farther than a limit lie on
something that is not part of the reference, such as the ground around the object.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.types import AnyArray, ArrayB, ArrayF
from thalweg.lightsheet.poses.poses import M_PER_MM
from thalweg.lightsheet.scanning.cloud import ScanCloud
from thalweg.lightsheet.scanning.outliers import NMAD
from thalweg.surface.cloud_to_mesh import Surface

MAX_DISTANCE_MM: Final = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshDistances:
    """Distances of the points of a cloud, in its order.

    ``distance_mm`` (n,) positive in front of the mesh; ``normal`` (n, 3) of the mesh at the nearest place;
    ``sigma_mm`` (n,) predicted along that normal, reference included; ``sigma_own_mm``, ``sigma_pose_mm``,
    ``sigma_shared_mm``, ``sigma_reference_mm`` (n,) its parts; ``at_border``, ``far`` (n,) why a point is
    not ``used``.
    """

    distance_mm: ArrayF
    normal: ArrayF
    sigma_own_mm: ArrayF
    sigma_pose_mm: ArrayF
    sigma_shared_mm: ArrayF
    sigma_reference_mm: ArrayF
    at_border: ArrayB
    far: ArrayB

    @property
    def used(self) -> ArrayB:
        """(n,) points that have a counterpart."""
        return ~self.at_border & ~self.far

    @property
    def sigma_mm(self) -> ArrayF:
        """(n,) predicted standard deviation of the distance."""
        parts = (self.sigma_own_mm, self.sigma_pose_mm, self.sigma_shared_mm, self.sigma_reference_mm)
        return np.sqrt(np.sum(np.square(parts), axis=0))

    def counts(self) -> dict[str, int]:
        """What became of the points; the numbers add up."""
        return {
            "points": len(self.distance_mm), "far": int(self.far.sum()),
            "at_border": int((self.at_border & ~self.far).sum()), "used": int(self.used.sum()),
        }  # fmt: skip

    def with_shared(self, sigma_shared_mm: ArrayF) -> "MeshDistances":
        """The same distances with other shared sigmas, as after an alignment."""
        return replace(self, sigma_shared_mm=sigma_shared_mm)


def mesh_distances(
    cloud: ScanCloud,
    surface: Surface,
    *,
    max_distance_mm: float = MAX_DISTANCE_MM,
    reference_sigma_mm: float = 0.0,
) -> MeshDistances:
    """Signed distances of all points of a scan from a mesh in the same frame.

    Parameters
    ----------
    cloud, surface : in one frame, metres.
    max_distance_mm : points farther away are not part of the reference.
    reference_sigma_mm : of the reference as a whole, beside what its vertices state.
    """
    found = surface.distances(cloud.xyz_m)
    own, pose, shared = cloud.variances_along(found.normal)
    distance = found.distance_m / M_PER_MM
    known = found.normal.any(axis=1)
    return MeshDistances(
        distance_mm=distance, normal=found.normal,
        sigma_own_mm=np.sqrt(own) / M_PER_MM, sigma_pose_mm=np.sqrt(pose) / M_PER_MM,
        sigma_shared_mm=np.sqrt(shared) / M_PER_MM,
        sigma_reference_mm=np.hypot(found.sigma_m / M_PER_MM, reference_sigma_mm),
        at_border=found.at_border | ~known, far=np.abs(distance) > max_distance_mm,
    )  # fmt: skip


def border_effect(found: MeshDistances) -> dict[str, float]:
    """Mean and standard deviation with and without the points at the mesh's border.

    Raises
    ------
    GeometryError : no point is left without them.
    """
    near = ~found.far
    inner, border = found.distance_mm[found.used], found.distance_mm[near & found.at_border]
    if len(inner) < 2:
        raise GeometryError(f"{len(inner)} points off the border of the mesh", expected="at least two")
    with_border = found.distance_mm[near]
    return {
        "n_border": float(len(border)), "n": float(len(inner)),
        "mean_border_mm": float(border.mean()) if len(border) else float("nan"),
        "mean_mm": float(inner.mean()), "std_mm": float(inner.std(ddof=1)),
        "mean_with_border_mm": float(with_border.mean()),
        "std_with_border_mm": float(with_border.std(ddof=1)),
    }  # fmt: skip


def normality(distance_mm: ArrayF, independent_share: float = 1.0) -> dict[str, float]:
    """Shape of distances: skewness and excess of kurtosis, each over its sigma for that many free points.

    P4 7.2 calls the wreck's distances normally distributed, with a histogram that the registration shifts.
    """
    d = np.asarray(distance_mm, dtype=np.float64)
    z = (d - d.mean()) / d.std()
    n = max(len(d) * independent_share, 8.0)
    skewness, excess = float((z**3).mean()), float((z**4).mean() - 3.0)
    return {
        "mean_mm": float(d.mean()), "std_mm": float(d.std(ddof=1)),
        "nmad_mm": NMAD * float(np.median(np.abs(d - np.median(d)))),
        "skewness": skewness, "excess": excess,
        "skewness_sigmas": skewness / float(np.sqrt(6.0 / n)),
        "excess_sigmas": excess / float(np.sqrt(24.0 / n)),
    }  # fmt: skip


def honesty(distance_mm: ArrayF, sigma_mm: ArrayF, keep: AnyArray) -> dict[str, Any]:
    """Observed against predicted: RMS of the distances, of their sigmas, and of their ratio."""
    d, s = distance_mm[keep], sigma_mm[keep]
    return {
        "n": len(d), "rms_mm": float(np.sqrt(np.mean(d**2))), "predicted_mm": float(np.sqrt(np.mean(s**2))),
        "rms_over_sigma": float(np.sqrt(np.mean((d / s) ** 2))),
    }  # fmt: skip
