"""Relative orientation of camera and lidar from cones: one adjustment of everything that sees them (P2 3.1).

1. Each cone of the field from its reference points (`cone_fit`).
2. The orientation of the lidar, roughly, from all cones at once (`cone_search`).
3. Points of each cone by their nominal beams (`cone_selection`), then one adjustment (`camera_lidar_model`);
   both again until the orientation stays.
4. Each cone against all others (`cone_check`): what stands elsewhere than the reference says is left out and
   named, the worst first, and all is adjusted again.

The scatter of the lidar is estimated along (`variance_factor`): it decides what lidar, marks and camera weigh
against each other, and the small mean distance of points from curved surfaces goes with it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Self

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, norm

from thalweg.calibration import (
    AGAIN,
    WORDS,
    Cone,
    ConeFit,
    ConeReference,
    ConeScan,
    Found,
    Position,
    SearchRange,
    Selection,
    SelectionLimits,
    Verdict,
    beside_its_place,
    fit_of,
    fit_reference,
    nowhere,
    search,
    select,
    without_support,
)
from thalweg.calibration.camera_lidar.model import (
    FIELD,
    LIDAR,
    FieldErrors,
    Layout,
    LidarRows,
    Unknowns,
    groups_of,
    lidar_rows,
)
from thalweg.core import Adjusted, ArrayF, GeometryError, Rigid, UnobservableError, adjust, root_mean_square
from thalweg.settings.sections import CameraLidarFit

_COARSE_M: Final = 0.05
_ROUNDS: Final = 8
_ENOUGH_POINTS: Final = 8
_IN_THE_WAY: Final = 0.1
_STAYS: Final = 0.05
"""Part of a sigma by which the orientation may still change from one selection of points to the next."""
_MIDDLE_M: Final = 0.35
"""Place along the axis whose shift is reported, about the middle of a cone; it changes no test."""
_FREE: Final = 1e-9
"""Smallest eigenvalue of a normal matrix over its largest, if scaled to a unit diagonal."""

FOUND: Final = "found"
_CORNERS: Final = 3
"""Saddles of a marker, of four, by which it is judged as a whole."""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraLidarSettings:
    """How to calibrate.

    Parameters
    ----------
    free_half_angle : six unknowns a cone; false: five, the half angle is that of the field description.
    limits : which beams take part.
    within : how far the nominal orientation may be off; None: it is good enough to start from.
    least_points : points of a cone at a position, below which it takes no part there.
    least_support : share of the beams through a cone's place that must end on it rather than behind it.
    least_score : balance of the beams of the first search, see `thalweg.calibration.cone_search`.
    contradiction_sigmas : displacement of a cone against the others, in sigmas, that puts it out.
    contradiction_m : displacement that is accepted all the same: form of the cones, and what the model of the
        lidar leaves.
    free_noise : the lidar's variances are scaled to the residuals.
    """

    free_half_angle: bool = CameraLidarFit().free_half_angle
    limits: SelectionLimits = field(default_factory=SelectionLimits)
    within: SearchRange | None = field(default_factory=SearchRange)
    least_points: int = 25
    least_support: float = 0.6
    least_score: float = 0.25
    contradiction_sigmas: float = 4.0
    contradiction_m: float = 0.001
    free_noise: bool = True

    @classmethod
    def from_section(cls, section: CameraLidarFit) -> Self:
        """From section ``calibration.camera_lidar`` of a campaign file."""
        return cls(
            free_half_angle=section.free_half_angle,
            limits=SelectionLimits(max_incidence_deg=section.max_incidence_deg),
            within=SearchRange(shift_m=section.search_shift_m, angle_deg=section.search_angle_deg),
        )


# ---------------------------------------------------------------- adjustment


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
        `thalweg.calibration.camera_lidar.adjustment`.
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
        """RMS of standardised residuals: of the lidar, and of reference points with exterior orientations."""
        found = {kind: _variance(self.adjusted, kind) for kind in (LIDAR, FIELD)}
        return {kind: float(np.sqrt(variance)) for kind, (variance, spare) in found.items() if spare > 1e-6}


def _variance(adjusted: Adjusted[Unknowns], kind: str) -> tuple[float, float]:
    """Mean square of the standardised residuals of all groups of a kind, and their redundancy."""
    mine = [n for n in adjusted.group_sigma0 if n.split(" ")[0] == kind]
    spare = sum(adjusted.group_redundancy[n] for n in mine)
    squares = sum(adjusted.group_sigma0[n] ** 2 * adjusted.group_redundancy[n] for n in mine)
    return squares / max(spare, 1e-9), spare


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
    found, start = None, nominal
    if settings.within is not None:
        found = search(cones, lengths, positions, nominal, settings.within)
        start = found.T_ccs_scs
        if found.score < settings.least_score:
            scores = {p.name: fit_of(start, cones, lengths, p.T_pcs_ccs, p) for p in positions}
            odd = [f"{name}: {score:.2f}" for name, score in scores.items() if score < settings.least_score]
            raise GeometryError(
                f"no orientation near the nominal one brings scans and cones together: in the best one the "
                f"balance of {found.beams} beams is {found.score:.2f} ({', '.join(odd)})",
                expected=f"at least {settings.least_score:g}, where 1 is every beam on its cone",
                cure="Check that scans and reference show the same field, that each scan has the name of its "
                "own picture, the exterior orientations, and the nominal mounts: they may be off by some "
                "decimetres and 6 degrees",
            )
    layout = Layout(
        cones=tuple(r.name for r in usable),
        positions=tuple(p.name for p in positions),
        free_half_angle=settings.free_half_angle,
        free_pose=tuple(errors is not None or bool(np.any(p.T_pcs_ccs.cov)) for p in positions),
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
        told = [
            without_support(
                selection.counts(k), least_points=how.least_points, least_support=how.least_support
            )
            for k in range(len(work.references))
        ]
        out = {k: why for k, why in enumerate(told) if why}
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
        )
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
    change, _ = _variance(adjusted, LIDAR)
    work.factor *= change
    return change


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


# ---------------------------------------------------------------- each cone against all others: does the
# lidar see it where the reference says?
#
# After an adjustment one cone at a time is given a place of its own for the lidar: a shift of its middle and
# a tilt of its axis that the reference does not know. With the standardised derivatives ``G`` of the lidar's
# distances by these five, residuals ``v`` and the adjustment's ``A`` and ``Q``, all in units of the sigmas::
#
#     S = G^T G - (G^T A) Q (A^T G),    displacement = -S^-1 G^T v,    covariance S^-1
#
# (Baarda 1968, data snooping with several outliers in one group). A cone that fell over or was pushed since
# the pictures of the field were taken stands out, and the others tell it.


def displacements(
    adjusted: Adjusted[Unknowns], layout: Layout, scans: Sequence[ConeScan], tolerance_m: float
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
                    Displacement(
                        cone=name,
                        position=label,
                        points=n,
                        shift_m=d[:3],
                        tilt_rad=d[3:],
                        cov=cov,
                        sigmas=sigmas,
                    )
                )
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
    UnobservableError : names the rotations that are free, and what to add.
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
        [layout.names[layout.orientation][i] for i in order],
        defects=int(free.sum()),
        cure=f"The lidar sees {', '.join(used)} only. Add a cone at another place in its view, with another "
        "axis, or a position from which it sees more: nothing shows a turn about the axis of a single cone",
    )


# ---------------------------------------------------------------- tables: what was used, what was not, what
# is left over


def detection_table(
    layout: Layout,
    selections: Sequence[Selection],
    out: Mapping[tuple[int, int], str],
    refused: Mapping[str, str],
) -> pd.DataFrame:
    """One line a position and cone: ``predicted`` beams, how many had which verdict, ``found``, ``reason``.

    ``predicted`` counts returned beams whose nominal direction meets the cone; the numbers behind it add up
    to it: ``used``, ``grazing``, too near to the ``outline`` or an ``end``, reflected ``in_front`` or
    ``behind``, or passing ``beside`` what is in front. Points of a cone that takes no part count as
    ``left_out`` instead of ``used``.
    """
    lines: list[dict[str, Any]] = []
    for p, (name, selection) in enumerate(zip(layout.positions, selections, strict=True)):
        for k, cone in enumerate(layout.cones):
            n = selection.counts(k)
            reason = out.get((p, k), "")
            if not reason and n[Verdict.USED] == 0:
                reason = (
                    f"none of {sum(n.values())} beams that should meet it ended on it: it fell over or was "
                    "moved, or it is hidden. Measure the field again, or leave the cone out"
                )
            line: dict[str, Any] = {"position": name, "cone": cone, "predicted": sum(n.values())}
            line |= {WORDS[v]: n[v] for v in WORDS}
            line["left_out"] = n[Verdict.USED] if reason else 0
            line["used"] = 0 if reason else n[Verdict.USED]
            lines.append({**line, FOUND: not reason, "reason": reason})
        none = {"predicted": 0, **dict.fromkeys(WORDS.values(), 0), "left_out": 0, FOUND: False}
        lines += [
            {"position": name, "cone": cone, **none, "reason": f"no reference: {why}"}
            for cone, why in refused.items()
        ]
    return pd.DataFrame(lines)


def residual_table(layout: Layout, scans: Sequence[ConeScan], rows: Sequence[LidarRows]) -> pd.DataFrame:
    """One line a position and cone: number of points, and mean, RMS and greatest distance in millimetres.

    ``standardised`` is the RMS of the distances over their sigmas. Distances are those left by the
    adjustment, less their expectation for noisy beams.
    """
    lines = []
    for name, scan, row in zip(layout.positions, scans, rows, strict=True):
        # Along the outward normal: positive outside.
        distance = row.residual * row.slope
        variance = scan.variance_m2 * row.slope**2
        for k, cone in enumerate(layout.cones):
            on = scan.cone == k
            if on.any():
                d = distance[on]
                lines.append(
                    {
                        "position": name,
                        "cone": cone,
                        "points": int(on.sum()),
                        "mean_mm": 1e3 * float(d.mean()),
                        "sigma_mean_mm": 1e3 * float(np.sqrt(variance[on].mean() / on.sum())),
                        "rms_mm": 1e3 * root_mean_square(d),
                        "greatest_mm": 1e3 * float(np.abs(d).max()),
                        "standardised": float(np.sqrt(np.mean(d**2 / variance[on]))),
                    }
                )
    return pd.DataFrame(lines)


def point_table(
    layout: Layout,
    positions: Sequence[Position],
    x: Unknowns,
    selections: Sequence[Selection],
    out: Mapping[tuple[int, int], str],
) -> pd.DataFrame:
    """One line a beam that should meet a cone: place of its point in pcs, distance from the cone, verdict.

    ``residual_m`` is positive outside, and less its expectation where the point is used.
    """
    words = np.array([WORDS.get(v, "") for v in Verdict], dtype=object)
    names, parts = [], []
    for p, (position, selection) in enumerate(zip(positions, selections, strict=True)):
        T = x.poses[p] @ x.T_ccs_scs
        for k, name in enumerate(layout.cones):
            rows = np.flatnonzero(selection.cone == k)
            at = T.apply(position.points_scs_m[rows])
            reach = np.linalg.norm(position.points_scs_m[rows], axis=1)
            met = x.cones[k].meet(T.shift_m, (at - T.shift_m) / reach[:, None])
            residual = -(reach - met.range_m - np.nan_to_num(selection.excess_m[rows])) * met.cosine
            verdict = selection.verdict[rows]
            names += [(name, position.name)] * len(rows)
            parts.append((at, residual, (verdict == Verdict.USED) & ((p, k) not in out), words[verdict]))
    place, residual, used, verdict = (np.concatenate(column) for column in zip(*parts, strict=True))
    return pd.DataFrame(
        {
            "cone": [cone for cone, _ in names],
            "position": [position for _, position in names],
            **{f"{a}_m": place[:, i] for i, a in enumerate("xyz")},
            "residual_m": residual,
            "used": used,
            "verdict": verdict,
        }
    )


def sensor_table(positions: Sequence[str], poses: Sequence[Rigid], T_ccs_scs: Rigid) -> pd.DataFrame:
    """Where camera and lidar were in pcs at each position: origin, and rotation from the sensor's frame."""
    lines = []
    for name, pose in zip(positions, poses, strict=True):
        for sensor, T in (("camera", pose), ("lidar", pose @ T_ccs_scs)):
            q = Rotation.from_matrix(T.R).as_quat(canonical=True)
            place = dict(zip(("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"), [*T.shift_m, *q], strict=True))
            lines.append({"position": name, "sensor": sensor, **place})
    return pd.DataFrame(lines)


