"""Pictures of a field of coded markers by the sensor's camera in air, for its interior orientation (P3 2.4).

The field is a board of printed sheets, some of them on posts, with scale bars along three of its sides. The
camera takes pictures of it in air at the focus that it has in the sensor, from all sides, from steep to flat
and rolled about its view. What is written are the marks in these pictures, not the pictures: file, marker,
corner, x_px, y_px, sigma_px as in the table of the camera station.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.calibration import MarkerLayout
from thalweg.core import ArrayB, ArrayF, Camera, Rigid, exp_rotation
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import TwinConfig
from thalweg_lab.tank.objects import SIGMA_PX
from thalweg_lab.tank.series import Basin, record_camera_station
from thalweg_lab.yard import Plane, Sheet

MODULE_M: Final = 0.003
"""Side of a module: sheets of 33 mm with their margin."""

PITCH_M: Final = 0.044
POST_M: Final = (0.025, 0.090)
"""Least and largest height of a sheet on a post over the board."""

SIGMA_BAR_M: Final = 1e-5
"""Of the certificate of a scale bar."""

DISTANCES: Final = (2.6, 3.4)
"""From the aim on the board over half its side, 0.37 to 0.48 m: behind the sensor's focus, stopped down."""

_BARS: Final = (((60, 61), (-0.5, 0.0), 0.0), ((62, 63), (0.5, 0.0), 0.0), ((64, 65), (0.0, -0.5), 90.0))
"""Markers at both ends of each bar, its middle in sides of the board, its direction from the board's y."""
_BAR_HEIGHT_M: Final = 0.012
_BAR_END: Final = 0.36
"""From the middle of a bar to the marker at its end, in sides of the board."""
_GOLDEN_TURN: Final = 0.381966
"""Any number of pictures comes from all sides if each is that part of a turn further round."""
_LARGEST_ANGLE: Final = float(np.deg2rad(65.0))
"""Between the normal of a sheet and the way to the camera: flatter ones are not read."""
_LEAST_MODULE_PX: Final = 2.0
_MARGIN_PX: Final = 3.0
_ZENITH_DEG: Final = (8.0, 28.0, 42.0)
"""Angles of the view from the vertical, in turns."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkerField:
    """The field as it truly is: its sheets, in its own frame with z up, and its scale bars.

    ``bars``: name, the markers at both ends; their saddles 0 are the ends. ``half_side_m`` of the board.
    """

    sheets: tuple[Sheet, ...]
    bars: tuple[tuple[str, int, int], ...]
    half_side_m: float

    def saddles_m(self) -> ArrayF:
        """(s, 4, 3) the saddles of each sheet."""
        return np.stack([sheet.saddles_wcs_m() for sheet in self.sheets])

    def bar_lengths_m(self) -> ArrayF:
        """(b,) true lengths."""
        at = {sheet.marker: sheet.saddles_wcs_m()[0] for sheet in self.sheets}
        return np.array([np.linalg.norm(at[b] - at[a]) for _, a, b in self.bars])


def build_marker_field(seed: int, *, sheets_a_side: int = 6, relief: bool = True) -> MarkerField:
    """Board, posts and bars; the sheets are glued on by hand, and in any of four directions.

    Parameters
    ----------
    seed : of the campaign; the stream is ``light sheet camera field layout``.
    sheets_a_side : of the board.
    relief : every fourth sheet stands on a post; False: all lie on the board.
    """
    rng = generator(seed, "light sheet camera field layout")
    n, sheets = sheets_a_side, []
    middle = (n - 1) / 2
    for k in range(n * n):
        turn, askew = rng.integers(4), rng.normal(0.0, 1.0, 2)
        height, tilt = rng.uniform(*POST_M), rng.normal(0.0, 0.04, 2)
        on_post = relief and k % 4 == 1
        place = np.array([k % n - middle, k // n - middle, 0.0]) * PITCH_M
        place[:2] += 5e-4 * askew
        place[2] = height if on_post else 0.0
        sheets.append(_sheet(k, place, 90.0 * turn + askew[0], tilt if on_post else np.zeros(2)))
    side = n * PITCH_M + 6 * MODULE_M
    bars = []
    for i, ((first, second), where, direction) in enumerate(_BARS):
        along = np.array([np.sin(np.deg2rad(direction)), np.cos(np.deg2rad(direction)), 0.0])
        centre = np.array([*(side * np.array(where)), _BAR_HEIGHT_M])
        for marker, sign in ((first, -1.0), (second, 1.0)):
            sheets.append(_sheet(marker, centre + sign * _BAR_END * side * along, direction, np.zeros(2)))
        bars.append((f"bar {i + 1}", first, second))
    return MarkerField(sheets=tuple(sheets), bars=tuple(bars), half_side_m=side / 2)


def _sheet(marker: int, place_m: ArrayF, turn_deg: float, tilt_rad: ArrayF) -> Sheet:
    R = exp_rotation(np.array([*tilt_rad, 0.0]))
    plane = Plane(origin_wcs_m=place_m, right_wcs=R[:, 0], down_wcs=-R[:, 1])
    return Sheet(
        marker=marker, module_m=MODULE_M, thing="board", surface=plane, turn_rad=float(np.deg2rad(turn_deg))
    )


def stations(
    field: MarkerField, seed: int, n: int, *, roll: bool = True, convergent: bool = True
) -> dict[str, Rigid]:
    """True poses ``T_field_ccs`` of the camera by name of the picture.

    Parameters
    ----------
    field : what is seen.
    seed : of the campaign; the stream is ``light sheet camera field stations``.
    n : number of pictures.
    roll : the camera is rolled about its view by a right angle from picture to picture.
    convergent : from all sides; False: all from above, in one direction.
    """
    rng = generator(seed, "light sheet camera field stations")
    poses = {}
    for k in range(n):
        azimuth = 2 * np.pi * (k * _GOLDEN_TURN + rng.uniform(-0.02, 0.02))
        zenith = np.deg2rad(_ZENITH_DEG[k % 3] + rng.uniform(-3.0, 3.0))
        away, turn = field.half_side_m * rng.uniform(*DISTANCES), rng.uniform(-8.0, 8.0)
        aim = np.array([*(0.25 * field.half_side_m * rng.uniform(-1.0, 1.0, 2)), 0.0])
        if not convergent:
            azimuth, zenith = 0.0, np.deg2rad(2.0)
        out = np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])
        angle = np.deg2rad(90.0 * (k % 4) + turn) if roll else 0.0
        poses[f"field_{k + 1:03d}.png"] = _looking(aim + away * out, -out, angle)
    return poses


def _looking(place: ArrayF, view: ArrayF, roll_rad: float) -> Rigid:
    """A pose whose z axis is the view, rolled about it."""
    side = np.cross(view, [0.0, 0.0, 1.0])
    right = side / np.linalg.norm(side)
    R = np.column_stack([right, np.cross(view, right), view])
    return Rigid(R=R @ exp_rotation(np.array([0.0, 0.0, roll_rad])), shift_m=place)


def observe_field(
    field: MarkerField, camera: Camera, poses: dict[str, Rigid], seed: int, *, sigma_px: float = SIGMA_PX
) -> pd.DataFrame:
    """Marks (file, marker, corner, x_px, y_px, sigma_px) of all pictures.

    A sheet is read if all of it is in the picture, large and steep enough, and not behind another on a post.

    Parameters
    ----------
    field, camera, poses : what is seen, by what, from where.
    seed : of the campaign; the stream is ``light sheet camera field marks``.
    sigma_px : standard deviation of each coordinate.
    """
    rng = generator(seed, "light sheet camera field marks")
    saddles = field.saddles_m()
    normals = np.stack([sheet.normal_wcs() for sheet in field.sheets])
    tables = []
    for name, pose in poses.items():
        noise = sigma_px * rng.standard_normal((len(saddles), 4, 2))
        xy = camera.project(pose.inverse().apply(saddles.reshape(-1, 3))).reshape(-1, 4, 2)
        inside = camera.inside(xy.reshape(-1, 2), _MARGIN_PX).reshape(-1, 4).all(axis=1)
        view = pose.shift_m - saddles.mean(axis=1)
        steep = (normals * view).sum(axis=1) > np.cos(_LARGEST_ANGLE) * np.linalg.norm(view, axis=1)
        module_px = np.linalg.norm(xy - np.roll(xy, 1, axis=1), axis=2).min(axis=1) / 8
        seen = inside & steep & (module_px > _LEAST_MODULE_PX) & ~_hidden(field, saddles, pose.shift_m)
        at = np.flatnonzero(seen)
        shown = (xy + noise)[at].reshape(-1, 2)
        tables.append(
            pd.DataFrame(
                {
                    "file": name,
                    "marker": np.repeat([field.sheets[i].marker for i in at], 4).astype(np.int64),
                    "corner": np.tile(np.arange(4), len(at)),
                    "x_px": shown[:, 0],
                    "y_px": shown[:, 1],
                    "sigma_px": sigma_px,
                }
            )
        )
    return pd.concat(tables, ignore_index=True)


def _hidden(field: MarkerField, saddles_m: ArrayF, eye_m: ArrayF) -> ArrayB:
    """(s,) sheets of which a saddle lies behind the paper of a higher sheet."""
    hidden = np.zeros(len(saddles_m), dtype=np.bool_)
    for sheet in field.sheets:
        height = sheet.centre_wcs_m()[2]
        way = eye_m - saddles_m
        low = saddles_m[..., 2] < height - 1e-3
        share = np.where(low, (height - saddles_m[..., 2]) / way[..., 2], 0.0)
        off = np.abs(saddles_m + share[..., None] * way - sheet.centre_wcs_m())[..., :2].max(axis=2)
        hidden |= (low & (off < sheet.half_side_m)).any(axis=1)
    return hidden


def field_text(field: MarkerField, seed: int) -> str:
    """Description of the field as its owner knows it: sizes of the sheets, certificates of the bars.

    Parameters
    ----------
    field : as it truly is.
    seed : of the campaign; the stream is ``light sheet camera field bars``.
    """
    error = generator(seed, "light sheet camera field bars").standard_normal(len(field.bars))
    stated = field.bar_lengths_m() + SIGMA_BAR_M * error
    bars = "".join(
        f'  - {{name: {name}, from: "{a}/0", to: "{b}/0", length_m: {length:.6f}, '
        f"sigma_m: {SIGMA_BAR_M:.6f}}}\n"
        for (name, a, b), length in zip(field.bars, stated, strict=True)
    )
    layout = MarkerLayout(module_m=MODULE_M)
    head = f"thalweg_field: 1\nmarkers: {{dictionary: {layout.dictionary}, module_m: {layout.module_m}}}\n"
    return f"{head}scale_bars:\n{bars}"


def record_camera_field(twin: TwinConfig, seed: int, *, out_marks: Path, out_field: Path) -> None:
    """Write the marks of the pictures and the description of the field.

    Parameters
    ----------
    twin, seed : of the campaign.
    out_marks, out_field : table (CSV) and description (YAML).
    """
    basin = Basin.of(twin, seed)
    field = build_marker_field(seed)
    poses = stations(field, seed, basin.settings.lens_pictures)
    out_marks.parent.mkdir(parents=True, exist_ok=True)
    marks = observe_field(field, basin.true.camera, poses, seed)
    marks.to_csv(out_marks, index=False, float_format="%.5f")
    out_field.write_text(field_text(field, seed))


def record_camera_marks(
    twin: TwinConfig,
    seed: int,
    *,
    out_sensor: Path,
    out_marks: Path,
    out_points: Path,
    out_field_marks: Path,
    out_field: Path,
) -> None:
    """All that the sensor's camera sees through air: from its station, and of the field.

    Parameters
    ----------
    twin, seed : of the campaign.
    out_sensor, out_marks, out_points : see `record_camera_station`.
    out_field_marks, out_field : see `record_camera_field`.
    """
    record_camera_station(twin, seed, out_sensor=out_sensor, out_marks=out_marks, out_points=out_points)
    record_camera_field(twin, seed, out_marks=out_field_marks, out_field=out_field)
