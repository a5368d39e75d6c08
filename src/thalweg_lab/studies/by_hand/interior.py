"""Interior orientations without sigmas, and lenses from boards: made-up cases by seeds, and real recordings.

    python -m thalweg_lab.studies.by_hand.interior resections FIRST_SEED SEEDS
    python -m thalweg_lab.studies.by_hand.interior boards FIRST_SEED SEEDS
    python -m thalweg_lab.studies.by_hand.interior pictures FOLDER_OF_RECORDINGS
    python -m thalweg_lab.studies.by_hand.interior halves FOLDER_OF_RECORDINGS SPLITS

Each prints rows of a table.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from thalweg.calibration import (
    Interior,
    calibrate_lens,
    corners_of_pictures,
    read_camera,
    read_corners,
    resect_series,
)
from thalweg.core import ArrayF, Camera, Model, ThalwegError, rotation_opk

_AXES: Final = ("x", "y", "z")
_CASES: Final = (
    ("no sigma, auto", 6, 1.0, 1.0, "auto"),
    ("no sigma, auto", 28, 1.0, 1.0, "auto"),
    ("no sigma, auto", 28, 0.5, 5.0, "auto"),
    ("no sigma, auto", 28, 1.0, 0.2, "auto"),
    ("held as exact", 6, 1.0, 1.0, "fixed"),
    ("held as exact", 12, 1.0, 1.0, "fixed"),
    ("held as exact", 28, 0.5, 5.0, "fixed"),
    ("right sigmas", 12, 1.0, 1.0, "weighted"),
    ("right sigmas", 28, 1.0, 1.0, "weighted"),
)
"""What is stated of the lens, points, noise of marks, stated sigma of marks [px], mode."""
_SMOOTH_PX: Final = 0.12
"""Standard deviation of each bend by which the corners of a picture err alike."""


# ---------------------------------------------------------------- made-up resections


def hillside(seed: int, n: int, noise_px: float) -> tuple[Camera, pd.DataFrame, pd.DataFrame]:
    """A lens, marks of n points over a slope 200 to 1500 m before a camera at the origin, and the points."""
    rng = np.random.default_rng([38, seed])
    f = 4000 * rng.uniform(0.7, 1.4)
    lens = [f, f, *rng.normal([2000, 1500], 20), *rng.normal(0, 0.05, 2), *rng.normal(0, 3e-4, 2), 0]
    true = Camera(model="perspective", size_px=(4000, 3000), parameters=np.array(lens))
    R = Rotation.from_euler("x", -95, degrees=True).as_matrix()
    rays = true.rays(rng.uniform([200, 400], [3800, 2800], (8 * n, 2))) @ R.T
    X = rays * (-185 / (rays[:, 2] - 0.35 * rays[:, 1]))[:, None]
    X = X[(X[:, 1] > 200) & (X[:, 1] < 1500)][:n]
    X += np.outer(rng.uniform(-8, 8, len(X)), [0, 0, 1])
    xy = true.project(X @ R) + rng.normal(0, noise_px, (len(X), 2))
    names = [f"P{i}" for i in range(len(X))]
    surveyed = X + rng.normal(0, 0.02, X.shape)
    marks = pd.DataFrame({"image": "a", "point": names, "x_px": xy[:, 0], "y_px": xy[:, 1]})
    return true, marks, pd.DataFrame({"point": names, **dict(zip(_AXES, surveyed.T, strict=True))})


def stated_lens(true: Camera, seed: int, interior: str) -> Camera:
    """A file of another program, 1 to 3 % off and without distortion; or one whose sigmas are right."""
    rng = np.random.default_rng([39, seed])
    f = true.parameters[0]
    if interior == "weighted":
        sigma = np.array([0.001 * f, 0.001 * f, 4, 4, 0.005, 0.005, 1e-4, 1e-4, 0])
        z = rng.normal(size=9)
        z[1] = z[0]
        cov = np.diag(sigma**2)
        cov[0, 1] = cov[1, 0] = 0.9999 * sigma[0] ** 2
        return replace(true, parameters=true.parameters + sigma * z, cov=cov)
    f *= 1 + rng.choice([-1, 1]) * rng.uniform(0.01, 0.03)
    return replace(true, parameters=np.array([f, f, 2000.0, 1500.0, 0, 0, 0, 0, 0]))


def resections(first: int, n: int) -> None:
    """Squares of the centre's errors over its variances, and what was refused."""
    print(
        "| lens | points | noise, stated [px] | poses | refused | NEES | 99.9 % | median error, sigma [m] |"
    )
    for words, points, noise, sigma_px, mode in _CASES:
        interior: Interior = mode  # type: ignore[assignment]
        squares, errors, sigmas = [], [], []
        for seed in range(first, first + n):
            true, marks, known = hillside(seed, points, noise)
            try:
                poses = resect_series(
                    stated_lens(true, seed, mode),
                    marks,
                    known,
                    sigma_px=sigma_px,
                    sigma_point_m=0.02,
                    largest_sigma_m=50,
                    interior=interior,
                )[0]
            except ThalwegError:
                continue
            if poses["refused"][0]:
                continue
            off, sigma = (poses[[f"{s}{a}_m" for a in _AXES]].to_numpy(float)[0] for s in ("", "sigma_"))
            squares.append((off / sigma) ** 2)
            errors.append(np.linalg.norm(off))
            sigmas.append(np.linalg.norm(sigma))
        k = len(squares)
        told = "| - | - | - |"
        if k:
            # three coordinates of a place err together
            low, high = (float(chi2.ppf(p, k)) / k for p in (0.0005, 0.9995))
            told = (
                f"| {np.mean(squares):.2f} | {low:.2f} to {high:.2f} "
                f"| {np.median(errors):.2f}, {np.median(sigmas):.2f} |"
            )
        print(f"| {words} | {points} | {noise:g}, {sigma_px:g} | {k} | {n - k} {told}", flush=True)


