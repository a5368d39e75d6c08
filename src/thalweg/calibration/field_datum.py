"""The place of a calibration field in the world, from targets whose centres were measured by RTK.

``x_wcs = R_wcs_pcs x_pcs + shift``; the scale is that of the scale bars. Both the RTK sigmas and the
covariance of the field's points count.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import chi2

from thalweg.calibration.field_description import Target
from thalweg.calibration.field_points import FieldPoints
from thalweg.core.adjustment import Adjusted, Linear, Observations, UnobservableError, adjust
from thalweg.core.errors import GeometryError
from thalweg.core.frames import LocalFrame
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayB, ArrayF

_LEVEL: Final = 1e-3
"""Probability with which good targets are called contradictory."""
_NAMES: Final = ("east", "north", "up", "rotation about east", "rotation about north", "rotation about up")
_WIDE: Final = 0.05
"""Width over length of the targets' layout below which they count as standing in one line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldDatum:
    """``T_wcs_pcs`` with covariance, ``table`` of the targets, and what was rejected as (name, reason)."""

    T_wcs_pcs: Rigid
    table: pd.DataFrame
    rejected: tuple[tuple[str, str], ...]
    sigma0: float
    redundancy: float


def targets_wcs(targets: Sequence[Target], frame: LocalFrame) -> ArrayF:
    """(n, 3) east, north, up of the targets."""
    return np.array([frame.from_geodetic(t.lat_deg, t.lon_deg, t.h_ell_m) for t in targets]).reshape(-1, 3)


def field_datum(points: FieldPoints, targets: Sequence[Target], frame: LocalFrame) -> FieldDatum:
    """Adjust the place of the field.

    Parameters
    ----------
    points : of the field.
    targets : RTK positions; those whose marker was not measured are left out and named.
    frame : of wcs.

    Raises
    ------
    GeometryError : fewer than three usable targets, targets in one line, or targets that contradict each
    other
        so that no single one explains it.
    """
    have = {m for m, _ in points.points}
    rejected: list[tuple[str, str]] = []
    usable: list[Target] = []
    for target in targets:
        saddles = sum(m == target.marker for m, _ in points.points)
        if target.marker not in have or saddles < 4:
            reason = f"marker {target.marker}: {saddles} of four saddles were measured in the pictures"
            rejected.append((target.name, reason))
        else:
            usable.append(target)
    if len(usable) < 3:
        told = "".join(f"; {name}: {reason}" for name, reason in rejected)
        raise GeometryError(
            f"{len(usable)} usable RTK targets{told}",
            expected="at least three, better four, around the field",
            cure="Measure more targets by RTK, and take pictures that show their markers",
        )
    centres = [points.centre(target.marker) for target in usable]
    pcs, cov = np.array([c for c, _ in centres]), np.array([C for _, C in centres])
    wcs = targets_wcs(usable, frame)
    rtk = np.array([np.diag(np.square(t.sigma_m)) for t in usable])
    _require_width(pcs, [t.name for t in usable])
    used = np.ones(len(usable), dtype=np.bool_)
    adjusted = _adjust(pcs, cov, wcs, rtk, used)
    if _probability(adjusted) < _LEVEL:
        wrong = _wrong(pcs, cov, wcs, rtk, [t.name for t in usable])
        used[wrong] = False
        adjusted = _adjust(pcs, cov, wcs, rtk, used)
        off = adjusted.x.apply(pcs[wrong : wrong + 1])[0] - wcs[wrong]
        east, north, up = -off * 1000.0
        reason = f"its RTK position is {east:+.0f} mm east, {north:+.0f} mm north, {up:+.0f} mm up"
        rejected.append((usable[wrong].name, f"{reason} of what the others say: measure it again"))
    off = wcs - adjusted.x.apply(pcs)
    table = pd.DataFrame(
        {
            "target": [t.name for t in usable],
            "marker": [t.marker for t in usable],
            "east_m": wcs[:, 0],
            "north_m": wcs[:, 1],
            "up_m": wcs[:, 2],
            "residual_east_m": off[:, 0],
            "residual_north_m": off[:, 1],
            "residual_up_m": off[:, 2],
            "used": used,
        }
    )
    return FieldDatum(
        T_wcs_pcs=adjusted.x.with_cov(adjusted.cov),
        table=table,
        rejected=tuple(rejected),
        sigma0=float(np.sqrt(adjusted.sigma0_squared)),
        redundancy=adjusted.redundancy,
    )


def _adjust(pcs: ArrayF, cov: ArrayF, wcs: ArrayF, rtk: ArrayF, used: ArrayB) -> Adjusted[Rigid]:
    p, C, w, S = pcs[used], cov[used], wcs[used], rtk[used]

    def model(x: Rigid) -> Linear:
        return Linear(
            residual=(x.apply(p) - w).ravel(),
            jacobian=x.by_error(p).reshape(-1, 6),
            cov=S + x.R @ C @ x.R.T,
        )

    # rotation about the middle of the targets, so that shift and rotation are found from far away, too
    dp, dw = p - p.mean(axis=0), w - w.mean(axis=0)
    U, _, Vt = np.linalg.svd(dw.T @ dp)
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    start = Rigid(R=R, shift_m=w.mean(axis=0) - R @ p.mean(axis=0))
    try:
        return adjust([Observations("targets", model)], start, _NAMES, update=lambda x, dx: x.moved(dx))
    except UnobservableError as error:
        raise _one_line([]) from error


def _probability(adjusted: Adjusted[Rigid]) -> float:
    return float(chi2.sf(adjusted.sigma0_squared * adjusted.redundancy, adjusted.redundancy))


def _wrong(pcs: ArrayF, cov: ArrayF, wcs: ArrayF, rtk: ArrayF, names: list[str]) -> int:
    """The one target without which all others agree."""
    n = len(pcs)
    if n == 3:
        raise GeometryError(
            f"the RTK targets {', '.join(names)} contradict the field, one of them is wrong",
            expected="distances that agree with those of the bundle adjustment",
            cure="Measure them again; a fourth target would tell which one it is",
        )
    fits = np.array([_probability(_adjust(pcs, cov, wcs, rtk, np.arange(n) != k)) for k in range(n)])
    best = int(fits.argmax())
    clear = np.sort(fits)[-2] < _LEVEL
    if fits[best] < _LEVEL or not clear:
        several = [names[k] for k in np.argsort(-fits)[:2]]
        who = (
            f"most likely {several[0]} or {several[1]}" if fits[best] >= _LEVEL else "more than one is wrong"
        )
        raise GeometryError(
            f"the RTK targets {', '.join(names)} contradict the field: {who}",
            expected="at most one wrong target among enough good ones",
            cure="Measure the targets again, and check markers and sigmas in the field description",
        )
    return best


def _require_width(pcs: ArrayF, names: list[str]) -> None:
    size = np.linalg.svd(pcs - pcs.mean(axis=0), compute_uv=False)
    if size[1] < _WIDE * size[0]:
        raise _one_line(names)


def _one_line(names: list[str]) -> GeometryError:
    return GeometryError(
        f"the RTK targets {', '.join(names)} stand in one line, and the field may turn about it",
        expected="targets on all sides of the field",
        cure="Measure a target away from this line",
    )
