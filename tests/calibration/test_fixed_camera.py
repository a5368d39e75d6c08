"""Poses of a fixed camera from control points: simulated with known errors, and a glacier's time lapse."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from tests.bands import band
from thalweg.accuracy import verdict_of
from thalweg.calibration import read_camera, resect_series, starting_lens
from thalweg.calibration.camera_files import free_of_lens
from thalweg.calibration.fixed_camera import _columns
from thalweg.cli import main
from thalweg.core import Camera, GeometryError, InputError, write_opencv
from thalweg.images import read_all_marks
from thalweg.images.fixed_camera import history_facts, resect_files, resect_pictures
from thalweg.settings.sections import ControlSettings, FixedCamera

CAMERA = Camera(
    model="perspective",
    size_px=(4000, 3000),
    parameters=np.array([3900.0, 3900.0, 2010.0, 1490.0, -0.08, 0.06, 0.0002, -0.0003, 0.0]),
)


R = Rotation.from_euler("x", -100, degrees=True).as_matrix()
"""The camera looks north, slightly down."""


def places(rng: np.random.Generator, n: int = 9) -> np.ndarray:
    """Points (n, 3) in sight of a camera at the origin."""
    return np.column_stack([rng.uniform(-25, 25, n), rng.uniform(60, 120, n), rng.uniform(-25, 5, n)])


def tables(X: np.ndarray, xy: np.ndarray, image: str = "a") -> tuple[pd.DataFrame, pd.DataFrame]:
    """Marks of a picture, and control points P0, P1 ..."""
    names = [f"P{i}" for i in range(len(X))]
    marks = pd.DataFrame({"image": image, "point": names, "x_px": xy[:, 0], "y_px": xy[:, 1]})
    return marks, pd.DataFrame({"point": names, **dict(zip("xyz", X.T, strict=True))})


def xyz(poses: pd.DataFrame, prefix: str = "") -> np.ndarray:
    """Places (n, 3), or with ``sigma_`` their standard deviations."""
    return poses[[f"{prefix}{axis}_m" for axis in "xyz"]].to_numpy(float)


def test_errors_of_places_are_those_that_the_sigmas_state():
    """24 pictures with points far from the origin, normal errors of image points and of control points."""
    rng = np.random.default_rng(11)
    true_m, squares, contradicted = np.array([500_000.0, 5_600_000.0, 320.0]), [], 0
    local = places(rng)
    for _ in range(24):
        moved = local + rng.normal(0, 0.02, local.shape)
        marks, points = tables(local + true_m, CAMERA.project(moved @ R) + rng.normal(0, 0.8, (9, 2)))
        try:
            poses, *_ = resect_series(
                CAMERA, marks, points, sigma_px=0.8, sigma_point_m=0.02, interior="fixed"
            )
        except GeometryError:
            contradicted += 1
            continue
        assert poses["refused"][0] == ""
        squares.append(((xyz(poses)[0] - true_m) / xyz(poses, "sigma_")[0]) ** 2)
    # one of a thousand right lenses is doubted by chance
    assert contradicted <= 1
    low, high = band(len(squares))
    assert (low < np.mean(squares, axis=0)).all()
    assert (np.mean(squares, axis=0) < high).all()


@pytest.mark.parametrize(
    ("camera", "pictures", "centre_m", "within_m", "rms_px"),
    [
        ("cam1", "IMG_26", (151.65, 99.26, 91.48), 0.005, (0.64, 0.64)),
        ("cam2", "IMG_11", (312.7, 300.4, 135.0), 0.25, (0.77, 1.39)),
    ],
)
def test_a_glacier_camera(camera, pictures, centre_m, within_m, rms_px, data_dir, tmp_path, capsys):
    """Four points in a picture give the published centre; three are refused.

    The file states no sigma: four points leave a lens that may err by 2 % open, and its places uncertain.
    """
    folder = data_dir / "icepy4d_belvedere" / "assets"
    world = pd.read_csv(folder / "targets" / "target_world.csv")
    world.columns = ["point", "x", "y", "z"]
    world.to_csv(tmp_path / "points.csv", index=False)
    tables = [
        pd.read_csv(p).assign(image=p.stem) for p in sorted((folder / "targets").glob(f"{pictures}*.csv"))
    ]
    marks = pd.concat(tables).rename(columns={"label": "point", "x": "x_px", "y": "y_px"})
    marks.to_csv(tmp_path / "marks.csv", index=False)
    words = ["resect", str(tmp_path / "marks.csv"), "--sigma-px", "5", "--sigma-point", "0.02"]
    words += ["--points", str(tmp_path / "points.csv"), "--camera", str(folder / f"calib/{camera}.txt")]
    words += ["-o", str(tmp_path / "poses.csv")]
    assert main([*words, "--largest-sigma", "20"]) == 0
    poses = pd.read_csv(tmp_path / "poses.csv").dropna(subset="x_m")
    sigma = xyz(poses, "sigma_")
    assert (np.abs(xyz(poses) - centre_m) < 2 * sigma).all()
    assert sigma.max() > 3.0
    assert "states no standard deviations: it counts as a guess" in capsys.readouterr().out
    assert main([*words, "--force", "--interior", "weighted"]) == 2
    assert (
        "states no standard deviations; expected a calibration with a covariance" in capsys.readouterr().err
    )
    assert main([*words, "--force", "--interior", "fixed"]) == 0
    poses = pd.read_csv(tmp_path / "poses.csv")
    n = marks.groupby("image").size()
    three = poses["image"].map(n) < 4
    assert all(text.startswith("3 known marks") for text in poses.loc[three, "refused"])
    assert poses.loc[~three, "refused"].isna().all()
    for place in xyz(poses[~three]):
        assert place == pytest.approx(centre_m, abs=within_m)
    found = poses.loc[~three, "rms_px"]
    assert (found.min(), found.max()) == pytest.approx(rms_px, abs=0.006)


def test_bad_tables_are_refused(tmp_path):
    path = tmp_path / "marks.csv"
    for row, told in (("a,P1,3,4", "point P1 stands twice in image a"), ("a,P2,3,", "no y_px")):
        path.write_text(f"image,point,x_px,y_px\na,P1,1,2\n{row}\n")
        with pytest.raises(InputError, match=told):
            read_all_marks([path])
    marks, points = tables(np.zeros((1, 3)), np.ones((1, 2)))
    with pytest.raises(InputError, match=r"none of the image points \(B\) is a control point"):
        resect_series(CAMERA, marks.assign(point="B"), points)


@pytest.mark.parametrize("xy", [(-1.0, 2.0), (10.0, 3000.5)])
def test_marks_outside_of_the_picture_of_the_lens_are_refused(xy):
    """Such are marks from the middle of the picture, in a turned one, or in one of another size."""
    with pytest.raises(InputError, match=r"the mark of P0 at .* in a; expected pixels inside of 4000 x 3000"):
        resect_series(CAMERA, *tables(np.zeros((1, 3)), np.array([xy])))


def test_pictures_of_another_size_than_the_lens_are_told(tmp_path):
    X = places(np.random.default_rng(2))
    for name, table in zip("mp", tables(X, CAMERA.project(X @ R), "a.png"), strict=True):
        table.to_csv(tmp_path / f"{name}.csv", index=False)
    write_opencv(tmp_path / "lens.yaml", CAMERA)
    for size, told in (((2000, 1500), True), ((4000, 3000), False)):
        Image.new("L", size).save(tmp_path / "a.png")
        *_, facts, _ = resect_pictures([tmp_path / "m.csv"], [tmp_path / "p.csv"], tmp_path / "lens.yaml")
        assert any(f"have {size[0]} x {size[1]} pixels" in note for note in facts["notes"]) == told


def test_tables_for_each_picture_are_called_like_it(tmp_path):
    """As ICEpy4D writes them: label, x, y."""
    for name in ("IMG_2", "IMG_10"):
        (tmp_path / f"{name}.csv").write_text("label,x,y\nF2,4002.5,3543.25\n")
    found = read_all_marks(sorted(tmp_path.glob("*.csv")))
    assert sorted(found.image) == ["IMG_10", "IMG_2"]
    assert found.point == ("F2", "F2")
    np.testing.assert_array_equal(found.xy_px, [[4002.5, 3543.25]] * 2)


def test_a_camera_that_stays_and_one_that_moved():
    """Differences from picture to picture are judged by the marks alone: points and lens err alike in all."""
    rng = np.random.default_rng(3)
    local = places(rng, 10)
    # surveyed 10 cm wrong: all poses err by centimetres, and none against another
    surveyed = local + rng.normal(0, 0.1, local.shape)

    def facts_of(shift_m: float) -> dict[str, float]:
        marks = []
        for k in range(16):
            xy = CAMERA.project((local - [shift_m if k >= 8 else 0.0, 0.0, 0.0]) @ R)
            of_picture, points = tables(surveyed, xy + rng.normal(0, 0.5, (10, 2)), f"{k}")
            marks.append(of_picture)
        poses, *_ = resect_series(CAMERA, pd.concat(marks), points, sigma_px=0.5, sigma_point_m=0.1)
        assert (poses["sigma_x_m"] > 1.5 * poses["sigma_change_x_m"]).all()
        return history_facts(poses)

    still = facts_of(0.0)
    assert still["degrees"] == 45
    # residuals of the wrong points add nothing to differences; 45 degrees of freedom: 99.9 % of cases
    low, high = band(45)
    assert low < still["normalised"] < high
    assert verdict_of(still["normalised"], 45) == "consistent"
    assert verdict_of(facts_of(0.2)["normalised"], 45) == "too optimistic"


def test_what_is_told_of_a_series_by_hand():
    """Three pictures, the third without a pose; places weighted by the marks."""
    good = {"x_m": [1.0, 2.0], "y_m": [5.0, 5.0], "z_m": [-1.0, -4.0], "rms_px": [0.3, 0.5]}
    good |= {f"sigma_change_{a}_m": [1.0, 2.0] for a in "xyz"}
    good |= {f"sigma_{a}_m": [2.0, 5.0] for a in "xyz"}
    rows = pd.DataFrame(good).assign(image=["a", "b"], refused="")
    none = pd.DataFrame([{"image": "c", "refused": "no marks"}])
    assert history_facts(pd.concat([rows, none])) == {
        "pictures": 3,
        "with_pose": 2,
        "refused": {"c": "no marks"},
        "place_m": pytest.approx({"x": 1.2, "y": 5.0, "z": -1.6}),
        "spread_m": pytest.approx({"x": np.sqrt(0.5), "y": 0.0, "z": 3 * np.sqrt(0.5)}),
        "predicted_m": pytest.approx(dict.fromkeys("xyz", np.sqrt(2.5))),
        "sigma_m": pytest.approx(dict.fromkeys("xyz", 3.5)),
        "degrees": 3,
        "normalised": pytest.approx((0.2**2 + 0.4**2 + 0.6**2 + 1.2**2) / 3),
        "rms_px": pytest.approx(np.sqrt(0.17)),
    }


def test_what_is_to_be_estimated_of_a_lens():
    """What a covariance observes is left to it; the focal length is one unknown, in pixels of the mean."""
    cov = np.zeros((9, 9))
    cov[2, 2] = cov[4, 4] = 0.25
    camera = CAMERA.with_parameters(CAMERA.parameters + np.eye(9)[1] * 200.0, cov)
    names = camera.parameter_names
    found = free_of_lens(camera, ["focal", "centre", names[4], names[5]])
    assert list(found) == ["focal", names[3], names[5]]
    np.testing.assert_allclose(found["focal"], np.r_[0.975, 1.025, np.zeros(7)])
    np.testing.assert_array_equal([found[names[3]], found[names[5]]], np.eye(9)[[3, 5]])


def test_check_points_take_no_part():
    local = places(np.random.default_rng(8), 8)
    marks, points = tables(local, CAMERA.project(local @ R))
    marks.loc[7, "x_px"] += 30.0
    poses, residuals, *_ = resect_series(CAMERA, marks, points.assign(check=points["point"] == "P7"))
    assert poses["points"][0] == 7
    assert poses["rms_px"][0] < 1e-3
    assert poses["check_rms_px"][0] == pytest.approx(30.0, abs=0.01)
    last = residuals.iloc[-1]
    assert (last["point"], last["used"]) == ("P7", False)
    assert last["vx_px"] == pytest.approx(30.0, abs=0.01)


def test_columns_of_a_pose_by_hand():
    """A quarter turn about z; sigmas 1, 2, 3 cm and 0.1, 0.3, 0.2 degrees."""
    sigma = np.array([0.01, 0.02, 0.03, *np.deg2rad([0.1, 0.3, 0.2])])
    row = _columns(Rotation.from_euler("z", 90, degrees=True).as_matrix(), np.arange(3.0), np.diag(sigma**2))
    assert [row[n] for n in ("x_m", "y_m", "z_m")] == [0.0, 1.0, 2.0]
    assert [row[f"sigma_{n}_m"] for n in "xyz"] == pytest.approx([0.01, 0.02, 0.03])
    assert [row[n] for n in ("qx", "qy", "qz", "qw")] == pytest.approx([0, 0, np.sqrt(0.5), np.sqrt(0.5)])
    assert row["sigma_rotation_deg"] == pytest.approx(0.3)


def test_poses_and_residuals_of_two_pictures():
    """Marks without errors but for one of 40 px; a picture of three marks and a mark of no point."""
    local, place_m = places(np.random.default_rng(4), 8), [100.0, 200.0, 30.0]
    marks, points = tables(local + place_m, CAMERA.project(local @ R))
    wrong = marks.assign(image="b")
    wrong.loc[3, "y_px"] += 40.0
    few = marks[:3].assign(image="c")
    unknown = marks[:1].assign(point="nowhere")
    poses, residuals, *_ = resect_series(CAMERA, pd.concat([marks, wrong, few, unknown]), points)
    assert poses["image"].tolist() == ["a", "b", "c"]
    assert poses["points"].tolist() == [8, 7, 3]
    assert poses["refused"].tolist()[:2] == ["", ""]
    assert poses["refused"][2].startswith("3 known marks")
    for row in poses[:2].itertuples():
        assert (row.x_m, row.y_m, row.z_m) == pytest.approx(place_m, abs=2e-3)
        turn = Rotation.from_quat([row.qx, row.qy, row.qz, row.qw]).as_matrix()
        assert turn == pytest.approx(R, abs=1e-4)
    assert poses["rms_px"][0] == pytest.approx(0.0, abs=1e-3)
    assert poses["rms_px"][1] == pytest.approx(np.sqrt(40.0**2 / 8), rel=0.02)
    bad = residuals[~residuals["used"]]
    assert bad[["image", "point"]].to_numpy().tolist() == [["b", "P3"]]
    assert bad["vy_px"].iloc[0] == pytest.approx(40.0, abs=0.5)


def hillside(seed: int, *, noise_px: float, n: int = 28) -> tuple[Camera, pd.DataFrame, pd.DataFrame]:
    """A lens as others are, and points over a slope 200 to 1500 m before it; marks with normal errors."""
    rng = np.random.default_rng(seed)
    f = 4000 * rng.uniform(0.7, 1.4)
    lens = [f, f, *rng.normal([2000, 1500], 40), *rng.normal(0, 0.1, 2), 0, 0, 0]
    camera = Camera(model="perspective", size_px=(4000, 3000), parameters=np.array(lens))
    R_slope = Rotation.from_euler("x", -95, degrees=True).as_matrix()
    rays = camera.rays(rng.uniform([200, 400], [3800, 2800], (8 * n, 2))) @ R_slope.T
    # where they meet the slope up = 0.35 (north - 300) - 80
    X = rays * (-185 / (rays[:, 2] - 0.35 * rays[:, 1]))[:, None]
    X = X[(X[:, 1] > 200) & (X[:, 1] < 1500)][:n] + np.outer(rng.uniform(-8, 8, n), [0, 0, 1])
    xy = np.clip(camera.project(X @ R_slope) + rng.normal(0, noise_px, (n, 2)), 0, (4000, 3000))
    return (camera, *tables(X, xy))


def test_an_unknown_focal_length_errs_as_its_sigma_states():
    """The true lens has a centre and a k2 that are not estimated: they count with what lenses have."""
    squares = []
    for seed in range(16):
        true, marks, points = hillside(seed, noise_px=5.0)
        near = 1.05 * true.parameters[0]
        start = starting_lens(marks, points, true.size_px, free=["focal", "k1"], focal_px=near, sigma_px=5.0)
        _, _, lens, _ = resect_series(start, marks, points, sigma_px=5.0, free=["focal", "k1"])
        assert lens.parameters[0] == lens.parameters[1]
        squares.append((lens.parameters[0] - true.parameters[0]) ** 2 / lens.cov[0, 0])
        assert np.sqrt(lens.cov[0, 0]) < 0.02 * lens.parameters[0]
    low, high = band(len(squares))
    assert low < np.mean(squares) < high


def test_what_the_points_do_not_tell_is_refused_by_name():
    true, marks, points = hillside(1, noise_px=5.0)
    free = ["focal", "centre", "k1", "k2"]
    start = starting_lens(marks, points, true.size_px, free=free, sigma_px=5.0)
    with pytest.raises(GeometryError, match="k2 to"):
        resect_series(start, marks, points, sigma_px=5.0, free=free, largest_sigma_m=50)
    with pytest.raises(InputError, match="'focus' to be estimated; expected some of focal, centre"):
        starting_lens(marks, points, true.size_px, free=["focus"])
    with pytest.raises(InputError, match="pixels inside of 400 x 300"):
        starting_lens(marks, points, (400, 300), free=["focal"])


def test_a_photograph_without_a_camera_file_in_a_national_grid(tmp_path, capsys):
    """Swiss LV95 lies on Bessel's ellipsoid: nothing of it needs another datum. Nothing is overwritten."""
    true, marks, points = hillside(3, noise_px=0.5)
    points = points.assign(x=points["x"] + 2_600_000, y=points["y"] + 1_200_000, z=points["z"] + 1500)
    marks.to_csv(tmp_path / "marks.csv", index=False)
    points.to_csv(tmp_path / "points.csv", index=False)
    words = ["resect", str(tmp_path / "marks.csv"), "--points", str(tmp_path / "points.csv")]
    words += ["--free", "focal,k1", "--crs", "EPSG:2056", "-o", str(tmp_path / "poses.csv")]
    assert main(words) == 2
    assert "State it, as --size 6000x4000" in capsys.readouterr().err
    words += ["--size", "4000x3000", "--sigma-px", "0.5"]
    assert main(words) == 0
    assert "stay in the datum of CH1903+ / LV95" in capsys.readouterr().out
    row = pd.read_csv(tmp_path / "poses.csv").iloc[0]
    # earth's curvature over 1 km and the scale of the map move it by centimetres
    assert (row.x_m, row.y_m, row.z_m) == pytest.approx((2_600_000, 1_200_000, 1500), abs=6.0)
    lens = read_camera(tmp_path / "poses_camera.yaml")
    assert lens.parameters[0] == pytest.approx(true.parameters[0], rel=0.02)
    assert main(words) == 2
    assert "exists already" in capsys.readouterr().err
    assert main([*words, "--force"]) == 0


