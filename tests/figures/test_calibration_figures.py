"""Figures of a calibration: what they show is what the tables say, and what they refuse."""

import numpy as np
import pandas as pd
import pytest

from thalweg.core import CoverageError
from thalweg.figures import count
from thalweg.figures.calibration import Oblique
from thalweg.figures.calibration.cones import cone_before_after
from thalweg.figures.calibration.field import cones_of, field_positions, field_reference, field_setup
from thalweg.figures.calibration.quality import calibration_design
from thalweg_lab.figures.synthetic_view import synthetic_view

NBSP = "\N{NO-BREAK SPACE}"


# ---------------------------------------------------------------- views


def test_a_cone_is_drawn_where_it_is(cones):
    cone = cones_of(cones)["C2"]
    R = cone.frame
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    surface = cone.surface().reshape(-1, 3) - cone.apex_m
    z = surface @ cone.axis
    rho = np.linalg.norm(surface - np.outer(z, cone.axis), axis=1)
    assert rho == pytest.approx(z * np.tan(cone.half_angle_rad), abs=1e-12)
    assert z.max() == pytest.approx(cone.length_m)


def test_the_projection_is_a_rotation():
    view = Oblique(azimuth_deg=0.0, elevation_deg=0.0)
    xy, depth = view.apply(np.array([[1.0, 2.0, 3.0]]))
    # seen from the south: east to the right, up upward, north is farther away
    assert xy == pytest.approx(np.array([[1.0, 3.0]]), abs=1e-12)
    assert depth == pytest.approx([-2.0])
    R = Oblique(azimuth_deg=35.0, elevation_deg=24.0).axes
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)


# ---------------------------------------------------------------- field


def test_the_field_shows_cones_and_sensors(cones, poses, look):
    figure = field_setup(cones, poses, twin=True)
    words = look.texts(figure)
    assert "n = 4 cones" in words
    assert "up (wcs) / m" in words
    low = cones.assign(apex_z_m=cones["apex_z_m"] - 5.0)
    words = look.texts(field_setup(low, poses, frame="pcs", unseen=["C7"]))
    assert "without data: C7" in words
    assert "z (pcs) / m" in words
    assert "from the south" not in words


def test_a_distance_is_signed(cones):
    cone = cones_of(cones)["C1"]
    surface = cone.surface()[1:].reshape(-1, 3)
    assert cone.distance(surface) == pytest.approx(0.0, abs=1e-12)
    assert cone.distance(cone.apex_m + 0.5 * cone.axis[None])[0] == pytest.approx(
        -0.5 * np.sin(cone.half_angle_rad)
    )


def test_positions_have_one_colour_each(cones, poses, look):
    figure = field_positions(cones, poses)
    words = look.texts(figure)
    assert "n = 2 positions, 4 cones" in words


@pytest.fixture
def reference(rng, cones):
    rows = [
        (f"{i // 4}/{i % 4}", *p, 2e-4, 2e-4, 1e-4)
        for i, p in enumerate(
            np.concatenate([c.surface(8, 4)[2:].reshape(-1, 3) for c in cones_of(cones).values()])
        )
    ]
    points = pd.DataFrame(rows, columns=["mark", "x_m", "y_m", "z_m", "sigma_x_m", "sigma_y_m", "sigma_z_m"])
    n = 40
    marks = pd.DataFrame(
        {
            "mark": [f"{i}/0" for i in range(n)],
            "x_px": rng.uniform(10, 190, n),
            "y_px": rng.uniform(10, 140, n),
            "residual_x_px": rng.normal(0, 0.1, n),
            "residual_y_px": rng.normal(0, 0.1, n),
            "used": np.arange(n) != 7,
        }
    )
    return points, marks


def test_the_calibration_in_four_pictures(cones, points, reference, look):
    reference_points, marks = reference
    image = np.full((150, 200), 120, np.uint8)
    figure = field_reference(reference_points, cones, image, marks, points, image_name="p.jpg", twin=True)
    words = look.texts(figure)
    used = points[points["used"]]
    assert f"n = {len(reference_points)} reference points, {count(len(used))}".replace(NBSP, " ") in words
    assert "median 3D sigma 0.30 mm" in words  # 0.2, 0.2 and 0.1 mm
    assert "40 marks in p.jpg" in words
    assert "1 mark rejected" in words
    kept = marks[marks["used"]]
    rms = np.sqrt((kept[["residual_x_px", "residual_y_px"]] ** 2).to_numpy().mean())
    assert f"RMS {rms:.3f} px" in words
    assert f"std {1e3 * used['residual_m'].std(ddof=0):.1f} mm" in words


def test_a_synthetic_view_colours_cones_by_height(rng, tmp_path, look):
    height = np.full((40, 100), np.nan, np.float32)
    height[10:20, 20:40], height[10:20, 60:80] = 0.5, 2.0
    shade = np.full((40, 100), 200, np.uint8)
    lidar = pd.DataFrame(rng.uniform(-3, 3, (200, 3)), columns=["x_m", "y_m", "z_m"])
    lidar = lidar.assign(ring=np.arange(200) % 8, on_cone=np.arange(200) < 120)
    figure = synthetic_view(height, shade, lidar, twin=True)
    assert "n = 120 points on cones in 8 scan lines" in look.texts(figure)


# ---------------------------------------------------------------- residuals and correlations


def test_before_and_after(rng, cones, look, on_cones):
    after = on_cones(rng, cones, noise_m=0.012)
    before = after.assign(x_m=after["x_m"] + 0.1, residual_m=after["residual_m"] + 0.06)
    figure = cone_before_after(before, after, cones, cone="C2", twin=True)
    words = look.texts(figure)
    part = after[after["used"] & (after["cone"] == "C2")]
    kept = 1e3 * cones_of(cones)["C2"].distance(part[["x_m", "y_m", "z_m"]].to_numpy())
    assert f"C2, n = {len(kept)} points" in words
    assert f"mean {kept.mean():+.1f} mm, RMS {np.sqrt((kept**2).mean()):.1f} mm" in words.replace("−", "-")
    with pytest.raises(CoverageError, match="no points of cone C4"):
        cone_before_after(before, after, cones, cone="C4")


def test_the_design_study_has_a_line_for_each_number_of_positions(rng, look):
    rows = [
        (c, p, q, u, s * np.sqrt(18 / c / p) * f)
        for c in (4, 6, 8)
        for p in (1, 3)
        for f in (0.8, 1.0, 1.3)
        for q, u, s in (("rotation_x_deg", "deg", 0.05), ("rotation_z_deg", "deg", 0.02), ("x_m", "m", 5e-4))
    ]
    figure = calibration_design(
        pd.DataFrame(rows, columns=["cones", "positions", "quantity", "unit", "sigma"]), twin=True
    )
    assert "n = 54 sigmas" in look.texts(figure)
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert titles[:3] == ["rotation about x", "rotation about z", "x of the lever arm"]
