"""Each cone against all others: does the lidar see it where the reference says?

After an adjustment one cone at a time is given a place of its own for the lidar: a shift of its middle and a
tilt of its axis that the reference does not know. With the standardised derivatives ``G`` of the lidar's
distances by these five, residuals ``v`` and the adjustment's ``A`` and ``Q``, all in units of the sigmas::

    S = G^T G - (G^T A) Q (A^T G),    displacement = -S^-1 G^T v,    covariance S^-1

(Baarda 1968, data snooping with several outliers in one group). A cone that fell over or was pushed since the
pictures of the field were taken stands out, and the others tell it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.stats import chi2, norm

from thalweg.calibration.camera_lidar.model import Layout, LidarRows, Unknowns, lidar_rows
from thalweg.calibration.cones.selection import ConeScan
from thalweg.core.adjustment.solve import Adjusted, UnobservableError
from thalweg.core.types import ArrayF

_MIDDLE_M: Final = 0.35
"""Place along the axis whose shift is reported, about the middle of a cone; it changes no test."""

_FREE: Final = 1e-9
"""Smallest eigenvalue of a normal matrix over its largest, if scaled to a unit diagonal."""

_PARALLEL: Final = 0.999


@dataclass(frozen=True, slots=True, kw_only=True)
class Displacement:
    """What the lidar says of a cone's place, against reference and all other cones.

    ``position`` is empty for all positions together. ``shift_m`` (3,) of the middle in pcs and ``tilt_rad``
    (2,) of the axis along its tangents, ``cov`` (5, 5) of both; ``sigmas``: the number of standard deviations
    of a normal error that is as unlikely.
    """

    cone: str
    position: str
    points: int
    shift_m: ArrayF
    tilt_rad: ArrayF
    cov: ArrayF
    sigmas: float

    def row(self) -> dict[str, Any]:
        """One line of a table."""
        s = np.sqrt(np.diag(self.cov))
        return {
            "cone": self.cone,
            "position": self.position or "all",
            "points": self.points,
            **{f"shift_{a}_mm": 1e3 * v for a, v in zip("xyz", self.shift_m, strict=True)},
            "sigma_shift_mm": 1e3 * float(np.linalg.norm(s[:3])),
            "tilt_deg": float(np.rad2deg(np.linalg.norm(self.tilt_rad))),
            "sigma_tilt_deg": float(np.rad2deg(np.linalg.norm(s[3:]))),
            "sigmas": self.sigmas,
        }


def displacements(
    adjusted: Adjusted[Unknowns],
    layout: Layout,
    scans: Sequence[ConeScan],
    tolerance_m: float,
) -> list[Displacement]:
    """Displacement of each cone, for all positions together and, if there are several, for each one.

    Parameters
    ----------
    adjusted, layout, scans : of the adjustment.
    tolerance_m : standard deviation of a displacement that is no fault; 3 times its tilt over the length.
    """
    x = adjusted.x
    rows = [lidar_rows(layout, x, p, scan) for p, scan in enumerate(scans)]
    out = []
    for k, name in enumerate(layout.cones):
        parts = [_normal(x, k, r, scan) for r, scan in zip(rows, scans, strict=True)]
        there = [p for p, part in enumerate(parts) if part[3] > 0]
        for mine, label in [(there, ""), *(([p], layout.positions[p]) for p in there if len(there) > 1)]:
            if not mine:
                continue
            G = np.sum([parts[p][0] for p in mine], axis=0)
            GA = np.sum([parts[p][1] for p in mine], axis=0)
            g = np.sum([parts[p][2] for p in mine], axis=0)
            found = _solve(G, GA, g, adjusted.cov, tolerance_m)
            if found is not None:
                d, cov, sigmas = found
                n = sum(parts[p][3] for p in mine)
                out.append(
                    Displacement(cone=name, position=label, points=n, shift_m=d[:3], tilt_rad=d[3:], cov=cov,
                                 sigmas=sigmas)
                )  # fmt: skip
    return out


def worst(found: Sequence[Displacement], sigmas: float) -> Displacement | None:
    """The displacement that is least likely, if it exceeds a number of sigmas; a single position only where
    the cone as a whole does not stand out more.
    """
    bad = [d for d in found if d.sigmas > sigmas]
    return max(bad, key=lambda d: (d.sigmas, d.position == "")) if bad else None


def _normal(x: Unknowns, k: int, rows: LidarRows, scan: ConeScan) -> tuple[ArrayF, ArrayF, ArrayF, int]:
    cone = x.cones[k]
    on = np.flatnonzero(scan.cone == k)
    root = 1 / np.sqrt(scan.variance_m2[on])
    by_motion = -rows.by_transform(rows.at_pcs - (cone.apex_m + _MIDDLE_M * cone.axis))[on]
    # Turning about b2 moves the axis along b1, about -b1 along b2; about the axis itself nothing changes.
    b1, b2 = cone.tangents
    G = np.hstack([by_motion[:, :3], by_motion[:, 3:] @ np.stack([b2, -b1]).T]) * root[:, None]
    A, r = rows.jacobian[on] * root[:, None], rows.residual[on] * root
    return G.T @ G, G.T @ A, G.T @ r, len(on)


def _solve(
    G: ArrayF, GA: ArrayF, g: ArrayF, Q: ArrayF, tolerance_m: float
) -> tuple[ArrayF, ArrayF, float] | None:
    S = G - GA @ Q @ GA.T
    values, vectors = np.linalg.eigh((S + S.T) / 2)
    seen = values > 1e-6 * max(float(np.trace(G)), 1e-30)
    if not seen.any():
        return None
    V = vectors[:, seen]
    inverse = V @ np.diag(1 / values[seen]) @ V.T
    d = -inverse @ g
    slack = np.diag([tolerance_m**2] * 3 + [(3 * tolerance_m) ** 2] * 2)
    small = V.T @ (inverse + slack) @ V
    square = float((V.T @ d) @ np.linalg.solve(small, V.T @ d))
    return d, inverse, float(norm.isf(max(chi2.sf(square, int(seen.sum())) / 2, 1e-300)))


def refuse_undetermined(layout: Layout, x: Unknowns, scans: Sequence[ConeScan]) -> None:
    """Refuse scans that leave the relative orientation free even with cones and camera known.

    Raises
    ------
    UnobservableError : names the turn or shift that is free, and what to add.
    """
    N = np.zeros((6, 6))
    for p, scan in enumerate(scans):
        if len(scan.cone):
            rows = lidar_rows(layout, x, p, scan)
            # In pcs, about the scanner: what is free is a turn or shift that can be shown in the field.
            J = rows.by_transform(rows.at_pcs - (x.poses[p] @ x.T_ccs_scs).shift_m)
            N += J.T @ (J / scan.variance_m2[:, None])
    scale = np.sqrt(np.maximum(np.diag(N), _FREE * max(N.max(), 1.0)))
    values, vectors = np.linalg.eigh(N / np.outer(scale, scale))
    free = values < _FREE * max(values[-1], 1e-300)
    if not free.any():
        return
    turn = (vectors[:, 0] / scale)[3:]
    used = sorted({layout.cones[k] for s in scans for k in np.unique(s.cone)})
    weight = np.abs(np.concatenate([np.zeros(3), x.poses[0].R.T @ turn]))
    order = [i for i in np.argsort(-weight)[:3] if weight[i] > 0.2 * weight.max()]
    raise UnobservableError(
        [*(layout.names[layout.orientation][i] for i in order), f"{_words(turn, layout, x, used)}"],
        defects=int(free.sum()),
        cure=f"The lidar sees {', '.join(used)} only. Add a cone at another place in its view, with another "
        "axis, or a position from which it sees more: nothing shows a turn about the axis of a single cone",
    )


def _words(turn: ArrayF, layout: Layout, x: Unknowns, used: Sequence[str]) -> str:
    length = float(np.linalg.norm(turn))
    if length == 0:
        return "a shift of the lidar"
    u = turn / length
    about = [n for n in used if abs(u @ x.cones[layout.cones.index(n)].axis) > _PARALLEL]
    if about:
        return f"a turn of the lidar about the axis of {' and '.join(about)}"
    return "a turn of the lidar about " + (
        "the vertical" if abs(u[2]) > _PARALLEL else f"the direction ({u[0]:.2f}, {u[1]:.2f}, {u[2]:.2f})"
    )