def without_sigma(true: Camera, share: float) -> Camera:
    """Another program's camera: a focal length that is wrong by a share, the middle, no distortion."""
    f = (1 + share) * true.parameters[0]
    return replace(true, parameters=np.array([f, f, 2000.0, 1500.0, 0, 0, 0, 0, 0]))


def test_a_camera_without_sigmas_is_a_guess():
    """1 to 3 % off: squares of the centre's errors over its variances; held as exact they were thousands."""
    squares = []
    rng = np.random.default_rng(20261128)
    for seed in range(400, 412):
        true, marks, points = hillside(seed, noise_px=1.0, n=10)
        camera = without_sigma(true, rng.choice([-1, 1]) * rng.uniform(0.01, 0.03))
        poses, _, lens, notes = resect_series(camera, marks, points, largest_sigma_m=50)
        assert notes[0].startswith("The interior orientation of camera states no standard deviations")
        squares.append((xyz(poses) / xyz(poses, "sigma_")) ** 2)
        assert abs(lens.parameters[0] - true.parameters[0]) < 4 * np.sqrt(lens.cov[0, 0])
    # three coordinates of one place are no three values
    low, high = band(len(squares))
    assert low < np.mean(squares) < high


@pytest.mark.parametrize(("noise_px", "sigma_px"), [(1.0, 1.0), (0.5, 5.0), (1.0, 0.2)])
def test_marks_contradict_an_interior_orientation_whatever_sigma_they_state(noise_px, sigma_px):
    """With a sigma of marks of 5 px, ten times too large, sigma0 looks innocent."""
    true, marks, points = hillside(413, noise_px=noise_px)
    camera = without_sigma(true, 0.03)
    stated = replace(camera, cov=np.diag(np.square([1.0, 1.0, 1.0, 1.0, *[1e-4] * 5])))
    for given, interior in ((camera, "fixed"), (stated, "weighted")):
        with pytest.raises(
            GeometryError, match=r"contradict the interior orientation of camera .* they want fx"
        ):
            resect_series(given, marks, points, sigma_px=sigma_px, interior=interior)
    poses, _, lens, notes = resect_series(stated, marks, points, sigma_px=sigma_px)
    assert notes[0].startswith("The marks contradict the interior orientation of camera")
    assert np.linalg.norm(xyz(poses)) < 3 * poses["sigma_y_m"][0]
    assert lens.parameters[0] == pytest.approx(true.parameters[0], rel=0.01)
    # the right lens is believed
    right = replace(true, cov=stated.cov)
    assert resect_series(right, marks, points, sigma_px=sigma_px, interior="weighted")[0]["refused"][0] == ""