# ---------------------------------------------------------------- real pictures


def belvedere(
    data: Path,
) -> Iterator[tuple[str, Camera, pd.DataFrame, pd.DataFrame, dict[str, ArrayF], float]]:
    """Two cameras before a glacier: four targets a picture; places with the published lens are the truth."""
    folder = data / "icepy4d_belvedere/assets"
    points = pd.read_csv(folder / "targets/target_world.csv").set_axis(["point", *_AXES], axis=1)
    for name, pictures, place in (
        ("cam1", "IMG_26", (151.65, 99.26, 91.48)),
        ("cam2", "IMG_11", (312.7, 300.4, 135.0)),
    ):
        tables = [
            pd.read_csv(p).assign(image=p.stem) for p in sorted((folder / "targets").glob(f"{pictures}*"))
        ]
        marks = pd.concat([t for t in tables if len(t) > 3])
        marks = marks.set_axis(["point", "x_px", "y_px", "image"], axis=1)
        truth = dict.fromkeys(marks["image"], np.array(place))
        yield f"belvedere {name}", read_camera(folder / f"calib/{name}.txt"), marks, points, truth, 5.0


def _poses_of_dbat(report: Path) -> dict[str, ArrayF]:
    """Values of a report of DBAT by their word: Omega, Phi, Kappa [deg], Xc, Yc, Zc."""
    words = report.read_text().split()
    return {
        name: np.array(
            [float(words[k + 2]) for k, w in enumerate(words) if w == f"{name}:" and words[k + 1] == "Value:"]
        )
        for name in ("Omega", "Phi", "Kappa", "Xc", "Yc", "Zc")
    }


def strasbourg(
    data: Path,
) -> Iterator[tuple[str, Camera, pd.DataFrame, pd.DataFrame, dict[str, ArrayF], float]]:
    """Five aerial photographs and 16 surveyed points; places by DBAT's block."""
    folder = data / "dbat_sxb/script/sxb"
    read: dict[str, Any] = {"comment": "#", "header": None, "skipinitialspace": True}
    columns = ["point", "name", *_AXES, *(f"sigma_{a}_m" for a in _AXES)]
    points = pd.read_csv(folder / "reference/sxb-control.txt", names=columns, **read)
    marks = pd.read_csv(folder / "measurements/markpts.txt", names=["point", "image", "x_px", "y_px"], **read)
    marks[["x_px", "y_px"]] -= 0.5
    marks["image"] = marks["image"].astype(str)
    found = _poses_of_dbat(folder / "result/report.txt")
    places = np.column_stack([found[w] for w in ("Xc", "Yc", "Zc")])
    f, c = 123.9392 / 0.006, np.array([26.577, 38.811]) / 0.006 - 0.5
    camera = Camera(
        model="perspective", size_px=(8858, 12996), parameters=np.array([f, f, *c, 0, 0, 0, 0, 0])
    )
    yield "strasbourg", camera, marks, points, {str(k + 1): p for k, p in enumerate(places)}, 0.5


