"""What more cones and positions bring: sigmas of the relative orientation before anything is measured (FW14).

Covariances follow from the geometry alone: where the nominal beams of the scanner meet the cones, where the
marks are, how well the camera is oriented. So a field can be judged before it is built, and a calibration can
be compared with fewer cones and positions than it had.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
import pandas as pd

from thalweg.calibration.camera_lidar.model import Layout, Unknowns, groups_of
from thalweg.calibration.cones.cone import Cone
from thalweg.calibration.cones.fit import ConeReference
from thalweg.calibration.cones.selection import ConeScan, Position, SelectionLimits, Verdict, select
from thalweg.core.adjustment.solve import RANK_TOLERANCE
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF

QUANTITIES: Final = (
    ("x_m", "m"), ("y_m", "m"), ("z_m", "m"),
    ("rotation_x_deg", "deg"), ("rotation_y_deg", "deg"), ("rotation_z_deg", "deg"),
)  # fmt: skip
_SUBSETS: Final = 15
"""Choices of cones, or of positions, of one number that are tried; evenly spread over all of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanPattern:
    """Beams of a scanner that stands still.

    Parameters
    ----------
    elevations_deg : of the lasers.
    azimuth_step_deg : from one shot of a laser to its next.
    revolutions : of the recording; they repeat the same beams.
    sigma_along_m, sigma_across_m : of a point along its beam and in each direction across.
    """

    elevations_deg: tuple[float, ...] = tuple(range(-15, 16, 2))
    azimuth_step_deg: float = 0.2
    revolutions: int = 1
    sigma_along_m: float = 0.0173
    sigma_across_m: float = 0.0173

    def beams(self) -> ArrayF:
        """(n, 3) unit directions of one revolution."""
        azimuth = np.deg2rad(np.arange(0.0, 360.0, self.azimuth_step_deg))
        a, w = np.meshgrid(azimuth, np.deg2rad(self.elevations_deg))
        return np.stack([np.cos(w) * np.sin(a), np.cos(w) * np.cos(a), np.sin(w)], axis=-1).reshape(-1, 3)


def planned_scan(
    cones: Sequence[Cone],
    lengths_m: Sequence[float],
    T_pcs_scs: Rigid,
    pattern: ScanPattern,
    limits: SelectionLimits,
) -> ConeScan:
    """Points that would take part, without errors; variances are those of all revolutions together."""
    beams = pattern.beams()
    shape = np.ones(len(beams))
    at_one = Position(
        name="planned",
        T_pcs_ccs=T_pcs_scs,
        points_scs_m=beams,
        var_along_m2=pattern.sigma_along_m**2 * shape,
        var_across_m2=pattern.sigma_across_m**2 * shape,
    )
    # Beams are chosen by their directions; what they measure must not matter.
    chosen = select(cones, lengths_m, T_pcs_scs, at_one, _any_range(limits))
    rows = np.flatnonzero(np.isin(chosen.verdict, (Verdict.USED, Verdict.IN_FRONT, Verdict.BEHIND)))
    reach = np.empty(len(rows))
    for k in np.unique(chosen.cone[rows]):
        on = chosen.cone[rows] == k
        reach[on] = cones[k].meet(T_pcs_scs.shift_m, beams[rows[on]] @ T_pcs_scs.R.T).range_m
    reach = reach + chosen.excess_m[rows]
    return ConeScan(
        points_scs_m=beams[rows] * reach[:, None],
        cone=chosen.cone[rows],
        excess_m=chosen.excess_m[rows],
        variance_m2=chosen.variance_m2[rows] / pattern.revolutions,
    )


