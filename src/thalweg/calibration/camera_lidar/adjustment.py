"""Relative orientation of camera and lidar from cones: one adjustment of everything that sees them (P2 3.1).

1. Each cone of the field from its reference points (`cone_fit`).
2. The orientation of the lidar, roughly, from all cones at once (`cone_search`); scans that belong to other
   pictures are named (`camera_lidar_pairs`).
3. Points of each cone by their nominal beams (`cone_selection`), then one adjustment (`camera_lidar_model`);
   both again until the orientation stays.
4. Each cone against all others (`cone_check`): what stands elsewhere than the reference says is left out and
   named, the worst first, and all is adjusted again.

The scatter of the lidar is estimated along (`variance_factor`): it decides what lidar, marks and camera weigh
against each other, and the small mean distance of points from curved surfaces goes with it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
import pandas as pd

from thalweg.calibration.camera_lidar.cone_check import (
    Displacement,
    displacements,
    refuse_undetermined,
    worst,
)
from thalweg.calibration.camera_lidar.model import (
    FIELD,
    LIDAR,
    POSE,
    REFERENCE,
    FieldErrors,
    Layout,
    Unknowns,
    groups_of,
    lidar_rows,
)
from thalweg.calibration.camera_lidar.pairs import refuse_swapped
from thalweg.calibration.camera_lidar.settings import CameraLidarSettings
from thalweg.calibration.camera_lidar.tables import (
    detection_table,
    point_table,
    reference_table,
    residual_table,
)
from thalweg.calibration.cones.cone import Cone
from thalweg.calibration.cones.fit import ConeFit, ConeReference, fit_reference
from thalweg.calibration.cones.search import Found, search
from thalweg.calibration.cones.selection import (
    ConeScan,
    Position,
    Selection,
    Verdict,
    select,
)
from thalweg.calibration.cones.views import AGAIN, beside_its_place, nowhere, out_of_view, without_support
from thalweg.core.adjustment.solve import Adjusted, UnobservableError, adjust
from thalweg.core.errors import GeometryError
from thalweg.core.rigid import Rigid

_COARSE_M: Final = 0.05
_ROUNDS: Final = 8
_ENOUGH_POINTS: Final = 8
_IN_THE_WAY: Final = 0.1
_STAYS: Final = 0.05
"""Part of a sigma by which the orientation may still change from one selection of points to the next."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraLidar:
    """Result of `calibrate_camera_lidar`.

    Parameters
    ----------
    T_ccs_scs : relative orientation with its covariance.
    cones : by name, in pcs with covariance; those that the lidar has seen.
    adjusted : the adjustment, with the covariance of all unknowns.
    variance_factor : of the lidar's stated variances.
    detection, residuals, references, displacements, points : tables, see
        `thalweg.calibration.camera_lidar.tables`.
    found : result of the search; None if there was none.
    """

    T_ccs_scs: Rigid
    cones: Mapping[str, Cone]
    adjusted: Adjusted[Unknowns]
    variance_factor: float
    detection: pd.DataFrame
    residuals: pd.DataFrame
    references: pd.DataFrame
    displacements: pd.DataFrame
    points: pd.DataFrame
    found: Found | None

    @property
    def group_sigma0(self) -> dict[str, float]:
        """RMS of the standardised residuals of lidar, reference points and exterior orientations."""
        out = {}
        for kind in (LIDAR, FIELD, REFERENCE, POSE):
            mine = [n for n in self.adjusted.group_sigma0 if n.split(" ")[0] == kind]
            spare = sum(self.adjusted.group_redundancy[n] for n in mine)
            squares = sum(
                self.adjusted.group_sigma0[n] ** 2 * self.adjusted.group_redundancy[n] for n in mine
            )
            if spare > 1e-6:
                out[kind] = float(np.sqrt(squares / spare))
        return out