def rome(data: Path) -> Iterator[tuple[str, Camera, pd.DataFrame, pd.DataFrame, dict[str, ArrayF], float]]:
    """Six of 60 photographs of an arch, marks freed of distortion; points and places by DBAT's block."""
    folder = data / "dbat_roma/script/romabundledemo"
    table = np.loadtxt(folder / "measurements/markpts.txt", delimiter=",")
    mm, pp = 36 / 5616, np.array([18.0816295411089882, 12.0164475994770967])
    xy, c, f = table[:, 2:4] - 0.5, pp / mm - 0.5, 24.5425002994450807 / mm
    away = (xy - c) * mm
    r2 = np.square(away).sum(axis=1, keepdims=True)
    xy = c + away * (1 + 2.21523347553201198e-4 * r2 - 1.86984852928280264e-07 * r2**2) / mm
    camera = Camera(model="perspective", size_px=(5616, 3744), parameters=np.array([f, f, *c, 0, 0, 0, 0, 0]))
    found = _poses_of_dbat(folder / "result/report.txt")
    places = np.column_stack([found[w] for w in ("Xc", "Yc", "Zc")])
    R = np.array(
        [
            rotation_opk(*np.radians(row)) @ np.diag([1.0, -1.0, -1.0])
            for row in np.column_stack([found[w] for w in ("Omega", "Phi", "Kappa")])
        ]
    )
    image, (_, point) = table[:, 0].astype(int) - 1, np.unique(table[:, 1], return_inverse=True)
    ray = np.einsum("mij,mj->mi", R[image], camera.rays(xy))
    across = np.eye(3) - ray[:, :, None] * ray[:, None]
    N, b = np.zeros((point.max() + 1, 3, 3)), np.zeros((point.max() + 1, 3))
    np.add.at(N, point, across)
    np.add.at(b, point, np.einsum("mij,mj->mi", across, places[image]))
    seen = np.bincount(point)
    rng = np.random.default_rng(38)
    for k in range(0, 60, 10):
        own = np.flatnonzero((image == k) & (seen[point] >= 6))
        own = rng.permutation(own)[:12]
        marks = pd.DataFrame({"image": str(k), "point": point[own], "x_px": xy[own, 0], "y_px": xy[own, 1]})
        X = np.linalg.solve(N[point[own]], b[point[own]][:, :, None])[:, :, 0]
        points = pd.DataFrame({"point": point[own], **dict(zip(_AXES, X.T, strict=True))})
        yield "rome", camera, marks, points, {str(k): places[k]}, 0.7


def pictures(data: Path) -> None:
    """Real resections with a focal length that is 3 % too long, without sigmas."""
    print("| picture | mode | off [m] | sigma [m] | largest off / sigma | told |")
    for source in (belvedere, strasbourg, rome):
        for name, camera, marks, points, truth, sigma_px in source(data):
            long = replace(camera, parameters=camera.parameters * np.r_[1.03, 1.03, np.ones(7)])
            for interior in ("auto", "fixed"):
                mode: Interior = "auto" if interior == "auto" else "fixed"
                try:
                    poses = resect_series(
                        long, marks, points, sigma_px=sigma_px, largest_sigma_m=200, interior=mode
                    )[0]
                except ThalwegError as error:
                    print(
                        f"| {name} {marks['image'].iloc[0]} | {interior} | - | - | - | {error.found[:110]} |"
                    )
                    continue
                for row in poses.to_dict("records"):
                    if row["refused"]:
                        print(f"| {name} {row['image']} | {interior} | - | - | - | {row['refused']} |")
                        continue
                    off = np.array([row[f"{a}_m"] for a in _AXES]) - truth[row["image"]]
                    sigma = np.array([row[f"sigma_{a}_m"] for a in _AXES])
                    print(
                        f"| {name} {row['image']} | {interior} | {np.linalg.norm(off):.2f} "
                        f"| {np.linalg.norm(sigma):.2f} | {np.abs(off / sigma).max():.1f} "
                        f"| sigma0 {row['sigma0']:.2f} |",
                        flush=True,
                    )


# ---------------------------------------------------------------- lenses from boards

LENSES: Final[dict[Model, ArrayF]] = {
    "fisheye": np.array([240.0, 238.0, 405.0, 396.0, -0.03, 0.02, -0.006, 0.0003]),
    "perspective": np.array([625.0, 623.0, 405.0, 396.0, -0.12, 0.08, 0.0006, -0.0004, -0.01]),
}


