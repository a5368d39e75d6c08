"""Pictures of a rig and its panoramas: words, numbers and marks in them."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.patches import Ellipse

from thalweg.calibration import Rig
from thalweg.core import Camera, Rigid
from thalweg.figures.cloud import colour_check, coloured_bank
from thalweg.figures.panorama import (
    panorama_picture,
    rig_field,
    rig_residuals,
    rig_sketch,
    seam_cost,
    seam_views,
)
from thalweg.settings.sections import Rig as RigSettings


def words(figure) -> str:
    texts = [text.get_text() for text in figure.findobj(match=lambda a: hasattr(a, "get_text"))]
    return " ".join(texts).replace("\n", " ")


def test_the_sketch_tells_base_angle_and_their_sigmas() -> None:
    R = np.diag([-1.0, 1.0, -1.0])
    cov = np.diag([1e-4, 1e-4, 2e-4, 1e-4, 1e-4, 1e-4]) ** 2
    figure = rig_sketch(Rigid(R=R, shift_m=[0.0, 0.0, -0.0194], cov=cov), title="Rig", twin=True)
    told = words(figure)
    assert "19.40 mm (sigma 0.20)" in told
    assert "180.000 degrees apart (sigma 0.006)" in told
    assert "digital twin" in told
    (ellipse,) = figure.axes[0].findobj(Ellipse)
    # 95 % of two dimensions, not enlarged: 2 x 2.4477 x 0.2 mm
    assert max(ellipse.width, ellipse.height) == pytest.approx(2 * 2.4477 * 0.2, rel=1e-3)
    assert "1 times enlarged" in told
    assert figure.axes[0].get_ylim()[0] < -1.4 * 19.4


def test_residuals_are_split_along_and_across_the_radius() -> None:
    rng = np.random.default_rng(1)
    n = 400
    azimuth, radial = rng.uniform(-180, 180, n), 0.02 + 0.001 * rng.standard_normal(n)
    a = np.deg2rad(azimuth)
    table = pd.DataFrame(
        {
            "lens": np.repeat(["front", "back"], n // 2),
            "angle_deg": rng.uniform(0, 95, n),
            "azimuth_deg": azimuth,
            "vx_px": radial * np.cos(a),
            "vy_px": radial * np.sin(a),
            "used": np.arange(n) != 7,
        }
    )
    figure = rig_residuals(table, title="Residuals", twin=False)
    assert "n = 399 marks of 400" in words(figure)
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert titles[0] == "front lens, radial, rms 0.020 px"
    assert titles[1] == "front lens, tangential, rms 0.000 px"


def row(**changes: object) -> pd.Series:
    given = {"width_px": 64, "mode": "depth", "heading_deg": 90.0}
    return pd.Series(given | {"sigma_east_m": 0.03, "sigma_north_m": 0.04} | changes)


def test_a_panorama_shows_where_north_is() -> None:
    figure = panorama_picture(np.zeros((32, 64, 3), np.uint8), row(), title="Panorama", twin=False)
    ax = figure.axes[0]
    at = dict(zip([t.get_text() for t in ax.get_xticklabels()], ax.get_xticks(), strict=True))
    assert (at["E"], at["S"], at["N"]) == (0, 90, -90)
    assert "centre ± 5.0 cm" in words(figure)


def test_the_cost_of_the_base_is_that_of_the_range() -> None:
    rows = pd.DataFrame({"width_px": [5376], "mode": ["depth"], "seam_rms_px": [0.4]})
    figure = seam_cost(0.0194, rows, 8.0, title="Seam", twin=False)
    far = next(line for line in figure.axes[0].lines if "none" in str(line.get_label()))
    x, y = far.get_data()
    assert np.interp(2.0, x, y) == pytest.approx(8.3, abs=0.05)
    assert np.interp(5.0, x, y) == pytest.approx(3.3, abs=0.05)


def test_marks_of_the_field_lie_where_their_angles_say() -> None:
    lens = np.array([40.0, 40.0, 70.0, 60.0, 0, 0, 0, 0])
    cameras = {
        name: Camera(model="fisheye", size_px=(140, 120), parameters=lens, name=name)
        for name in ("front", "back")
    }
    rig = Rig(
        cameras=cameras,
        T_back_front=Rigid(R=np.diag([-1.0, 1.0, -1.0]), shift_m=[0.0, 0.0, -0.02]),
        settings=RigSettings(),
    )
    table = pd.DataFrame(
        {
            "lens": ["front", "front", "back"],
            "angle_deg": [90.0, 45.0, 60.0],
            "azimuth_deg": [0.0, 90.0, 180.0],
            "vx_px": [0.1, 0.0, 0.0],
            "vy_px": [0.0, 0.0, 0.0],
            "used": [True, False, True],
        }
    )
    views = {name: np.zeros((120, 140, 3), np.uint8) for name in cameras}
    figure = rig_field(views, table, rig, title="Field", twin=True)
    front, back = figure.axes
    dots = [line.get_xydata() for line in front.lines[:2]]
    # r = f theta: 90 degrees to the right, and 45 downwards, which was left out
    assert dots[0] == pytest.approx(np.array([[70 + 40 * np.pi / 2, 60.0]]))
    assert dots[1] == pytest.approx(np.array([[70.0, 60 + 40 * np.pi / 4]]))
    assert "n = 2 marks" in words(figure)
    assert back.lines[0].get_xydata() == pytest.approx(np.array([[70 - 40 * np.pi / 3, 60.0]]))


def test_both_sides_of_the_seam_are_cut_out_where_they_are() -> None:
    picture = np.zeros((180, 360, 3), np.uint8)
    picture[:, 85:95], picture[:, 265:275] = (250, 0, 0), (0, 250, 0)
    figure = seam_views({"all far": (picture, 1.234), "ranges": (picture, 0.2)}, title="Seam", twin=False)
    assert len(figure.axes) == 4
    for ax, channel, side in zip(figure.axes[:2], (0, 1), (-90, 90), strict=True):
        (image,) = ax.images
        left, right, low, high = image.get_extent()
        assert (low, high) == (-15, 15)
        shown = np.flatnonzero(image.get_array()[0, :, channel] > 0)
        middle = left + (shown.mean() + 0.5) / image.get_array().shape[1] * (right - left)
        assert middle == pytest.approx(side)
    assert "all far: 1.23 px" in words(figure)


def test_the_check_of_clock_and_mount_shows_its_optimum() -> None:
    check = pd.DataFrame(
        {
            "quantity": ["clock_s", "turn_x_deg", "turn_y_deg", "turn_z_deg"],
            "optimum": [0.3, 0.01, np.nan, 0.0],
            "sigma": [0.02, 0.02, np.nan, 0.02],
            "verdict": ["shifted", "fits", "cannot be told", "fits"],
            "photographs": 12,
        }
    )
    shifts = np.linspace(-0.5, 0.5, 21)
    curves = pd.concat(
        pd.DataFrame({"quantity": name, "shift": shifts, "dependence": -((shifts - 0.3) ** 2)})
        for name in check["quantity"]
    )
    figure = colour_check(check, curves, title="Check", twin=True)
    told = words(figure)
    assert "shift +0.300 ± 0.020: shifted" in told
    assert "n = 12 photographs" in told
    line = figure.axes[0].lines[1].get_xydata()
    assert line[line[:, 1].argmax(), 0] == pytest.approx(0.3)


def test_the_coloured_bank_is_seen_from_the_boat() -> None:
    """The boat goes east; the camera saw the south bank, so that east is to the left."""
    rng = np.random.default_rng(2)
    x, z = rng.uniform(0, 50, (2, 1000))
    z /= 5
    xyz = np.column_stack([x, np.where(np.arange(1000) < 600, -10.0, 12.0), z])
    n_views = np.where(xyz[:, 1] < 0, 3, 0)
    counts = pd.DataFrame({"words": ["coloured", "behind something nearer"], "n": [600, 400]})
    track = np.column_stack([np.linspace(0, 50, 20), np.zeros((20, 2))])
    rgb = np.tile([0.2, 0.6, 0.1], (1000, 1))
    figure = coloured_bank(xyz, rgb, n_views, track, counts, title="Bank", twin=True)
    above, below = figure.axes[:2]
    left, right = above.get_xlim()
    assert left > right
    told = words(figure)
    assert "n = 600 coloured points of 1 000 drawn" in told.replace("\u202f", " ").replace("\xa0", " ")
    assert "400  behind something nearer" in told
    assert len(above.collections[0].get_offsets()) == len(below.collections[0].get_offsets()) == 600
    assert above.collections[0].get_facecolor()[0, :3] == pytest.approx([0.2, 0.6, 0.1])
