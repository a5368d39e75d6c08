"""Blocks of marker observations for tests: a yard of sheets, cameras around it, marks with known errors."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from thalweg.calibration import MarkerLayout, block_of
from thalweg.calibration.field import FieldDescription, FieldPoints, Layout, Problem, State, start_state
from thalweg.calibration.field.description import ScaleBar, Target
from thalweg.calibration.markers import Block
from thalweg.core import ArrayF, Camera, LocalFrame, Rigid, exp_rotation

SLR = Camera(
    model="perspective",
    size_px=(6000, 4000),
    parameters=np.array([3010.0, 3008.0, 3012.0, 1985.0, -0.08, 0.06, 2e-4, -3e-4, -0.01]),
    name="slr",
)
NOMINAL = SLR.with_parameters(np.array([3080.0, 3080.0, 3000.0, 2000.0, 0, 0, 0, 0, 0]))
FISHEYE = Camera(
    model="fisheye",
    size_px=(3840, 3840),
    parameters=np.array([1150.0, 1151.0, 1925.0, 1915.0, -0.02, 0.004, -0.001, 1e-4]),
    name="fisheye",
)


@dataclass
class Sheet:
    """A sheet: four saddles (4, 3) in the yard and its outward normal."""

    marker: int
    saddles: np.ndarray
    normal: np.ndarray


def sheet(marker: int, centre: np.ndarray, normal: np.ndarray, layout: MarkerLayout, rng) -> Sheet:
    n = normal / np.linalg.norm(normal)
    side = np.cross([0.0, 0.0, 1.0], n)
    side = side / np.linalg.norm(side) if np.linalg.norm(side) > 0.1 else np.array([1.0, 0.0, 0.0])
    flat = layout.saddles_m(marker)
    # sheets are printed with a scale error and put on askew and slightly bent
    flat = flat * 1.004 + np.array([0, 0, 1.0]) * rng.normal(0, 0.002, (4, 1))
    R = np.column_stack([side, np.cross(n, side), n]) @ exp_rotation([0, 0, rng.normal(0, 0.1)])
    return Sheet(marker, centre + flat @ R.T, n)


def yard(
    seed: int, cones: int = 8, per_cone: int = 8, flat: int = 12
) -> tuple[list[Sheet], FieldDescription]:
    rng = np.random.default_rng([seed, 1])
    layout = MarkerLayout(sizes=((60, 99, 0.016),) if per_cone * cones <= 60 else ())
    sheets, marker = [], 0
    for k in range(cones):
        angle = 2 * np.pi * (k + rng.uniform(-0.2, 0.2)) / cones
        foot = rng.uniform(3.5, 6.5) * np.array([np.cos(angle), np.sin(angle), 0.0])
        foot[2] = rng.uniform(0.3, 2.0)
        for j in range(per_cone):
            turn = 2 * np.pi * j / per_cone
            n = np.array([np.cos(turn), np.sin(turn), 0.3])
            sheets.append(sheet(marker, foot + 0.2 * n + [0, 0, 0.12 * (j % 2)], n, layout, rng))
            marker += 1
    marker = max(marker, 80)
    for k in range(flat):
        # in pairs, the ends of bars of 1.5 m, all seen from outside
        angle = 2 * np.pi * (k // 2) / (flat // 2) + 0.3
        out, along = (
            np.array([np.cos(angle), np.sin(angle), 0.0]),
            np.array([-np.sin(angle), np.cos(angle), 0.0]),
        )
        place = rng.uniform(2.0, 4.0) * out + (0.75 if k % 2 else -0.75) * along
        sheets.append(
            sheet(
                marker + k,
                place + np.array([0, 0, rng.uniform(0.2, 1.5)]),
                out + np.array([0, 0, 0.5]),
                layout,
                rng,
            )
        )
    at = {s.marker: s for s in sheets}
    bars = []
    for b in range(3):
        first, second = at[marker + 2 * b], at[marker + 2 * b + 1]
        length = float(np.linalg.norm(first.saddles[0] - second.saddles[2]))
        bars.append(
            ScaleBar(
                name=f"S{b + 1}",
                start=f"{first.marker}/0",
                end=f"{second.marker}/2",
                length_m=length + rng.normal(0, 3e-5),
                sigma_m=3e-5,
            )
        )
    return sheets, FieldDescription(layout=layout, scale_bars=tuple(bars))


def look(place: np.ndarray, target: np.ndarray, roll: float = 0.0) -> Rigid:
    z = target - place
    z = z / np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x = x / np.linalg.norm(x)
    return Rigid(R=np.column_stack([x, np.cross(z, x), z]) @ exp_rotation([0, 0, roll]), shift_m=place)


def stations(seed: int, n: int = 36, radius: float = 8.5) -> dict[str, Rigid]:
    rng = np.random.default_rng([seed, 2])
    poses = {}
    for k in range(n):
        angle = 2 * np.pi * k / n
        place = radius * rng.uniform(0.9, 1.1) * np.array([np.cos(angle), np.sin(angle), 0.0])
        place[2] = (1.3, 2.4)[k % 2]
        roll = (0.0, np.pi / 2)[k % 5 == 0]
        poses[f"IMG_{k:04d}.jpg"] = look(place, rng.normal(0, 0.5, 3) + np.array([0, 0, 0.8]), roll)
    return poses


def observe(
    sheets: list[Sheet],
    poses: dict[str, Rigid],
    camera: Camera,
    seed: int,
    *,
    sigma_px: float = 0.05,
    wrong: float = 0.0,
    largest_angle_deg: float = 65.0,
) -> pd.DataFrame:
    """Marks of all pictures; a share is wrong by 1 to 50 pixels."""
    rng = np.random.default_rng([seed, 3])
    rows = []
    limit = np.cos(np.radians(largest_angle_deg))
    for image, pose in poses.items():
        for s in sheets:
            view = pose.shift_m - s.saddles.mean(axis=0)
            if s.normal @ view / np.linalg.norm(view) < limit:
                continue
            xy = camera.project(pose.inverse().apply(s.saddles))
            if not np.isfinite(xy).all() or not camera.inside(xy, 20.0).all():
                continue
            local = np.linalg.norm(xy - np.roll(xy, 1, axis=0), axis=1).mean()
            if local < 8 * 2.5:
                continue
            for corner in range(4):
                error = rng.normal(0, sigma_px, 2)
                if rng.random() < wrong:
                    turn = rng.uniform(0, 2 * np.pi)
                    error += np.exp(rng.uniform(0, np.log(50))) * np.array([np.cos(turn), np.sin(turn)])
                x, y = xy[corner] + error
                rows.append((image, camera.name, s.marker, corner, x, y, sigma_px, local))
    return pd.DataFrame(
        rows, columns=["image", "camera", "marker", "corner", "x_px", "y_px", "sigma_px", "size_px"]
    )


def truth_of(sheets: list[Sheet], points: tuple[tuple[int, int], ...]) -> np.ndarray:
    at = {s.marker: s for s in sheets}
    return np.array([at[m].saddles[c] for m, c in points])


def field_of(sheets: list[Sheet], root: np.ndarray, error: np.ndarray) -> FieldPoints:
    """All saddles of sheets with errors (3n,) and the covariance ``root root^T``."""
    names = tuple((s.marker, c) for s in sheets for c in range(4))
    places = truth_of(sheets, names) + error.reshape(-1, 3)
    return FieldPoints(points=names, points_pcs=places, cov=root @ root.T)


def similarity(a: np.ndarray, b: np.ndarray, scale: bool = True) -> tuple[float, np.ndarray, np.ndarray]:
    """``b = s R a + t`` by least squares."""
    da, db = a - a.mean(axis=0), b - b.mean(axis=0)
    U, _, Vt = np.linalg.svd(db.T @ da)
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    s = float(np.trace(R @ da.T @ db) / (da**2).sum()) if scale else 1.0
    return s, R, b.mean(axis=0) - s * R @ a.mean(axis=0)


def rtk_targets(sheets: list[Sheet], markers: list[int]) -> dict[int, np.ndarray]:
    return {s.marker: s.saddles.mean(axis=0) for s in sheets if s.marker in markers}


FRAME = LocalFrame(lat_deg=51.028, lon_deg=13.721, h_ell_m=160.0)
PLACE = Rigid(R=exp_rotation([0, 0, 0.7]), shift_m=np.array([30.0, -20.0, 1.0]))
RTK_M = (0.008, 0.008, 0.012)


def targets(markers: list[int], places_wcs_m: np.ndarray) -> tuple[Target, ...]:
    """Targets T1, T2 ... at places in the world."""
    lat, lon, h = FRAME.to_geodetic(places_wcs_m)
    return tuple(
        Target(name=f"T{k + 1}", marker=m, lat_deg=lat[k], lon_deg=lon[k], h_ell_m=h[k], sigma_m=RTK_M)
        for k, m in enumerate(markers)
    )


def targets_on(sheets: list[Sheet], markers: list[int]) -> tuple[Target, ...]:
    """Targets of sheets of a yard that stands at `PLACE`."""
    centres = rtk_targets(sheets, markers)
    return targets(list(centres), PLACE.apply(np.array(list(centres.values()))))


def of_slr(block: Block, used: ArrayF | None = None, free: tuple[str, ...] = ()) -> Problem:
    """The adjustment of marks of one camera."""
    used = np.ones(len(block.image), bool) if used is None else used
    return Problem(block, np.zeros(len(block.images), int), used, (free,))


def true_block(
    sheets: list[Sheet], poses: dict[str, Rigid], marks: pd.DataFrame, free: tuple[str, ...] = ()
) -> tuple[Problem, State, Layout]:
    """Marks of the true camera, and the true poses and points."""
    block = block_of(marks, {"slr": SLR})
    at = {i: poses[name] for i, name in enumerate(block.images)}
    x = start_state(block.images, (SLR,), at, truth_of(sheets, block.points))
    problem = of_slr(block, free=free)
    return problem, x, Layout(problem, x.cameras)
