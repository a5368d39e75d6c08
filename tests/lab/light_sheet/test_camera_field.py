"""The marker field of the sensor's camera: what its pictures show; nothing else of the twin depends on it."""

import numpy as np
import pandas as pd
import pytest

from thalweg.calibration.field import read_field
from thalweg.core import Camera, Rigid
from thalweg.lightsheet.optics import paper_4
from thalweg_lab.settings import TwinConfig
from thalweg_lab.tank import record_camera_field
from thalweg_lab.tank.camera_field import (
    MODULE_M,
    SIGMA_BAR_M,
    SIGMA_PX,
    build_marker_field,
    observe_field,
    stations,
)

CAMERA = paper_4().camera.scaled((1024, 1024))


def recorded(folder, seed=7, **changes):
    twin = TwinConfig.of_size("basin_tiny", light_sheet=changes)
    paths = folder / f"marks{seed}.csv", folder / f"field{seed}.yaml"
    record_camera_field(twin, seed, out_marks=paths[0], out_field=paths[1])
    return pd.read_csv(paths[0]), paths[1]


def test_the_description_is_that_of_a_calibration_field(tmp_path):
    marks, path = recorded(tmp_path)
    field = read_field(path)
    assert field.layout.module_m == MODULE_M
    assert len(field.scale_bars) == 3
    true = build_marker_field(7).bar_lengths_m()
    # certificates are off by what they state, six digits of a metre are written
    assert np.abs([b.length_m for b in field.scale_bars] - true).max() < 4 * SIGMA_BAR_M
    assert not field.targets
    assert marks.columns.tolist() == ["file", "marker", "corner", "x_px", "y_px", "sigma_px"]
    assert marks["file"].nunique() == 24
    ends = {int(name.split("/")[0]) for b in field.scale_bars for name in (b.start, b.end)}
    assert ends <= set(marks["marker"])


def test_pictures_are_taken_from_all_sides_and_rolled():
    field = build_marker_field(1)
    poses = list(stations(field, 1, 24).values())
    view = np.array([p.R[:, 2] for p in poses])
    zenith = np.rad2deg(np.arccos(-view[:, 2]))
    assert zenith.min() < 12
    assert zenith.max() > 38
    azimuth = np.sort(np.rad2deg(np.arctan2(view[:, 1], view[:, 0])))
    assert np.diff(azimuth).max() < 60
    # the horizontal of the field lies along the rows in some, along the columns in others
    horizontal = np.cross(view, [0.0, 0.0, 1.0])
    horizontal /= np.linalg.norm(horizontal, axis=1, keepdims=True)
    along = np.abs(np.einsum("ij,ij->i", horizontal, [p.R[:, 0] for p in poses]))
    assert (along > 0.95).sum() == (along < 0.35).sum() == 12
    plain = list(stations(field, 1, 6, roll=False, convergent=False).values())
    assert np.rad2deg(np.arccos(plain[0].R[:, 2] @ plain[3].R[:, 2])) < 5


def test_marks_have_the_noise_that_they_state_and_fill_the_picture():
    field = build_marker_field(1)
    poses = stations(field, 1, 24)
    marks = observe_field(field, CAMERA, poses, 1)
    still = observe_field(field, CAMERA, poses, 1, sigma_px=0.0)
    off = (marks[["x_px", "y_px"]] - still[["x_px", "y_px"]]).to_numpy()
    # 5000 numbers: 1 % of a standard deviation
    assert off.std() == pytest.approx(SIGMA_PX, rel=0.05)
    assert abs(off.mean()) < 4 * SIGMA_PX / np.sqrt(off.size)
    reach = np.linalg.norm(still[["x_px", "y_px"]].to_numpy() - 512, axis=1).max()
    assert reach > 0.85 * 512 * np.sqrt(2)
    assert still["x_px"].between(0, 1024).all()
    assert still["y_px"].between(0, 1024).all()


def test_a_sheet_on_a_post_hides_what_is_behind_it():
    field = build_marker_field(1)
    post = max(field.sheets, key=lambda sheet: sheet.centre_wcs_m()[2])
    top = post.centre_wcs_m()
    on_board = [s for s in field.sheets if s.centre_wcs_m()[2] == 0.0]
    low = min(on_board, key=lambda s: float(np.linalg.norm(s.centre_wcs_m()[:2] - top[:2])))
    foot = low.centre_wcs_m()
    away = (top - foot) / np.linalg.norm(top - foot)

    def seen(place):
        z = (foot - place) / np.linalg.norm(foot - place)
        x = np.cross(z, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        pose = Rigid(R=np.column_stack([x, np.cross(z, x), z]), shift_m=place)
        wide = Camera(
            model="perspective",
            size_px=(4000, 4000),
            parameters=np.array([900.0, 900, 2000, 2000, *[0.0] * 5]),
        )
        return set(observe_field(field, wide, {"a": pose}, 1)["marker"])

    steep = foot + 0.4 * np.array([0.1, 0.0, 0.995])
    assert low.marker in seen(steep)
    # steep enough to be read, were it not for the post
    assert away[2] > np.cos(np.deg2rad(60))
    behind = seen(foot + 0.4 * away)
    assert low.marker not in behind
    assert post.marker in behind
