"""Figures of a calibration's clocks, and the tables that all its figures read."""

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from thalweg.core import CoverageError, InputError, Rigid
from thalweg.figures import read_picture
from thalweg.figures.calibration.clock import chosen_photo, clock_offset, clock_stability, display_intervals
from thalweg.figures.calibration.field import cones_of
from thalweg.figures.calibration.tables import (
    first_picture,
    natural,
    placed,
    read_cones,
    read_display,
    read_image_marks,
)

# ---------------------------------------------------------------- clocks


def test_the_offset_figure_shows_both_tracks(rng, look):
    t = np.arange(0, 60, 0.1)
    track = pd.DataFrame(
        {"t_gps_s": 1e8 + t, "east_m": 3 * np.sin(t / 9), "north_m": 2 * np.cos(t / 7), "up_m": 0.0}
    )
    at = np.arange(10, 590, 10)
    images = track.iloc[at].assign(
        residual_along_m=rng.normal(0, 0.01, len(at)),
        residual_across_m=0.002,
        residual_up_m=0.0,
        used=np.arange(len(at)) != 3,
    )
    figure = clock_offset(images, track, {"offset_s": 2.3471, "sigma_offset_s": 0.0031}, twin=True)
    words = look.texts(figure)
    assert "GPS minus camera +2.3471 s ± 3.1 ms, n = 57 images, 1 rejected" in words
    along = 1e3 * images[images["used"]]["residual_along_m"]
    assert f"along {along.mean():+.1f} ± {along.std(ddof=0):.1f}, across +2.0 ± 0.0" in words.replace(
        "−", "-"
    )
    # an image where the boat stands has no direction: the rest is still drawn
    standing = images.assign(residual_along_m=images["residual_along_m"].where(np.arange(len(at)) != 5))
    words = look.texts(clock_offset(standing, track, {"offset_s": 0.0, "sigma_offset_s": 0.001}))
    rest = 1e3 * standing[standing["used"]]["residual_along_m"].dropna()
    assert f"along {rest.mean():+.1f} ± {rest.std(ddof=0):.1f}, across" in words.replace("−", "-")


def test_intervals_jump_over_what_could_not_be_read(look):
    read = np.cumsum(np.full(50, 0.999))
    read[1::2] += 0.01
    good = np.ones(50, dtype=bool)
    good[[10, 11, 30]] = False
    table = pd.DataFrame(
        {
            "t_camera_s": np.arange(50.0),
            "read_s": np.where(good, read, np.nan),
            "readable": good,
            "file": [f"{k}.jpg" for k in range(50)],
            "text": "10:00:00.00",
        }
    )
    minutes, intervals = display_intervals(table)
    # 49 intervals; three at the hole of two photos, two at that of one
    assert intervals.size == 44
    assert set(intervals.round(6)) == {1.009, 0.989}
    assert minutes[0] == pytest.approx(1.009 / 60)
    figure = clock_stability(table, np.zeros((20, 40, 3), np.uint8), photo_text="10:00:00.00", twin=True)
    words = look.texts(figure)
    assert f"interval {intervals.mean():.4f} s, std {intervals.std(ddof=1):.4f} s, n = 44 intervals" in words
    assert "3 of 50 photos unreadable" in words
    assert "read: 10:00:00.00" in words
    assert chosen_photo(table.assign(overlaid=0.0)) == ("0.jpg", "10:00:00.00")
    overlaid = table.assign(overlaid=np.where(np.arange(50) < 4, 0.3, 0.0))
    assert chosen_photo(overlaid)[0] == "4.jpg"
    # a display of 10 ms has intervals of whole steps: each bar holds one of them
    figure = clock_stability(table, np.zeros((20, 40, 3), np.uint8), step_s=0.01)
    (bars,) = look.artists(figure, "histogram")
    counts, edges, _ = bars.get_data()
    assert np.diff(edges) == pytest.approx(0.01)
    assert counts.sum() == 44
    with pytest.raises(CoverageError, match="0 intervals between readable photos"):
        display_intervals(table.assign(read_s=np.nan))
    with pytest.raises(CoverageError, match="no photo could be read"):
        chosen_photo(table.assign(readable=False))


# ---------------------------------------------------------------- tables


FIELD = """\
thalweg_field: 1
markers: {dictionary: DICT_4X4_250, module_m: 0.012}
cones:
- {name: C1, markers: [0, 7], half_angle_deg: 25.0, length_m: 0.70}
- {name: C2, markers: [8, 15], half_angle_deg: 25.0, length_m: 0.80}
scale_bars:
- {name: S1, from: "80/0", to: "81/0", length_m: 1.5, sigma_m: 0.00003}
- {name: S2, from: "82/0", to: "83/0", length_m: 1.5, sigma_m: 0.00003}
"""


