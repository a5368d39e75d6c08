"""How well a rig of two lenses is calibrated, and whether its covariance says so: many rigs in one room.

Each seed is another device (lenses, base, tilt), another survey of the room's marks and other poses. Marks
have the noise that is measured in rendered pictures; the pictures themselves are left out, so that many seeds
are affordable. Errors are judged from both sides: as sizes, and as squares in units of the joint covariance.

The calibrated rig then takes part in a block of images between two banks, with one pose for each exposure;
beside it the same images of either lens alone. What the colours of a cloud are worth, and what is told of a
wrong clock or mount, is judged on scenes of `thalweg_lab.studies.sensors.colours`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.budgets import Budget, read_budget, totals_mm
from thalweg.calibration import LENSES, Rig, RigCalibration, calibrate_rig
from thalweg.core import ArrayF, Camera, Rigid, exp_rotation, rotation_vector
from thalweg.images.bundle import AdjustedBlock, Problem, adjust_block, pose_covariance, rig_frames
from thalweg.images.model import ControlMarks, ControlPoints, ImageBlock
from thalweg.settings.sections import BlockAdjustment, Rig as RigSettings
from thalweg_lab.dual_fisheye import TrueRig, room_marks, room_points, true_rig
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import TwinDualFisheye
from thalweg_lab.studies import Result, Seed, Study, Tables, band_of_squares
from thalweg_lab.studies.sensors.colours import colour_errors, colour_table

UNKNOWNS: Final = 22
"""Both interiors and the relative orientation."""
WIDEST_DEG: Final = 95.0
PANORAMA_PX: Final = 5376
"""Width of the panoramas of a Ricoh Theta V."""
BASE_MM: Final = 0.3
ANGLE_DEG: Final = 0.02
LENS_PX: Final = 0.1
SEAM_PX: Final = 1.0
SQUARES: Final = (0.7, 1.4)
"""Bounds of the figures, see `rig_table`."""
_CIRCLE_PX: Final = 2688
"""Side of an image circle of the Ricoh Theta V, whose stills have 5376 x 2688 pixels."""
_POINTS: Final = 2000
"""Points of which a perspective camera finds about as many in an image as 300 are in both image circles."""
EXPOSURES: Final = 12
"""Exposures of the block between two banks."""
_CONTROL: Final = 8
_SIGMA_CONTROL_M: Final = 0.01
_FOUND: Final = 0.5
"""Share of the points in view that are found in an image."""
_PLAIN: Final = BlockAdjustment(loss="none", correlated=False, reject_limit=100.0, interior_variance=1.0)
"""Marks err independently and as they are stated."""


def rig_rows(seed: Seed) -> Tables:
    """Errors of one calibrated rig.

    Parameters
    ----------
    seed : sizes ``exposures`` and ``sigma_px``.
    """
    true = true_rig(TwinDualFisheye(), seed.number)
    marks, _ = room_marks(
        true, seed.number, int(seed.sizes["exposures"]), sigma_px=float(seed.sizes["sigma_px"])
    )
    points, _ = room_points(seed.number, true.settings.sigma_field_m)
    found = calibrate_rig(marks, points, RigSettings())
    block = block_errors(true, found.rig, seed.number)
    return {
        "rigs": pd.DataFrame([{"seed": seed.number, **errors_of(found, true), **block}]),
        "colours": pd.DataFrame([{"seed": seed.number, **colour_errors(seed.number)}]),
        "cameras": cameras_beside(true, found.rig, seed.number),
    }


def errors_of(found: RigCalibration, true: TrueRig) -> dict[str, float]:
    """Errors of a calibrated rig: sizes, and squares in units of the joint covariance."""
    rig = found.rig
    pose = rig.T_back_front.error_from(true.T_back_front)
    error = np.concatenate(
        [*(rig.cameras[name].parameters - true.cameras[name].parameters for name in LENSES), pose]
    )
    sigma = rig.T_back_front.sigma_shift_m
    return {
        "base_mm": 1e3 * (rig.base_m - float(np.linalg.norm(true.T_back_front.shift_m))),
        "sigma_base_mm": 1e3 * float(sigma[2]),
        "rotation_deg": float(np.rad2deg(np.linalg.norm(pose[3:]))),
        "squares": float(error @ np.linalg.solve(found.cov, error)) / UNKNOWNS,
        "pose_squares": float(pose @ np.linalg.solve(rig.T_back_front.cov, pose)) / 6,
        "lens_px": max(lens_error_px(rig.cameras[name], true.cameras[name]) for name in LENSES),
        # ranges of a cloud err by far less than a twentieth
        "seam_depth_px": max(seam_px(rig, true, range_m, 1.05 * range_m) for range_m in (2.0, 5.0, 10.0)),
        "seam_far_px": seam_px(rig, true, 2.0, np.inf),
        "sigma0": float(found.report["sigma0"]),
    }


def lens_error_px(found: Camera, true: Camera) -> float:
    """Largest distance of the pixels of two interiors, up to an angle from the axis."""
    t, a = np.meshgrid(np.deg2rad(np.linspace(0, WIDEST_DEG, 96)), np.linspace(0, 2 * np.pi, 73))
    rays = np.stack([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)], axis=-1).reshape(-1, 3)
    return float(np.linalg.norm(found.project(rays) - true.project(rays), axis=1).max())


def seam_px(rig: Rig, true: TrueRig, range_m: float, taken_m: float) -> float:
    """How far both lenses show things beside each other at the seam of a panorama, rms of all azimuths.

    Parameters
    ----------
    rig : as it was calibrated, which makes the panorama.
    true : what took the picture.
    range_m, taken_m : true range from the middle of the rig, and that of the panorama.

    Returns
    -------
    shift : of things at right angles to the axis, pixels of a panorama of `PANORAMA_PX`.
    """
    azimuth = np.arange(72) * 2 * np.pi / 72
    things = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(72)], axis=1) * range_m
    shown = []
    for name, place in true.T_front_lens.items():
        seen = true.cameras[name].project((things + true.centre_front_m - place.shift_m) @ place.R)
        T = rig.T_front_lens[name]
        rays = rig.cameras[name].rays(seen) @ T.R.T
        # where the ray meets the sphere of the range about the middle of the calibrated rig
        origin = (T.shift_m - rig.centre_front_m) / taken_m
        along = rays @ origin
        shown.append(origin + (np.sqrt(along**2 - origin @ origin + 1) - along)[:, None] * rays)
    shift = np.linalg.norm(shown[0] - shown[1], axis=1)
    return float(np.sqrt(np.mean(shift**2))) * PANORAMA_PX / (2 * np.pi)


# ---------------------------------------------------------------- a block of images between two banks


@dataclass(frozen=True, slots=True)
class Lens:
    """A lens as it is and as it is calibrated, and its place in the camera that it belongs to."""

    true: Camera
    true_place: Rigid
    known: Camera
    place: Rigid


def lenses_of(true: TrueRig, rig: Rig) -> dict[str, Lens]:
    """The lenses of a rig, as it is and as it is calibrated."""
    return {
        name: Lens(true.cameras[name], true.T_front_lens[name], rig.cameras[name], rig.T_front_lens[name])
        for name in LENSES
    }


def two_cameras(seed: int) -> tuple[dict[str, Lens], Rig]:
    """Two cameras of 15.8 megapixels with lenses of 14 mm (C008) on chips 17.3 mm wide, back to back (FW29).

    Their relative orientation is calibrated to 0.2 mm and 0.01 degrees; the front camera counts alone, too.
    """
    rng, size, focal = generator(seed, "two cameras"), (4592, 3448), 14.0 / 17.3 * 4592
    parameters = np.array([focal, focal, size[0] / 2, size[1] / 2, -0.05, 0.02, 0.0, 0.0, 0.0])
    sigma = np.array([0.5, 0.5, 0.5, 0.5, 2e-4, 4e-4, 2e-5, 2e-5, 2e-4])
    true, known = {}, {}
    for name in LENSES:
        true[name] = Camera(model="perspective", size_px=size, parameters=parameters, name=name)
        wrong = parameters + sigma * rng.standard_normal(len(sigma))
        known[name] = true[name].with_parameters(wrong, np.diag(sigma**2))
    apart = Rigid(R=np.diag([-1.0, 1.0, -1.0]), shift_m=np.array([0.0, 0.0, -0.12]))
    sigma_apart = np.repeat([2e-4, np.deg2rad(0.01)], 3)
    found = apart.moved(sigma_apart * rng.standard_normal(6)).with_cov(np.diag(sigma_apart**2))
    rig = Rig(cameras=known, T_back_front=found, settings=RigSettings())
    places = {"front": Rigid(), "back": apart.inverse()}
    return {name: Lens(true[name], places[name], known[name], rig.T_front_lens[name]) for name in LENSES}, rig


def way_of(seed: int, exposures: int = EXPOSURES) -> list[Rigid]:
    """Poses of a camera that looks to one bank, 1.2 m apart."""
    t = np.arange(exposures)
    place = np.stack([1.2 * t, 2.0 * np.sin(t / 2.0), 0.9 + 0.05 * np.sin(t)], axis=1)
    level = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    turns = exp_rotation(generator(seed, "rig way").normal(0, [0.03, 0.03, 0.15], (exposures, 3)))
    return [Rigid(R=turn @ level, shift_m=at) for turn, at in zip(turns, place, strict=True)]


def simulated_block(
    lenses: Mapping[str, Lens],
    seed: int,
    *,
    rig: Rig | None = None,
    fronts: Sequence[Rigid] | None = None,
    points: int = 300,
    sigma_px: float = 0.3,
) -> tuple[Problem, list[Rigid]]:
    """Images of a camera on its way between two banks, and the true poses of its front lens.

    Marks reach to `WIDEST_DEG` and have independent errors; four control points on each bank are known to
    1 cm. Interiors and places of the lenses begin as they are calibrated; the true ones made the marks.

    Parameters
    ----------
    lenses : by name; the front lens looks to one bank.
    rig : calibration of the lenses, where they are two.
    fronts : true poses of the front lens on a way along a river; None: `way_of`.
    points : on both banks together; half as many in the bend ahead and astern as on each.
    sigma_px : noise of each coordinate of a mark.
    """
    rng = generator(seed, "rig block")
    fronts = way_of(seed) if fronts is None else list(fronts)
    exposures = len(fronts)
    place = np.array([T.shift_m for T in fronts])
    # the river lies along the way from its begin to its end
    ahead = (place[-1] - place[0])[:2]
    end = float(np.linalg.norm(ahead))
    (x, y), low = ahead / end, place[0] - [0.0, 0.0, 0.9]
    R = np.array([[x, -y, 0.0], [y, x, 0.0], [0.0, 0.0, 1.0]])
    wide = 7.0 + float(np.abs((place - low) @ R[:, 1]).max())
    n = points + _CONTROL
    up, along = rng.uniform(0, 5, n), rng.uniform(-12, end + 12, n)
    # below and above by turns on each bank: off the line, about which a block could turn
    along[points:], up[points:] = (
        np.linspace(0.0, end, _CONTROL),
        np.tile([0.3, 0.3, 4.5, 4.5], _CONTROL // 4),
    )
    across = np.where(np.arange(n) % 2, 1.0, -1.0) * (wide + 1.5 * up + rng.normal(0, 0.5, n))
    # where the river bends, ahead and astern, both lenses see the bank at their rims
    bend = np.arange(n) < points // 5
    along[bend] = np.where(rng.random(bend.sum()) < 0.5, -15.0, end + 15.0) + rng.normal(0, 2, bend.sum())
    across[bend] = rng.uniform(-wide, wide, bend.sum())
    X = np.stack([along, across, up], axis=1) @ R.T + low
    names: list[str] = []
    image, point, px = [], [], []
    for name, lens in lenses.items():
        for k, front in enumerate(fronts):
            local = (front @ lens.true_place).inverse().apply(X)
            xy = lens.true.project(local) + sigma_px * rng.standard_normal((n, 2))
            seen = local[:, 2] / np.linalg.norm(local, axis=1) > np.cos(np.deg2rad(WIDEST_DEG))
            rows = np.flatnonzero(seen & lens.true.inside(xy, 1.0) & (rng.random(n) < _FOUND))
            image.append(np.full(len(rows), len(names)))
            names.append(f"{name}/{k:03d}.jpg")
            point.append(rows)
            px.append(xy[rows])
    images, at, where = (np.concatenate(a) for a in (image, point, px))
    tie = at < points
    cameras = tuple(lens.known for lens in lenses.values())
    starts = [fronts[int(name[-7:-4])] @ lenses[name.split("/")[0]].place for name in names]
    C = np.array([T.shift_m for T in starts])
    problem = Problem(
        block=ImageBlock(
            cameras=cameras,
            images=tuple(names),
            camera=np.repeat(np.arange(len(lenses)), exposures),
            R_block_ccs=exp_rotation(rng.normal(0, 0.003, C.shape)) @ [T.R for T in starts],
            centre_block_m=C + rng.normal(0, 0.03, C.shape),
            points_block_m=X[:points] + rng.normal(0, 0.05, (points, 3)),
            mark_image=images[tie],
            mark_point=at[tie],
            mark_px=where[tie],
            sigma_px=np.full(int(tie.sum()), sigma_px),
        ),
        control=ControlPoints(
            names=tuple(f"P{k}" for k in range(_CONTROL)),
            points_wcs_m=X[points:] + _SIGMA_CONTROL_M * rng.standard_normal((_CONTROL, 3)),
            cov_wcs_m2=np.tile(_SIGMA_CONTROL_M**2 * np.eye(3), (_CONTROL, 1, 1)),
            check=np.zeros(_CONTROL, np.bool_),
        ),
        marks=ControlMarks(
            image=images[~tie],
            point=at[~tie] - points,
            xy_px=where[~tie],
            sigma_px=np.full(int((~tie).sum()), sigma_px),
        ),
        free=tuple(camera.parameter_names for camera in cameras),
        weighted=(True,) * len(cameras),
        held=np.zeros((exposures, 6), np.bool_),
        rig=None if rig is None else rig_frames(rig, names, cameras),
    )
    return problem, fronts


def one_lens(problem: Problem, lens: int) -> Problem:
    """The images of one lens of a rig alone, without the rig."""
    block = problem.block
    mine = block.camera == lens
    new = np.cumsum(mine) - 1
    tie, known = mine[block.mark_image], mine[problem.marks.image]
    marks = problem.marks.chosen(known)
    return replace(
        problem,
        block=replace(
            block,
            cameras=block.cameras[lens : lens + 1],
            images=tuple(np.array(block.images)[mine]),
            camera=np.zeros(int(mine.sum()), np.int64),
            R_block_ccs=block.R_block_ccs[mine],
            centre_block_m=block.centre_block_m[mine],
            mark_image=new[block.mark_image[tie]],
            mark_point=block.mark_point[tie],
            mark_px=block.mark_px[tie],
            sigma_px=block.sigma_px[tie],
        ),
        marks=replace(marks, image=new[marks.image]),
        free=problem.free[lens : lens + 1],
        weighted=problem.weighted[lens : lens + 1],
        rig=None,
    )


def plain_block(problem: Problem) -> AdjustedBlock:
    """Adjusted with sigmas that count as they are stated."""
    return adjust_block(problem, _PLAIN, scale_by_sigma0=False)


def block_errors(true: TrueRig, rig: Rig, seed: int) -> dict[str, float]:
    """Poses of a simulated block: their square in units of their covariance, and sigmas beside one lens."""
    problem, fronts = simulated_block(lenses_of(true, rig), seed, rig=rig)
    found = plain_block(problem)
    alone = [plain_block(one_lens(problem, lens)) for lens in range(len(LENSES))]
    ratio = pose_sigmas(found) / np.minimum(*(pose_sigmas(one) for one in alone))
    error, cov = pose_errors(found, fronts), pose_covariance(found)
    return {
        "block_squares": float(error @ np.linalg.solve(cov, error)) / len(error),
        "position_ratio": float(ratio[:, 0].mean()),
        "position_ratio_largest": float(ratio[:, 0].max()),
        "rotation_ratio": float(ratio[:, 1].mean()),
        "rotation_ratio_largest": float(ratio[:, 1].max()),
    }


def cameras_beside(true: TrueRig, rig: Rig, seed: int) -> pd.DataFrame:
    """Sigmas of poses by a panorama camera of twice 8 megapixels, by a perspective one and by two of these.

    All go the same way, and each lens has about as many marks in an exposure, with 0.3 px: what differs is
    the angle of a pixel, and which banks are seen. Columns ``seed, camera, sigma_m, sigma_rad, marks``.
    """
    finer = _CIRCLE_PX / true.settings.circle_px
    lenses, apart = two_cameras(seed)
    both = {
        "panorama": simulated_block(lenses_of(true, rig), seed, rig=rig, points=300, sigma_px=0.3 / finer)[0],
        "perspective": simulated_block({"front": lenses["front"]}, seed, points=_POINTS)[0],
        "two perspective": simulated_block(lenses, seed, rig=apart, points=_POINTS)[0],
    }
    rows = []
    for name, problem in both.items():
        sigma = np.sqrt(np.mean(np.square(pose_sigmas(plain_block(problem))), axis=0))
        marks = len(problem.block.mark_image) / EXPOSURES
        rows.append((seed, name, *sigma.tolist(), marks))
    return pd.DataFrame(rows, columns=["seed", "camera", "sigma_m", "sigma_rad", "marks"])


def camera_table(rows: pd.DataFrame, budget: Budget) -> pd.DataFrame:
    """What the poses of each camera make of a published budget: mm by part at each distance, RMSE of a point.

    Parameters
    ----------
    rows : of all seeds, see `cameras_beside`.
    budget : of P2 Table 1; its poses are replaced, everything else stays.

    Returns
    -------
    camera, distance_m, sigma_m, sigma_deg, poses_mm, rmse_mm, marks, seeds.
    """
    out = []
    for camera, mine in rows.groupby("camera", sort=False):
        sigma_m, sigma_rad = np.sqrt((mine[["sigma_m", "sigma_rad"]] ** 2).mean())
        of = {"position": (1e3 * sigma_m, "mm"), "attitude": (np.rad2deg(sigma_rad), "deg")}
        own, alone = [], []
        for item in budget.inputs:
            sigma, unit = of.get(budget.group(item), (item.sigma, item.unit))
            own.append(replace(item, sigma=sigma, unit=unit))
            alone.append(replace(own[-1], sigma=sigma if budget.group(item) in of else 0.0))
        distances = np.asarray(budget.distances_m)
        for d, whole, poses in zip(
            distances,
            totals_mm(replace(budget, inputs=tuple(own)), distances),
            totals_mm(replace(budget, inputs=tuple(alone)), distances),
            strict=True,
        ):
            out.append(
                (camera, d, sigma_m, np.rad2deg(sigma_rad), poses, whole, mine["marks"].mean(), len(mine))
            )
    names = ["camera", "distance_m", "sigma_m", "sigma_deg", "poses_mm", "rmse_mm", "marks", "seeds"]
    return pd.DataFrame(out, columns=names)


def pose_errors(found: AdjustedBlock, fronts: Sequence[Rigid]) -> ArrayF:
    """(6 f,) errors that move the poses of the exposures to the true ones."""
    R, C = found.layout.poses(found.x)
    true = [fronts[int(name[-7:-4])] for name in found.layout.exposures]
    shift = np.array([T.shift_m for T in true]) - C - found.origin_m
    turn = rotation_vector(np.array([T.R for T in true]) @ np.swapaxes(R, 1, 2))
    return np.concatenate([shift, turn], axis=1).ravel()


def pose_sigmas(found: AdjustedBlock) -> ArrayF:
    """(f, 2) standard deviations of position, m, and of rotation, rad: roots of the mean variances."""
    variance = np.diag(pose_covariance(found)).reshape(-1, 2, 3)
    return np.asarray(np.sqrt(variance.mean(axis=2)))


def rig_table(rows: pd.DataFrame) -> pd.DataFrame:
    """Figures over all seeds with their bounds: measure, value, low, high, seeds."""
    n = len(rows)

    def band(k: int) -> tuple[float, float]:
        """Of a mean square of that many numbers, at 99 %, and not wider than `SQUARES`."""
        low, high = band_of_squares(k * n, 0.01)
        return max(low, SQUARES[0]), min(high, SQUARES[1])

    def size(values: ArrayF) -> float:
        """Root mean square."""
        return float(np.sqrt(np.mean(np.square(values))))

    base, turn = rows["base_mm"].to_numpy(), rows["rotation_deg"].to_numpy()
    figures: list[tuple[str, float, float, float]] = [
        ("base, rms error, mm", size(base), 0.0, BASE_MM),
        ("base, largest error, mm", float(np.abs(base).max()), 0.0, BASE_MM),
        ("base, mean of the stated sigmas, mm", float(rows["sigma_base_mm"].mean()), 0.0, BASE_MM),
        ("relative rotation, rms error, deg", size(turn), 0.0, ANGLE_DEG),
        ("relative rotation, largest error, deg", float(turn.max()), 0.0, ANGLE_DEG),
        ("interiors to 95 degrees, largest error, px", float(rows["lens_px"].max()), 0.0, LENS_PX),
        ("seam at 2 to 10 m, ranges 5 % wrong, largest rms, px", rows["seam_depth_px"].max(), 0.0, SEAM_PX),
        ("seam at 2 m, all taken to be far, mean rms, px", rows["seam_far_px"].mean(), 8.0, 8.6),
        ("NEES, all 22 unknowns", float(rows["squares"].mean()), *band(UNKNOWNS)),
        ("NEES, relative orientation", float(rows["pose_squares"].mean()), *band(6)),
        ("NEES, poses of exposures in a block", float(rows["block_squares"].mean()), *band(6 * EXPOSURES)),
        *(
            (f"{what} sigma of a pose over that of the better lens alone, {which}", value, 0.0, 1.0)
            for what in ("position", "rotation")
            for which, value in (
                ("mean", float(rows[f"{what}_ratio"].mean())),
                ("largest", float(rows[f"{what}_ratio_largest"].max())),
            )
        ),
    ]
    return pd.DataFrame(
        [(*figure, n) for figure in figures], columns=["measure", "value", "low", "high", "seeds"]
    )


def _results(tables: Tables, files: Sequence[Path]) -> Mapping[str, Result]:
    return {
        "table": pd.concat([rig_table(tables["rigs"]), colour_table(tables["colours"])], ignore_index=True),
        "rigs": tables["rigs"],
        "cameras": camera_table(tables["cameras"], read_budget(files[0])),
    }


STUDY: Final = Study(rows=rig_rows, results=_results)
