"""Files of other programs: their conventions, what they do not say, and what they must not hold."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from thalweg.cli import main
from thalweg.core import (
    Camera,
    ConfigError,
    InputError,
    UnsupportedError,
    rotation_opk,
    write_colmap,
    write_opencv,
)
from thalweg.core.calibration import (
    import_camera,
    import_kalibr,
    import_matrix,
    read_calibration,
    read_kalibr,
    read_matrix,
)
from thalweg.ingest.registry import describe, recognise

SIGMAS = {
    "angle_deg": 0.02,
    "lever_m": 0.002,
    "focal_px": 0.5,
    "centre_px": 0.3,
    "distortion": 1e-4,
    "time_s": 1e-4,
}

T_CAM_IMU = np.eye(4)
T_CAM_IMU[:3, :3] = rotation_opk(*np.deg2rad([-91.0, 0.5, 2.0]))
T_CAM_IMU[:3, 3] = [0.07, -0.02, 0.004]

CHAIN = """\
cam0:
  T_cam_imu:
{first}
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, 0.00002]
  distortion_model: radtan
  intrinsics: [458.654, 457.296, 367.215, 248.375]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
  timeshift_cam_imu: -0.0123
cam1:
  T_cn_cnm1:
{second}
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [-0.01, 0.02, -0.003, 0.0004]
  distortion_model: equidistant
  intrinsics: [300.5, 301.5, 320.0, 240.0]
  resolution: [640, 480]
  rostopic: /cam1/image_raw
"""


def rows(T):
    return "\n".join(f"  - [{', '.join(f'{x:.9f}' for x in row)}]" for row in T)


@pytest.fixture
def chain(tmp_path):
    """A chain in the layout that Kalibr's wiki page on its YAML formats documents."""
    path = tmp_path / "camchain-imucam.yaml"
    stereo = np.eye(4)
    stereo[0, 3] = -0.11
    path.write_text(CHAIN.format(first=rows(T_CAM_IMU), second=rows(stereo)))
    return path


def test_kalibr_in_our_conventions(chain):
    first, second = read_kalibr(chain)
    # T_cam_imu takes points of the IMU to the camera; the mount is its inverse. Nine digits in the file.
    assert first.T_ics_ccs.matrix == pytest.approx(np.linalg.inv(T_CAM_IMU), abs=2e-9)
    assert first.offset_s == -0.0123
    assert first.camera.model == "perspective"
    # pixels from the corner instead of the centre of the first one
    assert first.camera.parameters == pytest.approx(
        [458.654, 457.296, 367.715, 248.875, -0.28, 0.07, 2e-4, 2e-5, 0]
    )
    assert second.camera.model == "fisheye"
    assert second.camera.size_px == (640, 480)
    assert second.T_ics_ccs is None
    assert second.T_ccs_previous.shift_m == pytest.approx([-0.11, 0, 0])


def test_kalibr_projects_like_opencv(chain):
    import cv2

    points = np.array([[0.3, -0.2, 2.0], [-0.5, 0.1, 1.5]])
    for found in read_kalibr(chain):
        p = found.camera.parameters
        K = np.array([[p[0], 0, p[2] - 0.5], [0, p[1], p[3] - 0.5], [0, 0, 1]])
        zero, given = np.zeros(3), points[:, None]
        if found.camera.model == "perspective":
            xy = cv2.projectPoints(given, zero, zero, K, p[4:8])[0]
        else:
            xy = cv2.fisheye.projectPoints(given, zero, zero, K, p[4:8])[0]
        assert found.camera.project(points) == pytest.approx(xy[:, 0] + 0.5, abs=1e-9)


def test_kalibr_becomes_a_calibration_with_the_sigmas_that_are_stated(chain):
    found = import_kalibr(chain, SIGMAS, run="yard")
    blocks = "camera camera_interior camera_clock camera_1_camera_0 camera_1_interior"
    assert names_of(found) == blocks.split()
    assert found.pose("camera").matrix == pytest.approx(np.linalg.inv(T_CAM_IMU), abs=2e-9)
    sigma = dict(zip(found.labels, found.sigmas, strict=True))
    expected = {"camera.x_m": 0.002, "camera.phi_deg": 0.02, "camera_interior.fx": 0.5}
    expected |= {"camera_interior.k3": 0.0, "camera_clock.offset_s": 1e-4}  # Kalibr's model has no k3
    assert {name: sigma[name] for name in expected} == pytest.approx(expected)
    assert found.find("camera_interior").facts == {"model": "perspective", "width_px": 752, "height_px": 480}