def test_cones_of_the_adjustment_get_axes_and_lengths(tmp_path):
    path, field = tmp_path / "cones.csv", tmp_path / "field.yaml"
    field.write_text(FIELD)
    table = pd.DataFrame(
        {
            "cone": ["C1", "C2"],
            "apex_x_m": 1.0,
            "apex_y_m": 2.0,
            "apex_z_m": 3.0,
            "lambda_deg": [30.0, 0.0],
            "theta_deg": [90.0, 180.0],
            "half_angle_deg": 25.0,
        }
    )
    table.to_csv(path, index=False)
    found = cones_of(read_cones(path, field))
    assert found["C1"].axis == pytest.approx([np.cos(np.pi / 6), 0.5, 0.0])
    assert found["C2"].axis == pytest.approx([0, 0, -1], abs=1e-12)
    assert found["C2"].length_m == 0.8
    table.assign(cone=["C1", "C9"]).to_csv(path, index=False)
    with pytest.raises(InputError, match="no cones C9; expected C1, C2"):
        read_cones(path, field)


def test_pictures_come_as_they_lie(tmp_path):
    path = tmp_path / "p.jpg"
    Image.fromarray(np.full((8, 12), 77, np.uint8)).save(path)
    assert read_picture(path).shape == (8, 12)
    Image.fromarray(np.full((8, 12, 3), 77, np.uint8)).save(path)
    assert read_picture(path).shape == (8, 12, 3)
    path.write_bytes(b"no picture")
    with pytest.raises(InputError, match="no picture"):
        read_picture(path)
    with pytest.raises(InputError, match="file not found"):
        read_picture(tmp_path / "none.jpg")


def test_names_are_sorted_as_people_count():
    assert natural(["C10", "C2", "C1", "C2"]) == ["C1", "C2", "C10"]


def test_marks_of_an_adjustment_get_their_places(tmp_path):
    keys = {"image": ["a.jpg", "a.jpg"], "marker": [3, 3], "corner": [0, 1]}
    residuals, measured = tmp_path / "r.csv", tmp_path / "m.parquet"
    pd.DataFrame({**keys, "vx_px": [0.1, 0.2], "vy_px": [0.0, 0.3], "used": [True, False]}).to_csv(
        residuals, index=False
    )
    places = pd.DataFrame({**keys, "x_px": [10.0, 20.0], "y_px": [5.0, 6.0]})
    places.iloc[::-1].to_parquet(measured)
    marks = read_image_marks(residuals, measured)
    assert list(marks["x_px"]) == [10.0, 20.0]
    assert list(marks["residual_y_px"]) == [0.0, 0.3]


def test_readings_of_the_display_keep_their_order(tmp_path):
    path = tmp_path / "display.csv"
    path.write_text("file,text,t_display_s,reason\na.jpg,1,10.5,\nb.jpg,?,,glare\n")
    table = read_display(path)
    assert list(table["readable"]) == [True, False]
    assert table["read_s"][0] == 10.5


def test_a_field_moves_as_a_whole_into_the_world(cones, poses):
    T = Rigid(R=np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), shift_m=np.array([10.0, 20, 30]))
    moved, stands = placed(cones, T), placed(poses, T)
    before, after = cones_of(cones)["C2"], cones_of(moved)["C2"]
    assert after.surface(4, 1)[0, 0] == pytest.approx(T.apply(before.apex_m[None])[0])
    assert after.axis == pytest.approx(T.R @ before.axis)
    turns = [Rotation.from_quat(each[["qx", "qy", "qz", "qw"]]).as_matrix() for each in (stands, poses)]
    assert turns[0] == pytest.approx(T.R @ turns[1])
    assert stands[["x_m", "y_m", "z_m"]].to_numpy() == pytest.approx(
        T.apply(poses[["x_m", "y_m", "z_m"]].to_numpy())
    )
    assert placed(cones, None) is cones


def test_pictures_come_from_folders_or_files(tmp_path):
    for name in ("position_10.jpg", "position_2.JPG", "notes.txt"):
        (tmp_path / name).write_bytes(b"")
    assert first_picture([tmp_path]).name == "position_2.JPG"
    assert first_picture([tmp_path / "position_10.jpg"]).name == "position_10.jpg"
    assert first_picture([tmp_path], choice=["position_10.jpg"]).name == "position_10.jpg"
    with pytest.raises(CoverageError, match="no picture"):
        first_picture([tmp_path], choice=["position_3.jpg"])