def reference_table(
    references: Sequence[ConeReference], fits: Mapping[str, ConeFit], refused: Mapping[str, str]
) -> pd.DataFrame:
    """One line a reference point: distance from its cone in millimetres, whether it was used, why not."""
    lines = []
    for r in references:
        fit = fits.get(r.name)
        for i, label in enumerate(r.labels):
            used = fit is not None and bool(fit.used[i])
            reason = "" if used else refused.get(r.name, "not on the cone: moved, or read wrongly")
            distance = np.nan if fit is None else 1e3 * float(fit.distance_m[i])
            lines.append((r.name, label, distance, used, reason))
    return pd.DataFrame(lines, columns=["cone", "point", "distance_mm", "used", "reason"])


def foreign_markers(references: pd.DataFrame) -> list[str]:
    """What to tell about markers that are not on the cone that the description of the field names.

    Parameters
    ----------
    references : of `reference_table`.
    """
    marker = references["point"].str.split("/").str[0]
    lines: list[str] = []
    for key, part in references.assign(marker=marker).groupby(["cone", "marker"], sort=False):
        cone, name = (str(k) for k in key)
        if int((~part["used"]).sum()) >= _CORNERS and part["distance_mm"].notna().all():
            off = float(part["distance_mm"].abs().median())
            lines.append(
                f"marker {name} of cone {cone} is {off:.1f} mm off its surface, and takes no part: it is "
                "on another cone than the description of the field says, not glued on it, or was moved "
                "between the pictures. Correct the description, photograph the field again, or leave it out"
            )
    return lines