def design_study(
    references: Sequence[ConeReference],
    cones: Sequence[Cone],
    poses: Sequence[Rigid],
    T_ccs_scs: Rigid,
    pattern: ScanPattern,
    *,
    limits: SelectionLimits | None = None,
    free_half_angle: bool = True,
) -> pd.DataFrame:
    """Sigmas of the six parameters for choices of cones and positions.

    Parameters
    ----------
    references, cones : reference points and shapes of the cones, in pcs. Cones that no position sees are
        left out.
    poses : T_pcs_ccs with covariance of the positions.
    T_ccs_scs : relative orientation.
    pattern : beams of the scanner.
    limits : which beams take part.
    free_half_angle : six unknowns a cone; false: five.

    Returns
    -------
    table : ``cones``, ``positions`` (numbers), ``quantity``, ``unit``, ``sigma`` in that unit, infinite where
        the choice leaves the orientation undetermined, and ``choice``, the names of the cones.
    """
    lengths = [r.length_m for r in references]
    scans = [
        planned_scan(cones, lengths, pose @ T_ccs_scs, pattern, limits or SelectionLimits()) for pose in poses
    ]
    seen = [k for k in range(len(cones)) if any((s.cone == k).any() for s in scans)]
    lines = []
    for n_cones in range(1, len(seen) + 1):
        for n_positions in range(1, len(poses) + 1):
            for chosen in _spread(list(combinations(seen, n_cones))):
                for at in _spread(list(combinations(range(len(poses)), n_positions))):
                    sigma = _sigmas(
                        [references[k] for k in chosen],
                        [cones[k] for k in chosen],
                        [poses[p] for p in at],
                        [_only(scans[p], chosen) for p in at],
                        T_ccs_scs,
                        free_half_angle,
                    )
                    label = " ".join(references[k].name for k in chosen)
                    number = {"cones": n_cones, "positions": n_positions, "choice": label}
                    lines += [
                        {**number, "quantity": name, "unit": unit, "sigma": s}
                        for (name, unit), s in zip(QUANTITIES, sigma.tolist(), strict=True)
                    ]
    return pd.DataFrame(lines)


def _any_range(limits: SelectionLimits) -> SelectionLimits:
    return SelectionLimits(
        max_incidence_deg=limits.max_incidence_deg, margin_sigmas=limits.margin_sigmas, slack_m=1e3
    )


def _spread(choices: list[tuple[int, ...]]) -> list[tuple[int, ...]]:
    if len(choices) <= _SUBSETS:
        return choices
    return [choices[i] for i in np.linspace(0, len(choices) - 1, _SUBSETS).round().astype(int)]


def _only(scan: ConeScan, chosen: Sequence[int]) -> ConeScan:
    number = np.full(max(int(scan.cone.max(initial=0)), *chosen) + 1, -1)
    number[list(chosen)] = np.arange(len(chosen))
    cone = number[scan.cone] if len(scan.cone) else scan.cone
    on = cone >= 0
    return ConeScan(
        points_scs_m=scan.points_scs_m[on],
        cone=cone[on],
        excess_m=scan.excess_m[on],
        variance_m2=scan.variance_m2[on],
    )


def _sigmas(
    references: Sequence[ConeReference],
    cones: Sequence[Cone],
    poses: Sequence[Rigid],
    scans: Sequence[ConeScan],
    T_ccs_scs: Rigid,
    free_half_angle: bool,
) -> ArrayF:
    """Standard deviations (6,) in metres and degrees; infinite where nothing determines them."""
    layout = Layout(
        cones=tuple(r.name for r in references),
        positions=tuple(str(i) for i in range(len(poses))),
        free_half_angle=free_half_angle,
        free_pose=tuple(bool(np.any(p.cov)) for p in poses),
    )
    x = Unknowns(cones=tuple(cones), T_ccs_scs=T_ccs_scs, poses=tuple(poses))
    used = [(r, np.ones(len(r.points_m), dtype=np.bool_)) for r in references]
    N = np.zeros((layout.n, layout.n))
    for group in groups_of(layout, used, poses, scans):
        part = group.model(x)
        J = np.asarray(part.jacobian)
        if part.cov.ndim == 1:
            N += J.T @ (J / part.cov[:, None])
        else:
            k = part.cov.shape[1]
            blocks = J.reshape(-1, k, layout.n)
            N += np.einsum("bki,bkj->ij", blocks, np.linalg.solve(part.cov, blocks))
    scale = np.sqrt(np.maximum(np.diag(N), 1e-300))
    values, vectors = np.linalg.eigh(N / np.outer(scale, scale))
    at = layout.orientation
    if values[0] < RANK_TOLERANCE:
        return np.full(6, np.inf)
    variance = np.square(vectors[at] / scale[at, None]) @ (1 / values)
    return np.sqrt(variance) * np.array([1.0, 1.0, 1.0, *np.rad2deg([1.0, 1.0, 1.0])])