@dataclass(slots=True)
class _Work:
    """What the steps share."""

    references: list[ConeReference]
    fits: list[ConeFit]
    positions: list[Position]
    settings: CameraLidarSettings
    layout: Layout
    x: Unknowns
    factor: float
    errors: FieldErrors | None
    out: dict[tuple[int, int], str]
    """Position and cone that take no part, and why."""


def calibrate_camera_lidar(
    references: Sequence[ConeReference],
    positions: Sequence[Position],
    nominal: Rigid,
    settings: CameraLidarSettings | None = None,
    *,
    errors: FieldErrors | None = None,
) -> CameraLidar:
    """Relative orientation of camera and lidar.

    Parameters
    ----------
    references : cones of the field with their reference points.
    positions : static positions. For P1's variant, the exterior orientation of the lidar itself, give one
        with the identity as orientation of the camera.
    nominal : T_ccs_scs as the mounts say.
    settings : see there.
    errors : what exterior orientations and reference points share; None: their own covariances.

    Raises
    ------
    UnobservableError : the cones that were found leave the orientation undetermined; says which turn or shift
        is free and what to add.
    GeometryError : no position, no cone was found, or a step failed.
    """
    settings = settings or CameraLidarSettings()
    names = [p.name for p in positions]
    if not names or len(set(names)) < len(names):
        raise GeometryError(f"static positions {names}", expected="at least one, with different names")
    fits, refused = _reference_cones(references, settings)
    usable = [r for r in references if r.name in fits]
    cones = [fits[r.name].cone for r in usable]
    lengths = [r.length_m for r in usable]
    if errors is not None:
        errors.check(references, len(positions))
    found, start = None, nominal
    if settings.within is not None:
        found = search(cones, lengths, positions, nominal, settings.within)
        start = found.T_ccs_scs
        odd = refuse_swapped(cones, lengths, positions, nominal, settings.within, found, settings.least_score)
        if found.score < settings.least_score:
            raise GeometryError(
                f"no orientation near the nominal one brings scans and cones together: in the best one the "
                f"balance of {found.beams} beams is {found.score:.2f} ({', '.join(odd)})",
                expected=f"at least {settings.least_score:g}, where 1 is every beam on its cone",
                cure="Check that scans and reference show the same field, the exterior orientations, and the "
                "nominal mounts: they may be off by some decimetres and 6 degrees",
            )
    layout = Layout(
        cones=tuple(r.name for r in usable),
        positions=tuple(p.name for p in positions),
        free_half_angle=settings.free_half_angle,
        free_pose=tuple(errors is not None or bool(np.any(p.T_pcs_ccs.cov)) for p in positions),
        free_range_offset=settings.free_range_offset,
    )
    x = Unknowns(cones=tuple(cones), T_ccs_scs=start, poses=tuple(p.T_pcs_ccs for p in positions))
    work = _Work(
        usable, [fits[r.name] for r in usable], list(positions), settings, layout, x, 1.0, errors, {}
    )
    _without_support(work)
    while True:
        try:
            adjusted, selections, layout = _until_it_stays(work)
        except UnobservableError:
            raise
        except GeometryError:
            # A cone that stands elsewhere may leave the adjustment without a solution.
            if not _beside(work):
                raise
            continue
        moved = displacements(adjusted, layout, _scans(work, selections, layout), settings.contradiction_m)
        bad = worst(moved, settings.contradiction_sigmas)
        if bad is None:
            break
        _leave_out(work, bad, selections)
    return _result(work, adjusted, selections, layout, moved, found, references, refused)


def _reference_cones(
    references: Sequence[ConeReference], settings: CameraLidarSettings
) -> tuple[dict[str, ConeFit], dict[str, str]]:
    fits, refused = {}, {}
    for r in references:
        try:
            fits[r.name] = fit_reference(r, free_half_angle=settings.free_half_angle)
        except GeometryError as error:
            refused[r.name] = str(error)
    marked = [r.name for r in references if r.name in fits or len(r.points_m) >= _ENOUGH_POINTS]
    lost = [name for name in marked if name in refused]
    # Cones that were described wrongly are no mishap of some; the rest would tell of something else.
    if not fits or 2 * len(lost) > len(marked):
        told = [refused[name] for name in lost] or list(refused.values())
        raise GeometryError(
            f"{len(refused)} of {len(references)} cones cannot be used: {' '.join(told)}",
            expected="at least two cones with reference points, and most of them as described",
        )
    return fits, refused