def cone_table(cones: Mapping[str, Cone]) -> pd.DataFrame:
    """One line a cone: apex in pcs, P2's angles, half angle, and sigmas, those of the axis across itself."""
    lines = []
    for name, cone in cones.items():
        s = np.sqrt(np.maximum(np.diag(cone.cov), 0.0))
        lam, theta = np.rad2deg(cone.angles_rad)
        lines.append(
            {
                "cone": name,
                **{f"apex_{a}_m": float(v) for a, v in zip("xyz", cone.apex_m, strict=True)},
                "lambda_deg": lam,
                "theta_deg": theta,
                "half_angle_deg": float(np.rad2deg(cone.half_angle_rad)),
                **{f"sigma_apex_{a}_mm": 1e3 * float(v) for a, v in zip("xyz", s[:3], strict=True)},
                "sigma_axis_1_deg": float(np.rad2deg(s[3])),
                "sigma_axis_2_deg": float(np.rad2deg(s[4])),
                "sigma_half_angle_deg": float(np.rad2deg(s[5])),
            }
        )
    return pd.DataFrame(lines)


def correlation_table(names: Sequence[str], correlation: ArrayF) -> pd.DataFrame:
    """Correlations of the unknowns as a square table with their names."""
    return pd.DataFrame(correlation, index=list(names), columns=list(names))