def test_marks_that_err_more_than_stated_make_the_sigmas_larger():
    """By sigma0, all but the part of the lens; too large sigmas are told and kept."""
    true, marks, points = hillside(414, noise_px=2.0)
    sigma, notes = {}, {}
    for stated in (0.5, 2.0, 20.0):
        poses, _, _, notes[stated] = resect_series(
            true, marks, points, sigma_px=stated, interior="fixed", largest_sigma_m=50
        )
        sigma[stated] = poses["sigma_y_m"][0]
    assert sigma[0.5] == pytest.approx(sigma[2.0], rel=0.2)
    assert sigma[20.0] == pytest.approx(10 * sigma[2.0], rel=0.1)
    assert ["Global test" in " ".join(notes[s]) for s in (0.5, 2.0, 20.0)] == [True, False, True]
    assert "err less than stated" in " ".join(notes[20.0])


def test_a_campaign_without_a_camera_file(tmp_path):
    """The rule of the campaign estimates the lens as the command does; what it needs is asked for."""
    true, marks, points = hillside(3, noise_px=0.5)
    marks.to_csv(tmp_path / "marks.csv", index=False)
    points.assign(z=points["z"] + 1500).to_csv(tmp_path / "points.csv", index=False)

    def run(section: FixedCamera) -> dict[str, object]:
        files = {name: tmp_path / f"{name}.out" for name in ("poses", "residuals", "facts")}
        resect_files(
            marks=[tmp_path / "marks.csv"],
            control_points=[tmp_path / "points.csv"],
            interior=[],
            **files,
            campaign={"crs": "local"},
            control=ControlSettings(sigma_px=0.5),
            settings=section,
        )
        return json.loads(files["facts"].read_text())

    lens = run(FixedCamera(size_px=(4000, 3000)))["lens"]
    assert lens["fx"]["value"] == pytest.approx(true.parameters[0], abs=4 * lens["fx"]["sigma"])
    with pytest.raises(InputError, match=r"images\.fixed_camera\.size_px"):
        run(FixedCamera())
    with pytest.raises(InputError, match="'focus' to be estimated"):
        run(FixedCamera(size_px=(4000, 3000), free=["focus"]))
