"""From marks of pictures to the reference points of a field: start, blunders, scale, adjustment."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.stats import chi2

from thalweg.calibration.field.bundle import (
    BARS,
    Bar,
    Layout,
    Problem,
    State,
    mark_lengths,
    marks_model,
    solve,
    start_state,
    transformed,
)  # fmt: skip
from thalweg.calibration.field.bundle_cleaning import LEAST_RAYS, Rejected, clean, thinned
from thalweg.calibration.field.description import FieldDescription
from thalweg.calibration.field.network_start import start_network
from thalweg.calibration.field.steady_camera import CameraChange, camera_changes
from thalweg.calibration.field.target_search import approximate_place
from thalweg.calibration.markers.mark_block import Block, block_of
from thalweg.calibration.markers.sheets import parse_mark
from thalweg.core.adjustment.solve import Adjusted
from thalweg.core.camera.model import PARAMETERS, Camera
from thalweg.core.errors import GeometryError
from thalweg.core.rigid import Rigid
from thalweg.core.types import AnyArray, ArrayB, ArrayF

# ---------------------------------------------------------------- do the scale bars of a field agree with
# each other?
#
# A free network knows all distances up to one scale. With two bars or more each gives it, so that a wrong one
# shows; with two, nobody can say which of them it is.


_LEVEL: Final = 1e-4
"""Probability with which good bars are called contradictory."""


@dataclass(frozen=True, slots=True)
class Scale:
    """Scale of a free network from its bars.

    Parameters
    ----------
    factor : true length over length in the network.
    sigma : of the factor.
    used : (b,) False for a bar that contradicts all others.
    off_m : (b,) stated length minus that of the network scaled by the used bars.
    sigma_off_m : (b,) of that difference, without the bar's own part in the scale.
    """

    factor: float
    sigma: float
    used: ArrayB
    off_m: ArrayF
    sigma_off_m: ArrayF


def scale_of(names: Sequence[str], stated_m: ArrayF, sigma_m: ArrayF, measured: ArrayF, cov: ArrayF) -> Scale:
    """Scale from bars; a single wrong one among three or more is found by leaving out each in turn.

    Parameters
    ----------
    names : of the bars.
    stated_m, sigma_m : (b,) their certificates.
    measured, cov : (b,) lengths in the free network, in its unit, and their covariance.

    Raises
    ------
    GeometryError : no bar; two bars contradict; or more than one of several is wrong.
    """
    b = len(names)
    if b == 0:
        raise GeometryError(
            "no scale bar", expected="at least two scale bars in the field description",
            cure="Put two bars of known length into the field and take the pictures again",
        )  # fmt: skip
    used = np.ones(b, dtype=np.bool_)
    if b > 1 and _contradiction(stated_m, sigma_m, measured, cov, used) < _LEVEL:
        if b == 2:
            factor, _ = _factor(stated_m, sigma_m, measured, cov, np.array([True, False]))
            off = (factor * measured[1] - stated_m[1]) * 1000.0
            raise GeometryError(
                f"the scale bars {names[0]} and {names[1]} contradict each other, one of them is wrong: by "
                f"{names[0]}, {names[1]} is {off:+.2f} mm longer than its {stated_m[1]:.5f} m",
                expected="bars that agree within their sigmas",
                cure="Check lengths and end marks in the field description; a third bar would tell which",
            )
        fits = np.array(
            [_contradiction(stated_m, sigma_m, measured, cov, np.arange(b) != k) for k in range(b)]
        )
        wrong = int(fits.argmax())
        if fits[wrong] < _LEVEL:
            raise GeometryError(
                f"more than one of the scale bars {', '.join(names)} is wrong",
                expected="at most one that contradicts the others",
                cure="Check lengths, sigmas and end marks in the field description",
            )
        used[wrong] = False
    factor, sigma = _factor(stated_m, sigma_m, measured, cov, used)
    off, sigma_off = np.empty(b), np.empty(b)
    for k in range(b):
        others = used.copy()
        others[k] = False
        if not others.any():
            off[k], sigma_off[k] = 0.0, np.nan
            continue
        own, own_sigma = _factor(stated_m, sigma_m, measured, cov, others)
        off[k] = stated_m[k] - own * measured[k]
        sigma_off[k] = np.sqrt(sigma_m[k] ** 2 + own**2 * cov[k, k] + (own_sigma * measured[k]) ** 2)
    return Scale(factor, sigma, used, off, sigma_off)


def _factor(
    stated: ArrayF, sigma: ArrayF, measured: ArrayF, cov: ArrayF, used: ArrayB
) -> tuple[float, float]:
    S, m, s = _system(stated, sigma, measured, cov, used)
    W = np.linalg.inv(S)
    N = float(m @ W @ m)
    return float(m @ W @ s) / N, N**-0.5


def _contradiction(stated: ArrayF, sigma: ArrayF, measured: ArrayF, cov: ArrayF, used: ArrayB) -> float:
    """Probability of a contradiction at least as large if all used bars are right."""
    if used.sum() < 2:
        return 1.0
    factor, _ = _factor(stated, sigma, measured, cov, used)
    S, m, s = _system(stated, sigma, measured, cov, used)
    v = s - factor * m
    return float(chi2.sf(v @ np.linalg.solve(S, v), used.sum() - 1))


def _system(
    stated: ArrayF, sigma: ArrayF, measured: ArrayF, cov: ArrayF, used: ArrayB
) -> tuple[ArrayF, ArrayF, ArrayF]:
    rough = float(np.median(stated[used] / measured[used]))
    S = rough**2 * cov[np.ix_(used, used)] + np.diag(np.square(sigma[used]))
    return S, measured[used], stated[used]


# ---------------------------------------------------------------- network


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldNetwork:
    """An adjusted field.

    Parameters
    ----------
    cameras : with covariance, by name.
    poses : ``T_pcs_ccs`` of each picture with covariance.
    points : (marker, corner) of each point; ``points_pcs`` (p, 3); ``cov_points`` (3p, 3p).
    adjusted, layout : the whole adjustment, for joint covariances.
    residuals : image, marker, corner, vx_px, vy_px, sigma_px, standardised, used.
    rejected : what, name, reason.
    scale : what the bars say, None if control points gave the datum.
    report : counts, sigma0, sigmas.
    changes : where the cameras most likely changed in the course of the pictures.
    """

    cameras: dict[str, Camera]
    poses: dict[str, Rigid]
    points: tuple[tuple[int, int], ...]
    points_pcs: ArrayF
    cov_points: ArrayF
    adjusted: Adjusted[State]
    layout: Layout
    residuals: pd.DataFrame
    rejected: pd.DataFrame
    scale: Scale | None
    report: dict[str, Any]
    changes: tuple[CameraChange, ...] = ()


def measure_field(
    marks: pd.DataFrame,
    cameras: Mapping[str, Camera],
    field: FieldDescription,
    *,
    approximate: Mapping[int, ArrayF] | None = None,
    calibrate: Mapping[str, tuple[str, ...]] | None = None,
) -> FieldNetwork:
    """Adjust the pictures of a field.

    Parameters
    ----------
    marks : image, camera, marker, corner, x_px, y_px, sigma_px.
    cameras : nominal interior orientation by name.
    field : its scale bars and marker sizes.
    approximate : centres of at least three markers in the frame that pcs should roughly have (east, north,
    up).
        Without, pcs is upright as the pictures are.
    calibrate : parameters to estimate of each camera; all if None.

    Raises
    ------
    GeometryError : too few markers or pictures, a free unknown, contradicting scale bars; each is named.
    """
    block = block_of(marks, cameras)
    rejected: list[Rejected] = []
    start = start_network(block, field.layout)
    rejected += [("image", image, reason) for image, reason in start.left_out.items()]
    used_cameras = tuple(cameras[name] for name in dict.fromkeys(block.camera_of))
    names = [camera.name for camera in used_cameras]
    number = {name: k for k, name in enumerate(dict.fromkeys(block.camera_of))}
    free = tuple(tuple((calibrate or {}).get(name, PARAMETERS[cameras[name].model])) for name in number)
    if len(set(names)) < len(names):
        raise GeometryError(f"two cameras are called {names}", expected="a name of its own for each camera")
    problem = Problem(
        block, np.array([number[c] for c in block.camera_of], np.int64), np.ones(len(block.image), bool), free
    )
    images = np.array([i in start.poses for i in range(len(block.images))])
    poses = {i: start.poses.get(i, Rigid(R=np.eye(3), shift_m=np.zeros(3))) for i in range(len(block.images))}
    x = start_state(block.images, used_cameras, poses, start.points)
    x = transformed(x, *_frame(block, x, images, approximate))
    problem, x, lost = thinned(
        problem, x, images, np.ones(len(block.points), bool), field.boat_markers, doubt=False
    )
    rejected += lost
    problem, adjusted, layout, cleaned = clean(problem, x, field.boat_markers)
    rejected += cleaned
    bars, scale = _scaled(field, problem, adjusted, layout, rejected)
    problem = replace(problem, bars=bars)
    x = transformed(adjusted.x, scale.factor, Rigid(R=np.eye(3), shift_m=np.zeros(3)))
    # once more: the approximate field may have been askew
    x = transformed(x, *_frame(problem.block, x, np.ones(len(x.C), bool), approximate, scaled=False))
    adjusted, layout = solve(problem, x)
    network = network_of(problem, adjusted, layout, rejected, scale)
    return replace(network, changes=tuple(camera_changes(problem, adjusted, layout)))


def _frame(
    block: Block,
    x: State,
    images: ArrayB,
    approximate: Mapping[int, ArrayF] | None,
    *,
    scaled: bool = True,
) -> tuple[float, Rigid]:
    """Scale and turn into pcs: the frame of approximate centres, or upright by the pictures.

    Centres that contradict the field, be they only some, do no harm.
    """
    markers = np.array([p[0] for p in block.points])
    known = {
        m: (x.X[markers == m].mean(axis=0), c)
        for m, c in (approximate or {}).items()
        if (markers == m).sum() == 4 and np.isfinite(x.X[markers == m]).all()
    }
    if len(known) >= 3:
        a, b = (np.array([pair[k] for pair in known.values()]) for k in (0, 1))
        place = approximate_place(a, b, scaled=scaled)
        if place is not None:
            return place
    up = -x.R[images][:, :, 1].mean(axis=0)
    up /= np.linalg.norm(up)
    solved = x.X[np.isfinite(x.X).all(axis=1)]
    # x along the longest horizontal extent of the field
    flat = (solved - solved.mean(axis=0)) @ (np.eye(3) - np.outer(up, up))
    along = np.linalg.svd(flat, full_matrices=False)[2][0]
    along -= up * (up @ along)
    along /= np.linalg.norm(along)
    R = np.stack([along, np.cross(up, along), up])
    return 1.0, Rigid(R=R, shift_m=-R @ np.median(solved, axis=0))


def _scaled(
    field: FieldDescription,
    problem: Problem,
    adjusted: Adjusted[State],
    layout: Layout,
    rejected: list[Rejected],
) -> tuple[tuple[Bar, ...], Scale]:
    """The bars that agree, as observations, and the scale of the network that they give."""
    at = {p: i for i, p in enumerate(problem.block.points)}
    bars: list[Bar] = []
    for stated in field.scale_bars:
        ends = [at.get(parse_mark(name)) for name in (stated.start, stated.end)]
        missing = [name for name, end in zip((stated.start, stated.end), ends, strict=True) if end is None]
        if missing or ends[0] is None or ends[1] is None:
            reason = f"its mark {' and '.join(missing)} was not measured in {LEAST_RAYS} good pictures"
            rejected.append(("scale bar", stated.name, reason))
            continue
        bars.append(Bar(stated.name, ends[0], ends[1], stated.length_m, stated.sigma_m))
    if not bars and field.scale_bars:
        told = "; ".join(f"{name}: {reason}" for what, name, reason in rejected if what == "scale bar")
        raise GeometryError(
            f"no scale bar can be used ({told})",
            expected="both ends of a bar in three pictures or more",
            cure="Take more pictures that show the bars",
        )
    X, cov = adjusted.x.X, adjusted.cov
    J = np.zeros((len(bars), len(adjusted.names)))
    length = np.empty(len(bars))
    for k, bar in enumerate(bars):
        d = X[bar.end] - X[bar.start]
        length[k] = np.linalg.norm(d)
        J[k, layout.point(bar.end)], J[k, layout.point(bar.start)] = d / length[k], -d / length[k]
    scale = scale_of(
        [bar.name for bar in bars],
        np.array([bar.length_m for bar in bars]),
        np.array([bar.sigma_m for bar in bars]),
        length,
        J @ cov @ J.T,
    )
    for bar, used, off in zip(bars, scale.used, scale.off_m, strict=True):
        if not used:
            reason = f"its length is {off * 1000:+.2f} mm off what the other bars say: measure it again"
            rejected.append(("scale bar", bar.name, reason))
    return tuple(bar for bar, used in zip(bars, scale.used, strict=True) if used), scale


def network_of(
    problem: Problem,
    adjusted: Adjusted[State],
    layout: Layout,
    rejected: list[Rejected],
    scale: Scale | None,
) -> FieldNetwork:
    """Tables and covariances of an adjusted bundle."""
    block, x, cov = problem.block, adjusted.x, adjusted.cov
    cameras: dict[str, Camera] = {}
    for camera, places in zip(x.cameras, layout.at_camera, strict=True):
        own = np.zeros((len(camera.parameters),) * 2)
        at = list(places)
        own[np.ix_(at, at)] = cov[np.ix_(list(places.values()), list(places.values()))]
        cameras[camera.name] = camera.with_parameters(camera.parameters, own)
    poses = {
        image: Rigid(R=x.R[i], shift_m=x.C[i], cov=_symmetric(cov[layout.pose(i), layout.pose(i)]))
        for i, image in enumerate(block.images)
    }
    used = problem.used
    v = marks_model(problem, layout, x, np.ones_like(used)).residual.reshape(-1, 2)
    residuals = pd.DataFrame(
        {
            "image": [block.images[i] for i in block.image],
            "marker": [block.points[p][0] for p in block.point],
            "corner": [block.points[p][1] for p in block.point],
            # observed minus computed, as residual plots have it
            "vx_px": -v[:, 0],
            "vy_px": -v[:, 1],
            "sigma_px": block.sigma_px,
            "standardised": mark_lengths(problem, x),
            "used": used,
        }
    )
    cov_points = _symmetric(cov[layout.points :, layout.points :])
    sigma = np.sqrt(np.maximum(np.diag(cov_points), 0.0)).reshape(-1, 3)
    low, high = adjusted.global_test()
    report: dict[str, Any] = {
        "images": len(block.images),
        "points": len(block.points),
        "markers": len({p[0] for p in block.points}),
        "marks": len(used),
        "marks_rejected": int((~used).sum()),
        "unknowns": len(adjusted.names),
        "redundancy": adjusted.redundancy,
        "sigma0": float(np.sqrt(adjusted.sigma0_squared)),
        "sigma0_band": [float(np.sqrt(low)), float(np.sqrt(high))],
        "mark_rms_px": float(np.sqrt(np.square(v[used]).mean())),
        "mark_sigma_px": float(np.sqrt(np.square(block.sigma_px[used]).mean())),
        "object_sigma_mean_mm": float(np.sqrt(np.square(sigma).mean()) * 1000.0),
        "object_sigma_max_mm": float(sigma.max() * 1000.0),
        "rejected": dict(Counter(what for what, _, _ in rejected)),
    }
    if scale is not None:
        report["scale_sigma"] = scale.sigma
        report["scale_bars_used"] = int(scale.used.sum())
        report["scale_bar_sigma0"] = adjusted.group_sigma0.get(BARS, 0.0)
    return FieldNetwork(
        cameras=cameras,
        poses=poses,
        points=block.points,
        points_pcs=x.X,
        cov_points=cov_points,
        adjusted=adjusted,
        layout=layout,
        residuals=residuals,
        rejected=pd.DataFrame(rejected, columns=["what", "name", "reason"]),
        scale=scale,
        report=report,
    )


def _symmetric(C: AnyArray) -> ArrayF:
    return np.asarray((C + C.T) / 2)
