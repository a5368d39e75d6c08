"""From marks of pictures to the reference points of a field: start, blunders, scale, adjustment."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy import sparse
from scipy.stats import chi2

from thalweg.calibration import Block, MarkerLayout, block_of, collinear, parse_mark, sheet_centres
from thalweg.calibration.field.bundle import (
    BARS,
    LEAST_RAYS,
    Bar,
    Layout,
    Problem,
    Rejected,
    State,
    bars_model,
    clean,
    mark_lengths,
    marks_model,
    solve,
    start_state,
    thinned,
    transformed,
)
from thalweg.calibration.field.description import FieldDescription
from thalweg.calibration.field.rays import improved_pose, pose_from_rays
from thalweg.core import (
    PARAMETERS,
    Adjusted,
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayI,
    Camera,
    GeometryError,
    Rigid,
    root_mean_square,
)
from thalweg.core.geometry import fit_points

_LEVEL: Final = 1e-4
"""Probability with which good bars are called contradictory."""

_ROUGH_RAD: Final = 0.06
"""Directions to the centres of sheets from their distances in one other picture."""
_FINE_RAD: Final = 0.01
"""Directions to intersected saddles with nominal interior orientation."""
_LEAST_MARKERS: Final = 4
_LEAST_SADDLES: Final = 7
_LEAST_ANGLE_RAD: Final = 0.03
_FITS_WELL: Final = 0.85
"""Share of fitting marks from which on a picture's pose is taken as right."""
_LEAST_ALIGNED: Final = 3
_ALIGNED: Final = 0.1
"""Median difference of the centres of aligned sheets over the size of their layout."""
_LEAST_WIDTH_OF_SHEETS: Final = 0.05
"""Width of the aligned sheets' layout over their distance: in one line they leave a turn free."""

_MOST_TRIPLES: Final = 2000
_ALL_TRIPLES: Final = 40
"""Places of which all triples are listed, to choose from."""
_LEAST_WIDTH_OF_TARGETS: Final = 0.02
"""Width over length of three targets below which they leave a turn of the field free."""
_SCALES: Final = (0.6, 1.6)
"""The sheets' printed size gives the size of a field, less the error of a nominal focal length."""
_ASKEW: Final = 0.15
"""Median distance over the size of the field up to which an approximate place is one."""
_LEAST_IMAGES: Final = 3
"""Pictures on either side of the place where a camera may have changed."""
_NOTED: Final = 0.3
_REFUSED: Final = 3.0
"""Bending of the field over its sigmas from which on it is told, and from which on it is refused."""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraChange:
    """The most likely change of a camera in the course of the pictures.

    Parameters
    ----------
    camera : its name.
    before, since : last picture before and first picture after the change, by the order of the file names.
    constant : relative change of the camera constant, and ``sigma_constant``.
    shift_px : (2,) change of the principal point.
    probability : of a change at least as clear if the camera is steady, over all places that were tried.
    bend_m : root mean square of the change of the points if the change is accounted for.
    bend_sigmas : the same over that of their standard deviations.
    """

    camera: str
    before: str
    since: str
    constant: float
    sigma_constant: float
    shift_px: tuple[float, float]
    probability: float
    bend_m: float
    bend_sigmas: float

    @property
    def clear(self) -> bool:
        """It is no accident, and it matters."""
        return self.probability < _LEVEL and self.bend_sigmas > _NOTED

    @property
    def words(self) -> str:
        """What was found and what to do, for people."""
        x, y = self.shift_px
        return (
            f"the camera {self.camera} changed between {self.before} and {self.since}: camera constant by "
            f"{self.constant:+.3%} (sigma {self.sigma_constant:.3%}), principal point by {x:+.1f} and "
            f"{y:+.1f} pixels. The lens was focused or zoomed, or its stabiliser was on; that bends the "
            f"field by {self.bend_m * 1000:.2f} mm, {self.bend_sigmas:.1f} times its sigma. Take out the "
            "pictures before or since, or take all again with focus and zoom taped and the stabiliser off"
        )


