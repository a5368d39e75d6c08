"""6-DOF poses: published accuracy, errors as the covariance says, pictures that give none (P4 4.2.1, 7.3)."""

import numpy as np
import pandas as pd
import pytest

from tests.bands import band
from tests.lightsheet.scanning.scan_files import write_panel_files
from thalweg.core import GeometryError, InputError, Rigid
from thalweg.lightsheet.poses import panel_poses, read_panel, read_standing_camera, sigmas_at
from thalweg.lightsheet.poses.sources import PUBLISHED_SIGMA_DEG, PUBLISHED_SIGMA_MM, read_marks
from thalweg_lab.tank import SIGMA_PX, build_panel, observe, scan_plan, set_up
from thalweg_lab.tank.objects import panel as plane

LINES = 4


def recorded(sensor, seed, folder):
    """Files of panel, marks and camera as a campaign has them; plan, panel and tripod with the truth."""
    plan = scan_plan(sensor, seed, plane(), lines=LINES, step_mm=5.0)
    panel = build_panel(seed)
    tripod = set_up(plan.path, panel)
    seen = observe(seed, tripod, panel, plan.path, name="test")
    marks = pd.DataFrame({
        "file": [f"i{k}.png" for k in seen.image], "marker": seen.marker,
        "x_px": seen.xy_px[:, 0], "y_px": seen.xy_px[:, 1], "sigma_px": SIGMA_PX,
    })  # fmt: skip
    write_panel_files(folder, panel, tripod.camera, marks)
    return plan, panel, tripod


def poses_of(folder, images):
    return panel_poses(
        read_standing_camera(folder / "camera.json"),
        read_panel(folder / "panel.csv"),
        read_marks(folder / "marks.csv"),
        images,
    )


NAMES = [f"i{k}.png" for k in range(LINES)]


def test_errors_are_what_the_covariance_says(exact, tmp_path):
    squares, differences = [], []
    for seed in range(1, 9):
        plan, panel, tripod = recorded(exact, seed, tmp_path)
        poses = poses_of(tmp_path, NAMES)
        errors = []
        for k in range(LINES):
            R, shift = tripod.T_ccs_lcs(plan.path, k)
            found = poses.pose(k)
            errors.append(found.error_from(Rigid(R=R, shift_m=shift * 1e-3)))
            squares.append(errors[-1] @ np.linalg.solve(found.cov, errors[-1]) / 6)
        # what all poses share drops out of differences
        step = errors[1] - errors[0]
        differences.append(step @ np.linalg.solve(poses.cov[0] + poses.cov[1], step) / 6)
        sigma_mm, sigma_deg = sigmas_at(poses, panel.xyz_lcs_mm.mean(axis=0))
        # P4: approx. 0.05 mm and 0.01 degrees; the way to the camera is the worst of three axes
        assert 0.3 * PUBLISHED_SIGMA_MM < np.sqrt(np.mean(sigma_mm**2)) < 1.2 * PUBLISHED_SIGMA_MM
        assert 0.5 * PUBLISHED_SIGMA_DEG < np.sqrt(np.mean(sigma_deg**2)) < 1.2 * PUBLISHED_SIGMA_DEG
    # the poses of a recording share the errors of its panel: worth one pose of six numbers, as its difference
    low, high = band(6 * len(differences))
    assert low < np.mean(squares) < high
    assert low < np.mean(differences) < high


def test_pictures_without_a_pose_are_named(exact, tmp_path):
    recorded(exact, 1, tmp_path)
    marks = pd.read_csv(tmp_path / "marks.csv")
    marks = marks[marks["file"] != "i1.png"]
    swapped = marks["file"] == "i2.png"
    marks.loc[swapped, ["x_px", "y_px"]] = marks.loc[swapped, ["x_px", "y_px"]].to_numpy()[::-1]
    marks.to_csv(tmp_path / "marks.csv", index=False)
    poses = poses_of(tmp_path, NAMES)
    assert poses.usable.tolist() == [True, False, False, True]
    assert poses.reasons[1] == "no picture of the standing camera"
    # turned by 180 degrees the panel still looks much like itself: a pose is found that fits badly
    assert "times their sigmas off any pose" in poses.reasons[2]
    assert np.isnan(poses.shift_m[1]).all()
    with pytest.raises(GeometryError, match="no pose"):
        poses.pose(1)
    with pytest.raises(InputError, match=r"no entry among the poses, such as x\.png"):
        poses.of(["i0.png", "x.png"])
    with pytest.raises(InputError, match="none of 2 images is among the 3 pictures"):
        poses_of(tmp_path, ["a.png", "b.png"])
    marks[swapped].to_csv(tmp_path / "marks.csv", index=False)
    with pytest.raises(GeometryError, match="none of 1 pictures gives a pose"):
        poses_of(tmp_path, ["i2.png"])


def test_a_panel_read_backwards_in_all_pictures(exact, tmp_path):
    """Half a turn and a mirror: a pose is found for each picture, at 150 times the sigmas of the marks."""
    recorded(exact, 1, tmp_path)
    marks = pd.read_csv(tmp_path / "marks.csv")
    for _, one in marks.groupby("file"):
        marks.loc[one.index, ["x_px", "y_px"]] = one[["x_px", "y_px"]].to_numpy()[::-1]
    marks.to_csv(tmp_path / "marks.csv", index=False)
    with pytest.raises(
        GeometryError, match=r"none of 4 pictures gives a pose.*the order of the marks"
    ) as caught:
        poses_of(tmp_path, NAMES)
    assert "times their sigmas off any pose" in caught.value.found


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("panel.csv", "marker,x_mm,y_mm,z_mm,sigma_mm\n1,0,0,0,0.1\n1,1,1,1,0.1\n", "marker 1 stands twice"),
        ("marks.csv", "file,marker,x_px,y_px\ni0.png,1,2,3\n", "columns missing: sigma_px"),
        ("camera.json", "{}", "this cannot be read"),
        ("camera.json", '{"model": "fisheye", "size_px": [1, 2], "parameters": {}}', "a fisheye camera"),
        (
            "camera.json",
            '{"model": "perspective", "size_px": [1, 2], "parameters": {"fx": 1}}',
            "missing: fy",
        ),
    ],
)
def test_bad_files_are_named(exact, tmp_path, file, content, message):
    recorded(exact, 1, tmp_path)
    (tmp_path / file).write_text(content)
    with pytest.raises(InputError, match=message):
        poses_of(tmp_path, NAMES)