def report(result: "CameraLidar", nominal: Rigid) -> dict[str, Any]:
    """What a person reads first, as plain values: orientation, sigmas, correlations, groups, verdict."""
    T = result.T_ccs_scs
    s = np.sqrt(np.diag(T.cov))
    back = T.error_from(nominal)
    test = result.adjusted.global_test()
    return {
        "lever_ccs_scs_m": T.shift_m.tolist(),
        "lever_length_m": float(np.linalg.norm(T.shift_m)),
        "sigma_lever_mm": (1e3 * T.sigma_shift_m).tolist(),
        "sigma_rotation_deg": np.rad2deg(T.sigma_rotation_rad).tolist(),
        "R_ccs_scs": T.R.tolist(),
        "correlation": (T.cov / np.outer(s, s)).tolist(),
        "from_nominal": {
            "shift_mm": (1e3 * back[:3]).tolist(),
            "rotation_deg": np.rad2deg(back[3:]).tolist(),
        },
        "unknowns": len(result.adjusted.names),
        "iterations": result.adjusted.n_iterations,
        "sigma0": test.sigma0,
        "sigma0_band": [test.low, test.high],
        "group_sigma0": result.group_sigma0,
        "lidar_sigma_factor": float(np.sqrt(result.variance_factor)),
        "points": int(result.residuals["points"].sum()),
        "positions": int(result.residuals["position"].nunique()),
        "cones": len(result.cones),
    }
