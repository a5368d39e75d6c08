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
_SIMILAR: Final = 1.01
"""Factor between two scales below which they are no explanation of a contradiction."""
_SCALED_SIGMAS: Final = 5.0
"""Targets that all lie nearer than so many sigmas to the field if it is scaled, blame its scale."""
_FAR_M: Final = 20_000.0
"""Distance of all targets from the origin of wcs at which a mistake in their coordinates is likely."""


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
    used = _without_gross(pcs, wcs, usable)
    gross = not used.all()
    adjusted = _adjust(pcs, cov, wcs, rtk, used)
    if _probability(adjusted) < _LEVEL:
        off = wcs - adjusted.x.apply(pcs)
        if gross:
            raise _several([t.name for t in usable], off)
        _require_scale(pcs, wcs, _tolerances_m(usable, 0.0, _SCALED_SIGMAS), [t.name for t in usable], off)
        used[_wrong(pcs, cov, wcs, rtk, [t.name for t in usable])] = False
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


def _tolerances_m(targets: Sequence[Target], least_m: float, sigmas: float) -> ArrayF:
    return np.array([least_m + sigmas * float(np.linalg.norm(t.sigma_m)) for t in targets])


def _without_gross(pcs: ArrayF, wcs: ArrayF, targets: Sequence[Target]) -> ArrayB:
    """(n,) targets without the only one that is far off.

    Raises
    ------
    GeometryError : the scale bars contradict, or more than one target is far off.
    """
    names = [t.name for t in targets]
    tolerance = _tolerances_m(targets, _GROSS_M, _GROSS_SIGMAS)
    near, off, _ = agreeing(pcs, wcs, tolerance)
    if near.all():
        return near
    _require_scale(pcs, wcs, tolerance, names, off)
    if len(targets) > 3 and near.sum() == len(targets) - 1:
        return near
    raise _several(names, off, near, _origin_words(wcs))


def _sigma_scale(pcs: ArrayF, cov: ArrayF, rtk: ArrayF, place: Rigid) -> float:
    """Relative sigma of the scale by the targets; it hardly depends on turn and shift of the field."""
    away = (pcs - pcs.mean(axis=0)) @ place.R.T
    S = rtk + place.R @ cov @ place.R.T
    return float(np.einsum("ni,nij,nj->", away, np.linalg.inv(S), away)) ** -0.5


def _several(names: list[str], off_m: ArrayF, near: ArrayB | None = None, hint: str = "") -> GeometryError:
    who = "more than one is wrong"
    if near is not None and near.sum() > len(near) / 2 and len(near) > 3:
        wrong = " and ".join(n for n, good in zip(names, near, strict=True) if not good)
        who = f"{wrong} are wrong, the others agree"
    elif len(names) == 3:
        who = "one of them is wrong; a fourth target would tell which one"
    return GeometryError(
        f"the RTK targets contradict the field by {distances_words(names, off_m)}: {who}{hint}",
        expected="at most one wrong target among four or more",
        cure="Check markers and coordinates (lat_deg, lon_deg) of the targets in the field description, "
        "those with the largest distance first, and the campaign's origin",
    )


def _require_scale(pcs: ArrayF, wcs: ArrayF, tolerance_m: ArrayF, names: list[str], off_m: ArrayF) -> None:
    """Scale bars that are wrong show in all targets at once, and no single one is to blame.

    Raises
    ------
    GeometryError : in another scale the field agrees with all targets.
    """
    kept, _, factor = agreeing(pcs, wcs, tolerance_m, scaled=True)
    if kept.all() and factor > 0 and max(factor, 1 / factor) > _SIMILAR:
        raise GeometryError(
            f"the RTK targets contradict the field by {distances_words(names, off_m)}: by the targets the "
            f"field is {factor:.4g} times as large as by the scale bars",
            expected="scale bars and RTK targets that give one scale",
            cure="Check lengths and end marks of the scale bars (in metres) in the field description",
        )


def _origin_words(wcs: ArrayF) -> str:
    away = float(np.linalg.norm(wcs, axis=1).min())
    return f"; all targets are {away / 1000:.0f} km from the campaign's origin" if away > _FAR_M else ""


def _metres(value: float) -> str:
    return f"{value * 1000:+.0f} mm" if abs(value) < 10 else f"{value:+.1f} m"


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
            f"the RTK targets {', '.join(names)} contradict the field: {who}{_origin_words(wcs)}",
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
