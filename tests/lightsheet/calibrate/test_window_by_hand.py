"""Camera over the window and free directions of a calibration, against formulas written out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from thalweg.calibration.field import FieldPoints
from thalweg.core import GeometryError, InputError, Rigid, exp_rotation, rotation_opk, rotation_z
from thalweg.core.adjustment import Linear, Observations
from thalweg.lightsheet.calibration import camera_over_window as over, rank
from thalweg.lightsheet.optics import CAMERA, LASER, LENS, PARAMETERS, WINDOW, paper_3, paper_4

MM = 1000.0


def points_of(places_m, sigma_m=1e-4, marker=90):
    n = len(places_m)
    keys = tuple((marker + k // 4, k % 4) for k in range(n))
    cov = np.eye(3 * n) * sigma_m**2
    return FieldPoints(points=keys, points_pcs=np.array(places_m, float), cov=cov)


def square(n=8, width=0.1, height=0.1):
    """Marks around a window in the plane z = 0."""
    turn = 2 * np.pi * np.arange(n) / n
    return np.column_stack([width * np.cos(turn), height * np.sin(turn), 0 * turn])


def test_the_flatness_of_a_window_and_marks_off_it():
    at = np.arange(8)
    flat = square()
    # every second mark out, every second one in: no plane follows them
    bent = flat + np.outer(np.tile([1, -1], 4), [0, 0, 2e-5])
    assert over._require_plane(points_of(bent), at, "") == pytest.approx(0.02)
    for off, told in ((7.9e-4, False), (8.1e-4, True)):
        # of one mark off its plane the others take three eighths in this ring
        one = flat.copy()
        one[2, 2] = off / (1 - 3 / 8)
        if told:
            with pytest.raises(GeometryError, match=r"mark 90/2 lies [+-]0\.81 mm off .* sigma of 0\.10 mm"):
                over._require_plane(points_of(one), at, "")
        else:
            over._require_plane(points_of(one), at, "")
    # sigmas below a hundredth of a millimetre count as that
    one = flat.copy()
    one[2, 2] = 7.5e-5 / (1 - 3 / 8)
    over._require_plane(points_of(one, 1e-6), at, "")
    for height, row in ((0.021, False), (0.019, True)):
        if row:
            with pytest.raises(GeometryError, match=r"lie in a row \(200 mm by 38 mm\)"):
                over._require_plane(points_of(square(height=height)), at, "")
        else:
            over._require_plane(points_of(square(height=height)), at, "")
    with pytest.raises(GeometryError, match=r"5 marks on the window.*at least 6"):
        over._require_plane(points_of(flat), at[:5], "")
    over._require_plane(points_of(flat), at[:6], "")


def test_the_frame_of_the_window():
    """Z along the normal towards the camera, its heading and place along the window those of the design."""
    nominal = paper_4()
    R_pcs_lcs, shift = rotation_opk(0.4, -0.2, 1.1), np.array([0.3, -0.1, 0.7])
    thickness = nominal.window.thickness_mm
    lcs_mm = MM * square(height=0.2) + [0, 0, -thickness]
    on_window = lcs_mm / MM @ R_pcs_lcs.T + shift
    centre = nominal.camera_origin_lcs_mm
    pose = Rigid(R=R_pcs_lcs @ nominal.R_lcs_ccs, shift_m=R_pcs_lcs @ centre / MM + shift)
    R, t = over._frame(pose, on_window, nominal, -thickness)
    assert_allclose(R, R_pcs_lcs.T, atol=1e-9)
    assert_allclose(MM * on_window @ R.T + t, lcs_mm, atol=1e-6)
    # turned about the normal the camera is brought back to the heading of the design
    turned = Rigid(R=R_pcs_lcs @ rotation_z(0.5) @ nominal.R_lcs_ccs, shift_m=pose.shift_m)
    R, _ = over._frame(turned, on_window, nominal, -thickness)
    assert_allclose(R, rotation_z(-0.5) @ R_pcs_lcs.T, atol=1e-9)


@pytest.mark.parametrize(
    ("turn_deg", "height_mm", "told"),
    [(14.9, 1.0, None), (15.1, 1.0, "turned by 15"), (0, -1.0, "lies -1.0 mm above")],
)
def test_a_camera_far_from_the_design_is_refused(turn_deg, height_mm, told):
    nominal = paper_4()
    R = exp_rotation(np.deg2rad(turn_deg) * np.array([0.6, 0.8, 0.0])) @ nominal.R_lcs_ccs
    value = np.array([0.0, 0.0, height_mm])
    if told is None:
        over._require_near(R, value, nominal, "a")
    else:
        with pytest.raises(GeometryError, match=told):
            over._require_near(R, value, nominal, "a")


@pytest.mark.parametrize(("times", "refused"), [(1.99, False), (2.01, True), (0.51, False), (0.49, True)])
def test_a_height_of_another_unit_is_refused(monkeypatch, times, refused):
    nominal = paper_4()
    found = SimpleNamespace(origin_lcs_mm=times * nominal.camera_origin_lcs_mm)
    monkeypatch.setattr(over, "camera_over_window", lambda *words, **how: found)
    if refused:
        with pytest.raises(GeometryError, match="mm above the window; expected about"):
            over.orient_camera(nominal, None, None, (), where="a.jpg")
    else:
        assert over.orient_camera(nominal, None, None, ()) is found


@pytest.mark.parametrize("where", ["", "b.jpg"])
def test_an_adjustment_without_an_end_is_told_of_its_picture(monkeypatch, where):
    def fails(*words, **how):
        raise GeometryError("no end", expected="an end", where=where, cure="Start elsewhere")

    monkeypatch.setattr(over, "camera_over_window", fails)
    with pytest.raises(GeometryError) as told:
        over.orient_camera(paper_4(), None, None, (), where="a.jpg")
    assert told.value.where == (where or "a.jpg")
    assert told.value.cure.startswith("Start" if where else "Take the files as stored")


def test_the_sensor_gets_all_covariances_of_its_camera():
    """With lens and window; what the design said of the camera is gone."""
    rng = np.random.default_rng(2)
    root = rng.normal(0, 0.01, (26, 26))
    sensor = paper_4()
    sensor = sensor.with_vector(sensor.vector(), cov=root @ root.T)
    k = len(range(26)[LENS])
    lens = rng.normal(0, 0.1, (k, k))
    sensor = sensor.with_camera(sensor.camera.with_parameters(sensor.camera.parameters, lens @ lens.T))
    made = over.CameraOverWindow(
        origin_lcs_mm=np.array([1.0, 2, 300]), angles_rad=np.array([0.1, 0.2, 0.3]),
        cov=np.diag(np.arange(6.0)),
        cov_with_lens=rng.normal(0, 1, (6, k)), by_glass=np.array([0, 0, -1.0, 0, 0, 0]),
        R_lcs_pcs=np.eye(3), shift_lcs_mm=np.zeros(3), flatness_mm=0.0, resected=None,
    )  # fmt: skip
    found = made.applied(sensor)
    assert_array_equal(found.vector()[CAMERA], [1, 2, 300, 0.1, 0.2, 0.3])
    rest = np.setdiff1d(np.arange(26), np.arange(26)[CAMERA])
    assert_array_equal(found.vector()[rest], sensor.vector()[rest])
    assert_array_equal(found.cov, found.cov.T)
    assert_array_equal(found.cov[CAMERA, CAMERA], made.cov)
    assert_array_equal(found.cov[CAMERA, LENS], made.cov_with_lens)
    assert_allclose(found.cov[LENS, LENS], lens @ lens.T)
    glass = PARAMETERS.index("glass_mm")
    assert_array_equal(found.cov[CAMERA.start + 2, WINDOW], -sensor.cov[glass, WINDOW])
    assert not found.cov[CAMERA, LASER].any()
    assert not found.cov[:2, WINDOW].any()


def test_numbers_of_marks(tmp_path):
    path = tmp_path / "m.csv"
    path.write_text("marker,corner,x_px,y_px,sigma_px\n1,0,10.5,20.5,0.25\n2,3,1,2,0.5\n")
    table = over.mark_numbers(path)
    assert table.values.tolist() == [[1, 0, 10.5, 20.5, 0.25], [2, 3, 1, 2, 0.5]]
    for row, words in (
        ("2,1.5,1,2,0.5", r"1\.5 in column corner, row 2; expected a whole number"),
        ("2,1,1,2,-0.5", r"sigma_px -0\.5 in row 2"),
        ("1,0,1,2,0.5", "mark 1/0 stands twice"),
    ):
        path.write_text(f"marker,corner,x_px,y_px,sigma_px\n1,0,10.5,20.5,0.25\n{row}\n")
        with pytest.raises(InputError, match=words):
            over.read_camera_marks(path)


# ---------------------------------------------------------------- free directions


def test_directions_are_told_in_words_with_their_amounts():
    one = rank.NullDirection(change={"a_mm": 1.0, "b_rad": -0.25}, motion="turned", singular_value=0.0)
    two = rank.NullDirection(change={"b_rad": 1.0}, motion="", singular_value=0.0)
    error = rank.FreeDirectionError([one])
    assert str(error).startswith(
        "1 direction of the unknowns changes no observation (turned: a_mm +1, b_rad -0.25)"
    )
    assert (error.defects, error.parameters) == (1, ("a_mm", "b_rad"))
    both = rank.FreeDirectionError([one, two])
    assert str(both).startswith("2 directions of the unknowns change no observation (turned:")
    assert "; b_rad +1)" in str(both)
    assert both.parameters == ("a_mm", "b_rad")
    assert "such as a_mm, b_rad: any sigma" in str(both)


def test_a_direction_in_degrees_with_its_largest_part_first():
    problem = SimpleNamespace(free=("a_mm", "b_rad", "c_mm", "d_mm"))
    change = np.array([0.5, np.deg2rad(-2.0), 0.0019, 0.0021])
    found = rank._null_direction(problem, change, "m", 0.125)
    assert list(found.change) == ["b_rad", "a_mm", "d_mm"]
    assert list(found.change.values()) == pytest.approx([1.0, -0.25, -0.00105])
    assert (found.motion, found.singular_value) == ("m", 0.125)


def blind_problem(J):
    """Unknowns a, b, ... of a problem with these derivatives, none of them of a sensor."""
    part = Linear(residual=np.zeros(len(J)), jacobian=J, cov=np.ones(len(J)))
    made = SimpleNamespace(
        free=tuple("abcde")[: J.shape[1]],
        sensor=paper_4(),
        observations=lambda: [Observations("l", lambda x: part)],
    )
    made.with_sensor = lambda sensor: made
    return made


def test_sums_that_nothing_shows_are_a_direction():
    """a + 2 b alone is seen, c well, d not at all; e has one derivative of its own, one of a thousandth."""
    J = np.array([[1.0, 2, 0, 0, 0], [2.0, 4, 0, 0, 0], [0, 0, 5, 0, 0], [0, 0, 0, 0, 1e-3]])
    d, ab = rank.null_directions(blind_problem(J), paper_4().vector())
    assert (d.change, d.motion, d.singular_value) == ({"d": 1.0}, "", 0.0)
    assert ab.change == pytest.approx({"a": 1.0, "b": -0.5})
    assert ab.singular_value == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(rank.FreeDirectionError, match="2 directions"):
        rank.require_full_rank(blind_problem(J), paper_4().vector())
    rank.require_full_rank(blind_problem(J[:, [0, 2, 4]]), paper_4().vector())
    assert len(rank.null_directions(blind_problem(np.zeros((2, 3))), paper_4().vector())) == 3
    # fewer observations than unknowns
    assert len(rank.null_directions(blind_problem(np.array([[1.0, 1, 1]])), paper_4().vector())) == 2
    # columns of unit length that differ by less than the limit are one
    # (the smaller singular value of two at an angle is the angle over the root of two)
    for angle, free in ((1.3e-5, 1), (1.5e-5, 0)):
        two = np.array([[1.0, np.cos(angle)], [0, np.sin(angle)]])
        assert len(rank.null_directions(blind_problem(two), paper_4().vector())) == free


def test_rows_in_reduced_echelon_form():
    rows = np.array([[0.0, 2, 4, 2], [1.0, 1, 1, 1], [3.0, 3, 3, 4]])
    assert_allclose(rank._echelon(rows), [[1, 0, -1, 0], [0, 1, 2, 0], [0, 0, 0, 1]], atol=1e-12)


def test_motions_of_the_sensor_in_its_parameters():
    """Shifts along the window, a turn about its normal, and of the fan in its plane, by finite steps."""
    sensor = paper_3()
    problem = SimpleNamespace(sensor=sensor)
    found = rank._motions(problem)
    assert set(found) == {rank.ABOUT_NORMAL, rank.ALONG_X, rank.ALONG_Y, rank.IN_PLANE}
    R = sensor.window.R_lcs_window
    for name, axis in ((rank.ALONG_X, R[:, 0]), (rank.ALONG_Y, R[:, 1])):
        expected = np.zeros(26)
        expected[CAMERA][:3] = expected[LASER][:3] = axis
        assert_array_equal(found[name], expected)
    h = 1e-4
    for name in (rank.ABOUT_NORMAL, rank.IN_PLANE):
        x = sensor.vector() + h * found[name]
        moved = sensor.with_vector(x)
        if name == rank.ABOUT_NORMAL:
            turn = exp_rotation(h * R[:, 2])
            assert_allclose(moved.R_lcs_ccs, turn @ sensor.R_lcs_ccs, atol=1e-7)
            assert_allclose(moved.camera_origin_lcs_mm, turn @ sensor.camera_origin_lcs_mm, atol=1e-4)
            assert_allclose(moved.sheet.origin_lcs_mm, turn @ sensor.sheet.origin_lcs_mm, atol=1e-4)
        else:
            turn = np.eye(3)
            assert_array_equal(x[CAMERA], sensor.vector()[CAMERA])
        fan = (
            sensor.sheet.R_lcs_las
            if name == rank.ABOUT_NORMAL
            else sensor.sheet.R_lcs_las @ exp_rotation([0, h, 0])
        )
        assert_allclose(moved.sheet.R_lcs_las, turn @ fan, atol=1e-7)
    cone = sensor.with_sheet(replace(sensor.sheet, v=0.01))
    assert rank.IN_PLANE not in rank._motions(SimpleNamespace(sensor=cone))


def test_angles_a_full_turn_apart_are_a_small_step():
    sensor = paper_4()
    k = PARAMETERS.index("laser_kappa_rad")

    def moved(h):
        x = sensor.vector()
        x[k] = (np.pi + h + np.pi) % (2 * np.pi) - np.pi
        x[PARAMETERS.index("laser_x_mm")] += 3 * h
        return x

    slope = rank._derivative(sensor, moved)
    assert (slope[k], slope[PARAMETERS.index("laser_x_mm")]) == pytest.approx((1.0, 3.0), rel=1e-6)
    assert np.count_nonzero(np.abs(slope) > 1e-9) == 2
