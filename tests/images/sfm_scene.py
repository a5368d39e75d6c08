"""A wall, a floor and two boxes with noise on them, photographed by cameras whose poses are known."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates

from thalweg.core import Camera

PERSPECTIVE = Camera(
    model="perspective",
    size_px=(320, 240),
    parameters=np.array([270.0, 270.0, 160.0, 120.0, -0.06, 0.03, 0.0, 0.0, 0.0]),
)
FISHEYE = Camera(
    model="fisheye",
    size_px=(320, 320),
    parameters=np.array([110.0, 110.0, 160.0, 160.0, 0.01, -0.002, 0.0, 0.0]),
)


def longer(times: float, camera: Camera = PERSPECTIVE) -> Camera:
    """The same camera with so many times the focal length."""
    return camera.with_parameters(camera.parameters * np.r_[times, times, np.ones(7)])


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """A rectangle: corner, two sides, and where it begins in the texture."""

    corner: tuple[float, float, float]
    u: tuple[float, float, float]
    v: tuple[float, float, float]
    at: tuple[float, float]


def box(x: float, y: float, z: float, w: float, h: float, d: float, at: float) -> list[Sheet]:
    """Front and both sides of a box whose front's upper left corner is given."""
    return [
        Sheet(corner=(x, y, z), u=(w, 0, 0), v=(0, h, 0), at=(at, 0.3)),
        Sheet(corner=(x, y, z), u=(0, 0, d), v=(0, h, 0), at=(at, 7.1)),
        Sheet(corner=(x + w, y, z), u=(0, 0, d), v=(0, h, 0), at=(at, 12.7)),
    ]


SCENE = [
    Sheet(corner=(-20, -6, 9), u=(40, 0, 0), v=(0, 8, 0), at=(0, 0)),
    Sheet(corner=(-20, 2, 1), u=(40, 0, 0), v=(0, 0, 8), at=(3, 20)),
    *box(-2.5, -0.2, 6, 1.6, 2.2, 2, 41),
    *box(1.0, 0.3, 5, 1.2, 1.7, 2, 52),
]
"""x to the right, y down, z into the picture: the frame of an unturned camera."""


@cache
def texture(seed: int = 1, size: int = 1600) -> NDArray[np.float64]:
    """Noise of several octaves, 25 samples a unit of length."""
    rng = np.random.default_rng(seed)
    total = sum(
        s**0.7 * (lambda a: a / a.std())(gaussian_filter(rng.standard_normal((size, size)), s, mode="wrap"))
        for s in (1.2, 2.5, 5.0, 12.0)
    )
    return np.clip(128 + 38 * total / np.std(total), 0, 255)


def rotation(yaw: float, pitch: float, roll: float) -> NDArray[np.float64]:
    """R_scene_ccs, degrees: about y, x and z."""
    a, b, c = np.radians([yaw, pitch, roll])
    Ry = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    Rx = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    Rz = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return Ry @ Rx @ Rz


def photograph(
    rays_ccs: NDArray[np.float64],
    size_px: tuple[int, int],
    R: NDArray[np.float64],
    centre: NDArray[np.float64],
    noise: NDArray[np.float64],
    sheets: list[Sheet] = SCENE,
) -> NDArray[np.uint8]:
    """Picture of the scene by casting the ray of each pixel."""
    w, h = size_px
    rays = rays_ccs @ R.T
    nearest = np.full(len(rays), np.inf)
    grey = np.full(len(rays), 215.0)
    for sheet in sheets:
        u, v = np.array(sheet.u, float), np.array(sheet.v, float)
        normal = np.cross(u, v)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (np.array(sheet.corner) - centre) @ normal / (rays @ normal)
            at = centre + t[:, None] * rays - sheet.corner
            p, q = at @ u / (u @ u), at @ v / (v @ v)
            hit = (t > 0) & (t < nearest) & (p >= 0) & (p <= 1) & (q >= 0) & (q <= 1)
        nearest[hit] = t[hit]
        a = 25 * (p[hit] * np.linalg.norm(u) + sheet.at[0])
        b = 25 * (q[hit] * np.linalg.norm(v) + sheet.at[1])
        grey[hit] = map_coordinates(noise, [b, a], order=1, mode="grid-wrap")
    return grey.reshape(h, w).round().astype(np.uint8)


@dataclass(frozen=True, kw_only=True)
class Photographs:
    """Files and the truth about them."""

    files: list[Path]
    camera: Camera
    R: NDArray[np.float64]
    centre: NDArray[np.float64]


def photographs(
    folder: Path, camera: Camera = PERSPECTIVE, *, x: NDArray[np.float64] | None = None, seed: int = 1
) -> Photographs:
    """A boat's way along the wall, unsteady and turning: image_01.png, image_02.png ..."""
    folder.mkdir(parents=True, exist_ok=True)
    along = np.linspace(-2.4, 2.4, 9) if x is None else x
    noise = texture(seed)
    w, h = camera.size_px
    column, row = np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5)
    rays = camera.rays(np.column_stack([column.ravel(), row.ravel()]))
    files, Rs, centres = [], [], []
    for k, s in enumerate(along):
        R = rotation(
            -2.5 * np.clip(s, -3, 3) + 1.5 * np.sin(2.1 * k), 2.0 * np.sin(1.3 * k), 1.5 * np.cos(1.7 * k)
        )
        centre = np.array([s, 0.1 * np.sin(1.9 * k), 0.25 * np.cos(2.3 * k)])
        files.append(folder / f"image_{k + 1:02d}.png")
        Image.fromarray(photograph(rays, camera.size_px, R, centre, noise)).save(files[-1])
        Rs.append(R)
        centres.append(centre)
    return Photographs(files=files, camera=camera, R=np.array(Rs), centre=np.array(centres))


def similarity(
    source: NDArray[np.float64], target: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Scale, rotation and shift of source points onto target points (Umeyama 1991)."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    U, S, Vt = np.linalg.svd(b.T @ a)
    D = np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))])
    R = U @ D @ Vt
    scale = float(np.trace(np.diag(S) @ D) / np.sum(a**2))
    return scale, R, target.mean(axis=0) - scale * R @ source.mean(axis=0)
