"""Cones in the points of a moving scanner without cropping by hand, from coarse to fine.

The mount is known roughly: the angles to some degrees, the lever arm to some decimetres (T 3.1.1 starts with
0). A grid of lever arms, then one of angles, is scored by how many points come to lie on the cones' surfaces;
each cone counts by the logarithm of its own score, so that one near cone cannot outvote the others, and the
ground beneath a cone has no say beside its surface. From the best place a robust fit goes on with weights
``(w^2 / (w^2 + d^2))^2`` (Geman and McClure 1987) whose width ``w`` shrinks.

Which points then enter an adjustment is decided by the surface alone: near it, between apex and base, and not
met at a grazing angle, where a beam that leaves aside passes or comes from elsewhere.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.calibration.cones.cone import Cone
from thalweg.calibration.ins_lidar.run_points import FieldCones, RunPoints
from thalweg.core.errors import CoverageError
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayB, ArrayF, ArrayI

SCORE_WIDTH_M: Final = 0.10
"""Width of the score's kernel: wider than the errors of trajectory and scanner, narrower than a cone."""

ANNEAL_M: Final = (0.20, 0.12, 0.08, 0.05)
"""Widths of the robust fit; the last one is three sigma of a point (P2 eq. 7)."""

_CHUNK: Final = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class MountRange:
    """How far from the start the mount may be.

    Parameters
    ----------
    lever_m : in each component of the lever arm.
    angle_deg : about each axis of ics.
    points_per_cone : points that are tried for each cone at most.
    """

    lever_m: float = 0.6
    angle_deg: float = 5.0
    points_per_cone: int = 600

    @property
    def reach_m(self) -> float:
        """How far from a cone its points may lie with the start's lever arm."""
        return float(self.lever_m * np.sqrt(3) + 0.1)


@dataclass(frozen=True, slots=True, kw_only=True)
class OnCones:
    """Points (n,) on the surface of a cone by the present state of knowledge.

    ``cone`` number of the cone in whose neighbourhood a point lies, -1 none; ``used``; and why others are
    not: ``far`` from the surface, beyond the ``ends``, met at a ``grazing`` angle or beside the outline.
    """

    cone: ArrayI
    used: ArrayB
    far: ArrayB
    ends: ArrayB
    grazing: ArrayB