@pytest.mark.parametrize("missing", sorted(SIGMAS))
def test_no_sigma_is_invented(chain, missing):
    with pytest.raises(InputError, match=rf"no sigma {missing}.*State it: --sigma {missing}="):
        import_kalibr(chain, {k: v for k, v in SIGMAS.items() if k != missing})


@pytest.mark.parametrize(
    ("old", "new", "error", "message"),
    [
        ("camera_model: pinhole", "camera_model: cubic", UnsupportedError, r":8: cam0: camera model cubic"),
        (
            "camera_model: pinhole",
            "camera_model: omni",
            UnsupportedError,
            "model omni with distortion radtan",
        ),
        ("radtan", "fov", UnsupportedError, "distortion fov; expected pinhole with radtan or equidistant"),
        ("  intrinsics: [458.654, ", "  intrinsics: [", ConfigError, r":11: cam0.intr.*expected 4 numbers"),
        ("  resolution: [752, 480]\n", "", ConfigError, "cam0.resolution: found None; expected 2 numbers"),
        ("[458.654", "[-458.654", ConfigError, "positive focal lengths"),
        ("shift_cam_imu: -0.0123", "shift_cam_imu: early", ConfigError, "'early'; expected seconds"),
        (", 0.070000000]", ", 70.0]", InputError, r":2: cam0\.T_cam_imu: a lever arm of \(70, .*millimetres"),
        (", -0.110000000]", ", -110.0]", InputError, r"cam1\.T_cn_cnm1: a lever arm of \(-110, .*\(-0\.11,"),
        ("0.000000000, 1.0", "0.1, 1.0", InputError, ":2: cam0.T_cam_imu: the last row"),
    ],
)
def test_what_kalibr_files_must_not_hold(chain, old, new, error, message):
    text = chain.read_text()
    assert old in text
    chain.write_text(text.replace(old, new, 1))
    with pytest.raises(error, match=message):
        read_kalibr(chain)


def test_cameras_of_a_chain_go_by_their_numbers_and_may_have_opencvs_head(chain):
    text, before = chain.read_text(), read_kalibr(chain)
    chain.write_text(text.replace("cam0:", "left:"))
    assert [found.name for found in read_kalibr(chain)] == ["cam1"]
    head, second = text.split("cam1:")
    chain.write_text(f"%YAML:1.0 # of OpenVINS\n---\ncam1:{second}{head}")
    after = read_kalibr(chain)
    assert [found.name for found in after] == ["cam0", "cam1"]
    assert [found.camera.model for found in after] == [found.camera.model for found in before]
    chain.write_text(f"cam1:{second}")
    assert names_of(import_kalibr(chain, SIGMAS)) == ["camera_interior"]


def names_of(calibration):
    return [block.name for block in calibration.blocks]


def write_matrix(path, T):
    path.write_text("\n".join(" ".join(f"{x:.8f}" for x in row) for row in T) + "\n")
    return path


def said(capsys, words, code=0):
    """What the command says: how it went, or what is wrong."""
    assert main([str(word) for word in words]) == code
    told = capsys.readouterr()
    return told.err if code else told.out


def test_a_matrix_by_rows(tmp_path):
    T = np.linalg.inv(T_CAM_IMU)
    path = write_matrix(tmp_path / "m.txt", T)
    assert recognise(path) == "matrix"
    found = import_matrix(path, SIGMAS, name="lidar")
    # eight digits in the file
    assert found.pose("lidar").matrix == pytest.approx(T, abs=2e-8)
    assert np.linalg.det(found.pose("lidar").R) == pytest.approx(1.0, abs=1e-14)
    assert found.pose("lidar").sigma_shift_m == pytest.approx([0.002] * 3)
    assert found.pose("lidar").sigma_rotation_rad == pytest.approx([np.deg2rad(0.02)] * 3)
    named = import_matrix(path, SIGMAS, name="sonar", target="ics", source="ecs")
    assert named.find("sonar").equation.startswith("x_ics = R_ics_ecs @ x_ecs")
    with pytest.raises(InputError, match="no sigma angle_deg"):
        import_matrix(path, {})