@dataclass(slots=True)
class Start:
    """Approximate values: poses ``T_pcs_ccs`` by image, points (p, 3), NaN if unknown, images left out."""

    poses: dict[int, Rigid]
    points: ArrayF
    left_out: dict[str, str] = field(default_factory=dict)


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
    start: Start | None = None,
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
    start : of `start_network` for these marks and cameras, if it is known already.

    Raises
    ------
    GeometryError : too few markers or pictures, a free unknown, contradicting scale bars; each is named.
    """
    block = block_of(marks, cameras)
    rejected: list[Rejected] = []
    start = start or start_network(block, field.layout)
    rejected += [("image", image, reason) for image, reason in start.left_out.items()]
    used_cameras = tuple(cameras[name] for name in dict.fromkeys(block.camera_of))
    names = [camera.name for camera in used_cameras]
    number = {name: k for k, name in enumerate(dict.fromkeys(block.camera_of))}
    free = tuple(PARAMETERS[cameras[name].model] for name in number)
    if len(set(names)) < len(names):
        raise GeometryError(f"two cameras are called {names}", expected="a name of its own for each camera")
    problem = Problem(
        block, np.array([number[c] for c in block.camera_of], np.int64), np.ones(len(block.image), bool), free
    )
    images = np.array([i in start.poses for i in range(len(block.images))])
    poses = {i: start.poses.get(i, Rigid()) for i in range(len(block.images))}
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
    x = transformed(adjusted.x, scale.factor, Rigid())
    # once more: the approximate field may have been askew
    x = transformed(x, *_frame(problem.block, x, np.ones(len(x.C), bool), approximate, scaled=False))
    adjusted, layout = solve(problem, x)
    network = network_of(problem, adjusted, layout, rejected, scale)
    return replace(network, changes=tuple(camera_changes(problem, adjusted, layout)))


def _frame(
    block: Block, x: State, images: ArrayB, approximate: Mapping[int, ArrayF] | None, *, scaled: bool = True
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
    measured, stated_m = bars_model(tuple(bars), layout, adjusted.x), np.array([bar.length_m for bar in bars])
    J = measured.jacobian
    scale = scale_of(
        [bar.name for bar in bars],
        stated_m,
        np.array([bar.sigma_m for bar in bars]),
        stated_m + measured.residual,
        J @ adjusted.cov @ J.T,
    )
    for bar, used, off in zip(bars, scale.used, scale.off_m, strict=True):
        if not used:
            reason = f"its length is {off * 1000:+.2f} mm off what the other bars say: measure it again"
            rejected.append(("scale bar", bar.name, reason))
    return tuple(bar for bar, used in zip(bars, scale.used, strict=True) if used), scale


def network_of(
    problem: Problem, adjusted: Adjusted[State], layout: Layout, rejected: list[Rejected], scale: Scale | None
) -> FieldNetwork:
    """Tables and covariances of an adjusted bundle."""
    block, x, cov = problem.block, adjusted.x, adjusted.cov
    cameras: dict[str, Camera] = {}
    for camera, change, at in zip(x.cameras, layout.change, layout.lens, strict=True):
        cameras[camera.name] = camera.with_parameters(camera.parameters, change @ cov[at, at] @ change.T)
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
    test = adjusted.global_test()
    report: dict[str, Any] = {
        "images": len(block.images),
        "points": len(block.points),
        "markers": len({p[0] for p in block.points}),
        "marks": len(used),
        "marks_rejected": int((~used).sum()),
        "unknowns": len(adjusted.names),
        "redundancy": adjusted.redundancy,
        "sigma0": test.sigma0,
        "sigma0_band": [test.low, test.high],
        "mark_rms_px": root_mean_square(v[used]),
        "mark_sigma_px": root_mean_square(block.sigma_px[used]),
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


# ---------------------------------------------------------------- do the scale bars of a field agree with
# each other?
#
# A free network knows all distances up to one scale. With two bars or more each gives it, so that a wrong one
# shows; with two, nobody can say which of them it is.


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
            "no scale bar",
            expected="at least two scale bars in the field description",
            cure="Put two bars of known length into the field and take the pictures again",
        )

    def fitted(used: ArrayB) -> tuple[float, float, float]:
        """Scale by some bars, its sigma, and the probability that they differ as much if all are right."""
        stated, length = stated_m[used], measured[used]
        rough = float(np.median(stated / length))
        W = np.linalg.inv(rough**2 * cov[np.ix_(used, used)] + np.diag(np.square(sigma_m[used])))
        N = float(length @ W @ length)
        factor = float(length @ W @ stated) / N
        v = stated - factor * length
        return factor, N**-0.5, float(chi2.sf(v @ W @ v, len(v) - 1)) if len(v) > 1 else 1.0

    used = np.ones(b, dtype=np.bool_)
    if fitted(used)[2] < _LEVEL:
        if b == 2:
            off = (fitted(np.array([True, False]))[0] * measured[1] - stated_m[1]) * 1000.0
            raise GeometryError(
                f"the scale bars {names[0]} and {names[1]} contradict each other, one of them is wrong: by "
                f"{names[0]}, {names[1]} is {off:+.2f} mm longer than its {stated_m[1]:.5f} m",
                expected="bars that agree within their sigmas",
                cure="Check lengths and end marks in the field description; a third bar would tell which",
            )
        fits = np.array([fitted(np.arange(b) != k)[2] for k in range(b)])
        wrong = int(fits.argmax())
        if fits[wrong] < _LEVEL:
            raise GeometryError(
                f"more than one of the scale bars {', '.join(names)} is wrong",
                expected="at most one that contradicts the others",
                cure="Check lengths, sigmas and end marks in the field description",
            )
        used[wrong] = False
    factor, sigma, _ = fitted(used)
    off, sigma_off = np.empty(b), np.empty(b)
    for k in range(b):
        others = used.copy()
        others[k] = False
        if not others.any():
            off[k], sigma_off[k] = 0.0, np.nan
            continue
        own, own_sigma, _ = fitted(others)
        off[k] = stated_m[k] - own * measured[k]
        sigma_off[k] = np.sqrt(sigma_m[k] ** 2 + own**2 * cov[k, k] + (own_sigma * measured[k]) ** 2)
    return Scale(factor, sigma, used, off, sigma_off)


# ---------------------------------------------------------------- approximate poses and points
#
# Each sheet of known size has a distance from the camera in each picture. So the picture with the most
# markers gives a first rough field; a second picture is resected on the centres of its sheets; from then on
# saddles are intersected from the pictures that are known, and picture after picture is resected on them.
# Planar poses of a sheet have two solutions that lie close together for a small sheet; only the centre,
# which hardly depends on which one is right, is used, and intersection settles the rest.
#
# A wrong mark makes its sheet look like no flat square: the marks of such sheets make no points until the
# poses are known. Where too few markers link a picture to the others, three sheets of known distance do.


def start_network(block: Block, layout: MarkerLayout) -> Start:
    """Approximate values in the frame of one picture; see the module.

    Raises
    ------
    GeometryError : no picture shows enough markers, or no two belong together.
    """
    centres, rays, odd = sheet_centres(block, layout)
    # marks of odd sheets make no points; for a pose, wrong ones among many do no harm
    sure = replace(block, rays=np.where(odd[:, None], np.nan, block.rays))
    count = {i: len(seen) for i, seen in centres.items()}
    if not count or max(count.values()) < _LEAST_MARKERS:
        best = max(count.values(), default=0)
        raise GeometryError(
            f"at most {best} whole markers in one picture",
            expected=f"pictures with {_LEAST_MARKERS} markers or more",
            cure="Take pictures from farther away or with a wider lens, so that each shows several sheets",
        )
    first = max(sorted(count), key=lambda i: count[i])
    start = Start({first: Rigid()}, np.full((len(block.points), 3), np.nan))
    rough = dict(centres[first])
    waiting = set(range(len(block.images))) - {first}
    next_sweep = 3
    while waiting:
        solved = np.isfinite(start.points[:, 0])
        score = {i: _known(block, i, solved, rough, rays.get(i, {})) for i in sorted(waiting)}
        order = sorted(waiting, key=lambda i: (-max(score[i]), i))
        found = _first((i, _resected(block, i, start, solved, rough, rays.get(i, {}))) for i in order)
        if found is None:
            # a weak link, only where no other is left
            places = rough | _centres(block, start)
            found = _first((i, _aligned(centres.get(i, {}), places)) for i in order)
        if found is None:
            break
        image, pose = found
        start.poses[image] = pose
        waiting.remove(image)
        for marker, centre in centres.get(image, {}).items():
            rough.setdefault(marker, pose.apply(centre[None])[0])
        if len(start.poses) >= next_sweep or not waiting:
            next_sweep = max(next_sweep + 1, round(1.3 * next_sweep))
            _sweep(block, sure, start, 3)
        else:
            start.points = _intersect(sure, start.poses)
    waiting -= _join(block, sure, start, waiting, centres, layout)
    for image in sorted(waiting):
        n = len(set(block.marker[block.image == image]))
        seen = f"{n} marker{'s' if n != 1 else ''}"
        start.left_out[block.images[image]] = f"shows {seen}, too few that other pictures show, too"
    if len(start.poses) < 2:
        raise GeometryError(
            "no two pictures show the same four markers",
            expected="overlapping pictures of one field",
            cure="Take more pictures, each with at least half of the markers of the one before",
        )
    _sweep(block, sure, start, 4)
    _repair(block, sure, start)
    _sweep(block, sure, start, 2)
    unsolved = np.isnan(start.points[:, 0])
    start.points[unsolved] = _intersect(block, start.poses)[unsolved]
    return start


def misfit_px(block: Block, start: Start, focal_px: float) -> float:
    """How badly a start fits: median angle of rays in pixels, more if pictures are missing."""
    off = _off_rad(block, start)
    off = off[np.isfinite(off)]
    if len(off) == 0:
        return float("inf")
    return float(np.median(off)) * focal_px * (len(block.image) / len(off)) ** 2


def _off_rad(block: Block, start: Start) -> ArrayF:
    """(m,) angle between the ray of a mark and the direction to its point, NaN where one is unknown."""
    R, C = _placed(block, start.poses)
    away = start.points[block.point] - C[block.image]
    local = np.einsum("mji,mj->mi", R[block.image], away)
    return np.asarray(np.linalg.norm(_unit(local) - block.rays, axis=1))


def _misses(pose: Rigid, points: ArrayF, rays: ArrayF) -> ArrayF:
    """(n,) angles between rays and the directions to their points."""
    return np.asarray(np.linalg.norm(_unit((points - pose.shift_m) @ pose.R) - rays, axis=1))


def _placed(block: Block, poses: dict[int, Rigid]) -> tuple[ArrayF, ArrayF]:
    """Rotations (i, 3, 3) and projection centres (i, 3) of all pictures, NaN without a pose."""
    R, C = np.full((len(block.images), 3, 3), np.nan), np.full((len(block.images), 3), np.nan)
    for image, pose in poses.items():
        R[image], C[image] = pose.R, pose.shift_m
    return R, C


def _known(
    block: Block, image: int, solved: ArrayB, rough: dict[int, ArrayF], rays: dict[int, ArrayF]
) -> tuple[int, int]:
    mine = block.image == image
    return len(set(block.marker[mine & solved[block.point]])), len(set(rays) & set(rough))


def _resected(
    block: Block, image: int, start: Start, solved: ArrayB, rough: dict[int, ArrayF], rays: dict[int, ArrayF]
) -> Rigid | None:
    """Pose of an image on intersected saddles, or else on the centres of sheets; None if neither is safe."""
    mine = block.rows(image, solved)
    markers = len(set(block.marker[mine]))
    if markers >= 2 and len(mine) >= _LEAST_SADDLES:
        pose, angles = _pose(start.points[block.point[mine]], block.rays[mine], block.marker[mine], _FINE_RAD)
        if pose is not None and (angles < _FINE_RAD).mean() > (0.6 if markers >= _LEAST_MARKERS else 0.85):
            return pose
    both = sorted(set(rays) & set(rough))
    if len(both) < _LEAST_MARKERS:
        return None
    points, directions = np.array([rough[m] for m in both]), np.array([rays[m] for m in both])
    pose, angles = _pose(points, directions, np.array(both), _ROUGH_RAD)
    enough = (angles < _ROUGH_RAD).sum() >= max(_LEAST_MARKERS, 0.6 * len(both))
    return pose if enough else None


def _pose(points: ArrayF, rays: ArrayF, groups: ArrayI, cap_rad: float) -> tuple[Rigid | None, ArrayF]:
    """A pose and the angles of rays (n,), None if no three rays give one: another picture goes on."""
    try:
        return pose_from_rays(points, rays, groups, cap_rad=cap_rad)
    except GeometryError:
        return None, np.full(len(points), np.pi)


def _first(tried: Iterable[tuple[int, Rigid | None]]) -> tuple[int, Rigid] | None:
    """The first image that has a pose; None if no image has one."""
    return next(((image, pose) for image, pose in tried if pose is not None), None)


def _centres(block: Block, start: Start) -> dict[int, ArrayF]:
    """Centres (3,) of markers whose four saddles were intersected."""
    solved = [(p[0], x) for p, x in zip(block.points, start.points, strict=True) if np.isfinite(x).all()]
    sums: dict[int, list[ArrayF]] = {}
    for marker, x in solved:
        sums.setdefault(marker, []).append(x)
    return {marker: np.mean(xs, axis=0) for marker, xs in sums.items() if len(xs) == 4}


def _places(block: Block, start: Start, centres: dict[int, dict[int, ArrayF]]) -> dict[int, ArrayF]:
    """Places (3,) of markers: intersected, or else by their distances in the pictures that show them."""
    seen: dict[int, list[ArrayF]] = {}
    for image, pose in start.poses.items():
        for marker, centre in centres.get(image, {}).items():
            seen.setdefault(marker, []).append(pose.apply(centre[None])[0])
    return {m: np.median(xs, axis=0) for m, xs in seen.items()} | _centres(block, start)


def _aligned(centres: dict[int, ArrayF], places: dict[int, ArrayF]) -> Rigid | None:
    """Pose from three common sheets or more: their centres in ccs, with the distances, laid upon pcs."""
    both = sorted(set(centres) & set(places))
    if len(both) < _LEAST_ALIGNED:
        return None
    ccs, pcs = (np.array([at[m] for m in both]) for at in (centres, places))
    R, shift_m, _ = fit_points(ccs, pcs)
    pose = Rigid(R=R, shift_m=shift_m)
    off = np.linalg.norm(pose.apply(ccs) - pcs, axis=1)
    size = np.linalg.svd(ccs - ccs.mean(axis=0), compute_uv=False) / np.sqrt(len(ccs))
    narrow = size[1] < _LEAST_WIDTH_OF_SHEETS * float(np.linalg.norm(ccs, axis=1).max())
    return None if narrow or np.median(off) > _ALIGNED * np.linalg.norm(size) else pose


def _sweep(block: Block, sure: Block, start: Start, times: int) -> None:
    """Points from poses and the sure marks, and poses from points, in turns."""
    for _ in range(times):
        start.points = _intersect(sure, start.poses)
        solved = np.isfinite(start.points[:, 0])
        for image, pose in start.poses.items():
            mine = block.rows(image, solved)
            points, rays = start.points[block.point[mine]], block.rays[mine]
            off = _misses(pose, points, rays)
            near = off < max(_FINE_RAD, 3 * float(np.median(off))) if len(off) else off > 0
            if near.sum() >= 6:
                start.poses[image] = improved_pose(pose, points[near], rays[near])
    start.points = _intersect(sure, start.poses)


def _join(
    block: Block,
    sure: Block,
    start: Start,
    waiting: set[int],
    centres: dict[int, dict[int, ArrayF]],
    layout: MarkerLayout,
) -> set[int]:
    """Pictures that hang together among themselves are laid upon the others by markers that both show.

    Returns those that are joined.
    """
    rows = np.isin(block.image, list(waiting))
    if len(waiting) < 2 or len(start.poses) < 2 or not rows.any():
        return set()
    try:
        other = start_network(block.taken(rows), layout)
    except GeometryError:
        return set()
    T = _aligned(_places(block, other, centres), _places(block, start, centres))
    if T is None:
        return set()
    start.poses |= {image: T @ pose for image, pose in other.poses.items()}
    _sweep(block, sure, start, 3)
    return set(other.poses)


def _repair(block: Block, sure: Block, start: Start) -> None:
    """Pictures that fit badly are resected anew on what the others say: a wrong pose spoils points, too."""
    off = _off_rad(block, start)
    fitting = {i: float(np.mean(off[block.image == i] < _FINE_RAD)) for i in start.poses}
    for image in sorted((i for i in fitting if fitting[i] < _FITS_WELL), key=lambda i: (fitting[i], i)):
        others = {i: pose for i, pose in start.poses.items() if i != image}
        points = _intersect(sure, others)
        mine = block.rows(image, np.isfinite(points[:, 0]))
        if len(mine) < _LEAST_SADDLES or len(set(block.marker[mine])) < _LEAST_MARKERS:
            continue
        there, rays = points[block.point[mine]], block.rays[mine]
        pose, angles = _pose(there, rays, block.marker[mine], _FINE_RAD)
        before = _misses(start.poses[image], there, rays)
        if pose is not None and (angles < _FINE_RAD).mean() > (before < _FINE_RAD).mean():
            start.poses[image] = pose


def _intersect(block: Block, poses: dict[int, Rigid]) -> ArrayF:
    """Points (p, 3) nearest to their rays, wrong ones weighted down; NaN without two that cross."""
    n = len(block.points)
    rows = np.flatnonzero(np.isin(block.image, list(poses)) & np.isfinite(block.rays).all(axis=1))
    R, C = _placed(block, poses)
    image, point = block.image[rows], block.point[rows]
    d = np.einsum("mij,mj->mi", R[image], block.rays[rows])
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    # of each ray the matrix of its plane across and the place of the camera on that plane
    parts = np.concatenate([across.reshape(-1, 9), (across @ C[image][:, :, None])[:, :, 0]], axis=1)
    sums = sparse.csr_array((np.ones(len(rows)), (point, np.arange(len(rows)))), shape=(n, len(rows)))
    weight = np.ones(len(rows))
    points = np.full((n, 3), np.nan)
    count = np.bincount(point, minlength=n)
    for _ in range(4):
        total = sums @ (weight[:, None] * parts)
        A, b = total[:, :9].reshape(n, 3, 3), total[:, 9:]
        smallest = np.linalg.eigvalsh(A)[:, 0]
        mass = np.bincount(point, weights=weight, minlength=n)
        fixed = (count >= 2) & (smallest > mass * _LEAST_ANGLE_RAD**2 / 4)
        points[:] = np.nan
        points[fixed] = np.linalg.solve(A[fixed], b[fixed][:, :, None])[:, :, 0]
        away = points[point] - C[image]
        off = np.linalg.norm((across @ away[:, :, None])[:, :, 0], axis=1)
        distance = np.linalg.norm(away, axis=1)
        weight = 1e-3 / np.maximum(np.nan_to_num(off / distance, nan=1.0), 1e-3)
    return points


def _unit(v: ArrayF) -> ArrayF:
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


# ---------------------------------------------------------------- targets that contradict the field grossly
#
# Any three targets give a place of the field in closed form; the place that most targets agree with is
# kept, as in RANSAC, but over all triples.


def similarity(a: ArrayF, b: ArrayF, *, scaled: bool) -> tuple[float, Rigid]:
    """Factor and ``T`` with ``b = T (factor a)`` by least squares (Umeyama 1991); without scale, factor is 1.

    Parameters
    ----------
    a, b : (n, 3) the same places in two frames, n >= 3.
    scaled : estimate the factor.
    """
    R, shift_m, factor = fit_points(a, b, scaled=scaled)
    return float(factor), Rigid(R=R, shift_m=shift_m)


def approximate_place(a: ArrayF, b: ArrayF, *, scaled: bool) -> tuple[float, Rigid] | None:
    """The similarity that most places agree with; None if no three belong together.

    Parameters
    ----------
    a, b : (n, 3) the same places in two frames, of about the same size.
    scaled : estimate a factor, too.
    """
    size = float(np.sqrt(np.square(a - a.mean(axis=0)).sum(axis=1).mean()))
    kept, _, factor = agreeing(a, b, np.full(len(a), _ASKEW * size), scaled=True)
    if not kept.any() or not _SCALES[0] < factor < _SCALES[1]:
        return None
    return similarity(a[kept], b[kept], scaled=scaled)


def agreeing(
    pcs: ArrayF, wcs: ArrayF, tolerance_m: ArrayF, *, scaled: bool = False
) -> tuple[ArrayB, ArrayF, float]:
    """Places that the similarity of most places agrees with, as targets of a field or points of a block.

    Parameters
    ----------
    pcs, wcs : (n, 3) the same places in two frames, as targets in the field and by RTK.
    tolerance_m : (n,) distance up to which a place agrees.
    scaled : the scale between both is free.

    Returns
    -------
    (n,) which agree, (n, 3) wcs minus what the similarity makes of pcs [m], and the factor of the scale.
    """
    best: tuple[int, float] | None = None
    kept: AnyArray = np.zeros(len(pcs), np.bool_)
    for three in _triples(pcs):
        factor, T = similarity(pcs[three], wcs[three], scaled=scaled)
        off = np.linalg.norm(T.apply(factor * pcs) - wcs, axis=1)
        near = off <= tolerance_m
        key = int(near.sum()), -float(np.minimum(off, tolerance_m).sum())
        if near[three].all() and (best is None or key > best):
            best, kept = key, near
    everyone: AnyArray = np.ones(len(pcs), np.bool_)
    factor, T = similarity(*(x[kept if best else everyone] for x in (pcs, wcs)), scaled=scaled)
    return kept, wcs - T.apply(factor * pcs), factor


def distances_words(names: Sequence[str], off_m: ArrayF) -> str:
    """Names with the lengths of their residuals (n, 3), the largest first."""
    length = np.linalg.norm(off_m, axis=1)
    return ", ".join(f"{names[k]} {length[k]:.2f} m" for k in np.argsort(-length, kind="stable"))


def _triples(places: ArrayF) -> list[AnyArray]:
    """Indices of triples that span a triangle; an even choice of them if there are very many."""
    n = len(places)
    if n <= _ALL_TRIPLES:
        every = np.array(list(combinations(range(n), 3)), dtype=np.int64).reshape(-1, 3)
    else:  # evenly over the places: neighbours give poor triples
        every = np.random.default_rng(n).random((_MOST_TRIPLES, n)).argpartition(3, axis=1)[:, :3]
    chosen = every[:: max(1, -(-len(every) // _MOST_TRIPLES))]
    three = places[chosen]
    size = np.linalg.svd(three - three.mean(axis=1, keepdims=True), compute_uv=False)
    return list(chosen[size[:, 1] > _LEAST_WIDTH_OF_TARGETS * size[:, 0]])


# ---------------------------------------------------------------- did the camera stay the same?
#
# A lens that is focused anew, a zoom that creeps or a sensor that is stabilised gives the later pictures
# another interior orientation. One bundle with one camera then bends the field, and its residuals hardly
# tell. So each place between two pictures is tried as the beginning of another camera constant and
# principal point: as extra unknowns of the finished adjustment (a score test, Rao 1948), which takes no new
# adjustment.


def camera_changes(problem: Problem, adjusted: Adjusted[State], layout: Layout) -> list[CameraChange]:
    """The most likely change of each camera with enough pictures.

    Parameters
    ----------
    problem, adjusted, layout : a finished adjustment; pictures in the order in which they were taken.
    """
    x, block, used = adjusted.x, problem.block, problem.used
    part = marks_model(problem, layout, x)
    image = block.image[used]
    weight = 1.0 / block.sigma_px[used]
    residual = part.residual.reshape(-1, 2) * weight[:, None]
    by_camera = _by_interior(problem, x) * weight[:, None, None]
    n = len(block.images)
    square, side = np.zeros((n, 3, 3)), np.zeros((n, 3))
    np.add.at(square, image, np.swapaxes(by_camera, 1, 2) @ by_camera)
    np.add.at(side, image, (np.swapaxes(by_camera, 1, 2) @ residual[:, :, None])[:, :, 0])
    rows = part.jacobian
    pairs = np.zeros((n, len(layout.names), 3))
    weights = np.repeat(weight, 2)
    for i in range(n):
        mine = np.repeat(image == i, 2)
        pairs[i] = rows[mine].T @ (by_camera[image == i].reshape(-1, 3) * weights[mine, None])
    found = []
    for k, camera in enumerate(x.cameras):
        mine = np.flatnonzero(problem.camera == k)
        if len(mine) < 2 * _LEAST_IMAGES:
            continue
        # all sums run over the pictures since the change, the last one first
        S, g, B = (np.cumsum(a[mine][::-1], axis=0)[::-1] for a in (square, side, pairs))
        change = _likeliest(S, g, B, adjusted, layout)
        if change is not None:
            at, values, sigmas, probability = change
            names = [block.images[i] for i in mine]
            moved = (adjusted.cov[layout.points :] @ (B[at] @ values)).ravel()
            sigma = float(np.sqrt(np.diag(adjusted.cov)[layout.points :].mean()))
            bend = root_mean_square(moved)
            found.append(
                CameraChange(
                    camera=camera.name,
                    before=names[at - 1],
                    since=names[at],
                    constant=float(values[0]),
                    sigma_constant=float(sigmas[0]),
                    shift_px=(float(values[1]), float(values[2])),
                    probability=probability,
                    bend_m=bend,
                    bend_sigmas=bend / sigma,
                )
            )
    return found


def require_steady(changes: list[CameraChange]) -> None:
    """Refuse a field that a changed camera has bent far beyond its sigmas.

    Raises
    ------
    GeometryError : names the camera and the pictures between which it changed.
    """
    for change in changes:
        if change.clear and change.bend_sigmas > _REFUSED:
            found, _, cure = change.words.partition(". Take out")
            raise GeometryError(
                found, expected="one focus and one zoom for all pictures of a camera", cure=f"Take out{cure}"
            )


def _likeliest(
    S: ArrayF, g: ArrayF, B: ArrayF, adjusted: Adjusted[State], layout: Layout
) -> tuple[int, ArrayF, ArrayF, float] | None:
    """First picture after the change; (3,) relative constant and principal point, sigmas; probability."""
    tried = range(_LEAST_IMAGES, len(S) - _LEAST_IMAGES + 1)
    best: tuple[float, int, ArrayF, ArrayF] | None = None
    for at in tried:
        left = S[at] - B[at].T @ adjusted.cov @ B[at]
        scale = np.sqrt(np.maximum(np.diag(S[at]), 1e-30))
        # what the adjustment already knows leaves nothing to tell
        if np.linalg.eigvalsh(left / np.outer(scale, scale))[0] < 1e-9:
            continue
        values = -np.linalg.solve(left, g[at])
        score = float(values @ left @ values)
        if best is None or score > best[0]:
            best = score, at, values, np.sqrt(np.diag(np.linalg.inv(left)))
    if best is None:
        return None
    score, at, values, sigmas = best
    return at, values, sigmas, min(1.0, float(chi2.sf(score, 3)) * len(tried))


def _by_interior(problem: Problem, x: State) -> ArrayF:
    """(m, 2, 3) derivatives of used marks by the relative camera constant and by the principal point."""
    image, point = problem.block.image[problem.used], problem.block.point[problem.used]
    camera = problem.camera[image]
    by_camera = collinear(x.cameras, camera, x.R[image], x.C[image], x.X[point]).by_camera
    constants = np.array([lens.parameters[:2] for lens in x.cameras])[camera]
    return np.concatenate([by_camera[:, :, :2] @ constants[:, :, None], by_camera[:, :, 2:4]], axis=2)