def _select(work: _Work, slack_m: float) -> list[Selection]:
    limits = replace(work.settings.limits, slack_m=slack_m)
    lengths = [r.length_m for r in work.references]
    return [
        select(work.x.cones, lengths, pose @ work.x.T_ccs_scs, position, limits, variance_factor=work.factor)
        for pose, position in zip(work.x.poses, work.positions, strict=True)
    ]


def _without_support(work: _Work) -> None:
    """Note the cones that are not where the reference says, or not seen, before anything is adjusted."""
    how = work.settings
    for p, selection in enumerate(_select(work, _COARSE_M)):
        T, out = work.x.poses[p] @ work.x.T_ccs_scs, {}
        for k, reference in enumerate(work.references):
            why = without_support(
                selection.counts(k),
                least_points=how.least_points,
                least_support=how.least_support,
                view=partial(out_of_view, work.x.cones[k], reference.length_m, T, work.positions[p]),
            )
            if why:
                out[k] = why
        if nowhere(selection, len(work.references), out):
            apart = "no cone is where scan and picture of this position together say: they do not belong "
            apart += "together, or the boat moved between them. Record the position again. Of this cone: "
            out = {k: apart + why for k, why in out.items()}
        work.out |= {(p, k): why for k, why in out.items()}


def _scans(work: _Work, selections: Sequence[Selection], layout: Layout) -> list[ConeScan]:
    """Used points of each position, numbered by the cones of the layout."""
    number = {name: k for k, name in enumerate(layout.cones)}
    scans = []
    for p, (selection, position) in enumerate(zip(selections, work.positions, strict=True)):
        rows, cone = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
        for k, r in enumerate(work.references):
            if (p, k) not in work.out and r.name in number:
                rows.append(selection.rows(k))
                cone.append(np.full(len(rows[-1]), number[r.name]))
        taken = np.concatenate(rows)
        scans.append(
            ConeScan(
                points_scs_m=position.points_scs_m[taken],
                cone=np.concatenate(cone),
                excess_m=selection.excess_m[taken],
                variance_m2=selection.variance_m2[taken],
            )
        )
    return scans


def _until_it_stays(work: _Work) -> tuple[Adjusted[Unknowns], list[Selection], Layout]:
    """Select and adjust in turn until the orientation stays."""
    slack = _COARSE_M
    for _ in range(_ROUNDS):
        selections = _select(work, slack)
        seen = [
            k
            for k in range(len(work.references))
            if any((p, k) not in work.out for p in range(len(work.positions)))
        ]
        if not seen:
            raise GeometryError(
                "no cone was found in the scans: "
                + "; ".join(
                    f"{work.layout.positions[p]}, {work.layout.cones[k]}: {why}"
                    for (p, k), why in work.out.items()
                ),
                expected="at least two cones in the view of the lidar where the reference says",
                cure="Check the nominal mounts and that reference and scans are of the same field",
            )
        layout = replace(work.layout, cones=tuple(work.layout.cones[k] for k in seen))
        scans = _scans(work, selections, layout)
        before = replace(work.x, cones=tuple(work.x.cones[k] for k in seen))
        refuse_undetermined(layout, before, scans)
        adjusted = adjust(
            groups_of(
                layout,
                [(work.references[k], work.fits[k].used) for k in seen],
                [p.T_pcs_ccs for p in work.positions],
                scans,
                work.errors,
            ),
            before,
            layout.names,
            update=layout.update,
        )  # fmt: skip
        cones = list(work.x.cones)
        for k, cone in zip(seen, adjusted.x.cones, strict=True):
            cones[k] = cone
        step = adjusted.x.T_ccs_scs.error_from(work.x.T_ccs_scs)
        work.x = replace(adjusted.x, cones=tuple(cones))
        sigma = adjusted.sigmas[layout.orientation]
        stays = bool(np.all(np.abs(step) < _STAYS * sigma)) and slack == 0.0
        change = _noise(work, adjusted) if slack == 0.0 else 1.0
        slack = 0.0
        if stays and abs(change - 1) < 0.02:
            break
    return adjusted, selections, layout