MIRROR = np.diag([1.0, 1, -1, 1])


@pytest.mark.parametrize(
    ("T", "message"),
    [
        (T_CAM_IMU.T, "stands column after column.*Transpose it"),
        (T_CAM_IMU @ np.diag([1.002, 1.002, 1.002, 1]), "a scale of 1.002;.*Register again without scale"),
        (T_CAM_IMU @ MIRROR, "a reflection"),
        (T_CAM_IMU @ np.diag([1.1, 1, 1, 1]), "no rotation"),
        (T_CAM_IMU @ np.diag([0.0, 0, 0, 1]), "no rotation"),
        (T_CAM_IMU[:3], "no 4x4 matrix"),
        (np.full((4, 4), np.nan), "no 4x4 matrix"),
        (T_CAM_IMU + np.diag([0, 0, 0, 1.0]), r"the last row is \[0.0, 0.0, 0.0, 2.0\]"),
    ],
)
def test_what_a_matrix_must_not_be(tmp_path, T, message):
    with pytest.raises(InputError, match=message):
        read_matrix(write_matrix(tmp_path / "m.txt", T))


def test_a_matrix_with_comments_and_commas(tmp_path):
    path = tmp_path / "m.txt"
    path.write_text(
        "# from CloudCompare\r\n1, 0, 0, 0.1\r\n0, 1, 0, 0.2\r\n0, 0, 1, 0.3\r\n0, 0, 0, 1\r\n\r\n"
    )
    assert read_matrix(path).shift_m == pytest.approx([0.1, 0.2, 0.3])
    assert recognise(path) == "matrix"
    with pytest.raises(InputError, match="file not found"):
        read_matrix(tmp_path / "none.txt")
    (tmp_path / "b.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not a text file"):
        read_matrix(tmp_path / "b.txt")


def test_the_command_writes_a_file_that_it_can_describe(chain, tmp_path, capsys):
    out, other = tmp_path / "camera.yaml", tmp_path / "x.yaml"
    sigmas = [word for name, value in SIGMAS.items() for word in ("--sigma", f"{name}={value}")]
    said(capsys, ["import-calibration", chain, out, *sigmas])
    assert "camera_clock.offset_s" in read_calibration(out).labels
    assert recognise(out) == "calibration"
    text = said(capsys, ["describe", out])
    assert "offset_s     -0.01230 ± 0.00010 s" in text
    assert "x_ics = R_ics_ccs @ x_ccs + (x, y, z)" in text
    assert "turned by" in text
    for words, answer in (
        ([chain, out, *sigmas], "exists already"),
        ([out, other], "this is a calibration file; expected Kalibr"),
        ([chain, other], "State it: --sigma"),
    ):
        assert answer in said(capsys, ["import-calibration", *words], 2)


def test_the_command_takes_a_matrix(tmp_path, capsys):
    path, out = write_matrix(tmp_path / "m.txt", T_CAM_IMU), tmp_path / "lidar.yaml"
    words = ["import-calibration", path, out, "--sigma", "angle_deg=0.1", "--sigma", "lever_m=0.01"]
    said(capsys, [*words, "--block", "camera"])
    assert read_calibration(out).to_mounts()["camera"]["sigma_axes"] == "ics"
    with pytest.raises(SystemExit):
        said(capsys, [*words, "--sigma", "lever=1"])


def test_a_matrix_in_millimetres_is_no_lever_arm(tmp_path):
    T = T_CAM_IMU.copy()
    T[:3, 3] *= 1000.0
    path = write_matrix(tmp_path / "m.txt", T)
    with pytest.raises(
        InputError, match=r"m\.txt: a lever arm of \(70, -20, 4\) m; expected components up to 20"
    ):
        import_matrix(path, SIGMAS)
    # looked at, it may be any transform
    assert any("Are these millimetres" in note for note in describe(path).notes)
    assert read_matrix(path).shift_m[0] == 70.0


