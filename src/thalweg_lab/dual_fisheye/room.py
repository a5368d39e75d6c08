"""A room of marker sheets around the rig: the cubic field of T 2.2.2, its survey and its pictures."""

from typing import Final

import numpy as np
import pandas as pd

from thalweg.calibration import SADDLES_MODULES, SHEET_MODULES, MarkerLayout
from thalweg.calibration.field import FieldPoints
from thalweg.core import ArrayF, Rigid, exp_rotation
from thalweg_lab.dual_fisheye.device import LENSES, TrueRig
from thalweg_lab.random_numbers import generator
from thalweg_lab.river_images import Sun
from thalweg_lab.yard import Plane, Sheet, Yard
from thalweg_lab.yard_images import Photographer

MODULE_M: Final = 0.035
LAYOUT: Final = MarkerLayout(module_m=MODULE_M)
HALF_M: Final = 1.3
HEIGHT_M: Final = 2.4
_SUN: Final = Sun(azimuth_rad=float(np.deg2rad(130.0)), elevation_rad=float(np.deg2rad(60.0)))
_EACH_WAY: Final = 4
_MIDDLE_M: Final = np.array([0.0, 0.0, HEIGHT_M / 2])
_AMID_M: Final = np.array([0.65, 0.65, 0.5])
"""How far from the middle the rig is held: near walls tell its base from the lenses."""


def room_sheets() -> tuple[Sheet, ...]:
    """Sheets on the floor and on four walls, four by four on each; there is no ceiling."""
    faces = {"board floor": np.array([0.0, 0.0, -1.0])}
    for k, name in enumerate(("east", "north", "west", "south")):
        angle = k * np.pi / 2
        faces[f"board {name}"] = np.array([np.cos(angle), np.sin(angle), 0.0])
    sheets, marker = [], 0
    for thing, into in faces.items():
        down = np.array([0.0, -1.0, 0.0]) if into[2] < 0 else np.array([0.0, 0.0, -1.0])
        middle = _MIDDLE_M + into * (HEIGHT_M / 2 if into[2] < 0 else HALF_M)
        plane = Plane(origin_wcs_m=middle, right_wcs=np.cross(down, into), down_wcs=down)
        across, along = 2 * HALF_M / _EACH_WAY, (2 * HALF_M if into[2] < 0 else HEIGHT_M) / _EACH_WAY
        for i in range(_EACH_WAY):
            for j in range(_EACH_WAY):
                place = ((j - (_EACH_WAY - 1) / 2) * across, (i - (_EACH_WAY - 1) / 2) * along)
                sheets.append(
                    Sheet(marker=marker, module_m=MODULE_M, thing=thing, surface=plane, place=place)
                )
                marker += 1
    return tuple(sheets)


def room_points(seed: int, sigma_m: float) -> tuple[FieldPoints, ArrayF]:
    """The survey of the room's saddles with errors of a standard deviation, and where they are (n, 3)."""
    sheets = room_sheets()
    keys = tuple((sheet.marker, corner) for sheet in sheets for corner in range(4))
    true = np.concatenate([sheet.to_wcs(SADDLES_MODULES) for sheet in sheets])
    error = sigma_m * generator(seed, "room survey").standard_normal(true.shape)
    cov = sigma_m**2 * np.eye(3 * len(true))
    return FieldPoints(points=keys, points_pcs=true + error, cov=cov), true


def room_poses(seed: int, n: int) -> list[Rigid]:
    """Poses of the front lens amid the room: views all around, turned about them by quarters."""
    rng = generator(seed, "room poses")
    poses = []
    for k in range(n):
        heading, pitch = 2 * np.pi * k / n + rng.normal(0, 0.2), rng.uniform(-0.5, 0.5)
        view = np.array([np.cos(heading) * np.cos(pitch), np.sin(heading) * np.cos(pitch), np.sin(pitch)])
        right = np.cross(view, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        level = np.stack([right, np.cross(view, right), view], axis=1)
        roll = exp_rotation(np.array([0.0, 0.0, k % 4 * np.pi / 2 + rng.normal(0, 0.1)]))
        poses.append(Rigid(R=level @ roll, shift_m=_MIDDLE_M + rng.uniform(-1, 1, 3) * _AMID_M))
    return poses


def room_photographer() -> Photographer:
    """The room in daylight."""
    sheets = room_sheets()
    vertices, triangles, things, names = [], [], [], []
    for number, thing in enumerate(dict.fromkeys(sheet.thing for sheet in sheets)):
        plane = next(sheet.surface for sheet in sheets if sheet.thing == thing)
        assert isinstance(plane, Plane)
        high = HALF_M if thing == "board floor" else HEIGHT_M / 2
        corners = [(-HALF_M, -high), (HALF_M, -high), (HALF_M, high), (-HALF_M, high)]
        first = 4 * number
        vertices += [plane.origin_wcs_m + a * plane.right_wcs + b * plane.down_wcs for a, b in corners]
        triangles += [(first, first + 2, first + 1), (first, first + 3, first + 2)]
        things += [number, number]
        names.append(thing)
    yard = Yard(
        vertices_wcs_m=np.array(vertices),
        triangles=np.array(triangles, dtype=np.int64),
        things=np.array(things, dtype=np.int64),
        names=tuple(names),
        sheets=sheets,
        layout=LAYOUT,
    )
    return Photographer(yard, _SUN)


def room_marks(rig: TrueRig, seed: int, n: int, *, sigma_px: float) -> tuple[pd.DataFrame, list[Rigid]]:
    """Marks of the room as a detector would measure them, without pictures, and the poses (for studies).

    Parameters
    ----------
    rig : the true one.
    seed, n : of the poses, and how many exposures.
    sigma_px : noise of each coordinate.

    Returns
    -------
    As `thalweg.calibration.detect_rig_marks` gives them.
    """
    rng = generator(seed, "room marks")
    sheets, poses = room_sheets(), room_poses(seed, n)
    widest = np.cos(np.deg2rad(rig.settings.field_of_view_deg) / 2)
    rows = []
    for k, pose in enumerate(poses):
        for name in LENSES:
            T = (pose @ rig.T_front_lens[name]).inverse()
            for sheet in sheets:
                local = T.apply(sheet.to_wcs(SADDLES_MODULES))
                if (local[:, 2] / np.linalg.norm(local, axis=1) < widest).any():
                    continue
                xy = rig.cameras[name].project(local)
                sides = np.linalg.norm(xy - np.roll(xy, 1, axis=0), axis=1) / (SHEET_MODULES - 2)
                if not sides.min() > 1.6 or not rig.cameras[name].inside(xy, 3.0).all():
                    continue
                seen = xy + sigma_px * rng.standard_normal(xy.shape)
                for corner in range(4):
                    file = f"{k:03d}.jpg"
                    rows.append(
                        (f"{name}/{file}", file, name, sheet.marker, corner, *seen[corner], sigma_px, 8.0)
                    )
    columns = ["image", "file", "camera", "marker", "corner", "x_px", "y_px", "sigma_px", "size_px"]
    return pd.DataFrame(rows, columns=columns), poses