def _noise(work: _Work, adjusted: Adjusted[Unknowns]) -> float:
    """Put the lidar's scatter into the variance factor; by how much it changed."""
    if not work.settings.free_noise:
        return 1.0
    mine = [n for n in adjusted.group_sigma0 if n.startswith(LIDAR)]
    spare = sum(adjusted.group_redundancy[n] for n in mine)
    change = sum(adjusted.group_sigma0[n] ** 2 * adjusted.group_redundancy[n] for n in mine) / max(
        spare, 1e-9
    )
    work.factor *= change
    return float(change)


def _beside(work: _Work) -> bool:
    """Leave out, at each position, the cone that is farthest off its place; whether there was one."""
    changed = False
    for p, selection in enumerate(_select(work, _COARSE_M)):
        T = work.x.poses[p] @ work.x.T_ccs_scs
        far = beside_its_place(work.x.cones, T, work.positions[p], selection)
        new = [k for k in far if (p, k) not in work.out][:1]
        work.out |= {(p, k): far[k] for k in new}
        changed |= bool(new)
    return changed


def _leave_out(work: _Work, bad: Displacement, selections: Sequence[Selection]) -> None:
    k = work.layout.cones.index(bad.cone)
    off = (
        f"{1e3 * float(np.linalg.norm(bad.shift_m)):.1f} mm and "
        f"{np.rad2deg(float(np.linalg.norm(bad.tilt_rad))):.2f} deg off ({bad.sigmas:.0f} sigmas)"
    )
    for p, name in enumerate(work.layout.positions):
        if bad.position in ("", name) and (p, k) not in work.out:
            n = selections[p].counts(k)
            before, aimed = n[Verdict.IN_FRONT], n[Verdict.IN_FRONT] + n[Verdict.USED] + n[Verdict.BEHIND]
            work.out[p, k] = (
                f"partly hidden: {before} of {aimed} beams were reflected before it, the rest is {off}. "
                f"Clear the view, then {AGAIN}"
                if before > _IN_THE_WAY * aimed
                else f"not where the reference says: {off}; it was moved. Set it up, then {AGAIN}"
            )


def _result(
    work: _Work,
    adjusted: Adjusted[Unknowns],
    selections: Sequence[Selection],
    layout: Layout,
    moved: Sequence[Displacement],
    found: Found | None,
    references: Sequence[ConeReference],
    refused: Mapping[str, str],
) -> CameraLidar:
    cones = {}
    for k, name in enumerate(layout.cones):
        cov = np.zeros((6, 6))
        n = layout.per_cone
        cov[:n, :n] = adjusted.cov[layout.cone(k), layout.cone(k)]
        cones[name] = replace(adjusted.x.cones[k], cov=cov)
    at = layout.orientation
    scans = _scans(work, selections, layout)
    rows = [lidar_rows(layout, adjusted.x, p, scan) for p, scan in enumerate(scans)]
    return CameraLidar(
        T_ccs_scs=adjusted.x.T_ccs_scs.with_cov(adjusted.cov[at, at]),
        cones=cones,
        adjusted=adjusted,
        variance_factor=work.factor,
        detection=detection_table(work.layout, selections, work.out, refused),
        residuals=residual_table(layout, scans, rows),
        references=reference_table(references, dict(zip(work.layout.cones, work.fits, strict=True)), refused),
        displacements=pd.DataFrame([d.row() for d in moved]),
        points=point_table(work.layout, work.positions, work.x, selections, work.out),
        found=found,
    )