def test_cameras_come_in_with_the_sigmas_that_are_stated(tmp_path):
    """What is exactly zero was held at zero by the program that calibrated."""
    parameters = np.array([3717.25, 3711.0, 2301.0, 1720.0, -0.11, 0.08, 3e-4, -5e-4, 0.0])
    camera = Camera(model="perspective", size_px=(4592, 3448), parameters=parameters)
    write_colmap(tmp_path / "cameras.txt", {1: camera, 7: camera})
    write_opencv(tmp_path / "cam.json", camera)
    by_colmap = import_camera(tmp_path / "cameras.txt", SIGMAS, kind="colmap", number=7, name="boat")
    by_opencv = import_camera(tmp_path / "cam.json", SIGMAS, kind="opencv", name="boat")
    assert by_colmap.labels == by_opencv.labels
    assert by_colmap.labels[0] == "boat_interior.fx"
    expected = [0.5, 0.5, 0.3, 0.3, 1e-4, 1e-4, 1e-4, 1e-4, 0.0]
    for found in (by_colmap, by_opencv):
        # 0.5 pixels off and on round the last digit of cx
        assert_allclose(found.values, parameters, rtol=1e-15)
        assert_allclose(found.sigmas, expected)
        assert found.source.method.endswith("sigmas as stated")
    for number, words in ((None, "2 cameras; expected the number of one: 1, 7"), (2, "there is no camera 2")):
        with pytest.raises(InputError, match=words):
            import_camera(tmp_path / "cameras.txt", SIGMAS, kind="colmap", number=number)
    with pytest.raises(InputError, match="no sigma centre_px"):
        import_camera(tmp_path / "cam.json", {"focal_px": 1.0}, kind="opencv")


def test_a_sigma_that_is_asked_for_is_never_dropped(tmp_path, capsys):
    """Zeros of a lens that nobody calibrated err as stated; those beside a calibrated one when named."""
    bare = np.array([3700.0, 3700.0, 2300.0, 1720.0, 0, 0, 0, 0, 0])
    radial = bare + np.array([0, 0, 0, 0, -0.1, 0, 0, 0, 0])
    expected = {
        "bare": ([0.1, 0.1, 0.0, 0.0, 0.1], {"distortion": 0.1}),
        "radial": ([0.1, 0.0, 0.0, 0.0, 0.0], {"distortion": 0.1}),
        "named": ([0.1, 0.02, 0.003, 0.0, 0.0], {"distortion": 0.1, "k2": 0.02, "p1": 0.003}),
    }
    for name, (sigmas, stated) in expected.items():
        values = bare if name == "bare" else radial
        camera = Camera(model="perspective", size_px=(4592, 3448), parameters=values)
        write_opencv(tmp_path / f"{name}.json", camera)
        found = import_camera(
            tmp_path / f"{name}.json", {"focal_px": 9.0, "centre_px": 5.0, **stated}, kind="opencv"
        )
        assert_allclose(found.sigmas, [9.0, 9.0, 5.0, 5.0, *sigmas])
        held = [n for n, s in zip(("k1", "k2", "p1", "p2", "k3"), sigmas, strict=True) if s == 0]
        assert found.blocks[0].facts["held"] == held
    words = ["import-camera", tmp_path / "bare.json", tmp_path / "out.yaml"]
    words += ["--sigma", "focal_px=9", "--sigma", "centre_px=5"]
    assert "no sigma distortion" in said(capsys, words, 2)
    words += ["--sigma", "distortion=0.1"]
    unknown = "a sigma of k4, which a perspective camera does not have"
    assert unknown in said(capsys, [*words, "--sigma", "k4=0.1"], 2)
    assert "held at their values, sigma zero: p1, p2" in said(capsys, words)


def test_describe_says_what_a_foreign_file_does_not(chain, tmp_path):
    report = describe(chain)
    assert report.stream == "calibration"
    text = "\n".join(report.lines())
    assert "cam1" in text
    assert "752 x 480 pixels" in text
    assert "does not say how well" in text
    report = describe(write_matrix(tmp_path / "m.txt", T_CAM_IMU))
    text = "\n".join(report.lines())
    assert "x, y, z  0.07000, -0.02000, 0.00400 m" in text
    assert '"pose"' in report.to_json()


