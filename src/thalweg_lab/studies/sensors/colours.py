"""Scenes whose colours are known, for the colours of a cloud and for the check of clock and mount by them.

A boat passes a wall with a pattern that lidar and camera both see; three cameras look at a red board before a
blue one, which tells every hidden point; and a rig of two lenses colours a reach of the twin's river.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
import pandas as pd
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation

from thalweg.calibration import Rig
from thalweg.core import (
    AnyArray,
    ArrayB,
    ArrayF,
    Camera,
    LazWriter,
    LocalFrame,
    Rigid,
    exp_rotation,
    iter_laz,
)
from thalweg.images.model import ImagePoses
from thalweg.lidar import EXTRA_DIMENSIONS, Photographs, check_colours, colour_cloud
from thalweg.panorama import rig_photographs, sphere_rays
from thalweg.settings.sections import Colour, Rig as RigSettings
from thalweg_lab.dual_fisheye import simulate_dual_fisheye, true_rig
from thalweg_lab.random_numbers import generator
from thalweg_lab.river import Scene, simulate_scene
from thalweg_lab.settings import TwinConfig, TwinDualFisheye
from thalweg_lab.truth import judge_colours
from thalweg_lab.voyage import write_true_mounts

FRAME: Final = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=200.0)
SIZE_PX: Final = (320, 240)
FOCAL_PX: Final = 300.0
CAMERA: Final = Camera(
    model="perspective",
    size_px=SIZE_PX,
    parameters=np.array([FOCAL_PX, FOCAL_PX, SIZE_PX[0] / 2, SIZE_PX[1] / 2, 0, 0, 0, 0, 0]),
    cov=np.zeros((9, 9)),
)
WALL_M: Final = 8.0
SPEED_M_S: Final = 1.2
START_S: Final = 1e9
EAST: Final = np.column_stack([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Camera that looks north: its axes right, down, ahead in the world."""
RED, BLUE = (200, 40, 40), (40, 40, 200)
PLACES_M: Final = (-0.6, 0.0, 0.6)
LATE_S: Final = 0.3
TURN_DEG: Final = 1.0
"""What is wrong in two of three passages of a seed."""
ATTITUDES_DEG: Final = (0.05, 0.1)
"""Errors of the attitude about each axis: as all sensors together leave them in the tiny twin (0.03 to 0.05),
and as a block on the positions of one antenna does (0.05 to 0.11)."""
SIGMA_M: Final = 0.02
"""Errors of poses and points of a reach of a river."""
_REACH_M: Final = 40.0
_POINTS: Final = 60_000


def image_names(n: int) -> tuple[str, ...]:
    """Names of so many photographs of a scene."""
    return tuple(f"image_{k}.png" for k in range(n))


def poses_of(centre_m: ArrayF, R: ArrayF, t_gps_s: AnyArray, frame: LocalFrame = FRAME) -> ImagePoses:
    """Poses (n, 3), (n, 3, 3) of `image_names`, known to 1 mm and 1 mrad."""
    n = len(centre_m)
    return ImagePoses(
        frame=frame,
        images=image_names(n),
        t_gps_s=np.asarray(t_gps_s, dtype=np.float64),
        sigma_t_s=np.zeros(n),
        oriented=np.ones(n, dtype=np.bool_),
        reasons=("",) * n,
        centre_wcs_m=centre_m,
        R_wcs_ccs=R,
        cov_pose_wcs=np.tile(1e-6 * np.eye(6), (n, 1, 1)),
        cov_next=np.zeros((n, 6, 6)),
        n_marks=np.full(n, 100.0),
        rms_px=np.full(n, 0.3),
    )


def save_cloud(path: Path, xyz_m: ArrayF, t_gps_s: ArrayF, intensity: AnyArray) -> None:
    """A cloud (n, 3) as `thalweg.lidar.georeference_log` writes it, with sigmas of 1 cm."""
    n = len(xyz_m)
    with LazWriter(path, FRAME, extra_dimensions=EXTRA_DIMENSIONS) as writer:
        writer.append(
            xyz_m,
            t_gps_s=t_gps_s,
            intensity=np.clip(intensity, 0, 65535).astype(np.uint16),
            return_number=np.ones(n, np.uint8),
            number_of_returns=np.ones(n, np.uint8),
            extra={name: np.full(n, 0.01) for name in EXTRA_DIMENSIONS} | {"ring": np.arange(n) % 16},
        )


# ---------------------------------------------------------------- a wall with a pattern