def board_pictures(camera: Camera, seed: int, n: int, smooth_px: float) -> pd.DataFrame:
    """Corners of a board of 9 x 6 in n pictures: 0.12 px of noise, and bends of each picture."""
    rng = np.random.default_rng([40, seed])
    column, row = (a.ravel() for a in np.meshgrid(np.arange(9), np.arange(6)))
    plane = 0.04 * np.column_stack([column - 4.0, row - 2.5, 0.0 * row])
    u, v = (column - 4) / 4, (row - 2.5) / 2.5
    bends = np.column_stack([u * u, v * v, u * v, u * u * v, u * v * v])
    parts: list[pd.DataFrame] = []
    while len(parts) < n:
        direction = rng.uniform(-1, 1, 2) * (1.35 if camera.model == "fisheye" else 0.35)
        side = Rotation.from_euler("yx", direction)
        turn = side * Rotation.from_rotvec(rng.normal(0, 0.35, 3))
        xy = camera.project(turn.apply(plane) + side.apply([0.0, 0.0, rng.uniform(0.25, 0.6)]))
        xy = xy + rng.normal(0, 0.12, xy.shape) + bends @ rng.normal(0, smooth_px, (5, 2))
        if ((xy > 1) & (xy < np.array(camera.size_px) - 1)).all():
            at = {"column": column, "row": row, "x_px": xy[:, 0], "y_px": xy[:, 1]}
            parts.append(pd.DataFrame({"image": f"{len(parts):02d}", **at}))
    return pd.concat(parts, ignore_index=True)


def boards(first: int, n: int) -> None:
    """Squares of errors over variances of twin lenses, with and without errors of whole pictures."""
    print("| lens | errors | lenses | NEES of parameters | of the centre | all together | factor |")
    for model, parameters in LENSES.items():
        true = Camera(model=model, size_px=(800, 800), parameters=parameters)
        for words, smooth in (("noise of corners", 0.0), ("and of pictures", _SMOOTH_PX)):
            own, centre, joint, factor = [], [], [], []
            for seed in range(first, first + n):
                found = calibrate_lens(
                    board_pictures(true, seed, 14, smooth), true.size_px, spacing_m=0.04, model=model
                )
                error = found.camera.parameters - true.parameters
                squares = error**2 / np.diag(found.camera.cov)
                own.append(squares.mean())
                centre.append(squares[2:4].mean())
                joint.append(error @ np.linalg.solve(found.camera.cov, error) / len(error))
                factor.append(found.picture_factor)
            print(
                f"| {model} | {words} | {n} | {np.mean(own):.2f} | {np.mean(centre):.2f} "
                f"| {np.mean(joint):.2f} | {np.median(factor):.1f} |",
                flush=True,
            )


def halves(data: Path, splits: int) -> None:
    """Lenses by halves of the pictures of real boards: rms of their differences over their sigmas."""
    photos = sorted((data / "acfr_vlp16_camera/data/vlp/images").glob("*.png"))
    print("| recording | pictures | splits | fx | fy | cx | cy | distortion |")
    for name, corners, size, spacing_m in (
        ("ricoh_theta_s", read_corners(data / "ricoh_theta_s/corners.csv"), (640, 640), 0.03),
        ("acfr_vlp16_camera", *corners_of_pictures(photos, (7, 5))[:2], 0.095),
    ):
        images = np.array(sorted(corners["image"].unique()))
        rng = np.random.default_rng(38)
        apart: list[ArrayF] = []
        while len(apart) < splits:
            half = corners["image"].isin(set(rng.permutation(images)[: len(images) // 2]))
            a, b = (
                calibrate_lens(part, size, spacing_m=spacing_m, model="fisheye").camera
                for part in (corners[half], corners[~half])
            )
            apart.append((a.parameters - b.parameters) / np.sqrt(np.diag(a.cov + b.cov)))
        rms = np.sqrt(np.mean(np.square(apart), axis=0))
        told = " | ".join(f"{v:.2f}" for v in [*rms[:4], np.sqrt(np.mean(rms[4:] ** 2))])
        print(f"| {name} | {len(images)} | {splits} | {told} |", flush=True)


def main(words: Sequence[str]) -> None:
    """What the words of the command ask for."""
    match words:
        case ["resections", first, n]:
            resections(int(first), int(n))
        case ["boards", first, n]:
            boards(int(first), int(n))
        case ["pictures", folder]:
            pictures(Path(folder))
        case ["halves", folder, n]:
            halves(Path(folder), int(n))
        case _:
            raise SystemExit(__doc__)


if __name__ == "__main__":
    main(sys.argv[1:])