def test_describe_reads_camera_files(tmp_path, capsys):
    camera = Camera(
        model="fisheye", size_px=(640, 480), parameters=np.array([300.5, 301, 320.5, 240.5, 0.01, 0, 0, 0])
    )
    for name, kind, write in (
        ("cameras.txt", "colmap", lambda path: write_colmap(path, {3: camera})),
        ("cam.yaml", "opencv", lambda path: write_opencv(path, camera)),
    ):
        path = tmp_path / name
        write(path)
        assert recognise(path) == kind
        text = said(capsys, ["describe", path])
        assert "fisheye, 640 x 480 pixels" in text
        assert "cx           320.5" in text
        assert "does not say how well" in text


SPHERE = """\
cam0:
  camera_model: {model}
  distortion_model: {kind}
  intrinsics: [{values}]
  resolution: {size}
"""


@pytest.mark.parametrize(
    ("model", "values", "size", "within_px"),
    [
        # front lens of a Ricoh Theta S at 1280 x 640, as published: u 547.23, xi 1.9267
        ("omni", "1.9267, 547.23, 547.23, 319.5, 319.5", [640, 640], 0.005),
        ("eucm", "0.61, 1.05, 190.0, 191.0, 318.0, 321.0", [640, 640], 0.005),
        ("ds", "-0.2, 0.6, 160.0, 161.0, 318.0, 321.0", [640, 640], 0.005),
        # a wide and a high picture whose principal point lies near one corner: the other one is far
        ("eucm", "0.65, 1.1, 420.0, 400.0, 119.5, 59.5", [700, 260], 0.03),
        ("ds", "-0.2, 0.6, 320.0, 300.0, 59.5, 119.5", [260, 700], 0.03),
    ],
)
def test_models_by_a_sphere_become_fisheyes(tmp_path, model, values, size, within_px):
    """Against the published formulae by points, not by angles."""
    path = tmp_path / "camchain.yaml"

    def read(distortion):
        path.write_text(SPHERE.format(model=model, values=values, kind=distortion, size=size))
        return read_kalibr(path)

    for terms in ("0, 0.1, 0, 0", "0.1, 0, 0, 0"):
        with pytest.raises(UnsupportedError):
            read(f"radtan\n  distortion_coeffs: [{terms}]")
    for terms in ("", "0, 0, 0, 0"):
        assert len(read(f"radtan\n  distortion_coeffs: [{terms}]")) == 1
    (found,) = read("none")
    *shape, fu, fv, pu, pv = map(float, values.split(","))
    angle, around = np.meshgrid(np.arange(1.0, 100.0), np.arange(0.0, 360.0, 5.0))
    t, turn = np.deg2rad([angle.ravel(), around.ravel()])
    x, y, z = np.stack([np.sin(t) * np.cos(turn), np.sin(t) * np.sin(turn), np.cos(t)])
    if model == "omni":
        w = z + shape[0]
    elif model == "eucm":
        alpha, beta = shape
        w = alpha * np.sqrt(beta * (x * x + y * y) + z * z) + (1 - alpha) * z
    else:
        xi, alpha = shape
        w = alpha * np.sqrt(x * x + y * y + (xi + z) ** 2) + (1 - alpha) * (xi + z)
    expected = np.stack([fu * x / w + pu + 0.5, fv * y / w + pv + 0.5], axis=1)
    got = found.camera.project(np.stack([x, y, z], axis=1))
    shown = ((expected >= 0) & (expected <= size)).all(axis=1)
    assert np.abs(got - expected)[shown].max() < within_px
    far = np.abs(expected[shown] - [pu, pv])
    assert (far.max(axis=0) > 0.95 * (np.array(size) - [pu, pv])).all()
    if model == "omni":
        assert found.camera.parameters[0] == pytest.approx(547.23 / 2.9267, abs=0.05)  # u / (1 + xi)


def test_a_sphere_that_no_fisheye_follows_is_refused(tmp_path):
    path = tmp_path / "camchain.yaml"
    path.write_text(
        SPHERE.format(model="omni", values="0.0, 50.0, 50.0, 319.5, 319.5", kind="none", size=[640, 640])
    )
    with pytest.raises(UnsupportedError, match=r"camchain.yaml:2: cam0.*within 0\.02 px"):
        read_kalibr(path)