def pattern(rng: np.random.Generator) -> ArrayF:
    """Blotches of some 0.3 m on a wall of 40 m x 12 m, a pixel each 2 cm, from -1 to 1."""
    return np.asarray(np.tanh(8 * gaussian_filter(rng.normal(size=(600, 2000)), 12) / 0.12))


def on_wall(look: ArrayF, x_m: ArrayF, z_m: ArrayF) -> ArrayF:
    """The pattern at places of the wall."""
    return np.asarray(map_coordinates(look, [(z_m + 6) / 0.02, (x_m + 10) / 0.02], order=1, mode="nearest"))


def check_passage(
    folder: Path, rng: np.random.Generator, *, late_s: float = 0.0, turn_deg: float = 0.0
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The check of a passage along the wall, its photographs later, and turned about y, by so much.

    The lidar sees the pattern inverted and in noise, the camera under another exposure each time.

    Returns
    -------
    As of `thalweg.lidar.check_colours`, the table by ``quantity``.
    """
    look, n, (width, height) = pattern(rng), 16, SIZE_PX
    t = START_S + np.arange(n) * 0.8
    way = np.column_stack([SPEED_M_S * (t - START_S), np.zeros((n, 2))])
    v, u = np.mgrid[0:height, 0:width] + 0.5
    rays = np.stack([(u - width / 2) / FOCAL_PX, (v - height / 2) / FOCAL_PX, np.ones_like(u)], axis=-1)
    turned = EAST @ Rotation.from_rotvec([0, np.deg2rad(turn_deg), 0]).as_matrix()
    for name, at in zip(image_names(n), way, strict=True):
        world = rays @ turned.T
        place = world * (WALL_M / world[..., 1:2])
        seen = on_wall(look, place[..., 0] + at[0] + SPEED_M_S * late_s, place[..., 2])
        grey = np.clip(rng.uniform(0.7, 1.2) * (120 + 40 * seen) + rng.normal(0, 4, seen.shape), 0, 255)
        Image.fromarray(grey.astype(np.uint8)).convert("RGB").save(folder / name, compress_level=1)
    x, z = rng.uniform(-4, 22, 60_000), rng.uniform(-3, 3, 60_000)
    order = np.argsort(x)
    xyz = np.column_stack([x, np.full(len(x), WALL_M), z])[order]
    intensity = 20_000 - 6000 * on_wall(look, xyz[:, 0], xyz[:, 2]) + rng.normal(0, 3000, len(x))
    save_cloud(folder / "points.laz", xyz, START_S + np.linspace(0, 12, len(x)), intensity)
    table, curves = check_colours(
        folder / "points.laz",
        poses_of(way, np.tile(EAST, (n, 1, 1)), t),
        {name: folder / name for name in image_names(n)},
        {},
        CAMERA,
        Colour(),
    )
    return table.set_index("quantity"), curves


# ---------------------------------------------------------------- a board before another


@dataclass(frozen=True)
class Boards:
    """A red board before a blue one: distances, half the width of the red one and its middle, in metres."""

    near_m: float = 3.0
    far_m: float = 5.0
    half_m: float = 0.4
    middle_m: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Boards":
        """Others by chance."""
        near, half = rng.uniform(2.5, 3.5), rng.uniform(0.25, 0.45)
        x, y = rng.uniform(-0.3, 0.3, 2).tolist()
        return cls(near_m=near, far_m=near + rng.uniform(0.8, 2.5), half_m=half, middle_m=(x, y))

    def in_front(self, xy: ArrayF) -> ArrayB:
        """Whether places (n, 2) in the plane of the red board lie on it."""
        return np.asarray(np.all(np.abs(xy - self.middle_m) <= self.half_m, axis=1))

    def points(self) -> tuple[ArrayF, ArrayB]:
        """Points (n, 3) on both boards, and which are red."""
        at = np.arange(0.01 - self.half_m, self.half_m, 0.02)
        near = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2) + self.middle_m
        far = np.stack(np.meshgrid(*[np.arange(-1.4, 1.4, 0.02)] * 2), axis=-1).reshape(-1, 2)
        depth = np.repeat([self.near_m, self.far_m], [len(near), len(far)])
        return np.column_stack([np.vstack([near, far]), depth]), np.arange(len(depth)) < len(near)

    def visible(self, xyz: ArrayF) -> ArrayB:
        """Points (n, 3) of the blue board that some camera sees past the red one."""
        seen = np.zeros(len(xyz), dtype=np.bool_)
        half = np.array(SIZE_PX) / 2 / FOCAL_PX
        for place in PLACES_M:
            ray = (xyz - [place, 0.0, 0.0])[:, :2] / xyz[:, 2:]
            inside = (np.abs(ray) < half).all(axis=1)
            seen |= inside & ~self.in_front(np.array([place, 0.0]) + self.near_m * ray)
        return seen

    def record(self, folder: Path, noise_m: ArrayF | float = 0.0) -> None:
        """Photographs by casting the ray of each pixel, and the cloud of both boards with errors (n, 3)."""
        width, height = SIZE_PX
        y, x = np.mgrid[0:height, 0:width] + 0.5
        rays = np.stack([(x.ravel() - width / 2) / FOCAL_PX, (y.ravel() - height / 2) / FOCAL_PX], axis=1)
        for name, place in zip(image_names(len(PLACES_M)), PLACES_M, strict=True):
            red = self.in_front(np.array([place, 0.0]) + self.near_m * rays)
            colour = np.where(red[:, None], RED, BLUE).astype(np.uint8)
            Image.fromarray(colour.reshape(height, width, 3)).save(folder / name)
        xyz = self.points()[0] + noise_m
        save_cloud(folder / "points.laz", xyz, START_S + np.linspace(0, 2, len(xyz)), np.arange(len(xyz)))


def board_poses(frame: LocalFrame = FRAME) -> ImagePoses:
    """Poses of the cameras before the boards; the axes of the world are those of the cameras."""
    n = len(PLACES_M)
    centre = np.column_stack([PLACES_M, np.zeros((n, 2))])
    return poses_of(centre, np.tile(np.eye(3), (n, 1, 1)), START_S + np.arange(n), frame)


def hidden_points(folder: Path, pair: Boards, noise_m: ArrayF, *, occlusion: bool) -> tuple[float, float]:
    """Share of blue points with a colour that is red, and share of visible blue points with a colour."""
    xyz, red = pair.points()
    pair.record(folder, noise_m)
    images = {name: folder / name for name in image_names(len(PLACES_M))}
    cameras = Photographs(poses=board_poses(), images=images, masks={}, camera=CAMERA)
    out = folder / "coloured.laz"
    colour_cloud(folder / "points.laz", out, [cameras], Colour(), occlusion=occlusion)
    cloud = next(iter_laz(out))
    has = cloud["n_views"] > 0
    wrong = (cloud["rgb"][:, 0] > cloud["rgb"][:, 2]) & ~red & has
    return float(wrong.sum() / (has & ~red).sum()), float(has[~red & pair.visible(xyz)].mean())


# ---------------------------------------------------------------- a reach of a river


def river_colours(folder: Path, seed: int) -> dict[float, tuple[float, float]]:
    """Colours of a reach by five files of a rig: median errors of a point, and of one free of shade, of 255.

    Points are those that are truly seen from the middle of the rig, with errors of `SIGMA_M`; the poses of
    all files err in common, as those of a block do: by `SIGMA_M`, and about each axis by `ATTITUDES_DEG`.
    """
    rng, config = generator(seed, "river colours"), TwinConfig.of_size("tiny")
    settings = TwinDualFisheye(images=5)
    rig = RigSettings.model_validate(
        {"mount": {"omega_deg": -90.0, "kappa_deg": 180.0, "lever_ics_m": [-0.25, 0.1, -0.9]}}
    )
    simulate_scene(config, seed, folder / "scene.npz")
    write_true_mounts(folder / "mounts.json", {}, {})
    simulate_dual_fisheye(
        config,
        settings,
        seed,
        FRAME,
        folder / "scene.npz",
        folder / "mounts.json",
        rig,
        {"seed": seed, "settings": settings.model_dump()},
        images=folder / "rig",
        poses=folder / "poses.parquet",
        panorama=folder / "panorama.npz",
        truth=folder / "rig.json",
    )
    with np.load(folder / "panorama.npz") as stored:
        range_m, T = stored["range_m"].astype(np.float64), Rigid.from_matrix(stored["T_wcs_pano"])
    rays = sphere_rays(range_m.shape[1])
    near = np.flatnonzero((range_m < _REACH_M).ravel())
    some = np.sort(rng.choice(near, min(_POINTS, len(near)), replace=False))
    xyz = T.apply(rays.reshape(-1, 3)[some] * range_m.ravel()[some, None])
    dry = xyz[:, 2] > Scene.read(folder / "scene.npz").water_level_m
    xyz = xyz[dry] + SIGMA_M * rng.standard_normal((int(dry.sum()), 3))
    true = ImagePoses.read(folder / "poses.parquet")
    save_cloud(folder / "river.laz", xyz, np.full(len(xyz), true.t_gps_s.mean()), np.arange(len(xyz)))
    device, turn, shift = true_rig(settings, seed), rng.standard_normal(3), rng.standard_normal(3)
    known = Rig(
        cameras=device.cameras, T_back_front=device.T_back_front.with_cov(np.zeros((6, 6))), settings=rig
    )
    files = {name: folder / "rig" / name for name in true.images}
    errors = {}
    for attitude_deg in ATTITUDES_DEG:
        sigma = np.repeat([SIGMA_M, np.deg2rad(attitude_deg)], 3)
        placed = replace(
            true,
            centre_wcs_m=true.centre_wcs_m + SIGMA_M * shift,
            R_wcs_ccs=true.R_wcs_ccs @ exp_rotation(np.deg2rad(attitude_deg) * turn),
            cov_pose_wcs=np.tile(np.diag(sigma**2), (len(true.images), 1, 1)),
        )
        out = folder / "coloured.laz"
        colour_cloud(folder / "river.laz", out, rig_photographs(files, placed, known), Colour())
        found = {name: value for name, value, _ in judge_colours(out, folder / "panorama.npz")}
        point, free = (
            found[f"colours: median error of {kind}, of 255"] for kind in ("a point", "a point free of shade")
        )
        errors[attitude_deg] = point, free
    return errors


# ---------------------------------------------------------------- what a study takes


def colour_errors(seed: int) -> dict[str, float]:
    """What colours and their check make of the scenes of a seed; `told`: 1 if it was warned of, else 0."""
    found: dict[str, float] = {}
    with TemporaryDirectory() as name:
        folder = Path(name)
        for case, kind, true, wrong in (
            ("right", "", 0.0, {}),
            ("clock", "clock_s", LATE_S, {"late_s": LATE_S}),
            ("mount", "turn_y_deg", TURN_DEG, {"turn_deg": TURN_DEG}),
        ):
            table, _ = check_passage(folder, generator(seed, f"wall {case}"), **wrong)
            if not kind:
                found["right_told"] = float((table["verdict"] != "fits").any())
                continue
            row: dict[Any, Any] = table.loc[kind].to_dict()
            found[f"{case}_error"] = row["optimum"] - true
            found[f"{case}_told"] = float(row["verdict"] == "shifted")
        rng = generator(seed, "boards")
        pair = Boards.draw(rng)
        noise = 0.01 * rng.standard_normal(pair.points()[0].shape)
        found["wrong"], found["shown"] = hidden_points(folder, pair, noise, occlusion=True)
        found["wrong_blind"], _ = hidden_points(folder, pair, noise, occlusion=False)
        for attitude_deg, (point, free) in river_colours(folder, seed).items():
            found[f"colour_{attitude_deg}"], found[f"free_{attitude_deg}"] = point, free
    return found


def colour_table(rows: pd.DataFrame) -> pd.DataFrame:
    """Figures over all seeds with their bounds: measure, value, low, high, seeds."""
    clock, mount = (rows[f"{case}_error"].abs().max() for case in ("clock", "mount"))
    figures = [
        (
            "colours free of shade, attitude to 0.05 degrees: mean of medians, of 255",
            "free_0.05",
            "mean",
            0,
            6,
        ),
        (
            "colours free of shade, attitude to 0.05 degrees: largest median, of 255",
            "free_0.05",
            "max",
            0,
            255,
        ),
        (
            "colours of all points, attitude to 0.05 degrees: mean of medians, of 255",
            "colour_0.05",
            "mean",
            0,
            6,
        ),
        (
            "colours free of shade, attitude to 0.1 degrees: mean of medians, of 255",
            "free_0.1",
            "mean",
            0,
            255,
        ),
        ("hidden points: largest share with a colour of what hides them", "wrong", "max", 0, 0.01),
        ("hidden points without the test: mean share with a wrong colour", "wrong_blind", "mean", 0.05, 1),
        ("visible points: mean share with a colour", "shown", "mean", 0.97, 1),
        ("visible points: smallest share with a colour", "shown", "min", 0, 1),
        ("clock and mount right: share of scenes with a warning", "right_told", "mean", 0, 0),
        ("clock 0.3 s wrong: share of scenes that tell", "clock_told", "mean", 1, 1),
        ("mount 1 degree wrong: share of scenes that tell", "mount_told", "mean", 1, 1),
    ]
    found = [(name, float(rows[key].agg(how)), low, high) for name, key, how, low, high in figures]
    found += [
        ("clock 0.3 s wrong: largest error of what is found, s", clock, 0, 0.05),
        ("mount 1 degree wrong: largest error of what is found, deg", mount, 0, 0.2),
    ]
    columns = ["measure", "value", "low", "high", "seeds"]
    return pd.DataFrame([(*row, len(rows)) for row in found], columns=columns)
