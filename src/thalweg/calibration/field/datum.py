"""The place of a calibration field in the world, from targets whose centres were measured by RTK.

``x_wcs = R_wcs_pcs x_pcs + shift``; the scale is that of the scale bars. Both the RTK sigmas and the
covariance of the field's points count. What contradicts grossly is found first and without approximate values
(`thalweg.calibration.field.network`), small contradictions by leaving out each target in turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import chi2

from thalweg.calibration.field.description import Target
from thalweg.calibration.field.network import agreeing, distances_words, similarity
from thalweg.calibration.field.points import FieldPoints
from thalweg.core import (
    Adjusted,
    ArrayB,
    ArrayF,
    GeometryError,
    Linear,
    LocalFrame,
    Observations,
    Rigid,
    UnobservableError,
    adjust,
)

_LEVEL: Final = 1e-3
"""Probability with which good targets are called contradictory."""
_NAMES: Final = ("east", "north", "up", "rotation about east", "rotation about north", "rotation about up")
_WIDE: Final = 0.05
"""Width over length of the targets' layout below which they count as standing in one line."""
_GROSS_M: Final = 0.5
_GROSS_SIGMAS: Final = 10.0
"""A target farther off than this sum is a mistake in writing, not one of measurement."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldDatum:
    """``T_wcs_pcs`` with covariance, ``table`` of the targets, and what was rejected as (name, reason).

    ``sigma_scale`` is the relative sigma with which the targets know the size of the field.
    """

    T_wcs_pcs: Rigid
    table: pd.DataFrame
    rejected: tuple[tuple[str, str], ...]
    sigma0: float
    redundancy: float
    sigma_scale: float


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
    n = len(usable)
    gross_m = [_GROSS_M + _GROSS_SIGMAS * float(np.linalg.norm(t.sigma_m)) for t in usable]
    used, off, _ = agreeing(pcs, wcs, np.array(gross_m))
    if used.sum() < max(3, n - 1):
        raise _contradiction([t.name for t in usable], off)
    adjusted = _adjust(pcs, cov, wcs, rtk, used)
    if _probability(adjusted) < _LEVEL:
        # the one target without which, and without which alone, all others agree
        each = [np.arange(n) != k for k in range(n)] if n > 3 and used.all() else []
        alone = [_probability(_adjust(pcs, cov, wcs, rtk, others)) >= _LEVEL for others in each]
        if sum(alone) != 1:
            raise _contradiction([t.name for t in usable], wcs - adjusted.x.apply(pcs))
        used[alone.index(True)] = False
        adjusted = _adjust(pcs, cov, wcs, rtk, used)
    for wrong in np.flatnonzero(~used):
        east, north, up = wcs[wrong] - adjusted.x.apply(pcs[wrong : wrong + 1])[0]
        reason = f"its RTK position is {_metres(east)} east, {_metres(north)} north, {_metres(up)} up"
        reason += " of what the others say: measure it again, and check its marker and coordinates (lat_deg, "
        reason += "lon_deg) in the field description"
        rejected.append((usable[wrong].name, reason))
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
        sigma_scale=_sigma_scale(pcs[used], cov[used], rtk[used], adjusted.x),
    )


def _adjust(pcs: ArrayF, cov: ArrayF, wcs: ArrayF, rtk: ArrayF, used: ArrayB) -> Adjusted[Rigid]:
    p, C, w, S = pcs[used], cov[used], wcs[used], rtk[used]

    def model(x: Rigid) -> Linear:
        """Residuals of the targets, field minus RTK."""
        return Linear(
            residual=(x.apply(p) - w).ravel(), jacobian=x.by_error(p).reshape(-1, 6), cov=S + x.R @ C @ x.R.T
        )

    start = similarity(p, w, scaled=False)[1]
    try:
        return adjust([Observations("targets", model)], start, _NAMES, update=lambda x, dx: x.moved(dx))
    except UnobservableError as error:
        raise _one_line([]) from error


def _sigma_scale(pcs: ArrayF, cov: ArrayF, rtk: ArrayF, place: Rigid) -> float:
    """Relative sigma of the scale by the targets; it hardly depends on turn and shift of the field."""
    away = (pcs - pcs.mean(axis=0)) @ place.R.T
    S = rtk + place.R @ cov @ place.R.T
    return float(np.einsum("ni,nij,nj->", away, np.linalg.inv(S), away)) ** -0.5


def _contradiction(names: list[str], off_m: ArrayF) -> GeometryError:
    return GeometryError(
        f"the RTK targets contradict the field by {distances_words(names, off_m)}",
        expected="at most one wrong target among four or more",
        cure="Check markers and coordinates (lat_deg, lon_deg) of the targets, those with the largest "
        "distance first, the lengths of the scale bars in metres, and the campaign's origin",
    )


def _metres(value: float) -> str:
    return f"{value * 1000:+.0f} mm" if abs(value) < 10 else f"{value:+.1f} m"


def _probability(adjusted: Adjusted[Rigid]) -> float:
    return float(chi2.sf(adjusted.sigma0_squared * adjusted.redundancy, adjusted.redundancy))


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
