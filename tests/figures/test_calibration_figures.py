"""Figures of a calibration: what they show is what the tables say, and what they refuse."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from thalweg.core import CoverageError
from thalweg.figures import count
from thalweg.figures.calibration import Oblique
from thalweg.figures.calibration.cones import cone_before_after
from thalweg.figures.calibration.field import cones_of, field_positions, field_reference, field_setup
from thalweg.figures.calibration.quality import calibration_design
from thalweg_lab.figures.cone_frame import cone_frame
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
    assert "digital twin" in words
    assert "up (wcs) / m" in words
    (camera, *_), (lidar, *_) = look.artists(figure, "camera"), look.artists(figure, "lidar")
    assert camera.get_marker() == "o"
    assert lidar.get_marker() == "s"
    assert {t for t in words.split(" | ") if t.startswith("C")} >= {"C1", "C2", "C4", "C10"}
    look.drawn(figure)
    # only wcs has a north; the grid lies below the lowest cone, wherever the origin of the frame is
    assert look.artists(figure, "north-arrow")
    low = cones.assign(apex_z_m=cones["apex_z_m"] - 5.0)
    words = look.texts(field_setup(low, poses, frame="pcs", unseen=["C7"]))
    assert "without data: C7" in words
    assert "z (pcs) / m" in words
    assert "from the south" not in words
    assert not look.artists(field_setup(low, poses, frame="pcs"), "north-arrow")


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
    for name in ("position_1", "position_2"):
        found = [look.artists(figure, f"{sensor}-{name}")[0] for sensor in ("camera", "lidar")]
        assert found[0].get_color() == found[1].get_color()
    assert (
        look.artists(figure, "camera-position_1")[0].get_color()
        != look.artists(figure, "camera-position_2")[0].get_color()
    )
    assert "digital twin" not in words
    look.drawn(figure)


def test_arrows_are_the_z_axes(cones, poses, look):
    figure = field_positions(cones, poses)
    arrows = [a for a in look.artists(figure, "z-axis") if a.axes.get_title(loc="left").startswith("b")]
    first = poses.iloc[0]
    z = Rotation.from_quat(first[["qx", "qy", "qz", "qw"]].to_numpy(float)).as_matrix()[:, 2]
    way = np.array(arrows[0].xy) - arrows[0].xyann
    assert way / np.linalg.norm(way) == pytest.approx(z[:2] / np.linalg.norm(z[:2]), abs=1e-9)
    # the camera looks to port: to the left of the heading of 3 degrees
    assert z[0] < -0.95


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
    # the picture fills 0..w, 0..h: pixels count from the corner
    ax = next(a for a in figure.axes if a.get_title(loc="left").startswith("b"))
    assert ax.images[0].get_extent() == [0, 200, 150, 0]
    (arrows,) = look.artists(figure, "residuals")
    scale = float(words.split("residuals enlarged ")[1].split(" times")[0].replace(" ", ""))
    assert np.asarray(arrows.U) == pytest.approx(scale * kept["residual_x_px"].to_numpy())
    assert np.asarray(arrows.V) == pytest.approx(scale * kept["residual_y_px"].to_numpy())
    look.drawn(figure)


def test_the_sketch_of_a_cone_has_its_symbols(look):
    figure = cone_frame()
    words = look.texts(figure)
    assert all(symbol in words for symbol in ("$a$", "$p_j$", "$s_j$", "$\\alpha$", "$z_{cocs}$"))
    assert "no data" in words
    look.drawn(figure)


def test_a_synthetic_view_colours_cones_by_height(rng, tmp_path, look):
    height = np.full((40, 100), np.nan, np.float32)
    height[10:20, 20:40], height[10:20, 60:80] = 0.5, 2.0
    shade = np.full((40, 100), 200, np.uint8)
    lidar = pd.DataFrame(rng.uniform(-3, 3, (200, 3)), columns=["x_m", "y_m", "z_m"])
    lidar = lidar.assign(ring=np.arange(200) % 8, on_cone=np.arange(200) < 120)
    figure = synthetic_view(height, shade, lidar, twin=True)
    assert "n = 120 points on cones in 8 scan lines" in look.texts(figure)
    (image,) = look.artists(figure, "image")
    pixels = np.asarray(image.get_array())
    assert np.ptp(pixels[0, 0]) == 0  # grey background
    assert not np.allclose(pixels[15, 30], pixels[15, 70])
    (frame,) = look.artists(figure, "frame")
    assert len(frame.get_offsets()) == 120
    look.drawn(figure)


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
    along = look.artists(figure, "along")
    radius = [np.linalg.norm(cloud.get_offsets(), axis=1) for cloud in along]
    # 12 mm on a radius of 8 to 33 cm, and 10 cm along an axis inclined to it
    assert np.median(np.abs(radius[1] - 1)) < 0.07
    assert np.median(np.abs(radius[0] - 1)) > 0.12
    look.drawn(figure)
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
    lines = look.artists(figure, "positions-3")
    assert len(lines) == 3
    x, y = lines[0].get_data()
    assert list(x) == [4, 6, 8]
    assert y == pytest.approx(0.05 * np.sqrt(18 / np.array([4, 6, 8]) / 3))
    # lever arms in millimetres
    assert lines[2].get_ydata()[1] == pytest.approx(0.5)
    look.drawn(figure)