def find_mount(
    points: RunPoints, field: FieldCones, T_wcs_pcs: Rigid, start: Rigid, search: MountRange
) -> Rigid:
    """The mount ``T_ics_scs`` to some centimetres, from a start that is decimetres off.

    Raises
    ------
    CoverageError : no point of the run comes near any cone, or none lies on one.
    """
    reach = search.reach_m
    near = field.near(points.in_wcs(start), T_wcs_pcs, reach)
    if not np.any(near >= 0):
        raise CoverageError(
            f"none of {len(points)} lidar points comes within {reach:.1f} m of one of the cones "
            f"{', '.join(field.names)}",
            expected="a run past the cones of the field",
            cure="Check heights and datum of the field's targets, and record a run along the cones",
        )
    parts, cones = [], []
    for k, cone in enumerate(field.cones):
        rows = np.flatnonzero(near == k)
        if rows.size:
            rows = rows[:: -(-rows.size // search.points_per_cone)]
            parts.append(points.taken(rows))
            cones.append((cone.in_frame(T_wcs_pcs), float(field.length_m[k])))
    mount = start
    steps = np.arange(-search.lever_m, search.lever_m + 0.05, 0.1)
    turns = np.deg2rad(np.arange(-search.angle_deg, search.angle_deg + 0.5, 1.0))
    for grid, turning in ((steps, False), (turns, True), (np.linspace(-0.2, 0.2, 9), False)):
        mount = _best(parts, cones, mount, grid, turning=turning)
    for width in ANNEAL_M:
        for _ in range(4):
            mount = _robust_step(parts, cones, mount, width)
    return mount


def _best(
    parts: list[RunPoints], cones: list[tuple[Cone, float]], mount: Rigid, grid: ArrayF, *, turning: bool
) -> Rigid:
    """The mount with the best score on a grid of shifts, or of rotation vectors, in ics."""
    changes = np.stack(np.meshgrid(grid, grid, grid, indexing="ij"), axis=-1).reshape(-1, 3)
    total = np.zeros(len(changes))
    for part, (cone, length) in zip(parts, cones, strict=True):
        arm = part.xyz_scs_m @ mount.R.T
        beam = np.einsum("nij,nj->ni", part.R_wcs_ics, arm / np.linalg.norm(arm, axis=1, keepdims=True))
        start = part.to_wcs(mount.apply(part.xyz_scs_m))
        score = np.empty(len(changes))
        for at in range(0, len(changes), _CHUNK):
            some = changes[at : at + _CHUNK]
            if turning:
                moved = np.einsum("nij,gnj->gni", part.R_wcs_ics, np.cross(some[:, None], arm[None]))
            else:
                moved = np.einsum("nij,gj->gni", part.R_wcs_ics, some)
            score[at : at + _CHUNK] = _score(cone, length, start + moved, beam)
        total += np.log(0.05 + score / max(float(score.max()), 1e-9))
    error = np.zeros(6)
    error[3 if turning else 0 :][:3] = changes[int(np.argmax(total))]
    return mount.moved(error)


def _score(cone: Cone, length_m: float, points: ArrayF, beam: ArrayF) -> ArrayF:
    """How many of points (g, n, 3) lie on the side of a cone that beams (n, 3) see, softly counted, (g,)."""
    d = points - cone.apex_m
    z = d @ cone.axis
    across = d - z[..., None] * cone.axis
    rho = np.linalg.norm(across, axis=-1)
    cos_a, sin_a = np.cos(cone.half_angle_rad), np.sin(cone.half_angle_rad)
    toward = cos_a * np.einsum("gni,ni->gn", across, beam) / np.maximum(rho, 1e-9) - sin_a * (
        beam @ cone.axis
    )
    distance = rho * cos_a - z * sin_a
    on = (z > 0) & (z < length_m) & (toward < 0)
    return np.asarray(np.sum(np.where(on, np.exp(-0.5 * (distance / SCORE_WIDTH_M) ** 2), 0.0), axis=1))


def _robust_step(
    parts: list[RunPoints], cones: list[tuple[Cone, float]], mount: Rigid, width_m: float
) -> Rigid:
    N, n = np.zeros((6, 6)), np.zeros(6)
    for part, (cone, length) in zip(parts, cones, strict=True):
        seen = cone.see(part.in_wcs(mount))
        slant = length / np.cos(cone.half_angle_rad)
        J = mount_rows(part, mount, seen.normal)
        toward = np.einsum("ni,ni->n", J[:, :3], part.xyz_scs_m @ mount.R.T)
        on = (seen.slant_m > 0) & (seen.slant_m < slant) & (toward < 0)
        weight = np.where(on, (width_m**2 / (width_m**2 + seen.distance_m**2)) ** 2, 0.0)
        # one vote a cone: near cones have many more points
        weight /= max(float(weight.sum()), 1e-9)
        N += J.T @ (J * weight[:, None])
        n -= J.T @ (weight * seen.distance_m)
    if not np.trace(N) > 0:
        raise CoverageError(
            f"lidar points come near {len(cones)} cones, but none lies on the side that its beam can see",
            expected="points on the surfaces of the cones",
            cure="Check heights and datum of the field's targets (a pole that was not taken off is 2 m), "
            "that the cones stand as they were measured, and calibration.ins_lidar.search_lever_m",
        )
    # 1e-9 of the largest: a direction that no point determines stays where it is
    return mount.moved(np.linalg.solve(N + 1e-9 * np.trace(N) * np.eye(6), n))


def mount_rows(points: RunPoints, T_ics_scs: Rigid, normal_wcs: ArrayF) -> ArrayF:
    """Change (n, 6) of a component of points in wcs with the error (shift; rotation) of the mount in ics."""
    normal_ics = np.einsum("nij,ni->nj", points.R_wcs_ics, normal_wcs)
    arm = points.xyz_scs_m @ T_ics_scs.R.T
    return np.concatenate([normal_ics, np.cross(arm, normal_ics)], axis=1)


def select(
    cone: ArrayI,
    distance_m: ArrayF,
    slant_m: ArrayF,
    cosine: ArrayF,
    *,
    ends_m: ArrayF,
    gate_m: ArrayF | float,
    end_margin_m: float,
    max_incidence_deg: float,
) -> OnCones:
    """Which points lie on the surfaces.

    Parameters
    ----------
    cone : (n,) number of the cone in whose neighbourhood a point lies, -1 none.
    distance_m, slant_m, cosine : (n,) distance from the surface, and where and at which cosine of incidence
        the nominal beam meets it; NaN where it does not.
    ends_m : (c,) length of each cone along its surface.
    gate_m : half width of the layer about the surface, for each point (n,) or for all.
    end_margin_m : points nearer to apex or base are left out.
    max_incidence_deg : points met at a larger angle are left out.
    """
    met = (cone >= 0) & np.isfinite(distance_m)
    away = met & (np.abs(np.nan_to_num(distance_m)) > gate_m)
    on = met & ~away
    outside = (slant_m < end_margin_m) | (slant_m > ends_m[cone] - end_margin_m)
    flat = cosine < np.cos(np.deg2rad(max_incidence_deg))
    return OnCones(
        cone=cone,
        used=on & ~outside & ~flat,
        far=away,
        ends=on & outside,
        grazing=(on & ~outside & flat) | ((cone >= 0) & ~met),
    )
